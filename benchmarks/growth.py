"""How do cleaning, retargeting and the filter grow with frames, joints and pairs?

    python -m benchmarks.growth g1_whole_body dance.csv 02_01.amc
        [--page docs/measurements/speed.md]

With frames: a motion (a CSV is cleaned, an AMC with its ASF beside retargeted) goes
there and back, and that again and again, so that each part asks for the same; from its
file to the certified one. With joints and pairs: arms of seven joints that swing
alike, each through its own sphere; the more arms, or the more often a sphere is there,
the more of the same. They are cleaned as arrays, without files and meshes, and
filtered frame by frame.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.page import Benchmark, Table, run
from benchmarks.step_robots import LINKS_PER_ARM, ON_A_LINK, link_urdf, sphere_urdf
from benchmarks.step_timing import fit_growth
from crar_drake.law.safety_filter import SafetyFilter
from crar_drake.motion.catalogue import motion_files
from crar_drake.motion.options import MotionOptions
from crar_drake.references.clean_file import CleanOptions
from crar_drake.references.cleaning import Cleaner
from crar_drake.references.retarget_file import RetargetOptions
from crar_drake.robot.description import RobotDescription, whole_body_name

TIMES = (1, 2, 4, 8)  # there and back
ARMS = (1, 2, 4, 8)
SPHERES = (1, 2, 4, 8, 16)  # of each of two arms
FRAMES, RATE = 960, 30.0  # of the arms' motion [Hz]
SWING = 0.5  # [rad], every two seconds
WATCHED = 5  # links of an arm, the last ones
SPHERE, RADIUS = (0.02, 0.02, 0.27), 0.03  # from where an arm begins [m]
ROUNDS = 3
HEADER = (
    "what",
    "growing",
    "sizes",
    "frames",
    "frames changed",
    "processor time a frame [ms]",
    "exponent, of the last two",
)


def there_and_back(lines: Sequence[str], times: int) -> list[str]:
    """The lines of a file whose motion goes there and back so many times.

    Args:
        lines: of a CSV with a line a frame, or of an AMC, whose frames begin with a
            line that has their number alone.
        times: how often.
    """
    starts = [i for i, line in enumerate(lines) if line.strip().isdigit()]
    if not starts:
        return (list(lines) + list(lines)[::-1]) * times
    ends = [*starts[1:], len(lines)]
    frames = [lines[a + 1 : b] for a, b in zip(starts, ends, strict=True)]
    made = list(lines[: starts[0]])
    for number, frame in enumerate((frames + frames[::-1]) * times, start=1):
        made += [str(number), *frame]
    return made


def with_frames(robot: str, motion: Path) -> list[str]:
    """The row of a motion that becomes longer.

    Args:
        robot: a whole body, name or folder.
        motion: a CSV, that is cleaned, or an AMC, that is retargeted.
    """
    cleans = motion.suffix == ".csv"
    besides = () if cleans else motion_files(motion, MotionOptions())[1:]
    work = (CleanOptions(robot) if cleans else RetargetOptions(robot)).begin()
    lines = motion.read_text(encoding="utf-8").splitlines()
    clips, seconds = [], []
    with tempfile.TemporaryDirectory() as name:
        # The first time once more, with nothing left to compile.
        for times in track((TIMES[0], *TIMES), motion.stem):
            folder = Path(name) / f"{len(seconds)}"
            folder.mkdir()
            for path in besides:
                shutil.copy(path, folder)
            longer = folder / motion.name
            longer.write_text("\n".join(there_and_back(lines, times)) + "\n")
            made, took = _timed(work, longer, folder / "out.csv")
            clips.append(made[0])
            seconds.append(took)
    what = "clean" if cleans else "retarget"
    frames = [clip.frames for clip in clips[1:]]
    # A clip that is made of a person's motion has no reference.
    changed = [clip.changed if cleans else "–" for clip in clips[1:]]
    name = f"{what}, {motion.stem}"
    return _row(name, "frames", frames, frames, changed, seconds[1:])


def with_arms(what: str, growing: str, robots: Sequence[tuple[int, int]]) -> list[str]:
    """The row of arms that grow.

    Args:
        what: of ON_ARMS.
        growing: "joints" or "pairs".
        robots: of each the arms, and how often the sphere of an arm is there.
    """
    sizes, changed, seconds = [], [], []
    with tempfile.TemporaryDirectory() as name:
        for arms, spheres in track(robots, f"{what}, {growing}"):
            description = arms_description(Path(name), arms, spheres)
            reference, work = swinging(LINKS_PER_ARM * arms), ON_ARMS[what](description)
            rounds = [_timed(work, reference) for _ in range(ROUNDS)]
            # The first one of all compiles; the median does not mind.
            seconds.append(float(np.median([took for _, took in rounds])))
            changed.append(int((rounds[0][0] != reference).any(axis=1).sum()))
            joints, pairs = reference.shape[1], len(description.pairs)
            sizes.append(pairs if growing == "pairs" else joints)
    frames = [FRAMES] * len(sizes)
    return _row(f"{what}, arms", growing, sizes, frames, changed, seconds)


def _cleaning(robot: RobotDescription) -> Callable[[np.ndarray], np.ndarray]:
    cleaner = Cleaner(robot, RATE)
    return lambda reference: cleaner.clean(reference).q


def _filtering(robot: RobotDescription) -> Callable[[np.ndarray], np.ndarray]:
    filter = SafetyFilter(robot, 1.0 / RATE)

    def filtered(reference: np.ndarray) -> np.ndarray:
        filter.reset(reference[0])
        return np.array([filter(q=q).q for q in reference])

    return filtered


ON_ARMS = {"clean": _cleaning, "filter": _filtering}


def arms_description(folder: Path, arms: int, spheres: int) -> RobotDescription:
    """Arms a metre apart, whose last links are watched with their spheres.

    Args:
        folder: to write the model into.
        arms: how many.
        spheres: how often each one's sphere is there, in the same place.
    """
    text, pairs = ['<robot name="arms"><link name="base"/>'], []
    for arm in range(arms):
        first = LINKS_PER_ARM * arm
        links = range(first, first + LINKS_PER_ARM)
        text.append(link_urdf(first, "base", f"0 {arm} 0"))
        text += [link_urdf(i, f"link{i - 1}", ON_A_LINK) for i in links[1:]]
        for number in range(spheres):
            x, y, z = SPHERE
            name = f"sphere{arm}_{number}"
            text.append(sphere_urdf(name, (x, arm + y, z), RADIUS))
            pairs += [[f"link{i}", name] for i in links[-WATCHED:]]
    (folder / "arms.urdf").write_text("".join(text) + "</robot>")
    return RobotDescription(
        name=f"{arms} arms",
        model="arms.urdf",
        base="base",
        pairs=pairs,
        folder=str(folder),
    )


def swinging(joints: int) -> np.ndarray:
    """(FRAMES, joints) of arms that swing alike [rad]."""
    swing = SWING * np.sin(np.pi * np.arange(FRAMES) / RATE)
    return np.tile(swing[:, None], joints)


def _timed(work: Callable, *arguments: object) -> tuple:
    """What comes of it, and the processor time that it takes [s]."""
    began = time.process_time()
    made = work(*arguments)
    return made, time.process_time() - began


def _row(
    what: str,
    growing: str,
    sizes: Sequence[int],
    frames: Sequence[int],
    changed: Sequence[int | str],
    seconds: Sequence[float],
) -> list[str]:
    each = [1e3 * s / t for s, t in zip(seconds, frames, strict=True)]
    growth = fit_growth(sizes, seconds)
    return [
        what,
        growing,
        *(", ".join(map(str, column)) for column in (sizes, frames, changed)),
        ", ".join(f"{ms:.2f}" for ms in each),
        f"{growth['exponent']:.2f}, {growth['last_exponent']:.2f}",
    ]


def main(argv: Sequence[str] | None = None) -> None:
    """Measures, and prints the table."""
    benchmark = Benchmark("benchmarks.growth", __doc__, "speed")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument("motions", nargs="+", type=Path)
    arguments = benchmark.parse(argv, lambda given: "growth")
    robot = whole_body_name(arguments.robot)
    rows = [with_frames(robot, motion) for motion in arguments.motions]
    for what in ON_ARMS:
        rows.append(with_arms(what, "joints", [(arms, 1) for arms in ARMS]))
        rows.append(with_arms(what, "pairs", [(2, spheres) for spheres in SPHERES]))
    benchmark.report([Table(HEADER, rows)])


if __name__ == "__main__":
    run(main)
