"""Pictures of an estimate's report: spectrograms of one note, decay rates of strings, gain over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tonewood.sound.level.spectrum import spectrogram
from tonewood.support.arrays import Floats
from tonewood.support.plotting import (
    COLOURS,
    LINE,
    colour_bar,
    data_uri,
    draw_spectrogram,
    figure,
    frequency_axis,
    legend_above,
    log_axis,
    plain,
    png,
    svg,
    title,
)
from tonewood.workshop.estimate import gain, laws
from tonewood.workshop.estimate.estimate import Estimate
from tonewood.workshop.estimate.recordings import FS
from tonewood.workshop.report.figures import Picture

#: dB and Hz shown of a spectrogram; strings that are drawn
_RANGE, _TOP, _MOST = 80.0, 10000.0, 12


def spectrograms(name: str, sounds: Mapping[str, Floats]) -> Picture:
    """Spectrograms of one note, a row each, re the loudest of all."""
    rows = {label: spectrogram(x[:, None], FS, columns=400, freq_upper=_TOP) for label, x in sounds.items()}
    top = max(float(level.max()) for _, _, level in rows.values())
    chart, axes = figure(len(rows), heights=[2.4] * len(rows), sharex=True)
    shown: Any = None
    for ax, (label, (time, freq, level)) in zip(axes[:, 0], rows.items(), strict=True):
        shown = draw_spectrogram(ax, time, freq, level - top, floor_db=-_RANGE)
        title(ax, label)
    axes[-1, 0].set(xlabel="time, s")
    colour_bar(chart, shown, axes[:, 0], "level, dB")
    return Picture(data_uri(png(chart, 72), "image/png"), f"Spectrograms of {name}: {', '.join(sounds)}")


def rates_picture(estimate: Estimate, strings: Sequence[str]) -> Picture | None:
    """Decay rates of partials, recorded and computed, and the law of each string; None where no notes tell one."""
    drawn = [name for name in strings if name in estimate.intervals][:_MOST]
    if not drawn:
        return None
    rows = -(-len(drawn) // 2)
    columns = min(len(drawn), 2)
    chart, axes = figure(rows, columns, heights=[3.0] * rows, sharex=True, sharey=True)
    for ax in axes.ravel()[len(drawn) :]:
        ax.set_axis_off()
    freq = np.geomspace(150.0, 9000.0, 60)
    for k, (ax, name) in enumerate(zip(axes.ravel(), drawn, strict=False)):
        at = [i for i, played in enumerate(estimate.notes) if played.string == name]
        kinds = (("recorded", estimate.recorded, "o"), ("computed", estimate.rendered.main, "x"))
        for c, (label, analyses, sign) in enumerate(kinds):
            rates = laws.rates_of([analyses[i] for i in at])
            ax.plot(rates.freq, rates.rate, sign, color=COLOURS[c], ms=4, label=label)
        ax.plot(freq, estimate.figures.laws[name].rate(freq), color=COLOURS[2], lw=LINE, label="string alone")
        low, high = estimate.intervals[name].rates
        ax.vlines(laws.STATED, low, high, color=COLOURS[2], lw=2 * LINE, label="90 %")
        frequency_axis(ax, 150.0, 9000.0)
        log_axis(ax)
        title(ax, plain(name))
        if k % columns == 0:
            ax.set_ylabel("decay rate, 1/s")
        if k >= len(drawn) - columns:
            ax.set_xlabel("frequency, Hz")
    legend_above(chart, axes[0, 0])
    return Picture(data_uri(svg(chart), "image/svg+xml"), "Decay rates of partials over frequency, by string")


def gain_picture(estimate: Estimate) -> Picture:
    """Gain of the first output, with its interval."""
    name, curve = next(iter(estimate.figures.gains.items()))
    chart, axes = figure(heights=[3.6])
    ax = axes[0, 0]
    half = (estimate.gain_interval[1] - estimate.gain_interval[0]) / 2
    ax.fill_between(gain.KNOTS, curve - half, curve + half, color=COLOURS[0], alpha=0.25, lw=0, label="90 %")
    ax.plot(gain.KNOTS, curve, "o-", color=COLOURS[0], lw=LINE, ms=5, label=plain(name))
    frequency_axis(ax, float(gain.KNOTS[0]), float(gain.KNOTS[-1]))
    ax.set(xlabel="frequency, Hz", ylabel="gain, dB")
    legend_above(chart, ax)
    alt = f"Gain of {name} over frequency, re the instrument begun with"
    return Picture(data_uri(svg(chart), "image/svg+xml"), alt)
