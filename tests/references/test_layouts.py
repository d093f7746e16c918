"""Each layout against a reader and a writer of the test's own, from its description."""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_biped import (
    BREADTH_FIRST,
    DEPTH_FIRST,
    link_poses,
    moving_samples,
    whole_biped,
)

from crar_drake.errors import MotionError
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.motion_files import (
    read_motion,
    read_motions,
    write_motions,
)
from crar_drake.references.robot_motion import RobotMotion

P, Q, JOINTS = moving_samples()
RATE = 40.0
WRITTEN = list(LAYOUTS)
# Where each layout has the joints.
ORDER = [DEPTH_FIRST.index(name) for name in BREADTH_FIRST]
LINKS = ("pelvis", "left_thigh", "left_shin", "right_thigh", "right_shin", "trunk")
BREADTH_LINKS = (
    *("pelvis", "left_thigh", "right_thigh", "trunk", "left_shin", "right_shin"),
)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return whole_biped(tmp_path_factory.mktemp("biped"))


def motion(**changes) -> RobotMotion:
    return replace(RobotMotion(DEPTH_FIRST, P, Q, JOINTS, RATE), **changes)


def xyzw(quaternions: np.ndarray) -> np.ndarray:
    return np.roll(quaternions, -1, axis=1)


def bodies(links: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Poses and velocities of links in the world, by hand.

    Velocities are differences of a spline-free kind: the exact ones of a motion whose
    root and joints move on with the layout's differences.
    """
    R_WR = Rotation.from_quat(xyzw(Q))
    v, qdot = np.gradient(P, 1 / RATE, axis=0), np.gradient(JOINTS, 1 / RATE, axis=0)
    w = np.empty_like(P)
    for t in range(len(P)):
        a, b = max(t - 1, 0), min(t + 1, len(P) - 1)
        w[t] = (R_WR[b] * R_WR[a].inv()).as_rotvec() / ((b - a) / RATE)
    found = {key: [] for key in ("p", "Q", "v", "w")}
    step = 1e-6
    for t in range(len(P)):
        poses = []
        for s in (-step, 0.0, step):
            turned = Rotation.from_rotvec(w[t] * s) * R_WR[t]
            links_in_root = link_poses(JOINTS[t] + s * qdot[t])
            poses.append(
                [
                    (P[t] + s * v[t] + turned.apply(p), turned * R)
                    for p, R in (links_in_root[link] for link in links)
                ]
            )
        before, now, after = poses
        found["p"].append([p for p, _ in now])
        found["Q"].append([np.roll(R.as_quat(), 1) for _, R in now])
        pairs = list(zip(before, after, strict=True))
        found["v"].append([(b[0] - a[0]) / (2 * step) for a, b in pairs])
        found["w"].append(
            [(b[1] * a[1].inv()).as_rotvec() / (2 * step) for a, b in pairs]
        )
    return {key: np.array(values) for key, values in found.items()}


def same_turns(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    """Whether (..., 4) quaternions are the same orientations, whatever their signs."""
    return bool((np.abs(np.abs(np.sum(a * b, axis=-1)) - 1.0) < tolerance).all())


# --- written, and read by the test ------------------------------------------------


@pytest.mark.parametrize(
    "layout, order, links",
    [
        ("mjlab-npz", [0, 1, 2, 3, 4], LINKS),
        ("beyondmimic-npz", ORDER, BREADTH_LINKS),
        ("holosoma-npz", [0, 1, 2, 3, 4], LINKS),
    ],
)
def test_npz_is_written(tmp_path: Path, robot, layout: str, order, links):
    write_motions(tmp_path / "a.npz", [motion()], layout, robot)
    file = np.load(tmp_path / "a.npz")
    exact = layout == "holosoma-npz"
    tolerance = 1e-9 if exact else 1e-6
    assert file["fps"].shape == (1,) and file["fps"][0] == RATE
    assert file["joint_pos"].dtype == (np.float64 if exact else np.float32)
    joints, speeds = file["joint_pos"], file["joint_vel"]
    by_hand = bodies(links)
    if exact:
        assert np.array_equal(joints[:, :3], P) and np.array_equal(joints[:, 3:7], Q)
        np.testing.assert_allclose(speeds[:, :3], by_hand["v"][:, 0], atol=1e-7)
        np.testing.assert_allclose(speeds[:, 3:6], by_hand["w"][:, 0], atol=1e-7)
        assert file["joint_names"].tolist() == list(DEPTH_FIRST)
        assert file["body_names"].tolist() == list(links)
        joints, speeds = joints[:, 7:], speeds[:, 6:]
    assert np.array_equal(joints, JOINTS[:, order].astype(joints.dtype))
    expected = np.gradient(JOINTS[:, order], 1 / RATE, axis=0)
    np.testing.assert_allclose(speeds, expected, atol=10 * tolerance)
    np.testing.assert_allclose(file["body_pos_w"], by_hand["p"], atol=tolerance)
    assert same_turns(file["body_quat_w"], by_hand["Q"], tolerance)
    np.testing.assert_allclose(file["body_lin_vel_w"], by_hand["v"], atol=5e-6)
    np.testing.assert_allclose(file["body_ang_vel_w"], by_hand["w"], atol=5e-6)


def test_gmr_is_written(tmp_path: Path, robot):
    write_motions(tmp_path / "a.pkl", [motion()], "gmr-pkl", robot)
    held = pickle.loads((tmp_path / "a.pkl").read_bytes())
    assert held["fps"] == 40 and np.array_equal(held["root_pos"], P)
    assert np.array_equal(held["root_rot"], xyzw(Q))
    assert np.array_equal(held["dof_pos"], JOINTS)
    assert held["link_body_list"] == list(LINKS)
    local = [[link_poses(q)[link][0] for link in LINKS] for q in JOINTS]
    np.testing.assert_allclose(held["local_body_pos"], local, atol=1e-6)
    write_motions(tmp_path / "a.pkl", [motion()], "gmr-pkl")
    held = pickle.loads((tmp_path / "a.pkl").read_bytes())
    assert held["local_body_pos"] is None and held["link_body_list"] is None


def test_motion_lib_is_written(tmp_path: Path, robot):
    clips = (motion(clip="a"), motion(clip="b", joint_positions=-JOINTS))
    write_motions(tmp_path / "a.pkl", clips, "motion-lib-pkl", robot)
    held = pickle.loads((tmp_path / "a.pkl").read_bytes())
    assert list(held) == ["a", "b"]
    single = held["b"]
    assert single["fps"] == 40 and single["dof"].dtype == np.float32
    assert np.array_equal(single["root_trans_offset"], P.astype(np.float32))
    assert np.array_equal(single["root_rot"], xyzw(Q).astype(np.float32))
    assert np.array_equal(single["dof"], -JOINTS.astype(np.float32))
    root = Rotation.from_quat(xyzw(Q)).as_rotvec()
    np.testing.assert_allclose(single["pose_aa"][:, 0], root, atol=1e-6)
    axes = np.array([[1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    turns = axes * -JOINTS[:, :, None]
    np.testing.assert_allclose(single["pose_aa"][:, 1:], turns, atol=1e-6)


# --- written by the test, and read ------------------------------------------------


def test_csv_is_read_and_its_order_guessed(tmp_path: Path):
    for order, columns in (("wxyz", Q), ("xyzw", xyzw(Q))):
        np.savetxt(tmp_path / "a.csv", np.hstack([P, columns, JOINTS]), delimiter=",")
        read = read_motion(tmp_path / "a.csv")
        assert read.layout == f"{order}-csv" and read.rate == 30.0
        assert np.array_equal(read.root_quaternions, Q)
        assert np.array_equal(read.joint_positions, JOINTS)
        assert any(
            guess.startswith(f"quaternions are {order}") for guess in read.guesses
        )
        assert any("30 Hz" in guess for guess in read.guesses)
        said = read_motion(tmp_path / "a.csv", layout=f"{order}-csv", rate=25.0)
        assert said.guesses == () and said.rate == 25.0


def test_an_order_that_nothing_tells_is_not_guessed(tmp_path: Path):
    lying = np.tile([0.5, 0.5, 0.5, 0.5], (12, 1))
    np.savetxt(tmp_path / "a.csv", np.hstack([P, lying, JOINTS]), delimiter=",")
    told = "--layout xyzw-csv or wxyz-csv, if the first 7 of its 12 columns"
    with pytest.raises(MotionError, match=told):
        read_motion(tmp_path / "a.csv")
    # Upright either way: 0 0 0 1 looks along +x, or along -x.
    ahead = np.tile([0.0, 0.0, 0.0, 1.0], (12, 1))
    np.savetxt(tmp_path / "a.csv", np.hstack([P, ahead, JOINTS]), delimiter=",")
    read = read_motion(tmp_path / "a.csv")
    assert read.layout == "xyzw-csv" and "NOT sure" in read.guesses[0]


@pytest.mark.parametrize("breadth_first", [True, False])
def test_npz_without_names_is_read(tmp_path: Path, robot, breadth_first: bool):
    links = BREADTH_LINKS if breadth_first else LINKS
    by_hand = bodies(links)
    np.savez(
        tmp_path / "a.npz",
        fps=np.array([50]),
        joint_pos=JOINTS[:, ORDER] if breadth_first else JOINTS,
        joint_vel=np.zeros_like(JOINTS),
        body_pos_w=by_hand["p"],
        body_quat_w=by_hand["Q"],
        body_lin_vel_w=by_hand["v"],
        body_ang_vel_w=by_hand["w"],
    )
    layout = "beyondmimic-npz" if breadth_first else "mjlab-npz"
    read = read_motion(tmp_path / "a.npz", robot=robot)
    assert read.layout == layout and read.rate == 50.0
    assert read.joint_names == DEPTH_FIRST
    assert np.array_equal(read.joint_positions, JOINTS)
    np.testing.assert_allclose(read.root_positions, P, atol=1e-12)
    assert same_turns(read.root_quaternions, Q, 1e-12)


def test_an_order_that_cannot_be_guessed_is_told_whatever_else_is_doubted(
    tmp_path: Path,
):
    by_hand = bodies(LINKS)
    by_hand["p"][:, 1:4] = P[:, None] + [[0.0], [1.0], [2.0]]  # two of four hang on
    by_hand["p"][:, 4:] = P[:, None] * [[2.0], [-3.0]]
    np.savez(
        tmp_path / "a.npz",
        fps=50.0,
        joint_pos=np.degrees(JOINTS) + 10.0,
        joint_vel=np.zeros_like(JOINTS),
        body_pos_w=by_hand["p"],
        body_quat_w=by_hand["Q"],
    )
    sentence = r"cannot be guessed \(50 % of the links .*; say it with --layout mjlab"
    with pytest.raises(MotionError, match=sentence):
        read_motion(tmp_path / "a.npz")


def test_npz_with_the_root_and_names_is_read(tmp_path: Path):
    names = np.array(DEPTH_FIRST)
    np.savez(
        tmp_path / "a.npz",
        fps=50.0,
        joint_pos=np.hstack([P, Q, JOINTS]),
        joint_vel=np.zeros((len(P), 11)),
        joint_names=names,
        object_pos=np.ones((len(P), 3)),
    )
    read = read_motion(tmp_path / "a.npz")
    assert read.layout == "holosoma-npz" and read.joint_names == DEPTH_FIRST
    assert np.array_equal(read.joint_positions, JOINTS)
    assert np.array_equal(read.root_quaternions, Q)
    assert list(read.extras) == ["object_pos"] and not read.guesses


def test_a_pickle_whose_quaternions_are_wxyz_is_told(tmp_path: Path):
    held = dict(fps=120, root_pos=P, root_rot=Q, dof_pos=JOINTS)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
    read = read_motion(tmp_path / "a.pkl")
    assert np.array_equal(read.root_quaternions, Q)
    assert "root_rot is wxyz, not xyzw as gmr-pkl has it: sure" in read.guesses[0]
    said = read_motion(tmp_path / "a.pkl", layout="gmr-pkl")
    assert np.array_equal(said.root_quaternions, Q[:, [3, 0, 1, 2]])
    # What is upright either way, or in neither, is as the layout has it.
    for quaternion in ([0.0, 0.0, 0.0, 1.0], [0.5, 0.5, 0.5, 0.5]):
        held["root_rot"] = np.tile(quaternion, (len(P), 1))
        (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
        read = read_motion(tmp_path / "a.pkl")
        assert np.array_equal(xyzw(read.root_quaternions), held["root_rot"])
        assert not read.guesses


def test_clips_of_motion_lib_are_read(tmp_path: Path):
    clip = dict(root_trans_offset=P, dof=JOINTS, root_rot=xyzw(Q), fps=30)
    clip["pose_aa"] = np.zeros((len(P), 6, 3))
    other = clip | {"dof": 2 * JOINTS, "contact_mask": np.ones((len(P), 2))}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"one": clip, "two": other}))
    one, two = read_motions(tmp_path / "a.pkl")
    assert (one.clip, two.clip) == ("one", "two")
    assert np.array_equal(two.joint_positions, 2 * JOINTS)
    assert list(two.extras) == ["contact_mask"]
    named = read_motion(tmp_path / "a.pkl", clip="two")
    assert np.array_equal(named.joint_positions, 2 * JOINTS)
    with pytest.raises(MotionError, match="holds 2 motions"):
        read_motion(tmp_path / "a.pkl")
    with pytest.raises(MotionError, match="did you mean 'two'"):
        read_motion(tmp_path / "a.pkl", clip="twoo")


# --- round trips ------------------------------------------------------------------


@pytest.mark.parametrize("layout", WRITTEN)
def test_a_file_that_was_read_is_written_as_it_was(tmp_path: Path, robot, layout: str):
    suffix = LAYOUTS[layout].suffix
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    write_motions(first, [motion(clip="x")], layout, robot)
    for reading in ({"robot": robot}, {"layout": layout}):
        # A table is sure of its order, or its height, only where it is told.
        if layout.endswith(("csv", "npy")):
            reading["layout"] = layout
        read = read_motion(first, **reading)
        assert read.is_as_read and read.layout == layout
        write_motions(second, [read], layout, reading.get("robot"))
        if suffix != ".pkl":
            assert first.read_bytes() == second.read_bytes()
            continue
        # Pickles differ where Python has the same text once or twice.
        one, two = (pickle.loads(file.read_bytes()) for file in (first, second))
        assert repr(one) == repr(two) and list(one) == list(two)
        one, two = one.get("x", one), two.get("x", two)
        for key, value in one.items():
            if isinstance(value, np.ndarray):
                assert value.dtype == two[key].dtype
                assert np.array_equal(value, two[key])


@pytest.mark.parametrize("layout", sorted(set(WRITTEN) - {"named-csv", "mimickit-pkl"}))
def test_no_layout_loses_a_number(tmp_path: Path, robot, layout: str):
    """Numbers that have 32 bits come back from every layout as they were."""
    p, Q32, q = (x.astype(np.float32).astype(float) for x in (P, Q, JOINTS))
    given = RobotMotion(DEPTH_FIRST, p, Q32, q, 30.0)
    file = tmp_path / f"a{LAYOUTS[layout].suffix}"
    write_motions(file, [given], layout, robot)
    read = read_motion(file, layout=layout, rate=30.0, robot=robot)
    assert read.joint_names == DEPTH_FIRST and read.rate == 30.0
    assert np.array_equal(read.root_positions, p)
    assert np.array_equal(read.root_quaternions, Q32)
    assert np.array_equal(read.joint_positions, q)


def test_what_follows_from_a_motion_is_not_kept_when_it_changes(tmp_path: Path, robot):
    write_motions(tmp_path / "a.npz", [motion()], "mjlab-npz", robot)
    read = read_motion(tmp_path / "a.npz", robot=robot)
    changed = replace(read, joint_positions=read.joint_positions + 0.1)
    assert not changed.is_as_read
    write_motions(tmp_path / "b.npz", [changed], "mjlab-npz", robot)
    a, b = np.load(tmp_path / "a.npz"), np.load(tmp_path / "b.npz")
    assert np.abs(a["body_pos_w"] - b["body_pos_w"]).max() > 0.01
    with pytest.raises(MotionError, match="--robot"):
        write_motions(tmp_path / "c.npz", [changed], "mjlab-npz")
    assert not (tmp_path / "c.npz").exists()


def test_orders_are_not_mixed_without_a_robot(tmp_path: Path, robot):
    write_motions(tmp_path / "a.npz", [motion()], "beyondmimic-npz", robot)
    read = read_motion(tmp_path / "a.npz", layout="beyondmimic-npz")
    with pytest.raises(MotionError, match="another order in xyzw-csv"):
        write_motions(tmp_path / "a.csv", [read], "xyzw-csv")


def test_the_guide_has_the_table(repository: Path = Path(__file__).parents[2]):
    guide = (repository / "docs/guides/reference-motions.md").read_text()
    rows = [line for line in guide.splitlines() if line.startswith("| `")]
    for layout in LAYOUTS.values():
        (row,) = (line for line in rows if f"`{layout.name}`" in line.split("|")[1])
        for key in {*layout.keys, *layout.needed, layout.velocities} - {""}:
            shown = key.removesuffix("Y").removesuffix("Z")
            assert f"`{key}`" in row or shown in row, (layout.name, key)


# --- refused ----------------------------------------------------------------------


def table() -> np.ndarray:
    return np.hstack([P, Q, JOINTS])


def spoiled(row: int, column: int, value: float) -> np.ndarray:
    changed = table()
    changed[row, column] = value
    return changed


def test_bad_csv_files(tmp_path: Path, robot):
    file = tmp_path / "a.csv"

    def refused(match: str, rows: np.ndarray | str, **options) -> None:
        if isinstance(rows, str):
            file.write_text(rows)
        else:
            np.savetxt(file, rows, delimiter=",")
        with pytest.raises(MotionError, match=match):
            read_motion(file, **options)

    refused("the file is empty", "")
    refused("the file is empty", "\n \n")
    refused("frame 3, column 9: nan", spoiled(2, 8, np.nan))
    refused("frame 4, column 1: inf", spoiled(3, 0, np.inf))
    zero = table()
    zero[5, 3:7] = 0.0
    refused("frame 6: the root's quaternion .* length zero", zero)
    refused("length 2.01, and is no rotation", spoiled(0, 3, 2.0), layout="wxyz-csv")
    refused(r"line 2: 3 columns, but 12", "1,2,3,1,0,0,0,1,2,3,4,5\n1,2,3\n")
    refused("line 1: 'x' is no number .*heading", "x,y,z\n1,2,3\n")
    refused("line 2: '1.5e' is no number", "1,2,3,1,0,0,0,1\n1,2,3,1,0,0,0,1.5e\n")
    refused("7 columns; a robot's motion has", "1,2,3,1,0,0,0\n")
    refused("there are 2 joint names but 5", table(), joint_names=["a", "b"])
    refused("'a' is there more than once", table(), joint_names=list("aabcd"))
    refused(
        r"11 columns, 7 of the root and 4 joints; robot biped has 5 joints.*"
        r"xyzw-csv \(12 columns\).*mjlab-npz \(5 columns of joint_pos\)",
        table()[:, :-1],
        robot=robot,
    )
    refused(
        "robot biped has 5 joints. If .* --whole-body",
        np.hstack([table(), JOINTS]),
        robot=robot,
    )
    refused("there is no layout 'xyzw'", table(), layout="xyzw")
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MotionError, match="line 1: .* is no number"):
        read_motion(file)
    with pytest.raises(MotionError, match="no such file"):
        read_motion(tmp_path / "b.csv")
    with pytest.raises(MotionError, match="this is a folder"):
        read_motion(tmp_path)
    (tmp_path / "a.bvh").write_text("x")
    with pytest.raises(MotionError, match=r"\.csv, \.npy, \.npz, \.pkl"):
        read_motion(tmp_path / "a.bvh")


def test_bad_npz_files(tmp_path: Path, robot):
    file = tmp_path / "a.npz"
    good = dict(fps=[50], joint_pos=table(), joint_names=np.array(DEPTH_FIRST))

    def refused(match: str, **changes) -> None:
        arrays = {k: v for k, v in (good | changes).items() if v is not None}
        np.savez(file, **arrays)
        with pytest.raises(MotionError, match=match):
            read_motion(file, robot=robot)

    refused("has no joint_pos", joint_pos=None)
    refused("holds objects", joint_pos=np.array([None, 1]))
    refused(
        "12 columns, but there are 3 joint names", joint_names=np.array(list("abc"))
    )
    doubled = [*DEPTH_FIRST[:4], "left_hip"]
    refused("'left_hip' is there more than once", joint_names=np.array(doubled))
    others = [*DEPTH_FIRST[:4], "tail"]
    refused("another robot: it lacks waist; it has tail", joint_names=np.array(others))
    refused("frame 3, column 2 is nan", joint_pos=spoiled(2, 8, np.nan))
    refused("the rate is 0", fps=[0])
    refused("the rate is 1e.09 Hz; .* at most 100000 Hz", fps=[1e9])
    refused("not one number", fps=[30, 40])
    refused(r"has no body_pos_w", joint_names=None, joint_pos=JOINTS)
    np.savez(file, **good)
    data = file.read_bytes()
    for end in (10, len(data) // 2, len(data) - 5):
        file.write_bytes(data[:end])
        with pytest.raises(MotionError, match="damaged"):
            read_motion(file)


def test_another_robots_links_are_noticed(tmp_path: Path, robot):
    by_hand = bodies(LINKS)
    by_hand["p"][:, 2] += 0.1
    np.savez(
        tmp_path / "a.npz",
        fps=[50],
        joint_pos=JOINTS,
        body_pos_w=by_hand["p"],
        body_quat_w=by_hand["Q"],
    )
    with pytest.raises(MotionError, match="173 mm from where .* of another robot"):
        read_motion(tmp_path / "a.npz", layout="mjlab-npz", robot=robot)


def test_bad_pickles(tmp_path: Path):
    file = tmp_path / "a.pkl"
    good = dict(fps=30, root_pos=P, root_rot=xyzw(Q), dof_pos=JOINTS)

    def refused(match: str, held: object) -> None:
        file.write_bytes(pickle.dumps(held))
        with pytest.raises(MotionError, match=match):
            read_motion(file)

    refused("holds no dict", [1, 2])
    refused("it is no motion: GMR's has root_pos", {"a": 1})
    refused("root_pos is an array", good | {"root_pos": P[:, :2]})
    refused("numbers of frames differ", good | {"dof_pos": JOINTS[:-1]})
    refused("frame 1: root_rot has length zero", good | {"root_rot": 0 * Q})
    refused("dof_pos is an array", good | {"dof_pos": [[1, 2], [3]]})
    refused("fps is fast", good | {"fps": "fast"})
    refused("is nan", good | {"dof_pos": JOINTS * np.nan})
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(good))
    with pytest.raises(MotionError, match="keys are those of gmr-pkl"):
        read_motion(file, layout="motion-lib-pkl")


@pytest.mark.parametrize("blank", [";", " ", "\t", "; "])
def test_other_separators_than_commas_are_read(tmp_path, blank):
    from crar_drake.motion.robots_own import holds_reference

    row = ["0.1", "0", "0.8", "0", "0", "0.1", "0.99498743710662", "0.5"]
    (tmp_path / "a.csv").write_text((blank.join(row) + "\n") * 3)
    assert holds_reference(tmp_path / "a.csv")
    motion = read_motion(tmp_path / "a.csv", "xyzw-csv")
    assert motion.joint_positions.tolist() == [[0.5]] * 3


def test_comments_and_encodings_of_a_csv(tmp_path):
    from crar_drake.motion.robots_own import holds_reference

    row = "0.1,0,0.8,0,0,0.1,0.99498743710662,0.5\n"
    text = f"# x, y, z, ...\n\n{row}{row}# the end\n"
    for encoding in ("utf-8", "utf-8-sig", "utf-16", "latin-1"):
        (tmp_path / "a.csv").write_bytes(text.encode(encoding))
        assert holds_reference(tmp_path / "a.csv")
        assert read_motion(tmp_path / "a.csv", "xyzw-csv").num_frames == 2


@pytest.mark.parametrize(
    "columns, factor, told",
    [
        (slice(7, None), np.degrees(1.0), "rad: are these degrees"),
        (slice(0, 3), 1000.0, "m: are these centimetres or mm"),
        (slice(0, 0), 1.0, ""),
    ],
)
def test_units_that_no_robot_has_are_doubted(tmp_path, columns, factor, told):
    rows = np.tile([0.1, 0.0, 0.8, 0.0, 0.0, 0.1, 0.995, 0.5, -1.5], (3, 1))
    rows[:, columns] *= factor
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    motion = read_motion(tmp_path / "a.csv")
    doubts = [guess for guess in motion.guesses if guess.startswith("units")]
    assert len(doubts) == bool(told) and told in "".join(doubts)
    assert motion.is_as_read


@pytest.mark.parametrize(
    "fps, rate, told",
    [
        (1.0 / 30.0, 30.0, "the time between frames in seconds"),
        (0.02, 50.0, "the time between frames in seconds"),
        (30, 30.0, ""),
        (3.0, 3.0, "no camera's"),
        (12000, 12000.0, "no camera's"),
    ],
)
def test_rates_that_no_motion_has(tmp_path, fps, rate, told):
    held = dict(fps=fps, root_pos=P, root_rot=xyzw(Q), dof_pos=JOINTS)
    held |= dict(local_body_pos=None, link_body_list=None)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
    names = np.array(DEPTH_FIRST)
    np.savez(
        tmp_path / "a.npz", joint_pos=np.hstack([P, Q, JOINTS]), fps=fps,
        joint_names=names, body_pos_w=np.zeros((len(P), 6, 3)),
        body_quat_w=np.tile([1.0, 0, 0, 0], (len(P), 6, 1)),
    )  # fmt: skip
    for name in ("a.pkl", "a.npz"):
        read = read_motion(tmp_path / name)
        assert read.rate == rate and read.is_as_read
        assert any(told in guess for guess in read.guesses) or not told
        # Whoever says a rate is believed.
        assert read_motion(tmp_path / name, rate=0.5).rate == 0.5


def test_a_rate_that_means_nothing_is_refused(tmp_path):
    held = dict(fps=0.7, root_pos=P, root_rot=xyzw(Q), dof_pos=JOINTS)
    held |= dict(local_body_pos=None, link_body_list=None)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
    with pytest.raises(MotionError, match=r"a.pkl.* rate of 0.7 Hz .*--frame-rate HZ"):
        read_motion(tmp_path / "a.pkl")
