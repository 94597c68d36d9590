"""A compiled system as the arrays that the C++ kernel loads: modes last, padded; fixed and contact ports apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood import _kernel
from tonewood.physics.coupling.connections import LinearSolve
from tonewood.physics.coupling.inverse import InverseInParts
from tonewood.physics.coupling.laws import NonlinearLaw
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.potentials.solve import force_vector
from tonewood.physics.coupling.potentials.tension import TensionShare
from tonewood.physics.coupling.system import Compiled, System
from tonewood.support.arrays import Floats

#: arrays and numbers by name
Description = dict[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class PortSets:
    """Ports of one component that are always stepped, ports on which only contacts act, and their connections.

    `incidence` (n_linear, n_fixed) is that of the linear connections; `coupled`: to a longitudinal motion; `is_hub`:
    the linear connections are solved in parts that its motions join; `key` tells whether any of it changed.
    """

    fixed: NDArray[np.intp]
    contact: NDArray[np.intp]
    incidence: Floats
    coupled: bool
    is_hub: bool
    key: bytes


#: of a component's terms in nonlinear connections: its connection among those that touch it, port among its fixed or
#: contact ports, whether it is a contact port, factor
OwnTerms = Sequence[tuple[int, int, bool, float]]


def sort_ports(
    shares: Floats, use: NDArray[np.intp], k: int, coupled: bool, one_way: bool, hub_ports: NDArray[np.intp] | None
) -> tuple[PortSets, OwnTerms]:
    """Sort a component's ports by the connections in use.

    shares : (g, n_ports) of its ports in the g connections that touch it.
    use : (g, 2) index of each among the k linear ones that can carry force, -1 of others; 1 for a nonlinear one, 2 for
        a contact, 0 for others.
    coupled, one_way : to a longitudinal motion; a driven component.
    hub_ports : of a hub, whose ports are its motions; else None.
    """
    index, kind = use.T
    acts = shares != 0.0
    touched, needed = np.any(acts[kind > 0], axis=0), np.any(acts[(index >= 0) | (kind == 1)], axis=0)
    is_contact = touched & ~needed & (not one_way and not coupled)
    contact, fixed = np.flatnonzero(is_contact), np.flatnonzero((touched | needed) & ~is_contact)
    if hub_ports is not None:
        fixed = np.union1d(hub_ports, np.flatnonzero(np.any(acts[kind == 1], axis=0)))
    numbers = []
    for i, port in zip(*np.nonzero(acts & (kind > 0)[:, None]), strict=True):
        among = contact if is_contact[port] else fixed
        numbers.append((int(i), int(np.searchsorted(among, port)), bool(is_contact[port]), float(shares[i, port])))
    incidence = np.zeros((0 if hub_ports is not None else k, len(fixed)))  # the hub's is that of the parts
    if hub_ports is None:
        incidence[index[index >= 0]] = shares[index >= 0][:, fixed]
    used = np.nonzero(incidence)
    parts = [part.tobytes() for part in (*used, incidence[used], fixed, contact)]
    parts.append(b"coupled" if coupled else b"" if hub_ports is None else b"hub")
    return PortSets(fixed, contact, incidence, coupled, hub_ports is not None, b"|".join(parts)), numbers


def describe_component(compiled: Compiled, sets: PortSets, one_way: bool, loaded: bool) -> Description:
    """Describe a component's arrays, modes last and padded; `loaded`: laws act on its fixed ports."""
    # the motion of a driven component's ports is not needed
    readouts = np.arange(len(compiled.ports), len(compiled.rows))
    fixed, contact, incidence = sets.fixed, sets.contact, sets.incidence
    if not (one_way or loaded or sets.coupled or sets.is_hub) and len(incidence):
        fixed, span = compiled.motions(fixed)
        if len(fixed) < len(sets.fixed):
            incidence = np.ascontiguousarray(incidence @ span)
    rows = readouts if one_way else np.concatenate([fixed, readouts])
    response = compiled.history
    out: Description = {
        "e": packed(compiled.E.reshape(-1, 4)[None])[0],
        "rows": packed(compiled.rows[rows]),
        "w": packed(compiled.W[fixed]),
        "response": np.ascontiguousarray(response[:, fixed][:, :, rows]),
        "incidence": incidence,
        "channels": compiled.readouts.tolist(),
        "difference": compiled.difference.astype(int).tolist(),
    }
    if contact.size:
        out |= {
            "contact_rows": packed(compiled.rows[contact]),
            "contact_w": packed(compiled.W[contact]),
            "from_fixed": np.ascontiguousarray(response[:, fixed][:, :, contact]),
            "from_contact": np.ascontiguousarray(response[:, contact][:, :, contact]),
            "on_rows": np.ascontiguousarray(response[:, contact][:, :, rows]),
        }
    if compiled.potentials and not one_way:
        y, none = compiled.coordinates, np.zeros(compiled.basis.n_modes)
        weights = next((p.weights for p in compiled.potentials.values() if isinstance(p, TensionShare)), none)
        names = ("a", weights), ("reading", y.reading), ("stiffness", y.stiffness)
        out |= {name: packed(a[None, :, None])[0, 0] for name, a in names}
        out["kick"] = packed(y.kick[None])[0]
        out["velocity"], out["middle"] = packed(y.velocity.T[None])[0], packed(y.middle.T[None])[0]
    return out


