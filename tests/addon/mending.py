"""Finding obstacles and pressing their buttons."""

import bpy
from lightpanes.addon import preflight


def found(kind):
    return [obstacle for obstacle in preflight.examine(bpy.context).obstacles if obstacle.kind == kind]


def press(obstacle):
    return bpy.ops.lightpanes.fix(**obstacle.properties)


def mend(kind):
    """Press the button of the one obstacle of this kind, which is gone then; returns the obstacle."""
    (obstacle,) = found(kind)
    assert obstacle.button
    assert press(obstacle) == {"FINISHED"}
    assert not found(kind)
    return obstacle


def without_fix(kind):
    (obstacle,) = found(kind)
    assert not obstacle.button
    return obstacle


def add(scene, name, data, collection=None):
    item = bpy.data.objects.new(name, data)
    (collection or scene.collection).objects.link(item)
    bpy.context.view_layer.update()
    return item


def bakes():
    return bpy.ops.lightpanes.bake() == {"FINISHED"}
