"""Figures put into an instrument, notes on its strings, moves of the search, and the cells of page, JSON and bundle."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from estimate_sounds import FS, GUITAR, analysed, partial, partials

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.sound.equalizer import response_db
from tonewood.workshop.estimate import estimate as whole
from tonewood.workshop.estimate import figures as figures_
from tonewood.workshop.estimate import gain, laws, page, pictures, pluck, search, yardstick
from tonewood.workshop.estimate.as_json import to_json
from tonewood.workshop.estimate.body_modes import HeardMode
from tonewood.workshop.estimate.bundle import RecordingOrigin, _provenance, write_bundle
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.estimate.playing import Stage, _columns, render_notes, seconds_of
from tonewood.workshop.estimate.recordings import Folder, Recording
from tonewood.workshop.estimate.room import RoomShare

OPEN = {"E2": 40, "A2": 45, "D3": 50, "G3": 55, "B3": 59, "E4": 64}


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage(Instrument.load(GUITAR))


@pytest.fixture(scope="module")
def begun(stage) -> figures_.Figures:
    return figures_.figures_of(stage)


def note(number, seconds=1.0, **figures) -> Recording:
    return Recording(f"{number}.wav", number, np.zeros(round(seconds * FS)), **figures)


# notes on strings


def test_notes_are_placed_lowest_position_first(stage) -> None:
    last = 19
    for number in (39, 40, 47, 64, 83, 84):
        wanted = sorted(
            ((name, float(number - low)) for name, low in OPEN.items() if 0 <= number - low <= last),
            key=lambda place: place[1],
        )
        assert stage.places(number) == wanted
        placed = stage.placed(note(number))
        assert (placed is None) == (not wanted)
        if placed is not None:
            assert (placed.string, placed.stop) == wanted[0]
            assert placed.length == pytest.approx(stage._strings[placed.string].length(placed.stop))
    assert stage.places(40.3) == [("E2", 0.0)]
    assert stage.span == "E2 to B5"
    assert stage.open_note("A2") == pytest.approx(45.0, abs=0.05)
    told = stage.placed(note(52, string="A2"))
    assert (told.string, told.stop) == ("A2", 7.0)
    at = stage.named(note(-1, string="A2", stop=3.0))
    assert at.note == 48
    assert stage.named(note(52)).note == 52
    part = stage.instrument.resolved["strings"]["A2"]
    assert (told.linear_density, told.bending_stiffness) == (part["linear_density"], part["bending_stiffness"])
    assert told.b == pytest.approx(np.pi**2 * told.bending_stiffness / told.tension / told.length**2)
    assert told.name == "E3 (52.wav)"
    assert stage.at_open("D3").recording.note == 50
    assert stage.at_open("D3").stop == 0.0


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (note(52, string="Z9"), "string 'Z9' does not exist; there are E2, A2, D3, G3, B3, E4"),
        (note(65, string="A2", stop=20.0), "stop 20 of string A2 does not exist; 0 to 19 are allowed"),
        (note(44, string="A2"), "stop -1 of string A2 does not exist"),
        (note(52, string="A2", stop=6.0), r"is E3; string A2 at stop 6 is D#3"),
    ],
)
def test_places_that_do_not_exist_are_told(stage, recording, said) -> None:
    with pytest.raises(TonewoodError, match=said):
        stage.placed(recording)
    assert stage.placed(note(64, string="A2", stop=19.0)).stop == 19.0


def test_seconds_of_notes_and_columns_of_outputs(stage) -> None:
    notes = [stage.placed(note(number, seconds)) for number, seconds in ((45, 1.0), (50, 9.0))]
    assert seconds_of(notes) == pytest.approx(1.4 + 3.6)
    assert search.seconds(notes, [], 3) == pytest.approx(5.0 * 4)
    assert search.seconds(notes, [(0,), (1,)], 3) == pytest.approx(5.0 * 5 + 5.0 * 2)
    channels = ["microphones.left", "microphones.right", "bridge"]
    assert _columns(channels, "microphones", False) == [0, 1]
    assert _columns(channels, "bridge", False) == [2]
    assert _columns(["left", "right"], "microphones", True) == [0, 1]
    assert len(search._shortened(note(45, 1.0)).samples) == round(0.8 * FS)


def test_rendered_notes_begin_80_ms_before_their_onset() -> None:
    """The last one is as long as the others where no damper ends it."""
    instrument = Instrument.load("monochord")
    stage = Stage(instrument)
    told = []
    notes = [stage.placed(note(number, 0.4, dynamic=d)) for number, d in ((45, 127.0), (45, 40.0), (57, None))]
    sounds = render_notes(instrument, notes, ["bridge"], told.append)
    assert [set(row) for row in sounds] == [{"bridge"}] * 3
    peaks = []
    for row in sounds:
        x = row["bridge"]
        assert len(x) == pytest.approx(round((0.4 + 0.08 - 0.05) * FS), abs=1)
        peaks.append(np.abs(np.diff(x[round(0.079 * FS) : round(0.085 * FS)])).max())
    first = sounds[0]["bridge"]
    assert 0.0795 < np.flatnonzero(np.abs(first) > 0.02 * np.abs(first).max())[0] / FS < 0.082
    assert peaks[0] > 2 * peaks[1]
    assert sum(told) == pytest.approx(0.6 + 3 * 0.8 - 0.4, abs=(1 << 14) / FS)


def test_a_note_goes_to_the_string_of_its_stiffness(stage) -> None:
    """Strings differ in B; a note told to lie on one stays; a set stiffer than the bundle's moves nothing."""
    low = [stage.placed(note(number)) for number in (59, 60, 61)]
    there = stage.at(low[0].recording, "G3", 4.0)
    analyses = [analysed(b=b) for b in (there.b, low[1].b, low[2].b)]
    placed, lines = whole.on_strings(low, analyses, stage)
    assert [(p.string, p.stop) for p in placed] == [("G3", 4.0), ("B3", 1.0), ("B3", 2.0)]
    assert len(lines) == 1
    assert lines[0].startswith("B3 (59.wav): taken for string G3, stop 4")
    assert whole.on_strings(low, [analysed(b=2.5 * p.b) for p in low], stage) == (tuple(low), [])
    told = [stage.placed(note(59, string="B3", stop=0.0))]
    assert whole.on_strings(told, analyses[:1], stage) == (tuple(told), [])
    assert whole.on_strings(low[:1], [analysed(b=1.69 * low[0].b)], stage)[1] == []
    assert whole.on_strings(low[:1], [analysed(b=np.nan)], stage)[1] == []


