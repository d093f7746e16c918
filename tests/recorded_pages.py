"""What is in a recorded page, and what a browser shows of it."""

import base64
import gzip
import io
import json
import re
from pathlib import Path

import matplotlib.image
import numpy as np

from docs.headless_browser import HeadlessBrowser


def read_parts(page: Path) -> tuple[list[bytes], list[str]]:
    """What is compressed in the page: arrays and what Meshcat draws, and scripts."""
    match = re.search(
        r'id="crar-packed" data-parts="([\d ]*)" data-scripts="([\d ]*)">([^<]*)<',
        page.read_text(encoding="utf-8"),
    )
    stream = io.BytesIO(gzip.decompress(base64.b64decode(match[3], validate=True)))
    parts, scripts = ([stream.read(int(n)) for n in match[k].split()] for k in (1, 2))
    assert not stream.read()
    return parts, [script.decode() for script in scripts]


def read_data(page: Path) -> dict:
    """What the page's scripts read, arrays unpacked: (F, columns)."""
    text = page.read_text(encoding="utf-8")
    data = json.loads(re.search(r'id="crar-data">(.*?)</script>', text, re.DOTALL)[1])
    parts, _ = read_parts(page)
    for run in data["runs"]:
        for name in ("poses", "targets", "reached", "near"):
            planes = np.frombuffer(parts[run[name]], np.uint8).reshape(4, -1)
            columns = np.ascontiguousarray(planes.T).view("<f4")
            run[name] = columns.reshape(-1, run["frames"]).T
    return data


def look(browser: HeadlessBrowser, time: float) -> np.ndarray:
    """(height, width, 3) of the robots' part of the page at that time, in [0, 1]."""
    browser.evaluate(f"crar.seek({time})")
    browser.settle()
    image = matplotlib.image.imread(io.BytesIO(browser.screenshot()), format="png")
    box = browser.evaluate(
        "(({top, bottom}) => [top, bottom])"
        "(document.getElementById('crar-stage').getBoundingClientRect())"
    )
    return image[round(box[0]) : round(box[1]), :, :3]
