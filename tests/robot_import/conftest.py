"""Fixtures of the tests of the import."""

from pathlib import Path

import pytest

from crar_drake.robot_import.robot_files import robot_data_folder


@pytest.fixture(scope="session")
def robot_data() -> Path:
    """The folder of the package example-robot-data."""
    folder = robot_data_folder()
    if folder is None:
        pytest.skip("install the package example-robot-data (extra `robots`)")
    return folder
