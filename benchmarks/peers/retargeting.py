"""Whole bodies: `crar-drake retarget` beside mink, frame by frame.

python -m benchmarks.peers.retargeting g1_whole_body dance cmu:05_02 some.bvh ...
    [--page docs/measurements/retargeting.md]

Both are asked for the same root, directions of limbs and feet, at 30 frames a second.
For mink the directions become points: each limb as long as the robot's, from the root
on. It runs without a bound of distances, as retargeters that solve frame by frame do,
and with it; and by the law of GMR in two stages, turns of links first. What comes out
is judged alike.
"""

import json
import math
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.multibody.tree import RigidBody
from scipy.spatial.transform import Rotation

from benchmarks.page import Benchmark, Table, run
from benchmarks.peers.peers import MARGIN
from benchmarks.peers.robot_files import mjcf, simplified_urdf
from benchmarks.peers.runs import PLACE, environment, run_driver
from crar_drake.motion.catalogue import load_performer
from crar_drake.references.ground_contact import Outline
from crar_drake.references.motion_files import read_motion
from crar_drake.references.reference_judge import ReferenceJudge
from crar_drake.references.retarget_file import (
    RATE,
    FileRetargeter,
    RetargetOptions,
    likeness,
)
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.robot.description import find_body, find_frame, whole_body_name
from crar_drake.trajectory.performer_targets import (
    LIMBS,
    PerformerTargets,
    performer_targets,
)

HEADER = [
    "motion",
    "by",
    "farthest limb, median / 95 %",
    "knees, median of either",
    "slip, at most",
    "lowest point",
    "frames with meshes in penetration",
    "frames with a joint too fast",
    "root's acceleration, rms",
    "jerk, rms",
    "× real time",
]
ALL_HEADER = [
    "by",
    "farthest limb, median / 95 %, medians of the motions",
    "slip, median and worst",
    "lowest point, median and worst",
    "frames with meshes in penetration",
    "frames with a joint too fast",
    "root's acceleration, rms, median",
    "jerk, rms, median",
    "× real time, median",
]
SETTINGS = {
    "steps": 10,
    "enough": 1e-3,
    "lm_damping": 0.1,
    "root": 1.0,
    "turn": 1.0,
    "posture": 0.02,
    "collision_gain": 0.85,
    "collision_distance": MARGIN,
    "detection_distance": 0.05,
    "relaxation": 0.0,
}
_OWN = "crar-drake retarget"
_GMR = "GMR's law"
_WAYS = (
    ("mink", {"collisions": False}),
    ("mink, distances bounded", {"collisions": True}),
    (_GMR, {"collisions": False}),
)
_SOLE = 5.0  # cost of heels and balls, the other points' being 1


@dataclass(frozen=True)
class Figures:
    """What one of them made of a motion.

    Attributes:
        motion, by: which, and who.
        limb, limb_95: the farthest limb, in the median and in 95 % of the frames [rad].
        knees: how much more than the person's each bends, in the median [rad].
        slip: longest way of a foot in a contact [m].
        lowest: of all links over the floor [m].
        frames: number of frames.
        penetrating: number of those in which meshes penetrate.
        fast: number of those in which a joint is too fast.
        root: rms of its acceleration [m/s²].
        jerk: rms [rad/s³].
        times_real_time: of one core.
    """

    motion: str
    by: str
    limb: float
    limb_95: float
    knees: tuple[float, ...]
    slip: float
    lowest: float
    frames: int
    penetrating: int
    fast: int
    root: float
    jerk: float
    times_real_time: float

    def row(self) -> list[str]:
        return [
            self.motion,
            self.by,
            f"{math.degrees(self.limb):.1f}° / {math.degrees(self.limb_95):.1f}°",
            " / ".join(f"{math.degrees(more):+.1f}°" for more in self.knees),
            f"{1e3 * self.slip:.0f} mm",
            f"{1e3 * self.lowest:.1f} mm",
            f"{self.penetrating} of {self.frames}",
            f"{self.fast}",
            f"{self.root:.1f} m/s²",
            f"{self.jerk:.0f} rad/s³",
            f"{self.times_real_time:.1f}",
        ]


