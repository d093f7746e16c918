"""Certificates of robots with meshes: what they say, and what refutes them."""

import copy

import numpy as np
import pytest
import trimesh
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.judging.referee import Referee
from crar_drake.references.certificate_files import certificate_path, read_certificate
from crar_drake.references.clean_file import CleanOptions, FileCleaner, clean_file
from crar_drake.references.motion_certificate import check_certificate
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description


def with_meshes(
    folder, pairs: str | None = None, of: str = "base_shape", radius: float = 0.05
):
    """The chain, whose base shape has a mesh; the other links' shapes are meshed."""
    write_robot(folder)
    trimesh.creation.icosphere(3, radius=radius).export(folder / "ball.obj")
    urdf = (folder / "chain.urdf").read_text()
    link = f'<link name="{of}">'
    visual = '<visual><geometry><mesh filename="ball.obj"/></geometry></visual>'
    assert link in urdf
    (folder / "chain.urdf").write_text(urdf.replace(link, link + visual))
    if pairs is not None:
        yaml = (folder / "robot.yaml").read_text()
        (folder / "robot.yaml").write_text(yaml[: yaml.index("pairs:")] + pairs)
    return folder


@pytest.fixture(scope="module")
def cleaned(tmp_path_factory):
    folder = with_meshes(tmp_path_factory.mktemp("meshes"))
    out = folder / "out" / "reach.csv"
    reference = write_csv(folder / "reach.csv", reaching(24, 30.0, 1.0))
    (row,) = clean_file(reference, out, str(folder))
    return folder, out, row


def check(folder, out, certificate=None):
    certificate = certificate or read_certificate(certificate_path(out))
    return check_certificate(out, certificate, load_robot_description(folder))


def test_it_says_what_it_is_of_and_what_not(cleaned, capsys):
    folder, out, row = cleaned
    certificate = read_certificate(certificate_path(out))
    assert not row.violated and row.meshes_penetrating == row.meshes_unclear == 0
    pairs = {frozenset(pair) for pair in certificate["mesh_pairs"]}
    links = ["post", "base_shape"]  # both are fixed to the base, and so no pair
    assert pairs == {
        *(frozenset((fixed, arm)) for fixed in links for arm in ("l1", "l2")),
        frozenset(("l0", "l2")),
    }
    not_covered = certificate["not_covered"]
    assert not_covered["pairs"] == not_covered["as_built"] == []
    one_joint = {frozenset(pair) for pair in not_covered["one_joint"]}
    assert one_joint == {
        *(frozenset((fixed, "l0")) for fixed in links),
        frozenset(("l0", "l1")),
        frozenset(("l1", "l2")),
    }
    assert {"base", "tip"} == set(not_covered["without_mesh"])
    (clip,) = certificate["clips"]
    at, on = (np.array(clip["meshes"][key]) for key in ("at_frames", "on_ways"))
    assert at.shape == on.shape == (5,) and np.all((0.0 < on) & (on <= at))
    found = check(folder, out)
    assert found.holds and found.uncovered == 0 and found.mesh_pairs == 5
    assert found.mesh_frames == 24 and found.mesh_points == 3 * 23
    capsys.readouterr()
    assert main(["judge", str(out), "--certificate", "--robot", str(folder)]) == 0
    assert "meshes, 5 pairs, 24 frames and 69 points" in capsys.readouterr().out


def of_meshes(certificate) -> dict:
    return certificate["clips"][0]["meshes"]


def without_a_pair(certificate) -> None:
    pairs = [set(pair) for pair in certificate["mesh_pairs"]]
    row = pairs.index({"l0", "l2"})  # that nobody watches by its capsules
    del certificate["mesh_pairs"][row]
    for key in ("at_frames", "on_ways"):
        del of_meshes(certificate)[key][row]


def tenfold(key):
    def edit(certificate) -> None:
        values = of_meshes(certificate)[key]
        values[int(np.argmin(values))] *= 10.0

    return edit


EDITS = {
    "not a number for each pair": [
        lambda c: of_meshes(c)["at_frames"].__setitem__(2, float("nan")),
        lambda c: of_meshes(c)["on_ways"].__setitem__(2, None),
        lambda c: of_meshes(c)["on_ways"].pop(),
    ],
    "are not shown to be clear between frames": [
        lambda c: of_meshes(c)["on_ways"].__setitem__(0, 0.0)
    ],
    "are not shown to be clear at a frame": [
        lambda c: of_meshes(c)["at_frames"].__setitem__(0, -1.0)
    ],
    "mm apart, claimed": [tenfold("at_frames"), tenfold("on_ways")],
    "it has no bounds of meshes": [lambda c: c["clips"][0].update(meshes=None)],
    "does not say that it is not of l0 - l2": [without_a_pair],
    "which is no pair that is judged": [
        lambda c: c["mesh_pairs"].__setitem__(0, ["l0", "l1"])
    ],
}


@pytest.mark.parametrize("refuted", EDITS)
def test_what_it_says_besides_is_refuted(cleaned, refuted):
    folder, out, _ = cleaned
    for edit in EDITS[refuted]:
        certificate = copy.deepcopy(read_certificate(certificate_path(out)))
        edit(certificate)
        found = check(folder, out, certificate)
        assert any(refuted in line for line in found.refuted), found.refuted


