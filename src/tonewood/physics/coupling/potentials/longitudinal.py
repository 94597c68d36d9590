"""Strings whose longitudinal motion is stepped too: phantom partials at sums of transverse ones.

A string moves transversely by v and w and along itself by u. To fourth order in the motion its strain e stores V,

    e = u_x + (v_x^2 + w_x^2) / 2,        V = EA/2 int_0^L e^2 dx,

beside the energy that the tension at rest stores (Bilbao, Numerical Sound Synthesis, 2009, ch. 8; Bank & Sujbert,
J. Acoust. Soc. Am. 117, 2005, Eqs 5-8; Chabassier & Joly, Comput. Methods Appl. Mech. Engrg 199, 2010, whose exact
string it approximates).
Slopes in cosines, v_x = sum c_i cos(i pi x / L), make the strain a series of cosines,

    e_n = s_n + l_n,   s_n = 1/2 sum over polarizations c^T H_n c,   l_n = strain of the longitudinal modes,
    V = EA L/2 [e_0^2 + 1/2 sum_{n = 1 .. P} e_n^2],

H_n couples c_i with c_j where |i - j| = n or i + j = n. A longitudinal mode above the P-th would follow at once, and
then its e_n is zero: it is left out together with e_n. The squares of l_n are the energy of the longitudinal modes
themselves, which are stepped exactly; the rest is
U = EA L/2 sum g_n (s_n^2 + 2 s_n l_n), g_0 = 1, g_n = 1/2. U plus the energy of the modes is a sum of squares, so
nothing can grow without limit.

U is stepped by psi = sqrt(2 (U + C)) (`potentials.base`), the shift C held for 64 steps. Here g is the gradient of U
over the step divided by sqrt(2 (U + C)),

    grad U = EA L sum g_n [(s_n + l_n) H_n c_m  on the slopes,   s_n on the strain l_n],

c_m the slopes and s_n their squares in the middle of the step (`ModalCoordinates.middle`), and l_n the strain of the
longitudinal modes there under s_n, the connections answering: without that answer the end of
the string would give way. C is 1e-8 EA L more than the energy of the string when C was chosen, so that modes never hold
more than twice the energy that is there and 1e-8 EA L.

Left out: terms of fifth order, T0 beside EA (below 1 % for steel, 3 % for nylon), shear and rotation. Transverse modes
above a frequency that the string's maker chooses do not take part in U; they are stepped as without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, cast

import numpy as np

from tonewood.physics.coupling.potentials.base import JoinedPotential, Kind, MiddleOfStep, Potential
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

#: cosines of the slope beyond the number of modes: the bridge's motion spreads a mode over its neighbours
MORE_COSINES = 12
#: part of EA L by which C exceeds the energy of a string: psi must not pass zero where a string at rest begins to move
LEAST_SHIFT = 1e-8


def cosine_slopes(name: str, component: str, basis: ModalBasis) -> tuple[Floats, Floats, float]:
    """Return shapes as a ramp and sines (rows, n_modes), wavenumbers of their slopes' cosines (rows,), and the length.

    Raises ValueError : the component was not made by `string_basis`.
    """
    metadata = basis.metadata
    if "vec" not in metadata:
        raise ValueError(f"{name}: {component} does not tell its shapes as a ramp and sines")
    vec, length = cast(Floats, metadata["vec"]), cast(float, metadata["length"])
    wavenumber: Floats = np.asarray(np.arange(len(vec)) * np.pi / length, dtype=np.float64)
    wavenumber[0] = -1.0 / length
    return vec, wavenumber, length


@dataclass(frozen=True, eq=False)
class GeometricStretch(Potential):
    """Couples a string's polarizations with its longitudinal motion.

    Attributes
    ----------
    name : of the string.
    transverse : its polarizations: components of real modes, made by `string_modes.string_basis`.
    longitudinal : component of its longitudinal motion: the same, with EA in place of the tension.
    axial_stiffness : EA, N.
    freq_coupled : Hz, transverse modes below it take part, the lowest at least.
    """

    name: str
    transverse: tuple[str, ...]
    longitudinal: str
    axial_stiffness: float
    freq_coupled: float = np.inf
    label: ClassVar[str] = "stretch"
    effect: ClassVar[str] = "longitudinal"  # type: ignore[misc]  # of this kind always

    def __post_init__(self) -> None:
        if not (self.axial_stiffness > 0.0 and self.freq_coupled > 0.0 and self.transverse):
            raise ValueError(f"{self.name}: a stretched string needs components, and EA and a frequency above 0")

    @property
    def components(self) -> tuple[str, ...]:  # type: ignore[override]  # of two attributes
        """All its components, the longitudinal one last."""
        return (*self.transverse, self.longitudinal)

    def share(self, component: str, basis: ModalBasis, dt: float) -> GeometricShare:
        """Return the arrays of one component.

        Raises
        ------
        ValueError : the component was not made by `string_basis`.
        """
        vec, wavenumber, length = cosine_slopes(self.name, component, basis)
        longitudinal = component == self.longitudinal
        count = basis.n_modes if longitudinal else max(1, int(np.searchsorted(basis.natural_freq, self.freq_coupled)))
        rows = len(vec) if longitudinal else min(len(vec), count + 1 + MORE_COSINES)
        slopes = np.ascontiguousarray(wavenumber[:rows, None] * vec[:rows, :count])
        return GeometricShare(slopes, self.axial_stiffness * length)

    def join(self, shares: Sequence[GeometricShare]) -> GeometricShares:
        """Return the string of all its motions."""
        return GeometricShares(tuple(shares))


@dataclass(frozen=True, eq=False)
class GeometricShare:
    """One component's share.

    slopes : (n_cosines, n) cosine coefficients of the slope (of the longitudinal component: strain) per coordinate.
    scale : EA L, N m.
    """

    slopes: Floats
    scale: float

    @property
    def n(self) -> int:
        """Modes that take part: the lowest ones."""
        return int(self.slopes.shape[1])


def cosine_products(n: int, n_cosines: int) -> Floats:
    """H_n, (n_cosines, n_cosines): n-th cosine coefficient of (sum c_i cos(i theta))^2 / 2 is c^T H_n c / 2."""
    i = np.arange(n_cosines)
    if n == 0:
        return np.diag(np.where(i == 0, 1.0, 0.5))
    out = np.zeros((n_cosines, n_cosines))
    distant, mirrored = i[1 : max(n_cosines - n, 1)], i[1:n]
    out[distant, distant + n] = out[distant + n, distant] = 0.5
    mirrored = mirrored[(mirrored < n_cosines) & (n - mirrored < n_cosines)]
    out[mirrored, n - mirrored] = 0.5
    if n < n_cosines:
        out[0, n] = out[n, 0] = 1.0
    return out


def cosine_product(c: Floats, d: Floats, count: int) -> Floats:
    """(count,) coefficients e_n = c^T H_n d of the product of two series of cosines."""
    out = np.zeros(max(count, len(c) + len(d) - 1))
    out[: len(c) + len(d) - 1] = np.convolve(c, d)  # i + j = n
    shifts = np.correlate(c, d, "full")  # i - j, from -(len(d) - 1) on
    zero = len(d) - 1
    out[: len(c)] += shifts[zero:]
    out[1 : len(d)] += shifts[:zero][::-1]
    return np.asarray(0.5 * out[:count])


def cosine_gradient(w: Floats, c: Floats) -> Floats:
    """sum_n w_n H_n c, as long as c: the gradient of sum_n w_n c^T H_n c / 2."""
    n, zero = len(c), len(c) - 1
    folded = np.zeros(n)
    mirrored = np.correlate(w, c, "full")[zero:][:n]  # sum_m w_{i + m} c_m
    folded[: len(mirrored)] = mirrored
    distant = np.correlate(c, np.concatenate([[0.0], w[1:]]), "full")[len(w) - 1 :]  # sum_{m > 0} w_m c_{i + m}
    return np.asarray(0.5 * (folded + np.convolve(w, c)[:n] + distant))


@dataclass(frozen=True, eq=False)
class GeometricShares(JoinedPotential):
    """The parts of one string together: its potential U and the direction of a step.

    Coordinates of all parts stand one after another, the longitudinal ones last.
    """

    parts: tuple[GeometricShare, ...]

    @cached_property
    def sizes(self) -> tuple[int, ...]:  # type: ignore[override]  # found when first wanted
        """Coordinates of each part."""
        return tuple(part.n for part in self.parts)

    @cached_property
    def strains(self) -> Floats:
        """(P + 1, n): l = strains y."""
        longitudinal = self.parts[-1]
        return np.hstack([np.zeros((len(longitudinal.slopes), self.n - longitudinal.n)), longitudinal.slopes])

    @cached_property
    def weights(self) -> Floats:
        """(P + 1,) EA L g_n, N m."""
        return self.parts[-1].scale * np.where(np.arange(len(self.strains)) == 0, 1.0, 0.5)

    @cached_property
    def stretching(self) -> list[tuple[slice, GeometricShare]]:
        """Transverse parts, and their places among the coordinates."""
        ends = [slice(*ends) for ends in pairwise([0, *np.cumsum(self.sizes).tolist()])]
        return list(zip(ends[:-1], self.parts[:-1], strict=True))

    def squares(self, y: Floats) -> Floats:
        """(P + 1,) s_n of coordinates (n,)."""
        out = np.zeros(len(self.strains))
        for at, part in self.stretching:
            slopes = part.slopes @ y[at]
            out += 0.5 * cosine_product(slopes, slopes, len(out))
        return out

    def potential(self, s: Floats, strain: Floats) -> float:
        """U, J, of s_n and l_n, (P + 1,) each."""
        return float(self.weights @ (0.5 * s * s + s * strain))

    def energy(self, y: Floats) -> float:
        """U, J: energy that coordinates (n,) store besides that of the modes."""
        return self.potential(self.squares(y), self.strains @ y)

    def gradient(self, y: Floats, s: Floats, strain: Floats) -> Floats:
        """(n,) grad U, N / sqrt(kg), of coordinates y whose s_n and l_n count as given."""
        out, weights = (self.weights * s) @ self.strains, self.weights * (s + strain)
        for at, part in self.stretching:
            out[at] += cosine_gradient(weights, part.slopes @ y[at]) @ part.slopes
        return np.asarray(out)

    def shift(self, kept: float, stored: float, modes: Callable[[], float]) -> float:
        """C, J, held while it is enough: all energy of the string, or the shortfall of U if more, and a little."""
        if kept > 0.0 and stored + kept > 0.0:
            return kept
        return float(max(modes() + stored, -stored, 0.0) + LEAST_SHIFT * self.parts[-1].scale)

    def fast(self, middle: Floats) -> Floats:
        """Forces on the longitudinal modes under s_n."""
        return -(self.weights * self.squares(middle)) @ self.strains

    def direction(self, step: MiddleOfStep) -> Floats:
        """See `JoinedPotential`."""
        squares, strain = self.squares(step.middle), np.asarray(self.strains @ step.answered)
        potential = self.potential(squares, strain)
        size = np.sqrt(max(2 * (potential + step.shift), abs(potential) + step.shift))
        return self.gradient(step.middle, squares, strain) / size if size > 0.0 else np.zeros(self.n)

    def describe(self) -> dict[str, Any]:
        """See `JoinedPotential`."""
        parts = [{"slopes": part.slopes} for part in self.parts]
        return {"kind": Kind.LONGITUDINAL, "scale": self.parts[-1].scale, "parts": parts}
