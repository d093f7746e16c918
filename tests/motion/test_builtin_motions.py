"""The motions that this project ships."""

import numpy as np
import pytest

from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import PaperParameters
from crar_drake.motion.catalogue import builtin_names, load_clip, load_performer
from crar_drake.motion.formats.asf_amc import bone_end, clip_tree
from crar_drake.motion.report import describe, inspect
from crar_drake.resources import builtin_motions_folder
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, position_tasks
from crar_drake.targets.motion import load_motion_targets

NAMES = ("boxing", "dance", "exercise", "reaching")
STEP = 4e-3  # of the kinematic run [s]


@pytest.fixture(scope="module")
def clips():
    return {name: load_clip(name) for name in NAMES}


def test_all_are_shipped():
    assert tuple(builtin_names()) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_size_and_duration(name, clips):
    assert (builtin_motions_folder() / f"{name}.amc").stat().st_size < 400_000
    assert 8.0 <= clips[name].duration <= 15.0
    assert clips[name].frame_rate == 60.0


@pytest.mark.parametrize("name", NAMES)
def test_looks_clean_and_no_faster_than_people(name):
    report = inspect(load_performer(name))
    assert not report.findings, list(describe(report))
    wrists = [report.peak_speeds[f"{side}_wrist"] for side in ("left", "right")]
    assert 2.0 < max(wrists) < 6.5  # [m/s]; a boxer's fist reaches 8 to 10
    # No joint centre is shaken: 25 g is what a fast punch's fist sees.
    for point, p_WC in load_performer(name).centres().items():
        acceleration = np.diff(p_WC, n=2, axis=0) * 60.0**2
        assert np.linalg.norm(acceleration, axis=1).max() < 250.0, point


@pytest.mark.parametrize("name", NAMES)
def test_feet_stay_on_the_ground(name, clips):
    skeleton, tree = clips[name].skeleton, clip_tree(clips[name])
    ends = [bone_end(skeleton, tree, foot) for foot in ("lfoot", "rfoot")]
    toes = np.stack(ends)[..., 1]
    assert toes.min() > -0.005
    assert toes.max() < 0.12
    # Nobody flies but in a jumping jack.
    aloft = (toes.min(axis=0) > 0.02).mean()
    assert aloft == 0.0 if name != "exercise" else 0.02 < aloft < 0.15


@pytest.mark.parametrize("name", NAMES)
def test_starts_and_ends_standing_with_hanging_arms(name):
    performer = load_performer(name)
    p = performer.centres()
    for frame in (0, -1):
        assert p["waist"][frame, 2] > 0.96 * performer.hip_height
        upright = p["neck"][frame] - p["waist"][frame]
        assert upright[2] > 0.99 * np.linalg.norm(upright)
        for side in ("left", "right"):
            reach = p[f"{side}_wrist"][frame] - p[f"{side}_shoulder"][frame]
            assert reach[2] < -0.9 * np.linalg.norm(reach)
            apart = p[f"{side}_wrist"][frame] - p["waist"][frame]
            assert np.linalg.norm(apart[:2]) > 0.25  # [m], away from the body


def test_dance_turns_once_and_fast():
    heading = np.degrees(load_performer("dance").heading)
    assert np.ptp(heading) >= 350.0
    assert heading[-1] - heading[0] == pytest.approx(360.0, abs=5.0)
    inside = np.flatnonzero((heading > 5.0) & (heading < 355.0))
    turn = inside[inside > 240]
    assert (turn[-1] - turn[0]) / 60.0 < 2.0  # [s]
    for name in ("boxing", "exercise", "reaching"):
        assert np.ptp(load_performer(name).heading) < np.pi / 2.0


def _violations(name: str, tasks: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Counts what the unconstrained motion violates at each step.

    Returns:
        Violated joint limits and penetrating pairs, (T,) each.
    """
    model = ControlModel.FromDescription(
        load_robot_description("upper_body"), position_tasks(tasks)
    )
    targets = load_motion_targets(name, model)
    parameters = PaperParameters(constraints="none", period=STEP)
    law = ControlLaw(model, parameters)
    source = targets.MakePrescribedSource()
    context = source.CreateDefaultContext()

    def prescribed(time):
        context.SetTime(time)
        return source.get_output_port().Eval(context)

    q = model.rest_positions()
    q[model.prescribed] = targets.prescribed_at(0.0)
    v = np.zeros(len(q))
    limits, pairs = [], []
    for time in np.arange(0.0, targets.duration, STEP):
        solution = law.step(q, v, targets.tasks_at(time), prescribed(time))
        joints = q[model.controlled]
        beyond = (joints < model.lower - 1e-6) | (joints > model.upper + 1e-6)
        limits.append(beyond.sum())
        pairs.append((solution.signed_distances < 0.0).sum())
        q, v = np.split(solution.position_command, 2)
    return np.array(limits), np.array(pairs)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_raw_motion_violates_limits_and_pairs_at_once(name, experiment):
    limits, pairs = _violations(name, EXPERIMENTS[experiment])
    total = limits + pairs
    assert not total[: round(0.5 / STEP)].any()  # the start is free
    assert ((limits > 0) & (pairs > 1)).any()
    if name == "dance":
        # More than five at once in its latter half, as in the paper's Fig. 2.
        assert total[len(total) // 2 :].max() > 5
