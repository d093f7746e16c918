"""OSCBF: control barrier functions by cbfpy over frax's kinematics, both in JAX.

The law of OSCBF, which itself is no package: of all velocities (or accelerations) that
keep the barriers, the one nearest to what the tasks ask for, as the tasks measure it.
frax knows spheres alone and cbfpy no shapes; distances of capsules are written here,
as functions that JAX differentiates.
"""

from __future__ import annotations

import copy
import json
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

# As both packages ask for; they have to know before they are imported.
os.environ.setdefault("JAX_ENABLE_X64", "1")
os.environ.setdefault("JAX_PLATFORMS", "cpu")
# What is compiled is kept for the next run.
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", os.path.join(tempfile.gettempdir(), "peers-jax")
)
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_multi_thread_eigen=false"
    " --xla_cpu_scheduler_type=CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
)

import cbfpy
import jax
import jax.numpy as jnp
import numpy as np
from frax.core.robot import Robot

from benchmarks.peers.driver import Controller, Problem, Targets, main

STOPS_IN = 0.01  # [s] an acceleration that is wanted would stop the fastest joint
SMALL = 1e-12  # [m^2] below which two points are one, for derivatives


class Shape(NamedTuple):
    """A capsule, or a sphere, that moves with a joint.

    Attributes:
        joint: its number, -1 for the world.
        ends: (2, 3) of its axis, in the joint's frame [m].
        radius: [m].
    """

    joint: int
    ends: np.ndarray
    radius: float


class Stack(NamedTuple):
    """Shapes one after the other: joints (N,), ends (N, 2, 3) and radii (N,) [m]."""

    joints: np.ndarray
    ends: np.ndarray
    radii: np.ndarray


class Body:
    """Task points and shapes of the problem's robot, by frax.

    Attributes:
        shapes: link to its shapes.
        first, second: of all watched pairs of shapes.
    """

    def __init__(self, problem: Problem) -> None:
        urdf = ET.parse(problem.folder / "robot_pinocchio.urdf").getroot()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "robot.urdf"
            path.write_bytes(ET.tostring(_with_inertias(urdf)))
            self.robot = Robot(str(path), joint_ordering=problem.joints)
        at = _placed_links(urdf, problem.joints)
        self.points = [
            (joint, X[:3, 3]) for joint, X in (at[link] for link in problem.links)
        ]
        self.shapes = _shapes(urdf, at)
        pairs = [
            (one, other)
            for a, b in problem.pairs
            for one in self.shapes[a]
            for other in self.shapes[b]
        ]
        self.first = _stacked([pair[0] for pair in pairs])
        self.second = _stacked([pair[1] for pair in pairs])

    def frames(self, q: jax.Array) -> jax.Array:
        """(n + 1, 4, 4) of the joints in the world; the world itself comes last."""
        moved = self.robot.joint_to_world_transforms(q)
        return jnp.concatenate([moved, jnp.eye(4)[None]])

    def task_points(self, q: jax.Array) -> jax.Array:
        """(tasks * 3,) in the world [m]."""
        X = self.frames(q)
        return jnp.concatenate([X[j, :3, :3] @ p + X[j, :3, 3] for j, p in self.points])

    def nearest(self, q: jax.Array, count: int) -> jax.Array:
        """(count,) the least distances of the watched pairs of shapes [m]."""
        X = self.frames(q)
        everything = _distances(jax.lax.stop_gradient(X), self.first, self.second)
        _, chosen = jax.lax.top_k(-everything, count)
        return _distances(X, *(_taken(x, chosen) for x in (self.first, self.second)))

    def from_spheres(
        self,
        q: jax.Array,
        links: list[Shape],
        centres: jax.Array,
        radii: jax.Array,
        count: int,
    ) -> jax.Array:
        """(count,) the least distances of shapes from N spheres [m].

        Args:
            q: (n,).
            links: the shapes.
            centres, radii: (N, 3), (N,) [m].
            count: at most all pairs.
        """
        X, shapes = self.frames(q), _stacked(links)
        one, other = (x.ravel() for x in np.indices((len(links), len(radii))))

        def apart(X, centres, one, other):
            points = jnp.stack([centres[other]] * 2, axis=1)
            shape = _taken(shapes, one)
            away = segment_distances(_moved(X, shape), points)
            return away - shape.radii - radii[other]

        fixed = [jax.lax.stop_gradient(x) for x in (X, centres)]
        _, chosen = jax.lax.top_k(-apart(*fixed, one, other), min(count, len(one)))
        return apart(X, centres, jnp.asarray(one)[chosen], jnp.asarray(other)[chosen])


