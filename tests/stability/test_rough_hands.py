"""Gestures that hands can make, and rougher ones: finite, no energy out of nothing, pitch where it was.

Energy is read from the engine's state after every interval of the control grid.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
from sounds import cents, partial
from tonewood.errors import NumericalError
from tonewood.instrument.contract.gestures import Gesture
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.performance.player.timeline import Change, Play, Timeline
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.forcing import Segment
from tonewood.sound.files.audio import SoundWriter

Floats = NDArray[np.float64]
FS = 16000
TAP = {"exciters.tap": {"plugin": "force_pulse", "at": "body.bridge", "duration": 1e-3, "force": 5.0}}


@pytest.fixture(scope="module")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


@pytest.fixture(scope="module")
def monochord() -> tw.Instrument:
    """One polarization, heard as displacement, so that a partial is one mode."""
    one = {"strings.A2.polarizations": ["z"], "outputs.bridge.quantity": "displacement"}
    return tw.load_instrument("monochord").replace({**one, "outputs.bridge.full_scale": 1e-4, **TAP})


def sound(notes: list[tw.Note], instrument: tw.Instrument, duration: float, fs: int = FS, **more: object) -> Floats:
    score = tw.Score(notes, more.pop("controls", ()))  # type: ignore[arg-type]  # passed on
    renderer = tw.Renderer(score, instrument, fs, max_duration=duration, **more)  # type: ignore[arg-type]  # passed on
    return np.concatenate(list(renderer.blocks(8192)))


def engine_of(notes: list[tw.Note], instrument: tw.Instrument, controls: list[tw.Control] | None = None) -> Engine:
    return tw.Renderer(tw.Score(notes, controls or []), instrument, FS).engine


def energies(engine: Engine, until: float) -> Iterator[tuple[float, float]]:
    """(time, stored energy) after every interval of the control grid."""
    while engine.state.sample < until * FS:
        engine.advance(1)
        yield engine.state.sample / FS, stored_energy(engine.system, engine.state).total


@pytest.mark.slow
@pytest.mark.parametrize("force", [1e-3, 20.0, 1e3])
def test_plucks_from_a_breath_to_a_kilonewton(guitar: tw.Instrument, force: float) -> None:
    """The instrument is linear: all sound alike up to the factor. Let go, it loses energy in every interval."""
    note = tw.Note(0.0, 2.0, note=45, force=force)
    ramp = guitar.replace({"exciters.pluck": {"plugin": "pluck_ramp"}})  # a finger's release depends on its force
    one = sound([tw.Note(0.0, 2.0, note=45, force=1.0)], ramp, 0.3)
    many = sound([note], ramp, 0.3)
    np.testing.assert_allclose(many, force * one, atol=1e-12 * force * np.abs(one).max(), rtol=0)
    course = np.array([e for t, e in energies(engine_of([note], ramp), 0.5) if t > 2 * GRID / FS])
    assert np.all(np.diff(course) < 0)


@pytest.mark.slow
@pytest.mark.parametrize("force", [0.5, 20.0, 1e3])
def test_a_finger_of_any_force_lets_go(guitar: tw.Instrument, force: float) -> None:
    """After its slip the instrument loses energy in every interval."""
    engine = engine_of([tw.Note(0.0, 2.0, note=45, force=force)], guitar)
    end = engine.timeline.plays[0].stop
    assert end < 0.01
    course = np.array([e for t, e in energies(engine, 0.5) if t > end + 2 * GRID / FS])
    assert np.all(np.diff(course) < 0)


def replucked(instrument: tw.Instrument, count: int, every: float) -> tuple[Floats, Floats]:
    """Energy at the end of each pluck's life, and the sound of the last one."""
    notes = [tw.Note(i * every, 5.0, note=45, force=2.0) for i in range(count)]
    renderer = tw.Renderer(tw.Score(notes), instrument, FS, max_duration=count * every + 1.0)
    left, engine, stream = [], renderer.engine, renderer.blocks(round(every * FS))
    for i, block in enumerate(stream):
        if i < count:
            left.append(stored_energy(engine.system, engine.state).total)
        else:
            last = np.concatenate([block, *stream])
            return np.array(left), last[:, 0]
    raise AssertionError("the render ended early")


