"""Style of every figure: one quantity a row, logarithmic frequency, levels in dB, readable at half its size.

A figure is `WIDTH` inches wide with text of 18 pt, so that at half its size (a column of a page) text has 9 pt. Colours
are those of Okabe and Ito, distinct to any colour vision; where curves are compared, their dashes differ, too.
Nothing here touches the global state of matplotlib, which is imported when a figure is made.

Source of the colours: M. Okabe, K. Ito, Color universal design, jfly.uni-koeln.de/color (2008).
"""

from __future__ import annotations

import base64
import io
import textwrap
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.errors import TonewoodError
from tonewood.support.whole_files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: blue, vermilion, green, purple, orange, sky blue, black
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
#: dashes of the first, second, ... curve that are compared
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
#: inches, and points
WIDTH, TEXT, SMALL, LINE = 10.0, 18.0, 16.0, 2.0
#: colours of levels in a spectrogram; equal steps of level are equal steps of lightness
LEVELS = "magma"
#: characters of a line as wide as a figure
_LINE_LENGTH = 64
#: suffixes of pictures
PICTURES = (".png", ".pdf", ".svg")


def figure(
    rows: int = 1,
    columns: int = 1,
    *,
    heights: Sequence[float] | None = None,
    sharex: bool = False,
    sharey: bool = False,
    polar: bool = False,
) -> tuple[Figure, NDArray[Any]]:
    """Make an empty figure and its axes.

    heights : of the rows, inches; 4 each.
    sharex, sharey : whether all axes share a scale.
    polar : polar axes.
    Returns figure, axes : (rows, columns).
    Raises TonewoodError : matplotlib is not installed.
    """
    tall = [4.0] * rows if heights is None else list(heights)
    chart = _figure_class()(figsize=(WIDTH, sum(tall) + 0.2), layout="constrained")
    axes = chart.subplots(
        rows,
        columns,
        squeeze=False,
        sharex=sharex,
        sharey=sharey,
        gridspec_kw={"height_ratios": tall},
        subplot_kw={"projection": "polar"} if polar else {},
    )
    for ax in axes.ravel():
        ax.tick_params(which="both", labelsize=SMALL)
        ax.grid(which="both", color="0.9", lw=0.8)
        ax.set_axisbelow(True)
        for text in (ax.xaxis.label, ax.yaxis.label, ax.title):
            text.set_size(TEXT)
        ax.yaxis.get_offset_text().set_size(SMALL)
    return chart, axes


@cache
def _figure_class() -> type[Figure]:
    """Figures that a notebook shows without pyplot."""
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
        from matplotlib.text import Text
    except ImportError:
        raise TonewoodError("figures need matplotlib: pip install 'tonewood[plot]'") from None

    class ShownFigure(Figure):
        def savefig(self, *args: Any, **options: Any) -> None:
            """Write the figure, without TeX also where a ``matplotlibrc`` asks for it: texts of figures are plain."""
            for text in self.findobj(Text):
                text.set_usetex(False)
            with rc_context({"text.usetex": False}):
                super().savefig(*args, **options)

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png", dpi=72)
            return stream.getvalue()

    return ShownFigure


def plain(text: str) -> str:
    """A text as matplotlib prints it without reading dollar signs as mathematics."""
    return text.replace("$", r"\$")


def frequency_axis(ax: Axes, low: float, high: float) -> None:
    """Give an axes a logarithmic axis of frequency from `low` to `high` Hz, with marks at 1, 2 and 5."""
    marks = [m * 10.0**k for k in range(6) for m in (1, 2, 5) if low <= m * 10.0**k <= high]
    ax.set(xscale="log", xlim=(low, high), xlabel="frequency, Hz")
    ax.set_xticks(marks, [f"{m:g}" if m < 1000 else f"{m / 1000:g}k" for m in marks])
    ax.set_xticks([], minor=True)


def title(ax: Axes, text: str) -> None:
    """Write a title above an axes, in as many lines as it needs."""
    ax.set_title(plain(textwrap.fill(text, _LINE_LENGTH)), fontsize=TEXT)