def test_meshes_of_pairs_that_nobody_watches(tmp_path, capsys):
    """The arm goes through the post, and only the meshes say so; they are parted,
    unless that is not asked for."""
    folder = with_meshes(tmp_path, "pairs: [[base_shape, l2]]\n")
    reference = write_csv(tmp_path / "reach.csv", reaching(24, 30.0, 1.0))
    out = tmp_path / "out" / "reach.csv"
    (row,) = clean_file(reference, out, str(folder))
    assert not row.violated and row.meshes_penetrating == row.meshes_unclear == 0
    assert main(["judge", str(out), "--certificate", "--robot", str(folder)]) == 0
    cleaner = FileCleaner(CleanOptions(str(folder)))
    cleaner.part_meshes = False
    (row,) = cleaner(reference, out)
    assert row.penetrating == 0 and row.between > 0.0 and row.violated
    assert 0 < row.meshes_penetrating < row.meshes_unclear < 24
    certificate = read_certificate(certificate_path(out))
    meshes = of_meshes(certificate)
    frames = {k for _, touching in meshes["touch_at"] for k in touching}
    assert len(frames) == row.meshes_penetrating
    capsys.readouterr()
    assert main(["judge", str(out), "--certificate", "--robot", str(folder)]) == 1
    said = capsys.readouterr().out
    assert "are not shown to be clear" in said and " - post" in said
    # A certificate that says nothing of it is refuted by what the judge finds.
    meshes["at_frames"] = meshes["on_ways"] = [1e-3] * len(certificate["mesh_pairs"])
    found = check(folder, out, certificate)
    assert any("penetrate in" in line for line in found.refuted), found.refuted


def test_where_only_shapes_are_too_near_nothing_is_changed(tmp_path, capsys):
    """Meshes decide; who cannot look at them does not believe it."""
    folder = with_meshes(tmp_path, of="post", radius=0.02)
    q = reaching(24, 30.0, 1.0)
    reference, out = write_csv(folder / "reach.csv", q), folder / "out" / "reach.csv"
    (row,) = clean_file(reference, out, str(folder))
    assert row.penetrating_before > 0 and row.nearest < 0.0
    assert not row.violated and row.penetrating == row.unclear == row.changed == 0
    written = np.loadtxt(out, delimiter=",")
    np.testing.assert_array_equal(written, np.loadtxt(reference, delimiter=","))
    (clip,) = read_certificate(certificate_path(out))["clips"]
    below = np.flatnonzero(np.array(clip["frames"]["distance"]) < 0.0)
    assert set(below) <= set(clip["excused"])
    assert check(folder, out).holds
    for arguments in (["--certificate"], []):
        assert main(["judge", str(out), *arguments, "--robot", str(folder)]) == 0
    certificate = read_certificate(certificate_path(out))
    certificate["clips"][0]["excused"] = []
    found = check(folder, out, certificate)
    assert any("penetrate by" in line for line in found.refuted)


@pytest.mark.parametrize("turn, parted", [(1.07, True), (1.3, False)])
def test_shapes_beside_others_that_meshes_excuse(tmp_path, turn, parted):
    """Shapes of post and l1, whose meshes are clear, are deeper in each other than
    those of post and l0, of which no meshes decide: they are one joint apart."""
    folder = with_meshes(tmp_path, "pairs: [[post, l0], [post, l1]]\n", "post", 0.02)
    urdf = folder / "chain.urdf"
    urdf.write_text(urdf.read_text().replace("0.2 0.5 0.1", "0.2 0.26 0.1"))
    still = np.tile([turn, -2.2, 0.0], (24, 1))
    reference, out = write_csv(folder / "a.csv", still), folder / "out" / "a.csv"
    (row,) = clean_file(reference, out, str(folder))
    assert row.penetrating_before == 24 and row.changed == 24 * parted
    assert row.penetrating == row.unclear == 0 and not row.violated
    robot = WholeBody(load_robot_description(folder))
    referee = Referee(robot.plant, robot.scene_graph, [["post", "l0"]])
    for path in (reference, out):
        q = np.loadtxt(path, delimiter=",")[:, 7:]
        d = np.array([referee.distances(frame).min() for frame in q])
        assert (d > 0.0).all() == (path == out or not parted)
    assert check(folder, out).holds


def test_without_the_packages_nothing_excuses_shapes(tmp_path, monkeypatch):
    folder = with_meshes(tmp_path, of="post", radius=0.02)
    reference, out = folder / "reach.csv", folder / "out" / "reach.csv"
    clean_file(write_csv(reference, reaching(24, 30.0, 1.0)), out, str(folder))
    monkeypatch.setattr(
        "crar_drake.references.motion_certificate.why_no_meshes",
        lambda robot: "not installed",
    )
    assert any("penetrate by" in line for line in check(folder, out).refuted)


def test_without_the_packages_its_meshes_count_as_uncovered(cleaned, monkeypatch):
    folder, out, _ = cleaned
    monkeypatch.setattr(
        "crar_drake.references.motion_certificate.why_no_meshes",
        lambda robot: "not installed",
    )
    found = check(folder, out)
    assert found.holds and found.why_not == "not installed"
    assert found.mesh_frames == 0 and found.uncovered == 2
