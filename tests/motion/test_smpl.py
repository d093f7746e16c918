"""Motions of SMPL's body models, against a BVH of the same body and the same turns."""

import pickle
from collections import defaultdict

import numpy as np
import pytest
from performed import performed
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.performer import JOINTS
from crar_drake.motion.robots_own import holds_reference
from crar_drake.motion.smpl_skeleton import MEAN_OFFSETS, NAMES, PARENTS

FRAMES, RATE = 40, 60.0
# z up, as AMASS is: the model's y points up, its z where -y does.
Z_UP = Rotation.from_matrix([[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def moving() -> tuple[np.ndarray, np.ndarray]:
    """(T, 22, 3) turns and (T, 3) of the model, y up, of a person who walks."""
    t = np.linspace(0.0, 1.0, FRAMES)[:, None]
    rng = np.random.default_rng(2)
    phases, sizes = rng.uniform(0, 6, (22, 3)), rng.uniform(0.05, 0.3, (22, 3))
    turns = sizes * np.sin(3.0 * t[:, :, None] + phases)
    turns[:, 0] = (
        Rotation.from_euler("y", 0.4 + t) * Rotation.from_euler("x", 0.1)
    ).as_rotvec()
    return turns, np.hstack([0.3 * t, 1.15 + 0.02 * np.sin(9 * t), 0.8 * t])


def bvh_text(turns: np.ndarray, root: np.ndarray, offsets: np.ndarray) -> str:
    lines, order = ["HIERARCHY"], []

    def add(i: int, depth: int) -> None:
        order.append(i)
        pad, x = "  " * depth, offsets[i] if i else np.zeros(3)
        lines.append(f"{pad}{'JOINT' if i else 'ROOT'} {NAMES[i]}")
        lines.append(f"{pad}{{\n{pad}OFFSET {x[0]} {x[1]} {x[2]}")
        where = "" if i else "Xposition Yposition Zposition "
        count = 3 if i else 6
        lines.append(f"{pad}CHANNELS {count} {where}Zrotation Xrotation Yrotation")
        children = [j for j, parent in enumerate(PARENTS) if parent == i]
        for j in children:
            add(j, depth + 1)
        if not children:
            lines.append(f"{pad}End Site\n{pad}{{\n{pad}OFFSET 0 0 0\n{pad}}}")
        lines.append(f"{pad}}}")

    add(0, 0)
    lines += ["MOTION", f"Frames: {len(turns)}", f"Frame Time: {1.0 / RATE:.9f}"]
    for turn, p in zip(turns, root + offsets[0], strict=True):
        angles = Rotation.from_rotvec(turn[order]).as_euler("ZXY", degrees=True)
        lines.append(" ".join(f"{x:.9f}" for x in [*p, *angles.ravel()]))
    return "\n".join(lines) + "\n"


def arrays(z_up: bool = True, columns: int = 156) -> dict[str, np.ndarray]:
    """What AMASS has in a file."""
    turns, root = moving()
    if z_up:
        turns[:, 0] = (Z_UP * Rotation.from_rotvec(turns[:, 0])).as_rotvec()
        root = Z_UP.apply(root)
    poses = np.zeros((FRAMES, columns))
    poses[:, :66] = turns.reshape(FRAMES, 66)
    return dict(poses=poses, trans=root, mocap_framerate=RATE, betas=np.ones(16))


@pytest.mark.parametrize("model", ["SMPL", "SMPL-X"])
@pytest.mark.parametrize("z_up", [True, False])
def test_it_moves_as_a_bvh_of_the_same_body(model, z_up, tmp_path) -> None:
    columns = {"SMPL": 156, "SMPL-X": 165}[model]
    held = arrays(z_up, columns)
    if not z_up:  # which no file of AMASS is
        held["fps"] = held.pop("mocap_framerate")
    np.savez(tmp_path / "a.npz", **held, gender="neutral")
    found = performed(tmp_path / "a.npz")
    text = bvh_text(*moving(), MEAN_OFFSETS[model])
    (tmp_path / "a.bvh").write_text(text)
    ways = {
        f"{side}_{a}: {b}"
        for side in ("left", "right")
        for a, b in (("toe", f"{side}_foot"),)
    }
    (tmp_path / "joints.yaml").write_text("\n".join(sorted(ways)))
    truth = performed(tmp_path / "a.bvh", joints=str(tmp_path / "joints.yaml"))
    assert found.format == model and found.frame_rate == RATE
    assert found.up == ("+z" if z_up else "+y")
    assert set(found.positions) == set(JOINTS) == set(truth.positions)
    shift = found.positions["pelvis"][0] - truth.positions["pelvis"][0]
    for joint in JOINTS:
        moved = truth.positions[joint] + shift
        np.testing.assert_allclose(found.positions[joint], moved, atol=1e-6)
        np.testing.assert_allclose(
            found.orientations[joint], truth.orientations[joint], atol=1e-6
        )
    np.testing.assert_allclose(found.heading, truth.heading, atol=1e-6)
    lowest = np.min([p[:, 2] for p in found.positions.values()], axis=0)
    assert abs(np.quantile(lowest, 0.02)) < 1e-9  # the lowest that the body comes


def test_who_lies_all_the_time_in_amass_is_not_stood_upright(tmp_path) -> None:
    held = arrays(z_up=False)  # with z up, the body lies along y
    np.savez(tmp_path / "a.npz", **held)
    found = performed(tmp_path / "a.npz")
    assert found.up == "+z" and "up +z (of the file)" in map(str, found.facts)
    trunk = found.positions["neck"] - found.positions["pelvis"]
    assert np.abs(trunk[:, 2]).max() < 0.3 < np.linalg.norm(trunk, axis=1).min()


def test_hands_and_what_is_said(tmp_path) -> None:
    """A T-pose, palms down: thumbs point ahead, fingers outwards."""
    still = arrays()
    still["poses"][:] = 0.0
    still["poses"][:, :3] = Z_UP.as_rotvec()
    np.savez(tmp_path / "a.npz", **still)
    performer = performed(tmp_path / "a.npz")
    left, right = (performer.hands[f"{side}_hand"][3] for side in ("left", "right"))
    np.testing.assert_allclose(
        left, np.transpose([[0, 1, 0], [0, 0, 1], [1, 0, 0]]), atol=1e-9
    )
    np.testing.assert_allclose(
        right, np.transpose([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), atol=1e-9
    )
    facts = {fact.what: str(fact) for fact in performer.facts}
    assert "betas are ignored" in facts["lengths"]
    assert performer.facing == "-y"
    assert performer.orientations["left_knee"][0] == pytest.approx(np.eye(3), abs=1e-9)


def test_other_keys_and_what_is_no_number(tmp_path) -> None:
    plain = arrays(columns=165)
    np.savez(tmp_path / "a.npz", **plain)
    expected = performed(tmp_path / "a.npz").positions["left_wrist"]
    parts = dict(root_orient=plain["poses"][:, :3], pose_body=plain["poses"][:, 3:66])
    objects = dict(markers_latent_vids=np.array([{"a": 1}], dtype=object))
    np.savez(
        tmp_path / "b.npz",
        trans=plain["trans"],
        mocap_frame_rate=RATE,
        **parts,
        **objects,
    )
    smplx = dict(
        global_orient=plain["poses"][:, :3],
        transl=plain["trans"],
        body_pose=plain["poses"][:, 3:66].reshape(FRAMES, 21, 3),
    )
    np.savez(tmp_path / "c.npz", **smplx)
    for name, options in (("b.npz", {}), ("c.npz", {"frame_rate": RATE})):
        performer = performed(tmp_path / name, **options)
        assert performer.format == "SMPL-X"
        np.testing.assert_allclose(performer.positions["left_wrist"], expected)


def test_the_models_own_file_gives_the_lengths(tmp_path) -> None:
    """A model whose first 22 vertices are its joints, and whose one shape stretches."""
    np.savez(tmp_path / "a.npz", **arrays())
    mean = np.zeros((22, 3))
    for i, parent in enumerate(PARENTS):
        mean[i] = MEAN_OFFSETS["SMPL"][i] + (mean[parent] if i else 0.0)
    vertices = np.vstack([mean, np.ones((8, 3))])
    model = dict(
        J_regressor=np.eye(52, 30),
        v_template=vertices,
        shapedirs=0.1 * vertices[:, :, None],
        kintree_table=np.zeros((2, 52)),
    )
    np.savez(tmp_path / "model.npz", **model)
    taller = performed(tmp_path / "a.npz", skeleton=str(tmp_path / "model.npz"))
    assert taller.height == pytest.approx(1.1 * performed(tmp_path / "a.npz").height)
    assert not any("betas are ignored" in str(fact) for fact in taller.facts)
    np.savez(tmp_path / "model.npz", **model | {"v_template": np.zeros((3, 3))})
    with pytest.raises(MotionError, match="shapes of a body model"):
        performed(tmp_path / "a.npz", skeleton=str(tmp_path / "model.npz"))
    with pytest.raises(MotionError, match="no NPZ of SMPL-H"):
        performed(tmp_path / "a.npz", skeleton=str(tmp_path / "a.npz"))


@pytest.mark.parametrize(
    "changes, options, said",
    [
        ({"poses": np.zeros((FRAMES, 63))}, {}, "63 columns"),
        ({"poses": np.zeros((FRAMES - 1, 156))}, {}, "frames differ"),
        ({"trans": np.full((FRAMES, 3), np.nan)}, {}, "trans, frame 1"),
        ({"trans": np.full((FRAMES, 3), 1e12)}, {}, "no unit makes a person"),
        ({"mocap_framerate": -1.0}, {}, "one positive number"),
        ({"mocap_framerate": None}, {}, "--frame-rate HZ"),
        ({"poses": np.array(["a"] * FRAMES)}, {}, "a row of numbers a frame"),
        ({}, {"unit": "cm"}, "leave unit cm away"),
        ({}, {"joints": "joints.yaml"}, "leave joints joints.yaml away"),
        ({}, {"skeleton": "none.npz"}, "none.npz"),
    ],
)
def test_wrong_files_are_told(changes, options, said, tmp_path) -> None:
    held = {k: v for k, v in (arrays() | changes).items() if v is not None}
    np.savez(tmp_path / "a.npz", **held)
    with pytest.raises(MotionError, match=said):
        performed(tmp_path / "a.npz", **options)


def wham(frame_ids: np.ndarray | None = None) -> dict:
    """What WHAM saves: a person a key, y up, turns of 24 joints."""
    turns, root = moving()
    poses = np.zeros((FRAMES, 72), dtype=np.float32)
    poses[:, :66] = turns.reshape(FRAMES, 66)
    ids = np.arange(5, 5 + FRAMES) if frame_ids is None else frame_ids
    person = dict(
        pose=poses * 0.0,
        trans=root * 0.0,
        pose_world=poses,
        trans_world=root.astype(np.float32),
        betas=np.ones((FRAMES, 10), dtype=np.float32),
        frame_ids=ids,
    )
    held = defaultdict(dict)
    held[0] = {k: v[:7] for k, v in person.items()}
    held[1] = person
    return held


def test_wham_is_read(tmp_path) -> None:
    turns, root = moving()
    poses = np.hstack([turns.reshape(FRAMES, 66), np.zeros((FRAMES, 6))])
    np.savez(tmp_path / "a.npz", poses=poses, trans=root, fps=25.0)
    expected = performed(tmp_path / "a.npz").positions
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(wham()))
    found = performed(tmp_path / "a.pkl", frame_rate=25.0)
    assert found.format == "SMPL" and not holds_reference(tmp_path / "a.pkl")
    assert found.notes == ("person 1, who is seen longest; others: 0",)
    for joint in ("pelvis", "left_wrist", "right_toe"):
        p = found.positions[joint]
        np.testing.assert_allclose(p, expected[joint], atol=1e-5)
    with pytest.raises(MotionError, match="--frame-rate HZ"):
        performed(tmp_path / "a.pkl")
    # The person is hidden for a while after the tenth frame.
    ids = np.concatenate([np.arange(10), np.arange(20, FRAMES + 10)])
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(wham(ids)))
    found = performed(tmp_path / "a.pkl", frame_rate=25.0)
    assert found.num_frames == FRAMES - 10
    assert "only frames 20 to 49 of the video, the longest of 2" in found.notes[1]


def test_a_pickle_of_no_person_is_a_robots(tmp_path) -> None:
    (tmp_path / "a.pkl").write_bytes(pickle.dumps({"root_pos": np.zeros((3, 3))}))
    assert holds_reference(tmp_path / "a.pkl")
    with pytest.raises(MotionError, match="of a robot's own joints, not of a person"):
        performed(tmp_path / "a.pkl")
    held = {1: {"pose_world": np.zeros((3, 72))}}
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(held))
    with pytest.raises(MotionError, match="person 1: no turns of a body model's"):
        performed(tmp_path / "a.pkl")
