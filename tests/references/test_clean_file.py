"""Files in, files and certificates out; what is wrong with one is told."""

import copy
import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_reference_robots import reaching, write_csv, write_robot

from crar_drake.commands import main
from crar_drake.errors import CrarError, MotionError, WriteError
from crar_drake.references.certificate_files import certificate_path, read_certificate
from crar_drake.references.clean_file import (
    CleanedClip,
    CleanOptions,
    FileCleaner,
    clean_file,
)
from crar_drake.references.folders import apart, read_table, work_through
from crar_drake.references.motion_certificate import check_certificate
from crar_drake.references.motion_files import read_motions, write_motions
from crar_drake.references.whole_body import WholeBody
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


def csv_parts(path, first, last):
    """Root positions, quaternions from w and joints; columns `first` to `last` are x
    y z, and w is the other one of the four."""
    table = np.loadtxt(path, delimiter=",")
    w = 6 if first == 3 else 3
    return table[:, :3], table[:, [w, *range(first, last)]], table[:, 7:]


def npz_parts(path):
    held = np.load(path)
    return held["body_pos_w"][:, 0], held["body_quat_w"][:, 0], held["joint_pos"]


def holosoma_parts(path):
    joints = np.load(path)["joint_pos"]
    return joints[:, :3], joints[:, 3:7], joints[:, 7:]


def gmr_parts(path):
    held = pickle.loads(path.read_bytes())
    return held["root_pos"], held["root_rot"][:, [3, 0, 1, 2]], held["dof_pos"]


def motion_lib_parts(path):
    (held,) = pickle.loads(path.read_bytes()).values()
    rotations = held["root_rot"][:, [3, 0, 1, 2]]
    return held["root_trans_offset"], rotations, held["dof"]


# As docs/guides/reference-motions.md describes the layouts, without what reads them
# here.
READERS = {
    "xyzw-csv": (".csv", lambda path: csv_parts(path, 3, 6)),
    "wxyz-csv": (".csv", lambda path: csv_parts(path, 4, 7)),
    "beyondmimic-npz": (".npz", npz_parts),
    "mjlab-npz": (".npz", npz_parts),
    "holosoma-npz": (".npz", holosoma_parts),
    "gmr-pkl": (".pkl", gmr_parts),
    "motion-lib-pkl": (".pkl", motion_lib_parts),
}


@pytest.mark.parametrize("layout", READERS)
def test_a_cleaned_file_is_what_others_read(cleaned, tmp_path, layout):
    folder, _, wanted, _ = cleaned
    ending, parts = READERS[layout]
    robot = WholeBody(load_robot_description(folder))
    (motion,) = read_motions(folder / "reach.csv", robot=robot)
    reference, out = tmp_path / f"in{ending}", tmp_path / f"out{ending}"
    write_motions(reference, [motion], layout, robot)
    (row,) = clean_file(reference, out, str(folder), layout=layout)
    assert row.penetrating_before > 0 and not row.violated
    p, Q, joints = parts(out)
    expected = np.loadtxt(wanted, delimiter=",")
    # Layouts of 32 bits give the law a reference that is a little off.
    np.testing.assert_allclose(p, expected[:, :3], atol=1e-6)
    turned = np.sign(Q[:, :1]) * Q
    np.testing.assert_allclose(turned, expected[:, 3:7], atol=1e-6)
    np.testing.assert_allclose(joints, expected[:, 7:], atol=1e-4)
    assert check(folder, out).holds


def test_the_certificate_holds(cleaned):
    folder, _, out, row = cleaned
    found = check(folder, out)
    assert found.holds, found.refuted
    assert found.frames == 24 and found.points == 23 * 3
    assert found.distance == pytest.approx(row.nearest, abs=1e-3)
    assert main(["judge", str(out), "--certificate", "--robot", str(folder)]) == 0


