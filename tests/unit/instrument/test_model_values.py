"""Pieces of a model with closed forms or by hand: stops, tensions, bases that are kept, banks, stems, tunings."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonewood.errors import BundleError
from tonewood.instrument.bundle.key_schema import Damper, KeyEntry, Keys, Pedals
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import Finger
from tonewood.instrument.contract import array_cache
from tonewood.instrument.contract.base import BodyPoint, BridgeForce
from tonewood.instrument.contract.microphones import Microphones
from tonewood.instrument.inspection import frequencies
from tonewood.instrument.model import kept_tunings, string_tuning, strings
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.choice import Choice
from tonewood.instrument.model.kept_tunings import KeptTunings
from tonewood.instrument.model.output_assembly import OutputGroup, Outputs
from tonewood.instrument.model.stop_table import StopTable
from tonewood.instrument.model.string_assembly import _is_beyond
from tonewood.instrument.model.string_setup import GivenTension, Polarization, Stopping
from tonewood.instrument.model.string_stems import outputs_by_string
from tonewood.instrument.model.string_tuning import StringTuning
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.tuning import CoupledMode, TunedStop, tune
from tonewood.instrument.model.untuned_bases import PASSING_STOPS, UntunedBases, held_freq
from tonewood.instrument.scales import note_name
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis


def semitones(stop: float) -> float:
    return 100.0 * 2 ** (stop / 12)


@pytest.mark.parametrize(
    ("given", "used", "held", "raised", "stretch", "cents"),
    [
        (80.0, 80.0, "pitch", 7.0, 0.0, 0.0), (160.0, 80.0, "pitch", 7.0, 0.0, 600.0),
        (80.0, 160.0, "pitch", 7.0, 5.0, -595.0), (80.0, 160.0, "tension", 7.0, 5.0, 7.0),
        (80.0, 80.0, "tension", 30.0, 0.0, 30.0), (80.0, 80.0, "tension", -30.001, 0.0, -30.001),
    ],
)  # fmt: skip
def test_cents_of_a_tension(given: float, used: float, held: str, raised: float, stretch: float, cents: float) -> None:
    tension = GivenTension("A", given, used, held, raised, stretch)
    assert (tension.cents, tension.noticeable) == (pytest.approx(cents), abs(cents) > 30.0)
    assert f"{cents:+.0f} cents" in tension.line()
    assert ("is held" in tension.line()) == (held == "tension")


def test_stops_of_an_ideal_string() -> None:
    """Stop n is at L (1 - 2^(-n/12)); a soft finger leaves the whole string in motion."""
    table = StopTable("A", 0.6, Stopping(12, False, semitones, "each_stop"))
    assert table.freqs == pytest.approx([semitones(n) for n in range(13)])
    assert table.lengths == pytest.approx([0.6 * 2 ** (-n / 12) for n in range(13)])
    assert (table.position(12), table.end(3.0)) == (pytest.approx(0.3), 3.0)
    assert (table.freq(0.5), table.freq(-1.0), table.freq(13)) == pytest.approx([semitones(x) for x in (0.5, -1, 13)])
    slide = StopTable("A", 0.6, Stopping(12, True, semitones, "each_stop", finger=Finger()))
    assert (slide.length(6.5), slide.end(6.5)) == (pytest.approx(0.6 * 2 ** (-6.5 / 12)), 0.0)
    for one, stop in ((table, 0.5), (table, 13), (table, -1), (slide, 12.01), (slide, -0.01)):
        with pytest.raises(ValueError, match=f"stops from 0 to 12, not {stop:g}") as caught:
            one.position(stop)
        assert ("whole" in str(caught.value)) == (one is table)


def test_bases_of_stops_between_frets_are_forgotten_in_turn() -> None:
    calls: list[tuple[float, float]] = []

    def basis(upper: float, *, stop: float, tension: float) -> ModalBasis:
        calls.append((stop, tension))
        n = 1 if stop > 0.1 else 2
        return ModalBasis.real(np.arange(1.0, n + 1), np.ones(n), {"bridge": np.ones(n), "x": np.zeros(n)})

    def fault(reason: str, key: str) -> BundleError:
        return BundleError(reason, key=key)

    resonator: Any = SimpleNamespace(basis=basis, fault=fault, detuned=lambda base, tension: tension)
    stops = StopTable("A", 1.0, Stopping(24, True, semitones, "each_stop"))
    planes = [Polarization("A.z", (0, 0, 1), {}), Polarization("A.y", (0, 1, 0), {}, 2.0)]
    bases = UntunedBases(resonator, stops, planes, 900.0, 0.25, lambda stop: 1200.0 * stop)
    passing = [n / 64 + 1 / 128 for n in range(PASSING_STOPS)]
    for stop in (0.0, *passing, 0.0, *passing):
        assert bases.at(stop, lambda: 70.0).residual.tolist() == [[0.25, 0.0], [0.0, 0.0]]
    assert (len(calls), {tension for _, tension in calls}) == (PASSING_STOPS + 1, {70.0})
    for stop, n in ((1.5, 2), (0.0, 2), (passing[1], 2), (passing[0], 3)):
        bases.at(stop, lambda: 70.0)
        assert len(calls) == PASSING_STOPS + n
    assert [bases.detune(p, 1.0) for p in planes] == [1.0, 4.0]
    assert bases.planes(None, 3.0, 1.0) == [3.0, 48.0]  # type: ignore[arg-type]
    with pytest.raises(BundleError, match=r"900 Hz leave 1 of the modes at stop 2; 112\.25 Hz need 2"):
        bases.at(2.0, lambda: 1.0)


def test_a_resonator_at_rest_has_its_lowest_frequency() -> None:
    basis = ModalBasis.real([300.0, 200.0], [0.1, 0.1], {"bridge": [0.0, 0.0]})
    assert held_freq(basis) == pytest.approx(200 / (2 * math.pi))
    assert frequencies.held_partials(basis, 1) == [pytest.approx(200 / (2 * math.pi))]


@pytest.mark.parametrize(
    ("zeros", "partials", "asked"),
    [
        ([100.0, 201.0, 303.0, 9.0], [100.0, 201.0, 303.0], [100.0, 200.0, 302.0]),
        ([100.0, 150.0], [100.0], [100.0, 200.0]),  # half a step on is not the next one
        ([100.0, 150.1, 200.0], [100.0, 150.1, 200.0], [100.0, 200.0, 200.2]),
        ([100.0, None], [100.0], [100.0, 200.0]),
        ([50.0], [], [100.0]),
        ([100.0, 241.0], [100.0, 241.0], [100.0, 200.0]),  # the next is searched below the highest mode alone
    ],
)
def test_partials_are_searched_a_step_above_the_last(
    monkeypatch: pytest.MonkeyPatch, zeros: list[float | None], partials: list[float], asked: list[float]
) -> None:
    left, starts = list(zeros), list[complex]()

    def newton(start: complex, steps: int) -> complex | None:
        starts.append(start / (2 * math.pi))
        freq = left.pop(0)
        return None if freq is None else complex(-0.1, 2 * math.pi * freq)

    monkeypatch.setattr(frequencies, "Joint", lambda ports: SimpleNamespace(newton=newton))
    monkeypatch.setattr(frequencies, "held_freq", lambda basis: 100.0)
    basis = ModalBasis.real([2 * math.pi * 380.0, 1.0], [0.1, 0.1], {"bridge": [1.0, 1.0]})
    assert frequencies.held_partials(basis, 3) == pytest.approx(partials)
    assert [s.imag for s in starts] == pytest.approx(asked)
    assert all(s.real == pytest.approx(-1e-4 * s.imag) for s in starts)


def test_names_have_sharps_unless_flats_are_wanted() -> None:
    assert [note_name(n) for n in (61, 70.25, 0, 59.5)] == ["C#4", "A#4+25", "C-1", "C4-50"]
    assert [note_name(n, flats=True) for n in (61, 70.25, 63)] == ["Db4", "Bb4+25", "Eb4"]


def test_a_pedal_lifts_its_dampers_by_eighths() -> None:
    pedals = Pedals(rises=0.2, free=0.6)
    assert [pedals.share(x) for x in (0.0, 0.2, 0.22, 0.23, 0.25, 0.4, 0.58, 0.6, 1.0)] == pytest.approx(
        [1, 1, 1, 49 / 64, 49 / 64, 1 / 4, 0, 0, 0]
    )
    assert (Pedals().rises, Pedals().free, Pedals().una_corda_stiffness) == (0.3, 0.7, 0.5)
    for rises, free in ((0.6, 0.6), (0.7, 0.6)):
        with pytest.raises(ValueError, match="rises must be below free"):
            Pedals(rises=rises, free=free)
    damper = Damper(from_bridge=0.1, resistance=1)
    for keys, moves in (({}, False), ({"una_corda": 1}, True), ({"damper": damper}, True)):
        assert Keys(entries={"C4": KeyEntry(note=60, strings=["a"], **keys)}).has_pedals is moves


@pytest.mark.parametrize(
    ("met", "una_corda", "factors"),
    [(2, False, [1, 1, 1]), (2, True, [0.25, 0.25, 0]), (None, True, [0.25] * 3), (3, True, [0.25] * 3)],
)
def test_the_soft_pedal_leaves_strings_out(met: int | None, una_corda: bool, factors: list[float]) -> None:
    group = ("a", "b", "c")
    string = SimpleNamespace(length=lambda stop: 0.5 - stop, tension=lambda stop: 70 + stop, polarizations=[1, 2],
                             group=group)  # fmt: skip
    entry = KeyEntry(note=60, strings=list(group), una_corda=met)
    keys: Keys | None = Keys(entries={"C4": entry}, pedals=Pedals(una_corda_stiffness=0.25))
    instrument = SimpleNamespace(spec=SimpleNamespace(keys=keys), key_of={"a": "C4"})
    model: Any = SimpleNamespace(strings={"a": string, "d": string}, instrument=instrument)
    place = Model.place(model, "a", 0.25, una_corda=una_corda)
    assert (place.name, place.length, place.planes, place.tension) == ("a", 0.25, 2, 70.25)
    assert dict(place.strings) == dict(zip(group, factors, strict=True))
    assert Model.place(model, "d", una_corda=una_corda).strings == ()


def test_effects_that_are_not_declared_always_run() -> None:
    choice = Choice("list", frozenset({"a"}), -80.0, 0.5)
    parts: list[Any] = [SimpleNamespace(effects=[SimpleNamespace(name=n) for n in names]) for names in ("", "ab", "b")]
    assert [choice.keeps(part) for part in parts] == [True, True, False]
    assert [choice.keeps(parts[1], name) for name in "abc"] == [True, False, True]


def test_banks_hear_forces_on_driven_points() -> None:
    points = {"p": BodyPoint((0, 0, 1)), "q": BodyPoint((0, 0, 1), driven=False)}
    scene: Any = SimpleNamespace(body_points=points, bridge_forces=[BridgeForce("k", "p", 3.0)])
    assert Microphones.at_points(None, "m", scene, -2.0) == (  # type: ignore[arg-type]
        ["p"], [Drive("m", "at_p", "k", -6.0)], {"p": (("m", "at_p", -2.0),)}
    )  # fmt: skip
    assert Microphones.at_points(None, "m", scene)[1] == [Drive("m", "at_p", "k", 3.0)]  # type: ignore[arg-type]
    drives, bank = [Drive("m", "at_p", "k", f) for f in (0.0, -1.0)], ModalBasis.real([1.0], [0.1], {"left": [1.0]})
    rows = Microphones.bank_rows(SimpleNamespace(channels=("left", "right")), "m", bank, drives, {})  # type: ignore[arg-type]
    assert rows.readouts == tuple(Readout(f"m.{c}", "displacement", (Term("m", c),)) for c in ("left", "right"))
    assert (rows.drives, rows.components) == ((drives[1],), {"m": bank})


def test_stems_share_forces_by_owner() -> None:
    """A readout of a bank, of the body and of a string: copies for each string and for the body's other forces."""
    basis = ModalBasis.real([1.0], [0.1], {"p": [1.0]})
    connections = [
        Connection("a.bridge", (Term("a", "bridge"), Term("body", "p", -2.0)), Rigid(), owner="a"),
        Connection("lump", (Term("body", "p", -1.0),), Rigid()),
    ]
    readouts = (
        Readout("r", "velocity", (Term("bank", "p", 3.0), Term("a", "x")), forces=(("a.bridge", 5.0), ("lump", 7.0))),
        Readout("s", "velocity", (Term("free", "x"),)),
    )
    group = OutputGroup("g", ("c", "d"), (0, 1), "velocity", "m/s", 1.0, "", columns=(0, 1))
    inputs = {"p": (("bank", "at", 4.0),)}
    given = Outputs((group,), readouts, {"bank": basis, "idle": basis}, (Drive("bank", "p", "a.bridge", 9.0),), inputs)
    out = outputs_by_string(given, connections, {"a": "a"}, ["a"], basis, ["p", "q"])
    assert [(g.name, g.readouts) for g in out.groups] == [("g.a", (0, 2)), ("g.body", (1, 3))]
    assert [(r.name, [(t.component, t.factor) for t in r.probes], r.forces) for r in out.readouts] == [
        ("r.a", [("bank.of_a", 3.0), ("a", 1.0)], (("a.bridge", 5.0),)),
        ("r.body", [("bank.of_body", 3.0)], (("lump", 7.0),)),
        ("s.a", [], ()),
        ("s.body", [("free", 1.0)], ()),
    ]
    assert set(out.components) == {"bank.of_a", "bank.of_body"}
    assert out.drives == (Drive("bank.of_a", "p", "a.bridge", 9.0),)
    assert out.body_inputs == {"p": (("bank.of_body", "at", 4.0),), "q": ()}
    body = Outputs((group,), (Readout("r", "velocity", (Term("body", "p"),)), readouts[1]), {}, (), {})
    out = outputs_by_string(body, connections, {"a": "a"}, ["a"], basis, ["p"])
    drives = [("body.of_a", "a.bridge", -2.0), ("body.of_body", "lump", -1.0)]
    assert out.drives == tuple(Drive(c, "p", k, factor, impulses=True) for c, k, factor in drives)
    assert out.body_inputs == {"p": (("body.of_body", "p", 1.0),)}


