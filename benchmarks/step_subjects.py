"""One control step, the bound that it is compared with, and its parts, to be timed."""

from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace

import numpy as np
from pydrake.multibody.tree import Frame, JacobianWrtVariable, MultibodyForces
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import InputPort

from benchmarks.plain import as_it_is, plain
from benchmarks.step_timing import Stopwatch, Subject, replaced
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.capsule_distances import ShapePairs
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.free_joints import PLAIN
from crar_drake.equations.kinematics import (
    Measured,
    joint_motion,
    link_poses,
    place_points,
)
from crar_drake.equations.lookahead_rows import resting_configuration
from crar_drake.robot.description import find_frame
from crar_drake.robot.model import ControlModel
from crar_drake.run import RunResult

# The parts of a step that are timed, by what they do; the rest of it is OVERHEAD.
PARTS = ("Drake's calls", "law", "inverse dynamics")
OVERHEAD = "system overhead"

_ORIGIN = np.zeros(3)


@dataclass(frozen=True)
class Samples:
    """What the controller was given, and what it answered, in K consecutive steps.

    Attributes:
        q, v: (K, nq), (K, nv) states.
        tasks: (K, layout.size) desired tasks.
        prescribed: (K, 3 n_p) desired motion of the prescribed joints.
        vdot: (K, nv) accelerations that it commanded.
    """

    q: np.ndarray
    v: np.ndarray
    tasks: np.ndarray
    prescribed: np.ndarray
    vdot: np.ndarray

    def __len__(self) -> int:
        return len(self.q)


def samples_of_run(run: RunResult) -> Samples:
    """The control steps of a run whose log has a sample in each of them."""
    log, motion = run.log, run.setup.motion
    prescribed = np.zeros((len(log.time), 0))
    if motion.MakePrescribedSource is not None:
        source = motion.MakePrescribedSource()
        context = source.CreateDefaultContext()
        rows = []
        for time in log.time:
            context.SetTime(time)
            rows.append(source.get_output_port().Eval(context))
        prescribed = np.array(rows)
    return Samples(
        log.q, log.v, log.desired_tasks, prescribed, log.desired_acceleration
    )


def samples_with_poses(
    samples: Samples, model: ControlModel, parameters: CrarParameters
) -> Samples:
    """The same states, where the tasks of another model are asked what they do there.

    Args:
        samples: of a run.
        model: the same robot with other tasks.
        parameters: of the controller, whose answers the samples then hold.
    """
    workspace = model.MakeWorkspace()
    states = [
        model.evaluate(workspace, q, v)
        for q, v in zip(samples.q, samples.v, strict=True)
    ]
    velocities = np.array([state.v for state in states])
    accelerations = np.gradient(velocities, parameters.period, axis=0)
    tasks = np.array(
        [
            model.layout.pack(state.R, state.p, v, a)
            for state, v, a in zip(states, velocities, accelerations, strict=True)
        ]
    )
    law = ControlLaw(model, parameters)
    vdot = [
        law.step(*given).acceleration
        for given in zip(samples.q, samples.v, tasks, samples.prescribed, strict=True)
    ]
    return Samples(samples.q, samples.v, tasks, samples.prescribed, np.array(vdot))


