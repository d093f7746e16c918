"""The index of equations in docs/theory/equations.md is true and complete.

Run as a program, this file tells which of the index's functions run in control steps.
"""

import ast
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType
from typing import NamedTuple

import numpy as np
import pytest

from crar_drake.control.law import ControlLaw
from crar_drake.control.parameters import (
    CrarParameters,
    LookaheadParameters,
)
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

ROOT = Path(__file__).resolve().parent.parent
INDEX = ROOT / "docs" / "theory" / "equations.md"
HEADING = "# Index of equations"
STEP, ONCE, REFERENCE = "each step", "once", "reference form"


class Row(NamedTuple):
    equations: str
    function: str
    called: str
    test: str


def index_rows() -> list[Row]:
    """The table's rows under the heading, without the header."""
    text = INDEX.read_text(encoding="utf-8")
    _, found, section = text.partition(f"{HEADING}\n")
    assert found, f"{INDEX.name} has no heading {HEADING!r}"
    rows = []
    for line in section.splitlines():
        if line.startswith("|") and not line.startswith(("| Equation ", "|---")):
            cells = [cell.strip().strip("`") for cell in line.strip("|").split("|")]
            assert len(cells) == 4 and cells[2] in (STEP, ONCE, REFERENCE), line
            rows.append(Row(*cells))
    return rows


def equation_numbers(text: str) -> set[int]:
    """All n of "Eq. (n)" and of "Eqs. (a), (b)-(c)" in a text."""
    item = r"\(\d+\)(?:-\(\d+\))?"
    numbers: set[int] = set()
    for found in re.finditer(rf"Eqs?\. ({item}(?:(?:, | and |, and ){item})*)", text):
        for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", found[1]):
            numbers.update(range(int(first), int(last or first) + 1))
    return numbers


def own_numbers(letter: str, text: str) -> set[int]:
    """All n of "(Ln)" and of "(La)-(Lb)" in a text, or of another letter."""
    numbers: set[int] = set()
    one = rf"\({letter}(\d+)\)"
    for first, last in re.findall(rf"{one}(?:-{one})?", text):
        numbers.update(range(int(first), int(last or first) + 1))
    return numbers


def labels(text: str) -> set[str]:
    """Of all kinds, for people: "Eq. (5)", "(L5)" and "(A5)"."""
    paper = {f"Eq. ({n})" for n in equation_numbers(text)}
    own = {f"({x}{n})" for x in "LA" for n in own_numbers(x, text)}
    return paper | own


def find_object(name: str) -> object:
    """What `robot.ControlModel.evaluate` or the like stands for in crar_drake, or
    `tests.reference_forms.collision_potential` here."""
    parts = name.split(".")
    if parts[0] == "tests":
        return getattr(importlib.import_module(parts[1]), parts[2])
    for split in range(len(parts) - 1, 0, -1):
        module = ".".join(["crar_drake", *parts[:split]])
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as error:
            # A module that is there but cannot be imported is another matter.
            if not module.startswith(error.name or ""):
                raise
            continue
        for attribute in parts[split:]:
            found = getattr(found, attribute)
        return found
    raise ModuleNotFoundError(name)


ROWS = index_rows()
PRODUCT = [row for row in ROWS if row.called != REFERENCE]


def label(row: Row) -> str:
    return f"{row.equations} {row.function.rpartition('.')[2]}"


def test_equation_numbers_are_read_from_every_form():
    assert equation_numbers("Eq. (11), upper part: 2 (x)") == {11}
    assert equation_numbers("Eqs. (4), (7)-(9) and (11): see (3)") == {4, 7, 8, 9, 11}
    assert equation_numbers("Eqs. (22), (24): f, and Eq. (3)") == {3, 22, 24}
    assert equation_numbers("(5), 6") == set()
    assert own_numbers("L", "r of (L7), and (L2), (L3)-(L5): (A6)") == {7, 2, 3, 4, 5}
    assert labels("Eq. (5), and (L6)-(L7), (A6)") == {"Eq. (5)", "(L6)", "(L7)", "(A6)"}


def test_every_equation_of_the_paper_is_listed():
    listed = set().union(*(equation_numbers(row.equations) for row in ROWS))
    assert listed == set(range(2, 36))


def test_every_equation_of_the_lookahead_is_listed():
    text = (ROOT / "docs" / "theory" / "theorem.md").read_text(encoding="utf-8")
    # Where an equation is set apart, its number ends the line.
    printed = set(re.findall(r"  \(L(\d+)\)$", text, flags=re.MULTILINE))
    listed = set().union(*(own_numbers("L", row.equations) for row in ROWS))
    assert listed == {int(n) for n in printed} == set(range(1, 15))


def test_every_equation_of_the_admission_is_listed():
    path = ROOT / "crar_drake" / "equations" / "admission.py"
    named = own_numbers("A", path.read_text(encoding="utf-8"))
    listed = set().union(*(own_numbers("A", row.equations) for row in ROWS))
    assert listed == named == set(range(1, 7))