def fake_tuning(**values: Any) -> Any:
    stops = SimpleNamespace(count=2, freq=semitones, length=lambda stop: 0.6 * 2 ** (-stop / 12), string="A",
                            stopping=SimpleNamespace(compensate="each_stop", finger=None))  # fmt: skip
    return SimpleNamespace(**{"stops": stops, "_interpolates": False, "_gains": {}, **values})


@pytest.mark.parametrize(("bow", "n"), [(0.0, 5), (1.15e-3, 5), (1.16e-3, 9), (4.6e-3, 9), (4.7e-3, 17), (1.0, 33)])
def test_a_table_of_tensions_is_as_fine_as_a_cent_asks(bow: float, n: int) -> None:
    """log T = b s (1 - s): the middle of a step h misses the mean by b h^2 / 4, 600 / ln 2 times as much in cents."""
    fake = fake_tuning(_tune=lambda stop: (None, math.exp(2.0 + 4 * bow * stop * (1 - stop))))
    stops, log = StringTuning.table.func(fake)
    assert log == pytest.approx(2.0 + 4 * bow * stops * (1 - stops))
    assert n == 1 + 4 * 2 ** sum(600 / math.log(2) * bow * 4**-i > 1.0 for i in range(3))
    assert (len(stops), stops[0], stops[-1]) == (n, 0.0, 2.0)


