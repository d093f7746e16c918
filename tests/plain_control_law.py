"""The control law once more, slowly and plainly: loops, Drake's own Jacobians, solves.

It shares nothing with `crar_drake.equations`, `crar_drake.robot.kinematics` or
`crar_drake.robot.collision_pairs`; of the model it takes names, indices and limits.
Jacobians are those of the witness points, distances the referee's, inverse dynamics the
printed sum. Without blending, nominal posture and lost targets.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule
from pydrake.multibody.tree import JacobianWrtVariable
from scipy.spatial.transform import Rotation

from crar_drake.control.parameters import CrarParameters
from crar_drake.results.referee import capsule_distance
from crar_drake.robot.description import find_body, find_frame
from crar_drake.robot.model import ControlModel

KV = JacobianWrtVariable.kV
LIMIT_CLAMP, DISTANCE_CLAMP, SMALLEST_MARGIN = 1e-4, 1e-3, 1e-4


@dataclass
class PlainStep:
    """The results of a step, as in `control_law.Solution`."""

    actuation: np.ndarray
    acceleration: np.ndarray
    task_error: np.ndarray
    signed_distances: np.ndarray
    constraint_weights: np.ndarray
    constrained_velocity: np.ndarray
    resting_margins: np.ndarray


class PlainKinematics:
    """What Drake and the referee know of a model, one quantity and point at a time."""

    def __init__(self, model: ControlModel) -> None:
        self.model = model
        self.plant = model.plant
        self.context = model.plant.CreateDefaultContext()
        self.world = model.plant.world_frame()
        self._distances: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Nc,) distances and (Nc, nv) gradients, Eq. (20); kept per q."""
        key = q.tobytes()
        if key not in self._distances:
            self.plant.SetPositions(self.context, q)
            pairs = [self._distance(a, b) for a, b in self.model.description.pairs]
            self._distances[key] = (
                np.array([d for d, _ in pairs]),
                np.array([gradient for _, gradient in pairs]),
            )
        return self._distances[key]

    def _distance(self, a: str, b: str) -> tuple[float, np.ndarray]:
        best = None
        for axis_a in self._axes(a):
            for axis_b in self._axes(b):
                d, p_a, p_b = capsule_distance(*axis_a, *axis_b)
                if best is None or d < best[0]:
                    best = d, p_a, p_b
        d, p_a, p_b = best
        normal = (p_a - p_b) / np.linalg.norm(p_a - p_b)
        return d, normal @ (self._jacobian(a, p_a) - self._jacobian(b, p_b))

    def _axes(self, name: str) -> list[tuple[np.ndarray, np.ndarray, float]]:
        """Per capsule or sphere of a link the ends of its axis in W, and its radius."""
        body = find_body(self.plant, name)
        inspector = self.model.scene_graph.model_inspector()
        X_WB = self.plant.EvalBodyPoseInWorld(self.context, body)
        axes = []
        for geometry in self.plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
            X_WG = X_WB.multiply(inspector.GetPoseInFrame(geometry))
            ends = [X_WG.multiply(np.array([0.0, 0.0, z])) for z in (-half, half)]
            axes.append((*ends, shape.radius()))
        return axes

    def _jacobian(self, name: str, p_W: np.ndarray) -> np.ndarray:
        """(3, nv) of the point of a link that is at p_W now."""
        frame = find_body(self.plant, name).body_frame()
        p_B = self.plant.CalcPointsPositions(self.context, self.world, p_W, frame)
        return self.plant.CalcJacobianTranslationalVelocity(
            self.context, KV, frame, p_B, self.world, self.world
        )

    def tasks(self, q: np.ndarray, v: np.ndarray) -> list[tuple]:
        """Per task R_WT, p_WT, J (6, nv) and bias (6,), angular above linear."""
        plant, context, W = self.plant, self.context, self.world
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        found = []
        for task in self.model.tasks:
            known = self.model.description.task_frames
            frame = find_frame(plant, known.get(task.frame, task.frame))
            p_FT = np.array(task.point)
            R = frame.CalcRotationMatrixInWorld(context).matrix()
            p = plant.CalcPointsPositions(context, frame, p_FT, W)[:, 0]
            J = plant.CalcJacobianSpatialVelocity(context, KV, frame, p_FT, W, W)
            bias = plant.CalcBiasSpatialAcceleration(context, KV, frame, p_FT, W, W)
            found.append((R, p, J, bias.get_coeffs()))
        return found

    def torque(self, q: np.ndarray, v: np.ndarray, vdot: np.ndarray) -> np.ndarray:
        """Eqs. (2), (29): H vdot + C v - tau_g and the joints' damping."""
        plant, context = self.plant, self.context
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        damping = np.zeros(plant.num_velocities())
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            start = joint.velocity_start()
            damping[start : start + joint.num_velocities()] = (
                joint.default_damping_vector()
            )
        tau = (
            plant.CalcMassMatrix(context) @ vdot
            + plant.CalcBiasTerm(context)
            - plant.CalcGravityGeneralizedForces(context)
            + damping * (v + plant.time_step() * vdot)
        )
        return np.linalg.lstsq(plant.MakeActuationMatrix(), tau)[0]


