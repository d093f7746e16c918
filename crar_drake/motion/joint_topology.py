"""Which joints are limbs where names say nothing: by the tree and its lengths.

A person's tree has a pair of like branches near the root, the legs, and beyond the
branch between them another pair, the arms, with the neck between those. Within a
limb the two neighbouring bones that are longest together are thigh and shank, or upper
arm and forearm. Which leg is the left one only geometry can tell, see `frames`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Branches whose longest ways differ by less than this share are a pair.
_ALIKE = 0.25
# Two neighbouring bones together are as long as the longest such if so much of it.
_AS_LONG = 0.88
# Shorter than this share of the longest bone, a bone is none: joints at one place.
_NOTHING = 1e-3


@dataclass(frozen=True)
class Limbs:
    """What the tree alone tells; the sides a and b are not known."""

    pelvis: int  # its index
    neck: int  # its index
    head: int  # its index, -1 if there is none
    # (a, b), each indices of hip, knee, ankle and toe (-1 if there is none)
    legs: tuple[tuple[int, ...], tuple[int, ...]]
    # (a, b), each indices of shoulder, elbow and wrist
    arms: tuple[tuple[int, ...], tuple[int, ...]]


def find_limbs(parents: Sequence[int], lengths: np.ndarray) -> Limbs | str:
    """Finds legs and arms in a tree.

    Args:
        parents: (J,) index of each joint's parent, -1 for a root; parents first.
        lengths: (J,) distance of each joint from its parent [any unit].

    Returns:
        The limbs, or what was found instead, in words.
    """
    tree = _Tree(parents, lengths)
    pairs = tree.pairs()
    # Arms begin farther out than legs; of several such couples the longest counts,
    # because fingers are pairs, too.
    best: tuple[float, int, tuple[int, int], int, tuple[int, int]] | None = None
    for leg_node, legs in pairs:
        for arm_node, arms in pairs:
            if arm_node == leg_node or leg_node not in tree.path(arm_node):
                continue
            if any(leg in tree.path(arm_node) for leg in legs):
                continue
            score = sum(tree.reach[i] for i in (*legs, *arms))
            if best is None or score > best[0]:
                best = score, leg_node, legs, arm_node, arms
    if best is None:
        return tree.found(pairs)
    _, pelvis, legs, chest, arms = best
    leg_chains = tuple(tree.chain(i, 4) for i in legs)
    arm_chains = tuple(tree.chain(i, 3) for i in arms)
    if any(chain is None for chain in (*leg_chains, *arm_chains)):
        return f"{tree.found(pairs)}, but they have too few joints for knees and elbows"
    # The neck: the longest other branch at the arms, or the arms' own node.
    others = [i for i in tree.branches(chest) if i not in arms]
    neck = max(others, key=lambda i: tree.reach[i], default=chest)
    inner = [i for i in tree.longest(neck) if tree.children[i]]
    head = inner[-1] if others and len(inner) > 1 else -1
    return Limbs(pelvis, neck, head, leg_chains, arm_chains)


class _Tree:
    """The joints, with lengths that are nothing counted as such."""

    def __init__(self, parents: Sequence[int], lengths: np.ndarray) -> None:
        self.parents = list(parents)
        self.lengths = np.where(np.array(parents) < 0, 0.0, lengths)
        self.nothing = _NOTHING * max(self.lengths.max(initial=0.0), 1e-12)
        self.children: list[list[int]] = [[] for _ in parents]
        for i, parent in enumerate(parents):
            if parent >= 0:
                self.children[parent].append(i)
        # Length of the longest way through a joint and on to an end.
        self.reach = self.lengths.copy()
        for i in reversed(range(len(self.parents))):
            beyond = [self.reach[child] for child in self.children[i]]
            self.reach[i] += max(beyond, default=0.0)

    def path(self, index: int) -> list[int]:
        path = []
        while index >= 0:
            path.append(index)
            index = self.parents[index]
        return path

    def branches(self, index: int) -> list[int]:
        """Joints that leave a place: through joints at the same place, too."""
        result = []
        for child in self.children[index]:
            if self.lengths[child] <= self.nothing and self.children[child]:
                result += self.branches(child)
            else:
                result.append(child)
        return result

    def longest(self, index: int) -> list[int]:
        """The joints of the longest way from a joint, itself first."""
        way = [index]
        while self.children[way[-1]]:
            way.append(max(self.children[way[-1]], key=lambda i: self.reach[i]))
        return way

    def pairs(self) -> list[tuple[int, tuple[int, int]]]:
        """(where, (a, b)): branches alike, the longest such two of each place."""
        result = []
        for i in range(len(self.parents)):
            parent = self.parents[i]
            if parent >= 0 and self.lengths[i] <= self.nothing:
                continue  # its branches are its parent's
            found = sorted(self.branches(i), key=lambda k: -self.reach[k])
            best = None
            for n, a in enumerate(found):
                for b in found[n + 1 :]:
                    ratio = self.reach[b] / max(self.reach[a], 1e-12)
                    like = self.size(a) == self.size(b)
                    if ratio > 1.0 - _ALIKE and self.reach[b] > 0.0:
                        score = (like, self.reach[a] + self.reach[b])
                        if best is None or score > best[0]:
                            best = score, (a, b)
            if best is not None:
                result.append((i, best[1]))
        return result

    def size(self, index: int) -> int:
        return 1 + sum(self.size(child) for child in self.children[index])

    def chain(self, index: int, count: int) -> tuple[int, ...] | None:
        """`count` joints of a limb about its two longest neighbouring bones."""
        way = [i for i in self.longest(index)]
        # Of joints at one place the last one turns what follows.
        way = [
            i
            for n, i in enumerate(way)
            if n + 1 == len(way) or self.lengths[way[n + 1]] > self.nothing
        ]
        bones = [self.lengths[i] for i in way]
        if len(way) < 3:
            return None
        sums = {n: bones[n] + bones[n + 1] for n in range(1, len(way) - 1)}
        # Collar bone and upper arm may be as long together as the arm: the outer two.
        first = max(n for n in sums if sums[n] > _AS_LONG * max(sums.values()))
        chosen = way[first - 1 : first - 1 + count]
        return tuple(chosen + [-1] * (count - len(chosen)))

    def found(self, pairs: list) -> str:
        ends = sum(not children for children in self.children)
        return (
            f"{len(self.parents)} joints with {ends} ends, and {len(pairs)} "
            f"place{'s' if len(pairs) != 1 else ''} where two like branches leave"
        )
