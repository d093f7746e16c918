"""Which pairs of links are worth watching: those that can come near each other.

Some random postures tell nearly all of them. Of each other pair the distance is then
minimised, from the postures in which it was least and from more random ones, by steps
along its gradient within the joints' limits.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint

from crar_drake.law.capsule_distances import capsule_distances
from crar_drake.law.kinematics import link_poses
from crar_drake.robot.kinematics import JointTree
from crar_drake.robot_import.capsule_fitting import Capsules
from crar_drake.robot_import.source_robot import Poses

SAMPLES = 1000
CLEAR = 0.005  # [m] that a pair keeps in the rest posture
NEAR = 0.02  # [m]; a pair that never came nearer than this cannot meet
_ALWAYS = 0.95  # share of samples
_BLOCK = 50  # postures at a time
_STARTS, _RANDOM = 8, 8  # of a minimisation: the nearest samples, and others
_PAIRS = 64  # that are minimised together
_STEPS = 40
_SHARES = np.array([1.0, 0.5, 0.2, 0.05])  # of a step, the best of which is taken
_LONGEST = 0.5  # [rad or m] of a step


@dataclass(frozen=True)
class SampledPairs:
    """What sampling found, in the words of MoveIt's setup assistant."""

    watched: list[list[str]]  # pairs that can meet
    overlapping: list[list[str]]  # in contact (or nearly) in the rest posture
    always: list[list[str]]  # pairs in contact in nearly every configuration
    never: int  # number of pairs that met in no configuration


def gaps(
    capsules: Capsules, pairs: Sequence[tuple[str, str]], poses: Poses
) -> np.ndarray:
    """(N,) distances between the capsules of pairs of links [m]."""
    placed = {
        name: [(poses[name] @ c.p_L0, poses[name] @ c.p_L1, c.radius) for c in of_link]
        for name, of_link in capsules.items()
    }
    found = []
    for a, b in pairs:
        shapes = zip(*itertools.product(placed[a], placed[b]), strict=True)
        ends = [map(np.array, zip(*side, strict=True)) for side in shapes]
        found.append(capsule_distances(*ends[0], *ends[1])[0].min())
    return np.array(found)


