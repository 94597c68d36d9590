"""One sound of a data set, with what was played: string, stop, onset, technique, force and place of every note."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import NumericalError, TonewoodError
from tonewood.performance.player.playing import Performance, playable
from tonewood.performance.player.timeline import Play
from tonewood.performance.score.assignment import Assigned
from tonewood.sound.files.audio import not_held
from tonewood.sound.render.renderer import Renderer
from tonewood.workshop.batch.conditions import Condition
from tonewood.workshop.batch.rendering import EngineRenderer

#: dBFS of the peak with ``level: peak``
PEAK_DBFS = -1.0


@dataclass(frozen=True)
class PlayedNote:
    """A note as it was played; numbers that its gesture has not are None.

    onset : sample of the file at which the gesture releases the string, a real number; `onset_frame` is the nearest.
    duration : s, to the end of the note: the next on its string, or its own.
    pitch : MIDI number of the stop, with the bend.
    velocity_midi : that gives the force by the instrument's curve.
    from_bridge, length : m, place of the gesture, and the string's speaking length.
    """

    string: str
    stop: float
    onset: float
    onset_frame: int
    duration: float
    pitch: float
    technique: str
    force: float | None
    velocity_midi: int
    from_bridge: float | None
    length: float
    angle_deg: float | None


@dataclass(frozen=True)
class Sound:
    """A rendered sound.

    stems : name -> (n, channels); the mix is ````.
    gain_db : that brought it to its level.
    clipped : samples of each stem beyond full scale.
    """

    stems: dict[str, NDArray[np.float64]]
    fs: int
    channels: tuple[str, ...]
    notes: tuple[PlayedNote, ...]
    dropped: tuple[str, ...]
    gain_db: float
    clipped: dict[str, int]
    warnings: tuple[str, ...]


def sound_of(
    renderer: EngineRenderer, condition: Condition, level: str, by_string: bool, duration: float | None
) -> Sound:
    """Render a sound.

    level : ``calibrated`` or ``peak``.
    duration : s, to which it is cut or padded; None leaves its length.
    Raises TonewoodError : it cannot be rendered, or is empty or not finite.
    """
    mix = renderer.renderer(condition)
    if reason := not_held("FLAC", mix.fs, len(mix.channels)):
        raise TonewoodError(f"{condition.name}: {reason}")
    samples = np.concatenate(list(mix.blocks(4096)))
    if not samples.size or not np.isfinite(samples).all():
        raise NumericalError(f"{condition.name}: the sound is empty, or not finite")
    frames = len(samples) if duration is None else round(duration * mix.fs)
    peak = float(np.max(np.abs(samples)))
    gain = 0.0 if level == "calibrated" or peak == 0.0 else PEAK_DBFS - 20.0 * math.log10(peak)
    stems = {"": fitted(samples, frames)}
    if by_string:
        stems |= _stems(renderer.renderer(condition, by_string=True), frames, len(mix.channels))
    summary = mix.summary()
    stems = {name: sound * 10.0 ** (gain / 20.0) for name, sound in stems.items()}
    return Sound(
        stems=stems,
        fs=mix.fs,
        channels=mix.channels,
        notes=played(mix, condition),
        dropped=tuple(f"{drop.time:.3f} s: {drop.reason}" for drop in mix.dropped),
        gain_db=gain,
        clipped={name: int(np.sum(np.abs(sound) > 1.0)) for name, sound in stems.items()},
        warnings=tuple(summary.warnings),
    )


def fitted(samples: NDArray[np.float64], frames: int) -> NDArray[np.float64]:
    """The sound cut, or padded with zeros, to a number of frames."""
    return np.pad(samples[:frames], ((0, max(0, frames - len(samples))), (0, 0)))


def _stems(renderer: Renderer, frames: int, channels: int) -> dict[str, NDArray[np.float64]]:
    """Shares of the strings and of the body: outputs ``GROUP.STRING``, each string's groups side by side."""
    sound = np.concatenate(list(renderer.blocks(4096)))
    columns: dict[str, list[int]] = {}
    at = 0
    for group in renderer.model.outputs:
        width = len(group.gains)
        columns.setdefault(group.name.rpartition(".")[2], []).extend(range(at, at + width))
        at += width
    assert all(len(where) == channels for where in columns.values())
    return {name: fitted(sound[:, where], frames) for name, where in columns.items()}


def played(renderer: Renderer, condition: Condition) -> tuple[PlayedNote, ...]:
    """The notes of a renderer's performance, in the order of their onsets."""
    performance: Performance = renderer.performance
    gestures: dict[tuple[str, float], Play] = {
        (play.string, play.time): play for play in performance.timeline.plays if play.string is not None
    }
    pitches = {string.name: string for string in playable(renderer.model, condition.render.capo)}
    notes = []
    for assigned in performance.notes:
        stop = assigned.stop - condition.render.capo
        pitch = pitches[assigned.string].pitch_at(stop)
        notes.append(_label(renderer, assigned, gestures, pitch))
    return tuple(sorted(notes, key=lambda note: (note.onset, note.string)))


def _label(
    renderer: Renderer, assigned: Assigned, gestures: dict[tuple[str, float], Play], pitch: float | None
) -> PlayedNote:
    note, model = assigned.note, renderer.model
    play = gestures.get((assigned.string, note.time))
    gesture = None if play is None else play.gesture
    onset = note.time * renderer.fs + renderer.zero_frame
    length = model.strings[assigned.string].length(assigned.stop)
    position = note.from_bridge if gesture is None else gesture.from_bridge
    angle = note.angle_deg if gesture is None else gesture.angle_deg
    velocity = model.playing.velocity
    if note.velocity_midi is not None:
        nearest = round(min(max(note.velocity_midi, 1), 127))
    elif note.force is not None:
        force = note.force
        nearest = min(range(1, 128), key=lambda v: abs(velocity.value(v) - force))
    else:
        nearest = 64
    return PlayedNote(
        string=assigned.string,
        stop=float(assigned.stop),
        onset=float(onset),
        onset_frame=round(onset),
        duration=float(max(assigned.end - note.time, 0.0)),
        pitch=float((pitch if pitch is not None else note.note or 0.0) + assigned.cents / 100.0),
        technique=(play.exciter if play is not None else "") or note.technique or model.playing.default_exciter,
        force=None if note.force is None else float(note.force),
        velocity_midi=int(nearest),
        from_bridge=None if position is None else float(position),
        length=float(length),
        angle_deg=None if angle is None else float(angle),
    )


def note_row(sound: str, note: PlayedNote) -> dict[str, Any]:
    """A row of the table of notes."""
    return {"sound": sound, **vars(note)}
