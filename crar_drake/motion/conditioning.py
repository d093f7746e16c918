"""Low-pass filtering and interpolation of recorded samples."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from pydrake.math import BsplineBasis
from pydrake.trajectories import BsplineTrajectory
from scipy.interpolate import make_interp_spline
from scipy.linalg.lapack import dtbtrs

from crar_drake.errors import MotionError

# Voluntary motion of the body lies below about 6 Hz (D. A. Winter, Biomechanics and
# Motor Control of Human Movement, on cut-off frequencies for marker data). What is
# above is mostly marker noise, which grows with the square of its frequency in the
# accelerations that a controller asks for.
DEFAULT_CUTOFF = 6.0  # [Hz]

# Each pass rolls off with f^-4, both with f^-8: accelerations of what is above the
# cutoff vanish although differentiating twice multiplies them by f^2.
_ORDER = 4

# The ends are extended until the filter's start has died out: its slowest pole falls
# by e^(-2 pi sin(pi/8)), to a tenth, in one period of the cutoff.
_PAD_PERIODS = 5

MIN_FRAMES = 3  # what a C2 cubic spline with not-a-knot ends needs


def low_pass(
    samples: np.ndarray, frame_rate: float, cutoff: float = DEFAULT_CUTOFF
) -> np.ndarray:
    """Returns the samples after a zero-phase Butterworth low-pass.

    The filter runs forwards and backwards over the samples, so that nothing is
    delayed and the gain at the cutoff is 1/2. The ends are extended by the samples
    turned about the end point, again and again if the clip is short: so a straight
    line passes unaltered, and no clip is pulled towards zero.

    Args:
        samples: (T, ...) samples along the first axis, T >= 3.
        frame_rate: samples per second [Hz].
        cutoff: the filter's cutoff frequency [Hz].

    Raises:
        MotionError: too few samples, or a cutoff that the frame rate cannot have.
    """
    if len(samples) < MIN_FRAMES:
        raise MotionError(
            f"{len(samples)} frames are too few to filter; at least {MIN_FRAMES} "
            f"are needed"
        )
    if not 0.0 < cutoff < frame_rate / 2.0:
        raise MotionError(
            f"a low-pass cutoff of {cutoff:g} Hz does not fit a frame rate of "
            f"{frame_rate:g} Hz; it must lie between 0 and {frame_rate / 2.0:g} Hz"
        )
    if not np.size(samples):  # without columns LAPACK crashes
        return np.asarray(samples, dtype=float)
    pad = math.ceil(_PAD_PERIODS * frame_rate / cutoff)
    widths = [(pad, pad)] + [(0, 0)] * (np.ndim(samples) - 1)
    extended = np.pad(samples, widths, mode="reflect", reflect_type="odd")
    x = extended.reshape(len(extended), -1)
    sections = _sections(frame_rate, cutoff)
    x = _forwards(sections, _forwards(sections, x)[::-1])[::-1]
    return x.reshape(extended.shape)[pad:-pad]


@lru_cache(maxsize=16)
def _sections(
    frame_rate: float, cutoff: float
) -> tuple[tuple[float, float, float], ...]:
    """The Butterworth filter by the bilinear transform: (b, a_1, a_2) of each section
    b (1 + z^-1)^2 / (1 + a_1 z^-1 + a_2 z^-2), the gain of which is 1 at 0 Hz.

    (`scipy.signal.butter` finds the same; to import it takes longer than to retarget a
    short clip.)
    """
    w = math.tan(math.pi * cutoff / frame_rate)
    sections = []
    for k in range(_ORDER // 2):
        damping = 2.0 * math.sin(math.pi * (2 * k + 1) / (2 * _ORDER)) * w
        scale = 1.0 + damping + w * w
        a_1, a_2 = 2.0 * (w * w - 1.0), 1.0 - damping + w * w
        sections.append((w * w / scale, a_1 / scale, a_2 / scale))
    return tuple(sections)


def _forwards(
    sections: Sequence[tuple[float, float, float]], samples: np.ndarray
) -> np.ndarray:
    """(T, k) samples after the sections, as if the first one had been there for ever.

    What a section makes of x solves y_n + a_1 y_n-1 + a_2 y_n-2 = b (x_n + 2 x_n-1 +
    x_n-2): a matrix with three diagonals, lower triangular.
    """
    x = samples - samples[0]
    for b, a_1, a_2 in sections:
        x = np.concatenate([np.zeros((2, x.shape[1])), x])
        x = b * (x[2:] + 2.0 * x[1:-1] + x[:-2])
        diagonals = np.repeat([[1.0], [a_1], [a_2]], len(x), axis=1)
        x, _ = dtbtrs(diagonals, x, uplo="L", diag="U")
    return x + samples[0]


def spline(time: np.ndarray, samples: np.ndarray) -> BsplineTrajectory:
    """Returns the cubic spline through the samples, twice continuously differentiable.

    Its ends are not-a-knot: nothing is assumed about the velocity there. (As B-spline,
    a minute of motion takes a megabyte; as PiecewisePolynomial it takes two hundred.)

    Args:
        time: (T,) increasing sample times [s], T >= 3.
        samples: (T, k) samples.

    Returns:
        A trajectory of k rows and one column over [time[0], time[-1]].

    Raises:
        MotionError: fewer than three samples.
    """
    if len(time) < MIN_FRAMES:
        raise MotionError(
            f"{len(time)} frames are too few for a spline; at least {MIN_FRAMES} "
            f"are needed"
        )
    # Not-a-knot through three samples is the parabola through them.
    degree = min(3, len(time) - 1)
    fitted = make_interp_spline(time, samples, k=degree)
    return BsplineTrajectory(
        BsplineBasis(degree + 1, list(fitted.t)), [row[:, None] for row in fitted.c]
    )


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(T,) between (T, 3) vectors, precise for small ones, too; NaN where one is 0."""
    lengths = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    sine, cosine = np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1)
    return np.where(lengths > 0.0, np.arctan2(sine, cosine), np.nan)


def unit_vectors(v: np.ndarray) -> np.ndarray:
    """(..., 3) directions of v (..., 3); 0 where it is 0."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def across(v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(..., 3) what is left of v (..., 3) across unit vectors u (..., 3)."""
    return v - np.sum(v * u, axis=-1, keepdims=True) * u
