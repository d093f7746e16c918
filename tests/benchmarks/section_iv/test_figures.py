"""What the figures of Section IV are drawn from."""

import numpy as np
from small_logs import small_log

from benchmarks.section_iv.figures import (
    Bars,
    choose_snapshots,
    draw_bars,
    draw_violations,
    frame_samples,
    violation_counts,
)


def test_violations_are_joints_beyond_limits_plus_penetrating_pairs():
    # Swing is beyond 1 rad in the second sample; pairs in the second and third.
    np.testing.assert_array_equal(violation_counts(small_log()), [0, 2, 2])


def test_samples_of_frames():
    log = small_log(time=np.arange(0.0, 1.0001, 0.001))
    np.testing.assert_array_equal(
        frame_samples(log, 120.0)[:5], np.round(np.arange(5) / 0.12)
    )
    assert frame_samples(log, 120.0)[-1] == 1000
    assert len(frame_samples(log, 120.0)) == 121


def test_histogram_has_a_bar_for_every_frame_and_the_line_at_five():
    figure = draw_violations(small_log(), 2.0)
    left, right = figure.axes
    (bars,) = left.patches
    np.testing.assert_array_equal(bars.get_data().values, [0, 2, 2])
    (line,) = left.lines
    np.testing.assert_array_equal(line.get_ydata(), 5)
    widths = [patch.get_width() for patch in right.patches]
    np.testing.assert_allclose(widths[:4], [100 / 3, 0.0, 200 / 3, 0.0])


def test_snapshots_are_where_most_pairs_of_the_raw_motion_penetrate():
    distances = np.full((12, 2), 0.1)
    distances[1, 0] = distances[2] = -0.01  # most in the third of the first four
    distances[9, 1] = -0.01
    raw = small_log(time=np.arange(12.0), signed_distances=distances)
    first, middle, last = choose_snapshots(raw, 3)
    assert (first.sample, first.tinted) == (2, ("hand", "left", "right", "torso"))
    assert (middle.sample, middle.tinted) == (6, ())
    assert (last.sample, last.tinted) == (9, ("hand", "torso"))


def test_bars_have_the_heights_of_the_data():
    values = np.array([[32.0, 31.0, 37.0], [14.0, 15.0, np.nan]])
    series = ("velocity", "acceleration", "lookahead")
    figure = draw_bars(Bars("error", "mm", ("05_02", "13_17"), series, values))
    (ax,) = figure.axes
    for container, column in zip(ax.containers, values.T, strict=True):
        heights = [bar.get_height() for bar in container]
        np.testing.assert_array_equal(heights, column)
    assert [text.get_text() for text in ax.get_xticklabels()] == ["05_02", "13_17"]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["velocity level", "acceleration level", "lookahead"]
