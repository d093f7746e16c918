"""Lists of tasks by their names."""

import pytest

from crar_drake.errors import ModelError
from crar_drake.robot.task import joint_tasks, position_tasks


@pytest.mark.parametrize(
    "make, more",
    [(position_tasks, ()), (joint_tasks, (0.5,))],
)
def test_one_name_is_no_list_of_letters(make, more):
    with pytest.raises(
        ModelError, match=r"'left_wrist'.*give a list, \['left_wrist'\]"
    ):
        make("left_wrist", *more)
    (task,) = make(["left_wrist"], *more)
    assert "left_wrist" in (task.frame, task.joint)
