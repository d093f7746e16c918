"""Where the certificate of a motion is, and what it says of the motion's file.

A CSV says neither its rate nor the order of its quaternion. What stands beside one that
was written here says both, of that file alone.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path

from crar_drake.errors import CrarError
from crar_drake.files import check_file, whole_file
from crar_drake.motion.rates import check_rate
from crar_drake.references.layouts import LAYOUTS
from crar_drake.robot.description import RobotDescription

KIND = "crar-drake certificate of a reference motion"
FORMAT = 4
SUFFIX = ".certificate.json"


def certificate_path(motion: str | os.PathLike[str]) -> Path:
    """Where the certificate of a motion's file is: NAME.certificate.json beside it."""
    path = Path(motion)
    return path.with_name(path.stem + SUFFIX)


def check_certificate_place(motion: Path) -> None:
    """dance.csv and dance.npz in one folder would have one certificate.

    Args:
        motion: the file that is to be written.

    Raises:
        WriteError: the certificate's place is a folder, or cannot be written to.
        CrarError: there is the certificate of another file, which is there as well.
    """
    place = certificate_path(motion)
    check_file(place)
    try:
        other = read_certificate(place)["motion"]["file"]
    except CrarError:
        return  # none of a motion: it is replaced
    if other != motion.name and (motion.parent / other).is_file():
        raise CrarError(
            f"{motion}: {place.name} beside it is the certificate of {other}; write "
            "to another name or folder"
        )


def file_hash(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def robot_files(description: RobotDescription) -> dict[str, str]:
    """Name to hash of the files that say what the robot is: description and model."""
    folder = Path(description.folder)
    files = [folder / "robot.yaml", folder / description.model]
    return {path.name: file_hash(path) for path in files if path.is_file()}


def write_certificate(path: Path, certificate: dict) -> None:
    """Writes it, whole or not at all.

    Raises:
        WriteError: the file cannot be written.
    """
    with whole_file(path) as temporary:
        temporary.write_text(_in_lines(certificate) + "\n")


def _in_lines(certificate: dict) -> str:
    """As JSON: a line for each entry of a list, and for what is no list."""
    entries = []
    for key, value in certificate.items():
        text = json.dumps(value)
        if isinstance(value, list) and value:
            text = "[\n  " + ",\n  ".join(map(json.dumps, value)) + "\n ]"
        entries.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(entries) + "\n}"


def read_certificate(path: str | os.PathLike[str]) -> dict:
    """Reads it.

    Raises:
        CrarError: it is not there, or not one of this format; the message names it.
    """
    try:
        certificate = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CrarError(
            f"{path}: there is no certificate; crar-drake clean writes it beside the "
            "motion"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise CrarError(f"{path}: is no certificate: {error}") from error
    if not isinstance(certificate, dict) or certificate.get("kind") != KIND:
        raise CrarError(f"{path}: is no certificate of a reference motion")
    if certificate.get("format") != FORMAT:
        raise CrarError(
            f"{path}: has format {certificate.get('format')!r}, and this version "
            f"reads {FORMAT}"
        )
    for keys, kind, what in (
        (("motion", "file"), str, "a text"),
        (("motion", "sha256"), str, "a text"),
        (("robot", "name"), str, "a text"),
        (("robot", "files"), dict, "an object"),
        (("not_covered", "pairs"), list, "a list"),
        (("mesh_pairs",), list, "a list"),
        (("clips",), list, "a list"),
    ):
        value = certificate
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        if not isinstance(value, kind):
            raise CrarError(f"{path}: {'.'.join(keys)} is not there, or not {what}")
    return certificate


def told_beside(
    motion: str | os.PathLike[str], robot: RobotDescription | None
) -> tuple[str | None, float | None, bool]:
    """What the certificate beside a motion says of this very file.

    Returns:
        The name of its layout; its rate [Hz] where such files have none; each None
        where nothing says it. And whether it was written for this robot.
    """
    layout = rate = files = None
    with suppress(CrarError, OSError, OverflowError):
        certificate = read_certificate(certificate_path(motion))
        of_file = certificate["motion"]
        if of_file["sha256"] == file_hash(motion):
            layout, files = of_file.get("layout"), certificate["robot"]["files"]
            if type(said := of_file.get("rate")) in (int, float):
                check_rate(said)
                rate = float(said)
    return (
        layout if isinstance(layout, str) and layout in LAYOUTS else None,
        rate,
        robot is not None and files == robot_files(robot),
    )
