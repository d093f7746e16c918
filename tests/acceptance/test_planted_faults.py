"""Planted faults stand where they can be planted; `planted_faults.py` plants them."""

import json
from pathlib import Path

import pytest

_FOLDER = Path(__file__).parent
_FAULTS = json.loads((_FOLDER / "planted_faults.json").read_text())


@pytest.mark.parametrize("fault", _FAULTS, ids=lambda fault: fault["name"])
def test_the_text_that_a_fault_replaces_stands_once(fault):
    text = (_FOLDER.parents[1] / fault["file"]).read_text()
    assert text.count(fault["old"]) == 1
    assert (_FOLDER.parents[1] / fault["test"].split("::")[0]).is_file()
