"""A step of the filter among spheres that move: what is left of a command.

What `joint_filter.filter_step` found is taken as it is, to the last bit, if it keeps
the links clear of all spheres (`moving_obstacles`). Else the guard has rows of them,
too, and if that is not clear the step is scaled towards braking: of the joints that
move the links in question, or of all.
"""

import numpy as np

from crar_drake.equations.admission import (
    AS_NOMINAL,
    BISECTIONS,
    CORRECTED,
    SCALED,
    AdmissionGains,
)
from crar_drake.equations.compilation import Held, compiled
from crar_drake.equations.joint_filter import (
    FilterLaw,
    Level,
    box_constraints,
    check_line,
    guard_rows,
    guarded,
    present_level,
    velocity_after,
)
from crar_drake.equations.lookahead_guard import LESS, step_bounds
from crar_drake.equations.lookahead_rows import Constraints, join_constraints
from crar_drake.equations.moving_obstacles import (
    Levels,
    Moving,
    Spheres,
    all_far,
    braking_line,
    command_line,
    evading_rows,
    line_bounds,
    own_reach,
    present_levels,
    sphere_rows,
)
from crar_drake.equations.vectors import times

# Entries of what `step_among` reports.
AMONG_HOW, AMONG_SHARE, AMONG_PAIRS, AMONG_CLEARANCE, LINK, SPHERE = range(6)
AMONG = 6


@compiled
def keeps_clear(
    q: np.ndarray,
    v_next: np.ndarray,
    level: Level,
    levels: Levels,
    spheres: Spheres,
    law: FilterLaw,
    world: Held,
) -> tuple[bool, float, float]:
    """Whether a step keeps the levels of pairs and of spheres; both clearances [m]."""
    line = command_line(q, v_next, world)
    found = line_bounds(line, levels, True, spheres, law.robot.value, world)
    if not found.clear:
        return False, np.inf, found.clearance
    checked = check_line(q, v_next, level, True, law)
    return checked.clear, checked.clearance, found.clearance


@compiled
def harmless_share(q: np.ndarray, v: np.ndarray, s: np.ndarray, world: Held) -> float:
    """The share of s that leads to a state as slow as is harmless, at most 1."""
    links, numbers = world.value.links.value, world.value.numbers
    reach = own_reach(braking_line(q, v, world), links) + links.turned
    left = numbers.kappa * (numbers.harmless - times(reach, np.abs(v)))
    asked = (numbers.period / numbers.T) * times(reach, np.abs(s))
    share = 1.0
    for i in range(len(left)):
        if asked[i] > 0.0:
            share = min(share, 0.999 * left[i] / asked[i])
    return max(share, 0.0)


@compiled
def known_after(
    clear: np.ndarray, proved: bool, levels: Levels, world: Held
) -> np.ndarray:
    """(N,) 1 where the next state is clear of a sphere: it was, or keeps the floor.

    Args:
        clear: (N,) bool, of which spheres the state is known to be clear.
        proved: whether the step was shown to keep the levels; braking was not.
        world: holds `WorldLaw`.
    """
    known = np.zeros(len(clear))
    for k in range(len(clear)):
        floor = (levels.moving[:, k] >= world.value.numbers.floor).all()
        known[k] = 1.0 if clear[k] or (proved and floor) else 0.0
    return known


@compiled
def moved_by(failed: np.ndarray, world: Held) -> np.ndarray:
    """(n,) 1 for the joints that move a link that is too near a sphere; (L, N) bool."""
    carried = world.value.links.value.carried
    scaled = np.zeros(carried.shape[1])
    for i in range(failed.shape[0]):
        if failed[i].any():
            scaled = np.maximum(scaled, carried[i])
    return scaled


