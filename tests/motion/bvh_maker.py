"""Writes one motion as BVH files of any naming, axes, unit and zero pose."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.formats.asf_amc import Clip, clip_tree

# A joint of the file: (its bone of the ASF, at whose start it is; its parent).
TREE = {
    "hips": ("root", ""),
    "left_thigh": ("lfemur", "hips"),
    "left_shank": ("ltibia", "left_thigh"),
    "left_foot": ("lfoot", "left_shank"),
    "right_thigh": ("rfemur", "hips"),
    "right_shank": ("rtibia", "right_thigh"),
    "right_foot": ("rfoot", "right_shank"),
    "lumbar": ("lowerback", "hips"),
    "spine": ("upperback", "lumbar"),
    "chest": ("thorax", "spine"),
    "neck": ("lowerneck", "chest"),
    "upper_neck": ("upperneck", "neck"),
    "head": ("head", "upper_neck"),
    "left_collar": ("lclavicle", "chest"),
    "left_arm": ("lhumerus", "left_collar"),
    "left_forearm": ("lradius", "left_arm"),
    "left_hand": ("lwrist", "left_forearm"),
    "right_collar": ("rclavicle", "chest"),
    "right_arm": ("rhumerus", "right_collar"),
    "right_forearm": ("rradius", "right_arm"),
    "right_hand": ("rwrist", "right_forearm"),
}

# What makers call these joints, but for spine and neck.
_MAKERS = {
    "lafan1": (
        "Hips LeftUpLeg LeftLeg LeftFoot RightUpLeg RightLeg RightFoot Head "
        "LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm "
        "RightHand",
        "",
    ),
    "xsens": (
        "Hips LeftHip LeftKnee LeftAnkle RightHip RightKnee RightAnkle Head LeftCollar "
        "LeftShoulder LeftElbow LeftWrist RightCollar RightShoulder RightElbow "
        "RightWrist",
        "",
    ),
    "biped": (
        "Pelvis L_Thigh L_Calf L_Foot R_Thigh R_Calf R_Foot Head L_Clavicle L_UpperArm "
        "L_Forearm L_Hand R_Clavicle R_UpperArm R_Forearm R_Hand",
        "Bip01 ",
    ),
    "optitrack": (
        "Hip LThigh LShin LFoot RThigh RShin RFoot Head LShoulder LUArm LFArm LHand "
        "RShoulder RUArm RFArm RHand",
        "Skeleton 001:",
    ),
    "cmu": (
        "root lfemur ltibia lfoot rfemur rtibia rfoot head lclavicle lhumerus lradius "
        "lwrist rclavicle rhumerus rradius rwrist",
        "",
    ),
    "unreal": (
        "pelvis thigh_l calf_l foot_l thigh_r calf_r foot_r head clavicle_l upperarm_l "
        "lowerarm_l hand_l clavicle_r upperarm_r lowerarm_r hand_r",
        "",
    ),
}
_MAKERS["mixamo"] = (_MAKERS["lafan1"][0], "mixamorig:")
_MAKERS["nokov"] = (_MAKERS["lafan1"][0].upper(), "Actor1_")
_SPINE = {
    "lumbar": "Spine",
    "spine": "Spine1",
    "chest": "Spine2",
    "neck": "Neck",
    "upper_neck": "Neck1",
}


def _named(maker: str) -> dict[str, str]:
    limbs, prefix = _MAKERS[maker]
    words = iter(limbs.split())
    names = {joint: _SPINE.get(joint) or next(words) for joint in TREE}
    blank = " " if prefix.endswith(" ") else "_"
    return {joint: prefix + name.replace("_", blank) for joint, name in names.items()}


NAMES: dict[str, Mapping[str, str]] = {
    **{maker: _named(maker) for maker in _MAKERS},
    "nothing": {joint: f"joint{i}" for i, joint in enumerate(TREE)},
}
NAMES["swapped"] = {
    joint: NAMES["lafan1"][
        joint.replace("left", "*").replace("right", "left").replace("*", "right")
    ]
    for joint in TREE
}

# Rows: the file's x, y, z in the ASF's axes (x left, y up, z forward).
AXES: Mapping[str, np.ndarray] = {
    "y up, z forward": np.eye(3),
    "y up, x forward": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], float),
    "z up, -y forward": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float),
    "z up, -x forward": np.array([[0, 0, -1], [-1, 0, 0], [0, 1, 0]], float),
    "y up, -x forward": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], float),
    "x up, y forward": np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], float),
}


def along_x(joint: str, offset: np.ndarray) -> np.ndarray:
    """A zero pose with all bones along x, but for the way to the next limb."""
    if not offset.any():
        return np.eye(3)
    R, _ = Rotation.align_vectors(offset[None], [[np.linalg.norm(offset), 0.0, 0.0]])
    return R.as_matrix()


def arms_hang(joint: str, offset: np.ndarray) -> np.ndarray:
    """Joint axes turned so that spread arms hang at zero."""
    if any(part in joint for part in ("_arm", "_forearm", "_hand")):
        turn = 90.0 if joint.startswith("left") else -90.0
        return Rotation.from_euler("z", turn, degrees=True).as_matrix()
    return np.eye(3)


@dataclass(frozen=True)
class Convention:
    """How a BVH is written.

    Attributes:
        names: key of NAMES.
        axes: key of AXES.
        unit: metres in one unit.
        order: of the rotation channels, e.g. "ZXY".
        zero: joint and offset to the joint's next, in the ASF's axes at rest, to R_BJ,
            the joint's axes in the bone's.
        all_positions: whether each joint has position channels.
    """

    names: str = "lafan1"
    axes: str = "y up, z forward"
    unit: float = 0.01
    order: str = "ZYX"
    zero: Callable[[str, np.ndarray], np.ndarray] = field(
        default=lambda joint, offset: np.eye(3)
    )
    all_positions: bool = False


def bvh_text(clip: Clip, convention: Convention) -> str:
    """The clip as a BVH."""
    tree = clip_tree(clip)
    p_W = dict(zip(tree.names, tree.positions, strict=True))
    R_W = dict(zip(tree.names, tree.rotations, strict=True))
    A = AXES[convention.axes]
    names = NAMES[convention.names]
    children = {
        joint: [j for j, (_, parent) in TREE.items() if parent == joint]
        for joint in TREE
    }
    # Offsets at rest, in the ASF's axes: of a chain of bones, which may lie between.
    rest = {joint: _rest_start(clip, bone) for joint, (bone, _) in TREE.items()}
    ends = {joint: _end(clip, bone) for joint, (bone, _) in TREE.items()}
    Q = {}
    for joint in TREE:
        next_one = children[joint][0] if children[joint] else None
        offset = rest[next_one] - rest[joint] if next_one else ends[joint]
        Q[joint] = convention.zero(joint, offset)
    lines = ["HIERARCHY"]
    channels = " ".join(f"{axis}rotation" for axis in convention.order)

    def write(joint: str, depth: int) -> None:
        indent = "\t" * depth
        parent = TREE[joint][1]
        kind = "JOINT" if parent else "ROOT"
        offset = np.zeros(3)
        if parent:
            offset = A @ Q[parent].T @ (rest[joint] - rest[parent])
        lines.extend([f"{indent}{kind} {names[joint]}", f"{indent}{{"])
        lines.append(f"{indent}\tOFFSET {_numbers(offset / convention.unit)}")
        if parent and not convention.all_positions:
            lines.append(f"{indent}\tCHANNELS 3 {channels}")
        else:
            lines.append(
                f"{indent}\tCHANNELS 6 Xposition Yposition Zposition {channels}"
            )
        for child in children[joint]:
            write(child, depth + 1)
        if not children[joint]:
            end = A @ Q[joint].T @ ends[joint] / convention.unit
            lines.extend(
                [f"{indent}\tEnd Site", f"{indent}\t{{"]
                + [f"{indent}\t\tOFFSET {_numbers(end)}", f"{indent}\t}}"]
            )
        lines.append(f"{indent}}}")

    write("hips", 0)
    written = [line.split()[1:] for line in lines if "ROOT" in line or "JOINT" in line]
    order = [
        next(j for j, name in names.items() if name.split() == words)
        for words in written
    ]
    columns = []
    for joint in order:
        bone, parent = TREE[joint]
        R_FJ = A @ R_W[bone] @ Q[joint] @ A.T
        p = p_W[bone] @ A.T
        if parent:
            parent_bone = TREE[parent][0]
            R_FP = A @ R_W[parent_bone] @ Q[parent] @ A.T
            p = np.einsum("tji,tj->ti", R_FP, p - p_W[parent_bone] @ A.T)
            R_FJ = np.swapaxes(R_FP, 1, 2) @ R_FJ
        if not parent or convention.all_positions:
            columns.append(p / convention.unit)
        columns.append(
            Rotation.from_matrix(R_FJ).as_euler(convention.order, degrees=True)
        )
    lines += ["MOTION", f"Frames: {clip.num_frames}"]
    lines.append(f"Frame Time: {1.0 / clip.frame_rate:.8f}")
    lines += [_numbers(row) for row in np.hstack(columns)]
    return "\n".join(lines) + "\n"


def _rest_start(clip: Clip, bone: str) -> np.ndarray:
    """(3,) start of a bone at rest, the root at 0."""
    p = np.zeros(3)
    while bone != "root":
        bone = clip.skeleton.bones[bone].parent
        if bone != "root":
            p = (
                p
                + clip.skeleton.bones[bone].direction * clip.skeleton.bones[bone].length
            )
    return p


def _end(clip: Clip, bone: str) -> np.ndarray:
    """(3,) from a bone's start to its end at rest."""
    if bone == "root":
        return np.zeros(3)
    return clip.skeleton.bones[bone].direction * clip.skeleton.bones[bone].length


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.11g}" for value in values)
