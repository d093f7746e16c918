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


@pytest.fixture
def python_without(tmp_path: Path):
    """Makes an interpreter: this one, after a line of Python."""

    def write(change: str) -> Path:
        script = tmp_path / "python"
        code = f"import sys; {change}; exec(sys.argv[1])"
        script.write_text(
            f"#!/bin/sh\n[ \"$1\" = -c ] || exit 99\nexec {sys.executable} -c '{code}' "
            '"$2"\n'
        )
        script.chmod(0o755)
        return script

    return write


def refused(tmp_path: Path, python: Path | str) -> str:
    """What is said, in a sentence and before anything is made."""
    environment = tmp_path / "environment"
    done = make("run", f"PYTHON={python}", f"VENV={environment}")
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert not environment.exists()
    sentence, end = done.stderr.strip().splitlines()  # and make's own line
    assert "Error" in end
    return sentence


def test_an_older_python_is_refused(tmp_path, python_without):
    python = python_without("sys.version_info = (3, 10, 13)")
    sentence = refused(tmp_path, python)
    assert f"needs Python 3.11, 3.12 or 3.13, and {python} is 3.10" in sentence
    assert "make run PYTHON=" in sentence


def test_a_python_without_venv_is_refused(tmp_path, python_without):
    sentence = refused(tmp_path, python_without('sys.modules["ensurepip"] = None'))
    assert "python3-venv" in sentence


@pytest.mark.parametrize("broken", [False, True])
def test_a_python_that_does_not_run(tmp_path, broken):
    """None at all, or a version manager's stand-in of one that is not chosen."""
    python = tmp_path / "python3.12"
    if broken:
        python.write_text("#!/bin/sh\necho not found >&2\nexit 127\n")
        python.chmod(0o755)
    assert f"{python} does not run here" in refused(tmp_path, python)


def test_a_run_does_not_install_what_the_tests_need(tmp_path):
    options = (f"PYTHON={sys.executable}", f"VENV={tmp_path / 'environment'}")
    run = make("--dry-run", "run", *options).stdout
    assert "[compiled]" in run and "[dev]" not in run
    test = make("--dry-run", "test", *options, "TESTS=-k one").stdout
    assert "[dev]" in test and " -m pytest " in test
    assert test.rstrip().endswith(" -k one")
    docs = make("--dry-run", "docs", *options).stdout
    assert "[docs]" in docs and "[dev]" not in docs and " -m sphinx " in docs


def test_an_environment_of_another_python_is_made_anew(tmp_path):
    """Also an incomplete one; one of this Python is kept."""
    environment = tmp_path / "environment"
    environment.mkdir()
    options = (f"PYTHON={sys.executable}", f"VENV={environment}")
    assert "--clear" not in make("--dry-run", "run", *options).stdout
    (environment / "pyvenv.cfg").touch()
    (environment / ".runs-3.99").touch()
    assert "venv --clear" in make("--dry-run", "run", *options).stdout
    version = "{}.{}".format(*sys.version_info)
    (environment / f".runs-{version}").touch()
    assert "-m venv" not in make("--dry-run", "run", *options).stdout
