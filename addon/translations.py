"""The interface in other languages. Blender looks up what it draws here, by the English text."""

from __future__ import annotations

import bpy

# Names, tooltips and labels.
GERMAN = {
    "Quality": "Qualität",
    "Advanced": "Erweitert",
    "Lamps": "Lampen",
    "Results": "Ergebnis",
    "Output": "Ausgabe",
    "Debug Views": "Prüfansichten",
    "Objects": "Objekte",
    "Light At": "Licht an",
    "Time": "Zeit",
    "Memory": "Speicher",
    "Error": "Fehler",
    "Panes": "Scheiben",
    "Noise": "Rauschen",
    "Lamp Sampling": "Lampenabtastung",
    "Worst 5 %": "Schlechteste 5 %",
    "Bound By": "Begrenzt durch",
    "Make an image over the atlas of where the bake is wrong: blue is well below the error that was asked for, green "
    "is that error, red four times it": "Ein Bild über dem Atlas, das zeigt, wo das Backergebnis falsch ist: Blau liegt "
    "weit unter dem verlangten Fehler, Grün ist dieser Fehler, Rot das Vierfache",
    "Points": "Punkte",
    "Rays": "Strahlen",
    "Last Relight": "Letzte Neubeleuchtung",
    "Size": "Größe",
    "Relight": "Neu beleuchten",
    "Triangles": "Dreiecke",
    "Surfaces": "Flächen",
    "Pilot": "Probelauf",
    "Transport": "Transport",
    "Exits": "Ausgänge",
    "Check": "Prüfung",
    "Judging": "Beurteilung",
    "Entries": "Einträge",
    "Atlas": "Atlas",
    "Reading the scene": "Szene lesen",
    "Storing": "Speichern",
    "Done": "Fertig",
    "Waiting for the cancelled bake": "Warten auf das abgebrochene Backen",
    "Waiting for the render": "Warten auf das Rendering",
    "Waiting for you to leave Edit Mode": "Warten, bis der Edit-Modus verlassen ist",
    "Waiting for you to leave Sculpt Mode": "Warten, bis der Sculpt-Modus verlassen ist",
    "Regions": "Regionen",
    "Texels": "Texel",
    "Group": "Gruppe",
    "Lamps of one group share an image wherever baked light is written by group":
        "Lampen einer Gruppe teilen sich ein Bild, wo gebackenes Licht nach Gruppen geschrieben wird",
    "No Group": "Ohne Gruppe",
    "By Group": "Nach Gruppen",
    "Also write an image for each group of lamps, for those without one, and for the light that no lamp changes. "
    "Together they are the whole":
        "Auch je ein Bild für jede Gruppe von Lampen, für die ohne Gruppe und für das Licht, das keine Lampe ändert. "
        "Zusammen sind sie das Ganze",
    "No lamps": "Keine Lampen",
    "Baked In": "Eingebacken",
    "{} more": "{} weitere",
    "{} at vertices": "{} an Vertices",
    "{} excluded": "{} ausgeschlossen",
    "{} only block light": "{} halten nur Licht auf",
    "{} points": "{} Punkte",
    "{} texels": "{} Texel",
    "{} live": "{} live",
    "{} baked in": "{} eingebacken",
    "Relative error of the indirect light to bake for: smaller is more exact and slower":
        "Relativer Fehler des indirekten Lichts, für den gebacken wird: kleiner ist genauer und langsamer",
    "GiB of memory that a bake may take beside what Blender has already. It works in smaller chunks and with fewer threads "
    "where that is little, and says so before it starts where it can't do with it": "GiB Speicher, die ein Backvorgang "
    "neben dem von Blender belegten nehmen darf. Wo das wenig ist, arbeitet er in kleineren Stücken und mit weniger "
    "Threads, und wo es nicht reicht, sagt er das vor dem Beginn",
    "Seconds that a bake may take, 0 for no limit. The error then is what the time allows":
        "Sekunden, die das Backen dauern darf, 0 ohne Grenze. Der Fehler ist dann so klein, wie es die Zeit erlaubt",
    "Resolution": "Auflösung",
    "Width and height of the atlas in pixels, shared by all baked objects":
        "Breite und Höhe des Atlas in Pixeln, den sich alle gebackenen Objekte teilen",
    "Where the bake gathers light": "Wo beim Backen Licht gesammelt wird",
    "Automatic": "Automatisch",
    "At points where that is less work than at every texel": "An Punkten, wo das weniger Arbeit ist als an jedem Texel",
    "At points, dense where light changes, between which texels are interpolated":
        "An Punkten, dicht wo sich das Licht ändert, zwischen denen Texel interpoliert werden",
    "At every texel. Objects that are lit at their vertices need points all the same":
        "An jedem Texel. Objekte, die an ihren Vertices beleuchtet werden, brauchen trotzdem Punkte",
    "Points, Spread to Texels": "Punkte, auf Texel verteilt",
    "At points, whose panes every texel then gets, as game engines read them":
        "An Punkten, deren Scheiben dann jeder Texel bekommt, so wie Spiele-Engines sie lesen",
    "Live": "Live",
    "Let the indirect light follow the lamps at once when they move or change":
        "Das indirekte Licht folgt den Lampen sofort, wenn sie sich bewegen oder ändern",
    "Direct Light": "Direktes Licht",
    "Last Direct Light": "Letztes direktes Licht",
    "What brings the lamps' direct light to baked objects. Objects lit at their vertices, and those that "
    "are not baked, get it from the engine either way":
        "Woher gebackene Objekte das direkte Licht der Lampen bekommen. An Vertices beleuchtete und nicht gebackene "
        "Objekte bekommen es immer von der Engine",
    "Engine": "Engine",
    "The engine that renders: the lamps shine as ever": "Von der Engine, die rendert: die Lampen leuchten wie immer",
    "Baked": "Gebacken",
    "The image Lightpanes Direct, soft shadows included, live as lamps move. Lamps then leave baked objects "
    "alone, by light linking":
        "Aus dem Bild Lightpanes Direct, samt weicher Schatten, live mit den Lampen. Die Lampen selbst beleuchten "
        "gebackene Objekte dann nicht (Light Linking)",
    "Samples": "Samples",
    "Samples of this lamp for its soft shadows where direct light is baked. 0: as many as the error asks "
    "for":
        "Samples dieser Lampe für ihre weichen Schatten, wo direktes Licht gebacken wird. 0: so viele, wie der Fehler "
        "verlangt",
    "Caustics": "Kaustiken",
    "Follow the lamps' light through glass and off metals to where it is focused, in the image Lightpanes "
    "Caustics. A scene without smooth glass or metal does nothing for it":
        "Das Licht der Lampen durch Glas und über Metall bis dorthin verfolgen, wo es gebündelt auftrifft: im Bild "
        "Lightpanes Caustics. Eine Szene ohne glattes Glas oder Metall tut nichts dafür",
    "Photons": "Photonen",
    "Photons of each lamp that caustics are made of. 0: as many as the error asks for":
        "Photonen jeder Lampe, aus denen Kaustiken gemacht werden. 0: so viele, wie der Fehler verlangt",
    "Caustics Of": "Kaustiken von",
    "Last Caustics": "Letzte Kaustiken",
    "Sampling": "Sampling",
    "Frames of one sample a pixel that a render with the engine Lightpanes adds up":
        "Bilder mit einem Sample je Pixel, die ein Rendering mit der Engine Lightpanes mittelt",
    "Viewport": "Ansicht",
    "Frames that a viewport adds up before it rests": "Bilder, die eine Ansicht mittelt, bevor sie ruht",
    "Bounces": "Reflexionen",
    "Diffuse bounces of indirect light where no bake knows it, at most":
        "Diffuse Reflexionen des indirekten Lichts, wo es nicht gebacken ist, höchstens",
    "Seed": "Seed",
    "The same seed gives the same bake": "Derselbe Seed ergibt dasselbe Ergebnis",
    "Show in Cycles": "In Cycles zeigen",
    "Cycles shows the baked indirect light too. While this is on, Cycles' own diffuse bounces are set "
    "to 0, so that no light counts twice":
        "Auch Cycles zeigt das gebackene indirekte Licht. Solange dies an ist, stehen Cycles' eigene diffuse "
        "Reflexionen auf 0, damit kein Licht doppelt zählt",
    "Draw the points that hold the light in the 3D viewports":
        "Die Punkte, die das Licht halten, in den 3D-Ansichten zeichnen",
    "None": "Keine",
    "No points": "Keine Punkte",
    "Radius": "Radius",
    "Coloured by the distance that they keep: dark where they are dense":
        "Gefärbt nach ihrem Abstand: dunkel, wo sie dicht sind",
    "Occlusion": "Verdeckung",
    "Coloured by ambient occlusion: dark where things are near":
        "Gefärbt nach Umgebungsverdeckung: dunkel, wo etwas nahe ist",
    "Irradiance": "Bestrahlungsstärke",
    "Coloured by the light that they hold now": "Gefärbt nach dem Licht, das sie jetzt halten",
    "Exclude": "Ausschließen",
    "Keep this object out of the atlas: it gets no baked light, but still blocks and reflects it":
        "Dieses Objekt bekommt keinen Platz im Atlas: kein gebackenes Licht, aber es wirft Schatten und reflektiert",
    "Light In": "Licht in",
    "Where this object keeps its baked light": "Wo dieses Objekt sein gebackenes Licht hält",
    "Texture": "Textur",
    "In its place in the atlas": "An seinem Platz im Atlas",
    "Vertices": "Vertices",
    "In the colour attribute lightpanes_irradiance of its mesh: no UV layer, no place in the atlas":
        "Im Farbattribut lightpanes_irradiance seines Meshs: keine UV-Ebene, kein Platz im Atlas",
    "Weight": "Gewicht",
    "Texels that this object gets in the atlas, relative to its area; 2 doubles their density":
        "Texel, die dieses Objekt im Atlas bekommt, im Verhältnis zu seiner Fläche; 2 verdoppelt ihre Dichte",
    "Follow this lamp after the bake. Off: its light is baked in, which is faster and more exact, and "
    "changes with the next bake only":
        "Dieser Lampe nach dem Backen folgen. Aus: ihr Licht wird eingebacken, was schneller und genauer ist, und "
        "ändert sich erst beim nächsten Backen",
    "Threads": "Threads",
    "Threads that bakes and relights may use, 0 for all cores. Fewer leave Blender more room; "
    "the result is the same":
        "Threads, die Backen und Neubeleuchten nutzen dürfen, 0 für alle Kerne. Weniger lassen Blender mehr Raum; "
        "das Ergebnis ist dasselbe",
    "Images": "Bilder",
    "Where the images of a bake are kept when the .blend is saved":
        "Wo die Bilder beim Speichern der .blend-Datei bleiben",
    "In the .blend": "In der .blend-Datei",
    "Packed: one file holds everything": "Gepackt: eine Datei enthält alles",
    "Beside the .blend": "Neben der .blend-Datei",
    "As 32-bit OpenEXR files in a folder that is named after the .blend":
        "Als OpenEXR-Dateien mit 32 Bit in einem Ordner, der nach der .blend-Datei heißt",
    "Cache Folder": "Cache-Ordner",
    "Where cancelled bakes keep what they had finished, so that baking goes on from there after Blender "
    "was closed. Empty: in memory only":
        "Wo abgebrochene Durchgänge behalten, was fertig war, damit das Backen auch nach einem Neustart von Blender dort "
        "weitergeht. Leer: nur im Arbeitsspeicher",
    "Cache Size": "Cache-Größe",
    "Gigabytes that the cache folder may hold. What was used least recently is deleted first":
        "Gigabyte, die der Cache-Ordner fassen darf. Was am längsten nicht gebraucht wurde, wird zuerst gelöscht",
    "Folder": "Ordner",
    "Where the images go; empty is beside the .blend": "Wohin die Bilder kommen; leer heißt neben die .blend-Datei",
    "Write the baked light as 32-bit OpenEXR images into a folder":
        "Das gebackene Licht als OpenEXR-Bilder mit 32 Bit in einen Ordner schreiben",
}  # fmt: skip

