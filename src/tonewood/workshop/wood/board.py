"""Constants of a wood from the frequencies and losses of a free rectangular plate, with intervals.

Sought are E_L, E_R and G_LR. Poisson's ratio, the shear moduli through the thickness and the error of the thickness are
unknown, too: they have prior distributions, and widen the intervals by as much as they matter. Peaks and modes are
paired so that sum min((ln f_k - ln f_m)^2 / s^2, 9) + (modes without a peak) is least; a peak that fits no mode, and a
mode without a peak, are allowed and stated. The constants then minimise the squares over the pairs and the priors
(Gauss-Newton); the covariance is (J^T J)^-1, enlarged by the misfit where that is more than the errors explain.

Loss factors are those of the energies: 1/Q_k = sum_i eta_i U_ik, U the shares of E_L (with half of the coupling Q12),
E_R (with the other half) and shear, by least squares with eta >= 0. They contain what the plate radiates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tonewood.physics.plate.wood import SPECIES, Wood
from tonewood.support.arrays import Floats, Indices
from tonewood.workshop.wood.rectangle import Rectangle

#: standard normal deviate of a two-sided interval of 90 %
NORMAL_90 = 1.645
#: standard deviation of ln f by the plate's own faults: grain that is not straight, density that is not even
MODEL_ERROR = 0.004
#: loss factors that are estimated; standard deviation of 1 / Q, relative, at least: each support takes some
LOSSES, _Q_ERROR = ("loss_L", "loss_R", "loss_shear"), 0.1
#: share of the energy above which a mode is of one kind
_MAINLY = 0.8
#: s of the pairing: at first, and of the last rounds
_FIRST, _LAST = 0.04, 0.012
#: standard deviations of the priors: ln E_L, ln E_R, ln G_LR, nu_LR, ln (G_LT / E_L), ln (G_RT / E_L)
_PRIOR = np.array([0.5, 0.6, 0.7, 0.08, 0.5, 0.7])
#: steps of ln E_L, ln E_R, ln G_LR among which starts are chosen by the lowest peaks; number of starts
_GRID = (np.linspace(-0.6, 0.4, 6), np.linspace(-0.6, 0.6, 7), np.linspace(-1.2, 0.6, 10))
_LOWEST, _STARTS = 8, 8
#: kg, standard deviation of a sensor's mass that is not known; gain, in squares over variances, from which there is one
_SENSOR, _SENSOR_GAIN = 1e-3, NORMAL_90**2
#: kg, least mass in slopes at 0: the mass matrix stays positive
_LEAST_SENSOR = -2e-4
#: unmatched modes and peaks in the cost of a pairing
_NO_PEAK, _NO_MODE = 1.0, 9.0


@dataclass(frozen=True, slots=True)
class MatchedPeak:
    """A peak and its mode.

    measured, computed : Hz.
    shares : (3,) of E_L, E_R and shear in its energy.
    q : of the peak, 0 where it is not known.
    """

    measured: float
    computed: float
    shares: tuple[float, float, float]
    q: float

    @property
    def kind(self) -> str:
        """What its energy is of for the most part, in words."""
        name = ("bending along", "bending across", "twist")[int(np.argmax(self.shares))]
        return name if max(self.shares) > _MAINLY else f"mixed, most {name}"


@dataclass(frozen=True, eq=False)
class Board:
    """Constants of a board.

    wood : density, constants, and loss factors where taps had Q.
    intervals : name -> 90 % interval of E_L, E_R, G_LR (Pa), loss_L, loss_R, loss_shear.
    pairs : peaks that were used.
    peaks_without_mode, modes_without_peak : Hz.
    misfit : root mean square of (ln f_k - ln f_m) over the pairs.
    sensor : kg, mass of a sensor at a corner that was taken into account.
    """

    wood: Wood
    intervals: dict[str, tuple[float, float]]
    pairs: tuple[MatchedPeak, ...]
    peaks_without_mode: tuple[float, ...]
    modes_without_peak: tuple[float, ...]
    misfit: float
    sensor: float = 0.0


def estimate_board(
    plate: Rectangle,
    freq: Sequence[float],
    errors: Sequence[float],
    q: Sequence[float] = (),
    *,
    thickness_error: float = 5e-5,
    size_error: float = 5e-4,
    model_error: float = MODEL_ERROR,
    prior: Wood | None = None,
    sensor: float | None = None,
) -> Board:
    """Estimate the constants of a plate's wood.

    plate : of its size and mass.
    freq, errors : (n,) Hz, peaks and their standard deviations.
    q : (n,) quality factors; losses are not estimated without them.
    thickness_error, size_error : m, standard deviations of thickness, and of length and width.
    model_error : standard deviation of ln f by the plate's own faults.
    prior : wood about which the constants are sought; that of `plate` where left out.
    sensor : kg, mass of a sensor that stood at a corner, 0 for a microphone; None to seek one, which is taken into
        account if the sum of squares is smaller by 2.7 with it, as chance has it in one of twenty boards without one.
    Raises ValueError : fewer than three peaks, or none that fits.
    """
    peaks, spread, quality = sorted_peaks(freq, errors, q, model_error)
    if len(peaks) < 3:
        raise ValueError(f"{len(peaks)} peaks; 3 or more are wanted, for three constants")
    problem = _Problem(plate, thickness_error, prior or plate.nominal, sensor or 0.0)
    fits = [problem.refined(start, peaks, spread) for start in problem.starts(peaks)]
    theta, (i, j), _ = min(fits, key=lambda fit: fit[2])
    if len(i) < 3:
        raise ValueError("fewer than three peaks fit any wood; are size, mass and frequencies right?")
    if sensor is None:
        other = _Problem(plate, thickness_error, prior or plate.nominal, 0.0, _SENSOR)
        more, pairs_there, _ = other.refined(theta, peaks, spread)
        gain = problem.squares(theta, (i, j), peaks, spread) - other.squares(more, pairs_there, peaks, spread)
        if more[-1] > 0 and len(pairs_there[0]) >= len(i) and gain > _SENSOR_GAIN:
            problem, theta, (i, j), sensor = other, more, pairs_there, float(more[-1])
    wood, thick, mass = problem.wood(theta)
    modes, shares = plate.solution(wood, thick, mass)
    residuals = np.log(peaks[i] / modes[j])
    covariance = problem.covariance(theta, j, spread[i], residuals)
    errors_of = np.sqrt(np.diag(covariance)[:3])
    # at a given mass E_L follows f^2 L^3 / W, E_R f^2 W^3 / L, G_LR f^2 L W
    long, cross = size_error / plate.length, size_error / plate.width
    sizes = np.array([np.hypot(3 * long, cross), np.hypot(long, 3 * cross), np.hypot(long, cross)])
    errors_of = np.hypot(errors_of, sizes)
    values = {"E_L": wood.E_L, "E_R": wood.E_R, "G_LR": wood.G_LR}
    intervals = {
        name: (value * np.exp(-NORMAL_90 * e), value * np.exp(NORMAL_90 * e))
        for (name, value), e in zip(values.items(), errors_of, strict=True)
    }
    grouped = np.array([shares[0] + shares[2] / 2, shares[1] + shares[2] / 2, shares[3] + shares[4] + shares[5]])
    losses, loss_intervals = losses_of(quality[i], grouped[:, j].T, LOSSES)
    pairs = tuple(
        MatchedPeak(float(peaks[a]), float(modes[b]), (g[0], g[1], g[2]), float(quality[a]))
        for a, b, g in zip(i, j, grouped[:, j].T.tolist(), strict=True)
    )
    missing = np.setdiff1d(np.flatnonzero(modes < peaks[i].max()), j)
    return Board(
        wood=replace(wood, density=plate.nominal.density, **losses),
        intervals=intervals | loss_intervals,
        pairs=pairs,
        peaks_without_mode=tuple(map(float, np.delete(peaks, i))),
        modes_without_peak=tuple(map(float, modes[missing])),
        misfit=float(np.sqrt(np.mean(residuals**2))),
        sensor=sensor or 0.0,
    )


class _Problem:
    """Least squares in theta: ln E_L, ln E_R, ln G_LR, nu_LR, ln (G_LT / E_L), ln (G_RT / E_L), ln h, sensor (kg)."""

    def __init__(self, plate: Rectangle, thickness_error: float, n: Wood, sensor: float, sensor_error: float = 1e-9):
        self.plate = plate
        self.mean = np.array([np.log(n.E_L), np.log(n.E_R), np.log(n.G_LR), n.nu_LR, np.log(n.G_LT / n.E_L),
                              np.log(n.G_RT / n.E_L), np.log(plate.thickness), sensor])  # fmt: skip
        self.sd = np.array([*_PRIOR, thickness_error / plate.thickness, sensor_error])

    def wood(self, theta: Floats) -> tuple[Wood, float, float]:
        """Wood, thickness (m), and mass of the sensor (kg)."""
        long, cross, shear, nu, g_lt, g_rt, h, sensor = theta
        e = np.exp(long)
        nu = min(max(nu, 0.01), 0.9 * float(np.sqrt(e / np.exp(cross))))
        wood = Wood(float(e), float(np.exp(cross)), float(np.exp(shear)), float(nu), self.plate.nominal.density,
                    G_LT=float(e * np.exp(g_lt)), G_RT=float(e * np.exp(g_rt)))  # fmt: skip
        return wood, float(np.exp(h)), max(float(sensor), _LEAST_SENSOR)

    def log_freq(self, theta: Floats) -> Floats:
        """Logarithms of the modes' frequencies."""
        return np.log(np.maximum(self.plate.solution(*self.wood(theta))[0], 1e-3))

    def squares(self, theta: Floats, pairs: tuple[Indices, Indices], peaks: Floats, spread: Floats) -> float:
        """Sum of squares over the pairs and the priors, re their variances."""
        i, j = pairs
        left = (np.log(peaks[i]) - self.log_freq(theta)[j]) / spread[i]
        return float(np.sum(left**2) + np.sum(((theta - self.mean) / self.sd) ** 2))

    def starts(self, peaks: Floats) -> list[Floats]:
        """The best woods of a grid about the nominal one."""
        grid = np.array(np.meshgrid(*_GRID, indexing="ij")).reshape(3, -1).T
        few, costs = np.log(peaks[:_LOWEST]), []
        for step in grid:
            theta = self.mean.copy()
            theta[:3] += step
            costs.append(_paired(few, self.log_freq(theta), _FIRST)[1] + float(np.sum((step / self.sd[:3]) ** 2)))
        best = np.argsort(costs)[:_STARTS]
        return [np.concatenate([self.mean[:3] + grid[k], self.mean[3:]]) for k in best]

    def refined(self, theta: Floats, peaks: Floats, spread: Floats) -> tuple[Floats, tuple[Indices, Indices], float]:
        """Constants, pairs and cost from a start."""
        for s in (_FIRST, _FIRST / 1.5, 0.02, _LAST, _LAST, _LAST):
            (i, j), cost = _paired(np.log(peaks), self.log_freq(theta), s)
            if len(i) < 3:
                return theta, (i, j), np.inf
            for _ in range(2):
                jacobian, f = self._slopes(theta, j)
                rows = np.vstack([jacobian / spread[i, None], np.diag(1 / self.sd)])
                right = np.concatenate([(np.log(peaks[i]) - f) / spread[i], (self.mean - theta) / self.sd])
                theta = theta + np.clip(np.linalg.lstsq(rows, right, rcond=None)[0], -0.4, 0.4)
        (i, j), cost = _paired(np.log(peaks), self.log_freq(theta), _LAST)
        return theta, (i, j), cost + float(np.sum(((theta - self.mean) / self.sd) ** 2))

    def _slopes(self, theta: Floats, modes: Indices) -> tuple[Floats, Floats]:
        """(modes, 8) derivatives of some ln f by theta, and these ln f."""
        f = self.log_freq(theta)[modes]
        jacobian = np.empty((len(modes), len(theta)))
        for k in range(len(theta)):
            step = np.zeros(len(theta))
            step[k] = size = 1e-4 if k < len(theta) - 1 else 1e-5
            jacobian[:, k] = (self.log_freq(theta + step)[modes] - self.log_freq(theta - step)[modes]) / (2 * size)
        return jacobian, f

    def covariance(self, theta: Floats, modes: Indices, spread: Floats, residuals: Floats) -> Floats:
        """(8, 8) of theta."""
        jacobian, _ = self._slopes(theta, modes)
        information = (jacobian / spread[:, None]).T @ (jacobian / spread[:, None])
        freedom = max(len(modes) - 3, 1)
        worse = max(1.0, float(np.sum((residuals / spread) ** 2)) / freedom)
        return np.asarray(np.linalg.inv(information / worse + np.diag(1 / self.sd**2)), dtype=np.float64)


