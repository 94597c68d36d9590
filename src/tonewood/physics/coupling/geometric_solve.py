"""Strings with longitudinal motion over one step: one linear force for each, beside all connections (`geometric`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.geometric import GeometricShare, GeometricShares
from tonewood.physics.coupling.system import System
from tonewood.physics.coupling.tension import pay_from_motion
from tonewood.physics.coupling.tension_solve import RESET_STEPS, RisingSolve, TensionSolve, TensionsOverStep

Floats = NDArray[np.float64]

#: part of EA L by which C exceeds the energy of a string: psi must not pass zero where a string at rest begins to move
LEAST_SHIFT = 1e-8


class GeometricSolve(RisingSolve):
    """Steps the strings of a system whose longitudinal motion is coupled, and those beside them.

    A row of a state's ``tension`` is the mean additional tension of the last step, N; the shift C, J, with the sign of
    psi; 0; and the excess of V = psi^2 / 2 - C over U, J. A row of zeros is a string whose C is still to be chosen.
    """

    def __init__(self, system: System):
        self.system = system
        self.index = [t for t, on in enumerate(system.is_on) if on]
        self.slots = [[system.slot(name) for name in law.parts] for law in system.geometric]
        self.strings = [GeometricShares(tuple(self._part(i) for i in slots)) for slots in self.slots]

    def _part(self, slot: int) -> GeometricShare:
        part = self.system.compiled[slot].geometric
        if part is None:
            raise ValueError(f"{self.system.names[slot]} was compiled without its stretch")
        return part

    def over(self, x: Sequence[Floats], free: Sequence[Floats], forces: Floats, tension: Floats) -> TensionsOverStep:
        """See `RisingSolve`."""
        s, count = self.system, len(self.strings)
        driven = self._moved(free, forces)
        ends = [self._coordinates(q, x) for q in range(count)], [self._coordinates(q, driven) for q in range(count)]
        squares = [0.5 * (st.squares(a) + st.squares(b)) for st, a, b in zip(self.strings, *ends, strict=True)]
        # the longitudinal modes under s_n, the connections answering
        added: dict[int, Floats] = {}
        for q, string in enumerate(self.strings):
            added |= self._added(q, -(string.weights * squares[q]) @ string.strains)
        answer = forces - s.solve.G @ self._gaps(added)
        stretched = self._moved([f + added[i] if i in added else f for i, f in enumerate(free)], answer)
        reach, own, start = np.zeros((len(s.connections), count)), np.zeros(count), np.zeros(count)
        per_mean = np.zeros(count)
        modal: dict[int, tuple[int, Floats, Floats]] = {}
        for q, string in enumerate(self.strings):
            before = ends[0][q]
            strain = np.asarray(0.5 * string.strains @ (before + self._coordinates(q, stretched)))
            shift, psi = self._psi(q, x, tension[self.index[q]])
            potential = string.potential(squares[q], strain)
            size = np.sqrt(max(2 * (potential + shift), abs(potential) + shift))
            per = 1 / size if size > 0.0 else 0.0
            g = per * string.gradient(0.5 * (before + ends[1][q]), squares[q], strain)
            own[q] = sum(g[at] @ ((part.reading * part.kick[:, 0])[: part.n] * g[at]) for part, at in self._places(q))
            start[q] = psi + 0.5 * g @ (self._coordinates(q, free) - before)
            per_mean[q] = per * (string.weights * (squares[q] + strain))[0]
            action = self._added(q, -g)
            reach[:, q] = self._gaps(action)
            for slot, (part, at) in zip(self.slots[q], self._places(q), strict=True):
                direction = np.zeros(len(x[slot]))
                direction[: part.n] = g[at]
                modal[slot] = q, direction, action[slot]
        return TensionsOverStep(reach, own, start, s.solve.G, modal, per_mean)

    def carried(
        self, x: Sequence[Floats], after: Sequence[Floats], over: TensionsOverStep, mean: Floats, tension: Floats,
        step: int,
    ) -> Floats:  # fmt: skip
        """See `RisingSolve`."""
        out = np.zeros_like(tension)
        for q, (t, string) in enumerate(zip(self.index, self.strings, strict=True)):
            shift, psi = self._psi(q, x, tension[t])
            psi = 2 * mean[q] - psi
            excess = 0.5 * psi * psi - shift - string.energy(self._coordinates(q, after))
            if step % RESET_STEPS == 0:
                states = [after[slot] for slot in self.slots[q]]
                excess += pay_from_motion([part.velocity[:, : part.n] for part in string.parts], states, -excess)
                shift = self._shift(q, after, string.energy(self._coordinates(q, after)) + excess)
                psi = 1.0  # above zero where it begins anew
            out[t] = over.per_mean[q] * mean[q], np.copysign(shift, psi), 0.0, excess
        return out

    def energies(self, x: Sequence[Floats], tension: Floats) -> Floats:
        """See `RisingSolve`."""
        out = np.zeros(len(self.system.rising))
        for q, (t, string) in enumerate(zip(self.index, self.strings, strict=True)):
            out[t] = string.energy(self._coordinates(q, x)) + (tension[t, 3] if tension.size else 0.0)
        return out

    def _psi(self, q: int, x: Sequence[Floats], row: Floats) -> tuple[float, float]:
        """C and psi of a string, from its row of the state."""
        stored = self.strings[q].energy(self._coordinates(q, x)) + row[3]
        shift = abs(row[1])
        if not (shift > 0.0 and stored + shift > 0.0):
            shift = self._shift(q, x, stored)
        return shift, float(np.copysign(np.sqrt(2 * (stored + shift)), row[1]))

    def _shift(self, q: int, x: Sequence[Floats], stored: float) -> float:
        """C for the next steps, J: all energy of the string, or the shortfall of U if that is more, and a little."""
        modes = sum(part.energy(x[slot]) for slot, part in zip(self.slots[q], self.strings[q].parts, strict=True))
        return float(max(modes + stored, -stored, 0.0) + LEAST_SHIFT * self.strings[q].parts[-1].scale)

    def _places(self, q: int) -> list[tuple[GeometricShare, slice]]:
        """Parts of a string, and where their coordinates stand."""
        parts, starts = self.strings[q].parts, self.strings[q].sizes[:-1].tolist()
        return [(part, slice(at, at + part.n)) for part, at in zip(parts, starts, strict=True)]

    def _coordinates(self, q: int, x: Sequence[Floats] | Mapping[int, Floats]) -> Floats:
        parts = zip(self.slots[q], self.strings[q].parts, strict=True)
        return np.concatenate([part.coordinates(x[slot]) for slot, part in parts])

    def _added(self, q: int, force: Floats) -> dict[int, Floats]:
        """Component slot -> state (n_modes, 2) that modal forces (n,) add over a step."""
        out = {}
        for slot, (part, at) in zip(self.slots[q], self._places(q), strict=True):
            out[slot] = np.zeros((self.system.compiled[slot].basis.n_modes, 2))
            out[slot][: part.n] = part.kick[: part.n] * force[at, None]
        return out

    def _gaps(self, added: dict[int, Floats]) -> Floats:
        """(m,) gaps of states by component slot, all others at rest."""
        total = np.zeros(len(self.system.connections))
        for slot, x in added.items():
            c = self.system.compiled[slot]
            total += self.system.incidence(slot) @ np.einsum("pmx,mx->p", c.rows[: len(c.ports)], x)
        return total

    def _moved(self, free: Sequence[Floats], forces: Floats) -> dict[int, Floats]:
        """States of the strings' components after connection forces (m,)."""
        s = self.system
        slots = [slot for string in self.slots for slot in string]
        return {i: free[i] + np.einsum("p,pmx->mx", s.incidence(i).T @ forces, s.compiled[i].W) for i in slots}


def rising_solve(system: System) -> RisingSolve | None:
    """Solve for the strings of a system whose tension rises, if there are any."""
    if any(system.tension_on):
        return TensionSolve(system)
    return GeometricSolve(system) if system.geometric else None