def test_a_true_certificate_of_a_penetration_does_not_hold(cleaned):
    """Made of the reference itself: all it claims is true, and it is violated."""
    folder, reference, out, _ = cleaned
    certificate = json.loads(certificate_path(out).read_text())
    from crar_drake.references.certificate_files import file_hash

    certificate["motion"]["sha256"] = file_hash(reference)
    frames = certificate["clips"][0]["frames"]
    for claim in ("distance", "between", "limit"):
        frames[claim] = [-1.0] * 24
    frames["speed"] = [1.0] * 24
    found = check_certificate(reference, certificate, load_robot_description(folder))
    assert any("penetrate" in line for line in found.refuted)


def test_what_is_guessed_is_said(cleaned, tmp_path, capsys):
    folder, reference, out, row = cleaned
    order, rate = row.guessed.split("; ")[:2]
    assert order.startswith("quaternions are wxyz: ") and rate.startswith("30 Hz, ")
    arguments = [str(reference), "--robot", str(folder), "--no-page"]
    main(["clean", *arguments, "--out", str(tmp_path / "a.csv")])
    assert f"guessed: {order}; {rate}" in capsys.readouterr().out
    # All that is guessed is given.
    again = CleanOptions(str(folder), layout="wxyz-csv", rate=30.0)
    (row,) = again.begin()(reference, tmp_path / "b.csv")
    assert "quaternion" not in row.guessed and "Hz" not in row.guessed


def test_of_what_was_written_here_nothing_is_guessed(cleaned, tmp_path):
    folder, reference, _, _ = cleaned
    out, given = tmp_path / "out.csv", {"layout": "xyzw-csv", "rate": 20.0}
    clean_file(reference, out, str(folder), **given)
    (row,) = clean_file(out, tmp_path / "again.csv", str(folder))
    assert row.guessed == ""
    (motion,) = read_motions(out)
    assert (motion.layout, motion.rate, motion.guesses) == ("xyzw-csv", 20.0, ())
    (motion,) = read_motions(out, "wxyz-csv", 25.0)
    assert (motion.layout, motion.rate) == ("wxyz-csv", 25.0)
    # It says so of this very file; one that is damaged says nothing.
    place = certificate_path(out)
    said = read_certificate(place)
    robot = WholeBody(load_robot_description(folder))
    damaged = [("xyzw-csv", rate) for rate in (True, "fast", -20.0, float("nan"))]
    damaged += [("zyxw-csv", 20.0), ("xyzw-csv", 1e9), ("xyzw-csv", 10**400)]
    for layout, rate in damaged:
        said["motion"] |= {"layout": layout, "rate": rate}
        place.write_text(json.dumps(said))
        assert len(read_motions(out, robot=robot)[0].guesses) == 3
    said["motion"] |= {"layout": "xyzw-csv", "rate": 20.0}
    place.write_text(json.dumps(said))
    out.write_text(out.read_text() + "\n")
    assert len(read_motions(out)[0].guesses) == 2


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


def edited(out, edit):
    """The certificate of a file after `edit` of it, or of the part it returns."""
    certificate = copy.deepcopy(read_certificate(certificate_path(out)))
    edit(certificate, certificate["clips"][0])
    return certificate


EDITS = {
    "frame 3: a claim is no number": [
        lambda c, clip: clip["frames"]["distance"].__setitem__(2, float("nan")),
        lambda c, clip: clip["frames"]["distance"].__setitem__(2, None),
        lambda c, clip: clip["frames"]["between"].__setitem__(2, float("-inf")),
        lambda c, clip: clip["frames"]["limit"].__setitem__(2, float("nan")),
        lambda c, clip: clip["frames"]["speed"].__setitem__(2, float("nan")),
    ],
    "not shown to be clear": [
        lambda c, clip: clip["frames"]["between"].__setitem__(2, -1e-9)
    ],
    "'smallest' is not what": [
        lambda c, clip: clip["smallest"].update(distance=0.5),
        lambda c, clip: clip["smallest"].update(pair=["l1", "l2"]),
        lambda c, clip: clip["smallest"].update(limit=float("nan")),
    ],
    "watches 3 pairs": [lambda c, clip: c["robot"].update(watched_pairs=300)],
    "clip 'more' is not in the motion": [
        lambda c, clip: c["clips"].append(clip | {"clip": "more"})
    ],
    "more than once": [lambda c, clip: c["clips"].append(clip)],
}


