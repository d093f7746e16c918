"""A port for one part of a controller's diagnostics, to be logged."""

import numpy as np
from pydrake.systems.framework import DiagramBuilder, OutputPort
from pydrake.systems.primitives import Selector, SelectorParams

from crar_drake.law.controller import CrarController


def part_port(
    builder: DiagramBuilder, controller: CrarController, name: str
) -> OutputPort:
    """A port that has this part of `diagnostics` alone, or the whole of it."""
    if name not in controller.diagnostics_slices:
        return controller.GetOutputPort(name)
    everything = controller.get_output_port_diagnostics()
    place = controller.diagnostics_slices[name]
    return select_entries(builder, everything, place, name)


def select_entries(
    builder: DiagramBuilder, port: OutputPort, entries: np.ndarray | slice, name: str
) -> OutputPort:
    """A port with some entries of another one, by Drake's Selector.

    Args:
        port: of a vector.
        entries: of it, by number (k,), or a slice.
        name: of the Selector, in the diagram.
    """
    params = SelectorParams
    output = params.OutputPortParams(
        name=name,
        selections=[
            params.OutputSelection(input_port_index=0, input_offset=int(entry))
            for entry in np.arange(port.size())[entries]
        ],
    )
    inputs = [params.InputPortParams(name=port.get_name(), size=port.size())]
    selector = Selector(params(inputs=inputs, outputs=[output]))
    some = builder.AddNamedSystem(name, selector)
    builder.Connect(port, some.get_input_port())
    return some.get_output_port()
