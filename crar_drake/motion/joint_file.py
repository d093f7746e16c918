"""The YAML file by which a user says which joint of a motion file is which."""

# YAML loading reads the types of the fields, so no postponed annotations here.
from collections.abc import Sequence
from dataclasses import dataclass, fields

from crar_drake.errors import MotionError
from crar_drake.motion.performer import JOINTS
from crar_drake.nearest import nearest
from crar_drake.yaml_files import load_yaml, read_text


@dataclass
class JointFile:
    """Name of JOINTS (or a thumb) to the file's name for it; "" keeps the match."""

    pelvis: str = ""
    neck: str = ""
    head: str = ""
    left_shoulder: str = ""
    left_elbow: str = ""
    left_wrist: str = ""
    left_thumb: str = ""
    right_shoulder: str = ""
    right_elbow: str = ""
    right_wrist: str = ""
    right_thumb: str = ""
    left_hip: str = ""
    left_knee: str = ""
    left_ankle: str = ""
    left_toe: str = ""
    right_hip: str = ""
    right_knee: str = ""
    right_ankle: str = ""
    right_toe: str = ""


assert set(JOINTS) <= {field.name for field in fields(JointFile)}


def load_joint_file(path: str, names: Sequence[str]) -> dict[str, int]:
    """Joint to the index of the name that the file gives it.

    Args:
        path: YAML file, joint: name in the motion file.
        names: of the motion file.

    Raises:
        MotionError: the file cannot be read, or names a joint that there is not.
    """
    parsed = load_yaml(
        read_text(path, MotionError),
        JointFile,
        path,
        MotionError,
        manual="docs/guides/your-motion.md",
    )
    chosen = {}
    for field in fields(JointFile):
        name = getattr(parsed, field.name)
        if not name:
            continue
        if name not in names:
            known = [known for known in names if known]
            raise MotionError(
                f"{path}: {field.name}: the motion has no {name!r}"
                f"{nearest(name, known)}; it has {', '.join(known)}"
            )
        chosen[field.name] = list(names).index(name)
    return chosen
