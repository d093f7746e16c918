"""Many reference motions judged, several at a time; a bad file spoils no other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from crar_drake.batches import in_batches
from crar_drake.errors import CrarError
from crar_drake.fresh_processes import FreshProcesses
from crar_drake.references.certificate_files import faults_beside
from crar_drake.references.faults import LIMBS_OFF, Fault, Tolerances
from crar_drake.references.motion_files import read_motions
from crar_drake.references.reference_judge import (
    ReferenceJudge,
    ReferenceVerdict,
)
from crar_drake.robot.description import load_robot_description


@dataclass(frozen=True)
class JudgedFile:
    """A file and what is said of it."""

    path: str  # of the file
    # one for each motion in it; empty if it cannot be used
    verdicts: tuple[ReferenceVerdict, ...]
    error: str = ""  # why not, or ""


@dataclass(frozen=True)
class JudgeOptions:
    """How motions are read and judged."""

    robot: str  # name or folder
    layout: str | None = None  # of the files; None: each as it looks like
    rate: float | None = None  # frames per second of files; None: as they say [Hz]
    meshes: bool = True  # whether meshes are asked
    # time between the frames in which they are; None: all frames [s]
    every: float | None = None
    tolerances: Tolerances = Tolerances()  # what is no violation


def judge_here(files: Sequence[str], options: JudgeOptions) -> list[JudgedFile]:
    """Judges files one after the other.

    Raises:
        CrarError: the robot cannot be used; what is wrong with a file is in its entry.
    """
    description = load_robot_description(options.robot).without_ground()
    judge = ReferenceJudge(description, options.meshes)
    return [_judge_file(judge, file, options) for file in files]


def judge_files(
    files: Sequence[str],
    options: JudgeOptions,
    jobs: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> list[JudgedFile]:
    """Judges files in several processes.

    Args:
        files: their paths.
        options: for all of them.
        jobs: number of processes; by default one per core.
        progress: is called with the number of files that are judged.

    Returns:
        An entry a file, in their order.

    Raises:
        CrarError: the robot cannot be used.
    """
    # A robot that cannot be used is reported once, before any process starts.
    load_robot_description(options.robot)
    done: dict[str, JudgedFile] = {}
    with FreshProcesses(jobs) as pool:
        for file, judged in in_batches(pool, judge_here, files, options, jobs=jobs):
            # A process died, or ran into a defect.
            if isinstance(judged, Exception):
                judged = JudgedFile(file, (), f"{file}: {judged}")
            done[file] = judged
            if progress is not None:
                progress(len(done))
    return [done[file] for file in files]


def _judge_file(judge: ReferenceJudge, file: str, options: JudgeOptions) -> JudgedFile:
    try:
        motions = read_motions(file, options.layout, options.rate, robot=judge.robot)
        beside, verdicts = faults_beside(file), []
        for motion in motions:
            faults, left = beside.get(motion.clip, ((), ()))
            told = [Fault(*fault) for fault in faults if fault[0] == LIMBS_OFF]
            of = options.every, options.tolerances, left, told
            verdicts.append(judge.judge(motion, *of))
        return JudgedFile(file, tuple(verdicts))
    except (CrarError, OSError) as error:
        return JudgedFile(file, (), str(error))
