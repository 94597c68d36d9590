"""The motion between two states, found again from the forces that made it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.geometric_solve import rising_solve
from tonewood.physics.coupling.phantom_solve import PhantomForces
from tonewood.physics.coupling.system import Injection, System

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Path:
    """T steps of the two-way components.

    Attributes
    ----------
    states : name -> (T + 1, n_modes, 2).
    modal_forces : name -> (T, n_modes), of rising tension and of longitudinal motion, for strings that have it.
    tension : (T + 1, n_tensions, 4) rows of the state.
    phantoms : (T, n_on) N, longitudinal forces of strings that are driven one way, over each step.
    memory : of these forces after the last step, as in the state.
    """

    states: dict[str, Floats]
    modal_forces: dict[str, Floats]
    tension: Floats
    phantoms: Floats
    memory: Floats


def step_again(
    system: System,
    start: Mapping[str, Floats],
    tension: Floats,
    sample: int,
    forces: Floats,
    injections: Sequence[Injection],
    memory: Floats,
) -> Path:
    """Step the two-way components under known connection forces.

    Parameters
    ----------
    start : name -> (n_modes, 2).
    tension : (n_tensions, 4) of the state at the start.
    sample : absolute number of the first step.
    forces : (T, m) N, constant over each step.
    injections : state that known forces add.
    memory : (n_strings, MEMORY) of the longitudinal forces at the start, as in the state.
    """
    names, T = list(start), len(forces)
    slots = [system.slot(name) for name in names]
    compiled = [system.compiled[i] for i in slots]
    sizes = np.cumsum([0, *(c.basis.n_modes for c in compiled)])
    spans = {name: slice(sizes[i], sizes[i + 1]) for i, name in enumerate(names)}
    path = np.empty((T + 1, sizes[-1], 2))
    forced = np.empty((T, sizes[-1], 2))
    path[1:], path[0] = 0.0, np.concatenate([start[name] for name in names])
    for name, slot, c in zip(names, slots, compiled, strict=True):
        at_ports, flat = forces @ system.incidence(slot), c.W.reshape(len(c.ports), 2 * c.basis.n_modes)
        forced[:, spans[name]] = (at_ports @ flat).reshape(T, c.basis.n_modes, 2)
    for injection in injections:
        first, last = max(injection.start, sample), min(injection.stop, sample + T)
        if injection.component in start and first < last:
            values = injection.values[:, first - injection.start : last - injection.start]
            added = np.einsum("vt,vmx->tmx", values, injection.vectors)
            path[1 + first - sample : 1 + last - sample, spans[injection.component]] += added
    E = np.concatenate([c.E for c in compiled])
    e00, e01, e10, e11 = (np.ascontiguousarray(E[:, i, j]) for i in (0, 1) for j in (0, 1))
    none = np.zeros((0, 2))

    def by_slot(at: Floats) -> list[Floats]:
        return [at[spans[name]] if name in spans else none for name in system.names]

    rising = rising_solve(system)
    tensions = np.zeros((T + 1, len(system.rising), 4))
    if tension.size:
        tensions[0] = tension
    slots_on = sorted(slot for string in rising.slots for slot in string) if rising else []
    driven = PhantomForces(system)
    memory, phantoms = memory.copy(), np.zeros((T, len(driven.on)))
    modal_forces = {system.names[i]: np.zeros((T, system.compiled[i].basis.n_modes)) for i in slots_on}
    for t in range(T):
        x, y = path[t, :, 0], path[t, :, 1]
        path[t + 1, :, 0] += e00 * x + e01 * y
        path[t + 1, :, 1] += e10 * x + e11 * y
        before, free = by_slot(path[t]), by_slot(path[t + 1])
        if driven.on:
            phantoms[t] = driven.advance(before, memory)
            for slot, vector, force in zip(driven.targets, driven.vectors, phantoms[t], strict=True):
                free[slot] += force * vector  # a view of the path
        if rising is not None:
            linear = system.solve
            alone = linear.constant - linear.apply(system.gaps(free) + linear.gamma * system.gaps(before))
            over = rising.over(before, free, alone, tensions[t])
            mean = over.mean_under(forces[t])
        path[t + 1] += forced[t]
        if rising is not None:
            for slot, (q, direction, added) in over.modal.items():
                modal_forces[system.names[slot]][t] = -direction * mean[q]
                free[slot] += added * mean[q]
            tensions[t + 1] = rising.carried(before, free, over, mean, tensions[t], sample + t + 1)
    return Path({name: path[:, spans[name]] for name in names}, modal_forces, tensions, phantoms, memory)
