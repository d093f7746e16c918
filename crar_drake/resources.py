"""Where data lies: what is shipped, and what is kept in the user's cache; and what an
extra brings."""

import importlib
import importlib.util
from collections.abc import Collection, Mapping
from pathlib import Path

import platformdirs

from crar_drake.errors import ModelError

_PACKAGE = Path(__file__).resolve().parent


def install_command(extra: str) -> str:
    """What installs an extra, from the checkout where there is one."""
    checkout = _PACKAGE.parent
    of = str(checkout) if (checkout / "pyproject.toml").is_file() else "crar-drake"
    return f"pip install '{of}[{extra}]'"


def require_packages(
    packages: Mapping[str, str],
    purpose: str,
    otherwise: str = "",
    later: Collection[str] = (),
) -> None:
    """Imports modules, so that one that is missing is told at once.

    Args:
        packages: module to the package of the extra `robots` that brings it.
        purpose: what needs them.
        otherwise: what to do without them, for the end of the message.
        later: which of the modules are looked for, and not imported yet.

    Raises:
        ModelError: a package is not installed, or is broken.
    """
    missing = []
    for module, package in packages.items():
        try:
            if module not in later:
                importlib.import_module(module)
            elif importlib.util.find_spec(module) is None:
                missing.append(package)
        except ImportError:
            missing.append(package)
    if missing:
        raise ModelError(
            f"{purpose} needs {', '.join(missing)}: "
            f"{install_command('robots')}{otherwise}"
        )


def page_resource(name: str, room: str = "results") -> str:
    """A file that the pages of a room are made of, as text."""
    return (_PACKAGE / room / "page" / name).read_text(encoding="utf-8")


def data_folder(kind: str) -> Path:
    """Returns the folder of the shipped "models" or "diagrams".

    In a wheel they lie inside the package; in a checkout (and so in an editable
    install) beside it.

    Raises:
        FileNotFoundError: neither place exists, so the installation is broken.
    """
    for candidate in (_PACKAGE / kind, _PACKAGE.parent / kind):
        if candidate.is_dir():
            return candidate
    raise FileNotFoundError(
        f"crar_drake's {kind}/ folder is in neither {_PACKAGE} nor "
        f"{_PACKAGE.parent}; reinstall the package"
    )


def builtin_motions_folder() -> Path:
    """Returns the folder of the motions that this project authored."""
    return _PACKAGE / "motion" / "builtin"


def cached(kind: str) -> Path:
    """Returns a folder of the user's cache; it need not exist."""
    return platformdirs.user_cache_path("crar-drake") / kind


def imported_robots_folder() -> Path:
    """Where `crar-drake import-robot` keeps robots, each in a folder of its name."""
    return cached("robots")
