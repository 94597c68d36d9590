"""Analysis of one note: the same for a recorded and for a computed one, so that its own errors drop out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.estimate.body_modes import envelopes
from tonewood.workshop.estimate.partials import (
    MOST,
    Bands,
    NotePartial,
    find_partials,
    measure_partial,
)
from tonewood.workshop.estimate.recordings import FS, SHORTEST, Recording
from tonewood.workshop.estimate.spectra import bands_over_time, db, find_onset, power_spectrum, share

#: Hz, bands of the measures of modulation, and of the floor between partials
MODULATED = ((700.0, 1500.0), (1500.0, 3000.0), (3000.0, 6000.0))
FLOORS = ((80.0, 1000.0), (1000.0, 3000.0), (3000.0, 8000.0))
#: Hz, band whose share tells how bright a stroke is
BRIGHT = (3000.0, 8000.0)
_OFF, _HALF = 60.0, 0.5


@dataclass(frozen=True, eq=False)
class NoteAnalysis:
    """Figures of one note.

    onset : s, in the file.
    f0, b : Hz, and inharmonicity; nan where too few partials are found.
    partials : number -> partial.
    below : what lies below the fundamental, `body_modes.envelopes`.
    bands : (4, 21) dB, third octaves over time.
    rise : s, from 20 dB below the first peak to it.
    peak, level : dB, largest sample, and rms of the first 500 ms.
    bright : dB, share of 3 to 8 kHz in the first 100 ms.
    modulation : dB rms of partials' envelopes about a parabola, by band of `MODULATED`; nan where there is none.
    floor : dB, partials re the floor half-way between them in the first 45 ms, by band of `FLOORS`.
    tail : (n, 2) s, dB: level between the partials from 1 to 5 kHz over time.
    """

    onset: float
    f0: float
    b: float
    partials: Mapping[int, NotePartial]
    below: tuple[Complexes | None, ...]
    bands: Floats
    rise: float
    peak: float
    level: float
    bright: float
    modulation: tuple[float, ...]
    floor: tuple[float, ...]
    tail: Floats


def analyse(x: Floats, freq: float, guess: float, upper: float = FS / 2) -> NoteAnalysis:
    """Analyse a note.

    x : (n,) at `recordings.FS`.
    freq : Hz, its pitch, within 60 cents.
    guess : B of the string that is expected.
    upper : Hz, end of the band that the sound holds.
    Returns The figures; those that the sound is too short for are nan.
    """
    onset, top = find_onset(x, freq)
    f0, b, rows = find_partials(x, onset, freq, guess, upper)
    bands = Bands(x, onset)
    measured = [measure_partial(bands, int(n), at, f0) for n, at, _, _ in rows[:MOST]]
    partials = {p.number: p for p in measured if p is not None}
    first = x[onset : onset + FS // 2]
    return NoteAnalysis(
        onset=onset / FS, f0=f0, b=b, partials=partials, below=envelopes(bands, f0),
        bands=bands_over_time(x, onset), rise=(top - onset) / FS, peak=float(20 * np.log10(np.abs(x).max() + 1e-12)),
        level=float(db(float(np.mean(first**2)))), bright=share(x[onset : onset + FS // 10], *BRIGHT),
        modulation=_modulation(bands, partials.values(), f0), floor=_floor(x, onset, f0, b), tail=_tail(bands, f0, b),
    )  # fmt: skip


def check_pitch(recording: Recording) -> str | None:
    """Return why a recording is not of the note of its name, within 60 cents, or too short; None if it is."""
    x = recording.samples
    onset, _ = find_onset(x, recording.freq)
    if len(x) < onset + int(SHORTEST * FS):
        left = (len(x) - onset) / FS
        return f"{recording.file}: ends {left:.2f} s after its onset; {SHORTEST:g} s or more are wanted"
    cents = pitch_offset(x, onset, recording.freq)
    if np.isnan(cents):
        return f"{recording.file}: no partials of its note stand out of the noise"
    if abs(cents) <= _OFF:
        return None
    return f"{recording.file}: sounds {abs(cents):.0f} cents {'above' if cents > 0 else 'below'} the note of its name"


def pitch_offset(x: Floats, onset: int, freq: float) -> float:
    """Cents of a note above a pitch, from -1900 to 1900 in steps of 5; nan if no partial stands out.

    The pitch whose first eight multiples have the largest sum of levels over the noise between them; of several alike
    the one nearest to `freq`, so that an octave counts only where partials are missing or lie between.
    """
    start = onset + int(0.05 * FS)
    piece = x[start : start + int(max(0.6, 30.0 / freq) * FS)]
    freqs, power = power_spectrum(piece, np.hanning(len(piece)), 1 << 18)
    level, step = db(power), float(freqs[1])
    from scipy.ndimage import maximum_filter1d, median_filter

    coarse = level[: int(min(12 * freq * 3, 0.95 * FS / 2) / step)]
    over = np.clip(
        coarse - median_filter(coarse[::4], size=max(3, int(freq / step / 4))).repeat(4)[: len(coarse)], 0, 40
    )
    over = maximum_filter1d(over, 3) - 10.0

    def score(f: float) -> float:
        at = (np.arange(1, 9) * f / step).round().astype(int)
        between = (np.arange(1, 9) * f / step - f / step / 2).round().astype(int)
        at, between = at[at < len(over)], between[between < len(over)]
        return float(over[at].sum() - np.maximum(over[between], 0).sum() - 2.0 * (8 - len(at)))

    cents = np.arange(-1900, 1901, 5)
    scores = np.array([score(freq * 2 ** (c / 1200)) for c in cents])
    near = np.abs(cents) <= _OFF
    if scores[near].max() >= 0.6 * scores.max() and scores[near].max() > 15.0:
        return float(cents[near][np.argmax(scores[near])])
    return float(cents[np.argmax(scores)]) if scores.max() > 15.0 else np.nan


def check_pitches(recordings: Iterable[Recording]) -> tuple[list[Recording], list[str]]:
    """Return the recordings whose pitch is that of their names, and a line on each of the others.

    Raises TonewoodError : most of them sound by the same interval off, or none is of use.
    """
    rows, fits, lines, offsets = list(recordings), [], [], []
    for recording in rows:
        reason = check_pitch(recording)
        if reason is None:
            fits.append(recording)
        else:
            lines.append(f"left out: {reason}")
            onset, _ = find_onset(recording.samples, recording.freq)
            offsets.append(pitch_offset(recording.samples, onset, recording.freq))
    finite = [o for o in offsets if np.isfinite(o)]
    if len(finite) > len(rows) / 2 and np.ptp(np.percentile(finite, [25, 75])) < 100:
        steps = round(float(np.median(finite)) / 100)
        raise TonewoodError(
            f"{len(finite)} of {len(rows)} notes sound {np.median(finite):+.0f} cents from their names: try {steps}",
            key="--transpose",
        )
    if not fits:
        raise TonewoodError(f"no recording is of use: {lines[0]}")
    return fits, lines


def _modulation(bands: Bands, partials: Iterable[NotePartial], f0: float) -> tuple[float, ...]:
    """Median, by band, of the rms of partials' envelopes about a parabola from 60 to 460 ms."""
    values: list[list[float]] = [[] for _ in MODULATED]
    if bands.end < 0.55:
        return (np.nan,) * len(MODULATED)
    for partial in partials:
        of = [i for i, (low, high) in enumerate(MODULATED) if low <= partial.freq < high]
        if not of:
            continue
        levels = []
        for freq in (partial.freq, partial.freq + f0 / 2):
            y, t = bands.envelope(freq, min(0.35 * f0, 50.0))
            use = (t > 0.06) & (t < 0.46)
            levels.append(db(np.abs(y[use]) ** 2))
        if np.median(levels[0]) - np.median(levels[1]) > 25:
            x = np.linspace(-1, 1, len(levels[0]))
            values[of[0]].append(float(np.std(levels[0] - np.polyval(np.polyfit(x, levels[0], 2), x))))
    return tuple(float(np.median(row)) if row else np.nan for row in values)