class PairDistances:
    """Distances of pairs of links in many postures, by their capsules.

    A root that floats stays where the plant has it by default: what moves a robot as a
    whole does not change how far its links are apart.

    Attributes:
        lower, upper: (nq,) of `position_ranges`.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        capsules: Capsules,
        pairs: Sequence[tuple[str, str]],
    ) -> None:
        """The plant is finalized; the links of pairs have capsules."""
        self.lower, self.upper = position_ranges(plant)
        self._joints = JointTree(plant)
        own, tree = self._joints.frame_of_velocity, self._joints.tree
        # Of the joints that move one position each.
        self._single = np.flatnonzero(~np.isin(own, tree.free[:, :1]))
        self._own = own[self._single]
        self._columns = tree.position[self._own]
        self._rest = plant.GetPositions(plant.CreateDefaultContext())
        flat = []
        for name, of_link in capsules.items():
            frame, X_FB = self._joints.place(plant.GetBodyByName(name))
            flat += [(frame, X_FB @ c.p_L0, X_FB @ c.p_L1, c.radius) for c in of_link]
        self._frame = np.array([frame for frame, *_ in flat], dtype=int)
        self._ends = np.array([ends for _, *ends, _ in flat]).reshape(-1, 2, 3)
        self._radius = np.array([radius for *_, radius in flat])
        names = [name for name, of_link in capsules.items() for _ in of_link]
        rows = {name: np.flatnonzero(np.array(names) == name) for name in set(names)}
        self._rows = [
            np.array(list(itertools.product(rows[a], rows[b]))) for a, b in pairs
        ]

    def of_all(self, q: np.ndarray) -> np.ndarray:
        """(K, N) of every pair in each posture (K, nq) [m]."""
        rows = np.concatenate(self._rows)
        starts = np.cumsum([0, *(len(r) for r in self._rows[:-1])])
        of = np.repeat(np.arange(len(q)), len(rows))
        d, *_ = self._distances(*self._place(q), of, np.tile(rows, (len(q), 1)))
        return np.minimum.reduceat(d.reshape(len(q), -1), starts, axis=1)

    def of_each(self, pairs: np.ndarray, q: np.ndarray):
        """(K,) of one pair in each posture [m], and (K, n) its gradient.

        Args:
            pairs: (K,) indices.
            q: (K, nq).
        """
        R, p = self._place(q)
        length = [len(self._rows[pair]) for pair in pairs]
        rows = np.concatenate([self._rows[pair] for pair in pairs])
        of = np.repeat(np.arange(len(pairs)), length)
        d, normal, p_A, _ = self._distances(R, p, of, rows)
        starts = np.cumsum([0, *length[:-1]])
        least = np.minimum.reduceat(d, starts)
        # The first row of each posture that has its least distance.
        at = np.flatnonzero(d == least[of])
        at = at[np.unique(of[at], return_index=True)[1]]
        own, single = self._own, self._single
        turns, slides = (
            (R[:, own] @ way[single, :, np.newaxis])[..., 0]
            for way in (self._joints.turns, self._joints.slides)
        )
        # The normal goes through the points of both: one of them says how it is moved.
        moved = np.cross(turns, p_A[at, np.newaxis] - p[:, own]) + slides
        by = self._joints.moved_by[self._frame[rows[at]]][..., single].astype(float)
        gradient = np.zeros_like(q)
        along = np.einsum("knx,kx->kn", moved, normal[at])
        gradient[:, self._columns] = along * (by[:, 0] - by[:, 1])
        return least, gradient

    def _place(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_WF (K, F, 3, 3) and p_WF (K, F, 3) of all frames in each posture [m]."""
        tree, posture = self._joints.tree, np.tile(self._rest, (len(q), 1))
        posture[:, self._columns] = q[:, self._columns]
        X = link_poses(posture, tree, tree.every).reshape(len(q), -1, 4, 3)
        return X[:, :, :3].swapaxes(2, 3), X[:, :, 3]

    def _distances(self, R, p, of: np.ndarray, rows: np.ndarray):
        """`capsule_distances` of pairs of capsules (N, 2), each in the posture `of`."""
        capsules = []
        for shapes in rows.T:
            frames = self._frame[shapes]
            turned = self._ends[shapes] @ np.swapaxes(R[of, frames], 1, 2)
            ends = turned + p[of, frames][:, np.newaxis]
            capsules += [ends[:, 0], ends[:, 1], self._radius[shapes]]
        return capsule_distances(*capsules)


def least_distances(
    distances: PairDistances, pairs: np.ndarray, q: np.ndarray, enough: float = -np.inf
) -> np.ndarray:
    """(K,) local minima of pairs' distances within the joints' limits [m].

    Args:
        pairs: (K,) which pair to bring together from each start.
        q: (K, nq) the starts.
        enough: distance at which a pair's search ends [m].
    """
    lower, upper = distances.lower, distances.upper
    q = q.copy()
    d, gradient = distances.of_each(pairs, q)
    alive = d > enough
    for _ in range(_STEPS):
        reached = np.unique(pairs[d <= enough])
        alive &= ~np.isin(pairs, reached)
        rows = np.flatnonzero(alive)
        if not len(rows):
            break
        down = -gradient[rows]
        # What would leave the limits stays where it is.
        stuck = (q[rows] <= lower) & (down < 0.0) | (q[rows] >= upper) & (down > 0.0)
        down[stuck] = 0.0
        square = np.maximum(np.einsum("kn,kn->k", down, down), 1e-12)
        # To where the distance would be gone, were it linear.
        step = down * ((d[rows] + 0.05) / square)[:, np.newaxis]
        norm = np.abs(step).max(axis=1, keepdims=True)
        step *= np.minimum(1.0, _LONGEST / np.maximum(norm, 1e-12))
        tried = np.clip(
            q[rows] + _SHARES[:, np.newaxis, np.newaxis] * step, lower, upper
        )
        found, gradients = distances.of_each(
            np.tile(pairs[rows], len(_SHARES)), tried.reshape(-1, q.shape[1])
        )
        found = found.reshape(len(_SHARES), -1)
        best = np.argmin(found, axis=0)
        least = found[best, np.arange(len(rows))]
        better = least < d[rows] - 1e-5
        alive[rows[~better]] = False
        moved = rows[better]
        q[moved] = tried[best, np.arange(len(rows))][better]
        d[moved] = least[better]
        gradient[moved] = gradients.reshape(len(_SHARES), len(rows), -1)[
            best, np.arange(len(rows))
        ][better]
    return d


