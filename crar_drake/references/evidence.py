"""What a file's own evidence says of the ways to read it.

A robot is mostly upright, its lowest points are on the floor, its joints are within
their limits, and its links where the file says that they are (`robot_match`). A reading
that evidence refutes is not taken while another fits, and two that fit alike are
refused, both named.

Of quaternions without a name for their columns continuity tells nothing: whatever the
order, the angle from one sample to the next is the same. Read in the wrong order, a
root that is upright and looks along +x is either upside down (1 0 0 0), or it is
upright as well but looks along -x (0 0 0 1). There only which way it goes tells, or
that motions tend to start along +x, a weak evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.references.layout_reader import ORDER_UNKNOWN, Reading
from crar_drake.references.layouts import TURN
from crar_drake.references.robot_match import KNOWN_BY_ORDER, matched
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.standing import Standing, mean_tilt
from crar_drake.references.whole_body import WholeBody

# How much less tilted one order must be than the other, on average [rad].
_CLEAR = np.radians(15.0)

# So much less, and less than a third, are against what files are meant to be [rad].
_DOUBTED, _THIRD = np.radians(6.0), 1.0 / 3.0

# A motion that is more tilted than this tells nothing of the order [rad].
_TILTED = np.radians(60.0)

# Who goes so far [m], and this share of it where he looks, goes forwards. The readings'
# speeds differ by twice his: a little is a walk, more is none backwards [m/s].
_WAY, _ALONG = 0.5, 0.5
_SLOW, _FAST = 0.2, 2.0

# Nothing is so far above or below the floor all the time; and what is doubtful [m].
_FAR, _OFF = 2.0, 0.3

# What positions may be in, and how long it is [m].
_UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}

# A motion in degrees whose largest angle is between these may be one in radians [rad].
_FEW_DEGREES = np.radians([0.35, np.pi])

# Joints of another robot, or in another order or unit, are beyond their limits: at
# least so many by so much, and so much in total [rad].
_BEYOND, _HOW_MANY, _TOTAL = 0.4, 2, 1.5

# From a world with y up to one with z up, as x y z w.
_FROM_Y_UP = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]


def settled(
    readings: Sequence[Reading], robot: WholeBody | None, trusted: bool = False
) -> RobotMotion:
    """The motion that a file means; with a robot its joints are named, in its order.

    Args:
        readings: all that the file may mean.
        robot: that it is a motion of.
        trusted: whether the file was written here for this very robot.

    Raises:
        MotionError: evidence refutes the reading, two fit alike, or it is a motion of
            another robot; the message says what is expected.
    """
    left = _of_order(readings, robot)
    if robot is not None:
        left = [replace(r, motion=matched(r.motion, robot)) for r in left]
    if len({r.motion.layout for r in left} & set(KNOWN_BY_ORDER)) > 1:
        first = left[0].motion
        if not first.joint_names or robot is not None:
            known = readings[0].motion.guesses
            said = next(guess for guess in known if guess.startswith(ORDER_UNKNOWN))
            raise MotionError(
                f"{first.source}: {said}; say it with --layout mjlab-npz or "
                "beyondmimic-npz, or which robot it is with --robot"
            )
    if robot is None:
        return left[0].motion
    reading = _by_height(left, robot)
    return reading.motion if trusted else _unrefuted(reading, readings, robot)


# --- the root's orientation and height --------------------------------------------


def _of_order(
    readings: Sequence[Reading], robot: WholeBody | None = None
) -> list[Reading]:
    """The readings with the order of the quaternion that evidence prefers."""
    first = next((reading for reading in readings if reading.usual), readings[0])
    of: dict[str, Reading] = {}
    for reading in readings:
        of.setdefault(reading.order, reading)
    if first.said or len(of) == 1:
        return list(readings)
    if len({reading.layout.parts[1] for reading in readings}) > 1:
        # Numbers of length 1 in either place: those of one of them by chance.
        names = " or ".join(dict.fromkeys(r.layout.name for r in readings))
        raise MotionError(
            f"{first.motion.source}: it may be {names}: say it with --layout"
        )
    order, evidence = guess_quaternion_order({k: r.motion for k, r in of.items()})
    if not evidence.startswith("sure"):
        stands = _that_stands(readings, robot)
        other = of[next(k for k in of if k != first.order)]
        doubted = first.usual and _is_doubted(first, other)
        if stands:
            order = stands
            evidence = f"{evidence}, and as {order} it stands on the floor"
        elif first.usual:
            order = other.order if doubted else first.order
        if (order != first.order and other.layout == first.layout and first.usual) or (
            doubted and stands == first.order
        ):
            name = first.layout.name
            raise MotionError(
                f"{first.motion.source}: quaternions may be {first.order}, as {name} "
                f"has them, or {other.order} ({evidence}): say --layout {name} if they "
                f"are {first.order}, else convert the file"
            )
    if not order:
        layouts = " or ".join(reading.layout.name for reading in of.values())
        columns = first.layout.root_columns + first.motion.num_joints
        raise MotionError(
            f"{first.motion.source}: whether the quaternion's columns are xyzw or wxyz "
            f"cannot be guessed ({evidence}); say it with --layout {layouts}, if the "
            f"first 7 of its {columns} columns are the root, and the others joints"
        )
    chosen = [reading for reading in readings if reading.order == order]
    if first.usual and order == first.order:
        return chosen
    guess = f"quaternions are {order}: {evidence}"
    if first.usual and chosen[0].layout == first.layout:
        name, key = first.layout.name, first.layout.parts[1].keys[0]
        guess = (
            f"{key} is {order}, not {first.order} as {name} has it: {evidence} "
            f"(--layout {name} takes it as {first.order})"
        )
    return [reading.guessing(guess) for reading in chosen]


def _is_doubted(usual: Reading, other: Reading) -> bool:
    """Whether evidence is against the order that files are meant to have."""
    tilted, less = (mean_tilt(r.motion.root_rotations) for r in (usual, other))
    looks_back = abs(_first_heading(usual.motion)) > 3.0 * np.pi / 4.0
    ahead = _forwards(other.motion) - _forwards(usual.motion)
    return bool(
        ahead > (_SLOW if looks_back else _FAST)
        or (tilted - less > _DOUBTED and less < _THIRD * tilted)
    )


def _that_stands(readings: Sequence[Reading], robot: WholeBody | None) -> str:
    """The order in which the robot stands on the floor, and clearly better than in the
    other; "" if there is none."""
    costs: dict[str, float] = {}
    for reading in readings if robot is not None else ():
        with suppress(MotionError):
            standing = Standing(matched(reading.motion, robot), robot)
            if standing.on_floor:
                least = costs.get(reading.order, np.inf)
                costs[reading.order] = min(standing.cost, least)
    best = min(costs, key=costs.get, default="")
    clear = all(costs[best] < c - 1.0 for o, c in costs.items() if o != best)
    return best if clear else ""


def guess_quaternion_order(read: dict[str, RobotMotion]) -> tuple[str, str]:
    """Guesses the order of the root's quaternion.

    Args:
        read: each order to the motion that is read in it.

    Returns:
        One of the orders or, without any evidence, ""; and the evidence in words, which
        begins with "sure" where it is.
    """
    tilt = {name: mean_tilt(motion.root_rotations) for name, motion in read.items()}
    order, other = sorted(tilt, key=tilt.get)
    evidence = (
        f"as {order} the root's z axis is on average {np.degrees(tilt[order]):.0f} "
        f"degrees from the vertical, as {other} {np.degrees(tilt[other]):.0f}"
    )
    if tilt[order] > _TILTED:
        return "", evidence
    if tilt[other] - tilt[order] >= _CLEAR:
        return order, f"sure: {evidence}"
    ahead = {name: _forwards(motion) for name, motion in read.items()}
    order, other = sorted(ahead, key=ahead.get, reverse=True)
    along = {name: abs(_first_heading(motion)) for name, motion in read.items()}
    looks, away = sorted(along, key=along.get)
    if along[looks] > np.pi / 4.0 or along[away] < 3.0 * np.pi / 4.0:
        looks = ""
    if ahead[order] > _SLOW / 2.0:
        if looks not in ("", order) and ahead[order] < _FAST / 2.0:
            return "", f"{evidence}, and as {order} it goes forwards from -x"
        how = f"as {order} it goes forwards, as {other} backwards"
        return order, f"NOT sure: {evidence}, and {how} (say --layout if that is wrong)"
    if not looks:
        return "", evidence
    return looks, (
        f"NOT sure: {evidence}, and as {looks} it looks along +x at first, as {away} "
        "along -x (say --layout if that is wrong)"
    )


def _forwards(motion: RobotMotion) -> float:
    """How fast the root goes where it looks, on average [m/s]; 0 if it goes nowhere, or
    mostly elsewhere."""
    steps = np.diff(motion.root_positions[:, :2], axis=0)
    looks = motion.root_rotations[:-1].apply([1.0, 0.0, 0.0])[:, :2]
    way, along = np.linalg.norm(steps, axis=1).sum(), float(np.sum(steps * looks))
    if way < _WAY or abs(along) < _ALONG * way:
        return 0.0
    return along / motion.duration


def _first_heading(motion: RobotMotion) -> float:
    """Of the x axis in the first frame [rad]."""
    x, y, _ = motion.root_rotations[0].apply([1.0, 0.0, 0.0])
    return float(np.arctan2(y, x))


def _by_height(readings: list[Reading], robot: WholeBody) -> Reading:
    """That of readings which differ by the root's height alone that is on the floor."""
    usual = next((reading for reading in readings if reading.usual), readings[0])
    if len(readings) == 1:
        return usual
    best = min(readings, key=lambda r: Standing(r.motion, robot).off_floor)
    p, other = usual.motion.root_positions, best.motion.root_positions
    if np.array_equal(p, other):
        return usual
    return best.guessing("heights are those above the floor: so it stands")


