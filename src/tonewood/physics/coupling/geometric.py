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
then its e_n is zero: it is left out together with e_n. With P = 0 and the end held, this is Kirchhoff and Carrier's
string (`tension`): such strings are stepped here, too, where both kinds stand side by side. The squares of l_n are the
energy of the longitudinal modes themselves, which are stepped exactly; the rest is
U = EA L/2 sum g_n (s_n^2 + 2 s_n l_n), g_0 = 1, g_n = 1/2. U plus the energy of the modes is a sum of squares, so
nothing can grow without limit.

U is stepped by a variable of its own, as the rise of a tension is (`tension`): psi = sqrt(2 (U + C)), the shift C held
for 64 steps, and modal forces -g psi_m along a direction g that is known before the connections answer. Whatever g is,
the energy of the modes and psi^2 / 2 - C together do not rise. Here g is the gradient of U over the step divided by
sqrt(2 (U + C)),

    grad U = EA L sum g_n [(s_n + l_n) H_n c_m  on the slopes,   s_n on the strain l_n],

c_m the mean of the slopes before the step and of those free of this coupling after it, s_n the mean of both, and l_n
the mean strain that the longitudinal modes have under s_n, the connections answering: without that answer the end of
the string would give way. C is 1e-8 EA L more than the energy of the string when C was chosen, so that modes never hold
more than twice the energy that is there and 1e-8 EA L.

Left out: terms of fifth order, T0 beside EA (below 1 % for steel, 3 % for nylon), shear and rotation. Transverse modes
above a frequency that the string's maker chooses do not take part in U; they are stepped as without it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.propagator import apply

Floats = NDArray[np.float64]

#: cosines of the slope beyond the number of modes: the bridge's motion spreads a mode over its neighbours
MORE_COSINES = 12


@dataclass(frozen=True, eq=False)
class GeometricStretch:
    """Couples a string's polarizations with its longitudinal motion.

    Attributes
    ----------
    name : of the string.
    components : its polarizations: components of real modes, made by `string_modes.string_basis`.
    longitudinal : component of its longitudinal motion: the same, with EA in place of the tension; None is a string
        without longitudinal motion, and all its modes take part: Kirchhoff and Carrier's.
    axial_stiffness : EA, N.
    freq_coupled : Hz, transverse modes below it take part.
    """

    name: str
    components: tuple[str, ...]
    longitudinal: str | None
    axial_stiffness: float
    freq_coupled: float = np.inf

    def __post_init__(self) -> None:
        if not (self.axial_stiffness > 0.0 and self.freq_coupled > 0.0 and self.components):
            raise ValueError(f"{self.name}: a stretched string needs components, and EA and a frequency above 0")

    @property
    def parts(self) -> tuple[str, ...]:
        """All its components, the longitudinal one last."""
        return self.components if self.longitudinal is None else (*self.components, self.longitudinal)

    def part(self, component: str, basis: ModalBasis, held: Floats) -> GeometricShare:
        """Arrays of one component.

        Parameters
        ----------
        held : (n_modes, 2, 2) h phi_1(A h), the response to an input held over a step.

        Raises
        ------
        ValueError : the component was not made by `string_basis`.
        """
        known, stretch = basis.metadata, None
        if not basis.is_real or "vec" not in known:
            raise ValueError(f"{self.name}: {component} does not tell its shapes as a ramp and sines")
        vec, length = cast(Floats, known["vec"]), cast(float, known["length"])
        longitudinal = component == self.longitudinal
        if self.longitudinal is None:
            count = basis.n_modes
            stretch = np.asarray(known.get("stretch_part", known["tension_part"]), dtype=np.float64) / length
            slopes = np.zeros((0, count))
        else:
            count = basis.n_modes if longitudinal else int(np.searchsorted(basis.natural_freq, self.freq_coupled))
            rows = len(vec) if longitudinal else min(len(vec), count + 1 + MORE_COSINES)
            wavenumber = np.arange(rows) * np.pi / length
            wavenumber[0] = -1.0 / length
            slopes = np.ascontiguousarray(wavenumber[:, None] * vec[:rows, :count])
        pair = basis.kind == PAIR
        kick = np.where(pair[:, None], [[0.0, -0.5]] / np.where(pair, basis.poles.imag, 1.0)[:, None], [[0.0, 1.0]])
        _, on_first, on_second, *_, per_velocity = basis.motion
        return GeometricShare(
            slopes=slopes,
            reading=np.where(pair, 2.0, 1.0),
            kick=apply(held, kick),
            velocity=np.stack([on_first, on_second, per_velocity]),
            stiffness=np.asarray(basis.stiffness)[:count],
            scale=self.axial_stiffness * length,
            longitudinal=longitudinal,
            stretch=stretch,
        )


