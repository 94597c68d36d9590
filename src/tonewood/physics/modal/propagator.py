"""The exact flow of modes over one step, and the exact injection of polynomial forces.

Every mode is a real 2 x 2 block x' = A x + B f, y = C x (a conjugate pair: x = (Re z, Im z)). Over a step h with the
force held constant,

    x+ = E x + W0 f,    E = exp(A h),    W0 = h phi_1(A h) B,

and for F(t) = c0 + c1 t + c2 t^2 on a piece of length d that ends d' before the step does,

    x+ += exp(A d') [ d phi_1(A d) c0 + d^2 phi_2(A d) c1 + 2 d^3 phi_3(A d) c2 ] B

with phi_k(z) = (phi_{k-1}(z) - 1/(k-1)!) / z, phi_0 = exp. Chinnakonda (2007) names the constant, linear and
quadratic cases P0, P1 and P2; here breakpoints may fall anywhere inside a step. Every such force is a sum of moments of
the piece, which know nothing of the modes, times a series of exp(A h), which knows nothing of the force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import BLOCK, PAIR, ModalBasis
from tonewood.support.arrays import Complexes, Floats


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
    small = np.abs(z) < (1.0 if order > 1 else 1e-3)
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

    A : (n_modes, 2, 2) generators, 1/s.
    B : (n_points, n_modes, 2) x' per force at a point.
    C : (n_points, n_modes, 2) displacement rows, m.
    """

    A: Floats
    B: Floats
    C: Floats

    def rows(self, quantity: str, points: NDArray[np.intp]) -> Floats:
        """(n, n_modes, 2) rows that read the ``displacement`` (m) or ``velocity`` (m/s) of points."""
        C = self.C[points]
        return C if quantity == "displacement" else np.einsum("imx,mxy->imy", C, self.A)


def real_form(basis: ModalBasis, generators: Floats | None = None) -> RealForm:
    """Write each mode of `basis` as a real 2 x 2 block; `generators` of the same modes may be given."""
    block, pair = basis.kind == BLOCK, basis.kind == PAIR
    A = _generators(basis, block) if generators is None else generators
    weight = np.where(pair, 2.0, 1.0)
    second = np.where(block, 1.0, np.where(pair, -2.0, 0.0))
    C = np.stack([weight * basis.right.real, second * basis.right.imag], axis=-1)
    ell = np.where(block, 1j * np.conj(basis.left), basis.left)
    B = np.stack([ell.real, ell.imag], axis=-1)
    return RealForm(A, B, C)


def _generators(basis: ModalBasis, block: NDArray[np.bool_]) -> Floats:
    lam, A = basis.poles, np.empty((basis.n_modes, 2, 2))
    A[:, 0, 0] = np.where(block, 0.0, lam.real)
    A[:, 0, 1] = np.where(block, 1.0, -lam.imag)
    A[:, 1, 0] = np.where(block, -basis.stiffness, lam.imag)
    A[:, 1, 1] = np.where(block, -2 * basis.damping_rate, lam.real)
    return A


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
    n, m = stiffness.size, 2 * (order + 1)
    big = np.zeros((n, m, m))
    # velocities in units of 1/dt keep the entries of one size, whatever the step
    big[:, 0, 1] = 1.0
    big[:, 1, 0] = -stiffness * dt**2
    big[:, 1, 1] = -2 * damping_rate * dt
    for k in range(order):
        big[:, 2 * k, 2 * k + 2] = big[:, 2 * k + 1, 2 * k + 3] = 1.0
    full = np.array([_exponential(a) for a in big])[:, :2, :].reshape(n, 2, order + 1, 2).transpose(2, 0, 1, 3)
    out = np.array(full)
    out[..., 0, 1] *= dt
    out[..., 1, 0] /= dt
    return out


def _exponential(a: Floats) -> Floats:
    """Exponential of a small matrix: Taylor's series of a / 2^s, of norm 1/2 at most, squared s times.

    `scipy.linalg` has one, too, but its import takes longer than all else up to a first block.
    """
    squarings = max(0, int(np.ceil(np.log2(max(float(np.abs(a).sum(axis=1).max()), 0.5)))) + 1)
    scaled, out = a / 2.0**squarings, np.eye(len(a))
    for k in range(_TAYLOR, 0, -1):
        out = np.eye(len(a)) + scaled @ out / k
    for _ in range(squarings):
        out = out @ out
    return np.asarray(out)


