"""How a run stood on the floor: slip of feet, what was below the floor, and whether the
ground could carry it."""

from dataclasses import dataclass

import numpy as np

from crar_drake.motion.planted_feet import ContactThresholds
from crar_drake.references.ground_contact import GroundContact, Outline
from crar_drake.references.ground_demand import ground_wrench, outside_support
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_motion import motion_of_log

_MOST_RATE = 100.0  # [Hz] of samples that are looked at

# A foot is planted if it touches the floor, however fast: here the floor is known.
_TOUCHING = ContactThresholds(
    height_on=0.001, height_off=0.002, speed_on=np.inf, speed_off=np.inf
)


@dataclass(frozen=True)
class Footing:
    """The figures of one run, the floor at z = 0, without blending in at the start."""

    # stretches in which a foot is planted: from within 1 mm of the floor till it is
    # higher than 2 mm
    contacts: int
    median_slip: float | None  # that a foot slides in one of them [m]; None: none
    worst_slip: float | None  # [m]
    lowest: float  # height of the robot's lowest point [m]
    lowest_link: str  # the link it is on
    lowest_time: float  # when [s]
    planted_share: float  # share of the time in which a foot is planted
    # share of that in which the centre of pressure is inside the support polygon; None
    # without any
    supported_share: float | None
    median_outside: float | None  # how far outside it is otherwise, in the median [m]
    least_force: float  # upwards, over the weight
    largest_force: float  # as well
    # horizontal over vertical force that 95 % of the time need less than
    friction: float | None

    def lines(self) -> list[str]:
        """The figures in words."""
        slip = "no contact"
        if self.contacts:
            slip = (
                f"{self.contacts} contacts, slip {1e3 * self.median_slip:.1f} mm in "
                f"the median, {1e3 * self.worst_slip:.1f} mm at worst"
            )
        lines = [
            f"feet: {slip}",
            f"lowest point: {1e3 * self.lowest:.1f} mm, {self.lowest_link}, at "
            f"{self.lowest_time:.2f} s",
        ]
        if self.supported_share is None:
            lines.append("ground: no foot is planted")
            return lines
        line = (
            f"ground: it would have to push with {self.least_force:.2f} to "
            f"{self.largest_force:.2f} times the weight; the centre of pressure is "
            f"inside the support {100 * self.supported_share:.0f} % of the time with a "
            f"planted foot ({100 * self.planted_share:.0f} %)"
        )
        if self.median_outside is not None:
            line += f", else {1e3 * self.median_outside:.0f} mm outside in the median"
        return [*lines, f"{line} (a note on feasibility, not a promise)"]


def lowest_point(
    log: SimulationLog, robot: WholeBody, start: float = 0.0
) -> tuple[float, str, float]:
    """Height over the floor z = 0 [m], link and time [s] of what was lowest in a run.

    Args:
        log: of a robot the root of which a motion moves.
        start: as in `footing`.

    Raises:
        MotionError, CrarError: as of `motion_of_log`.
    """
    rows, seen = _after(log, robot, start)
    return _lowest(Outline(robot).ground_contact(seen, floor=0.0), log.time[rows])


def footing(log: SimulationLog, robot: WholeBody, start: float = 0.0) -> Footing:
    """How a run stood on the floor z = 0.

    Args:
        log: of a robot the root of which floats.
        start: what is before is left out, such as blending in [s].

    Raises:
        MotionError, CrarError: as of `motion_of_log`.
        ModelError: the robot's root does not float.
    """
    rows, seen = _after(log, robot, start)
    outline = Outline(robot)
    contact = outline.ground_contact(seen, floor=0.0, thresholds=_TOUCHING)
    slips = np.concatenate([np.empty(0), *(foot.ways for foot in contact.feet)])
    wrench = ground_wrench(
        robot.plant, log.q[rows], log.v[rows], log.desired_acceleration[rows]
    )
    planted = {foot.foot: foot.planted for foot in contact.feet}
    outside = outside_support(wrench.centres(), outline.soles(seen), planted)
    standing = np.zeros(seen.num_frames, dtype=bool)
    for flags in planted.values():
        standing |= flags
    beyond = outside[standing & (outside > 0.0)]
    friction = wrench.friction[standing & np.isfinite(wrench.friction)]
    upwards = wrench.force[:, 2] / wrench.weight
    lowest, lowest_link, lowest_time = _lowest(contact, log.time[rows])
    count = np.count_nonzero(standing)
    return Footing(
        contacts=len(slips),
        median_slip=float(np.median(slips)) if len(slips) else None,
        worst_slip=float(slips.max()) if len(slips) else None,
        lowest=lowest,
        lowest_link=lowest_link,
        lowest_time=lowest_time,
        planted_share=count / seen.num_frames,
        supported_share=np.count_nonzero(outside[standing] <= 0.0) / count
        if count
        else None,
        median_outside=float(np.median(beyond)) if len(beyond) else None,
        least_force=float(upwards.min()),
        largest_force=float(upwards.max()),
        friction=float(np.quantile(friction, 0.95)) if len(friction) else None,
    )


def _lowest(contact: GroundContact, times: np.ndarray) -> tuple[float, str, float]:
    low = int(contact.lowest.argmin())
    return float(contact.lowest[low]), contact.lowest_links[low], float(times[low])


def _after(
    log: SimulationLog, robot: WholeBody, start: float
) -> tuple[slice, RobotMotion]:
    """The samples from a time on that are looked at, and the motion in them."""
    motion = motion_of_log(log, robot)
    first = int(np.searchsorted(log.time, start - 1e-9))
    first = min(first, motion.num_frames - 2)
    every = max(1, int(np.ceil(motion.rate / _MOST_RATE - 1e-9)))
    rows = slice(first, None, every)
    return rows, RobotMotion(
        joint_names=motion.joint_names,
        root_positions=motion.root_positions[rows],
        root_quaternions=motion.root_quaternions[rows],
        joint_positions=motion.joint_positions[rows],
        rate=motion.rate / every,
    )
