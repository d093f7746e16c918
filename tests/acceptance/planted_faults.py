"""Plants faults in a copy of the checkout, one by one, and shows that tests see them.

    python tests/acceptance/planted_faults.py          # all, some 15 minutes
    python tests/acceptance/planted_faults.py eq20     # those whose names have "eq20"

First the tests that are to see faults run on the copy as it is: they must pass. Then
each fault of `planted_faults.json` is planted and its test must fail. A fault replaces
one text, which must stand in its file just once; whoever moves the text moves the fault
with it. Exit code 0: all were seen; 1: some were not, or a test fails without a fault.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
PASSED, FAILED = 0, 1  # exit codes of pytest


def main(words: list[str]) -> int:
    """Plants the faults whose names have one of the words, or all; the exit code."""
    faults = json.loads((FOLDER / "planted_faults.json").read_text())
    faults = [f for f in faults if not words or any(w in f["name"] for w in words)]
    if not faults:
        print(f"no fault is called {' or '.join(words)}")
        return 1
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        _copy_checkout(copy)
        tests = sorted({fault["test"] for fault in faults})
        code, text = _test(copy, tests)
        if code != PASSED:
            print(f"without a fault these must pass:\n{text}")
            return 1
        print(f"without a fault: {text.splitlines()[-1]}")
        unseen = [fault["name"] for fault in faults if not _is_seen(copy, fault)]
    if unseen:
        print(f"NOT SEEN: {', '.join(unseen)}")
        return 1
    print(f"all {len(faults)} faults are seen")
    return 0


def _copy_checkout(copy: Path) -> None:
    """All files that Git knows, as they stand now."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            target = copy / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes((ROOT / name).read_bytes())


def _is_seen(copy: Path, fault: dict[str, str]) -> bool:
    """Whether the fault's test fails with it; prints a line. The copy is mended."""
    path = copy / fault["file"]
    text = path.read_text()
    if text.count(fault["old"]) != 1:
        print(f"{fault['name']}: {fault['file']} has not just one {fault['old']!r}")
        return False
    path.write_text(text.replace(fault["old"], fault["new"]))
    try:
        code, printed = _test(copy, [fault["test"]])
    finally:
        path.write_text(text)
    seen = code == FAILED
    first = [line for line in printed.splitlines() if line.startswith("E  ")][:1]
    print(f"{'seen' if seen else 'NOT SEEN'}: {fault['name']} ({fault['test']})")
    print("".join(f"    {line[4:].strip()}\n" for line in first), end="", flush=True)
    return seen


def _test(copy: Path, tests: list[str]) -> tuple[int, str]:
    """The exit code of pytest in the copy, and what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-x", *tests],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout + done.stderr


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
