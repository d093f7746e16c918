"""The control law whose arithmetic is compiled, in the place of `ControlLaw`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crar_drake.compiled.arithmetic import Gains, Robot, compiled_step
from crar_drake.compiled.distances import Shapes
from crar_drake.control_law import (
    STATUS_BLENDING,
    STATUS_TRACKING,
    UNLIMITED,
    ControlLaw,
    ControlStep,
    Memory,
    Solution,
    Targets,
    is_finite,
)
from crar_drake.equations.blending import smooth_step
from crar_drake.equations.composite_weight import composite_index
from crar_drake.equations.joint_limits import LimitPotential
from crar_drake.equations.lookahead import resting_configuration
from crar_drake.errors import ScenarioError
from crar_drake.parameters import CrarParameters
from crar_drake.robot import ControlModel, Workspace


class CompiledLaw(ControlLaw):
    """Answers as `ControlLaw` does, with Drake's calls between compiled functions.

    For position tasks, capsules and spheres, constraints "lookahead" or "paper" at the
    acceleration level, with the identity as metric, a constant Gv and no effort
    limits. What is not finite goes to `ControlLaw`, which brakes or complains. The
    answers are those of `ControlLaw` but for rounding (1e-9), and without Numba, too,
    slowly.
    """

    def __init__(
        self, model: ControlModel, parameters: CrarParameters | None = None
    ) -> None:
        """
        Raises:
            ScenarioError: a parameter is out of range, or the compiled arithmetic does
                not cover it or the model.
        """
        super().__init__(model, parameters)
        _check_scope(model, self.parameters)
        self.shapes = find_shapes(model)
        self._robot = find_robot(model)
        self._gains = find_gains(model, self.parameters)
        self._ahead = self.parameters.constraints == "lookahead"
        self._K = 2 if self._ahead else 1
        self._no_pairs = np.zeros((len(model.pairs), model.n))
        self._no_before = np.zeros((3, model.n))

    def solve(
        self,
        workspace: Workspace,
        memory: Memory,
        tick: int,
        time: float,
        q: np.ndarray,
        v: np.ndarray,
        targets: Targets,
    ) -> ControlStep:
        """As `ControlLaw.solve`."""
        model, gains = self.model, self.parameters
        X, ends, bias = self._ask_drake(workspace, q, v)
        start = memory
        if memory.start_time is None:
            p_start = self._task_positions(X)
            start = replace(
                memory, start_time=time, p_start=p_start, q_p_start=q[model.prescribed]
            )
        blend = smooth_step(time - start.start_time, gains.blend_time)
        starts = np.concatenate([start.p_start.ravel(), start.q_p_start])
        before, near_pair = self._before(memory, tick)
        vdot, error, d, W, qdot_c, command, margins, kept, pairs = compiled_step(
            X,
            ends,
            bias,
            q,
            v,
            targets.tasks,
            targets.prescribed,
            starts,
            blend,
            before,
            near_pair,
            self.shapes,
            self._robot,
            self._gains,
        )
        if not is_finite(vdot):
            return super().solve(workspace, memory, tick, time, q, v, targets)
        controlled = model.controlled
        solution = Solution(
            actuation=model.inverse_dynamics(workspace, vdot),
            acceleration=vdot,
            task_error=error,
            signed_distances=d,
            constraint_weights=W,
            position_command=command,
            constrained_velocity=qdot_c,
            resting_margins=margins,
            status=np.array([STATUS_TRACKING if blend[0] == 1.0 else STATUS_BLENDING]),
            torque_limit=UNLIMITED,
        )
        return ControlStep(
            solution,
            Memory(
                tick=tick,
                start_time=start.start_time,
                R_start=start.R_start,
                p_start=start.p_start,
                q_p_start=start.q_p_start,
                limit_proximity=None if self._ahead else kept,
                pair_proximity=None if self._ahead else pairs,
                qdot_c=qdot_c,
                qdot=v[controlled],
                qddot=vdot[controlled],
                slip=kept if self._ahead else None,
            ),
        )

    def _ask_drake(
        self, workspace: Workspace, q: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Poses (K, L, 3, 4), ends' Jacobians (K, ends, 6, nv) and bias (m,): the calls
        of `ControlModel.evaluate_with_ahead` and `evaluate`."""
        plant = self.model.plant
        here, ahead = workspace.plant_context, workspace.plant_context_ahead
        plant.SetPositionsAndVelocities(here, np.concatenate([q, v]))
        contexts = [here]
        if self._ahead:
            q_s = resting_configuration(q, v, self.parameters.braking_horizon)
            plant.SetPositions(ahead, q_s)
            contexts.append(ahead)
        poses, ends = self.model.kinematics.ask(contexts)
        # Of one layout always, lest the step be compiled for another.
        X = np.ascontiguousarray(np.concatenate(poses).reshape(self._K, -1, 3, 4))
        J = np.concatenate(ends).reshape(self._K, -1, 6, len(v))
        return X, np.ascontiguousarray(J), self.model.bias_accelerations(here)

    def _task_positions(self, X: np.ndarray) -> np.ndarray:
        """(tasks, 3) at the state [m]."""
        num_tasks = len(self.model.tasks)
        link, p_L = self._robot.link[:num_tasks], self._robot.p_L[:num_tasks]
        return np.einsum("tij,tj->ti", X[0, link], p_L)

    def _before(self, memory: Memory, tick: int) -> tuple[np.ndarray, np.ndarray]:
        """The step before, as `compiled_step` takes it."""
        if not self._ahead:
            if memory.limit_proximity is None:
                return self._no_before, self._no_pairs
            return memory.limit_proximity[None], memory.pair_proximity
        if memory.slip is None or tick != memory.tick + 1:
            return self._no_before, self._no_pairs
        before = np.empty_like(self._no_before)
        before[0] = memory.qdot + self.parameters.period * memory.qddot
        before[1], before[2] = memory.slip, 1.0
        return before, self._no_pairs


