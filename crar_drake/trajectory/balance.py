"""What the ground would have to give, from positions of some frames in a row.

A rigid body moves as any points do that have its mass, centre and inertia: here four of
a quarter of its mass, at the corners of a tetrahedron. Of points m_i at p_i = (x, y, z)
over a floor at height f,

    F_z = sum_i m_i (z_i'' + g),    H = sum_i m_i [(z_i'' + g) p_i - (z_i - f) p_i'']

are the vertical force and, but for a quarter turn, the moment on the floor; the centre
of pressure is the horizontal part of H / F_z (M. Vukobratovic and B. Borovac,
"Zero-moment point: thirty-five years of its life", Int. J. Humanoid Robotics 1(1),
2004, with point masses). It is inside a support {p: n_j . p <= b_j} by a margin e if

    d_j = [(b_j - e) F_z - n_j . H] / (M g) >= 0,

which divides by nothing, and asks for F_z >= 0 with it.

Each frame has such rows twice. *Of the mean* from the frame before to the frame after,
forces are second differences over the time h, and their moments what changes the mean
momentum of one straight way to that of the next. That is of the areas A, twice, which
the points sweep about the floor:

    H = sum_i m_i [(A_i(k, k+1) - A_i(k-1, k)) / h^2 + g mean(p_i)].

An arm may turn by a radian or two on a way, and a chord sweeps much less than its arc:
A is of two chords or more, and extrapolated from half as many (L. F. Richardson, Phil.
Trans. R. Soc. A 226, 1927).

*On a cubic spline* through the frames accelerations M swing beyond second differences:
M_(k-1) + 4 M_k + M_(k+1) = 6 x''_k (C. de Boor, "A Practical Guide to Splines", 1978,
ch. IV), of which five frames say most. Between two frames they are a mean of those at
both. Where one foot takes over from another within a step, centres of pressure leap
from sole to sole. No spline's acceleration does: there the mean alone is asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import ConvexHull, QhullError

from crar_drake.equations.compilation import compiled
from crar_drake.trajectory.body_points import Placed
from crar_drake.trajectory.optimiser import WideRows

# Corners of a tetrahedron whose mean is 0, and whose mean square is 1 along each axis.
_CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
# The second derivative at the third of five samples of a cubic spline, cut off, but
# right of parabolas.
_BESIDE = 0.5 * (3.0**0.5 - 1.0)
OF_SPLINE = np.array([0.0, 1.0, -2.0, 1.0, 0.0]) - _BESIDE * np.array(
    [1.0, -4.0, 6.0, -4.0, 1.0]
)
# A way to the next frame has two parts for each so much [rad or m] that it changes a
# joint, or how far the root is from where it is given, and so many times two at most.
_PART, _MOST_PARTS = 0.5, 4
_SIDES = 16  # of a hull, at most
_SHARE_OF_WIDTH = 0.8  # of a narrow support's half width, that its margin is at most


@dataclass(frozen=True)
class PointMasses:
    """P points that move as a robot's links do."""

    links: np.ndarray  # (P,) which of some links each is on
    offsets: np.ndarray  # (P, 3) p_LP in its frame [m]
    masses: np.ndarray  # (P,) [kg]
    gravity: float  # [m/s^2]


def point_masses(plant: MultibodyPlant, links: list[str]) -> PointMasses:
    """Of some of a plant's links; those without a mass have none."""
    context = plant.CreateDefaultContext()
    which, offsets, masses = [], [], []
    for number, link in enumerate(links):
        inertia = plant.GetBodyByName(link).CalcSpatialInertiaInBodyFrame(context)
        mass, centre = inertia.get_mass(), inertia.get_com()
        if not mass > 0.0:
            continue
        about = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        # The second moments of mass, about the link's origin and then its centre.
        second = 0.5 * np.trace(about) * np.eye(3) - about
        second = second / mass - np.outer(centre, centre)
        squares, axes = np.linalg.eigh(second)
        spread = axes * np.sqrt(np.maximum(squares, 0.0))
        which += 4 * [number]
        offsets.append(centre + _CORNERS @ spread.T)
        masses += 4 * [0.25 * mass]
    gravity = float(np.linalg.norm(plant.gravity_field().gravity_vector()))
    return PointMasses(
        np.array(which, dtype=int), np.concatenate(offsets), np.array(masses), gravity
    )


