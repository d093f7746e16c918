"""What a reference motion does to its robot: collisions, limits, ground, smoothness.

Nothing here is the controller's: capsules are judged by the referee, meshes by
`MeshJudge`. The root stands still for both, since only the joints decide whether the
robot meets itself; its pose counts against the ground.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.judging.mesh_judge import MeshJudge, MeshVerdict, PairContact
from crar_drake.references.certificate_files import certificate_beside
from crar_drake.references.faults import LIMBS_OFF, Fault, Tolerances, find_faults
from crar_drake.references.ground_contact import GroundContact, Outline
from crar_drake.references.motion_files import read_motions
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import (
    Jump,
    find_jumps,
    joint_jerks,
    rms,
    root_acceleration,
    step_speeds,
)
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    LIMIT_TOLERANCE,
    SPEED_TOLERANCE,
    RobotDescription,
    load_robot_description,
)
from crar_drake.robot_import.link_meshes import check_installed, has_meshes

# Capsules that are farther apart are not plotted [m].
_NEAR = 0.05


@dataclass(frozen=True)
class Beyond:
    """How far a joint, or its speed, is beyond a limit."""

    joint: str  # its name
    frames: tuple[int, ...]  # in which it is; of a speed the first one of the step
    excess: float  # the largest [rad or rad/s; m or m/s]
    frame: int  # of the largest


@dataclass(frozen=True, eq=False)
class ReferenceVerdict:
    """What is to be said of a motion with T frames."""

    motion: RobotMotion  # that was judged, without what the file had besides
    # pairs of capsules that penetrate, the deepest first; None where they are not
    # judged
    capsules: list[PairContact] | None
    why_no_capsules: str  # why they are not, or ""
    capsule_distances: np.ndarray  # (T,) the smallest; NaN beyond 5 cm [m]
    meshes: MeshVerdict | None  # what the meshes say; None where they were not asked
    limits: tuple[Beyond, ...]  # joints beyond their limits, the farthest first
    speeds: tuple[Beyond, ...]  # and beyond their speed limits
    # (T,) the largest of all joints, negative within [rad or m]
    limit_excess: np.ndarray
    # (T - 1,) the largest share of a speed limit; 0 without any
    speed_ratio: np.ndarray
    ground: GroundContact  # its contact with the ground
    jumps: tuple[Jump, ...]  # in the order of their frames
    root_acceleration: tuple[float, float]  # rms and largest [m/s^2]
    rms_jerk: float  # of all joints [rad/s^3]
    peak_jerk: float  # the largest of any joint [rad/s^3]
    peak_jerk_joint: str  # where it is
    faults: tuple[Fault, ...]  # what else is wrong with it
    # kinds of faults that its certificate says it was left with
    left: tuple[str, ...] = ()

    @property
    def mesh_pairs(self) -> list[PairContact]:
        """Pairs of meshes that penetrate, the deepest first."""
        return [] if self.meshes is None else self.meshes.penetrations

    @property
    def violations(self) -> tuple[str, ...]:
        """What is violated, in a few words each."""
        found = []
        if self.mesh_pairs:
            found.append("meshes penetrate")
        elif self.meshes is None and self.capsules:
            found.append("capsules penetrate")
        if self.limits:
            found.append("joint limits")
        if self.speeds:
            found.append("speed limits")
        return *found, *(f.kind for f in self.faults if f.kind not in self.left)

    @property
    def left_as_it_was(self) -> tuple[str, ...]:
        """Kinds of its faults that are no violations."""
        return tuple(f.kind for f in self.faults if f.kind in self.left)

    @property
    def capsule_frames(self) -> tuple[int, ...]:
        """Frames in which any capsules penetrate."""
        return frames_of(self.capsules or ())

    @property
    def penetrating_frames(self) -> tuple[int, ...]:
        """Frames in which any meshes do."""
        return frames_of(self.mesh_pairs)

    @property
    def beyond_frames(self) -> tuple[int, ...]:
        """Frames with a joint beyond its limit or its speed limit."""
        return frames_of(self.limits + self.speeds)

    def mesh_depths(self) -> np.ndarray:
        """(K,) how deep meshes penetrate in each frame judged, 0 if not [m]."""
        depths = dict.fromkeys(self.meshes.frames.tolist(), 0.0)
        for pair in self.mesh_pairs:
            for frame, depth in zip(pair.frames, pair.depths, strict=True):
                depths[frame] = max(depths[frame], depth)
        return np.array(list(depths.values()))


class ReferenceJudge:
    """Judges motions of one robot; making it takes longer than a short motion.

    Attributes:
        robot: the robot.
    """

    def __init__(self, description: RobotDescription, meshes: bool = True) -> None:
        """
        Args:
            description: of the robot, all of whose joints a motion has.
            meshes: whether to judge by meshes, where it has any.

        Raises:
            ModelError: the model or a mesh cannot be read, or what reads meshes is not
                installed.
        """
        self.robot = WholeBody(description)
        self._mesh_judge = None
        if meshes and has_meshes(self.robot.plant, self.robot.scene_graph):
            check_installed()
            self._mesh_judge = MeshJudge(description)
        self._referee, self._why_no_capsules = None, "no pairs are watched"
        if description.pairs:
            try:
                self._referee, self._why_no_capsules = self.robot.referee(), ""
            except ModelError as error:
                self._why_no_capsules = str(error)
        self._outline = Outline(self.robot)

    def judge(
        self,
        motion: RobotMotion,
        every: float | None = None,
        tolerances: Tolerances | None = None,
        left: Sequence[str] = (),
        told: Sequence[Fault] = (),
    ) -> ReferenceVerdict:
        """Judges every frame of a motion.

        Args:
            motion: with its joints in the robot's order (`robot_match.matched`).
            every: time between frames whose meshes are judged [s]; by default all are.
            tolerances: what is still no violation.
            left: kinds of faults that its certificate says it was left with.
            told: faults that its certificate tells of, and nothing here can find.
        """
        q = self.robot.configurations(motion.joint_positions)
        capsules, distances = self._judge_capsules(q)
        meshes = None
        if self._mesh_judge is not None:
            step = 1 if every is None else max(1, round(every * motion.rate))
            meshes = self._mesh_judge.judge(q, step)
        names = self.robot.joint_names
        excess, too_fast = limit_excess(motion, self.robot)
        speeds = np.abs(step_speeds(motion))
        jerks = joint_jerks(motion)
        peak = int(np.abs(jerks).max(axis=0).argmax()) if jerks.size else 0
        ground = self._outline.ground_contact(motion)
        return ReferenceVerdict(
            # Of thousands of files the poses of all links would fill the memory.
            motion=replace(motion, extras={}, computed={}),
            capsules=capsules,
            why_no_capsules=self._why_no_capsules,
            capsule_distances=distances,
            meshes=meshes,
            limits=beyond(names, excess, LIMIT_TOLERANCE),
            speeds=beyond(names, too_fast, SPEED_TOLERANCE),
            limit_excess=excess.max(axis=1),
            speed_ratio=(speeds / self.robot.speed_limits).max(axis=1, initial=0.0),
            ground=ground,
            jumps=find_jumps(motion),
            root_acceleration=root_acceleration(motion.root_positions, motion.rate),
            rms_jerk=rms(jerks),
            peak_jerk=float(np.abs(jerks).max(initial=0.0)),
            peak_jerk_joint=names[peak],
            faults=(*find_faults(motion, ground, tolerances), *told),
            left=tuple(left),
        )

    def _judge_capsules(
        self, q_trajectory: np.ndarray
    ) -> tuple[list[PairContact] | None, np.ndarray]:
        distances = np.full(len(q_trajectory), np.nan)
        if self._referee is None:
            return None, distances
        found: dict[int, PairContact] = {}
        for frame, q in enumerate(q_trajectory):
            near = self._referee.distances_below(q, _NEAR)
            smallest = min(near.values(), default=np.inf)
            if smallest < _NEAR:
                distances[frame] = smallest
            for k, distance in near.items():
                if distance < 0.0:
                    pair = found.setdefault(k, PairContact(self._referee.pairs[k]))
                    pair.frames.append(frame)
                    pair.depths.append(-distance)
        return sorted(found.values(), key=lambda pair: -pair.depth), distances


def limit_excess(
    motion: RobotMotion, robot: WholeBody
) -> tuple[np.ndarray, np.ndarray]:
    """(T, n) by how much joints are beyond their limits, and (T - 1, n) on the ways to
    the next frame beyond their speed limits; negative within [rad], [rad/s]."""
    q = motion.joint_positions
    over = np.maximum(robot.lower - q, q - robot.upper)
    return over, np.abs(step_speeds(motion)) - robot.speed_limits


def beyond(
    names: tuple[str, ...], excess: np.ndarray, tolerance: float
) -> tuple[Beyond, ...]:
    """Joints whose (T, n) excess is beyond a tolerance, the farthest first."""
    found = []
    for column in np.flatnonzero((excess > tolerance).any(axis=0)):
        of_joint = excess[:, column]
        found.append(
            Beyond(
                names[column],
                tuple(np.flatnonzero(of_joint > tolerance).tolist()),
                float(of_joint.max()),
                int(of_joint.argmax()),
            )
        )
    return tuple(sorted(found, key=lambda beyond: -beyond.excess))


def frames_of(found: Iterable[PairContact | Beyond]) -> tuple[int, ...]:
    """Frames in which any of them do."""
    return tuple(sorted({frame for each in found for frame in each.frames}))


@dataclass
class FileJudge:
    """Judges files of motions of one robot, one after the other.

    Raises:
        CrarError: the robot cannot be used.
    """

    robot: str  # name or folder
    layout: str | None = None  # of the files; None: each as it looks like
    rate: float | None = None  # frames per second of files; None: as they say [Hz]
    meshes: bool = True  # whether meshes are asked
    # time between the frames in which they are; None: all frames [s]
    every: float | None = None
    tolerances: Tolerances = Tolerances()  # what is no violation

    def __post_init__(self) -> None:
        description = load_robot_description(self.robot).without_ground()
        self._judge = ReferenceJudge(description, self.meshes)

    def __call__(self, file: Path) -> list[ReferenceVerdict]:
        """The verdict on each motion in a file, with what its certificate says.

        Raises:
            CrarError: the file cannot be used.
        """
        judge = self._judge
        motions = read_motions(file, self.layout, self.rate, robot=judge.robot)
        certificate, verdicts = certificate_beside(file) or {"clips": []}, []
        said = {clip["clip"]: clip for clip in certificate["clips"]}
        for motion in motions:
            of_clip = said.get(motion.clip, {"faults": [], "left_as_it_was": []})
            faults = [Fault(*fault) for fault in of_clip["faults"]]
            told = [fault for fault in faults if fault.kind == LIMBS_OFF]
            of = self.every, self.tolerances, of_clip["left_as_it_was"], told
            verdicts.append(judge.judge(motion, *of))
        return verdicts
