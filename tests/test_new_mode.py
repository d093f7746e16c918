"""The page about constraint modes: the mode that it adds works."""

import re
from pathlib import Path

import numpy as np
import pytest

from crar_drake.control.law import ControlLaw
from crar_drake.control.modes import MODES
from crar_drake.control.parameters import CONSTRAINTS, CrarParameters
from crar_drake.errors import ScenarioError
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import Task

PAGE = Path(__file__).parent.parent / "docs" / "theory" / "modes.md"


@pytest.fixture
def with_the_pages_mode():
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S)
    before = dict(MODES)
    assert list(before) == CONSTRAINTS
    names = {}
    exec(code, names)
    yield names
    MODES.clear()
    MODES.update(before)
    CONSTRAINTS[:] = list(before)


def test_the_pages_mode_is_chosen_by_its_name(with_the_pages_mode):
    model = ControlModel.FromDescription(
        load_robot_description("obstacle_arm"), [Task(frame="tool")]
    )
    q = model.rest_positions()
    v = np.zeros(len(q))
    tasks = model.tasks_at(q)
    tasks[:3] += 0.5  # far away
    free, gentle = (
        ControlLaw(model, CrarParameters(constraints=mode, blend_time=0.0)).step(
            q, v, tasks
        )
        for mode in ("none", "gentle")
    )
    nominal = np.abs(free.acceleration).max()
    assert nominal > with_the_pages_mode["LARGEST"]
    np.testing.assert_array_equal(
        gentle.acceleration, np.clip(free.acceleration, -20.0, 20.0)
    )
    assert gentle.of_mode["nominal_acceleration"] == nominal


def test_without_the_page_there_is_no_such_mode():
    with pytest.raises(ScenarioError, match="'gentle' is unknown; known are"):
        CrarParameters(constraints="gentle").validate()
