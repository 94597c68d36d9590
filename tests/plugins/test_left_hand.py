"""Slides, hammer-ons and pull-offs by an ideal stop and by a soft finger, and how they are asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scene import band_energy, instrument, play

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model import string_tuning
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.playing import perform
from tonewood.performance.score.note import Control
from tonewood.physics.energy.stored import stored_energy

Floats = NDArray[np.float64]
FS = 48000
ACTIONS = ("slide", "hammer_on", "pull_off")
PALM = {"plugin": "stopping_finger", "touch": 0.03, "width": 0.02, "weight": 4.0, "lift": 2.0, "from_bridge": 0.15}


def monochord(model: str, kind: str = "continuous", **playing: Any) -> Instrument:
    """The string on its box, with a hand; the output is its force on the bridge."""
    base = tw.load_instrument("monochord")
    values = json.loads(json.dumps(base.resolved))
    values["stops"] |= {"model": model, "kind": kind}
    values["exciters"] |= {action: {"plugin": "left_hand", "action": action} for action in ACTIONS}
    values["exciters"]["palm"] = PALM
    force = {"name": "f", "plugin": "point_pickup", "quantity": "force", "at": "A2.bridge", "full_scale": 4.0}
    values["outputs"] = [force]
    values["playing"] |= playing
    return Instrument.from_values(values, base.folder)


def played(made: Instrument, first: float, second: float, technique: str | None, **note: Any) -> Floats:
    """A pluck at one stop, and 0.6 s later the other stop by a technique."""
    notes = [
        tw.Note(0.0, 0.6, string="A2", stop=first, force=2.0),
        tw.Note(0.6, 1.0, string="A2", stop=second, force=2.0, technique=technique, **note),
    ]
    return tw.render(tw.Score(notes), made, max_duration=1.5).samples[:, 0] * 4.0


def pitch(x: Floats, start: float, stop: float) -> float:
    piece = x[int(start * FS) : int(stop * FS)]
    spectrum = np.abs(np.fft.rfft((piece - piece.mean()) * np.hanning(len(piece)), 1 << 20))
    freq = np.fft.rfftfreq(1 << 20, 1 / FS)
    near = (freq > 80) & (freq < 280)
    return float(freq[near][spectrum[near].argmax()])


def off(freq: float, stop: float) -> float:
    """Cents from a stop of A2."""
    return 1200 * float(np.log2(freq / 110.0)) - 100 * stop


@pytest.mark.slow
@pytest.mark.parametrize("model", ["ideal", "finger"])
@pytest.mark.parametrize(("technique", "first", "second"), [("hammer_on", 0, 5), ("pull_off", 5, 0), ("slide", 2, 7)])
def test_the_pitch_changes_without_a_pluck(model: str, technique: str, first: int, second: int) -> None:
    x = played(monochord(model), first, second, technique)
    assert abs(off(pitch(x, 0.15, 0.44), first)) < 1
    assert abs(off(pitch(x, 0.9, 1.5), second)) < 1
    before, after = x[int(0.3 * FS) : int(0.4 * FS)].std(), x[int(0.7 * FS) : int(0.8 * FS)].std()
    assert 0.3 * before < after < 1.2 * before
    # no click: nothing leaps at the exchange more than a pluck's own edge does
    pluck = np.abs(np.diff(x[: int(0.1 * FS)])).max()
    assert np.abs(np.diff(x[int(0.42 * FS) :])).max() < 0.7 * pluck


@pytest.mark.slow
@pytest.mark.parametrize("model", ["ideal", pytest.param("finger", marks=pytest.mark.slow)])
def test_a_slides_pitch_only_rises(model: str) -> None:
    """The fundamental's phase, taken down by a steady 140 Hz: its rate never turns back by more than the beat."""
    from scipy.signal import butter, sosfiltfilt

    made = monochord(model).replace({"exciters.slide.time": 0.2, "strings.A2.freq_upper": 6000.0})
    x = played(made, 0, 7, "slide")
    t = np.arange(len(x)) / FS
    low = sosfiltfilt(butter(3, 45.0, fs=FS, output="sos"), x * np.exp(-2j * np.pi * 137.0 * t))
    freq = 137.0 + np.gradient(np.unwrap(np.angle(low)), 1 / FS) / (2 * np.pi)
    track = np.array([freq[(t > a) & (t < a + 0.02)].mean() for a in np.arange(0.24, 0.72, 0.02)])
    assert track[0] == pytest.approx(110.0, rel=0.01)
    assert np.all(np.diff(track) > -0.006 * track[:-1])
    assert abs(off(pitch(x, 0.9, 1.5), 7)) < 1


