"""The wheel works by itself: built, installed elsewhere, run from an empty folder."""

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
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
def test_wheel_carries_data(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    for needed in (
        "crar_drake/py.typed",
        "crar_drake/models/upper_body/robot.yaml",
        "crar_drake/models/upper_body/upper_body.urdf",
        "crar_drake/models/obstacle_arm/scene.dmd.yaml",
        "crar_drake/models/g1/import.yaml",
        "crar_drake/diagrams/dance_wrists.yaml",
        "crar_drake/motion/builtin/dance.amc",
        "crar_drake/results/page/page.html",
        "crar_drake/results/page/page.css",
        "crar_drake/results/page/page.js",
        "crar_drake/results/page/marks.js",
        "crar_drake/results/page/timeline.js",
        "crar_drake/results/page/unpack.js",
        "crar_drake/results/page/view.js",
        "crar_drake/play/page/play.html",
        "crar_drake/play/page/play.css",
        "crar_drake/play/page/play.js",
        "crar_drake/play/page/panel.js",
        "crar_drake/play/page/handles.js",
        "crar_drake/play/page/live_run.js",
    ):
        assert needed in names


@pytest.mark.slow
def test_wheel_leaves_the_projects_own_tools_in_the_checkout(wheel: Path) -> None:
    """Benchmarks, tests, and the scripts that wrote models and motions."""
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    metadata = {name for name in names if ".dist-info/" in name}
    assert {name.partition("/")[0] for name in names - metadata} == {"crar_drake"}
    folders = ("models", "diagrams", "motion/builtin")
    data = tuple(f"crar_drake/{folder}/" for folder in folders)
    scripts = {name for name in names if name.startswith(data) and name[-3:] == ".py"}
    assert scripts == {"crar_drake/motion/builtin/__init__.py"}
    # And nothing else of the package.
    modules = {
        str(path.relative_to(ROOT)) for path in (ROOT / "crar_drake").rglob("*.py")
    }
    left = {name for name in modules if name not in names}
    assert left == set()


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

    listed = run(environment / "bin" / "crar-drake", "list")
    for name in ("upper_body", "obstacle_arm", "dance", "dance_wrists"):
        assert name in listed
    example = ROOT / "examples" / "controller_in_your_diagram.py"
    assert "smallest distance" in run(python, example, "0.2")
    where = run(python, "-c", "import crar_drake; print(crar_drake.__file__)")
    assert Path(where.strip()).is_relative_to(environment)
