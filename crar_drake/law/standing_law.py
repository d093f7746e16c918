"""What the motors of a robot that stands must give, and the ground with them.

The upper body follows a command, and nothing but the ground carries the root. A small
least squares over the ground's forces decides what becomes of it. The forces act at the
corners of the soles, inside friction pyramids, and leave torques within the motors'
limits. Whatever forces come out, motion and torques fit them: Newton and Euler hold and
the soles stay. What the ground cannot give, the root does without.

The centre of mass c is brought back by feedback of its *capture point* c + c_dot / w,
w^2 = g / height, over which it would come to rest. With the centre of pressure moved by
(1 + k / w) times that point's error, errors decay as exp(-w t) and exp(-k t), and with
w among the rates the soles are asked for the least: J. Englsberger et al., "Bipedal
walking control based on capture point dynamics", IROS 2011. The rest is the usual
inverse dynamics with contacts, as of A. Herzog et al., "Momentum control with
hierarchical inverse dynamics on a torque-controlled humanoid", Autonomous Robots 2016.
"""

from typing import NamedTuple

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JacobianWrtVariable, MultibodyForces
from pydrake.systems.framework import Context

from crar_drake.errors import ModelError
from crar_drake.law.one_sided import one_sided_minimum
from crar_drake.law.vectors import cross_rows
from crar_drake.robot.actuators import Actuators
from crar_drake.robot.description import (
    RobotDescription,
    find_body,
    find_joint,
    find_root,
    zero_positions,
)
from crar_drake.robot.joints import names_by_joint
from crar_drake.robot.standing import leg_joints

GRAVITY = 9.81  # [m/s^2]

# The edges of a friction pyramid lean these ways: it is inside the friction cone.
_WAYS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])

# What weighs as much as 1 m/s^2 of the centre of mass: a force outside its cone, in
# shares of the weight, and a torque beyond its limit, in shares of that; and what the
# forces themselves weigh, by which they are even where nothing else says how.
_OUTSIDE = 100.0
_EVEN = 0.01

# Singular values s of the legs below this are damped, where a knee is nearly straight:
# s / (s^2 + m), m = _SINGULAR^2 - s^2, of Y. Nakamura and H. Hanafusa, "Inverse
# kinematic solutions with singularity robustness", J. Dyn. Sys. Meas. Control 1986.
_SINGULAR = 0.02

# A root that leans by more [rad], or is lower than this share of its height at rest,
# belongs to a robot that fell.
_LEANS = np.pi / 4.0
_LOW = 0.6
_LIMP = 20.0  # joints of such a robot come to rest at that rate [1/s]


# Decay of the capture point's error [1/s]. PD of errors [1/s^2] and their rates [1/s]:
_CAPTURE = 6.0
_TURN, _TURN_RATE = 150.0, 25.0  # of the root's orientation,
_HEIGHT, _HEIGHT_RATE = 150.0, 25.0  # and height,
# of joints that follow the command; stiff, for they have its `tracking_error` to spare
# before a limit,
_JOINT, _JOINT_RATE = 4000.0, 120.0
# of the soles' orientations; stiff, for feet are light, and one that carries little
# tips over by itself; and of their places.
_SOLE_TURN, _SOLE_TURN_RATE = 2500.0, 100.0
_SOLE, _SOLE_RATE = 400.0, 40.0
# Of c_dd in x and y, of the root's angular acceleration [m/rad], and of its vertical
# one, what each weighs where the ground cannot give all.
_WEIGHTS = np.array([1.0, 1.0, 0.1, 0.1, 0.1, 2.0])
# Each corner of the soles is pressed down with so much, so that feet that carry nothing
# stay on the floor [shares of the weight].
_LEAST_FORCE = 0.005
_FRICTION = 0.8  # of the friction, the share that is used
# Forces keep so much from the soles' edges, over which feet would tip [m]. Much less
# than balance keeps of the command's (`BalanceParameters`): the difference is what
# brings the robot back.
SOLE_MARGIN = 0.005


class StandingStep(NamedTuple):
    """What the standing law answers."""

    # (nu,) in the plant's actuator order, within the limits [Nm or N]
    efforts: np.ndarray
    acceleration: np.ndarray  # (nv,) that these and the forces make
    # (C, 3) of the ground at the corners of the soles, in the world [N]
    forces: np.ndarray
    clipped: float = 0.0  # what the limits took off an effort, at most [Nm or N]
    # whether the robot lies, or no forces are found for it: its joints are just braked
    fell: bool = False


