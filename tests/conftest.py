"""Fixtures that more than one test module needs."""

# ruff: noqa: E402

import os

# Before NumPy is imported: threads of its own wait busily, and files of tests run side
# by side. The command line does the same.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import gc
import pickle
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import matplotlib
import platformdirs
import pytest
from small_urdfs import humanoid, write

matplotlib.use("Agg")

# Tests give commands caches of their own; what is compiled is kept all the same.
os.environ.setdefault(
    "NUMBA_CACHE_DIR", str(platformdirs.user_cache_path("crar-drake") / "compiled")
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests come first, lest one core be left with them at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@cache
def _has_threads(file: Path) -> bool:
    text = file.read_text(encoding="utf-8")
    names = ("ThreadPoolExecutor", "threading.Thread", "no_new_processes")
    return any(name in text for name in names)


@pytest.fixture(autouse=True)
def what_nobody_holds_ends_here(request):
    """Drake aborts where a Meshcat ends in another thread than that which made it, and
    garbage is collected in any."""
    if _has_threads(request.path):
        gc.collect()


class OneThread(ThreadPoolExecutor):
    """Runs calls one after the other, as if in another process: each is sent."""

    def __init__(self, jobs: int | None = None) -> None:
        super().__init__(1)

    def submit(self, fn, /, *args, **kwargs):
        sent = pickle.loads(pickle.dumps((fn, args, kwargs)))
        return super().submit(lambda: pickle.loads(pickle.dumps(_call(*sent))))


def _call(fn, args, kwargs):
    return fn(*args, **kwargs)


@pytest.fixture
def no_new_processes(monkeypatch):
    """Calls that have new processes, which take seconds to start, have none; see
    test_fresh_processes.py for these."""
    from crar_drake.fresh_processes import FreshProcesses

    for module in list(sys.modules.values()):
        if vars(module).get("FreshProcesses") is FreshProcesses:
            monkeypatch.setattr(module, "FreshProcesses", OneThread)


@pytest.fixture
def refused(capsys):
    """Runs a command line that must be refused; its message, without a traceback.
    Nothing is to be written into `out`, below the working directory."""
    from crar_drake.commands import main

    def run(*argv: str) -> str:
        assert main(argv) == 2
        output = capsys.readouterr()
        assert output.out == ""
        assert output.err.startswith("crar-drake: error: ")
        assert output.err.count("\n") == 1, "one line"
        assert not Path("out").exists(), "nothing is written"
        return output.err

    return run


@pytest.fixture
def usual_signals():
    """A background job may have been started with signals ignored; and who handles
    them in a test puts back what was there."""
    usual = {
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
        signal.SIGHUP: signal.SIG_DFL,
    }
    before = {n: signal.signal(n, handler) for n, handler in usual.items()}
    yield
    assert {n: signal.getsignal(n) for n in usual} == usual
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def cmu() -> Path:
    """The folder of the real CMU files, laid out as the database's own site."""
    folder = os.environ.get("CRAR_MOCAP_PATH", "")
    if not folder:
        pytest.skip("set CRAR_MOCAP_PATH to the folder of the CMU motion files")
    if not (Path(folder) / "subjects").is_dir():
        pytest.fail(f"CRAR_MOCAP_PATH={folder} has no subjects/ folder")
    return Path(folder)


@pytest.fixture(scope="session")
def imported(tmp_path_factory: pytest.TempPathFactory):
    """The small humanoid, imported with few capsules, and the report of it."""
    from crar_drake.robot_import import import_robot

    folder = tmp_path_factory.mktemp("small_humanoid")
    write(folder, humanoid())
    (folder / "import.yaml").write_text("source: small.urdf\nmost_capsules: 2\n")
    return import_robot("", folder)
