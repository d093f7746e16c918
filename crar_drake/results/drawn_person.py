"""A person beside the robots of a page: bones between joint centres."""

import numpy as np
from pydrake.geometry import Capsule, Meshcat, Rgba
from scipy.spatial.transform import Rotation

from crar_drake.motion.performer import PARENTS, Performer
from crar_drake.results.drawn_robot import MOST_NEAR, outermost

_SKIN = Rgba(0.82, 0.66, 0.52, 1.0)
_THICK = 0.025  # radius of a bone, of a person with hips as high as 1 m [m]


class DrawnPerson:
    """A person whose hips are as high as a robot's root, drawn into Meshcat once.

    Attributes:
        prefix: the path in Meshcat under which the bones are.
        paths: (B,) in Meshcat, of the bones.
        spheres: none, as of a `DrawnRobot`.
    """

    def __init__(
        self,
        person: Performer,
        meshcat: Meshcat,
        prefix: str,
        root: np.ndarray,
        rate: float,
    ) -> None:
        """
        Args:
            meshcat: to draw into.
            prefix: as of the attribute.
            root: (T, 3) where the robot's root is; the person is scaled by its height,
                and begins above the same place [m].
            rate: of the frames that are wanted [Hz].
        """
        places, hips = person.positions, person.positions["pelvis"]
        scale = float(np.median(root[:, 2]) / max(np.median(hips[:, 2]), 0.1))
        start = np.append(root[0, :2] - scale * hips[0, :2], 0.0)
        times = np.arange(0.0, person.duration + 1e-9, 1.0 / rate)
        frames = np.round(times * person.frame_rate).astype(int)
        frames = np.minimum(frames, person.num_frames - 1)
        at = {name: scale * p[frames] + start for name, p in places.items()}
        bones = [(a, b) for b, a in PARENTS.items() if {a, b} <= set(at)]
        # (F, B, 3) where bones begin, and where they lead from there.
        self._from = np.stack([at[a] for a, _ in bones], axis=1)
        self._along = np.stack([at[b] - at[a] for a, b in bones], axis=1)
        self.prefix, self.spheres = prefix, ()
        self.paths = [f"{prefix}/bone {i}" for i in range(len(bones))]
        lengths = np.median(np.linalg.norm(self._along, axis=2), axis=0)
        for path, length in zip(self.paths, lengths, strict=True):
            bone = Capsule(_THICK * float(np.median(root[:, 2])), max(length, 1e-3))
            meshcat.SetObject(path, bone, _SKIN)

    def record(self) -> dict[str, np.ndarray]:
        """`poses`, `near` and `outline` of `recorded_page.RecordedRun`."""
        F, B, _ = self._along.shape
        # The shortest turn of z to the bone: half way to it, twice.
        way = self._along / np.maximum(
            np.linalg.norm(self._along, axis=2, keepdims=True), 1e-9
        )
        half = way + [0.0, 0.0, 1.0 + 1e-9]
        turns = np.concatenate(
            (np.cross([0.0, 0.0, 1.0], half), half[..., 2:]), axis=2
        ).reshape(-1, 4)
        turns = Rotation.from_quat(turns).as_quat().reshape(F, B, 4)
        poses = np.concatenate((self._from + 0.5 * self._along, turns), axis=2)
        return {
            "poses": poses,
            "near": np.full((F, MOST_NEAR, 8), np.nan),
            "outline": outermost((self._from + self._along).reshape(-1, 3)),
        }
