"""What one process compiles, the next one finds."""

import json
import os
import subprocess
import sys

import pytest

from crar_drake.equations.compilation import IS_COMPILED

# A function that calls others.
_CALL = """
import json
import numba
import numpy as np
from crar_drake.equations.free_joints import quaternion_product
from crar_drake.equations.vectors import cross, dot

turned = quaternion_product(np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1, 0]))
told = {
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
def test_a_later_process_compiles_nothing(tmp_path):
    """Neither what it calls, nor what that calls: these are parts of it."""

    def call() -> dict:
        done = subprocess.run(
            [sys.executable, "-c", _CALL],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    first, later = call(), call()
    assert (first["hits"], first["misses"]) == (0, 1)
    assert (later["hits"], later["misses"]) == (1, 0)
    # Nothing is made machine code of that Python has not called.
    assert (first["parts"], first["called"]) == ([1, 1], [0, 0])
    assert (later["parts"], later["called"]) == ([0, 0], [0, 0])
    assert first["turned"] == later["turned"] == [0.0, 0.0, 0.0, 1.0]
    assert first["crossed"] == later["crossed"] == [0.0, 1.0, 0.0]
    # A user's compiled function may call ours, too.
    assert first["twice"] == later["twice"] == [-1.0, 0.0, 0.0, 0.0]
