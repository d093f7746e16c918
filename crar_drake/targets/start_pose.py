"""A constraint-valid pose to start from."""

import math

import numpy as np

from crar_drake.law.paper import (
    Gains,
    constraint_weights,
    damped_inverse,
    inverse_times,
    limit_potential,
)
from crar_drake.law.parameters import PaperGains
from crar_drake.law.references import find_error
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import ModelState

_MARGIN_DISTANCE = 0.02  # [m] that the start keeps from a collision
# What pairs keep that are nearer at rest already, if nothing moves otherwise [m].
_NARROW_MARGINS = (0.01, 0.005)
_MARGIN_LIMIT = 0.02  # [rad] that the start keeps from a joint limit
_LARGEST_STEP = 0.1  # [rad] of one iteration
_ITERATIONS = 300
_ROUNDS = 10  # in which pairs are found that hold up a step

_STOPPED = 1e9  # the weight of a joint that may go no farther
_GAINS = PaperGains(damping=0.05, rho=1e-3)


def solve_start_pose(
    model: ControlModel, tasks: np.ndarray, prescribed: np.ndarray
) -> np.ndarray:
    """The pose (nq,) that comes nearest to the targets from the rest posture.

    Steps of Eq. (9) with the damped inverse of Eq. (34), every constraint counted as
    being approached. Each is shortened until all watched pairs and limits keep a margin
    (or, where the rest posture itself has less, do not lose any; only where that stops
    all steps, down to 5 mm). So the answer is valid if the rest posture is; where the
    targets are not reachable without violation it stops short of them, and the
    controller's blending covers the rest.

    Args:
        model: the robot and its tasks.
        tasks: (layout.size,) [x_d; v_d; a_d] of the first instant.
        prescribed: (n_p,) positions of the prescribed joints.
    """
    workspace = model.MakeWorkspace()
    zero = np.zeros(model.plant.num_velocities())
    layout = model.layout
    desired = layout.unpack(np.array(tasks, dtype=float))
    S = model.row_weights
    limits = limit_potential(model.lower, model.upper)
    gains = Gains.of(_GAINS, math.nan, len(model.pairs))
    before = np.zeros(model.n), np.zeros((len(model.pairs), model.n))  # nothing near

    def at(q: np.ndarray) -> tuple[ModelState, np.ndarray]:
        state = model.evaluate(workspace, q, zero)
        return state, S * find_error(state.q, state.R, state.p, desired, layout.rows)

    q = model.rest_positions()
    q[model.prescribed_positions] = prescribed
    state, error = at(q)
    at_rest = state.d
    narrow = list(_NARROW_MARGINS)
    least_distance = np.minimum(at_rest, _MARGIN_DISTANCE)
    lower = np.minimum(model.lower + _MARGIN_LIMIT, state.q)
    upper = np.maximum(model.upper - _MARGIN_LIMIT, state.q)
    for _ in range(_ITERATIONS):
        J, dd_dq = S[:, None] * state.J, np.ascontiguousarray(state.dd_dq)
        near = state.q, state.d, dd_dq, *before
        W, _, _ = constraint_weights(*near, limits, gains)
        step = inverse_times(damped_inverse(J, W, gains.damping), error)
        # Joints that this takes out of their room stop: others do what they cannot.
        W[(state.q <= lower) & (step < 0.0)] = _STOPPED
        W[(state.q >= upper) & (step > 0.0)] = _STOPPED
        step = inverse_times(damped_inverse(J, W, gains.damping), error)
        step *= min(1.0, _LARGEST_STEP / max(np.abs(step).max(), 1e-12))
        step = _kept_apart(step, state, least_distance)
        for share in (1.0, 0.5, 0.25, 0.1, 0.02):
            trial = model.moved(q, share * step)
            joints = model.controlled_positions
            trial[joints] = np.clip(trial[joints], lower, upper)
            trial_state, trial_error = at(trial)
            valid = (trial_state.d >= least_distance).all()
            if valid and trial_error @ trial_error < error @ error:
                break
        else:
            if not narrow or not (at_rest < _MARGIN_DISTANCE).any():
                break  # no step helps: as near as constraints let it come
            near = at_rest < _MARGIN_DISTANCE
            least_distance[near] = np.minimum(at_rest[near], narrow.pop(0))
            continue
        progress = np.abs(trial - q).max()
        q, state, error = trial, trial_state, trial_error
        if progress < 1e-6:
            break
    return q


def _kept_apart(
    step: np.ndarray, state: ModelState, least_distance: np.ndarray
) -> np.ndarray:
    """The step without what would bring pairs nearer than they may be, to first order:
    weights alone would stop all of it at the first pair."""
    free, slope = step, np.ascontiguousarray(state.dd_dq)
    room = np.minimum(least_distance - state.d, 0.0)
    held = np.zeros(len(room), dtype=bool)
    for _ in range(_ROUNDS):
        near = slope @ free < room
        if not (near & ~held).any():
            break
        held |= near
        lacking = room[held] - slope[held] @ step
        free = step + np.linalg.lstsq(slope[held], lacking, rcond=1e-6)[0]
    return free
