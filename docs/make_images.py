"""Draws the pictures of the documentation.

    python docs/make_images.py [out/dance/recording.html] [out/reproduce/cmu]

`images/diagram.svg` comes from the diagram itself (needs Graphviz). Given a recorded
page, `images/dance.png` is what a browser shows of it (needs Chromium); given the
folder of a reproduction, those that `reproduction.md` shows become
`images/section-iv-*`.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from crar_drake import MakeCrarDiagram, load_scenario

IMAGES = Path(__file__).resolve().parent / "images"
SECONDS = 9.0  # into the recording


def draw_diagram() -> None:
    diagram = MakeCrarDiagram(load_scenario("dance_wrists"))
    text = diagram.GetGraphvizString(max_depth=1)
    subprocess.run(
        ["dot", "-Tsvg", "-o", IMAGES / "diagram.svg"], input=text.encode(), check=True
    )


def draw_recording(page: Path) -> None:
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [
                "chromium",
                "--headless",
                "--no-sandbox",
                "--use-gl=angle",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--disable-background-networking",
                "--no-first-run",
                "--hide-scrollbars",
                f"--user-data-dir={profile}",
                f"--virtual-time-budget={int(1000 * SECONDS)}",
                "--window-size=1000,640",
                f"--screenshot={IMAGES / 'dance.png'}",
                page.resolve().as_uri(),
            ],
            check=True,
            capture_output=True,
        )


def copy_figures(reproduction: Path) -> None:
    shown = (IMAGES.parent / "reproduction.md").read_text(encoding="utf-8")
    for figure in (reproduction / "figures").iterdir():
        name = f"section-iv-{figure.name}"
        if name in shown:
            shutil.copy(figure, IMAGES / name)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    draw_diagram()
    for given in map(Path, sys.argv[1:]):
        (copy_figures if given.is_dir() else draw_recording)(given)
