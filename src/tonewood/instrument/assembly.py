"""From a bundle to a model: components, connections, outputs, and all that the engine asks while it plays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tonewood.blas import one_blas_thread
from tonewood.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.coupling.geometric import GeometricStretch
from tonewood.coupling.system import Drive, Readout, System
from tonewood.coupling.tension import TensionModulation
from tonewood.errors import BundleError
from tonewood.instrument.bundle import Instrument
from tonewood.instrument.contract import BodyPoint, BridgeForce, Exciter, Longitudinal, PickupRows, Place, Scene, dot
from tonewood.instrument.directions import unit_vector
from tonewood.instrument.effects import Choice, declared
from tonewood.instrument.gestures import Fraction, places
from tonewood.instrument.registry import MANIFEST
from tonewood.instrument.schema import Playing, StringPart
from tonewood.instrument.strings import Along, Polarization, Stopping, StringModel
from tonewood.instrument.tuning import body_ports
from tonewood.modal.modes import ModalBasis
from tonewood.params import Vector
from tonewood.passivity.basis import check_basis
from tonewood.units import ratio_of_cents

#: share of the sampling rate above which modes are not stepped: their static compliance stands in for them
FREQ_LIMIT = 0.45
#: strings' modes stay this far below it, so that tuning does not lose the highest, on which pitch depends
TUNING_ROOM = 0.98


@dataclass(frozen=True, slots=True)
class OutputGroup:
    """Channels that belong together.

    Attributes
    ----------
    name : of the group.
    channels : names, in order.
    readouts : their places among the system's readouts.
    quantity, unit : what is read.
    full_scale : value at 0 dBFS, in `unit`.
    note : what this output is, and is not.
    """

    name: str
    channels: tuple[str, ...]
    readouts: tuple[int, ...]
    quantity: str
    unit: str
    full_scale: float
    note: str


@dataclass(frozen=True, eq=False)
class Model:
    """All that a render needs and that does not move.

    Attributes
    ----------
    instrument : the bundle it was made from.
    fs : Hz.
    system : open strings, every polarization. Components ``body``, ``STRING.z``, ``STRING.y`` and those of pickups;
        connections ``COMPONENT.bridge`` (rigid) and ``COMPONENT.hold`` (a dashpot to ground at the point ``pluck``,
        without effect until a gesture takes hold). What touches strings besides adds ``STRING.PART.NAME`` of both
        kinds; a string with axial stiffness has a tension of its name.
    strings : name -> string, from bass to treble.
    outputs : groups that were asked for, the default first.
    body_points : name -> place and direction.
    inputs : ``body.POINT`` -> (component, point, factor), ...: where a known force on the body enters, microphones
        driven by bridge forces included; ``STRING.PART.NAME`` those of exciters that react.
    resting : connections that a gesture wakes; in `system` they stand without effect.
    exciters : name -> what plays.
    default_exciter : name of the exciter of notes that name no technique.
    choice : effects that may run, and budgets; what is left out altogether is not in `system`.
    """

    instrument: Instrument
    fs: float
    system: System
    strings: Mapping[str, StringModel]
    outputs: tuple[OutputGroup, ...]
    body_points: Mapping[str, BodyPoint]
    inputs: Mapping[str, tuple[tuple[str, str, float], ...]]
    exciters: Mapping[str, Exciter[Any]]
    default_exciter: str
    choice: Choice
    resting: Mapping[str, Connection] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Model({self.instrument.name!r}, {len(self.strings)} strings, {self.n_modes} modes, {self.fs:g} Hz)"

    @property
    def playing(self) -> Playing:
        """Velocity curve, end of notes, controllers."""
        return self.instrument.spec.playing

    @property
    def n_modes(self) -> int:
        """Modes of the open instrument."""
        return sum(c.basis.n_modes for c in self.system.compiled)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was done to the bundle's figures to make them playable, one line each."""
        body = self.system.compiled[self.system.slot("body")].basis
        note = body.metadata.get("repair")
        lines = [] if note is None else [f"body: {note}"]
        if not body.n_modes:
            lines.append(f"body: has no mode below the highest that is stepped at {self.fs:g} Hz: it does not sound")
        lines += [
            f"strings.{name}: shares no direction with the body's points it ends on: its bridge end is rigid, and the "
            "body does not move with it"
            for name, string in self.strings.items()
            if not any(p.ends for p in string.ends)
        ]
        return tuple(lines)

    def place(self, string: str, stop: float = 0) -> Place:
        """A string at a stop, as exciters want it."""
        held = self.strings[string]
        return Place(string, held.length(stop), len(held.polarizations), held.tension(stop))


