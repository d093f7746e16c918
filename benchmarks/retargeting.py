"""How like the person a robot moves in the motions that `crar-drake retarget` makes.

python -m benchmarks.retargeting g1_whole_body dance cmu:05_02 some.bvh ...
    [--page docs/measurements/retargeting.md]
"""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.page import Benchmark, Table, run
from crar_drake.commands.clean import violations
from crar_drake.errors import MotionError
from crar_drake.references.retarget_file import RetargetedClip, retarget_file
from crar_drake.robot.description import whole_body_name

HEADER = [
    "motion",
    "length",
    "farthest limb, median / 95 %",
    "knees, left / right, median",
    "root's acceleration, rms / peak",
    "of the person's, scaled",
    "slip, planted / until it is high",
    "lowest point",
    "nearest, at frames / between",
    "frames with meshes in penetration",
    "joint and speed limits",
    "verdict",
    "× real time",
]


def row(motion: str, clip: RetargetedClip) -> list[str]:
    """The figures of a motion."""
    beyond = clip.beyond_limit + clip.too_fast
    median, most = map(math.degrees, (clip.limbs_median, clip.limbs_most))
    left, right = map(math.degrees, (clip.left_knee, clip.right_knee))
    return [
        motion,
        f"{(clip.frames - 1) / clip.rate:.1f} s",
        f"{median:.1f}° / {most:.1f}°",
        f"{left:+.1f}° / {right:+.1f}°",
        f"{clip.root:.1f} / {clip.root_peak:.1f} m/s²",
        f"{clip.root / clip.persons_root:.2f} / "
        f"{clip.root_peak / clip.persons_root_peak:.2f}",
        f"{1e3 * clip.slip:.1f} / {1e3 * clip.leaving:.1f} mm",
        f"{1e3 * clip.lowest:.1f} mm",
        f"{1e3 * clip.nearest:.1f} / {1e3 * clip.between:.1f} mm",
        f"{max(clip.meshes_penetrating, 0)} of {clip.frames}",
        "kept" if not beyond else f"{beyond} frames beyond",
        "; ".join(violations([clip])) or "OK",
        f"{clip.times_real_time:.1f}",
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Retargets, and prints the table."""
    benchmark = Benchmark("benchmarks.retargeting", __doc__, "retargeting")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument("motions", nargs="+")
    arguments = benchmark.parse(argv, lambda given: given.robot)
    robot, rows, failed = whole_body_name(arguments.robot), [], []
    with tempfile.TemporaryDirectory() as folder:
        for number, motion in enumerate(arguments.motions):
            out = Path(folder) / f"{number}.csv"
            try:
                clip = retarget_file(motion, out, robot)
            except MotionError as error:
                failed.append(str(error))
                continue
            rows.append(row(motion, clip))
            print(" | ".join(rows[-1]), flush=True)
    said = f"Not retargeted: {'; '.join(failed)}." if failed else ""
    benchmark.report([Table(HEADER, rows)], said)


if __name__ == "__main__":
    run(main)
