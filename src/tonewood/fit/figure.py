"""One picture of a fit: what was measured and what the body does, the error, what is uncertain, and the search."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tonewood.whole_files import whole_file

if TYPE_CHECKING:
    from tonewood.fit.fit import Fit

#: colour-blind safe (Okabe and Ito 2008)
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
#: dB between curves that lie above one another
_APART = 40.0


def draw_fit(fit: Fit, path: Path) -> None:
    """Draw a fit into a .png, .pdf or .svg file.

    From the top: mobility measured (grey) and of the body, dB re 1 (m/s)/N; their difference in dB; coherence where it
    was measured; one standard deviation of frequency and Q of each mode, modes beyond the band hollow; poles after each
    iteration of the search, the stability chart of this method.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    r, body = fit.responses, fit.body
    with mpl.rc_context({"font.size": 11, "axes.grid": True, "grid.alpha": 0.3}):
        heights = [4.0, 1.3, *([1.0] if r.coherence is not None else []), 1.6, 1.6]
        figure = Figure(figsize=(11, 1.35 * sum(heights)), layout="constrained")
        axes = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
        top, off, *middle, spread, iterations = axes
        for i, (point, reference) in enumerate(r.pairs):
            shift, colour = -_APART * i, _COLOURS[i % len(_COLOURS)]
            top.plot(r.freq, 20 * np.log10(np.abs(r.mobility[i])) + shift, color="0.65", lw=2.0)
            below = f", {shift:g} dB" if shift else ""
            top.plot(
                r.freq, 20 * np.log10(np.abs(fit.mobility[i])) + shift, color=colour, lw=1.0,
                label=f"{point} from {reference}{below}",
            )  # fmt: skip
            off.plot(r.freq, 20 * np.log10(np.abs(fit.mobility[i] / r.mobility[i])), color=colour, lw=0.6)
        top.plot([], [], color="0.65", lw=2.0, label="measured")
        top.set(ylabel="mobility, dB re 1 (m/s)/N", xscale="log", xlim=(r.freq[0], r.freq[-1]))
        top.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
        limit = max(1.0, float(np.quantile(fit.error_db, 0.99)))
        off.set(ylabel="error, dB", ylim=(-limit, limit))
        for axis in middle:
            assert r.coherence is not None
            for i, row in enumerate(r.coherence):
                axis.plot(r.freq, row, color=_COLOURS[i % len(_COLOURS)], lw=0.8)
            axis.set(ylabel="coherence", ylim=(0, 1.02))
        sure = body.measured
        spread.plot(body.freq[sure], body.cents[sure], "o", color=_COLOURS[0], ms=5, label="frequency, cents")
        spread.plot(body.freq[sure], 100 * body.quality_error[sure], "x", color=_COLOURS[1], ms=6, label="Q, %")
        spread.set(ylabel="1 s.d.", yscale="log")
        spread.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
        for number, iteration in enumerate(fit.modes.iterations, 1):
            iterations.plot(iteration.freq, np.full(len(iteration.freq), number), "|", color="0.3", ms=9)
        last = len(fit.modes.iterations) + 1
        iterations.plot(body.freq[sure], np.full(np.count_nonzero(sure), last), "|", color=_COLOURS[0], ms=11, mew=2)
        iterations.set(ylabel="iteration", xlabel="frequency, Hz", ylim=(0.4, last + 0.6), yticks=range(1, last + 1))
        iterations.xaxis.set_major_formatter(mpl.ticker.ScalarFormatter())
        iterations.xaxis.set_minor_formatter(mpl.ticker.NullFormatter())
        with whole_file(path) as file:
            figure.savefig(file, format=path.suffix[1:].lower(), dpi=110)
