"""How the hands are turned: by hand, and by SciPy's rotations."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from crar_drake.errors import MotionError
from crar_drake.motion.catalogue import load_clip, load_performer
from crar_drake.motion.formats.asf_amc import Clip
from crar_drake.motion.orientations import HANDS, smooth_hands
from crar_drake.motion.performers.asf_amc import asf_amc_performer, robot_frame

SIDES = {"left_hand": "l", "right_hand": "r"}


def of_file(vectors: np.ndarray) -> np.ndarray:
    """Vectors of the z-up world in the y-up file's axes."""
    return vectors[..., [1, 2, 0]]


def chained(clip: Clip, bone: str) -> Rotation:
    """R_WB of the file, by SciPy, from the bone up to the root."""
    R = Rotation.identity(clip.num_frames)
    while bone != "root":
        b = clip.skeleton.bones[bone]
        if b.dof:
            angles = np.zeros((clip.num_frames, 3))
            for column, dof in enumerate(b.dof):
                angles[:, "xyz".index(dof[1])] = clip.joints[bone][:, column]
            C = Rotation.from_euler("xyz", b.axis)
            R = C * Rotation.from_euler("xyz", angles) * C.inv() * R
        bone = b.parent
    return Rotation.from_euler("xyz", clip.root_rotation) * R


@pytest.mark.parametrize("motion", ["dance", "cmu:05_02"])
@pytest.mark.parametrize("hand", HANDS)
def test_they_are_those_of_the_bone_chain(motion, hand, request):
    """x and z of the hand are the wrist bone's direction and the front at rest."""
    if motion.startswith("cmu"):
        request.getfixturevalue("cmu")
    clip = load_clip(motion)
    R_WH = asf_amc_performer(clip).hands[hand]
    bone = SIDES[hand] + "wrist"
    R = chained(clip, bone)
    x = clip.skeleton.bones[bone].direction
    z = of_file(np.array([1.0, 0.0, 0.0]))
    assert abs(x @ z) < 1e-6
    np.testing.assert_allclose(R_WH[:, :, 0], robot_frame(R.apply(x)), atol=1e-6)
    np.testing.assert_allclose(R_WH[:, :, 2], robot_frame(R.apply(z)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(R_WH), 1.0)


def test_at_rest_palms_face_down():
    """The built-in performer's rest pose has its arms spread."""
    clip = load_clip("dance")
    still = dataclasses.replace(
        clip,
        root_rotation=np.zeros((clip.num_frames, 3)),
        joints={bone: 0.0 * values for bone, values in clip.joints.items()},
    )
    rotations = asf_amc_performer(still).hands
    x, y, z = np.eye(3)
    left, right = rotations["left_hand"][0], rotations["right_hand"][0]
    np.testing.assert_allclose(left, np.stack([y, z, x], axis=1), atol=1e-9)
    np.testing.assert_allclose(right, np.stack([-y, -z, x], axis=1), atol=1e-9)


def test_missing_hands_are_named():
    clip = load_clip("dance")
    bones = {
        k: b for k, b in clip.skeleton.bones.items() if k[1:] not in ("wrist", "hand")
    }
    skeleton = dataclasses.replace(clip.skeleton, bones=bones)
    bare = dataclasses.replace(clip, skeleton=skeleton)
    with pytest.raises(MotionError, match="lwrist, rwrist"):
        smooth_hands(asf_amc_performer(bare))


def turning(rate: float, num_frames: int) -> Rotation:
    """A turn about z by `rate` [rad] a frame."""
    return Rotation.from_rotvec(np.outer(np.arange(num_frames), [0.0, 0.0, rate]))


def test_the_low_pass_keeps_a_slow_turn_and_takes_the_noise():
    dancer = load_performer("dance")
    turn = turning(0.02, 1000)  # three turns
    noise = np.random.default_rng(1).normal(size=(1000, 3), scale=0.02)
    shaken = Rotation.from_rotvec(noise) * turn
    dancer = dataclasses.replace(dancer, hands={"left_hand": shaken.as_matrix()})
    quaternions = smooth_hands(dancer, cutoff=3.0)["left_hand"]
    assert (np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0.9).all()
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)
    error = (Rotation.from_quat(quaternions) * turn.inv()).magnitude()[60:-60]
    before = np.sqrt(np.mean(noise**2) * 3)
    assert np.sqrt(np.mean(error**2)) < before / 2


def test_refused_filters():
    dancer = load_performer("dance")
    with pytest.raises(MotionError, match="motion dance.*cutoff"):
        smooth_hands(dancer, cutoff=1e3)
    # Almost half a turn in every sample leaves no mean.
    spin = turning(3.1, 200).as_matrix()
    with pytest.raises(MotionError, match="left_hand turns so fast"):
        smooth_hands(dataclasses.replace(dancer, hands={"left_hand": spin}), 1.0)
