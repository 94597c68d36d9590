"""Drift of repeated hits: the zero of a channel that moves during a hit, frequencies that move from hit to hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from tonewood.support.arrays import Complexes, Floats

#: share of a record, its end, in which a body is nearly silent; least share before the hit that shows a slope
_TAIL, _BEFORE = 0.1, 0.01
#: standard deviations above which a drift is significant; least drift of a zero re the peak of its channel
_SURE, _LEAST_ZERO = 5.0, 1e-3
#: bins over which the variance of hits is smoothed; rounds in which frequencies are brought together
_SMOOTHED, _ROUNDS = 31, 4
#: most peaks that are looked at, their least power re the strongest, share of a bandwidth from which a move is named
_PEAKS, _LEAST_PEAK, _MOST_MOVED = 8, 1e-4, 0.1


@dataclass(frozen=True, eq=False)
class Spectra:
    """Spectra of hits at one point, and their slopes.

    freq : (N,) Hz.
    force, motion : (n_hits, N) and (n_hits, P, N).
    force_slope, motion_slope : their derivatives by frequency, per Hz, with time counted from the hit.
    """

    freq: Floats
    force: Complexes
    motion: Complexes
    force_slope: Complexes
    motion_slope: Complexes

    @classmethod
    def of(cls, force: Floats, motion: Floats, fs: float, stretch: Floats) -> Spectra:
        """Transform hits, each on its own frequencies (1 + stretch) f.

        force, motion : (n_hits, n) and (n_hits, P, n).
        fs : Hz.
        stretch : (n_hits,) relative.
        """
        n = force.shape[-1]
        t = np.arange(n) / fs
        t = t - t[int(np.argmax(np.abs(force).max(axis=0)))]  # slopes are small where time begins at the hit

        def transform(x: Floats) -> Complexes:
            return np.array([_stretched(hit, by) for hit, by in zip(x, stretch, strict=True)])

        turn = -2j * np.pi * (1 + stretch)
        return cls(
            np.arange(n // 2 + 1) * fs / n, transform(force), transform(motion), turn[:, None] * transform(force * t),
            turn[:, None, None] * transform(motion * t),
        )  # fmt: skip

    def moves(self, bins: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Return (n_hits,) relative shifts of frequency re the mean of the hits, and their standard deviations.

        Hit h has X_h = F_h (H - e_h f H'), H of all hits by H1; e_h by weighted least squares.
        """
        power = np.maximum(np.sum(np.abs(self.force) ** 2, axis=0), 1e-300)
        response = np.sum(self.motion * self.force.conj()[:, None], axis=0) / power
        slope = np.sum((self.motion_slope - response * self.force_slope[:, None]) * self.force.conj()[:, None], axis=0)
        left = self.motion - self.force[:, None] * response
        variance = uniform_filter1d(np.mean(np.abs(left) ** 2, axis=0), _SMOOTHED, axis=-1, mode="mirror")
        weight = 1 / np.maximum(variance, 1e-12 * variance.max() + 1e-300)
        column = -self.force[:, None] * self.freq * slope / power
        by, target, w = column[..., bins], left[..., bins], weight[..., bins]
        length = np.maximum(np.sum(w * np.abs(by) ** 2, axis=(1, 2)), 1e-300)
        slopes = np.sum(w * (by.conj() * target).real, axis=(1, 2)) / length
        misfit = target - slopes[:, None, None] * by
        per_bin = np.mean(w * np.abs(misfit) ** 2, axis=(1, 2)) / 2
        return slopes, np.sqrt(per_bin / length)

    def peaks(self) -> list[tuple[NDArray[np.intp], float]]:
        """Return the bins around the strongest peaks, and the widths of these at half their power, Hz."""
        power = np.maximum(np.sum(np.abs(self.force) ** 2, axis=0), 1e-300)
        response = np.sum(self.motion * self.force.conj()[:, None], axis=0) / power
        level = np.sum(np.abs(response) ** 2, axis=0) * power / power.max()
        out: list[tuple[NDArray[np.intp], float]] = []
        taken = np.zeros(level.size, dtype=bool)
        for i in np.argsort(-level):
            if taken[i] or len(out) == _PEAKS or level[i] < _LEAST_PEAK * level.max():
                continue
            half = level > 0.5 * level[i]
            below = np.flatnonzero(~half)
            first = int(below[below < i].max(initial=-1)) + 1
            stop = int(below[below > i].min(initial=level.size))
            width = stop - first
            around = np.arange(max(first - width, 1), min(stop + width, level.size))
            if not taken[around].any() and width > 1:
                out.append((around, width * float(self.freq[1])))
            taken[around] = True
        return out


