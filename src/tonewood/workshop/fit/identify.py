"""Real modes of a band from responses: noise, order, damping, and modes without the phases that noise gave them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.projection import FitData, LinearFit, Poles, Projection, Shape
from tonewood.workshop.fit.search import (
    DOUBT,
    Iteration,
    NothingFoundError,
    descend,
    inaudible,
    mains,
    pruned,
    sought,
    straightened,
    without_negative,
)  # fmt: skip

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: errors of a model, re the response, that the order search allows for, one after the other
ALLOWED = (0.3, 0.1, 0.03, 0.01, 0.003, 0.0)
#: least noise re the response: nobody measures better, and arithmetic of data made without noise is no measurement
LEAST_NOISE = 1e-4
#: misfit of a part of the band, re its noise, up to which it is noise; bins of such a part
_AT_NOISE, _PART = 1.25, 24
#: misfit, re the error allowed for, above which the model is further from the response, and more modes are not the cure
_REACHED = 10.0
#: median chi-squared of the residues' imaginary parts, 1 by chance, above which damping surely couples modes
TURNED = 30.0
#: difference of two kinds of damping, chi-squared per number measured, below which real residues decide
_CLOSE = 0.05
#: Q at which a required mode begins, and distance (of ln f) up to which a mode is the required one
_Q_WANTED, _NEAR = 50.0, 0.03


@dataclass(frozen=True, eq=False)
class Modes:
    """Result of an identification.

    Attributes
    ----------
    problem : real residues on all bins, with the noise that was taken.
    poles : sorted.
    solution : residues (P, K + edges).
    bent : the same of complex residues: what the responses say before a passive body is asked for.
    iterations : of the search, in order.
    mains : Hz, lines of one or two bins that are no modes and were muted.
    idle : Hz, modes within the band that were left out, for the fit is less than 0.05 dB worse without.
    turned : median chi-squared of the residues' imaginary parts; 1 by chance.
    """

    problem: Projection
    poles: Poles
    solution: LinearFit
    bent: tuple[Projection, Poles, LinearFit]
    iterations: list[Iteration]
    mains: tuple[float, ...] = ()
    idle: tuple[float, ...] = ()
    turned: float = 1.0

    @property
    def misfit(self) -> float:
        """Chi-squared per number measured, of complex residues: 1 where these leave the noise and nothing else."""
        problem, _, solution = self.bent
        return max(float(solution.cost / problem.size), 0.0)  # of data without noise it is rounding, of either sign

    @property
    def structural(self) -> bool:
        """Whether damping was taken for structural, else for viscous."""
        return self.problem.shape.structural

    def model(self) -> Complexes:
        """(P, N) mobility."""
        return self.problem.model(self.poles, self.solution.residues)

    @property
    def complexity(self) -> Floats:
        """(K,) of the bent poles: modal phase collinearity (Pappa, Elliott, Schenk 1993), 1 where all are in phase.

            MPC = ((S_xx - S_yy)^2 + 4 S_xy^2) / (S_xx + S_yy)^2,

        S of the residues' real and imaginary parts over the responses; 1 of one response alone.
        """
        _, poles, solution = self.bent
        x, y = np.split(solution.residues[:, : 2 * len(poles)], 2, axis=1)
        xx, yy, xy = (x * x).sum(axis=0), (y * y).sum(axis=0), (x * y).sum(axis=0)
        return np.asarray(((xx - yy) ** 2 + 4 * xy**2) / (xx + yy) ** 2)


@one_blas_thread
def identify(
    freq: Floats,
    mobility: Complexes,
    shape: Shape,
    *,
    sigma: Floats | None = None,
    alpha: float = 0.0,
    damping: str = "auto",
    keep: Sequence[float] = (),
    drop: Sequence[float] = (),
    least_error: float = 0.0,
    tell: Callable[[Iteration], None] = lambda iteration: None,
) -> Modes:
    """Identify the modes of a band.

    The order search allows for an error of the model of 30 % of the response first, then for less and less, and stops
    when the misfit is the noise's, or when more modes do not bring it nearer: leakage, nonlinearity and channels
    out of phase must not become modes. Noise that is not known is taken from fourth differences of bins, then from
    the misfit; known noise is raised where the misfit is larger.

    Parameters
    ----------
    freq : (N,) Hz, rising.
    mobility : (P, N) (m/s)/N on the line s = alpha + j 2 pi freq.
    shape : rows that are driving points, number of points, and residual terms.
    sigma : (P, N) standard deviation of the complex error; None if not known.
    damping : viscous, structural, or auto: the one that needs fewer modes for a better fit.
    keep, drop : Hz, where a mode has to be, whatever it gains, and where none may be.
    least_error : of a model, re the response, below which no mode is sought: what is not linear must not become modes.
    tell : called after each iteration of the search.

    Raises
    ------
    NothingFoundError : no mode stands out of the noise.
    LookupError : there is no mode where one is to be dropped.
    """
    iterations: list[Iteration] = []

    def note(iteration: Iteration) -> None:
        iterations.append(iteration)
        tell(iteration)

    data = FitData(freq, mobility, np.ones_like(mobility, dtype=np.float64), alpha)
    together = noise.tied(alpha, data.step)
    least = LEAST_NOISE * np.abs(mobility)
    level = np.maximum(noise.of_neighbours(mobility) if sigma is None else sigma * together, least)
    data = replace(data, sigma=level)
    bins = 2 * mobility.size
    kinds = {"viscous": (False,), "structural": (True,), "auto": (False, True)}[damping]
    orders: list[_Order] = []
    for structural in kinds:
        kind = replace(shape, structural=structural)
        with suppress(NothingFoundError):
            orders.append(_ordered(data, kind, least_error, note))
    if not orders:
        raise NothingFoundError("no mode stands out of the noise")
    least_allowed = min(order.allowed for order in orders)
    best = min(orders, key=lambda order: order.total(least_allowed))
    if shape.driving and len(orders) == 2 and np.ptp([order.total(least_allowed) for order in orders]) < _CLOSE * bins:
        best = min(orders, key=lambda order: order.total_of_real(least_allowed))
    data, shape, start, lines = best.weighed(best.allowed), best.shape, best.poles, best.lines
    required = Poles.at(keep, np.full(len(keep), _Q_WANTED))
    for f in drop:
        if not any(abs(np.log(start.freq[i] / f)) < _reach(start, i) for i in range(len(start))):
            near = start.freq[np.argmin(np.abs(np.log(start.freq / f)))]
            raise LookupError(f"there is no mode at {f:g} Hz; the nearest is at {near:.5g} Hz")
    bent = Projection(data, shape)
    solution = bent.solve(start)
    misfit = bent.misfit(start, solution.residues)
    if best.allowed:
        left = data.sigma * np.sqrt(np.median(np.abs(misfit / data.sigma) ** 2, axis=1, keepdims=True) / np.log(2))
    else:
        left = noise.of_misfit(misfit, bent.model(start, solution.residues)) * together
    level = np.maximum(left, least if sigma is None else level)
    data = replace(data, sigma=level).without(lines) if lines else replace(data, sigma=level)
    bent = Projection(data, shape)
    idle: list[float] = []
    start = _fixed(bent, pruned(bent, descend(bent, start, 20, 1e-7)[0])[0], required, drop, idle)
    start, solution = descend(bent, start, 20, 1e-8)
    turned = float(np.median(solution.chi2[:, len(start) : 2 * len(start)].mean(axis=0)))
    real, poles = Projection(data, replace(shape, complex=False)), start
    # where damping couples modes, poles that real residues would move are further from the truth than those at hand
    driven = turned > TURNED and bool(shape.driving)
    while True:
        if driven:
            poles = without_negative(real, poles)
        else:
            poles = _fixed(real, straightened(data, real.shape, poles)[1], required, drop, [])
            poles, _ = descend(real, poles, 20, 1e-8)
        if (fewer := _without_idle_edges(real, poles)) == real.shape:
            break
        real = Projection(data, fewer)
    poles = poles.damped_beyond(float(freq[0]), float(freq[-1]))
    return Modes(real, poles, real.solve(poles), (bent, start, solution), iterations, lines, tuple(idle), turned)


@dataclass(frozen=True, eq=False)
class _Order:
    """Modes of one kind of damping, as many as the responses show.

    Attributes
    ----------
    data : with muted bins; lines are their frequencies, Hz.
    allowed : error of the model, re the response, where all of the band is that far above its noise; else 0.
    """

    data: FitData
    shape: Shape
    poles: Poles
    lines: tuple[float, ...]
    allowed: float = 0.0

    def weighed(self, allowed: float) -> FitData:
        """Return the data with noise and an allowed error of the model."""
        return replace(self.data, sigma=np.hypot(self.data.sigma, allowed * np.abs(self.data.mobility)))

    def total(self, allowed: float) -> float:
        """Chi-squared and the price of the modes."""
        problem = Projection(self.weighed(allowed), self.shape)
        return problem.solve(self.poles).cost + problem.price * len(self.poles)

    def total_of_real(self, allowed: float) -> float:
        """The same of modes with real residues, which tell kinds of damping apart where complex ones adapt."""
        problem, real = straightened(self.weighed(allowed).thinned(), self.shape, self.poles)
        return problem.solve(real).cost + problem.price * len(real)


def _ordered(data: FitData, shape: Shape, least_error: float, note: Callable[[Iteration], None]) -> _Order:
    """Modes, as many as it takes until the misfit is noise."""
    size, poles = np.abs(data.mobility), Poles.none()
    lines: tuple[float, ...] = ()
    best: _Order | None = None
    before = left = np.inf
    floor = float(np.median(data.sigma / np.maximum(size, 1e-300)))
    for allowed in ALLOWED:
        if 0 < allowed < 0.3 * floor or allowed < least_error or (allowed == 0 and floor < ALLOWED[-2]):
            continue
        while True:
            level = replace(data, sigma=np.hypot(data.sigma, allowed * size))
            try:
                problem, poles = sought(level, shape, poles if len(poles) else None, note)
            except NothingFoundError:
                break
            more = mains(problem, poles)
            if not more.size:
                break
            muted = [f for f in poles.freq[more] if not any(abs(f - old) < data.step for old in lines)]
            poles = poles.without(more.tolist())
            if not muted:  # its bins are muted already: what is left is at their edges
                break
            lines, data = (*lines, *muted), data.without(muted)
        if not len(poles):
            continue
        reached = problem.solve(poles).cost < _REACHED * problem.size
        fine, _ = descend(Projection(data, shape), poles, 20, 1e-6)
        loud, cost = _parts_above_noise(data, shape, fine), Projection(data, shape).solve(fine).cost
        nearer = reached and (loud < before or (loud == 1 and cost < 0.5 * left))
        if best is not None and not nearer and len(poles) > len(best.poles):
            break
        if loud < 1:
            best = _Order(data, shape, fine, lines)
        elif reached or best is None:  # weights of the noise would follow its errors, not the modes
            best = _Order(data, shape, poles, lines, allowed)
        before, left = loud, cost
        if not loud:
            break
    if best is None:
        raise NothingFoundError("no mode stands out of the noise")
    return best


def _parts_above_noise(data: FitData, shape: Shape, poles: Poles) -> float:
    """Share of the parts of the band, of all responses, whose misfit is above the noise in most of their bins."""
    whole = Projection(data, shape)
    ratio = np.log(np.abs(whole.misfit(poles, whole.solve(poles).residues)) / data.sigma + 1e-300)
    starts = np.arange(0, ratio.shape[1], _PART)
    mean = np.add.reduceat(np.clip(ratio, -5, 5), starts, axis=1) / np.diff(np.append(starts, ratio.shape[1]))
    # of complex Gaussian noise ln |e| / sigma is half of Euler's constant below 0
    return float(np.mean(mean > np.log(_AT_NOISE) - 0.5 * np.euler_gamma))


def _reach(poles: Poles, i: int) -> float:
    """Distance of ln f up to which a frequency names a mode."""
    return float(max(_NEAR, 0.5 / poles.quality[i]))


def _fixed(problem: Projection, poles: Poles, required: Poles, drop: Sequence[float], idle: list[float]) -> Poles:
    """Modes less those dropped and those whose absence nobody would see (noted in `idle`), with those `required`."""
    gone = [i for i in range(len(poles)) if any(abs(np.log(poles.freq[i] / f)) < _reach(poles, i) for f in drop)]
    poles = descend(problem, poles.without(gone), 6, 1e-6)[0] if gone else poles
    while len(weak := inaudible(problem, poles, required.freq)):
        idle += [float(f) for f in poles.freq[weak] if problem.data.freq[0] < f < problem.data.freq[-1]]
        poles = descend(problem, poles.without(weak.tolist()), 6, 1e-6)[0]
    missing = [f for f in required.freq if not len(poles) or np.abs(np.log(poles.freq / f)).min() > _NEAR]
    if missing:
        poles = descend(problem, poles.joined(Poles.at(missing, [_Q_WANTED] * len(missing))), 12, 1e-6)[0]
    return poles


def _without_idle_edges(problem: Projection, poles: Poles) -> Shape:
    """The residual terms that are surely positive somewhere, and surely negative nowhere, where the body was driven."""
    shape, driving = problem.shape, list(problem.shape.driving)
    if not (shape.lower or shape.upper):
        return shape
    ratio = problem.solve(poles).residues[driving] / problem.deviations(poles)[2][driving]
    kept = (np.any(ratio > DOUBT, axis=0) & np.all(ratio > -DOUBT, axis=0))[len(poles) :].tolist()
    lower = bool(shape.lower and kept[0])
    return replace(shape, lower=lower, upper=bool(shape.upper and kept[-1]))
