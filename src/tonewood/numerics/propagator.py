"""The exact flow of modes over one step, and the exact injection of polynomial forces.

Every mode is a real 2 x 2 block x' = A x + B f, y = C x (a conjugate pair: x = (Re z, Im z)). Over a step h with the
force held constant,

    x+ = E x + W0 f,    E = exp(A h),    W0 = h phi_1(A h) B,

and for F(t) = c0 + c1 t + c2 t^2 on a piece of length d that ends d' before the step does,

    x+ += exp(A d') [ d phi_1(A d) c0 + d^2 phi_2(A d) c1 + 2 d^3 phi_3(A d) c2 ] B

with phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z, phi_0 = exp. Chinnakonda (2007) names the constant, linear and
quadratic cases P0, P1 and P2; here breakpoints may fall anywhere inside a step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.modes import BLOCK, PAIR, ModalBasis

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


def phi(order: int, z: Complexes) -> Complexes:
    """Functions phi_0 .. phi_order at complex z, shape (order + 1, *z.shape), to rounding for any z.

    Small |z| by the Taylor series of the highest and the recurrence downwards, large |z| by the recurrence upwards;
    each is used where it does not cancel.
    """
    z = np.asarray(z, dtype=np.complex128)
    out = np.empty((order + 1, *z.shape), dtype=np.complex128)
    out[0] = np.exp(z)
    if order == 0:
        return out
    small = np.abs(z) < 1.0
    zs = z[small]
    factorial = 1.0
    for k in range(2, order + 1):
        factorial *= k
    term = np.full(zs.shape, 1.0 / factorial, dtype=np.complex128)
    series = term.copy()
    for j in range(1, 22):
        term = term * zs / (order + j)
        series += term
    out[order][small] = series
    for k in range(order - 1, 0, -1):
        factorial /= k + 1
        out[k][small] = zs * out[k + 1][small] + 1.0 / factorial
    large = ~small
    zl = z[large]
    out[1][large] = np.expm1(zl) / zl
    factorial = 1.0
    for k in range(2, order + 1):
        factorial *= k - 1
        out[k][large] = (out[k - 1][large] - 1.0 / factorial) / zl
    return out


@dataclass(frozen=True, eq=False)
class RealForm:
    """A basis as real 2 x 2 blocks.

    Attributes
    ----------
    A : (n_modes, 2, 2) generators, 1/s.
    B : (n_points, n_modes, 2) what a unit force at a point does to x'.
    C : (n_points, n_modes, 2) displacement rows, m.
    """

    A: Floats
    B: Floats
    C: Floats

    def rows(self, quantity: str, points: NDArray[np.intp]) -> Floats:
        """(n, n_modes, 2) rows that read the ``displacement`` (m) or ``velocity`` (m/s) of points."""
        C = self.C[points]
        return C if quantity == "displacement" else np.einsum("imx,mxy->imy", C, self.A)


def real_form(basis: ModalBasis) -> RealForm:
    """Write each mode of `basis` as a real 2 x 2 block."""
    n = basis.n_modes
    lam, block, pair = basis.poles, basis.kind == BLOCK, basis.kind == PAIR
    A = np.empty((n, 2, 2))
    A[:, 0, 0] = np.where(block, 0.0, lam.real)
    A[:, 0, 1] = np.where(block, 1.0, -lam.imag)
    A[:, 1, 0] = np.where(block, -basis.stiffness, lam.imag)
    A[:, 1, 1] = np.where(block, -2 * basis.damping_rate, lam.real)
    weight = np.where(pair, 2.0, 1.0)
    second = np.where(block, 1.0, np.where(pair, -2.0, 0.0))
    C = np.stack([weight * basis.right.real, second * basis.right.imag], axis=-1)
    ell = np.where(block, 1j * np.conj(basis.left), basis.left)
    B = np.stack([ell.real, ell.imag], axis=-1)
    return RealForm(A, B, C)


def flow(basis: ModalBasis, dt: float, order: int = 1) -> Floats:
    """phi_0(A dt) .. phi_order(A dt) as real 2 x 2 blocks, shape (order + 1, n_modes, 2, 2); phi_0 is E itself."""
    out = np.empty((order + 1, basis.n_modes, 2, 2))
    values = phi(order, basis.poles * dt)
    out[..., 0, 0] = out[..., 1, 1] = values.real
    out[..., 0, 1], out[..., 1, 0] = -values.imag, values.imag
    block = np.flatnonzero(basis.kind == BLOCK)
    if block.size:
        out[:, block] = _block_flow(basis.stiffness[block], basis.damping_rate[block], dt, order)
    return out


def _block_flow(stiffness: Floats, damping_rate: Floats, dt: float, order: int) -> Floats:
    """Blocks of [[0, 1], [-omega^2, -2 sigma]] dt: first block row of the exponential of an augmented matrix."""
    import scipy.linalg as sla

    n, m = stiffness.size, 2 * (order + 1)
    big = np.zeros((n, m, m))
    # velocities in units of 1/dt keep the entries of one size, whatever the step
    big[:, 0, 1] = 1.0
    big[:, 1, 0] = -stiffness * dt**2
    big[:, 1, 1] = -2 * damping_rate * dt
    for k in range(order):
        big[:, 2 * k, 2 * k + 2] = big[:, 2 * k + 1, 2 * k + 3] = 1.0
    full = sla.expm(big)[:, :2, :].reshape(n, 2, order + 1, 2).transpose(2, 0, 1, 3)
    out = np.array(full)
    out[..., 0, 1] *= dt
    out[..., 1, 0] /= dt
    return out


def apply(blocks: Floats, x: Floats) -> Floats:
    """Blocks (n_modes, 2, 2) times states or inputs (..., n_modes, 2)."""
    a, b = x[..., 0], x[..., 1]
    out = np.empty(np.broadcast_shapes(blocks.shape[:-1], x.shape))
    out[..., 0] = blocks[:, 0, 0] * a + blocks[:, 0, 1] * b
    out[..., 1] = blocks[:, 1, 0] * a + blocks[:, 1, 1] * b
    return out


def polynomial_injection(
    basis: ModalBasis, B: Floats, dt: float, start: float, stop: float, coefficients: tuple[float, float, float]
) -> Floats:
    """State added over one step of length dt by F(t) = c0 + c1 (t - start) + c2 (t - start)^2 on [start, stop].

    Parameters
    ----------
    B : (n_modes, 2) input of the driven point.
    start, stop : s from the beginning of the step, 0 <= start <= stop <= dt.
    coefficients : c0 N, c1 N/s, c2 N/s^2.

    Returns
    -------
    (n_modes, 2).
    """
    d = stop - start
    if not 0.0 <= start <= stop <= dt * (1 + 1e-12):
        raise ValueError(f"piece [{start}, {stop}] s is not inside a step of {dt} s")
    if d == 0.0:
        return np.zeros_like(B)
    c0, c1, c2 = coefficients
    _, p1, p2, p3 = flow(basis, d, 3)
    added = apply(d * c0 * p1 + d**2 * c1 * p2 + 2 * d**3 * c2 * p3, B)
    return apply(flow(basis, max(dt - stop, 0.0), 0)[0], added) if stop < dt else added
