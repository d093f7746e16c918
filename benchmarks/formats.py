"""How far joint centres of one trial are apart in two formats.

    python -m benchmarks.formats $CRAR_MOCAP_PATH

prints a table: medians and 95 % quantiles of distances and of the angles between bones.
"""

import sys
from pathlib import Path

import numpy as np

from crar_drake.motion.catalogue import load_performer
from crar_drake.motion.performer import ARM, LEG, SIDES, Performer

TRIALS = ("131/131_01.bvh", "135/135_02.c3d")
POINTS = ("pelvis", "neck", *ARM, *LEG, "toe")
BONES = (ARM[:2], ARM[1:], LEG[:2], LEG[1:])


def main(folder: Path) -> None:
    """Prints the table."""
    pairs = []
    for trial in TRIALS:
        other = load_performer(str(folder / "subjects" / trial))
        amc = load_performer(str((folder / "subjects" / trial).with_suffix(".amc")))
        pairs.append((amc, other))
    names = [Path(trial).name for trial in TRIALS]
    print(f"| median / 95 % | {' | '.join(f'AMC – `{name}`' for name in names)} |")
    print("|---" * (len(names) + 1) + "|")
    for point in POINTS:
        cells = [_pair(_distances(a, b, point), "mm") for a, b in pairs]
        print(f"| {point} | {' | '.join(cells)} |")
    for start, end in BONES:
        cells = [_pair(_angles(a, b, start, end), "°") for a, b in pairs]
        print(f"| direction {start}–{end} | {' | '.join(cells)} |")
    cells = [
        _pair(np.degrees(np.abs(np.unwrap(a.heading - b.heading))), "°")
        for a, b in pairs
    ]
    print(f"| heading | {' | '.join(cells)} |")


def _of_both_sides(point: str) -> list[str]:
    unsided = point in ("pelvis", "neck")
    return [point] if unsided else [f"{side}_{point}" for side in SIDES]


def _distances(a: Performer, b: Performer, point: str) -> np.ndarray:
    """[mm]"""
    return 1e3 * np.concatenate(
        [
            np.linalg.norm(a.positions[name] - b.positions[name], axis=1)
            for name in _of_both_sides(point)
        ]
    )


def _angles(a: Performer, b: Performer, start: str, end: str) -> np.ndarray:
    """[deg]"""
    angles = []
    for side in SIDES:
        x, y = (
            p.positions[f"{side}_{end}"] - p.positions[f"{side}_{start}"]
            for p in (a, b)
        )
        sine = np.linalg.norm(np.cross(x, y), axis=1)
        angles.append(np.degrees(np.arctan2(sine, np.sum(x * y, axis=1))))
    return np.concatenate(angles)


def _pair(values: np.ndarray, unit: str) -> str:
    return f"{np.median(values):.1f} / {np.quantile(values, 0.95):.1f} {unit}"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
