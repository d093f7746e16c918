"""The control law once more, slowly and plainly: loops, Drake's own Jacobians, solves.

It shares nothing with `crar_drake.equations`, `crar_drake.robot.kinematics` or
`crar_drake.robot.collision_pairs`; of the model it takes names, indices and limits.
Jacobians are those of the witness points, distances the referee's, inverse dynamics the
printed sum. The stages of the lookahead are least squares with slacks, its admission
samples. Without blending and lost targets, and with a nominal posture in the lookahead
alone.
"""

import math
from dataclasses import dataclass

import numpy as np
from one_sided_least_squares import one_sided_least_squares
from pydrake.geometry import Capsule
from pydrake.multibody.tree import JacobianWrtVariable
from scipy.spatial.transform import Rotation

from crar_drake.control.parameters import CrarParameters
from crar_drake.judging.referee_distances import capsule_distance
from crar_drake.robot.description import find_body, find_frame
from crar_drake.robot.model import ControlModel

KV = JacobianWrtVariable.kV
LIMIT_CLAMP, DISTANCE_CLAMP, SMALLEST_MARGIN = 1e-4, 1e-3, 1e-4
NOMINAL_SPEED_LIMIT = 16.0
FAR = 0.05  # [m] pairs whose balls are farther apart are not looked at


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
        self._shapes: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}
        names = {name for pair in model.description.pairs for name in pair}
        self._links = {name: self._shapes_of(name) for name in names}
        self.pair_of_shapes = np.array(
            [
                pair
                for pair, (a, b) in enumerate(model.description.pairs)
                for _ in self._axes(a)
                for _ in self._axes(b)
            ]
        )

    def distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Nc,) distances and (Nc, nv) gradients, Eq. (20), of the nearest shapes."""
        d, gradients = self.shape_distances(q)
        nearest = []
        for pair in range(len(self.model.description.pairs)):
            rows = np.flatnonzero(self.pair_of_shapes == pair)
            nearest.append(rows[np.argmin(d[rows])])
        return d[nearest], gradients[nearest]

    def shape_distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Ns,) distances and (Ns, nv) gradients of all pairs of shapes; kept per q."""
        key = q.tobytes()
        if key not in self._shapes:
            self.plant.SetPositions(self.context, q)
            d, gradients = [], []
            for a, b in self.model.description.pairs:
                for axis_a in self._axes(a):
                    for axis_b in self._axes(b):
                        distance, p_a, p_b = capsule_distance(*axis_a, *axis_b)
                        n = (p_a - p_b) / np.linalg.norm(p_a - p_b)
                        J = self._jacobian(a, p_a) - self._jacobian(b, p_b)
                        d.append(distance)
                        gradients.append(n @ J)
            self._shapes[key] = np.array(d), np.array(gradients)
        return self._shapes[key]

    def smallest_on_path(
        self, start: np.ndarray, end: np.ndarray, samples: int = 200
    ) -> tuple[np.ndarray, np.ndarray]:
        """(Ns,) the smallest sampled distance of each pair of shapes on the way from
        `start` to `end`, and by how much it changes at most from sample to sample.

        A pair that is farther apart than FAR counts as so far.
        """
        found = []
        for t in np.linspace(0.0, 1.0, samples):
            self.plant.SetPositions(self.context, start + t * (end - start))
            row = []
            known = {name: self._axes(name) for name in self._links}
            for a, b in self.model.description.pairs:
                for axis_a in known[a]:
                    for axis_b in known[b]:
                        row.append(self._near_distance(axis_a, axis_b))
            found.append(row)
        d = np.array(found)
        return d.min(axis=0), np.abs(np.diff(d, axis=0)).max(axis=0)

    @staticmethod
    def _near_distance(axis_a: tuple, axis_b: tuple) -> float:
        (a0, a1, radius_a), (b0, b1, radius_b) = axis_a, axis_b
        balls = math.dist(a0 + a1, b0 + b1) / 2.0
        balls -= (math.dist(a1, a0) + math.dist(b1, b0)) / 2.0
        if balls - radius_a - radius_b > FAR:
            return FAR
        return min(capsule_distance(*axis_a, *axis_b)[0], FAR)

    def _axes(self, name: str) -> list[tuple[np.ndarray, np.ndarray, float]]:
        """Per capsule or sphere of a link the ends of its axis in W, and its radius."""
        body, shapes = self._links[name]
        X_WB = self.plant.EvalBodyPoseInWorld(self.context, body)
        return [(*X_WB.multiply(ends).T, radius) for ends, radius in shapes]

    def _shapes_of(self, name: str) -> tuple:
        """A link, and per shape the ends (3, 2) of its axis in it, and its radius."""
        body = find_body(self.plant, name)
        inspector, found = self.model.scene_graph.model_inspector(), []
        for geometry in self.plant.GetCollisionGeometriesForBody(body):
            shape = inspector.GetShape(geometry)
            half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
            X_BG = inspector.GetPoseInFrame(geometry)
            ends = X_BG.multiply(np.array([[0.0, 0.0], [0.0, 0.0], [-half, half]]))
            found.append((ends, shape.radius()))
        return body, found

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

    def __init__(
        self,
        kinematics: PlainKinematics,
        parameters: CrarParameters,
        fastest: np.ndarray | None = None,
    ) -> None:
        """With the speed limits (nv,) of all joints, if there are any."""
        self.kinematics, self.gains = kinematics, parameters
        self.model = kinematics.model
        self.fastest = fastest
        if fastest is None:
            self.fastest = np.full(self.model.plant.num_velocities(), np.inf)
        self.memory: dict = {}

    def next_state(self, q, v, vdot) -> tuple[np.ndarray, np.ndarray]:
        """One control period on: the plant's own steps, or a parabola."""
        period, step = self.gains.period, self.model.plant.time_step()
        if not step:
            return q + period * v + period**2 / 2.0 * vdot, v + period * vdot
        steps = max(1, round(period / step))
        for _ in range(steps):
            v = v + period / steps * vdot
            q = q + period / steps * v
        return q, v

    def _rest(self, q) -> np.ndarray:
        """Joint by joint, of those that have limits on both sides."""
        plant, wanted = self.model.plant, np.array(q)
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            if joint.num_positions() != 1:
                continue
            limits = (*joint.position_lower_limits(), *joint.position_upper_limits())
            if np.isfinite(limits).all():
                rest = self.model.description.rest_posture.get(joint.name(), 0.0)
                wanted[joint.position_start()] = rest
        return wanted[self.model.controlled]

    def step(self, q, v, desired, prescribed, nominal=None) -> PlainStep:
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
            k = gains.posture_gain
            if nominal is None:
                nominal = self._rest(q)
            posture = k * (nominal - q[c]) - 2.0 * np.sqrt(k) * v[c]
            qddot, qdot_c, W, margins = self._lookahead(
                q, v, J, v_r, a_r, vdot_p, posture
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

    # --- constraints "lookahead", docs/theory/theorem.md
    # -------------------------------

    def _lookahead(self, q, v, J, v_r, a_r, vdot_p, posture):
        model, gains, ahead = self.model, self.gains, self.gains.lookahead
        c, p, T = model.controlled, model.prescribed, gains.braking_horizon
        qdot, s_p = v[c], v[p] + T * vdot_p
        slip = self._slip(qdot)
        here = self.kinematics.shape_distances(q)
        there = self.kinematics.shape_distances(q + T * v)  # L1

        constraints = []  # g, drift, weight, retreat
        smallest = np.inf
        last_weighed, weighed = self.memory.get("weighed", {}), {}
        self.memory["weighed"] = weighed
        for pair, (d, gradient, d_there, gradient_there) in enumerate(
            zip(*here, *there, strict=True)
        ):
            smallest = min(smallest, d_there)
            curvature = (gradient_there - gradient) @ v  # of L4's rate, by the secant
            for told, h, by_joint, more in (
                ("L4", d + T * gradient @ v, gradient, curvature),
                ("L3", d_there, gradient_there, 0.0),
            ):
                h_w = h
                if (pair, told) in last_weighed:
                    grown = max(last_weighed[pair, told], ahead.distance_margin)
                    h_w = min(h, grown + ahead.retreat_speed * gains.period)
                weighed[pair, told] = h_w
                if h >= ahead.influence_distance:
                    continue
                g = by_joint[c]
                eta = max(h_w - ahead.distance_margin, SMALLEST_MARGIN)
                weight = ahead.rho * np.exp(-gains.alpha * eta) * eta**-gains.beta
                weight *= gains.beta / eta + gains.alpha  # L5
                short = max(ahead.distance_margin - h, 0.0)
                retreat = min(ahead.retreat_rate * short, ahead.retreat_speed)
                drift = by_joint[p] @ s_p + more + min(g @ slip, 0.0)
                constraints.append((g, drift, weight, retreat))
        nearest_limit = np.inf
        for i in range(model.n):
            lower, upper = model.lower[i], model.upper[i]
            q_s = q[c][i] + T * qdot[i]
            first = lower if np.isfinite(lower) else upper - 2.0 * np.pi
            last = upper if np.isfinite(upper) else lower + 2.0 * np.pi
            for limit, inward in ((lower, 1.0), (upper, -1.0)):
                if not np.isfinite(limit):
                    continue
                h = inward * (q_s - limit)
                g = np.zeros(model.n)
                g[i] = inward
                h_w = h
                if (i, inward) in last_weighed:
                    grown = max(last_weighed[i, inward], 0.0)
                    h_w = min(h, grown + ahead.joint_retreat_speed * gains.period)
                weighed[i, inward] = h_w
                at = limit + inward * h_w
                at = min(max(at, first + LIMIT_CLAMP), last - LIMIT_CLAMP)
                slope = (last - first) ** 2 * (2.0 * at - last - first)
                slope /= 4.0 * (last - at) ** 2 * (at - first) ** 2  # Eq. (17)
                weight = ahead.rho_limits * max(-inward * slope, 0.0)
                short = max(ahead.limit_margin - h, 0.0)
                retreat = min(ahead.retreat_rate * short, ahead.joint_retreat_speed)
                constraints.append((g, min(g @ slip, 0.0), weight, retreat))
                nearest_limit = min(nearest_limit, h)
        g, drift, weight, retreat = (
            np.array(x) for x in zip(*constraints, strict=True)
        )
        root = np.sqrt(weight)

        # Stage 1, L6: residuals as printed.
        m, n = J.shape
        regular = np.vstack([J, gains.damping * np.eye(n)])
        rows = gains.damping * root[:, None] * g
        qdot_c, _ = one_sided_least_squares(
            regular,
            np.concatenate([v_r, np.zeros(n)]),
            rows,
            -gains.damping * root * drift,
        )
        z = gains.Gv * (qdot_c - qdot)
        pull = z + posture if m < n else np.zeros(n)
        rate = g @ (qdot + T * z) + drift  # of h, without alpha
        alpha, active = one_sided_least_squares(
            regular,
            np.concatenate([a_r, gains.damping * pull]),
            rows,
            -gains.damping * root * rate / T,
        )
        W = 1.0 + (weight[active, None] * g[active] ** 2).sum(axis=0)
        s = qdot + T * (alpha + z)
        s = s / max(1.0, np.abs(s).max() / NOMINAL_SPEED_LIMIT)
        # Stage 2, L7.
        s, _ = one_sided_least_squares(
            np.eye(n), s, root[:, None] * g, root * (retreat - drift)
        )
        s = self._within_limits(q[c], qdot, s)
        return (s - qdot) / T, qdot_c, W, np.array([smallest, nearest_limit])

    def _within_limits(self, q, v, s):
        """A2: what a joint's s leads to is found by stepping, and is linear in s."""
        T, period = self.gains.braking_horizon, self.gains.period
        s = s.copy()
        for i in range(len(q)):

            def next_rest(s_i, i=i):
                q_next, v_next = self.next_state(q[i], v[i], (s_i - v[i]) / T)
                return np.array([q_next + T * v_next, v_next])

            base = next_rest(0.0)
            slope = next_rest(1.0) - base
            ends = (q[i], q[i] + T * v[i])
            fastest = self.fastest[self.model.controlled][i]
            fastest = max(fastest, abs(v[i]) * (1.0 - period / T))
            lowest = np.array([min(self.model.lower[i], *ends), -fastest])
            highest = np.array([max(self.model.upper[i], *ends), fastest])
            s[i] = max(s[i], min(((lowest - base) / slope).max(), 0.0))
            s[i] = min(s[i], max(((highest - base) / slope).min(), 0.0))
        return s

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
