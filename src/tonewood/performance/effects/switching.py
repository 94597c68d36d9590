"""Switches of effects: their energy, paid by the motion of the strings that are switched."""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from tonewood.performance.effects.base import Moment, SwitchedEffect, Switching, Watched
from tonewood.physics.coupling.connections import Rigid
from tonewood.physics.coupling.system import State, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.motion import from_motion, to_motion
from tonewood.support.arrays import Floats

#: share of the kinetic energy that a switch may take
_PAYABLE = 0.5


def clear_memory(system: System, state: State, potentials: Collection[str]) -> None:
    """Set the numbers of these potentials in a state to zero, in place."""
    if state.potentials.size:
        for potential, memory in zip(system.potentials, system.potentials.memory, strict=True):
            if potential.name in potentials:
                state.potentials[memory] = 0.0


def switch(effect: SwitchedEffect, moment: Moment, before: Switching, watched: Watched) -> Switching:
    """Switch components on or off as wanted, where the energy of the switch can be paid; the system is not changed.

    The energy is taken from the kinetic energy of the effect's `payers`, in the moment's state. A component that cannot
    pay stays as it is, and is pending if it is to be switched on.
    """
    on = set(before.on)
    for component in effect.components:
        wants = component in watched.wanted
        if wants != (component in before.on) and pay(effect, moment, component, wants):
            (on.add if wants else on.remove)(component)
    return Switching(frozenset(on), watched.wanted - on, watched.until)


def pay(effect: SwitchedEffect, moment: Moment, component: str, on: bool) -> bool:
    """Debit the energy of a switch from kinetic energy, in the moment's state; returns whether there was enough.

    Displacements stay, and so do the velocities of points that rigid connections join: the rest v of the velocities of
    the effect's `payers`, orthogonal to these points' shapes, is scaled by sqrt(1 - cost / (v^2 / 2)). Nothing of the
    switch so reaches the body at once. (An impulse that makes joined velocities equal would be heard at -60 dB: they
    differ from sample to sample by the error of a force that is constant over a step.)
    """
    cost, system, state = effect.cost(moment, component, on), moment.system, moment.state
    if cost <= 0.0:
        return True
    motions = []
    for name in effect.payers(component):
        basis = system.compiled[system.slot(name)].basis
        q, v = motion(system, state, name)
        motions.append((name, basis, q, v, free_velocity(system, name, basis, v)))
    kinetic = sum(0.5 * float(free @ free) for *_, free in motions)
    if cost > _PAYABLE * kinetic:
        return False
    share = 1.0 - math.sqrt(1.0 - cost / kinetic)
    for name, basis, q, v, free in motions:
        system.modes_of(state, name)[:] = from_motion(basis, q, v - share * free)
    return True


def free_velocity(system: System, component: str, basis: ModalBasis, v: Floats) -> Floats:
    """Part of a component's velocities (n_modes,) that moves none of its rigidly joined points."""
    terms = (term for c in system.connections if isinstance(c.law, Rigid) for term in c.terms)
    rows = [basis.right[basis.index(term.point)].real for term in terms if term.component == component]
    rows = [row for row in rows if np.any(row)]  # a point at rest in all modes has no direction
    if not rows:
        return v
    directions, _ = np.linalg.qr(np.stack(rows).T)
    return np.asarray(v - directions @ (directions.T @ v))


def motion(system: System, state: State, component: str) -> tuple[Floats, Floats]:
    """Coordinates q and q' of a component of real modes, m sqrt(kg) and m sqrt(kg)/s."""
    basis = system.compiled[system.slot(component)].basis
    return to_motion(basis, np.asarray(system.modes_of(state, component), dtype=np.float64))
