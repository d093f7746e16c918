"""Numba's compiler if it is installed; else the functions are interpreted, slowly.

What is compiled is kept in the user's cache, so that only the first process compiles.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from crar_drake.equations.collisions import DISTANCE_CLAMP
from crar_drake.equations.joint_limits import LIMIT_CLAMP
from crar_drake.equations.lookahead import SMALLEST_MARGIN
from crar_drake.resources import cached

try:
    import numba
except ImportError:
    numba = None

HAS_NUMBA = numba is not None


def cache_folder() -> Path:
    """Where these functions are kept, compiled: another folder for other sources.

    Numba looks at the file of a function only, but a compiled function contains those
    that it calls, and the constants that it uses.
    """
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    digest.update(repr((DISTANCE_CLAMP, LIMIT_CLAMP, SMALLEST_MARGIN)).encode())
    return cached("compiled") / digest.hexdigest()[:16]


def njit(function: Callable) -> Callable:
    """The function, to be compiled at its first call; as it is without Numba."""
    if numba is None:
        return function
    # Numba has one setting for everybody's functions: it is only borrowed.
    theirs = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_CACHE_FOLDER)
    try:
        return numba.njit(cache=True)(function)
    except RuntimeError:  # nothing can be written there: compile in every process
        return numba.njit(function)
    finally:
        numba.config.CACHE_DIR = theirs


_CACHE_FOLDER = cache_folder()
