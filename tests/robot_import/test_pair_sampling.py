"""Sampling tells pairs that can meet from those that cannot."""

import itertools

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_urdfs import joint, link, robot

from crar_drake.robot_import.capsule_fitting import FittedCapsule
from crar_drake.robot_import.pair_sampling import (
    PairDistances,
    position_ranges,
    sample_pairs,
)
from crar_drake.robot_import.source_urdf import read_urdf
from crar_drake.robot_import.watched_pairs import candidate_pairs

BALL = FittedCapsule(np.zeros(3), np.zeros(3), 0.1)
POST = FittedCapsule(np.zeros(3), np.array([0, 0, 1.0]), 0.1)


def turning() -> str:
    """A ball on an arm of 1 m that turns about z by up to 90 degrees either way."""
    parts = [link("base"), link("ball"), link("tail")]
    parts += [link(name) for name in ("ahead", "aside", "behind")]
    parts += [
        joint("turn", "base", "ball", xyz="0 0 0"),
        joint("end", "ball", "tail", kind="fixed", xyz="1 0 0"),
    ]
    for name, xyz in (("ahead", "1 0 0"), ("aside", "0 1 0"), ("behind", "-1 0 0")):
        parts.append(joint(f"{name}_weld", "base", name, kind="fixed", xyz=xyz))
    return robot(parts)


@pytest.fixture(scope="module")
def plant():
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    Parser(plant).AddModelsFromString(turning(), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    return plant


def parted(capsules) -> list[tuple[str, str]]:
    """All pairs of one link that moves and one that does not."""
    pairs = itertools.combinations(capsules, 2)
    return [pair for pair in pairs if len({"ball", "tail"} & set(pair)) == 1]


def test_links_that_are_welded_or_joined_are_no_pair(tmp_path):
    (tmp_path / "small.urdf").write_text(turning())
    found = candidate_pairs(
        read_urdf(tmp_path / "small.urdf"), ["base", "ball", "tail", "ahead"]
    )
    assert found == [("base", "tail"), ("ball", "ahead"), ("tail", "ahead")]
    # Without a shape between them a joint connects these.
    assert candidate_pairs(read_urdf(tmp_path / "small.urdf"), ["tail", "base"]) == []


def test_each_kind(plant):
    capsules = {
        "base": [BALL],
        "ball": [FittedCapsule(np.zeros(3), np.zeros(3), 0.05)],
        "tail": [BALL],
        "ahead": [POST],
        "aside": [POST],
        "behind": [POST],
    }
    pairs = parted(capsules)
    found = sample_pairs(plant, capsules, np.array([0.0]), pairs, 300)
    assert found.watched == [["tail", "aside"]]
    # The ball sits in the base, and the arm points ahead, at rest.
    assert found.overlapping == [["base", "ball"], ["tail", "ahead"]]
    # Clear of what it is in at rest, the same pairs are judged by the samples.
    moved = sample_pairs(plant, capsules, np.array([0.8]), pairs, 300)
    assert moved.watched == [["tail", "ahead"], ["tail", "aside"]]


def test_a_pair_is_watched_if_its_image_is(plant):
    """Though it is a little farther away than what counts as near."""
    above, below = np.array([[0.6, 0.8, 0.0], [0.6, -0.8, 0.0]])
    capsules = {
        "base": [FittedCapsule(*[0.95 * below] * 2, 0.01)],
        "ahead": [FittedCapsule(*[0.97 * above - [1.0, 0.0, 0.0]] * 2, 0.01)],
        "tail": [FittedCapsule(np.zeros(3), np.zeros(3), 0.01)],
    }
    alone = sample_pairs(plant, capsules, np.zeros(1), parted(capsules), 100)
    assert alone.watched == [["ahead", "tail"]] and alone.never == 1
    twins = {"ahead": "base", "base": "ahead"}
    alike = sample_pairs(plant, capsules, np.zeros(1), parted(capsules), 100, twins)
    assert alike.watched == [["base", "tail"], ["ahead", "tail"]]
    also = {frozenset(("base", "tail"))}
    pairs = parted(capsules)
    asked = sample_pairs(plant, capsules, np.zeros(1), pairs, 100, always_watched=also)
    assert asked.watched == alike.watched


def test_minimising_finds_what_samples_do_not(plant):
    """Two balls that meet in 3 of 10,000 postures of the joint, of 20 samples."""
    far = 100.0
    above = far * np.array([0.6, 0.8, 0.0])
    capsules = {
        "ahead": [FittedCapsule(*[above - [1.0, 0.0, 0.0]] * 2, 0.02)],
        "tail": [FittedCapsule(*[np.array([far - 1.0, 0.0, 0.0])] * 2, 0.02)],
    }
    pairs = [("ahead", "tail")]
    distances = PairDistances(plant, capsules, pairs)
    lower, upper = distances.lower, distances.upper
    q = np.random.default_rng(0).uniform(lower, upper, size=(20, 1))
    assert distances.of_all(q).min() > 1.0
    found = sample_pairs(plant, capsules, np.zeros(1), pairs, 20)
    assert found.watched == [list(pairs[0])]


@pytest.mark.parametrize(
    "limits, expected",
    [((-0.5, 5.0), (-0.5, 5.0)), ((-9.0, 9.0), (-9.0, 2.0 * np.pi - 9.0))],
)
def test_ranges_are_not_cut_at_half_a_turn(limits, expected):
    """A joint of -0.5 to 5 rad reaches all of it; a whole turn is enough."""
    said = 'lower="{}" upper="{}" effort="20" velocity="5"'.format(*limits)
    text = robot([link("a"), link("b"), joint("turn", "a", "b", limits=said)])
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    Parser(plant).AddModelsFromString(text, "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("a"))
    plant.Finalize()
    lower, upper = position_ranges(plant)
    np.testing.assert_allclose([lower[0], upper[0]], expected)


def test_always_in_contact(plant):
    capsules = {
        "base": [BALL],
        "ball": [FittedCapsule(*[np.array([0.2, 0, 0])] * 2, 0.11)],
    }
    found = sample_pairs(plant, capsules, np.array([0.0]), parted(capsules), 100)
    assert found.overlapping == [["base", "ball"]]
    wide = {
        "aside": [FittedCapsule(*[np.array([0, -1.0, 0])] * 2, 0.99)],
        "tail": [BALL],
    }
    far = sample_pairs(plant, wide, np.array([0.0]), parted(wide), 100)
    assert far.overlapping and not far.watched


def test_nothing_to_pair(plant):
    assert sample_pairs(plant, {"base": [BALL]}, np.zeros(1), [], 10).watched == []
