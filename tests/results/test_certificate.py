"""What a log claims of braking paths, on a slider whose distances are worked out here.

A ball of 0.1 m slides along x, another one stands at x = 1 m: d = |1 - q| - 0.2. The
horizon is 0.5 s, so that a braking path leads from q to q + 0.5 v. The floor is 4 mm.
"""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_logs import small_log

from crar_drake.judging.referee import Referee
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.results.certificate import has_certificate, judge_certificate

BALL = """
  <link name="{0}">
    <inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.1"/></geometry></collision>
  </link>
"""
URDF = f"""<robot name="slider"><link name="world"/>{BALL.format("post")}
  <joint name="stands" type="fixed"><parent link="world"/><child link="post"/>
    <origin xyz="1 0 0"/></joint>{BALL.format("ball")}
  <joint name="slide" type="prismatic"><parent link="world"/><child link="ball"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="5" effort="9" velocity="9"/></joint>
</robot>"""

PERIOD, T = 0.1, 0.5
PARAMETERS = LookaheadParameters(period=PERIOD, braking_time=T)


def referee() -> Referee:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, PERIOD)
    Parser(plant).AddModelsFromString(URDF, "urdf")
    plant.Finalize()
    return Referee(plant, scene_graph, [["ball", "post"]])


def log_of(q, v, clearance, clear=1.0, how=0.0, time=None, a=0.0):
    """A log of the slider; what is one number is so in every sample."""
    size = len(q)
    column = {
        name: np.broadcast_to(value, size).astype(float)
        for name, value in dict(
            q=q, v=v, a=a, how=how, clearance=clearance, clear=clear
        ).items()
    }
    told = [column["how"], np.ones(size), column["clearance"], column["clear"]]
    return replace(
        small_log(),
        time=PERIOD * np.arange(size) if time is None else np.array(time),
        q=column["q"][:, np.newaxis],
        v=column["v"][:, np.newaxis],
        desired_acceleration=column["a"][:, np.newaxis],
        admission=np.stack(told, axis=1),
        balance=np.full((len(told[0]), 3), np.nan),
        signed_distances=np.abs(1.0 - column["q"][:, np.newaxis]) - 0.2,
        controlled_names=np.array(["slide"]),
    )


def judge(log, step=PERIOD, every=None):
    return judge_certificate(log, referee(), PARAMETERS, step, every)


@pytest.mark.parametrize("by, undercut", [(-1e-3, 0), (0.0, 0), (2e-6, 1), (0.3, 1)])
def test_the_claim_is_of_the_next_braking_path(by, undercut):
    """Paths end at 0.2, 0.6 and 0.4: 0.6, 0.2 and 0.4 m from the post."""
    log = log_of([0.0, 0.1, 0.2], [0.4, 1.0, 0.4], [0.2 + by, 0.4, 0.35], a=0.0)
    log.desired_acceleration[2] = -0.8
    found = judge(log)
    assert (found.undercut, found.not_clear) == (undercut, 0)
    assert found.true == (undercut == 0) and not found.violated
    assert found.reported == found.steps.judged == found.steps.of == 3
    assert found.steps.nearest.distance == pytest.approx(0.2)
    assert found.steps.nearest.time == PERIOD
    assert found.clearance == pytest.approx(min(0.2 + by, 0.35))
    if undercut:
        worst = found.undercut_worst
        assert (worst.time, worst.pair) == (PERIOD, ("ball", "post"))
        assert worst.distance == pytest.approx(0.2)
        assert found.undercut_claim == pytest.approx(0.2 + by)


@pytest.mark.parametrize(
    "rest, clear, refuted, below, penetrating",
    [
        (0.7959, 1.0, 0, 0, 0),
        (0.7961, 1.0, 1, 1, 0),
        (0.7961, 0.0, 0, 1, 0),  # no claim, nothing to refute
        (0.81, 1.0, 1, 1, 1),
        (0.81, 0.0, 0, 1, 1),
        (2.0, 1.0, 1, 1, 1),  # clear at both ends, and through the post
    ],
)
def test_a_path_that_is_said_to_be_clear(rest, clear, refuted, below, penetrating):
    log = log_of([0.0, 0.0], [2.0 * rest, 0.0], 0.004, [clear, 1.0], a=0.0)
    found = judge(log)
    assert (found.not_clear, found.reported_unclear) == (refuted, int(clear == 0.0))
    assert (found.steps.below_floor, found.steps.penetrating) == (below, penetrating)
    assert found.violated == bool(penetrating)
    assert found.true == (not refuted)
    if refuted:
        expected = -0.2 if rest == 2.0 else 0.8 - rest
        assert found.not_clear_worst.distance == pytest.approx(expected)
        assert found.not_clear_worst.time == 0.0


