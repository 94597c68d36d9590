"""Rigidly connected components at one frequency: free response plus the correction by constraint forces.

    y = H_oi u + H_oc f,    0 = H_ci u + H_cc f    =>    y = (H_oi - H_oc H_cc^+ H_ci) u,

with H the receptances of the uncoupled components between outputs (o), inputs (i) and gaps (c): the same formula as in
time, without any step.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tonewood.lab.methods.problem import Problem
from tonewood.physics.coupling.connections import Term
from tonewood.support.arrays import Complexes


def coupled_receptance(problem: Problem, freq: ArrayLike) -> Complexes:
    """(n_freq, n_outputs, n_inputs) m/N at frequencies in Hz."""
    f = np.atleast_1d(np.asarray(freq, dtype=np.float64))
    inputs, outputs = [(t,) for t in problem.inputs], [(t,) for t in problem.outputs]
    gaps = [c.terms for c in problem.constraints]
    H_oi, H_oc = _receptance(problem, f, outputs, inputs), _receptance(problem, f, outputs, gaps)
    H_ci, H_cc = _receptance(problem, f, gaps, inputs), _receptance(problem, f, gaps, gaps)
    inverse = np.linalg.pinv(H_cc, rcond=len(gaps) * np.finfo(np.float64).eps)
    return np.asarray(H_oi - H_oc @ inverse @ H_ci)


def _receptance(
    problem: Problem, freq: NDArray[np.float64], rows: Sequence[Sequence[Term]], columns: Sequence[Sequence[Term]]
) -> Complexes:
    """(n_freq, len(rows), len(columns)) of uncoupled components, between weighted sums of points."""
    out = np.zeros((len(freq), len(rows), len(columns)), dtype=np.complex128)
    responses: dict[tuple[str, str, str], Complexes] = {}
    for i, row in enumerate(rows):
        for j, column in enumerate(columns):
            for a in row:
                for b in column:
                    if a.component != b.component:
                        continue
                    key = (a.component, a.point, b.point)
                    if key not in responses:
                        responses[key] = problem.components[a.component].frf(freq, a.point, b.point, "receptance")
                    out[:, i, j] += a.factor * b.factor * responses[key]
    return out
