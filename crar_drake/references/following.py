"""A reference motion made clear of collisions and within limits, changed the least.

Whether links touch and how joints move does not depend on where the root is. So the
root is passed on as it is, and the control law runs on the robot with its root fixed:
every joint is a task that follows the reference, and the feet are tasks of high weight
that keep their poses relative to the root, by which they keep them in the world. No
torque is needed: the robot is where the law's acceleration leads, exactly, and the
*admission* of each step proves the motion clear (`docs/lookahead.md`).

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
from crar_drake.control.modes.lookahead import LookaheadParameters
from crar_drake.control.modes.mode import Before, Resolved
from crar_drake.control.parameters import CrarParameters
from crar_drake.equations.admission import SCALED
from crar_drake.equations.kinematics import Measured, task_motion
from crar_drake.equations.nearby import keeps_level
from crar_drake.equations.prediction import next_state
from crar_drake.equations.references import BlendStart, Wanted
from crar_drake.errors import ModelError, MotionError, ScenarioError
from crar_drake.references.clear_ways import ClearWays
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

_NOTHING_ASKED = np.zeros((0, 7))
_NOTHING = np.zeros(0)
_NO_BLEND = (1.0, 0.0, 0.0)


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
    hands: bool = False
    hand_weight: float = 5.0
    hand_turn_weight: float = 1.0  # [m/rad]
    distance_margin: float = 5e-3  # [m]
    admission_slack: float = 1e-3  # [m]
    rho: float = 1e-6
    alpha: float = 400.0  # [1/m]
    beta: float = 2.0
    influence_distance: float = 0.03  # [m]
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
                rho_limits=1e-12,  # the bounds (A2) suffice
                limit_margin=1e-9,
                distance_margin=self.distance_margin,
                admission_slack=self.admission_slack,
                influence_distance=self.influence_distance,
                retreat_rate=0.5 / period,
                fastest_wish=3.0 / period,
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
            0 as wished, 1 corrected, 2 scaled, see `equations.admission`.
        share: (T,) the least share of the wish among them.
        clear: (T,) whether the law found the braking path clear in all of them.
        moved_start: how far the first frame was moved, by its farthest joint [rad or
            m]; 0 where the reference's own is clear.
        num_watched: pairs that the law watched.
    """

    q: np.ndarray
    admitted: np.ndarray
    share: np.ndarray
    clear: np.ndarray
    moved_start: float
    num_watched: int = 0


