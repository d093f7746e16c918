"""`crar-drake import-robot`: a robot that scenarios can name, from its own file."""

import argparse
from pathlib import Path

from crar_drake.commands.folders import progress_bar
from crar_drake.commands.options import add_command


def add(subparsers: argparse._SubParsersAction) -> None:
    """Adds the command and its options."""
    parser = add_command(
        subparsers,
        "import-robot",
        run,
        "Make a robot that scenarios can name, from its URDF, SDF or MJCF "
        "(docs/guides/your-robot.md). "
        "Needs the extra robots.",
    )
    parser.add_argument(
        "robot",
        metavar="ROBOT",
        help="a URDF, SDF or MJCF file, g1, talos, the name of another robot of the "
        "package example-robot-data, or a folder that was imported before",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder to write (default: one in the user's cache, so that scenarios "
        "find the robot by its name)",
    )
    parser.add_argument(
        "--package-path",
        action="append",
        metavar="DIR",
        help="folder in which the packages of package:// addresses lie",
    )
    locked = parser.add_mutually_exclusive_group()
    locked.add_argument(
        "--lock",
        metavar="GROUPS",
        help="groups of joints to lock, with commas between: legs, arms, hands, head, "
        "trunk, other (default: all but the arms and what carries them)",
    )
    locked.add_argument(
        "--whole-body",
        action="store_true",
        help="lock no joint that can be controlled; the base of a robot with legs "
        "floats, for reference motions and for standing",
    )
    parser.add_argument(
        "--base",
        choices=("prescribed", "floating", "fixed"),
        help="what becomes of the root link: a motion moves it and turns it about the "
        "vertical (prescribed), it floats, for reference motions and for standing "
        "(floating), or it is welded (default: floating with --whole-body and legs, "
        "else prescribed with two arms, else fixed)",
    )
    parser.add_argument(
        "--cover",
        action="store_true",
        help="grow the capsules until they hold all triangles of the meshes, by which "
        "meshes are clear wherever capsules are (on a first import)",
    )
    parser.add_argument(
        "--srdf",
        metavar="FILE",
        default="",
        help="semantic description: a posture of it is the rest posture, and pairs of "
        "links whose collisions it disables are not watched (on a first import)",
    )
    parser.add_argument(
        "--posture",
        metavar="NAME",
        default="",
        help="group_state of the SRDF (default: half_sitting, standing, home, ready, "
        "neutral or default, or the only one)",
    )


def run(arguments: argparse.Namespace) -> None:
    """Does what the arguments say."""
    from crar_drake.errors import ModelError, printable
    from crar_drake.files import whole_file
    from crar_drake.resources import imported_robots_folder
    from crar_drake.robot.description import IMPORT_FILE, import_file
    from crar_drake.robot_import import check_installed, import_robot, load_choices
    from crar_drake.robot_import.robot_files import default_name, find_urdf

    # What is missing is reported before a file is written.
    check_installed()
    given, lock = arguments.robot, _groups_to_lock(arguments)
    robot, out = given, arguments.out
    shipped = import_file(given)
    if shipped is not None:
        robot = ""
        source, _ = find_urdf(load_choices(shipped).source)
        for refused, what in (
            (lock is not None, "locked joints"),
            (arguments.base is not None, "base"),
            (arguments.srdf, "rest posture and pairs"),
        ):
            if refused:
                raise ModelError(
                    f"the robot {given} comes with its {what}; import its own file "
                    f"with that option: {source.stem}"
                )
        out = out or imported_robots_folder() / given
        kept = arguments.out is not None and (out / IMPORT_FILE).is_file()
        if not kept:
            with whole_file(out / IMPORT_FILE) as temporary:
                temporary.write_bytes(shipped.read_bytes())
    elif (Path(given) / IMPORT_FILE).is_file():
        robot, out = "", out or Path(given)
    elif out is None:
        out = imported_robots_folder() / default_name(find_urdf(given)[0])
    with progress_bar() as bar:
        task = bar.add_task("", total=100)
        report = import_robot(
            robot,
            out,
            package_paths=arguments.package_path or [],
            lock=lock,
            cover=arguments.cover,
            base=arguments.base,
            srdf=arguments.srdf,
            posture=arguments.posture,
            progress=lambda what, share: bar.update(
                task, completed=round(100.0 * share), description=what
            ),
        )
    for line in report.lines():
        print(printable(line))
    print()
    for name in (IMPORT_FILE, "robot.yaml", "robot.urdf", "picture.png", "report.txt"):
        print(out / name)
    print(f"\nnext: look at {out / 'picture.png'}, then {_what_next(out)}")


def _what_next(folder: Path) -> str:
    """A command that moves the robot, or how what no motion can move is moved."""
    from crar_drake.resources import imported_robots_folder
    from crar_drake.robot.description import load_robot_description
    from crar_drake.robot.task import EXPERIMENTS

    description = load_robot_description(folder)
    frames = description.task_frames
    if not {*EXPERIMENTS["upper-body"], "waist"} <= set(frames):
        points = ", ".join(frames) or "frames of its own"
        return (
            f"give its points ({points}) keyframes, as diagrams/obstacle_arm.yaml "
            "does, or targets in a diagram of yours (docs/guides/your-diagram.md)"
        )
    own = folder.parent == imported_robots_folder()
    robot = folder.name if own else folder
    if description.root != "fixed":
        legs = {"left_foot", "right_foot", "left_knee", "right_knee"}
        if not legs <= set(frames):
            return (
                "import it with --base fixed, for a floating base without legs is "
                "moved by nothing"
            )
        return f"crar-drake retarget dance --robot {robot} --out dance.csv"
    return f"crar-drake run --robot {robot} --motion dance --tasks upper-body"


def _groups_to_lock(arguments: argparse.Namespace) -> list[str] | None:
    """None where no option says it."""
    if arguments.whole_body:
        return []
    if arguments.lock is None:
        return None
    return [group.strip() for group in arguments.lock.split(",")]
