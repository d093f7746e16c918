"""Writes the arm and its obstacle: `python models/make_obstacle_arm.py`.

Seven revolute joints about z, y, z, y, z, y, z; the zero configuration stands
straight up. All numbers are chosen here, for an arm of 15 kg and 0.9 m reach.
"""

from math import radians
from pathlib import Path

from urdf_text import (
    Joint,
    Link,
    Shape,
    capsule,
    cylinder,
    ellipsoid,
    sphere,
    urdf,
)

from crar_drake.files import write_whole

# Heights of the joints above the link before [m].
BASE = 0.16
SHOULDER = 0.16
UPPER_ARM = 0.36  # joint2 to joint4
ELBOW = 0.20  # joint2 to joint3, within the upper arm
FOREARM = 0.34  # joint4 to joint6
WRIST = 0.18  # joint4 to joint5, within the forearm
PALM = 0.08  # joint6 to joint7
TOOL = 0.16  # joint7 to the tool point

POST_HEIGHT = 0.60  # [m]
POST_RADIUS = 0.05  # [m]

COLORS = {
    "white": (0.86, 0.87, 0.89, 1),
    "silver": (0.60, 0.63, 0.66, 1),
    "graphite": (0.17, 0.18, 0.20, 1),
    "accent": (0.02, 0.62, 0.62, 1),
    "amber": (0.96, 0.62, 0.16, 1),
    "cream": (0.98, 0.93, 0.84, 1),
}


def _pivot(radius: float, half_width: float) -> list[tuple[Shape, str]]:
    # A joint about y: a graphite barrel with a disc of the accent colour.
    ends = ((0, -half_width, 0), (0, half_width, 0))
    cap = ((0, -half_width - 0.004, 0), (0, half_width + 0.004, 0))
    return [
        (cylinder(radius, *ends), "graphite"),
        (cylinder(0.62 * radius, *cap), "accent"),
    ]


def _links() -> list[Link]:
    def segment(
        name: str, mass: float, solid: Shape, visuals: list[tuple[Shape, str]]
    ) -> Link:
        return Link(name, [(solid, mass)], [solid], visuals)

    return [
        segment(
            "base",
            2.5,
            capsule(0.075, (0, 0, 0.075), (0, 0, 0.085)),
            [
                (cylinder(0.105, (0, 0, 0.0), (0, 0, 0.022)), "graphite"),
                (cylinder(0.107, (0, 0, 0.008), (0, 0, 0.014)), "accent"),
                (ellipsoid((0.098, 0.098, 0.05), (0, 0, 0.022)), "white"),
                (cylinder(0.068, (0, 0, 0.03), (0, 0, 0.148)), "white"),
                (cylinder(0.062, (0, 0, 0.148), (0, 0, BASE)), "graphite"),
            ],
        ),
        segment(
            "shoulder",
            2.8,
            capsule(0.07, (0, 0, 0.07), (0, 0, SHOULDER)),
            [
                (cylinder(0.068, (0, 0, 0.002), (0, 0, 0.06)), "white"),
                (capsule(0.066, (0, 0, 0.06), (0, 0, SHOULDER)), "white"),
                (cylinder(0.0692, (0, 0, 0.012), (0, 0, 0.022)), "accent"),
            ],
        ),
        segment(
            "upper_arm",
            2.5,
            capsule(0.06, (0, 0, 0.0), (0, 0, ELBOW - 0.04)),
            [
                *_pivot(0.058, 0.070),
                (capsule(0.054, (0, 0, 0.03), (0, 0, 0.13)), "white"),
                (cylinder(0.050, (0, 0, 0.10), (0, 0, ELBOW)), "graphite"),
            ],
        ),
        segment(
            "elbow",
            2.0,
            capsule(0.058, (0, 0, 0.02), (0, 0, UPPER_ARM - ELBOW)),
            [
                (cylinder(0.054, (0, 0, 0.004), (0, 0, 0.06)), "white"),
                (capsule(0.054, (0, 0, 0.06), (0, 0, 0.16)), "white"),
                (cylinder(0.0552, (0, 0, 0.014), (0, 0, 0.022)), "accent"),
            ],
        ),
        segment(
            "forearm",
            1.8,
            capsule(0.054, (0, 0, 0.0), (0, 0, WRIST - 0.03)),
            [
                *_pivot(0.050, 0.062),
                (capsule(0.048, (0, 0, 0.03), (0, 0, 0.12)), "white"),
                (cylinder(0.044, (0, 0, 0.10), (0, 0, WRIST)), "graphite"),
            ],
        ),
        segment(
            "wrist",
            1.4,
            capsule(0.05, (0, 0, 0.02), (0, 0, FOREARM - WRIST)),
            [
                (cylinder(0.047, (0, 0, 0.004), (0, 0, 0.06)), "white"),
                (capsule(0.046, (0, 0, 0.06), (0, 0, 0.16)), "white"),
                (cylinder(0.0482, (0, 0, 0.014), (0, 0, 0.022)), "accent"),
            ],
        ),
        segment(
            "palm",
            1.1,
            capsule(0.048, (0, 0, 0.0), (0, 0, PALM - 0.03)),
            [
                *_pivot(0.044, 0.052),
                (cylinder(0.038, (0, 0, 0.02), (0, 0, PALM)), "graphite"),
            ],
        ),
        segment(
            "hand",
            0.9,
            capsule(0.046, (0, 0, 0.03), (0, 0, TOOL - 0.046)),
            [
                (cylinder(0.040, (0, 0, 0.002), (0, 0, 0.012)), "accent"),
                (ellipsoid((0.036, 0.052, 0.036), (0, 0, 0.038)), "white"),
                # Two rounded fingers.
                (capsule(0.013, (0, 0.036, 0.055), (0, 0.040, 0.095)), "graphite"),
                (capsule(0.011, (0, 0.040, 0.095), (0, 0.022, 0.140)), "silver"),
                (capsule(0.013, (0, -0.036, 0.055), (0, -0.040, 0.095)), "graphite"),
                (capsule(0.011, (0, -0.040, 0.095), (0, -0.022, 0.140)), "silver"),
            ],
        ),
        Link("tool"),
    ]


