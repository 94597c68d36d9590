"""Nonlinear laws between components: discrete forces that cannot create energy, and the solve that finds them.

Over one step the gaps of m ports move by p+ = p_u - Z F, where p_u is where they would go without the laws, Z the port
compliance over the step (symmetric, positive semi-definite), and F = phi(p+; p) the forces of the laws. Every law here
is monotone in p+, so the convex function behind p+ = p_u - Z phi(p+) has one minimum, whatever the step and the force.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import NumericalError
from tonewood.physics.coupling.connections import SpringDashpot, linear_solve
from tonewood.physics.coupling.system import Injection, State, System
from tonewood.physics.modal.propagator import apply

Floats = NDArray[np.float64]


class PortLaw(Protocol):
    """A law F(delta, delta') of one gap, made discrete so that F (p+ - p) >= V(p+) - V(p)."""

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Force (N) over a step that takes the gap from `old` to `new` (m), and its slope dF/dnew >= 0 (N/m)."""

    def continuous(self, gap: float, rate: float) -> float:
        """F(delta, delta') itself, N: the limit of the discrete force for short steps."""

    def energy(self, gap: float) -> float:
        """V(delta), J."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """F = k (delta + beta delta^3) + c delta' + d delta' |delta'|, a hardening spring with two dashpots.

    The spring force over a step is the discrete gradient (V(p+) - V(p)) / (p+ - p), here without a quotient,
    k (p+ + p)/2 [1 + beta (p+^2 + p^2)/2]; the dashpots see the mean rate (p+ - p)/dt.

    Attributes
    ----------
    stiffness : k, N/m.
    hardening : beta, 1/m^2.
    damping : c, N s/m.
    quadratic_damping : d, N s^2/m^2.
    """

    stiffness: float
    hardening: float = 0.0
    damping: float = 0.0
    quadratic_damping: float = 0.0

    def __post_init__(self) -> None:
        if min(self.stiffness, self.hardening, self.damping, self.quadratic_damping) < 0:
            raise ValueError("a mounting with a negative stiffness or damping can create energy")

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Discrete force and slope; see `PortLaw`."""
        k, b, rate = self.stiffness, self.hardening, (new - old) / dt
        total, squares = new + old, new * new + old * old
        value = 0.5 * k * total * (1 + 0.5 * b * squares)
        slope = 0.5 * k * (1 + 0.5 * b * (squares + 2 * new * total))
        value += (self.damping + self.quadratic_damping * abs(rate)) * rate
        slope += (self.damping + 2 * self.quadratic_damping * abs(rate)) / dt
        return value, slope

    def continuous(self, gap: float, rate: float) -> float:
        """F(delta, delta'), N."""
        spring = self.stiffness * gap * (1 + self.hardening * gap * gap)
        return spring + (self.damping + self.quadratic_damping * abs(rate)) * rate

    def energy(self, gap: float) -> float:
        """V = k (delta^2 / 2 + beta delta^4 / 4), J."""
        return self.stiffness * gap * gap * (0.5 + 0.25 * self.hardening * gap * gap)


@dataclass(frozen=True)
class GeneralLaw:
    """Any F(delta, delta') whose elastic part F(delta, 0) rises: its discrete gradient, and the rest at the midpoint.

    Attributes
    ----------
    law : F(gap, rate), N.
    potential : V(gap), J, with dV/dgap = F(gap, 0).
    reach : m, largest |gap|; speed : m/s, largest |rate|, on which the law is tried when it is made.

    Raises
    ------
    ValueError : within that range the potential is not that of the force, the elastic force falls, the rest of the
        force drives the motion, [F(gap, rate) - F(gap, 0)] rate < 0, or it falls as the rate grows.
    """

    law: Callable[[float, float], float]
    potential: Callable[[float], float]
    reach: float
    speed: float

    def __post_init__(self) -> None:
        gaps, rates = np.linspace(-self.reach, self.reach, 41), np.linspace(-self.speed, self.speed, 41)
        elastic = np.array([self.law(g, 0.0) for g in gaps])
        rest = np.array([[self.law(g, v) - e for v in rates] for g, e in zip(gaps, elastic, strict=True)])
        d = 1e-4 * self.reach
        slope = np.array([(self.potential(g + d) - self.potential(g - d)) / (2 * d) for g in gaps])
        size = np.abs(elastic).max()
        if np.any(np.abs(slope - elastic) > 1e-5 * size):
            raise ValueError("the force at rest is not the slope of the potential")
        if np.any(np.diff(elastic) < -1e-12 * size):
            raise ValueError("the force at rest must not fall as the gap grows")
        size = np.abs(rest).max()
        if np.any(rest * rates < -1e-12 * size * self.speed) or np.any(np.diff(rest, axis=1) < -1e-12 * size):
            raise ValueError("the part of the force that depends on the rate must oppose it, and not fall as it grows")

    def force(self, new: float, old: float, dt: float) -> tuple[float, float]:
        """Discrete force and slope; see `PortLaw`."""
        step, middle = new - old, 0.5 * (new + old)
        small = 1e-5 * self.reach
        if abs(step) > small:
            value = (self.potential(new) - self.potential(old)) / step
            slope = (self.law(new, 0.0) - value) / step
        else:
            value = self.law(middle, 0.0)
            slope = (self.law(middle + small, 0.0) - self.law(middle - small, 0.0)) / (4 * small)
        rate, tilt = step / dt, 1e-6 * self.speed
        rest = self.law(middle, rate) - self.law(middle, 0.0)
        tangent = (self.law(middle, rate + tilt) - self.law(middle, rate - tilt)) / (2 * tilt)
        return value + rest, max(slope, 0.0) + max(tangent, 0.0) / dt

    def continuous(self, gap: float, rate: float) -> float:
        """F(delta, delta'), N."""
        return self.law(gap, rate)

    def energy(self, gap: float) -> float:
        """V(delta), J."""
        return self.potential(gap)


def solve_ports(
    laws: tuple[PortLaw, ...],
    Z: Floats,
    unconstrained: Floats,
    old: Floats,
    dt: float,
    guess: Floats | None = None,
    *,
    rtol: float = 1e-12,
    max_iterations: int = 100,
) -> tuple[Floats, Floats, int]:
    """Find F with F = phi(p_u - Z F; p) by Newton's method, safeguarded by the convex energy along each step.

    Parameters
    ----------
    laws : m laws.
    Z : (m, m) m/N.
    unconstrained, old : (m,) m, p_u and p.
    guess : (m,) N, start; the forces of the step before do.
    rtol : last correction of the gaps, relative to them and to the displacement the forces make.

    Returns
    -------
    F : (m,) N.  gaps : (m,) m, p+.  iterations : of Newton's method.

    Raises
    ------
    NumericalError : no solution to that accuracy within `max_iterations`.

    Notes
    -----
    With D the slopes, s = sqrt(D) and r = phi(p) - F the step is dF = r - s (I + s Z s)^-1 s Z r: Z is never inverted
    and may be singular.
    """
    import scipy.linalg as sla

    def evaluate(force: Floats) -> tuple[Floats, Floats, Floats]:
        gaps = unconstrained - Z @ force
        pairs = [law.force(float(p), float(q), dt) for law, p, q in zip(laws, gaps, old, strict=True)]
        return gaps, np.array([f for f, _ in pairs]), np.array([d for _, d in pairs])

    F = np.zeros(len(laws)) if guess is None else guess.copy()
    gaps, phi, slope = evaluate(F)
    for iteration in range(1, max_iterations + 1):
        residual = phi - F
        s = np.sqrt(slope)
        inner = np.eye(len(laws)) + s[:, None] * Z * s
        try:
            step = residual - s * sla.solve(inner, s * (Z @ residual), assume_a="pos")
        except sla.LinAlgError as error:
            raise NumericalError(
                "a nonlinear connection is too stiff for its step: 1 / rounding is exceeded"
            ) from error
        moved = Z @ step
        start, t = float(moved @ (F - phi)), 1.0
        for _ in range(60):
            trial = F + t * step
            gaps, phi, slope = evaluate(trial)
            descent = float(moved @ (trial - phi))
            if descent < 0 or abs(descent) <= 0.9 * abs(start):
                break
            t *= 0.5
        F = trial
        scale = np.abs(unconstrained) + np.abs(Z) @ np.abs(F)
        if np.abs(moved).max(initial=0.0) <= rtol * scale.max(initial=0.0):
            return F, gaps, iteration
    raise NumericalError(
        f"the forces of {len(laws)} nonlinear connections were not found in {max_iterations} iterations"
    )


class PortStepper:
    """Steps a `System` some of whose connections have nonlinear laws; the linear ones are eliminated first.

    A connection pulls on its gap g with f = -F. Residual compliance R in series with a nonlinear law stretches by
    rho, (rho+ + rho)/2 = R f, and the law acts on g + rho.

    Parameters
    ----------
    system : its connections of the names in `laws` must have the law ``SpringDashpot()``, which does nothing.
    laws : connection name -> law.

    Raises
    ------
    ValueError : a name is unknown, or residual compliance couples nonlinear to other connections.
    """

    def __init__(self, system: System, laws: Mapping[str, PortLaw]):
        names = [c.name for c in system.connections]
        for name in laws:
            if name not in names or system.connections[names.index(name)].law != SpringDashpot():
                raise ValueError(f"no connection {name!r} with the law SpringDashpot()")
        self.system, self.laws = system, tuple(laws.values())
        self._at = np.array([names.index(name) for name in laws], dtype=np.intp)
        compliance, residual = system.gap_matrix("compliance"), system.gap_matrix("residual")
        linear = np.setdiff1d(np.arange(len(names)), self._at)
        if np.any(residual[np.ix_(self._at, linear)]):
            raise ValueError("residual compliance couples a nonlinear connection to a linear one")
        self._linear = linear_solve([c.law for c in system.connections], compliance, residual, system.dt)
        self._residual = residual[np.ix_(self._at, self._at)]
        answer = self._linear.G @ compliance[:, self._at]
        inner = compliance[np.ix_(self._at, self._at)] - compliance[self._at] @ answer
        self._compliance, self._answer = compliance, answer
        self._Z = 0.5 * (inner + inner.T) + 2 * self._residual
        #: iterations of Newton's method, all steps together
        self.iterations = 0

    def run(
        self, state: State, n: int, injections: Sequence[Injection] = (), stretch: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps, as `stepper.NumpyStepper` does.

        Parameters
        ----------
        stretch : (n_laws,) m, rho, advanced in place; only where a nonlinear port has residual compliance.

        Returns
        -------
        out : (n, n_readouts).
        forces : (n, m) N, connection forces f = -F, means over their steps.
        """
        s = self.system
        x = [s.modes_of(state, name).T.copy() for name in s.names]
        incidence = [s.incidence(i) for i in range(len(s.names))]
        ports = [len(c.ports) for c in s.compiled]
        two_way = [i for i, one_way in enumerate(s.driven) if not one_way]
        out, forces = np.zeros((n, len(s.readouts))), np.zeros((n, len(s.connections)))
        rho = np.zeros(len(self.laws)) if stretch is None else stretch
        weights, guess = s.force_weights(), -state.forces[self._at]

        def gaps() -> Floats:
            total = np.zeros(len(s.connections))
            for i in two_way:
                total += incidence[i] @ np.einsum("pmx,mx->p", s.compiled[i].rows[: ports[i]], x[i])
            return total

        for step in range(n):
            gap = gaps()
            before = [np.einsum("rmx,mx->r", c.rows[p:], xi) for c, p, xi in zip(s.compiled, ports, x, strict=True)]
            for i, compiled in enumerate(s.compiled):
                x[i] = apply(compiled.E, x[i])
            for injection in injections:
                k = state.sample + step - injection.start
                if 0 <= k < injection.values.shape[1]:
                    x[s.slot(injection.component)] += np.einsum("v,vmx->mx", injection.values[:, k], injection.vectors)
            free = gaps()
            f = self._linear.constant - self._linear.G @ (free + self._linear.gamma * gap)
            unconstrained = (free + self._compliance @ f)[self._at] - rho
            force, _, count = solve_ports(self.laws, self._Z, unconstrained, gap[self._at] + rho, s.dt, guess)
            self.iterations += count
            guess = force
            rho += -2 * self._residual @ force - 2 * rho
            f += self._answer @ force
            f[self._at] = -force
            forces[step] = f
            for i, compiled in enumerate(s.compiled):
                x[i] += np.einsum("p,pmx->mx", incidence[i].T @ f, compiled.W)
                if not np.all(np.isfinite(x[i])):
                    raise NumericalError(f"{s.names[i]} is no longer finite at {(state.sample + step) * s.dt:.6f} s")
                after = np.einsum("rmx,mx->r", compiled.rows[ports[i] :], x[i])
                np.add.at(out[step], compiled.readouts, np.where(compiled.difference, after - before[i], before[i]))
            out[step] += weights @ f
        for i, name in enumerate(s.names):
            s.modes_of(state, name)[:] = x[i].T
        if n:
            state.forces[:] = forces[-1]
        state.sample += n
        return out, forces
