"""Authors the built-in motions: python examples/author_motions.py

Everything here was invented for this project; nothing is a recording. A motion is a
few keyed tracks: where the performer walks and faces, how the trunk bends, and where
each wrist is. Between keys a monotone cubic runs, which cannot overshoot, and a
Gaussian rounds it, so that every joint moves smoothly. Two-bone inverse kinematics
turns wrists and ankles into joint angles.

The motions are meant to be too much for the robot in models/upper_body: hands brush
the body and cross, elbows and trunk bend further than the robot's can. But they keep
to ways that lead back: arms cross one over the other, not through each other, and
rise in front, because an arm that comes down in front after going up at the side
winds the robot's shoulder to its limit and leaves it there.

While authoring, vectors are (forward, left, up) of the body part they belong to, and
`R` matrices are written in these axes. The file's axes are (left, up, forward).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from benchmarks.amc_files import write_amc, write_asf
from scipy.interpolate import PchipInterpolator

from crar_drake.motion.formats.asf_amc import (
    Bone,
    Clip,
    Skeleton,
    rotation_xyz,
)
from crar_drake.resources import builtin_motions_folder

FRAME_RATE = 60.0  # [Hz]
SMOOTHING = 0.045  # standard deviation of the Gaussian over the keyed tracks [s]
OVERSAMPLING = 4  # of the tracks while they are smoothed

# An adult of about 1.75 m.
HIP_DROP = 0.08  # from the waist down to the hip joints [m]
HIP_HALF_WIDTH = 0.09  # [m]
THIGH = 0.42  # [m]
SHANK = 0.41  # [m]
ANKLE_HEIGHT = 0.07  # [m]
VERTEBRA = 0.155  # each of the three bones from the waist to the neck [m]
CLAVICLE = 0.18  # [m]
UPPER_ARM = 0.30  # [m]
FOREARM = 0.26  # [m]
HIP_HEIGHT = HIP_DROP + THIGH + SHANK + ANKLE_HEIGHT  # legs straight [m]

SIDES = {"left": 1.0, "right": -1.0}


# --- the performer ----------------------------------------------------------------

# The local axes of a humerus, so that its three angles degenerate only where the
# upper arm points backwards, up and inwards, or the opposite way. [rad]
_HUMERUS_AXIS = {
    "left": np.radians([-30.0, -55.0, 0.0]),
    "right": np.radians([-30.0, 55.0, 0.0]),
}


def performer() -> Skeleton:
    """Returns the skeleton: arms out, palms down, facing z, y up."""
    bones: dict[str, Bone] = {}

    def add(
        name: str,
        parent: str,
        to_end: Sequence[float],
        dof: str = "",
        axis: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        vector = np.array(to_end)
        length = float(np.linalg.norm(vector))
        bones[name] = Bone(
            name,
            parent,
            vector / length,
            length,
            np.array(axis, dtype=float),
            tuple(dof.split()),
            # Some viewers want limits; these limit nothing.
            ((-np.pi, np.pi),) * len(dof.split()),
        )

    for side, sign in SIDES.items():
        s = side[0]
        add(f"{s}hipjoint", "root", [sign * HIP_HALF_WIDTH, -HIP_DROP, 0.0])
        add(f"{s}femur", f"{s}hipjoint", [0.0, -THIGH, 0.0], "rx ry rz")
        add(f"{s}tibia", f"{s}femur", [0.0, -SHANK, 0.0], "rx")
        add(f"{s}foot", f"{s}tibia", [0.0, -ANKLE_HEIGHT, 0.17], "rx ry rz")
    add("lowerback", "root", [0.0, VERTEBRA, 0.0], "rx ry rz")
    add("upperback", "lowerback", [0.0, VERTEBRA, 0.0], "rx ry rz")
    add("thorax", "upperback", [0.0, VERTEBRA, 0.0], "rx ry rz")
    add("lowerneck", "thorax", [0.0, 0.08, 0.0])
    add("upperneck", "lowerneck", [0.0, 0.07, 0.02], "rx ry")
    add("head", "upperneck", [0.0, 0.15, 0.0])
    for side, sign in SIDES.items():
        s = side[0]
        hinge = np.radians([0.0, 0.0, -90.0 * sign])  # local x: elbow's axis
        add(f"{s}clavicle", "thorax", [sign * CLAVICLE, -0.02, 0.0], "ry rz")
        add(
            f"{s}humerus",
            f"{s}clavicle",
            [sign * UPPER_ARM, 0.0, 0.0],
            "rx ry rz",
            _HUMERUS_AXIS[side],
        )
        add(f"{s}radius", f"{s}humerus", [sign * FOREARM, 0.0, 0.0], "rx", hinge)
        add(f"{s}wrist", f"{s}radius", [sign * 0.04, 0.0, 0.0])
        add(f"{s}hand", f"{s}wrist", [sign * 0.14, 0.0, 0.0])
    return Skeleton("performer", bones)


# --- what a motion is made of -----------------------------------------------------


@dataclass(frozen=True)
class ArmPose:
    """Where a wrist is, seen from its own shoulder in the chest's frame.

    Attributes:
        wrist: forward, outward, up [arm lengths].
        elbow: the way that the elbow points: forward, outward, up.
    """

    wrist: tuple[float, float, float]
    elbow: tuple[float, float, float]


# Where arms cross, one passes over (in front of) the other.
ARM_POSES = {
    "hang": ArmPose((0.14, 0.24, -0.90), (-0.9, 0.5, 0.0)),
    "wide": ArmPose((0.32, 0.88, 0.06), (0.0, 0.1, -1.0)),
    "half wide": ArmPose((0.62, 0.38, 0.00), (0.0, 0.8, -0.6)),
    "low wide": ArmPose((-0.05, 0.62, -0.66), (-0.9, 0.4, 0.2)),
    "front": ArmPose((0.94, -0.05, 0.00), (0.0, 0.5, -1.0)),
    "front low": ArmPose((0.75, 0.10, -0.52), (-0.3, 0.8, -0.4)),
    "front over": ArmPose((0.72, -0.44, 0.14), (0.3, 0.9, -0.3)),
    "front under": ArmPose((0.62, -0.44, 0.00), (0.1, 0.8, -0.6)),
    "up": ArmPose((0.12, 0.14, 0.93), (0.3, 1.0, 0.0)),
    "up over": ArmPose((0.28, -0.36, 0.80), (0.5, 1.0, 0.1)),
    "up under": ArmPose((0.18, -0.36, 0.81), (0.4, 1.0, 0.1)),
    "round": ArmPose((0.68, -0.22, 0.05), (0.1, 1.0, -0.2)),
    "sweep in": ArmPose((0.62, -0.55, 0.12), (0.5, 0.5, -0.9)),
    # Each hand on the other shoulder.
    "hug over": ArmPose((0.38, -0.58, 0.05), (0.8, 0.3, -0.7)),
    "hug under": ArmPose((0.25, -0.58, -0.05), (0.4, 0.4, -0.9)),
    # Arms folded flat on the chest.
    "fold over": ArmPose((0.36, -0.42, -0.16), (0.4, 0.8, -0.6)),
    "fold under": ArmPose((0.24, -0.40, -0.28), (0.1, 0.8, -0.7)),
    "low over": ArmPose((0.52, -0.44, -0.58), (0.0, 1.0, -0.1)),
    "low under": ArmPose((0.38, -0.44, -0.68), (-0.2, 1.0, -0.1)),
    "belly": ArmPose((0.28, -0.40, -0.56), (-0.1, 1.0, -0.1)),
    "chest over": ArmPose((0.40, -0.24, 0.02), (0.1, 1.0, 0.1)),
    "chest under": ArmPose((0.36, -0.24, -0.12), (0.1, 1.0, 0.0)),
    "behind over": ArmPose((-0.42, -0.34, -0.52), (-0.6, 0.8, 0.1)),
    "behind under": ArmPose((-0.34, -0.34, -0.64), (-0.6, 0.8, 0.1)),
    "head over": ArmPose((-0.06, -0.16, 0.44), (0.1, 1.0, 0.5)),
    "head under": ArmPose((-0.02, -0.16, 0.32), (0.1, 1.0, 0.4)),
    "far across": ArmPose((0.55, -0.74, 0.05), (0.5, 0.3, -0.9)),
    "high reach": ArmPose((0.40, 0.00, 0.86), (0.3, 0.9, -0.2)),
    "toes": ArmPose((0.88, -0.18, 0.28), (0.0, 1.0, -0.3)),
    "other foot": ArmPose((0.80, -0.46, 0.26), (0.1, 0.8, -0.5)),
    "other knee": ArmPose((0.70, -0.46, 0.08), (0.0, 0.8, -0.6)),
    "guard": ArmPose((0.36, -0.18, 0.04), (0.1, 0.35, -1.0)),
    "shell": ArmPose((0.28, -0.20, 0.12), (0.5, 0.1, -1.0)),
    "jab": ArmPose((0.92, -0.26, 0.12), (0.0, 0.6, -1.0)),
    "hook out": ArmPose((0.42, 0.42, 0.02), (-0.2, 1.0, -0.1)),
    "hook in": ArmPose((0.50, -0.50, 0.10), (0.1, 1.0, 0.0)),
    "uppercut low": ArmPose((0.20, 0.05, -0.46), (-0.7, 0.4, -0.6)),
    "uppercut": ArmPose((0.46, -0.26, 0.36), (0.4, 0.2, -1.0)),
}

Keys = Sequence[Sequence[float]]


@dataclass(frozen=True)
class Choreography:
    """One motion as keyed tracks; every row starts with its time [s].

    Attributes:
        duration: [s].
        arms: (time, left pose, right pose), poses by their name in ARM_POSES.
        trunk: (time, forward, left, turn to the left): how far the chest is bent
            against the hips [deg].
        hips: (time, forward, left, down, pitch): where the hips are over the feet
            [m] and how far they tip forward [deg].
        travel: (time, x, y): where in the world the performer stands [m].
        heading: (time, angle): the way the hips face [deg], to the left positive.
        feet: (time, apart, up): by how much each foot is further out, a hop [m].
        step: time from one step of a foot to its next [s].
    """

    duration: float  # [s]
    arms: Sequence[tuple[float, str, str]]
    trunk: Keys
    hips: Keys
    travel: Keys = ((0.0, 0.0, 0.0),)
    heading: Keys = ((0.0, 0.0),)
    feet: Keys = ((0.0, 0.0, 0.0),)
    step: float = 0.8  # [s]


# --- the motions ------------------------------------------------------------------


def dance() -> Choreography:
    """Opens wide, sweeps, spins hugging itself, contracts and bows."""
    return Choreography(
        duration=13.0,
        arms=(
            (0.7, "hang", "hang"),
            (1.2, "front low", "front low"),
            (1.7, "wide", "wide"),
            (2.1, "half wide", "half wide"),
            (2.7, "high reach", "sweep in"),
            (3.4, "sweep in", "high reach"),
            (4.0, "half wide", "round"),
            (4.4, "round", "half wide"),
            (4.62, "sweep in", "half wide"),
            (4.95, "hug over", "hug under"),
            (6.0, "hug over", "hug under"),
            (6.3, "half wide", "half wide"),
            (6.65, "wide", "wide"),
            (6.9, "wide", "wide"),
            (7.25, "half wide", "half wide"),
            (7.6, "up over", "up under"),
            (8.1, "up over", "up under"),
            (8.5, "front over", "front under"),
            (8.9, "low over", "low under"),
            (9.3, "low over", "low under"),
            (9.8, "hug over", "hug under"),
            (10.4, "fold over", "fold under"),
            (10.7, "fold over", "fold under"),
            (11.05, "belly", "low wide"),
            (11.4, "belly", "behind over"),
            (11.8, "belly", "behind over"),
            (12.2, "front low", "low wide"),
            (12.6, "hang", "hang"),
        ),
        trunk=(
            (0.7, 0, 0, 0),
            (1.6, -8, 0, 0),
            (2.7, 6, 16, 35),
            (3.4, 6, -16, -35),
            (4.3, 4, 0, -30),
            (4.9, 8, 0, 22),
            (5.8, 8, 0, 12),
            (6.6, -12, 10, -10),
            (7.6, -16, 0, 0),
            (8.1, -14, 0, 0),
            (8.8, 42, 0, 12),
            (9.2, 44, 0, 15),
            (9.7, 34, 10, 30),
            (10.2, 34, -14, -34),
            (10.7, 30, 8, 20),
            (11.3, 48, 0, 0),
            (11.8, 46, 0, 0),
            (12.6, 0, 0, 0),
        ),
        hips=(
            (0.7, 0, 0, 0, 0),
            (1.6, 0, 0.03, 0.02, 0),
            (2.7, 0, 0.10, 0.08, 4),
            (3.4, 0, -0.10, 0.08, 4),
            (4.3, 0, 0, 0.10, 6),
            (4.9, 0, 0, 0.02, 2),
            (5.9, 0, 0, 0.02, 2),
            (6.6, 0.05, 0, 0.08, 0),
            (7.6, 0, 0, 0, -4),
            (8.1, 0, 0, 0, -4),
            (8.8, -0.08, 0, 0.16, 18),
            (9.7, -0.06, 0.05, 0.20, 14),
            (10.2, -0.06, -0.05, 0.20, 14),
            (10.7, -0.05, 0, 0.12, 12),
            (11.3, -0.12, 0, 0.06, 34),
            (11.8, -0.12, 0, 0.06, 34),
            (12.6, 0, 0, 0, 0),
        ),
        travel=(
            (0.8, 0, 0),
            (2.4, 0.15, 0.25),
            (4.2, 0.30, 0.0),
            (6.0, 0.40, -0.10),
            (7.4, 0.65, -0.10),
            (9.0, 0.65, 0.05),
            (10.8, 0.45, 0.0),
        ),
        heading=(
            (2.0, 0),
            (3.0, 15),
            (4.0, -15),
            (4.4, -18),
            (6.1, 358),
            (6.6, 362),
            (8.0, 360),
        ),
        step=0.5,
    )


def exercise() -> Choreography:
    """Jumping jacks, squats, side twists, hands to the opposite feet."""
    arms = [(0.7, "hang", "hang")]
    feet, hips = [(0.7, 0.0, 0.0)], [(0.7, 0, 0, 0, 0)]
    for start in (0.7, 1.6, 2.5):
        arms += [
            (start + 0.20, "half wide", "half wide"),
            (start + 0.40, "up over", "up under"),
            (start + 0.50, "up over", "up under"),
            (start + 0.70, "half wide", "half wide"),
            (start + 0.90, "front low", "front low")
            if start < 2.5
            else (start + 0.95, "front low", "front low"),
        ]
        feet += [
            (start + 0.05, 0.0, 0.0),
            (start + 0.22, 0.08, 0.07),
            (start + 0.40, 0.17, 0.0),
            (start + 0.50, 0.17, 0.0),
            (start + 0.68, 0.08, 0.07),
            (start + 0.87, 0.0, 0.0),
        ]
        hips += [
            (start + 0.05, 0, 0, 0.06, 3),
            (start + 0.22, 0, 0, -0.05, 0),
            (start + 0.45, 0, 0, 0.06, 0),
            (start + 0.68, 0, 0, -0.05, 0),
            (start + 0.87, 0, 0, 0.05, 3),
        ]
    arms += [
        (3.8, "low over", "low under"),
        (4.4, "front", "front"),
        (4.9, "hug over", "hug under"),
        (5.5, "hug over", "hug under"),
        (6.0, "chest over", "chest under"),
        (8.1, "chest over", "chest under"),
        (8.4, "half wide", "half wide"),
        (8.8, "wide", "wide"),
        (9.4, "wide", "other foot"),
        (10.2, "other foot", "wide"),
        (10.8, "other foot", "other knee"),
        (11.2, "toes", "toes"),
        (12.2, "hang", "hang"),
    ]
    feet += [(5.6, 0.0, 0.0), (6.2, 0.06, 0.0), (11.4, 0.06, 0.0), (12.2, 0.0, 0.0)]
    hips += [
        (3.9, 0, 0, 0.0, 0),
        (4.4, -0.10, 0, 0.30, 24),
        (4.8, 0, 0, 0.02, 0),
        (5.2, -0.10, 0, 0.30, 24),
        (5.8, 0, 0, 0.03, 0),
        (8.4, 0, 0, 0.03, 0),
        (9.4, -0.14, 0, 0.10, 42),
        (10.9, -0.14, 0, 0.10, 42),
        (12.1, 0, 0, 0, 0),
    ]
    return Choreography(
        duration=12.8,
        arms=tuple(arms),
        trunk=(
            (0.7, 0, 0, 0),
            (1.1, -8, 0, 0),
            (1.6, 4, 0, 0),
            (2.0, -8, 0, 0),
            (2.5, 4, 0, 0),
            (2.9, -8, 0, 0),
            (3.4, 12, 0, 0),
            (3.9, 0, 0, 0),
            (4.4, 18, 0, 0),
            (4.8, 0, 0, 0),
            (5.2, 22, 0, 0),
            (5.8, 4, 0, 0),
            (6.4, 4, 6, 48),
            (6.9, 4, -6, -48),
            (7.4, 4, 14, 52),
            (7.9, 4, -14, -52),
            (8.5, 0, 0, 0),
            (9.4, 48, 6, 40),
            (10.2, 48, -6, -40),
            (10.8, 52, 0, 0),
            (11.2, 54, 0, 0),
            (12.2, 0, 0, 0),
        ),
        hips=tuple(hips),
        feet=tuple(feet),
    )


def reaching() -> Choreography:
    """Reaches high, far across, behind the back, behind the head and to the floor."""
    return Choreography(
        duration=13.0,
        arms=(
            (0.8, "hang", "hang"),
            (1.7, "hang", "high reach"),
            (2.2, "hang", "up"),
            (2.9, "belly", "far across"),
            (3.5, "belly", "far across"),
            (4.2, "far across", "wide"),
            (4.6, "far across", "low wide"),
            (5.0, "half wide", "behind under"),
            (5.3, "low wide", "behind under"),
            (5.7, "behind over", "behind under"),
            (6.2, "behind over", "behind under"),
            (6.55, "low wide", "low wide"),
            (6.85, "hang", "hang"),
            (7.2, "front low", "front low"),
            (7.5, "high reach", "high reach"),
            (7.85, "head over", "head under"),
            (8.2, "head over", "head under"),
            (8.55, "high reach", "high reach"),
            (9.05, "hug under", "high reach"),
            (9.3, "hug under", "high reach"),
            (10.1, "belly", "other foot"),
            (10.6, "other foot", "other knee"),
            (11.2, "fold over", "fold under"),
            (11.6, "fold over", "fold under"),
            (12.4, "hang", "hang"),
        ),
        trunk=(
            (0.8, 0, 0, 0),
            (1.8, -8, 12, 12),
            (2.2, -8, 12, 6),
            (2.9, 10, -6, 42),
            (3.5, 14, -4, 46),
            (4.2, 12, 4, -40),
            (4.8, 8, 4, -36),
            (5.5, 18, 0, 0),
            (6.2, 26, 0, 0),
            (6.9, -6, 0, 0),
            (7.5, -14, 14, 0),
            (8.2, -10, -16, 0),
            (8.9, -6, 16, -14),
            (9.3, -6, 16, -14),
            (10.1, 50, -10, 34),
            (10.6, 54, 0, 20),
            (11.2, 24, 0, -16),
            (11.6, 16, 0, -10),
            (12.4, 0, 0, 0),
        ),
        hips=(
            (0.8, 0, 0, 0, 0),
            (1.8, 0.06, -0.04, 0, 0),
            (2.9, 0, 0.06, 0.05, 4),
            (4.2, 0, -0.06, 0.05, 4),
            (5.5, 0, 0, 0.02, 4),
            (6.2, -0.04, 0, 0.04, 10),
            (7.2, 0, 0, 0, 0),
            (9.2, 0.04, -0.04, 0, 0),
            (10.1, -0.12, 0.02, 0.24, 36),
            (10.6, -0.12, 0.02, 0.26, 38),
            (11.4, -0.03, 0, 0.06, 6),
            (12.4, 0, 0, 0, 0),
        ),
        travel=(
            (0.8, 0, 0),
            (1.8, 0.25, -0.05),
            (3.6, 0.25, 0.05),
            (5.6, 0.10, 0.0),
            (8.0, 0.10, 0.0),
            (9.4, 0.35, 0.0),
            (11.0, 0.35, 0.0),
            (12.4, 0.25, 0.0),
        ),
        heading=((0.8, 0), (2.9, 12), (4.4, -14), (5.6, 0), (9.8, 0), (10.4, 18)),
    )


def boxing() -> Choreography:
    """Jabs, hooks and uppercuts round a tight guard; bobs, weaves, covers up."""
    return Choreography(
        duration=12.0,
        arms=(
            (0.6, "hang", "hang"),
            (1.2, "guard", "guard"),
            (1.7, "guard", "guard"),
            (1.92, "jab", "guard"),
            (2.16, "guard", "guard"),
            (2.40, "jab", "guard"),
            (2.62, "guard", "guard"),
            (2.85, "guard", "jab"),
            (3.12, "guard", "guard"),
            (3.40, "hook out", "shell"),
            (3.66, "hook in", "shell"),
            (3.95, "guard", "guard"),
            (4.20, "shell", "uppercut low"),
            (4.46, "shell", "uppercut"),
            (4.80, "guard", "guard"),
            (5.0, "shell", "shell"),
            (6.3, "shell", "shell"),
            (6.55, "guard", "hook out"),
            (6.80, "guard", "hook in"),
            (7.05, "hook out", "guard"),
            (7.30, "hook in", "guard"),
            (7.55, "guard", "jab"),
            (7.80, "jab", "guard"),
            (8.05, "guard", "jab"),
            (8.30, "uppercut low", "guard"),
            (8.55, "uppercut", "guard"),
            (8.85, "shell", "shell"),
            (9.3, "fold over", "fold under"),
            (9.7, "fold over", "fold under"),
            (10.1, "guard", "guard"),
            (10.35, "guard", "hook out"),
            (10.62, "shell", "hook in"),
            (10.9, "guard", "guard"),
            (11.5, "hang", "hang"),
        ),
        trunk=(
            (0.6, 0, 0, 0),
            (1.2, 14, 0, -16),
            (1.7, 14, 0, -16),
            (1.92, 14, 0, -34),
            (2.16, 14, 0, -14),
            (2.40, 16, 0, -34),
            (2.62, 14, 0, -12),
            (2.85, 18, 4, 34),
            (3.12, 14, 0, -4),
            (3.40, 14, 6, 24),
            (3.66, 14, -4, -38),
            (4.0, 16, 0, -10),
            (4.20, 24, -14, -28),
            (4.46, 6, 4, 30),
            (4.8, 16, 0, -12),
            (5.15, 36, 22, 0),
            (5.55, 42, 0, -10),
            (5.9, 36, -22, -20),
            (6.3, 18, 0, 0),
            (6.55, 14, -6, -30),
            (6.80, 14, 4, 36),
            (7.05, 14, 6, 26),
            (7.30, 14, -4, -36),
            (7.55, 18, 0, 34),
            (7.80, 16, 0, -34),
            (8.05, 18, 0, 34),
            (8.30, 24, 14, 26),
            (8.55, 6, -4, -32),
            (8.85, 24, 0, 0),
            (9.3, 38, 0, 0),
            (9.7, 38, 0, 0),
            (10.1, 14, 0, -16),
            (10.35, 14, -6, -30),
            (10.62, 14, 4, 38),
            (10.95, 10, 0, 0),
            (11.5, 0, 0, 0),
        ),
        hips=(
            (0.6, 0, 0, 0, 0),
            (1.2, 0, 0, 0.07, 6),
            (1.92, 0.05, 0, 0.08, 6),
            (2.16, 0, 0, 0.07, 6),
            (2.85, 0.07, 0, 0.09, 8),
            (3.66, 0, 0, 0.08, 6),
            (4.20, 0, -0.04, 0.16, 10),
            (4.46, 0.03, 0, 0.05, 2),
            (4.8, 0, 0, 0.08, 6),
            (5.15, 0, 0.14, 0.10, 10),
            (5.55, 0, 0, 0.26, 16),
            (5.9, 0, -0.14, 0.10, 10),
            (6.3, 0, 0, 0.08, 6),
            (8.30, 0, 0.04, 0.16, 10),
            (8.55, 0.03, 0, 0.05, 2),
            (9.3, -0.05, 0, 0.18, 14),
            (9.7, -0.05, 0, 0.18, 14),
            (10.1, 0, 0, 0.08, 6),
            (10.9, 0, 0, 0.06, 4),
            (11.5, 0, 0, 0, 0),
        ),
        travel=(
            (0.7, 0, 0),
            (2.9, 0.30, 0.05),
            (4.6, 0.15, 0.15),
            (6.3, 0.15, -0.10),
            (8.4, 0.45, 0.0),
            (9.6, 0.20, 0.0),
            (11.3, 0.10, 0.0),
        ),
        heading=((0.6, 0), (1.3, -22), (6.0, -10), (9.0, -22), (10.8, -15), (11.5, 0)),
        feet=((0.6, 0, 0), (1.2, 0.08, 0), (10.8, 0.08, 0), (11.5, 0, 0)),
        step=0.5,
    )


MOTIONS: dict[str, Callable[[], Choreography]] = {
    "boxing": boxing,
    "dance": dance,
    "exercise": exercise,
    "reaching": reaching,
}


# --- from tracks to samples -------------------------------------------------------


def _sampled(duration: float, keys: Keys) -> np.ndarray:
    """Returns (T, k) smooth samples of keys (time, k values), held at both ends."""
    table = np.array(keys, dtype=float)
    fine = FRAME_RATE * OVERSAMPLING
    reach = round(4.0 * SMOOTHING * fine)
    count = round(duration * FRAME_RATE) * OVERSAMPLING + 1
    time = np.arange(-reach, count + reach) / fine
    if len(table) == 1:
        values = np.repeat(table[:, 1:], len(time), axis=0)
    else:
        curve = PchipInterpolator(table[:, 0], table[:, 1:])
        values = curve(np.clip(time, table[0, 0], table[-1, 0]))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / fine / SMOOTHING) ** 2)
    kernel /= kernel.sum()
    smooth = [np.convolve(column, kernel, mode="valid") for column in values.T]
    return np.stack(smooth, axis=1)[::OVERSAMPLING]


def _soft_min(a: np.ndarray, b: np.ndarray | float, width: float) -> np.ndarray:
    """Returns a smooth minimum, at most `width` log 2 below the true one."""
    return -width * np.logaddexp(-a / width, -np.asarray(b) / width)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _turn(axis: str, angle: np.ndarray) -> np.ndarray:
    """Returns (T, 3, 3) rotations about one of the file's axes by (T,) angles."""
    angles = np.zeros((len(angle), 3))
    angles[:, "xyz".index(axis)] = angle
    return rotation_xyz(angles)


