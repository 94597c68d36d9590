"""How many modes stand out of the noise, and where: a greedy search that ends at a maximum of the likelihood.

Modes are added where the whitened misfit has most to gain (a matched filter over frequency and Q), all poles are moved
together (Levenberg-Marquardt), modes that do not pay their price are taken away, and two that do the work of one are
joined. See `projection` for the model and the price.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
from numpy.typing import NDArray

from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: damping ratios of modes that the bins and the neighbouring modes can show; least bandwidth in steps of the bins
ZETA_LOW, ZETA_HIGH, NARROWEST = 1e-5, 0.35, 0.05
#: frequencies, re the ends of the band, up to which a pole may leave it: it stands for modes there
BELOW, ABOVE = 0.5, 1.6
#: standard deviations beyond which a residue's sign is taken to be known
DOUBT = 3.0
#: dB by which a mode has to change the fit; standard deviation of ln Q from which its Q is not known
CHANGE, UNKNOWN = 0.05, 0.1
#: Q of the matched filters
_QUALITIES = (3, 6, 12, 25, 50, 100, 200, 400, 800)
#: modes added in an iteration, and most iterations
_AT_ONCE, _ITERATIONS = 12, 16
#: chi-squared per number that counts as none; least damping of steps: the error that rounding makes in a step must be
#: far below the grid of the poles
_NOTHING, _LEAST_DAMPING = 1e-3, 1e-5
#: cost of one step of that grid, re the gain that ends a descent
_GRID = 1e-2
#: modes of a group that is moved by itself
_GROUP = 8
#: modes on each side that move with two that may be one; prices that these may cost there to be tried with all moving
_BESIDE, _DEARER = 2, 4.0


class NothingFoundError(ValueError):
    """No mode stands out of the noise."""


@dataclass(frozen=True)
class Iteration:
    """State of the search after one iteration: the stability chart of this method.

    Attributes
    ----------
    freq, quality : (K,) Hz and Q.
    misfit : chi-squared per number measured.
    """

    freq: Floats
    quality: Floats
    misfit: float


def descend(problem: Projection, poles: Poles, most: int, enough: float) -> tuple[Poles, LinearFit]:
    """Move poles downhill until a step gains less than `enough` of the cost, at most `most` steps.

    After each step poles are put on a grid, far finer than what a step is worth and far coarser than rounding: searches
    in which sums were rounded otherwise, of another processor, go through the same poles and take the same decisions.
    """
    band = problem.data.freq
    low, high = np.log(2 * np.pi * band[0] * BELOW), np.log(2 * np.pi * band[-1] * ABOVE)
    least = np.log(np.maximum(ZETA_LOW, 0.5 * NARROWEST * problem.data.step / poles.freq))
    k, damping = len(poles), 1e-3
    solution = problem.solve(poles, slopes=True)
    for _ in range(most):
        tolerance = enough * max(solution.cost, _NOTHING * problem.size)  # the cost of exact data is rounding
        curvature = np.diag(solution.normal)  # of directions that nothing tells it is rounding, of either sign
        unit = 1 / np.sqrt(np.maximum(curvature, 1e-12 * curvature.max()) + 1e-300)
        grid = np.exp2(np.floor(np.log2(unit * np.sqrt(_GRID * tolerance))))
        size, vectors = sla.eigh(solution.normal * np.outer(unit, unit))
        size, slope = np.maximum(size, 0.0), vectors.T @ (unit * solution.gradient)
        rejected = False
        for _ in range(6):
            step = unit * (vectors @ (slope / (size + damping)))
            zeta = np.exp(poles.log_zeta)
            moved = Poles(
                np.clip(_put(poles.log_freq + np.clip(step[:k], -zeta, zeta), grid[:k]), low, high),
                np.clip(_put(poles.log_zeta + np.clip(step[k:], -0.3, 0.3), grid[k:]), least, np.log(ZETA_HIGH)),
            )
            # the normal equations are as dear as the cost twice over: they are made at once, for a step is mostly taken
            there = problem.solve(moved, slopes=True)
            if there.cost < solution.cost - _GRID * tolerance:
                break
            damping, rejected = 8 * damping, True
        else:
            break
        done = solution.cost - there.cost < tolerance
        poles, solution, damping = moved, there, damping if rejected else max(damping / 8, _LEAST_DAMPING)
        if done:
            break
    order = np.argsort(poles.log_freq)
    if np.any(np.diff(order) < 0):
        poles = poles[order]
        solution = problem.solve(poles)
    return poles, solution


def _put(values: Floats, grid: Floats) -> Floats:
    """Nearest points of grids."""
    return np.asarray(np.round(values / grid) * grid)


def descend_in_groups(problem: Projection, poles: Poles, most: int) -> Poles:
    """Move neighbouring modes by themselves, group after group, on the bins around them; the others stay."""
    if len(poles) <= 2 * _GROUP:
        return descend(problem, poles, most, 1e-4)[0]
    residues, k = problem.solve(poles).residues, len(poles)
    freq, zeta = poles.log_freq.copy(), poles.log_zeta.copy()
    for first in range(0, k, _GROUP):
        mine = np.arange(first, min(first + _GROUP, k))
        around = _around(problem, poles, residues, mine)
        if around is None:
            continue
        part, _ = descend(around, poles[mine], most, 1e-3)
        freq[mine], zeta[mine] = part.log_freq, part.log_zeta
    return Poles(freq, zeta).sorted()


def _around(problem: Projection, poles: Poles, residues: Floats, mine: NDArray[np.intp]) -> Projection | None:
    """The problem of some neighbouring modes on the bins around them, less the others; None of too few bins."""
    k, n_kinds = len(poles), 1 + problem.shape.complex
    f, width = poles.freq[mine], 2 * poles.freq[mine] * np.exp(poles.log_zeta[mine])
    start = int(np.searchsorted(problem.data.freq, (f - 4 * width).min()))
    stop = int(np.searchsorted(problem.data.freq, (f + 4 * width).max()))
    if stop - start < 4 * len(mine):
        return None
    others = np.setdiff1d(np.arange(k), mine)
    rows = np.concatenate([others + m * k for m in range(n_kinds)])
    columns = problem.columns(poles)[0][rows, start:stop]
    return Projection(problem.data.cut(start, stop, residues[:, rows] @ columns), problem.shape)


def prices(problem: Projection, poles: Poles, solution: LinearFit) -> Floats:
    """(K,) chi-squared that each mode has to gain: the price, times the misfit per number around it if above 1.

    Where no number of modes reaches the noise, the misfit is the model's error. A mode that gains no more than chance
    would in noise of that size is no mode.
    """
    data = problem.data
    left = (np.abs(problem.misfit(poles, solution.residues)) ** 2 / data.sigma**2).mean(axis=0)
    total = np.concatenate([[0.0], np.cumsum(left)])
    first, stop = (np.searchsorted(data.freq, poles.freq + side * _reaches(data, poles)) for side in (-1, 1))
    count = np.maximum(stop - first, 1)
    return np.asarray(problem.price * np.maximum(1.0, (total[stop] - total[first]) / count))


def _reaches(data: FitData, poles: Poles) -> Floats:
    """(K,) Hz on both sides of modes: two bandwidths, and ten bins in all at least."""
    return np.asarray(2 * poles.freq / poles.quality + 5 * np.interp(poles.freq, data.freq, np.gradient(data.freq)))


def pruned(problem: Projection, poles: Poles, steps: int = 4) -> tuple[Poles, LinearFit]:
    """Take modes away that gain less than their price, or whose residue at a driving point is negative.

    Raises
    ------
    NothingFoundError : all are such.
    """
    while True:
        solution = problem.solve(poles)
        k = len(poles)
        n = (1 + problem.shape.complex) * k
        gain = solution.chi2[:, :n].reshape(-1, k).sum(axis=0)
        wrong = _never_positive(solution.residues[:, :k], solution.chi2[:, :k], problem.shape.driving)
        wrong |= _unresolved(poles, gain, problem.data)
        weak = np.flatnonzero(wrong | (gain < prices(problem, poles, solution)))
        if not weak.size or k <= 1:
            return poles, solution
        gone: list[int] = []
        zeta = np.exp(poles.log_zeta)
        for i in weak[np.argsort(np.where(wrong, 0.2, 1.0)[weak] * gain[weak])]:
            # neighbours stand in for each other: one of them at a time
            if all(abs(poles.log_freq[i] - poles.log_freq[j]) > 4 * (zeta[i] + zeta[j]) for j in gone):
                gone.append(int(i))
        if len(gone) == k:
            raise NothingFoundError("no mode that is passive stands out of the noise")
        poles, _ = descend(problem, poles.without(gone), steps, 1e-3)


def without_negative(problem: Projection, poles: Poles) -> Poles:
    """Leave out modes that would create energy; the others stay where they are."""
    while True:
        solution, k = problem.solve(poles), len(poles)
        wrong = _never_positive(solution.residues[:, :k], solution.chi2[:, :k], problem.shape.driving)
        if not wrong.any() or k <= 1:
            return poles
        # neighbours stand in for each other: the one that gains least at a time
        poles = poles.without([int(np.argmin(np.where(wrong, solution.chi2[:, :k].sum(axis=0), np.inf)))])


def _unresolved(poles: Poles, gain: Floats, data: FitData) -> NDArray[np.bool_]:
    """(K,) modes that lie within the distance of two bins of one that gains more: a peak's shape, not another mode."""
    near = np.abs(poles.freq[:, None] - poles.freq) < 2 * data.step
    narrow = poles.freq / poles.quality < 2 * data.step
    return np.asarray(np.any(near & narrow & (gain > gain[:, None]), axis=1))


