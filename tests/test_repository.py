"""The repository has what was written for it, and nothing that came from elsewhere."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

TOP_LEVEL = {
    *(".ci", ".gitignore", "CHANGELOG.md", "CITATION.cff", "LICENSE", "Makefile"),
    *("README.md", "pyproject.toml", "benchmarks", "crar_drake", "diagrams", "docs"),
    *("examples", "models", "tests"),
}
MESHES = {".obj", ".stl", ".dae", ".glb", ".gltf", ".ply", ".vtk"}
# What a script of models/ writes, see tests/models/test_models.py.
OWN_MESHES = ["models/shelf_arm/shelf.obj"]


def test_no_mesh_and_nothing_else_at_the_top_is_tracked():
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True
    )
    if listed.returncode:
        pytest.skip("not a clone")
    paths = [Path(line) for line in listed.stdout.splitlines()]
    assert {path.parts[0] for path in paths} <= TOP_LEVEL
    meshes = [str(path) for path in paths if path.suffix.lower() in MESHES]
    assert meshes == OWN_MESHES
