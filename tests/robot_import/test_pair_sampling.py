"""Sampling tells pairs that can meet from those that cannot."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from small_urdfs import joint, link, robot

from crar_drake.robot_import.capsule_fitting import FittedCapsule
from crar_drake.robot_import.pair_sampling import sample_pairs

BALL = FittedCapsule(np.zeros(3), np.zeros(3), 0.1)
POST = FittedCapsule(np.zeros(3), np.array([0, 0, 1.0]), 0.1)


@pytest.fixture(scope="module")
def plant():
    """A ball on an arm of 1 m that turns about z by up to 90 degrees either way."""
    parts = [link("base"), link("ball"), link("tail")]
    parts += [link(name) for name in ("ahead", "aside", "behind")]
    parts += [
        joint("turn", "base", "ball", xyz="0 0 0"),
        joint("end", "ball", "tail", kind="fixed", xyz="1 0 0"),
    ]
    for name, xyz in (("ahead", "1 0 0"), ("aside", "0 1 0"), ("behind", "-1 0 0")):
        parts.append(joint(f"{name}_weld", "base", name, kind="fixed", xyz=xyz))
    plant, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    Parser(plant).AddModelsFromString(robot(parts), "urdf")
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    return plant


def test_each_kind(plant):
    capsules = {
        "base": [BALL],
        "ball": [FittedCapsule(np.zeros(3), np.zeros(3), 0.05)],
        "tail": [BALL],
        "ahead": [POST],
        "aside": [POST],
        "behind": [POST],
    }
    adjacent = {frozenset(("ball", "tail"))}
    found = sample_pairs(plant, capsules, np.array([0.0]), adjacent, 300)
    assert found.watched == [["tail", "aside"]]
    assert found.least[0] < 0.02
    # The ball sits in the base, and the arm points ahead, at rest.
    assert found.overlapping == [["base", "ball"], ["tail", "ahead"]]
    # Clear of what it is in at rest, the same pairs are judged by the samples.
    moved = sample_pairs(plant, capsules, np.array([0.8]), adjacent, 300)
    assert moved.watched == [["tail", "ahead"], ["tail", "aside"]]
    # Links that are welded together are no pair at all.
    assert not any({"ahead", "aside"} <= set(pair) for pair in found.watched)


def test_both_sides_are_treated_alike(plant):
    """A pair that is near at rest is left out if that of the other side touches."""
    capsules = {
        "ball": [FittedCapsule(np.zeros(3), np.zeros(3), 0.05)],
        "ahead": [FittedCapsule(*[np.array([-0.90, 0, 0])] * 2, 0.04)],
        "aside": [FittedCapsule(*[np.array([0, -0.90, 0])] * 2, 0.06)],
        "tail": [FittedCapsule(np.zeros(3), np.zeros(3), 0.01)],
    }
    touching, near = ["ball", "aside"], ["ball", "ahead"]
    alone = sample_pairs(plant, capsules, np.zeros(1), set(), 100)
    assert touching in alone.overlapping and near in alone.watched
    twins = {"ahead": "aside", "aside": "ahead"}
    alike = sample_pairs(plant, capsules, np.zeros(1), set(), 100, twins)
    assert touching in alike.overlapping and near in alike.overlapping
    # What is farther away is watched all the same.
    capsules["ahead"] = [FittedCapsule(*[np.array([-0.85, 0, 0])] * 2, 0.04)]
    far = sample_pairs(plant, capsules, np.zeros(1), set(), 100, twins)
    assert touching in far.overlapping and near not in far.overlapping


def test_always_in_contact(plant):
    capsules = {
        "base": [BALL],
        "ball": [FittedCapsule(*[np.array([0.2, 0, 0])] * 2, 0.11)],
    }
    found = sample_pairs(plant, capsules, np.array([0.0]), set(), 100)
    assert found.overlapping == [["base", "ball"]]
    wide = {
        "aside": [FittedCapsule(*[np.array([0, -1.0, 0])] * 2, 0.99)],
        "tail": [BALL],
    }
    far = sample_pairs(plant, wide, np.array([0.0]), set(), 100)
    assert far.overlapping and not far.watched


def test_nothing_to_pair(plant):
    assert sample_pairs(plant, {"base": [BALL]}, np.zeros(1), set(), 10).watched == []
