"""A scenario's simulation that goes on step by step, moved by hand in between."""

from collections import deque
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context, System

from crar_drake.errors import CrarError, ScenarioError
from crar_drake.law.control_law import ControlLaw
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.tasks import TaskLayout
from crar_drake.play.live_sources import make_live
from crar_drake.play.motion_clock import MotionClock
from crar_drake.play.recorder import Recorder
from crar_drake.robot.description import LIMIT_TOLERANCE
from crar_drake.simulation.diagram import (
    MakeCrarDiagram,
    MakeSimulator,
    PrepareScenario,
    Setup,
)
from crar_drake.simulation.disturbances import Push, applied_force
from crar_drake.simulation.moving_obstacles import MovingObstacle, Place
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.desired_motion import DesiredMotion

# What a person drags targets by changes so fast at most [m/s].
_SPEED = 1.5

_MOST_EVENTS, _MOST_REPORTED = 10_000, 1000

# The ball that is dragged: its radius [m], the bound of its speed [m/s], and how far in
# front of the robot and its targets it is at first [m].
BALL = "your ball"
_BALL_RADIUS, _BALL_SPEED, _BALL_AHEAD = 0.08, 0.8, 0.5

PUSH_TIME = 0.1  # [s]
MOST_PUSHED = 1000.0  # by all pushes of a person's that act at a time [N]


@dataclass(frozen=True)
class Event:
    """Something that a person did."""

    time: float  # in the simulation [s]
    what: str  # in words


