"""Updates of modes under a force known at points in time (Chinnakonda 2007, chapter 2), each stating its order.

A force that is interpolated between nodes t_i of a step H by Lagrange polynomials of degree p and carried through the
exact flow gives (Eqs. 2.16-2.20; P0, P1, P2 for p = 0, 1, 2)

    x+ = E x + sum_i W_i B f(t_i),    W_i = sum_j C_ij j! H phi_(j+1)(A H),    L_i(s) = sum_j C_ij (s/H)^j.

The quadrature rules of Newton and Cotes interpolate the whole integrand instead (Eqs. 2.21-2.23; the trapezoidal rule
and Simpson's for p = 1, 2): W_i = H b_i E(H - t_i). Both kinds know of the force at t_i only. Nodes lie on the samples,
one update spanning p of them, or p + 1 lie within every step, the force being asked for in between.

With uniform nodes the error of a smooth motion falls with the step as h^(p+1), and as h^(p+2) for even p >= 2, whose
error term is odd about the middle: `order`. With uneven nodes even p loses that: `order_uneven`. Both hold where
|lambda| h is small. Where it is large, the interpolatory updates follow the static response lambda^-1 f, with an error
of order p, and the thesis' figures for heavy damping lie between the two (see `estimates`). Printed: I_2 in the
thesis lacks "+2" in its first bracket; its weights W_1..W_3 are right, and so are these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply, flow, real_form
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Update:
    """One way to advance modes over a step.

    name : short.
    degree : p of the polynomial.
    weighted : the force alone is interpolated, and carried exactly; otherwise force times exponential (quadrature).
    within : nodes inside every step rather than on p + 1 successive samples.
    """

    name: str
    degree: int
    weighted: bool
    within: bool = False

    def __post_init__(self) -> None:
        if self.degree < 0 or (self.degree == 0 and not self.weighted):
            raise ValueError("the degree is 0 or more, and 1 or more for a quadrature rule")

    @property
    def order(self) -> int:
        """Stated order in h of a motion under a smooth force, uniform nodes, |lambda| h small."""
        even = self.degree > 0 and self.degree % 2 == 0
        return self.degree + (2 if even else 1)

    @property
    def order_uneven(self) -> int:
        """Stated order in h with uneven nodes."""
        return self.order if self.within else self.degree + 1

    @property
    def span(self) -> int:
        """Samples that one update advances."""
        return 1 if self.within else max(self.degree, 1)

    def nodes(self, times: Floats) -> Floats:
        """Times at which an update over `times` (span + 1 of them, s) asks for the force."""
        if self.degree == 0:
            return times[:1]
        return np.linspace(times[0], times[-1], self.degree + 1) if self.within else times

    def weights(self, basis: ModalBasis, step: float, nodes: ArrayLike) -> Floats:
        """(n_nodes, n_modes, 2, 2) W_i for nodes at fractions of a step of H s."""
        c = np.asarray(nodes, dtype=np.float64)
        L = lagrange(c)
        if self.weighted:
            phi = flow(basis, step, c.size)
            moments = np.array([factorial(j) * step * phi[j + 1] for j in range(c.size)])
            return np.asarray(np.einsum("ij,jmxy->imxy", L, moments))
        share = L @ (1 / np.arange(1, c.size + 1))
        return np.array([step * b * flow(basis, step * (1 - x), 0)[0] for b, x in zip(share, c, strict=True)])


def lagrange(nodes: Floats) -> Floats:
    """(n, n) C_ij with L_i(s) = sum_j C_ij s^j, L_i(nodes[k]) = delta_ik."""
    out = np.zeros((nodes.size,) * 2)
    for i, x in enumerate(nodes):
        others = np.delete(nodes, i)
        out[i] = np.atleast_1d(np.poly(others))[::-1] / np.prod(x - others)
    return out


P0 = Update("P0", 0, True)
P1 = Update("P1", 1, True)
P2 = Update("P2", 2, True)
P2_MIDSTEP = Update("P2 mid-step", 2, True, within=True)
TRAPEZOIDAL = Update("trapezoidal", 1, False)
SIMPSON = Update("Simpson", 2, False)
SIMPSON_MIDSTEP = Update("Simpson mid-step", 2, False, within=True)


def interpolatory(degree: int, *, within: bool = False) -> Update:
    """Weighted update of any degree, P3, P4, ..."""
    return Update(f"P{degree}" + (" mid-step" if within else ""), degree, True, within)


def quadrature(degree: int, *, within: bool = False) -> Update:
    """Newton-Cotes update of any degree."""
    return Update(f"Newton-Cotes {degree}" + (" mid-step" if within else ""), degree, False, within)


#: every update that is held to its stated order
UPDATES = (
    P0, P1, P2, P2_MIDSTEP, TRAPEZOIDAL, SIMPSON, SIMPSON_MIDSTEP,
    interpolatory(3), interpolatory(4), interpolatory(5), interpolatory(3, within=True), interpolatory(4, within=True),
    quadrature(3), quadrature(4), quadrature(4, within=True),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Response:
    """A motion at the ends of the updates.

    times : (n,) s.  state : (n, n_modes, 2).  displacement, velocity : (n, n_points) m, m/s, at all points.
    """

    times: Floats
    state: Floats
    displacement: Floats
    velocity: Floats


def respond(
    update: Update,
    basis: ModalBasis,
    forces: Mapping[str, Callable[[Floats], ArrayLike]],
    times: ArrayLike,
    start: Floats | None = None,
) -> Response:
    """Drive a component from `start` through `times`.

    update : how.
    basis : any modes: under-, critically and over-damped, repeated, rigid-body.
    forces : point -> F(t), N, asked for at arrays of times.
    times : (n,) s, rising, in steps of any length; times that do not fill a last update are left out.
    start : (n_modes, 2) state, rest if left out (see `synthesis.initial_state`).
    """
    t = np.asarray(times, dtype=np.float64)
    if t.ndim != 1 or t.size < 2 or np.any(np.diff(t) <= 0):
        raise ValueError("sample times must rise")
    form = real_form(basis)
    B = np.array([form.B[basis.index(point)] for point in forces]).reshape(len(forces), basis.n_modes, 2)
    ends = np.arange(0, t.size, update.span)
    state = np.zeros((ends.size, basis.n_modes, 2))
    if start is not None:
        state[0] = start
    cache: dict[tuple[float, ...], tuple[Floats, Floats]] = {}
    for k, (a, b) in enumerate(pairwise(ends)):
        window = t[a : b + 1]
        step = window[-1] - window[0]
        nodes = update.nodes(window)
        fractions = (nodes - window[0]) / step
        # equal steps differ by the rounding of their times: the first of them stands for all
        key = (float(f"{step:.11g}"), *np.round(fractions, 10))
        if key not in cache:
            W = update.weights(basis, float(step), fractions)
            cache[key] = flow(basis, float(step), 0)[0], np.einsum("imxy,fmy->ifmx", W, B)
        E, injected = cache[key]
        values = np.array([np.broadcast_to(force(nodes), nodes.shape) for force in forces.values()])
        state[k + 1] = apply(E, state[k]) + np.einsum("ifmx,fi->mx", injected, values.reshape(len(forces), nodes.size))
    every = np.arange(len(basis.points))
    return Response(
        t[ends],
        state,
        np.einsum("pmx,kmx->kp", form.C, state),
        np.einsum("pmx,kmx->kp", form.rows("velocity", every), state),
    )
