"""Acclaim skeletons (ASF) and motions (AMC): reading, writing, kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Bone:
    """One bone of a skeleton, in the file's y-up world at rest.

    Attributes:
        name: the bone's name, e.g. "lhumerus".
        parent: the parent bone's name; "root" for the bones at the root.
        direction: (3,) unit vector from the bone's start to its end.
        length: distance from start to end [m].
        axis: (3,) the local axes' rotation about x, y, z [rad]: C = Rz Ry Rx.
        dof: names of its degrees of freedom in file order, among rx ry rz.
        limits: one (lower, upper) per dof [rad]; informative only.
    """

    name: str
    parent: str
    direction: np.ndarray
    length: float  # [m]
    axis: np.ndarray  # [rad]
    dof: tuple[str, ...] = ()
    limits: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Skeleton:
    """An ASF skeleton: `bones` maps name to Bone, each parent before its children."""

    name: str
    bones: dict[str, Bone]


@dataclass(frozen=True)
class Clip:
    """One AMC motion on its skeleton.

    Attributes:
        name: what the user called it, for messages.
        skeleton: the skeleton that it moves.
        frame_rate: samples per second [Hz].
        root_position: (T, 3) x y z of the root, y up [m].
        root_rotation: (T, 3) rotations about x y z as in the file [rad].
        joints: bone name to (T, k) dof values in the bone's dof order [rad].
    """

    name: str
    skeleton: Skeleton
    frame_rate: float  # [Hz]
    root_position: np.ndarray  # [m]
    root_rotation: np.ndarray  # [rad]
    joints: dict[str, np.ndarray]  # [rad]
