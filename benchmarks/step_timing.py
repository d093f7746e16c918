"""Control steps to be timed, side by side, and how times grow."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import InputPort

from crar_drake.law.controller import CrarController
from crar_drake.law.parameters import Parameters
from crar_drake.robot.model import ControlModel
from crar_drake.run import RunResult

IN_A_ROW = 50  # so many steps of one kind, before those of the next


@dataclass(frozen=True)
class Samples:
    """What the controller is given in K consecutive steps.

    Attributes:
        q, v: (K, nq), (K, nv) states.
        tasks: (K, layout.size) desired tasks.
        prescribed: (K, 3 n_p) desired motion of the prescribed joints.
    """

    q: np.ndarray
    v: np.ndarray
    tasks: np.ndarray
    prescribed: np.ndarray

    def __len__(self) -> int:
        return len(self.q)


def samples_of_run(run: RunResult) -> Samples:
    """The control steps of a run whose log has a sample in each of them."""
    log, motion = run.log, run.setup.motion
    prescribed = np.zeros((len(log.time), 0))
    if motion.MakePrescribedSource is not None:
        source = motion.MakePrescribedSource()
        context = source.CreateDefaultContext()
        rows = []
        for moment in log.time:
            context.SetTime(moment)
            rows.append(source.get_output_port().Eval(context))
        prescribed = np.array(rows)
    return Samples(log.q, log.v, log.desired_tasks, prescribed)


class Step:
    """A control step as a simulator does it: the torque, then the controller's update.

    The controller alone, with the samples' states and targets at its input ports.
    The plant and the loggers, which a simulation has besides, are not there.

    Attributes:
        torque: (n_a,) of the step taken last [Nm].
    """

    def __init__(
        self, model: ControlModel, parameters: Parameters, samples: Samples
    ) -> None:
        self.controller = CrarController(model, parameters)
        self._samples = samples
        self._period = parameters.period
        self.restart()

    def __len__(self) -> int:
        return len(self._samples)

    def restart(self) -> None:
        """Before the first step again."""
        context = self.controller.CreateDefaultContext()
        self._simulator = Simulator(self.controller, context)
        self._context = self._simulator.get_mutable_context()
        controller, samples = self.controller, self._samples
        state = np.hstack([samples.q, samples.v])
        given = [
            (controller.get_input_port_estimated_state(), state),
            (controller.get_input_port_desired_tasks(), samples.tasks),
        ]
        if controller.model.n_p:
            port = controller.get_input_port_desired_prescribed()
            given.append((port, samples.prescribed))
        self._inputs = [(self._fix(port), values) for port, values in given]
        self._actuation = controller.get_output_port_actuation()
        self._next = 0
        self.torque = np.zeros(0)

    def take(self) -> float:
        """Takes the next step; returns the processor's time for it [s]."""
        k, self._next = self._next, self._next + 1
        if k:
            self._simulator.AdvanceTo(k * self._period)
        for fixed, values in self._inputs:
            fixed.GetMutableData().get_mutable_value().SetFromVector(values[k])
        if not k:  # updates at the start wait for the first advance
            self._simulator.Initialize()
        start = time.thread_time()
        self.torque = self._actuation.Eval(self._context)
        self._simulator.AdvancePendingEvents()
        return time.thread_time() - start

    def _fix(self, port: InputPort):
        return port.FixValue(self._context, np.zeros(port.size()))


def time_side_by_side(steps: Mapping[str, Step]) -> dict[str, np.ndarray]:
    """Processor times of every step [s], a block of one kind and then of the next.

    So a machine that is slower for a while is slower for all of them. The first of a
    block does not count: the processor's caches are full of another kind's data. All
    were taken once before, so that nothing compiles meanwhile.
    """
    for step in steps.values():
        step.take()
        step.restart()
    times: dict[str, list[float]] = {name: [] for name in steps}
    for start in range(0, max(map(len, steps.values())), IN_A_ROW):
        for name, step in steps.items():
            block = [step.take() for _ in range(min(IN_A_ROW, len(step) - start))]
            times[name] += block[1:]
    return {name: np.array(each) for name, each in times.items()}


def fit_growth(sizes: Sequence[float], times: Sequence[float]) -> dict[str, float]:
    """How times grow with sizes.

    Returns:
        "exponent": k of the best time = c size^k; "last_exponent": k between the
        two largest sizes alone; "per_unit": slope of the best straight line [s];
        "last_over_first": ratio of the times at the largest and smallest size.
        Exponents are of the sizes that are not 0.
    """
    x, y = np.array(sizes, dtype=float), np.array(times, dtype=float)
    log_x, log_y = np.log(x[x > 0.0]), np.log(y[x > 0.0])
    return {
        "exponent": float(np.polyfit(log_x, log_y, 1)[0]),
        "last_exponent": float((log_y[-1] - log_y[-2]) / (log_x[-1] - log_x[-2])),
        "per_unit": float(np.polyfit(x, y, 1)[0]),
        "last_over_first": float(y[-1] / y[0]),
    }
