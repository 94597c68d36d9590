"""Results of `target.search` as text, JSON and charts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING

from tonewood.lab.accuracy.target import NAMES, Frontier, Trial, Worst
from tonewood.lab.tables import number, table
from tonewood.support.plotting import COLOURS, LINE, SMALL, figure, png, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: measure -> heading, factor from its unit to that of the heading
HEADS = {
    "cents": ("pitch, cents", 1.0),
    "decay": ("decay, %", 100.0),
    "level": ("level, dB", 1.0),
    "waveform": ("waveform, dB", 1.0),
}


def summary(frontier: Frontier) -> str:
    """The answer first, then its grounds, then the table."""
    lines = [_answer(frontier), "", *_ground(frontier), "", settings_table(frontier)]
    return "\n".join(lines)


def _answer(frontier: Frontier) -> str:
    best, default = frontier.cheapest, frontier.default
    question = f"{frontier.target.text} on {frontier.instrument} ({', '.join(frontier.notes)})"
    if best is None:
        near = frontier.nearest
        if not frontier.target.met(frontier.reference_error):
            return f"{question}: no setting can be shown to meet it: the error of the reference is larger, see below."
        return f"{question}: no setting tried meets it. The nearest: {near.setting.words} ({_worded(near.errors)})."
    ratio = best.seconds / default.seconds
    meets = "meets it, too" if default.met else "does not meet it"
    return (
        f"{question}: {best.setting.words}\n"
        f"It takes {number(best.seconds, 3)} s of computing per second of sound, {number(ratio, 2)} times as "
        f"long as a render without options, which {meets} ({_worded(default.errors)})."
    )


def _ground(frontier: Frontier) -> list[str]:
    effects = " with all effects" if frontier.default.setting.effects else ""
    out = [
        f"Errors: worst partial of the first twenty within 40 dB of the loudest, worst note, 2 s at {frontier.fs} Hz, "
        f"against {frontier.reference:g} steps per frame{effects}.",
        f"The reference's own error, by Richardson's extrapolation: {_worded(frontier.reference_error)}. "
        "It is added before an error is compared with the target.",
        "Part of the instrument and in no error: the limit of its strings' modes; twice as high, it would change "
        f"{_worded(frontier.modes)}.",
    ]
    if frontier.strokes > 1:
        out.append(
            f"A thousandth more force changes these notes: compared are means over {frontier.strokes} strokes, and the "
            "difference of two halves of the reference's strokes counts as its own error."
        )
    return out


def settings_table(frontier: Frontier) -> str:
    """A row per setting, from cheap to dear: `>` the cheapest that meets the target; `*` errors on the frontier."""

    def effects(t: Trial) -> str:
        budgets = t.setting.budgets
        return t.setting.effects or "" if budgets is None else "{:g} cents, {:g} dB".format(*budgets)

    def error(name: str) -> Callable[[Trial], str]:
        return lambda t: f"{_shown(t.errors, name)}{'*' if frontier.on_front(t, name) else ''}"

    columns: Mapping[str, Callable[[Trial], str]] = {
        "meets": lambda t: ">" if t is frontier.cheapest else "yes" if t.met else "",
        "oversampling": lambda t: f"{t.setting.oversampling:g}",
        "modes to, kHz": lambda t: f"{t.highest / 1e3:.3g}",
        "effects": effects,
        "modes": lambda t: str(t.n_modes),
        **{HEADS[name][0]: error(name) for name in NAMES},
        "s per s": lambda t: number(t.seconds, 3),
        "time ratio": lambda t: number(t.seconds / frontier.default.seconds, 2),
    }
    note = "`>`: the cheapest that meets the target. `*`: no cheaper one has as small an error."
    return f"{table(frontier.trials, columns)}\n\n{note}"


def _shown(errors: Worst, name: str) -> str:
    value = getattr(errors, name)
    if value is None:
        return "–"
    return f"{20 * math.log10(value):.0f}" if name == "waveform" and value > 0 else number(HEADS[name][1] * value)


def _worded(errors: Worst) -> str:
    units = {"cents": " cent", "decay": " % of the decay", "level": " dB", "waveform": " dB of the waveform"}
    return ", ".join(_shown(errors, name) + unit for name, unit in units.items() if getattr(errors, name) is not None)


def to_json(frontier: Frontier) -> dict[str, object]:
    """Everything, with the options of the cheapest setting."""
    best = frontier.cheapest
    return asdict(frontier) | {"apply": None if best is None else best.setting.words}


def chart_png(frontier: Frontier, *, dpi: int = 110) -> bytes:
    """One quantity a row: error against time, the frontier drawn as a line with the numbers of its settings.

    Raises TonewoodError : matplotlib is not installed.
    """
    shown = [name for name in NAMES if any(getattr(t.errors, name) for t in frontier.trials)]
    chart, axes = figure(len(shown), heights=[3.6] * len(shown), sharex=True)
    best = [
        t for t in sorted(frontier.trials, key=lambda t: t.seconds) if any(frontier.on_front(t, name) for name in shown)
    ]
    numbers = {id(t): i for i, t in enumerate(best, 1)}
    for ax, name in zip(axes[:, 0], shown, strict=True):
        _row(ax, frontier, name, numbers)
    for i, t in enumerate(best, 1):
        axes[0, 0].plot([], [], marker=f"${i}$", ls="", color="black", ms=11, label=_label(t))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    chart.legend(handles, labels, loc="outside upper center", ncols=3, fontsize=SMALL)
    from matplotlib.ticker import LogLocator, NullFormatter  # `figure` has refused where there is none

    last = axes[-1, 0]
    last.xaxis.set_major_formatter("{x:g}")
    last.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    last.xaxis.set_minor_formatter(NullFormatter())
    last.set_xlabel("s of computing per s of sound")
    title(axes[0, 0], f"{frontier.instrument}: {', '.join(frontier.notes)}")
    return png(chart, dpi)


def _row(ax: Axes, frontier: Frontier, name: str, numbers: Mapping[int, int]) -> None:
    heading, factor = HEADS[name]
    points = [(t, factor * e) for t in frontier.trials if (e := getattr(t.errors, name))]
    ax.plot([t.seconds for t, _ in points], [e for _, e in points], "o", color="0.6", ms=7)
    front = [(t, e) for t, e in points if frontier.on_front(t, name)]
    ax.plot([t.seconds for t, _ in front], [e for _, e in front], "o-", color=COLOURS[0], lw=LINE, ms=9)
    for i, (t, e) in enumerate(sorted(front, key=lambda point: point[0].seconds)):
        at = (t.seconds, e)
        above = (0, -22 if i % 2 else 9)
        ax.annotate(str(numbers[id(t)]), at, xytext=above, ha="center", textcoords="offset points", fontsize=SMALL)
    best = frontier.cheapest
    if best is not None and (error := getattr(best.errors, name)):
        ax.plot(best.seconds, factor * error, "o", color=COLOURS[1], ms=17, mfc="none", mew=3)
    for value, style, text in (
        (getattr(frontier.target.limits, name), "-", "target"),
        (getattr(frontier.reference_error, name), ":", "the reference's own error"),
    ):
        if value:
            ax.axhline(factor * value, color=COLOURS[1] if style == "-" else "0.3", ls=style, lw=LINE)
            ax.annotate(
                text,
                (0.995, factor * value),
                xycoords=("axes fraction", "data"),
                ha="right",
                va="bottom",
                fontsize=SMALL,
            )
    ax.set(xscale="log", yscale="log")
    ax.set_ylabel("waveform" if name == "waveform" else heading)
    ax.margins(0.12, 0.25)
    ax.grid(which="major", alpha=0.3)


def _label(t: Trial) -> str:
    return f"{t.setting.oversampling:g}x, {t.highest / 1e3:.3g} kHz"
