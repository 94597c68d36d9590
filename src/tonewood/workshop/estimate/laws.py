"""Loss laws of strings from the decays of partials.

A partial of frequency f on a string whose end moves decays at the rate

    sigma(f) = sum_j p_j c_j(f) + b f0

c_j is the rate that the law's parameter p_j gives alone (omega eta / 2 at p_j = 1), and b the loss at the bridge per
period, which is a nuisance here: bodies lose more or less at each frequency, and the law is to fit the string.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.contract.base import Loss
from tonewood.instrument.contract.losses import StringData
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.analysis import NoteAnalysis

#: partials that a law needs; Hz below which strings move with the body
FEWEST, LOWEST = 8, 150.0
#: Hz, where decay rates are stated, and the grid on which laws are compared
STATED = np.array([500.0, 1000.0, 2000.0, 4000.0])
#: natural logarithm of a rate, its scatter; weight of the prior on each parameter (a factor of 20 at one sd)
_SCATTER, _PRIOR = 0.25, 1 / 3.0


@dataclass(frozen=True, eq=False)
class DecayRates:
    """DecayRates of decay of the partials of a string: Hz, f0 in Hz, 1/s, and the note that each belongs to."""

    freq: Floats
    f0: Floats
    rate: Floats
    note: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.freq)

    def taken(self, at: NDArray[np.intp]) -> DecayRates:
        """Some of them."""
        return DecayRates(self.freq[at], self.f0[at], self.rate[at], self.note[at])


def rates_of(notes: Sequence[NoteAnalysis], scale: float = 1.0) -> DecayRates:
    """DecayRates of the clear partials of the notes of a string, above 150 Hz."""
    rows = [
        (p.freq, a.f0, p.rate * scale, i)
        for i, a in enumerate(notes)
        for p in a.partials.values()
        if p.clear and p.freq > LOWEST
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return DecayRates(table[:, 0], table[:, 1], table[:, 2], table[:, 3].astype(np.intp))


@dataclass(frozen=True, eq=False)
class LinearLoss:
    """A loss law whose rate is a sum over some of its parameters, at a string.

    loss : the plugin with its present numbers.
    string : tension, mass and stiffness.
    names : parameters in which the rate is linear.
    values : their present numbers.
    """

    loss: Loss[Any]
    string: StringData
    names: tuple[str, ...]
    values: Floats

    @classmethod
    def of(cls, loss: Loss[Any], string: StringData) -> LinearLoss:
        """Find the parameters in which the rate is linear: those at which twice the number adds twice the rate."""
        names = [
            name for name, value in loss.parameters.model_dump().items()
            if isinstance(value, float) and _linear(loss, string, name)
        ]  # fmt: skip
        return cls(loss, string, tuple(names), np.array([getattr(loss.parameters, n) for n in names], float))

    def columns(self, freq: Floats) -> Floats:
        """(n_freq, n_names) 1/s per unit of each parameter."""
        out = np.empty((len(freq), len(self.names)))
        zero = dict.fromkeys(self.names, 0.0)
        rest = _rate(self.loss, self.string, zero, freq)
        for j, name in enumerate(self.names):
            out[:, j] = (_rate(self.loss, self.string, zero | {name: self._unit(j)}, freq) - rest) / self._unit(j)
        return out

    def rest(self, freq: Floats) -> Floats:
        """(n_freq,) 1/s, of the parameters that are not linear."""
        return _rate(self.loss, self.string, dict.fromkeys(self.names, 0.0), freq)

    def rate(self, freq: Floats, values: Floats | None = None) -> Floats:
        """(n_freq,) 1/s at the present numbers, or at others."""
        return np.asarray(self.rest(freq) + self.columns(freq) @ (self.values if values is None else values))

    def _unit(self, j: int) -> float:
        return float(self.values[j]) or 1e-3

    @property
    def starts(self) -> Floats:
        """Numbers to begin a fit with: the present ones; of those that are 0, ones that give a tenth of the rate."""
        probe = np.array([1000.0])
        total, columns = float(self.rate(probe)[0]), self.columns(probe)[0]
        return np.where(self.values > 0, self.values, 0.1 * total / np.maximum(columns, 1e-300))


def _rate(loss: Loss[Any], string: StringData, values: Mapping[str, float], freq: Floats) -> Floats:
    """1/s at frequencies, of the law with other numbers: omega eta / 2 at the wavenumber of a stiff string."""
    other = type(loss)(loss.parameters.model_copy(update=dict(values)), loss.files, loss.key)
    omega = 2 * np.pi * freq
    t, ei, mu = string.tension, string.bending_stiffness, string.linear_density
    k2 = omega**2 * mu / t if ei <= 0 else (np.sqrt(t * t + 4 * ei * mu * omega**2) - t) / (2 * ei)
    return np.asarray(omega * other.eta(omega, np.sqrt(k2), string) / 2 * np.ones_like(freq))


def _linear(loss: Loss[Any], string: StringData, name: str) -> bool:
    freq = np.array([300.0, 3000.0])
    value = float(getattr(loss.parameters, name)) or 1e-3
    none, once, twice = (_rate(loss, string, {name: factor * value}, freq) for factor in (0.0, 1.0, 2.0))
    grown = once - none
    return bool(np.all(grown > 0) and np.allclose(twice - once, grown, rtol=1e-6, atol=1e-12))


def fit_law(rates: DecayRates, law: LinearLoss) -> tuple[Floats, float]:
    """Parameters of a law and loss at the bridge per period, robust: soft L1 of the logarithm of the rate.

    rates : of one string; weak priors, a factor of 20, hold the numbers of which these say nothing.
    law : with the numbers to begin with.
    """
    from scipy.optimize import least_squares

    columns, rest = law.columns(rates.freq), law.rest(rates.freq)
    start = np.log(np.append(law.starts, 2e-3))
    measured = np.log(rates.rate)

    def off(q: Floats) -> Floats:
        p = np.exp(np.clip(q, -40, 40))
        fitted = np.log(np.maximum(rest + columns @ p[:-1] + p[-1] * rates.f0, 1e-12))
        return np.concatenate([(fitted - measured) / _SCATTER, _PRIOR * (q - start)])

    q = np.exp(least_squares(off, start, loss="soft_l1", x_scale="jac", max_nfev=200).x)
    return np.asarray(q[:-1]), float(q[-1])


def moved(law: LinearLoss, recorded: DecayRates, rendered: DecayRates) -> Floats:
    """Parameters of a law, moved by the difference of the curves fitted to recorded and to rendered partials.

        p' = argmin_{p >= 0} sum_f (sigma(f; p) / (sigma(f) + sigma_rec(f) - sigma_syn(f)) - 1)^2

    f from 150 Hz to the highest partial recorded; both curves with their loss at the bridge, which so drops out as far
    as the two bodies are alike; no rate becomes less than a fifth or more than five times itself.
    """
    from scipy.optimize import nnls

    top = float(min(max(recorded.freq.max(), 1000.0), 8000.0))
    grid, now = np.geomspace(LOWEST, top, 40), law.rate(np.geomspace(LOWEST, top, 40))
    period = float(np.median(recorded.f0))
    curves = []
    for rates in (recorded, rendered):
        values, bridge = fit_law(rates, law)
        curves.append(law.rate(grid, values) + bridge * period)
    target = np.clip(now + curves[0] - curves[1], 0.2 * now, 5.0 * now)
    columns = law.columns(grid)
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    shares = np.maximum(1.0 - law.rest(grid) / target, 0.0)
    q, _ = nnls(columns / scale / target[:, None], shares)
    return np.asarray(np.maximum(q / scale, 1e-3 * law.starts))


@dataclass(frozen=True, eq=False)
class Interval:
    """90 % intervals by bootstrap over notes and partials.

    rates : (2, 4) 1/s at `STATED`, low and high.
    values : (2, n) of each parameter.
    bridge : (2,) of the loss at the bridge, per period.
    trades : (n + 1, n + 1) rank correlations of the parameters, and of the loss at the bridge, over the draws.
    """

    rates: Floats
    values: Floats
    bridge: Floats
    trades: Floats

    @property
    def spread(self) -> Floats:
        """(4,) half of the interval of each decay rate, relative."""
        low, high = self.rates
        return np.asarray(np.sqrt(high / low) - 1)


def bootstrap(rates: DecayRates, law: LinearLoss, rng: np.random.Generator, draws: int = 40) -> Interval:
    """Draw notes, and partials of them, with replacement, and fit each draw."""
    slopes, at_bridge, stated = [], [], []
    ids = np.unique(rates.note)
    members = [np.flatnonzero(rates.note == i) for i in ids]
    for _ in range(draws):
        picked = [members[i] for i in rng.integers(0, len(ids), len(ids))]
        at = np.concatenate([rng.choice(part, len(part)) for part in picked])
        values, bridge = fit_law(rates.taken(at), law)
        slopes.append(values)
        at_bridge.append(bridge)
        stated.append(law.rate(STATED, values))
    low_high = [5.0, 95.0]
    return Interval(
        np.percentile(stated, low_high, axis=0), np.percentile(slopes, low_high, axis=0),
        np.percentile(at_bridge, low_high), _rank_correlations(np.column_stack([slopes, at_bridge])),
    )  # fmt: skip


def _rank_correlations(draws: Floats) -> Floats:
    """(n, n) Spearman's rank correlations of columns; 0 where a column does not vary."""
    from scipy.stats import rankdata

    ranks = rankdata(draws, axis=0)
    ranks = ranks - ranks.mean(axis=0)
    size = np.sqrt(np.sum(ranks**2, axis=0))
    size[size == 0] = np.inf
    return np.asarray(ranks.T @ ranks / np.outer(size, size))


def trades(law: LinearLoss, interval: Interval, least: float = 0.5) -> list[tuple[str, str, float]]:
    """Pairs of parameters, or of one and the bridge, whose rank correlation over the draws is -`least` or below."""
    names = [*law.names, "bridge"]
    return [
        (names[i], names[j], float(interval.trades[i, j]))
        for i in range(len(names))
        for j in range(i + 1, len(names))
        if interval.trades[i, j] <= -least
    ]
