"""The performer of an ASF skeleton with the CMU database's bone names."""

from collections.abc import Iterator

import numpy as np

from crar_drake.motion.formats.asf_amc import (
    CMU_LENGTH,
    Clip,
    Skeleton,
    bone_end,
    clip_tree,
    rest_tree,
)
from crar_drake.motion.performer import (
    ARM,
    SIDES,
    Fact,
    Performer,
    heading_of,
    repeated,
)
from crar_drake.motion.plausible import HEIGHTS, USUAL_HEIGHT
from crar_drake.motion.segment_tree import SegmentTree

# Joint centre: the bone at whose start it lies ("root" for the root itself).
_BONE_OF = {"pelvis": "root", "neck": "lowerneck", "head": "head"} | {
    f"{side}_{joint}": side[0] + bone
    for side in SIDES
    for joint, bone in (
        ("shoulder", "humerus"),
        ("elbow", "radius"),
        ("wrist", "wrist"),
        ("hip", "femur"),
        ("knee", "tibia"),
        ("ankle", "foot"),
        ("toe", "toes"),
    )
}

# What today's robots follow.
_UPPER_BODY = ("neck", *(f"{side}_{joint}" for side in SIDES for joint in ARM))

# Hand: the bone that says how it is turned. That is the wrist, the forearm's last
# third, which turns with the hand and was fitted to the two markers at its sides; it
# knows no bending of the wrist. The hand bones, fitted to a single marker, know it,
# but spin and flip by half a turn in some trials (135_02), as thumbs and fingers do.
_HAND_BONES = {"left_hand": "lwrist", "right_hand": "rwrist"}

# What `length` may have been meant: the CMU database's, inches, cm, mm, m.
_LENGTHS = (CMU_LENGTH, 1.0, 2.54, 25.4, 0.0254)

# No angle beyond this: radians. Real files in degrees have 70 to 93 % of their
# degrees of freedom beyond it; of those in radians at most a tenth can be, that turn
# by more than once in all. An angle file that is all but still says nothing.
_TURN_IN_RADIANS = 6.3
_STILL = 0.5
_DEGREES_SHARE = 0.25


def robot_frame(p_file: np.ndarray) -> np.ndarray:
    """Returns (..., 3) positions of the y-up file as z-up ones: (z, x, y)."""
    return p_file[..., [2, 0, 1]]


def asf_amc_performer(clip: Clip) -> Performer:
    """Returns the performer of a clip.

    A skeleton that lacks bones which a robot needs is no error; the performer's
    `obstacle` says what it lacks.
    """
    skeleton, tree, rest = clip.skeleton, clip_tree(clip), rest_tree(clip.skeleton)
    heights = [float(bone_end(skeleton, rest, name)[0, 1]) for name in skeleton.bones]
    lowest, highest = min([0.0, *heights]), max([0.0, *heights])
    segment = {
        joint: tree.names.index(bone)
        for joint, bone in _BONE_OF.items()
        if bone in tree.names
    }
    hands, hands_obstacle = _hands(clip, rest, tree)
    unit = f"{1e3 * skeleton.metres_per_unit:.4g} mm"
    return Performer(
        name=clip.name,
        format="ASF/AMC",
        frame_rate=clip.frame_rate,
        rate_source=clip.rate_source,
        positions={j: robot_frame(tree.positions[i]) for j, i in segment.items()},
        orientations={
            j: _robot_rotation(tree.rotations[i]) for j, i in segment.items()
        },
        hands=hands,
        heading=heading_of(_robot_rotation(tree.rotations[0])),
        hip_height=-lowest,
        height=highest - lowest,
        up="+y",
        facing="+z",
        joints={
            joint: f"{tree.names[i]}'s start" if i else "root"
            for joint, i in segment.items()
        },
        facts=(
            Fact("unit", unit, "file", "length of :units"),
            Fact("up", "+y", "assumed", "as in the CMU database"),
            Fact("facing", "+z", "assumed", "as in the CMU database"),
        ),
        bones=len(skeleton.bones),
        same=repeated(
            np.hstack([clip.root_position, clip.root_rotation, *clip.joints.values()])
        ),
        doubts=(*_doubt_angles(clip), *_doubt_height(skeleton, highest - lowest)),
        obstacle=_obstacle(clip, lowest),
        hands_obstacle=hands_obstacle,
        **tree.described(segment),
    )


