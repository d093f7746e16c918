"""The command line, in process: what it prints, writes, and refuses."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from small_logs import small_log
from small_urdfs import humanoid, humanoid_with_legs

import crar_drake.run
from crar_drake.commands import main, make_parser, options, parse
from crar_drake.errors import CrarError, ScenarioError
from crar_drake.resources import data_folder
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS
from crar_drake.simulation.scenario import parse_scenario, scenario_names

FILES = ["log.npz", "plot.png", "summary.json"]


@pytest.fixture(autouse=True)
def empty_folder(tmp_path, monkeypatch):
    """Each test runs in an empty folder, and without a user's cache."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# --- run --------------------------------------------------------------------------


def test_options_override_the_scenario(empty_folder, capsys):
    argv = "run diagrams/paper.yaml --tasks wrists --set controller.level=velocity "
    argv += "--set controller.constraints=none --duration 0.01 --motion reaching "
    argv += "--set plant_config.time_step=0.0005 --no-page"
    assert main(argv.split()) == 0
    # Without --out the folder says what was run.
    name = "paper_reaching_wrists_level-velocity_constraints-none_"
    out = empty_folder / "out/diagrams" / f"{name}plant_config.time_step-0.0005"
    assert names(out) == FILES
    scenario = parse_scenario(SimulationLog.load(out / "log.npz").scenario)
    assert (scenario.motion, scenario.experiment) == ("reaching", "wrists")
    assert scenario.controller.level == "velocity"
    assert scenario.controller.constraints == "none"
    assert (scenario.duration, scenario.plant_config.time_step) == (0.01, 5e-4)


def test_settings_are_taken_together_in_any_order(monkeypatch):
    settings = [
        "controller.constraints=paper",
        "controller.level=velocity",
        "plant_config.time_step=0.003",  # of which the period has to be a multiple
        "controller.period=0.006",
    ]
    taken = []

    def keep(scenario, *_, **__):
        taken.append(scenario)
        raise CrarError("not simulated")

    monkeypatch.setattr(crar_drake.run, "run_scenario", keep)
    for each in (settings, settings[::-1]):
        assert main(["run", *(word for s in each for word in ("--set", s))]) == 2
    assert taken[0].to_yaml() == taken[1].to_yaml()
    controller = taken[0].controller
    assert (controller.constraints, controller.level) == ("paper", "velocity")
    assert (controller.period, taken[0].plant_config.time_step) == (0.006, 0.003)


def test_run_follows_a_motion_and_a_skeleton_by_path(cmu, empty_folder, capsys):
    amc = empty_folder / "walk.amc"
    amc.write_bytes((cmu / "subjects/02/02_01.amc").read_bytes())
    skeleton = cmu / "subjects/02/02.asf"
    argv = ["run", "--motion", "./walk.amc", "--skeleton", str(skeleton)]
    assert main([*argv, "--duration", "0.01", "--no-page"]) == 0
    out = empty_folder / "out/dance_walk"
    assert json.loads((out / "summary.json").read_text())["motion"] == "./walk.amc"


# --- where it goes ----------------------------------------------------------------


@pytest.fixture
def where(monkeypatch):
    """Tells the folder of a command line, which does not run."""

    def tell(command: str) -> str:
        def keep(scenario, out, **options):
            folders.append(str(out))
            raise ScenarioError("it is not run")

        folders: list[str] = []
        monkeypatch.setattr(crar_drake.run, "run_scenario", keep)
        assert main(command.split()) == 2
        return folders[0]

    return tell


@pytest.mark.parametrize(
    "command, folder",
    [
        ("run", "out/dance"),
        ("run diagrams/paper.yaml", "out/diagrams/paper"),
        (
            "run dance_wrists --set controller.constraints=none",
            "out/dance_wrists_constraints-none",
        ),
        (
            "run --set controller.effort_limits=true",
            "out/dance_effort_limits-true",
        ),
        (
            "run --set simulated_robot.effort_limits=true",
            "out/dance_simulated_robot.effort_limits-true",
        ),
        ("run --motion cmu:05_02 --tasks wrists", "out/dance_05_02_wrists"),
        ("run --motion ./a/../b/walk.amc", "out/b/dance_walk"),
        ("run a/mine.yaml --robot upper_body", "out/a/mine_upper_body"),
        ("run mine.yaml --set controller.period=5e-3", "out/mine_period-5e-3"),
    ],
)
def test_the_folder_says_what_was_run(command, folder, where, empty_folder):
    Path("a").mkdir()
    for name in ("mine.yaml", "a/mine.yaml"):
        Path(name).write_text("motion: dance\nexperiment: wrists\n")
    assert where(command) == folder