@pytest.mark.parametrize("refuted", EDITS)
def test_what_a_certificate_says_besides_is_refuted(cleaned, refuted):
    folder, _, out, _ = cleaned
    description = load_robot_description(folder)
    for edit in EDITS[refuted]:
        found = check_certificate(out, edited(out, edit), description)
        assert any(refuted in line for line in found.refuted), found.refuted


def test_a_way_that_is_not_shown_to_be_clear_is_a_violation(cleaned):
    row = cleaned[3]
    assert not row.violated and row.unclear == 0
    assert replace(row, unclear=1).violated


def test_each_clip_of_a_file_has_its_own_rate(cleaned, tmp_path):
    folder = cleaned[0]
    clips = {}
    for rate in (30, 120):
        turn = np.zeros((4, 4), dtype=np.float32)
        turn[:, 3] = 1.0
        clips[f"at {rate}"] = {
            "fps": rate,
            "root_trans_offset": np.zeros((4, 3), dtype=np.float32),
            "root_rot": turn,
            "dof": np.outer([0.0, 0.01, 0.02, 0.03], [0, 0, -1]).astype(np.float32),
        }
    (tmp_path / "two.pkl").write_bytes(pickle.dumps(clips))
    out = tmp_path / "out" / "two.pkl"
    rows = clean_file(tmp_path / "two.pkl", out, str(folder))
    assert [row.rate for row in rows] == [30.0, 120.0]
    certificate = read_certificate(certificate_path(out))
    speeds = [clip["smallest"]["speed"] for clip in certificate["clips"]]
    assert speeds == pytest.approx([0.05, 0.2], rel=1e-3)  # of 6 rad/s
    certificate["motion"]["rate"] = 30.0  # which would be that of all, if it counted
    found = check_certificate(out, certificate, load_robot_description(folder))
    assert found.holds and found.speed == pytest.approx(0.2, rel=1e-3)


def test_a_certificate_is_of_one_file(cleaned, tmp_path):
    """reach.csv and reach.pkl would both have reach.certificate.json."""
    folder, reference, out, _ = cleaned
    for place in (out, certificate_path(out)):
        (tmp_path / place.name).write_bytes(place.read_bytes())
    with pytest.raises(
        CrarError, match=r"reach\.pkl: .* the certificate of reach\.csv"
    ):
        clean_file(reference, tmp_path / "reach.pkl", str(folder))
    (tmp_path / out.name).unlink()
    certificate_path(out.parent / "a.csv").unlink(missing_ok=True)
    # What is wrong with the certificate's place is known before anything is written.
    (tmp_path / "a.certificate.json").mkdir()
    with pytest.raises(WriteError, match="a.certificate.json: this is a folder"):
        clean_file(reference, tmp_path / "a.csv", str(folder))
    assert not (tmp_path / "a.csv").exists()