class Step(Subject):
    """A control step as a simulator does it: the torque, then the controller's update.

    The controller alone, with the samples' states and targets at its input ports.
    The plant and the loggers, which a simulation has besides, are not there.
    """

    def __init__(
        self,
        model: ControlModel,
        parameters: CrarParameters,
        samples: Samples,
        package: SimpleNamespace | None = None,
    ) -> None:
        """
        Args:
            model, parameters: of the controller.
            samples: its inputs.
            package: of `benchmarks.plain`, that model and parameters are of.
        """
        self.controller = (package or as_it_is()).CrarController(model, parameters)
        self._samples = samples
        self._period = parameters.period
        self.restart()

    def restart(self) -> None:
        """Before the first step again."""
        context = self.controller.CreateDefaultContext()
        self._simulator = Simulator(self.controller, context)
        self._context = self._simulator.get_mutable_context()
        samples = self._samples
        self._inputs = [
            (self._fix(port), values)
            for port, values in (
                (
                    self.controller.get_input_port_estimated_state(),
                    np.hstack([samples.q, samples.v]),
                ),
                (self.controller.get_input_port_desired_tasks(), samples.tasks),
                (
                    self.controller.get_input_port_desired_prescribed(),
                    samples.prescribed,
                ),
            )
            if port is not None
        ]
        self._actuation = self.controller.get_output_port_actuation()
        self._next = 0
        self.torque = np.zeros(0)

    def prepare(self, k: int) -> None:
        if k != self._next:
            raise ValueError(f"step {k} does not follow on step {self._next - 1}")
        self._next += 1
        if k == 0:
            self._set_inputs(0)
            # Updates at the start wait for the first advance.
            self._simulator.Initialize()
        else:
            self._simulator.AdvanceTo(k * self._period)
            self._set_inputs(k)

    def __call__(self) -> None:
        self.torque = self._actuation.Eval(self._context)
        self._simulator.AdvancePendingEvents()

    def _set_inputs(self, k: int) -> None:
        for fixed, values in self._inputs:
            fixed.GetMutableData().get_mutable_value().SetFromVector(values[k])

    def _fix(self, port: InputPort):
        return port.FixValue(self._context, np.zeros(port.size()))


class StepInParts(Step):
    """The same, with a watch on what it consists of.

    Attributes:
        own: per part (K,) its time without the other parts' [s].
        calls: per part (K,) how often it was called.
    """

    def __init__(
        self, model: ControlModel, parameters: CrarParameters, samples: Samples
    ) -> None:
        super().__init__(model, parameters, samples)
        self._watch = Stopwatch()
        self._model = model
        self._k = 0
        self.own = {part: np.zeros(len(samples)) for part in PARTS}
        self.calls = {part: np.zeros(len(samples), dtype=int) for part in PARTS}

    def begin(self) -> None:
        timed = self._watch.timed
        model = self._model
        self._stack = ExitStack()
        self._stack.enter_context(
            replaced(
                [
                    (owner, name, partial(timed, part))
                    for owner, name, part in (
                        (self.controller.law, "solve", "law"),
                        (model, "measure", "Drake's calls"),
                        (model, "effort_per_acceleration", "Drake's calls"),
                        (model, "inverse_dynamics", "inverse dynamics"),
                    )
                ]
            )
        )

    def end(self) -> None:
        self._stack.close()

    def prepare(self, k: int) -> None:
        super().prepare(k)
        self._k = k
        self._watch.reset()

    def __call__(self) -> None:
        super().__call__()
        for part in PARTS:
            self.own[part][self._k] = self._watch.own.get(part, 0.0)
            self.calls[part][self._k] = self._watch.calls.get(part, 0)


@compiled
def what_distances_are_of(
    measured: Measured, robot: Held
) -> tuple[np.ndarray, np.ndarray, ShapePairs]:
    """Points, S and pairs, as `find_state` has them; holds a `Robot`."""
    r = robot.value
    tree = r.tree.value
    X = link_poses(measured.q, tree, tree.every)
    points = place_points(X, r.selection, r.first)
    return points, joint_motion(points[:, : 3 * len(r.order)]), r.pairs.value


