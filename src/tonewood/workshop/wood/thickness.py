"""Thickness at which a top of a given outline has a wanted stiffness.

The lowest frequency of the bare top, clamped at its outline, stands for the stiffness: a stiff or a light top has a
high one. It is the kind of target that T. Gore and G. Gilet (Contemporary Acoustic Guitar, 2011) call a panel's
vibrational stiffness. Their book's formula, of a rectangle, was not at hand, and none of their figures is built in.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.plate.plate import Edge, Plate, cell_size
from tonewood.physics.plate.wood import Wood

Floats = NDArray[np.float64]

#: m, thinnest and thickest top
THINNEST, THICKEST = 5e-4, 2e-2


def panel_freq(wood: Wood, outline: Floats, thickness: float) -> float:
    """Lowest frequency (Hz) of a bare plate clamped at its outline.

    Parameters
    ----------
    outline : (n, 2) m, a ring.
    thickness : m.
    """
    size = min(cell_size(wood, thickness, 400.0), float(np.ptp(outline, axis=0).min()) / 12)
    return float(Plate([outline], wood, thickness, Edge(np.inf, np.inf), size=size).modes(count=1).freq[0])


def thickness_for(wood: Wood, outline: Floats, freq: float) -> float:
    """Thickness (m) at which `panel_freq` is a frequency (Hz).

    Raises
    ------
    ValueError : it is below 0.5 mm or above 20 mm.
    """
    h = 2.5e-3
    for _ in range(6):  # the frequency is nearly proportional to the thickness
        now = panel_freq(wood, outline, h)
        last, h = h, h * freq / now
        if not THINNEST <= h <= THICKEST:
            raise ValueError(f"{freq:g} Hz would need {1e3 * h:.2g} mm; 0.5 to 20 mm are allowed")
        if abs(h / last - 1) < 1e-5:
            break
    return h