def test_halves_alternate_by_pitch() -> None:
    notes = [SimpleNamespace(recording=SimpleNamespace(note=n)) for n in (50, 50, 40, 61, 45)]
    assert whole.alternating(notes) == ((0, 1, 2), (3, 4))


# figures


def test_figures_are_those_of_the_bundle(stage, begun) -> None:
    strings = stage.instrument.resolved["strings"]
    assert set(begun.laws) == set(OPEN)
    for name, law in begun.laws.items():
        assert [strings[name]["loss"][k] for k in law.names] == law.values.tolist()
        assert law.string.tension == pytest.approx(stage._strings[name].tension(0.0))
        assert begun.bending[name] == law.string.bending_stiffness == strings[name]["bending_stiffness"]
    exciter = stage.instrument.resolved["exciters"]["pluck"]
    velocity = stage.instrument.resolved["playing"]["velocity"]
    assert begun.place == exciter["from_bridge"]
    assert begun.edge == stage.instrument.exciters["pluck"].parameters.tip.edge
    assert begun.forces == (velocity["low"], velocity["high"])
    assert begun.split == np.median([part["scatter"]["split_cents"] for part in strings.values()])
    assert set(begun.gains) == {"microphones", "bridge", "listener"}
    assert not any(np.any(curve) for curve in begun.gains.values())
    assert figures_.split_key(stage.instrument) == "scatter.split_cents"
    assert not figures_.in_fractions(stage.instrument)
    tables = figures_.mode_tables(stage.instrument)
    assert set(tables) == {"body", "outputs.microphones"}
    rows = list(csv.DictReader(r for r in (stage.instrument.folder / "body.csv").open() if not r.startswith("#")))
    assert tables["body"][0] == pytest.approx([float(row["f_Hz"]) for row in rows])
    assert search._body_table(stage.instrument) == [f for f in tables["body"][0] if f < 525.0]
    assert begun.overrides(stage.instrument) == {
        f"strings.{name}.{key}": pytest.approx(value, rel=1e-4)
        for name, law in begun.laws.items()
        for key, value in {
            **{f"loss.{n}": v for n, v in zip(law.names, law.values, strict=True)},
            "bending_stiffness": begun.bending[name],
            "scatter.split_cents": begun.split,
        }.items()
    } | {"exciters.pluck.from_bridge": begun.place}