def test_on_frets_a_slide_sounds_every_fret() -> None:
    made = monochord("ideal", "frets")
    for first, second in ((2, 6), (6, 2)):
        notes = [
            tw.Note(0.0, 0.6, string="A2", stop=first), tw.Note(0.6, 1.0, string="A2", stop=second, technique="slide")
        ]  # fmt: skip
        changes = perform(tw.Score(notes), assemble(made, FS)).timeline.changes
        stops = [c.stop for c in changes if c.stop is not None]
        way = range(first, second + 1) if second > first else range(first, second - 1, -1)
        assert [*dict.fromkeys(stops)][: len(way)] == [float(s) for s in way]


@pytest.mark.slow
@pytest.mark.parametrize("model", ["ideal", "finger"])
def test_a_stopping_hand_without_force_gives_no_energy(model: str) -> None:
    """With no push, a finger that comes or leaves can only take; while nothing changes energy falls."""
    made = monochord(model).replace({"exciters.hammer_on.share": 0.0, "exciters.pull_off.share": 0.0})
    for technique, first, second in (("hammer_on", 0, 5), ("pull_off", 5, 0)):
        notes = [
            tw.Note(0.0, 0.1, string="A2", stop=first, force=2.0),
            tw.Note(0.1, 1.0, string="A2", stop=second, technique=technique),
        ]
        engine = Engine(model := assemble(made, FS), perform(tw.Score(notes), model).timeline)
        energies = []
        while engine.state.sample < 0.2 * FS:
            engine.advance(1)
            energies.append(stored_energy(engine.system, engine.state).total)
        start = next(i for i, e in enumerate(energies) if e == max(energies)) + 1
        assert start < 0.06 * FS / 64
        assert np.all(np.diff(energies[start:]) <= 1e-9 * max(energies))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["ideal", "finger"])
