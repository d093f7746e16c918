"""A motion against the ground z = 0: how low the robot gets, and how its feet slip.

A foot is *planted* while it is low and still (`motion.planted_feet`). The floor is
where the feet are when they are lowest, since motions may float or sink as a whole,
which is reported apart.

The *slip* of a planted foot from one frame to the next is the smallest horizontal way
of its points near the floor, those between its vertices among them: a foot that rolls
over its toes, or turns on its ball, has one that stays.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crar_drake.law.compilation import compiled
from crar_drake.motion.planted_feet import ContactThresholds, runs, standing
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_frame
from crar_drake.robot_import.link_outlines import links_outward
from crar_drake.trajectory.optimiser import spread

THRESHOLDS = ContactThresholds()
FEET, HANDS = ("left_foot", "right_foot"), ("left_hand", "right_hand")

# Points of a foot within this of its lowest one are those that it may stand on [m].
_SOLE = 0.01

_HULL_ENOUGH = 1e-9  # to which `least_way` is known [m]

# The feet's lowest heights of this share of the frames are the floor's.
_FLOOR_SHARE = 0.1

# A contact that is shorter is none [s].
_SHORTEST = 0.1

# Frames whose points are in memory at a time.
_BLOCK = 512

# A hand carries a little so long before and after it is planted [s].
_BEFORE_CARRYING = 0.1


@dataclass(frozen=True, eq=False)
class FootSlip:
    """What a foot does on the floor."""

    foot: str  # name of the motion's point, such as left_foot
    planted: np.ndarray  # (T,) whether it is
    num_contacts: int  # stretches in which it is planted
    total: float  # way that it slips while planted, in all of them [m]
    worst: float  # the longest of one contact [m]
    worst_start: int | None  # first frame of that contact; None without any
    worst_end: int | None  # and its last
    top_speed: float  # of slipping, from one frame to the next [m/s]


@dataclass(frozen=True, eq=False)
class GroundContact:
    """A motion against the ground."""

    lowest: np.ndarray  # (T,) height of the robot's lowest point [m]
    lowest_links: tuple[str, ...]  # (T) the link it is on
    floor: float  # height of the feet when they are lowest [m]; 0 without feet
    # an entry a foot; empty where the robot has no frames of that name
    feet: tuple[FootSlip, ...]


class Outline:
    """The robot's links as balls: vertices of hulls, or the ends of capsules.

    Motions have their joints in the order of the robot.

    Attributes:
        links: that have a shape.
        feet: task frame to those of its links that have one; none without.
    """

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: whose links have meshes, or else capsules and spheres.
        """
        self._robot, self.links = robot, tuple(robot.outlines)
        self.feet = self._shaped(FEET)

    @cached_property
    def hands(self) -> dict[str, list[str]]:
        """Task frame to those of its links that have a shape; none without."""
        return self._shaped(HANDS)

    def _shaped(self, points: Sequence[str]) -> dict[str, list[str]]:
        plant, found = self._robot.plant, {}
        for point, frame in self._robot.description.task_frames.items():
            if point in points:
                outward = links_outward(plant, find_frame(plant, frame))
                found[point] = [link for link in outward if link in self.links]
        return {point: links for point, links in found.items() if links}

    def ground_contact(
        self, motion: RobotMotion, floor: float | None = None
    ) -> GroundContact:
        """A motion against the ground.

        Args:
            floor: height at which feet stand [m]; by default where they are lowest.
        """
        if not self.links:
            zeros = np.zeros(motion.num_frames)
            return GroundContact(zeros, ("",) * motion.num_frames, 0.0, ())
        low = self._lowest(motion, self.links)
        if floor is None:
            floor = _lowest_floor(_of_points(self.feet, self.links, low))
        return GroundContact(
            lowest=low.min(axis=1),
            lowest_links=tuple(self.links[i] for i in low.argmin(axis=1)),
            floor=floor,
            feet=tuple(
                foot_slip(foot, self.sole(motion, foot), floor, motion.rate)
                for foot in self.feet
            ),
        )

    def slip_of_planted(
        self, motion: RobotMotion, planted: Mapping[str, np.ndarray]
    ) -> float:
        """The longest way that a foot slips in one contact, where contacts are known
        [m].

        Args:
            planted: foot to (T,) whether it is on the floor.
        """
        slips = (longest_slip(self.sole(motion, f), planted[f]) for f in self.feet)
        return max(slips, default=0.0)

    def sole(self, motion: RobotMotion, foot: str) -> Iterator[np.ndarray]:
        """Yields (B, V, 3) the lowest points of a foot's or hand's balls, in the world
        [m]; of each block of frames with the first one of the next."""
        links = self.feet.get(foot) or self.hands[foot]
        outlines = [self._robot.outlines[link] for link in links]
        for p_WB, R_WB in self._blocks(motion, links, 1):
            points = []
            for i, outline in enumerate(outlines):
                # Transposed in place, NumPy would multiply it many times slower.
                R_BW = np.ascontiguousarray(R_WB[:, i].swapaxes(1, 2))
                p = p_WB[:, i, None] + outline.points @ R_BW
                p[..., 2] -= outline.radii
                points.append(p)
            yield np.concatenate(points, axis=1)

    def carrying(self, motion: RobotMotion, hands: Sequence[str]) -> np.ndarray:
        """When hands carry the robot, which they do while they are planted on the floor
        of its feet: (T, H) 1 then, and less shortly before and after, else 0.

        Args:
            hands: task frames.
        """
        shares = np.zeros((motion.num_frames, len(hands)))
        if not self.hands:
            return shares
        floor = _lowest_floor(self._heights(motion, self.feet))
        before = round(_BEFORE_CARRYING * motion.rate)
        weights = np.full(2 * before + 1, 1.0 / (2 * before + 1))
        for hand, height in self._heights(motion, self.hands).items():
            # What is never low is never planted, and not looked at.
            if hand in hands and height.min() <= floor + THRESHOLDS.height_off:
                p_WS = self.sole(motion, hand)
                planted = foot_slip(hand, p_WS, floor, motion.rate).planted
                share = np.convolve(spread(planted, before), weights)
                shares[:, hands.index(hand)] = share[before:][: len(shares)]
        return shares

    def _heights(
        self, motion: RobotMotion, points: Mapping[str, Sequence[str]]
    ) -> dict[str, np.ndarray]:
        """Of feet or hands, with their links, each to (T,) its lowest height [m]."""
        links = list(dict.fromkeys(link for of in points.values() for link in of))
        return _of_points(points, links, self._lowest(motion, links)) if links else {}

    def _lowest(self, motion: RobotMotion, links: Sequence[str]) -> np.ndarray:
        """(T, L) heights of the lowest points of links [m]."""
        blocks = self._blocks(motion, links)
        return np.concatenate([self._robot.lowest(links, *X) for X in blocks])

    def _blocks(
        self, motion: RobotMotion, links: Sequence[str], more: int = 0
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yields where links are in the world, p_WB (B, L, 3) [m] and R_WB (B, L, 3,
        3), of some frames at a time, with so many of the next ones."""
        R_WR = motion.root_rotations
        for start in range(0, max(motion.num_frames - more, 1), _BLOCK):
            some = slice(start, start + _BLOCK + more)
            root = motion.root_positions[some], R_WR[some]
            q = motion.joint_positions[some]
            yield self._robot.poses_in_world(*root, q, links)


def _of_points(
    points: Mapping[str, Sequence[str]], links: Sequence[str], low: np.ndarray
) -> dict[str, np.ndarray]:
    """Each to (T,) its lowest height, where those of links are (T, L) [m]."""
    return {
        point: low[:, [links.index(link) for link in of]].min(axis=1)
        for point, of in points.items()
    }


def _lowest_floor(heights: dict[str, np.ndarray]) -> float:
    """Where feet, whose heights are (T,) each, are lowest [m]."""
    if not heights:
        return 0.0
    lowest = np.min(list(heights.values()), axis=0)
    return float(np.quantile(lowest, _FLOOR_SHARE))


@compiled
def _nearest(ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """The point of the segment from a to b that is nearest to 0."""
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    share = -(ax * dx + ay * dy) / square if square > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return ax + share * dx, ay + share * dy


@compiled
def least_way(moves: np.ndarray, there: np.ndarray) -> np.ndarray:
    """How far the points of a flat piece move that move least, (T,) [m].

    A piece that is turned and shifted moves its points by an affine function of where
    they are: so the ways of all points between some lie between the ways of these, and
    the least is the distance of 0 from their convex hull. It is found from segment to
    nearer segment between two of them, each with the vertex that is farthest towards 0
    (E. G. Gilbert, D. W. Johnson and S. S. Keerthi, IEEE J. Robot. Autom. 4, 1988).

    Args:
        moves: (T, V, 2) of the vertices [m].
        there: (T, V) which of them count; at least one each.
    """
    found = np.empty(len(moves))
    for k in range(len(moves)):
        first = 0
        while not there[k, first]:
            first += 1
        x, y = moves[k, first]  # the nearest of the segment from a to b
        ax, ay, bx, by = x, y, x, y
        while True:
            along, p, q = np.inf, x, y
            for i in range(moves.shape[1]):
                a, b = moves[k, i, 0], moves[k, i, 1]
                if there[k, i] and a * x + b * y < along:
                    along, p, q = a * x + b * y, a, b
            size = np.hypot(x, y)
            # No point of the hull is nearer to 0 by more than that over |x|.
            if size * size - along <= _HULL_ENOUGH * size:
                break
            # Turning about 0 alike from a to b, to the vertex and back it is inside.
            ab, bp, pa = ax * by - ay * bx, bx * q - by * p, p * ay - q * ax
            if min(ab, bp, pa) > 0.0 or max(ab, bp, pa) < 0.0:
                x, y = 0.0, 0.0
                break
            of_a, of_b = _nearest(ax, ay, p, q), _nearest(bx, by, p, q)
            by_a, by_b = np.hypot(*of_a), np.hypot(*of_b)
            # Of a segment through 0, rounding may leave both farther.
            if not min(by_a, by_b) < size:
                break
            if by_a <= by_b:
                (x, y), bx, by = of_a, p, q
            else:
                (x, y), ax, ay = of_b, p, q
        found[k] = np.hypot(x, y)
    return found


def step_slips(p_WS: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """(B - 1,) how far a foot slips from each frame to the next [m]; inf where that is
    not asked.

    Args:
        p_WS: (B, V, 3) points of its surface in the world [m].
        asked: (B - 1,) in which steps.
    """
    z = p_WS[..., 2]
    # Points that are low in both frames of a step are what it could stand on.
    low = z <= z.min(axis=1)[:, None] + _SOLE
    both = low[1:] & low[:-1]
    moves = np.diff(p_WS[..., :2], axis=0)
    slips = np.full(len(moves), np.inf)
    some = asked & both.any(axis=1)
    slips[some] = least_way(moves[some], both[some])
    # A foot that stands on other points than before has rolled from one to the other;
    # the point that moves least tells.
    other = asked & ~some
    ways = np.linalg.norm(moves[other], axis=2)
    slips[other] = ways.min(axis=1, initial=np.inf)
    return slips


def longest_slip(p_WS: Iterable[np.ndarray], planted: np.ndarray) -> float:
    """The longest way that a foot slips in one contact [m].

    Args:
        p_WS: blocks of points of its surface, as of `Outline.sole`.
        planted: (T,) whether it is on the floor.
    """
    stands, slips = planted[1:] & planted[:-1], []
    for block in p_WS:
        asked = stands[len(slips) :][: len(block) - 1]
        slips += step_slips(block, asked).tolist()
    return max((float(np.sum(slips[a:b])) for a, b in runs(stands)), default=0.0)


def foot_slip(
    foot: str, p_WS: Iterable[np.ndarray], floor: float, rate: float
) -> FootSlip:
    """When a foot is planted, and how far it slips then.

    Args:
        foot: its name.
        p_WS: blocks of points of its surface, as of `Outline.sole`.
        floor: height of the floor [m].
        rate: frames per second [Hz].
    """
    heights, slips = [], []  # of steps
    for block in p_WS:
        height = block[..., 2].min(axis=1) - floor
        heights.append(np.maximum(height[1:], height[:-1]))
        # What is higher is not planted, however it moves.
        slips.append(step_slips(block, heights[-1] <= THRESHOLDS.height_off))
    step_height, slips = np.concatenate(heights), np.concatenate(slips)
    stands = standing(step_height, slips * rate, THRESHOLDS)
    planted = np.zeros(len(slips) + 1, dtype=bool)
    every, worst, place, top = [], 0.0, None, 0.0
    for start, end in runs(stands):  # steps start, ..., end - 1
        if (end - start) / rate < _SHORTEST:
            continue
        planted[start : end + 1] = True
        way = float(slips[start:end].sum())
        every.append(way)
        top = max(top, float(slips[start:end].max() * rate))
        if place is None or way > worst:
            worst, place = way, (start, end)
    first, last = place or (None, None)
    contacts = len(every), float(sum(every))
    return FootSlip(foot, planted, *contacts, worst, first, last, top)
