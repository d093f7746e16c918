"""Signed distances of capsules and spheres, for all pairs at once.

The paper takes the minimum distances and collision points of Eqs. (19)-(26) from
a collision library. For capsules (a sphere is one of length zero) the closed form
is exact and much faster than reading a library's answers one by one.
"""

from __future__ import annotations

import numpy as np

from crar_drake.equations.vectors import clip_to_unit, cross_rows

# Below this sin^2 of the angle between two axes, cancellation spoils the plain
# formula for their nearest points: by 4e-9 m at 5e-8 rad where arms cross.
_NEARLY_PARALLEL = 1e-8
# Below this one they are parallel.
_PARALLEL = 1e-24
# Axes nearer than this [m] have no direction between them to speak of.
_TOUCHING = 1e-12


def capsule_distances(
    p_a0: np.ndarray,
    p_a1: np.ndarray,
    radius_a: np.ndarray,
    p_b0: np.ndarray,
    p_b1: np.ndarray,
    radius_b: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Distances, normals and witness points of capsule pairs.

    The signed distance is that of the axes less both radii: exact outside, and
    inside the depth along the line between the axes' nearest points. Of parallel
    axes that face each other the witness points are in the middle of the overlap.
    Where the axes meet, the normal is perpendicular to both.

    Args:
        p_a0, p_a1: (N, 3) ends of the axes of the first capsules [m].
        radius_a: (N,) their radii [m].
        p_b0, p_b1, radius_b: likewise for the second capsules.

    Returns:
        (N,) signed distance [m]; (N, 3) unit normal from b towards a; (N, 3)
        witness points on the axis of a and (N, 3) on the axis of b [m]. The
        distance's gradient is the same at the axis as at the surface, since the
        offset between them is along the normal.
    """
    u, v = p_a1 - p_a0, p_b1 - p_b0
    r = p_a0 - p_b0
    uu = np.einsum("ij,ij->i", u, u)
    vv = np.einsum("ij,ij->i", v, v)
    uv = np.einsum("ij,ij->i", u, v)
    ur = np.einsum("ij,ij->i", u, r)
    vr = np.einsum("ij,ij->i", v, r)
    # Lengths of zero are replaced by one: the parameter then does not matter.
    uu_safe = np.where(uu > 0.0, uu, 1.0)
    vv_safe = np.where(vv > 0.0, vv, 1.0)
    # Nearest point of the infinite lines, as a fraction of axis a: Cramer's rule.
    determinant = uu * vv - uv * uv
    numerator = uv * vr - ur * vv
    close = determinant < _NEARLY_PARALLEL * uu * vv
    if close.any():
        cross = cross_rows(u[close], v[close])
        determinant[close] = np.einsum("ij,ij->i", cross, cross)
        numerator[close] = np.einsum("ij,ij->i", cross_rows(v[close], r[close]), cross)
    parallel = determinant <= _PARALLEL * uu * vv
    s = numerator / np.where(parallel, 1.0, determinant)
    if parallel.any():
        # The ends of b as fractions of a bound the overlap; take its middle.
        end_0, end_1 = -ur / uu_safe, (uv - ur) / uu_safe
        low = clip_to_unit(np.minimum(end_0, end_1))
        high = clip_to_unit(np.maximum(end_0, end_1))
        s = np.where(parallel, 0.5 * (low + high), s)
    s = clip_to_unit(s)
    # Best t for this s; clamped, and then the best s for that t.
    t = clip_to_unit((uv * s + vr) / vv_safe)
    s_again = clip_to_unit((uv * t - ur) / uu_safe)
    t_inside = (t > 0.0) & (t < 1.0)
    s = np.where(t_inside, s, s_again)

    p_a = p_a0 + s[:, None] * u
    p_b = p_b0 + t[:, None] * v
    difference = p_a - p_b
    axis_distance = np.sqrt(np.einsum("ij,ij->i", difference, difference))
    touching = axis_distance < _TOUCHING
    normal = difference / np.where(touching, 1.0, axis_distance)[:, None]
    if touching.any():
        normal[touching] = _perpendiculars(u[touching], v[touching])
    return axis_distance - radius_a - radius_b, normal, p_a, p_b


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
