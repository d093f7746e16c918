"""Faults: how a simulated robot differs from what is believed of it, and when."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.tree import JacobianWrtVariable

from crar_drake.judging.referee import Violations
from crar_drake.run import RunResult
from crar_drake.simulation.disturbances import Disturbances, Push

PUSH_DURATION = 0.2  # [s]
FORCE = 50.0  # of pushes [N]


@dataclass(frozen=True)
class Fault:
    """A way in which the simulated robot differs from what the controller believes.

    Attributes:
        name: of the table's row.
        assumption: that it breaks.
        disturbances: it.
        period: of the controller [s]; None for the one of the whole table.
        latency: that the controller is told of [s].
        late_commands: how late drives get their commands [s], of a filter.
    """

    name: str
    assumption: str = ""
    disturbances: Disturbances = field(default_factory=Disturbances)
    period: float | None = None
    latency: float = 0.0
    late_commands: float = 0.0


@dataclass(frozen=True)
class Judged:
    """A run under a fault, judged by the referee on the true state.

    Attributes:
        fault: it.
        where: which motion.
        verdict: on each step of the plant; None: the state did not stay finite.
    """

    fault: Fault
    where: str
    verdict: Violations | None

    @property
    def violated(self) -> int:
        """Samples with a violation."""
        return 1 if self.verdict is None else self.verdict.num_violated

    @property
    def samples(self) -> int:
        """All of them."""
        return 1 if self.verdict is None else self.verdict.num_samples

    @property
    def smallest_distance(self) -> float:
        """Over pairs and samples [m]; minus infinity without a verdict."""
        return -np.inf if self.verdict is None else self.verdict.smallest_distance


@dataclass(frozen=True)
class Moment:
    """When and where the robot without a fault came nearest to itself.

    Attributes:
        time: [s].
        hand: link that a push acts on.
        towards: (3,) direction in which it comes nearer, in W.
    """

    time: float
    hand: str
    towards: np.ndarray

    def pushes(self, nearest: str, since: Iterable[float]) -> dict[str, Push]:
        """By their directions: to what is nearest, sideways, and up.

        Args:
            nearest: what is so.
            since: when each begins, after `time` [s].
        """
        up = np.array([0.0, 0.0, 1.0])
        sideways = np.cross(self.towards, up)
        sideways = sideways / max(np.linalg.norm(sideways), 1e-9)
        ways = {f"towards the nearest {nearest}": self.towards}
        ways |= {"sideways": sideways, "up": up}
        return {
            f"{FORCE:g} N on a hand, {name}": Push(
                self.hand,
                (FORCE * unit).tolist(),
                max(self.time + after, 0.0),
                PUSH_DURATION,
            )
            for (name, unit), after in zip(ways.items(), since, strict=True)
        }


def find_moment(run: RunResult, settled: float = 1.0) -> Moment:
    """When a hand of this run came nearest to something, from `settled` [s] on.

    The direction is that of the force on the hand that brings it nearer: the one
    whose share J^T f of the joints is most like the distance's negative gradient.
    """
    model, log = run.setup.model, run.log
    hands = [_hand_of(str(name)) for name in log.pair_names]
    distances = np.where([bool(h) for h in hands], log.signed_distances, np.inf)
    distances[log.time < settled] = np.inf
    # After a push there must be time to see what it did.
    distances[log.time > log.time[-1] - PUSH_DURATION - 0.1] = np.inf
    sample, pair = np.unravel_index(distances.argmin(), distances.shape)
    q, hand = log.q[sample], hands[pair]
    gradient = model.evaluate(
        model.MakeWorkspace(), q, np.zeros(len(model.order))
    ).dd_dq[pair]
    plant = model.plant
    context, W = plant.CreateDefaultContext(), plant.world_frame()
    plant.SetPositions(context, q)
    J = plant.CalcJacobianTranslationalVelocity(
        *(context, JacobianWrtVariable.kV, plant.GetFrameByName(hand)),
        *(np.zeros(3), W, W),
    )[:, model.controlled]
    towards = -np.linalg.lstsq(J.T, gradient, rcond=None)[0]
    return Moment(
        float(log.time[sample]), hand, towards / max(np.linalg.norm(towards), 1e-9)
    )


def _hand_of(pair: str) -> str:
    """The first hand in a pair's name; "" if there is none."""
    return next((link for link in pair.split(" - ") if link.endswith("hand")), "")
