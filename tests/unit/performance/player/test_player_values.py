"""Parts of a player by themselves: slurs, dampers, courses of fingers, techniques, varied notes, by hand."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.instrument.bundle.schema import HandNoises, HumanVariation, NoteEnd, Playing, Slurs
from tonewood.instrument.contract.gestures import Event, Fraction, Gesture, Hold
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.player import between_notes, techniques
from tonewood.performance.player.dampers import on_grid, pressed_farthest
from tonewood.performance.player.fretting import FrettedBases, Fretting
from tonewood.performance.player.gestures import _RISE, hold_steps, samples
from tonewood.performance.player.hands import PacedHands
from tonewood.performance.player.player import Player
from tonewood.performance.player.playing import _duration, _glided, _why_nothing, perform, playable
from tonewood.performance.player.strokes import beyond_capo, force_of, gripped, hurried, with_force
from tonewood.performance.player.timeline import GRID, Change, Play, Timeline
from tonewood.performance.player.variation import Deviates, moved, touched
from tonewood.performance.player.voices import CONTINUED, HeldKeys, PlayerCounters, Voice
from tonewood.performance.score.assignment import Assigned, PlayableString
from tonewood.performance.score.note import Control, Dropped
from tonewood.physics.stepping.forcing import Segment
from tonewood.physics.stepping.motion import to_motion

FS = 8000
#: s, between points of the control grid
TICK = GRID / FS


def assigned(time: float, duration: float = 1.0, stop: float = 0.0, end: float | None = None, **more: Any) -> Assigned:
    return Assigned(tw.Note(time, duration, **more), "E2", stop, 0.0, time + duration if end is None else end)


@pytest.fixture(scope="module")
def guitar() -> Model:
    instrument = tw.load_instrument("classical_guitar").replace({"playing.noises.on": True})
    return assemble(instrument, FS, freq_limit=1000)


SLURS = Playing(slurs=Slurs(up="on", down="off", far="slide", reach=4.0, overlap=0.02))


@pytest.mark.parametrize(
    ("both", "steps", "technique", "played"),
    [
        (0.02, 1, None, "on"),
        (0.0199, 1, None, None),
        (0.1, -1, None, "off"),
        (0.1, 0, None, None),
        (0.1, 4, None, "on"),
        (0.1, 4.5, None, "slide"),
        (0.1, -4, None, "off"),
        (0.1, -5, None, "slide"),
        (0.1, 1, "palm", "palm"),
    ],
)
def test_notes_that_overlap_are_slurred(both: float, steps: float, technique: str | None, played: str | None) -> None:
    notes = [assigned(0.0, 1.0 + both, 7), assigned(1.0, 1.0, 7 + steps, technique=technique)]
    first, second = between_notes.slurred(notes, SLURS)
    assert (first, second.note.technique) == (notes[0], played)
    none = between_notes.slurred(notes, Playing())
    assert [n.note.technique for n in none] == [None, technique]
    assert between_notes.slurred([], SLURS) == []


def test_a_damping_hand_takes_60_db_in_its_time() -> None:
    """60 dB are a factor of 1000 of the amplitude."""
    end = NoteEnd(kind="damp", t60=0.25)
    assert math.exp(-between_notes.damping(end) * 0.25) == pytest.approx(1e-3)
    assert between_notes.let_go(1.0, "E2", 3.0, end) == Change(1.0, "E2", stop=3.0, cents=0.0, added_damping=0.0)
    lies = between_notes.let_go(1.0, "E2", 3.0, NoteEnd(idle="damp"))
    assert (lies.stop, lies.added_damping) == (3.0, None)


def test_a_hand_is_laid_on_every_string_where_idle_ones_are_damped(guitar: Model) -> None:
    assert between_notes.laid_on(0.5, guitar) == []
    damped = assemble(guitar.instrument.replace({"playing.note_end.idle": "damp"}), FS, freq_limit=1000)
    rate = math.log(1000) / damped.playing.note_end.t60
    laid = between_notes.laid_on(0.5, damped)
    assert laid == [Change(0.5, name, added_damping=rate) for name in damped.strings]


def plucks(model: Model, *notes: Assigned, length: float = 0.01) -> list[Play]:
    """Gestures that draw for 0.02 s before their notes and last `length` s after them."""
    gesture = Gesture((Segment(-0.02, 0.0, 0.0, 50.0), Segment(0.0, length, 1.0, -1 / length)), 0.1)
    return [Play(n.note.time, gesture, string="E2", exciter=n.note.technique or "pluck") for n in notes]


def heard(model: Model, *notes: Assigned, capo: float = 0.0) -> list[tuple[str, float, float]]:
    """Noises, their beginnings and ends."""
    plays = plucks(model, *notes)
    return [(p.exciter, p.start, p.stop) for p in between_notes.noises(notes, plays, model, capo)]


def test_noises_of_a_hand_come_before_the_gesture_that_needs_the_stop(guitar: Model) -> None:
    """The first finger comes at the last point of the grid before 0.48 s; each noise begins at a point of its own."""
    rows = heard(guitar, assigned(0.5, 0.3, 3, end=2.0), assigned(2.0, 0.3, 0, end=math.inf))
    assert [name for name, _, _ in rows] == ["fretting", "fretting"]
    for (_, begin, end), until in zip(rows, (0.48, 1.98), strict=True):
        point = math.floor(until / TICK + 1e-6) * TICK
        assert point <= end < point + TICK
        assert begin / TICK == pytest.approx(round(begin / TICK), abs=1e-4)
    assert [row[0] for row in heard(guitar, assigned(0.5, 0.3, 3, end=math.inf), capo=3)] == []


@pytest.mark.parametrize(
    ("stops", "capo", "squeaks"),
    [((3, 5), 0.0, 1), ((3, 4), 0.0, 0), ((5, 3), 0.0, 1), ((3, 0), 0.0, 0), ((3, 5), 3.0, 0), ((4, 7), 3.0, 1)],
)
def test_a_hand_squeaks_that_slides_by_two_stops_or_more(
    guitar: Model, stops: tuple[float, float], capo: float, squeaks: int
) -> None:
    notes = [assigned(0.5, 0.5, stops[0], end=3.0), assigned(3.0, 0.5, stops[1], end=math.inf)]
    assert sum(name == "squeak" for name, _, _ in heard(guitar, *notes, capo=capo)) == squeaks


def test_a_note_that_is_damped_well_before_the_next_is_touched(guitar: Model) -> None:
    """Within 1 ms before the next gesture it is not; afterwards the hand is back at the capo where there is time."""
    for end, touches in ((1.0, 1), (1.98 - 0.9e-3, 0), (1.99, 0), (math.inf, 0), (0.505, 0)):
        rows = heard(guitar, assigned(0.5, 0.5, 0, end=end), assigned(2.0, 0.5, 0, end=math.inf))
        assert [row[0] for row in rows] == ["touch"] * touches
    (row,) = heard(guitar, assigned(0.5, 0.5, 0, end=1.0))
    assert row[1] == pytest.approx(1.0, abs=TICK)
    # 1.5 T60 and 0.1 s after its end the finger is gone: the same stop is pressed again
    t60 = guitar.playing.note_end.t60
    for gap, presses in ((1.5 * t60 + 0.1 + 0.021, 2), (1.5 * t60 + 0.1 + 0.019, 1)):
        notes = [assigned(0.5, 0.5, 3, end=1.0), assigned(1.0 + gap, 0.5, 3, end=math.inf)]
        assert sum(row[0] == "fretting" for row in heard(guitar, *notes)) == presses


def test_noises_have_forty_percent_of_the_time_between_two_gestures(guitar: Model) -> None:
    longest = -guitar.exciters["fretting"].gesture(*_event(guitar)).start
    for share, presses in ((1.1, 2), (0.9, 1)):
        gap = share * longest / 0.4
        first = assigned(0.5, 0.1, 3, end=math.inf)
        second = assigned(0.51 + gap + 0.02 + TICK, 0.1, 5, end=math.inf)
        rows = heard(guitar, first, second)
        assert sum(row[0] == "fretting" for row in rows) == presses


def _event(model: Model) -> Any:
    string = model.strings["E2"]
    return Event({}, string.freq(5), 0.0, 5.0, 3.0, string.length(3)), model.place("E2", 5.0)


def test_a_slur_makes_no_noise_of_its_own(guitar: Model) -> None:
    playing = replace_playing(guitar, slurs=Slurs(up="hammer_on"))
    notes = [assigned(0.5, 0.5, 3, end=math.inf), assigned(1.5, 0.5, 5, end=math.inf, technique="hammer_on")]
    assert [row[0] for row in heard(playing, *notes)] == ["fretting"]


def replace_playing(model: Model, **changes: Any) -> Model:
    """The model with other values of ``playing``, for functions that read them alone."""
    keys = ("fs", "strings", "exciters", "choice", "place")
    same = {name: getattr(model, name) for name in keys}
    return SimpleNamespace(playing=model.playing.model_copy(update=changes), **same)  # type: ignore[return-value]


def test_noises_that_are_not_wanted_are_not_made(guitar: Model) -> None:
    off = replace_playing(guitar, noises=HandNoises(on=False, fretting="fretting", touch="touch"))
    one = replace_playing(guitar, noises=HandNoises(on=True, touch="touch"))
    notes = [assigned(0.5, 0.5, 3, end=1.0)]
    assert heard(off, *notes) == []
    assert [row[0] for row in heard(one, *notes)] == ["touch"]
    assert between_notes.not_live(off) == between_notes.not_live(one) == []
    assert between_notes.not_live(guitar) == ["playing.noises.fretting", "playing.noises.squeak"]
    rings = replace_playing(guitar, note_end=NoteEnd(kind="ring"))
    assert [row[0] for row in heard(rings, *notes)] == ["fretting"]


def test_a_note_that_ends_live_is_touched_unless_it_is_still_plucked(guitar: Model) -> None:
    note = assigned(0.5, 0.5, 3)
    (play,) = plucks(guitar, note)
    assert between_notes.touch_at_end(None, play, 1.0, guitar) == []
    assert between_notes.touch_at_end(note, play, 0.509, guitar) == []
    for one in (play, None):
        (touch,) = between_notes.touch_at_end(note, one, 0.512, guitar)
        assert (touch.exciter, touch.string) == ("touch", "E2")
        assert 0.512 <= touch.start < 0.512 + TICK


def test_dampers_follow_the_pedal_pressed_farthest() -> None:
    controls = [
        Control(0.0, "cc64", 0.2, 0), Control(1.0, "cc64", 0.5, 1), Control(2.0, "cc64", 0.9, 0),
        Control(3.0, "cc64", 0.0, 0), Control(3.0, "cc64", 0.0, 1), Control(0.5, "cc7", 1.0, 2),
        Control(4.0, "cc64", 0.0, 2),
    ]  # fmt: skip
    assert pressed_farthest(reversed(controls), "cc64") == [(0.0, 0.2), (1.0, 0.5), (2.0, 0.9), (3.0, 0.0)]  # type: ignore[arg-type]
    assert pressed_farthest([], "cc64") == []


def test_the_last_move_in_each_interval_of_the_grid_counts() -> None:
    steps = [(0.0, 1.0), (0.09, 2.0), (0.1, 3.0), (0.25, 4.0), (0.29, 5.0)]
    assert on_grid(steps, 0.1) == [(0.09, 2.0), (0.1, 3.0), (0.29, 5.0)]


def test_bends_of_a_wheel_leap_at_no_more_than_40_000_cents_a_second() -> None:
    """With steps of 40 cents every ms: 100 by 40, 80, 100, and back by multiples of 40; a later bend cuts it off."""
    up = [Control(1.0, "bend", 100.0, 3)]
    assert [(round(c.time, 9), c.value) for c in _glided(up, 1e-3)] == [(1.0, 40.0), (1.001, 80.0), (1.002, 100.0)]
    back = _glided([*up, Control(2.0, "bend", -50.0, 3)], 1e-3)[3:]
    assert [c.value for c in back] == [80.0, 40.0, 0.0, -40.0, -50.0]
    assert {c.channel for c in back} == {3}
    short = _glided([Control(0.0, "bend", 200.0), Control(0.002, "bend", 90.0)], 1e-3)
    assert [c.value for c in short] == [40.0, 80.0, 90.0]
    assert _glided([Control(0.0, "bend", 0.0)], 1e-3) == []


def test_reasons_why_nothing_is_played_come_by_their_number() -> None:
    drops = [Dropped(0.0, 60.0, None, name) for name in "abbcccdd"]
    assert _why_nothing(drops) == "none of 8 notes can be played: c (3); b (2); d (2); and others"
    assert _why_nothing(drops[:1]) == "the one note cannot be played: a"
    assert _why_nothing(drops[:3]) == "none of 3 notes can be played: b (2); a"


def test_strings_beyond_a_capo(guitar: Model) -> None:
    shortest = min(s.n_stops for s in guitar.strings.values())
    low, _, *_ = playable(guitar, 3)
    assert low.pitches == tuple(40.0 + i for i in range(3, shortest + 1))
    assert playable(guitar)[0].pitches[0] == 40.0
    assert len(playable(guitar, shortest - 1)[0].pitches) == 2
    for capo in (shortest, -1):
        with pytest.raises(ScoreError, match=f"capo: is {capo}; 0 to {shortest - 1} are allowed on this instrument"):
            playable(guitar, capo)


def test_forces_of_notes(guitar: Model) -> None:
    note = tw.Note(0.0, note=60, velocity_midi=64)
    curve = guitar.playing.velocity.value(64)
    assert force_of(note, guitar, 0.5) == pytest.approx(0.5 * curve)
    assert force_of(replace(note, force=2.0), guitar, 0.5) == 1.0
    assert force_of(tw.Note(0.0, note=60), guitar, 0.5) is None
    with_ = with_force(note, guitar, 0.5)
    assert (with_.force, with_.velocity_midi) == (pytest.approx(0.5 * curve), None)
    bare = tw.Note(0.0, note=60)
    assert with_force(bare, guitar, 0.5) is bare


@pytest.mark.parametrize(("stop", "capo", "left"), [(5.0, 2, 3.0), (1.0, 2, 0.0), (None, 2, None), (5.0, 0, 5.0)])
def test_stops_count_from_the_capo(stop: float | None, capo: int, left: float | None) -> None:
    assert beyond_capo(tw.Note(0.0, note=60, stop=stop), capo).stop == left


def test_a_hurried_gesture_has_the_same_force_in_less_time() -> None:
    """F(t) of the whole preparation is F(t s) of the hurried one, s the share of the time; what follows stays."""
    gesture = Gesture(
        (Segment(-0.04, -0.02, 0.0, 0.0, 500.0), Segment(-0.02, 0.0, 0.2, 20.0), Segment(0.0, 0.01, 0.6, -60.0)),
        hold=Hold(-0.03, -0.01, 0.005, 2.0),
    )
    short = hurried(gesture, 0.01)
    assert (short.start, short.stop) == (-0.01, 0.01)
    for t in (-0.039, -0.03, -0.021, -0.01, -0.001):
        assert short.force(t / 4) == pytest.approx(gesture.force(t))
    assert short.force(0.004) == gesture.force(0.004)
    assert short.hold == Hold(-0.0075, -0.0025, 0.005, 2.0)
    assert hurried(gesture, 0.04) is gesture
    assert hurried(gesture, 0.0).start == pytest.approx(-1e-3)
    struck = replace(gesture, on="E2.hammer")
    assert hurried(struck, 0.01) is struck
    later = Gesture((Segment(0.0, 0.01, 1.0),))
    assert hurried(later, 0.0) is later
    assert gripped(gesture).hold == Hold(-0.03, -0.03, 0.005, 2.0)
    assert gripped(later) is later


def test_a_dashpot_grows_in_three_steps_where_its_smooth_course_passes_half_way() -> None:
    """3 s^2 - 2 s^3 = 1/6, 1/2, 5/6; each level is the course's mean over its third."""
    hold = Hold(0.1, 0.2, 0.5, 6.0)
    (t1, d1), (t2, d2), (t3, d3), (t4, d4) = hold_steps(Play(1.0, Gesture((), hold=hold), string="E2"), 1e-4)
    assert (d1, d2, d3, d4) == (2.0, 4.0, 6.0, 0.0)
    for sample, level in ((t1, 1 / 6), (t2, 1 / 2), (t3, 5 / 6)):
        s = (sample * 1e-4 - 1.1) / 0.1
        assert 3 * s**2 - 2 * s**3 == pytest.approx(level, abs=2e-3)
    assert t4 == 15000
    assert hold_steps(Play(1.0, Gesture((), hold=hold)), 1e-4) == ()
    assert hold_steps(Play(1.0, Gesture(()), string="E2"), 1e-4) == ()
    assert samples(0.3, 0.1) == 3.0