@pytest.mark.parametrize(
    ("continuous", "compensate", "table"),
    [(True, "each_stop", True), (True, "open_only", False), (False, "each_stop", False), (True, "none", False)],
)
def test_a_slide_takes_its_tensions_from_a_table(continuous: bool, compensate: str, table: bool) -> None:
    fake = fake_tuning(_gains={0.0: 2.0})
    fake.stops.stopping.continuous, fake.stops.stopping.compensate = continuous, compensate
    other = StringTuning.interpolated(fake)
    assert (other is not fake) is table
    assert (other._interpolates, other._gains) == (table, {} if table else {0.0: 2.0})
    assert (fake._interpolates, fake._gains) == (False, {0.0: 2.0})


def test_what_a_live_player_may_need_is_computed_ahead() -> None:
    asked: list[Any] = []
    for interpolates in (False, True):
        StringTuning.prepare_all(
            fake_tuning(
                _interpolates=interpolates, _bend_gain=asked.append, tension=lambda stop: asked.append(("t", stop))
            )
        )
    assert asked == [0, 1, 2, ("t", 0.5), 0, 1, 2]
    asked.clear()
    fake = fake_tuning(
        _bend_gain=lambda stop: asked.append(("bend", stop)), tension=lambda stop: asked.append(("tension", stop)),
        under_finger=lambda stop: asked.append(("finger", stop)),
    )  # fmt: skip
    StringTuning.prepare(fake, [2, 0, 2], [1])
    fake.stops.stopping.finger = Finger()
    StringTuning.prepare(fake, [1])
    assert asked == [("bend", 1), ("tension", 0), ("tension", 2), ("finger", 1)]


