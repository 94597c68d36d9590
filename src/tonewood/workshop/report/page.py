"""Facts as one HTML page without network, with figures and sounds."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.support.page.offline import offline_page
from tonewood.support.plotting import data_uri
from tonewood.workshop.report.comparison import Comparison, alike
from tonewood.workshop.report.facts import InstrumentFacts
from tonewood.workshop.report.figures import (
    decay_picture,
    mobility_picture,
    notes_picture,
    shapes_picture,
    spectrogram_picture,
    sweep_picture,
    wolf_picture,
)
from tonewood.workshop.report.summary import changes, difference_words, heard_words, key_figures, value_words
from tonewood.workshop.report.tones import flac, matched_gains_db

#: rows of the table of modes
MOST_ROWS = 150
#: tables of what changed, rows of a table, wolf notes, notes, spectrograms and tables of strings that are printed, on
#: six A4 pages at most
PRINTED: dict[str, Any] = {
    "print_summaries": 3, "print_rows": 24, "print_wolves": 5, "print_notes": 4, "print_spectrograms": 2,
    "print_strings": 2,
}  # fmt: skip


def page(comparison: Comparison) -> str:
    """A comparison, or of one instrument a report, as HTML; every text of a bundle is escaped.

    Raises TonewoodError : jinja2 is not installed.
    """
    template = (files("tonewood.workshop.report") / "page.html").read_text(encoding="utf-8")
    several = len(comparison.instruments) > 1
    names = [facts.heading for facts in comparison.instruments]
    return offline_page(
        template,
        comparison=comparison,
        several=several,
        title=", ".join(names) if several else comparison.instruments[0].title,
        most_rows=MOST_ROWS,
        figures=[(name, value_words(*pair)) for name, pair in key_figures(comparison.instruments[0]).items()],
        summary=[] if comparison.sweep else [_summary(comparison, i) for i in range(1, len(comparison.instruments))],
        sweep=_sweep(comparison) if comparison.sweep else None,
        modes_differ=any(not alike(match) for match in comparison.modes),
        tones=[_tone(comparison, note) for note in comparison.tones],
        mobility=mobility_picture(comparison),
        shapes=shapes_picture(comparison),
        t60_picture=notes_picture(comparison, "t60"),
        cents_picture=notes_picture(comparison, "cents_mounted"),
        wolf_picture=wolf_picture(comparison),
        wolf_stops=_wolf_stops,
        origins=_origins(comparison),
        **PRINTED,
    )


def _summary(comparison: Comparison, i: int) -> dict[str, Any]:
    """Changes of one instrument from the first."""
    rows = changes(comparison, i)
    return {
        "index": i,
        "label": comparison.instruments[i].label,
        "short": comparison.instruments[i].short,
        "said": heard_words(comparison, i, rows),
        "rows": [
            (
                row.name,
                value_words(row.before, row.unit),
                value_words(row.after, row.unit),
                difference_words(row),
                row.times is not None and row.times >= 1,
                row.verdict,
                row.threshold.source if row.threshold else "",
            )
            for row in rows
        ],
    }


def _sweep(comparison: Comparison) -> dict[str, Any]:
    """Key figures over the swept value."""
    rows = [(value, facts, key_figures(facts)) for value, facts in comparison.swept()]
    names = list(dict.fromkeys(name for _, _, figures in rows for name in figures))
    cells = [[value_words(*f[name]) if name in f else "\N{EN DASH}" for name in names] for _, _, f in rows]
    return {
        "names": names,
        "rows": [(f"{v:g}", facts.label, row) for (v, facts, _), row in zip(rows, cells, strict=True)],
        "picture": sweep_picture(comparison),
    }


def _origins(comparison: Comparison) -> list[tuple[str, InstrumentFacts]]:
    """Instruments that name other sources than those before them, each with all labels that share them."""
    groups: dict[tuple[str, str], list[InstrumentFacts]] = {}
    for facts in comparison.instruments:
        groups.setdefault((facts.name, repr((facts.sources, facts.stand_ins, facts.kinds))), []).append(facts)
    return [(", ".join(facts.label for facts in group), group[0]) for group in groups.values()]


def _tone(comparison: Comparison, note: str) -> dict[str, Any]:
    """Sounds and pictures of one note."""
    played = [(i, facts, facts.tones[note]) for i, facts in enumerate(comparison.instruments) if note in facts.tones]
    gains = matched_gains_db([tone for _, _, tone in played])
    _, facts, tone = played[0]
    sounding = next((n.note for n in facts.notes if (n.string, n.stop) == (tone.string, tone.stop)), note)
    return {
        "note": note if sounding == note else f"{note} ({sounding})",
        "sounds": [
            {
                "index": i,
                "label": facts.short,
                "tone": tone,
                "gain_db": gain,
                "uri": data_uri(flac(tone, gain), "audio/flac"),
            }
            for (i, facts, tone), gain in zip(played, gains, strict=True)
        ],
        "missing": [
            f"{facts.label} does not play {note}: {facts.missing_tones[note]}"
            for facts in comparison.instruments
            if note in facts.missing_tones
        ],
        "decay": decay_picture(comparison, note),
        "spectrogram": spectrogram_picture(comparison, note),
    }


def _wolf_stops(facts: InstrumentFacts, wolf: WolfNote) -> str:
    """Notes at the stops within a wolf note."""
    return ", ".join(n.note for n in facts.notes if n.string == wolf.string and n.stop in wolf.stops)
