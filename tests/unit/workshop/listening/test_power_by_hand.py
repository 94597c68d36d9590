"""Power and simulated listeners against figures worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest
from listening_by_hand import LEVITT, LINEAR, row, simulated
from listening_studies import NULLS, graded, ratings, without
from scipy import stats

from tonewood.workshop.batch.pages import MushraPage, PairedPage, RatingPage, StaircasePage
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.detection import sensitivity
from tonewood.workshop.listening.panel import PanelThreshold, _Listener, _reply, _rule
from tonewood.workshop.listening.power import (
    _levels,
    _pilot_means,
    _pilot_spread,
    _sounds,
    _trials,
    power_of,
)
from tonewood.workshop.listening.simulated_power import (
    TooManyListenersError,
    _batches,
    answers_for_share,
    fewest,
    screened_found,
    stated_spread,
)
from tonewood.workshop.listening.simulations import trials
from tonewood.workshop.listening.trials import Step

# -- power -------------------------------------------------------------------------------------------------------------


def test_answers_for_a_share_are_those_of_the_binomial_test() -> None:
    """From this number on, and not with one less, the power of the exact test stays above."""
    n = answers_for_share(0.75, 0.5, 0.05, 0.8)

    def reached(k: int) -> bool:
        least = next(r for r in range(k + 2) if stats.binom.sf(r - 1, k, 0.5) <= 0.05)
        return bool(stats.binom.sf(least - 1, k, 0.75) >= 0.8)

    assert not reached(n - 1)
    assert all(reached(k) for k in range(n, n + 30))
    with pytest.raises(ListeningError, match="not above guessing"):
        answers_for_share(0.5, 0.5, 0.05, 0.8)


@pytest.mark.parametrize("needed", [3, 4, 5, 17, 10_000])
def test_the_fewest_listeners_are_searched_for(needed: int) -> None:
    assert fewest(lambda n: 0.9 if n >= needed else 0.1, 0.9, "") == needed
    with pytest.raises(TooManyListenersError, match="more than 10000 listeners would be needed for it"):
        fewest(lambda n: 0.0, 0.5, "it")


def test_stated_spreads_are_halves_of_variances() -> None:
    listeners, sounds = stated_spread(12.0, 5.0, 6, 3)
    np.testing.assert_allclose(listeners, 36.0 * np.eye(3))
    np.testing.assert_allclose(sounds.sounds, 12.5 * np.eye(3))
    np.testing.assert_allclose(sounds.pairs, 6 * 36.0 * np.eye(3))
    assert sounds.count == 6


def test_an_effect_must_be_seen_with_and_without_those_left_out(rng: np.random.Generator) -> None:
    y = np.zeros((4, 8, 2)) + rng.normal(0, 0.1, (4, 8, 2))
    y[..., 1] += 5.0  # all differ
    y[1, :4, 1] -= 30.0  # half of them the other way
    kept = np.ones((4, 8), dtype=bool)
    kept[1, :4] = False
    kept[2, 2:] = False  # two are too few
    kept[3, 3:] = False
    assert screened_found(y, kept, 0.05)[:, 0].tolist() == [True, False, False, True]


def manifest(**choices: list[str]) -> Any:
    return SimpleNamespace(choices=lambda: choices, conditions=None, random=[], repeats=1)


def test_numbers_of_trials_levels_and_sounds() -> None:
    page = MushraPage.model_validate({"type": "mushra", "group_by": ["note"], "reference": {"damping": "a"}})
    whole = manifest(note=["x", "y", "z"], damping=["a", "b"], body=["k", "l"])
    assert _levels(whole, page) == 2
    assert _levels(manifest(body=["k", "l", "m"], damping=["a"]), page) == 3
    assert _levels(manifest(note=["x", "y"]), page) == 2  # nothing varies
    assert _trials(whole, page, 2, 1) == (3, 2)
    whole.repeats = 4
    assert _trials(whole, page, 2, 3) == (4, 2)
    assert _trials(whole, page.model_copy(update={"subset": 6}), 2, 1) == (6, 2)
    whole.random = ["body"]
    assert _trials(whole, page, 2, 2) == (6, 1)
    assert (_sounds(whole), _sounds(manifest())) == (2, 1)
    rows = [{"note": n, "damping": d, "body": "k"} for n in "xy" for d in "ab"]
    listed = SimpleNamespace(choices=whole.choices, conditions=rows, random=["note"], repeats=1)
    assert (_sounds(listed), _trials(listed, page, 2, 1)) == (2, (2, 1))


def test_means_of_a_pilot_are_of_listeners_who_have_all() -> None:
    rows = [row(who, 10 * i + j + 100 * k, d=d, n=n)
            for i, who in enumerate("pqrs") for j, d in enumerate("ab") for k, n in enumerate("xy")]  # fmt: skip
    rows = [r for r in rows if not (r["listener"] == "s" and r["n"] == "y")]
    rows += [row("p", None, d="a", n="x"), row("p", 999, d="a", n="x") | {"role": "anchor70"}]
    own = SimpleNamespace(factors=("n", "d"), rows=rows)
    means, who = _pilot_means(own, {"d": "b"}, ["n"])  # type: ignore[arg-type, misc]
    assert who == ["p", "q", "r"]
    assert means.tolist() == [[[10 * i + 1, 10 * i], [10 * i + 101, 10 * i + 100]] for i in range(3)]
    assert _pilot_means(SimpleNamespace(factors=("n",), rows=rows), {}, ["n"]) == (None, [])  # type: ignore[arg-type]
    few = SimpleNamespace(factors=("n", "d"), rows=[r for r in rows if r["listener"] != "r"])
    assert _pilot_means(few, {}, ["n"]) == (None, [])  # type: ignore[arg-type]
    covariance, spread = _pilot_spread(means[:, :1], 1)
    assert spread is None
    np.testing.assert_allclose(covariance, np.full((2, 2), 100.0))


def test_power_of_a_page_is_stated_with_its_defaults(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tonewood.workshop.listening.simulated_power.EXPERIMENTS", 100)
    pages = [
        {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "times": 2},
        {"type": "paired_comparison", "pairs": {"damping": ["complex", "block"]}, "question": "?", "expect": 0.8},
        {"type": "instructions"},
    ]
    test = fakes.made(tmp_path, pages)
    abx, choice = power_of(test.manifest, {0: 6, 1: 3})
    answers = answers_for_share(0.7, 0.5, 0.05, 0.8)
    assert (abx.page, abx.name, abx.listeners, abx.stated) == (1, "abx", math.ceil(answers / 6), False)
    d = sensitivity(0.7, "abx")
    assert abx.effect == f"70 % right, d' = {d:.2f}: {answers} answers, 6 a listener, over all cells"
    assert str(abx).endswith("over all cells (not stated by the page)")
    assert choice.stated
    assert choice.effect.startswith("80 % chosen: ")
    assert f": {3 * (choice.listeners or 0)} answers, 3 a listener" in choice.effect


# -- simulated listeners -----------------------------------------------------------------------------------------------


def test_simulated_ratings_without_spread_are_the_effects() -> None:
    one = simulated(ratings={"d": {"b": -20.0}, "p": {"y": -5.0, "x": 2.0}}, interactions={"d=b, p=y": -3.0})
    slots = {"reference": "r", "A": "s", "B": "r", "C": "k"}
    assert one._mushra(slots) == {"A": 100.0 - 20 - 5 - 2 - 3, "B": 100.0, "C": 25.0}
    assert one._bs1116({"reference": "r", "A": "s", "B": "r"}) == {"A": 5 - 30 / 25, "B": 5.0}
    page = RatingPage.model_validate(
        {"type": "rating", "scales": [{"name": "q", "label": "Q", "low": 0.0, "high": 60.0}]}
    )
    session = SimpleNamespace(step=Step(0, 0, "t", {"A": "s"}), page=page, page_index=0)
    assert one.answer(session)["values"] == {"q": 30.0 - 28.0}
    assert _rule("d=b, p = y") == {"d": "b", "p": "y"}


def test_simulated_choices_follow_positions_and_thresholds() -> None:
    sure = simulated(d_prime={"d": {"b": 40.0}}, preference={"d": {"b": 60.0}}, thresholds={})
    step = Step(0, 0, "t", {"A": "r", "B": "s", "X": "s"}, "B")
    pages = {p["type"]: p for p in fakes.ALL}
    from tonewood.workshop.batch.pages import AbPage, AbxPage

    abx = AbxPage.model_validate({**pages["abx"], "pairs": {"d": "all"}})
    ab = AbPage.model_validate({**pages["ab"], "pairs": {"d": "all"}})
    paired = PairedPage.model_validate({**pages["paired_comparison"], "pairs": {"d": "all"}})
    for _ in range(20):
        assert sure._judged(abx, step, ["A", "B", "undecided"]) == "B"
        assert sure._judged(ab, replace(step, correct="different"), ["same", "different"]) == "different"
        assert sure._judged(ab, replace(step, correct="same"), ["same", "different"]) == "same"
        assert sure._judged(paired, step, ["A", "B"]) == "B"
        assert sure._judged(paired, replace(step, slots={"A": "s", "B": "r"}), ["A", "B"]) == "A"
    wanted = PanelThreshold(mean=0.5, sd=1.2, slope=4.0, lapses=0.0)
    one = simulated(thresholds={"1": wanted.model_dump()})
    one.deviation = 2.0
    assert one._detects(LEVITT, 0, 0.5 * 1.2**2) == pytest.approx(LEVITT.share)
    assert one._detects(LEVITT, 1, 0.5) == pytest.approx(1 / 3)
    assert one._detects(LEVITT, 0, None) == pytest.approx(1 / 3)


@pytest.mark.parametrize("d", [0.5, 3.0])
def test_simulated_answers_say_different_beyond_half_of_d(d: float) -> None:
    """Differences of two observations, N(0, 2) or N(d, 2), against the criterion d / 2, at least 0.7."""
    from tonewood.workshop.batch.pages import AbPage

    one, page = simulated(d_prime={"d": {"b": d}}), AbPage.model_validate({"type": "ab", "pairs": {"d": "all"}})
    for correct, mean in (("same", 0.0), ("different", d)):
        step = Step(0, 0, "t", {"A": "r", "B": "s"}, correct)
        found = np.mean([one._judged(page, step, []) == "different" for _ in range(4000)])
        beyond = [stats.norm.sf((max(d / 2, 0.7) - sign * mean) / math.sqrt(2)) for sign in (1, -1)]
        assert found == pytest.approx(sum(beyond), abs=0.025)


def test_simulated_replies_to_questions() -> None:
    assert _reply(SimpleNamespace(kind="choice", choices={"b": 1, "a": 2})) == "b"
    for kind, reply in (("text", "simulated"), ("number", 0.0), ("scale", 3.5)):
        assert _reply(SimpleNamespace(kind=kind, low=2.0, high=5.0)) == reply


def test_responses_to_levels_are_a_listener_s_own() -> None:
    one = simulated(slope_sd=4.0)
    many = [_Listener(one.panel, one.key, one.test, np.random.default_rng(k))._response("s") for k in range(800)]
    assert one._response("s") == one._response("s")
    assert np.std(many) == pytest.approx(4.0 * math.sqrt(2), rel=0.1)  # of two levels
    assert simulated()._response("s") == 0.0


# -- simulated experiments ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("null", ["no effect", "listeners differ in the factor", "unequal variance"])
def test_simulated_ratings_have_the_stated_means_and_spreads(null: str) -> None:
    """Variances: 36 of listeners, those of their own responses to a level, and of single answers."""
    law: Any = NULLS[null]
    y = ratings(np.random.default_rng(3), 40, 500, null, 3.0).reshape(-1, 3, 3, 2)
    assert y.mean(axis=(0, 2, 3)) == pytest.approx(law["mean"] + np.array([0.0, 3.0, 0.0]), abs=0.35)
    own, residual = np.square(law["own"]), np.square(law["residual"])
    assert y.var(axis=0).mean(axis=(1, 2)) == pytest.approx(36 + own + residual, rel=0.06)
    assert y.var(axis=3, ddof=1).mean(axis=(0, 2)) == pytest.approx(residual, rel=0.06)
    between = y.mean(axis=(2, 3))
    assert np.cov(between, rowvar=False)[0, 1] == pytest.approx(36, rel=0.08)
    assert between.var(axis=0) == pytest.approx(36 + own + residual / 6, rel=0.06)


def test_simulated_ratings_end_at_100() -> None:
    y = ratings(np.random.default_rng(3), 10, 200, "ratings at the ceiling")
    assert np.mean(y == 100.0) == pytest.approx(stats.norm.sf(5 / math.sqrt(36 + 25 + 81)), abs=0.01)
    assert y.shape == (10, 200, 9, 2)


def test_simulated_ratings_of_other_populations() -> None:
    def drawn(name: str, shift: float = 0.0) -> np.ndarray:
        return ratings(np.random.default_rng(4), 40, 500, name, shift).reshape(-1, 3, 3, 2)

    skewed = drawn("skewed differently in each level")
    level = skewed.mean(axis=(2, 3))
    assert level.var(axis=0) == pytest.approx(36 + 64 + 36 / 6, rel=0.08)
    third = np.mean((level - level.mean(axis=0)) ** 3, axis=0)
    assert third == pytest.approx([0, 2 * 8**3, -2 * 8**3], abs=160)
    assert set(np.unique(drawn("three values only"))) == {20.0, 50.0, 80.0}
    tenth = drawn("one listener in ten responds", 2.0)
    assert tenth.mean(axis=(0, 2, 3)) == pytest.approx([50.0, 52.0, 50.0], abs=0.4)
    change = tenth.mean(axis=(2, 3))[:, 2] - tenth.mean(axis=(2, 3))[:, 0]
    assert change.var() == pytest.approx(20**2 * 0.09 + 2 * 36 / 6, rel=0.06)
    assert np.mean(change > 8) == pytest.approx(0.1, abs=0.01)
    heavy = drawn("heavy tails", 5.0)
    assert np.median(heavy, axis=(0, 2, 3)) == pytest.approx([50.0, 55.0, 50.0], abs=0.4)
    own = np.median(np.abs(heavy[..., 0] - heavy[..., 1])) / math.sqrt(2)
    t = np.random.default_rng(0).standard_t(3, (200_000, 2))
    assert own == pytest.approx(5 * np.median(np.abs(t[:, 0] - t[:, 1])) / math.sqrt(2), rel=0.04)


def test_missing_answers_are_those_of_the_law() -> None:
    y = np.arange(3 * 8 * 9 * 2, dtype=float).reshape(3, 8, 9, 2)
    rng = np.random.default_rng(2)
    sets = without(rng, y, "sets of six of nine sounds")
    assert (np.isnan(sets).sum(axis=-1) == 3).all()
    third = without(rng, y, "a third of every fourth listener's")
    there = ~np.isnan(third)
    assert there[:, [1, 2, 3, 5, 6, 7]].all()
    assert np.array_equal(third[:, 1], y[:, 1].mean(axis=-1))
    some = third[:, [0, 4]]
    assert not np.array_equal(some, y[:, [0, 4]].mean(axis=-1), equal_nan=True)
    expected = np.stack([y.mean(axis=-1), y[..., 0], y[..., 1]])[:, there]
    assert (np.abs(expected - third[there]).min(axis=0) == 0).all()  # the mean of those that are left
    many = np.zeros((20, 50, 9, 1))
    assert np.isnan(without(rng, many, "20 % at random")).mean() == pytest.approx(0.2, abs=0.015)


def test_simulated_grades_are_two_answers_a_cell() -> None:
    found = graded(np.random.default_rng(2), 3, 400, "five grades", 1.0)
    assert found.shape == (3, 400, 9, 5)
    assert (found.sum(axis=-1) == 2).all()
    share = found.sum(axis=(0, 1))[:3].sum(axis=0) / (3 * 400 * 3 * 2)
    latent = np.random.default_rng(0)
    many = latent.normal(0, math.hypot(1, 0.7), 200_000) + latent.logistic(size=200_000)
    cuts = np.array([-2.0, -0.5, 0.7, 2.0])
    assert share == pytest.approx(np.bincount(np.searchsorted(cuts, many), minlength=5) / 200_000, abs=0.02)
    higher = found[:, :, 3:6].sum(axis=(0, 1, 2)) @ np.arange(5) - found[:, :, :3].sum(axis=(0, 1, 2)) @ np.arange(5)
    assert higher > 0


def test_simulated_tracks_of_sure_listeners_stay_at_their_thresholds() -> None:
    """At a slope of 1e6 answers are right above the threshold, and two of five below it; no lapses."""
    levels, right = trials(LINEAR, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    (levels,), (right,) = levels, right
    assert right[levels > 3.0].all()
    assert levels[0] == 4.0
    two = LINEAR.model_copy(update={"tracks": 2})
    (both,), _ = trials(two, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    assert np.flatnonzero(both[: len(levels)] != levels).size == 0
    assert len(both) > len(levels)
    quest = StaircasePage.model_validate(
        {"type": "staircase", "path": "a.b", "start": 4.0, "lowest": 0.0, "highest": 10.0, "trials": 12, "tracks": 2}
    )
    (levels,), (right,) = trials(quest, np.array([3.0]), np.array([1e6]), 0.0, np.random.default_rng(1))
    assert (levels.shape, levels[0], levels[12]) == ((24,), 4.0, 4.0)
    assert right[levels > 3.0].all()


@pytest.mark.parametrize(
    ("size", "batches"),
    [(1, [4000]), (500, [4000]), (501, [3992, 8]), (1500, [1333, 1333, 1333, 1]), (40_000, [50] * 4),
     (3_000_000, [1] * 200)],
)  # fmt: skip
def test_experiments_are_simulated_in_batches_of_two_million_answers(size: int, batches: list[int]) -> None:
    """4000 experiments, of large ones four batches, 200 at least."""
    assert _batches(size) == batches
    assert all(one * size <= 2_000_000 or one == 1 for one in _batches(size))