def test_overrides_put_figures_into_the_instrument(stage, begun) -> None:
    """Five digits; a mode that hardly moves stays; the gain is on top of the equalizer that an output has."""
    near = float(figures_.mode_tables(stage.instrument)["body"][0][2])
    curve = 3.0 * np.sin(np.arange(15) / 3)
    moved = replace(
        begun,
        place=0.1234567,
        split=2.5,
        edge=5e-4,
        forces=(0.2, 4.0),
        gains={**begun.gains, "microphones": curve},
        modes={near: (1.1, 2.0), 102.0: (1.002, 1.02)},
    )
    made = stage.instrument.replace(moved.overrides(stage.instrument))
    assert made.resolved["exciters"]["pluck"]["from_bridge"] == 0.12346
    assert made.resolved["exciters"]["pluck"]["edge"] == 5e-4
    assert [made.resolved["playing"]["velocity"][k] for k in ("low", "high")] == [0.2, 4.0]
    assert {part["scatter"]["split_cents"] for part in made.resolved["strings"].values()} == {2.5}
    (body,), (microphones,) = moved.moved_modes(stage.instrument).values()
    freq, q = figures_.mode_tables(stage.instrument)["body"]
    assert body == pytest.approx({"near": freq[2], "freq": 1.1 * freq[2], "q": 2.0 * q[2]}, rel=1e-4)
    other, other_q = figures_.mode_tables(stage.instrument)["outputs.microphones"]
    assert microphones == pytest.approx({"near": other[1], "freq": 1.1 * other[1], "q": 2 * other_q[1]}, rel=1e-4)
    assert replace(begun, modes={near * 1.1: (1.2, 1.0)}).moved_modes(stage.instrument) == {}
    assert replace(begun, modes={near: (1.0, 1.04)}).moved_modes(stage.instrument)["body"][0]["freq"] == pytest.approx(
        near, rel=1e-4
    )
    bands = [(b.freq, b.gain_db, b.q) for b in made.spec.outputs[0].equalizer]
    own = [(b.freq, b.gain_db, b.q) for b in stage.instrument.spec.outputs[0].equalizer]
    away = response_db(bands, gain.KNOTS) - response_db(own, gain.KNOTS) - curve
    assert np.ptp(away) < 1.0
    assert "outputs.bridge.equalizer" not in moved.overrides(stage.instrument)
    again = figures_.figures_of(Stage(made))
    assert (again.place, again.edge, again.forces, again.split) == (0.12346, 5e-4, (0.2, 4.0), 2.5)


def test_a_place_in_fractions_stays_one(stage, begun) -> None:
    made = stage.instrument.replace({"exciters.pluck.from_bridge": {"fraction": 0.2}})
    assert figures_.in_fractions(made)
    assert figures_._place_now(made) == 0.2
    assert replace(begun, place=0.31).overrides(made)["exciters.pluck.from_bridge"] == {"fraction": 0.31}


# moves


def bare(stage, begun, **figures):
    out = search.Search.__new__(search.Search)
    out.stage, out.start, out.outputs = stage, begun, ("microphones", "bridge", "listener")
    out.body_table, out._advance = search._body_table(stage.instrument), lambda seconds: None
    for name, value in figures.items():
        setattr(out, name, value)
    return out


def test_stiffness_moves_by_the_median_ratio_of_b(stage, begun) -> None:
    notes = [stage.placed(note(n)) for n in (45, 46, 47, 48, 50)]
    recorded = [analysed(b=b) for b in (1.2, 1.4, 4.0, np.nan, 2.0)]
    values, bending = bare(stage, begun)._strings(begun, notes, recorded, [analysed(b=1.0)] * 5)
    assert values == {}
    assert bending == pytest.approx({"A2": 1.3 * begun.bending["A2"], "D3": 2.0 * begun.bending["D3"]})


def test_loss_moves_with_eight_partials_or_more(stage, begun) -> None:
    notes = [stage.placed(note(45))]
    law = begun.laws["A2"]
    for count, told in ((7, False), (8, True)):
        freq = 220.0 * np.arange(1, count + 1)
        rows = [
            analysed(
                partials=[
                    partial(i, freq=f, rate=r) for i, (f, r) in enumerate(zip(freq, by * law.rate(freq), strict=True))
                ]
            )
            for by in (2.0, 1.0)
        ]
        values, _ = bare(stage, begun)._strings(begun, notes, rows[:1], rows[1:])
        assert ("A2" in values) is told
        if told:
            assert law.rate(freq, values["A2"]) == pytest.approx(2 * law.rate(freq), rel=0.15)
        assert bare(stage, begun, keeps_loss=True)._strings(begun, notes, rows[:1], rows[1:])[0] == {}


@pytest.mark.parametrize(("shift", "wanted"), [(0.02, 0.125), (0.1, 0.145), (-0.03, 0.075), (-0.2, 0.065)])
def test_the_place_moves_by_40_mm_at_most(stage, begun, monkeypatch, shift, wanted) -> None:
    notes = [stage.placed(note(n)) for n in (45, 50)]
    said = []
    monkeypatch.setattr(pluck, "places", lambda *args: said.append(args) or SimpleNamespace(moved=shift))
    longest = max(p.length for p in notes)
    assert bare(stage, begun)._place(begun, notes, [], []) == pytest.approx(wanted)
    assert said[0][3] == pytest.approx(0.4 * longest)
    assert bare(stage, begun)._place(replace(begun, place=None), notes, [], []) is None
    near = replace(begun, place=0.03)
    assert bare(stage, begun)._place(near, notes, [], []) == pytest.approx(
        max(0.03 + np.clip(shift, -0.04, 0.04), 0.02 * longest)
    )
    fractions = SimpleNamespace(
        stage=SimpleNamespace(instrument=stage.instrument.replace({"exciters.pluck.from_bridge": {"fraction": 0.2}}))
    )
    step = np.clip(shift, -0.04, 0.04) / np.median([p.length for p in notes])
    assert search.Search._place(fractions, replace(begun, place=0.2), notes, [], []) == pytest.approx(0.2 + step)
    monkeypatch.setattr(pluck, "places", lambda *args: None)
    assert bare(stage, begun)._place(begun, notes, [], []) == begun.place


