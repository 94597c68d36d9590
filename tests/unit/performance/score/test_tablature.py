"""Tablature: read again it has the notes that went in; measures are full; a piece known by heart has its frets."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import tonewood as tw
from tonewood.performance.score.assignment import Assigned, PlayableString, assign
from tonewood.performance.score.note import Beats
from tonewood.performance.score.tablature import TICKS, Tablature, musicxml, tablature, text

OPEN = {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64}
GUITAR = [PlayableString.fretted(name, pitch, 19) for name, pitch in OPEN.items()]
ROMANCE = Path(__file__).parents[4] / "examples/scores/romance.mid"


def tab_of(notes: list[tw.Note], beats: Beats | None = None) -> Tablature:
    return tablature(assign(notes, GUITAR).notes, GUITAR, beats or Beats(), title="A & B")


def read_again(tab: Tablature, path: Path) -> list[tuple[Fraction, float, float]]:
    """(quarter note, pitch, stop) of each note, by the reader of MusicXML."""
    path.write_bytes(musicxml(tab))
    score = tw.read_score(path)
    assert score.ignored == {}
    assert score.beats is not None
    beats = [(Fraction(score.beats.quarter(n.time)).limit_denominator(96), n) for n in score.notes]
    return sorted((at, float(n.note or 0), float(n.stop or 0)) for at, n in beats)


def test_romance_has_the_frets_that_guitarists_play(tmp_path: Path) -> None:
    """Its melody lies on the first string at 7 7 7, 7 5 3, 3 2 0 over the open second and third."""
    music = tw.read_score(ROMANCE)
    tab = tablature(assign(music.notes, GUITAR).notes, GUITAR, music.beats or Beats(), title="romance")
    melody = [p.fret for _, chord in tab.chords for p in chord if p.row == 1]
    assert melody[:9] == [7, 7, 7, 7, 5, 3, 3, 2, 0]
    assert [p.fret for _, chord in tab.chords[1:3] for p in chord] == [0, 0]
    assert all(0 <= p.finger <= 4 and (p.finger == 0) == (p.fret == 0) for _, chord in tab.chords for p in chord)
    again = read_again(tab, tmp_path / "a.musicxml")
    wanted = sorted(music.notes, key=lambda n: (n.time, n.note or 0))
    assert [n[1] for n in again] == [float(n.note or 0) for n in wanted]
    first = text(tab).splitlines()
    assert first[:2] == ["romance", "Tuning E2 A2 D3 G3 B3 E4"]
    assert first[4].startswith("E4 |-7")
    assert first[9].startswith("E2 |-0")


@pytest.mark.parametrize("fine", [4, 6, 8])
def test_onsets_and_frets_come_back(tmp_path: Path, fine: int) -> None:
    """Sixteenths, triplets and thirty-seconds at 90 a minute in 3/4, across bar lines, a long one at the end."""
    steps = [0, 1, 2, 5, fine, 2 * fine + 1, 3 * fine - 1, 3 * fine, 7 * fine]
    notes = [tw.Note(k / fine * 60 / 90, 0.1, note=52 + i) for i, k in enumerate(steps)]
    notes += [tw.Note(0.0, 0.5, note=40), tw.Note(12 * 60 / 90, 8.0, note=43)]
    tab = tab_of(sorted(notes, key=lambda n: n.time), Beats([(0.0, 0.0, 90.0)], [(0.0, 3.0)]))
    wanted = sorted(
        (Fraction(round(p.note.note.time * 1.5 * fine), fine), p.note.note.note, float(p.fret))
        for _, chord in tab.chords for p in chord
    )  # fmt: skip
    assert read_again(tab, tmp_path / "a.musicxml") == wanted
    root = ET.fromstring(musicxml(tab))
    for measure in root.iter("measure"):
        alone = [n for n in measure.iter("note") if n.find("chord") is None]
        assert sum(int(n.findtext("duration", "0")) for n in alone) == 3 * TICKS
    inner = root.iter("time-modification")
    assert bool(list(inner)) == (fine == 6)


def test_two_notes_within_a_step_on_one_string_stay_two() -> None:
    notes = [tw.Note(0.0, 0.01, note=64, string="E4", stop=0), tw.Note(0.02, 0.1, note=66, string="E4", stop=2)]
    tab = tab_of(notes)
    assert [[p.fret for p in chord] for _, chord in tab.chords] == [[0], [2]]


#: strings from stop 1 on, at which a capo holds them
HELD = [PlayableString("A", tuple(range(46, 65))), PlayableString("D", tuple(range(51, 70)))]
#: 60 a minute, from the second quarter note on 90; a measure of 5/8, then of 2/4
CHANGING = Beats([(0.0, 0.0, 60.0), (1.0, 1.0, 90.0)], [(0.0, 2.5), (2.5, 2.0)])
MEASURES = """<part id="P1"><measure number="1">
<attributes><divisions>24</divisions><time><beats>5</beats><beat-type>8</beat-type></time>
<clef><sign>TAB</sign><line>5</line></clef><staff-details><staff-lines>2</staff-lines>
<staff-tuning line="1"><tuning-step>A</tuning-step><tuning-octave>2</tuning-octave></staff-tuning>
<staff-tuning line="2"><tuning-step>D</tuning-step><tuning-octave>3</tuning-octave></staff-tuning>
<capo>1</capo></staff-details></attributes>
{above}<metronome><beat-unit>quarter</beat-unit><per-minute>60</per-minute></metronome></direction-type>
<sound tempo="60"/></direction>
{above}<metronome><beat-unit>quarter</beat-unit><per-minute>90</per-minute></metronome></direction-type>
<offset>24</offset><sound tempo="90"/></direction>
{above}<words>I</words></direction-type></direction>
<note><pitch><step>D</step><alter>1</alter><octave>3</octave></pitch><duration>36</duration><voice>1</voice>
<type>quarter</type><dot/><notations><technical><string>1</string><fret>0</fret></technical></notations></note>
<note><chord/><pitch><step>C</step><octave>3</octave></pitch><duration>36</duration><voice>1</voice>
<type>quarter</type><dot/>
<notations><technical><fingering>2</fingering><string>2</string><fret>2</fret></technical></notations></note>
{above}<words>IV</words></direction-type></direction>
<note><pitch><step>F</step><octave>3</octave></pitch><duration>24</duration><tie type="start"/><voice>1</voice>
<type>quarter</type><notations><tied type="start"/>
<technical><fingering>4</fingering><string>2</string><fret>7</fret></technical></notations></note></measure>
<measure number="2"><attributes><time><beats>2</beats><beat-type>4</beat-type></time></attributes>
<note><pitch><step>F</step><octave>3</octave></pitch><duration>36</duration><tie type="stop"/><tie type="start"/>
<voice>1</voice><type>quarter</type><dot/><notations><tied type="stop"/><tied type="start"/>
<technical><string>2</string><fret>7</fret></technical></notations></note>
<note><pitch><step>F</step><octave>3</octave></pitch><duration>6</duration><tie type="stop"/><voice>1</voice>
<type>16th</type><notations><tied type="stop"/>
<technical><string>2</string><fret>7</fret></technical></notations></note>
{above}<words>III</words></direction-type></direction>
<note><pitch><step>F</step><alter>1</alter><octave>3</octave></pitch><duration>6</duration><tie type="start"/>
<voice>1</voice><type>16th</type><notations><tied type="start"/>
<technical><fingering>1</fingering><string>1</string><fret>3</fret></technical></notations></note></measure>
<measure number="3">
<note><pitch><step>F</step><alter>1</alter><octave>3</octave></pitch><duration>48</duration><tie type="stop"/>
<voice>1</voice><type>half</type><notations><tied type="stop"/>
<technical><string>1</string><fret>3</fret></technical></notations></note></measure></part>""".format(
    above='<direction placement="above"><direction-type>'
)


def test_a_piece_of_three_measures_element_by_element() -> None:
    """Notes of a chord, of a string over a bar line and of another; positions, tempos, meters, a capo."""
    placed = [(0.0, "A", 3), (0.0, "D", 1), (1.5, "A", 8), (4.25, "D", 4)]
    times = [at if at < 1 else 1 + (at - 1) / 1.5 for at, *_ in placed]
    notes = [
        Assigned(tw.Note(time, 0.5, note=60), string, stop, 0.0, time + 0.5)
        for time, (_, string, stop) in zip(times, placed, strict=True)
    ]
    tab = tablature(notes, HELD, CHANGING, title="A & B", capo=1)
    part = ET.fromstring(musicxml(tab)).find("part")
    assert part is not None
    part.tail = None
    measures = ET.canonicalize(ET.tostring(part, encoding="unicode"), strip_text=True)
    assert measures == ET.canonicalize(MEASURES, strip_text=True)
    assert text(tab).splitlines() == [
        "A & B",
        "Tuning A2 D3, capo 1",
        "",
        "     I      IV             III",
        "D3 |-0------------|--------3---|--------|",
        "A2 |-2------7-----|------------|--------|",
    ]


def test_lines_of_text_hold_whole_measures() -> None:
    """Up to 88 columns; a measure that is longer is alone. Two columns for a 32nd, eight beside a long note's fret."""
    placed = [(k / 16, 0.0) for k in range(64)] + [(4.0, 5.0)]
    notes = [Assigned(tw.Note(time, 0.1, note=60), "E4", stop, 0.0, time + 0.1) for time, stop in placed]
    tab = replace(tablature(notes, GUITAR[5:], Beats()), measures=[0, *range(192, 1153, 96)])
    assert text(tab).splitlines()[2:] == [
        *("", "     I", "E4 |-" + 64 * "0-" + "|"),
        *("", "     II", "E4 |-5---------|" + 8 * "--------|"),  # 88
        *("", "", "E4 |--------|"),
    ]