def sample_pairs(
    plant: MultibodyPlant,
    capsules: Capsules,
    rest: np.ndarray,
    candidates: Sequence[tuple[str, str]],
    samples: int = SAMPLES,
    twins: Mapping[str, str] | None = None,
    always_watched: set[frozenset[str]] = frozenset(),
) -> SampledPairs:
    """Looks for postures within the joints' limits in which pairs are near.

    Args:
        plant: finalized.
        capsules: of the links.
        rest: (nq,) the rest posture.
        candidates: pairs that neither a joint nor a weld connects; those always touch.
        twins: link to the same one of the robot's other side: a pair is watched if its
            image is.
        always_watched: pairs that are watched although nothing was found.
    """
    if not candidates:
        return SampledPairs([], [], [], 0)
    distances = PairDistances(plant, capsules, candidates)
    at_rest = distances.of_all(rest[np.newaxis])[0]
    rng = np.random.default_rng(0)
    lower, upper = distances.lower, distances.upper
    q = rng.uniform(lower, upper, size=(samples, len(lower)))
    seen = np.concatenate(
        [distances.of_all(q[k : k + _BLOCK]) for k in range(0, samples, _BLOCK)]
    )
    contacts = (seen < 0.0).mean(axis=0)
    least = np.minimum(at_rest, seen.min(axis=0))
    unseen = np.flatnonzero(least > NEAR)
    # So many at a time that all their links' poses fit into memory.
    for some in np.array_split(unseen, -(-len(unseen) // _PAIRS) or 1):
        few = np.argsort(seen[:, some], axis=0)[:_STARTS].T
        others = rng.integers(samples, size=(len(some), _RANDOM))
        starts = np.concatenate([few, others], axis=1)
        pairs = np.repeat(some, starts.shape[1])
        if len(pairs):
            found = least_distances(distances, pairs, q[starts.ravel()], NEAR)
            np.minimum.at(least, pairs, found)
    near = {frozenset(candidates[k]) for k in np.flatnonzero(least <= NEAR)}
    near |= always_watched
    near |= {frozenset((twins or {}).get(link, link) for link in pair) for pair in near}
    watched, overlapping, always, never = [], [], [], 0
    for index, pair in enumerate(candidates):
        if at_rest[index] < CLEAR:
            overlapping.append(list(pair))
        elif contacts[index] > _ALWAYS:
            always.append(list(pair))
        elif frozenset(pair) not in near:
            never += 1
        else:
            watched.append(list(pair))
    return SampledPairs(watched, overlapping, always, never)


def position_ranges(plant: MultibodyPlant) -> tuple[np.ndarray, np.ndarray]:
    """(n,) lower and upper positions that are worth trying: a whole turn at most."""
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    unlimited = ~np.isfinite(upper - lower)
    lower[unlimited], upper[unlimited] = -np.pi, np.pi
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        if isinstance(joint, RevoluteJoint):
            at = joint.position_start()
            upper[at] = min(upper[at], lower[at] + 2.0 * np.pi)
    return lower, upper
