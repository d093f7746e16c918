"""What a reference motion does to its robot: collisions, limits, ground, smoothness.

Nothing here is the controller's: capsules are judged by the referee, meshes by
`MeshJudge`. The root stands still for both, since only the joints decide whether the
robot meets itself; its pose counts against the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crar_drake.errors import ModelError
from crar_drake.judging.mesh_judge import MeshJudge, MeshVerdict
from crar_drake.judging.referee import Referee
from crar_drake.references.faults import Fault, Tolerances, find_faults
from crar_drake.references.ground_contact import FootSlip, Outline
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.smoothness import (
    Jump,
    find_jumps,
    joint_jerks,
    root_acceleration,
    step_speeds,
)
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import (
    LIMIT_TOLERANCE,
    SPEED_TOLERANCE,
    RobotDescription,
)
from crar_drake.robot_import.link_meshes import check_installed, has_meshes

# Capsules that are farther apart are not plotted [m].
_NEAR = 0.05


@dataclass(frozen=True)
class PairFrames:
    """Two links that penetrate each other."""

    pair: tuple[str, str]  # the links
    frames: tuple[int, ...]  # in which they do, from 0
    depths: tuple[float, ...]  # how deep in each [m]

    @property
    def depth(self) -> float:
        """The deepest [m]."""
        return max(self.depths)

    @property
    def frame(self) -> int:
        """Of the deepest."""
        return self.frames[int(np.argmax(self.depths))]


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
    capsules: tuple[PairFrames, ...] | None
    why_no_capsules: str  # why they are not, or ""
    capsule_distances: np.ndarray  # (T,) the smallest; NaN beyond 5 cm [m]
    mesh_frames: np.ndarray  # (K,) the frames in which the meshes were judged
    meshes: MeshVerdict | None  # what they said; None where they were not asked
    # pairs of meshes that penetrate, the deepest first
    mesh_pairs: tuple[PairFrames, ...]
    limits: tuple[Beyond, ...]  # joints beyond their limits, the farthest first
    speeds: tuple[Beyond, ...]  # and beyond their speed limits
    # (T,) the largest of all joints, negative within [rad or m]
    limit_excess: np.ndarray
    # (T - 1,) the largest share of a speed limit; 0 without any
    speed_ratio: np.ndarray
    lowest: np.ndarray  # (T,) height of the lowest point [m]
    lowest_link: str  # where it is lowest of all
    floor: float  # height of the feet when they are lowest [m]
    feet: tuple[FootSlip, ...]  # what each does on the floor
    jumps: tuple[Jump, ...]  # in the order of their frames
    root_acceleration: tuple[float, float]  # rms and largest [m/s^2]
    rms_jerk: float  # of all joints [rad/s^3]
    peak_jerk: float  # the largest of any joint [rad/s^3]
    peak_jerk_joint: str  # where it is
    faults: tuple[Fault, ...]  # what else is wrong with it
    # kinds of faults that its certificate says it was left with
    left: tuple[str, ...] = ()

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
        depths = dict.fromkeys(self.mesh_frames.tolist(), 0.0)
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
        plant, graph = self.robot.plant, self.robot.scene_graph
        self._mesh_judge = None
        if meshes and has_meshes(plant, graph):
            check_installed()
            self._mesh_judge = MeshJudge(description)
        self._referee, self._why_no_capsules = None, ""
        try:
            self._referee = Referee(
                plant, graph, description.pairs, self.robot.plant_speed_limits()
            )
        except ModelError as error:
            self._why_no_capsules = str(error)
        if not description.pairs:
            self._referee, self._why_no_capsules = None, "no pairs are watched"
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
        step = 1 if every is None else max(1, round(every * motion.rate))
        mesh_frames = np.arange(0, motion.num_frames, step)
        meshes, mesh_pairs = None, ()
        if self._mesh_judge is not None:
            meshes = self._mesh_judge.judge(q[mesh_frames])
            mesh_pairs = tuple(
                PairFrames(
                    contact.pair,
                    tuple(int(mesh_frames[i]) for i in contact.samples),
                    contact.depths,
                )
                for contact in meshes.penetrations
            )
        names = self.robot.joint_names
        excess = np.maximum(
            self.robot.lower - motion.joint_positions,
            motion.joint_positions - self.robot.upper,
        )
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
            mesh_frames=mesh_frames,
            meshes=meshes,
            mesh_pairs=mesh_pairs,
            limits=_beyond(names, excess, LIMIT_TOLERANCE),
            speeds=_beyond(names, speeds - self.robot.speed_limits, SPEED_TOLERANCE),
            limit_excess=excess.max(axis=1),
            speed_ratio=(speeds / self.robot.speed_limits).max(axis=1, initial=0.0),
            lowest=ground.lowest,
            lowest_link=ground.lowest_links[int(ground.lowest.argmin())],
            floor=ground.floor,
            feet=ground.feet,
            jumps=find_jumps(motion),
            root_acceleration=root_acceleration(motion.root_positions, motion.rate),
            rms_jerk=float(np.sqrt(np.mean(jerks**2))) if jerks.size else 0.0,
            peak_jerk=float(np.abs(jerks).max(initial=0.0)),
            peak_jerk_joint=names[peak],
            faults=(*find_faults(motion, ground, tolerances), *told),
            left=tuple(left),
        )

    def _judge_capsules(
        self, q_trajectory: np.ndarray
    ) -> tuple[tuple[PairFrames, ...] | None, np.ndarray]:
        distances = np.full(len(q_trajectory), np.nan)
        if self._referee is None:
            return None, distances
        found: dict[int, dict[int, float]] = {}
        for frame, q in enumerate(q_trajectory):
            near = self._referee.distances_below(q, _NEAR)
            smallest = min(near.values(), default=np.inf)
            if smallest < _NEAR:
                distances[frame] = smallest
            for pair, distance in near.items():
                if distance < 0.0:
                    found.setdefault(pair, {})[frame] = -distance
        pairs = [
            PairFrames(self._referee.pairs[pair], tuple(depths), tuple(depths.values()))
            for pair, depths in found.items()
        ]
        return tuple(sorted(pairs, key=lambda pair: -pair.depth)), distances


def _beyond(
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


def frames_of(found: tuple[PairFrames | Beyond, ...]) -> tuple[int, ...]:
    """Frames in which any of them do."""
    return tuple(sorted({frame for each in found for frame in each.frames}))