def test_neither_motion_nor_certificate_without_the_other(
    cleaned, tmp_path, monkeypatch
):
    folder = cleaned[0]
    calm = write_csv(tmp_path / "calm.csv", np.full((3, 3), 0.1))

    def fail(*arguments):
        raise WriteError(tmp_path, "the disk is full")

    monkeypatch.setattr("crar_drake.references.pipeline.write_certificate", fail)
    with pytest.raises(WriteError, match="full"):
        clean_file(calm, tmp_path / "out" / "calm.csv", str(folder))
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_judged_is_told_by_its_name(cleaned, tmp_path, capsys):
    folder, _, out, _ = cleaned
    robot = ["--certificate", "--robot", str(folder)]
    assert main(["judge", str(tmp_path / "none.csv"), *robot]) == 2
    assert "none.csv: there is no such file" in capsys.readouterr().err
    deep = tmp_path / "deep.csv"
    deep.write_text("1,2\n")
    certificate_path(deep).write_text("[" * 100000)
    (tmp_path / "first.csv").write_text("1,2\n")
    last = tmp_path / "last.csv"
    last.write_bytes(out.read_bytes())
    named = edited(out, lambda c, clip: c["robot"].update(name="nobody"))
    certificate_path(last).write_text(json.dumps(named))
    assert main(["judge", str(tmp_path), *robot]) == 2
    told = capsys.readouterr()
    assert "deep.certificate.json: the certificate is damaged" in told.err
    assert "first.certificate.json: there is no certificate" in told.err
    assert "last.certificate.json: nothing refutes it" in told.out
    assert main(["judge", str(last), "--certificate"]) == 2
    assert "last.certificate.json: its robot" in capsys.readouterr().err


class Here:
    """An executor that runs each call at once, and counts files."""

    calls = 0

    def submit(self, fn, files, *args):
        from concurrent.futures import Future

        Here.calls += len(files)
        future = Future()
        future.set_result(fn(files, *args))
        return future


def test_a_folder_is_cleaned_once_and_bad_files_are_told(cleaned, tmp_path):
    folder, reference, _, row = cleaned
    references, out = tmp_path / "references", tmp_path / "out"
    (references / "deep").mkdir(parents=True)
    (references / "deep" / "reach.csv").write_bytes(reference.read_bytes())
    (references / "bad.csv").write_text("1,2,3\n")
    for calls in (2, 3):  # the second time only what failed is tried again
        files = work_through(
            CleanOptions(str(folder)), references, out, executor=Here()
        )
        assert Here.calls == calls
        bad, good = files
        assert bad.error and not bad.clips and "bad.csv" in bad.error
        assert good.clips[0].nearest == pytest.approx(row.nearest, abs=1e-12)
    assert (out / "deep" / "reach.csv").is_file()
    lines = (out / "cleaned.csv").read_text().splitlines()
    assert len(lines) == 3
    for place in (references, references / "clean"):
        with pytest.raises(CrarError, match="own folder"):
            work_through(CleanOptions(str(folder)), references, place)


def test_what_is_done_was_done_with_the_same_options(cleaned, tmp_path):
    folder = cleaned[0]
    references, out = tmp_path / "references", tmp_path / "out"
    references.mkdir()
    write_csv(references / "calm.csv", np.full((3, 3), 0.1))
    for rate, layout in ((30.0, None), (60.0, None), (60.0, "wxyz-csv")):
        for calls in (1, 0):
            before = Here.calls
            files = work_through(
                CleanOptions(str(folder), rate=rate, layout=layout),
                references,
                out,
                executor=Here(),
            )
            assert Here.calls - before == calls
            assert files[0].clips[0].rate == rate


def test_a_damaged_table_costs_no_more_than_its_files(cleaned, tmp_path):
    """Cut off anywhere, or with other bytes in it."""
    folder, reference, *_ = cleaned
    references, out = tmp_path / "references", tmp_path / "out"
    references.mkdir()
    (references / "reach.csv").write_bytes(reference.read_bytes())
    work_through(CleanOptions(str(folder)), references, out, executor=Here())
    table = out / "cleaned.csv"
    whole = table.read_bytes()
    cuts = [whole[:k] for k in range(0, len(whole), 41)]
    cuts += [whole.replace(b"0.", b"x\xff\0"), whole + b"a" * 200_000]
    for damaged in cuts:
        table.write_bytes(damaged)
        kept = read_table(table, references, CleanedClip)
        assert set(kept) <= {references / "reach.csv"}
    table.write_bytes(whole[:-20])
    (file,) = work_through(CleanOptions(str(folder)), references, out, executor=Here())
    assert not file.error and len(file.clips) == 1
    assert table.read_bytes()[:200] == whole[:200]


