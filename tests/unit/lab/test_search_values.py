"""The search of the cheapest setting, and the grid of stability, on notes and runs that are made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy import stability
from tonewood.lab.accuracy.partials import PartialErrors
from tonewood.lab.accuracy.target import Setting, Target, Worst, _Search


class Note:
    """Errors of order 2 in the steps per frame, 64 / n^2 cents re the limit; of fewer modes one cent more."""

    string, duration = "A", 2.0

    def __init__(self, stop: int = 0, nudged: float = 0.0, seconds: float = 0.1):
        self.stop, self.nudged, self.seconds, self.asked = stop, nudged, seconds, []

    def strokes(self, options: dict[str, Any], factors=(1.0,), overrides=None) -> Any:
        self.asked.append((options, factors, overrides))
        out = SimpleNamespace(options=options, factors=factors, overrides=overrides, seconds=self.seconds, n_modes=70)
        out.halves = lambda: ("one half", "the other")
        return out

    def errors(self, strokes: Any, truth: Any) -> PartialErrors:
        if strokes == "one half":
            return self.of(9.0 if truth == "the other" else 0.0)
        if strokes.factors == (1.001,):
            return self.of(self.nudged)
        if strokes.overrides:
            return self.of(0.25 if truth.overrides is None and strokes.options == truth.options else 0.0)
        e, r = (64 / (o.options.get("oversampling", 1.0) ** 2) for o in (strokes, truth))
        budget = strokes.options.get("budget_cents", 0.0)
        return self.of(e - r + 1.0 * ("freq_limit" in strokes.options) + budget)

    @staticmethod
    def of(e: float) -> PartialErrors:
        return PartialErrors(e / 2, e, 0.0, 0.0, 0.0, 0.0, 9, 0.0)

    def timed(self, options: list[dict[str, Any]], repeats: int, tell: Any) -> list[float]:
        tell(1.0)
        self.repeats = repeats
        return [o["oversampling"] - 0.01 * ("freq_limit" in o) - 0.02 * ("budget_cents" in o) for o in options]

    def renderer(self, options: dict[str, Any]) -> Any:
        return SimpleNamespace(engine=SimpleNamespace(effects=()))


def search(
    *notes: Note, cents: float = 20.0, bandwidth: float = 10e3, switched: bool = False, standard: int = 1
) -> Any:
    strings = {"A": SimpleNamespace(freq_upper=20e3), "B": SimpleNamespace(freq_upper=15e3)}
    instrument: Any = SimpleNamespace(spec=SimpleNamespace(name="lute", oversampling=standard, strings=strings))
    shares: list[float] = []
    made = _Search(instrument, Target("x", Worst(cents=cents)), list(notes), 48000, bandwidth, shares.append)  # type: ignore[arg-type]
    made._switched = lambda: switched  # type: ignore[method-assign]
    found = made.run()
    return found, shares


def test_settings_are_tried_from_the_lowest_rate_until_well_beyond_the_first_that_meets_the_target() -> None:
    note = Note(stop=3)
    found, shares = search(note)
    # the reference: eight steps a frame; from 16 and 64/16 - 1 and 64/4 - 1 by its order, 2
    assert (found.reference, found.strokes, found.notes, found.fs) == (8.0, 1, ("A:3",), 48000)
    assert found.reference_error.cents == pytest.approx(3.0 / (2 ** np.log2(15 / 3 - 1) - 1))
    trials = [(0.5, [None])]  # 10 kHz is nearly all that it steps
    trials += [(rate, [10e3, 12700.0 if rate < 1 else 14100.0, None]) for rate in (0.75, 1.0, 1.5, 2.0, 3.0, 4.0)]
    settings = [Setting(rate, limit) for rate, limits in trials for limit in limits]
    assert [t.setting for t in found.trials] == settings
    by = {(t.setting.oversampling, t.setting.freq_limit): t for t in found.trials}
    assert by[1.0, None].highest == 20e3
    assert by[0.5, None].highest == 0.45 * 0.5 * 48e3
    assert by[1.0, 10e3].highest == 10e3
    assert by[1.0, 14100.0].setting.words == "--oversampling 1 --freq-limit 14100"
    assert by[2.0, None].errors.cents == 15.0
    assert (by[2.0, None].met, by[1.5, None].met) == (True, False)
    assert [t.seconds for t in found.trials] == sorted(t.seconds for t in found.trials)
    assert found.cheapest.setting == Setting(2.0, 10e3)
    assert (found.default.setting, found.default.errors.cents) == (Setting(1.0), 63.0)
    assert found.modes.cents == 0.25
    wider = [(o["oversampling"], overrides) for o, _, overrides in note.asked if overrides]
    assert wider == [(2.0, {"strings.A.freq_upper": 40e3, "strings.B.freq_upper": 30e3})]
    assert shares[:3] == [0.1, 0.35, 0.5]
    assert max(shares) == pytest.approx(0.95)
    assert note.repeats == 2


@pytest.mark.parametrize(("nudged", "strokes"), [(4.0, 1), (4.1, 8)])
def test_a_sensitive_note_is_compared_by_strokes(nudged: float, strokes: int) -> None:
    """A fifth of the limit of 20 cents; chance is that of the halves of the reference."""
    found, _ = search(Note(nudged=nudged))
    assert (found.strokes, found.reference_error.cents) == (strokes, pytest.approx(1.0 if strokes == 1 else 9.0))


@pytest.mark.parametrize(("seconds", "reference"), [(1.8, 8.0), (1.9, 4.0), (3.7, 4.0), (3.8, 2.0), (99.0, 2.0)])
def test_a_reference_is_as_fine_as_its_time_allows(seconds: float, reference: float) -> None:
    """30 s: a note of 2 s at the rate of `standard` takes twice these, eight times that at eight times the rate."""
    assert search(Note(seconds=seconds), cents=1e3)[0].reference == reference


@pytest.mark.parametrize(("standard", "reference"), [(2, 16.0), (4, 16.0)])
def test_a_reference_makes_at_most_16_steps_a_frame(standard: int, reference: float) -> None:
    assert search(Note(), cents=1e3, standard=standard)[0].reference == reference


def test_effects_that_are_switched_get_budgets() -> None:
    """Of the two cheapest that meet the target, down to the first budget that does."""
    found, _ = search(Note(), cents=16.4, switched=True)
    auto = [(t.setting.oversampling, t.setting.budgets) for t in found.trials if t.setting.effects == "auto"]
    assert {t.setting.effects for t in found.trials} == {"all", "auto"}
    assert found.default.setting.effects == "auto"
    assert found.cheapest.setting.words == "--oversampling 2 --effects auto --budget-cents 0.05 --budget-db -120"
    assert auto == [(2.0, (5.0, -40.0)), (2.0, (0.5, -80.0)), (2.0, (0.05, -120.0)), (3.0, (5.0, -40.0))]


def test_no_rate_steps_modes_beyond_all() -> None:
    with pytest.raises(TonewoodError, match="is 90000 Hz; up to 86400 are allowed"):
        search(Note(), bandwidth=90e3)


# stability


class Energies:
    def __init__(self, *energies: float, finite: int = 99):
        self.energies, self.finite, self.made = energies, finite, []

    def start(self) -> None:
        self.made.clear()

    def energy(self) -> float:
        return self.energies[min(len(self.made), len(self.energies) - 1)]

    def run(self, n: int):
        self.made.append(n)
        return None, len(self.made) < self.finite


@pytest.mark.parametrize(
    ("run", "verdict", "growth"),
    [
        (Energies(2.0, 4.0, 1.0), "stable", 2.0),
        (Energies(2.0, 4.1, 1.0), "grows", 2.05),
        (Energies(2.0, 1.0), "stable", 1.0),
        (Energies(2.0, np.inf), "NaN", np.inf),
        (Energies(2.0, 1.0, finite=3), "NaN", np.inf),
    ],
)
def test_verdicts_on_energies(monkeypatch, run: Energies, verdict: str, growth: float) -> None:
    monkeypatch.setattr(stability, "run_of", lambda method, scene, fs: run)
    scene: Any = SimpleNamespace(problem=SimpleNamespace(components={"string": SimpleNamespace(n_modes=7)}))
    cell = stability.watched("s", "m", scene, 3.0, 1600.0, 0.5)
    assert (cell.n_modes, cell.force, cell.fs, cell.verdict, cell.growth) == (7, 3.0, 1600.0, verdict, growth)
    assert set(run.made) == {50}
    assert len(run.made) == (16 if verdict != "NaN" else run.finite if run.finite < 99 else 1)


def test_scenes_of_the_grid() -> None:
    string = SimpleNamespace(held_freq=lambda n: 100.0 * n)
    assert stability._between(string, 3) == 350.0  # type: ignore[arg-type]
    for quick, modes, rates in (
        (True, [48, 228], [48e3, 192e3]),
        (False, [24, 72, 168, 228, 480], [24e3, 48e3, 96e3, 192e3, 384e3, 768e3]),
    ):
        made = list(stability._linear(quick, 0.5))
        assert [m.args[4] for m in made[: len(rates)]] == rates
        assert {(m.args[0], m.args[3], m.args[5]) for m in made} == {("string on 16 modes", 10.0, 0.5)}
        assert len(made) == 7 * len(rates) * len(modes)
    quick = list(stability._tension(True, 0.25))
    assert [m.args[3] for m in quick[:12:4]] == [0.001, 50.0, 1000.0]
    assert [(m.args[1], m.args[4]) for m in quick[:4]] == [
        (n, fs) for n in ("tonewood", "verlet") for fs in (48e3, 192e3)
    ]
    assert len(quick) == 2 * 3 * 4
    assert len(list(stability._tension(False, 0.25))) == 4 * 6 * 8


@pytest.mark.parametrize(("quick", "duration"), [(True, 0.05), (False, 0.25)])
def test_a_grid_tells_how_far_it_is(monkeypatch, quick: bool, duration: float) -> None:
    monkeypatch.setattr(stability, "_linear", lambda quick, duration: [lambda: ("linear", quick, duration)])
    monkeypatch.setattr(stability, "_tension", lambda quick, duration: [lambda: ("tension", quick, duration)])

    def attacks(quick: bool, tell: Any) -> list[bool]:
        tell(0.5)
        return [quick]

    monkeypatch.setattr(stability.attacks, "run", attacks)
    shares: list[float] = []
    grid = stability.run(quick, shares.append)
    assert grid.cells == [("linear", quick, duration), ("tension", quick, duration)]
    assert (grid.duration, grid.attacks) == (duration, [quick])
    assert shares == pytest.approx([0.15, 0.3, 0.65])