def _file_axes(forward_left_up: np.ndarray) -> np.ndarray:
    """Returns (..., 3) vectors (forward, left, up) in the file's axes."""
    return forward_left_up[..., [1, 2, 0]]


def _apply(R: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return np.einsum("tij,tj->ti", R, np.broadcast_to(vectors, (len(R), 3)))


def _angles(R: np.ndarray) -> np.ndarray:
    """Returns (T, 3) angles of (T, 3, 3) rotations Rz Ry Rx, continuous in time."""
    x = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    y = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 2, 1], R[:, 2, 2]))
    z = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    angles = np.stack([x, y, z], axis=1)
    turn = 2.0 * np.pi
    for now in range(1, len(angles)):
        # (x + pi, pi - y, z + pi) is the same rotation: take the nearer of the two.
        other = np.array([np.pi, np.pi, np.pi]) + angles[now] * [1.0, -1.0, 1.0]
        before = angles[now - 1]
        options = [
            a - turn * np.round((a - before) / turn) for a in (angles[now], other)
        ]
        angles[now] = min(options, key=lambda a: np.abs(a - before).sum())
    return angles


def _two_bones(
    to_goal: np.ndarray, bend: np.ndarray, first: float, second: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns (T, 3) unit directions of two bones that reach a goal.

    Args:
        to_goal: (T, 3) from the first bone's start; softly kept within reach [m].
        bend: (T, 3) the way that the joint between the bones points.
        first, second: lengths of the bones [m].
    """
    distance = np.linalg.norm(to_goal, axis=1)
    along = to_goal / distance[:, None]
    reach = first + second
    distance = _soft_min(distance, 0.99 * reach, 0.01 * reach)
    distance = -_soft_min(-distance, -0.26 * reach, 0.02 * reach)
    side = _unit(bend - np.sum(bend * along, axis=1, keepdims=True) * along)
    cosine = (first**2 + distance**2 - second**2) / (2.0 * first * distance)
    joint = first * (cosine[:, None] * along + np.sqrt(1.0 - cosine**2)[:, None] * side)
    return joint / first, _unit(distance[:, None] * along - joint)


def _frame(along: np.ndarray, hinge: np.ndarray) -> np.ndarray:
    """Returns (T, 3, 3) rotations with columns along, hinge, along x hinge."""
    return np.stack([along, hinge, np.cross(along, hinge)], axis=-1)


# --- from samples to joint angles -------------------------------------------------


def make_clip(name: str, choreography: Choreography) -> Clip:
    """Returns the motion on the performer's skeleton, rounded as its file is."""
    skeleton = performer()
    duration = choreography.duration
    num_frames = round(duration * FRAME_RATE) + 1
    time = np.arange(num_frames) / FRAME_RATE
    joints: dict[str, np.ndarray] = {}

    # Nobody stands quite still: breath, and a slow sway.
    breath = np.sin(2.0 * np.pi * 0.27 * time)
    sway = np.sin(2.0 * np.pi * 0.19 * time + 0.8)

    heading = np.radians(_sampled(duration, choreography.heading)[:, 0])
    hips = _sampled(duration, choreography.hips)
    pitch = np.radians(hips[:, 3])
    travel = _sampled(duration, choreography.travel)
    feet = _sampled(duration, choreography.feet)
    ankles, foot_headings = _steps(choreography, travel, heading, feet)

    R_yaw = _turn("y", heading)
    R_hips = R_yaw @ _turn("x", pitch)
    offset = np.stack([hips[:, 0], hips[:, 1] + 0.006 * sway, 0.0 * sway], axis=1)
    root = _apply(R_yaw, _file_axes(offset))
    root[:, 0] += travel[:, 1]
    root[:, 2] += travel[:, 0]
    root[:, 1] = HIP_HEIGHT - 0.012 - hips[:, 2] + 0.002 * breath
    for side, sign in SIDES.items():
        # Not higher than where both ankles are within the legs' reach.
        to_hip = np.array([sign * HIP_HALF_WIDTH, -HIP_DROP, 0.0])
        p_hip = root + _apply(R_hips, to_hip)
        aside = np.sum((p_hip - ankles[side])[:, [0, 2]] ** 2, axis=1)
        highest = ankles[side][:, 1] + np.sqrt((0.985 * (THIGH + SHANK)) ** 2 - aside)
        root[:, 1] = _soft_min(root[:, 1], highest + root[:, 1] - p_hip[:, 1], 0.008)

    for side, sign in SIDES.items():
        to_hip = np.array([sign * HIP_HALF_WIDTH, -HIP_DROP, 0.0])
        leg = _leg(
            R_hips, ankles[side] - root - _apply(R_hips, to_hip), foot_headings[side]
        )
        joints |= {side[0] + bone: angles for bone, angles in leg.items()}

    bend = np.radians(_sampled(duration, choreography.trunk))
    bend[:, 0] += 0.010 * breath
    vertebra = np.stack([bend[:, 0], bend[:, 2], -bend[:, 1]], axis=1) / 3.0
    for bone in ("lowerback", "upperback", "thorax"):
        joints[bone] = vertebra
    # The head keeps looking ahead, as far as the neck lets it.
    nod = np.radians(50.0) * np.tanh(-0.6 * (bend[:, 0] + pitch) / np.radians(50.0))
    joints["upperneck"] = np.stack([nod, -0.5 * bend[:, 2]], axis=1)

    for number, side in enumerate(SIDES, start=1):
        keys = []
        for row in choreography.arms:
            pose = ARM_POSES[row[number]]
            keys.append((row[0], *pose.wrist, *_unit(np.array(pose.elbow))))
        goals = _sampled(duration, keys)
        goals[:, 2] += 0.004 * breath
        arm = _arm(side, goals[:, :3], goals[:, 3:])
        joints |= {side[0] + bone: angles for bone, angles in arm.items()}

    clip = Clip(
        name=name,
        skeleton=skeleton,
        frame_rate=FRAME_RATE,
        root_position=root,
        root_rotation=np.stack([pitch, heading, np.zeros(num_frames)], axis=1),
        joints={bone: joints[bone] for bone, b in skeleton.bones.items() if b.dof},
    )
    return _rounded(clip)


def _rounded(clip: Clip) -> Clip:
    """Returns the clip with few digits: 0.001 degree, 1e-4 file units (6 um)."""

    def degrees(angles: np.ndarray) -> np.ndarray:
        # Adding zero turns -0 into 0.
        return np.radians(np.round(np.degrees(angles), 3) + 0.0)

    unit = clip.skeleton.metres_per_unit
    return replace(
        clip,
        root_position=(np.round(clip.root_position / unit, 4) + 0.0) * unit,
        root_rotation=degrees(clip.root_rotation),
        joints={bone: degrees(angles) for bone, angles in clip.joints.items()},
    )


def _steps(
    choreography: Choreography,
    travel: np.ndarray,
    heading: np.ndarray,
    feet: np.ndarray,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Returns each ankle's (T, 3) position [m] and each foot's (T,) heading [rad].

    A foot stands still, and in turn with the other one steps to where it will be
    needed until its next step.
    """
    num_frames = len(heading)
    time = np.arange(num_frames) / FRAME_RATE
    period = choreography.step
    ankles, headings = {}, {}
    for side, sign in SIDES.items():
        # (forward, left, heading) below the hip joint, wherever the hips go.
        home = np.stack([travel[:, 0], travel[:, 1], heading], axis=1)
        home[:, 0] -= sign * HIP_HALF_WIDTH * np.sin(heading)
        home[:, 1] += sign * HIP_HALF_WIDTH * np.cos(heading)
        begin = 0.0 if side == "left" else 0.5 * period
        stands = [home[0]]
        foot = np.repeat(home[:1], num_frames, axis=0)
        lift = np.zeros(num_frames)
        while begin < choreography.duration:
            middle = round((begin + 0.9 * period) * FRAME_RATE)
            step = home[min(middle, num_frames - 1)] - stands[-1]
            tau = np.clip((time - begin) / (0.45 * period), 0.0, 1.0)
            foot += step * (tau**3 * (10.0 + tau * (6.0 * tau - 15.0)))[:, None]
            size = np.hypot(step[0], step[1]) + 0.1 * abs(step[2])
            lift += min(0.3 * size, 0.07) * 64.0 * (tau * (1.0 - tau)) ** 3
            stands.append(stands[-1] + step)
            begin += period
        apart = sign * feet[:, 0]
        foot[:, 0] -= apart * np.sin(foot[:, 2])
        foot[:, 1] += apart * np.cos(foot[:, 2])
        height = ANKLE_HEIGHT + lift + feet[:, 1]
        ankles[side] = np.stack([foot[:, 1], height, foot[:, 0]], axis=1)
        headings[side] = foot[:, 2] + sign * np.radians(8.0)
    return ankles, headings


def _leg(
    R_hips: np.ndarray, to_ankle: np.ndarray, foot_heading: np.ndarray
) -> dict[str, np.ndarray]:
    """Returns a leg's joint angles; the foot stays level.

    Args:
        R_hips: (T, 3, 3) orientation of the hips.
        to_ankle: (T, 3) from the hip joint, in the world's axes [m].
        foot_heading: (T,) the way that the foot points [rad].
    """
    R_foot = _turn("y", foot_heading)
    ahead = R_foot[:, :, 2] + R_hips[:, :, 2]
    thigh, shank = _two_bones(to_ankle, ahead, THIGH, SHANK)
    hinge = _unit(np.cross(ahead, thigh))  # to the performer's left
    rest = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R_rest = _frame(rest[:1], rest[1:2])[0]
    R_thigh = _frame(thigh, hinge) @ R_rest.T
    flexion = np.arccos(np.clip(np.sum(thigh * shank, axis=1), -1.0, 1.0))
    R_shank = R_thigh @ _turn("x", flexion)
    return {
        "femur": _angles(np.swapaxes(R_hips, 1, 2) @ R_thigh),
        "tibia": flexion[:, None],
        "foot": _angles(np.swapaxes(R_shank, 1, 2) @ R_foot),
    }


def _arm(side: str, wrist: np.ndarray, elbow: np.ndarray) -> dict[str, np.ndarray]:
    """Returns an arm's joint angles.

    Args:
        side: "left" or "right".
        wrist: (T, 3) forward, outward, up of the shoulder [arm lengths].
        elbow: (T, 3) the way that the elbow points, likewise.
    """
    sign = SIDES[side]
    mirror = np.array([1.0, sign, 1.0])
    # The shoulder rises with the hand and follows it forward.
    rise = np.radians(16.0) * 0.5 * (1.0 + np.tanh(3.0 * (wrist[:, 2] - 0.5)))
    forth = np.radians(10.0) * np.tanh(1.5 * (wrist[:, 0] - 0.1))
    clavicle = np.stack([-sign * forth, sign * rise], axis=1)
    R_clavicle = _turn("z", clavicle[:, 1]) @ _turn("y", clavicle[:, 0])
    R_back = np.swapaxes(R_clavicle, 1, 2)

    upper, fore = _two_bones(
        _apply(R_back, _file_axes(wrist * mirror)) * (UPPER_ARM + FOREARM),
        _apply(R_back, _file_axes(elbow * mirror)),
        UPPER_ARM,
        FOREARM,
    )
    hinge = _unit(np.cross(upper, fore))
    at_rest = _frame(np.array([[sign, 0.0, 0.0]]), np.array([[0.0, -sign, 0.0]]))[0]
    R_upper = _frame(upper, hinge) @ at_rest.T
    C = rotation_xyz(_HUMERUS_AXIS[side])
    flexion = np.arccos(np.clip(np.sum(upper * fore, axis=1), -1.0, 1.0))
    return {
        "clavicle": clavicle,
        "humerus": _angles(C.T @ R_upper @ C),
        "radius": flexion[:, None],
    }


def write_motions(folder: Path) -> None:
    """Writes performer.asf and every motion's AMC file into the folder."""
    write_asf(folder / "performer.asf", performer())
    for name, choreography in MOTIONS.items():
        write_amc(folder / f"{name}.amc", make_clip(name, choreography()))


if __name__ == "__main__":
    write_motions(builtin_motions_folder())
