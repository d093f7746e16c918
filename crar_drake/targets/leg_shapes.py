"""The legs of a robot, as a motion that moves them must know them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.multibody.tree import Frame

from crar_drake.errors import ScenarioError
from crar_drake.motion.leg_shape import LegShape
from crar_drake.motion.performer import SIDES
from crar_drake.robot.description import find_body, find_frame, zero_positions
from crar_drake.robot.model import ControlModel
from crar_drake.robot_import.link_outlines import (
    LinkOutline,
    link_outlines,
    links_outward,
)

LEG_FRAMES = ("hip", "knee", "foot")

# Points of a foot at rest within this of its lowest one are its sole [m].
_SOLE = 0.01

# How the reach of a leg is sampled: joints above the knee within this of zero [rad].
_SAMPLED_RANGE = 0.8
_SAMPLES = 200
_KNEE_STEPS = 25


def leg_shapes(model: ControlModel) -> dict[str, LegShape]:
    """The legs of a robot whose base floats, by side.

    Raises:
        ScenarioError: the base does not float, a task frame of a leg is missing, or a
            foot has no shape.
    """
    description = model.description
    frames = description.task_frames
    needed = [f"{side}_{part}" for side in SIDES for part in LEG_FRAMES]
    missing = [name for name in needed if name not in frames]
    if missing:
        raise ScenarioError(
            f"robot {description.name}: following a motion's feet needs the "
            f"task_frames {', '.join(missing)}; add them to its robot.yaml (frames of "
            "an import.yaml)"
        )
    if not model.num_free:
        raise ScenarioError(
            f"robot {description.name}: its root does not float, so that its feet "
            "cannot follow a motion; say root: prescribed in its robot.yaml, or import "
            "it with --whole-body"
        )
    outlines = link_outlines(model.plant, model.scene_graph)
    return {side: _leg(model, side, outlines) for side in SIDES}


def _leg(
    model: ControlModel, side: str, outlines: Mapping[str, LinkOutline]
) -> LegShape:
    plant, description = model.plant, model.description
    context = model.MakeWorkspace().plant_context
    hip, knee, foot = (
        find_frame(plant, description.task_frames[f"{side}_{part}"])
        for part in LEG_FRAMES
    )
    base = find_body(plant, description.base).body_frame()

    def place(frame: Frame) -> np.ndarray:
        return frame.CalcPoseInWorld(context).translation()

    plant.SetPositions(context, model.rest_positions())
    p_BH = place(hip) - place(base)
    X_WF = foot.CalcPoseInWorld(context)
    points = [np.empty((0, 3))]
    for link in links_outward(plant, foot):
        if link in outlines:
            X_WB = plant.EvalBodyPoseInWorld(context, find_body(plant, link))
            p_W = X_WB.multiply(outlines[link].points.T).T
            p_W[:, 2] -= outlines[link].radii
            points.append(p_W - X_WF.translation())
    points = np.concatenate(points)
    if not len(points):
        raise ScenarioError(
            f"robot {description.name}: {side}_foot: nothing from this frame's link on "
            "has a mesh, capsule or sphere, so that there is no sole to stand on"
        )
    sole = points[points[:, 2] <= points[:, 2].min() + _SOLE]
    (x0, y0, z), (x1, y1, _) = sole.min(axis=0), sole.max(axis=0)
    y = 0.5 * (y0 + y1)
    reach = _reach(model, side, context)
    plant.SetPositions(context, zero_positions(plant))
    return LegShape(
        hip=p_BH,
        thigh=float(np.linalg.norm(place(knee) - place(hip))),
        shank=float(np.linalg.norm(place(foot) - place(knee))),
        reach=reach,
        foot=X_WF.rotation().matrix(),
        points=points,
        heel=np.array([x0, y, z]),
        ball=np.array([x1, y, z]),
    )


def _reach(model: ControlModel, side: str, context) -> float:
    """The least distance from where the hip is at rest that a leg, stretched out as far
    as its knee goes, reaches.

    Joints of a hip whose axes do not meet move its centre a little.
    """
    plant, description = model.plant, model.description
    hip, knee, foot = (
        find_frame(plant, description.task_frames[f"{side}_{part}"])
        for part in LEG_FRAMES
    )
    base = find_body(plant, description.base)
    chain, body = [], knee.body()
    while body.index() != base.index():
        joint = next(
            j
            for j in map(plant.get_joint, plant.GetJointIndices())
            if j.child_body().index() == body.index()
        )
        if joint.num_positions() == 1:
            chain.append(joint)
        body = joint.parent_body()
    rest = model.rest_positions()
    plant.SetPositions(context, rest)
    p_H = hip.CalcPoseInWorld(context).translation()

    def stretched(q: np.ndarray) -> float:
        best = 0.0
        bend = chain[0]
        for angle in _within(bend, -_SAMPLED_RANGE, _SAMPLED_RANGE, _KNEE_STEPS):
            q[bend.position_start()] = angle
            plant.SetPositions(context, q)
            p_F = foot.CalcPoseInWorld(context).translation()
            best = max(best, float(np.linalg.norm(p_F - p_H)))
        return best

    rng, least = np.random.default_rng(0), np.inf
    for _ in range(_SAMPLES):
        q = rest.copy()
        for joint in chain[1:]:
            low, high = _within(joint, -_SAMPLED_RANGE, _SAMPLED_RANGE, 2)
            q[joint.position_start()] = rng.uniform(low, high)
        least = min(least, stretched(q))
    return least


def _within(joint, low: float, high: float, count: int) -> np.ndarray:
    """Positions between two bounds, as far as the joint's limits let."""
    lower = float(joint.position_lower_limits()[0])
    upper = float(joint.position_upper_limits()[0])
    return np.linspace(np.clip(low, lower, upper), np.clip(high, lower, upper), count)
