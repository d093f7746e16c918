"""A robot's own MJCF, MuJoCo's format: read by MuJoCo itself, as a tree of links.

MuJoCo compiles the file, so that defaults, includes, units, orientations, meshes and
inertias mean here what they mean there. What the compiled model has and a tree of
links has not is said in the notes, or refused.

A body becomes a link with the body's frame. A joint that is not the only one of its
body, or is beside the body's origin, gets a link without geometry of its own.
"""

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from crar_drake.errors import ModelError
from crar_drake.resources import require_packages
from crar_drake.robot_import.mjcf_model import (
    body_shapes,
    effort_limits,
    keyframe_posture,
    kind_of,
    pose_of,
)
from crar_drake.robot_import.robot_files import default_name
from crar_drake.robot_import.source_robot import (
    WORLD,
    Inertia,
    Joint,
    Link,
    Loop,
    SourceRobot,
)
from crar_drake.robot_import.source_tree import SourceTree

_UNNAMED = "MuJoCo Model"  # what MuJoCo calls a model without a name
_TINY = 1e-9  # of a coefficient


def read_mjcf(path: Path) -> SourceRobot:
    """Reads an MJCF.

    Of a scene only the robot is taken: the free body with the most joints, or all
    that is mounted in the world and has joints.

    Raises:
        ModelError: MuJoCo is not installed or cannot read the file, or the file has no
            joints that turn or slide.
    """
    require_packages({"mujoco": "mujoco"}, "importing an MJCF")
    import mujoco

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            spec = mujoco.MjSpec.from_file(str(path))
            # Both would take away what the import needs: the look, and frames.
            spec.compiler.discardvisual = False
            spec.compiler.fusestatic = False
            model = spec.compile()
    except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as error:
        said = _line(error)
        lacks = "not found" in said or "unknown" in said
        raise ModelError(
            f"{path}: MuJoCo cannot read it: {said}{_scenes(path) if lacks else ''}"
        ) from error
    notes = [f"MuJoCo says: {_line(warning.message)}" for warning in caught]
    name = "" if spec.modelname == _UNNAMED else spec.modelname
    return _Reader(path, model, notes).read(name)


def _scenes(path: Path) -> str:
    """Of a file that others beside it include, that these may have what it lacks."""
    name = re.escape(path.name)
    include = re.compile(rf"""<include\s[^>]*file\s*=\s*["'](\./)?{name}["']""")
    scenes = sorted(
        other.name
        for other in path.parent.glob("*.xml")
        if other.is_file() and include.search(other.read_text(errors="replace"))
    )
    return f"; what it lacks may be in {' or '.join(scenes)}" if scenes else ""


def _line(said: object) -> str:
    """What MuJoCo says in several lines, in one."""
    return "; ".join(line for line in str(said).split("\n") if line)


