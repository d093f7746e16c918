"""The low-pass has no phase; the spline is twice continuously differentiable."""

import math

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from crar_drake.errors import MotionError
from crar_drake.motion.conditioning import low_pass, spline

RATE = 120.0
TIME = np.arange(1200) / RATE
MIDDLE = slice(240, -240)  # away from the ends


def _gain(frequency: float, order: int = 4) -> float:
    """Amplitude gain of two passes of the bilinear Butterworth low-pass."""
    warped = np.tan(np.pi * frequency / RATE) / np.tan(np.pi * 6.0 / RATE)
    return 1.0 / (1.0 + warped ** (2 * order))


@pytest.mark.parametrize("frequency", [0.5, 2.0, 4.0, 6.0, 8.0, 12.0])
def test_sine_keeps_its_phase_and_has_the_filter_s_gain(frequency: float) -> None:
    phase = 2.0 * np.pi * frequency * TIME + 0.4
    samples = np.stack([np.sin(phase), 3.0 * np.cos(phase)], axis=1)
    smooth = low_pass(samples, RATE)
    expected = _gain(frequency) * samples
    np.testing.assert_allclose(smooth[MIDDLE], expected[MIDDLE], atol=2e-6)


def test_gain_at_the_cutoff_is_one_half() -> None:
    smooth = low_pass(np.sin(2.0 * np.pi * 10.0 * TIME), RATE, cutoff=10.0)
    assert np.abs(smooth[MIDDLE]).max() == pytest.approx(0.5, abs=1e-3)


def test_straight_lines_pass_untouched_ends_included() -> None:
    line = np.outer(TIME, [1.0, -2.0, 0.0]) + [5.0, 0.0, 7.0]
    np.testing.assert_allclose(low_pass(line, RATE), line, atol=1e-5)


@pytest.mark.parametrize(
    "rate, cutoff",
    [(30.0, 6.0), (120.0, 40.0), (1000.0, 6.0), (120.0, 59.9), (120.0, 1.0)],
)
@pytest.mark.parametrize("shape", [(3,), (200, 4, 3)])
def test_the_filter_is_scipy_s(rate, cutoff, shape) -> None:
    samples = 1.0 + np.cumsum(np.random.default_rng(2).normal(size=shape), axis=0)
    pad = math.ceil(5.0 * rate / cutoff)
    widths = [(pad, pad)] + [(0, 0)] * (len(shape) - 1)
    extended = np.pad(samples, widths, mode="reflect", reflect_type="odd")
    sections = butter(4, cutoff, fs=rate, output="sos")
    expected = sosfiltfilt(sections, extended, axis=0, padtype=None)[pad:-pad]
    np.testing.assert_allclose(low_pass(samples, rate, cutoff), expected, atol=1e-9)


def test_samples_of_nothing() -> None:
    assert low_pass(np.zeros((5, 0)), RATE).shape == (5, 0)


@pytest.mark.parametrize("frames", [3, 4, 10, 30])
def test_short_clips_are_filtered_too(frames: int) -> None:
    line = np.linspace(1.0, 2.0, frames)
    np.testing.assert_allclose(low_pass(line, RATE), line, atol=1e-4)


def test_too_few_frames() -> None:
    with pytest.raises(MotionError, match="2 frames are too few.*at least 3"):
        low_pass(np.zeros((2, 3)), RATE)
    with pytest.raises(MotionError, match="2 frames are too few.*at least 3"):
        spline(np.arange(2.0), np.zeros((2, 3)))


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 60.0, 100.0, float("nan")])
def test_cutoff_that_the_rate_cannot_have(cutoff: float) -> None:
    with pytest.raises(MotionError, match="between 0 and 60 Hz"):
        low_pass(np.zeros(100), RATE, cutoff=cutoff)


def test_spline_passes_its_samples_with_its_derivatives() -> None:
    samples = np.stack([np.sin(3.0 * TIME), np.cos(2.0 * TIME)], axis=1)
    trajectory = spline(TIME, samples)
    assert (trajectory.rows(), trajectory.cols()) == (2, 1)
    assert (trajectory.start_time(), trajectory.end_time()) == (0.0, TIME[-1])
    np.testing.assert_allclose(
        trajectory.vector_values(TIME), samples.T, atol=1e-12, rtol=0
    )
    for t in (0.0, 1.2345, 5.0, TIME[-1]):
        np.testing.assert_allclose(
            trajectory.EvalDerivative(t, 1)[:, 0],
            [3.0 * np.cos(3.0 * t), -2.0 * np.sin(2.0 * t)],
            atol=1e-4,
        )
        np.testing.assert_allclose(
            trajectory.EvalDerivative(t, 2)[:, 0],
            [-9.0 * np.sin(3.0 * t), -4.0 * np.cos(2.0 * t)],
            atol=1e-2,
        )


def test_spline_is_smooth_across_its_breaks() -> None:
    """Noise, so that a lower continuity would show."""
    samples = np.random.default_rng(0).normal(size=(40, 1))
    time = np.arange(40) / RATE
    trajectory = spline(time, samples)
    step = 1e-9
    for order in (0, 1, 2):
        scale = RATE**order
        for t in time[1:-1]:
            before = trajectory.EvalDerivative(t - step, order)[0, 0]
            after = trajectory.EvalDerivative(t + step, order)[0, 0]
            assert abs(after - before) < 1e-4 * scale
