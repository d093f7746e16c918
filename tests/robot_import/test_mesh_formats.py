"""Every mesh format arrives where Drake has it: its own convex hull of the same file.

Of formats that Drake takes no hull of, the file is made from the OBJ that it does.
"""

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Convex, Mesh
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull
from small_urdfs import joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot_import import import_robot
from crar_drake.robot_import.link_meshes import read_link_meshes
from crar_drake.robot_import.link_outlines import link_outlines
from crar_drake.robot_import.meshes import Part, link_parts, write_obj
from crar_drake.robot_import.source_robot import Link, Shape

SCALES = [(1, 1, 1), (2, 0.5, 3), (-1, 1, 1), (1, -2, 0.5), (-1, -2, -3)]
# No two of its extents are alike, nor is it its own image in any plane.
CORNERS = np.array([[0.1, 0, 0], [0.9, 0.1, 0], [0.2, 2, 0.3], [0, 0.2, 3.1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
NESTED = [
    {
        "children": [1],
        "rotation": [0.5, 0.5, 0.5, 0.5],
        "translation": [1.0, 2.0, 3.0],
    },
    {"mesh": 0, "scale": [1.0, 2.0, -3.0], "children": [2]},
    {
        "mesh": 0,
        "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 4.0, 5.0, 6.0, 1],
    },
]


def hull_of_drake(path: Path, scale=(1, 1, 1)) -> np.ndarray:
    hull = Convex(str(path), np.array(scale, dtype=float)).GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])


def read(path: Path, scale=(1, 1, 1), up_axis: str = "z") -> list[Part]:
    shape = Shape(RigidTransform(), Mesh(str(path), scale))
    return link_parts(Link("l", (shape,), (), None), up_axis)


def assert_same_hull(parts: list[Part], expected: np.ndarray) -> None:
    """The corners of both hulls are the same points, and triangles face outwards."""
    vertices = np.concatenate([part.vertices for part in parts])
    ours, theirs = vertices[ConvexHull(vertices).vertices], expected
    apart = np.linalg.norm(ours[:, np.newaxis] - theirs, axis=2)
    assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 2e-5
    assert all(trimesh.Trimesh(p.vertices, p.faces).volume > 0.0 for p in parts)


def gltf_content(nodes=None, **primitive) -> tuple[dict, bytes]:
    """A glTF's JSON and its buffer."""
    points, indices = CORNERS.astype("<f4"), FACES.astype("<u2")
    buffer = points.tobytes() + indices.tobytes()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": nodes or [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **primitive}]}
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(points),
                "type": "VEC3",
                "min": points.min(axis=0).tolist(),
                "max": points.max(axis=0).tolist(),
            },
            {
                "bufferView": 1,
                "componentType": 5123,
                "count": indices.size,
                "type": "SCALAR",
            },
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": indices.nbytes},
        ],
        "buffers": [{"byteLength": len(buffer)}],
    }, buffer


def write_gltf(path: Path, content: dict, buffer: bytes) -> Path:
    content = json.loads(json.dumps(content))
    if path.suffix.lower() == ".glb":
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        data = struct.pack("<I4s", len(text), b"JSON") + text
        data += struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(data)) + data)
        return path
    encoded = base64.b64encode(buffer).decode()
    uri = f"data:application/octet-stream;base64,{encoded}"
    content["buffers"][0]["uri"] = uri
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".off", ".dae"])
def test_formats_that_have_no_up_of_their_own(tmp_path, suffix, scale):
    write_obj(tmp_path / "a.obj", CORNERS, FACES)
    path = tmp_path / f"a{suffix}"
    if suffix != ".obj":
        trimesh.Trimesh(CORNERS, FACES).export(path)
    assert_same_hull(read(path, scale), hull_of_drake(tmp_path / "a.obj", scale))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("nodes", [None, NESTED], ids=["plain", "nested"])
@pytest.mark.parametrize("suffix", [".gltf", ".glb", ".GLTF"])
def test_gltf_has_y_up(tmp_path, suffix, nodes, scale):
    """Whatever an import says of DAE files, and with what its nodes do to meshes."""
    content, buffer = gltf_content(nodes)
    expected = hull_of_drake(
        write_gltf(tmp_path / "drake.gltf", content, buffer), scale
    )
    path = write_gltf(tmp_path / f"a{suffix}", content, buffer)
    for up_axis in ("z", "file"):
        assert_same_hull(read(path, scale, up_axis), expected)


def test_the_buffers_of_a_gltf_may_be_files(tmp_path):
    content, buffer = gltf_content()
    (tmp_path / "a.bin").write_bytes(buffer)
    content["buffers"][0]["uri"] = "a.bin"
    (tmp_path / "a.gltf").write_text(json.dumps(content))
    assert_same_hull(read(tmp_path / "a.gltf"), hull_of_drake(tmp_path / "a.gltf"))
    (tmp_path / "a.bin").unlink()
    with pytest.raises(ModelError, match="link 'l': mesh .*a.gltf cannot be read"):
        read(tmp_path / "a.gltf")


