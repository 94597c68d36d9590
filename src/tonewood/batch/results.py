"""The statistics of a listening test: means with confidence intervals, post-screening, detection rates.

Scores (MUSHRA 0 to 100; BS.1116 the sound's grade minus the hidden reference's). Answers of one listener are not
independent, so a mean over several trials is taken of the listeners' means, and its interval is Student's

    mean ± t(1 - a/2, n - 1) s / sqrt(n)          n listeners, s the standard deviation of their means.

Choices (paired comparison). The share of right answers among those decided, with the exact (Clopper-Pearson)
interval, and the probability of as many by guessing (one-sided binomial test against 1/2); here every answer counts
as independent.

Post-screening is that of ITU-R BS.1534-3, 4.1.2: a listener is left out who rates the hidden reference below 90, or
the mid anchor (7 kHz) above 90, in more than 15 % of the trials; a trial whose mid anchor more than a quarter of all
listeners rate above 90 does not count for the second rule.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tonewood.batch.answers import HELPERS, Answer, Kind, ResultsError, read_answers, read_key
from tonewood.plotting import COLOURS, LINE, figure, plain, title
from tonewood.whole_files import whole_file

LIMIT_SCORE = 90.0
LIMIT_SHARE = 0.15
EASY_ITEM_SHARE = 0.25


@dataclass(frozen=True)
class RatingMean:
    """Scores of one label, over all trials (`trial` is None) or in one.

    Attributes
    ----------
    mean, low, high : of the listeners' means, with the bounds of the interval (None with one listener).
    median, lower_quartile, upper_quartile : of all ratings.
    """

    label: str
    trial: str | None
    listeners: int
    ratings: int
    mean: float
    low: float | None
    high: float | None
    median: float
    lower_quartile: float
    upper_quartile: float


@dataclass(frozen=True)
class Rate:
    """Choices between the reference and one label, over all trials (`trial` is None) or in one."""

    label: str
    trial: str | None
    listeners: int
    correct: int
    incorrect: int
    undecided: int
    unknown: int
    rate: float | None
    low: float | None
    high: float | None
    p_value: float | None


@dataclass(frozen=True)
class Screened:
    """A listener who is left out, and by which rule."""

    listener: str
    reason: str


@dataclass(frozen=True)
class Results:
    """All that is known of one table of answers."""

    kind: Kind
    name: str
    confidence: float
    listeners: int
    screened: tuple[Screened, ...]
    overall: tuple[RatingMean, ...] | tuple[Rate, ...]
    per_trial: tuple[RatingMean, ...] | tuple[Rate, ...]
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


def analyse(
    results: str | os.PathLike[str],
    key: str | os.PathLike[str],
    *,
    confidence: float = 0.95,
    screening: bool = True,
) -> Results:
    """Read a table of webMUSHRA and the batch's key, and work out the statistics.

    Parameters
    ----------
    results : CSV of webMUSHRA, of any of its three test types.
    key : the batch's ``key.json``.
    confidence : of the intervals, between 0 and 1.
    screening : leave out listeners after BS.1534-3 (MUSHRA only).

    Raises
    ------
    ResultsError
        A file cannot be read, a row does not fit, or the screening leaves nobody.
    """
    if not 0.0 < confidence < 1.0:
        raise ResultsError(f"confidence {confidence} must lie between 0 and 1")
    opened = read_key(key)
    kind, answers = read_answers(results, opened)
    everyone = _unique(a.listener for a in answers)
    screened = screen(answers) if kind == "mushra" and screening else ()
    out = {s.listener for s in screened}
    kept = [a for a in answers if a.listener not in out]
    if not kept:
        raise ResultsError(f"none of {len(everyone)} listeners passes the screening", file=results)
    summary: Callable[..., Any] = _rate if kind == "paired_comparison" else _mean
    labels = sorted(_unique(a.label for a in kept), key=lambda label: (label in HELPERS, label))
    names = {t: f"{opened.trials[t].group} ({t})" for t in _unique(a.trial for a in kept)}
    overall = tuple(summary(label, None, [a for a in kept if a.label == label], confidence) for label in labels)
    per_trial = tuple(
        summary(label, names[trial], chosen, confidence)
        for trial in names
        for label in labels
        if (chosen := [a for a in kept if a.trial == trial and a.label == label])
    )
    return Results(
        kind, opened.name, confidence, len(everyone), tuple(screened), overall, per_trial, _incomplete(answers)
    )


def screen(answers: Sequence[Answer]) -> tuple[Screened, ...]:
    """Listeners to be left out by BS.1534-3; see the module."""
    low = {(a.listener, a.trial): a.score < LIMIT_SCORE for a in answers if a.label == "reference"}
    high = {(a.listener, a.trial): a.score > LIMIT_SCORE for a in answers if a.label == "anchor70"}
    for trial in _unique(trial for _, trial in high):
        marks = [mark for (_, t), mark in high.items() if t == trial]
        if sum(marks) > EASY_ITEM_SHARE * len(marks):
            high = {place: mark for place, mark in high.items() if place[1] != trial}
    rules = ((low, "hidden reference below"), (high, "mid anchor above"))
    found = []
    for listener in _unique(a.listener for a in answers):
        for marks_of, text in rules:
            marks = [mark for (who, _), mark in marks_of.items() if who == listener]
            if marks and sum(marks) > LIMIT_SHARE * len(marks):
                found.append(Screened(listener, f"{text} {LIMIT_SCORE:g} in {sum(marks)} of {len(marks)} trials"))
                break
    return tuple(found)


def _mean(label: str, trial: str | None, answers: list[Answer], confidence: float) -> RatingMean:
    from scipy.stats import t as student

    scores = np.array([a.score for a in answers])
    listeners = _unique(a.listener for a in answers)
    means = np.array([np.mean([a.score for a in answers if a.listener == who]) for who in listeners])
    n, mean = len(means), float(means.mean())
    low = high = None
    if n > 1:
        half = float(student.ppf((1 + confidence) / 2, n - 1)) * float(means.std(ddof=1)) / math.sqrt(n)
        low, high = mean - half, mean + half
    lower, median, upper = (float(q) for q in np.percentile(scores, [25, 50, 75]))
    return RatingMean(label, trial, n, len(scores), mean, low, high, median, lower, upper)


def _rate(label: str, trial: str | None, answers: list[Answer], confidence: float) -> Rate:
    from scipy.stats import binomtest

    correct, incorrect, undecided, unknown = (
        sum(a.choice == choice for a in answers) for choice in ("correct", "incorrect", "undecided", "unknown")
    )
    listeners = len(_unique(a.listener for a in answers))
    rate = low = high = p_value = None
    if decided := correct + incorrect:
        test = binomtest(correct, decided, 0.5, alternative="greater")
        interval = binomtest(correct, decided).proportion_ci(confidence, method="exact")
        rate, low, high = correct / decided, float(interval.low), float(interval.high)
        p_value = float(test.pvalue)
    return Rate(label, trial, listeners, correct, incorrect, undecided, unknown, rate, low, high, p_value)


def _incomplete(answers: Sequence[Answer]) -> tuple[str, ...]:
    """Listeners without an answer to a trial that another listener has answered."""
    asked = {(a.trial, a.label) for a in answers}
    given: dict[str, int] = {}
    for a in answers:
        given[a.listener] = given.get(a.listener, 0) + 1
    return tuple(f"{who} gave {n} of {len(asked)} answers" for who, n in given.items() if n < len(asked))


def _unique(items: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(items))


def write_plot(results: Results, path: Path) -> None:
    """Plot the overall means or rates with their intervals as PNG."""
    rows: list[RatingMean | Rate] = list(results.overall)
    values = [r.mean if isinstance(r, RatingMean) else (math.nan if r.rate is None else r.rate) for r in rows]
    below = [0.0 if r.low is None else v - r.low for r, v in zip(rows, values, strict=True)]
    above = [0.0 if r.high is None else r.high - v for r, v in zip(rows, values, strict=True)]
    made, grid = figure(heights=[1.6 + 0.6 * len(rows)])
    axes = grid[0, 0]
    axes.errorbar(values, range(len(rows)), xerr=[below, above], fmt="o", capsize=6, color=COLOURS[0], lw=LINE, ms=8)
    axes.set_yticks(range(len(rows)), [plain(r.label) for r in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    if results.kind == "mushra":
        axes.set(xlim=(0, 100), xlabel="score")
    elif results.kind == "bs1116":
        axes.axvline(0.0, color="grey", linewidth=0.8)
        axes.set_xlabel("difference grade")
    else:
        axes.axvline(0.5, color="grey", linewidth=0.8)
        axes.set(xlim=(0, 1), xlabel="share of right answers")
    counted = results.listeners - len(results.screened)
    title(axes, f"{results.name}: {counted} listeners, {100 * results.confidence:g} % intervals")
    with whole_file(path) as stream:
        made.savefig(stream, format="png", metadata={"Software": None})
