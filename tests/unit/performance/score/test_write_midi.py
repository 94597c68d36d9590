"""Writing a score and reading it back gives the score, to the tick."""

from __future__ import annotations

import mido
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood.errors import OutputError, ScoreError
from tonewood.performance.score.midi import read_midi, write_midi
from tonewood.performance.score.note import Control, Note, Score


def test_a_beat_is_a_beat(tmp_path):
    path = tmp_path / "scale.mid"
    write_midi(Score([Note(1.0, 0.5, note=60, velocity_midi=90)], name="scale"), path, bpm=60, ticks_per_beat=480)
    file = mido.MidiFile(path)
    assert (file.type, file.ticks_per_beat, file.length) == (1, 480, pytest.approx(1.5))
    assert [(m.type, m.time) for m in file.tracks[1][:2]] == [("note_on", 480), ("note_off", 240)]
    assert read_midi(path).metadata["title"] == "scale"


@given(
    st.lists(
        st.tuples(st.integers(0, 9600), st.integers(48, 4800), st.integers(1, 127), st.integers(0, 15)),
        min_size=1,
        max_size=30,
    ),
    st.lists(
        st.tuples(st.integers(0, 9600), st.integers(-1200, 1100), st.integers(0, 15)),
        max_size=8,
        unique_by=lambda b: b[0],
    ),
)
def test_round_trip(tmp_path_factory, notes, bends):
    tick = 1 / 1920  # s, at the default tempo
    score = Score(
        [Note(t * tick, d * tick, note=key, velocity_midi=v, channel=c) for key, (t, d, v, c) in enumerate(notes)],
        [Control(t * tick, "bend", float(cents), c) for t, cents, c in sorted(bends)] + [Control(0.0, "cc7", 1.0, 0)],
    )
    path = tmp_path_factory.getbasetemp() / "round.mid"
    write_midi(score, path)
    back = read_midi(path, percussion=True)
    assert {n.note: n.velocity_midi for n in back.notes} == {n.note: n.velocity_midi for n in score.notes}
    ours = {n.note: n for n in back.notes}
    for note in score.notes:
        assert ours[note.note].time == pytest.approx(note.time, abs=1e-9)
        assert ours[note.note].duration == pytest.approx(note.duration, abs=1e-9)
        assert ours[note.note].channel == note.channel
    step = 1200 / 8192  # cents
    for control in score.controls:
        sounding = [c.value for c in back.controls if (c.kind, c.channel) == (control.kind, control.channel)
                    and c.time <= control.time + 1e-9]  # fmt: skip
        assert (sounding or [0.0])[-1] == pytest.approx(control.value, abs=step)


@pytest.mark.parametrize("note", [Note(0.0), Note(0.0, note=60.5), Note(0.0, note=128)])
def test_what_midi_cannot_say_is_refused(tmp_path, note):
    with pytest.raises(ScoreError, match="whole number from 0 to 127"):
        write_midi(Score([note]), tmp_path / "x.mid")
    with pytest.raises(ScoreError, match="MIDI has no message"):
        write_midi(Score([], [Control(0.0, "cc120", 0.5)]), tmp_path / "x.mid")


def test_a_place_that_cannot_be_written_gives_one_line(tmp_path):
    with pytest.raises(OutputError, match="there is no folder"):
        write_midi(Score([Note(0.0, note=60)]), tmp_path / "no" / "x.mid")


def test_a_note_without_length_ends_a_tick_after_it_begins(tmp_path):
    """A note-off at the tick of its note-on would be taken for the end of a note before."""
    path = tmp_path / "short.mid"
    write_midi(Score([Note(1.0, 0.0, note=60), Note(1.0, 1e-5, note=64)]), path, bpm=60, ticks_per_beat=480)
    notes = [(m.type, m.note, m.time) for m in mido.MidiFile(path).tracks[1] if m.type.startswith("note")]
    assert notes == [("note_on", 60, 480), ("note_on", 64, 0), ("note_off", 60, 1), ("note_off", 64, 0)]
