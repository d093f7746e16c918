"""A file of reference motions judged, each motion by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from crar_drake.references.certificate_files import faults_beside
from crar_drake.references.faults import LIMBS_OFF, Fault, Tolerances
from crar_drake.references.motion_files import read_motions
from crar_drake.references.reference_judge import ReferenceJudge, ReferenceVerdict
from crar_drake.robot.description import load_robot_description


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


class FileJudge:
    """Judges files of motions of one robot, one after the other."""

    def __init__(self, options: JudgeOptions) -> None:
        """
        Raises:
            CrarError: the robot cannot be used.
        """
        description = load_robot_description(options.robot).without_ground()
        self._options = options
        self._judge = ReferenceJudge(description, options.meshes)

    def __call__(self, file: Path) -> list[ReferenceVerdict]:
        """The verdict on each motion in a file, with what its certificate says.

        Raises:
            CrarError: the file cannot be used.
        """
        options, judge = self._options, self._judge
        motions = read_motions(file, options.layout, options.rate, robot=judge.robot)
        beside, verdicts = faults_beside(file), []
        for motion in motions:
            faults, left = beside.get(motion.clip, ((), ()))
            told = [Fault(*fault) for fault in faults if fault[0] == LIMBS_OFF]
            of = options.every, options.tolerances, left, told
            verdicts.append(judge.judge(motion, *of))
        return verdicts