def test_body_modes_move_by_the_ratios_of_recorded_and_rendered(stage, begun) -> None:
    def heard(*rows):
        return tuple(HeardMode(f, q, (f, f), (q, q), 1.0) for f, q in rows)

    table = search._body_table(stage.instrument)
    told = iter([heard((200.0, 8.0), (400.0, 9.0)), heard((220.0, 10.0), (101.0, 30.0))])
    out = bare(stage, begun, body_modes=lambda rows: next(told))._modes(begun, [], [])
    near = min(table, key=lambda f: abs(np.log(f / 220.0)))
    assert out == {near: pytest.approx((200 / 220, 0.8))}  # 400 Hz is more than 1.2 times any
    told = iter([heard((210.0, 80.0)), heard((200.0, 10.0))])
    again = bare(stage, begun, body_modes=lambda rows: next(told))._modes(replace(begun, modes=out), [], [])
    assert again == {near: pytest.approx((200 / 220 * 1.05, 1.6))}
    assert bare(stage, begun, body_table=[])._modes(begun, [], []) == {}


def test_gains_of_the_outputs_that_are_told_move(stage, begun) -> None:
    loud, quiet = np.full((4, 21), -10.0), np.full((4, 21), -10.0)
    loud += 3 * np.log(np.geomspace(100, 10079.4, 21))
    now = search.RenderedNotes((), {"bridge": (analysed(bands=quiet),)})
    start = replace(begun, gains={**begun.gains, "bridge": np.ones(15)})
    moved = bare(stage, begun).with_gains(start, [analysed(bands=loud)], now, ["bridge"])
    assert np.diff(moved.gains["bridge"]) == pytest.approx(3 * np.diff(np.log(gain.KNOTS)), rel=0.02)
    assert moved.gains["bridge"].mean() == pytest.approx(1.0, abs=0.01)
    assert not np.any(moved.gains["microphones"])


def test_strokes_set_the_range_of_forces_and_the_edge(stage, begun) -> None:
    """Rendered peaks grow by 6 dB where 9 are recorded: the range in dB grows by 1.5; sharper edges brighten more."""
    notes = [stage.at(note(45 + i, dynamic=d), "A2", float(i)) for i in range(3) for d in (40.0, 100.0)]
    recorded = [analysed(peak=p, bright=b) for _ in range(3) for p, b in ((-20.0, -30.0), (-11.0, -26.0))]
    calls = []

    def render(figures, strokes):
        calls.append(len(strokes[0].recording.samples))
        bright = 8.0 * np.log(figures.edge / begun.edge) / np.log(3.3) + 2.0
        return SimpleNamespace(
            main=[analysed(peak=p, bright=b) for _ in range(3) for p, b in ((-20.0, -30.0), (-14.0, -30.0 + bright))]
        )

    found = bare(stage, begun, render=render).with_strokes(begun, notes, recorded)
    assert found.forces == pytest.approx(pluck.scaled_forces(begun.forces, 1.5))
    assert found.edge == pytest.approx(begun.edge * 3.3**0.25, rel=0.03)
    assert set(calls) == {round(0.8 * FS)}
    assert len(calls) == 8
    assert bare(stage, begun).with_strokes(begun, notes[:4], recorded[:4]) is begun
    alone = replace(begun, edge=None)
    assert bare(stage, begun).with_strokes(alone, notes, recorded) is alone


def test_intervals_of_b_and_of_strings_with_notes(stage, begun, monkeypatch) -> None:
    monkeypatch.setattr(laws, "bootstrap", lambda rates, law, rng: len(rates))
    notes = [stage.placed(note(n)) for n in (45, 46, 47, 48, 50)]
    recorded = [analysed(b=b) for b in (1.1, 1.1, 3.1, np.nan, 0.5)]
    found = whole._b_spread(notes, recorded, [analysed(b=1.0)] * 5, np.random.default_rng(1))
    assert found == {"A2": (2, pytest.approx(1.1), pytest.approx(1.1)), "D3": (1, 0.5, 0.5)}
    freq = 220.0 * np.arange(1, 9)
    rows = [
        analysed(partials=[partial(i, freq=f, rate=3.0 + i) for i, f in enumerate(freq[:count])]) for count in (8, 7)
    ]
    told = replace(begun, estimated={"A2": True, "D3": True})
    at = [stage.placed(note(45)), stage.placed(note(50))]
    assert whole._intervals(told, at, rows, [], np.random.default_rng(1)) == {"A2": 8}
    assert whole._intervals(begun, at, rows, [], np.random.default_rng(1)) == {}


def test_no_loss_is_unknown_without_halves() -> None:
    assert whole.loss_is_unknown([]) is False


# the result


def apart(value, notes=3) -> Distance:
    return Distance(value, value + 1, value + 2, value + 3, value + 4, value + 5, notes, 7)