def test_motions_of_one_name_have_folders_of_their_own(
    where, empty_folder, tmp_path_factory
):
    first, second = tmp_path_factory.mktemp("x"), tmp_path_factory.mktemp("y")
    for folder in (first, second):
        (folder / "mocap").mkdir()
    commands = [f"run --motion {f / 'mocap/walk.amc'}" for f in (first, second)]
    folders = [where(command) for command in commands]
    for folder in folders:
        assert re.fullmatch(r"out/mocap-[0-9a-f]{6}/dance_walk", folder)
    assert folders[0] != folders[1]
    assert [where(command) for command in commands] == folders
    # The same file by another path is the same motion.
    (empty_folder / "link").symlink_to(first / "mocap")
    assert where("run --motion link/walk.amc") == folders[0]


# --- what cannot be written -------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        "run --out {}",
        "show log.npz --out {}/x.html",
        "show log.npz log.npz --out {}/x.html",
        "show dance --out {}/x.png",
    ],
)
@pytest.mark.parametrize("place", ["file/below", "locked"])
def test_impossible_places_are_refused_before_the_work(
    command, place, empty_folder, monkeypatch, refused
):
    small_log().save("log.npz")
    Path("file").write_text("")
    Path("locked").mkdir(mode=0o555)
    if place == "locked" and os.geteuid() == 0:  # who may write there
        place = "/proc/self"
    # What is imported later would keep what is replaced here.
    for module in ("motion.picture", "play.session"):
        importlib.import_module(f"crar_drake.{module}")
    for name in (
        "crar_drake.run.run_scenario",
        "crar_drake.results.playback.record_logs",
        "crar_drake.motion.report.inspect",
    ):
        if name.endswith("run_scenario") and command.startswith("run "):
            continue  # it looks itself, first of all
        monkeypatch.setattr(name, lambda *a, **k: pytest.fail("too late"))
    message = refused(*command.format(place).split())
    assert "name another folder" in message
    assert names(empty_folder) == ["file", "locked", "log.npz"]


def test_pictures_of_no_known_format_are_refused(empty_folder, refused):
    message = refused(*"show dance --out x.xyz".split())
    assert "x.xyz" in message and ".png" in message and ".pdf" in message
    message = refused(*"show dance --out picture".split())
    assert "picture: there is no suffix" in message
    assert names(empty_folder) == []


