"""What README.md and the pages in docs/ say is true: links and public names."""

import dataclasses
import importlib
import inspect
import re
from pathlib import Path

import pytest

import crar_drake

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
REFERENCE = ROOT / "docs" / "site" / "reference.rst"
PAGES = [
    README,
    *sorted((ROOT / "docs").glob("**/*.md")),
    *sorted((ROOT / "models").glob("**/README.md")),
    *sorted((ROOT / "diagrams").glob("*.md")),
]


def prose(page: Path) -> str:
    """A page without its fenced code."""
    return re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    """What a link can point to: the headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.M)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.strip().replace(" ", "-") for heading in plain}


def links(page: Path) -> list[str]:
    text = re.sub(r"`[^`\n]*`", "`", prose(page))
    return re.findall(r"\]\(\s*([^)\s]+)\s*\)", text)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_relative_link_resolves(page):
    for link in links(page):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert target.is_relative_to(ROOT), link
        if anchor:
            assert anchor in anchors(target), link


# --- the public names -------------------------------------------------------------


@pytest.mark.parametrize("name", crar_drake.__all__)
def test_every_public_name_is_documented(name):
    """In its docstring, with every field and method; and on the page of them all."""
    assert re.search(rf"\b{name}\b", REFERENCE.read_text("utf-8"))
    thing = getattr(crar_drake, name)
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        source = inspect.getsource(
            importlib.import_module(f"crar_drake.{crar_drake._MODULES[name]}")
        )
        assert re.search(rf"^# .+\n{name}\b", source, re.M), "a comment says what it is"
        return
    # A dataclass without a docstring gets its signature for one.
    assert thing.__doc__ and not thing.__doc__.startswith(f"{name}(")
    if inspect.isfunction(thing):
        for parameter in inspect.signature(thing).parameters:
            assert re.search(rf"\b{parameter}\b", thing.__doc__), parameter
        return
    inherited = "\n".join(each.__doc__ or "" for each in thing.__mro__[:-1])
    for field in dataclasses.fields(thing) if dataclasses.is_dataclass(thing) else ():
        assert re.search(rf"\b{field.name}\b", inherited), field.name
    for method, member in vars(thing).items():
        member = getattr(member, "__func__", getattr(member, "fget", None) or member)
        if inspect.isfunction(member) and not method.startswith("_"):
            assert member.__doc__, f"{name}.{method}"
