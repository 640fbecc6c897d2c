"""Progress as lines on the console."""

from __future__ import annotations

# A line for each stage and each tenth.
STEP = 0.1


class ConsoleProgress:
    """Progress as lines on the console and, in a window, as the cursor's number."""

    def __init__(self, window_manager):
        self.window_manager = window_manager
        self.stage, self.tenth = "", -1

    def __enter__(self):
        self.window_manager.progress_begin(0, 100)
        return self

    def __exit__(self, *_):
        self.window_manager.progress_end()

    def __call__(self, progress) -> None:
        self.window_manager.progress_update(100 * progress.fraction)
        tenth = int(progress.fraction / STEP)
        if progress.stage != self.stage or tenth != self.tenth:
            self.stage, self.tenth = progress.stage, tenth
            print(f"Lightpanes: {100 * progress.fraction:3.0f} %  {progress.stage}")
