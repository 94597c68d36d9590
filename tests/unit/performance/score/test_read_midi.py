"""Reading of intact MIDI files: tempo, keys, pedal, bends, controllers, excerpts. mido is the second opinion."""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path

import mido
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smf_bytes import END, ONE_NOTE, chunk, event, header, meta, smf, tempo

from tonewood.errors import ScoreError
from tonewood.performance.score.controllers import Controllers, loudness
from tonewood.performance.score.midi import MIN_DURATION, read_midi
from tonewood.performance.score.note import Control, Note, Score
from tonewood.performance.score.reading import read_score


@pytest.fixture
def read(tmp_path):
    def read(data: bytes, **options) -> Score:
        path = tmp_path / "piece.mid"
        path.write_bytes(data)
        return read_midi(path, **options)

    return read


def spans(score: Score) -> list[tuple[float, float, float]]:
    return [(n.note, pytest.approx(n.time), pytest.approx(n.time + n.duration)) for n in score.notes]


def controls(score: Score, kind: str) -> list[tuple[float, float]]:
    return [(round(c.time, 6), round(c.value, 6)) for c in score.controls if c.kind == kind]


def test_a_note_keeps_what_the_file_says(read):
    (note,) = read(smf(event(240, 0x93, 60, 80) + event(480, 0x83, 60, 64))).notes
    assert note == Note(time=0.25, duration=0.5, note=60, velocity_midi=80, channel=3)


def test_note_on_of_velocity_0_and_running_status_end_a_note(read):
    score = read(smf(event(0, 0x90, 60, 80) + event(480, 60, 0) + event(0, 62, 80) + event(480, 62, 0)))
    assert spans(score) == [(60, 0.0, 0.5), (62, 0.5, 1.0)]
    assert score.warnings == ()


def test_running_status_survives_a_meta_event(read):
    score = read(smf(event(0, 0x90, 60, 80) + meta(0, 1, b"text") + event(480, 60, 0)))
    assert spans(score) == [(60, 0.0, 0.5)]


def test_tempo_map_in_a_track_without_notes(read):
    tempos = tempo(0, 500_000) + tempo(960, 250_000) + tempo(960, 1_000_000)
    notes = b"".join(event(0, 0x90, 50 + i, 80) + event(480, 0x80, 50 + i, 64) for i in range(6))
    assert [n.time for n in read(smf(b"", tempos, notes)).notes] == pytest.approx([0, 0.5, 1.0, 1.25, 1.5, 2.5])


@pytest.mark.parametrize(
    ("frames", "ticks", "frames_per_second"), [(24, 4, 24), (25, 40, 25), (29, 80, 30000 / 1001), (30, 100, 30)]
)
def test_smpte_division_ignores_tempo(read, frames, ticks, frames_per_second):
    division = (256 - frames) << 8 | ticks
    body = tempo(0, 123_456) + event(ticks, 0x90, 64, 80) + event(100 * ticks, 0x80, 64, 64)
    score = read(smf(body, division=division))
    (note,) = score.notes
    assert score.beats is None  # frames are no quarter notes
    assert note.time == pytest.approx(1 / frames_per_second, rel=1e-12)
    assert note.duration == pytest.approx(100 / frames_per_second, rel=1e-12)


def test_format_2_plays_its_patterns_one_after_the_other(read):
    score = read(smf(tempo(0, 500_000) + ONE_NOTE, tempo(0, 250_000) + ONE_NOTE, form=2))
    assert spans(score) == [(60, 0.0, 0.5), (60, 0.5, 0.75)]
    assert "one after the other" in score.warnings[0]


def test_riff_wrapper(read):
    data = smf(ONE_NOTE)
    padded = data + b"\0" * (len(data) % 2)
    riff = b"RMID" + b"LIST" + (4).to_bytes(4, "little") + b"INFO" + b"data" + len(data).to_bytes(4, "little") + padded
    assert spans(read(b"RIFF" + len(riff).to_bytes(4, "little") + riff)) == [(60, 0.0, 0.5)]


ON, OFF = (0x90, 60, 80), (0x80, 60, 64)
DOWN, UP = (0xB0, 64, 127), (0xB0, 64, 0)


