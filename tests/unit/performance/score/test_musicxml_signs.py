"""Signs of MusicXML that change loudness, time and pedals: against what the standard says of each."""

from __future__ import annotations

from pathlib import Path

import pytest
from tablatures import note

import tonewood as tw
from tonewood.errors import ScoreError


def read(tmp_path: Path, *measures: str) -> tw.Score:
    """A score in quarter notes at 60 a minute, four divisions to each."""
    start = '<attributes><divisions>4</divisions></attributes><direction><sound tempo="60"/></direction>'
    bars = "".join(f"<measure>{start if i == 0 else ''}{m}</measure>" for i, m in enumerate(measures))
    path = tmp_path / "a.musicxml"
    path.write_text(f'<score-partwise><part id="P">{bars}</part></score-partwise>', encoding="utf-8")
    return tw.read_score(path)


def sign(inside: str, more: str = "") -> str:
    return f"<direction><direction-type>{inside}</direction-type>{more}</direction>"


def plain(*steps: str, duration: int = 4) -> str:
    return "".join(note(step, 4, duration) for step in steps)


def test_hairpins_lead_to_the_dynamics_after_them(tmp_path: Path) -> None:
    """From p (49) to f (96) over four quarters, then to the end by the usual step; the last level stays."""
    p, f = (sign(f"<dynamics><{d}/></dynamics>") for d in "pf")
    grows, fades, ends = (sign(f'<wedge type="{t}"/>') for t in ("crescendo", "diminuendo", "stop"))
    score = read(tmp_path, p + grows + plain(*"CDEF") + ends, f + plain("C") + fades + plain(*"DE") + ends + plain("F"))
    assert [n.velocity_midi for n in score.notes] == [49, 61, 72, 84, 96, 96, 88, 80]
    assert score.ignored == {}
    alone = read(tmp_path, grows + plain(*"CD") + ends + plain("E"), sign('<wedge type="crescendo"/>') + plain("C"))
    assert [n.velocity_midi for n in alone.notes] == [80, 88, 96, 96]
    assert alone.ignored == {"hairpin without an end": 1}


DYNAMICS = "<dynamics><{}/></dynamics>"


@pytest.mark.parametrize(
    ("signs", "velocities"),
    [
        # dynamics a quarter after the end of a hairpin are its goal, later ones are not
        (["p <", "C", "D !", "E", "f F"], [49, 72, 96, 96]),
        (["p <", "C !", "D", "E", "f F"], [49, 65, 65, 96]),
        # dynamics against its sense, or none other than before, are those of the notes after it alone
        (["p <", "C", "D ! pp", "E", "<", "F !"], [49, 57, 33, 33]),
        (["p >", "C", "D ! p", "E", "F"], [49, 41, 49, 49]),
        # one hairpin after the other, and within the range of velocities
        (["p <", "C", "D ! >", "E", "F !"], [49, 57, 65, 57]),
        (["fff <", "C", "D !", "pppp >", "E", "F !", "G"], [126, 126, 8, 4, 1]),
        ([">", "C", "D !", "E"], [80, 72, 64]),
        (["<", "C", "D", "E !", "F"], [80, 85, 91, 96]),
        # dynamics within a hairpin end it
        (["p <", "C", "D f", "E !", "F"], [49, 72, 96, 96]),
        # of several at one place the first is the goal, the last holds from there on
        (["p <", "C", "D ! f p", "E"], [49, 72, 49]),
        (["f p <", "C", "D ! ff", "E"], [49, 80, 112]),
    ],
)
def test_levels_of_hairpins_by_hand(tmp_path: Path, signs: list[str], velocities: list[int]) -> None:
    kinds = {"<": "crescendo", ">": "diminuendo", "!": "stop"}
    bar = "".join(
        plain(s) if s in "CDEFG" else sign(f'<wedge type="{kinds[s]}"/>' if s in kinds else DYNAMICS.format(s))
        for s in " ".join(signs).split()
    )
    assert [n.velocity_midi for n in read(tmp_path, bar).notes] == velocities