def find_shapes(model: ControlModel) -> Shapes:
    """The watched pairs of a model, for `distances`."""
    pairs, capsules = model.pairs, model.pairs.capsules
    N = len(pairs.gather) // 4
    # Of the rectangular table each shape pair is in one line, or repeated there.
    pair = np.empty(N, dtype=np.int64)
    for i, members in enumerate(pairs.shape_pairs):
        pair[members] = i
    return Shapes(
        axis_a=pairs.gather[:N],
        axis_b=pairs.gather[N : 2 * N],
        uu=capsules.uu,
        vv=capsules.vv,
        radii=capsules.radii,
        pair=pair,
        moves=model.pair_moves,
    )


def find_robot(model: ControlModel) -> Robot:
    """The rest of a model, for `compiled_step`."""
    kinematics = model.kinematics
    selection = kinematics.selection.T.reshape(len(kinematics.selection.T), -1, 4)
    link = np.abs(selection).sum(axis=2).argmax(axis=1)
    potential = LimitPotential(model.lower, model.upper)
    return Robot(
        link=link,
        p_L=selection[np.arange(len(link)), link],
        end_signs=np.ascontiguousarray(kinematics.end_signs[:, 0]),
        carried=np.array(
            [
                kinematics.carried_by(frame.body()).astype(float)
                for frame, _ in model.task_targets
            ]
        ),
        row_weights=model.row_weights,
        controlled=model.controlled,
        prescribed=model.prescribed,
        lower=model.lower,
        upper=model.upper,
        potential=np.array(
            [
                potential.lower,
                potential.upper,
                potential.first,
                potential.last,
                potential.factor,
            ]
        ),
    )


def find_gains(model: ControlModel, parameters: CrarParameters) -> Gains:
    """The parameters, for `compiled_step`."""
    ahead = parameters.lookahead
    share = parameters.limit_share
    numbers = Gains(
        period=parameters.period,
        K=parameters.K,
        Kp=parameters.Kp,
        Kv=parameters.velocity_gain,
        Gv=parameters.Gv,
        GvN=parameters.null_space_gain,
        damping=parameters.damping,
        rho=parameters.rho,
        alpha=parameters.alpha,
        beta=parameters.beta,
        limit_share=composite_index(len(model.pairs)) if share is None else share,
        T=parameters.braking_horizon,
        rho_ahead=ahead.rho,
        rho_limits=ahead.rho_limits,
        distance_margin=ahead.distance_margin,
        limit_margin=ahead.limit_margin,
        retreat_rate=ahead.retreat_rate,
        retreat_speed=ahead.retreat_speed,
        joint_retreat_speed=ahead.joint_retreat_speed,
        slip_share=min(1.0, parameters.period / ahead.slip_time_constant),
        influence=ahead.influence_distance,
    )
    return Gains(*map(float, numbers))  # an int would be another type to compile for


def _check_scope(model: ControlModel, parameters: CrarParameters) -> None:
    beyond = [
        (set(model.layout.kinds) != {"position"}, "tasks other than positions"),
        (model.pairs.needs_query, "shapes other than capsules and spheres"),
        (parameters.constraints == "none", "constraints none"),
        (parameters.level != "acceleration", "level velocity"),
        (parameters.metric != "identity", "metric inertia"),
        (parameters.Gv_near is not None, "Gv_near"),
        (parameters.nominal_posture_gain > 0.0, "nominal_posture_gain"),
        (parameters.respect_effort_limits, "respect_effort_limits"),
    ]
    found = [name for is_beyond, name in beyond if is_beyond]
    if found:
        raise ScenarioError(
            f"controller.arithmetic: compiled does not cover {', '.join(found)}; use "
            "numpy"
        )
