"""The performer of a motion of the body models SMPL, SMPL-H and SMPL-X."""

import numpy as np

from crar_drake.motion.formats.smpl import SmplMotion, read_smpl_offsets
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import (
    JOINTS,
    Fact,
    Performer,
    hung_on,
    repeated,
    turning,
)
from crar_drake.motion.performers.assemble import Recording, assemble
from crar_drake.motion.point_layouts import joints_of_layout
from crar_drake.motion.smpl_skeleton import (
    BODY_AXES,
    MEAN_OFFSETS,
    NAMES,
    PARENTS,
    smpl_kinematics,
)

_PARENT = {NAMES[i]: NAMES[p] for i, p in enumerate(PARENTS) if p >= 0}


def smpl_performer(motion: SmplMotion, name: str, options: MotionOptions) -> Performer:
    """Returns the performer of a body model's motion.

    Without the model's own file (`options.skeleton`) its lengths are the mean ones,
    whatever the person's. Turns are the person's; the floor is then where that body
    comes lowest.

    Raises:
        MotionError: the file says no rate, or an option is given that it does not need.
    """
    options.refuse(("unit", "joints"), f"motion {name} is of {motion.model}")
    rate, rate_source = options.rate_of(name, motion.frame_rate)
    if options.skeleton:
        offsets = read_smpl_offsets(options.skeleton, motion.betas)
        lengths = Fact("lengths", "of the body's shape", "given", options.skeleton)
    else:
        offsets = MEAN_OFFSETS[motion.model]
        ignored = "betas are ignored" if motion.betas.size else "no betas"
        lengths = Fact("lengths", f"the mean {motion.model} body's", "assumed", ignored)
    p, R, local = smpl_kinematics(motion.turns, motion.translations, offsets)
    index = joints_of_layout(NAMES, JOINTS)
    # Fingers point outwards at rest, thumbs ahead: x and z of the model.
    hands = {
        f"{side}_hand": (
            way * R[:, index[f"{side}_wrist"], :, 0],
            R[:, index[f"{side}_wrist"], :, 2],
        )
        for side, way in (("left", 1.0), ("right", -1.0))
    }
    return assemble(
        Recording(
            name=name,
            format=motion.model,
            frame_rate=rate,
            rate_source=rate_source,
            positions={joint: p[:, i] for joint, i in index.items()},
            joints={joint: NAMES[i] for joint, i in index.items()},
            rotations={joint: R[:, i] for joint, i in index.items()},
            body_axes=BODY_AXES,
            floor_unknown=not options.skeleton,
            hands=hands,
            unit_fact=Fact("unit", "m", "assumed", "as the model has it"),
            bones=len(NAMES),
            bones_called="joints",
            turns={name: turning(local[:, i]) for i, name in enumerate(NAMES)},
            carriers={joint: hung_on(NAMES[i], _PARENT) for joint, i in index.items()},
            same=repeated(
                np.hstack(
                    [motion.translations, motion.turns.reshape(len(motion.turns), -1)]
                )
            ),
            notes=motion.notes,
            up=motion.up,
            facts=(lengths,),
        ),
        options,
    )
