"""Methods of the literature as arrays for one compiled loop: rows read, state kept, columns of forces.

    f_n = -(G r_n + K f_(n-1)),   every mode moves on under f_n, f_(n-1), ...,   r_(n+1) is read from the new state

The rules of the loop (``src/kernel/lab/methods.hpp``) are the exact flow of a mode, Adams-Bashforth 3, velocity Verlet
and Newmark's family. Methods of one rule differ in their arrays: by the level at which the constraint is
asked for (position, velocity, acceleration), and how a force is continued within and across steps. Forces that come
from accelerations are known at t_n only; the interpolatory updates of Chinnakonda (2007) then take the last one, two or
three of them (P0, P1, P2), and the quadrature rules evaluate them at their nodes, explicitly.

`Scheme.poles` gives the poles that a method puts in place of the true ones, from its m x m characteristic matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.linalg as sla

from tonewood.lab.methods.problem import Problem, inverses, product, through
from tonewood.lab.methods.scheme import Scheme
from tonewood.lab.newmark import Newmark
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.modal.propagator import apply
from tonewood.support.arrays import Floats

# ---- methods on the exact flow ----


def _flow_scheme(
    problem: Problem, dt: float, scatter: list[list[Floats]], reads: Floats, G: list[Floats],
    K: list[Floats] | None = None, *, begin: Callable[[Floats], tuple[Floats, Floats]] | None = None,
    ahead: Floats | None = None, shift: Floats | None = None,
) -> Scheme:  # fmt: skip
    """scatter: by phase and lag (m, n, 2).  ahead: (m, n, 2) that forces add to the state read out, first phase."""
    m, phases, lags = len(G[0]), len(scatter), len(scatter[0])
    out_memory = np.zeros((phases, len(problem.out), m))
    if ahead is not None:
        out_memory[0] = product(problem.out, ahead)

    def motion(numbers: Floats) -> Floats:
        x = numbers.T
        if shift is None:
            return x.copy()
        # the state lacks the kick of the force it leads to
        return np.asarray(x + np.einsum("m,mnx->nx", -G[0] @ np.einsum("mnx,nx->m", reads, x), shift))

    return Scheme(
        problem=problem,
        dt=dt,
        rule="flow",
        coef=np.ascontiguousarray(problem.flow(dt, 0)[0].reshape(-1, 4).T),
        scatter=np.array(scatter).swapaxes(1, 2),
        reads=reads,
        outs=problem.out,
        G=np.array(G),
        K=np.zeros((phases, m, m)) if K is None else np.array(K),
        out_memory=out_memory,
        constants=(),
        begin=begin or (lambda x: (x.T.copy(), np.zeros((lags, m)))),
        motion=motion,
    )


def held_position(problem: Problem, dt: float) -> Scheme:
    """The scheme of this project, a sweep per sample: force held over the step, gap zero at its end."""
    E, phi1 = problem.flow(dt)
    solve = problem.system(dt).solve
    reads = through(problem.C, E) + solve.gamma[:, None, None] * problem.C
    return _flow_scheme(problem, dt, [[dt * apply(phi1, problem.B)]], reads, [solve.G])


def held_velocity(problem: Problem, dt: float) -> Scheme:
    """Force held over the step, gap at rest at its end."""
    E, phi1 = problem.flow(dt)
    CA, W = through(problem.C, problem.A), dt * apply(phi1, problem.B)
    return _flow_scheme(problem, dt, [[W]], through(CA, E), [scaled_pinv(product(CA, W))])


def linear_position(problem: Problem, dt: float) -> Scheme:
    """Force linear in time over the step, gap zero at its end. Unstable at any step: one of the traps."""
    E, phi1, phi2 = problem.flow(dt, 2)
    new, old = dt * apply(phi2, problem.B), dt * apply(phi1 - phi2, problem.B)
    G = scaled_pinv(product(problem.C, new))
    return _flow_scheme(problem, dt, [[new, old]], through(problem.C, E), [G], [G @ product(problem.C, old)])


def _past_forces(problem: Problem, x: Floats, dt: float, lags: int) -> Floats:
    """(lags, m) forces one, two, ... steps ago of a free motion, by its Taylor series to second order."""
    first = problem.rate(x)
    second = problem.rate(first)
    ago = [x - k * dt * first + (k * dt) ** 2 / 2 * second for k in range(1, lags + 1)]
    return -np.array([problem.S @ np.einsum("mnx,nx->m", problem.CA2, y) for y in ago]).reshape(lags, len(problem.S))


def interpolated(problem: Problem, dt: float, degree: int) -> Scheme:
    """Force from the acceleration constraint at t_n and `degree` steps before it, continued over the step: P0, P1, P2.

    Newton's backward differences: f(t_n + s h) = f_n + s df_n + s (s + 1)/2 ddf_n, carried exactly by phi-functions.
    """
    _, phi1, phi2, phi3 = problem.flow(dt, 3)
    terms = [phi1, phi2, phi3 + 0.5 * phi2]
    weights = [
        sum((terms[k] * (-1.0) ** lag * _BINOMIAL[k][lag] for k in range(lag, degree + 1)), np.zeros_like(phi1))
        for lag in range(degree + 1)
    ]
    scatter = [dt * apply(w, problem.B) for w in weights]

    def begin(x: Floats) -> tuple[Floats, Floats]:
        # the latest comes first: at the first step it is shifted by one
        return x.T.copy(), _past_forces(problem, x, dt, degree + 1)

    return _flow_scheme(problem, dt, [scatter], problem.CA2, [problem.S], begin=begin)


_BINOMIAL = ((1.0,), (1.0, 1.0), (1.0, 2.0, 1.0))


def _through_kick(problem: Problem, kick: Floats) -> Floats:
    """(m, m) G of a force that is right after its own kick: f = -S C A^2 (s + kick f)  =>  f = -G C A^2 s."""
    return np.asarray(sla.solve(np.eye(len(problem.S)) + problem.S @ product(problem.CA2, kick), problem.S))


def _before_kick(problem: Problem, kick: Floats) -> Callable[[Floats], tuple[Floats, Floats]]:
    """State x -> numbers of x without the kick of its force."""

    def begin(x: Floats) -> tuple[Floats, Floats]:
        f = -problem.S @ np.einsum("mnx,nx->m", problem.CA2, x)
        return (x - np.einsum("m,mnx->nx", f, kick)).T.copy(), np.zeros((1, len(f)))

    return begin


def trapezoidal(problem: Problem, dt: float) -> Scheme:
    """Trapezoidal rule for the integral of exp(A (h - t)) B f(t); the state is kept just before the kick of f_n."""
    E = problem.flow(dt, 0)[0]
    kick = 0.5 * dt * problem.B
    G = _through_kick(problem, kick)
    return _flow_scheme(
        problem, dt, [[dt * apply(E, problem.B)]], problem.CA2, [G], begin=_before_kick(problem, kick), shift=kick
    )


def simpson(problem: Problem, dt: float) -> Scheme:
    """Simpson's rule over two steps; its middle state, where the force is asked for, by the trapezoidal rule."""
    E = problem.flow(dt, 0)[0]
    kick, turned = dt / 3 * problem.B, apply(E, problem.B)
    # share of the force before in the middle state beyond the share that is kept: 1/2 instead of 1/3
    missing = dt / 6 * turned
    G = [_through_kick(problem, kick), _through_kick(problem, 0.5 * dt * problem.B)]
    K = G[1] @ product(problem.CA2, missing)
    return _flow_scheme(
        problem, dt, [[2 * dt / 3 * turned], [4 * dt / 3 * turned]], problem.CA2, G, [np.zeros_like(K), K],
        begin=_before_kick(problem, kick), ahead=missing, shift=kick,
    )  # fmt: skip


