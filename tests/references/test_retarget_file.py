"""A person's motion in, a robot's with its certificate out: as the person moves, by the
robot's own legs (`small_walker.leg_points`) and the person's points."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from short_motions import short_amc
from small_biped import biped
from small_reference_robots import reaching, write_csv, write_robot
from small_walker import leg_points, walker

from crar_drake.commands import main
from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.conditioning import low_pass
from crar_drake.references.certificate_files import (
    certificate_path,
    file_hash,
    read_certificate,
)
from crar_drake.references.clean_file import clean_file
from crar_drake.references.contacts import contacts_path, write_beside
from crar_drake.references.faults import find_faults
from crar_drake.references.folders import find_references
from crar_drake.references.ground_contact import FootSlip, GroundContact
from crar_drake.references.motion_certificate import check_certificate
from crar_drake.references.motion_files import read_motion
from crar_drake.references.retarget_file import retarget_file
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

BALL, SIDES = 0.01, ("left", "right")
ARM = ("shoulder", "elbow", "wrist")
FRAMES, RATE = 121, 30.0


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The robot's folder, the person's file, the robot's, and what is said of it."""
    robot = tmp_path_factory.mktemp("walker")
    walker(robot, knee=0.06)
    person = short_amc(tmp_path_factory.mktemp("person"), "some", FRAMES, "exercise")
    out = tmp_path_factory.mktemp("out") / "some.csv"
    return robot, person, out, retarget_file(person, out, str(robot), rate=RATE)


@pytest.fixture(scope="module")
def motion(made):
    robot, _, out, _ = made
    return read_motion(out, robot=WholeBody(load_robot_description(robot)))


@pytest.fixture(scope="module")
def legs(motion):
    """Of each frame, side to the leg's points in the world."""
    found = []
    for p, R, q in zip(
        motion.root_positions,
        motion.root_rotations,
        motion.joint_positions,
        strict=True,
    ):
        joints = dict(zip(motion.joint_names, q, strict=True))
        legs = {side: leg_points(side, joints) for side in SIDES}
        found.append(
            {
                side: {name: p + R.apply(at) for name, at in leg.items()}
                for side, leg in legs.items()
            }
        )
    return {
        side: {name: np.array([f[side][name] for f in found]) for name in leg}
        for side, leg in found[0].items()
    }


@pytest.fixture(scope="module")
def person(made):
    """The person's points at the robot's frames, without what is faster than 6 Hz."""
    performer = load_performer(made[1])
    assert performer.frame_rate == 2 * RATE
    return {
        name: low_pass(points, performer.frame_rate, 6.0)[::2]
        for name, points in performer.positions.items()
    }


def angles(a, b):
    """(T,) between (T, 3) vectors [rad]."""
    cosine = np.einsum("ti,ti->t", a, b)
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), cosine)


def test_it_is_certified_and_judged(made, capsys):
    robot, person, out, clip = made
    certificate = read_certificate(certificate_path(out))
    assert check_certificate(out, certificate, load_robot_description(robot)).holds
    assert certificate["reference"] == {"file": "some.amc", "sha256": file_hash(person)}
    skeleton = person.with_suffix(".asf")
    assert certificate["options"]["read with"] == {"some.asf": file_hash(skeleton)}
    assert not clip.violated
    for more in ([], ["--certificate"]):
        assert main(["judge", str(out), "--robot", str(robot), *more]) == 0
    assert capsys.readouterr().out.endswith("OK\n")


def test_how_its_root_accelerates_is_said(made, motion, person):
    sizes = np.linalg.norm(np.diff(motion.root_positions, 2, axis=0), axis=1) * RATE**2
    rms = np.sqrt(np.mean(sizes**2))
    assert (made[3].root, made[3].root_peak) == pytest.approx((rms, sizes.max()))
    # The person's, by the hips' middle, of his size.
    hips = 0.5 * (person["left_hip"] + person["right_hip"])
    persons = np.linalg.norm(np.diff(hips, 2, axis=0), axis=1) * RATE**2
    scale = made[3].persons_root / np.sqrt(np.mean(persons**2))
    assert 0.5 < scale < 1.2
    assert not made[3].faults