def course(*segments: Segment, stop: float, continuous: bool, tick: float = 0.1) -> list[tuple[float, float]]:
    play = Play(2.0, Gesture((), stops=segments), string="E2")
    rows = techniques.stop_course(play, stop, continuous, tick)
    return [(round(time, 6), value) for time, value in rows]


def test_a_slide_sounds_the_last_fret_that_it_has_reached() -> None:
    """From 3 to 5 in 0.4 s: 3.5 sounds as 3 on the way up, 4.5 as 5 on the way down; the end is the note's own stop."""
    up, down = Segment(-0.4, 0.0, 3.0, 5.0), Segment(-0.4, 0.0, 5.0, -5.0)
    assert course(up, stop=5.0, continuous=False) == [(1.6, 3.0), (1.8, 4.0), (2.0, 5.0)]
    assert course(down, stop=3.0, continuous=False) == [(1.6, 5.0), (1.8, 4.0), (2.0, 3.0)]
    free = course(up, stop=5.0, continuous=True)
    assert free == [(1.6, 3.0), (1.7, 3.5), (1.8, 4.0), (1.9, 4.5), (2.0, 5.0)]
    assert course(stop=5.0, continuous=False) == []
    fine = course(Segment(0.0, 0.1, 1.23456), stop=1.0, continuous=True)
    assert fine == [(2.0, 1.235), (2.1, 1.0)]