#: terms of Taylor's series: 0.5^19 / 19! is 2e-23
_TAYLOR = 18


def apply(blocks: Floats, x: Floats) -> Floats:
    """Blocks (n_modes, 2, 2) times states or inputs (..., n_modes, 2)."""
    a, b = x[..., 0], x[..., 1]
    out = np.empty(np.broadcast_shapes(blocks.shape[:-1], x.shape))
    out[..., 0] = blocks[:, 0, 0] * a + blocks[:, 0, 1] * b
    out[..., 1] = blocks[:, 1, 0] * a + blocks[:, 1, 1] * b
    return out


def powers(blocks: Floats, x: Floats, count: int) -> Floats:
    """(count, ..., n_modes, 2) of blocks^k x, k = 0 .. count - 1, by doubling."""
    out = np.empty((count, *x.shape))
    out[0], filled, power = x, 1, blocks
    while filled < count:
        more = min(filled, count - filled)
        out[filled : filled + more] = apply(power, out[:more])
        filled += more
        if filled < count:
            power = power @ power
    return out


#: terms of an exponential series that are exact to rounding up to |A| t = 2, to both sides of the middle of a cell
SERIES_TERMS, _CELL = 24, 4.0


def impulse_series(basis: ModalBasis, form: RealForm, point: int, dt: float) -> Floats:
    """Effect at the end of a step of impulses within it, as power series about the middles of equal cells.

    An impulse of 1 N s at the time s of the step leaves exp(A (dt - s)) B; with the middle m of the cell that s lies in

        exp(A (dt - s)) B = sum_j  ((m - s) / dt)^j / j!  (A dt)^j exp(A (dt - m)) B.

    Returns (n_cells, SERIES_TERMS, n_modes, 2) the vectors of this sum; one cell for any mode below 0.6 of the sampling
        rate.
    """
    block = basis.kind == BLOCK
    rate = np.where(block, np.sqrt(basis.stiffness) + 2 * np.abs(basis.damping_rate), np.abs(basis.poles))
    n_cells = max(1, math.ceil(dt * float(rate.max(initial=0.0)) / _CELL))
    middles = [flow(basis, dt * (1 - (c + 0.5) / n_cells), 0)[0] for c in range(n_cells)]
    starts = np.stack([apply(blocks, form.B[point]) for blocks in middles])
    return powers(form.A * dt, starts, SERIES_TERMS).swapaxes(0, 1)


#: 1 / j, j = 1 .. SERIES_TERMS - 1
_INVERSE = (1.0 / np.arange(1, SERIES_TERMS))[:, None, None, None]


def moments(begin: Floats, end: Floats, coefficients: Floats, dt: float, n_cells: int) -> Floats:
    """Integrals of ((m - s) / dt)^j / j! F(s) over parts of a step, m the middles of its cells.

    Times an `impulse_series` they are the state that the force adds over the step. By Gauss's quadrature, with as many
    nodes as make it exact.

    begin, end : (p,) s from the beginning of the step.
    coefficients : (3, p) of F(s) = c0 + c1 (s - begin) + c2 (s - begin)^2.
    Returns (p, n_cells SERIES_TERMS) N s.
    """
    nodes, weights = _gauss()
    cell = dt / n_cells
    low = np.arange(n_cells)[:, None] * cell
    a, b = (np.minimum(np.maximum(x, low), low + cell)[..., None] for x in (begin, end))
    s = a + (b - a) * nodes
    t = s - begin[:, None]
    c0, c1, c2 = coefficients[:, :, None]
    terms = np.empty((SERIES_TERMS, *s.shape))
    terms[0] = (b - a) * weights * (c0 + t * (c1 + t * c2))
    terms[1:] = (low[..., None] + 0.5 * cell - s) / dt * _INVERSE
    np.multiply.accumulate(terms, axis=0, out=terms)
    return np.asarray(terms.sum(axis=-1).transpose(2, 1, 0).reshape(len(begin), -1))


@cache
def _gauss() -> tuple[Floats, Floats]:
    """Nodes and weights on [0, 1], exact for the last term of a series times a parabola (Golub & Welsch 1969)."""
    k = np.arange(1, SERIES_TERMS // 2 + 1)
    nodes, vectors = np.linalg.eigh(np.diag(k / np.sqrt(4.0 * k**2 - 1.0), -1))  # of the lower triangle
    return (nodes + 1) / 2, vectors[0] ** 2
