"""The names of the product: every one that the acceptance suite uses stands here.

The suite judges what users see and outlives the inside of the package. Its tests speak
of concepts; this file says what the package calls them today. Renaming something
changes this file, and no test.
"""

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# --- commands -----------------------------------------------------------------------

PROGRAM = "crar-drake"
MODULE = "crar_drake"


@dataclass(frozen=True)
class Finished:
    """A command that has ended: its exit code and what it printed."""

    code: int
    out: str
    err: str


def run_command(*argv: object) -> Finished:
    """Runs the command line in this process; the exit code is as of the shell."""
    from crar_drake.commands import main

    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(word) for word in argv])
        except SystemExit as stopped:  # argparse
            code = stopped.code if isinstance(stopped.code, int) else 1
    return Finished(code or 0, out.getvalue(), err.getvalue())


def run_program(*argv: object, cwd: Path | None = None, **environment: str) -> Finished:
    """Runs the command line in a process of its own, as a shell does."""
    done = subprocess.run(
        [sys.executable, "-m", MODULE, *map(str, argv)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    return Finished(done.returncode, done.stdout, done.stderr)


def command(name: str, *what: object, **named: Any) -> Finished:
    """Runs a command in this process, by the neutral names of it and its options."""
    return run_command(*words(name, *what, **named))


def words(name: str, *what: object, **named: Any) -> list[str]:
    """The words of a command line, by neutral names."""
    return [COMMANDS[name], *map(str, what), *options(name, **named)]


def options(_command: str = "", /, **named: Any) -> list[str]:
    """The options of a command line, by neutral names; None and False are left out,
    and a list is an option for each."""
    words = []
    for name, value in named.items():
        for each in value if isinstance(value, list) else [value]:
            if each is None or each is False:
                continue
            words.append(option(name, _command))
            if each is not True:
                words.append(str(each))
    return words


def option(name: str, command: str = "") -> str:
    """An option by its neutral name, as it is typed."""
    general = OPTIONS.get(name, "--" + name.replace("_", "-"))
    return OPTIONS.get(f"{command} {name}", general)


# What is done to the command that does it.
COMMANDS = {
    "simulate": "run",
    "play": "play",
    "serve": "serve",
    "judge": "judge",
    "retarget": "retarget",
    "clean": "clean",
    "convert": "convert",
    "import": "import-robot",
    "catalogue": "list",
    "motion": "motion",  # what is in a person's or a robot's motion
    "page": "playback",  # of a log
    "compare": "compare",
}

# Neutral name to the option, where it is not --name; with the command before it, where
# the same thing is called differently.
OPTIONS: dict[str, str] = {
    "tasks": "--experiment",
    "simulate no_page": "--no-recording",
    "play out": "--save",
}

# Exit codes.
FINE, VIOLATED, REFUSED, INTERRUPTED = 0, 1, 2, 130

# Environment variables: the folder of CMU's motions, and that of users' caches.
MOCAP, CACHE = "CRAR_MOCAP_PATH", "XDG_CACHE_HOME"

# --- robots, models, scenarios, diagrams (section of SEEN) ----------------------------

ROOT = Path(__file__).resolve().parents[2]

# Robots that are shipped, and one that is imported by its name.
BUILT_IN, ARM, HUMANOID = "upper_body", "obstacle_arm", "g1_whole_body"
ROBOT_PACKAGE = "example-robot-data"  # has the humanoid's file

# --- law and filter (section of LAW) --------------------------------------------------

# --- tracking (section of TRACKING) ---------------------------------------------------

# --- whole motions, imports, certificates (section of MOTIONS) ------------------------
