"""Simulated panels, and the power that is promised."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from pathlib import Path

import listening_fakes as fakes
import listening_studies as studies
import numpy as np
import pytest
from scipy import stats
from statistics_rows import panel

from tonewood.cli.main import run
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening import power, results, simulations
from tonewood.workshop.listening.models import bradley_terry
from tonewood.workshop.listening.panel import simulate
from tonewood.workshop.listening.plain import summary
from tonewood.workshop.listening.results import analyse


def test_a_panel_without_effects_rates_the_hidden_reference_like_the_others(tmp_path: Path) -> None:
    """It gave the hidden reference 100 and the others their deviations: p was 5e-5."""
    pages = [
        {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]},
        {"type": "bs1116", "group_by": ["pluck"], "reference": {"damping": "complex"}},
    ]
    test = fakes.made(tmp_path, pages)
    simulate(test, panel(), 60, seed=5)
    mushra, grades = analyse(tmp_path / "out", screening=False).pages
    for term in mushra.linear.terms:
        assert term.p_value > 1e-3
        assert abs(term.difference) < 3
    best = [row["role"] for row in mushra.rows if row["value"] == 100.0]
    assert 0.2 < best.count("reference") / len(best) < 0.5  # one of three: at chance
    values = [row["value"] for row in grades.rows]
    assert abs(np.mean(np.sign(values))) < 0.25


@pytest.mark.validate
def test_panels_without_effects_find_effects_in_5_percent_of_tests(tmp_path: Path) -> None:
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]}
    test = fakes.made(tmp_path, [page])
    alarms = []
    for seed in range(300):
        for old in (tmp_path / "out" / "answers").glob("*"):
            old.unlink()
        simulate(test, panel(slope_sd=4.0), 14, seed=seed)
        (found,) = analyse(tmp_path / "out", screening=False).pages
        alarms += [t.p_value < 0.05 for t in found.linear.tests]
    assert 0.03 < np.mean(alarms) < 0.07


def test_screening_does_not_make_effects(tmp_path: Path) -> None:
    """It leaves those out who missed the hidden reference: the figures of the first lines are not of the rest alone."""
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500]}
    simulate(fakes.made(tmp_path, [page]), panel(), 100, seed=1)
    found = analyse(tmp_path / "out")
    (own,) = found.pages
    assert len(own.screened) > 15
    assert own.linear.terms[0].high < 0  # of those who are left
    lines = summary(found)
    assert any("no difference between proportional and complex is shown" in line for line in lines)
    for line in lines:
        if "95 % interval" in line and "no difference" in line and "points" in line:
            low, high = line.split("95 % interval ")[1].split(",")[0].split(" to ")
            assert float(low.replace("\N{MINUS SIGN}", "-")) <= 0 <= float(high.replace("\N{MINUS SIGN}", "-"))
    assert not any("depends on" in line for line in lines)


def test_pairs_are_tested_over_all_cells_and_cells_by_holm(tmp_path: Path) -> None:
    """--dry-run counted the answers of all cells, the report tested each cell, unadjusted."""
    page = {"type": "abx", "group_by": ["pluck"], "pairs": {"damping": "all"}, "times": 2, "expect": 0.8}
    test = fakes.made(tmp_path, [page])
    simulate(test, panel(d_prime={"damping": {"block": 2.5}}), 8, seed=2)
    found = analyse(tmp_path / "out")
    (own,) = found.pages
    assert (len(own.pairs), len(own.detections)) == (3, 9)
    raw = [stats.binomtest(p.right, 8 * 3 * 2, 0.5, alternative="greater").pvalue for p in own.pairs]
    assert [p.p_value for p in own.pairs] == pytest.approx(raw)
    assert min(p.p_holm for p in own.pairs) == pytest.approx(3 * min(raw))
    assert min(d.p_holm for d in own.detections) == pytest.approx(9 * min(d.p_value for d in own.detections))
    lines = summary(found)
    assert sum("told apart (" in line and "of 48 answers" in line for line in lines) == 3
    assert "9 cells" in lines[-1]
    (row,) = power.power_of(test.manifest, {0: 6})
    assert row.listeners == math.ceil(power.answers_for_share(0.8, 0.5, 0.05 / 3, 0.8) / 6)
    assert "over all cells, of one of 3 pairs" in str(row)


@pytest.mark.slow
def test_too_few_listeners_and_thresholds_beyond_the_levels_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first lines left the page out; the threshold was 32 % of levels that end at 10 %; the command broke off."""
    pages = [{"type": "rating", "scales": [{"name": "dry", "label": "Dry"}]},
             {"type": "ab", "pairs": {"damping": ["complex", "block"]}},
             fakes.STAIRS | {"reversals": 4, "longest": 12, "discard": 1}]  # fmt: skip
    simulate(fakes.made(tmp_path, pages), panel(), 2, seed=1)
    found = analyse(tmp_path / "out")
    lines = summary(found)
    assert "no difference is tested, with answers of 2 listeners; three are needed." in lines[0]
    assert "lies above the levels that can be presented, which end at 10 %" in lines[-1]
    assert found.pages[1].pairs[0].d_high is None  # six answers put no bound on d'
    with pytest.raises(SystemExit) as done:
        run(["results", str(tmp_path / "out")])
    assert not done.value.code
    assert "\N{EN DASH}]" in capsys.readouterr().out.split("threshold")[1]