class _Reader(SourceTree):
    """Turns a compiled model into links and joints, and keeps what it meets."""

    def __init__(self, path: Path, model, notes: list[str]) -> None:
        super().__init__(path, notes)
        self._model = model
        # What the model's bodies and joints are called here, by their indices there.
        self._bodies, self._joint_names = {0: WORLD}, {}
        self._efforts = effort_limits(model)

    def read(self, name: str) -> SourceRobot:
        """All of it; the model's name may be ""."""
        trees, left_out = self._select_trees()
        bodies = [i for i in range(1, self._model.nbody) if self._top(i) in trees]
        for body in bodies:
            named = self._model.body(body).name or f"body_{body}"
            self._bodies[body] = self.unique(named)
            self._name_joints(body)
        self.reserved = set(self._joint_names.values())
        mounted = not self._is_free(trees[0])
        if mounted:
            self.add_link(Link(WORLD))
        # Parents have smaller indices than their children.
        for body in bodies:
            link, X_PB = self._bodies[body], pose_of(self._model, "body", body)
            if body in trees:
                parent, X_PB = self.stand(link, X_PB, mounted)
            else:
                parent = self._bodies[self._model.body_parentid[body]]
            visual, collision = body_shapes(self._model, body, link, self.notes)
            inertia = _inertia(self._model, body)
            self.add_link(Link(link, visual, collision, inertia))
            if parent:
                self._join(parent, X_PB, body)
        self._add_sites()
        loops = self._read_equalities()
        self._note_left_out(left_out)
        name = (name or default_name(self.path)).replace(" ", "_")
        posture = keyframe_posture(self._model, self._joint_names)
        return self.finished(name, loops, posture)

    # --- which bodies are the robot -------------------------------------------------

    def _top(self, body: int) -> int:
        """The body in the world that a body hangs on."""
        return int(self._model.body_rootid[body])

    def _is_free(self, root: int) -> bool:
        return any(self._kind(j) == "free" for j in self._joints_of(root))

    def _joints_of(self, body: int) -> range:
        first = int(self._model.body_jntadr[body])
        return range(first, first + int(self._model.body_jntnum[body]))

    def _own_joints(self, body: int) -> list[int]:
        """Those by which it does not float."""
        return [j for j in self._joints_of(body) if self._kind(j) != "free"]

    def _kind(self, joint: int) -> str:
        """free, ball, slide or hinge."""
        return kind_of("mjtJoint", self._model.jnt_type[joint])

    def _select_trees(self) -> tuple[list[int], list[int]]:
        """Roots of what is the robot, and of what is not."""
        model = self._model
        count = {i: 0 for i in range(1, model.nbody) if model.body_parentid[i] == 0}
        for joint in range(model.njnt):
            if self._kind(joint) in ("hinge", "slide"):
                count[self._top(model.jnt_bodyid[joint])] += 1
        moving = [root for root, joints in count.items() if joints]
        if not moving:
            raise ModelError(
                f"{self.path}: it has no joint that turns or slides (a ball or free "
                "joint is none)"
            )
        main = max(moving, key=count.get)
        trees = [main]
        if not self._is_free(main):
            trees = [root for root in moving if not self._is_free(root)]
        return trees, [root for root in count if root not in trees]

    def _note_left_out(self, left_out: list[int]) -> None:
        model = self._model
        names = [model.body(i).name or f"body {i}" for i in left_out]
        scene = [i for i in range(model.ngeom) if model.geom_bodyid[i] == 0]
        names += [model.geom(i).name or "a shape of the world" for i in scene]
        self.note_foreign(names)
        balls = [n for j, n in self._joint_names.items() if self._kind(j) == "ball"]
        if balls:
            self.notes.append(
                f"ball joints are not supported: {', '.join(balls)} must be locked; "
                "three hinges in their stead can be controlled"
            )
        if model.ntendon:
            tendons = [model.tendon(i).name or str(i) for i in range(model.ntendon)]
            self.notes.append(
                f"tendons are left out, and what pulls at them: {', '.join(tendons)}"
            )
        dofs = [
            int(model.jnt_dofadr[j])
            for j in self._joint_names
            if self._kind(j) in ("hinge", "slide")
        ]
        lost = {
            "armature": np.any(model.dof_armature[dofs]),
            "friction": np.any(model.dof_frictionloss[dofs]),
            "springs": np.any(model.jnt_stiffness[list(self._joint_names)]),
        }
        if left_out := [what for what, there in lost.items() if there]:
            self.notes.append(f"left out of the joints: {', '.join(left_out)}")
        self.notes.append(
            "MJCF has no speed limits: the joints have none, unless a scenario's "
            "controller gives velocity_limits"
        )

    # --- links and joints -----------------------------------------------------------

    def _name_joints(self, body: int) -> None:
        joints = self._own_joints(body)
        for index, joint in enumerate(joints):
            count = f"_{index + 1}" if len(joints) > 1 else ""
            otherwise = f"{self._bodies[body]}_joint{count}"
            self._joint_names[joint] = self._model.joint(joint).name or otherwise

    def _join(self, parent: str, X_PB: RigidTransform, body: int) -> None:
        """Adds what joins a body to a link: its joints, one after the other."""
        model, link, joints = self._model, self._bodies[body], self._own_joints(body)
        X = X_PB
        for index in joints:
            p_BM = np.array(model.jnt_pos[index])
            X_PM, X_MB = X @ RigidTransform(p_BM), RigidTransform(-p_BM)
            if index == joints[-1]:
                self.add_joint(self._joint(index, parent, link, X_PM), X_MB)
            else:
                child = self.add_bare_link(f"{self._joint_names[index]}_link")
                self.add_joint(self._joint(index, parent, child, X_PM))
                parent, X = child, X_MB
        if not joints:
            self.weld(parent, link, X_PB)

    def _joint(self, index: int, parent: str, child: str, X: RigidTransform) -> Joint:
        """A joint whose frame is at X where MuJoCo draws the body."""
        model, name, kind = self._model, self._joint_names[index], self._kind(index)
        limited = bool(model.jnt_limited[index]) and kind != "ball"
        lower, upper = model.jnt_range[index] if limited else (-np.inf, np.inf)
        axis = np.array(model.jnt_axis[index]) if kind != "ball" else np.zeros(3)
        turns = "revolute" if limited else "continuous"
        joint = Joint(
            name,
            {"slide": "prismatic", "hinge": turns, "ball": "ball"}[kind],
            parent,
            child,
            X,
            axis,
            float(lower),
            float(upper),
            self._efforts.get(index),
            None,
            float(np.ravel(model.dof_damping[model.jnt_dofadr[index]])[0]),
        )
        if not joint.moves:
            return joint
        # MuJoCo draws the body where the joint is at its reference, not at zero.
        reference = float(model.qpos0[model.jnt_qposadr[index]])
        return replace(joint, X_PC=joint.transform(-reference))

    def _add_sites(self) -> None:
        """Sites become links without geometry, which frames can name."""
        model = self._model
        through = {
            int(model.wrap_objid[i])
            for i in range(model.nwrap)
            if kind_of("mjtWrap", model.wrap_type[i]) == "site"
        }
        for site in range(model.nsite):
            body = int(model.site_bodyid[site])
            name = model.site(site).name
            if body == 0 or body not in self._bodies or not name or site in through:
                continue
            X_BS = pose_of(model, "site", site)
            self.add_frame(self._bodies[body], name, "_site", X_BS)

    # --- equalities -----------------------------------------------------------------

    def _read_equalities(self) -> tuple[Loop, ...]:
        """Joints that follow others become mimic joints; the rest closes loops."""
        model, loops = self._model, []
        for index in range(model.neq):
            kind = kind_of("mjtEq", model.eq_type[index])
            name = model.equality(index).name or f"{kind} {index}"
            if not model.eq_active0[index]:
                continue
            if kind == "joint" and self._follow(index):
                continue
            joints = self._loop(index) if kind in ("connect", "weld") else []
            if joints:
                loops.append(Loop(name, tuple(joints)))
            else:
                self.notes.append(f"the equality {name} ({kind}) is left out")
        return tuple(loops)

    def _follow(self, index: int) -> bool:
        """Makes one joint mimic another; whether the two are joints of the robot."""
        model = self._model
        ids = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if not all(j in self._joint_names for j in ids):
            return False
        follower, leader = (self._joint_names[j] for j in ids)
        q_follower, q_leader = (model.qpos0[model.jnt_qposadr[j]] for j in ids)
        offset, multiplier, *curved = model.eq_data[index][:5]
        if np.abs(curved).max() > _TINY:
            self.notes.append(
                f"{follower} follows {leader} by a curve: read as a straight line"
            )
        self.joints[follower] = replace(
            self.joints[follower],
            mimic=leader,
            multiplier=float(multiplier),
            offset=float(offset + q_follower - multiplier * q_leader),
        )
        return True

    def _loop(self, index: int) -> list[str]:
        """The joints between two bodies of the robot that are tied together."""
        model = self._model
        ends = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if kind_of("mjtObj", model.eq_objtype[index]) == "site":
            ends = tuple(int(model.site_bodyid[site]) for site in ends)
        if any(body == 0 or body not in self._bodies for body in ends):
            return []
        links = (self._bodies[body] for body in ends)
        return [joint.name for joint in self.robot().between(*links)]


def _inertia(model, body: int) -> Inertia | None:
    """A body's mass and central inertia, in the body's axes."""
    mass = float(model.body_mass[body])
    if not mass > 0.0:
        return None
    wxyz = np.array(model.body_iquat[body])
    R = RotationMatrix(Quaternion(wxyz / np.linalg.norm(wxyz))).matrix()
    moments = R @ np.diag(model.body_inertia[body]) @ R.T
    return Inertia(mass, RigidTransform(model.body_ipos[body]), moments)
