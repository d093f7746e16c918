"""A server from a scenario: its robot, its tasks, its gains."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from crar_drake.addresses import listen
from crar_drake.errors import ScenarioError
from crar_drake.law.parameters import (
    LookaheadParameters,
    SafetyParameters,
    with_constraints,
)
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.standing import standing_description
from crar_drake.simulation.scenario import Scenario, load_scenario
from crar_drake.teleoperation.filtered_motion import FilteredMotion
from crar_drake.teleoperation.gate import Gate
from crar_drake.teleoperation.server import TeleoperationServer
from crar_drake.teleoperation.task_motion import TaskMotion


def make_server(
    scenario: str = "dance_wrists",
    *,
    robot: str = "",
    experiment: str = "",
    joints: bool = False,
    rate: float = 200.0,
    gate: Gate | None = None,
    start: Mapping[str, float] | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    latency: float = 0.0,
    tracking_error: float = math.inf,
    start_measured: bool = False,
) -> TeleoperationServer:
    """Makes a server, ready to run.

    Args:
        scenario: path or name; its motion is not used, and whatever its constraints
            are, these are those that hold by proof.
        robot: instead of its robot.
        experiment: instead of its tasks.
        joints: whether targets are positions of joints, which `SafetyFilter` makes
            safe; of the scenario the robot and `lookahead.tracking_error` count then.
        rate: commands per second [Hz].
        gate: what a target may be.
        start: see `SafeMotion.begin`.
        host, port: see `listen`.
        latency, tracking_error, start_measured: see `TeleoperationServer`.

    Raises:
        CrarError: something in the scenario or the robot is wrong, or nothing can
            listen there.
    """
    opened = listen("UDP", host, port)  # what takes no time to find out comes first
    try:
        if joints and experiment:
            raise ScenarioError(
                f"--tasks {experiment}: of --joints the joints are all targets"
            )
        loaded = load_scenario(scenario)
        loaded.robot = robot or loaded.robot
        if experiment:
            loaded.experiment, loaded.tasks = experiment, []
        gate = gate or Gate()
        if joints:
            motion = _make_filtered(loaded, rate, gate.joint_speed, start)
        else:
            motion = _make_motion(loaded, rate, start)
    except BaseException:
        opened.close()
        raise
    return TeleoperationServer(
        motion,
        gate,
        opened=opened,
        latency=latency,
        tracking_error=tracking_error,
        start_measured=start_measured,
    )


def _make_filtered(
    scenario: Scenario,
    rate: float,
    joint_speed: float,
    start: Mapping[str, float] | None,
) -> FilteredMotion:
    stated, ahead = scenario.controller, SafetyParameters()
    if isinstance(stated, LookaheadParameters):
        ahead = SafetyParameters(
            tracking_error=stated.tracking_error,
            tracking_errors=stated.tracking_errors,
            evade=stated.evade,
        )
    description = load_robot_description(scenario.robot)
    with _naming_rate(rate):
        made = SafetyFilter(description, 1.0 / rate)
    # A target that jumps is gone to no faster than one may move.
    fastest = np.minimum(made.model.velocity_limits, joint_speed)
    limits = dict(zip(made.joint_names, fastest.tolist(), strict=True))
    return FilteredMotion(
        SafetyFilter(made.model, 1.0 / rate, replace(ahead, velocity_limits=limits)),
        start,
        stated.blend_time,
    )


def _make_motion(
    scenario: Scenario, rate: float, start: Mapping[str, float] | None
) -> TaskMotion:
    with _naming_rate(rate):
        parameters = with_constraints(scenario.controller, "lookahead")
        parameters = replace(parameters, period=1.0 / rate)
        parameters.validate()
    description = load_robot_description(scenario.robot)
    if scenario.standing is not None:
        description = standing_description(description)
    model = ControlModel.FromDescription(
        description, scenario.task_list(), time_step=1.0 / rate
    )
    return TaskMotion(model, parameters, start)


@contextmanager
def _naming_rate(rate: float) -> Iterator[None]:
    """Names the option where a period is out of range."""
    try:
        yield
    except ScenarioError as error:
        raise ScenarioError(f"--rate {rate:g}: {error}") from error
