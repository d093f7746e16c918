"""The input port of a system that keeps a robot from obstacles that move."""

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, InputPort, LeafSystem

from crar_drake.errors import InputError
from crar_drake.law.obstacles import Obstacles


class ObstaclePort:
    """Port `obstacles`, (4 N,): x, y, z and radius of each sphere now [m]; true where
    there is one."""

    def __init__(self, system: LeafSystem, speeds: Sequence[float]) -> None:
        """
        Args:
            system: that gets the port; none if there are no obstacles.
            speeds: (N,) bounds of their speeds [m/s].

        Raises:
            InputError: one is not a number, infinite or negative.
        """
        self._system, self._port = system.get_name(), None
        try:
            self._speeds = Obstacles(np.zeros((len(speeds), 3)), 0.0, speeds).speeds
        except (TypeError, InputError) as error:
            raise InputError(
                f"{self._system}: obstacle_speeds are {speeds!r}: {error}"
            ) from None
        if len(self._speeds):
            self._port = system.DeclareVectorInputPort("obstacles", 4 * len(speeds))

    def __bool__(self) -> bool:
        return self._port is not None

    @property
    def port(self) -> InputPort:
        """
        Raises:
            InputError: there are no obstacles.
        """
        if self._port is None:
            raise InputError(
                f"{self._system} has no port for obstacles: give obstacle_speeds when "
                "it is made"
            )
        return self._port

    def Eval(self, context: Context) -> Obstacles | None:
        """The obstacles now; None if nothing is connected."""
        if self._port is None or not self._port.HasValue(context):
            return None
        spheres = self._port.Eval(context).reshape(-1, 4)
        return Obstacles(spheres[:, :3], spheres[:, 3], self._speeds)
