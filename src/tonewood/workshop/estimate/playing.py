"""Recorded notes on an instrument: which string and stop, and the same notes rendered."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.scales import note_name
from tonewood.performance.score.note import Note, Score
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import Renderer, assembled
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.recordings import FS, Recording

#: MIDI velocity of notes whose dynamic nobody says
VELOCITY = 96.0
#: s before a note and after it that are kept, longest note, and rest until the next one
_BEFORE, _LONGEST, _REST = 0.08, 3.2, 0.4
#: notes of one render: strings are damped between them, and memory is bounded
_AT_ONCE = 16


@dataclass(frozen=True, eq=False)
class Played:
    """A recording and its place on the instrument.

    recording : of the note.
    string, stop : where it is played.
    length : m, speaking length there.
    tension, linear_density, bending_stiffness : N, kg/m, N m^2 of the string there.
    """

    recording: Recording
    string: str
    stop: float
    length: float
    tension: float
    linear_density: float
    bending_stiffness: float

    @property
    def name(self) -> str:
        """Note, and its file."""
        return f"{note_name(self.recording.note)} ({self.recording.file})"

    @property
    def b(self) -> float:
        """Inharmonicity B = pi^2 EI / (T L^2)."""
        return float(np.pi**2 * self.bending_stiffness / (self.tension * self.length**2))


class Stage:
    """An instrument on which recorded notes are placed and played.

    instrument : as it is begun with.
    Raises TonewoodError : it has no string with a pitch.
    """

    def __init__(self, instrument: Instrument):
        self.instrument = instrument
        options = RenderOptions(fs=FS, effects="auto")
        self._model = assembled(instrument, options)
        self._strings = {name: self._model.strings[name] for name in instrument.groups}
        if not self._strings:
            raise TonewoodError("has no string that a note could be played on", file=instrument.folder)

    def places(self, note: float) -> list[tuple[str, float]]:
        """String and stop of a note, the lowest position first."""
        out = []
        for name, string in self._strings.items():
            stop = note - string.open_note
            whole = stop if string.stopping.continuous else float(round(stop))
            if abs(stop - whole) < 0.5 and -0.25 < whole <= string.n_stops:
                out.append((name, max(whole, 0.0)))
        return sorted(out, key=lambda string_stop: string_stop[1])

    def placed(self, recording: Recording) -> Played | None:
        """A recording in the place that it names, or in the lowest position; None if no string has its note.

        Raises TonewoodError : the string or the stop that it names does not exist, or is of another note.
        """
        string, stop = recording.string, recording.stop
        if string is not None:
            if string not in self._strings:
                allowed = ", ".join(self._strings)
                raise TonewoodError(f"string {string!r} does not exist; there are {allowed}", key=recording.file)
            model = self._strings[string]
            if stop is None:
                stop = float(round(recording.note - model.open_note))
            if not 0 <= stop <= model.n_stops:
                reason = f"stop {stop:g} of string {string} does not exist; 0 to {model.n_stops} are allowed"
                raise TonewoodError(reason, key=recording.file)
            if recording.note < 0:
                recording = replace(recording, note=round(model.open_note + stop))
            if abs(model.open_note + stop - recording.note) > 0.75:
                sounding = note_name(round(model.open_note + stop))
                reason = f"is {note_name(recording.note)}; string {string} at stop {stop:g} is {sounding}"
                raise TonewoodError(reason, key=recording.file)
            return self.at(recording, string, stop)
        places = self.places(recording.note)
        return self.at(recording, *places[0]) if places else None

    def named(self, recording: Recording) -> Recording:
        """A recording with the note of its string and stop, where it tells no other.

        Raises TonewoodError : as `placed`.
        """
        played = self.placed(recording) if recording.note < 0 else None
        return recording if played is None else played.recording

    def at(self, recording: Recording, string: str, stop: float) -> Played:
        """A recording at a stop of a string."""
        model, part = self._strings[string], self.instrument.resolved["strings"][string]
        return Played(
            recording, string, stop, model.length(stop), model.tension(stop), float(part.get("linear_density") or 0.0),
            float(part.get("bending_stiffness") or 0.0),
        )  # fmt: skip

    def at_open(self, string: str) -> Played:
        """The open string, without a recording."""
        note = round(self._strings[string].open_note)
        return self.at(Recording("", note, np.zeros(0)), string, 0.0)

    @property
    def span(self) -> str:
        """Lowest and highest note, for messages."""
        low = min(s.open_note for s in self._strings.values())
        high = max(s.open_note + s.n_stops for s in self._strings.values())
        return f"{note_name(round(low))} to {note_name(round(high))}"

    def open_note(self, string: str) -> float:
        """MIDI number of an open string."""
        return float(self._strings[string].open_note)


def render_notes(
    instrument: Instrument,
    notes: Sequence[Played],
    outputs: Sequence[str],
    advance: Callable[[float], None] = lambda seconds: None,
) -> list[dict[str, Floats]]:
    """Each note alone on an instrument: output -> mono sound at `FS`, from 80 ms before the note.

    instrument : with the figures of the present iteration.
    notes : rendered one after the other, at most 16 in a render.
    outputs : names of output groups; the mean of a group's channels is taken.
    advance : called with the seconds of sound rendered since the last call.
    Raises TonewoodError : the instrument cannot play a note.
    """
    options = RenderOptions(fs=FS, outputs=tuple(outputs), tail=_LONGEST, tail_level_db=-300.0)
    model = assembled(instrument, options)
    out: list[dict[str, Floats]] = []
    for first in range(0, len(notes), _AT_ONCE):
        now, score, starts = 0.6, [], []
        for played in notes[first : first + _AT_ONCE]:
            duration = min(len(played.recording.samples) / FS, _LONGEST)
            velocity = played.recording.dynamic or VELOCITY
            starts.append((now, duration))
            score.append(
                Note(
                    now, duration, string=played.string, stop=played.stop, velocity_midi=velocity,
                    from_bridge=played.recording.place,
                )
            )  # fmt: skip
            now += duration + _REST
        renderer = Renderer(Score(score), instrument, options=options, model=model)
        blocks, done = [], 0.0
        for block in renderer.blocks(1 << 14):
            blocks.append(block)
            advance(len(block) / FS)
            done += len(block) / FS
            if done >= now - _REST:  # a string without a damper has no last event here
                break
        sound = np.concatenate(blocks)
        columns = {name: _columns(renderer.channels, name, len(outputs) == 1) for name in outputs}
        for start, duration in starts:
            a, b = round((start - _BEFORE) * FS), round((start + duration - 0.05) * FS)
            out.append({name: sound[a:b, of].mean(axis=1) for name, of in columns.items()})
    return out


def seconds_of(notes: Iterable[Played]) -> float:
    """Seconds of sound that `render_notes` renders."""
    return sum(min(len(p.recording.samples) / FS, _LONGEST) + _REST for p in notes)


def _columns(channels: Sequence[str], output: str, alone: bool) -> list[int]:
    return [i for i, name in enumerate(channels) if alone or name.partition(".")[0] == output]


def strings_of(instrument: Instrument, string: str) -> tuple[str, ...]:
    """Strings that a note on `string` plays together."""
    groups: Mapping[str, tuple[str, ...]] = instrument.groups
    return groups.get(string, (string,))
