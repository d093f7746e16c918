"""The controller as a Drake system."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
    ValueProducer,
)

from crar_drake.errors import InputError, few, tell
from crar_drake.law.control_law import ControlLaw, Memory
from crar_drake.law.measured import check_finite, is_finite
from crar_drake.law.obstacles import NO_PORT, Obstacles, checked_speeds
from crar_drake.law.parameters import LookaheadParameters, Parameters
from crar_drake.law.references import Targets
from crar_drake.law.solution import (
    GUARANTEED,
    PARTS,
    PROMISES,
    STATUS_IMPLAUSIBLE,
    Solution,
)
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.robot.model import ControlModel
from crar_drake.robot.workspace import Workspace

_NOTHING = np.zeros(0)

# Of a motor's limit: by so little more it is not beyond [1].
_ROUNDING = 1e-9
# A locked joint that is farther from its place does not count as locked [rad or m].
_LOCKED = 1e-3

# Parts that have a port of their own, and whether it shows what is held alone.
_CONNECTED = {
    "actuation": False,
    "desired_acceleration": True,
    "position_command": True,
}
_ATTRIBUTES = {name: name for name in PARTS} | {"desired_acceleration": "acceleration"}


@dataclass(slots=True)
class _Solve:
    """What is cached of a torque tick; a copy has contexts of its own."""

    # Here because each further cache entry costs a step as much as reading a port.
    workspace: Workspace
    memory: Memory


class CrarController(LeafSystem):
    """Constrained Resolved Acceleration Control of Dariush, Bin Hammam and Orin.

    The torque of Eq. (29) that makes the controlled joints accelerate by

        alpha_c = alpha + Gv (q_dot_c - q_dot)                           Eq. (30)

    with q_dot_c of Eq. (15) and alpha of Eq. (10) (level "velocity") or Eq. (35)
    (level "acceleration"), both through the damped pseudo-inverse of Eq. (34),
    weighted by the constraints.

                              ┌────────────────┐
        estimated_state ─────►│                ├──► actuation
        desired_tasks ───────►│                ├──► desired_acceleration
        desired_prescribed ──►│ CrarController ├──► position_command
        nominal_posture ─────►│                ├──► diagnostics
        obstacles (if any) ──►│                │
        locked_positions ────►│                │
                              └────────────────┘

    Notation: W the world frame; T a task's frame or point; q, v the plant's
    positions and velocities; n controlled and n_p prescribed joints, m task rows,
    Nc watched pairs.

    Input ports:
        estimated_state: (nq + nv,) [q; v] of the control model's plant.
        desired_tasks: (layout.size,) [x_d; v_d; a_d] in W, see `TaskLayout`.
        desired_prescribed: (3 n_p,) [q_p; q_dot_p; q_ddot_p], positions, velocities
            and accelerations of the joints `model.prescribed_names`, in that order
            [rad or m]; only if there are prescribed joints.
        nominal_posture: (n,) positions that the null space is drawn to [rad or m], the
            default posture of `ControlLaw` where nothing is connected; absent if
            `LookaheadParameters.posture_gain` is 0.
        obstacles: (4 N,) [x; y; z; radius] of each of N spheres that move by
            themselves, now, in W [m]. Only there if their speeds are given, and
            connected or not: where it is not, there are none. Constraints "lookahead"
            alone keep off them (`docs/theory/moving-obstacles.md`).
        locked_positions: (k,) measured positions of joints that the control model has
            locked, of a gripper that the robot carries [rad or m]; only if there are
            any. The part "promise" alone depends on them.

    Output ports:
        actuation: (nu,) efforts in the plant's actuator order [Nm or N], at the state
            of the present torque tick.
        desired_acceleration: (nv,) commanded accelerations of all joints, held for a
            control period.
        position_command: (nq + nv,) [q; v] one control period after the solve.
        diagnostics: actuation, desired_acceleration, position_command and the parts
            below one after the other; `diagnostics_slices` says where, and
            `diagnostics(context)` has them by name.

    Parts of diagnostics, see `Solution` for those that are not above:
        task_error (m,), signed_distances (Nc,) in the order of the description's pairs
            [m], constraint_weights (n,), status (1,), torque_limit (2,), admission
            (4,), balance (3,), T (1,).
        promise: (1,) 0 if watched pairs stay apart and joints within their limits, else
            what is missing, by its number; `diagnostics` has the word, "guaranteed" or
            another one of `law.solution.PROMISES`.

    The law is solved once a control period, at t = 0, period, 2 period, ..., on the
    state of that instant, and its accelerations are held until the next. What realises
    them, the inverse dynamics of Eq. (29), is computed anew at each torque tick, on the
    state of that instant, as often in a period as `Shared.torque_ticks` says: a
    torque that is held is not an acceleration that is held. Every control tick is a
    torque tick; there the law comes first, and its torque is that of the tick. In
    between only the torque changes, and NaN among the targets is not seen.

    There is no delay. Where the plant is discrete, its own update happens at the same
    instant as the controller's, so `actuation` and `diagnostics` then answer from the
    new state already; where it is continuous they change with the controller's update.
    `desired_acceleration` and `position_command` hold what the last update left, before
    the first one rest in the rest posture: no input is fed through to them, so that
    targets may be made of them. All state is in the Context: several simulators may run
    one diagram, and a clone of a context goes on as the original does.

    Attributes:
        law: the `ControlLaw` that the system wraps.
        model: the `ControlModel` that it computes with.
        border: the model's.
        diagnostics_slices: name of a part to its place in the port "diagnostics".

    Limits: joints with as many velocities as positions, all actuated, on a base that is
    fixed; the plant's torque is exact where its model is the control model's, time step
    included, and the acceleration is exactly held where each of its steps is a torque
    tick.
    """

    def __init__(
        self,
        model: ControlModel,
        parameters: Parameters | None = None,
        *,
        obstacle_speeds: Sequence[float] = (),
        strict: bool = False,
    ) -> None:
        """
        Args:
            model: the robot, its tasks and watched pairs; its plant is discrete if that
                which takes the torque is, with the same time step.
            parameters: gains and modes; by default `LookaheadParameters()`.
            obstacle_speeds: (N,) bounds of the speeds of obstacles [m/s].
            strict: whether a start inside a pair or beyond a limit, of which the first
                step warns (CrarWarning), is an error.

        Raises:
            ModelError: as of `ControlLaw`.
            ScenarioError: a parameter is out of range, or does not go with obstacles.
        """
        super().__init__()
        self.set_name("crar_controller")
        gains = parameters or LookaheadParameters()
        safe = isinstance(gains, LookaheadParameters)
        if obstacle_speeds and safe:
            gains = gains.among_obstacles()
        self.law, self._strict = ControlLaw(model, gains), strict
        self.border = model.border
        self._plant_step = model.plant.time_step()
        ticks = self.law.parameters.torque_ticks(self._plant_step)
        self._torque_ticks, self._torque_period = ticks

        self._nq, nv = model.plant.num_positions(), model.plant.num_velocities()
        self._locked = [] if self.border is None else [*self.border.locked.values()]
        self._speeds = checked_speeds(self.get_name(), obstacle_speeds)
        self._inputs = {
            name: self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("estimated_state", self._nq + nv),
                ("desired_tasks", model.layout.size),
                ("desired_prescribed", 3 * model.n_p),
                ("nominal_posture", model.n * self.law.has_posture),
                ("obstacles", 4 * len(self._speeds)),
                ("locked_positions", len(self._locked)),
            )
            if size
        }
        if len(self._speeds) and safe:
            self.law.among  # noqa: B018 (what does not go with them is refused now)

        nothing_yet, still = Memory(), np.zeros(nv)
        self._start = Solution(
            acceleration=still,
            task_error=_NOTHING,
            constraint_weights=_NOTHING,
            constrained_velocity=_NOTHING,
            position_command=np.concatenate((model.rest_positions(), still)),
        )
        held = self.DeclareAbstractState(AbstractValue.Make(nothing_yet))
        self._held_index = int(held)
        sources = {
            self.time_ticket(),
            self.all_input_ports_ticket(),
            self.abstract_state_ticket(held),
        }
        self._solve_cache = self.DeclareCacheEntry(
            "this torque tick",
            ValueProducer(
                allocate=lambda: AbstractValue.Make(
                    _Solve(model.MakeWorkspace(), nothing_yet)
                ),
                calc=self._CalcStep,
            ),
            sources,
        )
        period = self._torque_period
        if self._plant_step and period != self._plant_step:
            # k periods and the plant's steps up to then may differ by rounding. A
            # tick just before the plant's step sees the state that it starts from;
            # one just after it would see the next one, and solve again.
            period *= 1.0 - 4e-15
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Update)

        self._outputs, self.diagnostics_slices, end = {}, {}, 0
        for name, size_of in (PARTS | {"promise": lambda model: 1}).items():
            size = size_of(model)
            self.diagnostics_slices[name] = slice(end, end + size)
            end += size
            if name in _CONNECTED:
                tickets = sources
                if _CONNECTED[name]:
                    tickets = {self.abstract_state_ticket(held)}
                self._outputs[name] = self.DeclareVectorOutputPort(
                    name, size, self._MakeOutputCalc(name), tickets
                )
        self._outputs["diagnostics"] = self.DeclareVectorOutputPort(
            "diagnostics", end, self._CalcDiagnostics, sources
        )
        targets = "desired_tasks", "desired_prescribed", "nominal_posture"
        self.law.target_names = tuple(map(self._named, targets))

    @property
    def model(self) -> ControlModel:
        """The control model: joints, tasks and their layout, watched pairs."""
        return self.law.model

    def get_input_port_estimated_state(self) -> InputPort:
        """Port (nq + nv,): measured [q; v]."""
        return self._inputs["estimated_state"]

    def get_input_port_desired_tasks(self) -> InputPort:
        """Port (layout.size,): [x_d; v_d; a_d]."""
        return self._inputs["desired_tasks"]

    def get_input_port_desired_prescribed(self) -> InputPort:
        """Port (3 n_p,): [q_p; q_dot_p; q_ddot_p].

        Raises:
            InputError: no joint is prescribed.
        """
        return self._InputPort("desired_prescribed", "no joint is prescribed")

    def get_input_port_nominal_posture(self) -> InputPort:
        """Port (n,), may be left open.

        Raises:
            InputError: the law has none: the paper's, or one whose `posture_gain` is 0.
        """
        none = "the law draws to no posture: give LookaheadParameters(posture_gain=...)"
        return self._InputPort("nominal_posture", none)

    def get_input_port_obstacles(self) -> InputPort:
        """Port (4 N,), may be left open: [x; y; z; radius] of each obstacle now.

        Raises:
            InputError: the controller was made without `obstacle_speeds`.
        """
        return self._InputPort("obstacles", NO_PORT)

    def _InputPort(self, name: str, why_not: str) -> InputPort:
        if name not in self._inputs:
            raise InputError(f"{self.get_name()}: {why_not}")
        return self._inputs[name]

    def get_output_port_actuation(self) -> OutputPort:
        """Port (nu,): efforts [Nm or N]."""
        return self._outputs["actuation"]

    def get_output_port_desired_acceleration(self) -> OutputPort:
        """Port (nv,): commanded accelerations, held [rad/s^2 or m/s^2]."""
        return self._outputs["desired_acceleration"]

    def get_output_port_position_command(self) -> OutputPort:
        """Port (nq + nv,): [q; v] one control period on."""
        return self._outputs["position_command"]

    def get_output_port_diagnostics(self) -> OutputPort:
        """Port: all parts, placed as `diagnostics_slices` says."""
        return self._outputs["diagnostics"]

    def diagnostics(self, context: Context) -> dict[str, np.ndarray | str]:
        """The parts of the port `diagnostics` by name, see the class documentation.

        Args:
            context: the controller's own, `GetMyContextFromRoot` of a diagram's.
        """
        values = self._outputs["diagnostics"].Eval(context)
        parts = {name: values[at] for name, at in self.diagnostics_slices.items()}
        return parts | {"promise": PROMISES[int(parts["promise"][0])]}

    def obstacle(self, context: Context) -> tuple[str, str] | None:
        """The number of the obstacle that holds the robot back, and the link; None if
        none does.

        Args:
            context: as of `diagnostics`.
        """
        return self._EvalSolution(context).obstacle

    def __getattr__(self, name: str):
        # Found only where nothing has the name.
        part = name.removeprefix("get_output_port_")
        if part != name and part in self.__dict__.get("diagnostics_slices", {}):
            raise AttributeError(
                f"{part} has no port of its own: it is a part of the port diagnostics, "
                f'controller.diagnostics(context)["{part}"]'
            )
        raise AttributeError(f"CrarController has no attribute {name!r}")

    def _CalcDiagnostics(self, context: Context, output: BasicVector) -> None:
        solution = self._EvalSolution(context)
        parts = [getattr(solution, name) for name in _ATTRIBUTES.values()]
        promise = [self._Promise(context, solution)]
        output.SetFromVector(np.concatenate([*parts, promise]))

    def _Promise(self, context: Context, solution: Solution) -> float:
        """What is missing of the promise; the first of PROMISES that is."""
        off = np.abs(self._EvalPort("locked_positions", context) - self._locked)
        missing = (
            self.law.parameters.constraints != "lookahead",
            self.border is not None and bool(self.border.said),
            not (off <= _LOCKED).all(),
            solution.status[0] == STATUS_IMPLAUSIBLE,
            solution.admission[3] != 1.0,
            solution.torque_limit[1] > _ROUNDING,
        )
        return float(missing.index(True) + 1 if any(missing) else GUARANTEED)

    def _MakeOutputCalc(self, name: str):
        attribute = _ATTRIBUTES[name]

        def calc(context: Context, output: BasicVector) -> None:
            if _CONNECTED[name]:
                held = context.get_abstract_state(self._held_index).get_value()
                solution = held.solution or self._start
            else:
                solution = self._EvalSolution(context)
            output.SetFromVector(getattr(solution, attribute))

        return calc

    def _EvalSolution(self, context: Context) -> Solution:
        """The held solution, or that of a tick whose update has not come yet."""
        held = context.get_abstract_state(self._held_index).get_value()
        now, then = self._Tick(context.get_time()), (held.tick, held.torque_tick)
        newer = now > then and self._plant_step > 0.0
        # An older tick: the user set the time back.
        if held.solution is None or newer or now < then:
            return self._solve_cache.Eval(context).memory.solution
        return held.solution

    def _Update(self, context: Context, state: State) -> None:
        memory = self._solve_cache.Eval(context).memory
        state.get_mutable_abstract_state(self._held_index).set_value(memory)

    def _CalcStep(self, context: Context, value: AbstractValue) -> None:
        time = context.get_time()
        tick, torque_tick = self._Tick(time)
        held = context.get_abstract_state(self._held_index).get_value()
        x = self._EvalPort("estimated_state", context)
        if not is_finite(x):
            check_finite(self._named("estimated_state"), x, time)
        solve = value.get_value()
        workspace = solve.workspace
        q, v = x[: self._nq], x[self._nq :]
        same_period = held.solution is not None and tick == held.tick
        if same_period and torque_tick > held.torque_tick:
            solve.memory = self.law.hold(workspace, held, torque_tick, q, v)
            return
        memory = held if tick > held.tick else Memory()
        if memory.solution is None:
            self._tell_of_the_start(q)
        targets = Targets(
            self._EvalPort("desired_tasks", context),
            self._EvalPort("desired_prescribed", context),
            self._EvalPort("nominal_posture", context, may_be_open=True),
        )
        spheres = self._EvalPort("obstacles", context, may_be_open=True)
        obstacles = Obstacles.of_port(spheres, self._speeds) if len(spheres) else None
        solve.memory = self.law.solve(
            workspace, memory, tick, time, q, v, targets, obstacles
        )
        if torque_tick:
            # A run that begins between control ticks. The next one comes too early to
            # tell what the plant does in a period.
            solve.memory = replace(solve.memory, torque_tick=torque_tick, kept=None)

    def _tell_of_the_start(self, q: np.ndarray) -> None:
        """Warns of joints beyond their limits, and of pairs that are inside one another
        and are not so at rest."""
        model = self.model
        rest, wrong = model.rest_positions(), []
        here, there = (model.signed_distances(x) for x in (q, rest))
        for i in np.flatnonzero((here <= 0.0) & (there > 0.0)):
            a, b = model.pairs.names[i]
            wrong.append(f"{a} - {b} inside one another by {-1e3 * here[i]:.1f} mm")
        at = q[model.controlled_positions]
        beyond = np.maximum(model.lower - at, at - model.upper) > LIMIT_TOLERANCE
        wrong += [
            f"{model.joint_names[i]} beyond its limit" for i in beyond.nonzero()[0]
        ]
        if wrong:
            tell(
                f"robot {model.description.name} starts with {few(wrong, 4)}: nothing "
                "is promised of that until it has left",
                self._strict,
            )

    def _named(self, name: str) -> str:
        """What errors call an input port."""
        return f"input port {name} of {self.get_name()}"

    def _EvalPort(
        self, name: str, context: Context, may_be_open: bool = False
    ) -> np.ndarray:
        """The value of an input port; (0,) of one that is not there, or open and may
        be."""
        port = self._inputs.get(name)
        if port is None or (may_be_open and not port.HasValue(context)):
            return _NOTHING
        try:
            return port.Eval(context)
        except RuntimeError as error:
            if port.HasValue(context):
                raise
            raise InputError(f"{self._named(name)} is not connected") from error

    def _Tick(self, time: float) -> tuple[int, int]:
        """Number of the control tick, and of the torque tick since then."""
        # The time of a tick is a multiple of the period up to rounding.
        ticks = math.floor(time / self._torque_period + 1e-6)
        return divmod(ticks, self._torque_ticks)
