"""Which links a judge asks for, of robots whose joints are counted by hand."""

import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from crar_drake.judging.judged_pairs import pairs_by_joints

LINKS = ("a", "b", "c", "d")


def plant(*joints: tuple[str, str, str]) -> MultibodyPlant:
    """Links a to d with joints (kind, parent, child)."""
    made = MultibodyPlant(0.0)
    parts = [f'<link name="{name}"/>' for name in LINKS]
    for kind, parent, child in joints:
        parts.append(
            f'<joint name="{parent}_{child}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    Parser(made).AddModelsFromString(
        f'<robot name="r">{"".join(parts)}</robot>', "urdf"
    )
    made.Finalize()
    return made


def pairs(made: MultibodyPlant) -> set[str]:
    bodies = [made.GetBodyByName(name).index() for name in LINKS]
    return {LINKS[i] + LINKS[j] for i, j in pairs_by_joints(made, bodies)[0]}


@pytest.mark.parametrize(
    "joints, expected",
    [
        (("revolute ab", "revolute bc", "prismatic cd"), {"ac", "ad", "bd"}),
        # b and c are one: a and d are next to it.
        (("revolute ab", "fixed bc", "revolute cd"), {"ad"}),
        # The same, with what is welded hanging on the side.
        (("revolute ab", "fixed bc", "revolute bd"), {"ad"}),
        (("fixed ab", "fixed bc", "fixed cd"), set()),
        (("continuous ab", "continuous ac", "continuous ad"), {"bc", "bd", "cd"}),
    ],
)
def test_pairs_beyond_one_joint(joints, expected):
    made = plant(*((each.split()[0], *each.split()[1]) for each in joints))
    assert pairs(made) == expected


def test_links_of_two_robots_are_pairs():
    made = plant(("revolute", "a", "b"), ("revolute", "c", "d"))
    assert pairs(made) == {"ac", "ad", "bc", "bd"}
