"""Robots made of text: odd ones, drawn at random, and one that stands on two soles."""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
import product
from judges import RobotJudge

APART = 8e-3  # at rest, of watched pairs [m]


def link(name: str, mass: float, middle: Sequence[float], *shapes: str) -> str:
    """A link whose mass is about its middle [kg, m], with collision shapes."""
    size = 0.01 * mass
    return (
        f'<link name="{name}"><inertial><origin xyz="{_row(middle)}"/>'
        f'<mass value="{mass}"/><inertia ixx="{size}" iyy="{size}" izz="{size}" '
        f'ixy="0" ixz="0" iyz="0"/></inertial>{"".join(shapes)}</link>'
    )


def shape(kind: str, radius: float, length: float, xyz, rpy=(0, 0, 0)) -> str:
    """A "capsule" along z, or a "sphere", in a link [m]."""
    size = f'radius="{radius}"' + (f' length="{length}"' * (kind == "capsule"))
    return (
        f'<collision><origin xyz="{_row(xyz)}" rpy="{_row(rpy)}"/>'
        f"<geometry><{kind} {size}/></geometry></collision>"
    )


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    xyz: Sequence[float],
    axis: Sequence[float] = (0, 0, 1),
    *,
    rpy: Sequence[float] = (0, 0, 0),
    limits: tuple[float, float] | None = None,
    speed: float = 20.0,
    effort: float = 100.0,
) -> str:
    """A joint with a motor, unless it is fixed."""
    told = f'velocity="{speed}" effort="{effort}"'
    if limits is not None:
        told += f' lower="{limits[0]}" upper="{limits[1]}"'
    text = (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{_row(xyz)}" rpy="{_row(rpy)}"/>'
    )
    if kind == "fixed":
        return text + "</joint>"
    return (
        f'{text}<axis xyz="{_row(axis)}"/><limit {told}/></joint>'
        f'<transmission name="{name}"><type>transmission_interface/SimpleTransmission'
        f'</type><joint name="{name}"/><actuator name="{name}"/></transmission>'
    )


def urdf(*parts: str) -> str:
    """The robot of these links and joints."""
    return f'<robot name="own">{"".join(parts)}</robot>'


def _row(values: Sequence[float]) -> str:
    return " ".join(f"{value:.6g}" for value in values)


def odd_robot(folder: Path, seed: int) -> tuple[Path, list[str]]:
    """A robot that nobody would build, and the points to track.

    A branching chain of joints that turn and slide, with capsules, spheres and a whip
    of 1 mm; ranges from a few degrees to none at all; posts that stand around, and one
    that somebody moves. Each pair that is apart at rest is watched.
    """
    rng = np.random.default_rng(seed)
    parts = [link("base", 5.0, (0, 0, 0), _any_shape(rng))]
    links, parents = ["base"], {}
    for i in range(int(rng.integers(4, 7))):
        parent = links[-1] if rng.random() < 0.8 else str(rng.choice(links))
        name, slides = f"link{i}", rng.random() < 0.3
        half = 10.0 ** (rng.uniform(-1.5, -0.7) if slides else rng.uniform(-0.8, 0.4))
        kind, limits = "prismatic" if slides else "revolute", (-half, 0.7 * half)
        if not slides and rng.random() < 0.2:
            kind, limits = "continuous", None
        parts.append(link(name, rng.uniform(0.3, 2.0), (0, 0, 0.1), _any_shape(rng)))
        parts.append(
            joint(
                *(f"joint{i}", kind, parent, name),
                (0.05 * rng.normal(), 0.05 * rng.normal(), 0.3 * (parent != "base")),
                rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[i % 3],
                rpy=rng.uniform(-0.5, 0.5, 3),
                limits=limits,
                speed=1.0 if slides else 10.0 ** rng.uniform(0.3, 1.3),
                effort=10.0 ** rng.uniform(1.5, 2.5),
            )
        )
        links.append(name)
        parents[name] = parent
    for i in range(4):
        name, place = f"post{i}", rng.normal(0.0, 0.4, 3) + [0.0, 0.0, 0.4]
        parts.append(link(name, 1.0, (0, 0, 0), _any_shape(rng)))
        kind = "prismatic" if i == 0 else "fixed"
        axis = rng.normal(size=3)
        limits = (-0.3, 0.3)
        parts.append(
            joint(f"of_{name}", kind, "base", name, place, axis, limits=limits)
        )
        links.append(name)
        parents[name] = "base"
    text = urdf(*parts)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "drawn.urdf").write_text(text)
    pairs = [
        [a, b]
        for a, b in combinations(links, 2)
        if parents.get(b) != a and not a.startswith("post")
    ]
    judge = RobotJudge(folder / "drawn.urdf", pairs, base="base")
    apart = judge.distances(np.zeros((1, len(judge.joints))))[0] > APART
    pairs = [pair for pair, far in zip(pairs, apart, strict=True) if far]
    points = [links[links.index("post0") - 1], "link1"]
    made = product.write_robot(
        folder, text, pairs=pairs, points=points, prescribed=("of_post0",)
    )
    return made, points


