"""The index of equations in docs/equations.md is true and complete."""

import ast
import importlib
import inspect
import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parent.parent
INDEX = ROOT / "docs" / "equations.md"
HEADING = "# Index of equations"


class Row(NamedTuple):
    equations: str
    function: str
    test: str


def index_rows() -> list[Row]:
    """The table's rows under the heading, without the header."""
    text = INDEX.read_text(encoding="utf-8")
    _, found, section = text.partition(f"{HEADING}\n")
    assert found, f"{INDEX.name} has no heading {HEADING!r}"
    rows = []
    for line in section.splitlines():
        if line.startswith("| Eq") and not line.startswith("| Equation "):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            assert len(cells) == 3, line
            rows.append(Row(cells[0], cells[1].strip("`"), cells[2].strip("`")))
    return rows


def equation_numbers(text: str) -> set[int]:
    """All n of "Eq. (n)" and of "Eqs. (a), (b)-(c)" in a text."""
    item = r"\(\d+\)(?:-\(\d+\))?"
    numbers: set[int] = set()
    for found in re.finditer(rf"Eqs?\. ({item}(?:(?:, | and |, and ){item})*)", text):
        for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", found[1]):
            numbers.update(range(int(first), int(last or first) + 1))
    return numbers


def find_object(name: str) -> object:
    """What `robot.ControlModel.evaluate` or the like stands for in crar_drake."""
    parts = name.split(".")
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


def label(row: Row) -> str:
    return f"{row.equations} {row.function.rpartition('.')[2]}"


def test_equation_numbers_are_read_from_every_form():
    assert equation_numbers("Eq. (11), upper part: 2 (x)") == {11}
    assert equation_numbers("Eqs. (4), (7)-(9) and (11): see (3)") == {4, 7, 8, 9, 11}
    assert equation_numbers("Eqs. (22), (24): f, and Eq. (3)") == {3, 22, 24}
    assert equation_numbers("(5), 6") == set()


def test_every_equation_of_the_paper_is_listed():
    listed = set().union(*(equation_numbers(row.equations) for row in ROWS))
    assert listed == set(range(2, 36))


@pytest.mark.parametrize("row", ROWS, ids=label)
def test_the_functions_docstring_opens_with_the_equation(row):
    docstring = inspect.getdoc(find_object(row.function))
    assert docstring, f"{row.function} has no docstring"
    first_line = docstring.splitlines()[0]
    missing = equation_numbers(row.equations) - equation_numbers(first_line)
    assert not missing, f"{row.function}: {first_line!r} lacks {sorted(missing)}"


@pytest.mark.parametrize("row", ROWS, ids=label)
def test_the_test_exists(row):
    path, _, name = row.test.partition("::")
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert name.startswith("test_") and name in functions, row.test
