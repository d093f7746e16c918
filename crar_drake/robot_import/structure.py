"""Which way a robot stands, what of it is locked, where its points are."""

from dataclasses import replace

from crar_drake.errors import ModelError, nearest
from crar_drake.robot_import.alarms import coupling_alarms
from crar_drake.robot_import.anatomy import elbow_index, find_anatomy
from crar_drake.robot_import.body_frames import (
    guess_frames,
    guess_leg_and_head_frames,
    guess_tool,
    has_feet,
)
from crar_drake.robot_import.choices import ImportChoices
from crar_drake.robot_import.facing import guess_facing, guess_up, turned
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.joint_groups import DEFAULT_LOCK, guess_locked
from crar_drake.robot_import.meshes import Part
from crar_drake.robot_import.source_robot import WORLD, SourceRobot
from crar_drake.robot_import.srdf import read_srdf


def without_world(robot: SourceRobot, choices: ImportChoices) -> SourceRobot:
    """A humanoid's root is what stands in the world, not a link of that name."""
    bare = robot.without_world()
    if bare is None:
        return robot
    arms = any(find_anatomy(turned(bare, facing)) for facing in ("+x", "+y"))
    if choices.base not in ("prescribed", "floating") and not arms:
        return robot
    what = "called" if bare.root not in robot.links else "left out: the root is"
    note = f"the root link {WORLD!r} is {what} {bare.root}"
    return replace(bare, notes=(*robot.notes, note))


def with_semantics(robot: SourceRobot, report: ImportReport) -> SourceRobot:
    """The robot with a posture and the allowed pairs of its SRDF."""
    path = report.folder / report.choices.srdf
    semantics = read_srdf(path, robot)
    name, posture = semantics.posture(report.choices.posture)
    if name:
        report.notes.append(f"rests in the posture {name!r} of {path.name}")
    elif semantics.postures:
        what = f"no posture of {path.name} was taken; write one as posture"
        report.note(what, [*semantics.postures])
    return replace(robot, posture=posture or robot.posture, allowed=semantics.allowed)


def face_ahead(robot: SourceRobot, report: ImportReport) -> SourceRobot:
    """The robot in a frame whose x axis is its front, its z axis up."""
    choices = report.choices
    if choices.up is None and choices.facing is None:
        up = guess_up(robot)
        if up != "+z":
            choices.up = up
            report.guessed["up"] = "where arms and legs are found as a body has them"
            report.notes.append(f"{up} of the root link points up: it was turned")
    up = choices.up or "+z"
    if choices.facing is None:
        guess = guess_facing(robot, up)
        choices.facing = guess.facing
        report.guessed["facing"] = guess.why
        if guess.doubt:
            report.warnings.append(f"facing: {guess.doubt}")
        if guess.facing != "+x":
            report.notes.append(
                f"the robot faces {guess.facing} of its root link, {guess.why}: it was "
                "turned to face +x"
            )
    if (choices.facing, up) != ("+x", "+z") and robot.root == WORLD:
        raise ModelError(
            f"{report.file}: facing: the root link is named {WORLD!r}, which cannot "
            "turn; write +x (up: +z), or rename the link in the URDF"
        )
    return turned(robot, choices.facing, up)


def guess_structure(robot: SourceRobot, report: ImportReport) -> None:
    """Fills in base, locked and frames where the import file leaves them out."""
    choices, anatomy = report.choices, find_anatomy(robot)
    if choices.base is None:
        if robot.root == WORLD:
            choices.base, why = "fixed", f"the root link is named {WORLD!r}"
        elif anatomy is None:
            choices.base, why = "fixed", "no pair of mirrored arms was found"
        elif (
            choices.lock is not None
            and "legs" not in choices.lock
            and has_feet(robot, anatomy)
        ):
            choices.base, why = "floating", "mirrored arms and legs, none locked"
        else:
            choices.base, why = "prescribed", "two mirrored arms were found"
        report.guessed["base"] = why
    elif choices.base != "fixed" and robot.root == WORLD:
        raise ModelError(
            f"{report.file}: base: the root link is named {WORLD!r}, which cannot "
            "move; write fixed, or rename the link in the URDF"
        )
    if choices.locked is None:
        lock = DEFAULT_LOCK if choices.lock is None else choices.lock
        choices.locked = guess_locked(robot, anatomy, lock)
        if choices.srdf:
            stated = {n for n in choices.locked if not robot.joints[n].mimic}
            choices.locked |= {n: p for n, p in robot.posture.items() if n in stated}
        report.guessed["locked"] = _how_locked(choices, anatomy is not None)
        report.warnings += coupling_alarms(robot, anatomy, choices.locked)
    if choices.segments is None:
        group = welded_groups(replace(robot, locked=choices.locked))
        choices.segments = {}
        X = robot.poses()
        for arm in anatomy or ():
            hand = arm.hand
            forearm = arm.joints[elbow_index(X, arm)].child
            if group[hand] == group[forearm]:
                continue  # no wrist moves: a forearm is no hand
            others = [a for a in robot.links if group[a] == group[hand] and a != hand]
            others = [a for a in others if not robot.is_bare(a)]
            if others and group[hand] != robot.root:
                choices.segments[hand] = others
        report.guessed["segments"] = "all that is welded to a hand is one with it"
    if choices.frames is None:
        missing = (
            "a motion needs waist, neck and both arms' shoulder, elbow and wrist, "
            "keyframes only what your tasks name"
        )
        if anatomy:
            others, lacking = guess_leg_and_head_frames(robot, anatomy)
            choices.frames = guess_frames(robot, anatomy) | others
            how = "from the axes of the joints"
            if lacking:
                how += f"; not found: {', '.join(lacking)}"
        else:
            choices.frames = guess_tool(robot)
            found = "the tool at the end of the longest chain"
            how = f"{found if choices.frames else 'none'}; {missing}"
        report.guessed["frames"] = how


