"""Imports run downward: no room imports one that imports it."""

import ast
import runpy
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
PACKAGE = DOCS.parent / "crar_drake"
DRAWN = runpy.run_path(str(DOCS / "make_rooms.py"))


@cache
def counted() -> Counter:
    return DRAWN["count_imports"]()


@cache
def imports_of_files() -> dict[Path, list[ast.ImportFrom]]:
    """Of each file of the package, those in functions, too."""
    return {
        path: [
            node
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) and node.module
        ]
        for path in PACKAGE.rglob("*.py")
    }


def test_no_room_imports_one_that_imports_it():
    imports = counted()
    below: dict[str, set[str]] = {}
    for room, imported in imports:
        below.setdefault(room, set()).add(imported)
    order = list(TopologicalSorter(below).static_order())  # CycleError names a cycle
    assert order[-1] == "commands"
    assert set(order) - set(below) == {"equations", "motion"}  # import no other room


def test_no_file_imports_one_that_imports_it():
    """Nor where the import stands in a function, or is for types alone."""
    root = DOCS.parent
    names = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        for path in imports_of_files()
    }
    imports: dict[str, set[str]] = {}
    for path, nodes in imports_of_files().items():
        parts = path.relative_to(root).with_suffix("").parts
        own = ".".join(parts).removesuffix(".__init__")
        found = imports.setdefault(own, set())
        for node in nodes:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in names else node.module)
        found &= names - {own}
    TopologicalSorter(imports).prepare()  # CycleError names a circle


def test_no_layer_imports_a_higher_one():
    """Modules beside the rooms count, too; all but `run` belong to no layer."""
    layers = DRAWN["LAYERS"].values()
    rank = {room: i for i, rooms in enumerate(layers) for room in rooms}
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert rooms <= set(rank) | {"models", "diagrams"}
    upward = []
    for path, nodes in imports_of_files().items():
        own = path.relative_to(PACKAGE).with_suffix("").parts[0]
        # The package's face shows names of all layers.
        below = rank.get(own, 9 if own in ("__init__", "__main__") else -1)
        for node in nodes:
            first, *inside = node.module.split(".")
            if first == PACKAGE.name:
                room = inside[0] if inside else "__init__"
                if rank.get(room, 9 if room == "__init__" else -1) > below:
                    upward.append(f"{path.relative_to(PACKAGE)}: {node.module}")
    assert upward == []


def test_the_picture_is_of_these_rooms():
    drawn = (DOCS / "images" / "rooms.svg").read_text(encoding="utf-8")
    for room, imported in counted():
        assert f"{room}&#45;&gt;{imported}" in drawn, "run python docs/make_rooms.py"