def test_pedals_hold_notes_and_move_controllers(tmp_path: Path) -> None:
    down, change, up = (sign(f'<pedal type="{t}"/>') for t in ("start", "change", "stop"))
    score = read(tmp_path, down + plain(*"CD") + change + plain(*"EF") + up)
    moves = [(c.time, c.kind, c.value) for c in score.controls if c.kind == "cc64"]
    assert moves == [(0, "cc64", 1), (2, "cc64", 0), (pytest.approx(2.06), "cc64", 1), (4, "cc64", 0)]
    assert [(n.duration, n.held) for n in score.notes] == [(2.0, 1.0), (1.0, None), (2.0, 1.0), (1.0, None)]
    some = read(tmp_path, sign('<pedal type="sostenuto"/>') + plain(*"CD") + up + plain("E"))
    assert [(c.time, c.kind, c.value) for c in some.controls if c.kind == "cc66"] == [(0, "cc66", 1), (2, "cc66", 0)]
    half = read(tmp_path, '<sound damper-pedal="40"/>' + plain("C") + '<sound soft-pedal="yes"/>' + plain("D"))
    assert [(c.time, c.kind, c.value) for c in half.controls] == [(0.0, "cc64", 0.4), (1.0, "cc67", 1.0)]
    assert [n.held for n in half.notes] == [None, None]
    wrong = read(tmp_path, '<sound damper-pedal="deep"/>' + plain("C"))
    assert wrong.ignored == {"damper-pedal that cannot be read": 1}


@pytest.mark.parametrize(
    ("fifths", "ornament", "pitches"),
    [
        (0, "<turn/>", [65, 64, 62, 64]),
        (2, "<turn/>", [66, 64, 62, 64]),
        (0, "<inverted-turn/>", [62, 64, 65, 64]),
        (0, "<mordent/>", [64, 62, 64]),
        (-3, "<inverted-mordent/>", [64, 65, 64]),
        (0, '<mordent/><accidental-mark placement="below">sharp</accidental-mark>', [64, 63, 64]),
        (0, "<trill-mark/>", [64, 65] * 4),
        (1, "<trill-mark/><wavy-line type='start'/>", [64, 66] * 4),
    ],
)
def test_ornaments_take_their_notes_from_the_key(
    tmp_path: Path, fifths: int, ornament: str, pitches: list[int]
) -> None:
    key = f"<attributes><key><fifths>{fifths}</fifths></key></attributes>"
    score = read(tmp_path, key + note("E", 4, 4, more=f"<ornaments>{ornament}</ornaments>"))
    assert [n.note for n in score.notes] == pitches
    assert score.ignored == {}


def test_arpeggios_go_up_and_down(tmp_path: Path) -> None:
    for way, order in (("", [60, 64, 67]), (' direction="down"', [67, 64, 60])):
        chord = "".join(
            note(step, 4, 4, more=f"<arpeggiate{way}/>", before="<chord/>" if step != "C" else "") for step in "CEG"
        )
        score = read(tmp_path, chord)
        assert [n.note for n in score.notes] == order
        assert [n.time for n in score.notes] == pytest.approx([0.0, 0.012, 0.024])


def test_a_fermata_holds_all(tmp_path: Path) -> None:
    """A held quarter lasts half as long again; a tempo within it, and the tempo after it, stay those of the score."""
    score = read(
        tmp_path,
        plain("C") + note("D", 4, 4, more="<fermata/>") + plain("E") + '<sound tempo="120"/>' + plain("F", "G"),
    )
    assert [n.time for n in score.notes] == pytest.approx([0, 1, 2.5, 3.5, 4.0])
    assert score.notes[1].duration == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("mark", "quarter"),
    [
        ("<metronome><beat-unit>half</beat-unit><per-minute>60</per-minute></metronome>", 0.5),
        ("<metronome><beat-unit>quarter</beat-unit><per-minute>ca. 120</per-minute></metronome>", 0.5),
        ("<words>Allegro (♩ = 120)</words>", 0.5),
        ("<words>♩. = 40</words>", 1.0),
        ("<words>h=90</words>", 1 / 3),
        ("<words>Andante</words>", 1.0),
        ("<words>Allegro = 120</words>", 0.5),
        ("<words>measure = 120</words>", 0.5),
        ("<words>A = 415</words>", 1.0),
        ("<words>tuned to a' = 440</words>", 1.0),
        ("<words>e = 120</words>", 1.0),
        ("<words>pitch = 440 Hz</words>", 1.0),
        ("<words>Capo = open</words>", 1.0),
    ],
)
def test_tempos_stand_in_marks_and_words(tmp_path: Path, mark: str, quarter: float) -> None:
    score = read(tmp_path, sign(mark) + plain("C", "D"))
    assert score.notes[1].time == pytest.approx(quarter)


