"""Legs and trunk of a robot, as a motion that moves them must know them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from pydrake.multibody.tree import Frame, RevoluteJoint

from crar_drake.errors import ScenarioError
from crar_drake.motion.leg_shape import LegShape, TrunkShape
from crar_drake.motion.performer import SIDES
from crar_drake.robot.description import find_body, find_frame, zero_positions
from crar_drake.robot.model import ControlModel
from crar_drake.robot_import.link_outlines import (
    LinkOutline,
    capsule_outlines,
    link_outlines,
    links_outward,
)
from crar_drake.targets.ankle_limits import joints_between, leg_joints

LEG_FRAMES = ("hip", "knee", "foot")

# Points of a foot at rest within this of its lowest one are its sole [m].
_SOLE = 0.01

# How the reach of a leg is sampled: joints above the knee within this of zero [rad].
_SAMPLED_RANGE = 0.8
_SAMPLES = 60
_KNEE_STEPS = 9

# A knee that bends far: from its limit [rad], between what is watched of its leg [m].
# A lookahead of 40 ms brakes it nearer.
_BENT_MARGIN = 0.1
_BENT_ROOM = 0.02
_BENT_STEPS = 100
_NO_NEARER = 0.8  # share of their distance at rest, that links may be near at any bend

# How leans of a trunk are sampled: joints whose axes are less upright than that, within
# this of zero [rad].
_UPRIGHT = 0.8
_LEAN = (-1.5, 1.5)
_LEAN_STEPS = 5


def body_shapes(model: ControlModel) -> tuple[dict[str, LegShape], TrunkShape]:
    """The legs of a robot whose base floats, by side, and its trunk.

    Raises:
        ScenarioError: the root is not prescribed, a task frame of a leg is missing, or
            a foot has no shape.
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
    if description.root != "prescribed":
        raise ScenarioError(
            f"robot {description.name}: its root is {description.root}, so that its "
            "feet cannot follow a motion; say root: prescribed in its robot.yaml, or "
            "import it with --whole-body"
        )
    plant = model.plant
    feet = {
        link
        for side in SIDES
        for link in links_outward(plant, find_frame(plant, frames[f"{side}_foot"]))
    }
    soles = link_outlines(plant, model.scene_graph, feet)
    capsules = capsule_outlines(plant, model.scene_graph)
    legs = {side: _leg(model, side, soles, capsules) for side in SIDES}
    return legs, _trunk(model, capsules)


def _leg(
    model: ControlModel,
    side: str,
    outlines: Mapping[str, LinkOutline],
    capsules: Mapping[str, LinkOutline],
) -> LegShape:
    plant, description = model.plant, model.description
    context = _at_rest(model)
    hip, knee, foot = _leg_frames(model, side)
    base = find_body(plant, description.base).body_frame()

    def place(frame: Frame) -> np.ndarray:
        return frame.CalcPoseInWorld(context).translation()

    p_BH = place(hip) - place(base)
    X_WF = foot.CalcPoseInWorld(context)
    links = [link for link in links_outward(plant, foot) if link in outlines]
    points = _points(model, links, outlines) - X_WF.translation()
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
        knee=_knee_radius(place(knee), place(foot), knee, capsules, context),
        shortest=_shortest(model, side),
    )


def _knee_radius(
    p_WK: np.ndarray,
    p_WF: np.ndarray,
    knee: Frame,
    capsules: Mapping[str, LinkOutline],
    context,
) -> float:
    """How far the shank's upper half is from the line of knee and foot, at most [m]."""
    outline = capsules.get(knee.body().name())
    if outline is None:
        return 0.0
    way = p_WF - p_WK
    off = knee.body().EvalPoseInWorld(context).multiply(outline.points.T).T - p_WK
    along = off @ way / (way @ way)
    across = np.linalg.norm(off - along[:, None] * way, axis=1) + outline.radii
    return float(across[along < 0.5].max(initial=0.0))


def _trunk(model: ControlModel, outlines: Mapping[str, LinkOutline]) -> TrunkShape:
    plant, description = model.plant, model.description
    frames = description.task_frames
    base = find_body(plant, description.base)
    taken = set()
    for side in SIDES:
        for point, last in (("foot", base), ("wrist", None)):
            body = find_frame(plant, frames[f"{side}_{point}"]).body()
            until = last or find_frame(plant, frames["neck"]).body()
            for joint in joints_between(model, body, until):
                taken |= set(links_outward(plant, joint.child_body().body_frame()))
    every = links_outward(plant, base.body_frame())
    welded = {b.name() for b in plant.GetBodiesWeldedTo(base)}
    own = [link for link in every if link in outlines and link in welded]
    upper = [
        link
        for link in every
        if link in outlines and link not in welded and link not in taken
    ]
    p_WB, p_WC, p_WN = (
        find_frame(plant, name).CalcPoseInWorld(_at_rest(model)).translation()
        for name in (description.base, frames["waist"], frames["neck"])
    )
    pitch, roll = _leans(model)
    return TrunkShape(
        pelvis=_points(model, own, outlines) - p_WB,
        waist=p_WC - p_WB,
        upper=_points(model, upper, outlines) - p_WC,
        neck=(p_WN - p_WC) / np.linalg.norm(p_WN - p_WC),
        pitch=pitch,
        roll=roll,
    )


