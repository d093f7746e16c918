"""How a robot stood in a run: what was measured of it, and the figures."""

from dataclasses import dataclass, replace

import numpy as np

from crar_drake.law.references import find_error
from crar_drake.law.standing_law import StandingLaw
from crar_drake.results.log import SimulationLog
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.scenario import Scenario


@dataclass(frozen=True)
class Stance:
    """How a robot stood on its soles."""

    lean: float  # largest angle between the root and where it stands upright [rad]
    slide: float  # farthest that a sole's corner was from where it stood [m]
    lift: float  # highest that a corner of a sole was above the floor [m]
    # when the robot began to lie [s]; None if it stood to the end. The other figures
    # are of the time before.
    fell: float | None

    def line(self) -> str:
        """The figures in words."""
        figures = (
            f"root leans by at most {np.degrees(self.lean):.1f}°, soles slide by "
            f"{1e3 * self.slide:.0f} mm and lift by {1e3 * self.lift:.0f} mm"
        )
        if self.fell is None:
            return f"stands: {figures}"
        return f"FELL at {self.fell:.2f} s; before, {figures}"


def stance(log: SimulationLog, model: ControlModel, friction: float) -> Stance:
    """How the robot of a log stood.

    Args:
        log: of a run with `standing`.
        model: of the robot that was simulated, whose root floats.

    Raises:
        ModelError: the robot has no soles on legs.
    """
    law = StandingLaw(model.plant, model.description, friction)
    context = model.plant.CreateDefaultContext()
    at_rest = np.vstack(law.corners_at_rest)
    lean = slide = lift = 0.0
    for time, q in zip(log.time, log.q, strict=True):
        model.plant.SetPositions(context, q)
        if law.fell(context):
            return Stance(lean, slide, lift, float(time))
        corners = np.vstack(law.corners(context))
        ways = np.linalg.norm((corners - at_rest)[:, :2], axis=1)
        lean = max(lean, law.lean(context))
        slide = max(slide, float(ways.max()))
        lift = max(lift, float(corners[:, 2].max()) - law.floor)
    return Stance(lean, slide, lift, None)


def judged_speed_limits(scenario: Scenario, model: ControlModel) -> np.ndarray:
    """(nv,) the largest speeds of the robot that is simulated [rad/s or m/s].

    A robot that stands follows a command that may be kept to a share of them, and is
    to keep to the whole.
    """
    parameters = scenario.controller
    if scenario.standing is not None:
        scale = max(parameters.velocity_scale, 1.0)
        parameters = replace(parameters, velocity_scale=scale)
    return parameters.speed_limits(model)


def as_measured(
    reported: dict[str, np.ndarray],
    q: np.ndarray,
    v: np.ndarray,
    desired_tasks: np.ndarray,
    commanded: ControlModel,
    simulated: ControlModel,
) -> dict[str, np.ndarray]:
    """What a log says of the robot, where the controller saw its own command.

    Args:
        reported: of the controller, by name, as a log has it, T samples.
        q, v: (T, nq), (T, nv) of the robot.
        desired_tasks: (T, layout.size).
        commanded, simulated: models of the command and of the robot.

    Returns:
        Those of `task_error`, `signed_distances` and `constraint_weights` that belong
        to the robot. Joints that the controller did not control weigh 1.
    """
    workspace, layout = simulated.MakeWorkspace(), simulated.layout
    errors = np.empty_like(reported["task_error"])
    distances = np.empty((len(q), len(simulated.pairs.names)))
    for i in range(len(q)):
        at = simulated.evaluate(workspace, q[i], v[i])
        distances[i] = at.d
        desired = layout.unpack(desired_tasks[i])
        errors[i] = find_error(at.q, at.R, at.p, desired, layout.rows)
    errors[np.isnan(reported["task_error"])] = np.nan
    weights = np.ones((len(q), simulated.n))
    for column, name in zip(
        reported["constraint_weights"].T, commanded.joint_names, strict=True
    ):
        weights[:, simulated.joint_names.index(name)] = column
    return {
        "task_error": errors,
        "signed_distances": distances,
        "constraint_weights": weights,
    }
