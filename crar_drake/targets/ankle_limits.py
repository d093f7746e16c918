"""Feet that their legs can turn so: poses within the limits of a leg's joints."""

from __future__ import annotations

import numpy as np
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable, Joint, RevoluteJoint
from scipy.ndimage import binary_dilation
from scipy.spatial.transform import Rotation

from crar_drake.motion.held_feet import FootMotion
from crar_drake.motion.leg_shape import LegShape
from crar_drake.motion.performer import SIDES
from crar_drake.motion.smooth_steps import led_over
from crar_drake.robot.description import find_body, find_frame
from crar_drake.robot.model import ControlModel

_ITERATIONS = 8
_LARGEST_STEP = 0.3  # [rad] of one iteration
_DAMPING = 1e-3  # [m]
_SAME = 1e-6  # [m, rad] by which what is asked for may be other than before
_MARGIN = 0.03  # [rad] that a joint keeps from its limits
# Ankles come to their limits like exp(-t / this), no faster: a lookahead would brake
# them before, and the foot would slide. Longer than the scenarios' horizons [s].
_APPROACH = 0.05
_SPEED_SHARE = 0.9  # of an ankle's largest speed
_FROM_SINGULAR = 0.2  # [rad] that a hip keeps from where its axes are in one plane
# A radian of the foot counts as much as this: where both cannot be had, the foot is
# where it should be, and turned as it can be [m].
_ORIENTATION_WEIGHT = 0.03
# No foot of a filtered motion turns so suddenly. Where its leg has it do so, one way of
# the leg has come to its end, and the next sample has another.
_SUDDEN = 1200.0  # [rad/s^2]
# A hip that runs into its limit is braked before, by the scenarios' lookaheads [s].
_HORIZON = 0.04
# In either case the joints change over from so long before to so long after [s].
_CHANGE = 0.05