def test_no_stop_of_a_score_is_tuned_while_it_sounds(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    notes = [tw.Note(0.0, 0.1, string="A2", stop=1), tw.Note(0.1, 0.2, string="A2", stop=4.5, technique="slide")]
    made, searches = assemble(monochord(model), FS), []
    search = string_tuning.tune

    def counted(*args: Any) -> Any:
        searches.append(args[1])
        return search(*args)

    monkeypatch.setattr(string_tuning, "tune", counted)
    engine = Engine(made, perform(tw.Score(notes), made).timeline)
    before = len(searches)
    assert before > 2
    engine.advance(int(0.3 * FS / 64))
    assert len(searches) == before


@pytest.mark.slow
def test_the_work_of_a_sliding_finger_is_bounded() -> None:
    """Down to half the length and back: the string never has more than twice the energy of the pluck."""
    made = monochord("finger").replace({"exciters.slide.time": 0.1})
    notes = [tw.Note(0.25 * i, 0.25, string="A2", stop=s, technique="slide" if i else None, force=2.0)
             for i, s in enumerate((2, 12, 2))]  # fmt: skip
    engine = Engine(model := assemble(made, FS), perform(tw.Score(notes), model).timeline)
    energies = []
    while engine.state.sample < 0.7 * FS:
        engine.advance(1)
        energies.append(stored_energy(engine.system, engine.state).total)
    first = max(energies[: int(0.1 * FS / 64)])
    assert max(energies) < 1.05 * first
    assert energies[-1] < 0.5 * first


def decay(x: Floats) -> float:
    """T60 of the energy between 0.1 and 0.4 s, s."""
    pieces = [float(np.sum(x[int(a * FS) : int((a + 0.05) * FS)] ** 2)) for a in (0.1, 0.35)]
    return 60 * 0.25 / (10 * np.log10(pieces[0] / pieces[1]))


def test_a_palm_shortens_the_decay() -> None:
    made, t60 = monochord("ideal"), {}
    for technique in (None, "palm"):
        notes = [tw.Note(0.0, 1.0, string="A2", stop=0, force=2.0, technique=technique)]
        x = tw.render(tw.Score(notes), made, max_duration=0.45).samples[:, 0]
        t60[technique] = decay(x - x[int(0.3 * FS) :].mean())
    assert t60["palm"] < 0.25 * t60[None]


@pytest.mark.parametrize(("node", "partial"), [(1 / 2, 2), (1 / 3, 3), (1 / 4, 4)])
def test_harmonics_at_nodes(node: float, partial: int) -> None:
    """A light touch at 1/n of the string leaves its n-th partial, and sounds n times the open pitch."""
    notes = [tw.Note(0.0, 1.0, string="A2", stop=0, force=2.0, technique="harmonic")]
    sound = tw.render(tw.Score(notes), touched(touch={"fraction": node}), max_duration=1.0).samples
    spectrum, freq = strongest(sound[int(0.3 * FS) :, 0])
    assert freq[spectrum.argmax()] == pytest.approx(partial * 110.0, rel=5e-3)
    below = [spectrum[np.abs(freq - n * 110.0) < 20].max() for n in range(1, partial)]
    assert max(below) < 0.1 * spectrum.max()


def test_asked_for_by_key_and_controller() -> None:
    """A keyswitch holds until the next one, a controller while it is up; neither is a note."""
    made = monochord("ideal", keyswitches={"C1": "slide", "D1": "pluck"}, switches={"cc68": "hammer_on"})
    line = [tw.Note(0.5 * i, 0.5, note=45 + i, channel=0) for i in range(6)]
    keys = [tw.Note(0.9, 0.05, note=24, channel=0), tw.Note(1.9, 0.05, note=26, channel=0)]
    controls = [Control(2.4, "cc68", 1.0, 0), Control(2.45, "cc68", 0.2, 0), Control(0.4, "cc68", 0.7, 1)]
    performance = perform(tw.Score([*line, *keys], controls), assemble(made, FS))
    asked = [a.note.technique for a in performance.notes]
    assert asked == [None, None, "slide", "slide", "pluck", "pluck"]
    held = perform(tw.Score(line, [Control(0.9, "cc68", 0.6, 0), Control(1.6, "cc68", 0.0, 0)]), assemble(made, FS))
    assert [a.note.technique for a in held.notes] == [None, None, "hammer_on", "hammer_on", None, None]
    with pytest.raises(BundleError, match=r"playing\.keyswitches\.C1: there is no exciter 'glide'"):
        monochord("ideal", keyswitches={"C1": "glide"})
    with pytest.raises(BundleError, match="'H9' is not a note"):
        monochord("ideal", keyswitches={"H9": "slide"})


def test_a_broad_touch_leaves_no_node(tmp_path: Path) -> None:
    """The 20th partial has a node under a narrow finger at L / 20; a palm 3 cm broad damps it too."""
    level = {}
    for width in (0.0, 0.03):
        finger = {**PALM, "touch": {"fraction": 0.05}, "width": width, "hold_dashpot": 0.0}
        x = play(instrument(tmp_path, exciters={"palm": finger}), {"force": 2.0}, duration=0.25).out[-4800:]
        freq = np.sqrt(73.9 / 3.61e-3) / 2 / 0.65
        level[width] = band_energy(x, 19.5 * freq, 21.5 * freq)
    assert level[0.03] < 0.05 * level[0.0]


def strongest(x: Floats) -> tuple[Floats, Floats]:
    """Spectrum and its frequencies."""
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), 1 << 19))
    return spectrum, np.fft.rfftfreq(1 << 19, 1 / FS)


def touched(**finger: Any) -> Instrument:
    made = monochord("ideal")
    values = json.loads(json.dumps(made.resolved))
    values["exciters"]["harmonic"] = {"plugin": "stopping_finger", "from_bridge": 0.09, "lift": 0.12, **finger}
    values["playing"]["controls"] = {"cc1": {"parameter": "harmonic.touch", "low": 0.2, "high": 0.65}}
    return Instrument.from_values(values, made.folder)


