"""Numba's compiler if it is installed; else the functions are interpreted, slowly."""

from __future__ import annotations

try:
    from numba import njit
except ImportError:

    def njit(function):
        """Leaves a function to the interpreter."""
        return function

    HAS_NUMBA = False
else:
    HAS_NUMBA = True
