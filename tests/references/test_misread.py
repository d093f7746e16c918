"""No file is taken for what it is not: each layout, and each with what is easily taken
for it, is read right or refused."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_humanoid import crouching, humanoid

from crar_drake.errors import MotionError
from crar_drake.references.layouts import LAYOUTS
from crar_drake.references.motion_files import read_motion, read_motions, write_motions
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody

LOCKED = ("waist_roll", "waist_pitch", "wrist_pitch", "wrist_yaw")
SEES_LINKS = (
    *("beyondmimic-npz", "mjlab-npz", "holosoma-npz"),
    *("gmr-pkl", "motion-lib-pkl"),
)


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> WholeBody:
    return humanoid(tmp_path_factory.mktemp("humanoid"))


def motion(robot: WholeBody, **changes) -> RobotMotion:
    p, Q, q = crouching(robot)
    return replace(RobotMotion(robot.joint_names, p, Q, q, 30.0), **changes)


# --- files as dicts of arrays, read and written without what is tested ------------


class File:
    """A file's arrays by key; columns of a CSV stand in one table."""

    def __init__(self, path: Path) -> None:
        self.path, self.clip = path, None
        if path.suffix == ".csv":
            first, *rest = path.read_text().splitlines()
            self.heading = first.split(",") if first[0].isalpha() else None
            rows = rest if self.heading else [first, *rest]
            self.held = {"": np.array([list(map(float, r.split(","))) for r in rows])}
        elif path.suffix == ".pkl":
            self.held = pickle.loads(path.read_bytes())
            if isinstance(next(iter(self.held.values())), dict):
                ((self.clip, self.held),) = self.held.items()
        else:
            held = np.load(path, allow_pickle=True)
            self.held = dict(held) if path.suffix == ".npz" else {"": held}
            if path.suffix == ".npy" and held.dtype == object:
                self.held = held.item()

    def write(self) -> None:
        held = self.held
        if self.path.suffix == ".csv":
            head = ",".join(self.heading) if self.heading else ""
            np.savetxt(self.path, held[""], delimiter=",", header=head, comments="")
        elif self.path.suffix == ".pkl":
            clips = held if self.clip is None else {self.clip: held}
            self.path.write_bytes(pickle.dumps(clips))
        elif self.path.suffix == ".npz":
            np.savez(self.path, **held)
        else:
            np.save(self.path, held.get("", held), allow_pickle=True)


# Where layouts have the root and joints: key and columns, in the words of the guide.
ONE = {"position": slice(0, 3), "rotation": slice(3, 7), "joints": slice(7, None)}
BODY = {"position": "body_pos_w", "rotation": "body_quat_w", "joints": "joint_pos"}
GMR = {"position": "root_pos", "rotation": "root_rot", "joints": "dof_pos"}
PLACES = {
    **{f"{order}-{kind}": ("", ONE) for order in ("xyzw", "wxyz")
       for kind in ("csv", "npy")},
    "amass-npy": ("", ONE),
    "named-csv": ("", {"position": slice(1, 4), "rotation": slice(4, 7),
                       "joints": slice(7, None)}),
    "joints-csv": ("", {"position": slice(1, 4), "rotation": slice(4, 8),
                        "joints": slice(8, None)}),
    "beyondmimic-npz": BODY,
    "mjlab-npz": BODY,
    "holosoma-npz": ("joint_pos", ONE),
    "amp-npz": {"position": "body_positions", "rotation": "body_rotations",
                "joints": "dof_positions"},
    "locomujoco-npz": ("qpos", ONE),
    "qpos-npz": ("qpos", ONE),
    "omniretarget-npz": ("qpos", ONE | {"position": slice(4, 7),
                                        "rotation": slice(0, 4)}),
    "phuma-npy": {"position": "root_trans", "rotation": "root_ori",
                  "joints": "dof_pos"},
    "gmr-pkl": GMR,
    "motion-lib-pkl": {"position": "root_trans_offset", "rotation": "root_rot",
                       "joints": "dof"},
    "mimickit-pkl": ("frames", {"position": slice(0, 3), "rotation": slice(3, 6),
                                "joints": slice(6, None)}),
}  # fmt: skip
ANGLES = {"named-csv": "euler", "mimickit-pkl": "vector"}
XYZW = {"xyzw-csv", "xyzw-npy", "amass-npy", "phuma-npy", "gmr-pkl", "motion-lib-pkl"}


