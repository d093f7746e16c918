"""A port for one part of a controller's diagnostics, to be logged."""

from pydrake.systems.framework import DiagramBuilder, OutputPort

from crar_drake.control.controller import CrarController
from crar_drake.simulation.diagram import select_entries


def part_port(
    builder: DiagramBuilder, controller: CrarController, name: str
) -> OutputPort:
    """The port of that name, or one that has this part of `diagnostics` alone."""
    if controller.HasOutputPort(name):
        return controller.GetOutputPort(name)
    everything = controller.get_output_port_diagnostics()
    place = controller.diagnostics_slices[name]
    return select_entries(builder, everything, place, name)
