"""What a picture of a robot has around it, and where it is seen from."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat, Rgba

GRID_COLOR = Rgba(0.52, 0.58, 0.62, 1.0)
GRID = "/crar/grid"

# Three-quarter front view: azimuth about z from the robot's x, and elevation [rad].
VIEW_YAW, VIEW_PITCH = np.deg2rad(-32.0), np.deg2rad(12.0)
_FLOOR, _CELL = 6.0, 0.5  # half the floor's width, and a cell of its grid [m]


def set_surroundings(meshcat: Meshcat) -> None:
    """Background and a grid on the floor (z = 0); no axes."""
    meshcat.SetProperty("/Background/<object>", "top_color", [0.93, 0.95, 0.97])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.66, 0.72, 0.76])
    meshcat.SetProperty("/Axes", "visible", False)
    # Else the dark side of a dark robot is black.
    meshcat.SetProperty("/Lights/AmbientLight/<object>", "intensity", 0.9)
    # Meshcat's own grid is made of long lines, and browsers without a graphics card
    # drop a line that passes the camera: so one of short lines, a cell each.
    meshcat.SetProperty("/Grid", "visible", False)
    n = round(2.0 * _FLOOR / _CELL)
    along, across = np.meshgrid(np.arange(n), np.arange(n + 1))
    start = np.vstack([along.ravel(), across.ravel(), np.zeros(along.size)])
    end = start + np.array([[1.0], [0.0], [0.0]])
    corner = np.array([[_FLOOR], [_FLOOR], [0.0]])
    meshcat.SetLineSegments(
        GRID,
        _CELL * np.hstack([start, start[[1, 0, 2]]]) - corner,
        _CELL * np.hstack([end, end[[1, 0, 2]]]) - corner,
        1.0,
        GRID_COLOR,
    )