def test_few_listeners_who_agree_are_no_scale() -> None:
    """Three of three made an interval without width: in one of four tests of coins."""
    rows = [{"listener": str(i), "f": "x|y", "value": 1.0} for i in range(12)]
    for n, sure in ((3, False), (5, False), (7, True), (12, True)):  # as in the sign test, from six or seven on
        x, y = bradley_terry(rows[:n], "f", 0.95)
        assert (y.low > x.high) == sure
    alarms, covered = studies.choice_rates(np.random.default_rng(2), 300, 12, 2, 0.5)
    assert alarms < 0.09
    assert covered > 0.91


def test_the_power_promised_is_had() -> None:
    promised = power.rating_power([0.0, 5.0, 0.0], 8.0**2 / 2 * np.eye(3), 25, 0.05)[0]
    had = studies.power_had(np.random.default_rng(3), 3000, 25, 5.0, 8.0)
    assert had == pytest.approx(promised, abs=0.035)


def test_power_is_that_of_student_s_t() -> None:
    """Differences of two levels: of listeners, or of random sounds where listeners hardly differ."""
    mean, sd, n = 5.0, 8.0, 20
    at = stats.t.ppf(0.975, n - 1)
    law = stats.nct(n - 1, mean / sd * math.sqrt(n))
    true = law.sf(at) + law.cdf(-at)
    wide, narrow = sd**2 / 2 * np.eye(2), 1e-4 * np.eye(2)
    assert power.rating_power([0.0, mean], wide, n, 0.05)[0] == pytest.approx(true, abs=0.025)
    sounds = power.SoundSpread(n, wide, np.zeros((2, 2)))
    assert power.rating_power([0.0, mean], narrow, 60, 0.05, sampled=sounds)[0] == pytest.approx(true, abs=0.025)


@pytest.mark.slow
def test_power_of_random_sounds_is_had(tmp_path: Path) -> None:
    """Six sounds, which differ in the effect: the power is that of the quasi-F, whatever the number of listeners."""
    own, spread = power.stated_spread(12.0, 5.0, 6, 2)
    promised = power.rating_power([0.0, 8.0], own, 20, 0.05, sampled=spread)[0]
    had = studies.power_had_by_sounds(np.random.default_rng(3), 1500, 20, 6, 8.0, 12.0, 5.0)
    assert had == pytest.approx(promised, abs=0.04)
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "expect": 10.0}
    fixed = fakes.made(tmp_path, [page])
    factor = next(f for f, x in fixed.manifest.choices().items() if f != "damping" and len(x) > 1)
    few = []
    for spread in (1.5, 30.0):
        pages = [fixed.manifest.pages[0].model_copy(update={"expect_sound_sd": spread})]
        few += power.power_of(fixed.manifest.model_copy(update={"random": [factor], "pages": pages}), {})
    (whole,) = power.power_of(fixed.manifest, {})
    assert few[0].listeners > whole.listeners
    assert "random sounds with sd 1.5" in str(few[0])
    row = few[1]
    assert row.listeners is None
    assert "no number of listeners is enough for 10 points" in str(row)


@pytest.mark.slow
def test_power_of_ordinal_scales_is_that_of_shares_of_comparisons(tmp_path: Path) -> None:
    """Grades are drawn one by one and analysed as in the report; a scale that ends changes little."""
    promised = power.ordinal_power([0.0, 0.6, 0.0], 1.0, 6, (1.0, 5.0), 25, 0.05)[0]
    had = studies.power_had_by_shares(np.random.default_rng(3), 300, 25, 0.6, 1.0)
    assert had == pytest.approx(promised, abs=0.07)
    assert power.ordinal_power([0.0, 0.6, 0.0], 1.0, 6, (2.9, 3.1), 25, 0.05)[0] == pytest.approx(promised, abs=0.06)
    assert power.ordinal_power([0.0, 0.0, 0.0], 1.0, 6, (1.0, 5.0), 12, 0.05)[0] < 0.03  # a third of 5 %, by Holm
    scale = {"name": "bright", "label": "Brightness", "low": 1.0, "high": 5.0, "ordinal": True}
    test = fakes.made(tmp_path, [{"type": "rating", "scales": [scale], "expect": 0.6, "expect_sd": 1.0}])
    (row,) = power.power_of(test.manifest, {})
    assert "0.6 of 4 points, sd 1, by shares of comparisons in 3 sounds" in str(row)
    simulate(test, panel(ratings={"damping": {"block": -1.5}}, listener_sd=0.2, residual_sd=0.3), 8, seed=1)
    (piloted,) = power.power_of(test.manifest, {}, analyse(tmp_path / "out"))
    assert "8 listeners of a pilot" in str(piloted)
    assert piloted.listeners < row.listeners


