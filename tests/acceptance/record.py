"""What the product reaches today, and whether it is no worse tomorrow.

A test measures figures and hands them over:

    record.assert_no_worse("tracking", "boxing, wrists", {"error mm": 13.4})

They are compared with `recorded_tracking.json`. A figure is an error, an acceleration
or the like: smaller is better, and it may be 1.05 times what is recorded. Of counts
that should be large `assert_no_fewer` takes care.

    python tests/acceptance/record.py tracking

runs the tests of a room, whatever their figures are, and writes its file: figures, date
and commit. Record when a figure has become better, so that it stays so, or where a
change is wanted and its price is known. Tests that are skipped, or fail otherwise, are
named, and nothing is written: their figures would be lost.

A new room is a line of ROOMS.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

FOLDER = Path(__file__).parent
# Room to the files that measure it.
ROOMS = {
    "tracking": ("test_tracking.py", "test_constant_targets.py"),
    "motions": ("test_clean.py", "test_retargeted.py"),
}
MOST = 1.05  # times what is recorded
DIGITS = 5
NEW_FIGURES = "ACCEPTANCE_FIGURES"  # environment variable: the file that takes them


def assert_no_worse(
    room: str,
    name: str,
    figures: Mapping[str, float],
    unnoticed: Mapping[str, float] | None = None,
) -> None:
    """Each figure is at most MOST times what is recorded.

    Args:
        name: of what was measured.
        figures: what to how much; the last word of what is its unit.
        unnoticed: unit to a difference that is allowed besides, since nobody would
            call it a change for the worse.
    """
    unnoticed = unnoticed or {}

    def worse(what: str, now: float, before: float) -> bool:
        return now > MOST * before + unnoticed.get(what.split()[-1], 0.0)

    _compare(room, name, figures, worse, f"at most {MOST:g} times is allowed")


def assert_no_fewer(room: str, name: str, counts: Mapping[str, int]) -> None:
    """Each count is at least what is recorded."""
    _compare(
        *(room, name, counts),
        lambda what, now, before: now < before,
        "as many at least are expected",
    )


def _compare(room, name, figures, is_worse, allowed) -> None:
    if path := os.environ.get(NEW_FIGURES):
        with Path(path).open("a") as file:
            file.write(json.dumps([name, dict(figures)], default=float) + "\n")
        return
    recorded = json.loads(_file(room).read_text())
    before = recorded["figures"].get(name, {})
    how = f"python {Path(__file__).relative_to(FOLDER.parents[1])} {room}"
    if before.keys() != figures.keys():
        raise AssertionError(
            f"{name}: {', '.join(figures)} are measured, "
            f"{', '.join(before) or 'nothing'} recorded: {how}"
        )
    told = [
        f"{name}: {what}: {before[what]:.5g} at {recorded['commit']} of "
        f"{recorded['date']}, now {now:.5g}; {allowed}"
        for what, now in figures.items()
        # So that NaN is worse than anything.
        if not now == now or is_worse(what, now, before[what])
    ]
    assert not told, "\n".join(told)


def _file(room: str) -> Path:
    return FOLDER / f"recorded_{room}.json"


# --- the command ----------------------------------------------------------------------


class _Unusable:
    """A plugin of pytest that notes tests that were skipped or failed."""

    def __init__(self) -> None:
        self.tests: list[str] = []

    def pytest_runtest_logreport(self, report) -> None:
        if report.outcome != "passed":
            self.tests.append(report.nodeid)


def main(words: list[str]) -> int:
    """Records the room that is named; the exit code."""
    import pytest

    if len(words) != 1 or words[0] not in ROOMS:
        print(f"name one of the rooms: {', '.join(ROOMS)}")
        return 2
    (room,) = words
    tests = sorted(path for glob in ROOMS[room] for path in FOLDER.glob(glob))
    unusable = _Unusable()
    with tempfile.NamedTemporaryFile("r") as new:
        os.environ[NEW_FIGURES] = new.name
        code = pytest.main([*map(str, tests), "-p", "no:xdist"], plugins=[unusable])
        lines = new.read().splitlines()
    if code or unusable.tests or not lines:
        print(f"nothing is written; without figures: {', '.join(unusable.tests)}")
        return 1
    figures = {
        name: {what: float(f"{value:.{DIGITS}g}") for what, value in each.items()}
        for name, each in sorted(map(json.loads, lines))
    }
    today = {"commit": _commit(), "date": f"{datetime.now(UTC):%Y-%m-%d}"}
    text = json.dumps(today | {"figures": figures}, indent=1)
    _file(room).write_text(text + "\n")
    print(f"{len(figures)} entries in {_file(room)}")
    return 0


def _commit() -> str:
    """The product's commit, with "-dirty" if the product is changed."""

    def git(*words: str) -> str:
        return subprocess.run(
            ["git", *words], cwd=FOLDER, capture_output=True, text=True, check=True
        ).stdout.strip()

    root = FOLDER.parents[1]
    changed = git("status", "--porcelain", "--", root / "crar_drake", root / "models")
    return git("rev-parse", "--short", "HEAD") + ("-dirty" if changed else "")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