def test_the_first_guess_of_a_tension_goes_with_the_square_of_the_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 Hz at 70 N: 110 Hz need 1.21 times as much; five times more or less is no such string."""
    asked: list[tuple[float, float]] = []
    fault = lambda reason, key: BundleError(reason, key=key)  # noqa: E731  # short
    resonator = SimpleNamespace(tension=70.0, basis=lambda high, tension: asked.append((high, tension)), fault=fault)
    fake = fake_tuning(
        resonator=resonator, _kept=None, _tension_held=False, freq=lambda stop: 110.0,
        untuned=SimpleNamespace(freq_upper=1000.0),
    )  # fmt: skip
    monkeypatch.setattr(string_tuning, "held_freq", lambda basis: 100.0)
    assert StringTuning._first_guess(fake) == pytest.approx(70.0 * 1.21)
    fake.untuned.freq_upper = 2000.0
    assert StringTuning._first_guess(fake) == pytest.approx(70.0 * 1.21)
    assert asked == [(1000.0, 70.0), (1320.0, 70.0)]
    for ratio, fits in ((4.9, True), (5.1, False), (1 / 4.9, True), (1 / 5.1, False)):
        fake.freq = lambda stop, ratio=ratio: 100.0 * math.sqrt(ratio)
        if fits:
            assert StringTuning._first_guess(fake) == pytest.approx(70.0 * ratio)
            continue
        with pytest.raises(
            BundleError, match=f"needs a tension of {70 * ratio:.3g} N where the bundle says 70 N; up to 5"
        ):
            StringTuning._first_guess(fake)
    monkeypatch.setattr(string_tuning, "held_freq", lambda basis: None)  # no mode below the limit
    assert StringTuning._first_guess(fake) == 70.0
    monkeypatch.setattr(string_tuning, "held_freq", lambda basis: pytest.fail("nothing is to be tuned"))
    fake._tension_held = True
    assert StringTuning._first_guess(fake) == 70.0
    fake._tension_held, fake.stops.stopping.compensate = False, "none"
    assert StringTuning._first_guess(fake) == 70.0
    fake._kept = SimpleNamespace(entries={"A": (71.5, None)})
    assert StringTuning._first_guess(fake) == 71.5
    fake._kept.entries = {"B": (71.5, None)}
    assert StringTuning._first_guess(fake) == 70.0


def test_tensions_between_stops_and_under_bends() -> None:
    fake = fake_tuning(
        _interpolates=True, table=(np.array([0.0, 1.0]), np.log([64.0, 81.0])), _tune=lambda s: (None, s)
    )
    assert StringTuning.tension(fake, 0.5) == pytest.approx(72.0)
    assert [StringTuning.tension(fake, s) for s in (1, 2)] == [1, 2]
    fake.stops.stopping.compensate = "open_only"
    assert StringTuning.tension(fake, 2) == 0.0
    bent: Any = SimpleNamespace(tension=lambda stop: 80.0, _bend_gain=lambda stop: 0.5)
    assert [StringTuning.bent(bent, 0, x) for x in (0.0, 1200.0, -1200.0)] == pytest.approx([80.0, 160.0, 40.0])


def test_cents_of_tension_per_cent_of_pitch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where f goes as T^p, a cent of pitch needs 1 / (2 p) cents of tension; between stops the gain is straight."""
    fake = fake_tuning(base=lambda stop: 0.5 if stop else 0.25, tension=lambda stop: 70.0)
    fake.resonator = SimpleNamespace(detuned=lambda power, tension: 100.0 * tension**power)
    fake._bend_gain = lambda stop: StringTuning._bend_gain(fake, stop)
    monkeypatch.setattr(string_tuning, "held_freq", lambda freq: freq)
    assert [fake._bend_gain(stop) for stop in (0, 1, 0.5)] == pytest.approx([2.0, 1.0, 1.0])
    fake._interpolates = True
    assert fake._bend_gain(0.25) == pytest.approx(1.75)
    for freq in (None, 100.0):
        monkeypatch.setattr(string_tuning, "held_freq", lambda _, freq=freq: freq)
        fake._gains = {}
        assert fake._bend_gain(0) == 1.0


