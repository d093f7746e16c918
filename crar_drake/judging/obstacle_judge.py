"""The independent judge of contacts with obstacles that move.

Poses and velocities are Drake's, distances and speeds this file's own: nothing of the
filter takes part. A violation is a contact (distance at most 0) while the surface of
the link is faster there than is harmless.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import Capsule, SceneGraph, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from crar_drake.errors import plural
from crar_drake.robot.description import find_body

# What rounding adds to a speed [1].
_ROUNDING = 1e-9


class Surface:
    """A link's spheres and capsules: where they are, and how fast, by Drake.

    Attributes:
        body: the link.
        shapes: (S, 2, 3) ends of their axes in its frame [m].
        radii: (S,) [m].
        reach: from the frame's origin to what is farthest from it [m].
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody
    ) -> None:
        self.body, shapes, radii = body, [], []
        inspector = scene_graph.model_inspector()
        for geometry in plant.GetCollisionGeometriesForBody(body):
            shape, X = inspector.GetShape(geometry), inspector.GetPoseInFrame(geometry)
            if isinstance(shape, Sphere | Capsule):
                half = shape.length() / 2 if isinstance(shape, Capsule) else 0.0
                ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
                shapes.append(X.translation() + ends @ X.rotation().matrix().T)
                radii.append(shape.radius())
        self.shapes, self.radii = np.array(shapes).reshape(-1, 2, 3), np.array(radii)
        far = np.linalg.norm(self.shapes, axis=2).max(axis=1, initial=0.0)
        self.reach = float((far + self.radii).max(initial=0.0))

    def against(
        self,
        context,
        centres: np.ndarray,
        sizes: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) of N spheres, and (N,) how fast the surface is where it is
        nearest to each [m], [m/s].

        In a contact that is the point of the surface towards the obstacle.
        """
        X = self.body.EvalPoseInWorld(context)
        V = self.body.EvalSpatialVelocityInWorld(context)
        R, p = X.rotation().matrix(), X.translation()
        a = p + self.shapes[:, 0] @ R.T  # (S, 3)
        u = (self.shapes[:, 1] - self.shapes[:, 0]) @ R.T
        to = centres[:, None] - a  # (N, S, 3)
        uu = np.maximum((u * u).sum(-1), 1e-30)
        share = np.clip((to * u).sum(-1) / uu, 0.0, 1.0)
        axis = a + share[..., None] * u
        off = centres[:, None] - axis
        far = np.linalg.norm(off, axis=-1)
        d = far - self.radii - sizes[:, None]
        k = np.argmin(d, axis=1)
        every = np.arange(len(centres))
        off, axis, d = off[every, k], axis[every, k], d[every, k]
        towards = off / np.maximum(np.linalg.norm(off, axis=1), 1e-12)[:, None]
        point = axis + self.radii[k][:, None] * towards
        v = V.translational() + np.cross(V.rotational(), point - p)
        return d, np.linalg.norm(v, axis=1)


@dataclass(frozen=True)
class ObstacleFigures:
    """What one obstacle did."""

    smallest_distance: float  # of a watched link [m]
    link: str  # that one
    time: float  # when [s]
    contact_samples: int  # in which it touches a link
    fast_contacts: int  # those in which that link is faster there than `contact_speed`
    fastest_contact: float  # the largest speed of a link where it was touched [m/s]

    def in_words(self) -> str:
        """Where it was nearest, and how fast links were that it touched."""
        text = f"{self.link}, at {self.time:.2f} s"
        if self.contact_samples:
            text += (
                f"; touches in {plural(self.contact_samples, 'sample')} a link that "
                f"moves at up to {1e3 * self.fastest_contact:.0f} mm/s"
            )
        return text


class ObstacleJudge:
    """Judges links and spheres, on a plant's context of its own.

    Attributes:
        surfaces: of the links that have spheres or capsules.
    """

    def __init__(
        self, plant: MultibodyPlant, scene_graph: SceneGraph, links: Iterable[str]
    ) -> None:
        """
        Args:
            plant: finalized.
            scene_graph: where it is registered.
        """
        self._plant, self._context = plant, plant.CreateDefaultContext()
        bodies = [find_body(plant, name) for name in dict.fromkeys(links)]
        surfaces = [Surface(plant, scene_graph, body) for body in bodies]
        self.surfaces = [surface for surface in surfaces if len(surface.radii)]

    def look(
        self,
        q: np.ndarray,
        v: np.ndarray,
        centres: np.ndarray,
        sizes: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(L, N) distances and (L, N) speeds there [m], [m/s].

        Args:
            q, v: (nq,), (nv,) the state.
            centres, sizes: (N, 3), (N,) of the spheres [m].
        """
        self._place(q, v)
        found = [s.against(self._context, centres, sizes) for s in self.surfaces]
        return np.array([d for d, _ in found]), np.array([v for _, v in found])

    def places(self) -> np.ndarray:
        """(L, 3) the middles of the links, where they were looked at last [m]."""
        middles = [surface.shapes.mean(axis=(0, 1)) for surface in self.surfaces]
        poses = [s.body.EvalPoseInWorld(self._context) for s in self.surfaces]
        return np.array([X.multiply(p) for X, p in zip(poses, middles, strict=True)])

    def judge(
        self,
        time: np.ndarray,
        q: np.ndarray,
        v: np.ndarray,
        spheres: np.ndarray,
        harmless: float,
    ) -> list[ObstacleFigures]:
        """Judges a trajectory, by sphere.

        Args:
            time: (T,) of the samples [s].
            q, v: (T, nq), (T, nv) the states.
            spheres: (T, N, 4) centre and radius of each [m].
            harmless: the speed that is [m/s].
        """
        count = spheres.shape[1]
        low, link, at = np.full(count, np.inf), [""] * count, np.zeros(count, int)
        touching, violations = np.zeros(count, int), np.zeros(count, int)
        fastest = np.zeros(count)
        for k in range(len(q)):
            self._place(q[k], v[k])
            centres, sizes = spheres[k, :, :3], spheres[k, :, 3]
            touched, harmed = np.zeros(count, bool), np.zeros(count, bool)
            for surface in self.surfaces:
                origin = surface.body.EvalPoseInWorld(self._context).translation()
                bound = np.linalg.norm(centres - origin, axis=1) - surface.reach - sizes
                if (bound >= np.maximum(low, 0.0)).all():
                    continue  # neither touched nor nearer than before
                d, speed = surface.against(self._context, centres, sizes)
                for i in np.flatnonzero(d < low):
                    low[i], link[i], at[i] = d[i], surface.body.name(), k
                touches = d <= 0.0
                touched |= touches
                harmed |= touches & (speed > harmless * (1.0 + _ROUNDING))
                fastest = np.where(touches, np.maximum(fastest, speed), fastest)
            touching += touched
            violations += harmed
        return [
            ObstacleFigures(*found)
            for found in zip(
                *(low.tolist(), link, time[at].tolist(), touching.tolist()),
                *(violations.tolist(), fastest.tolist()),
                strict=True,
            )
        ]

    def _place(self, q: np.ndarray, v: np.ndarray) -> None:
        self._plant.SetPositions(self._context, q)
        self._plant.SetVelocities(self._context, v)
