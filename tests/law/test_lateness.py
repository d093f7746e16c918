"""A state that is late without the law's being told: it is seen, and predicted."""

import numpy as np
import pytest

from crar_drake import ControlModel, load_robot_description, position_tasks
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.measured import LATEST, watch_lateness
from crar_drake.law.parameters import LookaheadParameters

PERIOD = 5e-3
PARAMETERS = LookaheadParameters(period=PERIOD, blend_time=0.0)
JOINTS = 6


def watched(lag: float, told: float = 0.0, steps: int = 200, **faults) -> list[int]:
    """The lags [periods] that are seen of joints that do as commanded, late by `lag`.

    A period has ten parts here, so that a lag may end within one.
    """
    rng = np.random.default_rng(4)
    noise, push, gain = (faults.get(name, 0.0) for name in ("noise", "push", "gain"))
    commanded = 20.0 * rng.standard_normal((steps, JOINTS))
    commanded = np.cumsum(commanded, axis=0) * 0.3  # that go on for some periods
    commanded -= np.linspace(0.0, 1.0, steps)[:, np.newaxis] * commanded[-1]
    parts = np.repeat(commanded * (1.0 + gain) + push, 10, axis=0)
    v = np.vstack([np.zeros(JOINTS), np.cumsum(parts * PERIOD / 10, axis=0)])
    seen, found = None, []
    for k in range(steps):
        measured = v[max(10 * k - round(10 * lag), 0)]
        measured = measured + noise * rng.standard_normal(JOINTS)
        sent = tuple(commanded[:k][::-1][:8])
        seen = watch_lateness(seen, measured, sent, told, PERIOD)
        found.append(seen.periods)
    return found


@pytest.mark.parametrize("lag", range(round(LATEST / PERIOD) + 1))
def test_the_lag_is_found(lag):
    assert watched(lag)[40:] == [lag] * 160


def test_what_is_known_of_the_lag_does_not_count():
    assert watched(2.4, told=0.4)[40:] == [2] * 160
    assert watched(1.4, told=1.4) == [0] * 200


@pytest.mark.parametrize(
    "fault", [{"noise": 0.05}, {"push": 30.0}, {"gain": 0.2}, {"gain": -0.2}]
)
def test_other_faults_are_no_lag(fault):
    assert watched(0, **fault) == [0] * 200


def test_nothing_is_believed_at_once():
    assert watched(3)[:8] == [0] * 8


@pytest.fixture(scope="module")
def model() -> ControlModel:
    tasks = position_tasks(["left_wrist", "right_wrist"])
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), tasks, time_step=PERIOD
    )


def swung(model: ControlModel, late: int):
    """Errors (K,) [m] of wrists that swing, and accelerations (K, nv), of a robot that
    does as commanded, with a state that is late by so many periods."""
    law = ControlLaw(model, PARAMETERS)
    q, nq = model.rest_positions(), model.plant.num_positions()
    home, still = model.tasks_at(q), model.prescribed_at(q)
    points = model.layout.unpack(home).p
    past = [np.concatenate((q, np.zeros(model.plant.num_velocities())))]
    errors, accelerations = [], []
    for k in range(200):
        w, t = 6.0, k * PERIOD
        swing = 0.08 * np.array(
            [np.sin(w * t), w * np.cos(w * t), -w * w * np.sin(w * t)]
        )
        p, v, a = (
            each + swing[i] * np.ones((2, 3)) * [1.0, 0.0, 1.0]
            for i, each in enumerate((points + [0.1, 0.0, 0.1], 0.0, 0.0))
        )
        target = model.layout.pack(np.empty((0, 3, 3)), p, v.ravel(), a.ravel())
        seen = past[max(len(past) - 1 - late, 0)]
        solution = law.step(seen[:nq], seen[nq:], target, still)
        now, vdot = past[-1], solution.acceleration
        v = now[nq:] + PERIOD * vdot
        past.append(np.concatenate((now[:nq] + PERIOD * v, v)))
        there = model.layout.unpack(model.tasks_at(past[-1][:nq])).p
        errors.append(np.linalg.norm(there - p, axis=1).max())
        accelerations.append(vdot)
    return np.array(errors), np.array(accelerations)


@pytest.mark.parametrize("late", [2, 3])
def test_a_preview_bears_a_late_state(model, late, monkeypatch):
    """As closely and calmly as without the lag, once it is seen; else it shakes."""
    right, calm = swung(model, 0)
    found, accelerations = swung(model, late)
    settled = slice(100, None)
    assert found[settled].max() < right[settled].max() + 2e-3
    assert np.abs(accelerations[settled]).max() < 1.1 * np.abs(calm[settled]).max()
    monkeypatch.setattr("crar_drake.law.measured._FIRST", 10**9)
    _, shaking = swung(model, late)
    assert np.abs(shaking[settled]).max() > 3.0 * np.abs(calm[settled]).max()


@pytest.mark.parametrize("power", [1, 2, 3])
def test_a_robot_that_is_stuck_is_not_late(power):
    """Older commands are smaller, and so less wrong; but they explain nothing."""
    seen, still = None, np.zeros(JOINTS)
    for k in range(60):
        sent = tuple(
            np.full(JOINTS, min(0.5 * j**power, 200.0))
            for j in range(k - 1, max(k - 9, -1), -1)
        )
        seen = watch_lateness(seen, still, sent, 0.0, PERIOD)
        assert seen.periods == 0
    assert seen.missed[0] > 0.01  # it was noticed that nothing comes of them


@pytest.mark.parametrize("glitch", [1e3, 1e160])
def test_after_a_glitch_of_the_sensor_a_lag_is_still_seen(model, glitch):
    """Else what was missing in that step would outweigh all else, 1e160 for ever."""
    law = ControlLaw(model, PARAMETERS)
    q, still = model.rest_positions(), model.prescribed_at(model.rest_positions())
    target = model.tasks_at(q)
    for k in range(12):
        v = np.zeros(model.plant.num_velocities())
        v[model.controlled[0]] = glitch if k == 10 else 0.0
        law.step(q, v, target, still)
    assert law._memory.lateness.missed.max() < 1e-4