def test_a_pilot_s_spread_is_of_listeners_sounds_and_pairs() -> None:
    rng = np.random.default_rng(6)
    y = rng.normal(0, 6, (400, 1, 2)) + rng.normal(0, 3, (1, 400, 2)) + rng.normal(0, 9, (400, 400, 2))
    listeners, sounds = power._pilot_spread(y, 5)
    for found, sd in ((listeners, 6.0), (sounds.sounds, 3.0), (sounds.pairs, 9.0)):
        assert np.sqrt(np.diag(found)) == pytest.approx([sd, sd], rel=0.12)
    assert sounds.count == 5


@pytest.mark.parametrize(("effect", "sd", "trials"), [(5.0, 12.0, 1), (10.0, 15.0, 4), (20.0, 20.0, 1)])
def test_stated_effects_are_those_of_the_ratings(effect: float, sd: float, trials: int) -> None:
    """Mean and spread of the rated differences, cut off at 100, are the stated ones; listeners as of a t test."""
    people = power.MushraListeners.stated(np.array([0.0, -effect]), sd, trials=trials)
    y, _ = people.drawn(np.random.default_rng(7), 1, 20_000)
    differences = (y[..., 1] - y[..., 0]).mean(axis=(0, 2))
    assert differences.mean() == pytest.approx(-effect, rel=0.04)
    assert differences.std() == pytest.approx(sd, rel=0.03)
    wanted = (sum(stats.norm.ppf([0.975, 0.8])) * sd / effect) ** 2
    needed = power.fewest(lambda m: float(power.mushra_power(people, m, 0.05)[0]), 0.8, "")
    assert needed == pytest.approx(wanted + 1.9, abs=0.1 * wanted + 1)  # t with small samples needs two more


