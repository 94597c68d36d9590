"""Potentials over one step: one linear force for each, beside all connections, of any kinds side by side.

Each potential acts by -psi_m g along a direction g that is known before the connections answer (`potentials.base`), and
psi_m answers to the motion along g as a linear connection does:

    M psi_m = psi + g . (y_free - y) / 2 + C f / 2,      M = I + G / 2 + C K C^T / 2 >= I,

G = g . w g its own motion along g, C the gaps' motion per psi_m, f the forces of the linear connections without
potentials, K those forces per displacement of the gaps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from tonewood.physics.coupling.potentials.base import JoinedPotential, MiddleOfStep
from tonewood.physics.coupling.potentials.coordinates import ModalCoordinates, pay_from_motion
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal, PhantomShares
from tonewood.physics.coupling.system import State, System
from tonewood.physics.modal.propagator import apply
from tonewood.support.arrays import Floats

#: steps after which psi is put back to the root of its potential
RESET_STEPS = 64


@dataclass(frozen=True, eq=False)
class PotentialsOverStep:
    """Action of s potentials over one step.

    reach : (m, s) gaps per psi_m.
    self_loss : (s,) g . w g, loss of g . y+ per psi_m.
    start : (s,) psi + g . (y_free - y) / 2, sqrt(J).
    linear : (m, m) N/m, forces of the linear connections against gaps.
    modal : component slot -> index of its potential, its direction g (n_modes,), and (n_modes, 2) state per psi_m.
    shift, psi : (s,) C, J, and psi, sqrt(J), before the step.
    """

    reach: Floats
    self_loss: Floats
    start: Floats
    linear: Floats
    modal: dict[int, tuple[int, Floats, Floats]]
    shift: Floats
    psi: Floats

    @cached_property
    def matrix(self) -> Floats:
        """(s, s) of the equations of psi_m, the linear connections answering; symmetric, positive definite."""
        return np.asarray(np.diag(1 + 0.5 * self.self_loss) - 0.5 * self.reach.T @ self.linear @ self.reach)

    def mean(self, forces: Floats) -> Floats:
        """(s,) psi_m, sqrt(J), if `forces` (m,) are those of the linear connections without potentials."""
        right = self.start - 0.5 * self.reach.T @ forces
        return np.asarray(np.linalg.solve(self.matrix, right))

    def mean_under(self, forces: Floats) -> Floats:
        """(s,) psi_m, sqrt(J), if `forces` (m,) are those of all connections."""
        return np.asarray((self.start - 0.5 * self.reach.T @ forces) / (1 + 0.5 * self.self_loss))

    def answer(self, moved: Floats) -> Floats:
        """(s, k) psi_m per force of nonlinear connections, of whose gaps `moved` (k, s) are reached by psi_m."""
        return np.asarray(-0.5 * np.linalg.solve(self.matrix, moved.T)) if moved.size else moved.T

    def after(self, x: Sequence[Floats], mean: Floats) -> list[Floats]:
        """States x after the forces -psi_m g are added."""
        return [xi + self.modal[i][2] * mean[self.modal[i][0]] if i in self.modal else xi for i, xi in enumerate(x)]


@dataclass(frozen=True, eq=False)
class ActivePotential:
    """A two-way potential that is on.

    index : among the potentials of its system.
    memory : its place in the state's numbers.
    slots : of its components.
    joined : as it is stepped.
    coordinates : of each component.
    """

    index: int
    memory: slice
    slots: tuple[int, ...]
    joined: JoinedPotential
    coordinates: tuple[ModalCoordinates, ...]

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.joined.n

    @cached_property
    def places(self) -> tuple[tuple[int, ModalCoordinates, slice], ...]:
        """Slot of each component, its coordinates, and their places among all."""
        ends = pairwise([0, *np.cumsum(self.joined.sizes).tolist()])
        return tuple(zip(self.slots, self.coordinates, (slice(*pair) for pair in ends), strict=True))

    @cached_property
    def compliance(self) -> Floats:
        """(n,) displacement over a step per modal force."""
        return np.concatenate([part.compliance[: at.stop - at.start] for _, part, at in self.places])

    @cached_property
    def middle_weights(self) -> Floats:
        """(2, n) ``middle`` of `ModalCoordinates`."""
        return np.hstack([part.middle[:, : at.stop - at.start] for _, part, at in self.places])

    def middle(self, before: Floats, alone: Floats, after: Floats) -> Floats:
        """(n,) coordinates in the middle of a step from those before it, after it without any forces, and after it."""
        weights = self.middle_weights
        return np.asarray(weights[0] * (before + alone) + weights[1] * (after - alone))

    def y(self, x: Sequence[Floats] | Mapping[int, Floats]) -> Floats:
        """(..., n) coordinates of states (..., n_modes, 2) by slot."""
        parts = [part.of_state(x[slot], at.stop - at.start) for slot, part, at in self.places]
        return np.concatenate(parts, axis=-1)

    def added(self, force: Floats) -> dict[int, Floats]:
        """Slot -> state (n_modes, 2) that modal forces (n,) add over a step."""
        out = {}
        for slot, part, at in self.places:
            out[slot] = np.zeros((len(part.reading), 2))
            out[slot][: at.stop - at.start] = part.kick[: at.stop - at.start] * force[at, None]
        return out

    def energy(self, x: Sequence[Floats]) -> float:
        """Energy of its modes in states by slot, J."""
        return sum(part.energy(x[slot], at.stop - at.start) for slot, part, at in self.places)

    def pay(self, x: Sequence[Floats], cost: float) -> float:
        """Take an energy (J) from the kinetic energy of its modes in states by slot, in place; return what was paid."""
        velocities = [part.velocity[:, : at.stop - at.start] for _, part, at in self.places]
        return pay_from_motion(velocities, [x[slot] for slot in self.slots], cost)

    def stored(self, x: Sequence[Floats] | Mapping[int, Floats], rows: Floats) -> Floats:
        """(T,) J of states (T, n_modes, 2) by slot, with rows (T, memory) of the state."""
        return np.array([self.joined.stored(y, row) for y, row in zip(self.y(x), rows, strict=True)])


class PotentialSolve:
    """Steps the two-way potentials of a system that are on."""

    def __init__(self, system: System):
        self.system = system
        self.active = [active_potential(system, i) for i in system.potentials.two_way]

    def over(self, x: Sequence[Floats], free: Sequence[Floats], forces: Floats, memory: Floats) -> PotentialsOverStep:
        """Prepare a step.

        x, free : states by component slot before, and after a step without connection forces.
        forces : (m,) N, of the linear connections without potentials.
        memory : of the state.
        """
        s, count = self.system, len(self.active)
        driven = self._moved(free, forces)
        slots = [slot for p in self.active for slot in p.slots]
        alone = {slot: apply(s.compiled[slot].E, x[slot]) for slot in slots}
        ends = [(p.y(x), p.y(alone)) for p in self.active]
        middles = [p.middle(*both, p.y(driven)) for p, both in zip(self.active, ends, strict=True)]
        added: dict[int, Floats] = {}
        for p, middle in zip(self.active, middles, strict=True):
            if (fast := p.joined.fast(middle)) is not None:
                added |= p.added(fast)
        answered = driven
        if added:  # the connections answer to the fast coordinates
            answer = forces - s.solve.G @ self._gaps(added)
            answered = self._moved([f + added[i] if i in added else f for i, f in enumerate(free)], answer)
        reach = np.zeros((len(s.connections), count))
        self_loss, start, shift, psi = np.zeros((4, count))
        modal: dict[int, tuple[int, Floats, Floats]] = {}
        for q, (p, (before, alone_y), middle) in enumerate(zip(self.active, ends, middles, strict=True)):
            shift[q], psi[q] = p.joined.begin(before, memory[p.memory], partial(p.energy, x))
            answered_y = p.middle(before, alone_y, p.y(answered)) if added else middle
            g = p.joined.direction(MiddleOfStep(middle, answered_y, p.compliance, float(shift[q]), float(psi[q])))
            self_loss[q] = g @ (p.compliance * g)
            start[q] = psi[q] + 0.5 * g @ (p.y(free) - before)
            action = p.added(-g)
            reach[:, q] = self._gaps(action)
            for slot, part, at in p.places:
                direction = np.zeros(len(part.reading))
                direction[: at.stop - at.start] = g[at]
                modal[slot] = q, direction, action[slot]
        return PotentialsOverStep(reach, self_loss, start, s.solve.G, modal, shift, psi)

    def carried(
        self, after: Sequence[Floats], over: PotentialsOverStep, mean: Floats, memory: Floats, step: int
    ) -> Floats:
        """Numbers of the state after a step; resets `after` in place where the step calls for it.

        after : states by component slot after the step.
        over : result of `over` for the step, and `mean` (s,) its psi_m, sqrt(J).
        memory : of the state before the step.
        step : number of the step's end since time 0.
        """
        out = memory.copy()
        for q, p in enumerate(self.active):
            pay: Callable[[float], float] | None = partial(p.pay, after) if step % RESET_STEPS == 0 else None
            psi = float(2 * mean[q] - over.psi[q])
            shift, modes = float(over.shift[q]), partial(p.energy, after)
            out[p.memory] = p.joined.end(p.y(after), shift, psi, modes, pay)
        return out

    def energies(self, x: Sequence[Floats], memory: Floats) -> Floats:
        """(n_potentials,) V, J, of states by component slot; 0 of potentials that are off, and one-way ones."""
        out = np.zeros(len(self.system.potentials))
        for p in self.active:
            out[p.index] = p.joined.stored(p.y(x), memory[p.memory])
        return out

    def _gaps(self, added: Mapping[int, Floats]) -> Floats:
        """(m,) gaps of states by component slot, all others at rest."""
        total = np.zeros(len(self.system.connections))
        for slot, x in added.items():
            c = self.system.compiled[slot]
            total += self.system.layout.incidence[slot] @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], x)
        return total

    def _moved(self, free: Sequence[Floats], forces: Floats) -> dict[int, Floats]:
        """States of the potentials' components after connection forces (m,)."""
        s = self.system
        slots = [slot for p in self.active for slot in p.slots]
        return {i: free[i] + np.einsum("p,pmx->mx", s.layout.incidence[i].T @ forces, s.compiled[i].W) for i in slots}


