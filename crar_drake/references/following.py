"""A reference motion made clear of collisions and within limits, changed the least.

Whether links touch and how joints move does not depend on where the root is. So the
root is passed on as it is, and the control law runs on the robot with its root fixed:
every joint is a task that follows the reference, and the feet are tasks of high weight
that keep their poses relative to the root, by which they keep them in the world. No
torque is needed: the robot is where the law's acceleration leads, exactly, and the
*admission* of each step proves the motion clear (`docs/theory/theorem.md`).

What changes least is, in each step, the norm of (L6) and (L7),

    sum_j |s_j - s_0j|^2 (w^2 + lambda^2) + sum_tasks w_task^2 |change of its twist|^2,

of the velocities s of where the robot would come to rest, s_0 those that follow the
reference. Where nothing is in the way, s = s_0 leads exactly onto it, since the
targets' velocities and accelerations are the differences that the prediction (A1)
integrates:

    v_k = (q_k - q_(k-1)) / h,      a_k = (v_(k+1) - v_k) / h.

After it was held off, the robot catches up: its error x follows both poles z =
exp(-h / catch_up) of x'' = -P x - D x', for which h D = 1 - z^2, h^2 P = (1 - z)^2.

Where the robot is on the reference, and the way to the next frame is clear by the whole
margin, that frame is taken as it is: nothing changes less, and the law, which would
weigh pairs that are near, need not be asked. Where the straight way between two frames
of the law's is not clear, the robot brakes for a frame, straight on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from crar_drake.control.checks import check_numbers
from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import CrarParameters, LookaheadParameters
from crar_drake.equations.admission import SCALED
from crar_drake.equations.compilation import Held, hold
from crar_drake.equations.following import (
    Followed,
    FollowerNumbers,
    OnTheWay,
    follow_steps,
)
from crar_drake.equations.free_joints import PLAIN
from crar_drake.equations.lookahead import LookaheadMemory
from crar_drake.equations.lookahead_rows import find_limits
from crar_drake.equations.nearby import keeps_level
from crar_drake.equations.prediction import next_state
from crar_drake.equations.references import BlendStart
from crar_drake.errors import ModelError, MotionError, ScenarioError
from crar_drake.references.clear_ways import ClearWays
from crar_drake.references.frame_targets import (
    FrameTargets,
    configurations,
    velocities,
)
from crar_drake.references.margins import Margins, find_margins
from crar_drake.robot.description import RobotDescription
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task, joint_tasks

FEET = ("left_foot", "right_foot")
HANDS = ("left_hand", "right_hand")

# Steps to find a clear configuration near the first frame; after some, less than this
# in a step counts as being stuck [rad].
_SETTLING = 600
_STUCK = 10
_SETTLED = 1e-6

# Nearer to the reference than this is on it [rad or m, and per second].
_ON_IT, _ALONG_IT = 3e-4, 2e-2

# A step is expected to be at most so many times faster than the robot.
_EXPECTED = 1.3

# This share of the floor is kept on straight ways between frames.
_BETWEEN = 0.125


@dataclass(frozen=True)
class CleaningParameters:
    """How a reference is followed.

    Attributes:
        longest_period: a step of the law is at most so long; whole steps make up a
            period of the motion [s].
        horizon: the braking horizon T, in steps of the law.
        catch_up: time constant of the way back onto the reference [s].
        damping: lambda [m].
        joint_weight: w of each joint [m/rad].
        foot_weight, foot_turn_weight: of the feet's positions [1], and of their
            orientations [m/rad].
        foot_height_weight: of their positions along the root's z axis [1]: feet that
            meet part sideways, and not into the floor.
        hands: whether the hands are tasks, too.
        hand_weight, hand_turn_weight: their weights, likewise.
        distance_margin: that watched pairs are to keep [m].
        admission_slack: they keep at least the margin less this [m].
        rho, alpha, beta: of the collision weight (L5).
        influence_distance: pairs farther apart than this do not count [m].
        velocity_scale: share of the robot's velocity limits that may be used.
    """

    longest_period: float = 0.00505  # [s]
    horizon: float = 2.0
    catch_up: float = 0.02  # [s]
    damping: float = 0.1  # [m]
    joint_weight: float = 1.0  # [m/rad]
    foot_weight: float = 25.0
    foot_turn_weight: float = 4.0  # [m/rad]
    foot_height_weight: float = 100.0
    hands: bool = False
    hand_weight: float = 35.0
    hand_turn_weight: float = 0.3  # [m/rad]
    distance_margin: float = 5e-3  # [m]
    admission_slack: float = 1e-3  # [m]
    rho: float = 1e-6
    alpha: float = 400.0  # [1/m]
    beta: float = 2.0
    influence_distance: float = 0.012  # [m]
    velocity_scale: float = 1.0

    @property
    def floor(self) -> float:
        """The distance that watched pairs keep [m]."""
        return self.distance_margin - self.admission_slack

    def validate(self) -> None:
        """Raises ScenarioError, naming the field and what it may be."""
        check_numbers("clean", self, may_be_zero=set())
        if self.velocity_scale > 1.0:
            raise ScenarioError(
                f"clean: velocity_scale is {self.velocity_scale:g}; a share of the "
                "robot's speed limits is at most 1"
            )

    def steps_per_frame(self, rate: float) -> int:
        """How many steps of the law make up a period of the motion.

        Args:
            rate: samples per second of the motion [Hz].
        """
        return max(1, math.ceil(1.0 / (rate * self.longest_period) - 1e-9))

    def of_law(self, period: float) -> CrarParameters:
        """The control law's parameters.

        Args:
            period: h, of a step of the law [s].
        """
        z = math.exp(-period / self.catch_up)
        # Half of D = Kv + Gv and of P = Kp + Gv K each (Eqs. 14, 30).
        D, P = (1.0 - z * z) / period, (1.0 - z) ** 2 / period**2
        return CrarParameters(
            period=period,
            K=P / D,
            Kp=0.5 * P,
            Kv=0.5 * D,
            Gv=0.5 * D,
            damping=self.damping,
            alpha=self.alpha,
            beta=self.beta,
            blend_time=0.0,
            nominal_posture_gain=0.0,
            respect_effort_limits=False,
            velocity_scale=self.velocity_scale,
            lookahead=LookaheadParameters(
                horizon=self.horizon * period,
                rho=self.rho,
                distance_margin=self.distance_margin,
                admission_slack=self.admission_slack,
                influence_distance=self.influence_distance,
                retreat_rate=0.5 / period,
                nominal_speed_limit=3.0 / period,
                guard_norm="tasks",
                lost_target="error",
            ),
        )


@dataclass(frozen=True)
class Cleaned:
    """A reference's joints, cleaned; T frames of n joints.

    Attributes:
        q: (T, n) positions of the controlled joints [rad or m].
        admitted: (T,) how the steps to each frame were admitted, the worst of them:
            0 nominal, 1 corrected, 2 scaled, see `equations.admission`.
        share: (T,) the least share of the nominal step among them.
        clear: (T,) whether the law found the braking path clear in all of them.
        moved_start: how far the first frame was moved, by its farthest joint [rad or
            m]; 0 where the reference's own is clear.
        num_watched: pairs that the law watched.
        asked: how often the law was asked, for all frames but the first.
    """

    q: np.ndarray
    admitted: np.ndarray
    share: np.ndarray
    clear: np.ndarray
    moved_start: float
    num_watched: int = 0
    asked: int = 0


class Follower:
    """Follows references of one robot at one rate, under the constraints of its pairs.

    Attributes:
        description: of the robot.
        model: the robot with its root fixed, and the tasks.
        law: on it.
        steps: of the law in a period of the motion.
        feet, hands: task frames that are followed.
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
            rate: samples per second [Hz].
            parameters: how the reference is followed.

        Raises:
            ScenarioError: a parameter is out of range.
            ModelError: the robot watches no pair, has watched shapes other than
                capsules and spheres, or no frames of hands that are asked for.
        """
        self.parameters = parameters or CleaningParameters()
        self.parameters.validate()
        self.description, self.rate = description, rate
        self.steps = self.parameters.steps_per_frame(rate)
        period = 1.0 / (rate * self.steps)
        description = replace(description, root="fixed")
        if not description.pairs:
            raise ModelError(
                f"robot {description.name} watches no pairs of links: list `pairs` in "
                "its robot.yaml, or import it"
            )
        self.feet = tuple(f for f in FEET if f in description.task_frames)
        self.hands = self._hands_of(description)
        bare = replace(description, pairs=[])
        probe = ControlModel.FromDescription(bare, [Task(frame=_any_frame(bare))])
        tasks = self._tasks(probe.joint_names)
        self.model = ControlModel.FromDescription(description, tasks, time_step=period)
        if self.model.pairs.needs_query:
            raise ModelError(
                f"robot {description.name} has watched shapes that are neither "
                "capsules nor spheres; the admission examines these alone"
            )
        poses = [task for task in tasks if task.kind == "pose"]
        self._poses = (
            ControlModel.FromDescription(bare, poses, time_step=period)
            if poses
            else None
        )
        self.law = ControlLaw(self.model, self.parameters.of_law(period))
        self._period = period
        self._rest = self.model.rest_positions()
        start = BlendStart(
            np.zeros((len(self.model.layout.angular_tasks), 3, 3)),
            np.zeros((len(self.model.layout.linear_tasks), 3)),
            self._rest[self.model.prescribed_positions],
            np.zeros(self.model.n),
        )
        self._numbers = hold(
            FollowerNumbers(
                self.law.mode.robot,
                self._law_numbers(),
                self.model.prescribed_at(self._rest),
                start,
                _EXPECTED,
                _ON_IT,
                _ALONG_IT,
            )
        )

    def margins(self, q: np.ndarray) -> Margins:
        """What a motion (T, n) of the controlled joints keeps.

        Speeds are shares of the robot's own limits, whatever share the law may use.
        """
        fastest = self.model.velocity_limits[self.model.controlled]
        return find_margins(self.model, self.law.mode, fastest, q, self.rate)

    def follow(
        self, reference: np.ndarray, progress: Callable[[int], None] | None = None
    ) -> Cleaned:
        """The reference under all constraints.

        Where its first frame is not clear, the robot begins in the configuration that
        the law retreats to from there, and catches up as it does everywhere.

        Args:
            reference: (T, n) positions of the controlled joints, in their order.
            progress: is called with the frame that was reached.

        Raises:
            MotionError: no clear configuration was found near the first frame, or
                numbers overflow.
        """
        frames, steps = len(reference), self.steps
        targets = self._targets(reference, steps)
        ways = ClearWays(
            self.law, configurations(self.model, self._rest, reference), self.rate
        )
        watched = np.zeros(len(self.model.pairs.pair_of_shapes), dtype=bool)
        now = self._settle(reference[0], watched)
        q = np.empty_like(reference)
        q[0] = start = now.q[self.model.controlled_positions]
        admitted, share = np.zeros(frames), np.ones(frames)
        clear, asked = np.ones(frames, dtype=bool), np.zeros(frames, dtype=int)
        on_it = False  # as far as is known: the steps end where it comes to be so
        for frame in range(1, frames):
            k, last, began = (frame - 1) * steps, frame * steps, now
            until_on_it = True
            while k < last:
                if on_it:
                    until_on_it = False
                    if ways.clear(frame - 1):
                        now = self._start(targets.q[last], targets.v[last])
                        break
                found = self._take(now, targets, k, last, until_on_it, watched)
                now, k = found.end, k + found.steps
                on_it = k < last
                asked[frame] += found.asked
                admitted[frame] = max(admitted[frame], found.how)
                share[frame] = min(share[frame], found.share)
                clear[frame] &= found.clear
            if asked[frame] and not self._goes_clear(began.q, now.q):
                now, on_it = self._brake(began), False
                admitted[frame], share[frame] = SCALED, 0.0
            # At a limit, rounding may lead beyond it.
            here = now.q[self.model.controlled_positions]
            q[frame] = np.minimum(np.maximum(here, self.model.lower), self.model.upper)
            if progress is not None:
                progress(frame)
        moved = float(np.abs(start - reference[0]).max())
        pairs = np.unique(self.model.pairs.pair_of_shapes[watched])
        return Cleaned(q, admitted, share, clear, moved, len(pairs), asked.sum())

    def _start(self, q: np.ndarray, v: np.ndarray) -> OnTheWay:
        """On the way from a state (n,), (n,) of the controlled joints."""
        still = np.zeros_like(v)
        memory = LookaheadMemory(v, still, still, np.zeros(0), np.zeros(0))
        return OnTheWay(
            configurations(self.model, self._rest, q), velocities(self.model, v), memory
        )

    def _take(
        self,
        now: OnTheWay,
        targets: FrameTargets,
        first: int,
        last: int,
        until_on_it: bool,
        watched: np.ndarray,
    ) -> Followed:
        """`follow_steps`, of the steps `first` to `last` of a frame.

        Raises:
            MotionError: numbers overflow.
        """
        some = slice(first, last)
        found = follow_steps(
            now,
            targets.at(first, last),
            targets.q[some],
            targets.v[some],
            until_on_it,
            watched,
            self._numbers,
        )
        if not np.isfinite(found.end.v).all():
            raise MotionError("its joints move beyond all sense: an overflow")
        return found

    def _goes_clear(self, start: np.ndarray, end: np.ndarray) -> bool:
        """Whether the straight way from one frame to the next keeps clear: the law goes
        between them in steps, and so not straight."""
        model, mode = self.model, self.law.mode
        return keeps_level(
            start[model.positions],
            (end - start)[model.order],
            _BETWEEN * self.parameters.floor,
            mode.robot,
            mode.reaches,
        )

    def _brake(self, now: OnTheWay) -> OnTheWay:
        """A frame on, straight along the braking path, which is clear."""
        q, v, T = now.q, now.v, self.law.parameters.braking_horizon
        for _ in range(self.steps):
            q, v = next_state(q, v, -v / T, self._period, self._period, PLAIN)
        return self._start(q[self.model.controlled_positions], v[self.model.controlled])

    def _settle(self, q_0: np.ndarray, watched: np.ndarray) -> OnTheWay:
        """Where to begin, at rest: at the first frame, or where the law that retreats
        from there first is clear."""
        model = self.model
        inside = np.clip(q_0, model.lower, model.upper)
        still = np.zeros_like(q_0)
        targets = self._targets(inside[None], 1)
        now = self._start(inside, still)
        for step in range(_SETTLING):
            here = now.q
            found = self._take(now, targets, 0, 1, False, watched)
            if found.clear:  # the braking path from here is clear, and so is here
                return self._start(here[model.controlled_positions], still)
            now = found.end
            if step > _STUCK and np.abs(now.q - here).max() < _SETTLED:
                break  # nothing leads out
        raise MotionError(
            "no configuration that is clear of collisions was found near the first "
            "frame; begin later, or look whether the reference is of this robot"
        )

    def _targets(self, reference: np.ndarray, steps: int) -> FrameTargets:
        """Of some frames (T, n), with so many steps of the law in each."""
        return FrameTargets(
            self.model, self._poses, self._rest, reference, steps, self._period
        )

    def _law_numbers(self) -> Held:
        """Of the law, with the weight of the feet's heights, which is not that of their
        other coordinates; and without rows of the joint limits, which the bounds (A2)
        keep: a cleaned joint may go up to its limit."""
        numbers, layout = self.law.mode.numbers.value, self.model.layout
        limits = numbers.limits.value
        nowhere = np.full(self.model.n, np.inf)
        without_rows = find_limits(-nowhere, nowhere, limits.fastest)
        limits = without_rows._replace(lower=limits.lower, upper=limits.upper)
        weights = self.model.row_weights.copy()
        heights = layout.linear_rows[: len(self.feet), 2]
        weights[heights] = self.parameters.foot_height_weight
        tasks = numbers.tasks._replace(weights=weights)
        return hold(numbers._replace(tasks=tasks, limits=hold(limits)))

    def _hands_of(self, description: RobotDescription) -> tuple[str, ...]:
        if not self.parameters.hands:
            return ()
        hands = tuple(f for f in HANDS if f in description.task_frames)
        if not hands:
            raise ModelError(
                f"robot {description.name} has no task_frames {' and '.join(HANDS)} to "
                "follow; add them to its robot.yaml, or leave out --hands"
            )
        return hands

    def _tasks(self, joints: list[str]) -> list[Task]:
        p = self.parameters
        poses = [
            Task(
                frame=frame,
                kind="pose",
                position_weight=weight,
                orientation_weight=turn_weight,
            )
            for frames, weight, turn_weight in (
                (self.feet, p.foot_weight, p.foot_turn_weight),
                (self.hands, p.hand_weight, p.hand_turn_weight),
            )
            for frame in frames
        ]
        return joint_tasks(joints, p.joint_weight) + poses


def _any_frame(description: RobotDescription) -> str:
    """Some frame of a robot, for a model whose tasks do not matter."""
    return next(iter(description.task_frames), "world")
