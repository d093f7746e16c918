"""What differs between the versions of Drake that this package runs with.

The installer takes another Drake for another Python: 1.51 is the newest for 3.11, later
ones need 3.12. Everything else in the package uses what they have in common.
"""

from __future__ import annotations

from pydrake.systems.analysis import SimulatorConfig
from pydrake.visualization import VisualizationConfig

# Drake's configuration and a setting that only some versions have, with what the others
# do instead. A scenario in a log has every setting of the Drake that wrote it.
_SETTINGS_OF_SOME = {
    # 1.51, no longer 1.58
    ("simulator_config", "publish_every_time_step"): (SimulatorConfig, False),
    # 1.58, not yet 1.51
    ("visualization", "mouse_interaction_stiffness"): (VisualizationConfig, 100.0),
}


def settings_of_others() -> dict[tuple[str, str], bool | float]:
    """Settings of a scenario that the Drake which is installed does not have.

    Returns:
        The way to each, its two keys, to what this Drake does anyway. A scenario that
        asks for that can be read without the setting.
    """
    return {
        way: usual
        for way, (config, usual) in _SETTINGS_OF_SOME.items()
        if way[1] not in {field.name for field in config().__fields__}
    }
