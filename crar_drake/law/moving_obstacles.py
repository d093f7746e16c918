"""Spheres that move by themselves, of bounded speed: (M1), (M2), (M5) of
`docs/theory/moving-obstacles.md`.

The links of a robot are kept at the floor and what a sphere can come nearer meanwhile,
as long as they are faster than a speed that does no harm:

    d(shape at q + u T q_dot, R) >= d_0 + V t(u)      for 0 <= u <= u_end,
    t(u) = eta - T* ln(1 - u / kappa),      u_end = kappa (1 - kappa v_ok / sigma).

A command of the filter moves the robot on a straight line, and its braking path goes on
along this line: t then begins with the period. What is left of the line, where links
are slower than v_ok, keeps the floor from the sphere as it is now.
"""

from typing import NamedTuple

import numpy as np

from crar_drake.law.approach import Approach, distance_rows
from crar_drake.law.capsule_distances import distance_gradient_about_origin
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import joint_motion, link_poses, place_points
from crar_drake.law.path_balls import curvature, least_length
from crar_drake.law.path_bounds import FIRST, LOWEST, ROUNDING, Reaches, reaching
from crar_drake.law.vectors import dot, product, put, times, to_places

# A line is halved so often before a link that is not shown to be clear counts as not,
# and one that is known not to be has its worst place found: as `path_bounds` has it.
_HALVINGS, _SEARCHED = 7, 4
# So fast a link may still go where it begins to evade who comes [m/s].
_FAST = 1.0

# What is kept of a sphere: besides what it can come nearer; and of it as it is now.
MOVING, STILL = 0, 1


class Links(NamedTuple):
    """L moving links with S shapes; made by `robot.watched_links`."""

    # of a `Robot` with other points: the joints' axes, as in `joint_motion`; where the
    # axes of shapes start; and from there to their ends
    robot: Held
    shapes: np.ndarray  # (L + 1,) where the shapes of each link begin, and all end
    radii: np.ndarray  # (S,) of the shapes [m]
    balls: np.ndarray  # (S,) and of the balls about them
    reaches: Reaches  # in the world, of all axes of each link, slides at zero
    turned: np.ndarray  # (L, nv) what is added to rho for the surface: the radius
    carried: np.ndarray  # (L, nv) 1 where the joint moves the link


class Spheres(NamedTuple):
    """N spheres, R_k of the theorem, in the world."""

    centre: np.ndarray  # (N, 3) [m]
    radius: np.ndarray  # (N,) [m]
    speed: np.ndarray  # (N,) V, no point of what is in it is faster [m/s]


class Passing(NamedTuple):
    """The numbers of (M1), (M2) and (M5); made by `passing`."""

    T: float  # braking time constant [s]
    period: float  # of the filter [s]
    floor: float  # d_0 [m]
    harmless: float  # v_ok [m/s]
    kappa: float  # also the share of the speed that a period of braking leaves
    T_star: float  # [s]
    eta: float  # [s]
    lead: float  # tau of (M5): who comes counts as nearer by what it comes in that [s]


class World(NamedTuple):
    """All that stays from step to step."""

    links: Links
    numbers: Passing


class Line(NamedTuple):
    """A braking path, from q or from where a command leads, with the way there; made by
    `line_of`."""

    start: np.ndarray  # (nv,) q
    x: np.ndarray  # (nv,) to its end
    before: float  # how long the robot is on the way [s]
    lasts: float  # all of it, at the speed that it begins with [s]


class Placed(NamedTuple):
    """Where links are, in W."""

    S: np.ndarray  # (6, nv) `joint_motion`
    start: np.ndarray  # (S, 3) where the axes of shapes start [m]
    vector: np.ndarray  # (S, 3) from there to their ends [m]


