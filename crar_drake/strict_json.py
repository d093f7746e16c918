"""JSON of anybody's: an object, each key once, with numbers in bounds.

Nothing that is read is run, and what is wrong is one kind of error.
"""

import json
import math

import numpy as np

from crar_drake.errors import CrarError


class MessageError(CrarError):
    """What was sent is none of what can be; it says why."""


def read_object(text: bytes, longest: float = math.inf) -> dict[str, object]:
    """Reads an object.

    Args:
        longest: text that is longer is not looked at [bytes].

    Raises:
        MessageError: it is too long, or no object.
    """
    if len(text) > longest:
        raise MessageError(f"longer than {longest} bytes")
    try:
        said = json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)
        # JSON can name halves of characters, which no text may have.
        json.dumps(said, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise MessageError("text that is no valid Unicode") from error
    except (ValueError, RecursionError) as error:
        raise MessageError(f"no JSON: {error}") from error
    if not isinstance(said, dict):
        raise MessageError("no JSON object")
    return said


def number(value: object, least: float, most: float) -> float:
    """A finite number in bounds.

    Raises:
        MessageError: it is none.
    """
    # To Python, true is a number.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MessageError(f"{str(value)[:40]!r} is no number")
    if not (least <= value <= most and abs(value) < math.inf):
        raise MessageError(f"{str(value)[:40]} is not from {least:g} to {most:g}")
    return float(value)


def numbers(name: str, value: object, count: int, most: float) -> list[float]:
    """So many numbers in a list, each from -most to most.

    Raises:
        MessageError: it is no such list.
    """
    if not isinstance(value, list) or len(value) != count:
        raise MessageError(f"{name} is {count} numbers")
    return [number(x, -most, most) for x in value]


def finite(value: float | np.ndarray, digits: int) -> float | None | list:
    """What is to be said, for JSON, which has no infinity and no NaN.

    Args:
        value: a number, or an array of any shape.
        digits: behind the point.
    """
    if np.ndim(value):
        return [finite(each, digits) for each in value]
    return round(float(value), digits) if math.isfinite(value) else None


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no number")


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key twice")
    return found
