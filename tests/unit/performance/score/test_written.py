"""Scores that musicians write: MusicXML, Guitar Pro 3 to 5, 7; against the files' contents, note by note."""

from __future__ import annotations

import re
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from tablatures import enabled, gpif, guitar_pro, musicxml, mxl, note

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.performance.score.assignment import PlayableString
from tonewood.performance.score.note import Beats
from tonewood.performance.score.tablature import tablature
from tonewood.performance.score.unfolding import Measure, order
from tonewood.performance.score.written import WrittenMusic, WrittenNote, WrittenPart, performed

FOUR = [(0.0, 40.0, 0.0), (1.0, 47.0, 2.0), (2.0, 55.0, 5.0), (3.0, 62.0, 7.0)]


def places(score: tw.Score) -> list[tuple[float, float | None, float | None]]:
    return [(n.time, n.note, n.stop) for n in score.notes]


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


FOUR_XML = musicxml(
    note("E", 2, 4, "<string>6</string><fret>0</fret>") + note("B", 2, 4, "<string>5</string><fret>2</fret>")
    + note("G", 3, 4, "<string>4</string><fret>5</fret>") + note("D", 4, 4, "<string>3</string><fret>7</fret>")
)  # fmt: skip


@pytest.mark.parametrize("suffix", [".musicxml", ".mxl", ".gp3", ".gp4", ".gp5", ".gp"])
def test_every_format_has_its_strings_and_frets(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"study{suffix}"
    if suffix == ".musicxml":
        write(path, FOUR_XML)
    elif suffix == ".mxl":
        mxl(path, FOUR_XML)
    elif suffix == ".gp":
        gpif(path, [(0, 0, "", ""), (1, 2, "", ""), (2, 5, "", ""), (3, 7, "", "")])
    else:
        guitar_pro(path)
    score = tw.read_score(path)
    assert places(score)[:4] == FOUR
    assert score.metadata["title"] == "Study"
    assert all(n.duration == pytest.approx(1.0) and "tablature" in n.marks for n in score.notes)
    repeated = suffix in (".musicxml", ".mxl")
    assert places(score)[4:] == ([(t + 4.0, p, s) for t, p, s in FOUR] if repeated else [])
    # the contents of the file count, not its name
    other = path.rename(tmp_path / "study.mid")
    assert tw.read_score(other).notes == score.notes


def test_a_tablature_is_played_where_it_says(tmp_path: Path) -> None:
    renderer = tw.Renderer(tw.read_score(guitar_pro(tmp_path / "a.gp5")), "classical_guitar", fs=8000)
    strings = [(a.string, a.stop) for a in renderer.performance.notes]
    assert strings == [("E2", 0.0), ("A2", 2.0), ("D3", 5.0), ("G3", 7.0)]
    low = tw.load_instrument("classical_guitar").replace({"strings.A2.note": "G2"})
    other = tw.Renderer(tw.read_score(tmp_path / "a.gp5"), low, fs=8000)
    assert len(other.performance.notes) == 4
    assert other.performance.ignored == {"note of the tablature, fingered elsewhere": 1}


def test_techniques_are_played_where_there_are_some_and_counted_where_not(tmp_path: Path) -> None:
    def change(song: Any, beats: list[Any]) -> None:
        beats[0].notes[0].effect.palmMute = True
        beats[1].notes[0].effect.hammer = True
        beats[2].notes[0].string, beats[2].notes[0].value = 5, 4
        beats[3].notes[0].string, beats[3].notes[0].value = 5, 2
        beats[2].notes[0].effect.hammer = True

    score = tw.read_score(guitar_pro(tmp_path / "a.gp5", change))
    assert [set(n.marks) - {"tablature"} for n in score.notes] == [{"palm_mute"}, set(), {"hammer_on"}, {"pull_off"}]
    steel = tw.Renderer(score, "steel_strings", fs=8000).performance
    assert [a.note.technique for a in steel.notes] == ["palm", None, "hammer_on", "pull_off"]
    assert steel.ignored == {}
    nylon = tw.Renderer(score, "flamenco_guitar", fs=8000).performance
    assert [a.note.technique for a in nylon.notes] == [None] * 4
    assert nylon.ignored == {f"{name}, plucked as any note": 1 for name in ("palm mute", "hammer on", "pull off")}


def test_bends_go_to_their_string_and_back(tmp_path: Path) -> None:
    def change(song: Any, beats: list[Any]) -> None:
        import guitarpro as gp

        points = [gp.BendPoint(0, 0), gp.BendPoint(6, 4), gp.BendPoint(12, 4)]
        beats[1].notes[0].effect.bend = gp.BendEffect(gp.BendType.bend, 100, points)

    whole_tone = enabled("Bended") + "".join(
        f'<Property name="Bend{name}"><Float>{value}</Float></Property>'
        for name, value in (("OriginValue", 0), ("DestinationValue", 100), ("DestinationOffset", 50))
    )
    files = [
        guitar_pro(tmp_path / "a.gp5", change),
        gpif(tmp_path / "a.gp", [(0, 0, "", ""), (1, 2, whole_tone, "")]),
        write(tmp_path / "a.xml", musicxml(
            note("E", 2, 4, "<string>6</string><fret>0</fret>")
            + note("B", 2, 4, "<string>5</string><fret>2</fret><bend><bend-alter>2</bend-alter></bend>"))),
    ]  # fmt: skip
    for path in files:
        score = tw.read_score(path)
        bent = score.notes[1]
        own = [c for c in score.controls if 1.0 <= c.time <= 2.0]
        assert {c.channel for c in own} == {bent.channel}
        assert bent.channel != score.notes[0].channel
        assert max(c.value for c in own) == 200.0
        half = [c.value for c in own if c.time <= 1.25][-1]
        assert half == pytest.approx(100.0, abs=10.0)
        assert own[-1].value == 0.0


def test_signs_of_guitar_pro_7(tmp_path: Path) -> None:
    hopo = enabled("HopoOrigin")
    natural = enabled("Harmonic") + '<Property name="HarmonicType"><HType>Natural</HType></Property>'
    natural += '<Property name="HarmonicFret"><HFret>12</HFret></Property>'
    slide = '<Property name="Slide"><Flags>2</Flags></Property>'
    into = '<Property name="Slide"><Flags>16</Flags></Property>'
    notes = [
        (1, 2, hopo, ""), (1, 4, enabled("PalmMuted"), ""), (2, 12, natural, ""), (3, 2, slide, "<LetRing/>"),
        (3, 4, into, ""), (4, 1, enabled("Muted"), ""),
    ]  # fmt: skip
    score = tw.read_score(gpif(tmp_path / "a.gp", notes, rhythm=1))
    assert [n.time for n in score.notes] == pytest.approx([i / 3 for i in (0, 1, 2, 3, 5)])
    marks = [set(n.marks) - {"tablature"} for n in score.notes]
    assert marks == [set(), {"hammer_on", "palm_mute"}, set(), set(), {"dead_note"}]
    harmonic, slid = score.notes[2:4]
    assert (harmonic.note, harmonic.stop, harmonic.partial) == (62.0, 0.0, 2)  # the open string, touched at its middle
    # one stroke, whose finger slides two frets up
    assert (slid.note, slid.duration, slid.glides) == (57.0, 2 / 3 + 8.0, ((pytest.approx(1 / 3), 2.0),))
    assert score.notes[4].duration == pytest.approx(0.05)
    assert score.ignored == {}
    capo = tw.read_score(gpif(tmp_path / "b.gp", notes[:1], capo=3))
    assert (capo.notes[0].note, capo.notes[0].stop) == (45 + 3 + 2, 5.0)


def test_a_natural_harmonic_sounds_beyond_the_capo(tmp_path: Path) -> None:
    natural = enabled("Harmonic") + '<Property name="HarmonicType"><HType>Natural</HType></Property>'
    natural += '<Property name="HarmonicFret"><HFret>12</HFret></Property>'
    (one,) = tw.read_score(gpif(tmp_path / "a.gp", [(2, 12, natural, "")], capo=3)).notes
    assert (one.note, one.stop, one.partial) == (50.0 + 3 + 12, 3.0, 2)


@pytest.mark.parametrize(("dots", "beats"), [(0, 1.0), (1, 1.5), (2, 1.75), (3, 1.875)])
def test_every_dot_adds_half_of_what_the_last_one_did(tmp_path: Path, dots: int, beats: float) -> None:
    with zipfile.ZipFile(gpif(tmp_path / "a.gp", [(1, 0, "", ""), (2, 0, "", "")])) as archive:
        text = archive.read("Content/score.gpif").decode()
    dot = f'<NoteValue>Quarter</NoteValue><AugmentationDot count="{dots}"/>'
    with zipfile.ZipFile(tmp_path / "a.gp", "w") as archive:
        archive.writestr("Content/score.gpif", text.replace("<NoteValue>Quarter</NoteValue>", dot))
    assert [n.time for n in tw.read_score(tmp_path / "a.gp").notes] == [0.0, beats]


def test_octaves_of_transposing_instruments_and_dotted_tempos(tmp_path: Path) -> None:
    """A guitar's part sounds an octave below the written one; 40 dotted quarters a minute are 60 quarters."""
    text = musicxml(note("E", 4, 4) + note("A", 4, 4)).replace(
        "</divisions>", "</divisions><transpose><chromatic>2</chromatic><octave-change>-1</octave-change></transpose>"
    )
    text = text.replace(
        "<beat-unit>quarter</beat-unit><per-minute>60", "<beat-unit>quarter</beat-unit><beat-unit-dot/><per-minute>40"
    )
    notes = tw.read_score(write(tmp_path / "a.xml", text)).notes[:2]
    assert [(n.time, n.note) for n in notes] == [(0.0, 64.0 + 2 - 12), (1.0, 69.0 + 2 - 12)]


def test_a_measure_of_guitar_pro_is_as_long_as_its_time_signature(tmp_path: Path) -> None:
    """Two measures of 6/8 with a quarter in each: the second begins after three quarters."""
    import guitarpro as gp

    song = gp.Song(title="Study", tempo=60)
    header = song.measureHeaders[0]
    header.timeSignature.numerator, header.timeSignature.denominator.value = 6, 8
    track = song.tracks[0]
    second = gp.MeasureHeader(number=2, start=header.start + header.length)
    song.addMeasureHeader(second)
    track.measures.append(gp.Measure(track, second))
    second.timeSignature.numerator, second.timeSignature.denominator.value = 6, 8
    for measure in track.measures:
        beat = gp.Beat(measure.voices[0], status=gp.BeatStatus.normal)
        beat.notes.append(gp.Note(beat, value=2, string=5, type=gp.NoteType.normal))
        measure.voices[0].beats.append(beat)
    gp.write(song, str(tmp_path / "a.gp5"))
    assert [n.time for n in tw.read_score(tmp_path / "a.gp5").notes] == pytest.approx([0.0, 3.0])


def test_a_pitch_beyond_all_strings_is_no_note(tmp_path: Path) -> None:
    """Octave 10 ends at 140 with its a flat; no higher note is played."""
    text = musicxml(note("G", 10, 4) + note("A", 10, 4)).replace('<repeat direction="backward"/>', "")
    score = tw.read_score(write(tmp_path / "a.xml", text))
    assert [n.note for n in score.notes] == [139.0]


def test_signs_of_musicxml(tmp_path: Path) -> None:
    text = musicxml(
        note("E", 4, 4, more='<slur type="start"/><articulations><staccato/><accent/></articulations>')
        + note("F", 4, 4, '<hammer-on type="start"/>', more="<tied type='let-ring'/>")
        + note("G", 4, 4, '<hammer-on type="stop"/>', "<ornaments><tremolo>2</tremolo></ornaments>")
        + note("A", 4, 2, "<handbell/>", before="<tie type='start'/>")
        + note("A", 4, 2, before="<tie type='stop'/>")
    ).replace('<barline location="right"><repeat direction="backward"/></barline>', "")
    score = tw.read_score(write(tmp_path / "a.xml", text))
    assert [(n.time, n.note) for n in score.notes] == [(0.0, 64.0), (1.0, 65.0)] + [
        (2 + i / 4, 67.0) for i in range(4)
    ] + [(3.0, 69.0)]
    assert (score.notes[0].duration, score.notes[0].velocity_midi) == (0.5, 96)
    assert score.notes[1].duration == 8.0
    assert [n.marks for n in score.notes[2:4]] == [("hammer_on",), ()]
    assert score.notes[-1].duration == 1.0
    assert score.ignored == {"handbell": 1}


def test_repeats_endings_and_jumps() -> None:
    def names(*measures: Measure) -> str:
        return "".join("abcdefgh"[i] for i in order(measures))

    plain = Measure()
    one, two = frozenset({1}), frozenset({2})
    assert names(plain, Measure(closes=2), plain) == "ababc"
    assert names(plain, Measure(opens=True), Measure(closes=3), plain) == "abcbcbcd"
    assert names(plain, Measure(closes=2, endings=one), Measure(endings=two), plain) == "abacd"
    assert names(Measure(closes=2), Measure(), Measure(closes=2)) == "aabcbc"
    assert names(plain, Measure(signs={"fine"}), Measure(signs={"da_capo"})) == "abcab"
    coda = [
        plain,
        Measure(signs={"segno"}),
        Measure(signs={"to_coda"}),
        Measure(signs={"dal_segno"}),
        Measure(signs={"coda"}),
    ]
    assert names(*coda) == "abcdbce"
    # a jump whose mark is not there, or on the wrong side of it, leads nowhere
    assert names(plain, Measure(signs={"to_coda"}), Measure(signs={"dal_segno"}), plain) == "abcd"
    assert names(Measure(signs={"coda"}), Measure(signs={"to_coda"}), Measure(signs={"da_capo"})) == "abcabc"
    assert names(Measure(signs={"dal_segno"}), Measure(signs={"segno"})) == "ab"
    first_and_second = frozenset({1, 2})
    three = [
        plain,
        Measure(closes=3, endings=first_and_second),
        Measure(endings=frozenset({3})),
        plain,
        Measure(closes=2),
    ]
    assert names(*three) == "ababacdede"
    with pytest.raises(ScoreError, match="more than 20000 measures"):
        order([Measure(closes=32) for _ in range(2000)])


SOUND = "<attributes><divisions>1</divisions></attributes>"
SOUND += "<direction><sound {}/></direction><note><pitch><step>A</step><octave>3</octave></pitch>"
SOUND += "<duration>1</duration></note>"


@pytest.mark.parametrize(
    ("jumps", "n_notes", "ignored"),
    [
        (['segno="a"', 'dalsegno="a"'], 4, {}),
        (['fine="yes"', 'dalsegno="a"'], 2, {"dal segno without a segno": 1}),
        (['tocoda="a"', 'dacapo="yes"', 'coda="a"'], 4, {}),
        (['tocoda="a"', 'dacapo="yes"', 'tocoda="b"'], 5, {"to coda without a coda": 2}),
        (['dacapo="no"', 'dacapo="no"'], 2, {}),
    ],
)
def test_jumps_that_lead_nowhere_are_counted(
    tmp_path: Path, jumps: list[str], n_notes: int, ignored: dict[str, int]
) -> None:
    measures = "".join(f"<measure>{SOUND.format(jump)}</measure>" for jump in jumps)
    score = tw.read_score(write(tmp_path / "a.xml", f'<score-partwise><part id="P">{measures}</part></score-partwise>'))
    assert (len(score.notes), score.ignored) == (n_notes, ignored)


@pytest.mark.parametrize(
    ("name", "n_notes", "ignored"),
    [
        ("Da Capo", 8, {}),
        ("Da Capo al Fine", 8, {}),
        ("Da Segno al Coda", 4, {"dal segno without a segno": 1}),
        ("Da Double Coda", 4, {"to double coda without a double coda": 1}),
    ],
)
def test_directions_of_guitar_pro_are_followed_or_counted(
    tmp_path: Path, name: str, n_notes: int, ignored: dict[str, int]
) -> None:
    import guitarpro

    def change(song: guitarpro.Song, _: object) -> None:
        song.measureHeaders[0].fromDirection = guitarpro.DirectionSign(name)

    five = tw.read_score(guitar_pro(tmp_path / "a.gp5", change))
    with zipfile.ZipFile(gpif(tmp_path / "b.gp", [(i, 0, "", "") for i in range(4)])) as archive:
        text = archive.read("Content/score.gpif").decode()
    jump = f"<Directions><Jump>{name.title().replace(' ', '')}</Jump></Directions></MasterBar>"
    with zipfile.ZipFile(tmp_path / "b.gp", "w") as archive:
        archive.writestr("Content/score.gpif", text.replace("</MasterBar>", jump))
    for score in (five, tw.read_score(tmp_path / "b.gp")):
        assert (len(score.notes), score.ignored) == (n_notes, ignored)


def test_tempo_changes_and_grace_notes() -> None:
    quarter = Fraction(1)
    measure = Measure(tempos=[(Fraction(0), 60.0), (Fraction(2), 120.0)])
    notes = [
        WrittenNote(Fraction(0), quarter, 60.0),
        WrittenNote(Fraction(3), Fraction(0), 62.0),
        WrittenNote(Fraction(3), quarter, 64.0),
    ]
    score = performed(WrittenMusic(Path("t"), [measure, Measure()], [WrittenPart("p", [notes, notes[:1]])]))
    # 2 s for the first two quarters, 0.5 s for each after them; the grace note takes an eighth of a quarter
    assert [n.time for n in score.notes] == pytest.approx([0.0, 2.5, 2.5625, 3.0])
    assert score.notes[1].duration == pytest.approx(0.0625)


def test_titles_and_names_of_parts_are_one_line(tmp_path: Path) -> None:
    def named(song: Any, beats: list[Any]) -> None:
        song.title, song.tracks[0].name = "A\x1b[31m\nB", "low\x1b[2J"

    path = guitar_pro(tmp_path / "a.gp4", named)
    score = tw.read_score(path)
    assert (score.metadata["title"], score.parts[0].name) == ("A [31m B", "low [2J")
    title = tablature([], [PlayableString.fretted("E4", 64)], Beats(), title="A\x1b[31m\nB").title
    assert title == "A [31m B"
    many = WrittenMusic(Path("t"), [Measure()], [WrittenPart("x" * 99) for _ in range(22)])
    with pytest.raises(ScoreError, match=r", 20 x{40} and 2 more$"):
        performed(many, [23])


def test_excerpts_tempo_tracks_and_transposition(tmp_path: Path) -> None:
    path = guitar_pro(tmp_path / "a.gp4")
    part = tw.read_score(path, start=1.0, stop=2.5, tempo=2.0, transpose=2)
    assert places(part) == [(0.0, 49.0, 4.0), (0.5, 57.0, 7.0)]
    assert [n.duration for n in part.notes] == pytest.approx([0.5, 0.25])
    assert tw.read_score(path, tracks=[1]).notes == tw.read_score(path).notes
    for settings, line in (
        ({"tracks": [2]}, "there is no part 2; there are 1 Track 1"),
        ({"tempo": 0.0}, "0.05 to 20 are allowed"),
        ({"tempo": 20.5}, "0.05 to 20 are allowed"),
        ({"transpose": 99}, "-48 to 48"),
        ({"start": 3.0, "stop": 2.0}, "0 <= start < stop"),
    ):
        with pytest.raises(ScoreError, match=f"^{re.escape(str(path))}: .*{line}"):
            tw.read_score(path, **settings)  # type: ignore[arg-type]


def test_channels_of_midi_are_its_tracks(tmp_path: Path) -> None:
    notes = [tw.Note(0.5 * i, 0.4, note=60 + i, channel=i % 2, velocity_midi=80) for i in range(4)]
    tw.write_midi(tw.Score(notes), tmp_path / "a.mid")
    assert [n.note for n in tw.read_score(tmp_path / "a.mid", tracks=[2]).notes] == [61.0, 63.0]
    place = re.escape(str(tmp_path / "a.mid"))
    with pytest.raises(ScoreError, match=f"^{place}: there is no channel 5; there are 1, 2"):
        tw.read_score(tmp_path / "a.mid", tracks=[5])
    for excerpt, line in ((tw.read_score(tmp_path / "a.mid", start=9.0), "has no notes"), (None, "none of 4 notes")):
        score = excerpt or tw.read_score(tmp_path / "a.mid", transpose=48)
        with pytest.raises(ScoreError, match=f"^{place}: {line}"):
            tw.Renderer(score, "monochord", fs=8000)


def test_files_that_cannot_be_read_are_one_line(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    good = guitar_pro(tmp_path / "good.gp5").read_bytes()
    cases = {
        "six.gpx": (b"BCFZ1234", "damaged Guitar Pro 6 file"),
        "system.gpx": (b"BCFS" + bytes(0x3000), "has no score.gpif"),
        "tune.abc": (b"X:1\nK:C\nCDE", "ABC is not read; converted it is: by abc2midi"),
        "cut.gp5": (good[: len(good) // 2], "damaged Guitar Pro file"),
        "cut.mxl": (b"PK\x03\x04 and so on", "damaged archive"),
        "empty.mxl": ((tmp_path / "empty.zip").read_bytes(), "has no META-INF/container.xml"),
        "page.xml": (b"<html><body/></html>", "is no score but <html>"),
        "cut.xml": (FOUR_XML[:800].encode(), "damaged XML"),
        "bomb.xml": (
            b'<!DOCTYPE a [<!ENTITY b "bb">]><score-partwise>&b;</score-partwise>',
            "declares or uses entities",
        ),
    }
    for name, (data, line) in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ScoreError, match=line) as caught:
            tw.read_score(tmp_path / name)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(3))
def test_damaged_files_are_read_or_refused(tmp_path: Path, seed: int) -> None:
    """Bytes changed at random: a score, or a ScoreError; never anything else."""
    import numpy as np

    rng = np.random.default_rng(seed)
    files = [guitar_pro(tmp_path / "a.gp5"), guitar_pro(tmp_path / "a.gp3"), write(tmp_path / "a.xml", FOUR_XML)]
    for path in files:
        good = path.read_bytes()
        for _ in range(40):
            data = bytearray(good)
            for place in rng.integers(40, len(data), 4):
                data[place] = rng.integers(256)
            path.write_bytes(data)
            lines = []
            try:
                tw.read_score(path)
            except ScoreError as error:
                lines = str(error).splitlines()
            assert len(lines) < 2


@pytest.mark.parametrize("number", ["nan", "inf", "1e308", "-1e9", "9" * 5000, "", "six"])
def test_numbers_that_are_none_keep_the_other_notes(tmp_path: Path, number: str) -> None:
    """One number of a MusicXML file after another replaced: notes, or one line of a ScoreError."""
    text = FOUR_XML.replace("</direction-type>", '</direction-type><sound tempo="90" dynamics="80"/>', 1)
    damaged = [text[: m.start()] + number + text[m.end() :] for m in re.finditer(r"(?<=[>\"])\d+(?=[<\"])", text)]
    assert len(damaged) > 30
    lines, n_read = [], 0
    for one in damaged:
        try:
            n_read += len(tw.read_score(write(tmp_path / "a.xml", one)).notes) >= 6
        except ScoreError as error:
            lines += str(error).splitlines()
    assert n_read + len(lines) <= len(damaged)
    assert n_read > 0.9 * len(damaged)


MARK = "<direction-type><metronome><beat-unit>{}</beat-unit><per-minute>{}</per-minute></metronome></direction-type>"
RELATED = MARK.format("quarter", "").replace("<per-minute></per-minute>", "<beat-unit>half</beat-unit>")
TREMOLO = "</duration><notations><ornaments><tremolo>9</tremolo></ornaments></notations>"
PROGRAM = "<part-name/><midi-instrument><midi-program>{}</midi-program></midi-instrument>"


@pytest.mark.parametrize(
    ("change", "counted"),
    [
        (("<octave>3<", "<octave>x<"), "octave that cannot be read"),
        (("<octave>3<", "<alter>nan</alter><octave>3<"), "alter that cannot be read"),
        (("<octave>3<", "<octave>0_3<"), "octave that cannot be read"),
        (("<duration>1<", "<duration>\u0661<"), "duration that cannot be read"),
        (("<duration>1<", "<duration><"), "duration that cannot be read"),
        (("<duration>1<", "<duration>-1<"), "duration below 0"),
        (("<divisions>1<", "<divisions>1e300<"), "divisions that cannot be read"),
        (("<divisions>1<", "<divisions>-1<"), "divisions outside 1/16384 to 16384"),
        (('tempo="90"', 'tempo="0"'), "tempo outside 4 to 2000"),
        (('times="2"', 'times="x"'), "repeat times outside 1 to 32"),
        (('times="2"', f'times="{"9" * 5000}"'), "repeat times outside 1 to 32"),
        (('number="1"', f'number="{"9" * 5000}"'), "number of an ending that cannot be read"),
        (('number="1"', 'number="-1"'), "number of an ending that cannot be read"),
        (("<divisions>1<", "<divisions>0<"), "divisions outside 1/16384 to 16384"),
        (("<attributes><divisions>1</divisions></attributes>", ""), "part without divisions"),
        (("<duration>1</duration>", ""), "note without a duration"),
        (("<duration>1<", "<duration>0<"), "note whose duration is 0"),
        (("<duration>1<", "<duration>1e-9<"), "note whose duration is 0"),
        (("<octave>3</octave>", ""), "pitch without an octave"),
        (("<octave>3<", "<octave>3.5<"), "octave that is not whole"),
        (
            ("<note>", "<note><pitch><step>H</step></pitch><duration>1</duration></note><note>"),
            "note whose pitch cannot be read",
        ),
        (
            ("<barline><e", "<backup><duration>1</duration></backup><barline><e"),
            "backup beyond the beginning of its measure",
        ),
        (("<barline><e", "<backup/><barline><e"), "backup without a duration"),
        (('tempo="90"', 'dynamics="-5"'), "dynamics beyond velocities 1 to 127"),
        (('tempo="90"', 'dynamics="1e9"'), "dynamics beyond velocities 1 to 127"),
        (("<divisions>", "<key><fifths>9</fifths></key><divisions>"), "fifths outside -7 to 7"),
        (("</duration>", TREMOLO), "tremolo outside 0 to 5 strokes"),
        (('<sound tempo="90"/>', MARK.format("quarter", "0")), "tempo outside 4 to 2000"),
        (('<sound tempo="90"/>', MARK.format("quarter", "-5")), "tempo outside 4 to 2000"),
        (('<sound tempo="90"/>', MARK.format("quarter", "nan")), "per-minute that cannot be read"),
        (('<sound tempo="90"/>', MARK.format("quavers", "90")), "metronome whose beat-unit is not known"),
        (('<sound tempo="90"/>', MARK.format("breve", "c. 60")), None),
        (('<sound tempo="90"/>', "<direction-type><words>h = 0</words></direction-type>"), "tempo outside 4 to 2000"),
        (
            (
                '<sound tempo="90"/>',
                MARK.format("quarter", "").replace("<per-minute></per-minute>", "<beat-unit>half</beat-unit>"),
            ),
            "metronome that relates two values",
        ),
        (('tempo="90"/>', 'tempo="90"><offset>x</offset></sound>'), "offset that cannot be read"),
        (("<part-name/>", PROGRAM.format("129")), "midi-program outside 1 to 128"),
        (("<part-name/>", PROGRAM.format("x")), "midi-program outside 1 to 128"),
    ],
    ids=lambda value: value[1][:24] if isinstance(value, tuple) else "",
)
def test_numbers_that_are_none_are_counted(tmp_path: Path, change: tuple[str, str], counted: str | None) -> None:
    text = """<score-partwise><part-list><score-part id="P"><part-name/></score-part></part-list><part id="P"><measure>
        <attributes><divisions>1</divisions></attributes><direction><sound tempo="90"/></direction>
        <barline><ending number="1" type="start"/></barline>
        <note><pitch><step>A</step><octave>3</octave></pitch><duration>1</duration></note>
        <barline><repeat direction="backward" times="2"/></barline></measure></part></score-partwise>"""
    assert tw.read_score(write(tmp_path / "a.xml", text)).ignored == {}
    assert change[0] in text
    found = tw.read_score(write(tmp_path / "b.xml", text.replace(*change)))
    assert len(found.notes) >= 1
    assert found.ignored == ({} if counted is None else {counted: 1})


def test_a_tie_does_not_end_the_other_voice(tmp_path: Path) -> None:
    """A quarter tied to a quarter beside a whole note of the same pitch, which lasts."""
    a, tied = note("A", 3, 1), note("A", 3, 1).replace("</note>", '<tie type="stop"/></note>')
    back = "<backup><duration>2</duration></backup>"
    text = SOUND[: SOUND.index("<direction>")] + a + tied + back + note("A", 3, 4)
    path = write(tmp_path / "a.xml", f"<score-partwise><part><measure>{text}</measure></part></score-partwise>")
    assert max(n.duration for n in tw.read_score(path).notes) == pytest.approx(2.0)


def test_a_tie_that_is_only_drawn_holds_the_note(tmp_path: Path) -> None:
    """MusicXML's <tie> says what sounds, <tied> what is drawn; some programs write the drawn tie alone."""
    lengths = []
    for i, more in enumerate(('<tied type="stop"/>', "")):
        text = musicxml(note("A", 3, 2, more='<tied type="start"/>') + note("A", 3, 2, more=more))
        lengths.append([n.duration for n in tw.read_score(write(tmp_path / f"{i}.musicxml", text)).notes])
    held, struck = lengths[0][0], lengths[1][0]
    assert lengths == [[held] * 2, [struck] * 4]  # the measure is repeated
    assert held == pytest.approx(2 * struck, rel=0.05)


def test_staves_are_transposed_and_notes_have_their_dynamics(tmp_path: Path) -> None:
    moves = "".join(
        f'<transpose number="{i}"><chromatic>0</chromatic><octave-change>{o}</octave-change></transpose>'
        for i, o in ((1, -1), (2, 1))
    )
    notes = "".join(
        note("A", 3, 1)
        .replace("</note>", f"<staff>{i}</staff></note>")
        .replace("<note>", f'<note dynamics="{10 * i}">')
        for i in (1, 2)
    )
    text = f"<attributes><divisions>1</divisions>{moves}</attributes>{notes}"
    path = write(tmp_path / "a.xml", f"<score-partwise><part><measure>{text}</measure></part></score-partwise>")
    assert [(n.note, n.velocity_midi) for n in tw.read_score(path).notes] == [(45.0, 9), (69.0, 18)]


def test_a_mark_of_two_dots(tmp_path: Path) -> None:
    mark = MARK.format("quarter", "60").replace("<per", "<beat-unit-dot/><beat-unit-dot/><per")
    text = SOUND.replace("<sound {}/>", mark)
    path = write(tmp_path / "a.xml", f"<score-partwise><part><measure>{text}</measure></part></score-partwise>")
    assert tw.read_score(path).notes[0].duration == pytest.approx(1 / 1.75)


def test_divisions_may_be_no_whole_number(tmp_path: Path) -> None:
    """The standard has decimals: two and a half durations to a quarter note, half of one."""
    for divisions, quarters in ((2.5, 0.4), (0.5, 2.0)):
        text = SOUND.replace("<divisions>1", f"<divisions>{divisions}").format('tempo="60"')
        path = write(tmp_path / "a.xml", f"<score-partwise><part><measure>{text}</measure></part></score-partwise>")
        score = tw.read_score(path)
        assert (score.notes[0].duration, score.ignored) == (pytest.approx(quarters), {})


def test_notes_that_no_pass_reaches_are_counted(tmp_path: Path) -> None:
    ending = '<barline><ending number="9" type="start"/></barline>'
    measures = f"<measure>{SOUND.format('')}</measure><measure>{ending}{2 * SOUND.format('')}</measure>"
    path = write(tmp_path / "a.xml", f"<score-partwise><part>{measures}</part></score-partwise>")
    score = tw.read_score(path)
    assert (len(score.notes), score.ignored) == (1, {"note in a measure that no pass reaches": 2})


def test_a_damaged_archive_is_one_line(tmp_path: Path) -> None:
    good = mxl(tmp_path / "good.mxl", FOUR_XML).read_bytes()
    for at in range(0, len(good), 7):
        (tmp_path / "bad.mxl").write_bytes(good[:at] + bytes([good[at] ^ 0x7D]) + good[at + 1 :])
        lines = []
        try:
            tw.read_score(tmp_path / "bad.mxl")
        except ScoreError as error:
            lines = str(error).splitlines()
        assert len(lines) < 2


def test_a_capo_raises_the_open_strings() -> None:
    guitar = tw.load_instrument("classical_guitar")
    score = tw.Score([tw.Note(0.1, 0.5, note=42), tw.Note(0.1, 0.5, string="A2", stop=5)])
    renderer = tw.Renderer(score, guitar, fs=8000, capo=2)
    assert sorted((a.string, a.stop) for a in renderer.performance.notes) == [("A2", 5.0), ("E2", 2.0)]
    renderer.engine.advance(40)
    assert {f.stop for name, f in renderer.engine.frettings.items() if name != "A2"} == {2.0}
    lower = tw.Renderer(tw.Score([tw.Note(0.0, note=40), tw.Note(0.0, note=64)]), guitar, fs=8000, capo=2)
    assert [d.reason for d in lower.dropped] == ["no string plays E2 (the strings reach from F#2 to B5)"]
    with pytest.raises(ScoreError, match="capo: is 19; 0 to 18 are allowed"):
        tw.Renderer(score, guitar, fs=8000, capo=19)


@pytest.mark.parametrize("suffix", [".musicxml", ".gp5", ".gp"])
def test_titles_and_composers_are_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".gp5":
        guitar_pro(path, lambda song, _: setattr(song, "music", "F. Sor"))
    elif suffix == ".gp":
        with zipfile.ZipFile(gpif(path, [(0, 0, "", "")])) as archive:
            text = archive.read("Content/score.gpif").decode().replace("</Title>", "</Title><Music>F. Sor</Music>")
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("Content/score.gpif", text)
    else:
        by = '<identification><creator type="lyricist">N.</creator><creator type="composer">F. Sor</creator>'
        path.write_text(musicxml(note("E", 2, 4)).replace("</work>", f"</work>{by}</identification>"))
    assert tw.read_score(path).metadata == {"title": "Study", "composer": "F. Sor"}
