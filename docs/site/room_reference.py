"""Sphinx: a page for each room, with the reference of all its modules.

The pages are alike: each has the directive `.. room:: control`, or of another folder of
the package. They are written before Sphinx looks for pages, and are not kept in git.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import crar_drake

_PACKAGE = Path(crar_drake.__file__).parent


def rooms() -> list[str]:
    """The folders of the package, but for `commands`: these are for a shell."""
    found = {path.parent.name for path in _PACKAGE.glob("*/__init__.py")}
    return sorted(found - {"commands"})


def write_pages(app: Sphinx) -> None:
    """Writes the page of each room where it is not there yet."""
    folder = Path(app.confdir) / "rooms"
    folder.mkdir(exist_ok=True)
    pages = {folder / f"{room}.rst": room for room in rooms()}
    for page in {*folder.glob("*.rst")} - {*pages}:
        page.unlink()  # of a room that is gone
    for page, room in pages.items():
        title = f"``{room}``"
        text = f"{title}\n{'=' * len(title)}\n\n.. room:: {room}\n"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


class Room(SphinxDirective):
    """A section for each module: what it is, its classes and functions.

    Those that `crar_drake` hands out are on the page of public names.
    """

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections."""
        lines: list[str] = []
        for path in sorted((_PACKAGE / self.arguments[0]).rglob("*.py")):
            parts = path.relative_to(_PACKAGE).with_suffix("").parts
            lines += _module(path, ".".join(parts).removesuffix(".__init__"))
        return self.parse_text_to_nodes("\n".join(lines), allow_section_headings=True)


def _module(path: Path, name: str) -> list[str]:
    """The section of a module."""
    public = [key for key, at in crar_drake._MODULES.items() if at == name]
    members = [
        node.name
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef)
        and not node.name.startswith("_")
        and node.name not in public
    ]
    title = f"``{name}``"
    lines = [title, "-" * len(title), "", f".. automodule:: crar_drake.{name}"]
    # Named, because to see what else a module has takes five times as long.
    lines += [f"   :members: {', '.join(members)}"] if members else []
    if public:
        links = ", ".join(f":py:obj:`~crar_drake.{key}`" for key in public)
        lines += ["", f"Among the public names: {links}."]
    return [*lines, ""]


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("room", Room)
    app.connect("builder-inited", write_pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
