"""Sphinx: docstrings as they are written here, which is Markdown with headed lists.

    Args:
        q, v: (nq,), (nv,) the state.

becomes a list of names under "Args"; likewise every other line at the margin that ends
with a colon and has an indented line right below. The rest is Markdown: what is
indented is a formula or a drawing, and names in backticks are links where the
reference has them. The fields of a class without a list "Attributes" are told by the
comments behind them, or above them.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import re
import textwrap
from importlib import import_module
from typing import Any

from docutils import nodes
from markdown_it import MarkdownIt
from mdit_py_plugins.field_list import fieldlist_plugin
from myst_parser.mdit_to_docutils.sphinx_ import SphinxRenderer
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform
from sphinx.util.docutils import SphinxDirective

import crar_drake

# After an empty line, and with an indented one below.
_HEADING = re.compile(r"(?<![^\n]\n)^(\S.*):\n(?= )", re.M)
_ITEM = re.compile(r"^(\S[^:\n]*):(?= |\n)", re.M)
_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*$")
_COMMENTED = re.compile(r"^(?P<code>[^#]*)#:?\s*(?P<comment>.*)$")
_PARSER = MarkdownIt("commonmark", renderer_cls=SphinxRenderer).use(fieldlist_plugin)


def as_markdown(text: str) -> str:
    """A docstring as Markdown alone, with MyST's field lists.

    Args:
        text: of the docstring, its margin at the left.
    """
    parts = []
    while found := _HEADING.search(text):
        rest = text[found.end() :]
        end = re.search(r"^\S", rest, re.M)
        block = rest[: end.start()] if end else rest
        parts += [text[: found.start()], _field(found[1], textwrap.dedent(block))]
        text = rest[len(block) :]
    markdown = "".join([*parts, text])
    # Pages are named from the repository's folder.
    markdown = re.sub(r"(?<!\[)`(docs/[\w-]+\.md)`", r"[`\1`](\1)", markdown)
    return re.sub(r"\]\((?=docs/)", "](/", markdown)


def _field(heading: str, text: str) -> str:
    """What stands under a heading: a list, or prose whose colons are its own."""
    starts = [found.start() for found in _ITEM.finditer(text)]
    if heading != "Returns" and starts[:1] == [0]:
        parts = zip(starts, [*starts[1:], len(text)], strict=True)
        text = "".join(_item(text[start:end]) for start, end in parts)
    heading = "Arguments" if heading == "Args" else heading
    return f":{heading}:\n{textwrap.indent(text, '    ')}\n"


def _item(text: str) -> str:
    name, _, said = text.partition(":")
    first, _, others = said.strip().partition("\n")
    others = textwrap.indent(textwrap.dedent(others), "  ").rstrip()
    return f"- **{name}** – {first}\n" + (f"{others}\n" if others else "")


def has_fields(thing: type) -> bool:
    """Whether it is a dataclass or a NamedTuple."""
    return dataclasses.is_dataclass(thing) or hasattr(thing, "_fields")


def field_comments(source: str) -> str:
    """A list "Attributes" of the fields of a class that have a comment behind them, or
    right above.

    Args:
        source: of the class.
    """
    lines = source.splitlines()
    (definition,) = ast.parse(source).body
    said = []
    for field in definition.body:
        if isinstance(field, ast.AnnAssign):
            over = (line.strip() for line in reversed(lines[: field.lineno - 1]))
            above = [*itertools.takewhile(lambda line: line.startswith("#"), over)]
            comments = [line.lstrip("#: ") for line in reversed(above)]
            if found := _COMMENTED.match(lines[field.end_lineno - 1]):
                comments.append(found["comment"])
            if comments:
                name, first, *others = ast.unparse(field.target), *comments
                said.append(f"    {name}: {first}")
                said += [f"        {other}" for other in others]
    return "\n".join(["Attributes:", *said]) if said else ""


class Docstring(SphinxDirective):
    """`.. docstring::` with a docstring as its content."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """The docstring's nodes."""
        made = nodes.container()
        _PARSER.options["myst_config"] = self.env.myst_config
        _PARSER.options["document"] = self.state.document
        _PARSER.options["current_node"] = made
        _PARSER.render(as_markdown("\n".join(self.content)))
        for node in made.findall(nodes.literal):
            node["module"] = self.env.ref_context.get("py:module")
            node["class"] = self.env.ref_context.get("py:class")
        return made.children


