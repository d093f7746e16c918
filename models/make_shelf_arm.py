"""Writes the shelf beside the arm: `python models/make_shelf_arm.py`.

Boards and a sloping top, each a convex piece of one mesh. All numbers are chosen here.
"""

from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from crar_drake.files import write_whole

WIDTH, DEPTH, HEIGHT = 0.70, 0.30, 0.80  # of the shelf, inside [m]
BOARD = 0.02  # thickness [m]
LEVELS = (0.10, 0.42, HEIGHT)  # heights of the boards' lower sides [m]
TOP = 0.12  # height of the sloping top [m]


def _board(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.array(list(product(*zip(low, high, strict=True))))


def shelf_pieces() -> dict[str, np.ndarray]:
    """Name to the corners (V, 3) of each piece; it opens towards -x, stands on z = 0
    and has its front at x = 0 [m]."""
    side = 0.5 * WIDTH
    roof = HEIGHT + BOARD
    pieces = {
        "left": _board((0.0, side, 0.0), (DEPTH, side + BOARD, roof)),
        "right": _board((0.0, -side - BOARD, 0.0), (DEPTH, -side, roof)),
        "back": _board(
            (DEPTH, -side - BOARD, 0.0), (DEPTH + BOARD, side + BOARD, roof)
        ),
    }
    for k, z in enumerate(LEVELS):
        pieces[f"board{k}"] = _board((0.0, -side, z), (DEPTH, side, z + BOARD))
    wedge = _board((0.0, -side, roof), (DEPTH, side, roof + TOP))
    # It is as high as that at the back alone.
    pieces["top"] = wedge[(wedge[:, 0] > 0.0) | (wedge[:, 2] == roof)]
    return pieces


def shelf_obj() -> str:
    """Returns the text of shelf.obj."""
    lines, first = [f"# Written by {Path(__file__).name}; [m]"], 1
    for name, corners in shelf_pieces().items():
        lines.append(f"o {name}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        hull = ConvexHull(corners)
        for (a, b, c), plane in zip(hull.simplices, hull.equations, strict=True):
            if (
                np.cross(corners[b] - corners[a], corners[c] - corners[a]) @ plane[:3]
                < 0
            ):
                b, c = c, b
            lines.append(f"f {a + first} {b + first} {c + first}")
        first += len(corners)
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    path = Path(__file__).parent / "shelf_arm" / "shelf.obj"
    write_whole(path, shelf_obj())
    print(f"wrote {path.relative_to(Path(__file__).parent.parent)}")
