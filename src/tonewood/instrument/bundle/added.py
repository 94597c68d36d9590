"""Masses, springs and dashpots put on a body (`body.added`): components and connections of the system.

A mass is a component of its own, held rigidly to the body's point; a spring or a dashpot alone is a connection to the
ground. Both are passive by construction, as every linear connection is, and one-way microphones hear their forces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tonewood.errors import BundleError
from tonewood.instrument.bundle.schema import Added
from tonewood.instrument.contract.attached import loose_mass
from tonewood.instrument.contract.base import BodyPoint, BridgeForce, dot
from tonewood.instrument.contract.directions import unit_vector
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.modal.loaded import loaded
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.validation_messages import did_you_mean


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
    rows = np.zeros((len(entries), len(body.points)))
    for i, (entry, factor) in enumerate(zip(entries, factors, strict=True)):
        rows[i, body.index(entry.at)] = factor
        name = f"body.added.{i}"
        if entry.mass > 0:
            rate = entry.damping / (2 * entry.mass)
            components[name] = loose_mass(entry.mass, math.sqrt(entry.stiffness / entry.mass), rate)
            terms = (Term(name, "mass"), Term("body", entry.at, -factor))
            connections.append(Connection(name, terms, Rigid(), role="added"))
            forces.append(BridgeForce(name, entry.at, -factor))
        else:
            law = SpringDashpot(entry.stiffness, entry.damping)
            connections.append(Connection(name, (Term("body", entry.at, factor),), law, role="added"))
            forces.append(BridgeForce(name, entry.at, factor))
    try:
        whole = loaded(body, rows, *_numbers(entries))
    except ValueError as fault:
        raise BundleError(str(fault), file=file, key="body.added") from None
    return BodyParts(whole, components, tuple(connections), tuple(forces))


def _numbers(entries: Sequence[Added]) -> tuple[list[float], list[float], list[float]]:
    """Masses, damping constants and stiffnesses."""
    return [e.mass for e in entries], [e.damping for e in entries], [e.stiffness for e in entries]


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
    """Mass, stiffness, damping and place of an entry, one line."""
    named = ((entry.mass, "kg"), (entry.stiffness, "N/m"), (entry.damping, "N s/m"))
    return f"{', '.join(f'{value:g} {unit}' for value, unit in named if value)} at {entry.at}"
