"""Real modes of a band from responses: noise, search, and modes without the phases that noise and damping gave them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tonewood.support.blas import one_blas_thread
from tonewood.workshop.fit import noise
from tonewood.workshop.fit.projection import Line, LinearFit, Poles, Projection, Shape
from tonewood.workshop.fit.search import DOUBT, Iteration, sought, straightened

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


#: median chi-squared of the residues' imaginary parts, 1 by chance, above which damping surely couples modes
TURNED = 30.0


@dataclass(frozen=True, eq=False)
class Modes:
    """Result of an identification.

    Attributes
    ----------
    problem : real residues on all bins, with the noise that was taken.
    poles : sorted.
    solution : residues (P, K + edges).
    bent : poles found with complex residues, before these were made real, and their problem.
    iterations : of the search, in order.
    turned : median chi-squared of the residues' imaginary parts; 1 by chance.
    """

    problem: Projection
    poles: Poles
    solution: LinearFit
    bent: tuple[Projection, Poles]
    iterations: list[Iteration]
    turned: float

    @property
    def misfit(self) -> float:
        """Chi-squared per number measured: 1 where the model leaves the noise and nothing else."""
        return self.solution.cost / self.problem.size

    def model(self) -> Complexes:
        """(P, N) mobility."""
        return self.problem.model(self.poles, self.solution.residues)


@one_blas_thread
def identify(
    freq: Floats,
    mobility: Complexes,
    shape: Shape,
    *,
    sigma: Floats | None = None,
    alpha: float = 0.0,
    tell: Callable[[Iteration], None] = lambda iteration: None,
) -> Modes:
    """Identify the modes of a band.

    Known noise is raised where a first fit leaves more: leakage and nonlinearity must not become modes. Unknown noise
    is taken from second differences first, then from the misfit of a fit.

    Parameters
    ----------
    freq : (N,) Hz, evenly spaced.
    mobility : (P, N) (m/s)/N on the line s = alpha + j 2 pi freq.
    sigma : (P, N) standard deviation of the complex error; None if not known.

    Raises
    ------
    NothingFoundError : no mode stands out of the noise.
    """
    iterations: list[Iteration] = []

    def note(iteration: Iteration) -> None:
        iterations.append(iteration)
        tell(iteration)

    together = noise.tied(alpha, float(freq[1] - freq[0]))
    level = noise.of_neighbours(mobility) if sigma is None else sigma * together
    start: Poles | None = None
    for last in (False, True):
        problem, start = sought(Line(freq, mobility, level, alpha), shape, start, note)
        if last:
            break
        residues = problem.solve(start).residues
        whole = Projection(Line(freq, mobility, level, alpha), shape)
        left = noise.of_misfit(whole.misfit(start, residues)) * together
        level = left if sigma is None else np.maximum(level, left)
    assert start is not None
    line = Line(freq, mobility, level, alpha)
    found = problem.solve(start)
    turned = float(np.median(found.chi2[:, len(start) : 2 * len(start)].mean(axis=0)))
    if turned < TURNED:
        # complex residues may stand for modes of their own: real ones that explain as much
        straight, more = sought(line, replace(shape, complex=False), start, note)
        if _akaike(straight, more) < _akaike(problem, start):
            start = more
    real, poles = straightened(line, shape, start)
    while (fewer := _without_idle_edges(real, poles)) != real.shape:
        # a residual term that is no passive body's, or none: modes near the band are sought in its place
        cost = real.solve(poles).cost
        shape = replace(shape, lower=fewer.lower, upper=fewer.upper)
        real, poles = straightened(line, shape, poles)
        if real.solve(poles).cost > cost + real.price:
            _, more = sought(line, replace(shape, complex=False), poles, note)
            real, poles = straightened(line, shape, more)
    poles = poles.damped_beyond(float(freq[0]), float(freq[-1]))
    return Modes(real, poles, real.solve(poles), (problem, start), iterations, turned)


def _without_idle_edges(problem: Projection, poles: Poles) -> Shape:
    """The residual terms that are surely positive somewhere, and surely negative nowhere, where the body was driven."""
    shape, driving = problem.shape, list(problem.shape.driving)
    if not (shape.lower or shape.upper):
        return shape
    ratio = problem.solve(poles).residues[driving] / problem.deviations(poles)[2][driving]
    kept = (np.any(ratio > DOUBT, axis=0) & np.all(ratio > -DOUBT, axis=0))[len(poles) :].tolist()
    lower = bool(shape.lower and kept[0])
    return replace(shape, lower=lower, upper=bool(shape.upper and kept[-1]))


def _akaike(problem: Projection, poles: Poles) -> float:
    """Akaike's criterion: chi-squared and twice the parameters. BIC would take coupled damping for modes."""
    each = 2 + (1 + problem.shape.complex) * problem.shape.free
    return problem.solve(poles).cost + 2 * each * len(poles)