def test_touching_points_follow_their_courses_on_the_grid() -> None:
    touches = {"a": (Segment(0.0, 0.2, 0.1, 1.0),), "b": (Segment(0.1, 0.2, 0.5),)}
    rows = techniques.touch_course(Play(1.0, Gesture((), touches=touches), string="E2"), 0.1)
    assert [round(t, 6) for t, _ in rows] == [1.0, 1.1, 1.2]
    assert [dict(at)["a"] for _, at in rows] == pytest.approx([0.1, 0.2, 0.3])
    assert [dict(at)["b"] for _, at in rows] == [0.5, 0.5, 0.5]
    assert techniques.touch_course(Play(1.0, Gesture(()), string="E2"), 0.1) == []
    still = techniques.touch_course(Play(1.0, Gesture((), touches={"b": touches["b"]})), 0.02)
    assert len(still) == 1


KEYED = Playing(keyswitches={"C1": "palm", "D1": "rest"}, switches={"cc20": "flesh"})


def test_keyswitches_and_controllers_choose_techniques() -> None:
    """A key holds for its channel until the next; a controller from a half on; a note's own stands."""
    notes = [
        tw.Note(0.0, note=60, channel=0), tw.Note(1.0, note=24, channel=0), tw.Note(1.0, note=61, channel=0),
        tw.Note(1.5, note=62, channel=1), tw.Note(2.0, note=26, channel=0), tw.Note(2.5, note=63, channel=0),
        tw.Note(3.0, note=64, channel=0), tw.Note(4.0, note=65, channel=0, technique="own"),
        tw.Note(5.0, note=66, channel=0), tw.Note(5.0, note=24, string="E2"),
    ]  # fmt: skip
    controls = [Control(2.9, "cc20", 0.5, 0), Control(4.5, "cc20", 0.49, 0)]
    played = techniques.with_techniques(tw.Score(notes, controls), KEYED)
    assert [(n.note, n.technique) for n in played.notes] == [
        (60, None), (61, "palm"), (62, None), (63, "rest"), (64, "flesh"), (65, "own"), (24, None), (66, "rest"),
    ]  # fmt: skip
    plain = tw.Score(notes, controls)
    assert techniques.with_techniques(plain, Playing()) is plain