def mains(problem: Projection, poles: Poles) -> NDArray[np.intp]:
    """Return which modes a few bins alone show: lines of the mains and the like.

    A mode narrower than two steps has to be worth its price in the bins beside its four best.
    """
    data, solution = problem.data, problem.solve(poles)
    k, step = len(poles), np.gradient(data.freq)
    weight, misfit = np.sqrt(2) / data.sigma, problem.misfit(poles, solution.residues)
    columns, out = problem.columns(poles)[0], []
    for i in np.flatnonzero(poles.freq / poles.quality < 2 * np.interp(poles.freq, data.freq, step)):
        if not data.freq[0] < poles.freq[i] < data.freq[-1]:
            continue
        rows = [i + m * k for m in range(1 + problem.shape.complex)]
        at_drive = solution.residues[:, rows] @ columns[rows]
        gain = ((np.abs(misfit + at_drive) ** 2 - np.abs(misfit) ** 2) * weight**2).sum(axis=0)
        if np.sort(gain)[:-4].sum() < problem.price:
            out.append(i)
    return np.array(out, dtype=np.intp)


def inaudible(problem: Projection, poles: Poles, required: Floats) -> NDArray[np.intp]:
    """Return the mode, if any, without which the fit changes least, and by less than 0.05 dB.

    The others' residues adapt; compared are the r.m.s. levels of data re model within two bandwidths, and ten bins at
    least, of the mode, at the response where it matters most. Without a driving point no sign of a residue shows which
    modes are a body's: there, one whose Q is not known within 10 % has to matter over the whole band: mostly it is a
    peak's departure from the model.
    """
    data, full, doubt = problem.data, problem.solve(poles), problem.deviations(poles)[1]
    level, around = np.abs(data.mobility), _reaches(problem.data, poles)
    best = _decibels(level, problem.model(poles, full.residues))
    least: tuple[float, int] = (CHANGE, -1)
    for i in range(len(poles) if len(poles) > 1 else 0):
        if required.size and np.abs(np.log(required / poles.freq[i])).min() < 0.03:
            continue
        fewer = poles.without([i])
        without = _decibels(level, problem.model(fewer, problem.solve(fewer).residues))
        reach = around[i]
        near = np.abs(data.freq - poles.freq[i]) <= reach
        if not near.any() or (
            doubt[i] > UNKNOWN and not problem.shape.driving
        ):  # beyond the band it stands for modes there
            near = np.ones_like(near)
        change = np.sqrt(np.mean(without[:, near] ** 2, axis=1)) - np.sqrt(np.mean(best[:, near] ** 2, axis=1))
        least = min(least, (float(change.max()), i))
    return np.array([least[1]] if least[1] >= 0 else [], dtype=np.intp)


