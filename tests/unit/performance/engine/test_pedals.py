"""Keys and pedals: when dampers rise and fall, and the effect on the strings."""

from __future__ import annotations

import math
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
import tonewood.authoring as ta
from midi_bytes import control, note, off, on, write
from pianos import piano
from tonewood.instrument.model.assembly import Model
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.dampers import Dampers, on_grid, pressed_farthest
from tonewood.performance.player.playing import perform
from tonewood.support.units import decibel

FS = 24000


@pytest.fixture(scope="module")
def grand(tmp_path_factory: pytest.TempPathFactory) -> tw.Instrument:
    """Three keys an octave apart, the last without a damper, and one apart from them."""
    return piano(tmp_path_factory.mktemp("keys"), ["C3", "C4", "F#4", "C5", "C7"])


@pytest.fixture(scope="module")
def model(grand: tw.Instrument) -> Model:
    return ta.assemble(grand, FS)


def courses(model: Model, notes: list[tw.Note], controls: list[tw.Control]) -> dict[str, list[tuple]]:
    """String -> (time, share of its damper's loss) in the timeline of a score."""
    found = perform(tw.Score(notes, controls), model)
    out: dict[str, list[tuple]] = defaultdict(list)
    for change in found.timeline.changes:
        if change.damper is not None:
            out[change.string].append((round(change.time, 3), change.damper))
    return out


def course(model: Model, steps: list[tuple[float, Any]], string: str = "C4_1") -> list[tuple[float, float]]:
    """Share of a damper's loss over time; steps are (time, key that goes down or comes up, or controller)."""
    dampers, out = Dampers(model), []
    for time, step in steps:
        if isinstance(step, tw.Control):
            dampers.control(step.kind, step.value, step.channel)
        else:
            (dampers.press if step > 0 else dampers.release)("C4_1")
        out += [(c.time, c.damper) for c in dampers.moved(time) if c.string == string]
    return out


def pedal(kind: str, value: float, channel: int | None = None) -> tw.Control:
    return tw.Control(0.0, kind, value, channel)


def test_course_of_a_damper(model: Model) -> None:
    down, up = 1, -1
    assert course(model, [(1.0, down), (2.0, up)]) == [(1.0, 0.0), (2.0, 1.0)]
    half, none = pedal("cc64", 0.5), pedal("cc64", 0.0)
    pedalled = course(model, [(1.0, down), (1.5, half), (2.0, up), (3.0, none)])
    assert pedalled == [(1.0, 0.0), (2.0, 0.25), (3.0, 1.0)]
    assert course(model, [(0.0, pedal("cc64", 1.0)), (1.0, down), (2.0, up)]) == [(0.0, 0.0)]
    assert course(model, [(1.0, pedal("cc64", 1.0)), (2.0, none)], "C7_1") == []


def test_sostenuto_holds_what_is_down_when_it_is_pressed(model: Model) -> None:
    middle, off = pedal("cc66", 1.0), pedal("cc66", 0.0)
    assert course(model, [(1.0, 1), (1.5, middle), (2.0, -1), (5.0, off)]) == [(1.0, 0.0), (5.0, 1.0)]
    # a key that is down while the pedal holds its damper, and longer
    assert course(model, [(1.0, 1), (1.5, middle), (4.0, off), (5.0, -1)]) == [(1.0, 0.0), (5.0, 1.0)]
    # a key struck later, and one released before
    assert course(model, [(1.5, middle), (2.5, 1), (3.0, -1)]) == [(2.5, 0.0), (3.0, 1.0)]
    assert course(model, [(0.0, 1), (0.9, -1), (1.5, middle)]) == [(0.0, 0.0), (0.9, 1.0)]


def test_the_pedal_pressed_farthest_counts(model: Model) -> None:
    steps = [(0.0, pedal("cc64", 0.5, 0)), (1.0, pedal("cc64", 1.0, 1)), (2.0, pedal("cc64", 0.0, 1))]
    assert course(model, steps) == [(0.0, 0.25), (1.0, 0.0), (2.0, 0.25)]
    controls = [tw.Control(0.0, "cc64", 0.5, 0), tw.Control(1.0, "cc64", 1.0, 1), tw.Control(2.0, "cc64", 0.0, 1)]
    assert pressed_farthest(controls, "cc64") == [(0.0, 0.5), (1.0, 1.0), (2.0, 0.5)]