class DrivenForces:
    """Forces of a system's one-way potentials that are on, sample by sample."""

    def __init__(self, system: System):
        self.on = system.potentials.one_way
        #: by potential: slot it acts on, (n_modes, 2) state added by 1 N held over a step, slots of its components
        self.targets, self.vectors, self.slots = list[int](), list[Floats](), list[tuple[int, ...]]()
        self.joined: list[PhantomShares] = []
        self.memory = [system.potentials.memory[i] for i in self.on]
        for i in self.on:
            potential = system.potentials[i]
            assert isinstance(potential, DrivenLongitudinal)
            self.targets.append(system.slot(potential.targets[0]))
            self.vectors.append(force_vector(system, potential))
            self.slots.append(tuple(system.slot(name) for name in potential.components))
            self.joined.append(system.joined(i))

    def advance(self, x: Sequence[Floats], memory: Floats) -> Floats:
        """(n_on,) N, forces over the step that begins with states x by component slot.

        memory : of the state; moved by one sample.
        """
        parts = zip(self.joined, self.slots, self.memory, strict=True)
        return np.array([joined.advance([x[i] for i in slots], memory[at]) for joined, slots, at in parts])


def cut_excess(system: System, state: State, components: Set[str]) -> None:
    """Cut the excess of psi^2 / 2 - C over V, in place, of two-way potentials whose components were moved from outside.

    components : names of those that were moved; the others keep theirs.
    """
    if not state.potentials.size:  # at rest
        return
    for index in system.potentials.two_way:
        names = system.potentials[index].components
        if not components.isdisjoint(names):
            p = active_potential(system, index)
            x = {slot: np.asarray(system.modes_of(state, name)).T for slot, name in zip(p.slots, names, strict=True)}
            state.potentials[p.memory] = p.joined.moved(p.y(x), state.potentials[p.memory])


def active_potential(system: System, index: int) -> ActivePotential:
    """A two-way potential of a system as it is stepped while it is on."""
    slots = tuple(system.slot(name) for name in system.potentials[index].components)
    coordinates = tuple(system.compiled[slot].coordinates for slot in slots)
    return ActivePotential(index, system.potentials.memory[index], slots, system.joined(index), coordinates)


def force_vector(system: System, string: DrivenLongitudinal) -> Floats:
    """(n_modes, 2) state that a longitudinal force of 1 N, held over a step, adds to the component it acts on."""
    compiled = system.compiled[system.slot(string.onto[0][0])]
    # not rows of W: a string whose transverse end is rigid makes no port of the point on which its tension acts
    points = [compiled.basis.index(point) for _, point, _ in string.onto]
    inputs = apply(compiled.response, compiled.form.B[points])
    return np.asarray(sum(share * row for (_, _, share), row in zip(string.onto, inputs, strict=True)))