# ---- other rules, of one sample and one force a step ----


def _plain_scheme(
    problem: Problem, dt: float, rule: str, coef: Floats, scatter: Floats, reads: Floats, outs: Floats, G: Floats,
    constants: tuple[float, ...], begin: Callable[[Floats], Floats], motion: Callable[[Floats], Floats],
) -> Scheme:  # fmt: skip
    """scatter, reads, outs: (., n, .) of the rule's numbers; begin: state -> numbers."""
    m = len(G)
    return Scheme(
        problem=problem,
        dt=dt,
        rule=rule,
        coef=coef,
        scatter=scatter[None, :, None],
        reads=reads,
        outs=outs,
        G=G[None],
        K=np.zeros((1, m, m)),
        out_memory=np.zeros((1, len(outs), m)),
        constants=constants,
        begin=lambda x: (begin(x), np.zeros((1, m))),
        motion=motion,
    )


def adams_bashforth(problem: Problem, dt: float) -> Scheme:
    """Adams-Bashforth 3 on Udwadia and Kalaba's equation in complex modes (Fabre et al. 2024, Eq. 26)."""

    def begin(x: Floats) -> Floats:
        rate = problem.rate(x)
        second, third = problem.rate(rate), problem.rate(problem.rate(rate))
        past = [rate - ago * second + ago**2 / 2 * third for ago in (dt, 2 * dt)]
        return np.concatenate([x.T, past[0].T, past[1].T])

    def motion(numbers: Floats) -> Floats:
        return numbers[:2].T.copy()

    coef, constants = np.ascontiguousarray(problem.A.reshape(-1, 4).T), (23 * dt / 12, -16 * dt / 12, 5 * dt / 12)
    return _plain_scheme(
        problem, dt, "adams_bashforth", coef, problem.B, problem.CA2, problem.out, problem.S, constants, begin, motion
    )


