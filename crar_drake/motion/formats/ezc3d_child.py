"""Reads a C3D file by ezc3d, as a program of its own, and writes what a motion needs.

Changed bytes crash ezc3d, or keep it for ever. `c3d.py` runs this file, which imports
nothing else of the package.

    python -P ezc3d_child.py FILE.c3d OUT.npz MEMORY
"""

import json
import resource
import sys

import ezc3d
import numpy as np


def main(path: str, out: str, memory: str) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    c3d = ezc3d.c3d(path)
    data = c3d["data"]
    # What is longer is no list of labels.
    words = {
        group: {
            name: np.asarray(entry.get("value", [])).tolist()
            for name, entry in c3d["parameters"].get(group, {}).items()
            if isinstance(entry, dict) and len(entry.get("value", [])) < 10_000
        }
        for group in ("POINT", "PROCESSING")
    }
    np.savez(
        out,
        parameters=json.dumps(words),
        points=data["points"][:3],
        residuals=data["meta_points"]["residuals"][0],
    )


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except Exception as error:  # of many kinds: what its C++ throws
        # After its first sentence comes advice to programmers.
        sys.exit(str(error).split(". ")[0].split("\n")[0])
