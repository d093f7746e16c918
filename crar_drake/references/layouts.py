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

# Keys of a rate: a number in the file's name (`walk_poses_120_jpos.npy`), and the times
# of all frames.
FILE_NAME, TIME = "its name", "time"


@dataclass(frozen=True)
class Part:
    """Where root or joints stand in a file."""

    # of the array, or of each column; * stands for a joint's name
    keys: tuple[str, ...]
    first: int = 0  # column in that array
    # whether the array has a row for each link, the root's first: (T, B, count)
    of_links: bool = False


@dataclass(frozen=True)
class Layout:
    """A layout; angles are in radians and positions in metres unless said otherwise."""

    name: str  # what it is called here; it ends with the suffix of its files
    used_by: str  # who writes and reads such files
    # of the root's x y z, of its rotation in the world, and of the joints
    parts: tuple[Part, Part, Part]
    order: str  # of the rotation's numbers: WXYZ, XYZW, EULER or TURN
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
    # keys of B links' names (B,), and of their `LINK_STATES`
    links: tuple[str, ...] = ()
    computed: tuple[str, ...] = ()  # further keys that follow from motion and robot
    needed: tuple[str, ...] = ()  # further keys without which a file is none
    # whether a file that could be of several is taken for this until evidence decides
    usual: bool = True
    several: bool = False  # whether a file can hold several motions
    precision: str = "float64"  # of the numbers that are written

    @property
    def suffix(self) -> str:
        """Of its files."""
        return "." + self.name.rpartition("-")[2]

    @property
    def has_rate(self) -> bool:
        """Whether a file says its rate, each of its motions another perhaps."""
        return self.rate not in ("", FILE_NAME)

    @property
    def has_room(self) -> bool:
        """Whether a file can hold more of a motion than its keys: it has keys and
        values of each motion, and not arrays of several in a row."""
        arrays = self.suffix == ".npz" and not self.several
        return arrays or self.suffix == ".pkl" or self.name == "phuma-npy"

    @property
    def root_columns(self) -> int:
        """Columns before the joints, in their array."""
        return self.parts[2].first

    @property
    def has_columns(self) -> bool:
        """Whether each joint has a column with its name."""
        return "*" in self.parts[2].keys[0]

    @property
    def keys(self) -> tuple[str, ...]:
        """Without which a file is none."""
        parts = [key for part in self.parts for key in part.keys if "*" not in key]
        return tuple(dict.fromkeys([*self.needed, *parts]))


# What follows from a motion and its robot's links, in the world: origins (T, B, 3) [m],
# orientations (T, B, 4) w x y z, velocities of the origins (T, B, 3) [m/s], and angular
# velocities (T, B, 3) [rad/s].
LINK_STATES = ("body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w")


def _in(key: str, position: int = 0, rotation: int = 3, joints: int = 7):
    """Root and joints in columns of one array."""
    return Part((key,), position), Part((key,), rotation), Part((key,), joints)


def _of(position: str, rotation: str, joints: str, of_links: bool = False):
    """Root and joints in arrays of their own."""
    root = [Part((key,), of_links=of_links) for key in (position, rotation)]
    return *root, Part((joints,))


_EULER = tuple(f"root_rotate{axis}" for axis in "XYZ")
_NAMED = Part(NAMED_ROOT), Part(_EULER), Part(("*_dof",))
_QUATERNION = tuple(f"root_q{axis}" for axis in "wxyz")
_COLUMNS = Part(("root_x", "root_y", "root_z")), Part(_QUATERNION), Part(("*",))
_LINKS = _of("body_pos_w", "body_quat_w", "joint_pos", True)
_NPZ = dict(rate="fps", usual_rate=50.0, names=("joint_names",))
_BODIES = _NPZ | dict(velocities="joint_vel", links=("body_names", *LINK_STATES))
_AMP = (
    *("body_names", "body_positions", "body_rotations"),
    *("body_linear_velocities", "body_angular_velocities"),
)
_DICT = dict(rate="fps", names=("joint_names", "dof_names"))
_ONE_OF = dict(usual=False)

# fmt: off
LAYOUTS = {row[0]: Layout(*row[:4], **row[4]) for row in (
    ("xyzw-csv", "Unitree, input of BeyondMimic and mjlab", _in(""), XYZW, _ONE_OF),
    ("wxyz-csv", "ProtoMotions, kimodo", _in(""), WXYZ, _ONE_OF),
    ("named-csv", "BONES-SEED", _NAMED, EULER,
     dict(metre=0.01, radian=np.pi / 180.0, usual_rate=120.0)),
    ("joints-csv", "logs with a heading", _COLUMNS, WXYZ, dict(rate=TIME)),
    ("beyondmimic-npz", "BeyondMimic, Isaac Lab", _LINKS, WXYZ,
     _BODIES | dict(breadth_first=True, precision="float32")),
    ("mjlab-npz", "mjlab", _LINKS, WXYZ, _BODIES | dict(precision="float32")),
    ("holosoma-npz", "holosoma", _in("joint_pos"), WXYZ, _BODIES),
    ("amp-npz", "Isaac Lab's AMP, AMASS Retargeted for G1",
     _of("body_positions", "body_rotations", "dof_positions", True), WXYZ,
     _NPZ | dict(names=("dof_names",), needed=("dof_names",), links=_AMP,
                 velocities="dof_velocities", precision="float32")),
    ("locomujoco-npz", "LocoMuJoCo, version 1", _in("qpos"), WXYZ,
     _NPZ | dict(rate="frequency", velocities="qvel", own_spin=True, several=True,
                 needed=("frequency", "joint_names", "jnt_type", "split_points"))),
    ("qpos-npz", "holosoma's retargeting, any4hdmi", _in("qpos"), WXYZ, _NPZ),
    ("omniretarget-npz", "OmniRetarget", _in("qpos", 4, 0), WXYZ, _NPZ),
    ("phuma-npy", "PHUMA", _of("root_trans", "root_ori", "dof_pos"), XYZW, _DICT),
    ("amass-npy", "Retargeted AMASS for robotics", _in(""), XYZW,
     dict(raised=0.793, raised_columns=36, rate=FILE_NAME, usual_rate=120.0)),
    ("xyzw-npy", "tables of Unitree's CSV", _in(""), XYZW, _ONE_OF),
    ("wxyz-npy", "tables of MuJoCo's qpos", _in(""), WXYZ, _ONE_OF),
    ("gmr-pkl", "GMR, TWIST", _of("root_pos", "root_rot", "dof_pos"), XYZW,
     _DICT | dict(computed=("local_body_pos", "link_body_list"))),
    ("motion-lib-pkl", "PHC, ASAP, HumanoidVerse",
     _of("root_trans_offset", "root_rot", "dof"), XYZW,
     _DICT | dict(computed=("pose_aa",), several=True, precision="float32")),
    ("mimickit-pkl", "MimicKit", _in("frames", joints=6), TURN, _DICT),
)}
# fmt: on


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
