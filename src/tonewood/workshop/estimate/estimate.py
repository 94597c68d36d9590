"""The whole estimate: notes on strings, held-back halves, figures of all notes and their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.support.arrays import Floats
from tonewood.support.blas import one_blas_thread
from tonewood.workshop.estimate import gain, laws, pluck
from tonewood.workshop.estimate.analysis import NoteAnalysis, analyse, check_pitches
from tonewood.workshop.estimate.body_modes import HeardMode
from tonewood.workshop.estimate.distance import Distance, distance, neighbours, strokes
from tonewood.workshop.estimate.figures import Figures
from tonewood.workshop.estimate.playing import Played, Stage
from tonewood.workshop.estimate.recordings import Folder
from tonewood.workshop.estimate.room import RoomShare, room_share
from tonewood.workshop.estimate.search import RenderedNotes, Search, seconds

#: notes that an estimate needs, and of which halves are held back
FEWEST_NOTES, FEWEST_HALVED = 3, 8
ITERATIONS = 3
#: a note is moved to another string if its B is off by more than the first factor there, and by less than the second
_OFF_STRING, _ON_STRING = 1.7, 1.35


@dataclass(frozen=True, eq=False)
class Half:
    """One half of the notes fitted, the other held back.

    fitted, held_back : numbers of the notes.
    before, after : distances of the held-back notes, with the figures begun with and the fitted ones.
    sounds, begun : note -> its sound with the fitted figures and with those begun with, of the held-back ones.
    """

    fitted: tuple[int, ...]
    held_back: tuple[int, ...]
    before: Distance
    after: Distance
    sounds: Mapping[int, Floats]
    begun: Mapping[int, Floats]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of an estimate.

    instrument : with the figures of all notes.
    begun_with : the instrument before.
    notes, recorded : the notes that were used, and their analyses.
    figures : estimated from all notes; start : those begun with.
    before, after : distances of all notes.
    halves : the two tests on notes held back; none with fewer than 8 notes.
    scale : distance between strokes of one note, or of the next semitones, of these recordings.
    intervals : string -> 90 % intervals of its loss.
    gain_interval : (2, 15) dB of the first output's gain, 90 %.
    b_ratio : string -> (number of notes, 90 % interval of B of the recorded re the estimated).
    places : of the pluck, in the last iteration; None where it was not estimated.
    louder : (recorded, rendered) change from soft to loud; None without pairs.
    rendered : all notes with the figures.
    body_modes : that the recorded notes tell.
    room : share of a room in them; None where none brings the rendered notes nearer, or none can be tried.
    moved : lines on notes put on another string than in the lowest position.
    warnings : one line each.
    """

    instrument: Instrument
    begun_with: Instrument
    notes: tuple[Played, ...]
    recorded: tuple[NoteAnalysis, ...]
    figures: Figures
    start: Figures
    before: Distance
    after: Distance
    halves: tuple[Half, ...]
    scale: Mapping[str, Distance]
    intervals: Mapping[str, laws.Interval]
    gain_interval: Floats
    b_spread: Mapping[str, tuple[int, float, float]]
    places: pluck.PluckPlaces | None
    louder: tuple[pluck.Louder, pluck.Louder] | None
    rendered: RenderedNotes
    body_modes: tuple[HeardMode, ...]
    room: RoomShare | None
    moved: tuple[str, ...]
    warnings: tuple[str, ...]