def row_of_all(found: Sequence[Figures]) -> list[str]:
    """One of them, over its motions."""

    def median(name: str) -> float:
        return float(np.median([getattr(each, name) for each in found]))

    frames = sum(each.frames for each in found)
    shares = (
        sum(getattr(each, name) for each in found) / frames
        for name in ("penetrating", "fast")
    )
    return [
        found[0].by,
        f"{math.degrees(median('limb')):.1f}° / {math.degrees(median('limb_95')):.1f}°",
        f"{1e3 * median('slip'):.0f} mm, {1e3 * max(x.slip for x in found):.0f} mm",
        f"{1e3 * median('lowest'):.1f} mm, {1e3 * min(x.lowest for x in found):.1f} mm",
        *(f"{100.0 * share:.1f} %" for share in shares),
        f"{median('root'):.1f} m/s²",
        f"{median('jerk'):.0f} rad/s³",
        f"{median('times_real_time'):.1f}",
    ]


class Comparison:
    """One robot's retargeting by both."""

    def __init__(self, robot: str, folder: Path, python: str) -> None:
        """
        Args:
            robot: name or folder, imported as a whole body.
            folder: to work in.
            python: that has mink.
        """
        self._own = FileRetargeter(
            RetargetOptions(robot, layout="mjlab-npz", rate=RATE)
        )
        self._retargeter = self._own.retargeter
        description, plant = self._retargeter.description, self._retargeter.model.plant
        self._folder, self._python = folder, python
        self._at_rest = plant.CreateDefaultContext()
        plant.SetPositions(self._at_rest, self._retargeter.rest)
        base = find_body(plant, description.base).EvalPoseInWorld(self._at_rest)
        self._base = base.translation(), base.rotation().matrix()
        self._judge = ReferenceJudge(description)
        self._outline = Outline(self._judge.robot)
        self._write_robot()

    def figures(self, motion: str) -> list[Figures]:
        """The figures of a motion, ours first."""
        retargeter, out = self._retargeter, self._folder / "own.npz"
        (clip,) = self._own(motion, out)
        targets = performer_targets(
            load_performer(motion),
            retargeter.legs,
            retargeter.soles,
            self._base[1],
            RATE,
            retargeter.parameters.cutoff,
        )
        own = read_motion(out, robot=self._judge.robot)
        found = [self._judged(motion, _OWN, targets, own, clip.times_real_time)]
        self._write_case(targets)
        for name, more in _WAYS:
            more = more | ({"stages": self._stages()} if name == _GMR else {})
            made, seconds = self._by_mink(own, more)
            speed = own.duration / seconds
            found.append(self._judged(motion, name, targets, made, speed))
        return found

    def _judged(
        self,
        name: str,
        by: str,
        targets: PerformerTargets,
        motion: RobotMotion,
        times_real_time: float,
    ) -> Figures:
        off, knees = likeness(self._retargeter, targets, motion)
        limbs = [by for limb, by in off.items() if "-" in limb]
        verdict = self._judge.judge(motion)
        ground = self._outline.ground_contact(motion, floor=0.0)
        fast = {frame for beyond in verdict.speeds for frame in beyond.frames}
        return Figures(
            motion=name,
            by=by,
            limb=float(np.median(limbs, axis=1).max()),
            limb_95=float(np.quantile(limbs, 0.95, axis=1).max()),
            knees=tuple(float(np.median(more)) for more in knees.values()),
            slip=max(foot.worst for foot in ground.feet),
            lowest=float(ground.lowest.min()),
            frames=motion.num_frames,
            penetrating=len(verdict.penetrating_frames),
            fast=len(fast),
            root=verdict.root_acceleration[0],
            jerk=verdict.rms_jerk,
            times_real_time=times_real_time,
        )

    def _write_robot(self) -> None:
        """Writes the robot for mink, with a link at each of its points."""
        retargeter = self._retargeter
        description, model = retargeter.description, retargeter.model
        frames = description.task_frames
        named = sorted({end for _, ends in LIMBS.values() for end in ends})
        named = [name for name in named if name in frames]
        points = [frames[name] for name in named]
        robot = simplified_urdf(
            Path(description.folder) / description.model, {}, points
        )
        ends = []
        for side, leg in retargeter.legs.items():
            frame = find_frame(model.plant, frames[f"{side}_foot"])
            link = frame.body()
            X_WL = link.EvalPoseInWorld(self._at_rest)
            for end in ("heel", "ball"):
                name = f"{side}_{end}"
                at = X_WL.inverse().multiply(
                    self._place(f"{side}_foot") + getattr(leg, end)
                )
                ends.append(name)
                ET.SubElement(robot, "link", {"name": name})
                joint = ET.SubElement(robot, "joint", {"name": f"{name}_weld"})
                joint.set("type", "fixed")
                ET.SubElement(joint, "parent", {"link": link.name()})
                ET.SubElement(joint, "child", {"link": name})
                xyz = " ".join(f"{x:.9g}" for x in at)
                ET.SubElement(joint, "origin", {"xyz": xyz})
        links = [*points, *ends]
        mujoco = ET.fromstring(mjcf(robot, links))
        body = mujoco.find("worldbody/body")
        body.insert(0, ET.Element("freejoint", {"name": "root"}))
        ET.ElementTree(mujoco).write(self._folder / "robot_mujoco.xml")
        names = [j.get("name") for j in mujoco.iter("joint")]
        self._joints = names
        order = [model.joint_names.index(name) for name in names]
        at = model.controlled_positions[: model.n]
        problem = {
            "robot": description.name,
            "base": body.get("name"),
            "joints": names,
            "lower": model.lower[order].tolist(),
            "upper": model.upper[order].tolist(),
            "velocity_limits": model.velocity_limits[model.controlled][order].tolist(),
            "task_links": links,
            "pairs": [list(pair) for pair in description.pairs],
            "rest": model.rest_positions()[at][order].tolist(),
        }
        (self._folder / "problem.json").write_text(json.dumps(problem))
        self._points = named

    def _write_case(self, targets: PerformerTargets) -> None:
        """Where the robot's points would be, had it the person's directions."""
        rest = {name: self._place(name) for name in self._points}
        turned = targets.root_rotations @ self._base[1].T
        at: dict[str, np.ndarray] = {}

        def from_root(name: str) -> np.ndarray:
            offset = rest[name] - self._base[0]
            return targets.root_positions + turned @ offset

        def on(limb: str, start: np.ndarray) -> np.ndarray:
            a, b = LIMBS[limb][1]
            length = np.linalg.norm(rest[b] - rest[a])
            return start + length * targets.directions[limb]

        at["waist"] = from_root("waist")
        at["neck"] = on("trunk", at["waist"])
        # The shoulders are about the trunk as at rest: across it, and along.
        trunk = rest["neck"] - rest["waist"]
        up = trunk / np.linalg.norm(trunk)
        for side, sign in (("left", 0.5), ("right", -0.5)):
            across = -sign * np.linalg.norm(
                rest["left_shoulder"] - rest["right_shoulder"]
            )
            along = (rest[f"{side}_shoulder"] - rest["neck"]) @ up
            at[f"{side}_shoulder"] = (
                at["neck"]
                + across * targets.directions["shoulders"]
                + along * targets.directions["trunk"]
            )
            at[f"{side}_hip"] = from_root(f"{side}_hip")
            for limb in ("shoulder-elbow", "elbow-wrist", "hip-knee", "knee-ankle"):
                a, b = LIMBS[f"{side}_{limb}"][1]
                at[b] = on(f"{side}_{limb}", at[a])
        if "head" in self._points:
            at["head"] = on("head", at["neck"])
        points = [at[name] for name in self._points]
        ends = [x for f in targets.feet.values() for x in (f.heel, f.ball)]
        costs = np.array([1.0] * len(points) + [_SOLE] * len(ends))
        quaternions = Rotation.from_matrix(targets.root_rotations).as_quat()
        np.savez(
            self._folder / "case.npz",
            points=np.stack([*points, *ends], axis=1),
            costs=costs,
            root_positions=targets.root_positions,
            root_quaternions=quaternions[:, [3, 0, 1, 2]],
            **self._turned_links(targets, turned),
        )

    def _turned_links(
        self, targets: PerformerTargets, turned: np.ndarray
    ) -> dict[str, np.ndarray]:
        """How GMR would have links turned: as at rest with the root, and from there
        the shortest way to the direction of their limbs.

        Args:
            targets: of the person.
            turned: (T, 3, 3) of the root, from rest.
        """
        plant = self._retargeter.model.plant
        frames = self._retargeter.description.task_frames
        asked = {}  # link to its direction at rest (3,) and in each frame (T, 3)

        def ask(link: RigidBody, at_rest: np.ndarray, wanted: np.ndarray) -> None:
            lengths = np.linalg.norm(wanted, axis=1, keepdims=True)
            asked[link.name()] = at_rest / np.linalg.norm(at_rest), wanted / lengths

        def body(name: str) -> RigidBody:
            return find_frame(plant, frames[name]).body()

        above = {}
        for index in plant.GetJointIndices():
            joint = plant.get_joint(index)
            above[joint.child_body().name()] = joint.parent_body()
        for side in ("left", "right"):
            for limb, link in (
                ("shoulder-elbow", above[body(f"{side}_elbow").name()]),
                ("elbow-wrist", body(f"{side}_elbow")),
                ("hip-knee", body(f"{side}_hip")),
                ("knee-ankle", body(f"{side}_knee")),
            ):
                a, b = LIMBS[f"{side}_{limb}"][1]
                way = self._place(b) - self._place(a)
                ask(link, way, targets.directions[f"{side}_{limb}"])
            leg, foot = self._retargeter.legs[side], targets.feet[side]
            ask(body(f"{side}_foot"), leg.ball - leg.heel, foot.ball - foot.heel)
        up = self._place("neck") - self._place("waist")
        ask(body("neck"), up, targets.directions["trunk"])
        quaternions = []
        for name, (at_rest, wanted) in asked.items():
            link = plant.GetBodyByName(name)
            R = link.EvalPoseInWorld(self._at_rest).rotation().matrix()
            way = turned @ at_rest
            axis = np.cross(way, wanted)
            angle = np.arctan2(np.linalg.norm(axis, axis=1), (way * wanted).sum(axis=1))
            axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-12)
            shortest = Rotation.from_rotvec(angle[:, None] * axis)
            placed = shortest * Rotation.from_matrix(turned @ R)
            quaternions.append(placed.as_quat()[:, [3, 0, 1, 2]])
        self._links = list(asked)
        return {
            "link_names": np.array(self._links),
            "link_quaternions": np.stack(quaternions, axis=1),
        }

    def _stages(self) -> list[dict]:
        """Costs like those that GMR publishes for this kind of robot: turns and where
        the soles are, and then where points are; trunk and upper arms turn foremost."""
        soles = [50.0] * (2 * len(self._retargeter.legs))
        frames = self._retargeter.description.task_frames
        plant = self._retargeter.model.plant
        trunk = find_frame(plant, frames["neck"]).body().name()
        first = [100.0 if name == trunk else 10.0 for name in self._links]
        last = [10.0 if name == trunk else 5.0 for name in self._links]
        far = ("elbow", "wrist", "knee", "hip")
        points = [10.0 if name.endswith(far) else 0.0 for name in self._points]
        points = [
            5.0 if name.endswith("shoulder") else cost
            for name, cost in zip(self._points, points, strict=True)
        ]
        none = [0.0] * len(points)
        return [
            {"root": 0.0, "turn": 10.0, "points": none + soles, "links": first},
            {"root": 100.0, "turn": 5.0, "points": points + soles, "links": last},
        ]

    def _place(self, name: str) -> np.ndarray:
        """(3,) where a task frame is as the robot stands [m]."""
        plant = self._retargeter.model.plant
        frame = find_frame(plant, self._retargeter.description.task_frames[name])
        return frame.CalcPoseInWorld(self._at_rest).translation()

    def _by_mink(self, like: RobotMotion, more: dict) -> tuple[RobotMotion, float]:
        """The motion, and how long a processor took [s]."""
        case = {
            "case": "case.npz",
            "settings": SETTINGS | more,
            "out": "made.npz",
        }
        words = str(self._folder), json.dumps([case])
        run_driver(self._python, "retarget_mink", *words)
        data = np.load(self._folder / "made.npz")
        qpos = data["qpos"]
        order = [7 + self._joints.index(name) for name in like.joint_names]
        motion = RobotMotion(
            joint_names=like.joint_names,
            root_positions=qpos[:, :3],
            root_quaternions=qpos[:, 3:7],
            joint_positions=qpos[:, order],
            rate=like.rate,
        )
        return motion, float(data["seconds"])


def main(argv: Sequence[str] | None = None) -> None:
    """Retargets by all, and prints the table."""
    benchmark = Benchmark("benchmarks.peers.retargeting", __doc__, "retargeting")
    benchmark.parser.add_argument("robot", help="name or folder")
    benchmark.parser.add_argument("motions", nargs="+")
    arguments = benchmark.parse(argv, lambda given: f"{given.robot} beside mink")
    found: list[Figures] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        python = environment(PLACE, "mink")
        comparison = Comparison(whole_body_name(arguments.robot), folder, python)
        for motion in arguments.motions:
            for each in comparison.figures(motion):
                found.append(each)
                print(" | ".join(each.row()), flush=True)
    ways = dict.fromkeys(each.by for each in found)
    of_all = [row_of_all([x for x in found if x.by == way]) for way in ways]
    title = f"All {len(arguments.motions)} motions"
    rows = [each.row() for each in found]
    benchmark.report([Table(ALL_HEADER, of_all, title), Table(HEADER, rows, "Each")])


if __name__ == "__main__":
    run(main)
