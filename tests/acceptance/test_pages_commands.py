"""Every command and every program of README and guides, as the pages have them now.

What a page adds is found by itself: a command that no rule of `product.PAGE_RULES`
covers fails, and so does a program that takes something for given that nobody has.
"""

import ast
import contextlib
import functools
import importlib.util
import io
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import product
import pytest
import yaml

README = product.ROOT / "README.md"
GUIDES = sorted((product.ROOT / "docs" / "guides").glob("*.md"))
OTHERS = ("python", "make", "pip", "source")  # commands that are not the product's
IS_COMMAND = re.compile(rf"(?:{product.PROGRAM}|{'|'.join(OTHERS)})\s")


@dataclass(frozen=True)
class Piece:
    """A piece of code in a page."""

    page: Path
    line: int
    language: str  # of a fence; "" of lines that are indented, "span" within a line
    text: str

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def pieces(page: Path) -> Iterator[Piece]:
    """All of a page, in their order; spans only if they look like commands."""
    prose, code, start, language = [], [], 0, None
    for number, line in enumerate([*page.read_text().splitlines(), ""], 1):
        fence = re.match(r"\s*```(\w*)$", line)
        indented = language is None and (line.startswith("    ") and line.strip())
        if fence and language is None:
            start, language = number, fence[1] or "plain"
        elif fence or (code and language is None and not indented):
            yield Piece(page, start, language or "", unindented(code))
            code, language = [], None
        elif language is not None or indented:
            start = start if code or language else number
            code.append(line)
        prose.append("" if language or indented or fence else line)
    text = "\n".join(prose)
    for span in re.finditer(r"`([^`]+)`", text):
        words = " ".join(span[1].split())
        if IS_COMMAND.match(words):
            line = text.count("\n", 0, span.start()) + 1
            yield Piece(page, line, "span", words)


def unindented(lines: list[str]) -> str:
    least = min(len(x) - len(x.lstrip()) for x in lines if x.strip())
    return "\n".join(line[least:] for line in lines) + "\n"


def kind(piece: Piece) -> str:
    """Of what a piece is."""
    if piece.language in ("python", "yaml"):
        return piece.language
    if IS_COMMAND.match(piece.text):
        return "commands"
    if piece.text.startswith("{"):
        return "message"
    if piece.language:  # a drawing, or what has no command
        return "drawing"
    try:
        ast.parse(piece.text)
    except SyntaxError:  # a formula
        return "drawing"
    return "output" if re.match(r"\w+\(\w+=.*\.\.\.", piece.text) else "python"


PIECES = [piece for page in (README, *GUIDES) for piece in pieces(page)]


def all_of(which: str) -> list[Piece]:
    return [piece for piece in PIECES if kind(piece) == which]


def test_the_pages_are_read():
    """All kinds are there, and each line that begins like a command is one."""
    assert {kind(piece) for piece in PIECES} >= {"commands", "python", "yaml"}
    assert len({piece.page for piece in all_of("commands")}) > len(GUIDES) / 2
    for page in (README, *GUIDES):
        known = "".join(c.text for c in all_of("commands") if c.page == page)
        for line in page.read_text().splitlines():
            if line.startswith(f"    {product.PROGRAM} "):
                assert line.strip() in known
    for piece in all_of("drawing"):
        assert not re.search(rf"^\s*{product.PROGRAM} ", piece.text, re.M), piece


# --- commands ---------------------------------------------------------------------


@dataclass(frozen=True)
class Command:
    """A command of a page, and what is said behind it."""

    piece: Piece
    text: str
    remark: str

    def __str__(self) -> str:
        return f"{self.piece.page.stem}: {self.text}"


def commands() -> Iterator[Command]:
    for piece in all_of("commands"):
        for line in piece.text.splitlines():
            line, _, remark = line.partition(" #")
            for text in line.removesuffix("&").split("&&"):
                yield Command(piece, " ".join(text.split()), remark.strip())


# Each once, where it is first.
EVERY = list({each.text: each for each in reversed([*commands()])}.values())[::-1]
OURS = [each for each in EVERY if each.text.startswith(f"{product.PROGRAM} ")]
THEIRS = [each for each in EVERY if each not in OURS]


def rule(command: Command) -> product.Rule:
    """The first that fits."""
    for each in product.PAGE_RULES:
        if re.match(each.begins, command.text):
            return each
    pytest.fail(f"{command.piece}: no rule of PAGE_RULES covers {command.text!r}")


