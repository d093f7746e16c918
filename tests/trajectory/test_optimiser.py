"""Small problems of the optimiser, against SciPy's and by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from crar_drake.errors import CrarError
from crar_drake.trajectory.distance_rows import NearRows
from crar_drake.trajectory.optimiser import (
    AtFrames,
    Part,
    Problem,
    Samples,
)

FRAMES, M = 12, 2


class Following:
    """r = 3 (y_0 + y_1^2 - wanted): not linear, so that steps are iterated."""

    def __init__(self, wanted, step_weights=None):
        self.wanted, self.step_weights = wanted, step_weights
        self.steps = np.full((FRAMES - 1, 1), 0.02)

    def at(self, frames, y):
        r = 3.0 * (y[:, 0] + y[:, 1] ** 2 - self.wanted[frames])
        J = 3.0 * np.stack([np.ones(len(y)), 2.0 * y[:, 1]], axis=1)
        f, G = np.sin(y[:, :1]), np.zeros((len(y), 1, M))
        G[:, 0, 0] = np.cos(y[:, 0])
        return AtFrames(r[:, None], J[:, None], f, G)


def disc(y):
    """(S,) how far a point is outside a disc, and its gradient."""
    away = y - [0.6, 0.3]
    far = np.linalg.norm(away, axis=1)
    return far - 0.25, away / far[:, None]


def near_rows(at, y, look):
    d, g = disc(y)
    d = d - at.asked
    near = np.flatnonzero(d < look)
    return NearRows(near, np.zeros(len(near), dtype=int), d[near], g[near])


def problem(**changes) -> Problem:
    t = np.linspace(0.0, 1.0, FRAMES)
    through = np.stack([1.2 * t, 0.25 + 0.2 * t], axis=1)
    fields = dict(
        tasks=Following(through[:, 0] + through[:, 1] ** 2),
        posture=through,
        posture_weight=np.array([1.0, 2.0]),
        about=through,
        smoothness=np.array([0.5, 1.0]),
        lower=np.array([-np.inf, -1.0]),
        upper=np.array([np.inf, 0.7]),
        fastest=np.array([0.25, 0.2]),
        near_rows=near_rows,
        num_rows=1,
    )
    return Problem(**(fields | changes))


def samples(between=1) -> Samples:
    frames = np.arange(FRAMES)
    k = np.repeat(frames[:-1], between)
    t = np.tile(np.arange(1, between + 1) / (between + 1), FRAMES - 1)
    asked = np.full(FRAMES + len(k), 0.01)
    return Samples(
        np.concatenate([frames, k]), np.concatenate([np.zeros(FRAMES), t]), asked
    )


def places(y, at: Samples):
    t = at.share[:, None]
    return (1.0 - t) * y[at.frame] + t * y[np.minimum(at.frame + 1, FRAMES - 1)]


def cost(problem, y):
    done = problem.tasks.at(np.arange(FRAMES), y)
    bends = problem.smoothness * np.diff(y - problem.about, 2, axis=0)
    posture = problem.posture_weight * (y - problem.posture)
    stands = 0.0
    if problem.tasks.step_weights is not None:
        stands = np.diff(done.f, axis=0) - problem.tasks.steps
        stands = problem.tasks.step_weights * stands
    terms = (done.r, posture, bends, np.asarray(stands))
    return 0.5 * sum(float((z**2).sum()) for z in terms)


def scipy_says(problem, start, at: Samples):
    def rows(x):
        y = x.reshape(FRAMES, M)
        steps = np.diff(y, axis=0)
        return np.concatenate(
            [
                disc(places(y, at))[0] - at.asked,
                (problem.fastest - steps).ravel(),
                (problem.fastest + steps).ravel(),
            ]
        )

    bounds = list(zip(problem.lower, problem.upper, strict=True)) * FRAMES
    found = minimize(
        lambda x: cost(problem, x.reshape(FRAMES, M)),
        start.ravel(),
        method="SLSQP",
        bounds=bounds,
        constraints={"type": "ineq", "fun": rows},
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert found.success
    return found.fun


@pytest.mark.parametrize("fastest, stands", [(0.25, 0), (0.13, 0), (0.25, 6.0)])
def test_a_path_around_a_disc_is_a_minimum(fastest, stands):
    """That SciPy's sequential programs do not find a better one near, and that what is
    to stand from frame 2 to 5 does so the more."""
    of = problem(fastest=np.array([fastest, 0.2]))
    if stands:
        weights = np.zeros((FRAMES - 1, 1))
        weights[2:5] = stands
        of = replace(of, tasks=Following(of.tasks.wanted, weights))
    at = samples()
    part = Part(of, 0, of.posture.copy(), np.ones(FRAMES, dtype=bool), at)
    assert disc(of.posture)[0].min() < -0.15
    part.begin()
    part.solve(FRAMES)
    y = part.y
    assert (disc(places(y, at))[0] - at.asked).min() > -2e-4
    assert np.abs(np.diff(y, axis=0)).max(axis=0)[0] < fastest + 1e-3
    assert y[:, 1].max() < 0.7 + 1e-3
    assert cost(of, y) < 1.01 * scipy_says(of, y, at)
    if stands:
        steps = np.abs(np.diff(np.sin(y[:, 0])) - 0.02)
        assert steps[2:5].max() < 0.5 * steps[7:].max()


def test_held_frames_stay_and_the_rest_goes_on_from_them():
    """As if the whole motion were solved with these frames given."""
    of, at = problem(), samples()
    free = np.zeros(FRAMES, dtype=bool)
    free[2:8] = True
    part = Part(of, 0, of.posture.copy(), free, at)
    part.begin()
    part.solve(FRAMES)
    np.testing.assert_array_equal(part.y[~free], of.posture[~free])
    assert np.abs(part.y[free] - of.posture[free]).max() > 0.05
    # No step of a free unknown makes what is minimised smaller.
    rng = np.random.default_rng(0)
    rows = disc(places(part.y, at))[0] - at.asked

    def lagrangian(y):
        lacks = np.minimum(0.0, disc(places(y, at))[0] - at.asked)
        return cost(of, y) + 1e5 * float((lacks**2).sum())

    here = lagrangian(part.y) - 1e5 * float((np.minimum(0.0, rows) ** 2).sum())
    for _ in range(50):
        step = np.zeros_like(part.y)
        step[free] = 1e-2 * rng.normal(size=(free.sum(), M))
        assert lagrangian(part.y + step) > here - 1e-3


def test_a_part_is_a_piece_of_its_motion():
    """Counted from its first frame, tasks and posture are those of its own frames."""
    of = problem()
    whole = Part(of, 0, of.posture.copy(), np.arange(FRAMES) >= 5, samples())
    whole.begin()
    whole.solve(FRAMES)
    at = samples()
    own = at.frame >= 3
    piece = Samples(at.frame[own] - 3, at.share[own], at.asked[own])
    part = Part(of, 3, of.posture[3:].copy(), np.arange(3, FRAMES) >= 5, piece)
    part.begin()
    part.solve(FRAMES)
    np.testing.assert_allclose(part.y, whole.y[3:], atol=1e-9)


def test_what_is_not_a_number_is_refused_by_its_frame():
    """From there no step is of use: the start would come back as if it were found."""
    of = problem()
    of.tasks.wanted = of.tasks.wanted.copy()
    of.tasks.wanted[7] = np.nan
    at = samples()
    own = at.frame >= 3
    piece = Samples(at.frame[own] - 3, at.share[own], at.asked[own])
    part = Part(of, 3, of.posture[3:].copy(), np.ones(FRAMES - 3, dtype=bool), piece)
    with pytest.raises(CrarError, match="^about frame 8: "):
        part.begin()


def test_one_that_cannot_be_had_ends_and_is_as_near_as_may_be():
    """A disc that fills what the limits leave."""
    of = problem(lower=np.array([0.5, 0.25]), upper=np.array([0.7, 0.35]))
    part = Part(of, 0, of.posture.copy(), np.ones(FRAMES, dtype=bool), samples())
    part.begin()
    part.solve(FRAMES)
    assert np.isfinite(part.y).all() and disc(part.y)[0].max() < 0.01