def test_a_note_struck_again_while_its_hammer_is_on_its_way_keeps_the_damper_up(model: Model) -> None:
    notes = [tw.Note(0.1, 0.01, note=60), tw.Note(0.102, 0.5, note=60)]
    assert [damper for _, damper in courses(model, notes, [])["C4_1"]] == [0.0, 1.0]


def test_a_key_lifts_the_dampers_of_its_strings(model: Model) -> None:
    found = courses(model, [tw.Note(0.1, 0.5, note=60)], [])
    assert set(found) == {"C4_1", "C4_2", "C4_3"}
    (up, lifted), (down, fallen) = found["C4_2"]
    assert lifted == 0.0
    assert fallen == 1.0
    # before the hammer comes, and when the key is released
    assert 0.08 < up < 0.1
    assert down == 0.6


def test_pedals_in_a_score(model: Model) -> None:
    notes = [tw.Note(0.1, 0.2, note=60), tw.Note(0.5, 0.2, note=72)]
    found = courses(model, notes, [tw.Control(0.2, "cc66", 1.0), tw.Control(1.0, "cc66", 0.0)])
    assert found["C4_1"][-1] == (1.0, 1.0)
    assert found["C5_1"][-1] == (0.7, 1.0)
    found = courses(model, notes, [tw.Control(0.2, "cc64", 1.0), tw.Control(1.0, "cc64", 0.0)])
    assert found["C4_1"][-1] == found["C3_1"][-1] == (1.0, 1.0)
    assert found["C3_1"] == [(0.2, 0.0), (1.0, 1.0)]
    half = courses(model, notes, [tw.Control(0.2, "cc64", 0.5)])["C3_1"]
    assert half == [(0.2, 0.25)]
    assert "C7_1" not in found


def test_midi_keeps_when_the_key_was_released(tmp_path: Path) -> None:
    events = [control(0.0, 64, 127), on(0.0, 60), off(0.5, 60), control(2.0, 64, 0)]
    (found,) = tw.read_midi(write(tmp_path / "pedal.mid", events)).notes
    assert found.duration == pytest.approx(2.0)
    assert found.held == pytest.approx(0.5)
    tw.write_midi(tw.read_midi(tmp_path / "pedal.mid"), tmp_path / "again.mid")
    again = tw.read_midi(tmp_path / "again.mid")
    assert again.notes[0].held == pytest.approx(0.5, abs=1e-3)
    assert again.notes[0].duration == pytest.approx(2.0, abs=1e-3)
    faster = tw.read_score(tmp_path / "pedal.mid", tempo=2.0, stop=0.75).notes[0]
    assert (faster.duration, faster.held) == (pytest.approx(0.375), pytest.approx(0.25))


def test_the_pedal_goes_up_with_the_track(tmp_path: Path) -> None:
    events = [control(0.0, 64, 127), *note(0.0, 0.5, 60)]
    score = tw.read_midi(write(tmp_path / "open.mid", events))
    assert [(c.kind, c.value) for c in score.controls] == [("cc64", 1.0), ("cc64", 0.0)]


def level(sound: np.ndarray, start: float, stop: float) -> float:
    return decibel(float(np.sqrt(np.mean(sound[int(start * FS) : int(stop * FS)] ** 2))))


def rendered(grand: tw.Instrument, notes: list[tw.Note], *controls: tw.Control, to: float = 1.2) -> np.ndarray:
    return tw.render(tw.Score(notes, controls), grand, fs=FS, max_duration=to).samples[:, 0]


def test_strings_that_are_not_played_hear_the_pedal(model: Model) -> None:
    """With the pedal C3 and C5 go on with partials of C4; F#4 without a common partial has nothing to go on with."""
    note, down = [tw.Note(0.05, 0.3, note=60, velocity_midi=100)], tw.Control(0.0, "cc64", 1.0)

    def energies(*controls: tw.Control) -> dict[str, float]:
        engine = Engine(model, perform(tw.Score(note, controls), model).timeline)
        engine.advance(int(0.8 * FS / 64))
        system, state = engine.system, engine.state
        return {
            name: float(np.sum(np.abs(system.modes_of(state, f"{name}.z")) ** 2)) for name in ("C3_1", "C5_1", "Fs4_1")
        }

    with_pedal, without = energies(down), energies()
    assert with_pedal["C5_1"] > 30 * without["C5_1"]
    assert with_pedal["C3_1"] > 30 * without["C3_1"]
    assert with_pedal["C5_1"] > 30 * with_pedal["Fs4_1"]


