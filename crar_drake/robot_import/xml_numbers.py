"""Numbers in the attributes of a URDF, as people write them."""

from __future__ import annotations

import numpy as np


def numbers_of(text: str | None, infinite: bool = False) -> tuple[float, ...]:
    """Numbers in a text, also those that were written with commas.

    "1.5 2 3", "1.5, 2, 3" and "1.5,2,3" are three numbers, "1,5" is one. ValueError
    where something is none, NaN, or infinite if it must not be.
    """
    words = [word.strip(",") for word in (text or "").split()]
    numbers = []
    for word in words:
        decimal = word.count(",") == 1 and "." not in word
        pieces = [word.replace(",", ".")] if decimal else word.split(",")
        for piece in pieces:
            try:
                numbers.append(float(piece))
            except ValueError:
                raise ValueError(f"{text!r} is not made of numbers") from None
    if np.isnan(numbers).any() or not (infinite or np.isfinite(numbers).all()):
        raise ValueError(f"{text!r} is not made of finite numbers")
    return tuple(numbers)


def three_numbers(text: str | None) -> tuple[float, ...]:
    numbers = numbers_of(text)
    if len(numbers) != 3:
        raise ValueError(f"{text!r} is not three numbers")
    return numbers


def one_number(text: str, infinite: bool = False) -> float:
    """The number that an attribute is; "1,5" is 1.5. ValueError if it is none."""
    numbers = numbers_of(text, infinite)
    if len(numbers) != 1:
        raise ValueError(f"{text!r} is not a number")
    return numbers[0]
