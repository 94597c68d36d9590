"""The C++ kernel behind the same interface as `stepper.NumpyStepper`.

The instruction set is chosen when the module is imported: the widest this machine has, or the one named by the
environment variable ``TONEWOOD_ISA``. For the same arrays, one build and one instruction set, results are
bit-identical, also where a run is cut at multiples of 64 samples.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr

from tonewood import _kernel
from tonewood.coupling.connections import NonlinearGaps
from tonewood.coupling.laws import (
    CompiledPotential,
    Contact,
    Friction,
    HardeningSpring,
    NonlinearLaw,
    SampledPotential,
    Scalar,
)
from tonewood.coupling.system import Compiled, Control, Injection, State, System
from tonewood.errors import NumericalError, TonewoodError
from tonewood.stepping.stepper import NumpyStepper, Statistics

Floats = NDArray[np.float64]
_NONE = np.zeros(0, dtype=np.intp)
#: samples, at multiples of which a run may be cut without changing a bit
_CUT = 64
#: nonlinear connection, component, port among its fixed or its guarded ones, whether it is guarded, factor
Term = tuple[int, int, int, bool, float]
#: slot of a component, whether laws other than contacts push it, and how connections use it
_Key = tuple[int, bool, bytes]


def instruction_set() -> str:
    """Name of the instruction set in use: avx512, avx2 or baseline."""
    available: list[str] = _kernel.instruction_sets()
    wanted = os.environ.get("TONEWOOD_ISA", "auto")
    if wanted == "auto":
        return available[0]
    if wanted not in available:
        raise TonewoodError(f"TONEWOOD_ISA={wanted}: this machine has auto, {', '.join(available)}")
    return wanted


def compiler() -> str:
    """Name and version of the compiler that built the kernel: another one may fuse other products and sums."""
    return _kernel.COMPILER


@dataclass(frozen=True, slots=True, eq=False)
class _Wires:
    """How connections use a component: its ports that are always stepped, those only contacts act on, and where.

    `incidence` (n_linear, n_fixed) is that of the linear connections; `coupled`: to a motion along its string; `key`
    tells whether any of it changed.
    """

    fixed: NDArray[np.intp]
    guarded: NDArray[np.intp]
    incidence: Floats
    coupled: bool
    key: bytes


class KernelStepper:
    """Steps a `System` in C++.

    Parameters
    ----------
    system : what to step.
    isa : instruction set, by default `instruction_set()`.
    guarded : leave contacts out while a bound says that they touch nothing; the results are the same bit for bit.
    """

    def __init__(self, system: System, *, isa: str | None = None, guarded: bool = True):
        n_components, capacity = len(system.names), sum(system.capacities)
        self._kernel = _kernel.Kernel(isa or instruction_set(), n_components, capacity, len(system.readouts))
        self._packed: dict[int, tuple[Injection, Floats, Floats]] = {}
        self._ready: WeakKeyDictionary[Compiled, dict[_Key, tuple[int, tuple[Any, ...], tuple[Floats, ...]]]]
        self._ready, self._numbers = WeakKeyDictionary(), count()
        self._seen: tuple[Sequence[Compiled], Sequence[_Wires]] = (), ()
        self._loaded: list[tuple[Compiled, bytes, int] | None] = [None] * len(system.names)
        self._wirings: dict[tuple[bytes, bytes, bytes, frozenset[str]], tuple[list[_Wires], list[Term]]] = {}
        self._guarded, self._steps, self._redone, self._failures = guarded, 0, 0, 0
        self._slow: NumpyStepper | None = None
        self._law_forces, self._acted = np.zeros(0), list[int]()  # the former is kept at zero between runs
        self._nonlinear = self._active = _NONE
        self._laws: tuple[NonlinearLaw, ...] = ()
        self._terms: Sequence[Term] = ()
        self._along: list[list[int]] = []
        self._gaps: tuple[NonlinearGaps, bytes] | None = None
        self.system = system
        self._load(system)

    def exchange(self, system: System) -> None:
        """Go on with a changed system: same components and connections, other bases or laws."""
        self.system = system
        self._load(system)

    @property
    def statistics(self) -> Statistics:
        """What the nonlinear solves took, since this stepper was made."""
        solves, iterations, most, _, tension, most_tension, *_ = self._kernel.statistics()
        return Statistics(self._steps, solves, iterations, most, tension, most_tension, self._failures, self._redone)

    @property
    def n_solves(self) -> int:
        """How many steps asked for nonlinear forces so far."""
        return int(self._kernel.statistics()[0])

    @property
    def guard_statistics(self) -> dict[str, int]:
        """How contacts were left out.

        Blocks stepped with nonlinear connections, rows of contacts read in them, contacts woken inside a block;
        windows of 64 samples begun by strings that may touch something, and those in which nothing could.
        """
        return dict(
            zip(("blocks", "rows_read", "woken", "windows", "calm"), self._kernel.statistics()[6:], strict=True)
        )

    def _load(self, system: System) -> None:
        nonlinear, solve = system.nonlinear, system.solve
        self._nonlinear = _NONE if nonlinear is None else nonlinear.index
        self._active = on = solve.on
        wiring, terms = self._wired(system)
        fresh = self._load_components(system, wiring, terms)
        along = [[system.slot(name) for name in law.parts] for law in system.geometric]
        if along != self._along or fresh & {slot for slots in along for slot in slots}:
            self._along = along
            self._kernel.set_geometric([_geometric(system, slots, wiring) for slots in along])
        weights = system.force_weights()
        self._kernel.set_solve(
            solve.inverse, solve.gamma[on], solve.inverse @ solve.offset[on], weights.take(on, axis=1)
        )
        self._load_laws(system, terms, weights)
        if system.tensions:
            self._kernel.set_tensions(
                [
                    (t, part.kappa, [system.slot(name) for name in string.components])
                    for t, string in enumerate(system.tensions)
                    if system.tension_on[t] and (part := system.compiled[system.slot(string.components[0])].tension)
                ],
                solve.matrix,
                solve.offset[on],
            )

    def _load_laws(self, system: System, terms: Sequence[Term], weights: Floats) -> None:
        """Load what has changed of the nonlinear connections: which there are, their laws, what they give way by."""
        laws: tuple[NonlinearLaw, ...] = () if system.nonlinear is None else system.nonlinear.laws
        gaps = None if system.nonlinear is None else system.nonlinear.gaps
        before, self._laws = self._laws, laws
        if terms is not self._terms or len(laws) != len(before):
            theta = 0.5 if gaps is None else gaps.laws.theta
            heard = np.ascontiguousarray(weights[:, self._nonlinear])
            self._kernel.set_nonlinear(len(laws), terms, system.dt, theta, self._guarded, heard)
            self._terms, self._gaps, before = terms, None, ()
        old = before or (None,) * len(laws)
        if others := [(j, _law(law)) for j, (law, was) in enumerate(zip(laws, old, strict=True)) if law is not was]:
            self._kernel.set_laws(others)
        key = self._active.tobytes()
        if gaps is not None and (self._gaps is None or self._gaps[0] is not gaps or self._gaps[1] != key):
            self._gaps = gaps, key
            from_linear, to_linear = gaps.from_linear[:, self._active], gaps.to_linear[self._active]
            self._kernel.set_gaps(
                *(np.ascontiguousarray(a) for a in (gaps.compliance, from_linear, to_linear, gaps.residual))
            )

    def _load_components(self, system: System, wiring: Sequence[_Wires], terms: Sequence[Term]) -> set[int]:
        """Load those that are others, or used otherwise, than before; returns their slots."""
        fresh: set[int] = set()
        pushed = {slot for _, slot, _, on_guarded, _ in terms if not on_guarded}
        before, self._seen = self._seen, (system.compiled, wiring)
        if before[0] is system.compiled and before[1] is wiring:
            return fresh
        for slot, (compiled, one_way, wires) in enumerate(zip(system.compiled, system.driven, wiring, strict=True)):
            if (known := self._loaded[slot]) and known[0] is compiled and known[1] == wires.key:
                continue
            fresh.add(slot)
            # strings come back to stops, and hands to strings
            ready = self._ready.setdefault(compiled, {})
            if (key := (slot, slot in pushed, wires.key)) not in ready:
                ready[key] = next(self._numbers), *self._arrays(compiled, wires, one_way, slot in pushed)
            number, component, guarded = ready[key]
            if known:
                self._kernel.set_aside(slot, known[2])
            self._loaded[slot] = (compiled, wires.key, number)
            if self._kernel.take_back(slot, number):
                continue
            self._kernel.set_component(slot, system.offsets[slot], one_way, *component)
            if guarded:
                self._kernel.set_guarded(slot, component[0], *guarded)
            if (part := compiled.tension) is not None:
                half = 0.5 * part.reading * part.kick[:, 0] * part.weights
                weights, half, reading = (_pack(a[None, :, None])[0, 0] for a in (part.weights, half, part.reading))
                self._kernel.set_stretched(slot, weights, half, reading, _pack(part.kick[None])[0], component[0])
        return fresh

    def _arrays(
        self, compiled: Compiled, wires: _Wires, one_way: bool, pushed: bool
    ) -> tuple[tuple[Any, ...], tuple[Floats, ...]]:
        """A component as ``set_component`` wants it, and ports that only contacts act on; `pushed` by other laws."""
        # nobody asks for the motion of a driven component's ports
        readouts = np.arange(len(compiled.ports), len(compiled.rows))
        fixed, guarded, incidence = wires.fixed, wires.guarded, wires.incidence
        if not (one_way or pushed or wires.coupled):
            fixed, incidence = _independent(compiled, fixed, incidence)
        rows = readouts if one_way else np.concatenate([fixed, readouts])
        E = _pack(compiled.E.reshape(-1, 4)[None])[0]
        history = compiled.history
        component = (
            E,
            _pack(compiled.rows[rows]),
            _pack(compiled.W[fixed]),
            np.ascontiguousarray(history[:, fixed][:, :, rows]),
            incidence,
            compiled.readouts.tolist(),
            compiled.difference.astype(int).tolist(),
        )
        if not guarded.size:
            return component, ()
        return component, (
            _pack(compiled.rows[guarded]),
            _pack(compiled.W[guarded]),
            np.ascontiguousarray(history[:, fixed][:, :, guarded]),
            np.ascontiguousarray(history[:, guarded][:, :, guarded]),
            np.ascontiguousarray(history[:, guarded][:, :, rows]),
        )

    def _wired(self, system: System) -> tuple[list[_Wires], list[Term]]:
        """Ports of every component as the connections now use them; made once for each set of those in use."""
        contact = system.elimination.others.is_contact
        coupled = {name for law in system.geometric for name in law.parts}
        key = self._active.tobytes(), self._nonlinear.tobytes(), contact.tobytes(), frozenset(coupled)
        if key not in self._wirings:
            always = np.concatenate([self._active, self._nonlinear[~contact]])
            wiring: list[_Wires] = []
            terms: list[Term] = []
            for slot, (name, one_way) in enumerate(zip(system.names, system.driven, strict=True)):
                incidence = system.incidence(slot)
                acts = incidence != 0.0
                touched = np.any(acts[self._nonlinear], axis=0)
                needed = np.any(acts[always], axis=0)
                may_sleep = not one_way and name not in coupled
                guarded = np.flatnonzero(touched & ~needed & may_sleep)
                fixed = np.flatnonzero((touched | needed) & ~np.isin(np.arange(acts.shape[1]), guarded))
                for j, port in zip(*np.nonzero(acts[self._nonlinear]), strict=True):
                    among, factor = (guarded if port in guarded else fixed), incidence[self._nonlinear[j], port]
                    k = int(np.searchsorted(among, port))
                    terms.append((int(j), slot, k, among is guarded, float(factor)))
                wires = np.ascontiguousarray(incidence[self._active][:, fixed])
                wired = np.nonzero(wires)
                parts = [part.tobytes() for part in (*wired, wires[wired], fixed, guarded)]
                parts.append(b"coupled" if name in coupled else b"")
                wiring.append(_Wires(fixed, guarded, wires, name in coupled, b"|".join(parts)))
            self._wirings[key] = wiring, terms
        return self._wirings[key]

    def run(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[Control] = ()
    ) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps; see `NumpyStepper.run`."""
        out, linear, laws = self._step(state, n, injections, controls)
        if len(self._active) == len(self.system.connections):
            return out, linear
        forces = np.zeros((n, len(self.system.connections)))
        forces[:, self._active] = linear
        if self._acted:
            forces[:, self._nonlinear[self._acted]] = laws[:, self._acted]
            laws[:, self._acted] = 0.0
        return out, forces

    def advance(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[Control] = ()
    ) -> tuple[Floats, NDArray[np.intp]]:
        """As `run`; in place of the forces only the places of the nonlinear connections that had one.

        A number for every sample and every contact of an instrument that touches little would cost as much as a tenth
        of its steps.
        """
        out, _, laws = self._step(state, n, injections, controls)
        if not self._acted:
            return out, _NONE
        laws[:, self._acted] = 0.0
        return out, self._nonlinear[self._acted]

    def _step(
        self, state: State, n: int, injections: Sequence[Injection], controls: Sequence[Control]
    ) -> tuple[Floats, Floats, Floats]:
        """Step; returns the output, the forces of linear connections, and of nonlinear ones.

        The latter are to be put back to zero where `_acted` says that they are not. A step whose forces the kernel does
        not find is redone by `NumpyStepper`, which has a search of last resort.
        """
        if state.modes.dtype != np.float64:
            raise ValueError(f"a state of {state.modes.dtype}; float64 is needed")
        s, on = self.system, self._nonlinear
        may_fail = s.nonlinear is not None or s.tensions or s.geometric
        before = state.copy() if may_fail else state
        found = self._run(state, n, injections, controls)
        if not isinstance(found, int):
            return found
        out, active_forces = np.empty((n, len(s.readouts))), np.empty((n, len(self._active)))
        law_forces, acted = np.zeros((n, len(on))), set[int]()
        done, end = 0, n
        while True:
            if isinstance(found, int):
                state.restore(before)
                if found:  # steps that it can make; cut where that changes nothing, wherever this run began
                    aligned = (state.sample + found) // _CUT * _CUT - state.sample
                    end = done + (aligned if aligned > 0 else found)
                    found = self._run(state, end - done, injections, controls)
                    continue
                end = done + 1
                found = self._redo(state, injections, controls)
            out[done:end], active_forces[done:end], law_forces[done:end] = found
            found[2][:, self._acted] = 0.0
            acted.update(self._acted)
            if end == n:
                break
            done, to_cut = end, -state.sample % _CUT
            end = min(n, done + to_cut) if to_cut else n
            before = state.copy()
            found = self._run(state, end - done, injections, controls)
        self._acted = sorted(acted)
        return out, active_forces, law_forces

    def _redo(
        self, state: State, injections: Sequence[Injection], controls: Sequence[Control]
    ) -> tuple[Floats, Floats, Floats]:
        """Make one step the slow way; returns as `_step`."""
        if self._slow is None or self._slow.system is not self.system:
            self._slow = NumpyStepper(self.system)
        self._redone += 1
        try:
            out, forces = self._slow.run(state, 1, injections, controls)
        except NumericalError:
            self._failures += 1
            raise
        self._steps += 1
        laws = forces[:, self._nonlinear]
        self._acted = np.flatnonzero(laws[0]).tolist()
        return out, forces[:, self._active], laws

    def _run(
        self, state: State, n: int, injections: Sequence[Injection], controls: Sequence[Control]
    ) -> tuple[Floats, Floats, Floats] | int:
        """Step in C++; returns as `_step`, or the first step whose forces were not found, the state being lost."""
        m, on = len(self.system.connections), self._nonlinear
        if state.series.size != m or state.slip.size != m:
            state.series, state.slip = np.zeros(m), np.zeros(m)
        remembers = np.count_nonzero(state.series) > 0
        if self.system.nonlinear is not None and remembers:
            state.series = self.system.nonlinear.settled_series(state.series)
        out = np.empty((n, len(self.system.readouts)))
        active_forces = np.empty((n, len(self._active)))
        if self._law_forces.size < n * len(on):
            self._law_forces = np.zeros(n * len(on))
        law_forces, solves = self._law_forces[: n * len(on)].reshape(n, len(on)), self.n_solves
        series, slip, last = state.series.take(on), state.slip.take(on), state.forces.take(on)
        active = [i for i in injections if i.start < state.sample + n and i.stop > state.sample]
        if len(state.tension) != len(self.system.tensions):
            state.tension = np.zeros((len(self.system.tensions), 3))
        slot, sample = self._kernel.run(
            state.modes,
            out,
            active_forces,
            [self._pack_injection(i, state) for i in active],
            law_forces,
            list(self.system.controlled(controls, state.sample, n).items()),
            series,
            slip,
            last,
            state.tension,
        )
        if slot != -1:
            self._law_forces = np.zeros(0)
            t = (state.sample + sample) * self.system.dt
            if slot >= 0:
                raise NumericalError(f"{self.system.names[slot]} is no longer finite at {t:.6f} s")
            return int(sample)
        solved = self.n_solves > solves
        self._acted = self._kernel.acted() if solved else []
        if n:
            state.forces[:] = 0.0
            state.forces[self._active] = active_forces[-1]
        if n and (solved or remembers):
            state.forces[on], state.series[on], state.slip[on] = law_forces[-1], series, slip
        state.sample += n
        self._steps += n
        return out, active_forces, law_forces

    def start(self) -> State:
        """Return the state of rest."""
        return self.system.start()

    def _pack_injection(self, injection: Injection, state: State) -> tuple[int, int, Floats, Floats]:
        known = self._packed.get(id(injection))
        if known is None or known[0] is not injection:
            for key in [k for k, v in self._packed.items() if v[0].stop <= state.sample]:
                del self._packed[key]
            known = (injection, _pack(injection.vectors), np.ascontiguousarray(injection.values))
            self._packed[id(injection)] = known
        return self.system.slot(injection.component), injection.start - state.sample, known[1], known[2]