# Labels of buttons, which Blender looks up apart.
GERMAN_BUTTONS = {
    "Show Error": "Fehler zeigen",
    "Bake": "Backen",
    "Bake Again": "Neu backen",
    "Relight": "Neu beleuchten",
    "Clear": "Entfernen",
    "Save Images": "Bilder speichern",
    "Bake Animation": "Animation backen",
    "Fix": "Beheben",
    "Show in Renders": "Im Rendering zeigen",
    "Include All": "Alle einschließen",
    "Leave Edit Mode": "Edit-Modus verlassen",
    "To Object Mode": "In den Objektmodus",
    "Exclude": "Ausschließen",
    "Rename": "Umbenennen",
    "Light At: Automatic": "Licht an: Automatisch",
    "Show Lamps": "Lampen zeigen",
    "Add Lamp": "Lampe hinzufügen",
    "Set Power": "Leistung setzen",
    "Convert to Mesh": "In Mesh umwandeln",
    "Make Real": "Zu Objekten machen",
    "Make Local": "Lokal machen",
    "Use That Bake": "Dieses Ergebnis nutzen",
    "Remove That Light": "Dieses Licht entfernen",
    "Hide from Renders": "Im Rendering ausblenden",
    "Make Single User": "Zum Einzelnutzer machen",
    "Show It to the Camera Only": "Nur der Kamera zeigen",
    "Show It as It Is": "Zeigen, wie sie ist",
    "Keep Reflections Only": "Nur Spiegelungen behalten",
    "Hide Light Probes": "Lichtsonden ausblenden",
    "Direct Light: Engine": "Direktes Licht: Engine",
    "Set Diffuse Bounces to 0": "Diffuse Reflexionen auf 0",
    "Turn Fast GI Off": "Fast GI ausschalten",
    "Turn Caustics Off": "Kaustiken ausschalten",
    "Turn Shadow Caustics Off": "Schatten-Kaustiken ausschalten",
}

_STRINGS = {("*", text): said for text, said in GERMAN.items()}
_STRINGS |= {("Operator", text): said for text, said in GERMAN_BUTTONS.items()}
# Blender has written its name for German both ways
DICTIONARY = {"de": _STRINGS, "de_DE": _STRINGS}


def register() -> None:
    bpy.app.translations.register(__name__, DICTIONARY)


def unregister() -> None:
    bpy.app.translations.unregister(__name__)
