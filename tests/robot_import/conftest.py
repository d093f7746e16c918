"""Fixtures of the tests of the import."""

from pathlib import Path

import pytest

from crar_drake.robot_import import importer, link_fits
from crar_drake.robot_import.robot_files import robot_data_folder


@pytest.fixture(scope="session", autouse=True)
def each_link_fitted_once():
    """The robots of these tests share links; `fit_link` has tests of its own."""
    fit, known = link_fits.fit_link, {}

    def remembered(parts, most, excess, image=()):
        shapes = [(p.vertices.tobytes(), p.faces.tobytes()) for p in (*parts, *image)]
        key = (most, excess, len(parts), *shapes)
        if key not in known:
            known[key] = fit(parts, most, excess, image)
        return known[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(link_fits, "fit_link", remembered)
        yield


@pytest.fixture(autouse=True)
def no_picture_of_every_robot(monkeypatch):
    """They take as long as the rest; the robot of the session has one."""
    monkeypatch.setattr(importer, "draw_robot", lambda path, *_: path.touch())


@pytest.fixture(scope="session")
def robot_data() -> Path:
    """The folder of the package example-robot-data."""
    folder = robot_data_folder()
    if folder is None:
        pytest.skip("install the package example-robot-data (extra `robots`)")
    return folder
