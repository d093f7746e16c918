"""Writes upper_body/upper_body.urdf: `python models/make_upper_body.py`.

Lengths are Drillis and Contini's fractions of stature, masses are Winter's
fractions of body mass (both in D. A. Winter, Biomechanics and Motor Control of
Human Movement, Fig. 4.1 and Table 4.1), for a stature of 1.3 m and 54 kg. What
they leave open (radii, actuators, limits) is chosen here; README.md says which
is which. Robot frame: x forward, y left, z up; zero configuration: arms hanging.
"""

from math import radians
from pathlib import Path

from urdf_text import (
    Joint,
    Link,
    capsule,
    cylinder,
    ellipsoid,
    sphere,
    urdf,
)

from crar_drake.files import write_whole

STATURE = 1.3  # [m]
BODY_MASS = 54.0  # [kg]

# Lengths [m], as fractions of stature.
HIP_HEIGHT = 0.530 * STATURE
TRUNK = (0.818 - 0.530) * STATURE  # hips to shoulders
SHOULDER_HALF_WIDTH = 0.129 * STATURE
UPPER_ARM = 0.186 * STATURE
FOREARM = 0.146 * STATURE
HAND = 0.108 * STATURE
THIGH = 0.245 * STATURE
NECK = TRUNK + 0.02 * STATURE  # neck centre, slightly above the shoulders
HEAD = 1.0 * STATURE - HIP_HEIGHT - 0.095  # head centre; its crown at full stature

# Masses [kg], as fractions of body mass.
THORAX_MASS = 0.216 * BODY_MASS
ABDOMEN_MASS = 0.139 * BODY_MASS
PELVIS_MASS = 0.142 * BODY_MASS
HEAD_MASS = 0.081 * BODY_MASS  # with the neck
UPPER_ARM_MASS = 0.028 * BODY_MASS
FOREARM_MASS = 0.016 * BODY_MASS
HAND_MASS = 0.006 * BODY_MASS
THIGH_MASS = 0.100 * BODY_MASS

# The actuator between two rotations of one joint is a solid ball. Its mass is
# taken off the segment that houses it. Without it the mass matrix would be
# singular where two axes of a shoulder align (roll = 90 degrees).
WAIST_ACTUATOR = 1.0  # [kg], off the abdomen
SHOULDER_ACTUATOR = 0.4  # [kg], two: off the thorax and off the upper arm

HIP_HALF_WIDTH = 0.08  # hip joint centres [m]
HIP_DROP = 0.06  # below the waist point [m]
THIGH_SHOWN = 0.19  # the modelled part of the thigh, from the hip joint [m]

COLORS = {
    "white": (0.86, 0.87, 0.89, 1),
    "silver": (0.60, 0.63, 0.66, 1),
    "graphite": (0.17, 0.18, 0.20, 1),
    "visor": (0.045, 0.055, 0.07, 1),
    "accent": (0.02, 0.62, 0.62, 1),
    "glow": (0.55, 0.97, 0.94, 1),
}


def _base_and_carriages() -> list[Link]:
    # The disc stands on the floor whatever the waist's height; the inner column
    # hangs from the waist and telescopes in the outer one. Neither collides.
    column = [
        (cylinder(0.235, (0, 0, 0.004), (0, 0, 0.05)), "graphite"),
        (cylinder(0.239, (0, 0, 0.024), (0, 0, 0.034)), "accent"),
        (ellipsoid((0.225, 0.225, 0.045), (0, 0, 0.05)), "white"),
        (ellipsoid((0.085, 0.085, 0.06), (0, 0, 0.085)), "white"),
        (cylinder(0.045, (0, 0, 0.05), (0, 0, 0.27)), "white"),
        (cylinder(0.047, (0, 0, 0.252), (0, 0, 0.264)), "accent"),
        (ellipsoid((0.045, 0.045, 0.012), (0, 0, 0.27)), "graphite"),
    ]
    inner = [(cylinder(0.027, (0, 0, -0.60), (0, 0, -0.05)), "silver")]
    return [
        Link("base"),
        Link("carriage_x"),
        Link("carriage_y", visuals=column),
        Link("waist", visuals=inner),
    ]


