"""Can the meshes of two links meet within the limits of the joints between them?

    python -m benchmarks.mesh_range g1_whole_body pelvis,left_hip_roll_link ...
        [--page docs/measurements/whole-body.md]

The triangles are asked over a grid of these joints, from limit to limit; the others are
at rest. Where links meet that are built so near each other that nobody watches them,
it is for the motion to stay away from there.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from benchmarks.page import Benchmark, Table, run
from crar_drake.errors import CrarError
from crar_drake.judging.mesh_judge import MeshJudge
from crar_drake.robot.description import (
    RobotDescription,
    find_body,
    load_robot_description,
)
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import position_tasks

HEADER = (
    "links",
    "at rest",
    "configurations in which they meet",
    "smallest distance",
    "where [rad]",
)


def main(argv: Sequence[str] | None = None) -> None:
    """Reports what the command line asks for."""
    benchmark = Benchmark("benchmarks.mesh_range", __doc__, "whole-body")
    parser = benchmark.parser
    parser.add_argument("robot", help="its name or folder")
    parser.add_argument(
        "pairs", nargs="+", metavar="INNER,OUTER", help="two links, the inner one first"
    )
    parser.add_argument("--steps", type=int, default=19, help="of each joint")
    arguments = benchmark.parse(argv, lambda _: "mesh range")
    description = load_robot_description(arguments.robot)
    rows = []
    for pair in arguments.pairs:
        links = pair.split(",")
        if len(links) != 2:
            raise CrarError(f"{pair!r}: give two links with a comma between")
        rest, joints, values, distances = mesh_range(
            description, *links, arguments.steps
        )
        deepest = np.unravel_index(distances.argmin(), distances.shape)
        rows.append(
            [
                ", ".join(links),
                f"{1e3 * rest:.1f} mm",
                f"{np.sum(distances < 0.0)} of {distances.size}",
                f"{1e3 * distances.min():.1f} mm",
                ", ".join(
                    f"{joint} {of[k]:.2f}"
                    for joint, of, k in zip(joints, values, deepest, strict=True)
                ),
            ]
        )
    benchmark.report([Table(HEADER, rows)])


def mesh_range(
    description: RobotDescription, inner: str, outer: str, steps: int
) -> tuple[float, list[str], list[np.ndarray], np.ndarray]:
    """Distances of two links over a grid of the joints between them.

    Args:
        description: of the robot.
        inner, outer: the links; the outer one hangs on the inner one.
        steps: values of each joint, from limit to limit.

    Returns:
        Their distance at rest [m]; the joints, from the inner link out; the values of
        each [rad]; and the distances, an axis a joint [m].
    """
    frame = next(iter(description.task_frames))
    model = ControlModel.FromDescription(description, position_tasks([frame]))
    plant, judge = model.plant, MeshJudge(description)
    joints = _joints_between(plant, *(find_body(plant, x) for x in (inner, outer)))
    places = [joint.position_start() for joint in joints]
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    values = [np.linspace(lower[k], upper[k], steps) for k in places]
    q = model.rest_positions()
    rest = judge.distance(q, inner, outer)
    distances = []
    for point in itertools.product(*values):
        q[places] = point
        distances.append(judge.distance(q, inner, outer))
    shape = [steps] * len(joints)
    names = [joint.name() for joint in joints]
    return rest, names, values, np.reshape(distances, shape)


def _joints_between(plant: MultibodyPlant, inner: RigidBody, body: RigidBody) -> list:
    """Joints with one position from one link out to another, which hangs on it."""
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    by_child = {joint.child_body().index(): joint for joint in joints}
    chain = []
    while body.index() != inner.index():
        joint = by_child[body.index()]
        chain.insert(0, joint)
        body = joint.parent_body()
    return [joint for joint in chain if joint.num_positions() == 1]


if __name__ == "__main__":
    run(main)