@one_blas_thread
def estimate(
    folder: Folder,
    instrument: Instrument,
    *,
    iterations: int = ITERATIONS,
    advance: Callable[[float], None] = lambda share: None,
) -> Estimate:
    """Estimate an instrument from recorded notes.

    folder : recordings.
    instrument : to begin with: its strings, stops, body, exciter and outputs are kept, figures of them moved.
    iterations : of the search; three bring figures to where the scatter of notes is larger than a further step.
    advance : called with the share of the work that is done, 0 to 1.
    Raises TonewoodError : fewer than three notes are of use, or none of the instrument's strings has them.
    """
    stage = Stage(instrument)
    notes, warnings = placed_notes(folder, stage)
    if len(notes) < FEWEST_NOTES:
        shown = f": {warnings[0]}" if warnings else ""
        raise TonewoodError(f"{len(notes)} notes are of use; {FEWEST_NOTES} or more are wanted{shown}", key="FOLDER")
    recorded = tuple(analyse(p.recording.samples, p.recording.freq, p.b, p.recording.freq_upper) for p in notes)
    notes, moved = on_strings(notes, recorded, stage)
    halves = ((), ()) if len(notes) < FEWEST_HALVED else alternating(notes)
    folds = [fold for fold in halves if fold]
    done, total = 0.0, max(seconds(notes, folds, iterations), 1e-9)

    def tell(more: float) -> None:
        nonlocal done
        done += more
        advance(min(done / total, 1.0))

    search = Search(stage, tell)
    begun = search.render(search.start, notes)
    before = distance(zip(recorded, begun.main, strict=True))
    tested = [_tested(search, notes, recorded, begun, fold, iterations) for fold in folds]
    search.keeps_loss = loss_is_unknown(tested)
    if search.keeps_loss:
        changes = ", ".join(f"{half.before.decays:.2f} to {half.after.decays:.2f}" for half in tested)
        warnings.append(
            f"the loss of the strings is kept: moved, it brings the decays of held-back notes farther off ({changes})"
        )
    figures = search.with_strokes(search.fit(notes, recorded, begun, iterations), notes, recorded)
    final = search.render(figures, notes, all_outputs=True)
    figures = search.with_gains(figures, recorded, final, search.outputs[1:])
    main = search.outputs[0]
    rng = np.random.default_rng(1)
    numbered = [(p.recording.note, a) for p, a in zip(notes, recorded, strict=True)]
    return Estimate(
        instrument=search.instrument(figures),
        begun_with=instrument,
        notes=notes,
        recorded=recorded,
        figures=figures,
        start=search.start,
        before=before,
        after=distance(zip(recorded, final.main, strict=True)),
        halves=tuple(tested),
        scale={"strokes of one note": distance(strokes(numbered)), "next semitone": distance(neighbours(numbered))},
        intervals=_intervals(figures, notes, recorded, final.main, rng),
        gain_interval=gain.curve_interval(gain.differences(recorded, final.analyses[main]), rng),
        b_spread=_b_spread(notes, recorded, final.main, rng),
        places=_places(search, figures, notes, recorded, final),
        louder=_louder(notes, recorded, final.main),
        rendered=final,
        body_modes=search.body_modes(recorded),
        room=_room(notes, recorded, final, warnings),
        moved=tuple(moved),
        warnings=tuple(warnings),
    )


def placed_notes(folder: Folder, stage: Stage) -> tuple[tuple[Played, ...], list[str]]:
    """Recordings whose pitch is right, on the strings of an instrument; and a line on each that is left out."""
    rows = [stage.named(r) for r in folder.recordings]
    good, lines = check_pitches(rows)
    notes, warnings = [], [*folder.warnings, *lines]
    for recording in good:
        played = stage.placed(recording)
        if played is None:
            warnings.append(f"left out: {recording.file}: no string has this note; {stage.span} are playable")
        else:
            notes.append(played)
    return tuple(notes), warnings


def on_strings(
    notes: Sequence[Played], analyses: Sequence[NoteAnalysis], stage: Stage
) -> tuple[tuple[Played, ...], list[str]]:
    """Put notes whose inharmonicity is that of another string there: B ~ 2^(stop / 6) EI / (T l^2).

    Notes whose string was told stay. Each string's B is first scaled by the median of its notes, so that a set of
    strings stiffer than the bundle's moves nothing.
    """
    ratios: dict[str, list[float]] = {}
    for played, a in zip(notes, analyses, strict=True):
        if played.b > 0 and a.b > 0:
            ratios.setdefault(played.string, []).append(a.b / played.b)
    factor = {name: float(np.median(rows)) if len(rows) > 2 else 1.0 for name, rows in ratios.items()}
    out, lines = [], []
    for played, a in zip(notes, analyses, strict=True):
        best = played
        if played.recording.string is None and a.b > 0 and played.b > 0:
            places = [stage.at(played.recording, *string_stop) for string_stop in stage.places(played.recording.note)]
            off = {p.string: abs(np.log(a.b / (p.b * factor.get(p.string, 1.0)))) for p in places if p.b > 0}
            nearest = min((p for p in places if p.string in off), key=lambda p: off[p.string])
            if off[played.string] > np.log(_OFF_STRING) and off[nearest.string] < np.log(_ON_STRING):
                best = nearest
                lines.append(
                    f"{played.name}: taken for string {best.string}, stop {best.stop:g}: its B of {a.b:.2g} is not "
                    f"that of {played.string} there ({played.b * factor.get(played.string, 1.0):.2g})"
                )
        out.append(best)
    return tuple(out), lines


