"""What is none of a kind is said to be so, whatever it is instead."""

import numpy as np
import pytest

from crar_drake.errors import ModelError, check_vector


@pytest.mark.parametrize(
    "value", [1.0, None, "far", "one", [1, 2], [[1], [2], [3]], [1, 2, np.nan]]
)
def test_what_is_no_vector_is_told(value) -> None:
    with pytest.raises(ModelError, match="^here: .* must be three finite numbers$"):
        check_vector("here", value, ModelError)


def test_a_vector_passes() -> None:
    check_vector("here", [1, 2.0, 3])
    check_vector("here", np.zeros(3))
