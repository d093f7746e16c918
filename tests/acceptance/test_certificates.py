"""Certificates: what the product claims of a motion, and who may believe it."""

import copy
import json
from collections.abc import Callable
from pathlib import Path

import judges
import numpy as np
import product
import pytest
import two_arms
from product import certified, certify

FRAMES, RATE = 30, 30.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two arms on a trunk that moves freely, with meshes for its shapes."""
    folder = tmp_path_factory.mktemp("robot")
    urdf = two_arms.write_urdf(folder / "cell.urdf")
    out = folder / "cell"
    done = product.command("import", urdf, whole_body=True, base="floating", out=out)
    assert done.code == product.FINE, done.err
    return out


@pytest.fixture(scope="module")
def cleaned(robot: Path) -> Path:
    """A motion whose forearms crossed, cleaned, with its certificate beside it."""
    reference = write_crossing(robot.parent / "crossing.csv")
    out = robot.parent / "clean" / "crossing.csv"
    done = product.command("clean", reference, robot=robot, no_page=True, out=out)
    assert done.code == product.FINE, done.out
    return out


@pytest.fixture
def copied(cleaned: Path, tmp_path: Path) -> Path:
    """A copy of motion and certificate that a test may change."""
    for path in (cleaned, product.certificate_of(cleaned)):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path / cleaned.name


def write_crossing(path: Path) -> Path:
    """Elbows bend and upper arms turn inwards, until forearms are in each other."""
    swing = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(FRAMES) / (FRAMES - 1))
    rows = np.zeros((FRAMES, 7 + 12))
    rows[:, 2], rows[:, 3] = 0.8, 1.0
    angle = np.linspace(0.0, 0.6, FRAMES)  # about z, by which the order is seen
    rows[:, 3], rows[:, 6] = np.cos(angle / 2.0), np.sin(angle / 2.0)
    for first, sign in ((7, 1.0), (13, -1.0)):
        rows[:, first + 1] = 0.2 * sign
        rows[:, first + 2] = -1.2 * sign * swing
        rows[:, first + 3] = -1.4 * swing
    np.savetxt(path, rows, delimiter=",", fmt="%.6f")
    return path


def judged(motion: Path, robot: Path) -> product.Finished:
    return product.command("judge", motion, robot=robot, certificate=True, jobs=1)


def said(done: product.Finished) -> str:
    return done.out + done.err


def change(motion: Path, what: str, to: Callable) -> None:
    """Makes the certificate of a motion claim something else."""
    path = product.certificate_of(motion)
    certificate = json.loads(path.read_text())
    certify(certificate, what, to(copy.deepcopy(certified(certificate, what))))
    path.write_text(json.dumps(certificate))


def test_there_and_back(cleaned: Path, robot: Path):
    done = judged(cleaned, robot)
    assert done.code == product.FINE, said(done)
    assert done.out.splitlines()[-1].startswith(product.HOLDS)
    assert product.certificate_of(cleaned).name in done.out


def test_what_it_claims_is_true(cleaned: Path, robot: Path):
    """By the table of the motion, and by capsules that another judge measures."""
    certificate = json.loads(product.certificate_of(cleaned).read_text())
    q = np.loadtxt(cleaned, delimiter=",")[:, 7:]
    margin = two_arms.LIMIT - np.abs(q).max(axis=1)
    np.testing.assert_allclose(
        certified(certificate, "margin to limits"), margin, atol=1e-6
    )
    shares = np.abs(np.diff(q, axis=0)).max(axis=1) * RATE / two_arms.SPEED
    claimed = certified(certificate, "share of speed limits")
    np.testing.assert_allclose(claimed[:-1], shares, atol=1e-6)
    imported = product.imported(robot)
    judge = judges.RobotJudge(imported.model, map(sorted, imported.pairs), base="trunk")
    q = q[:, judge.at(list(imported.joints))]
    distances = judge.distances(q).min(axis=1)
    claimed = certified(certificate, "distance at frames")
    np.testing.assert_allclose(claimed, distances, atol=1e-6)
    midway = judge.distances(0.5 * (q[1:] + q[:-1])).min(axis=1)
    between = certified(certificate, "distance between frames")
    assert len(between) == FRAMES and np.all(between <= distances + 1e-9)
    assert np.all(between[:-1] <= midway + 1e-9) and min(between) > 0.0
    assert min(distances) < 0.01
    assert certified(certificate, "rate") == RATE
    assert certified(certificate, "number of pairs") == len(imported.pairs)


def best(values: list[float]) -> list[float]:
    """The worst frame claims to be better by 1 cm, or a tenth."""
    k = int(np.argmin(values))
    values[k] += 0.01
    return values


def slower(values: list[float]) -> list[float]:
    k = int(np.argmax(values))
    values[k] -= 0.1
    return values


# What is changed, how, and what must be told. The motion stays as it is.
TAMPERED = {
    "a distance": ("distance at frames", best, "frame"),
    "a bound between": ("distance between frames", best, "frame"),
    "a margin": ("margin to limits", lambda v: [x + 0.1 for x in v], "frame"),
    "a speed": ("share of speed limits", slower, "frame"),
    "not clear between": (
        "distance between frames",
        lambda v: [*v[:-1], -1.0],
        "clear",
    ),
    "meshes": (
        "distance of meshes at frames",
        lambda v: [x + 0.01 for x in v],
        "mesh",
    ),
    "pairs": ("number of pairs", lambda n: n + 1, "pairs"),
    "smallest": ("smallest distance", lambda d: d + 0.01, "smallest"),
    "another motion": ("hash of the motion", lambda h: h[::-1], "another file"),
    "another robot": ("hash of the model", lambda h: h[::-1], "robot cell"),
}


@pytest.mark.parametrize("case", TAMPERED)
def test_a_claim_that_was_changed_is_refuted(copied: Path, robot: Path, case: str):
    what, to, told = TAMPERED[case]
    change(copied, what, to)
    done = judged(copied, robot)
    assert done.code == product.VIOLATED, said(done)
    assert done.out.splitlines()[-1].startswith(product.BROKEN)
    assert product.certificate_of(copied).name in done.out and told in done.out


def test_a_motion_that_was_changed_is_refuted(copied: Path, robot: Path):
    lines = copied.read_text().splitlines()
    words = lines[4].split(",")
    words[8] = repr(float(words[8]) + 1e-9)
    lines[4] = ",".join(words)
    copied.write_text("\n".join(lines) + "\n")
    done = judged(copied, robot)
    assert done.code == product.VIOLATED and "another file" in done.out, said(done)


def test_a_certificate_of_another_motion_is_refuted(copied: Path, robot: Path):
    """It lies beside the reference, which is not clean."""
    reference = write_crossing(copied.parent / "reference.csv")
    place = product.certificate_of(reference)
    place.write_bytes(product.certificate_of(copied).read_bytes())
    done = judged(reference, robot)
    assert done.code == product.VIOLATED and "another file" in done.out, said(done)
    assert place.name in done.out


DAMAGED = {
    "cut off": (lambda text: text[: len(text) // 2], "damaged"),
    "empty": (lambda text: "", "damaged"),
    "something else": (lambda text: "[1, 2]", "no certificate"),
    "a key is missing": (lambda text: text.replace('"layout"', '"lay"', 1), "layout"),
    "another format": (
        lambda text: text.replace('"format": ', '"format": 9', 1),
        "format",
    ),
    "no number": (
        lambda text: text.replace('"distance": [', '"distance": [NaN, ', 1),
        "distance[0]",
    ),
    "no list": (
        lambda text: text.replace('"distance": [', '"distance": 1, "x": [', 1),
        "",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_certificate_that_is_damaged_is_told(copied: Path, robot: Path, case: str):
    damage, told = DAMAGED[case]
    place = product.certificate_of(copied)
    text = place.read_text()
    assert damage(text) != text
    place.write_text(damage(text))
    done = judged(copied, robot)
    assert done.code == product.REFUSED, said(done)
    assert place.name in done.err and told in done.err and done.err.count("\n") == 1
    place.unlink()  # that none is there is told as well
    done = judged(copied, robot)
    assert done.code == product.REFUSED and place.name in done.err


def test_a_robot_that_was_changed_is_refuted(copied: Path, robot: Path, tmp_path: Path):
    """One limit is wider than when the motion was cleaned."""
    other = tmp_path / "other"
    for path in robot.rglob("*"):
        if path.is_file():
            place = other / path.relative_to(robot)
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(path.read_bytes())
    model = product.imported(other).model
    text = model.read_text()
    wider = text.replace('lower="-1.5"', 'lower="-1.6"', 1)
    assert wider != text
    model.write_text(wider)
    done = judged(copied, other)
    assert done.code == product.VIOLATED and "robot" in done.out, said(done)
