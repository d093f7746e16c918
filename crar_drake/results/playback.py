"""The recorded page: what was drawn of a run as one HTML file to play back.

`save_recording` ends what `simulation.visualization.start_recording` began;
`record_log` makes the same page from a saved log.
"""

from __future__ import annotations

import copy
import os

import numpy as np
from pydrake.geometry import Meshcat, MeshcatAnimation
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from crar_drake.equations.tasks import TaskLayout
from crar_drake.errors import CrarError
from crar_drake.files import whole_file
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_robot import (
    check_logged_robot,
    load_logged_robot,
    load_logged_scenario,
)
from crar_drake.robot.description import add_robot
from crar_drake.simulation.scenario import Scenario
from crar_drake.simulation.visualization import AddVisualization, start_recording
from crar_drake.simulation.visuals import models_without_visuals

# Opens the panel with the play, pause and time controls, whose folder of the scene
# tree is long; and gives every track the length of the longest. A track ends with
# its last key, so a warning shell's would repeat sooner than the robot's.
_PAGE_SCRIPT = """
  <script>
    (function arrange() {
      const animator = viewer.animator;
      if (animator.actions.length == 0) { requestAnimationFrame(arrange); return; }
      for (const action of animator.actions)
        action.getClip().duration = animator.duration;
      animator.reset();
      viewer.gui.__folders["Scene"].close();
      viewer.gui.open();
    })();
  </script>
"""


def save_recording(meshcat: Meshcat, path: str | os.PathLike[str]) -> None:
    """Ends the recording and writes it as one page that needs no network.

    The page plays in a loop, with its controls open: play, pause, time, time scale.

    Args:
        meshcat: that was recorded.
        path: of the .html file; appears whole or not at all.
    """
    meshcat.StopRecording()
    animation = meshcat.get_mutable_recording()
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(1_000_000)
    meshcat.PublishRecording()
    page = meshcat.StaticHtml()
    body, end, rest = page.rpartition("</body>")
    with whole_file(path) as temporary:
        temporary.write_text(body + _PAGE_SCRIPT + end + rest, encoding="utf-8")


def record_log(
    log: SimulationLog,
    path: str | os.PathLike[str],
    *,
    frames_per_second: float = 32.0,
    meshcat: Meshcat | None = None,
    robot: str = "",
    scenario: Scenario | None = None,
) -> list[str]:
    """Writes the page of a run from its log, without simulating again.

    Args:
        log: from `SimulationLog.load`, or of a run just made.
        path: of the .html file.
        frames_per_second: of the recording; the log is interpolated to them.
        meshcat: to draw into; by default one of its own.
        robot: where the robot is now, or its name; by default what the log says.
        scenario: of the log, if it is at hand; by default the log's text is parsed.

    Returns:
        The models whose collision shapes were drawn, for want of anything else.

    Raises:
        CrarError: the log is empty, does not fit its robot any more, or
            `frames_per_second` is not positive.
        ModelError, ScenarioError: its robot or its scenario is not there any more.
    """
    if not len(log.time):
        raise CrarError("the log is empty: there is nothing to play back")
    if not 0.0 < frames_per_second < np.inf:
        raise CrarError(f"frames_per_second: {frames_per_second} must be positive")
    scenario = scenario or load_logged_scenario(log)
    description = load_logged_robot(log, robot, scenario)
    layout = TaskLayout(tuple(log.task_names), tuple(log.task_kinds))
    period = 1.0 / frames_per_second

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_robot(plant, description)
    plant.Finalize()
    pairs = [(a, b) for a, b in description.pairs]
    check_logged_robot(log, plant, description)
    meshcat = meshcat or Meshcat()
    unseen = models_without_visuals(plant, scene_graph.model_inspector())
    visualization = copy.deepcopy(scenario.visualization)  # the caller keeps its own
    visualization.publish_period = period
    overlay = AddVisualization(
        builder,
        visualization,
        meshcat,
        plant,
        scene_graph,
        pairs,
        [layout.names[i] for i in layout.linear_tasks],
        scenario.warning_distance,
    )
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    plant_context = plant.GetMyMutableContextFromRoot(context)
    overlay_context = overlay.GetMyMutableContextFromRoot(context)

    time = log.time - log.time[0]
    frames = np.arange(np.floor(time[-1] / period + 1e-6) + 1.0) * period
    q = _resample(frames, time, log.q)
    targets = _resample(
        frames, time, log.desired_tasks[:, layout.position_entries.ravel()]
    )
    distances = _resample(frames, time, log.signed_distances)
    start_recording(meshcat, period)
    diagram.ExecuteInitializationEvents(context)
    for i, now in enumerate(frames):
        context.SetTime(now)
        plant.SetPositions(plant_context, q[i])
        overlay.get_input_port_target_positions().FixValue(overlay_context, targets[i])
        overlay.get_input_port_signed_distances().FixValue(
            overlay_context, distances[i]
        )
        diagram.ForcedPublish(context)
    save_recording(meshcat, path)
    return unseen


def _resample(frames: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolates the columns of `values` (T, k), sampled at `time` (T,)."""
    columns = [np.interp(frames, time, column) for column in values.T]
    return np.column_stack(columns) if columns else np.empty((len(frames), 0))
