"""The wheel works by itself: built, installed elsewhere, run from an empty folder."""

import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", out, ROOT],
        check=True,
        capture_output=True,
    )
    return next(out.glob("*.whl"))


@pytest.mark.slow
def test_wheel_in_a_clean_environment(wheel: Path, tmp_path: Path) -> None:
    """What it needs is lent by this environment: `make run` has it all installed."""
    environment = tmp_path / "environment"
    venv.create(environment)
    subprocess.run(
        [
            *(sys.executable, "-m", "pip", "--python", environment, "install"),
            *("--quiet", "--no-deps", "--no-compile", wheel),
        ],
        check=True,
        capture_output=True,
    )
    (site,) = environment.glob("lib/python3*/site-packages")
    (site / "lent.pth").write_text(sysconfig.get_path("purelib"))
    python = environment / "bin" / "python"
    empty = tmp_path / "empty"
    empty.mkdir()

    # A checkout on the path would hide what the wheel lacks.
    clean = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}

    def run(*command: str | Path) -> str:
        finished = subprocess.run(
            command, cwd=empty, env=clean, capture_output=True, text=True, timeout=900
        )
        assert finished.returncode == 0, finished.stderr
        return finished.stdout

    listed = run(environment / "bin" / "crar-drake", "show")
    for name in ("upper_body", "obstacle_arm", "dance", "dance_wrists"):
        assert name in listed
    example = ROOT / "examples" / "runs.py"
    assert "smallest distance" in run(python, example, "0.2")
    where = run(python, "-c", "import crar_drake; print(crar_drake.__file__)")
    assert Path(where.strip()).is_relative_to(environment)
