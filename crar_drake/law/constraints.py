"""The constraints of a robot, and the braking time constant T of each step.

What the control law and the safety filter have in common: pairs, limits, motors,
obstacles that move and the ground, by the model and the parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from crar_drake.errors import ScenarioError
from crar_drake.law.approach import Approach
from crar_drake.law.compilation import hold
from crar_drake.law.ground import Ground
from crar_drake.law.limits import JointLimits, Limits, is_within
from crar_drake.law.measured import fastest_asked
from crar_drake.law.motors import Motors
from crar_drake.law.obstacles import Regions
from crar_drake.law.pairs import Pairs
from crar_drake.law.parameters import LEAST_PERIODS, LookaheadParameters
from crar_drake.law.path_balls import Shapes
from crar_drake.law.spheres import MovingSpheres
from crar_drake.law.step import SCALED, Constraint, State, Step, step
from crar_drake.law.tracking_error import joint_errors, narrowed_limits, thickened
from crar_drake.robot.balls import find_balls
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches


@dataclass(frozen=True, slots=True)
class Braking:
    """What one step leaves to the next; never changed in place."""

    T: float = 0.0  # over which the robot may brake [s]; 0 before the first step
    # whether its braking path over T is known to be collision-free
    known: bool = False
    # where obstacles are at the next step at most; None without any
    regions: Regions | None = None


class Taken(NamedTuple):
    """The step of a robot, and what is known of it."""

    step: Step
    clear: bool  # whether nothing is violated where it began, nor on the path there
    clearance: float  # no watched distance is smaller on the braking path after it [m]
    braking: Braking  # for the next step


class RobotConstraints:
    """The constraints of a robot, in the order in which they are asked.

    Attributes:
        T: braking time constant wherever nothing asks for another [s].
        errors: (nv,) how far joints may be from their commands [rad or m].
        fastest: that q_s is asked to move in any joint [rad/s or m/s].
        pairs, limits: always there.
        motors, ground: None where nothing limits motors, or nobody stands.
        all: a list, to which a user may append others; moving obstacles come last.
    """

    def __init__(
        self,
        model: ControlModel,
        gains: LookaheadParameters,
        approach: Approach,
        T: float,
        others: Sequence[float],
        plant_step: float,
    ) -> None:
        """
        Args:
            model: of the robot.
            gains: the margin, tracking errors, speeds and efforts of it count.
            approach: of the rows.
            T: as of the attribute.
            others: further T [s]: shorter ones for starts that are so fast that the
                braking path over T is not clear, longer ones for weak motors.
            plant_step: of what does as commanded [s].
        """
        self.model, self.T, self._gains = model, float(T), gains
        self.period = float(gains.period)
        self.plant_step = min(float(plant_step), self.period)
        choices = {self.T, *(float(x) for x in others)}
        least = LEAST_PERIODS * self.period
        self._choices = sorted(x for x in choices if x >= least or x == self.T)
        plant = model.plant
        self.errors = errors = joint_errors(gains, model)
        lower, upper = narrowed_limits(errors, model)
        none = np.flatnonzero(upper - lower <= 2.0 * gains.limit_margin)
        if len(none) and gains.limit_margin > LookaheadParameters.limit_margin:
            raise ScenarioError(
                f"controller.limit_margin: {gains.limit_margin} leaves joint "
                f"{model.joint_names[none[0]]} no room; lower it, or leave it out"
            )
        reaches = find_reaches(
            *(model.joints, model.pairs, model.order),
            *(plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()),
        )
        robot, losses = model.robot, np.zeros(len(model.pairs.pair_of_shapes))
        if errors.any():
            robot, losses = thickened(errors, reaches, gains.safety_distance, model)
        self._approach, self.fastest = approach, approach.fastest
        self.pairs = Pairs(
            Shapes(robot, hold(reaches), hold(find_balls(model, losses))),
            [model.pairs.names[i] for i in model.pairs.pair_of_shapes],
            *(float(gains.safety_distance), approach),
        )
        speeds = gains.speed_limits(model)[model.controlled]
        fastest = np.minimum(speeds, fastest_asked(model))
        limits = JointLimits(lower, upper, fastest, self.period, self.plant_step)
        self.limits = Limits(limits, approach)
        self.all: list[Constraint] = [self.limits, self.pairs]
        self.motors = self.ground = None
        efforts = gains.limits_of_efforts(model)
        if np.isfinite(efforts).any():
            self.motors = Motors(model, efforts, self.period, self.plant_step)
            self.all.append(self.motors)
        if gains.balance is not None:
            self.ground = Ground(model, self.T, self.period, gains.balance)
            self.all.append(self.ground)

    def compile(self, q: np.ndarray, v: np.ndarray) -> None:
        """Compiles what only some steps need, by such ones from a state (nv,), (nv,)
        that leave nothing behind."""
        state = self.state(q, v, Braking(), lambda T: np.ones(self.model.n))
        for each in self.all:
            each.begin(state)
            each.rows(state)
            each.examine(state, state.whole(state.nominal), True)

    @cached_property
    def among(self) -> MovingSpheres:
        """What keeps links from obstacles that move.

        Raises:
            ScenarioError: a parameter does not go with them.
        """
        return MovingSpheres(self.model, self._gains, self._approach, self.T)

    def state(
        self,
        q: np.ndarray,
        v: np.ndarray,
        before: Braking,
        make_nominal: Callable[[float], np.ndarray],
        **others: Any,
    ) -> State:
        """The state of a step, with the T that is best for it.

        T is that of the step before, or the next that will do; it grows only onto a
        braking path that every constraint finds safe. On the ground it is fixed, and
        among obstacles, but where it has yet to come there. A robot that did not do as
        it was told keeps T, too: over a shorter one the motors may not brake it.

        Args:
            q, v: (nv,), (nv,) positions and velocities, controlled joints first.
            before: of the step before.
            make_nominal, others: of `State`.
        """
        times = before.T or self.T, self.period, self.plant_step
        of = *times, make_nominal, before.known
        state = State(q, v, self.model.n, *of, **others)
        T, known = before.T, before.known
        if self.ground is not None or (T == self.T and before.regions is not None):
            state.take_T(self.T, known and T == self.T)
            return state
        if self.motors is None and T >= self.T:
            return state

        def is_safe(longer: float) -> bool:
            at = q, v, longer
            return self.limits.is_safe(*at, before.T) and all(
                each.is_safe(*at) for each in self.all if each is not self.limits
            )

        if not T and is_safe(self.T):  # nothing was known
            T, known = self.T, True
        for longer in self._choices:
            if T < longer <= self.T:
                if not is_safe(longer):
                    break
                T, known = longer, True
        state.take_T(T or self.T, known)
        if self.motors is None or len(self._choices) == 1:
            return state
        T, among = state.T, before.regions is not None
        choices = [x for x in self._choices if x >= min(T, self.T)]
        if among and T > self.T:
            # To where it stays among obstacles, as soon as the motors can.
            choices = [self.T]
        elif among:
            choices = [x for x in choices if x <= self.T]
        chosen = self.motors.braking_time_constant(
            *(state, (state.whole(state.nominal) - state.v) / T),
            *(sorted({T, *choices}), is_safe),
        )
        if chosen != T:
            state.take_T(chosen, known or chosen > T)
        return state

    def step(self, state: State, before: Braking) -> Taken:
        """The step of a state of `state`, and what is known after the one before."""
        pairs, regions, constraints = self.pairs, before.regions, self.all
        if regions is not None:
            if state.T != self.T:  # over which alone anything is shown of obstacles
                regions = replace(regions, clear=np.zeros_like(regions.clear))
            self.among.place(regions)
            constraints = [*constraints, self.among]
        found = step(state, constraints)
        if regions is not None:
            unknown = state.T != self.T or (found.how == SCALED and found.share == 0.0)
            regions = regions.later(self.period, self.among.clear_after(unknown))
        clear = self.is_clear(state.q, pairs.present_is_clear, before.regions)
        clearance = float(found.clearances.get(pairs.name, pairs.least_kept))
        left = Braking(state.T, pairs.present_is_clear, regions)
        return Taken(found, clear, clearance, left)

    def is_clear(self, q: np.ndarray, known: bool, regions: Regions | None) -> bool:
        """Whether nothing is violated where a step began.

        Args:
            q: (nv,) positions, which are to be within the joint limits.
            known: whether its braking path is known to keep the safety distance.
            regions: where obstacles are taken to be; None without any.
        """
        clear = known and is_within(q, *self.limits.kept)
        return clear and (regions is None or bool(regions.clear.all()))