def passing(T: float, period: float, floor: float, harmless: float) -> Passing:
    """(M1) for a filter, whose plant moves in steps of the period on straight lines.

    So kappa = lambda = 1 - period / T, and between two commands, at tau, the braking
    robot is at u = kappa tau / T. Then eta = max over tau of tau + T* ln(1 - tau / T),
    where tau = T - T*.

    Args:
        T: braking time constant [s].
        period: of the filter, less than T [s].
        floor: d_0 [m].
        harmless: v_ok, positive [m/s].
    """
    kappa = 1.0 - period / T
    T_star = -period / np.log(kappa)
    eta = max(T - T_star + T_star * np.log(T_star / T), 0.0)
    slows = T_star * np.log(_FAST / (kappa * min(harmless, _FAST)))  # to v_ok
    of = T, period, floor, harmless, kappa, float(T_star), float(eta)
    return Passing(*of, float(eta + slows))


@compiled
def line_of(q: np.ndarray, v: np.ndarray, before: float, numbers: Passing) -> Line:
    """The present braking path of a state (nv,), (nv,); or, with the period before it,
    the way of a command of the velocity v with its braking path."""
    return Line(q, (before + numbers.T) * v, before, before + numbers.T)


@compiled
def own_reach(line: Line, links: Links) -> np.ndarray:
    """(L, nv) rho that holds on a line, for where slides are there."""
    every = np.arange(len(links.turned))
    return reaching(line.start, line.x, 0.0 * line.x, every, links.reaches)


@compiled
def surface_speeds(line: Line, links: Links) -> np.ndarray:
    """sigma: no point of a link's surface is faster where a line begins, (L,) [m/s]."""
    return times(own_reach(line, links) + links.turned, np.abs(line.x)) / line.lasts


@compiled
def braking_time(t: float, before: float, numbers: Passing) -> float:
    """(M1): how long after now the robot is at a place of its line at most [s].

    Args:
        t: seconds along the line at the speed that it begins with; at most `last_time`.
        before: as of `Line`.
    """
    if t <= before:
        return numbers.eta + t
    left = 1.0 - (t - before) / (numbers.T * numbers.kappa)
    return numbers.eta + before - numbers.T_star * np.log(left)


@compiled
def comes_nearer(
    u: float, o: int, line: Line, spheres: Spheres, numbers: Passing
) -> float:
    """V t(u): what a sphere can come nearer until the robot is at u of its line [m]."""
    t = braking_time(u * line.lasts, line.before, numbers)
    return spheres.speed[o] * t


@compiled
def last_times(
    line: Line, links: Links, numbers: Passing
) -> tuple[np.ndarray, np.ndarray]:
    """Until where on a line each link is faster than v_ok, (L,) in [0, 1], negative if
    it never is; and how long after now the robot is there at most, (L,) [s]."""
    speed, harmless = surface_speeds(line, links), numbers.kappa * numbers.harmless
    last, seconds = np.full(len(speed), -1.0), np.zeros(len(speed))
    for i in range(len(speed)):
        # A speed that is none (NaN) is not harmless, and no distance will be enough.
        if not speed[i] <= harmless:
            u = numbers.kappa * (1.0 - harmless / speed[i])
            t = line.before + numbers.T * u
            last[i] = t / line.lasts
            seconds[i] = braking_time(t, line.before, numbers)
    return last, seconds


@compiled
def harmless_share(
    q: np.ndarray, v: np.ndarray, change: np.ndarray, world: Held
) -> float:
    """The share of a change of speed in a period that leads from braking to a state as
    slow as is harmless, at most 1.

    Args:
        q, v, change: (nv,), (nv,), (nv,) the state; what is added to the velocity that
            braking leaves [rad/s or m/s].
        world: holds `World`.
    """
    links, of = world.value.links, world.value.numbers
    speed = surface_speeds(line_of(q, v, 0.0, of), links)
    more, share = surface_speeds(line_of(q, change, 0.0, of), links), 1.0
    for i in range(len(more)):
        if more[i] > 0.0:
            left = of.kappa * (of.harmless - speed[i])
            share = min(share, left / more[i])
    return max(0.999 * share, 0.0)


