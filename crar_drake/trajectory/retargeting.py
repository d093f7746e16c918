"""A performer's motion on a whole robot, root and joints of all frames at once.

    minimise    sum_k  |w_limb (u_robot - u_performer)|^2     of each limb's direction
                     + |w_root (p_WR - target)|^2 + |w_turn turn of the root|^2
                     + |w_foot (soles' corners - targets)|^2 + |w_hand turn|^2
                     + |w_posture (q - rest)|^2 + |second differences|^2, of the root
                       of what differs from the person's, scaled,
                     + |w_stand (steps of heels and balls that stand)|^2
    such that   watched pairs, joint limits and speeds are kept, elbows and knees bend
                as a person's, and nothing is below the floor.

Unknowns of a frame are those of `body_points`: a metre is no radian, so that the root's
second differences have weights of their own. Else feet that are held shake it. The
motion is begun with limbs alone: feet pull a leg that points elsewhere to where it
cannot turn back from. Where limbs went astray all the same they are solved again from
a straight way past it.

Windows alone are solved (`keeping`), so that a foot without room slips where a window
cuts its contact. Contacts that slip are solved again as a whole, and may be elsewhere.
The motion that is found is cleaned (`references.cleaning`), which certifies it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from pydrake.multibody.tree import Frame
from scipy.spatial.transform import Rotation

from crar_drake.errors import ModelError
from crar_drake.law.compilation import compiled
from crar_drake.motion.leaps import leaps
from crar_drake.motion.performer import SIDES, Performer
from crar_drake.motion.performer_legs import LegShape
from crar_drake.motion.planted_feet import lasting, runs
from crar_drake.motion.smooth_steps import smooth_flags
from crar_drake.robot.description import RobotDescription, find_body, find_frame
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.robot_import.link_outlines import (
    LinkOutline,
    link_outlines,
    links_outward,
)
from crar_drake.trajectory.body_points import (
    ROOT,
    Placed,
    lowest_points,
    model_of_links,
)
from crar_drake.trajectory.distance_rows import (
    NearRows,
    join_rows,
)
from crar_drake.trajectory.keeping import COARSE, Keeper, Meshes
from crar_drake.trajectory.optimiser import AtFrames, Effort, Problem, Samples, spread
from crar_drake.trajectory.performer_targets import (
    LIMBS,
    PerformerTargets,
    performer_targets,
)

# Points of a foot at rest within this of its lowest one are its sole [m].
_SOLE = 0.01
# Directions in which a link's farthest point is one that can be the lowest.
_OF_FEET, _OF_LINKS = 512, 64

# The ends of a foot count more, since they would slip else, the lower they are than
# this [m], if they are slower than this [m/s] or the foot stands within this time [s].
_LOW, _SLOW, _SOON = 0.08, 0.5, 0.2
# Soles that stand are wanted so high, for nothing to be below the floor [m].
_ABOVE = 4e-4
# Within this time before and after both stand, legs part by what they are asked to be
# farther apart [s].
_PARTING = 0.15
# Limbs, but the head, that point elsewhere than the person's by more than this [rad]
# for longer than this [s] went astray: they are solved again from the straight way past
# it.
_ASTRAY, _ASTRAY_FOR = np.pi / 4.0, 0.2
# So did joints whose step is by so much faster than both beside it [rad/s].
_JUMP = 14.0
# Feet that slip by more in a contact may stand elsewhere [m], and their steps are held
# by so much more.
MOST_SLIP, _HELD_MORE = 2e-3, 5.0
# Beyond straight, or over-stretched, by so much at most [rad].
_STRETCHED = 0.02


@dataclass(frozen=True)
class RetargetingParameters:
    """What the performer's motion counts for."""

    limb: float = 1.0  # of a limb's direction [1]
    head: float = 0.2  # of the head's [1]
    root: float = 1.0  # of the root's place on the floor [1/m]
    root_height: float = 0.3  # of its height [1/m]
    turn: float = 1.0  # of how the root is turned [1/rad]
    foot: float = 1.5  # of heels and balls on the floor plane, in the air [1/m],
    planted: float = 60.0  # and standing [1/m]
    foot_height: float = 2.0  # of the heights of the soles' corners, in the air [1/m],
    planted_height: float = 100.0  # and standing [1/m]
    standing: float = 2e3  # of the steps of what stands, from a frame to the next [1/m]
    hand: float = 0.4  # of how the hands are turned, by their axes [1]
    posture: float = 0.03  # of the rest posture [1/rad]
    smoothing: float = 0.02  # motions that come and go within this time cost more [s],
    change_smoothing: float = 0.08  # as do changes by which constraints are kept [s]
    # of how much else than the person's, scaled, the root accelerates [s^2/m], and its
    # turn does [s^2/rad]
    root_acceleration: float = 0.07
    turn_acceleration: float = 0.005
    cutoff: float = 6.0  # of the low-pass of the performer [Hz]
    floor: float = 4e-3  # distance that watched pairs keep at each frame [m],
    floor_between: float = 0.5e-3  # and on the straight way to the next [m]
    # by how much farther apart legs are asked to be while one is in the air [m]: where
    # they pass each other fast, nothing that looks ahead has to evade. Feet that both
    # stand are not moved by it.
    between_legs: float = 0.02