def test_a_soft_finger_lies_nearer_to_the_bridge_by_its_compliance() -> None:
    finger = Finger()
    tensions = {0.0: 70.0, 1.0: 72.0, 2.0: 76.0}
    fake = fake_tuning(tension=lambda stop: 70.0, freq=semitones, _tune=lambda stop: (None, tensions[stop]))
    fake.base = lambda stop: SimpleNamespace(metadata={"bending_stiffness": 7e-5})
    fake.stops.stopping.finger = finger
    for compensate, stop, ideal in (("each_stop", 1.0, 72.0), ("each_stop", 1.25, 73.0), ("none", 1.0, 70.0)):
        fake.stops.stopping.compensate = compensate
        s, w = 2j * math.pi * semitones(stop), 2 * math.pi * finger.freq
        tip = finger.mass * (s * s + 2 * finger.damping_ratio * w * s + w * w)
        soft = (1 / (finger.skin_stiffness + finger.skin_damping * s) + 1 / tip).real
        length = 0.6 * 2 ** (-stop / 12) * math.sqrt(70.0 / ideal)
        assert StringTuning.under_finger(fake, stop) == pytest.approx(length + 0.5e-3 - 70.0 * soft, abs=1e-12)


def test_tunings_are_kept_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    written = list[bytes]()
    monkeypatch.setattr(kept_tunings, "_key", lambda instrument, limit: f"{instrument} {limit}")
    monkeypatch.setattr(kept_tunings, "read_kept", lambda *_: None)
    monkeypatch.setattr(kept_tunings, "keep", lambda folder, key, content: written.append(content))
    kept = KeptTunings("guitar", 900.0)  # type: ignore[arg-type]
    kept.save()
    assert (kept.entries, written) == ({}, [])
    tuned = TunedStop(110.1, 71.3, (CoupledMode(complex(-0.1, 691.7), (0.9, 0.05, 0.05), 1.625),))
    kept.add("A2", 70.0, tuned)
    kept.save()
    kept.save()
    (content,) = written
    assert kept_tunings._decoded(content) == {"A2": (70.0, tuned)} == kept.entries
    for before, after in ((b"110.1", b"110"), (b"1.625", b"true")):
        with pytest.raises(TypeError, match="is no number"):
            kept_tunings._decoded(content.replace(before, after))
    with pytest.raises(ValueError, match="no modes"):
        kept_tunings._entry({"modes": []})


