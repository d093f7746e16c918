"""The controllers that are compared: their drivers, environments and grids.

A grid is a list of settings that is tried for a peer, case by case; which one is taken
is written to `settings.json` by `compare.py --tune` (its rule is in `compare.best`).
All are asked to keep the same margin of distance.
"""

from dataclasses import dataclass
from itertools import product


@dataclass(frozen=True)
class Peer:
    """One row of the comparison.

    Attributes:
        name: as the tables show it.
        driver: module beside this file; imports nothing that its environment lacks.
        environment: key of ENVIRONMENTS.
        grid: settings to try.
    """

    name: str
    driver: str
    environment: str
    grid: tuple[dict, ...]


# Pinned, so that the figures can be had again. "" is the environment of this project.
ENVIRONMENTS = {
    "": (),
    "placo": ("placo==0.10.2",),
    "pink": ("pin-pink==4.4.0", "pin==4.1.0", "daqp==0.11.0", "qpsolvers==4.13.0"),
    "mink": ("mink==1.3.0", "mujoco==4.0.0", "daqp==0.11.0", "qpsolvers==4.13.0"),
    "drake": ("drake==1.58.0",),
    "oscbf": ("cbfpy==0.1.0", "frax==0.1.0", "jax==0.10.2", "jaxlib==0.10.2"),
    "embodik": ("embodik==0.23.2",),
}
# Those of their packages that are not for every Python of this project.
PYTHONS = {"drake": "python3.12", "embodik": "python3.12"}


def every(common: dict, *more: dict) -> tuple[dict, ...]:
    """All combinations of choices, which are tuples; other values are for all.

    Args:
        common: setting to value or choices, of all grids.
        more: the same, of a grid each; one grid if there are none.
    """
    found = []
    for own in more or ({},):
        choices = {
            name: value if isinstance(value, tuple) else (value,)
            for name, value in (common | own).items()
        }
        found += [
            dict(zip(choices, x, strict=True)) for x in product(*choices.values())
        ]
    return tuple(found)


MARGIN = 0.005  # [m] that every controller is asked to keep

_OSCBF = {
    "posture_gain": 1.0,
    "margin": MARGIN,
    "nearest": 12,
    # Its default, 1e3, gives way; null stands for barriers that never do.
    "penalty": 1e6,
    "tolerance": 1e-3,
    "damping": 1e-3,
}
_ALPHA_1 = (10.0, 20.0, 50.0, 75.0, 100.0, 140.0, 190.0)
_ALPHA_2 = (10.0, 20.0, 30.0, 40.0, 60.0, 80.0, 100.0)
PEERS = (
    Peer(
        "PlaCo, kinematics",
        "run_placo",
        "placo",
        every(
            {
                "solver": "kinematics",
                "posture": 1e-3,
                "margin": MARGIN,
                "trigger": 0.05,
                "velocity_limits": True,
            },
            {
                "gain": (30.0, 60.0, 200.0),
                "regularization": (1e-4, 1e-3, 1e-2),
                "priority": "hard",
                "weight": 1.0,
            },
            {
                "gain": 60.0,
                "regularization": (1e-4, 1e-3),
                "priority": "soft",
                "weight": (10.0, 1000.0),
            },
        ),
    ),
    Peer(
        "PlaCo, dynamics",
        "run_placo",
        "placo",
        every(
            {
                "solver": "dynamics",
                "kp": (300.0, 900.0),
                "posture": 1e-3,
                "posture_kp": 100.0,
                "torque_cost": (1e-6, 1e-4),
                "qdd_safe": (20.0, 80.0, 200.0),
                "margin": MARGIN,
                "trigger": 0.1,
            },
            {"priority": "hard", "weight": 1.0, "velocity_limits": True},
            {"priority": "soft", "weight": 1e3, "velocity_limits": False},
        ),
    ),
    Peer(
        "Pink",
        "run_pink",
        "pink",
        every(
            {
                "posture": 1e-3,
                "damping": 0.03,
                "collision_distance": MARGIN,
                "velocity_limits": True,
            },
            {
                "gain": (60.0, 200.0),
                "barrier_gain": (20.0, 50.0),
                "safe_displacement": (0.0, 0.01, 0.1),
                "acceleration_limit": None,
            },
            {
                "gain": 60.0,
                "barrier_gain": 20.0,
                "safe_displacement": 0.01,
                "acceleration_limit": (100.0, 300.0),
            },
        ),
    ),
    Peer(
        "mink",
        "run_mink",
        "mink",
        every(
            {
                "posture": 1e-3,
                "collision_distance": MARGIN,
                "detection_distance": 0.1,
                "velocity_limits": True,
            },
            {
                "gain": (60.0, 200.0),
                "damping": (0.03, 0.1),
                # Up to 1 by its documentation; up to the period it is a displacement.
                "collision_gain": (0.0005, 0.001, 0.0025, 0.005, 0.05, 0.5),
                "relaxation": 0.0,
            },
            {
                "gain": 60.0,
                "damping": 0.03,
                "collision_gain": (0.001, 0.0025),
                # A negative one asks for a retreat from inside the margin.
                "relaxation": (-1e-4, -5e-4),
            },
        ),
    ),
    Peer(
        "Drake, differential IK",
        "run_drake_diffik",
        "drake",
        every(
            {
                "gain": (15.0, 30.0, 60.0, 200.0),
                "cartesian_weight": (1.0, 100.0),
                "posture_gain": 1.0,
                "collision_distance": MARGIN,
                "influence_distance": (0.05, 0.15),
                "limit_margin": 0.0025,
                "limit_influence": 0.1,
            }
        ),
    ),
    Peer(
        "OSCBF, velocities",
        "run_oscbf",
        "oscbf",
        every(_OSCBF | {"order": 1, "gain": (60.0, 200.0), "alpha": _ALPHA_1}),
    ),
    Peer(
        "OSCBF, accelerations",
        "run_oscbf",
        "oscbf",
        every(_OSCBF | {"order": 2, "gain": (30.0, 60.0), "alpha": _ALPHA_2}),
    ),
    Peer(
        "embodik",
        "run_embodik",
        "embodik",
        every(
            {
                "gain": (60.0, 200.0),
                "posture": 1.0,
                "damping": 0.03,
                "tolerance": (1e-3, 1e-2, 1e-1),
                "mode": ("MIN_ERROR", "SCALE"),
                "tuning": "PRECISE",
                "margin": MARGIN,
                "constraints": 10,
                "recovery": (0.2, 1.0),
            }
        ),
    ),
)


# Ours, and its settings beside the default: the lookahead of the paper's law.
OURS = Peer("lookahead", "run_crar", "", ({},))
PAPER = {"nominal": {}}
