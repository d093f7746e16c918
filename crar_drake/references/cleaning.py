"""A reference motion made clear of collisions and within limits, changed the least.

Whether links touch and how joints move does not depend on where the root is. So the
root is passed on as it is, and all frames' joints are found at once (`trajectory`):

    minimise    1/2 sum_k [ |w (q_k - r_k)|^2 + |W (pose_k(q_k) - pose_k(r_k))|^2
                            + |w tau^2 x''_k|^2 ],         x = q - r,

with r the reference, and the poses those of the feet and, where they carry, the hands.
Constraints are distances of watched pairs at the frames and at samples between them,
and the limits and speeds of joints.

Only windows about frames that violate something are solved, and what comes out is
certified (`trajectory.keeping`): a clean reference comes back bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError, MotionError, ScenarioError
from crar_drake.law.checks import check_numbers
from crar_drake.references.ground_contact import FEET, HANDS
from crar_drake.references.mesh_rows import MeshRows
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.uncovered import Uncovered
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.trajectory.distance_rows import (
    configurations,
    find_poses,
)
from crar_drake.trajectory.keeping import Keeper
from crar_drake.trajectory.optimiser import (
    AtFrames,
    Effort,
    Problem,
)

# Frames whose Jacobians are in memory at a time.
_BLOCK = 512


@dataclass(frozen=True)
class CleaningParameters:
    """What changing the least means, and what is kept."""

    joint_weight: float = 1.0  # w of each joint [m/rad]
    foot_weight: float = 25.0  # of the feet's positions [1]
    foot_turn_weight: float = 4.0  # of their orientations [m/rad]
    # of their heights [1]: feet that meet part sideways, and not into the floor
    foot_height_weight: float = 100.0
    hand_weight: float = 2.0  # of the hands' positions [1]
    carrying_weight: float = 35.0  # instead, of hands that carry [1]
    carrying_turn_weight: float = 0.3  # and of their orientations [m/rad]
    # whether hands are taken to carry throughout, as those that hold an object do; else
    # while they are planted on the ground
    hands: bool = False
    # tau; changes that come and go within this time cost more [s]
    smoothing: float = 0.03
    floor: float = 4e-3  # distance that watched pairs keep at each frame [m]
    floor_between: float = 0.5e-3  # and on each straight way to the next frame [m]
    velocity_scale: float = 1.0  # share of the robot's velocity limits that may be used

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        check_numbers("clean", self, may_be_zero={"smoothing", "hand_weight"})
        if self.velocity_scale > 1.0:
            raise ScenarioError(
                f"clean: velocity_scale is {self.velocity_scale:g}; a share of the "
                "robot's speed limits is at most 1"
            )


@dataclass(frozen=True)
class Cleaned:
    """A reference's joints, cleaned; T frames of n joints."""

    q: np.ndarray  # (T, n) positions of the controlled joints [rad or m]
    # (T,) frames that still violate something, at them or on the way to the next
    violating: np.ndarray
    effort: Effort  # that it took


