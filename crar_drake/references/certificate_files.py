"""Where the certificate of a motion is, and what it says of the motion's file.

A CSV says neither its rate nor the order of its quaternion. What stands beside one that
was written here says both, of that file alone.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from crar_drake.errors import CrarError
from crar_drake.files import whole_file
from crar_drake.motion.rates import can_be_rate
from crar_drake.references.layouts import LAYOUTS
from crar_drake.robot.description import RobotDescription

KIND = "crar-drake certificate of a reference motion"
FORMAT = 4
SUFFIX = ".certificate.json"
_WHENCE = "crar-drake clean writes one beside the motion"


def certificate_path(motion: str | os.PathLike[str]) -> Path:
    """Where the certificate of a motion's file is: NAME.certificate.json beside it."""
    path = Path(motion)
    return path.with_name(path.stem + SUFFIX)


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

    Returns:
        What it says; what a judge looks at is there, and of the right kind.

    Raises:
        CrarError: it is not there, not one of this format, or damaged; the message
            names it, and says what to do.
    """
    try:
        certificate = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CrarError(
            f"{path}: there is no certificate; {_WHENCE}, and a log of `crar-drake "
            "run` needs none"
        ) from None
    except IsADirectoryError:
        raise CrarError(f"{path}: is no certificate, but a folder; {_WHENCE}") from None
    except json.JSONDecodeError as error:
        raise _damaged(path, f"from line {error.lineno} on it is not JSON") from error
    except (ValueError, RecursionError) as error:
        raise _damaged(path, "it is not JSON in UTF-8") from error
    except OSError as error:
        raise CrarError(f"{path}: cannot be read: {error.strerror}") from error
    if not isinstance(certificate, dict) or certificate.get("kind") != KIND:
        raise CrarError(f"{path}: is no certificate of a reference motion; {_WHENCE}")
    if certificate.get("format") != FORMAT:
        raise CrarError(
            f"{path}: has format {certificate.get('format')!r}, and this version "
            f"reads {FORMAT}; clean the motion again"
        )
    if what := next(_mistakes(certificate, _FORM, ""), None):
        raise _damaged(path, what)
    return certificate


def _damaged(path: str | os.PathLike[str], what: str) -> CrarError:
    return CrarError(
        f"{path}: the certificate is damaged: {what}; copy it again, or clean the "
        "motion again"
    )


def _is_number(value: object) -> bool:
    if isinstance(value, float):
        return not math.isnan(value)  # infinite is the distance of what is far
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53


def _is_whole(value: object) -> bool:
    return not isinstance(value, float) and _is_number(value)


def _are_two_texts(value: object) -> bool:
    texts = isinstance(value, list) and all(isinstance(text, str) for text in value)
    return texts and len(value) == 2


# What it is to be: a test, and its words.
_TEXT = (lambda value: isinstance(value, str), "no text")
_NUMBER = (_is_number, "no number")
_WHOLE = (_is_whole, "no whole number")
_RATE = (lambda value: _is_number(value) and can_be_rate(value), "no rate")
_RATE_IF_ANY = (lambda value: value is None or _RATE[0](value), "no rate")
_LAYOUT = (lambda value: isinstance(value, str) and value in LAYOUTS, "no layout")
_OBJECT = (lambda value: isinstance(value, dict), "no object")
_PAIR, _FAULT = (
    (_are_two_texts, what) for what in ("no pair of links", "no fault and where it is")
)
_OF_MESHES = {"at_frames": [_NUMBER], "on_ways": [_NUMBER]}
_MESHES = (
    lambda value: value is None or not any(_mistakes(value, _OF_MESHES, "")),
    "no bounds of meshes",
)
# The parts of a certificate that a judge looks at. A list is one of what is in it.
_FORM = {
    "motion": {
        **{"file": _TEXT, "sha256": _TEXT, "layout": _LAYOUT, "rate": _RATE_IF_ANY},
        "guessed": [_TEXT],
    },
    "robot": {"name": _TEXT, "files": _OBJECT, "watched_pairs": _WHOLE},
    "not_covered": {"pairs": [_PAIR]},
    "mesh_pairs": [_PAIR],
    "clips": [
        {
            "clip": _TEXT,
            "rate": _RATE,
            "frames": {
                "distance": [_NUMBER],
                "pair": [_WHOLE],
                "between": [_NUMBER],
                "limit": [_NUMBER],
                "speed": [_NUMBER],
            },
            "smallest": _OBJECT,
            "meshes": _MESHES,
            "faults": [_FAULT],
            "left_as_it_was": [_TEXT],
            "excused": [_WHOLE],
        }
    ],
}


def _mistakes(value: object, form: object, where: str) -> Iterator[str]:
    """What in a certificate is not of its form."""
    if isinstance(form, tuple):
        fits, what = form
        if not fits(value):
            yield f"{where} is {what}"
    elif isinstance(form, list):
        if not isinstance(value, list):
            yield f"{where} is no list"
            return
        for k, entry in enumerate(value):
            yield from _mistakes(entry, form[0], f"{where}[{k}]")
    elif not isinstance(value, dict):
        yield f"{where} is no object"
    else:
        for key, of in form.items():
            inner = f"{where}.{key}".lstrip(".")
            if key in value:
                yield from _mistakes(value[key], of, inner)
            else:
                yield f"{inner} is missing"


def certificate_beside(motion: str | os.PathLike[str]) -> dict | None:
    """The certificate beside a motion, if it is one of this very file."""
    with suppress(CrarError, OSError):
        certificate = read_certificate(certificate_path(motion))
        if certificate["motion"]["sha256"] == file_hash(motion):
            return certificate
    return None
