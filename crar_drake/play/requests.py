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

from collections.abc import Callable
from dataclasses import dataclass

from crar_drake.play.pacing import FASTEST, SLOWEST
from crar_drake.strict_json import MessageError, number, numbers, read_object

LONGEST = 2048  # [bytes]
FARTHEST = 2.0  # of an offset, in each direction [m]
FARTHEST_BALL = 10.0  # likewise, from the origin of the world [m]
STRONGEST = 500.0  # of a push, in each direction [N]
# Far more frames than a robot has.
_MOST_TASKS = 1000


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
        MessageError: it is no request.
    """
    said = read_object(body, LONGEST)
    do = said.pop("do", None)
    if not isinstance(do, str) or do not in _KINDS:
        raise MessageError(f"there is no {str(do)[:40]!r} to do")
    if set(said) != set(_KINDS[do]):
        raise MessageError(f"{do} has {', '.join(['do', *_KINDS[do]])}")
    return Request(do, **{key: read(said[key]) for key, read in _KINDS[do].items()})


def _task(value: object) -> int:
    return int(number(value, 0, _MOST_TASKS))


def _name(value: object) -> str:
    if not isinstance(value, str) or len(value) > 200:
        raise MessageError("a frame is given by its name")
    return value


def _switch(value: object) -> bool:
    if not isinstance(value, bool):
        raise MessageError("value is true or false")
    return value


def _speed(value: object) -> float:
    return number(value, SLOWEST, FASTEST)


def _vector(most: float) -> Callable[[object], list[float]]:
    return lambda value: numbers("value", value, 3, most)


# What a request has beside `do`, and how that is read.
_KINDS: dict[str, dict[str, Callable[[object], object]]] = {
    "pause": {},
    "resume": {},
    "step": {},
    "stop": {},
    "home": {},
    "speed": {"value": _speed},
    "offset": {"task": _task, "value": _vector(FARTHEST)},
    "ball": {"value": _vector(FARTHEST_BALL)},
    "ball away": {},
    "motion": {"value": _switch},
    "push": {"frame": _name, "value": _vector(STRONGEST)},
}
