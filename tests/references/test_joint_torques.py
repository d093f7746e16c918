"""Torques of a pendulum on a body that rises, and of a waist above legs, by hand."""

import numpy as np
import pytest
from small_biped import biped, whole_biped

from crar_drake.commands import main
from crar_drake.errors import ModelError
from crar_drake.references.joint_torques import JointTorques
from crar_drake.references.motion_files import read_motion, write_motion
from crar_drake.references.resampling import retimed
from crar_drake.references.robot_motion import RobotMotion
from crar_drake.references.whole_body import WholeBody
from crar_drake.robot.description import load_robot_description

MASS, LENGTH, INERTIA, GRAVITY = 2.0, 0.3, 0.02, 9.81
LIMIT = 12.0  # [Nm]
RATE = 100.0

_URDF = f"""
<robot name="swing">
  <link name="body"><inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
    ixz="0" iyz="0"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0 {-LENGTH}"/><mass value="{MASS}"/>
    <inertia ixx="1" iyy="{INERTIA}" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 {-LENGTH}"/><geometry><sphere radius="0.02"/></geometry>
    </collision></link>
  <link name="post"><collision><origin xyz="0 1 0"/><geometry><sphere radius="0.02"/>
    </geometry></collision></link>
  <joint name="stand" type="fixed"><parent link="body"/><child link="post"/></joint>
  <joint name="swing" type="revolute"><parent link="body"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="{LIMIT}" velocity="30"/>
  </joint>
</robot>
"""
_YAML = """
name: swing
model: robot.urdf
base: body
root: prescribed
task_frames: {left_hand: arm}
pairs: [[arm, post]]
"""


def actuated(urdf: str, *joints: str) -> str:
    """With a motor for each of some joints."""
    motors = (
        "<transmission><type>transmission_interface/SimpleTransmission</type>"
        f'<joint name="{joint}"/><actuator name="{joint}_motor"/></transmission>'
        for joint in joints
    )
    return urdf.replace("</robot>", "".join(motors) + "</robot>")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("swing")
    (made / "robot.urdf").write_text(actuated(_URDF, "swing"))
    (made / "robot.yaml").write_text(_YAML)
    return made


@pytest.fixture(scope="module")
def robot(folder):
    return WholeBody(load_robot_description(folder))


def swings(frequency: float, rises: float = 0.0, duration: float = 3.0) -> RobotMotion:
    """It swings by 1 rad, in the middle, while the body rises ever faster [m/s^2]."""
    t = np.arange(round(duration * RATE) + 1) / RATE
    q = np.sin(2 * np.pi * frequency * t) * np.exp(-(((t - 1.5) / 0.5) ** 2))
    return RobotMotion(
        ("swing",),
        np.column_stack([0.0 * t, 0.0 * t, 0.5 * rises * t**2]),
        np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)),
        q[:, None],
        RATE,
    )


def by_hand(motion: RobotMotion, rises: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(T - 2,) the torques of the frames between first and last, and gravity's."""
    q = motion.joint_positions[:, 0]
    turns = np.diff(q, 2) * motion.rate**2
    lever = MASS * LENGTH * np.sin(q[1:-1])
    moved = (INERTIA + MASS * LENGTH**2) * turns + lever * (GRAVITY + rises)
    return moved, lever * GRAVITY


def test_a_pendulum_on_a_body_that_rises(robot):
    motion = swings(1.5, rises=3.0)
    torques = JointTorques(robot)
    assert torques.joints == ["swing"] and torques.limits.tolist() == [LIMIT]
    needed, gravity = torques.find(motion)
    for found, true in zip((needed, gravity), by_hand(motion, 3.0), strict=True):
        assert np.abs(true).max() > 4.0
        np.testing.assert_allclose(found[1:-1, 0], true, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(
        torques.shares(motion), np.abs(needed[:, 0]) / LIMIT, atol=1e-12
    )


def test_it_is_slowed_down_until_its_motor_can(robot):
    motion, torques = swings(2.0), JointTorques(robot)
    needed, _ = by_hand(motion)
    assert np.abs(needed).max() > 2.0 * LIMIT
    slowed = retimed(motion, torques.slower)
    needed, _ = by_hand(slowed)
    assert 0.7 * LIMIT < np.abs(needed).max() < 1.001 * LIMIT
    # The same swings, to the same places.
    assert motion.duration + 0.1 < slowed.duration < 2.0 * motion.duration
    ends = [np.ptp(m.joint_positions) for m in (motion, slowed)]
    assert abs(ends[1] - ends[0]) < 0.02
    gentle = swings(0.5)
    assert retimed(gentle, torques.slower) is gentle


def test_what_gravity_takes_no_tempo_changes(tmp_path, robot):
    held = swings(0.2)
    held.joint_positions[:] = 1.3  # 5.7 Nm, of 5 that there are
    weak = _URDF.replace(f'effort="{LIMIT}"', 'effort="5"')
    (tmp_path / "robot.urdf").write_text(actuated(weak, "swing"))
    (tmp_path / "robot.yaml").write_text(_YAML)
    torques = JointTorques(WholeBody(load_robot_description(tmp_path)))
    assert torques.shares(held).min() > 1.0
    assert retimed(held, torques.slower) is held


def test_legs_are_not_looked_at(tmp_path):
    folder = biped(tmp_path / "biped")
    urdf = (folder / "biped.urdf").read_text()
    motors = "left_hip", "left_knee", "right_hip", "right_knee", "waist"
    (folder / "biped.urdf").write_text(actuated(urdf, *motors))
    robot = WholeBody(load_robot_description(folder))
    assert JointTorques(robot).joints == ["waist"]
    with pytest.raises(ModelError, match="no joint that carries no foot has an effort"):
        JointTorques(whole_biped(tmp_path / "without"))


def test_the_command(folder, tmp_path, capsys):
    source, out = tmp_path / "fast.csv", tmp_path / "slow.csv"
    write_motion(source, swings(2.0), "wxyz-csv")
    given = ["clean", str(source), "--robot", str(folder), "--out", str(out)]
    given += ["--layout", "wxyz-csv", "--frame-rate", str(RATE), "--no-page"]
    assert main([*given, "--retime-torques"]) == 0
    told = capsys.readouterr().out
    assert "or needs too much torque" in told
    assert "beyond an effort limit in " in told and " before, 0 after" in told
    slowed = read_motion(out, "wxyz-csv", RATE)
    assert np.abs(by_hand(slowed)[0]).max() < 1.001 * LIMIT
    # Speeds alone are kept as they are.
    assert main([*given, "--retime"]) == 0
    assert "effort limit" not in capsys.readouterr().out
    assert read_motion(out, "wxyz-csv", RATE).num_frames == swings(2.0).num_frames