@pytest.fixture(scope="module")
def result(stage, begun) -> whole.Estimate:
    numbers = (45, 47, 52, 57)
    sounds = {n: partials(440 * 2 ** ((n - 69) / 12), 1e-4, np.full(12, 4.0), seconds=1.0)[0] for n in numbers}
    notes = tuple(stage.placed(replace(note(n), samples=x)) for n, x in sounds.items())
    analyses = tuple(
        analysed(f0=110.0 + i, b=1e-4 * (i + 1), onset=0.1, rise=0.003, partials=[partial(j + 2) for j in range(i + 1)])
        for i in range(4)
    )
    law = begun.laws["A2"]
    near = search._body_table(stage.instrument)[2]
    after = replace(
        begun,
        place=0.13,
        split=2.0,
        edge=5e-4,
        forces=(0.2, 4.0),
        modes={near: (0.9, 1.5)},
        laws={**begun.laws, "A2": replace(law, values=2 * law.values)},
        bending={**begun.bending, "A2": 5e-5},
        gains={**begun.gains, "microphones": np.linspace(-2, 2, 15)},
        estimated={"A2": True},
    )
    trades = np.array([[1, -0.8, 0.1, 0], [-0.8, 1, 0, 0], [0.1, 0, 1, -0.6], [0, 0, -0.6, 1.0]])
    interval = laws.Interval(
        np.outer([0.81, 1.21], [1.0, 2, 3, 4]),
        np.array([[1e-5, 0.01, 1.0], [2e-4, 0.04, 3.0]]),
        np.array([1e-3, 2e-3]),
        trades,
    )
    played = {i: 0.5 * p.recording.samples for i, p in enumerate(notes)}
    halves = tuple(
        whole.Half(
            fitted, held, apart(2.0 + k), apart(1.0 + k), {i: played[i] for i in held}, {i: 2 * played[i] for i in held}
        )
        for k, (fitted, held) in enumerate([((0, 2), (1, 3)), ((1, 3), (2, 0))])
    )
    shown = search.RenderedNotes(tuple(played.values()), {"microphones": analyses})
    return whole.Estimate(
        instrument=stage.instrument.replace(after.overrides(stage.instrument)),
        begun_with=stage.instrument,
        notes=notes,
        recorded=analyses,
        figures=after,
        start=begun,
        before=apart(5.0, 4),
        after=apart(4.0, 4),
        halves=halves,
        scale={"strokes of one note": apart(0.5, 0), "next semitone": apart(0.6, 2)},
        intervals={"A2": interval},
        gain_interval=np.array([np.full(15, -1.5), np.full(15, 0.5)]),
        b_spread={"A2": (4, 0.9, 1.1)},
        places=pluck.PluckPlaces(0.13, 0.128, 0.0042, 4),
        louder=(pluck.Louder(9.0, 4.0, 60.0, 3), pluck.Louder(np.nan, 3.0, 60.0, 3)),
        rendered=shown,
        body_modes=(
            HeardMode(0.92 * near, 12.0, (190.0, 200.0), (10.0, 14.0), 0.9),
            HeardMode(120.0, 9.0, (119.0, 121.0), (8.0, 10.0), 0.8),
        ),
        room=RoomShare("studio", -6.0, (-8.0, -4.0), 5.0, 3.0, 6),
        moved=("a line",),
        warnings=("a warning",),
    )


def test_json_has_the_figures(result) -> None:
    out = json.loads(json.dumps(to_json(result), allow_nan=False))
    law = result.figures.laws["A2"]
    string = out["strings"]["A2"]
    assert string["loss"] == pytest.approx(dict(zip(law.names, law.values, strict=True)))
    assert string["bending_stiffness"] == 5e-5
    assert string["bending_stiffness_before"] == result.start.bending["A2"]
    assert string["own_notes"]
    assert not out["strings"]["E2"]["own_notes"]
    assert "rate_1/s_90 %" not in out["strings"]["E2"]
    assert list(string["rate_1/s"].values()) == pytest.approx(law.rate(laws.STATED))
    assert string["rate_1/s_90 %"] == {
        f"{f}": pytest.approx([0.81 * i, 1.21 * i]) for i, f in enumerate(laws.STATED, 1)
    }
    assert string["loss_90 %"] == {"eta_f": [1e-5, 2e-4], "eta_b": [0.01, 0.04], "eta_a": [1.0, 3.0]}
    assert string["bridge_per_period_90 %"] == [1e-3, 2e-3]
    assert string["trades"] == [
        {"between": ["eta_f", "eta_b"], "rank_correlation": -0.8},
        {"between": ["eta_a", "bridge"], "rank_correlation": -0.6},
    ]
    assert string["B_ratio_90 %"] == {"notes": 4, "low": 0.9, "high": 1.1}
    assert out["place"] == {"value": 0.13, "before": result.start.place, "scatter_m": 0.0042, "notes": 4}
    assert out["split_cents"] == {"value": 2.0, "before": result.start.split}
    assert out["gain_db"]["freq_Hz"] == pytest.approx(gain.KNOTS)
    assert out["gain_db"]["microphones"] == pytest.approx(np.linspace(-2, 2, 15))
    assert out["gain_db"]["90 %"] == [[-1.5] * 15, [0.5] * 15]
    assert out["louder"][0] == {
        "peak_dB": 9.0,
        "share_3_to_8_kHz_dB": 4.0,
        "per_7_dB": pytest.approx(28 / 9),
        "pairs": 3,
    }
    assert out["louder"][1]["peak_dB"] is None
    assert (out["edge_m"]["value"], out["forces_N"]["value"], out["forces_N"]["before"]) == (
        5e-4,
        [0.2, 4.0],
        list(result.start.forces),
    )
    assert out["body_modes"][1]["q_interval"] == [8.0, 10.0]
    (near,) = result.figures.modes
    assert out["moved_modes"] == [{"near_Hz": near, "freq_ratio": 0.9, "q_ratio": 1.5}]
    assert out["room"]["mix_db"] == -6.0
    assert [out["distances"]["all notes"][k]["third_octaves"] for k in ("before", "after")] == [5.0, 4.0]
    assert [half["fitted"] for half in out["distances"]["held back"]] == [[0, 2], [1, 3]]
    assert [half["after"]["onset"] for half in out["distances"]["held back"]] == [2.0, 3.0]
    assert set(out["distances"]["scale"]) == {"next semitone"}
    assert out["notes"][1] == {
        "file": "47.wav",
        "note": 47,
        "string": "A2",
        "stop": 2.0,
        "f0_Hz": 111.0,
        "B": 2e-4,
        "partials": 2,
        "onset_s": 0.1,
        "rise_s": 0.003,
    }
    assert (out["moved"], out["warnings"], out["begun_with"]) == (["a line"], ["a warning"], GUITAR)
    bare_ = json.loads(json.dumps(to_json(replace(result, room=None, louder=None, places=None))))
    assert (bare_["room"], bare_["louder"], bare_["place"]) == (
        None,
        None,
        {"value": 0.13, "before": result.start.place},
    )


