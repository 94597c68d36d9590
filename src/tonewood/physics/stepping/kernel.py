"""The C++ kernel behind the same interface as `stepper.NumpyStepper`.

The instruction set is chosen when the module is imported: the widest this machine has, or the one named by the
environment variable ``TONEWOOD_ISA``. For the same arrays, one build and one instruction set, results are
bit-identical, also where a run is cut at multiples of 64 samples.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from tonewood import _kernel
from tonewood.errors import NumericalError, TonewoodError
from tonewood.physics.coupling.potentials.user import PotentialEnergy
from tonewood.physics.coupling.system import Injection, PrescribedMotion, State, System
from tonewood.physics.stepping.description import Description, packed
from tonewood.physics.stepping.forcing import controlled
from tonewood.physics.stepping.kept_descriptions import KeptDescriptions
from tonewood.physics.stepping.stepper import NumpyStepper, Statistics
from tonewood.support.arrays import Floats

_NONE = np.zeros(0, dtype=np.intp)
#: samples, at multiples of which a run may be cut without changing a bit
_CUT = 64


def instruction_set() -> str:
    """Name of the instruction set in use: avx512, avx2 or baseline."""
    available: list[str] = _kernel.instruction_sets()
    name = os.environ.get("TONEWOOD_ISA", "auto")
    if name == "auto":
        return available[0]
    if name not in available:
        raise TonewoodError(f"TONEWOOD_ISA={name}: this machine has auto, {', '.join(available)}")
    return name


def compiler() -> str:
    """Name and version of the compiler that built the kernel: another one may fuse other products and sums."""
    return _kernel.COMPILER


@dataclass(frozen=True, slots=True)
class Shortcuts:
    """Which shortcuts of the kernel are on; ``docs/kernel.md`` derives each and states its gain.

    None of them changes the equations that are solved: samples are the same bit for bit, or within 1e-12 of their peak
    where the page says so.
    """

    #: modes that one row reads are stepped in their share of that row, moved and read in one pass
    fused_pass: bool = True
    #: port forces of linear connections in one product; contact-free samples without the general step
    direct_step: bool = True
    #: contacts are stepped only where a bound cannot exclude them
    block_culling: bool = True
    #: one bound for all contacts of a group first
    group_bound: bool = True
    #: a second bound about the middle of the block
    fine_bound: bool = True
    #: components at rest that nothing can move are not stepped
    at_rest: bool = True
    #: laws with a linear force are solved with the linear connections while no other law can act
    linear_laws: bool = True


class KernelStepper:
    """Steps a `System` in C++.

    system : to be stepped.
    isa : instruction set, by default `instruction_set()`.
    shortcuts : which shortcuts of the kernel are on, by default all.
    """

    def __init__(self, system: System, *, isa: str | None = None, shortcuts: Shortcuts | None = None):
        n_components, capacity = len(system.names), sum(system.layout.capacities)
        self._kernel = _kernel.Kernel(isa or instruction_set(), n_components, capacity, len(system.readouts))
        self._packed: dict[int, tuple[Injection, Floats, Floats]] = {}
        self._shortcuts = asdict(shortcuts or Shortcuts())
        self._descriptions = KeptDescriptions(self._shortcuts)
        self._steps = self._redone = self._failures = 0
        self._slow: NumpyStepper | None = None
        self._law_forces, self._acted = np.zeros(0), list[int]()  # the former is kept at zero between runs
        self._carried: tuple[System | None, Floats] = None, _NONE.astype(float)  # whose series is that of the system
        self._nonlinear = self._active = _NONE
        self.system = system
        self._load(system)

    def exchange(self, system: System) -> None:
        """Go on with a changed system: same components and connections, other bases or laws."""
        self.system = system
        self._load(system)

    @property
    def statistics(self) -> Statistics:
        """Work of the nonlinear solves since this stepper was made."""
        solves, iterations, most, *_ = self._kernel.statistics()
        return Statistics(self._steps, solves, iterations, most, self._failures, self._redone)

    @property
    def n_solves(self) -> int:
        """Number of nonlinear solves so far."""
        return int(self._kernel.statistics()[0])

    @property
    def culling_statistics(self) -> dict[str, int]:
        """Work of the broad phase.

        Blocks stepped with nonlinear connections, rows of contacts read in them, contacts added inside a block.
        """
        return dict(zip(("blocks", "rows_read", "added"), self._kernel.statistics()[4:], strict=True))

    def describe(self) -> Description:
        """Return all that the kernel is loaded with, every array by its name, as `load` of ``src/kernel`` reads it."""
        return KeptDescriptions(self._shortcuts).of(self.system)

    def _load(self, system: System) -> None:
        self._nonlinear = _NONE if system.nonlinear is None else system.nonlinear.index
        self._active = system.solve.on
        self._kernel.load(self._descriptions.of(system, frozenset(self._kernel.cached())))

    def run(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[PrescribedMotion] = ()
    ) -> tuple[Floats, Floats]:
        """Advance `state` in place by n steps; see `NumpyStepper.run`."""
        out, linear, laws = self._step(state, n, injections, controls)
        if len(self._active) == len(self.system.connections):
            return out, linear
        forces = np.zeros((n, len(self.system.connections)))
        forces[:, self._active] = linear
        if self._acted:
            forces[:, self._nonlinear[self._acted]] = laws[:, self._acted]
            self._clear(laws)
        return out, forces

    def advance(
        self, state: State, n: int, injections: Sequence[Injection] = (), controls: Sequence[PrescribedMotion] = ()
    ) -> tuple[Floats, NDArray[np.intp]]:
        """As `run`; in place of the forces only the places of the nonlinear connections that had one.

        A number for every sample and every contact of an instrument that touches little would cost as much as a tenth
        of its steps.
        """
        out, _, laws = self._step(state, n, injections, controls)
        if not self._acted:
            return out, _NONE
        self._clear(laws)
        return out, self._nonlinear[self._acted]

    def _clear(self, laws: Floats) -> None:
        """Set the forces of the laws that acted to zero again, in place."""
        if self._acted:  # a slice: much quicker than those columns alone, and the ones between are zero
            laws[:, self._acted[0] : self._acted[-1] + 1] = 0.0

    def _step(
        self, state: State, n: int, injections: Sequence[Injection], controls: Sequence[PrescribedMotion]
    ) -> tuple[Floats, Floats, Floats]:
        """Step; returns the output, the forces of linear connections, and of nonlinear ones.

        The caller sets the latter to zero again in the columns that `_acted` names. If the kernel does not find the
        forces of a step, `NumpyStepper` repeats it, with a search of last resort.
        """
        if state.modes.dtype != np.float64:
            raise ValueError(f"a state of {state.modes.dtype}; float64 is needed")
        s, on = self.system, self._nonlinear
        to_cut = -state.sample % _CUT
        if 0 < to_cut < n and s.potentials.two_way:  # the kernel puts psi back at the ends of its windows
            first = self._step(state, to_cut, injections, controls)
            first_laws, acted = first[2].copy(), set(self._acted)
            self._clear(first[2])
            rest = self._step(state, n - to_cut, injections, controls)
            laws = np.concatenate([first_laws, rest[2]])
            self._clear(rest[2])
            self._acted = sorted(acted | set(self._acted))
            return np.concatenate([first[0], rest[0]]), np.concatenate([first[1], rest[1]]), laws
        may_fail = s.nonlinear is not None
        before = state.copy() if may_fail else state
        piece = self._run(state, n, injections, controls)
        if not isinstance(piece, int):
            return piece
        out, active_forces = np.empty((n, len(s.readouts))), np.empty((n, len(self._active)))
        law_forces, acted = np.zeros((n, len(on))), set()
        done, end = 0, n
        while True:
            if isinstance(piece, int):
                state.restore(before)
                if piece:  # steps that it can make; cut where that changes nothing, wherever this run began
                    aligned = (state.sample + piece) // _CUT * _CUT - state.sample
                    end = done + (aligned if aligned > 0 else piece)
                    piece = self._run(state, end - done, injections, controls)
                    continue
                end = done + 1
                piece = self._redo(state, injections, controls)
            out[done:end], active_forces[done:end], law_forces[done:end] = piece
            self._clear(piece[2])
            acted.update(self._acted)
            if end == n:
                break
            done, to_cut = end, -state.sample % _CUT
            end = min(n, done + to_cut) if to_cut else n
            before = state.copy()
            piece = self._run(state, end - done, injections, controls)
        self._acted = sorted(acted)
        return out, active_forces, law_forces

    def _redo(
        self, state: State, injections: Sequence[Injection], controls: Sequence[PrescribedMotion]
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
        self, state: State, n: int, injections: Sequence[Injection], controls: Sequence[PrescribedMotion]
    ) -> tuple[Floats, Floats, Floats] | int:
        """Step in C++; returns as `_step`, or the first step whose forces were not found, the state being lost."""
        m, on = len(self.system.connections), self._nonlinear
        if state.series.size != m or state.slip.size != m:
            state.series, state.slip = np.zeros(m), np.zeros(m)
        remembers = np.count_nonzero(state.series) > 0
        carried = self._carried[0] is self.system and self._carried[1] is state.series
        if self.system.nonlinear is not None and remembers and not carried:
            state.series = self.system.nonlinear.carried_series(state.series)
        self._carried = self.system, state.series
        out = np.empty((n, len(self.system.readouts)))
        active_forces = np.empty((n, len(self._active)))
        if self._law_forces.size < n * len(on):
            self._law_forces = np.zeros(n * len(on))
        law_forces, solves = self._law_forces[: n * len(on)].reshape(n, len(on)), self.n_solves
        series, slip, last = state.series.take(on), state.slip.take(on), state.forces.take(on)
        active = [i for i in injections if i.start < state.sample + n and i.stop > state.sample]
        state.potentials = self.system.potentials.checked(state.potentials)
        slot, sample = self._kernel.run(
            state.modes,
            out,
            active_forces,
            self.pack_injections(active, state.sample),
            law_forces,
            list(controlled(self.system, controls, state.sample, n).items()),
            series,
            slip,
            last,
            state.potentials,
            state.sample % _CUT,
        )
        if slot != -1:
            self._law_forces = np.zeros(0)
            for i in range(len(self.system.potentials)):
                if isinstance(potential := self.system.joined(i), PotentialEnergy):
                    potential.raise_fault()
            t = (state.sample + sample) * self.system.dt
            if slot >= 0:
                raise NumericalError(f"{self.system.names[slot]} is no longer finite at {t:.6f} s")
            return int(sample)
        self.system.check_potentials(state)
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

    def pack_injections(self, active: Sequence[Injection], now: int) -> list[tuple[int, int, Floats, Floats]]:
        """Return slot, first step, vectors and values of each; those of the run before are not packed again."""
        before, self._packed = self._packed, {}
        out = []
        for injection in active:
            entry = before.get(id(injection))
            if entry is None or entry[0] is not injection:
                entry = (injection, packed(injection.vectors), np.ascontiguousarray(injection.values))
            self._packed[id(injection)] = entry
            out.append((self.system.slot(injection.component), injection.start - now, entry[1], entry[2]))
        return out
