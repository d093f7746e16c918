"""Where a robot's file and its meshes are; its name; numbers in its XML."""

import importlib.metadata
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from crar_drake.errors import ModelError, nearest
from crar_drake.resources import install_command

# How an import names a file of that package, wherever it is installed.
PACKAGE_SCHEME = "example-robot-data:"

# What a file in another encoding than UTF-8 begins with: a byte order mark, or "<".
_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe\0\0": "utf-32"} | {
    **{b"\0\0\xfe\xff": "utf-32", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"},
    **{b"<\0": "utf-16-le", b"\0<": "utf-16-be"},
}
_DECLARED = re.compile(rb"\s*<\?xml[^>]*?\bencoding\s*=\s*[\"']([\w.-]+)[\"']")
_DECLARATION = re.compile(r"^\s*<\?xml[^>]*\?>")

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
        root = read_xml(path, "an XML file")
        model = root.find("model")  # of an SDF
        element = root if model is None else model
        name = element.get("name") or element.get("model")
    except ModelError:
        name = None  # it is refused where it is read
    return (name or path.stem).replace("/", "_").replace(" ", "_")


def robot_name(name: str, path: Path) -> str:
    return default_name(path) if name.lower() in ("", *_SAYS_NOTHING) else name


def read_xml(path: Path, what: str) -> ElementTree.Element:
    """The root element; Drake's prefix, which files use undeclared, is _drake_ in it.

    Raises:
        ModelError: it cannot be read, or is no XML.
    """
    text = xml_text(path, what)
    text = text.replace("<drake:", "<_drake_").replace("</drake:", "</_drake_")
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ModelError(f"{path}: not {what}: {error}") from error


def xml_text(path: Path, what: str) -> str:
    """A file's text, in the encoding that its first bytes or its declaration say.

    Python's parser would read neither GBK nor another encoding of several bytes, and
    it heeds no declaration in a text.

    Raises:
        ModelError: it cannot be read, or is not in that encoding.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    marked = next((e for mark, e in _MARKS.items() if data.startswith(mark)), "")
    declared = _DECLARED.match(data.replace(b"\0", b""))
    encoding = marked or (declared[1].decode() if declared else "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeError as error:
        raise ModelError(f"{path}: not {what}: {error}") from error
    except LookupError:
        raise ModelError(
            f"{path}: not {what}: nobody knows its encoding, {encoding!r}"
        ) from None
    return _DECLARATION.sub("", text.lstrip("\ufeff"))


def numbers_of(text: str | None, infinite: bool = False) -> tuple[float, ...]:
    """Numbers in a text, also those that were written with commas.

    "1.5 2 3", "1.5, 2, 3" and "1.5,2,3" are three numbers, "1,5" is one. ValueError
    where something is none, NaN, or infinite if it must not be.
    """
    words = [word.strip(",") for word in (text or "").split()]
    numbers = []
    for word in words:
        decimal = word.count(",") == 1 and "." not in word
        pieces = [word.replace(",", ".")] if decimal else word.split(",")
        for piece in pieces:
            try:
                numbers.append(float(piece))
            except ValueError:
                raise ValueError(f"{text!r} is not made of numbers") from None
    if np.isnan(numbers).any() or not (infinite or np.isfinite(numbers).all()):
        raise ValueError(f"{text!r} is not made of finite numbers")
    return tuple(numbers)


def three_numbers(text: str | None) -> tuple[float, ...]:
    numbers = numbers_of(text)
    if len(numbers) != 3:
        raise ValueError(f"{text!r} is not three numbers")
    return numbers


def one_number(text: str, infinite: bool = False) -> float:
    """The number that an attribute is; "1,5" is 1.5. ValueError if it is none."""
    numbers = numbers_of(text, infinite)
    if len(numbers) != 1:
        raise ValueError(f"{text!r} is not a number")
    return numbers[0]


@contextmanager
def naming(path: Path, what: str, element: ElementTree.Element) -> Iterator[None]:
    """Numbers that are none become a ModelError that names the element."""
    try:
        yield
    except ValueError as error:
        name = element.get("name") or ""
        raise ModelError(f"{path}: {what} {name!r}: {error}") from error


class MeshFinder:
    """Resolves mesh addresses, and tells all that are missing at once."""

    def __init__(self, file: Path, package_paths: Sequence[Path]) -> None:
        self._file = file
        variables = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
        entries = [e for v in variables for e in os.environ.get(v, "").split(":") if e]
        around = [Path(entry) for entry in entries]
        around += [path / "share" for path in around]
        self._roots = [*map(Path, package_paths), *around]
        self._missing: list[str] = []
        self._other_capitals: list[str] = []
        self._packages: set[str] = set()

    def find(self, address: str, where: str, *, folder: bool = False) -> Path:
        """The file of an address; what is not there is told by `check`.

        Of a name that is there with other capitals alone, that file: file systems that
        such names come from do not tell them apart.

        Args:
            address: relative, or package://, model:// or file://.
            where: in the file it stands, "link pelvis" or "line 7".
            folder: whether it may be a folder.
        """
        scheme, _, rest = address.rpartition("://")
        if scheme in ("package", "model"):
            package, _, inner = rest.lstrip("/").partition("/")
            place = self._package(package)
            if place is None:
                self._packages.add(package)
                return Path(inner)
            path = place / inner
        else:
            path = self._file.parent / rest
        if not (path.is_file() or (folder and path.is_dir())):
            likely = _with_other_capitals(path)
            if len(likely) == 1:
                self._other_capitals.append(likely[0].name)
                return likely[0]
            names = "".join(f"; there is {each.name}" for each in likely)
            self._missing.append(f"{address} ({where}{names})")
        return path

    def check(self) -> list[str]:
        """Tells all that was asked for and is not there.

        Returns:
            a note, if there is one, of files whose names have other capitals.

        Raises:
            ModelError: there is such; it names the addresses and what to do.
        """
        if self._packages:
            raise ModelError(
                f"{self._file}: it needs packages that are not found: "
                f"{', '.join(sorted(self._packages))}; name the folder that contains "
                "them with --package-path (or in ROS_PACKAGE_PATH)"
            )
        if self._missing:
            shown = "; ".join(self._missing[:5])
            more = len(self._missing) - 5
            raise ModelError(
                f"{self._file}: files are missing: {shown}"
                f"{f'; and {more} more' if more > 0 else ''}"
            )
        if not self._other_capitals:
            return []
        names = ", ".join(dict.fromkeys(self._other_capitals))
        where = self._file.name
        return [f"files whose names have other capitals than {where} writes: {names}"]

    def _package(self, name: str) -> Path | None:
        given = [place for root in self._roots for place in (root / name, root)]
        around = [place for up in self._file.parents for place in (up, up / name)]
        folders = (folder for folder in (*given, *around) if folder.is_dir())
        return next((f for f in folders if _is_package(f, name)), None)


def _with_other_capitals(path: Path) -> list[Path]:
    """Files beside it whose names differ by capitals alone."""
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    return sorted(
        each
        for each in beside
        if each.is_file() and each.name.lower() == path.name.lower()
    )


def _is_package(folder: Path, name: str) -> bool:
    if folder.name == name:
        return True
    try:
        manifest = read_xml(folder / "package.xml", "a manifest")
    except ModelError:
        return False
    return (manifest.findtext("name") or "").strip() == name
