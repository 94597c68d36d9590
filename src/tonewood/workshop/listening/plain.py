"""Results in plain words: sentences for the head of a report, and a paragraph on methods for a paper."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tonewood.support.units import counted
from tonewood.workshop.batch.pages import PairedPage, StaircasePage
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.detection import Detection, sensitivity, task_of
from tonewood.workshop.listening.models import END_SHARE, FactorTest, LinearAnalysis, ModelTerm, Superiority
from tonewood.workshop.listening.ordinal import OddsTerm, OddsTest
from tonewood.workshop.listening.results import PageResults, PanelResults
from tonewood.workshop.listening.table import VERSUS

#: share of right answers that is one just-noticeable difference where no staircase states another
JND_SHARE = 2.0**-0.5


def summary(panel: PanelResults) -> list[str]:
    """Sentences on each page: the difference, how sure it is, in the varied unit and in just-noticeable differences."""
    sentences = []
    for page in panel.pages:
        lines = _of_page(panel, page)
        sentences += [f"Page {page.page}, {page.heading}: {line}" for line in lines]
    return sentences


def _of_page(panel: PanelResults, page: PageResults) -> list[str]:
    percent = f"{100 * panel.confidence:g} %"
    if page.thresholds is not None:
        return [_threshold(panel, page, percent)]
    if page.pairs:
        lines = [_detected(panel, page, one, percent) for one in page.pairs]
        return lines + ([_cells(page, 1 - panel.confidence)] if len(page.detections) > len(page.pairs) else [])
    if page.scale:
        best = max(page.scale, key=lambda s: s.value)
        sure = [s for s in page.scale if s is not best and s.high < best.low]
        settings = panel.test.pages[page.page - 1]
        question = "" if not isinstance(settings, PairedPage) else " in answer to the question"
        if not sure:
            return [f"no level is chosen more often than all others{question}: the {percent} intervals overlap."]
        return [f"{best.level} is chosen more often than {' and '.join(s.level for s in sure)}{question} "
                f"({percent} intervals of the Bradley-Terry values do not overlap)."]  # fmt: skip
    if page.linear is None:
        rated = any(row["value"] is not None for row in page.rows)
        return [_untested(page)] if rated and page.factors else []
    return _rated(panel, page, page.linear, percent)


def _untested(page: PageResults) -> str:
    """Why ratings are not tested."""
    left = f", {counted(len(page.screened), 'listener')} left out by the screening" if page.screened else ""
    return f"no difference is tested, with answers of {counted(page.listeners, 'listener')}{left}; three are needed."


def _cells(page: PageResults, alpha: float) -> str:
    """The cells of the other factors in which a pair is told apart, p by Holm over the cells."""
    sure = [one for one in page.detections if one.p_holm is not None and one.p_holm < alpha]
    of = f"of {len(page.detections)} cells"
    if not sure:
        return f"in none {of} is a pair shown to be told apart by the answers of that cell alone (p by Holm)."
    text = "; ".join(f"{_levels(one)} ({one.right} of {one.answers} right, p {_p(one.p_holm or 0.0)})" for one in sure)
    return f"in {len(sure)} {of} a pair is told apart by the answers of that cell alone (p by Holm): {text}."


def _levels(one: Detection) -> str:
    return ", ".join(f"{k} {' and '.join(v.split(VERSUS))}" for k, v in one.cell.items())


def _rated(panel: PanelResults, page: PageResults, linear: LinearAnalysis, percent: str) -> list[str]:
    alpha = 1 - panel.confidence
    differences = [_difference(panel, page, linear, term) for term in linear.terms if len(term.effect) == 1]
    # differences that are found come first
    lines = [text + "." for p, text in sorted(differences, key=lambda one: one[0] >= alpha)]
    bent = page.ordinal or (linear.at_ends or 0.0) > END_SHARE
    if page.ordinal:
        lines.append(
            "grades have an order but no stated distance: odds of higher grades and shares of comparisons are "
            "reported, not points."
        )
    elif bent:
        lines.append(
            f"{100 * (linear.at_ends or 0):.0f} % of the answers stand at an end of the scale, where differences in "
            "points are pulled together and interactions may be the scale's: odds of higher ratings and shares of "
            "comparisons are reported, too."
        )
    if page.everybody is not None:
        lines.append(
            f"{counted(len(page.screened), 'listener')} left out by the ratings of reference and anchors. That choice "
            "favours the reference: each line has the figures without or with them, whichever have the larger p."
        )
    lines += [
        f"the effect of {' depends on '.join(t.name.split(' : '))} (p {_p(t.p_value)}): see the means per cell."
        for t in map(_least_sure, _interactions(page))
        if t.p_value < alpha
    ]
    return lines + [f"{note}." for note in linear.notes if note.startswith(("left out", "not stated"))]


def _analyses(page: PageResults) -> tuple[PageResults, ...]:
    """The page, and its analyses with the listeners who were left out."""
    return (page,) if page.everybody is None else (page, page.everybody)


def _interactions(page: PageResults) -> list[list[FactorTest | OddsTest]]:
    """Tests of each interaction without and with the listeners who were left out."""
    tests: dict[str, list[FactorTest | OddsTest]] = {}
    for one in _analyses(page):
        model = one.odds if page.ordinal else one.linear
        for test in model.tests if model is not None else ():
            if " : " in test.name:
                tests.setdefault(test.name, []).append(test)
    return list(tests.values())


def _least_sure(tests: list[FactorTest | OddsTest]) -> FactorTest | OddsTest:
    return max(tests, key=lambda test: test.p_value)


def _difference(panel: PanelResults, page: PageResults, linear: LinearAnalysis, term: ModelTerm) -> tuple[float, str]:
    """Probability of a difference, adjusted for those of the same factor, and the difference in words."""
    percent, alpha = f"{100 * panel.confidence:g} %", 1 - panel.confidence
    first, level = term.first, term.name.partition("=")[2]
    varied = _in_unit(panel, term.effect[0], first, level)
    odds = _odds(page, term.name, percent)
    share = _superiority(page, term.effect[0], first, level)
    rated = "" if share is None else (
        f"{level} is rated above {first} in {100 * share.share:.0f} % of comparisons ({percent} interval "
        f"{100 * share.low:.0f} to {100 * share.high:.0f} %, {_p_of(share)})"
    )  # fmt: skip
    if page.ordinal and share is not None:
        shown = "" if share.p_holm < alpha else f"no difference between {level} and {first} is shown: "
        return share.p_holm, f"{shown}{rated}{f' ({varied})' if varied else ''}{odds}"
    same = term.name, first
    terms = [t for a in _analyses(page) if a.linear is not None for t in a.linear.terms if (t.name, t.first) == same]
    term = max(terms, key=lambda t: t.p_holm)
    p = term.p_holm
    interval = f"{percent} interval {_number(term.low)} to {_number(term.high)}, {_p_of(term)}"
    if term.low == term.high:
        interval = f"the same for every listener, sign test {_p_of(term)}"
    about = f"{varied}; " if varied else ""
    if p < alpha:
        way = "above" if term.difference > 0 else "below"
        text = f"{level} is rated {abs(term.difference):.3g} points {way} {first} ({about}{interval})"
    elif term.low == term.high == 0:
        text = f"no difference between {level} and {first} is shown ({about}every listener's answers to both are equal)"
    else:
        most = max(abs(term.low), abs(term.high))
        text = (
            f"no difference between {level} and {first} is shown ({about}{_number(term.difference)} points, {interval})"
        )
        text += f"; one of more than {most:.3g} points is unlikely" if term.low < term.high else ""
    bent = (linear.at_ends or 0.0) > END_SHARE
    return p, text + (f"; {rated}{odds}" if bent and rated else odds)


def _superiority(page: PageResults, factor: str, first: str, level: str) -> Superiority | None:
    """Share of comparisons in which `level` is rated above `first`."""
    shares = []
    for one in (s for analysis in _analyses(page) if analysis.ranks is not None for s in analysis.ranks.superiority):
        if one.factor != factor:
            continue
        if (one.first, one.second) == (first, level):
            shares.append(one)
        if (one.first, one.second) == (level, first):
            back = replace(one, first=first, second=level, share=1 - one.share, low=1 - one.high, high=1 - one.low)
            shares.append(back)
    return max(shares, key=lambda one: one.p_holm, default=None)


def _odds(page: PageResults, name: str, percent: str) -> str:
    """The ratio of odds of a difference in words; nothing where it is not stated."""
    terms = [t for one in _analyses(page) if one.odds is not None for t in one.odds.terms if t.name == name]
    term = max(terms, key=lambda t: t.p_holm, default=None)
    if term is None:
        return ""
    bounds = f"{percent} interval {_number(term.low)} to {_number(term.high)}"
    return f"; the odds of a higher rating are {_number(term.ratio)} times as large ({bounds}, {_p_of(term)})"


def _detected(panel: PanelResults, page: PageResults, one: Detection, percent: str) -> str:
    cell = _levels(one)
    if one.share is None or one.p_holm is None:
        return f"{cell}: nobody decided."
    settings = panel.test.pages[page.page - 1]
    task = task_of(settings)
    pair = next(((k, *v.split(VERSUS)) for k, v in one.cell.items() if VERSUS in v), None)
    varied = _in_unit(panel, *pair) if pair is not None and len(pair) == 3 else ""
    varied = f" ({varied})" if varied else ""
    share = f"{one.right} of {one.answers} answers, {100 * one.share:.0f} %"
    if one.p_holm >= 1 - panel.confidence:
        bound = "" if one.d_high is None else f"; d' is at most {one.d_high:.2g}"
        return f"{cell}{varied} are not shown to be told apart ({share}, {_p_of(one)}{bound})."
    jnd = ""
    if one.d_prime is not None and task is not None:
        unit = sensitivity(JND_SHARE, task)
        bounds = (
            ""
            if one.d_low is None
            else f" ({percent} interval from {one.d_low:.2f})"
            if one.d_high is None
            else f" ({percent} interval {one.d_low:.2f} to {one.d_high:.2f})"
        )
        jnd = f"; d' = {one.d_prime:.2f}{bounds}, {one.d_prime / unit:.2g} just-noticeable differences by these answers"
    elif one.d_prime is None and one.d_low is not None and task is not None:
        jnd = f"; d' is at least {one.d_low:.2f}"
    return f"{cell}{varied} are told apart ({share} right, {_p_of(one)}{jnd})."


def _threshold(panel: PanelResults, page: PageResults, percent: str) -> str:
    staircase, fit = panel.test.pages[page.page - 1], page.thresholds
    assert isinstance(staircase, StaircasePage)
    assert fit is not None
    unit = f" {fit.unit}".rstrip()
    base = staircase.reference
    varied = f" of {staircase.path}"
    if isinstance(base, (int, float)) and not isinstance(base, bool):
        varied += f", {staircase.value(fit.mean, base):.4g} instead of {base:g}"
    interval = "of one listener, without an interval of the mean"
    if len(fit.listeners) > 1:
        low = staircase.lowest if fit.low is None else fit.low
        high = staircase.highest if fit.high is None else fit.high
        interval = f"{percent} interval {low:.3g} to {high:.3g}{unit}"
        if fit.low is None or fit.high is None:
            ends = "both ends" if fit.low is fit.high else "its lower end" if fit.low is None else "its upper end"
            interval += f", beyond the levels at {ends}"
    spread = "" if len(fit.listeners) < 2 else (
        f"; listeners differ by a factor of {fit.spread:.2f}" if staircase.ratio
        else f"; standard deviation {fit.spread:.2g}{unit}"
    )  # fmt: skip
    share = f"at {100 * fit.share:.1f} % right answers"
    if not staircase.lowest <= fit.mean <= staircase.highest:
        side, end = ("below", staircase.lowest) if fit.mean < staircase.lowest else ("above", staircase.highest)
        return (
            f"the just-noticeable difference of {staircase.path} lies {side} the levels that can be presented, which "
            f"end at {end:g}{unit}: no more can be said of it ({interval})."
        )
    return f"the just-noticeable difference is {fit.mean:.3g}{unit}{varied}, {share} ({interval}{spread})."


def _in_unit(panel: PanelResults, factor: str, first: str, second: str) -> str:
    """Difference of two levels in the parameter that they set, and in just-noticeable differences of a staircase."""
    factor_settings = panel.test.manifest.factors.get(factor)
    if factor_settings is None or first not in factor_settings.levels or second not in factor_settings.levels:
        return ""
    a, b = factor_settings.levels[first], factor_settings.levels[second]
    if _scalar(a) is None or _scalar(b) is None:
        return ""
    text = f"{factor_settings.path} {_value(b)} against {_value(a)}"
    for page in panel.pages:
        stairs = panel.test.pages[page.page - 1]
        if page.thresholds is None or not isinstance(stairs, StaircasePage) or stairs.path != factor_settings.path:
            continue
        seen = stairs.lowest <= page.thresholds.mean <= stairs.highest
        if (x := _as_level(stairs, a, b)) is not None and page.thresholds.mean > 0 and seen:
            text += f", {abs(x) / page.thresholds.mean:.2g} just-noticeable differences"
        break
    return text


def _scalar(value: Any) -> float | None:
    """Number of a level: a value, ``{scale: x}`` or ``{fraction: x}``."""
    if isinstance(value, Mapping) and len(value) == 1:
        value = next(iter(value.values()))
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        ((key, number),) = value.items()
        return f"{number:g} times" if key == "scale" else f"{key} {number:g}"
    return f"{value:g}"


def _as_level(page: StaircasePage, first: Any, second: Any) -> float | None:
    """Difference of two numbers on the scale of a staircase."""
    if isinstance(first, Mapping) or isinstance(second, Mapping):
        return None
    a, b = float(first), float(second)
    if page.scale in ("value", "add"):
        return b - a
    if a == 0 or b / a <= 0:
        return None
    return 100 * (b / a - 1) if page.scale == "percent" else 20 * math.log10(b / a)


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}")


def _p(value: float) -> str:
    return "< 0.001" if value < 0.001 else f"= {value:.3f}"


def _p_of(test: ModelTerm | OddsTerm | Superiority | Detection) -> str:
    """Probability of a test, which says where it is adjusted for the others: the interval beside it is not."""
    return f"p{'' if test.p_holm == test.p_value else ' by Holm'} {_p(test.p_holm or 0.0)}"


def methods(panel: PanelResults) -> str:
    """A paragraph on methods, to be shortened for a paper."""
    test = panel.test
    parts = [
        f"{panel.listeners} listeners took part"
        + (f", {panel.simulated} of them simulated" if panel.simulated else "")
        + f"; {len(panel.table.rows)} answers were given. Intervals are of {100 * panel.confidence:g} %."
    ]
    linear = [page.linear for page in panel.pages if page.linear is not None]
    for one in dict.fromkeys((x.method, x.random) for x in linear):
        sampled = f" The levels of {', '.join(one[1])} are treated as a random sample." if one[1] else ""
        parts.append(
            f"Ratings were analysed by {one[0]}; main effects are over all cells of the other factors, p values of "
            f"differences are adjusted by Holm within an effect.{sampled}"
        )
    if any(page.odds is not None for page in panel.pages):
        parts.append(
            "Grades without stated distances, and ratings of which many stand at an end of the scale, were also "
            "analysed by a cumulative logit model with proportional odds (McCullagh 1980), its covariance matrix "
            "clustered by listener; ratios are of the odds of a higher grade."
        )
    if any(page.screened for page in panel.pages):
        parts.append(
            "Listeners were screened after ITU-R BS.1534-3; tests are reported without and with those left out."
        )
    if any(page.detections for page in panel.pages):
        parts.append(
            "Right answers to a pair, over all other factors, were tested against guessing by one-sided exact binomial "
            "tests, p by Holm over the pairs, and so were those of single cells, p by Holm over the cells; d' is the "
            "mean of a normal population of listeners, by maximum likelihood of the listeners' counts under the task's "
            "model."
        )
    if any(page.scale for page in panel.pages):
        parts.append(
            "Paired comparisons were scaled by Bradley and Terry's model, with intervals clustered by listener."
        )
    parts += [text for page in panel.pages if page.thresholds is not None for text in [_stairs(test, page)]]
    return " ".join(dict.fromkeys(parts))


def _stairs(test: ListeningTest, page: PageResults) -> str:
    spec = test.pages[page.page - 1]
    assert isinstance(spec, StaircasePage)
    rule = (
        f"QUEST+ (Watson 2017), {spec.trials} trials"
        if spec.adaptive == "quest_plus"
        else f"a {spec.down}-down, 1-up staircase (Levitt 1971), {spec.reversals} reversals"
    )
    return (
        f"Thresholds of {spec.path} were measured by {rule} in {spec.tracks} track{'s' if spec.tracks > 1 else ''}, "
        f"{spec.intervals} intervals, at {100 * spec.share:.1f} % right answers, and estimated by a hierarchical "
        "logistic psychometric function over all trials and listeners, lapse rates marginal."
    )