@compiled(loops=True)
def demand(
    p: np.ndarray,
    J: np.ndarray,
    masses: np.ndarray,
    frames: np.ndarray,
    second: np.ndarray,
    floor: np.ndarray,
    gravity: float,
) -> tuple[np.ndarray, np.ndarray]:
    """F_z, H_x and H_y over the weight, (R, 3) [1, m, m], and their gradients by the
    unknowns of the W frames, (R, 3, W, m).

    Args:
        p, J: (K, P, 3) [m], (K, P, 3, m) places of points and their Jacobians.
        masses: (P,) [kg].
        frames: (R, W) frames in a row; in the middle one the demand is asked.
        second: (W,) how much each counts in the second derivative [1/s^2].
        floor: (R,) its height [m].
        gravity: [m/s^2].
    """
    (R, W), m = frames.shape, J.shape[3]
    found, G = np.zeros((R, 3)), np.zeros((R, 3, W, m))
    weight, centre = masses.sum() * gravity, W // 2
    for r in range(R):
        k = frames[r, centre]
        for i in range(p.shape[1]):
            share = masses[i] / weight
            x, y, z = p[k, i, 0], p[k, i, 1], p[k, i, 2] - floor[r]
            ax, ay, up = 0.0, 0.0, gravity
            for a in range(W):
                at = frames[r, a]
                ax += second[a] * p[at, i, 0]
                ay += second[a] * p[at, i, 1]
                up += second[a] * p[at, i, 2]
            found[r, 0] += share * up
            found[r, 1] += share * (up * x - z * ax)
            found[r, 2] += share * (up * y - z * ay)
            for a in range(W):
                by, at = share * second[a], frames[r, a]
                if by == 0.0:
                    continue
                for j in range(m):
                    Jx, Jy, Jz = J[at, i, :, j]
                    G[r, 0, a, j] += by * Jz
                    G[r, 1, a, j] += by * (x * Jz - z * Jx)
                    G[r, 2, a, j] += by * (y * Jz - z * Jy)
            for j in range(m):
                Jx, Jy, Jz = J[k, i, :, j]
                G[r, 1, centre, j] += share * (up * Jx - ax * Jz)
                G[r, 2, centre, j] += share * (up * Jy - ay * Jz)
    return found, G


