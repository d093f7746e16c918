"""What `crar-drake clean` changes in reference motions, and what they keep then.

python -m benchmarks.cleaning g1_whole_body dance.csv walk.csv ...
    [--page docs/measurements/cleaning.md]
"""

import math
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.page import Benchmark, Table, run
from crar_drake.references.clean_file import CleanedClip, clean_file
from crar_drake.robot.description import whole_body_name


def cells(clip: CleanedClip) -> dict[str, str]:
    """The figures of a motion, by their names."""
    jerk = clip.jerk / clip.jerk_before if clip.jerk_before else 1.0
    return {
        "frames": f"{clip.frames} at {clip.rate:g} Hz",
        "frames in penetration, capsules where meshes do not decide": (
            f"{clip.penetrating_before} → {clip.penetrating}"
        ),
        "smallest distance, capsules": (
            f"{1e3 * clip.nearest_before:.1f} → {1e3 * clip.nearest:.1f} mm"
        ),
        "between frames at least": f"{1e3 * clip.between:.1f} mm",
        "frames in penetration, meshes": str(clip.meshes_penetrating),
        "paths with meshes not shown to be clear": str(clip.meshes_unclear),
        "frames beyond a joint limit": (
            f"{clip.beyond_limit_before} → {clip.beyond_limit}"
        ),
        "frames beyond a speed limit": f"{clip.too_fast_before} → {clip.too_fast}",
        "frames changed (by 1e-6 rad)": str(clip.changed),
        "frames that stand still": str(clip.frozen),
        "joints, rms / worst": degrees(clip.joints_rms, clip.joints_worst),
        "feet, rms / worst": lengths(clip.feet_rms, clip.feet_worst),
        "hands, rms / worst": lengths(clip.hands_rms, clip.hands_worst),
        "jerk of the joints, after / before": f"{jerk:.3f}",
        "times real time, one core": f"{clip.times_real_time:.1f}",
    }


def degrees(rms: float, worst: float) -> str:
    """Of angles [rad], as text."""
    return f"{math.degrees(rms):.2f}° / {math.degrees(worst):.1f}°"


def lengths(rms: float, worst: float) -> str:
    """Of lengths [m], as text."""
    return f"{1e3 * rms:.1f} / {1e3 * worst:.1f} mm"


def main(argv: Sequence[str] | None = None) -> None:
    """Cleans, and prints the table."""
    benchmark = Benchmark("benchmarks.cleaning", __doc__, "cleaning")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument("motions", nargs="+", type=Path)
    arguments = benchmark.parse(argv, lambda given: "clean")
    columns = []
    with tempfile.TemporaryDirectory() as folder:
        for motion in arguments.motions:
            out = Path(folder) / motion.name
            # The second time, with nothing left to compile.
            for name in (f"first_{out.name}", out.name)[bool(columns) :]:
                (clip,) = clean_file(
                    motion, out.with_name(name), whole_body_name(arguments.robot)
                )
            columns.append(cells(clip))
    names = [motion.stem for motion in arguments.motions]
    rows = [[what, *(c[what] for c in columns)] for what in columns[0]]
    benchmark.report([Table(["before → after", *names], rows)])


if __name__ == "__main__":
    run(main)
