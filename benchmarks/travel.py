"""How well travel is rebuilt from feet that stand, of recordings that have it.

    python -m benchmarks.travel $CRAR_MOCAP_PATH

takes the travel from all AMC recordings of a folder with toes, rebuilds it, without and
with white noise of 10 mm on every point, and prints how far the pelvis is off at most,
as a share of its way.
"""

import sys
from pathlib import Path

import numpy as np

from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.travel import travelling

NOISE = (0.0, 0.01)  # [m]


def main(folder: Path) -> None:
    """Prints the table."""
    print("| recording | way | off at most | with 10 mm of noise |\n|---|---|---|---|")
    for path in sorted(folder.glob("subjects/*/*.amc")):
        performer = load_performer(str(path))
        p = performer.positions
        if "left_toe" not in p:
            continue
        pelvis = p["pelvis"]
        way = np.linalg.norm(np.diff(pelvis[:, :2], axis=0), axis=1).sum()
        shares = []
        for noise in NOISE:
            rng = np.random.default_rng(0)
            still = {
                joint: points - pelvis + noise * rng.standard_normal(points.shape)
                for joint, points in p.items()
            }
            found = travelling(still, performer.frame_rate)["pelvis"]
            off = found - found[0] - pelvis + pelvis[0]
            shares.append(np.linalg.norm(off[:, :2], axis=1).max() / way)
        cells = " | ".join(f"{100.0 * share:.0f} %" for share in shares)
        print(f"| {path.stem} | {way:.1f} m | {cells} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
