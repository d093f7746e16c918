"""Motors that cannot even brake: an assumption of the theorem is gone, and both the run
and the judge say so."""

import re
import shutil

import numpy as np
from small_logs import small_log

from crar_drake.commands import main
from crar_drake.resources import data_folder
from crar_drake.results.clipped_torque import clipped_line
from crar_drake.results.log import SimulationLog

# Of the shoulder [Nm]; it needs more than that to hold the arm stretched out.
WEAK = 6.0


def test_the_first_sample_and_the_motors_at_their_limits_are_named():
    rounding, some = [1.0, 5e-5], [0.4, 0.3]
    log = small_log(
        torque_limit=np.array([rounding, some, some]),
        actuation=np.array([[10.0, 0.0, 0.0], [9.0, 0.0, -40.0], [10.0, 0.0, 40.0]]),
    )
    line = clipped_line(log)
    assert "clipped in 2 samples, the first at 0.500 s" in line
    assert "limits of swing (40), turn (10). " in line
    assert clipped_line(small_log(torque_limit=np.array([rounding] * 3))) == ""


def test_an_arm_too_weak_for_its_weight_falls_and_it_is_said_why(
    tmp_path, monkeypatch, capsys
):
    arm = tmp_path / "arm"
    shutil.copytree(data_folder("models") / "obstacle_arm", arm)
    urdf = arm / "obstacle_arm.urdf"
    text = urdf.read_text()
    strong = 'effort="200"'  # joint2's
    assert text.count(strong) == 1
    urdf.write_text(text.replace(strong, f'effort="{WEAK}"'))
    monkeypatch.chdir(tmp_path)
    given = ["--constraints", "lookahead", "--duration", "1.5", "--no-recording"]
    main(["run", "obstacle_arm", "--robot", str(arm), *given, "--out", "fell"])
    said = capsys.readouterr().out
    log = SimulationLog.load("fell/log.npz")
    share = log.torque_limit[:, 1].max()
    assert share > 0.1, share
    first = log.time[log.torque_limit[:, 1] > 1e-4][0]
    told = f"the first at {first:.3f} s: not even braking"
    assert re.search(f"^BAD: torques were clipped.*{re.escape(told)}", said, re.M)
    assert f"joint2 ({WEAK:g})" in said
    main(["judge", "fell/log.npz"])
    judged = capsys.readouterr().out
    assert re.search(
        f"^assumption broken: torques were clipped.*{re.escape(told)}", judged, re.M
    )