class StandingLaw:
    """Joint torques of a robot on its soles whose upper body follows a command.

    Notation: W the world, z up; q, v of the plant; b the six velocities of its root, l
    the joints between root and soles, M, h of M a + h = S^T tau + J_c^T f, f the
    ground's forces at the soles' corners, J the soles' Jacobian, c the centre of mass.

    Legs keep the soles still, J_l a_l = -J_b a_b - bias - PD, and all other joints
    accelerate as commanded, plus PD. So the root's rows make a_b a function of f, and

        f = argmin |c_dd - c_dd*|^2 + |w (a_b - a_b*)|^2
            f inside its pyramids, |tau| <= limits,

    where c_dd* (x and y) is the command's, less the capture point's feedback, and a_b*
    PD of the root's orientation and height.

    Attributes:
        joint_names: (n,) joints of the command, in the order of their velocities.
        rest: (nq,) where it stands, the description's rest posture.
        corners_at_rest: per sole (V, 3) where its corners are there, in W [m].
        floor: height of the soles there [m].
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        description: RobotDescription,
        friction: float,
    ) -> None:
        """
        Args:
            plant: finalized, with the robot alone, whose root floats.
            description: of the robot, with soles.
            friction: of the ground.

        Raises:
            ModelError: the root does not float, a joint is not actuated, or a sole is
                not on a leg.
        """
        self.plant = plant
        root = find_root(plant, description)
        if root is None:
            raise ModelError(
                f"robot {description.name}: root: fixed: a robot that stands on its "
                "soles has a root that floats"
            )
        names = names_by_joint(plant)
        self._root = root.child_body()
        self._b = np.arange(root.velocity_start(), root.velocity_start() + 6)
        self._actuators = Actuators(plant, names, self._b)
        joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
        joints = [joint for joint in joints if joint.num_velocities() == 1]
        joints.sort(key=lambda joint: joint.velocity_start())
        self._j = np.array([joint.velocity_start() for joint in joints])
        self._j_q = np.array([joint.position_start() for joint in joints])
        self.joint_names = [names[i] for i in self._j]
        legs = {joint.velocity_start() for joint in leg_joints(plant, description)}
        self._l = np.array(sorted(legs))
        # A discrete plant has the damping of its joints at the end of the step.
        self._damping = np.zeros((plant.num_velocities(),) * 2)
        damping = [joint.default_damping_vector()[0] for joint in joints]
        self._damping[self._j, self._j] = plant.time_step() * np.array(damping)
        self._forces = MultibodyForces(plant)
        self._soles = [
            (find_body(plant, link).body_frame(), np.array(corners, dtype=float))
            for link, corners in description.soles.items()
        ]
        self._stiffness, self._rates = (
            np.tile(np.repeat(pair, 3), len(self._soles))
            for pair in ((_SOLE_TURN, _SOLE), (_SOLE_TURN_RATE, _SOLE_RATE))
        )
        friction *= _FRICTION
        self._edges = np.column_stack([friction * _WAYS, np.ones(len(_WAYS))])
        self._pressed = [_within(corners, SOLE_MARGIN) for _, corners in self._soles]
        context, q = plant.CreateDefaultContext(), zero_positions(plant)
        for name, value in description.rest_posture.items():
            q[find_joint(plant, name).position_start()] = value
        plant.SetPositions(context, q)
        plant.SetFreeBodyPose(context, self._root, description.rest_pose())
        self.rest = plant.GetPositions(context)
        self._weight = plant.CalcTotalMass(context) * GRAVITY
        self._soles_at_rest = [f.CalcPoseInWorld(context) for f, _ in self._soles]
        self.corners_at_rest = self.corners(context)
        self._corners_at_rest = np.vstack(self.corners_at_rest)
        self.floor = float(self._corners_at_rest[:, 2].min())
        root_at_rest = plant.EvalBodyPoseInWorld(context, self._root)
        self._up = root_at_rest.rotation().inverse() @ np.array([0.0, 0.0, 1.0])
        self._lowest = _LOW * (root_at_rest.translation()[2] - self.floor)

    def corners(self, context: Context) -> list[np.ndarray]:
        """Per sole (V, 3), where its corners are in W at the context's state [m]."""
        return [
            frame.CalcPoseInWorld(context).multiply(corners.T).T
            for frame, corners in self._soles
        ]

    def lean(self, context: Context) -> float:
        """Angle between the root and where it stands upright [rad]."""
        pose = self.plant.EvalBodyPoseInWorld(context, self._root)
        return float(np.arccos(np.clip((pose.rotation() @ self._up)[2], -1.0, 1.0)))

    def fell(self, context: Context) -> bool:
        """Whether the robot lies at the context's state, or is about to."""
        pose = self.plant.EvalBodyPoseInWorld(context, self._root)
        low = pose.translation()[2] - self.floor < self._lowest
        return bool(low) or self.lean(context) > _LEANS

    def step(
        self,
        context: Context,
        reference: Context,
        state: np.ndarray,
        command: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> StandingStep:
        """What motors and ground give at a state.

        Args:
            context, reference: of the plant, to compute in.
            state: (nq + nv,) of the plant, as measured.
            command: (n,) positions, velocities and accelerations of the joints
                `joint_names`, with legs at rest.
        """
        plant, b, legs, j = self.plant, self._b, self._l, self._j
        nv = plant.num_velocities()
        q, v = np.split(state, [len(state) - nv])
        plant.SetPositionsAndVelocities(context, state)
        M = plant.CalcMassMatrix(context) + self._damping
        if self.fell(context):
            return self._go_limp(M, v)
        plant.CalcForceElementsContribution(context, self._forces)
        h = plant.CalcInverseDynamics(context, np.zeros(nv), self._forces)
        X_WS = _moved(self._corners_at_rest, np.vstack(self.corners(context)))
        J, bias, off, pushes = self._contacts(context, X_WS)
        X_ref, c_ref, c_dot_ref, c_dd_ref = self._reference(reference, X_WS, command)

        # a = a_0 + N a_b: joints as commanded, legs such that the soles stay.
        a_0, N = np.zeros(nv), np.zeros((nv, 6))
        a_0[j] = (
            command[2]
            + _JOINT * (command[0] - q[self._j_q])
            + _JOINT_RATE * (command[1] - v[j])
        )
        U, s, V_T = np.linalg.svd(J[:, legs], full_matrices=False)
        inverse = (V_T.T * (s / np.maximum(s, _SINGULAR) ** 2)) @ U.T
        a_0[legs] = -inverse @ (bias + self._stiffness * off + self._rates * (J @ v))
        N[b], N[legs] = np.eye(6), -inverse @ J[:, b]

        # The root's rows, in shares x of the weight along the pyramids' edges:
        # a_b = B x - a_f.
        pushes = self._weight * pushes
        solved = _solved(M[b] @ N, np.column_stack([pushes[b], M[b] @ a_0 + h[b]]))
        if not np.isfinite(solved).all():
            return self._go_limp(M, v)
        B, a_f = solved[:, :-1], solved[:, -1]

        c = plant.CalcCenterOfMassPositionInWorld(context) - c_ref
        c_dot = plant.CalcCenterOfMassTranslationalVelocityInWorld(context) - c_dot_ref
        omega, k = np.sqrt(GRAVITY / (c_ref[2] - self.floor)), _CAPTURE
        c_dd = c_dd_ref - omega * k * c - (omega + k) * c_dot
        pose = plant.EvalBodyPoseInWorld(context, self._root)
        turned = _rotation_vector(pose.rotation() @ X_ref.rotation().inverse())
        turn = -_TURN * turned - _TURN_RATE * v[b[:3]]
        fallen = X_ref.translation()[2] - pose.translation()[2]
        rise = _HEIGHT * fallen - _HEIGHT_RATE * v[b[5]]
        rows = np.vstack([pushes[b[3:5]] * GRAVITY / self._weight, B[:3], B[5:]])
        wanted = np.concatenate([c_dd[:2], turn + a_f[:3], [rise + a_f[5]]])

        # Efforts are efforts_0 + D x.
        root_inertia, of_joints = M @ N, self._actuators.of_joints
        efforts_0 = of_joints @ (M @ a_0 + h - root_inertia @ a_f)
        D = of_joints @ (root_inertia @ B - pushes)
        rows = _WEIGHTS[:, np.newaxis] * rows
        x = self._shares(rows, _WEIGHTS * wanted, efforts_0, D)
        if not np.isfinite(x).all():
            # Legs that fling about in a fall cannot hold the root at all.
            return self._go_limp(M, v)
        answer, limits = efforts_0 + D @ x, self._actuators.limits
        allowed = np.clip(answer, -limits, limits)
        forces = (self._weight * x).reshape(-1, len(_WAYS)) @ self._edges
        return StandingStep(
            allowed,
            a_0 + N @ (B @ x - a_f),
            forces,
            float(np.abs(answer - allowed).max()),
        )

    def _go_limp(self, M: np.ndarray, v: np.ndarray) -> StandingStep:
        """Falling or lying, joints are braked, each against its own inertia."""
        braked = np.zeros(len(v))
        braked[self._j] = -_LIMP * v[self._j] * np.diag(M)[self._j]
        limits = self._actuators.limits
        efforts = np.clip(self._actuators.of_joints @ braked, -limits, limits)
        nothing = np.zeros(self._corners_at_rest.shape)
        return StandingStep(efforts, np.zeros(len(v)), nothing, fell=True)

    def _shares(
        self, rows: np.ndarray, wanted: np.ndarray, efforts_0: np.ndarray, D: np.ndarray
    ) -> np.ndarray:
        """(K,) forces along the pyramids' edges, in shares of the weight."""
        limits = self._actuators.limits
        some = np.isfinite(limits)
        D, at = D[some] / limits[some, np.newaxis], efforts_0[some] / limits[some]
        none = np.eye(rows.shape[1])
        least = np.full(len(none), _LEAST_FORCE / len(_WAYS))
        M, right = rows.T @ rows + _EVEN**2 * none, rows.T @ wanted
        x = one_sided_minimum(
            M,
            right,
            _OUTSIDE * np.vstack([none, D, -D]),
            _OUTSIDE * np.concatenate([least, -1.0 - at, at - 1.0]),
            _solved(M, right),
        )
        return np.maximum(x, 0.0)

    def _contacts(
        self, context: Context, X_WS: RigidTransform
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The soles' Jacobian (6 S, nv) and bias (6 S,); how far they are from where
        they stand, (6 S,), turned [rad] and off [m]; and what forces along the
        pyramids' edges do, (nv, K)."""
        plant, W = self.plant, self.plant.world_frame()
        jacobians, biases, off, pushes = [], [], [], []
        for (frame, _), at_rest, at in zip(
            self._soles, self._soles_at_rest, self._pressed, strict=True
        ):
            of_sole = context, JacobianWrtVariable.kV, frame, np.zeros(3), W, W
            J = plant.CalcJacobianSpatialVelocity(*of_sole)
            jacobians.append(J)
            bias = plant.CalcBiasSpatialAcceleration(*of_sole)
            biases.append(bias.get_coeffs())
            pose, wanted = frame.CalcPoseInWorld(context), X_WS @ at_rest
            off.append(_rotation_vector(pose.rotation() @ wanted.rotation().inverse()))
            off.append(pose.translation() - wanted.translation())
            arms = np.repeat(at @ pose.rotation().matrix().T, len(_WAYS), axis=0)
            edges = np.tile(self._edges, (len(at), 1))
            pushes.append(J.T @ np.hstack([cross_rows(arms, edges), edges]).T)
        stacked = map(np.concatenate, (jacobians, biases, off))
        return *stacked, np.hstack(pushes)

    def _reference(
        self,
        context: Context,
        X_WS: RigidTransform,
        command: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> tuple[RigidTransform, np.ndarray, np.ndarray, np.ndarray]:
        """The root's pose, and the centre of mass with two derivatives, if root and
        legs were as commanded, where the soles are now."""
        plant, q = self.plant, self.rest.copy()
        v, a = np.zeros((2, plant.num_velocities()))
        q[self._j_q], v[self._j], a[self._j] = command
        plant.SetPositionsAndVelocities(context, np.concatenate((q, v)))
        plant.CalcForceElementsContribution(context, self._forces)
        # The root's force is that on the centre of mass: m (c_dd + g).
        force = plant.CalcInverseDynamics(context, a, self._forces)[self._b[3:]]
        R = X_WS.rotation()
        return (
            X_WS @ plant.EvalBodyPoseInWorld(context, self._root),
            X_WS @ plant.CalcCenterOfMassPositionInWorld(context),
            R @ plant.CalcCenterOfMassTranslationalVelocityInWorld(context),
            R @ (GRAVITY * force / self._weight),
        )


def _solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A^-1 b, or NaN where there is none.

    M N is singular in postures whose legs hold the root from neither side, of which
    bent legs have some. The normal matrix of `_shares` is not, unless rows next to such
    a posture are so large that the identity in it is lost to rounding.
    """
    try:
        return np.linalg.solve(A, b)
    except np.linalg.LinAlgError:
        return np.full_like(b, np.nan)


def _within(corners: np.ndarray, margin: float) -> np.ndarray:
    """(V, 3) corners of a sole, drawn in by a margin along its principal axes [m]."""
    middle = corners.mean(axis=0)
    axes = np.linalg.svd(corners - middle)[2][:2]
    along = (corners - middle) @ axes.T
    shares = np.maximum(1.0 - margin / np.abs(along).max(axis=0), 0.0)
    return middle + shares * along @ axes


def _rotation_vector(R: RotationMatrix) -> np.ndarray:
    """(3,) axis times angle [rad]."""
    turn = R.ToAngleAxis()
    return turn.angle() * turn.axis()


def _moved(at_rest: np.ndarray, now: np.ndarray) -> RigidTransform:
    """How the soles have slid: the turn about z, and the way on the floor, that bring
    their (C, 3) corners nearest to where these are now."""
    middle_0, middle = (x.sum(axis=0) / len(x) for x in (at_rest, now))
    p, r = (at_rest - middle_0)[:, :2], (now - middle)[:, :2]
    sine = p[:, 0] @ r[:, 1] - p[:, 1] @ r[:, 0]
    R = RotationMatrix.MakeZRotation(np.arctan2(sine, np.sum(p * r)))
    way = middle - R @ middle_0
    return RigidTransform(R, [way[0], way[1], 0.0])
