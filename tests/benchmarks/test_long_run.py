"""Runs of many minutes, on few seconds."""

import numpy as np

from benchmarks.long_run import HEADER, measure, there_and_back
from crar_drake.motion.catalogue import load_clip


def test_there_and_back_has_no_jump():
    clip = load_clip("reaching")
    duration = 2.6 * clip.num_frames / clip.frame_rate
    longer = there_and_back(clip, duration)
    assert longer.num_frames == int(duration * clip.frame_rate) + 1
    for name, values in clip.joints.items():
        jumps = np.abs(np.diff(values, axis=0)).max(initial=0.0)
        assert np.abs(np.diff(longer.joints[name], axis=0)).max(initial=0.0) <= jumps
        once = clip.num_frames
        np.testing.assert_array_equal(longer.joints[name][:once], values)
        np.testing.assert_array_equal(
            longer.joints[name][once : 2 * once - 1], values[-2::-1]
        )


def test_measure_runs_a_length_to_its_end():
    line = dict(zip(HEADER, measure("dance", "dance_wrists", 0.01), strict=True))
    assert line["motion"].startswith("0.01 min, ")
    assert line["log samples"] == "601"
    assert float(line["peak memory"].split()[0]) > 50.0
