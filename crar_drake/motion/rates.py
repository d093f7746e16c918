"""Frame rates that files state in another unit than they should."""

import math
from collections.abc import Mapping

from crar_drake.errors import MotionError

# Slower is no recording of motion [Hz]; what is said to be so is said otherwise.
SLOWEST = 1.0
# Faster, what is computed around a frame for a part of a second fills any memory [Hz].
_FASTEST = 1e5
_PLAUSIBLE = (5.0, 2000.0)  # [Hz]
# What cameras and games run at [Hz].
_USUAL = (
    *(10.0, 12.0, 12.5, 15.0, 20.0, 23.976, 24.0, 25.0, 29.97, 30.0, 48.0, 50.0),
    *(59.94, 60.0, 72.0, 75.0, 80.0, 90.0, 100.0, 119.88, 120.0, 125.0, 144.0, 150.0),
    *(160.0, 180.0, 200.0, 240.0, 250.0, 300.0, 400.0, 480.0, 500.0, 600.0, 1000.0),
)
_NEAR = 2e-3  # of a usual rate: files round frame times to three digits or more


def can_be_rate(rate: float) -> bool:
    """Whether a motion of a robot can have the rate [Hz]."""
    return 0.0 < rate <= _FASTEST


def check_rate(rate: float) -> None:
    """Raises MotionError if a motion of a robot cannot have the rate [Hz]."""
    if not can_be_rate(rate):
        raise MotionError(
            f"the rate is {rate:g} Hz; it must be positive, and at most "
            f"{_FASTEST:.0f} Hz"
        )


def rate_meant(
    where: str, stated: str, readings: Mapping[str, float]
) -> tuple[float, str]:
    """The rate [Hz] that a file means which states an impossible one, and a sentence.

    Args:
        stated: what the file says, as in "a frame time of 30 s".
        readings: what else the number could be ("a rate", "milliseconds") to the
            rate then [Hz].

    Raises:
        MotionError: none of the readings is a usual rate, or more than one.
    """
    usual = {reading: rate for reading, rate in readings.items() if _is_usual(rate)}
    if len(usual) != 1:
        could = ", ".join(f"{rate:g} Hz if {what}" for what, rate in readings.items())
        raise MotionError(
            f"{where}: {stated} is none ({could}); say the rate: --frame-rate HZ"
        )
    ((reading, rate),) = usual.items()
    near = min(_USUAL, key=lambda usual_rate: abs(math.log(rate / usual_rate)))
    return near, (
        f"{stated} is none: taken as {reading}, so {near:g} Hz (--frame-rate HZ says "
        "another)"
    )


def rate_doubt(rate: float) -> str:
    """Why a rate [Hz] is doubted, or ""."""
    if _PLAUSIBLE[0] <= rate <= _PLAUSIBLE[1]:
        return ""
    return f"a rate of {rate:g} Hz is no camera's: is it another? --frame-rate HZ"


def _is_usual(rate: float) -> bool:
    return 0.0 < rate < math.inf and any(
        abs(rate / usual - 1.0) < _NEAR for usual in _USUAL
    )