STRING = [PlayableString("A", tuple(45.0 + i for i in range(13)))]


def marked(*marks: str, names: tuple[str, ...] = ("palm", "slide", "harmonic"), **note: Any) -> tw.Score:
    values = {"time": 0.0, "duration": 1.0, "note": 50.0, **note}
    return techniques.with_marks(tw.Score([tw.Note(marks=marks, **values)]), names, STRING)


def test_signs_become_the_techniques_that_there_are() -> None:
    assert marked("dead_note").notes[0].technique == "palm"
    assert marked("palm_mute", technique="own").notes[0].technique == "own"
    lacking = marked("tapping", "golpe", "palm_mute")
    assert lacking.notes[0].technique == "palm"
    assert lacking.ignored == {"tapping, plucked as any note": 1, "golpe, plucked as any note": 1}
    assert [marked("tablature", stop=s).notes[0].stop for s in (5, 6)] == [5, None]
    assert marked("tablature", stop=6).ignored == {"note of the tablature, fingered elsewhere": 1}
    free = [PlayableString("A", (45.0, 57.0), continuous=True)]
    kept = techniques.with_marks(tw.Score([tw.Note(0.0, note=50, stop=6, marks=("tablature",))]), (), free)
    assert (kept.notes[0].stop, kept.ignored) == (6, {})


