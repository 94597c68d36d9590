"""Signs of Guitar Pro: against what alphaTab (2026) plays of files, and closed forms of harmonics."""

from __future__ import annotations

import math
import struct
import zipfile
from pathlib import Path
from typing import Any

import pytest
from tablatures import enabled, gpif, gpx_bits, gpx_system, guitar_pro

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.performance.score.gpx import _expanded, gpx_score
from tonewood.performance.score.harmonics import interval, partial_at
from tonewood.performance.score.unfolding import Measure, order

NOTES = [(0, 0, "", ""), (1, 2, "", ""), (2, 5, "", ""), (3, 7, "", "")]


def edited(path: Path, *changes: tuple[str, str], notes: list[tuple[int, int, str, str]] = NOTES) -> tw.Score:
    """A score of Guitar Pro 7 with texts replaced by others."""
    with zipfile.ZipFile(gpif(path, notes)) as archive:
        text = archive.read("Content/score.gpif").decode()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Content/score.gpif", text)
    return tw.read_score(path)


def value(name: str, kind: str, number: object) -> str:
    return f'<Property name="{name}"><{kind}>{number}</{kind}></Property>'


def harmonic(kind: str, fret: float) -> str:
    return enabled("Harmonic") + value("HarmonicType", "HType", kind) + value("HarmonicFret", "HFret", fret)


def test_guitar_pro_6_is_read_plain_and_compressed(tmp_path: Path) -> None:
    path = gpif(tmp_path / "a.gp", NOTES)
    with zipfile.ZipFile(path) as archive:
        system = gpx_system(archive.read("Content/score.gpif"))
    expected = tw.read_score(path).notes
    (tmp_path / "plain.gpx").write_bytes(system)
    # the empty first sector by references that double what is there
    bits = gpx_bits(system[:4], system[4:8], (4, 4), *((2**i, 2**i) for i in range(3, 12)), system[4 + 0x1000 :])
    (tmp_path / "packed.gpx").write_bytes(b"BCFZ" + struct.pack("<i", len(system)) + bits)
    for name in ("plain.gpx", "packed.gpx"):
        assert tw.read_score(tmp_path / name).notes == expected
    (tmp_path / "cut.gpx").write_bytes(system[:-0x1000])
    with pytest.raises(ScoreError, match=r"score.gpif ends early"):
        tw.read_score(tmp_path / "cut.gpx")
    # the last sector describes the file, and is cut within its numbers of sectors
    (tmp_path / "cut.gpx").write_bytes(system[: 4 + 0x1000 + 0x94] + struct.pack("<2i", 1, 1) + b"\1\0")
    with pytest.raises(ScoreError, match=r"score.gpif ends early"):
        tw.read_score(tmp_path / "cut.gpx")


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (struct.pack("<i", 100) + gpx_bits((5, 5)), "bytes before its beginning"),
        (struct.pack("<i", 2**30), "bytes, expanded"),
        (struct.pack("<i", 8) + gpx_bits(b"ABCDEFGH"), "no file system"),
        (b"", "ends early"),
    ],
)
def test_a_damaged_container_is_one_line(data: bytes, line: str) -> None:
    with pytest.raises(ScoreError, match=line):
        gpx_score(b"BCFZ" + data, Path("a.gpx"))


@pytest.mark.parametrize(
    ("size", "length", "line"),
    [
        # 4 MiB of a small file, 300 times a larger one, 32 MiB of any; 2 MiB compressed
        (8, 2**22, "no file system"),
        (8, 2**22 + 1, "4194305 bytes, expanded"),
        (14_000, 4_200_000, "no file system"),
        (14_000, 4_200_001, "4200001 bytes, expanded"),
        (2**21, 2**25 + 1, "33554433 bytes, expanded"),
        (2**21 + 1, 8, "2097152 are allowed"),
        (8, 3, "3 bytes, expanded"),
    ],
)
def test_sizes_of_a_container_that_are_allowed(size: int, length: int, line: str) -> None:
    """After the head come zeros: pieces of no bytes."""
    with pytest.raises(ScoreError, match=line):
        gpx_score((b"BCFZ" + struct.pack("<i", length)).ljust(size, b"\0"), Path("a.gpx"))


