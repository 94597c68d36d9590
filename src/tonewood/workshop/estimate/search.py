"""Indirect inference: figures are moved until recorded and rendered notes look alike to the same analysis.

C. Gourieroux, A. Monfort and E. Renault, Indirect inference, J. Applied Econometrics 8 (1993) S85. Errors of the
analysis that are the same for both, of windows, of bodies between partials, of combs, drop out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tonewood.instrument.bundle.loading import Instrument
from tonewood.support.arrays import Floats
from tonewood.workshop.estimate import gain, laws, pluck
from tonewood.workshop.estimate.analysis import NoteAnalysis, analyse
from tonewood.workshop.estimate.body_modes import LIMITS, HeardMode, body_modes
from tonewood.workshop.estimate.figures import Figures, figures_of, in_fractions, mode_tables, with_laws
from tonewood.workshop.estimate.playing import Played, Stage, render_notes, seconds_of
from tonewood.workshop.estimate.recordings import FS, Recording

#: most that a figure moves at once: ratio of B, ratio of the splitting, m of the place
_MOST_B, _MOST_SPLIT, _MOST_PLACE = 3.0, 1.8, 0.04
#: cents, range of the splitting
_SPLITS = (0.05, 12.0)
#: edges that are tried for pairs of soft and loud, re the present one; most ratio of the range of forces at once
EDGES, _MOST_RANGE = np.geomspace(0.3, 3.3, 7), 2.0
#: largest ratio by which Q moves at once, and between the frequencies of a mode recorded and rendered
_MODE_STEP, _PAIR = 2.0, 1.2
#: s of a note that tell its brightness
_SHORT = 0.8
#: of the open length, farthest place of a pluck
_FARTHEST = 0.4


@dataclass(frozen=True, eq=False)
class RenderedNotes:
    """Notes of an instrument, rendered and analysed.

    sounds : of the first output, one a note.
    analyses : output -> one a note.
    """

    sounds: tuple[Floats, ...]
    analyses: Mapping[str, tuple[NoteAnalysis, ...]]

    @property
    def main(self) -> tuple[NoteAnalysis, ...]:
        """Those of the first output."""
        return next(iter(self.analyses.values()))


def rendered(
    instrument: Instrument, notes: Sequence[Played], outputs: Sequence[str], advance: Callable[[float], None]
) -> RenderedNotes:
    """Render notes and analyse them as the recorded ones are, with the same end of the band."""
    sounds = render_notes(instrument, notes, outputs, advance)
    analyses: dict[str, list[NoteAnalysis]] = {name: [] for name in outputs}
    for played, by_output in zip(notes, sounds, strict=True):
        for name, x in by_output.items():
            analyses[name].append(analyse(x, played.recording.freq, played.b, played.recording.freq_upper))
        advance(0.0)
    first = next(iter(outputs))
    return RenderedNotes(tuple(row[first] for row in sounds), {name: tuple(rows) for name, rows in analyses.items()})


class Search:
    """Moves the figures of an instrument towards recorded notes.

    stage : with the instrument that is begun with.
    advance : called with the seconds of sound rendered since the last call.
    keeps_loss : whether the loss of strings stays as it is begun with.
    """

    keeps_loss = False

    def __init__(self, stage: Stage, advance: Callable[[float], None] = lambda seconds: None):
        self.stage, self._advance = stage, advance
        self.outputs = tuple(part.name for part in stage.instrument.spec.outputs)
        self.start = figures_of(stage)
        self.body_table = _body_table(stage.instrument)

    def instrument(self, figures: Figures) -> Instrument:
        """The instrument with these figures."""
        return self.stage.instrument.replace(figures.overrides(self.stage.instrument))

    def render(self, figures: Figures, notes: Sequence[Played], *, all_outputs: bool = False) -> RenderedNotes:
        """Render notes with these figures, on all outputs or on the first one."""
        outputs = self.outputs if all_outputs else self.outputs[:1]
        return rendered(self.instrument(figures), notes, outputs, self._advance)

    def fit(
        self, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], start: RenderedNotes, iterations: int
    ) -> Figures:
        """Figures after some iterations.

        notes, recorded : those to fit, and their analyses.
        start : the same notes, rendered with the figures that are begun with.
        """
        figures, now = self.start, start
        for i in range(iterations):
            if i:
                now = self.render(figures, notes)
            figures = self._moved(figures, notes, recorded, now)
        return figures

    def _moved(
        self, figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], now: RenderedNotes
    ) -> Figures:
        """Figures after one iteration."""
        values, bending = self._strings(figures, notes, recorded, now.main)
        out = with_laws(figures, values, bending, self.stage)
        out = replace(out, place=self._place(figures, notes, recorded, now.main))
        out = replace(out, split=_split(figures.split, recorded, now.main))
        out = replace(out, modes=self._modes(figures, recorded, now.main))
        return self.with_gains(out, recorded, now, self.outputs[:1])

    def with_gains(
        self, figures: Figures, recorded: Sequence[NoteAnalysis], now: RenderedNotes, outputs: Sequence[str]
    ) -> Figures:
        """Figures with the gains of some outputs moved."""
        moved = {
            name: figures.gains[name] + gain.curve(gain.differences(recorded, now.analyses[name])) for name in outputs
        }
        return replace(figures, gains={**figures.gains, **moved})

    def with_strokes(self, figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis]) -> Figures:
        """Figures whose forces and edge change level and brightness from soft to loud as the recordings do.

        The range of forces is that of the recorded peaks, unless these were normalised. Of several edges, each rendered
        with both strokes, the one that brightens as much; without pairs an edge trades with the gain and stays.
        """
        louder, strokes = pluck.louder(notes, recorded), pluck.pairs(notes)
        if louder is None or figures.edge is None:
            return figures
        strokes = tuple(replace(p, recording=_shortened(p.recording)) for p in strokes)

        def changes(tried: Figures) -> pluck.Louder:
            change = pluck.louder(strokes, self.render(tried, strokes).main)
            assert change is not None, "the rendered strokes are those of the recorded pairs"
            return change

        if figures.forces is not None and np.isfinite(louder.peak):
            ratio = float(np.clip(louder.peak / changes(figures).peak, 1 / _MOST_RANGE, _MOST_RANGE))
            figures = replace(figures, forces=pluck.scaled_forces(figures.forces, ratio))
        edges = float(figures.edge or 0.0) * EDGES
        bright = np.array([changes(replace(figures, edge=float(edge))).bright for edge in edges])
        return replace(figures, edge=pluck.edge_for(edges, bright, louder.bright))

    def _modes(
        self, figures: Figures, recorded: Sequence[NoteAnalysis], now: Sequence[NoteAnalysis]
    ) -> dict[float, tuple[float, float]]:
        """Body modes that both sets of notes tell, moved by the ratios of their frequencies and Q."""
        out = dict(figures.modes)
        if not len(self.body_table):
            return out
        modes, heard = (self.body_modes(rows) for rows in (recorded, now))
        for mode in modes:
            pair = min(heard, key=lambda other: abs(np.log(other.freq / mode.freq)), default=None)
            if pair is None or not 1 / _PAIR < mode.freq / pair.freq < _PAIR:
                continue
            near = min(self.body_table, key=lambda f: abs(np.log(f * out.get(f, (1.0, 1.0))[0] / pair.freq)))
            freq, q = out.get(near, (1.0, 1.0))
            ratio = float(np.clip(mode.q / pair.q, 1 / _MODE_STEP, _MODE_STEP))
            out[near] = (freq * mode.freq / pair.freq, q * ratio)
        return out

    def body_modes(self, notes: Sequence[NoteAnalysis]) -> tuple[HeardMode, ...]:
        """Modes of the body that notes tell."""
        open_strings = [440.0 * 2 ** ((self.stage.open_note(name) - 69) / 12) for name in self.stage.instrument.groups]
        return body_modes((note.below for note in notes), open_strings)

    def _strings(
        self, figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], now: Sequence[NoteAnalysis]
    ) -> tuple[dict[str, Floats], dict[str, float]]:
        """New numbers of the loss laws, and bending stiffnesses, of the strings whose notes tell them."""
        values, bending = {}, {}
        for name, law in figures.laws.items():
            at = [i for i, played in enumerate(notes) if played.string == name]
            if not at:
                continue
            rec, syn = (laws.rates_of([rows[i] for i in at]) for rows in (recorded, now))
            if not self.keeps_loss and len(rec) >= laws.FEWEST and len(syn) >= laws.FEWEST:
                values[name] = laws.moved(law, rec, syn)
            ratios = [recorded[i].b / now[i].b for i in at if now[i].b > 0 and recorded[i].b > 0]
            ratios = [r for r in ratios if 1 / _MOST_B < r < _MOST_B]
            if ratios and figures.bending[name] > 0:
                bending[name] = figures.bending[name] * float(np.median(ratios))
        return values, bending

    def _place(
        self, figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], now: Sequence[NoteAnalysis]
    ) -> float | None:
        if figures.place is None:
            return None
        longest = max(played.length for played in notes)
        positions = pluck.places(notes, recorded, now, _FARTHEST * longest)
        if positions is None:
            return figures.place
        step = float(np.clip(positions.moved, -_MOST_PLACE, _MOST_PLACE))
        if in_fractions(self.stage.instrument):
            step /= float(np.median([played.length for played in notes]))
            return float(np.clip(figures.place + step, 0.02, 0.5))
        return float(np.clip(figures.place + step, 0.02 * longest, _FARTHEST * longest))


def _body_table(instrument: Instrument) -> list[float]:
    """Hz, modes of a body's table below those that notes can tell; none where it has no table to move."""
    freq = mode_tables(instrument).get("body", (np.empty(0),))[0]
    return [float(f) for f in freq if f < 1.5 * LIMITS[-1]]