def test_a_share_of_the_ranges_is_all_that_is_used(made, tmp_path, capsys):
    """And a limb that is off by more than is allowed then violates."""
    robot, out = made[0], tmp_path / "half.csv"
    person = short_amc(tmp_path, "few", 31)
    arguments = ["retarget", str(person), "--robot", str(robot), "--out", str(out)]
    assert main([*arguments, "--limits", "0.5", "--at-most", "limbs=90deg"]) == 0
    whole = WholeBody(load_robot_description(robot))
    q = read_motion(out, robot=whole).joint_positions
    middle, half = 0.5 * (whole.lower + whole.upper), 0.5 * (whole.upper - whole.lower)
    used = (np.abs(q - middle) / half)[:, np.isfinite(half)].max()
    assert 0.45 < used <= 0.5 + 1e-6
    capsys.readouterr()
    assert main([*arguments, "--at-most", "limbs=0.1deg"]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.match(r"VIOLATED: .* by more than 0.1 deg in frames 1-16", last)
    assert main(["judge", str(out), "--robot", str(robot), "--no-meshes"]) == 1
    assert "VIOLATED: limbs off" in capsys.readouterr().out


def test_what_nothing_carries_falls(motion):
    """Held up for a second; thrown; and where it jumps."""
    t = np.arange(motion.num_frames) / RATE
    up = np.array([0.0, 0.0, 1.0])
    foot = FootSlip("left_foot", t < 0.0, 0, 0.0, 0.0, None, None, 0.0)
    ground = GroundContact(np.where(t < 1.0, 0.5, 0.0), ("",) * len(t), 0.0, (foot,))

    def faults(height):
        root = np.ones((len(t), 1)) * [0.0, 0.0, 1.0] + height[:, None] * up
        still = np.zeros_like(motion.joint_positions)
        moved = replace(motion, root_positions=root, joint_positions=still)
        moved = replace(
            moved, root_quaternions=np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1))
        )
        return list(map(str, find_faults(moved, ground)))

    assert faults(0.0 * t) == ["nothing carries the robot: frames 1-30"]
    assert faults(-4.9 * t**2) == []
    jumps = faults(np.where(t > 1.5, 0.3, 0.0))[1:]
    assert jumps == ["jumps: root position to frame 47"]


def test_cleaning_it_changes_nothing(made, tmp_path):
    robot, _, out, _ = made
    (row,) = clean_file(out, tmp_path / "again.csv", str(robot))
    assert row.changed == 0
    assert (tmp_path / "again.csv").read_bytes() == out.read_bytes()


def test_legs_point_where_the_persons_do(made, legs, person):
    _, _, _, clip = made
    for side in SIDES:
        for a, b in (("hip", "knee"), ("knee", "ankle")):
            of_robot = legs[side][b] - legs[side][a]
            of_person = person[f"{side}_{b}"] - person[f"{side}_{a}"]
            off = angles(of_robot, of_person)
            median, most = np.median(off), np.quantile(off, 0.95)
            assert median < np.radians(10.0) and most < np.radians(20.0)
            # Said is it of the farthest limb, of arms and legs.
            assert median < clip.limbs_median + 2e-3 and most < clip.limbs_most + 2e-3


def test_knees_bend_as_the_persons_do(made, motion, person):
    for side in SIDES:
        thigh = person[f"{side}_knee"] - person[f"{side}_hip"]
        shank = person[f"{side}_ankle"] - person[f"{side}_knee"]
        k = motion.joint_names.index(f"{side}_shank_j")
        more = motion.joint_positions[:, k] - angles(thigh, shank)
        assert abs(np.median(more)) < np.radians(5.0)
        said = getattr(made[3], f"{side}_knee")
        assert said == pytest.approx(np.median(more), abs=2e-3)


def test_elbows_and_knees_stay_on_their_side(motion):
    for side in SIDES:
        elbow, knee = (
            motion.joint_positions[:, motion.joint_names.index(f"{side}_{x}_j")]
            for x in ("fore_arm", "shank")
        )
        assert elbow.max() < 0.1 and knee.min() > -0.1
        assert elbow.min() < -0.2


def test_nothing_is_below_the_floor_and_what_stands_stays(made, legs):
    """A foot stands where a ball of its sole is on the floor before and after a step;
    of these the one that moves least."""
    lowest, worst = np.inf, 0.0
    for leg in legs.values():
        z = leg["sole"][..., 2] - BALL
        lowest = min(lowest, z.min())
        on = (z[1:] < 5e-3) & (z[:-1] < 5e-3)
        ways = np.linalg.norm(np.diff(leg["sole"][..., :2], axis=0), axis=2)
        least = np.where(on, ways, np.inf).min(axis=1)
        stands = np.isfinite(least)
        assert stands.mean() > 0.5
        worst = max(worst, least[stands].sum())
    assert made[3].lowest == pytest.approx(lowest, abs=1e-6)
    assert -1e-3 < lowest < 5e-3
    assert worst < 2e-3 and made[3].slip < 2e-3


