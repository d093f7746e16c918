"""The package as it is without Numba, beside the compiled one in the same process.

So both can be timed by turns: a machine that is slower for a while is so for both.
"""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType, SimpleNamespace

from crar_drake.equations import compilation

_PACKAGE = "crar_drake"

# What is measured: names, and where they are.
_NAMES = {
    "ControlModel": "robot.model",
    "CrarController": "control.controller",
    "CrarParameters": "control.parameters",
    "MakeCrarDiagram": "simulation.diagram",
    "PrepareScenario": "simulation.diagram",
    "Scenario": "simulation.scenario",
    "Task": "robot.task",
    "distance_gradient_about_origin": "equations.collisions",
    "load_robot_description": "robot.description",
    "nearest_of_pairs": "equations.capsule_distances",
    "position_tasks": "robot.task",
}


@cache
def as_it_is() -> SimpleNamespace:
    """The names of `_NAMES`: compiled where Numba is installed."""
    return _gather()


@cache
def plain() -> SimpleNamespace:
    """The same names of a second copy of the package, in plain NumPy.

    Its classes are others than those of the first copy. Without Numba, or with
    NUMBA_DISABLE_JIT=1, there is one copy only, which is plain.
    """
    if not compilation.IS_COMPILED:
        return as_it_is()
    with _second_copy(), _disabled():
        return _gather()


def _gather() -> SimpleNamespace:
    found = {
        name: getattr(importlib.import_module(f"{_PACKAGE}.{module}"), name)
        for name, module in _NAMES.items()
    }
    return SimpleNamespace(**found)


@contextmanager
def _second_copy() -> Iterator[None]:
    """Imports of the package load it anew; afterwards the first copy is back."""

    def loaded() -> dict[str, ModuleType]:
        return {
            name: module
            for name, module in sys.modules.items()
            if name == _PACKAGE or name.startswith(f"{_PACKAGE}.")
        }

    first = loaded()
    for name in first:
        del sys.modules[name]
    try:
        yield
    finally:
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(first)


@contextmanager
def _disabled() -> Iterator[None]:
    """Numba compiles nothing of what is decorated meanwhile."""
    config = compilation.numba.config
    before = config.DISABLE_JIT
    config.DISABLE_JIT = 1
    try:
        yield
    finally:
        config.DISABLE_JIT = before