def describe_linear(solve: LinearSolve, weights: Floats, port_sets: Sequence[PortSets], in_parts: bool) -> Description:
    """Describe the k linear connections that can carry force, their inverse dense or in parts."""
    on, by = solve.on, solve.by
    out: Description = {
        "gamma": solve.gamma[on],
        "constant": by.apply(solve.offset[on]),
        "weights": np.ascontiguousarray(weights[:, on]),
    }
    if not (in_parts and isinstance(by, InverseInParts)):
        return out | {"inverse": np.ascontiguousarray(by.dense)}
    out["parts"] = [{"places": p.astype(np.float64), "inverses": np.ascontiguousarray(a)} for p, a in by.parts]
    if (hub := by.hub) is not None:
        places = np.searchsorted(port_sets[hub.slot].fixed, hub.ports)
        out["hub"] = {
            "slot": hub.slot,
            "ports": places.tolist(),
            "point": hub.point.tolist(),
            "factor": hub.factor,
            "span": np.ascontiguousarray(hub.span),
            "joined": np.ascontiguousarray(by.joined),
        }
    return out


def describe_potentials(system: System) -> list[Description]:
    """Describe the potentials that are on, those of a kind together: index in the state, components, and arrays."""
    out: list[Description] = []
    for i, (potential, memory) in enumerate(zip(system.potentials, system.potentials.memory, strict=True)):
        if not system.potentials.on[i]:
            continue
        slots = [system.slot(name) for name in potential.components]
        entry: Description = {"at": memory.start, "slots": slots, **system.joined(i).describe()}
        if isinstance(potential, DrivenLongitudinal):
            entry["target"] = system.slot(potential.targets[0])
            entry["vector"] = packed(force_vector(system, potential)[None])[0]
        out.append(entry)
    return sorted(out, key=lambda entry: int(entry["kind"]))


def law_arrays(
    laws: Sequence[NonlinearLaw], before: Sequence[NonlinearLaw] = (), arrays: Description | None = None
) -> Description:
    """Describe laws: kinds (k), numbers (k, 8): a[4], loss, damping, offset, velocity; samples and functions of some.

    Where a law is the same as in `before`, its arrays are taken over from `arrays`.
    """
    out: Description = {"kinds": np.zeros(len(laws), dtype=np.int64), "numbers": np.zeros((len(laws), 8))}
    out |= {"samples": [], "functions": []}
    if arrays is not None and len(before) == len(laws):
        out = arrays | {"kinds": arrays["kinds"].copy(), "numbers": arrays["numbers"].copy()}
        changed = [j for j, (law, was) in enumerate(zip(laws, before, strict=True)) if law is not was]
    else:
        changed = list(range(len(laws)))
    for name in ("samples", "functions"):
        out[name] = [entry for entry in out[name] if entry[0] not in set(changed)]
    for j in changed:
        law, data = laws[j], laws[j].describe()
        out["kinds"][j] = data.kind
        numbers = *data.numbers, data.loss, data.damping
        out["numbers"][j] = [*numbers, law.offset, law.velocity]
        if data.samples is not None:
            out["samples"].append((j, *data.samples))
        if data.functions:
            out["functions"].append((j, list(data.functions)))
    return out


def packed(a: Floats) -> Floats:
    """(k, n_modes, c) -> (k, c, padded n_modes), zeros in the padding."""
    k, n, c = a.shape
    width = -(-max(n, 1) // _kernel.PADDING) * _kernel.PADDING
    out = np.zeros((k, c, width))
    out[:, :, :n] = a.transpose(0, 2, 1)
    return out
