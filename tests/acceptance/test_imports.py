"""Imported robots: which limbs, joints, limits and pairs; what is refused, and how."""

from pathlib import Path

import mesh_judge
import numpy as np
import product
import pytest
import two_arms

SIDES = ("left", "right")
ARM_POINTS = {f"{side} {p}" for side in SIDES for p in ("shoulder", "elbow", "wrist")}
LEG_POINTS = {f"{side} {point}" for side in SIDES for point in ("hip", "knee", "foot")}
G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
TALOS = "talos_data/robots/talos_full_v2.urdf"
UR5 = "ur_description/urdf/ur5_joint_limited_robot.urdf"
WRITERS = {
    "cell.urdf": two_arms.write_urdf,
    "cell.sdf": two_arms.write_sdf,
    "cell.xml": two_arms.write_mjcf,
}


def mirrored(pairs: set[frozenset[str]]) -> set[frozenset[str]]:
    """The pairs of the other side."""

    def other(link: str) -> str:
        words = {"left": "right", "right": "left"}
        return "_".join(words.get(word, word) for word in link.split("_"))

    return {frozenset(map(other, pair)) for pair in pairs}


def assert_limits_are_the_files(robot: product.Imported, urdf: Path) -> None:
    """What a joint may do is what the robot's own file says."""
    said = mesh_judge.limits(urdf)
    for joint, limits in robot.joints.items():
        assert limits == pytest.approx(said[joint], rel=1e-6), joint


@pytest.fixture(scope="module")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, product.Imported]:
    """The robot of two arms, of three formats."""
    folder, found = tmp_path_factory.mktemp("cells"), {}
    for name, write in WRITERS.items():
        out = folder / name.replace(".", "_")
        done = product.command("import", write(folder / name), out=out)
        assert done.code == product.FINE, done.err
        found[name] = product.imported(out)
    return found


@pytest.mark.parametrize("name", WRITERS)
def test_two_arms_are_found(cells: dict[str, product.Imported], name: str):
    robot = cells[name]
    names = [f"{side}_arm_{k}_joint" for side in SIDES for k in range(1, 7)]
    assert list(robot.joints) == names
    no_speed = name == "cell.xml"  # which MJCF does not know
    for lower, upper, effort, speed in robot.joints.values():
        assert (lower, upper) == (-two_arms.LIMIT, two_arms.LIMIT)
        assert effort == two_arms.EFFORT
        assert speed == two_arms.SPEED or no_speed and (speed is None or speed > 1e3)
    links = {
        f"{side} {point}": f"{side}_arm_{number}"
        for side in SIDES
        for point, number in (("shoulder", 1), ("elbow", 4), ("wrist", 4), ("hand", 6))
    }
    assert {point: robot.points[point] for point in links} == links
    assert not LEG_POINTS & set(robot.points)
    assert robot.base == "prescribed"


def test_all_formats_are_the_same_robot(cells: dict[str, product.Imported]):
    first, *others = cells.values()
    assert first.pairs == mirrored(first.pairs) and first.rest
    for hand in ("left_arm_6", "right_arm_6"):
        assert {
            frozenset((hand, link)) for link in ("trunk", "left_arm_4")
        } & first.pairs
    for other in others:
        assert other.pairs == first.pairs
        assert other.points == first.points
        assert other.rest == pytest.approx(first.rest)


def test_a_humanoid(humanoid: str):
    robot = product.imported(product.imported_by_name(humanoid))
    judge = mesh_judge.Robot(mesh_judge.example(G1))
    assert list(robot.joints) == judge.joints and len(judge.joints) == 29
    assert_limits_are_the_files(robot, mesh_judge.example(G1))
    assert robot.base == "floating"
    assert ARM_POINTS | LEG_POINTS | {"head"} <= set(robot.points)
    for point in ARM_POINTS | LEG_POINTS:
        assert robot.points[point].startswith(point.split()[0])
    rest = np.array([robot.rest.get(joint, 0.0) for joint in judge.joints])
    assert not judge.penetrating(rest[None], judge.pairs(np.zeros(29), rest))


def test_what_can_meet_is_kept_apart(humanoid: str):
    """Meshes of a humanoid, more than two joints apart, that meet somewhere."""
    robot = product.imported(product.imported_by_name(humanoid))
    judge = mesh_judge.Robot(mesh_judge.example(G1))
    rng = np.random.default_rng(61)
    q = rng.uniform(judge.lower, judge.upper, (100, len(judge.joints)))
    met = judge.penetrating(q, judge.pairs(beyond=2))
    # Links that are screwed to others and one with them.
    part_of = {"logo_link": "torso_link"}
    part_of |= {f"{side}_wrist_yaw_link": f"{side}_rubber_hand" for side in SIDES}
    pairs = {frozenset(part_of.get(link, link) for link in each[1:]) for each in met}
    assert len(pairs) > 80
    assert pairs <= robot.pairs
    assert robot.pairs == mirrored(robot.pairs)


