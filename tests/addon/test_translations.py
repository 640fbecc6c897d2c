"""All that the interface says is there in German, and no more."""

import ast
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from lightpanes.addon import obstacles, panel, preferences, properties, translations, twice  # noqa: E402
from lightpanes.core.bake.clock import Clock  # noqa: E402

from .drawing import Context, draw  # noqa: E402


def constants():
    """All texts in the source of the interface, and the stages of a bake."""
    found = {*Clock.STAGES, Clock.JUDGING}
    for path in Path(translations.__file__).parent.glob("*.py"):
        if path.name != "translations.py":
            found |= {
                node.value
                for node in ast.walk(ast.parse(path.read_text("utf-8")))
                if isinstance(node, ast.Constant) and isinstance(node.value, str)
            }
    return found


def interface():
    """(context, text) of all names, tooltips and labels of the settings, the preferences and the panels."""
    said = set()
    for group in (properties.SceneSettings, properties.ObjectSettings, properties.LightSettings,
                  preferences.LightpanesPreferences):  # fmt: skip
        for item in group.bl_rna.properties:
            if item.identifier in {"rna_type", "name", "bl_idname"} or item.is_hidden:
                continue
            said |= {item.name, item.description}
            for choice in getattr(item, "enum_items", ()) or ():
                said |= {choice.name, choice.description}
    said |= {cls.bl_label for cls in panel.CLASSES} | set(panel.ERROR_PARTS.values()) | {*Clock.STAGES, Clock.JUDGING}
    return {text for text in said if text} - {"Lightpanes"}


def test_everything_is_translated(room, quick):
    assert interface() <= translations.GERMAN.keys()
    before = shown()
    room.lightpanes.live = False
    assert bpy.ops.lightpanes.bake() == {"FINISHED"}
    for kind, text in before | shown():
        assert text in (translations.GERMAN if kind == "label" else translations.GERMAN_BUTTONS), text


def shown():
    """(kind, text) of all that the panels draw now and Blender looks up."""
    context = Context(object=bpy.data.objects["Block"], light=bpy.data.lights["Lamp"])
    drawn = [entry for cls in panel.CLASSES for entry in draw(cls, context) or ()]
    labels = {("label", entry[1]) for entry in drawn if entry[0] == "label" and entry[1] and entry[2]}
    return labels | {("operator", entry[2]) for entry in drawn if entry[0] == "operator" and entry[2]}


def test_every_button_of_an_obstacle_is_translated():
    for module in (obstacles, twice):
        tree = ast.parse(Path(module.__file__).read_text("utf-8"))
        for call in ast.walk(tree):
            if not isinstance(call, ast.Call) or getattr(call.func, "id", "") != "Obstacle":
                continue
            given = call.args[4:5] + [word.value for word in call.keywords if word.arg == "button"]
            for node in (n for part in given for n in ast.walk(part)):
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value:
                    assert node.value in translations.GERMAN_BUTTONS


def test_nothing_is_translated_that_is_not_there():
    texts_there = constants()
    for text in (*translations.GERMAN, *translations.GERMAN_BUTTONS):
        assert text in texts_there, text


def test_translations_keep_their_gaps():
    for text, german in (*translations.GERMAN.items(), *translations.GERMAN_BUTTONS.items()):
        assert text.count("{}") == german.count("{}")
        assert not german.endswith(".") and german.strip()