def test_arrays_are_computed_once_and_the_last_sixteen_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("read_kept", lambda *_: None), ("keep", lambda *_: None), ("_RECENT", {})):
        monkeypatch.setattr(array_cache, name, value)
    calls: list[int] = []

    def arrays(n: int) -> array_cache.Arrays:
        return array_cache.cached_arrays({"n": n}, lambda: calls.append(n) or {"x": np.full(2, n)}, "support")

    for n in (*range(16), *range(16)):
        assert arrays(n)["x"].tolist() == [n, n]
    with pytest.raises(ValueError, match="read-only"):
        arrays(0)["x"][0] = 1
    arrays(0).clear()
    assert arrays(0)["x"].tolist() == [0, 0]
    for n in (16, 1, 0):
        arrays(n)
    assert calls == [*range(16), 16, 0]


@pytest.mark.parametrize("guess", [60.0, 69.9, 70.0, 71.0, 80.0])
@pytest.mark.parametrize("jump", [0.0, 20.0])
def test_a_tension_is_found_by_its_pitch_or_at_the_jump_over_it(guess: float, jump: float) -> None:
    """Pitch goes as the root of the tension, or jumps from 20 cents below the note at 70 N to 20 above."""
    tried: list[float] = []

    def pole(tension: float) -> complex:
        cents = 600 * math.log2(tension / 70.0) + (jump if tension > 70.0 else -jump)
        return complex(-1.0, 2 * math.pi * 110.0 * 2 ** (cents / 1200))

    string: Any = SimpleNamespace(
        joint=lambda tension: SimpleNamespace(newton=lambda s: pole(tension), tension=tension),
        poles=lambda joint, freq: tried.append(joint.tension) or [(pole(joint.tension), (1.0, 0.0))],
        modes=lambda tension, freq: (CoupledMode(pole(tension), (1.0, 0.0), 1.0),),
    )
    tuned = tune(string, 110.0, guess)
    assert tuned.tension == pytest.approx(70.0, rel=1e-5)
    assert abs(tuned.error_cents) == pytest.approx(jump, abs=0.01)
    assert len(tried) < 24  # the search ends by itself


