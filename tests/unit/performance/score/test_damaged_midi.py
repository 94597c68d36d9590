"""Damaged MIDI files: readable parts are read, with a warning, or one line says why not. Nothing else happens."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st
from smf_bytes import END, ONE_NOTE, chunk, event, header, meta, smf, tempo, vlq

from tonewood.errors import ScoreError
from tonewood.performance.score import midi
from tonewood.performance.score.midi import MAX_BYTES, MAX_DURATION, MIN_DURATION, read_midi
from tonewood.performance.score.note import Score


@pytest.fixture
def read(tmp_path):
    def read(data: bytes) -> Score:
        path = tmp_path / "damaged.mid"
        path.write_bytes(data)
        return read_midi(path)

    return read


SECOND = event(0, 0x90, 67, 80) + event(480, 0x80, 67, 64)

READABLE = {  # name: (bytes, keys that must come out, word of the warning or None)
    "alien chunk before the track": (header() + chunk(b"JUNK", b"12345") + smf(ONE_NOTE)[14:], [60], "unknown chunk"),
    "stray bytes between tracks": (
        header(1, 2) + chunk(b"MTrk", ONE_NOTE + END) + b"\x01\x02\x03" + chunk(b"MTrk", SECOND + END),
        [60, 67],
        "stray",
    ),
    "data byte over 127": (smf(event(0, 0x90, 0x80 | 60, 80) + event(480, 0x80, 60, 64)), [60], "over 127"),
    "division 32767": (smf(event(0, 0x90, 60, 80) + event(32767, 60, 0), division=32767), [60], None),
    "format 0 with two tracks": (smf(ONE_NOTE, SECOND, form=0), [60, 67], "format 0"),
    "format 7": (smf(ONE_NOTE, form=7), [60], "format 7"),
    "long header": (header(extra=b"\0\0\0\0") + smf(ONE_NOTE)[14:], [60], None),
    "header length beyond the file": (
        b"MThd" + (2**31).to_bytes(4, "big") + smf(ONE_NOTE)[8:],
        [60],
        "header's length",
    ),
    "more tracks announced": (header(1, 5) + smf(ONE_NOTE)[14:], [60], "announces 5"),
    "fewer tracks announced": (header(1, 1) + smf(ONE_NOTE, SECOND)[14:], [60, 67], "holds 2"),
    "no end of track": (smf(ONE_NOTE, end=b""), [60], "end-of-track"),
    "track longer than the file": (header() + chunk(b"MTrk", ONE_NOTE + END, 9999), [60], "length is wrong"),
    "first track's length swallows the second": (
        header(1, 2) + chunk(b"MTrk", ONE_NOTE + END, 9999) + chunk(b"MTrk", SECOND + END),
        [60, 67],
        "length is wrong",
    ),
    "track length too short": (
        header(1, 2) + chunk(b"MTrk", ONE_NOTE + END, 5) + chunk(b"MTrk", SECOND + END),
        [60, 67],
        "length is wrong",
    ),
    "broken off inside an event": (
        smf(ONE_NOTE + event(0, 0x90, 64, 80) + b"\x83\x60", end=b""),
        [60, 64],
        "ends inside",
    ),
    "meta event longer than the track": (
        smf(ONE_NOTE + meta(0, 1, b"abc", length=2**28 - 1)),
        [60],
        "leaves the track",
    ),
    "system exclusive longer than the track": (
        smf(ONE_NOTE + b"\0\xf0" + vlq(9999) + b"\x43"),
        [60],
        "leaves the track",
    ),
    "number of variable length without end": (smf(ONE_NOTE + b"\xff\xff\xff\xff\xff"), [60], "does not end"),
    "data without status after a note": (
        header(1, 2) + chunk(b"MTrk", b"\0\x40\x50" + END) + chunk(b"MTrk", ONE_NOTE + END),
        [60],
        "without a status",
    ),
    "split system exclusive": (smf(b"\0\xf0\x03\x43\x12\x00" + b"\x0a\xf7\x03\x43\x12\xf7" + ONE_NOTE), [60], None),
    "realtime bytes in the track": (smf(event(0, 0xF8) + event(0, 0xF2, 1, 2) + ONE_NOTE), [60], "does not belong"),
    "tempo 0": (smf(tempo(0, 0) + ONE_NOTE), [60], "tempo"),
    "tempo of two bytes": (smf(meta(0, 0x51, b"\x07\xa1") + ONE_NOTE), [60], "tempo"),
    "note-off alone": (smf(event(0, 0x80, 60, 64) + ONE_NOTE), [60], "note-off without a note"),
    "note never ended": (smf(ONE_NOTE + event(0, 0x90, 64, 80) + event(480, 0xB0, 1, 0)), [60, 64], "never ended"),
    "padding after the last track": (smf(ONE_NOTE) + b"\0" * 11, [60], None),
    "percussion channel": (smf(event(0, 0x99, 36, 80) + event(480, 0x89, 36, 0) + ONE_NOTE), [60], "percussion"),
}


@pytest.mark.parametrize("name", READABLE)
def test_what_can_be_read_is_read(read, name):
    data, keys, warning = READABLE[name]
    score = read(data)
    assert [n.note for n in score.notes] == keys
    if warning is None:
        assert score.warnings == ()
    else:
        assert any(warning in line for line in score.warnings), score.warnings
    assert all("\n" not in line for line in score.warnings)


REFUSED = {
    "empty file": (b"", "empty"),
    "text": (b"not music at all", "MThd"),
    "header only": (header(), "no track"),
    "half a header": (header()[:11], "broken off"),
    "short header": (chunk(b"MThd", b"\0\0\0\1"), "broken off"),
    "division 0": (smf(ONE_NOTE, division=0), "division 0"),
    "SMPTE with no ticks": (smf(ONE_NOTE, division=0xE700), "0 ticks per frame"),
    "SMPTE with 77 frames": (smf(ONE_NOTE, division=(256 - 77) << 8 | 10), "77 frames"),
    "RIFF of another kind": (b"RIFF\x04\0\0\0WAVE", "RIFF"),
    "RIFF without data": (b"RIFF\x04\0\0\0RMID", "RIFF"),
    "no note before the fault": (smf(b"\0\x40\x50"), "without a status"),
    "a first note after nine hours": (smf(event(480 * 64800, 0x90, 60, 80)), "silence"),
    "silence of nine hours": (smf(ONE_NOTE + event(480 * 64800, 0x90, 62, 80) + event(1, 62, 0)), "silence"),
    "silence in small pieces": (smf((ONE_NOTE + event(480 * 200, 0xB0, 1, 1)) * 11), "silence"),
    "a day of music": (smf((event(0, 0x90, 60, 80) + event(480 * 100, 60, 0)) * 1800), "s of music"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_gives_one_line(read, name):
    data, reason = REFUSED[name]
    with pytest.raises(ScoreError) as caught:
        read(data)
    line = str(caught.value)
    assert reason in line
    assert "damaged.mid: " in line
    assert "\n" not in line


@pytest.mark.parametrize("name", ["no such file", "folder", "nul"])
def test_what_is_not_a_file_gives_one_line(tmp_path, name):
    path = {"no such file": tmp_path / "absent.mid", "folder": tmp_path, "nul": tmp_path / "a\0b.mid"}[name]
    with pytest.raises(ScoreError):
        read_midi(path)


def test_a_file_beyond_the_size_limit_is_not_even_opened(tmp_path):
    path = tmp_path / "huge.mid"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    with pytest.raises(ScoreError, match=f"{MAX_BYTES + 1} bytes"):
        read_midi(path)


def test_number_of_notes_and_messages_is_limited(read, monkeypatch):
    monkeypatch.setattr(midi, "MAX_NOTES", 9)
    with pytest.raises(ScoreError, match="10 notes: 9 are allowed"):
        read(smf(ONE_NOTE * 10))
    monkeypatch.setattr("tonewood.performance.score.smf.MAX_MESSAGES", 19)
    with pytest.raises(ScoreError, match="more than 19 MIDI messages"):
        read(smf(ONE_NOTE * 5, ONE_NOTE * 5))
    for change in (b"\xff\x51\x03\x07\xa1\x20", b"\xff\x58\x04\x03\x02\x18\x08"):
        with pytest.raises(ScoreError, match="more than 19 MIDI messages, tempos and meters"):
            read(smf((b"\x01" + change) * 18 + ONE_NOTE))
        assert len(read(smf((b"\x01" + change) * 17 + ONE_NOTE)).notes) == 1


@pytest.mark.parametrize(("status", "most"), [(0xA0, 240), (0xE0, 300)])
def test_memory_of_a_message_is_limited(tmp_path, status, most):
    """Bytes of the largest state while 20,000 messages are read: 10⁶ of them, or 600,000 changes, fit in 300 MB."""
    path = tmp_path / "a.mid"
    path.write_bytes(smf(ONE_NOTE + b"".join(event(1, status, i & 127, i >> 7 & 127) for i in range(20_000))))
    read_midi(path)
    tracemalloc.start()
    read_midi(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / 20_000 < most


def test_notes_of_no_length_and_endless_notes_are_bounded(read):
    score = read(smf(event(0, 0x90, 60, 80) + event(0, 60, 0) + event(0, 62, 80) + event(480 * 7200, 62, 0)))
    assert [n.duration for n in score.notes] == [MIN_DURATION, MAX_DURATION]
    assert ["shorter" in score.warnings[0], "longer" in score.warnings[1]] == [True, True]


def test_oddities_of_a_kind_share_one_line(read):
    score = read(smf(event(0, 0x80, 60, 64) * 500 + ONE_NOTE))
    assert score.warnings == ("note-off without a note, ignored: channel 1, note 60 at 0.000 s (and 499 more)",)


def test_one_pitch_on_sixteen_channels_is_sixteen_notes(read):
    ons = b"".join(event(0, 0x90 | c, 52, 60 + c) for c in range(16))
    offs = b"".join(event(960 if c == 0 else 0, 0x80 | c, 52, 0) for c in range(16))
    found = read(smf(ons + offs))
    assert [(n.channel, n.duration) for n in found.notes] == [(c, 1.0) for c in range(16) if c != 9]
    assert [p.n_drums for p in found.parts] == [1 if c == 9 else 0 for c in range(16)]


@pytest.mark.slow
def test_false_lengths_in_every_track_do_not_multiply_the_work(read):
    """Each of 2000 tracks points into the middle of a large file: reading must not search it anew for each."""
    tracks = (b"MTrk" + (2**21).to_bytes(4, "big") + b"\0\x90") * 1999
    data = header(1, 2000) + tracks + b"\x01" * 2**22 + chunk(b"MTrk", ONE_NOTE + END)
    with pytest.raises(ScoreError, match="MIDI messages"):
        read(data)


def outcome(path, data: bytes) -> Score | None:
    """Read the bytes: a score that holds together, or None for an orderly refusal."""
    path.write_bytes(data)
    try:
        score = read_midi(path)
    except ScoreError:
        return None
    assert all(a.time <= b.time for a, b in zip(score.notes, score.notes[1:], strict=False))
    assert all(MIN_DURATION <= n.duration <= MAX_DURATION for n in score.notes)
    assert all(0 <= n.note <= 127 and 1 <= n.velocity_midi <= 127 and 0 <= n.channel < 16 for n in score.notes)
    assert len(score.warnings) < 30
    return score


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz") / "fuzz.mid"


PIECE = smf(
    meta(0, 3, b"conductor") + tempo(0, 500_000) + tempo(960, 400_000),
    ONE_NOTE + event(0, 0xB0, 64, 127) + SECOND + event(10, 0xE0, 0, 0) + event(0, 0xB0, 64, 0),
    b"\0\xf0" + vlq(3) + b"\x43\x12\xf7" + event(0, 0xC1, 24) + event(0, 0x91, 50, 70) + event(200, 50, 0),
)


@given(st.binary(max_size=300))
def test_random_bytes_end_well(scratch, data):
    outcome(scratch, data)
    outcome(scratch, header() + data)
    outcome(scratch, smf(data))


@given(
    st.lists(st.tuples(st.integers(0, len(PIECE) - 1), st.integers(0, 255)), min_size=1, max_size=8),
    st.integers(0, len(PIECE)),
    st.binary(max_size=4),
)
def test_mutations_end_well(scratch, changes, cut, inserted):
    data = bytearray(PIECE)
    for place, value in changes:
        data[place] = value
    outcome(scratch, bytes(data))
    outcome(scratch, bytes(data[:cut] + inserted + data[cut:]))
    outcome(scratch, bytes(data[:cut]))


def test_every_truncation_keeps_the_notes_before_it(scratch):
    """Cutting the file anywhere never adds a note, and once the first is whole it is never lost again."""
    counts = []
    for cut in range(len(PIECE) + 1):
        score = outcome(scratch, PIECE[:cut])
        counts.append(0 if score is None else len(score.notes))
    assert counts == sorted(counts)
    assert counts[-1] == 3
