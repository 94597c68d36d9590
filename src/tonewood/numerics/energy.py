"""Energy accounting on request: what is stored where, what exciters put in, what is lost, and whether it adds up.

For every step of a run

    residual = [stored after] - [stored before] - [work of known forces] + [dissipated] - [booked].

The terms are found apart from each other: stored energy from the states, dissipation and work in closed form from the
state a step begins with and the forces over it (`energy_forms`), losses of dashpots from their laws. What changes the
energy between two steps (a string stopped, bent or joined anew) is booked by whoever does it. So the residual is
rounding, or a mistake.

Components that are driven one way (microphones) carry no energy of the instrument and are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tonewood.numerics.connections import Rigid, SpringDashpot, scaled_pinv
from tonewood.numerics.energy_forms import ComponentEnergy
from tonewood.numerics.energy_trace import EnergyTrace
from tonewood.numerics.forcing import Piece
from tonewood.numerics.passivity_storage import Storage, storage_matrix
from tonewood.numerics.system import Compiled, Injection, State, System

Floats = NDArray[np.float64]

#: steps followed at a time: bounds the memory of a long run
_CHUNK = 512


@dataclass(frozen=True, slots=True)
class KnownForce:
    """A force that exciters put on a point, as `forcing.compile_force` takes it; `label` is whose work it is."""

    label: str
    component: str
    point: str
    pieces: tuple[Piece, ...]
    time: float = 0.0
    factor: float = 1.0


@dataclass(eq=False)
class _Record:
    """What happened up to some time, J."""

    time: float
    steps: int
    stored: dict[str, float]
    supplied: dict[str, float]
    lost: dict[str, float]
    booked: dict[str, float]
    residual: float


@dataclass(eq=False)
class _Laws:
    """Connections of a system as energies: springs and dashpots one by one, residual compliance together."""

    names: tuple[str, ...]
    stiffness: Floats
    damping: Floats
    offset: Floats
    yielding: NDArray[np.intp]
    residual_stiffness: Floats

    @classmethod
    def of(cls, system: System) -> _Laws:
        laws = [c.law for c in system.connections]
        springs = [law if isinstance(law, SpringDashpot) else SpringDashpot(0.0, 0.0, law.offset) for law in laws]
        rigid = np.array([isinstance(law, Rigid) for law in laws], dtype=bool)
        yielding = np.flatnonzero(rigid & (system.solve.gamma > 0))
        residual = system.gap_matrix("residual")[np.ix_(yielding, yielding)]
        return cls(
            tuple(c.name for c in system.connections),
            np.array([s.stiffness for s in springs]),
            np.array([s.damping for s in springs]),
            np.array([s.offset for s in springs]),
            yielding,
            scaled_pinv(residual) if yielding.size else np.zeros((0, 0)),
        )

    def stored(self, gaps: Floats) -> Floats:
        """(T, m) J of gaps (T, m): k (g - b)^2 / 2, and each rigid joint's share of (g - b)^T R^+ (g - b) / 2."""
        g = gaps - self.offset
        out = 0.5 * self.stiffness * g * g
        bent = g[:, self.yielding]
        out[:, self.yielding] += 0.5 * bent * (bent @ self.residual_stiffness)
        return np.asarray(out)

    def lost(self, gaps: Floats, dt: float) -> Floats:
        """(T, m) J that dashpots take in the steps between gaps (T + 1, m)."""
        return np.asarray(self.damping * np.diff(gaps, axis=0) ** 2 / dt)


