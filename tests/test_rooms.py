"""Imports run downward: no room imports one that imports it."""

import ast
import runpy
from graphlib import TopologicalSorter
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"


def test_no_room_imports_one_that_imports_it():
    imports = runpy.run_path(str(DOCS / "make_rooms.py"))["count_imports"]()
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
        for path in (root / "crar_drake").rglob("*.py")
    }
    imports: dict[str, set[str]] = {}
    for path in (root / "crar_drake").rglob("*.py"):
        parts = path.relative_to(root).with_suffix("").parts
        own = ".".join(parts).removesuffix(".__init__")
        found = imports.setdefault(own, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    found.add(inner if inner in names else node.module)
        found &= names - {own}
    TopologicalSorter(imports).prepare()  # CycleError names a circle


def test_no_layer_imports_a_higher_one():
    """Modules beside the rooms count, too; all but `run` belong to no layer."""
    layers = runpy.run_path(str(DOCS / "make_rooms.py"))["LAYERS"]
    rank = {room: i for i, rooms in enumerate(layers.values()) for room in rooms}
    package = DOCS.parent / "crar_drake"
    rooms = {path.parent.name for path in package.glob("*/__init__.py")}
    assert rooms <= set(rank) | {"models", "diagrams"}
    upward = []
    for path in package.rglob("*.py"):
        own = path.relative_to(package).with_suffix("").parts[0]
        # The package's face shows names of all layers.
        below = rank.get(own, 9 if own in ("__init__", "__main__") else -1)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module:
                first, *inside = node.module.split(".")
                if first == package.name:
                    room = inside[0] if inside else "__init__"
                    if rank.get(room, 9 if room == "__init__" else -1) > below:
                        upward.append(f"{path.relative_to(package)}: {node.module}")
    assert upward == []


def test_the_picture_is_of_these_rooms():
    drawn = (DOCS / "images" / "rooms.svg").read_text(encoding="utf-8")
    imports = runpy.run_path(str(DOCS / "make_rooms.py"))["count_imports"]()
    for room, imported in imports:
        assert f"{room}&#45;&gt;{imported}" in drawn, "run python docs/make_rooms.py"
