"""An instrument played live: causal, the same in every block size, bounded, and nothing lost without a count."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import ScoreError, TonewoodError
from tonewood.performance.engine.engine import GRID
from tonewood.performance.player import voices
from tonewood.performance.player.fretting import FrettedBases
from tonewood.sound.live.prepared import PreparedBases


def played(instrument: tw.Instrument, events: dict[int, Any], frames: int, block: int, **options: Any) -> np.ndarray:
    """Sound with events, frame -> function called with the instrument, in blocks that end where an event comes."""
    live = tw.Live(instrument, prepare=False, **options)
    out, due = [], sorted(events)
    while live.frames < frames:
        while due and due[0] <= live.frames:
            events[due.pop(0)](live)
        until = min(due[0] if due else frames, live.frames + block, frames)
        out.append(live.process(until - live.frames))
    return np.concatenate(out)


def dominant(sound: np.ndarray, fs: float, low: float, high: float) -> float:
    """Frequency (Hz) of the largest line of the spectrum between two frequencies, interpolated."""
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 8 * len(sound)))
    freq = np.fft.rfftfreq(8 * len(sound), 1 / fs)
    among = np.flatnonzero((freq > low) & (freq < high))
    return float(freq[among[np.argmax(spectrum[among])]])


def test_stops_are_compiled_before_the_first_note_unless_told_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[PreparedBases] = []
    monkeypatch.setattr(PreparedBases, "prepare", lambda self: made.append(self))
    tw.Live("monochord", 8000, prepare=False)
    assert made == []
    tw.Live("monochord", 8000)
    assert len(made) == 1


def test_each_stop_is_compiled_as_it_is_plucked_and_as_it_is_damped(monkeypatch: pytest.MonkeyPatch) -> None:
    """25 of the monochord's string."""
    ways: list[tuple[str, float]] = []
    monkeypatch.setattr(FrettedBases, "prepare", lambda self, name, way: ways.append((name, way.added_damping)))
    tw.Live("monochord", 8000)
    assert [name for name, _ in ways] == 50 * ["A2"]
    assert {damping for _, damping in ways[::2]} == {0.0}
    assert min(damping for _, damping in ways[1::2]) > 0.0


def test_ways_to_pluck_at_another_place_are_compiled_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """All stops from the capo on, when the controller of the place moves; the newest place alone."""
    done: list[tuple[str, int, Any]] = []
    monkeypatch.setattr(PreparedBases, "_compile", lambda self, *way: done.append(way))
    places = {"cc74": SimpleNamespace(parameter="pluck.from_bridge", value=lambda x: 0.1 + x / 10)}
    places["cc1"] = SimpleNamespace(parameter="pluck.force", value=lambda x: x)
    strings = {"A": SimpleNamespace(n_stops=3), "B": SimpleNamespace(n_stops=2)}
    playing = SimpleNamespace(controls=places)
    model: Any = SimpleNamespace(strings=strings, playing=playing, default_exciter="pluck")
    bases = PreparedBases(model, SimpleNamespace(room=3), 2)  # type: ignore[arg-type]
    for kind in ("cc1", "cc2"):
        bases.moved(kind, 0.5)
    assert (bases.waiting, bases.compile_one(), done) == (False, False, [])
    bases.moved("cc74", 0.5)
    assert (bases.waiting, bases.compile_one()) == (True, True)
    bases.moved("cc74", 1.0)
    assert [bases.compile_one() for _ in range(4)] == [True, True, True, False]
    values = [(name, stop, pytest.approx(way["from_bridge"], abs=1e-3)) for name, stop, way in done]
    assert values == [("A", 2, 0.15), ("A", 2, 0.2), ("A", 3, 0.2), ("B", 2, 0.2)]
    assert not bases.waiting


def test_limits_of_ramp_and_spacing_are_allowed_themselves() -> None:
    for ramp, spacing in ((1e-3, 0), (0.1, 64)):
        live = tw.Live("monochord", 16000, prepare=False, ramp=ramp, spacing=spacing)
        assert live.ramp == ramp
    for options in ({"ramp": 0.99e-3}, {"ramp": 0.101}, {"spacing": 65}, {"spacing": -1}):
        with pytest.raises(TonewoodError, match="are allowed"):
            tw.Live("monochord", 16000, prepare=False, **options)


