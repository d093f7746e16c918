"""Acclaim skeletons (ASF) and motions (AMC), written: what `asf_amc` reads."""

import os

import numpy as np

from crar_drake.files import whole_file, write_whole
from crar_drake.motion.formats.asf_amc import ROOT_ORDER, Clip, Skeleton


def write_asf(path: str | os.PathLike[str], skeleton: Skeleton) -> None:
    """Writes the skeleton as an ASF file in degrees."""
    lines = [
        ":version 1.10",
        f":name {skeleton.name}",
        ":units",
        "  mass 1.0",
        f"  length {_text(skeleton.length_unit)}",
        "  angle deg",
        ":root",
        f"  order {' '.join(ROOT_ORDER)}",
        "  axis XYZ",
        "  position 0 0 0",
        "  orientation 0 0 0",
        ":bonedata",
    ]
    children: dict[str, list[str]] = {}
    for number, bone in enumerate(skeleton.bones.values(), start=1):
        children.setdefault(bone.parent, []).append(bone.name)
        lines += [
            "  begin",
            f"    id {number}",
            f"    name {bone.name}",
            f"    direction {_texts(bone.direction)}",
            f"    length {_text(bone.length / skeleton.metres_per_unit)}",
            f"    axis {_texts(np.degrees(bone.axis))} XYZ",
        ]
        if bone.dof:
            lines.append(f"    dof {' '.join(bone.dof)}")
        for index, pair in enumerate(bone.limits):
            word = "limits" if index == 0 else "      "
            lines.append(f"    {word} ({_texts(np.degrees(pair))})")
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    for parent in ["root", *skeleton.bones]:
        if parent in children:
            lines.append(f"    {parent} {' '.join(children[parent])}")
    lines.append("  end")
    write_whole(path, "\n".join(lines) + "\n")


def write_amc(path: str | os.PathLike[str], clip: Clip) -> None:
    """Writes the motion as an AMC file in degrees, with its frame rate.

    Values keep 12 significant digits and no trailing zeros, so that a motion whose
    angles were rounded in degrees (and its root in file units) stays small.
    """
    blocks = [
        (
            "root",
            np.hstack(
                [
                    clip.root_position / clip.skeleton.metres_per_unit,
                    np.degrees(clip.root_rotation),
                ]
            ),
        )
    ]
    for bone in clip.skeleton.bones.values():
        if bone.dof:
            blocks.append((bone.name, np.degrees(clip.joints[bone.name])))
    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8") as file:
        file.write(":FULLY-SPECIFIED\n:DEGREES\n")
        file.write(f":SAMPLES-PER-SECOND {_text(clip.frame_rate)}\n")
        for frame in range(clip.num_frames):
            file.write(f"{frame + 1}\n")
            for name, values in blocks:
                file.write(f"{name} {_texts(values[frame])}\n")


def _text(value: float) -> str:
    return f"{value:.12g}"


def _texts(values: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in values)
