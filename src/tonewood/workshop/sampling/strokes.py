"""Strokes of a sample library: one rendered note each, the ring after its key comes up, and measures of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.performance.score.note import Note, Score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer
from tonewood.support.arrays import Floats

#: s, after which the key of a release's note comes up
KEY_DOWN = 0.8
#: s of the beginning over which levels of velocities are compared
_LOUD = 0.5
#: frames of a stroke's block
_BLOCK = 8192


@dataclass(frozen=True, eq=False)
class Stroke:
    """One rendered note.

    key, velocity, repeat : MIDI numbers, and the count of round robins from 1.
    samples : (n, n_channels) at the instrument's calibrated level.
    """

    key: int
    velocity: int
    repeat: int
    samples: Floats

    @property
    def peak(self) -> float:
        """Largest sample."""
        return float(np.max(np.abs(self.samples), initial=0.0))

    def level_db(self, fs: int) -> float:
        """Mean level of the first half second, dB re full scale; -200 for silence."""
        return _level(self.samples[: round(_LOUD * fs)])

    def decay_db(self, fs: int) -> float:
        """Decay of the level, dB per s, between 0.1 and 0.1 + `KEY_DOWN` s; 0 where the stroke is shorter."""
        early, late = (self.samples[round(at * fs) : round((at + 0.1) * fs)] for at in (0.1, 0.1 + KEY_DOWN))
        if len(late) < round(0.1 * fs):
            return 0.0
        return max(0.0, (_level(early) - _level(late)) / KEY_DOWN)


def ringing(instrument: Instrument, options: RenderOptions, key: int, velocity: int, repeat: int) -> Stroke:
    """Render a note whose key stays down until the sound has decayed, or for the longest duration of the options."""
    longest = options.max_duration or options.tail
    return Stroke(key, velocity, repeat, _sound(instrument, options, key, velocity, repeat, longest))


def release(instrument: Instrument, options: RenderOptions, key: int, velocity: int, repeat: int) -> Stroke:
    """Render the sound after the key comes up."""
    whole = _sound(instrument, options, key, velocity, repeat, KEY_DOWN)
    return Stroke(key, velocity, repeat, whole[round(KEY_DOWN * options.fs) :])


def rings(instrument: Instrument) -> bool:
    """Return whether notes go on when their keys come up: no hand and no damper ends them."""
    keys = instrument.spec.keys
    damped = keys is not None and any(entry.damper is not None for entry in keys.entries.values())
    return instrument.spec.playing.note_end.kind == "ring" and not damped


def _sound(
    instrument: Instrument, options: RenderOptions, key: int, velocity: int, repeat: int, duration: float
) -> Floats:
    """Return (n, n_channels): one note; repeats differ as a player's do."""
    score = Score([Note(0.0, duration, note=float(key), velocity_midi=float(velocity))])
    # a seed for each stroke, so that no two of them are alike
    seed = None if options.humanize is None else options.humanize + 1000 * repeat + key
    renderer = Renderer(score, instrument, options=options.at(humanize=seed))
    return _joined(list(renderer.blocks(_BLOCK)), len(renderer.channels))


def _joined(blocks: Sequence[Floats], n_channels: int) -> Floats:
    return np.concatenate(blocks) if blocks else np.zeros((0, n_channels))


def _level(samples: Floats) -> float:
    return float(10 * np.log10(max(float(np.mean(samples**2)) if samples.size else 0.0, 1e-20)))
