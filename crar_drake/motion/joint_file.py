"""The YAML file by which a user says which joint of a motion file is which."""

from collections.abc import Sequence
from dataclasses import asdict, make_dataclass

from crar_drake.errors import MotionError, nearest
from crar_drake.motion.performer import JOINTS
from crar_drake.yaml_files import load_yaml, read_text

# Each joint, and the thumbs, to the file's name for it; "" keeps the match.
JointFile = make_dataclass(
    "JointFile",
    [(joint, str, "") for joint in (*JOINTS, "left_thumb", "right_thumb")],
)


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
    for joint, name in asdict(parsed).items():
        if not name:
            continue
        if name not in names:
            known = [known for known in names if known]
            raise MotionError(
                f"{path}: {joint}: the motion has no {name!r}"
                f"{nearest(name, known)}; it has {', '.join(known)}"
            )
        chosen[joint] = list(names).index(name)
    return chosen