def test_swing_lasts_until_it_is_straight(tmp_path: Path) -> None:
    swing = "<sound><swing><first>2</first><second>1</second></swing></sound>"
    straight = "<sound><swing><straight/></swing></sound>"
    pair = plain("C", "D", duration=2)
    score = read(tmp_path, swing + pair, pair, straight + pair)
    assert [n.time for n in score.notes] == pytest.approx([0, 2 / 3, 1, 1 + 2 / 3, 2, 2.5])


def test_bytes_that_declare_another_encoding(tmp_path: Path) -> None:
    """A file in UTF-8 whose first line says UTF-16 is read as what it is."""
    text = f'<score-partwise><part id="P"><measure>{plain("C")}</measure></part></score-partwise>'
    path = tmp_path / "a.xml"
    path.write_bytes(f'<?xml version="1.0" encoding="UTF-16"?>{text}'.encode())
    assert [n.note for n in tw.read_score(path).notes] == [60]
    path.write_bytes(f'<?xml version="1.0" encoding="UTF-16"?>{text}'.encode("utf-16"))
    assert [n.note for n in tw.read_score(path).notes] == [60]
    path.write_bytes(f'<?xml version="1.0" encoding="KOI-99"?>{text}'.encode())
    with pytest.raises(ScoreError, match="damaged XML"):
        tw.read_score(path)


def test_words_without_a_text_say_nothing(tmp_path: Path) -> None:
    score = read(tmp_path, sign("<words/>") + plain("C"), sign("<words>q = 120</words>") + plain(*"DE"))
    assert [n.time for n in score.notes] == [0.0, 1.0, 1.5]


def test_jumps_in_words_hold_where_no_sound_says_any(tmp_path: Path) -> None:
    """Orders of measures as music21 unfolds them; the first measure is C, the second D, and so on."""

    def played(*signs: str, more: str = "") -> str:
        bars = [sign(s) + plain(step, duration=16) for s, step in zip(signs, "CDEF", strict=False)]
        return "".join("C.D.EF"[int(n.note or 0) - 60] for n in read(tmp_path, more + bars[0], *bars[1:]).notes)

    al_coda = ("<segno/>", "<words>To Coda</words>", "<words>D.S. al Coda</words>", "<coda/>")
    assert played(*al_coda) == "CDECDF"
    assert played("<words/>", "<words>Fine</words>", "<words>D. C. al Fine</words>") == "CDECD"
    assert played("<words/>", "<words>segno</words>", "<words>Dal Segno</words>") == "CDEDE"
    assert played(*al_coda, more='<sound segno="a"/>') == "CDEF"
    assert played("<words>fine tuning</words>", "<words>D.C. ad lib</words>", "<words/>") == "CDE"


def test_divisions_after_the_first_notes_and_a_blank_line_before_all(tmp_path: Path) -> None:
    bar = plain("C", "D", duration=8) + "<attributes><divisions>8</divisions></attributes>" + plain("E", duration=8)
    path = tmp_path / "a.xml"
    path.write_text(
        f'\n<?xml version="1.0"?><score-partwise><part id="P"><measure>{bar}</measure></part></score-partwise>'
    )
    assert [n.time for n in tw.read_score(path).notes] == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize("tied_first", [True, False])
def test_a_tie_ends_no_longer_note_of_another_voice(tmp_path: Path, tied_first: bool) -> None:
    tied = [note("A", 4, 4, before=tie) for tie in ('<tie type="start"/>', '<tie type="stop"/>')]
    back = "<backup><duration>{}</duration></backup>"
    voices = ["".join(tied) + back.format(8), note("A", 4, 16)]
    if not tied_first:
        voices = [note("A", 4, 16) + back.format(16), "".join(tied)]
    score = read(tmp_path, "".join(voices))
    assert max(n.time + n.duration for n in score.notes) == 4.0


