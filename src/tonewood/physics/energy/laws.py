"""Energy that connections store, lose and receive from outside over the steps of a known motion.

Losses come from the laws at the gaps of each step: of a dashpot r (g+ - g)^2 / h, of a nonlinear law the part of its
force that its potential does not have, times the motion; never from the forces that a solver found, so that a force
that is not the law's leaves a balance open.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Rigid, SpringDashpot
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.laws import NonlinearLaw, PotentialLaw
from tonewood.physics.coupling.system import System
from tonewood.support.arrays import Floats

#: numbers of nonlinear laws that make them lose energy
_LOSSES = ("loss", "damping", "quadratic_damping")


@dataclass(eq=False)
class Flows:
    """Energy of connections, J: stored at both ends of the steps, lost and supplied in each; by those that have any.

    stored : name -> (T + 1,).
    lost, supplied : name -> (T,); supplied is the work of moving partners and scales.
    """

    stored: dict[str, Floats]
    lost: dict[str, Floats]
    supplied: dict[str, Floats]


class LawEnergies:
    """Energies of the connections of one system."""

    def __init__(self, system: System):
        laws = [c.law for c in system.connections]
        self._dt = system.dt
        self._names = tuple(c.name for c in system.connections)
        self._springs = {j: law for j, law in enumerate(laws) if isinstance(law, SpringDashpot)}
        self._springs.update(system.elimination.springs_in_series)
        rigid = np.array([isinstance(law, Rigid) for law in laws], dtype=bool)
        self._yielding = np.flatnonzero(rigid & (system.solve.gamma > 0))
        self._offset = np.array([law.offset if isinstance(law, Rigid) else 0.0 for law in laws])
        self._bend = _inverse(system.elimination.gap.residual, self._yielding)
        solve = self._solve = system.nonlinear
        self._on = solve.index if solve else np.zeros(0, dtype=np.intp)
        self._laws: tuple[NonlinearLaw, ...] = solve.laws if solve else ()
        self._elastic = {k: _without_losses(law) for k, law in enumerate(self._laws) if isinstance(law, PotentialLaw)}
        self._residual = solve.residual if solve else np.zeros((0, 0))
        self._theta = solve.theta if solve else 0.5
        self._in_series = np.flatnonzero(np.diag(self._residual) > 0)
        self._series_stiffness = _inverse(self._residual, self._in_series)

    def series(self, start: Floats, forces: Floats) -> Floats:
        """(T + 1, k) displacement of the residual compliance in series with the k nonlinear laws.

        start : (m,) at the beginning; empty is rest.
        forces : (T, m) N.
        """
        path = np.zeros((len(forces) + 1, self._on.size))
        path[0] = self._start(start)
        driven = forces[:, self._on] @ self._residual.T / self._theta
        for t in range(len(forces) if self._on.size else 0):
            path[t + 1] = driven[t] - (1 - self._theta) / self._theta * path[t]
        return path

    def _start(self, start: Floats) -> Floats:
        """(k,) displacements in series with the laws at the beginning."""
        if self._solve is None or not start.size:
            return np.zeros(self._on.size)
        return self._solve.carried_series(start)[self._on]

    def spread(self, series: Floats) -> Floats:
        """(m,) series displacements of all connections, from those (k,) of the nonlinear ones."""
        out = np.zeros(len(self._names))
        out[self._on] = series
        return out

    def moved(self, moving: Mapping[int, Floats]) -> list[str]:
        """Names of the connections with a potential whose partners are moved."""
        return [self._names[self._on[k]] for k in moving if k in self._elastic]

    def at(self, gaps: Floats, start: Floats) -> dict[str, float]:
        """Stored energy of one instant: gaps (m,) and series displacements (m,), partners where their laws say."""
        flows = self.over(gaps[None], self._start(start)[None], np.zeros((0, gaps.size)), {})
        return {name: float(values[0]) for name, values in flows.stored.items()}

    def over(self, gaps: Floats, series: Floats, forces: Floats, moving: Mapping[int, Floats]) -> Flows:
        """Energies of T steps.

        gaps : (T + 1, m) m, without displacements in series.
        series : (T + 1, k) m.
        forces : (T, m) N; only the work of partners is taken from them.
        moving : index among the nonlinear laws -> (4, T), as `physics.stepping.forcing.controlled` gives it.
        """
        flows = Flows({}, {}, {})
        for j, spring in self._springs.items():
            if spring.stiffness > 0:
                flows.stored[self._names[j]] = 0.5 * spring.stiffness * (gaps[:, j] - spring.offset) ** 2
            if spring.damping > 0:
                flows.lost[self._names[j]] = spring.damping * np.diff(gaps[:, j]) ** 2 / self._dt
        bent = gaps[:, self._yielding] - self._offset[self._yielding]
        for row, share in zip(self._yielding, (0.5 * bent * (bent @ self._bend)).T, strict=True):
            flows.stored[self._names[row]] = share
        series_part = series[:, self._in_series]
        bend, jump = 0.5 * series_part * (series_part @ self._series_stiffness), np.diff(series_part, axis=0)
        heat = (self._theta - 0.5) * jump * (jump @ self._series_stiffness)
        for k, law in enumerate(self._laws):
            name, at = self._names[self._on[k]], int(np.searchsorted(self._in_series, k))
            yields = bool(np.any(self._in_series == k))
            self._nonlinear(flows, name, k, law, gaps[:, self._on[k]] + series[:, k], forces, moving.get(k))
            if yields:
                flows.stored[name] = flows.stored.get(name, 0.0) + bend[:, at]
                flows.lost[name] = flows.lost.get(name, 0.0) + heat[:, at]
        return flows

    def _nonlinear(
        self, flows: Flows, name: str, k: int, law: NonlinearLaw, gap: Floats, forces: Floats, moved: Floats | None
    ) -> None:
        T, dt = len(forces), self._dt
        f = forces[:, self._on[k]]
        if not isinstance(law, PotentialLaw):  # friction
            partner = np.full(T, law.velocity) if moved is None else moved[2]
            slip = np.diff(gap) / dt - partner
            flows.lost[name] = np.abs(f * slip) * dt
            flows.supplied[name] = f * partner * dt
            return
        begin = np.full(T, law.offset) if moved is None else moved[0]
        end = begin if moved is None else moved[1]
        scale = np.ones(T) if moved is None else moved[3]
        rest = law.energy(law.offset)  # counted from where the gap is zero
        if T == 0:
            flows.stored[name] = np.array([law.energy(float(law.offset - g)) - rest for g in gap])
            return
        old, new = begin - gap[:-1], end - gap[1:]
        # a contact that is open at both ends of a step has nothing to tell
        busy = np.flatnonzero((old > 0) | (new > 0)) if law.one_sided else np.arange(T)
        before, after, lost = -scale * rest, -scale * rest, np.zeros(T)
        for t in busy:
            a, b = float(old[t]), float(new[t])
            before[t], after[t] = scale[t] * (law.energy(a) - rest), scale[t] * (law.energy(b) - rest)
            extra = law.force(b, a, dt)[0] - self._elastic[k].force(b, a, dt)[0]
            lost[t] = scale[t] * extra * (b - a)
        flows.stored[name] = np.concatenate([before[:1], after])
        flows.lost[name] = lost
        if moved is not None:
            # the partner's motion within each step and its jumps between two
            flows.supplied[name] = f * (end - begin)
            flows.supplied[name][1:] += before[1:] - after[:-1]


def _without_losses(law: PotentialLaw) -> PotentialLaw:
    typed: Any = law  # a dataclass
    there = {f.name for f in fields(typed)}
    return cast(PotentialLaw, replace(typed, **{name: 0.0 for name in _LOSSES if name in there}))


def _inverse(compliance: Floats, among: NDArray[np.intp]) -> Floats:
    return scaled_pinv(compliance[np.ix_(among, among)]) if among.size else np.zeros((0, 0))
