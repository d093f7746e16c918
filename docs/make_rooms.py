"""Draws which room of the package imports which: `images/rooms.svg` (needs Graphviz).

    python docs/make_rooms.py

A room is a folder of `crar_drake`; what lies beside the folders is left out. An arrow
points from a room to one that it imports, with the number of such imports. Rooms are in
three layers, each of which does without those above it.
"""

import ast
import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "crar_drake"

# Layer to its rooms, the lowest first. `run` is a module beside them.
LAYERS = {
    "the law": ("equations", "robot", "control"),
    "motions": (
        *("motion", "targets", "robot_import", "judging", "trajectory", "references"),
    ),
    "runs": (
        *("simulation", "results", "run", "play", "teleoperation"),
        "commands",
    ),
}


def count_imports() -> Counter:
    """How often the files of one room import from another: (room, imported room)."""
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    imports: Counter = Counter()
    for room in rooms:
        for path in (PACKAGE / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module:
                    parts = node.module.split(".")
                    if parts[0] == PACKAGE.name and len(parts) > 1:
                        imports[room, parts[1]] += parts[1] in rooms - {room}
    return +imports


def draw_rooms(target: Path) -> None:
    dot = ["digraph { node [shape=box fontname=sans] edge [fontname=sans fontsize=9]"]
    for number, (layer, rooms) in enumerate(LAYERS.items()):
        inside = "; ".join(room for room in rooms if (PACKAGE / room).is_dir())
        dot.append(
            f'subgraph cluster_{number} {{ label="{layer}" fontname=sans '
            f"style=dashed; {inside} }}"
        )
    dot += [
        f'{room} -> {imported} [label="{number}"]'
        for (room, imported), number in sorted(count_imports().items())
    ]
    command = ["dot", "-Tsvg", "-o", target]
    subprocess.run(command, input="\n".join([*dot, "}"]).encode(), check=True)


if __name__ == "__main__":
    draw_rooms(ROOT / "docs" / "images" / "rooms.svg")
