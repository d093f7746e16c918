"""The law: a nominal, its projection, and the safety check; and its Drake systems.

    step, projection            one step, from nominal and constraints
    pairs, limits, motors,      constraints, a file each
    spheres, ground
    paper, plan, joint_command  nominals, a file each
    constraints                 those of a robot; the braking time constant T
    control_law, safety_filter  tasks, or joint commands, to safe accelerations
    measured                    what is believed of measured states
    controller, safety_filter_system, standing_controller
                                their Drake systems
    parameters                  of all of them

The paper's equations, indexed in `docs/theory/equations.md`:

    tasks                   Eqs. (4), (7), (8), (11)
    kinematics              Eqs. (5), (6), (20)
    references              Eqs. (9), (11), (14)
    paper                   Eqs. (10), (12), (13), (15)-(28), (30)-(35)

A constraint of one's own is a class with the methods of `Constraint`;
`examples/own_constraint.py` has one.
"""

from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.step import Constraint, SafetyCheck, State, lowest_on_segment

__all__ = [
    "Constraint",
    "Rows",
    "SafetyCheck",
    "State",
    "hard_rows",
    "lowest_on_segment",
]
