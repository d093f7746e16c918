"""Who never comes near a target is told of."""

import numpy as np
import pytest
from small_logs import small_log

from crar_drake.results.lasting_errors import lasting_error_warnings


def log(hand: float, turned: float, shift: np.ndarray | None = None):
    """Three samples, 1 s; the hand's distance [m] and the tool's angle [rad]."""
    error = np.zeros((3, 9))
    error[:, 1], error[:, 4] = hand, turned
    if shift is not None:
        error[:, 1] += shift
    return small_log(task_error=error)


def test_a_hand_that_stays_away_and_a_tool_that_stays_turned():
    lines = lasting_error_warnings(log(0.12, 0.6), 0.0)
    assert [line.partition(" is never ")[0] for line in lines] == ["hand", "tool"]
    assert "than 120 mm:" in lines[0] and "than 34 deg:" in lines[1]


@pytest.mark.parametrize("shift", [[0.0, -0.05, 0.0], [np.nan, 0.0, -0.05]])
def test_once_near_is_near(shift):
    """Samples without targets say nothing, and what is short says nothing."""
    assert lasting_error_warnings(log(0.12, 0.4, np.array(shift)), 0.0) == []
    assert lasting_error_warnings(log(0.12, 0.6), 0.5) == []


def test_what_is_blended_in_does_not_count():
    """Near at the start only, where targets are blended in from where it stands."""
    far = small_log(
        time=np.arange(3) * 1.0,
        task_error=log(0.2, 0.0, np.array([-0.2, 0, 0])).task_error,
    )
    assert lasting_error_warnings(far, 0.0) == []
    assert "never nearer" in lasting_error_warnings(far, 0.5)[0]
