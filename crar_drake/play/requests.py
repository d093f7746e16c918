"""What the page asks for: JSON, one object each, and numbers in bounds.

    {"do": "pause"}  {"do": "resume"}  {"do": "step"}  {"do": "stop"}
    {"do": "speed", "value": 0.5}
    {"do": "offset", "task": 0, "value": [0.1, 0, 0]}           of a target [m]
    {"do": "home"}                                              no offsets
    {"do": "ball", "value": [1, 0, 1]}                          to a place [m]
    {"do": "ball away"}                                         where it was at first
    {"do": "motion", "value": false}
    {"do": "push", "frame": "left_hand", "value": [0, 60, 0]}   [N]

Nothing in a request is run, and names are looked up among those of the robot.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

from crar_drake.errors import CrarError
from crar_drake.play.pacing import FASTEST, SLOWEST

LONGEST = 2048  # [bytes]
FARTHEST = 2.0  # of an offset, in each direction [m]
FARTHEST_BALL = 10.0  # likewise, from the origin of the world [m]
STRONGEST = 500.0  # of a push, in each direction [N]
# Far more frames than a robot has.
_MOST_TASKS = 1000


class RequestError(CrarError):
    """A request that is not one of those above; it says why."""


@dataclass(frozen=True)
class Request:
    """One request, checked as far as can be without the simulation."""

    do: str  # what, see the module
    value: object = None  # of a type that belongs to `do`; None if it has none
    task: int = 0  # number of a task, of "offset"
    frame: str = ""  # name of a frame, of "push"


def parse(body: bytes) -> Request:
    """Reads a request.

    Raises:
        RequestError: it is no request.
    """
    if len(body) > LONGEST:
        raise RequestError(f"longer than {LONGEST} bytes")
    try:
        said = json.loads(body)
        # JSON can name halves of characters, which no text may have.
        json.dumps(said, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise RequestError("text that is no valid Unicode") from error
    except (ValueError, RecursionError) as error:
        raise RequestError(f"no JSON: {error}") from error
    if not isinstance(said, dict) or not isinstance(said.get("do"), str):
        raise RequestError('no object with a "do"')
    if said["do"] not in _KINDS:
        raise RequestError(f"there is no {said['do'][:40]!r} to do")
    read, more = _KINDS[said["do"]]
    wanted = {"do", *more} | ({"value"} if read is not None else set())
    if set(said) != wanted:
        raise RequestError(f"{said['do']} has {', '.join(sorted(wanted))}")
    return Request(
        said["do"],
        None if read is None else read(said["value"]),
        int(_number(said["task"], 0, _MOST_TASKS)) if "task" in more else 0,
        _name(said["frame"]) if "frame" in more else "",
    )


def _number(value: object, least: float, most: float) -> float:
    # To Python, true is a number.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise RequestError(f"{str(value)[:40]!r} is no number")
    if not (least <= value <= most and math.isfinite(value)):
        raise RequestError(f"{str(value)[:40]} is not from {least:g} to {most:g}")
    return float(value)


def _name(value: object) -> str:
    if not isinstance(value, str) or len(value) > 200:
        raise RequestError("a frame is given by its name")
    return value


def _switch(value: object) -> bool:
    if not isinstance(value, bool):
        raise RequestError("value is true or false")
    return value


def _vector(most: float) -> Callable[[object], tuple[float, ...]]:
    def read(value: object) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != 3:
            raise RequestError("value is three numbers")
        return tuple(_number(x, -most, most) for x in value)

    return read


# How the value is read, None if there is none, and what else a request has.
_KINDS: dict[str, tuple[Callable[[object], object] | None, tuple[str, ...]]] = {
    "pause": (None, ()),
    "resume": (None, ()),
    "step": (None, ()),
    "stop": (None, ()),
    "home": (None, ()),
    "speed": (lambda value: _number(value, SLOWEST, FASTEST), ()),
    "offset": (_vector(FARTHEST), ("task",)),
    "ball": (_vector(FARTHEST_BALL), ()),
    "ball away": (None, ()),
    "motion": (_switch, ()),
    "push": (_vector(STRONGEST), ("frame",)),
}