class LiveSimulation:
    """A diagram of a scenario and its simulator, a control period at a time.

    What is changed, is so in the middle between two control ticks, and counts from the
    next one on. So every sample of the log is what the controller went by, and nothing
    that is cached of a tick becomes stale. No tick is ever left out.

    Attributes:
        scenario: as it was begun.
        model: the control model.
        period: of the controller [s].
        duration: of the motion [s].
        offsets: (N, 3) from the motion to where a person wants the targets of the
            position and pose tasks, in the order of `layout.linear_tasks` [m].
        moved: (N, 3) what is added to these targets by now [m].
        path: (N, 3) where targets are on the way of the motion [m].
        clock: of the motion.
        ball: (3,) where the ball is that a person drags, an obstacle that moves [m];
            None where the robot keeps off none.
        setup, diagram, simulator, controller, plant: what it is made of.
        recorder: keeps the log.
        events: what was done, in order; the last ones of very many.
    """

    def __init__(self, scenario: Scenario) -> None:
        """
        Args:
            scenario: validated.

        Raises:
            CrarError: something in the scenario, its robot or its motion is wrong.
        """
        if scenario.standing is None:
            # As obstacles that move ask for.
            scenario = deepcopy(scenario)
            scenario.plant_config.time_step = scenario.controller.period
        setup = PrepareScenario(scenario)
        self.model, self.duration = setup.model, setup.motion.duration
        parameters, simulated = scenario.controller, scenario.simulated_robot
        balls = []
        if isinstance(parameters, LookaheadParameters):
            # Only pushes lead beyond limits, and from there perhaps no way back.
            simulated = replace(simulated, position_limits=True)
            among = parameters.among_obstacles()
            with suppress(ScenarioError):  # a robot that keeps off none
                ControlLaw(self.model, among).among  # noqa: B018
                parameters, balls = among, [make_ball(setup)]
        self.scenario = replace(
            scenario,
            controller=parameters,
            simulated_robot=simulated,
            obstacles=[*scenario.obstacles, *balls],
            log_period=scenario.log_period or parameters.period,
        )
        self.path = points_of(setup.motion, self.model.layout)
        setup = replace(setup, motion=make_live(setup.motion, setup.model))
        self.setup = setup
        self.diagram = MakeCrarDiagram(self.scenario, setup=setup)
        self.period, self._tick = parameters.period, 0
        self.simulator = MakeSimulator(self.scenario, self.diagram)
        self.controller, self._controller_context = self._part("crar_controller")
        self.plant, self._plant_context = self._part("plant")
        names = ["desired_tasks"] + ["desired_prescribed"] * bool(self.model.n_p)
        self._sources = [self._part(name) for name in names]
        ball = balls[0].at(0.0) if balls else None
        self.ball = self._ball_home = self._ball_goal = ball
        self.offsets = np.zeros((len(self.model.layout.linear_tasks), 3))
        self.moved = self.offsets.copy()
        self.clock = MotionClock()
        self.events: deque[Event] = deque(maxlen=_MOST_EVENTS)
        self._pushes = list(scenario.disturbances.pushes)
        self.recorder = Recorder(setup, self.simulator)
        self._set_targets(0.0)
        self.simulator.Initialize()
        self.simulator.AdvanceTo(0.5 * self.period)

    @property
    def time(self) -> float:
        """Of the last control tick [s]."""
        return self._tick * self.period

    @property
    def phase(self) -> float:
        """Where the motion is [s]."""
        return self.clock.phase(self.time, self.duration)[0]

    @property
    def moves(self) -> bool:
        """Whether the motion runs, or is about to."""
        return self.clock.goal > 0.0

    @property
    def floor(self) -> float:
        """What no pair comes nearer than, by the lookahead [m]."""
        return self.scenario.controller.safety_distance

    @property
    def mode(self) -> str:
        """What the constraints are."""
        return self.scenario.controller.constraints

    def compile(self) -> None:
        """Compiles what has yet to be, before somebody waits for it."""
        self.controller.law.compile(bool(self.scenario.obstacles))

    def step(self) -> None:
        """Goes on by one control period.

        Raises:
            Exception: what stopped the simulation; it cannot go on.
        """
        next_time = self.time + self.period
        self.moved = _on_the_way(self.moved, self.offsets, _SPEED * self.period)
        self._set_targets(next_time)
        self._roll()
        self.simulator.AdvanceTo(next_time + 0.5 * self.period)
        self._tick += 1
        self.recorder.collect(self.scenario)

    # --- what a person does -------------------------------------------------------

    def set_offset(self, task: int, offset: np.ndarray) -> None:
        """Lets a target move away from the motion's, at a bounded speed.

        Args:
            task: its place in `layout.linear_tasks`.
            offset: (3,) to go to, in W [m].

        Raises:
            CrarError: there is no such task.
        """
        if not 0 <= task < len(self.offsets):
            raise CrarError(f"there is no target {task}")
        self.offsets[task] = offset
        name = self.model.layout.names[self.model.layout.linear_tasks[task]]
        x, y, z = offset
        self._note_drag(f"{name} moved by", f"{x:.3f}, {y:.3f}, {z:.3f} m")

    def take_offsets_away(self) -> None:
        """Lets all targets move back to the motion's."""
        for task in np.flatnonzero(self.offsets.any(axis=1)):
            self.set_offset(int(task), np.zeros(3))

    def set_ball(self, goal: np.ndarray | None) -> None:
        """Lets the ball move to a place, no faster than its speed.

        Args:
            goal: (3,) in W [m]; None is where it was at first.

        Raises:
            CrarError: there is no ball.
        """
        if self.ball is None:
            raise CrarError("this robot keeps off no obstacles: there is no ball")
        self._ball_goal = self._ball_home if goal is None else goal
        x, y, z = self._ball_goal
        self._note_drag(f"{BALL} to", f"{x:.2f}, {y:.2f}, {z:.2f}")

    def set_motion(self, on: bool) -> None:
        """Lets the motion stop where it is, or go on."""
        if on != self.moves:
            self.clock = self.clock.toward(self.time + self.period, float(on))
            self._note(f"motion {'on' if on else 'off'}")

    def push(self, frame: str, force: np.ndarray) -> None:
        """Pushes a frame at its origin, at once.

        Args:
            frame: of the plant, or of the description's tasks.
            force: (3,) in W, for `PUSH_TIME` [N].

        Raises:
            ModelError: there is no such frame.
            CrarError: all pushes together would be too strong.
        """
        push = Push(frame, list(map(float, force)), self._now, PUSH_TIME)
        frames = self.model.description.task_frames
        applied = applied_force(self.plant, frames, push)
        acting = [p.force for p in self._pushes if p.acts(push.start)]
        total = sum(map(np.linalg.norm, (*acting, push.force)))
        if total > MOST_PUSHED:
            raise CrarError(
                f"pushes of {total:.0f} N together; at most {MOST_PUSHED:g} N act at a "
                f"time, each for {PUSH_TIME:g} s"
            )
        source, context = self._part("pushes")
        source.add(context, push, applied)
        self._pushes.append(push)
        x, y, z = push.force
        self._note(f"{frame} pushed by {x:.0f}, {y:.0f}, {z:.0f} N")

    @property
    def pushed(self) -> bool:
        """Whether a push acted since the last tick."""
        return any(
            push.start < self._now and self.time < push.start + push.duration
            for push in self._pushes
        )

    # --- what is to be seen -------------------------------------------------------

    def positions(self) -> np.ndarray:
        """(nq,) of the plant now."""
        return self.plant.GetPositions(self._plant_context)

    def diagnostics(self) -> dict[str, np.ndarray]:
        """The parts of the controller's diagnostics now, by name."""
        return self.controller.diagnostics(self._controller_context)

    def obstacles(self) -> np.ndarray:
        """(N, 4) of those that move, centre and radius now [m]."""
        if not self.scenario.obstacles:
            return np.empty((0, 4))
        source, context = self._part("obstacles")
        return source.get_output_port().Eval(context).reshape(-1, 4)

    def holding_back(self) -> tuple[str, str] | None:
        """The obstacle that holds the robot back now, and which link; None if none."""
        found = self.controller.obstacle(self._controller_context)
        if found is None:
            return None
        number, link = found
        return self.scenario.obstacles[int(number)].name, link

    def beyond(self) -> tuple[str, float] | None:
        """The joint that is farthest beyond a limit now, and by how much [rad or m];
        None if none is."""
        model = self.setup.simulated
        q = self.positions()[model.controlled_positions]
        far = np.maximum(model.lower - q, q - model.upper)
        if not (far > LIMIT_TOLERANCE).any():
            return None
        joint = int(far.argmax())
        return model.joint_names[joint], float(far[joint])

    def targets(self) -> np.ndarray:
        """(layout.size,) [x_d; v_d; a_d] as they are now, `moved` included."""
        source, context = self._sources[0]
        return source.get_output_port().Eval(context)

    def wanted(self) -> np.ndarray:
        """(N, 3) where a person wants the targets of position and pose tasks [m]."""
        at = self.targets()[self.model.layout.position_entries]
        return at + self.offsets - self.moved

    def logged_scenario(self) -> Scenario:
        """The scenario that says what was done: its changes and pushes."""
        pushes = [push for push in self._pushes if push.start < self._now]
        return replace(
            self.scenario,
            description="\n".join([self.reported(), *self._changes()]),
            disturbances=replace(self.scenario.disturbances, pushes=pushes),
        )

    def _changes(self) -> list[str]:
        reported = list(self.events)[-_MOST_REPORTED:]
        return [f"{event.time:.3f} s: {event.what}" for event in reported]

    def reported(self) -> str:
        """What it was, in a line."""
        done = len(self.events)
        return f"played live, {done} change{'s' if done != 1 else ''} by hand"

    # --- inside -------------------------------------------------------------------

    def _part(self, name: str) -> tuple[System, Context]:
        """A system of the diagram, and its context."""
        system = self.diagram.GetSubsystemByName(name)
        root = self.simulator.get_mutable_context()
        return system, system.GetMyMutableContextFromRoot(root)

    def _set_targets(self, time: float) -> None:
        """Lets the sources emit what is wanted at a tick [s]."""
        phase, layout = self.clock.phase(time, self.duration), self.model.layout
        x = np.zeros(layout.size_x)
        x[layout.position_entries] = self.moved
        # Nobody moves prescribed joints.
        offsets = x, np.zeros(self.model.n_p)
        for (source, context), offset in zip(self._sources, offsets, strict=False):
            source.set(context, phase, offset)

    def _note_drag(self, words: str, where: str) -> None:
        """One drag is one event."""
        if self.events and self.events[-1].what.startswith(words):
            self.events.pop()
        self._note(f"{words} {where}")

    def _note(self, what: str) -> None:
        self.events.append(Event(self.time + self.period, what))

    @property
    def _now(self) -> float:
        """Where the simulator stands: half a period after the last tick [s]."""
        return self.time + 0.5 * self.period

    def _roll(self) -> None:
        """Moves the ball on its way, for the next tick."""
        if self.ball is None:
            return
        # A hair less than its speed, for the rounding.
        most = (1.0 - 1e-9) * _BALL_SPEED * self.period
        self.ball = _on_the_way(self.ball, self._ball_goal, most)
        shift = np.zeros((len(self.scenario.obstacles), 3))
        shift[-1] = self.ball - self._ball_home
        source, context = self._part("obstacles")
        source.shift(context, shift)