@dataclass(frozen=True)
class Retargeted:
    """A robot's motion, T frames of n joints."""

    root_positions: np.ndarray  # (T, 3) p_WR [m]
    root_rotations: np.ndarray  # (T, 3, 3) R_WR
    q: np.ndarray  # (T, n) positions of the controlled joints [rad or m]
    violating: np.ndarray  # (T,) frames that still violate something
    targets: PerformerTargets  # what the performer asked for
    effort: Effort  # that it took


class Retargeter:
    """Retargets performers to one robot.

    Attributes:
        description: of the robot.
        model: the robot with its root fixed, and its watched pairs.
        parameters: what is wanted.
        legs: side to the leg's lengths and sole.
        soles: side to the corners of its sole, see `performer_targets`.
    """

    def __init__(
        self,
        description: RobotDescription,
        parameters: RetargetingParameters | None = None,
        outlines: dict[str, LinkOutline] | None = None,
    ) -> None:
        """
        Args:
            description: of a robot with legs and arms, imported as a whole body.
            parameters: what is wanted.
            outlines: of its links, if they were found already.

        Raises:
            ModelError: it lacks a task frame, or its feet have no shape.
        """
        self.parameters = parameters or RetargetingParameters()
        self.description = description
        frames = description.task_frames
        needed = {end for _, ends in LIMBS.values() for end in ends} - {"head"}
        missing = sorted(needed - set(frames))
        if missing:
            raise ModelError(
                f"robot {description.name}: following a person needs the task_frames "
                f"{', '.join(missing)}; add them to its robot.yaml (frames of an "
                "import.yaml)"
            )
        fixed = replace(description, root="fixed")
        some = [Task(frame=frames["waist"])]
        self.model = ControlModel.FromDescription(fixed, some)
        plant = self.model.plant
        if outlines is None:
            outlines = link_outlines(plant, self.model.scene_graph)
        self._outlines = outlines
        carrying = {self.frame(name).body().name() for name in frames}
        self._links = sorted(carrying | set(self._outlines))
        self._poses = model_of_links(description, self._links)
        self.rest = self.model.rest_positions()
        self._last = None, np.zeros(1, dtype=int), np.zeros((1, 0)), None
        self._keeper: Keeper | None = None
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, self.rest)
        self._context = context
        X_WB = find_body(plant, description.base).EvalPoseInWorld(context)
        self._base = X_WB.translation(), X_WB.rotation().matrix()
        self.legs = {side: self._leg(side) for side in SIDES}
        self.soles = {
            side: _sole_corners(leg.points) for side, leg in self.legs.items()
        }
        self._set_floor_points()
        self._lower, self._upper = self._bent_as_a_person()

    def retarget(
        self,
        performer: Performer,
        rate: float,
        progress: Callable[[int], None] | None = None,
        meshes: Meshes | None = None,
    ) -> Retargeted:
        """A performer's motion on the robot.

        Args:
            performer: with legs.
            rate: frames per second [Hz].
            progress: is called with the number of frames that are done.
            meshes: of the robot's links, which are parted where they touch.

        Raises:
            MotionError: the performer lacks something.
        """
        p = self.parameters
        targets = performer_targets(
            performer, self.legs, self.soles, self._base[1], rate, p.cutoff
        )
        # Not every robot has a head.
        own = set(self.description.task_frames)
        directions = {
            limb: way
            for limb, way in targets.directions.items()
            if own.issuperset(LIMBS[limb][1])
        }
        targets = replace(targets, directions=directions)
        frames, n = len(targets.root_positions), self.model.n
        y = np.zeros((frames, ROOT + n))
        rest = self.rest[self.model.controlled_positions]
        y[:, ROOT:] = np.clip(rest, self._lower, self._upper)
        keeper = self._keeper_of(rate)
        problem = self._problem(targets, keeper, y)
        effort = Effort()
        limbs = replace(problem, tasks=problem.tasks.without_feet())
        for each, every in ((limbs, COARSE), (problem, COARSE), (problem, 1)):
            y = keeper.found_without_rows(each, y, effort, every)
        problem = replace(
            problem, about=y, smoothness=self._smoothness(p.change_smoothing, rate)
        )
        y, violating, effort = keeper.keep(problem, y, effort, progress)
        tasks, astray = problem.tasks, problem.tasks.astray(y)
        # Past it of this motion, then of the one that knows no constraints.
        for whose in (y, problem.about):
            around = spread(astray, round(_ASTRAY_FOR * rate))
            # Nothing is bridged to where all frames are astray.
            if not astray.any() or around.all():
                break
            start = np.where(around[:, np.newaxis], bridged(whose, around), y)
            other = replace(problem, about=start)
            again, still, effort = keeper.keep(other, start, effort, progress, astray)
            left = tasks.astray(again)
            if left.sum() < astray.sum() and still.sum() <= violating.sum():
                y, violating, problem, astray = again, still, other, left
        slip = tasks.slip(y)
        if slip > 0.0:
            slipping = tasks.let_slipping_go(y)
            again, still, effort = keeper.keep(problem, y, effort, progress, slipping)
            if tasks.slip(again) < slip and still.sum() <= violating.sum():
                y, violating = again, still
        if meshes is not None:
            y, violating, effort = keeper.keep(problem, y, effort, meshes=meshes)
        turned = Rotation.from_rotvec(y[:, 3:ROOT]).as_matrix()
        return Retargeted(
            targets.root_positions + y[:, :3],
            turned @ targets.root_rotations,
            y[:, ROOT:],
            violating,
            targets,
            effort,
        )

    def ways(
        self,
        root_positions: np.ndarray,
        root_rotations: np.ndarray,
        q: np.ndarray,
        ends: Sequence[tuple[str, str]],
    ) -> list[np.ndarray]:
        """From one task frame to another, (T, 3) of each pair [m].

        Args:
            root_positions, root_rotations: (T, 3) p_WR [m], (T, 3, 3) R_WR.
            q: (T, n) positions of the controlled joints.
            ends: pairs of task frames.
        """
        y = np.hstack([np.zeros((len(q), ROOT)), q])
        placed = Placed(
            self._poses, self.rest, self._base, root_positions, root_rotations, y
        )
        found = []
        for pair in ends:
            points, _ = placed.points(*self.frame_points(pair))
            found.append(points[:, 1] - points[:, 0])
        return found

    def placed(
        self, targets: PerformerTargets, frames: np.ndarray, y: np.ndarray
    ) -> Placed:
        """The links at some frames."""
        found = Placed(
            self._poses,
            self.rest,
            self._base,
            targets.root_positions[frames],
            targets.root_rotations[frames],
            y,
        )
        self._last = targets, frames, y, found
        return found

    def placed_before(
        self, targets: PerformerTargets, frames: np.ndarray, y: np.ndarray
    ) -> tuple[Placed, np.ndarray]:
        """The links at frames, and which of its frames these are: the last that were
        placed, if they are among them."""
        known, at, of, found = self._last
        k = np.minimum(np.searchsorted(at, frames), len(at) - 1)
        same = known is targets and np.array_equal(at[k], frames)
        if same and np.array_equal(of[k], y):
            return found, k
        return self.placed(targets, frames, y), np.arange(len(frames))

    def frame(self, name: str) -> Frame:
        """A task frame in the model."""
        return find_frame(self.model.plant, self.description.task_frames[name])

    def frame_points(self, names: Sequence[str]) -> tuple[list[int], np.ndarray]:
        """Of task frames: (P,) their links, and (P, 3) where they are on them [m]."""
        links, offsets = [], []
        for name in names:
            frame = self.frame(name)
            links.append(self._links.index(frame.body().name()))
            offsets.append(frame.GetFixedPoseInBodyFrame().translation())
        return links, np.array(offsets)

    def _problem(
        self, targets: PerformerTargets, keeper: Keeper, y: np.ndarray
    ) -> Problem:
        p, n, rate = self.parameters, self.model.n, targets.rate
        nowhere = np.full(ROOT, np.inf)
        fastest = self.model.velocity_limits[self.model.controlled]
        fastest = fastest / rate
        weight = np.concatenate([np.zeros(ROOT), np.full(n, p.posture)])
        return Problem(
            tasks=PersonTasks(self, targets),
            posture=y.copy(),
            posture_weight=weight,
            about=np.zeros_like(y),
            smoothness=self._smoothness(p.smoothing, rate),
            lower=np.concatenate([-nowhere, self._lower]),
            upper=np.concatenate([nowhere, self._upper]),
            fastest=np.concatenate([nowhere, fastest]),
            near_rows=NearRowsAndFloor(self, targets, keeper),
            num_rows=keeper.num_rows + len(self.floor_points[0]),
        )

    def _smoothness(self, time: float, rate: float) -> np.ndarray:
        """(m,) weights of second differences, of joints by a time [s]."""
        p = self.parameters
        of_root = np.repeat([p.root_acceleration, p.turn_acceleration], 3)
        joints = np.full(self.model.n, time**2)
        return rate**2 * np.concatenate([of_root, joints])

    def _keeper_of(self, rate: float) -> Keeper:
        """Making one takes a tenth of a second: the last one is kept."""
        if self._keeper is None or self._keeper.rate != rate:
            p = self.parameters
            keeper = Keeper(self.model, rate, p.floor, p.floor_between)
            keeper.room[self._between_legs()] = p.between_legs
            self._keeper = keeper
        return self._keeper

    def _between_legs(self) -> np.ndarray:
        """Which pairs of shapes are of both legs."""
        left, right = (set(self._outward(f"{side}_hip")) for side in SIDES)
        of_pairs = np.array(
            [
                (a in left and b in right) or (a in right and b in left)
                for a, b in self.description.pairs
            ],
            dtype=bool,
        )
        return of_pairs[self.model.pairs.pair_of_shapes]

    def _outward(self, name: str) -> list[str]:
        """The links from a task frame's on."""
        return links_outward(self.model.plant, self.frame(name))

    def _place(self, name: str) -> np.ndarray:
        """(3,) where a task frame is at rest [m]."""
        return self.frame(name).CalcPoseInWorld(self._context).translation()

    def _leg(self, side: str) -> LegShape:
        plant = self.model.plant
        hip, knee, ankle = (self._place(f"{side}_{x}") for x in ("hip", "knee", "foot"))
        points = []
        for link in self._outward(f"{side}_foot"):
            if link in self._outlines:
                outline = self._outlines[link]
                X_WL = plant.GetBodyByName(link).EvalPoseInWorld(self._context)
                down = outline.radii[:, None] * [0.0, 0.0, 1.0]
                points.append(X_WL.multiply(outline.points.T).T - down - ankle)
        if not points:
            raise ModelError(
                f"robot {self.description.name}: {side}_foot: nothing from this "
                "frame's link on has a mesh, capsule or sphere, so that there is no "
                "sole to stand on"
            )
        points = np.concatenate(points)
        corners = _sole_corners(points)
        thigh, shank = np.linalg.norm(knee - hip), np.linalg.norm(ankle - knee)
        return LegShape(
            hip=hip - self._base[0],
            thigh=float(thigh),
            shank=float(shank),
            points=points,
            heel=corners[:2].mean(axis=0),
            ball=corners[2:].mean(axis=0),
        )

    def sole_points(self) -> tuple[list[int], np.ndarray]:
        """Heel and ball of each foot, left then right, and then the corners of the
        soles: (12,) their links, and (12, 3) where they are on them [m]."""
        links, offsets = [], []
        ends = {side: np.array([leg.heel, leg.ball]) for side, leg in self.legs.items()}
        for side, corners in (*ends.items(), *self.soles.items()):
            body = self.frame(f"{side}_foot").body()
            X_WL = body.EvalPoseInWorld(self._context)
            ankle = self._place(f"{side}_foot")
            links += [self._links.index(body.name())] * len(corners)
            offsets.append(X_WL.inverse().multiply((ankle + corners).T).T)
        return links, np.concatenate(offsets)

    def _set_floor_points(self) -> None:
        """Which links have a shape (K,), the points that can be their lowest (N, 3)
        with the radii of balls about them (N,) [m], and where those of each link begin
        (K + 1,)."""
        rng = np.random.default_rng(0)
        directions = rng.normal(size=(_OF_FEET, 3))
        feet = {link for side in SIDES for link in self._outward(f"{side}_foot")}
        links, points, radii, first = [], [], [], [0]
        for link, outline in self._outlines.items():
            count = _OF_FEET if link in feet else _OF_LINKS
            far = outline.points @ directions[:count].T + outline.radii[:, None]
            some = np.unique(far.argmax(axis=0))
            links.append(self._links.index(link))
            points.append(outline.points[some])
            radii.append(outline.radii[some])
            first.append(first[-1] + len(some))
        self.floor_points = (
            np.array(links),
            np.concatenate(points),
            np.concatenate(radii),
            np.array(first),
        )

    def _bent_as_a_person(self) -> tuple[np.ndarray, np.ndarray]:
        """(n,) limits of the joints, elbows and knees beyond straight on one side."""
        model = self.model
        lower, upper = model.lower.copy(), model.upper.copy()
        # From a straight limb the lower part goes ahead at an elbow, back at a knee.
        for chain, ahead in (
            (("shoulder", "elbow", "wrist"), 1.0),
            (("hip", "knee", "foot"), -1.0),
        ):
            for side in SIDES:
                found = self._hinge([f"{side}_{x}" for x in chain])
                if found is None:
                    continue
                joint, straight, sense = found
                if ahead * sense > 0.0:
                    lower[joint] = max(lower[joint], straight - _STRETCHED)
                else:
                    upper[joint] = min(upper[joint], straight + _STRETCHED)
        return lower, upper

    def _hinge(self, chain: Sequence[str]) -> tuple[int, float, float] | None:
        """The joint that bends a limb: which, where the limb is straight, and whether
        from there the end goes ahead as it turns; None if it does not say."""
        model, plant = self.model, self.model.plant
        context = plant.CreateDefaultContext()
        frames = [self.frame(name) for name in chain]

        def places(q: np.ndarray) -> list[np.ndarray]:
            plant.SetPositions(context, q)
            return [frame.CalcPoseInWorld(context).translation() for frame in frames]

        # Which velocities move some of the frames, not all: others bend no limb.
        carried = [model.joints.place(frame.body())[0] for frame in frames]
        moves_some = np.ptp(model.joints.moved_by[carried].astype(int), axis=0) > 0
        best = None
        for i, column in enumerate(model.controlled_positions):
            if not moves_some[model.controlled[i]]:
                continue
            # A joint without limits may be a hinge, too.
            low, high = np.nan_to_num(
                [model.lower[i], model.upper[i]], neginf=-np.pi, posinf=np.pi
            )
            values = np.linspace(low, high, 61)
            angles, middles, ends = [], [], []
            for value in values:
                q = self.rest.copy()
                q[column] = value
                a, b, c = places(q)
                cosine = (b - a) @ (c - b)
                cosine /= np.linalg.norm(b - a) * np.linalg.norm(c - b)
                angles.append(np.arccos(np.clip(cosine, -1.0, 1.0)))
                middles.append(b)
                ends.append(c)
            moves = np.ptp(np.array(middles), axis=0).max()
            bends = np.ptp(angles)
            if moves > 1e-6 or bends < 0.5 or (best and bends <= best[0]):
                continue
            k = int(np.argmin(angles))
            ahead = np.gradient(np.array(ends)[:, 0], values)[k]
            best = bends, i, float(values[k]), float(ahead)
        if best is None or abs(best[3]) < 0.02:
            return None
        return best[1:]