@compiled
def evading_constraints(
    v: np.ndarray,
    g: np.ndarray,
    least: np.ndarray,
    admission: AdmissionGains,
    world: Held,
) -> Constraints:
    """The rows of `evading_rows` on s: g s >= g q_dot + (least - g q_dot) T / period.

    Args:
        v: (n,) velocity.
        g, least: (C, n), (C,) the rows on q_dot'.
        world: holds `WorldLaw`.
    """
    now, zero = times(g, v), np.zeros(len(least))
    retreat = now + (least - now) * (admission.T / admission.period)
    weight = np.full(len(least), world.value.evasion.weight)
    return Constraints(zero, g, zero, weight, retreat)


@compiled
def less_wanted(
    q: np.ndarray,
    v: np.ndarray,
    s_1: np.ndarray,
    rows: Constraints,
    lowest: np.ndarray,
    highest: np.ndarray,
    failed: np.ndarray,
    level: Level,
    levels: Levels,
    spheres: Spheres,
    law: FilterLaw,
    world: Held,
) -> tuple[bool, float, np.ndarray, np.ndarray, float, float]:
    """Less of a command, but all of the way out, that keeps the levels.

    Less of the joints that move what is too near; of all if that is not enough.

    Args:
        q, v: (n,), (n,) state.
        s_1: (n,) of the command.
        rows: the guard's, those of `evading_constraints` among them.
        lowest, highest: (n,), (n,) bounds.
        failed: (L, N) bool, what is too near if all of the command is asked for.
        level, levels: that pairs and spheres are to keep.

    Returns:
        Whether there is any; the share of the command; (n,) s, of the largest share
        that was found, or else of none; (n,) the velocity that it leads to; clearances
        of pairs and of spheres [m].
    """
    admission = law.mode.value.admission
    s, after = s_1, v
    pair = sphere_left = np.inf
    for some in (True, False):
        scaled = moved_by(failed, world) if some else np.ones(len(q))
        s = guarded((1.0 - scaled) * s_1, rows, lowest, highest)
        after = velocity_after(s, v, admission)
        good, pair, sphere_left = keeps_clear(
            q, after, level, levels, spheres, law, world
        )
        if not good:
            continue
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            share = 0.5 * (low + high)
            asked = (1.0 - (1.0 - share) * scaled) * s_1
            other = guarded(asked, rows, lowest, highest)
            to = velocity_after(other, v, admission)
            good, of_pair, left = keeps_clear(q, to, level, levels, spheres, law, world)
            if good:
                low, s, after, pair, sphere_left = share, other, to, of_pair, left
            else:
                high = share
        return True, low, s, after, pair, sphere_left
    return False, 0.0, s, after, pair, sphere_left


