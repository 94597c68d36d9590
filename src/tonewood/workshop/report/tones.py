"""Notes played on an instrument: sound, level over time, loudness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_name, note_number
from tonewood.performance.player.playing import playable
from tonewood.performance.score.assignment import assign
from tonewood.performance.score.note import Note, Score
from tonewood.sound.files.audio import flac_bytes
from tonewood.sound.level.loudness import loudness, matching_gain_db, true_peak
from tonewood.sound.level.spectrum import level_curve
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import render
from tonewood.support.arrays import Floats
from tonewood.support.units import decibel

#: loudness of the players, LUFS, lowered for all where a peak would pass `_PEAK_DB`
_TARGET_LUFS, _PEAK_DB = -20.0, -1.0
#: s, over which the end of a sound in a player fades
_FADE = 0.05


@dataclass(frozen=True, eq=False)
class Tone:
    """One note of one instrument.

    note : as it was asked for; string, stop : where it was played.
    freq : Hz, of the note there.
    samples, fs : (n, n_channels) of the instrument's first output group, full scale 1.0; Hz.
    time, level_db : s, and level re full scale over 20 ms each.
    peak_dbfs, lufs : largest sample, and loudness (BS.1770-4).
    full_scale, unit : of the output; levels of two instruments are comparable once both are re one full scale.
    """

    note: str
    string: str
    stop: float
    freq: float
    samples: Floats
    fs: int
    time: Floats
    level_db: Floats
    peak_dbfs: float
    lufs: float
    full_scale: float
    unit: str

    def shift_db(self, first: Tone) -> float | None:
        """Return the dB that make its levels those re the full scale of another; None if that has another unit."""
        return decibel(self.full_scale / first.full_scale) if self.unit == first.unit else None


def play_note(
    instrument: Instrument, model: Model, note: str, *, fs: int, duration: float, velocity_midi: float
) -> Tone:
    """Render one note.

    note : name such as ``E2``, or STRING:STOP for a place, such as ``A2:12``.
    duration : s, of the note and of its sound.
    velocity_midi : 1 to 127.
    Raises TonewoodError : there is no such note, or the instrument cannot play it.
    """
    string, stop = place(model, note)
    score = Score([Note(0.0, duration + 1.0, string=string, stop=stop, velocity_midi=velocity_midi)], name=note)
    options = RenderOptions(fs=fs, max_duration=duration, tail=duration, tail_level_db=-300.0)
    audio = render(score, instrument, options=options)
    time, level_db = level_curve(audio.samples, fs)
    return Tone(
        note=note,
        string=string,
        stop=stop,
        freq=model.strings[string].freq(stop),
        samples=audio.samples,
        fs=fs,
        time=time,
        level_db=level_db,
        peak_dbfs=audio.peak_dbfs,
        lufs=loudness(audio.samples, fs)[0],
        full_scale=model.outputs[0].full_scale,
        unit=model.outputs[0].unit,
    )


def place(model: Model, note: str) -> tuple[str, float]:
    """String and stop of a note: STRING:STOP as it says, a name as the left hand would choose.

    Raises TonewoodError : there is no such string or stop, the text is no note, or no string reaches it.
    """
    name, colon, stop = note.partition(":")
    if colon:
        if name not in model.groups:
            raise TonewoodError(f"there is no string {name!r}; there are {', '.join(model.groups)}")
        count = model.strings[name].n_stops
        if not (stop.isascii() and stop.isdigit() and int(stop) <= count):
            raise TonewoodError(f"{stop!r} is no stop of string {name}; 0 to {count} are allowed")
        return name, float(stop)
    assignment = assign([Note(0.0, 1.0, note=note_number(note))], playable(model), tuning=model.instrument.tuning)
    if assignment.dropped:
        raise TonewoodError(assignment.dropped[0].reason)
    return assignment.notes[0].string, assignment.notes[0].stop


def place_name(model: Model, string: str, stop: int) -> str:
    """STRING:STOP as `place` reads it, or the note's name where the left hand would choose that place."""
    name = note_name(model.strings[string].open_note + stop)
    try:
        chosen = place(model, name)
    except TonewoodError:
        chosen = ("", -1.0)
    return name if chosen == (string, float(stop)) else f"{string}:{stop}"


def matched_gains_db(tones: list[Tone]) -> list[float]:
    """Gains, dB, that bring tones to one loudness, as loud as their peaks allow; silence is left as it is."""
    gains = [
        matching_gain_db(tone.samples, tone.fs, _TARGET_LUFS) if tone.peak_dbfs > -np.inf else 0.0 for tone in tones
    ]
    peaks = [decibel(true_peak(tone.samples)) + gain for tone, gain in zip(tones, gains, strict=True)]
    excess = max([0.0, *(peak - _PEAK_DB for peak in peaks)])
    return [gain - excess for gain in gains]


def flac(tone: Tone, gain_db: float = 0.0) -> bytes:
    """A tone as a FLAC file of 16 bits, its first two channels, with a fade at its end."""
    sound = tone.samples[:, :2] * 10.0 ** (gain_db / 20.0)
    n = min(len(sound), round(_FADE * tone.fs))
    sound[len(sound) - n :] *= (0.5 + 0.5 * np.cos(np.pi * np.arange(n) / max(n, 1)))[:, None]
    return flac_bytes(sound, tone.fs)
