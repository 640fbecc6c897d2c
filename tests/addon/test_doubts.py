"""What the panel says about lamps where they are now."""

from dataclasses import replace

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import panel, sessions  # noqa: E402

from .drawing import draw, paragraph  # noqa: E402


def said() -> str:
    return paragraph(draw(panel.LIGHTPANES_PT_results))


def move(place):
    bpy.data.objects["Lamp"].location = place
    bpy.context.view_layer.update()
    bpy.ops.lightpanes.relight()


def test_the_panel_warns_of_lamps_where_light_is_not_known(room, quick):
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    assert "Lamp 'Lamp'" not in said()
    move((0.3, 0.2, -0.75))  # the block's middle
    assert "Lamp 'Lamp' lights nothing that was baked" in said()
    move((-0.3, -0.2, 0.4))
    assert "Lamp 'Lamp'" not in said()
    # a bake that is as good as was asked for, and a lamp that nearly touches the wall
    current = sessions.of(room)
    current.expected = replace(current.expected, target=0.03, error=0.02, grows=0.02)
    move((-0.99, 0, 0))
    assert "Lamp 'Lamp' is so close to a surface that the light it bounces is wrong by about " in said()
    assert "where 3.0 % was asked for" in said()