@pytest.mark.parametrize(
    ("messages", "expected"),
    [  # messages one quarter of a second apart, the first at 0
        ([DOWN, ON, OFF, UP], [(0.25, 0.75)]),
        ([ON, DOWN, OFF, UP], [(0.0, 0.75)]),
        ([ON, OFF, DOWN, UP], [(0.0, 0.25)]),
        ([ON, DOWN, UP, OFF], [(0.0, 0.75)]),
        ([DOWN, ON, OFF, ON, OFF, UP], [(0.25, 0.75), (0.75, 1.25)]),  # struck again under the pedal
        ([DOWN, ON, OFF, DOWN, UP, UP], [(0.25, 1.0)]),  # chatter
        ([DOWN, ON, OFF, (0xB0, 64, 63)], [(0.25, 0.75)]),  # 63 is up
        ([(0xB0, 64, 63), ON, OFF, UP], [(0.25, 0.5)]),
        ([DOWN, ON, OFF], [(0.25, 0.5)]),  # never released: the end of the track releases it
        ([DOWN, ON, OFF, (0xB0, 121, 0), UP], [(0.25, 0.75)]),  # reset controllers lifts the pedal
        ([ON, (0xB0, 123, 0), ON, OFF], [(0.0, 0.25), (0.5, 0.75)]),
        ([DOWN, ON, (0xB0, 123, 0), UP], [(0.25, 0.75)]),  # all notes off waits for the pedal
        ([DOWN, ON, (0xB0, 120, 0), UP], [(0.25, 0.5)]),  # all sound off does not
        ([DOWN, ON, OFF, (0xB0, 120, 0), ON, OFF, UP], [(0.25, 0.75), (1.0, 1.5)]),
        ([DOWN, ON, ON, OFF, OFF, UP], [(0.25, 1.0), (0.5, 1.25)]),  # both keys up: one string left sounding
        ([ON, ON, OFF, OFF], [(0.0, 0.5), (0.25, 0.75)]),  # first on, first off
    ],
)
def test_pedal_in_every_order(read, messages, expected):
    body = b"".join(event(240 if i else 0, *message) for i, message in enumerate(messages))
    assert [(n.time, n.time + n.duration) for n in read(smf(body)).notes] == expected


def test_pedal_is_each_channels_own(read):
    body = event(0, 0xB1, 64, 127) + event(0, *ON) + event(480, *OFF) + event(480, 0xB1, 64, 0)
    assert spans(read(smf(body))) == [(60, 0.0, 0.5)]


def test_pedal_chatter_of_ten_thousand_messages(read):
    chatter = event(0, *DOWN) + event(1, *UP)
    score = read(smf(event(0, *DOWN) + event(0, *ON) + event(0, *OFF) + chatter * 5000))
    assert [(n.time, n.duration) for n in score.notes] == [(0.0, MIN_DURATION)]


def bend(delta: int, value: int, channel: int = 0) -> bytes:
    return event(delta, 0xE0 | channel, value & 0x7F, value >> 7)


def parameter(number: int, msb: int, lsb: int | None = None) -> bytes:
    entry = event(0, 0xB0, 101, 0) + event(0, 0xB0, 100, number) + event(0, 0xB0, 6, msb)
    return entry if lsb is None else entry + event(0, 0xB0, 38, lsb)


NULL = event(0, 0xB0, 101, 127) + event(0, 0xB0, 100, 127)


def test_bend_is_in_cents_of_two_semitones_by_default(read):
    body = bend(0, 0) + bend(480, 4096) + bend(480, 8192) + bend(480, 16383) + ONE_NOTE
    expected = [(0.0, -200.0), (0.5, -100.0), (1.0, 0.0), (1.5, round(200 * 8191 / 8192, 6))]
    assert controls(read(smf(body)), "bend") == expected


def test_bend_range_is_set_by_registered_parameter_0(read):
    body = parameter(0, 12, 50) + NULL + bend(0, 0) + ONE_NOTE
    assert controls(read(smf(body)), "bend") == [(0.0, -1250.0)]


def test_a_new_range_moves_a_bend_that_is_on(read):
    body = bend(0, 0) + event(480, 0xB0, 101, 0) + parameter(0, 24) + ONE_NOTE
    assert controls(read(smf(body)), "bend") == [(0.0, -200.0), (0.5, -2400.0)]


