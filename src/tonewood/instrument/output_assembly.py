"""The outputs of an instrument: the readouts, components and inputs that its pickups add to the system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tonewood.coupling.layout import Drive, Readout
from tonewood.errors import BundleError
from tonewood.instrument.bundle import Instrument
from tonewood.instrument.contract import Body, BodyPoint, BridgeForce, PickupRows, Scene
from tonewood.instrument.registry import MANIFEST
from tonewood.instrument.schema import OutputPart
from tonewood.instrument.strings import StringModel
from tonewood.modal.modes import ModalBasis
from tonewood.validation_messages import did_you_mean


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
    note : for the user, one line.
    """

    name: str
    channels: tuple[str, ...]
    readouts: tuple[int, ...]
    quantity: str
    unit: str
    full_scale: float
    note: str


@dataclass(frozen=True, eq=False)
class Outputs:
    """All that the wanted output groups add to a system.

    Attributes
    ----------
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


def make_outputs(instrument: Instrument, wanted: Sequence[str] | None, scene: Scene) -> Outputs:
    """Ask the pickups of the wanted groups for their rows.

    Parameters
    ----------
    wanted : names of output groups; the bundle's first where left out.

    Raises
    ------
    BundleError : there is no group of that name.
    """
    names = list(instrument.pickups)
    chosen = names[:1] if wanted is None else list(wanted)
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
    return OutputGroup(
        name=part.name,
        channels=pickup.channels,
        readouts=tuple(range(first, first + len(rows.readouts))),
        quantity="pressure" if pickup.unit == "Pa" else rows.readouts[0].quantity,
        unit=pickup.unit,
        full_scale=part.full_scale,
        note=part.note or "",
    )


def make_scene(
    strings: Mapping[str, StringModel],
    body_points: Mapping[str, BodyPoint],
    limit: float,
    added: Sequence[BridgeForce] = (),
    body: Body[Any] | None = None,
) -> Scene:
    """Describe to pickups what they can read, up to the frequency `limit` (Hz); `added` are forces beside strings'."""
    bridge_forces, string_points, end_forces = list(added), {}, {}
    for name, string in strings.items():
        end_forces[name] = tuple((f"{p.component}.bridge", p.direction) for p in string.ends)
        for point in ("bridge", "pluck", *string.points):
            string_points[f"{name}.{point}"] = tuple((p.component, point, p.direction) for p in string.polarizations)
        for p in string.ends:
            # the connection pulls the string's end by +f, and the body by -f along the polarization
            bridge_forces += [BridgeForce(f"{p.component}.bridge", pt, -factor) for pt, factor in p.ends.items()]
    return Scene(body_points, tuple(bridge_forces), string_points, end_forces, limit, body)
