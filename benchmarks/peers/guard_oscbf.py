"""OSCBF's law among spheres that move: barriers of velocities, by cbfpy."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.driver import Guard, Problem, Spheres, main
from benchmarks.peers.run_oscbf import Body, Velocities, cbfpy

OPEN = ("alpha", "keep", "told")  # settings that are no part of what is compiled


class Among(Velocities):
    """z = (q, centres), u = q_dot; the spheres' velocities and radii besides."""

    def __init__(self, body: Body, problem: Problem, settings: dict, count: int):
        self.n_joints = len(problem.joints)
        self.guarded = [s for link in problem.guarded for s in body.shapes[link]]
        self.count = count
        super().__init__(body, problem, settings)

    def extra(self) -> dict:
        still = jnp.zeros(3 * self.count)
        return {
            "n": self.n_joints + 3 * self.count,
            "init_args": (1.0, still, jnp.zeros(self.count)),
        }

    def f(self, z, alpha, velocities, radii):
        return jnp.concatenate([jnp.zeros(self.n_joints), velocities])

    def g(self, z, alpha, velocities, radii):
        n = self.n_joints
        return jnp.concatenate([jnp.eye(n), jnp.zeros((len(z) - n, n))])

    def h_1(self, z, alpha, velocities, radii):
        q, centres = z[: self.n_joints], z[self.n_joints :].reshape(-1, 3)
        apart = self.body.from_spheres(q, self.guarded, centres, radii, self.nearest)
        return jnp.concatenate([self.barriers(q), apart])

    def h_2(self, z, alpha, velocities, radii):
        return jnp.zeros(0)

    def alpha(self, h, alpha, velocities, radii):
        return alpha * h

    def alpha_2(self, h_2, alpha, velocities, radii):
        return h_2

    def P(self, z, u_des, alpha, velocities, radii):
        return 2.0 * jnp.eye(self.m)

    def q(self, z, u_des, alpha, velocities, radii):
        return -2.0 * u_des


class OscbfGuard(Guard):
    """Settings: those of `run_oscbf.Oscbf` for barriers; keep [m] from spheres; told,
    whether it knows how they move."""

    packages = ("cbfpy", "frax", "jax", "jaxlib", "qpax", "numpy")

    def __init__(self, problem: Problem, period: float, settings: dict) -> None:
        self.problem, self.settings = problem, settings

    def guard(self, q: np.ndarray, v: np.ndarray, spheres: Spheres) -> np.ndarray:
        fixed = {k: v for k, v in self.settings.items() if k not in OPEN}
        step = compiled_step(
            self.problem.folder,
            json.dumps(fixed, sort_keys=True),
            len(spheres.radii),
        )
        told = spheres.velocities if self.settings["told"] else 0.0 * spheres.centres
        alpha, radii = self.settings["alpha"], spheres.radii + self.settings["keep"]
        return np.asarray(step(q, v, spheres.centres, told, radii, alpha))


@cache
def compiled_step(folder: Path, settings: str, count: int) -> Callable[..., jax.Array]:
    """A step: q, the wanted v, and centres, velocities and radii of spheres, and alpha,
    to the command.

    Args:
        folder: of the problem.
        settings: the others, as JSON.
        count: of the spheres.
    """
    problem = Problem(folder)
    config = Among(Body(problem), problem, json.loads(settings), count)
    cbf = cbfpy.CBF.from_config(config)

    def step(q, v, centres, velocities, radii, alpha):
        z = jnp.concatenate([q, centres.ravel()])
        return cbf.safety_filter(z, v, alpha, velocities.ravel(), radii)

    return jax.jit(step)


if __name__ == "__main__":
    main(OscbfGuard)
