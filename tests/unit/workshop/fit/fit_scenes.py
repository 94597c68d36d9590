"""Bodies of which everything is known, and noisy responses of them: made without the code under test."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.linalg as sla

INSTRUMENTS = Path(__file__).parents[4] / "instruments"
TAU = 2 * np.pi


@dataclass(frozen=True)
class Truth:
    """Real modes at points; the first point is the reference."""

    freq: np.ndarray  # (K,) Hz
    quality: np.ndarray  # (K,)
    residues: np.ndarray  # (P, K) 1/kg, of each point from the reference

    def mobility(self, freq, alpha=0.0):
        s = alpha + 1j * TAU * freq
        w = TAU * self.freq[:, None]
        return self.residues @ (s / (s * s + w / self.quality[:, None] * s + w * w))

    def noisy(self, freq, share, seed):
        """Responses, and the standard deviation of their noise: a share of the r.m.s. mobility, alike in all bins."""
        rng, clean = np.random.default_rng(seed), self.mobility(freq)
        sigma = share * np.sqrt(np.mean(np.abs(clean) ** 2, axis=1, keepdims=True)) * np.ones(freq.size)
        error = rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape)
        return clean + sigma / np.sqrt(2) * error, sigma

    def identifiable(self, freq, sigma):
        """Modes in the band whose information bounds (Cramer and Rao) are below 1 cent, 5 % of Q and 5 % of residue."""
        s, K, P = 1j * TAU * freq, self.freq.size, len(self.residues)
        w, zeta = TAU * self.freq[:, None], 0.5 / self.quality[:, None]
        per = 1 / (s * s + 2 * zeta * w * s + w * w)
        h = s * per
        by_freq, by_zeta = -h * per * (2 * zeta * w * s + 2 * w * w), -h * per * 2 * zeta * w * s
        jacobian = []
        for p in range(P):
            own = np.zeros((2 * K + P * K, freq.size), dtype=complex)
            own[:K], own[K : 2 * K] = self.residues[p][:, None] * by_freq, self.residues[p][:, None] * by_zeta
            own[2 * K + p * K : 2 * K + (p + 1) * K] = self.residues[p][:, None] * h  # relative residues
            jacobian.append(own * np.sqrt(2) / sigma[p])
        rows = np.concatenate(jacobian, axis=1)
        information = (rows.conj() @ rows.T).real
        scale = 1 / np.sqrt(np.diag(information))
        covariance = sla.inv(information * np.outer(scale, scale) + 1e-13 * np.eye(len(scale))) * np.outer(scale, scale)
        bound = np.sqrt(np.diag(covariance))
        sure = (bound[:K] * 1200 / np.log(2) < 1) & (bound[K : 2 * K] < 0.05) & (bound[2 * K : 3 * K] < 0.05)
        return np.flatnonzero(sure & (self.freq > freq[0]) & (self.freq < freq[-1]))

    def matched(self, freq, quality):
        """Found mode of each true one (-1: none) within a bandwidth, and found modes that are none's."""
        pairs = np.full(self.freq.size, -1)
        for k in range(self.freq.size):
            j = int(np.argmin(np.abs(np.log(freq / self.freq[k]))))
            if abs(np.log(freq[j] / self.freq[k])) < 0.5 / max(quality[j], self.quality[k]):
                pairs[k] = j
        return pairs, np.setdiff1d(np.arange(len(freq)), pairs)


def guitar(name="classical_guitar", places=(0.0, -0.6, 0.6)):
    """The table of a shipped guitar (measured by R. Mores 2021) at places along its bridge, driven at the first."""
    with (INSTRUMENTS / name / "body.csv").open() as file:
        rows = np.array(
            [[float(x) for x in row] for row in csv.reader(x for x in file if not x.startswith(("#", "f_Hz")))]
        )
    u0 = places[0]
    residues = np.array([rows[:, 2] + (u + u0) * rows[:, 3] + u * u0 * rows[:, 4] for u in places])
    return Truth(rows[:, 0], rows[:, 1], residues)


def random_body(n_modes, seed, n_points=2, low=80.0, high=1800.0):
    """Modes at random, at least a bandwidth and a half apart: each is drawn until it keeps clear of those before it."""
    rng = np.random.default_rng(seed)
    freq, quality = np.zeros(n_modes), np.zeros(n_modes)
    for k in range(n_modes):
        while True:
            f, q = np.exp(rng.uniform(np.log((low, 15)), np.log((high, 120))))
            if np.all(np.abs(freq[:k] - f) > 0.75 * (freq[:k] / np.maximum(quality[:k], 1) + f / q)):
                break
        freq[k], quality[k] = f, q
    order = np.argsort(freq)
    shapes = rng.normal(size=(n_points, n_modes))
    shapes[0] = np.abs(shapes[0]) + 0.3
    return Truth(freq[order], quality[order], shapes * shapes[0])
