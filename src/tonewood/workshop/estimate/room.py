"""Share of the room in recorded notes: level between the partials while a note decays.

Half-way between partials a dry note has little; a room fills it, as what it returns of the onset has all frequencies
and decays by the room's law. Rendered notes are put into a box at several mixes until the level between their
partials, from 50 to 500 ms and re the partials' own, is that of the recorded ones. Noise fills it, too, so that the
share is an upper limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.sound.room import room_response
from tonewood.support.arrays import Complexes, Floats
from tonewood.workshop.estimate.analysis import NoteAnalysis
from tonewood.workshop.estimate.partials import Bands
from tonewood.workshop.estimate.recordings import FS

#: s after the onset at which levels are compared
TIMES = np.arange(0.05, 0.5, 0.01)
#: Hz, partials that are looked at, and most of them; pitches whose partials are far enough apart
_BAND, _MOST, _LOWEST = (1000.0, 5000.0), 12, 100.0
#: dB, mixes that are tried, least number of notes, and share of misfit that a room has to take off
MIXES, FEWEST, _GAIN = np.arange(-24.0, 12.1, 1.5), 5, 0.8
#: dB, widest interval of a mix that is known
_WIDEST = 9.0
#: dB, mix that leaves the direct sound alone
_NONE = -400.0
#: boxes that are tried
BOXES = ("studio", "small")


@dataclass(frozen=True)
class RoomShare:
    """A room that brings rendered notes to the recorded ones.

    room, mix_db : of `tonewood.sound.room`.
    interval : dB, 90 % of the mix, by bootstrap over notes.
    dry, wet : dB, median misfit of the level between partials without the room and with it.
    notes : compared.
    """

    room: str
    mix_db: float
    interval: tuple[float, float]
    dry: float
    wet: float
    notes: int

    @property
    def known(self) -> bool:
        """Whether the notes agree on the mix."""
        return self.interval[1] - self.interval[0] <= _WIDEST


def between(x: Floats, note: NoteAnalysis) -> tuple[Complexes, Complexes] | None:
    """Envelopes half-way between partials at `TIMES`, and of the partials in the first 50 ms of these: linear in `x`.

    Returns (partials, times) each; None for notes too low, too short, or without partials there.
    """
    f0, b = note.f0, note.b
    if not np.isfinite(b) or f0 < _LOWEST:
        return None
    bands = Bands(x, round(note.onset * FS))
    numbers = np.arange(1, int(_BAND[1] / f0) + 1)
    at, half = (m * f0 * np.sqrt(1 + b * m**2) for m in (numbers, numbers + 0.5))
    inside = np.flatnonzero((half > _BAND[0]) & (half < _BAND[1]))[:_MOST]
    if not len(inside) or bands.end < TIMES[-1] + 0.1:
        return None

    def envelope(freq: float, times: Floats) -> Complexes:
        y, t = bands.envelope(freq, 0.15 * f0)
        return np.asarray(np.interp(times, t, y.real) + 1j * np.interp(times, t, y.imag))

    return (
        np.array([envelope(float(freq), TIMES) for freq in half[inside]]),
        np.array([envelope(float(freq), TIMES[:6]) for freq in at[inside]]),
    )


def _level(halves: Complexes, partials: Complexes) -> Floats:
    """Level at `TIMES`, dB."""
    return np.asarray(10 * np.log10(np.mean(np.abs(halves) ** 2, axis=0) / np.mean(np.abs(partials) ** 2) + 1e-12))


def room_share(
    recorded: Sequence[tuple[Floats, NoteAnalysis]], rendered: Sequence[tuple[Floats, NoteAnalysis]]
) -> RoomShare | None:
    """Find the room and the mix that fill the space between partials as in recorded notes.

    recorded, rendered : sound and analysis of the same notes.
    Returns None where no room brings the rendered notes nearer, or too few notes tell.
    Raises TonewoodError : pyroomacoustics is not installed.
    """
    from scipy.signal import fftconvolve

    measured, dry = [], []
    for (x, a), (y, b) in zip(recorded, rendered, strict=True):
        pair = between(x, a), between(y, b)
        if pair[0] is not None and pair[1] is not None:
            measured.append(_level(*pair[0]))
            dry.append((y, b, _level(*pair[1])))
    if len(measured) < FEWEST:
        return None
    targets = np.array(measured)
    before = float(np.median(np.mean(np.abs(targets - np.array([level for _, _, level in dry])), axis=1)))
    best: RoomShare | None = None
    for room in BOXES:
        whole, direct = (room_response(room, FS, 1, mix_db=mix)[:, 0] for mix in (0.0, _NONE))
        levels = []
        for y, b, _ in dry:
            parts = [between(fftconvolve(y, h)[: len(y)], b) for h in (direct, whole - direct)]
            first, late = (part for part in parts if part is not None)
            levels.append([_level(*(p + g * q for p, q in zip(first, late, strict=True))) for g in 10 ** (MIXES / 20)])
        misfit = np.mean(np.abs(np.array(levels) - targets[:, None]), axis=2)
        rng = np.random.default_rng(1)
        drawn = [
            MIXES[np.argmin(np.median(misfit[rng.integers(0, len(misfit), len(misfit))], axis=0))] for _ in range(60)
        ]
        k = int(np.argmin(np.median(misfit, axis=0)))
        wet_misfit = float(np.median(misfit[:, k]))
        low, high = np.percentile(drawn, [5, 95])
        if best is None or wet_misfit < best.wet:
            best = RoomShare(room, float(MIXES[k]), (float(low), float(high)), before, wet_misfit, len(misfit))
    return best if best is not None and best.wet < _GAIN * before else None
