"""Pictures of modes: displacement of the plate in colours, nodal lines in black as sand would draw them (Chladni)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tonewood.physics.plate.outline import inside
from tonewood.physics.plate.radiation import Sources
from tonewood.support.arrays import Floats
from tonewood.support.plotting import title

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: panels in a row
COLUMNS = 4


def draw_shapes(axes: Iterable[Axes], sources: Sources, freq: Floats, q: Floats) -> None:
    """Draw a mode in each axes; axes without a mode are left empty.

    Colours span the displacement of the plate; that of the air in a hole, which is larger, fills it with its sign.
    """
    from matplotlib.tri import Triangulation

    wood = inside(sources.points, sources.rings)
    points = sources.points[wood]
    mesh = Triangulation(points[:, 1], points[:, 0])
    corners = points[mesh.triangles]
    mesh.set_mask(~inside(corners.mean(axis=1), sources.rings))
    height = sources.volumes / sources.areas[:, None]
    for k, ax in enumerate(axes):
        ax.set_axis_off()
        if k < len(freq):
            flow = height[~wood, k].mean() if not wood.all() else 0.0
            _draw(ax, mesh, height[wood, k], float(flow), sources.rings)
            label = sources.labels[k] if k < len(sources.labels) else ""
            title(ax, f"{label + ' ' if label in ('A0', 'T1') else ''}{freq[k]:.0f} Hz, Q {q[k]:.0f}")


def _draw(ax: Axes, mesh: Any, height: Floats, air: float, rings: Sequence[Floats]) -> None:
    largest = float(np.quantile(np.abs(height), 0.99)) or 1.0
    shown = np.clip(height / largest, -1.0, 1.0)
    ax.tripcolor(mesh, shown, shading="gouraud", cmap="RdBu_r", vmin=-1.2, vmax=1.2, rasterized=True)
    ax.tricontour(mesh, height, levels=[0.0], colors="black", linewidths=1.2)
    colour = "white" if abs(air) < 0.05 * largest else "#f0b7a0" if air > 0 else "#a6cde3"
    for ring in rings[1:]:
        ax.fill(ring[:, 1], ring[:, 0], color=colour)
    for ring in rings:
        closed = np.vstack([ring, ring[:1]])
        ax.plot(closed[:, 1], closed[:, 0], color="0.25", lw=1.5)
    ax.set_aspect("equal")
    if not ax.yaxis_inverted():
        ax.invert_yaxis()