class Cleaner:
    """Cleans references of one robot at one rate.

    Attributes:
        parameters: what is asked for.
        description: of the robot.
        model: the robot with its root fixed, and its watched pairs.
        keeper: of what is kept. Speeds of its margins are shares of the robot's own
            limits, whatever share may be used.
        meshes: of its links, which are parted, or None,
        by_shapes: and the keeper of pairs of which they do not decide.
        feet, hands: task frames that are kept.
        rate: frames per second [Hz].
    """

    def __init__(
        self,
        description: RobotDescription,
        rate: float,
        parameters: CleaningParameters | None = None,
        uncovered: Uncovered | None = None,
    ) -> None:
        """
        Args:
            description: of the robot. Its root is fixed here, even if it floats, and
                joints that it prescribes stay in the rest posture.
            rate: frames per second [Hz].
            parameters: what is asked for.
            uncovered: has the meshes of the robot's links, which decide, and are parted
                where they touch; by default there are none.

        Raises:
            ScenarioError: a parameter is out of range.
            ModelError: the robot watches no pair, has watched shapes other than
                capsules and spheres, or no frames of hands that are asked for.
        """
        self.parameters = parameters or CleaningParameters()
        self.parameters.validate()
        self.description, self.rate = description, rate
        description = replace(description, root="fixed")
        if not description.pairs:
            raise ModelError(
                f"robot {description.name} watches no pairs of links: list `pairs` in "
                "its robot.yaml, or import it"
            )
        known = description.task_frames
        self.feet, self.hands = (
            tuple(frame for frame in frames if frame in known)
            for frames in (FEET, HANDS)
        )
        if self.parameters.hands and not self.hands:
            raise ModelError(
                f"robot {description.name} has no task_frames {' and '.join(HANDS)} to "
                "keep; add them to its robot.yaml, or leave out --hands"
            )
        # Of a robot without any the world is kept, which stays.
        frames = self.feet + self.hands or ("world",)
        kept = [Task(frame=frame, kind="pose") for frame in frames]
        p = self.parameters
        model = ControlModel.FromDescription(description, kept)
        kept_of_pairs = rate, p.floor, p.floor_between, p.velocity_scale
        self.keeper = Keeper(model, *kept_of_pairs)
        self.meshes = self.by_shapes = None
        if uncovered is not None and uncovered.meshes is not None:
            self.meshes = MeshRows(uncovered.meshes, model.joint_names)
            others = replace(description, pairs=uncovered.by_shapes)
            others = ControlModel.FromDescription(others, kept)
            self.by_shapes = Keeper(others, *kept_of_pairs)
        self.model = model
        bare = replace(description, pairs=[])
        self._poses = ControlModel.FromDescription(bare, kept)
        self._rest = self.model.rest_positions()

    @property
    def fastest(self) -> np.ndarray:
        """(n,) how far each joint may go from a frame to the next [rad or m]."""
        limits = self.model.velocity_limits[self.model.controlled]
        return self.parameters.velocity_scale * limits / self.rate

    def columns(self, motion: RobotMotion) -> list[int]:
        """Where the joints that are controlled stand in a motion's.

        Raises:
            MotionError: the motion moves joints that the robot does not control, so
                that distances would not be those of the motion.
        """
        others = sorted(set(motion.joint_names) - set(self.model.joint_names))
        if others:
            raise MotionError(
                f"{motion.source}: robot {self.description.name} does not control "
                f"{', '.join(others[:5])}: import it with --whole-body, or take these "
                "out of its prescribed_joints"
            )
        return [motion.joint_names.index(name) for name in self.model.joint_names]

    def controlled(self, motion: RobotMotion) -> np.ndarray:
        """(T, n) a motion's joints, in the order of the model [rad or m].

        Raises:
            MotionError: as `columns`.
        """
        return np.ascontiguousarray(motion.joint_positions[:, self.columns(motion)])

    def clean(
        self,
        reference: np.ndarray,
        root_rotations: np.ndarray | None = None,
        carries: np.ndarray | None = None,
        progress: Callable[[int], None] | None = None,
        part_meshes: bool = True,
    ) -> Cleaned:
        """The reference under all constraints, changed the least.

        Args:
            reference: (T, n) positions of the controlled joints, in their order.
            root_rotations: (T, 3, 3) R_WR, by which heights are known; by default the
                root is upright.
            carries: (T, H) how much each hand carries the robot, from 0 to 1.
            progress: is called with the number of frames that are done.
            part_meshes: whether meshes are looked at; else that was done before.
        """
        problem = self._problem(reference, root_rotations, carries)
        of_meshes = dict(meshes=self.meshes, by_shapes=self.by_shapes)
        found = self.keeper.keep(
            problem, reference, None, progress, **(of_meshes if part_meshes else {})
        )
        return Cleaned(*found)

    def _problem(self, reference, root_rotations, carries) -> Problem:
        p, model = self.parameters, self.model
        ones = np.ones(model.n)
        stiffness = p.joint_weight * (p.smoothing * self.rate) ** 2
        return Problem(
            tasks=self._tasks(reference, root_rotations, carries),
            posture=reference,
            posture_weight=p.joint_weight * ones,
            about=reference,
            smoothness=stiffness * ones,
            lower=model.lower,
            upper=model.upper,
            fastest=self.fastest,
            near_rows=self.keeper.near_rows,
            num_rows=self.keeper.num_rows,
        )

    def _tasks(self, reference, root_rotations, carries) -> KeptPoses:
        p, frames = self.parameters, len(reference)
        hands = len(self.hands)
        if carries is None or p.hands:
            carries = np.full((frames, hands), float(p.hands))
        if root_rotations is None:
            root_rotations = np.tile(np.eye(3), (frames, 1, 1))
        feet = np.ones((frames, len(self._poses.tasks) - hands))
        foot = [p.foot_weight, p.foot_weight, p.foot_height_weight]
        hand = (1.0 - carries) * p.hand_weight + carries * p.carrying_weight
        linear = (feet[:, :, None] * foot, np.repeat(hand[:, :, None], 3, axis=2))
        turn = (feet * p.foot_turn_weight, carries * p.carrying_turn_weight)
        return KeptPoses(
            self._poses,
            self._rest,
            reference,
            root_rotations,
            np.concatenate(linear, axis=1),
            np.repeat(np.concatenate(turn, axis=1)[:, :, None], 3, axis=2),
        )


class KeptPoses:
    """Links that are to stay where a reference has them, in the world."""

    step_weights = None

    def __init__(
        self,
        model: ControlModel,
        rest: np.ndarray,
        reference: np.ndarray,
        root_rotations: np.ndarray,
        linear: np.ndarray,
        angular: np.ndarray,
    ) -> None:
        """
        Args:
            model: of the robot, its root fixed; its L tasks are poses.
            rest: (nq,) its rest posture.
            reference: (T, n) positions of the controlled joints.
            root_rotations: (T, 3, 3) R_WR.
            linear, angular: (T, L, 3) weights along the world's axes [1], [m/rad].
        """
        self._model, self._rest = model, rest
        self._root, self._linear, self._angular = root_rotations, linear, angular
        blocks = range(0, len(reference), _BLOCK)
        found = [self._find(reference[k : k + _BLOCK])[:2] for k in blocks]
        self._R, self._p = map(np.concatenate, zip(*found, strict=True))

    def _find(self, y):
        return find_poses(configurations(self._model, self._rest, y), self._model.robot)

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        R, p, J = self._find(y)
        J, of = J[:, :, : y.shape[1]], self._model.layout
        root = self._root[frames][:, None]
        turned = Rotation.from_matrix(
            (R @ self._R[frames].swapaxes(-1, -2)).reshape(-1, 3, 3)
        ).as_rotvec()
        r, jacobians = [], []
        for error, rows, weight in (
            (p - self._p[frames], of.linear_rows, self._linear[frames]),
            (turned.reshape(p.shape), of.angular_rows, self._angular[frames]),
        ):
            by = weight[..., None] * root  # (K, L, 3, 3)
            r.append((by @ error[..., None]).reshape(len(y), -1))
            jacobians.append((by @ J[:, rows]).reshape(len(y), -1, y.shape[1]))
        nothing = np.zeros((len(y), 0)), np.zeros((len(y), 0, y.shape[1]))
        return AtFrames(
            np.concatenate(r, axis=1), np.concatenate(jacobians, axis=1), *nothing
        )