def obstacle_arm_urdf() -> str:
    """Returns the text of obstacle_arm.urdf."""
    y, z = (0, 1, 0), (0, 0, 1)
    # parent, child, height above the parent, axis, +- limit [deg], [Nm], [rad/s]
    rows = [
        ("base", "shoulder", BASE, z, 170, 150, 3.0),
        ("shoulder", "upper_arm", SHOULDER, y, 115, 200, 3.0),
        ("upper_arm", "elbow", ELBOW, z, 170, 100, 4.0),
        ("elbow", "forearm", UPPER_ARM - ELBOW, y, 140, 100, 4.0),
        ("forearm", "wrist", WRIST, z, 170, 50, 5.0),
        ("wrist", "palm", FOREARM - WRIST, y, 115, 50, 5.0),
        ("palm", "hand", PALM, z, 175, 30, 6.0),
    ]
    joints = [
        Joint(
            f"joint{k}",
            "revolute",
            parent,
            child,
            (0.0, 0.0, height),
            axis,
            -radians(degrees),
            radians(degrees),
            effort,
            velocity,
        )
        for k, (parent, child, height, axis, degrees, effort, velocity) in enumerate(
            rows, start=1
        )
    ]
    joints.append(Joint("tool_mount", "fixed", "hand", "tool", (0.0, 0.0, TOOL)))
    # Next but one neighbours overlap where a joint about z splits a segment.
    names = ["base", *(row[1] for row in rows)]
    filters = {
        f"near_{first}": ((first, last), (f"near_{first}",))
        for first, last in zip(names[:-2], names[2:], strict=True)
    }
    return urdf("obstacle_arm", Path(__file__).name, COLORS, _links(), joints, filters)


def obstacle_urdf() -> str:
    """Returns the text of obstacle.urdf: a post that stands on its origin."""
    solid = capsule(POST_RADIUS, (0, 0, POST_RADIUS), (0, 0, POST_HEIGHT - POST_RADIUS))
    look = [
        (capsule(0.046, (0, 0, 0.05), (0, 0, POST_HEIGHT - POST_RADIUS)), "amber"),
        (sphere(0.0495, (0, 0, POST_HEIGHT - POST_RADIUS)), "amber"),
        *(
            (cylinder(0.0485, (0, 0, height), (0, 0, height + 0.045)), "cream")
            for height in (0.20, 0.32, 0.44)
        ),
        (cylinder(0.095, (0, 0, 0), (0, 0, 0.015)), "graphite"),
        (ellipsoid((0.085, 0.085, 0.035), (0, 0, 0.015)), "amber"),
    ]
    return urdf(
        "obstacle",
        Path(__file__).name,
        COLORS,
        [Link("post", [(solid, 4.0)], [solid], look)],
    )


if __name__ == "__main__":
    folder = Path(__file__).parent / "obstacle_arm"
    for name, text in (
        ("obstacle_arm.urdf", obstacle_arm_urdf()),
        ("obstacle.urdf", obstacle_urdf()),
    ):
        write_whole(folder / name, text)
        print(f"wrote models/obstacle_arm/{name}")