def test_dynamics_of_one_note(tmp_path: Path) -> None:
    """In percent of velocity 90, for that note alone."""
    soft = note("A", 4, 4).replace("<note>", '<note dynamics="50">')
    loud = note("A", 4, 4).replace("<note>", '<note dynamics="300">')
    score = read(tmp_path, soft + loud + note("A", 4, 4))
    assert [n.velocity_midi for n in score.notes] == [45, 127, 80]


def test_staves_are_transposed_apart(tmp_path: Path) -> None:
    moves = "".join(f'<transpose number="{n}"><chromatic>{c}</chromatic></transpose>' for n, c in ((1, -12), (2, 3)))
    staves = "".join(note("A", 4, 4, before=f"<staff>{n}</staff>") for n in (1, 2))
    all_staves = "<attributes><transpose><chromatic>-2</chromatic><double/></transpose></attributes>"
    score = read(tmp_path, f"<attributes>{moves}</attributes>" + staves + all_staves + staves)
    assert [n.note for n in score.notes] == [57, 72, 67, 67]
    assert score.ignored == {"transposition that doubles": 1}


@pytest.mark.parametrize(
    ("direction", "first"),
    [
        ('<direction><offset>4</offset><sound tempo="120"/></direction>', 0.5),
        ('<direction><offset sound="yes">4</offset><sound tempo="120"/></direction>', 1.0),
        ('<sound tempo="120"><offset>4</offset></sound>', 1.0),
    ],
)
def test_an_offset_moves_what_is_heard_where_it_says_so(tmp_path: Path, direction: str, first: float) -> None:
    score = read(tmp_path, direction + plain(*"AB"))
    assert [n.duration for n in score.notes] == [first, 0.5]


@pytest.mark.parametrize(("between", "third"), [(", ", "2"), ("-", "3")])
def test_endings_of_several_passes(tmp_path: Path, between: str, third: str) -> None:
    """A B A C A B D of the endings 1, 3 and 2; A B A B A C D of 1-2 and 3."""

    def ending(numbers: str, step: str) -> str:
        repeat = '<repeat direction="backward"/>' if step == "B" or third == "2" else ""
        start, stop = (f'<ending number="{numbers}" type="{t}"/>' for t in ("start", "stop"))
        return f"<barline>{start}</barline>{note(step, 4, 4)}<barline>{stop}{repeat}</barline>"

    last = "3" if between == ", " else "2"
    opens = '<barline><repeat direction="forward"/></barline>'
    score = read(tmp_path, opens + plain("A"), ending(f"1{between}{last}", "B"), ending(third, "C"), plain("D"))
    played = ["CDEFGAB"[[0, 2, 4, 5, 7, 9, 11].index(int(n.note or 0) % 12)] for n in score.notes]
    assert "".join(played) == ("ABACABD" if third == "2" else "ABABACD")
    assert score.ignored == {}


def test_a_measure_with_nothing_in_it_lasts_as_its_time_signature_says(tmp_path: Path) -> None:
    """3/4 + 2/8 is four quarters; without a time signature nothing says how long it lasts."""
    time = "<attributes><time>{}</time></attributes>"
    meter = time.format("<beats>3</beats><beat-type>4</beat-type><beats>1+1</beats><beat-type>8</beat-type>")
    assert [n.time for n in read(tmp_path, meter + plain("A"), "", plain("B")).notes] == [0.0, 5.0]
    assert [n.time for n in read(tmp_path, plain("A"), "", plain("B")).notes] == [0.0, 1.0]
    free = time.format("<senza-misura/>")
    assert [n.time for n in read(tmp_path, meter + plain("A"), free, plain("B")).notes] == [0.0, 1.0]


