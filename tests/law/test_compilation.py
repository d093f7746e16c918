"""What one process compiles, the others find."""

import ast
import errno
import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numba
import numpy as np
import pytest

import crar_drake
from crar_drake.law import blending, compilation
from crar_drake.law.compilation import Program, Whole, compiled

# A function that calls others.
_CALL = """
import json
import numba
import numpy as np
import crar_drake
from crar_drake.law.blending import _inverse_left_jacobian as rate_of_turn
from crar_drake.law.vectors import cross, dot

turned = rate_of_turn(np.zeros(3), np.array([0.0, 1.0, 0.0]))
told = {
    "package": crar_drake.__file__,
    "turned": turned.tolist(),
    "hits": sum(rate_of_turn.stats.cache_hits.values()),
    "misses": sum(rate_of_turn.stats.cache_misses.values()),
    "parts": [len(each.part.overloads) for each in (cross, dot)],
    "called": [len(each.overloads) for each in (cross, dot)],
    "crossed": cross(turned, np.array([1.0, 0.0, 0.0])).tolist(),
}

@numba.njit
def twice(a):
    return rate_of_turn(a, a)

print(json.dumps(told | {"twice": twice(turned).tolist()}))
"""


def test_one_process_compiles_for_all(tmp_path):
    """Those that want the same at once wait for it, from whatever copy of the package.

    Neither what they call is compiled again, nor what that calls: these are parts.
    """
    copy = tmp_path / "copy"
    package = Path(crar_drake.__file__).parent
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(package, copy / "crar_drake", ignore=ignored)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    at_once = [
        subprocess.Popen(
            [sys.executable, "-c", _CALL],
            env=environment | {"PYTHONPATH": str(folder)},
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for folder in (package.parent, copy)
    ]
    told = []
    for process in at_once:
        out, err = process.communicate()
        assert process.returncode == 0, err
        told.append(json.loads(out))
    assert {Path(each["package"]).parent for each in told} == {
        package,
        copy / package.name,
    }
    first, later = sorted(told, key=lambda each: each["hits"])
    assert (first["hits"], first["misses"]) == (0, 1)
    assert (later["hits"], later["misses"]) == (1, 0)
    # Nothing is made machine code of that Python has not called.
    assert (first["parts"], first["called"]) == ([1, 1], [0, 0])
    assert (later["parts"], later["called"]) == ([0, 0], [0, 0])
    assert first["turned"] == later["turned"] == [0.0, 1.0, 0.0]
    assert first["crossed"] == later["crossed"] == [0.0, 0.0, -1.0]
    # A user's compiled function may call ours, too.
    assert first["twice"] == later["twice"] == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_while_machine_code_is_handed_over(tmp_path, monkeypatch, number):
    """It is not lost, nor is what it came in the middle of."""

    def asked(*_):
        raise KeyboardInterrupt(signal.Signals(number).name)

    def disturbed(self, code):
        if code is not None:
            signal.raise_signal(number)
        vars(self)["code"] = code

    code = property(lambda self: vars(self)["code"], disturbed)
    before = signal.signal(number, asked)
    monkeypatch.setattr(compilation, "cache_folder", lambda source: tmp_path)
    doubled = compiled(lambda a: 2.0 * a)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(Whole, "_compiled_object", code, raising=False)
            with pytest.raises(KeyboardInterrupt, match=signal.Signals(number).name):
                doubled(1.0)
        assert signal.getsignal(number) is asked
    finally:
        signal.signal(number, before)
    assert doubled(1.0) == 2.0


# The second one comes while no handler of Python can. In the background of a shell a
# process has none to begin with.
_TWICE = """
import itertools, os, signal, subprocess
from crar_drake.interrupts import undisturbed
signal.signal(signal.SIGINT, signal.default_int_handler)
with undisturbed('compiled'):
    signal.raise_signal(signal.SIGINT)
    print("waits", flush=True)
    subprocess.Popen(["kill", "-INT", str(os.getpid())])
    sum(itertools.repeat(0))
"""


def test_a_second_ctrl_c_ends_it_at_once():
    found = subprocess.run(
        [sys.executable, "-c", _TWICE], capture_output=True, text=True, timeout=100
    )
    assert found.returncode == -signal.SIGINT and found.stdout == "waits\n"
    assert "at once by Ctrl-C" in found.stderr


# Writing fails as on a disk that is full, or may not be written.
_NO_ROOM = """
import os, pathlib, tempfile

def refuse(*_, **__):
    raise OSError({code}, os.strerror({code}))

pathlib.Path.write_bytes = refuse
if {everything}:
    os.makedirs = os.mkdir = tempfile.mkstemp = tempfile.TemporaryFile = refuse
"""


def call(cache: Path, before: str = "") -> tuple[dict, str]:
    """What `_CALL` tells in a process of its own, and what that says on stderr."""
    done = subprocess.run(
        [sys.executable, "-c", before + _CALL],
        env=os.environ
        | {
            "NUMBA_CACHE_DIR": str(cache),
            "PYTHONPATH": str(Path(crar_drake.__file__).parents[1]),
        },
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.fixture(scope="module")
def warm(tmp_path_factory) -> Path:
    """A cache with what `_CALL` compiles."""
    folder = tmp_path_factory.mktemp("warm")
    assert call(folder)[0]["misses"] == 1
    return folder


def kept_files(cache: Path) -> list[Path]:
    return [place for place in cache.rglob("*") if place.is_file()]


def _flip(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "emptied": lambda content: b"",
    "cut": lambda content: content[: len(content) // 2],
    "a bit is wrong": _flip,
    "something else": lambda content: b"something else\n" * 100,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_damaged_is_compiled_again(warm, tmp_path, monkeypatch, caplog, damage):
    """And kept: the next one of the same function finds it."""
    cache = tmp_path / "cache"
    shutil.copytree(warm, cache)
    files = kept_files(cache)
    assert files
    for file in files:
        file.write_bytes(DAMAGES[damage](file.read_bytes()))
    (folder,) = cache.glob("blending-*")
    monkeypatch.setattr(compilation, "cache_folder", lambda source: folder)
    i, j = np.zeros(3), np.array([0.0, 1.0, 0.0])
    for hits in (0, 1):
        product = compiled(blending._inverse_left_jacobian.py_func)
        assert product(i, j).tolist() == [0.0, 1.0, 0.0]
        found = product.stats
        assert sum(found.cache_hits.values()) == hits
        assert sum(found.cache_misses.values()) == 1 - hits
    assert caplog.messages == []


def test_a_folder_in_the_place_of_a_file_is_said_and_no_more(warm, tmp_path):
    cache = tmp_path / "cache"
    shutil.copytree(warm, cache)
    for file in kept_files(cache):
        file.unlink()
        file.mkdir()
    told, said = call(cache)
    assert told["misses"] == 1 and told["turned"] == [0.0, 1.0, 0.0]
    assert said.count("cannot be kept") == 1


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS])
def test_what_cannot_be_kept_is_said_once_and_all_goes_on(tmp_path, code):
    before = _NO_ROOM.format(code=int(code), everything=code == errno.EROFS)
    told, said = call(tmp_path / "cache", before)
    assert told["misses"] == 1 and told["turned"] == [0.0, 1.0, 0.0]
    compiles, said = said.split("\n", 1)
    assert compiles == f"crar_drake: {compilation.COMPILING}"
    assert said.count("\n") == 1 and os.strerror(code) in said
    assert "NUMBA_CACHE_DIR names another folder" in said


def test_a_cache_that_is_read_only_is_read(warm):
    before = _NO_ROOM.format(code=int(errno.EROFS), everything=True)
    told, said = call(warm, before)
    assert (told["hits"], told["misses"], said) == (1, 0, "")


def test_what_is_compiled_is_found_by_all_sources_that_it_is_made_of():
    """Of whatever a compiled function names: others, records, constants."""
    package = Path(crar_drake.__file__).parent
    checked = 0
    for source in package.rglob("*.py"):
        if "@compiled" not in (text := source.read_text()):
            continue
        known = set(compilation.sources_of(source))
        room = importlib.import_module(
            ".".join(source.relative_to(package.parent).with_suffix("").parts)
        )
        whence = {
            alias.asname or alias.name: sys.modules[node.module].__file__
            for node in ast.parse(text).body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for made in vars(room).values():
            if isinstance(made, Program) and made.__module__ == room.__name__:
                used = set(made.py_func.__code__.co_names) & set(whence)
                inside = {Path(whence[x]) for x in used if "crar_drake" in whence[x]}
                assert inside <= known, (made, inside - known)
                checked += 1
    assert checked > 150


def test_another_source_means_another_folder(tmp_path, monkeypatch):
    """Of those that a file takes names from, however far away; others are nothing to
    it."""
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    room = tmp_path / "room"
    room.mkdir()
    (room / "a.py").write_text("from crar_drake.room.b import (\n    x,\n    y,\n)\n")
    (room / "b.py").write_text("from crar_drake.room import c\nx = y = c.x\n")
    (room / "c.py").write_text("x = 1\n")
    (room / "d.py").write_text("x = 1\n")

    def folder() -> Path:
        compilation._imported.cache_clear()
        return compilation.cache_folder.__wrapped__(room / "a.py")

    before = folder()
    (room / "d.py").write_text("x = 2\n")
    assert folder() == before
    (room / "c.py").write_text("x = 2\n")
    assert folder() != before


def test_compiling_is_told_with_how_far_it_is(monkeypatch, tmp_path):
    monkeypatch.setattr(compilation, "_REPORTED_EVERY", 0.0)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    compilation.cache_folder.cache_clear()
    told = []
    with compilation.when_compiling(told.append):
        assert numba.njit(lambda x: x)(1.0) == 1.0  # of another package
        assert told == []
        for function in (_once, _twice, _thrice):
            assert compilation.compiled(function)(1.0) > 0.0
    assert told[0] == compilation.COMPILING
    assert re.fullmatch(r"1 functions compiled in \d+ s", told[1])
    assert re.fullmatch(r"2 functions compiled in \d+ s", told[2])
    assert len(told) == 3
    compilation.cache_folder.cache_clear()


def test_blocks_that_are_told_may_end_in_any_order(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    compilation.cache_folder.cache_clear()
    first, second = [], []
    blocks = [compilation.when_compiling(each.append) for each in (first, second)]
    for block in blocks:
        block.__enter__()
    blocks[0].__exit__(None, None, None)
    compilation.compiled(_once)(1.0)
    blocks[1].__exit__(None, None, None)
    compilation.compiled(_twice)(1.0)
    assert (first, second) == ([], [compilation.COMPILING])
    compilation.cache_folder.cache_clear()


def _once(x):
    return x


def _twice(x):
    return 2.0 * x


def _thrice(x):
    return 3.0 * x


def test_a_library_says_once_on_stderr_that_it_compiles(tmp_path):
    program = (
        "import numpy as np; from crar_drake.law.vectors import cross, dot;"
        "print(dot(np.ones(3), np.ones(3)), *cross(np.ones(3), np.ones(3)))"
    )
    for told in (f"crar_drake: {compilation.COMPILING}\n", ""):
        ran = subprocess.run(
            [sys.executable, "-c", program],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert (ran.stdout, ran.stderr) == ("3.0 0.0 0.0 0.0\n", told)