def _paired(peaks: Floats, modes: Floats, s: float) -> tuple[tuple[Indices, Indices], float]:
    """Pairs of peaks and modes, all as ln f, and their cost."""
    from scipy.optimize import linear_sum_assignment

    cost = np.minimum(((peaks[:, None] - modes) / s) ** 2, _NO_MODE)
    i, j = linear_sum_assignment(cost)
    good = cost[i, j] < _NO_MODE
    total = float(cost[i, j].sum())
    i, j = i[good], j[good]
    if len(i):
        total += _NO_PEAK * (np.count_nonzero(modes < peaks[i].max() + 1e-9) - len(i))
    return (i, j), total


def sorted_peaks(
    freq: Sequence[float], errors: Sequence[float], q: Sequence[float], model_error: float
) -> tuple[Floats, Floats, Floats]:
    """Peaks by rising frequency (Hz), their standard deviations re it with that of the model, and Q; 0: not known."""
    order = np.argsort(freq)
    peaks = np.asarray(freq, dtype=np.float64)[order]
    spread = np.hypot(np.asarray(errors, dtype=np.float64)[order] / peaks, model_error)
    return peaks, spread, np.asarray(q, dtype=np.float64)[order] if len(q) else np.zeros(len(peaks))


def losses_of(
    q: Floats, shares: Floats, names: Sequence[str], fewest: int = 4
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Loss factors and their 90 % intervals from the peaks' Q; nothing where fewer than `fewest` have one.

    q : (n,), 0 where not known.
    shares : (n, losses) of each kind of stiffness in the energy.
    names : of the losses.
    """
    from scipy.optimize import nnls

    measured = q > 0
    n = int(np.count_nonzero(measured))
    if n < max(fewest, len(names)):
        return {}, {}
    rows, right = shares[measured] * q[measured, None], np.ones(n)  # even relative errors
    solution, rest = nnls(rows, right)
    scatter = max(float(rest) ** 2 / (n - len(names) or 1), _Q_ERROR**2)
    error = NORMAL_90 * np.sqrt(scatter * np.diag(np.linalg.pinv(rows.T @ rows)))
    ends = zip(names, np.maximum(solution - error, 0.0), solution + error, strict=True)
    return dict(zip(names, map(float, solution), strict=True)), {n: (float(a), float(b)) for n, a, b in ends}


def typical(species: str, density: float) -> Wood:
    """Wood of a species about which a board's constants are sought."""
    return replace(SPECIES[species].wood, density=density)
