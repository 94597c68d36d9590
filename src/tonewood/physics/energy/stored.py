"""Energy stored in a system of real modes: a step can only lower it unless something outside does work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tonewood.physics.coupling.connections import Rigid, SpringDashpot
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.laws import PotentialLaw
from tonewood.physics.coupling.potentials.solve import PotentialSolve
from tonewood.physics.coupling.system import State, System
from tonewood.physics.stepping.motion import to_motion
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class Energy:
    """Joules.

    modes : kinetic and potential energy of all two-way components.
    potentials : psi^2 / 2 - C of the potentials that are on: V but for the error of the steps; may be negative.
    connections : of springs and nonlinear potentials.
    residual : of residual compliance, of rigid joints and in series with nonlinear laws.
    """

    modes: float
    potentials: float
    connections: float
    residual: float

    @property
    def total(self) -> float:
        """All of it."""
        return self.modes + self.potentials + self.connections + self.residual


def gaps(system: System, state: State) -> Floats:
    """(m,) m, gaps of all connections, without the residual compliance in series with nonlinear ones."""
    return system.gaps(_states(system, state))


def stored_energy(system: System, state: State) -> Energy:
    """Stored energy of a state.

    Raises ValueError : a two-way component's modes are not real: their energy is not theirs alone to tell.
    """
    modes = springs = 0.0
    for slot, (name, compiled) in enumerate(zip(system.names, system.compiled, strict=True)):
        if system.layout.driven[slot]:
            continue
        if not compiled.basis.is_real:
            raise ValueError(f"the modes of {name} are not real")
        x = np.asarray(system.modes_of(state, name), dtype=np.float64)
        q, velocity = to_motion(compiled.basis, x)
        modes += 0.5 * float(np.sum(velocity**2 + compiled.basis.stiffness * q**2))
    states = _states(system, state)
    memory = system.potentials.checked(state.potentials)
    potentials = float(np.sum(PotentialSolve(system).energies(states, memory)))
    gap = system.gaps(states)
    laws = [c.law for c in system.connections]
    rigid = np.array([isinstance(law, Rigid) for law in laws], dtype=bool)
    offset = np.array([law.offset for law in laws])
    R = system.elimination.gap.residual[np.ix_(rigid, rigid)]
    bent = (gap - offset)[rigid]
    residual = 0.5 * float(bent @ scaled_pinv(R) @ bent) if R.any() else 0.0
    for j, law in enumerate(laws):
        if isinstance(law, SpringDashpot):
            spring = system.elimination.springs_in_series.get(j, law)
            springs += 0.5 * spring.stiffness * float(gap[j] - spring.offset) ** 2
    if system.nonlinear is not None:
        on = system.nonlinear.index
        series = state.series[on] if state.series.size else np.zeros(len(on))
        for nonlinear, g in zip(system.nonlinear.laws, gap[on] + series, strict=True):
            if isinstance(nonlinear, PotentialLaw):
                springs += nonlinear.energy(float(nonlinear.offset - g))
        residual += 0.5 * float(series @ scaled_pinv(system.nonlinear.residual) @ series)
    return Energy(modes, potentials, springs, residual)


def _states(system: System, state: State) -> list[Floats]:
    return [np.asarray(system.modes_of(state, name), dtype=np.float64).T for name in system.names]
