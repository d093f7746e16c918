"""The ground, which can push only so much: a robot that stands does not tip over.

Lemma: braking keeps it. With kappa = w^2 and a the share of the braking acceleration,
every state of braking a period on is of the present path, with kappa' kappa and kappa'
a in (B2) of `docs/theory/balance.md`. A state is safe if every wrench of (B2) on its
braking path is in the cone K that the soles can give; a step if its own wrench is, in
the whole period, and it leads to a safe state. A wrench that is out of K already may
not go farther out.

Rows (B5): linear about what was examined, of each face of K that is near.
"""

import numpy as np

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.balance import BalanceLaw, balance_level, examine_balance
from crar_drake.law.compilation import hold
from crar_drake.law.parameters import BalanceParameters
from crar_drake.law.projection import Rows, hard_rows, stacked
from crar_drake.law.step import SafetyCheck, State
from crar_drake.robot.model import ControlModel
from crar_drake.robot.soles import ground_cone, masses_on_soles, sole_corners

# What the pieces of a path may add to a face's value, and what a correction leaves to
# spare [m of the weight's arm]: small beside a sole.
_FINEST, _SPARE = 2e-4, 1e-3
# Of the weight, which counts as balanced: doubles are no closer [m].
_ROUNDING = 1e-9
# What a joint counts beside the tasks where a step is changed [m].
_DAMPING = 0.3
# Faces that are farther below their level get no rows [m, as above].
_NEAR = 0.1


class Ground:
    """The constraint of a robot on its soles, whose base is fixed; T never changes.

    Attributes:
        weight: of the robot [N].
    """

    name = "ground"

    def __init__(
        self, model: ControlModel, T: float, period: float, soles: BalanceParameters
    ) -> None:
        """
        Args:
            model: of the robot, its base fixed.
            T: braking time constant [s].
            period: of the controller [s].
            soles: margin and friction.

        Raises:
            ModelError: the robot has no soles, or they move.
            ScenarioError: it is not balanced at rest; or prescribed joints move.
        """
        description = model.description
        if not description.soles:
            raise ModelError(
                f"robot {description.name}: controller.balance needs soles, and there "
                "are none; give link -> corners of its flat sole"
            )
        moving = [
            joint
            for joint, source in description.prescribed_joints.items()
            if source != "hold"
        ]
        if moving:
            raise ScenarioError(
                f"controller.balance: {', '.join(moving)}: the motion moves the base "
                "of a robot that stands; say hold"
            )
        masses = masses_on_soles(model)
        cone = ground_cone(sole_corners(model), soles.friction, soles.margin)
        self.weight = float(masses.inertia[:, 3, 3].sum() * masses.g)
        self._model, self._T = model, T
        self._law = hold(
            BalanceLaw(
                *(masses, cone, model.controlled, T, period),
                float(min(model.plant.time_step(), period)),
                *(_FINEST * self.weight, _NEAR * self.weight),
            )
        )
        rest = model.rest_positions()
        level = balance_level(rest, np.zeros(model.plant.num_velocities()), self._law)
        if level.max() > 0.0:
            raise ScenarioError(
                f"controller.balance: robot {description.name} is not balanced in its "
                "rest posture: its centre of mass is not over the soles, less a margin "
                f"of {1e3 * soles.margin:g} mm; change the posture, or the margin"
            )

    def is_safe(self, q: np.ndarray, v: np.ndarray, T: float) -> bool:
        """On soles T never changes."""
        return T == self._T

    def begin(self, state: State) -> None:
        model = self._model
        self._q, self._v = model.in_plant(state.q, state.v)
        self._level = balance_level(self._q, self._v, self._law)
        self._brake: np.ndarray | None = None
        # What evades a tip is to move the tasks the least.
        J = model.task_state(self._q, self._v).J[:, : state.n]
        norm = J.T @ J + _DAMPING**2 * np.eye(state.n)
        state.root = np.linalg.cholesky(state.n / np.trace(norm) * norm)

    def rows(self, state: State) -> None:
        return None

    def examine(self, state: State, s: np.ndarray, correct: bool) -> SafetyCheck:
        _, a = self._model.in_plant(state.q, (s - state.v) / self._T)
        given = self._q, self._v, a, self._level
        most = _ROUNDING * self.weight
        asked = most if correct else np.inf
        excess, *found = examine_balance(*given, asked, self._law)
        left = -excess / self.weight
        if excess <= most or not correct:
            return SafetyCheck(excess <= most, left)
        rows = []
        if self._brake is None:
            # About braking first: nearer to what comes out than the nominal is.
            still = np.concatenate((np.zeros(state.n), state.v[state.n :]))
            _, self._brake = self._model.in_plant(state.q, (still - state.v) / self._T)
            of_braking = self._q, self._v, self._brake, self._level
            _, *about = examine_balance(*of_braking, -np.inf, self._law)
            rows.append(self._of(*about, state))
        rows.append(self._of(*found, state))
        return SafetyCheck(False, left, stacked(rows))

    def _of(self, g: np.ndarray, b: np.ndarray, state: State) -> Rows:
        """Rows on s of g q_ddot <= b; not more is asked for than braking has."""
        at = self._model.controlled
        b = np.maximum(b - _SPARE * self.weight, g @ self._brake[at])
        size = np.sqrt((g * g).sum(axis=1))
        some = np.flatnonzero(np.isfinite(b) & (size > 0.0))
        g, b = g[some] / size[some, None], b[some] / size[some]
        return hard_rows(-g, -(self._T * b + g @ state.v[: state.n]))