def test_every_function_that_opens_with_an_equation_is_listed():
    listed = {row.function for row in ROWS}
    missing = []
    for path in (ROOT / "crar_drake" / "equations").glob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                docstring = ast.get_docstring(node) or ""
                name = f"equations.{path.stem}.{node.name}"
                if re.match(r"Eqs?\. |\([LA]\d", docstring) and name not in listed:
                    missing.append(name)
    assert not missing


def test_the_equations_with_nothing_but_reference_forms_are_named():
    # A range belongs to a function that calls those which compute its equations.
    single = [row.equations for row in PRODUCT if ")-(" not in row.equations]
    computed = set().union(*map(equation_numbers, single))
    text = " ".join(INDEX.read_text(encoding="utf-8").split())
    named = re.search(r"have reference forms only: (.*?\))\. ", text)
    assert named and equation_numbers(named[1]) == set(range(2, 36)) - computed


@pytest.mark.parametrize("row", ROWS, ids=label)
def test_the_functions_docstring_opens_with_the_equation(row):
    docstring = inspect.getdoc(find_object(row.function))
    assert docstring, f"{row.function} has no docstring"
    first_line = docstring.splitlines()[0]
    missing = labels(row.equations) - labels(first_line)
    assert not missing, f"{row.function}: {first_line!r} lacks {sorted(missing)}"


@cache
def functions_of(path: str) -> set[str]:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", ROWS, ids=label)
def test_the_test_exists(row):
    path, _, name = row.test.partition("::")
    functions = functions_of(path)
    assert name.startswith("test_") and name in functions, row.test


def code_of(name: str) -> CodeType:
    """What runs when a function is called, or when an object of a class is made."""
    found = find_object(name)
    return (found.__post_init__ if inspect.isclass(found) else found).__code__


# What a step computes depends on the mode and on these choices.
MODES = [
    {"constraints": "none", "level": "velocity"},
    {"constraints": "none", "metric": "inertia"},
    {"constraints": "paper", "level": "velocity"},
    {
        "constraints": "paper",
        "metric": "inertia",
        "nominal_posture_gain": 20.0,
        "respect_effort_limits": True,
    },
    {
        "lookahead": LookaheadParameters(preview=0.0),
        "nominal_posture_gain": 20.0,
    },
    {},
]
TASKS = [
    Task(frame="left_wrist", kind="pose", orientation_weight=0.2),
    Task(frame="right_wrist", kind="orientation"),
]


def control_steps(model: ControlModel, law: ControlLaw) -> Iterator[None]:
    """Three control steps, on the way from the rest posture onto targets about it; and
    some so fast that their braking paths lead the arms into the body."""
    assert model.m < model.n  # so that there is a null space
    layout = model.layout
    q, v = model.rest_positions(), np.full(model.plant.num_velocities(), 0.1)
    state = model.evaluate(model.MakeWorkspace(), q, v)
    targets = layout.pack(state.R, state.p + 0.05)
    prescribed = np.concatenate([state.q_p, np.zeros(2 * model.n_p)])
    yield
    for _ in range(3):
        law.step(q, v, targets, prescribed, state.q)
        q = q + law.parameters.period * v
    for seed in (4, 19, 38):
        v = 15.0 * np.random.default_rng(seed).normal(size=len(v))
        law.reset()
        law.step(model.rest_positions(), v, targets, prescribed)


def watch_calls() -> dict[str, str]:
    """Per function of the index when it was called, watched by the interpreter."""
    called: dict[str, set[CodeType]] = {ONCE: set(), STEP: set()}
    when = ""

    def note(frame, event: str, _) -> None:
        if event == "call" and when:
            called[when].add(frame.f_code)

    sys.setprofile(note)
    for choices in MODES:
        when = ONCE
        description = load_robot_description("upper_body")
        model = ControlModel.FromDescription(description, TASKS)
        law = ControlLaw(model, CrarParameters(**choices))
        when = ""
        for _ in control_steps(model, law):
            when = STEP
    when = ""
    sys.setprofile(None)

    def first_of(code: CodeType) -> str:
        return next((w for w in (STEP, ONCE) if code in called[w]), REFERENCE)

    return {row.function: first_of(code_of(row.function)) for row in ROWS}


@pytest.fixture(scope="module")
def watched() -> dict[str, str]:
    """In a process of its own, where nothing is compiled: that cannot be watched."""
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    run = subprocess.run(
        [sys.executable, __file__], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.mark.parametrize("row", ROWS, ids=label)
def test_the_function_is_called_when_the_index_says(row, watched):
    assert watched[row.function] == row.called


@cache
def names_used_in_the_package() -> frozenset[str]:
    """Every name and attribute that its code mentions, other than to define it."""
    names = set()
    for path in (ROOT / "crar_drake").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names.add(getattr(node, "id", None) or getattr(node, "attr", None))
    return frozenset(names - {None})


@pytest.mark.parametrize(
    "row", [row for row in ROWS if row.called == REFERENCE], ids=label
)
def test_nothing_in_the_package_uses_a_reference_form(row):
    assert "damped_inverse" in names_used_in_the_package()
    assert row.function.rpartition(".")[2] not in names_used_in_the_package()


if __name__ == "__main__":
    print(json.dumps(watch_calls()))