class LinksToNames(SphinxTransform):
    """Makes links of the names in backticks, in all pages and docstrings."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        """Replaces the names of one document."""
        # In signatures, what is imported for type checkers alone has no module.
        for link in self.document.findall(addnodes.pending_xref):
            name = link["reftarget"]
            if link.get("refdomain") == "py" and name in crar_drake.__all__:
                link["reftarget"] = f"crar_drake.{name}"
        for node in list(self.document.findall(nodes.literal)):
            text = node.astext()
            if not _NAME.match(text) or _is_linked(node):
                continue
            in_docstring = "module" in node
            first = text.partition(".")[0]
            if first in crar_drake.__all__:
                target = f"crar_drake.{text}"
            elif first in _ROOMS and "." in text:
                target = f"crar_drake.{text}"
            elif in_docstring:
                target = text
            else:
                continue
            link = addnodes.pending_xref(
                "",
                nodes.literal("", text, classes=["xref", "py", "py-obj"]),
                refdomain="py",
                reftype="obj",
                reftarget=target,
                refdoc=self.env.docname,
                refexplicit=True,
                optional=not in_docstring,
            )
            link["py:module"] = node.get("module")
            link["py:class"] = node.get("class")
            node.replace_self(link)


_ROOMS = {module.partition(".")[0] for module in crar_drake._MODULES.values()}


def _is_linked(node: nodes.Node) -> bool:
    """Whether a node is in a link already, or where none belongs."""
    while node := node.parent:
        if isinstance(node, nodes.reference | addnodes.pending_xref | nodes.title):
            return True
    return False


def _belongs_to(
    app: Sphinx, env: BuildEnvironment, node: addnodes.pending_xref, text: nodes.Node
) -> nodes.Node | None:
    """Where a field is named, a link to its class, which tells of it."""
    if node["reftype"] != "obj":
        return None
    owner = node["reftarget"].rpartition(".")[0]
    found = owner and env.domains.python_domain.resolve_xref(
        env, node["refdoc"], app.builder, "obj", owner, node, text
    )
    # In a page, `robot.yaml` may be anything.
    return found or (text if node.get("optional") else None)


def _take_over(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Wraps a docstring, so that it is read by the directive."""
    if what == "class" and "Attributes:" not in lines and has_fields(thing):
        source = textwrap.dedent(inspect.getsource(thing))
        lines += ["", *field_comments(source).splitlines()]
    if what == "data":
        lines[:] = _comment_above(name)
    lines[:] = [".. docstring::", "", *(f"   {line}" for line in lines), ""]


def _comment_above(name: str) -> list[str]:
    """What the comment above a public value says."""
    name = name.rpartition(".")[2]
    module = import_module(f"crar_drake.{crar_drake._MODULES[name]}")
    above = re.search(rf"((?:^#.*\n)+)^{name}\b", inspect.getsource(module), re.M)
    return [line.removeprefix("#").strip() for line in above[1].splitlines()]


def _skip(
    app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any
) -> bool | None:
    """Leaves out what a NamedTuple says of its fields: their numbers."""
    if (getattr(thing, "__doc__", None) or "").startswith("Alias for field number"):
        return True
    return None


def setup(app: Sphinx) -> dict[str, Any]:
    """Called by Sphinx."""
    app.add_directive("docstring", Docstring)
    app.add_transform(LinksToNames)
    app.connect("missing-reference", _belongs_to)
    app.connect("autodoc-process-docstring", _take_over)
    app.connect("autodoc-skip-member", _skip)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