def test_the_samples_do_not_depend_on_the_blocks(guitar: tw.Instrument) -> None:
    events = {
        100: lambda live: (live.note_on("E2", 100), live.note_on("B3", 60), live.note_on("G3", 70)),
        3001: lambda live: live.bend(80.0, 0),
        4096: lambda live: (live.control(64, 1.0), live.note_off("B3"), live.note_on(71, 90, channel=1)),
        9000: lambda live: (live.control(64, 0.0), live.all_off(1)),
    }
    first = played(guitar, events, 12000, 64)
    assert np.abs(first).max() > 1e-3
    for block in (128, 1000, 12000):
        assert np.array_equal(played(guitar, events, 12000, block), first)


@pytest.mark.parametrize("accuracy", ["standard", pytest.param("draft", marks=pytest.mark.validate)])
def test_an_event_changes_nothing_before_it_and_something_soon_after(guitar: tw.Instrument, accuracy: str) -> None:
    before = {0: lambda live: live.note_on("A2", 100)}
    after = before | {5000: lambda live: live.note_on("E4", 127)}
    options: dict[str, Any] = {"accuracy": accuracy, "ramp": 2e-3}
    alone, both = (played(guitar, events, 7000, 128, **options) for events in (before, after))
    assert np.array_equal(alone[:5000], both[:5000])
    live = tw.Live(guitar, prepare=False, **options)
    # sound of the pluck itself, after the ramp: the finger's touch is some 40 dB below it
    loud = np.flatnonzero(np.abs(both - alone).max(axis=1) > 0.1 * np.abs(both - alone).max())[0]
    assert 5000 < loud < 5000 + live.latency * live.fs + 0.003 * live.fs


@pytest.mark.parametrize(("ramp", "tolerance_db"), [pytest.param(20e-3, 0.05, marks=pytest.mark.validate), (5e-3, 1.0)])
def test_a_live_note_is_a_rendered_note(guitar: tw.Instrument, ramp: float, tolerance_db: float) -> None:
    """The same string, stop and force; a ramp shorter than the period adds motion of its own."""
    live = played(guitar, {0: lambda live: live.note_on("A2", force=2.0)}, 48000, 512, ramp=ramp)
    score = tw.Score([tw.Note(0.0, 2.0, note="A2", force=2.0)])
    wanted = tw.render(score, guitar, max_duration=1.0).samples
    late = round(ramp * 48000)
    a, b = live[4800 + late :, 0], wanted[4800 : len(live) - late, 0]
    assert 20 * np.log10(np.std(a) / np.std(b)) == pytest.approx(0.0, abs=tolerance_db)
    for low, high in ((90, 130), (200, 240)):
        assert dominant(a, 48000, low, high) == pytest.approx(dominant(b, 48000, low, high), rel=2e-4)


def test_a_bend_moves_the_pitch_by_its_cents(monochord: tw.Instrument) -> None:
    straight = played(monochord, {0: lambda live: live.note_on("A2")}, 48000, 512)
    bent = played(monochord, {0: lambda live: live.note_on("A2"), 4800: lambda live: live.bend(100.0)}, 48000, 512)
    a, b = (dominant(x[12000:, 0], 48000, 90, 130) for x in (straight, bent))
    assert 1200 * np.log2(b / a) == pytest.approx(100.0, abs=2.0)


def test_a_released_note_is_damped_and_the_pedal_holds_it(guitar: tw.Instrument) -> None:
    def level(*events: Any) -> float:
        sound = played(guitar, dict([(0, lambda live: live.note_on("A2", 100)), *events]), 33600, 512)
        return float(20 * np.log10(np.std(sound[-4800:])))

    ringing, damped = level(), level((9600, lambda live: live.note_off("A2")))
    # the other strings ring on: as loud as in a render of the same note
    late = 240
    score = tw.Score([tw.Note(0.0, (9600 - late) / 48000, note="A2", velocity_midi=100)])
    rendered = tw.render(score, guitar, max_duration=1.0).samples[33600 - late - 4800 : 33600 - late]
    assert damped == pytest.approx(20 * np.log10(np.std(rendered)), abs=1.0)
    assert damped < ringing - 10.0
    pedal = (4800, lambda live: live.control(64, 1.0)), (9600, lambda live: live.note_off("A2"))
    assert level(*pedal) == pytest.approx(ringing, abs=0.1)
    assert level(*pedal, (9700, lambda live: live.control(64, 0.0))) == pytest.approx(damped, abs=1.0)