def test_harmonics_are_touched_or_played_at_their_pitch() -> None:
    touched_ = marked("tablature", note=64.0, stop=0, partial=3).notes[0]
    assert (touched_.note, touched_.technique, touched_.partial, touched_.stop) == (45.0, "harmonic", 3, 0)
    plucked = marked("tablature", names=(), note=64.0, stop=0, partial=3)
    assert (plucked.notes[0].note, plucked.notes[0].partial, plucked.notes[0].stop) == (64.0, None, None)
    assert plucked.ignored == {"harmonic, plucked as a note of its pitch": 1}


@pytest.mark.parametrize(
    ("glides", "names", "rows"),
    [
        (((0.5, 2.0),), ("slide",), [(0.0, 0.5, 50, None), (0.5, 0.5, 52, "slide")]),
        (((0.0, -2.0), (0.2, 0.0)), ("slide",), [(0.0, 0.2, 48, None), (0.2, 0.8, 50, "slide")]),
        (((1.0, 2.0),), ("slide",), [(0.0, 0.97, 50, None), (0.97, 0.03, 52, "slide")]),
        (((0.5, 2.0),), (), [(0.0, 0.5, 50, None), (0.5, 0.5, 52, None)]),
        (((0.0, -2.0), (0.2, 0.0)), (), [(0.0, 1.0, 50, None)]),
        (((1.0, 2.0),), (), [(0.0, 1.0, 50, None)]),
        (((0.5, 0.0),), ("slide",), [(0.0, 0.5, 50, None)]),
    ],
)
def test_slides_become_notes(
    glides: tuple[tuple[float, float], ...], names: tuple[str, ...], rows: list[tuple[float, float, float, str | None]]
) -> None:
    notes = marked(names=names, glides=glides).notes
    played = [(n.time, pytest.approx(n.duration), n.note, n.technique) for n in notes]
    assert rows == played


def test_a_slide_below_the_nut_is_left_out() -> None:
    to_nut = marked(names=("slide",), glides=((0.0, -1.0), (0.2, 0.0)), stop=1, note=46.0).notes
    assert [(n.time, n.note, n.stop) for n in to_nut] == [(0.0, 45.0, 0.0), (0.2, 46.0, 1.0)]
    notes = marked(names=("slide",), glides=((0.0, -2.0), (0.2, 0.0)), stop=1, note=46.0).notes
    assert [(n.time, n.note, n.stop) for n in notes] == [(0.2, 46.0, 1.0)]


def test_a_varied_note_moves_by_its_deviates() -> None:
    variation = HumanVariation(seed=1, time=0.01, force_db=6.0)
    drawn = Deviates(force=1.0, time=-2.0, place=0.0, angle=0.0, nail=0.0)
    note = moved(assigned(1.0, 1.0, 3, force=2.0, end=1.5), drawn, variation)
    assert note.note.force == pytest.approx(2.0 * 10 ** (6 / 20))
    assert (note.note.time, note.end, note.stop) == (pytest.approx(0.98), pytest.approx(1.48), 3)
    early = moved(assigned(0.01, 1.0, end=0.5), drawn, variation)
    assert (early.note.time, early.end, early.note.force) == (0.0, pytest.approx(0.49), None)


def test_deviates_are_cut_normal_numbers_of_seed_and_index() -> None:
    drawn = np.array([list(vars(Deviates.of(seed, i)).values()) for seed in (1, 2) for i in range(400)])
    assert np.abs(drawn).max() == 2.5
    assert np.std(drawn, axis=0) == pytest.approx(np.full(5, 0.98), abs=0.08)
    assert np.abs(np.mean(drawn, axis=0)).max() < 0.15
    assert Deviates.of(1, 2) != Deviates.of(2, 1)


