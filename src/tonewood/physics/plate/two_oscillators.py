"""Far field of a guitar whose bridge alone was measured: two oscillators below, statistics of modes above.

The top and the air in the hole are two coupled oscillators with the modes A0 (f-) and T1 (f+). With their shapes phi at
the bridge, mass-normalised, and the air's stiffness kappa = rho c^2 / V,

    1 / m_p = phi-^2 + phi+^2,                       effective mass of the top at the bridge
    f_p'^2 = m_p (phi-^2 f-^2 + phi+^2 f+^2),        the top with the hole shut
    f_h^2 = f-^2 + f+^2 - f_p'^2,   f_p = f- f+ / f_h,
    kappa A^2 / m_p = (2 pi)^2 (f_p'^2 - f_p^2),     effective area A of the top
    V_k = A phi_k f_k^2 / (f_k^2 - f_h^2),           volume that a mode displaces, top and hole together

(O. Christensen and B. B. Vistisen, J. Acoust. Soc. Am. 68 (1980) 758). Both are sources in free air,
p = rho / (4 pi r) sum_k V_k q_k''. A mode above T1 has a radiation loss factor eta and as much chance of either sign:
its power, spread evenly over a sphere, gives

    |p_k| = sqrt(rho c eta omega_k / 4 pi) / r |q_k'|.

Phases between modes above T1 are made up: this estimates levels in bands, not a waveform.
"""

from __future__ import annotations

import numpy as np

from tonewood.physics.plate.air import AIR_DENSITY, SOUND_SPEED
from tonewood.support.arrays import Floats


def displaced_volumes(freq: tuple[float, float], shapes: tuple[float, float], volume: float) -> tuple[float, float]:
    """V of A0 and of T1, m^3 per unit of the mode's coordinate.

    freq, shapes : f- and f+ (Hz), phi- and phi+ (1/sqrt(kg)).
    volume : V of the body, m^3.
    Raises ValueError : no two coupled oscillators have these modes.
    """
    (low, high), (first, second) = freq, shapes
    total = first**2 + second**2
    shut = (first**2 * low**2 + second**2 * high**2) / total if total > 0 else 0.0
    hole = low**2 + high**2 - shut
    if not low**2 < hole < high**2:
        raise ValueError(f"modes at {low:.1f} and {high:.1f} Hz do not move the bridge as two coupled oscillators")
    stiffness = AIR_DENSITY * SOUND_SPEED**2 / volume
    area = np.sqrt((2 * np.pi) ** 2 * (shut - low**2 * high**2 / hole) / (total * stiffness))
    return float(area * first * low**2 / (low**2 - hole)), float(area * second * high**2 / (high**2 - hole))


def pressure_shapes(
    freq: Floats, loss: Floats, bridge: Floats, pair: tuple[int, int], volume: float, distance: float, radiated: float,
    signs: Floats,
) -> Floats:  # fmt: skip
    """(channels, n) Pa per unit of each mode's acceleration q'' at a distance (m).

    freq, loss, bridge : (n,) Hz, loss factors and shapes at the bridge.
    pair : numbers of A0 and T1; modes below T1 but these are taken to displace no volume.
    volume : m^3, of the body.
    radiated : loss factor by radiation of a mode above T1, at most its whole loss.
    signs : (channels, n) of 1 and -1, for the modes above T1.
    """
    out = np.zeros(signs.shape)
    above = freq > freq[pair[1]]
    share = np.minimum(radiated, loss[above])
    omega = 2 * np.pi * freq[above]
    out[:, above] = signs[:, above] * np.sqrt(AIR_DENSITY * SOUND_SPEED * share / (4 * np.pi * omega)) / distance
    low, high = (float(freq[k]) for k in pair)
    volumes = displaced_volumes((low, high), (float(bridge[pair[0]]), float(bridge[pair[1]])), volume)
    for k, displaced in zip(pair, volumes, strict=True):
        out[:, k] = AIR_DENSITY * displaced / (4 * np.pi * distance)
    return out