def is_name(command: Command) -> bool:
    """Whether a sentence names a command, without saying how to call it."""
    return command.piece.language == "span" and len(command.text.split()) == 2


@functools.cache
def names_of_tests() -> set[str]:
    folder = Path(__file__).parent
    text = "".join(path.read_text() for path in folder.glob("test_*.py"))
    return set(re.findall(r"^def (test_\w+)", text, re.M))


@pytest.mark.parametrize("command", OURS, ids=str)
def test_a_command_is_one(command: Command):
    """The product's parser takes it with all its options; a rule says who runs it."""
    words = shlex.split(command.text)[1:]
    if is_name(command) or words[0] == "COMMAND":
        assert words[0] == "COMMAND" or words[0] in product.COMMANDS.values()
        return
    assert product.parse_error(words) == "", command.piece
    where = rule(command).elsewhere
    assert not where.startswith("test_") or where in names_of_tests()


@pytest.mark.parametrize("name", product.COMMANDS.values())
def test_every_commands_help(name: str):
    done = product.run_command(name, "--help")
    assert done.code == product.FINE and "usage" in done.out and name in done.out


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """The folder of a short run."""
    out = tmp_path_factory.mktemp("log") / "it"
    done = product.command(
        "simulate", product.HANDS, duration=0.05, out=out, no_page=True
    )
    assert done.code == product.FINE, done.err
    return out


def stand_in(word: str, log: Path) -> str:
    """What stands for a word of a command, whose file is put there."""
    path = Path(word)
    if word in product.PAGE_WORDS:
        return product.PAGE_WORDS[word]
    if word.startswith("cmu:") or path.suffix in (".bvh", ".amc"):
        folder = os.environ.get(product.MOCAP) or pytest.skip("no recordings")
    if path.suffix == ".bvh":
        copy(Path(folder) / "subjects/131/131_01.bvh", path)
    elif path.suffix == ".yaml":
        scenario = dict(robot=product.BUILT_IN, motion=product.MOTION)
        path.write_text(product.scenario(**scenario, tasks=product.TASKS))
    elif path.suffix == ".csv" and not path.exists():
        copy(product.ROBOT_MOTION, path)
    elif path.name == product.RUN_FILES["log"]:
        copy(log / path.name, path)
    return word


def copy(file: Path, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(file, path)


@pytest.mark.parametrize(
    "command",
    [c for c in OURS if not is_name(c) and rule(c).more is not None],
    ids=str,
)
def test_a_command_works(
    command: Command,
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
):
    """With stand-ins for a user's files; it ends as the page says."""
    if product.HUMANOID in command.text:
        request.getfixturevalue("humanoid")
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command.text)[1:]
    if words[0] == product.COMMANDS["compare"]:
        for word in words[1:]:
            if word.startswith("out/"):
                shutil.copytree(log, word)
    words = [words[0], *(stand_in(word, log) for word in words[1:])]
    done = product.run_command(*words, *rule(command).more)
    codes = product.PAGE_CODES.items()
    code = next((code for said, code in codes if said in command.remark), product.FINE)
    assert done.code == code, done
    for name in re.findall(r"\b[\w/]+\.(?:html|png|npz|csv)\b", command.remark):
        if "--no-page" not in rule(command).more:
            assert list(tmp_path.glob(f"**/{Path(name).name}")), name


@pytest.mark.parametrize("command", THEIRS, ids=str)
def test_a_command_of_the_checkout(command: Command, tmp_path: Path):
    """Of make, pip and Python: targets, extras, files and options are there."""
    program, *words = shlex.split(command.text)
    assert program in OTHERS, command
    if program == "make":
        makefile = (product.ROOT / "Makefile").read_text()
        for word in words:
            name, is_variable, _ = word.partition("=")
            begin = rf"^{name} \?=" if is_variable else rf"^{name}:"
            assert re.search(begin, makefile, re.M), word
    elif program == "pip":
        project = tomllib.loads((product.ROOT / "pyproject.toml").read_text())
        known = project["project"]["optional-dependencies"]
        extras = re.search(r"\[(.*)\]", command.text)[1].split(",")
        assert words[0] == "install" and set(extras) <= set(known)
    elif program == "source":
        assert words == [".venv/bin/activate"]
    else:
        check_script(words, tmp_path, is_run=rule(command).more is not None)