def _obstacle(clip: Clip, lowest: float) -> str:
    """Why the clip cannot drive a robot's upper body, or ""."""
    bones = [_BONE_OF[joint] for joint in _UPPER_BODY]
    missing = [bone for bone in bones if bone not in clip.skeleton.bones]
    if missing:
        return (
            f"motion {clip.name}: skeleton {clip.skeleton.name!r} lacks the bones "
            f"{', '.join(missing)}, which mark the neck and the arms; use a skeleton "
            f"with the CMU database's bone names"
        )
    if lowest >= 0.0:
        return (
            f"motion {clip.name}: skeleton {clip.skeleton.name!r} has nothing below "
            f"its root, so its hip height is unknown; it needs legs"
        )
    return ""


def _robot_rotation(R_file: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) of the y-up file's axes in the robot's: (z, x, y)."""
    order = np.ix_([2, 0, 1], [2, 0, 1])
    return R_file[(..., *order)]


# --- hands ------------------------------------------------------------------------


def _hands(
    clip: Clip, rest: SegmentTree, tree: SegmentTree
) -> tuple[dict[str, np.ndarray], str]:
    """R_WH of the hands, or why there are none."""
    skeleton = clip.skeleton
    missing = [bone for bone in _HAND_BONES.values() if bone not in skeleton.bones]
    if missing:
        return {}, (
            f"motion {clip.name}: skeleton {skeleton.name!r} lacks the bones "
            f"{', '.join(missing)}, which give the hands' orientations; use a skeleton "
            f"with the CMU database's bone names, or track positions only"
        )
    rotations = {}
    for hand, bone in _HAND_BONES.items():
        i = tree.names.index(bone)
        R_rest = rest.rotations[i][0]
        fingers = R_rest @ skeleton.bones[bone].direction
        x = robot_frame(fingers) / np.linalg.norm(fingers)
        z = np.array([1.0, 0.0, 0.0]) - x[0] * x
        if np.linalg.norm(z) < 0.5:
            return {}, (
                f"motion {clip.name}: skeleton {skeleton.name!r}: {bone} points "
                f"forward at rest, so its thumb's side is unknown; use a skeleton at "
                f"rest with its arms spread or hanging, or track positions only"
            )
        z /= np.linalg.norm(z)
        R_WH_rest = np.stack([x, np.cross(z, x), z], axis=1)
        turned = _robot_rotation(tree.rotations[i] @ R_rest.T)
        rotations[hand] = turned @ R_WH_rest
    return rotations, ""


# --- implausible as a whole -------------------------------------------------------


def _doubt_height(skeleton: Skeleton, height: float) -> Iterator[str]:
    least, most = HEIGHTS
    if least <= height <= most:
        return
    # The length unit divides, so another one makes the performer so tall:
    heights = {unit: height * skeleton.length_unit / unit for unit in _LENGTHS}
    unit = min(_LENGTHS, key=lambda u: abs(np.log(heights[u] / USUAL_HEIGHT)))
    text = (
        f"standing height {height:.3g} m is implausible, with length "
        f"{skeleton.length_unit:g} in the skeleton's :units"
    )
    if least <= heights[unit] <= most:
        text += f"; with length {unit:g} it would be {heights[unit]:.2f} m"
    yield text


def _doubt_angles(clip: Clip) -> Iterator[str]:
    bones = clip.skeleton.bones.values()
    # Numbers of a skeleton stand for themselves, those of a motion by columns.
    fixed = [bone.axis for bone in bones]
    fixed += [np.ravel(bone.limits) for bone in bones if bone.limits]
    moving = np.hstack([clip.root_rotation, *clip.joints.values()])
    yield from _doubt_unit(
        "skeleton",
        clip.skeleton.angle_unit,
        np.abs(np.concatenate(fixed)),
        {"degrees": "angle deg", "radians": "angle rad"},
    )
    yield from _doubt_unit(
        "motion",
        clip.angle_unit,
        np.abs(moving).max(axis=0),
        {"degrees": ":DEGREES", "radians": ":RADIANS"},
    )


def _doubt_unit(
    what: str, unit: str, angles: np.ndarray, words: dict[str, str]
) -> Iterator[str]:
    """Doubts that a file's absolute angles (k,) [rad] are in the unit that it says."""
    numbers = np.degrees(angles) if unit == "degrees" else angles  # of the file
    numbers = numbers[np.isfinite(numbers) & (numbers > 0.0)]
    largest = numbers.max(initial=0.0)
    share = np.mean(numbers > _TURN_IN_RADIANS) if numbers.size else 0.0
    if unit == "degrees" and largest > _STILL and share == 0.0:
        seen, other = f"never exceed ±{largest:.2f}", "radians"
    elif unit == "radians" and share > _DEGREES_SHARE:
        seen, other = f"reach ±{largest:.0f}", "degrees"
    else:
        return
    yield (
        f"the {what}'s angles {seen}, which looks like {other}, but the file says "
        f"{unit}; if so, write {words[other]} in it"
    )
