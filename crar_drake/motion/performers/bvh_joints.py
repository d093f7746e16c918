"""Which joint of a tree is which: by the user's file, by names, or by its shape."""

from collections.abc import Mapping, Sequence

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.file_frame import seems_mirrored
from crar_drake.motion.joint_names import joints_by_name, load_joint_file
from crar_drake.motion.joint_topology import Limbs, find_limbs
from crar_drake.motion.performer import ARM, LEG, SIDES, sides_swapped
from crar_drake.motion.segment_tree import SegmentTree

_LIMBS = {"arm": ARM, "leg": LEG}
_TIPS = {"arm": "thumb", "leg": "toe"}

# A bone shorter than this share of the legs is none.
SHORT = 0.01


def find_joints(
    tree: SegmentTree, motion: str, joints_file: str = ""
) -> tuple[dict[str, int], list[str]]:
    """Joint of `performer.JOINTS`, and perhaps thumbs, to its index in a tree.

    Args:
        motion: its name, for errors.
        joints_file: YAML that says which some of them are, or "".

    Returns:
        The joints, and the limbs ("arm", "leg") that its shape told, not names.

    Raises:
        MotionError: there are no two arms and two legs, or the file is none.
    """
    by_file = load_joint_file(joints_file, tree.names) if joints_file else {}
    found = joints_by_name(tree.names) | by_file
    for limb, parts in _LIMBS.items():
        for side in SIDES:
            limb_joints = [f"{side}_{part}" for part in parts]
            if _hang_together(tree, [found.get(joint) for joint in limb_joints]):
                continue
            if given := [joint for joint in limb_joints if joint in by_file]:
                raise MotionError(
                    f"{joints_file}: {given[0]} and the others of the {side} {limb} do "
                    "not hang on each other; name all of them"
                )
            for joint in (*limb_joints, f"{side}_{_TIPS[limb]}"):
                found.pop(joint, None)
    lacking = [
        limb
        for limb, parts in _LIMBS.items()
        if any(f"{side}_{parts[0]}" not in found for side in SIDES)
    ]
    lengths = _lengths(tree)
    if lacking:
        found |= _by_shape(tree, lengths, lacking, found, motion)
    _correct_trunk(tree, found, by_file, motion)
    _find_toes(tree, lengths, found)
    return found | by_file, lacking


def _hang_together(tree: SegmentTree, chain: Sequence[int | None]) -> bool:
    return None not in chain and all(
        a != b and a in tree.path(b) for a, b in zip(chain, chain[1:], strict=False)
    )


def _lengths(tree: SegmentTree) -> np.ndarray:
    """(J,) of each joint from its parent, in the median; 0 of a root."""
    p = tree.positions
    return np.array(
        [
            float(np.median(np.linalg.norm(p[j] - p[parent], axis=1)))
            if parent >= 0
            else 0.0
            for j, parent in enumerate(tree.parents)
        ]
    )


def _by_shape(
    tree: SegmentTree,
    lengths: np.ndarray,
    lacking: Sequence[str],
    found: Mapping[str, int],
    motion: str,
) -> dict[str, int]:
    """Limbs, and what else of the trunk, that names do not tell."""
    limbs = find_limbs(tree.parents, lengths)
    if isinstance(limbs, str):
        known = sorted(joint for joint in found if joint.partition("_")[2])
        raise MotionError(
            f"motion {motion}: no two {'s and no two '.join(lacking)}s in "
            f"this hierarchy, neither by names nor by its shape: {limbs}"
            + (f"; by name: {', '.join(known)}" if known else "")
            + f". Its joints: {', '.join(n for n in tree.names if n)}. "
            "Say which is which: --joints FILE"
        )
    result = _sided(tree, limbs, motion)
    wanted = [
        f"{side}_{part}"
        for limb in lacking
        for part in (*_LIMBS[limb], _TIPS[limb])
        for side in SIDES
    ]
    wanted += [joint for joint in ("pelvis", "neck", "head") if joint not in found]
    return {joint: result[joint] for joint in wanted if joint in result}


def _sided(tree: SegmentTree, limbs: Limbs, motion: str) -> dict[str, int]:
    """The limbs with their sides: toes and knees point forward."""
    result = {"pelvis": limbs.pelvis, "neck": limbs.neck, "head": limbs.head}
    for pair, parts in ((limbs.legs, (*LEG, "toe")), (limbs.arms, ARM)):
        for side, chain in zip(SIDES, pair, strict=True):
            for part, index in zip(parts, chain, strict=True):
                result[f"{side}_{part}"] = index
    result = {joint: index for joint, index in result.items() if index >= 0}
    points = {joint: tree.positions[index] for joint, index in result.items()}
    # Of the neck's place, that of the arms will do.
    points["neck"] = (points["left_shoulder"] + points["right_shoulder"]) / 2.0
    mirrored = seems_mirrored(points)
    if mirrored is None:
        raise MotionError(
            f"motion {motion}: names do not tell left from right, and neither "
            "toes nor knees tell the front; say which is which: --joints FILE"
        )
    hips = points["left_hip"] - points["right_hip"]
    shoulders = points["left_shoulder"] - points["right_shoulder"]
    crossed = np.median(np.sum(hips * shoulders, axis=1)) < 0.0
    swap = (*LEG, "toe") if mirrored else ()
    swap += ARM if crossed != mirrored else ()
    swapped = {j: result.pop(j) for j in [*result] if j.partition("_")[2] in swap}
    return result | sides_swapped(swapped)


def _correct_trunk(
    tree: SegmentTree, found: dict[str, int], by_file: Mapping[str, int], motion: str
) -> None:
    """Puts the pelvis where the legs meet, unless a name says it better."""
    paths = [tree.path(found[f"{side}_hip"]) for side in SIDES]
    shared = [a for a, b in zip(*paths, strict=False) if a == b]
    if not shared:
        raise MotionError(
            f"motion {motion}: the legs hang on different roots; join them"
        )
    if "pelvis" not in by_file and found.get("pelvis") not in shared:
        found["pelvis"] = shared[-1]
    # An early joint of the neck's name beside the body, or none: leave it out.
    if "neck" in found and "neck" not in by_file:
        if found["pelvis"] not in tree.path(found["neck"]):
            del found["neck"]
    if "head" in found and found["head"] == found.get("neck"):
        del found["head"]


def _find_toes(tree: SegmentTree, lengths: np.ndarray, found: dict[str, int]) -> None:
    """A foot without toes of its own ends in them: where its bone ends."""
    least = SHORT * lengths[found["left_knee"]]
    for side in SIDES:
        ankle, toe = found[f"{side}_ankle"], found.pop(f"{side}_toe", None)
        if toe is None or not _hang_together(tree, [ankle, toe]):
            beyond = [j for j, parent in enumerate(tree.parents) if parent == ankle]
            toe = next((j for j in beyond if lengths[j] > least), None)
        if toe is not None:
            found[f"{side}_toe"] = toe
