"""Keeps the world's light off surfaces in EEVEE, which would add it, unshadowed, to the sky that a bake holds.

Beside the user's nodes stands a second World Output, which only EEVEE reads: it shows the world to the camera alone.
All nodes of ours are tagged; without them the tree is what it was.
"""

from __future__ import annotations

import bpy

from . import environment
from .nodes import FORMER, NO_NODES, NODE_TAG


def is_hidden(world: bpy.types.World) -> bool:
    """Whether our nodes are in the world."""
    return world.node_tree is not None and any(NODE_TAG in node for node in world.node_tree.nodes)


def shines(world: bpy.types.World | None) -> bool:
    """Whether the world lights diffuse surfaces, as far as its nodes show it plainly: what varies is taken to shine."""
    if not environment.lights_surfaces(world):
        return False
    plain = environment.plain(world)
    return plain is None or bool(plain.any())


def hide(world: bpy.types.World) -> None:
    """Let EEVEE show the world to the camera and light nothing with it."""
    if is_hidden(world):
        return
    sources: dict[str, bpy.types.NodeSocket] = {}
    former = None
    if _uses_nodes(world):
        former = world.node_tree.get_output_node("EEVEE")
        if former is not None:
            sources = {socket.name: socket.links[0].from_socket for socket in former.inputs if socket.is_linked}
    else:
        sources["Surface"] = _plain(world)
    tree = world.node_tree
    ray, mix, output = (
        _node(tree, kind) for kind in ("ShaderNodeLightPath", "ShaderNodeMixShader", "ShaderNodeOutputWorld")
    )
    output.target = "EEVEE"
    output.label = "Lightpanes"
    place = former.location if former is not None else (0.0, 0.0)
    for node, step in ((ray, 0), (mix, 200), (output, 400)):
        node.location = (place[0] + step, place[1] - 200)
    tree.links.new(ray.outputs["Is Camera Ray"], mix.inputs[0])
    for name, source in sources.items():
        tree.links.new(source, mix.inputs[2] if name == "Surface" else output.inputs[name])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    _activate(output, former)


def give_back(world: bpy.types.World | None) -> None:
    """Take our nodes out again."""
    if world is None or world.library is not None or world.node_tree is None:
        return
    nodes = world.node_tree.nodes
    ours = [node for node in nodes if NODE_TAG in node]
    former = [name for node in ours if (name := node.get(FORMER, "")) in nodes]
    for node in ours:
        nodes.remove(node)
    for name in former:
        nodes[name].is_active_output = True
    if NO_NODES in world:
        del world[NO_NODES]
        world.use_nodes = False


def _uses_nodes(world) -> bool:
    # from 5.0 on nodes count whenever they exist, and asking is deprecated
    return world.node_tree is not None and (bpy.app.version >= (5, 0) or world.use_nodes)


def _plain(world) -> bpy.types.NodeSocket:
    """Give nodes to a world that is one colour; returns what shines with it, which Cycles goes on showing."""
    color = tuple(world.color)
    world.use_nodes = True
    world[NO_NODES] = 1
    background, output = (_node(world.node_tree, kind) for kind in ("ShaderNodeBackground", "ShaderNodeOutputWorld"))
    background.inputs["Color"].default_value = (*color, 1.0)
    output.target = "CYCLES"
    world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])
    _activate(output, world.node_tree.get_output_node("CYCLES"))
    return background.outputs[0]


def _activate(output, former) -> None:
    """Let the engine read this output; one that is for this engine alone wins over one that is for all."""
    if former is not None and output.id_data.get_output_node(output.target) != output:
        output[FORMER] = former.name
        output.is_active_output = True


def _node(tree, kind: str) -> bpy.types.Node:
    active = tree.nodes.active
    node = tree.nodes.new(kind)
    node[NODE_TAG] = 1
    node.select = False
    tree.nodes.active = active
    return node
