"""The log of a simulation whose end nobody knows: its last minutes."""

import math
from collections import deque
from dataclasses import replace

import numpy as np
from pydrake.systems.analysis import Simulator

from crar_drake.results.log import OVER_TIME, SimulationLog
from crar_drake.run import log_sinks, make_log
from crar_drake.simulation.diagram import Setup
from crar_drake.simulation.scenario import Scenario

KEPT = 600.0  # [s]

# The loggers are emptied this often [s]: it takes some milliseconds.
_PIECE = 10.0

_MOST = 2**30  # [B]


class Recorder:
    """Takes what a diagram's loggers hold, in pieces, and drops the oldest ones."""

    # so much time, once it has passed [s]; less if it takes more than _MOST
    kept = KEPT

    def __init__(self, setup: Setup, simulator: Simulator) -> None:
        """`setup` is what the simulated diagram is made of."""
        self._setup, self._simulator = setup, simulator
        self._diagram = simulator.get_system()
        self._pieces: deque[SimulationLog] = deque()
        self._sinks = list(log_sinks(self._diagram).values())

    def collect(self, scenario: Scenario) -> None:
        """Takes a piece, if there is one, of that scenario."""
        root = self._simulator.get_mutable_context()
        times = self._sinks[0].FindLog(root).sample_times()
        if not len(times) or times[-1] - times[0] < _PIECE:
            return
        self._pieces.append(self._piece(scenario))
        for sink in self._sinks:
            sink.FindMutableLog(root).Clear()
        newest = self._pieces[-1]
        size = sum(getattr(newest, name).nbytes for name in OVER_TIME)
        most = min(math.ceil(self.kept / _PIECE - 1e-9), _MOST // size)
        while len(self._pieces) > max(1, most):
            self._pieces.popleft()

    def log(self, scenario: Scenario) -> SimulationLog:
        """All pieces in one."""
        last = self._piece(scenario)
        pieces = [*self._pieces, last]
        return replace(
            last,
            **{
                name: np.concatenate([getattr(piece, name) for piece in pieces])
                for name in OVER_TIME
            },
        )

    def _piece(self, scenario: Scenario) -> SimulationLog:
        context = self._simulator.get_context()
        return make_log(scenario, self._setup, self._diagram, context)
