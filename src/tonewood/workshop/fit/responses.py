"""Measured responses of a body: quantities and places, and the checks that come before any fit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.fit import noise

#: form -> power of s by which it is multiplied to become mobility
FORMS: Mapping[str, int] = {"receptance": 1, "mobility": 0, "accelerance": -1}
#: largest share of the band in which a driving point may give energy back, beyond twice the noise
MOST_NEGATIVE = 0.05
#: fewest bins of a band
FEWEST_BINS = 32
#: coherence below which a response is more noise than motion; bins of its running median
LEAST_COHERENCE, _COHERENCE = 0.5, 31
#: energy before the hit re that after it, above which time runs backwards
_BEFORE = 4.0
#: share of the bins, most that are outliers
_MOST_OUTLIERS = 0.2
#: (m/s)/N from which on a response is no number of a body, nor is one below its inverse: squares leave the range
_LARGEST = 1e30
#: error of rounding of a coherence of 1
_ROUNDED = 1e-6
#: share of the step below which a frequency is 0
_ZERO = 0.01
#: kg that a body of an instrument weighs as felt at a point
LIGHTEST, HEAVIEST = 1e-5, 1e4


@dataclass(frozen=True, eq=False)
class Responses:
    """Frequency responses of one body.

    Attributes
    ----------
    freq : (N,) Hz, rising.
    mobility : (P, N) (m/s)/N, velocity at a point over force at a reference.
    pairs : (point, reference) of each row.
    coherence : (P, N), or None.
    n_hits : averaged, or None where not known.
    alpha : 1/s, of an exponential window that is in the data.
    pressure : microphone and reference -> (N,) Pa/N.
    files : name -> SHA-256 of the bytes read.
    kept : hits kept and hits given, where raw hits were read.
    remarks : on how they were read, a line each.
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
    remarks: tuple[str, ...] = ()

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

    @property
    def measured(self) -> NDArray[np.bool_]:
        """(N,) bins with finite numbers other than 0; responses that are 0 in nearly all bins do not count."""
        rows = self.mobility[np.count_nonzero(self.mobility, axis=1) >= FEWEST_BINS]
        return np.asarray(np.isfinite(self.mobility).all(axis=0) & (rows != 0).all(axis=0))

    def band(self, low: float | None, high: float | None) -> Responses:
        """Return the part between two frequencies, without 0 Hz and without bins that were not measured.

        A first bin below a hundredth of the step stands for 0 Hz, written so for programs that divide by it.

        Parameters
        ----------
        low, high : Hz, both included; None is the end of the data.

        Raises
        ------
        TonewoodError : too few bins lie there.
        """
        first = max(low or 0.0, 0.0)
        least = _ZERO * float(np.median(np.diff(self.freq))) if self.freq.size > 1 else 0.0
        inside = (self.freq >= first) & (self.freq > max(least, 0.0)) & (self.freq <= (high or np.inf))
        inside &= self.measured
        for row in self.pressure.values():
            inside &= np.isfinite(row)
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

    def without_outliers(self) -> tuple[Responses, tuple[float, ...]]:
        """Return these responses less the bins that disagree with their neighbours, and their frequencies, Hz."""
        step = np.diff(self.freq)
        if step.max() > 1.01 * step.min():  # differences of bins tell nothing
            return self, ()
        out = noise.outliers(self.mobility).any(axis=0)
        if np.count_nonzero(out) > _MOST_OUTLIERS * out.size:
            return self, ()
        return replace(
            self,
            freq=self.freq[~out],
            mobility=self.mobility[:, ~out],
            coherence=None if self.coherence is None else self.coherence[:, ~out],
            pressure={key: row[~out] for key, row in self.pressure.items()},
        ), tuple(self.freq[out].tolist())

    def renamed(self, names: Mapping[str, str]) -> Responses:
        """Return these responses with other names of points and microphones, old -> new.

        Raises
        ------
        TonewoodError : there is no point of an old name, or two get the same one.
        """
        allowed = (*self.points, *self.microphones)
        for old in names:
            if old not in allowed:
                raise TonewoodError(f"there is no point {old!r}; there are {', '.join(allowed)}", key="--point")
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

    def reciprocal(self) -> Responses:
        """Return these responses with point and reference exchanged where that makes a driven point the reference.

        Y_ij = Y_ji: a hammer that goes from point to point beside one sensor tells the same as a sensor that does.
        """
        driven = {point for point, reference in self.pairs if point == reference}
        heard = list(dict.fromkeys(point for point, _ in self.pairs))
        # without any driving point the sensor that stayed is the reference of all
        fixed = set(heard) if not driven and len(heard) < len(self.references) else driven
        pairs = tuple(
            (reference, point) if point in fixed and reference not in fixed and (reference, point) not in self.pairs
            else (point, reference)
            for point, reference in self.pairs
        )  # fmt: skip
        return replace(self, pairs=pairs)

    def of_driven(self) -> tuple[Responses, tuple[str, ...]]:
        """Return the responses from references that were measured themselves, and the names of the other references.

        All of them, where no reference was.
        """
        driven = {self.pairs[i][1] for i in self.driving}
        others = tuple(name for name in self.references if name not in driven)
        if not driven or not others:
            return self, ()
        kept = [i for i, (_, reference) in enumerate(self.pairs) if reference in driven]
        return replace(
            self,
            mobility=self.mobility[kept],
            pairs=tuple(self.pairs[i] for i in kept),
            coherence=None if self.coherence is None else self.coherence[kept],
            pressure={key: row for key, row in self.pressure.items() if key[1] in driven},
        ), others

    def checked(self) -> Responses:
        """Return these responses if modes can be fitted to them.

        Raises
        ------
        TonewoodError : values are not finite or all 0, frequencies do not rise, or the body rings before the hit.
        """
        if not 1 / _LARGEST < np.abs(self.mobility).max() < _LARGEST:
            raise TonewoodError(
                f"responses hold values that are not finite numbers, or the largest is not between {1 / _LARGEST:g} "
                f"and {_LARGEST:g} (m/s)/N", key="responses",
            )  # fmt: skip
        if np.any(np.diff(self.freq) <= 0):
            raise TonewoodError("frequencies do not rise from bin to bin", key="freq_Hz")
        for (point, reference), row in zip(self.pairs, self.mobility, strict=True):
            if np.count_nonzero(row) < FEWEST_BINS:
                raise TonewoodError(f"the response {point}:{reference} is 0 in nearly all bins", key="responses")
        used = None if self.n_hits is None else self.coherence
        if used is not None and not np.all((used >= 0) & (used <= 1 + _ROUNDED)):
            raise TonewoodError(
                "coherences hold values that are not numbers from 0 to 1; without --hits they are not used",
                key="--hits",
            )
        # of exp(jwt) the second half of the period is the time before the hit
        power = np.square(np.abs(np.fft.ifft(self.mobility, axis=1))).sum(axis=0)
        half = power.size // 2
        if power[half:].sum() > _BEFORE * power[:half].sum():
            raise TonewoodError(
                "the body rings before it is struck: imaginary parts of the other sign (a file for exp(-jwt): take the "
                "conjugate), or force and response exchanged", key="responses",
            )  # fmt: skip
        return self

    def no_body(self) -> str | None:
        """Return why no passive body can have these responses, in one line that says what to look for, or None."""
        if not self.driving:
            return (
                "no driving point: " + self._not_driven() + "; a passive body needs a response where it was driven "
                "(--driving NAME says which point that was)"
            )
        for i in self.driving:
            name = self.pairs[i][0]
            clear = 2 * noise.of_neighbours(self.mobility[i : i + 1])[0]
            negative = float(np.mean(self.mobility[i].real < -clear))
            if negative > MOST_NEGATIVE:
                return (
                    f"the driving-point mobility of {name!r} has a negative real part over {negative:.0%} of the band; "
                    "likely causes: the sensor did not stand where the hammer struck, a channel's sign is wrong "
                    "(--scale -1), --form is wrong, a delay between channels, or hits were cut off while they rang "
                    "(--window-tau)"
                )
            size = float(np.median(np.abs(self.mobility[i])))
            apparent = 1.0 / (2 * np.pi * np.sqrt(self.freq[0] * self.freq[-1]) * max(size, 1e-300))
            if not LIGHTEST < apparent < HEAVIEST:
                return (
                    f"the median mobility of {name!r} is {size:.3g} (m/s)/N, that of {apparent:.3g} kg in the middle "
                    f"of the band; {LIGHTEST:g} to {HEAVIEST:g} kg are a body: check units, --scale and --sensitivity"
                )
        return None

    def _not_driven(self) -> str:
        references = ", ".join(repr(name) for name in self.references[:3])
        return f"the sensor did not stand where the hammer struck ({references})"

    def incoherent(self, i: int) -> list[tuple[float, float]]:
        """Return the parts of the band, Hz, in which the coherence of response `i` (running median) is too low."""
        if self.coherence is None:
            return []
        low = median_filter(self.coherence[i], size=min(_COHERENCE, self.freq.size), mode="mirror") < LEAST_COHERENCE
        edges = np.flatnonzero(np.diff(np.concatenate([[False], low, [False]]).astype(np.int8)))
        return [(float(self.freq[a]), float(self.freq[b - 1])) for a, b in edges.reshape(-1, 2)]


def to_mobility(response: Complexes, freq: Floats, form: str, alpha: float = 0.0) -> Complexes:
    """Turn receptance, mobility or accelerance into mobility, on the line s = alpha + j 2 pi f."""
    s, power = alpha + 2j * np.pi * freq, FORMS[form]
    if power < 0:  # at 0 Hz an accelerance tells no velocity
        return np.asarray(np.divide(response, s, out=np.zeros_like(response), where=s != 0))
    return np.asarray(response * s**power)
