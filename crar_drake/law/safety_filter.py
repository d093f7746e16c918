"""A safety filter in joint space: any controller in front of it, no tasks.

What a policy, a planner or an inverse kinematics wants of the joints goes in, what the
robot may be told comes out: the wanted command itself wherever that is safe, to the
last bit. `law.step` has the step, `docs/theory/theorem.md` the proof,
`docs/guides/safety-filter.md` the use. `SafetyFilterSystem` is the same for diagrams.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from crar_drake.errors import InputError, ModelError, ScenarioError, nearest, tell
from crar_drake.law.constraints import Braking, RobotConstraints, Taken
from crar_drake.law.joint_command import JointCommand, all_finite
from crar_drake.law.motors import Motors
from crar_drake.law.obstacles import Obstacles
from crar_drake.law.parameters import (
    T_OF_COMMANDS,
    LookaheadParameters,
    SafetyParameters,
)
from crar_drake.law.spheres import MovingSpheres
from crar_drake.law.step import AS_NOMINAL, CORRECTED, SCALED, Constraint, State
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.model import ControlModel

# What a user may give for the joints: (n,) in the order of `joint_names`, or by name.
Joints = ArrayLike | Mapping[str, float]

NOMINAL, BRAKING, OBSTACLE = "nominal", "braking", MovingSpheres.name
HOW = {AS_NOMINAL: NOMINAL, CORRECTED: "corrected", SCALED: "scaled"}
CATCHING_UP, NO_NUMBER, NO_SENSE = "catching up", "no number", "no sense"
NOT_FOLLOWED = "tracking error"
_ROUNDING = 1e-9  # of a tracking error [rad or m]

# Other braking time constants are these times T: shorter ones where a robot moves so
# fast at the start that its path over T is not collision-free, longer ones for weak
# motors [1].
_OTHERS = (0.2, 0.34, 0.58, 1.6, 2.6, 4.2)


@dataclass(frozen=True, slots=True)
class FilterReport:
    """What became of a wanted command, and why.

    Attributes:
        how: "nominal": the command is the wanted one, to the last bit; "corrected":
            the nearest that is safe; "scaled": a share of that, towards braking;
            "braking": nothing usable was wanted, or the robot is elsewhere.
        share: of the corrected step that was taken, 1 unless scaled; 0 braking [1].
        why: what the wanted command ran into: "pair" (of links), "joint limit",
            "joint speed", "motor", "obstacle"; "catching up", where the command was
            held back before and returns to the wanted one; "no number", a NaN or
            infinity; "no sense", numbers so large that they overflow; "tracking
            error", where a joint is farther from its command than
            `SafetyParameters.tracking_error` says, or is measured as no number; "".
        pair: the two links that come too near, or hold the command back; or None.
        joint: the joint that `why` is about, or that binds besides; or None.
        clearance: no watched distance is smaller on the braking path from the command
            [m]; a bound from below. NaN while it brakes.
        clear: whether joints were within their limits, and the path that the step
            started with is known to be clear; False with a "tracking error".
        motor_use: the largest share of a motor's limit that the command takes, now or
            braking after it [1]; NaN without effort limits, and while it brakes.
        T: braking time constant over which the next state is safe [s].
        tracking_error: how far the measured joint is from the command before that is
            farthest, beyond what it may be [rad or m], NaN where nothing is measured;
        tracking_joint: which one, or None.
        obstacle: what the command, or what pairs and limits left of it, ran into: the
            obstacle's name or number, and the link; or None.
        obstacle_clearance: how far links stay from obstacles on the braking path from
            the command, less what these can come nearer while the links are faster than
            `SafetyParameters.contact_speed` [m]; a bound from below. NaN without
            obstacles, and while it brakes.
        too_fast: names of the obstacles that are where they could not be, had they kept
            the bound of their speed.
    """

    how: str
    share: float
    why: str
    pair: tuple[str, str] | None
    joint: str | None
    clearance: float
    clear: bool
    tracking_error: float
    tracking_joint: str | None
    obstacle: tuple[str, str] | None = None
    obstacle_clearance: float = np.nan
    too_fast: tuple[str, ...] = ()
    motor_use: float = np.nan
    T: float = np.nan

    @property
    def braking(self) -> bool:
        """Whether the robot brakes: nothing usable was wanted, or nothing is left."""
        return self.how == BRAKING or self.share == 0.0


@dataclass(frozen=True, slots=True)
class FilterCommand:
    """Where the robot is to be at the end of the period.

    Attributes:
        names: (n,) the joints, in the order of `SafetyFilter.joint_names`.
        q: (n,) positions [rad or m].
        v: (n,) velocities, (q - the command before) / period [rad/s or m/s].
        a: (n,) accelerations, held for the period [rad/s^2 or m/s^2].
        report: what became of the wanted command.
    """

    names: tuple[str, ...]
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    report: FilterReport

    @property
    def by_name(self) -> dict[str, float]:
        """Joint to position [rad or m]."""
        return dict(zip(self.names, self.q.tolist(), strict=True))


@dataclass(frozen=True, slots=True)
class FilterMemory:
    """What one step leaves to the next; never changed in place."""

    q: np.ndarray  # (n,) the command's positions [rad or m]
    v: np.ndarray  # (n,) and its velocities [rad/s or m/s]
    # (n,) the position that was wanted, None if none was
    desired: np.ndarray | None = None
    following: bool = False  # whether the command was the wanted one
    braking: Braking = Braking()  # what is known of its braking path
    command: FilterCommand | None = None  # all of it; None before the first step

    def __deepcopy__(self, memo: dict) -> FilterMemory:
        return self  # Drake copies states often; nothing here is ever changed.


class SafetyFilter:
    """Turns wanted joint commands into safe ones.

        filter = SafetyFilter("upper_body", period=0.02)
        command = filter(q_desired)      # or filter(v=...), filter(a=...)
        command.q, command.v, command.a, command.report

    Call it once a period. It runs on its own command: the state of a step is the
    command before, so that the theorem holds for the commands as it stands, whatever
    the robot does. It begins in the robot's rest posture, or where `reset` or the first
    `measured` says.

    The joints are all of the robot's that move, those that its description calls
    prescribed among them. A base that floats counts as fixed, since no joint moves it:
    links are kept off one another, and nothing off the ground.

    Attributes:
        model: kinematics and distances, without tasks.
        joint_names: (n,) the joints, in the plant's order: that of all vectors.
        parameters: of the law.
    """

    def __init__(
        self,
        robot: str | os.PathLike[str] | RobotDescription | ControlModel,
        period: float = 0.02,
        parameters: SafetyParameters | None = None,
        *,
        effort_limits: bool = False,
    ) -> None:
        """
        Args:
            robot: the name of a shipped or imported robot, the path of a robot.yaml or
                of its folder, a description, or a control model, whose plant and
                shapes then count (a post beside the robot, say): `MakeControlModel`.
            period: between two calls [s].
            parameters: margin, speeds, errors; by default `SafetyParameters()`.
            effort_limits: whether the torque of a command, by the model, stays within
                the motors' limits, and that of braking after it.

        Raises:
            ModelError: there is no such robot, or it cannot be controlled; or a control
                model's base floats.
            ScenarioError: a number is out of range, or what is given for one is not a
                number.

        Warns:
            CrarWarning: no pair of links is watched.
        """
        if not isinstance(period, Real):
            raise ScenarioError(f"filter.period: {period!r} is no number of seconds")
        parameters = SafetyParameters() if parameters is None else parameters
        if type(parameters) is not SafetyParameters:
            raise ScenarioError(
                f"filter: give SafetyParameters, not {type(parameters).__name__}"
            )
        gains = LookaheadParameters(
            period=period, effort_limits=effort_limits, **vars(parameters)
        )
        if gains.braking_time is None:
            gains = replace(gains, braking_time=T_OF_COMMANDS)
        with self._refusing():
            gains.check_safety()
        self.parameters = gains
        self.model = model = _joint_model(robot, effort_limits)
        if not model.pairs.names:
            line = "no pair of links is watched; name some, or take MakeControlModel"
            tell(f"robot {model.description.name}: {line}", strict=False)
        self._period = float(period)
        self.joint_names = tuple(model.joint_names)
        self._n = model.n
        self._at = {name: i for i, name in enumerate(self.joint_names)}
        T, approach = gains.T, gains.approach_of_commands()
        with self._refusing():
            self._robot = RobotConstraints(
                *(model, gains, approach, T),
                *([share * T for share in _OTHERS], self._period),
            )
        self.reset()

    @property
    def constraints(self) -> list[Constraint]:
        """Of a step; those of a user may be appended."""
        return self._robot.all

    @property
    def period(self) -> float:
        """Between two calls [s]; another one takes another filter."""
        return self._period

    def reset(self, q: Joints | None = None, v: Joints | None = None) -> None:
        """Begins anew.

        Args:
            q: (n,) where the robot is [rad or m], or by name, the others at rest; by
                default the rest posture.
            v: (n,) how fast it moves [rad/s or m/s], or by name; by default not at all.

        Raises:
            InputError: a size is wrong, a joint unknown or a number none.
        """
        self._memory = self.start(q, v)
        self._started = q is not None

    def start(self, q: Joints | None = None, v: Joints | None = None) -> FilterMemory:
        """The memory to begin with; as of `reset`."""
        still, rest = np.zeros(self._n), self.model.rest_positions()
        q = rest if q is None else self._vector("q", q, rest)
        v = still if v is None else self._vector("v", v, still)
        for name, value in (("q", q), ("v", v)):
            bad = np.flatnonzero(~np.isfinite(value))
            if len(bad):
                joints = ", ".join(self.joint_names[i] for i in bad[:8])
                raise InputError(
                    f"the start's {name} has a NaN or infinite value, of {joints}"
                )
        return FilterMemory(q, v)

    def __call__(
        self,
        q: Joints | None = None,
        v: Joints | None = None,
        a: Joints | None = None,
        *,
        measured: tuple[Joints, Joints] | None = None,
        obstacles: Obstacles | None = None,
    ) -> FilterCommand:
        """The command for the end of this period. Give `q`, `v`, `a`, or `q` and `v`.

        Each is (n,) in the order of `joint_names`, or by name; of joints that are not
        named the position stays the one wanted last, velocity and acceleration are 0.
        A NaN or infinity among them makes the robot brake.

        Args:
            q: wanted positions at the end of the period [rad or m].
            v: wanted velocities [rad/s or m/s]; beside q only where the wanted
                motion is going, which helps where it cannot be had as it is.
            a: wanted accelerations [rad/s^2 or m/s^2].
            measured: positions and velocities of the robot now. At the first call the
                filter starts there; later the robot brakes while it is farther from the
                command before than a stated `tracking_error`, or at NaN.
            obstacles: that move by themselves, where they are now; they replace all
                before. Where none are given, those before may be anywhere that their
                speeds let them be since.

        Raises:
            InputError: a size is wrong, a joint unknown, or nothing or too much is
                wanted; or the filter is to start from a NaN.
        """
        if measured is not None and not self._started:
            self.reset(*self._measured(measured))
        self._started = True
        self._memory = self.solve(self._memory, q, v, a, measured, obstacles)
        return self._memory.command

    def compile(self, obstacles: bool = False) -> None:
        """Compiles what has yet to be, by steps that leave nothing behind.

        Args:
            obstacles: whether there will be any.
        """
        memory, rest = self.start(), self.model.rest_positions()
        self.solve(memory, rest)
        if obstacles:
            around = Obstacles(np.zeros((1, 3)), 1.0, 1.0, ("all",))
            memory = self.solve(memory, rest + 0.1, obstacles=around)
            self.solve(memory, rest + 0.2)

    @property
    def links(self) -> tuple[str, ...]:
        """The links that are kept from obstacles: those of watched pairs that move, and
        have capsules or spheres."""
        return self.among.links

    def solve(
        self,
        memory: FilterMemory,
        q: Joints | None = None,
        v: Joints | None = None,
        a: Joints | None = None,
        measured: tuple[Joints, Joints] | None = None,
        obstacles: Obstacles | None = None,
    ) -> FilterMemory:
        """One step without side effects, for a loop that keeps the memory itself.

        Args:
            memory: of the step before; `start()` before the first.
            q, v, a, measured, obstacles: as of a call; nothing starts from `measured`
                here.

        Returns:
            What the next step is to be given, with the `command`.
        """
        error, worst, follows = self._tracking(memory, measured)
        before = memory.braking
        if obstacles is not None:
            given = before.regions, obstacles, memory.q, memory.v
            before = replace(before, regions=self.among.regions(*given))
        desired = self._desired(memory, q, v, a)
        if not follows:
            return self._brake(memory, before, NOT_FOLLOWED, error, worst)
        if not desired.is_finite():
            return self._brake(memory, before, NO_NUMBER, error, worst)

        def nominal(T: float) -> np.ndarray:
            at, fastest = (memory.q, memory.v, memory.desired), self._robot.fastest
            return desired.nominal(*at, T, self._period, fastest)

        state = self._robot.state(memory.q, memory.v, before, nominal)
        q_next, v_next, s = desired.step(memory.q, memory.v, state.T, self._period)
        if not all_finite(s):
            return self._brake(memory, before, NO_SENSE, error, worst)
        # Lest the robot leap, what was held back catches up no faster than this.
        calm = memory.following or np.abs(s).max() <= self._robot.fastest
        state.desired = s if calm else None
        taken = self._robot.step(state, before)
        found = taken.step
        if found.how != AS_NOMINAL or found.s is not s:
            v_next = state.v + self._period * ((found.s - state.v) / state.T)
            q_next = state.q + self._period * v_next
        report = self._report(state, taken, s, calm, before, error, worst)
        command = FilterCommand(
            *(self.joint_names, q_next, v_next),
            *((v_next - state.v) / self._period, report),
        )
        # The command is the user's, who may change it.
        return FilterMemory(
            *(q_next.copy(), v_next.copy(), desired.q),
            *(report.how == NOMINAL, taken.braking, command),
        )

    def _report(
        self,
        state: State,
        taken: Taken,
        s: np.ndarray,
        calm: bool,
        before: Braking,
        error: float,
        worst: str | None,
    ) -> FilterReport:
        """What became of a desired step s (n,)."""
        of, regions, found = self._robot, before.regions, taken.step
        how = found.how if found.s is s else max(found.how, CORRECTED)
        why, joint, pair, objections = "", None, None, found.objections
        if of.pairs.name in objections:
            why, index = of.pairs.name, objections[of.pairs.name].index
            pair = of.pairs.names[index] if index >= 0 else None
        if how != AS_NOMINAL:
            # The nominal is within the bounds, the command may not have been.
            check = of.limits.examine(state, s, False)
            if not check.safe:
                why, joint = check.reason, check.index
            elif not why and not calm:
                why, joint = CATCHING_UP, int(np.argmax(np.abs(s)))
        for name, check in objections.items():
            if name not in (of.pairs.name, of.limits.name):
                why = check.reason or name
            if of.motors is not None and name == of.motors.name:
                joint = check.index
        obstacle, left, too_fast = None, np.nan, ()
        if regions is not None:
            obstacle, too_fast = self.among.ran_into(regions, found), regions.too_fast
            left = found.clearances.get(OBSTACLE, np.nan)
            if obstacle is not None and not why:
                why = OBSTACLE
        if how != AS_NOMINAL and not why:
            # Nothing is wrong with the command but what is violated already.
            why = of.pairs.name
            if of.pairs.present_is_clear:
                beyond = np.maximum(
                    of.limits.lower - state.q, state.q - of.limits.upper
                )
                why, joint = of.limits.name, int(np.argmax(beyond))
        joint = None if joint is None else self.joint_names[joint]
        return FilterReport(
            *(HOW[how], float(found.share), why, pair, joint),
            *(taken.clearance, taken.clear, error, worst),
            *(obstacle, left, too_fast),
            motor_use=1.0 - found.clearances.get(Motors.name, np.nan),
            T=state.T,
        )

    @property
    def among(self) -> MovingSpheres:
        """What keeps links from obstacles.

        Raises:
            ScenarioError: a parameter does not go with them.
        """
        with self._refusing():
            return self._robot.among

    @contextmanager
    def _refusing(self) -> Iterator[None]:
        """Calls parameters by where a user gives them, in errors."""
        try:
            yield
        except ScenarioError as error:
            text = str(error).replace("controller.", "filter.")
            raise ScenarioError(text) from None

    def _desired(self, memory: FilterMemory, q, v, a) -> JointCommand:
        """What is desired, as vectors."""
        n = self._n
        if (q is None and v is None and a is None) or (
            a is not None and (q is not None or v is not None)
        ):
            raise InputError(
                "give wanted positions q (with velocities v, or without), velocities "
                "v, or accelerations a"
            )
        if a is not None:
            return JointCommand(a=self._vector("a", a, np.zeros(n)))
        if v is not None:
            v = self._vector("v", v, np.zeros(n))
        if q is not None:
            q = self._vector(
                "q", q, memory.q if memory.desired is None else memory.desired
            )
        return JointCommand(q, v)

    def _vector(self, name: str, value: Joints, others: np.ndarray) -> np.ndarray:
        """(n,) of a vector or of what is given by name; raises InputError."""
        if isinstance(value, Mapping):
            vector = others.copy()
            for joint, number in value.items():
                if joint not in self._at:
                    raise InputError(
                        f"{name}: the robot has no joint {joint!r} that moves"
                        f"{nearest(str(joint), self.joint_names)}"
                    )
                try:
                    vector[self._at[joint]] = float(number)
                except (TypeError, ValueError):
                    raise InputError(
                        f"{name}: {number!r} of joint {joint!r} is no number"
                    ) from None
            return vector
        # Copied, since what may not be written to is compiled for anew.
        try:
            vector = np.array(value, dtype=float, order="C")
        except (TypeError, ValueError):
            raise InputError(f"{name} is not a vector of numbers") from None
        if vector.shape != (self._n,):
            raise InputError(
                f"{name} has shape {vector.shape}; it must be ({self._n},), in the "
                "order of joint_names"
            )
        return vector

    def _measured(self, measured: tuple[Joints, Joints]) -> list[np.ndarray]:
        """(n,) positions and (n,) velocities; raises InputError."""
        if len(measured) != 2:
            raise InputError("measured: give (q, v), positions and velocities")
        names = ("measured q", "measured v")
        others = self.model.rest_positions(), np.zeros(self._n)
        return list(map(self._vector, names, measured, others))

    def _tracking(
        self, memory: FilterMemory, measured: tuple[Joints, Joints] | None
    ) -> tuple[float, str | None, bool]:
        """How far which joint is from the command before, and whether it may be."""
        if measured is None:
            return np.nan, None, True
        error = np.abs(self._measured(measured)[0] - memory.q)
        stated = self._robot.errors
        worst = int(np.argmax(error - stated))  # the first NaN, if there is one
        most = stated[worst] + _ROUNDING if stated.any() else np.inf
        return float(error[worst]), self.joint_names[worst], bool(error[worst] <= most)

    def _brake(
        self,
        memory: FilterMemory,
        before: Braking,
        why: str,
        error: float,
        worst: str | None,
    ) -> FilterMemory:
        """q_ddot = -q_dot / T: a part of the present braking path."""
        still = np.zeros(self._n)
        state = self._robot.state(memory.q, memory.v, before, lambda T: still)
        vdot = -memory.v / state.T
        v = memory.v + self._period * vdot
        q = memory.q + self._period * v
        regions, too_fast = before.regions, ()
        lost = worst if why == NOT_FOLLOWED else None
        clear = lost is None and self._robot.is_clear(state.q, state.known, regions)
        if regions is not None:
            too_fast, regions = regions.too_fast, regions.later(self._period)
        report = FilterReport(
            *(BRAKING, 0.0, why, None, lost, np.nan, clear, error, worst),
            too_fast=too_fast,
            T=state.T,
        )
        command = FilterCommand(self.joint_names, q, v, vdot, report)
        braking = Braking(state.T, state.known, regions)
        return FilterMemory(q.copy(), v.copy(), None, False, braking, command)


def _joint_model(
    robot: str | os.PathLike[str] | RobotDescription | ControlModel,
    effort_limits: bool,
) -> ControlModel:
    """A model whose joints are all controlled, without tasks."""
    if isinstance(robot, ControlModel):
        if robot.description.root != "fixed":
            raise ModelError(
                f"robot {robot.description.name}: the base of this model floats, and "
                "no joint moves it; give the filter the robot's name or description, "
                "of which it welds the base"
            )
        if not robot.n_p and not robot.tasks:
            return robot
        description = replace(robot.description, prescribed_joints={})
        parts = robot.diagram, robot.plant, robot.scene_graph
        return ControlModel(*parts, description, [])
    description = robot
    if not isinstance(robot, RobotDescription):
        description = load_robot_description(robot)
    if description.root != "fixed":
        if effort_limits:
            raise ScenarioError(
                f"filter.effort_limits: the base of robot {description.name} floats, "
                "and what its motors do does not follow from a fixed one: leave them "
                "out, or give a robot whose base is fixed"
            )
        description = replace(description.without_ground(), root="fixed")
    description = replace(description, prescribed_joints={})
    return ControlModel.FromDescription(description, [])
