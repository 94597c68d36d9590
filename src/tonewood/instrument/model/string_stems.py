"""Outputs by string: the share of each string's force on the body, and of its own motion, in every channel.

Body and microphones are linear, so that a readout is the sum of the shares of all connections' forces. Each string
has copies of the microphones' banks, and of the body where it is read, driven one way by the connections that the
string owns; readouts of strings keep their own probes. The rest, of known forces on the body and of parts joined to it,
is the stem ``body``. All stems of a channel add up to it, also where a string that is stopped anew gives the bridge an
impulse: the copies of the body receive it, too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tonewood.instrument.model.output_assembly import OutputGroup, Outputs
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis

#: stem of the parts that no string owns
BODY = "body"


def outputs_by_string(
    outputs: Outputs,
    connections: Sequence[Connection],
    owners: Mapping[str, str],
    strings: Sequence[str],
    body: ModalBasis,
    points: Sequence[str],
) -> Outputs:
    """Split every group into one per string, ``GROUP.STRING``, and ``GROUP.body``.

    outputs : of the instrument.
    connections : all of the system, with their owners.
    owners : component -> string that it belongs to.
    strings : their names.
    body, points : its modes and the points where known forces may act.
    """
    stems = [*strings, BODY]
    owner = {c.name: c.owner or BODY for c in connections}
    copied = {BODY: body} | dict(outputs.components)
    drives = [
        Drive(BODY, term.point, c.name, term.factor, impulses=True)
        for c in connections
        for term in c.terms
        if term.component == BODY
    ]
    components = {_copy(name, stem): basis for name, basis in copied.items() for stem in stems}
    driven = tuple(
        replace(drive, component=_copy(drive.component, owner[drive.connection]))
        for drive in [*outputs.drives, *drives]
    )
    inputs: dict[str, tuple[tuple[str, str, float], ...]] = {
        point: (
            *((_copy(name, BODY), port, factor) for name, port, factor in outputs.body_inputs.get(point, ())),
            (_copy(BODY, BODY), point, 1.0),
        )
        for point in points
    }
    readouts: list[Readout] = []
    slots: dict[tuple[int, str], int] = {}
    for index, readout in enumerate(outputs.readouts):
        for stem in stems:
            probes = tuple(_of_stem(readout, stem, copied, owners))
            forces = tuple(entry for entry in readout.forces if owner[entry[0]] == stem)
            slots[index, stem] = len(readouts)
            readouts.append(replace(readout, name=f"{readout.name}.{stem}", probes=probes, forces=forces))
    groups = tuple(_group(group, stem, slots) for group in outputs.groups for stem in stems)
    used = {probe.component for readout in readouts for probe in readout.probes}
    return Outputs(
        groups,
        tuple(readouts),
        {name: basis for name, basis in components.items() if name in used},
        tuple(drive for drive in driven if drive.component in used),
        {point: tuple(e for e in entries if e[0] in used) for point, entries in inputs.items()},
    )


def _copy(component: str, stem: str) -> str:
    return f"{component}.of_{stem}"


def _of_stem(readout: Readout, stem: str, copied: Mapping[str, ModalBasis], owners: Mapping[str, str]) -> list[Term]:
    probes = [replace(p, component=_copy(p.component, stem)) for p in readout.probes if p.component in copied]
    return probes + [p for p in readout.probes if p.component not in copied and owners.get(p.component, BODY) == stem]


def _group(group: OutputGroup, stem: str, slots: Mapping[tuple[int, str], int]) -> OutputGroup:
    return replace(group, name=f"{group.name}.{stem}", readouts=tuple(slots[i, stem] for i in group.readouts))
