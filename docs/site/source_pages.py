"""Sphinx: links of a page to source files and folders lead to pages that show them.

On GitHub `[the law](../crar_drake/control/law.py)` opens the file, and
`[examples](examples)` lists the folder. Here a linked file gets a page with its
highlighted text, and a linked folder the page of its README, or else a list of its
files. Pictures and data are copied, as Sphinx does by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform

_PAGES = "source"  # the folder of these pages in the site
# What has a page: the suffix, and the language it is written in.
_LANGUAGES = {".py": "python", ".yaml": "yaml"}


class LinksToSources(SphinxTransform):
    """Turns links to files that are no pages into links to the pages made here."""

    default_priority = 5  # before Sphinx notes what is to be copied

    def apply(self, **kwargs: Any) -> None:
        """Replaces the links of one document."""
        for node in list(self.document.findall(_is_link)):
            _, absolute = self.env.relfn2path(node["reftarget"], self.env.docname)
            path = Path(absolute)
            if not path.is_relative_to(self.env.srcdir):
                continue
            name = path.relative_to(self.env.srcdir).as_posix()
            if (path / "README.md").exists():
                page = f"{name}/README"
            elif path.is_dir() or (path.is_file() and path.suffix in _LANGUAGES):
                page = f"{_PAGES}/{name}"
                _linked(self.env).setdefault(self.env.docname, set()).add(name)
            else:
                continue
            node.replace_self(
                nodes.reference("", "", *node.children, internal=True, page=page)
            )


def _is_link(node: nodes.Node) -> bool:
    """Whether it is a Markdown link to something that is no page."""
    return (
        isinstance(node, addnodes.download_reference | addnodes.pending_xref)
        and node.get("reftype") == "myst"
        and node.get("refdomain") is None
    )


def _linked(env: BuildEnvironment) -> dict[str, set[str]]:
    """Page to the files and folders that it links to."""
    if not hasattr(env, "linked_sources"):
        env.linked_sources = {}
    return env.linked_sources


def _forget(app: Sphinx, env: BuildEnvironment, docname: str) -> None:
    """A page is read anew."""
    _linked(env).pop(docname, None)


def _merge(
    app: Sphinx, env: BuildEnvironment, docnames: set[str], other: BuildEnvironment
) -> None:
    """Pages were read in another process."""
    _linked(env).update(_linked(other))


def _address(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Writes the addresses, relative to the page that links."""
    for node in doctree.findall(nodes.reference):
        if "page" in node:
            node["refuri"] = app.builder.get_relative_uri(docname, node["page"])


def _pages(app: Sphinx) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The pages made here: name, context and template of each."""
    root = Path(app.srcdir)
    names = set().union(*_linked(app.env).values())
    listed = {name: _shown(root / name) for name in names if (root / name).is_dir()}
    names |= {
        f"{folder}/{file}"
        for folder, files in listed.items()
        for file in files
        if Path(file).suffix in _LANGUAGES
    }
    for name in sorted(names):
        page = f"{_PAGES}/{name}"
        if name in listed:
            body = _list(app, page, name, listed[name])
        else:
            text = (root / name).read_text(encoding="utf-8")
            language = _LANGUAGES[Path(name).suffix]
            body = app.builder.highlighter.highlight_block(text, language)
        heading = f"<h1><code>{escape(name)}</code></h1>"
        yield page, {"title": name, "body": heading + body}, "page.html"


def _shown(folder: Path) -> list[str]:
    """The files of a folder that its page lists."""
    suffixes = {*_LANGUAGES, ".ipynb"}
    return sorted(path.name for path in folder.iterdir() if path.suffix in suffixes)


def _list(app: Sphinx, page: str, folder: str, files: list[str]) -> str:
    """A list of links to the files of a folder; a notebook is a page of its own."""
    items = []
    for file in files:
        is_notebook = Path(file).suffix not in _LANGUAGES
        page_of_it = f"{folder}/{Path(file).stem}"
        target = page_of_it if is_notebook else f"{_PAGES}/{folder}/{file}"
        address = app.builder.get_relative_uri(page, target)
        items.append(f'<li><a href="{escape(address)}">{escape(file)}</a></li>')
    return f"<ul>{''.join(items)}</ul>"


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_transform(LinksToSources)
    app.connect("env-purge-doc", _forget)
    app.connect("env-merge-info", _merge)
    app.connect("doctree-resolved", _address)
    app.connect("html-collect-pages", _pages)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
