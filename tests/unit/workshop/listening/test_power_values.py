"""Power of pages against figures worked out by hand: what is simulated, and what is said about it."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from tonewood.workshop.batch.pages import Bs1116Page, MushraPage, RatingPage, StaircasePage
from tonewood.workshop.listening import power, simulated_power
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.simulated_power import (
    MushraListeners,
    TooManyListenersError,
    _batches,
    _draws,
    ordinal_power,
    screened_power,
    threshold_listeners,
)

STAIRS = {"type": "staircase", "path": "a", "start": 4.0, "lowest": 1.0, "highest": 9.0}


def planned(random: tuple[str, ...] = (), **choices: list[str]) -> Any:
    """A manifest with these factors."""
    goal = SimpleNamespace(alpha=0.05, power=0.8)
    return SimpleNamespace(choices=lambda: choices, conditions=None, random=list(random), repeats=1, power=goal)


def rating(**fields: Any) -> RatingPage:
    scale = {"name": "s", "label": "S", "low": 0.0, "high": 10.0, "ordinal": fields.pop("ordinal", False)}
    return RatingPage.model_validate({"type": "rating", "scales": [scale], **fields})


def graded(**fields: Any) -> Bs1116Page:
    return Bs1116Page.model_validate({"type": "bs1116", "reference": {"d": "a"}, **fields})


def piloted(out: tuple[str, ...] = (), sounds: str = "x") -> Any:
    """Four listeners p to s, whose ratings of b are 2, 4, 6 and 8 above those of a."""
    rows = [
        {"listener": who, "role": "sound", "value": 50.0 + 10 * i + 2.0 * (i + 1) * (d == "b") + 3 * j, "d": d, "n": n}
        for i, who in enumerate("pqrs") for d in "ab" for j, n in enumerate(sounds)
    ]  # fmt: skip
    screened = [SimpleNamespace(listener=name) for name in out]
    return SimpleNamespace(factors=("d", "n"), rows=rows, everybody=None, screened=screened, pairs=[])


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Calls of the simulations, which find every effect; seven listeners are enough."""
    calls: list[Any] = []

    def noted(name: str) -> Any:
        return lambda *given, **named: calls.append((name, *given, named)) or np.array([0.9, 0.8])

    for name in ("rating_power", "mushra_power", "screened_power", "ordinal_power"):
        monkeypatch.setattr(power, name, noted(name))
    monkeypatch.setattr(power, "fewest", lambda reached, share, text: 7 if reached(7) in (0.9, 0.8) else share)
    return calls


@pytest.mark.parametrize(
    ("page", "levels", "text", "effects", "variance", "stated"),
    [
        (graded(), "abc", "0.5 points, sd 0.8, 3 levels", [0, 0.5, 0], 0.32, False),
        (graded(expect=1.0, expect_sd=2.0), "ab", "1 points, sd 2", [0, 1], 2.0, True),
        (rating(), "ab", "1 points, sd 1.5", [0, 1], 1.125, False),
        (rating(expect=2.0), "ab", "2 points, sd 1.5", [0, 2], 1.125, True),
    ],
)
def test_stated_ratings(
    asked: list[Any], page: Any, levels: str, text: str, effects: list[float], variance: float, stated: bool
) -> None:
    assert power._rated(planned(d=list(levels)), page, None) == (text, 7, stated)
    ((name, given, covariance, listeners, alpha, named),) = asked
    assert (name, listeners, alpha, named) == ("rating_power", 7, 0.05, {"sampled": None})
    assert given.tolist() == effects
    np.testing.assert_allclose(covariance, variance * np.eye(len(levels)))


