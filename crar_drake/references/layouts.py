"""The layouts of robot motions, as data: one reader and one writer work from the table.

A file holds values by *keys*: arrays of an NPZ, entries of a dict (pickled, in a PKL or
an NPY), columns of a CSV with a heading. A table without names (a CSV, an NPY) is the
one value with the key "".

Sources: Isaac Lab's `motion_loader.py` of the task `humanoid_amp`; BeyondMimic's and
mjlab's `csv_to_npz.py`; `convert_data_format_mj.py` of holosoma; LocoMuJoCo's
`trajectory/dataclasses.py`; `motion_adaptation.py` of PHUMA; GMR; motion_lib of PHC and
ASAP; MimicKit's `anim/motion.py`; any4hdmi's `core/format.py`; the data sets' cards of
BONES-SEED (with `convert_g1_csv_to_proto.py` of ProtoMotions), OmniRetarget, and
"Retargeted AMASS for robotics" (of its heights the players of that data set).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crar_drake.errors import MotionError, nearest
from crar_drake.motion.robots_own import NAMED_ROOT, SUFFIXES

WXYZ, XYZW = "wxyz", "xyzw"  # quaternions
EULER = "xyz"  # about the world's x, then its y, then its z [deg]
TURN = "rotation vector"  # axis times angle [rad]

# The key that stands for a number in the file's name (`walk_poses_120_jpos.npy`).
FILE_NAME = "its name"


@dataclass(frozen=True)
class Part:
    """Where root or joints stand in a file."""

    # of the array, or of each column; * stands for a joint's name
    keys: tuple[str, ...]
    first: int = 0  # column in that array
    count: int | None = None  # of its columns; None for all that follow
    # whether the array has a row for each link, the root's first: (T, B, count)
    of_links: bool = False


@dataclass(frozen=True)
class Links:
    """Keys of what follows from a motion and its robot's links; B links of T frames."""

    names: str = "body_names"  # (B,)
    positions: str = "body_pos_w"  # (T, B, 3) of the origins, in the world [m]
    rotations: str = "body_quat_w"  # (T, B, 4) w x y z
    velocities: str = "body_lin_vel_w"  # (T, B, 3) of the origins, in the world [m/s]
    spins: str = "body_ang_vel_w"  # (T, B, 3) angular velocities, in the world [rad/s]


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A layout; angles are in radians and positions in metres unless said otherwise."""

    name: str  # what it is called here
    suffix: str  # of its files
    used_by: str  # who writes and reads such files
    position: Part  # x y z of the root
    rotation: Part  # of the root in the world
    order: str  # of its numbers: WXYZ, XYZW, EULER or TURN
    joints: Part
    # how long a unit of position is [m], and how large one of a joint [rad]
    metre: float = 1.0
    radian: float = 1.0
    # the root is so much higher than files of so many columns say [m]
    raised: float = 0.0
    raised_columns: int = 0
    breadth_first: bool = False  # whether joints are in that order, and not depth first
    rate: str = ""  # key of the rate [Hz], or of the frames' times [s]
    usual_rate: float = 30.0  # where a file does not say it [Hz]
    names: tuple[str, ...] = ()  # keys of the joints' names; the first is written
    # of the joints' velocities [rad/s]; where the root stands before the joints its
    # velocity [m/s] and angular velocity [rad/s] stand before theirs
    velocities: str = ""
    own_spin: bool = False  # whether that is in the root's frame, not in the world
    links: Links | None = None
    computed: tuple[str, ...] = ()  # further keys that follow from motion and robot
    needed: tuple[str, ...] = ()  # further keys without which a file is none
    # keys of which one at least tells it from others whose root and joints are there
    marks: tuple[str, ...] = ()
    # whether a file that could be of several is taken for this until evidence decides
    usual: bool = True
    several: bool = False  # whether a file can hold several motions
    precision: str = "float64"  # of the numbers that are written

    @property
    def has_rate(self) -> bool:
        """Whether a file says its rate, each of its motions another perhaps."""
        return self.rate not in ("", FILE_NAME)

    @property
    def root_columns(self) -> int:
        """Columns before the joints, in their array."""
        return self.joints.first

    @property
    def parts(self) -> tuple[Part, Part, Part]:
        """Of position, rotation and joints."""
        return self.position, self.rotation, self.joints

    @property
    def keys(self) -> tuple[str, ...]:
        """Without which a file is none."""
        parts = [key for part in self.parts for key in part.keys]
        return tuple(dict.fromkeys([*self.needed, *parts]))


_POSITION = Part(("",), 0, 3)
_TABLE = dict(position=_POSITION, rotation=Part(("",), 3, 4), joints=Part(("",), 7))
_IN_JOINTS = dict(
    position=Part(("joint_pos",), 0, 3),
    rotation=Part(("joint_pos",), 3, 4),
    joints=Part(("joint_pos",), 7),
)
_IN_QPOS = dict(
    position=Part(("qpos",), 0, 3),
    rotation=Part(("qpos",), 3, 4),
    joints=Part(("qpos",), 7),
)
_FIRST_LINK = dict(
    position=Part(("body_pos_w",), 0, 3, of_links=True),
    rotation=Part(("body_quat_w",), 0, 4, of_links=True),
    joints=Part(("joint_pos",)),
)
_NPZ = dict(suffix=".npz", order=WXYZ, rate="fps", usual_rate=50.0)
_ISAAC = dict(names=("joint_names",), velocities="joint_vel", links=Links())
_PKL = dict(suffix=".pkl", rate="fps", names=("joint_names", "dof_names"))


def _root(position: str, rotation: str, joints: str) -> dict[str, Part]:
    return dict(
        position=Part((position,), 0, 3),
        rotation=Part((rotation,), 0, 4),
        joints=Part((joints,)),
    )


LAYOUTS = {
    layout.name: layout
    for layout in (
        Layout(
            name="xyzw-csv",
            suffix=".csv",
            used_by="Unitree, input of BeyondMimic and mjlab",
            **_TABLE,
            order=XYZW,
            usual=False,
        ),
        Layout(
            name="wxyz-csv",
            suffix=".csv",
            used_by="ProtoMotions, kimodo",
            **_TABLE,
            order=WXYZ,
            usual=False,
        ),
        Layout(
            name="named-csv",
            suffix=".csv",
            used_by="BONES-SEED",
            position=Part(NAMED_ROOT),
            rotation=Part(tuple(f"root_rotate{axis}" for axis in "XYZ")),
            order=EULER,
            joints=Part(("*_dof",)),
            metre=0.01,
            radian=np.pi / 180.0,
            usual_rate=120.0,
        ),
        Layout(
            name="joints-csv",
            suffix=".csv",
            used_by="logs of MuJoCo and ROS",
            position=Part(("root_x", "root_y", "root_z")),
            rotation=Part(("root_qw", "root_qx", "root_qy", "root_qz")),
            order=WXYZ,
            joints=Part(("*",)),
            rate="time",
        ),
        Layout(
            name="beyondmimic-npz",
            used_by="BeyondMimic, Isaac Lab",
            **_NPZ,
            **_FIRST_LINK,
            **_ISAAC,
            breadth_first=True,
            precision="float32",
        ),
        Layout(
            name="mjlab-npz",
            used_by="mjlab",
            **_NPZ,
            **_FIRST_LINK,
            **_ISAAC,
            precision="float32",
        ),
        Layout(name="holosoma-npz", used_by="holosoma", **_NPZ, **_IN_JOINTS, **_ISAAC),
        Layout(
            name="amp-npz",
            used_by="Isaac Lab's AMP, AMASS Retargeted for G1",
            **_NPZ,
            position=Part(("body_positions",), 0, 3, of_links=True),
            rotation=Part(("body_rotations",), 0, 4, of_links=True),
            joints=Part(("dof_positions",)),
            names=("dof_names",),
            needed=("dof_names",),
            velocities="dof_velocities",
            links=Links(
                positions="body_positions",
                rotations="body_rotations",
                velocities="body_linear_velocities",
                spins="body_angular_velocities",
            ),
            precision="float32",
        ),
        Layout(
            name="locomujoco-npz",
            used_by="LocoMuJoCo, version 1",
            **_NPZ | dict(rate="frequency"),
            **_IN_QPOS,
            names=("joint_names",),
            velocities="qvel",
            own_spin=True,
            needed=("frequency", "joint_names", "jnt_type", "split_points"),
            marks=("jnt_type", "split_points"),
            several=True,
        ),
        Layout(
            name="qpos-npz",
            used_by="holosoma's retargeting, any4hdmi",
            **_NPZ,
            **_IN_QPOS,
            names=("joint_names",),
        ),
        Layout(
            name="omniretarget-npz",
            used_by="OmniRetarget",
            **_NPZ,
            **_IN_QPOS
            | dict(position=Part(("qpos",), 4, 3), rotation=Part(("qpos",), 0, 4)),
            names=("joint_names",),
            usual=False,
        ),
        Layout(
            name="phuma-npy",
            suffix=".npy",
            used_by="PHUMA",
            **_root("root_trans", "root_ori", "dof_pos"),
            order=XYZW,
            rate="fps",
            names=("joint_names", "dof_names"),
        ),
        Layout(
            name="amass-npy",
            suffix=".npy",
            used_by="Retargeted AMASS for robotics",
            **_TABLE,
            order=XYZW,
            raised=0.793,
            raised_columns=36,
            rate=FILE_NAME,
            usual_rate=120.0,
        ),
        Layout(
            name="xyzw-npy",
            suffix=".npy",
            used_by="tables of Unitree's CSV",
            **_TABLE,
            order=XYZW,
            usual=False,
        ),
        Layout(
            name="wxyz-npy",
            suffix=".npy",
            used_by="tables of MuJoCo's qpos",
            **_TABLE,
            order=WXYZ,
            usual=False,
        ),
        Layout(
            name="gmr-pkl",
            used_by="GMR, TWIST",
            **_PKL,
            **_root("root_pos", "root_rot", "dof_pos"),
            order=XYZW,
            computed=("local_body_pos", "link_body_list"),
        ),
        Layout(
            name="motion-lib-pkl",
            used_by="PHC, ASAP, HumanoidVerse",
            **_PKL,
            **_root("root_trans_offset", "root_rot", "dof"),
            order=XYZW,
            computed=("pose_aa",),
            several=True,
            precision="float32",
        ),
        Layout(
            name="mimickit-pkl",
            used_by="MimicKit",
            **_PKL,
            position=Part(("frames",), 0, 3),
            rotation=Part(("frames",), 3, 3),
            order=TURN,
            joints=Part(("frames",), 6),
        ),
    )
}


def layout_named(name: str) -> Layout:
    """The layout of that name.

    Raises:
        MotionError: there is none.
    """
    if name not in LAYOUTS:
        raise MotionError(f"there is no layout {name!r}{nearest(name, LAYOUTS)}")
    return LAYOUTS[name]


def usual_suffix(path: str | os.PathLike[str]) -> str:
    """The suffix that files of that one's suffix usually have; .joblib is .pkl."""
    suffix = Path(path).suffix.lower()
    return SUFFIXES.get(suffix, suffix)


def layouts_of(path: str | os.PathLike[str]) -> list[str]:
    """Names of the layouts that a file with that suffix can have."""
    suffix = usual_suffix(path)
    return [layout.name for layout in LAYOUTS.values() if layout.suffix == suffix]
