"""The level of a file or of playing: calibrated, or brought to a peak or a loudness by one gain for all.

Calibrated, full scale is the `full_scale` of the bundle's output, e.g. 40 Pa. A gain of g dB makes it
full_scale / 10^(g / 20).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from tonewood.errors import NothingPlayedError, TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.output_assembly import OutputGroup
from tonewood.performance.score.note import Note, Score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer
from tonewood.support.units import decibel

LevelName = Literal["calibrated", "peak", "LUFS"]

#: dBFS, largest sample where the level is `peak` or `LUFS`; LUFS, the loudness of EBU R 128
PEAK, LOUDNESS = -1.0, -23.0
#: s, of the loudest part of a score that `preview_gain` renders
_PREVIEW = 2.0
#: dB left between the peak of that part and `PEAK`
_MARGIN = 3.0


def level_name(text: str | None, *, gain_db: float, limiter: bool) -> LevelName:
    """Check the name of a level; left out it is `peak`, or `calibrated` where a gain or a limiter is asked for.

    Raises TonewoodError : the name is unknown, or a gain or limiter is given with a level that sets the gain itself.
    """
    if text is None:
        return "calibrated" if gain_db or limiter else "peak"
    for name in get_args(LevelName):
        if text == name:
            if name != "calibrated" and gain_db:
                raise TonewoodError(f"the level {name} sets the gain; --gain goes with calibrated", key="--gain")
            level: LevelName = name
            return level
    raise TonewoodError(f"is {text!r}; {', '.join(get_args(LevelName))} are allowed", key="--level")


def meaning(groups: Sequence[OutputGroup], gain_db: float) -> str:
    """Return the meaning of full scale after a gain, e.g. ``0 dBFS is 12.6 Pa``."""
    values = [f"{g.full_scale / 10 ** ((gain_db + g.gain_db) / 20):.4g} {g.unit}" for g in groups]
    return f"gain {gain_db:+.1f} dB, 0 dBFS is {', '.join(values)}"


def preview_gain(score: Score, instrument: Instrument, options: RenderOptions) -> float:
    """Gain (dB) that brings the loudest two seconds of a score near `PEAK`, for sound that is played as it is rendered.

    These are where the sum of squares of the forces is largest; they are rendered without effects that may be left out.
    0 where none of their notes can be played.
    """
    notes = sorted(score.notes, key=lambda n: n.time)
    if not notes:
        return 0.0
    velocity = instrument.spec.playing.velocity

    def squared(note: Note) -> float:
        force = note.force if note.force is not None else velocity.value(note.velocity_midi or 64.0)
        return force * force

    ends = np.cumsum([0.0, *map(squared, notes)])
    times = np.array([n.time for n in notes])
    sums = ends[np.searchsorted(times, times + _PREVIEW)] - ends[:-1]
    begin = notes[int(np.argmax(sums))].time
    part = [replace(n, time=n.time - begin) for n in notes if begin <= n.time < begin + _PREVIEW]
    quick = options.at(effects="none", energy=False, gain_db=0.0, max_duration=_PREVIEW, lead_in=0.0)
    controls = [replace(c, time=max(c.time - begin, 0.0)) for c in score.controls if c.time < begin + _PREVIEW]
    try:
        renderer = Renderer(Score(part, controls, name=score.name, file=score.file), instrument, options=quick)
    except NothingPlayedError:
        return 0.0
    peak = max((float(np.abs(block).max()) for block in renderer.blocks(4096)), default=0.0)
    return PEAK - _MARGIN - decibel(peak) if peak > 0 else 0.0
