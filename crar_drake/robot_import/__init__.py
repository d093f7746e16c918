"""From a robot's own URDF, SDF or MJCF to a folder that the controller can use.

`import_robot` is the whole way; `docs/guides/your-robot.md` walks it. Needs the
optional dependencies of the extra `robots`.

Words of all modules: a `robot` is turned so that x is its front and z up, once
`structure.face_ahead` has seen it. `anatomy` are its arms, None if it has no two.
`segments` are the looks that capsules are fitted to, several links' together where
they share them; `frames` says where a motion's points are, and `X` are the links' poses
with joints at 0.
"""

from crar_drake.robot_import.choices import ImportChoices, load_choices
from crar_drake.robot_import.import_report import ImportReport
from crar_drake.robot_import.importer import check_installed, import_robot

__all__ = [
    "ImportChoices",
    "ImportReport",
    "check_installed",
    "import_robot",
    "load_choices",
]