@compiled(loops=True)
def mean_demand(
    p: np.ndarray,
    J: np.ndarray,
    masses: np.ndarray,
    first: np.ndarray,
    frames: np.ndarray,
    rate: float,
    floor: np.ndarray,
    gravity: float,
) -> tuple[np.ndarray, np.ndarray]:
    """As `demand`, of the mean from the frame before to the frame after; gradients by
    the unknowns of these three, (R, 3, 3, m).

    Args:
        p, J: (S, P, 3) [m], (S, P, 3, m) of points at K frames and between; a share t
            of the way to the next frame moves by 1 - t and t of what moves both.
        masses: (P,) [kg].
        first: (K,) which of the S is each frame; ways have an even number of parts.
        frames: (R,) in which of the K it is asked, not in the first or the last.
        rate: frames per second [Hz].
        floor: (R,) its height [m].
        gravity: [m/s^2].
    """
    R, m = len(frames), J.shape[3]
    found, G = np.zeros((R, 3)), np.zeros((R, 3, 3, m))
    weight = masses.sum() * gravity
    for r in range(R):
        around = first[frames[r] - 1 : frames[r] + 2]
        for i in range(p.shape[1]):
            share = masses[i] / weight
            by = share * rate * rate
            found[r, 0] += share * gravity
            for k in range(3):
                up = by * (-2.0 if k == 1 else 1.0)
                found[r, 0] += up * (p[around[k], i, 2] - floor[r])
                for j in range(m):
                    G[r, 0, k, j] += up * J[around[k], i, 2, j]
            for way in range(2):
                start, parts = around[way], around[way + 1] - around[way]
                area = by / 3.0 if way else -by / 3.0
                for a in range(parts + 1):
                    at, t = start + a, a / parts
                    # Simpson's rule, of what counts the more the nearer to the frame.
                    rule = 1.0 if a in (0, parts) else 4.0 if a % 2 else 2.0
                    held = share * gravity * rule / (3.0 * parts)
                    held *= 1.0 - t if way else t
                    for c in range(2):
                        # The area is linear in each place: chords, and extrapolated
                        # with those that are twice as long.
                        gx, gz = 0.0, 0.0
                        for long in range(1, 3 - a % 2):
                            for side in (-1, 1):
                                b = a + side * long
                                if 0 <= b <= parts:
                                    size = (4.0 if long == 1 else -1.0) * side * area
                                    gx += size * (p[start + b, i, 2] - floor[r])
                                    gz -= size * p[start + b, i, c]
                        x, z = p[at, i, c], p[at, i, 2] - floor[r]
                        # Both ends of a chord count it.
                        found[r, 1 + c] += 0.5 * (gx * x + gz * z) + held * x
                        gx += held
                        for j in range(m):
                            slope = gx * J[at, i, c, j] + gz * J[at, i, 2, j]
                            G[r, 1 + c, way, j] += (1.0 - t) * slope
                            G[r, 1 + c, way + 1, j] += t * slope
    return found, G


@dataclass(frozen=True)
class HalfPlanes:
    """The supports of T frames, n . p <= b each."""

    normals: np.ndarray  # (T, N, 2) n, outwards
    bounds: np.ndarray  # (T, N) b [m]; infinite where there are fewer
    margins: np.ndarray  # (T,) by how much they are shrunk [m]
    floor: np.ndarray  # (T,) height of the floor [m]

    @property
    def supported(self) -> np.ndarray:
        """(T,) frames that have one."""
        return np.isfinite(self.bounds).any(axis=1)


def half_planes(
    points: list[np.ndarray], floor: np.ndarray, margin: float
) -> HalfPlanes:
    """The hulls of points on the floor: of those that are the farthest in some
    directions, since of a sole that is round there are hundreds.

    Args:
        points: (T) of each frame (V, 2) [m]. Where there are none, or all in a line, it
            has no support.
        floor: (T,) its height [m].
        margin: by which hulls are shrunk [m]; of narrow ones half their half width.
    """
    hulls, margins = [], np.full(len(points), margin)
    turns = np.arange(_SIDES) * 2.0 * np.pi / _SIDES
    ways = np.stack([np.cos(turns), np.sin(turns)])
    for t, some in enumerate(points):
        hulls.append(np.zeros((0, 3)))
        if len(some) < 3:
            continue
        some = some[np.unique((some @ ways).argmax(axis=0))]
        try:
            hull = ConvexHull(some)
        except QhullError:
            continue
        # Of a side between many points there are several pieces.
        equations = np.unique(hull.equations.round(9), axis=0)
        centre = some[hull.vertices].mean(axis=0)
        room = -(equations[:, :2] @ centre + equations[:, 2]).max()
        margins[t] = min(margin, _SHARE_OF_WIDTH * room)
        hulls[-1] = equations
    most = max((len(hull) for hull in hulls), default=0)
    normals = np.zeros((len(hulls), most, 2))
    bounds = np.full((len(hulls), most), np.inf)
    for t, hull in enumerate(hulls):
        normals[t, : len(hull)], bounds[t, : len(hull)] = hull[:, :2], -hull[:, 2]
    return HalfPlanes(normals, bounds, margins, floor)


