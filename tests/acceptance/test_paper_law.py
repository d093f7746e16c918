"""The paper's law, written once more: Eqs. (10), (11), (14), (15) and (17) to (35).

Everything is dense and plain: distances and witness points are a query of SceneGraph,
Jacobians are Drake's, of those points; inverses are inverses. What the paper leaves
open stands where it is chosen.
"""

import numpy as np
import product
import pytest
from attacks import judge_of
from judges import RobotJudge, find_link
from pydrake.multibody.tree import JacobianWrtVariable

STATES, PERIOD, AGREE = 60, 1e-3, 1e-10
K, KP, GV, GVN = 30.0, 300.0, 30.0, 30.0  # section IV of the paper
KV, DAMPING = 2.0 * np.sqrt(KP), 0.1
RHO, ALPHA, BETA = 1.0, 50.0, 2.0
JV = JacobianWrtVariable.kV


class PaperLaw:
    """The law at one state after the other, from the robot's own file."""

    def __init__(self, judge: RobotJudge, points: list[str], prescribed: list[int]):
        self.judge, self.plant, self.context = judge, judge.plant, judge.context
        self.points = [find_link(self.plant, name).body_frame() for name in points]
        n = self.plant.num_velocities()
        self.p = np.array(prescribed)
        self.c = np.setdiff1d(np.arange(n), self.p)
        self.limit_before = self.pairs_before = self.dq_before = None

    def step(self, q, v, x_d, v_d, a_d, prescribed, level: str):
        """alpha_c of all joints, dq_c, diagonal W, and the torque."""
        W, c, p = self.plant.world_frame(), self.c, self.p
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)
        zero = np.zeros(3)
        J = np.vstack([self.jacobian(f, zero) for f in self.points])
        bias = np.concatenate(
            [
                self.plant.CalcBiasTranslationalAcceleration(
                    self.context, JV, f, zero, W, W
                )[:, 0]
                for f in self.points
            ]
        )
        x = [f.CalcPoseInWorld(self.context).translation() for f in self.points]
        e = x_d - np.concatenate(x)  # Eq. (11)
        # Prescribed joints follow their motion by Eq. (14), and are known to the rest.
        q_p, v_p, a_p = prescribed
        alpha_p = a_p + KV * (v_p - v[p]) + KP * (q_p - q[p])
        v_r = v_d + K * e - J[:, p] @ v[p]
        a_r = a_d + KV * (v_d - J @ v) + KP * e - J[:, p] @ alpha_p  # Eq. (14)
        J = J[:, c]
        weights = self.weights(q)
        inverse_W = np.diag(1.0 / weights)
        m, n = J.shape
        damped = J @ inverse_W @ J.T + DAMPING**2 * np.eye(m)
        J_star = inverse_W @ J.T @ np.linalg.inv(damped)  # Eq. (34)
        dq_c = J_star @ v_r  # Eq. (15); its gain is that of Eq. (9)
        if level == "velocity":
            before = dq_c if self.dq_before is None else self.dq_before
            alpha = (dq_c - before) / PERIOD  # Eq. (10)
        else:
            alpha = J_star @ (a_r - bias)
            if m < n:  # Eq. (35), with Eq. (33)
                alpha += (np.eye(n) - J_star @ J) @ (GVN * (dq_c - v[c]))
        self.dq_before = dq_c
        commanded = np.zeros(len(v))
        commanded[c], commanded[p] = alpha + GV * (dq_c - v[c]), alpha_p  # Eq. (30)
        torque = self.judge.torques(*(x[None] for x in (q, v, commanded)))[0]
        return commanded, dq_c, weights, torque  # Eq. (29)

    def jacobian(self, frame, point) -> np.ndarray:
        """(3, n) of a point of a frame."""
        W = self.plant.world_frame()
        return self.plant.CalcJacobianTranslationalVelocity(
            self.context, JV, frame, point, W, W
        )

    def weights(self, q: np.ndarray) -> np.ndarray:
        """(n_c,) the diagonal of W, Eqs. (17) to (28)."""
        c = self.c
        lower, upper = self.judge.lower[c], self.judge.upper[c]
        limit = np.zeros(len(c))  # of a joint without limits
        for i in np.flatnonzero(np.isfinite(upper - lower)):
            low, high, q_i = lower[i], upper[i], q[c[i]]
            up = (high - low) ** 2 * (2.0 * q_i - high - low)
            limit[i] = abs(up / (4.0 * (high - q_i) ** 2 * (q_i - low) ** 2))  # (17)
        d, gradient = self.distances()
        slope = -RHO * np.exp(-ALPHA * d) * d**-BETA * (BETA / d + ALPHA)  # Eq. (23)
        pairs = np.abs(slope[:, None] * gradient[:, c])  # Eqs. (19), (25)
        # Nothing is known of what changed before the first step: all is approached.
        if self.limit_before is None:
            self.limit_before, self.pairs_before = limit, pairs
        W_JL = 1.0 + limit * (limit - self.limit_before >= 0.0)  # Eq. (18)
        W_COL = 1.0 + pairs * (pairs - self.pairs_before >= 0.0)  # Eq. (21)
        self.limit_before, self.pairs_before = limit, pairs
        a = 1.0 / (len(d) + 1)  # Eq. (28)
        return a * W_JL + (1.0 - a) * W_COL.mean(axis=0)  # Eqs. (26), (27)

    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """(N_c,) and Eq. (20), (N_c, n): of each pair the nearest two shapes."""
        query, plant = self.judge.query(), self.plant
        d, gradients = [], []
        for a, b in self.judge.pairs:
            links = [find_link(plant, name) for name in (a, b)]
            shapes = [plant.GetCollisionGeometriesForBody(link) for link in links]
            found = [
                query.ComputeSignedDistancePairClosestPoints(x, y)
                for x in shapes[0]
                for y in shapes[1]
            ]
            nearest = min(found, key=lambda pair: pair.distance)
            witnesses = {
                nearest.id_A: nearest.p_ACa,
                nearest.id_B: nearest.p_BCb,
            }
            ends, jacobians = [], []
            for link, of_link in zip(links, shapes, strict=True):
                (shape,) = set(of_link) & set(witnesses)
                X_LS = query.inspector().GetPoseInFrame(shape)
                p_L = X_LS.multiply(witnesses[shape])
                frame = link.body_frame()
                ends.append(frame.CalcPoseInWorld(self.context).multiply(p_L))
                jacobians.append(self.jacobian(frame, p_L))
            d.append(nearest.distance)
            way = ends[0] - ends[1]
            gradients.append((jacobians[0] - jacobians[1]).T @ way / nearest.distance)
        return np.array(d), np.array(gradients)

    def is_searched_well(self, q: np.ndarray) -> bool:
        """Whether SceneGraph's search has found distances, and not ended too early."""
        self.plant.SetPositions(self.context, q)
        beyond = self.distances()[0] - self.judge.distances(q[None])[0]
        return bool(beyond.max() <= 0.99 * product.MEASURED_WITHIN)


