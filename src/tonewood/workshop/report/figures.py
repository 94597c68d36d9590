"""Figures of a report, in the style of `tonewood.support.plotting`: colours and dashes tell instruments apart."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.scales import note_name
from tonewood.physics.plate.figures import COLUMNS, draw_shapes
from tonewood.sound.level.spectrum import spectrogram
from tonewood.support.plotting import (
    COLOURS,
    DASHES,
    LINE,
    TEXT,
    colour_bar,
    data_uri,
    draw_mobility,
    draw_spectrogram,
    figure,
    frequency_axis,
    legend,
    legend_above,
    log_axis,
    plain,
    png,
    svg,
    title,
)
from tonewood.workshop.report.comparison import Comparison, WolfMatch
from tonewood.workshop.report.summary import key_figures
from tonewood.workshop.report.tones import matched_gains_db

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: panels, bars of wolf notes and strings' ends that a figure shows at most
MOST_PANELS, MOST_WOLVES, MOST_ENDS = 12, 10, 6
#: rows of mode shapes of one body
_SHAPE_ROWS = 3
#: dB shown of a spectrogram and of a decay; Hz, highest frequency of a spectrogram
RANGE_DB, TOP_FREQ = 80.0, 6000.0
#: window of a spectrogram, samples at 48 kHz, and of notes below `_LOW_FREQ` Hz
_WINDOW, _LONG_WINDOW, _LOW_FREQ = 4096, 8192, 70.0


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as an address that holds it, with its text for those who do not see it."""

    uri: str
    alt: str


def _names(comparison: Comparison) -> list[str]:
    return [facts.short for facts in comparison.instruments]


def mobility_picture(comparison: Comparison) -> Picture | None:
    """Mobility of the body at strings' ends; None where no body moves.

    Of one instrument, all ends in one row; of several, a row for the end of the first string and one for the last.
    """
    first = comparison.instruments[0]
    ends = [name for name in first.mobility if all(name in facts.mobility for facts in comparison.instruments)]
    if not ends:
        return None
    if len(comparison.instruments) == 1:
        shown = ends if len(ends) <= MOST_ENDS else [ends[int(i)] for i in np.linspace(0, len(ends) - 1, MOST_ENDS)]
        drawing, axes = figure(heights=[5.5])
        draw_mobility(axes[0, 0], first.freq, {f"{name}": first.mobility[name] for name in shown})
        legend(axes[0, 0], title="at the end of", ncols=3)
        return Picture(_svg(drawing), f"Mobility of the body of {first.name} at the ends of its strings")
    shown = list(dict.fromkeys((ends[0], ends[-1])))
    drawing, axes = figure(len(shown) + 1, heights=[3.7] * len(shown) + [3.0], sharex=True)
    for ax, name in zip(axes[:, 0], shown, strict=False):
        for i, facts in enumerate(comparison.instruments):
            level = 20 * np.log10(np.maximum(np.abs(facts.mobility[name]), 1e-12))
            ax.plot(facts.freq, level, color=COLOURS[i], ls=DASHES[i % 4], lw=LINE, label=plain(_names(comparison)[i]))
        frequency_axis(ax, float(first.freq[0]), float(first.freq[-1]))
        ax.set(ylabel="mobility\ndB re 1 (m/s)/N", xlabel="")
        title(ax, f"at the end of {name}")
    freq, levels = band_levels(comparison, ends)
    for i, level in enumerate(levels[1:], 1):
        axes[-1, 0].plot(freq, level - levels[0], color=COLOURS[i], ls=DASHES[i % 4], lw=LINE)
    axes[-1, 0].axhline(0.0, color=COLOURS[0], lw=1.0)
    frequency_axis(axes[-1, 0], float(first.freq[0]), float(first.freq[-1]))
    axes[-1, 0].set(ylabel=f"less {first.label}, dB", xlabel="frequency, Hz")
    title(axes[-1, 0], "difference, mean of all ends, third octaves")
    legend_above(drawing, axes[0, 0])
    ends_shown = " and ".join(shown)
    return Picture(_svg(drawing), f"Mobility of the bodies at the ends of {ends_shown}, overlaid, and their difference")


def band_levels(comparison: Comparison, ends: Sequence[str]) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """(f,) Hz, and of each instrument (f,) dB: mean of 20 lg |Y| over the ends and a third of an octave."""
    low = max(float(facts.freq[0]) for facts in comparison.instruments) * 2 ** (1 / 6)
    high = min(float(facts.freq[-1]) for facts in comparison.instruments) / 2 ** (1 / 6)
    freq = np.geomspace(low, high, 120)
    levels = []
    for facts in comparison.instruments:
        x = np.log2(facts.freq)
        level = np.mean([20 * np.log10(np.maximum(np.abs(facts.mobility[n]), 1e-12)) for n in ends], axis=0)
        total = np.concatenate([[0.0], np.cumsum(np.diff(x) * (level[1:] + level[:-1]) / 2)])
        edges = [np.interp(np.log2(freq) + by, x, total) for by in (-1 / 6, 1 / 6)]
        levels.append(3 * (edges[1] - edges[0]))
    return freq, levels