def _floor(x: Floats, onset: int, f0: float, b: float) -> tuple[float, ...]:
    """dB, peaks of the partials re the floor half-way between them, first 45 ms or 6.5 periods, by band."""
    length = int(max(0.045, 6.5 / f0) * FS)
    piece = x[onset : onset + length]
    if len(piece) < length or not np.isfinite(b):
        return (np.nan,) * len(FLOORS)
    freqs, power = power_spectrum(piece, np.blackman(length), 1 << 17)
    step, out = freqs[1], []
    for low, high in FLOORS:
        numbers = np.arange(1, int(high / f0) + 2)
        at, between = (m * f0 * np.sqrt(1 + b * m * m) for m in (numbers, numbers + _HALF))
        inside = (at >= low) & (between <= min(high, FS / 2 - f0))
        peaks = [power[int((f - 0.12 * f0) / step) : int((f + 0.12 * f0) / step)].max() for f in at[inside]]
        floors = [power[int((g - 0.06 * f0) / step) : int((g + 0.06 * f0) / step)].mean() for g in between[inside]]
        out.append(float(db(np.sum(peaks) / max(np.sum(floors), 1e-24))) if len(peaks) > 1 else np.nan)
    return tuple(out)


def _tail(bands: Bands, f0: float, b: float) -> Floats:
    """(n, 2) s, dB: mean level half-way between partials from 1 to 5 kHz, 30 to 700 ms after the onset, each 10 ms."""
    width = 0.3 * f0 / 2
    if not np.isfinite(b) or f0 < 100 or bands.end < 0.7:
        return np.empty((0, 2))
    grid = np.arange(0.03, 0.7, 0.01)
    numbers = np.arange(1, int(5000 / f0) + 1) + _HALF
    freqs = numbers * f0 * np.sqrt(1 + b * numbers**2)
    powers = []
    for freq in freqs[(freqs > 1000) & (freqs < 5000)][:12]:
        y, t = bands.envelope(float(freq), width)
        powers.append(np.interp(grid, t, np.abs(y) ** 2))
    return np.stack([grid, db(np.mean(powers, 0))], 1) if powers else np.empty((0, 2))
