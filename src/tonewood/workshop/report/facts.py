"""Facts of an instrument as plain data, for reports and comparisons.

Frequencies and decays are those of the coupled modes (poles), not measured in a rendered sound:

    T60 = ln(1000) / sigma,      Q = omega / 2 sigma,      residue A = phi^2,  mass = 1 / A

A of a body mode is the mean over the points where strings end; Y(omega) = sum A i omega / (omega_k^2 - omega^2 + 2 i
sigma_k omega) is then the mean driving-point mobility of the bridge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tonewood.instrument.bundle.added import added_line
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import Provenance, Source
from tonewood.instrument.inspection.frequencies import StringFeel, bridge_mobility, feel, partials, pitches
from tonewood.instrument.inspection.mode_names import mode_names
from tonewood.instrument.inspection.mounted import mounted_pitches
from tonewood.instrument.inspection.potentials_at_rest import left_out_lines
from tonewood.instrument.inspection.wolf import WolfNote, wolf_notes
from tonewood.instrument.model.assembly import Model
from tonewood.instrument.scales import note_name
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.plate.radiation import Sources
from tonewood.support.arrays import Complexes, Floats
from tonewood.support.units import t60
from tonewood.workshop.report.parameters import ParameterValue, parameters
from tonewood.workshop.report.tones import Tone

#: Hz, lowest and highest frequency of the mobility; points per factor of 10 beside the natural frequencies
_LOW, _HIGH, _PER_DECADE = 40.0, 10000.0, 500
#: partials of each open string
_PARTIALS = 12


@dataclass(frozen=True, slots=True)
class BodyMode:
    """A mode of the body without strings.

    freq : natural frequency, Hz; q, t60 : quality factor and decay time (s).
    residue : mean of phi^2 over the strings' ends, 1/kg.
    mass : 1 / residue, kg; infinite where no string's end moves.
    shape : (n_strings,) displacement at the strings' ends, of a body alone over its whole surface if known, of norm 1.
    """

    freq: float
    q: float
    t60: float
    residue: float
    mass: float
    shape: Complexes


@dataclass(frozen=True, slots=True)
class NoteRow:
    """A string at a stop.

    freq : Hz, of the note.
    cents : of the string-dominated mode from the note, the string alone on the body.
    cents_mounted : of the same with all other strings open beside it.
    t60 : of that mode, s, the string alone.
    tension : of the first polarization, N.
    """

    string: str
    stop: int
    note: str
    freq: float
    cents: float
    cents_mounted: float
    t60: float
    tension: float


@dataclass(frozen=True, slots=True)
class PartialRow:
    """A partial of an open string: number, frequency (Hz), cents from the harmonic, T60 (s)."""

    number: int
    freq: float
    cents: float
    t60: float


@dataclass(frozen=True, slots=True)
class StringRow:
    """An open string.

    length : m; linear_density : kg/m, None where the string's plugin has no such parameter.
    tension, given_tension : N, in use and in the bundle.
    held : ``pitch`` or ``tension``, which of the two the instrument keeps.
    """

    name: str
    note: str
    length: float
    linear_density: float | None
    tension: float
    given_tension: float
    held: str
    stops: int
    feel: StringFeel
    partials: tuple[PartialRow, ...]


@dataclass(frozen=True, eq=False)
class InstrumentFacts:
    """Everything that a report states.

    called : name that the caller gave it there; may be empty.
    changes : values changed by the caller, PATH=VALUE.
    added : masses, springs and dashpots on the body, one line each.
    sources, stand_ins : source key -> source; paths of stand-ins -> note.
    unknown : paths of values of unknown origin.
    kinds : kind of provenance -> number of entries.
    table_doubts, warnings : one line each.
    fs : Hz, at which it was assembled.
    body_modes : by frequency.
    named : numbers among them of those called A0 and T1.
    mass : of the body's plates with all that is fixed to them, kg; None where it is not known.
    surface : how the whole surface of the body moves in each of its own modes, where that is known.
    surface_modes : basis of these modes.
    freq, mobility : Hz; string -> mobility of the body at its end, (m/s)/N, without strings.
    strings, notes : from bass to treble.
    wolves : the most severe first.
    tones : notes that were rendered; the key is the note as it was asked for.
    missing_tones : note -> why the instrument cannot play it.
    parameters : every value of the bundle, by dotted key.
    """

    label: str
    called: str
    name: str
    title: str
    licence: str
    description: str
    folder: str
    changes: tuple[str, ...]
    added: tuple[str, ...]
    sources: Mapping[str, Source]
    stand_ins: Mapping[str, str]
    unknown: tuple[str, ...]
    kinds: Mapping[str, int]
    table_doubts: tuple[str, ...]
    warnings: tuple[str, ...]
    fs: float
    body_modes: tuple[BodyMode, ...]
    named: Mapping[str, int]
    mass: float | None
    surface: Sources | None
    surface_modes: ModalBasis
    freq: Floats
    mobility: Mapping[str, Complexes]
    strings: tuple[StringRow, ...]
    notes: tuple[NoteRow, ...]
    wolves: tuple[WolfNote, ...]
    tones: Mapping[str, Tone]
    missing_tones: Mapping[str, str]
    parameters: Mapping[str, ParameterValue]

    @property
    def short(self) -> str:
        """Label, and its name here, its changes or its bundle's name; 40 characters at most."""
        text = self.called or "; ".join(self.changes) or self.name
        return f"{self.label}: {text if len(text) <= 36 else text[:35] + '…'}"

    @property
    def heading(self) -> str:
        """Label and name, with the changes."""
        inner = [*([self.name] if self.called and self.called != self.name else []), *self.changes]
        return f"{self.label}: {self.called or self.name}" + (f" ({'; '.join(inner)})" if inner else "")


