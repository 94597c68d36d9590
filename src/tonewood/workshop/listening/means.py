"""Means with confidence intervals per factor and per cell, and post-screening of listeners.

Answers of one listener are not independent: a mean over several trials is taken of the listeners' means, and its
interval is Student's

    mean ± t(1 - a/2, n - 1) s / sqrt(n)          n listeners, s the standard deviation of their means.

Post-screening is that of ITU-R BS.1534-3, 4.1.2: a listener is left out who rates the hidden reference below 90, or the
mid anchor (7 kHz) above 90, in more than 15 % of the trials; a trial whose mid anchor more than a quarter of all
listeners rate above 90 does not count for the second rule.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LIMIT_SCORE = 90.0
LIMIT_SHARE = 0.15
EASY_ITEM_SHARE = 0.25
Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class CellMean:
    """Mean of the answers in one cell.

    mean, low, high : of the listeners' means, with the bounds of the interval (None with one listener).
    median, lower_quartile, upper_quartile : of all answers.
    """

    cell: dict[str, str]
    listeners: int
    answers: int
    mean: float
    low: float | None
    high: float | None
    median: float
    lower_quartile: float
    upper_quartile: float

    @property
    def label(self) -> str:
        """Levels in words."""
        return ", ".join(f"{k}={v}" for k, v in self.cell.items())


@dataclass(frozen=True)
class ScreenedListener:
    """A listener who is left out, and by which rule."""

    listener: str
    reason: str


def unique(items: Sequence[Any]) -> list[Any]:
    """Items in the order of their first occurrence."""
    return list(dict.fromkeys(items))


def listener_means(rows: Rows) -> dict[str, float]:
    """Mean value of each listener's answers."""
    values: dict[str, list[float]] = {}
    for row in rows:
        values.setdefault(row["listener"], []).append(row["value"])
    return {who: float(np.mean(of)) for who, of in values.items()}


def student_interval(values: Sequence[float], confidence: float) -> tuple[float, float | None, float | None]:
    """Mean of independent values, with Student's interval (None with one value)."""
    from scipy.stats import t as student

    x = np.asarray(values, dtype=np.float64)
    n, mean = len(x), float(x.mean())
    if n < 2:
        return mean, None, None
    half = float(student.ppf((1 + confidence) / 2, n - 1)) * float(x.std(ddof=1)) / math.sqrt(n)
    return mean, mean - half, mean + half


def cell_means(rows: Rows, by: Sequence[str], confidence: float) -> list[CellMean]:
    """Means of the cells of some columns, in the order in which they occur."""
    cells: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["value"] is not None:
            cells.setdefault(tuple(str(row[name]) for name in by), []).append(row)
    means_of_cells = []
    for levels, inside in cells.items():
        means = list(listener_means(inside).values())
        mean, low, high = student_interval(means, confidence)
        lower, median, upper = (float(q) for q in np.percentile([row["value"] for row in inside], [25, 50, 75]))
        cell = dict(zip(by, levels, strict=True))
        means_of_cells.append(CellMean(cell, len(means), len(inside), mean, low, high, median, lower, upper))
    return means_of_cells


def screen(rows: Rows) -> tuple[ScreenedListener, ...]:
    """Listeners to be left out by BS.1534-3; see the module."""
    low = {_place(row): row["value"] < LIMIT_SCORE for row in rows if row["role"] == "reference"}
    high = {_place(row): row["value"] > LIMIT_SCORE for row in rows if row["role"] == "anchor70"}
    for trial in unique([cell[1:] for cell in high]):
        marks = [mark for cell, mark in high.items() if cell[1:] == trial]
        if sum(marks) > EASY_ITEM_SHARE * len(marks):
            high = {cell: mark for cell, mark in high.items() if cell[1:] != trial}
    rules = ((_by_listener(low), "hidden reference below"), (_by_listener(high), "mid anchor above"))
    verdicts = []
    for listener in unique([row["listener"] for row in rows]):
        for marks_of, text in rules:
            marks = marks_of.get(listener, [])
            if marks and sum(marks) > LIMIT_SHARE * len(marks):
                reason = f"{text} {LIMIT_SCORE:g} in {sum(marks)} of {len(marks)} trials"
                verdicts.append(ScreenedListener(listener, reason))
                break
    return tuple(verdicts)


def _by_listener(marks: Mapping[tuple[str, str, int], bool]) -> dict[str, list[bool]]:
    by_listener: dict[str, list[bool]] = {}
    for (who, *_), mark in marks.items():
        by_listener.setdefault(who, []).append(mark)
    return by_listener


def _place(row: Mapping[str, Any]) -> tuple[str, str, int]:
    return row["listener"], row["trial"], row["repetition"]