def assert_replucks(instrument: tw.Instrument, count: int) -> None:
    every = 0.04375  # 700 samples
    left, last = replucked(instrument, count, every)
    assert left[10:].max() < 1.5 * left[:10].max()
    # no trend: the last plucks leave as much as the first ones
    assert abs(np.log(left[-100:].mean() / left[10:110].mean())) < 0.1
    single = sound([tw.Note(0.0, 5.0, note=45, force=2.0)], instrument, 1.0)[:, 0]
    freq, wanted = partial(last[FS // 50 :], FS, 110.0)[0], partial(single[FS // 50 :], FS, 110.0)[0]
    assert abs(cents(freq, wanted)) < 0.01


@pytest.mark.slow
def test_300_replucks_neither_drift_nor_pile_up(monochord: tw.Instrument) -> None:
    """Energy before each next pluck stays where the first ones left it; pitch within a hundredth of a cent."""
    assert_replucks(monochord, 300)


@pytest.mark.validate
def test_10_000_replucks_neither_drift_nor_pile_up(monochord: tw.Instrument) -> None:
    """The same for seven minutes."""
    assert_replucks(monochord, 10_000)


@pytest.mark.slow
def test_all_strings_stopped_and_released_at_once(guitar: tw.Instrument) -> None:
    """After a chord, forty times: a stop or release brings no more energy than its change of tension allows.

    Compensation gives each stop its own tension, within half a percent of the open string's here: that work apart,
    carrying motion over to another length can only lose.
    """
    chord = [tw.Note(0.0, 3.0, note=n, force=5.0) for n in (40, 45, 50, 55, 59, 64)]
    renderer = tw.Renderer(tw.Score(chord), guitar, FS)
    timeline = renderer.engine.timeline
    toggles = [
        Change(0.1 + 0.0173 * i, name, stop=5 if i % 2 == 0 else 0)
        for i in range(40)
        for name in renderer.model.strings
    ]
    tensions = [(s.tension(0), s.tension(5)) for s in renderer.model.strings.values()]
    allowed = max(max(a / b, b / a) for a, b in tensions)
    engine = Engine(
        renderer.model, Timeline(sorted([*timeline.changes, *toggles], key=lambda c: c.time), timeline.plays)
    )
    course = [e for t, e in energies(engine, 1.0) if t > 0.09]
    assert engine.counters.exchanges >= 6 * 40
    assert allowed < 1.05
    assert max(b / a for a, b in itertools.pairwise(course)) < allowed
    assert course[-1] < 0.5 * course[0]


def test_a_cluster_of_all_keys(guitar: tw.Instrument) -> None:
    """128 keys at once on six strings: six sound, the rest is listed; no more energy than six plucks make."""
    notes = [tw.Note(0.0, 1.0, note=n, force=3.0) for n in range(128)]
    renderer = tw.Renderer(tw.Score(notes), guitar, FS, max_duration=0.5)
    samples = np.concatenate(list(renderer.blocks()))
    summary = renderer.summary()
    assert summary.notes == 6
    assert len(summary.notes_dropped) == 122
    assert all(drop.reason for drop in summary.notes_dropped)
    assert 0.0 < np.abs(samples).max() < 1.0
    engine = engine_of(notes, guitar)
    peak = max(e for _, e in energies(engine, 0.1))
    # a string drawn aside by F at x holds F^2 x (L - x) / (2 L T)
    bound = 6 * 3.0**2 * 0.65 / 4 / (2 * 40.0)
    assert 0.0 < peak < bound


@pytest.mark.slow
@pytest.mark.parametrize("controls", [[], [tw.Control(0.003 * i, "cc64", float(i % 2)) for i in range(200)]])
def test_notes_of_no_length_and_a_chattering_pedal(guitar: tw.Instrument, controls: list[tw.Control]) -> None:
    """Every string at once again and again, each note ending as it begins: energy is that of one round, then gone."""
    rounds = 6
    notes = [tw.Note(0.05 * k, 0.0, note=n, force=3.0) for k in range(rounds) for n in (40, 45, 50, 55, 59, 64)]
    course = list(energies(engine_of(notes, guitar, controls), 1.0))
    assert np.isfinite([e for _, e in course]).all()
    first = max(e for t, e in course if t < 0.02)
    assert max(e for _, e in course) < 1.6 * first
    assert course[-1][1] < 1e-3 * first


@pytest.mark.slow
def test_bends_of_two_octaves_up_and_down_at_once(monochord: tw.Instrument) -> None:
    """Thirty leaps over four octaves: no interval gains more than its tension does, nothing piles up, pitch returns.

    At rest in its wheel a string only loses. While it is tightened its potential energy grows at most as its tension,
    which is work of the hand.
    """
    leaps = [tw.Control(0.1 + 0.15 * i, "bend", (2400.0, -2400.0, 0.0)[i % 3]) for i in range(30)]
    engine = engine_of([tw.Note(0.0, 9.0, note=45, force=2.0)], monochord, leaps)
    course = []
    for at, energy in energies(engine, 4.8):
        course.append((at, energy, engine.frettings["A2"].cents))
    t, e, bend = np.array(course).T
    free = np.flatnonzero(t > 0.01)[:-1]
    raised = np.maximum(np.diff(bend), 0.0)[free]
    assert raised.max() > 100
    assert np.all(e[free + 1] <= e[free] * 2 ** (2 * raised / 1200) * (1 + 1e-9))
    start = e[np.searchsorted(t, 0.09)]
    assert e.max() < 16 * start
    assert e[-1] < 0.2 * start
    x = sound([tw.Note(0.0, 9.0, note=45, force=2.0)], monochord, 5.6, controls=leaps)[:, 0]
    assert abs(cents(partial(x[round(4.7 * FS) :], FS, 110.0)[0], 110.0)) < 0.05


@pytest.mark.parametrize("fs", [8000, 11025, 44100, 192000])
def test_the_same_instrument_at_every_rate(monochord: tw.Instrument, fs: int) -> None:
    """Pitch within 0.05 cent and T60 within 0.5 percent of 96 kHz."""
    found = []
    for rate in (fs, 96000):
        x = sound([tw.Note(0.0, 5.0, note=45, force=1.0)], monochord, 0.75, rate)[round(0.05 * rate) :, 0]
        found.append([partial(x, rate, near) for near in (110.0, 220.1)])
    for (freq, rate_here), (wanted, rate_there) in zip(*found, strict=True):
        assert abs(cents(freq, wanted)) < 0.05
        assert rate_here == pytest.approx(rate_there, rel=5e-3)


def test_a_struck_body_with_strings_on_it(monochord: tw.Instrument) -> None:
    """The tap's energy only falls once the tap is over, and no tone is left at Nyquist."""
    tap = [tw.Note(0.05 * i, 0.0, technique="tap", force=50.0) for i in range(4)]
    course = [e for t, e in energies(engine_of(tap, monochord), 1.0) if t > 0.16]
    assert np.all(np.diff(course) < 0)
    x = sound(tap, monochord.replace({"outputs.bridge.quantity": "acceleration"}), 1.0)[round(0.2 * FS) :, 0]
    spectrum = np.abs(np.fft.rfft(x * np.hanning(len(x))))
    assert spectrum[-len(spectrum) // 40 :].max() < 1e-5 * spectrum.max()


@pytest.mark.parametrize("component", ["body", "A2.z"])
def test_a_state_that_is_not_a_number_reaches_no_file(monochord: tw.Instrument, tmp_path: Path, component: str) -> None:
    """The error names component and time, no block holds it, and no file appears."""
    renderer = tw.Renderer(tw.Score([tw.Note(0.0, 1.0, note=45, force=1.0)]), monochord, FS, max_duration=1.0)
    blocks, path = renderer.blocks(512), tmp_path / "out.wav"
    seen: list[Floats] = []
    bad: list[int] = []

    def render() -> None:
        with SoundWriter(path, FS, 1) as writer:
            for i, block in enumerate(blocks):
                seen.append(block)
                writer.write(block)
                if i == 3:
                    bad.append(renderer.engine.state.sample)
                    renderer.engine.system.modes_of(renderer.engine.state, component)[1, 2] = np.nan

    with pytest.raises(NumericalError, match=rf"^{component} is no longer finite at ([\d.]+) s$") as fault:
        render()
    reported = float(str(fault.value).split()[-2])
    assert 0 <= reported - bad[0] / FS <= 16 / FS + 1e-6
    assert np.isfinite(np.concatenate(seen)).all()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_force_that_is_not_a_number_is_reported(monochord: tw.Instrument, value: float) -> None:
    model = assemble(monochord, FS)
    gesture = Gesture((Segment(0.0, 0.01, value),), 0.1)
    engine = Engine(model, Timeline([], [Play(0.1, gesture, string="A2")]))
    with pytest.raises(NumericalError, match=r"^A2\.z is no longer finite at 0\.10\d* s$"):
        engine.advance(100)


def silence(instrument: tw.Instrument, seconds: float) -> tuple[Floats, Floats, Floats, Engine]:
    """First and second note after 5 ms, s of computing per second of silence between them, and the engine after it."""
    notes = [tw.Note(t, 0.5, note=45, force=2.0) for t in (0.0, seconds)]
    renderer = tw.Renderer(tw.Score(notes), instrument, FS, max_duration=seconds + 1.0)
    out, cost = [], []
    for block in renderer.blocks(FS):
        out.append(block[:, 0])
        began = time.process_time()
        cost.append(began)
        if len(out) == round(seconds) - 1:
            state = renderer.engine.state.modes.copy()
            tiny = (np.abs(state) < np.finfo(np.float64).tiny) & (state != 0)
            assert not tiny.any()
    whole = round(5e-3 * FS)  # until then the step at frame 0 fades, where the first note's ramp is cut off
    return out[0][whole:], out[-1][whole:], np.diff(cost), renderer.engine


def test_silence_leaves_nothing_behind(monochord: tw.Instrument) -> None:
    """After a minute the second note is the first one again, and no denormal number is in the state."""
    first, second, _, _ = silence(monochord, 60.0)
    np.testing.assert_allclose(second, first, atol=1e-9 * np.abs(first).max(), rtol=0)


@pytest.mark.validate
def test_ten_minutes_of_silence(monochord: tw.Instrument, capsys: pytest.CaptureFixture[str]) -> None:
    """The same after ten minutes; the cost of a silent second beside a loud one is printed, not judged."""
    first, second, cost, _ = silence(monochord, 600.0)
    np.testing.assert_allclose(second, first, atol=1e-9 * np.abs(first).max(), rtol=0)
    with capsys.disabled():
        print(f"\na silent second costs {np.median(cost[-60:-1]) / np.median(cost[:10]):.2f} of a loud one")
