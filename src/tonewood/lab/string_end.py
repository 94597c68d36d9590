"""Exact end of a stiff string, and the poles of string and body together, without modes.

The string of `physics.modal.string_modes` at complex frequency s, u = U(x) exp(s t):

    EI u'''' - T u'' + mu (s^2 + 2 sigma0 s) u = 0,   u''(0) = u(L) = u''(L) = 0,

whose solutions are sinh p (L - x) with EI p^4 - T p^2 + mu (s^2 + 2 sigma0 s) = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tonewood.lab.assembled import Matrices
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.support.arrays import Floats


@dataclass(frozen=True)
class ExactString:
    """A string held at x = L and moved at x = 0; no moment at either end.

    length : m.
    tension : N.
    linear_density : kg/m.
    bending_stiffness : N m^2.
    sigma0 : 1/s, decay rate common to all partials (viscous, proportional to mass).
    """

    length: float
    tension: float
    linear_density: float
    bending_stiffness: float = 0.0
    sigma0: float = 0.0

    @classmethod
    def tuned(cls, radius: float, length: float, freq: float, sigma0: float) -> ExactString:
        """Return a nylon string of Fabre et al. (2024), 1100 kg/m^3 and 7.4 GPa, of an ideal fundamental (Hz)."""
        mu = 1100.0 * np.pi * radius**2
        return cls(length, mu * (2 * length * freq) ** 2, mu, 7.4e9 * np.pi * radius**4 / 4, sigma0)

    @property
    def fundamental(self) -> float:
        """Hz, of the string held at both ends, without stiffness."""
        return float(np.sqrt(self.tension / self.linear_density) / (2 * self.length))

    @property
    def impedance(self) -> float:
        """Z0 = sqrt(T mu), kg/s."""
        return float(np.sqrt(self.tension * self.linear_density))

    def held_freq(self, n: int) -> float:
        """Hz, n f0 sqrt(1 + B n^2), B = pi^2 EI / (T L^2): both ends held."""
        B = np.pi**2 * self.bending_stiffness / (self.tension * self.length**2)
        return float(n * self.fundamental * np.sqrt(1 + B * n**2))

    def basis(
        self, places: Mapping[str, float] | None = None, *, freq_upper: float | None = None, n_modes: int | None = None
    ) -> ModalBasis:
        """Fixed-base modes and ramp, up to a frequency (Hz) or a number, with points at shares of the length."""
        basis = string_basis(
            self.length, self.tension, self.linear_density, self.bending_stiffness,
            lambda omega, k: 2 * self.sigma0 / omega, freq_upper=freq_upper, n_modes=n_modes,
        )  # fmt: skip
        return basis.with_places({name: share * self.length for name, share in (places or {}).items()})

    def assembled(self, n_sines: int, body: Matrices, end: Floats, pluck: float) -> tuple[Matrices, Floats]:
        """String and body put together in (sines, body dofs), and the direction of a force at a share of the length.

        Written out from the string's kinetic and potential energy, apart from `physics.modal.string_modes`; its end
        moves as the body does along `end`.
        """
        k = np.arange(1, n_sines + 1) * np.pi / self.length
        n, sines, on_body = n_sines + len(end), np.arange(n_sines), slice(n_sines, None)
        M, K = np.zeros((n, n)), np.zeros((n, n))
        M[sines, sines] = self.linear_density * self.length / 2
        M[:n_sines, on_body] = np.outer(self.linear_density / k, end)
        M[on_body, :n_sines] = M[:n_sines, on_body].T
        M[on_body, on_body] = self.linear_density * self.length / 3 * np.outer(end, end)
        K[sines, sines] = self.length / 2 * (self.tension * k**2 + self.bending_stiffness * k**4)
        K[on_body, on_body] = self.tension / self.length * np.outer(end, end)
        C = 2 * self.sigma0 * M
        for total, part in zip((M, C, K), body, strict=True):
            total[on_body, on_body] += part
        return Matrices(M, C, K), np.concatenate([np.sin(k * pluck * self.length), (1 - pluck) * end])

    def pole(self, n: int) -> complex:
        """Pole of a partial with both ends held, 1/s."""
        return complex(-self.sigma0, np.sqrt((2 * np.pi * self.held_freq(n)) ** 2 - self.sigma0**2))

    def roots(self, s: complex) -> tuple[complex, complex | None]:
        """Wavenumbers p of the travelling and of the bending wave (None without stiffness), 1/m."""
        inertia = self.linear_density * (s**2 + 2 * self.sigma0 * s)
        if self.bending_stiffness == 0:
            return complex(np.sqrt(inertia / self.tension + 0j)), None
        T, EI = self.tension, self.bending_stiffness
        large = (T + np.sqrt(T**2 - 4 * EI * inertia + 0j)) / (2 * EI)
        return complex(np.sqrt(inertia / EI / large)), complex(np.sqrt(large))

    def end_receptance(self, s: complex) -> complex:
        """Displacement of the end per unit force on it, m/N: T p coth(p L) inverted, with its bending term."""
        p, q = self.roots(s)
        if q is None:
            return complex(np.tanh(p * self.length) / (self.tension * p))
        # EI p q (p^3 coth(q L) - q^3 coth(p L)) / (p^2 - q^2), both sides multiplied by tanh(p L)
        tp, tq = np.tanh(p * self.length), np.tanh(q * self.length)
        stiffness = self.bending_stiffness * p * q * (p**3 * tp / tq - q**3) / (p**2 - q**2)
        return complex(tp / stiffness)

    def transfer(self, s: complex, x: float) -> complex:
        """u(x) / u(0) of the string driven by its end."""
        p, q = self.roots(s)
        there = self.length - x
        travelling = np.sinh(p * there) / np.sinh(p * self.length)
        if q is None:
            return complex(travelling)
        bending = np.exp(-q * x) * np.expm1(-2 * q * there) / np.expm1(-2 * q * self.length)
        return complex((p**2 * bending - q**2 * travelling) / (p**2 - q**2))


def coupled_pole(string: ExactString, body_receptance: Callable[[complex], complex], partial: int) -> complex:
    """Pole of string and body near a partial of the held string: R_string(s) + R_body(s) = 0 by Newton's method.

    body_receptance : s -> m/N at the string's end.
    partial : n, 1 for the fundamental.
    Raises ValueError : no convergence (a body resonance on top of the partial).
    """

    def total(s: complex) -> complex:
        return string.end_receptance(s) + body_receptance(s)

    s = -string.sigma0 + 2j * np.pi * string.held_freq(partial)
    for _ in range(60):
        h = 1e-6 * abs(s)
        # analytic: one central difference along the real axis serves for the complex derivative
        step = total(s) * 2 * h / (total(s + h) - total(s - h))
        s -= step
        if abs(step) < 1e-13 * abs(s):
            return complex(s)
    raise ValueError(f"no coupled pole found near partial {partial}")