def _geometric(
    system: System, slots: Sequence[int], wiring: Sequence[_Wires]
) -> tuple[float, bool, list[tuple[int, Floats, Floats, Floats, Floats, Floats, Floats]]]:
    """EA L, whether its longitudinal motion is stepped, and the parts of a string, as module.cpp reads them."""
    scale, along = 0.0, False
    parts: list[tuple[int, Floats, Floats, Floats, Floats, Floats, Floats]] = []
    for slot in slots:
        compiled, ports = system.compiled[slot], wiring[slot].fixed
        if (part := compiled.geometric) is not None:
            scale, along = part.scale, along or part.along
            slopes = part.slopes if part.stretch is None else part.stretch[None]
            moved = np.einsum("pmx,mx->pm", compiled.rows[ports][:, : part.n], part.kick)
            called = part.reading * compiled.W[ports][:, : part.n, 0]
            yields, kick = part.reading * part.kick[:, 0], np.ascontiguousarray(part.kick.T)
            parts.append((slot, slopes, part.reading, yields, kick, moved, called))
    return scale, along, parts


def _independent(compiled: Compiled, ports: NDArray[np.intp], incidence: Floats) -> tuple[NDArray[np.intp], Floats]:
    """As few ports as move the others with them, and how connections then use those.

    Where p ports of a body move by r < p independent motions (a rigid bridge that heaves and rocks has two), r of them
    span the rest, u = B u_r, in what they read and in what they push; a force on one is B^T f on those.
    """
    if len(ports) < 3 or not len(incidence):
        return ports, incidence
    parts = [part[ports].reshape(len(ports), -1) for part in (compiled.rows, compiled.W)]
    motion = np.hstack([part / (np.max(np.abs(part), initial=0.0) or 1.0) for part in parts])
    _, R, order = qr(motion.T, mode="economic", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(R)) > 1e-13 * np.abs(R[0, 0]))) if R.size else 0
    if rank in (0, len(ports)):
        return ports, incidence
    chosen = np.sort(order[:rank])
    span = lstsq(motion[chosen].T, motion.T)[0].T
    if np.max(np.abs(motion - span @ motion[chosen])) > 1e-14 * rank:
        return ports, incidence
    return ports[chosen], np.ascontiguousarray(incidence @ span)


