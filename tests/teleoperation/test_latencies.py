"""Percentiles from a histogram, beside NumPy's of the numbers themselves."""

import math

import numpy as np
import pytest

from crar_drake.teleoperation.latencies import Latencies


def test_percentiles():
    numbers = np.random.default_rng(0).exponential(3e-3, 5000)
    latencies = Latencies()
    assert math.isnan(latencies.percentile(50))
    for number in numbers:
        latencies.add(number)
    for share in (1, 50, 99, 100):
        expected = np.percentile(numbers, share, method="inverted_cdf")
        assert latencies.percentile(share) == pytest.approx(expected, abs=1.1e-5)
    assert latencies.count == 5000 and latencies.longest == numbers.max()


def test_what_is_very_long_or_before_it_began():
    latencies = Latencies()
    latencies.add(70.0)
    latencies.add(-1e-6)
    assert latencies.longest == 70.0 and latencies.count == 2
    assert latencies.percentile(100) == pytest.approx(0.2, abs=2e-5)
