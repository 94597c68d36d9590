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
from tonewood.workshop.listening.models import END_SHARE, LinearAnalysis, ModelTerm, Superiority
from tonewood.workshop.listening.results import PageResults, PanelResults
from tonewood.workshop.listening.table import VERSUS

#: share of right answers that is one just-noticeable difference where no staircase states another
JND_SHARE = 2.0**-0.5


def summary(found: PanelResults) -> list[str]:
    """Sentences on each page: the difference, how sure it is, in the varied unit and in just-noticeable differences."""
    sentences = []
    for page in found.pages:
        lines = _of_page(found, page)
        sentences += [f"Page {page.page}, {page.heading}: {line}" for line in lines]
    return sentences


def _of_page(found: PanelResults, page: PageResults) -> list[str]:
    percent = f"{100 * found.confidence:g} %"
    if page.thresholds is not None:
        return [_threshold(found, page, percent)]
    if page.detections:
        return [_detected(found, page, one, percent) for one in page.detections]
    if page.scale:
        best = max(page.scale, key=lambda s: s.value)
        sure = [s for s in page.scale if s is not best and s.high < best.low]
        own = found.test.pages[page.page - 1]
        question = "" if not isinstance(own, PairedPage) else " in answer to the question"
        if not sure:
            return [f"no level is chosen more often than all others{question}: the {percent} intervals overlap."]
        return [f"{best.level} is chosen more often than {' and '.join(s.level for s in sure)}{question} "
                f"({percent} intervals of the Bradley-Terry values do not overlap)."]  # fmt: skip
    if page.linear is None:
        return []
    return _rated(found, page, page.linear, percent)


def _rated(found: PanelResults, page: PageResults, linear: LinearAnalysis, percent: str) -> list[str]:
    alpha = 1 - found.confidence
    differences = [_difference(found, page, linear, term) for term in linear.terms if len(term.effect) == 1]
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
            f"{counted(len(page.screened), 'listener')} left out by the ratings of reference and anchors; p is the "
            "larger of those without and with them, because that choice favours the reference."
        )
    tests = linear.tests if not page.ordinal else page.odds.tests if page.odds is not None else ()
    lines += [
        f"the effect of {' depends on '.join(t.name.split(' : '))} (p {_p(t.p_value)}): see the means per cell."
        for t in tests
        if " : " in t.name and t.p_value < alpha
    ]
    return lines


def _difference(found: PanelResults, page: PageResults, linear: LinearAnalysis, term: ModelTerm) -> tuple[float, str]:
    """Probability of a difference, adjusted for those of the same factor, and the difference in words."""
    percent, alpha = f"{100 * found.confidence:g} %", 1 - found.confidence
    first, level = _first_level(linear, page, term), term.name.partition("=")[2]
    varied = _in_unit(found, term.effect[0], first, level)
    odds = _odds(page, term.name, percent)
    share = _superiority(page, term.effect[0], first, level)
    rated = "" if share is None else (
        f"{level} is rated above {first} in {100 * share.share:.0f} % of comparisons ({percent} interval "
        f"{100 * share.low:.0f} to {100 * share.high:.0f} %, p {_p(share.p_holm)})"
    )  # fmt: skip
    if page.ordinal and share is not None:
        shown = "" if share.p_holm < alpha else f"no difference between {level} and {first} is shown: "
        return share.p_holm, f"{shown}{rated}{f' ({varied})' if varied else ''}{odds}"
    p = max([term.p_holm, *(t.p_holm for t in page.everybody.terms if t.name == term.name)]
            if page.everybody is not None else [term.p_holm])  # fmt: skip
    interval = f"{percent} interval {_number(term.low)} to {_number(term.high)}, p {_p(p)}"
    about = f"{varied}; " if varied else ""
    if p < alpha:
        way = "above" if term.difference > 0 else "below"
        text = f"{level} is rated {abs(term.difference):.3g} points {way} {first} ({about}{interval})"
    else:
        most = max(abs(term.low), abs(term.high))
        text = (
            f"no difference between {level} and {first} is shown ({about}{_number(term.difference)} points, "
            f"{interval}); one of more than {most:.3g} points is unlikely"
        )
    bent = (linear.at_ends or 0.0) > END_SHARE
    return p, text + (f"; {rated}{odds}" if bent and rated else odds)