def test_the_arms_of_a_larger_humanoid(tmp_path: Path):
    done = product.command("import", product.UPPER_HALF, out=tmp_path / "talos")
    assert done.code == product.FINE, done.err
    robot = product.imported(tmp_path / "talos")
    arms = [f"arm_{side}_{k}_joint" for side in SIDES for k in range(1, 8)]
    assert list(robot.joints) == ["torso_1_joint", "torso_2_joint", *arms]
    assert_limits_are_the_files(robot, mesh_judge.example(TALOS))
    assert ARM_POINTS <= set(robot.points) and robot.base == "prescribed"
    for point in ARM_POINTS:
        assert robot.points[point].startswith(f"arm_{point.split()[0]}")
    assert robot.pairs == mirrored(robot.pairs)
    elbows = {"arm_left_4_link", "arm_right_4_link"}
    assert {frozenset(elbows)} | {frozenset((e, "torso_2_link")) for e in elbows} <= (
        robot.pairs
    )


def test_an_arm(tmp_path: Path):
    done = product.command("import", product.INDUSTRIAL_ARM, out=tmp_path / "arm")
    assert done.code == product.FINE, done.err
    robot = product.imported(tmp_path / "arm")
    assert len(robot.joints) == 6 and robot.base == "fixed"
    assert_limits_are_the_files(robot, mesh_judge.example(UR5))
    assert list(robot.points) == ["tool"]
    assert frozenset(("base_link", "wrist_3_link")) in robot.pairs


JOINT = "left_arm_4"
# What stands in a joint, and what a user must be told of it.
BAD_JOINTS = {
    "lower is above upper": ({"lower": 1.5, "upper": -1.5}, ("lower", "upper", "1.5")),
    "no number": ({"lower": "nan"}, ("lower", "nan")),
    "infinite on one side": ({"upper": "inf"}, ("-1.5", "inf")),
    "half a word": ({"lower": "-1.5rad"}, ("lower", "-1.5rad")),
}


@pytest.mark.parametrize("case", BAD_JOINTS)
def test_a_joint_that_is_wrong_is_refused(tmp_path: Path, case: str):
    values, told = BAD_JOINTS[case]
    urdf = two_arms.write_urdf(tmp_path / "bad.urdf", two_arms.changed(JOINT, **values))
    refused(urdf, tmp_path / "out", f"{JOINT}_joint", *told)


def test_a_speed_that_is_negative_is_refused(tmp_path: Path):
    urdf = two_arms.write_urdf(tmp_path / "bad.urdf")
    speed = f'velocity="{two_arms.SPEED}"'
    urdf.write_text(urdf.read_text().replace(speed, 'velocity="-5"', 1))
    refused(urdf, tmp_path / "out", "left_arm_1_joint", "velocity", "-5")


def test_a_file_that_is_damaged_is_refused(tmp_path: Path):
    urdf = two_arms.write_urdf(tmp_path / "bad.urdf")
    urdf.write_text(urdf.read_text()[:700])
    refused(urdf, tmp_path / "out", "line")
    mesh = '<mesh filename="nowhere.stl"/>'
    refused(
        two_arms.write_urdf(urdf, trunk=mesh), tmp_path / "out", "nowhere.stl", "trunk"
    )
    urdf.unlink()
    refused(urdf, tmp_path / "out")


def refused(urdf: Path, out: Path, *told: str) -> None:
    """The import says why not, and writes no robot."""
    done = product.command("import", urdf, out=out)
    assert done.code == product.REFUSED
    for word in (urdf.name, *told):
        assert word in done.err, done.err
    assert done.err.count("\n") == 1 and not out.exists()


def test_a_limit_on_one_side_is_warned_of(tmp_path: Path):
    urdf = two_arms.write_urdf(tmp_path / "odd.urdf")
    urdf.write_text(urdf.read_text().replace('lower="-1.5" ', "", 1))
    done = product.command("import", urdf, out=tmp_path / "out")
    assert done.code == product.FINE
    warning = [line for line in done.out.splitlines() if "left_arm_1_joint" in line][0]
    assert warning.startswith("WARNING") and "lower" in warning
    limits = product.imported(tmp_path / "out").joints["left_arm_1_joint"]
    assert limits[:2] == (0.0, two_arms.LIMIT)
