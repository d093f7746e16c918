"""States to start in: whatever is clear, by the adversary's own judge."""

import numpy as np

from benchmarks.adversary.judge import Judge
from crar_drake.errors import CrarError
from crar_drake.robot.model import ControlModel

POSE_CLEARANCE = 5e-3  # [m] of a pose at rest
PATH_CLEARANCE = 2e-3  # [m] of the braking path of a moving start
FASTEST = 20.0  # [rad/s or m/s] of joints without a speed limit
LIMIT_GAP = 1e-3  # [rad or m] that starts keep from limits,
FARTHEST = 2.0  # or may be beyond them, where that is the attack
_BATCH = 64


def random_poses(
    model: ControlModel, judge: Judge, rng: np.random.Generator, count: int
) -> np.ndarray:
    """Clear poses (count, nq), anywhere within the limits; prescribed joints rest.

    Raises:
        CrarError: hardly any pose is clear.
    """
    rest = model.rest_positions()
    c = model.controlled
    gap = limit_gap(judge)
    lower = np.maximum(judge.lower + gap, rest[c] - np.pi)
    upper = np.minimum(judge.upper - gap, rest[c] + np.pi)
    found = []
    for _ in range(200):
        q = np.tile(rest, (_BATCH, 1))
        # Some near the rest posture, which is where robots are.
        spread = rng.choice([0.3, 1.0], size=(_BATCH, 1))
        middle = np.clip(rest[c], lower, upper)
        q[:, c] = middle + spread * (
            rng.uniform(lower, upper, (_BATCH, len(c))) - middle
        )
        found.extend(q[judge.nearest(q)[0] > POSE_CLEARANCE])
        if len(found) >= count:
            return np.array(found[:count])
    raise CrarError("hardly any pose of the robot is clear: is its model right?")


def limit_gap(judge: Judge) -> np.ndarray:
    """(n,) what starts keep from limits; less where a range is narrow."""
    return np.minimum(LIMIT_GAP, 0.25 * (judge.upper - judge.lower))


def at_rest(
    model: ControlModel, judge: Judge, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The rest posture, if it is clear, or a random pose; without velocity."""
    q = model.rest_positions()
    v = np.zeros(len(q))
    if rng.random() < 0.5 or not judge.path_is_clear(q, v, 0.0, POSE_CLEARANCE):
        q = random_poses(model, judge, rng, 1)[0]
    return q, v


def fast(
    model: ControlModel, judge: Judge, rng: np.random.Generator, horizon: float
) -> tuple[np.ndarray, np.ndarray]:
    """A state that is as fast as its braking path, dense in samples, allows.

    Along a random direction the velocity grows until the path comes within
    PATH_CLEARANCE of a contact, or a speed or position limit; of several, the one
    whose joints are fastest, or the one whose path comes nearest to a contact.
    """
    c = judge.controlled
    gap = limit_gap(judge)
    fastest = np.where(gap > 0.0, np.minimum(judge.fastest, FASTEST), 0.0)
    shares = np.linspace(0.0, 1.0, 81)
    best_q, best_v = at_rest(model, judge, rng)
    best, nearest_counts = -np.inf, rng.random() < 0.5
    for q in random_poses(model, judge, rng, 8):
        v = np.zeros(len(q))
        v[c] = fastest * rng.uniform(-1.0, 1.0, len(c))
        v[c] *= rng.choice([1.0, 0.2], size=len(c))
        path = q + horizon * shares[:, None] * v
        x = path[:, c]
        d, _ = judge.nearest(path)
        clear = d >= PATH_CLEARANCE
        clear &= np.all(x >= judge.lower + 0.5 * gap, axis=1)
        clear &= np.all(x <= judge.upper - 0.5 * gap, axis=1)
        reached = len(shares) if clear.all() else int(np.argmin(clear))
        last = max(reached - 1, 0)
        v *= shares[last]
        value = -d[: last + 1].min() if nearest_counts else np.abs(v[c]).sum()
        if value > best and judge.path_is_clear(q, v, horizon, 0.9 * PATH_CLEARANCE):
            best, best_q, best_v = value, q, v
    return best_q, best_v


def beyond(
    model: ControlModel, judge: Judge, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A clear pose with joints beyond their limits, and prescribed ones anywhere."""
    lower, upper = judge.lower, judge.upper
    for _ in range(20):
        q = np.repeat(random_poses(model, judge, rng, _BATCH // 4), 4, axis=0)
        x = q[:, model.controlled]
        moved = rng.random(x.shape) < rng.choice([0.0, 0.3, 1.0], size=(len(q), 1))
        by = 10.0 ** rng.uniform(-3.0, np.log10(FARTHEST), x.shape)
        up = rng.random(x.shape) < 0.5
        outside = np.where(up, upper + by, lower - by)
        q[:, model.controlled] = np.where(moved & np.isfinite(outside), outside, x)
        of_prescribed = (len(q), model.n_p)
        q[:, model.prescribed] += rng.uniform(-FARTHEST, FARTHEST, of_prescribed)
        clear = judge.nearest(q)[0] > POSE_CLEARANCE
        if clear.any():
            return q[clear.argmax()], np.zeros(q.shape[1])
    return at_rest(model, judge, rng)


def touching(
    model: ControlModel, judge: Judge, rng: np.random.Generator, floor: float
) -> tuple[np.ndarray, np.ndarray]:
    """A pose at rest whose smallest distance is the floor, to the last digits."""
    clear = random_poses(model, judge, rng, _BATCH)
    other = clear[rng.permutation(len(clear))]
    ways = (
        clear[:, None] + np.linspace(0.0, 1.0, 30)[:, None] * (other - clear)[:, None]
    )
    d = judge.nearest(ways.reshape(-1, clear.shape[1]))[0].reshape(len(clear), -1)
    for k in np.flatnonzero((d < floor).any(axis=1)):
        near = int((d[k] < floor).argmax())
        low, high = ways[k, near - 1], ways[k, near]
        for _ in range(60):
            middle = 0.5 * (low + high)
            if judge.nearest(middle[None])[0][0] < floor:
                high = middle
            else:
                low = middle
        return (low if rng.random() < 0.5 else high), np.zeros(clear.shape[1])
    return at_rest(model, judge, rng)


def singular(
    model: ControlModel, judge: Judge, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A clear pose in which the task Jacobian has as small a singular value as found.

    Joints are moved to 0 (where arms are stretched and axes of shoulders and wrists
    are in line) or to random places, one by one, as long as the value shrinks.
    """
    c = model.controlled
    workspace = model.MakeWorkspace()
    v = np.zeros(model.plant.num_velocities())

    def smallest(q: np.ndarray) -> float:
        J = model.evaluate(workspace, q, v).J
        return float(np.linalg.svd(J, compute_uv=False)[-1])

    poses = random_poses(model, judge, rng, 12)
    q = min(poses, key=smallest)
    value = smallest(q)
    gap = limit_gap(judge)
    lower = np.maximum(judge.lower + gap, -np.pi)
    upper = np.minimum(judge.upper - gap, np.pi)
    for i in np.concatenate([rng.permutation(len(c)) for _ in range(3)]):
        for x in (0.0, rng.uniform(lower[i], upper[i])):
            other = q.copy()
            other[c[i]] = np.clip(x, lower[i], upper[i])
            better = smallest(other)
            if better < value and judge.path_is_clear(other, v, 0.0, POSE_CLEARANCE):
                q, value = other, better
    return q, v