@dataclass(slots=True)
class _Run:
    """The law on its way: state, and what a step leaves to the next."""

    q: np.ndarray  # (nq,)
    v: np.ndarray  # (nv,)
    watched: np.ndarray  # (Nr,) which pairs of shapes the law has looked at
    before: Before | None = None


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
        self._kinematics = ControlModel.FromDescription(bare, tasks, time_step=period)
        self.law = ControlLaw(self.model, self.parameters.of_law(period))
        self._period, self._T = period, self.law.parameters.braking_horizon
        self._workspace = self.model.MakeWorkspace()
        rest = self.model.rest_positions()
        self._rest = rest
        self._prescribed = self.model.prescribed_at(rest)
        self._start = BlendStart(
            np.zeros((len(self.model.layout.angular_tasks), 3, 3)),
            np.zeros((len(self.model.layout.linear_tasks), 3)),
            rest[self.model.prescribed_positions],
            np.zeros(self.model.n),
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
            progress: is told the frame that was reached.

        Raises:
            MotionError: no clear configuration was found near the first frame, or
                numbers overflow.
        """
        frames, h, steps = len(reference), self._period, self.steps
        q_d = self._sampled(reference)
        v_d = np.diff(q_d, axis=0, prepend=q_d[:1]) / h
        a_d = np.diff(v_d, axis=0, append=v_d[-1:]) / h
        ways = ClearWays(self.law, self._whole(reference), self.rate)
        start, run = self._settle(q_d[0])
        q = np.empty_like(reference)
        q[0] = start
        admitted, share = np.zeros(frames), np.ones(frames)
        clear = np.ones(frames, dtype=bool)
        for frame in range(1, frames):
            first, last = (frame - 1) * steps, frame * steps
            began, targets = (run.q, run.v), None
            for k in range(first, last):
                if self._is_on(run, q_d[k], v_d[k]) and ways.clear(frame - 1):
                    run.q, run.v = self._whole(q_d[last]), self._moving(v_d[last])
                    run.before = None
                    break
                if targets is None:
                    samples = slice(first, last)
                    targets = self._targets(q_d[samples], v_d[samples], a_d[samples])
                told = self._step(run, targets[k - first])
                admitted[frame] = max(admitted[frame], told[0])
                share[frame] = min(share[frame], told[1])
                clear[frame] &= told[3] == 1.0
            if targets is not None and not self._goes_clear(began[0], run.q):
                run.q, run.v = began
                self._brake(run)
                admitted[frame], share[frame] = SCALED, 0.0
            # At a limit, rounding may lead beyond it.
            here = run.q[self.model.controlled_positions]
            q[frame] = np.clip(here, self.model.lower, self.model.upper)
            if progress is not None:
                progress(frame)
        moved = float(np.abs(start - reference[0]).max())
        watched = np.unique(self.model.pairs.pair_of_shapes[run.watched])
        return Cleaned(q, admitted, share, clear, moved, len(watched))

    def _sampled(self, reference: np.ndarray) -> np.ndarray:
        """(K, n) of the law's steps: on straight lines between the frames."""
        if self.steps == 1 or len(reference) == 1:
            return reference
        share = np.arange(self.steps)[:, None] / self.steps
        between = reference[:-1, None] + share * np.diff(reference, axis=0)[:, None]
        return np.vstack([between.reshape(-1, reference.shape[1]), reference[-1:]])

    def _targets(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """(K, layout.size) [x_d; v_d; a_d] of the tasks that a motion of the joints is,
        at K samples of it, each (K, n)."""
        model, layout = self._kinematics, self._kinematics.layout
        moving = (self._moving(x) for x in (v, a))
        R, p, v_d, a_d = task_motion(self._whole(q), *moving, model.robot_by_pair)
        return layout.pack(R, p, v_d, a_d, q[:, layout.rows.joints])

    def _whole(self, q: np.ndarray) -> np.ndarray:
        """(..., nq) of the plant, the prescribed joints at rest, from (..., n)."""
        whole = np.empty((*q.shape[:-1], len(self._rest)))
        whole[...] = self._rest
        whole[..., self.model.controlled_positions] = q
        return whole

    def _moving(self, v: np.ndarray) -> np.ndarray:
        """(..., nv) of the plant, the prescribed joints at rest, from (..., n)."""
        whole = np.zeros((*v.shape[:-1], self.model.n + self.model.n_p))
        whole[..., self.model.controlled] = v
        return whole

    def _is_on(self, run: _Run, q: np.ndarray, v: np.ndarray) -> bool:
        """Whether it is where and as fast as a sample of the reference."""
        off = np.abs(run.q[self.model.controlled_positions] - q).max()
        return (
            off <= _ON_IT
            and np.abs(run.v[self.model.controlled] - v).max() <= _ALONG_IT
        )

    def _step(self, run: _Run, targets: np.ndarray) -> np.ndarray:
        """Moves `run` a step on; returns how it was admitted, (4,)."""
        wanted = Wanted(targets, self._prescribed, _NOTHING, self._start, _NO_BLEND)
        q_s = run.q + self._T * run.v
        measured = Measured(np.array([run.q, q_s]), run.v, _NOTHING_ASKED)
        fastest = _EXPECTED * np.abs(run.v)
        while True:
            mode, rows, room = self.law.mode.watching(run.q, run.v, fastest)
            resolved: Resolved = mode.resolve(
                self._workspace, measured, wanted, run.before
            )
            vdot = resolved.answer.vdot
            if not np.isfinite(vdot).all():
                raise MotionError("its joints move beyond all sense: an overflow")
            s = run.v + self._T * vdot
            if self.law.mode.leaves_clear(s, room):
                break
            fastest = np.maximum(fastest, 2.0 * np.abs(s))
        run.watched[rows] = True
        controlled = self.model.controlled
        run.before = Before(True, run.v[controlled], vdot[controlled], resolved.kept)
        run.q, run.v = next_state(run.q, run.v, vdot, self._period, self._period)
        return resolved.diagnostics["admission"]

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

    def _brake(self, run: _Run) -> None:
        """Moves `run` a frame on, straight along its braking path, which is clear."""
        for _ in range(self.steps):
            vdot = -run.v / self._T
            run.q, run.v = next_state(run.q, run.v, vdot, self._period, self._period)
        run.before = None

    def _settle(self, q_0: np.ndarray) -> tuple[np.ndarray, _Run]:
        """Where to begin, (n,): at the first frame, or where the law that retreats
        from there first is clear; and the run from there, at rest."""
        model = self.model
        inside = np.clip(q_0, model.lower, model.upper)
        still = np.zeros_like(q_0)
        targets = self._targets(inside[None], still[None], still[None])[0]
        watched = np.zeros(len(model.pairs.pair_of_shapes), dtype=bool)
        run = _Run(self._whole(inside), np.zeros(model.n + model.n_p), watched)
        for step in range(_SETTLING):
            here = run.q
            told = self._step(run, targets)
            if told[3] == 1.0:  # the braking path from here is clear, and so is here
                still = np.zeros_like(run.v)
                return here[model.controlled_positions], _Run(here, still, watched)
            if step > _STUCK and np.abs(run.q - here).max() < _SETTLED:
                break  # nothing leads out
        raise MotionError(
            "no configuration that is clear of collisions was found near the first "
            "frame; begin later, or look whether the reference is of this robot"
        )

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
