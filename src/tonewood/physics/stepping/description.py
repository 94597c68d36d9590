"""A compiled system as the arrays that the C++ kernel loads: modes last, padded; fixed and contact ports apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood import _kernel
from tonewood.physics.coupling.connections import LinearSolve
from tonewood.physics.coupling.geometric import GeometricStretch
from tonewood.physics.coupling.inverse import InverseInParts
from tonewood.physics.coupling.laws import (
    CompiledPotential,
    Contact,
    Friction,
    HardeningSpring,
    NonlinearLaw,
    SampledPotential,
    Scalar,
)
from tonewood.physics.coupling.phantom_solve import force_vector
from tonewood.physics.coupling.system import Compiled, System

Floats = NDArray[np.float64]
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

    Parameters
    ----------
    shares : (g, n_ports) of its ports in the g connections that touch it.
    use : (g, 2) place of each among the k linear ones that can carry force, -1 of others; 1 for a nonlinear one, 2 for
        a contact, 0 for others.
    coupled, one_way : to a longitudinal motion; a driven component.
    hub_ports : of a hub, whose ports are its motions; else None.
    """
    place, kind = use.T
    acts = shares != 0.0
    touched, needed = np.any(acts[kind > 0], axis=0), np.any(acts[(place >= 0) | (kind == 1)], axis=0)
    is_contact = touched & ~needed & (not one_way and not coupled)
    contact, fixed = np.flatnonzero(is_contact), np.flatnonzero((touched | needed) & ~is_contact)
    if hub_ports is not None:
        fixed = np.union1d(hub_ports, np.flatnonzero(np.any(acts[kind == 1], axis=0)))
    own = []
    for i, port in zip(*np.nonzero(acts & (kind > 0)[:, None]), strict=True):
        among = contact if is_contact[port] else fixed
        own.append((int(i), int(np.searchsorted(among, port)), bool(is_contact[port]), float(shares[i, port])))
    incidence = np.zeros((0 if hub_ports is not None else k, len(fixed)))  # the hub's is that of the parts
    if hub_ports is None:
        incidence[place[place >= 0]] = shares[place >= 0][:, fixed]
    used = np.nonzero(incidence)
    parts = [part.tobytes() for part in (*used, incidence[used], fixed, contact)]
    parts.append(b"coupled" if coupled else b"" if hub_ports is None else b"hub")
    return PortSets(fixed, contact, incidence, coupled, hub_ports is not None, b"|".join(parts)), own


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
    part = compiled.tension or compiled.geometric
    if part is not None and not one_way:
        none = np.zeros(compiled.basis.n_modes)
        share = compiled.tension
        names = (
            ("a", share.weights if share else none),
            ("half", share.half if share else none),
            ("reading", part.reading),
        )
        out |= {name: packed(a[None, :, None])[0, 0] for name, a in names}
        out["kick"] = packed(part.kick[None])[0]
        out["velocity"] = packed(part.velocity.T[None])[0]
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


def describe_tensions(system: System) -> Description:
    """Describe the strings whose tension rises: (row of the state, EA/(4 L), components); their longitudinal motion."""
    on = [t for t, is_on in enumerate(system.is_on) if is_on]
    strings, stretches = [], []
    for t in on:
        law = system.rising[t]
        slots = [system.slot(name) for name in (law.parts if isinstance(law, GeometricStretch) else law.components)]
        first = system.compiled[slots[0]].tension
        strings.append((t, 0.0 if first is None else first.kappa, slots))
        if isinstance(law, GeometricStretch):
            stretches.append(describe_stretch(system, slots))
    return {"strings": strings, "stretches": stretches}


def describe_phantoms(system: System) -> list[Description]:
    """Describe the strings whose longitudinal motion is driven one way: EA, body, and their parts."""
    out: list[Description] = []
    for i, (string, on) in enumerate(zip(system.phantoms, system.phantoms_on, strict=True)):
        if not on:
            continue
        shares = [(slot, system.compiled[slot].phantom) for slot in map(system.slot, string.components)]
        parts = [{"slot": s, "weights": p.weights, "mirrored": p.mirrored} for s, p in shares if p is not None]
        steps = next(p.steps for _, p in shares if p is not None)
        target, vector = system.slot(string.onto[0][0]), packed(force_vector(system, string)[None])[0]
        whole = {"index": i, "target": target, "scale": string.axial_stiffness, "vector": vector, "steps": steps}
        out.append(whole | {"parts": parts})
    return out


def describe_stretch(system: System, slots: Sequence[int]) -> Description:
    """Describe a string with longitudinal motion: EA L, whether there is such a motion, and its parts."""
    parts = [(slot, part) for slot in slots if (part := system.compiled[slot].geometric) is not None]
    return {
        "scale": parts[0][1].scale,
        "longitudinal": parts[-1][1].longitudinal,
        "parts": [
            {
                "slot": slot,
                "slopes": np.ascontiguousarray(part.slopes if part.stretch is None else part.stretch[None]),
                "stiffness": np.ascontiguousarray(part.stiffness),
            }
            for slot, part in parts
        ],
    }


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
        match law := laws[j]:
            case Contact():
                kind, numbers = 0, [law.stiffness, law.exponent, 0.0, 0.0, law.loss, 0.0]
            case HardeningSpring():
                kind, numbers = 1, [law.stiffness, law.cubic, law.quadratic_damping, 0.0, 0.0, law.damping]
            case SampledPotential():
                kind, numbers = 2, [0.0, 0.0, 0.0, 0.0, law.loss, law.damping]
                out["samples"].append((j, law.knots.tolist(), law.coefficients.reshape(-1).tolist()))
            case CompiledPotential():
                kind, numbers = 3, [0.0, 0.0, 0.0, 0.0, law.loss, law.damping]
                scalars: tuple[Scalar, Scalar] = (law.potential, law.slope)
                out["functions"].append((j, [(f.address, f.data, f.takes_data) for f in scalars]))
            case Friction():
                kind, numbers = 4, [law.normal_force, law.static, law.dynamic, law.speed, 0.0, 0.0]
        velocity = law.velocity if isinstance(law, Friction) else 0.0
        out["kinds"][j], out["numbers"][j] = kind, [*numbers, law.offset, velocity]
    return out


def packed(a: Floats) -> Floats:
    """(k, n_modes, c) -> (k, c, padded n_modes), zeros in the padding."""
    k, n, c = a.shape
    width = -(-max(n, 1) // _kernel.PADDING) * _kernel.PADDING
    out = np.zeros((k, c, width))
    out[:, :, :n] = a.transpose(0, 2, 1)
    return out
