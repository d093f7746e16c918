"""The performer of points with names: markers on the skin, or joint centres."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.file_frame import find_unit, seems_mirrored
from crar_drake.motion.gaps import fill_all
from crar_drake.motion.joint_names import joints_by_name, load_joint_file
from crar_drake.motion.marker_sets import choose_markers, marker_body
from crar_drake.motion.options import UNITS, MotionOptions
from crar_drake.motion.performer import (
    JOINTS,
    SIDES,
    Fact,
    Performer,
    repeated,
    sides_swapped,
)
from crar_drake.motion.performers.assemble import (
    MIRRORED,
    REQUIRED,
    Recording,
    assemble,
)
from crar_drake.motion.point_layouts import LAYOUTS, MEANS, layout_of

# So many more markers with the names of a body's are of another one.
_SECOND_BODY = 10


@dataclass(frozen=True)
class RecordedPoints:
    """What a file has of points over time."""

    names: tuple[str, ...]  # (J,) as in the file; empty if it has none
    positions: np.ndarray  # (T, J, 3) [file units]; NaN where a point is missing
    frame_rate: float  # samples per second [Hz]; 0 if the file does not say
    unit: str = ""  # what the file says, or ""
    # what the file says of the subject, e.g. "LKneeWidth" [file units]
    measures: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()  # as in `Performer`


def joints_performer(
    points: RecordedPoints, name: str, options: MotionOptions
) -> Performer:
    """The performer of joint positions.

    Raises:
        MotionError: the points are of no known layout and have no names that say what
            they are, joints are missing, or there is no frame rate.
    """
    if points.unit and points.unit not in UNITS:
        raise MotionError(
            f"motion {name}: its unit {points.unit!r} is not known: {', '.join(UNITS)}"
        )
    layout = layout_of(points.names, points.positions)
    names = points.names or LAYOUTS.get(layout, ())
    if not names:
        raise MotionError(
            f"motion {name}: {points.positions.shape[1]} points without names, which "
            f"is no layout that is known ({', '.join(LAYOUTS)}); put an array names of "
            "their names into an NPZ"
        )
    found = joints_by_name(names)
    if options.joints:
        found |= load_joint_file(options.joints, names)
    common, filled = _common(
        points, dict(zip(names, names, strict=True)), name, options
    )
    positions = {
        joint: filled[names[i]]
        for joint, i in found.items()
        if joint in JOINTS and names[i] in filled
    }
    labels = {joint: names[found[joint]] for joint in positions}
    guessed = set()
    for joint, choices in MEANS.items():
        for means in choices:
            both = filled | positions
            if joint not in positions and all(m in both for m in means):
                positions[joint] = np.mean([both[m] for m in means], axis=0)
                labels[joint] = f"mean of {', '.join(means)}"
                guessed.add(joint)
    missing = [joint for joint in REQUIRED if joint not in positions]
    if missing:
        raise MotionError(
            f"motion {name}: no {', '.join(missing)} among its points: "
            f"{', '.join(names)}; say which is which: --joints FILE"
        )
    if seems_mirrored(positions) and not options.joints:
        positions, labels = sides_swapped(positions), sides_swapped(labels)
        common["doubts"] += (MIRRORED,)
    return assemble(
        Recording(
            format="joint positions",
            positions=positions,
            joints=labels,
            guessed=frozenset(guessed),
            hands_obstacle=(
                f"motion {name}: joint positions do not say how a hand is turned; "
                "track positions only"
            ),
            unit=points.unit,
            bones=len(names),
            bones_called="points",
            facts=(Fact("points", layout, "inferred"),) if layout else (),
            **common,
        ),
        options,
    )


def markers_performer(
    points: RecordedPoints, name: str, options: MotionOptions, *, format: str
) -> Performer:
    """The performer of markers of a known set.

    Args:
        format: of the file.

    Raises:
        MotionError: the markers are of no known set, one that is needed is never
            seen, or the file says no rate.
    """
    if options.joints:
        raise MotionError(
            f"motion {name}: joints of a {format} come from its markers' "
            f"labels; leave --joints {options.joints} away"
        )
    marker_set, subject, labels = choose_markers(points.names, name)
    common, filled = _common(points, labels, name, options)
    if len(filled) < len(labels):  # perhaps one that is needed
        choose_markers([labels[marker] for marker in filled], name)
    legs = {"Hip": "ASI" if "LASI" in filled else "FWT", "Knee": "KNE", "Ankle": "ANK"}
    metres, unit, unit_doubts = find_unit(
        {
            f"{side}_{joint.lower()}": filled[side[0].upper() + marker]
            for side in SIDES
            for joint, marker in legs.items()
        },
        points.unit,
        options,
        name,
    )
    common["doubts"] = (*unit_doubts, *common["doubts"])
    body = marker_body(
        {marker: metres * samples for marker, samples in filled.items()},
        marker_set,
        {measure: metres * value for measure, value in points.measures.items()},
        common["frame_rate"],
    )
    facts = [Fact("markers", marker_set, "file", f"subject {subject}" * bool(subject))]
    if others := _others(points.names, labels, subject):
        who = f"{subject or 'the first'} is taken"
        facts.append(Fact("subjects", "several", "file", f"{who}; {others}"))
    if not any(measure.endswith("KneeWidth") for measure in points.measures):
        facts.append(Fact("widths of joints", "an adult's", "assumed"))
    return assemble(
        Recording(
            format=format,
            positions=body.positions,
            joints=body.sources,
            guessed=frozenset({"head"} & set(body.positions)),
            pelvis_up=body.pelvis_up,
            hands=body.hands,
            unit_fact=unit,
            bones=len(filled),
            bones_called="markers",
            facts=tuple(facts),
            **common,
        ),
        options,
    )


def _common(
    points: RecordedPoints, used: Mapping[str, str], name: str, options: MotionOptions
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a `Recording` says of any points, and those that are used, without gaps.

    Args:
        used: what a point is called to its name in the file, or in its layout.
    """
    rate, rate_source = options.rate_of(name, points.frame_rate)
    # Of several with one name the first.
    listed = points.names or tuple(used.values())
    seen = {
        point: points.positions[:, listed.index(label)] for point, label in used.items()
    }
    filled, notes, doubts = fill_all(seen, rate)
    if hidden := [point for point in seen if point not in filled]:
        notes += (f"never seen: {', '.join(hidden)}",)
    recorded = np.hstack(list(filled.values())) if filled else np.zeros((0, 0))
    common = {
        "name": name,
        "frame_rate": rate,
        "rate_source": rate_source,
        "same": repeated(recorded),
        "doubts": points.doubts + doubts,
        "notes": notes,
    }
    return common, filled


def _others(labels: Sequence[str], used: Mapping[str, str], subject: str) -> str:
    """Who else is in the file, in words; "" if nobody is.

    Args:
        labels: of all markers.
        used: marker of the body that is taken to its label.
        subject: that body's prefix.
    """
    prefixes = {label.rpartition(":")[0] for label in labels} - {subject, ""}
    if prefixes:
        return f"others: {', '.join(sorted(prefixes))}"
    twice = list((Counter(labels) - Counter(set(labels))).elements())
    alike = twice + [
        label
        for marker, label in used.items()
        if any(name in marker for name in used if name != marker)
    ]
    if len(alike) < _SECOND_BODY:
        return ""
    return f"others have {', '.join(alike[:3])} and {len(alike) - 3} more markers"