def change(file: File, layout: str, what: str, how) -> None:
    """Changes position, rotation or joints where they stand."""
    place = PLACES[layout]
    if isinstance(place, dict):
        key, columns = place[what], slice(None)
    else:
        key, columns = place[0], place[1][what]
    values = np.array(file.held[key])
    rows = values.reshape(-1, values.shape[-1])
    made = how(rows[:, columns])
    if made.shape[1] == rows[:, columns].shape[1]:
        rows[:, columns] = made
    else:
        rows = np.hstack([rows[:, : columns.start or 0], made])
    file.held[key] = rows.reshape(*values.shape[:-1], rows.shape[1])


def unnamed(file: File, layout: str) -> None:
    """Takes names away where others write none."""
    if layout not in ("amp-npz", "locomujoco-npz"):
        for key in ("joint_names", "dof_names", "body_names"):
            file.held.pop(key, None)


Y_UP = Rotation.from_euler("x", -90.0, degrees=True)


def tilted(rotations: np.ndarray, layout: str) -> np.ndarray:
    """The root's rotations in a world whose y points up, as a layout has them."""
    if layout == "named-csv":
        R = Y_UP * Rotation.from_euler("xyz", rotations, degrees=True)
        return R.as_euler("xyz", degrees=True)
    if layout == "mimickit-pkl":
        return (Y_UP * Rotation.from_rotvec(rotations)).as_rotvec()
    roll = 0 if layout in XYZW else 1
    R = Y_UP * Rotation.from_quat(np.roll(rotations, -roll, axis=1))
    return np.roll(R.as_quat(), roll, axis=1)


def misread(kind: str, file: File, layout: str, robot: WholeBody) -> bool:
    """Writes what is easily taken for a layout; whether there is such a thing."""
    metre = 0.01 if layout == "named-csv" else 1.0
    one_array = PLACES[layout][0] if isinstance(PLACES[layout], tuple) else None
    heading = layout in ("named-csv", "joints-csv")
    breadth = [robot.joint_names.index(name) for name in robot.breadth_first]
    orders = {True: list(np.argsort(breadth)), False: breadth}
    if kind in ("metres", "centimetres", "millimetres"):
        unit = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}[kind]
        change(file, layout, "position", lambda p: p * metre / unit)
        return unit != metre
    if kind == "radians for degrees, or degrees":
        how = np.radians if layout == "named-csv" else np.degrees
        change(file, layout, "joints", how)
    elif kind == "the quaternion's other order":
        if layout in ANGLES:
            return False
        roll = 1 if layout in XYZW else -1
        change(file, layout, "rotation", lambda Q: np.roll(Q, roll, axis=1))
    elif kind == "the joints' other order":
        if heading or layout in ("amp-npz", "locomujoco-npz"):
            return False
        order = orders[LAYOUTS[layout].breadth_first]
        change(file, layout, "joints", lambda q: q[:, order])
    elif kind == "y up":
        change(file, layout, "position", Y_UP.apply)
        change(file, layout, "rotation", lambda Q: tilted(Q, layout))
    elif kind in ("root last", "rotation first"):
        if one_array is None or heading:
            return False
        rows, root = file.held[one_array], 6 if layout == "mimickit-pkl" else 7
        first = 3 if PLACES[layout][1]["position"].start == 0 else 4
        swapped = [*range(first, root), *range(first), *range(root, rows.shape[1])]
        last = [*range(root, rows.shape[1]), *range(root)]
        file.held[one_array] = rows[:, last if kind == "root last" else swapped]
    elif kind == "float32":
        for key, values in file.held.items():
            if isinstance(values, np.ndarray) and values.dtype == float:
                file.held[key] = values.astype(np.float32)
    else:
        return without_six(file, layout, robot)
    return True


def without_six(file: File, layout: str, robot: WholeBody) -> bool:
    """The version of 23 joints, of which the motion has the six others at 0."""
    if layout in ("named-csv", "joints-csv", "amp-npz", "locomujoco-npz"):
        return False
    locked = [name for name in robot.joint_names if any(x in name for x in LOCKED)]
    of = LAYOUTS[layout]
    names = robot.breadth_first if of.breadth_first else robot.joint_names
    fewer = robot.order_without(locked, of.breadth_first)
    kept = [names.index(name) for name in fewer]
    change(file, layout, "joints", lambda q: q[:, kept])
    links = robot.links_of(names)
    rows = [links.index(link) for link in robot.links_of(fewer)]
    for key in of.links[1:]:
        file.held[key] = file.held[key][:, rows]
    if of.velocities:
        before = 6 if of.root_columns else 0
        columns = [*range(before), *(before + k for k in kept)]
        file.held[of.velocities] = file.held[of.velocities][:, columns]
    if "pose_aa" in file.held:
        file.held["pose_aa"] = file.held["pose_aa"][:, [0, *(1 + k for k in kept)]]
    return True


