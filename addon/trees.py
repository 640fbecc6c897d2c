"""Node trees as Cycles reads them: which output counts, what feeds an input, and what is constant."""

from __future__ import annotations

import bpy
import numpy as np

CONSTANT_NODES = {"RGB", "VALUE"}

# On materials and worlds that got nodes from us: they had none.
NO_NODES = "lightpanes_no_nodes"


def heeds_nodes(owner: bpy.types.ID) -> bool:
    """Whether Blender takes the look of a material, lamp or world from its nodes."""
    # from 5.0 on nodes count whenever they exist, and asking is deprecated
    return owner.node_tree is not None and (bpy.app.version >= (5, 0) or owner.use_nodes)


def uses_nodes(material: bpy.types.Material) -> bool:
    """Whether its own nodes make its look."""
    return NO_NODES not in material and heeds_nodes(material)


def surface_output(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    """The output that Cycles reads, or would read but for ours, which only shows what was baked."""
    output = tree.get_output_node("CYCLES")
    if output is not None and "lightpanes" in output:
        return tree.nodes.get(output.get("lightpanes_former", ""))
    return output


def source(socket: bpy.types.NodeSocket) -> bpy.types.Node | None:
    """The node that feeds an input, through reroutes and muted nodes; None if nothing does."""
    while socket.is_linked:
        link = next((link for link in socket.links if not link.is_muted), None)
        if link is None:
            return None
        node = link.from_node
        if node.type == "REROUTE":
            socket = node.inputs[0]
        elif node.mute:
            inner = next((inner for inner in node.internal_links if inner.to_socket == link.from_socket), None)
            if inner is None:
                return None
            socket = inner.from_socket
        else:
            return node
    return None


def constant(socket: bpy.types.NodeSocket) -> np.ndarray | float | None:
    """Value of an input: (3,) of a colour, a float, or None where it varies."""
    node = source(socket)
    if node is None:
        value = socket.default_value
    elif node.type in CONSTANT_NODES:
        value = node.outputs[0].default_value
    else:
        return None
    if socket.type == "RGBA":
        return np.array(value[:3]) if hasattr(value, "__len__") else np.full(3, float(value))
    if hasattr(value, "__len__"):
        # a colour into a number: its luminance, as in Cycles
        return float(np.dot(value[:3], (0.2126, 0.7152, 0.0722)))
    return float(value)
