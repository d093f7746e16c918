"""How far the surfaces of two links are apart, by their triangles."""

from crar_drake.robot_import.meshes import Looks, triangles_of
from crar_drake.robot_import.source_robot import Poses


class Surfaces:
    """Triangles of links, prepared when they are first asked for."""

    def __init__(self, segments: Looks) -> None:
        self._segments = segments
        self._trees: dict = {}

    def gap(self, X: Poses, a: str, b: str) -> float:
        """Distance of two links' nearest triangles; 0 where some intersect [m]."""
        import fcl

        placed = [
            fcl.CollisionObject(
                self._tree(name),
                fcl.Transform(X[name].rotation().matrix(), X[name].translation()),
            )
            for name in (a, b)
        ]
        found = fcl.distance(*placed, fcl.DistanceRequest(), fcl.DistanceResult())
        return max(0.0, float(found))

    def _tree(self, name: str):
        import fcl

        if name not in self._trees:
            vertices, faces = triangles_of(self._segments[name])
            tree = fcl.BVHModel()
            tree.beginModel(len(vertices), len(faces))
            tree.addSubModel(vertices, faces)
            tree.endModel()
            self._trees[name] = tree
        return self._trees[name]
