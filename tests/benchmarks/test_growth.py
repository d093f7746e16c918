"""In the growth of cleaning and retargeting nothing grows but the size."""

import numpy as np
from short_motions import short_amc
from small_reference_robots import reaching, write_csv, write_robot
from small_walker import walker

from benchmarks.growth import (
    FRAMES,
    RATE,
    arms_description,
    swinging,
    there_and_back,
    with_frames,
)
from crar_drake.motion.catalogue import load_performer
from crar_drake.references.cleaning import Cleaner


def test_a_person_goes_there_and_back(tmp_path):
    path = short_amc(tmp_path, "one", 7)
    before = load_performer(path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(there_and_back(lines, 3)) + "\n")
    after = load_performer(path)
    assert after.num_frames == 6 * before.num_frames
    wrist = before.positions["left_wrist"]
    wrist = np.tile(np.concatenate([wrist, wrist[::-1]]), (3, 1))
    # Where it is in the world is said by the first frames.
    assert np.allclose(
        np.diff(after.positions["left_wrist"], axis=0), np.diff(wrist, axis=0)
    )


def test_a_longer_reference_has_as_much_to_be_cleaned(tmp_path):
    robot = write_robot(tmp_path)
    motion = write_csv(tmp_path / "reach.csv", reaching(24, 30.0, 1.0))
    row = with_frames(str(robot), motion)
    assert row[:3] == ["clean, reach", "frames", "48, 96, 192, 384"]
    changed = [int(count) for count in row[4].split(", ")]
    assert changed[0] > 10
    assert np.allclose(np.array(changed) / changed[0], [1, 2, 4, 8], rtol=0.1)


def test_a_longer_motion_of_a_person_is_retargeted(tmp_path):
    robot = tmp_path / "walker"
    robot.mkdir()
    walker(robot, knee=0.06)
    row = with_frames(str(robot), short_amc(tmp_path, "one", 12))
    frames = [int(count) for count in row[3].split(", ")]
    assert np.allclose(np.array(frames) / frames[0], [1, 2, 4, 8], rtol=0.3)
    assert row[:2] == ["retarget, one", "frames"] and row[4] == "–, –, –, –"


def test_more_arms_and_spheres_ask_for_the_same_change(tmp_path):
    made = {}
    for arms, spheres in ((1, 1), (3, 1), (1, 4)):
        description = arms_description(tmp_path, arms, spheres)
        cleaner = Cleaner(description, RATE)
        reference = swinging(cleaner.model.n)
        assert reference.shape == (FRAMES, 7 * arms)
        assert cleaner.keeper.margins(reference).distance.min() < 0.0
        found = cleaner.clean(reference)
        assert not found.violating.any()
        made[arms, spheres] = found.q
    for arm in range(3):
        assert np.allclose(made[3, 1][:, 7 * arm : 7 * arm + 7], made[1, 1], atol=1e-3)
    assert np.allclose(made[1, 4], made[1, 1], atol=1e-2)
