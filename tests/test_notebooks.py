"""The notebooks of examples/ run from top to bottom, and are kept without outputs.

`CRAR_NOTEBOOK_SECONDS` is how much each of them simulates here, two seconds by default;
`make docs` runs them as they are.
"""

import ast
import importlib
import os
import re
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))

nbformat = pytest.importorskip("nbformat", reason="needs the extra: .[docs]")


def parameters(notebook):
    """The one cell whose values a test may change."""
    (cell,) = [c for c in notebook.cells if "parameters" in c.metadata.get("tags", ())]
    return cell


def printed(notebook) -> str:
    outputs = [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]
    return "".join(o.text for o in outputs if o.output_type == "stream")


def test_there_are_three():
    names = {path.stem for path in NOTEBOOKS}
    assert names == {"first_dance", "your_diagram", "your_robot"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_without_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert re.match(r"seconds = [\d.]+\b", parameters(notebook).source)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_it_imports_is_there(path):
    """It runs only where slow tests do."""
    notebook = nbformat.read(path, as_version=4)
    cells = [c.source for c in notebook.cells if c.cell_type == "code"]
    tree = ast.walk(ast.parse("\n".join(cells)))
    lines = [line for line in tree if isinstance(line, ast.ImportFrom)]
    ours = [line for line in lines if line.module.startswith("crar_drake")]
    assert ours
    for line in ours:
        for name in line.names:
            assert hasattr(importlib.import_module(line.module), name.name)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="needs the extra: .[docs]")
    pytest.importorskip("ipykernel", reason="needs the extra: .[docs]")
    if path.stem == "your_robot":
        pytest.importorskip("trimesh", reason="needs the extra: .[robots]")
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))  # nobody's settings
    notebook = nbformat.read(path, as_version=4)
    seconds = float(os.environ.get("CRAR_NOTEBOOK_SECONDS", "2.0"))
    parameters(notebook).source = f"seconds = {seconds}"
    client = nbclient.NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},  # where its files go
    )
    client.execute()
    text = printed(notebook)
    if path.stem == "first_dance":
        assert re.search(r"^lookahead +0 of \d+ samples in violation", text, re.M)
        assert (tmp_path / "first_dance.html").stat().st_size > 100_000
    elif path.stem == "your_diagram":
        assert "clear at every step: True" in text
        assert (tmp_path / "your_diagram.html").stat().st_size > 100_000
        assert "lookahead" in text.splitlines()[-1]  # what the mistake should have been
    else:
        assert re.search(r"^capsules: 0 of \d+ samples in violation", text, re.M)
        assert re.search(r"^triangles: 0 of \d+ samples penetrate", text, re.M)
        assert (tmp_path / "small_robot.html").stat().st_size > 100_000
