"""Fixtures of the tests of the import."""

from pathlib import Path

import pytest
from small_urdfs import humanoid, write

from crar_drake.robot_import.source_urdf import robot_data_folder


@pytest.fixture(scope="session")
def robot_data() -> Path:
    """The folder of the package example-robot-data."""
    folder = robot_data_folder()
    if folder is None:
        pytest.skip("install the package example-robot-data (extra `robots`)")
    return folder


@pytest.fixture(scope="session")
def imported(tmp_path_factory: pytest.TempPathFactory):
    """The small humanoid, imported with few capsules, and the report of it."""
    from crar_drake.robot_import import import_robot

    folder = tmp_path_factory.mktemp("small_humanoid")
    write(folder, humanoid())
    (folder / "import.yaml").write_text("source: small.urdf\nmost_capsules: 2\n")
    return import_robot("", folder)
