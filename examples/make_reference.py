"""Writes examples/g1_boxing.csv: the built-in boxing on a G1, with no constraints.

A reference motion of our own, as policies are trained on: its hands go through its
trunk, so that `crar-drake judge` has something to find and `crar-drake clean` to mend.

    crar-drake import-robot g1_whole_body
    python examples/make_reference.py [file] [scenario] [seconds]
"""

import sys
from pathlib import Path

import numpy as np

from crar_drake import load_scenario
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.logged_motion import export_log
from crar_drake.run import run_scenario

RATE = 30.0  # [Hz]
BLENDED = 0.5  # [s] the robot's way onto the motion, which is left out

given = dict(enumerate(sys.argv))
out = Path(given.get(1, Path(__file__).parent / "g1_boxing.csv"))
scenario = load_scenario(given.get(2, "g1_whole_body_boxing"))
scenario.motion, scenario.duration = "boxing", float(given.get(3, 3.0))
scenario.controller.constraints = "none"
result = run_scenario(scenario)
robot = WholeBody(result.setup.model.description)
export_log(result.log, robot, out, "wxyz-csv", RATE, BLENDED)
# A tenth of a milliradian, and of a millimetre, is enough, and a fifth of the size.
np.savetxt(out, np.loadtxt(out, delimiter=","), "%.4f", ",")
