"""A motion against the ground z = 0: how low the robot gets, and how its feet slip.

A foot is *planted* while it is low and still (`motion.planted_feet`). The floor is
where the feet are when they are lowest, since motions may float or sink as a whole,
which is reported apart.

The *slip* of a planted foot from one frame to the next is the smallest horizontal way
of its points near the floor, those between its vertices among them: a foot that rolls
over its toes, or turns on its ball, has one that stays.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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

# A hand carries a little so long before and after it is planted [s].
_BEFORE_CARRYING = 0.1


@dataclass(frozen=True, eq=False)
class FootSlip:
    """What a foot does on the floor."""

    foot: str  # name of the motion's point, such as left_foot
    planted: np.ndarray  # (T,) whether it is
    num_contacts: int  # stretches in which it is planted
    total: float  # way that it slips while planted, in all of them [m]
    ways: np.ndarray  # (num_contacts,) of each contact [m]
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
    """The robot's links as balls: vertices of hulls, or the ends of capsules."""

    def __init__(self, robot: WholeBody, points: Sequence[str] = FEET) -> None:
        """
        Args:
            robot: whose links have meshes, or else capsules and spheres.
            points: task frames of what may stand on the ground.
        """
        self._robot = robot
        self._outlines = robot.outlines
        self.feet = {
            point: links_outward(robot.plant, find_frame(robot.plant, frame))
            for point, frame in robot.description.task_frames.items()
            if point in points
        }

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links that have a shape."""
        return tuple(self._outlines)

    def ground_contact(
        self,
        motion: RobotMotion,
        floor: float | None = None,
        thresholds: ContactThresholds = THRESHOLDS,
    ) -> GroundContact:
        """A motion against the ground.

        Args:
            motion: with its joints in the order of the robot.
            floor: height at which feet stand [m]; by default where they are lowest.
            thresholds: of a planted foot.
        """
        links = self.links
        if not links:
            zeros = np.zeros(motion.num_frames)
            return GroundContact(zeros, ("",) * motion.num_frames, 0.0, ())
        p_WB, R_WB = self._poses(motion, links)
        low = self._robot.lowest(links, p_WB, R_WB)
        soles = self._soles(links, p_WB, R_WB)
        if floor is None:
            floor = _lowest_floor(self._of_feet(links, low))
        return GroundContact(
            lowest=low.min(axis=1),
            lowest_links=tuple(links[i] for i in low.argmin(axis=1)),
            floor=floor,
            feet=tuple(
                foot_slip(foot, p_WS, floor, motion.rate, thresholds)
                for foot, p_WS in soles.items()
            ),
        )

    def slip_of_planted(
        self, motion: RobotMotion, planted: Mapping[str, np.ndarray]
    ) -> float:
        """The longest way that a foot slips in one contact, where contacts are known
        [m].

        Args:
            motion: with its joints in the order of the robot.
            planted: foot to (T,) whether it is on the floor.
        """
        soles = self.soles(motion).items()
        return max((longest_slip(p, planted[foot]) for foot, p in soles), default=0.0)

    def soles(self, motion: RobotMotion) -> dict[str, np.ndarray]:
        """Foot to (T, V, 3) the lowest points of its balls, in the world [m].

        Args:
            motion: with its joints in the order of the robot.
        """
        links = self._links_of_feet()
        return self._soles(links, *self._poses(motion, links))

    def heights(self, motion: RobotMotion) -> dict[str, np.ndarray]:
        """Foot to (T,) the height of its lowest point [m].

        Args:
            motion: with its joints in the order of the robot.
        """
        links = self._links_of_feet()
        low = self._robot.lowest(links, *self._poses(motion, links))
        return self._of_feet(links, low)

    def _links_of_feet(self) -> list[str]:
        return [b for b in self.links if any(b in of for of in self.feet.values())]

    def _poses(
        self, motion: RobotMotion, links: Sequence[str]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where links are in the world: p_WB (T, L, 3) [m], R_WB (T, L, 3, 3)."""
        root = motion.root_positions, motion.root_rotations
        return self._robot.poses_in_world(*root, motion.joint_positions, links)

    def _of_feet(self, links: Sequence[str], low: np.ndarray) -> dict[str, np.ndarray]:
        """`heights`, where those of links are (T, L)."""
        of_feet = {
            foot: low[:, [i for i, link in enumerate(links) if link in of]]
            for foot, of in self.feet.items()
        }
        return {foot: z.min(axis=1) for foot, z in of_feet.items() if z.shape[1]}

    def _soles(
        self, links: Sequence[str], p_WB: np.ndarray, R_WB: np.ndarray
    ) -> dict[str, np.ndarray]:
        """`soles` of links whose poses are (T, L)."""
        soles = {
            foot: self._sole({b: links.index(b) for b in of if b in links}, p_WB, R_WB)
            for foot, of in self.feet.items()
        }
        return {foot: sole for foot, sole in soles.items() if sole.shape[1]}

    def _sole(
        self, rows: Mapping[str, int], p_WB: np.ndarray, R_WB: np.ndarray
    ) -> np.ndarray:
        """(T, V, 3) lowest points of the balls of some links, in the world."""
        points = [np.empty((len(p_WB), 0, 3))]
        for link, i in rows.items():
            outline = self._outlines[link]
            # Transposed in place, NumPy would multiply it many times slower.
            R_BW = np.ascontiguousarray(R_WB[:, i].swapaxes(1, 2))
            p = p_WB[:, i, None] + outline.points @ R_BW
            p[..., 2] -= outline.radii
            points.append(p)
        return np.concatenate(points, axis=1)