def _sole_corners(points: np.ndarray) -> np.ndarray:
    """(4, 3) of the sole of a foot's points (V, 3), two of the heel, then two of the
    ball [m]."""
    z = points[:, 2].min()
    sole = points[points[:, 2] <= z + _SOLE, :2]
    ends = np.stack([sole.min(axis=0), sole.max(axis=0)])
    return np.array([[x, y, z] for x in ends[:, 0] for y in ends[:, 1]])


def bridged(y: np.ndarray, some: np.ndarray) -> np.ndarray:
    """A motion (T, m) that goes straight past some frames (T,), not all."""
    y, others = y.copy(), np.flatnonzero(~some)
    for column in y.T:
        column[some] = np.interp(np.flatnonzero(some), others, column[others])
    return y


class PersonTasks:
    """What a performer asks for, as residuals; see the module."""

    def __init__(self, robot: Retargeter, targets: PerformerTargets) -> None:
        self._robot, self._targets = robot, targets
        p, rate = robot.parameters, targets.rate
        limbs = list(targets.directions)
        ends = [LIMBS[limb][1] for limb in limbs]
        self._limb_weights = np.array(
            [p.head if limb == "head" else p.limb for limb in limbs]
        )
        self._directions = np.stack([targets.directions[x] for x in limbs], axis=1)
        starts, tips = zip(*ends, strict=True)
        start_links, start_offsets = robot.frame_points(starts)
        tip_links, tip_offsets = robot.frame_points(tips)
        sole_links, sole_offsets = robot.sole_points()
        self._links = [*start_links, *tip_links, *sole_links]
        self._offsets = np.concatenate([start_offsets, tip_offsets, sole_offsets])
        feet = [targets.feet[side] for side in robot.legs]
        self._ends = np.stack([x for f in feet for x in (f.heel, f.ball)], axis=1)
        on = np.stack([x for f in feet for x in (f.on_heel, f.on_ball)], axis=1)
        heights = np.stack([f.heights for f in feet], axis=1)  # (T, 2, 4)
        self._heights = heights.reshape(len(on), -1) + _ABOVE
        on_it = [smooth_flags(f.on_heel | f.on_ball, round(_SOON * rate)) for f in feet]
        steps = np.diff(self._ends, axis=0, prepend=self._ends[:1])
        slow = 1.0 - rate * np.linalg.norm(steps, axis=2) / _SLOW
        low = np.clip(1.0 - self._ends[..., 2] / _LOW, 0.0, 1.0)
        near = low * np.clip(slow, np.repeat(on_it, 2, axis=0).T, 1.0)
        near = np.where(on, 1.0, near)
        weights = p.foot + near * (p.planted - p.foot)
        self._end_weights = np.repeat(weights, 2, axis=1)
        weights = p.foot_height + near * (p.planted_height - p.foot_height)
        self._height_weights = np.repeat(weights, 2, axis=1)

        steps = np.diff(self._ends[..., :2], axis=0)
        down = on.reshape(len(on), 2, 2)  # heel and ball of each foot
        stands = down[1:] & down[:-1]
        # From the one on the other a foot goes in a step as it is wanted to.
        passes = down[1:].any(axis=2) & down[:-1].any(axis=2) & ~stands.any(axis=2)
        weights = p.standing * (stands | passes[..., None]).reshape(len(steps), 4)
        self.steps = steps.reshape(len(steps), 8)
        self.step_weights = np.repeat(weights, 2, axis=1)
        hands = [
            hand for hand in targets.hands if hand in robot.description.task_frames
        ]
        count = len(hands)
        self._hand_links, self._hand_turns = [], np.empty((count, 3, 3))
        self._hand_rotations = np.empty((len(on), count, 3, 3))
        for number, hand in enumerate(hands):
            self._hand_links += robot.frame_points([hand])[0]
            X_BF = robot.frame(hand).GetFixedPoseInBodyFrame()
            self._hand_turns[number] = X_BF.rotation().matrix()
            self._hand_rotations[:, number] = targets.hands[hand]

    def without_feet(self) -> PersonTasks:
        """Limbs, root and hands alone."""
        found = copy(self)
        found._end_weights = np.zeros_like(self._end_weights)
        found._height_weights = np.zeros_like(self._height_weights)
        return found

    def astray(self, y: np.ndarray) -> np.ndarray:
        """(T,) frames in which limbs went astray, or to which a joint jumps.

        Args:
            y: (T, m) unknowns.
        """
        r = self.at(np.arange(len(y)), y).r[:, : 3 * len(self._limb_weights)]
        off = np.linalg.norm(r.reshape(len(y), -1, 3), axis=2) / self._limb_weights
        far = off > 2.0 * np.sin(0.5 * _ASTRAY)  # of unit vectors
        far &= np.array([limb != "head" for limb in self._targets.directions])
        shortest = int(_ASTRAY_FOR * self._targets.rate) + 1
        found = np.any([lasting(flags, shortest) for flags in far.T], axis=0)
        for joint in np.diff(y[:, ROOT:], axis=0).T:
            for frame, _ in leaps(joint[:, None], _JUMP / self._targets.rate):
                found[frame] = True
        return found

    def slip(self, y: np.ndarray) -> float:
        """By how much more than `MOST_SLIP` feet slip, all their contacts together [m].

        Args:
            y: (T, m) unknowns.
        """
        return sum(slip - MOST_SLIP for *_, slip in self._slipping(y))

    def let_slipping_go(self, y: np.ndarray) -> np.ndarray:
        """Lets feet stand elsewhere that slip by more than `MOST_SLIP` in a contact:
        its place is no longer held, and its steps are held more.

        Args:
            y: (T, m) unknowns.

        Returns:
            (T,) the frames of these contacts.
        """
        stands = self._stands()
        # Flat, a foot turns about its ball.
        more = np.where(stands.all(axis=2)[..., None], [1.0, _HELD_MORE], _HELD_MORE)
        slips = np.zeros(len(y), dtype=bool)
        for foot, first, last, _ in self._slipping(y):
            columns = slice(4 * foot, 4 * foot + 4)
            slips[first : last + 1] = True
            self._end_weights[first : last + 1, columns] = self._robot.parameters.foot
            self.step_weights[first:last, columns] *= np.repeat(
                more[first:last, foot], 2, axis=1
            )
        return slips

    def _stands(self) -> np.ndarray:
        """(T - 1, 2, 2) whether heel and ball of each foot stand in a step."""
        return self.step_weights.reshape(-1, 2, 2, 2)[..., 0] > 0.0

    def _slipping(self, y: np.ndarray) -> list[tuple[int, int, int, float]]:
        """Contacts in which a foot slips by more than `MOST_SLIP`: the foot, the first
        step and the one after the last, and by how much it slips [m]."""
        f, found = self.at(np.arange(len(y)), y).f, []
        lacks = (np.diff(f, axis=0) - self.steps).reshape(-1, 2, 2, 2)
        ways = np.where(self._stands(), np.linalg.norm(lacks, axis=3), np.inf)
        ways = ways.min(axis=2)
        for foot, way in enumerate(ways.T):
            for first, last in runs(np.isfinite(way)):
                slip = float(way[first:last].sum())
                if slip > MOST_SLIP:
                    found.append((foot, first, last, slip))
        return found

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        targets, p = self._targets, self._robot.parameters
        placed = self._robot.placed(targets, frames, y)
        points, J = placed.points(self._links, self._offsets)
        R, of_hands = placed.turns(self._hand_links)
        return AtFrames(
            *person_rows(
                points,
                J,
                R @ self._hand_turns,
                of_hands,
                y,
                self._limb_weights,
                self._directions[frames],
                np.array([p.root, p.root, p.root_height, p.turn, p.turn, p.turn]),
                self._ends[frames],
                self._end_weights[frames],
                self._heights[frames],
                self._height_weights[frames],
                self._hand_rotations[frames],
                0.5 * p.hand,
            )
        )