def test_of_so_few_frames_that_there_are_no_steps(made, tmp_path):
    robot, person, _, _ = made
    clip = retarget_file(person, tmp_path / "one.csv", str(robot), rate=0.1)
    assert clip.frames == 1 and not clip.violated


def test_how_the_person_was_read_is_said(made, tmp_path, capsys):
    person = short_amc(tmp_path, "few", 13)
    arguments = ["retarget", str(person), "--robot", str(made[0])]
    assert main([*arguments, "--out", str(tmp_path / "a.csv")]) == 0
    said = capsys.readouterr().out.splitlines()[0]
    assert said.startswith("read: ") and "up +y (assumed" in said


@pytest.mark.parametrize("name, layout", [("a.npz", "mjlab-npz"), ("a.pkl", "gmr-pkl")])
def test_the_layout_is_the_usual_one_of_the_suffix(tmp_path, made, name, layout):
    robot, out = made[0], tmp_path / name
    person = short_amc(tmp_path, "few", 13)
    arguments = ["retarget", str(person), "--robot", str(robot), "--out", str(out)]
    assert main([*arguments, "--rate", "20"]) == 0
    whole = WholeBody(load_robot_description(robot))
    read = read_motion(out, robot=whole)
    assert (read.layout, read.rate, read.num_frames) == (layout, 20.0, 5)
    place = json.loads(certificate_path(out).read_text())
    assert place["motion"]["layout"] == layout


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["PERSON", "--layout", "nonsense"], "there is no layout 'nonsense'"),
        (["PERSON", "--out", "a.txt"], "a.txt: a reference motion is a .csv, .npz or"),
        (
            ["PERSON", "--out", "a.csv", "--layout", "gmr-pkl"],
            "a.csv: .* not of layout gmr-pkl",
        ),
        (["PERSON", "--limits", "1.5"], "'1.5' is no share: it is at most 1"),
        (
            ["PERSON", "--at-most", "feet=1mm"],
            "how far limbs may be off, such as limbs",
        ),
        (["PERSON", "--rate", "0"], "'0' is not a positive number"),
        (["PERSON", "--rate", "1e9"], "the rate is 1e.09 Hz; .* at most 100000 Hz"),
        (["PERSON", "--robot", "CHAIN"], "needs the task_frames left_elbow, "),
        (["PERSON", "--robot", "BIPED"], "needs the task_frames left_elbow, "),
        (["PERSON", "--robot", "nobody"], "no robot 'nobody'"),
        (["ARMS", "--frame-rate", "30"], "arms.csv: no pelvis, left_hip"),
        (["ROBOTS"], "robots.csv is a motion of a robot's own joints"),
        (["none.bvh"], "none.bvh: there is no such motion file"),
    ],
)
def test_bad_input_is_told(made, tmp_path, monkeypatch, capsys, arguments, told):
    monkeypatch.chdir(tmp_path)
    robot, person, _, _ = made
    heads = [f"{s}_{x}_{a}" for s in SIDES for x in ARM for a in "xyz"]
    rows = [",".join(heads), *[",".join(["0.5"] * len(heads))] * 20]
    (tmp_path / "arms.csv").write_text("\n".join(rows))
    write_csv(tmp_path / "robots.csv", reaching(5, 30.0, 0.5))
    chain = tmp_path / "chain"
    chain.mkdir()
    names = {
        "PERSON": person,
        "ARMS": tmp_path / "arms.csv",
        "ROBOTS": tmp_path / "robots.csv",
        "CHAIN": write_robot(chain),
        "BIPED": biped(tmp_path / "biped"),
    }
    arguments = [str(names.get(word, word)) for word in arguments]
    if "--robot" not in arguments:
        arguments += ["--robot", str(robot)]
    assert main(["retarget", *arguments]) == 2
    error = capsys.readouterr().err
    # Where nothing is compiled yet, it says before that it compiles.
    said = [line for line in error.splitlines() if "compil" not in line]
    assert said[0].startswith("crar-drake: error:") and "Traceback" not in error
    assert re.search(told, error), error
    assert not list(tmp_path.glob("**/*.certificate.json"))


