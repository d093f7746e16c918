"""How continuous the law is: what the benchmark measures, on a short stretch."""

import pytest

from benchmarks.continuity import main


def test_a_nudge_changes_little(capsys):
    main(["--motion", "boxing", "--every", "10", "--duration", "0.5"])
    out = capsys.readouterr().out
    header, _, *rows = [line for line in out.splitlines() if "|" in line]
    assert "steps nominal" in header
    assert [row.split("|")[1].strip() for row in rows] == [
        "boxing, wrists",
        "boxing, upper-body",
        "all",
    ]
    _, _, steps, change, *_ = rows[-1].split("|")
    assert int(steps) == 2 * 9  # every tenth of 100 but the first
    # A bound of what stiff gains make of 1e-9; a branch that is taken anew jumps by 1.
    assert 0.0 < float(change) < 0.1


def test_it_tells_how_to_be_used(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "--period" in capsys.readouterr().out