@compiled
def step_among(
    q: np.ndarray,
    v: np.ndarray,
    v_next: np.ndarray,
    held: bool,
    clear: np.ndarray,
    spheres: Spheres,
    moving: Moving,
    law: Held,
    world: Held,
) -> np.ndarray:
    """What is left of a command among spheres.

    Args:
        q, v: (n,), (n,) state.
        v_next: (n,) the velocity of the command.
        held: whether all pairs are clear of each other on the present braking path.
        clear: (N,) bool, of which spheres the state is known to be clear.
        spheres: (N,) of them.
        moving: what is evaded, if anything.
        law: holds `FilterLaw`.
        world: holds `WorldLaw`.

    Returns:
        One after the other: (6,) what is reported, at AMONG_HOW, ...; (n,) the velocity
        that is left; (N,) 1 where the next state is clear of the sphere as it then may
        be. AMONG_HOW is AS_NOMINAL if the command is left as it is; AMONG_PAIRS is the
        clearance of pairs then on.
    """
    of = law.value
    r, radius = of.robot.value, spheres.radius
    numbers = of.mode.value
    admission, gains = numbers.admission, numbers.gains
    line = command_line(q, v_next, world)
    g, least, who = evading_rows(q, v, v_next, moving, r, world)
    evades = len(who) > 0
    if not evades:
        far, clearance = all_far(line, spheres, r, world)
        if far:
            reported = np.array([AS_NOMINAL, 1.0, np.inf, clearance, -1.0, -1.0])
            return np.concatenate((reported, v_next, np.ones(len(radius))))
    levels = present_levels(braking_line(q, v, world), clear, spheres, r, world)
    found = line_bounds(line, levels, False, spheres, r, world)
    if found.clear and not evades:
        reported = np.array([AS_NOMINAL, 1.0, np.inf, found.clearance, -1.0, -1.0])
        known = known_after(clear, True, levels, world)
        return np.concatenate((reported, v_next, known))
    link, sphere, failed = found.link, found.sphere, found.failed
    level = Level(np.zeros(0), True) if held else present_level(q, v, of)
    s_1 = v + (v_next - v) * (admission.T / admission.period)
    lowest, highest = step_bounds(q, v, len(q), numbers.limits.value, admission)
    if evades:
        # No more suddenly than what was held back catches up.
        most = gains.nominal_speed_limit
        lowest = np.maximum(lowest, np.minimum(s_1, -most))
        highest = np.minimum(highest, np.maximum(s_1, most))
    of_pairs, _ = guard_rows(q, v, s_1, of)
    of_spheres = sphere_rows(q, v, s_1, spheres, gains, r, world)
    rows = join_constraints(
        join_constraints(of_pairs, of_spheres), box_constraints(lowest, highest)
    )
    if evades:
        lacks = least - times(g, v_next)
        if link < 0:
            worst = np.argmax(lacks)
            link, sphere = who[worst, 0], who[worst, 1]
        rows = join_constraints(
            rows, evading_constraints(v, g, least, admission, world)
        )
    s, how, share = guarded(s_1, rows, lowest, highest), CORRECTED, 1.0
    after = velocity_after(s, v, admission)
    good, of_pair, left = keeps_clear(q, after, level, levels, spheres, of, world)
    proved = True
    if not good and evades:
        how = SCALED
        found = line_bounds(
            command_line(q, after, world), levels, False, spheres, r, world
        )
        failed = found.failed
        good, share, s, after, of_pair, left = less_wanted(
            *(q, v, s_1, rows, lowest, highest, failed),
            *(level, levels, spheres, of, world),
        )
    if not good:
        how = SCALED
        # Of the joints that move what is too near; of all if that is not enough.
        scaled = moved_by(failed, world)
        low, high = 0.0, 1.0
        after = velocity_after((1.0 - scaled) * s, v, admission)
        good, of_pair, left = keeps_clear(q, after, level, levels, spheres, of, world)
        if not good:
            # Braking is clear, and needs no check.
            scaled, proved = np.ones(len(q)), False
            after = velocity_after(np.zeros(len(q)), v, admission)
            of_pair = admission.floor if level.held else level.of.min()
            left = levels.moving.min()
        for _ in range(BISECTIONS):
            share = 0.5 * (low + high)
            other = velocity_after((1.0 - (1.0 - share) * scaled) * s, v, admission)
            good, pair, sphere_left = keeps_clear(
                q, other, level, levels, spheres, of, world
            )
            if good:
                low, after, of_pair, left = share, other, pair, sphere_left
                proved = True
            else:
                high = share
        share = low
        if share < LESS[0] and scaled.all():
            # What the guard asks for, a way out among it, would be scaled as well.
            for less in LESS:
                asked = guarded(less * s_1, rows, lowest, highest)
                other = velocity_after(asked, v, admission)
                good, pair, sphere_left = keeps_clear(
                    q, other, level, levels, spheres, of, world
                )
                if good:
                    share, after, of_pair, left = less, other, pair, sphere_left
                    proved = True
                    break
        if not share > 0.0:
            # So slow that nothing is harmed: a share that bisection may miss.
            creep = harmless_share(q, v, s, world)
            other = velocity_after(creep * s, v, admission)
            good, pair, sphere_left = keeps_clear(
                q, other, level, levels, spheres, of, world
            )
            if creep > 0.0 and good:
                share, after, of_pair, left = creep, other, pair, sphere_left
                proved = True
    reported = np.array([how, share, of_pair, left, float(link), float(sphere)])
    known = known_after(clear, proved, levels, world)
    return np.concatenate((reported, after, known))
