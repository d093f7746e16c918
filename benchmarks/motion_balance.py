"""What `--balance` changes in reference motions, and what the ground could give then.

python -m benchmarks.motion_balance g1_whole_body dance.csv cmu:05_02 ...
    [--page docs/measurements/motion-balance.md]
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.cleaning import degrees, lengths
from benchmarks.page import Benchmark, Table, run
from crar_drake.references.clean_file import CleanedClip, clean_file
from crar_drake.references.ground_support import Ground, given_share
from crar_drake.references.motion_files import read_motion
from crar_drake.references.resampling import resampled
from crar_drake.references.retarget_file import retarget_file
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description, whole_body_name

_FINER = 4
HEADER = [
    "motion",
    "frames",
    "that stand",
    "of these the ground could give",
    "on a spline, four times as often",
    "outside, in 95 %",
    "lifts of a foot, not balanced on the other",
    "joints, rms / worst",
    "root, rms / worst",
    "feet, rms / worst",
    "hands, rms / worst",
    "jerk, after / before",
    "violated",
    "× real time",
]


def row(motion: str, clip: CleanedClip, between: Sequence[float]) -> list[str]:
    """The figures of a motion.

    Args:
        motion: its name.
        clip: what became of it.
        between: shares of `share_between`, before and after.
    """
    return [
        motion,
        f"{clip.frames} at {clip.rate:g} Hz",
        str(clip.stands),
        f"{100 * clip.given_before:.0f} → {100 * clip.given:.0f} %",
        f"{100 * between[0]:.0f} → {100 * between[1]:.0f} %",
        f"{_outside(clip.outside_before)} → {_outside(clip.outside)} mm",
        f"{clip.lifts}, {clip.lifts_before} → {clip.lifts_outside}",
        degrees(clip.joints_rms, clip.joints_worst),
        lengths(clip.root_rms, clip.root_worst),
        lengths(clip.feet_rms, clip.feet_worst),
        lengths(clip.hands_rms, clip.hands_worst),
        f"{clip.jerk / clip.jerk_before:.3f}" if clip.jerk_before else "–",
        "yes" if clip.violated else "no",
        f"{clip.times_real_time:.1f}",
    ]


def share_between(path: Path, robot: WholeBody, ground: Ground) -> float:
    """As of `given_share`, where splines through the frames of a file lead."""
    motion = read_motion(path, None, None, robot=robot)
    finer, _ = resampled(motion, _FINER * motion.rate)
    return given_share(ground.outside(finer))


def _outside(length: float) -> str:
    """Inside is 0, and where the ground had to pull, infinite."""
    return f"{1e3 * max(length, 0.0):.0f}".replace("inf", "∞")


def main(argv: Sequence[str] | None = None) -> None:
    """Cleans or retargets, balances what comes of it, and prints the table."""
    benchmark = Benchmark("benchmarks.motion_balance", __doc__, "motion-balance")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument(
        "motions", nargs="+", help="robot motions (.csv, .npz, .pkl), or of people"
    )
    arguments = benchmark.parse(argv, lambda given: "balance")
    robot, rows = whole_body_name(arguments.robot), []
    whole = WholeBody(load_robot_description(robot).without_ground())
    ground = Ground(whole)
    with tempfile.TemporaryDirectory() as folder:
        for number, motion in enumerate(arguments.motions):
            path = Path(motion)
            suffix = path.suffix if path.is_file() else ".csv"
            before = Path(folder) / f"{number}{suffix}"
            if suffix == path.suffix:
                clean_file(motion, before, robot)
            else:
                retarget_file(motion, before, robot)
            after = before.with_name(f"balanced_{before.name}")
            # The second time, with nothing left to compile.
            for name in (f"first_{after.name}", after.name)[bool(rows) :]:
                (clip,) = clean_file(before, after.with_name(name), robot, balance=True)
            between = [share_between(x, whole, ground) for x in (before, after)]
            rows.append(row(path.stem, clip, between))
            print(" | ".join(rows[-1]), flush=True)
    benchmark.report([Table(HEADER, rows)])


if __name__ == "__main__":
    run(main)
