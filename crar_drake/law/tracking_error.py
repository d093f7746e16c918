"""What a robot that follows its command only within a bound needs to stay clear.

The corollary of `docs/theory/theorem.md`: where every joint j is within E_j of its
command, the distance of a pair of shapes is within sum_j rho_j E_j of that of the
command, rho_j the reach of (A3). A pair of capsules or spheres whose command is kept
farther apart by that sum is one of thicker capsules: so all distances of the law, the
floor's and the margin's, are those that are left for the robot.
"""

import numpy as np

from crar_drake.errors import ModelError, ScenarioError
from crar_drake.law.compilation import Held, hold
from crar_drake.law.parameters import LookaheadParameters
from crar_drake.law.path_bounds import Reaches, travel
from crar_drake.law.placed_shapes import shape_distances
from crar_drake.robot.description import find_joint
from crar_drake.robot.model import ControlModel

_WHERE = "controller.tracking_error"


def joint_errors(ahead: LookaheadParameters, model: ControlModel) -> np.ndarray:
    """E, how far each joint may be from its command: (nv,) [rad or m].

    In the order of `model.order`.

    Raises:
        ScenarioError: `tracking_errors` names a joint that the robot has not, or one
            that has not one position.
    """
    plant = model.plant
    errors = np.full(plant.num_velocities(), ahead.tracking_error)
    for name, error in ahead.tracking_errors.items():
        try:
            joint = find_joint(plant, name)
        except ModelError as why:
            raise ScenarioError(f"{_WHERE}s.{name}: {why}") from why
        if joint.num_velocities() != 1:
            raise ScenarioError(
                f"{_WHERE}s.{name}: the joint has {joint.num_velocities()} velocities; "
                "only those with one have a tracking error"
            )
        errors[joint.velocity_start()] = error
    return errors[model.order]


def distance_losses(errors: np.ndarray, reaches: Reaches) -> np.ndarray:
    """sum_j rho_j E_j: what errors can take of the pairs' distances, (Np,) [m].

    While commands keep slides within their limits. An error takes these beyond, which
    makes the reach of what carries them longer.

    Args:
        errors: (nv,) of `joint_errors`.
        reaches: of all pairs.
    """
    longer = np.tensordot(errors[reaches.slides], reaches.by, 1)
    return travel(errors, reaches.reach + longer)


def narrowed_limits(
    errors: np.ndarray, model: ControlModel
) -> tuple[np.ndarray, np.ndarray]:
    """The limits of the controlled joints that their commands keep: (n,), (n,).

    Raises:
        ScenarioError: nothing is left between two limits, or the rest posture is not
            there.
    """
    E = errors[: model.n]
    lower, upper = model.lower + E, model.upper - E
    rest = model.rest_positions()[model.controlled_positions]
    for i in np.flatnonzero(E):
        name = model.joint_names[i]
        limits = f"its limits, {model.lower[i]:g} and {model.upper[i]:g}"
        if not lower[i] < upper[i]:
            raise ScenarioError(
                f"{_WHERE}: {E[i]:g} of joint {name} leaves nothing between {limits}"
            )
        within = model.lower[i] <= rest[i] <= model.upper[i]
        if within and not lower[i] <= rest[i] <= upper[i]:
            raise ScenarioError(
                f"{_WHERE}: {E[i]:g} of joint {name} is more than its rest posture, "
                f"{rest[i]:g}, has to {limits}; lower it, or change the rest posture"
            )
    return lower, upper


def thickened(
    errors: np.ndarray, reaches: Reaches, floor: float, model: ControlModel
) -> tuple[Held, np.ndarray]:
    """The `Robot` of a model with shapes that are thicker by what errors can take of
    their pairs' distances; and that, (Np,) of `distance_losses` [m].

    Args:
        errors: (nv,) of `joint_errors`.
        reaches: of all pairs.
        floor: d_0 [m].
        model: of the robot.

    Raises:
        ScenarioError: a slide without limits is carried by a joint that errs, and
            nothing bounds how far from that joint's axis it takes shapes; or a pair
            keeps the floor in the rest posture, but not by as much as errors can take.
    """
    plant = model.plant
    limited = np.isfinite(plant.GetPositionLowerLimits())
    limited &= np.isfinite(plant.GetPositionUpperLimits())
    for k, slide in enumerate(reaches.slides):
        name = model.velocity_names[model.order[slide]]
        at = list(model.position_names).index(name)
        if not limited[at] and (reaches.by[k] @ errors).any():
            raise ScenarioError(
                f"{_WHERE}: joint {name} slides without limits, and what carries it "
                "errs: nothing bounds what that does to the shapes that it carries; "
                "give the joint limits, or what carries it no error (tracking_errors)"
            )
    losses, pairs = distance_losses(errors, reaches), model.pairs
    d = shape_distances(model.rest_positions()[np.newaxis], model.robot)[0]
    short = np.flatnonzero((d >= floor) & (d - losses < floor))
    if len(short):
        worst = short[np.argmin((d - floor)[short] / losses[short])]
        share = (d[worst] - floor) / losses[worst]
        a, b = pairs.names[pairs.pair_of_shapes[worst]]
        raise ScenarioError(
            f"{_WHERE}: in the rest posture {a} - {b} are {1e3 * d[worst]:.1f} mm "
            f"apart. The errors of their joints can take {1e3 * losses[worst]:.1f} mm "
            f"of it, and {1e3 * floor:.1f} mm are to be left; lower all errors to "
            f"{share:.2g} of these at most, or change the rest posture"
        )
    robot = model.robot.value
    shapes = robot.pairs.value
    nearer = {"radii": shapes.radii + losses, "balls": shapes.balls + losses}
    return hold(robot._replace(pairs=hold(shapes._replace(**nearer)))), losses
