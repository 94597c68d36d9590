"""Instruments beside one another: which modes and wolf notes belong together, and which parameters differ."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.inspection.wolf import WolfNote
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.support.blas import one_blas_thread
from tonewood.support.units import cents
from tonewood.workshop.report.facts import BodyMode, InstrumentFacts, NoteRow, gather
from tonewood.workshop.report.tones import place, place_name, play_note

T = TypeVar("T")

#: cents between two modes, and decades between their residues, that alone make them different ones
_REACH_CENTS, _REACH_DECADES = 400.0, 1.5
#: places from which on a shape is a whole surface's; cents between two modes of such that alone make them different
_SURFACE, _WIDE_CENTS = 60, 3600.0
#: labels of instruments
LABELS = "ABCDEF"
#: open strings of a report that are played
_MOST_OPEN = 12


@dataclass(frozen=True, slots=True)
class ModeMatch:
    """A mode of each instrument that is the same one, None where an instrument has none."""

    modes: tuple[BodyMode | None, ...]

    def cents(self, i: int) -> float | None:
        """Cents of instrument i's mode from the first instrument's."""
        first, other = self.modes[0], self.modes[i]
        return None if first is None or other is None else cents(other.freq / first.freq)


@dataclass(frozen=True, slots=True)
class WolfMatch:
    """A wolf note of each instrument on one string at about one pitch, None where an instrument has none."""

    wolves: tuple[WolfNote | None, ...]

    @property
    def severity_cents(self) -> float:
        """The largest severity."""
        return max(wolf.severity_cents for wolf in self.wolves if wolf is not None)


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """A parameter that differs: dotted key, value of each instrument (None where it has no such key), unit."""

    key: str
    values: tuple[Any, ...]
    unit: str


@dataclass(frozen=True, slots=True)
class NoteMatch:
    """A string at a stop on each instrument, None where an instrument has none."""

    string: str
    stop: int
    notes: tuple[NoteRow | None, ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Facts of instruments, and differences between them; of one instrument, a report.

    instruments : the others are compared with the first.
    modes : by frequency; wolves : the most severe first; notes : from bass to treble.
    parameters : those that differ, by key.
    tones : names of the notes that at least one instrument plays.
    duration, velocity_midi : of those notes, s, and MIDI velocity.
    sweep : a number of the bundle that the instruments differ in, if they are a sweep of it.
    """

    instruments: tuple[InstrumentFacts, ...]
    modes: tuple[ModeMatch, ...]
    wolves: tuple[WolfMatch, ...]
    notes: tuple[NoteMatch, ...]
    parameters: tuple[ParameterRow, ...]
    tones: tuple[str, ...]
    duration: float
    velocity_midi: float
    sweep: str = ""

    def swept(self) -> list[tuple[float, InstrumentFacts]]:
        """Instruments of a sweep by its value."""
        pairs = [(f.parameters.get(self.sweep), f) for f in self.instruments]
        rows = [(float(p.value), f) for p, f in pairs if p is not None and isinstance(p.value, int | float)]
        return sorted(rows, key=lambda row: row[0]) if self.sweep else []


@dataclass(frozen=True, slots=True)
class Candidate:
    """An instrument to be compared, the changes that the caller made, as text, and what the caller calls it."""

    instrument: Instrument
    changes: tuple[str, ...] = ()
    name: str = ""