@compiled
def place_links(q: np.ndarray, links: Links) -> Placed:
    """Where links are at q (nv,)."""
    r = links.robot.value
    tree, in_plant = r.tree.value, to_places(q, r.positions)
    X = link_poses(in_plant.reshape(1, -1), tree, tree.every)
    at = place_points(X, r.selection, r.first)[0]
    start = 3 * len(q)
    vector = start + len(links.radii)
    S = joint_motion(at[:start].reshape(1, -1, 3))[0]
    return Placed(S, at[start:vector], at[vector:])


@compiled
def ball_about(
    middle: np.ndarray, way: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """A ball about S balls, each of which moves on a chord.

    Args:
        middle, way, size: (S, 3), (S, 3), (S,) where they have their centres at first,
            where these are led, and their radii [m].

    Returns:
        The same of the ball: (3,), (3,), and its radius [m].
    """
    centre, along, radius = np.zeros(3), np.zeros(3), 0.0
    for i in range(len(size)):
        for c in range(3):
            centre[c] += middle[i, c] / len(size)
            along[c] += way[i, c] / len(size)
    for i in range(len(size)):
        # A centre is the farthest from another's chord at one of the ends.
        at_first, at_last = 0.0, 0.0
        for c in range(3):
            off = middle[i, c] - centre[c]
            at_first += off * off
            off += way[i, c] - along[c]
            at_last += off * off
        # np.maximum, for a NaN stays.
        far = np.sqrt(np.maximum(at_first, at_last)) + size[i]
        radius = np.maximum(radius, far)
    return centre, along, radius


@compiled
def links_near(
    begin: Placed,
    end: Placed,
    bend: np.ndarray,
    seconds: np.ndarray,
    enough: float,
    spheres: Spheres,
    links: Links,
) -> tuple[np.ndarray, float]:
    """The links and spheres that are not shown to keep a distance on a line, by balls
    about the links' shapes.

    Args:
        begin, end: where links are where the line begins and ends.
        bend: (L,) how far each link may be off its chord [m].
        seconds: (L,) that spheres have to come nearer.
        enough: the distance besides [m].

    Returns:
        (k, 2) links and spheres; no distance of the others is smaller, less what the
        spheres come nearer [m].
    """
    L, N = len(bend), len(spheres.radius)
    found, count, low = np.empty((L * N, 2), dtype=np.int64), 0, np.inf
    middle = begin.start + 0.5 * begin.vector
    way = end.start + 0.5 * end.vector - middle
    # Balls about links, and one about all of them, show it of most spheres.
    centre, along, radius = np.empty((L, 3)), np.empty((L, 3)), np.empty(L)
    for i in range(L):
        own = slice(links.shapes[i], links.shapes[i + 1])
        here, to, radius[i] = ball_about(middle[own], way[own], links.balls[own])
        put(centre[i], 0, here)
        put(along[i], 0, to)
    here, to, most = ball_about(centre, along, radius + bend)
    farthest, far_off = seconds.max(), np.zeros(N, dtype=np.bool_)
    for o in range(N):
        a, b, c = spheres.centre[o, 0], spheres.centre[o, 1], spheres.centre[o, 2]
        apart = least_length(here[0] - a, here[1] - b, here[2] - c, to[0], to[1], to[2])
        apart -= most + spheres.radius[o] + spheres.speed[o] * farthest
        if apart >= enough:
            low, far_off[o] = min(low, apart), True
    for i in range(L):
        x_i, y_i, z_i = centre[i, 0], centre[i, 1], centre[i, 2]
        u_i, v_i, w_i = along[i, 0], along[i, 1], along[i, 2]
        for o in range(N):
            if far_off[o]:
                continue
            a, b, c = spheres.centre[o, 0], spheres.centre[o, 1], spheres.centre[o, 2]
            more = bend[i] + spheres.radius[o] + spheres.speed[o] * seconds[i]
            apart = least_length(x_i - a, y_i - b, z_i - c, u_i, v_i, w_i)
            apart -= radius[i] + more
            if apart >= enough:
                low = min(low, apart)
                continue
            apart = np.inf
            for shape in range(links.shapes[i], links.shapes[i + 1]):
                x, y, z = middle[shape, 0], middle[shape, 1], middle[shape, 2]
                u, v, w = way[shape, 0], way[shape, 1], way[shape, 2]
                far = least_length(x - a, y - b, z - c, u, v, w) - links.balls[shape]
                apart = np.minimum(apart, far)
            apart -= more
            # A bound that is none (NaN) shows nothing.
            if apart >= enough:
                low = min(low, apart)
                continue
            found[count, 0], found[count, 1] = i, o
            count += 1
    return found[:count], low


@compiled
def nearest_to(
    p: np.ndarray, u: np.ndarray, c: np.ndarray
) -> tuple[float, float, float, float]:
    """Where a segment, from p by u, is nearest to a point c, (3,) each.

    Returns:
        The three parts of the unit normal from the point to the segment; their distance
        [m]. No array, which would take longer than all the rest.
    """
    x, y, z = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    uu, share = u[0] * u[0] + u[1] * u[1] + u[2] * u[2], 0.0
    if uu > 0.0:
        share = min(max(-(u[0] * x + u[1] * y + u[2] * z) / uu, 0.0), 1.0)
    x, y, z = x + share * u[0], y + share * u[1], z + share * u[2]
    far = np.sqrt(x * x + y * y + z * z)
    if far < 1e-12:
        return 0.0, 0.0, 1.0, far  # any bounds the distance from below
    return x / far, y / far, z / far, far


@compiled
def link_gaps(
    i: int,
    o: int,
    before: float,
    after: float,
    at: Placed,
    twist: np.ndarray,
    spheres: Spheres,
    links: Links,
) -> tuple[float, float, float]:
    """(A4): how far a link is from a sphere at least, to the first order [m].

    By the shadows of its shapes on the directions in which they are nearest to the
    sphere's centre.

    Args:
        before, after: two places on a line from where the link is, in shares of it.
        twist: (6,) how it moves on the line, about the world's origin.

    Returns:
        At both places; and where it is, which is the distance.
    """
    first, last, now, c = np.inf, np.inf, np.inf, spheres.centre[o]
    for shape in range(links.shapes[i], links.shapes[i + 1]):
        p, u = at.start[shape], at.vector[shape]
        x, y, z, _ = nearest_to(p, u, c)
        # n . (v + w x p) = n . v + (n x w) . p, so of the other end (n x w) . u more.
        t_0 = y * twist[2] - z * twist[1]
        t_1 = z * twist[0] - x * twist[2]
        t_2 = x * twist[1] - y * twist[0]
        rate = x * twist[3] + y * twist[4] + z * twist[5]
        rate += t_0 * p[0] + t_1 * p[1] + t_2 * p[2]
        turned = t_0 * u[0] + t_1 * u[1] + t_2 * u[2]
        gap = x * (p[0] - c[0]) + y * (p[1] - c[1]) + z * (p[2] - c[2])
        gap -= links.radii[shape] + spheres.radius[o]
        more = x * u[0] + y * u[1] + z * u[2]
        # np.minimum, for a NaN stays.
        now = np.minimum(now, np.minimum(gap, gap + more))
        one, other = gap + rate * before, gap + more + (rate + turned) * before
        first = np.minimum(first, np.minimum(one, other))
        one, other = gap + rate * after, gap + more + (rate + turned) * after
        last = np.minimum(last, np.minimum(one, other))
    return first, last, now


@compiled
def line_bounds(
    q: np.ndarray,
    v: np.ndarray,
    before: float,
    keep: np.ndarray,
    wanted: int,
    spheres: Spheres,
    world: Held,
) -> tuple[np.ndarray, float]:
    """(M2) on a whole line: what links lack of what they are to keep of spheres.

    As `path_bounds`: the gap of two shadows on a fixed direction is concave
    along the line, to the first order, and V t is convex. So in a part of the line it
    is enough to look where the part begins and ends, and where V t ends.

    What is not clear now is asked from the next braking path on: else a robot that
    rests too near could never leave.

    Args:
        q, v, before: of `line_of`, the way and the braking path.
        keep: (2, L, N) MOVING what each link is to keep of each sphere besides what
            that can come nearer, and STILL of the sphere as it is [m]; minus infinite
            for nothing.
        wanted: as in `path_bounds`, of a link and a sphere.
        world: holds `World`.

    Returns:
        (2, L, N) how far below that it comes, to the first order, 0 where it is shown
        to keep it; infinite where a distance is none (NaN) [m]. No distance is smaller,
        less what a sphere can come nearer meanwhile, if nothing is lacking [m].
    """
    links, numbers = world.value.links, world.value.numbers
    line = line_of(q, v, before, numbers)
    bent = curvature(line.x, own_reach(line, links), links.reaches.above)
    last, seconds = last_times(line, links, numbers)
    begins = place_links(line.start, links)
    ends = place_links(line.start + line.x, links)
    of = 0.125 * bent, seconds, numbers.floor, spheres, links
    near, clearance = links_near(begins, ends, *of)
    lacks, open_ = np.zeros(keep.shape), np.ones((1, 2 * len(near)), dtype=np.bool_)
    for halving in range(_HALVINGS + 1):
        half = 0.5 / len(open_)
        below = np.zeros((2 * len(open_), 2 * len(near)), dtype=np.bool_)
        for part in range(len(open_)):
            if not open_[part].any():
                continue
            middle = (2 * part + 1) * half
            at = place_links(line.start + middle * line.x, links)
            twists = product(links.carried * line.x, np.ascontiguousarray(at.S.T))
            for row in np.flatnonzero(open_[part]):
                i, o, kind = near[row // 2, 0], near[row // 2, 1], row % 2
                level, begin, end = keep[kind, i, o], middle - half, middle + half
                if level < numbers.floor:
                    begin = max(begin, line.before / line.lasts)
                if kind == MOVING:
                    end = min(end, last[i])
                if level == -np.inf or begin > end:
                    continue
                of_part = begin - middle, end - middle, at, twists[i]
                first, final, now = link_gaps(i, o, *of_part, spheres, links)
                if kind == MOVING:
                    first -= comes_nearer(begin, o, line, spheres, numbers)
                    final -= comes_nearer(end, o, line, spheres, numbers)
                    now -= comes_nearer(middle, o, line, spheres, numbers)
                least = np.minimum(first, final)
                low = least - 0.5 * half * half * bent[i]
                # A distance that is none (NaN) is not clear.
                if low >= level - ROUNDING:
                    clearance = min(clearance, low)
                    continue
                fails = begin <= middle <= end and not now >= level - ROUNDING
                quick = fails and wanted == FIRST
                if quick or halving == _HALVINGS or fails and halving >= _SEARCHED:
                    lack = max(level - least, ROUNDING) if least == least else np.inf
                    lacks[kind, i, o] = max(lacks[kind, i, o], lack)
                    if wanted == FIRST:
                        return lacks, clearance
                else:
                    either = not fails or wanted == LOWEST
                    below[2 * part, row] = either or first < final
                    below[2 * part + 1, row] = either or not first < final
        open_ = below
        if not open_.any():
            break
    return lacks, clearance


@compiled
def link_distances(
    at: Placed, near: np.ndarray, spheres: Spheres, links: Links
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The distances of links' nearest shapes from spheres, and how joints change them.

    Args:
        near: (k, 2) links and spheres.

    Returns:
        (k,) distances [m]; (k, nv) their gradients; (k, 3) unit normals, from the
        spheres to the links.
    """
    d, n = np.full(len(near), np.inf), np.zeros((len(near), 3))
    for k in range(len(near)):
        i, o = near[k, 0], near[k, 1]
        for shape in range(links.shapes[i], links.shapes[i + 1]):
            p, u = at.start[shape], at.vector[shape]
            x, y, z, far = nearest_to(p, u, spheres.centre[o])
            far -= links.radii[shape] + spheres.radius[o]
            if far < d[k]:
                d[k], n[k, 0], n[k, 1], n[k, 2] = far, x, y, z
    # The line of the shortest distance passes the centre: so does the force.
    centre, moves = spheres.centre[near[:, 1]], links.carried[near[:, 0]]
    return d, distance_gradient_about_origin(n, centre, at.S, moves), n


@compiled
def sphere_rows(
    q: np.ndarray,
    v: np.ndarray,
    s_0: np.ndarray,
    spheres: Spheres,
    approach: Approach,
    world: Held,
) -> tuple[np.ndarray, np.ndarray]:
    """g (C, n), least (C,): the rows (L3), (L4) of the spheres that s_0 could bring
    links to.

    As `law.pairs.pair_rows`, of the nearest shape of each link, with a drift of -V,
    but of no more than v_ok: what flees faster would not be safe.

    Args:
        q, v: (n,), (n,) state.
        s_0: (n,) the nominal velocity.
        world: holds `World`.
    """
    links, numbers = world.value.links, world.value.numbers
    line = line_of(q, v, 0.0, numbers)
    here, there = place_links(q, links), place_links(q + line.x, links)
    # A row binds at h = d_min + (drift - g s) / approach_rate.
    reach = own_reach(line, links)
    ahead = times(reach, np.abs(s_0)) + numbers.harmless
    most = approach.influence_distance - approach.distance_margin
    bend = 0.125 * curvature(line.x, reach, links.reaches.above)
    bend += np.minimum(ahead / approach.approach_rate, most)
    of = bend, 0.0 * bend, approach.distance_margin, spheres, links
    near, _ = links_near(here, there, *of)
    d, g = np.empty((2, len(near))), np.empty((2, len(near), len(q)))
    d[0], g[0], _ = link_distances(here, near, spheres, links)
    d[1], g[1], _ = link_distances(there, near, spheres, links)
    drift = np.minimum(spheres.speed[near[:, 1]], numbers.harmless)
    return distance_rows(d, g, drift, v, numbers.T, approach)


@compiled
def evading_rows(
    q: np.ndarray,
    v_next: np.ndarray,
    spheres: Spheres,
    velocity: np.ndarray,
    world: Held,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(M5): how fast links are to get out of the way of what moves.

        g q_dot' >= n v_o + min(-alpha h, V),      h = d - d_e - tau max(n v_o, 0)

    with d the distance of a link, d_e that which it is kept at, n its direction, from
    the sphere to the link, v_o the velocity of the sphere, and alpha = 1/T.

    Args:
        q: (n,) positions.
        v_next: (n,) the velocity of the command.
        spheres: that are evaded, with d_e in their radii.
        velocity: (N, 3) of their centres [m/s].
        world: holds `World`.

    Returns:
        (C, n), (C,) g and the right sides; (C, 2) links and spheres.
    """
    links, numbers = world.value.links, world.value.numbers
    at, line = place_links(q, links), line_of(q, v_next, 0.0, numbers)
    # A row binds at h = (n v_o - g q_dot') T: V T, and what the command does; other
    # rows ask for up to 2 V, and may move this link by as much.
    ahead = numbers.T * surface_speeds(line, links)
    seconds = np.full(len(ahead), 3.0 * numbers.T + numbers.lead)
    of = ahead, seconds, 0.0, spheres, links
    near, _ = links_near(at, at, *of)
    d, g, n = link_distances(at, near, spheres, links)
    least = np.empty(len(near))
    for k in range(len(near)):
        o = near[k, 1]
        comes = dot(n[k], velocity[o])
        h = d[k] - numbers.lead * max(comes, 0.0)
        least[k] = comes + min(-h / numbers.T, spheres.speed[o])
    return g, least, near