def _any_shape(rng: np.random.Generator) -> str:
    kind = rng.choice(["capsule", "sphere", "whip"], p=[0.6, 0.25, 0.15])
    turn = rng.uniform(-0.3, 0.3, 3)
    if kind == "whip":
        return shape("capsule", 1e-3, 1.0, (0, 0, 0.6), turn)
    radius, length = rng.uniform(0.02, 0.06), rng.uniform(0.05, 0.2)
    return shape(kind, radius, length, (0, 0, 0.15), turn)


LEG, HIP, SOLE = 0.4, 0.12, 0.06  # of thigh and shin, of a hip from the middle, [m]
BEND = 0.3  # of hip and ankle at rest [rad]


def standing_robot(folder: Path) -> tuple[Path, list[str]]:
    """A trunk on two bent legs with flat soles, with an arm of three joints that weighs
    a third of it all; and the point to track."""
    ball = shape("sphere", 0.05, 0.0, (0, 0, 0))
    parts = [link("trunk", 8.0, (0, 0, 0.2), ball)]
    for side, y in (("left", HIP), ("right", -HIP)):
        thigh, shin, foot = (f"{side}_{name}" for name in ("thigh", "shin", "foot"))
        parts += [
            link(thigh, 3.0, (0, 0, -LEG / 2), ball),
            link(shin, 2.0, (0, 0, -LEG / 2), ball),
            link(foot, 0.5, (0, 0, -0.03)),
            joint(f"{side}_hip", "revolute", "trunk", thigh, (0, y, 0), (0, 1, 0)),
            joint(f"{side}_knee", "revolute", thigh, shin, (0, 0, -LEG), (0, 1, 0)),
            joint(f"{side}_ankle", "revolute", shin, foot, (0, 0, -LEG), (0, 1, 0)),
        ]
    up, reach, wide = (0, 0, 0.4), (0.3, 0, 0), (-2.0, 2.0)
    parts += [
        link("shoulder", 0.5, (0, 0, 0)),
        link("upper_arm", 4.0, (0.15, 0, 0), ball),
        link("forearm", 3.0, (0.15, 0, 0), ball),
        link("hand", 1.0, (0, 0, 0), ball),
        joint("turn", "revolute", "trunk", "shoulder", up, (0, 0, 1), limits=wide),
        joint(
            *("lift", "revolute", "shoulder", "upper_arm", (0, 0, 0), (0, 1, 0)),
            limits=wide,
            effort=200.0,
        ),
        joint("elbow", "revolute", "upper_arm", "forearm", reach, limits=wide),
        joint("wrist", "fixed", "forearm", "hand", reach),
    ]
    corners = [[x, y, -SOLE] for x, y in ((0.14, 0.05), (-0.1, 0.05))]
    corners += [[x, -y, z] for x, y, z in corners[::-1]]
    bends = {"hip": -BEND, "knee": 2 * BEND, "ankle": -BEND}
    rest = {f"{s}_{name}": b for s in ("left", "right") for name, b in bends.items()}
    made = product.write_robot(
        folder,
        urdf(*parts),
        pairs=[["forearm", "trunk"], ["hand", "left_thigh"], ["hand", "trunk"]],
        points=["hand"],
        base="trunk",
        place=(0.0, 0.0, 2.0 * LEG * float(np.cos(BEND)) + SOLE),
        rest=rest | {"lift": 1.2, "elbow": 1.6, "turn": -0.6},
        soles={"left_foot": corners, "right_foot": corners},
        floats=True,
    )
    return made, ["hand"]
