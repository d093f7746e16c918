"""From a robot's own URDF, SDF or MJCF to a folder that the controller can use.

`import_robot` is the whole way; `docs/guides/your-robot.md` walks it. Needs the
optional dependencies of the extra `robots`.
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