@pytest.mark.parametrize(("meter", "rests", "counted"), [("4", 2, 1), ("4", 1, 0), ("8", 2, 0)])
def test_a_measure_that_one_part_makes_too_long_is_counted(
    tmp_path: Path, meter: str, rests: int, counted: int
) -> None:
    """All parts wait for a part with two whole rests in a measure of 4/4, as some files have it."""
    start = "<attributes><divisions>4</divisions>" + f"<time><beats>{meter}</beats><beat-type>4</beat-type></time>"
    lower = f"<measure>{start}</attributes>{'<note><rest/><duration>16</duration></note>' * rests}</measure>"
    upper = f"<measure>{start}</attributes>{plain(*'ABCD')}</measure><measure>{plain('E')}</measure>"
    path = tmp_path / "a.musicxml"
    path.write_text(f'<score-partwise><part id="P">{upper}</part><part id="Q">{lower}</part></score-partwise>')
    score = tw.read_score(path)
    assert score.notes[-1].time == 2.0 * rests
    assert score.ignored == ({"measure that some parts make longer than its time signature": 1} if counted else {})


def harmonic(step: str, octave: int, inside: str, *, place: str = "", before: str = "") -> str:
    return note(step, octave, 4, f"<harmonic>{inside}</harmonic>{place}", before=before)


@pytest.mark.parametrize(
    ("fret", "step", "octave", "pitch", "partial"), [(12, "E", 5, 76, 2), (7, "B", 5, 83, 3), (5, "E", 6, 88, 4)]
)
def test_a_natural_harmonic_at_its_sounding_pitch(
    tmp_path: Path, fret: int, step: str, octave: int, pitch: int, partial: int
) -> None:
    """Of the open E4 the touched octave, twelfth and double octave; nothing sounds above them."""
    place = f"<string>1</string><fret>{fret}</fret>"
    (one,) = read(tmp_path, harmonic(step, octave, "<natural/><sounding-pitch/>", place=place)).notes
    assert (one.note, one.partial, one.stop, one.marks) == (pitch, partial, 0, ("tablature",))


def test_of_an_artificial_harmonic_in_three_pitches_one_is_heard(tmp_path: Path) -> None:
    """A3 touched a fourth higher sounds A5; the other two notes say where the fingers are."""
    three = (("A", 3, "base"), ("D", 4, "touching"), ("A", 5, "sounding"))
    chord = [
        harmonic(step, octave, f"<artificial/><{kind}-pitch/>", before="<chord/>" if i else "")
        for i, (step, octave, kind) in enumerate(three)
    ]
    score = read(tmp_path, "".join(chord) + plain("C"))
    assert [(n.note, n.time) for n in score.notes] == [(81, 0.0), (60, 1.0)]
    assert score.ignored == {}
    without = read(tmp_path, "".join(chord[:2]))
    assert [n.note for n in without.notes] == [57]
    assert without.ignored == {"harmonic whose sounding pitch is not written, played at the octave": 1}


def test_a_sound_begins_a_repeat(tmp_path: Path) -> None:
    back = '<barline><repeat direction="backward"/></barline>'
    score = read(tmp_path, plain("A"), '<sound forward-repeat="yes"/>' + plain("B") + back, plain("C"))
    assert [n.note for n in score.notes] == [69, 71, 71, 60]


def test_what_is_not_followed_of_passes_and_tremolos_is_counted(tmp_path: Path) -> None:
    some = note("A", 4, 4).replace("<note>", '<note time-only="2">')
    pair = [note("A", 4, 4, more=f'<ornaments><tremolo type="{t}">2</tremolo></ornaments>') for t in ("start", "stop")]
    score = read(tmp_path, some + '<sound time-only="1" tempo="60"/>' + "".join(pair))
    assert score.ignored == {
        "note of some passes only, played in all": 1,
        "sound of some passes only, obeyed in all": 1,
        "tremolo between two notes, each repeated": 1,
    }


def test_fermatas_of_rests_hold_and_those_of_barlines_are_counted(tmp_path: Path) -> None:
    """60 a minute: a rest of a quarter under a fermata lasts 1.5 s."""
    held = "<note><rest/><duration>4</duration><notations><fermata/></notations></note>"
    score = read(tmp_path, plain("C") + held + plain("D") + "<barline><fermata/></barline>")
    assert [n.time for n in score.notes] == [0.0, 2.5]
    assert score.ignored == {"fermata of a barline": 1}


