"""Figures as files."""

import os
from pathlib import Path

from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from crar_drake.errors import CrarError
from crar_drake.files import check_file, whole_file


def picture_formats() -> tuple[str, ...]:
    """The suffixes of pictures that can be written, such as ".png"."""
    known = FigureCanvasBase.get_supported_filetypes()
    # It needs LaTeX.
    return tuple(sorted(f".{name}" for name in known if name != "pgf"))


def check_picture(path: str | os.PathLike[str]) -> None:
    """Better to know before the work than after it.

    Raises:
        CrarError: the suffix of `path` names no format.
        WriteError: the file cannot be written.
    """
    formats = picture_formats()
    suffix = Path(path).suffix.lower()
    if suffix not in formats:
        what = f"{suffix} is no" if suffix else "there is no suffix to choose the"
        raise CrarError(f"{path}: {what} picture format; known: {', '.join(formats)}")
    check_file(path)


def save_figure(
    figure: Figure, path: str | os.PathLike[str], **options: object
) -> None:
    """Writes a figure, whole or not at all.

    Figures are made without pyplot, so that neither a display nor the backend that
    the user has chosen for windows plays a part.

    Args:
        path: its suffix (.png, .pdf, .svg) chooses the format.
        options: of matplotlib's `Figure.savefig`.

    Raises:
        CrarError: as `check_picture`.
    """
    check_picture(path)
    with whole_file(path) as temporary:
        figure.savefig(temporary, **options)