@dataclass(frozen=True, eq=False)
class GeometricShare:
    """One component's share.

    Attributes
    ----------
    slopes : (n_cosines, n) cosine coefficients of the slope (of the longitudinal component: strain) per coordinate.
    reading : (n_modes,) coordinate y = reading times the first number of the mode.
    kick : (n_modes, 2) state added by a unit modal force held over one step.
    velocity : (3, n_modes) y' per first and per second number, and second number per y'.
    stiffness : (n,) omega^2, 1 / s^2.
    scale : EA L, N m.
    longitudinal : whether this is the longitudinal component.
    stretch : (n,) of a string without one, in place of the slopes: s_0 = 1/2 sum stretch y^2, 1 / (kg m^2).
    """

    slopes: Floats
    reading: Floats
    kick: Floats
    velocity: Floats
    stiffness: Floats
    scale: float
    longitudinal: bool
    stretch: Floats | None = None

    @property
    def n(self) -> int:
        """Modes that take part: the lowest ones."""
        return len(self.stiffness)

    def coordinates(self, x: Floats) -> Floats:
        """(n,) y of a state (n_modes, 2)."""
        return self.reading[: self.n] * x[: self.n, 0]

    def energy(self, x: Floats) -> float:
        """Energy of these modes in a state (n_modes, 2), J."""
        moving = (self.velocity[:2] * x.T).sum(axis=0)[: self.n]
        return float(0.5 * (moving @ moving + self.stiffness @ self.coordinates(x) ** 2))


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
class GeometricShares:
    """The parts of one string together: its potential U and the forces of a step.

    Coordinates of all parts stand one after another, the longitudinal ones (if there are any) last.
    """

    parts: tuple[GeometricShare, ...]

    @cached_property
    def sizes(self) -> NDArray[np.intp]:
        """First coordinate of each part, and the number of all."""
        return np.cumsum([0, *(p.n for p in self.parts)])

    @property
    def n(self) -> int:
        """Coordinates."""
        return int(self.sizes[-1])

    @cached_property
    def strains(self) -> Floats:
        """(P + 1, n): l = strains y."""
        longitudinal = self.parts[-1]
        if not longitudinal.longitudinal:
            return np.zeros((1, self.n))
        return np.hstack([np.zeros((len(longitudinal.slopes), self.n - longitudinal.n)), longitudinal.slopes])

    @cached_property
    def weights(self) -> Floats:
        """(P + 1,) EA L g_n, N m."""
        return self.parts[-1].scale * np.where(np.arange(len(self.strains)) == 0, 1.0, 0.5)

    @cached_property
    def stretching(self) -> list[tuple[slice, GeometricShare]]:
        """Parts that stretch the string, and their places among the coordinates."""
        ends = [slice(*ends) for ends in pairwise(self.sizes)]
        return [(at, part) for at, part in zip(ends, self.parts, strict=True) if not part.longitudinal]

    def squares(self, y: Floats) -> Floats:
        """(P + 1,) s_n of coordinates (n,)."""
        out = np.zeros(len(self.strains))
        for at, part in self.stretching:
            if part.stretch is not None:
                out[0] += 0.5 * part.stretch @ y[at] ** 2
            else:
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
            if part.stretch is not None:
                out[at] += weights[0] * part.stretch * y[at]
            else:
                out[at] += cosine_gradient(weights, part.slopes @ y[at]) @ part.slopes
        return np.asarray(out)