def test_lines_of_the_page_have_the_figures(result) -> None:
    assert (
        page.place_line(result) == "Place of the pluck: 0.13, begun with 0.105; places of single notes scatter by 4 mm."
    )
    assert page.place_line(replace(result, figures=replace(result.figures, place=None))) == ""
    assert page.split_line(result).startswith(
        "Splitting of the polarizations: 2 cents (standard deviation), begun with 4;"
    )
    assert page.split_line(replace(result, start=replace(result.start, split=None))) == ""
    line = page.louder_line(result)
    assert (
        "recorded +4.0 dB of 3 to 8 kHz and +9.0 dB of peak; computed +3.0 dB of 3 to 8 kHz (peaks were normalised)."
        in line
    )
    assert "Edge of the finger: 0.5 mm, begun with 0.28 mm; forces at velocity 1 and 127: " in line
    assert line.endswith("0.2 to 4 N, begun with 0.12 to 5 N.")
    assert line.startswith("From soft to loud, 3 pairs: ")
    same = replace(result, figures=replace(result.figures, forces=result.start.forces))
    assert "forces" not in page.louder_line(same)
    still = replace(result, figures=replace(result.figures, edge=result.start.edge))
    assert "Edge" not in page.louder_line(still)
    assert page.louder_line(replace(result, louder=None)) == ""
    first, second = page.mode_lines(result)
    assert first.startswith("Body mode at 199.1 Hz (190 to 200), Q 12 (10 to 14): frequency of the bundle's mode ")
    assert first.endswith("at 216.4 Hz times 0.9, Q times 1.5.")
    assert second.endswith("Q 9 (8 to 10): not moved: no mode of the bundle's tables sounds near it.")
    assert "studio with a mix of -6.0 dB (-8.0 to -4.0)" in page.room_line(result)
    assert "5.0 dB, with it 3.0 dB, 6 notes." in page.room_line(result)
    wide = replace(result, room=replace(result.room, interval=(-20.0, 3.0)))
    assert page.room_line(wide) == "Room: not told by these notes; a mix of -20.0 to +3.0 dB of studio would do."
    assert page.room_line(replace(result, room=None)) == ""
    assert {k: d.third_octaves for k, d in page.columns_of(result).items()} == {
        "held back 1: before": 2.0,
        "held back 1: after": 1.0,
        "held back 2: before": 3.0,
        "held back 2: after": 2.0,
        "all: before": 5.0,
        "all: after": 4.0,
        "next semitone": 0.6,
    }
    assert page.shown_strings(result) == list(OPEN)
    many = dict.fromkeys([f"s{i}" for i in range(12)] + ["A2"], result.figures.laws["A2"])
    assert page.shown_strings(replace(result, figures=replace(result.figures, laws=many))) == ["A2"]
    many.pop("s0")
    assert len(page.shown_strings(replace(result, figures=replace(result.figures, laws=many)))) == 12
    string = page._string(result, "A2")
    assert (string["count"], string["own"], string["b"]) == (2, True, pytest.approx(5e-5 / result.start.bending["A2"]))
    rates = result.figures.laws["A2"].rate(laws.STATED)
    assert string["rates"] == [(pytest.approx(r), pytest.approx(1.1 / 0.9 - 1)) for r in rates]
    assert page._string(result, "E2")["rates"][0][1] is None
    rows = page._parameters(result, "A2")
    assert [row["trades"] for row in rows] == [
        "eta_b (\N{MINUS SIGN}0.80)",
        "eta_f (\N{MINUS SIGN}0.80)",
        "bridge (\N{MINUS SIGN}0.60)",
    ]
    assert [(row["value"], row["low"], row["high"]) for row in rows] == [
        ("0.00014", "1e-05", "0.0002"),
        ("0.05", "0.01", "0.04"),
        ("1.8", "1", "3"),
    ]


