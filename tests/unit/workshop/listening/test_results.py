from __future__ import annotations

import csv
import io
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import listening_fakes as fakes
import numpy as np
import pytest
import soundfile
from scipy import integrate, stats

from tonewood.cli.main import run
from tonewood.sound.level.loudness import loudness
from tonewood.support.folder_lock import locked
from tonewood.workshop.batch.manifest import Stimuli
from tonewood.workshop.batch.pages import LevelPage, StaircasePage
from tonewood.workshop.listening import detection, means, power, simulated_power, thresholds
from tonewood.workshop.listening.answer_file import begin
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.models import bradley_terry, linear_analysis, rank_analysis, share_interval
from tonewood.workshop.listening.panel import SimulatedPanel, read_panel, simulate
from tonewood.workshop.listening.plain import _as_level
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.report import write_report
from tonewood.workshop.listening.results import analyse, write_tables
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.shown import shown

pytest.importorskip("jinja2")


def panel(**changes) -> SimulatedPanel:
    return SimulatedPanel.model_validate({"schema": "tonewood-panel/1", **changes})


def row(listener: str, value: float, role: str = "sound", trial: str = "t", **levels) -> dict:
    return {"listener": listener, "value": value, "role": role, "trial": trial, "repetition": 1, **levels}


@pytest.mark.slow
def test_a_simulated_panel_s_effects_are_found_again(tmp_path: Path) -> None:
    pages = [
        {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}, "anchors": [3500, 7000]},
        {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "group_by": ["pluck"], "times": 10},
        {"type": "afc", "pairs": {"pluck": ["near", "far"]}, "times": 10},
        {"type": "ab", "pairs": {"damping": ["complex", "block"]}, "times": 30},
        {"type": "paired_comparison", "pairs": {"pluck": "all"}, "question": "Brighter?", "times": 4},
        fakes.STAIRS | {"tracks": 2},
    ]
    test = fakes.made(tmp_path, pages)
    effects = {"damping": {"proportional": -20.0, "block": -40.0}}
    heard = panel(
        ratings=effects,
        interactions={"damping=block, pluck=far": -12.0},
        d_prime={"damping": {"block": 2.0}, "pluck": {"far": 1.5}},
        preference={"pluck": {"middle": 0.7, "far": 1.6}},
        thresholds={"6": {"mean": 0.5, "sd": 1.15, "slope": 4.0}},
        careless=0.1,
    )
    simulate(test, heard, 40, seed=2)
    found = analyse(tmp_path / "out")
    assert (found.simulated, found.unfinished) == (40, ())
    mushra, abx, afc, same, paired, stairs = found.pages

    assert 1 <= len(mushra.screened) <= 9  # 40 listeners, a tenth of them careless
    careful = 40 - len(mushra.screened)
    assert mushra.listeners == careful
    terms = {t.name: t for t in mushra.linear.terms}
    assert mushra.linear.formula == "value ~ damping + pluck + damping:pluck"
    for name, true in (  # main effects are over all cells: a third of the interaction is in them
        ("damping=proportional", -20.0), ("damping=block", -44.0), ("pluck=far", -4.0),
        ("damping=block : pluck=far", -12.0), ("damping=proportional : pluck=middle", 0.0),
    ):  # fmt: skip
        assert terms[name].low - 2 < true < terms[name].high + 2, (name, terms[name])
        assert terms[name].high - terms[name].low < 12
    assert terms["damping=block"].p_value < 1e-6
    pairs = {(p.first, p.second): p for p in mushra.ranks.pairs if p.factor == "damping"}
    assert pairs["complex", "block"].r == -1.0
    (damping,) = [t for t in mushra.ranks.tests if t.name == "damping"]
    assert damping.p_value < 1e-6
    assert damping.effect > 0.8

    for page, true in ((abx, 2.0), (afc, 1.5)):
        task = detection.task_of(test.pages[page.page - 1])
        for one in page.detections:
            # a careless listener guesses: the share is that of the others and of guesses
            share = 0.9 * detection.share_right(true, task) + 0.1 * detection.CHANCE[task]
            assert one.low - 0.03 < share < one.high + 0.03
    assert len(abx.detections) == 3
    assert len(abx.by_listener) == 3 * 40
    for one in same.detections:
        assert one.d_low - 0.3 < 2.0 < one.d_high + 0.6
    values = {s.level: s for s in paired.scale}
    for level, true in (("near", -23 / 30), ("middle", -2 / 30), ("far", 25 / 30)):
        assert values[level].low - 0.25 < true < values[level].high + 0.25
    # careless listeners climb to the largest level: the median is that of the others
    assert stairs.thresholds.median == pytest.approx(0.5, rel=0.12)
    reversals = [t.reversals for t in stairs.thresholds.listeners if t.reversals]
    assert np.median(reversals) == pytest.approx(0.5, rel=0.25)  # few trials: coarse, and careless listeners
    careful = [t for t in stairs.thresholds.listeners if t.threshold < 1.5]
    assert len(careful) >= 30
    assert np.mean([(t.low or 0) < 0.5 < (t.high or 9) for t in careful]) > 0.65  # they differ by 15 %

    write_tables(found, tmp_path / "results")
    with (tmp_path / "results" / "answers.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(found.table.rows)
    assert {r["simulated"] for r in rows} == {"1"}
    rated = [r for r in rows if r["type"] == "mushra" and r["role"] == "sound"]
    assert len(rated) == 40 * 3 * 2
    block = [float(r["value"]) for r in rated if r["damping"] == "block" and r["pluck"] == "near"]
    assert np.median(block) == pytest.approx(60, abs=6)
    page = write_report(found, tmp_path / "results").read_text()
    for words in (
        "40 simulated listeners",
        "damping:pluck",
        "Cohen",
        "simulated</strong>",
        "Methods",
        "just-noticeable",
    ):
        assert words in page
    for heading in re.findall(r"<h2>\d.*?</h2>", page):
        assert "simulated listeners" in heading
    assert json.loads(json.dumps(found.to_dict()))["simulated"] == 40


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.found.append(tag)


def test_every_text_of_a_report_is_escaped(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>&amp;"
    pages = [{"type": "abx", "name": evil, "pairs": {"damping": ["complex", "block"]}}]
    test = fakes.made(tmp_path, pages, title=evil)
    simulate(test, panel(), 2, seed=1)
    found = analyse(tmp_path / "out")
    write_tables(found, tmp_path / "results")
    text = write_report(found, tmp_path / "results").read_text()
    tags = Tags()
    tags.feed(text)
    assert "script" not in tags.found
    assert "&lt;script&gt;alert(1)&lt;/script&gt;&amp;amp;" in text


def test_the_same_simulated_listeners_do_not_take_a_test_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second run of `tonewood simulate` gave the same answers again: intervals became narrow."""
    test = fakes.made(tmp_path, [{"type": "rating", "scales": [{"name": "bright", "label": "B"}]}])
    assert len(simulate(test, panel(), 2, seed=1)) == 2
    with pytest.raises(ListeningError, match="--seed: is 1: its listeners took this test before"):
        simulate(test, panel(), 3, seed=1)
    assert len(simulate(test, panel(), 1, seed=2)) == 1
    assert analyse(test.folder).listeners == 3
    (tmp_path / "panel.yaml").write_text("schema: tonewood-panel/1")
    with locked(test.folder, "tonewood serve"), pytest.raises(SystemExit):
        run(["simulate", str(test.folder), "--panel", str(tmp_path / "panel.yaml"), "--seed", "3"])
    assert "is in use by tonewood serve" in capsys.readouterr().err
    assert analyse(test.folder).listeners == 3


def test_a_page_that_nobody_sees_is_not_missing(tmp_path: Path) -> None:
    """With a page of the audition file after the last one nobody had finished."""
    scales = [{"name": "bright", "label": "B"}]
    test = fakes.made(tmp_path, [{"type": "rating", "scales": scales}, {"type": "finish"}, {"type": "html"}])
    simulate(test, panel(), 1, seed=1)
    session = begin(test, language="en", listener="P1", started="")
    session.answer({"values": {"bright": 1.0}}, now="")
    assert analyse(test.folder).unfinished == ("P1",)


def test_means_and_intervals_are_student_s() -> None:
    rng = np.random.default_rng(1)
    scores = rng.normal(60, 8, 12)
    rows = [row(f"p{i}", x, f="a") for i, x in enumerate(scores)]
    (mean,) = means.cell_means(rows, ("f",), 0.95)
    assert (mean.low, mean.high) == pytest.approx(stats.t.interval(0.95, 11, scores.mean(), stats.sem(scores)))
    # two listeners, every trial another score: the interval is that of the two means 50 and 60, t(0.975, 1) = 12.706
    rows = [row("a", 40, f="a"), row("a", 60, f="a"), row("b", 50, f="a"), row("b", 70, f="a")]
    (mean,) = means.cell_means(rows, ("f",), 0.95)
    assert mean.high - mean.mean == pytest.approx(12.7062047 * np.std([50, 60], ddof=1) / np.sqrt(2), rel=1e-6)
    assert (mean.listeners, mean.answers, mean.median) == (2, 4, 55.0)


def test_screening_follows_bs1534() -> None:
    rows = []
    for trial in "1234":
        rows += [row("good", 100, "reference", trial), row("deaf", 50, "reference", trial)]
        rows += [row("edge", 90, "reference", trial), row("mid", 95, "reference", trial)]
        rows += [row(w, v, "anchor70", trial) for w, v in (("good", 40), ("deaf", 40), ("edge", 90), ("mid", 30))]
    rows[-1]["value"] = 95  # in one of four trials, 25 % > 15 %; one of four listeners is no more than 25 %
    assert [(s.listener, s.reason) for s in means.screen(rows)] == [
        ("deaf", "hidden reference below 90 in 4 of 4 trials"),
        ("mid", "mid anchor above 90 in 1 of 4 trials"),
    ]
    easy = [r for r in rows if r["role"] == "anchor70" and r["trial"] == "4"]
    for r in easy[:2]:
        r["value"] = 95  # now more than a quarter of the listeners: that trial does not count
    assert [s.listener for s in means.screen(rows)] == ["deaf"]


@pytest.mark.parametrize(
    ("task", "d", "share"),
    [
        # Macmillan & Creelman, table A5.7 (m-AFC), 2-AFC by Phi(d'/sqrt 2)
        ("more_2", 1.0, 0.7602), ("more_3", 1.0, 0.6337), ("more_3", 2.0, 0.8658),
        # Ennis, J. Sensory Stud. 8 (1993) 353-370, tables of triangle and duo-trio methods
        ("odd_3", 1.0, 0.418), ("odd_3", 2.0, 0.605), ("odd_3", 3.0, 0.781), ("abx", 1.0, 0.583), ("abx", 2.0, 0.747),
    ],
)  # fmt: skip
def test_sensitivities_are_those_of_the_tables(task: str, d: float, share: float) -> None:
    assert detection.share_right(d, task) == pytest.approx(share, abs=6e-4)
    assert detection.sensitivity(detection.share_right(d, task), task) == pytest.approx(d, rel=1e-8)
    assert detection.sensitivity(detection.CHANCE[task], task) == 0.0


def test_sensitivities_are_those_of_simulated_decisions(rng: np.random.Generator) -> None:
    """Decisions made as the tasks describe them, from noisy observations."""
    n, d = 400_000, 1.7
    x = rng.standard_normal((n, 3))
    x[:, 2] += d
    distance = np.abs(x[:, [0, 0, 1]] - x[:, [1, 2, 2]])
    odd = np.argmin(distance, axis=1)  # the closest two are alike: the third is the odd one
    assert detection.share_right(d, "odd_3") == pytest.approx(np.mean(odd == 0), abs=4e-3)
    right = np.abs(x[:, 0] - x[:, 1]) < np.abs(x[:, 0] - x[:, 2])
    assert detection.share_right(d, "abx") == pytest.approx(np.mean(right), abs=4e-3)
    k = 1.3
    hits, alarms = np.mean(np.abs(x[:, 2] - x[:, 0]) > k), np.mean(np.abs(x[:, 1] - x[:, 0]) > k)
    assert detection.sensitivity_same_different(hits, alarms) == pytest.approx(d, abs=0.02)


@pytest.mark.parametrize("kinds", [(True,), (False,), (True, False)])
def test_same_or_different_needs_pairs_of_both_kinds(kinds: tuple[bool, ...]) -> None:
    """Of one listener and of two; without pairs of one kind there is no rate of false alarms, or of hits."""
    said = {True: "different", False: "same"}
    for who in ("ab", "a"):
        rows = [
            {"listener": name, "value": float(right), "right": right, "response": said[right == pair]}
            for name in who for pair in kinds for right in (True, True, True, False)
        ]  # fmt: skip
        (one,) = detection.detections(rows, (), "same", 0.95)
        assert one.share == 0.75
        if len(kinds) == 1:
            assert (one.d_prime, one.d_low, one.d_high) == (None, None, None)
        else:  # three of four hits, one false alarm of four, half an answer added to each
            assert one.d_low < one.d_prime
            # two listeners, Student's t on one degree of freedom, put no upper bound on their population's d'
            assert one.d_high is None if who == "ab" else one.d_high > one.d_prime
            alone = detection.sensitivity_same_different(3.5 / 5, 1.5 / 5)
            assert one.d_prime == pytest.approx(alone, rel=1e-9 if who == "a" else 0.5)


@pytest.mark.parametrize(
    ("scale", "levels", "step"),
    [
        ("value", (3.0, 1.0), -2.0), ("value", (0.0, -1.5), -1.5), ("add", (-1.0, 0.5), 1.5),
        ("percent", (2.0, 3.0), 50.0), ("percent", (2.0, 1.0), -50.0), ("percent", (-2.0, -1.0), -50.0),
        ("percent", (0.0, 1.0), None), ("percent", (1.0, 0.0), None), ("percent", (1.0, -2.0), None),
        ("db", (1.0, 10.0), 20.0), ("db", (10.0, 1.0), -20.0), ("db", (0.0, 1.0), None), ("db", (1.0, 0.0), None),
        ("value", ({"scale": 2.0}, 1.0), None), ("value", (1.0, {"fraction": 0.2}), None),
    ],
)  # fmt: skip
def test_a_difference_of_levels_on_the_scale_of_a_staircase(scale: str, levels: tuple, step: float | None) -> None:
    page = StaircasePage.model_validate(fakes.STAIRS).model_copy(update={"scale": scale})
    found = _as_level(page, *levels)
    assert found == (None if step is None else pytest.approx(step, rel=1e-12))


@pytest.mark.parametrize("careless", [0.0, 1.0])
def test_listeners_hear_a_large_difference_and_careless_ones_guess(tmp_path: Path, careless: float) -> None:
    pages = [{"type": "abx", "pairs": {"damping": ["complex", "block"]}, "times": 15}]
    test = fakes.made(tmp_path, pages)
    heard = panel(d_prime={"damping": {"block": 30.0}}, careless=careless)
    simulate(test, heard, 8, seed=4)
    found = analyse(tmp_path / "out")
    right = sum(one.right for one in found.pages[0].detections)
    answers = sum(one.answers for one in found.pages[0].detections)
    assert answers >= 8 * 15
    if careless:
        assert abs(right - answers / 2) < 4 * math.sqrt(answers) / 2
    else:
        assert right == answers


def test_a_psychometric_function_is_fitted_to_its_own_answers(rng: np.random.Generator) -> None:
    page = StaircasePage.model_validate(fakes.STAIRS)
    levels = rng.choice(np.geomspace(0.05, 5.0, 25), 4000)
    p = psychometric(np.log(levels), np.log(0.5), 3.0, 1 / 3, 2**-0.5)
    grid = thresholds.ThresholdGrid(page)
    fit = grid.fit(np.array([grid.likelihood(levels, rng.random(len(p)) < p)]), 0.95)
    low, high = np.exp(fit.alone_intervals[0])
    assert low < 0.5 < high
    assert np.exp(fit.alone[0]) == pytest.approx(0.5, rel=0.08)
    assert fit.slopes[0] == pytest.approx(3.0, rel=0.2)
    at = psychometric(np.log(0.5), np.log(0.5), 3.0, 1 / 3, 2**-0.5)
    assert at == pytest.approx(2**-0.5, rel=1e-12)  # the share that two down, one up converges to


@pytest.mark.slow
def test_intervals_of_thresholds_hold_their_share(rng: np.random.Generator) -> None:
    grid = thresholds.ThresholdGrid(StaircasePage.model_validate(fakes.STAIRS))
    inside = 0
    for _ in range(100):
        levels = rng.choice(np.geomspace(0.2, 1.2, 9), 120)
        right = rng.random(120) < psychometric(np.log(levels), np.log(0.5), 3.0, 1 / 3, 2**-0.5)
        fit = grid.fit(np.array([grid.likelihood(levels, right)]), 0.95)
        inside += fit.alone_intervals[0, 0] < np.log(0.5) < fit.alone_intervals[0, 1]
    assert 88 <= inside <= 100


def test_differences_are_paired_t_tests_of_listeners(rng: np.random.Generator) -> None:
    """Balanced data: differences of cell means, and Student's paired test of the listeners' own means."""
    n, levels = 14, ["a", "b", "c"]
    own = rng.normal(0, 7, n)
    y = 50 + own[:, None, None] + np.array([0, -5, 9])[None, :, None] + rng.normal(0, 3, (n, 3, 4))
    rows = [row(f"l{i}", y[i, j, k], f=levels[j]) for i in range(n) for j in range(3) for k in range(4)]
    fit = linear_analysis(rows, ("f",), 0.95, {"f": levels})
    means_ = y.mean(axis=(0, 2))
    assert [t.difference for t in fit.terms] == pytest.approx(means_[1:] - means_[0], abs=1e-9)
    paired = [stats.ttest_rel(y.mean(axis=2)[:, j], y.mean(axis=2)[:, 0]) for j in (1, 2)]
    assert [t.p_value for t in fit.terms] == pytest.approx([t.pvalue for t in paired], rel=1e-9)
    assert [(t.low, t.high) for t in fit.terms] == [
        pytest.approx(tuple(t.confidence_interval(0.95)), rel=1e-9) for t in paired
    ]
    ranks = rank_analysis(rows, ("f",))
    table = y.mean(axis=2)
    assert ranks.tests[0].statistic == pytest.approx(stats.friedmanchisquare(*table.T).statistic)
    assert [p.p_value for p in ranks.pairs] == pytest.approx(
        [stats.wilcoxon(table[:, b] - table[:, a]).pvalue for a, b in ((0, 1), (0, 2), (1, 2))]
    )


@pytest.mark.slow
def test_p_values_are_two_sided_and_holm_s_never_fall(rng: np.random.Generator) -> None:
    """Against statsmodels, over draws in which a later pair's product is less than an earlier one's."""
    multipletests = pytest.importorskip("statsmodels.stats.multitest").multipletests
    fell = 0
    for _ in range(6):
        y = rng.normal([0.0, 0.1, 0.5, 0.8], 1, (12, 4))
        rows = [row(f"l{i}", y[i, j], f="abcd"[j]) for i in range(12) for j in range(4)]
        pairs = rank_analysis(rows, ("f",)).pairs
        raw = np.array([p.p_value for p in pairs])
        np.testing.assert_allclose([p.p_holm for p in pairs], multipletests(raw, method="holm")[1], rtol=1e-12)
        fell += np.any(np.diff(np.sort(raw) * np.arange(len(raw), 0, -1)) < 0)
    assert fell > 0
    terms = linear_analysis(rows, ("f",), 0.95, {"f": list("abcd")}).terms
    raw = [t.p_value for t in terms]
    np.testing.assert_allclose([t.p_holm for t in terms], multipletests(raw, method="holm")[1], rtol=1e-12)
    error = (terms[0].high - terms[0].low) / 2 / stats.t.ppf(0.975, 11)
    assert terms[0].p_value == pytest.approx(2 * stats.t.sf(abs(terms[0].difference) / error, 11), rel=1e-9)


def test_bradley_terry_of_two_is_the_log_of_the_odds() -> None:
    """With one tie added: 30.5 and 10.5 of 41."""
    rows = [row("a", 1.0, f="x|y")] * 30 + [row("a", 0.0, f="x|y")] * 10
    x, y = bradley_terry(rows, "f", 0.95)
    assert y.value - x.value == pytest.approx(np.log(30.5 / 10.5), rel=1e-5)
    error = np.sqrt(1 / 30.5 + 1 / 10.5)  # of the log of the odds
    assert y.high - y.value == pytest.approx(stats.norm.ppf(0.975) * error / 2, rel=1e-5)


def test_numbers_of_listeners() -> None:
    def two_levels(effect: float):
        return lambda n: float(power.rating_power([0.0, effect], np.eye(2) / 2, n, 0.05)[0])

    # Cohen, Statistical Power Analysis (1988): d = 0.5, two-sided 5 %, power 80 %, one sample: 34; d = 0.8: 15
    assert power.fewest(two_levels(0.5), 0.8, "") == pytest.approx(34, abs=1)
    assert power.fewest(two_levels(0.8), 0.8, "") == pytest.approx(15, abs=1)
    n = power.answers_for_share(0.75, 0.5, 0.05, 0.8)
    limit = stats.binom.isf(0.05, n, 0.5)
    assert stats.binom.sf(limit, n, 0.75) >= 0.8
    assert stats.binom.sf(limit, n, 0.5) <= 0.05
    assert n == 28
    with pytest.raises(ListeningError, match="not above guessing"):
        power.answers_for_share(0.5, 0.5, 0.05, 0.8)
    with pytest.raises(ListeningError, match="more than 10000 listeners"):
        power.fewest(lambda n: 0.1, 0.8, "nothing")


def test_the_stated_power_is_that_of_the_noncentral_t() -> None:
    limit, shift = stats.t.ppf(0.975, 19), 10 / 15 * np.sqrt(20)
    exact = stats.nct.sf(limit, 19, shift) + stats.nct.cdf(-limit, 19, shift)
    stated = power.rating_power([0.0, 10.0], 15**2 / 2 * np.eye(2), 20, 0.05)[0]
    assert stated == pytest.approx(exact, abs=0.025)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("schema: tonewood-panel/1\nratings: {dampng: {block: 1.0}}", "ratings: dampng is not one of"),
        ("schema: tonewood-panel/1\nratings: {damping: {blok: 1.0}}", "ratings.damping: blok is not one of complex"),
        ("schema: tonewood-panel/1\nthresholds: {'1': {mean: 1.0, slope: 1.0}}", "page 1 is no staircase; 2 is"),
        (
            "schema: tonewood-panel/1\nthresholds: {'2': {mean: 1.0, sd: 0.25, slope: 1.0}}",
            "thresholds.2.sd: is 0.25; a ratio",
        ),
        ("schema: tonewood-panel/1\nrating: {}", "rating: is not a known key; did you mean ratings?"),
    ],
)
def test_a_panel_s_mistakes_are_one_line(tmp_path: Path, text: str, line: str) -> None:
    test = fakes.made(tmp_path, [{"type": "abx", "pairs": {"damping": ["complex", "block"]}}, fakes.STAIRS])
    (tmp_path / "panel.yaml").write_text(text)
    with pytest.raises(ListeningError) as caught:
        simulate(test, read_panel(tmp_path / "panel.yaml"), 1, seed=1)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_phi_is_integrated_to_rounding() -> None:
    exact = integrate.quad(lambda z: stats.norm.pdf(z - 1.0) * stats.norm.cdf(z) ** 2, -12, 12)[0]
    assert detection.share_right(1.0, "more_3") == pytest.approx(exact, abs=1e-9)


def test_a_share_of_listeners_is_held_to_a_half_from_both_sides() -> None:
    """Student's t over listeners; a sign test where all of them have one share."""
    shares = np.array([0.5, 0.7, 0.9, 0.6, 0.4, 0.8])
    for each in (shares, 1 - shares):
        mean, low, high, p = share_interval(each, 0.95)
        found = stats.ttest_1samp(each, 0.5)
        assert p == pytest.approx(found.pvalue, rel=1e-9)
        assert (low, high) == pytest.approx(tuple(found.confidence_interval(0.95)), rel=1e-9)
        assert mean == pytest.approx(each.mean())
    for same in (0.0, 1.0):
        assert share_interval(np.full(6, same), 0.95)[3] == pytest.approx(stats.binomtest(6, 6, 0.5).pvalue)


@pytest.mark.parametrize(("channels", "target"), [(1, -23.0), (2, -30.0)])
def test_the_tone_of_the_level_page_is_as_loud_as_the_stimuli_and_loops(
    tmp_path: Path, channels: int, target: float
) -> None:
    """BS.1770: a sine near 1 kHz of amplitude a has -3.01 + 20 log10(a) LUFS in one channel, 3.01 more in two."""
    stimuli = {"loudness": {"target_lufs": target}, "channels": channels}
    pages = [{"type": "level", "spl_db": 65.0, "freq": 997.25}, {"type": "afc", "pairs": {"pluck": ["near", "far"]}}]
    test = fakes.made(tmp_path, pages, stimuli=stimuli)
    samples, fs = soundfile.read(io.BytesIO(tone(test, test.pages[0])), always_2d=True)
    assert samples.shape == (2 * fs, channels)
    level = -3.01 + 20 * np.log10(np.abs(samples).max()) + 10 * np.log10(channels)
    assert level == pytest.approx(target, abs=0.01)
    assert np.ptp(samples, axis=1).max() < 1e-6
    line = np.abs(np.fft.rfft(samples[:, 0]))
    assert line.argmax() == 1994  # 997 Hz: whole periods in two seconds
    assert np.sqrt(np.sum(np.delete(line, 1994) ** 2)) < 1e-4 * line[1994]
    assert abs(samples[0, 0]) < 1e-6


@pytest.mark.parametrize("freq", [50.0, 100.0, 4000.0, 10000.0])
def test_the_tone_of_the_level_page_is_as_loud_at_any_frequency(freq: float) -> None:
    """By the meter of BS.1770; of one amplitude 50 Hz has 4.6 LU less than 1 kHz, and 4 kHz 3.3 LU more."""
    test = SimpleNamespace(manifest=SimpleNamespace(stimuli=Stimuli(channels=2)))
    page = LevelPage(type="level", freq=freq)
    samples, fs = soundfile.read(io.BytesIO(tone(test, page)), always_2d=True)  # type: ignore[arg-type]
    assert loudness(samples, fs)[0] == pytest.approx(-23.0, abs=0.02)


@pytest.mark.parametrize(("method", "words"), [("loudest", "as loud as the sounds"), ("none", "their own levels")])
def test_the_level_page_calls_the_tone_as_loud_as_sounds_only_where_they_have_one_loudness(
    tmp_path: Path, method: str, words: str
) -> None:
    pages = [{"type": "level"}, {"type": "afc", "pairs": {"pluck": ["near", "far"]}}]
    test = fakes.made(tmp_path, pages, stimuli={"loudness": {"method": method}})
    assert words in shown(test, Session(test, 1), "en")["notes"][0]


def test_power_of_choices_is_that_of_a_test_of_their_share() -> None:
    """Without an effect the share of false alarms; with one that of the normal approximation of binomial answers."""
    assert power.choice_power(0.5, 10, 20, 0.05) == pytest.approx(0.05, abs=0.02)
    for share, each, listeners in ((0.55, 8, 80), (0.45, 8, 80), (0.56, 2, 150), (0.6, 8, 60)):
        n = each * listeners
        z = stats.norm.ppf(0.975) * math.sqrt(0.25 / n)
        deviation = math.sqrt(share * (1 - share) / n)
        expected = 1 - stats.norm.cdf((0.5 + z - share) / deviation) + stats.norm.cdf((0.5 - z - share) / deviation)
        assert power.choice_power(share, each, listeners, 0.05) == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(
    "needed", [1, 3, 4, 5, 57, 8193, simulated_power.MOST - 1, simulated_power.MOST, simulated_power.MOST + 1]
)
def test_the_fewest_listeners_are_found_up_to_the_most_that_are_tried(needed: int) -> None:
    if needed > simulated_power.MOST:
        with pytest.raises(power.TooManyListenersError, match=f"more than {simulated_power.MOST} listeners"):
            power.fewest(lambda n: 0.9 if n >= needed else 0.7, 0.8, "a nuance")
    else:
        assert power.fewest(lambda n: 0.8 if n >= needed else 0.7, 0.8, "a nuance") == max(needed, 3)


def test_training_of_a_paired_comparison_has_no_right_answer(tmp_path: Path) -> None:
    """Of a training page, too, the value is the choice: 1 for the second sound, 0 for the first, 0.5 for a tie."""
    pages = [
        {"type": "training", "page": 2, "trials": 1},
        {"type": "paired_comparison", "pairs": {"pluck": "all"}, "question": "Brighter?", "times": 2},
    ]
    test = fakes.made(tmp_path, pages)
    simulate(test, panel(preference={"pluck": {"middle": 0.7, "far": 1.6}}), 6, seed=3)
    values = [row["value"] for row in analyse(tmp_path / "out").table.rows]
    assert len(values) > 6
    assert set(values) <= {0.0, 0.5, 1.0}