# --- near relatives ---------------------------------------------------------------


def _unrefuted(
    reading: Reading, readings: Sequence[Reading], robot: WholeBody
) -> RobotMotion:
    """The motion of a reading.

    Raises:
        MotionError: evidence refutes it, or prefers a near relative.
    """
    motion, source = reading.motion, reading.motion.source
    standing = Standing(motion, robot)
    low = standing.lowest
    for what, other in _relatives(reading, readings):
        if standing.on_floor and not (_raised(reading) and "y up" in what):
            continue
        stands = Standing(other, robot)
        if stands.on_floor and stands.tilt < max(standing.tilt, _TILTED):
            raise MotionError(
                f"{source}: as {motion.layout} has it, the robot's lowest points are "
                f"at {np.median(low):.3g} m and its root is tilted by "
                f"{np.degrees(standing.tilt):.0f} degrees; {what} it stands on the "
                "floor: convert the file first"
            )
    if low.size and (low.min() > _FAR or low.max() < -_FAR):
        raise MotionError(
            f"{source}: the root is at {np.median(motion.root_positions[:, 2]):.4g} m, "
            f"and the robot's lowest point at {np.median(low):.4g} m, never near the "
            "floor: are these centimetres or millimetres?"
        )
    _refuse_radians(reading, standing, robot)
    many = (standing.beyond > _BEYOND).sum() >= _HOW_MANY
    if many and standing.beyond.sum() > _TOTAL:
        q = motion.joint_positions
        over = np.maximum(robot.lower - q, q - robot.upper)
        frame, i = np.unravel_index(over.argmax(), over.shape)
        raise MotionError(
            f"{source}: {robot.joint_names[i]} is at {q[frame, i]:.1f} in frame "
            f"{frame + 1}, its limits are {robot.lower[i]:.2f}, {robot.upper[i]:.2f} "
            "[rad, m], and others are as far off: is the file in degrees, are its "
            "joints in another order, or is it of another robot?"
        )
    feet = {"left_foot", "right_foot"} <= robot.description.task_frames.keys()
    if feet and low.size and (low.min() > _OFF or low.max() < -_OFF):
        told = f"heights are the file's: its lowest point is at {np.median(low):.2f} m"
        motion = replace(motion, guesses=(*motion.guesses, told))
    return motion


