"""The page of `crar-drake play`: Meshcat's viewer, and what is laid over and beside it.

Its scripts share how robots are looked at, and how targets and near pairs are drawn,
with those of the recorded page.
"""

import html
import json
from pathlib import Path

from pydrake.common import FindResourceOrThrow
from pydrake.multibody.tree import BodyIndex

from crar_drake.play.live_scene import PREFIX, LiveScene
from crar_drake.play.live_simulation import LiveSimulation
from crar_drake.play.pacing import FASTEST, SLOWEST
from crar_drake.play.requests import STRONGEST
from crar_drake.resources import page_resource
from crar_drake.results.drawn_robot import MOST_NEAR
from crar_drake.results.recorded_page import page_look, spoken
from crar_drake.results.summary import motion_name, robot_name

_SCRIPTS = ("live_run.js", "handles.js", "panel.js", "play.js")


def make_page(live: LiveSimulation, scene: LiveScene, meshcat_port: int) -> str:
    """The page as HTML.

    Args:
        meshcat_port: of Meshcat, at the same host as the page.
    """
    layout, scenario = live.model.layout, live.scenario
    motion = motion_name(scenario.motion) if scenario.motion else "its keyframes"
    data = {
        "title": f"{robot_name(scenario.robot)} following {motion}",
        "meshcatPort": meshcat_port,
        "period": live.period,
        "duration": live.duration,
        "tasks": [spoken(layout.names[i]) for i in layout.linear_tasks],
        "pairs": [spoken(f"{a} - {b}") for a, b in live.model.pairs.names],
        "most": MOST_NEAR,
        "warning": scenario.warning_distance,
        "floor": live.floor,
        "frames": _push_frames(live),
        "strongest": STRONGEST,
        "speeds": [SLOWEST, FASTEST],
        "ball": _ball(live),
        "overlay": False,
        **page_look(),
        "robots": [{"prefix": PREFIX, "paths": scene.robot.paths}],
        "outline": scene.outline.round(4).ravel().tolist(),
    }
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")
    styles = page_resource("page.css") + page_resource("play.css", "play")
    scripts = [page_resource("view.js"), page_resource("marks.js")]
    scripts += [page_resource(name, "play") for name in _SCRIPTS]
    page = page_resource("play.html", "play")
    for mark, what in {
        "TITLE": html.escape(data["title"]),
        "STYLES": styles,
        "DATA": text,
        "SCRIPTS": "\n".join(scripts),
    }.items():
        page = page.replace(f"<!--{mark}-->", what)
    return page


def viewer_script() -> bytes:
    """The script of Meshcat's viewer, as Drake has it."""
    return Path(FindResourceOrThrow("drake/geometry/meshcat.js")).read_bytes()


def _ball(live: LiveSimulation) -> dict | None:
    """The obstacle that is dragged, which is the last one; None if there is none."""
    if live.ball is None:
        return None
    ball = live.scenario.obstacles[-1]
    return {"radius": ball.radius, "speed": ball.fastest}


def _push_frames(live: LiveSimulation) -> list[dict]:
    """What can be pushed: bodies that move and have a mass, and the tasks' frames."""
    plant = live.plant
    anchored = plant.GetBodiesWeldedTo(plant.world_body())
    bodies = [
        body.name()
        for body in map(plant.get_body, map(BodyIndex, range(plant.num_bodies())))
        if body not in anchored and body.default_mass() > 0.0
    ]
    frames = [live.model.tasks[i].frame for i in live.model.layout.linear_tasks]
    names = dict.fromkeys([*frames, *bodies])
    return [{"name": name, "label": spoken(name)} for name in names]