def test_code_in_a_bundle_may_not_run_unasked() -> None:
    assert Instrument.allow_code is False


@pytest.mark.parametrize(
    ("freq", "n_modes", "beyond"), [(249.9, 0, False), (250.1, 1, True), (250.1, 2, False), (2000.0, 1, True)]
)
def test_keys_without_two_modes_below_the_limit_are_beyond_it(freq: float, n_modes: int, beyond: bool) -> None:
    """The limit is 0.98 / 1.06 of what is stepped, or of the string's own; a fourth of it is always far enough."""
    upper = list[float]()

    def basis(freq_upper: float, tension: float) -> SimpleNamespace:
        upper.append(freq_upper)
        return SimpleNamespace(n_modes=n_modes)

    instrument: Any = SimpleNamespace(
        spec=SimpleNamespace(strings={"a": SimpleNamespace(freq_upper=1e5), "b": SimpleNamespace(freq_upper=1060.0)}),
        tuning=SimpleNamespace(freq=lambda note: freq), open_note=lambda name: 60.0, key_of={"a": 1, "b": 1},
        resonators=dict.fromkeys("ab", SimpleNamespace(basis=basis, tension=70.0)),
    )  # fmt: skip
    assert _is_beyond(instrument, "a", 1060.0 / 0.98) is beyond
    assert _is_beyond(instrument, "b", 1e5) is beyond
    assert upper == pytest.approx([] if freq < 250 else [1000.0] * 2)
    instrument.key_of = {}
    assert not _is_beyond(instrument, "a", 1060.0 / 0.98)


