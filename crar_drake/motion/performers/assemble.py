"""From joint centres in a file's own axes and unit to the performer in the world."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import across, unit_vectors
from crar_drake.motion.file_frame import (
    ANKLE_SHARE,
    LEG_SHARE,
    find_frame,
    leg_length,
    seems_mirrored,
    stands_along,
)
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import (
    ARM,
    JOINTS,
    LEG,
    SIDES,
    Described,
    Fact,
    Performer,
    Points,
    heading_of,
)
from crar_drake.motion.plausible import refuse_far
from crar_drake.motion.rates import rate_doubt

# A performer whose feet are no farther than this from the file's zero height stands
# on it; else the file's origin is elsewhere (often at the pelvis).
_FLOOR = 0.15  # [m]
_FLOOR_QUANTILE = 0.02  # of the frames, by which single bad frames do not count

# A whole body moves this fast from one frame to the next, and this many times as fast
# as ever later: what is before is a pose apart, which converters write first (or last:
# the same in reversed time), once or some frames long. Out of the zero pose, which is
# none of a motion, less tells it.
_APART_SPEED = 6.0  # [m/s]
_APART_SPEED_AT_REST = 2.0  # [m/s]
_APART_FACTOR = 5.0
_HELD_TIME = 1.0  # [s]
_HELD_SPEED = 0.1  # [m/s] of a pose that is held

REQUIRED = (
    "pelvis",
    "neck",
    *(f"{side}_{joint}" for side in SIDES for joint in (*ARM, *LEG)),
)


MIRRORED = (
    "left and right are swapped in the file, for toes or knees point backwards: taken "
    "the other way; --joints FILE takes it as it says"
)


@dataclass(frozen=True, kw_only=True)
class Recording(Described):
    """What a format gives, in the file's own axes F and units."""

    positions: Points  # name of JOINTS to (T, 3) p_FJ, REQUIRED among them
    # name of JOINTS to (3,) in a standing rest pose; empty if there is none
    rest: Points = field(default_factory=dict)
    # name of JOINTS to (T, 3, 3) R_FJ, the identity in the rest pose where there is one
    rotations: Mapping[str, np.ndarray] = field(default_factory=dict)
    # (3, 3) axes of a body (x ahead, y to the left, z up) in those that `rotations`
    # turn, where these have a rest pose, a T-pose with palms down, that lies in the
    # file as the format says, not along its up axis; None elsewhere
    body_axes: np.ndarray | None = None
    # whether the body's lengths are not the person's, and so the file's height 0 not
    # its floor
    floor_unknown: bool = False
    # (T, 3) what is up in the pelvis; the neck from it by default
    pelvis_up: np.ndarray | None = None
    # hand to the vectors (T, 3) to its fingertips and to its thumb's side
    hands: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    unit: str = ""  # what the file states, a key of `options.UNITS`, or ""
    # where the unit comes from, if the positions are in metres already
    unit_fact: Fact | None = None
    up: str = ""  # axis that the file states, or ""
    doubts: tuple[str, ...] = ()  # as in `Performer`
    facts: tuple[Fact, ...] = ()  # as in `Performer`


def assemble(recording: Recording, options: MotionOptions) -> Performer:
    """Returns the performer of a recording, in metres and the robot's world.

    Raises:
        MotionError: joints are missing, there are fewer than two frames, no unit makes
            a person of it, or its hips coincide.
    """
    p = recording.positions
    name = recording.name
    missing = [joint for joint in REQUIRED if joint not in p]
    if missing:
        raise MotionError(
            f"motion {name}: no {', '.join(missing)} in it; found: "
            f"{', '.join(recording.joints.values()) or 'nothing'}"
        )
    if len(p["pelvis"]) < 2:
        raise MotionError(
            f"motion {name}: it has a single frame; at least 2 are needed"
        )
    for joint, samples in p.items():
        refuse_far(f"motion {name}: {joint}", samples)
    mirrored = seems_mirrored(p)
    frame = find_frame(
        p,
        recording.rest,
        recording.unit,
        options,
        name,
        up_stated=recording.up,
        unit_fact=recording.unit_fact,
    )
    doubts = [*recording.doubts, *frame.doubts]
    if mirrored:
        doubts.append("toes or knees point backwards: left and right seem swapped")
    if doubt := rate_doubt(recording.frame_rate):
        doubts.append(doubt)
    R_WF = frame.R_WF
    world = {joint: frame.metres * p[joint] @ R_WF.T for joint in JOINTS if joint in p}
    facts = [*frame.facts, *recording.facts]
    within = 0.0 if recording.floor_unknown else _FLOOR
    floor, floor_fact = _floor(world, leg_length(world), within)
    world = {joint: q - [0.0, 0.0, floor] for joint, q in world.items()}
    if floor_fact is not None:
        facts.append(floor_fact)
    R_WP, orientations, orientation_fact = _orientations(recording, world, R_WF)
    facts.append(orientation_fact)
    leg = leg_length(world)
    hips = (world["left_hip"] + world["right_hip"]) / 2.0
    drop = float(np.median(np.sum((world["pelvis"] - hips) * R_WP[:, :, 2], axis=1)))
    known = {field.name: getattr(recording, field.name) for field in fields(Described)}
    return Performer(
        **known,
        positions=world,
        orientations=orientations,
        hands={
            hand: _frames(*(v @ R_WF.T for v in vectors))
            for hand, vectors in _hands(recording).items()
        },
        heading=heading_of(R_WP),
        hip_height=drop + leg * (1.0 + ANKLE_SHARE / LEG_SHARE),
        height=leg / LEG_SHARE,
        up=frame.up,
        facing=frame.facing,
        facts=tuple(facts),
        doubts=tuple(doubts),
    )


