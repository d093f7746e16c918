"""Builds a scenario's diagram in a script, simulates it and looks at the ports.

python examples/build_and_simulate.py [seconds]
"""

import sys

import numpy as np
from pydrake.systems.analysis import Simulator

from crar_drake import CrarParameters, MakeCrarDiagram, Scenario

seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0

scenario = Scenario(
    robot="upper_body",
    motion="boxing",
    experiment="upper-body",
    controller=CrarParameters(constraints="lookahead"),
)
diagram = MakeCrarDiagram(scenario)
simulator = Simulator(diagram)
controller = diagram.GetSubsystemByName("crar_controller")
context = controller.GetMyContextFromRoot(simulator.get_context())

smallest = np.inf
for time in np.arange(0.0, seconds, 0.05):
    simulator.AdvanceTo(time)
    reported = controller.diagnostics(context)
    error = reported["task_error"]
    smallest = min(smallest, reported["signed_distances"].min())
print(f"task error at {seconds:g} s: {1e3 * np.abs(error).max():.1f} mm")
print(f"smallest distance: {1e3 * smallest:.1f} mm")
