"""A note of an instrument, rendered with one setting or another, once or with forces a little apart."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.lab.accuracy.partials import PartialErrors, compare
from tonewood.lab.accuracy.timing import Task, Tell, measure, silent
from tonewood.performance.score.note import Note, Score
from tonewood.sound.render.renderer import Renderer
from tonewood.support.arrays import Floats

#: of the note; s of it, from when on partials are compared
VELOCITY_MIDI, STEADY = 64, 0.1
#: a little more force; share of a limit that it may change before strokes are compared by their means
NUDGE, SENSITIVE = (1.001,), 0.2
#: how far forces of such strokes lie to either side
SPREAD = 0.01


@dataclass(frozen=True, slots=True)
class Strokes:
    """Sounds of one note with one setting.

    sounds : (n_strokes, n).
    seconds : of computing per second of sound.
    n_modes : stepped.
    """

    sounds: Floats
    seconds: float
    n_modes: int

    def halves(self) -> tuple[Strokes, Strokes]:
        """Every other stroke, and those between."""
        one, other = (Strokes(self.sounds[i::2], self.seconds, self.n_modes) for i in (0, 1))
        return one, other


def forces(n: int) -> tuple[float, ...]:
    """Factors of n strokes, spread evenly."""
    return tuple(1 + SPREAD * (2 * (np.arange(n) + 0.5) / n - 1))


@dataclass(frozen=True, slots=True)
class NoteCase:
    """A note of one string.

    instrument, string, stop : of the note.
    force : N or m/s, as the exciter has it.
    let_go : s, of a note that is driven until then; 0 if it is left alone from the first.
    duration : s of sound.
    fs : Hz of the sound.
    """

    instrument: Instrument
    string: str
    stop: int
    force: float
    let_go: float
    duration: float
    fs: int

    @classmethod
    def of(
        cls, instrument: Instrument, string: str, duration: float, *, stop: int = 0, force: float | None = None,
        fs: int = 48000,
    ) -> NoteCase:  # fmt: skip
        """With the force of a velocity in the middle, if none is given."""
        note = Note(
            0.0, duration, string=string, stop=stop, force=force, velocity_midi=None if force else VELOCITY_MIDI
        )
        renderer = Renderer(Score([note]), instrument, fs)
        motions = [m for play in renderer.performance.timeline.plays for m in play.gesture.motions]
        force = renderer.model.playing.velocity.value(VELOCITY_MIDI) if force is None else force
        # a partner that moves at a velocity goes on giving energy
        let_go = 0.5 * duration if any(m.quantity == "velocity" for m in motions) else 0.0
        return cls(instrument, string, stop, force, let_go, duration, fs)

    def renderer(
        self, options: Mapping[str, Any], *, factor: float = 1.0, overrides: Mapping[str, Any] | None = None
    ) -> Renderer:
        """Return a renderer of the note with some options, so many times the force, and overrides of the bundle."""
        instrument = self.instrument.replace(overrides) if overrides else self.instrument
        duration = self.let_go or self.duration
        note = Note(0.0, duration, string=self.string, stop=self.stop, force=self.force * factor)
        return Renderer(Score([note]), instrument, self.fs, max_duration=self.duration, **options)

    def strokes(
        self,
        options: Mapping[str, Any],
        factors: Sequence[float] = (1.0,),
        overrides: Mapping[str, Any] | None = None,
    ) -> Strokes:
        """Render the note with each factor of force; seconds are processor time of this thread."""
        sounds, spent, heard, n_modes = [], 0.0, 0.0, 0
        for factor in factors:
            renderer = self.renderer(options, factor=factor, overrides=overrides)
            began = time.thread_time()
            sounds.append(np.concatenate(list(renderer.blocks(4096)))[:, 0])
            spent, heard = spent + time.thread_time() - began, heard + len(sounds[-1]) / self.fs
            n_modes = renderer.model.n_modes
        shortest = min(len(sound) for sound in sounds)
        return Strokes(np.stack([sound[:shortest] for sound in sounds]), spent / heard, n_modes)

    def timed(self, options: Sequence[Mapping[str, Any]], repeats: int, tell: Tell = silent) -> list[float]:
        """Seconds of computing per second of sound with each of some options: medians of renders that take turns."""
        tasks = []
        for setting in options:
            renderer = self.renderer(setting)
            start = renderer.snapshot()

            def play(renderer: Renderer = renderer) -> None:
                for _ in renderer.blocks(4096):
                    pass

            def restore(renderer: Renderer = renderer, start: Any = start) -> None:
                renderer.restore(start)

            tasks.append(Task(play, self.duration, restore))
        return [timing.median for timing in measure(tasks, repeats, tell)]

    def errors(self, strokes: Strokes, truth: Strokes) -> PartialErrors:
        """Compare strokes with others."""
        freq = self.instrument.tuning.freq(self.instrument.open_note(self.string) + self.stop)
        skip = int(STEADY * self.fs)
        let_go = self.let_go and self.let_go - STEADY
        return compare(strokes.sounds[:, skip:], truth.sounds[:, skip:], self.fs, freq, let_go)
