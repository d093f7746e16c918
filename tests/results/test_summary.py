"""The figures of a run, against numbers worked out by hand from `small_log`."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from small_logs import small_log

import crar_drake
from crar_drake.errors import ScenarioError
from crar_drake.results.summary import TaskErrors, summarize
from crar_drake.results.summary_table import summary_table


def test_violations():
    summary = summarize(small_log())
    assert summary.samples == 3
    assert summary.penetrating_samples == 2
    assert summary.penetrating_pairs == {"left - right": 1, "hand - torso": 2}
    assert summary.beyond_limit_samples == 1
    assert summary.joints_beyond_limits == {"swing": 1}
    assert summary.largest_excess == 0.25
    assert summary.largest_excess_joint == "swing"
    # Nothing; one pair and one limit; two pairs.
    assert summary.violated_samples == 2
    assert summary.mean_violations == pytest.approx(4.0 / 3.0)


@pytest.mark.parametrize("beyond, samples", [(0.9e-6, 0), (1.1e-6, 1)])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_limit_may_be_exceeded_by_rounding_only(side, beyond, samples):
    q, v = np.zeros((3, 3)), np.zeros((3, 3))
    q[1, 1], v[1, 1] = side * (1.0 + beyond), side * (2.0 + beyond)
    found = summarize(small_log(q=q, v=v))
    assert found.beyond_limit_samples == found.beyond_speed_samples == samples
    assert found.largest_excess == pytest.approx(beyond, abs=1e-15)
    assert found.largest_speed_excess == pytest.approx(beyond, abs=1e-15)


def test_speeds_are_judged_apart_from_the_violations():
    """Swing moves at 1, -2, 0 rad/s, turn at 2, 0, 4; the rail is not controlled."""
    before = summarize(small_log())
    assert before.beyond_speed_samples == 0  # a limit of 2 is reached, not passed
    assert (before.joints_beyond_speed, before.largest_speed_excess_joint) == ({}, "")
    found = summarize(small_log(velocity_limits=np.array([1.0, 1.5, 1.0])))
    assert found.beyond_speed_samples == 3
    assert found.joints_beyond_speed == {"swing": 1, "turn": 2}
    assert (found.largest_speed_excess, found.largest_speed_excess_joint) == (3, "turn")
    assert found.violated_samples == before.violated_samples


def test_power_and_torque_of_the_controlled_joints():
    summary = summarize(small_log())
    # |10 * 1| + |3 * 2|; |-30 * -2| + 0; 0 + |-8 * 4|: the rail's 4500 W do not count.
    assert summary.mean_power == pytest.approx((16.0 + 60.0 + 32.0) / 3.0)
    assert (summary.peak_torque, summary.peak_torque_joint) == (30.0, "swing")
    # Two actuators on a joint add up.
    summary = summarize(small_log(actuator_names=np.array(["swing", "rail", "swing"])))
    assert summary.peak_torque == 25.0  # 5 - 30


def test_samples_without_targets_count_in_no_error():
    error = small_log().task_error.copy()
    error[1:] = np.nan
    summary = summarize(
        small_log(task_error=error, status=np.array([[0.0], [2.0], [2.0]]))
    )
    assert summary.braking_samples == 2
    assert summary.rms_task_error == pytest.approx(1e-3 * np.sqrt(25.0 / 2.0))
    assert summary.rms_orientation_error == pytest.approx(0.1)


def admitted_log(*rows, **changes):
    """One sample a row of how, clearance and clear; control steps of 0.5 s."""
    log = small_log()
    how, clearance, clear = np.array(rows).T
    told = np.stack([how, np.where(how == 2.0, 0.25, 1.0), clearance, clear], axis=1)
    T = len(rows)
    longer = {
        name: np.repeat(value[:1], T, axis=0)
        for name, value in vars(log).items()
        if isinstance(value, np.ndarray) and value.shape[0] == 3 and value.ndim == 2
    }
    time = 0.5 * np.arange(T)
    return replace(log, **longer | {"time": time, "admission": told} | changes)


def test_how_steps_were_admitted():
    nothing, nan = [0.0, 0.02, 1.0], np.nan
    log = admitted_log(
        nothing,
        [1.0, 0.01, 1.0],
        [2.0, 0.006, 1.0],
        [1.0, 0.004, 0.0],
        nothing,
        [nan, nan, nan],  # braking without targets
        [2.0, 0.007, 1.0],
    )
    found = summarize(log)
    assert found.admitted_steps == 6
    assert (found.corrected_steps, found.scaled_steps) == (2, 2)
    assert (found.unclear_steps, found.path_clearance) == (1, 0.004)
    assert found.longest_held_back == 1.5
    # What follows after the log's end is not known: the last step counts whole.
    assert summarize(admitted_log([1.0, 0.1, 1.0])).longest_held_back == 0.5


def test_steps_count_once_in_a_finer_log():
    rows = [[1.0, 0.01, 1.0], [1.0, 0.01, 1.0], [0.0, 0.02, 1.0], [0.0, 0.02, 1.0]]
    found = summarize(admitted_log(*rows, time=0.25 * np.arange(4)))
    assert (found.admitted_steps, found.corrected_steps) == (2, 1)
    assert found.longest_held_back == 0.5
    assert found.samples == 4


def test_steps_that_balance_changed_are_not_blamed_on_motors():
    nan, T = np.nan, 5
    rows = [[0.0, 0.02, 1.0]] * T
    told = np.array(
        [[0, 1, 0.03], [1, 1, 0.001], [2, 0.5, 0.002], [nan, nan, nan], [0, 1, 0.02]]
    )
    limited = np.column_stack([[1.0, 0.4, 0.4, 1.0, 1.0], np.zeros(T)])
    log = admitted_log(*rows, balance=told, torque_limit=limited)
    found = summarize(log)
    assert (found.balanced_steps, found.changed_for_balance) == (4, 2)
    assert found.smallest_balance == 0.001
    assert found.torque_limited_samples == 2
    assert any("balance holds the robot back in 40 %" in x for x in found.remarks)
    assert not any("torque limits" in x for x in found.remarks)
    told[:, 0] = 0.0
    found = summarize(replace(log, balance=told))
    assert any("torque limits hold the robot back" in x for x in found.remarks)
    assert not any("balance" in x for x in found.remarks)


def test_nothing_is_told_without_the_lookahead():
    found = summarize(small_log())
    assert (found.admitted_steps, found.unclear_steps) == (0, 0)
    assert (found.path_clearance, found.longest_held_back) == (None, 0.0)
    # No pair is watched: nothing can be near.
    found = summarize(admitted_log([0.0, np.inf, 1.0]))
    assert (found.admitted_steps, found.path_clearance) == (1, None)


def table(log, row: str = "", **known) -> list[str]:
    """The lines of the table that have a word, their spaces joined."""
    console = Console(width=160, record=True, file=open("/dev/null", "w"))
    console.print(summary_table(summarize(log, **known), verbose=True))
    lines = (" ".join(line.split()) for line in console.export_text().splitlines())
    return [line for line in lines if row in line]


def test_table_tells_of_braking_paths():
    def line(*rows) -> str:
        (only,) = table(admitted_log(*rows), "braking path")
        return only

    assert table(small_log(), "braking path") == []
    nominal = [0.0, 0.005, 1.0]
    told = line(nominal)
    assert "5.0 mm │ at least, clear at every step; all steps nominal │" in told
    told = line(*[nominal] * 3, [1.0, 0.004, 1.0])
    assert "4.0 mm │ at least, clear at every step; 25.0 % of the steps" in told
    assert (
        "25.0 % of the steps corrected, none scaled, for up to 0.5 s in a row" in told
    )
    told = line(*[nominal] * 4999, [2.0, 0.004, 0.0])
    assert "4.0 mm │ not clear at 1 step; none corrected, < 0.1 % scaled" in told
    assert "│ no pair │" in line([0.0, np.inf, 1.0])


def test_identification_and_wall_time():
    summary = summarize(small_log(), wall_time=4.0)
    assert summary.version == crar_drake.__version__
    assert (summary.robot, summary.motion) == ("upper_body", "some/waltz.amc")
    assert (summary.experiment, summary.level) == ("wrists", "velocity")
    assert (summary.constraints, summary.period) == ("none", 0.5)
    assert summary.duration == 1.0
    assert (summary.wall_time, summary.real_time_factor) == (4.0, 0.25)
    assert summarize(small_log()).real_time_factor is None


def test_without_pairs_and_without_positions():
    summary = summarize(
        small_log(
            signed_distances=np.zeros((3, 0)),
            pair_names=np.array([], dtype=str),
            task_names=np.array(["tool"]),
            task_kinds=np.array(["orientation"]),
            task_error=np.full((3, 3), 0.1),
        )
    )
    assert summary.smallest_distance is None
    assert summary.smallest_distance_time is None
    assert summary.smallest_distance_pair == ""
    assert summary.penetrating_samples == 0
    assert summary.rms_task_error is None
    assert summary.tasks == {
        "tool": TaskErrors("orientation", None, pytest.approx(np.sqrt(0.03)))
    }


def test_what_is_not_a_number_is_null_in_json():
    actuation = small_log().actuation.copy()
    actuation[2, 2] = np.inf
    text = summarize(small_log(v=np.ones((3, 3)), actuation=actuation)).to_json()
    assert json.loads(text)["peak_torque"] is None
    assert json.loads(text)["mean_power"] is None


def test_a_log_of_another_version_is_refused():
    with pytest.raises(ScenarioError, match="the log's scenario.*experimnt"):
        summarize(small_log(scenario="motion: dance\nexperimnt: wrists\n"))


def test_table_shows_the_figures():
    log = small_log(velocity_limits=np.array([1.0, 1.5, 1.0]))
    assert "upper_body following waltz: wrists" in table(log)[0]
    for name, *parts in (
        ["rms task error", "5.7 mm", "worst tool, 7.5 mm"],
        ["rms orientation error", "0.173 rad", "worst tool"],
        ["smallest distance", "-30.0 mm", "left - right, at 1.00 s"],
        ["violations", "2", "of 3 samples"],
        ["penetrating", "2", "hand - torso and 1 more"],
        ["beyond limits", "1", "swing; farthest swing, 0.25 rad"],
        ["beyond speed limits", "3", "turn and 1 more; most turn, by 3 rad/s"],
        ["mean power", "36.0 W"],
        ["peak torque", "30.0 Nm", "swing, at 0.50 s"],
        ["rms acceleration", "2.0 rad/s²"],
        ["wall time", "4.0 s", "0.25 x real time"],
    ):
        (line,) = table(log, name, wall_time=4.0)
        assert all(part in line for part in parts), line
    assert table(small_log(), "beyond speed limits") == []


def test_torque_limited_samples():
    summary = summarize(small_log())
    assert (summary.torque_limited_samples, summary.torque_clipped_samples) == (2, 1)
    free = summarize(small_log(torque_limit=np.array([[1.0, 0.0]] * 3)))
    assert (free.torque_limited_samples, free.torque_clipped_samples) == (0, 0)


@pytest.mark.parametrize(
    ("names", "heights", "smallest", "pair"),
    [
        # Feet stand near the ground: that says nothing, unless one is below.
        (["foot - ground", "hand - torso"], [0.005, 0.006], 0.1, "hand - torso"),
        (["ground - foot", "hand - torso"], [0.005, -0.006], -0.006, "ground - foot"),
        (["foot - ground", "hand - ground"], [0.005, 0.006], 0.005, "foot - ground"),
    ],
)
def test_the_ground_counts_where_something_is_below(names, heights, smallest, pair):
    distances = np.array([[heights[0], 0.1], [heights[1], 0.2], [0.3, 0.3]])
    log = small_log(pair_names=np.array(names), signed_distances=distances)
    summary = summarize(log)
    assert summary.smallest_distance == smallest
    assert summary.smallest_distance_pair == pair
    assert summary.penetrating_samples == (smallest < 0.0)


def test_joints_that_slide_have_units_of_their_own():
    """`swing` is beyond its limit and too fast, and has the largest effort."""
    log = small_log(controlled_units=np.array(["m", "rad"]))
    assert summarize(log).sliding_joints == ["swing"]
    text = "\n".join(table(log))
    assert "swing, 0.25 m" in text and "30.0 N " in text
    assert "1 that slide, in m/s², among them" in text