def test_sustain_half_pedal_and_none(grand: tw.Instrument) -> None:
    note = [tw.Note(0.05, 0.2, note=60, velocity_midi=90)]
    levels = [level(rendered(grand, note, tw.Control(0.0, "cc64", position)), 0.9, 1.2) for position in (0.0, 0.5, 1.0)]
    assert levels[2] - levels[1] > 3.0
    assert levels[1] - levels[0] > 10.0


def test_the_upper_keys_have_no_dampers(grand: tw.Instrument) -> None:
    note = [tw.Note(0.05, 0.05, note=96, velocity_midi=90)]
    assert np.array_equal(
        rendered(grand, note, to=0.6), rendered(grand, [tw.Note(0.05, 0.5, note=96, velocity_midi=90)], to=0.6)
    )


def test_no_click_when_a_damper_falls_or_rises(grand: tw.Instrument) -> None:
    """The second difference of the sound hears a step of its slope, and has nothing but partials."""
    note = [tw.Note(0.05, 0.4, note=60, velocity_midi=90)]
    short = rendered(grand, note, to=0.8)
    longer = rendered(grand, [tw.Note(0.05, 0.7, note=60, velocity_midi=90)], to=0.8)
    until = int(0.45 * FS) - 128
    assert np.array_equal(short[:until], longer[:until])
    sharp = np.abs(np.diff(short, 2))
    at, before = slice(int(0.45 * FS) - 64, int(0.46 * FS)), slice(int(0.40 * FS), int(0.44 * FS))
    assert sharp[at].max() < 1.02 * sharp[before].max()
    # rising under the pedal, while the string still sounds under its damper
    lifted = rendered(grand, note, tw.Control(0.55, "cc64", 1.0), to=0.8)
    sharp = np.abs(np.diff(lifted, 2))
    at, before = slice(int(0.55 * FS) - 64, int(0.57 * FS)), slice(int(0.51 * FS), int(0.54 * FS))
    assert sharp[at].max() < 1.02 * sharp[before].max()


def test_una_corda_meets_fewer_strings(model: Model) -> None:
    """Two strings of three are struck, at half the felt's force: softer, and the third sounds by the bridge alone."""
    note, soft = [tw.Note(0.05, 0.5, note=60, velocity_midi=90)], tw.Control(0.0, "cc67", 1.0)
    found = {}
    for name, controls in (("all", ()), ("two", (soft,))):
        engine = Engine(model, perform(tw.Score(note, controls), model).timeline)
        # 5 ms after the blow
        engine.advance(math.ceil((0.055 - engine.state.sample / FS) * FS / 64))
        modes = [engine.system.modes_of(engine.state, f"C4_{i}.z") for i in (1, 2, 3)]
        found[name] = [float(np.sum(np.abs(m) ** 2)) for m in modes]
    assert found["all"][2] == pytest.approx(found["all"][0], rel=0.05)
    assert found["two"][1] == pytest.approx(found["two"][0], rel=0.05)
    assert found["two"][2] < 0.05 * found["two"][0]


def test_a_key_repeated_fifteen_times_a_second(grand: tw.Instrument) -> None:
    """Every blow lands: the hammer is back in time, and the level neither dies nor grows."""
    notes = [tw.Note(0.05 + i / 15, 0.04, note=60, velocity_midi=80) for i in range(12)]
    sound = rendered(grand, notes, tw.Control(0.0, "cc64", 0.5), to=1.0)
    peaks = [np.abs(sound[int((0.05 + i / 15) * FS) : int((0.05 + (i + 1) / 15) * FS)]).max() for i in range(12)]
    assert max(peaks) < 3.0 * peaks[0]
    assert min(peaks) > 0.5 * peaks[0]


@pytest.mark.slow
def test_a_trill_of_two_keys_with_half_pedal(grand: tw.Instrument) -> None:
    """Two keys in turn, fifteen blows a second on each: every blow lands, and the account closes."""
    notes = [
        tw.Note(0.02 + (2 * i + j) / 30, 0.03, note=note, velocity_midi=80)
        for i in range(5)
        for j, note in enumerate((60, 66))
    ]
    score = tw.Score(notes, [tw.Control(0.0, "cc64", 0.5)])
    sound = tw.render(score, grand, fs=FS, max_duration=0.4, energy=True)
    peaks = [np.abs(sound.samples[int((0.02 + i / 15) * FS) : int((0.02 + (i + 1) / 15) * FS)]).max() for i in range(5)]
    assert max(peaks) < 3.0 * peaks[0]
    assert min(peaks) > 0.5 * peaks[0]
    assert sound.energy is not None
    put_in = sum(v.sum() for v in sound.energy.supplied.values())
    assert sound.energy.worst_cumulative_residual * sound.energy.peak <= 1e-10 * put_in


