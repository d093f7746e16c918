"""All modules are there without the packages of the extras."""

import subprocess
import sys

EXTRAS = (
    *("fcl", "coal", "trimesh", "collada", "networkx", "fast_simplification", "mujoco"),
    *("example_robot_data", "ezc3d", "torch", "joblib"),
)
# Of a process that reads C3D files.
NOT_WITHOUT = "crar_drake.motion.formats.ezc3d_child"
IMPORT_ALL = f"""
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys({EXTRAS!r}))  # none can be imported
import crar_drake
for module in pkgutil.walk_packages(crar_drake.__path__, "crar_drake."):
    if not module.name.endswith("__main__") and module.name != {NOT_WITHOUT!r}:
        importlib.import_module(module.name)
"""


def test_every_module_can_be_imported_without_extras() -> None:
    found = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr
