"""The outputs of an instrument: the readouts, components and inputs that its pickups add to the system."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tonewood.errors import BundleError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.bundle.schema import OutputPart
from tonewood.instrument.contract.base import Body, BodyPoint, BridgeForce, PickupRows, Scene
from tonewood.instrument.contract.conversion import Conversion
from tonewood.instrument.contract.registry import MANIFEST
from tonewood.instrument.model.strings import StringModel
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.validation_messages import did_you_mean


@dataclass(frozen=True, slots=True)
class OutputGroup:
    """Channels that belong together.

    name : of the group.
    channels : names, in order.
    readouts : their places among the system's readouts.
    columns : of each channel, its place among those that the conversion makes of the readouts.
    conversion : of readouts to channels; None: they are the same.
    quantity, unit : quantity read, and its unit.
    full_scale : value at 0 dBFS, in `unit`, before gain and pan.
    note : for the user, one line.
    gain_db, pan : dB, and -1 (left) to 1 (right); None where it is not placed.
    delay : s.
    equalizer : middle (Hz), gain (dB) and quality of each band, None for a shelf.
    """

    name: str
    channels: tuple[str, ...]
    readouts: tuple[int, ...]
    quantity: str
    unit: str
    full_scale: float
    note: str
    gain_db: float = 0.0
    pan: float | None = None
    delay: float = 0.0
    equalizer: tuple[tuple[float, float, float | None], ...] = ()
    columns: tuple[int, ...] = ()
    conversion: Conversion | None = None

    @property
    def gains(self) -> tuple[float, ...]:
        """Factor of each channel by gain and pan."""
        alone = len(set(self.columns)) == 1
        places = (1.0,) * len(self.channels) if self.pan is None else pan_gains(self.pan, 1 if alone else 2)
        return tuple(10 ** (self.gain_db / 20) * factor for factor in places)


def pan_gains(pan: float, n_channels: int) -> tuple[float, float]:
    """Factors left and right of a sound of one or two channels at a pan p from -1 to 1, at constant power.

    One channel takes cos and sin of pi (1 + p) / 4, two are balanced by sqrt(2) times these: p = 0 leaves them.
    """
    angle, factor = math.pi * (1.0 + pan) / 4.0, 1.0 if n_channels == 1 else math.sqrt(2.0)
    return factor * math.cos(angle), factor * math.sin(angle)


@dataclass(frozen=True, eq=False)
class Outputs:
    """All that the wanted output groups add to a system.

    groups : in the order in which they were asked for.
    readouts : of all groups, in the order of the bundle.
    components : one-way modal banks.
    drives : forces of connections that drive these.
    body_inputs : body point -> (component, point, factor): banks that a known force on that point drives as well.
    """

    groups: tuple[OutputGroup, ...]
    readouts: tuple[Readout, ...]
    components: Mapping[str, ModalBasis]
    drives: tuple[Drive, ...]
    body_inputs: Mapping[str, tuple[tuple[str, str, float], ...]]


def make_outputs(instrument: Instrument, request: Sequence[str] | None, scene: Scene) -> Outputs:
    """Ask the pickups of the wanted groups for their rows.

    request : names of output groups; the bundle's first where left out.
    Raises BundleError : there is no group of that name, or two channels of a group have one name.
    """
    names = list(instrument.pickups)
    chosen = names[:1] if request is None else list(request)
    unknown = [name for name in chosen if name not in names]
    if unknown:
        raise BundleError(
            f"there is no output {unknown[0]!r}; {did_you_mean(unknown[0], names)}there are {', '.join(names)}",
            file=instrument.folder / MANIFEST,
            key="outputs",
        )
    readouts: list[Readout] = []
    components: dict[str, ModalBasis] = {}
    drives: list[Drive] = []
    groups: list[OutputGroup] = []
    body_inputs: dict[str, tuple[tuple[str, str, float], ...]] = {}
    for part in instrument.spec.outputs:
        if part.name not in chosen:
            continue
        channels = instrument.pickups[part.name].channels
        if twice := [name for i, name in enumerate(channels) if name in channels[:i]]:
            reason = f"has {twice[0]!r} twice; every channel has a name of its own"
            raise BundleError(reason, file=instrument.folder / MANIFEST, key=f"outputs.{part.name}.channels")
        rows = instrument.pickups[part.name].rows(part.name, scene)
        groups.append(_group(instrument, part, rows, len(readouts)))
        readouts += rows.readouts
        components.update(rows.components)
        drives += rows.drives
        for point, entries in rows.body_inputs.items():
            body_inputs[point] = (*body_inputs.get(point, ()), *entries)
    groups.sort(key=lambda g: chosen.index(g.name))
    return Outputs(tuple(groups), tuple(readouts), components, tuple(drives), body_inputs)


def _group(instrument: Instrument, part: OutputPart, rows: PickupRows, first: int) -> OutputGroup:
    pickup = instrument.pickups[part.name]
    channels, columns = pickup.channels, tuple(range(len(pickup.channels)))
    if part.pan is not None:
        if len(channels) > 2:
            reason = f"is for outputs of one or two channels; {part.name} has {len(channels)}"
            raise BundleError(reason, file=instrument.folder / MANIFEST, key=f"outputs.{part.name}.pan")
        if len(channels) == 1:
            channels, columns = ("left", "right"), (0, 0)
    return OutputGroup(
        name=part.name,
        channels=channels,
        readouts=tuple(range(first, first + len(rows.readouts))),
        quantity="pressure" if pickup.unit == "Pa" else rows.readouts[0].quantity,
        unit=pickup.unit,
        full_scale=part.full_scale,
        note=part.note or "",
        gain_db=part.gain_db,
        pan=part.pan,
        delay=part.delay,
        equalizer=tuple((band.freq, band.gain_db, band.q) for band in part.equalizer),
        columns=columns,
        conversion=rows.conversion,
    )


def make_scene(
    strings: Mapping[str, StringModel],
    body_points: Mapping[str, BodyPoint],
    limit: float,
    added: Sequence[BridgeForce] = (),
    body: Body[Any] | None = None,
) -> Scene:
    """Describe to pickups the points and forces they can read, up to `limit` (Hz); `added`: forces beside strings'."""
    bridge_forces, string_points, end_forces = list(added), {}, {}
    for name, string in strings.items():
        end_forces[name] = tuple((f"{p.component}.bridge", p.direction) for p in string.ends)
        for point in ("bridge", "pluck", *string.places.points):
            string_points[f"{name}.{point}"] = tuple((p.component, point, p.direction) for p in string.polarizations)
        for p in string.ends:
            # the connection pulls the string's end by +f, and the body by -f along the polarization
            bridge_forces += [BridgeForce(f"{p.component}.bridge", pt, -factor) for pt, factor in p.ends.items()]
    return Scene(body_points, tuple(bridge_forces), string_points, end_forces, limit, body)
