"""Of a compiled MJCF: bodies' geoms as shapes, motors' limits, a rest posture."""

from collections.abc import Mapping

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.robot_import.source_robot import Shape, Triangles

_HIDDEN_GROUP = 3  # MuJoCo's viewer shows the geoms of groups below it
_DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # of a geom without a colour


def kind_of(enumeration: str, value: int) -> str:
    """What MuJoCo calls a value of an enumeration, as "hinge" one of "mjtJoint"."""
    import mujoco

    # "mjJNT_HINGE"
    return getattr(mujoco, enumeration)(int(value)).name.partition("_")[2].lower()


def body_shapes(
    model, body: int, link: str, notes: list[str]
) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
    """What is seen of a body, and what collides, in the body's frame.

    Args:
        notes: gets a line for each geom that has no volume of its own.
    """
    first = int(model.body_geomadr[body])
    seen, hidden, colliding = {}, {}, {}
    for geom in range(first, first + int(model.body_geomnum[body])):
        shape = _shape(model, geom, link, notes)
        if shape is None:
            continue
        # The same mesh is often there twice, to be seen and to collide.
        key = (
            *(int(model.geom_type[geom]), int(model.geom_dataid[geom])),
            *np.round(model.geom_size[geom], 6),
            *np.round(shape.X_LG.GetAsMatrix34().ravel(), 6),
        )
        group, alpha = model.geom_group[geom], (shape.rgba or _DEFAULT_RGBA)[3]
        if group < _HIDDEN_GROUP and alpha > 0.0:
            seen.setdefault(key, shape)
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        (colliding if collides else hidden).setdefault(key, shape)
    if not seen and not colliding:
        seen = hidden
    return tuple(seen.values()), tuple(colliding.values())


def _shape(model, geom: int, link: str, notes: list[str]) -> Shape | None:
    """A geom; None where it has no volume of its own."""
    kind = kind_of("mjtGeom", model.geom_type[geom])
    a, b, c = (float(v) for v in model.geom_size[geom])
    makers = {
        "sphere": lambda: Sphere(a),
        "capsule": lambda: Capsule(a, 2 * b),
        "cylinder": lambda: Cylinder(a, 2 * b),
        "box": lambda: Box(2 * a, 2 * b, 2 * c),
        "ellipsoid": lambda: Ellipsoid(a, b, c),
        "mesh": lambda: _triangles(model, geom),
    }
    if kind not in makers:
        notes.append(f"link {link}: a shape of kind {kind} is left out")
        return None
    return Shape(pose_of(model, "geom", geom), makers[kind](), _colour(model, geom))


def _triangles(model, geom: int) -> Triangles:
    """A mesh as MuJoCo has it: scaled, in its own inertial frame."""
    mesh = int(model.geom_dataid[geom])
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    return np.array(vertices, dtype=float), np.array(faces)


def _colour(model, geom: int) -> tuple[float, ...] | None:
    """A geom's own colour, else its material's."""
    material = int(model.geom_matid[geom])
    rgba = tuple(float(v) for v in model.geom_rgba[geom])
    if np.allclose(rgba, _DEFAULT_RGBA):
        if material < 0:
            return None
        rgba = tuple(float(v) for v in model.mat_rgba[material])
    return tuple(round(min(max(v, 0.0), 1.0), 4) for v in rgba)


def pose_of(model, kind: str, index: int) -> RigidTransform:
    """Of a body, geom or site, in its body's (a body: its parent's) frame."""
    wxyz = np.array(getattr(model, f"{kind}_quat")[index])
    p = np.array(getattr(model, f"{kind}_pos")[index])
    R = RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz)))
    return RigidTransform(R, p)


def effort_limits(model) -> dict[int, float]:
    """Joint to its largest torque or force [Nm or N]; those without one are absent.

    A joint's actuators add up; what the joint itself admits (actuatorfrcrange) is
    beyond them. Of two different bounds the nearer one counts, since an effort limit
    has but one.
    """
    by_actuators: dict[int, float] = {}
    for actuator in range(model.nu):
        carrier = kind_of("mjtTrn", model.actuator_trntype[actuator])
        if carrier in ("joint", "jointinparent"):
            joint = int(model.actuator_trnid[actuator][0])
            most = _largest_force(model, actuator)
            by_actuators[joint] = by_actuators.get(joint, 0.0) + most
    limits = {}
    for joint in range(model.njnt):
        most = by_actuators.get(joint, np.inf)
        if model.jnt_actfrclimited[joint]:
            most = min(most, _nearer(model.jnt_actfrcrange[joint]))
        if np.isfinite(most) and most > 0.0:
            limits[joint] = float(most)
    return limits


def _largest_force(model, actuator: int) -> float:
    """Of one actuator at its joint; infinite where nothing bounds it."""
    most = np.inf
    if model.actuator_forcelimited[actuator]:
        most = _nearer(model.actuator_forcerange[actuator])
    # A motor's force is its control times a gain; a servo's depends on the error.
    motor = (
        kind_of("mjtGain", model.actuator_gaintype[actuator]) == "fixed"
        and kind_of("mjtBias", model.actuator_biastype[actuator]) == "none"
        and kind_of("mjtDyn", model.actuator_dyntype[actuator]) != "integrator"
    )
    if motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator][0]))
        most = min(most, gain * _nearer(model.actuator_ctrlrange[actuator]))
    return most * abs(float(model.actuator_gear[actuator][0]))


def _nearer(bounds: np.ndarray) -> float:
    """The one of a lower and an upper bound that is nearer to zero."""
    lower, upper = (float(v) for v in bounds)
    return min(-lower, upper) if lower < 0.0 < upper else max(abs(lower), abs(upper))


_NAMES = ("home", "rest", "neutral", "stand")  # best first


def keyframe_posture(model, joint_names: Mapping[int, str]) -> dict[str, float]:
    """Joint to position [rad or m] in the keyframe that shows the robot at rest.

    It is the one of the first name in `_NAMES` that there is, else the file's first.
    Empty where there is no keyframe, or all of it is zero.

    Args:
        joint_names: index in the model to name, of the robot's joints; ball and free
            joints are left out.
    """
    if not model.nkey:
        return {}
    keys = [model.key(i).name.lower() for i in range(model.nkey)]
    index = next((keys.index(name) for name in _NAMES if name in keys), 0)
    q = np.array(model.key_qpos[index])
    posture = {
        name: round(float(q[model.jnt_qposadr[joint]]), 6)
        for joint, name in joint_names.items()
        if kind_of("mjtJoint", model.jnt_type[joint]) in ("hinge", "slide")
    }
    return posture if any(posture.values()) else {}
