"""The performer of a BVH file, whatever its names, unit and axes."""

import math
from collections.abc import Mapping

import numpy as np

from crar_drake.motion.file_frame import body_forward, seems_mirrored
from crar_drake.motion.formats.bvh import (
    Bvh,
    added_positions,
    bvh_tree,
    rest_positions,
)
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import (
    JOINTS,
    SIDES,
    Fact,
    Performer,
    Points,
    repeated,
    sides_swapped,
)
from crar_drake.motion.performers.assemble import (
    MIRRORED,
    Recording,
    assemble,
    frames_apart,
)
from crar_drake.motion.performers.bvh_joints import SHORT, find_joints
from crar_drake.motion.rates import SLOWEST, rate_meant
from crar_drake.motion.segment_tree import SegmentTree

# In a standing rest pose, legs point away from the neck by more than this.
_AWAY = -0.8  # cosine

_NOT_TURNED = 0.01  # [deg]


def bvh_performer(bvh: Bvh, name: str, options: MotionOptions) -> Performer:
    """Returns the performer of a BVH.

    Raises:
        MotionError: it has no two arms and legs, too few frames, or lengths that are
            a person's in no unit; the message says what was found.
    """
    tree = bvh_tree(bvh)
    found, told_by_shape = find_joints(tree, name, options.joints)
    notes, doubts = [], []
    guessed = frozenset({"neck"} - set(found))

    def points_of(p) -> dict[str, np.ndarray]:
        points = {joint: p[i] for joint, i in found.items() if joint in JOINTS}
        if guessed:
            points["neck"] = (points["left_shoulder"] + points["right_shoulder"]) / 2.0
        return points

    points = points_of(tree.positions)
    if seems_mirrored(points) and not options.joints:
        found = sides_swapped(found)
        doubts.append(MIRRORED)
        points = points_of(tree.positions)
    rate = _rate(bvh, name, options, notes)
    kept = _kept(bvh, points, rate, notes)
    added = [bvh.joints[j].name for j in added_positions(bvh)]
    if added:
        notes.append(
            f"positions of {added[0]}"
            + (f" and {len(added) - 1} more joints" if len(added) > 1 else "")
            + " are about 0 beside their OFFSET: added to it"
        )
    tree = tree.during(kept)
    own = {joint: i for joint, i in found.items() if joint in JOINTS}
    labels = {
        joint: tree.names[i] or f"end of {tree.names[tree.parents[i]]}"
        for joint, i in own.items()
    }
    if guessed:
        labels["neck"] = "between the shoulders"
    rest_all = rest_positions(bvh, tree)
    rest = points_of(rest_all)
    if not _stands(rest):
        rest, rest_all = {}, None
    hands, hands_obstacle = _hands(tree, found, rest, rest_all, name)
    facts = [_pose_fact(rest)]
    if told_by_shape:
        limbs = " and ".join(f"{limb}s" for limb in told_by_shape)
        why = "names do not tell them; --joints says otherwise"
        facts.insert(0, Fact(limbs, "by the shape of the tree", "inferred", why))
    return assemble(
        Recording(
            name=name,
            format="BVH",
            frame_rate=rate,
            rate_source="file" if options.frame_rate is None else "given",
            positions=points_of(tree.positions),
            joints=labels,
            guessed=guessed,
            rest=rest,
            rotations={joint: tree.rotations[i] for joint, i in own.items()},
            pelvis_up=_pelvis_up(tree, found),
            hands=hands,
            hands_obstacle=hands_obstacle,
            bones=sum(bool(joint) for joint in tree.names),
            bones_called="joints",
            same=repeated(bvh.values[kept]),
            doubts=tuple(doubts),
            notes=tuple(notes),
            facts=tuple(facts),
            **tree.described(found),
        ),
        options,
    )


def _rate(bvh: Bvh, name: str, options: MotionOptions, notes: list[str]) -> float:
    """Samples per second [Hz]."""
    if options.frame_rate is not None:
        return options.frame_rate
    if 1.0 / bvh.frame_time >= SLOWEST:
        return _exact_rate(1.0 / bvh.frame_time)
    rate, note = rate_meant(
        f"motion {name}",
        f"a frame time of {bvh.frame_time:g} s",
        {
            "the rate in Hz": bvh.frame_time,
            "milliseconds": 1e3 / bvh.frame_time,
            "microseconds": 1e6 / bvh.frame_time,
        },
    )
    notes.append(note)
    return rate


def _kept(bvh: Bvh, points: Points, rate: float, notes: list[str]) -> slice:
    """The frames without poses apart at the beginning and at the end."""
    at_rest = _at_rest(bvh)
    count = bvh.num_frames
    first = frames_apart(points, rate, at_rest)
    backwards = {joint: q[first:][::-1] for joint, q in points.items()}
    end = count - frames_apart(backwards, rate, at_rest[first:][::-1])
    for start, stop in ((0, first), (end, count)):
        if start < stop:
            which = (
                f"frame {stop} is"
                if stop == start + 1
                else f"frames {start + 1} to {stop} are"
            )
            notes.append(f"{which} a pose apart (often a T-pose): left out")
    return slice(first, end)


def _at_rest(bvh: Bvh) -> np.ndarray:
    """(T,) whether all joints but the roots are turned by nothing."""
    columns = [
        column
        for j, joint in enumerate(bvh.joints)
        for channel, column in bvh.columns(j).items()
        if joint.parent >= 0 and channel.endswith("rotation")
    ]
    return np.abs(bvh.values[:, columns]).max(axis=1, initial=0.0) < _NOT_TURNED


