"""The performer of an MVNX file of Xsens."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.motion.formats.mvnx import Mvnx
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import (
    SIDES,
    Fact,
    Performer,
    hung_on,
    repeated,
    turning,
)
from crar_drake.motion.performers.assemble import Recording, assemble

_LIMBS = {
    "shoulder": "UpperArm",
    "elbow": "ForeArm",
    "wrist": "Hand",
    "hip": "UpperLeg",
    "knee": "LowerLeg",
    "ankle": "Foot",
    "toe": "Toe",
}
# Joint to the segment whose origin it is.
_SEGMENT_OF: Mapping[str, str] = MappingProxyType(
    {
        "pelvis": "Pelvis",
        "neck": "Neck",
        "head": "Head",
        **{
            f"{side}_{joint}": f"{side.capitalize()}{segment}"
            for side in SIDES
            for joint, segment in _LIMBS.items()
        },
    }
)
_ARM = ("Shoulder", "UpperArm", "ForeArm", "Hand")
_LEG = ("UpperLeg", "LowerLeg", "Foot", "Toe")
# Chains of segments, each of which hangs on the one before.
_CHAINS = (
    ("Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head"),
    *(("T8", *(side + part for part in _ARM)) for side in ("Left", "Right")),
    *(("Pelvis", *(side + part for part in _LEG)) for side in ("Left", "Right")),
)
_PARENT = {b: a for chain in _CHAINS for a, b in zip(chain, chain[1:], strict=False)}


def mvnx_performer(mvnx: Mvnx, name: str, options: MotionOptions) -> Performer:
    """Returns the performer of an MVNX file.

    Raises:
        MotionError: a segment is missing, the file says no rate, or an option is given
            that it does not need.
    """
    options.refuse(("unit", "up", "joints"), f"motion {name} is an MVNX")
    rate, rate_source = options.rate_of(name, mvnx.frame_rate)
    index = {label: i for i, label in enumerate(mvnx.segments)}
    found = {joint: s for joint, s in _SEGMENT_OF.items() if s in index}
    Q = mvnx.quaternions[:, :, [1, 2, 3, 0]]
    R = Rotation.from_quat(Q.reshape(-1, 4)).as_matrix().reshape(*Q.shape[:2], 3, 3)
    # Fingers point outwards at rest, thumbs ahead.
    hands = {
        f"{side}_hand": (
            way * R[:, index[f"{side.capitalize()}Hand"], :, 1],
            R[:, index[f"{side.capitalize()}Hand"], :, 0],
        )
        for side, way in (("left", 1.0), ("right", -1.0))
        if f"{side.capitalize()}Hand" in index
    }
    others = ", ".join(label or "without a name" for label in mvnx.others)
    return assemble(
        Recording(
            name=name,
            format="MVNX",
            frame_rate=rate,
            rate_source=rate_source,
            positions={j: mvnx.positions[:, index[s]] for j, s in found.items()},
            joints={joint: f"{s}'s origin" for joint, s in found.items()},
            rotations={joint: R[:, index[s]] for joint, s in found.items()},
            body_axes=np.eye(3),
            hands=hands,
            unit_fact=Fact("unit", "m", "assumed", "as the format has it"),
            up="+z",
            bones=len(index),
            bones_called="segments",
            turns={
                label: turning(_against(R, index.get(_PARENT.get(label)), i))
                for label, i in index.items()
            },
            carriers={joint: hung_on(s, _PARENT) for joint, s in found.items()},
            same=repeated(Q.reshape(len(Q), -1)),
            notes=(f"other subjects in the file: {others}",) if mvnx.others else (),
        ),
        options,
    )


def _against(R: np.ndarray, parent: int | None, index: int) -> np.ndarray:
    """(T, 3, 3) turns of a segment against the one that it hangs on."""
    if parent is None:
        return R[:, index]
    return np.swapaxes(R[:, parent], 1, 2) @ R[:, index]