def test_sounds_that_are_heard(result) -> None:
    """Low, middle and high notes of each half, in the order of pitch; one rms, a lead of 30 ms, a fade at the end."""
    assert page.heard(result) == [(1, 0), (0, 1), (1, 2), (0, 3)]
    many = replace(result.halves[0], held_back=(0, 1, 2, 3))
    assert page.heard(replace(result, halves=(many,))) == [(0, 0), (0, 2), (0, 3)]
    x, _ = partials(220.0, 1e-4, np.full(5, 1.0), seconds=4.0, before=0.5)
    cut = page._cut(x, 220.0)
    assert len(cut) == 3 * FS
    assert np.sqrt(np.mean(cut[:FS] ** 2)) == pytest.approx(0.08)
    assert np.flatnonzero(np.abs(cut) > 1e-9)[0] / FS == pytest.approx(0.03, abs=0.003)
    early = page._cut(x[round(0.5 * FS) :], 220.0)
    assert np.flatnonzero(np.abs(early) > 1e-9)[0] / FS == pytest.approx(0.03, abs=0.003)
    click = np.zeros(FS)
    click[5000:5010] = 1.0
    assert np.abs(page._cut(click, 220.0)).max() == pytest.approx(0.9)
    faded = page._faded(np.ones(FS))
    assert faded[: FS - 2205].tolist() == [1.0] * (FS - 2205)
    assert faded[FS - 2205 :] == pytest.approx(np.linspace(1, 0, 2205))
    assert page._faded(np.ones(3)).tolist() == [1.0, 0.5, 0.0]


