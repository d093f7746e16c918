"""Links in each other's way are fitted closer; both sides of a robot alike."""

import itertools
import json

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform
from small_urdfs import humanoid_with_legs, joint, link, robot, write

from crar_drake.law.capsule_distances import capsule_distances
from crar_drake.robot.description import import_file
from crar_drake.robot_import import import_robot, link_fits, load_choices
from crar_drake.robot_import.anatomy import link_twins
from crar_drake.robot_import.capsule_fitting import TOLERANCE
from crar_drake.robot_import.link_fits import FitCache, LinkFits
from crar_drake.robot_import.meshes import Part, Surfaces, write_obj
from crar_drake.robot_import.source_urdf import read_urdf


def plates(folder, apart: float):
    """Two plates, one above the other, with a ball and two joints between."""
    plate = '<box size="0.3 0.3 0.02"/>'
    text = robot(
        [
            link("lower", plate),
            link("ball", '<sphere radius="0.005"/>'),
            joint("turn", "lower", "ball", "0 0 1", f"0 0 {apart / 2.0}"),
            link("upper", plate),
            joint("twist", "ball", "upper", "0 0 1", f"0 0 {apart / 2.0}"),
        ]
    )
    return write(folder, text)


def gap(report, heights: dict[str, float]) -> float:
    """Of two links' capsules, moved up [m]."""
    shapes = []
    for name, height in heights.items():
        up = np.array([0.0, 0.0, height])
        shapes.append(
            [(c.p_L0 + up, c.p_L1 + up, c.radius) for c in report.fits[name].capsules]
        )
    together = (a + b for a, b in itertools.product(*shapes))
    rows = [np.array(each) for each in zip(*together, strict=True)]
    return float(capsule_distances(*rows)[0].min())


def test_capsules_that_meet_where_meshes_are_apart_are_fitted_closer(tmp_path):
    """Faces 40 mm apart, which 20 mm of each plate's capsules fill."""
    choices = {"base": "fixed", "facing": "+x", "most_capsules": 32}
    report = import_robot(plates(tmp_path, 0.06), tmp_path / "out", **choices)
    assert report.choices.pairs == [["lower", "upper"]]
    assert gap(report, {"lower": 0.0, "upper": 0.06}) >= 5e-3
    excess = {name: report.fits[name].excess for name in ("lower", "upper")}
    assert min(excess.values()) <= 0.01 + 1e-6
    for fit in report.fits.values():
        assert fit.farthest <= TOLERANCE
    assert any("fitted more closely" in note for note in report.notes)
    assert not any("NOT watched" in warning for warning in report.warnings)


def test_what_is_built_closely_is_left_as_it_is(tmp_path):
    """Faces that are 2 mm apart: no fit would part them."""
    source, out = plates(tmp_path, 0.022), tmp_path / "out"
    report = import_robot(source, out, base="fixed", facing="+x")
    assert not any("fitted more closely" in note for note in report.notes)
    assert report.choices.pairs == []


def test_surfaces_are_as_far_apart_as_their_triangles():
    """Also where vertices are far away: the middles of two large faces."""
    box = trimesh.creation.box(extents=(1.0, 1.0, 0.1))
    part = Part(np.asarray(box.vertices), np.asarray(box.faces), (1,) * 4)
    surfaces = Surfaces({"a": [part], "b": [part]})
    poses = {"a": RigidTransform(), "b": RigidTransform([0.9, 0.0, 0.13])}
    assert surfaces.gap(poses, "a", "b") == pytest.approx(0.03)
    poses["b"] = RigidTransform([0.9, 0.0, 0.05])
    assert surfaces.gap(poses, "a", "b") == 0.0


def leaning(turned: bool) -> Part:
    """A link that is no mirror image of itself, or its image, other triangles."""
    mesh = trimesh.util.concatenate(
        [
            trimesh.creation.box(extents=(0.08, 0.06, 0.3)),
            trimesh.creation.icosphere(2, 0.05).apply_translation([0.06, 0.05, 0.1]),
        ]
    )
    if turned:
        mesh = mesh.subdivide()
        mesh.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    return Part(np.asarray(mesh.vertices), np.asarray(mesh.faces), (1,) * 4)


def test_a_link_and_its_image_have_each_others_capsules(tmp_path):
    """Though their triangles differ, and the frame of one is turned."""
    parts = [link("base")]
    for side, y, rpy in (("left", 1, "0 0 0"), ("right", -1, "0 0 1.2")):
        parts += [
            link(f"{side}_arm"),
            joint(side, "base", f"{side}_arm", xyz=f"0 {0.3 * y} 0").replace(
                "<origin", f'<origin rpy="{rpy}"'
            ),
        ]
    read = read_urdf(write(tmp_path, robot(parts)))
    X = {name: pose.rotation().matrix() for name, pose in read.poses().items()}
    left, right = leaning(False), leaning(True)
    right = Part(right.vertices @ X["right_arm"], right.faces, right.rgba)
    segments = {"left_arm": [left], "right_arm": [right]}
    twins = {"left_arm": "right_arm", "right_arm": "left_arm"}
    cache = FitCache(tmp_path / "fits.json")
    fits = LinkFits(read, segments, twins, cache).fit(segments, 0.015, 16)
    mirror = np.diag([1.0, -1.0, 1.0])
    pairs = zip(*(fits[name].capsules for name in segments), strict=True)
    for a, b in pairs:
        for end in ("p_L0", "p_L1"):
            image = mirror @ X["left_arm"] @ getattr(a, end)
            there = X["right_arm"] @ getattr(b, end)
            np.testing.assert_allclose(image, there, atol=1e-12)
        assert a.radius == b.radius
    for name, fit in fits.items():
        assert fit.good(0.015)
        d = np.min([c.distance(segments[name][0].vertices) for c in fit.capsules], 0)
        assert d.max() <= TOLERANCE
    # What is no image of the other is fitted for itself.
    other = leaning(False)
    other = Part(other.vertices @ X["right_arm"], other.faces, other.rgba)
    segments["right_arm"] = [other]
    alone = LinkFits(read, segments, twins, cache).fit(segments, 0.015, 16)
    for name, fit in alone.items():
        assert fit.good(0.015)
        d = np.min([c.distance(segments[name][0].vertices) for c in fit.capsules], 0)
        assert d.max() <= TOLERANCE


