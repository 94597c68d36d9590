"""Thickness at which a top of a given outline has a wanted stiffness.

The lowest frequency of the bare top, clamped at its outline, stands for the stiffness: a stiff or a light top has a
high one. T. Gore and G. Gilet (Contemporary Acoustic Guitar Design and Build, 2011, Eq. 4.5-7) call it a panel's
vibrational stiffness and take Rayleigh's quotient of a clamped rectangle for it; their formula and targets are here as
public programs quote them, for the book was not at hand.
"""

from __future__ import annotations

import numpy as np

from tonewood.physics.plate.plate import Edge, Plate, cell_size
from tonewood.physics.plate.wood import Wood
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread

#: Hz, targets of Gore and Gilet for panels without braces
TARGETS = {"classical_top": 60.0, "steel_string_top": 75.0, "classical_back": 50.0, "steel_string_back": 55.0}
#: their Poisson's ratio nu_RL, and nu_LR nu_RL
_NU_RL, _PRODUCT = 0.05, 0.02
#: m, thinnest and thickest top
THINNEST, THICKEST = 5e-4, 2e-2


@one_blas_thread
def panel_freq(wood: Wood, outline: Floats, thickness: float) -> float:
    """Lowest frequency (Hz) of a bare plate clamped at its outline.

    outline : (n, 2) m, a ring.
    thickness : m.
    """
    size = min(cell_size(wood, thickness, 400.0), float(np.ptp(outline, axis=0).min()) / 12)
    return float(Plate([outline], wood, thickness, Edge(np.inf, np.inf), size=size).modes(count=1).freq[0])


@one_blas_thread
def thickness_for(wood: Wood, outline: Floats, freq: float) -> float:
    """Thickness (m) at which `panel_freq` is a frequency (Hz).

    Raises ValueError : it is below 0.5 mm or above 20 mm.
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


def gore_thickness(wood: Wood, length: float, width: float, freq: float) -> float:
    """Thickness (m) at which Rayleigh's quotient of a clamped rectangle is a frequency (Hz).

    h = pi f a^2 sqrt(12 (1 - n) rho / 126 / (E_L + r^2 E_R + r (4 nu_RL E_L / 7 + 8 (1 - n) G_LR / 7))), r = (a / b)^2,

    n = nu_LR nu_RL, of the shape w = x^2 (a - x)^2 y^2 (b - y)^2: a plate that does not shear, a few percent too stiff.

    length, width : m, a and b: of the body and of its lower bout.
    """
    ratio, free = (length / width) ** 2, 1 - _PRODUCT
    rigid = wood.E_L + ratio**2 * wood.E_R + ratio * (4 * _NU_RL * wood.E_L / 7 + 8 * free * wood.G_LR / 7)
    return float(np.pi * freq * length**2 * np.sqrt(12 * free * wood.density / 126 / rigid))