def _decibels(level: Floats, model: Complexes) -> Floats:
    return np.asarray(20 * np.log10(np.maximum(np.abs(model), 1e-300) / np.maximum(level, 1e-300)))


def _never_positive(residues: Floats, chi2: Floats, driving: tuple[int, ...]) -> NDArray[np.bool_]:
    """(n,) modes that would create energy: negative at one driving point beyond doubt, or positive at none."""
    if not driving:
        return np.zeros(residues.shape[1], dtype=bool)
    at_drive, sure = residues[list(driving)], chi2[list(driving)] > DOUBT**2
    return np.asarray(np.any((at_drive < 0) & sure, axis=0) | np.all(at_drive <= 0, axis=0))


def joined(problem: Projection, poles: Poles) -> tuple[Poles, LinearFit]:
    """Put one pole in place of two that lie within their bandwidths wherever that costs less than the price of one."""
    solution, tried = problem.solve(poles), set()
    while True:
        zeta = np.exp(poles.log_zeta)
        near = sorted(
            ((poles.log_freq[j] - poles.log_freq[i]) / (zeta[i] + zeta[j]), i, j)
            for i in range(len(poles))
            for j in range(i + 1, min(i + 4, len(poles)))
        )
        pairs = [
            (i, j)
            for distance, i, j in near
            if distance < 1 and (round(poles.log_freq[i], 3), round(poles.log_freq[j], 3)) not in tried
        ]
        if not pairs:
            return poles, solution
        i, j = pairs[0]
        tried.add((round(poles.log_freq[i], 3), round(poles.log_freq[j], 3)))
        size = np.abs(solution.residues).max(axis=0)
        share = size[i] / max(size[i] + size[j], 1e-300)
        one = Poles(
            np.array([share * poles.log_freq[i] + (1 - share) * poles.log_freq[j]]),
            np.array([share * poles.log_zeta[i] + (1 - share) * poles.log_zeta[j]]),
        )
        if not _may_be_one(problem, poles, solution.residues, (i, j), one):
            continue
        fewer, there = descend(problem, poles.without([i, j]).joined(one), 6, 1e-4)
        if there.cost < solution.cost + prices(problem, poles, solution)[[i, j]].max():
            poles, solution = fewer, there