def random_states(judge: RobotJudge, rest: np.ndarray, prescribed: list[int]):
    """STATES states q, v that are apart and within limits; half of them are near."""
    rng, around = np.random.default_rng(60), np.full(len(rest), 2.0)
    around[prescribed] = 0.1
    lower = np.maximum(judge.lower, rest - around)
    upper = np.minimum(judge.upper, rest + around)
    share = rng.uniform(0.02, 0.98, (40 * STATES, len(rest)))
    q = lower + share * (upper - lower)
    d = judge.distances(q).min(axis=1)
    near, far = q[(d > 2e-3) & (d < 0.02)], q[d > 0.02]
    chosen = np.concatenate([near[: STATES // 2], far[: STATES - STATES // 2]])
    assert len(chosen) == STATES
    return zip(chosen, rng.normal(0.0, 1.0, chosen.shape), strict=True)


@pytest.mark.parametrize("level", ["velocity", "acceleration"])
@pytest.mark.parametrize("points", ["wrists", "seven"])
def test_the_law_is_the_papers(points, level):
    names = product.points_of(points)
    law = product.Law(
        product.BUILT_IN, names, period=PERIOD, paper=level, motors=False, blend=0.0
    )
    judge = judge_of(product.BUILT_IN)
    links = product.links_of(product.BUILT_IN, names)
    rng = np.random.default_rng(9)
    seen, compared = set(), 0
    for q, v in random_states(judge, law.rest, law.prescribed):
        plain = PaperLaw(judge, links, law.prescribed)
        law.restart()
        for _ in range(2):  # the second step knows what is approached
            points_d = law.home + rng.normal(0.0, 0.2, law.home.shape)
            v_d, a_d = rng.normal(0.0, 1.0, (2, *law.home.shape))
            given = rng.normal(0.0, 0.1, (3, len(law.prescribed)))
            given[0] += q[law.prescribed]
            ours = law.step(q, v, points_d, v_d, a_d, prescribed=given)
            if not plain.is_searched_well(q):
                break
            desired = points_d.ravel(), v_d.ravel(), a_d.ravel()
            a, dq_c, W, torque = plain.step(q, v, *desired, given, level)
            for told, found in (
                (ours.dq, dq_c),
                (ours.weights, W),
                (ours.a, a),
                (ours.torques, torque),
            ):
                assert np.abs(told - found).max() <= AGREE * np.abs(found).max()
            seen.add(bool((W > 2.0).any()))
            compared += 1
            q, v = q + PERIOD * v, v + PERIOD * rng.normal(0.0, 5.0, len(v))
    assert seen == {True, False}  # near to constraints, and far from them
    assert compared > 1.8 * STATES