def test_references_repeat_no_more_than_is_behind_them() -> None:
    """Widths of 3 and 15 bits; two bytes back, of which five are asked for, are two."""
    bits = "0" + "11" + "".join(f"{b:08b}" for b in b"BCF") + "0" + "10" + f"{ord('S'):08b}"
    bits += "1" + "0011" + "010" + "101" + "1" + "1111" + f"{2:015b}"[::-1] + f"{1:015b}"[::-1]
    bits += "0" + "10" + f"{ord('!'):08b}"
    data = int(bits.ljust(-len(bits) % 8 + len(bits), "0"), 2).to_bytes(-(-len(bits) // 8), "big")
    assert _expanded(b"BCFZ" + struct.pack("<i", 8) + data, Path("a.gpx")) == b"BCFSFSF!"


def test_nodes_of_a_string_leave_their_partials() -> None:
    """A touch at the fret over k/n leaves the n-th partial, n times the string's frequency."""
    for n in range(2, 9):
        for k in range(1, n):
            if math.gcd(k, n) == 1:
                assert partial_at(-12 * math.log2(1 - k / n)) == n
    assert [interval(n) for n in range(2, 9)] == [12, 19, 24, 28, 31, 34, 36]
    # the frets that players name
    named = {12: 2, 7: 3, 19: 3, 5: 4, 24: 4, 4: 5, 9: 5, 16: 5, 3.2: 6, 2.7: 7, 5.8: 7, 9.6: 7, 14.7: 7, 8.2: 8, 17: 8}
    assert {fret: partial_at(fret) for fret in named} == named
    assert [partial_at(fret) for fret in (1, 11, 13, 18)] == [None] * 4


def test_harmonics_sound_at_their_pitch(tmp_path: Path) -> None:
    """Natural ones over the open string, others over the fret; one at no node is plucked as written."""
    notes = [
        (1, 7, harmonic("Natural", 7), ""), (1, 2, harmonic("Artificial", 12), ""), (1, 2, harmonic("Pinch", 5), ""),
        (1, 2, harmonic("Tap", 7), ""), (1, 11, harmonic("Natural", 11), ""),
    ]  # fmt: skip
    score = edited(tmp_path / "a.gp", notes=notes)
    assert [(n.note, n.stop, n.partial) for n in score.notes] == [
        (45 + 19, 0.0, 3), (47 + 12, 2.0, 2), (47 + 24, 2.0, 4), (47 + 19, 2.0, 3), (56, 11.0, None),
    ]  # fmt: skip
    assert score.ignored == {"harmonic that touches no node, plucked as a note": 1}


@pytest.mark.parametrize(("stroke", "n"), [("1/2", 2), ("1/4", 4), ("1/8", 8), ("1/3", 1)])
def test_strokes_of_a_tremolo_in_a_quarter_note(tmp_path: Path, stroke: str, n: int) -> None:
    score = edited(tmp_path / "a.gp", ('<Beat id="0">', f'<Beat id="0"><Tremolo>{stroke}</Tremolo>'))
    assert [note.time for note in score.notes][: n + 1] == pytest.approx([*(i / n for i in range(n)), 1.0])


def test_a_tie_over_a_rest_is_not_struck(tmp_path: Path) -> None:
    """It joins the note before it on its string, as far back as three measures; so does a legato slide."""
    tie = '<Tie origin="false" destination="true"/>'
    tied = tw.read_score(gpif(tmp_path / "a.gp", [(1, 2, "", ""), (2, 5, "", ""), (1, 2, "", tie)])).notes
    assert [(n.time, n.note, n.duration) for n in tied] == [(0.0, 47.0, 3.0), (1.0, 55.0, 1.0)]
    slide = value("Slide", "Flags", 2)
    slid = tw.read_score(gpif(tmp_path / "b.gp", [(1, 2, slide, ""), (2, 5, "", ""), (1, 4, "", "")])).notes
    assert [(n.time, n.duration, n.glides) for n in slid] == [(0.0, 3.0, ((2.0, 2.0),)), (1.0, 1.0, ())]


@pytest.mark.parametrize("version", [3, 4, 5])
def test_a_tie_beyond_three_measures_is_struck_at_its_own_fret(version: int, tmp_path: Path) -> None:
    """As alphaTab plays it: no note is near that it could hold; the file says its fret (pyguitarpro writes 0)."""
    import guitarpro as gp

    def later(song: gp.Song, measures: int) -> None:
        track = song.tracks[0]
        for number in range(2, measures + 2):
            header = gp.MeasureHeader(number=number, start=song.measureHeaders[-1].start + 4 * 960)
            song.addMeasureHeader(header)
            track.measures.append(gp.Measure(track, header))
        beat = gp.Beat(track.measures[-1].voices[0], status=gp.BeatStatus.normal)
        beat.notes.append(gp.Note(beat, value=9, string=5, type=gp.NoteType.tie))
        track.measures[-1].voices[0].beats.append(beat)

    for measures, struck in ((3, []), (4, [(16.0, 45.0)])):
        path = guitar_pro(tmp_path / f"a.gp{version}", lambda song, _, n=measures: later(song, n))
        assert [(n.time, n.note) for n in tw.read_score(path).notes[4:]] == struck


def test_notes_at_negative_frets(tmp_path: Path) -> None:
    """Below the open string they are notes by pitch; a dead grace note without a fret is on the open string."""
    (one,) = tw.read_score(gpif(tmp_path / "a.gp", [(1, -3, "", "")])).notes
    assert (one.note, one.stop) == (42.0, None)
    import guitarpro as gp

    def grace(_: gp.Song, beats: list[gp.Beat]) -> None:
        beats[2].notes[0].effect.grace = gp.GraceEffect(fret=-1, isDead=True)

    before = tw.read_score(guitar_pro(tmp_path / "a.gp3", grace)).notes[2]
    assert (before.note, before.stop, "dead_note" in before.marks) == (50.0, 0.0, True)


@pytest.mark.parametrize(
    ("bars", "played"),
    [
        # opens, closes, endings of each measure -> measures as alphaTab plays them
        ([(1, 0, ()), (0, 4, ()), (0, 0, ())], [0, 1, 0, 1, 0, 1, 0, 1, 2]),
        ([(0, 2, ()), (0, 0, (1, 2)), (0, 2, ())], [0, 0, 1, 2, 0, 0, 1, 2]),
        # a repeat sign in a measure that the second pass skips ends the repeat
        ([(1, 0, ()), (0, 2, (1,)), (0, 0, ())], [0, 1, 0, 2]),
        ([(1, 0, ()), (0, 2, (1, 2, 3)), (0, 2, (4,)), (0, 0, (1, 2, 3, 5))], [0, 1, 0, 1, 0, 1, 0, 1, 3]),
        # an ending lasts until the next one
        ([(1, 0, ()), (0, 0, (1, 3)), (0, 0, (2,)), (0, 4, ()), (0, 0, ())], [0, 1, 0, 2, 3, 0, 1, 0, 4]),
        # a repeat in a repeat
        ([(1, 0, ()), (1, 2, ()), (0, 2, ()), (0, 0, ())], [0, 1, 1, 2, 0, 1, 1, 2, 3]),
        # one that is never closed
        ([(1, 0, ()), (0, 0, ()), (1, 2, ())], [0, 1, 2, 2]),
    ],
)
def test_repeats_as_guitar_pro_has_them(bars: list[tuple[int, int, tuple[int, ...]]], played: list[int]) -> None:
    measures = [Measure(opens=bool(o), closes=c, endings=frozenset(e)) for o, c, e in bars]
    assert order(measures, tablature=True) == played


def test_jumps_name_what_they_obey() -> None:
    def names(*signs: set[str]) -> str:
        return "".join("abcdefgh"[i] for i in order([Measure(signs=s) for s in signs], tablature=True))

    assert names(set(), {"fine"}, {"da_capo_al_fine"}, set()) == "abcab"
    assert names(set(), {"fine"}, {"da_capo"}, set()) == "abcabcd"
    assert names({"segno"}, {"to_coda"}, {"dal_segno_al_coda"}, {"coda"}) == "abcabd"
    assert names({"segno"}, {"to_coda"}, {"dal_segno_al_double_coda"}, {"coda"}) == "abcabcd"
    double = [{"segno_segno"}, {"to_double_coda"}, {"dal_segno_segno_al_double_coda"}, set(), {"double_coda"}]
    assert names(*double) == "abcabe"
    # of two segnos the one before; a coda before its sign, where there is none after it
    assert names({"segno"}, {"segno"}, {"dal_segno"}) == "abcbc"
    assert names({"coda"}, {"to_coda"}, {"da_capo_al_coda"}) == "abcab" + "abc"


def test_similes_anacruses_and_drums(tmp_path: Path) -> None:
    """A measure of % is the one before it; an upbeat is as long as its beats; drums are counted."""
    bars = "<Bars>0</Bars></MasterBar>"
    more = bars + "<MasterBar><Time>4/4</Time><Bars>1</Bars></MasterBar>" * 2
    simile = '<Bars><Bar id="1"><Voices>-1</Voices><SimileMark>Simple</SimileMark></Bar>'
    notes = NOTES[:2]
    score = edited(tmp_path / "a.gp", (bars, more), ("<Bars><Bar ", simile + "<Bar "), notes=notes)
    assert [(n.time, n.note) for n in score.notes] == [
        (4.0 * i + j, p) for i in range(3) for j, p in ((0, 40), (1, 47))
    ]
    begins = ("<MasterTrack>", "<MasterTrack><Anacrusis/>")
    upbeat = edited(tmp_path / "b.gp", (bars, more), ("<Bars><Bar ", simile + "<Bar "), begins, notes=notes)
    assert [n.time for n in upbeat.notes] == [0.0, 1.0, 2.0, 3.0, 6.0, 7.0]
    kit = ("<Name>Guitar", "<InstrumentSet><Type>drumKit</Type></InstrumentSet><Name>Guitar")
    drums = edited(tmp_path / "c.gp", kit, notes=notes)
    assert (len(drums.notes), drums.ignored) == (0, {"note of a percussion track": 2})


def test_grace_notes_before_and_on_the_beat(tmp_path: Path) -> None:
    """One takes a 32nd, each of two a 64th; before the first beat they let all begin later."""
    second, third = '<Beat id="1">', '<Beat id="2">'
    for where, times in (("BeforeBeat", [0.0, 0.9375, 0.96875, 1.0]), ("OnBeat", [0.0, 1.0, 1.0625, 1.125])):
        grace = f"<GraceNotes>{where}</GraceNotes>"
        score = edited(tmp_path / "a.gp", (second, second + grace), (third, third + grace))
        assert [n.time for n in score.notes] == pytest.approx(times if where == "OnBeat" else [0.0, 0.875, 0.9375, 1.0])
    first = '<Beat id="0">'
    score = edited(tmp_path / "b.gp", (first, first + "<GraceNotes>BeforeBeat</GraceNotes>"))
    assert [n.time for n in score.notes] == pytest.approx([0.0, 0.125, 1.125, 2.125])


def test_grace_notes_with_no_beat_after_them_follow_the_last_one(tmp_path: Path) -> None:
    third, fourth = '<Beat id="2">', '<Beat id="3">'
    grace = "<GraceNotes>BeforeBeat</GraceNotes>"
    score = edited(tmp_path / "a.gp", (third, third + grace), (fourth, fourth + grace))
    assert [n.time for n in score.notes] == pytest.approx([0.0, 1.0, 2.0, 2.0625])


def test_strums_rasgueados_and_dead_slaps(tmp_path: Path) -> None:
    chord = ("<Beats>0 1 2 3</Beats>", "<Beats>0</Beats>"), ("<Notes>0</Notes>", "<Notes>0 1 2 3</Notes>{}")
    brush = '<XProperties><XProperty id="687935489"><Int>480</Int></XProperty></XProperties><Properties>'
    brush += '<Property name="Brush"><Direction>{}</Direction></Property></Properties>'
    up, down = (
        edited(tmp_path / "a.gp", chord[0], (chord[1][0], chord[1][1].format(brush.format(way)))).notes
        for way in ("Up", "Down")
    )
    assert [n.note for n in down] == [40, 47, 55, 62]
    assert [n.note for n in up] == [62, 55, 47, 40]
    assert [n.time for n in down] == pytest.approx([0, 0.5 / 3, 1 / 3, 0.5])
    finger = '<Properties><Property name="Rasgueado"><Rasgueado>mii_2</Rasgueado></Property></Properties>'
    many = edited(tmp_path / "b.gp", chord[0], (chord[1][0], chord[1][1].format(finger))).notes
    # three strokes in an anapaest of a quarter note, each spread over a quarter of itself
    assert [n.time for n in many[::4]] == pytest.approx([0.0, 0.25, 0.5])
    assert [n.note for n in many[8:]] == [62, 55, 47, 40]
    slap = edited(tmp_path / "c.gp", ("<Notes>0</Notes>", "<Notes/><DeadSlapped/>"))
    assert [(n.note, "dead_note" in n.marks) for n in slap.notes[:6]] == [(p, True) for p in (40, 45, 50, 55, 59, 64)]


def test_whammy_ornaments_trills_and_slides(tmp_path: Path) -> None:
    first = '<Beat id="0">'
    whammy = '<Whammy originValue="0" middleValue="-50" middleOffset1="50" middleOffset2="50" destinationValue="0" '
    score = edited(tmp_path / "a.gp", (first, f'{first}{whammy} destinationOffset="100"/>'))
    bent = {round(c.time, 2): c.value for c in score.controls}
    assert (bent[0.5], bent[0.24], min(bent.values())) == (-100.0, -48.0, -100.0)
    older = "".join(
        value(f"WhammyBar{name}", "Float", number)
        for name, number in (("MiddleValue", -50), ("MiddleOffset1", 50), ("MiddleOffset2", 50))
    )
    older = f'{first}<Properties><Property name="WhammyBar"><Enable/></Property>{older}</Properties>'
    assert edited(tmp_path / "b.gp", (first, older)).controls == score.controls
    notes = [
        (2, 2, "", "<Ornament>Turn</Ornament>"), (2, 2, "", "<Trill>54</Trill>"),
        (2, 2, value("Slide", "Flags", 16 + 8), ""), (2, 2, value("Slide", "Flags", 64), ""),
    ]  # fmt: skip
    signs = edited(tmp_path / "c.gp", notes=notes)
    # E turns over F and D sharp in a sixteenth, then E trills with F sharp in sixteenths
    assert [n.note for n in signs.notes[:8]] == [53, 52, 51, 52, 52, 54, 52, 54]
    assert [n.time for n in signs.notes[:8]] == pytest.approx([0, 1 / 12, 1 / 6, 0.25, 1, 1.25, 1.5, 1.75])
    # from two frets below, and two frets up and away
    assert signs.notes[8].glides == ((0.0, -2.0), (0.15, 0.0), (1.0, 2.0))
    assert signs.ignored == {"pick slide": 1}


def test_slides_go_two_frets_and_not_beyond_the_nut(tmp_path: Path) -> None:
    flags = {(5, 4): -2.0, (1, 4): -1.0, (1, 8): 2.0, (5, 32): 2.0, (1, 16): -1.0}
    notes = [(2, fret, value("Slide", "Flags", flag), "") for fret, flag in flags]
    glides = [note.glides for note in edited(tmp_path / "a.gp", notes=notes).notes]
    assert [glide[0 if flag > 8 else -1][1] for glide, (_, flag) in zip(glides, flags, strict=True)] == [
        *flags.values()
    ]


def test_swing_moves_the_second_of_two(tmp_path: Path) -> None:
    eighths = ("<NoteValue>Quarter</NoteValue>", "<NoteValue>Eighth</NoteValue>")
    for feel, late in (("Triplet8th", 2 / 3), ("Dotted8th", 3 / 4), ("Scottish8th", 1 / 4)):
        swung = ("<Time>4/4</Time>", f"<Time>4/4</Time><TripletFeel>{feel}</TripletFeel>")
        score = edited(tmp_path / "a.gp", eighths, swung)
        assert [n.time for n in score.notes] == pytest.approx([0, late, 1, 1 + late])


@pytest.mark.parametrize("version", [3, 4, 5])
def test_a_tempo_in_the_first_beat_replaces_that_of_the_head(version: int, tmp_path: Path) -> None:
    """As TuxGuitar reads it; of two tracks the later one decides, as alphaTab and TuxGuitar play it."""
    import guitarpro as gp

    def change(song: gp.Song, beats: list[gp.Beat]) -> None:
        song.tracks.append(gp.Track(song, number=2))
        second = gp.Beat(song.tracks[1].measures[0].voices[0], status=gp.BeatStatus.rest, duration=gp.Duration(1))
        second.voice.beats.append(second)
        for beat, bpm, duration in ((beats[0], 90, 0), (second, 80, 0), (beats[2], 120, 2)):
            tempo = gp.MixTableItem(value=bpm, duration=duration)
            beat.effect.mixTableChange = gp.MixTableChange(tempo=tempo, volume=gp.MixTableItem(value=9))

    score = tw.read_score(guitar_pro(tmp_path / f"a.gp{version}", change, tempo=100))
    assert [n.time for n in score.notes] == pytest.approx([0.0, 0.75, 1.5, 2.0])
    assert score.ignored == {"change of volume": 3, "gradual change of tempo, made at once": 1}


def test_sustain_pedal_of_a_track(tmp_path: Path) -> None:
    """A note that ends while the pedal is down lasts until it comes up; moves that say nothing are counted."""
    move = "<Automation><Type>SustainPedal</Type><Bar>0</Bar><Position>{}</Position><Value>0 {}</Value></Automation>"
    moves = "".join(move.format(at, value) for at, value in ((0.375, 1), (0.625, 3), (0.75, 2)))
    score = edited(tmp_path / "a.gp", ("</Staves></Track>", f"</Staves><Automations>{moves}</Automations></Track>"))
    assert [n.duration for n in score.notes] == pytest.approx([1.0, 1.5, 1.0, 1.0])
    assert {(c.time, c.value) for c in score.controls} == {(1.5, 1.0), (2.5, 0.0)}
    assert score.ignored == {"sustain pedal that cannot be read": 1}


@pytest.mark.parametrize("version", [3, 4, 5])
def test_points_of_a_bend_that_are_left_out_are_counted(tmp_path: Path, version: int) -> None:
    """One of 20 million quarter tones; the other, 4 of them, is a whole tone when the note ends."""

    def change(_: Any, beats: Any) -> None:
        import guitarpro as gp

        points = [gp.BendPoint(0, 0), gp.BendPoint(6, 20_000_000), gp.BendPoint(12, 4)]
        beats[0].notes[0].effect.bend = gp.BendEffect(type=gp.BendType.bend, value=100, points=points)

    score = tw.read_score(guitar_pro(tmp_path / f"a.gp{version}", change))
    assert score.ignored == {"point of a bend beyond 48 semitones": 1}
    assert max(c.value for c in score.controls if c.kind == "bend") == pytest.approx(200.0, abs=5.0)


@pytest.mark.parametrize("version", [3, 4])
def test_a_note_on_a_string_that_the_track_does_not_have_is_counted(tmp_path: Path, version: int) -> None:
    def last_on_string_6(song: Any, beats: list[Any]) -> None:
        for beat, string in zip(beats, (3, 4, 5, 6), strict=True):
            beat.notes[0].string = string

    path = guitar_pro(tmp_path / f"a.gp{version}", last_on_string_6)
    tuning = struct.pack("<6i", 64, 59, 55, 50, 45, 40)
    data = path.read_bytes().replace(struct.pack("<i", 6) + tuning, struct.pack("<i", 5) + tuning)
    path.write_bytes(data + bytes(8))
    score = tw.read_score(path)
    assert [note.note for note in score.notes] == [55, 52, 50]
    assert score.ignored["note on a string that the track does not have"] == 1


@pytest.mark.parametrize(
    ("old", "new", "counted", "n"),
    [
        ("<Bars>0</Bars>", "<Bars>7</Bars>", "bar that is not in the file", 1),
        ("<Voices>0 -1", "<Voices>9 -1", "voice that is not in the file", 1),
        ("<Notes>1</Notes>", "<Notes>99</Notes>", "note that is not in the file", 1),
        ('<Rhythm ref="0"/>', '<Rhythm ref="9"/>', "rhythm that is not in the file", 4),
        ("<Fret>0</Fret></Property></Properties></Staff>", "<Fret>1x</Fret></Property></Properties></Staff>",
         "capo that cannot be read", 1),
        ('<Property name="CapoFret">', '<Property name="PartialCapoFret"><Fret>2</Fret></Property><Property name="C">',
         "capo on some strings", 1),
        ("<Dynamic>F</Dynamic>", "<Dynamic>FX</Dynamic>", "dynamic that is not known", 4),
        ("<Dynamic>F</Dynamic>", "<Tremolo>1/3</Tremolo>", "tremolo that is not known", 4),
        ("<Time>", "<TripletFeel>Waltz</TripletFeel><Time>", "swing that is not known", 1),
        ("<Time>", "<TripletFeel>NoTripletFeel</TripletFeel><Time>", "swing that is not known", 0),
        ("<Time>", '<Repeat end="true" count="129"/><Time>', "repeat count outside 0 to 128", 1),
        ("</Note>", "<Ornament>Trillo</Ornament></Note>", "ornament that is not known", 4),
    ],
)  # fmt: skip
def test_what_a_file_lacks_or_names_otherwise_is_counted(
    tmp_path: Path, old: str, new: str, counted: str, n: int
) -> None:
    assert edited(tmp_path / "a.gp", (old, new)).ignored == ({counted: n} if n else {})


def test_nested_tuplets_and_many_repeats(tmp_path: Path) -> None:
    nested = '<PrimaryTuplet num="3" den="2"/><SecondaryTuplet num="5" den="4"/></Rhythm>'
    score = edited(
        tmp_path / "a.gp", ("<NoteValue>Quarter</NoteValue></Rhythm>", "<NoteValue>Quarter</NoteValue>" + nested)
    )
    assert [n.time for n in score.notes] == pytest.approx([i * 8 / 15 for i in range(4)])
    for count, times in {"": 2, "0": 1, "1": 1, "2": 2, "2.7": 2, "-1": 2, "99": 99, "128": 128, "129": 2}.items():
        repeated = edited(tmp_path / "b.gp", ("<Time>", f'<Repeat end="true" count="{count}"/><Time>'))
        assert len(repeated.notes) == 4 * times


def test_strokes_of_tremolos_and_trills_of_guitar_pro_5(tmp_path: Path) -> None:
    """60 a minute: sixteenths on one note, thirty-seconds between two, eighths on the third."""
    import guitarpro as gp

    def repeated(song: Any, beats: list[Any]) -> None:
        beats[0].notes[0].effect.tremoloPicking = gp.TremoloPickingEffect(gp.Duration(16))
        beats[1].notes[0].effect.trill = gp.TrillEffect(fret=4, duration=gp.Duration(32))
        beats[2].notes[0].effect.tremoloPicking = gp.TremoloPickingEffect(gp.Duration(8))

    score = tw.read_score(guitar_pro(tmp_path / "a.gp5", repeated))
    assert [n.time for n in score.notes] == [
        *(i / 4 for i in range(4)), *(1 + i / 8 for i in range(8)), 2, 2.5, 3
    ]  # fmt: skip
    assert [n.note for n in score.notes] == 4 * [40] + 4 * [47, 49] + [55, 55, 62]


def test_mutes_of_tracks_are_counted(tmp_path: Path) -> None:
    def muted(song: Any, beats: list[Any]) -> None:
        song.tracks[0].isMute = True

    assert tw.read_score(guitar_pro(tmp_path / "a.gp5", muted)).ignored == {"mute of a track": 1}
    mute = ("<Staves>", "<PlaybackState>Mute</PlaybackState><Staves>")
    assert edited(tmp_path / "a.gp", mute).ignored == {"mute of a track": 1}