@pytest.mark.parametrize(("place", "partial"), [(0.3, 3), (0.45, 2), (0.6, 3), (0.225, 4)])
def test_a_controller_places_the_finger(place: float, partial: int) -> None:
    """On 0.9 m of string; the bundle's own place is the middle."""
    notes = [tw.Note(0.0, 1.0, string="A2", stop=0, force=2.0, technique="harmonic")]
    control = Control(0.0, "cc1", (place - 0.2) / 0.45)
    x = tw.render(tw.Score(notes, [control]), touched(touch=0.45), max_duration=1.0).samples[int(0.3 * FS) :, 0]
    spectrum, freq = strongest(x)
    assert freq[spectrum.argmax()] == pytest.approx(partial * 110.0, rel=5e-3)


@pytest.mark.slow
def test_a_finger_that_moves_along() -> None:
    """From the middle to a third while the string sounds: it takes the octave too, and gives nothing worth naming."""
    made = touched(touch=0.45, touch_end=0.3, lift=0.2)
    notes = [tw.Note(0.0, 1.0, string="A2", stop=0, force=2.0, technique="harmonic")]
    model = assemble(made, FS)
    engine = Engine(model, perform(tw.Score(notes), model).timeline)
    energies, out = [], []
    while engine.state.sample < 0.6 * FS:
        out.append(engine.advance(1)[:, 0])
        energies.append(stored_energy(engine.system, engine.state).total)
    start = int(np.argmax(energies)) + 1
    rises = np.maximum(np.diff(energies[start:]), 0.0)
    assert rises.sum() < 1e-3 * max(energies)
    still = tw.render(tw.Score(notes), touched(touch=0.45, lift=0.2), max_duration=0.6).samples[-int(0.3 * FS) :, 0] * 4
    moved = np.concatenate(out)[-int(0.3 * FS) :]
    level = [spectrum[np.abs(freq - 220.0) < 5].max() for spectrum, freq in map(strongest, (still, moved))]
    assert level[1] < 0.1 * level[0]


@pytest.mark.slow
@settings(max_examples=5, deadline=None)
@given(
    st.sampled_from(["ideal", "finger"]),
    st.lists(
        st.tuples(
            st.floats(0, 24), st.sampled_from([None, *ACTIONS, "palm"]), st.floats(0.1, 8.0), st.floats(0.01, 0.2)
        ),
        min_size=2, max_size=6,
    ),
)  # fmt: skip
def test_any_sequence_of_techniques(model: str, line: list[tuple[float, str | None, float, float]]) -> None:
    """In any order, however quickly: the sound stays finite and of the size of the forces."""
    made = monochord(model).replace({"strings.A2.freq_upper": 4000.0, "tuning.at": "open_only"})
    time, notes = 0.0, []
    for stop, technique, force, duration in line:
        notes.append(tw.Note(time, duration, string="A2", stop=stop, force=force, technique=technique))
        time += duration
    x = tw.render(tw.Score(notes), made, fs=16000, max_duration=time + 0.1).samples * 4.0
    assert np.all(np.isfinite(x))
    assert np.abs(x).max() < 3 * sum(force for _, _, force, _ in line)


@pytest.mark.slow
def test_live_slides_search_for_no_tension(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stops that a slide passes, and bends of them, take their tension from a table made before the sound."""
    made = monochord("ideal")
    live = tw.Live(made, FS)

    def searched(*_: object) -> None:
        raise AssertionError("searched for a tension in mid-sound")

    exact = assemble(made, FS).strings["A2"].tuning
    stops = np.random.default_rng(5).uniform(0, 24, 40)
    table = live.model.strings["A2"].tuning
    errors = [600 * np.log2(table.tension(stop) / exact.tension(stop)) for stop in stops.tolist()]
    assert np.abs(errors).max() < 0.5
    assert all(table.tension(stop) == exact.tension(stop) for stop in range(25))

    monkeypatch.setattr(string_tuning, "tune", searched)
    monkeypatch.setattr(string_tuning, "held_freq", searched)
    live.note_on(string="A2", stop=2.0, force=2.0)
    before = live.process(FS // 4)
    live.note_on(string="A2", stop=6.4, force=2.0, technique="slide")
    live.bend(30.0)
    after = live.process(FS)
    assert np.abs(before).max() > 0
    freq = 110.0 * 2 ** ((6.4 + 0.3) / 12)
    assert 1200 * abs(np.log2(pitch(after[:, 0], 0.4, 1.0) / freq)) < 3.0
