"""Writes the tipping cell's frame: `python models/make_tipping_cell.py`.

Two crossed bars on four feet, light and narrow under what `upper_body` weighs. All
numbers are chosen here.
"""

from pathlib import Path

from urdf_text import Joint, Link, capsule, urdf

from crar_drake.files import write_whole

HALF = 0.13  # of a foot beside the middle, along x and along y [m]
PAD = 0.02  # half the width of a foot, and the radius of foot and bar [m]
HEIGHT = 0.12  # of the bars' upper side, where the upper body stands [m]
BAR_MASS, FOOT_MASS = 3.0, 0.25  # of each [kg]

COLORS = {"graphite": (0.17, 0.18, 0.20, 1), "amber": (0.96, 0.62, 0.16, 1)}
FEET = {
    f"{end}_{side}_foot": (x, y, 0.0)
    for end, x in (("front", HALF), ("rear", -HALF))
    for side, y in (("left", HALF), ("right", -HALF))
}


def frame_urdf() -> str:
    """Returns the text of frame.urdf."""
    z = HEIGHT - PAD
    bars = [
        capsule(PAD, (-HALF, -sign * HALF, z), (HALF, sign * HALF, z))
        for sign in (1, -1)
    ]
    frame = Link(
        "frame",
        [(bar, BAR_MASS) for bar in bars],
        bars,
        [(bar, "amber") for bar in bars],
    )
    leg = capsule(PAD, (0.0, 0.0, PAD), (0.0, 0.0, z))
    feet = [Link(name, [(leg, FOOT_MASS)], [], [(leg, "graphite")]) for name in FEET]
    joints = [
        Joint(f"{name}_mount", "fixed", "frame", name, at) for name, at in FEET.items()
    ]
    return urdf("frame", Path(__file__).name, COLORS, [frame, *feet], joints)


if __name__ == "__main__":
    path = Path(__file__).parent / "tipping_cell" / "frame.urdf"
    write_whole(path, frame_urdf())
    print(f"wrote {path.relative_to(Path(__file__).parent.parent)}")