def frames_apart(p: Points, frame_rate: float, at_rest: np.ndarray) -> int:
    """Number of frames at the beginning that are a pose by themselves, as a T-pose.

    It is held for up to a second, and the body then leaps out of it.

    Args:
        p: in any unit.
        frame_rate: samples per second [Hz].
        at_rest: (T,) whether the skeleton is in its zero pose; out of it a smaller
            leap counts.
    """
    leg = leg_length(p)
    if not leg > 0.0:
        return 0
    # Against the pelvis, in heights per second.
    scale = 1.6 * LEG_SHARE / leg
    moving = [q - p["pelvis"] for joint, q in p.items() if joint != "pelvis"]
    steps = np.mean(
        [np.linalg.norm(np.diff(q, axis=0), axis=1) for q in moving], axis=0
    )
    speed = steps * scale * frame_rate
    held = max(1, int(_HELD_TIME * frame_rate))
    # What is apart is the shorter part.
    for last in range(min(len(speed) - 9, len(speed) // 2, held)):
        leap, later = speed[last], speed[last + 1 :]
        usual = max(float(np.quantile(later, 0.99)), float(later[:5].max()))
        least = _APART_SPEED_AT_REST if at_rest[: last + 1].all() else _APART_SPEED
        if leap > least and leap > _APART_FACTOR * usual:
            return last + 1
        if leap > _HELD_SPEED:
            break
    return 0


def _floor(p: Points, leg: float, within: float) -> tuple[float, Fact | None]:
    """Height of the floor in the file [m], 0 if the body comes as near as `within`."""
    lowest = np.min([q[:, 2] for q in p.values()], axis=0)
    height = float(np.quantile(lowest, _FLOOR_QUANTILE))
    if not any(joint.endswith("toe") for joint in p):
        height -= leg * ANKLE_SHARE / LEG_SHARE
    if abs(height) < within:
        return 0.0, None
    why = "the lowest that the body comes"
    return height, Fact("floor", f"at {height:.2f} m of the file", "inferred", why)


def _hands(recording: Recording) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
    """As in `Recording.hands`: in a T-pose fingers point outwards, thumbs ahead."""
    if recording.body_axes is None:
        return recording.hands
    ahead, left, _ = recording.body_axes.T
    outwards = {"left": left, "right": -left}
    R = recording.rotations
    return {
        f"{side}_hand": (
            R[f"{side}_wrist"] @ outwards[side],
            R[f"{side}_wrist"] @ ahead,
        )
        for side in SIDES
    }


def _frames(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations whose first axis is along x and whose third near z."""
    x = unit_vectors(x)
    z = unit_vectors(across(z, x))
    return np.stack([x, np.cross(z, x), z], axis=2)


def _orientations(
    recording: Recording, world: Points, R_WF: np.ndarray
) -> tuple[np.ndarray, dict[str, np.ndarray], Fact]:
    """R_WP of the pelvis, those of all parts, and where they come from."""
    rotations = recording.rotations
    if recording.body_axes is not None:
        turned = {
            joint: R_WF @ R @ recording.body_axes for joint, R in rotations.items()
        }
        why = "against the model's rest pose"
        return turned["pelvis"], turned, Fact("orientations", "", "file", why)
    turned = {joint: R_WF @ R @ R_WF.T for joint, R in rotations.items()}
    if turned and recording.rest and stands_along(recording.rest, R_WF[2]):
        why = "against the standing rest pose"
        return turned["pelvis"], turned, Fact("orientations", "", "file", why)
    # By geometry: y to the left hip, z up in the pelvis.
    y = world["left_hip"] - world["right_hip"]
    if recording.pelvis_up is None:
        z = world["neck"] - world["pelvis"]
    else:
        z = recording.pelvis_up @ R_WF.T
    if (lost := ~y.any(axis=1) & z.any(axis=1)).any():
        raise MotionError(
            f"motion {recording.name}: both hips are in one place in frame "
            f"{lost.argmax() + 1}, so that nothing says where it faces; repair the file"
        )
    y = unit_vectors(y)
    z = unit_vectors(across(z, y))
    R_WP = np.stack([np.cross(y, z), y, z], axis=2)
    if not turned:
        fact = Fact("orientations", "of the pelvis", "inferred", "from hips and trunk")
        return R_WP, {"pelvis": R_WP}, fact
    # The zero pose is no standing person: the most upright frame stands in for it.
    bones = [world["neck"] - world["pelvis"]] + [
        world[f"{side}_{a}"] - world[f"{side}_{b}"]
        for side in SIDES
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    upright = np.min([v[:, 2] / np.linalg.norm(v, axis=1) for v in bones], axis=0)
    k = int(np.argmax(upright))
    c, s = np.cos(heading_of(R_WP)[k]), np.sin(heading_of(R_WP)[k])
    yaw = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    orientations = {joint: R @ R[k].T @ yaw for joint, R in turned.items()}
    why = f"against frame {k + 1}, the most upright: the zero pose is not standing"
    fact = Fact("orientations", "", "inferred", why)
    return R_WP, orientations | {"pelvis": R_WP}, fact
