"""What a certificate's file may hold, `judge --certificate` tells in plain words."""

import copy
import json
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.references.certificate_files import certificate_path
from crar_drake.references.clean_file import clean_file
from crar_drake.robot.description import load_robot_description

# What may stand in another's place; "\ud800" and the escape are in files of others.
VALUES = (
    None,
    True,
    -1,
    7,
    10**400,
    1.5,
    float("nan"),
    float("-inf"),
    "",
    "\ud800\x1b",
)
VALUES += ([], [[]], [1, 2], ["a", "b"], {}, {"a": 1})
# What nothing judges: of which reference and how the motion was made, and remarks.
NOT_JUDGED = {"version", "reference", "checked", "parameters", "options"}
NOT_JUDGED |= {"touch_at", "touch_on", "not_shown"}


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """A motion's certificate, its text, and the arguments that judge it."""
    folder = write_robot(tmp_path_factory.mktemp("damaged"))
    trimesh.creation.icosphere(1, radius=0.05).export(folder / "ball.obj")
    urdf = (folder / "chain.urdf").read_text()
    for link in ("base_shape", "l2"):
        name = f'<link name="{link}">'
        visual = '<visual><geometry><mesh filename="ball.obj"/></geometry></visual>'
        urdf = urdf.replace(name, name + visual)
    (folder / "chain.urdf").write_text(urdf)
    out = folder / "out" / "reach.csv"
    clean_file(
        write_csv(folder / "reach.csv", reaching(4, 30.0, 0.1)), out, str(folder)
    )
    place = certificate_path(out)
    text = place.read_text()
    return place, text, ["judge", str(out), "--certificate", "--robot", str(folder)]


def verdict(judged, capsys, text: str | bytes) -> tuple[int, str]:
    """The exit code with this in the certificate's file, and what is said."""
    place, was, arguments = judged
    place.write_bytes(text if isinstance(text, bytes) else text.encode())
    try:
        capsys.readouterr()
        code = main(arguments)
    finally:
        place.write_text(was)
    said = capsys.readouterr()
    return code, said.err if code == 2 else said.out


def places(part: object, way: tuple = ()) -> Iterator[tuple]:
    """Where there is something in a certificate; of a list its first and last."""
    yield way
    if isinstance(part, dict):
        for key, value in part.items():
            yield from places(value, (*way, key))
    elif isinstance(part, list) and part:
        for k in {0, len(part) - 1}:
            yield from places(part[k], (*way, k))


def damages(certificate: dict) -> Iterator[tuple[tuple, object, dict]]:
    """Certificates without a key, or with another value; and where, and which."""
    for way in places(certificate):
        remark = way[:1] == ("not_covered",) and way[1:2] not in ((), ("pairs",))
        if not way or remark or NOT_JUDGED & set(way):
            continue
        for value in (KeyError, *VALUES):
            damaged = copy.deepcopy(certificate)
            holder = damaged
            for key in way[:-1]:
                holder = holder[key]
            if value is KeyError:
                del holder[way[-1]]
            elif holder[way[-1]] == value and type(holder[way[-1]]) is type(value):
                continue
            else:
                holder[way[-1]] = value
            yield way, value, damaged


def test_whatever_is_damaged_is_told(judged, capsys, monkeypatch):
    _, text, arguments = judged
    # Of one robot, which is not damaged: its hulls take long to make.
    judge = MeshJudge(load_robot_description(arguments[-1]))
    of = "crar_drake.references.motion_certificate.MeshJudge"
    monkeypatch.setattr(of, lambda description: judge)
    codes = []
    for way, value, damaged in damages(json.loads(text)):
        where = f"{way}: {value!r}"
        code, said = verdict(judged, capsys, json.dumps(damaged))
        codes.append(code)
        if code == 2:
            assert said.count("\n") == 1, where
            assert "reach.certificate.json: " in said, f"{where}: {said}"
        for words in ("Error", "Errno", "object is", "'NoneType'", "Traceback", "\x1b"):
            assert words not in said, f"{where}: {said}"
        # Every key is needed.
        assert code or value is not KeyError or isinstance(way[-1], int), where
    assert np.bincount(codes)[1] > 20 and np.bincount(codes)[2] > 200


@pytest.mark.parametrize(
    "damage, told",
    [
        (lambda text: text[:-30], "is damaged: from line"),
        (lambda text: "", "is damaged: from line 1 on it is not JSON"),
        (lambda text: "[" * 100_000, "is damaged"),
        (lambda text: "1" * 5000, "is damaged"),
        (lambda text: text.encode("utf-16"), "is damaged: it is not JSON in UTF-8"),
        (lambda text: text.replace('"floor"', '"fl\\q"'), "is damaged: from line"),
        (lambda text: "[]", "is no certificate of a reference motion"),
        (lambda text: text.replace('"format": 4', '"format": 3'), "has format 3, and"),
        (lambda text: text.replace('"layout"', '"lay"'), "motion.layout is missing"),
        (
            lambda text: text.replace('"layout": "', '"layout": "my-'),
            "motion.layout is no layout",
        ),
    ],
)
def test_a_file_that_is_none_is_told(judged, capsys, damage, told):
    code, said = verdict(judged, capsys, damage(judged[1]))
    assert code == 2 and said.count("\n") == 1
    assert "reach.certificate.json: " in said and told in said
    if "damaged" in told:
        assert "copy it again, or clean the motion again" in said


def test_a_folder_is_no_certificate(judged, capsys):
    place, text, arguments = judged
    place.unlink()
    place.mkdir()
    try:
        assert main(arguments) == 2
    finally:
        place.rmdir()
        place.write_text(text)
    assert "is no certificate, but a folder" in capsys.readouterr().err
