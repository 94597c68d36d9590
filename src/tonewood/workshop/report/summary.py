"""What changed from one instrument to another, in a few numbers, and whether published thresholds say it is heard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tonewood.workshop.report.facts import BodyMode, InstrumentFacts
from tonewood.workshop.report.noticed import BODY_DAMPING, BODY_FREQ, DECAY, LEVEL, Threshold, resonance

if TYPE_CHECKING:
    from tonewood.workshop.report.comparison import Comparison

#: Hz, band of the mean mobility; Hz, below which lie the modes that are listed
BAND, _LISTED = (80.0, 1000.0), 2000.0
#: modes that are listed; dB below the strongest peak of mobility at which a mode is no more looked at
_MODES, _WEAK = 5, 20.0
_LOUDNESS = "loudness, mean of the notes"
#: cents of severity from which on a wolf is counted
_WOLF_CENTS = 10.0


@dataclass(frozen=True, slots=True)
class FigureChange:
    """One figure of two instruments.

    before, after : of the first instrument and the other, in `unit`.
    unit : of both; empty for a number.
    difference : after less before, in `scale`.
    scale : ``%`` of the value before, or the unit itself.
    threshold : least difference that was noticed; None where none is published.
    """

    name: str
    before: float
    after: float
    unit: str
    difference: float
    scale: str
    threshold: Threshold | None

    @property
    def times(self) -> float | None:
        """How many times the least noticed difference this one is; None without a threshold."""
        return None if self.threshold is None else self.threshold.times(self.difference)

    @property
    def verdict(self) -> str:
        """Whether it is heard, in words."""
        if self.threshold is None or self.times is None:
            return "no threshold is published"
        heard = "may be heard" if self.times >= 1 else "hardly heard"
        return f"{heard}: {self.times:.2g} x the least noticed"


def key_figures(facts: InstrumentFacts) -> dict[str, tuple[float, str]]:
    """Figures that describe an instrument in a line, as far as it has them: name -> value and unit."""
    out: dict[str, tuple[float, str]] = {}
    for name in ("A0", "T1"):
        if name in facts.named:
            out[name] = (facts.body_modes[facts.named[name]].freq, "Hz")
    if facts.mass is not None:
        out["mass of the body"] = (1e3 * facts.mass, "g")
    inside = (facts.freq >= BAND[0]) & (facts.freq <= BAND[1])
    if facts.mobility and inside.sum() > 1:
        x = np.log(facts.freq[inside])
        levels = [20 * np.log10(np.maximum(np.abs(y[inside]), 1e-12)) for y in facts.mobility.values()]
        mean = float(np.mean([np.trapezoid(level, x) for level in levels]) / (x[-1] - x[0]))
        out[f"mean mobility, {BAND[0]:g} to {BAND[1]:g} Hz"] = (mean, "dB")
    heard = [tone.lufs for tone in facts.tones.values() if math.isfinite(tone.lufs)]
    if heard:
        out[_LOUDNESS] = (float(np.mean(heard)), "LUFS")
    decays = [note.t60 for note in facts.notes if math.isfinite(note.t60)]
    if decays:
        out["decay, median T60 of all stops"] = (float(np.median(decays)), "s")
    if facts.strings:
        worst = max((wolf.severity_cents for wolf in facts.wolves), default=0.0)
        out["worst wolf note, severity"] = (worst, "cents")
        out[f"wolf notes of {_WOLF_CENTS:g} cents or more"] = (
            float(sum(wolf.severity_cents >= _WOLF_CENTS for wolf in facts.wolves)), "",
        )  # fmt: skip
    return out


def changes(comparison: Comparison, i: int) -> list[FigureChange]:
    """Differences of instrument `i` from the first, the named figures before the modes that changed most."""
    first, other = comparison.instruments[0], comparison.instruments[i]
    before, after = key_figures(first), key_figures(other)
    if first.tones.keys() != other.tones.keys():
        shared = {**first.tones}.keys() & other.tones.keys()
        for figures, facts in ((before, first), (after, other)):
            heard = [facts.tones[note].lufs for note in shared if math.isfinite(facts.tones[note].lufs)]
            figures.pop(_LOUDNESS, None)
            if heard:
                figures[_LOUDNESS] = (float(np.mean(heard)), "LUFS")
    level_db = _shift_db(first, other)
    if level_db is None:
        before.pop(_LOUDNESS, None)
    elif _LOUDNESS in after:  # re the full scale of the first
        after[_LOUDNESS] = (after[_LOUDNESS][0] + level_db, "LUFS")
    out = []
    for name, (value, unit) in before.items():
        if name in after:
            out.append(_change(name, value, after[name][0], unit, _threshold(name, first, other)))
    pairs = [
        (a, b) for match in comparison.modes if (a := match.modes[0]) and (b := match.modes[i]) and a.freq and b.freq
    ]
    if pairs:
        shift = [100 * (b.freq / a.freq - 1) for a, b in pairs]
        at = float(np.median([a.freq for a, _ in pairs]))
        middle = float(np.median(shift))
        out.append(FigureChange("all body modes, median", at, at * (1 + middle / 100), "Hz", middle, "%", BODY_FREQ))
        lossy = [(1 / a.q, 1 / b.q) for a, b in pairs if math.isfinite(a.q) and math.isfinite(b.q)]
        if lossy:
            middle = 100 * (float(np.median([b / a for a, b in lossy])) - 1)
            at = 100 * float(np.median([a for a, _ in lossy]))
            name = "damping of all body modes, median"
            out.append(FigureChange(name, at, at * (1 + middle / 100), "%", middle, "%", BODY_DAMPING))
    return out + _most_changed(pairs, [first, other])


def _shift_db(first: InstrumentFacts, other: InstrumentFacts) -> float | None:
    """See `Tone.shift_db`; 0 where no note was played on both."""
    pairs = [(first.tones[note], tone) for note, tone in other.tones.items() if note in first.tones]
    return pairs[0][1].shift_db(pairs[0][0]) if pairs else 0.0


def _most_changed(pairs: Sequence[tuple[BodyMode, BodyMode]], facts: Sequence[InstrumentFacts]) -> list[FigureChange]:
    """Of modes whose peak of mobility counts, those whose frequency changed by most times what is noticed."""
    if not pairs:
        return []
    peaks = np.array([max(m.residue * m.t60 for m in pair) for pair in pairs])
    strong = peaks >= peaks.max() * 10 ** (-_WEAK / 20)
    named = {id(f.body_modes[k]): name for f in facts for name, k in f.named.items()}
    rows = [
        _change(f"mode at {a.freq:.0f} Hz", a.freq, b.freq, "Hz", resonance(0.5 * (min(a.q, 1e6) + min(b.q, 1e6))))
        for (a, b), counts in zip(pairs, strong, strict=True)
        if counts and a.freq < _LISTED and id(a) not in named and id(b) not in named
    ]
    rows.sort(key=lambda row: -(row.times or 0.0))
    return [row for row in rows[:_MODES] if row.difference]


def _change(name: str, before: float, after: float, unit: str, threshold: Threshold | None) -> FigureChange:
    relative = unit in ("Hz", "g", "s") and before > 0
    difference = 100 * (after / before - 1) if relative else after - before
    return FigureChange(
        name, before, after, unit, difference, "%" if relative else unit.replace("LUFS", "dB"), threshold
    )


def _threshold(name: str, first: InstrumentFacts, other: InstrumentFacts) -> Threshold | None:
    if name in ("A0", "T1"):
        qs = [facts.body_modes[facts.named[name]].q for facts in (first, other)]
        return resonance(0.5 * (min(qs[0], 1e6) + min(qs[1], 1e6)))
    return LEVEL if name.startswith("loudness") else DECAY if name.startswith("decay") else None


def value_words(value: float, unit: str) -> str:
    """A figure with its unit."""
    digits = {"Hz": 1, "g": 1, "dB": 1, "LUFS": 1, "s": 2, "cents": 0, "%": 2}.get(unit, 0)
    return f"{value:.{digits}f} {unit}".strip()


def difference_words(change: FigureChange) -> str:
    """A difference with its sign and unit."""
    text = f"{change.difference:+.{0 if change.scale in ('cents', '') else 1}f}"
    return f"{'0' if not float(text) else text} {change.scale}".strip()


def heard_words(comparison: Comparison, i: int, rows: Sequence[FigureChange]) -> str:
    """One sentence: which of the changes of instrument `i` may be heard, and whether a note was played on both."""
    heard = [row.name for row in rows if row.times is not None and row.times >= 1]
    words = "no change here reaches a published threshold of hearing"
    if heard:
        words = f"by published thresholds these may be heard: {'; '.join(heard)}"
    first, other = comparison.instruments[0], comparison.instruments[i]
    if (first.tones or other.tones) and not first.tones.keys() & other.tones.keys():
        words = f"no note was played on both, so their sounds are not compared; of the other figures, {words}"
    elif _shift_db(first, other) is None:
        units = " and ".join(next(iter(facts.tones.values())).unit for facts in (first, other))
        words = f"their outputs are in {units}, so their levels are not compared; of the other figures, {words}"
    return words


def lines(comparison: Comparison, i: int) -> list[str]:
    """Differences of instrument `i` from the first, as lines of a terminal."""
    rows = changes(comparison, i)
    texts = [(r.name, value_words(r.before, r.unit), value_words(r.after, r.unit), difference_words(r)) for r in rows]
    wide = [max((len(row[k]) for row in texts), default=0) for k in range(4)]
    out = [heard_words(comparison, i, rows)]
    for row, (name, before, after, difference) in zip(rows, texts, strict=True):
        pair = f"{name:<{wide[0]}}  {before:>{wide[1]}} to {after:>{wide[2]}}  {difference:>{wide[3]}}"
        out.append(f"  {pair}  {row.verdict}")
    return out
