"""A Meshcat that tells what was drawn into it."""

import numpy as np
from pydrake.geometry import Meshcat


class SpyMeshcat(Meshcat):
    """A Meshcat that also remembers what Python asked of it."""

    def __init__(self) -> None:
        super().__init__()
        self.visibility: list[tuple[str, bool, float]] = []
        self.moved: list[tuple[str, np.ndarray, float]] = []
        self.cameras: list[tuple[np.ndarray, np.ndarray]] = []

    def forget(self) -> None:
        self.visibility.clear()
        self.moved.clear()
        self.cameras.clear()

    def SetProperty(self, path, name, value, time_in_recording=None):
        if name == "visible" and time_in_recording is not None:
            self.visibility.append((path, value, time_in_recording))
        super().SetProperty(path, name, value, time_in_recording)

    def SetTransform(self, path, X_ParentPath, time_in_recording=None):
        if time_in_recording is not None:
            self.moved.append((path, X_ParentPath.translation(), time_in_recording))
        super().SetTransform(path, X_ParentPath, time_in_recording)

    def SetCameraPose(self, camera_in_world, target_in_world):
        self.cameras.append((camera_in_world, target_in_world))
        super().SetCameraPose(camera_in_world, target_in_world)
