"""What one process compiles, the next one finds."""

import json
import os
import subprocess
import sys

import pytest

from crar_drake.equations.compilation import IS_COMPILED

_CALL = """
import json
import numpy as np
from crar_drake.equations.vectors import cross_rows

turned = cross_rows(np.array([[0.0, 0.0, 1.0]]), np.array([[2.0, 0.0, 0.0]]))
hits = sum(cross_rows.stats.cache_hits.values())
misses = sum(cross_rows.stats.cache_misses.values())
print(json.dumps({"turned": turned.tolist(), "hits": hits, "misses": misses}))
"""


@pytest.mark.skipif(not IS_COMPILED, reason="needs Numba, not disabled")
def test_a_later_process_compiles_nothing(tmp_path):
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
    assert first["turned"] == later["turned"] == [[0.0, 2.0, 0.0]]