@pytest.mark.slow
def test_a_capo_counts_frets_from_itself(tmp_path: Path) -> None:
    path = tmp_path / "c.mid"
    tw.write_midi(tw.Score([tw.Note(0.0, 0.4, note=42), tw.Note(0.5, 0.4, note=45)]), path)
    command = [sys.executable, "-m", "tonewood", "tab", str(path), "-i", "classical_guitar", "--capo", "2"]
    output = tmp_path / "c.musicxml"
    done = subprocess.run([*command, "-o", str(output), "--json"], capture_output=True, text=True, check=True)
    said = json.loads(done.stdout)
    assert [said["notes"][0][key] for key in ("string", "stop", "fret", "finger")] == ["E2", 2.0, 0, 0]
    root = ET.fromstring(output.read_bytes())
    assert root.findtext(".//staff-details/capo") == "2"
    assert [t.text for t in root.iterfind(".//staff-tuning/tuning-step")] == list("EADGBE")
    assert [(n.stop, n.note) for n in tw.read_score(output).notes] == [(2.0, 42.0), (5.0, 45.0)]
    for more, reason in {
        ("-o", "a.pdf"): ".pdf is not written", (): "Missing option", ("--json", "--meter", "3/5"): "--meter: is '3/5'",
    }.items():  # fmt: skip
        failed = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
        assert failed.returncode == 2
        assert reason in failed.stderr


