"""A control law among obstacles that move by themselves.

A step of the law is a desired step of the filter: it is taken bit-identical where
nothing is near, and else changed as a joint command is. The law keeps pairs and limits
itself, and goes on from where that leads.
"""

from dataclasses import replace

import numpy as np

from crar_drake.control.obstacles import Obstacles, Regions
from crar_drake.control.parameters import CrarParameters
from crar_drake.control.records import Memory, Solution
from crar_drake.control.safety_filter import SafetyFilter, filter_parameters
from crar_drake.errors import ScenarioError
from crar_drake.law.step import CORRECTED, State
from crar_drake.robot.model import ControlModel

# A robot that is off its command by less is where it was told to be [rad or m, per
# second]: what was proved of the command holds, for the floor has it to spare.
_AS_TOLD = 1e-6


class _LawFilter(SafetyFilter):
    parameters_of = "controller"


class LawAmong:
    """What becomes of a law's accelerations among obstacles.

    Attributes:
        filter: of all joints, with the horizon and the margins of the law.
    """

    def __init__(self, model: ControlModel, gains: CrarParameters) -> None:
        """
        Raises:
            ScenarioError: the plant does not move in steps of the control period, or a
                parameter does not go with obstacles.
        """
        if gains.balance is not None:
            raise ScenarioError(
                "controller.balance: what obstacles that move leave of a step is not "
                "known to be balanced; leave out obstacles or balance"
            )
        step, period = model.plant.time_step(), gains.period
        if abs(step - period) > 1e-9 * period:
            raise ScenarioError(
                f"obstacles: the plant's time step, {step:g} s, must be the control "
                f"period, {period:g} s: make plant_config.time_step or "
                "controller.period the other"
            )
        ahead = gains.lookahead
        usual = filter_parameters(period)
        # Prescribed joints are the filter's, too.
        limits = gains.speed_limits(model)[model.controlled]
        self.filter = _LawFilter(
            model,
            period,
            replace(
                ahead,
                horizon=gains.braking_horizon,
                longest_horizon=gains.longest_braking_horizon,
                influence_distance=usual.influence_distance,
                approach_rate=usual.approach_rate,
                limit_approach_rate=None,
                preset=None,
                preview=None,
            ),
            effort_limits=gains.limits_efforts,
            velocity_limits=dict(zip(model.joint_names, limits.tolist(), strict=True)),
        )
        self.filter.among  # noqa: B018 (what does not go with them is refused now)

    def compile(self) -> None:
        """Compiles what has yet to be."""
        self.filter.compile(obstacles=True)

    def regions(
        self, before: Memory, given: Obstacles | None, q: np.ndarray, v: np.ndarray
    ) -> Regions | None:
        """Where obstacles are taken to be.

        Args:
            before: of the step before; empty if there is none.
            given: measured now; None if nothing was.
            q, v: (nq,), (nv,) the state.
        """
        regions = before.regions
        if regions is not None and not _as_told(before.solution, q, v):
            regions = replace(regions, clear=np.zeros_like(regions.clear))
            given = regions.spheres if given is None else given
        return self.filter.among.regions(regions, given, q, v)

    def limit(
        self, regions: Regions, q: np.ndarray, v: np.ndarray, solution: Solution
    ) -> tuple[bool, Regions]:
        """Changes a solution's accelerations where they are not clear of obstacles.

        Args:
            regions: where obstacles are taken to be.
            q, v: (nq,), (nv,) the state.
            solution: of the law.

        Returns:
            Whether they were changed; where obstacles are a period on at most.
        """
        filter, how = self.filter, solution.admission
        T, period = filter.parameters.braking_horizon, filter.period
        s = v + T * solution.acceleration
        known = bool(how[3] == 1.0)
        state = State(q, v, len(q), T, period, period, lambda: s, known)
        found, clear = filter.left_among_obstacles(state, regions)
        later, all_clear = regions.later(period, clear), bool(regions.clear.all())
        changed = found.s is not s
        if not np.isnan(how[0]) and (changed or not all_clear):
            how = how.copy()
            if changed:
                how[:2] = max(how[0], found.how, CORRECTED), found.share
                pairs = filter.pairs
                left = found.clearances.get(pairs.name, pairs.least_kept)
                how[2] = left + 0.0 * how[2]  # NaN where not examined
            how[3] *= all_clear
            solution.of_mode = {**solution.of_mode, "admission": how}
        if changed:
            solution.acceleration = (found.s - v) / T
            solution.obstacle = filter.among.ran_into(regions, found)
        return changed, later


def _as_told(solution: Solution | None, q: np.ndarray, v: np.ndarray) -> bool:
    """Whether the robot is where it was told to be a period ago."""
    if solution is None:
        return False
    off = solution.position_command - np.concatenate((q, v))
    return bool(np.abs(off).max() <= _AS_TOLD)
