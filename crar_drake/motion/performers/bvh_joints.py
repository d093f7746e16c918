"""Which joint of a BVH is which: by the user's file, by names, or by the tree."""

from collections.abc import Mapping

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.file_frame import seems_mirrored
from crar_drake.motion.formats.bvh import Bvh, BvhPoses
from crar_drake.motion.joint_names import joints_by_name, load_joint_file
from crar_drake.motion.joint_topology import Limbs, find_limbs
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import ARM, LEG, SIDES, sides_swapped

_LIMBS = {"arm": ARM, "leg": LEG}

# A bone shorter than this share of the legs is none.
SHORT = 0.01


class JointMatch:
    """Joints by the user's file, by names, and the rest by the tree."""

    def __init__(
        self, bvh: Bvh, poses: BvhPoses, name: str, options: MotionOptions
    ) -> None:
        self.bvh, self.poses, self.motion = bvh, poses, name
        self.names = [joint.name for joint in bvh.joints]
        self.parents = [joint.parent for joint in bvh.joints]
        p = poses.positions
        self.lengths = np.array(
            [
                float(np.median(np.linalg.norm(p[j] - p[parent], axis=1)))
                if parent >= 0
                else 0.0
                for j, parent in enumerate(self.parents)
            ]
        )
        self.options = options
        self.told_by_tree: list[str] = []  # limbs: "arm", "leg"

    def joints(self) -> dict[str, int]:
        """Joint of JOINTS, and perhaps thumbs, to its index.

        Raises:
            MotionError: there are no two arms and two legs.
        """
        by_file = {}
        if self.options.joints:
            by_file = load_joint_file(self.options.joints, self.names)
        found = joints_by_name(self.names) | by_file
        for limb, parts in _LIMBS.items():
            for side in SIDES:
                if not self.hangs_together([f"{side}_{part}" for part in parts], found):
                    self.check_not_given(side, limb, parts, by_file)
                    for part in (*parts, "toe" if limb == "leg" else "thumb"):
                        found.pop(f"{side}_{part}", None)
        lacking = [
            limb
            for limb, parts in _LIMBS.items()
            if any(f"{side}_{parts[0]}" not in found for side in SIDES)
        ]
        if lacking:
            found |= self.by_tree(lacking, found)
            self.told_by_tree = lacking
        found = self.trunk(found, by_file)
        return self.toes(found) | by_file

    def hangs_together(self, joints: list[str], found: Mapping[str, int]) -> bool:
        if any(joint not in found for joint in joints):
            return False
        inner = [found[joint] for joint in joints]
        return all(
            a != b and a in self.bvh.path(b)
            for a, b in zip(inner, inner[1:], strict=False)
        )

    def check_not_given(self, side, limb, parts, by_file: Mapping[str, int]) -> None:
        given = [part for part in parts if f"{side}_{part}" in by_file]
        if given:
            raise MotionError(
                f"{self.options.joints}: {side}_{given[0]} and the others of the "
                f"{side} {limb} do not hang on each other; name all of them"
            )

    def by_tree(self, lacking: list[str], found: Mapping[str, int]) -> dict[str, int]:
        """Limbs that names do not tell."""
        limbs = find_limbs(self.parents, self.lengths)
        if isinstance(limbs, str):
            known = sorted(joint for joint in found if joint.partition("_")[2])
            raise MotionError(
                f"motion {self.motion}: no two {'s and no two '.join(lacking)}s in "
                f"this hierarchy, neither by names nor by its shape: {limbs}"
                + (f"; by name: {', '.join(known)}" if known else "")
                + f". Its joints: {', '.join(n for n in self.names if n)}. "
                "Say which is which: --joints FILE"
            )
        result = self.sided(limbs)
        chosen = {
            f"{side}_{part}": result[f"{side}_{part}"]
            for limb in lacking
            for part in (*_LIMBS[limb], *(("toe",) if limb == "leg" else ()))
            for side in SIDES
            if f"{side}_{part}" in result
        }
        for joint in ("pelvis", "neck", "head"):
            if joint not in found and joint in result:
                chosen[joint] = result[joint]
        return chosen

    def sided(self, limbs: Limbs) -> dict[str, int]:
        """The limbs with their sides: toes and knees point forward."""
        result = {"pelvis": limbs.pelvis, "neck": limbs.neck}
        if limbs.head >= 0:
            result["head"] = limbs.head
        for pair, parts in ((limbs.legs, (*LEG, "toe")), (limbs.arms, ARM)):
            for side, chain in zip(SIDES, pair, strict=True):
                for part, index in zip(parts, chain, strict=True):
                    if index >= 0:
                        result[f"{side}_{part}"] = index
        p = self.poses.positions
        points = {joint: p[index] for joint, index in result.items()}
        # Of the neck's place, that of the arms will do.
        points["neck"] = (points["left_shoulder"] + points["right_shoulder"]) / 2.0
        mirrored = seems_mirrored(points)
        if mirrored is None:
            raise MotionError(
                f"motion {self.motion}: names do not tell left from right, and neither "
                "toes nor knees tell the front; say which is which: --joints FILE"
            )
        hips = points["left_hip"] - points["right_hip"]
        shoulders = points["left_shoulder"] - points["right_shoulder"]
        crossed = np.median(np.sum(hips * shoulders, axis=1)) < 0.0
        swap = (*LEG, "toe") if mirrored else ()
        swap += ARM if crossed != mirrored else ()
        swapped = {j: result.pop(j) for j in [*result] if j.partition("_")[2] in swap}
        return result | sides_swapped(swapped)

    def trunk(
        self, found: dict[str, int], by_file: Mapping[str, int]
    ) -> dict[str, int]:
        """Puts the pelvis where the legs meet, unless a name says it better."""
        paths = [self.bvh.path(found[f"{side}_hip"]) for side in SIDES]
        shared = [a for a, b in zip(*paths, strict=False) if a == b]
        if not shared:
            raise MotionError(
                f"motion {self.motion}: the legs hang on different roots; join them"
            )
        meet = shared[-1]
        pelvis = found.get("pelvis", meet)
        if "pelvis" not in by_file and pelvis not in shared:
            pelvis = meet
        # An early joint of the neck's name beside the body, or none: leave it out.
        neck = found.get("neck")
        if (
            neck is not None
            and "neck" not in by_file
            and pelvis not in (self.bvh.path(neck))
        ):
            found.pop("neck")
        if "head" in found and found["head"] == found.get("neck"):
            found.pop("head")
        return found | {"pelvis": pelvis}

    def toes(self, found: dict[str, int]) -> dict[str, int]:
        """A foot without toes of its own ends in them: where its bone ends."""
        found = dict(found)
        least = SHORT * self.lengths[found["left_knee"]]
        for side in SIDES:
            ankle, toe = found[f"{side}_ankle"], found.get(f"{side}_toe")
            if toe is not None and toe != ankle and ankle in self.bvh.path(toe):
                continue
            found.pop(f"{side}_toe", None)
            ends = [
                j
                for j, parent in enumerate(self.parents)
                if parent == ankle and self.lengths[j] > least
            ]
            if ends:
                found[f"{side}_toe"] = ends[0]
        return found