class LegSolver:
    """Inverse kinematics of one leg, the root of the robot given.

    Asked for the same stretch of time again, it begins from what it found, and where
    that is as before it has the answer.

    Attributes:
        joints: of the leg, from the foot up.
        positions: what it found last, a row (n,) of them a sample [rad].
    """

    def __init__(
        self, model: ControlModel, side: str, leg: LegShape, rate: float
    ) -> None:
        """
        Args:
            model: the robot.
            side: "left" or "right".
            leg: the robot's on that side.
            rate: of the samples that it will be asked for [Hz].
        """
        plant, description = model.plant, model.description
        self._plant = plant
        self._context = model.MakeWorkspace().plant_context
        self._root = model.root_positions
        self._rest = model.rest_positions()
        self._at_rest = Rotation.from_matrix(
            description.rest_pose().rotation().matrix()
        )
        self._leg = leg
        self._foot = find_frame(plant, description.task_frames[f"{side}_foot"])
        self._shank = find_frame(plant, description.task_frames[f"{side}_knee"])
        chain = leg_joints(model, side, "foot")
        hip = leg_joints(model, side, "knee")[1:]
        self._q = np.array([joint.position_start() for joint in chain])
        self._v = np.array([joint.velocity_start() for joint in chain])
        lower = plant.GetPositionLowerLimits()[self._q]
        upper = plant.GetPositionUpperLimits()[self._q]
        self._hip = slice(len(chain) - len(hip), None)
        self._limits_of_hip = lower[self._hip], upper[self._hip]
        margin = np.minimum(_MARGIN, 0.25 * (upper - lower))
        self._lower, self._upper = lower + margin, upper - margin
        if len(hip) == 3 and all(isinstance(joint, RevoluteJoint) for joint in hip):
            plant.SetPositions(self._context, self._rest)
            low, high = _one_way(self._context, hip)
            low = max(low, self._lower[-2])
            high = min(high, self._upper[-2])
            if low < high:
                self._lower[-2], self._upper[-2] = low, high
        self._rate = rate
        self.joints = chain
        self.positions: list[np.ndarray] = []
        # Hip and knee are not held back: the foot would not be where it should.
        self._share = np.ones(len(chain))
        self._most = np.full(len(chain), np.inf)
        ankle = len(chain) - len(hip) - 1  # what is below the knee
        self._share[:ankle] = -np.expm1(-1.0 / (rate * _APPROACH))
        fastest = model.velocity_limits[self._v[:ankle]]
        self._most[:ankle] = _SPEED_SHARE * fastest / rate

    def turns(
        self, root_positions: np.ndarray, root_turns: Rotation, foot: FootMotion
    ) -> tuple[Rotation, np.ndarray]:
        """How the foot can be turned where it should be, and where the knee is then.

        Args:
            root_positions: (T, 3) of the base's origin [m].
            root_turns: T of them, from the base at rest.
            foot: where the foot should be, and how turned from standing flat.

        Returns:
            T turns from standing flat, (T, 3) positions of the knee [m].
        """
        R_WB = (root_turns * self._at_rest).as_quat()[:, [3, 0, 1, 2]]
        R_WF = Rotation.from_quat(foot.turns).as_matrix() @ self._leg.foot
        count = len(R_WF)
        asked = [R_WB, root_positions, R_WF.reshape(count, 9), foot.positions]
        asked = np.concatenate(asked, axis=1)
        q, found, knees = self._rest.copy(), np.empty_like(R_WF), np.empty((count, 3))
        before, self.positions = self.positions, []
        bounds = self._lower, self._upper
        for t in range(count):
            if (
                before
                and (np.abs(asked[t] - self._asked[t]) < _SAME).all()
                and (t == 0 or (self.positions[-1] == before[t - 1]).all())
            ):
                self.positions.append(before[t])
                asked[t] = self._asked[t]
                found[t], knees[t] = self._found[t], self._knees[t]
                continue
            q[self._root[:4]], q[self._root[4:]] = R_WB[t], root_positions[t]
            if t > 0:
                last = self.positions[-1]
                bounds = tuple(
                    last
                    + np.clip(self._share * (limit - last), -self._most, self._most)
                    for limit in (self._lower, self._upper)
                )
            if before:
                q[self._q] = np.clip(before[t], *bounds)
            self._solve(q, foot.positions[t], R_WF[t], bounds)
            found[t], knees[t] = self._foot_and_knee(q)
            self.positions.append(q[self._q].copy())
        joints = np.array(self.positions)
        sudden = sudden_turns(Rotation.from_matrix(found), self._rate)
        sudden = around(sudden | self._runs_into_limits(joints), self._rate)
        joints = np.clip(led_over(joints, sudden), self._lower, self._upper)
        for t in np.flatnonzero(sudden):
            q[self._root[:4]], q[self._root[4:]] = R_WB[t], root_positions[t]
            q[self._q] = self.positions[t] = joints[t]
            found[t], knees[t] = self._foot_and_knee(q)
        self._asked, self._found, self._knees = asked, found, knees
        return Rotation.from_matrix(found @ self._leg.foot.T), knees

    def _runs_into_limits(self, joints: np.ndarray) -> np.ndarray:
        """(T,) where a hip could not stop within its limits any more."""
        low, high = self._limits_of_hip
        hip = joints[:, self._hip]
        rest = hip + _HORIZON * self._rate * np.gradient(hip, axis=0)
        return ((rest < low) | (rest > high)).any(axis=1)

    def stopped(self, positions: np.ndarray) -> np.ndarray:
        """(n,) which joints from the knee up are at a limit: a foot that is to be
        elsewhere cannot count on them, while an ankle's lets it turn otherwise.

        Args:
            positions: (n,) of the leg's joints [rad].
        """
        near = (positions <= self._lower + _SAME) | (positions >= self._upper - _SAME)
        return near & (self._share == 1.0)

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(6, n) of the foot in the world, [omega; p_dot] by the leg's joints.

        Args:
            q: (nq,) positions of the whole plant.
        """
        plant, world = self._plant, self._plant.world_frame()
        plant.SetPositions(self._context, q)
        return plant.CalcJacobianSpatialVelocity(
            self._context,
            JacobianWrtVariable.kV,
            self._foot,
            np.zeros(3),
            world,
            world,
        )[:, self._v]

    def _foot_and_knee(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(3, 3) orientation of the foot, (3,) position of the knee [m]."""
        self._plant.SetPositions(self._context, q)
        X_WF = self._foot.CalcPoseInWorld(self._context)
        knee = self._shank.CalcPoseInWorld(self._context).translation()
        return X_WF.rotation().matrix(), knee

    def _solve(self, q, p, R, bounds: tuple[np.ndarray, np.ndarray]) -> None:
        """R_WF nearest to R within bounds of the leg's joints, from and into q."""
        context, wanted = self._context, RotationMatrix(R)
        for _ in range(_ITERATIONS):
            J = self.jacobian(q)
            X = self._foot.CalcPoseInWorld(context)
            away = (wanted @ X.rotation().inverse()).ToAngleAxis()
            turn = away.angle() * away.axis()
            error = np.concatenate([_ORIENTATION_WEIGHT * turn, p - X.translation()])
            J[:3] *= _ORIENTATION_WEIGHT
            step = self._step(J, error, q[self._q], bounds)
            q[self._q] = np.clip(q[self._q] + step, *bounds)
            if np.abs(step).max() < 1e-5:
                break

    def _step(self, J, error, q, bounds: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """A damped step; what a joint at its bound cannot do, the others must."""
        lower, upper = bounds
        free = np.ones(len(q), dtype=bool)
        step = np.zeros(len(q))
        for _ in range(len(q)):
            A = J[:, free]
            core = A.T @ A + _DAMPING**2 * np.eye(A.shape[1])
            step[:] = 0.0
            step[free] = np.linalg.solve(core, A.T @ error)
            stopped = free & (
                ((q <= lower) & (step < 0.0)) | ((q >= upper) & (step > 0.0))
            )
            if not stopped.any():
                break
            free &= ~stopped
            if not free.any():
                return np.zeros(len(q))
        return step * min(1.0, _LARGEST_STEP / max(np.abs(step).max(), 1e-12))


def sudden_turns(turns: Rotation, rate: float) -> np.ndarray:
    """(T,) where a foot turns more suddenly than any does.

    Args:
        turns: T of them.
        rate: samples per second [Hz].
    """
    sudden = np.zeros(len(turns), dtype=bool)
    speeds = rate * (turns[1:] * turns[:-1].inv()).as_rotvec()
    sudden[1:-1] = rate * np.linalg.norm(np.diff(speeds, axis=0), axis=1) > _SUDDEN
    return sudden


def around(flags: np.ndarray, rate: float) -> np.ndarray:
    """(T,) flags that are set a moment before and after those that are."""
    return binary_dilation(flags, np.ones(2 * round(_CHANGE * rate) + 1))


def _one_way(context, hip: list[RevoluteJoint]) -> tuple[float, float]:
    """Between which angles the middle joint of a hip stays on one side of its singular
    poses [rad].

    There its first and its last axis are parallel, and beyond it the other two joints
    have turned by half a turn for the same pose of the thigh.

    Args:
        context: of the plant; the joint's position in it is within the result.
        hip: three joints, the one that the thigh is on first.
    """
    last, middle, first = (
        joint.frame_on_parent().CalcPoseInWorld(context).rotation()
        @ joint.revolute_axis()
        for joint in hip
    )
    angle = np.arctan2(middle @ np.cross(first, last), first @ last) % np.pi
    here = hip[1].get_angle(context)
    return here - angle + _FROM_SINGULAR, here + np.pi - angle - _FROM_SINGULAR


def leg_joints(model: ControlModel, side: str, part: str) -> list[Joint]:
    """Joints of one leg alone, from its foot or its knee up.

    Where the base is above the waist, its joint turns both legs: as one of either it
    would have two positions at once.

    Args:
        model: the robot.
        side: of the leg.
        part: "foot" or "knee", where it begins.
    """
    description, ways = model.description, {}
    base = find_body(model.plant, description.base)
    for each in SIDES:
        frame = find_frame(model.plant, description.task_frames[f"{each}_{part}"])
        ways[each] = joints_between(model, frame.body(), base)
    (other,) = set(SIDES) - {side}
    shared = {joint.index() for joint in ways[other]}
    return [joint for joint in ways[side] if joint.index() not in shared]


def joints_between(model: ControlModel, body, base) -> list[Joint]:
    """Joints with one position on the way from a body up to the base, from the body on.

    Args:
        model: the robot.
        body: where it begins.
        base: where the way ends; if it does not carry the body (as a neck that is on a
            link beside the shoulders), where both ways up meet.
    """
    plant = model.plant
    by_child = {
        plant.get_joint(index).child_body().index(): plant.get_joint(index)
        for index in plant.GetJointIndices()
    }
    ends, above = {base.index()}, base
    while above.index() in by_child:
        above = by_child[above.index()].parent_body()
        ends.add(above.index())
    chain = []
    while body.index() not in ends:
        joint = by_child[body.index()]
        if joint.num_positions() == 1:
            chain.append(joint)
        body = joint.parent_body()
    return chain
