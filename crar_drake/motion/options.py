"""What a user says of a motion file that the file leaves open."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from crar_drake.errors import MotionError

# Name of a unit: metres.
UNITS = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "in": 0.0254,
    "cmu": 0.0254 / 0.45,  # of the CMU database's ASF files, and of BVHs made of them
}
AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True)
class MotionOptions:
    """Overrides of what is read off a motion file, or inferred from it."""

    # the ASF file of an AMC motion, "" for the one beside it; the model's own NPZ of a
    # motion of SMPL-H or SMPL-X, "" for a body in the mean
    skeleton: str = ""
    frame_rate: float | None = None  # samples per second [Hz]; None for the file's own
    unit: str = ""  # a key of UNITS, or its metres as a number; "" to infer it
    up: str = ""  # the file's axis that points up, one of AXES (the + may be left out)
    facing: str = ""  # the file's axis that becomes forward
    joints: str = ""  # YAML file that says which of the file's joints are meant

    def __post_init__(self) -> None:
        """Raises MotionError if an axis or the unit is none."""
        if self.unit:
            metres_of(self.unit)
        for option, axis in (("up", self.up), ("facing", self.facing)):
            if axis:
                axis_of(axis, option)
        if self.up and self.facing:
            if axis_of(self.up, "up")[1] == axis_of(self.facing, "facing")[1]:
                raise MotionError(
                    f"facing: {self.facing} and up: {self.up} are along one axis"
                )

    def refuse(self, names: Sequence[str], motion: str) -> None:
        """Raises MotionError if one of these options is given, which a motion does not
        leave open; it says what that is, as in "motion a.amc is an AMC"."""
        for name in names:
            if given := getattr(self, name):
                raise MotionError(
                    f"{name}: {motion}, which says that itself; leave {name} {given} "
                    "away"
                )

    def rate_of(self, motion: str, stated: float) -> tuple[float, str]:
        """The rate that is given, else `stated` by the file [Hz]; "given" or "file".

        Raises:
            MotionError: neither is; `stated` is 0 then.
        """
        if not (self.frame_rate or stated):
            raise MotionError(
                f"motion {motion}: the file says no rate: give --frame-rate HZ"
            )
        return self.frame_rate or stated, "given" if self.frame_rate else "file"


def metres_of(unit: str) -> float:
    """Metres in a unit [m].

    Raises:
        MotionError: it is neither a key of UNITS nor a positive number.
    """
    try:
        metres = UNITS[unit] if unit in UNITS else float(unit)
    except ValueError:
        metres = math.nan
    if not 0.0 < metres < math.inf:
        raise MotionError(
            f"unit: {unit!r} is none; known: {', '.join(UNITS)}, or a number of metres"
        )
    return metres


def axis_of(text: str, option: str) -> str:
    """The axis of AXES that an option means by "-y" or "y".

    Raises:
        MotionError: there is no such axis.
    """
    axis = text.strip().lower()
    axis = axis if axis[:1] in "+-" else f"+{axis}"
    if axis not in AXES:
        raise MotionError(f"{option}: {text!r} is none of {', '.join(AXES)}")
    return axis