def _trunk() -> list[Link]:
    hips = capsule(0.075, (0, -0.045, -0.03), (0, 0.045, -0.03))
    pelvis = Link(
        "pelvis",
        [(hips, PELVIS_MASS)],
        [hips],
        [
            (ellipsoid((0.088, 0.122, 0.062), (0, 0, -0.04)), "white"),
            (ellipsoid((0.080, 0.100, 0.030), (0, 0, 0.012)), "graphite"),
            (sphere(0.052, (0, HIP_HALF_WIDTH, -HIP_DROP - 0.02)), "graphite"),
            (sphere(0.052, (0, -HIP_HALF_WIDTH, -HIP_DROP - 0.02)), "graphite"),
            (ellipsoid((0.012, 0.034, 0.010), (0.080, 0, -0.035)), "accent"),
        ],
    )
    gimbal = Link(
        "torso_gimbal",
        [(sphere(0.06), WAIST_ACTUATOR)],
        visuals=[(sphere(0.074), "graphite")],
    )
    chest = capsule(0.095, (0, -0.055, 0.285), (0, 0.055, 0.285))
    belly = capsule(0.085, (0, 0, 0.09), (0, 0, 0.17))
    torso = Link(
        "torso",
        [
            (chest, THORAX_MASS - 2 * SHOULDER_ACTUATOR),
            (belly, ABDOMEN_MASS - WAIST_ACTUATOR),
        ],
        [chest, belly],
        [
            # A ribbed waist.
            *(
                (ellipsoid((0.079, 0.093, 0.021), (0, 0, z)), "graphite")
                for z in (0.062, 0.094, 0.126, 0.158)
            ),
            # The chest, with a collar that carries the shoulders.
            (ellipsoid((0.098, 0.138, 0.110), (0, 0, 0.285)), "white"),
            (ellipsoid((0.088, 0.108, 0.115), (0, 0, 0.235)), "white"),
            (capsule(0.052, (-0.01, -0.095, 0.355), (-0.01, 0.095, 0.355)), "white"),
            (ellipsoid((0.060, 0.062, 0.030), (0, 0, 0.392)), "graphite"),
            # A lamp on the chest, slats below it, a rounded pack on the back.
            (ellipsoid((0.012, 0.030, 0.030), (0.094, 0, 0.300)), "graphite"),
            (ellipsoid((0.010, 0.022, 0.022), (0.101, 0, 0.300)), "accent"),
            (ellipsoid((0.006, 0.011, 0.011), (0.108, 0, 0.300)), "glow"),
            (capsule(0.042, (-0.075, -0.055, 0.31), (-0.075, 0.055, 0.31)), "silver"),
            (capsule(0.036, (-0.072, -0.050, 0.24), (-0.072, 0.050, 0.24)), "silver"),
            (capsule(0.034, (0, 0, 0.37), (0, 0, 0.45)), "graphite"),
        ],
    )
    skull = sphere(0.095)
    head = Link(
        "head",
        [(skull, HEAD_MASS)],
        [skull],
        [
            (ellipsoid((0.094, 0.088, 0.095)), "white"),
            (ellipsoid((0.054, 0.069, 0.047), (0.046, 0, 0.004)), "visor"),
            (ellipsoid((0.006, 0.010, 0.015), (0.0955, 0.026, 0.008)), "glow"),
            (ellipsoid((0.006, 0.010, 0.015), (0.0955, -0.026, 0.008)), "glow"),
            (cylinder(0.031, (0, -0.091, 0), (0, 0.091, 0)), "graphite"),
            (cylinder(0.019, (0, -0.096, 0), (0, 0.096, 0)), "accent"),
        ],
    )
    return [pelvis, gimbal, torso, head]


def _left_limbs() -> list[Link]:
    thigh_solid = capsule(0.048, (0, 0, -0.02), (0, 0, -THIGH_SHOWN + 0.048))
    thigh = Link(
        "thigh",
        [(thigh_solid, THIGH_MASS * THIGH_SHOWN / THIGH)],
        [thigh_solid],
        [
            (capsule(0.047, (0, 0, -0.055), (0, 0, -0.125)), "white"),
            (cylinder(0.0482, (0, 0, -0.115), (0, 0, -0.125)), "accent"),
            (sphere(0.043, (0, 0, -THIGH_SHOWN + 0.043)), "graphite"),
        ],
    )
    actuator = (sphere(0.045), SHOULDER_ACTUATOR)
    pitch = Link("shoulder_pitch", [actuator], visuals=[(sphere(0.050), "graphite")])
    roll = Link(
        "shoulder_roll",
        [actuator],
        visuals=[(ellipsoid((0.053, 0.046, 0.052), (0, 0.012, 0.008)), "white")],
    )
    upper_solid = capsule(0.040, (0, 0, -0.02), (0, 0, -UPPER_ARM))
    upper_arm = Link(
        "upper_arm",
        [(upper_solid, UPPER_ARM_MASS - SHOULDER_ACTUATOR)],
        [upper_solid],
        [
            (capsule(0.034, (0, 0, -0.03), (0, 0, -0.20)), "graphite"),
            (capsule(0.040, (0, 0, -0.085), (0, 0, -0.165)), "white"),
            (cylinder(0.0412, (0, 0, -0.163), (0, 0, -0.173)), "accent"),
        ],
    )
    fore_solid = capsule(0.034, (0, 0, -0.015), (0, 0, -FOREARM))
    forearm = Link(
        "forearm",
        [(fore_solid, FOREARM_MASS)],
        [fore_solid],
        [
            (sphere(0.041), "graphite"),
            (cylinder(0.024, (0, -0.043, 0), (0, 0.043, 0)), "accent"),
            (capsule(0.036, (0, 0, -0.060), (0, 0, -0.100)), "white"),
            (capsule(0.031, (0, 0, -0.075), (0, 0, -0.150)), "white"),
            (cylinder(0.0322, (0, 0, -0.150), (0, 0, -0.160)), "accent"),
            (capsule(0.024, (0, 0, -0.15), (0, 0, -FOREARM)), "graphite"),
        ],
    )
    hand_solid = capsule(0.036, (0, 0, -0.036), (0, 0, -HAND + 0.036))
    fingers = [
        (capsule(0.0088, (x, -0.002, -0.078), (1.05 * x, -0.006, tip)), "silver")
        for x, tip in (
            (0.027, -0.122),
            (0.009, -0.131),
            (-0.009, -0.128),
            (-0.026, -0.116),
        )
    ]
    hand = Link(
        "hand",
        [(hand_solid, HAND_MASS)],
        [hand_solid],
        [
            (sphere(0.026), "graphite"),
            (ellipsoid((0.038, 0.021, 0.042), (0, 0, -0.050)), "graphite"),
            (ellipsoid((0.028, 0.012, 0.030), (0, 0.013, -0.050)), "white"),
            *fingers,
            (
                capsule(0.0095, (0.030, -0.008, -0.045), (0.044, -0.014, -0.078)),
                "silver",
            ),
        ],
    )
    return [thigh, pitch, roll, upper_arm, forearm, hand]


