"""The first screen of the page: the least time for an error on each system, by us and by the best other method."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tonewood.lab.accuracy.outcome import (
    DIAL,
    OURS,
    PITCH,
    WAVEFORM,
    Measure,
    Outcome,
    Point,
    front,
    line,
    seconds_at,
    usual,
)
from tonewood.lab.methods import METHODS
from tonewood.lab.tables import markdown, number
from tonewood.support.plotting import COLOURS, LINE, figure, legend_above, png, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: first words of the page
READERS = """\
For readers who choose a sampling rate or a method. After this page you know the time of computing for a given error."""
#: errors that are asked for: cents, relative
TARGETS = {PITCH.name: (10.0, 1.0, 0.1, 0.01), WAVEFORM.name: (0.1, 0.01, 1e-3, 1e-4)}
#: other damping cases of the same harp
VARIANTS = ("harp_proportional", "harp_block")
#: methods that are no peers: ours in another loop, the floor, and one that is Adams-Bashforth's with more modes
NO_PEERS = (OURS, "held_position", "superposition", "ab3_paper")
#: rows of the chart: system and measure
CHART = (("fabre_guitar", PITCH), ("classical_guitar", WAVEFORM), ("tension", WAVEFORM))
#: methods drawn there, and marks of all but the first
DRAWN = (OURS, "ab3", "verlet", "newmark", "p1", "p2", "superposition")
MARKS = ("s", "^", "v", "D", "P", "*", "X")


def cheapest(outcome: Outcome, measure: Measure, error: float) -> Point | None:
    """Our cheapest measured point, of any dial, with an error no larger."""
    accurate = [
        p
        for p in outcome.points
        if p.method == OURS and p.stable == "stable" and np.isfinite(p.seconds) and measure.of(p) <= error
    ]
    return min(accurate, key=lambda p: p.seconds, default=None)


def best_peer(outcome: Outcome, measure: Measure, error: float) -> tuple[str, float] | None:
    """The other method that reaches an error in least time, and that time; None: none reaches it."""
    methods = {p.method for p in outcome.points if p.dial == DIAL} - set(NO_PEERS)
    times = {m: seconds_at(line(outcome.points, m, measure), error) for m in sorted(methods)}
    reached = {m: t for m, t in times.items() if t is not None}
    return min(reached.items(), key=lambda item: item[1], default=None)


def floor(outcome: Outcome) -> float | None:
    """Seconds that superposition takes; None where there is no such thing."""
    return next((p.seconds for p in outcome.points if p.method == "superposition"), None)


def verlet_is_quicker_above(outcome: Outcome) -> float | None:
    """Return the error of the waveform above which velocity Verlet takes less time than we do; None: nowhere."""
    ours, theirs = (line(outcome.points, m, WAVEFORM) for m in (OURS, "verlet"))
    if not ours or not theirs:
        return None
    low, high = (max(front(points)[i][1] for points in (ours, theirs)) for i in (-1, 0))
    errors = np.geomspace(low, high, 200)[::-1]
    quicker = [(seconds_at(theirs, e) or np.inf) < (seconds_at(ours, e) or np.inf) for e in errors]
    return float(errors[quicker.index(False) - 1]) if quicker[0] and False in quicker else None


def table(outcomes: Sequence[Outcome], measure: Measure) -> str:
    """A row per system, a column per error: setting, seconds per second, best other method as a ratio to that."""
    rows = []
    for o in outcomes:
        if o.name in VARIANTS or not any(np.isfinite(measure.of(p)) for p in o.points if p.method == OURS):
            continue
        cells = [_cell(o, measure, error) for error in TARGETS[measure.name]]
        at_usual, least = usual(o.points, measure), floor(o)
        ratio = "" if least is None or at_usual is None else f"{number(least)} s"
        rows.append([f"`{o.name}`", *cells, ratio])
    words = [f"{e:g} cent" if measure is PITCH else f"{100 * e:g} %" for e in TARGETS[measure.name]]
    return markdown(["system", *words, "superposition"], rows)


def _cell(outcome: Outcome, measure: Measure, error: float) -> str:
    ours, peer = cheapest(outcome, measure, error), best_peer(outcome, measure, error)
    if ours is None:
        return "not measured" if peer is None else f"not measured; {METHODS[peer[0]].short} {number(peer[1])} s"
    shown = "none" if peer is None else f"{METHODS[peer[0]].short} {number(peer[1] / ours.seconds)} x"
    return f"{ours.value.removeprefix('strings solved ')}: {number(ours.seconds)} s; {shown}"


def sentences(outcomes: Sequence[Outcome]) -> str:
    """Return three sentences: the cost of one cent, that by other methods, and where others are the better choice."""
    linear = [o for o in outcomes if o.name not in VARIANTS and (floor(o) is not None or o.name == "classical_guitar")]
    ours = [(o, p) for o in linear if (p := cheapest(o, PITCH, 1.0)) is not None]
    out = []
    if ours:
        times = [p.seconds for _, p in ours]
        peers = [t[1] / p.seconds for o, p in ours if (t := best_peer(o, PITCH, 1.0)) is not None]
        out.append(
            f"One cent, in the worst of a string's partials 1 to 40, costs {number(min(times))} to "
            f"{number(max(times))} s of computing per second of sound on the linear systems here"
            + (
                f"; the best other method takes {number(min(peers))} to {number(max(peers))} times as long."
                * bool(peers)
            )
        )
        floors = [f / p.seconds for o, p in ours if (f := floor(o)) is not None]
        if floors:
            out.append(
                "Where nothing ever changes, superposition of the coupled modes is exact and takes "
                f"{number(min(floors))} to {number(max(floors))} times that."
            )
    rising = next((o for o in outcomes if o.name == "tension"), None)
    above = None if rising is None else verlet_is_quicker_above(rising)
    if above is not None:
        out.append(f"With rising tension velocity Verlet is the quicker one for errors above {number(100 * above)} %.")
    return " ".join(out)


def section(outcomes: Sequence[Outcome]) -> str:
    """Sentences and tables."""
    parts = [textwrap.fill(f"{READERS} {sentences(outcomes)}", 120)]
    for measure in (PITCH, WAVEFORM):
        text = table(outcomes, measure)
        if text.count("\n") > 1:
            parts += [f"By the {measure.title}:", text]
    return "\n\n".join(part for part in parts if part)


def chart_png(outcomes: Sequence[Outcome], *, dpi: int = 110) -> bytes:
    """One system and one quantity a row, a labelled line per method.

    Raises TonewoodError : matplotlib is not installed.
    """
    by_name = {o.name: o for o in outcomes}
    rows = [(by_name[name], measure) for name, measure in CHART if name in by_name]
    rows = rows or [(o, o.measures[0]) for o in outcomes]
    chart, axes = figure(len(rows), heights=[4.6] * len(rows))
    for ax, (outcome, measure) in zip(axes[:, 0], rows, strict=True):
        _row(ax, outcome, measure)
    legend_above(chart, axes[0, 0])
    return png(chart, dpi)


def _row(ax: Axes, outcome: Outcome, measure: Measure) -> None:
    others = iter(zip(COLOURS, MARKS, strict=True))
    for method in DRAWN:
        ours = method == OURS
        colour, mark = (COLOURS[-1], "o") if ours else next(others)
        points = [(s, e) for s, e in line(outcome.points, method, measure) if e > 0]
        seconds, errors = zip(*points, strict=True) if points else ((), ())
        ax.plot(
            seconds, errors, mark, ls="-", color=colour, lw=3.5 if ours else LINE, ms=9, label=METHODS[method].short
        )
    ax.set(xscale="log", yscale="log")
    title(ax, outcome.title)
    ax.set_xlabel("s of computing per s of sound")
    ax.set_ylabel("pitch, cents" if measure is PITCH else "waveform, relative")
    ax.grid(which="major", alpha=0.3)