def _stretched(x: Floats, by: float) -> Complexes:
    """(..., n // 2 + 1) Fourier transform at (1 + by) times the frequencies of the bins."""
    from scipy.signal import czt

    n = x.shape[-1]
    if by == 0:
        return np.asarray(np.fft.rfft(x))
    return np.asarray(czt(x, n // 2 + 1, np.exp(-2j * np.pi * (1 + by) / n)))


@dataclass(frozen=True)
class Drift:
    """What drifted.

    zero : (P + 1,) largest move of a channel's zero during a hit, re the channel's peak, force first; it was taken out.
    common : (n_hits,) relative shift of all frequencies of each hit; it was taken out. 0 where there is none.
    peaks : (Hz, relative move, share of the peak's width) of peaks that still move.
    """

    zero: tuple[float, ...] = ()
    common: tuple[float, ...] = ()
    peaks: tuple[tuple[float, float, float], ...] = ()

    def lines(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Say what drifted, a line each; `names` of the channels."""
        out = []
        moved = [f"{name} ({100 * x:.2g} % of its peak)" for name, x in zip(names, self.zero, strict=True) if x]
        if moved:
            out.append(
                f"the zero drifts during a hit of {', '.join(moved)}: a straight line through the silence before the "
                "hit and the end was taken out"
            )
        if any(self.common):
            span = max(self.common) - min(self.common)
            shown = ", ".join(f"{100 * x:+.2g}" for x in self.common)
            out.append(
                f"all frequencies drift by {100 * span:.2g} % from hit to hit ({shown} %): the hits were brought to "
                "their mean; let the body rest, and strike it alike"
            )
        out += [
            f"the peak at {freq:.5g} Hz drifts by {100 * moved:.2g} % from hit to hit, {share:.0%} of its bandwidth: "
            "its Q comes out too low"
            for freq, moved, share in self.peaks
        ]
        return tuple(out)


def level_zero(force: Floats, motion: Floats) -> tuple[Floats, Floats, Floats]:
    """Take the straight line through the quiet parts out of each channel of each hit, where there is one.

    force, motion : (n_hits, n) and (n_hits, P, n).
    Returns force and motion without it, and (P + 1,) how far it moves re the peak of the channel, force first; 0 where
        none.
    """
    channels = np.concatenate([force[:, None], motion], axis=1)
    out, moved = channels.copy(), np.zeros(channels.shape[1])
    for h, hit in enumerate(force):
        quiet = _quiet(hit)
        for c, x in enumerate(channels[h]):
            baseline = _line(x, quiet)
            out[h, c] -= baseline
            moved[c] = max(moved[c], float(np.ptp(baseline)) / max(float(np.abs(x - baseline).max()), 1e-300))
    return out[:, 0], out[:, 1:], np.where(moved > _LEAST_ZERO, moved, 0.0)


def _quiet(force: Floats) -> NDArray[np.intp]:
    """Samples before the hit, if there are enough, and at the end."""
    x = np.abs(force - np.median(force))
    n, peak = x.size, int(np.argmax(x))
    loud = np.flatnonzero(x > 0.01 * x[peak] + 8 * np.median(x))
    before = max(int(loud.min(initial=peak)) - 2, 0)
    begin = np.arange(before) if before >= max(_BEFORE * n, 8) else np.arange(0)
    return np.concatenate([begin, np.arange(int((1 - _TAIL) * n), n)])


def _line(x: Floats, quiet: NDArray[np.intp]) -> Floats:
    """(n,) straight line through the quiet parts, level without a part before the hit; 0 where it is in doubt."""
    t = np.linspace(-1, 1, x.size)
    columns = np.stack([np.ones(x.size), t] if quiet[0] == 0 else [np.ones(x.size)], axis=1)
    basis = columns[quiet]
    coefficients = np.linalg.lstsq(basis, x[quiet], rcond=None)[0]
    left = x[quiet] - basis @ coefficients
    # what is left may be ringing: as many independent samples as it changes its sign
    independent = max(np.count_nonzero(np.diff(np.sign(left))), 1)
    deviation = np.sqrt(np.mean(left**2) * quiet.size / independent * np.diag(np.linalg.inv(basis.T @ basis)))
    return np.asarray(columns @ coefficients if np.any(np.abs(coefficients) > _SURE * deviation) else 0 * t)


def brought_together(
    force: Floats, motion: Floats, fs: float
) -> tuple[Spectra, Floats, list[tuple[float, float, float]]]:
    """Bring hits to the mean of their frequencies where these drift in common, and say what still moves.

    force, motion : (n_hits, n) and (n_hits, P, n), windowed.
    fs : Hz.
    Returns Spectra of the hits, (n_hits,) relative shifts that were taken out, and peaks that still move: Hz, relative
        move, and share of the width.
    """
    stretch = np.zeros(len(force))
    spectra = Spectra.of(force, motion, fs, stretch)
    if len(force) < 2:
        return spectra, stretch, []
    around = np.concatenate([np.arange(0), *(bins for bins, _ in spectra.peaks())])
    if around.size:
        moved, deviation = spectra.moves(around)
        rounds = _ROUNDS if np.any(np.abs(moved) > _SURE * deviation) else 0
        for _ in range(rounds):
            stretch = stretch + moved - np.mean(moved)
            spectra = Spectra.of(force, motion, fs, stretch)
            moved, _ = spectra.moves(around)
    peaks = []
    for bins, width in spectra.peaks():
        moved, deviation = spectra.moves(bins)
        centre, span = float(np.mean(spectra.freq[bins])), float(np.ptp(moved))
        if span > _SURE * float(deviation.max()) and span * centre > _MOST_MOVED * width:
            peaks.append((centre, span, span * centre / width))
    return spectra, stretch, sorted(peaks)
