"""Targets of a motion that can be stopped, moved by what a person adds to them."""

from dataclasses import replace

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from crar_drake.play.motion_clock import MotionClock, to_and_fro
from crar_drake.robot.model import ControlModel
from crar_drake.targets.desired_motion import DesiredMotion


class LiveSource(LeafSystem):
    """Emits [x; v; a] of a source at its motion's own time, with an offset on x.

    With the phase s(t) of the motion these are

        x(s) + offset,    v(s) s',    a(s) s'^2 + v(s) s''.

    The clock and the offset are parameters of the context: changing them there changes
    what is emitted from that instant on.

    Output port: the name of the system, (nx + 2 nv,).
    """

    def __init__(self, name: str, source: LeafSystem, nx: int, duration: float) -> None:
        """
        Args:
            name: of the system and its port.
            source: emits [x; v; a] as a function of time alone.
            nx: how many entries x has.
            duration: of the motion; its ends are not left [s].
        """
        super().__init__()
        self.set_name(name)
        self._source, self._duration = source, duration
        self._source_context = source.CreateDefaultContext()
        size = source.get_output_port(0).size()
        nv = (size - nx) // 2
        self._splits = [nx, nx + nv]
        self._clock = self.DeclareNumericParameter(
            BasicVector(MotionClock().to_vector())
        )
        self._offset = self.DeclareNumericParameter(BasicVector(np.zeros(nx)))
        self.DeclareVectorOutputPort(
            name, size, self._Calc, {self.time_ticket(), self.all_parameters_ticket()}
        )

    def set_clock(self, context: Context, clock: MotionClock) -> None:
        """Sets when the motion is where, in a context of the system."""
        parameter = context.get_mutable_numeric_parameter(int(self._clock))
        parameter.SetFromVector(clock.to_vector())

    def set_offset(self, context: Context, offset: np.ndarray) -> None:
        """Sets the offset (nx,), in a context of the system."""
        parameter = context.get_mutable_numeric_parameter(int(self._offset))
        parameter.SetFromVector(offset)

    def _Calc(self, context: Context, output: BasicVector) -> None:
        values = context.get_numeric_parameter(int(self._clock)).value()
        offset = context.get_numeric_parameter(int(self._offset)).value()
        way, way_rate, way_change = MotionClock.from_vector(values).at(
            context.get_time()
        )
        phase, slope, bend = to_and_fro(way, self._duration)
        rate = slope * way_rate
        change = bend * way_rate**2 + slope * way_change
        self._source_context.SetTime(phase)
        targets = self._source.get_output_port(0).Eval(self._source_context)
        x, v, a = np.split(targets, self._splits)
        output.SetFromVector(
            np.concatenate((x + offset, rate * v, rate * rate * a + change * v))
        )


def make_live(motion: DesiredMotion, model: ControlModel) -> DesiredMotion:
    """The same motion, whose sources are `LiveSource`."""

    def task_source() -> LiveSource:
        return LiveSource(
            "desired_tasks",
            motion.MakeTaskSource(),
            model.layout.size_x,
            motion.duration,
        )

    def prescribed_source() -> LiveSource:
        return LiveSource(
            "desired_prescribed",
            motion.MakePrescribedSource(),
            model.n_p,
            motion.duration,
        )

    prescribed = motion.MakePrescribedSource is not None
    return replace(
        motion,
        MakeTaskSource=task_source,
        MakePrescribedSource=prescribed_source if prescribed else None,
    )
