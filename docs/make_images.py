"""Draws the pictures of the documentation.

    python docs/make_images.py [out/compare.html] [out/reproduce/cmu]

`images/diagram.svg` comes from the diagram itself (needs Graphviz). Given a page of
`crar-drake show` that `VIEWS` names, `images/NAME.webp` is what a browser shows of
it, moving (needs Chromium); given the folder of a reproduction, those pictures that
`measurements/reproduction.md` shows become `images/section-iv-*`.

The first page's picture, a G1 before and after `crar-drake clean`, is made by

    crar-drake import-robot g1_whole_body
    crar-drake clean examples/g1_boxing.csv --robot g1_whole_body \\
        --out out/cleaned.csv --no-page
    crar-drake show examples/g1_boxing.csv out/cleaned.csv --robot g1_whole_body \\
        --label raw --label cleaned --out out/g1_boxing.html
    python docs/make_images.py out/g1_boxing.html

and that of the built-in robot, without and with constraints, by

    crar-drake run --no-page --set controller.constraints=none --out out/none
    crar-drake run --no-page --out out/lookahead
    crar-drake show out/none out/lookahead
    python docs/make_images.py out/compare.html
"""

import io
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from headless_browser import HeadlessBrowser
from PIL import Image

from crar_drake import MakeCrarDiagram, load_scenario

IMAGES = Path(__file__).resolve().parent / "images"
WIDTH = 880  # [pixels]
RATE = 8.0  # pictures per second


class View(NamedTuple):
    """What is shown of a page, and how near."""

    start: float  # [s]
    end: float  # [s]
    height: int = 600  # [pixels]
    zoom: float = 1.0
    higher: float = 0.0  # how far the camera and what it looks at are raised [m]


VIEWS = {"compare": View(7.0, 12.5), "g1_boxing": View(0.0, 2.5, 640, 1.7, 0.27)}
# Nobody presses a button in a picture.
_HIDDEN = "#crar-controls, #crar-legend { display: none !important; }"


def draw_diagram() -> None:
    diagram = MakeCrarDiagram(load_scenario("dance_wrists"))
    text = diagram.GetGraphvizString(max_depth=1)
    subprocess.run(
        ["dot", "-Tsvg", "-o", IMAGES / "diagram.svg"], input=text.encode(), check=True
    )


def draw_comparison(page: Path) -> None:
    view, pictures = VIEWS[page.stem], []
    with HeadlessBrowser(WIDTH, view.height) as browser:
        browser.open(page, f"#t={view.start}")
        browser.evaluate(
            "document.head.append(Object.assign(document.createElement('style'), "
            f"{{ textContent: '{_HIDDEN}' }}))"
        )
        # Meshcat's y points up. As if a user had moved it, the camera then stays.
        browser.evaluate(
            "viewer.controls.dispatchEvent({ type: 'start' }); "
            "for (const it of [viewer.camera.position, viewer.controls.target]) "
            f"it.y += {view.higher}; viewer.camera.zoom = {view.zoom}; "
            "viewer.camera.updateProjectionMatrix(); viewer.controls.update()"
        )
        for time in np.arange(view.start, view.end, 1.0 / RATE):
            browser.evaluate(f"crar.seek({time})")
            browser.settle()
            pictures.append(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"))
    first, *others = pictures
    first.save(
        IMAGES / f"{page.stem}.webp",
        append_images=others,
        save_all=True,
        duration=round(1e3 / RATE),
        loop=0,
        quality=70,
        method=4,
    )


def copy_figures(reproduction: Path) -> None:
    shown = (IMAGES.parent / "measurements" / "reproduction.md").read_text(
        encoding="utf-8"
    )
    for figure in (reproduction / "figures").iterdir():
        name = f"section-iv-{figure.name}"
        if name in shown:
            shutil.copy(figure, IMAGES / name)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    draw_diagram()
    for given in map(Path, sys.argv[1:]):
        (copy_figures if given.is_dir() else draw_comparison)(given)
