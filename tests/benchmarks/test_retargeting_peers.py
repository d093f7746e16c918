"""The figures of all motions beside mink."""

import numpy as np

from benchmarks.peers.retargeting import ALL_HEADER, HEADER, Figures, row_of_all


def made(slip: float, lowest: float, penetrating: int, frames: int) -> Figures:
    degrees = np.radians([3.0, 9.0, 1.0])
    return Figures(
        motion="walk", by="mink", limb=degrees[0], limb_95=degrees[1],
        knees=(degrees[2],), slip=slip, lowest=lowest, frames=frames,
        penetrating=penetrating, fast=frames // 10, root=2.0, jerk=500.0,
        times_real_time=2.0,
    )  # fmt: skip


def test_all_motions_have_medians_the_worst_and_shares_of_all_frames():
    found = [
        made(0.01, 0.0, 0, 100),
        made(0.02, -0.001, 30, 100),
        made(0.09, -0.02, 0, 10),
    ]
    row = dict(zip(ALL_HEADER, row_of_all(found), strict=True))
    assert row == {
        "by": "mink",
        "farthest limb, median / 95 %, medians of the motions": "3.0° / 9.0°",
        "slip, median and worst": "20 mm, 90 mm",
        "lowest point, median and worst": "-1.0 mm, -20.0 mm",
        "frames with meshes in penetration": "14.3 %",
        "frames with a joint too fast": "10.0 %",
        "root's acceleration, rms, median": "2.0 m/s²",
        "jerk, rms, median": "500 rad/s³",
        "× real time, median": "2.0",
    }
    assert dict(zip(HEADER, found[1].row(), strict=True))["slip, at most"] == "20 mm"
