"""Runs one episode: in a user's own loop with the exact model, or in the diagram."""

import warnings
from dataclasses import dataclass, field

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, LeafSystem

from benchmarks.adversary.attacks import Episode
from crar_drake.errors import InputError
from crar_drake.law.control_law import ControlLaw
from crar_drake.robot.model import ControlModel
from crar_drake.simulation.diagram import MakeCrarDiagram, Setup
from crar_drake.simulation.scenario import Scenario
from crar_drake.targets.desired_motion import DesiredMotion

# Faster than this [rad/s] is an unstable loop: it goes on to numbers without sense.
DIVERGED = 1e4


@dataclass
class Drive:
    """What a robot did.

    Attributes:
        q, v: (K + 1, nq), (K + 1, nv) states, the start first; fewer if it diverged.
        diverged: whether the episode ended before its time.
        admitted: steps as wished, corrected, scaled.
        unheld: steps after which the law does not vouch for the invariant.
        overloaded: steps in which a torque is beyond a motor's limit.
        slip: largest |acceleration - commanded| over a step of the plant [rad/s^2];
            0 with the exact model.
        per_step: states a control step.
        T: (K + 1,) the braking time constant that each state is claimed to be safe
            over [s].
    """

    q: np.ndarray
    v: np.ndarray
    diverged: bool = False
    admitted: list[int] = field(default_factory=lambda: [0, 0, 0])
    unheld: int = 0
    overloaded: int = 0
    slip: float = 0.0
    per_step: int = 1
    T: np.ndarray | float = 0.0

    @property
    def steps(self) -> int:
        """Control steps, or samples of the plant."""
        return len(self.q) - 1


def drive_exact(model: ControlModel, episode: Episode) -> Drive:
    """The next state is the one that the law predicts.

    Raises:
        ScenarioError: the law refuses the parameters.
    """
    law = ControlLaw(model, episode.parameters)
    nq = len(episode.q)
    K = len(episode.tasks)
    states = np.empty((K + 1, nq + len(episode.v)))
    states[0, :nq], states[0, nq:] = episode.q, episode.v
    done = Drive(states[:, :nq], states[:, nq:], T=np.full(K + 1, law.parameters.T))
    posture = episode.posture.shape[1] > 0
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        for k in range(K):
            if k in episode.switches:
                law = ControlLaw(model, episode.switches[k])
            try:
                solution = law.step(
                    states[k, :nq],
                    states[k, nq:],
                    episode.tasks[k],
                    episode.prescribed[k],
                    episode.posture[k] if posture and law.has_posture else None,
                )
            except (FloatingPointError, InputError, np.linalg.LinAlgError):
                solution = None
            if solution is None or not _sound(solution.position_command, nq):
                done.q, done.v = states[: k + 1, :nq], states[: k + 1, nq:]
                done.T = done.T[: k + 1]
                done.diverged = True
                break
            states[k + 1] = solution.position_command
            told, (T,) = solution.admission, solution.T
            done.T[k + 1] = T if np.isfinite(T) else law.parameters.T
            if np.isfinite(told[0]):
                done.admitted[int(told[0])] += 1
                done.unheld += not told[3]
    return done


def _sound(state: np.ndarray, nq: int) -> bool:
    """Whether a state is finite, and no joint beyond all sense."""
    return bool(np.isfinite(state).all() and np.abs(state[nq:]).max() < DIVERGED)


class _Rows(LeafSystem):
    """Emits row number floor(t / period) of a table; the last one stays."""

    def __init__(self, table: np.ndarray, period: float) -> None:
        super().__init__()
        self._table, self._period = table, period
        self.DeclareVectorOutputPort("row", table.shape[1], self._calc)

    def _calc(self, context: Context, output) -> None:
        # A time a little before the tick, by rounding, counts as the tick.
        row = int(context.get_time() / self._period + 1e-6)
        output.SetFromVector(self._table[min(row, len(self._table) - 1)])


def drive_torque(model: ControlModel, episode: Episode) -> Drive:
    """The simulated robot under the controller's torque, at every step of the plant.

    Raises:
        ScenarioError: the law refuses the parameters, or a setting of the diagram.
    """
    parameters = episode.parameters
    K, n_p = len(episode.tasks), model.n_p
    scenario = Scenario(controller=parameters, duration=K * parameters.period)
    dt = scenario.plant_config.time_step
    scenario.log_period = dt
    motion = DesiredMotion(
        K * parameters.period,
        lambda: _Rows(episode.tasks, parameters.period),
        (lambda: _Rows(episode.prescribed, parameters.period)) if n_p else None,
    )
    diagram = MakeCrarDiagram(scenario, setup=Setup(model, motion, episode.q))
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant = diagram.GetSubsystemByName("plant")
    plant.SetPositionsAndVelocities(
        plant.GetMyMutableContextFromRoot(context),
        np.concatenate([episode.q, episode.v]),
    )
    diverged = False
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            simulator.AdvanceTo(K * parameters.period)
        except (RuntimeError, FloatingPointError, InputError, np.linalg.LinAlgError):
            diverged = True
    log = diagram.GetSubsystemByName("log_state").FindLog(context).data().T
    controller = diagram.GetSubsystemByName("crar_controller")
    told = diagram.GetSubsystemByName("log_diagnostics").FindLog(context).data().T
    commanded = told[:, controller.diagnostics_slices["desired_acceleration"]]
    nq = len(episode.q)
    sound = np.isfinite(log).all(axis=1) & (np.abs(log[:, nq:]).max(axis=1) < DIVERGED)
    if not sound.all():
        log, diverged = log[: int(sound.argmin())], True
    slip = np.diff(log[:, nq:], axis=0) / dt - commanded[: len(log) - 1]
    return Drive(
        log[:, :nq],
        log[:, nq:],
        diverged,
        slip=float(np.abs(slip).max(initial=0.0)),
        per_step=round(parameters.period / dt),
        T=parameters.T,
    )
