"""Distances of two links with two joints between them, in boxes of these joints.

How far such links are apart depends on the two joints alone, whatever the rest of the
robot does. So what was measured once is known of all motions, and is kept in the user's
cache, under a name by what it depends on.

**Theorem.** Seen from the link between them, A turns about the axis of one joint alone,
or slides along it, and B that of the other. So a point of A is always as far from its
axis: at most rho_1, and of B rho_2. In a box of both joints' positions with centre c
and half-widths w, on the straight way from c, (M1) of `mesh_clearance` is

    |d - d(c)| <= w_1 rho_1 + w_2 rho_2.                                        (M5)

With rho' of the parts that are near (`near_parts`) the same holds of min(d, h).

*Inside.* In a box in which the surfaces do not meet, one link is inside the other
everywhere or nowhere.

Boxes that a motion goes through are halved until their bounds are a share of the
distance, or close enough. Whether a box is halved depends on nothing but the box, so
that bounds do not depend on which motions were looked at before.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.compilation import compiled
from crar_drake.references.kept_arrays import keep_array, place_of, read_kept
from crar_drake.references.mesh_pairs import FOUND_BY, MeshPairs, relative_poses
from crar_drake.references.near_parts import near_approach

# The first box reaches so far from 0 [rad or m]. Nothing is measured in a box in which
# the distance can change by more than this [m].
_FARTHEST, _COARSE = 16.0, 0.1
# A bound is sought until it is this share of the distance, or so much [m].
SHARE, ENOUGH = 0.1, 1e-3
# Nor is a box halved in which it changes by less than this [m], or than this if links
# meet at its centre.
_FINEST, _FINEST_WHERE_MET = 1e-4, 1e-3
# Near parts are looked for again where the distance can change by so much less.
_LESS = 0.25
_DEPTH = 128  # of boxes in boxes, at most, and more than there can be
_WORTH_KEEPING = 20  # distances more than were kept before

# centre, half: its centre and half-widths [rad or m]. first: its first half, the second
# one follows; -1 if it is whole. loss: by how much d can change from the centre [m].
# rho: what is known of its near parts, and found_at: the loss where that was found.
# low, high: no distance in it is smaller, or larger [m]. inside: whether one link is
# inside the other, -1 before that is asked.
_BOX = np.dtype(
    [
        ("centre", float, 2),
        ("half", float, 2),
        ("rho", float, 2),
        ("found_at", float),
        ("loss", float),
        ("low", float),
        ("high", float),
        ("first", np.int64),
        ("measured", bool),
        ("inside", np.int8),
    ]
)


def _seen(boxes: np.ndarray) -> tuple[np.ndarray, ...]:
    """What `through_boxes` asks of boxes."""
    low, high, loss = (boxes[name] for name in ("low", "high", "loss"))
    close = (low >= np.minimum(ENOUGH, SHARE * high)) & (low > 0.0)
    finest = np.where(high > loss, _FINEST, _FINEST_WHERE_MET)
    ready = boxes["measured"] & (close | (loss < finest))
    fields = (boxes[name].copy() for name in ("centre", "half", "first", "low"))
    return *fields, close, ready


class PairTable:
    """Of one pair of meshes A and B.

    Attributes:
        meshes: of the robot.
        pair: which of them A and B are.
        columns: (2,) where the positions of the two joints stand in the plant's.
        turns: (2,) whether each turns; else it slides.
        depends_on: all that distances and bounds depend on.
    """

    def __init__(
        self,
        meshes: MeshPairs,
        row: int,
        joints: tuple[int, int],
        rest: np.ndarray,
        near: float,
    ) -> None:
        """
        Args:
            meshes: of the robot.
            row: which of its pairs.
            joints: the velocities of the joint next to A and of the one next to B.
            rest: (nq,) any positions of the plant.
            near: h [m].
        """
        self.meshes, self._rest, self._near = meshes, rest.copy(), near
        self.pair = tuple(meshes.rows[row])
        self._links = [meshes.meshes[k] for k in self.pair]
        self._frames = np.array([link.frame for link in self._links])
        self._joints = [np.array([velocity]) for velocity in joints]
        tree = meshes.joints
        own = tree.frame_of_velocity[list(joints)]
        self.columns = tree.tree.position[own]
        self._rest[self.columns] = 0.0
        self._slides = np.linalg.norm(tree.slides, axis=1)
        self._rho, geometry = self._farthest(joints)
        self.turns = tree.turns[list(joints)].any(axis=1)
        self.depends_on = self._depends_on(geometry)
        found_by = "pair_tables", *FOUND_BY
        self._place = place_of("meshes", found_by, self.depends_on)
        self._boxes, self._seen = self._kept(), None
        self._num_kept = self.num_measured

    @property
    def num_measured(self) -> int:
        """Distances that were measured."""
        return int(self._boxes["measured"].sum())

    def bounds(
        self, start: np.ndarray, end: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What straight ways keep.

        Args:
            start, end: (K, nq) positions of the plant where they begin and end.

        Returns:
            (K,) no distance on a way is smaller [m]; and (K,) whether that is positive,
            and close enough.
        """
        ends = [np.ascontiguousarray(q[:, self.columns]) for q in (start, end)]
        while True:
            seen = self._seen = self._seen or _seen(self._boxes)
            bounds, done, asked = through_boxes(*ends, *seen)
            some = np.flatnonzero(asked)
            if not len(some):
                break
            boxes, self._seen = self._boxes, None
            halved = boxes["measured"][some] | (boxes["loss"][some] > _COARSE)
            for box in some[~halved]:
                self._measure(boxes[box])
            self._halve(some[halved])
        outside = np.abs(np.stack(ends)).max(axis=(0, 2)) > _FARTHEST
        return np.where(outside, -np.inf, bounds), done & ~outside

    def placed(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """R_AB (K, 3, 3) and p_AB (K, 3) [m].

        Args:
            at: (K, 2) positions of the joints [rad or m].
        """
        q = np.tile(self._rest, (len(at), 1))
        q[:, self.columns] = at
        return relative_poses(*self.meshes.poses(q), *self._frames)

    def one_inside(self, q: np.ndarray) -> bool:
        """Whether one link is inside the other where they do not touch.

        Args:
            q: (nq,) positions of the plant.
        """
        box, at = self._boxes[0], q[self.columns]
        while box["first"] >= 0:
            halves = self._boxes[box["first"] : box["first"] + 2]
            off = np.abs(halves["centre"] - at) - halves["half"]
            box = halves[int(off.max(axis=1).argmin())]
        if box["inside"] >= 0:
            return bool(box["inside"])
        R, p = self.meshes.poses(q[None])
        X = relative_poses(R[0], p[0], *self._frames)
        found = self.meshes.one_inside(*self.pair, *X)
        if box["low"] > 0.0 and np.abs(at).max() <= _FARTHEST:
            box["inside"] = found
        return found

    def keep(self) -> None:
        """Writes what was measured to the cache, if it is more than is there."""
        if self.num_measured < self._num_kept + _WORTH_KEEPING:
            return
        keep_array(self._place, self._boxes)
        self._num_kept = self.num_measured

    def _kept(self) -> np.ndarray:
        """The boxes of the cache, or a first one."""
        boxes = read_kept(self._place, _BOX)
        if boxes is not None and boxes.ndim == 1 and len(boxes):
            return boxes
        boxes = np.zeros(1, dtype=_BOX)
        boxes["half"], boxes["rho"] = _FARTHEST, self._rho
        boxes["loss"] = boxes["half"] @ self._rho
        boxes["low"], boxes["high"], boxes["found_at"] = -np.inf, np.inf, np.inf
        boxes["first"] = boxes["inside"] = -1
        return boxes

    def _depends_on(self, geometry: list[np.ndarray]) -> list[np.ndarray]:
        """All that distances and bounds depend on."""
        for link in self._links:
            geometry = [*geometry, link.vertices, link.faces.astype(np.int64)]
        return [*geometry, np.array([self._near])]

    def _farthest(self, joints: tuple[int, int]) -> tuple[np.ndarray, list[np.ndarray]]:
        """(2,) rho of A and B [m/rad or 1]; and what says how they are carried: with
        both joints at 0, X_AB and each joint's axis and place in A."""
        R, p = self.meshes.poses(self._rest[None])
        R, p = R[0], p[0]
        tree, found = self.meshes.joints, []
        a = self._frames[0]
        geometry = [*relative_poses(R, p, *self._frames)]
        for link, velocity in zip(self._links, joints, strict=True):
            own = tree.frame_of_velocity[velocity]
            axis = R[own] @ tree.turns[velocity]
            corners = p[link.frame] + link.corners @ R[link.frame].T
            arms = np.cross(axis, corners - p[own])
            found.append(np.linalg.norm(arms, axis=1).max() + self._slides[velocity])
            slide = R[own] @ tree.slides[velocity]
            geometry += [x @ R[a] for x in (axis, slide, p[own] - p[a])]
        return np.array(found), geometry

    def _halve(self, some: np.ndarray) -> None:
        """Divides boxes across the joint that moves surfaces the most."""
        if not len(some):
            return
        number, boxes = np.arange(len(some)), self._boxes[some]
        along = (boxes["half"] * self._rho).argmax(axis=1)
        boxes["half"][number, along] /= 2.0
        step = np.zeros_like(boxes["half"])
        step[number, along] = boxes["half"][number, along]
        boxes["loss"] = boxes["half"] @ self._rho
        boxes["measured"], boxes["inside"] = False, -1
        halves = np.stack([boxes, boxes], axis=1)
        halves["centre"] += np.stack([-step, step], axis=1)
        boxes = np.concatenate([self._boxes, halves.reshape(-1)])
        boxes["first"][some] = len(self._boxes) + 2 * number
        self._boxes = boxes  # at last: an interrupt leaves none without its halves

    def _measure(self, box: np.void) -> None:
        """Finds the bounds of a box."""
        q = self._rest.copy()
        q[self.columns] = box["centre"]
        R, p = self.meshes.poses(q[None])
        X = relative_poses(R, p, *self._frames)
        found, _ = self.meshes.distances(np.array([self.pair]), *X)
        d, loss = found[0], box["loss"]
        low, high = d - loss, d + loss
        if d < self._near:
            if loss < _LESS * box["found_at"]:
                box["rho"], box["found_at"] = self._find_rho_near(box, R, p), loss
            loss = min(loss, box["half"] @ box["rho"])
            # min(d, h) is no farther off: it is d itself where that is less than h.
            low = max(low, d - loss)
            high = d + loss if d + loss < 0.999 * self._near else high
        box["measured"], box["loss"] = True, loss
        box["low"], box["high"] = max(box["low"], low), min(box["high"], high)

    def _find_rho_near(self, box: np.void, R: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(2,) rho' of A and B: of parts that are near somewhere in a box [m/rad or 1].

        Args:
            box: which.
            R, p: R_WF (1, N, 3, 3) and p_WF (1, N, 3) of all frames at its centre [m].
        """
        tree = self.meshes.joints
        R, p = np.repeat(R, 2, axis=0), np.repeat(p, 2, axis=0)
        frames = tree.frame_of_velocity
        axes = (R[:, frames] @ tree.turns[..., None])[..., 0]
        a, b = self._links
        # From the centre to any place and back to the centre.
        nearer = np.array([2.0 * box["half"] @ self._rho])
        steps = np.ones((1, len(frames)))
        found = near_approach(
            *(R, p, self._frames, a.parts, b.parts, *self._joints, p[:, frames], axes),
            *(self._slides, steps, nearer, np.ones(1, dtype=bool), self._near),
        )
        return np.minimum(found[0], box["rho"])


@compiled
def through_boxes(
    start: np.ndarray,
    end: np.ndarray,
    centre: np.ndarray,
    half: np.ndarray,
    first: np.ndarray,
    low: np.ndarray,
    close: np.ndarray,
    ready: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which boxes straight ways go through.

    Args:
        start, end: (K, 2) where the ways begin and end.
        centre, half: (N, 2) centres and half-widths of the boxes.
        first: (N,) the first of a box's two halves; -1 if it is whole.
        low: (N,) no distance in it is smaller [m].
        close, ready: (N,) whether its bound is close enough, and whether it is not to
            be halved.

    Returns:
        (K,) no distance on a way is smaller [m], and (K,) whether all bounds on it are
        close enough; (N,) whole boxes on the ways that are not ready.
    """
    bounds, done = np.full(len(start), np.inf), np.ones(len(start), np.bool_)
    asked, stack = np.zeros(len(low), np.bool_), np.empty(_DEPTH, np.int64)
    for k in range(len(start)):
        stack[0], used = 0, 1
        while used:
            used -= 1
            box = stack[used]
            begin, stop = 0.0, 1.0
            for j in range(2):
                # Neighbours have the same edge, so that no way passes between them.
                lower = centre[box, j] - half[box, j] - start[k, j]
                upper = centre[box, j] + half[box, j] - start[k, j]
                step = end[k, j] - start[k, j]
                if step > 0.0:
                    begin, stop = max(begin, lower / step), min(stop, upper / step)
                elif step < 0.0:
                    begin, stop = max(begin, upper / step), min(stop, lower / step)
                elif lower > 0.0 or upper < 0.0:
                    stop = -1.0
            if begin > stop:
                continue
            if first[box] >= 0:
                stack[used], stack[used + 1] = first[box], first[box] + 1
                used += 2
            else:
                bounds[k] = min(bounds[k], low[box])
                done[k] = done[k] and close[box]
                asked[box] = asked[box] or not ready[box]
    return bounds, done, asked