def _how_locked(choices: ImportChoices, arms: bool) -> str:
    if choices.lock is not None:
        return (
            f"joints of {', '.join(choices.lock) or 'no group'}, and those that cannot "
            "be controlled"
        )
    if arms:
        return "all joints that are not between the root and a hand"
    return "joints that mimic or are mimicked, and fingers"


def check_structure(robot: SourceRobot, report: ImportReport) -> SourceRobot:
    """Checks names and supported joints; the robot with its joints locked."""
    choices, file = report.choices, report.file
    locked = dict(choices.locked)
    robot = replace(robot, locked=locked)
    for name in locked:
        if name not in robot.joints:
            raise ModelError(
                f"{file}: locked: the robot has no joint {name!r}"
                f"{nearest(name, robot.joints)}"
            )
    for point, frame in choices.frames.items():
        _check_link(robot, frame.link, f"{file}: frames: {point}")
    for link in choices.soles:
        _check_link(robot, link, f"{file}: soles")
    group = welded_groups(robot)
    taken: set[str] = set()
    for name, others in choices.segments.items():
        for link in (name, *others):
            _check_link(robot, link, f"{file}: segments")
            if link in taken:
                raise ModelError(f"{file}: segments: {link!r} is there twice")
            if group[link] != group[name]:
                raise ModelError(
                    f"{file}: segments: {link!r} is not welded to {name!r}"
                )
            taken.add(link)
    for joint in robot.joints.values():
        if not joint.moves and not robot.is_weld(joint):
            raise ModelError(
                f"{file}: joint {joint.name!r} is {joint.kind}, which the controller "
                "does not support; add it to locked"
            )
        if not joint.mimic:
            continue
        if joint.name not in locked:
            raise ModelError(
                f"{file}: joint {joint.name!r} mimics {joint.mimic!r}: a mimic joint "
                "cannot be controlled; add both to locked"
            )
        if not robot.is_weld(robot.joints[joint.mimic]):
            raise ModelError(
                f"{file}: joint {joint.mimic!r} is mimicked by {joint.name!r}, which "
                "is locked; add it to locked, too"
            )
        if joint.name not in choices.locked or choices.locked[joint.name] == 0.0:
            leader = locked.get(joint.mimic, 0.0)
            locked[joint.name] = joint.multiplier * leader + joint.offset
    for loop in robot.loops:
        if open_joints := [name for name in loop.joints if name not in locked]:
            raise ModelError(
                f"{file}: {loop.name!r} closes a chain, which the controller does not "
                f"support; add to locked: {', '.join(open_joints)}"
            )
    for name, position in locked.items():
        joint = robot.joints[name]
        if not joint.lower - 1e-3 <= position <= joint.upper + 1e-3:
            raise ModelError(
                f"{file}: locked: {name}: {position:g} is beyond the joint's limits, "
                f"{joint.lower:g} to {joint.upper:g} {joint.unit}"
            )
    if all(joint.kind == "fixed" for joint in robot.joints.values()):
        raise ModelError(
            f"{robot.path}: no joint of it moves; import the file that has the whole "
            "robot"
        )
    if not robot.controlled:
        raise ModelError(f"{file}: no joint is left to control; take some from locked")
    return robot


def _check_link(robot: SourceRobot, link: str, where: str) -> None:
    if link not in robot.links:
        raise ModelError(
            f"{where}: the robot has no link {link!r}{nearest(link, robot.links)}"
        )


def merge_segments(robot: SourceRobot, choices: ImportChoices) -> dict[str, list[Part]]:
    """What each fit is made of: a link's parts and those of its segment's others, in
    the link's frame."""
    X = robot.posed()
    merged = {name: list(of_link) for name, of_link in robot.looks.items()}
    for name, others in choices.segments.items():
        for other in others:
            X_LO = X[name].inverse() @ X[other]
            merged[name] += [part.moved(X_LO) for part in merged.pop(other)]
    return {name: of_segment for name, of_segment in merged.items() if of_segment}


def welded_groups(robot: SourceRobot) -> dict[str, str]:
    """Link to the first link of those that are welded to it."""
    group = {robot.root: robot.root}
    for link in robot.below(robot.root):
        joint = robot.parent_joint(link)
        if joint is not None:
            group[link] = group[joint.parent] if robot.is_weld(joint) else link
    return group
