"""A file's unit, up axis and facing, inferred from the body that moves in it."""

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import across, unit_vectors
from crar_drake.motion.options import AXES, UNITS, MotionOptions, axis_of, metres_of
from crar_drake.motion.performer import SIDES, Fact, Points
from crar_drake.motion.plausible import HEIGHTS

# Body proportions after Drillis and Contini (in D. A. Winter, Biomechanics and Motor
# Control of Human Movement): hip 0.530, ankle 0.039 of the height.
ANKLE_SHARE = 0.039
LEG_SHARE = 0.530 - ANKLE_SHARE  # from hip to ankle

# Grown people; two units that differ by more than the quotient cannot both fit.
_USUAL_HEIGHTS = (1.2, 2.1)  # [m]

_UPRIGHT = np.cos(np.radians(40.0))  # of the trunk and legs against the vertical
_ALONG_AXIS = np.cos(np.radians(25.0))  # of a rest pose
_ENOUGH_UPRIGHT = 0.15  # share of the frames


@dataclass(frozen=True)
class FileFrame:
    """How a file's numbers become positions in the robot's world W."""

    metres: float  # in one unit of the file [m]
    R_WF: np.ndarray  # (3, 3) the file's axes in W, a permutation with signs
    up: str  # the file's axis that becomes z of W
    facing: str  # and that which becomes x
    facts: tuple[Fact, ...]  # what was given, inferred or assumed
    doubts: tuple[str, ...]  # what does not fit


