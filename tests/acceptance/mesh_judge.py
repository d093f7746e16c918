"""Judges a robot's postures by the triangles of its own file, by libraries of others.

The URDF is read as XML, its meshes by trimesh, and python-fcl says which triangles
cross. Nothing here knows the product. A length is in metres, an angle in radians.
"""

import itertools
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from importlib.metadata import distribution
from pathlib import Path

import fcl
import numpy as np
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

EXAMPLES = "example-robot-data"  # the package whose files have the robots of the tests
DEEP = 1e-3  # what is this deep is a penetration [m]


def example(path: str) -> Path:
    """A file of the package of example robots, below its `robots`."""
    prefix = f"cmeel.prefix/share/{EXAMPLES}/robots"
    return Path(str(distribution(EXAMPLES).locate_file(f"{prefix}/{path}")))


def limits(urdf: Path) -> dict[str, tuple[float, ...]]:
    """Lower and upper limit, effort and speed of a URDF's joints that have limits."""
    keys = ("lower", "upper", "effort", "velocity")
    return {
        joint.get("name"): tuple(
            float(joint.find("limit").get(key, 0.0)) for key in keys
        )
        for joint in ElementTree.parse(urdf).getroot().iter("joint")
        if joint.find("limit") is not None
    }


class Robot:
    """A URDF's links, joints and meshes.

    Attributes:
        joints: (n,) names of the joints that move, down one limb after the other.
        lower, upper, speed: (n,) their limits.
    """

    def __init__(self, urdf: Path) -> None:
        root = ElementTree.parse(urdf).getroot()
        # Of each link: its parent, the number of the joint that turns it or None, its
        # place in the parent, and the axis; parents come first.
        self._links: dict[str, tuple[str, int | None, np.ndarray, np.ndarray]] = {}
        self.joints: list[str] = []
        joints = list(root.iter("joint"))
        children = {joint.find("child").get("link") for joint in joints}
        names = [link.get("name") for link in root.findall("link")]
        (base,) = (name for name in names if name not in children)
        self._links[base] = "", None, np.eye(4), np.zeros(3)

        def descend(parent: str) -> None:
            for joint in joints:
                if joint.find("parent").get("link") != parent:
                    continue
                number, axis = None, np.zeros(3)
                if joint.get("type") != "fixed":
                    assert joint.get("type") == "revolute", joint.get("type")
                    number, axis = len(self.joints), _three(joint.find("axis"), "xyz")
                    self.joints.append(joint.get("name"))
                link = joint.find("child").get("link")
                self._links[link] = parent, number, _place(joint), axis
                descend(link)

        descend(base)
        said = limits(urdf)
        self.lower, self.upper, _, self.speed = np.array(
            [said[j] for j in self.joints]
        ).T
        self._meshes = _meshes(root, urdf)
        self._objects = {name: _fcl_object(m) for name, m in self._meshes.items()}
        self._hulls = {
            name: mesh.vertices[ConvexHull(mesh.vertices).vertices]
            for name, mesh in self._meshes.items()
        }

    def poses(self, q: np.ndarray, X_WR: np.ndarray | None = None) -> dict:
        """(T, 4, 4) poses of the links at (T, n) joints, in the root link's frame or,
        with the root's (T, 4, 4) poses, in the world."""
        found: dict[str, np.ndarray] = {}
        for name, (parent, joint, place, axis) in self._links.items():
            if not parent:
                found[name] = np.tile(place, (len(q), 1, 1)) if X_WR is None else X_WR
                continue
            found[name] = found[parent] @ place
            if joint is not None:
                turn = np.tile(np.eye(4), (len(q), 1, 1))
                vectors = q[:, joint, None] * axis / np.linalg.norm(axis)
                turn[:, :3, :3] = Rotation.from_rotvec(vectors).as_matrix()
                found[name] = found[name] @ turn
        return found

    def point(
        self, poses: Mapping, link: str, p: tuple = (0.0, 0.0, 0.0)
    ) -> np.ndarray:
        """(T, 3) places of a point that is fixed in a link."""
        return poses[link][:, :3, 3] + poses[link][:, :3, :3] @ np.array(p)

    def lowest(self, poses: Mapping) -> np.ndarray:
        """(T,) the height of the lowest vertex."""
        heights = [
            (poses[name][:, 2, :3] @ hull.T).min(axis=1) + poses[name][:, 2, 3]
            for name, hull in self._hulls.items()
        ]
        return np.min(heights, axis=0)

    def pairs(self, *built: np.ndarray, beyond: int = 1) -> set[tuple[str, str]]:
        """Links with meshes and more than so many joints between, less those that meet
        in all of the given (n,) postures: they do as they are built."""
        ways = {name: list(self._way(name)) for name in self._meshes}
        pairs = {
            (a, b)
            for a, b in itertools.combinations(self._meshes, 2)
            if len(set(ways[a]) ^ set(ways[b])) > beyond
        }
        meet = [set(self._crossing(q[None], pairs, 0.0)) for q in built]
        return pairs - {
            pair
            for pair in pairs
            if meet and all((0, *pair) in found for found in meet)
        }

    def penetrating(self, q: np.ndarray, pairs: set) -> list[tuple[int, str, str]]:
        """The postures, of (T, n), and the pairs whose meshes are `DEEP` in each other:
        none of 26 shifts by so much parts them."""
        return list(self._crossing(q, pairs, DEEP))

    def _way(self, link: str) -> Iterator[int]:
        """The joints from the base to a link."""
        while link:
            link, joint = self._links[link][:2]
            if joint is not None:
                yield joint

    def _crossing(
        self, q: np.ndarray, pairs: set, depth: float
    ) -> Iterator[tuple[int, str, str]]:
        poses = self.poses(q)
        middles = {name: m.bounds.mean(axis=0) for name, m in self._meshes.items()}
        radii = {
            name: np.linalg.norm(mesh.vertices - middles[name], axis=1).max()
            for name, mesh in self._meshes.items()
        }
        places = {name: self.point(poses, name, middles[name]) for name in middles}
        for a, b in sorted(pairs):
            apart = np.linalg.norm(places[a] - places[b], axis=1)
            for t in np.flatnonzero(apart < radii[a] + radii[b]):
                if self._parted(a, b, poses[a][t], poses[b][t], np.zeros(3)):
                    continue
                shifts = depth * DIRECTIONS
                if depth and any(
                    self._parted(a, b, poses[a][t], poses[b][t], shift)
                    for shift in shifts
                ):
                    continue
                yield int(t), a, b

    def _parted(
        self, a: str, b: str, X_A: np.ndarray, X_B: np.ndarray, shift: np.ndarray
    ) -> bool:
        """Whether A, shifted, and B do not meet: no triangles cross, and none of the
        two is inside the other."""
        first, second = self._objects[a], self._objects[b]
        first.setTransform(fcl.Transform(X_A[:3, :3], X_A[:3, 3] + shift))
        second.setTransform(fcl.Transform(X_B[:3, :3], X_B[:3, 3]))
        if fcl.collide(first, second, fcl.CollisionRequest(), fcl.CollisionResult()):
            return False
        shifted = X_A.copy()
        shifted[:3, 3] += shift
        X_BA = np.linalg.inv(X_B) @ shifted
        return not (
            _inside(self._meshes[a], self._meshes[b], X_BA)
            or _inside(self._meshes[b], self._meshes[a], np.linalg.inv(X_BA))
        )


