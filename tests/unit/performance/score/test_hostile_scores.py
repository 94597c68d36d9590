"""Scores made to be slow, large or absurd: they are read within limits, or one line says which limit they pass."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tracemalloc
import zipfile
from fractions import Fraction
from pathlib import Path
from types import FrameType

import pytest
from mutations import FORMATS, NUMBERS
from smf_bytes import event, smf
from tablatures import gpif, guitar_pro, musicxml, mxl, note

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.performance.score import bend_curves, guitar_pro_file, limits, score_clock, written, xml_files
from tonewood.performance.score import gpif as gpif_reader
from tonewood.performance.score.limits import number, whole
from tonewood.performance.score.musicxml import read_musicxml
from tonewood.performance.score.unfolding import Measure, order

MB = 2**20
NOTE = note("C", 4, 4)


def archived(path: Path, text: str, name: str = "Content/score.gpif", method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("META-INF/container.xml", f'<c><rootfile full-path="{name}"/></c>')
        archive.writestr(name, text)
    return path


def gpif_text(tmp_path: Path) -> str:
    path = gpif(tmp_path / "plain.gp", [(0, 0, "", "")])
    with zipfile.ZipFile(path) as archive:
        return archive.read("Content/score.gpif").decode()


def refused(path: Path, line: str) -> None:
    with pytest.raises(ScoreError, match=line) as caught:
        tw.read_score(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def parts(measures: str, n_parts: int = 1) -> str:
    part = f'<part id="P1">{measures}</part>'
    return f"<score-partwise><part-list/>{part * n_parts}</score-partwise>"


@pytest.mark.parametrize("times", [{"Notes": 1000, "Beats": 1000}, {"Notes": 60, "Beats": 60, "Voices": 60}])
def test_lists_that_multiply_end_while_they_are_read(
    tmp_path: Path, times: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []
    replace = gpif_reader.replace
    monkeypatch.setattr(gpif_reader, "replace", lambda *a, **k: built.append(a) or replace(*a, **k))
    monkeypatch.setattr(written, "MAX_NOTES", 5000)
    text = gpif_text(tmp_path)
    for kind, n in times.items():
        text = text.replace(f"<{kind}>0", f"<{kind}>" + "0 " * n)
    path = archived(tmp_path / "many.gp", text)
    assert path.stat().st_size < 1500
    refused(path, "more than 5000 notes")
    assert len(built) <= 2 * 5000


def test_lists_without_notes_are_counted_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpif_reader, "_MOST_REFERENCES", 5000)
    text = gpif_text(tmp_path).replace("<Voices>0", "<Voices>" + "0 " * 1000).replace("<Notes>0<", "<Notes><")
    path = archived(tmp_path / "rests.gp", text.replace("<Beats>0", "<Beats>" + "0 " * 1000))
    refused(path, "more than 5000 bars, voices, beats and notes in lists")


def test_names_of_signs_are_told_up_to_a_number_and_a_length(tmp_path: Path) -> None:
    signs = "".join(f"<s{i}{'x' * 400}/>" if i % 2 else f"<s{i}/>" for i in range(3000))
    path = tmp_path / "signs.musicxml"
    path.write_text(
        parts(f"<measure><attributes><divisions>4</divisions></attributes>{note('C', 4, 4, more=signs)}</measure>"),
        encoding="utf-8",
    )
    ignored = tw.read_score(path).ignored
    assert sum(ignored.values()) == 3000
    assert len(ignored) <= 101
    assert max(map(len, ignored)) <= 40


def test_wide_characters_count_by_their_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_files, "_MOST_KEPT", 4000)  # of some 100 bytes each
    text = "<GPIF>" + 1900 * ("<a/>" + 62 * "x" + "\U0001f600") + "</GPIF>"
    refused(archived(tmp_path / "wide.gp", text), "more than 4000 elements, attributes and texts")


@pytest.mark.parametrize("place", ["<NoteValue>", "<Dynamic>", "<Notes>", "<Fret>", "<Voices>"])
def test_long_texts_that_are_listed_often_end_while_they_are_read(tmp_path: Path, place: str) -> None:
    n_bars, n_beats = (5000, 0) if place == "<Voices>" else (1, 5000)
    text = f"""<GPIF><MasterBars>{"<MasterBar><Bars>0</Bars></MasterBar>" * n_bars}</MasterBars>
    <Tracks><Track><Properties><Property name="Tuning"><Pitches>40 45</Pitches></Property></Properties></Track></Tracks>
    <Bars><Bar id="0"><Voices>0</Voices></Bar></Bars><Voices><Voice id="0">
    <Beats>{"0 " * n_beats}</Beats></Voice></Voices>
    <Beats><Beat id="0"><Rhythm ref="0"/><Dynamic>F</Dynamic><Notes>0</Notes></Beat></Beats>
    <Notes><Note id="0"><Properties><Property name="String"><String>0</String></Property>
    <Property name="Fret"><Fret>3</Fret></Property></Properties></Note></Notes>
    <Rhythms><Rhythm id="0"><NoteValue>64th</NoteValue></Rhythm></Rhythms></GPIF>"""
    filler = "t" if place == "<NoteValue>" else " "
    path = archived(tmp_path / "long.gp", text.replace(place, place + filler * 500_000))
    refused(path, "more than 20000000 elements and texts read again and again")


def test_an_archive_that_expands_is_left_while_it_expands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = archived(tmp_path / "elements.mxl", parts("<measure>" + "<a/>" * 1_000_000), "s.xml")
    assert path.stat().st_size < 10_000
    monkeypatch.setattr(xml_files, "MAX_ELEMENTS", 5000)
    refused(path, "more than 5000 elements")
    refused(
        archived(tmp_path / "wide.gp", "<GPIF>" + " " * 9 * MB), "of more than 2097152 characters|more than .* bytes"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("inside", "line"),
    [
        ("<a>" * 200, "elements more than 100 deep"),
        ("<a " + " ".join(f'a{i}=""' for i in range(400_000)) + "/>", "a tag or comment of more than"),
        ("<!--" + "x" * 3 * MB + "-->", "a tag or comment of more than"),
        ("<a>" + "x\n" * 2 * MB + "</a>", "a text of more than"),
        ('<a xmlns="' + "u" * 9000 + '">' + "<b/>" * 9, "a name of more than 500 characters"),
        ('<a b="c"/>' * 500_000, "elements, attributes and texts"),
    ],
)
def test_elements_attributes_and_texts_are_counted_as_they_come(tmp_path: Path, inside: str, line: str) -> None:
    path = tmp_path / "score.musicxml"
    path.write_text(parts(f"<measure>{inside}</measure>"))
    refused(path, line)


def test_a_long_score_needs_the_memory_of_a_measure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xml_files, "_MOST_KEPT", 200)
    measure = "<measure>" + "<print/>" * 50 + NOTE + "</measure>"
    for kind in ("part", "measure"):
        path = tmp_path / "long.musicxml"
        whole_text = parts(measure * 400)
        if kind == "measure":
            whole_text = (
                "<score-timewise>"
                + measure.replace("<measure>", '<measure><part id="P1">').replace("</measure>", "</part></measure>")
                * 400
                + "</score-timewise>"
            )
        path.write_text(whole_text)
        if kind == "part":
            assert len(tw.read_score(path).notes) == 400
        else:
            refused(path, "more than 200 elements, attributes and texts")  # of empty measures


def test_archives_of_many_files_and_unusual_compression(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "many.mxl", "w") as archive:
        for i in range(10_001):
            archive.writestr(str(i), "")
    refused(tmp_path / "many.mxl", "more than 10000 files")
    refused(archived(tmp_path / "odd.mxl", parts(""), "s.xml", zipfile.ZIP_LZMA), "compressed in an unusual way")
    refused(mxl(tmp_path / "within.mxl", "PK"), "not XML")
    away = io.BytesIO()
    with zipfile.ZipFile(away, "w") as archive:
        archive.writestr("META-INF/container.xml", '<c><rootfile full-path="../../etc/passwd"/></c>')
    (tmp_path / "away.mxl").write_bytes(away.getvalue())
    refused(tmp_path / "away.mxl", "has no ../../etc/passwd")


DOCTYPES = {
    "laughs": '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    "file": '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>',
    "parameter": "<!DOCTYPE a [<!ENTITY % a \"<!ENTITY b 'c'>\">%a;]>",
    "attributes": '<!DOCTYPE a [<!ATTLIST note b CDATA "c">]>',
    "behind a comment": f'<!--{"x" * 100_000}--><!DOCTYPE a [<!ENTITY b "c">]>',
    "not there": '<!DOCTYPE a SYSTEM "http://127.0.0.1:9/a.dtd">',
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "iso-8859-15", "utf-7"])
@pytest.mark.parametrize("name", DOCTYPES)
def test_no_entities_in_any_encoding(tmp_path: Path, name: str, encoding: str) -> None:
    declared = {"utf-8-sig": "utf-8"}.get(encoding, encoding)
    text = f'<?xml version="1.0" encoding="{declared}"?>{DOCTYPES[name]}'
    text += parts(f"<measure><words>&b;</words>{NOTE}</measure>")
    path = tmp_path / "score.musicxml"
    path.write_bytes(text.encode(encoding))
    refused(path, "entities, or has a DTD|multi-byte encodings|does not begin with '<'|not well-formed")
    with zipfile.ZipFile(tmp_path / "score.mxl", "w") as archive:
        archive.writestr("META-INF/container.xml", '<c><rootfile full-path="s.xml"/></c>')
        archive.writestr("s.xml", text.encode(encoding))
    refused(tmp_path / "score.mxl", "entities, or has a DTD|multi-byte encodings|not XML|damaged XML")


def test_the_public_name_of_a_dtd_is_read_over(tmp_path: Path) -> None:
    path = tmp_path / "score.musicxml"
    text = musicxml(NOTE)
    assert "<!DOCTYPE" in text
    path.write_bytes(text.replace('<?xml version="1.0"?>', '<?xml version="1.0" encoding="utf-16"?>').encode("utf-16"))
    assert len(tw.read_score(path).notes) == 2


PLACES = {
    "time": ("4/4", "{}/4"), "beat": ("4/4", "4/{}"), "tempo": ("60 2", "{} 2"), "bar": ("<Bar>0<", "<Bar>{}<"),
    "position": ("<Position>0", "<Position>{}"), "tuning": ("40 45", "{} 45"), "capo": ("<Fret>2<", "<Fret>{}<"),
    "value": ("Quarter", "{}"), "fret": ("<Fret>3<", "<Fret>{}<"), "string": ("<String>1<", "<String>{}<"),
    "dots": ("<NoteValue>Q", '<AugmentationDot count="{}"/><NoteValue>Q'),
    "notes of a tuplet": ("<NoteValue>Q", '<PrimaryTuplet num="{}" den="2"/><NoteValue>Q'),
    "time of a tuplet": ("<NoteValue>Q", '<PrimaryTuplet num="3" den="{}"/><NoteValue>Q'),
    "endings": ("<Time>", "<AlternateEndings>{}</AlternateEndings><Time>"),
    "repeats": ("<Time>", '<Repeat start="true" end="true" count="{}"/><Time>'),
    "accent": ('<Note id="0">', '<Note id="0"><Accent>{}</Accent>'),
    "trill": ('<Note id="0">', '<Note id="0"><Trill>{}</Trill>'),
}  # fmt: skip
for _name in ("OriginValue", "DestinationValue", "DestinationOffset", "MiddleValue", "MiddleOffset1"):
    _bend = '<Property name="Bended"><Enable/></Property>'
    _bend += f'<Property name="Bend{_name}"><Float>{{}}</Float></Property></Properties></Note>'
    PLACES[_name] = ("</Properties></Note>", _bend)


@pytest.mark.parametrize("place", PLACES)
def test_no_number_of_guitar_pro_7_is_a_traceback(tmp_path: Path, place: str) -> None:
    path = gpif(tmp_path / "plain.gp", [(1, 3, "", ""), (2, 5, "", "")], capo=2)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("Content/score.gpif").decode()
    before, after = PLACES[place]
    assert before in text
    for said in NUMBERS:
        archived(path, text.replace(before, after.format(said), 1))
        score = read_or_refused(path)
        assert score is None or all(0.0 <= n.time < limits.MAX_TIME for n in score.notes)


def read_or_refused(path: Path) -> tw.Score | None:
    try:
        return tw.read_score(path)
    except ScoreError as error:
        return None if str(path) in str(error) else pytest.fail(f"the file is not named: {error}")


@pytest.mark.parametrize(("place", "said"), [("value", "0th"), ("tuning", "--5"), ("time", "0"), ("beat", "٣")])
def test_what_cannot_be_read_is_counted_and_the_rest_played(tmp_path: Path, place: str, said: str) -> None:
    path = gpif(tmp_path / "plain.gp", [(1, 3, "", ""), (2, 5, "", "")], capo=2)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("Content/score.gpif").decode()
    score = tw.read_score(archived(path, text.replace(PLACES[place][0], PLACES[place][1].format(said), 1)))
    assert len(score.notes) == 2
    assert any("cannot be read" in what for what in score.ignored)


def test_a_number_of_a_file_is_decimal_and_within_bounds() -> None:
    assert [number(x, -5, 5) for x in ("1", " 2.5 ", "-5", "5e0", 3)] == [1.0, 2.5, -5.0, 5.0, 3.0]
    wrong = ["", "6", "-5.1", "nan", "inf", "²", "٣", "1_0", "0x1", "1" * 5000, "0" * 50, None, "1/2", 10**400]
    assert [number(x, -5, 5) for x in wrong] == [None] * len(wrong)
    assert [whole(x, 0, 9) for x in ("3", "3.9", "9", "10", "-1")] == [3, 3, 9, None, None]


def test_repeats_tempos_and_parts_that_multiply(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("MAX_NOTES", "MOST_TEMPOS", "_MOST_CELLS"):
        monkeypatch.setattr(written, name, 2000)
    monkeypatch.setattr(score_clock, "MOST_TEMPOS", 2000)
    again = '<barline location="right"><repeat direction="backward" times="32"/></barline></measure>'
    short = NOTE.replace(">4</dur", ">0.01</dur")
    tempos = "".join(f'<sound tempo="{90 + i}"/><forward><duration>1</duration></forward>' for i in range(100))
    cases = {
        "notes": ("<measure>" + short * 100 + again, 1, "more than 2000 notes, repeats unfolded"),
        "tempos": ("<measure>" + tempos + again, 1, "more than 2000 tempo changes"),
        "parts": ("<measure/>" * 9 + "<measure>" + again, 20, "more than 2000 measures of parts, repeats unfolded"),
        "time": (f"<measure>{NOTE.replace('<duration>4', '<duration>99999')}</measure>", 1, "s of music"),
    }
    for name, (measures, n_parts, line) in cases.items():
        path = tmp_path / f"{name}.musicxml"
        path.write_text(parts(measures, n_parts))
        refused(path, line)


def test_measures_that_are_passed_over_are_counted() -> None:
    skipped = [Measure(endings=frozenset({99})) for _ in range(7000)]
    with pytest.raises(ScoreError, match="more than 200000 measures, repeats unfolded, with those that are left out"):
        order([Measure(), *skipped, Measure(closes=32, endings=frozenset(range(33)))])
    assert len(order([Measure(), Measure(closes=32)])) == 64


def test_strokes_and_bends_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ornaments = {"tremolo": "<tremolo>5</tremolo>", "trill": "<trill-mark/>", "vibrato": "<wavy-line/>"}
    monkeypatch.setattr(written, "MAX_NOTES", 500)
    monkeypatch.setattr(written, "MAX_CONTROLS", 500)
    for name, sign in ornaments.items():
        long = note("C", 4, 400, more=f"<ornaments>{sign}</ornaments>")
        path = tmp_path / f"{name}.musicxml"
        path.write_text(parts(f"<measure>{long}</measure>"))
        refused(path, "more than 500 (notes|controls)")
        path.write_text(
            parts(f"<measure>{long.replace('400', '1e9')}<backup><duration>1e9</duration></backup></measure>")
        )
        refused(path, "s of music")


@pytest.mark.parametrize("kind", ["PrimaryTuplet", "SecondaryTuplet"])
@pytest.mark.parametrize(("num", "den"), [(1, 1000), (1000, 1), (997, 991)])
def test_a_rhythm_has_one_tuplet_of_a_kind(tmp_path: Path, kind: str, num: int, den: int) -> None:
    text = gpif_text(tmp_path)
    tuplets = f'</NoteValue><{kind} num="3" den="2"/>' + f'<{kind} num="{num}" den="{den}"/>' * 120
    path = archived(tmp_path / "tuplets.gp", text.replace("</NoteValue>", tuplets, 1))
    score = tw.read_score(path)
    assert score.notes[0].duration == pytest.approx(2 / 3)  # of a quarter note of 1 s
    assert score.ignored == {"second tuplet of a kind": 120}


def test_notes_of_ornaments_count_as_notes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = gpif_text(tmp_path).replace('<Note id="0">', '<Note id="0"><Ornament>Turn</Ornament>')
    path = archived(tmp_path / "turns.gp", text.replace("<Beats>0", "<Beats>" + "0 " * 10))
    monkeypatch.setattr(written, "MAX_NOTES", 40)
    assert len(tw.read_score(path).notes) == 40
    monkeypatch.setattr(written, "MAX_NOTES", 39)
    refused(path, "more than 39 notes, repeats unfolded")


def test_a_curve_of_many_points_is_what_it_was() -> None:
    curve = tuple((share, cents) for share, cents in ((0.0, 10.0), (0.0, 20.0), (0.25, 60.0), (0.5, 60.0), (0.75, 0.0)))
    wanted = {0.0: 20.0, 0.125: 40.0, 0.25: 60.0, 0.375: 60.0, 0.625: 30.0, 0.75: 0.0, 1.0: 0.0}
    assert {share: bend_curves.value_at(curve, share) for share in wanted} == wanted
    assert bend_curves.value_at(((0.5, 7.0),), 0.5) == 7.0


def test_grace_notes_and_chords_of_any_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(written, "_MOST_COMPARED", 5000)
    grace = "<note><grace/><pitch><step>D</step><octave>4</octave></pitch></note>"
    chord = NOTE.replace("<note>", "<note><chord/>")
    path = tmp_path / "grace.musicxml"
    path.write_text(parts("<measure>" + (grace + NOTE) * 1000 + "</measure>"))
    assert len(tw.read_score(path).notes) == 2000
    path.write_text(parts("<measure>" + grace * 200 + NOTE + chord * 200 + "</measure>"))
    refused(path, "more than 5000 notes that begin together with grace notes")


def test_sums_of_odd_lengths_stay_short(tmp_path: Path) -> None:
    """Divisions of all sizes: the exact time would have a denominator of thousands of digits."""
    one = "<measure><attributes><divisions>{}</divisions></attributes>" + note("C", 4, 1) + "</measure>"
    path = tmp_path / "odd.musicxml"
    path.write_text(parts("".join(one.format(n) for n in range(9000, 11_000))))
    notes = tw.read_score(path).notes
    wanted = 0.5 * sum(1.0 / n for n in range(9000, 11_000 - 1))
    assert notes[-1].time == pytest.approx(wanted, abs=1e-6)
    assert written.near(Fraction(1, 3)) == Fraction(1, 3)
    assert written.near(Fraction(10**30, 3 * 10**30 + 1)).denominator <= 10**9


@pytest.mark.parametrize("suffix", [".gp3", ".gp4", ".gp5"])
def test_counts_of_guitar_pro_are_bounded(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import guitarpro as gp

    def longer(song: gp.Song, beats: list[gp.Beat]) -> None:
        for _ in range(9):
            song.newMeasure()

    path = guitar_pro(tmp_path / f"long{suffix}", longer)
    before = [n.time for n in tw.read_score(path).notes]
    assert before == [0.0, 1.0, 2.0, 3.0]
    limits_and_lines = {
        "_MOST_HEADERS": (9, "more than 9 measures"), "_MOST_TRACKS": (0, "more than 0 tracks"),
        "_MOST_BEATS": (3, "more than 3 beats"), "_MOST_CELLS": (9, "more than 9 measures of tracks"),
    }  # fmt: skip
    for name, (most, line) in limits_and_lines.items():
        with monkeypatch.context() as patched:
            patched.setattr(guitar_pro_file, name, most)
            refused(path, line)


@pytest.mark.parametrize("suffix", [".gp3", ".gp5"])
def test_ties_and_beats_are_looked_up_in_few_steps(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beats without a time of their own, and ties to nothing, would be searched for among all others."""
    import guitarpro as gp

    def ties(song: gp.Song, beats: list[gp.Beat]) -> None:
        for beat in beats[1:]:
            beat.notes[0].type, beat.notes[0].string = gp.NoteType.tie, 6
        beats[0].notes[0].value = 7

    path = guitar_pro(tmp_path / f"ties{suffix}", ties)
    score = tw.read_score(path)
    assert [(n.stop, n.duration) for n in score.notes] == [(7.0, 4.0)]
    monkeypatch.setattr(guitar_pro_file, "_MOST_LOOKS", 2)
    refused(path, "more than 2 beats between ties")


