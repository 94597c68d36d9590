"""Noises of hands: their forces against the laws of strings, and when a score has them."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.base import Exciter
from tonewood.instrument.contract.gestures import Event, Gesture, Place
from tonewood.instrument.contract.registry import plugin
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.player.playing import perform
from tonewood.performance.player.timeline import Play
from tonewood.physics.energy.trace import EnergyTrace

TENSION, DENSITY, OPEN = 71.6, 6.24e-3, 0.65
#: wave impedance, sqrt(T mu), N s/m
IMPEDANCE = (TENSION * DENSITY) ** 0.5
NAMES = ("fretting", "touch", "squeak")
#: E2 and G3, so far apart that all noises find their time; a note ends before the next one
SCORE = tw.Score(
    [
        tw.Note(0.5, 0.5, string="E2", stop=1, force=2.0),
        tw.Note(1.0, 0.5, string="E2", stop=5, force=2.0),
        tw.Note(1.5, 0.3, string="E2", stop=0, force=2.0),
        tw.Note(2.5, 0.3, string="G3", stop=2, force=2.0),
    ]
)


def gesture(name: str, stops: tuple[float, float] = (0, 5), string: str = "E2", **values: Any) -> Gesture:
    """A finger that goes from one stop to another on a string of 0.65 m."""
    exciter = plugin(name).from_values(values)
    assert isinstance(exciter, Exciter)
    before, after = (OPEN * 2 ** (-stop / 12) for stop in stops)
    freq = (TENSION / DENSITY) ** 0.5 / (2 * after)
    return exciter.gesture(Event({}, freq, 0.0, stops[1], stops[0], before), Place(string, after, 2, TENSION))


def test_a_finger_presses_with_the_force_of_a_string_that_is_moved_at_its_speed() -> None:
    """2 Z v, at the new stop, down to the board, until the string has it."""
    found = gesture("fretting_noise", speed=0.2, roughness=0.0)
    assert found.noise is not None
    assert found.noise.values.max() == pytest.approx(2 * IMPEDANCE * 0.2, rel=1e-9)
    assert (found.start, found.stop) == (pytest.approx(-0.015), pytest.approx(0.0))
    assert found.from_bridge == pytest.approx(OPEN * 2 ** (-5 / 12))
    assert found.angle_deg == 180.0
    assert found.noise.values[[0, -1]].tolist() == [0.0, 0.0]


def test_a_finger_leaves_a_stop_sideways_and_less_strongly() -> None:
    found, came = (gesture("fretting_noise", stops, roughness=0.0) for stops in ((5, 2), (0, 2)))
    assert found.noise is not None
    assert came.noise is not None
    assert found.noise.values.max() == pytest.approx(0.5 * came.noise.values.max())
    assert found.angle_deg == 90.0
    assert found.from_bridge is not None
    assert found.from_bridge < OPEN * 2 ** (-5 / 12)


def test_roughness_is_a_share_of_the_force_and_hangs_on_the_seed() -> None:
    smooth, a, b, other = (
        gesture("touch_noise", roughness=r, seed=s, time=0.5) for r, s in ((0, 1), (0.1, 1), (0.1, 1), (0.1, 2))
    )
    assert smooth.noise is not None
    assert a.noise is not None
    assert b.noise is not None
    assert other.noise is not None
    part = a.noise.values - smooth.noise.values
    assert np.sqrt(np.mean(part**2) / np.mean(smooth.noise.values**2)) == pytest.approx(0.1, rel=0.05)
    assert np.array_equal(a.noise.values, b.noise.values)
    assert not np.array_equal(a.noise.values, other.noise.values)


def test_a_squeak_has_the_pitch_of_the_windings_that_pass() -> None:
    """Half way the hand moves at 1.5 way / time: so many turns of wire a second."""
    found = gesture("squeak", (2, 7), windings=3000.0, time=0.2, jitter=0.0)
    assert found.noise is not None
    middle = len(found.noise.values) // 2
    piece = found.noise.values[middle - 240 : middle + 240] * np.hanning(480)
    spectrum = np.abs(np.fft.rfft(piece, 1 << 15))
    freq = np.fft.rfftfreq(1 << 15, found.noise.interval)[spectrum.argmax()]
    way = OPEN * (2 ** (-2 / 12) - 2 ** (-7 / 12))
    assert freq == pytest.approx(1.5 * 3000 * way / 0.2, rel=0.02)


@pytest.mark.parametrize(("freq", "partials"), [(15_000.0, 1), (9_000.0, 2), (4_000.0, 3)])
def test_partials_of_a_squeak_end_below_20_khz(freq: float, partials: int) -> None:
    """Half way they are depth / k; the samples could only hold a higher one as its alias."""
    way = OPEN * (2 ** (-2 / 12) - 2 ** (-7 / 12))
    found = gesture("squeak", (2, 7), windings=freq * 0.05 / (1.5 * way), time=0.05, jitter=0.0, depth=0.5)
    assert found.noise is not None
    middle = len(found.noise.values) // 2
    window = np.hanning(120)
    time = found.noise.interval * np.arange(120)
    piece = found.noise.values[middle - 60 : middle + 60] * window
    for k in (1, 2, 3):
        size = 2 * abs(np.exp(-2j * np.pi * k * freq * time) @ piece) / window.sum()
        assert size == pytest.approx(0.5 / k if k <= partials else 0.0, abs=0.03)


def test_a_plain_string_does_not_squeak() -> None:
    assert gesture("squeak", strings=("A2",)) == Gesture(())
    assert gesture("squeak", (3, 3)) == Gesture(())


@pytest.fixture(scope="module")
def guitar() -> Instrument:
    return tw.load_instrument("classical_guitar")


def assembled(guitar: Instrument, changes: dict[str, Any]) -> Model:
    return assemble(guitar.replace({"playing.noises.on": True, **changes}), 48000)


def sorted_out(model: Model) -> dict[str, list[Play]]:
    plays = perform(SCORE, model).timeline.plays
    return {name: [p for p in plays if p.exciter == name] for name in NAMES}


def test_a_score_has_the_noises_of_its_stops_and_ends(guitar: Instrument) -> None:
    """Each before the gesture that needs the stop; none over the one before it."""
    model = assembled(guitar, {})
    found = sorted_out(model)
    plucks = [p for p in perform(SCORE, model).timeline.plays if p.exciter == "pluck"]
    assert len(plucks) == 4
    assert [p.string for p in found["fretting"]] == ["E2", "E2", "E2", "G3"]
    assert [p.string for p in found["squeak"]] == ["E2"]
    assert [p.time for p in found["touch"]] == pytest.approx([1.8, 2.8], abs=2e-3)
    grid = 64 / 48000
    for noise, pluck in zip(found["fretting"], plucks, strict=True):
        assert abs(noise.stop - pluck.start) <= grid + 1e-9
        assert noise.start * 48000 / 64 == pytest.approx(round(noise.start * 48000 / 64), abs=1e-3)
    (squeak,) = found["squeak"]
    assert squeak.stop <= found["fretting"][1].start + grid
    assert squeak.start > plucks[0].stop


def test_noises_are_left_out_by_default_and_by_effect(guitar: Instrument) -> None:
    off = perform(SCORE, assemble(guitar, 48000)).timeline.plays
    assert {p.exciter for p in off} == {"pluck"}
    found = sorted_out(assembled(guitar, {"effects.mode": ["touch_noise", "dampers"]}))
    assert [len(found[name]) for name in NAMES] == [0, 2, 0]


def test_a_plan_tells_when_and_what_they_cost(guitar: Instrument) -> None:
    planned = [e for e in tw.plan(SCORE, guitar, max_duration=3.0, noises=True).effects if e.name == "fretting_noise"]
    spans = {e.component: e.spans_s for e in planned}
    assert set(spans) == {"E2", "G3"}
    assert len(spans["E2"]) == 3
    assert all(0.005 <= b - a <= 0.025 for a, b in spans["E2"])  # a sketch has a wider grid
    assert all(e.predicted_s is not None and e.predicted_s > 0 for e in planned)


@pytest.mark.slow
def test_their_work_is_in_the_account_of_energy(guitar: Instrument) -> None:
    notes = [
        tw.Note(0.05, 0.1, string="D3", stop=2, force=1.0),
        tw.Note(0.15, 0.03, string="D3", stop=6, force=1.0),
        tw.Note(0.26, 0.03, string="D3", stop=4, force=1.0),
    ]
    score, quick = tw.Score(notes), guitar.replace({"exciters.squeak.time": 0.02})
    assert "squeak" in {p.exciter for p in perform(score, assembled(quick, {})).timeline.plays}
    silent, heard = (tw.render(score, quick, max_duration=0.3, energy=True, noises=on) for on in (False, True))
    for audio in (silent, heard):
        assert isinstance(audio.energy, EnergyTrace)
        assert audio.energy.worst_residual <= 1e-10
    assert np.abs(heard.samples - silent.samples).max() > 1e-4 * np.abs(silent.samples).max()


def test_a_noise_needs_its_exciter(guitar: Instrument) -> None:
    with pytest.raises(BundleError, match=r"playing\.noises\.touch"):
        guitar.replace({"playing.noises.touch": "tuch"})


def test_overlapping_notes_of_a_string_are_slurred_where_the_bundle_asks_for_it() -> None:
    guitar = tw.load_instrument("steel_strings")
    asked = {"up": "hammer_on", "down": "pull_off", "far": "slide"}
    notes = [(0.0, 0.55, 2), (0.5, 0.55, 4), (1.0, 0.55, 3), (1.5, 0.5, 12), (2.0, 0.55, 13), (2.5, 0.5, 13)]
    score = tw.Score([tw.Note(t, d, string="G3", stop=stop, force=2.0) for t, d, stop in notes])
    expected = ["pluck", "hammer_on", "pull_off", "slide", "pluck", "pluck"]
    for slurs, names in (({}, ["pluck"] * 6), (asked, expected)):
        model = assemble(guitar.replace({"playing.slurs": slurs}), 48000)
        assert [p.exciter for p in perform(score, model).timeline.plays] == names


def test_a_hand_lies_on_idle_strings_where_the_bundle_asks_for_it(guitar: Instrument) -> None:
    """The open A2 has a partial at the pitch of A3 and takes its energy through the bridge, unless it is damped."""
    score = tw.Score([tw.Note(0.1, 3.0, string="G3", stop=2, force=2.0)])
    late = {}
    for idle in ("ring", "damp"):
        made = guitar.replace({"playing.note_end.idle": idle, "outputs": json.loads(_FORCE)})
        x = tw.render(score, made, 24000, max_duration=1.0).samples[:, 0]
        late[idle] = np.sqrt(np.mean(x[12000:] ** 2))
    assert late["damp"] < 0.05 * late["ring"]


_FORCE = '[{"name": "f", "plugin": "point_pickup", "quantity": "force", "at": "A2.bridge", "full_scale": 1.0}]'


@pytest.mark.slow
def test_live_playing_says_which_noises_it_has_not(guitar: Instrument) -> None:
    for on, expected in ((False, {}), (True, {"playing.noises.fretting": 1, "playing.noises.squeak": 1})):
        assert dict(tw.Live(guitar.replace({"playing.noises.on": on})).summary().ignored) == expected


@pytest.mark.slow
def test_a_finger_ends_a_note_that_is_played_live(guitar: Instrument) -> None:
    """The noise begins as the key comes up, whatever the note was: the guitar is linear."""

    @cache
    def played(force: float, on: bool) -> np.ndarray:
        live = tw.Live(guitar.replace({"playing.noises.on": on}), fs=24000)
        voice = live.note_on(string="A2", stop=3, force=force)
        before = live.process(6000)
        assert voice is not None
        live.release(voice)
        return np.concatenate([before, live.process(6000)])

    soft, loud = (played(force, True) - played(force, False) for force in (0.5, 2.0))
    first = np.flatnonzero(np.any(soft != 0.0, axis=1))[0]
    assert 6000 <= first <= 6000 + 128 + 2
    assert np.abs(soft).max() > 1e-4 * np.abs(played(0.5, False)).max()
    assert np.abs(soft - loud).max() < 1e-9 * np.abs(soft).max()
