"""Without an optional package the import says which extra to install, no more."""

import json
import subprocess
import sys

import pytest
from small_mjcfs import humanoid as humanoid_in_mjcf
from small_urdfs import humanoid, write

from crar_drake.resources import install_command

# Reads what is missing, and the command line, and does it in a child in which these
# modules and their distributions are not installed: no finder finds them, as if they
# were not there.
WITHOUT = """
import importlib.metadata, json, os, sys
from importlib.machinery import PathFinder

import crar_drake.robot_import
from crar_drake.commands import main

def do_without(modules, distributions):
    assert not set(modules) & set(sys.modules), "they are imported already"

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

for line in sys.stdin:
    packages, folder, arguments = json.loads(line)
    child = os.fork()
    if not child:
        os.chdir(folder)
        for stream, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), stream)
        do_without(list(packages), list(packages.values()))
        sys.exit(main(arguments))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

MESH_PACKAGES = {
    "trimesh": "trimesh",
    "collada": "pycollada",
    "networkx": "networkx",
    "fast_simplification": "fast-simplification",
}


@pytest.fixture(scope="module")
def process():
    """One that has the command line, which takes as long as a command, and forks."""
    with subprocess.Popen(
        [sys.executable, "-c", WITHOUT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as started:
        yield started


@pytest.fixture
def run_without(process, tmp_path):
    """Runs the command line where those modules of those packages are missing."""

    def run(packages: dict[str, str], *arguments: str):
        print(json.dumps([packages, str(tmp_path), arguments]), file=process.stdin)
        process.stdin.flush()
        code = int(process.stdout.readline())
        said = [(tmp_path / name).read_text() for name in ("stdout", "stderr")]
        return subprocess.CompletedProcess(arguments, code, *said)

    return run


def only_line(finished) -> str:
    """What a refused command says: one line on stderr, and exit code 2."""
    assert finished.returncode == 2, finished.stderr
    assert not finished.stdout
    (line,) = finished.stderr.splitlines()
    return line


@pytest.mark.parametrize("module, package", MESH_PACKAGES.items())
def test_a_missing_mesh_package_is_named_with_its_extra(
    module, package, run_without, tmp_path
):
    write(tmp_path, humanoid())
    arguments = ("import-robot", "small.urdf", "--out", "out")
    finished = run_without({module: package}, *arguments)
    assert only_line(finished) == (
        f"crar-drake: error: importing robots needs {package}: "
        f"{install_command('robots')}"
    )
    assert not (tmp_path / "out").exists()


def test_without_mujoco_an_mjcf_names_its_extra(run_without, tmp_path):
    for module in MESH_PACKAGES:
        pytest.importorskip(module)
    write(tmp_path, humanoid_in_mjcf(), "small.xml")
    arguments = ("import-robot", "small.xml", "--out", "out")
    finished = run_without({"mujoco": "mujoco"}, *arguments)
    assert only_line(finished) == (
        "crar-drake: error: importing an MJCF needs mujoco: "
        f"{install_command('robots')}"
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("robot", ["g1", "romeo"])
def test_without_the_robots_package_its_extra_is_named(robot, run_without, tmp_path):
    for module in MESH_PACKAGES:
        pytest.importorskip(module)
    arguments = ("import-robot", robot, "--out", "out")
    package = {"example_robot_data": "example-robot-data"}
    finished = run_without(package, *arguments)
    line = only_line(finished)
    assert "example-robot-data" in line and install_command("robots") in line
    assert not (tmp_path / "out").exists()


def test_commands_that_import_nothing_need_no_extra(run_without):
    """`show` and the shipped robots work without any of them."""
    finished = run_without(MESH_PACKAGES, "show")
    assert finished.returncode == 0 and "upper_body" in finished.stdout
