"""Labels as other programs read them: JAMS and MIDI.

JAMS (E. J. Humphrey et al., ISMIR 2014; https://jams.readthedocs.io) is JSON. As in GuitarSet (Q. Xi et al., ISMIR
2018) each string has one ``note_midi`` annotation, named by its ``data_source``; the sandbox of a note's annotation has
what that namespace has no place for. In the MIDI file a tick is one sample, a track one string; a text at each onset
gives stop, technique, force and place.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any

from tonewood.workshop.dataset.manifest import midi_clock
from tonewood.workshop.dataset.sound import PlayedNote

JAMS_VERSION = "0.3.4"
#: facts of a note that stand in sandbox and text
_FACTS = ("stop", "onset_frame", "technique", "force", "from_bridge", "length", "angle_deg")


def by_string(notes: Sequence[PlayedNote]) -> dict[str, list[PlayedNote]]:
    """Notes of each string, in time order."""
    notes_of: dict[str, list[PlayedNote]] = {}
    for note in notes:
        notes_of.setdefault(note.string, []).append(note)
    return notes_of


def jams(
    name: str, notes: Sequence[PlayedNote], fs: int, seconds: float, parameters: Mapping[str, Any], by: str
) -> str:
    """A JAMS file.

    parameters : of the data set, kept in the file's sandbox.
    by : program and version that made it.
    """
    annotations = []
    for string, played in by_string(notes).items():
        annotations.append(
            {
                "namespace": "note_midi",
                "annotation_metadata": {
                    "curator": {"name": "", "email": ""}, "annotator": {}, "version": "", "corpus": "",
                    "annotation_tools": by, "annotation_rules": "synthesis", "validation": "", "data_source": string,
                },
                "data": [
                    {"time": n.onset / fs, "duration": n.duration, "value": n.pitch, "confidence": 1.0} for n in played
                ],
                "sandbox": {"string": string, "notes": [_facts(n) for n in played]},
                "time": 0.0,
                "duration": seconds,
            }
        )  # fmt: skip
    metadata = {
        "title": name, "artist": by, "release": "", "duration": seconds, "identifiers": {},
        "jams_version": JAMS_VERSION,
    }  # fmt: skip
    sandbox = {"fs": fs, "parameters": dict(parameters)}
    data = {"annotations": annotations, "file_metadata": metadata, "sandbox": sandbox}
    return json.dumps(data, sort_keys=True, allow_nan=False) + "\n"


def _facts(note: PlayedNote) -> dict[str, Any]:
    return {name: getattr(note, name) for name in _FACTS}


def midi(notes: Sequence[PlayedNote], fs: int) -> bytes:
    """A MIDI file of type 1 in which a tick is one sample.

    Raises ValueError : no clock of MIDI has ticks of one sample at this rate.
    """
    import mido

    clock = midi_clock(fs)
    if clock is None:
        raise ValueError(f"MIDI has no tick of one sample at {fs} Hz")
    file = mido.MidiFile(type=1, ticks_per_beat=clock[0])
    file.tracks.append(mido.MidiTrack([mido.MetaMessage("set_tempo", tempo=clock[1], time=0)]))
    for channel, (string, played) in enumerate(by_string(notes).items()):
        track = mido.MidiTrack([mido.MetaMessage("track_name", name=_latin(string), time=0)])
        events: list[tuple[int, int, Any]] = []
        for note in played:
            start = note.onset_frame
            stop = max(start + 1, round(note.onset + note.duration * fs))
            key, voice = min(max(round(note.pitch), 0), 127), channel % 16
            words = " ".join(f"{name}={_word(getattr(note, name))}" for name in _FACTS)
            events.append((start, 1, mido.MetaMessage("text", text=_latin(words))))
            events.append((start, 2, mido.Message("note_on", note=key, velocity=note.velocity_midi, channel=voice)))
            events.append((stop, 0, mido.Message("note_off", note=key, velocity=0, channel=voice)))
        now = 0
        for at, _, message in sorted(events, key=lambda event: event[:2]):
            track.append(message.copy(time=at - now))
            now = at
        file.tracks.append(track)
    stream = io.BytesIO()
    file.save(file=stream)
    return stream.getvalue()


def _latin(text: str) -> str:
    """MIDI's texts are Latin-1."""
    return text.encode("latin-1", "replace").decode("latin-1")


def _word(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, float) else "" if value is None else str(value)
