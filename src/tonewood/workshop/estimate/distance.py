"""Distances between two sets of notes: two guitars, a guitar and its model, two strokes of one guitar.

third octaves   dB rms of the levels of third octaves (100 Hz to 10 kHz) in four parts of the note, to 1.2 s, less one
                gain for the whole note, of bands within 50 dB of the loudest; a difference counts 20 dB at most
onset           the same of the first 50 ms alone, less one gain for these
decays          factor exp |ln(a / b)| between rates of decay of the same partial, over its first 30 and 15 dB
levels          dB rms of the levels of the same partials, less one gain a note
rise            ms between the times in which the two notes rise

Each is the median over notes, that of decays over the partials of all notes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from tonewood.workshop.estimate.analysis import NoteAnalysis

#: dB below the loudest band, and most that a difference counts
_RANGE, _MOST = 50.0, 20.0


@dataclass(frozen=True)
class Distance:
    """Distance between two sets of notes, see the module; nan where nothing could be compared.

    third_octaves, onset, levels : dB rms.
    decays, early_decays : factors, of the first 30 and 15 dB.
    rise : ms.
    notes, partials : compared.
    """

    third_octaves: float
    onset: float
    decays: float
    early_decays: float
    levels: float
    rise: float
    notes: int
    partials: int

    #: field -> its name and unit for people
    LABELS: ClassVar[dict[str, str]] = {
        "third_octaves": "third octaves over time, dB",
        "onset": "third octaves of the onset, dB",
        "decays": "decay of partials over 30 dB, factor",
        "early_decays": "decay of partials over 15 dB, factor",
        "levels": "levels of partials, dB",
        "rise": "rise, ms",
    }

    def as_dict(self) -> dict[str, float | int]:
        """Fields by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def bands_apart(a: NoteAnalysis, b: NoteAnalysis, parts: slice = slice(None)) -> float:
    """Rms (dB) between third octaves of parts of two notes, less one gain; nan where no band can be compared."""
    p, q = a.bands[parts], b.bands[parts]
    use = np.isfinite(p) & np.isfinite(q)
    if not use.any():
        return np.nan
    use &= p > np.max(p[use]) - _RANGE
    difference = np.clip((p - q)[use], -200, 200)
    return float(np.sqrt(np.mean(np.clip(difference - np.median(difference), -_MOST, _MOST) ** 2)))


def distance(pairs: Iterable[tuple[NoteAnalysis, NoteAnalysis]]) -> Distance:
    """Distance between notes, pair by pair.

    pairs : note of one set, note of the other. Partials count in decays if both are clear (`NotePartial.clear`).
    """
    third, onset, levels, rise, late, early = [], [], [], [], [], []
    rows = list(pairs)
    for a, b in rows:
        third.append(bands_apart(a, b))
        onset.append(bands_apart(a, b, slice(0, 1)))
        rise.append(1e3 * abs(a.rise - b.rise))
        both = [(p, b.partials[n]) for n, p in a.partials.items() if n in b.partials]
        if len(both) > 2:
            d = np.array([p.level - q.level for p, q in both])
            levels.append(float(np.sqrt(np.mean(np.clip(d - np.median(d), -_MOST, _MOST) ** 2))))
        clear = [(p, q) for p, q in both if p.clear and q.clear]
        late += [abs(np.log(p.rate / q.rate)) for p, q in clear]
        early += [abs(np.log(p.early / q.early)) for p, q in clear if np.isfinite(p.early) and np.isfinite(q.early)]
    return Distance(
        _median(third), _median(onset), float(np.exp(_median(late))), float(np.exp(_median(early))), _median(levels),
        _median(rise), len(rows), len(late),
    )  # fmt: skip


def neighbours(notes: Sequence[tuple[int, NoteAnalysis]]) -> list[tuple[NoteAnalysis, NoteAnalysis]]:
    """Pairs of notes a semitone apart, of one set: by MIDI number."""
    first: dict[int, NoteAnalysis] = {}
    for note, analysis in notes:
        first.setdefault(note, analysis)
    return [(a, first[note + 1]) for note, a in first.items() if note + 1 in first]


def strokes(notes: Sequence[tuple[int, NoteAnalysis]]) -> list[tuple[NoteAnalysis, NoteAnalysis]]:
    """Pairs of strokes of one note, of one set."""
    out: list[tuple[NoteAnalysis, NoteAnalysis]] = []
    seen: dict[int, NoteAnalysis] = {}
    for note, analysis in notes:
        if note in seen:
            out.append((seen[note], analysis))
        seen[note] = analysis
    return out


def _median(values: Sequence[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else np.nan
