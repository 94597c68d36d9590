"""Responses of modes at points: residues, static compliance, frequency responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.support.arrays import Complexes, Floats

#: kinds of mode, see `modes`
PAIR, REAL, BLOCK = 0, 1, 2
#: frequencies times modes of a response that are computed at once: 16 bytes each
_FRF_CELLS = 500_000


@dataclass(frozen=True, eq=False)
class ModalResponses:
    """Arrays of a basis, as `ModalBasis` describes them, and the responses between its points."""

    poles: Complexes
    kind: NDArray[np.uint8]
    stiffness: Floats
    damping_rate: Floats
    points: tuple[str, ...]
    right: Complexes
    left: Complexes
    residual: Floats

    def index(self, point: str) -> int:
        """Return the row of a named point; a ValueError names the points there are."""
        try:
            return self.points.index(point)
        except ValueError:
            raise ValueError(f"no point {point!r}; there are {', '.join(self.points)}") from None

    def residues(self, point: str) -> Floats:
        """Return (n_modes,) sizes of the residues at a driving point, 1/kg: phi^2 of a mass-normalised real mode.

        Y(s) = sum A s / (s^2 + 2 sigma s + omega^2) of real modes has A = phi^2; left shapes hold -i / 2 omega_d of it.
        """
        i = self.index(point)
        gain = np.where(self.kind == PAIR, 2 * np.abs(self.poles.imag), 1.0)
        return np.asarray(np.abs(self.right[i] * self.left[i]) * gain)

    def static_of(self, modes: NDArray[np.bool_]) -> Floats:
        """Return (n_points, n_points) m/N, static compliance of some modes; rigid-body modes count as 0."""
        soft = modes & (self.stiffness > 0)
        pair, block = soft & (self.kind == PAIR), soft & (self.kind == BLOCK)
        real = soft & (self.kind == REAL)
        out = -2 * ((self.right[:, pair] / self.poles[pair]) @ self.left[:, pair].T).real
        out -= ((self.right[:, real] / self.poles[real]) @ self.left[:, real].T).real
        r, ell, k = self.right[:, block], self.left[:, block], self.stiffness[block]
        out += (r.real / k) @ (ell.real + 2 * self.damping_rate[block] * ell.imag).T - r.imag @ ell.imag.T
        return np.asarray(0.5 * (out + out.T), dtype=np.float64)

    def static_compliance(self) -> Floats:
        """Return (n_points, n_points) displacements under a constant unit force, residual included, m/N.

        Raises
        ------
        ValueError : if a rigid-body mode makes it infinite.
        """
        if np.any(self.stiffness == 0):
            raise ValueError("a component with a rigid-body mode has no static compliance")
        return self.static_of(np.ones(self.poles.size, dtype=bool)) + self.residual

    def frf(self, freq: ArrayLike, output: str, input: str, frf_form: str = "mobility") -> Complexes:
        """Return the frequency response between two points.

        Y(omega) = (i omega)^p [ sum_k r_k l_k / (i omega - lambda_k) + conj. part + R ],  p = 0, 1, 2.

        Parameters
        ----------
        freq : (n,) Hz.
        output, input : names of the point that is read, and of the one that is driven.
        frf_form : ``receptance`` (m/N), ``mobility`` ((m/s)/N) or ``accelerance`` ((m/s^2)/N).

        Returns
        -------
        (n,) complex.

        Raises
        ------
        ValueError : `frf_form` is none of these, or there is no such point.
        """
        power = {"receptance": 0, "mobility": 1, "accelerance": 2}.get(frf_form)
        if power is None:
            raise ValueError(f"frf_form is receptance, mobility or accelerance, not {frf_form!r}")
        s = np.asarray(2j * np.pi * np.atleast_1d(np.asarray(freq, dtype=np.float64)), dtype=np.complex128)
        i, j = self.index(output), self.index(input)
        total = np.empty(s.shape, dtype=np.complex128)
        rows = max(1, _FRF_CELLS // max(1, self.poles.size))
        for start in range(0, len(s), rows):
            total[start : start + rows] = self._receptance(s[start : start + rows], i, j)
        return np.asarray(total * s**power)

    def _receptance(self, s: Complexes, i: int, j: int) -> Complexes:
        """Return the displacement of point i per newton at point j at complex frequencies s.  (n,), m/N"""
        r, ell = self.right[i], self.left[j]
        total = np.full(s.shape, complex(self.residual[i, j]))
        pair, real, block = (self.kind == k for k in (PAIR, REAL, BLOCK))
        total += np.sum((r * ell)[pair] / (s[:, None] - self.poles[pair]), axis=1)
        total += np.sum(np.conj(r * ell)[pair] / (s[:, None] - np.conj(self.poles[pair])), axis=1)
        total += np.sum((r * ell)[real] / (s[:, None] - self.poles[real]), axis=1)
        sb, k, d = s[:, None], self.stiffness[block], 2 * self.damping_rate[block]
        q = (sb + d) * ell[block].imag + ell[block].real
        p = sb * ell[block].real - k * ell[block].imag
        total += np.sum((r[block].real * q + r[block].imag * p) / (sb**2 + d * sb + k), axis=1)
        return total