def test_measures_follow_the_signs_of_a_midi_file() -> None:
    beats = Beats([(0.0, 0.0, 120.0), (2.0, 4.0, 60.0)], [(0.0, 3.0), (6.0, 2.0), (9.0, 4.0)])
    assert [beats.quarter(t) for t in (0.0, 1.0, 2.0, 4.0)] == [0.0, 2.0, 4.0, 6.0]
    assert beats.measures(9.5) == [0.0, 3.0, 6.0, 8.0, 9.0, 13.0]


def test_a_string_struck_again_and_again_takes_the_first_free_ticks() -> None:
    """As a search of all ticks one after another finds them, and in time proportional to the notes."""
    notes = [tw.Note(time=k // 3 * 0.1, duration=30.0, note=40, string="E2") for k in range(300)]
    tab = tablature([Assigned(n, "E2", 0.0, 0.0, 30.0) for n in notes], GUITAR, Beats())
    taken: set[int] = set()
    for note in notes:
        tick = round(note.time * 2 * 8) * TICKS // 8
        while tick in taken:
            tick += TICKS // 8
        taken.add(tick)
    assert [tick for tick, _ in tab.chords] == sorted(taken)


def test_tempos_of_a_measure_are_found_in_few_steps() -> None:
    compared: list[int] = []

    class Tick(int):
        def __le__(self, other: int) -> bool:
            compared.append(1)
            return int(self) <= other

        def __ge__(self, other: int) -> bool:
            compared.append(1)
            return int(self) >= other

        def __lt__(self, other: int) -> bool:
            compared.append(1)
            return int(self) < other

    tempos = [(Tick(96 * i), 60.0 + i % 2) for i in range(200)]
    tab = Tablature("T", GUITAR, 0, [], frozenset(), [96 * i for i in range(201)], tempos)
    root = ET.fromstring(musicxml(tab))
    assert [len(measure.findall("direction")) for measure in root.iter("measure")] == 200 * [1]
    assert len(compared) < 200 * 20
