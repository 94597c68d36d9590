"""Pareto charts: error against time, a line per method, the dial's value at every point."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.lab.accuracy.catalogue import Outcome
from tonewood.lab.accuracy.pareto import DIAL, OURS, Measure
from tonewood.lab.accuracy.study import LABELS, Point

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: methods in the order of their colours
ORDER = tuple(LABELS)
#: errors below this are drawn on it
FLOOR = 1e-9


def pareto_png(outcomes: Sequence[Outcome], *, dpi: int = 90) -> bytes:
    """One chart per system.

    Raises
    ------
    TonewoodError : matplotlib is not installed.
    """
    try:
        import matplotlib as mpl
    except ImportError:
        raise TonewoodError('pictures need matplotlib: pip install "tonewood[plot]"', key="--plot") from None
    mpl.use("Agg")
    from matplotlib.figure import Figure

    columns = 1 if len(outcomes) == 1 else 2
    rows = -(-len(outcomes) // columns)
    figure = Figure(figsize=(8.0 * columns, 6.0 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for outcome, ax in zip(outcomes, axes, strict=False):
        chart(ax, outcome, outcome.measures[0])
    for ax in axes[len(outcomes) :]:
        ax.set_axis_off()
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def chart(ax: Axes, outcome: Outcome, measure: Measure) -> None:
    """One system by one measure."""
    import matplotlib as mpl

    palette = mpl.colormaps["tab20"].colors  # type: ignore[attr-defined]  # a listed map has them
    for method in ORDER:
        own = [p for p in outcome.points if p.method == method and p.dial == DIAL and _drawn(p, measure)]
        if not own:
            continue
        own.sort(key=lambda p: p.fs)
        ours = method == OURS
        color = "black" if ours else palette[ORDER.index(method) % len(palette)]
        ax.plot(
            [p.seconds for p in own],
            [max(measure.of(p), FLOOR) for p in own],
            "o-",
            color=color,
            lw=2.2 if ours else 1.2,
            ms=6 if ours else 4,
            label=LABELS[method],
            zorder=3 if ours else 2,
        )
        for p in own:
            _name(ax, p, p.value.removesuffix(" kHz"), measure)
    dials = [p for p in outcome.points if p.method == OURS and p.dial != DIAL and _drawn(p, measure)]
    for p in dials:
        ax.plot(p.seconds, max(measure.of(p), FLOOR), "x", color="black", ms=5)
        _name(ax, p, p.value, measure)
    ax.set(xscale="log", yscale="log", xlabel="s of computing per s of sound", ylabel=measure.title)
    ax.set_title(outcome.title, fontsize=10)
    ax.grid(which="both", alpha=0.2)
    ax.legend(fontsize=6.5, title="by sampling rate, kHz; crosses: other dials", title_fontsize=6.5)


def _drawn(p: Point, measure: Measure) -> bool:
    return p.stable == "stable" and bool(np.isfinite(p.seconds) and np.isfinite(measure.of(p)))


def _name(ax: Axes, p: Point, text: str, measure: Measure) -> None:
    ax.annotate(
        text, (p.seconds, max(measure.of(p), FLOOR)), xytext=(3, 3), textcoords="offset points", fontsize=5.5
    )  # fmt: skip