def _distances(X: jax.Array, first: Stack, second: Stack) -> jax.Array:
    """(N,) of pairs of shapes, with the joints' frames at X [m]."""
    apart = segment_distances(_moved(X, first), _moved(X, second))
    return apart - first.radii - second.radii


def segment_distances(first: jax.Array, second: jax.Array) -> jax.Array:
    """(N,) distances of segments (N, 2, 3): C. Ericson, Real-Time Collision Detection,
    5.1.9, without its cases, so that JAX differentiates it twice."""
    d1, d2 = first[:, 1] - first[:, 0], second[:, 1] - second[:, 0]
    r = first[:, 0] - second[:, 0]
    a, e = jnp.sum(d1 * d1, axis=1) + SMALL, jnp.sum(d2 * d2, axis=1) + SMALL
    b, c, f = (jnp.sum(x * y, axis=1) for x, y in ((d1, d2), (d1, r), (d2, r)))
    s = jnp.clip((b * f - c * e) / (a * e - b * b + SMALL), 0.0, 1.0)
    t = jnp.clip((b * s + f) / e, 0.0, 1.0)
    s = jnp.clip((b * t - c) / a, 0.0, 1.0)
    apart = r + s[:, None] * d1 - t[:, None] * d2
    return jnp.sqrt(jnp.sum(apart * apart, axis=1) + SMALL)


class Velocities(cbfpy.config.cbf_config.CBFConfig):
    """z = q, u = q_dot; barriers: distances, and limits of the joints.

    What all are given besides z is alpha [1/s], so that it is no part of what is
    compiled.
    """

    def __init__(self, body: Body, problem: Problem, settings: dict) -> None:
        self.body, self.settings = body, settings
        self.nearest = min(settings["nearest"], len(body.first.joints))
        n = len(problem.joints)
        self.low, self.high = _finite(problem.lower), _finite(problem.upper)
        self.lower, self.upper = problem.lower[self.low], problem.upper[self.high]
        self.set_limits(problem.velocity_limits)
        super().__init__(
            m=n,
            **({"n": self.states * n} | self.extra()),
            relax_qp=settings["penalty"] is not None,
            cbf_relaxation_penalty=settings["penalty"] or 0.0,
            control_relaxation_penalty=1e2 * (settings["penalty"] or 0.0),
            solver_tol=settings["tolerance"],
            **self.bounds,
        )

    states = 1

    def extra(self) -> dict:
        """What else cbfpy is told."""
        return {"init_args": (1.0,)}

    def set_limits(self, fastest: np.ndarray) -> None:
        """Of the joints' speed (n,) [rad/s]."""
        self.fastest, self.bounds = fastest, {"u_min": -fastest, "u_max": fastest}

    def f(self, z, alpha):
        return jnp.zeros_like(z)

    def g(self, z, alpha):
        return jnp.eye(len(z))

    def h_1(self, z, alpha):
        return self.barriers(z)

    def alpha(self, h, alpha):
        return alpha * h

    def P(self, z, u_des, alpha):
        return 2.0 * metric(self.body, z[: self.m], self.settings["damping"])

    def q(self, z, u_des, alpha):
        return -self.P(z, u_des, alpha) @ u_des

    def barriers(self, q):
        """The least distances less the margin [m], and the ways to the limits [rad]."""
        least = self.body.nearest(q, self.nearest)
        return jnp.concatenate(
            [
                least - self.settings["margin"],
                q[self.low] - self.lower,
                self.upper - q[self.high],
            ]
        )


