"""Keeps the world's light off surfaces in EEVEE, which would add it, unshadowed, to the sky that a bake holds.

Beside the user's nodes stands a second World Output, which only EEVEE reads: it shows the world to the camera alone.
All nodes of ours are tagged; without them the tree is what it was.
"""

from __future__ import annotations

import bpy

from . import environment
from .nodes import FORMER, NODE_TAG
from .trees import NO_NODES, heeds_nodes

# On our output: the name of the user's, whose world it shows.
_MEANT = "lightpanes_meant"


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
    if heeds_nodes(world):
        meant = world.node_tree.get_output_node("EEVEE")
    else:
        meant = _make_plain(world)
    tree = world.node_tree
    ray, mix, output = (
        _node(tree, kind) for kind in ("ShaderNodeLightPath", "ShaderNodeMixShader", "ShaderNodeOutputWorld")
    )
    output.target = "EEVEE"
    output.label = "Lightpanes"
    place = meant.location if meant is not None else (0.0, 0.0)
    for node, step in ((ray, 0), (mix, 200), (output, 400)):
        node.location = (place[0] + step, place[1] - 200)
    tree.links.new(ray.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    if meant is not None:
        output[_MEANT] = meant.name
        follow(world)
    _activate(output, meant)


def is_outdated(world: bpy.types.World) -> bool:
    """Whether the user's nodes feed their output otherwise than when ours began to show what they give."""
    return any(_source(meant) != _source(shown) for meant, shown in _feeds(world))


def follow(world: bpy.types.World) -> None:
    """Let our nodes show what the user's give by now."""
    for meant, shown in _feeds(world):
        for link in list(shown.links):
            world.node_tree.links.remove(link)
        if meant.is_linked:
            world.node_tree.links.new(meant.links[0].from_socket, shown)


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


def _feeds(world) -> list[tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]]:
    """Pairs of inputs that ought to be fed alike: of the user's output, and of our nodes behind it."""
    tree = world.node_tree
    output = next((node for node in tree.nodes if NODE_TAG in node and getattr(node, "target", "") == "EEVEE"), None)
    if output is None or not output.inputs["Surface"].is_linked:
        return []
    meant = tree.nodes.get(output.get(_MEANT, "")) or tree.get_output_node("CYCLES")
    if meant is None:
        return []
    mix = output.inputs["Surface"].links[0].from_node
    return [(each, mix.inputs[2] if each.name == "Surface" else output.inputs[each.name]) for each in meant.inputs]


def _source(socket) -> tuple[str, str] | None:
    """Names of the node and of its output that feed an input."""
    if not socket.is_linked:
        return None
    link = socket.links[0]
    return link.from_node.name, link.from_socket.identifier


def _make_plain(world) -> bpy.types.Node:
    """Give nodes to a world that is one colour; returns the output that Cycles goes on showing it by."""
    color = tuple(world.color)
    world.use_nodes = True
    world[NO_NODES] = 1
    background, output = (_node(world.node_tree, kind) for kind in ("ShaderNodeBackground", "ShaderNodeOutputWorld"))
    background.inputs["Color"].default_value = (*color, 1.0)
    output.target = "CYCLES"
    world.node_tree.links.new(background.outputs[0], output.inputs["Surface"])
    _activate(output, world.node_tree.get_output_node("CYCLES"))
    return output


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
