"""Known forces in time, compiled to injections into modes: exact for any piecewise quadratic force."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.physics.coupling.system import Injection, PrescribedMotion, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import SERIES_TERMS, impulse_series, moments, real_form
from tonewood.support.arrays import Floats

#: steps with breakpoints that lie so far apart are injected one by one, others together, so many at most
_APART = _TOGETHER = 64
_Acting = TypeVar("_Acting", Injection, PrescribedMotion)


@dataclass(frozen=True, slots=True)
class Segment:
    """A known force F(t) = c0 + c1 (t - start) + c2 (t - start)^2 for start <= t < stop; s, N, N/s, N/s^2."""

    start: float
    stop: float
    c0: float
    c1: float = 0.0
    c2: float = 0.0

    def shifted(self, by: float) -> tuple[float, float, float]:
        """Return the coefficients about start + by."""
        return self.c0 + by * (self.c1 + by * self.c2), self.c1 + 2 * by * self.c2, self.c2


def course(pieces: Sequence[Segment], times: ArrayLike, *, derivative: bool = False) -> Floats:
    """Values (or first derivatives) at times (n,) s; 0 outside the pieces, from the right at their ends."""
    t = np.asarray(times, dtype=np.float64)
    out = np.zeros_like(t)
    for s in pieces:
        here = (t >= s.start) & (t < s.stop)
        u = t[here] - s.start
        out[here] = s.c1 + 2 * u * s.c2 if derivative else s.c0 + u * (s.c1 + u * s.c2)
    return out


@dataclass(frozen=True, eq=False)
class SampledForce:
    """A known force by its values at equal intervals, straight lines between them, 0 outside; for noise.

    Where it is stepped, each step has a constant force, the value in its middle.

    Attributes
    ----------
    start : s, time of the first value.
    interval : s, between two values.
    values : (n,) N; the first and the last should be 0.
    """

    start: float
    interval: float
    values: Floats

    @property
    def stop(self) -> float:
        """Time of the last value, s."""
        return self.start + self.interval * (len(self.values) - 1)

    def at(self, times: ArrayLike) -> Floats:
        """Return the values at times (n,) s."""
        t, last = np.asarray(times, dtype=np.float64), len(self.values) - 1
        if not t.size:
            return np.zeros_like(t)
        # the part of the grid about these times, a value more on either side
        first, stop = (math.floor((float(end) - self.start) / self.interval) for end in (t.min(), t.max()))
        part = slice(min(max(first - 1, 0), last), min(max(stop + 3, 1), last + 1))
        grid = self.start + self.interval * np.arange(part.start, part.stop)
        return np.asarray(np.interp(t, grid, self.values[part], left=0.0, right=0.0))

    def rate(self, times: ArrayLike) -> Floats:
        """Return the first derivative at times (n,) s, N/s; from the right where two lines meet."""
        index = np.floor((np.asarray(times, dtype=np.float64) - self.start) / self.interval).astype(np.intp)
        last = len(self.values) - 1
        rise = self.values[np.clip(index + 1, 0, last)] - self.values[np.clip(index, 0, last)]
        return np.asarray(rise / self.interval)

    def by_step(self, sample: int, n: int, dt: float, time: float = 0.0) -> Floats:
        """Return (n,) N, the force over the steps from `sample` on.

        Parameters
        ----------
        dt : s, step; step k is [k dt, (k + 1) dt].
        time : s, absolute time of the force's origin.
        """
        return self.at((sample + 0.5 + np.arange(n)) * dt - time)

    def course(self, dt: float, *, time: float = 0.0, first: int) -> Course:
        """Return it from step to step of `dt` s, from the step `first` on; `time` (s) is that of its event."""
        begin = max(first, math.floor((time + self.start) / dt))
        return Course(dt, (), (), begin, max(math.ceil((time + self.stop) / dt), begin), (self, time))

    def after(self, time: float) -> SampledForce:
        """Return the part from a time (s) on."""
        skipped = min(max(math.ceil((time - self.start) / self.interval), 0), len(self.values) - 2)
        return SampledForce(self.start + skipped * self.interval, self.interval, self.values[skipped:])


@dataclass(frozen=True, eq=False)
class Course:
    """A known force from step to step, whatever it acts on.

    dt : s, step; step n is [n dt, (n + 1) dt].
    parts : step, and the part of it that the force fills: begin and end (s from its beginning), coefficients there; of
        steps with breakpoints.
    whole : first step, the step after the last, begin (in steps) and piece, of the steps that lie inside one piece.
    start, stop : the first of those steps or of the noise, and the step after the last.
    noise : a random part, and the time (s) of its origin.
    """

    dt: float
    parts: tuple[tuple[int, float, float, tuple[float, float, float]], ...]
    whole: tuple[tuple[int, int, float, Segment], ...]
    start: int
    stop: int
    noise: tuple[SampledForce, float] | None = None

    @classmethod
    def of(cls, pieces: Sequence[Segment], dt: float, *, time: float = 0.0, first: int | None = None) -> Course:
        """Cut a force into steps; parameters as of `compile_force`."""
        earliest = -math.inf if first is None else first
        parts: list[tuple[int, float, float, tuple[float, float, float]]] = []
        whole: list[tuple[int, int, float, Segment]] = []
        for piece in pieces:
            begin, end = (time + piece.start) / dt, (time + piece.stop) / dt
            if not end > begin:
                continue
            n0, n1, full0, full1 = math.floor(begin), math.ceil(end), math.ceil(begin), math.floor(end)
            for n in sorted({n0, n1 - 1}):
                if n >= earliest and not full0 <= n < full1:
                    a, b = max(begin - n, 0.0), min(end - n, 1.0)
                    parts.append((n, a * dt, b * dt, piece.shifted((n + a - begin) * dt)))
            full0 = full0 if first is None else max(full0, first)
            if full1 > full0:
                whole.append((full0, full1, begin, piece))
        start, stop = min((w[0] for w in whole), default=0), max((w[1] for w in whole), default=0)
        return cls(dt, tuple(parts), tuple(whole), start, stop)

    def with_noise(self, noise: Course) -> Course:
        """Return the sum of this force, which has none, and a random one."""
        courses = [c for c in (self, noise) if c.stop > c.start] or [self]
        start, stop = min(c.start for c in courses), max(c.stop for c in courses)
        return Course(self.dt, self.parts, self.whole, start, stop, noise.noise)

    def between(self, start: int, stop: int) -> Floats:
        """Return (3, n) constant, linear and quadratic part at the beginning of each whole step; 0 in other steps."""
        total = np.zeros((3, stop - start))
        whole = [(max(w[0], start), min(w[1], stop), *w[2:]) for w in self.whole if w[0] < stop and w[1] > start]
        if whole:
            counts = [full1 - full0 for full0, full1, *_ in whole]
            steps = np.concatenate([np.arange(full0, full1) for full0, full1, *_ in whole])
            numbers = np.array([(begin, piece.c0, piece.c1, piece.c2) for *_, begin, piece in whole])
            begins, c0, c1, c2 = np.repeat(numbers, counts, axis=0).T
            at = (steps - begins) * self.dt
            for row, values in zip(total, (c0 + at * (c1 + c2 * at), c1 + 2 * c2 * at, c2), strict=True):
                np.add.at(row, steps - start, values)
        if self.noise:
            noise, time = self.noise
            total[0] += noise.by_step(start, stop - start, self.dt, time)
        return total

    @cached_property
    def values(self) -> Floats:
        """`between` start and stop."""
        return self.between(self.start, self.stop)

    @cached_property
    def steps(self) -> tuple[int, ...]:
        """Steps with breakpoints, in order."""
        return tuple(sorted({n for n, *_ in self.parts}))

    @cached_property
    def used(self) -> NDArray[np.intp]:
        """Which of constant, linear and quadratic part there are in whole steps."""
        nonzero = np.array([(p.c0, p.c1, p.c2) for *_, p in self.whole]).reshape(-1, 3) != 0.0
        noisy = self.noise is not None and bool(np.any(self.noise[0].values))
        return np.flatnonzero([noisy or nonzero.any(), nonzero[:, 1:].any(), nonzero[:, 2].any()])

    def injections(
        self, component: str, impulses: Floats, factor: float = 1.0, *, window: int | None = None
    ) -> list[Injection]:
        """Injection of the force into a component, from the `impulse_series` of the point it acts on, in windows."""
        n_cells, n_terms, n_modes, _ = impulses.shape
        added = factor * (self._moments(n_cells) @ impulses.reshape(n_cells * n_terms, 2 * n_modes))
        added = added.reshape(len(added), n_modes, 2)
        out, steps = [], np.array(self.steps, dtype=np.intp)
        for near in np.split(np.arange(len(steps)), np.flatnonzero(np.diff(steps) >= _APART) + 1):
            for group in (near[i : i + _TOGETHER] for i in range(0, len(near), _TOGETHER)):
                at = steps[group] - steps[group[0]]
                values = np.zeros((len(group), int(at[-1]) + 1))
                values[np.arange(len(group)), at] = 1.0
                out.append(Injection(component, int(steps[group[0]]), added[group[0] : group[-1] + 1], values))
        if self.used.size:
            out += self.held(component, added[len(self.steps) + self.used], self.used, window=window)
        return out

    def held(self, component: str, vectors: Floats, rows: Any, *, window: int | None) -> list[Injection]:
        """Injection of some of its parts in whole steps, in windows."""

        def acting(start: int, stop: int) -> Injection:
            whole = (start, stop) == (self.start, self.stop)
            return Injection(component, start, vectors, (self.values if whole else self.between(start, stop))[rows])

        return [windowed(self.start, self.stop, acting, window)] if self.stop > self.start else []

    def _moments(self, n_cells: int) -> Floats:
        """(n_steps + 3, n_cells SERIES_TERMS) of the steps with breakpoints, then of 1, t and t^2 over a whole step."""
        if n_cells not in self._known:
            n = len(self.steps)
            out = np.zeros((n + 3, n_cells * SERIES_TERMS))
            out[n:] = _unit_step(n_cells) * self.dt ** np.array([[1], [2], [3]])
            if self.parts:
                steps, begin, end, coefficients = zip(*self.parts, strict=True)
                each = moments(np.array(begin), np.array(end), np.array(coefficients).T, self.dt, n_cells)
                np.add.at(out, np.searchsorted(self.steps, steps), each)
            self._known[n_cells] = out
        return self._known[n_cells]

    @cached_property
    def _known(self) -> dict[int, Floats]:
        return {}


def windowed(start: int, stop: int, acting: Callable[[int, int], _Acting], window: int | None) -> _Acting:
    """Return what acts from one step to another, computed for the first `window` steps; `further` has what follows.

    acting : computes it between two steps.
    window : steps; the end is rounded down to a multiple of it. None computes all.
    """
    end = stop if window is None else min((start // window + 1) * window, stop)
    first = acting(start, end)
    return replace(first, further=lambda: windowed(end, stop, acting, window)) if end < stop else first


@cache
def _unit_step(n_cells: int) -> Floats:
    """(3, n_cells SERIES_TERMS) moments of 1, t and t^2 over a step of 1 s."""
    return moments(np.zeros(3), np.ones(3), np.eye(3), 1.0, n_cells)


def compile_force(
    component: str,
    basis: ModalBasis,
    point: str,
    pieces: Sequence[Segment],
    dt: float,
    *,
    time: float = 0.0,
    first: int | None = None,
    factor: float = 1.0,
) -> list[Injection]:
    """Injections of a force on one point.

    Steps that lie inside one piece share three vectors (constant, linear and quadratic part); a step with a
    breakpoint gets a vector of its own, to which each part of the step adds exactly.

    pieces : in time order, not overlapping, times relative to `time`.
    dt : s, step.
    time : s, absolute time of the pieces' origin; step n is [n dt, (n + 1) dt].
    first : earliest step to compile (absolute); earlier ones are left out.
    factor : multiplies the force.
    """
    impulses = impulse_series(basis, real_form(basis), basis.index(point), dt)
    return Course.of(pieces, dt, time=time, first=first).injections(component, impulses, factor)


def controlled(system: System, controls: Sequence[PrescribedMotion], start: int, n: int) -> dict[int, Floats]:
    """Offset at the beginning and the end of each step, velocity and scale, (4, n), of connections under `controls`.

    Returns Index among the nonlinear connections -> array, of those that are controlled in the n steps from `start`.
    Raises ValueError : a control names no nonlinear connection.
    """
    nonlinear, out = system.nonlinear, dict[int, Floats]()
    if not controls:
        return out
    laws, index = ((), ()) if nonlinear is None else (nonlinear.laws, nonlinear.index)
    names = [system.connections[i].name for i in index]
    for control in controls:
        first, last = max(control.start, start), min(control.stop, start + n)
        if first >= last:
            continue
        if control.connection not in names:
            raise ValueError(f"no nonlinear connection {control.connection!r} to control")
        j = names.index(control.connection)
        if j not in out:
            out[j] = np.repeat([[laws[j].offset], [laws[j].offset], [laws[j].velocity], [1.0]], n, axis=1)
        here, there = slice(first - start, last - start), slice(first - control.start, last - control.start)
        if control.offset is not None:
            out[j][0, here], out[j][1, here] = control.offset[:-1][there], control.offset[1:][there]
        if control.velocity is not None:
            out[j][2, here] = control.velocity[there]
        if control.scale is not None:
            out[j][3, here] = control.scale[there]
    return out
