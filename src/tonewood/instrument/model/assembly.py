"""Assembly: from an instrument to a model for one sampling rate.

body -> strings (`string_assembly`) -> attachments (`attached`) -> outputs (`output_assembly`) -> one system of
components, connections and readouts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.added import body_parts
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import Playing
from tonewood.instrument.contract.base import BodyPoint, Exciter, Plugin
from tonewood.instrument.contract.gestures import Place, places
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.instrument.model.choice import Choice, declared
from tonewood.instrument.model.kept_tunings import KeptTunings
from tonewood.instrument.model.output_assembly import OutputGroup, Outputs, make_outputs, make_scene
from tonewood.instrument.model.references import by_part, check_connections, check_readouts
from tonewood.instrument.model.string_assembly import string_models
from tonewood.instrument.model.string_stems import outputs_by_string
from tonewood.instrument.model.strings import StringModel
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.basis import check_basis
from tonewood.support.blas import one_blas_thread

#: share of the sampling rate above which modes are not stepped: their static compliance stands in for them
FREQ_LIMIT = 0.45


@dataclass(frozen=True, eq=False)
class Model:
    """All immutable data of a render.

    Attributes
    ----------
    instrument : the bundle it was made from.
    fs : Hz.
    system : open strings, every polarization. Components ``body``, ``STRING.z``, ``STRING.y`` and those of pickups;
        connections ``COMPONENT.bridge`` (rigid) and ``COMPONENT.hold`` (a dashpot to ground at the point ``pluck``,
        without effect until a gesture holds the string). Parts that touch a string add ``STRING.PART.NAME`` of both
        kinds; a string with axial stiffness has a tension of its name.
    strings : name -> string, from bass to treble.
    outputs : groups that were asked for, the default first.
    body_points : name -> place and direction.
    inputs : ``body.POINT`` -> (component, point, factor), ...: where a known force on the body enters, microphones
        driven by bridge forces included; ``STRING.PART.NAME`` those of exciters that react.
    resting : connections that act only while a gesture moves them, with their laws; in `system` they have no effect.
    exciters : name -> plugin.
    default_exciter : name of the exciter of notes that name no technique.
    choice : effects that may run, and budgets; `system` does not contain effects that may not.
    body : modes of the body with the parts added to it, as its strings feel it; `system` has the parts by themselves.
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
    body: ModalBasis
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
        """Changes to the bundle's figures that were needed to play it, one line each."""
        body = self.system.compiled[self.system.slot("body")].basis
        note = body.metadata.get("repair")
        lines = [] if note is None else [f"body: {note}"]
        if not body.n_modes:
            lines.append(f"body: has no mode below the highest that is stepped at {self.fs:g} Hz: it does not sound")
        if missing := [key for string, key in self.instrument.key_of.items() if string not in self.strings]:
            keys = list(dict.fromkeys(missing))
            named = keys[0] if len(keys) == 1 else f"{keys[0]} to {keys[-1]}"
            lines.append(f"keys.{named}: left out, their pitch is too high for {self.fs:g} Hz")
        lines += [
            f"strings.{name}: shares no direction with the body's points it ends on: its bridge end is rigid, and the "
            "body does not move with it"
            for name, string in self.strings.items()
            if not any(p.ends for p in string.ends)
        ]
        return tuple(lines)

    @cached_property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """String that gives the pitch -> the strings that a note on it plays."""
        return {leader: of for leader, of in self.instrument.groups.items() if leader in self.strings}

    def exciter(self, name: str, string: str) -> Exciter[Any]:
        """Return the exciter called `name` with the parameters that it has on a string."""
        return self.instrument.exciter(name, string)

    def place(self, string: str, stop: float = 0, *, una_corda: bool = False) -> Place:
        """Return the place of a gesture: a string at a stop, and the other strings of its key.

        Parameters
        ----------
        string, stop : name of the string; number of its stop, 0 open.
        una_corda : whether the soft pedal is down, so that the hammer meets fewer strings, more softly.
        """
        spec, keys = self.strings[string], self.instrument.spec.keys
        strings: tuple[tuple[str, float], ...] = ()
        if keys is not None and (key := self.instrument.key_of.get(string)) is not None:
            met = keys.entries[key].una_corda if una_corda else None
            factor = keys.pedals.una_corda_stiffness if una_corda else 1.0
            strings = tuple((s, factor if met is None or i < met else 0.0) for i, s in enumerate(spec.group))
        return Place(string, spec.length(stop), len(spec.polarizations), spec.tension(stop), strings)