@dataclass(eq=False)
class EnergyAccount:
    """Follows the steps of a run and keeps the account.

    Parameters
    ----------
    system, state : where the account begins.
    interval : steps to one entry, counted from the beginning of each run that is followed.
    storages : storage functions of components whose modes are not real, for the points that `driven_points` and
        connections act on, ports first; by default found with `passivity_storage.storage_matrix`.
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
        self._laws = _Laws.of(self.system)
        self._start_time = self.state.sample * self.system.dt
        self._initial = self.stored(self.state)
        self._last = sum(self._initial.values())

    def stored(self, state: State) -> dict[str, float]:
        """Stored energy of a state, J, by component and by connection that can store some."""
        x = {name: np.asarray(self.system.modes_of(state, name).T, dtype=np.float64)[None] for name in self._two_way()}
        out = {name: float(self._energy_of(name).stored(x[name])[0]) for name in x}
        held = self._laws.stored(sum((self._gaps(n, x[n]) for n in x), np.zeros((1, len(self._laws.names)))))[0]
        return out | {name: float(held[j]) for j, name in enumerate(self._laws.names) if self._stores(j)}

    def exchange(self, system: System) -> None:
        """Go on with a changed system; the energy that the change puts in is to be booked."""
        self.system = system
        self._laws = _Laws.of(system)

    def book(self, label: str, amount: float) -> None:
        """Enter energy put in (J, negative if taken out) between two steps, by a bend, a stop or an impact."""
        self._booked[label] = self._booked.get(label, 0.0) + amount

    def follow(
        self,
        before: State,
        after: State,
        forces: Floats,
        injections: Sequence[Injection] = (),
        known: Sequence[KnownForce] = (),
    ) -> None:
        """Enter the steps that took `before` to `after`.

        Parameters
        ----------
        before, after : states at the two ends; `before` need not be the last `after`, if what lies between is booked.
        forces : (n, m) N, connection forces, as a stepper returned them.
        injections : what the stepper was given: the motion between the two ends is found from them anew.
        known : the forces behind the injections: their work is found from these.
        """
        x = self._states(before)
        chunk = max(_CHUNK // self.interval, 1) * self.interval
        for start in range(0, len(forces), chunk):
            part = forces[start : start + chunk]
            path = self._path(x, before.sample + start, part, injections)
            if start + chunk >= len(forces):
                for name, end in self._states(after).items():
                    path[name][-1] = end
            self._enter(before.sample + start, path, part, known)
            x = {name: states[-1] for name, states in path.items()}

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

    def _two_way(self) -> list[str]:
        return [name for name, one_way in zip(self.system.names, self.system.driven, strict=True) if not one_way]

    def _stores(self, j: int) -> bool:
        return bool(self._laws.stiffness[j] > 0 or j in self._laws.yielding)

    def _states(self, state: State) -> dict[str, Floats]:
        return {n: np.array(self.system.modes_of(state, n).T, dtype=np.float64) for n in self._two_way()}

    def _energy_of(self, name: str) -> ComponentEnergy:
        compiled = self.system.compiled[self.system.slot(name)]
        if name not in self._energies or self._energies[name][0] is not compiled:
            basis, ports = compiled.basis, self.system.ports_of(name)
            if basis.is_real:
                energy = ComponentEnergy(basis, basis.points, self.system.dt)
            else:
                points = [*ports, *(p for p in self.driven_points.get(name, ()) if p not in ports)]
                index = np.array([basis.index(p) for p in points], dtype=np.intp)
                storage = self.storages.get(name) or storage_matrix(basis.poles, basis.right[index], basis.left[index])
                energy = ComponentEnergy(basis, points, self.system.dt, storage)
            self._energies[name] = (compiled, energy)
        return self._energies[name][1]

    def _port_displacements(self, name: str, x: Floats) -> Floats:
        compiled = self.system.compiled[self.system.slot(name)]
        return np.asarray(np.einsum("pmx,tmx->tp", compiled.rows[: len(compiled.ports)], x, optimize=True))

    def _gaps(self, name: str, x: Floats) -> Floats:
        return np.asarray(self._port_displacements(name, x) @ self.system.incidence(self.system.slot(name)).T)

    def _path(
        self, start: Mapping[str, Floats], sample: int, forces: Floats, injections: Sequence[Injection]
    ) -> dict[str, Floats]:
        """States (T + 1, n_modes, 2) of every component under known connection forces."""
        names = list(start)
        slots = [self.system.slot(name) for name in names]
        compiled = [self.system.compiled[i] for i in slots]
        sizes = np.cumsum([0, *(c.basis.n_modes for c in compiled)])
        path = np.empty((len(forces) + 1, sizes[-1], 2))
        for i, (slot, c) in enumerate(zip(slots, compiled, strict=True)):
            pushed = forces @ self.system.incidence(slot)
            flat = c.W.reshape(len(c.ports), 2 * c.basis.n_modes)
            path[1:, sizes[i] : sizes[i + 1]] = (pushed @ flat).reshape(len(forces), c.basis.n_modes, 2)
            path[0, sizes[i] : sizes[i + 1]] = start[names[i]]
        for injection in injections:
            if injection.component not in start:
                continue
            i = names.index(injection.component)
            first, last = max(injection.start, sample), min(injection.stop, sample + len(forces))
            if first < last:
                values = injection.values[:, first - injection.start : last - injection.start]
                added = np.einsum("vt,vmx->tmx", values, injection.vectors)
                path[1 + first - sample : 1 + last - sample, sizes[i] : sizes[i + 1]] += added
        E = np.concatenate([c.E for c in compiled])
        e00, e01, e10, e11 = (np.ascontiguousarray(E[:, i, j]) for i in (0, 1) for j in (0, 1))
        for t in range(len(forces)):
            x, y = path[t, :, 0], path[t, :, 1]
            path[t + 1, :, 0] += e00 * x + e01 * y
            path[t + 1, :, 1] += e10 * x + e11 * y
        return {name: path[:, sizes[i] : sizes[i + 1]] for i, name in enumerate(names)}

    def _enter(self, sample: int, path: Mapping[str, Floats], forces: Floats, known: Sequence[KnownForce]) -> None:
        """Entries for the steps of one path."""
        T, dt = len(forces), self.system.dt
        stored: dict[str, Floats] = {}
        lost: dict[str, Floats] = {}
        supplied: dict[str, Floats] = {}
        gaps = np.zeros((T + 1, len(self._laws.names)))
        for name, x in path.items():
            energy = self._energy_of(name)
            stored[name] = energy.stored(x)
            gaps += self._gaps(name, x)
            pushed = forces @ self.system.incidence(self.system.slot(name))
            held = np.zeros((T, len(energy.points)))
            held[:, [energy.points.index(p) for p in self.system.ports_of(name)]] = pushed
            mine = [k for k in known if k.component == name]
            lost[name], works = _over_steps(energy, x[:-1], held, mine, sample, dt)
            for force, work in zip(mine, works, strict=True):
                supplied[force.label] = supplied.get(force.label, np.zeros(T)) + work
        held_energy, held_loss = self._laws.stored(gaps), self._laws.lost(gaps, dt)
        for j, name in enumerate(self._laws.names):
            if self._stores(j):
                stored[name] = held_energy[:, j]
            if self._laws.damping[j] > 0:
                lost[name] = held_loss[:, j]
        total = np.sum(list(stored.values()), axis=0)
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
            entry.residual = float(total[last] - self._last - into)
            self._last, self._booked = float(total[last]), {}
            self._records.append(entry)


def _over_steps(
    energy: ComponentEnergy, x: Floats, held: Floats, known: Sequence[KnownForce], sample: int, dt: float
) -> tuple[Floats, list[Floats]]:
    """Energy lost in each of T steps from states x (T, n_modes, 2), and the work of each known force.

    held: (T, n_points) N, constant over each step.
    """
    T = len(x)
    coefficients = [_by_step(force, sample, T, dt) for force in known]
    broken = np.zeros(T, dtype=bool)
    for c in coefficients:
        broken |= np.isnan(c[:, 0])
    driven = np.zeros(T, dtype=bool)
    for c in coefficients:
        driven |= np.any(c != 0.0, axis=1)
    driven &= ~broken
    lost, works = np.zeros(T), [np.zeros(T) for _ in known]
    forms = energy.forms(dt)
    quiet = ~driven & ~broken
    if quiet.any():
        lost[quiet] = energy.lost(forms, energy.start(x[quiet], held[quiet][:, :, None]))
    if driven.any():
        total = np.zeros((T, len(energy.points), 3))
        total[:, :, 0] = held
        for force, c in zip(known, coefficients, strict=True):
            total[driven, energy.points.index(force.point)] += c[driven]
        s = energy.start(x[driven], total[driven])
        lost[driven] = energy.lost(forms, s)
        for force, c, work in zip(known, coefficients, works, strict=True):
            work[driven] = np.sum(c[driven] * energy.moments(forms, s, force.point), axis=1)
    for step in np.flatnonzero(broken):
        edges = [e for force in known for e in _edges(force, sample + int(step), dt)]
        at = x[step : step + 1]
        for start, stop in pairwise(sorted({0.0, 1.0, *(e for e in edges if 0 < e < 1)})):
            parts = [_on_interval(force, sample + int(step), start, stop, dt) for force in known]
            total = np.zeros((1, len(energy.points), 3))
            total[0, :, 0] = held[step]
            for force, part in zip(known, parts, strict=True):
                total[0, energy.points.index(force.point)] += part
            forms = energy.forms((stop - start) * dt)
            s = energy.start(at, total)
            lost[step] += energy.lost(forms, s)[0]
            for force, part, work in zip(known, parts, works, strict=True):
                work[step] += float(part @ energy.moments(forms, s, force.point)[0])
            at = energy.flow(forms, s)
    return lost, works


def _edges(force: KnownForce, step: int, dt: float) -> list[float]:
    """Ends of pieces in steps from the beginning of `step`."""
    return [(force.time + t) / dt - step for p in force.pieces for t in (p.start, p.stop)]


def _by_step(force: KnownForce, sample: int, T: int, dt: float) -> Floats:
    """(T, 3) coefficients in tau of a force over each of T steps; nan where it has a breakpoint inside the step."""
    out = np.zeros((T, 3))
    for piece in force.pieces:
        begin, end = (force.time + piece.start) / dt - sample, (force.time + piece.stop) / dt - sample
        if end <= begin or end <= 0 or begin >= T:
            continue
        for edge in (begin, end):
            if 0 < edge < T and edge != np.floor(edge):
                out[int(np.floor(edge))] = np.nan
        first, last = max(int(np.ceil(begin)), 0), min(int(np.floor(end)), T)
        if first < last:
            by = (np.arange(first, last) - begin) * dt
            out[first:last, 0] += force.factor * (piece.c0 + by * (piece.c1 + by * piece.c2))
            out[first:last, 1] += force.factor * dt * (piece.c1 + 2 * by * piece.c2)
            out[first:last, 2] += force.factor * dt**2 * piece.c2
    return out


def _on_interval(force: KnownForce, step: int, start: float, stop: float, dt: float) -> Floats:
    """(3,) coefficients in tau of a force between two neighbouring breakpoints, given in shares of a step."""
    for piece in force.pieces:
        begin, end = ((force.time + t) / dt - step for t in (piece.start, piece.stop))
        if begin <= 0.5 * (start + stop) < end:
            c0, c1, c2 = piece.shifted((start - begin) * dt)
            d = (stop - start) * dt
            return force.factor * np.array([c0, c1 * d, c2 * d * d])
    return np.zeros(3)
