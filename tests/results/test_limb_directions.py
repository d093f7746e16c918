"""How far limbs are off in direction, against points turned by known angles."""

from dataclasses import replace

import numpy as np
import pytest

from crar_drake.law.solution import STATUS_BRAKING, STATUS_TRACKING
from crar_drake.motion.performer import Performer
from crar_drake.results.limb_directions import limb_directions
from crar_drake.results.log import SimulationLog
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.model import ControlModel
from crar_drake.robot.task import EXPERIMENTS, position_tasks

T, RATE = 41, 20.0
JOINTS = [f"{s}_{j}" for s in ("left", "right") for j in ("shoulder", "elbow", "wrist")]


def robot(experiment: str) -> ControlModel:
    return ControlModel.FromDescription(
        load_robot_description("upper_body"), position_tasks(EXPERIMENTS[experiment])
    )


@pytest.fixture(scope="module")
def model() -> ControlModel:
    return robot("upper-body")


def motion(model: ControlModel) -> np.ndarray:
    """(T, nq) somewhere about the rest posture."""
    return model.rest_positions() + 0.3 * np.sin(
        np.linspace(0.0, 5.0, T)[:, None] + np.arange(model.plant.num_positions())
    )


def log_of(model: ControlModel, q: np.ndarray) -> SimulationLog:
    """What is looked at of a log."""
    log = object.__new__(SimulationLog)
    log.__dict__.update(
        time=np.arange(T) / RATE, q=q, status=np.full((T, 1), STATUS_TRACKING)
    )
    return log


def performer_of(model: ControlModel, q: np.ndarray, turned: dict) -> Performer:
    """Somebody of twice the size who stands elsewhere and does the same, but that a
    limb, named by its end, is turned by (T,) angles about an axis across it."""
    context, positions = model.plant.CreateDefaultContext(), {}
    for joint in JOINTS:
        frame = model.plant.GetFrameByName(model.description.task_frames[joint])
        places = []
        for each in q:
            model.plant.SetPositions(context, each)
            places.append(frame.CalcPoseInWorld(context).translation())
        positions[joint] = np.array(places)
    theirs = {}
    for side in ("left", "right"):
        start = 2.0 * positions[f"{side}_shoulder"] + [3.0, -1.0, 0.2]
        theirs[f"{side}_shoulder"] = start
        for a, b in (("shoulder", "elbow"), ("elbow", "wrist")):
            along = 2.0 * (positions[f"{side}_{b}"] - positions[f"{side}_{a}"])
            angle = turned.get(f"{side}_{b}", np.zeros(T))[:, None]
            across = np.cross(along, [0.3, 0.5, 0.8])
            across *= np.linalg.norm(along, axis=1, keepdims=True) / np.linalg.norm(
                across, axis=1, keepdims=True
            )
            start = start + np.cos(angle) * along + np.sin(angle) * across
            theirs[f"{side}_{b}"] = start
    return Performer(
        name="x",
        format="BVH",
        frame_rate=RATE,
        rate_source="file",
        positions=theirs,
        heading=np.zeros(T),
        hip_height=1.0,
        height=2.0,
    )


def test_who_does_the_same_is_off_by_nothing_whatever_the_size(model) -> None:
    q = motion(model)
    found = limb_directions(log_of(model, q), model, performer_of(model, q, {}), 0.0)
    parts = ("upper_arm", "forearm")
    assert list(found) == [f"{s}_{p}" for s in ("left", "right") for p in parts]
    for limb in found.values():
        assert limb.most < 1e-7 and limb.followed


def test_a_limb_is_off_by_what_it_is_turned(model) -> None:
    q, angles = motion(model), np.linspace(0.0, np.pi, T)
    performer = performer_of(model, q, {"right_wrist": angles})
    log = log_of(model, q)
    found = limb_directions(log, model, performer, 0.0)
    assert found["right_forearm"].median == pytest.approx(np.median(angles), abs=1e-9)
    most = np.quantile(angles, 0.95)
    assert found["right_forearm"].most == pytest.approx(most, abs=1e-9)
    assert max(found[n].most for n in found if n != "right_forearm") < 1e-7
    # Of what is counted: not blending in, nor without targets, nor after the end.
    log.status[-10:] = STATUS_BRAKING
    found = limb_directions(log, model, performer, 0.5)
    assert found["right_forearm"].median == pytest.approx(
        np.median(angles[10:-10]), abs=1e-9
    )
    short = {name: p[:21] for name, p in performer.positions.items()}
    short = replace(performer, positions=short, heading=np.zeros(21))
    log.status[:] = STATUS_TRACKING
    found = limb_directions(log, model, short, 0.0)
    assert found["right_forearm"].median == pytest.approx(
        np.median(angles[:21]), abs=1e-9
    )


def test_two_wrists_settle_no_elbow(model) -> None:
    q = motion(model)
    found = limb_directions(
        log_of(model, q), robot("wrists"), performer_of(model, q, {}), 0.0
    )
    assert found and not any(limb.followed for limb in found.values())


def test_keyframes_have_no_limbs(model) -> None:
    assert limb_directions(log_of(model, motion(model)), model, None, 0.0) == {}
