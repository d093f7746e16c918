"""Newton and Euler against closed forms and against the change of momentum."""

import numpy as np
import pytest
from floating_robots import make_floater, random_state
from ground_demand import GroundWrench, ground_wrench


@pytest.fixture(scope="module")
def floater():
    return make_floater()


def momentum(plant, context):
    """Of all that moves, about the world's origin: linear and angular (6,)."""
    h = plant.CalcSpatialMomentumInWorldAboutPoint(context, np.zeros(3))
    return np.concatenate([h.translational(), h.rotational()])


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_change_of_momentum_and_the_weight(floater, seed):
    plant = floater.plant
    context = plant.CreateDefaultContext()
    q, v = random_state(floater, seed)
    at = floater.prescribed_positions[-7:-3]
    q[at] /= np.linalg.norm(q[at])
    vdot = np.random.default_rng(seed).normal(size=len(v))
    found = ground_wrench(plant, q[None], v[None], vdot[None])
    rates, h = [], 1e-5
    for sign in (-1.0, 1.0):
        plant.SetPositions(context, q)
        step = sign * h
        qdot = plant.MapVelocityToQDot(context, v + 0.5 * step * vdot)
        plant.SetPositions(context, q + step * qdot)
        plant.SetVelocities(context, v + step * vdot)
        rates.append(momentum(plant, context))
    change = (rates[1] - rates[0]) / (2.0 * h)
    plant.SetPositions(context, q)
    p = plant.CalcCenterOfMassPositionInWorld(context)
    lift = np.array([0.0, 0.0, found.weight])
    np.testing.assert_allclose(found.force[0], change[:3] + lift, atol=2e-3)
    np.testing.assert_allclose(
        found.moment[0], change[3:] + np.cross(p, lift), atol=5e-3
    )


def test_who_accelerates_leans():
    """A mass m at height h: the centre lags by h a / g, measured from any floor."""
    m, g, a = 2.0, 10.0, np.array([3.0, -1.0, 0.0])
    p = np.array([0.3, 0.2, 0.9])
    force = m * (a + [0, 0, g])
    wrench = GroundWrench(force[None], np.cross(p, force)[None], m * g)
    for floor in (0.0, 0.15):
        expected = p[:2] - (p[2] - floor) * a[:2] / g
        np.testing.assert_allclose(wrench.centres(floor)[0], expected, atol=1e-12)
    flying = GroundWrench(np.zeros((1, 3)), np.zeros((1, 3)), m * g)
    assert np.isnan(flying.centres()).all()
