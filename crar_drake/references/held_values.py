"""What the readers of layouts ask of a file's values, by their keys."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from crar_drake.errors import MotionError


def numbers(
    where: object, held: Mapping[str, object], key: str, *shape: int | None
) -> np.ndarray:
    """The numbers of that shape, in which None is any length; integers become floats.

    Raises:
        MotionError: `where` has none there, or others.
    """
    if key not in held:
        raise MotionError(f"{where}: it has no {key}")
    try:
        array = np.asarray(held[key])
    except ValueError:  # lists of several lengths
        array = np.empty(0, dtype=object)
    if array.ndim == len(shape) + 1 and array.shape[-1] == 1:
        array = array[..., 0]  # some tools keep an axis for a joint's angles
    fits = len(shape) == array.ndim and all(
        a in (None, b) for a, b in zip(shape, array.shape, strict=True)
    )
    if not fits or array.dtype.kind not in "fiu":
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise MotionError(
            f"{where}: {key} is an array {array.shape} of {array.dtype}; numbers of "
            f"shape ({wanted}) are expected"
        )
    return array if array.dtype.kind == "f" else array.astype(float)


def check_frames(where: object, arrays: Mapping[str, np.ndarray]) -> None:
    """Raises MotionError unless all have as many frames, with numbers in them."""
    lengths = {len(array) for array in arrays.values()}
    if len(lengths) > 1 or not all(array.size for array in arrays.values()):
        shapes = ", ".join(f"{key} {array.shape}" for key, array in arrays.items())
        raise MotionError(
            f"{where}: numbers of frames differ, or there are none: {shapes}"
        )


def check_quaternions(where: object, what: str, quaternions: np.ndarray) -> None:
    """Raises MotionError, with the frame, if one of (T, 4) has no length."""
    zero = np.flatnonzero(np.linalg.norm(quaternions, axis=1) < 1e-6)
    if len(zero):
        raise MotionError(f"{where}, frame {zero[0] + 1}: {what} has length zero")


def stated_rate(
    where: object,
    held: Mapping[str, object],
    key: str = "fps",
    usual: float | None = None,
    guesses: list[str] | None = None,
) -> float:
    """The rate that a file states [Hz]; if it states none the usual one of such files,
    where there is one, with a line for the guesses.

    Raises:
        MotionError: it is not one number.
    """
    rate = held.get(key)
    if usual is not None and rate is None:
        guesses.append(f"{usual:g} Hz, the usual rate of such files: it has no {key}")
        return usual
    values = np.asarray(rate)
    if values.size != 1 or values.dtype.kind not in "fiu":
        raise MotionError(f"{where}: {key} is {rate}, not one number")
    return float(values.reshape(()))
