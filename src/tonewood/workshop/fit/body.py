"""A passive body from residues: real modes with one shape per point.

A real mode has A_ij = phi_i phi_j at every pair of points: positive where it is driven, of rank one, symmetric.
Residues of a fit have noise, so the nearest such shapes are taken; `FittedBody.mobility` shows the error of that.

* One reference r: phi_r = sqrt(A_rr), phi_i = A_ir / phi_r. Pairs of undriven points were not measured and follow from
  rank one; they have been 1 to 4 dB off (r.m.s.) where two modes coincide, which one reference cannot tell apart.
* Several: A_ij and A_ji averaged (reciprocity), eigenvectors whose eigenvalues stand out of the noise; two of them are
  coincident modes, two rows of the table.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.fit.identify import Modes

#: standard deviations by which a residual term, and a second shape at one pole, have to stand out
_CLEAR = 3.0
#: the row that stands for modes below the band: at this share of its lowest frequency, at the least of an instrument's
#: table (Hz), and with this Q
_LOWER_SHARE, _LOWER_LEAST, _LOWER_Q = 1 / 8, 1e-3, 5.0
#: a pole that is damped more is background, no mode
LEAST_QUALITY = 2.0


@dataclass(frozen=True, eq=False)
class FittedBody:
    """Real modes at some points.

    Attributes
    ----------
    points : names of the columns of `shapes`.
    freq, quality : (K,) Hz and Q.
    shapes : (K, n_points) mass-normalised, 1/sqrt(kg).
    compliance : (n_points, n_points) m/N of modes above the band; positive semidefinite.
    cents, quality_error, shape_error : (K,) one standard deviation: of the frequency in cents, of Q relative, of the
        shape at the driving point relative; nan of the row that stands for the modes below the band.
    measured : (K,) whether the mode lies in the band.
    dropped : modes and channels left out and why, a line each.
    """

    points: tuple[str, ...]
    freq: Floats
    quality: Floats
    shapes: Floats
    compliance: Floats
    cents: Floats
    quality_error: Floats
    shape_error: Floats
    measured: NDArray[np.bool_]
    dropped: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<FittedBody of {self.freq.size} modes at {', '.join(self.points)}>"

    def mobility(self, freq: Floats, pairs: tuple[tuple[str, str], ...], alpha: float = 0.0) -> Complexes:
        """Return the mobility (P, N), (m/s)/N, at some pairs of points, on s = alpha + j 2 pi freq."""
        s = alpha + 2j * np.pi * freq
        w = 2 * np.pi * self.freq[:, None]
        resonance = s / (s * s + w / self.quality[:, None] * s + w * w)
        at = [(self.points.index(i), self.points.index(j)) for i, j in pairs]
        return np.array(
            [(self.shapes[:, i] * self.shapes[:, j]) @ resonance + self.compliance[i, j] * s for i, j in at]
        )


def passive_body(modes: Modes, pairs: tuple[tuple[str, str], ...]) -> FittedBody:
    """The passive body nearest to some modes.

    modes : with real residues at `pairs`.
    pairs : (point, reference) of each row of their residues.
    """
    points = tuple(dict.fromkeys(name for pair in pairs for name in pair))
    problem, poles, residues = modes.problem, modes.poles, modes.solution.residues
    by_freq, by_zeta, errors = problem.deviations(poles)
    k, band = len(poles), problem.data.freq
    rows: list[tuple[float, float, Floats, float, float, float]] = []
    dropped: list[str] = []
    for i in range(k):
        shapes, error = _shapes(residues[:, i], errors[:, i], pairs, points, certain=True)
        freq, quality = float(poles.freq[i]), float(poles.quality[i])
        if not shapes:
            dropped.append(f"mode at {freq:.1f} Hz: negative residue at the driving point")
        for shape in shapes:
            rows.append((freq, quality, shape, 1200 / np.log(2) * by_freq[i], by_zeta[i], 0.5 * error))
    compliance = np.zeros((len(points), len(points)))
    edge = k
    if problem.shape.lower:
        shapes, _ = _shapes(residues[:, edge], errors[:, edge], pairs, points, certain=False)
        edge += 1
        for shape in shapes:
            there = shape * np.sqrt(problem.scale)
            rows.append((max(band[0] * _LOWER_SHARE, _LOWER_LEAST), _LOWER_Q, there, np.nan, np.nan, np.nan))
    else:
        dropped.append("mass line of modes below the band: not above its noise")
    if problem.shape.upper:
        shapes, _ = _shapes(residues[:, edge], errors[:, edge], pairs, points, certain=False)
        compliance = sum((np.outer(x, x) for x in shapes), compliance) / problem.scale
    else:
        dropped.append("compliance of modes above the band: not above its noise")
    rows.sort(key=lambda row: row[0])
    freq_all = np.array([row[0] for row in rows])
    return FittedBody(
        points,
        freq_all,
        np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]).reshape(-1, len(points)),
        np.asarray(compliance),
        np.array([row[3] for row in rows]),
        np.array([row[4] for row in rows]),
        np.array([row[5] for row in rows]),
        (freq_all >= band[0])
        & (freq_all <= band[-1])
        & np.array([np.isfinite(row[3]) and row[1] >= LEAST_QUALITY for row in rows], dtype=bool),
        tuple(dropped),
    )


def _shapes(
    residues: Floats, errors: Floats, pairs: tuple[tuple[str, str], ...], points: tuple[str, ...], *, certain: bool
) -> tuple[list[Floats], float]:
    """Shapes whose products are these residues, strongest first, and the relative error of the driving residue.

    `certain`: one shape is there and needs not stand out of the noise.
    """
    references = list(dict.fromkeys(reference for _, reference in pairs))
    at = {pair: i for i, pair in enumerate(pairs)}
    if len(references) == 1:
        r = references[0]
        driving = at[r, r]
        if residues[driving] <= (0.0 if certain else _CLEAR * errors[driving]):
            return [], np.inf
        shape = np.array([residues[at[name, r]] for name in points]) / np.sqrt(residues[driving])
        return [shape], float(errors[driving] / residues[driving])
    matrix, weight = np.zeros((len(points), len(points))), np.zeros((len(points), len(points)))
    for (i, j), row in at.items():
        p, q = points.index(i), points.index(j)
        for a, b in {(p, q), (q, p)}:  # a driving point is one entry
            precision = 1 / max(errors[row], 1e-300) ** 2
            matrix[a, b] += precision * residues[row]
            weight[a, b] += precision
    measured = weight > 0
    matrix[measured] /= weight[measured]
    noise = float(np.sqrt(1 / weight[measured].min()))
    values, vectors = sla.eigh(matrix)
    shapes: list[Floats] = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        first = certain and not shapes
        if value > (0.0 if first else 1.5 * _CLEAR * noise):
            shapes.append(vector * np.sqrt(value) * np.sign(vector[np.argmax(np.abs(vector))]))
    return shapes, noise / max(float(values[-1]), 1e-300)