@pytest.mark.parametrize("between", [NULL, event(0, 0xB0, 99, 0), event(0, 0xB0, 98, 0)])
def test_data_entry_without_the_parameter_chosen_changes_nothing(read, between):
    body = event(0, 0xB0, 101, 0) + event(0, 0xB0, 100, 0) + between + event(0, 0xB0, 6, 12) + bend(0, 0) + ONE_NOTE
    assert controls(read(smf(body)), "bend") == [(0.0, -200.0)]


def test_bend_keeps_to_its_channel_and_reset_centres_it(read):
    score = read(smf(bend(0, 0, channel=2) + event(480, 0xB2, 121, 0) + ONE_NOTE))
    assert score.controls == (Control(0.0, "bend", -200.0, 2), Control(0.5, "bend", 0.0, 2))


def test_controllers_come_as_fractions_and_only_when_they_change(read):
    body = event(0, 0xB0, 74, 127) + event(10, 0xB0, 74, 127) + event(470, 0xB0, 74, 0) + ONE_NOTE
    assert controls(read(smf(body)), "cc74") == [(0.0, 1.0), (0.5, 0.0)]


def test_volume_and_expression_are_a_factor_on_later_notes(read):
    body = ONE_NOTE + event(0, 0xB0, 7, 64) + ONE_NOTE + event(0, 0xB0, 11, 64) + ONE_NOTE
    score = read(smf(body))
    factors = [loudness(Controllers(score.controls).of(note)) for note in score.notes]
    # General MIDI: 40 lg(64/127) = -11.9 dB each
    assert factors == pytest.approx([1.0, 10 ** (-11.905 / 20), 10 ** (-23.81 / 20)], rel=1e-3)


def test_titles_are_text_without_control_characters(read):
    score = read(smf(meta(0, 3, "Bourrée\n\x1b[31m".encode()) + ONE_NOTE))
    assert score.metadata["title"] == "Bourrée [31m"
    long = read(smf(meta(0, 3, ("a" + 100 * "é").encode()) + ONE_NOTE))  # of 201 bytes 200 are kept
    assert long.metadata["title"] == "a" + 99 * "é"
    assert read(smf(meta(0, 3, "Lágrima".encode("latin-1")) + ONE_NOTE)).metadata["title"] == "Lágrima"


def test_an_empty_piece_is_an_empty_score(read):
    score = read(smf(b""))
    assert (score.notes, score.warnings, score.name) == ((), (), "piece")


class TestExcerpt:
    body = b"".join(event(0, 0x90, 60 + i, 80) + event(480, 0x80, 60 + i, 64) for i in range(8))

    def test_times_count_from_start_and_notes_end_at_stop(self, read):
        score = read(smf(self.body), start=1.0, stop=2.25)
        assert spans(score) == [(62, 0.0, 0.5), (63, 0.5, 1.0), (64, 1.0, 1.25)]

    def test_a_note_that_sounds_across_start_is_left_out_and_reported(self, read):
        score = read(smf(self.body), start=0.25)
        assert len(score.notes) == 7
        assert "left out" in score.warnings[0]

    def test_controllers_keep_the_value_they_have_at_start(self, read):
        body = event(0, 0xB0, 7, 127) + event(240, 0xB0, 7, 0) + bend(0, 0) + event(960, 0xB0, 7, 127) + self.body
        score = read(smf(body), start=1.0, stop=2.0)
        assert controls(score, "cc7") == [(0.0, 0.0), (0.25, 1.0)]
        assert controls(score, "bend") == [(0.0, -200.0)]

    @pytest.mark.parametrize(("start", "stop"), [(-1.0, None), (2.0, 2.0), (3.0, 1.0), (float("nan"), None)])
    def test_an_impossible_excerpt_is_refused(self, read, start, stop):
        with pytest.raises(ScoreError, match="excerpt"):
            read(smf(self.body), start=start, stop=stop)

    def test_an_excerpt_is_a_way_around_a_long_silence(self, read):
        body = ONE_NOTE + event(480 * 7200, 0x90, 62, 80) + event(480, 0x80, 62, 64)
        with pytest.raises(ScoreError, match="silence"):
            read(smf(body))
        assert len(read(smf(body), stop=10.0).notes) == 1
        assert len(read(smf(body), start=3000.0).notes) == 1


notes_strategy = st.lists(
    st.tuples(
        st.integers(0, 2000),  # ticks since the one before
        st.integers(1, 3000),  # ticks long
        st.integers(1, 127),
        st.integers(0, 15),
    ),
    min_size=1,
    max_size=40,
)