def gather(model: Model, *, label: str = "A", changes: tuple[str, ...] = (), called: str = "") -> InstrumentFacts:
    """Compute the facts of an instrument, without any sound.

    model : of the instrument, at the sampling rate that decides which modes it has.
    label : A, B, ... in a comparison.
    changes : as the caller wrote them.
    """
    body = model.body
    instrument, spec = model.instrument, model.instrument.spec
    freq = frequencies(body, model.fs)
    modes = body_modes(model)
    mass = instrument.body.mass()
    return InstrumentFacts(
        label=label,
        called=called,
        name=instrument.name,
        title=spec.title,
        licence=spec.licence,
        description=spec.description or "",
        folder=str(instrument.folder),
        changes=changes,
        added=tuple(added_line(entry) for entry in spec.body.added),
        sources=dict(spec.sources),
        stand_ins={path: spec.provenance[path].note or "" for path in instrument.origins.stand_ins()},
        unknown=tuple(instrument.origins.of_unknown_origin()),
        kinds=_kinds(spec.provenance),
        table_doubts=tuple(instrument.origins.table_doubts()),
        warnings=(*model.warnings, *left_out_lines(model)),
        fs=model.fs,
        body_modes=modes,
        named=_named(model, modes),
        mass=None if mass is None else mass + sum(entry.mass for entry in spec.body.added),
        surface=instrument.body.sources(model.fs / 2),
        surface_modes=instrument.body.basis(model.fs / 2),
        freq=freq,
        mobility=bridge_mobility(model, freq),
        strings=_strings(instrument, model),
        notes=_notes(model),
        wolves=tuple(wolf_notes(model)),
        tones={},
        missing_tones={},
        parameters=parameters(instrument),
    )


def frequencies(body: ModalBasis, fs: float) -> Floats:
    """Frequencies at which mobility is stated, Hz: equally spaced in their logarithm, and the body's own."""
    top = min(_HIGH, 0.45 * fs)
    even = np.geomspace(_LOW, top, int(_PER_DECADE * np.log10(top / _LOW)))
    elastic = body.natural_freq[body.natural_freq > 0]
    near = [elastic * (1 + x * np.minimum(body.damping_ratio[body.natural_freq > 0], 1.0)) for x in (-1.0, 0.0, 1.0)]
    every = np.concatenate([even, *near])
    return np.unique(every[(every >= _LOW) & (every <= top)])