def _first_level(linear: LinearAnalysis, page: PageResults, term: ModelTerm) -> str:
    """The level that a term is a difference from: the one without a term."""
    factor = term.effect[0]
    named = {t.name.partition("=")[2] for t in linear.terms if t.effect == term.effect}
    levels = dict.fromkeys(str(row[factor]) for row in page.rows if row["role"] in ("sound", "reference"))
    return next((level for level in levels if level not in named), "the first level")


def _superiority(page: PageResults, factor: str, first: str, level: str) -> Superiority | None:
    """Share of comparisons in which `level` is rated above `first`."""
    for one in page.ranks.superiority if page.ranks is not None else ():
        if one.factor != factor:
            continue
        if (one.first, one.second) == (first, level):
            return one
        if (one.first, one.second) == (level, first):
            return replace(one, first=first, second=level, share=1 - one.share, low=1 - one.high, high=1 - one.low)
    return None


def _odds(page: PageResults, name: str, percent: str) -> str:
    """The ratio of odds of a difference in words; nothing where it is not stated."""
    term = next((t for t in page.odds.terms if t.name == name), None) if page.odds is not None else None
    if term is None:
        return ""
    bounds = f"{percent} interval {_number(term.low)} to {_number(term.high)}"
    return f"; the odds of a higher rating are {_number(term.ratio)} times as large ({bounds}, p {_p(term.p_holm)})"


def _detected(found: PanelResults, page: PageResults, one: Detection, percent: str) -> str:
    cell = ", ".join(f"{k} {' and '.join(v.split(VERSUS))}" for k, v in one.cell.items())
    if one.share is None or one.p_value is None:
        return f"{cell}: nobody decided."
    own = found.test.pages[page.page - 1]
    task = task_of(own)
    pair = next(((k, *v.split(VERSUS)) for k, v in one.cell.items() if VERSUS in v), None)
    varied = _in_unit(found, *pair) if pair is not None and len(pair) == 3 else ""
    varied = f" ({varied})" if varied else ""
    share = f"{one.right} of {one.answers} answers, {100 * one.share:.0f} %"
    if one.p_value >= 1 - found.confidence:
        bound = "" if one.d_high is None else f"; d' is at most {one.d_high:.2g}"
        return f"{cell}{varied} are not shown to be told apart ({share}, p {_p(one.p_value)}{bound})."
    jnd = ""
    if one.d_prime is not None and task is not None:
        unit = sensitivity(JND_SHARE, task)
        bounds = (
            ""
            if one.d_low is None or one.d_high is None
            else f" ({percent} interval {one.d_low:.2f} to {one.d_high:.2f})"
        )
        jnd = f"; d' = {one.d_prime:.2f}{bounds}, {one.d_prime / unit:.2g} just-noticeable differences"
    return f"{cell}{varied} are told apart ({share} right, p {_p(one.p_value)}{jnd})."


def _threshold(found: PanelResults, page: PageResults, percent: str) -> str:
    own, fit = found.test.pages[page.page - 1], page.thresholds
    assert isinstance(own, StaircasePage)
    assert fit is not None
    unit = f" {fit.unit}".rstrip()
    base = own.reference
    varied = f" of {own.path}"
    if isinstance(base, (int, float)) and not isinstance(base, bool):
        varied += f", {own.value(fit.mean, base):.4g} instead of {base:g}"
    interval = "of one listener, without an interval of the mean"
    if fit.low is not None and fit.high is not None:
        interval = f"{percent} interval {fit.low:.3g} to {fit.high:.3g}{unit}"
    elif len(fit.listeners) > 1:
        interval = "its interval passes the levels that can be presented"
    spread = "" if len(fit.listeners) < 2 else (
        f"; listeners differ by a factor of {fit.spread:.2f}" if own.ratio
        else f"; standard deviation {fit.spread:.2g}{unit}"
    )  # fmt: skip
    share = f"at {100 * fit.share:.1f} % right answers"
    return f"the just-noticeable difference is {fit.mean:.3g}{unit}{varied}, {share} ({interval}{spread})."


