"""The files of an imported robot's folder."""

from dataclasses import replace
from pathlib import Path

from pydrake.common.yaml import yaml_dump_typed

from crar_drake.files import write_whole
from crar_drake.robot.description import IMPORT_FILE, RobotDescription
from crar_drake.robot_import.meshes import Part, simplified, write_obj
from crar_drake.robot_import.urdf_writer import VisualMesh

URDF, DESCRIPTION, PICTURE, REPORT = (
    "robot.urdf",
    "robot.yaml",
    "picture.png",
    "report.txt",
)

# The folder of the meshes with all their triangles, which `mesh_judge` reads.
TRIANGLES = "triangles"


def write_meshes(
    out: Path, parts: dict[str, list[Part]], faces: int
) -> tuple[dict[str, list[VisualMesh]], dict[str, list[Part]]]:
    """Returns the files that are drawn, and what is in them."""
    visuals: dict[str, list[VisualMesh]] = {}
    drawn: dict[str, list[Part]] = {name: [] for name in parts}
    for name, of_link in parts.items():
        # One budget a link: parts share it by their number of triangles.
        total = sum(len(part.faces) for part in of_link)
        safe = name.replace("/", "_")
        for index, part in enumerate(of_link):
            share = max(60, round(faces * len(part.faces) / total))
            small = simplified(part, share)
            file = f"meshes/{safe}_{index}.obj"
            write_obj(out / file, small.vertices, small.faces)
            # What is drawn is coarser than what judges.
            write_obj(triangles_file(out / file), part.vertices, part.faces)
            visuals.setdefault(name, []).append(VisualMesh(file, part.rgba))
            drawn[name].append(small)
    return visuals, drawn


def remove_old_triangles(made: Path, out: Path) -> None:
    """An earlier import's are of no use any more."""
    new = {path.name for path in made.glob(f"{TRIANGLES}/*.obj")}
    for path in out.glob(f"{TRIANGLES}/*.obj"):
        if path.name not in new:
            path.unlink()


def triangles_file(drawn: Path) -> Path:
    """Where all triangles of the mesh lie that is drawn from the file `drawn`."""
    return drawn.parent.parent / TRIANGLES / drawn.name


def write_description(out: Path, description: RobotDescription) -> None:
    written = replace(description, folder="")
    text = (
        f"# Made by crar-drake import-robot from {IMPORT_FILE}; change that one.\n"
        + yaml_dump_typed(written)
    )
    write_whole(out / DESCRIPTION, text)