@one_blas_thread
def compare(
    candidates: Sequence[Candidate],
    *,
    notes: Sequence[str] | None = None,
    fs: int = 48000,
    duration: float = 4.0,
    velocity_midi: float = 80.0,
    sweep: str = "",
    tell: Callable[[float], None] = lambda share: None,
) -> Comparison:
    """Compute the facts of instruments and the differences between them.

    candidates : one, for a report, or up to six.
    notes : to be played: names (``E2``) or places (``A2:12``); by default of one instrument its open strings and the
        worst wolf note, of several the lowest and highest open string and the worst wolf note at a stop of each, as far
        as all can play them.
    fs : Hz. duration : s, of each note. velocity_midi : 1 to 127.
    sweep : key of the bundle that the instruments differ in; empty where they are no sweep.
    Raises TonewoodError : there is no instrument or too many; no instrument can play a note.
    """
    if not 1 <= len(candidates) <= len(LABELS):
        raise TonewoodError(f"{len(candidates)} instruments; 1 to {len(LABELS)} are allowed")
    models = [assemble(candidate.instrument, fs, alone=True) for candidate in candidates]
    if notes and not all(model.strings for model in models):
        raise TonewoodError("a body without strings plays none", key="--notes")
    names = list(dict.fromkeys(notes or ()))
    for name in names:
        faults = [fault for model in models if (fault := _fault(model, name))]
        if len(faults) == len(models):
            raise TonewoodError(faults[0], key=f"--notes {name}")
    instruments: list[InstrumentFacts] = []
    for label, candidate, model in zip(LABELS, candidates, models, strict=False):
        instruments.append(gather(model, label=label, changes=candidate.changes, called=candidate.name))
        tell(0.5 * len(instruments) / len(candidates))
    names = names or default_notes(instruments, models)
    whole = []
    for i, (facts, model, candidate) in enumerate(zip(instruments, models, candidates, strict=True)):
        missing = {name: reason for name in names if (reason := _fault(model, name))}
        tones = {
            name: play_note(candidate.instrument, model, name, fs=fs, duration=duration, velocity_midi=velocity_midi)
            for name in names
            if name not in missing
        }
        whole.append(replace(facts, tones=tones, missing_tones=missing))
        tell(0.5 + 0.4 * (i + 1) / len(candidates))
    return Comparison(
        instruments=tuple(whole),
        modes=match_modes([facts.body_modes for facts in whole]),
        wolves=match_wolves([facts.wolves for facts in whole]),
        notes=match_notes([facts.notes for facts in whole]),
        parameters=differing(whole),
        tones=tuple(names),
        duration=duration,
        velocity_midi=velocity_midi,
        sweep=sweep,
    )


def default_notes(instruments: Sequence[InstrumentFacts], models: Sequence[Model]) -> list[str]:
    """Notes that are played where none are asked for; see `compare`."""
    names: list[str] = []
    for facts, model in zip(instruments, models, strict=True):
        strings = list(model.groups)
        if not strings:
            return []
        if len(instruments) > 1:
            strings = [strings[0], strings[-1]]
        elif len(strings) > _MOST_OPEN:
            strings = [strings[i] for i in np.linspace(0, len(strings) - 1, _MOST_OPEN).astype(int)]
        names += [place_name(model, name, 0) for name in strings]
        names += [place_name(model, w.string, nearest_stop(model, w)) for w in facts.wolves if w.stops][:1]
    every = list(dict.fromkeys(names))
    return [name for name in every if not any(_fault(model, name) for model in models)] or every


def _fault(model: Model, note: str) -> str:
    """Why an instrument cannot play a note; empty if it can."""
    try:
        place(model, note)
    except TonewoodError as fault:
        return fault.reason
    return ""


def nearest_stop(model: Model, wolf: WolfNote) -> int:
    """The stop within a wolf note whose pitch is nearest to where it is worst."""
    return min(wolf.stops, key=lambda stop: abs(cents(model.strings[wolf.string].freq(stop) / wolf.worst_freq)))


def match_modes(instruments: Sequence[Sequence[BodyMode]]) -> tuple[ModeMatch, ...]:
    """Pair the modes of each instrument with those of the first, and list the others by themselves.

    Pairs minimise the sum of |cents| / 400 + |lg(A_b / A_a)| / 1.5 + 1 - MAC, where A is the residue and
    MAC = |psi_a^H psi_b|^2 the modal assurance criterion of the shapes at the strings' ends, of norm 1 (left out where
    the instruments differ in their number of strings). Two modes with a sum of 1 or more are no pair.

    Source of the criterion: R. J. Allemang, D. L. Brown, A correlation coefficient for modal vector analysis, Proc. 1st
    International Modal Analysis Conference (1982) 110.
    """
    from scipy.optimize import linear_sum_assignment

    first, *others = instruments
    rows: list[list[BodyMode | None]] = [[mode, *[None] * len(others)] for mode in first]
    for i, modes in enumerate(others, 1):
        paired: set[int] = set()
        if first and modes:
            cost = np.array([[_unlike(a, b) for b in modes] for a in first])
            for k, m in zip(*linear_sum_assignment(np.minimum(cost, 1.0)), strict=True):
                if cost[k, m] < 1.0:
                    rows[int(k)][i] = modes[int(m)]
                    paired.add(int(m))
        for j, mode in enumerate(modes):
            if j not in paired:
                alone: list[BodyMode | None] = [None] * len(instruments)
                alone[i] = mode
                rows.append(alone)
    rows.sort(key=lambda row: next(mode.freq for mode in row if mode is not None))
    return tuple(ModeMatch(tuple(row)) for row in rows)


