"""Whether the ground could give what a reference motion takes, frame by frame.

A frame *stands* while a foot, or a hand, is planted on the floor; its *support* is the
hull of what is planted. The ground could give what it takes if the centre of pressure
of the mean force from the frame before to the frame after (`ground_demand`, by Drake's
momentum) is inside. Flights have no support, the first and the last frame no such mean:
they are not judged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.references.ground_contact import FEET, HANDS, Outline
from crar_drake.references.ground_demand import (
    ON_THE_FLOOR,
    GroundWrench,
    mean_wrench,
    outside_support,
)
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import find_root

_MOST = 0.95  # share of the frames whose worst is told


@dataclass(frozen=True)
class Lift:
    """A foot that is lifted while another one, or a hand, stays planted."""

    foot: str  # its name
    frame: int  # the last one in which it is planted
    # how far the centre of pressure is outside the support of what stays, from this
    # frame until a foot or hand is set down, or lifted [m]; negative inside: the motion
    # is *balanced on the other*
    outside: float


@dataclass(frozen=True, eq=False)
class Support:
    """What a motion of T frames stands on."""

    # (T,) height of the lowest that is planted; motions float by centimetres [m]
    floor: np.ndarray
    # foot or hand to (T, V, 3) points of its surface [m], their heights over its own
    # lowest one
    soles: dict[str, np.ndarray]
    planted: dict[str, np.ndarray]  # foot or hand to (T,) whether it is planted

    @property
    def stands(self) -> np.ndarray:
        """(T,) frames that are judged."""
        stands = np.any(list(self.planted.values()), axis=0)
        stands[[0, -1]] = False
        return stands

    def outside(self, wrench: GroundWrench) -> np.ndarray:
        """(T,) how far the centre of pressure is outside [m]; infinite where the ground
        had to pull, NaN where the frame is not judged."""
        outside = outside_support(wrench.centres(self.floor), self.soles, self.planted)
        outside[np.isnan(outside)] = np.inf
        outside[~self.stands] = np.nan
        return outside

    def lifts(self, wrench: GroundWrench) -> list[Lift]:
        """Where a foot is lifted while another one, or a hand, stays planted."""
        centres = wrench.centres(self.floor)
        outside = outside_support(centres, self.soles, self.stays)
        outside[np.isnan(outside)] = np.inf
        planted, found = np.array(list(self.planted.values())), []
        feet = [foot for foot in FEET if foot in self.planted]
        for foot in feet:
            own = self.planted[foot]
            for frame in np.flatnonzero(own[:-1] & ~own[1:]):
                alone, end = planted[:, frame + 1], frame + 1
                if not (planted[:, frame] & alone).any():
                    continue  # a jump
                while end < len(own) and (planted[:, end] == alone).all():
                    end += 1
                judged = outside[max(frame, 1) : min(end, len(own) - 1)]
                if len(judged):
                    found.append(Lift(foot, int(frame), float(judged.max())))
        return sorted(found, key=lambda lift: lift.frame)

    @property
    def stays(self) -> dict[str, np.ndarray]:
        """Foot or hand to (T,) whether it is planted, but for the last frame of a
        contact in which another carries that was planted in the frame before, too."""
        planted = np.array(list(self.planted.values()))  # (F, T)
        wide = np.pad(planted, ((0, 0), (1, 1)), mode="edge")
        goes_on = planted & wide[:, 2:]
        carried = (goes_on & wide[:, :-2]).any(axis=0)
        return dict(zip(self.planted, np.where(carried, goes_on, planted), strict=True))

    @property
    def goes_on(self) -> np.ndarray:
        """(T,) frames in which something stays planted that does in the frame before
        and in the frame after, unless these are of a flight."""
        stays = np.array(list(self.stays.values()))  # (F, T)
        some = stays.any(axis=0)
        shared = (stays[:, 1:] & stays[:, :-1]).any(axis=0)
        shared |= ~(some[1:] & some[:-1])
        return np.append(shared, True) & np.append(True, shared)

    def points(self) -> list[np.ndarray]:
        """(T) of each frame that is judged (V, 2) the points of what stays planted [m];
        none of others. So a foot is lifted, and set down, while the motion is balanced
        on the other."""
        found, stays = [], self.stays
        for t, stands in enumerate(self.stands):
            on = [
                p[t][p[t][:, 2] <= ON_THE_FLOOR][:, :2]
                for foot, p in self.soles.items()
                if stands and stays[foot][t]
            ]
            found.append(np.concatenate([np.empty((0, 2)), *on]))
        return found


class Ground:
    """The ground under motions of one robot."""

    def __init__(self, robot: WholeBody) -> None:
        """
        Args:
            robot: that moves.

        Raises:
            ModelError: its base does not float, or its feet have no shape.
        """
        name = robot.description.name
        root = find_root(robot.plant, robot.description)
        if root is None:
            raise ModelError(
                f"robot {name}: its base is fixed, and needs no ground to carry it; "
                "write root: prescribed into its robot.yaml, or leave --balance away"
            )
        self._robot, self._root = robot, root
        self._feet = Outline(robot)
        self._outline = Outline(robot, (*FEET, *HANDS))
        links = self._feet.links
        if not any(link in links for of in self._feet.feet.values() for link in of):
            raise ModelError(
                f"robot {name}: no foot has a shape, so that there is no sole to stand "
                f"on; add task_frames {' and '.join(FEET)} to its robot.yaml, or leave "
                "--balance away"
            )

    def support(self, motion: RobotMotion) -> Support:
        """What a motion stands on; its joints in the robot's order."""
        floor = self._feet.ground_contact(motion).floor
        contact = self._outline.ground_contact(motion, floor)
        planted = {foot.foot: foot.planted for foot in contact.feet}
        soles = self._outline.soles(motion)
        lowest = np.full(motion.num_frames, np.inf)
        for foot, points in soles.items():
            low = points[..., 2].min(axis=1)
            lowest[planted[foot]] = np.minimum(lowest, low)[planted[foot]]
            points[..., 2] -= low[:, None]
        return Support(np.where(lowest < np.inf, lowest, floor), soles, planted)

    def wrench(self, motion: RobotMotion) -> GroundWrench:
        """What a motion takes; see `mean_wrench`."""
        return mean_wrench(self._robot, self._root, motion)

    def outside(self, motion: RobotMotion) -> np.ndarray:
        """(T,) as of `Support.outside`."""
        return self.judged(motion)[0]

    def judged(self, motion: RobotMotion) -> tuple[np.ndarray, list[Lift]]:
        """As of `Support.outside`, and of `Support.lifts`."""
        support, wrench = self.support(motion), self.wrench(motion)
        return support.outside(wrench), support.lifts(wrench)


def given_share(outside: np.ndarray) -> float:
    """Share of the frames that stand in which the ground could give what they take; NaN
    if none stands.

    Args:
        outside: (T,) of `Support.outside`.
    """
    stands = ~np.isnan(outside)
    return float(np.mean(outside[stands] <= 0.0)) if stands.any() else np.nan


def worst_outside(outside: np.ndarray) -> float:
    """How far outside the centre of pressure is in the worst of 95 % of the frames that
    stand [m]; NaN if none stands."""
    stands = outside[~np.isnan(outside)]
    if not len(stands):
        return np.nan
    return float(np.quantile(stands, _MOST, method="inverted_cdf"))