@pytest.mark.slow
@pytest.mark.parametrize(("listeners", "random"), [(14, False), (24, True)])
def test_power_of_stated_effects_with_screening_is_had(
    listeners: int, random: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Panels take the test and their answers are analysed and screened; of 300 tests, the standard error is 2.8 %."""
    for unused in ("ordinal_analysis", "rank_analysis"):  # p of points does not depend on them
        monkeypatch.setattr(results, unused, lambda *_: None)
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [7000]}
    factors = copy.deepcopy(fakes.BASE["factors"])
    sounds, rng = {}, np.random.default_rng(4)
    if random:
        factors["pluck"]["levels"] = {f"p{i}": 1 + i / 1000 for i in range(6)}
        test = fakes.made(tmp_path, [page], factors=factors, random=["pluck"])
        people = power.MushraListeners.stated(np.array([0.0, 0.0, -10.0]), 12.0, sounds=6, sound_sd=5.0)
        sounds = {f"damping={d}, pluck={p}": 5 / math.sqrt(2) for d in factors["damping"]["levels"]
                  for p in factors["pluck"]["levels"]}  # fmt: skip
    else:
        test = fakes.made(tmp_path, [page])
        people = power.MushraListeners.stated(np.array([0.0, 0.0, -10.0]), 12.0, trials=3)
    promised = power.mushra_power(people, listeners, 0.05)[1]
    taken, left_out = 300, 0
    had = []
    for seed in range(taken):
        for old in (tmp_path / "out" / "answers").glob("*"):
            old.unlink()
        drawn = {rule: sd * rng.standard_normal() for rule, sd in sounds.items()}
        own = panel(listener_sd=people.own_sd, slope_sd=people.slope_sd, residual_sd=people.residual_sd,
                    ratings={"damping": {"block": float(people.effects[2])}}, interactions=drawn)  # fmt: skip
        simulate(test, own, listeners, seed=seed)
        found = analyse(tmp_path / "out")
        left_out += len(found.pages[0].screened)
        had.append(any(": block is rated" in line for line in summary(found)))
    assert 0.5 < promised < 0.9
    assert np.mean(had) == pytest.approx(promised, abs=0.05)
    stays = people.drawn(np.random.default_rng(1), 200, 100)[1]
    assert left_out / (taken * listeners) == pytest.approx(1 - stays.mean(), abs=0.04)


def test_power_counts_those_whom_the_screening_leaves_out() -> None:
    """With nobody left out it is that of the pilot's spread; with half of them it is near that of half as many."""
    pilot = np.repeat(np.random.default_rng(8).normal(50, 6, (200, 2)), 2, axis=0)  # half of them are as all are
    effects, half = np.array([0.0, 5.0]), np.arange(400) % 2 == 0

    def plain(n: int) -> float:
        return float(power.rating_power(effects, np.cov(pilot, rowvar=False), n, 0.05)[0])

    whole = power.screened_power(pilot, np.ones(400, dtype=bool), effects, 20, 0.05)[0]
    assert whole == pytest.approx(plain(20), abs=0.04)
    screened = power.screened_power(pilot, half, effects, 40, 0.05)[0]
    assert screened < plain(20) + 0.03  # standard error 1 %
    assert screened == pytest.approx(plain(20), abs=0.1)
    _, spread = power.stated_spread(6.0 * math.sqrt(2), 2.0, 8, 2)
    shares = [power.screened_power(pilot, who, effects, 20, 0.05, sampled=spread)[0] for who in (half | True, half)]
    listeners = np.cov(pilot, rowvar=False) - spread.pairs / 8
    assert shares[0] == pytest.approx(power.rating_power(effects, listeners, 20, 0.05, sampled=spread)[0], abs=0.05)
    assert shares[1] < shares[0] - 0.1


@pytest.mark.slow
def test_power_takes_a_pilot_s_answers(tmp_path: Path) -> None:
    page = {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "expect": 10.0}
    test = fakes.made(tmp_path, [page])
    (stated,) = power.power_of(test.manifest, {})
    simulate(test, panel(listener_sd=2.0, residual_sd=3.0, ratings={"damping": {"block": -30.0}}), 12, seed=1)
    (piloted,) = power.power_of(test.manifest, {}, analyse(tmp_path / "out"))
    assert "12 listeners of a pilot" in str(piloted)
    assert piloted.listeners < stated.listeners
    assert stated.stated
    unstated = fakes.made(tmp_path / "unstated", [{k: v for k, v in page.items() if k != "expect"}])
    assert not power.power_of(unstated.manifest, {})[0].stated
    (piloted,) = power.power_of(unstated.manifest, {}, analyse(tmp_path / "out"))
    assert piloted.stated
    assert float(piloted.effect.split()[0]) == pytest.approx(-30.0, abs=5.0)


def test_power_of_a_staircase_takes_a_pilot_s_thresholds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[simulations.Population, float]] = []

    def fewest(page: StaircasePage, people: simulations.Population, margin: float, *_: float) -> int:
        asked.append((people, margin))
        return 7

    monkeypatch.setattr(power, "threshold_listeners", fewest)
    test = fakes.made(tmp_path, [fakes.STAIRS | {"expect": 1.0, "expect_sd": 2.0, "expect_slope": 3.0, "margin": 1.3}])
    (stated,) = power.power_of(test.manifest, {})
    assert asked.pop() == (simulations.Population(1.0, math.log(2.0), 3.0), pytest.approx(math.log(1.3)))
    assert "by 30 % than 1, spread between listeners 2" in str(stated)
    simulate(test, panel(thresholds={"1": {"mean": 0.5, "sd": 1.1, "slope": 4.0}}), 4, seed=1)
    pilot = analyse(tmp_path / "out")
    seen = pilot.pages[0].thresholds
    (piloted,) = power.power_of(test.manifest, {}, pilot)
    assert asked.pop()[0] == simulations.Population(seen.mean, math.log(seen.spread), seen.slope)
    assert f"than {seen.mean:.3g}," in str(piloted)
    unfinished = replace(pilot, pages=(replace(pilot.pages[0], thresholds=None),))
    (again,) = power.power_of(test.manifest, {}, unfinished)
    assert asked.pop()[0] == simulations.Population(1.0, math.log(2.0), 3.0)
    assert again == stated


def test_the_best_sound_of_a_panel_gets_the_grade_of_the_reference(tmp_path: Path) -> None:
    """BS.1116: one of two gets 5; a sound 40 points worse than the reference gets it nearly never."""
    test = fakes.made(tmp_path, [{"type": "bs1116", "group_by": ["pluck"], "reference": {"damping": "complex"}}])
    simulate(test, panel(residual_sd=1.0, ratings={"damping": {"block": -40.0, "proportional": -40.0}}), 4, seed=2)
    (page,) = analyse(tmp_path / "out", screening=False).pages
    values = [row["value"] for row in page.rows]
    assert len(values) == 4 * 6
    assert max(values) < 0
