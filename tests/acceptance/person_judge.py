"""Reads where the limbs of a person of the CMU database point, and where a robot's do.

Forward kinematics of ASF and AMC as the format's description has it; nothing here knows
the product. The world has z up; x is where the person faces at rest, y the left.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

UNIT = 0.0254 / 0.45  # of the database [m]
# Each limb: the bones of the person whose beginnings it joins ("" is where the bone
# before ends).
BONES = {
    "upper arm": ("humerus", "radius"),
    "forearm": ("radius", "wrist"),
    "thigh": ("femur", "tibia"),
    "shin": ("tibia", "foot"),
}


STANDS = 0.1  # a foot whose ankle and toes are slower stands [m/s]


def read(amc: Path, every: int) -> dict[str, np.ndarray]:
    """(T, 3) where the person's bones begin, of each `every`-th frame [m]."""
    skeleton = _read_skeleton(next(amc.parent.glob("*.asf")))
    frames = [_starts(skeleton, frame) for frame in list(_read_frames(amc))[::every]]
    return {
        bone: UNIT * np.array([frame[bone] for frame in frames])[:, [2, 0, 1]]
        for bone in frames[0]
    }


def limbs_of(person: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """(T, 3) directions of the person's limbs."""
    return {
        f"{side} {limb}": direction(person[side[0] + upper], person[side[0] + lower])
        for limb, (upper, lower) in BONES.items()
        for side in ("left", "right")
    }


def stands(person: dict[str, np.ndarray], side: str, rate: float) -> np.ndarray:
    """(T - 1,) whether a foot stands from each frame to the next."""
    ways = [np.diff(person[side[0] + bone], axis=0) for bone in ("foot", "toes")]
    return np.max(np.linalg.norm(ways, axis=2), axis=0) * rate < STANDS


def errors(person: dict, robot: dict) -> dict[str, np.ndarray]:
    """(T,) angles between the limbs of both [degrees]."""
    return {
        limb: np.degrees(
            np.arccos(np.clip(np.sum(person[limb] * robot[limb], axis=1), -1.0, 1.0))
        )
        for limb in person
    }


def direction(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(T, 3) unit vectors from one point to another."""
    way = end - start
    return way / np.linalg.norm(way, axis=1)[:, None]


def _read_skeleton(asf: Path) -> list[tuple[str, str, Rotation, np.ndarray, list]]:
    """Bones from the root outwards: name, parent, axes, offset to its end (in the
    file's unit), the names of its angles."""
    sections = asf.read_text().split(":bonedata")[1]
    bonedata, hierarchy = sections.split(":hierarchy")
    bones = {}
    for block in bonedata.split("begin")[1:]:
        words = {
            line.split()[0]: line.split()[1:]
            for line in block.splitlines()
            if line.split()
        }
        axes = Rotation.from_euler("xyz", np.float64(words["axis"][:3]), degrees=True)
        offset = np.float64(words["direction"]) * float(words["length"][0])
        bones[words["name"][0]] = axes, offset, words.get("dof", [])
    found = []
    for line in hierarchy.splitlines():
        parent, *children = line.split() or [""]
        found += [
            (child, parent, *bones[child]) for child in children if child in bones
        ]
    return found


def _read_frames(amc: Path) -> Iterator[dict[str, list[float]]]:
    frame: dict[str, list[float]] | None = None
    for line in amc.read_text().splitlines():
        words = line.split()
        if len(words) == 1 and words[0].isdigit():
            if frame is not None:
                yield frame
            frame = {}
        elif frame is not None and words:
            frame[words[0]] = [float(word) for word in words[1:]]
    if frame:
        yield frame


def _starts(skeleton: list, frame: dict[str, list[float]]) -> dict[str, np.ndarray]:
    """Where each bone begins."""
    p, angles = np.array(frame["root"][:3]), frame["root"][3:]
    ends, turns = (
        {"root": p},
        {"root": Rotation.from_euler("xyz", angles, degrees=True)},
    )
    starts = {}
    for bone, parent, axes, offset, names in skeleton:
        own = dict(zip(names, frame.get(bone, []), strict=True))
        turn = Rotation.from_euler(
            "xyz", [own.get(name, 0.0) for name in ("rx", "ry", "rz")], degrees=True
        )
        turns[bone] = turns[parent] * axes * turn * axes.inv()
        starts[bone] = ends[parent]
        ends[bone] = ends[parent] + turns[bone].apply(offset)
    return starts
