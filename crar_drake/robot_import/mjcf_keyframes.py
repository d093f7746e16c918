"""The posture that an MJCF names as its own: one of its keyframes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

_NAMES = ("home", "rest", "neutral", "stand")  # best first


def keyframe_posture(model, joint_names: Mapping[int, str]) -> dict[str, float]:
    """Joint to position [rad or m] in the keyframe that shows the robot at rest.

    It is the one of the first name in `_NAMES` that there is, else the file's first.
    Empty where there is no keyframe, or all of it is zero.

    Args:
        model: compiled by MuJoCo.
        joint_names: index in the model to name, of the robot's joints; ball and free
            joints are left out.
    """
    import mujoco

    if not model.nkey:
        return {}
    keys = [model.key(i).name.lower() for i in range(model.nkey)]
    index = next((keys.index(name) for name in _NAMES if name in keys), 0)
    q = np.array(model.key_qpos[index])
    one = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
    posture = {
        name: round(float(q[model.jnt_qposadr[joint]]), 6)
        for joint, name in joint_names.items()
        if int(model.jnt_type[joint]) in one
    }
    return posture if any(posture.values()) else {}