def test_parts_on_a_string_have_places_and_names_of_their_own() -> None:
    class Pad:
        def fault(self, reason: str) -> BundleError:
            return BundleError(reason)

    fake: Any = SimpleNamespace(
        name="A", places=SimpleNamespace(points=("nut",)), touching={"a": Pad(), "b": Pad()},
        tuning=SimpleNamespace(stops=SimpleNamespace(open_length=0.6)),
    )  # fmt: skip

    def check(*places: dict[str, float] | None) -> None:
        StringModel._check_places(fake, [None if at is None else SimpleNamespace(places=at) for at in places])

    check(None, {"b.pad": 0.0})
    check({"a.pad": 0.6}, {"b.pad": 0.3})
    for places, said in (
        (({"bridge": 0.1}, None), "'bridge' on string A, which has a point of this name; names begin with the part's"),
        (({"pluck": 0.1}, None), "'pluck' on string A"), (({"nut": 0.1}, None), "'nut' on string A"),
        (({"x": 0.1}, {"x": 0.2}), "'x' on string A"),
        (({"x": -1e-3}, None), "-0.001 m from the bridge; 0 to 0.6 m are allowed"), (({"x": 0.601}, None), "0.601 m"),
    ):  # fmt: skip
        with pytest.raises(BundleError, match=re.escape(said)):
            check(*places)


def test_motion_is_carried_to_the_next_stop_by_the_string_its_finger_or_its_length(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(strings, "string_transfer", lambda old, new: ("along", old, new))
    monkeypatch.setattr(strings, "string_carry", lambda old, new, q, v: (2 * q, 3 * v))
    monkeypatch.setattr(strings, "laid_down", lambda old, new: (np.full((1, 2), 2.0), np.full((1, 2), 5.0)))
    resonator = SimpleNamespace(
        transfer=lambda old, new: ("own", old, new), carried=lambda old, new, q, v: (4 * q, 5 * v)
    )
    fake: Any = SimpleNamespace(
        name="A", components=("A.z", "A.x"), longitudinal=SimpleNamespace(component="A.x"), resonator=resonator,
        stopping=SimpleNamespace(finger=None),
    )  # fmt: skip
    fake._is_longitudinal = lambda component: StringModel._is_longitudinal(fake, component)
    short, long = (SimpleNamespace(metadata={"length": x}) for x in (0.5, 0.6))
    q, v = np.array([1.0, 2.0]), np.array([3.0, 4.0])

    def carried(component: str, old: Any, new: Any) -> list[list[float]]:
        return [part.tolist() for part in StringModel.carried(fake, component, old, new, q, v)]

    assert StringModel.transfer(fake, "A.x", short, long) == ("along", short, long)
    assert StringModel.transfer(fake, "A.z", short, long) == ("own", short, long)
    assert carried("A.x", short, long) == [[2.0, 4.0], [9.0, 12.0]]
    assert carried("A.x", short, short) == [[1.0, 2.0], [3.0, 4.0]]  # stays as it is
    assert carried("A.z", short, long) == [[4.0, 8.0], [15.0, 20.0]]
    fake.stopping.finger = Finger()
    assert carried("A.z", short, long) == [[6.0], [35.0]]
    assert StringModel.transfer(fake, "A.z", short, long)[1].tolist() == [[5.0, 5.0]]
    with pytest.raises(ValueError, match=r"string A has the components A\.z, A\.x, not 'A\.y'"):
        carried("A.y", short, long)
    fake.longitudinal = None
    assert StringModel.transfer(fake, "A.x", short, long)[0].tolist() == [[2.0, 2.0]]