def test_any_error_is_of_its_file(cleaned, tmp_path, monkeypatch):
    folder = cleaned[0]
    references = tmp_path / "references"
    references.mkdir()
    for name in ("a.csv", "b.csv", "b.npz"):
        (references / name).write_text("")

    def fail(self, reference, out):
        raise PermissionError(13, "Permission denied", str(reference))

    monkeypatch.setattr(FileCleaner, "__call__", fail)
    files = work_through(
        CleanOptions(str(folder)), references, tmp_path / "out", executor=Here()
    )
    assert ["PermissionError" in file.error for file in files] == [True, True, True]


def test_names_that_clash_are_written_apart(tmp_path):
    names = ("a.csv", "b.csv", "b.npz", "b.pkl", "b-npz.csv")
    places = {Path("in") / name: tmp_path / name for name in names}
    found = apart(places)
    assert found[Path("in/b.csv")] == tmp_path / "b.csv"
    assert len({certificate_path(place) for place in found.values()}) == len(names)
    assert [place.suffix for place in found.values()] == [
        source.suffix for source in found
    ]


def test_what_is_no_motion_is_skipped_and_said(tmp_path, capsys):
    folder = write_robot(tmp_path)
    references = tmp_path / "references"
    references.mkdir()
    np.savez(references / "shape.npz", betas=np.zeros(10), gender="neutral")
    (references / "labels.csv").write_text("file,label\nwalk.npz,walk\n")
    arguments = ["clean", str(references), "--out", str(tmp_path / "out")]
    arguments += ["--robot", str(folder), "--jobs", "1"]
    assert main(arguments) == 2
    assert "NOT JUDGED: 2 files, and no motion in any" in capsys.readouterr().out
    write_csv(references / "reach.csv", reaching(24, 30.0, 0.5))
    assert main(arguments) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[-1].startswith("OK")
    assert said.err.count("skipped: ") == 2


def test_degrees_are_refused(tmp_path, capsys):
    """They were put at the limits, for minutes, and the doubt was said at the end."""
    write_robot(tmp_path)
    degrees = np.degrees(reaching(24, 30.0, 1.0))
    reference = write_csv(tmp_path / "degrees.csv", degrees)
    out = tmp_path / "out.csv"
    arguments = ["clean", str(reference), "--robot", str(tmp_path), "--out", str(out)]
    assert main(arguments) == 2
    assert "is the file in degrees" in capsys.readouterr().err
    q = reaching(24, 30.0, 1.0)
    q[9] = np.degrees(q[9])
    write_csv(reference, q)
    assert main([*arguments, "--frames", "5:"]) == 2
    assert "in frame 10, " in capsys.readouterr().err
    assert not out.exists() and not certificate_path(out).exists()


def test_what_it_is_not_asked_to_change_is_left_and_said(tmp_path, capsys):
    """`clean` and `judge` end with the same; without the certificate it violates."""
    folder = write_robot(tmp_path)
    low, out = write_csv(tmp_path / "low.csv", reaching(24, 30.0, 0.5)), tmp_path / "o"
    rows = np.loadtxt(low, delimiter=",")
    rows[:, 2] = -0.1
    np.savetxt(low, rows, delimiter=",", fmt="%.10g")
    of, out = ["--robot", str(folder)], out / "low.csv"

    def last(*arguments: str) -> tuple[int, str]:
        code = main([*arguments, *of])
        return code, capsys.readouterr().out.splitlines()[-1]

    code, said = last("clean", str(low), "--out", str(out), "--no-page")
    assert code == 0 and said.startswith("OK, left as it was: below the ground: ")
    for more in ([], ["--certificate"]):
        code, said = last("judge", str(out), *more)
        assert code == 0 and said.startswith("OK, left as it was: below the ground")
    certificate_path(out).unlink()
    code, said = last("judge", str(out))
    assert code == 1 and "below the ground" in said
