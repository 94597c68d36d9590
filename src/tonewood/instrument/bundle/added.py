"""Masses, springs, dashpots and tuned dampers on a body (`body.added`): components and connections of the system.

A mass is a component of its own, held rigidly to the body's point; a spring or a dashpot alone is a connection to the
ground. A tuned damper is a free mass that a spring and a dashpot join to the point. All are passive by construction, as
every linear connection is, and one-way microphones hear their forces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.bundle.added_schema import Added
from tonewood.instrument.contract.attached import loose_mass
from tonewood.instrument.contract.base import BodyPoint, BridgeForce, dot
from tonewood.instrument.contract.directions import unit_vector
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.modal.loaded import at_first_points, loaded, with_masses
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.validation_messages import did_you_mean

#: coefficients, highest power first
Poly = tuple[float, ...]


@dataclass(frozen=True)
class BodyParts:
    """Components and connections that `body.added` adds to a system.

    body : the body's modes with all of it, for tuning and inspection; the system steps the parts by themselves.
    components, connections : of the system.
    forces : of these connections on points of the body.
    """

    body: ModalBasis
    components: Mapping[str, ModalBasis] = field(default_factory=dict)
    connections: tuple[Connection, ...] = ()
    forces: tuple[BridgeForce, ...] = ()


def body_parts(
    entries: Sequence[Added], body: ModalBasis, points: Mapping[str, BodyPoint], file: Path | None = None
) -> BodyParts:
    """Make the parts that an instrument's bundle adds to its body.

    entries : `body.added` of the bundle.
    body, points : the body's modes, and its points.
    file : the bundle's, for errors.
    Raises BundleError : a point does not exist, takes no forces, or does not move along the direction given.
    """
    if not entries:
        return BodyParts(body)
    factors = [point_factor(i, entry, points, file) for i, entry in enumerate(entries)]
    components: dict[str, ModalBasis] = {}
    connections: list[Connection] = []
    forces: list[BridgeForce] = []
    dampers = [i for i, entry in enumerate(entries) if entry.frequency is not None]
    rows = np.zeros((len(entries), len(body.points) + len(dampers)))
    for i, (entry, factor) in enumerate(zip(entries, factors, strict=True)):
        rows[i, body.index(entry.at)] = factor
        name = f"body.added.{i}"
        mass = f"{name}.mass"
        if entry.frequency is not None:
            rows[i, len(body.points) + dampers.index(i)] = -1.0
            components[mass] = loose_mass(entry.mass)
            _, damping, stiffness = lump(entry)
            terms = (Term("body", entry.at, factor), Term(mass, "mass", -1.0))
            connections.append(Connection(name, terms, SpringDashpot(stiffness, damping), role="added"))
            forces.append(BridgeForce(name, entry.at, factor))
        elif entry.mass > 0:
            rate = entry.damping / (2 * entry.mass)
            components[mass] = loose_mass(entry.mass, math.sqrt(entry.stiffness / entry.mass), rate)
            terms = (Term(mass, "mass"), Term("body", entry.at, -factor))
            connections.append(Connection(name, terms, Rigid(), role="added"))
            forces.append(BridgeForce(name, entry.at, -factor))
        else:
            law = SpringDashpot(entry.stiffness, entry.damping)
            connections.append(Connection(name, (Term("body", entry.at, factor),), law, role="added"))
            forces.append(BridgeForce(name, entry.at, factor))
    try:
        free = with_masses(body, {f"body.added.{i}": entries[i].mass for i in dampers})
        whole = loaded(free, rows, *np.array([lump(e) for e in entries]).T)
    except ValueError as fault:
        raise BundleError(str(fault), file=file, key="body.added") from None
    return BodyParts(at_first_points(whole, len(body.points)), components, tuple(connections), tuple(forces))


def lump(entry: Added) -> tuple[float, float, float]:
    """Mass (kg), damping (N s/m) and stiffness (N/m) fixed to the point; of a tuned damper those of its suspension."""
    if entry.frequency is None or entry.q is None:
        return entry.mass, entry.damping, entry.stiffness
    omega = 2 * math.pi * entry.frequency
    return 0.0, entry.mass * omega / entry.q, entry.mass * omega**2


def dynamic_stiffness(entry: Added) -> tuple[Poly, Poly]:
    """Force per displacement of the point, N/m: numerator and denominator, polynomials of s, highest power first.

    m s^2 + d s + k, or of a tuned damper m s^2 b / (s^2 + b) with b = omega s / Q + omega^2.
    """
    if entry.frequency is None or entry.q is None:
        return (entry.mass, entry.damping, entry.stiffness), (1.0,)
    omega = 2 * math.pi * entry.frequency
    slope, square = omega / entry.q, omega**2
    return (entry.mass * slope, entry.mass * square, 0.0, 0.0), (1.0, slope, square)


def stiffness_rate(entry: Added, key: str) -> tuple[Poly, Poly]:
    """Derivative of `dynamic_stiffness` with respect to a number of the entry, as numerator and denominator.

    Of a tuned damper m s^2 g, g = b / (s^2 + b): dg/db = s^2 / (s^2 + b)^2, db/domega = s / Q + 2 omega and
    db/dQ = -omega s / Q^2.

    key : of the number.
    Raises BundleError : the entry has no number of that name.
    """
    if entry.frequency is None or entry.q is None:
        keys = ("mass", "damping", "stiffness")
        rates: dict[str, tuple[Poly, Poly]] = {k: (tuple(float(k == other) for other in keys), (1.0,)) for k in keys}
    else:
        (b1, b0, *_), below = dynamic_stiffness(entry.model_copy(update={"mass": 1.0}))
        square = tuple(float(x) for x in np.polymul(below, below))
        by_omega, by_q = (1 / entry.q, 2 * b0**0.5), (-b1 / entry.q, 0.0)
        rates = {
            "mass": ((b1, b0, 0.0, 0.0), below),
            "frequency": (tuple(2 * math.pi * entry.mass * x for x in (*by_omega, 0.0, 0.0, 0.0, 0.0)), square),
            "q": (tuple(entry.mass * x for x in (*by_q, 0.0, 0.0, 0.0, 0.0)), square),
        }
    if key not in rates:
        raise BundleError(f"cannot be changed; {', '.join(rates)} of it are allowed", key=key)
    return rates[key]


def point_factor(i: int, entry: Added, points: Mapping[str, BodyPoint], file: Path | None = None) -> float:
    """Displacement along the direction of entry i of `body.added`, per displacement of its point along its own.

    Raises BundleError : the point does not exist, takes no forces, or does not move along the direction given.
    """
    driven = {name: point for name, point in points.items() if point.driven}
    if entry.at not in driven:
        names = f"{did_you_mean(entry.at, driven)}there are {', '.join(driven)}"
        raise BundleError(f"there is no point {entry.at!r}; {names}", file=file, key=f"body.added.{i}.at")
    direction = driven[entry.at].direction
    factor = 1.0 if entry.direction is None else dot(unit_vector(entry.direction), direction)
    if factor == 0.0:
        raise BundleError(
            f"the body does not move that way at {entry.at}: its modes are known along {_shown(direction)}",
            file=file,
            key=f"body.added.{i}.direction",
        )
    return factor


def _shown(direction: Sequence[float]) -> str:
    return "[" + ", ".join(f"{x:g}" for x in direction) + "]"


def added_line(entry: Added) -> str:
    """Mass, stiffness, damping and position of an entry, one line."""
    named = ((entry.mass, "kg"), (entry.stiffness, "N/m"), (entry.damping, "N s/m"))
    tuned = "" if entry.frequency is None else f" on a spring, tuned to {entry.frequency:g} Hz, Q {entry.q:g},"
    return f"{', '.join(f'{value:g} {unit}' for value, unit in named if value)}{tuned} at {entry.at}"
