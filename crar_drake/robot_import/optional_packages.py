"""What the extra `robots` brings, asked for before it is needed."""

import importlib
from collections.abc import Mapping

from crar_drake.errors import ModelError
from crar_drake.resources import install_command


def require_packages(
    packages: Mapping[str, str], purpose: str, otherwise: str = ""
) -> None:
    """Imports modules, so that one that is missing is told at once.

    Args:
        packages: module to the package of the extra `robots` that brings it.
        purpose: what needs them.
        otherwise: what to do without them, for the end of the message.

    Raises:
        ModelError: a package is not installed, or is broken.
    """
    missing = []
    for module, package in packages.items():
        try:
            importlib.import_module(module)
        except ImportError:
            missing.append(package)
    if missing:
        raise ModelError(
            f"{purpose} needs {', '.join(missing)}: "
            f"{install_command('robots')}{otherwise}"
        )