def _leans(model: ControlModel) -> tuple[tuple[float, float], tuple[float, float]]:
    """How far the joints of the trunk can lean the neck: `TrunkShape`'s pitch, roll.

    Joints that turn it about the vertical are left at rest: they face the shoulders.
    """
    plant, description = model.plant, model.description
    context, rest = _at_rest(model), model.rest_positions()
    frames = [find_frame(plant, description.task_frames[k]) for k in ("waist", "neck")]
    base = find_body(plant, description.base)
    steps = []
    for joint in joints_between(model, frames[1].body(), base):
        at = joint.position_start()
        if isinstance(joint, RevoluteJoint) and at in model.controlled_positions:
            X = joint.frame_on_child().CalcPoseInWorld(context)
            if abs((X.rotation() @ joint.revolute_axis())[2]) < _UPRIGHT:
                steps.append((at, _within(joint, *_LEAN, _LEAN_STEPS)))
    leans = []
    for positions in itertools.product(*(values for _, values in steps)):
        q = rest.copy()
        q[[at for at, _ in steps]] = positions
        plant.SetPositions(context, q)
        p_C, p_N = (frame.CalcPoseInWorld(context).translation() for frame in frames)
        x, y, z = (p_N - p_C) / np.linalg.norm(p_N - p_C)
        leans.append((np.arctan2(x, z), np.arcsin(-y)))
    (pitch_low, roll_low), (pitch_high, roll_high) = np.min(leans, 0), np.max(leans, 0)
    return (float(pitch_low), float(pitch_high)), (float(roll_low), float(roll_high))


def _at_rest(model: ControlModel):
    context = model.MakeWorkspace().plant_context
    model.plant.SetPositions(context, model.rest_positions())
    return context


def _points(model: ControlModel, links, outlines) -> np.ndarray:
    """(V, 3) lowest points of the balls of some links, in the world, at rest [m]."""
    plant, context = model.plant, _at_rest(model)
    points = [np.empty((0, 3))]
    for link in links:
        X_WB = plant.EvalBodyPoseInWorld(context, find_body(plant, link))
        p_W = X_WB.multiply(outlines[link].points.T).T
        p_W[:, 2] -= outlines[link].radii
        points.append(p_W)
    return np.concatenate(points)


def _leg_frames(model: ControlModel, side: str) -> tuple[Frame, Frame, Frame]:
    """Of hip, knee and foot."""
    names = model.description.task_frames
    hip, knee, foot = (
        find_frame(model.plant, names[f"{side}_{part}"]) for part in LEG_FRAMES
    )
    return hip, knee, foot


def _reach(model: ControlModel, side: str, context) -> float:
    """The least distance from where the hip is at rest that a leg, stretched out as far
    as its knee goes, reaches.

    Joints of a hip whose axes do not meet move its centre a little.
    """
    plant = model.plant
    hip, knee, foot = _leg_frames(model, side)
    chain = leg_joints(model, side, "knee")
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


def _shortest(model: ControlModel, side: str) -> float:
    """How near a leg, its other joints at rest, has its foot to its hip [m]."""
    plant, description = model.plant, model.description
    hip, knee, foot = _leg_frames(model, side)
    chain = leg_joints(model, side, "knee")
    links = links_outward(plant, chain[-1].child_body().body_frame())
    rows = [i for i, pair in enumerate(description.pairs) if set(pair) <= set(links)]
    bend, workspace = chain[0], model.MakeWorkspace()
    q, context = model.rest_positions(), workspace.plant_context
    least = np.minimum(
        _BENT_ROOM, _NO_NEARER * model.evaluate_distances(workspace, q).d[rows]
    )
    found = np.inf
    low, high = _within(bend, -np.inf, np.inf, 2)
    for angle in np.linspace(low + _BENT_MARGIN, high - _BENT_MARGIN, _BENT_STEPS):
        q[bend.position_start()] = angle
        if (model.evaluate_distances(workspace, q).d[rows] >= least).all():
            plant.SetPositions(context, q)
            p_H, p_F = (f.CalcPoseInWorld(context).translation() for f in (hip, foot))
            found = min(found, float(np.linalg.norm(p_F - p_H)))
    return found if np.isfinite(found) else 0.0


def _within(joint, low: float, high: float, count: int) -> np.ndarray:
    """Positions between two bounds, as far as the joint's limits let."""
    lower = float(joint.position_lower_limits()[0])
    upper = float(joint.position_upper_limits()[0])
    return np.linspace(np.clip(low, lower, upper), np.clip(high, lower, upper), count)