@one_blas_thread
def assemble(
    instrument: Instrument, fs: float, *, freq_limit: float | None = None, outputs: Sequence[str] | None = None
) -> Model:
    """Make the model of an instrument at a sampling rate.

    Parameters
    ----------
    fs : Hz.
    freq_limit : Hz, no mode is stepped above it; 0.45 fs.
    outputs : names of output groups; the bundle's first where left out.

    Raises
    ------
    BundleError, PassivityError : a table is missing or wrong, a body (a plugin's own too) would create energy where
        strings end or exciters push, a string has no mode below the limit; one line.
    """
    limit = FREQ_LIMIT * fs if freq_limit is None else freq_limit
    spec, file = instrument.spec, instrument.folder / MANIFEST
    choice = Choice.of(spec.effects, declared(instrument.plugins))
    body = instrument.body.basis(limit)
    body_points = instrument.body.points()
    exciter = spec.playing.exciter or spec.playing.velocity.parameter.partition(".")[0]
    strings = {
        name: _string(instrument, name, body, body_points, limit, instrument.exciters[exciter], choice)
        for name in instrument.string_names
    }
    _check_places(instrument, strings, exciter, file)
    driven = {point for string in strings.values() for p in string.ends for point in p.ends}
    driven |= {e.at.partition(".")[2] for e in instrument.exciters.values() if e.at is not None}
    check_basis(body, sorted(driven), dt=1.0 / fs).require(file=str(file), key="body")
    components: dict[str, ModalBasis] = {"body": body}
    connections: list[Connection] = []
    for string in strings.values():
        components.update(string.bases())
        for p in string.ends:
            moved = tuple(Term("body", point, -factor) for point, factor in p.ends.items())
            connections.append(Connection(f"{p.component}.bridge", (Term(p.component, "bridge"), *moved), Rigid()))
    for string in strings.values():
        for p in string.polarizations:
            connections.append(Connection(f"{p.component}.hold", (Term(p.component, "pluck"),), SpringDashpot()))
    attached = [a for string in strings.values() for a in string.attached()]
    resting = {c.name: c for a in attached for c in a.connections if c.name in a.resting}
    for a in attached:
        components.update(a.components)
        connections += [replace(c, law=SpringDashpot()) if c.name in resting else c for c in a.connections]
    stretching = [
        s
        for s in strings.values()
        if s.resonator.axial_stiffness > 0 and not s.along and choice.keeps(s.resonator, "tension_modulation")
    ]
    geometric = [
        GeometricStretch(
            s.name,
            tuple(p.component for p in s.polarizations),
            s.along.component,
            s.resonator.axial_stiffness,
            s.along.motion.freq_coupled,
        )
        for s in strings.values()
        if s.along
    ]
    if geometric:  # then all rising tensions are found together
        geometric += [GeometricStretch(s.name, s.components, None, s.resonator.axial_stiffness) for s in stretching]
        stretching = []
    tensions = [TensionModulation(s.name, s.components, s.resonator.axial_stiffness) for s in stretching]
    scene = _scene(strings, body_points, limit)
    names = list(instrument.pickups)
    wanted = names[:1] if outputs is None else list(outputs)
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise BundleError(f"there is no output {unknown[0]!r}; there are {', '.join(names)}", file=file, key="outputs")
    readouts: list[Readout] = []
    drives: list[Drive] = []
    groups: list[OutputGroup] = []
    inputs = {f"body.{point}": [("body", point, 1.0)] for point in body_points}
    inputs |= {name: list(entries) for a in attached for name, entries in a.inputs.items()}
    for part in spec.outputs:
        if part.name not in wanted:
            continue
        pickup = instrument.pickups[part.name]
        rows: PickupRows = pickup.rows(part.name, scene)
        first = len(readouts)
        readouts += rows.readouts
        components.update(rows.components)
        drives += rows.drives
        for point, entries in rows.body_inputs.items():
            inputs[f"body.{point}"] += entries
        groups.append(
            OutputGroup(
                name=part.name,
                channels=pickup.channels,
                readouts=tuple(range(first, len(readouts))),
                quantity="pressure" if pickup.unit == "Pa" else rows.readouts[0].quantity,
                unit=pickup.unit,
                full_scale=part.full_scale,
                note=part.note or "",
            )
        )
    groups.sort(key=lambda g: wanted.index(g.name))
    system = System.build(
        components, connections, readouts, dt=1.0 / fs, drives=drives, tensions=tensions, geometric=geometric
    )
    return Model(
        instrument=instrument,
        fs=fs,
        system=system,
        strings=strings,
        outputs=tuple(groups),
        body_points=body_points,
        inputs={name: tuple(entries) for name, entries in inputs.items()},
        exciters=instrument.exciters,
        default_exciter=exciter,
        choice=choice,
        resting=resting,
    )


def _check_places(instrument: Instrument, strings: Mapping[str, StringModel], default: str, file: Path) -> None:
    """Hold places of exciters to the strings: the default one plays them all, any other at least the longest."""
    lengths = [string.length() for string in strings.values()]
    for name, exciter in instrument.exciters.items():
        if exciter.at is None:
            length = min(lengths) if name == default else max(lengths)
            try:
                places(exciter.parameters, length, length)
            except ValueError as fault:
                raise BundleError(str(fault), file=file, key=f"exciters.{name}") from None


