"""Every gesture of an instrument made once, and a few milliseconds of all of them stepped with their effects."""

from __future__ import annotations

import numpy as np

from tonewood.instrument.model.assembly import Model
from tonewood.instrument.model.references import by_part
from tonewood.instrument.model.strings import StringModel
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.playing import perform
from tonewood.performance.player.timeline import GRID
from tonewood.performance.score.note import Note, Score

#: s, between gestures that share a string; grid points that are stepped after the last one's time
_APART, _AFTER = 0.005, 8


def try_parts(model: Model) -> list[str]:
    """Make the gesture of every exciter on an open string and step them; compare attachments at the last stops.

    Each exciter and effect is so asked once for all that a render asks; assembly has asked the other plugins.

    Returns Names of output groups that hear nothing of all that.
    Raises TonewoodError : a plugin breaks the contract; names it.
    """
    strings = list(model.groups)
    if not strings:
        return []
    notes = [
        Note(_APART * (i // len(strings)), _APART, string=strings[i % len(strings)], stop=0, technique=name)
        for i, name in enumerate(model.exciters)
    ]
    for name in strings:
        if model.strings[name].n_stops:
            _same_connections(model.strings[name])
    engine = Engine(model, perform(Score(notes), model).timeline)
    last = max(note.time for note in notes) * model.fs
    heard = np.zeros(len(model.system.readouts), dtype=bool)
    while engine.state.sample < last + _AFTER * GRID:
        heard |= engine.advance(1).any(axis=0)
    for effect in engine.effects:
        effect.report(engine.usage)
    return [group.name for group in model.outputs if not heard[list(group.readouts)].any()]


def _same_connections(string: StringModel) -> None:
    """Refuse a part whose connections differ at the last stop from those of the open string."""
    stopped = by_part(string.connections(string.n_stops))
    for part, opened in by_part(string.connections()).items():
        now = [(c.name, c.terms) for c in stopped.get(part, ())]
        if now != [(c.name, c.terms) for c in opened] and part in string.touching:
            plugin = string.touching[part]
            raise plugin.fault(
                f"{type(plugin).__name__}.attach returns other connections at stop {string.n_stops} of {string.name} "
                "than on the open string; the same names and terms are wanted, laws may differ"
            )
