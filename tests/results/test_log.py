"""A log comes back from its file as it went in, and nothing else is taken for one."""

from dataclasses import fields

import numpy as np
import pytest
from small_logs import small_log

from crar_drake.errors import CrarError, WriteError
from crar_drake.results.log import SimulationLog


def test_round_trip(tmp_path):
    path = tmp_path / "log.npz"
    log = small_log()
    log.save(path)
    loaded = SimulationLog.load(path)
    for field in fields(SimulationLog):
        ours, theirs = getattr(log, field.name), getattr(loaded, field.name)
        assert type(ours) is type(theirs), field.name
        np.testing.assert_array_equal(ours, theirs, strict=field.name != "scenario")
    assert [p.name for p in tmp_path.iterdir()] == ["log.npz"]


@pytest.mark.parametrize(
    "period, first", [(0.5, [0, 1, 2]), (1.0, [0, 2]), (0.1, [0, 1, 2]), (9.0, [0])]
)
def test_the_first_sample_of_each_control_step(period, first):
    assert small_log().control_steps(period).tolist() == first
    # Ticks are multiples of the period to rounding only.
    for shift in (-1e-12, 1e-12):
        log = small_log(time=np.array([0.0, 0.5, 1.0 + shift]))
        assert log.control_steps(period).tolist() == first


def test_an_older_log_stays_if_saving_fails(tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    small_log().save(path)
    before = path.read_bytes()

    def fail(stream, **arrays):
        stream.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", fail)
    with pytest.raises(WriteError, match="log.npz: could not be written: disk full"):
        small_log().save(path)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 1


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CrarError, match="nowhere.npz: there is no such log"):
        SimulationLog.load(tmp_path / "nowhere.npz")


def _damaged(path):
    small_log().save(path)
    data = bytearray(path.read_bytes())
    start = data.index(b"q.npy") + 40
    data[start : start + 40] = bytes(40)
    path.write_bytes(data)


def _with_something_else(path):
    arrays = {f.name: getattr(small_log(), f.name) for f in fields(SimulationLog)}
    np.savez(path, **arrays, gyroscope=np.zeros(3))


@pytest.mark.parametrize("write", [_damaged, _with_something_else])
def test_what_is_no_log_is_refused(tmp_path, write):
    path = tmp_path / "log.npz"
    write(path)
    with pytest.raises(CrarError, match="log.npz: not a log of crar-drake run"):
        SimulationLog.load(path)