def test_varied_values_of_an_exciter(guitar: Model) -> None:
    """Places in multiples of 0.5 mm within 2 % to 98 % of the string; a share of nail from 0 to 1."""
    variation = HumanVariation(seed=1, from_bridge=0.01, angle_deg=5.0, nail=0.2)
    exciter = guitar.exciters["pluck"]
    parameters = exciter.parameters

    def values(deviate: float, given: dict[str, float] | None = None, length: float = 0.65) -> dict[str, float]:
        return touched(given or {}, exciter, length, Deviates(0.0, 0.0, deviate, deviate, deviate), variation)

    usual = parameters.from_bridge
    metres = usual.fraction * 0.65 if isinstance(usual, Fraction) else usual
    one = values(1.0)
    assert one["from_bridge"] == pytest.approx(round((metres + 0.01) / 5e-4) * 5e-4)
    assert one["angle_deg"] == pytest.approx(parameters.angle_deg + 5.0)
    assert one["nail"] == pytest.approx(min(parameters.nail + 0.2, 1.0))
    given = values(-1.0, {"from_bridge": 0.2, "angle_deg": 10.0, "nail": 0.5, "force": 3.0})
    assert given == pytest.approx({"from_bridge": 0.19, "angle_deg": 5.0, "nail": 0.3, "force": 3.0})
    assert values(1.0, {"from_bridge": 0.64})["from_bridge"] == pytest.approx(0.98 * 0.65)
    assert values(-1.0, {"from_bridge": 0.015, "nail": 0.1})["from_bridge"] == pytest.approx(0.02 * 0.65)
    assert values(-1.0, {"nail": 0.1})["nail"] == 0.0
    assert values(1.0, {"nail": 0.9})["nail"] == 1.0
    assert values(0.0, {"from_bridge": 0.1003})["from_bridge"] == pytest.approx(0.1005)


def test_a_timeline_knows_its_stops_bends_and_ends() -> None:
    gesture = Gesture((Segment(-0.5, 0.25, 1.0),))
    changes = [
        Change(-0.1, "a", stop=2.0),
        Change(0.1, "a", cents=30.0),
        Change(0.2, "a", stop=3.0),
        Change(0.3, "a", cents=0.0),
        Change(0.4, "a", stop=4.0),
        Change(0.5, "b", cents=10.0),
    ]
    line = Timeline(changes, [Play(0.25, gesture), Play(1.0, gesture)])
    assert line.stops == {"a": {2.0, 3.0, 4.0}}
    assert line.bent == {"a": {2.0, 3.0}, "b": {0.0}}
    assert (line.start, line.stop) == (-0.25, 1.25)
    assert (Timeline([], []).start, Timeline([], []).stop) == (0.0, 0.0)
    assert Timeline([Change(3.0, "a")], []).stop == 3.0
    play = Play(2.0, gesture)
    assert (play.start, play.stop) == (1.5, 2.25)


def test_a_fretting_changes_in_the_values_that_are_given() -> None:
    held = Fretting(1.0, 2.0, 3.0, 0.4, (("p", 0.5),), 0.6, 0.7)
    assert held.changed(Change(0.0, "a")) == held
    assert held.changed(Change(0.0, "a", 0.0, 0.0, 0.0, (), 0.0)) == Fretting(place=0.4, width=0.6)
    assert held.unplucked == replace(held, place=None, width=0.0)


def test_the_usual_place_of_a_pluck_is_none_of_its_own(guitar: Model) -> None:
    bases, string = FrettedBases(guitar), guitar.strings["E2"]
    usual, length = string.places.pluck, string.length(0)
    for place, kept in (
        (None, None),
        (usual, None),
        (usual + 1e-3, usual + 1e-3),
        (1.01 * length, None),
        (length, length),
    ):
        assert bases.playable("E2", Fretting(place=place)).place == kept
    high = string.n_stops
    short = min(usual, 0.9 * string.length(high))
    assert bases.playable("E2", Fretting(stop=high, place=short)).place is None


def test_bases_are_kept_and_the_oldest_dropped(guitar: Model) -> None:
    bases = FrettedBases(guitar)
    bases.room = len(guitar.strings) + 2
    first = bases.bases("E2", Fretting(stop=1.0))
    assert bases.bases("E2", Fretting(stop=1.0)) is first
    bases.prepare("A2", Fretting(stop=2.0))
    prepared = bases.bases("A2", Fretting(stop=2.0))
    for stop in range(3, 3 + bases.room):
        bases.bases("E2", Fretting(stop=float(stop)))
    assert len(bases._compiled) == bases.room
    assert bases.bases("A2", Fretting(stop=2.0)) is prepared
    again = bases.bases("E2", Fretting(stop=1.0))
    assert again is not first
    for component, part in again.items():
        np.testing.assert_array_equal(part.basis.poles, first[component].basis.poles)


def no_force(component: str) -> float:
    raise AssertionError(component)


def test_a_motion_goes_on_where_only_the_damping_changes(guitar: Model) -> None:
    """Displacement and velocity of every mode stay; a string at rest stays so at another stop."""
    bases, rng = FrettedBases(guitar), np.random.default_rng(1)
    free, damped = Fretting(), Fretting(added_damping=30.0)
    modes = {c: rng.standard_normal((2, p.basis.n_modes)) for c, p in bases.bases("E2", free).items()}
    after = bases.carried("E2", free, damped, modes, no_force)
    for c, values in after.items():
        q, v = to_motion(bases.bases("E2", damped)[c].basis, values)
        q0, v0 = to_motion(bases.bases("E2", free)[c].basis, modes[c])
        np.testing.assert_allclose(np.concatenate([q, v]), np.concatenate([q0, v0]), rtol=1e-9, atol=1e-9)
    rest = {c: np.zeros_like(m) for c, m in modes.items()}
    assert all(not m.any() for m in bases.carried("E2", free, Fretting(stop=5.0), rest, no_force).values())
    same = bases.carried("E2", free, free, modes, no_force)
    assert all(same[c] is modes[c] for c in modes)