def _may_be_one(problem: Projection, poles: Poles, residues: Floats, pair: tuple[int, int], one: Poles) -> bool:
    """Whether one pole in place of two is worth a descent of all: on the bins around, with neighbours that move along.

    That costs more than with all of them moving, but not many times more.
    """
    i, j = pair
    mine = np.arange(max(i - _BESIDE, 0), min(j + _BESIDE + 1, len(poles)))
    around = _around(problem, poles, residues, mine)
    if around is None:
        return True
    two, gone = poles[mine], [i - int(mine[0]), j - int(mine[0])]
    _, fewer = descend(around, two.without(gone).joined(one), 6, 1e-4)
    solution = around.solve(two)
    return fewer.cost < solution.cost + _DEARER * float(prices(around, two, solution)[gone].max())


@dataclass(frozen=True, eq=False)
class MatchedFilters:
    """Bound the gain of one more mode, at every frequency and Q of a grid."""

    problem: Projection

    @cached_property
    def _grid(self) -> tuple[Floats, Floats]:
        freq, at, quality = self.problem.data.freq, [], []
        for q in _QUALITIES:
            # a resonance narrower than two bins cannot be distinguished from a wider one
            f = np.exp(np.arange(np.log(freq[0]), np.log(freq[-1]), 0.3 / q))
            f = f[f / q > 0.5 * np.interp(f, freq, np.gradient(freq))]
            at.append(f)
            quality.append(np.full(len(f), float(q)))
        return np.concatenate(at), np.concatenate(quality)

    @cached_property
    def _filters(self) -> tuple[list[sp.csr_array], Floats]:
        """Conjugate whitened resonances of each response, (grid, N), and their squared lengths, (P, grid)."""
        data, (at, quality) = self.problem.data, self._grid
        reach = 6 * at / quality + 3 * np.interp(at, data.freq, np.gradient(data.freq))
        first = np.searchsorted(data.freq, at - reach)
        count = np.searchsorted(data.freq, at + reach) - first
        row = np.repeat(np.arange(at.size), count)
        starts = np.concatenate([[0], np.cumsum(count)])
        bins = np.arange(starts[-1]) - np.repeat(starts[:-1], count) + np.repeat(first, count)
        s, w, q = data.s[bins], 2 * np.pi * at[row], quality[row]
        resonance = s / (s * s + (1j * w * w / q if self.problem.shape.structural else w / q * s) + w * w)
        filters, lengths = [], []
        for sigma in data.sigma:
            values = resonance.conj() * (np.sqrt(2) / sigma[bins])
            filters.append(sp.csr_array((values, bins, starts), shape=(at.size, data.freq.size)))
            lengths.append(np.add.reduceat(np.append(np.abs(values) ** 2, 0.0), starts[:-1]))
        return filters, np.array(lengths)

    def candidates(self, misfit: Complexes, most: int = _AT_ONCE) -> Poles:
        """At most so many modes that would each gain more than the price, none within another's bandwidth."""
        filters, lengths = self._filters
        at, quality = self._grid
        whitened = misfit * (np.sqrt(2) / self.problem.data.sigma)
        seen = np.array([(f @ w).real for f, w in zip(filters, whitened, strict=True)])
        gain = (seen**2 / np.maximum(lengths, 1e-300)).sum(axis=0)
        gain[_never_positive(seen, seen**2 / np.maximum(lengths, 1e-300), self.problem.shape.driving)] = 0.0
        out: list[int] = []
        for i in np.argsort(-gain):
            if gain[i] < self.problem.price or len(out) == most:
                break
            if all(abs(np.log(at[i] / at[j])) > 0.75 * (1 / quality[i] + 1 / quality[j]) for j in out):
                out.append(int(i))
        return Poles.at(at[out], quality[out])