def test_the_users_backend_plays_no_part(empty_folder):
    environment = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    result = subprocess.run(
        [sys.executable, "-m", "crar_drake", "show", "dance", "--out", "x.png"],
        env={**environment, "MPLBACKEND": "TkAgg"},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert (result.returncode, result.stderr) == (0, "")
    assert matplotlib.image.imread("x.png").shape[0] > 500


def test_output_that_nobody_can_take_is_no_traceback():
    with open("/dev/full", "w") as full:
        result = subprocess.run(
            [sys.executable, "-m", "crar_drake", "show"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=600,
        )
    assert result.returncode == 2
    assert result.stderr == "crar-drake: error: No space left on device\n"


# --- what is no log ---------------------------------------------------------------


@pytest.mark.parametrize("command", ["show", "judge"])
@pytest.mark.parametrize(
    "name, told",
    [
        (".", "log.npz"),
        ("picture.png", "picture.png: "),
        ("pickled.npz", "holds objects, which are not"),
        ("shapes.npz", "array 'q' is of shape (2,)"),
    ],
)
def test_what_is_no_log_is_refused(command, name, told, empty_folder, refused):
    matplotlib.image.imsave("picture.png", np.zeros((9, 9)))
    arrays = vars(small_log())
    np.savez("pickled.npz", **{**arrays, "q": np.array([print], dtype=object)})
    np.savez("shapes.npz", **{**arrays, "q": np.zeros(2)})
    message = refused(command, name)
    assert told in message
    assert "pickle" not in message.lower().replace(f"{name}:", "")
    asked = command == "judge" and name != "."  # whether it is a motion instead
    assert ("nor is it a reference motion" in message) == asked


def test_judging_a_log_of_another_model_is_refused(empty_folder, refused):
    small_log().save("log.npz")
    assert "was made with another model" in refused("judge", "log.npz")


@pytest.fixture(scope="module")
def lookahead_log(tmp_path_factory) -> SimulationLog:
    """Of a control period of 5 ms, every millisecond of it."""
    folder = tmp_path_factory.mktemp("lookahead")
    (folder / "mine.yaml").write_text(
        "motion: boxing\nexperiment: wrists\nduration: 0.1\nlog_period: 0.001\n"
        "controller: {period: 0.005}\n"
    )
    arguments = ["run", str(folder / "mine.yaml"), "--no-page"]
    assert main([*arguments, "--out", str(folder / "it")]) == 0
    return SimulationLog.load(folder / "it/log.npz")


def judged(log: SimulationLog, capsys, *options: str) -> tuple[int, str]:
    """Exit code and lines of `crar-drake judge`."""
    log.save("log.npz")
    code = main(["judge", "log.npz", *options])
    return code, capsys.readouterr().out


def test_judging_a_certificate_that_is_true(lookahead_log, empty_folder, capsys):
    code, told = judged(lookahead_log, capsys)
    assert code == 0
    assert "braking paths, 21 of 21 control steps: 0 in penetration" in told
    assert "braking paths, 80 of 80 samples between control steps: 0 in" in told
    least = np.nanmin(lookahead_log.admission[:, 2])
    assert (
        "certificate: 21 of 21 control steps with a clear braking path, distances of "
        f"at least {1e3 * least:.1f} mm: nothing refutes it\n"
    ) in told
    code, told = judged(lookahead_log, capsys, "--paths-every", "30")
    assert code == 0 and "21 of 21 control steps" in told  # the nearest 100
    assert "3 of 80 samples between control steps" in told


def test_judging_a_certificate_that_claims_too_much(
    lookahead_log, empty_folder, capsys
):
    """Though one step alone does, and nothing is near there."""
    admission = lookahead_log.admission.copy()
    admission[50:55, 2] = 5.0
    code, told = judged(replace(lookahead_log, admission=admission), capsys)
    assert code == 1 and "distances of at least" in told and "NOT TRUE" in told
    assert "1 braking path nearer than said: worst " in told
    assert "of the path at 0.055 s, where at least 5000.000 mm were claimed" in told


def test_judging_what_a_certificate_says_of_another_motion(
    lookahead_log, empty_folder, capsys
):
    """Much faster, braking paths lead anywhere, though no position is touched."""
    v = np.random.default_rng(0).uniform(-100.0, 100.0, lookahead_log.v.shape)
    fast = replace(lookahead_log, v=v)
    code, told = judged(fast, capsys)
    assert code == 1 and "NOT TRUE" in told
    assert "said to be clear, but not: worst -" in told
    assert " 0 that end beyond a joint limit" not in told.splitlines()[1]
    # Of states without a certificate only what they violate is told.
    silent = np.full_like(fast.admission, np.nan)
    code, told = judged(replace(fast, admission=silent), capsys)
    assert code == 1 and "braking paths" not in told and "certificate" not in told
    assert "samples beyond a speed limit" in told.splitlines()[-1]


def test_judging_counts_who_is_too_fast(empty_folder, capsys):
    """In a motion from rest every sample but the first ones; none without limits."""
    told = {}
    shutil.copytree(data_folder("models") / "upper_body", "robot")
    described = Path("robot/robot.yaml").read_text()
    joints = ControlModel.FromDescription(load_robot_description("robot"), [])
    Path("mine.yaml").write_text(
        "robot: robot\nmotion: dance\nexperiment: wrists\nduration: 0.05\n"
        "controller: {constraints: paper}\n"
    )
    for limit, code in (("1e-9", 1), (".inf", 0)):
        limits = [f"{name}: {limit}" for name in joints.joint_names]
        Path("robot/robot.yaml").write_text(
            f"{described}\nvelocity_limits: {{{', '.join(limits)}}}\n"
        )
        assert main(["run", "mine.yaml", "--no-page", "--out", "it"]) == code
        run = capsys.readouterr().out.splitlines()
        assert main(["judge", "it/log.npz"]) == code
        judged = capsys.readouterr().out
        assert run[-1] == judged.splitlines()[-1]
        told[limit] = " ".join(judged.split())
    log = SimulationLog.load("it/log.npz")
    columns = [log.position_names.tolist().index(name) for name in log.controlled_names]
    fast = (np.abs(log.v[:, columns]) > 1e-6).any(axis=1).sum()
    assert 0 < fast < len(log.time)
    assert f"{fast} beyond a speed limit, smallest distance" in told["1e-9"]
    assert told["1e-9"].endswith(f" VIOLATED: {fast} samples beyond a speed limit")
    assert "beyond a joint limit, smallest distance" in told[".inf"]
    assert told[".inf"].endswith(" OK")


def test_without_a_command_help_is_printed(capsys):
    assert main([]) == 0
    told = capsys.readouterr().out
    assert told.startswith("usage: crar-drake") and "\n    import-robot" in told


# --- what is refused --------------------------------------------------------------


@pytest.mark.parametrize(
    "command, expected",
    [
        ("run --lev velocity", "unknown option --lev; known are"),
        ("clean cmu:05_02 --robot g1_no --out x.csv", "no robot 'g1_no'"),
        ("clean x.csv --robot g1 --rate 30", "--rate; did you mean '--frame-rate'?"),
        ("run dance_wrists boxing_wrists", "unexpected argument 'boxing_wrists'"),
        ("run --set duration", "--set duration: write KEY=VALUE"),
        ("run --set duration=[", "--set duration=[: no such key, or no value"),
        ("run --set motion.x=1", "--set motion.x=1: no such key"),
        ("run --set duration=long", "duration: expected a number, found the text"),
        ("run --set controller.margn=1", "did you mean 'margin'?"),
        ("run --set controller.constraints=x", "it may be none, paper, lookahead"),
        ("run --set controller.level=velocity", "it belongs to constraints: paper"),
        ("run --duration nan", "--duration: 'nan' is not a positive number"),
        ("run --motion nowhere/05_02.amc", "nowhere/05_02.amc: there is no such"),
        ("run --motion cmu:99_99", "99.asf from http://mocap.cs.cmu.edu"),
        ("run obstacle_arm --skeleton x.asf", "--skeleton: obstacle_arm follows"),
        ("run obstacle_arm --tasks wrists", "obstacle_arm has tasks of its own"),
        ("run --skeleton x.asf", "'dance' has its own skeleton"),
        ("run obstacle_arm --frame-rate 60", "frame_rate: keyframes have times"),
        ("show dance --frame-rate fast", "'fast' is not a positive number"),
        ("show nowhere.npz there.npz", "nowhere.npz: there is no such log"),
        ("show a.npz b.npz --label x", "--label: given 1 times for 2 files"),
        ("show --robot g1", "--robot is of a robot's motion or a log or several logs"),
        (
            "show dance --clip x",
            "dance: --clip is of several motions of a robot or a person beside a "
            "robot, not of a person's motion",
        ),
        ("show a.npz b.npz --clip x", "a person beside a robot, not of several logs"),
    ],
)
def test_mistakes_are_refused(command, expected, empty_folder, refused):
    assert expected in refused(*command.split())


@pytest.mark.parametrize(
    "argv, option",
    [
        (["judge", ""], "FILE"),
        (["clean", "", "--robot", "g1"], "PATH"),
        (["retarget", "", "--robot", "g1"], "MOTION"),
        (["retarget", "dance", "--robot", "g1", "--out", ""], "--out"),
    ],
)
def test_nothing_is_not_the_working_directory(argv, option, empty_folder, refused):
    """A shell makes nothing of a variable that is not set."""
    said = refused(*argv)
    assert option in said and "it is empty" in said


# --- the other commands -----------------------------------------------------------


def test_list_names_everything(capsys, monkeypatch):
    monkeypatch.delenv("CRAR_MOCAP_PATH", raising=False)
    assert main(["show"]) == 0
    lines = capsys.readouterr().out.splitlines()
    titles = [line for line in lines if not line.startswith(" ")]
    assert [re.match(r"\w+", title)[0] for title in titles] == [
        "Robots",
        "Motions",
        "Scenarios",
    ]
    entries = dict(line.split(maxsplit=1) for line in lines if line.startswith(" "))
    assert entries["obstacle_arm"]
    assert {"dance", "exercise", "reaching", "boxing", "upper_body"} < set(entries)
    # A motion and a scenario are both called dance.
    assert re.fullmatch(r"\d+\.\d s at \d+ Hz", entries["reaching"])
    assert entries["dance_wrists"].startswith("The built-in dance, two wrists")
    # Nothing is imported in a user's empty cache.
    assert entries["g1"].endswith("first: crar-drake import-robot g1")
    assert "import-robot" not in entries["upper_body"]


def test_list_names_trials_that_are_at_hand(cmu, capsys):
    assert main(["show"]) == 0
    assert "  cmu:05_02" in capsys.readouterr().out


# --- importing a robot ------------------------------------------------------------


ARM = """<robot name="arm">
<link name="base"/>
<link name="tip"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><sphere radius="0.1"/></geometry></visual></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="tip"/>
<axis xyz="0 1 0"/></joint>
</robot>"""


def test_import_robot_lists_its_guesses_and_files(empty_folder, capsys):
    Path("arm.urdf").write_text(ARM)
    assert main(["import-robot", "arm.urdf", "--out", "arm"]) == 0
    out = capsys.readouterr().out
    assert "tip: 1, 100.0 %" in out and "guessed; correct it in import.yaml" in out
    *files, _, following = out.splitlines()[-7:]
    for line in files:
        assert Path(line).is_file()
    # It has no wrists to follow a dancer's.
    assert "next: look at arm/picture.png" in following and "keyframes" in following
    # The same again, of its folder: nothing is guessed any more.
    assert main(["import-robot", "arm"]) == 0
    assert "guessed" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "urdf, options",
    [(humanoid, []), (humanoid_with_legs, []), (humanoid_with_legs, ["--whole-body"])],
)
def test_what_an_import_says_comes_next_works(urdf, options, empty_folder, capsys):
    Path("small.urdf").write_text(urdf())
    assert main(["import-robot", "small.urdf", "--out", "mine", *options]) == 0
    following = capsys.readouterr().out.splitlines()[-1]
    command = following.partition(", then crar-drake ")[2].split()
    if options:
        assert command[:4] == ["retarget", "dance", "--robot", "mine"]
        assert main(command) in (0, 1) and Path("dance.csv").is_file()
        return
    assert command[:3] == ["run", "--robot", "mine"]
    assert main([*command, "--duration", "0.1", "--no-page"]) in (0, 1)
    assert "mine following dance" in capsys.readouterr().out


def test_motion_tells_and_plots(empty_folder, capsys):
    assert main(["show", "dance"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("dance: ") and "largest speeds: waist" in output
    assert output.splitlines()[-1] == "out/dance.png"
    assert matplotlib.image.imread("out/dance.png").shape[0] > 500
    assert main(["show", "dance", "--out", "a/b.pdf"]) == 0
    assert (empty_folder / "a/b.pdf").read_bytes().startswith(b"%PDF")


def trial_of_another_name(folder: Path, cmu: Path) -> Path:
    """A run of the database, of which nothing tells the rate."""
    folder = folder / "found"
    folder.mkdir()
    motion = folder / "somebody.amc"
    # Another checksum, so that it is no file that is known.
    text = (cmu / "subjects/127/127_23.amc").read_text()
    motion.write_text(text + "# edited\n")
    (folder / "somebody.asf").write_bytes((cmu / "subjects/127/127.asf").read_bytes())
    return motion


def test_motion_says_assumed_and_asks_about_the_rate(cmu, empty_folder, capsys):
    motion = str(trial_of_another_name(empty_folder, cmu))

    def lines(*more: str) -> list[str]:
        assert main(["show", motion, "--out", "p.png", *more]) == 0
        return capsys.readouterr().out.splitlines()

    assumed = lines()
    assert "349 frames at 120 Hz, assumed, 2.90 s" in assumed[0]
    assert any("--frame-rate HZ" in line for line in assumed)
    assert not any("--frame-rate 120" in line for line in assumed)
    given = lines("--frame-rate", "240")
    assert "349 frames at 240 Hz, 1.45 s" in given[0]
    assert any("is the rate 120 Hz? --frame-rate 120" in line for line in given)


def test_run_says_assumed_and_repeats_what_the_report_finds(cmu, empty_folder, capsys):
    motion = str(trial_of_another_name(empty_folder, cmu))
    argv = ["run", "--motion", motion, "--duration", "0.01", "--no-page"]

    def run(*more: str) -> tuple[str, dict]:
        assert main([*argv, "--out", "it", *more]) == 0
        summary = json.loads((empty_folder / "it/summary.json").read_text())
        return capsys.readouterr().out, summary

    printed, summary = run()
    assert re.search(r"frame rate +│ +120 Hz, assumed", printed)
    assert summary["frame_rate_source"] == "assumed"
    assert not any("m/s" in line for line in summary["motion_findings"])
    printed, summary = run("--frame-rate", "240", "--verbose")
    assert (
        re.search(r"frame rate +│ +240 Hz ", printed) and "Hz, assumed" not in printed
    )
    assert (summary["frame_rate"], summary["frame_rate_source"]) == (240.0, "given")
    (line,) = [x for x in printed.splitlines() if x.startswith("warning: motion: ")]
    assert "is the rate 120 Hz? --frame-rate 120" in line
    assert line.endswith(f"see crar-drake show {motion} --frame-rate 240")
    log = SimulationLog.load(empty_folder / "it/log.npz")
    assert parse_scenario(log.scenario).frame_rate == 240.0


def test_another_motion_does_not_take_the_scenarios_rate(empty_folder, capsys):
    (empty_folder / "mine.yaml").write_text(
        "motion: dance\nexperiment: wrists\nduration: 0.01\nframe_rate: 50\n"
    )
    for more, rate in (([], 50.0), (["--motion", "reaching"], 60.0)):
        argv = ["run", "mine.yaml", "--no-page", "--out", "it", *more]
        assert main(argv) == 0
        summary = json.loads((empty_folder / "it/summary.json").read_text())
        assert summary["frame_rate"] == rate


# Each command with the arguments that it cannot do without.
COMMANDS = {
    "run": [],
    "play": [],
    "show": [],
    "import-robot": ["g1"],
    "retarget": ["dance", "--robot", "g1"],
    "judge": ["log.npz"],
    "clean": ["dance.csv", "--robot", "g1"],
    "convert": ["a.csv", "b.csv"],
    "serve": [],
}


def test_help_offers_what_there_is():
    assert options.EXPERIMENTS == tuple(EXPERIMENTS)
    assert options.DEFAULT_SCENARIO in scenario_names()


def waits_for_none_of(script: str, *slow: str) -> str:
    """What a script prints in a process of its own, that imports none of these."""
    script += f"import sys\nprint({set(slow)} & set(sys.modules), file=sys.stderr)\n"
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=600
    )
    assert result.stderr == "set()\n"
    return result.stdout


def test_help_waits_for_nothing_that_takes_long():
    script = (
        "from crar_drake.commands import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
    )
    slow = "pydrake", "scipy", "numpy", "matplotlib", "rich"
    assert waits_for_none_of(script, *slow).startswith("usage: crar-drake")


def test_a_first_clip_waits_for_no_library_that_it_does_not_use():
    script = (
        "import numpy as np\n"
        "import crar_drake.references.clean_file\n"
        "import crar_drake.references.retarget_file\n"
        "from crar_drake.motion.conditioning import low_pass\n"
        "low_pass(np.zeros((9, 3)), 30.0)\n"
    )
    of_scipy = "scipy.signal", "scipy.stats", "scipy.ndimage"
    waits_for_none_of(script, *of_scipy, "trimesh", "matplotlib", "ezc3d")


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_says_what_it_does(command, capsys):
    """No option and no argument is left without words, or with a default only."""
    with pytest.raises(SystemExit) as exit:
        main([command, "--help"])
    assert exit.value.code == 0
    usage = capsys.readouterr().out
    parser = parse(make_parser(), [command, *COMMANDS[command]]).parser
    for action in parser._actions:
        assert re.match(r"[a-z]\w* ", action.help), action.dest
        assert (action.option_strings or [action.metavar or action.dest])[-1] in usage


def test_the_commands_above_are_all_there_are(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    offered = re.findall(r"^    ([a-z][a-z-]+)\b", capsys.readouterr().out, re.M)
    assert offered == list(COMMANDS)


# --- Ctrl-C while modules are imported ----------------------------------------------

INTERRUPTED_IMPORT = """
import signal, sys
module = sys.argv.pop(1)

class CtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == module:
            sys.meta_path.remove(self)
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, CtrlC())
# A background job may ignore SIGINT, and so would its child.
signal.signal(signal.SIGINT, signal.default_int_handler)
from crar_drake.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("module", ["crar_drake.commands", "pydrake.geometry"])
def test_ctrl_c_during_an_import_leaves_no_traceback(module):
    """Drake's modules turn it into an ImportError."""
    process = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_IMPORT, module, "run", "nothing.yaml"],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert process.returncode == 130, process.stderr
    assert process.stderr.endswith("crar-drake: interrupted\n")
    assert "Traceback" not in process.stderr
