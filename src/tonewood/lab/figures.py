"""Pictures of validations, drawn without any global state of matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tonewood.errors import TonewoodError
from tonewood.support.plotting import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def figure(
    rows: int = 1, columns: int = 1, *, size: tuple[float, float] | None = None, polar: bool = False, **shared: Any
) -> tuple[Figure, Any]:
    """An empty figure and its axes: one of them, or an array as of `matplotlib.pyplot.subplots`."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise TonewoodError("plots need matplotlib: pip install 'tonewood[plot]'") from None
    fig = Figure(figsize=size or (9.0, 3.4 * rows), layout="constrained")
    axes = fig.subplots(rows, columns, subplot_kw={"projection": "polar"} if polar else {}, **shared)
    for ax in fig.axes:
        ax.set_prop_cycle(color=COLOURS)
    return fig, axes
