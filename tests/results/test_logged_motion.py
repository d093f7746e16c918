"""A log as a reference motion, and its lowest point: against what it was made of."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_logs import small_log
from small_walker import HEIGHT, walker

from crar_drake.commands import main
from crar_drake.errors import CrarError, MotionError
from crar_drake.references.motion_files import read_motion
from crar_drake.references.whole_body import WholeBody
from crar_drake.results.log import SimulationLog
from crar_drake.results.logged_motion import lowest_point, motion_of_log
from crar_drake.robot.description import load_robot_description
from crar_drake.robot.joints import names_by_joint

RATE = 200.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> WholeBody:
    return WholeBody(walker(tmp_path_factory.mktemp("walker")))


def log_of(robot: WholeBody, samples: int = 101, **changes):
    """It stands straight, slides ahead, and turns its waist; its root is turned by
    more than half a turn, so that quaternions change their sign."""
    plant = robot.plant
    t = np.arange(samples) / RATE
    q = np.zeros((samples, plant.num_positions()))
    root = plant.get_joint(robot.plant.GetJointIndices()[-1])
    at = root.position_start()
    turns = Rotation.from_euler("z", 7.0 * t[:, None]).as_quat()[:, [3, 0, 1, 2]]
    q[:, at : at + 4] = turns * np.where(t > 0.2, -1.0, 1.0)[:, None]
    q[:, at + 4] = 0.3 * t
    q[:, at + 6] = HEIGHT
    waist = plant.GetJointByName("waist_yaw").position_start()
    q[:, waist] = np.sin(t)
    n = plant.num_velocities()
    given = {
        "time": t,
        "q": q,
        "v": np.zeros((samples, n)),
        "desired_acceleration": np.zeros((samples, n)),
        "signed_distances": np.ones((samples, 1)),
        "position_names": np.array(names_by_joint(plant, of_positions=True)),
        "pair_names": np.array(["left_foot - right_foot"]),
    }
    return small_log(**(given | changes)), waist


def test_root_and_joints_are_the_logs(robot):
    log, waist = log_of(robot)
    motion = motion_of_log(log, robot)
    assert motion.rate == RATE and motion.joint_names == robot.joint_names
    np.testing.assert_allclose(motion.root_positions[:, 0], log.q[:, 4], atol=1e-12)
    yaw = np.unwrap(motion.root_rotations.as_euler("ZYX")[:, 0])
    np.testing.assert_allclose(yaw, 7.0 * log.time, atol=1e-9)
    assert (np.diff(motion.root_quaternions, axis=0) ** 2).sum(axis=1).max() < 0.01
    column = motion.joint_names.index("waist_yaw")
    np.testing.assert_array_equal(motion.joint_positions[:, column], log.q[:, waist])


def test_what_comes_before_its_start_is_left_out(robot):
    log, _ = log_of(robot)
    whole, late = motion_of_log(log, robot), motion_of_log(log, robot, 0.1)
    np.testing.assert_array_equal(late.joint_positions, whole.joint_positions[20:])
    assert motion_of_log(log, robot, 9.0).num_frames == whole.num_frames


def test_a_log_is_converted(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main("run --duration 0.69 --no-page --out it".split()) == 0
    log = SimulationLog.load("it/log.npz")
    command = "convert it/log.npz motion.csv --to named-csv --rate 50"
    capsys.readouterr()
    assert main(command.split()) == 0
    told = capsys.readouterr().out
    assert "10 frames at 50 Hz, 14 joints, from log to named-csv" in told
    robot = WholeBody(load_robot_description("upper_body"))
    found = read_motion("motion.csv", rate=50.0, robot=robot)
    _, _, joints = robot.of_configurations(log.q[500::20][:10])
    np.testing.assert_allclose(found.joint_positions, joints, atol=1e-5)
    # What says something of files of motions alone.
    for option in ("--layout named-csv", "--clip x", "--frame-rate 30"):
        assert main(f"{command} {option}".split()) == 2
        name = option.split()[0]
        assert f"it/log.npz: {name} is of a file of motions" in capsys.readouterr().err


def test_what_is_refused(robot):
    log, _ = log_of(robot)
    with pytest.raises(MotionError, match="0.005 s and 0.1 s apart"):
        times = log.time.copy()
        times[50:] += 0.095
        motion_of_log(replace(log, time=times), robot)
    with pytest.raises(MotionError, match="fewer than two"):
        motion_of_log(log_of(robot, samples=1)[0], robot)
    with pytest.raises(CrarError, match="another model"):
        motion_of_log(replace(log, q=log.q[:, 1:]), robot)


def test_what_was_lowest(robot):
    log, _ = log_of(robot)
    q = log.q.copy()
    q[30, 6] -= 0.02
    height, link, time = lowest_point(replace(log, q=q), robot)
    assert height == pytest.approx(-0.02, abs=1e-6)
    assert link.endswith("foot") and time == pytest.approx(30 / RATE)
    # What comes before the start counts not.
    height, _, time = lowest_point(replace(log, q=q), robot, 0.2)
    assert height == pytest.approx(0.0, abs=1e-6) and time >= 0.2
