"""Meshes of any format arrive in metres, in the link's frame, the right way out."""

import numpy as np
import pytest
import trimesh
from pydrake.geometry import Box, Capsule, Mesh, Sphere
from pydrake.math import RigidTransform
from small_urdfs import joint, link, robot, write

from crar_drake.errors import ModelError
from crar_drake.robot_import.meshes import (
    Part,
    convex_hulls,
    guess_up_axis,
    link_parts,
    read_obj,
    simplified,
    write_obj,
)
from crar_drake.robot_import.source_robot import Link, Shape
from crar_drake.robot_import.source_urdf import read_urdf


def one(shape: Shape):
    (part,) = link_parts(Link("l", (shape,), (), None))
    return part


def long_box(path, up: str, size=(0.1, 0.2, 0.6)):
    """A DAE file with a box from its origin to its far corner, and what it says."""
    box = trimesh.creation.box(extents=size)
    box.apply_translation(np.array(size) / 2.0)
    box.export(path)
    text = path.read_text()
    assert "<up_axis>Y_UP</up_axis>" in text
    path.write_text(text.replace("<up_axis>Y_UP</up_axis>", up))


@pytest.mark.parametrize("way, reading", [("0 0 0.6", "z"), ("0 -0.6 0", "file")])
def test_whether_a_file_lies_is_seen_from_the_joints(tmp_path, way, reading):
    """iCub's files tell the truth, those of others do not."""
    long_box(tmp_path / "box.dae", "<up_axis>Y_UP</up_axis>")
    parts = [link("a", '<mesh filename="box.dae"/>'), link("b")]
    text = robot([*parts, joint("j", "a", "b", xyz=way)])
    guess, how = guess_up_axis(read_urdf(write(tmp_path, text)))
    assert guess == reading and "0.00 m" in how
    long_box(tmp_path / "box.dae", "<up_axis>Z_UP</up_axis>")
    assert guess_up_axis(read_urdf(write(tmp_path, text))) is None


def test_colours(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box().export(path)
    assert one(Shape(RigidTransform(), Mesh(str(path)), (1, 0, 0, 1))).rgba == (
        1,
        0,
        0,
        1,
    )
    assert one(Shape(RigidTransform(), Sphere(0.1))).rgba[3] == 1.0


def test_decimation_keeps_the_shape():
    part = one(Shape(RigidTransform(), Capsule(0.1, 0.4)))
    small = simplified(part, 300)
    assert len(small.faces) <= 330 < len(part.faces)
    np.testing.assert_allclose(
        np.ptp(small.vertices, axis=0), np.ptp(part.vertices, axis=0), rtol=0.05
    )


def test_triangles_that_share_no_vertices_are_decimated_as_one_surface():
    """As MuJoCo has those of an OBJ."""
    ball = trimesh.creation.icosphere(3)
    corners = ball.vertices[ball.faces].reshape(-1, 3)
    apart = corners, np.arange(len(corners)).reshape(-1, 3)
    small = simplified(one(Shape(RigidTransform(), apart)), 300)
    assert trimesh.Trimesh(small.vertices, small.faces).volume == pytest.approx(
        ball.volume, rel=0.05
    )


def test_obj_and_hulls(tmp_path):
    part = one(Shape(RigidTransform(), Box(1.0, 2.0, 3.0)))
    write_obj(tmp_path / "a.obj", part.vertices, part.faces)
    vertices, faces = read_obj(tmp_path / "a.obj")
    np.testing.assert_allclose(vertices[faces], part.vertices[part.faces], atol=1e-5)
    again = trimesh.load_mesh(tmp_path / "a.obj")
    assert again.volume == pytest.approx(6.0)
    (hull,) = convex_hulls([part])
    assert hull.volume == pytest.approx(6.0)


@pytest.mark.parametrize(
    "text",
    [
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1/1 2/2 3/3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 4\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 nan\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\n",
        "f 1 2 3\n",
        "# of me\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf",
        " f 1 2 3\n",
        "",
    ],
)
def test_an_obj_that_the_import_did_not_write(tmp_path, text):
    (tmp_path / "a.obj").write_text(text)
    assert read_obj(tmp_path / "a.obj") is None


def test_what_is_flat_has_no_hull():
    """Quietly: a plate that is a hair's breadth thick has a volume of rounding only."""
    corners = np.array(
        [[0.069, 0.053, 3e-13], [0.069, -0.012, 0], [0, -0.012, 0], [0, 0.053, 1e-13]]
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    plates = [Part(corners * [1, 1, thick], faces, (1.0,) * 4) for thick in (0, 1, 1e4)]
    assert convex_hulls(plates) == []


def test_unreadable_meshes_are_named(tmp_path):
    path = tmp_path / "hand.stl"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(ModelError, match="link 'l': mesh .*hand.stl"):
        one(Shape(RigidTransform(), Mesh(str(path))))


def test_an_stl_with_more_or_fewer_bytes_than_it_says(tmp_path):
    tetrahedron = trimesh.Trimesh(
        [[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0], [0.01, 0.01, 0.12]],
        [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    )
    data = trimesh.exchange.stl.export_stl(tetrahedron)
    path = tmp_path / "hand.STL"
    shape = Shape(RigidTransform(), Mesh(str(path)))
    for more in (b"", b"some bytes", b"\n" * 60):
        path.write_bytes(data + more)
        part = one(shape)
        assert len(part.faces) == 4
        np.testing.assert_allclose(np.ptp(part.vertices, axis=0), [0.03, 0.03, 0.12])
    path.write_bytes(data[:-60])
    with pytest.raises(ModelError, match="hand.STL .*cut off: 2 of 4 triangles"):
        one(shape)
    # A binary one may begin like a text, and a text may be short.
    path.write_bytes(b"solid" + data[5:])
    assert len(one(shape).faces) == 4
    path.write_text(trimesh.exchange.stl.export_stl_ascii(tetrahedron))
    assert len(one(shape).faces) == 4


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "off", "glb"])
@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_a_vertex_that_is_no_place(tmp_path, suffix, wrong):
    """It is named, and its triangles do not vanish silently."""
    path = tmp_path / f"hand.{suffix}"
    vertices = np.array([[0, 0, 0], [0, 0.03, 0], [0.01, 0.01, 0.12], [0.03, 0, 0]])
    vertices[1, 0] = wrong
    faces = [[0, 1, 3], [0, 3, 2], [3, 1, 2], [1, 0, 2]]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    with np.errstate(invalid="ignore"):
        mesh.export(path)
    with pytest.raises(ModelError, match=r"hand\.\w+.* vertex \d+ is \(.*(nan|inf)"):
        one(Shape(RigidTransform(), Mesh(str(path))))