@pytest.mark.parametrize("suffix", [".gltf", ".glb"])
@pytest.mark.parametrize(
    "said, change",
    [
        ("KHR_draco_mesh_compression", "draco"),
        ("KHR_mesh_quantization", "quantization"),
        ("sparse accessors", "sparse"),
        ("triangle fans", "fan"),
    ],
)
def test_what_of_gltf_is_not_read_is_refused(tmp_path, suffix, said, change):
    """trimesh reads zeros, another size, or nothing, without a word."""
    content, buffer = gltf_content(**({"mode": 6} if change == "fan" else {}))
    if change in ("draco", "quantization"):
        content["extensionsRequired"] = [said, "KHR_texture_transform"]
    if change == "sparse":
        content["accessors"][0]["sparse"] = {"count": 1}
    path = write_gltf(tmp_path / f"a{suffix}", content, buffer)
    with pytest.raises(ModelError, match=f"link 'l': mesh .*{said}.*OBJ"):
        read(path)


@pytest.mark.parametrize(
    "axis, said",
    [
        ("X", "<up_axis> X_UP</up_axis>"),
        ("Y", "<up_axis>Y_UP</up_axis>"),
        ("Z", "<up_axis>Z_UP</up_axis>"),
        ("Y", ""),  # as COLLADA has it
    ],
)
@pytest.mark.parametrize("scale", [(1, 1, 1), (1, -2, 0.5)])
def test_a_collada_file_in_closed_form(tmp_path, axis, said, scale):
    """Its nodes, its unit, what it says is up, and then the scale."""
    path = tmp_path / "a.dae"
    trimesh.Trimesh(CORNERS, FACES).export(path)
    text = path.read_text()
    assert "<up_axis>Y_UP</up_axis>" in text
    text = text.replace("<up_axis>Y_UP</up_axis>", said)
    text = text.replace("</asset>", '<unit name="inch" meter="0.0254"/></asset>')
    head, node, rest = text.partition("<instance_geometry")
    assert node
    moved = "<translate>7 8 9</translate><rotate>0 0 1 90</rotate>"
    inner = f"{head}<node>{moved}{node}{rest}"
    path.write_text(
        inner.replace("</instance_geometry>", "</instance_geometry></node>")
    )
    points = (CORNERS[:, [1, 0, 2]] * [-1, 1, 1] + [7, 8, 9]) * 0.0254
    turned = {
        "X": points[:, [1, 2, 0]] * [-1, -1, 1],
        "Y": points[:, [0, 2, 1]] * [1, -1, 1],
        "Z": points,
    }
    assert_same_hull(read(path, scale), points * scale)
    assert_same_hull(read(path, scale, "file"), turned[axis] * scale)


def test_the_judge_and_the_outline_read_what_drake_has(tmp_path):
    """Of a robot that nobody imported, which has glTF meshes itself."""
    path = write_gltf(tmp_path / "a.gltf", *gltf_content(NESTED))
    text = robot([link("a", f'<mesh filename="{path}" scale="1 -2 0.5"/>')])
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    Parser(plant).AddModels(str(write(tmp_path, text)))
    plant.Finalize()
    expected = hull_of_drake(path, (1, -2, 0.5))
    (mesh,) = read_link_meshes(plant, scene_graph)
    assert_same_hull(mesh.parts, expected)
    outline = link_outlines(plant, scene_graph)["a"].points
    apart = np.linalg.norm(outline[:, np.newaxis] - expected, axis=2)
    assert apart.min(axis=0).max() < 1e-9


def test_an_import_has_its_shapes_where_drake_has_the_gltf(tmp_path):
    """Capsules, what is drawn and what is judged, of a mesh that is not at the link's
    origin."""
    content, buffer = gltf_content(NESTED)
    path = write_gltf(tmp_path / "a.gltf", content, buffer)
    mesh = f'<mesh filename="{path.name}" scale="0.02 0.03 0.04"/>'
    text = robot([link("a", mesh), link("b", mesh), joint("j", "a", "b", xyz="0 0 1")])
    urdf = write(tmp_path, text)
    choices = {"base": "fixed", "pairs": [], "facing": "+x"}
    report = import_robot(urdf, tmp_path / "out", **choices)
    expected = hull_of_drake(path, (0.02, 0.03, 0.04))
    for capsule_of in ("a", "b"):
        fit = report.fits[capsule_of]
        d = np.min([c.distance(expected) for c in fit.capsules], axis=0)
        assert d.max() < 5e-3
    for folder in ("meshes", "triangles"):
        drawn = trimesh.load_mesh(tmp_path / "out" / folder / "a_0.obj")
        assert_same_hull([Part(drawn.vertices, drawn.faces, (1,) * 4)], expected)


@pytest.mark.parametrize("suffix", [".obj", ".gltf"])
def test_in_a_pose(tmp_path, suffix):
    """The shape's pose in its link comes last."""
    if suffix == ".obj":
        write_obj(tmp_path / "a.obj", CORNERS, FACES)
    else:
        write_gltf(tmp_path / "a.gltf", *gltf_content())
    X = RigidTransform(RollPitchYaw(0.3, -0.5, 0.8), [1.0, 2.0, 3.0])
    shape = Shape(X, Mesh(str(tmp_path / f"a{suffix}"), [1.0, -2.0, 0.5]))
    expected = hull_of_drake(tmp_path / f"a{suffix}", (1, -2, 0.5))
    assert_same_hull(
        link_parts(Link("l", (shape,), (), None)), X.multiply(expected.T).T
    )
