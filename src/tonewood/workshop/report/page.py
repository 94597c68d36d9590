"""Facts as one HTML page without network, with figures and sounds."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.support.plotting import data_uri
from tonewood.workshop.report.comparison import Comparison, alike
from tonewood.workshop.report.facts import InstrumentFacts
from tonewood.workshop.report.figures import (
    decay_picture,
    mobility_picture,
    notes_picture,
    shapes_pictures,
    spectrogram_picture,
    wolf_picture,
)
from tonewood.workshop.report.offline import offline_page
from tonewood.workshop.report.tones import flac, matched_gains_db

#: rows of the table of modes
MOST_ROWS = 150


def page(found: Comparison) -> str:
    """A comparison, or of one instrument a report, as HTML; every text of a bundle is escaped.

    Raises
    ------
    TonewoodError : jinja2 is not installed.
    """
    template = (files("tonewood.workshop.report") / "page.html").read_text(encoding="utf-8")
    several = len(found.instruments) > 1
    names = [facts.heading for facts in found.instruments]
    return offline_page(
        template,
        found=found,
        several=several,
        title=", ".join(names) if several else found.instruments[0].title,
        most_rows=MOST_ROWS,
        modes_differ=any(not alike(match) for match in found.modes),
        tones=[_tone(found, note) for note in found.tones],
        mobility=mobility_picture(found),
        shapes=shapes_pictures(found),
        t60_picture=notes_picture(found, "t60"),
        cents_picture=notes_picture(found, "cents_mounted"),
        wolf_picture=wolf_picture(found),
        wolf_stops=_wolf_stops,
    )


def _tone(found: Comparison, note: str) -> dict[str, Any]:
    """Sounds and pictures of one note."""
    played = [(i, facts, facts.tones[note]) for i, facts in enumerate(found.instruments) if note in facts.tones]
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
            for facts in found.instruments
            if note in facts.missing_tones
        ],
        "decay": decay_picture(found, note),
        "spectrogram": spectrogram_picture(found, note),
    }


def _wolf_stops(facts: InstrumentFacts, wolf: WolfNote) -> str:
    """Notes at the stops within a wolf note."""
    return ", ".join(n.note for n in facts.notes if n.string == wolf.string and n.stop in wolf.stops)