def sought(
    data: FitData, shape: Shape, start: Poles | None = None, tell: Callable[[Iteration], None] = lambda iteration: None
) -> tuple[Projection, Poles]:
    """Modes that stand out of the noise, on thinned bins.

    Raises
    ------
    NothingFoundError : no mode gains its price.
    """
    problem = Projection(data.thinned(), shape)
    filters, poles = MatchedFilters(problem), start or Poles.none()
    best = np.inf
    if len(poles):
        best = problem.solve(poles).cost + problem.price * len(poles)
    for _ in range(_ITERATIONS):
        misfit = problem.misfit(poles, problem.solve(poles).residues) if len(poles) else problem.data.mobility
        new = filters.candidates(misfit)
        if not len(new):
            break
        more = descend_in_groups(problem, poles.joined(new), 8)
        more, solution = pruned(problem, descend(problem, more, 4, 1e-4)[0])
        total = solution.cost + problem.price * len(more)
        tell(Iteration(more.freq, more.quality, solution.cost / problem.size))
        if total >= best - 1:
            break
        poles, best = more, total
    if not len(poles):
        raise NothingFoundError("no mode stands out of the noise")
    poles, _ = pruned(problem, descend(problem, poles, 15, 1e-6)[0])
    return problem, joined(problem, poles)[0]


def straightened(data: FitData, shape: Shape, poles: Poles) -> tuple[Projection, Poles]:
    """Real residues to poles found with complex ones, on all bins: the nearest real modes. None is added."""
    real = Projection(data, replace(shape, complex=False))
    poles, _ = pruned(real, descend(real, poles, 8, 1e-5)[0])
    poles, _ = joined(real, poles)
    return real, descend(real, poles, 20, 1e-7)[0]