def alternating(notes: Sequence[Played]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Numbers of every other pitch, and of the rest: strokes of one pitch stay together."""
    pitches = sorted({p.recording.note for p in notes})
    even = {pitch for i, pitch in enumerate(pitches) if i % 2 == 0}
    rows = [(i, p.recording.note in even) for i, p in enumerate(notes)]
    return tuple(i for i, is_even in rows if is_even), tuple(i for i, is_even in rows if not is_even)


def loss_is_unknown(halves: Sequence[Half]) -> bool:
    """Whether decays of held-back notes come farther off in every half: too few notes of a string tell its loss."""
    return len(halves) > 0 and all(half.after.decays > half.before.decays for half in halves)


def _tested(
    search: Search, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], begun: RenderedNotes,
    fold: Sequence[int], iterations: int,
) -> Half:  # fmt: skip
    """Fit some notes, and compare the others."""
    fitted = tuple(fold)
    rest = tuple(i for i in range(len(notes)) if i not in set(fitted))
    start = RenderedNotes(
        tuple(begun.sounds[i] for i in fitted),
        {name: tuple(rows[i] for i in fitted) for name, rows in begun.analyses.items()},
    )
    figures = search.fit([notes[i] for i in fitted], [recorded[i] for i in fitted], start, iterations)
    sounds = search.render(figures, [notes[i] for i in rest])
    target = [recorded[i] for i in rest]
    return Half(
        fitted, rest, distance(zip(target, (begun.main[i] for i in rest), strict=True)),
        distance(zip(target, sounds.main, strict=True)), dict(zip(rest, sounds.sounds, strict=True)),
        {i: begun.sounds[i] for i in rest},
    )  # fmt: skip


def _intervals(
    figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], final: Sequence[NoteAnalysis],
    rng: np.random.Generator,
) -> dict[str, laws.Interval]:  # fmt: skip
    """Intervals of the strings whose own notes tell their loss."""
    out = {}
    for name, law in figures.laws.items():
        at = [i for i, played in enumerate(notes) if played.string == name]
        rates = laws.rates_of([recorded[i] for i in at])
        if figures.estimated.get(name) and len(rates) >= laws.FEWEST:
            out[name] = laws.bootstrap(rates, law, rng)
    return out


def _b_spread(
    notes: Sequence[Played], recorded: Sequence[NoteAnalysis], final: Sequence[NoteAnalysis], rng: np.random.Generator
) -> dict[str, tuple[int, float, float]]:
    """String -> notes with a B, and the 90 % interval of the median ratio of B, recorded to estimated."""
    rows: dict[str, list[float]] = {}
    for played, a, b in zip(notes, recorded, final, strict=True):
        if a.b > 0 and b.b > 0 and 1 / 3 < a.b / b.b < 3:
            rows.setdefault(played.string, []).append(a.b / b.b)
    out = {}
    for name, ratios in rows.items():
        drawn = np.median(rng.choice(ratios, (200, len(ratios))), axis=1)
        low, high = np.percentile(drawn, [5, 95])
        out[name] = (len(ratios), float(low), float(high))
    return out


def _places(
    search: Search, figures: Figures, notes: Sequence[Played], recorded: Sequence[NoteAnalysis], final: RenderedNotes
) -> pluck.PluckPlaces | None:
    if figures.place is None:
        return None
    return pluck.places(notes, recorded, final.main, 0.4 * max(p.length for p in notes))


def _room(
    notes: Sequence[Played], recorded: Sequence[NoteAnalysis], final: RenderedNotes, warnings: list[str]
) -> RoomShare | None:
    """Share of a room; a warning in place of it where rooms cannot be computed."""
    if find_spec("pyroomacoustics") is None:
        warnings.append("the room's share is not estimated: it needs pip install 'tonewood[room]'")
        return None
    sounds = [(p.recording.samples, a) for p, a in zip(notes, recorded, strict=True)]
    return room_share(sounds, list(zip(final.sounds, final.main, strict=True)))


def _louder(
    notes: Sequence[Played], recorded: Sequence[NoteAnalysis], final: Sequence[NoteAnalysis]
) -> tuple[pluck.Louder, pluck.Louder] | None:
    ratios = pluck.louder(notes, recorded), pluck.louder(notes, final)
    return None if ratios[0] is None or ratios[1] is None else (ratios[0], ratios[1])
