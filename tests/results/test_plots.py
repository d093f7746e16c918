"""The plot of a run: a readable page, with the log's data in it."""

import matplotlib.colors
import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from small_logs import small_log

from crar_drake.errors import WriteError
from crar_drake.results import marks
from crar_drake.results.plots import draw_run, plot_run


def _axes(figure: Figure, label: str):
    return next(ax for ax in figure.axes if ax.get_ylabel() == label)


def _line(ax, label: str) -> np.ndarray:
    return next(
        line.get_ydata() for line in ax.get_lines() if line.get_label() == label
    )


def test_errors_reach_the_axes():
    figure = draw_run(small_log())
    ax = _axes(figure, "task error [mm]")
    np.testing.assert_allclose(_line(ax, "hand"), [5.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(_line(ax, "tool"), [0.0, 12.0, 5.0])
    np.testing.assert_array_equal(ax.get_lines()[0].get_xdata(), [0.0, 0.5, 1.0])
    assert "5.7 mm" in ax.get_title(loc="left")
    ax = _axes(figure, "orientation error [deg]")
    np.testing.assert_allclose(_line(ax, "tool"), np.degrees([0.1, 0.2, 0.2]))


def test_distances_reach_the_axes():
    ax = _axes(draw_run(small_log()), "distance [mm]")
    np.testing.assert_allclose(_line(ax, "smallest"), [100.0, -10.0, -30.0])
    np.testing.assert_allclose(_line(ax, "left - right"), [200.0, 50.0, -30.0])
    np.testing.assert_allclose(_line(ax, "hand - torso"), [100.0, -10.0, -20.0])
    low, high = ax.get_ylim()
    assert low < -30.0 and high >= 200.0
    title = ax.get_title(loc="left")
    assert "-30.0 mm, left - right, at 1.00 s" in title


def test_joints_are_drawn_between_their_limits():
    q = np.array([[9.0, -1.0, 3.0], [9.0, 0.0, 4.0], [9.0, 1.5, 5.0]])
    figure = draw_run(small_log(q=q))
    ax = next(ax for ax in figure.axes if "Joint" in ax.get_title(loc="left"))
    assert [tick.get_text() for tick in ax.get_yticklabels()] == ["swing", "turn"]
    swing, outside, turn = (line.get_ydata() for line in ax.get_lines())
    top, bottom = swing[1] - 0.38, swing[1] + 0.38  # the axis counts downwards
    assert swing[0] == pytest.approx(bottom) and swing[2] < top
    np.testing.assert_array_equal(np.isnan(outside), [True, True, False])
    assert outside[2] == swing[2]
    # Without limits, the lane spans what was visited.
    np.testing.assert_allclose(turn, [1.38, 1.0, 0.62])
    assert len(ax.patches) == 1
    assert "swing, 29°" in ax.get_title(loc="left")
    assert [text.get_text() for text in ax.texts] == [
        "-57° … 57°",
        "172° … 286° visited,\nno limits",
    ]


def test_who_is_too_fast_is_marked():
    """Swing moves at 1, -2, 0 rad/s; turn has no limit here."""
    figure = draw_run(small_log(velocity_limits=np.array([0.0, 1.5, np.inf])))
    ax = next(ax for ax in figure.axes if "Joint" in ax.get_title(loc="left"))
    (marks,) = [line for line in ax.get_lines() if line.get_marker() == "."]
    np.testing.assert_array_equal(np.isfinite(marks.get_ydata()), [False, True, False])
    assert marks.get_ydata()[1] == ax.get_lines()[0].get_ydata()[1]
    assert "magenta: too fast, 1 samples" in ax.get_title(loc="left")
    figure = draw_run(small_log())
    ax = next(ax for ax in figure.axes if "Joint" in ax.get_title(loc="left"))
    assert "too fast" not in ax.get_title(loc="left")


def test_torque_is_drawn_as_a_share_of_its_limit():
    """Turn has 3, 5, -8 of 10 Nm, swing 10, -30, 1 of 40 Nm."""
    log = small_log(effort_limits=np.array([10.0, np.inf, 40.0]))
    figure = draw_run(log)
    ax = next(ax for ax in figure.axes if "Torque" in ax.get_title(loc="left"))
    (mesh,) = ax.collections
    shares = np.asarray(mesh.get_array()).reshape(2, 3)
    np.testing.assert_allclose(shares, [[0.25, 0.75, 0.025], [0.3, 0.5, 0.8]])
    assert "at most 80 %, turn" in ax.get_title(loc="left")
    assert [text.get_text() for text in ax.texts] == ["75 % of 40", "80 % of 10"]
    # Beyond it is the colour of violations; where none is known there is no share.
    figure = draw_run(small_log(effort_limits=np.array([np.inf, np.inf, 20.0])))
    ax = next(ax for ax in figure.axes if "Torque" in ax.get_title(loc="left"))
    (mesh,) = ax.collections
    beyond = mesh.to_rgba(np.asarray(mesh.get_array()).reshape(2, 3))[0, 1]
    assert matplotlib.colors.to_hex(beyond) == marks.VIOLATION
    assert [text.get_text() for text in ax.texts] == ["150 % of 20", "8, no limit"]


def test_spans_are_marked():
    """Blending in the first sample, braking in the last two, all limited in torque."""
    log = small_log(
        status=np.array([[1.0], [2.0], [2.0]]),
        torque_limit=np.array([[1.0, 0.0], [0.4, 0.0], [0.0, 0.25]]),
    )
    assert marks.marked_spans(log) == {
        "blending": [(0.0, 0.5)],
        "braking": [(0.5, 1.0)],
        "torque limited": [(0.5, 1.0)],
    }
    ax = draw_run(log).axes[0]
    names = [tick.get_text() for tick in ax.get_yticklabels()]
    assert names == ["blending", "braking", "torque limited"]
    colours = [
        matplotlib.colors.to_hex(bar.get_facecolor()[0]) for bar in ax.collections
    ]
    assert colours == list(marks.SPANS.values())
    unmarked = small_log(torque_limit=np.tile([1.0, 0.0], (3, 1)))
    assert draw_run(unmarked).axes[0].get_ylabel() == "task error [mm]"


def test_power_reaches_the_axes():
    ax = _axes(draw_run(small_log()), "power [W]")
    power, mean = (np.asarray(line.get_ydata()) for line in ax.get_lines())
    np.testing.assert_allclose(power, [16.0, 60.0, 32.0])
    np.testing.assert_allclose(mean, 36.0)
    assert "mean 36.0 W" in ax.get_title(loc="left")


def test_what_is_not_there_takes_no_room(tmp_path):
    log = small_log(
        signed_distances=np.zeros((3, 0)),
        pair_names=np.array([], dtype=str),
        task_names=np.array(["hand"]),
        task_kinds=np.array(["position"]),
        task_error=np.zeros((3, 3)),
        q=np.zeros((3, 3)),
        v=np.zeros((3, 3)),
    )
    labels = [ax.get_ylabel() for ax in draw_run(log).axes]
    # When torque was limited, errors, joints, torque, power.
    assert labels == ["", "task error [mm]", "", "", "power [W]"]
    plot_run(log, tmp_path / "standing still.png")


def test_samples_without_targets_leave_a_gap(tmp_path):
    error = small_log().task_error.copy()
    error[1] = np.nan
    log = small_log(task_error=error)
    ax = _axes(draw_run(log), "task error [mm]")
    np.testing.assert_allclose(_line(ax, "hand"), [5.0, np.nan, 0.0], atol=1e-12)
    plot_run(small_log(task_error=np.full_like(error, np.nan)), tmp_path / "plot.png")


def test_a_failure_leaves_the_old_plot(tmp_path, monkeypatch):
    path = tmp_path / "plot.png"
    path.write_bytes(b"old")

    def fail(self, *args, **options):
        raise OSError("disk full")

    monkeypatch.setattr(Figure, "savefig", fail)
    with pytest.raises(WriteError, match="plot.png: could not be written: disk full"):
        plot_run(small_log(), path)
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1
