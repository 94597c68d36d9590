"""Passivity of a `ModalBasis` at the points where forces act: tested, or repaired.

`physics.passivity.conditions.check` and `physics.passivity.repair.repair` speak of poles and shapes alone. A basis
also has points that are only heard (no force acts there, so nothing can be gained there), modes that are second-order
blocks with shapes of another meaning, and a residual compliance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.modal.modes import BLOCK, ModalBasis
from tonewood.physics.passivity.conditions import PassivityReport, check

#: share of the largest element by which an eigenvalue of the residual compliance may be negative
_RESIDUAL = 1e-9


def check_basis(basis: ModalBasis, driven: Sequence[str], *, dt: float | None = None) -> PassivityReport:
    """Test whether forces at the points `driven` can draw energy from a component without end.

    It is passive in the sense of Willems (1972) if there is a stored energy V >= 0 with V' <= sum_i f_i y_i'.

    First-order modes (``PAIR``, ``REAL``) go through `physics.passivity.conditions.check`. ``BLOCK`` modes are passive
    by themselves when they are real modes of mass, stiffness and damping that are not negative, and faults otherwise.
    The residual compliance has to be positive semidefinite: connections store energy in it.

    Parameters
    ----------
    driven : names of points of the basis; repeated names count once.
    dt : s, step for which the compliance over one step is tested too.
    """
    rows = _rows(basis, driven)
    first = basis.kind != BLOCK
    report = check(basis.poles[first], basis.right[np.ix_(rows, first)], basis.left[np.ix_(rows, first)], dt=dt)
    faults = list(report.faults)
    block = ~first
    right, left = basis.right[np.ix_(rows, block)], basis.left[np.ix_(rows, block)]
    real = np.all(np.abs(left - right) <= 1e-12 * np.abs(left).max(initial=0.0)) and not np.any(right.imag)
    if not real or np.any(basis.damping_rate[block] < 0) or np.any(basis.stiffness[block] < 0):
        faults.append("rigid-body or overdamped modes with complex shapes, or negative damping or stiffness")
    residual = basis.residual[np.ix_(rows, rows)]
    smallest = _eigenvalues(residual)[0].min(initial=0.0)
    largest = np.abs(residual).max(initial=0.0)
    if smallest < -_RESIDUAL * largest:
        faults.append(f"residual compliance has the negative eigenvalue {smallest:.3g} m/N beside {largest:.3g} m/N")
    return replace(report, faults=tuple(faults), n_modes=basis.n_modes)


def repair_basis(basis: ModalBasis, driven: Sequence[str], *, max_change: float) -> ModalBasis:
    """Return the nearest basis that is passive at the points `driven`; other points stay as they are.

    The repair is described in the metadata under ``repair``.

    Parameters
    ----------
    basis : modes of one component.
    driven : names of points of the basis; repeated names count once.
    max_change : largest relative change of the response that is allowed, as for `physics.passivity.repair.repair`.

    Raises
    ------
    PassivityError : see `physics.passivity.repair.repair`.
    """
    from tonewood.physics.passivity.repair import repair

    rows = _rows(basis, driven)
    first = np.flatnonzero(basis.kind != BLOCK)
    at = np.ix_(rows, first)
    mended = repair(basis.poles[first], basis.right[at], basis.left[at], max_change=max_change)
    right, left = basis.right.copy(), basis.left.copy()
    right[at], left[at] = mended.right, mended.left
    residual, note = basis.residual.copy(), mended.summary()
    values, vectors = _eigenvalues(residual[np.ix_(rows, rows)])
    if values.min(initial=0.0) < 0.0:
        residual[np.ix_(rows, rows)] = (vectors * np.maximum(values, 0.0)) @ vectors.T
        note += f", residual compliance by {-values.min():.2g} m/N"
    return replace(basis, right=right, left=left, residual=residual, metadata={**basis.metadata, "repair": note})


def _rows(basis: ModalBasis, driven: Sequence[str]) -> NDArray[np.intp]:
    return np.array([basis.index(name) for name in dict.fromkeys(driven)], dtype=np.intp)


def _eigenvalues(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    values, vectors = np.linalg.eigh(matrix) if matrix.size else (np.zeros(0), np.zeros((0, 0)))
    return np.asarray(values), np.asarray(vectors)
