"""The motion between two states, found again from the forces that made it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.physics.coupling.potentials.solve import DrivenForces, PotentialSolve
from tonewood.physics.coupling.system import Injection, System
from tonewood.support.arrays import Floats


@dataclass(frozen=True, eq=False)
class Path:
    """T steps of the two-way components.

    states : name -> (T + 1, n_modes, 2).
    modal_forces : name -> (T, n_modes), of potentials, for components that have one.
    memory : (T + 1, size) numbers of the potentials in the state.
    driven : (T, n_on) N, forces of one-way potentials, over each step.
    """

    states: dict[str, Floats]
    modal_forces: dict[str, Floats]
    memory: Floats
    driven: Floats


def step_again(
    system: System,
    start: Mapping[str, Floats],
    memory: Floats,
    sample: int,
    forces: Floats,
    injections: Sequence[Injection],
) -> Path:
    """Step the two-way components under known connection forces.

    start : name -> (n_modes, 2).
    memory : numbers of the potentials at the start, as in the state.
    sample : absolute number of the first step.
    forces : (T, m) N, constant over each step.
    injections : state that known forces add.
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
        at_ports, flat = forces @ system.layout.incidence[slot], c.W.reshape(len(c.ports), 2 * c.basis.n_modes)
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

    solve, driven = PotentialSolve(system), DrivenForces(system)
    memories, forces_of = np.tile(system.potentials.checked(memory), (T + 1, 1)), np.zeros((T, len(driven.on)))
    slots_on = sorted(slot for p in solve.active for slot in p.slots)
    modal_forces = {system.names[i]: np.zeros((T, system.compiled[i].basis.n_modes)) for i in slots_on}
    for t in range(T):
        x, y = path[t, :, 0], path[t, :, 1]
        path[t + 1, :, 0] += e00 * x + e01 * y
        path[t + 1, :, 1] += e10 * x + e11 * y
        before, free = by_slot(path[t]), by_slot(path[t + 1])
        memories[t + 1] = memories[t]
        if driven.on:
            forces_of[t] = driven.advance(before, memories[t + 1])
            for slot, vector, force in zip(driven.targets, driven.vectors, forces_of[t], strict=True):
                free[slot] += force * vector  # a view of the path
        if solve.active:
            linear = system.solve
            alone = linear.constant - linear.apply(system.gaps(free) + linear.gamma * system.gaps(before))
            over = solve.over(before, free, alone, memories[t])
            mean = over.mean_under(forces[t])
        path[t + 1] += forced[t]
        if solve.active:
            for slot, (q, direction, added) in over.modal.items():
                modal_forces[system.names[slot]][t] = -direction * mean[q]
                free[slot] += added * mean[q]
            memories[t + 1] = solve.carried(free, over, mean, memories[t + 1], sample + t + 1)
    return Path({name: path[:, spans[name]] for name in names}, modal_forces, memories, forces_of)