def verlet(problem: Problem, dt: float) -> Scheme:
    """Velocity Verlet with the constraint on accelerations, real modes (Antunes & Debut 2017)."""
    r = problem.real
    G = scaled_pinv(r.gaps @ r.gaps.T)
    back = inverses(r.read)

    def begin(x: Floats) -> Floats:
        q, v = apply(r.read, x).T
        g = -r.omega2 * q - 2 * r.sigma * v
        a = g - r.gaps.T @ (G @ (r.gaps @ g))
        return np.stack([q, v - 0.5 * dt * a, g])

    def motion(numbers: Floats) -> Floats:
        q, w, g = numbers
        a = g - r.gaps.T @ (G @ (r.gaps @ g))
        return apply(back, np.stack([q, w + 0.5 * dt * a], axis=-1))

    coef, gaps, outs = np.stack([r.omega2, 2 * r.sigma]), r.gaps[..., None], r.outs[..., None]
    return _plain_scheme(problem, dt, "verlet", coef, gaps, gaps, outs, G, (dt, 0.5 * dt), begin, motion)


def newmark(problem: Problem, dt: float, method: Newmark) -> Scheme:
    """Newmark's family and HHT-alpha (Hilber, Hughes & Taylor 1977), real modes, gaps without acceleration."""
    r = problem.real
    w, b, g = 1 + method.alpha, method.beta, method.gamma
    loss, stiff = 2 * r.sigma * dt, r.omega2 * dt**2
    lead = 1 + w * g * loss + w * b * stiff
    p = dt**2 * r.gaps / lead
    G = scaled_pinv(r.gaps @ p.T)
    back = inverses(r.read)

    def begin(x: Floats) -> Floats:
        q, v = apply(r.read, x).T
        a = -r.omega2 * q - 2 * r.sigma * v
        a -= r.gaps.T @ (scaled_pinv(r.gaps @ r.gaps.T) @ (r.gaps @ a))
        return np.stack([q, dt * v, dt**2 * a])

    def motion(numbers: Floats) -> Floats:
        return apply(back, np.stack([numbers[0], numbers[1] / dt], axis=-1))

    coef = np.stack([-stiff, -loss - w * stiff, -w * (1 - g) * loss - w * (0.5 - b) * stiff]) / lead
    gaps, outs, constants = r.gaps[..., None], r.outs[..., None], (0.5 - b, b, 1 - g, g)
    return _plain_scheme(problem, dt, "newmark", coef, p[..., None], gaps, outs, G, constants, begin, motion)
