"""Segments that hang on each other and turn: of BVH, ASF/AMC, SMPL and MVNX."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class SegmentTree:
    """Where the segments of a body are over time, in a file's axes F and units.

    A segment begins at its joint with the one that it hangs on.
    """

    names: tuple[str, ...]  # (J,), "" for one that has none
    # (J,) index of the one that each hangs on, -1 for a root; parents come first
    parents: tuple[int, ...]
    positions: Sequence[np.ndarray]  # J times (T, 3) p_FS of where a segment begins
    rotations: Sequence[np.ndarray]  # J times (T, 3, 3) R_FS

    def path(self, index: int) -> list[int]:
        """Indices from the root to a segment, both included."""
        path = []
        while index >= 0:
            path.append(index)
            index = self.parents[index]
        return path[::-1]

    def during(self, frames: slice) -> SegmentTree:
        """The tree in some of the frames."""
        p, R = (
            [of[frames] for of in each] for each in (self.positions, self.rotations)
        )
        return SegmentTree(self.names, self.parents, p, R)

    def name(self, index: int) -> str:
        """What a segment is called in messages."""
        return self.names[index] or f"joint {index + 1}"

    def turning(self, index: int) -> np.ndarray:
        """(T - 1,) angles by which it turns against its parent from frame to frame
        [rad]. Rotations are compared, not angles: 359 degrees beside -1 is no turn."""
        R, parent = self.rotations[index], self.parents[index]
        if parent >= 0:
            R = np.swapaxes(self.rotations[parent], 1, 2) @ R
        # trace(RᵀS) is the sum of the products of the elements.
        trace = np.einsum("tij,tij->t", R[:-1], R[1:])
        return np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))

    def described(self, joints: Mapping[str, int]) -> dict[str, Any]:
        """What `performer.Described` says of rotations.

        Args:
            joints: name of `performer.JOINTS` to the segment that begins there.
        """
        return {
            "turns": {self.name(i): self.turning(i) for i in range(len(self.names))},
            "carriers": {
                joint: frozenset(self.name(k) for k in self.path(i)[:-1])
                for joint, i in joints.items()
            },
        }


def tree_of_turns(
    names: Sequence[str],
    parents: Sequence[int],
    offsets: Sequence[np.ndarray],
    turns: Sequence[np.ndarray],
) -> SegmentTree:
    """The tree of segments that turn against their parents.

    p_FS = p_FP + R_FP p_PS and R_FS = R_FP R_PS, from the roots outwards.

    Args:
        offsets: J times p_PS, (3,) or (T, 3), in the parent's axes; (T, 3) of a root,
            in the file's.
        turns: J times R_PS (T, 3, 3).
    """
    positions, rotations = [], []
    for parent, offset, R_PS in zip(parents, offsets, turns, strict=True):
        if parent < 0:
            positions.append(offset)
            rotations.append(R_PS)
            continue
        R_FP = rotations[parent]
        fixed = offset.ndim == 1
        way = R_FP @ offset if fixed else np.einsum("tij,tj->ti", R_FP, offset)
        positions.append(positions[parent] + way)
        rotations.append(R_FP @ R_PS)
    return SegmentTree(tuple(names), tuple(parents), positions, rotations)
