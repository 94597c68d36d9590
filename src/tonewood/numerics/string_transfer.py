"""How a string's motion passes from one stop to another, and its basis to another tension.

Both strings are described by a ramp and sines from the bridge (x = 0) to their own stop (see `string_modes`):

    u = d (1 - x / L) + sum_j a_j sin(k_j x),    k_j = j pi / L.

The field of the old string, cut off at the new stop or continued by rest beyond the old one, is not in the space of
the new: it has a jump or a kink there. Displacement is therefore projected in the energy norm and velocity in the
mass norm; both are contractions, so neither potential nor kinetic energy can rise. The bridge keeps its displacement
and its velocity: it belongs to the body, which a finger on the string does not move. Sine coefficients of the field
itself, the naive choice, multiply the energy by up to some hundreds.

Shorter string, L -> L': the field minus the straight line that takes its value at the new stop to zero,

    b_i = sum_j (k_j / k'_i)^2 (2 / L') int_0^L' sin(k_j x) sin(k'_i x) dx  a_j ;

longer string: the projection in the broken energy norm, which counts the kink at the old stop as no bending,

    b_i = { sum_j [T k'_i k_j int_0^L cos cos + EI k'_i^2 k_j^2 int_0^L sin sin] a_j - (T / L) sin(k'_i L) d }
          / { (L'/2) (T k'_i^2 + EI k'_i^4) } ,

a contraction by Bessel's inequality, because the sines are orthogonal in that norm on [0, L'].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import ModalBasis

Floats = NDArray[np.float64]


def string_transfer(old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
    """Matrices that carry modal coordinates from one basis of a string to another of its bases.

    Parameters
    ----------
    old, new : bases made by `string_modes.string_basis` (or the same with changed frequencies), of equal linear
        density and bending stiffness.

    Returns
    -------
    displacement, velocity : (n_new, n_old), for q (y = sum phi q) and for q'.

    Notes
    -----
    With equal tensions the potential energy of a displacement with bridge value d rises by no more than
    T d^2 / 2 (1 / L' - 1 / L) when the string is shortened, the work of a finger that presses a displaced string
    down, and never when it is lengthened; kinetic energy is bounded by that of the old field up to the part of the
    bridge's ramp which the kept sines cannot follow.
    """
    L, L_new = _number(old, "length"), _number(new, "length")
    tension, stiffness = _number(new, "tension"), _number(new, "bending_stiffness")
    vec, vec_new = _array(old, "vec"), _array(new, "vec")
    k, k_new = _wavenumbers(len(vec) - 1, L), _wavenumbers(len(vec_new) - 1, L_new)
    short = min(L, L_new)
    sine = _overlap(k_new, k, short, -1.0)
    displacement, velocity = np.zeros((len(vec_new), len(vec))), np.zeros((len(vec_new), len(vec)))
    displacement[0, 0] = velocity[0, 0] = 1.0
    velocity[1:, 1:] = 2 / L_new * sine
    if L_new <= L:
        displacement[1:, 1:] = 2 / L_new * sine * np.outer(1 / k_new**2, k**2)
        # what is left of the old ramp once the new one is taken off: (1/L' - 1/L) x, by its sine coefficients
        velocity[1:, 0] = -2 / L_new * (L_new / L - 1) * -np.cos(k_new * L_new) / k_new
    else:
        energy = L_new / 2 * (tension * k_new**2 + stiffness * k_new**4)
        cosine = _overlap(k_new, k, short, 1.0)
        broken = tension * np.outer(k_new, k) * cosine + stiffness * np.outer(k_new**2, k**2) * sine
        displacement[1:, 1:] = broken / energy[:, None]
        displacement[1:, 0] = -tension / L * np.sin(k_new * L) / energy
        velocity[1:, 0] = -2 / (L_new * L) * np.sin(k_new * L) / k_new**2
    modal = vec_new.T @ _mass(len(k_new), L_new, _number(new, "linear_density"))
    return np.asarray(modal @ displacement @ vec), np.asarray(modal @ velocity @ vec)


def retuned(
    basis: ModalBasis, freq_rad: Floats, damping_rate: Floats, changes: Mapping[str, object] | None = None
) -> ModalBasis:
    """Real modes with other frequencies and losses, same shapes and places.

    Parameters
    ----------
    basis : of real modes.
    freq_rad, damping_rate : (n_modes,) rad/s and 1/s.
    changes : of the metadata.
    """
    new = ModalBasis.real(
        freq_rad,
        damping_rate,
        {name: basis.right[i].real for i, name in enumerate(basis.points)},
        residual=basis.residual,
    )
    return replace(
        new,
        shape=basis.shape,
        residual_at=basis.residual_at,
        places=basis.places,
        metadata={**basis.metadata, **(changes or {})},
    )


def _overlap(a: Floats, b: Floats, length: float, sign: float) -> Floats:
    """(n_a, n_b) int_0^length of cos a x cos b x (sign 1) or sin a x sin b x (sign -1)."""
    difference, total = np.subtract.outer(a, b) * length, np.add.outer(a, b) * length
    return np.asarray(length / 2 * (np.sinc(difference / np.pi) + sign * np.sinc(total / np.pi)))


def _wavenumbers(n_sines: int, length: float) -> Floats:
    return np.asarray(np.arange(1, n_sines + 1) * np.pi / length, dtype=np.float64)


def _mass(n_sines: int, length: float, linear_density: float) -> Floats:
    """(n + 1, n + 1) mass matrix in (ramp, sines)."""
    mass = np.diag(np.concatenate([[length / 3], np.full(n_sines, length / 2)]))
    mass[0, 1:] = mass[1:, 0] = length / (np.arange(1, n_sines + 1) * np.pi)
    return linear_density * mass


def _number(basis: ModalBasis, key: str) -> float:
    return cast(float, basis.metadata[key])


def _array(basis: ModalBasis, key: str) -> Floats:
    return cast(Floats, basis.metadata[key])
