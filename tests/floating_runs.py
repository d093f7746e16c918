"""What tests of roots that float do alike: steps of Drake's plant, braking paths, the
same robot on six joints, and whole runs with keyframes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from floating_robots import APART, SLIDES, TURNS, root_entries
from pydrake.geometry import Meshcat

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.judging.referee import Referee
from crar_drake.results.certificate import PATH_POINTS, Moves, judge_certificate
from crar_drake.results.log import SimulationLog
from crar_drake.results.playback import record_log
from crar_drake.results.plots import plot_run
from crar_drake.robot.model import ControlModel
from crar_drake.run import RunResult
from crar_drake.simulation.scenario import Scenario, parse_scenario

PERIOD, STEP = 5e-3, 1e-3
HORIZON = CrarParameters().braking_horizon
SLOW = 2.5 / 30.0  # T without a preview [s]
FLOOR = 4e-3  # the default distance margin, less the slack

_SCENARIO = """
robot: ROBOT
tasks: [{frame: left_hand}, {frame: right_hand}]
keyframes:
  left_hand: [{time: 0.0, xyz: LEFT}, {time: DURATION, xyz: LEFT_THEN}]
  right_hand: [{time: 0.0, xyz: RIGHT}, {time: DURATION, xyz: RIGHT_THEN}]
controller: {period: 5.0e-3, constraints: MODE}
log_period: 5.0e-3
"""


def by_drake(moves: Moves, model: ControlModel, q, v, vdot):
    """One control period on, by the steps of Drake's discrete plant."""
    for _ in range(round(PERIOD / STEP)):
        v = v + STEP * vdot
        q = moves.step(q, v, STEP)
    at = root_entries(model)[0][:4]
    q[at] /= np.linalg.norm(q[at])
    return q, v


def nearest_in_braking(judge: Referee, moves: Moves, q, v, horizon=HORIZON) -> float:
    """The smallest distance on the braking path of a state [m]."""
    path = moves.along(q, np.outer(np.linspace(0.0, horizon, PATH_POINTS), v))
    return judge.violations(path).smallest_distance


def first_accelerations(
    free: ControlModel, jointed: ControlModel, gains: CrarParameters, q, told=()
) -> np.ndarray:
    """(2, 12) of the same robot on a root that floats and on six joints, from rest and
    not turned: of both arms, and of the root's position and orientation.

    Args:
        free, jointed: by `make_floater` and `on_six_joints`.
        gains: of both laws.
        q: of the first, whose hands are then drawn away.
        told: the last of `desired_prescribed`, accelerations.
    """
    goal = free.tasks_at(q)
    goal[:6] += [0.02, 0.05, -0.02, -0.03, -0.07, 0.01]
    arms = [n for n in jointed.joint_names if n not in (*SLIDES, *TURNS)]
    rates = [f"body.{v}" for v in ("vx", "vy", "vz", "wx", "wy", "wz")]
    found = []
    for model, names in ((free, rates), (jointed, [*SLIDES, *TURNS])):
        at = np.zeros(model.plant.num_positions())
        at[root_entries(free)[0][:1]] = 1.0 if model is free else 0.0
        for name, value in zip(arms, APART, strict=True):
            at[model.plant.GetJointByName(name).position_start()] = value
        prescribed = model.prescribed_at(at)
        prescribed[len(prescribed) - len(told) :] = told
        still = np.zeros(len(model.order))
        solution = ControlLaw(model, gains).step(at, still, goal, prescribed)
        every = dict(zip(model.velocity_names, solution.acceleration, strict=True))
        found.append([every[name] for name in [*arms, *names]])
    return np.array(found)


def hands_scenario(
    folder: Path,
    hands: np.ndarray,
    then: Sequence[np.ndarray],
    constraints: str = "lookahead",
    duration: float = 0.8,
) -> Scenario:
    """Of the robot of `write_floater`, whose hands go from some places to others.

    Args:
        folder: of the robot.
        hands, then: (2, 3) the places [m].
        constraints: of the controller.
        duration: of the way [s].
    """
    text = _SCENARIO.replace("ROBOT", str(folder)).replace("MODE", constraints)
    text = text.replace("DURATION", f"{duration:g}")
    for name, value in (
        ("LEFT_THEN", then[0]),
        ("LEFT", hands[0]),
        ("RIGHT_THEN", then[1]),
        ("RIGHT", hands[1]),
    ):
        text = text.replace(f"xyz: {name}}}", f"xyz: {np.asarray(value).tolist()}}}")
    return parse_scenario(text, "test")


def check_log(result: RunResult, log: SimulationLog, folder: Path) -> None:
    """It is judged, nothing refutes its certificate, and it is drawn and recorded."""
    assert result.summary.violated_samples == 0
    model, parameters = result.setup.model, CrarParameters(period=PERIOD)
    referee = Referee(model.plant, model.scene_graph, model.description.pairs)
    verdict = judge_certificate(log, referee, parameters, STEP)
    assert verdict.true and verdict.reported_unclear == 0 and verdict.steps.judged > 20
    plot_run(log, folder / "plot.png")
    record_log(log, folder / "page.html", meshcat=Meshcat())
    assert (folder / "page.html").stat().st_size > 1e5