def _string(
    instrument: Instrument,
    name: str,
    body: ModalBasis,
    body_points: Mapping[str, BodyPoint],
    limit: float,
    exciter: Exciter[Any],
    choice: Choice,
) -> StringModel:
    spec, part, resonator = instrument.spec, instrument.spec.strings[name], instrument.resonators[name]
    file = instrument.folder / MANIFEST
    polarizations = tuple(
        Polarization(
            component=f"{name}.{_label(part, i)}",
            direction=direction,
            ends=_shares(direction, [part.end] if isinstance(part.end, str) else part.end, body_points),
            detune=ratio_of_cents(part.split_cents) if i else 1.0,
        )
        for i, direction in enumerate(instrument.polarizations(name))
        if i == 0 or choice.keeps(resonator, "second_polarization")
    )
    note, tuning, stops = instrument.open_note(name), instrument.tuning, spec.stops
    count = 0 if stops.kind == "none" else stops.count if part.stops is None else part.stops
    stopping = Stopping(
        count=count,
        continuous=stops.kind == "continuous",
        freq=lambda stop: tuning.freq(note + stop),
        compensate=spec.tuning.at if spec.tuning.compensate == "coupled" else "none",
        hold=spec.tuning.hold,
        finger=stops.finger if stops.model == "finger" else None,
    )
    motion, along = resonator.longitudinal, None
    if motion is not None and choice.keeps(resonator, "longitudinal"):
        x, y, z = unit_vector(part.axis)
        to_nut = (-x, -y, -z)
        ends = [part.end] if isinstance(part.end, str) else part.end
        along = Along(f"{name}.longitudinal", to_nut, _end_shares(to_nut, ends, body_points, motion), motion)
    points = {
        point: at.from_bridge.fraction * resonator.length if isinstance(at.from_bridge, Fraction) else at.from_bridge
        for point, at in part.points.items()
    }
    usual = getattr(exciter.parameters, "from_bridge", 0.1 * resonator.length)
    string = StringModel(
        name,
        resonator,
        polarizations,
        open_note=note,
        stopping=stopping,
        body=body_ports(body, [p.ends for p in polarizations]),
        freq_upper=min(part.freq_upper, TUNING_ROOM * limit),
        freq_limit=limit,
        end_compliance=part.end_compliance,
        points=points,
        tilt_deg=part.tilt_deg,
        touching={
            **{
                n: a
                for n, a in instrument.attachments.items()
                if name in (spec.connections[n].strings or [name]) and choice.keeps(a)
            },
            **{n: e for n, e in instrument.exciters.items() if e.at is None},
        },
        pluck_from_bridge=usual.fraction * resonator.length if isinstance(usual, Fraction) else float(usual),
        along=along,
    )
    shortest = string.length(count)
    for point, x in points.items():
        if point in ("bridge", "pluck") or not 0 <= x <= shortest:
            raise BundleError(
                f"lies {x:g} m from the bridge; places from 0 to {shortest:g} m (the last stop) are allowed, and names "
                "other than bridge and pluck",
                file=file,
                key=f"strings.{name}.points.{point}",
            )
    return string


def _label(part: StringPart, i: int) -> str:
    wanted = part.polarizations[i]
    return wanted if isinstance(wanted, str) else f"p{i + 1}"


def _shares(direction: Vector, ends: Sequence[str], body_points: Mapping[str, BodyPoint]) -> dict[str, float]:
    """Body point -> (p . d); directions in which the body has no data are rigid."""
    shares = {end.partition(".")[2]: 0.0 for end in ends}
    for point in shares:
        shares[point] = dot(direction, body_points[point].direction)
    return {point: factor for point, factor in shares.items() if factor != 0.0}


def _end_shares(
    to_nut: Vector, ends: Sequence[str], body_points: Mapping[str, BodyPoint], motion: Longitudinal
) -> dict[str, float]:
    """Body point -> share of its displacement in the string's end, along the string.

    What its inclination makes of each, and the leverage of the point that moves most across the string.
    """
    points = [end.partition(".")[2] for end in ends]
    shares = {point: dot(to_nut, body_points[point].direction) for point in points}
    most = min(points, key=lambda point: abs(shares[point]))
    shares[most] += motion.bridge_leverage
    return {point: factor for point, factor in shares.items() if abs(factor) > 1e-12}


def _scene(strings: Mapping[str, StringModel], body_points: Mapping[str, BodyPoint], limit: float) -> Scene:
    bridge_forces, string_points, end_forces = [], {}, {}
    for name, string in strings.items():
        end_forces[name] = tuple((f"{p.component}.bridge", p.direction) for p in string.ends)
        for point in ("bridge", "pluck", *string.points):
            string_points[f"{name}.{point}"] = tuple((p.component, point, p.direction) for p in string.polarizations)
        for p in string.ends:
            # the connection pulls the string's end by +f, and the body by -f along the polarization
            bridge_forces += [BridgeForce(f"{p.component}.bridge", pt, -factor) for pt, factor in p.ends.items()]
    return Scene(body_points, tuple(bridge_forces), string_points, end_forces, limit)
