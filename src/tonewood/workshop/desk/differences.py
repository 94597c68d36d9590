"""What differs between a design and the start, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.instrument.model.assembly import Model
from tonewood.support.units import cents
from tonewood.workshop.report.comparison import match_modes, match_wolves
from tonewood.workshop.report.facts import BodyMode, body_modes

#: modes that are compared
MOST_MODES = 400


def differences(model: Model, start: Model) -> list[str]:
    """Return what differs from the start, in words: strongest modes moved or without a counterpart, open strings."""
    lines: list[str] = []
    before, after = body_modes(start)[:MOST_MODES], body_modes(model)[:MOST_MODES]
    moved, alone = [], []
    for match in match_modes([before, after]):
        a, b = match.modes
        if a is None or b is None:
            alone += [(mode, words) for mode, words in ((a, "of the start"), (b, "of the design")) if mode is not None]
        elif _differ(a, b):
            moved.append((a, b))
    # highest peaks of the mobility first
    for a, b in sorted(moved, key=lambda pair: -pair[0].residue * pair[0].q / pair[0].freq)[:3]:
        level = 10 * math.log10(b.residue / a.residue) if a.residue > 0 and b.residue > 0 else 0.0
        lines.append(
            f"body mode {a.freq:.1f} → {b.freq:.1f} Hz ({cents(b.freq / a.freq):+.0f} cents), "
            f"Q {a.q:.0f} → {b.q:.0f}, at the bridge {level:+.1f} dB"
        )
    alone.sort(key=lambda pair: -pair[0].residue * pair[0].q / pair[0].freq)
    lines += [f"mode {words} at {mode.freq:.1f} Hz has no counterpart" for mode, words in alone[:3]]
    if len(alone) > 3:
        lines.append(f"{len(alone) - 3} weaker modes have no counterpart")
    lost, more = len(before), len(after)
    if lost != more:
        lines.append(f"modes of the body: {lost} → {more}")
    for name in list(model.groups)[:12]:
        if name in start.strings and (line := _string_line(name, start, model)):
            lines.append(line)
    return lines


def wolf_words(start: Sequence[WolfNote], now: Sequence[WolfNote]) -> list[str]:
    """Return which wolf notes differ from the start's, in words, the most severe first."""
    lines = []
    for match in match_wolves([start, now]):
        one, other = match.wolves
        where = one or other
        sizes = [f"{x.severity_cents:.1f}" if x is not None else "none" for x in (one, other)]
        if where is not None and sizes[0] != sizes[1]:
            lines.append(f"wolf note on {where.string} at {where.worst_freq:.0f} Hz: {' → '.join(sizes)} cents")
    return lines[:6]


def _differ(a: BodyMode, b: BodyMode) -> bool:
    return (
        abs(cents(b.freq / a.freq)) > 0.5
        or abs(b.q / a.q - 1) > 0.01
        or abs(b.residue / max(a.residue, 1e-30) - 1) > 0.02
    )


def _string_line(name: str, start: Model, model: Model) -> str:
    a, b = start.strings[name], model.strings[name]
    parts = []
    if abs(b.tension(0) / a.tension(0) - 1) > 0.002:
        parts.append(f"tension {a.tension(0):.1f} → {b.tension(0):.1f} N")
    if abs(cents(b.freq(0) / a.freq(0))) > 0.5:
        parts.append(f"{a.freq(0):.2f} → {b.freq(0):.2f} Hz")
    return f"string {name}: {', '.join(parts)}" if parts else ""
