"""The parameter study: what it varies, and its lines."""

from dataclasses import fields

from benchmarks import parameter_study
from benchmarks.parameter_study import HEADER, line, variations
from benchmarks.sweep.cases import Result
from crar_drake.control.parameters import LookaheadParameters


def result(**changes) -> Result:
    values = {field.name: 0.0 for field in fields(Result)}
    values |= dict(motion="dance", experiment="wrists", error="")
    return Result(**(values | changes))


def test_every_parameter_is_varied_and_valid():
    varied = set()
    for parameters in (*variations().values(), *variations(0.0).values()):
        parameters.validate()
        for field in fields(LookaheadParameters):
            default = getattr(LookaheadParameters(), field.name)
            if getattr(parameters.lookahead, field.name) != default:
                varied.add(field.name)
    # What a lost target does is no trade-off, nor is how far a robot may be off.
    # Nor what a person may be touched by, or whether one is evaded; and a preset is
    # others of these by a name.
    others = {"lost_target", "tracking_error", "tracking_errors", "contact_speed"}
    others |= {"evade", "preset"}
    assert varied == {f.name for f in fields(LookaheadParameters)} - others


def test_a_line_reduces_all_clips():
    cells = line(
        "x",
        [
            result(rms_task_error=0.01, smallest_distance=0.02, peak_torque=5.0),
            result(rms_task_error=0.03, smallest_distance=-0.01, penetrating=7),
        ],
    )
    named = dict(zip(HEADER, cells, strict=True))
    assert named["mean error"] == "20.0 mm"
    assert named["smallest distance"] == "-10.0 mm"
    assert named["penetrating samples"] == "7.0"
    assert named["largest τ"] == "5 Nm"


def test_a_study_of_one_variation(monkeypatch, tmp_path, capsys, no_new_processes):
    default = variations()["defaults"]
    monkeypatch.setattr(
        parameter_study, "variations", lambda preview: {"defaults": default}
    )
    page = tmp_path / "study.md"
    page.write_text("<!-- defaults -->\n<!-- end -->\n")
    parameter_study.main(["reaching", "--duration", "0.02", "--page", str(page)])
    text = page.read_text()
    assert text.count("| defaults |") == 2 and "### upper-body" in text