class Accelerations(Velocities):
    """z = (q, q_dot), u = q_ddot; the same barriers, and bounds of the speeds."""

    states = 2

    def set_limits(self, fastest: np.ndarray) -> None:
        self.fastest, self.bounds = fastest, {}

    def f(self, z, alpha):
        return jnp.concatenate([z[len(z) // 2 :], jnp.zeros(len(z) // 2)])

    def g(self, z, alpha):
        n = len(z) // 2
        return jnp.concatenate([jnp.zeros((n, n)), jnp.eye(n)])

    def h_1(self, z, alpha):
        v = z[len(z) // 2 :]
        return jnp.concatenate([self.fastest - v, self.fastest + v])

    def h_2(self, z, alpha):
        return self.barriers(z[: len(z) // 2])

    def alpha_2(self, h_2, alpha):
        return alpha * h_2


def metric(body: Body, q: jax.Array, damping: float) -> jax.Array:
    """(n, n): how far the tasks are from what they want, and a little of all joints."""
    J = jax.jacfwd(body.task_points)(q)
    return J.T @ J + damping * jnp.eye(len(q))


class Oscbf(Controller):
    """Settings: order 1 (velocities) or 2 (accelerations), gain [1/s] of the tasks,
    damping and posture gain [1/s], margin [m], so many of the
    nearest pairs of shapes, alpha [1/s] of the barriers, penalty of
    a barrier that gives way (null for none that does), tolerance of the solver."""

    packages = ("cbfpy", "frax", "jax", "jaxlib", "qpax", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.commands = "acceleration" if settings["order"] == 2 else "velocity"
        self.tasks = len(problem.links)
        self.numbers = np.array([settings["gain"], settings["alpha"]])
        fixed = settings | {"gain": 0.0, "alpha": 0.0}
        self.step = compiled_step(problem.folder, json.dumps(fixed, sort_keys=True))

    def reset(self, q: np.ndarray) -> None:
        still = np.zeros((self.tasks, 3))
        self.solve(q, np.zeros_like(q), Targets(still, still, still, still))  # compiles

    def solve(self, q: np.ndarray, v: np.ndarray, targets: Targets) -> np.ndarray:
        given = (targets.p, targets.v_step, targets.v, targets.a)
        return np.asarray(self.step(q, v, *(x.ravel() for x in given), self.numbers))


@cache
def compiled_step(folder: Path, settings: str) -> Callable[..., jax.Array]:
    """A step: q, v, the targets of `Targets`, and gain and alpha, to the command.

    Args:
        folder: of the problem.
        settings: the others, as JSON.
    """
    problem, settings = Problem(folder), json.loads(settings)
    body = Body(problem)
    second_order = settings["order"] == 2
    config = (Accelerations if second_order else Velocities)(body, problem, settings)
    cbf = cbfpy.CBF.from_config(config)
    posture, damping, rest = (
        settings["posture_gain"],
        settings["damping"],
        problem.rest,
    )
    # The solver finds nothing near a wish that is beyond all sense.
    fastest = problem.velocity_limits

    def velocities(q, v, p_d, v_step, v_d, a_d, numbers):
        gain, alpha = numbers
        J = jax.jacfwd(body.task_points)(q)
        wanted = v_step + gain * (p_d - body.task_points(q))
        u = _nearest(J, wanted, posture * (rest - q), damping)
        u = jnp.clip(u, -fastest, fastest)
        return cbf.safety_filter(q, u, alpha)

    def accelerations(q, v, p_d, v_step, v_d, a_d, numbers):
        gain, alpha = numbers

        def velocity(x):
            return jax.jvp(body.task_points, (x,), (v,))[1]

        J = jax.jacfwd(body.task_points)(q)
        drift, bias = jax.jvp(velocity, (q,), (v,))
        error = p_d - body.task_points(q)
        wanted = a_d + 2.0 * gain * (v_d - drift) + gain**2 * error - bias
        rests = posture**2 * (rest - q) - 2.0 * posture * v
        u = _nearest(J, wanted, rests, damping)
        u = jnp.clip(u, -fastest / STOPS_IN, fastest / STOPS_IN)
        return cbf.safety_filter(jnp.concatenate([q, v]), u, alpha)

    return jax.jit(accelerations if second_order else velocities)


def _nearest(J, wanted, rests, damping):
    """(n,) of the least squares of tasks and posture."""
    left = J.T @ J + damping * jnp.eye(J.shape[1])
    return jnp.linalg.solve(left, J.T @ wanted + damping * rests)


def _with_inertias(robot: ET.Element) -> ET.Element:
    """frax reads no robot whose links have none; nothing here depends on them."""
    robot = copy.deepcopy(robot)
    for link in robot.findall("link"):
        if link.find("inertial") is None:
            inertial = ET.SubElement(link, "inertial")
            ET.SubElement(inertial, "origin", {"xyz": "0 0 0", "rpy": "0 0 0"})
            ET.SubElement(inertial, "mass", {"value": "1e-6"})
            zero = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            some = dict.fromkeys(("ixx", "iyy", "izz"), "1e-9")
            ET.SubElement(inertial, "inertia", zero | some)
    return robot


def _finite(limits: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.isfinite(limits))


def _moved(X: jax.Array, shapes: Stack) -> jax.Array:
    """(N, 2, 3) ends in the world [m]."""
    turned = jnp.einsum("nij,nkj->nki", X[shapes.joints, :3, :3], shapes.ends)
    return turned + X[shapes.joints, None, :3, 3]


def _taken(shapes: Stack, chosen: jax.Array) -> Stack:
    """Some of the shapes."""
    return Stack(*(jnp.asarray(array)[chosen] for array in shapes))


def _stacked(shapes: list[Shape]) -> Stack:
    return Stack(*(np.array(values) for values in zip(*shapes, strict=True)))


def _placed_links(
    robot: ET.Element, joints: list[str]
) -> dict[str, tuple[int, np.ndarray]]:
    """Each link: the joint that moves it, -1 for none, and its pose in that frame."""
    above = {
        joint.find("child").get("link"): joint
        for joint in robot.iter("joint")
        if joint.find("child") is not None
    }
    placed: dict[str, tuple[int, np.ndarray]] = {}

    def place(link: str) -> tuple[int, np.ndarray]:
        if link not in placed:
            joint = above.get(link)
            if joint is None:
                placed[link] = -1, np.eye(4)
            elif joint.get("type") == "fixed":
                number, X = place(joint.find("parent").get("link"))
                placed[link] = number, X @ _pose(joint)
            else:
                placed[link] = joints.index(joint.get("name")), np.eye(4)
        return placed[link]

    for link in robot.findall("link"):
        place(link.get("name"))
    return placed


def _shapes(
    robot: ET.Element, at: dict[str, tuple[int, np.ndarray]]
) -> dict[str, list[Shape]]:
    """Link to its capsules and spheres."""
    made: dict[str, list[Shape]] = {}
    for link in robot.findall("link"):
        joint, X = at[link.get("name")]
        for collision in link.findall("collision"):
            (shape,) = collision.find("geometry")
            half = 0.5 * float(shape.get("length", 0.0))
            in_shape = np.array([[0.0, 0.0, half, 1.0], [0.0, 0.0, -half, 1.0]])
            ends = (in_shape @ (X @ _pose(collision)).T)[:, :3]
            made.setdefault(link.get("name"), []).append(
                Shape(joint, ends, float(shape.get("radius")))
            )
    return made


def _pose(element: ET.Element) -> np.ndarray:
    """(4, 4) of its origin."""
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    x, y, z = (float(angle) for angle in given.get("rpy", "0 0 0").split())
    X = np.eye(4)
    cos, sin = np.cos, np.sin
    Rx = [[1, 0, 0], [0, cos(x), -sin(x)], [0, sin(x), cos(x)]]
    Ry = [[cos(y), 0, sin(y)], [0, 1, 0], [-sin(y), 0, cos(y)]]
    Rz = [[cos(z), -sin(z), 0], [sin(z), cos(z), 0], [0, 0, 1]]
    X[:3, :3] = np.array(Rz) @ np.array(Ry) @ np.array(Rx)
    X[:3, 3] = [float(x) for x in given.get("xyz", "0 0 0").split()]
    return X


if __name__ == "__main__":
    main(Oscbf)
