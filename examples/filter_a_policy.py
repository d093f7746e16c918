"""A policy's actions at 50 Hz, in the shape of LeRobot's robots, through a filter.

python examples/filter_a_policy.py [seconds]
"""

import sys
from collections import Counter

import numpy as np

from crar_drake import SafetyFilter
from crar_drake.judging.referee import Referee

RATE = 50.0  # [Hz]


class Robot:
    """Stands for a real one: it is at once where it is told to be."""

    def __init__(self, positions: dict[str, float]) -> None:
        self.positions = dict(positions)

    def get_observation(self) -> dict[str, float]:
        return {f"{joint}.pos": q for joint, q in self.positions.items()}

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.positions |= {k.removesuffix(".pos"): q for k, q in action.items()}
        return action


class SafeRobot(Robot):
    """The same, behind a filter; it tells what was sent in place of an action."""

    def __init__(self, filter: SafetyFilter) -> None:
        rest = filter.model.rest_positions()
        super().__init__(dict(zip(filter.joint_names, rest, strict=True)))
        self.filter = filter

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        wanted = {k.removesuffix(".pos"): q for k, q in action.items()}
        self.command = self.filter(wanted)
        return super().send_action(
            {f"{joint}.pos": q for joint, q in self.command.by_name.items()}
        )


robot = SafeRobot(SafetyFilter("upper_body", period=1.0 / RATE))
model, rng = robot.filter.model, np.random.default_rng(3)
start, sent, counts = robot.get_observation(), [], Counter()
size = rng.uniform(0.0, 1.0, model.n)
for k in range(int(RATE * float(sys.argv[1] if len(sys.argv) > 1 else 20.0))):
    swing = size * np.sin(0.6 * np.pi * k / RATE) + rng.normal(0.0, 2e-3, model.n)
    robot.send_action({n: start[n] + x for n, x in zip(start, swing, strict=True)})
    report = robot.command.report
    counts[f"{report.how} {report.why}".strip()] += 1
    sent.append(robot.command.q)
referee = Referee(model.plant, model.scene_graph, model.description.pairs)
found = referee.violations(np.array(sent))
print(", ".join(f"{kind}: {count}" for kind, count in counts.items()))
print(f"nearest {1e3 * found.smallest_distance:.1f} mm, {found.num_violated} violated")
