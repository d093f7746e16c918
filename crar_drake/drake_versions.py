"""What differs between the versions of Drake that this package runs with.

The installer takes another Drake for another Python: 1.51 is the newest for 3.11, later
ones need 3.12. Everything else in the package uses what they have in common.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.common.yaml import yaml_dump, yaml_load
from pydrake.multibody.plant import MultibodyPlantConfig
from pydrake.systems.analysis import SimulatorConfig
from pydrake.visualization import VisualizationConfig

from crar_drake.errors import ScenarioError

# Key of a scenario to Drake's own configuration below it.
DRAKE_CONFIGS = {
    "plant_config": MultibodyPlantConfig,
    "simulator_config": SimulatorConfig,
    "visualization": VisualizationConfig,
}

# Settings that only some versions have, with what the others do instead. A scenario in
# a log has every setting of the Drake that wrote it.
_SETTINGS_OF_SOME = {
    ("simulator_config", "publish_every_time_step"): False,  # 1.51, no longer 1.58
    ("visualization", "mouse_interaction_stiffness"): 100.0,  # 1.58, not yet 1.51
}


def setting_names() -> set[str]:
    """The names of all settings of Drake's that a scenario may have."""
    return {name for config in DRAKE_CONFIGS for name in _known(config)}


def for_this_drake(text: str) -> str:
    """A scenario's YAML text without the settings that another Drake has.

    They go where they say what this Drake does anyway. The text is otherwise
    unchanged, comments and all, if there are none.

    Args:
        text: YAML.

    Raises:
        ScenarioError: one of them says something else; the message names it.
    """
    foreign = [
        (config, name)
        for config, name in _SETTINGS_OF_SOME
        if name not in _known(config) and name in text
    ]
    return _without(text, foreign) if foreign else text


def _without(text: str, foreign: Sequence[tuple[str, str]]) -> str:
    scenario = yaml_load(data=text)
    if not isinstance(scenario, dict):
        return text
    dropped = False
    for config, name in foreign:
        settings = scenario.get(config)
        if not isinstance(settings, dict) or name not in settings:
            continue
        value, usual = settings.pop(name), _SETTINGS_OF_SOME[config, name]
        if value != usual:
            raise ScenarioError(
                f"{config}.{name}: {value}: the Drake that is installed does not have "
                f"this setting, and does as if it were {usual}; leave it out"
            )
        dropped = True
    return yaml_dump(scenario) if dropped else text


def _known(config: str) -> set[str]:
    return {f.name for f in DRAKE_CONFIGS[config]().__fields__}