def test_dynamics_at_a_note_hold_from_it_on_and_those_that_are_no_level_are_counted(tmp_path: Path) -> None:
    at_note = note("D", 4, 4, more="<dynamics><ff/></dynamics>")
    score = read(tmp_path, plain("C") + at_note + plain("E") + sign("<dynamics><sfz/></dynamics>") + plain("F"))
    assert [n.velocity_midi for n in score.notes] == [80, 112, 112, 112]
    assert score.ignored == {"sfz": 1}
    ends = (sign(f"<dynamics><{level}/></dynamics>") for level in ("pppppp", "ffffff"))
    assert [n.velocity_midi for n in read(tmp_path, "".join(d + plain("C") for d in ends)).notes] == [1, 127]
    grows, end = (sign(f'<wedge type="{kind}"/>') for kind in ("crescendo", "stop"))
    score = read(tmp_path, grows + plain("C", "C") + end + at_note)
    assert [n.velocity_midi for n in score.notes] == [80, 96, 112]
    sfz = sign("<dynamics><sfz/></dynamics>")  # ends no hairpin
    score = read(tmp_path, grows + plain("C") + sfz + plain("C") + end + at_note)
    assert [n.velocity_midi for n in score.notes] == [80, 96, 112]


def test_measures_of_repeat_signs_play_those_before_them(tmp_path: Path) -> None:
    """A sign may play the last two measures again; it holds until its stop, in measures without notes."""
    style = "<attributes>{}<measure-style{}>{}</measure-style></attributes>"
    again = '<measure-repeat type="{}">{}</measure-repeat>'
    rest = "<note><rest/><duration>4</duration></note>"
    bars = (plain("C"), plain("D"), style.format("", "", again.format("start", 2)) + rest, rest, plain("E"), rest)
    end = style.format("", "", again.format("stop", "")) + rest
    score = read(tmp_path, *bars, end, plain("F"))
    assert [(n.time, n.note) for n in score.notes] == [
        (0, 60), (1, 62), (2, 60), (3, 62), (4, 64), (5, 62), (7, 65)
    ]  # fmt: skip
    assert score.ignored == {}
    beats = style.format("", "", '<beat-repeat type="start"/>')
    wrong = style.format("", "", again.format("start", "x")) + style.format(
        "<staves>2</staves>", ' number="2"', again.format("start", 1)
    )
    score = read(tmp_path, plain("C"), beats + wrong + rest)
    assert [n.note for n in score.notes] == [60]
    assert score.ignored == {
        "beat-repeat": 1, "measure-repeat that cannot be read": 1, "measure-repeat on one of several staves": 1
    }  # fmt: skip


def test_a_chord_of_grace_notes_sounds_at_once(tmp_path: Path) -> None:
    """60 a minute: each, a chord and a note, takes a quarter of the note after it, at most an eighth of a quarter."""

    def grace(step: str, before: str = "") -> str:
        return f"<note><grace/>{before}<pitch><step>{step}</step><octave>4</octave></pitch></note>"

    score = read(tmp_path, plain("C") + grace("D") + grace("F", "<chord/>") + grace("E") + plain("G"))
    assert [(n.time, n.note, n.duration) for n in score.notes] == [
        (0, 60, 1), (1, 62, 0.03125), (1, 65, 0.03125), (1.03125, 64, 0.09375), (1.125, 67, 0.875)
    ]  # fmt: skip


def test_a_tremolo_that_is_not_measured_has_eight_strokes_a_quarter(tmp_path: Path) -> None:
    free = note("C", 4, 4, more='<ornaments><tremolo type="unmeasured">0</tremolo></ornaments>')
    assert [n.time for n in read(tmp_path, free).notes] == [i / 8 for i in range(8)]


def test_signs_of_a_sound_that_are_not_followed_are_counted(tmp_path: Path) -> None:
    program = '<sound><midi-instrument id="I"><midi-program>41</midi-program></midi-instrument></sound>'
    early = note("D", 4, 4).replace("<note>", '<note attack="-1" release="2">')
    score = read(tmp_path, plain("C") + program + early + '<sound pizzicato="yes"/>' + plain("E"))
    assert [n.note for n in score.notes] == [60, 62, 64]
    assert score.ignored == {
        "change of instrument within a part": 1, "attack or release of a note": 1, "pizzicato": 1,
    }  # fmt: skip
