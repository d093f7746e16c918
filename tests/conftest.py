"""Fixtures that more than one test module needs."""

import os
from pathlib import Path

import matplotlib
import pytest

matplotlib.use("Agg")


@pytest.fixture(scope="session")
def cmu() -> Path:
    """The folder of the real CMU files, laid out as the database's own site."""
    folder = os.environ.get("CRAR_MOCAP_PATH", "")
    if not folder:
        pytest.skip("set CRAR_MOCAP_PATH to the folder of the CMU motion files")
    if not (Path(folder) / "subjects").is_dir():
        pytest.fail(f"CRAR_MOCAP_PATH={folder} has no subjects/ folder")
    return Path(folder)
