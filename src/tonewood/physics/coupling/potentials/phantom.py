"""Phantom partials: motion along a string, driven one way by the square of its transverse slopes.

A transverse motion of slopes v_x stretches a string by v_x^2 / 2 (sum over both planes). With both ends held along the
string, x from the bridge,

    v_x^2 / 2 = sum_n s_n cos(n pi x / L),      mu u_tt = EA (u_x + v_x^2 / 2)_x - loss,

drives the longitudinal modes n, of W_n = n pi / L sqrt(EA / mu), and the strain at the bridge is the sum of

    e_n = s_n + a_n,     a_n'' + 2 d_n a_n' + W_n^2 a_n = -W_n^2 s_n,     e_0 = s_0

(Bank & Sujbert, J. Acoust. Soc. Am. 117 (2005) 2268, Eqs 5-8, 13). Partials i and j of the string give s_n their sums
and differences of frequencies, f_i + f_j where i + j = n and f_i - f_j where i - j = n: Conklin's phantom partials,
loud near a longitudinal mode. EA sum e_n acts on the body.

One way: the transverse motion does not feel the longitudinal one, nor that a tension rises (`potentials.longitudinal`
and `potentials.tension` step these). Terms of the fourth order in the motion are so left out, and the force puts energy
into the body that no string loses; `energy.account` enters this work under the string's name.

The slopes are those of the modes below `freq_coupled`. With the bridge end free, mode k of an ideal string has the
slope sin((k - 1/2) pi x / L), and s_n is a sum over pairs of modes n places apart and of pairs with j + k = n + 1.
Bending stiffness adds other pairs, which are left out: s_n of random motions of a piano's A0 is within 1 % of that of
all pairs for n = 0, 3 % for n <= 5 and 6 % for n = 15. The force acts 16 samples late, a block of the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, cast

import numpy as np

from tonewood.physics.coupling.potentials.base import Kind, Potential
from tonewood.physics.coupling.potentials.longitudinal import MORE_COSINES, cosine_products, cosine_slopes
from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.support.arrays import Floats

#: samples by which the force is late
DELAY = 16
#: longitudinal modes of a string at most
MOST_MODES = 32
#: numbers of a string in a state: forces that are due; a_n and a_n' of every mode
MEMORY = DELAY + 2 * MOST_MODES


@dataclass(frozen=True, eq=False)
class DrivenLongitudinal(Potential):
    """A string whose longitudinal modes are driven one way.

    Attributes
    ----------
    name : of the string.
    components : its polarizations, made by `string_modes.string_basis`.
    onto : (component, point, share), ...: points on which the tension at the bridge acts, times the share; all of one
        component.
    axial_stiffness : EA, N.
    freq_coupled : Hz, transverse modes below it drive; longitudinal modes up to twice as high are stepped.
    loss : loss factor of the longitudinal modes, 2 d_n / W_n.
    """

    name: str
    components: tuple[str, ...]
    onto: tuple[tuple[str, str, float], ...]
    axial_stiffness: float
    freq_coupled: float
    loss: float
    one_way: ClassVar[bool] = True
    memory: ClassVar[int] = MEMORY
    effect: ClassVar[str] = "phantom_partials"  # type: ignore[misc]  # of this kind always

    def __post_init__(self) -> None:
        if not (self.axial_stiffness > 0.0 and self.freq_coupled > 0.0 and 0.0 <= self.loss < 2.0 and self.components):
            raise ValueError(
                f"{self.name}: a stretched string needs components, EA and a frequency above 0, a loss factor below 2"
            )
        if len({component for component, _, _ in self.onto}) != 1:
            raise ValueError(f"{self.name}: its longitudinal force acts on points of one component")

    @property
    def targets(self) -> tuple[str, ...]:
        """The component that it acts on."""
        return (self.onto[0][0],)

    def share(self, component: str, basis: ModalBasis, dt: float) -> PhantomShare:
        """Return the arrays of one polarization.

        Raises
        ------
        ValueError : the component was not made by `string_basis`.
        """
        vec, wavenumber, length = cosine_slopes(self.name, component, basis)
        density = cast(float, basis.metadata["linear_density"])
        first = np.pi / length * np.sqrt(self.axial_stiffness / density)
        top = min(4 * np.pi * self.freq_coupled, 0.9 * np.pi / dt)
        order = int(np.clip(top / first, 1, MOST_MODES))
        n = int(np.searchsorted(basis.natural_freq, self.freq_coupled))
        wavenumber = wavenumber[: n + 1 + MORE_COSINES]
        slopes = wavenumber[:, None] * vec[: len(wavenumber), :n]
        reading = np.where(basis.kind == PAIR, 2.0, 1.0)[:n]
        weights, mirrored = np.zeros((order + 1, n)), np.zeros((order + 1, order))
        for m in range(order + 1):
            products = cosine_products(m, len(slopes)) @ slopes
            near = np.arange(max(n - m, 0))
            weights[m, near] = np.einsum("ij,ij->j", slopes[:, near], products[:, near + m])
            weights[m, near] *= reading[near] * reading[near + m] * (1.0 if m else 0.5)
            pair = np.arange(m)[(np.arange(m) < n) & (m - 1 - np.arange(m) < n)]
            mirrored[m, pair] = 0.5 * np.einsum("ij,ij->j", slopes[:, pair], products[:, m - 1 - pair])
            mirrored[m, pair] *= reading[pair] * reading[m - 1 - pair]
        freq_rad = first * np.arange(1, order + 1)
        return PhantomShare(weights, mirrored, steps_of(freq_rad, 0.5 * self.loss * freq_rad, dt))

    def join(self, shares: Sequence[PhantomShare]) -> PhantomShares:
        """Return the string of all its polarizations."""
        return PhantomShares(tuple(shares), self.axial_stiffness)


@dataclass(frozen=True, eq=False)
class PhantomShare:
    """One polarization's share, over n modes and P longitudinal ones.

    weights : (P + 1, n) s_m = sum_k weights[m, k] x_k x_(k + m) + ..., x the first numbers of the modes.
    mirrored : (P + 1, P) ... + sum_(k < m) mirrored[m, k] x_k x_(m - 1 - k).
    steps : (P, 6) from e_n and a_n' before a step to e_n and a_n' after it, s_n being held: row by row; then to e_n in
        its middle.
    """

    weights: Floats
    mirrored: Floats
    steps: Floats

    def squares(self, x: Floats) -> Floats:
        """(P + 1,) s_m of a state (n_modes, 2)."""
        n, out = self.weights.shape[1], np.zeros(len(self.weights))
        first = x[:n, 0]
        for m in range(len(out)):
            count = max(n - m, 0)
            out[m] = (self.weights[m, :count] * first[:count]) @ first[m:]
            pair = np.arange(m)[(np.arange(m) < n) & (m - 1 - np.arange(m) < n)]
            out[m] += (self.mirrored[m, pair] * first[pair]) @ first[m - 1 - pair]
        return out


@dataclass(frozen=True, eq=False)
class PhantomShares:
    """The polarizations of a string and its longitudinal modes, as they are stepped."""

    shares: tuple[PhantomShare, ...]
    axial_stiffness: float

    def advance(self, states: Sequence[Floats], row: Floats) -> float:
        """Return the force (N) over the step that begins with states (n_modes, 2) of the polarizations.

        row : (MEMORY,) of the state; moved by one sample. Its a_n belong to the time half a sample before that of the
            states: s_n is held from half a sample before to half a sample after the time at which it is read. In slow
            motion a_n is nearly -s_n. If s_n were held from the time at which it is read on, the error of
            e_n = s_n + a_n would be of the first order in dt.
        """
        steps = self.shares[0].steps
        order = len(steps)
        s = sum((p.squares(x) for p, x in zip(self.shares, states, strict=True)), np.zeros(order + 1))
        a, moving = row[DELAY : DELAY + order], row[DELAY + MOST_MODES : DELAY + MOST_MODES + order]
        e, force = a + s[1:], float(row[0])
        row[: DELAY - 1] = row[1:DELAY].copy()
        row[DELAY - 1] = self.axial_stiffness * (s[0] + (steps[:, 4] * e + steps[:, 5] * moving).sum())
        a[:], moving[:] = steps[:, 0] * e + steps[:, 1] * moving - s[1:], steps[:, 2] * e + steps[:, 3] * moving
        return force

    def describe(self) -> dict[str, Any]:
        """Return what the kernel is loaded with, as `JoinedPotential.describe`."""
        parts = [{"weights": part.weights, "mirrored": part.mirrored} for part in self.shares]
        return {"kind": Kind.PHANTOM, "scale": self.axial_stiffness, "steps": self.shares[0].steps, "parts": parts}


def steps_of(freq_rad: Floats, damping_rate: Floats, dt: float) -> Floats:
    """(P, 6) propagator of e and e' of oscillators over a step, row by row, and of e over half a step."""
    damped = np.sqrt(freq_rad**2 - damping_rate**2)

    def rows(time: float) -> Floats:
        c, s = np.cos(damped * time), np.sin(damped * time) / damped
        decay = np.exp(-damping_rate * time)
        return np.asarray(decay * np.array([c + damping_rate * s, s, -(freq_rad**2) * s, c - damping_rate * s]))

    return np.concatenate([rows(dt), rows(0.5 * dt)[:2]]).T.copy()
