"""Picture of the spectrum of taps with its peaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tonewood.support.plotting import COLOURS, LINE, figure, frequency_axis, save
from tonewood.workshop.taps.ringing import Peak

#: dB that are shown below the strongest bin
_SHOWN = 70.0


def draw_taps(
    taps: Sequence[NDArray[np.float64]],
    fs: float,
    band: tuple[float, float],
    peaks: Sequence[Peak],
    names: Mapping[Peak, str],
    path: Path,
) -> None:
    """Draw each tap's spectrum (grey), their mean square (black) and the peaks, dB re the strongest bin."""
    samples = np.array(taps)
    freq = np.fft.rfftfreq(samples.shape[1], 1 / fs)
    inside = (freq >= band[0]) & (freq <= band[1])
    power = np.abs(np.fft.rfft(samples)[:, inside]) ** 2 + 1e-300
    mean = power.mean(axis=0)
    chart, axes = figure(1, 1, heights=[5.0])
    axis = axes[0, 0]
    for row in power:
        axis.plot(freq[inside], 10 * np.log10(row / mean.max()), color="0.8", lw=0.5 * LINE)
    level = 10 * np.log10(mean / mean.max())
    axis.plot(freq[inside], level, color="0.1", lw=LINE)
    for peak in peaks:
        at = float(np.interp(peak.freq, freq[inside], level))
        axis.plot(peak.freq, at, "o" if peak.certain else ".", color=COLOURS[0], ms=7)
        label = f"{names[peak]} " if peak in names else ""
        if peak.certain:
            axis.annotate(
                f"{label}{peak.freq:.0f}\nQ {peak.quality:.0f}", (peak.freq, at), xytext=(0, 9),
                textcoords="offset points", ha="center", fontsize="small",
            )  # fmt: skip
    axis.set(ylim=(-_SHOWN, 18), ylabel="level, dB re the strongest bin")
    frequency_axis(axis, *band)
    save(chart, path)