def shapes_picture(comparison: Comparison) -> Picture | None:
    """First modes of the bodies whose whole surface is known, with nodal lines, a row or more each."""
    bodies = [f for f in comparison.instruments if f.surface is not None and len(f.surface.areas)]
    if not bodies:
        return None
    rows = _SHAPE_ROWS if len(bodies) == 1 else 1
    drawing, axes = figure(rows * len(bodies), COLUMNS, heights=[3.6] * rows * len(bodies))
    for k, facts in enumerate(bodies):
        assert facts.surface is not None
        basis = facts.surface_modes
        moves = basis.natural_freq > 0
        moves &= np.cumsum(moves) <= rows * COLUMNS
        mine = axes[k * rows : (k + 1) * rows].ravel()
        draw_shapes(mine, facts.surface.of(moves), basis.natural_freq[moves], 0.5 / basis.damping_ratio[moves])
        if len(comparison.instruments) > 1:
            mine[0].set_title(plain(f"{facts.label}: {mine[0].get_title()}"))
    names = ", ".join(facts.label for facts in bodies) if len(comparison.instruments) > 1 else bodies[0].name
    return Picture(data_uri(png(drawing, 72), "image/png"), f"First modes of the bodies of {names}")


def sweep_picture(comparison: Comparison) -> Picture:
    """Key figures over the value that is swept, a panel each."""
    rows = [(value, key_figures(facts)) for value, facts in comparison.swept()]
    names = [n for n in dict.fromkeys(n for _, f in rows for n in f) if all(n in f for _, f in rows)]
    drawing, axes = figure(-(-len(names) // 2), 2, heights=[2.6] * -(-len(names) // 2), sharex=True)
    for ax in axes.ravel()[len(names) :]:
        ax.set_axis_off()
    for k, (ax, name) in enumerate(zip(axes.ravel(), names, strict=False)):
        ax.plot([v for v, _ in rows], [f[name][0] for _, f in rows], "o-", color=COLOURS[0], lw=LINE, ms=7)
        ax.set_title(plain(name.partition(",")[0]), fontsize=TEXT)
        ax.set(ylabel=rows[0][1][name][1], xlabel=comparison.sweep.rpartition(".")[2] if k >= len(names) - 2 else "")
    return Picture(_svg(drawing), f"Figures of the instrument over {comparison.sweep}")


def notes_picture(comparison: Comparison, quantity: str) -> Picture:
    """T60 or cents of every stop, a panel per string.

    quantity : ``t60`` or ``cents_mounted``.
    """
    label = {"t60": "T60, s", "cents_mounted": "cents"}[quantity]
    strings = list(dict.fromkeys(match.string for match in comparison.notes))
    stopped = any(match.stop for match in comparison.notes)
    panels = strings[:MOST_PANELS] if stopped else [""]
    columns = 2 if len(panels) > 1 else 1
    rows = -(-len(panels) // columns)
    lines = [DASHES[i % 4] if stopped else "" for i in range(len(comparison.instruments))]  # strings are no sequence
    drawing, axes = figure(rows, columns, heights=[2.6 if rows > 1 else 4.0] * rows, sharex=stopped, sharey=True)
    for ax in axes.ravel()[len(panels) :]:
        ax.set_axis_off()
    for p, (ax, string) in enumerate(zip(axes.ravel(), panels, strict=False)):
        mine = [match for match in comparison.notes if not string or match.string == string]
        x = np.array([match.stop for match in mine]) if stopped else np.arange(len(mine))
        for i in range(len(comparison.instruments)):
            values = [np.nan if (n := m.notes[i]) is None else getattr(n, quantity) for m in mine]
            values = [v if np.isfinite(v) else np.nan for v in values]
            ax.plot(x, values, "o", ls=lines[i], color=COLOURS[i], ms=6, lw=LINE, label=plain(_names(comparison)[i]))
        if quantity == "t60":
            log_axis(ax)
        if stopped:
            title(ax, string)
            ax.xaxis.get_major_locator().set_params(integer=True)
        elif len(mine) <= 24:
            ax.set_xticks(x, [plain(match.string) for match in mine])
        if p % columns == 0:
            ax.set_ylabel(label)
        if stopped and p >= len(panels) - columns:
            ax.set_xlabel("stop")
    if len(comparison.instruments) > 1:
        legend_above(drawing, axes[0, 0])
    return Picture(_svg(drawing), f"{label} of every note, by string")


def wolf_picture(comparison: Comparison) -> Picture | None:
    """Severity of the worst wolf notes as bars; None where there is none."""
    worst = comparison.wolves[:MOST_WOLVES]
    if not worst:
        return None
    count = len(comparison.instruments)
    drawing, axes = figure(heights=[1.6 + 0.3 * len(worst) * count + 0.15 * len(worst)])
    ax = axes[0, 0]
    for i in range(count):
        places = [k + (i - (count - 1) / 2) * 0.8 / count for k in range(len(worst))]
        sizes = [0.0 if (w := match.wolves[i]) is None else w.severity_cents for match in worst]
        ax.barh(places, sizes, height=0.72 / count, color=COLOURS[i], label=plain(_names(comparison)[i]))
    ax.set_yticks(range(len(worst)), [plain(wolf_name(match)) for match in worst])
    ax.set(xlabel="severity, cents", ylim=(len(worst) - 0.5, -0.5))
    ax.grid(visible=False, axis="y")
    if count > 1:
        legend_above(drawing, ax)
    return Picture(_svg(drawing), "Severity of the worst wolf notes")


def wolf_name(match: WolfMatch) -> str:
    """String and pitch of a wolf note where it is worst."""
    wolf = max((w for w in match.wolves if w is not None), key=lambda w: w.severity_cents)
    return f"{wolf.string} near {note_name(round(69 + 12 * np.log2(wolf.worst_freq / 440.0)))}"


def decay_picture(comparison: Comparison, note: str) -> Picture:
    """Level over time of a note on every instrument that plays it, dB re the first one's loudest 20 ms.

    One whose output is of another unit is drawn re its own.
    """
    played = [(i, facts.tones[note]) for i, facts in enumerate(comparison.instruments) if note in facts.tones]
    first = played[0][1]
    shifts = [tone.shift_db(first) for _, tone in played]
    tops = [
        float(tone.level_db.max() if shift is None else first.level_db.max() - shift)
        for (_, tone), shift in zip(played, shifts, strict=True)
    ]
    drawing, axes = figure(heights=[4.0])
    ax = axes[0, 0]
    for (i, tone), top in zip(played, tops, strict=True):
        ax.plot(
            tone.time,
            tone.level_db - top,
            color=COLOURS[i],
            ls=DASHES[i % 4],
            lw=LINE,
            label=plain(_names(comparison)[i]),
        )
    highest = max(float(tone.level_db.max()) - top for (_, tone), top in zip(played, tops, strict=True))
    of = f" of {comparison.instruments[played[0][0]].label}" if len(comparison.instruments) > 1 else ""
    of = " of each" if None in shifts else of
    ax.set(xlabel="time, s", ylabel=f"level\ndB re maximum{of}")
    ax.set(xlim=(0.0, comparison.duration), ylim=(-RANGE_DB, highest + 5.0))
    if len(comparison.instruments) > 1:
        legend_above(drawing, ax)
    return Picture(_svg(drawing), f"Level of {note} over time")


def spectrogram_picture(comparison: Comparison, note: str) -> Picture:
    """Spectrogram of a note on every instrument that plays it, a row each, at one loudness."""
    played = [(i, facts.tones[note]) for i, facts in enumerate(comparison.instruments) if note in facts.tones]
    gains = matched_gains_db([tone for _, tone in played])
    rows = []
    for (_, tone), gain in zip(played, gains, strict=True):
        window = _LONG_WINDOW if tone.freq < _LOW_FREQ else _WINDOW
        time, freq, level = spectrogram(
            tone.samples, tone.fs, window=round(window * tone.fs / 48000), columns=500, freq_upper=TOP_FREQ
        )
        rows.append((time, freq, level + gain))
    top = max(float(level.max()) for _, _, level in rows)
    drawing, axes = figure(len(rows), heights=[3.0] * len(rows), sharex=True)
    shown: Any = None
    for ax, (i, _), (time, freq, level) in zip(axes[:, 0], played, rows, strict=True):
        shown = draw_spectrogram(ax, time, freq, level - top, floor_db=-RANGE_DB)
        if len(comparison.instruments) > 1:
            ax.set_ylabel(f"{comparison.instruments[i].label}: frequency, kHz")
    axes[-1, 0].set(xlabel="time, s", xlim=(0.0, comparison.duration))
    colour_bar(drawing, shown, axes[:, 0], "level, dB")
    stream = io.BytesIO()
    drawing.savefig(stream, format="png", dpi=96, metadata={"Software": None})
    return Picture(data_uri(stream.getvalue(), "image/png"), f"Spectrogram of {note}")


def _svg(drawing: Figure) -> str:
    return data_uri(svg(drawing), "image/svg+xml")
