"""Inertias that are read, refused or made up."""

from xml.etree import ElementTree

import numpy as np
import pytest
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.tree import CalcSpatialInertia
from small_urdfs import joint, link, robot, write

from crar_drake.robot_import import import_robot
from crar_drake.robot_import.link_bodies import read_inertia, stand_in
from crar_drake.robot_import.meshes import link_parts
from crar_drake.robot_import.source_robot import Inertia, Link, Shape


def element(mass=2.0, ixx=0.02, iyy=0.03, izz=0.04) -> Link:
    X_LB = RigidTransform([1.0, 2.0, 3.0])
    return Link("l", (), (), Inertia(mass, X_LB, np.diag([ixx, iyy, izz])))


def test_as_it_stands():
    inertia, complaint = read_inertia(element())
    assert not complaint and inertia.mass == 2.0
    np.testing.assert_array_equal(inertia.X_LB.translation(), [1, 2, 3])
    np.testing.assert_array_equal(np.diag(inertia.moments), [0.02, 0.03, 0.04])


@pytest.mark.parametrize(
    "link, complaint",
    [
        (Link("l", (), (), None), "no inertia"),
        (element(mass=0.0), "no mass"),
        (element(ixx=0, iyy=0, izz=0), "an inertia of zero"),
        (element(izz=0.5), "that no body of 2 kg can have"),  # triangle inequality
        (element(ixx=-0.01), "that no body"),
    ],
)
def test_complaints(link, complaint):
    inertia, told = read_inertia(link)
    assert inertia is None and complaint in told


def test_a_stand_in_is_that_of_a_solid_hull():
    box = Shape(RigidTransform([0.1, 0, 0]), Box(0.2, 0.3, 0.4))
    made = stand_in(link_parts(Link("l", (box,), (), None)), 3.0)
    solid = CalcSpatialInertia(Box(0.2, 0.3, 0.4), 3.0 / (0.2 * 0.3 * 0.4))
    assert made.mass == pytest.approx(3.0)
    np.testing.assert_allclose(made.X_LB.translation(), [0.1, 0, 0], atol=1e-12)
    expected = solid.CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(made.moments, expected, atol=1e-9)


def test_a_flat_body_stays_one_that_can_be(tmp_path):
    """The largest moment is the sum of the others: nine digits of each (as of TIAGo's
    first arm link) can be beyond it, which Drake then warns of."""
    numbers = dict(ixx=0.0123456789449, iyy=0.0234567891449)
    numbers["izz"] = numbers["ixx"] + numbers["iyy"]
    rounded = {key: float(f"{value:.9g}") for key, value in numbers.items()}
    assert rounded["ixx"] + rounded["iyy"] < rounded["izz"]
    values = " ".join(f'{key}="{value!r}"' for key, value in numbers.items())
    flat = f'<inertia {values} ixy="0" ixz="0" iyz="0"/>'
    default = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    shape = '<box size="0.1 0.1 0.2"/>'
    text = robot(
        [link("a", shape), link("b", shape), joint("j", "a", "b", xyz="1 0 0")]
    )
    path = write(tmp_path, text.replace(default, flat))
    import_robot(str(path), tmp_path / "out")
    made = ElementTree.parse(tmp_path / "out" / "robot.urdf").getroot()
    (moments,) = {tuple(e.attrib.items()) for e in made.iter("inertia")}
    assert {k: float(v) for k, v in moments} == numbers | dict(ixy=0, ixz=0, iyz=0)


@pytest.mark.parametrize(
    "kind, told",
    [("revolute", "but moving, given 0.001 kg each: "), ("fixed", "that have one: ")],
)
def test_of_many_links_without_mass_a_few_are_named(kind, told, tmp_path):
    parts = [link("base", '<box size="0.1 0.1 0.1"/>')]
    for k in range(12):
        parts += [link(f"l{k}", mass=0.0), joint(f"j{k}", "base", f"l{k}", kind=kind)]
    # Without a joint there is nothing to import.
    parts += [link("arm", '<box size="0.1 0.1 0.1"/>', "1 0 0")]
    parts += [joint("j", "base", "arm")]
    report = import_robot(write(tmp_path, robot(parts)), tmp_path / "out")
    (line,) = [note for note in report.notes if "without mass" in note]
    assert line.endswith(told + "l0, l1, l2, l3, l4 and 7 more")
