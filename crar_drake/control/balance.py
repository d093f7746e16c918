"""A robot that stands: only steps from which it could brake without tipping over.

`equations.balance` has the condition, `docs/theory/balance.md` the theorem. What the
mode admits of the targets is changed to the nearest accelerations that are balanced, or
scaled towards braking, which always is.
"""

from collections.abc import Callable, Mapping

import numpy as np

from crar_drake.control.modes.mode import Mode
from crar_drake.control.parameters import BalanceParameters
from crar_drake.equations.admission import AS_NOMINAL, BISECTIONS, CORRECTED, SCALED
from crar_drake.equations.balance import (
    BalanceLaw,
    balance_excess,
    balance_level,
    balance_rows,
)
from crar_drake.equations.balance_correction import correction_norm, nearest_balanced
from crar_drake.equations.compilation import hold
from crar_drake.equations.kinematics import Measured
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.robot.model import ControlModel
from crar_drake.robot.soles import find_masses, ground_cone, sole_corners

# How often a correction is tried, with rows about the one before.
_CORRECTIONS = 4
# What the pieces of a path may add to a face's value, and what a correction leaves to
# spare [m of the weight's arm]: small beside a sole.
_FINEST = 2e-4
_SPARE = 1e-3
# Of the weight, which counts as balanced: doubles are no closer [m].
_ROUNDING = 1e-9
# What a joint counts beside the tasks where a step is corrected [m].
_DAMPING = 0.3
# Faces that are farther below their level get no rows, and rows that are farther from
# binding are left out of a correction [m, as above].
_NEAR, _FAR = 0.1, 0.5

# Accelerations to what the mode leaves of them and what it reports; None if the motors
# have not the torque.
Admit = Callable[[np.ndarray], tuple[np.ndarray, Mapping[str, np.ndarray]] | None]


class Balance:
    """The admission of balance for a robot and its mode.

    Attributes:
        ground: K, what the ground may be asked for.
        weight: of the robot [N].
    """

    def __init__(
        self, model: ControlModel, parameters: BalanceParameters, mode: Mode,
        period: float,
    ) -> None:  # fmt: skip
        """
        Args:
            model: of the robot, its base fixed.
            parameters: of the ground.
            mode: the lookahead, with one braking horizon.
            period: control period [s].

        Raises:
            ModelError: the robot has no soles, or they move.
            ScenarioError: it is not balanced at rest, or may brake over several
                horizons; or prescribed joints move.
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
        if mode.slower:
            raise ScenarioError(
                "controller.lookahead.longest_horizon: with balance there is one "
                "braking horizon; leave it out"
            )
        masses = find_masses(model)
        corners = sole_corners(model, description.soles)
        self.ground = ground_cone(corners, parameters.friction, parameters.margin)
        self.weight = float(masses.mass.sum() * masses.g)
        self._controlled = model.controlled
        self._model = model
        self._mode = mode
        self._T = float(mode.horizon)
        self._law = hold(
            BalanceLaw(
                masses,
                self.ground,
                model.controlled,
                self._T,
                float(period),
                float(min(model.plant.time_step(), period)),
                _FINEST * self.weight,
                _NEAR * self.weight,
            )
        )
        rest = model.rest_positions()
        level = balance_level(rest, np.zeros(model.plant.num_velocities()), self._law)
        if level.max() > 0.0:
            raise ScenarioError(
                f"controller.balance: robot {description.name} is not balanced in its "
                "rest posture: its centre of mass is not over the soles, less a margin "
                f"of {1e3 * parameters.margin:g} mm; change the posture, or the margin"
            )

    def limit(
        self, measured: Measured, vdot: np.ndarray, admit: Admit
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The nearest accelerations that are balanced, or a share of them.

        Args:
            measured: the state.
            vdot: (nv,) accelerations that are admitted but for balance.
            admit: asked of accelerations that are changed.

        Returns:
            (nv,) accelerations; and what is reported of them: by `admit`, where it was
            asked, and "balance".
        """
        q, v = measured.q[0], measured.v
        level = balance_level(q, v, self._law)
        enough = _ROUNDING * self.weight

        def excess_of(a: np.ndarray) -> float:
            return balance_excess(q, v, a, level, self._law)

        excess = excess_of(vdot)
        if excess <= enough:
            return vdot, self._report(AS_NOMINAL, 1.0, excess)
        at = self._controlled
        brake = np.zeros_like(v)
        brake[at] = -v[at] / self._T
        root = correction_norm(q, _DAMPING, self._model.robot_by_pair)
        bounds = self._mode.acceleration_bounds(measured)
        # Rows about braking first: nearer to what comes out than the nominal is.
        _, g, b = balance_rows(q, v, brake, level, -np.inf, self._law)
        for _ in range(_CORRECTIONS):
            # Not more is asked for than braking has, which is balanced.
            b = np.maximum(b - _SPARE * self.weight, g @ brake[at])
            aim = vdot.copy()
            aim[at] = nearest_balanced(
                root, vdot[at], g / self.weight, b / self.weight, *bounds, _FAR
            )
            excess, g, b = balance_rows(q, v, aim, level, enough, self._law)
            if excess > enough:
                continue
            # Asked last, for pairs and torques take longer than balance.
            found = admit(aim)
            if found is None:
                break
            if not np.array_equal(found[0], aim):
                excess, g, b = balance_rows(q, v, found[0], level, enough, self._law)
            if excess <= enough:
                return found[0], {**found[1], **self._report(CORRECTED, 1.0, excess)}
        # Braking is balanced by the theorem, where the bounds do not show it, too.
        best = brake, self._report(SCALED, 0.0, min(excess_of(brake), 0.0))
        share, failed = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (share + failed)
            there = brake + middle * (aim - brake)
            excess = excess_of(there)
            found = admit(there) if excess <= enough else None
            if found is not None and not np.array_equal(found[0], there):
                excess = excess_of(found[0])
            if found is not None and excess <= enough:
                share = middle
                best = found[0], {**found[1], **self._report(SCALED, share, excess)}
            else:
                failed = middle
        return best

    def compile(self, measured: Measured) -> None:
        """Compiles what has yet to be, at a state."""
        q, v = measured.q[0], measured.v
        level = balance_level(q, v, self._law)
        balance_excess(q, v, np.zeros_like(v), level, self._law)
        _, g, b = balance_rows(q, v, np.zeros_like(v), level, -np.inf, self._law)
        root = correction_norm(q, _DAMPING, self._model.robot_by_pair)
        bounds = self._mode.acceleration_bounds(measured)
        nearest_balanced(
            root, v[self._controlled], g, np.minimum(b, -1.0), *bounds, np.inf
        )

    def _report(self, how: float, share: float, excess: float) -> dict[str, np.ndarray]:
        return {"balance": np.array([how, share, -excess / self.weight])}
