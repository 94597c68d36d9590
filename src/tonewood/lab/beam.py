"""A simply supported Euler-Bernoulli beam: finite elements, its modes, and its driving point in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.lab.assembled import Matrices
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Beam:
    """Length m, mass per length kg/m, bending stiffness EI N m^2; pinned at both ends, undamped."""

    length: float
    linear_density: float
    bending_stiffness: float

    def natural_freq_rad(self, n_modes: int) -> Floats:
        """(n_modes,) omega_n = (n pi / L)^2 sqrt(EI / rho A), rad/s (Klosner & Ranlet 1978, problem C)."""
        wave = np.arange(1, n_modes + 1) * np.pi / self.length
        return np.asarray(wave**2 * np.sqrt(self.bending_stiffness / self.linear_density))

    def midspan_shapes(self, n_modes: int) -> Floats:
        """(n_modes,) sin(n pi / 2) over the root of the modal mass rho A L / 2, 1/sqrt(kg)."""
        mass = 0.5 * self.linear_density * self.length
        return np.asarray(np.sin(np.arange(1, n_modes + 1) * np.pi / 2) / np.sqrt(mass))

    def midspan_receptance(self, omega: float) -> float:
        """Displacement per force at the middle at omega, m/N: L^3 (tan(z/2) - tanh(z/2)) / (4 EI z^3), z = beta L."""
        z = self.length * (self.linear_density * omega**2 / self.bending_stiffness) ** 0.25
        bend = np.tan(z / 2) - np.tanh(z / 2)
        return float(self.length**3 * bend / (4 * self.bending_stiffness * z**3))

    def elements(self, n: int) -> tuple[Matrices, Floats]:
        """Matrices of n equal cubic elements (n even), and the direction (n_dof,) of the middle's deflection.

        Dofs: rotation of the left end, deflection and rotation of every inner node, rotation of the right end.
        """
        if n % 2:
            raise ValueError("the middle of the beam must be a node: take an even number of elements")
        a = self.length / n
        stiff = self.bending_stiffness / a**3 * np.array([
            [12, 6 * a, -12, 6 * a], [6 * a, 4 * a**2, -6 * a, 2 * a**2],
            [-12, -6 * a, 12, -6 * a], [6 * a, 2 * a**2, -6 * a, 4 * a**2],
        ])  # fmt: skip
        mass = self.linear_density * a / 420 * np.array([
            [156, 22 * a, 54, -13 * a], [22 * a, 4 * a**2, 13 * a, -3 * a**2],
            [54, 13 * a, 156, -22 * a], [-13 * a, -3 * a**2, -22 * a, 4 * a**2],
        ])  # fmt: skip
        M, K = np.zeros((2 * n + 2,) * 2), np.zeros((2 * n + 2,) * 2)
        for i in range(n):
            where = np.ix_(range(2 * i, 2 * i + 4), range(2 * i, 2 * i + 4))
            M[where] += mass
            K[where] += stiff
        free = np.delete(np.arange(2 * n + 2), [0, 2 * n])
        middle = np.zeros(2 * n + 2)
        middle[n] = 1.0
        M, K = M[np.ix_(free, free)], K[np.ix_(free, free)]
        return Matrices(M, np.zeros_like(M), K), middle[free]
