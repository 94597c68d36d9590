"""Place of the pluck, and what playing louder changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tonewood.support.arrays import Floats
from tonewood.workshop.estimate.analysis import NoteAnalysis
from tonewood.workshop.estimate.playing import Played

#: m, step of the search; partials that are looked at; dB at which a partial's misfit counts no more
_STEP, _MOST, _OUTLIER = 0.001, 22, 12.0


def place_of(note: NoteAnalysis, length: float, longest: float) -> float:
    """Distance of the pluck from the nearer end, m: that whose comb explains the levels of the partials best.

        L_n = 10 lg(sin^2(n pi d / l) + 0.01) + cubic in ln f_n

    note : with its partials.
    length : l, m, of the string at its stop.
    longest : m, largest distance that is tried; half of the length at most.
    Returns nan where fewer than nine partials are known.
    """
    rows = [(n, p.freq, p.level) for n, p in note.partials.items() if n <= _MOST]
    if len(rows) < 9:
        return np.nan
    n, f, y = np.array(rows).T
    x = np.log(f) - np.log(f).mean()
    cubic = np.vander(x, 4)
    places = np.arange(0.03 * length, min(longest, 0.5 * length), _STEP)
    combs = 10 * np.log10(np.sin(np.outer(n, places) * np.pi / length) ** 2 + 0.01)
    rest = y[:, None] - combs
    rest -= cubic @ np.linalg.lstsq(cubic, rest)[0]
    cost = np.mean(np.minimum(np.abs(rest), _OUTLIER), axis=0)
    return float(places[int(np.argmin(cost))])


@dataclass(frozen=True)
class PluckPlaces:
    """Places of the pluck by the comb in recorded and rendered notes, m: medians, and the scatter of the recorded."""

    recorded: float
    rendered: float
    scatter: float
    notes: int

    @property
    def moved(self) -> float:
        """m, by which the place is to be moved."""
        return self.recorded - self.rendered


def places(
    notes: Sequence[Played], recorded: Sequence[NoteAnalysis], rendered: Sequence[NoteAnalysis], longest: float
) -> PluckPlaces | None:
    """Median of the places of the notes that show one in both; None with fewer than three of these.

    Notes whose place was told are left out.
    """
    positions = []
    for played, rec, syn in zip(notes, recorded, rendered, strict=True):
        pair = [place_of(a, played.length, longest) for a in (rec, syn)]
        if np.isfinite(pair).all() and played.recording.place is None:
            positions.append(pair)
    if len(positions) < 3:
        return None
    table = np.array(positions)
    # of the recorded combs that are mistaken for another one, most are far off: a median of differences is robust
    shift = float(np.median(table[:, 0] - table[:, 1]))
    middle = float(np.median(table[:, 1]))
    scatter = float(1.4826 * np.median(np.abs(table[:, 0] - np.median(table[:, 0]))))
    return PluckPlaces(middle + shift, middle, scatter, len(positions))


@dataclass(frozen=True)
class Louder:
    """Change from soft to loud strokes of the same notes: medians.

    peak : dB, of the largest sample; nan where files were normalised one by one.
    bright : dB, of the share of 3 to 8 kHz.
    steps : MIDI velocity, between the two dynamics.
    notes : pairs.
    """

    peak: float
    bright: float
    steps: float
    notes: int

    @property
    def per_7_db(self) -> float:
        """Brightness (dB) that go with 7 dB of peak."""
        return 7 * self.bright / self.peak if self.peak > 1 else np.nan


def louder(notes: Sequence[Played], analyses: Sequence[NoteAnalysis]) -> Louder | None:
    """Compare the softest and the loudest stroke of each note and place; None with fewer than three pairs.

    Peaks that are all alike within 0.5 dB were made so, and say nothing of the strokes.
    """
    by_place: dict[tuple[str, float], list[tuple[float, NoteAnalysis]]] = {}
    for played, analysis in zip(notes, analyses, strict=True):
        if played.recording.dynamic is not None:
            by_place.setdefault((played.string, played.stop), []).append((played.recording.dynamic, analysis))
    rows = []
    for strokes in by_place.values():
        (low, soft), (high, loud) = (pick(strokes, key=lambda stroke: stroke[0]) for pick in (min, max))
        if high > low:
            rows.append((loud.peak - soft.peak, loud.bright - soft.bright, high - low))
    if len(rows) < 3:
        return None
    peaks = [analysis.peak for strokes in by_place.values() for _, analysis in strokes]
    peak, bright, steps = np.median(rows, axis=0)
    return Louder(float(peak) if np.ptp(peaks) > 0.5 else np.nan, float(bright), float(steps), len(rows))


def pairs(notes: Sequence[Played]) -> tuple[Played, ...]:
    """Softest and loudest stroke of each note and place that has two dynamics."""
    by_place: dict[tuple[str, float], list[Played]] = {}
    for played in notes:
        if played.recording.dynamic is not None:
            by_place.setdefault((played.string, played.stop), []).append(played)
    out: list[Played] = []
    for strokes in by_place.values():
        ends = [pick(strokes, key=lambda p: p.recording.dynamic or 0.0) for pick in (min, max)]
        if ends[0].recording.dynamic != ends[1].recording.dynamic:
            out += ends
    return tuple(out)


def scaled_forces(forces: tuple[float, float], ratio: float) -> tuple[float, float]:
    """Forces at both ends of the velocity curve, whose range in dB is multiplied and whose middle stays."""
    middle, half = np.sqrt(forces[0] * forces[1]), np.sqrt(forces[1] / forces[0]) ** ratio
    return float(middle / half), float(middle * half)


def edge_for(edges: Floats, changes: Floats, change: float) -> float:
    """Edge (m) whose change of brightness from soft to loud is nearest to `change`, between those tried."""
    grid = np.geomspace(edges[0], edges[-1], 200)
    between = np.interp(np.log(grid), np.log(edges), changes)
    return float(grid[np.argmin(np.abs(between - change))])
