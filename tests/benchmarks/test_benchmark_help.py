"""Each benchmark says how it is used."""

import importlib
from pathlib import Path

import pytest

import benchmarks

ROOT = Path(benchmarks.__file__).parent
COMMANDS = sorted(
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
    for path in ROOT.rglob("*.py")
    if "Benchmark(" in path.read_text(encoding="utf-8") and path.name != "page.py"
)


@pytest.mark.parametrize("module", COMMANDS)
def test_it_tells_how_to_be_used(module, capsys):
    with pytest.raises(SystemExit) as ended:
        importlib.import_module(module).main(["--help"])
    assert ended.value.code == 0
    assert f"python -m {module.removesuffix('.__main__')}" in capsys.readouterr().out
