"""Draws panels without a window."""

from types import SimpleNamespace

import bpy
from lightpanes.addon import panel

ICONS = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys()


class Recorder:
    """Stands in for a UILayout: notes what is drawn, and refuses what Blender would."""

    def __init__(self, drawn=None):
        self.drawn = [] if drawn is None else drawn
        self.enabled = True

    def _part(self, *_, **__):
        part = Recorder(self.drawn)
        part.enabled = self.enabled
        return part

    row = column = box = split = _part

    def separator(self):
        pass

    def label(self, text="", icon="NONE", translate=True):
        assert icon in ICONS
        self.drawn.append(("label", text, translate))

    def prop(self, data, name, text=None, translate=True, **_):
        assert name in data.bl_rna.properties
        self.drawn.append(("prop", name, text))

    def operator(self, name, text=None, icon="NONE"):
        assert icon in ICONS
        group, _, rest = name.partition(".")
        kind = getattr(getattr(bpy.ops, group), rest).get_rna_type()
        self.drawn.append(("operator", name, text or kind.name))
        button = SimpleNamespace(enabled=self.enabled, properties=kind.properties)
        self.drawn[-1] += (button,)
        return button


class Context:
    """The context, as in a Properties editor 400 px wide."""

    region = SimpleNamespace(width=400)
    # without a window there is no scale
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))

    def __init__(self, **more):
        self.__dict__.update(more)

    def __getattr__(self, name):
        return getattr(bpy.context, name)


def draw(cls, context=None):
    """What a panel draws: (kind, name or text, …) each; None where it does not show."""
    context = context or Context()
    if hasattr(cls, "poll") and not cls.poll(context):
        return None
    shown = type("Shown", (panel._Panel,), {})()
    shown.layout = Recorder()
    cls.draw(shown, context)
    return shown.layout.drawn


def texts(drawn, kind="label"):
    return [entry[1] for entry in drawn if entry[0] == kind]


def value(drawn, label):
    """What stands beside a label."""
    found = texts(drawn)
    return found[found.index(label) + 1]


def paragraph(drawn):
    """All labels as one text, wrapped sentences made whole again."""
    return " ".join(texts(drawn))