def test_random_sounds_are_tried_alone_first(asked: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    whole, page = planned(("n",), d=["a", "b"], n=["x", "y", "z"]), graded(expect_sd=2.0, expect_sound_sd=1.0)
    assert power._rated(whole, page, None)[0] == "0.5 points, sd 2, 3 random sounds with sd 1"
    (_, effects, none, fifty, alpha, alone), (_, _, covariance, seven, _, both) = asked
    assert (effects.tolist(), none.tolist(), fifty, alpha, seven) == ([0, 0.5], [[0, 0], [0, 0]], 50, 0.05, 7)
    assert (alone["sampled"].count, alone["sampled"].pairs.tolist()) == (3, [[0, 0], [0, 0]])
    np.testing.assert_allclose(alone["sampled"].sounds, 0.5 * np.eye(2))
    np.testing.assert_allclose(both["sampled"].pairs, 3 * np.eye(2))
    np.testing.assert_allclose(covariance, np.eye(2))
    monkeypatch.setattr(power, "rating_power", lambda *given, **named: np.array([0.79]))
    with pytest.raises(TooManyListenersError, match=r"no number of listeners is enough for 0\.5 points.*more sounds"):
        power._rated(whole, page, None)


def test_a_pilot_takes_the_place_of_what_is_stated(asked: list[Any]) -> None:
    whole, spread = planned(d=["a", "b"]), 10.0 * np.arange(4)
    means = np.stack([spread, spread + 2.0 * np.arange(1, 5)], axis=1)
    assert power._rated(whole, graded(), piloted()) == ("5 points, spread of 4 listeners of a pilot", 7, True)
    assert power._rated(whole, graded(expect=3.0), piloted(("q", "s"))) == (
        "3 points, spread of 4 listeners of a pilot, 2 of whom the screening left out", 7, True
    )  # fmt: skip
    (name, effects, covariance, *_), (screened, given, kept, moved, listeners, alpha, _) = asked
    assert (name, effects.tolist(), screened, moved.tolist()) == ("rating_power", [0, 5], "screened_power", [0, 3])
    np.testing.assert_allclose(covariance, np.cov(means, rowvar=False))
    np.testing.assert_allclose(given, 50 + means)
    assert (kept.tolist(), listeners, alpha) == ([True, False, True, False], 7, 0.05)
    asked.clear()
    sampled = planned(("n",), d=["a", "b"], n=["x", "y"])
    text = power._rated(sampled, graded(), piloted(sounds="xy"))[0]
    assert text == "5 points, spread of 4 listeners of a pilot and 2 random sounds"
    assert asked[-1][-1]["sampled"].count == 2


@pytest.mark.parametrize(("rated", "said"), [(-9.1, ""), (-8.0, " (with such a spread the mean of ratings is 8)")])
def test_stated_effects_of_a_mushra_page_are_screened(
    asked: list[Any], monkeypatch: pytest.MonkeyPatch, rated: float, said: str
) -> None:
    stays = np.array([[True, True, True, False]])
    drawn = np.tile([100.0, 100.0 + rated, 0.0], (1, 4, 1, 1))
    people, stated = SimpleNamespace(drawn=lambda random, n, m: (drawn, stays)), list[Any]()
    monkeypatch.setattr(power.MushraListeners, "stated", lambda *given: stated.append(given) or people)
    page = MushraPage.model_validate({"type": "mushra", "group_by": ["n"], "reference": {"d": "a"}})
    found = power._rated(planned(d=["a", "b", "c"], n=["x", "y"]), page, None)
    assert found == (f"10 points, sd 15{said}, 25 % of listeners left out by the screening, 3 levels", 7, False)
    ((effects, *given),) = stated
    assert (effects.tolist(), given) == ([0, -10, 0], [15.0, 1, 2, 1, 0.0])
    assert asked == [("mushra_power", people, 7, 0.05, {})]


def test_grades_are_of_single_sounds(asked: list[Any]) -> None:
    whole = planned(d=["a", "b"], n=["x", "y", "z"])
    assert power._graded(whole, rating(ordinal=True), None) == (
        "1 of 10 points, sd 1.5, by shares of comparisons in 3 sounds", 7, False
    )  # fmt: skip
    text, _, stated = power._graded(whole, rating(ordinal=True), piloted())
    assert (text, stated) == (
        "5 of 10 points, spread of 4 listeners of a pilot, by shares of comparisons in 3 sounds", True
    )  # fmt: skip
    (_, effects, *given, _), (_, of_pilot, sd, *_) = asked
    assert (effects.tolist(), given) == ([0, 1], [1.5, 3, (0.0, 10.0), 7, 0.05])
    assert (of_pilot.tolist(), sd) == ([0, 5], pytest.approx(math.sqrt(20 / 3)))  # of 2, 4, 6, 8


def test_a_staircase_of_a_pilot(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[Any] = []
    monkeypatch.setattr(power, "threshold_listeners", lambda page, people, *rest: given.append((people, rest)) or 5)
    own: Any = SimpleNamespace(thresholds=SimpleNamespace(mean=3.0, slope=2.0, spread=0.5, listeners=range(3)))
    text, listeners, stated = power._staircase(StaircasePage.model_validate(STAIRS | {"margin": 0.7}), own, 0.05, 0.9)
    assert text == "a mean threshold other by 0.7 than 3, spread between listeners 0.5"
    ((people, rest),) = given
    assert (people.mean, people.sd, people.slope, rest) == (3.0, 0.5, 2.0, (0.7, 0.05, 0.9))
    assert (listeners, stated) == (5, True)
    own.thresholds.listeners = range(2)  # of whom the spread is not known
    text, _, stated = power._staircase(StaircasePage.model_validate(STAIRS | {"margin": 0.7}), own, 0.05, 0.9)
    assert (text.endswith("spread between listeners 0.5"), stated) == (False, False)


@pytest.mark.parametrize(
    ("kind", "factors", "reason"),
    [
        ("mushra", ("d",), "page 1 is rating in the manifest, and mushra in the pilot"),
        ("rating", ("e",), "page 1 is rating without a factor e in the manifest"),
    ],
)
def test_a_pilot_of_other_pages_is_refused(kind: str, factors: tuple[str, ...], reason: str) -> None:
    """Spread and effect of another question were taken for those of the page."""
    whole = planned(d=["a", "b"])
    whole.pages, whole.language = [rating()], "en"
    pilot: Any = SimpleNamespace(pages=[SimpleNamespace(page=1, kind=kind, factors=factors)])
    with pytest.raises(ListeningError, match=f"--pilot: {reason}"):
        power.power_of(whole, {}, pilot)


def test_a_page_that_needs_too_many_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*given: Any) -> Any:
        raise TooManyListenersError("more than all")

    monkeypatch.setattr(power, "_need", fail)
    whole = planned(d=["a", "b"])
    whole.pages, whole.language = [rating(), rating(name="N", expect=1.0)], "en"
    assert [str(row) for row in power.power_of(whole, {})] == [
        "page 1, rating: more than all (not stated by the page)", "page 2, N: more than all"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("size", "batches"),
    [
        ((1,), [4000]),
        ((1500,), [1333] * 3 + [1]),
        ((20_000,), [100] * 4),
        ((100_000,), [20] * 10),
        ((3_000_000,), [1] * 200),
        ((9000, 4_000_000, 1), [444]),
    ],
)
def test_experiments_are_simulated_in_batches(size: tuple[int, ...], batches: list[int]) -> None:
    assert _batches(*size) == batches


def test_numbers_of_a_covariance(rng: np.random.Generator) -> None:
    """Of [[1, 2], [2, 1]], the eigenvalue -1 is taken as 0: 3 times its other projector."""
    for wanted, had in (
        ([[4.0, 2.0], [2.0, 3.0]], [[4.0, 2.0], [2.0, 3.0]]),
        ([[1.0, 2.0], [2.0, 1.0]], [[1.5] * 2] * 2),
    ):
        drawn = _draws(rng, np.array(wanted), 200, 100)
        assert drawn.shape == (200, 100, 2)
        np.testing.assert_allclose(np.cov(drawn.reshape(-1, 2), rowvar=False), had, atol=0.15)


def test_ratings_of_listeners_without_spread() -> None:
    """The best sound has 100, others what is heard below the reference; a reference below 90 leaves a listener out."""
    for effects, rated, kept in (([0, -10, -30], [100, 90, 70], True), ([0, 5, -120], [100, 100, 0], True),
                                 ([-20, 0], [80, 100], False), ([-10, 0], [90, 100], True)):  # fmt: skip
        people = MushraListeners(np.array(effects, float), 2, 3, 2, 0.0, 0.0, 0.0)
        y, stays = people.drawn(np.random.default_rng(1), 4, 5)
        assert y.shape == (4, 5, 2, len(effects))
        np.testing.assert_allclose(y, np.broadcast_to(rated, y.shape), atol=1e-9)
        assert stays.tolist() == [[kept] * 5] * 4
    use = MushraListeners(np.array([0.0, -40.0, -60.0]), 1, 1, 1, 5.0, 0.0, 0.0)
    y = use.drawn(np.random.default_rng(1), 1, 4000)[0][0, :, 0]
    np.testing.assert_allclose(y[:, 1] - y[:, 2], 20.0)
    assert (y[:, 1].mean(), y[:, 1].std()) == pytest.approx((60.0, 5.0), abs=0.3)
    for change in ("slope", "sound"):  # differences from the first level have sqrt(2) of slopes, one of sounds
        sds = {"slope_sd": 4.0 if change == "slope" else 0.0, "sound_sd": 4.0 if change == "sound" else 0.0}
        some = MushraListeners(np.array([0.0, -40.0]), 500, 1, 1, 0.0, residual_sd=0.0, **sds)
        y = some.drawn(np.random.default_rng(1), 1, 500)[0][0]
        apart = y[..., 1] - y[..., 0]
        over = apart[:, 0] if change == "slope" else apart[0]
        assert over.std() == pytest.approx(4.0 * (math.sqrt(2) if change == "slope" else 1.0), rel=0.12)
        assert np.ptp(apart, axis=1 if change == "slope" else 0).max() < 1e-9


def test_power_of_a_pilot_s_listeners_is_that_of_student_s_t(rng: np.random.Generator) -> None:
    """Of normal differences with an effect of 0.6 standard deviations and 20 listeners; none, where two are kept."""
    apart = rng.standard_normal(500)
    pilot = np.stack([np.zeros(500), 50 + (apart - apart.mean()) / apart.std(ddof=1)], axis=1)
    limit, shift = stats.t.ppf(0.975, 19), 0.6 * math.sqrt(20)
    expected = stats.nct.sf(limit, 19, shift) + stats.nct.cdf(-limit, 19, shift)
    found = screened_power(pilot, np.ones(500, dtype=bool), np.array([0.0, 0.6]), 20, 0.05)
    assert found == pytest.approx([expected], abs=0.03)
    assert screened_power(pilot, np.zeros(500, dtype=bool), np.array([0.0, 0.6]), 20, 0.05) == [0.0]


def test_listeners_of_a_threshold_are_added_by_15_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    """From (2.8 spread / margin)^2 on: of a spread of 2 and a margin of 1.4 from 16; 16, 19, 22, 26 are tried."""
    tried: list[int] = []

    class Grid:
        def __init__(self, page: Any):
            self.u = page

        def fit(self, tables: Any, level: float) -> Any:
            assert level == 0.95
            n = len(tables)
            tried.append(n)
            middle = 4.0 if n < 23 else 2.5  # the margin is from 4 to 5.4
            return SimpleNamespace(alone=np.tile([1.0, 5.0], 100), interval=(middle, middle + 1.5))

    monkeypatch.setattr(simulated_power, "ThresholdGrid", Grid)
    monkeypatch.setattr(simulated_power, "STAIRCASES", 3)
    monkeypatch.setattr(simulated_power.simulations, "likelihoods", lambda *given: (0, 0, np.zeros((200, 2))))
    page, people = StaircasePage.model_validate(STAIRS), SimpleNamespace(mean=4.0)
    assert threshold_listeners(page, people, 1.4, 0.05, 0.8) == 26  # type: ignore[arg-type]
    assert tried == [200, *[16] * 3, *[19] * 3, *[22] * 3, *[26] * 3]
    monkeypatch.setattr(simulated_power, "MOST", 25)
    with pytest.raises(TooManyListenersError, match=r"more than 25 listeners .* a margin of 1\.4"):
        threshold_listeners(page, people, 1.4, 0.05, 0.8)  # type: ignore[arg-type]


def test_power_of_grades_is_that_of_shares_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six listeners' shares of two comparisons are 0, 1/2 or 1: all counts of these, tested by Student's t."""
    monkeypatch.setattr(simulated_power, "EXPERIMENTS", 4000)
    effect, sd, cells, n = 3.0, 2.0, 2, 6
    u, weight = np.polynomial.hermite_e.hermegauss(60)
    q = stats.norm.cdf((effect + sd / math.sqrt(2) * u) / (sd * math.sqrt(cells / 2)))
    none, half, both = ((weight * p).sum() / weight.sum() for p in ((1 - q) ** 2, 2 * q * (1 - q), q**2))
    expected = 0.0
    for i in range(n + 1):
        for j in range(n + 1 - i):
            shares = np.repeat([0.0, 0.5, 1.0], [i, j, n - i - j])
            alike = 1.0 if j == n else 2 * 0.5**n  # by the sign test
            p = alike if np.ptp(shares) == 0 else stats.ttest_1samp(shares, 0.5).pvalue
            expected += (p < 0.05) * stats.multinomial.pmf([i, j, n - i - j], n, [none, half, both])
    found = ordinal_power([0.0, effect], sd, cells, (-500.0, 700.0), n, 0.05)
    assert 0.3 < expected < 0.9
    assert found == pytest.approx([expected], abs=0.03)
    assert ordinal_power([60.0, 70.0], 0.1, 1, (0.0, 100.0), 8, 0.05).tolist() == [0.0]  # both at the upper end
    assert ordinal_power([48.0, 60.0], 0.1, 1, (0.0, 100.0), 8, 0.05).tolist() == [1.0]
    same, other = ordinal_power([0.0, 0.0, 30.0], 1.0, 3, (0.0, 100.0), 12, 0.05)
    assert same < 0.07
    assert other == 1.0