class CarryingHands:
    """When hands carry a robot: while they are planted on the floor of its feet."""

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: with or without hands.
        """
        self._feet, self._hands = Outline(robot), Outline(robot, HANDS)

    def shares(self, motion: RobotMotion, hands: Sequence[str]) -> np.ndarray:
        """(T, H) 1 where a hand carries, and less shortly before and after, else 0.

        Args:
            motion: with its joints in the order of the robot.
            hands: task frames.
        """
        shares = np.zeros((motion.num_frames, len(hands)))
        if not self._hands.feet:
            return shares
        of_hands = self._hands.heights(motion)
        floor = _lowest_floor(self._feet.heights(motion))
        # What is never low is never planted, and not looked at.
        low = [z.min() <= floor + THRESHOLDS.height_off for z in of_hands.values()]
        if not any(low):
            return shares
        before = round(_BEFORE_CARRYING * motion.rate)
        weights = np.full(2 * before + 1, 1.0 / (2 * before + 1))
        for hand, p_WS in self._hands.soles(motion).items():
            if hand in hands:
                planted = foot_slip(hand, p_WS, floor, motion.rate).planted
                share = np.convolve(spread(planted, before), weights)
                shares[:, hands.index(hand)] = share[before:][: len(shares)]
        return shares


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
    """(T - 1,) how far a foot slips from each frame to the next [m]; inf where that is
    not asked.

    Args:
        p_WS: (T, V, 3) points of its surface in the world [m].
        asked: (T - 1,) in which steps.
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


def longest_slip(p_WS: np.ndarray, planted: np.ndarray) -> float:
    """The longest way that a foot slips in one contact [m].

    Args:
        p_WS: (T, V, 3) points of its surface in the world [m].
        planted: (T,) whether it is on the floor.
    """
    stands = planted[1:] & planted[:-1]
    slips = step_slips(p_WS, stands)
    return max((float(slips[a:b].sum()) for a, b in runs(stands)), default=0.0)


def foot_slip(
    foot: str,
    p_WS: np.ndarray,
    floor: float,
    rate: float,
    thresholds: ContactThresholds = THRESHOLDS,
) -> FootSlip:
    """When a foot is planted, and how far it slips then.

    Args:
        foot: its name.
        p_WS: (T, V, 3) points of its surface in the world [m].
        floor: height of the floor [m].
        rate: frames per second [Hz].
        thresholds: of a planted foot.
    """
    z = p_WS[..., 2]
    height = z.min(axis=1) - floor  # (T,)
    # What is higher is not planted, however it moves.
    step_height = np.maximum(height[1:], height[:-1])
    slips = step_slips(p_WS, step_height <= thresholds.height_off)
    stands = standing(step_height, slips * rate, thresholds)
    planted = np.zeros(len(z), dtype=bool)
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
    return FootSlip(
        foot,
        planted,
        len(every),
        float(sum(every)),
        np.array(every),
        worst,
        first,
        last,
        top,
    )