def _exact_rate(rate: float) -> float:
    """Frame times are rounded: 0.0083333 s is 120 Hz [Hz]."""
    near = round(rate)
    return float(near) if near and abs(rate / near - 1.0) < 1e-3 else rate


def _stands(rest: Points) -> bool:
    """Whether the rest pose is a person's that stands: legs away from the neck."""
    up = rest["neck"] - rest["pelvis"]
    hips = rest["left_hip"] - rest["right_hip"]
    legs = [rest[f"{side}_ankle"] - rest[f"{side}_hip"] for side in SIDES]
    if min(np.linalg.norm(v) for v in (up, hips, *legs)) < 1e-9:
        return False
    up, hips = up / np.linalg.norm(up), hips / np.linalg.norm(hips)
    return abs(hips @ up) < 0.5 and all(
        leg @ up / np.linalg.norm(leg) < _AWAY for leg in legs
    )


def _pose_fact(rest: Points) -> Fact:
    if not rest:
        return Fact("rest pose", "not a standing person's", "inferred")
    up = rest["neck"] - rest["pelvis"]
    left = rest["left_wrist"] - rest["left_shoulder"]
    cosine = float(up @ left / np.linalg.norm(up) / np.linalg.norm(left))
    spread = np.degrees(math.acos(max(-1.0, min(1.0, -cosine))))
    pose = (
        "T-pose"
        if 65.0 < spread < 115.0
        else ("arms hanging" if spread <= 25.0 else f"arms at {spread:.0f} degrees")
    )
    return Fact("rest pose", pose, "file")


def _pelvis_up(tree: SegmentTree, found: Mapping[str, int]) -> np.ndarray:
    """(T, 3) up in the pelvis: from between the hips to what is fixed above them.

    That is the spine's first joint, unless it lies in the pelvis itself: what comes
    after it turns against the pelvis. Then it is the pelvis's own origin, unless that
    lies between the hips.
    """
    p = tree.positions
    hips = (p[found["left_hip"]] + p[found["right_hip"]]) / 2.0
    pelvis, above = found["pelvis"], found.get("neck", found["left_shoulder"])
    least = SHORT * np.linalg.norm(p[found["left_knee"]][0] - p[found["left_hip"]][0])
    path = tree.path(above)
    spine = path[path.index(pelvis) + 1 :] if pelvis in path else [above]
    for fixed in (spine[0], pelvis):
        origin = p[pelvis] if fixed != pelvis else hips
        if np.linalg.norm(p[fixed][0] - origin[0]) > least:
            return p[fixed] - hips
    return p[above] - hips


# --- hands ------------------------------------------------------------------------


def _hands(
    tree: SegmentTree,
    found: Mapping[str, int],
    rest: Points,
    rest_all: np.ndarray | None,
    name: str,
) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], str]:
    """Per hand (T, 3) to the fingertips and to the thumb's side, in the file's axes.

    To the fingertips points the mean of what hangs on the wrist but the thumb, or else
    the forearm; the thumb's side is the thumb's, or the front of a standing rest pose.
    """
    p = tree.positions

    def below(index: int) -> list[int]:
        return [j for j in range(len(p)) if index in tree.path(j)[:-1]]

    result = {}
    for side in SIDES:
        wrist, elbow = found[f"{side}_wrist"], found[f"{side}_elbow"]
        R = tree.rotations[wrist]
        thumb = found.get(f"{side}_thumb")
        thumbs = [thumb, *below(thumb)] if thumb is not None else []
        least = SHORT * float(np.linalg.norm(p[wrist][0] - p[elbow][0]))
        others = [i for i in below(wrist) if i not in thumbs]
        fingers = _rigid(tree, rest_all, wrist, others, least)
        x = (
            np.einsum("tij,j->ti", R, fingers)
            if fingers is not None
            else p[wrist] - p[elbow]
        )
        ahead = fingers
        if ahead is None:
            ahead = np.median(np.einsum("tji,tj->ti", R, x), axis=0)
        to_thumb = _rigid(tree, rest_all, wrist, thumbs, least)
        if _along(to_thumb, ahead) and rest:
            to_thumb = body_forward(rest)
        if _along(to_thumb, ahead):
            to_thumb = None
        if to_thumb is None:
            return {}, (
                f"motion {name}: {tree.names[wrist]} has no thumb, and the "
                "skeleton at rest does not tell the thumb's side; track positions only"
            )
        result[f"{side}_hand"] = x, np.einsum("tij,j->ti", R, to_thumb)
    return result, ""


def _along(v: np.ndarray | None, x: np.ndarray) -> bool:
    """Whether v is no direction, or one that hardly leaves that of x."""
    if v is None:
        return True
    return bool(abs(v @ x) > 0.9 * np.linalg.norm(v) * np.linalg.norm(x))


def _rigid(
    tree: SegmentTree, rest: np.ndarray | None, joint: int, others: list[int], least
) -> np.ndarray | None:
    """(3,) mean, in a joint's own axes, of those farther from it than `least`.

    It is that of the standing rest pose, where there is one: a bent thumb points where
    the fingers do.
    """
    offsets = []
    for i in others:
        if rest is not None:
            q = rest[i] - rest[joint]
        else:
            p = tree.positions[i] - tree.positions[joint]
            p_J = np.einsum("tji,tj->ti", tree.rotations[joint], p)
            q = np.median(p_J, axis=0)
        if np.linalg.norm(q) > least:
            offsets.append(q)
    return np.mean(offsets, axis=0) if offsets else None