def _joint(
    name: str,
    parent: str,
    child: str,
    axis: str,
    degrees: tuple[float, float],
    effort: float,
    velocity: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Joint:
    vector = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[axis]
    lower, upper = (radians(d) for d in degrees)
    return Joint(
        name, "revolute", parent, child, origin, vector, lower, upper, effort, velocity
    )


def _trunk_joints() -> list[Joint]:
    def slide(name: str, parent: str, child: str, axis: tuple, effort: float) -> Joint:
        return Joint(
            name, "prismatic", parent, child, (0, 0, 0), axis, -10, 10, effort, 5
        )

    return [
        slide("waist_x", "base", "carriage_x", (1, 0, 0), 2000),
        slide("waist_y", "carriage_x", "carriage_y", (0, 1, 0), 2000),
        slide("waist_z", "carriage_y", "waist", (0, 0, 1), 3000),
        Joint("torso_yaw", "continuous", "waist", "pelvis", effort=200, velocity=32),
        _joint("torso_pitch", "pelvis", "torso_gimbal", "y", (-20, 60), 300, 30),
        _joint("torso_roll", "torso_gimbal", "torso", "x", (-30, 30), 300, 30),
        Joint("head_mount", "fixed", "torso", "head", (0, 0, HEAD)),
        Joint("neck_mount", "fixed", "torso", "neck", (0, 0, NECK)),
    ]


def _side_joints(side: str) -> list[Joint]:
    sign = 1 if side == "left" else -1

    def mirror(lower: float, upper: float) -> tuple[float, float]:
        # Rotations about x and z change their sign in the mirror, about y not.
        return (lower, upper) if sign > 0 else (-upper, -lower)

    def link(name: str) -> str:
        return f"{side}_{name}"

    shoulder = (0.0, sign * SHOULDER_HALF_WIDTH, TRUNK)
    hip = (0.0, sign * HIP_HALF_WIDTH, -HIP_DROP)
    pitch, roll, yaw = (link(f"shoulder_{axis}") for axis in ("pitch", "roll", "yaw"))
    return [
        Joint(link("thigh_mount"), "fixed", "pelvis", link("thigh"), hip),
        Joint(link("shoulder_mount"), "fixed", "torso", link("shoulder"), shoulder),
        _joint(pitch, "torso", pitch, "y", (-180, 60), 80, 37, shoulder),
        _joint(roll, pitch, roll, "x", mirror(-20, 150), 80, 37),
        _joint(yaw, roll, link("upper_arm"), "z", mirror(-90, 90), 50, 37),
        _joint(
            link("elbow"),
            link("upper_arm"),
            link("forearm"),
            "y",
            (-145, 0),  # beyond straight an arm can only be stuck
            50,
            37,
            (0, 0, -UPPER_ARM),
        ),
        Joint(
            link("wrist_mount"),
            "fixed",
            link("forearm"),
            link("hand"),
            (0, 0, -FOREARM),
        ),
    ]


def upper_body_urdf() -> str:
    """Returns the text of upper_body.urdf."""
    links = [*_base_and_carriages(), *_trunk(), Link("neck")]
    joints = _trunk_joints()
    for side in ("left", "right"):
        links.append(Link(f"{side}_shoulder"))
        for limb in _left_limbs():
            name = f"{side}_{limb.name}"
            mirrored = limb.mirrored(name)
            links.append(mirrored if side == "right" else mirrored.mirrored(name))
        joints += _side_joints(side)
    # Neighbours that overlap by construction never touch in Drake's contact.
    filters = {
        "trunk": (
            ("pelvis", "torso", "head", "left_thigh", "right_thigh"),
            ("trunk",),
        ),
        "chest": (("torso",), ("upper_arms",)),
        "upper_arms": (("left_upper_arm", "right_upper_arm"), ()),
    }
    return urdf("upper_body", Path(__file__).name, COLORS, links, joints, filters)


if __name__ == "__main__":
    path = Path(__file__).parent / "upper_body" / "upper_body.urdf"
    write_whole(path, upper_body_urdf())
    print(f"wrote {path.relative_to(Path(__file__).parent.parent)}")
