"""The motion between two states, found again from the forces that made it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.geometric_solve import GeometricSolve
from tonewood.coupling.system import Injection, System
from tonewood.coupling.tension import TensionShare
from tonewood.errors import NumericalError

Floats = NDArray[np.float64]

_TOLERANCE, _MAX_ITERATIONS = 1e-13, 100


def step_again(
    system: System, start: Mapping[str, Floats], sample: int, forces: Floats, injections: Sequence[Injection]
) -> tuple[dict[str, Floats], dict[str, Floats]]:
    """States of components under known connection forces, all components at once.

    Parameters
    ----------
    start : name -> (n_modes, 2) of the components to step.
    sample : absolute number of the first step.
    forces : (T, m) N, constant over each step.
    injections : what known forces add.

    Returns
    -------
    states : name -> (T + 1, n_modes, 2).
    modal_forces : name -> (T, n_modes), of rising tension and of longitudinal motion, for strings that have it.
    """
    names, T = list(start), len(forces)
    slots = [system.slot(name) for name in names]
    compiled = [system.compiled[i] for i in slots]
    sizes = np.cumsum([0, *(c.basis.n_modes for c in compiled)])
    spans = {name: slice(sizes[i], sizes[i + 1]) for i, name in enumerate(names)}
    path = np.empty((T + 1, sizes[-1], 2))
    for name, slot, c in zip(names, slots, compiled, strict=True):
        at_ports, flat = forces @ system.incidence(slot), c.W.reshape(len(c.ports), 2 * c.basis.n_modes)
        path[1:, spans[name]] = (at_ports @ flat).reshape(T, c.basis.n_modes, 2)
        path[0, spans[name]] = start[name]
    for injection in injections:
        first, last = max(injection.start, sample), min(injection.stop, sample + T)
        if injection.component in start and first < last:
            values = injection.values[:, first - injection.start : last - injection.start]
            added = np.einsum("vt,vmx->tmx", values, injection.vectors)
            path[1 + first - sample : 1 + last - sample, spans[injection.component]] += added
    E = np.concatenate([c.E for c in compiled])
    e00, e01, e10, e11 = (np.ascontiguousarray(E[:, i, j]) for i in (0, 1) for j in (0, 1))
    strings = [
        [(name, part) for name in law.components if (part := system.compiled[system.slot(name)].tension) is not None]
        for law, on in zip(system.tensions, system.tension_on, strict=True)
        if on
    ]
    modal_forces = {name: np.zeros((T, part.weights.size)) for string in strings for name, part in string}
    solve = GeometricSolve(system) if system.geometric else None
    stretched = [name for law in system.geometric for name in law.parts]
    modal_forces |= {name: np.zeros((T, system.compiled[system.slot(name)].basis.n_modes)) for name in stretched}
    for t in range(T):
        x, y = path[t, :, 0], path[t, :, 1]
        path[t + 1, :, 0] += e00 * x + e01 * y
        path[t + 1, :, 1] += e10 * x + e11 * y
        for string in strings:
            parts = [(part, path[t, spans[name]], path[t + 1, spans[name]]) for name, part in string]
            tension = _tension(parts, (sample + t) * system.dt)
            for (name, part), (_, before, free) in zip(string, parts, strict=True):
                after = part.step(before, free, np.zeros((0, *free.shape)), tension)[0]
                modal_forces[name][t] = -0.5 * tension * part.weights * part.reading * (before[:, 0] + after[:, 0])
                path[t + 1, spans[name]] = after
        if solve is not None:
            none = np.zeros((0, 2))
            earlier, later = ([p[spans[n]] if n in spans else none for n in system.names] for p in path[t : t + 2])
            force, _, found = solve.find(earlier, later, list)
            if not found:
                raise NumericalError(f"the forces of a string were not found again at {(sample + t) * system.dt:.6f} s")
            for name, held in solve.by_component(force).items():
                modal_forces[name][t] = held
            moved = solve.after(later, force)
            for name in stretched:
                path[t + 1, spans[name]] = moved[system.slot(name)]
    return {name: path[:, spans[name]] for name in names}, modal_forces


def _tension(parts: Sequence[tuple[TensionShare, Floats, Floats]], time: float) -> float:
    """Mean additional tension over one step of a string's polarizations: (part, before, free motion with forces)."""
    kappa = parts[0][0].kappa
    old = sum(part.stretch(before) for part, before, _ in parts)
    T, best = 2 * kappa * old, np.inf
    for _ in range(_MAX_ITERATIONS):
        after = [part.step(before, free, np.zeros((0, *free.shape)), T)[0] for part, before, free in parts]
        excess = T - kappa * (sum(part.stretch(a) for (part, _, _), a in zip(parts, after, strict=True)) + old)
        if abs(excess) <= _TOLERANCE * T or (abs(excess) >= best and abs(excess) <= 1e-9 * T):
            return T
        best = abs(excess)
        slope = 1 - kappa * sum(part.slope(b, a, T) for (part, b, _), a in zip(parts, after, strict=True))
        T = max(kappa * old, T - excess / slope)
    raise NumericalError(f"the tension of a string was not found again at {time:.6f} s")