def test_pictures_show_the_figures(result, monkeypatch) -> None:
    drawn = []
    monkeypatch.setattr(pictures, "svg", lambda made: drawn.append(made) or b"")
    monkeypatch.setattr(pictures, "png", lambda made, dpi: drawn.append(made) or b"")
    pictures.gain_picture(result)
    (line,) = drawn[0].axes[0].lines
    assert line.get_xdata() == pytest.approx(gain.KNOTS)
    assert line.get_ydata() == pytest.approx(np.linspace(-2, 2, 15))
    band = drawn[0].axes[0].collections[0].get_paths()[0].vertices
    assert (band[:, 1].min(), band[:, 1].max()) == pytest.approx((-3.0, 3.0))
    clear = tuple(analysed(f0=110.0, partials=[partial(3, freq=330.0 + i, rate=2.0 + i)]) for i in range(4))
    shown = replace(result, recorded=clear, rendered=search.RenderedNotes((), {"m": clear[::-1]}))
    assert pictures.rates_picture(shown, ["E2"]) is None
    pictures.rates_picture(shown, list(OPEN))
    recorded, computed, law = drawn[1].axes[0].lines
    assert (recorded.get_xdata().tolist(), recorded.get_ydata().tolist()) == ([330.0, 331.0], [2.0, 3.0])
    assert (computed.get_xdata().tolist(), computed.get_ydata().tolist()) == ([333.0, 332.0], [5.0, 4.0])
    freq = law.get_xdata()
    assert (freq[0], freq[-1]) == pytest.approx((150.0, 9000.0))
    assert law.get_ydata() == pytest.approx(result.figures.laws["A2"].rate(freq))
    segments = drawn[1].axes[0].collections[0].get_segments()
    assert [s[:, 1].tolist() for s in segments] == [pytest.approx([0.81 * i, 1.21 * i]) for i in (1, 2, 3, 4)]
    assert [s[0, 0] for s in segments] == laws.STATED.tolist()
    x = np.sin(2 * np.pi * 1000 * np.arange(FS // 2) / FS)
    pictures.spectrograms("A2", {"loud": x, "soft": 0.1 * x})
    levels = [
        np.asarray(ax.collections[0].get_array() if ax.collections else ax.images[0].get_array())
        for ax in drawn[2].axes[:2]
    ]
    assert [level.max() for level in levels] == pytest.approx([0.0, -20.0], abs=0.5)


def test_the_page_has_the_cells(result, monkeypatch) -> None:
    for name in ("spectrograms", "rates_picture", "gain_picture"):
        monkeypatch.setattr(page, name, lambda *args: None)
    text = page.page(result, RecordingOrigin("a title", "somebody", "CC0-1.0", "https://example.org/x"), "mine")
    for cell in (
        "mine, estimated from recordings",
        "a title, recorded by somebody, licence CC0-1.0, https://example.org/x",
        "a warning",
        "a line",
        "<td>111.00</td><td>200.0</td><td>2</td><td>3.0</td>",
        "begun with classical_guitar",
        "B2 (47.wav), string A2, stop 2",
        "follows its neighbours",
    ):
        assert cell in text
    assert text.count("<audio") == 12


def test_a_bundle_tells_where_its_figures_come_from(result, tmp_path) -> None:
    notes = _provenance(result)
    assert notes["strings.A2.loss"].startswith("decay rate known within 22 % at 0.5 kHz, 22 % at 1 kHz")
    assert notes["strings.E2.loss"].startswith("no notes of its own")
    assert notes["exciters.pluck.from_bridge"].endswith("notes scatter by 4 mm")
    assert set(notes) == {f"strings.{name}.loss" for name in OPEN} | {
        "strings.*.bending_stiffness",
        "strings.*.scatter.split_cents",
        "exciters.pluck.from_bridge",
        "exciters.pluck.edge",
        "playing.velocity",
        "body.moved_modes",
        "outputs.microphones.moved_modes",
        "presets.recorded",
        "outputs.microphones.equalizer",
    }
    still = replace(result, figures=replace(result.start, place=None, split=None), room=None, places=None)
    assert set(_provenance(still)) == {f"strings.{name}.loss" for name in OPEN} | {"strings.*.bending_stiffness"}
    made = write_bundle(
        result, tmp_path / "mine", GUITAR, RecordingOrigin("a title", "somebody", "CC0-1.0", "https://example.org/x")
    )
    assert made.name == "mine"
    wanted = result.instrument.resolved
    for key in ("strings", "exciters", "body"):
        assert made.resolved[key] == wanted[key]
    assert made.resolved["playing"]["velocity"] == wanted["playing"]["velocity"]
    for a, b in zip(made.resolved["outputs"], wanted["outputs"], strict=True):
        assert (a["equalizer"], a.get("moved_modes")) == (b["equalizer"], b.get("moved_modes"))
    manifest = made.spec.model_dump()
    assert made.spec.title == "mine, estimated from recordings: a title"
    source = manifest["sources"]["recordings"]
    assert source["text"] == "a title; recorded by somebody"
    assert (source["licence"], source["url"]) == ("CC0-1.0", "https://example.org/x")
    assert source["changes"].startswith("4 single notes analysed")
    assert manifest["presets"]["recorded"]["room_mix_db"] == -6.0
    assert json.loads((tmp_path / "mine" / "estimate.json").read_text()) == json.loads(json.dumps(to_json(result)))
    with pytest.raises(TonewoodError, match="are not those estimated"):
        write_bundle(
            replace(result, instrument=made.replace({"strings.E2.linear_density": 9e-3})),
            tmp_path / "other",
            GUITAR,
            RecordingOrigin(),
        )
    assert not (tmp_path / "other").exists()
    with pytest.raises(Exception, match="is there already"):
        write_bundle(result, tmp_path / "mine", GUITAR, RecordingOrigin())


# the yardstick


def test_strokes_are_paired_by_note_and_nearest_dynamic() -> None:
    def side(*rows):
        return [(note(n, 0.0, dynamic=d), analysed(rise=float(i))) for i, (n, d) in enumerate(rows)]

    pairs = yardstick._pairs(side((60, 40.0), (60, None), (62, 80.0)), side((60, 110.0), (60, 60.0), (61, 40.0)))
    assert [(n, a.rise, b.rise) for n, a, b in pairs] == [(60, 0.0, 1.0), (60, 1.0, 0.0)]


def test_folders_are_compared_note_by_note() -> None:
    def folder(rates, *numbers, seconds=1.0):
        rows = [
            Recording(f"{n}.wav", n, partials(440 * 2 ** ((n - 69) / 12), 1e-4, rates, seconds=seconds)[0])
            for n in numbers
        ]
        return Folder(tuple(rows), ("told",))

    said = []
    a, b = folder(np.full(12, 4.0), 57, 58), folder(np.full(12, 6.0), 57, 60)
    b = replace(b, recordings=(*b.recordings, replace(b.recordings[0], file="nowhere.wav", note=-1)))
    found = yardstick.compare_notes(a, b, advance=said.append)
    assert found.shared == (57,)
    assert found.between.decays == pytest.approx(1.5, rel=0.03)
    assert set(found.scale) == {"next semitone, A"}
    assert found.warnings == ("told", "told", "left out: nowhere.wav: no note is told")
    assert said == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_a_folder_is_played_as_another_instrument() -> None:
    monochord = Instrument.load("monochord")
    folder = Folder((note(45, 0.4, dynamic=90.0), note(40, 0.4)), ())
    played = yardstick.played_as(folder, monochord)
    (only,) = played.recordings
    assert (only.file, only.note, only.string, only.stop, only.dynamic) == ("monochord: 45.wav", 45, "A2", 0.0, 90.0)
    assert len(only.samples) > 0.4 * FS
    assert played.warnings == ("left out: 40.wav: monochord plays A2 to A4",)
    with pytest.raises(TonewoodError, match="none of the notes is between A2 to A4"):
        yardstick.played_as(Folder((note(40, 0.4),), ()), monochord)
