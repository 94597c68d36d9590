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
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import ModalBasis, second_order
from tonewood.support.arrays import Floats


def string_transfer(old: ModalBasis, new: ModalBasis) -> tuple[Floats, Floats]:
    """Return matrices that carry modal coordinates from one basis of a string to another of its bases.

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
    vec, sines = _array(old, "vec"), _Sines.of(old, new)
    return _to_modes(new, _displaced(old, new, sines, vec)), _to_modes(new, _moving(old, new, sines, vec))


def string_carry(old: ModalBasis, new: ModalBasis, q: Floats, velocity: Floats) -> tuple[Floats, Floats]:
    """Carry one motion as the matrices of `string_transfer` do, without making them.

    Parameters
    ----------
    old, new : bases, as for `string_transfer`.
    q, velocity : (n_old,) modal coordinates and their rates.

    Returns
    -------
    (n_new,) coordinates and rates in the new basis.
    """
    vec, sines = _array(old, "vec"), _Sines.of(old, new)
    shape = _displaced(old, new, sines, (vec @ q)[:, None])
    moving = _moving(old, new, sines, (vec @ velocity)[:, None])
    return _to_modes(new, shape)[:, 0], _to_modes(new, moving)[:, 0]


def _displaced(old: ModalBasis, new: ModalBasis, sines: _Sines, c: Floats) -> Floats:
    """Coefficients (ramp, sines) on the new string of displacements c (1 + n_sines, n) of the old one."""
    L, L_new, k, k_new = _number(old, "length"), _number(new, "length"), sines.b[:, None], sines.a[:, None]
    if L_new <= L:
        shape = 2 / L_new / k_new**2 * sines.sine(k**2 * c[1:])
    else:
        tension, stiffness = _number(new, "tension"), _number(new, "bending_stiffness")
        broken = tension * k_new * sines.cosine(k * c[1:]) + stiffness * k_new**2 * sines.sine(k**2 * c[1:])
        broken -= tension / L * np.sin(k_new * L) * c[0]
        shape = broken / (L_new / 2 * (tension * k_new**2 + stiffness * k_new**4))
    return np.concatenate([c[:1], shape])


def _moving(old: ModalBasis, new: ModalBasis, sines: _Sines, c: Floats) -> Floats:
    """Coefficients (ramp, sines) on the new string of velocities c (1 + n_sines, n) of the old one."""
    L, L_new, k_new = _number(old, "length"), _number(new, "length"), sines.a[:, None]
    if L_new <= L:
        # the old ramp less the new one: (1/L' - 1/L) x, by its sine coefficients
        ramp = 2 / L_new * (L_new / L - 1) * np.cos(k_new * L_new) / k_new
    else:
        ramp = -2 / (L_new * L) * np.sin(k_new * L) / k_new**2
    return np.concatenate([c[:1], 2 / L_new * sines.sine(c[1:]) + ramp * c[0]])


def _to_modes(basis: ModalBasis, c: Floats) -> Floats:
    """Modal coordinates (n_modes, n) of coefficients in (ramp, sines): V^T M c."""
    length, density = _number(basis, "length"), _number(basis, "linear_density")
    coupling = length / (np.arange(1, len(c)) * np.pi)
    with_mass = length / 2 * c + np.concatenate([[0.0], coupling])[:, None] * c[:1]
    with_mass[0] = length / 3 * c[0] + coupling @ c[1:]
    return np.asarray(density * (_array(basis, "vec").T @ with_mass))


def retuned(
    basis: ModalBasis, freq_rad: Floats, damping_rate: Floats, changes: Mapping[str, object] | None = None
) -> ModalBasis:
    """Return real modes with other frequencies and losses, same shapes and places.

    Parameters
    ----------
    basis : of real modes.
    freq_rad, damping_rate : (n_modes,) rad/s and 1/s.
    changes : of the metadata.
    """
    poles, kind, gain = second_order(freq_rad, damping_rate)
    return replace(
        basis,
        poles=poles,
        kind=kind,
        stiffness=freq_rad**2,
        damping_rate=damping_rate,
        left=basis.right * gain,
        metadata={**basis.metadata, **(changes or {})},
    )


@dataclass(frozen=True, eq=False)
class _Sines:
    """Integrals of products of two strings' sines over the shorter one, applied to coefficients.

    int_0^l sin a x sin b x dx = (b sin al cos bl - a cos al sin bl) / (a^2 - b^2),
    int_0^l cos a x cos b x dx = (a sin al cos bl - b cos al sin bl) / (a^2 - b^2),

    so that only 1 / (a^2 - b^2) is a matrix. Pairs of nearly one wavenumber, where this cancels, are kept apart.
    """

    a: Floats
    b: Floats
    length: float
    inverse: Floats
    close: tuple[NDArray[np.intp], NDArray[np.intp]]

    @classmethod
    def of(cls, old: ModalBasis, new: ModalBasis) -> _Sines:
        return _sines(
            len(_array(old, "vec")) - 1, _number(old, "length"), len(_array(new, "vec")) - 1, _number(new, "length")
        )

    @classmethod
    def between(cls, n: int, L: float, n_new: int, L_new: float) -> _Sines:
        """Make the products of n sines on the length L (m) with n_new ones on L_new."""
        a, b, length = _wavenumbers(n_new, L_new), _wavenumbers(n, L), min(L, L_new)
        nearest = np.clip(np.rint(a * L / np.pi).astype(np.intp) - 1, 0, max(len(b) - 1, 0))
        i = np.flatnonzero(np.abs(a - b[nearest]) * length < 1e-3) if len(b) else np.zeros(0, dtype=np.intp)
        j = nearest[i]
        gap = np.subtract.outer(a**2, b**2)
        gap[i, j] = np.inf
        return cls(a, b, length, 1 / gap, (i, j))

    def sine(self, c: Floats) -> Floats:
        """Sums over the old sines b with coefficients c (n_b, n)."""
        a, b = self.a[:, None], self.b[:, None]
        (sa, ca), (sb, cb) = self._ends
        out = sa * (self.inverse @ (b * cb * c)) - a * ca * (self.inverse @ (sb * c))
        return self._with_close(out, c, -1.0)

    def cosine(self, c: Floats) -> Floats:
        """Sums over cosines of the old wavenumbers b with coefficients c (n_b, n)."""
        a, b = self.a[:, None], self.b[:, None]
        (sa, ca), (sb, cb) = self._ends
        out = a * sa * (self.inverse @ (cb * c)) - ca * (self.inverse @ (b * sb * c))
        return self._with_close(out, c, 1.0)

    @cached_property
    def _ends(self) -> tuple[tuple[Floats, Floats], ...]:
        """Columns sin kl and cos kl of new and old sines."""
        angles = self.a[:, None] * self.length, self.b[:, None] * self.length
        return tuple((np.sin(angle), np.cos(angle)) for angle in angles)

    @cached_property
    def _close_sinc(self) -> tuple[Floats, Floats]:
        """Sinc of the difference and of the sum of pairs of nearly one wavenumber."""
        i, j = self.close
        difference, total = ((f(self.a[i], self.b[j])) * self.length / np.pi for f in (np.subtract, np.add))
        return np.sinc(difference), np.sinc(total)

    def _with_close(self, out: Floats, c: Floats, sign: float) -> Floats:
        i, j = self.close
        if i.size:
            difference, total = self._close_sinc
            out[i] += (self.length / 2 * (difference + sign * total))[:, None] * c[j]
        return out


#: both polarizations of a string pass from one stop to another, and often back: some (n_new, n) matrices are kept
_sines = lru_cache(maxsize=8)(_Sines.between)


def _wavenumbers(n_sines: int, length: float) -> Floats:
    return np.asarray(np.arange(1, n_sines + 1) * np.pi / length, dtype=np.float64)


def _number(basis: ModalBasis, key: str) -> float:
    return cast(float, basis.metadata[key])


def _array(basis: ModalBasis, key: str) -> Floats:
    return cast(Floats, basis.metadata[key])
