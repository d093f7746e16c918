"""What one process compiles, the others find."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import crar_drake
from crar_drake.equations.compilation import IS_COMPILED

# A function that calls others.
_CALL = """
import json
import numba
import numpy as np
import crar_drake
from crar_drake.equations.free_joints import quaternion_product
from crar_drake.equations.vectors import cross, dot

turned = quaternion_product(np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1, 0]))
told = {
    "package": crar_drake.__file__,
    "turned": turned.tolist(),
    "hits": sum(quaternion_product.stats.cache_hits.values()),
    "misses": sum(quaternion_product.stats.cache_misses.values()),
    "parts": [len(each.part.overloads) for each in (cross, dot)],
    "called": [len(each.overloads) for each in (cross, dot)],
    "crossed": cross(turned[1:], np.array([1.0, 0.0, 0.0])).tolist(),
}

@numba.njit
def twice(a):
    return quaternion_product(a, a)

print(json.dumps(told | {"twice": twice(turned).tolist()}))
"""


@pytest.mark.skipif(not IS_COMPILED, reason="needs Numba, not disabled")
def test_one_process_compiles_for_all(tmp_path):
    """Those that want the same at once wait for it, from whatever copy of the package.

    Neither what they call is compiled again, nor what that calls: these are parts.
    """
    copy = tmp_path / "copy"
    package = Path(crar_drake.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(package, copy / "crar_drake", ignore=ignored)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    at_once = [
        subprocess.Popen(
            [sys.executable, "-c", _CALL],
            env=environment | {"PYTHONPATH": str(folder)},
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for folder in (package.parent, copy)
    ]
    told = []
    for process in at_once:
        out, err = process.communicate()
        assert process.returncode == 0, err
        told.append(json.loads(out))
    assert {Path(each["package"]).parent for each in told} == {
        package,
        copy / package.name,
    }
    first, later = sorted(told, key=lambda each: each["hits"])
    assert (first["hits"], first["misses"]) == (0, 1)
    assert (later["hits"], later["misses"]) == (1, 0)
    # Nothing is made machine code of that Python has not called.
    assert (first["parts"], first["called"]) == ([1, 1], [0, 0])
    assert (later["parts"], later["called"]) == ([0, 0], [0, 0])
    assert first["turned"] == later["turned"] == [0.0, 0.0, 0.0, 1.0]
    assert first["crossed"] == later["crossed"] == [0.0, 1.0, 0.0]
    # A user's compiled function may call ours, too.
    assert first["twice"] == later["twice"] == [-1.0, 0.0, 0.0, 0.0]