def test_a_file_of_guitar_pro_that_ends_early_is_not_read_for_ever(tmp_path: Path) -> None:
    data = bytearray(guitar_pro(tmp_path / "good.gp3").read_bytes())
    path = tmp_path / "cut.gp3"
    place = 31  # behind the version, and then eight texts: the number of lines of the notice
    for _ in range(8):
        place += 4 + int.from_bytes(data[place : place + 4], "little")
    data[place : place + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(data)
    refused(path, "damaged Guitar Pro file")


def test_keys_struck_again_and_again_end_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "held.mid"
    path.write_bytes(smf(b"".join(event(0, 0x90, 60, 80) for _ in range(50)) + event(1, 60, 0) * 50))
    ends = [n.time + n.duration for n in tw.read_score(path).notes]
    assert ends == sorted(ends)


def test_a_trill_below_the_open_string_has_no_fret(tmp_path: Path) -> None:
    path = gpif(tmp_path / "trill.gp", [(0, 0, "", "<Trill>35</Trill>")])
    notes = tw.read_score(path).notes
    assert {(n.note, n.stop) for n in notes} == {(40.0, 0.0), (35.0, None)}


def child(kind: str, seed: int, count: int) -> str:
    """Read damaged files in another process; returns its output."""
    arguments = [sys.executable, str(Path(__file__).with_name("mutations.py")), kind, str(seed), str(count)]
    result = subprocess.run(arguments, capture_output=True, text=True, env=os.environ, timeout=900, check=False)
    assert result.returncode == 0, result.stderr[-500:]
    return result.stdout


@pytest.mark.skipif(sys.platform != "linux", reason="memory of a process is read from /proc")
@pytest.mark.parametrize("kind", FORMATS)
def test_a_few_damaged_files_of_every_format(kind: str) -> None:
    said = child(kind, 50, 12)
    assert "BAD" not in said
    assert " read, " in said


@pytest.mark.validate
@pytest.mark.skipif(sys.platform != "linux", reason="memory of a process is read from /proc")
@pytest.mark.parametrize("kind", FORMATS)
def test_many_damaged_files_of_every_format(kind: str) -> None:
    said = child(kind, 100_000, 1500)
    assert "BAD" not in said


def test_parts_and_numbers_of_endings_are_bounded(tmp_path: Path) -> None:
    """Else 95,000 parts in an archive of some kB, and an ending of 10,000 numbers in each measure, take a minute."""
    path = tmp_path / "a.musicxml"
    path.write_text(f"<score-partwise>{2001 * '<part><measure/></part>'}</score-partwise>", encoding="utf-8")
    refused(path, "more than 2000 parts")
    numbers = ",".join(map(str, range(1, 300)))
    ending = f'<barline><ending type="start" number="{numbers}"/></barline>'
    path.write_text(parts(f"<measure>{ending}</measure>"), encoding="utf-8")
    assert tw.read_score(path).ignored == {"number of an ending that cannot be read": 1}


def test_times_of_many_tempos_and_fermatas_are_found_without_comparing_fractions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign = NOTE.replace("</notations>", "<fermata/></notations>")
    path = tmp_path / "held.xml"
    path.write_text(parts("<measure>" + 400 * ('<sound tempo="1900"/>' + sign) + "</measure>"))
    compared: list[Fraction] = []
    below = Fraction.__lt__
    monkeypatch.setattr(Fraction, "__lt__", lambda a, b: compared.append(a) or below(a, b))
    assert len(tw.read_score(path).notes) == 400
    assert len(compared) < 20 * 400


def test_empty_measures_of_one_part_are_not_compared_with_all_others(tmp_path: Path) -> None:
    """1000 parts of one measure and one of 1000 are 2000 measures; each of them costs the same few calls."""
    many = "".join(f'<part id="{i}"><measure/></part>' for i in range(1000))
    path = tmp_path / "a.musicxml"
    path.write_text(f'<score-partwise>{many}<part id="long">{"<measure/>" * 1000}</part></score-partwise>')
    calls = 0

    def count(_frame: FrameType, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        read_musicxml(path.read_bytes(), path)
    finally:
        sys.setprofile(None)
    assert calls < 2000 * 100


def test_names_with_a_long_namespace_are_kept_once(tmp_path: Path) -> None:
    """expat writes the namespace out in each name; 20,000 elements of one name take less than 300 bytes each."""
    path = tmp_path / "a.musicxml"
    space = f'<score-partwise xmlns:a="{"u" * 400}"><a:b'
    path.write_text(f"{space}/>{'<a:b/>' * 20_000}</score-partwise>")
    tracemalloc.start()
    read_musicxml(path.read_bytes(), path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak / 20_000 < 300
    for names in ("<a:c{}/>", '<a:b a:c{}=""/>'):
        path.write_text(f"{space}>{''.join(names.format(i) for i in range(10_000))}</a:b></score-partwise>")
        refused(path, "more than 10000 different names of elements and attributes")