def leg_length(p: Points) -> float:
    """Thigh and shank, the mean of both sides and the median of the frames [units]."""
    lengths = [
        np.linalg.norm(p[f"{side}_{b}"] - p[f"{side}_{a}"], axis=-1)
        for side in SIDES
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    return float(np.median(np.sum(lengths, axis=0))) / 2.0


def find_unit(
    p: Points, stated: str, options: MotionOptions, name: str
) -> tuple[float, Fact, tuple[str, ...]]:
    """Metres in a unit, where that comes from, and doubts.

    Lengths of p are in the file's units; it states one of UNITS, or "".

    Raises:
        MotionError: no unit makes a person of these legs.
    """
    tall = leg_length(p) / LEG_SHARE
    if not tall > 0.0:
        raise MotionError(f"motion {name}: the legs have no length")
    least, most = HEIGHTS
    if options.unit:
        metres = metres_of(options.unit)
        doubts = ()
        if not least <= metres * tall <= most:
            doubts = (
                f"standing height {metres * tall:.3g} m is implausible, with unit "
                f"{options.unit}",
            )
        return metres, Fact("unit", options.unit, "given"), doubts
    heights = {unit: tall * metres for unit, metres in UNITS.items()}
    if stated:
        if least <= heights[stated] <= most:
            return UNITS[stated], Fact("unit", stated, "file"), ()
        raise MotionError(
            f"motion {name}: its unit, {stated}, would make a person of "
            f"{heights[stated]:.3g} m; say which it is: --unit "
            f"{'|'.join(unit for unit in UNITS if unit != stated)}"
        )
    for low, high in (_USUAL_HEIGHTS, HEIGHTS):
        fitting = [unit for unit in UNITS if low <= heights[unit] <= high]
        if fitting:
            middle = np.sqrt(low * high)
            unit = min(fitting, key=lambda u: abs(np.log(heights[u] / middle)))
            why = f"so the performer is {heights[unit]:.2f} m tall by the legs"
            return UNITS[unit], Fact("unit", unit, "inferred", why), ()
    listed = ", ".join(f"{height:.3g} m in {u}" for u, height in heights.items())
    raise MotionError(
        f"motion {name}: in no unit are these legs a person's; by them the performer "
        f"would be tall: {listed}; say the unit, or the metres in one: --unit"
    )


def find_frame(
    p: Points,
    rest: Points,
    stated: str,
    options: MotionOptions,
    name: str,
    *,
    up_stated: str = "",
    unit_fact: Fact | None = None,
) -> FileFrame:
    """Infers unit, up and facing, but for what the user says.

    Args:
        p: in the file's axes and units.
        rest: as the skeleton stands at rest; empty if it does not say.
        stated, options, name: as of `find_unit`.
        up_stated: up axis that the file states, or "".
        unit_fact: where the unit comes from, if p is in metres.

    Raises:
        MotionError: no unit makes a person, or facing is along up.
    """
    if unit_fact is not None:
        metres, unit, doubts = 1.0, unit_fact, ()
    else:
        metres, unit, doubts = find_unit(p, stated, options, name)
    up, up_fact, up_doubts = _find_up(p, rest, options, up_stated)
    facing, facing_fact = _find_facing(p, rest, options, up, name)
    z, x = _vector(up), _vector(facing)
    return FileFrame(
        metres,
        np.stack([x, np.cross(z, x), z]),
        up,
        facing,
        (unit, up_fact, facing_fact),
        doubts + up_doubts,
    )


def _vector(axis: str) -> np.ndarray:
    sign = -1.0 if axis[0] == "-" else 1.0
    return sign * np.eye(3)["xyz".index(axis[1])]


def trunk_and_legs(p: Points) -> np.ndarray:
    """(..., 3) unit vector from the ankles' middle to the neck."""
    return unit_vectors(p["neck"] - (p["left_ankle"] + p["right_ankle"]) / 2.0)


def stands_along(rest: Points, up: np.ndarray) -> bool:
    """Whether a rest pose, joint to (3,), stands along a unit vector."""
    return bool(trunk_and_legs(rest) @ up > _ALONG_AXIS)


def _find_up(
    p: Points, rest: Points, options: MotionOptions, stated: str
) -> tuple[str, Fact, tuple[str, ...]]:
    """The axis along which the performer stands for the longest time.

    The rest pose's axis comes first if he stands along it for some time, or if he
    hardly ever stands along any: then he lies or rolls.
    """
    if options.up:
        axis = axis_of(options.up, "up")
        return axis, Fact("up", axis, "given"), ()
    upright = trunk_and_legs(p)
    share = {axis: np.mean(upright @ _vector(axis) > _UPRIGHT) for axis in AXES}
    best = max(AXES, key=lambda axis: share[axis])
    if stated:
        return stated, Fact("up", stated, "file"), ()
    if rest:
        standing = trunk_and_legs(rest)
        axis = max(AXES, key=lambda a: standing @ _vector(a))
        if stands_along(rest, _vector(axis)):
            if share[axis] >= _ENOUGH_UPRIGHT or share[best] < 0.5:
                return axis, Fact("up", axis, "inferred", "from the rest pose"), ()
            doubt = (
                f"the rest pose stands along {axis}, but the performer along {best} "
                f"all the time; --up {axis} if he only lies"
            )
            fact = Fact("up", best, "inferred", "along which the performer stands")
            return best, fact, (doubt,)
    if share[best] >= _ENOUGH_UPRIGHT:
        why = f"upright along it for {100.0 * share[best]:.0f} % of the time"
        return best, Fact("up", best, "inferred", why), ()
    mean = upright.mean(axis=0)
    best = max(AXES, key=lambda axis: mean @ _vector(axis))
    doubt = f"the performer never stands, so that up, {best}, is a guess: --up AXIS"
    return best, Fact("up", best, "assumed", "nearest to the body"), (doubt,)


def body_forward(p: Points) -> np.ndarray:
    """(..., 3) where the pelvis faces: left times up of the body."""
    left = p["left_hip"] - p["right_hip"]
    return unit_vectors(np.cross(left, p["neck"] - p["pelvis"]))


def _find_facing(
    p: Points, rest: Points, options: MotionOptions, up: str, name: str
) -> tuple[str, Fact]:
    """The horizontal axis nearest to where the performer faces at rest, or at first."""
    if options.facing:
        axis = axis_of(options.facing, "facing")
        if axis[1] == up[1]:
            raise MotionError(
                f"motion {name}: facing {options.facing} is along the up axis, {up}"
            )
        return axis, Fact("facing", axis, "given")
    upright = trunk_and_legs(p) @ _vector(up) > _UPRIGHT
    frame = int(np.argmax(upright))
    z = _vector(up)
    why = f"where the performer faces in frame {frame + 1}"
    forward = body_forward({joint: q[frame] for joint, q in p.items()})
    if rest and stands_along(rest, z):
        forward, why = body_forward(rest), "from the rest pose"
    horizontal = [axis for axis in AXES if axis[1] != up[1]]
    axis = max(horizontal, key=lambda a: round(float(forward @ _vector(a)), 9))
    return axis, Fact("facing", axis, "inferred", why)


def seems_mirrored(p: Points) -> bool | None:
    """Whether left and right are swapped: toes and knees point backwards, in any axes
    and units. None if neither tells."""
    forward = body_forward(p)
    toes = [
        unit_vectors(p[f"{side}_toe"] - p[f"{side}_ankle"])
        for side in SIDES
        if f"{side}_toe" in p
    ]
    score = np.median([np.sum(toe * forward, axis=-1) for toe in toes] or [0.0])
    if abs(score) > 0.3:
        return bool(score < 0.0)
    bends = []
    for side in SIDES:
        hip, knee, ankle = (p[f"{side}_{joint}"] for joint in ("hip", "knee", "ankle"))
        out = across(knee - hip, unit_vectors(ankle - hip))
        bends.append(np.sum(out * forward, axis=-1))
    bend = float(np.mean(bends)) / leg_length(p)
    return bool(bend < 0.0) if abs(bend) > 0.01 else None