@compiled
def person_rows(
    points: np.ndarray,
    J: np.ndarray,
    hands: np.ndarray,
    of_hands: np.ndarray,
    y: np.ndarray,
    limb_weights: np.ndarray,
    directions: np.ndarray,
    root_weights: np.ndarray,
    ends: np.ndarray,
    end_weights: np.ndarray,
    heights: np.ndarray,
    height_weights: np.ndarray,
    hand_rotations: np.ndarray,
    hand_weight: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The fields of `AtFrames`, of D limbs and H hands at K frames.

    Args:
        points, J: (K, P, 3) [m] and (K, P, 3, m), of `Placed.points`: where limbs
            begin, where they end, four ends and eight corners of soles.
        hands, of_hands: (K, H, 3, 3) R_WH and (K, H, 3, m), as of `Placed.turns`.
        y: (K, m) unknowns.
        limb_weights, directions: (D,), (K, D, 3) unit vectors that are wanted.
        root_weights: (6,).
        ends, end_weights: (K, 4, 3) [m], of which x and y count, (K, 8).
        heights, height_weights: (K, 8) of the corners [m].
        hand_rotations, hand_weight: (K, H, 3, 3) R_WH that are wanted.
    """
    K, m, limbs, count = len(y), y.shape[1], len(limb_weights), hands.shape[1]
    rows = 3 * limbs + 22 + 9 * count
    r, found = np.empty((K, rows)), np.zeros((K, rows, m))
    f, G = np.empty((K, 8)), np.empty((K, 8, m))
    u = np.empty(3)
    for k in range(K):
        for limb in range(limbs):
            start, tip, row = J[k, limb], J[k, limbs + limb], 3 * limb
            for c in range(3):
                u[c] = points[k, limbs + limb, c] - points[k, limb, c]
            length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
            for c in range(3):
                u[c] /= length
                off = u[c] - directions[k, limb, c]
                r[k, row + c] = limb_weights[limb] * off
            by = limb_weights[limb] / length
            for j in range(m):
                a = tip[0, j] - start[0, j]
                b = tip[1, j] - start[1, j]
                c = tip[2, j] - start[2, j]
                along = u[0] * a + u[1] * b + u[2] * c
                found[k, row, j] = by * (a - along * u[0])
                found[k, row + 1, j] = by * (b - along * u[1])
                found[k, row + 2, j] = by * (c - along * u[2])
        row = 3 * limbs
        for i in range(6):
            r[k, row + i] = root_weights[i] * y[k, i]
            found[k, row + i, i] = root_weights[i]
        for i in range(8):
            row, point, c = 3 * limbs + 6 + i, 2 * limbs + i // 2, i % 2
            f[k, i] = points[k, point, c]
            r[k, row] = end_weights[k, i] * (f[k, i] - ends[k, i // 2, c])
            for j in range(m):
                G[k, i, j] = J[k, point, c, j]
                found[k, row, j] = end_weights[k, i] * G[k, i, j]
        for i in range(8):
            row, point = 3 * limbs + 14 + i, 2 * limbs + 4 + i
            lacks = points[k, point, 2] - heights[k, i]
            r[k, row] = height_weights[k, i] * lacks
            for j in range(m):
                found[k, row, j] = height_weights[k, i] * J[k, point, 2, j]
        for hand in range(count):
            w = of_hands[k, hand]
            for axis in range(3):
                row = 3 * limbs + 22 + 9 * hand + 3 * axis
                for c in range(3):
                    u[c] = hand_weight * hands[k, hand, c, axis]
                    wanted = hand_rotations[k, hand, c, axis]
                    r[k, row + c] = u[c] - hand_weight * wanted
                for j in range(m):
                    found[k, row, j] = w[1, j] * u[2] - w[2, j] * u[1]
                    found[k, row + 1, j] = w[2, j] * u[0] - w[0, j] * u[2]
                    found[k, row + 2, j] = w[0, j] * u[1] - w[1, j] * u[0]
    return r, found, f, G


class NearRowsAndFloor:
    """Watched pairs that are near, and links that are near the floor or below it."""

    def __init__(
        self, robot: Retargeter, targets: PerformerTargets, keeper: Keeper
    ) -> None:
        self._robot, self._targets, self._keeper = robot, targets, keeper
        stands = [foot.on_heel | foot.on_ball for foot in targets.feet.values()]
        margin = max(1, round(_PARTING * targets.rate))
        self._without_room = smooth_flags(np.all(stands, axis=0), margin)  # (T,)

    def __call__(self, at: Samples, y: np.ndarray, look: float) -> NearRows:
        """See `optimiser.Problem`."""
        rows = self._keeper.near_rows(at, y, look)
        share = self._without_room[at.frame[rows.sample]]
        rows = rows._replace(d=rows.d + share * self._keeper.room[rows.row])
        return join_rows(rows, self._low(at, y, look))

    def _low(self, at: Samples, y: np.ndarray, look: float) -> NearRows:
        """Of each link its lowest point, at frames alone."""
        robot = self._robot
        samples = np.flatnonzero(at.share == 0.0)
        placed, k = robot.placed_before(self._targets, at.frame[samples], y[samples])
        z = placed.root_positions[:, None, 2] + placed.from_root[..., 2]
        some, number, d, points = lowest_points(
            k, *robot.floor_points, placed.R, z, look
        )
        links = robot.floor_points[0][number]
        _, g = placed.heights(k[some], links, points)
        return NearRows(samples[some], self._keeper.num_rows + number, d, g)