def body_modes(model: Model) -> tuple[BodyMode, ...]:
    """Modes of the body at the points where strings end, of a body alone at all of its points, by frequency."""
    body = model.body
    points = [
        max(ends, key=lambda p: abs(ends[p]))
        for s in (model.strings[name] for name in model.groups)
        if (ends := s.polarizations[0].ends)
    ] or ([] if model.strings else list(model.body_points))
    rows = [body.index(point) for point in points]
    surface = None if model.strings else model.instrument.body.sources(model.fs / 2)
    whole = surface is not None and surface.volumes.shape[1] == body.n_modes and not model.instrument.spec.body.added
    mean = np.mean([body.residues(point) for point in points], axis=0) if points else np.zeros(body.n_modes)
    out = []
    for k in np.argsort(body.natural_freq):
        if not model.strings and not body.natural_freq[k]:
            continue  # rigid-body motion
        shape = surface.volumes[:, k] if whole and surface is not None else body.right[rows, k]
        norm = float(np.sqrt(np.sum(np.abs(shape) ** 2)))
        sigma, omega = float(body.damping_rate[k]), float(np.sqrt(body.stiffness[k]))
        out.append(
            BodyMode(
                freq=omega / (2 * np.pi),
                q=omega / (2 * sigma) if sigma > 0 else np.inf,
                t60=t60(sigma),
                residue=float(mean[k]),
                mass=1.0 / float(mean[k]) if mean[k] > 0 else np.inf,
                shape=np.asarray(shape / norm if norm > 0 else shape),
            )
        )
    return tuple(out)


def _named(model: Model, modes: Sequence[BodyMode]) -> dict[str, int]:
    """Numbers of A0 and T1: as the drawing's own modes say, or of a fretted instrument by order and level.

    With masses and springs on a drawn body they are the modes most like those without, by frequency and by shape at the
    body's points.
    """
    instrument, upper = model.instrument, model.fs / 2
    surface = instrument.body.sources(upper)
    if surface is None or not any(surface.labels):
        if instrument.spec.stops.kind != "frets":
            return {}
        with np.errstate(divide="ignore"):
            level = 20 * np.log10([mode.residue * mode.t60 for mode in modes])
        return mode_names([mode.freq for mode in modes], level)
    drawn, whole = instrument.body.basis(upper), model.body
    rows = [whole.index(point) for point in drawn.points]
    out = {}
    for k, name in enumerate(surface.labels):
        if name in ("A0", "T1"):
            shapes, shape = whole.right[rows], drawn.right[:, k]
            size = np.linalg.norm(shapes, axis=0) * np.linalg.norm(shape)
            alike = np.abs(shape.conj() @ shapes) / np.where(size > 0, size, np.inf)
            octaves = np.abs(np.log2(np.maximum(whole.natural_freq, 1e-9) / drawn.natural_freq[k]))
            freq = whole.natural_freq[int(np.argmin(octaves - alike))]
            out[name] = int(np.argmin([abs(mode.freq - freq) for mode in modes]))
    return out


def _kinds(provenance: Mapping[str, Provenance]) -> dict[str, int]:
    return dict(Counter(entry.kind for entry in provenance.values()))


def _notes(model: Model) -> tuple[NoteRow, ...]:
    rows = pitches(model)
    return tuple(
        NoteRow(
            string=p.string,
            stop=p.stop,
            note=note_name(p.note),
            freq=p.wanted_freq,
            cents=p.error_cents,
            cents_mounted=mounted.error_cents,
            t60=p.t60,
            tension=p.tension,
        )
        for p, mounted in zip(rows, mounted_pitches(model, rows), strict=True)
    )


def _strings(instrument: Instrument, model: Model) -> tuple[StringRow, ...]:
    rows = []
    for name in model.groups:
        string = model.strings[name]
        tension = string.tuning.given
        values: Mapping[str, Any] = instrument.resolved["strings"][name]
        density = values.get("linear_density")
        rows.append(
            StringRow(
                name=name,
                note=note_name(string.open_note),
                length=string.length(0),
                linear_density=float(density) if isinstance(density, int | float) else None,
                tension=tension.used,
                given_tension=tension.given,
                held=tension.held,
                stops=string.n_stops,
                feel=feel(model, name),
                partials=tuple(
                    PartialRow(p.number, p.freq, p.cents, p.t60) for p in partials(model, name, 0, count=_PARTIALS)
                ),
            )
        )
    return tuple(rows)
