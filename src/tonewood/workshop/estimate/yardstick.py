"""Distance of a folder of notes, or of an instrument, to one guitar, and the scale to judge it by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.estimate.analysis import NoteAnalysis, analyse, check_pitches
from tonewood.workshop.estimate.distance import Distance, distance, neighbours, strokes
from tonewood.workshop.estimate.playing import VELOCITY, Stage, render_notes
from tonewood.workshop.estimate.recordings import Folder, Recording

#: B that is expected where no instrument tells it; the analysis looks from a quarter to four times that
_GUESS = 1e-4


@dataclass(frozen=True, eq=False)
class Yardstick:
    """Distances between two sets of notes.

    between : from the one to the other, over `shared` notes.
    scale : distances within the sets, by their name: strokes of one note, next semitones; those that have any.
    shared : MIDI numbers that both have.
    warnings : one line each.
    """

    between: Distance
    scale: dict[str, Distance]
    shared: tuple[int, ...]
    warnings: tuple[str, ...]


@one_blas_thread
def compare_notes(a: Folder, b: Folder, *, advance: Callable[[float], None] = lambda share: None) -> Yardstick:
    """Compare two folders of notes, note by note: each stroke of the first with the one of nearest dynamic.

    advance : called with the share of the work that is done, 0 to 1.
    Raises TonewoodError : they have no note in common, or one has none of use.
    """
    warnings = [*a.warnings, *b.warnings]
    sides: list[list[tuple[Recording, NoteAnalysis]]] = []
    for i, folder in enumerate((a, b)):
        good, lines = check_pitches([r for r in folder.recordings if r.note >= 0])
        warnings += [*lines, *(f"left out: {r.file}: no note is told" for r in folder.recordings if r.note < 0)]
        sides.append([])
        for k, r in enumerate(good):
            sides[-1].append((r, analyse(r.samples, r.freq, _GUESS, r.freq_upper)))
            advance((i + (k + 1) / len(good)) / 2)
    pairs = _pairs(*sides)
    if not pairs:
        raise TonewoodError("the two sets have no note in common")
    scale: dict[str, Distance] = {}
    for name, side in zip("AB", sides, strict=True):
        rows = [(r.note, analysis) for r, analysis in side]
        scale |= {f"strokes of one note, {name}": distance(strokes(rows))}
        scale |= {f"next semitone, {name}": distance(neighbours(rows))}
    shared = tuple(sorted({note for note, _, _ in pairs}))
    between = distance((p, q) for _, p, q in pairs)
    return Yardstick(between, {k: d for k, d in scale.items() if d.notes}, shared, tuple(warnings))


def _pairs(
    a: Sequence[tuple[Recording, NoteAnalysis]], b: Sequence[tuple[Recording, NoteAnalysis]]
) -> list[tuple[int, NoteAnalysis, NoteAnalysis]]:
    """Note, stroke of the one, stroke of the other that is nearest in dynamic; the first of several."""
    out = []
    for recording, analysis in a:
        same = [row for row in b if row[0].note == recording.note]
        if same:
            velocity = recording.dynamic or VELOCITY
            nearest = min(same, key=lambda row: abs((row[0].dynamic or VELOCITY) - velocity))
            out.append((recording.note, analysis, nearest[1]))
    return out


def played_as(folder: Folder, instrument: Instrument) -> Folder:
    """Notes of a folder played on an instrument, in the places that the folder tells or in the lowest position.

    Raises TonewoodError : the instrument has none of the notes.
    """
    stage = Stage(instrument)
    notes, warnings = [], []
    for recording in folder.recordings:
        played = stage.placed(recording)
        if played is None:
            warnings.append(f"left out: {recording.file}: {instrument.name} plays {stage.span}")
        else:
            notes.append(played)
    if not notes:
        raise TonewoodError(f"none of the notes is between {stage.span}", file=instrument.folder)
    output = instrument.spec.outputs[0].name
    sounds = render_notes(instrument, notes, [output], lambda seconds: None)
    rows = []
    for p, sound in zip(notes, sounds, strict=True):
        name = f"{instrument.name}: {p.recording.file}"
        rows.append(Recording(name, p.recording.note, sound[output], p.string, p.stop, p.recording.dynamic))
    return Folder(tuple(rows), tuple(warnings))