def _law(law: NonlinearLaw) -> tuple[int, list[float], list[float], list[float], list[tuple[int, int, bool]]]:
    """Kind, a[4] with loss, damping, offset and velocity, samples, and addresses, as module.cpp reads them."""
    knots: list[float] = []
    coefficients: list[float] = []
    functions: list[tuple[int, int, bool]] = []
    match law:
        case Contact():
            kind, numbers = 0, [law.stiffness, law.exponent, 0.0, 0.0, law.loss, 0.0]
        case HardeningSpring():
            kind, numbers = 1, [law.stiffness, law.cubic, law.quadratic_damping, 0.0, 0.0, law.damping]
        case SampledPotential():
            kind, numbers = 2, [0.0, 0.0, 0.0, 0.0, law.loss, law.damping]
            knots, coefficients = law.knots.tolist(), law.coefficients.reshape(-1).tolist()
        case CompiledPotential():
            kind, numbers = 3, [0.0, 0.0, 0.0, 0.0, law.loss, law.damping]
            scalars: tuple[Scalar, Scalar] = (law.potential, law.slope)
            functions = [(f.address, f.data, f.takes_data) for f in scalars]
        case Friction():
            kind, numbers = 4, [law.normal_force, law.static, law.dynamic, law.speed, 0.0, 0.0]
    velocity = law.velocity if isinstance(law, Friction) else 0.0
    return kind, [*numbers, law.offset, velocity], knots, coefficients, functions


def _pack(a: Floats) -> Floats:
    """(k, n_modes, c) -> (k, c, padded n_modes), zeros in the padding."""
    k, n, c = a.shape
    width = -(-max(n, 1) // _kernel.PADDING) * _kernel.PADDING
    out = np.zeros((k, c, width))
    out[:, :, :n] = a.transpose(0, 2, 1)
    return out
