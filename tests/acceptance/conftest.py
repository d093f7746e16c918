"""What more than one file of the suite needs: a real robot, people's motions."""

import fcntl
import importlib.metadata
import os
from pathlib import Path

import product
import pytest


@pytest.fixture(scope="session")
def mocap() -> Path:
    """The folder of CMU's motions; tests without it are skipped."""
    folder = os.environ.get(product.MOCAP, "")
    if not folder:
        pytest.skip(f"set {product.MOCAP} to the folder of the CMU motion files")
    return Path(folder)


@pytest.fixture(scope="session")
def _cache_with_a_humanoid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's cache with the whole G1, which one worker imports for all."""
    try:
        importlib.metadata.version(product.ROBOT_PACKAGE)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"install {product.ROBOT_PACKAGE}, which has the robot's file")
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    cache, done = folder / "user_cache", folder / "user_cache_is_ready"
    with (folder / "user_cache_lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            imported = product.run_program(
                *product.words("import", product.HUMANOID),
                **{product.CACHE: str(cache)},
            )
            assert imported.code == product.FINE, imported.err
            done.touch()
    return cache


@pytest.fixture
def humanoid(_cache_with_a_humanoid: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the whole G1, which is imported while the test runs."""
    monkeypatch.setenv(product.CACHE, str(_cache_with_a_humanoid))
    return product.HUMANOID
