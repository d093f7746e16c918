"""Both forms of every function on vectors: NumPy's, and the loops that are compiled.

Each is compared with an expression of its own, so that neither is the other's judge.
"""

import ast
import importlib.util
from types import ModuleType
from unittest import mock

import numpy as np
import pytest

from crar_drake.equations import compilation, vectors


def plain_vectors() -> ModuleType:
    """The module once more as it is without Numba: NumPy, nothing compiled."""
    spec = importlib.util.spec_from_file_location("plain_vectors", vectors.__file__)
    module = importlib.util.module_from_spec(spec)
    with mock.patch.object(compilation, "IS_COMPILED", False):
        spec.loader.exec_module(module)
    return module


PLAIN = plain_vectors()


def functions_with_loops() -> dict[str, str]:
    """From the source: the functions to the names of their loops."""
    with open(vectors.__file__, encoding="utf-8") as file:
        tree = ast.parse(file.read())
    found = {}
    for node in tree.body:
        for decorator in getattr(node, "decorator_list", []):
            for keyword in getattr(decorator, "keywords", []):
                assert keyword.arg == "loops"
                if isinstance(keyword.value, ast.Name):  # else it is its own loops
                    found[node.name] = keyword.value.id
    return found


LOOPS = functions_with_loops()
FORMS = ("numpy", "loops", "in use")


def form(name: str, which: str):
    """A function's NumPy form, its loops in Python, or what the equations call."""
    if which == "in use" or name not in LOOPS:
        return getattr(vectors if which == "in use" else PLAIN, name)
    return getattr(PLAIN, LOOPS[name] if which == "loops" else name)


RNG = np.random.default_rng(1)


def normal(*shape: int) -> np.ndarray:
    return RNG.normal(size=shape)


def definite(n: int) -> np.ndarray:
    root = normal(n, n)
    return root @ root.T + 0.1 * np.eye(n)


def lower_factor(n: int) -> np.ndarray:
    """With something above the diagonal, which means nothing."""
    return np.linalg.cholesky(definite(n)) + np.triu(normal(n, n), 1)


def of_factor(L: np.ndarray) -> np.ndarray:
    return np.tril(L) @ np.tril(L).T


