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
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Meshcat

from crar_drake.files import write_whole
from crar_drake.resources import page_resource
from crar_drake.results import marks
from crar_drake.results.packed_page import packed_array, packed_page
from crar_drake.results.recorded_run import DrawnRobot, RecordedRun
from crar_drake.simulation.visuals import GRID, VIEW_PITCH, VIEW_YAW, set_surroundings

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
class ShownRun:
    """One of the robots that a page shows."""

    recorded: RecordedRun  # how it moves, and what is near
    robot: int  # which of the page's robots it is
    label: str  # what it is called beside others
    figures: Sequence[dict]  # of it, see `figure`


def figure(name: str, value: str, bad: bool = False) -> dict:
    """A figure in a page's caption; `bad` ones stand out."""
    return {"name": name, "value": value, "bad": bad}


def empty_scene(meshcat: Meshcat | None) -> Meshcat:
    """A Meshcat with nothing but what surrounds the robots."""
    meshcat = meshcat or Meshcat()
    meshcat.Delete()
    set_surroundings(meshcat)
    return meshcat


def robot_prefix(number: int) -> str:
    """The path in Meshcat under which a page's robot of that number is drawn."""
    return f"/crar/robot{number}"


def write_page(
    path: str | os.PathLike[str],
    meshcat: Meshcat,
    robots: Sequence[DrawnRobot],
    shown: Sequence[ShownRun],
    *,
    title: str,
    subtitle: str,
    overlay: bool = False,
    spans: dict[str, str] | None = None,
    texts: dict | None = None,
) -> None:
    """Writes a page, whole or not at all.

    Args:
        meshcat: from `empty_scene`, in which the robots are drawn.
        robots: in it, each at its `robot_prefix`.
        shown: what moves; at most as many as `marks.RUNS`.
        overlay: whether the robots are laid over each other when the page opens.
        spans: of their recordings to the colours that they have; by default those of
            runs.
        texts: as `RUN_TEXTS`.

    Raises:
        WriteError: the file cannot be written.
    """
    arrays: list[bytes] = []
    entries = [
        {"label": run.label, "robot": run.robot, "colour": colour}
        | {"figures": list(run.figures)}
        | _recorded_entry(run.recorded, arrays)
        for run, colour in zip(shown, marks.RUNS, strict=False)
    ]
    outline = np.vstack([run.recorded.outline for run in shown])
    data = {
        "title": title,
        "subtitle": subtitle,
        "overlay": overlay,
        **page_look(),
        "spans": marks.SPANS if spans is None else spans,
        "texts": RUN_TEXTS if texts is None else texts,
        "robots": [
            {
                "prefix": robot_prefix(i),
                "paths": robot.paths,
                "spheres": len(robot.spheres),
            }
            for i, robot in enumerate(robots)
        ],
        "runs": entries,
        "outline": _rounded(outline.ravel(), 4),
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


def _recorded_entry(run: RecordedRun, arrays: list[bytes]) -> dict:
    """What the page's scripts read of a run; its arrays are added to the others."""
    packed = {}
    for name, step in _STEPS.items():
        packed[name] = len(arrays)
        arrays.append(packed_array(getattr(run, name), step))
    return {
        **packed,
        "rate": run.rate,
        "frames": len(run.time),
        "most": run.near.shape[1],
        "warning": run.warning_distance,
        "pairNames": [spoken(name) for name in run.pair_names],
        "targetNames": [spoken(name) for name in run.target_names],
        "curve": {
            "time": _rounded(run.curve_time, 3),
            "distance": _rounded(run.distance_curve, 5),
            "error": _rounded(run.error_curve, 5),
            "unit": run.error_unit,
        },
        "spans": {
            name: [[round(a, 3), round(b, 3)] for a, b in spans]
            for name, spans in run.spans.items()
        },
        "penetrating": run.penetrating,
    }


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]


def spoken(name: str) -> str:
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
