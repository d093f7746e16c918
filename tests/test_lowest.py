"""The lowest versions that are tested are those that pyproject.toml allows."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


# Of the extras that bring them these are not in that environment: they are large.
LEFT_OUT = {"example-robot-data"}


def test_the_lowest_versions_are_the_ones_stated():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *extras["robots"], *extras["c3d"]]
    stated = dict(line.split(",")[0].split(">=") for line in needed)
    lines = (ROOT / "tests" / "lowest.txt").read_text().splitlines()
    tested = dict(line.split("==") for line in lines if not line.startswith("#"))

    def numbers(version: str) -> tuple[int, ...]:
        parts = [int(part) for part in version.split(".")]
        return tuple(parts + [0] * (4 - len(parts)))

    assert {name: numbers(v) for name, v in tested.items()} == {
        name: numbers(v) for name, v in stated.items() if name not in LEFT_OUT
    }