KINDS = (
    *("metres", "centimetres", "millimetres", "radians for degrees, or degrees"),
    *("the quaternion's other order", "the joints' other order", "y up", "root last"),
    *("rotation first", "float32", "23 joints"),
)
# What is read though it is not as the layout has it: evidence is sure, or it is exact.
READ = {
    "float32": set(LAYOUTS),
    "23 joints": set(SEES_LINKS),
    "the joints' other order": {"gmr-pkl"},  # by its links, which have names
    "rotation first": {"qpos-npz", "omniretarget-npz"},
    "the quaternion's other order": set(LAYOUTS) - {"amass-npy"},
}


def same(read: RobotMotion, given: RobotMotion) -> bool:
    turned = np.abs(np.sum(read.root_quaternions * given.root_quaternions, axis=1))
    return (
        read.joint_names == given.joint_names
        and np.abs(read.joint_positions - given.joint_positions).max() < 1e-5
        and np.abs(read.root_positions - given.root_positions).max() < 1e-5
        and np.abs(turned - 1.0).max() < 1e-6
    )


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_written_is_read_without_its_certificate(
    layout: str, robot: WholeBody, tmp_path: Path
):
    path, given = tmp_path / f"a{LAYOUTS[layout].suffix}", motion(robot)
    write_motions(path, [given], layout, robot)
    room = LAYOUTS[layout].names or layout in ("named-csv", "joints-csv")
    assert bool(read_motion(path).joint_names) == bool(room)
    assert same(read_motion(path, robot=robot), given)
    file = File(path)
    unnamed(file, layout)
    file.write()
    read = read_motion(path, robot=robot)
    assert same(read, given)
    # What tells them apart is said, unless names stand in the file.
    assert read.guesses or layout in ("joints-csv", "amp-npz", "locomujoco-npz")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_near_relatives(layout: str, kind: str, robot: WholeBody, tmp_path: Path):
    path, given = tmp_path / f"a{LAYOUTS[layout].suffix}", motion(robot)
    write_motions(path, [given], layout, robot)
    file = File(path)
    unnamed(file, layout)
    if not misread(kind, file, layout, robot):
        return
    file.write()
    if layout in READ.get(kind, ()):
        assert same(read_motions(path, robot=robot)[0], given)
        return
    with pytest.raises(MotionError, match=r"a\.(csv|np|pkl)"):
        read_motions(path, robot=robot)


# --- what nothing in a file tells -------------------------------------------------


def crouch_csv(path: Path, robot: WholeBody, columns: list[int]) -> Path:
    p, Q, q = crouching(robot)
    rows = np.hstack([p, np.roll(Q, -1, axis=1), q[:, columns]])
    np.savetxt(path, rows, delimiter=",")
    return path


def test_two_versions_of_a_robot_that_fit_alike_are_both_named(robot, tmp_path: Path):
    names = robot.joint_names
    kept = [k for k, name in enumerate(names) if not any(x in name for x in LOCKED)]
    path = crouch_csv(tmp_path / "a.csv", robot, kept)
    both = r"23 joints may be .* 14 .* waist_roll_joint.* 14 .* left_shoulder_pitch"
    with pytest.raises(MotionError, match=both):
        read_motion(path, robot=robot)
    # Who names them is believed, and so are limits: a wrist does not bend so far.
    named = read_motion(path, joint_names=[names[k] for k in kept], robot=robot)
    assert same(named, motion(robot)) and "6 of waist and wrists" in str(named.guesses)
    rows = np.loadtxt(path, delimiter=",")
    rows[:, 7 + 13] += 1.5  # the left shoulder's pitch, or the waist's roll
    np.savetxt(path, rows, delimiter=",")
    read = read_motion(path, robot=robot)
    assert np.abs(read.joint_positions[:, names.index("waist_roll_joint")]).max() == 0.0


