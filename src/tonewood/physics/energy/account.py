"""Energy accounting on request: stored energy by place, work of exciters, losses, and whether they add up.

For every step of a run

    residual = [stored after] - [stored before] - [work of known forces] + [dissipated] - [booked].

The terms are computed independently: stored energy from the states, dissipation and work in closed form from the
state a step begins with and the forces over it (`physics.energy.forms`), losses of connections from their laws
(`physics.energy.laws`). Whoever changes the energy between two steps (a string stopped, bent or joined anew) books
the change. A residual above rounding is therefore an error.

Components that are driven one way (microphones) carry no energy of the instrument and are left out. Sound has
an entry ``COMPONENT.sound`` of its own where a basis says which share of each mode's loss is radiated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.potentials.solve import PotentialSolve
from tonewood.physics.coupling.system import Compiled, Injection, PrescribedMotion, State, System
from tonewood.physics.energy.forms import ComponentEnergy
from tonewood.physics.energy.laws import LawEnergies
from tonewood.physics.energy.path import Path, step_again
from tonewood.physics.energy.steps import KnownForce, over_steps
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.physics.passivity.storage import Storage, storage_matrix
from tonewood.physics.stepping.forcing import controlled
from tonewood.support.arrays import Floats

__all__ = ["EnergyAccount", "EnergyTrace", "KnownForce"]


#: steps followed at a time: bounds the memory of a long run
_CHUNK = 512


@dataclass(eq=False)
class _Record:
    """Energies entered up to some time, J."""

    time: float
    steps: int
    stored: dict[str, float]
    supplied: dict[str, float]
    lost: dict[str, float]
    booked: dict[str, float]
    residual: float


@dataclass(eq=False)
class EnergyAccount:
    """Follows the steps of a run and keeps the account.

    system, state : where the account begins.
    interval : steps to one entry, counted from the beginning of each run that is followed.
    storages : storage functions of components whose modes are not real, for the points that connections and
        `driven_points` act on, ports first; by default found with `physics.passivity.storage.storage_matrix`.
    driven_points : component -> further points that known forces may act on; real modes need none named.
    """

    system: System
    state: State
    interval: int = 64
    storages: Mapping[str, Storage] = field(default_factory=dict)
    driven_points: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._energies: dict[str, tuple[Compiled, ComponentEnergy]] = {}
        self._records: list[_Record] = []
        self._booked: dict[str, float] = {}
        self._laws = LawEnergies(self.system)
        self._initial = self.stored(self.state)
        self._last = dict(self._initial)
        #: stored energy after the changes made since the last step
        self._changed = dict(self._initial)

    def stored(self, state: State) -> dict[str, float]:
        """Stored energy of a state, J, by component, connection and potential."""
        x = {name: modes[None] for name, modes in self._states(state).items()}
        memory = self.system.potentials.checked(state.potentials)
        out = {name: float(values[0]) for name, values in self._of_components(x, memory[None]).items()}
        return out | self._laws.at(self._gaps(x)[0], state.series)

    def exchange(self, system: System) -> None:
        """Go on with a changed system; the energy that the change puts in is to be booked."""
        self.system = system
        self._laws = LawEnergies(system)

    def book(self, label: str, amount: float) -> None:
        """Enter energy put in (J, negative if taken out) between two steps, by a bend, a stop or an impact."""
        self._booked[label] = self._booked.get(label, 0.0) + amount

    def book_change(self, label: str, state: State) -> None:
        """Book the energy that a change between two steps put in: stored energy of this state, less that before."""
        now = self.stored(state)
        self.book(label, sum(now.values()) - sum(self._changed.values()))
        self._changed = now

    def follow(
        self,
        before: State,
        after: State,
        forces: Floats,
        injections: Sequence[Injection] = (),
        known: Sequence[KnownForce] = (),
        controls: Sequence[PrescribedMotion] = (),
    ) -> None:
        """Enter the steps that took `before` to `after`.

        Parameters
        ----------
        before, after : states at the two ends; `before` need not be the last `after`, if the changes between are
            booked.
        forces : (n, m) N, connection forces, as a stepper returned them.
        injections, controls : as the stepper was given them: the motion between the two ends is found from them anew.
        known : the forces behind the injections: their work is found from these.

        The motion is made again from the forces. Where potentials act, its rounding errors grow within some hundred
        steps: follow pieces of 64 there, and of 16 with longitudinal motion.
        """
        x, series, memory = self._states(before), before.series, before.potentials
        chunk = max(_CHUNK // self.interval, 1) * self.interval
        for start in range(0, len(forces), chunk):
            part, sample = forces[start : start + chunk], before.sample + start
            again = step_again(self.system, x, memory, sample, part, injections)
            path = again.states
            if start + chunk >= len(forces):
                for name, end in self._states(after).items():
                    path[name][-1] = end
                if after.potentials.size:
                    again.memory[-1] = after.potentials
            within = self._laws.series(series, part)
            moving = controlled(self.system, controls, sample, len(part)) if controls else {}
            self._enter(sample, again, within, part, known, moving)
            x, series = {name: states[-1] for name, states in path.items()}, self._laws.spread(within[-1])
            memory = again.memory[-1]

    def trace(self) -> EnergyTrace:
        """The account so far."""
        records = self._records

        def table(which: str) -> dict[str, Floats]:
            names = dict.fromkeys(name for r in records for name in getattr(r, which))
            return {name: np.array([getattr(r, which).get(name, 0.0) for r in records]) for name in names}

        return EnergyTrace(
            time=np.array([r.time for r in records]),
            steps=np.array([r.steps for r in records], dtype=np.int64),
            dt=self.system.dt,
            initial=dict(self._initial),
            stored=table("stored"),
            supplied=table("supplied"),
            booked=table("booked"),
            lost=table("lost"),
            residual=np.array([r.residual for r in records]),
        )

    def _states(self, state: State) -> dict[str, Floats]:
        two_way = (n for n, one_way in zip(self.system.names, self.system.layout.driven, strict=True) if not one_way)
        return {n: np.array(self.system.modes_of(state, n).T, dtype=np.float64) for n in two_way}

    def _energy_of(self, name: str) -> ComponentEnergy:
        compiled = self.system.compiled[self.system.slot(name)]
        if name not in self._energies or self._energies[name][0] is not compiled:
            basis, ports = compiled.basis, self.system.layout.ports[name]
            if basis.is_real:
                energy = ComponentEnergy(basis, basis.points, self.system.dt)
            else:
                driven = (p for p in self.system.potentials if isinstance(p, DrivenLongitudinal))
                onto = [at for p in driven for component, at, _ in p.onto if component == name]
                points = list(dict.fromkeys([*ports, *self.driven_points.get(name, ()), *onto]))
                index = np.array([basis.index(p) for p in points], dtype=np.intp)
                storage = self.storages.get(name) or storage_matrix(basis.poles, basis.right[index], basis.left[index])
                energy = ComponentEnergy(basis, points, self.system.dt, storage)
            self._energies[name] = (compiled, energy)
        return self._energies[name][1]

    def _of_components(self, path: Mapping[str, Floats], memory: Floats) -> dict[str, Floats]:
        """Stored energy (T,) of components and of the potentials that are on; `memory` (T, size) as in the state."""
        out = {name: self._energy_of(name).stored(x) for name, x in path.items()}
        for p in PotentialSolve(self.system).active:
            potential = self.system.potentials[p.index]
            x = {slot: path[name] for slot, name in zip(p.slots, potential.components, strict=True)}
            out[f"{potential.name}.{potential.label}"] = p.stored(x, memory[:, p.memory])
        return out

    def _driven(self, component: str, again: Path) -> Iterator[tuple[str, str, Floats]]:
        """Yield label, point and force (T,) of one-way potentials that act on a component."""
        on = (self.system.potentials[i] for i in self.system.potentials.one_way)
        for string, force in zip(on, again.driven.T, strict=True):
            assert isinstance(string, DrivenLongitudinal)
            for name, point, share in string.onto:
                if name == component:
                    yield f"{string.name} longitudinal", point, share * force

    def _gaps(self, path: Mapping[str, Floats]) -> Floats:
        """(T, m) gaps of all connections."""
        total: Floats = np.zeros((1, len(self.system.connections)))
        for name, x in path.items():
            slot = self.system.slot(name)
            compiled = self.system.compiled[slot]
            ports = np.einsum("pmx,tmx->tp", compiled.rows[: len(compiled.ports)], x, optimize=True)
            total = total + ports @ self.system.layout.incidence[slot].T
        return total

    def _enter(
        self,
        sample: int,
        again: Path,
        series: Floats,
        forces: Floats,
        inputs: Sequence[KnownForce],
        moving: Mapping[int, Floats],
    ) -> None:
        """Entries for the steps of one path."""
        T, dt, path, modal_forces = len(forces), self.system.dt, again.states, again.modal_forces
        stored, flows = (
            self._of_components(path, again.memory),
            self._laws.over(self._gaps(path), series, forces, moving),
        )
        lost, supplied = dict(flows.lost), dict(flows.supplied)
        for name, x in path.items():
            energy = self._energy_of(name)
            port_forces = np.zeros((T, len(energy.points)))
            ports = [energy.points.index(p) for p in self.system.layout.ports[name]]
            port_forces[:, ports] = forces @ self.system.layout.incidence[self.system.slot(name)]
            for label, point, tension in self._driven(name, again):
                column = energy.points.index(point)
                port_forces[:, column] += tension
                compiled = self.system.compiled[self.system.slot(name)]
                moved = np.diff(np.einsum("mx,tmx->t", compiled.form.C[compiled.basis.index(point)], x))
                supplied[label] = supplied.get(label, np.zeros(T)) + tension * moved
            mine = [k for k in inputs if k.component == name]
            lost[name], sound, works = over_steps(energy, x[:-1], port_forces, modal_forces.get(name), mine, sample, dt)
            if energy.radiated is not None:
                lost[name], lost[f"{name}.sound"] = lost[name] - sound, sound
            for force, work in zip(mine, works, strict=True):
                supplied[force.label] = supplied.get(force.label, np.zeros(T)) + work
        stored |= flows.stored
        for name in self._laws.moved(moving):
            # a partner may have been moved at once since the last step
            supplied[name][0] += stored[name][0] - self._changed.get(name, 0.0)
        total, last_total = np.sum(list(stored.values()), axis=0), sum(self._last.values())
        for first in range(0, T, self.interval):
            last = min(first + self.interval, T)
            entry = _Record(
                time=(sample + last) * dt,
                steps=last - first,
                stored={n: float(v[last]) for n, v in stored.items()},
                supplied={n: float(v[first:last].sum()) for n, v in supplied.items()},
                lost={n: float(v[first:last].sum()) for n, v in lost.items()},
                booked=self._booked,
                residual=0.0,
            )
            into = sum(entry.supplied.values()) + sum(entry.booked.values()) - sum(entry.lost.values())
            entry.residual = float(total[last] - last_total - into)
            last_total, self._booked = float(total[last]), {}
            self._last = self._changed = entry.stored
            self._records.append(entry)
