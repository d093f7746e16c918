"""What is kept in the user's cache, and what goes."""

import os

import numpy as np
import pytest

from crar_drake import kept_files
from crar_drake.equations import compilation
from crar_drake.kept_files import LONGEST, digest_of, remove_unused
from crar_drake.references import kept_arrays
from crar_drake.references.kept_arrays import keep_array, place_of, read_kept


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The cache's folder; the time is 3 `LONGEST`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kept_files.time, "time", lambda: 3.0 * LONGEST)
    return tmp_path / "crar-drake"


def used_at(place, share):
    """Says that it was used at a time, in `LONGEST`."""
    os.utime(place, (share * LONGEST, share * LONGEST))


def test_what_nobody_used_for_long_goes_where_something_is_kept(cache):
    old, young, new = (place_of("some", (), [np.array(k)]) for k in range(3))
    for place in (old, young):
        keep_array(place, np.zeros(3))
    left = old.with_name(".of-a-process-that-was-killed.npy")
    left.touch()
    for place, share in ((old, 1.9), (young, 2.1), (left, 1.9)):
        used_at(place, share)
    other = cache / "robots"
    other.mkdir()
    used_at(other, 0.0)
    remove_unused.cache_clear()
    keep_array(new, np.zeros(3))
    assert set(old.parent.iterdir()) == {young, new}
    assert other.is_dir()


def test_what_is_read_was_used(cache):
    place = place_of("some", (), [])
    keep_array(place, np.zeros(3))
    used_at(place, 0.0)
    np.testing.assert_array_equal(read_kept(place, float), np.zeros(3))
    assert place.stat().st_mtime > 0.0


def test_what_is_damaged_anywhere_is_not_read(cache):
    """A bit of a distance that flips would be in certificates."""
    place = place_of("some", (), [])
    keep_array(place, np.arange(40.0))
    data = place.read_bytes()
    for at in range(len(data)):
        place.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :])
        assert read_kept(place, float) is None, at
        place.write_bytes(data[:at])
        assert read_kept(place, float) is None, at
    place.write_bytes(data)
    np.testing.assert_array_equal(read_kept(place, float), np.arange(40.0))


def test_another_process_may_remove_it_first(cache, monkeypatch):
    cache.mkdir()
    (cache / "old").mkdir()
    used_at(cache / "old", 0.0)
    listed = [cache / "gone", cache / "old"]
    monkeypatch.setattr(kept_files.Path, "iterdir", lambda _: iter(listed))
    remove_unused(cache)
    assert not (cache / "old").exists()


def test_arrays_are_found_by_sources(cache, tmp_path, monkeypatch):
    """What other sources found is not read, and nobody has to say that they changed."""
    monkeypatch.setattr(kept_arrays, "__file__", str(tmp_path / "kept_arrays.py"))
    source, places = tmp_path / "finder.py", []
    for text in ("x = 1", "x = 2", "x = 1"):
        source.write_text(text)
        kept_arrays._sources.cache_clear()
        places.append(place_of("some", ("finder",), [np.zeros(2)]))
    kept_arrays._sources.cache_clear()
    assert places[0] == places[2] != places[1]
    equations = [tmp_path / "equation.py"]
    equations[0].write_text("y = 1")
    monkeypatch.setattr(kept_arrays, "SOURCES", equations)
    assert place_of("some", ("finder",), [np.zeros(2)]) != places[0]
    kept_arrays._sources.cache_clear()


def test_what_other_versions_compiled_goes_once_nobody_uses_it(cache, monkeypatch):
    monkeypatch.setattr(compilation, "numba", None)  # and its NUMBA_CACHE_DIR
    folder = cache / "compiled" / digest_of(compilation.SOURCES)[:16]
    old, young = folder.with_name("old"), folder.with_name("young")
    for place, share in ((old, 1.9), (young, 2.1)):
        (place / "function").mkdir(parents=True)
        (place / "function" / "some.nbc").touch()
        used_at(place, share)
    remove_unused.cache_clear()
    assert compilation.cache_folder() == folder
    assert list(folder.parent.iterdir()) == [young]
    # One that is there is used.
    folder.mkdir()
    used_at(folder, 0.0)
    assert compilation.cache_folder() == folder
    assert folder.stat().st_mtime > 0.0
