"""Files in, files and certificates out; what is wrong with one is told."""

import json

import numpy as np
import pytest
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.errors import CrarError, MotionError
from crar_drake.references.clean_file import clean_file
from crar_drake.references.clean_folder import clean_folder
from crar_drake.references.motion_certificate import (
    certificate_path,
    check_certificate,
    read_certificate,
)
from crar_drake.robot.description import load_robot_description


@pytest.fixture(scope="module")
def cleaned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clean")
    write_robot(folder)
    reference = write_csv(folder / "reach.csv", reaching(24, 30.0, 1.0))
    out = folder / "out" / "reach.csv"
    (row,) = clean_file(reference, out, str(folder))
    return folder, reference, out, row


def check(folder, out):
    description = load_robot_description(folder)
    return check_certificate(out, read_certificate(certificate_path(out)), description)


def test_the_root_stays_and_the_layout_too(cleaned):
    _, reference, out, row = cleaned
    before, after = (np.loadtxt(path, delimiter=",") for path in (reference, out))
    assert before.shape == after.shape
    np.testing.assert_allclose(after[:, :7], before[:, :7], atol=1e-9)
    assert row.penetrating_before > 0 and row.penetrating == 0 and not row.violated
    assert row.nearest >= row.between > 3.9e-3
    change = after[:, 7:] - before[:, 7:]
    assert row.joints_worst == pytest.approx(np.abs(change).max(), abs=1e-9)
    assert row.joints_rms == pytest.approx(np.sqrt((change**2).mean()), abs=1e-9)


def test_the_certificate_holds(cleaned):
    folder, _, out, row = cleaned
    found = check(folder, out)
    assert found.holds, found.refuted
    assert found.frames == 24 and found.points == 23 * 3
    assert found.distance == pytest.approx(row.nearest, abs=1e-3)
    assert main(["judge", str(out), "--certificate", "--robot", str(folder)]) == 0


def test_a_certificate_of_another_file_or_robot_does_not_hold(cleaned, tmp_path):
    folder, _, out, _ = cleaned
    other = tmp_path / out.name
    other.write_text(out.read_text().replace("0.8", "0.9", 1))
    place = certificate_path(other)
    place.write_text(certificate_path(out).read_text())
    assert "another file" in check(folder, other).refuted[0]
    assert main(["judge", str(other), "--certificate", "--robot", str(folder)]) == 1
    changed = write_robot(tmp_path)
    (changed / "robot.yaml").write_text((folder / "robot.yaml").read_text() + "\n")
    other.write_bytes(out.read_bytes())
    assert "other files" in check(changed, other).refuted[0]


@pytest.mark.parametrize("claim, by", [("distance", 0.01), ("between", 0.01),
                                       ("limit", 0.1), ("speed", -0.1)])  # fmt: skip
def test_claims_that_are_too_good_are_refuted(cleaned, tmp_path, claim, by):
    folder, _, out, _ = cleaned
    certificate = read_certificate(certificate_path(out))
    frames = certificate["clips"][0]["frames"]
    worst = np.argmax(frames["speed"]) if claim == "speed" else np.argmin(frames[claim])
    frames[claim][worst] += by
    found = check_certificate(out, certificate, load_robot_description(folder))
    assert not found.holds and f"frame {worst + 1}" in found.refuted[0]


def test_a_true_certificate_of_a_penetration_does_not_hold(cleaned):
    """Made of the reference itself: all it claims is true, and it is violated."""
    folder, reference, out, _ = cleaned
    certificate = json.loads(certificate_path(out).read_text())
    from crar_drake.references.motion_certificate import file_hash

    certificate["motion"]["sha256"] = file_hash(reference)
    frames = certificate["clips"][0]["frames"]
    for claim in ("distance", "between", "limit"):
        frames[claim] = [-1.0] * 24
    frames["speed"] = [1.0] * 24
    found = check_certificate(reference, certificate, load_robot_description(folder))
    assert any("penetrate" in line for line in found.refuted)


def test_bad_files_are_refused(cleaned, tmp_path):
    folder, reference, out, _ = cleaned
    with pytest.raises(MotionError, match="reference itself"):
        clean_file(reference, reference, str(folder))
    wrong = write_csv(tmp_path / "wrong.csv", np.zeros((5, 4)))
    with pytest.raises(MotionError, match="4 joints"):
        clean_file(wrong, tmp_path / "out.csv", str(folder))
    assert not (tmp_path / "out.csv").exists()
    with pytest.raises(CrarError, match="no certificate"):
        read_certificate(tmp_path / "none.certificate.json")
    (tmp_path / "some.certificate.json").write_text("{}")
    with pytest.raises(CrarError, match="no certificate of"):
        read_certificate(tmp_path / "some.certificate.json")
    assert main(["clean", str(wrong), "--robot", str(folder)]) == 2


class Here:
    """An executor that runs each call at once, and counts."""

    calls = 0

    def submit(self, fn, *args):
        from concurrent.futures import Future

        Here.calls += 1
        future = Future()
        future.set_result(fn(*args))
        return future


def test_a_folder_is_cleaned_once_and_bad_files_are_told(cleaned, tmp_path):
    folder, reference, _, row = cleaned
    references, out = tmp_path / "references", tmp_path / "out"
    (references / "deep").mkdir(parents=True)
    (references / "deep" / "reach.csv").write_bytes(reference.read_bytes())
    (references / "bad.csv").write_text("1,2,3\n")
    for calls in (2, 3):  # the second time only what failed is tried again
        files = clean_folder(references, out, str(folder), executor=Here())
        assert Here.calls == calls
        bad, good = files
        assert bad.error and not bad.clips and "bad.csv" in bad.error
        assert good.clips[0].nearest == pytest.approx(row.nearest, abs=1e-12)
    assert (out / "deep" / "reach.csv").is_file()
    lines = (out / "cleaned.csv").read_text().splitlines()
    assert len(lines) == 3
    with pytest.raises(CrarError, match="own folder"):
        clean_folder(references, references, str(folder))
