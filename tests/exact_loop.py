"""A control law on the exact model: the next state is the law's own prediction."""

import numpy as np

from crar_drake import ControlModel
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters


def follow(model: ControlModel, parameters: LookaheadParameters, targets: np.ndarray):
    """From rest, prescribed joints at rest, a row of targets (K, layout.size) a period.

    Returns:
        The states that follow (K, nq + nv), and what the law answered, (K) solutions.
    """
    law = ControlLaw(model, parameters)
    q = model.rest_positions()
    still, v = model.prescribed_at(q), np.zeros(model.plant.num_velocities())
    states, answers = [], []
    for target in targets:
        answers.append(law.step(q, v, target, still))
        command = answers[-1].position_command
        q, v = command[: len(q)], command[len(q) :]
        states.append(command)
    return np.array(states), answers