def test_notes_that_come_together_are_strummed_one_after_the_other(guitar: tw.Instrument) -> None:
    live = tw.Live(guitar, prepare=False, spacing=3)
    for note in (40, 47, 52, 56, 59, 64):
        live.note_on(note)
    live.process(4800)
    began = sorted(line.voice.began for line in live.player.hands.strings.values() if line.voice)
    assert np.diff(began).tolist() == [3 * GRID] * 5
    assert live.summary().notes == 6


def test_a_seventh_note_ends_one_that_has_its_pitch_in_reach(guitar: tw.Instrument) -> None:
    live = tw.Live(guitar, prepare=False)
    for note in (40, 47, 52, 56, 59, 64):
        live.note_on(note)
        live.process(1024)
    live.note_on(67)
    live.process(1024)
    assert (live.summary().notes, live.summary().cut, live.player.n_sounding) == (7, 1, 6)


def test_repeated_pitches_stay_on_their_string(guitar: tw.Instrument) -> None:
    live = tw.Live(guitar, prepare=False)
    places = set()
    for _ in range(4):
        voice = live.note_on("C4")
        live.process(2048)
        places.add(voice.string)
        live.note_off("C4")
        live.process(2048)
    assert len(places) == 1
    assert live.summary().cut == 0


def test_notes_that_cannot_be_played_are_counted_with_reasons(guitar: tw.Instrument) -> None:
    live = tw.Live(guitar, prepare=False)
    assert live.note_on("C0") is not None
    live.note_on(64)
    live.process(512)
    summary = live.summary()
    assert (summary.notes, sum(summary.dropped.values())) == (1, 1)
    assert "no string plays C0" in summary.latest_dropped[0].reason
    live.control(1, 0.5)
    live.pressure(0.5)
    live.pressure(0.5, note=64)
    assert live.summary().ignored == {"controller 1": 1, "channel pressure": 1, "polyphonic pressure": 1}


def test_a_bow_lasts_as_long_as_its_key_is_down() -> None:
    bowed = tw.load_instrument("bowed_monochord")
    on = {0: lambda live: live.note_on("A3", 90)}
    held = played(bowed, on, 96000, 512)
    short = played(bowed, on | {24000: lambda live: live.note_off("A3")}, 96000, 512)
    assert np.array_equal(held[:24000], short[:24000])
    steady = [np.std(held[n : n + 12000]) for n in (24000, 48000, 84000)]
    assert max(steady) < 1.5 * min(steady)
    assert np.std(short[-12000:]) < 0.1 * steady[-1]


def test_techniques_by_keyswitch_name_and_on_the_body(guitar: tw.Instrument) -> None:
    bass = tw.load_instrument("electric_bass").replace({"playing.keyswitches": {"C0": "palm"}})
    live = tw.Live(bass, prepare=False)
    assert live.note_on("C0") is None
    voice = live.note_on("A2")
    assert voice is not None
    assert voice.note.technique == "palm"
    live.process(256)
    tapped = tw.Live(guitar, prepare=False)
    tapped.note_on(60, technique="tap")
    assert np.abs(tapped.process(2048)).max() > 1e-4
    with pytest.raises(ScoreError, match="no technique 'palms'; did you mean"):
        live.note_on("A2", technique="palms")


def test_the_peak_is_the_largest_of_both_signs(monochord: tw.Instrument) -> None:
    """Also of a first block whose samples are all of one sign, or whose largest is negative."""
    live, largest = tw.Live(monochord, prepare=False), 0.0
    signs = set()
    live.note_on(45, 127)
    for _ in range(60):
        block = live.process(16)
        largest = max(largest, float(np.abs(block).max()))
        signs.add(block.max() < -block.min())
        if largest > 0:
            assert live.summary().peak_dbfs == pytest.approx(20 * np.log10(largest))
    assert signs == {True, False}


