"""Forces of one step of strings under geometric stretch (`geometric`), by damped Newton iterations on all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.coupling.geometric import GeometricShare, GeometricShares
from tonewood.coupling.system import System

Floats = NDArray[np.float64]

#: relative residual of the norm of the forces of a step at which the iterations have converged
TOLERANCE = 1e-12
MAX_ITERATIONS = 60
#: smallest share of the potential by which continuation raises it where the damped iterations fail
SMALLEST_PART = 1e-4


class GeometricSolve:
    """Finds the forces of one step of all such strings of a system, together with everything else.

    Damped Newton iterations on the modal forces F: each step is shortened until the residual decreases. V + tension is
    convex where no string is slack, and the iterations then converge to the only solution. Where a string is slack
    there may be several solutions, and the iterations may stop at a minimum of the residual; then the potential is
    raised from zero in small steps, F = s Phi(y+(F)), s = 0 .. 1, each beginning at the solution of the one before. So
    the solution is the one next to the forces of the last step, or else the one that continuation from the string
    without a rise of tension finds.
    """

    def __init__(self, system: System):
        self.system = system
        self.slots = [[system.slot(name) for name in law.parts] for law in system.geometric]
        self.strings = [GeometricShares(tuple(self._part(i) for i in slots)) for slots in self.slots]
        self.starts = np.cumsum([0, *(s.n for s in self.strings)])

    def _part(self, slot: int) -> GeometricShare:
        part = self.system.compiled[slot].geometric
        if part is None:
            raise ValueError(f"{self.system.names[slot]} was compiled without its stretch")
        return part

    def _all(self) -> list[tuple[int, GeometricShare, slice]]:
        """(component slot, part, place of its coordinates)."""
        out = []
        for start, string, slots in zip(self.starts[:-1], self.strings, self.slots, strict=True):
            for slot, part, at in zip(slots, string.parts, start + string.sizes[:-1], strict=True):
                out.append((slot, part, slice(int(at), int(at) + part.n)))
        return out

    @cached_property
    def _reach(self) -> tuple[Floats, Floats]:
        """(m, n) gaps per modal force, and (n, m) coordinates per force of a connection; of no connection's answer."""
        s, n = self.system, int(self.starts[-1])
        gaps, answers = np.zeros((len(s.connections), n)), np.zeros((n, len(s.connections)))
        for slot, part, at in self._all():
            c = s.compiled[slot]
            gaps[:, at] = s.incidence(slot) @ np.einsum("pmx,mx->pm", c.rows[: len(c.ports), : part.n], part.kick)
            answers[at] = (part.reading * c.W[:, : part.n, 0]).T @ s.incidence(slot).T
        return gaps, answers

    @cached_property
    def compliance(self) -> Floats:
        """(n, n) coordinates after a step per modal force, linear connections included."""
        gaps, answers = self._reach
        return np.diag(self.yields) - answers @ self.system.solve.G @ gaps

    @cached_property
    def _nonlinear_reach(self) -> tuple[Floats, Floats]:
        """`_reach` of the nonlinear connections, with the linear ones eliminated: (k, n) and (n, k)."""
        nonlinear, (gaps, answers) = self.system.nonlinear, self._reach
        if nonlinear is None:
            return gaps[:0], answers[:, :0]
        on = nonlinear.index
        moved = gaps[on] - nonlinear.from_linear @ (self.system.solve.G @ gaps)
        return moved, answers[:, on] - answers @ nonlinear.answer

    def answer(self, stiffness: Floats) -> Floats:
        """(n, n) `compliance` with nonlinear connections too, whose forces gain `stiffness` (k, k), N/m, per gap."""
        gaps, answers = self._nonlinear_reach
        return np.asarray(self.compliance - answers @ stiffness @ gaps)

    @cached_property
    def yields(self) -> Floats:
        """(n,) coordinates after a step per own modal force, without connections."""
        return np.concatenate([part.reading * part.kick[:, 0] for _, part, _ in self._all()])

    def coordinates(self, x: Sequence[Floats]) -> Floats:
        """(n,) of states by component slot."""
        return np.concatenate([part.coordinates(x[slot]) for slot, part, _ in self._all()])

    def by_component(self, force: Floats) -> dict[str, Floats]:
        """Component -> (n_modes,) modal forces."""
        out = {}
        for slot, part, at in self._all():
            out[self.system.names[slot]] = np.zeros(self.system.compiled[slot].basis.n_modes)
            out[self.system.names[slot]][: part.n] = force[at]
        return out

    def after(self, free: Sequence[Floats], force: Floats) -> list[Floats]:
        """States after modal forces (n,)."""
        out = list(free)
        for slot, part, at in self._all():
            out[slot] = part.after(out[slot], force[at])
        return out

    def force(self, before: Floats, after: Floats) -> Floats:
        """Modal forces (n,) over a step."""
        pieces = np.split(np.stack([before, after]), self.starts[1:-1], axis=1)
        return np.concatenate([s.force(*piece) for s, piece in zip(self.strings, pieces, strict=True)])

    def energy(self, x: Sequence[Floats]) -> Floats:
        """(n_strings,) U, J."""
        pieces = np.split(self.coordinates(x), self.starts[1:-1])
        return np.array([s.energy(y) for s, y in zip(self.strings, pieces, strict=True)])

    def find(
        self,
        x: Sequence[Floats],
        free: Sequence[Floats],
        attempt: Callable[[list[Floats]], Sequence[Floats]],
        answer: Callable[[], Floats] | None = None,
    ) -> tuple[Floats, int, bool]:
        """Find the modal forces of a step.

        Parameters
        ----------
        x, free : states before, and after a step without forces.
        attempt : states without connection forces -> states with them.
        answer : (n, n) coordinates per modal force at the last attempt; by default there are no connections.

        Returns
        -------
        forces (n,), iterations, and whether they were found.
        """
        before, size, count = self.coordinates(x), np.sqrt(self.yields), 0

        def wrong(F: Floats, share: float) -> tuple[Floats, Floats, float]:
            """Residual of F, coordinates after the step, and the norm of the residual."""
            nonlocal count
            count += 1
            after = self.coordinates(attempt(self.after(free, F)))
            off = share * self.force(before, after) - F
            return off, after, float(sla.norm(size * off))

        def descend(F: Floats, share: float) -> tuple[Floats, bool]:
            off, after, left = wrong(F, share)
            last = np.inf
            for _ in range(MAX_ITERATIONS):
                all_of_it = float(sla.norm(size * F))
                if not np.isfinite(left):
                    return F, False
                # rounding of the two terms of the strain, which nearly cancel, ends the descent
                if left <= TOLERANCE * all_of_it or (left >= 0.5 * last and left <= 1e3 * TOLERANCE * all_of_it):
                    return F, True
                slope = share * sla.block_diag(
                    *(
                        s.slope(before[a:b], after[a:b])
                        for s, a, b in zip(self.strings, self.starts[:-1], self.starts[1:], strict=True)
                    )
                )
                compliance = np.diag(self.yields) if answer is None else answer()
                step, t, last = sla.solve(np.eye(len(F)) - slope @ compliance, off), 1.0, left
                while True:
                    off, after, left = wrong(F + t * step, share)
                    if left <= (1 - 1e-4 * t) * last or left <= 1e3 * TOLERANCE * all_of_it:
                        break
                    t *= 0.5
                    if t < 1e-6:
                        return F, False
                F = F + t * step
            return F, False

        F, found = descend(self.force(before, before), 1.0)
        if not found:
            F, share, part = np.zeros_like(F), 0.0, 0.25
            while share < 1.0 and part > SMALLEST_PART:
                part = min(part, 1.0 - share)
                tried, found = descend(F, share + part)
                if found:
                    F, share, part = tried, share + part, 2 * part
                else:
                    part *= 0.5
            found = share == 1.0
        return F, count, found