def alike(match: ModeMatch) -> bool:
    """Whether all instruments have a mode, within 0.01 cent, and 1e-4 of its Q and mass."""
    a = match.modes[0]
    return a is not None and all(
        b is not None
        and math.isclose(a.freq, b.freq, rel_tol=6e-6)
        and math.isclose(a.q, b.q, rel_tol=1e-4)
        and math.isclose(a.mass, b.mass, rel_tol=1e-4)
        for b in match.modes
    )


def _unlike(a: BodyMode, b: BodyMode) -> float:
    """How unlike two modes are; 1 or more where they cannot be one."""
    if a.freq <= 0 or b.freq <= 0:
        return 0.0 if a.freq == b.freq else 1.0
    alike = abs(np.vdot(a.shape, b.shape)) ** 2 if a.shape.shape == b.shape.shape and a.shape.any() else 1.0
    if a.shape.shape == b.shape.shape and len(a.shape) > _SURFACE:  # whole surfaces: the shape says which mode it is
        return abs(cents(b.freq / a.freq)) / _WIDE_CENTS + 1.0 - float(alike)
    size = abs(math.log10(b.residue / a.residue)) if a.residue > 0 and b.residue > 0 else 0.0
    return abs(cents(b.freq / a.freq)) / _REACH_CENTS + size / _REACH_DECADES + 1.0 - float(alike)


def match_wolves(instruments: Sequence[Sequence[WolfNote]]) -> tuple[WolfMatch, ...]:
    """Put wolf notes on one string together that overlap or are worst within a semitone, the worst first."""
    rows: list[list[WolfNote | None]] = []
    for i, wolves in enumerate(instruments):
        for wolf in wolves:
            fit = [row for row in rows if row[i] is None and any(w is not None and _overlap(w, wolf) for w in row)]
            if fit:
                fit[0][i] = wolf
            else:
                rows.append([wolf if j == i else None for j in range(len(instruments))])
    return tuple(sorted((WolfMatch(tuple(row)) for row in rows), key=lambda m: -m.severity_cents))


def _overlap(a: WolfNote, b: WolfNote) -> bool:
    if a.string != b.string:
        return False
    overlap = a.low_freq <= b.high_freq and b.low_freq <= a.high_freq
    return overlap or abs(cents(a.worst_freq / b.worst_freq)) <= 100.0


def match_notes(instruments: Sequence[Sequence[NoteRow]]) -> tuple[NoteMatch, ...]:
    """Put notes of one string and stop together."""
    keys = dict.fromkeys((note.string, note.stop) for notes in instruments for note in notes)
    at: list[Mapping[tuple[str, int], NoteRow]] = [{(n.string, n.stop): n for n in notes} for notes in instruments]
    return tuple(NoteMatch(*key, tuple(notes.get(key) for notes in at)) for key in keys)


def differing(instruments: Sequence[InstrumentFacts]) -> tuple[ParameterRow, ...]:
    """Parameters whose values are not all the same, in the order of the bundles."""
    keys = dict.fromkeys(key for facts in instruments for key in facts.parameters)
    rows = []
    for key in keys:
        entries = [facts.parameters.get(key) for facts in instruments]
        values = tuple(None if entry is None else entry.value for entry in entries)
        there = [entry for entry in entries if entry is not None]
        if any(value != values[0] for value in values):
            rows.append(ParameterRow(key, values, next((entry.unit for entry in there if entry.unit), "")))
    return tuple(rows)


def finite(value: float | None) -> float | None:
    """A number as JSON has it: None where it is infinite."""
    return value if value is not None and math.isfinite(value) else None
