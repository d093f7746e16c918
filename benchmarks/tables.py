"""Markdown tables, as the documentation shows them."""

import os
from collections.abc import Sequence

from crar_drake.files import write_whole


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with a header; every cell is text already."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def write_report(text: str, path: str | os.PathLike[str] | None) -> None:
    """Prints a report, and writes it to `path` if there is one."""
    print(text)
    if path is not None:
        write_whole(path, text)