@pytest.mark.parametrize("name", ["walk.csv", "walk.npz", "walk.pkl"])
def test_it_says_when_feet_are_on_the_floor(made, name):
    """As the person's are: in the file, or beside one that has no room for it."""
    robot, _, first, _ = made
    out = first.parent / name.replace(".", "_") / name
    person = short_amc(first.parent, "labelled", 31)
    retarget_file(str(person), out, str(robot))
    if name.endswith("csv"):
        beside = contacts_path(out)
        feet, *labels = (line.split(",") for line in beside.read_text().splitlines())
        labels = np.array(labels, dtype=int)
        assert find_references(out.parent).count(beside) == 0
    else:
        motion = read_motion(out, robot=WholeBody(load_robot_description(robot)))
        feet, labels = (motion.extras[key] for key in ("foot_names", "foot_contacts"))
        assert not contacts_path(out).exists()
    assert list(feet) == ["left_foot", "right_foot"]
    frames = read_motion(out).num_frames
    assert labels.shape == (frames, 2) and set(labels.ravel()) <= {0, 1}
    assert labels.any()


def test_labels_of_contacts_go_where_the_motion_goes(made, capsys):
    """From an NPZ to other layouts, and back from those that hold them."""
    robot, _, first, _ = made
    folder = first.parent / "labels"
    npz, other = folder / "walk.npz", folder / "other.npz"
    person = short_amc(first.parent, "labelled too", 31)
    main(["retarget", str(person), "--robot", str(robot), "--out", str(npz)])
    whole = WholeBody(load_robot_description(robot))
    labels = read_motion(npz, robot=whole).extras["foot_contacts"]
    for name, layout, says in (
        ("a.csv", "xyzw-csv", str(folder / "a.contacts.csv")),
        ("b.npz", "locomujoco-npz", str(folder / "b.contacts.csv")),
        ("c.pkl", "motion-lib-pkl", ""),
        ("d.pkl", "gmr-pkl", ""),
    ):
        capsys.readouterr()
        out = folder / name
        given = [str(npz), str(out), "--to", layout, "--robot", str(robot)]
        assert main(["convert", *given]) == 0
        told = capsys.readouterr().out.splitlines()
        assert not any("foot_" in line for line in told), told
        assert told[-1] == (says or str(out))
        if says:
            beside = np.loadtxt(says, delimiter=",", skiprows=1)
            np.testing.assert_array_equal(beside, labels)
        assert contacts_path(out).exists() == bool(says)
        given = [str(out), str(other), "--to", "mjlab-npz", "--robot", str(robot)]
        assert main(["convert", *given]) == 0
        again = read_motion(other, robot=whole).extras
        np.testing.assert_array_equal(again["foot_contacts"], labels)
        assert list(again["foot_names"]) == ["left_foot", "right_foot"]
    assert main(["convert", *given, "--rate", "60"]) == 0
    assert "left out" in capsys.readouterr().out


def test_labels_beside_a_file_are_those_of_its_motion(made, tmp_path, capsys):
    """They are read with it, and go when another motion is written there."""
    robot, _, first, _ = made
    of, out = ["--robot", str(robot)], tmp_path / "walk.csv"
    for path in (first, contacts_path(first), certificate_path(first)):
        (tmp_path / path.name.replace(first.stem, "walk")).write_bytes(
            path.read_bytes()
        )
    labels = read_motion(out).extras["foot_contacts"]
    assert labels.shape == (61, 2) and labels.any()
    few = tmp_path / "few.csv"
    arguments = [str(out), *of, "--out", str(few), "--frames", "3:9", "--no-page"]
    assert main(["clean", *arguments]) == 0
    again = read_motion(few).extras["foot_contacts"]
    np.testing.assert_array_equal(again, labels[2:9])
    for text in (
        "left_foot,right_foot\n" + 6 * "0,1\n",
        "left_foot\n" + 7 * "2\n",
        "left_foot\n" + 7 * "300\n",
        "left_foot\n1,0,0,0,1,0,1\n",
        "\0",
    ):
        contacts_path(few).write_text(text)
        assert main(["judge", str(few), *of]) == 2
        assert "few.contacts.csv: is to name the feet" in capsys.readouterr().err
    contacts_path(few).unlink()
    for command in (
        ["convert", str(few), str(out)],
        ["clean", str(few), "--out", str(out)],
    ):
        contacts_path(out).write_text("of another motion")
        more = [] if command[0] == "convert" else ["--no-page"]
        assert main([*command, *of, *more]) == 0
        assert not contacts_path(out).exists()
    # Those of a file of the same stem stay.
    npz = out.with_suffix(".npz")
    write_beside(out, read_motion(first))
    assert main(["convert", str(few), str(npz), "--to", "mjlab-npz", *of]) == 0
    assert contacts_path(out).exists()
