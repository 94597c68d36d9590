"""Instruments and takes of the desk whose values are worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np

from tonewood.workshop.desk.playback import DeskSound

FS = 1000  # a fade lasts 30 frames, the margin 40


class Take:
    """A phrase of one value on the left, of its negative on the right."""

    def __init__(self, value: float, frames: int = 100):
        self.value, self.length, self.frames, self.begun = value, frames, frames, 0

    def read(self, start: int, frames: int) -> Any:
        n = max(min(frames, self.length - start), 0)
        return np.tile(np.float32([self.value, -self.value]), (n, 1))

    def again(self) -> Take:
        self.begun += 1
        return self


def sounding(value: float, frames: int = 100, at: int = 0) -> DeskSound:
    sound = DeskSound(FS)
    sound.swap(Take(value, frames))  # type: ignore[arg-type]
    sound.start()
    if at:
        sound.read(at)
    return sound