def plain_distances(
    points: np.ndarray, asked: np.ndarray, S: np.ndarray, pairs: ShapePairs
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (20) and the distances before it, as plain NumPy computes them.

    Args:
        points, asked, pairs: of `nearest_of_pairs`.
        S: of `distance_gradient_about_origin`.
    """
    package = plain()
    d, normal, p_WA = package.nearest_of_pairs(points, asked, pairs)
    return d, package.distance_gradient_about_origin(normal, p_WA, S, pairs.moves)


class Bound(Subject):
    """A step's quantities as far as Drake has them, asked of Drake, and the distances.

    One call per quantity, each result an array: set the state; positions and
    spatial Jacobian of every link that carries a task or a watched shape (bodies
    that are welded together are one link, what is fixed to the world is none); a
    bias acceleration per task; force elements and inverse dynamics; within effort
    limits the mass matrix. Then distances and gradients, by the step's own functions
    as plain NumPy, with the step's own arguments. In the lookahead mode positions,
    Jacobians and distances also where the robot would come to rest.

    It bounds what a step takes that asks for all of this. Ours has kinematics of its
    own, so it may take less.
    """

    def __init__(
        self, model: ControlModel, parameters: CrarParameters, samples: Samples
    ) -> None:
        """Of the step with the same arguments."""
        self._model, self._samples = model, samples
        ahead = parameters.constraints == "lookahead"
        # Rows by pair, or by shapes.
        self._robot = model.robot_ahead if ahead else model.robot_by_pair
        self._horizon = parameters.braking_horizon if ahead else None
        self._with_mass_matrix = parameters.limits_efforts
        workspace = model.MakeWorkspace()
        self._workspace = workspace
        self._here, self._ahead = workspace.plant_context, workspace.plant_context_ahead
        self._forces = MultibodyForces(model.plant)
        known = model.description.task_frames
        self._tasks = [
            (
                find_frame(model.plant, known.get(task.frame, task.frame)),
                np.asarray(task.point, dtype=float),
                task.kind,
            )
            for task in model.tasks
        ]
        self._links = self._find_links()
        self.num_links = len(self._links)
        self.d = np.zeros(0)
        self.dd_dv = np.zeros(0)

    def prepare(self, k: int) -> None:
        samples, model, workspace = self._samples, self._model, self._workspace
        q, v = samples.q[k], samples.v[k]
        self._x = np.concatenate([q, v])
        self._vdot = samples.vdot[k]
        self._q_s = None
        if self._horizon is not None:
            self._q_s = resting_configuration(q, v, self._horizon, PLAIN)
        # What the step hands to the distances, from the step's own functions.
        measured = model.measure(workspace, q, v, self._q_s)
        points, S, pairs = what_distances_are_of(measured, self._robot)
        self._given = (points, measured.asked, S, pairs)
        # Setting the state that is there already would cost nothing.
        model.plant.SetPositionsAndVelocities(self._here, 0.0 * self._x)
        if self._q_s is not None:
            model.plant.SetPositions(self._ahead, 0.0 * q)

    def __call__(self) -> None:
        plant, here, forces = self._model.plant, self._here, self._forces
        plant.SetPositionsAndVelocities(here, self._x)
        self._links_at(here)
        W, kV = plant.world_frame(), JacobianWrtVariable.kV
        for frame, p_FT, kind in self._tasks:
            if kind == "position":
                plant.CalcBiasTranslationalAcceleration(here, kV, frame, p_FT, W, W)
            else:
                plant.CalcBiasSpatialAcceleration(
                    here, kV, frame, p_FT, W, W
                ).get_coeffs()
        if self._q_s is not None:
            plant.SetPositions(self._ahead, self._q_s)
            self._links_at(self._ahead)
        self.d, self.dd_dv = plain_distances(*self._given)
        plant.CalcForceElementsContribution(here, forces)
        plant.CalcInverseDynamics(here, self._vdot, forces)
        if self._with_mass_matrix:
            plant.CalcMassMatrix(here)

    def _links_at(self, context) -> None:
        plant = self._model.plant
        W, kV = plant.world_frame(), JacobianWrtVariable.kV
        for frame, points in self._links:
            plant.CalcPointsPositions(context, frame, points, W)
            plant.CalcJacobianSpatialVelocity(context, kV, frame, _ORIGIN, W, W)

    def _find_links(self) -> list[tuple[Frame, np.ndarray]]:
        """Each link's frame L and the points p_LP (3, P) on it."""
        plant, pairs = self._model.plant, self._model.pairs
        context = plant.CreateDefaultContext()
        placed = [(frame.body(), frame, p_FT) for frame, p_FT, _ in self._tasks]
        for body, axes in zip(pairs.bodies, pairs.axes, strict=True):
            for axis in axes:
                placed += [(body, body.body_frame(), p) for p in (axis.p_B0, axis.p_B1)]
        links: dict[int, tuple[Frame, list[np.ndarray]]] = {}
        for body, frame, p in placed:
            if plant.IsAnchored(body):
                continue
            first = min(plant.GetBodiesWeldedTo(body), key=lambda b: int(b.index()))
            link = links.setdefault(int(first.index()), (first.body_frame(), []))
            link[1].append(plant.CalcPointsPositions(context, frame, p, link[0])[:, 0])
        return [(frame, np.array(points).T) for frame, points in links.values()]
