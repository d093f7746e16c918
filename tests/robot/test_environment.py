"""Meshes that stand in the world: their pieces, their formats, and what is refused."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from small_robots import chain_urdf

from crar_drake.errors import ModelError
from crar_drake.judging.mesh_distance import TriangleMesh
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.environment import convex_pieces
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task
from crar_drake.robot_import.link_meshes import has_meshes, read_link_meshes

CUBE = np.indices((2, 2, 2)).reshape(3, -1).T - 0.5


def triangles(points: np.ndarray) -> np.ndarray:
    """(F, 3) faces of a hull, outward."""
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    for face, plane in zip(faces, hull.equations, strict=True):
        a, b, c = points[face]
        if np.cross(b - a, c - a) @ plane[:3] < 0.0:
            face[1:] = face[:0:-1]
    return faces


def obj(*solids: np.ndarray) -> str:
    lines, first = [], 1
    for points in solids:
        lines += [f"v {x} {y} {z}" for x, y, z in points]
        lines += [f"f {a} {b} {c}" for a, b, c in triangles(points) + first]
        first += len(points)
    return "\n".join(lines)


def stl(*solids: np.ndarray) -> bytes:
    meshes = [trimesh.Trimesh(points, triangles(points)) for points in solids]
    return trimesh.exchange.stl.export_stl(trimesh.util.concatenate(meshes))


def same_points(found: np.ndarray, expected: np.ndarray) -> bool:
    far = np.linalg.norm(found[:, None] - expected, axis=2)
    return len(found) == len(expected) and far.min(axis=1).max() < 1e-6


TWO = CUBE * [0.4, 0.6, 0.02], CUBE * [0.02, 0.6, 0.3] + [0.5, 0.1, 0.2]


@pytest.mark.parametrize("suffix", ["obj", "stl"])
def test_each_connected_piece_is_a_hull(tmp_path, suffix):
    path = tmp_path / f"table.{suffix}"
    if suffix == "obj":
        path.write_text(obj(*TWO))
    else:
        path.write_bytes(stl(*TWO))
    pieces = sorted(convex_pieces(path, 2.0), key=lambda p: p[:, 0].mean())
    assert len(pieces) == 2
    for found, expected in zip(pieces, TWO, strict=True):
        assert same_points(found, 2.0 * expected)


def test_a_gltf_file_has_y_up(tmp_path):
    path = tmp_path / "board.glb"
    turned = TWO[1] @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, z, -y)
    trimesh.Trimesh(turned, triangles(TWO[1])).export(path)
    (found,) = convex_pieces(path)
    assert same_points(found, TWO[1])


def test_pieces_of_an_obj_file_may_share_places(tmp_path):
    """Boards that touch at a face are pieces of their own."""
    path = tmp_path / "boards.obj"
    path.write_text(obj(CUBE, CUBE + [1.0, 0.0, 0.0], CUBE + [1.0, 1.0, 0.0]))
    assert len(convex_pieces(path)) == 3


def hollow() -> str:
    """An L of one piece: a square prism of which a quarter is cut out."""
    base = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in base]
    fans = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(a, c, b) for a, b, c in fans]
    faces += [(a + 6, b + 6, c + 6) for a, b, c in fans]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, j + 6), (i, j + 6, i + 6)]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    return "\n".join(lines)


def test_a_piece_that_is_not_convex_is_refused_unless_its_hull_is_meant(tmp_path):
    path = tmp_path / "corner.obj"
    path.write_text(hollow())
    with pytest.raises(ModelError, match=r"corner.obj: piece 1 of 1 is not convex"):
        convex_pieces(path)
    with pytest.raises(ModelError, match=r"at least 333 mm beyond.*hull: true"):
        convex_pieces(path)
    (corners,) = convex_pieces(path, hull=True)
    assert len(corners) == 10


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("none.obj", None, "there is no such mesh file"),
        ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "flat.*thickness"),
        ("empty.obj", b"", "cannot be read"),
        ("odd.dae", b"<x/>", r"read from .obj, .stl"),
        ("short.stl", stl(CUBE)[:-60], "cut off: 10 of 12 triangles"),
        ("wrong.glb", b"glTF no", "cannot be read"),
        (
            "packed.gltf",
            b'{"extensionsRequired": ["KHR_draco_mesh_compression"]}',
            "KHR_draco_mesh_compression, which are not read",
        ),
    ],
)
def test_files_that_are_refused(tmp_path, name, data, message):
    path = tmp_path / name
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(ModelError, match=message) as caught:
        convex_pieces(path)
    assert name in str(caught.value)


def described(folder, **changes) -> str:
    text = chain_urdf("zyz", extra="")
    (folder / "chain.urdf").write_text(text)
    (folder / "table.obj").write_text(obj(*TWO))
    lines = {
        "name": "chain",
        "model": "chain.urdf",
        "base": "base",
        "environment": "{table: {meshes: [table.obj], xyz: [0.2, 0.5, -0.3], "
        "rpy: [0.0, 0.0, 0.4]}}",
        "pairs": "[[l1, table], [l2, table]]",
    } | changes
    (folder / "robot.yaml").write_text(
        "\n".join(f"{key}: {value}" for key, value in lines.items())
    )
    return str(folder)


def test_distances_to_a_mesh_are_drakes_to_boxes_in_its_place(tmp_path):
    robot = load_robot_description(described(tmp_path))
    model = ControlModel.FromDescription(robot, [Task(frame="tip")])
    assert len(model.pairs.pair_of_shapes) == 4
    boxes = "".join(
        f"<collision name='c{k}'><origin xyz='{x} {y} {z}'/><geometry><box size='{s}'/>"
        "</geometry></collision>"
        for k, (s, (x, y, z)) in enumerate(
            [("0.4 0.6 0.02", (0, 0, 0)), ("0.02 0.6 0.3", (0.5, 0.1, 0.2))]
        )
    )
    there = tmp_path / "boxes"
    there.mkdir()
    described(there, environment="{}")
    text = chain_urdf("zyz", extra="").replace(
        "</robot>",
        f"<link name='table'>{boxes}</link><joint name='w' type='fixed'>"
        "<origin xyz='0.2 0.5 -0.3' rpy='0 0 0.4'/><parent link='base'/>"
        "<child link='table'/></joint></robot>",
    )
    (there / "chain.urdf").write_text(text)
    other = ControlModel.FromDescription(
        load_robot_description(str(there)), [Task(frame="tip")]
    )
    rng = np.random.default_rng(1)
    apart = 0
    for _ in range(40):
        q = rng.uniform(-2.0, 2.0, 3)
        a, b = (m.evaluate(m.MakeWorkspace(), q, 0 * q) for m in (model, other))
        outside = b.d > 1e-3
        np.testing.assert_allclose(a.d[outside], b.d[outside], atol=1e-5)
        np.testing.assert_allclose(a.dd_dq[outside], b.dd_dq[outside], atol=5e-3)
        apart += outside.sum()
    assert apart > 40


def test_what_judges_meshes_reads_the_pieces(tmp_path):
    """As closed triangles, outward; nothing of them is in a file."""
    robot = load_robot_description(described(tmp_path))
    model = ControlModel.FromDescription(robot, [])
    assert not has_meshes(model.plant, model.scene_graph)
    of_links = read_link_meshes(model.plant, model.scene_graph)
    (table,) = (mesh for mesh in of_links if mesh.name == "table")
    assert len(table.parts) == 2
    for part, expected in zip(table.parts, TWO, strict=True):
        assert TriangleMesh(part.vertices, part.faces).is_closed
        a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0
        assert volume == pytest.approx(np.ptp(expected, axis=0).prod())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": "[[l0, l2]]"}, r"environment: table: no pair names it"),
        ({"environment": "{table: {meshes: []}}"}, "meshes: there is none"),
        (
            {"environment": "{table: {meshes: [table.obj], scale: 0.0}}"},
            "scale: 0.0 must be",
        ),
        (
            {"environment": "{table: {meshes: [table.obj], xyz: [1.0]}}"},
            "xyz.*three finite numbers",
        ),
        (
            {"environment": "{table: {meshes: [absent.obj]}}"},
            r"absent.obj: there is no such mesh file",
        ),
        (
            {
                "environment": "{l2: {meshes: [table.obj]}}",
                "pairs": "[[l0, l2]]",
            },
            "l2: there is a link of that name already",
        ),
        ({"environment": "{table: {mesh: table.obj}}"}, "mesh"),
    ],
)
def test_descriptions_that_are_refused(tmp_path, changes, message):
    folder = described(tmp_path, **changes)
    with pytest.raises(ModelError, match=message):
        ControlModel.FromDescription(load_robot_description(folder), [])