@given(
    notes=notes_strategy,
    tempos=st.lists(st.tuples(st.integers(0, 3000), st.integers(1, 2**24 - 1)), max_size=6),
    division=st.integers(1, 32767),
)
def test_times_agree_with_mido(tmp_path_factory, notes, tempos, division):
    """Random notes under random tempo maps; each key once, so that every reader pairs them alike."""
    timed, tick = [], 0
    for key, (delta, length, velocity, channel) in enumerate(notes):
        tick += delta
        on = mido.Message("note_on", note=key, velocity=velocity, channel=channel)
        off = mido.Message("note_off", note=key, channel=channel)
        timed += [(tick, 1, on), (tick + length, 0, off)]
    file = mido.MidiFile(ticks_per_beat=division)
    first = mido.MidiTrack([mido.MetaMessage("set_tempo", tempo=t, time=delta) for delta, t in tempos])
    second, now = mido.MidiTrack(), 0
    for tick, _, message in sorted(timed, key=lambda m: m[:2]):
        second.append(message.copy(time=tick - now))
        now = tick
    file.tracks += [first, second]
    buffer = io.BytesIO()
    file.save(file=buffer)
    path: Path = tmp_path_factory.getbasetemp() / "random.mid"
    path.write_bytes(buffer.getvalue())

    expected, time, begun = {}, 0.0, {}
    for message in mido.MidiFile(file=io.BytesIO(buffer.getvalue())):
        time += message.time
        if message.type == "note_on":
            begun[message.note] = time
        elif message.type == "note_off":
            expected[message.note] = (begun[message.note], time)
    try:
        got = {n.note: (n.time, n.time + n.duration) for n in read_midi(path, percussion=True).notes}
    except ScoreError:  # only the longest of them may be refused: for silence, or for their length
        assert max(end for _, end in expected.values()) > 900
        return
    assert got.keys() == expected.keys()
    for key, (begin, end) in expected.items():
        assert got[key][0] == pytest.approx(begin, rel=1e-9, abs=1e-9)
        assert got[key][1] == pytest.approx(begin + min(max(end - begin, MIN_DURATION), 600.0), rel=1e-9, abs=1e-9)


def test_end_of_track_is_where_the_builder_puts_it():
    """The builders themselves are sound: mido reads their files."""
    file = mido.MidiFile(file=io.BytesIO(header() + chunk(b"MTrk", ONE_NOTE + END)))
    assert [m.type for m in file.tracks[0]] == ["note_on", "note_off", "end_of_track"]


def register(channel: int, parameter: int, value: int) -> bytes:
    return b"".join(event(0, 0xB0 | channel, *pair) for pair in ((101, 0), (100, parameter), (6, value)))


MPE_NOTE = event(10, 0x91, 55, 90) + event(10, 0x81, 55, 0)


def test_zones_of_mpe_are_read_as_they_are_played_live(read):
    """MPE: members have 48 semitones, the master 2, which are added; the master's controllers reach the zone."""
    moves = event(10, 0xE1, 0, 68) + event(10, 0xE0, 0, 32) + event(10, 0xB0, 64, 127) + event(10, 0xD0, 64)
    ends = event(10, 0x81, 55, 0) + event(0, 0x89, 64, 0) + event(10, 0xB0, 64, 0) + event(10, 0xB1, 121, 0)
    notes = event(0, 0x91, 55, 90) + event(0, 0x99, 64, 90)
    found = read(smf(register(0, 6, 9) + notes + moves + ends + event(0, 0xB0, 121, 0)))
    bends = [(c.channel, c.value) for c in found.controls if c.kind == "bend"]
    # 4 * 128 / 8192 of 48 semitones; half way down of 2
    assert [cents for at, cents in bends if at == 1] == [300.0, 200.0, -100.0, 0.0]
    assert [cents for at, cents in bends if at == 9] == [-100.0, 0.0]
    assert [n.held is not None for n in found.notes] == [True, True]  # the master's pedal holds both
    assert {c.channel for c in found.controls if c.kind == "channel_pressure"} == set(range(10))
    assert not found.warnings  # channel 10 is no percussion here


