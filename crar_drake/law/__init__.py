"""One step of the law: a nominal, its projection, and the safety check.

`step` is the idea. `pairs`, `limits`, `motors` and `spheres` are constraints,
`joint_command` is a nominal. A constraint of one's own is a class with the methods of
`Constraint`; `examples/own_constraint.py` has one.
"""

from crar_drake.law.projection import Rows, hard_rows
from crar_drake.law.segment import lowest_on_segment
from crar_drake.law.step import Constraint, SafetyCheck, State

__all__ = [
    "Constraint",
    "Rows",
    "SafetyCheck",
    "State",
    "hard_rows",
    "lowest_on_segment",
]
