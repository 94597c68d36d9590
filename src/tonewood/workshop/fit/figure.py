"""One figure of a fit: the measured and the body's response, the error, the uncertainties, and the search."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tonewood.support.plotting import COLOURS, LINE, figure, frequency_axis, legend_above, log_axis, plain, save
from tonewood.workshop.fit.stability import stability

if TYPE_CHECKING:
    from tonewood.workshop.fit.fit import Fit

#: dB between curves that lie above one another
_APART = 40.0


def draw_fit(fit: Fit, path: Path) -> None:
    """Draw a fit into a .png, .pdf or .svg file.

    From the top: mobility measured (grey) and fitted, dB re 1 (m/s)/N; their difference in dB; coherence where it
    was measured; one standard deviation of frequency and of Q of each mode within the band; the stability chart, dots
    for poles that the order before had, too, and a line for each mode that was kept.
    """
    r = fit.responses
    sure = [row for row in fit.rows if row["measured"] and row["sd_cents"] is not None]
    freq, cents, error = (np.array([row[key] for row in sure]) for key in ("freq_Hz", "sd_cents", "sd_Q"))
    heights = [5.0, 2.2, *([1.8] if r.coherence is not None else []), 2.2, 2.2, 4.0]
    picture, grid = figure(len(heights), heights=heights, sharex=True)
    top, off, *middle, spread, quality, chart = axes = list(grid[:, 0])
    top.plot([], [], color="0.65", lw=2 * LINE, label="measured")
    for i, (point, reference) in enumerate(r.pairs):
        shift, colour = -_APART * i, COLOURS[i % len(COLOURS)]
        top.plot(r.freq, 20 * np.log10(np.abs(r.mobility[i])) + shift, color="0.65", lw=2 * LINE)
        label = f"{point} from {reference}" + (f", {shift:g} dB" if shift else "")
        level = 20 * np.log10(np.abs(fit.mobility[i])) + shift
        top.plot(r.freq, level, color=colour, lw=0.75 * LINE, label=plain(label))
        off.plot(r.freq, 20 * np.log10(np.abs(fit.mobility[i] / r.mobility[i])), color=colour, lw=0.5 * LINE)
    limit = max(1.0, float(np.quantile(fit.error_db, 0.99)))
    off.set(ylabel="error\ndB", ylim=(-limit, limit))
    for axis in middle:
        assert r.coherence is not None
        for i, row in enumerate(r.coherence):
            axis.plot(r.freq, row, color=COLOURS[i % len(COLOURS)], lw=0.5 * LINE)
        axis.set(ylabel="coherence", ylim=(0, 1.02))
    spread.plot(freq, cents, "o", color=COLOURS[0], ms=6)
    spread.set_ylabel("s.d. of f\ncents")
    log_axis(spread)
    quality.plot(freq, 100 * error, "o", color=COLOURS[0], ms=6)
    quality.set_ylabel("s.d. of Q\n%")
    log_axis(quality)
    stable = stability(r.freq, r.mobility)
    chart.vlines(freq, 0, stable.order.max(initial=0) + 2, color=COLOURS[0], lw=0.5 * LINE)
    chart.plot(stable.freq[~stable.stable], stable.order[~stable.stable], ".", color="0.75", ms=3)
    chart.plot(stable.freq[stable.stable], stable.order[stable.stable], ".", color="0.1", ms=6)
    chart.set(ylabel="order,\nstability")
    for axis in axes:
        frequency_axis(axis, float(r.freq[0]), float(r.freq[-1]))
        axis.set_xlabel("frequency, Hz" if axis is chart else "")
    top.set_ylabel("mobility\ndB re 1 (m/s)/N")
    legend_above(picture, top)
    save(picture, path)
