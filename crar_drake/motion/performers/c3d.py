"""The performer of a C3D or TRC file with a known set of markers."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from crar_drake.errors import MotionError
from crar_drake.motion.file_frame import find_unit
from crar_drake.motion.formats.c3d import Markers
from crar_drake.motion.gaps import fill_all
from crar_drake.motion.marker_sets import choose_markers, marker_body
from crar_drake.motion.options import MotionOptions
from crar_drake.motion.performer import SIDES, Fact, Performer, repeated
from crar_drake.motion.performers.assemble import Recording, assemble

# So many more markers with the names of a body's are of another one.
_SECOND_BODY = 10


def c3d_performer(markers: Markers, name: str, options: MotionOptions) -> Performer:
    """Returns the performer of a C3D file.

    Raises:
        MotionError: the markers are of no known set, one that is needed is never
            seen, or the file says no rate.
    """
    if options.joints:
        raise MotionError(
            f"motion {name}: joints of a {markers.format} come from its markers' "
            f"labels; leave --joints {options.joints} away"
        )
    rate, rate_source = options.rate_of(name, markers.frame_rate)
    marker_set, subject, labels = choose_markers(markers.labels, name)
    column = {label: i for i, label in reversed(list(enumerate(markers.labels)))}
    seen = {
        marker: markers.positions[:, column[label]] for marker, label in labels.items()
    }
    points, notes, doubts = fill_all(seen, rate)
    doubts = markers.doubts + doubts
    hidden = {marker: label for marker, label in labels.items() if marker not in points}
    if hidden:  # perhaps one that is needed
        choose_markers([labels[marker] for marker in points], name)
        notes += (f"never seen: {', '.join(hidden)}",)
    legs = {"Hip": "ASI" if "LASI" in points else "FWT", "Knee": "KNE", "Ankle": "ANK"}
    metres, unit, unit_doubts = find_unit(
        {
            f"{side}_{joint.lower()}": points[side[0].upper() + marker]
            for side in SIDES
            for joint, marker in legs.items()
        },
        markers.unit,
        options,
        name,
    )
    used = {marker: metres * samples for marker, samples in points.items()}
    body = marker_body(
        used,
        marker_set,
        {measure: metres * value for measure, value in markers.measures.items()},
        rate,
    )
    facts = [Fact("markers", marker_set, "file", f"subject {subject}" * bool(subject))]
    if others := _others(markers.labels, labels, subject):
        who = f"{subject or 'the first'} is taken"
        facts.append(Fact("subjects", "several", "file", f"{who}; {others}"))
    if not any(measure.endswith("KneeWidth") for measure in markers.measures):
        facts.append(Fact("widths of joints", "an adult's", "assumed"))
    return assemble(
        Recording(
            name=name,
            format=markers.format,
            frame_rate=rate,
            rate_source=rate_source,
            positions=body.positions,
            joints=body.sources,
            guessed=frozenset({"head"} & set(body.positions)),
            pelvis_up=body.pelvis_up,
            hands=body.hands,
            unit_fact=unit,
            bones=len(points),
            bones_called="markers",
            same=repeated(np.hstack(list(points.values()))),
            doubts=(*unit_doubts, *doubts),
            notes=notes,
            facts=tuple(facts),
        ),
        options,
    )


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
