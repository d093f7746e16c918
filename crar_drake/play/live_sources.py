"""Targets of a motion that can be stopped, moved by what a person adds to them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from crar_drake.robot.model import ControlModel
from crar_drake.targets.desired_motion import DesiredMotion


class LiveSource(LeafSystem):
    """Emits [x; v; a] of a source at its motion's own time, with an offset on x.

    With the phase s of the motion these are

        x(s) + offset,    v(s) s',    a(s) s'^2 + v(s) s''.

    The phase and the offset are parameters of the context: changing them there changes
    what is emitted from that instant on.

    Output port: targets, (nx + 2 nv,).
    """

    def __init__(self, source: LeafSystem, nx: int) -> None:
        """
        Args:
            source: emits [x; v; a] as a function of time alone.
            nx: how many entries x has.
        """
        super().__init__()
        self._source, self._source_context = source, source.CreateDefaultContext()
        size = source.get_output_port(0).size()
        self._splits = [nx, nx + (size - nx) // 2]
        self._phase, self._offset = (
            self.DeclareNumericParameter(BasicVector(np.zeros(n))) for n in (3, nx)
        )
        self.DeclareVectorOutputPort(
            "targets", size, self._Calc, {self.all_parameters_ticket()}
        )

    def set(
        self, context: Context, phase: tuple[float, float, float], offset: np.ndarray
    ) -> None:
        """Sets what is emitted, in a context of the system.

        Args:
            phase: s [s], its rate [1] and its acceleration [1/s].
            offset: (nx,) on x.
        """
        for index, value in ((self._phase, phase), (self._offset, offset)):
            parameter = context.get_mutable_numeric_parameter(int(index))
            parameter.SetFromVector(value)

    def _Calc(self, context: Context, output: BasicVector) -> None:
        phase, rate, change = context.get_numeric_parameter(int(self._phase)).value()
        offset = context.get_numeric_parameter(int(self._offset)).value()
        self._source_context.SetTime(phase)
        targets = self._source.get_output_port(0).Eval(self._source_context)
        x, v, a = np.split(targets, self._splits)
        output.SetFromVector(
            np.concatenate((x + offset, rate * v, rate * rate * a + change * v))
        )


def make_live(motion: DesiredMotion, model: ControlModel) -> DesiredMotion:
    """The same motion, whose sources are `LiveSource`."""

    def live(make: Callable[[], LeafSystem] | None, nx: int):
        return make and (lambda: LiveSource(make(), nx))

    return replace(
        motion,
        MakeTaskSource=live(motion.MakeTaskSource, model.layout.size_x),
        MakePrescribedSource=live(motion.MakePrescribedSource, model.n_p),
    )
