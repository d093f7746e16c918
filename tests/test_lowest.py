"""The lowest versions that are tested are those that pyproject.toml allows."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_the_lowest_versions_are_the_ones_stated():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    stated = dict(re.split(">=", line, maxsplit=1) for line in project["dependencies"])
    lines = (ROOT / "tests" / "lowest.txt").read_text().splitlines()
    tested = dict(line.split("==") for line in lines if not line.startswith("#"))

    def numbers(version: str) -> tuple[int, ...]:
        parts = [int(part) for part in version.split(".")]
        return tuple(parts + [0] * (3 - len(parts)))

    assert {name: numbers(v) for name, v in tested.items()} == {
        name: numbers(v) for name, v in stated.items()
    }
