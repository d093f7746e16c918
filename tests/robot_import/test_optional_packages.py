"""Without an optional package the import says which extra to install, no more."""

import subprocess
import sys
from pathlib import Path

import pytest
from small_mjcfs import humanoid as humanoid_in_mjcf
from small_urdfs import humanoid, write

from crar_drake.resources import install_command

# A process in which these modules and their distributions are not installed: no finder
# finds them, as if they were not there.
WITHOUT = """
import importlib.metadata, sys
from importlib.machinery import PathFinder

modules, distributions = {modules!r}, {distributions!r}

class Finder(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.partition(".")[0] in modules:
            return None
        return super().find_spec(name, path, target)

sys.meta_path = [Finder if f is PathFinder else f for f in sys.meta_path]
found = importlib.metadata.distribution

def distribution(name):
    if name in distributions:
        raise importlib.metadata.PackageNotFoundError(name)
    return found(name)

importlib.metadata.distribution = distribution
from crar_drake.resources import install_command
from crar_drake.commands import main
sys.exit(main(sys.argv[1:]))
"""

MESH_PACKAGES = {
    "trimesh": "trimesh",
    "collada": "pycollada",
    "networkx": "networkx",
    "fast_simplification": "fast-simplification",
}


def run_without(packages: dict[str, str], *arguments: str, folder: Path):
    """Runs the command line where those modules of those packages are missing."""
    script = WITHOUT.format(
        modules=list(packages), distributions=list(packages.values())
    )
    return subprocess.run(
        [sys.executable, "-c", script, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=900,
        check=False,
    )


def only_line(finished) -> str:
    """What a refused command says: one line on stderr, and exit code 2."""
    assert finished.returncode == 2, finished.stderr
    assert not finished.stdout
    (line,) = finished.stderr.splitlines()
    return line


@pytest.mark.parametrize("module, package", MESH_PACKAGES.items())
def test_a_missing_mesh_package_is_named_with_its_extra(module, package, tmp_path):
    write(tmp_path, humanoid())
    arguments = ("import-robot", "small.urdf", "--out", "out")
    finished = run_without({module: package}, *arguments, folder=tmp_path)
    assert only_line(finished) == (
        f"crar-drake: error: importing robots needs {package}: "
        f"{install_command('robots')}"
    )
    assert not (tmp_path / "out").exists()


def test_without_mujoco_an_mjcf_names_its_extra(tmp_path):
    for module in MESH_PACKAGES:
        pytest.importorskip(module)
    write(tmp_path, humanoid_in_mjcf(), "small.xml")
    arguments = ("import-robot", "small.xml", "--out", "out")
    finished = run_without({"mujoco": "mujoco"}, *arguments, folder=tmp_path)
    assert only_line(finished) == (
        "crar-drake: error: importing an MJCF needs mujoco: "
        f"{install_command('robots')}"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("robot", ["g1", "romeo"])
def test_without_the_robots_package_its_extra_is_named(robot, tmp_path):
    for module in MESH_PACKAGES:
        pytest.importorskip(module)
    arguments = ("import-robot", robot, "--out", "out")
    package = {"example_robot_data": "example-robot-data"}
    finished = run_without(package, *arguments, folder=tmp_path)
    line = only_line(finished)
    assert "example-robot-data" in line and install_command("robots") in line
    assert not (tmp_path / "out").exists()


def test_commands_that_import_nothing_need_no_extra(tmp_path):
    """`list` and the shipped robots work without any of them."""
    finished = run_without(MESH_PACKAGES, "list", folder=tmp_path)
    assert finished.returncode == 0 and "upper_body" in finished.stdout
