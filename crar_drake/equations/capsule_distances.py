"""Signed distances of capsules and spheres, for all pairs at once.

The paper takes the minimum distances and collision points of Eqs. (19)-(26) from
a collision library. For capsules (a sphere is one of length zero) the closed form
is exact and much faster than reading a library's answers one by one.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.vectors import clip_to_unit, cross_rows, dot_columns

# Below this sin^2 of the angle between two axes, cancellation spoils the plain
# formula for their nearest points: by 4e-9 m at 5e-8 rad where arms cross.
_NEARLY_PARALLEL = 1e-8
# Below this one they are parallel.
_PARALLEL = 1e-24
# Axes nearer than this [m] have no direction between them to speak of.
_TOUCHING = 1e-12


class CapsulePairs:
    """Distances, normals and witness points of N pairs of capsules of fixed sizes.

    The signed distance is that of the axes less both radii: exact outside, and
    inside the depth along the line between the axes' nearest points. Of parallel
    axes that face each other the witness points are in the middle of the overlap.
    Where the axes meet, the normal is perpendicular to both.

    Attributes:
        uu, vv: (N,) squared lengths of the axes [m^2].
        radii: (N,) sums of both radii [m].
    """

    def __init__(
        self,
        length_a: np.ndarray,
        radius_a: np.ndarray,
        length_b: np.ndarray,
        radius_b: np.ndarray,
    ) -> None:
        """
        Args:
            length_a, length_b: (N,) of the axes, 0 for spheres [m].
            radius_a, radius_b: (N,) [m].
        """
        self.uu, self.vv = np.square(length_a), np.square(length_b)
        # Of an axis without length the parameter does not matter.
        self._per_uu = 1.0 / np.where(self.uu > 0.0, self.uu, 1.0)
        self._per_vv = 1.0 / np.where(self.vv > 0.0, self.vv, 1.0)
        product = self.uu * self.vv
        self._uu_vv = np.where(product > 0.0, product, 1.0)
        self._close = _NEARLY_PARALLEL * self._uu_vv
        self.radii = radius_a + radius_b

    def __call__(
        self, p_a: np.ndarray, u: np.ndarray, p_b: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """
        Args:
            p_a, p_b: (..., 3, N) where the axes start [m].
            u, v: (..., 3, N) from there to their ends [m].

        Returns:
            (..., N) signed distance [m]; (..., 3, N) unit normal from b towards a;
            (..., 3, N) witness points on the axis of a and (..., 3, N) on that of b
            [m]. The distance's gradient is the same at the axis as at the surface,
            since the offset between them is along the normal.
        """
        r = p_a - p_b
        uv, ur, vr = dot_columns(u, v), dot_columns(u, r), dot_columns(v, r)
        # Nearest point of the infinite lines, as a fraction of axis a: Cramer's rule.
        determinant = self._uu_vv - uv * uv
        close = determinant < self._close
        if close.any():
            determinant[close] = 1.0
        s = (uv * vr - ur * self.vv) / determinant
        if close.any():
            s[close] = self._along_nearly_parallel(close, u, v, r, uv, ur)
        # Best t for this s; limited, and then the best s for that t.
        t = clip_to_unit((uv * clip_to_unit(s) + vr) * self._per_vv)
        s = clip_to_unit((uv * t - ur) * self._per_uu)

        nearest_a = p_a + s[..., None, :] * u
        nearest_b = p_b + t[..., None, :] * v
        difference = nearest_a - nearest_b
        axis_distance = np.sqrt(dot_columns(difference, difference))
        if axis_distance.min(initial=np.inf) < _TOUCHING:
            normal = _normals_where_axes_meet(difference, axis_distance, u, v)
        else:
            normal = difference / axis_distance[..., None, :]
        return axis_distance - self.radii, normal, nearest_a, nearest_b

    def _along_nearly_parallel(self, close, u, v, r, uv, ur) -> np.ndarray:
        """s without cancellation, of the pairs `close` (..., N)."""
        uu = np.broadcast_to(self.uu, close.shape)[close]
        vv = np.broadcast_to(self.vv, close.shape)[close]
        uv, ur = uv[close], ur[close]
        u, v, r = (np.moveaxis(x, -2, -1)[close] for x in (u, v, r))
        cross = cross_rows(u, v)
        determinant = np.einsum("ij,ij->i", cross, cross)
        numerator = np.einsum("ij,ij->i", cross_rows(v, r), cross)
        parallel = determinant <= _PARALLEL * uu * vv
        # The ends of b as fractions of a bound the overlap; take its middle.
        end_0, end_1 = -ur / uu, (uv - ur) / uu
        low = clip_to_unit(np.minimum(end_0, end_1))
        high = clip_to_unit(np.maximum(end_0, end_1))
        s = numerator / np.where(parallel, 1.0, determinant)
        return np.where(parallel, 0.5 * (low + high), s)


def capsule_distances(
    p_a0: np.ndarray,
    p_a1: np.ndarray,
    radius_a: np.ndarray,
    p_b0: np.ndarray,
    p_b1: np.ndarray,
    radius_b: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, normals and witness points of any capsules: `CapsulePairs`, once.

    Args:
        p_a0, p_a1: (N, 3) ends of the axes of the first capsules [m].
        radius_a: (N,) their radii [m].
        p_b0, p_b1, radius_b: likewise for the second capsules.

    Returns:
        (N,) signed distance [m]; (N, 3) unit normal from b towards a; (N, 3)
        witness points on the axis of a and (N, 3) on the axis of b [m].
    """
    u, v = p_a1 - p_a0, p_b1 - p_b0
    pairs = CapsulePairs(
        np.linalg.norm(u, axis=1), radius_a, np.linalg.norm(v, axis=1), radius_b
    )
    d, normal, p_a, p_b = pairs(p_a0.T, u.T, p_b0.T, v.T)
    return d, normal.T, p_a.T, p_b.T


def _normals_where_axes_meet(
    difference: np.ndarray, axis_distance: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Unit normals (..., 3, N), perpendicular to both axes where they meet."""
    touching = axis_distance < _TOUCHING
    normal = difference / np.where(touching, 1.0, axis_distance)[..., None, :]
    by_pair = np.moveaxis(normal, -2, -1)  # a view
    by_pair[touching] = _perpendiculars(
        np.moveaxis(u, -2, -1)[touching], np.moveaxis(v, -2, -1)[touching]
    )
    return normal


def _perpendiculars(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) perpendicular to both u and v (N, 3), as far as they
    have directions."""
    normals = np.cross(u, v)
    for i, (u_i, v_i) in enumerate(zip(u, v, strict=True)):
        lengths = np.linalg.norm(u_i) * np.linalg.norm(v_i)
        if np.linalg.norm(normals[i]) <= 1e-9 * lengths or lengths == 0.0:
            along = u_i if np.linalg.norm(u_i) > 0.0 else v_i
            helper = np.eye(3)[np.argmin(np.abs(along))]
            normals[i] = (
                np.cross(along, helper) if np.linalg.norm(along) > 0.0 else helper
            )
        normals[i] /= np.linalg.norm(normals[i])
    return normals
