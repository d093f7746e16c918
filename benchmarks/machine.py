"""What measured durations depend on: the processor, the versions."""

import os
import platform
from importlib.metadata import version
from pathlib import Path

import numpy as np


def describe_machine() -> dict:
    """What the figures depend on."""
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "threads": os.environ.get("OMP_NUM_THREADS", "not set"),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "drake": version("drake"),
    }


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
