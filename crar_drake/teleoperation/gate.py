"""What a target may be: the bounds that `crar-drake serve` has options for."""

from dataclasses import dataclass, field


def _bound(default: float, unit: str, words: str) -> float:
    """A field; the command's help has its unit and words."""
    return field(default=default, metadata={"unit": unit, "help": words})


@dataclass(frozen=True)
class Gate:
    """What a target may be."""

    speed: float = _bound(
        1.5, "M/S", "targets that are faster are approached at it"
    )  # [m/s]
    angular_speed: float = _bound(6.0, "RAD/S", "the same of orientations")  # [rad/s]
    # [rad/s or m/s]
    joint_speed: float = _bound(
        3.0,
        "RAD/S",
        "tasks that are joints count as clamped if they are faster, and pass as they "
        "are: the robot's own speed limits slow them down",
    )
    distance: float = _bound(
        1.0, "M", "targets farther from the robot's point are rejected, but for joints"
    )  # [m]
    timeout: float = _bound(
        0.25, "S", "without targets for so long the robot brakes"
    )  # [s]
