"""What the motors of an MJCF can do: the effort limit of each joint."""

from __future__ import annotations

import numpy as np


def effort_limits(model) -> dict[int, float]:
    """Joint to its largest torque or force [Nm or N]; those without one are absent.

    A joint's actuators add up; what the joint itself admits (actuatorfrcrange) is
    beyond them. Of two different bounds the nearer one counts, since an effort limit
    has but one.

    Args:
        model: compiled by MuJoCo.
    """
    import mujoco

    kinds = mujoco.mjtTrn
    at_joint = (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
    by_actuators: dict[int, float] = {}
    for actuator in range(model.nu):
        if int(model.actuator_trntype[actuator]) in at_joint:
            joint = int(model.actuator_trnid[actuator][0])
            most = _largest_force(model, actuator)
            by_actuators[joint] = by_actuators.get(joint, 0.0) + most
    limits = {}
    for joint in range(model.njnt):
        most = by_actuators.get(joint, np.inf)
        if model.jnt_actfrclimited[joint]:
            most = min(most, _nearer(model.jnt_actfrcrange[joint]))
        if np.isfinite(most) and most > 0.0:
            limits[joint] = float(most)
    return limits


def _largest_force(model, actuator: int) -> float:
    """Of one actuator at its joint; infinite where nothing bounds it."""
    import mujoco

    most = np.inf
    if model.actuator_forcelimited[actuator]:
        most = _nearer(model.actuator_forcerange[actuator])
    # A motor's force is its control times a gain; a servo's depends on the error.
    motor = (
        int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        and int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
        and int(model.actuator_dyntype[actuator]) != int(mujoco.mjtDyn.mjDYN_INTEGRATOR)
    )
    if motor and model.actuator_ctrllimited[actuator]:
        gain = abs(float(model.actuator_gainprm[actuator][0]))
        most = min(most, gain * _nearer(model.actuator_ctrlrange[actuator]))
    return most * abs(float(model.actuator_gear[actuator][0]))


def _nearer(bounds: np.ndarray) -> float:
    """The one of a lower and an upper bound that is nearer to zero."""
    lower, upper = (float(v) for v in bounds)
    return min(-lower, upper) if lower < 0.0 < upper else max(abs(lower), abs(upper))
