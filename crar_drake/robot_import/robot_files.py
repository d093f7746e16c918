"""Where a robot's file is, and what the robot is called after it."""

from __future__ import annotations

import importlib.metadata
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from crar_drake.errors import ModelError
from crar_drake.nearest import nearest
from crar_drake.resources import install_command

# How an import names a file of that package, wherever it is installed.
PACKAGE_SCHEME = "example-robot-data:"

# Names of files and folders that many robots share.
_SAYS_NOTHING = (
    *("model", "robot", "main", "scene", "urdf", "sdf", "mjcf", "xml", "xmls"),
    *("robots", "description", "models"),
)


def find_urdf(name: str | os.PathLike[str]) -> tuple[Path, str]:
    """The file of a path, of `example-robot-data:some/path`, or of a file's name there.

    Args:
        name: e.g. "robot.urdf", "robot.xml", "romeo", "cassie_v2",
            "example-robot-data:robots/…/g1.urdf".

    Returns:
        The file, and how an import file names it.

    Raises:
        ModelError: there is no such file; the message names what there is.
    """
    text = str(name)
    if Path(text).is_file():
        return Path(text).resolve(), str(Path(text).resolve())
    if not text.startswith(PACKAGE_SCHEME) and (
        "/" in text or text.endswith((".urdf", ".xacro", ".sdf", ".xml"))
    ):
        raise ModelError(f"no URDF, SDF or MJCF at {text}")
    folder = robot_data_folder()
    if folder is None:
        raise ModelError(
            f"no robot {text!r} without the package example-robot-data: "
            f"{install_command('robots')}, or give the path of a URDF, SDF or MJCF"
        )
    if text.startswith(PACKAGE_SCHEME):
        path = folder / text.removeprefix(PACKAGE_SCHEME)
        if not path.is_file():
            raise ModelError(
                f"the installed example-robot-data has no {path.relative_to(folder)}; "
                "install another version of it"
            )
        return path, text
    known = {
        path.stem: path
        for kind in ("sdf", "urdf")  # a URDF is taken where there are both
        for path in sorted(folder.glob(f"robots/**/*.{kind}"))
    }
    if text not in known:
        raise ModelError(
            f"no robot {text!r}: neither a file nor one of the package "
            f"example-robot-data{nearest(text, known)}"
        )
    path = known[text]
    return path, PACKAGE_SCHEME + path.relative_to(folder).as_posix()


def robot_data_folder() -> Path | None:
    """Where the package example-robot-data has its files; None if not installed."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        parts = file.parts
        if "robots" in parts and file.suffix == ".urdf":
            return Path(str(file.locate())).parents[
                len(parts) - parts.index("robots") - 1
            ]
    return None


def default_name(path: Path) -> str:
    """What a robot is called after its file: the file's name, or where that says
    nothing (model.urdf) the folder's, or the robot element's."""
    for name in (path.stem, *(folder.name for folder in path.absolute().parents[:2])):
        if name and name.lower() not in _SAYS_NOTHING:
            return name
    try:
        root = ElementTree.fromstring(readable_xml(path))
        model = root.find("model")  # of an SDF
        element = root if model is None else model
        name = element.get("name") or element.get("model")
    except (ElementTree.ParseError, UnicodeDecodeError, OSError):
        name = None  # it is refused where it is read
    return (name or path.stem).replace("/", "_").replace(" ", "_")


def robot_name(name: str, path: Path) -> str:
    return default_name(path) if name.lower() in ("", *_SAYS_NOTHING) else name


def readable_xml(path: Path) -> str:
    """The file's text, readable although it may use undeclared XML prefixes."""
    text = path.read_text(encoding="utf-8")
    return text.replace("<drake:", "<_drake_").replace("</drake:", "</_drake_")