class PlainControlLaw:
    """Like `ControlLaw`: call `step` once a control period."""

    def __init__(self, kinematics: PlainKinematics, parameters: CrarParameters) -> None:
        self.kinematics, self.gains = kinematics, parameters
        self.model = kinematics.model
        self.memory: dict = {}

    def step(self, q, v, desired, prescribed) -> PlainStep:
        model, gains = self.model, self.gains
        c, p = model.controlled, model.prescribed
        d, dd_dv = self.kinematics.distances(q)
        J, bias, weights, e, v_d, a_d = self._stack_tasks(q, v, desired)

        # Prescribed joints, Eq. (14).
        q_p, v_p, a_p = np.reshape(prescribed, (3, -1))
        vdot_p = a_p + gains.velocity_gain * (v_p - v[p]) + gains.Kp * (q_p - q[p])
        v_r = v_d + gains.K * e  # Eq. (9)
        a_r = a_d + gains.velocity_gain * (v_d - J @ v) + gains.Kp * e  # Eq. (14)
        S = np.diag(weights)
        v_r = S @ (v_r - J[:, p] @ v[p])
        a_r = S @ (a_r - J[:, p] @ vdot_p - bias)
        J = S @ J[:, c]

        margins = np.full(2, np.nan)
        if gains.constraints == "lookahead":
            qddot, qdot_c, W, margins = self._lookahead(
                q, v, J, v_r, a_r, d, dd_dv, vdot_p
            )
        else:
            qddot, qdot_c, W = self._paper(q[c], v[c], J, v_r, a_r, d, dd_dv[:, c])
        vdot = np.zeros(len(v))
        vdot[c], vdot[p] = qddot, vdot_p
        self.memory |= {"qdot": v[c], "qddot": qddot, "qdot_c": qdot_c}
        torque = self.kinematics.torque(q, v, vdot)
        return PlainStep(torque, vdot, e, d, W, qdot_c, margins)

    def _stack_tasks(self, q, v, desired):
        """J, bias, row weights, Eq. (11), v_d and a_d of all tasks' rows."""
        rows = {"J": [], "bias": [], "S": [], "e": []}
        entry = 0

        def add(J, bias, weight, e):
            rows["J"].append(J)
            rows["bias"].append(bias)
            rows["S"].append(np.full(3, weight))
            rows["e"].append(e)

        found = self.kinematics.tasks(q, v)
        for task, (R, p, J, bias) in zip(self.model.tasks, found, strict=True):
            if task.kind in ("orientation", "pose"):
                w, x, y, z = desired[entry : entry + 4]
                R_d = Rotation.from_quat([x, y, z, w]).as_matrix()
                e = sum(0.5 * np.cross(R[:, i], R_d[:, i]) for i in range(3))
                add(J[:3], bias[:3], task.orientation_weight, e)
                entry += 4
            if task.kind in ("position", "pose"):
                p_d = desired[entry : entry + 3]
                add(J[3:], bias[3:], task.position_weight, p_d - p)
                entry += 3
        J, bias, S, e = (np.concatenate(rows[name]) for name in ("J", "bias", "S", "e"))
        m = len(e)
        return J, bias, S, e, desired[entry : entry + m], desired[entry + m :]

    # --- constraints "none" and "paper" -------------------------------------------

    def _paper(self, q, qdot, J, v_r, a_r, d, dd_dq):
        gains = self.gains
        m, n = J.shape
        W = np.ones(n)
        if gains.constraints == "paper":
            W = self._composite_weight(q, d, dd_dq)
        W_inverse = np.diag(1.0 / W)
        core = J @ W_inverse @ J.T + gains.damping**2 * np.eye(m)
        J_star = W_inverse @ J.T @ np.linalg.inv(core)  # Eq. (34)
        qdot_c = J_star @ v_r  # Eq. (15)
        if gains.level == "velocity":
            before = self.memory.get("qdot_c", qdot_c)
            alpha = (qdot_c - before) / gains.period  # Eq. (10)
        else:
            zeta = gains.null_space_gain * (qdot_c - qdot)  # Eq. (33)
            alpha = J_star @ a_r
            if m < n:
                alpha = alpha + (np.eye(n) - J_star @ J) @ zeta  # Eq. (35)
        return alpha + gains.Gv * (qdot_c - qdot), qdot_c, W  # Eq. (30)

    def _composite_weight(self, q, d, dd_dq):
        """Eqs. (17)-(28)."""
        gains = self.gains
        n, Nc = len(q), len(d)
        W_JL, near_limit = np.ones(n), np.zeros(n)
        for i in range(n):
            gradient = self._limit_gradient(i, q[i])
            outside = abs(q[i] - self._clamped(i, q[i]))
            near_limit[i] = abs(gradient) * (1.0 + outside / LIMIT_CLAMP)
            if near_limit[i] >= self.memory.get("near_limit", near_limit)[i]:
                W_JL[i] += abs(gradient)
        W_COL, near_pair = np.zeros(n), np.zeros((Nc, n))
        for j in range(Nc):
            D = max(d[j], DISTANCE_CLAMP)
            slope = -gains.rho * np.exp(-gains.alpha * D) * D**-gains.beta
            slope *= gains.beta / D + gains.alpha
            for i in range(n):
                magnitude = abs(slope * dd_dq[j, i])
                near_pair[j, i] = magnitude * (1.0 + (D - d[j]) / DISTANCE_CLAMP)
                if d[j] > DISTANCE_CLAMP:
                    near_pair[j, i] = magnitude
                before = self.memory.get("near_pair", near_pair)[j, i]
                approaching = near_pair[j, i] >= before
                W_COL[i] += (1.0 + magnitude if approaching else 1.0) / Nc
        self.memory |= {"near_limit": near_limit, "near_pair": near_pair}
        a = 1.0 / (Nc + 1)
        return a * W_JL + (1.0 - a) * W_COL

    def _limit_gradient(self, i: int, q_i: float) -> float:
        """Eq. (17), at most LIMIT_CLAMP near a limit."""
        lower, upper = self.model.lower[i], self.model.upper[i]
        if not (np.isfinite(lower) and np.isfinite(upper)):
            return 0.0
        q_i = self._clamped(i, q_i)
        return (
            (upper - lower) ** 2
            * (2.0 * q_i - upper - lower)
            / (4.0 * (upper - q_i) ** 2 * (q_i - lower) ** 2)
        )

    def _clamped(self, i: int, q_i: float) -> float:
        lower, upper = self.model.lower[i], self.model.upper[i]
        if not (np.isfinite(lower) and np.isfinite(upper)):
            return q_i
        return min(max(q_i, lower + LIMIT_CLAMP), upper - LIMIT_CLAMP)

    # --- constraints "lookahead", docs/lookahead.md -------------------------------

    def _lookahead(self, q, v, J, v_r, a_r, d, dd_dv, vdot_p):
        model, gains, ahead = self.model, self.gains, self.gains.lookahead
        c, p, T = model.controlled, model.prescribed, gains.braking_horizon
        qdot, s_p = v[c], v[p] + T * vdot_p
        slip = self._slip(qdot)
        d_there, dd_dv_there = self.kinematics.distances(q + T * v)  # L1

        constraints = []  # h, g, drift, weight, retreat
        smallest = np.inf
        for distances, gradients, step in (
            (d, dd_dv, T),  # L4
            (d_there, dd_dv_there, 0.0),  # L3
        ):
            for d_j, gradient in zip(distances, gradients, strict=True):
                h, g = d_j + step * gradient @ v, gradient[c]
                smallest = min(smallest, h)
                if h >= ahead.influence_distance:
                    continue
                eta = max(h - ahead.distance_margin, SMALLEST_MARGIN)
                weight = ahead.rho * np.exp(-gains.alpha * eta) * eta**-gains.beta
                weight *= gains.beta / eta + gains.alpha  # L5
                short = max(ahead.distance_margin - h, 0.0)
                retreat = min(ahead.retreat_rate * short, ahead.retreat_speed)
                drift = gradient[p] @ s_p + min(g @ slip, 0.0)
                constraints.append((h, g, drift, weight, retreat))
        nearest_limit = np.inf
        for i in range(model.n):
            lower, upper = model.lower[i], model.upper[i]
            if not (np.isfinite(lower) and np.isfinite(upper)):
                continue
            q_s = q[c][i] + T * qdot[i]
            h = min(upper - q_s, q_s - lower)
            g = np.zeros(model.n)
            g[i] = 1.0 if q_s - lower < upper - q_s else -1.0
            weight = ahead.rho_limits * abs(self._limit_gradient(i, q_s))
            short = max(ahead.limit_margin - h, 0.0)
            retreat = min(ahead.retreat_rate * short, ahead.joint_retreat_speed)
            constraints.append((h, g, min(g @ slip, 0.0), weight, retreat))
            nearest_limit = min(nearest_limit, h)

        s_0, qdot_c, W = self._first_stage(J, v_r, a_r, qdot, constraints)
        s = self._guard(s_0, constraints)
        return (s - qdot) / T, qdot_c, W, np.array([smallest, nearest_limit])  # L8

    def _slip(self, qdot):
        """L9, through a low-pass."""
        gains, T = self.gains, self.gains.braking_horizon
        slip = np.zeros(len(qdot))
        if "slip" in self.memory:
            acceleration = (qdot - self.memory["qdot"]) / gains.period
            seen = T * (acceleration - self.memory["qddot"])
            share = min(1.0, gains.period / gains.lookahead.slip_time_constant)
            slip = (1.0 - share) * self.memory["slip"] + share * seen
        self.memory["slip"] = slip
        return slip

    def _first_stage(self, J, v_r, a_r, qdot, constraints):
        """L6 and the paper's law with it."""
        gains, T = self.gains, self.gains.braking_horizon
        m, n = J.shape
        damping2 = gains.damping**2
        active: set[int] = set()
        while True:
            W, pull = np.eye(n), np.zeros(n)
            for j in sorted(active):
                _, g, drift, weight, _ = constraints[j]
                W += weight * np.outer(g, g)
                pull += weight * drift * g
            M = J.T @ J + damping2 * W
            qdot_c = np.linalg.solve(M, J.T @ v_r - damping2 * pull)
            z = gains.Gv * (qdot_c - qdot)
            right = J.T @ a_r + (damping2 * z if m < n else 0.0)
            s_0 = qdot + T * (np.linalg.solve(M, right) + z)
            met = {
                j
                for j, (_, g, drift, _, _) in enumerate(constraints)
                if g @ s_0 + drift < 0.0
            }
            if met <= active:
                return s_0, qdot_c, W.diagonal()
            active |= met

    def _guard(self, s_0, constraints):
        """L7."""
        active: set[int] = set()
        s = s_0
        while True:
            exceeded = {
                j
                for j, (_, g, drift, _, retreat) in enumerate(constraints)
                if g @ s + drift < retreat
            }
            if exceeded <= active:
                return s
            active |= exceeded
            # Least squares of the stacked wishes, not their normal equations.
            A, b = [np.eye(len(s_0))], [s_0]
            for j in sorted(active):
                _, g, drift, weight, retreat = constraints[j]
                A.append(np.sqrt(weight) * g[None])
                b.append([np.sqrt(weight) * (retreat - drift)])
            s = np.linalg.lstsq(np.vstack(A), np.concatenate(b))[0]
