"""The strings of an instrument, tuned on their body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import StringPart
from tonewood.instrument.contract.base import Attachment, BodyPoint, Exciter, Resonator, dot, levered
from tonewood.instrument.contract.directions import unit_vector
from tonewood.instrument.contract.gestures import Fraction
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.instrument.model.choice import Choice
from tonewood.instrument.model.fretboard import fretted_string
from tonewood.instrument.model.kept_tunings import KeptTunings
from tonewood.instrument.model.stop_table import StopTable
from tonewood.instrument.model.stretch import inharmonicity, octave_stretch
from tonewood.instrument.model.string_bases import StringPlaces
from tonewood.instrument.model.string_setup import LongitudinalMotion, Polarization, Stopping
from tonewood.instrument.model.string_tuning import StringTuning
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.tuning import body_ports
from tonewood.instrument.model.untuned_bases import UntunedBases
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.params import Vector
from tonewood.support.units import ratio_of_cents

#: strings' modes stay this share below the limit, so that tuning does not lose the highest, on which pitch depends
TUNING_ROOM = 0.98
#: ratio by which stretch and mistuning may raise a pitch
STRETCH_ROOM = 1.06


def string_models(
    instrument: Instrument,
    body: ModalBasis,
    body_points: Mapping[str, BodyPoint],
    limit: float,
    choice: Choice,
    kept: KeptTunings | None = None,
) -> dict[str, StringModel]:
    """Make every string of an instrument.

    body, body_points : the body's modes below the limit, and its points.
    limit : Hz, no mode is stepped above it.
    choice : effects that may run.
    kept : tunings of open strings from an earlier run.
    Returns name -> string, from bass to treble; without those of keys whose pitch is too high for the limit.
    Raises BundleError : a point of a string does not lie on its speaking part at the last stop.
    """
    stretch = stretch_cents(instrument)
    copies = {
        name: sum(abs(instrument.open_note(other) - instrument.open_note(name)) < 0.5 for other in strings)
        for strings in instrument.groups.values()
        for name in strings
    }
    beyond = {
        name
        for leader in instrument.groups
        if _is_beyond(instrument, leader, limit)
        for name in instrument.groups[leader]
    }
    return {
        name: _string(instrument, name, body, body_points, limit, choice, stretch.get(name, 0.0), copies[name], kept)
        for name in instrument.string_names
        if name not in beyond
    }


def _is_beyond(instrument: Instrument, leader: str, limit: float) -> bool:
    """Whether the strings of a key have less than the two modes below the limit (Hz) that a pitch needs."""
    part, freq = instrument.spec.strings[leader], instrument.tuning.freq(instrument.open_note(leader))
    upper = min(part.freq_upper, TUNING_ROOM * limit) / STRETCH_ROOM
    if leader not in instrument.key_of or 4 * freq < upper:
        return False
    resonator = instrument.resonators[leader]
    return resonator.basis(upper, tension=resonator.tension).n_modes < 2


def stretch_cents(instrument: Instrument) -> dict[str, float]:
    """String -> cents by which the tuning raises it; the strings of a key alike."""
    if instrument.spec.tuning.stretch == "none":
        return {}
    notes = {name: instrument.open_note(name) for name in instrument.groups}
    freqs = {name: instrument.tuning.freq(note) for name, note in notes.items()}
    B = {name: inharmonicity(instrument.resonators[name], freq) for name, freq in freqs.items()}
    stretch = octave_stretch(notes, freqs, B)
    return {string: stretch[leader] for leader, strings in instrument.groups.items() for string in strings}


def _string(
    instrument: Instrument,
    name: str,
    body: ModalBasis,
    body_points: Mapping[str, BodyPoint],
    limit: float,
    choice: Choice,
    stretch_cents: float,
    copies: int,
    kept: KeptTunings | None,
) -> StringModel:
    part, resonator = instrument.spec.strings[name], instrument.resonators[name]
    polarizations = tuple(
        Polarization(
            component=f"{name}.{part.label(i)}",
            direction=direction,
            ends=_transverse_ends(direction, part.body_points, body_points),
            detune=ratio_of_cents(part.split_cents) if i else 1.0,
        )
        for i, direction in enumerate(instrument.polarizations(name))
        if i == 0 or choice.keeps(resonator, "second_polarization")
    )
    exciter = instrument.exciter(instrument.spec.playing.default_exciter, name)
    key = instrument.key_of.get(name)
    damper = instrument.spec.keys.entries[key].damper if instrument.spec.keys and key else None
    resting = None if damper is None else (damper.resistance, _metres(damper.from_bridge, resonator), damper.width)
    places = StringPlaces(
        pluck=_metres(getattr(exciter.parameters, "from_bridge", 0.1 * resonator.length), resonator),
        pluck_width=float(getattr(exciter.parameters, "felt_width", 0.0)),
        points={point: _metres(at.from_bridge, resonator) for point, at in part.points.items()},
        widths={point: at.width for point, at in part.points.items() if at.width},
        damper=resting,
    )
    untuned = UntunedBases(
        resonator,
        StopTable(name, resonator.length, _stopping(instrument, name, part.cents + stretch_cents)),
        polarizations,
        min(part.freq_upper, TUNING_ROOM * limit),
        part.end_compliance,
        partial(part.scatter.split, name) if part.scatter.split_cents else None,
    )
    ports = body_ports(body, [p.ends for p in polarizations], copies)
    string = StringModel(
        name,
        StringTuning(untuned, ports, places.pluck, kept),
        places,
        open_note=instrument.open_note(name),
        freq_limit=limit,
        tilt_deg=part.tilt_deg + part.scatter.tilt(name),
        touching=_touching(instrument, name, choice),
        longitudinal=_longitudinal(part, name, resonator, body_points, choice),
        end_shares=_end_shares(part, body_points)[1],
        group=next(s for s in instrument.groups.values() if name in s) if name in instrument.key_of else (),
    )
    shortest = string.length(string.n_stops)
    for point, x in places.points.items():
        if point in ("bridge", "pluck") or not 0 <= x <= shortest:
            raise BundleError(
                f"lies {x:g} m from the bridge; places from 0 to {shortest:g} m (the last stop) are allowed, and names "
                "other than bridge and pluck",
                file=instrument.folder / MANIFEST,
                key=f"strings.{name}.points.{point}",
            )
    if resting is not None and not 0 < resting[1] < shortest:
        raise BundleError(
            f"puts the damper of string {name} {resting[1]:g} m from the bridge; places between 0 and "
            f"{shortest:g} m are allowed",
            file=instrument.folder / MANIFEST,
            key=f"keys.entries.{key}.damper.from_bridge",
        )
    return string


def _metres(position: Any, resonator: Resonator[Any]) -> float:
    """Return a position on the open string, m from the bridge."""
    return position.fraction * resonator.length if isinstance(position, Fraction) else float(position)


def _stopping(instrument: Instrument, name: str, raised_cents: float) -> Stopping:
    spec, part = instrument.spec, instrument.spec.strings[name]
    note, tuning, stops = instrument.open_note(name), instrument.tuning, spec.stops
    count = stops.count if part.stops is None else part.stops
    ratio = ratio_of_cents(raised_cents)
    return Stopping(
        count=0 if stops.kind == "none" else count,
        continuous=stops.kind == "continuous",
        freq=lambda stop: tuning.freq(note + stop) * ratio,
        compensate=spec.tuning.at if spec.tuning.compensate == "coupled" else "none",
        hold=spec.tuning.hold,
        finger=stops.finger if stops.model == "finger" else None,
        stretch_cents=raised_cents,
        fretted=fretted_string(instrument, name) if spec.tuning.at == "frets" and count else None,
    )


def _touching(instrument: Instrument, name: str, choice: Choice) -> dict[str, Attachment[Any] | Exciter[Any]]:
    """Attachments on a string, and exciters that may add components to it."""
    parts = instrument.spec.connections
    attachments = {
        key: attachment
        for key, attachment in instrument.attachments.items()
        if name in (parts[key].strings or [name]) and choice.keeps(attachment)
    }
    return {**attachments, **{n: instrument.exciter(n, name) for n, e in instrument.exciters.items() if e.at is None}}


def _longitudinal(
    part: StringPart, name: str, resonator: Resonator[Any], body_points: Mapping[str, BodyPoint], choice: Choice
) -> LongitudinalMotion | None:
    motion = resonator.longitudinal
    if motion is None or not choice.keeps(resonator, "longitudinal"):
        return None
    to_nut, end_shares = _end_shares(part, body_points)
    return LongitudinalMotion(f"{name}.longitudinal", to_nut, levered(end_shares, motion.bridge_leverage), motion)


def _transverse_ends(direction: Vector, ends: Sequence[str], body_points: Mapping[str, BodyPoint]) -> dict[str, float]:
    """Body point -> (p . d); an end is rigid in directions in which the body has no data."""
    shares = {point: dot(direction, body_points[point].direction) for point in ends}
    return {point: factor for point, factor in shares.items() if factor != 0.0}


def _end_shares(part: StringPart, body_points: Mapping[str, BodyPoint]) -> tuple[Vector, dict[str, float]]:
    """Direction to the nut; body point -> share of its displacement in the string's end, along the string."""
    x, y, z = unit_vector(part.axis)
    to_nut = (-x, -y, -z)
    return to_nut, {point: dot(to_nut, body_points[point].direction) for point in part.body_points}
