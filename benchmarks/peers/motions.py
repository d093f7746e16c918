"""The motions that every controller is given: hands swung through each other.

Written as formulas in joint space, so that all seven task points are consistent with
the robot at every instant: whatever error is left is the constraints' doing. The
joint path is q(t) = q_from + w(t) (q_to - q_from) + u(t) A sin(2 pi f (t - t0)), with
two smooth steps w and u, and its derivatives are those of this formula.
`random_crossing` draws such motions, for any robot.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SWINGS_PER_SECOND = 1.1  # f [Hz]

# Poses: joint to angle [rad]; those not named keep the angle of the rest posture.
ARMS_APART = {
    "left_shoulder_pitch": -0.35,
    "left_shoulder_roll": 0.1,
    "left_shoulder_yaw": 0.1,
    "left_elbow": -1.6,
    "right_shoulder_pitch": -0.35,
    "right_shoulder_roll": -0.1,
    "right_shoulder_yaw": -0.1,
    "right_elbow": -1.6,
}
ARMS_CROSSED = ARMS_APART | {"left_shoulder_yaw": -0.5, "right_shoulder_yaw": 0.5}
# The left arm through the chest and through the right forearm.
ARMS_IN_CHEST = ARMS_APART | {
    "left_shoulder_pitch": 0.05,
    "left_shoulder_yaw": -0.95,
    "left_elbow": -1.75,
    "right_shoulder_yaw": 0.75,
}
# The left arm deep in the chest.
ARM_DEEP_IN_CHEST = ARMS_APART | {
    "left_shoulder_pitch": 0.15,
    "left_shoulder_yaw": -1.2,
    "left_elbow": -1.75,
    "right_shoulder_yaw": 0.75,
}
# Amplitudes A of the swing [rad]: both hands inwards at once, while one rises and
# the torso turns.
SWING = {
    "torso_yaw": 0.25,
    "torso_pitch": 0.1,
    "left_shoulder_yaw": -0.8,
    "right_shoulder_yaw": 0.8,
    "right_shoulder_roll": 0.5,  # 3 degrees beyond its limit
    "left_shoulder_pitch": 0.52,
    "right_shoulder_pitch": -0.1,
    "left_elbow": -0.25,
    "right_elbow": 0.15,
}

# Of random motions: distance of the two poses [m], how deep they penetrate between
# them [m], the fastest joint [rad/s], and how far unlimited joints turn [rad].
APART = 0.02
SHALLOWEST, DEEPEST = 0.01, 0.1
FASTEST_JOINT = 4.0
FREE_JOINT = 1.5
TRIES = 30000  # a motion; hardly any two poses of some robots are far enough apart


@dataclass(frozen=True)
class JointMotion:
    """A joint-space reference.

    Attributes:
        q_from, q_to: (n,) poses before and after the first smooth step [rad].
        amplitude: (n,) of the swing [rad].
        departure, arrival: times of the first smooth step [s].
        duration: of the motion [s].
        frequency: f of the swing [Hz].
    """

    q_from: np.ndarray
    q_to: np.ndarray
    amplitude: np.ndarray
    departure: float
    arrival: float
    duration: float
    frequency: float = SWINGS_PER_SECOND

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """q, q_dot and q_ddot, (T, n) each, at the times (T,)."""
        w = smooth_step(time, self.departure, self.arrival)
        u = smooth_step(time, self.departure, self.arrival + 0.5)
        omega = 2.0 * np.pi * self.frequency
        phase = omega * (time - self.departure)
        s = np.sin(phase), omega * np.cos(phase), -(omega**2) * np.sin(phase)
        swing = (
            u[0] * s[0],
            u[1] * s[0] + u[0] * s[1],
            u[2] * s[0] + 2.0 * u[1] * s[1] + u[0] * s[2],
        )
        q, v, a = (
            np.outer(w[i], self.q_to - self.q_from) + np.outer(swing[i], self.amplitude)
            for i in range(3)
        )
        return q + self.q_from, v, a


def random_crossing(
    seed: int,
    rest: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    smallest_distance: Callable[[np.ndarray], float],
) -> JointMotion:
    """A motion, drawn at random, whose hands swing through each other or the body.

    It swings between two clear poses on a straight line in joint space that
    penetrates between them, and stays within the limits of the joints; it starts in
    the rest posture.

    Args:
        seed: the same one draws the same motion.
        rest: (n,) rest posture [rad].
        lower, upper: (n,) limits [rad], infinite where there are none.
        smallest_distance: of the pairs that are to meet, at q (n,) [m].

    Raises:
        ValueError: hardly any two poses are so, e.g. since nothing can meet.
    """
    rng = np.random.default_rng(seed)
    lower = np.maximum(lower, rest - FREE_JOINT)
    upper = np.minimum(upper, rest + FREE_JOINT)
    for _ in range(TRIES):
        reach = rng.uniform(0.2, 0.8)
        first, second = (
            rest + reach * (rng.uniform(lower, upper) - rest) for _ in range(2)
        )
        if min(smallest_distance(first), smallest_distance(second)) < APART:
            continue
        shares = np.linspace(0.0, 1.0, 33)[1:-1]
        way = second - first
        deepest = min(smallest_distance(first + x * way) for x in shares)
        if not -DEEPEST <= deepest <= -SHALLOWEST:
            continue
        half = 0.5 * way
        frequency = rng.uniform(0.4, 1.4)
        fastest = 2.0 * np.pi * frequency * np.abs(half).max()
        frequency *= min(1.0, FASTEST_JOINT / fastest)
        return JointMotion(rest, first + half, half, 0.5, 1.5, 6.0, float(frequency))
    raise ValueError("no crossing was found")


def smooth_step(
    time: np.ndarray, start: float, end: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """10 x^3 - 15 x^4 + 6 x^5 between start and end, and two derivatives."""
    span = end - start
    x = np.clip((time - start) / span, 0.0, 1.0)
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        30.0 * (x * (1.0 - x)) ** 2 / span,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / span**2,
    )