def _shortened(recording: Recording) -> Recording:
    """The beginning of a recording."""
    return replace(recording, samples=recording.samples[: round(_SHORT * FS)])


def _split(now: float | None, recorded: Sequence[NoteAnalysis], rendered: Sequence[NoteAnalysis]) -> float | None:
    """Splitting of the polarizations, moved by the ratio of the modulations, which grow with it."""
    if now is None:
        return None
    table = np.array([[np.log(a / b) for a, b in zip(rec.modulation, syn.modulation, strict=True)]
                      for rec, syn in zip(recorded, rendered, strict=True)])  # fmt: skip
    finite = table[np.isfinite(table)]
    if len(finite) < 6:
        return now
    ratio = float(np.clip(np.exp(np.median(finite)), 1 / _MOST_SPLIT, _MOST_SPLIT))
    return float(np.clip(max(now, _SPLITS[0]) * ratio, *_SPLITS))


def seconds(notes: Sequence[Played], folds: Sequence[Sequence[int]], iterations: int) -> float:
    """Seconds of sound that a whole estimate renders."""
    whole = seconds_of(notes)
    parts = sum(seconds_of([notes[i] for i in fold]) for fold in folds)
    return whole * (1 + iterations + (len(folds) > 0)) + parts * (iterations - 1)
