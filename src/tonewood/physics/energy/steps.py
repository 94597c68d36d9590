"""Losses and the work of known forces over the steps of one component's motion, breakpoints inside steps included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tonewood.physics.energy.forms import ComponentEnergy
from tonewood.physics.stepping.forcing import SampledForce, Segment
from tonewood.support.arrays import Floats


@dataclass(frozen=True, slots=True)
class KnownForce:
    """A force that exciters put on a point: segments, or values at equal intervals; `label` is whose work it is."""

    label: str
    component: str
    point: str
    pieces: tuple[Segment, ...] | SampledForce
    time: float = 0.0
    factor: float = 1.0


def over_steps(
    energy: ComponentEnergy,
    x: Floats,
    constant: Floats,
    modal_forces: Floats | None,
    forces: Sequence[KnownForce],
    sample: int,
    dt: float,
) -> tuple[Floats, Floats, list[Floats]]:
    """Energy lost in each of T steps, J, the part of it that is sound, and the work of each known force.

    x : (T, n_modes, 2) states at the beginning of each step.
    constant : (T, n_points) N, forces on points that are constant over each step.
    modal_forces : (T, n_modes) modal forces that are constant over each step, or None.
    forces : forces on this component.
    sample : absolute number of the first step.
    """
    T = len(x)
    if not x.shape[1]:  # all its modes lie above the highest that is stepped
        return np.zeros(T), np.zeros(T), [np.zeros(T) for _ in forces]
    coefficients = [_by_step(force, sample, T, dt) for force in forces]
    broken = np.zeros(T, dtype=bool)
    for c in coefficients:
        broken |= np.isnan(c[:, 0])
    driven = np.zeros(T, dtype=bool)
    for c in coefficients:
        driven |= np.any(c != 0.0, axis=1)
    driven &= ~broken
    lost, sound, works = np.zeros(T), np.zeros(T), [np.zeros(T) for _ in forces]

    def of(which: NDArray[np.bool_] | slice) -> Floats | None:
        return None if modal_forces is None else modal_forces[which]

    forms = energy.forms(dt)
    quiet = ~driven & ~broken
    if quiet.any():
        s = energy.start(x[quiet], constant[quiet][:, :, None], of(quiet))
        lost[quiet], sound[quiet] = energy.lost(forms, s), energy.sound(forms, s)
    if driven.any():
        total = np.zeros((T, len(energy.points), 3))
        total[:, :, 0] = constant
        for force, c in zip(forces, coefficients, strict=True):
            total[driven, energy.points.index(force.point)] += c[driven]
        s = energy.start(x[driven], total[driven], of(driven))
        lost[driven], sound[driven] = energy.lost(forms, s), energy.sound(forms, s)
        for force, c, work in zip(forces, coefficients, works, strict=True):
            work[driven] = np.sum(c[driven] * energy.moments(forms, s, force.point), axis=1)
    for step in np.flatnonzero(broken):
        edges = [e for force in forces for e in _edges(force, sample + int(step), dt)]
        at = x[step : step + 1]
        for start, stop in pairwise(sorted({0.0, 1.0, *(e for e in edges if 0 < e < 1)})):
            parts = [_on_interval(force, sample + int(step), start, stop, dt) for force in forces]
            total = np.zeros((1, len(energy.points), 3))
            total[0, :, 0] = constant[step]
            for force, part in zip(forces, parts, strict=True):
                total[0, energy.points.index(force.point)] += part
            forms = energy.forms((stop - start) * dt)
            s = energy.start(at, total, of(slice(step, step + 1)))
            lost[step] += energy.lost(forms, s)[0]
            sound[step] += energy.sound(forms, s)[0]
            for force, part, work in zip(forces, parts, works, strict=True):
                work[step] += float(part @ energy.moments(forms, s, force.point)[0])
            at = energy.flow(forms, s)
    return lost, sound, works


def _edges(force: KnownForce, step: int, dt: float) -> list[float]:
    """Ends of pieces in steps from the beginning of `step`."""
    if isinstance(force.pieces, SampledForce):
        return []
    return [(force.time + t) / dt - step for p in force.pieces for t in (p.start, p.stop)]


def _by_step(force: KnownForce, sample: int, T: int, dt: float) -> Floats:
    """(T, 3) coefficients in tau of a force over each of T steps; nan where it has a breakpoint inside the step."""
    out = np.zeros((T, 3))
    if isinstance(force.pieces, SampledForce):
        out[:, 0] = force.factor * force.pieces.by_step(sample, T, dt, force.time)
        return out
    for piece in force.pieces:
        begin, end = (force.time + piece.start) / dt - sample, (force.time + piece.stop) / dt - sample
        if end <= begin or end <= 0 or begin >= T:
            continue
        for edge in (begin, end):
            if 0 < edge < T and edge != np.floor(edge):
                out[int(np.floor(edge))] = np.nan
        first, last = max(int(np.ceil(begin)), 0), min(int(np.floor(end)), T)
        if first < last:
            by = (np.arange(first, last) - begin) * dt
            out[first:last, 0] += force.factor * (piece.c0 + by * (piece.c1 + by * piece.c2))
            out[first:last, 1] += force.factor * dt * (piece.c1 + 2 * by * piece.c2)
            out[first:last, 2] += force.factor * dt**2 * piece.c2
    return out


def _on_interval(force: KnownForce, step: int, start: float, stop: float, dt: float) -> Floats:
    """(3,) coefficients in tau of a force between two neighbouring breakpoints, given in shares of a step."""
    if isinstance(force.pieces, SampledForce):
        return np.array([force.factor * float(force.pieces.by_step(step, 1, dt, force.time)[0]), 0.0, 0.0])
    for piece in force.pieces:
        begin, end = ((force.time + t) / dt - step for t in (piece.start, piece.stop))
        if begin <= 0.5 * (start + stop) < end:
            c0, c1, c2 = piece.shifted((start - begin) * dt)
            d = (stop - start) * dt
            return force.factor * np.array([c0, c1 * d, c2 * d * d])
    return np.zeros(3)