def test_a_damaged_file_of_fits_is_one_without_fits(tmp_path, monkeypatch):
    """And is written anew, with which nothing is fitted again."""
    place, fitted = tmp_path / "fits.json", []
    fit_link = link_fits.fit_link
    monkeypatch.setattr(
        link_fits, "fit_link", lambda *given: fitted.append(1) or fit_link(*given)
    )
    some = [leaning(False)]
    first = FitCache(place)
    expected = first.fit(some, 16, 0.015)
    first.save()
    whole = place.read_text()
    (key,) = json.loads(whole)
    entries = [], 3, "a", [[[1.0]], 1.0], [[[0.0] * 6 + ["a"]], 1.0, 1.0, 0.0, 0.0]
    damaged = ["[]", "3", "null", '"a"', "{", whole[:-9], "[" * 100_000]
    damaged += [json.dumps({key: entry}) for entry in entries]
    for text in damaged:
        place.write_text(text)
        fitted.clear()
        again = FitCache(place)
        found = again.fit(some, 16, 0.015)
        assert fitted == [1]
        assert len(found.capsules) == len(expected.capsules)
        again.save()
        assert place.read_text() == whole
    found = FitCache(place).fit(some, 16, 0.015)
    assert fitted == [1]
    for a, b in zip(found.capsules, expected.capsules, strict=True):
        assert (a.p_L0 == b.p_L0).all() and (a.p_L1 == b.p_L1).all()
        assert a.radius == b.radius


def test_fingers_have_twins_as_arms_and_legs_have(tmp_path):
    read = read_urdf(write(tmp_path, humanoid_with_legs()))
    twins = link_twins(read)
    for name in ("arm_fore", "arm_hand", "arm_finger", "arm_thumb", "knee", "leg"):
        assert twins[f"left_{name}"] == f"right_{name}"
        assert twins[f"right_{name}"] == f"left_{name}"
    assert "pelvis" not in twins


def other_side(link: str) -> str:
    swapped = link.replace("left", "#").replace("right", "left")
    return swapped.replace("#", "right")


def without_image(pairs: list[list[str]]) -> list[frozenset[str]]:
    known = {frozenset(pair) for pair in pairs}
    return [p for p in known if frozenset(map(other_side, p)) not in known]


def test_the_list_of_pairs_is_its_own_image(tmp_path):
    """Of a robot whose left shin has a mesh of its own, a little thinner."""
    thin = trimesh.creation.cylinder(radius=0.049, height=0.66)
    write_obj(tmp_path / "thin.obj", thin.vertices, thin.faces)
    text = humanoid_with_legs()
    old = '<cylinder radius="0.05" length="0.66"/>'
    text = text.replace(old, '<mesh filename="thin.obj"/>', 1)
    report = import_robot(write(tmp_path, text), tmp_path, lock=[])
    assert len(report.choices.pairs) > 30
    assert without_image(report.choices.pairs) == []
    # One forearm and hand with the other's, whatever was found.
    watched = {frozenset(pair) for pair in report.choices.pairs}
    beyond = [
        [n for n in report.capsules() if f"{side}_arm" in n and "upper" not in n]
        for side in ("left", "right")
    ]
    assert len(beyond[0]) >= 2
    for pair in itertools.product(*beyond):
        assert frozenset(pair) in watched


@pytest.mark.parametrize("name", ["g1", "g1_whole_body", "talos", "talos_whole_body"])
def test_the_shipped_lists_are_their_own_images(name):
    assert without_image(load_choices(import_file(name)).pairs) == []


def test_arms_that_hardly_reach_each_other(tmp_path):
    """Forearms and hands are watched against each other, though no sample was near:
    arms of 0.3 m on two posts 3 m apart."""
    parts = [link("base", '<box size="0.1 0.1 0.1"/>')]
    for side, y in (("left", 1.5), ("right", -1.5)):
        below, xyz = "base", f"0 {y} 0.5"
        for index, axis in enumerate(("0 0 1", "0 1 0", "1 0 0", "0 1 0", "0 0 1")):
            name = f"{side}_{index}"
            look = '<cylinder radius="0.02" length="0.05"/>'
            parts += [
                link(name, look, "0 0 -0.03"),
                joint(f"{side}_joint_{index}", below, name, axis, xyz),
            ]
            below, xyz = name, "0 0 -0.08"
    report = import_robot(write(tmp_path, robot(parts)), tmp_path, base="fixed")
    watched = {frozenset(pair) for pair in report.choices.pairs}
    for a, b in itertools.product((3, 4), repeat=2):
        assert frozenset((f"left_{a}", f"right_{b}")) in watched
    assert frozenset(("left_0", "right_0")) not in watched
