"""Checks of parameters that all their classes share."""

import math
from collections.abc import Collection
from dataclasses import fields
from numbers import Real
from typing import Any

from crar_drake.errors import ScenarioError, nearest


def check_choice(
    where: str, parameters: Any, name: str, choices: tuple[str, ...]
) -> None:
    """Raises ScenarioError unless the field is one of the choices."""
    value = getattr(parameters, name)
    if value not in choices:
        raise ScenarioError(
            f"{where}.{name}: {value!r} is unknown{nearest(str(value), choices)}"
        )


def check_numbers(
    where: str,
    parameters: Any,
    names: Collection[str] | None = None,
    may_be_zero: set[str] = frozenset(),
    may_be_infinite: set[str] = frozenset(),
) -> None:
    """Fields that are numbers by default are numbers, positive and finite; zero or
    infinite only where that means "off".

    Args:
        where: the way to these, for messages.
        parameters: a dataclass.
        names: of the fields; by default all.
        may_be_zero, may_be_infinite: which of them.

    Raises:
        ScenarioError: names the field.
    """
    for entry in fields(parameters):
        if names is not None and entry.name not in names:
            continue
        value = getattr(parameters, entry.name)
        if not isinstance(value, Real) or isinstance(value, bool):
            if isinstance(entry.default, float):
                raise ScenarioError(f"{where}.{entry.name}: {value!r} is no number")
            continue
        zero = entry.name in may_be_zero
        infinite = entry.name in may_be_infinite
        finite = math.isfinite(value) or (value == math.inf and infinite)
        if not finite or value < 0.0 or (value == 0.0 and not zero):
            raise ScenarioError(
                f"{where}.{entry.name}: {value} must be "
                f"{'not negative' if zero else 'positive'}"
                + ("" if infinite else " and finite")
            )
