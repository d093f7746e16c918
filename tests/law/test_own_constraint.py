"""A constraint that a user wrote, beside all others, under attack.

Drake's own plant judges: the hand's height, distances of links, joint limits, torques.
"""

import runpy
from pathlib import Path

import numpy as np
import pytest

from crar_drake import Obstacles, SafetyFilter
from crar_drake.judging.referee import Referee

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
STEPS, PERIOD = 2500, 0.01
SHARES = (0.25, 0.5, 0.75, 1.0)


def attack(kind: str, rng: np.random.Generator, rest: np.ndarray):
    """What is desired at each step, by what is known of the command before."""
    held = {}

    def desired(k: int, q: np.ndarray) -> dict[str, np.ndarray]:
        if k % 20 == 0:
            held["q"] = rest + rng.uniform(-1.5, 1.5, len(rest))
            held["v"] = rng.uniform(-5.0, 5.0, len(rest))
        if kind == "accelerations":
            return {"a": rng.normal(0.0, 200.0, len(rest))}
        if kind == "noise":
            return {"q": q + rng.normal(0.0, 0.05, len(rest))}
        return {"q": held["q"]} if kind == "jumps" else {"v": held["v"]}

    return desired


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["jumps", "velocities", "accelerations", "noise"])
def test_a_hand_stays_above_a_height_beside_all_other_constraints(kind):
    """10,000 steps of four attacks; and it is what holds commands back."""
    HandAbove = runpy.run_path(str(EXAMPLES / "own_constraint.py"))["HandAbove"]
    filter = SafetyFilter("upper_body", PERIOD, effort_limits=True)
    model = filter.model
    plant, rest = model.plant, model.rest_positions()
    context = plant.CreateDefaultContext()
    hand = plant.GetFrameByName("left_hand")

    def height(q: np.ndarray) -> float:
        plant.SetPositions(context, q)
        return hand.CalcPoseInWorld(context).translation()[2]

    table = height(rest) - 0.05
    filter.constraints.append(HandAbove(model, "left_hand", table, reach=1.5))
    rng = np.random.default_rng(4)
    desired = attack(kind, rng, rest)
    q, v, ways, reasons, use = rest, 0.0 * rest, [rest], set(), 0.0
    limits, workspace = model.actuator_limits, model.MakeWorkspace()
    for k in range(STEPS):
        around = 0.9 * np.array([np.cos(0.01 * k), np.sin(0.01 * k), 0.0])
        command = filter(
            **desired(k, q), obstacles=Obstacles([around + [0.0, 0.0, 1.0]], 0.1, 1.0)
        )
        x = np.concatenate((q, v))
        plant.SetPositionsAndVelocities(workspace.plant_context, x)
        torque = model.inverse_dynamics(workspace, command.a)
        use = max(use, np.abs(torque / limits).max())
        ways += [q + share * (command.q - q) for share in SHARES]
        q, v = command.q, command.v
        reasons.add(command.report.why)
    assert min(map(height, ways)) >= table - 1e-9
    referee = Referee(plant, model.scene_graph, model.description.pairs)
    found = referee.violations(np.array(ways))
    assert found.num_violated == 0 and found.smallest_distance > 4e-3 - 1e-6
    assert use <= 1.0
    assert "table" in reasons or kind == "accelerations"  # which never get there
