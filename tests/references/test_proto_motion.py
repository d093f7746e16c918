"""ProtoMotions' files, written byte by byte, and what is refused of them."""

from pathlib import Path

import numpy as np
import pytest
from small_biped import DEPTH_FIRST, moving_samples, whole_biped
from torch_files import Raw, named, tensor, write_torch

from crar_drake.errors import MotionError
from crar_drake.motion.robots_own import holds_reference
from crar_drake.motion.torch_zip import read_torch_zip
from crar_drake.references.motion_files import read_motion, write_motion

P, Q, JOINTS = (x.astype(np.float32) for x in moving_samples())
STATE = "protomotions.simulator.base_simulator.simulator_state"


def proto(**changes) -> dict:
    positions = np.stack([P, P + 1.0], axis=1)
    turns = np.stack([np.roll(Q, -1, axis=1)] * 2, axis=1)
    held = dict(
        state_conversion=named(STATE, "StateConversion", "common"),
        fps=30,
        dof_pos=JOINTS,
        rigid_body_pos=positions,
        rigid_body_rot=turns,
        rigid_body_contacts=np.zeros((len(P), 2), dtype=bool),
    )
    return {key: value for key, value in (held | changes).items() if value is not None}


@pytest.mark.parametrize("offset", [0, 7])
def test_it_is_read(tmp_path: Path, offset: int) -> None:
    robot = whole_biped(tmp_path / "biped")
    path = write_torch(tmp_path / "a.motion", proto(), offset=offset)
    assert holds_reference(path)
    read = read_motion(path, robot=robot)
    assert read.layout == "proto-motion" and read.rate == 30.0
    assert read.joint_names == DEPTH_FIRST
    assert np.array_equal(read.root_positions, P)
    assert np.array_equal(read.root_quaternions, Q)
    assert np.array_equal(read.joint_positions, JOINTS)
    with pytest.raises(MotionError, match="is read, but not written"):
        write_motion(tmp_path / "b.motion", read, "proto-motion", robot)
    write_motion(tmp_path / "b.csv", read, "wxyz-csv", robot)


def test_tensors_of_any_strides(tmp_path: Path) -> None:
    """A transposed one, one that is expanded, a number, and none."""
    given = {
        "turned": np.arange(12.0).reshape(3, 4).T,
        "wide": np.broadcast_to(np.arange(3.0), (5, 3)),
        "one": np.array(2.5),
        "none": np.zeros((0, 3)),
        "long": np.arange(4),
    }
    given["none"] = Raw(tensor("0", "Double", 12, 0, (0, 3), (3, 1)))
    held = read_torch_zip(write_torch(tmp_path / "a.pt", given))
    for key in ("turned", "wide", "one", "long"):
        assert np.array_equal(held[key], given[key]) and held[key].flags.owndata
    assert held["none"].shape == (0, 3)


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"dof_pos": None}, "no dof_pos"),
        ({"dof_pos": JOINTS[:3]}, "numbers of frames differ"),
        ({"rigid_body_rot": Q}, "rigid_body_rot is an array"),
        ({"fps": None}, "fps is None"),
        ({"state_conversion": named(STATE, "StateConversion", "sim")},
         "in the order of a simulator"),
        ({"more": named("os", "system", "true")}, "names os.system, which is no plain"),
        ({"more": named("torch._utils", "_rebuild_tensor_v2", 1, 2, (3,), (1,))},
         "no storage"),
        ({"more": tensor("0", "Float", 60, 1, (60,), (1,))}, "larger than its storage"),
        ({"more": tensor("0", "Float", 9999, 0, (1,), (1,))}, "storage is cut off"),
        ({"more": tensor("0", "Float", 60, 0, (2**30, 8), (0, 0))}, "too large"),
        ({"more": tensor("0", "Float", 60, 0, (2,), (-1,))}, "tensor is damaged"),
        ({"more": tensor("x", "Float", 60, 0, (2,), (1,))}, "that is damaged"),
        ({"more": tensor("0", "BFloat16", 60, 0, (2,), (1,))}, "names torch.BFloat16"),
    ],
)  # fmt: skip
def test_wrong_files_are_told(changes, said: str, tmp_path: Path) -> None:
    write_torch(tmp_path / "a.motion", proto(**changes))
    with pytest.raises(MotionError, match=said) as caught:
        read_motion(tmp_path / "a.motion")
    assert str(tmp_path / "a.motion") in str(caught.value)


def test_what_is_no_such_zip_is_told(tmp_path: Path) -> None:
    path = write_torch(tmp_path / "a.motion", proto(), order="big")
    with pytest.raises(MotionError, match="big-endian"):
        read_motion(path)
    data = write_torch(path, proto()).read_bytes()
    for content in (data[: len(data) // 2], b"\x80\x02}.", b"PK\x05\x06" + bytes(18)):
        path.write_bytes(content)
        with pytest.raises(MotionError, match=r"a\.motion: "):
            read_motion(path)
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(200):
        changed = bytearray(data)
        for place in rng.choice(1500, 3):
            changed[place] = rng.integers(256)
        path.write_bytes(changed)
        try:
            read_motion(path)
        except MotionError:
            refused += 1
    assert refused > 100
