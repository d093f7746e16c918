"""Where the meshes of a URDF or SDF are."""

import os
from collections.abc import Sequence
from pathlib import Path

from crar_drake.errors import ModelError
from crar_drake.robot_import.robot_files import read_xml


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
        for root in self._roots:
            for folder in (root / name, root):
                if folder.is_dir() and _is_package(folder, name):
                    return folder
        for ancestor in self._file.parents:
            for folder in (ancestor, ancestor / name):
                if folder.is_dir() and _is_package(folder, name):
                    return folder
        return None


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
