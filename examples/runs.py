"""A scenario made in Python: simulated, recorded, and judged by code of its own."""

import sys

from crar_drake import LookaheadParameters, Scenario
from crar_drake.judging.referee import Referee
from crar_drake.run import run_scenario

scenario = Scenario(
    robot="upper_body",
    motion="boxing",
    experiment="wrists",
    duration=float(sys.argv[1]) if len(sys.argv) > 1 else 3.0,
    controller=LookaheadParameters(),
)
result = run_scenario(scenario, "boxing")  # recording.html, log.npz, summary.json
model = result.setup.model
referee = Referee(model.plant, model.scene_graph, model.description.pairs)
verdict = referee.violations(result.log.q, result.log.v)
print(f"samples that violate something: {verdict.num_violated}")
print(f"smallest distance: {1e3 * verdict.smallest_distance:.1f} mm")
for file in result.files:
    print(file)
