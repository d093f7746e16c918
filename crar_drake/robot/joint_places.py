"""Which of a plant's positions and velocities are controlled, and which prescribed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, QuaternionFloatingJoint

from crar_drake.equations.free_joints import QUATERNION, TURN

_TRANSLATION = 3


class Places(NamedTuple):
    """Indices in v, and in q: of what is controlled, of what is prescribed, a root that
    floats last in each; and of all of the root, whose orientation comes first."""

    velocities: tuple[np.ndarray, np.ndarray, np.ndarray]
    positions: tuple[np.ndarray, np.ndarray, np.ndarray]


def find_places(
    plant: MultibodyPlant,
    moved: Sequence[Joint],
    root: QuaternionFloatingJoint | None,
    given: Sequence[str],
) -> Places:
    """Where joints are in v and in q.

    Args:
        plant: finalized.
        moved: the prescribed joints, in their order.
        root: the joint by which the base floats; None if it does not.
        given: what of the root is prescribed: "orientation", "position".
    """
    free = [] if root is None else [root]
    parts = [part in given for part in ("orientation", "position")]
    in_v, in_q = _entries(moved)
    root_in_v, root_in_q = _entries(free)
    return Places(
        _parted(
            plant.num_velocities(),
            in_v,
            root_in_v,
            np.repeat(parts, (TURN, _TRANSLATION)),
        ),
        _parted(
            plant.num_positions(),
            in_q,
            root_in_q,
            np.repeat(parts, (QUATERNION, _TRANSLATION)),
        ),
    )


def _parted(
    count: int, moved: np.ndarray, root: np.ndarray, given: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of so many: the controlled, the prescribed, and the root's, of which some are
    given."""
    given = given[: len(root)]  # none of a root that does not float
    joints = np.setdiff1d(np.arange(count), [*moved, *root])
    return (
        np.concatenate([joints, root[~given]]),
        np.concatenate([moved, root[given]]),
        root,
    )


def _entries(joints: Sequence[Joint]) -> tuple[np.ndarray, np.ndarray]:
    """Where joints are in v and in q, one after the other."""
    v, q = [], []
    for joint in joints:
        start = joint.velocity_start()
        v += range(start, start + joint.num_velocities())
        start = joint.position_start()
        q += range(start, start + joint.num_positions())
    return np.array(v, dtype=int), np.array(q, dtype=int)
