"""From motions to what a file of them holds, by the table of layouts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.references import locomujoco_npz
from crar_drake.references.contacts import LABELS
from crar_drake.references.held_values import FRAME, write_held
from crar_drake.references.layout_reader import FROM_WXYZ, OBJECTS
from crar_drake.references.layouts import EULER, LINK_STATES, TIME, Layout
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody


def write_layout(
    path: Path,
    motions: Sequence[RobotMotion],
    layout: Layout,
    robot: WholeBody | None,
) -> None:
    """Writes a file, whole or not at all.

    Velocities are central differences of the samples (one-sided at the ends), as the
    tools that make such files take them; links' poses and velocities are the robot's.

    Args:
        path: of the file.
        motions: their joints in the order of the layout; one, unless it has several.
        layout: of the file.
        robot: that moves; not needed where the file had what follows from it, and
            nothing has changed since.

    Raises:
        MotionError: joints have no names, there is no robot where one is needed, or
            motions do not go into one file.
    """
    held = [_Held(path, motion, layout, robot).values for motion in motions]
    if layout.name == locomujoco_npz.NAME:
        write_held(path, layout.suffix, locomujoco_npz.joined_trajectories(path, held))
    elif not layout.several or (
        # A file that was one clip without a name stays so.
        len(motions) == 1 and not motions[0].clip and motions[0].layout == layout.name
    ):
        write_held(path, layout.suffix, held[0])
    else:
        clips = {}
        for motion, values in zip(motions, held, strict=True):
            name = motion.clip or Path(motion.source).stem or "motion"
            if name in clips:
                raise MotionError(f"{path}: two clips are called {name!r}")
            clips[name] = values
        write_held(path, layout.suffix, clips)


def kept_extras(motion: RobotMotion, layout: Layout) -> dict[str, object]:
    """What of a motion's extras goes into a file of a layout: labels of contacts if
    there is room, and all others if it is from such a one."""
    same = motion.layout == layout.name
    return {
        key: value
        for key, value in motion.extras.items()
        if (layout.has_room if key in LABELS else same)
    }


class _Held:
    """What a file holds of one motion."""

    def __init__(
        self,
        path: Path,
        motion: RobotMotion,
        layout: Layout,
        robot: WholeBody | None,
    ) -> None:
        self._path, self._motion, self._layout = path, motion, layout
        self._robot = robot
        self._same = motion.layout == layout.name
        self._kept = dict(motion.computed) if self._same and motion.is_as_read else {}
        self._extras = kept_extras(motion, layout)
        precision = motion.precision if self._same else ""
        self._precision = precision or layout.precision
        self.values = self._values()

    def _values(self) -> dict[str, object]:
        layout, motion = self._layout, self._motion
        if not motion.joint_names and (layout.has_columns or layout.needed):
            raise MotionError(
                f"{self._path}: {layout.name} has the joints' names, and the motion "
                "has none: say which robot it is (--robot)"
            )
        held: dict[str, object] = {}
        if layout.rate == TIME:
            held[TIME] = np.arange(motion.num_frames) / motion.rate
        elif layout.has_rate:
            rate = int(motion.rate) if motion.rate == int(motion.rate) else motion.rate
            held[layout.rate] = np.array([rate]) if layout.suffix == ".npz" else rate
        elif layout.has_columns:
            held[FRAME] = np.arange(motion.num_frames)
        held |= self._parts()
        if layout.links and not set(LINK_STATES) <= self._kept.keys():
            self._kept = self._link_states()
        if layout.velocities:
            speeds = self._kept.get("joint_vel")
            if speeds is None:
                speeds = self._speeds().astype(self._precision)
            held[layout.velocities] = speeds
        states = dict(zip(layout.links[1:], LINK_STATES, strict=False))
        held |= {theirs: self._kept[ours] for theirs, ours in states.items()}
        if layout.computed:
            held |= self._computed_besides()
        return held | self._extras | self._names()

    def _names(self) -> dict[str, object]:
        """The joints' names, under a key that the file had, or the layout has."""
        layout, names = self._layout, self._motion.joint_names
        if not names or not layout.names:
            return {}
        keys = [key for key in layout.names[1:] if key in self._extras]
        as_held = np.array(names) if layout.suffix == ".npz" else list(names)
        return dict.fromkeys(keys or layout.names[:1], as_held)

    def _parts(self) -> dict[str, np.ndarray]:
        """Arrays of root and joints, or columns with names."""
        layout, motion = self._layout, self._motion
        rows = self._kept.get("rows")
        if rows is None:
            joints = motion.joint_positions / layout.radian
            rows = np.hstack([self._position(), self._rotation(), joints])
            rows = rows if layout.suffix == ".csv" else rows.astype(self._precision)
        if layout.has_columns:
            position, rotation, joints = (part.keys for part in layout.parts)
            keys = [joints[0].replace("*", name) for name in motion.joint_names]
            return dict(zip((*position, *rotation, *keys), rows.T, strict=True))
        pieces: dict[str, dict[int, np.ndarray]] = {}
        values = np.split(rows, [3, rows.shape[1] - motion.num_joints], axis=1)
        for part, columns in zip(layout.parts, values, strict=True):
            if not part.of_links:
                pieces.setdefault(part.keys[0], {})[part.first] = columns
        if OBJECTS in self._extras:
            pieces["qpos"][rows.shape[1]] = self._extras.pop(OBJECTS)
        return {
            key: np.hstack([columns[first] for first in sorted(columns)])
            for key, columns in pieces.items()
        }

    def _position(self) -> np.ndarray:
        layout, motion = self._layout, self._motion
        position = motion.root_positions
        if 7 + motion.num_joints == layout.raised_columns:
            position = position - [0.0, 0.0, layout.raised]
        return position / layout.metre

    def _rotation(self) -> np.ndarray:
        order, motion = self._layout.order, self._motion
        if order in FROM_WXYZ:
            return motion.root_quaternions[:, FROM_WXYZ[order]]
        if order == EULER:
            return motion.root_rotations.as_euler(EULER, degrees=True)
        return motion.root_rotations.as_rotvec()

    def _speeds(self) -> np.ndarray:
        """Of the joints; of the root before them, where it stands before them."""
        motion, step = self._motion, 1.0 / self._motion.rate
        qdot = _difference(motion.joint_positions, step)
        if not self._layout.root_columns:
            return qdot
        w = _turning(motion.root_rotations, step)
        if self._layout.own_spin:
            w = motion.root_rotations.inv().apply(w)
        return np.hstack([_difference(motion.root_positions, step), w, qdot])

    def _link_states(self) -> dict[str, np.ndarray]:
        """Velocities, and the links' poses and velocities in the world."""
        layout, motion, robot = self._layout, self._motion, self._robot
        if robot is None:
            raise MotionError(
                f"{self._path}: {layout.name} has the poses of the robot's links, "
                "which follow from its model: say which robot (--robot)"
            )
        links = robot.links_of(motion.joint_names)
        kept = tuple(map(str, self._extras.pop(layout.links[0], ())))
        if layout.name == "amp-npz" and kept and all(map(robot.has_link, kept)):
            links = kept  # some or all; its first is the root
        self._extras[layout.links[0]] = np.array(links)
        step = 1.0 / motion.rate
        R_WR = motion.root_rotations
        v_WR, w_WR = _difference(motion.root_positions, step), _turning(R_WR, step)
        columns = robot.columns_in(motion.joint_names)
        q = motion.joint_positions
        v = _difference(q, step)[:, columns]
        p_RB, R_RB = robot.poses_in_root(q[:, columns], links)
        v_RB, w_RB = robot.velocities_in_root(q[:, columns], v, links)
        R = R_WR.as_matrix()[:, None]
        p_RB_W, v_RB_W, w_RB_W = (
            np.einsum("tlij,tlj->tli", np.broadcast_to(R, R_RB.shape), x)
            for x in (p_RB, v_RB, w_RB)
        )
        turned = np.cross(w_WR[:, None], p_RB_W)
        quaternions = Rotation.from_matrix((R @ R_RB).reshape(-1, 3, 3)).as_quat()
        quaternions = quaternions[:, [3, 0, 1, 2]].reshape(*p_RB.shape[:2], 4)
        # Of the root the samples themselves, not what they are after two conversions.
        quaternions[:, 0] = motion.root_quaternions
        found = (
            motion.root_positions[:, None] + p_RB_W,
            quaternions,
            v_WR[:, None] + turned + v_RB_W,
            w_WR[:, None] + w_RB_W,
        )
        states = (value.astype(self._precision) for value in found)
        return dict(zip(LINK_STATES, states, strict=True))

    def _computed_besides(self) -> dict[str, object]:
        """`local_body_pos` of GMR, `pose_aa` of motion_lib."""
        layout, motion, robot = self._layout, self._motion, self._robot
        if set(layout.computed) <= self._kept.keys():
            return {key: self._kept[key] for key in layout.computed}
        if layout.name == "gmr-pkl":
            if robot is None:
                return dict.fromkeys(layout.computed)
            links = robot.links_of(motion.joint_names)
            columns = robot.columns_in(motion.joint_names)
            p_RB, _ = robot.poses_in_root(motion.joint_positions[:, columns], links)
            values = p_RB.astype("float32"), list(links)
            return dict(zip(layout.computed, values, strict=True))
        if robot is None:
            raise MotionError(
                f"{self._path}: {layout.name} has the joints' turns about their axes "
                "(pose_aa), which follow from the robot's model: say which robot "
                "(--robot)"
            )
        order = [robot.joint_names.index(name) for name in motion.joint_names]
        turns = robot.joint_axes[order] * motion.joint_positions[:, :, None]
        root = motion.root_rotations.as_rotvec()[:, None]
        pose = np.concatenate([root, turns], axis=1).astype(self._precision)
        return {"pose_aa": pose}


def _difference(samples: np.ndarray, step: float) -> np.ndarray:
    """(T, k) rates of change of (T, k) samples that are `step` apart [s]."""
    if len(samples) < 2:
        return np.zeros_like(samples)
    return np.gradient(samples, step, axis=0)


def _turning(R: Rotation, step: float) -> np.ndarray:
    """(T, 3) angular velocities in the world [rad/s]."""
    if len(R) < 2:
        return np.zeros((len(R), 3))
    inner = (R[2:] * R[:-2].inv()).as_rotvec() / (2.0 * step)
    first, last = ((R[i + 1] * R[i].inv()).as_rotvec() / step for i in (0, len(R) - 2))
    return np.vstack([first, inner, last])