@pytest.mark.slow
def test_nothing_grows_with_time(monochord: tw.Instrument) -> None:
    """Lists and tables of the engine after 120 notes, and after twice as many."""
    live = tw.Live(monochord, fs=8000, accuracy="draft")
    rng = np.random.default_rng(0)

    def sizes() -> dict[str, int]:
        engine, player = live.engine, live.player
        lists = {
            "active": engine.gestures.active, "injections": engine.gestures.injections,
            "controls": engine.gestures.controls,
            "changes": engine.schedule._changes._entries, "plays": engine.schedule._plays._entries,
            "due": next(iter(engine.schedule._due.values())),
            "bases": engine.fingerboard._compiled, "held": player.keys.held, "waiting": player.waiting,
            "ending": player.keys.ending, "latest": player.counters.latest,
        }  # fmt: skip
        return {name: len(value) for name, value in lists.items()} | {
            "spans": sum(len(s.all) for s in engine.usage.spans.values()),
            "pending": len(live._pending),
        }

    largest = dict.fromkeys(sizes(), 0)
    for turn in range(2):
        for _ in range(120):
            note = float(rng.integers(45, 60))
            live.note_on(note, float(rng.integers(1, 128)))
            live.bend(float(rng.integers(-50, 50)))
            live.process(500)
            live.note_off(note)
            live.process(500)
        now = sizes()
        if turn == 0:
            largest = {name: max(2 * size, 200) for name, size in now.items()} | {
                "changes": 2100,
                "plays": 2100,
                "due": 2100,
                "bases": live.engine.fingerboard.room,
            }
        assert {name: (now[name], most) for name, most in largest.items() if now[name] > most} == {}


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"ramp": 1.0}, "ramp: is 1.0 s; 0.001 to 0.1 s"),
        ({"spacing": -1}, "spacing: is -1; 0 to 64"),
        ({"tail": 3.0}, "tail: is for scores that are known before"),
    ],
)
def test_wrong_options_are_one_line(monochord: tw.Instrument, options: dict[str, Any], line: str) -> None:
    with pytest.raises(TonewoodError, match=line):
        tw.Live(monochord, prepare=False, **options)


def test_wrong_events_are_one_line(monochord: tw.Instrument) -> None:
    live = tw.Live(monochord, prepare=False)
    for call in (
        lambda: live.note_on(400), lambda: live.control(64, 2.0), lambda: live.control(128, 0.0),
        lambda: live.bend(1e6), lambda: live.pressure(-1.0), lambda: live.process(0), lambda: live.note_on("H9"),
        lambda: live.process(1.5), lambda: live.process(None), lambda: live.process(float("nan")),
    ):  # fmt: skip
        with pytest.raises(TonewoodError):
            call()
    assert not live.process(256).any()


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda live: live.bend("1"), "a bend of '1' cents"),
        (lambda live: live.bend(None), "a bend of None cents"),
        (lambda live: live.bend(10.0, 16), "channel 16: 0 to 15 are allowed"),
        (lambda live: live.control(64, None), "controller 64 at None"),
        (lambda live: live.control(64.0, 1.0), "controller 64.0 at 1.0"),
        (lambda live: live.control(True, 1.0), "controller True at 1.0"),
        (lambda live: live.all_off(99), "channel 99: 0 to 15 are allowed"),
        (lambda live: live.release_keys("all"), "channel 'all': 0 to 15 are allowed"),
        (lambda live: live.control(64, 1.0, -1), "channel -1"),
        (lambda live: live.control(64, 1.0, 1.5), "channel 1.5"),
        (lambda live: live.pressure(None), "pressure of None"),
        (lambda live: live.pressure(True), "pressure of True"),
        (lambda live: live.note_off("A2", 10**30), "channel 1000"),
        (lambda live: live.release(object()), "a voice that note_on of this instrument returned"),
    ],
)
def test_events_of_other_types_are_one_line(monochord: tw.Instrument, call: Any, line: str) -> None:
    with pytest.raises(TonewoodError, match=re.escape(line)):
        call(tw.Live(monochord, prepare=False))