def test_an_order_that_evidence_doubts_is_refused(robot, tmp_path: Path):
    """A file is meant to have w first; with w last it walks forwards."""
    p, Q, q = crouching(robot)
    still, ahead = np.tile([1.0, 0.0, 0.0, 0.0], (len(p), 1)), p * [20.0, 1.0, 1.0]
    for positions, doubted in ((ahead, True), (p, False)):
        qpos = np.hstack([positions, np.roll(still, -1, axis=1), q])
        np.savez(tmp_path / "a.npz", fps=30, qpos=qpos)
        if doubted:
            with pytest.raises(MotionError, match="may be wxyz, .* or xyzw"):
                read_motion(tmp_path / "a.npz", robot=robot)
        said = read_motion(tmp_path / "a.npz", layout="qpos-npz", robot=robot)
        assert np.array_equal(said.root_quaternions, qpos[:, 3:7])


def test_joints_far_beyond_their_limits_are_another_robots(robot, tmp_path: Path):
    """With as many joints, arms first: shoulders that hang down are knees."""
    p, Q, q = crouching(robot)
    legs_last = np.hstack([q[:, 12:], q[:, :12]])
    legs_last[:, [3, 10]] = -1.3, 1.3
    legs_last[:, 4] = 1.4
    rows = np.hstack([p, np.roll(Q, -1, axis=1), legs_last])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    with pytest.raises(MotionError, match=r"a\.csv: .* (limits|soles)"):
        read_motion(tmp_path / "a.csv", robot=robot)


def test_a_manifest_names_columns_and_rate(robot, tmp_path: Path):
    """any4hdmi's, beside the folder of motions; columns are in any order."""
    p, Q, q = crouching(robot)
    root = [f"root_t{x}" for x in "xyz"] + [f"root_q{x}" for x in "wxyz"]
    turned = [3, 4, 5, 6, 0, 1, 2]
    names = [*(root[k] for k in turned), *robot.joint_names[::-1]]
    said = {"qpos_names": names, "timestep": 1.0 / 30.0}
    (tmp_path / "manifest.json").write_text(json.dumps(said))
    path = tmp_path / "motions" / "a.npz"
    path.parent.mkdir()
    np.savez(path, qpos=np.hstack([np.hstack([p, Q])[:, turned], q[:, ::-1]]))
    read = read_motion(path, robot=robot)
    assert same(read, motion(robot)) and read.rate == 30.0
    assert "manifest.json" in read.guesses[0]
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(MotionError, match="manifest.json: is to say qpos_names"):
        read_motion(path, robot=robot)


def test_poses_of_objects_are_no_joints(robot, tmp_path: Path):
    p, Q, q = crouching(robot)
    box = np.hstack([Q[::-1], p + 1.0])
    held = {"fps": 30, "qpos": np.hstack([Q, p, q, box])}
    np.savez(tmp_path / "a.npz", **held)
    read = read_motion(tmp_path / "a.npz", robot=robot)
    assert read.layout == "omniretarget-npz" and same(read, motion(robot))
    assert "poses of objects" in read.guesses[0]
    write_motions(tmp_path / "b.npz", [read], "omniretarget-npz", robot)
    assert np.array_equal(np.load(tmp_path / "b.npz")["qpos"], held["qpos"])


def test_who_lies_is_not_stood_up(robot, tmp_path: Path):
    """On the back all the time, as the floor shows: no order is more upright."""
    _, _, q = crouching(robot)
    p = np.tile([0.0, 0.0, 0.1], (len(q), 1))
    turn = Rotation.from_euler("y", -90.0, degrees=True).as_quat()
    rows = np.hstack([p, np.tile(turn, (len(q), 1)), 0.0 * q])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    with pytest.raises(MotionError, match="--layout xyzw-csv or wxyz-csv"):
        read_motion(tmp_path / "a.csv", robot=robot)
    read = read_motion(tmp_path / "a.csv", layout="xyzw-csv", robot=robot)
    assert np.array_equal(read.root_quaternions[:, 0], rows[:, 6])


def test_a_root_in_millimetres_is_refused(robot, tmp_path: Path):
    p, Q, q = crouching(robot)
    rows = np.hstack([1000.0 * p, np.roll(Q, -1, axis=1), q])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",")
    for layout in (None, "xyzw-csv"):
        with pytest.raises(
            MotionError, match="with positions in millimetres it stands"
        ):
            read_motion(tmp_path / "a.csv", layout=layout, robot=robot)
