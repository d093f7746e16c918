"""What slides is in metres."""

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from small_urdfs import joint, link, robot

from crar_drake.robot.joints import joint_units


def test_units():
    kinds = {"lift": "prismatic", "turn": "revolute", "roll": "continuous"}
    parts = [link("base")]
    for name, kind in kinds.items():
        parts += [link(f"{name}_link"), joint(name, "base", f"{name}_link", kind=kind)]
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(robot(parts), "urdf")
    plant.Finalize()
    units = joint_units(plant, ["turn", "lift", "roll"])
    assert units == ["rad", "m", "rad"]
