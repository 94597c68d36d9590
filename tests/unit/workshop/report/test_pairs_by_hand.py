"""Modes, wolf notes and figures of instruments side by side, by values worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from reports_by_hand import FREQ, compared, facts, mode, note, tone, wolf

import tonewood as tw
from tonewood.instrument.bundle.schema import Source
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.instrument.model.assembly import assemble
from tonewood.workshop.report import comparison
from tonewood.workshop.report import facts as report_facts
from tonewood.workshop.report.as_json import to_json
from tonewood.workshop.report.comparison import ModeMatch, WolfMatch, alike, match_modes
from tonewood.workshop.report.facts import BodyMode
from tonewood.workshop.report.parameters import ParameterValue, flattened

# -- pairs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("other", "one"),
    [
        (mode(200 * 2 ** (395 / 1200)), True),  # 395 of 400 cents
        (mode(200 * 2 ** (405 / 1200)), False),
        (mode(200 * 2 ** (-395 / 1200)), True),
        (mode(200.0, mass=0.1 * 10**1.45), True),  # 1.45 of 1.5 decades
        (mode(200.0, mass=0.1 * 10**1.55), False),
        (mode(200 * 2 ** (200 / 1200), mass=0.1 * 10**0.7), True),  # 0.5 + 0.47
        (mode(200 * 2 ** (200 / 1200), mass=0.1 * 10**0.8), False),
        (replace(mode(200.0), residue=0.0, mass=math.inf), True),  # nothing is known of its size
        (mode(200.0, shape=(1.0, 0.0)), True),  # nor of shapes of other strings
        (mode(200 * 2 ** (405 / 1200), shape=(1.0, 0.0)), False),
        (mode(-1.0), False),
    ],
)
def test_two_modes_are_one_within_400_cents_or_1_5_decades(other: BodyMode, one: bool) -> None:
    rows = match_modes([[mode(200.0)], [other]])
    assert [None in row.modes for row in rows] == ([False] if one else [True, True])


@pytest.mark.parametrize(("share", "one"), [(0.3, True), (0.2, False)])
def test_shapes_of_two_strings_count_by_their_modal_assurance(share: float, one: bool) -> None:
    """300 cents are 0.75; a share of 0.3 in common leaves 0.7 * ... : |psi_a^H psi_b|^2 = share."""
    shape = (math.sqrt(share) * 1j, math.sqrt(1 - share))
    rows = match_modes([[mode(200.0, shape=(1.0, 0.0))], [mode(200 * 2 ** (100 / 1200), shape=shape)]])
    assert (len(rows) == 1) is one  # 0.25 + 1 - share < 1


@pytest.mark.parametrize(("places", "cents", "one"), [(61, 3500, True), (61, 3700, False), (60, 450, False)])
def test_shapes_of_whole_surfaces_count_over_three_octaves(places: int, cents: float, one: bool) -> None:
    shape = tuple(np.full(places, places**-0.5))
    other = mode(200 * 2 ** (cents / 1200), mass=9.0 if one else 0.1, shape=shape)
    assert (len(match_modes([[mode(200.0, shape=shape)], [other]])) == 1) is one


def test_modes_of_three_instruments_are_rows_by_frequency() -> None:
    a, b, c = [mode(300.0)], [mode(100.0), mode(301.0)], [mode(299.0), mode(2000.0)]
    rows = match_modes([a, b, c])
    assert [[m and m.freq for m in row.modes] for row in rows] == [
        [None, 100.0, None], [300.0, 301.0, 299.0], [None, None, 2000.0]
    ]  # fmt: skip
    assert rows[1].cents(2) == pytest.approx(1200 * math.log2(299 / 300))
    assert (rows[1].cents(0), rows[0].cents(1), rows[2].cents(1)) == (0.0, None, None)
    assert match_modes([[], []]) == ()
    assert [row.modes for row in match_modes([[], a])] == [(None, a[0])]
    assert [row.modes for row in match_modes([a])] == [(a[0],)]


def test_cents_of_modes_need_both() -> None:
    match = ModeMatch((mode(100.0), None, mode(200.0)))
    assert [match.cents(i) for i in range(3)] == [0.0, None, pytest.approx(1200.0)]
    assert [ModeMatch((None, mode(100.0))).cents(i) for i in range(2)] == [None, None]
    wolves = WolfMatch((None, wolf("A", 90, 95, 3.0), wolf("A", 90, 95, 7.0)))
    assert wolves.severity_cents == 7.0


@pytest.mark.parametrize(
    ("other", "same"),
    [
        (mode(200 * (1 + 5e-6)), True),
        (mode(200 * (1 + 7e-6)), False),
        (mode(200.0, q=20 * (1 + 9e-5)), True),
        (mode(200.0, q=20 * (1 - 1.2e-4)), False),
        (mode(200.0, mass=0.1 * (1 + 9e-5)), True),
        (mode(200.0, mass=0.1 * (1 + 1.2e-4)), False),
        (None, False),
    ],
)
def test_modes_are_alike_within_a_hundredth_of_a_cent(other: BodyMode | None, same: bool) -> None:
    assert alike(ModeMatch((mode(200.0), mode(200.0), other))) is same
    assert not alike(ModeMatch((None, mode(200.0))))


@pytest.mark.parametrize(
    ("other", "one"),
    [
        (wolf("A", 220, 230, 1), True),  # its end touches
        (wolf("A", 190, 210, 1), True),
        (wolf("B", 210, 220, 1), False),
        (WolfNote("A", 221, 222, 215 * 2 ** (99 / 1200), 0.5, 9.0, 1.0, 215.0, ()), True),
        (WolfNote("A", 221, 222, 215 * 2 ** (101 / 1200), 0.5, 9.0, 1.0, 215.0, ()), False),
        (WolfNote("A", 221, 222, 215 * 2 ** (-101 / 1200), 0.5, 9.0, 1.0, 215.0, ()), False),
    ],
)
def test_wolf_notes_are_one_that_overlap_or_lie_within_a_semitone(other: WolfNote, one: bool) -> None:
    first = wolf("A", 210, 220, 5.0)
    rows = comparison.match_wolves([[first], [other]])
    assert [row.wolves for row in rows] == ([(first, other)] if one else [(first, None), (None, other)])


def test_notes_and_parameters_of_two_instruments_stand_side_by_side() -> None:
    a, b = [note("A", 0), note("A", 1)], [note("A", 1), note("B", 0)]
    rows = comparison.match_notes([a, b])
    assert [(m.string, m.stop, m.notes) for m in rows] == [
        ("A", 0, (a[0], None)), ("A", 1, (a[1], b[0])), ("B", 0, (None, b[1]))
    ]  # fmt: skip
    one = {"x": ParameterValue(1.0, "N"), "same": ParameterValue("a", ""), "old": ParameterValue(2, "")}
    other = {"new": ParameterValue(3, "m"), "x": ParameterValue(1.5, "N"), "same": ParameterValue("a", "")}
    found = comparison.differing([facts(parameters=one), facts("B", parameters=other)])
    assert [(row.key, row.values, row.unit) for row in found] == [
        ("x", (1.0, 1.5), "N"), ("old", (2, None), ""), ("new", (None, 3), "m")
    ]  # fmt: skip


def test_a_sweep_is_in_the_order_of_its_values() -> None:
    rows = [facts(label, parameters={"x": ParameterValue(v, "")}) for label, v in (("A", 2), ("B", 1.5), ("C", "no"))]
    found = compared(*rows, facts("D"), sweep="x")
    assert [(value, f.label) for value, f in found.swept()] == [(1.5, "B"), (2.0, "A")]
    assert replace(found, sweep="").swept() == []
    shown = to_json(found)["sweep"]
    assert (shown["key"], [(r["value"], r["label"]) for r in shown["rows"]]) == ("x", [(1.5, "B"), (2.0, "A")])
    assert shown["rows"][0]["figures"]["decay, median T60 of all stops"] == 1.0
    assert "sweep" not in to_json(compared(*rows))


def test_infinite_numbers_are_null_in_json() -> None:
    assert [comparison.finite(x) for x in (1.5, math.inf, -math.inf, math.nan, None)] == [1.5, None, None, None, None]
    still = replace(mode(100.0), q=math.inf, t60=math.inf, residue=0.0, mass=math.inf)
    quiet = tone("A2", level=(-10.0, -5.0, -30.127), lufs=-math.inf, peak_dbfs=-math.inf)
    lasting = note("A", 0, math.inf)
    one = facts(body_modes=(still,), tones={"A2": quiet}, notes=(lasting,), named={"T1": 0}, mass=0.2, kinds={"a": 3})
    source = Source(text="A book", licence="facts")
    found = to_json(compared(replace(one, sources={"k": source}, mobility={"A": 0.0123 + 0j * FREQ})))
    assert set(found["instruments"][0]["mobility"]["level_db"]["A"]) == {round(20 * math.log10(0.0123), 3)}
    found = to_json(compared(replace(one, sources={"k": source})))
    assert found["instruments"][0]["sources"] == {"k": {"text": "A book", "licence": "facts"}}
    assert found["modes"][0] == {
        "modes": [{"freq": 100.0, "q": None, "t60": None, "residue": 0.0, "mass": None}], "cents": [0.0]
    }  # fmt: skip
    shown = found["instruments"][0]
    assert shown["tones"]["A2"] == {
        "string": "A", "stop": 0.0, "freq": 110.0, "peak_dbfs": None, "lufs": None,
        "full_scale": 1.0, "unit": "Pa", "time": [0.0, 0.1, 0.2],
        "level_db": [-10.0, -5.0, -30.13],
    }  # fmt: skip
    assert shown["strings"][0]["partials"] == [{"number": 1, "freq": 110.0, "cents": 0.0, "t60": None}]
    assert (shown["named_modes"], shown["mass"], shown["provenance"]) == ({"T1": 100.0}, 0.2, {"a": 3})
    assert shown["mobility"]["level_db"]["A"] == [-40.0] * len(FREQ)
    assert shown["mobility"]["freq"] == [round(f, 4) for f in FREQ]
    assert found["notes"][0]["notes"][0] == {
        "note": "A2", "freq": 110.0, "cents": 0.5, "cents_mounted": 0.0, "t60": None, "tension": 60.0
    }  # fmt: skip


@pytest.mark.parametrize(
    ("other", "short", "heading"),
    [
        ({}, "A: box", "A: box"),
        ({"changes": ("x=1", "y=2")}, "A: x=1; y=2", "A: box (x=1; y=2)"),
        ({"called": "mine", "changes": ("x=1",)}, "A: mine", "A: mine (box; x=1)"),
        ({"called": "box"}, "A: box", "A: box"),
        ({"called": "m" * 36}, "A: " + "m" * 36, "A: " + "m" * 36 + " (box)"),
        ({"called": "m" * 37}, "A: " + "m" * 35 + "…", "A: " + "m" * 37 + " (box)"),
    ],
)
def test_names_of_instruments(other: dict[str, Any], short: str, heading: str) -> None:
    assert (facts(**other).short, facts(**other).heading) == (short, heading)


def test_members_of_lists_are_keys_by_their_name_or_number() -> None:
    value = {"a": {"b": 1, "c": []}, "d": [{"name": "x", "e": 2}, {"e": 3}], "f": [1, 2], "g": {}, "h": [[1, 2], [3]]}
    assert dict(flattened(value)) == {
        "a.b": 1, "a.c": [], "d.x.name": "x", "d.x.e": 2, "d.1.e": 3, "f": [1, 2], "g": {}, "h.0": [1, 2], "h.1": [3]
    }  # fmt: skip
    assert dict(flattened(5, "k")) == {"k": 5}


# -- facts -------------------------------------------------------------------------------------------------------------


def test_frequencies_of_mobility_are_even_and_the_modes_own() -> None:
    """500 per factor of 10 from 40 Hz to 10 kHz or 0.45 fs; each mode at f and f (1 +- zeta)."""
    body = SimpleNamespace(natural_freq=np.array([0.0, 20.0, 100.0, 9000.0]), damping_ratio=np.array([9, 0.1, 0.02, 3]))
    found = report_facts.frequencies(body, 48000.0)  # type: ignore[arg-type]
    assert (found[0], found[-1]) == pytest.approx((40.0, 10000.0))
    assert (np.diff(found) > 0).all()
    even = np.geomspace(40.0, 10000.0, int(500 * math.log10(250)))
    extra = [98.0, 100.0, 102.0, 9000.0]  # a ratio above 1 counts as 1: 0 and 18 kHz are outside
    np.testing.assert_allclose(found, np.unique(np.concatenate([even, extra])))
    assert report_facts.frequencies(body, 10000.0)[-1] == pytest.approx(4500.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(("plates", "whole"), [(0.2, 0.23), (None, None)])
def test_the_mass_of_a_body_is_with_what_is_on_it(monkeypatch: pytest.MonkeyPatch, plates: Any, whole: Any) -> None:
    for name in ("_strings", "_notes", "wolf_notes"):
        monkeypatch.setattr(report_facts, name, lambda *words: ())
    added = [{"at": "bridge", "mass": 0.01}, {"at": "bridge", "mass": 0.02}]
    model = assemble(tw.load_instrument("monochord").replace({"body.added": added}), 8000.0)
    monkeypatch.setattr(type(model.instrument.body), "mass", lambda body: plates)
    found = report_facts.gather(model, label="B", changes=("x=1",), called="mine")
    assert found.mass == (None if whole is None else pytest.approx(whole))
    assert (found.label, found.called, found.changes, found.fs) == ("B", "mine", ("x=1",), 8000.0)
    assert (len(found.added), found.name, found.tones, found.missing_tones) == (2, "monochord", {}, {})
    assert (found.strings, found.notes, found.wolves) == ((), (), ())


def test_modes_of_a_body_at_its_strings_and_alone() -> None:
    """Residues of ends a and b: means; a mode without loss rings for ever, one that no end moves has no mass."""
    shapes = np.array([[3.0, 0.0, 1.0], [4.0, 0.0, 2.0], [1.0, 1.0, 5.0]])
    omega = 2 * np.pi * np.array([200.0, 0.0, 100.0])
    body = SimpleNamespace(
        natural_freq=omega / 2 / np.pi, stiffness=omega**2, damping_rate=np.array([10.0, 0.0, 0.0]), right=shapes,
        n_modes=3, index={"a": 0, "b": 1, "c": 2}.get, residues=lambda p: shapes[{"a": 0, "b": 1, "c": 2}[p]] ** 2,
    )  # fmt: skip
    ends = {"A": {"a": 0.5, "c": 0.4}, "B": {"b": -1.0, "c": 0.9}}
    strings = {n: SimpleNamespace(polarizations=[SimpleNamespace(ends=e)]) for n, e in ends.items()}
    surface = SimpleNamespace(volumes=np.array([[0.0, 1.0, 3.0], [2.0, 1.0, 4.0]]))
    made = SimpleNamespace(
        body=SimpleNamespace(sources={500.0: surface}.get), spec=SimpleNamespace(body=SimpleNamespace(added=()))
    )
    model: Any = SimpleNamespace(
        body=body,
        strings=strings,
        groups=dict.fromkeys(strings),
        body_points={"a": 0, "c": 0},
        fs=1000.0,
        instrument=made,
    )
    still, low, high = report_facts.body_modes(model)
    assert (low.freq, high.freq) == pytest.approx((100.0, 200.0))
    assert (low.q, low.t60, high.q) == (math.inf, math.inf, pytest.approx(2 * np.pi * 200 / 20))
    assert high.t60 == pytest.approx(math.log(1000) / 10)
    assert (low.residue, high.residue, high.mass) == pytest.approx(((1 + 4) / 2, (9 + 16) / 2, 2 / 25))
    assert (still.residue, still.mass, still.freq) == (0.0, math.inf, 0.0)
    np.testing.assert_allclose(high.shape, [0.6, 0.8])
    np.testing.assert_allclose(still.shape, [0.0, 0.0])
    model.strings = model.groups = {}
    low, high = report_facts.body_modes(model)  # no rigid motion; shapes of the whole surface
    np.testing.assert_allclose([low.shape, high.shape], [[0.6, 0.8], [0.0, 1.0]])
    assert low.residue == (1 + 25) / 2  # at its points a and c
    made.spec.body.added = (1,)
    np.testing.assert_allclose(report_facts.body_modes(model)[0].shape, np.array([1.0, 5.0]) / math.sqrt(26))
    model.body_points = {}
    assert report_facts.body_modes(model)[0].mass == math.inf


def test_modes_of_a_loaded_body_are_named_like_those_without() -> None:
    """Own modes at 100 and 200 Hz; with a mass at 95, 150 and 190 Hz, of which the shape says which is T1."""
    own = SimpleNamespace(natural_freq=np.array([100.0, 200.0]), points=("p", "q"), right=np.array([[1.0, 1], [1, -1]]))
    right = np.array([[1.0, 2.0, 1.0], [1.0, -2.0, 0.9]])
    whole = SimpleNamespace(natural_freq=np.array([95.0, 150.0, 190.0]), right=right, index={"p": 0, "q": 1}.get)
    surface: Any = SimpleNamespace(labels=("A0", "T1"))
    body = SimpleNamespace(sources={500.0: surface}.get, basis={500.0: own}.get)  # up to half of the rate
    spec = SimpleNamespace(stops=SimpleNamespace(kind="none"))
    model: Any = SimpleNamespace(instrument=SimpleNamespace(body=body, spec=spec), body=whole, fs=1000.0)
    modes = [mode(95.0), mode(150.0), mode(190.0)]
    assert report_facts._named(model, modes) == {"A0": 0, "T1": 1}
    turned = np.array([[1.0, 1.0, 1.0], [2.0j, -2.0j, 0.5]])  # of complex modes the conjugate counts
    complex_own = SimpleNamespace(natural_freq=np.array([100.0]), points=("p", "q"), right=np.array([[1.0], [1.0j]]))
    near = SimpleNamespace(natural_freq=np.array([101.0, 99.0, 300.0]), right=turned, index=whole.index)
    apart: Any = SimpleNamespace(sources={500.0: SimpleNamespace(labels=("A0",))}.get, basis={500.0: complex_own}.get)
    with_complex: Any = SimpleNamespace(instrument=SimpleNamespace(body=apart, spec=spec), body=near, fs=1000.0)
    assert report_facts._named(with_complex, [mode(99.0), mode(101.0), mode(300.0)]) == {"A0": 1}
    surface.labels = ("top", "T1")
    assert report_facts._named(model, modes) == {"T1": 1}
    surface.labels = ("", "")
    assert report_facts._named(model, modes) == {}
    spec.stops.kind = "frets"
    fretted = [mode(f) for f in (100.0, 200.0, 300.0)]  # A0, then 1.4 to 2.8 times that
    assert report_facts._named(model, fretted)["T1"] == 1


def test_a_string_is_told_as_it_is_used() -> None:
    monochord = tw.load_instrument("monochord")
    model = assemble(monochord.replace({"strings.A2.tension": 55.0}), 16000)
    (row,) = report_facts._strings(model.instrument, model)
    string = model.strings["A2"]
    assert (row.name, row.note, row.length, row.linear_density) == ("A2", "A2", 0.9, 1.5e-3)
    assert (row.given_tension, row.held, row.stops) == (55.0, "pitch", 24)
    assert row.tension == string.tension(0) != 55.0
    assert [p.number for p in row.partials] == list(range(1, 13))
    assert row.feel.newton_per_mm == pytest.approx(1e-3 * row.tension * 0.9 / (0.15 * 0.75), rel=1e-9)
    rows = report_facts._notes(model)
    assert [(r.string, r.stop) for r in rows] == [("A2", k) for k in range(25)]
    assert [r.note for r in rows[:3]] == ["A2", "A#2", "B2"]
    np.testing.assert_allclose([r.freq for r in rows], 110.0 * 2 ** (np.arange(25) / 12))