DIRECTIONS = np.array(
    [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)]
)
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def _inside(inner: trimesh.Trimesh, outer: trimesh.Trimesh, X: np.ndarray) -> bool:
    """Whether the first vertex of one mesh, which `X` brings into the frame of the
    other, is inside that: around it the other winds once."""
    p = X[:3, :3] @ inner.vertices[0] + X[:3, 3]
    if not np.all((outer.bounds[0] < p) & (p < outer.bounds[1])):
        return False
    a, b, c = np.moveaxis(outer.triangles - p, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    winding = np.arctan2(volume, below).sum() / (2.0 * np.pi)
    return bool(abs(winding) > 0.5)


def _meshes(root: ElementTree.Element, urdf: Path) -> dict[str, trimesh.Trimesh]:
    """The visual meshes of each link, in its frame."""
    packages = urdf.parents[3].parent  # .../example-robot-data/robots/NAME/urdf/FILE
    meshes = {}
    for link in root.findall("link"):
        parts = []
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            path = packages / mesh.get("filename").removeprefix("package://")
            part = trimesh.load(path, force="mesh")
            part.apply_scale(_three(mesh, "scale", "1 1 1"))
            parts.append(part.apply_transform(_place(visual)))
        if parts:
            meshes[link.get("name")] = trimesh.util.concatenate(parts)
    return meshes


def _fcl_object(mesh: trimesh.Trimesh) -> fcl.CollisionObject:
    model = fcl.BVHModel()
    model.beginModel(len(mesh.vertices), len(mesh.faces))
    model.addSubModel(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    model.endModel()
    return fcl.CollisionObject(model)


def _place(element: ElementTree.Element) -> np.ndarray:
    """The pose that an element's origin says."""
    X = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        X[:3, 3] = _three(origin, "xyz", "0 0 0")
        angles = _three(origin, "rpy", "0 0 0")
        X[:3, :3] = Rotation.from_euler("xyz", angles).as_matrix()
    return X


def _three(element: ElementTree.Element, key: str, default: str = "") -> np.ndarray:
    return np.array([float(word) for word in element.get(key, default).split()])