@one_blas_thread
def assemble(
    instrument: Instrument,
    fs: float,
    *,
    freq_limit: float | None = None,
    outputs: Sequence[str] | None = None,
    by_string: bool = False,
    alone: bool = False,
) -> Model:
    """Make the model of an instrument at a sampling rate.

    Parameters
    ----------
    fs : Hz.
    freq_limit : Hz, no mode is stepped above it; 0.45 fs.
    outputs : names of output groups; the bundle's first where left out.
    alone : whether a body without strings is taken, to be looked at; nothing can be played on it.
    by_string : whether each group is split into the shares of all strings, ``GROUP.STRING``, and ``GROUP.body``.

    Raises
    ------
    BundleError, PassivityError : there are no strings; a table is missing or wrong, a body would create energy where
        strings end or exciters push, a string has no mode below the limit; one line.
    """
    if not (alone or instrument.spec.strings):
        raise BundleError(
            "there are none, and so nothing can be played; `tonewood modes`, `compare` and `report` take a body alone",
            file=instrument.folder / MANIFEST,
            key="strings",
        )
    limit = FREQ_LIMIT * fs if freq_limit is None else freq_limit
    choice = Choice.of(instrument.spec.effects, declared(instrument.plugins))
    body, body_points = instrument.body.basis(limit), instrument.body.points()
    added = body_parts(instrument.spec.body.added, body, body_points, instrument.folder / MANIFEST)
    tunings = KeptTunings(instrument, limit)
    strings = string_models(instrument, added.body, body_points, limit, choice, tunings)
    _check_places(instrument, strings)
    _check_body(instrument, strings, body, 1.0 / fs)
    attached = [a for string in strings.values() for a in string.attached()]
    resting = {c.name: c for a in attached for c in a.connections if c.name in a.resting}
    channels = make_outputs(instrument, outputs, make_scene(strings, body_points, limit, added.forces, instrument.body))
    # connections that only gestures move begin without effect
    parts = (replace(c, law=SpringDashpot()) if c.name in resting else c for a in attached for c in a.connections)
    connections = [*_end_connections(strings.values()), *added.connections, *parts]
    components = {"body": body, **added.components, **_string_components(strings.values())}
    _check_components(strings.values(), {"body", *added.components}, channels)
    _check_references(instrument, strings, {**components, **channels.components}, connections, channels)
    owners = {component: name for name, string in strings.items() for component in string.components}
    owners |= {component: name for name, s in strings.items() for a in s.attached() for component in a.components}
    if by_string:
        channels = outputs_by_string(channels, connections, owners, list(strings), body, list(body_points))
    system = System.build(
        {**components, **channels.components},
        connections,
        channels.readouts,
        dt=1.0 / fs,
        drives=channels.drives,
        potentials=_potentials(instrument, strings.values(), added.body, choice),
        owners=owners,
    )
    tunings.save()
    inputs: dict[str, tuple[tuple[str, str, float], ...]] = {
        f"body.{point}": (("body", point, 1.0), *channels.body_inputs.get(point, ())) for point in body_points
    }
    return Model(
        instrument=instrument,
        fs=fs,
        system=system,
        strings=strings,
        outputs=channels.groups,
        body_points=body_points,
        inputs=inputs | {name: entries for a in attached for name, entries in a.inputs.items()},
        exciters=instrument.exciters,
        default_exciter=instrument.spec.playing.default_exciter,
        choice=choice,
        body=added.body,
        resting=resting,
    )


def _check_body(instrument: Instrument, strings: Mapping[str, StringModel], body: ModalBasis, dt: float) -> None:
    """Refuse a body that is not passive at the points where strings end and exciters push."""
    driven = {point for string in strings.values() for p in string.ends for point in p.ends}
    driven |= {e.at.partition(".")[2] for e in instrument.exciters.values() if e.at is not None}
    check_basis(body, sorted(driven), dt=dt).require(file=str(instrument.folder / MANIFEST), key="body")


