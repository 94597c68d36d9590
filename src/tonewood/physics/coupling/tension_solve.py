"""Rising tensions over one step: one linear force for each string, beside all connections (`tension`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.system import System
from tonewood.physics.coupling.tension import TensionShare, reset_psi

Floats = NDArray[np.float64]

#: steps after which psi is put back to sqrt(kappa) S
RESET_STEPS = 64
#: largest alpha, of the highest mode, at which the direction is corrected for the motion by the tension
LARGEST_ALPHA = 0.5


@dataclass(frozen=True, eq=False)
class TensionsOverStep:
    """Action of s rising tensions over one step.

    Attributes
    ----------
    reach : (m, s) gaps per psi_m.
    own : (s,) g . w g, loss of g . y+ per psi_m.
    start : (s,) psi + g . (y_free - y) / 2, sqrt(J).
    linear : (m, m) N/m, forces of the linear connections against gaps.
    modal : component slot -> the string's place, its direction g (n_modes,), and (n_modes, 2) state per psi_m.
    per_mean : (s,) mean tension per psi_m, N / sqrt(J).
    """

    reach: Floats
    own: Floats
    start: Floats
    linear: Floats
    modal: dict[int, tuple[int, Floats, Floats]]
    per_mean: Floats

    @cached_property
    def matrix(self) -> Floats:
        """(s, s) of the equations of psi_m, the linear connections answering; symmetric, positive definite."""
        return np.asarray(np.diag(1 + 0.5 * self.own) - 0.5 * self.reach.T @ self.linear @ self.reach)

    def mean(self, forces: Floats) -> Floats:
        """(s,) psi_m, sqrt(J), if `forces` (m,) are those of the linear connections without tensions."""
        right = self.start - 0.5 * self.reach.T @ forces
        return np.asarray(np.linalg.solve(self.matrix, right))

    def mean_under(self, forces: Floats) -> Floats:
        """(s,) psi_m, sqrt(J), if `forces` (m,) are those of all connections."""
        return np.asarray((self.start - 0.5 * self.reach.T @ forces) / (1 + 0.5 * self.own))

    def answer(self, moved: Floats) -> Floats:
        """(s, k) psi_m per force of nonlinear connections, of whose gaps `moved` (k, s) are reached by psi_m."""
        return np.asarray(-0.5 * np.linalg.solve(self.matrix, moved.T)) if moved.size else moved.T

    def after(self, x: Sequence[Floats], mean: Floats) -> list[Floats]:
        """States x after the forces -psi_m g are added."""
        return [xi + self.modal[i][2] * mean[self.modal[i][0]] if i in self.modal else xi for i, xi in enumerate(x)]


class RisingSolve(ABC):
    """Steps the strings of a system whose tension rises; a string has a row of the state's ``tension``.

    Attributes
    ----------
    system : of which it steps them.
    index : rows of the strings that are on.
    slots : of the components of each of these strings.
    """

    system: System
    index: list[int]
    slots: list[list[int]]

    @abstractmethod
    def over(self, x: Sequence[Floats], free: Sequence[Floats], forces: Floats, tension: Floats) -> TensionsOverStep:
        """Prepare a step.

        Parameters
        ----------
        x, free : states by component slot before, and after a step without connection forces.
        forces : (m,) N, of the linear connections without these strings.
        tension : (n_strings, 4) of the state.
        """

    @abstractmethod
    def carried(
        self, x: Sequence[Floats], after: Sequence[Floats], over: TensionsOverStep, mean: Floats, tension: Floats,
        step: int,
    ) -> Floats:  # fmt: skip
        """Rows of the state after a step, (n_strings, 4); resets `after` in place where the step calls for it.

        Parameters
        ----------
        x, after : states by component slot before and after the step.
        over : result of `over` for the step, and `mean` (s,) its psi_m, sqrt(J).
        tension : (n_strings, 4) of the state before the step.
        step : number of the step's end since time 0.
        """

    @abstractmethod
    def energies(self, x: Sequence[Floats], tension: Floats) -> Floats:
        """(n_strings,) V, J, of states by component slot; 0 of strings that are off."""


class TensionSolve(RisingSolve):
    """Steps strings without longitudinal motion.

    A row of a state's ``tension`` is the mean additional tension of the last three steps, latest first, N, and
    psi - sqrt(kappa) S, sqrt(J).
    """

    def __init__(self, system: System):
        self.system = system
        self.index = [t for t, on in enumerate(system.tension_on) if on]
        self.strings: list[list[tuple[int, TensionShare]]] = []
        self.slots: list[list[int]] = []
        for t in self.index:
            slots = [system.slot(name) for name in system.tensions[t].components]
            parts = [(slot, part) for slot in slots if (part := system.compiled[slot].tension) is not None]
            self.strings.append(parts)
            self.slots.append([slot for slot, _ in parts])
        self.roots = np.sqrt([string[0][1].kappa for string in self.strings])

    def over(self, x: Sequence[Floats], free: Sequence[Floats], forces: Floats, tension: Floats) -> TensionsOverStep:
        """See `RisingSolve`."""
        s, count = self.system, len(self.strings)
        reach, own, power = np.zeros((len(s.connections), count)), np.zeros(count), np.zeros(count)
        modal: dict[int, tuple[int, Floats, Floats]] = {}
        for q, (t, string) in enumerate(zip(self.index, self.strings, strict=True)):
            highest = max(float(part.half.max(initial=0.0)) for _, part in string)
            ahead = 3 * (tension[t, 0] - tension[t, 1]) + tension[t, 2]
            ahead = min(max(ahead, 0.0), LARGEST_ALPHA / highest if highest > 0.0 else np.inf)
            for i, part in string:
                compiled, incidence = s.compiled[i], s.incidence(i)
                after = free[i] + np.einsum("p,pmx->mx", incidence.T @ forces, compiled.W)
                g = part.direction(x[i], after, ahead)
                power[q] += g @ (part.reading * (free[i][:, 0] - x[i][:, 0]))
                own[q] += g @ (part.reading * part.kick[:, 0] * g)
                modal[i] = q, g, -part.kick * g[:, None]
                reach[:, q] += incidence @ np.einsum("pmx,mx->p", compiled.rows[: len(compiled.ports)], modal[i][2])
        psi = self.roots * self._stretches(x) + tension[self.index, 3]
        return TensionsOverStep(reach, own, psi + 0.5 * power, s.solve.G, modal, 2 * self.roots)

    def carried(
        self, x: Sequence[Floats], after: Sequence[Floats], over: TensionsOverStep, mean: Floats, tension: Floats,
        step: int,
    ) -> Floats:  # fmt: skip
        """See `RisingSolve`."""
        out = np.zeros_like(tension)
        psi = self.roots * self._stretches(x) + tension[self.index, 3]
        excess = 2 * mean - psi - self.roots * self._stretches(after)
        for q, (t, string) in enumerate(zip(self.index, self.strings, strict=True)):
            if step % RESET_STEPS == 0:
                excess[q] = reset_psi([part for _, part in string], [after[i] for i, _ in string], float(excess[q]))
            out[t] = over.per_mean[q] * mean[q], tension[t, 0], tension[t, 1], excess[q]
        return out

    def energies(self, x: Sequence[Floats], tension: Floats) -> Floats:
        """See `RisingSolve`."""
        out = np.zeros(len(self.system.tensions))
        excess = tension[self.index, 3] if tension.size else 0.0
        out[self.index] = 0.5 * (self.roots * self._stretches(x) + excess) ** 2
        return out

    def _stretches(self, x: Sequence[Floats]) -> Floats:
        return np.array([sum(part.stretch(x[i]) for i, part in string) for string in self.strings])
