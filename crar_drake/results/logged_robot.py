"""Scenario and robot of a saved log; the robot may have moved or changed since."""

from pydrake.multibody.plant import MultibodyPlant

from crar_drake.errors import CrarError, ModelError
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import RobotDescription, load_robot_description
from crar_drake.robot.joints import names_by_joint
from crar_drake.simulation.scenario import Scenario, parse_scenario


def load_logged_scenario(log: SimulationLog) -> Scenario:
    """The scenario that a log was made with, from the log's text.

    Raises:
        ScenarioError: it is not one of this version.
    """
    return parse_scenario(log.scenario, "the log's scenario")


def load_logged_robot(log: SimulationLog, robot: str = "") -> RobotDescription:
    """Loads the robot that a log was made with.

    Args:
        log: that names it: by its name, or by where it lay at the run.
        robot: where it is now, or its name; by default what the log says.

    Raises:
        ModelError: it is not there (any more), not imported, or not a description.
        ScenarioError: the log's scenario is not one of this version.
    """
    name = robot or load_logged_scenario(log).robot
    try:
        return load_robot_description(name)
    except ModelError as error:
        if robot:
            raise
        raise ModelError(
            f"the log's robot is not found: {error}; if it lies elsewhere now, say "
            "where with --robot"
        ) from error


def check_logged_robot(
    log: SimulationLog, plant: MultibodyPlant, description: RobotDescription
) -> None:
    """Raises CrarError unless a log's columns are those of the robot as it is now.

    Args:
        plant: finalized, with the robot in it and nothing else.
    """
    for what, ours, logged in (
        ("positions", plant.num_positions(), log.q.shape[1]),
        ("watched pairs", len(description.pairs), log.signed_distances.shape[1]),
    ):
        if ours != logged:
            raise CrarError(
                f"the log has {logged} {what} but robot {description.name} {ours}: it "
                "was made with another model"
            )
    if names_by_joint(plant, of_positions=True) != log.position_names.tolist():
        raise CrarError(
            f"robot {description.name} has other joints than the log, or has them in "
            "another order: it was made with another model"
        )
