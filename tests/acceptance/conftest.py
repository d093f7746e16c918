"""What more than one file of the suite needs: a real robot, people's motions."""

import fcntl
import importlib.metadata
import os
from pathlib import Path
from typing import Any

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


@pytest.fixture(scope="session")
def judge() -> Any:
    """The humanoid's, by its own meshes."""
    import mesh_judge
    import whole_motions

    return mesh_judge.Robot(mesh_judge.example(whole_motions.G1))


@pytest.fixture(scope="session")
def kept() -> dict[str, Any]:
    """What is cleaned or retargeted once for all tests."""
    return {}


@pytest.fixture
def made(
    name: str,
    kept: dict[str, Any],
    humanoid: str,
    tmp_path_factory: pytest.TempPathFactory,
    request: pytest.FixtureRequest,
) -> Any:
    """The motion of `whole_motions` that is called so: cleaned, or a person's."""
    import whole_motions

    if name not in kept:
        folder = tmp_path_factory.mktemp("made")
        if name in whole_motions.STRETCHES:
            kept[name] = whole_motions.clean(name, folder)
        else:
            mocap = request.getfixturevalue("mocap")
            kept[name] = whole_motions.retarget(name, mocap, folder)
    return kept[name]
