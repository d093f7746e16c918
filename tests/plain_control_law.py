"""The control law once more, slowly and plainly: loops, Drake's own Jacobians, solves.

It shares nothing with `crar_drake.equations`, `crar_drake.robot.kinematics` or
`crar_drake.robot.collision_pairs`; of the model it takes names, indices and limits.
Jacobians are those of the witness points, inverse dynamics is the printed sum. Of the
paper's constraints, without blending.
"""

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule, GeometryId, QueryObject
from pydrake.multibody.tree import JacobianWrtVariable, RigidBody
from scipy.spatial.transform import Rotation

from crar_drake.judging.referee_distances import capsule_distance
from crar_drake.law.parameters import PaperParameters
from crar_drake.robot.description import find_body, find_frame
from crar_drake.robot.model import ControlModel

KV = JacobianWrtVariable.kV
LIMIT_CLAMP, DISTANCE_CLAMP = 1e-4, 1e-3


@dataclass
class PlainStep:
    """The results of a step, as in `control_law.Solution`."""

    actuation: np.ndarray
    acceleration: np.ndarray
    task_error: np.ndarray
    signed_distances: np.ndarray
    constraint_weights: np.ndarray
    constrained_velocity: np.ndarray


class PlainKinematics:
    """What Drake and the referee know of a model, one quantity and point at a time."""

    def __init__(self, model: ControlModel) -> None:
        self.model = model
        self.plant = model.plant
        self.context = model.plant.CreateDefaultContext()
        self.world = model.plant.world_frame()

    def distances(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Nc,) distances and (Nc, nv) gradients, Eq. (20), of the nearest shapes."""
        root = self.model.diagram.CreateDefaultContext()
        self.plant.SetPositions(self.plant.GetMyMutableContextFromRoot(root), q)
        self.plant.SetPositions(self.context, q)
        scene_graph = self.model.scene_graph
        query = scene_graph.get_query_output_port().Eval(
            scene_graph.GetMyContextFromRoot(root)
        )
        d, gradients = [], []
        for pair in self.model.description.pairs:
            a, b = (find_body(self.plant, name) for name in pair)
            distance, normal, p_a, p_b = min(
                (
                    self._nearest(query, of_a, of_b)
                    for of_a in self.plant.GetCollisionGeometriesForBody(a)
                    for of_b in self.plant.GetCollisionGeometriesForBody(b)
                ),
                key=lambda found: found[0],
            )
            d.append(distance)
            gradients.append(normal @ (self._jacobian(p_a, a) - self._jacobian(p_b, b)))
        return np.array(d), np.array(gradients)

    def _nearest(self, query: QueryObject, a: GeometryId, b: GeometryId) -> tuple:
        """The distance, the normal from b to a, and a point of each: SceneGraph's,
        unless the referee's are nearer by more than 0.1 mm."""
        found = query.ComputeSignedDistancePairClosestPoints(a, b)
        exact, *ends = capsule_distance(*self._axis(query, a), *self._axis(query, b))
        if found.distance > exact + 1e-4:
            normal = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
            return exact, normal, *ends
        p_a = query.GetPoseInWorld(found.id_A).multiply(found.p_ACa)
        p_b = query.GetPoseInWorld(found.id_B).multiply(found.p_BCb)
        if found.id_A == a:
            return found.distance, found.nhat_BA_W, p_a, p_b
        return found.distance, -found.nhat_BA_W, p_b, p_a

    @staticmethod
    def _axis(query: QueryObject, geometry: GeometryId) -> tuple:
        """Both ends of the axis of a capsule or sphere in W, and its radius."""
        shape = query.inspector().GetShape(geometry)
        half = 0.5 * shape.length() if isinstance(shape, Capsule) else 0.0
        ends = np.array([[0.0, 0.0], [0.0, 0.0], [-half, half]])
        return *query.GetPoseInWorld(geometry).multiply(ends).T, shape.radius()

    def _jacobian(self, p_W: np.ndarray, body: RigidBody) -> np.ndarray:
        """(3, nv) of the point of a link that is at p_W now."""
        frame = body.body_frame()
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

    def inertia(self, q: np.ndarray) -> np.ndarray:
        """(nv, nv) H."""
        self.plant.SetPositions(self.context, q)
        return self.plant.CalcMassMatrix(self.context)

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
        self, kinematics: PlainKinematics, parameters: PaperParameters
    ) -> None:
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

        H = self.kinematics.inertia(q)[np.ix_(c, c)]
        qddot, qdot_c, W = self._paper(q[c], v[c], J, v_r, a_r, d, dd_dv[:, c], H)
        vdot = np.zeros(len(v))
        vdot[c], vdot[p] = qddot, vdot_p
        self.memory["qdot_c"] = qdot_c
        torque = self.kinematics.torque(q, v, vdot)
        return PlainStep(torque, vdot, e, d, W, qdot_c)

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

    def _paper(self, q, qdot, J, v_r, a_r, d, dd_dq, H):
        gains = self.gains
        m, n = J.shape
        W = np.ones(n)
        if gains.constraints == "paper":
            W = self._composite_weight(q, d, dd_dq)
        W_inverse = np.diag(1.0 / W)
        if gains.metric == "inertia":
            weight = H / np.linalg.det(H) ** (1.0 / n) + np.diag(W - 1.0)
            W, W_inverse = np.diag(weight), np.linalg.inv(weight)
        core = J @ W_inverse @ J.T + gains.damping**2 * np.eye(m)
        J_star = W_inverse @ J.T @ np.linalg.inv(core)  # Eq. (34)
        qdot_c = J_star @ v_r  # Eq. (15)
        if gains.level == "velocity":
            before = self.memory.get("qdot_c", qdot_c)
            alpha = (qdot_c - before) / gains.period  # Eq. (10)
        else:
            zeta = gains.Gv * (qdot_c - qdot)  # Eq. (33)
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