@pytest.mark.parametrize("beyond, count", [(0.0, 0), (0.9e-6, 0), (1.1e-6, 1)])
def test_limits_count_where_the_robot_comes_to_rest(beyond, count):
    log = log_of([-0.5, 0.0], [-1.0 - 2.0 * beyond, 0.0], 0.004)
    found = judge(log)
    assert found.steps.beyond_limit == count and found.violated == bool(count)
    assert found.steps.largest_excess == pytest.approx(beyond, abs=1e-12)
    # A prescribed joint goes where it is told to.
    other = replace(log, controlled_names=np.array(["other"]))
    assert judge(other).steps.beyond_limit == 0


@pytest.mark.parametrize("step, ends", [(PERIOD, 0.86), (PERIOD / 2.0, 0.85)])
def test_a_coarse_log_is_judged_by_what_was_commanded(step, ends):
    """v' = 1.0, and q' = 0.1 + 0.26 = 0.36 or 0.1 + 0.25 = 0.35 after one period."""
    changes = dict(v=[3.0, 0.0], a=[-20.0, 0.0], time=[0.0, 3.0 * PERIOD])
    start = ends - 0.5 - {PERIOD: 0.1, PERIOD / 2.0: 0.15}[step]
    distance = 0.8 - ends
    for claim, undercut in ((distance - 2e-6, 0), (distance + 2e-6, 1)):
        found = judge(log_of([start, 0.0], clearance=[claim, 0.5], **changes), step)
        assert found.undercut == undercut
        if undercut:
            assert found.undercut_worst.time == pytest.approx(PERIOD)


def test_samples_between_control_steps_are_told_apart():
    time = PERIOD * np.array([0.0, 0.5, 1.0, 1.5])
    log = log_of([0.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], 0.7, time=time)
    found = judge(log)
    assert (found.steps.of, found.between.of) == (2, 2)
    assert (found.steps.penetrating, found.between.penetrating) == (0, 1)
    assert found.between.nearest.distance == pytest.approx(-0.2)
    assert found.true and not found.violated


def test_of_a_continuous_plant_the_log_tells_of_the_step_before():
    """Only the path at 0.1 s comes as near as 0.2 m; tick 0's claim is in sample 1."""
    q, v = [0.0, 0.1, 0.2, 0.2], [0.4, 1.0, 0.0, 0.0]
    right = log_of(q, v, [0.1, 0.2, 0.5, 0.5])
    assert judge(right, step=0.0).undercut == 0
    assert judge(right, step=PERIOD).undercut == 0
    wrong = log_of(q, v, [0.1, 0.25, 0.5, 0.5])
    assert judge(wrong, step=0.0).undercut == 1
    assert judge(wrong, step=PERIOD).undercut == 0


@pytest.mark.slow
def test_a_long_log_is_judged_in_part_but_always_where_it_is_near():
    size, lie = 850, 700
    q = np.zeros(size)
    log = log_of(q, 0.0, 0.7)
    in_part = judge(log)
    assert in_part.true and in_part.every == 3
    assert in_part.steps.judged < 450
    assert judge(log, every=1).steps.judged == size
    # One path leads near the post: not among every third, nor among the nearest.
    log.v[lie + 1] = 1.4
    assert judge(log).true
    assert judge(log, every=1).undercut == 1
    # But if the log says that something is near there.
    log.admission[lie, 2] = 0.3
    assert judge(log).undercut == 1
    log.admission[lie, 2] = 0.1
    assert judge(log).true and judge(log, every=1).true


def test_steps_without_targets_claim_nothing():
    nan = np.nan
    log = log_of([0.0, 0.0], [1.7, 0.0], [nan, 0.7], [nan, 1.0], [nan, 0.0])
    found = judge(log)
    assert (found.reported, found.not_clear, found.steps.penetrating) == (1, 0, 1)
    assert found.true and found.violated
    assert has_certificate(log)
    assert not has_certificate(log_of([0.0], 0.0, nan, nan, nan))