class Balance:
    """Rows that keep centres of pressure inside the supports; see the module.

    Attributes:
        num_rows: that a frame may have.
        width: of how many frames each is.
    """

    def __init__(
        self,
        placed: Callable[[np.ndarray, np.ndarray], Placed],
        masses: PointMasses,
        support: HalfPlanes,
        smooth: np.ndarray,
        rate: float,
    ) -> None:
        """
        Args:
            placed: the links at some frames, of their unknowns; 1.5 is halfway from
                frame 1 to the next.
            masses: of these links.
            support: of each frame of the motion.
            smooth: (T,) frames in which a spline is asked for, too.
            rate: frames per second [Hz].
        """
        self._placed, self._masses = placed, masses
        self._support, self._smooth, self._rate = support, smooth, rate
        self._supported = support.supported
        self.num_rows, self.width = 2 * support.bounds.shape[1], len(OF_SPLINE)

    def __call__(self, frames: np.ndarray, y: np.ndarray) -> WideRows:
        """See `optimiser.Wide`."""
        last, reach = len(self._supported) - 1, self.width // 2
        wanted = np.clip(frames[:, None] + np.arange(-reach, reach + 1), 0, last)
        rows = np.searchsorted(frames, wanted)
        there = frames[np.minimum(rows, len(frames) - 1)] == wanted
        inner = self._supported[frames] & (frames > 0) & (frames < last)
        three = np.flatnonzero(inner & there.all(axis=1))
        # Beside the first and the last frame there are three.
        five = three[(frames[three] >= reach) & (frames[three] <= last - reach)]
        five = five[self._smooth[frames[five]]]
        some = np.concatenate([three, five])
        kind = np.repeat([0, 1], [len(three), len(five)])
        found, G = self._demand(frames, y, three, five, rows)
        t = frames[some]
        n, b = self._support.normals[t], self._support.bounds[t]
        H = found[:, None, 1:]
        # (R, N); infinite where there are fewer sides: a force may be downwards.
        d = np.where(np.isfinite(b), b, 0.0) * found[:, :1] - (n * H).sum(axis=2)
        d -= self._support.margins[t, None]
        row, side = np.nonzero(np.isfinite(b))
        share = np.column_stack([b[row, side], -n[row, side]])
        gradient = np.einsum("ra,raWm->rWm", share, G[row])
        number = side + kind[row] * b.shape[1]
        return WideRows(rows[some][row], number, d[row, side], gradient)

    def _demand(
        self,
        frames: np.ndarray,
        y: np.ndarray,
        three: np.ndarray,
        five: np.ndarray,
        rows: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of the mean in some of these frames, and then on a spline in others, by the
        unknowns of five frames (`rows`) each; see `demand`."""
        masses, floor = self._masses, self._support.floor[frames]
        steps = np.abs(np.diff(y, axis=0)).max(axis=1)
        # Of what is not a number there are as many as of the largest.
        twos = np.fmax(1.0, np.fmin(np.ceil(steps / _PART), _MOST_PARTS))
        parts = 2 * twos.astype(int)
        first = np.append(0, np.cumsum(parts))
        k = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(k)) - first[k]) / parts[k]
        times = np.append(frames[k] + share, frames[-1])
        between = y[k] + share[:, None] * (y[k + 1] - y[k])
        p, J = self._placed(times, np.concatenate([between, y[-1:]])).points(
            masses.links, masses.offsets
        )
        mean, G = mean_demand(
            p, J, masses.masses, first, three, self._rate, floor[three], masses.gravity
        )
        bent, more = demand(
            p[first],
            J[first],
            masses.masses,
            rows[five],
            OF_SPLINE * self._rate**2,
            floor[five],
            masses.gravity,
        )
        G = np.pad(G, ((0, 0), (0, 0), (1, 1), (0, 0)))
        return np.concatenate([mean, bent]), np.concatenate([G, more])