def _check_references(
    instrument: Instrument,
    strings: Mapping[str, StringModel],
    components: Mapping[str, ModalBasis],
    connections: Sequence[Connection],
    outputs: Outputs,
) -> None:
    """Refuse connections and readouts of plugins that name unknown components, points and connections."""
    earlier = {c.name for c in connections if c.role != "attached"}
    for string in strings.values():
        for part, parts in by_part(string.connections()).items():
            plugin = string.touching.get(part)
            fault = partial(_fault, plugin, f"connections.{part}")
            check_connections(parts, components, earlier, fault)
            earlier |= {c.name for c in parts}
    names = [c.name for c in connections]
    for group in outputs.groups:
        pickup = instrument.pickups.get(group.name.partition(".")[0], instrument.pickups.get(group.name))
        readouts = [outputs.readouts[i] for i in group.readouts]
        check_readouts(readouts, (), components, names, partial(_fault, pickup, f"outputs.{group.name}"))
    check_readouts((), outputs.drives, components, names, partial(_fault, None, "outputs"))


def _check_components(strings: Iterable[StringModel], taken: set[str], outputs: Outputs) -> None:
    """Refuse a component of a part that has the name of another one: it would take its place."""
    for string in strings:
        _take(string.bases(), taken, partial(_fault, None, f"strings.{string.name}"))
        for parts in string.attached():
            plugin = string.touching.get(next((c.part for c in parts.connections), ""))
            _take(parts.components, taken, partial(_fault, plugin, f"strings.{string.name}"))
    _take(outputs.components, taken, partial(_fault, None, "outputs"))


def _take(names: Iterable[str], taken: set[str], fault: Callable[[str], BundleError]) -> None:
    for name in names:
        if name in taken:
            raise fault(f"there are two components {name!r}; names begin with the string's and the part's")
        taken.add(name)


def _fault(plugin: Plugin[Any] | None, key: str, reason: str) -> BundleError:
    """Error of a part that names its class."""
    return BundleError(reason, key=key) if plugin is None else plugin.fault(f"{type(plugin).__name__}: {reason}")


def _string_components(strings: Iterable[StringModel]) -> dict[str, ModalBasis]:
    bases = {name: basis for string in strings for name, basis in string.bases().items()}
    return bases | {name: b for string in strings for a in string.attached() for name, b in a.components.items()}


def _end_connections(strings: Iterable[StringModel]) -> list[Connection]:
    """Joints of the strings' ends to the body, then the dashpots of the fingers that hold strings."""
    joints = [
        Connection(
            f"{p.component}.bridge",
            (Term(p.component, "bridge"), *(Term("body", point, -factor) for point, factor in p.ends.items())),
            Rigid(),
            role="bridge",
            owner=string.name,
        )
        for string in strings
        for p in string.ends
    ]
    holds = [
        Connection(
            f"{p.component}.hold", (Term(p.component, "pluck"),), SpringDashpot(), role="hold", owner=string.name
        )
        for string in strings
        for p in string.polarizations
    ]
    return joints + holds


def _potentials(
    instrument: Instrument, strings: Iterable[StringModel], body: ModalBasis, choice: Choice
) -> list[Potential]:
    """Potentials of strings and of the body, without those that are left out by choice."""
    potentials = list(instrument.body.potentials("body"))
    if potentials and not body.is_real:
        raise instrument.body.fault("stores energy beside that of its modes, which then must be real")
    declared = [(s.resonator, p) for s in strings for p in s.potentials] + [(instrument.body, p) for p in potentials]
    return [p for plugin, p in declared if not p.effect or choice.keeps(plugin, p.effect)]


def _check_places(instrument: Instrument, strings: Mapping[str, StringModel]) -> None:
    """Check places of exciters: the default one plays every string, any other one at least the longest."""
    lengths = [string.length() for string in strings.values()]
    for name, exciter in instrument.exciters.items():
        if exciter.at is None and lengths:
            length = min(lengths) if name == instrument.spec.playing.default_exciter else max(lengths)
            try:
                places(exciter.parameters, length, length)
            except ValueError as fault:
                raise BundleError(str(fault), file=instrument.folder / MANIFEST, key=f"exciters.{name}") from None