def test_the_range_of_a_zone_is_that_of_parameter_0(read):
    """On a member it holds for all members, on the master for the master; a zone of none ends it."""
    wheels = event(5, 0xE1, 0, 96) + event(5, 0xE0, 0, 96)
    found = read(smf(register(0, 6, 5) + register(3, 0, 24) + register(0, 0, 12) + wheels + MPE_NOTE))
    assert [c.value for c in found.controls if c.channel == 1] == [1200.0, 1800.0]
    ended = read(smf(register(0, 6, 5) + register(0, 6, 0) + wheels + MPE_NOTE))
    assert [c.value for c in ended.controls if c.kind == "bend" and c.channel == 0] == [100.0]
    assert len([c for c in ended.controls if c.channel == 1]) == 1


@pytest.mark.parametrize("n", [16, 127])
def test_a_zone_of_more_channels_than_there_are_is_ignored_and_counted(read, n):
    wheel = event(5, 0xE0, 0, 96)
    found = read(smf(register(0, 6, n) + wheel + MPE_NOTE))
    assert found.ignored["zone of MPE of more than 15 channels"] == 1
    assert {c.channel for c in found.controls if c.kind == "bend"} == {0}
    largest = read(smf(register(0, 6, 15) + wheel + MPE_NOTE))
    assert not largest.ignored
    assert {c.channel for c in largest.controls if c.kind == "bend"} == set(range(16))


def test_a_master_cannot_multiply_controllers_beyond_a_limit(read, monkeypatch):
    monkeypatch.setattr("tonewood.performance.score.channel_reader.MAX_CONTROLS", 1000)
    with pytest.raises(ScoreError, match=r"\.mid: more than 1000 changes"):
        read(smf(register(0, 6, 15) + MPE_NOTE + b"".join(event(1, 0xB0, 1, i % 128) for i in range(100))))
    for message in (register(3, 0, 24), event(1, 0xC0, 5), register(0, 6, 15)):  # nothing that sounds changes
        with pytest.raises(ScoreError, match=r"\.mid: more than 1000 changes"):
            read(smf(register(0, 6, 15) + MPE_NOTE + message * 100))
        read(smf(register(0, 6, 15) + MPE_NOTE + message * 20))


@pytest.mark.parametrize("order", [1, -1])
def test_a_note_that_is_never_ended_lasts_until_the_longest_track_ends(read, order):
    held, longer = event(0, 0x90, 60, 80), event(1440, 0x91, 64, 80) + event(480, 0x81, 64, 0)
    assert spans(read(smf(*[held, longer][::order]))) == [(60, 0.0, 2.0), (64, 1.5, 2.0)]


def test_percussion_is_read_where_its_channel_is_asked_for(tmp_path):
    path = tmp_path / "piece.mid"
    drum = event(0, 0x99, 36, 80) + event(480, 0x89, 36, 0)
    path.write_bytes(smf(drum, event(0, 0x90, 60, 80) + event(480, 0x80, 60, 0)))
    for tracks, notes in ((None, [60]), ([1], [60]), ([10], [36]), ([1, 10], [36, 60])):
        assert sorted(n.note for n in read_score(path, tracks=tracks).notes) == notes
    (line,) = read_score(path).warnings  # the end of what is left out is no fault
    assert line.endswith("left out (--tracks 10 plucks them): channel 10, note 36 at 0.000 s")


@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_beats_of_music_at_another_tempo_fit_its_seconds(tmp_path: Path, factor: float) -> None:
    """From one change of tempo to the next, quarter notes are beats a minute times time; the onsets are on them."""
    file = mido.MidiFile(ticks_per_beat=96)
    events = [
        mido.MetaMessage("set_tempo", tempo=500_000, time=0),
        mido.Message("note_on", note=60, time=96), mido.Message("note_off", note=60, time=96),
        mido.MetaMessage("set_tempo", tempo=750_000, time=96),
        mido.MetaMessage("set_tempo", tempo=400_000, time=192),
    ]  # fmt: skip
    file.tracks.append(mido.MidiTrack(events))
    file.save(tmp_path / "a.mid")
    score = read_score(tmp_path / "a.mid", tempo=factor)
    assert score.beats is not None
    rows = list(score.beats.tempos)
    assert len(rows) == 3
    for (t, q, bpm), (after, then, _) in pairwise(rows):
        assert then - q == pytest.approx(bpm * (after - t) / 60)
    assert [note.time for note in score.notes] == pytest.approx([60 / rows[0][2]])