def test_nothing_grows_with_the_notes_of_a_session(monochord: tw.Instrument, monkeypatch: pytest.MonkeyPatch) -> None:
    """Notes under the pedal whose string another one took are forgotten; reasons of dropped notes are counted."""
    monkeypatch.setattr(voices, "_REASONS", 2)
    live = tw.Live(monochord, 8000, prepare=False)
    live.control(64, 1.0)
    for k in range(4):
        live.note_on(50 + k / 10)
        live.process(800)
        live.note_off(50 + k / 10)
    assert len(live.player.keys.pedalled) == 1
    for k in range(5):
        live.note_on("A2", force=2000.0 + k)
        live.process(800)
    dropped = live.summary().dropped
    assert (len(dropped), dropped["other reasons"], sum(dropped.values())) == (3, 3, 5)


def test_a_voice_of_another_instrument_is_not_released(monochord: tw.Instrument) -> None:
    lives = [tw.Live(monochord, prepare=False) for _ in range(2)]
    voices = [live.note_on("A2") for live in lives]
    assert voices[0] is not None
    with pytest.raises(TonewoodError, match="of this instrument"):
        lives[1].release(voices[0])
    assert voices[0].key_down
    lives[0].release(voices[0])
    assert not voices[0].key_down
    lives[0].release(voices[0])  # again: nothing happens


def test_a_capo_holds_every_string() -> None:
    """E2 is gone, F#2 at stop 2 is the lowest; the string rings on at the capo when its note ends."""
    live = tw.Live("classical_guitar", 24000, capo=2, prepare=False)
    assert live.note_on("E2") is not None
    low = live.note_on("F#2")
    live.process(2400)
    assert live.summary().notes == 1
    assert any("E2" in reason for reason in live.summary().dropped)
    assert low is not None
    assert (low.string, low.assigned.stop) == ("E2", 2.0)
    high = live.note_on(string="A2", stop=5)
    live.process(2400)
    assert (high.string, high.assigned.stop) == ("A2", 5.0)
    live.release(high)
    live.process(12000)
    assert live.engine.frettings["A2"].stop == 2.0


def test_a_capo_sounds_as_in_a_score() -> None:
    """A note on a string at the capo has the pitch of that in a render with the same capo: C3, 130.8 Hz."""
    live = tw.Live("monochord", 24000, capo=3, prepare=False, effects="none")
    live.note_on(string="A2", stop=3, velocity=80)
    sound = live.process(24000)[4800:, 0]
    score = tw.Score([tw.Note(0.05, 1.0, string="A2", stop=3, velocity_midi=80)])
    wanted = tw.render(score, "monochord", 24000, capo=3, effects="none", max_duration=1.05).samples[6000:, 0]
    found, expected = (dominant(x[:18000], 24000, 120.0, 145.0) for x in (sound, wanted))
    assert found == pytest.approx(expected, rel=2e-4)
    assert found == pytest.approx(130.81, rel=2e-3)


def test_pressure_moves_what_a_bundle_maps_it_to() -> None:
    """Live and in a score: the place of the pluck follows the pressure before the note, and nothing is ignored."""
    mapped = {"playing.controls.channel_pressure": {"parameter": "pluck.from_bridge", "low": 0.03, "high": 0.25}}
    guitar = tw.load_instrument("classical_guitar").replace(mapped)
    plays = []
    for value in (0.0, 1.0):
        live = tw.Live(guitar, 24000, prepare=False)
        live.pressure(value)
        voice = live.note_on("E3")
        live.process(480)
        assert live.summary().ignored == {}
        plays.append(voice.play.gesture.from_bridge)
    assert plays == pytest.approx([0.03, 0.25], abs=3e-3)
    controls = [tw.Control(0.0, "channel_pressure", 1.0, 0)]
    score = tw.Score([tw.Note(0.1, 0.2, "E3", channel=0)], controls)
    renderer = tw.Renderer(score, guitar, 24000)
    assert renderer.performance.timeline.plays[0].gesture.from_bridge == pytest.approx(0.25, abs=3e-3)
    assert not renderer.performance.ignored
