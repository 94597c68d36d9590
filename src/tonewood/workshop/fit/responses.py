"""Measured responses of a body: quantities and places, and the checks that come before any fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tonewood.errors import TonewoodError
from tonewood.workshop.fit import noise

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: form -> power of s by which it is multiplied to become mobility
FORMS: Mapping[str, int] = {"receptance": 1, "mobility": 0, "accelerance": -1}
#: largest share of the band in which a driving point may give energy back, beyond twice the noise
MOST_NEGATIVE = 0.05
#: fewest bins of a band
FEWEST_BINS = 32
#: coherence below which a response is more noise than motion; bins of its running median
LEAST_COHERENCE, _COHERENCE = 0.5, 31


@dataclass(frozen=True, eq=False)
class Responses:
    """Frequency responses of one body.

    Attributes
    ----------
    freq : (N,) Hz, rising, evenly spaced.
    mobility : (P, N) (m/s)/N, velocity at a point over force at a reference.
    pairs : (point, reference) of each row.
    coherence : (P, N), or None.
    n_hits : averaged, or None where not known.
    alpha : 1/s, of an exponential window that is in the data.
    pressure : microphone and reference -> (N,) Pa/N.
    files : name -> SHA-256 of the bytes read.
    kept : hits kept and hits given, where raw hits were read.
    """

    freq: Floats
    mobility: Complexes
    pairs: tuple[tuple[str, str], ...]
    coherence: Floats | None = None
    n_hits: int | None = None
    alpha: float = 0.0
    pressure: Mapping[tuple[str, str], Complexes] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[int, int] | None = None

    def __repr__(self) -> str:
        band = f"{self.freq[0]:g} to {self.freq[-1]:g} Hz" if self.freq.size else "no bins"
        return (
            f"<Responses of {len(self.pairs)} pairs, {len(self.pressure)} microphones, {self.freq.size} bins, {band}>"
        )

    @property
    def points(self) -> tuple[str, ...]:
        """All points, in the order in which they come."""
        return tuple(dict.fromkeys(name for pair in self.pairs for name in pair))

    @property
    def microphones(self) -> tuple[str, ...]:
        """All microphones, in the order in which they come."""
        return tuple(dict.fromkeys(name for name, _ in self.pressure))

    @property
    def references(self) -> tuple[str, ...]:
        """Points that were driven."""
        return tuple(dict.fromkeys(reference for _, reference in self.pairs))

    @property
    def driving(self) -> tuple[int, ...]:
        """Rows measured where they were driven."""
        return tuple(i for i, (point, reference) in enumerate(self.pairs) if point == reference)

    def band(self, low: float | None, high: float | None) -> Responses:
        """Return the part between two frequencies, without 0 Hz.

        Parameters
        ----------
        low, high : Hz, both included; None is the end of the data.

        Raises
        ------
        TonewoodError : too few bins lie there.
        """
        first = max(low or 0.0, 0.0)
        inside = (self.freq >= first) & (self.freq > 0) & (self.freq <= (high or np.inf))
        if np.count_nonzero(inside) < FEWEST_BINS:
            raise TonewoodError(
                f"{np.count_nonzero(inside)} bins lie between {first:g} and {high or self.freq[-1]:g} Hz; "
                f"{FEWEST_BINS} or more are needed",
                key="--band",
            )
        return replace(
            self,
            freq=self.freq[inside],
            mobility=self.mobility[:, inside],
            coherence=None if self.coherence is None else self.coherence[:, inside],
            pressure={key: row[inside] for key, row in self.pressure.items()},
        )

    def renamed(self, names: Mapping[str, str]) -> Responses:
        """Return these responses with other names of points and microphones, old -> new.

        Raises
        ------
        TonewoodError : there is no point of an old name, or two get the same one.
        """
        known = (*self.points, *self.microphones)
        for old in names:
            if old not in known:
                raise TonewoodError(f"there is no point {old!r}; there are {', '.join(known)}", key="--point")
        for group in (self.points, self.microphones):
            new = [names.get(old, old) for old in group]
            for name in new:
                if new.count(name) > 1:
                    raise TonewoodError(f"two points would be called {name!r}", key="--point")
        pairs = tuple((names.get(point, point), names.get(reference, reference)) for point, reference in self.pairs)
        pressure = {
            (names.get(heard, heard), names.get(reference, reference)): row
            for (heard, reference), row in self.pressure.items()
        }
        return replace(self, pairs=pairs, pressure=pressure)

    def checked(self) -> Responses:
        """Return these responses if a passive body can have them.

        Raises
        ------
        TonewoodError : values are not finite, bins are not evenly spaced, no driving point is among them, or one gives
            energy back over more of the band than noise explains: a sign, a delay, or another form than was said; or
            is incoherent over most of it.
        """
        if not np.all(np.isfinite(self.mobility)):
            raise TonewoodError("responses hold values that are not finite numbers", key="responses")
        step = np.diff(self.freq)
        if np.any(step <= 0) or step.max() > 1.01 * step.min():
            raise TonewoodError("bins are not evenly spaced; a constant step in Hz is allowed", key="freq_Hz")
        for reference in self.references:
            if (reference, reference) not in self.pairs:
                raise TonewoodError(
                    f"nothing was measured at {reference!r}, where the body was driven: shapes have no scale",
                    key="responses",
                )
        for i in self.driving:
            clear = 2 * noise.of_neighbours(self.mobility[i : i + 1])[0]
            negative = float(np.mean(self.mobility[i].real < -clear))
            if negative > MOST_NEGATIVE:
                raise TonewoodError(
                    f"the driving-point mobility of {self.pairs[i][0]!r} has a negative real part over {negative:.0%} "
                    "of the band: a channel's sign, --form or a delay between channels is wrong, or hits were cut off "
                    "while they rang (--window-tau)",
                    key="responses",
                )
            self._weighed(i)
            ranges = self.incoherent(i)
            if sum(high - low for low, high in ranges) > 0.5 * (self.freq[-1] - self.freq[0]):
                shown = ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ranges[:3])
                raise TonewoodError(
                    f"the coherence at {self.pairs[i][0]!r} is below {LEAST_COHERENCE:g} over most of the band "
                    f"({shown} Hz): the hammer did not reach there, or the channels are not of one measurement",
                    key="--band",
                )
        return self

    def incoherent(self, i: int) -> list[tuple[float, float]]:
        """Return the parts of the band, Hz, in which the coherence of response `i` (running median) is too low."""
        if self.coherence is None:
            return []
        low = median_filter(self.coherence[i], size=min(_COHERENCE, self.freq.size), mode="mirror") < LEAST_COHERENCE
        edges = np.flatnonzero(np.diff(np.concatenate([[False], low, [False]]).astype(np.int8)))
        return [(float(self.freq[a]), float(self.freq[b - 1])) for a, b in edges.reshape(-1, 2)]

    def _weighed(self, i: int) -> None:
        """No body of an instrument weighs less than 10 mg or more than 10 t as felt at a point."""
        size = float(np.median(np.abs(self.mobility[i])))
        apparent = 1.0 / (2 * np.pi * np.sqrt(self.freq[0] * self.freq[-1]) * max(size, 1e-300))
        if not 1e-5 < apparent < 1e4:
            raise TonewoodError(
                f"the median mobility of {self.pairs[i][0]!r} is {size:.3g} (m/s)/N, that of {apparent:.3g} kg in the "
                "middle of the band; 1e-5 to 1e4 kg are allowed: check units and --sensitivity",
                key="responses",
            )


def to_mobility(response: Complexes, freq: Floats, form: str, alpha: float = 0.0) -> Complexes:
    """Turn receptance, mobility or accelerance into mobility, on the line s = alpha + j 2 pi f."""
    s, power = alpha + 2j * np.pi * freq, FORMS[form]
    if power < 0:  # at 0 Hz an accelerance tells no velocity
        return np.asarray(np.divide(response, s, out=np.zeros_like(response), where=s != 0))
    return np.asarray(response * s**power)
