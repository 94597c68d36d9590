"""Onset, spectra and levels of a note at `recordings.FS`: the tools of the analysis and of the distances."""

from __future__ import annotations

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.recordings import FS

#: Hz, middles of the third octaves of IEC 61260, 100 Hz to 10 kHz
THIRD_OCTAVES = 1000 * 2 ** (np.arange(-10, 11) / 3)
#: s, parts of a note after its onset whose third octaves are compared
PARTS = ((0.0, 0.05), (0.05, 0.2), (0.2, 0.6), (0.6, 1.2))
_TINY = 1e-12


def db(power: Floats | float) -> Floats:
    """Decibels of a power, -240 at least."""
    return np.asarray(10 * np.log10(np.maximum(power, _TINY**2)))


def running_rms(x: Floats, seconds: float) -> Floats:
    """Rms around each sample."""
    from scipy.ndimage import uniform_filter1d

    power = uniform_filter1d(x**2, max(1, int(seconds * FS)), mode="constant")
    return np.asarray(np.sqrt(np.maximum(power, _TINY**2)))


def find_onset(x: Floats, freq: float) -> tuple[int, int]:
    """Samples where a note begins, 20 dB below its first peak, and where it has come within 10 % of that peak.

    The 2 ms level of the sound above 0.75 `freq` (Hz) is searched; silence or noise before the note may be of any
    length, as long as it stays 20 dB below the note.
    """
    from scipy.signal import butter, sosfiltfilt

    sections = butter(2, max(0.75 * freq, 40.0), "highpass", fs=FS, output="sos")
    level = running_rms(sosfiltfilt(sections, x), 0.002)
    first = int(np.argmax(level > 0.1 * level.max()))
    attack = level[first : first + int(0.15 * FS)]
    top = first + int(np.argmax(attack > 0.9 * attack.max()))
    start = top
    while start > 0 and level[start] > 0.1 * level[top]:
        start -= 1
    return start, top


def power_spectrum(x: Floats, window: Floats, size: int) -> tuple[Floats, Floats]:
    """Frequencies (Hz) and power of a windowed piece."""
    return np.asarray(np.fft.rfftfreq(size, 1 / FS)), np.asarray(np.abs(np.fft.rfft(x * window, size)) ** 2)


def third_octaves(x: Floats) -> Floats:
    """(21,) power in each of `THIRD_OCTAVES`."""
    from scipy.signal.windows import tukey

    size = 1 << int(np.ceil(np.log2(4 * len(x))))
    freqs, power = power_spectrum(x, tukey(len(x), 0.1), size)
    edges = np.append(THIRD_OCTAVES[0] * 2 ** (-1 / 6), THIRD_OCTAVES * 2 ** (1 / 6))
    return np.asarray(np.diff(np.concatenate([[0.0], np.cumsum(power)])[np.searchsorted(freqs, edges)]))


def bands_over_time(x: Floats, onset: int) -> Floats:
    """(4, 21) dB, level of each third octave in each of `PARTS`; nan where the sound is too short."""
    rows = []
    for start, stop in PARTS:
        piece = x[onset + int(start * FS) : onset + int(stop * FS)]
        full = len(piece) > 0.6 * (stop - start) * FS
        rows.append(db(third_octaves(piece) / len(piece)) if full else np.full(len(THIRD_OCTAVES), np.nan))
    return np.array(rows)


def share(x: Floats, low: float, high: float) -> float:
    """dB, energy of a band (Hz) re everything above 50 Hz."""
    from scipy.signal.windows import tukey

    freqs, power = power_spectrum(x, tukey(len(x), 0.1), 1 << int(np.ceil(np.log2(4 * len(x)))))
    return float(db(power[(freqs >= low) & (freqs < high)].sum() / max(power[freqs >= 50].sum(), _TINY**2)))