def _relatives(
    reading: Reading, readings: Sequence[Reading]
) -> Iterator[tuple[str, RobotMotion]]:
    """Yields what a reading is easily taken for: in words, and what it would be."""
    motion, layout = reading.motion, reading.layout
    p = motion.root_positions
    zero = np.array([0.0, 0.0, _raised(reading)])
    for unit, metre in _UNITS.items():
        # What is low is not made of smaller units: a root may be on the floor itself.
        high = zero.any() or np.median(p[:, 2]) > _FAR
        if metre > layout.metre or (metre < layout.metre and high):
            scaled = (p - zero) * (metre / layout.metre) + zero
            yield f"with positions in {unit}", replace(motion, root_positions=scaled)
    heights = {0.0, *(r.layout.raised for r in readings)}
    for other, raised in product(readings, heights):
        words = [f"quaternions {other.order}"] * (other.order != reading.order)
        words += [f"heights above {raised:g} m"] * bool(raised)
        up = p + [0.0, 0.0, raised]
        turned = other.motion.root_rotations
        if words:
            told = f"with {' and '.join(words)}"
            yield told, _moved(motion, up, turned)
        if not reading.said:
            from_y_up = Rotation.from_quat(_FROM_Y_UP)
            turned = from_y_up * turned
            up = from_y_up.apply(p - zero) + [0.0, 0.0, raised]
            yield " and ".join(["with y up", *words]), _moved(motion, up, turned)
    if layout.order == TURN:
        rows = readings[0].motion.computed["rows"]
        swapped = _moved(motion, rows[:, 3:6], Rotation.from_rotvec(rows[:, :3]))
        yield "with rotation before position", swapped
        last = _moved(motion, rows[:, -6:-3], Rotation.from_rotvec(rows[:, -3:]))
        if motion.num_joints == rows.shape[1] - 6:
            yield "with the root last", replace(last, joint_positions=rows[:, :-6])


