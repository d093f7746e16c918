"""Draws the pictures of the documentation.

    python docs/make_images.py [out/compare.html] [out/reproduce/cmu]

`images/diagram.svg` comes from the diagram itself (needs Graphviz). Given a page of
`crar-drake compare`, `images/compare.webp` is what a browser shows of it, moving (needs
Chromium); given the folder of a reproduction, those that `reproduction.md` shows become
`images/section-iv-*`. The first page's picture is made by

    crar-drake run --no-recording --constraints none --out out/none
    crar-drake run --no-recording --out out/lookahead
    crar-drake compare out/none out/lookahead
    python docs/make_images.py out/compare.html
"""

import io
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from headless_browser import HeadlessBrowser
from PIL import Image

from crar_drake import MakeCrarDiagram, load_scenario

IMAGES = Path(__file__).resolve().parent / "images"
SIZE = 880, 600  # [pixels]
START, END = 7.0, 12.5  # of what is shown of the runs [s]
RATE = 8.0  # pictures per second
# Nobody presses a button in a picture.
_HIDDEN = "#crar-controls, #crar-legend { display: none !important; }"


def draw_diagram() -> None:
    diagram = MakeCrarDiagram(load_scenario("dance_wrists"))
    text = diagram.GetGraphvizString(max_depth=1)
    subprocess.run(
        ["dot", "-Tsvg", "-o", IMAGES / "diagram.svg"], input=text.encode(), check=True
    )


def draw_comparison(page: Path) -> None:
    pictures = []
    with HeadlessBrowser(*SIZE) as browser:
        browser.open(page, f"#t={START}")
        browser.evaluate(
            "document.head.append(Object.assign(document.createElement('style'), "
            f"{{ textContent: '{_HIDDEN}' }}))"
        )
        for time in np.arange(START, END, 1.0 / RATE):
            browser.evaluate(f"crar.seek({time})")
            browser.settle()
            pictures.append(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"))
    first, *others = pictures
    first.save(
        IMAGES / "compare.webp",
        append_images=others,
        save_all=True,
        duration=round(1e3 / RATE),
        loop=0,
        quality=70,
        method=4,
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
        (copy_figures if given.is_dir() else draw_comparison)(given)