def _in_unit(found: PanelResults, factor: str, first: str, second: str) -> str:
    """Difference of two levels in the parameter that they set, and in just-noticeable differences of a staircase."""
    own = found.test.manifest.factors.get(factor)
    if own is None or first not in own.levels or second not in own.levels:
        return ""
    a, b = own.levels[first], own.levels[second]
    if _scalar(a) is None or _scalar(b) is None:
        return ""
    text = f"{own.path} {_value(b)} against {_value(a)}"
    for page in found.pages:
        stairs = found.test.pages[page.page - 1]
        if page.thresholds is None or not isinstance(stairs, StaircasePage) or stairs.path != own.path:
            continue
        if (x := _as_level(stairs, a, b)) is not None and page.thresholds.mean > 0:
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


def methods(found: PanelResults) -> str:
    """A paragraph on methods, to be shortened for a paper."""
    test = found.test
    parts = [
        f"{found.listeners} listeners took part"
        + (f", {found.simulated} of them simulated" if found.simulated else "")
        + f"; {len(found.table.rows)} answers were given. Intervals are of {100 * found.confidence:g} %."
    ]
    linear = [page.linear for page in found.pages if page.linear is not None]
    for one in dict.fromkeys((x.method, x.random) for x in linear):
        sampled = f" The levels of {', '.join(one[1])} are treated as a random sample." if one[1] else ""
        parts.append(
            f"Ratings were analysed by {one[0]}; main effects are over all cells of the other factors, p values of "
            f"differences are adjusted by Holm within an effect.{sampled}"
        )
    if any(page.odds is not None for page in found.pages):
        parts.append(
            "Grades without stated distances, and ratings of which many stand at an end of the scale, were also "
            "analysed by a cumulative logit model with proportional odds (McCullagh 1980), its covariance matrix "
            "clustered by listener; ratios are of the odds of a higher grade."
        )
    if any(page.screened for page in found.pages):
        parts.append(
            "Listeners were screened after ITU-R BS.1534-3; tests are reported without and with those left out."
        )
    if any(page.detections for page in found.pages):
        parts.append(
            "Right answers were tested against guessing by one-sided exact binomial tests; d' is the mean of a normal "
            "population of listeners, by maximum likelihood of the listeners' counts under the task's model."
        )
    if any(page.scale for page in found.pages):
        parts.append(
            "Paired comparisons were scaled by Bradley and Terry's model, with intervals clustered by listener."
        )
    parts += [text for page in found.pages if page.thresholds is not None for text in [_stairs(test, page)]]
    return " ".join(dict.fromkeys(parts))


def _stairs(test: ListeningTest, page: PageResults) -> str:
    own = test.pages[page.page - 1]
    assert isinstance(own, StaircasePage)
    rule = (
        f"QUEST+ (Watson 2017), {own.trials} trials"
        if own.adaptive == "quest_plus"
        else f"a {own.down}-down, 1-up staircase (Levitt 1971), {own.reversals} reversals"
    )
    return (
        f"Thresholds of {own.path} were measured by {rule} in {own.tracks} track{'s' if own.tracks > 1 else ''}, "
        f"{own.intervals} intervals, at {100 * own.share:.1f} % right answers, and estimated by a hierarchical "
        "logistic psychometric function over all trials and listeners, lapse rates marginal."
    )