@pytest.mark.slow
def test_the_account_closes_with_everything_on(grand: tw.Instrument) -> None:
    notes = [
        tw.Note(0.01, 0.04, note=60, velocity_midi=110),
        tw.Note(0.03, 0.05, note=48, velocity_midi=90),
        tw.Note(0.076, 0.02, note=60, velocity_midi=100),
        tw.Note(0.05, 0.02, note=96, velocity_midi=127),
    ]
    controls = [tw.Control(0.02, "cc64", 1.0), tw.Control(0.04, "cc64", 0.5), tw.Control(0.06, "cc67", 1.0)]
    controls += [tw.Control(0.055, "cc66", 1.0), tw.Control(0.08, "cc64", 0.0)]
    trace = tw.render(tw.Score(notes, controls), grand, fs=FS, max_duration=0.12, energy=True).energy
    assert trace is not None
    put_in = sum(v.sum() for v in trace.supplied.values())
    assert trace.worst_residual <= 1e-10
    assert trace.worst_cumulative_residual * trace.peak <= 1e-10 * put_in
    # a damper that falls or rises takes nothing and gives nothing
    assert np.abs(trace.booked["stops, bends and dampers"]).max() < 1e-9 * put_in


def test_a_snapshot_goes_on_to_the_last_bit(model: Model) -> None:
    notes = [tw.Note(0.02, 0.05, note=60, velocity_midi=90), tw.Note(0.09, 0.05, note=72, velocity_midi=60)]
    controls = [tw.Control(0.05, "cc64", 0.5), tw.Control(0.1, "cc66", 1.0), tw.Control(0.11, "cc64", 1.0)]
    engine = Engine(model, perform(tw.Score(notes, controls), model).timeline)
    engine.advance(20)
    kept = engine.snapshot()
    first = engine.advance(40)
    engine.restore(kept)
    assert np.array_equal(np.concatenate([engine.advance(1) for _ in range(40)]), first)


def test_pedals_of_courses_without_dampers_are_reported_as_ignored() -> None:
    courses_only = ta.assemble(tw.load_instrument("twelve_string_guitar"), 8000)
    pressed = [tw.Control(0.0, kind, 1.0) for kind in ("cc66", "cc67")]
    found = perform(tw.Score([tw.Note(0.1, note=45)], pressed), courses_only)
    assert sum(found.ignored.values()) == 2
    live = tw.Live(tw.load_instrument("twelve_string_guitar"), prepare=False, fs=8000)
    live.control(67, 1.0)
    assert sum(live.summary().ignored.values()) == 1


def test_a_pedal_that_trembles_moves_once_per_point_of_the_grid(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    """20,000 moves in 2 s: at most one for each 64 samples, and fewer where they would be too many for the strings."""
    moves = [tw.Control(i * 1e-4, "cc64", float(i % 2)) for i in range(20_000)]
    score = tw.Score([tw.Note(0.5, 1.0, note="C4", velocity_midi=80)], moves)
    most = 2.0 * FS / 64 + 2
    lines = perform(score, model)
    times = {c.time for c in lines.timeline.changes if c.damper is not None and c.string.startswith("C3")}
    assert 0.25 * most < len(times) <= most
    assert not [w for w in lines.warnings if "pedal" in w]
    monkeypatch.setattr("tonewood.performance.player.dampers._MOST_MOVES", 50 * len(model.strings))
    fewer = perform(score, model)
    times = {c.time for c in fewer.timeline.changes if c.damper is not None and c.string.startswith("C3")}
    assert len(times) <= 50
    assert [w for w in fewer.warnings if "controller 64 moves a pedal 20000 times: moves within" in w]


def test_the_last_move_within_an_interval_counts() -> None:
    assert on_grid([(0.1, 1.0), (0.9, 0.0), (1.5, 0.5), (3.0, 1.0)], 1.0) == [(0.9, 0.0), (1.5, 0.5), (3.0, 1.0)]