def check_script(words: list[str], folder: Path, *, is_run: bool) -> None:
    """A file or a module is there, has the options, and works, if it is to be run."""
    module = words[0] == "-m"
    script = words[:2] if module else [product.ROOT / words[0]]
    if module:
        assert importlib.util.find_spec(words[1])
    else:
        assert script[0].is_file()
    options = [word for word in words if word.startswith("--")]
    if not (is_run or options):
        return
    asked = words[len(script) :] if is_run else ["--help"]
    environment = {**os.environ, "PYTHONPATH": str(product.ROOT)}
    done = subprocess.run(
        [sys.executable, *script, *asked],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    if not is_run:
        assert all(option in done.stdout for option in options)


# --- programs ---------------------------------------------------------------------


class Names(dict):
    """The names of a program; what it does not define is asked of `product.Given`."""

    def __init__(self, code: str, **more: object) -> None:
        super().__init__(more)
        self._given = product.Given(code)

    def __missing__(self, name: str) -> object:
        try:
            self[name] = getattr(self._given, name)
        except AttributeError:
            raise KeyError(name) from None
        return self[name]


def run_program(code: str, **more: object) -> str:
    """Runs a program with what it takes for given; what it printed."""
    for old, new in product.SNIPPET_TEXTS.items():
        code = code.replace(old, new)
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(code, Names(code, **more))
    return said.getvalue()


def is_client(piece: Piece) -> bool:
    return "socket." in piece.text


@pytest.mark.parametrize(
    "piece", [p for p in all_of("python") if not is_client(p)], ids=str
)
def test_a_program_runs(piece: Piece, tmp_path: Path, monkeypatch):
    """As it stands; what the page shows as its output is what it prints."""
    monkeypatch.chdir(tmp_path)
    said = run_program(piece.text)
    if piece.page == README:
        off = re.fullmatch(product.README_SAYS, said)
        # The wrists have risen: else they would be off by 100 mm.
        assert float(off[1]) < product.README_ERROR
    following = PIECES[PIECES.index(piece) + 1 :][:1]
    if following and kind(following[0]) == "output":
        shown = re.escape(following[0].text.strip()).replace(r"\.\.\.", ".*")
        assert re.fullmatch(shown, said.strip())


class TrackedEnough(Exception):
    """The person's hand was asked for often enough."""


@pytest.fixture(scope="module")
def served(tmp_path_factory) -> Iterator[int]:
    """The port of a server of the built-in robot."""
    words = product.words("serve", port=0)
    folder = tmp_path_factory.mktemp("served")
    with product.running(*words, cwd=folder) as (_, line):
        yield product.port_of(line)


@pytest.mark.parametrize(
    "piece", [p for p in all_of("python") if is_client(p)], ids=str
)
def test_a_client_runs(piece: Piece, served: int):
    """Against a server, while a hand rises by 5 cm; an answer has the page's keys."""
    places = iter([[0.0, 0.0, 0.001 * k] for k in range(50)])

    def tracked_hand() -> list[float]:
        try:
            return next(places)
        except StopIteration:
            raise TrackedEnough from None

    code = re.sub(r"(\"127\.0\.0\.1\", )\d+", rf"\g<1>{served}", piece.text)
    opened = []

    class Socket(socket.socket):
        def __init__(self, *kind: int) -> None:
            super().__init__(*kind)
            self.settimeout(300.0)
            opened.append(self)

    here = type("socket", (), vars(socket) | {"socket": Socket})
    with pytest.raises(TrackedEnough):
        run_program(code, tracked_hand=tracked_hand, socket=here)
    (client,) = opened
    answer = json.loads(client.recv(65536))
    client.close()
    shown = [message for each in all_of("message") for message in messages(each)]
    (command,) = (each for each in shown if product.ANSWER_HAS <= set(each))
    assert set(command) <= set(answer)


def messages(piece: Piece) -> list[dict]:
    return [json.loads(piece.text.replace("[...]", "[]"))]


@pytest.mark.parametrize("piece", all_of("message"), ids=str)
def test_a_message_is_json(piece: Piece):
    assert all(messages(piece))


@pytest.mark.parametrize("piece", all_of("yaml"), ids=str)
def test_yaml_has_known_keys(piece: Piece, tmp_path: Path):
    assert yaml.safe_load(piece.text)
    assert product.yaml_error(piece.text, tmp_path) == ""
