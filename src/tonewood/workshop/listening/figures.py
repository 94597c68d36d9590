"""Figures of results: means with intervals, interactions, shares, tracks and psychometric functions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tonewood.support.plotting import COLOURS, DASHES, LINE, figure, legend, plain, title
from tonewood.workshop.batch.pages import StaircasePage
from tonewood.workshop.listening.detection import CHANCE, chance_of, task_of
from tonewood.workshop.listening.means import CellMean, cell_means, unique
from tonewood.workshop.listening.psychometric import psychometric
from tonewood.workshop.listening.results import PageResults, PanelResults

#: tracks drawn in one figure
_TRACKS = 6


def figures_of(panel: PanelResults, page: PageResults) -> dict[str, Any]:
    """Figures of one page: name -> figure."""
    who = f"{page.listeners} {'simulated ' if panel.simulated == panel.listeners else ''}listeners"
    heading = f"{who}, {100 * panel.confidence:g} % intervals"
    figures: dict[str, Any] = {}
    if page.thresholds is not None:
        figures["tracks"] = _tracks(panel, page, who)
        figures["psychometric"] = _psychometric(panel, page, who)
    elif page.detections:
        rows = [(_cell(d.cell), d.share, d.low, d.high) for d in page.detections]
        chance = CHANCE[task_of(panel.test.pages[page.page - 1]) or "abx"]
        figures["shares"] = _points(rows, "share of right answers", heading, (0.0, 1.0), chance)
    elif page.scale:
        rows = [(s.level, s.value, s.low, s.high) for s in page.scale]
        figures["scale"] = _points(rows, "Bradley-Terry value, logits", heading, None, 0.0)
    else:
        limits = (0.0, 100.0) if page.kind == "mushra" else None
        shown = [*page.cells, *(h for h in page.helpers if h.cell["role"] != "reference")]
        rows = [(_cell(m.cell), m.mean, m.low, m.high) for m in shown]
        label = "difference grade" if page.kind == "bs1116" else "rating"
        figures["means"] = _points(rows, label, heading, limits, 0.0 if page.kind == "bs1116" else None)
        if len(page.factors) > 1:
            figures["interaction"] = _interaction(page, label, heading, panel.confidence)
    return figures


def _cell(cell: dict[str, str]) -> str:
    text = ", ".join(v.replace("|", " or ") if len(cell) > 1 else f"{k} = {v}" for k, v in cell.items())
    return text.replace("|", " or ")


def _points(
    rows: list[tuple[str, float | None, float | None, float | None]],
    label: str,
    heading: str,
    limits: tuple[float, float] | None,
    reference: float | None,
) -> Any:
    values = [math.nan if v is None else v for _, v, _, _ in rows]
    below = [0.0 if low is None or v is None else v - low for _, v, low, _ in rows]
    above = [0.0 if high is None or v is None else high - v for _, v, _, high in rows]
    picture, grid = figure(heights=[2.6 + 0.62 * len(rows)])
    axes = grid[0, 0]
    axes.errorbar(values, range(len(rows)), xerr=[below, above], fmt="o", capsize=6, color=COLOURS[0], lw=LINE, ms=8)
    axes.set_yticks(range(len(rows)), [plain(name) for name, *_ in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(label)
    if limits is not None:
        axes.set_xlim(*limits)
    if reference is not None:
        axes.axvline(reference, color="0.5", lw=1.0, ls="--")
    title(axes, heading)
    return picture


def _interaction(page: PageResults, label: str, heading: str, confidence: float) -> Any:
    """Means over the levels of each other factor, a line for each level of the first."""
    first, *others = page.factors
    sounds = [row for row in page.rows if row["role"] in ("sound", "reference")]
    picture, grid = figure(len(others), heights=[4.6] * len(others))
    for axes, other in zip(grid[:, 0], others, strict=True):
        means = cell_means(sounds, (first, other), confidence)
        levels = unique([m.cell[other] for m in means])
        for i, level in enumerate(unique([m.cell[first] for m in means])):
            row_means: list[CellMean] = [m for m in means if m.cell[first] == level]
            x = [levels.index(m.cell[other]) + 0.06 * i for m in row_means]
            below = [0.0 if m.low is None else m.mean - m.low for m in row_means]
            above = [0.0 if m.high is None else m.high - m.mean for m in row_means]
            axes.errorbar(
                x, [m.mean for m in row_means], yerr=[below, above], fmt="o", ls=DASHES[i % 4],
                color=COLOURS[i % len(COLOURS)], lw=LINE, ms=8, capsize=6, label=plain(level),
            )  # fmt: skip
        axes.set_xticks(range(len(levels)), [plain(level) for level in levels])
        axes.set(xlabel=plain(other), ylabel=label)
        legend(axes, title=plain(first))
    title(grid[0, 0], heading)
    return picture


def _tracks(panel: PanelResults, page: PageResults, who: str) -> Any:
    settings = panel.test.pages[page.page - 1]
    assert isinstance(settings, StaircasePage)
    picture, grid = figure(heights=[4.6])
    axes = grid[0, 0]
    names = unique([(row["listener"], row["track"]) for row in page.rows])
    for i, (listener, track) in enumerate(names[:_TRACKS]):
        rows = sorted(
            (r for r in page.rows if (r["listener"], r["track"]) == (listener, track)), key=lambda r: r["index"]
        )
        colour = COLOURS[i % len(COLOURS)]
        levels, right = [row["level"] for row in rows], np.array([bool(row["right"]) for row in rows])
        x = np.arange(1, len(rows) + 1)
        axes.plot(x, levels, "-", color=colour, lw=LINE, label=plain(str(listener)))
        axes.plot(x[~right], np.array(levels)[~right], "x", color=colour, ms=9, mew=2)
    if settings.ratio:
        axes.set_yscale("log")
    axes.set(
        xlabel="trial (x: wrong)", ylabel=plain(f"level {page.thresholds.unit}".strip() if page.thresholds else "")
    )
    legend(axes, ncols=2)
    shown = "" if len(names) <= _TRACKS else f", the first {_TRACKS} tracks"
    title(axes, f"{who}{shown}")
    return picture


def _psychometric(panel: PanelResults, page: PageResults, who: str) -> Any:
    served, thresholds = panel.test.pages[page.page - 1], page.thresholds
    assert isinstance(served, StaircasePage)
    assert thresholds is not None
    chance = chance_of(served)
    picture, grid = figure(heights=[4.6])
    axes = grid[0, 0]
    levels = np.array([row["level"] for row in page.rows], dtype=np.float64)
    right = np.array([bool(row["right"]) for row in page.rows])
    for level in np.unique(levels):
        here = right[levels == level]
        axes.plot(level, here.mean(), "o", color="0.6", ms=4 + 2 * math.sqrt(len(here)), alpha=0.6)
    low, high = float(levels.min()), float(levels.max())
    x = np.geomspace(low, high, 200) if served.ratio else np.linspace(low, high, 200)
    transform = np.log if served.ratio else np.asarray
    for one in thresholds.listeners:
        y = psychometric(transform(x), transform(np.array(one.threshold)), one.slope, chance, thresholds.share)
        axes.plot(x, y, "-", color=COLOURS[0], lw=1.0, alpha=0.5)
    axes.axvline(thresholds.mean, color=COLOURS[1], lw=LINE, label=f"mean threshold {thresholds.mean:.4g}")
    if thresholds.low is not None and thresholds.high is not None:
        axes.axvspan(thresholds.low, thresholds.high, color=COLOURS[1], alpha=0.15)
    axes.axhline(chance, color="0.5", lw=1.0, ls="--")
    if served.ratio:
        axes.set_xscale("log")
    axes.set(ylim=(0, 1.02), xlabel=plain(f"level {thresholds.unit}".strip()), ylabel="share of right answers")
    legend(axes)
    title(axes, f"{who}; one line a listener, dots: all answers")
    return picture
