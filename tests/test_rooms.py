"""Imports run downward: no room imports one that imports it."""

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


def test_the_picture_is_of_these_rooms():
    drawn = (DOCS / "images" / "rooms.svg").read_text(encoding="utf-8")
    imports = runpy.run_path(str(DOCS / "make_rooms.py"))["count_imports"]()
    for room, imported in imports:
        assert f"{room}&#45;&gt;{imported}" in drawn, "run python docs/make_rooms.py"