def _raised(reading: Reading) -> float:
    """How much higher the root is than the file says [m]."""
    columns = 7 + reading.motion.num_joints
    has = columns == reading.layout.raised_columns
    return reading.layout.raised if has else 0.0


def _moved(motion: RobotMotion, p: np.ndarray, R: Rotation) -> RobotMotion:
    Q = R.as_quat()[:, [3, 0, 1, 2]]
    return replace(motion, root_positions=p, root_quaternions=Q)


def _refuse_radians(reading: Reading, standing: Standing, robot: WholeBody) -> None:
    """Raises MotionError where angles, meant to be degrees, may be radians."""
    motion, radian = reading.motion, reading.layout.radian
    largest = np.abs(motion.joint_positions).max(initial=0.0)
    if radian == 1.0 or not _FEW_DEGREES[0] < largest <= _FEW_DEGREES[1]:
        return
    other = replace(motion, joint_positions=motion.joint_positions / radian)
    radians = Standing(other, robot)
    if (radians.beyond > _BEYOND).any() or standing.cost < radians.cost - 1.0:
        return
    raise MotionError(
        f"{motion.source}: no joint is beyond {np.degrees(largest):.2g} of 0: are "
        f"these degrees, as {motion.layout} has them, or radians? Convert the "
        "file if they are radians"
    )
