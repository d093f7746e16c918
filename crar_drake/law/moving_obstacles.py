"""Spheres that move by themselves, of bounded speed: (M1), (M2) of
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

from crar_drake.law.admission import ROUNDING
from crar_drake.law.approach import (
    Approach,
    margin_curvature,
    pair_margins,
    pair_rates,
)
from crar_drake.law.compilation import Held, compiled
from crar_drake.law.kinematics import (
    Robot,
    joint_motion,
    link_poses,
    place_points,
)
from crar_drake.law.path_balls import least_length
from crar_drake.law.vectors import times

# A line is halved so often before a link that is not shown to be clear counts as not;
# as `admission` has it.
_HALVINGS = 7
# Where a state is not clear, the smallest distance on its braking path is looked for
# at so many places.
_PLACES = 9


class Links(NamedTuple):
    """L moving links with S shapes; made by `robot.watched_links`."""

    # (P, 4) of `place_points`: the joints' axes, as in `joint_motion`; the balls'
    # centres; where the shapes' axes start; and from there to their ends
    selection: np.ndarray
    first: np.ndarray  # (P,) of `place_points` as well
    radius: np.ndarray  # (L,) of the balls about the links' shapes [m]
    shapes: np.ndarray  # (L + 1,) where the shapes of each link begin, and all end
    radii: np.ndarray  # (S,) of the shapes [m]
    reach: np.ndarray  # (L, nv) rho in the world, of all axes and centres [m/rad, 1]
    turned: np.ndarray  # (L, nv) what is added to that for the surface: the radius
    carried: np.ndarray  # (L, nv) 1 where the joint moves the link
    above: np.ndarray  # (nv, nv) 1 where joint j carries joint i, i = j not included
    slides: np.ndarray  # (K,) the joints that slide between a turn and a shape
    extents: np.ndarray  # (K,) how far from zero they are at most [m]
    by: np.ndarray  # (K, L, nv) what a metre of each adds to `reach` [1/rad]


class Spheres(NamedTuple):
    """N spheres, R_k of the theorem, in the world."""

    centre: np.ndarray  # (N, 3) [m]
    radius: np.ndarray  # (N,) [m]
    speed: np.ndarray  # (N,) V, no point of what is in it is faster [m/s]


class Passing(NamedTuple):
    """The numbers of (M1) and (M2); made by `passing`."""

    T: float  # braking horizon [s]
    period: float  # of the filter [s]
    floor: float  # d_0 [m]
    harmless: float  # v_ok [m/s]
    kappa: float  # also the share of the speed that a period of braking leaves
    T_star: float  # [s]
    eta: float  # [s]


class Evasion(NamedTuple):
    """The numbers of (M5)."""

    rate: float  # alpha, how fast what is left of a distance is used up at most [1/s]
    lead: float  # tau, who comes counts as nearer by what it comes in so long [s]
    weight: float  # w, of what rows lack, beside the change of joints [1/m^2]


class WorldLaw(NamedTuple):
    """All that stays from step to step."""

    links: Held  # of `Links`
    numbers: Passing
    evasion: Evasion


class Moving(NamedTuple):
    """N spheres that are evaded, as they are and as they move."""

    spheres: Spheres  # with d_e, which they are kept at, in their radii
    velocity: np.ndarray  # (N, 3) of their centres [m/s]


class Line(NamedTuple):
    """A braking path, from q or from where a command leads, with the way there."""

    start: np.ndarray  # (nv,) q
    x: np.ndarray  # (nv,) to its end
    before: float  # how long the robot is on the way [s]


class Levels(NamedTuple):
    """What each link is to keep of each sphere, (L, N) [m]."""

    moving: np.ndarray  # besides what the sphere can come nearer
    still: np.ndarray  # of the sphere as it is


class Found(NamedTuple):
    """What is found of a line."""

    clear: bool  # whether every link keeps its levels
    # no distance is smaller, less what a sphere can come nearer meanwhile, if it is
    # clear [m]
    clearance: float
    link: int  # which is farthest below its level, -1 if none is
    sphere: int  # of which sphere
    failed: np.ndarray  # (L, N) bool, what is not clear; if looked at quickly, some


def passing(T: float, period: float, floor: float, harmless: float) -> Passing:
    """(M1) for a filter, whose plant moves in steps of the period on straight lines.

    So kappa = lambda = 1 - period / T, and between two commands, at tau, the braking
    robot is at u = kappa tau / T. Then eta = max over tau of tau + T* ln(1 - tau / T),
    where tau = T - T*.

    Args:
        T: braking horizon [s].
        period: of the filter, less than T [s].
        floor: d_0 [m].
        harmless: v_ok, positive [m/s].
    """
    kappa = 1.0 - period / T
    T_star = -period / np.log(kappa)
    eta = max(T - T_star + T_star * np.log(T_star / T), 0.0)
    return Passing(T, period, floor, harmless, kappa, float(T_star), float(eta))


@compiled
def own_reach(line: Line, links: Links) -> np.ndarray:
    """`Links.reach` that holds on a line: longer where slides leave their extents."""
    reach = links.reach
    for k in range(len(links.slides)):
        j = links.slides[k]
        far = max(abs(line.start[j]), abs(line.start[j] + line.x[j]))
        if far > links.extents[k]:
            reach = reach + (far - links.extents[k]) * links.by[k]
    return reach


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
def last_times(
    line: Line, reach: np.ndarray, links: Links, numbers: Passing
) -> np.ndarray:
    """(L,) until when on a line each link is faster than v_ok, in seconds as of
    `braking_time`; negative if it never is."""
    speed = times(reach + links.turned, np.abs(line.x)) / (line.before + numbers.T)
    last = np.full(len(speed), -1.0)
    for i in range(len(speed)):
        harmless = numbers.kappa * numbers.harmless
        # A speed that is none (NaN) is not harmless, and no distance will be enough.
        if not speed[i] <= harmless:
            u = numbers.kappa * (1.0 - harmless / speed[i])
            last[i] = line.before + numbers.T * u
    return last


@compiled
def place_links(q: np.ndarray, r: Robot, links: Links) -> np.ndarray:
    """(P, 3) of `Links.selection` in W, of a robot at q (nv,), in its order."""
    tree, in_plant = r.tree.value, np.empty((1, len(q)))
    for i in range(len(q)):
        in_plant[0, r.positions[i]] = q[i]
    X = link_poses(in_plant, tree, tree.every)
    return place_points(X, links.selection, links.first)[0]


@compiled
def links_near(
    start: np.ndarray,
    end: np.ndarray,
    bend: np.ndarray,
    seconds: np.ndarray,
    enough: float,
    spheres: Spheres,
    links: Links,
) -> tuple[np.ndarray, float]:
    """The links and spheres that are not shown to keep a distance on a line.

    Args:
        start, end: (L, 3), (L, 3) the centres of the links' balls [m].
        bend: (L,) how far each link may be off its chord [m].
        seconds: (L,) that spheres have to come nearer.
        enough: the distance besides [m].

    Returns:
        (k, 2) links and spheres; no distance of the others is smaller, less what the
        spheres come nearer [m].
    """
    L, N = len(start), len(spheres.radius)
    found, count, low = np.empty((L * N, 2), dtype=np.int64), 0, np.inf
    # One ball about all links on the whole line.
    middle = np.zeros(3)
    for c in range(3):
        lowest, highest = np.inf, -np.inf
        for i in range(L):
            lowest = min(lowest, min(start[i, c], end[i, c]))
            highest = max(highest, max(start[i, c], end[i, c]))
        middle[c] = 0.5 * (lowest + highest)
    around, longest = 0.0, 0.0
    for i in range(L):
        a = b = 0.0
        for c in range(3):
            a += (start[i, c] - middle[c]) ** 2
            b += (end[i, c] - middle[c]) ** 2
        size = links.radius[i] + bend[i]
        around = max(around, np.sqrt(max(a, b)) + size)
        longest = max(longest, seconds[i])
    for k in range(N):
        x = spheres.centre[k, 0] - middle[0]
        y = spheres.centre[k, 1] - middle[1]
        z = spheres.centre[k, 2] - middle[2]
        r, V = spheres.radius[k], spheres.speed[k]
        apart = np.sqrt(x * x + y * y + z * z) - around - r - V * longest
        if apart >= enough:
            low = min(low, apart)
            continue
        for i in range(L):
            x = start[i, 0] - spheres.centre[k, 0]
            y = start[i, 1] - spheres.centre[k, 1]
            z = start[i, 2] - spheres.centre[k, 2]
            u, v = end[i, 0] - start[i, 0], end[i, 1] - start[i, 1]
            w = end[i, 2] - start[i, 2]
            apart = least_length(x, y, z, u, v, w) - links.radius[i] - bend[i]
            apart = apart - r - V * seconds[i]
            # A bound that is none (NaN) shows nothing.
            if apart >= enough:
                low = min(low, apart)
                continue
            found[count, 0], found[count, 1] = i, k
            count += 1
    return found[:count], low


@compiled
def path_curvature(line: Line, reach: np.ndarray, links: Links) -> np.ndarray:
    """The largest acceleration of the links on a line, (A3) in the world; (L,) [m]."""
    speed = np.abs(line.x)
    return times(reach, speed * (speed + 2.0 * times(links.above, speed)))


@compiled
def near_line(
    line: Line,
    last: np.ndarray,
    reach: np.ndarray,
    spheres: Spheres,
    r: Robot,
    law: Held,
) -> tuple[np.ndarray, float]:
    """`links_near` of a line, to the floor.

    Args:
        last: (L,) `last_times`.
        reach: (L, nv) `own_reach`.
        law: holds `WorldLaw`.
    """
    links, numbers = law.value.links.value, law.value.numbers
    axes, L = 3 * links.reach.shape[1], len(links.radius)
    start = place_links(line.start, r, links)[axes : axes + L]
    end = place_links(line.start + line.x, r, links)[axes : axes + L]
    bend = 0.125 * path_curvature(line, reach, links)
    seconds = np.zeros(L)
    for i in range(L):
        if not last[i] < 0.0:
            seconds[i] = braking_time(last[i], line.before, numbers)
    return links_near(start, end, bend, seconds, numbers.floor, spheres, links)


@compiled
def nearest_to(p: np.ndarray, u: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, float]:
    """Where a segment, from p by u, is nearest to a point c, (3,) each.

    Returns:
        (3,) the unit normal from the point to the segment; their distance [m].
    """
    uu = ur = 0.0
    for i in range(3):
        uu += u[i] * u[i]
        ur += u[i] * (p[i] - c[i])
    s = 0.0
    if uu > 0.0:
        s = min(max(-ur / uu, 0.0), 1.0)
    n, far = np.empty(3), 0.0
    for i in range(3):
        n[i] = p[i] + s * u[i] - c[i]
        far += n[i] * n[i]
    far = np.sqrt(far)
    if far < 1e-12:
        n[0], n[1], n[2] = 0.0, 0.0, 1.0  # any bounds the distance from below
    else:
        for i in range(3):
            n[i] /= far
    return n, far


@compiled
def line_bounds(
    line: Line, levels: Levels, quick: bool, spheres: Spheres, r: Robot, law: Held
) -> Found:
    """(M2) on a whole line: whether links keep their levels of spheres.

    As `admission.path_bounds`: the gap of two shadows on a fixed direction is concave
    along the line, to the first order, and V t is convex. So in a part of the line it
    is enough to look where the part begins and ends, and where V t ends.

    What is not clear now is asked from the next braking path on: else a robot that
    rests too near could never leave.

    Args:
        line: the way and the braking path.
        quick: whether one that fails is enough to know.
        law: holds `WorldLaw`.
    """
    links, numbers = law.value.links.value, law.value.numbers
    reach = own_reach(line, links)
    last = last_times(line, reach, links, numbers)
    near, clearance = near_line(line, last, reach, spheres, r, law)
    L, N, nv = len(links.radius), len(spheres.radius), len(line.x)
    failed = np.zeros((L, N), dtype=np.bool_)
    if not len(near):
        return Found(True, clearance, -1, -1, failed)
    lasts = line.before + numbers.T  # seconds at the speed that it begins with
    curvature = path_curvature(line, reach, links)
    count = 0
    for k in range(len(near)):
        count += links.shapes[near[k, 0] + 1] - links.shapes[near[k, 0]]
    item = np.empty((count, 3), dtype=np.int64)
    count = 0
    for k in range(len(near)):
        for shape in range(links.shapes[near[k, 0]], links.shapes[near[k, 0] + 1]):
            item[count, 0], item[count, 1] = near[k, 0], near[k, 1]
            item[count, 2] = shape
            count += 1
    link, sphere, most = -1, -1, -np.inf
    open_ = np.ones((1, count), dtype=np.bool_)
    w, placed = np.zeros((L, 6)), np.zeros(L, dtype=np.bool_)
    for halving in range(_HALVINGS + 1):
        parts, half = len(open_), 0.5 / len(open_)
        below = np.zeros((2 * parts, count), dtype=np.bool_)
        remain = False
        for part in range(parts):
            if not open_[part].any():
                continue
            middle = (2 * part + 1) * half
            at = place_links(line.start + middle * line.x, r, links)
            S = joint_motion(at[: 3 * nv].reshape(1, -1, 3))[0]
            placed[:] = False
            for k in range(count):
                if not open_[part, k]:
                    continue
                i, o, shape = item[k, 0], item[k, 1], item[k, 2]
                if not placed[i]:
                    placed[i] = True
                    for c in range(6):
                        w[i, c] = 0.0
                        for j in range(nv):
                            w[i, c] += S[c, j] * line.x[j] * links.carried[i, j]
                p, u = at[3 * nv + L + shape], at[3 * nv + L + len(links.radii) + shape]
                centre, speed = spheres.centre[o], spheres.speed[o]
                n, far = nearest_to(p, u, centre)
                thick = links.radii[shape] + spheres.radius[o]
                start = along = moves = turns = 0.0
                for c in range(3):
                    d, e = (c + 1) % 3, (c + 2) % 3
                    start += n[c] * (p[c] - centre[c])
                    along += n[c] * u[c]
                    spin = w[i, d] * p[e] - w[i, e] * p[d]
                    moves += n[c] * (w[i, 3 + c] + spin)
                    turns += n[c] * (w[i, d] * u[e] - w[i, e] * u[d])
                off = thick + 0.5 * half * half * curvature[i]
                low, high = middle - half, middle + half
                # What is not clear now is asked from where the way ends.
                begin, rest = low, low
                if levels.moving[i, o] < numbers.floor:
                    begin = max(low, line.before / lasts)
                if levels.still[i, o] < numbers.floor:
                    rest = max(low, line.before / lasts)
                stop = min(high, last[i] / lasts)
                good, needed, bound = True, -np.inf, np.inf
                if not last[i] < 0.0 and not begin > stop:
                    for t in (begin, stop):
                        by = t - middle
                        gap = min(
                            start + by * moves, start + along + by * (moves + turns)
                        )
                        came = speed * braking_time(t * lasts, line.before, numbers)
                        left = gap - off - came
                        bound = min(bound, left)
                        good = good and left >= levels.moving[i, o] - ROUNDING
                    t = min(max(middle, begin), stop)
                    came = speed * braking_time(t * lasts, line.before, numbers)
                    if begin <= middle <= stop:
                        needed = levels.moving[i, o] + came
                if rest < high:
                    for t in (rest, high):
                        by = t - middle
                        gap = min(
                            start + by * moves, start + along + by * (moves + turns)
                        )
                        bound = min(bound, gap - off)
                        good = good and gap - off >= levels.still[i, o] - ROUNDING
                    if rest <= middle:
                        needed = max(needed, levels.still[i, o])
                if good:
                    clearance = min(clearance, bound)
                    continue
                lacks = needed - (far - thick)
                # A distance that is none (NaN) is not clear.
                if not lacks <= 0.0 or halving == _HALVINGS:
                    if quick:
                        failed[i, o] = True
                        return Found(False, clearance, i, o, failed)
                    lacks = max(lacks, 0.0) if lacks == lacks else np.inf
                    if lacks > most:
                        link, sphere, most = i, o, lacks
                    failed[i, o] = True
                    continue
                below[2 * part, k], below[2 * part + 1, k] = True, True
                remain = True
        if not remain:
            break
        # Of what is known to fail, nothing else is asked.
        for k in range(count):
            if failed[item[k, 0], item[k, 1]]:
                below[:, k] = False
        open_ = below
    return Found(link < 0, clearance, link, sphere, failed)


@compiled
def floors(spheres: Spheres, law: Held) -> Levels:
    """The floor for all links and spheres."""
    L = len(law.value.links.value.radius)
    floor = np.full((L, len(spheres.radius)), law.value.numbers.floor)
    return Levels(floor, floor)


@compiled
def braking_line(q: np.ndarray, v: np.ndarray, law: Held) -> Line:
    """The present braking path."""
    return Line(q, law.value.numbers.T * v, 0.0)


@compiled
def command_line(q: np.ndarray, v_next: np.ndarray, law: Held) -> Line:
    """The way of a command of the velocity v_next (n,), and its braking path."""
    numbers = law.value.numbers
    return Line(q, (numbers.period + numbers.T) * v_next, numbers.period)


@compiled
def are_clear(
    q: np.ndarray, v: np.ndarray, spheres: Spheres, robot: Held, law: Held
) -> np.ndarray:
    """(N,) bool, of which spheres the state (n,), (n,) is shown to be clear: (M2)."""
    line, levels = braking_line(q, v, law), floors(spheres, law)
    # How near it is now, and where it rests, is no part of (M2).
    levels = Levels(levels.moving, np.full(levels.still.shape, -np.inf))
    failed = line_bounds(line, levels, False, spheres, robot.value, law).failed
    clear = np.ones(len(spheres.radius), dtype=np.bool_)
    for i in range(failed.shape[0]):
        for k in range(failed.shape[1]):
            clear[k] = clear[k] and not failed[i, k]
    return clear


@compiled
def present_levels(
    line: Line, clear: np.ndarray, spheres: Spheres, r: Robot, law: Held
) -> Levels:
    """What links are to keep: the floor; where they do not on the present braking path,
    the smallest distance there, less what the sphere comes nearer until then.

    Args:
        clear: (N,) bool, of which spheres the state is known to be clear.
        law: holds `WorldLaw`.
    """
    links, numbers = law.value.links.value, law.value.numbers
    L, S, nv = len(links.radius), len(links.radii), len(line.x)
    reach = own_reach(line, links)
    last = last_times(line, reach, links, numbers)
    asked = last.copy()
    if clear.all():
        asked[:] = -1.0
    near, _ = near_line(line, asked, reach, spheres, r, law)
    floor = numbers.floor
    moving = np.full((L, len(spheres.radius)), floor)
    still = moving.copy()
    if not len(near):
        return Levels(moving, still)
    for place in range(_PLACES):
        t = place / (_PLACES - 1)
        at = place_links(line.start + t * line.x, r, links)
        for k in range(len(near)):
            i, o = near[k, 0], near[k, 1]
            for shape in range(links.shapes[i], links.shapes[i + 1]):
                p, u = at[3 * nv + L + shape], at[3 * nv + L + S + shape]
                _, far = nearest_to(p, u, spheres.centre[o])
                d = far - links.radii[shape] - spheres.radius[o]
                still[i, o] = min(still[i, o], d)
                if not clear[o] and t * numbers.T <= last[i]:
                    came = braking_time(t * numbers.T, 0.0, numbers)
                    moving[i, o] = min(moving[i, o], d - spheres.speed[o] * came)
    return Levels(moving, still)


@compiled
def link_gradient(
    i: int, o: int, at: np.ndarray, S: np.ndarray, spheres: Spheres, links: Links
) -> tuple[float, np.ndarray, np.ndarray]:
    """The distance of a link from a sphere, and how the joints change it.

    Args:
        at: (P, 3) of `place_links` [m].
        S: (6, n) of `joint_motion` there.

    Returns:
        The distance of the nearest shape [m]; (n,) its gradient; (3,) the unit normal
        from the sphere to it.
    """
    L, n = len(links.radius), S.shape[1]
    best, normal = np.inf, np.zeros(3)
    for shape in range(links.shapes[i], links.shapes[i + 1]):
        p, u = at[3 * n + L + shape], at[3 * n + L + len(links.radii) + shape]
        n_here, far = nearest_to(p, u, spheres.centre[o])
        if far - links.radii[shape] < best:
            best, normal = far - links.radii[shape], n_here
    # The line of the shortest distance passes the centre: so does the force.
    x, y, z = spheres.centre[o, 0], spheres.centre[o, 1], spheres.centre[o, 2]
    moment = (
        y * normal[2] - z * normal[1],
        z * normal[0] - x * normal[2],
        x * normal[1] - y * normal[0],
    )
    g = np.zeros(n)
    for j in range(n):
        if links.carried[i, j] != 0.0:
            for c in range(3):
                g[j] += moment[c] * S[c, j] + normal[c] * S[3 + c, j]
    return best - spheres.radius[o], g, normal


@compiled
def sphere_rows(
    q: np.ndarray,
    v: np.ndarray,
    s_0: np.ndarray,
    spheres: Spheres,
    approach: Approach,
    r: Robot,
    law: Held,
) -> tuple[np.ndarray, np.ndarray]:
    """g (C, n), least (C,): the rows (L3), (L4) of the spheres that s_0 could bring
    links to.

    As `law.pairs.pair_rows`, of the nearest shape of each link, with a drift of -V,
    but of no more than v_ok: what flees faster would not be safe.

    Args:
        q, v: (n,), (n,) state.
        s_0: (n,) the nominal velocity.
        law: holds `WorldLaw`.
    """
    links, numbers, n = law.value.links.value, law.value.numbers, len(q)
    line = braking_line(q, v, law)
    reach = own_reach(line, links)
    L = len(links.radius)
    here = place_links(q, r, links)
    there = place_links(q + line.x, r, links)
    # A row binds at h = d_min + (drift - g s) / approach_rate.
    ahead = (times(reach, np.abs(s_0)) + numbers.harmless) / approach.approach_rate
    ahead = np.minimum(ahead, approach.influence_distance - approach.distance_margin)
    bend = 0.125 * path_curvature(line, reach, links) + ahead
    near, _ = links_near(
        here[3 * n : 3 * n + L],
        there[3 * n : 3 * n + L],
        bend,
        np.zeros(L),
        approach.distance_margin,
        spheres,
        links,
    )
    d, g = np.zeros((2, len(near))), np.zeros((2, len(near), n))
    drift = np.zeros(2 * len(near))
    for end in range(2):
        at = here if end == 0 else there
        S_world = joint_motion(at[: 3 * n].reshape(1, -1, 3))[0]
        for k in range(len(near)):
            i, o = near[k, 0], near[k, 1]
            d[end, k], g[end, k], _ = link_gradient(i, o, at, S_world, spheres, links)
            drift[end * len(near) + k] = -min(spheres.speed[o], numbers.harmless)
    h = pair_margins(d, g, v, numbers.T)
    some = np.flatnonzero(h < approach.influence_distance)
    least = pair_rates(h, approach) - drift - margin_curvature(g, v)
    return g.reshape(len(h), n)[some], least[some]


@compiled
def evading_rows(
    q: np.ndarray,
    v: np.ndarray,
    v_next: np.ndarray,
    moving: Moving,
    r: Robot,
    law: Held,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(M5): how fast links are to get out of the way of what moves.

        g q_dot' >= n v_o + min(-alpha h, V),      h = d - d_e - tau max(n v_o, 0)

    with d the distance of a link, d_e that which it is kept at, n its direction, from
    the sphere to the link, and v_o the velocity of the sphere.

    Args:
        q, v: (n,), (n,) state.
        v_next: (n,) the velocity of the command.
        law: holds `WorldLaw`.

    Returns:
        (C, n), (C,) g and the right sides; (C, 2) links and spheres. None at all if the
        command keeps to them.
    """
    links, n = law.value.links.value, len(q)
    evasion, spheres = law.value.evasion, moving.spheres
    if not len(spheres.radius):
        return np.zeros((0, n)), np.zeros(0), np.zeros((0, 2), dtype=np.int64)
    L = len(links.radius)
    reach = own_reach(braking_line(q, v, law), links) + links.turned
    at = place_links(q, r, links)
    # A row binds at h = (n v_o - g q_dot') / alpha: V / alpha, and what the command
    # does; other rows ask for up to 2 V, and may move this link by as much.
    ahead = times(reach, np.abs(v_next)) / evasion.rate
    seconds = np.full(L, 3.0 / evasion.rate + evasion.lead)
    balls = at[3 * n : 3 * n + L]
    near, _ = links_near(balls, balls, ahead, seconds, 0.0, spheres, links)
    g, least = np.zeros((len(near), n)), np.zeros(len(near))
    S = joint_motion(at[: 3 * n].reshape(1, -1, 3))[0]
    for k in range(len(near)):
        i, o = near[k, 0], near[k, 1]
        h, g[k], normal = link_gradient(i, o, at, S, spheres, links)
        comes = 0.0
        for c in range(3):
            comes += normal[c] * moving.velocity[o, c]
        h -= evasion.lead * max(comes, 0.0)
        least[k] = comes + min(-evasion.rate * h, spheres.speed[o])
    if not (times(g, v_next) < least).any():
        return g[:0], least[:0], near[:0]
    return g, least, near
