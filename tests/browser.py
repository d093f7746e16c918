"""Opens a recorded page in headless Chromium and looks at it at chosen times."""

import base64
import html
import io
import json
import re
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

_LISTEN = """<script>
const report = {errors: [], frames: []};
addEventListener("error", e => report.errors.push(String(e.message)));
addEventListener("unhandledrejection", e => report.errors.push(String(e.reason)));
</script>"""

_LOOK = """<script>
function picture() {
  viewer.render();
  return viewer.renderer.domElement.toDataURL();
}
function node(path) { return viewer.scene_tree.find(path.split("/")).object; }
function look() {
  const animator = viewer.animator;
  if (animator.actions.length == 0 || viewer.gui.closed) return setTimeout(look, 50);
  report.playing = animator.playing;
  report.durations = animator.actions.map(a => a.getClip().duration);
  report.repetitions = animator.actions.map(a => a.repetitions);
  animator.pause();
  for (const time of TIMES) {
    animator.seek(time);
    report.frames.push({
      image: picture(), visible: PATHS.map(path => node(path).visible),
    });
  }
  node("drake").visible = false;
  report.without_robot = picture();
  // Only what is not in the page itself.
  report.requests = performance.getEntriesByType("resource")
    .map(entry => entry.name).filter(name => !name.startsWith("data:"));
  const answer = document.createElement("pre");
  answer.id = "report";
  answer.textContent = JSON.stringify(report);
  document.body.append(answer);
}
addEventListener("load", look);
</script>"""


@dataclass(frozen=True)
class Look:
    """What was seen of a page.

    Attributes:
        errors: uncaught errors.
        requests: addresses that it asked for, itself not counted.
        playing: whether it played of its own.
        durations, repetitions: per track.
        images: per time, (height, width, 3) in [0, 1].
        visible: per time, per path whether its node is visible.
        without_robot: as the last image, Drake's geometry hidden.
    """

    errors: list[str]
    requests: list[str]
    playing: bool
    durations: list[float]
    repetitions: list[int]
    images: list[np.ndarray]
    visible: list[list[bool]]
    without_robot: np.ndarray


def look_at(
    page: Path, folder: Path, times: Sequence[float], paths: Sequence[str]
) -> Look:
    """Opens a page and seeks its animation; skips the test without a browser.

    Args:
        page: the .html file.
        folder: for a copy of it and the browser's own files.
        times: to look at [s].
        paths: of nodes of the scene tree, without the first "/".
    """
    names = ("chromium", "chromium-browser", "google-chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        pytest.skip("there is no Chromium to open the page in")
    script = _LOOK.replace("TIMES", json.dumps(list(times)))
    script = script.replace("PATHS", json.dumps(list(paths)))
    text = page.read_text(encoding="utf-8")
    assert "<head>" in text and text.rstrip().endswith("</html>")
    copy = folder / "copy.html"
    copy.write_text(text.replace("<head>", "<head>" + _LISTEN, 1) + script)
    command = [
        *(browser, "--headless", "--no-sandbox", "--disable-gpu"),
        *("--disable-background-networking", "--use-angle=swiftshader"),
        *("--enable-unsafe-swiftshader", "--window-size=640,480"),
        *(f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=10000"),
        *("--dump-dom", copy.as_uri()),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="report">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, f"the page did not play; the browser said: {done.stderr[-2000:]}"
    report = json.loads(html.unescape(found[1]))
    frames = report.pop("frames")
    report["without_robot"] = _decode(report["without_robot"])
    return Look(
        images=[_decode(frame["image"]) for frame in frames],
        visible=[frame["visible"] for frame in frames],
        **report,
    )


def _decode(data_url: str) -> np.ndarray:
    data = base64.b64decode(data_url.partition(",")[2])
    return matplotlib.image.imread(io.BytesIO(data), format="png")[:, :, :3]