def legend_above(chart: Figure, ax: Axes) -> None:
    """Add a legend of the curves of an axes above the whole figure, where it hides none of them."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        columns = max(1, min(len(labels), 80 // max(len(label) + 6 for label in labels)))
        chart.legend(handles, labels, loc="outside upper center", ncols=columns, fontsize=SMALL, handlelength=2.6)


def log_axis(ax: Axes) -> None:
    """Give an axes a logarithmic vertical axis with plain numbers at 1, 2 and 5."""
    from matplotlib.ticker import LogLocator, NullFormatter

    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=8))
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())


def legend(ax: Axes, **options: Any) -> None:
    """Add a legend to an axes that has curves with labels."""
    if ax.get_legend_handles_labels()[0]:
        title = options.pop("title", None)
        ax.legend(fontsize=SMALL, title=title, title_fontsize=SMALL, handlelength=2.6, framealpha=0.85, **options)


def draw_mobility(ax: Axes, freq: ArrayLike, curves: Mapping[str, ArrayLike]) -> None:
    """Draw driving-point mobilities: (n,) Hz; label -> (n,) (m/s)/N, drawn in dB re 1 (m/s)/N."""
    f = np.asarray(freq, dtype=np.float64)
    for i, (label, values) in enumerate(curves.items()):
        level = 20 * np.log10(np.maximum(np.abs(np.asarray(values)), 1e-12))
        ax.plot(
            f, level, color=COLOURS[i % len(COLOURS)], ls=DASHES[i // len(COLOURS) % 4], lw=LINE, label=plain(label)
        )
    frequency_axis(ax, float(f[0]), float(f[-1]))
    ax.set_ylabel("mobility\ndB re 1 (m/s)/N")


def mobility_figure(
    freq: ArrayLike, curves: Mapping[str, ArrayLike], *, heading: str = "", marks: Sequence[float] = (), of: str = ""
) -> Figure:
    """Figure of driving-point mobilities.

    freq, curves : as for `draw_mobility`.
    marks : Hz, drawn as grey lines: pitches of open strings.
    of : title of the legend.
    """
    chart, axes = figure(heights=[5.0])
    ax = axes[0, 0]
    draw_mobility(ax, freq, curves)
    for mark in marks:
        ax.axvline(mark, color="0.75", lw=1.0, zorder=0)
    title(ax, heading)
    legend(ax, title=of or None, ncols=2 if len(curves) > 3 else 1)
    return chart


def points_figure(freq: ArrayLike, rows: Mapping[str, ArrayLike], *, heading: str = "") -> Figure:
    """Figure with a point per mode and a row per quantity, on logarithmic axes.

    freq : (n,) Hz.
    rows : label of the row, with unit -> (n,) values; those that are not positive and finite are left out.
    """
    f = np.asarray(freq, dtype=np.float64)
    chart, axes = figure(len(rows), heights=[3.4] * len(rows), sharex=True)
    shown = f[f > 0]
    low, high = (float(shown.min()) / 1.15, float(shown.max()) * 1.15) if shown.size else (20.0, 20000.0)
    for ax, (label, levels) in zip(axes[:, 0], rows.items(), strict=True):
        values = np.asarray(levels, dtype=np.float64)
        fit = np.isfinite(values) & (values > 0) & (f > 0)
        ax.plot(f[fit], values[fit], "o", color=COLOURS[0], ms=7)
        frequency_axis(ax, low, high)
        ax.set(ylabel=label, xlabel="frequency, Hz" if ax is axes[-1, 0] else "")
        log_axis(ax)
    title(axes[0, 0], heading)
    return chart


def draw_spectrogram(
    ax: Axes, time: ArrayLike, freq: ArrayLike, level_db: ArrayLike, *, floor_db: float, top_db: float = 0.0
) -> Any:
    """Draw levels (n_freq, n_time) in dB over time (s) and frequency (Hz); returns the image, for a colour bar."""
    t, f = np.asarray(time, dtype=np.float64), np.asarray(freq, dtype=np.float64)
    shown = ax.imshow(
        np.asarray(level_db), origin="lower", aspect="auto", cmap=LEVELS, vmin=floor_db, vmax=top_db,
        extent=(float(t[0]), float(t[-1]), float(f[0]) / 1e3, float(f[-1]) / 1e3), interpolation="nearest",
    )  # fmt: skip
    ax.grid(visible=False)
    ax.set_ylabel("frequency, kHz")
    return shown


def colour_bar(chart: Figure, shown: Any, axes: Any, label: str) -> None:
    """Add the scale of a spectrogram's colours."""
    bar = chart.colorbar(shown, ax=axes, pad=0.01)
    bar.ax.tick_params(labelsize=SMALL)
    bar.set_label(label, size=TEXT)


def save(chart: Figure, path: Path, *, make_folder: bool = False) -> Path:
    """Write a figure to a file that appears when it is complete; its suffix is one of `PICTURES`."""
    with whole_file(path, make_folder=make_folder) as stream:
        chart.savefig(stream, format=path.suffix[1:].lower(), dpi=110)
    return path


def png(chart: Figure, dpi: float = 110) -> bytes:
    """A figure as PNG."""
    stream = io.BytesIO()
    chart.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def svg(chart: Figure) -> bytes:
    """A figure as SVG, the same bytes for the same figure."""
    import matplotlib as mpl

    stream = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "tonewood"}):
        chart.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def data_uri(content: bytes, kind: str) -> str:
    """Bytes as an address that holds them: ``data:KIND;base64,...``."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