def _on_the_way(here: np.ndarray, goal: np.ndarray, most: float) -> np.ndarray:
    """(..., 3) from here to a goal, each no farther than `most` [m]."""
    way = goal - here
    far = np.linalg.norm(way, axis=-1, keepdims=True)
    return here + way * np.minimum(1.0, most / np.maximum(far, 1e-12))


def points_of(motion: DesiredMotion, layout: TaskLayout) -> np.ndarray:
    """(N, 3) where targets with a position are on the way of a motion [m]."""
    entries = layout.position_entries
    times = np.linspace(0.0, motion.duration, 60)
    return np.vstack([motion.tasks_at(t)[entries] for t in times])


def make_ball(setup: Setup) -> MovingObstacle:
    """A ball in front of the robot and its targets, at the height of these."""
    model, motion = setup.model, setup.motion
    plant, workspace = model.plant, model.MakeWorkspace()
    plant.SetPositions(workspace.plant_context, setup.start_positions)
    links = [
        plant.get_body(BodyIndex(i)).EvalPoseInWorld(workspace.plant_context)
        for i in range(1, plant.num_bodies())
    ]
    wanted = points_of(motion, model.layout)
    points = np.vstack([wanted, [X.translation() for X in links]])
    x = points[:, 0].max() + _BALL_AHEAD
    _, y, z = (wanted if len(wanted) else points).mean(axis=0)
    place = Place(0.0, [float(x), float(y), float(z)])
    return MovingObstacle(BALL, _BALL_RADIUS, _BALL_SPEED, [place])