def sparse_case(K: int, rows: int, columns: int) -> tuple:
    first = 4 * RNG.integers(columns // 4, size=rows)
    return normal(rows, 4), first, normal(K, columns, 3)


def whole_rows(A: np.ndarray, first: np.ndarray, columns: int) -> np.ndarray:
    """A (N, 4) where its rows stand in a matrix (N, columns)."""
    whole = np.zeros((len(A), columns))
    for i, j in enumerate(first):
        whole[i, j : j + 4] = A[i]
    return whole


# Per function: its arguments, and what it must give by another way.
CASES = {
    "cross_rows": (
        [(normal(N, 3), normal(N, 3)) for N in (0, 1, 7)],
        lambda a, b: np.cross(a, b),
    ),
    "dot_rows": (
        [(normal(N, 3), normal(N, 3)) for N in (0, 1, 7)],
        lambda a, b: (a * b).sum(axis=1),
    ),
    "identity": ([(1,), (4,)], lambda n: np.diag([1.0] * n)),
    "largest": (
        [
            (normal(1),),
            (normal(9),),
            (np.array([-3.0, 2.0]),),
            (np.array([1.0, np.nan, 2.0]),),
            (np.array([np.nan, 1.0]),),
        ],
        lambda x: np.linalg.norm(x, np.inf),
    ),
    "sum_rows": (
        [(normal(5, 3),), (normal(0, 3),), (normal(3, 5).T,)],
        lambda A: np.einsum("ij->i", A),
    ),
    "sum_columns": (
        [(normal(5, 3),), (normal(0, 3),), (normal(3, 5).T,)],
        lambda A: np.einsum("ij->j", A),
    ),
    "gram": (
        [(normal(k, n),) for k, n in ((0, 3), (1, 1), (3, 7), (9, 4), (11, 2))],
        lambda A: np.einsum("ki,kj->ij", A, A),
    ),
    "is_finite": (
        [
            (normal(5),),
            (np.zeros(0),),
            (np.array([0.0, np.nan]),),
            (np.array([-np.inf, np.inf, 1.0]),),
        ],
        lambda x: np.isfinite(x).all(),
    ),
    "times": (
        [
            (normal(5, 3), normal(3)),
            (normal(11, 2), normal(2)),
            (normal(0, 3), normal(3)),
            (normal(5, 0), normal(0)),
            (normal(3, 5).T, normal(3)),
            (normal(5, 7)[:, 4:], normal(3)),
        ],
        lambda A, x: np.einsum("ij,j->i", A, x),
    ),
    "transposed_times": (
        [
            (normal(5, 3), normal(5)),
            (normal(0, 3), normal(0)),
            (normal(5, 0), normal(5)),
            (normal(3, 5).T, normal(5)),
            (normal(5, 7)[:, 4:], normal(5)),
        ],
        lambda A, x: np.einsum("ij,i->j", A, x),
    ),
    "cholesky_solve": (
        [(lower_factor(n), normal(n)) for n in (1, 2, 6, 13)],
        lambda L, b: np.linalg.solve(of_factor(L), b),
    ),
    "cholesky_solve_matrix": (
        [(lower_factor(n), normal(n, m)) for n, m in ((1, 1), (2, 5), (6, 3))],
        lambda L, B: np.linalg.solve(of_factor(L), B),
    ),
    "forward": (
        [(lower_factor(n), normal(n, m)) for n, m in ((1, 1), (2, 5), (6, 0), (7, 3))],
        lambda L, B: np.linalg.solve(np.tril(L), B),
    ),
    "backward": (
        [(lower_factor(n), normal(n)) for n in (1, 2, 6, 13)],
        lambda L, b: np.linalg.solve(np.tril(L).T, b),
    ),
    "product": (
        [
            (normal(4, 3), normal(3, 5)),
            (normal(3, 3).T, normal(3, 3)),
            (normal(0, 3), normal(3, 2)),
            (normal(2, 6), normal(4, 6).T),
            (normal(2, 6)[:, 1:3], normal(2, 2)),
        ],
        lambda A, B: np.einsum("ij,jk->ik", A, B),
    ),
    "transposed": (
        [(normal(2, 3, 5),), (normal(1, 3, 3),), (normal(0, 3, 3),)],
        lambda A: np.einsum("kij->kji", A),
    ),
    "sparse_product": (
        [sparse_case(1, 3, 4), sparse_case(2, 9, 20), sparse_case(2, 0, 8)],
        lambda A, first, X: np.einsum(
            "ij,kjc->kic", whole_rows(A, first, X.shape[1]), X
        ),
    ),
    "some_columns": (
        [
            (normal(3, 7), np.array([6, 0, 2, 2])),
            (normal(2, 4), np.zeros(0, dtype=int)),
        ],
        lambda A, some: np.array([[row[j] for j in some] for row in A.tolist()]),
    ),
    "select_rows": (
        [
            (normal(3, 7), np.array([2, 0, 2, 1])),
            (normal(2, 4), np.zeros(0, dtype=int)),
        ],
        lambda A, some: np.reshape([A.tolist()[i] for i in some], (-1, A.shape[1])),
    ),
    "smallest": (
        [
            (normal(9), np.array([[0, 1, 2], [8, 7, 8], [3, 3, 3], [6, 4, 5]])),
            # Of equal ones, the first.
            (np.array([2.0, 1.0, 1.0]), np.array([[0, 2, 1], [1, 2, 0], [0, 0, 0]])),
            (normal(3), np.array([[2], [0]])),
        ],
        lambda x, members: [min(row, key=lambda i: x[i]) for row in members.tolist()],
    ),
}
# These are tested apart: one is no function of equal results, the others have none.
APART = {"cholesky", "add_to", "add_to_diagonal", "put", "put_at"}


def test_every_function_with_loops_is_tested():
    assert set(CASES) | APART >= set(LOOPS)


def test_the_forms_are_what_they_are_called():
    for name, loops in LOOPS.items():
        numpy_form, loop_form = form(name, "numpy"), form(name, "loops")
        assert numpy_form.__code__.co_name == name
        assert (
            loop_form.__code__.co_name
            == loops
            == f"_{name.removesuffix('_rows')}_loops"
        )
        in_use = getattr(vectors, name)
        chosen = loop_form if compilation.IS_COMPILED else numpy_form
        assert getattr(in_use, "py_func", in_use).__code__.co_name == (
            chosen.__code__.co_name
        )


@pytest.mark.parametrize("which", FORMS)
@pytest.mark.parametrize("name", CASES)
def test_both_forms_give_what_an_expression_of_its_own_gives(name, which):
    arguments, expected = CASES[name]
    for given in arguments:
        before = [np.array(x) for x in given]
        result = form(name, which)(*given)
        np.testing.assert_allclose(result, expected(*given), rtol=1e-9, atol=1e-12)
        assert np.shape(result) == np.shape(expected(*given))
        for x, x_before in zip(given, before, strict=True):
            np.testing.assert_array_equal(x, x_before)


@pytest.mark.parametrize("which", FORMS)
def test_smallest_takes_the_first_nan(which):
    """A distance that is NaN is shown as the pair's, wherever it stands."""
    x = np.array([3.0, np.nan, 1.0, np.nan, 2.0])
    members = np.array([[0, 1, 2], [1, 3, 0], [3, 2, 1], [0, 4, 3], [2, 4, 0]])
    found = form("smallest", which)(x, members)
    np.testing.assert_array_equal(found, [1, 1, 3, 3, 2])


@pytest.mark.parametrize("which", FORMS)
def test_gram_is_symmetric_to_the_last_bit(which):
    for _ in range(20):
        M = form("gram", which)(normal(5, 9))
        np.testing.assert_array_equal(M, M.T)


@pytest.mark.parametrize("which", FORMS)
def test_cholesky_gives_the_lower_factor(which):
    for n in (1, 2, 6, 13):
        A = definite(n)
        before = A.copy()
        L = form("cholesky", which)(A)
        np.testing.assert_allclose(
            np.tril(L), np.linalg.cholesky(A), rtol=1e-9, atol=1e-12
        )
        np.testing.assert_array_equal(A, before)


@pytest.mark.parametrize("which", FORMS)
@pytest.mark.parametrize("case", ["indefinite", "zero", "nan"])
def test_cholesky_of_what_has_no_factor_is_nan(which, case):
    """Whatever is solved with it is NaN as well, in every entry."""
    A = definite(4)
    if case == "indefinite":
        A[2, 2] = -1.0
    elif case == "zero":
        A = np.zeros((4, 4))
    else:
        A[1, 1] = np.nan
    L = form("cholesky", which)(A)
    assert np.isnan(np.tril(L)).any()
    assert np.isnan(form("cholesky_solve", which)(L, np.ones(4))).all()


@pytest.mark.parametrize("which", FORMS)
def test_add_to_diagonal_works_in_place_on_the_diagonal_only(which):
    A, x = normal(5, 5), normal(5)
    expected = A + np.diag(x)
    assert form("add_to_diagonal", which)(A, x) is None
    np.testing.assert_array_equal(A, expected)


@pytest.mark.parametrize("which", FORMS)
def test_add_to_works_in_place(which):
    A, B = normal(3, 5), normal(3, 5)
    expected = A + B
    assert form("add_to", which)(A, B) is None
    np.testing.assert_array_equal(A, expected)


@pytest.mark.parametrize("which", FORMS)
def test_put_works_in_place_from_a_place_on(which):
    x, values = normal(7), normal(3)
    expected = np.concatenate([x[:2], values, x[5:]])
    assert form("put", which)(x, 2, values) is None
    np.testing.assert_array_equal(x, expected)


@pytest.mark.parametrize("which", FORMS)
def test_put_at_works_in_place_on_these_places_only(which):
    x, values = normal(6), normal(3)
    expected = x.copy()
    for place, value in zip((4, 0, 5), values, strict=True):
        expected[place] = value
    assert form("put_at", which)(x, np.array([4, 0, 5]), values) is None
    np.testing.assert_array_equal(x, expected)


def test_vectors_of_one_and_unit_clipping_are_numpys():
    a, b = normal(3), normal(3)
    np.testing.assert_allclose(vectors.cross(a, b), np.cross(a, b), rtol=1e-12)
    assert vectors.dot(a, b) == pytest.approx(np.inner(a, b), rel=1e-12)
    x = np.array([-0.5, 0.0, 0.3, 1.0, 7.0])
    np.testing.assert_array_equal(vectors.clip_to_unit(x), np.clip(x, 0.0, 1.0))
