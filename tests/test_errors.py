"""What is none of a kind is said to be so, whatever it is instead."""

import numpy as np
import pytest

from crar_drake.errors import ModelError, check_vector, nearest


@pytest.mark.parametrize(
    "value", [1.0, None, "far", "one", [1, 2], [[1], [2], [3]], [1, 2, np.nan]]
)
def test_what_is_no_vector_is_told(value) -> None:
    with pytest.raises(ModelError, match="^here: .* must be three finite numbers$"):
        check_vector("here", value, ModelError)


def test_a_vector_passes() -> None:
    check_vector("here", [1, 2.0, 3])
    check_vector("here", np.zeros(3))


CLEAN = ["--frames", "--frame-rate", "--out", "--no-page", "--retime"]


@pytest.mark.parametrize(
    "name, known, meant",
    [
        # The words of a name, in it, before one that is spelled alike.
        ("--rate", CLEAN, "'--frame-rate'"),
        ("--page", CLEAN, "'--no-page'"),
        ("--out-dir", CLEAN, "'--out'"),
        ("-o", CLEAN, "'--out'"),
        ("--frame_rate", CLEAN, "'--frame-rate'"),
        ("--fr", CLEAN, "'--frames' or '--frame-rate'"),
        # Mistyped, where a letter counts more than words; dashes alone are no likeness.
        ("--frame", CLEAN, "'--frames'"),
        ("--framerate", CLEAN, "'--frame-rate'"),
        ("danse", ["boxing", "dance"], "'dance'"),
        ("--fps", CLEAN, None),
        ("xyzzy", ["boxing", "dance"], None),
        ("", ["boxing", "dance"], None),
    ],
)
def test_the_nearest_name_is_told_else_all(name, known, meant) -> None:
    every = f"known are {', '.join(sorted(known))}"
    assert nearest(name, known) == "; " + (f"did you mean {meant}?" if meant else every)


def test_among_no_names_none_is_told() -> None:
    assert nearest("dance", []) == ""
