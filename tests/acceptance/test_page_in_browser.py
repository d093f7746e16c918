"""The page of a run in a real browser: it draws, plays, and says what the run was."""

import io
import json
from collections.abc import Iterator
from pathlib import Path

import matplotlib.image
import numpy as np
import product
import pytest
from browser import Browser, find_browser


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Of a run of a second, its page among its files."""
    if find_browser() is None:
        pytest.skip("there is no Chromium here to open the page in: install chromium")
    out = tmp_path_factory.mktemp("run") / "it"
    done = product.command("simulate", product.HANDS, duration=1.0, out=out)
    assert done.code == product.FINE, done.err
    return out


@pytest.fixture(scope="module")
def page(folder: Path) -> Iterator[Browser]:
    """The page, which has begun to play by itself, and is stopped."""
    with Browser(1280, 960) as browser:
        browser.open(folder / product.RUN_FILES["page"])
        browser.wait_for(product.PAGE_IS_READY)
        browser.wait_for(f"{product.PAGE_PLAYS} && {product.PAGE_TIME} > 0.05")
        browser.value(product.PAGE_STOP)
        yield browser


def text(page: Browser, part: str) -> str:
    selector = json.dumps(product.PAGE_PARTS[part])
    return page.value(f"document.querySelector({selector}).textContent")


@pytest.mark.parametrize("part", product.PAGE_PARTS)
def test_its_parts_are_seen(page: Browser, part: str):
    """Each has a place on the screen."""
    selector = json.dumps(product.PAGE_PARTS[part])
    box = page.value(
        f"(({{width, height}}) => [width, height])"
        f"(document.querySelector({selector}).getBoundingClientRect())"
    )
    assert min(box) > 4


def test_it_says_what_the_run_was(page: Browser, folder: Path):
    title = text(page, "title")
    assert product.BUILT_IN in title and product.MOTION in title
    told = product.read_figures(folder / product.RUN_FILES["figures"])
    figures = text(page, "figures")
    assert f"{1e3 * told['distance']:.1f} mm" in figures
    assert f"{1e3 * told['error']:.1f} mm" in figures
    assert told["violated"] == 0 and "none" in figures
    assert "target" in text(page, "legend")
    paths = json.dumps(product.PAGE_PARTS["time line"] + " path")
    assert page.value(f"document.querySelectorAll({paths}).length") >= 2


def look(page: Browser, time: float) -> np.ndarray:
    """(height, width, 3) of the scene at a time of the run, in [0, 1]."""
    page.value(product.PAGE_SEEK.format(time))
    picture = matplotlib.image.imread(io.BytesIO(page.picture()), format="png")
    selector = json.dumps(product.PAGE_PARTS["scene"])
    top, bottom, left, right = page.value(
        "(({top, bottom, left, right}) => [top, bottom, left, right])"
        f"(document.querySelector({selector}).getBoundingClientRect())"
    )
    return picture[round(top) : round(bottom), round(left) : round(right), :3]


def test_the_robot_is_drawn_and_moves(page: Browser):
    first, last = look(page, 0.0), look(page, 1.0)
    for image in (first, last):
        background = np.median(image.reshape(-1, 3), axis=0)
        drawn = np.abs(image - background).max(axis=2) > 0.1
        assert 0.02 < drawn.mean() < 0.9
    changed = (np.abs(last - first).max(axis=2) > 0.1).mean()
    assert 1e-3 < changed < 0.5


def test_it_complains_of_nothing_and_asks_for_nothing(page: Browser):
    look(page, 0.5)
    assert page.complaints == [] and page.requests == []
