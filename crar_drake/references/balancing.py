"""A reference motion changed the least so that the ground could give what it takes.

Root and joints of all frames are found at once, with the unknowns y of `body_points`:

    minimise    1/2 sum_k [ |w x_k|^2 + |W (pose_k(y_k) - pose_k of the reference)|^2
                            + |w tau^2 x''_k|^2 + |v (steps of what stands)|^2 ],

with x the change, and the poses those of feet and hands in the world.

What is kept is kept as `cleaning` does: distances of watched pairs, limits and speeds,
and meshes are parted. Balance is kept with them: rows that hold the centre of pressure
(`trajectory.balance`) inside the support, shrunk by a margin. It may be that no change
keeps them all: their multipliers have a bound.

The supports are those of the reference, but that a foot is lifted while the motion is
balanced on the other (`ground_support.Support.stays`); a further round is of those of
the one before. A motion that keeps a part of the margin comes back bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from crar_drake.motion.quaternion_spline import sign_continuous
from crar_drake.references.cleaning import Cleaner
from crar_drake.references.ground_contact import FEET
from crar_drake.references.ground_support import Ground, Support
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.robot.description import find_body, find_frame
from crar_drake.robot_import.link_outlines import links_outward
from crar_drake.trajectory.balance import (
    Balance,
    half_planes,
    point_masses,
)
from crar_drake.trajectory.body_points import ROOT, Placed, model_of_links
from crar_drake.trajectory.optimiser import AtFrames, Problem, Wide

_ROUNDS = 4  # feet that were changed are planted in other frames
_KEPT = 0.3  # share of the margin within which a frame is left alone


@dataclass(frozen=True)
class BalancingParameters:
    """What changing the least means."""

    joint_weight: float = 1.0  # w of each joint [m/rad]
    root_weight: float = 1.0  # of the root's place [1],
    root_turn_weight: float = 1.0  # and of its turn [m/rad]
    foot_weight: float = 50.0  # of the feet's places [1],
    foot_turn_weight: float = 10.0  # and of their turns [m/rad]
    # of the steps of what stands, from a frame to the next [1]
    standing_weight: float = 200.0
    hand_weight: float = 1.0  # of the hands' places [1],
    carrying_weight: float = 35.0  # and of hands that carry [1]
    # tau; changes that come and go within this time cost more [s]
    smoothing: float = 0.08
    # square root of the last penalty of how far the centre of pressure is outside [1],
    balance_weight: float = 60.0
    most: float = 1e3  # and the largest multiplier of that [m]
    margin: float = 0.015  # by which supports are shrunk [m]


class Balancer:
    """Balances motions of one robot at one rate."""

    def __init__(
        self,
        cleaner: Cleaner,
        ground: Ground,
        parameters: BalancingParameters | None = None,
    ) -> None:
        """
        Args:
            cleaner: of the robot, whose constraints are kept.
            ground: under it.
            parameters: what changing the least means.
        """
        self.parameters = parameters or BalancingParameters()
        self._cleaner, self._ground = cleaner, ground
        model, description = cleaner.model, cleaner.description
        plant = model.plant
        base = find_body(plant, description.base)
        self._links = list(links_outward(plant, base.body_frame()))
        self._poses = model_of_links(description, self._links)
        self._masses = point_masses(plant, self._links)
        self._rest = model.rest_positions()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, self._rest)
        X_WB = base.EvalPoseInWorld(context)
        self._base = X_WB.translation(), X_WB.rotation().matrix()

    def balance(
        self,
        motion: RobotMotion,
        carries: np.ndarray,
        progress: Callable[[int], None] | None = None,
    ) -> RobotMotion:
        """The motion, balanced.

        Args:
            motion: with its joints in the order of the robot.
            carries: (T, H) how much each hand carries the robot, from 0 to 1.
            progress: is called with the number of frames that are done.
        """
        if motion.num_frames < 3:
            return motion  # none has a frame before and one after
        for _ in range(_ROUNDS):
            support, was = self._ground.support(motion), motion
            motion = self._balanced(was, support, carries, progress)
            if motion is was:
                break
        return motion

    def _balanced(
        self,
        motion: RobotMotion,
        support: Support,
        carries: np.ndarray,
        progress: Callable[[int], None] | None,
    ) -> RobotMotion:
        """The motion balanced on a support, or itself."""
        cleaner = self._cleaner
        columns = [motion.joint_names.index(x) for x in cleaner.model.joint_names]
        y = np.zeros((motion.num_frames, ROOT + len(columns)))
        y[:, ROOT:] = motion.joint_positions[:, columns]
        problem = self.problem(motion, support, carries, y)
        found, _, _ = cleaner.keeper.keep(
            problem, y, progress=progress, meshes=cleaner.meshes
        )
        changed = (found != y).any(axis=1)
        if not changed.any():
            return motion
        joints, places = motion.joint_positions.copy(), motion.root_positions.copy()
        quaternions = motion.root_quaternions.copy()
        joints[:, columns] = found[:, ROOT:]
        places += found[:, :3]
        turned = Rotation.from_rotvec(found[:, 3:ROOT]) * motion.root_rotations
        turned = sign_continuous(turned.as_quat())[:, [3, 0, 1, 2]]
        # As the file has their signs.
        turned *= np.where((turned * quaternions).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
        quaternions[changed] = turned[changed]
        return replace(
            motion,
            root_positions=places,
            root_quaternions=quaternions,
            joint_positions=joints,
        )

    def problem(
        self, motion: RobotMotion, support: Support, carries: np.ndarray, y: np.ndarray
    ) -> Problem:
        """What is minimised.

        Args:
            motion, carries: as of `balance`.
            support: of the motion.
            y: (T, 6 + n) its unknowns.
        """
        p, model = self.parameters, self._cleaner.model
        nowhere = np.full(ROOT, np.inf)
        weight = np.full(y.shape[1], p.joint_weight)
        weight[:3], weight[3:ROOT] = p.root_weight, p.root_turn_weight
        roots = motion.root_positions, motion.root_rotations.as_matrix()
        every = np.arange(motion.num_frames)
        turned = Slerp(every, motion.root_rotations)

        def placed(frames: np.ndarray, y: np.ndarray) -> Placed:
            p_0, R_0 = (x[frames] for x in roots)
            return Placed(self._poses, self._rest, self._base, p_0, R_0, y)

        def on_ways(times: np.ndarray, y: np.ndarray) -> Placed:
            p_0 = np.column_stack([np.interp(times, every, x) for x in roots[0].T])
            R_0 = turned(times).as_matrix()
            return Placed(self._poses, self._rest, self._base, p_0, R_0, y)

        points = support.points()
        rows, kept = (
            Balance(
                on_ways,
                self._masses,
                half_planes(points, support.floor, share * p.margin),
                support.goes_on,
                motion.rate,
            )
            for share in (1.0, _KEPT)
        )
        keeper = self._cleaner.keeper
        return Problem(
            tasks=self._tasks(placed, support, carries, y),
            posture=y.copy(),
            posture_weight=weight,
            about=y.copy(),
            smoothness=weight * (p.smoothing * motion.rate) ** 2,
            lower=np.concatenate([-nowhere, model.lower]),
            upper=np.concatenate([nowhere, model.upper]),
            fastest=np.concatenate([nowhere, self._cleaner.fastest]),
            near_rows=keeper.near_rows,
            num_rows=keeper.num_rows,
            wide=Wide(
                rows, kept, rows.num_rows, rows.width, p.balance_weight**2, p.most
            ),
        )

    def _tasks(self, placed, support: Support, carries: np.ndarray, y: np.ndarray):
        p, cleaner = self.parameters, self._cleaner
        frames = cleaner.description.task_frames
        plant, links, offsets, linear, turn = cleaner.model.plant, [], [], [], []
        planted = []
        for name in cleaner.frames:
            frame = find_frame(plant, frames[name])
            links.append(self._links.index(frame.body().name()))
            offsets.append(frame.GetFixedPoseInBodyFrame().translation())
            planted.append(support.planted.get(name, np.zeros(len(y), dtype=bool)))
            if name in FEET:
                linear.append(np.full(len(y), p.foot_weight))
                turn.append(np.full(len(y), p.foot_turn_weight))
            else:
                share = carries[:, cleaner.hands.index(name)]
                linear.append((1.0 - share) * p.hand_weight + share * p.carrying_weight)
                turn.append(np.zeros(len(y)))
        return _KeptInWorld(
            placed,
            links,
            np.array(offsets),
            y,
            np.stack(linear, axis=1),
            np.stack(turn, axis=1),
            p.standing_weight * np.stack(planted, axis=1),
        )


class _KeptInWorld:
    """Links that are to stay where a reference has them, while the root moves."""

    def __init__(self, placed, links, offsets, y, linear, turn, standing) -> None:
        """
        Args:
            placed: the links at some frames, of their unknowns.
            links, offsets: (L,), (L, 3) [m] of the points.
            y: (T, 6 + n) the reference.
            linear, turn: (T, L) weights [1], [m/rad].
            standing: (T, L) of their steps; 0 where they do not stand.
        """
        self._placed, self._links, self._offsets = placed, links, offsets
        self._linear, self._turn = linear[..., None], turn[..., None]
        reference = placed(np.arange(len(y)), y)
        self._p, _ = reference.points(links, offsets)
        self._R, _ = reference.turns(links)
        self.steps = np.diff(self._p, axis=0).reshape(len(y) - 1, -1)
        both = np.minimum(standing[1:], standing[:-1])
        self.step_weights = np.repeat(both, 3, axis=1)

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        placed, K = self._placed(frames, y), len(y)
        p, Jp = placed.points(self._links, self._offsets)
        R, JR = placed.turns(self._links)
        turned = Rotation.from_matrix(
            (R @ self._R[frames].swapaxes(-1, -2)).reshape(-1, 3, 3)
        ).as_rotvec()
        r, jacobians = [], []
        for error, J, weight in (
            (p - self._p[frames], Jp, self._linear[frames]),
            (turned.reshape(p.shape), JR, self._turn[frames]),
        ):
            r.append((weight * error).reshape(K, -1))
            jacobians.append((weight[..., None] * J).reshape(K, -1, y.shape[1]))
        return AtFrames(
            np.concatenate(r, axis=1),
            np.concatenate(jacobians, axis=1),
            p.reshape(K, -1),
            Jp.reshape(K, -1, y.shape[1]),
        )
