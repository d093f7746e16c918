"""`make run`: what it says of a Python that will not do, and what it installs."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="needs make")


def make(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        ["make", "--no-print-directory", "-C", ROOT, *arguments],
        capture_output=True,
        text=True,
        timeout=600,
    )


def test_a_run_does_not_install_what_the_tests_need(tmp_path):
    options = (f"PYTHON={sys.executable}", f"VENV={tmp_path / 'environment'}")
    run = make("--dry-run", "run", *options).stdout
    assert " -e .\n" in run and "[dev]" not in run
    test = make("--dry-run", "test", *options, "TESTS=-k one").stdout
    assert "[dev]" in test and " -m pytest " in test
    assert test.rstrip().endswith(" -k one")
    docs = make("--dry-run", "docs", *options).stdout
    assert "[docs]" in docs and "[dev]" not in docs and " -m sphinx " in docs
