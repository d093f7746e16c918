"""The performer of an array of joint positions."""

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.file_frame import seems_mirrored
from crar_drake.motion.formats.point_arrays import PointArrays
from crar_drake.motion.gaps import fill_all
from crar_drake.motion.joint_names import joints_by_name, load_joint_file
from crar_drake.motion.options import UNITS, MotionOptions
from crar_drake.motion.performer import JOINTS, Fact, Performer, repeated, sides_swapped
from crar_drake.motion.performers.assemble import (
    MIRRORED,
    REQUIRED,
    Recording,
    assemble,
)
from crar_drake.motion.point_layouts import LAYOUTS, MEANS, joints_of_layout, layout_of


def points_performer(
    arrays: PointArrays, name: str, options: MotionOptions
) -> Performer:
    """Returns the performer of an array of joint positions.

    Raises:
        MotionError: the points are of no known layout and have no names that say what
            they are, joints are missing, or there is no frame rate.
    """
    rate, rate_source = options.rate_of(name, arrays.frame_rate)
    if arrays.unit and arrays.unit not in UNITS:
        raise MotionError(
            f"motion {name}: its unit {arrays.unit!r} is not known: {', '.join(UNITS)}"
        )
    layout = layout_of(arrays.names, arrays.positions)
    names = arrays.names or LAYOUTS.get(layout, ())
    if not names:
        raise MotionError(
            f"motion {name}: {arrays.positions.shape[1]} points without names, which "
            f"is no layout that is known ({', '.join(LAYOUTS)}); put an array names of "
            "their names into an NPZ"
        )
    found = joints_of_layout(names, JOINTS) if layout else joints_by_name(names)
    if options.joints:
        found |= load_joint_file(options.joints, names)
    everything = {names[i]: arrays.positions[:, i] for i in range(len(names))}
    filled, notes, doubts = fill_all(everything, rate)
    doubts = arrays.doubts + doubts
    points = {
        joint: filled[names[i]]
        for joint, i in found.items()
        if joint in JOINTS and names[i] in filled
    }
    labels = {joint: names[found[joint]] for joint in points}
    guessed = set()
    for joint, choices in MEANS.items():
        for means in choices:
            if joint not in points and all(m in (filled | points) for m in means):
                both = filled | points
                points[joint] = np.mean([both[m] for m in means], axis=0)
                labels[joint] = f"mean of {', '.join(means)}"
                guessed.add(joint)
    hidden = [n for n in everything if n not in filled]
    if hidden:
        notes += (f"never seen: {', '.join(hidden)}",)
    missing = [joint for joint in REQUIRED if joint not in points]
    if missing:
        raise MotionError(
            f"motion {name}: no {', '.join(missing)} among its points: "
            f"{', '.join(names)}; say which is which: --joints FILE"
        )
    if seems_mirrored(points) and not options.joints:
        points, labels = sides_swapped(points), sides_swapped(labels)
        doubts += (MIRRORED,)
    return assemble(
        Recording(
            name=name,
            format="joint positions",
            frame_rate=rate,
            rate_source=rate_source,
            positions=points,
            joints=labels,
            guessed=frozenset(guessed),
            hands_obstacle=(
                f"motion {name}: joint positions do not say how a hand is turned; "
                "track positions only"
            ),
            unit=arrays.unit,
            bones=len(names),
            bones_called="points",
            same=repeated(np.hstack(list(filled.values()))),
            doubts=doubts,
            notes=notes,
            facts=(Fact("points", layout, "inferred"),) if layout else (),
        ),
        options,
    )
