"""Which way is up on a robot, and which way it looks: from the symmetry of its limbs,
their names, and its feet."""

import os
from dataclasses import dataclass, replace

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.robot_import.anatomy import (
    Arms,
    find_anatomy,
    find_leg_chains,
    welded_below,
)
from crar_drake.robot_import.meshes import vertices_of
from crar_drake.robot_import.source_robot import SourceRobot

# Axes of the root link, in its own frame; the usual way up comes first.
_AXES = {
    f"{sign}{name}": np.roll([float(f"{sign}1"), 0.0, 0.0], shift)
    for shift, name in ((2, "z"), (1, "y"), (0, "x"))
    for sign in "+-"
}

_BEHIND = {axis: ("-" if axis[0] == "+" else "+") + axis[1] for axis in _AXES}
_TOES = 0.08  # share of a foot's length by which its middle is ahead of the ankle


@dataclass(frozen=True)
class FacingGuess:
    """Where a robot's front is."""

    facing: str  # one of `choices.AXES`: the axis of the root link that points ahead
    why: str  # what says so
    doubt: str = ""  # what speaks against it; "" if nothing


def turned(robot: SourceRobot, facing: str, up: str = "+z") -> SourceRobot:
    """The robot with poses in a frame whose x axis is its front, its z axis up, both
    axes of the root link (`choices.AXES`)."""
    x, z = _AXES[facing], _AXES[up]
    R_FR = RotationMatrix(np.stack([x, np.cross(z, x), z]))
    return replace(robot, X_FR=RigidTransform(R_FR, np.zeros(3)))


def guess_up(robot: SourceRobot) -> str:
    """The axis of the root link that points up, one of `choices.AXES`.

    It is z, as is usual, unless arms with two legs below them are found for another one
    only; or arms above the root link for another one, and for z none at all.
    """
    with_arms = []
    for up in _AXES:
        for facing in _across(up):
            there = turned(robot, facing, up)
            anatomy = find_anatomy(there)
            if anatomy is None:
                continue
            X = there.poses()
            shoulder = X[anatomy.left.joints[0].child].translation()[2]
            legs = find_leg_chains(there, anatomy)
            if legs and shoulder > X[legs.left.joints[0].child].translation()[2]:
                return up
            if up == "+z" or shoulder > 0.0:
                with_arms.append(up)
    return with_arms[0] if with_arms else "+z"


def _across(up: str) -> list[str]:
    """The two positive axes that a robot may look along, the usual one first."""
    return [axis for axis in ("+x", "+y", "+z") if axis[1] != up[1]]


def guess_facing(robot: SourceRobot, up: str = "+z") -> FacingGuess:
    """The axis of the root link that the robot looks along.

    Arms that mirror each other leave two directions; which of them is the front is
    said by what is called left and right, else by the feet, whose toes are ahead of
    the ankles.
    """
    for facing in _across(up):
        there = turned(robot, facing, up)
        anatomy = find_anatomy(there)
        if anatomy is not None:
            break
    else:
        return FacingGuess(_across(up)[0], "no pair of mirrored arms was found")
    named, toes = _named_left(anatomy), _toes(there, anatomy)
    votes = {"the names of left and right": named, "the feet": toes}
    said = [what for what, sign in votes.items() if sign]
    if not said:
        return FacingGuess(
            facing,
            "assumed, since neither names nor feet tell front from back",
            "neither names nor feet tell front from back; look at picture.png",
        )
    sign = named or toes
    doubt = ""
    if named and toes and named != toes:
        doubt = (
            "the names of left and right and the feet contradict each other; the "
            "names were believed"
        )
        said = said[:1]
    return FacingGuess(
        facing if sign > 0 else _BEHIND[facing], f"from {' and '.join(said)}", doubt
    )


def _named_left(anatomy: Arms) -> int:
    """1 if what is at +y is called left, -1 if it is called right, 0 if neither."""
    names = [[*(joint.name for joint in arm.joints), arm.hand] for arm in anatomy]
    return int(np.sign(sum(map(side_of_names, *names))))


def side_of_names(a: str, b: str) -> int:
    """What two mirrored things' names say: 1 if `a` is the left one, -1 if `b` is."""
    a, b = a.lower(), b.lower()
    start = len(os.path.commonprefix([a, b]))
    first = (a[start : start + 1], b[start : start + 1])
    return {("l", "r"): 1, ("r", "l"): -1}.get(first, 0)


def _toes(robot: SourceRobot, anatomy: Arms) -> int:
    """1 if both feet reach farther to +x than to -x, -1 the other way, else 0."""
    signs, X = set(), robot.poses()
    for chain in find_leg_chains(robot, anatomy) or ():
        leg = chain.joints[-1].child
        points = [
            vertices_of(robot.looks[link], X[link])
            for link in (leg, *welded_below(robot, leg))
            if robot.looks.get(link)
        ]
        if not points:
            return 0
        x = np.concatenate(points)[:, 0] - X[leg].translation()[0]
        ahead = (x.max() + x.min()) / 2.0
        long = x.max() - x.min()
        signs.add(int(np.sign(ahead)) if abs(ahead) > _TOES * long else 0)
    return signs.pop() if len(signs) == 1 else 0
