"""Mistakes of users: the message names the thing and the remedy; nothing is written."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import product
import pytest


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the command runs, and a user without a cache."""
    monkeypatch.setenv(product.CACHE, str(tmp_path / "cache"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def misspelt(name: str) -> str:
    """Without its last letter but one."""
    return name[:-2] + name[-1:]


def refused(words: list[str], *, says: tuple[str, ...]) -> str:
    """The message of a command that must be refused, and must have these words."""
    before = contents()
    done = product.run_command(*words)
    assert done.code == product.REFUSED, done
    # The first time a line before it may say that something is compiled.
    *_, message = done.err.splitlines()
    assert message.startswith(f"{product.PROGRAM}: ") and "Traceback" not in done.err
    assert done.out == "" and contents() == before, "something was written"
    for word in says:
        assert word in message, message
    return message


def contents() -> dict[str, int]:
    """All files below the working directory, and their sizes."""
    return {
        os.path.join(place, name): os.path.getsize(os.path.join(place, name))
        for place, _, names in os.walk(".")
        for name in names
    }


@dataclass(frozen=True)
class Mistake:
    """A command line, the files that it reads, and what the message must say."""

    words: list[str]
    says: tuple[str, ...]
    files: dict[str, str | bytes] = field(default_factory=dict)


def of_scenario(text: str | bytes, *says: str) -> Mistake:
    """A scenario's file with a mistake, which the message names by its file."""
    words = product.words("simulate", "mine.yaml")
    return Mistake(words, ("mine.yaml", *says), {"mine.yaml": text})


def of_simulation(*says: str, **options: object) -> Mistake:
    return Mistake(product.words("simulate", **options), says)


GOOD = dict(robot=product.BUILT_IN, motion=product.MOTION, tasks=product.TASKS)
OPTION = product.option("tasks", "simulate")
DURATION = product.option("duration", "simulate")
PERIOD, BRAKING = product.leaf("period"), product.leaf("braking_time")

ARM = """<robot name="arm">
<link name="base"/>
<link name="tip"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><sphere radius="0.1"/></geometry></visual></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="tip"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


def of_urdf(old: str, new: str, *says: str) -> Mistake:
    """An import of a file with a mistake."""
    assert old in ARM
    words = product.words("import", "arm.urdf", out="arm")
    return Mistake(words, ("arm.urdf", *says), {"arm.urdf": ARM.replace(old, new)})


def of_start(text: str, *says: str) -> Mistake:
    """Where a served robot is to begin."""
    words = product.words("serve", port=0, start="start.json")
    return Mistake(words, says, {"start.json": text})


MISTAKES = {
    # --- of the command line
    "a command": Mistake(
        [misspelt(product.COMMANDS["judge"])], (repr(product.COMMANDS["judge"]),)
    ),
    "an option": Mistake(
        [product.COMMANDS["simulate"], misspelt(OPTION), product.TASKS],
        (misspelt(OPTION), f"mean '{OPTION}'"),
    ),
    "a choice": of_simulation(
        OPTION, f"mean '{product.TASKS}'", tasks=misspelt(product.TASKS)
    ),
    "a scenario": Mistake(
        product.words("simulate", misspelt(product.HANDS)),
        (misspelt(product.HANDS), f"mean '{product.HANDS}'"),
    ),
    "a robot": of_simulation(
        misspelt(product.BUILT_IN),
        f"mean '{product.BUILT_IN}'",
        robot=misspelt(product.BUILT_IN),
    ),
    "a motion": of_simulation(
        misspelt(product.MOTION),
        f"mean '{product.MOTION}'",
        motion=misspelt(product.MOTION),
    ),
    "a robot that is not imported": of_simulation(
        f"{product.COMMANDS['import']} {product.HUMANOID}", robot=product.HUMANOID
    ),
    "a duration below 0": of_simulation(DURATION, "-1", duration=-1),
    "a duration in words": of_simulation(DURATION, "long", duration="long"),
    "a duration of years": of_simulation("days", "at most", duration=1e9),
    "a port": Mistake(product.words("serve", port=99999), ("--port", "99999", "65535")),
    "a host": Mistake(
        product.words("play", host="999.1.1.1", no_browser=True),
        ("--host", "999.1.1.1", "127.0.0.1"),
    ),
    "a motion for a robot with keyframes": Mistake(
        product.words("simulate", product.BY_A_POST, motion=product.MOTION),
        (product.option("motion"), product.BY_A_POST, "keyframes"),
    ),
    "a folder that is a file": Mistake(
        product.words("simulate", product.HANDS, out="file/below"),
        ("file", "another folder"),
        {"file": "x"},
    ),
    "a file that is not there": Mistake(
        product.words("motion", "nowhere.bvh"), ("nowhere.bvh", "check the path")
    ),
    "an option of another thing": Mistake(
        product.words("page", "dance", overlay=True), ("--overlay", "several logs")
    ),
    # --- of scenarios
    "an unknown key": of_scenario(
        product.scenario(**GOOD, period=0.001).replace(PERIOD, misspelt(PERIOD)),
        "line 4",
        f"mean '{PERIOD}'",
    ),
    "an unknown key three levels down": of_scenario(
        product.scenario(**GOOD, braking_time=0.1).replace(BRAKING, misspelt(BRAKING)),
        "line 4",
        f"mean '{BRAKING}'",
    ),
    "text for a number": of_scenario(
        product.scenario(**GOOD, duration="long"), "line 4", "number", "'long'"
    ),
    "a key twice": of_scenario(
        product.scenario(**GOOD) + product.scenario(motion=product.OTHER_MOTION),
        product.leaf("motion"),
        "lines 2 and 4",
    ),
    "no YAML": of_scenario(product.scenario(**GOOD) + "a: {b: \n", "line 5"),
    "no UTF-8": of_scenario(
        product.scenario(**GOOD).encode() + b"a: caf\xe9\n", "line 4", "UTF-8"
    ),
    "an empty file": of_scenario("", "empty"),
    "a period below 0": of_scenario(
        product.scenario(**GOOD, period=-0.001), PERIOD, "-0.001", "positive"
    ),
    "a period at which gains diverge": of_scenario(
        product.scenario(**GOOD, period=0.5), PERIOD, "0.5", "below"
    ),
    # --- of robots' files
    "limits that are reversed": of_urdf('lower="-1"', 'lower="2"', "turn", "above"),
    "a mesh that is missing": of_urdf(
        '<sphere radius="0.1"/>', '<mesh filename="no.stl"/>', "no.stl", "tip"
    ),
    "tags that do not match": of_urdf("</robot>", "</root>", "line 8"),
    "no number": of_urdf('mass value="1"', 'mass value="much"', "tip", "much"),
    "no file of a robot": Mistake(
        product.words("import", "no.urdf", out="arm"), ("no.urdf",)
    ),
    # --- of what is served, and of logs
    "a start beyond a limit, in degrees": of_start(
        f'{{"{product.JOINT}": -45}}', product.JOINT, "-45", "limits"
    ),
    "a start of no such joint": of_start(
        f'{{"{misspelt(product.JOINT)}": 0}}', f"mean '{product.JOINT}'"
    ),
    "a start that is no JSON": of_start("{", "start.json"),
    "what is no log": Mistake(
        product.words("judge", "log.npz"), ("log.npz", "not a log"), {"log.npz": "t, q"}
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_refused(name: str, folder: Path):
    of = MISTAKES[name]
    for file, text in of.files.items():
        data = text if isinstance(text, bytes) else text.encode()
        (folder / file).write_bytes(data)
    refused(of.words, says=of.says)


@pytest.mark.parametrize("section", product.ROBOT_SECTIONS)
def test_a_name_in_a_robots_file_that_the_model_lacks(section: str, folder: Path):
    """In its pairs, its points, its rest posture."""
    for file in product.robot_folder(product.BUILT_IN).iterdir():
        if file.is_file():
            (folder / file.name).write_bytes(file.read_bytes())
    path = folder / product.ROBOT_FILE
    entry, name = product.ROBOT_SECTIONS[section]
    start, _, rest = path.read_text().partition(f"\n{section}:")
    assert entry in rest
    rest = rest.replace(entry, entry.replace(name, misspelt(name)), 1)
    path.write_text(f"{start}\n{section}:{rest}")
    (folder / "s.yaml").write_text(product.scenario(**GOOD | {"robot": "."}))
    refused(
        product.words("simulate", "s.yaml"),
        says=(misspelt(name), f"mean '{name}'"),
    )


# --- of recordings ----------------------------------------------------------------


@pytest.mark.parametrize(
    "motion, skeleton, says",
    [
        ("truncated_07_12.amc", "07.asf", ("truncated_07_12.amc:7352", "cut off")),
        (
            "wrong_bones_for_toy_skeleton.amc",
            "toy_skeleton.asf",
            ("toy_skeleton.asf:19", "lhipjoint", "remove"),
        ),
    ],
)
def test_a_recording_that_is_damaged(
    mocap: Path, motion: str, skeleton: str, says: tuple[str, ...]
):
    folder = mocap / "damaged"
    words = product.words("motion", folder / motion, skeleton=folder / skeleton)
    refused(words, says=says)


def test_a_skeleton_that_is_missing(mocap: Path, folder: Path):
    (folder / "05_02.amc").write_bytes((mocap / "subjects/05/05_02.amc").read_bytes())
    refused(
        product.words("motion", "05_02.amc"),
        says=("05_02.amc", "05.asf", "name the skeleton"),
    )


def test_numbers_of_a_recording(mocap: Path, folder: Path):
    """One that is none, a line that is cut, and a joint that nobody has."""
    lines = (mocap / "subjects/131/131_01.bvh").read_text().splitlines()
    first = next(i for i, x in enumerate(lines) if x.startswith("Frame Time")) + 1
    numbers = lines[first + 4].split()
    for name, row, word in (
        ("nan.bvh", [*numbers[:7], "nan", *numbers[8:]], "finite"),
        ("cut.bvh", numbers[:-1], f"{len(numbers) - 1} values"),
    ):
        text = [*lines[: first + 4], " ".join(row), *lines[first + 5 : first + 9]]
        (folder / name).write_text("\n".join(text) + "\n")
        says = (f"{name}:{first + 5}", word)
        refused(product.words("motion", name), says=says)
    point = product.MOTIONS_POINT
    (folder / "joints.yaml").write_text(f"{misspelt(point)}: LeftForeArm\n")
    words = product.words(
        "motion", mocap / "subjects/131/131_01.bvh", joints="joints.yaml"
    )
    refused(words, says=("joints.yaml", "line 1", f"mean '{point}'"))


# --- of a robot's motions -----------------------------------------------------------


def of_numbers(rows: np.ndarray) -> str:
    return "\n".join(",".join(f"{x:.6f}" for x in row) for row in rows) + "\n"


def with_nan(rows: np.ndarray) -> np.ndarray:
    rows[11, 9] = np.nan
    return rows


def in_degrees(rows: np.ndarray) -> np.ndarray:
    rows[:, 7:] = np.degrees(rows[:, 7:])
    return rows


@pytest.mark.parametrize(
    "change, says",
    [
        (with_nan, ("frame 12", "column 10", "nan")),
        (in_degrees, ("degrees", "frame", "_joint")),
        (lambda rows: rows[:, :-3], ("33 columns", "26 joints", "29 joints")),
    ],
)
def test_numbers_of_a_robots_motion(
    change: Callable, says: tuple[str, ...], humanoid: str, folder: Path
):
    rows = np.loadtxt(product.ROBOT_MOTION, delimiter=",")
    (folder / "motion.csv").write_text(of_numbers(change(rows)))
    words = product.words("clean", "motion.csv", robot=humanoid, out="clean.csv")
    refused(words, says=("motion.csv", *says))


def test_files_of_a_robots_motion(humanoid: str, folder: Path):
    """A line that is cut, a layout that is none, a certificate that is not there."""
    text = product.ROBOT_MOTION.read_text()
    (folder / "motion.csv").write_text(text)
    words = product.words("judge", "motion.csv", robot=humanoid, certificate=True)
    refused(words, says=(product.CERTIFICATE.format("motion"), "no certificate"))
    layout = misspelt(product.LAYOUT)
    words = product.words("convert", "motion.csv", "x.npz", to=layout, robot=humanoid)
    refused(words, says=(layout, f"mean '{product.LAYOUT}'"))
    *most, last = text.splitlines()
    cut = last.rpartition(",")[0]
    (folder / "motion.csv").write_text("\n".join([*most, cut]) + "\n")
    words = product.words("clean", "motion.csv", robot=humanoid, out="clean.csv")
    refused(words, says=("motion.csv", f"line {len(most) + 1}", "cut off"))


# --- of programs --------------------------------------------------------------------


def test_a_port_that_nothing_is_connected_to():
    wired = with_controller()
    ports = wired.ports()
    del ports[product.TARGETS]
    with pytest.raises(product.mistake(), match=f"{product.TARGETS}.*not connected"):
        product.simulate(wired, ports, 0.01)


def test_a_port_and_numbers_of_another_size():
    wired = with_controller()
    port, value = wired.ports()[product.TARGETS]
    # Drake's own words; ours is the name.
    with pytest.raises(RuntimeError, match=f"{product.TARGETS}.*{len(value)}"):
        product.simulate(wired, {product.TARGETS: (port, value[:-1])}, 0.01)


def with_controller(*points: str, finalized: bool = True, **more) -> product.Wired:
    """The built-in robot in a plant, and a controller of positions of points."""
    tasks = [("position", point) for point in points]
    wired = product.put_in_plant(finalized=finalized)
    return product.add_controller(wired, tasks, **more)


def joint_filter() -> product.JointFilter:
    return product.JointFilter(product.BUILT_IN, 0.01)


@pytest.mark.parametrize(
    "program, says",
    [
        (lambda: with_controller(finalized=False), "Finalize"),
        (product.add_the_robot_too_late, "before"),
        (
            lambda: with_controller(misspelt(product.POINT)),
            f"{misspelt(product.POINT)}.*mean '{product.POINT}'",
        ),
        (lambda: with_controller(*[product.POINT] * 2), f"{product.POINT}.*apart"),
        (lambda: with_controller(**{PERIOD: -1.0}), f"{PERIOD}.*-1.*positive"),
        (lambda: joint_filter().step(np.zeros(3)), r"\(3,\).*must be \(14,\)"),
        (
            lambda: joint_filter().step({misspelt(product.JOINT): 0.1}),
            f"{misspelt(product.JOINT)}.*mean '{product.JOINT}'",
        ),
        (
            lambda: product.load_robot(misspelt(product.BUILT_IN)),
            f"mean '{product.BUILT_IN}'",
        ),
    ],
)
def test_a_program_that_is_wrong(program: Callable[[], object], says: str):
    with pytest.raises(product.mistake(), match=says):
        program()
