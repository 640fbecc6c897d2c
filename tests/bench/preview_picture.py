"""The picture of the preview engine in the README: `make preview` leaves it in out/pictures/preview.png."""

import bpy
import lightpanes

from . import harness, scenes

SAMPLE, PERCENT, SAMPLES = "two_rooms", 60, 64


def main() -> None:
    """Render the sample with the engine, as a user does."""
    target = harness.ROOT / "out" / "pictures" / "preview.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    lightpanes.register()
    bpy.ops.wm.open_mainfile(filepath=str(scenes.FOLDER / f"{SAMPLE}.blend"))
    scene = bpy.context.scene
    scene.render.engine = "LIGHTPANES"
    scene.lightpanes.samples = SAMPLES
    scene.render.resolution_percentage = PERCENT
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.compression = 100
    # where the file lies is nobody's business
    scene.render.use_stamp_filename = False
    scene.render.filepath = str(target)
    bpy.ops.render.render(write_still=True)
    print(f"Wrote {target}")


if __name__ == "__main__":
    main()