@pytest.mark.parametrize(("cents", "cut"), [(0.0, False), (400.0, True)])
def test_a_bent_string_without_its_highest_modes_is_carried_as_if_these_rested(
    guitar: Model, cents: float, cut: bool
) -> None:
    """Its motion as a bend leaves fewer modes below the limit, padded by zeros, and carried by the string itself."""
    bases, string, rng = FrettedBases(guitar), guitar.strings["E2"], np.random.default_rng(2)
    before, after = Fretting(cents=cents), Fretting(stop=5.0, cents=cents)
    modes = {c: rng.standard_normal((2, p.basis.n_modes)) for c, p in bases.bases("E2", before).items()}
    carried = bases.carried("E2", before, after, modes, lambda component: 0.0)
    old, new = (string.bases(f.stop, bend_cents=cents, whole=True) for f in (before, after))
    for c, values in carried.items():
        here, there = bases.bases("E2", before)[c].basis, bases.bases("E2", after)[c].basis
        assert (here.n_modes < old[c].n_modes) is cut
        q, v = (np.pad(x, (0, old[c].n_modes - x.size)) for x in to_motion(here, modes[c]))
        q, v = string.carried(c, old[c], new[c], q, v)
        np.testing.assert_allclose(to_motion(there, values)[0], q[: there.n_modes], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(to_motion(there, values)[1], v[: there.n_modes], rtol=1e-9, atol=1e-9)


def test_a_key_holds_eight_strokes_and_releases_the_first() -> None:
    keys = HeldKeys()
    voices = [Voice(i, tw.Note(0.0, note=60)) for i in range(10)]
    assert [keys.press(v) for v in voices[:8]] == [None] * 8
    assert keys.press(voices[8]) is voices[0]
    assert keys.press(Voice(99, tw.Note(0.0, string="E2"))) is None
    keys.release(voices[0], pedal=True)
    keys.release(voices[1], pedal=True)  # the pedal holds one note a key
    assert keys.ending == [voices[0]]
    assert keys.pedalled == {(0, 60.0): voices[1]}
    assert keys.falling == [voices[0], voices[1]]
    assert (voices[1].key_down, voices[1].pedalled) == (False, True)
    keys.press(voices[9])
    assert keys.ending == [voices[0], voices[1]]
    free = Voice(100, tw.Note(0.0, string="E2"))
    keys.release(free, pedal=True)
    assert keys.ending[-1] is free


def test_the_first_voice_that_sounds_and_need_not_wait_is_due() -> None:
    keys = HeldKeys()
    waits, silent, sounds, later = (Voice(i, tw.Note(0.0), string=s) for i, s in enumerate(("E2", None, "A2", "D3")))
    voices = [waits, silent, sounds, later]
    assert keys.due(voices, lambda v: v is waits) is sounds
    assert voices == [waits, later]
    assert keys.due([], lambda v: False) is None
    counters = PlayerCounters()
    counters.latest.extend(Dropped(float(i), None, None, "") for i in range(101))
    assert (len(counters.latest), counters.latest[0].time) == (100, 1.0)


def test_a_held_gesture_leaves_its_recovery_before_the_next(guitar: Model) -> None:
    recovery = guitar.exciter("pluck", "E2").recovery
    note = assigned(0.0, 1.0, end=1.0)
    assert _duration(note, None, guitar) == 1.0
    assert _duration(note, assigned(1.2 + recovery), guitar) == 1.0
    assert _duration(note, assigned(0.8 + recovery), guitar) == pytest.approx(0.8)
    assert _duration(note, assigned(0.1), guitar) == 0.5
    assert _duration(note, assigned(0.8, technique="rest"), guitar) == 1.0


def test_a_score_is_played_with_its_counts(guitar: Model) -> None:
    notes = [
        tw.Note(0.0, 1.0, note=40, force=1.0, channel=0), tw.Note(0.5, 1.0, string="E2", stop=1, force=1.0, channel=0),
        tw.Note(0.5, 1.0, note=64, force=1.0, channel=1), tw.Note(0.5, 0.5, note=64, force=1.0, channel=2),
        tw.Note(1.0, 1.0, note=20, force=1.0),
    ]  # fmt: skip
    controls = [
        Control(0.0, "cc7", 1.0),
        Control(0.0, "cc30", 1.0),
        Control(0.1, "cc30", 0.0),
        Control(0.0, "cc66", 1.0),
    ]
    played = perform(tw.Score(notes, controls, ignored={"x": 2}, warnings=["w"]), guitar)
    assert played.ignored == {"x": 2, "controller 30": 2, "controller 66": 1}
    assert played.warnings == [
        "w", "1 notes end early: their string is needed again", "1 notes share another voice's pluck of the same pitch",
    ]  # fmt: skip
    assert [(a.string, a.stop, a.end) for a in played.notes] == [("E2", 0, 0.5), ("E2", 1, 1.5), ("E4", 0, 1.5)]
    assert [d.note for d in played.dropped] == [20]
    assert {play.exciter for play in played.timeline.plays} >= {guitar.default_exciter}
    assert "" not in {play.exciter for play in played.timeline.plays}
    starts = [play.start for play in played.timeline.plays]
    times = [change.time for change in played.timeline.changes]
    assert (starts, times) == (sorted(starts), sorted(times))


def test_paced_hands_bend_the_farthest_string_first(guitar: Model) -> None:
    """By 40 000 cents a second in the time between two of them, 2 x spacing points of the grid, and no farther."""
    hands = PacedHands(guitar, 5e-3, 2, 0)
    for name, wanted in (("E2", 100.0), ("A2", -900.0)):
        string = hands.strings[name]
        string.voice, string.target = Voice(0, tw.Note(0.0)), wanted
    step = 40e3 * 4 * TICK
    assert step > 900.0
    fine = PacedHands(assemble(guitar.instrument, 96000, freq_limit=1000), 5e-3, 2, 0)
    string = fine.strings["A2"]
    string.voice, string.target = Voice(0, tw.Note(0.0)), -900.0
    order = []
    for one in (hands, hands, hands, fine, fine):
        before = len(one.changes)
        one.bend_one()
        order += [(c.string, c.cents) for c in one.changes[before:]]
    small = 40e3 * 4 * GRID / 96000
    assert order == [
        ("A2", -900.0), ("E2", 100.0), ("A2", pytest.approx(-small)), ("A2", pytest.approx(-2 * small)),
    ]  # fmt: skip


def test_levels_of_the_dashpot_are_thirds() -> None:
    """sin of a third of an angle solves the cubic: s = 1/2 - sin(asin(1 - 2 y) / 3)."""
    assert [3 * s**2 - 2 * s**3 for s in _RISE] == pytest.approx([1 / 6, 1 / 2, 5 / 6])
    assert all(a < b for a, b in itertools.pairwise(_RISE))


def test_a_bow_that_is_held_goes_on_for_a_quarter_of_a_second_ahead() -> None:
    """When half of that is left it is continued; it ends where the key comes up."""
    model = assemble(tw.load_instrument("bowed_monochord"), FS, freq_limit=1000)
    player, rows = Player(model), []
    (name,) = model.strings
    for point in range(int(1.0 / TICK)):
        decided = player.feed([tw.Note(0.0, 0.8, string=name)] if point == 0 else [], 0.0, point * GRID)
        rows += [(point * TICK, play.stop - play.time, play.time) for play in decided.plays]
    (first, shortest, begun), *later, (_, _, _) = rows
    after = shortest - CONTINUED  # of the gesture, beyond the note
    for before, now in itertools.pairwise([begun, *(row[0] for row in later)]):
        assert now - before == pytest.approx(CONTINUED / 2, abs=1.01 * TICK)
    for now, length, time in later:
        assert (time, length - after) == (begun, pytest.approx(now + CONTINUED - begun))
    assert len(later) in (5, 6)
    assert rows[-1][0] == pytest.approx(0.8, abs=2 * TICK)
    assert rows[-1][1] - after == pytest.approx(rows[-1][0] - begun)
    assert first == 0.0


def test_a_slide_that_comes_live_is_heard_at_the_points_before_its_stops() -> None:
    """Every change of the stop at the last point of the grid before its time, or as soon as it can: one at a point."""
    model = assemble(tw.load_instrument("electric_bass"), FS, freq_limit=600)
    player, changes, plays = Player(model), [], []
    notes = {0: tw.Note(0.0, 9.0, string="E1", stop=2), 100: tw.Note(0.0, 9.0, string="E1", stop=9, technique="slide")}
    for point in range(200):
        decided = player.feed([replace(notes[point], time=point * TICK)] if point in notes else [], 0.0, point * GRID)
        changes += [c for c in decided.changes if c.stop is not None and c.string == "E1"]
        plays += decided.plays
        if point == 100:
            planned = list(player.hands.strings["E1"].later)
    slide = next(play for play in plays if play.exciter == "slide")
    course = techniques.stop_course(slide, 9.0, False, TICK)
    moved = [c for c in changes if c.time >= 99 * TICK]
    assert len(course) > 4
    assert [c.stop for c in moved] == [stop for _, stop in course]
    last = moved[0].time
    for change, (time, _) in zip(moved[1:], course[1:], strict=True):
        last = max(math.floor(time / TICK + 1e-6) * TICK, last + TICK)
        assert change.time == pytest.approx(last, abs=1e-9)
    due = [math.floor(time / TICK + 1e-6) * GRID for time, _ in course[1:]]
    assert [sample for sample, _ in planned] == due


def test_keys_struck_by_hand_are_due_at_once_and_released_in_their_order(guitar: Model) -> None:
    player = Player(guitar)
    note = tw.Note(0.0, 1.0, note=52, channel=3, force=1.0)
    first, second = player.note_on(note), player.note_on(note, time=0.5)
    assert first is not None
    assert second is not None
    assert (first.time, second.time) == (-math.inf, 0.5)
    assert list(player.waiting) == [first, second]
    assert (first.key_down, second.key_down) == (True, True)
    assert not player.note_off(52)  # another channel's
    assert player.note_off(52, 3)
    assert (first.key_down, second.key_down) == (False, True)
    assert player.note_off(52, 3)
    assert not player.note_off(52, 3)
    assert not second.key_down
