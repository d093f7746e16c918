"""A reference motion made clear of collisions and within limits, changed the least.

Whether links touch and how joints move does not depend on where the root is. So the
root is passed on as it is, and all frames' joints are found at once (`trajectory`):

    minimise    1/2 sum_k [ |w (q_k - r_k)|^2 + |W (pose_k(q_k) - pose_k(r_k))|^2
                            + |w tau^2 x''_k|^2 ],         x = q - r,

with r the reference, and the poses those of the feet and, where they carry, the hands.
Constraints are distances of watched pairs at the frames and at samples between them,
and the limits and speeds of joints.

Only *windows* about frames that violate something are solved, with half a second on
either side, in parts of some ten seconds. Elsewhere the reference stands, bit for bit.

Nothing trusts the solver. Afterwards the margins of each frame and of each straight way
to the next are found (`margins`). Where they are too small, more is asked for, and a
small window is solved again; where that does not help, from a clear straight way that
leads past it. What stays violated is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.control.checks import check_numbers
from crar_drake.equations.compilation import hold
from crar_drake.errors import ModelError, ScenarioError
from crar_drake.references.ground_contact import FEET, HANDS
from crar_drake.references.margins import Margins, find_margins
from crar_drake.robot.description import LIMIT_TOLERANCE, RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.reach import find_reaches
from crar_drake.robot.task import Task
from crar_drake.trajectory.distance_rows import (
    NearRows,
    configurations,
    find_near_rows,
    find_poses,
)
from crar_drake.trajectory.optimiser import (
    AtFrames,
    Effort,
    Part,
    Problem,
    Samples,
    spread,
)

# The solver is asked for so much more than is certified [m], for its tolerance and what
# a file rounds.
_MORE_AT_FRAMES, _MORE_BETWEEN = 3e-4, 2e-3
_WITHIN_LIMITS = 1e-6  # [rad or m]
_SHARE_OF_SPEED = 0.998

# A window reaches so far beyond what violates something, and again beyond what is not
# certified after it was solved [s].
_AROUND, _AROUND_AGAIN = 0.5, 0.3
# Frames of a part of a long window, and how long it is solved beyond its end [s].
_PART, _OVERLAP = 300, 0.7
_TRIES = 8
# From this try on, what is not certified begins anew from straight ways; the last try
# leaves it there.
_FIRST_CHORDS = 3
# Samples on the way to the next frame: one, three where a joint moves by more than this
# [rad], and twice as many each time that the way is not certified.
_FAST, _MOST_PARTS = 0.12, 16


@dataclass(frozen=True)
class CleaningParameters:
    """What changing the least means, and what is kept.

    Attributes:
        joint_weight: w of each joint [m/rad].
        foot_weight, foot_turn_weight: of the feet's positions [1], and of their
            orientations [m/rad].
        foot_height_weight: of their heights [1]: feet that meet part sideways, and not
            into the floor.
        hand_weight: of the hands' positions [1].
        carrying_weight, carrying_turn_weight: instead, of hands that carry [1], and of
            their orientations [m/rad].
        hands: whether hands are taken to carry throughout, as those that hold an object
            do; else while they are planted on the ground.
        smoothing: tau; changes that come and go within this time cost more [s].
        floor: distance that watched pairs keep at each frame [m].
        floor_between: and on each straight way to the next frame [m].
        velocity_scale: share of the robot's velocity limits that may be used.
    """

    joint_weight: float = 1.0  # [m/rad]
    foot_weight: float = 25.0
    foot_turn_weight: float = 4.0  # [m/rad]
    foot_height_weight: float = 100.0
    hand_weight: float = 2.0
    carrying_weight: float = 35.0
    carrying_turn_weight: float = 0.3  # [m/rad]
    hands: bool = False
    smoothing: float = 0.03  # [s]
    floor: float = 4e-3  # [m]
    floor_between: float = 0.5e-3  # [m]
    velocity_scale: float = 1.0

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
    """A reference's joints, cleaned; T frames of n joints.

    Attributes:
        q: (T, n) positions of the controlled joints [rad or m].
        violating: (T,) frames that still violate something, at them or on the way to
            the next.
        effort: that it took.
    """

    q: np.ndarray
    violating: np.ndarray
    effort: Effort


class Cleaner:
    """Cleans references of one robot at one rate.

    Attributes:
        parameters: what is asked for.
        description: of the robot.
        model: the robot with its root fixed, and its watched pairs.
        feet, hands: task frames that are kept,
        frames: and both.
        rate: frames per second [Hz].
    """

    def __init__(
        self,
        description: RobotDescription,
        rate: float,
        parameters: CleaningParameters | None = None,
    ) -> None:
        """
        Args:
            description: of the robot. Its root is fixed here, even if it floats, and
                joints that it prescribes stay in the rest posture.
            rate: frames per second [Hz].
            parameters: what is asked for.

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
        self.frames = self.feet + self.hands
        kept = [Task(frame=frame, kind="pose") for frame in self.frames]
        other = [Task(frame=next(iter(known), "world"))]
        self.model = ControlModel.FromDescription(description, kept or other)
        if self.model.pairs.needs_query:
            raise ModelError(
                f"robot {description.name} has watched shapes that are neither "
                "capsules nor spheres; these alone are examined"
            )
        bare = replace(description, pairs=[])
        self._poses = ControlModel.FromDescription(bare, kept) if kept else None
        plant = self.model.plant
        self.reaches = hold(
            find_reaches(
                self.model.joints,
                self.model.pairs,
                self.model.order,
                plant.GetPositionLowerLimits(),
                plant.GetPositionUpperLimits(),
            )
        )
        self._rest = self.model.rest_positions()

    def margins(self, q: np.ndarray) -> Margins:
        """What a motion (T, n) of the controlled joints keeps.

        Speeds are shares of the robot's own limits, whatever share may be used.
        """
        return find_margins(self.model, self.reaches, q, self.rate)

    def clean(
        self,
        reference: np.ndarray,
        root_rotations: np.ndarray | None = None,
        carries: np.ndarray | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> Cleaned:
        """The reference under all constraints, changed the least.

        Args:
            reference: (T, n) positions of the controlled joints, in their order.
            root_rotations: (T, 3, 3) R_WR, by which heights are known; by default the
                root is upright.
            carries: (T, H) how much each hand carries the robot, from 0 to 1.
            progress: is called with the number of frames that are done.
        """
        frames = len(reference)
        problem = self._problem(reference, root_rotations, carries)
        q, effort = reference.copy(), Effort()
        margins = self.margins(q)
        violating = self._violating(margins)
        asked = np.full(frames, self.parameters.floor + _MORE_AT_FRAMES)
        between = np.full(frames, self.parameters.floor_between + _MORE_BETWEEN)
        moves = np.abs(np.diff(reference, axis=0, append=reference[-1:])).max(axis=1)
        parts = np.where(moves > _FAST, 4, 2)
        around, attempt = _AROUND, 0
        while violating.any() and attempt < _TRIES:
            solved = spread(violating, round(around * self.rate))
            if attempt >= _FIRST_CHORDS:
                solved |= self._lay_chords(q, violating)
            for first, last, end in self._parts(solved & (attempt < _TRIES - 1)):
                samples = _samples(asked, between, parts, first, last)
                before, after = max(0, first - 2), min(frames, last + 2)
                free = np.zeros(after - before, dtype=bool)
                free[first - before : last - before] = True
                part = Part(problem, before, q[before:after].copy(), free, samples)
                part.effort = effort
                part.solve(
                    round(_AROUND_AGAIN * self.rate), "again" if attempt else "all rows"
                )
                q[first:last] = part.y[first - before : last - before]
                if progress is not None and not attempt:
                    progress(end)
            q = np.clip(
                q, self.model.lower, self.model.upper, where=solved[:, None], out=q
            )
            margins = self._margins_again(q, margins, solved)
            violating = self._violating(margins)
            low = margins.distance < self.parameters.floor
            asked[low] += 1.2 * (self.parameters.floor - margins.distance[low]) + 1e-4
            gaps = margins.between < self.parameters.floor_between
            between[gaps & (parts >= _MOST_PARTS)] += 1e-3
            parts[gaps] = np.minimum(2 * parts[gaps], _MOST_PARTS)
            around, attempt = _AROUND_AGAIN, attempt + 1
        return Cleaned(q, violating, effort)

    def _lay_chords(self, q: np.ndarray, violating: np.ndarray) -> np.ndarray:
        """Leads the motion past what violates something on straight ways that are
        clear, from a frame before to a frame after: the side of an obstacle on which
        the robot stays is not the reference's then.

        Args:
            q: (T, n), changed in place.
            violating: (T,) which frames are not to stay.

        Returns:
            (T,) the frames that were changed.
        """
        frames, changed = len(q), np.zeros(len(q), dtype=bool)
        for first, last in _runs(violating):
            for reach in range(1, frames):
                a, b = max(first - reach, -1), min(last - 1 + reach, frames)
                ends = [k for k in (a, b) if 0 <= k < frames]
                if not ends:
                    break
                if violating[ends].any() or not self._is_way(q[ends], b - a):
                    continue
                share = np.linspace(0.0, 1.0, b - a + 1)[1:-1, None]
                q[a + 1 : b] = (1.0 - share) * q[ends[0]] + share * q[ends[-1]]
                changed[a + 1 : b] = True
                break
        return changed

    def _is_way(self, ends: np.ndarray, frames: int) -> bool:
        """Whether all frames on the straight way between two configurations, so many
        apart, violate nothing; of one configuration, whether that does not."""
        margins = self.margins(ends)
        slowed = replace(margins, speed=margins.speed / frames)
        low = margins.between.min() < self.parameters.floor
        return not (low or self._violating(slowed).any())

    def _violating(self, margins: Margins) -> np.ndarray:
        """(T,) frames that violate something, at them or on the way to the next."""
        p = self.parameters
        fast = margins.speed > p.velocity_scale
        return (
            (margins.distance < p.floor)
            | (margins.between < p.floor_between)
            | (margins.limit < -LIMIT_TOLERANCE)
            | fast
            | np.append(False, fast[:-1])
        )

    def _margins_again(
        self, q: np.ndarray, margins: Margins, changed: np.ndarray
    ) -> Margins:
        """The margins of a motion of which some frames have changed."""
        found = {name: x.copy() for name, x in vars(margins).items()}
        touched = np.flatnonzero(spread(changed, 1))
        for run in np.split(touched, np.flatnonzero(np.diff(touched) > 1) + 1):
            if not len(run):
                continue
            # The last frame of a run has no way of its own here.
            some = slice(run[0], min(run[-1] + 2, len(q)))
            new = self.margins(q[some])
            last = run[-1] + 1 == len(q)
            for name, x in vars(new).items():
                found[name][run] = x[: len(run)] if last else x[:-1]
        return Margins(**found)

    def _parts(self, mask: np.ndarray) -> Iterator[tuple[int, int, int]]:
        """First frame, frame after the last, and how far the motion is done with it;
        the last frames of a part that goes on are solved again by the next."""
        overlap = round(_OVERLAP * self.rate)
        for first, last in _runs(mask):
            while last - first > _PART + overlap + _PART // 2:
                yield first, first + _PART + overlap, first + _PART
                first += _PART
            yield first, last, last

    def _problem(self, reference, root_rotations, carries) -> Problem:
        p, model = self.parameters, self.model
        ones = np.ones(model.n)
        fastest = model.velocity_limits[model.controlled]
        stiffness = p.joint_weight * (p.smoothing * self.rate) ** 2
        return Problem(
            tasks=self._tasks(reference, root_rotations, carries),
            posture=reference,
            posture_weight=p.joint_weight * ones,
            about=reference,
            smoothness=stiffness * ones,
            lower=np.minimum(model.lower + _WITHIN_LIMITS, model.upper),
            upper=np.maximum(model.upper - _WITHIN_LIMITS, model.lower),
            fastest=fastest * min(p.velocity_scale, 1.0) * _SHARE_OF_SPEED / self.rate,
            near_rows=self._near_rows,
            num_rows=len(self.reaches.value.rows),
        )

    def _near_rows(self, at: Samples, y: np.ndarray, look: float) -> NearRows:
        asked = at.asked
        whole = configurations(self.model, self._rest, y)
        rows = NearRows(*find_near_rows(whole, asked + look, self.model.robot_ahead))
        # The prescribed joints, which come last, stay where they are.
        gradient = rows.gradient[:, : self.model.n]
        return rows._replace(d=rows.d - asked[rows.sample], gradient=gradient)

    def _tasks(self, reference, root_rotations, carries) -> KeptPoses | _Nothing:
        p, frames = self.parameters, len(reference)
        if self._poses is None:
            return _Nothing()
        hands = len(self.hands)
        if carries is None or p.hands:
            carries = np.full((frames, hands), float(p.hands))
        if root_rotations is None:
            root_rotations = np.tile(np.eye(3), (frames, 1, 1))
        feet = np.ones((frames, len(self.feet)))
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


class _Nothing:
    """No tasks besides the joints."""

    step_weights = None

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        nothing = np.zeros((len(y), 0)), np.zeros((len(y), 0, y.shape[1]))
        return AtFrames(*nothing, *nothing)


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
        self._R, self._p, _ = self._find(reference)
        rows = model.layout
        self._linear_rows, self._angular_rows = rows.linear_rows, rows.angular_rows

    def _find(self, y):
        return find_poses(
            configurations(self._model, self._rest, y), self._model.robot_by_pair
        )

    def at(self, frames: np.ndarray, y: np.ndarray) -> AtFrames:
        """See `optimiser.Tasks`."""
        R, p, J = self._find(y)
        J = J[:, :, : y.shape[1]]
        root = self._root[frames][:, None]
        turned = Rotation.from_matrix(
            (R @ self._R[frames].swapaxes(-1, -2)).reshape(-1, 3, 3)
        ).as_rotvec()
        r, jacobians = [], []
        for error, rows, weight in (
            (p - self._p[frames], self._linear_rows, self._linear[frames]),
            (turned.reshape(p.shape), self._angular_rows, self._angular[frames]),
        ):
            by = weight[..., None] * root  # (K, L, 3, 3)
            r.append((by @ error[..., None]).reshape(len(y), -1))
            jacobians.append((by @ J[:, rows]).reshape(len(y), -1, y.shape[1]))
        nothing = np.zeros((len(y), 0)), np.zeros((len(y), 0, y.shape[1]))
        return AtFrames(
            np.concatenate(r, axis=1), np.concatenate(jacobians, axis=1), *nothing
        )


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """First frame of each stretch of a mask (T,), and the one after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _samples(
    asked: np.ndarray, between: np.ndarray, parts: np.ndarray, first: int, last: int
) -> Samples:
    """At the frames first to last - 1, and between these and their neighbours, counted
    from the part's first."""
    before, frames = max(0, first - 2), len(asked)
    at = np.arange(first, last)
    ways = np.arange(max(first - 1, 0), min(last, frames - 1))
    times = parts[ways] - 1
    k = np.repeat(ways, times)
    number = np.arange(len(k)) - np.repeat(np.cumsum(times) - times, times) + 1
    return Samples(
        np.concatenate([at, k]) - before,
        np.concatenate([np.zeros(len(at)), number / parts[k]]),
        np.concatenate([asked[at], between[k]]),
    )
