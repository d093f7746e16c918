"""The recorded page: robots that move, side by side over one time line, as HTML.

`write_page` puts what is recorded of them into Meshcat's own page, which holds the
robots, with what `results/page/` holds: it moves them, and draws targets, distances and
the time line. Runs come from logs (`playback`), reference motions from their files
(`crar_drake.results.motion_page`).
"""

import html
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.files import write_whole
from crar_drake.resources import page_resource
from crar_drake.results import marks
from crar_drake.results.drawn_person import DrawnPerson
from crar_drake.results.drawn_robot import DrawnRobot
from crar_drake.results.packed_page import packed_array, packed_page
from crar_drake.simulation.visuals import GRID, VIEW_PITCH, VIEW_YAW, set_surroundings
from crar_drake.strict_json import finite

_SCRIPTS = ("view.js", "marks.js", "timeline.js", "page.js")

# What the page's numbers are rounded to, far below a pixel: poses and points [m, 1],
# and where links are near each other [m].
_STEPS = {"poses": 2**-14, "targets": 2**-14, "reached": 2**-14, "near": 2**-17}

# What the time line calls its curves, where there is room and where there is little,
# and the legend what is drawn.
RUN_TEXTS = {
    "distance": ("smallest distance", "nearest"),
    "error": ("largest error of a target", "error"),
    "inside": "links inside each other",
}


@dataclass(frozen=True)
class RecordedRun:
    """One of the robots that a page shows, at F frames."""

    robot: DrawnRobot | DrawnPerson  # that several runs of a page may share
    label: str  # what it is called beside others
    figures: Sequence[dict]  # in the caption, see `figure`
    # at which links count as near each other; 0 if only those inside each other do [m]
    warning_distance: float
    rate: float  # of the frames [Hz]
    # (F, B, 7) of the links that are drawn and move, and then of the obstacles that do:
    # p_WB [m] and the quaternion (x, y, z, w) of R_WB
    poses: np.ndarray
    # (F, K, 8) of the nearest pairs, nearest first: the pair's number, its signed
    # distance [m], and a point on either surface [m]; NaN where fewer are near
    near: np.ndarray
    outline: np.ndarray  # (P, 3) outermost points of all frames [m]
    pair_names: Sequence[str]
    # (C,) when the curves are [s]; the smallest of all distances around that time [m],
    # and the largest of all errors [m or rad], which may have NaN; both may be empty
    curve_time: np.ndarray
    distance_curve: np.ndarray
    error_curve: np.ndarray
    error_unit: str  # "m" or "rad"; "" without errors
    # name of what is marked on the time line to its spans (start, end) [s]
    spans: dict[str, list[tuple[float, float]]]
    target_names: Sequence[str]
    # (F, N, 3) p_WT, NaN where there is none, and where the points are that should be
    # there [m]
    targets: np.ndarray
    reached: np.ndarray
    # link, as its number among those that are drawn and move, to the first and last of
    # frames in a row in which it is inside another
    penetrating: dict[int, list[tuple[int, int]]] = field(default_factory=dict)


def figure(name: str, value: str, bad: bool = False) -> dict:
    """A figure in a page's caption; `bad` ones stand out."""
    return {"name": name, "value": value, "bad": bad}


def empty_scene() -> Meshcat:
    """A Meshcat with nothing but what surrounds the robots."""
    meshcat = Meshcat()
    set_surroundings(meshcat)
    return meshcat


def robot_prefix(number: int) -> str:
    """The path in Meshcat under which a page's robot of that number is drawn."""
    return f"/crar/robot{number}"


def write_page(
    path: str | os.PathLike[str],
    meshcat: Meshcat,
    runs: Sequence[RecordedRun],
    *,
    title: str,
    subtitle: str,
    overlay: bool,
    spans: dict[str, str] = marks.SPANS,
    texts: dict = RUN_TEXTS,
) -> None:
    """Writes a page, whole or not at all.

    Args:
        meshcat: from `empty_scene`, in which the robots are drawn.
        runs: what moves; at most as many as `marks.RUNS`.
        overlay: whether the robots are laid over each other when the page opens.
        spans: what is marked on the time line to its colour.
        texts: as `RUN_TEXTS`.

    Raises:
        WriteError: the file cannot be written.
    """
    arrays: list[bytes] = []
    robots = list(dict.fromkeys(run.robot for run in runs))
    data = {
        "title": title,
        "subtitle": subtitle,
        "overlay": overlay,
        **page_look(),
        "spans": spans,
        "texts": texts,
        "robots": [
            {
                "prefix": robot.prefix,
                "paths": robot.paths,
                "spheres": len(robot.spheres),
            }
            for robot in robots
        ],
        "runs": [
            {"robot": robots.index(run.robot), "colour": colour, **_entry(run, arrays)}
            for run, colour in zip(runs, marks.RUNS, strict=False)
        ],
        "outline": finite(np.vstack([run.outline for run in runs]).ravel(), 4),
    }
    page = packed_page(_page(meshcat.StaticHtml(), data), arrays)
    write_whole(path, page)


def page_look() -> dict:
    """What the scripts of a page read of how it looks: view, grid, colours, scales."""
    return {
        "grid": GRID,
        "view": {
            "azimuth": float(np.degrees(VIEW_YAW)),
            "elevation": float(np.degrees(VIEW_PITCH)),
        },
        "colours": {
            "target": marks.TARGET,
            "obstacle": marks.OBSTACLE,
            "violation": marks.VIOLATION,
            "smallest": marks.SMALLEST,
        },
        "nearness": {"colours": marks.NEARNESS, "steps": marks.NEARNESS_STEPS},
        "scaleUnit": marks.SCALE_UNIT,
    }


def _entry(run: RecordedRun, arrays: list[bytes]) -> dict:
    """What the page's scripts read of a run; its arrays are added to the others."""
    packed = {}
    for name, step in _STEPS.items():
        packed[name] = len(arrays)
        arrays.append(packed_array(getattr(run, name), step))
    return {
        "label": run.label,
        "figures": list(run.figures),
        **packed,
        "rate": run.rate,
        "frames": len(run.poses),
        "most": run.near.shape[1],
        "warning": run.warning_distance,
        "pairNames": [spoken(name) for name in run.pair_names],
        "targetNames": [spoken(name) for name in run.target_names],
        "curve": {
            "time": finite(run.curve_time, 3),
            "distance": finite(run.distance_curve, 5),
            "error": finite(run.error_curve, 5),
            "unit": run.error_unit,
        },
        "spans": {name: finite(spans, 3) for name, spans in run.spans.items()},
        "penetrating": run.penetrating,
    }


def spoken(name: str) -> str:
    """The name of a joint, a link or a pair, for people."""
    return name.replace("_", " ").replace(" - ", " – ")


def _page(meshcat_page: str, data: dict) -> str:
    """Meshcat's page with ours in it."""
    # What stands in a script ends at the first "</script", wherever that is.
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    text = text.replace("<", "\\u003c").replace("\u2028", "\\u2028")
    page = re.sub(
        r"<title>.*?</title>",
        lambda _: (
            f"<title>{html.escape(data['title'])}</title>\n"
            '  <meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"  <style>\n{page_resource('page.css')}  </style>"
        ),
        meshcat_page,
        count=1,
    )
    scripts = "\n".join(page_resource(name) for name in _SCRIPTS)
    body, end, rest = page.rpartition("</body>")
    return (
        f"{body}{page_resource('page.html')}"
        f'<script type="application/json" id="crar-data">{text}</script>\n'
        f'<script>\n(() => {{\n"use strict";\n{scripts}}})();\n</script>\n{end}{rest}'
    )
