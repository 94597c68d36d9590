"""A string as it is held, with all its modes or the lower ones only: what may sleep of it, octave by octave.

What sleeps are modes of the string held at its bridge (`modal.held_modes`): those are its partials, and without the
highest of them the others keep their pitch. Bands are the same for all strings, so that what one of them does in a band
can wake the others there: band b lies between ``cuts[b]`` and ``cuts[b - 1]``, and at level b all bands up to it sleep.
At the last level nothing is left but the string's static shape, which moves with its bridge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.connections import Connection, SpringDashpot
from tonewood.coupling.laws import Contact
from tonewood.coupling.system import Compiled
from tonewood.engine.transfer import Transfer
from tonewood.instrument.assembly import Model
from tonewood.modal.held_modes import Condensed, HeldModes, condensed
from tonewood.modal.modes import ModalBasis
from tonewood.stepping.motion import from_motion, to_motion

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: bands, an octave each but for the last one, which holds all that is left
BANDS = 6
#: modes from which on a band's velocities tell its amplitude by their mean
_MANY = 12


def cuts(model: Model) -> Floats:
    """(BANDS + 1,) rad/s, from infinity down to 0."""
    top = max(float(c.basis.stiffness.max(initial=0.0)) for c in model.system.compiled) ** 0.5
    return np.array([np.inf, *(top / 2.0**b for b in range(1, BANDS)), 0.0])


@dataclass(frozen=True, eq=False)
class Part:
    """One component of a string as it is held now.

    Attributes
    ----------
    compiled : the whole of it.
    held : its modes with the bridge held.
    counts : (BANDS + 1,) held modes kept at each level.
    push : (n_held,) N at the bridge per velocity of a held mode.
    reach : (BANDS,) N at the bridge, at most, per root of twice a band's energy in J: its modes in step.
    kick : (BANDS,) largest velocity that a mode gathers per metre of the bridge, kg^-1/2 s^-1.
    heard : (n_readouts, n_held) of the readouts per velocity of a held mode that is left out at once.
    few : (n_held,) whether its band has only some modes.
    compliance : largest g^2 / 2 W^2, N/m: N that a mode in tune gathers per metre of the bridge.
    decay : (BANDS,) 1/s, slowest of each band; infinite where it has no mode.
    loudest : (n_readouts, BANDS) of the readouts per N of a held mode.
    spread : N per m/s of the bridge for all modes of a band out of tune with its motion.
    inertia : (BANDS + 1, F) N per m/s, at most, of what the modes culled at a level would do besides their static force
        when the bridge moves at frequencies of a bin below theirs; 0 elsewhere.
    gain : (F,) s N/m, at most: N, after a long time, per m/s of the bridge in a bin, of the modes in and near it.
    bins : (n_held,) bins of the modes.
    edge : (BANDS + 1, 2) rad/s, last held mode kept at each level and first one culled.
    """

    compiled: Compiled
    held: HeldModes
    counts: NDArray[np.intp]
    push: Floats
    reach: Floats
    kick: Floats
    heard: Floats
    few: NDArray[np.bool_]
    compliance: float
    decay: Floats
    loudest: Floats
    spread: float
    inertia: Floats
    gain: Floats
    bins: NDArray[np.intp]
    edge: Floats
    made: dict[int, tuple[Condensed, Compiled]] = field(default_factory=dict)
    _turned: dict[int, Floats] = field(default_factory=dict)

    @classmethod
    def of(cls, component: str, compiled: Compiled, model: Model, transfer: Transfer, edges: Floats) -> Part:
        """Look at a component.

        Raises
        ------
        ValueError : it cannot be held at its bridge.
        """
        basis = compiled.basis
        held = HeldModes.of(basis, "bridge")
        w, g = held.freq_rad, held.force
        per_newton = transfer.heard_at(component, w)
        for r, readout in enumerate(model.system.readouts):
            power = {"velocity": 1, "acceleration": 2}.get(readout.quantity, 0)
            probes = [(p.factor, basis.index(p.point)) for p in readout.probes if p.component == component]
            for factor, i in probes:
                per_newton[r] += np.abs(factor * (held.vectors @ basis.right[i].real)) * w**power / g
        counts = np.array([np.count_nonzero(w < edge) for edge in edges], dtype=np.intp)
        bands = [slice(counts[b + 1], counts[b]) for b in range(BANDS)]
        push = g / w
        few = counts[:-1] - counts[1:] < _MANY
        gathered = float(np.max(g**2 / (2 * w**2), initial=0.0))
        apart = float(np.min(np.diff(w), initial=np.inf)) / 2
        bounded = np.concatenate([[0.0], w, [np.inf]])
        return cls(
            compiled=compiled,
            held=held,
            counts=counts,
            push=push,
            reach=np.array([math.sqrt(float(push[band] @ push[band])) for band in bands]),
            kick=np.array([0.5 * push[band].max(initial=0.0) for band in bands]),
            heard=(per_newton + transfer.stopped_at(component, w)) * push,
            few=np.concatenate([np.full(b.stop - b.start, f) for b, f in zip(bands[::-1], few[::-1], strict=True)]),
            compliance=gathered,
            decay=np.array([held.damping_rate[band].min(initial=np.inf) for band in bands]),
            loudest=np.array([per_newton[:, band].max(axis=1, initial=0.0) for band in bands]).T,
            spread=gathered * math.log(held.n_modes + 2) / apart,
            inertia=_inertia(push, w, counts, edges, transfer.bins),
            gain=_gain(gathered, w, held.damping_rate, transfer.bins),
            bins=transfer.bin_of(w),
            edge=np.stack([bounded[counts], bounded[counts + 1]], axis=1),
        )

    def at(self, component: str, model: Model, level: int) -> tuple[Condensed | None, Compiled]:
        """What is stepped at a level; made when it is first wanted."""
        if level == 0:
            return None, self.compiled
        if level not in self.made:
            fewer = condensed(self.compiled.basis, self.held, int(self.counts[level]))
            self.made[level] = fewer, model.system.compile(component, fewer.basis)
        return self.made[level]

    def turned(self, component: str, model: Model, level: int) -> Floats:
        """(F,) error of the part's own partials in a bin, at most, re their amplitude, if it stays at a level.

        Forces are held for a step: so stepped, the point's compliance differs from that in continuous time, a little
        less for the modes that are kept alone. At a held mode's frequency, where the point hardly moves, a difference
        D of compliance turns the partial by g^2 |D| / 2 W, and t exp(-s t) is 1 / (e s) at most.
        """
        if level not in self._turned:
            ratio = np.zeros_like(self.gain)
            w, g = self.held.freq_rad[: self.counts[level]], self.held.force[: self.counts[level]]
            if level and w.size:
                whole, fewer = (_stepped_compliance(c, w) for c in (self.compiled, self.at(component, model, level)[1]))
                rate = g**2 / (2 * w) * np.abs(whole - fewer)
                off = np.minimum(rate / (math.e * np.maximum(self.held.damping_rate[: w.size], 1e-9)), 2.0)
                np.maximum.at(ratio, self.bins[: w.size], off)
            self._turned[level] = ratio
        return self._turned[level]

    @cached_property
    def _picks(self) -> Floats:
        """(n_held, n_modes) velocities of the held modes, as they add to the static shape's."""
        return np.asarray(self.held.vectors * self.held.stiffness / self.held.freq_rad[:, None] ** 2)

    def picks(self, component: str, model: Model, level: int) -> Floats:
        """(n_held, n_modes) velocities of the held modes there are at a level, from those of what is stepped."""
        fewer = self.at(component, model, level)[0]
        return self._picks if fewer is None else fewer.held

    def plucked(self, shortest: float) -> tuple[Floats, Floats, Floats]:
        """Forces on the bridge (BANDS,) and (F,), roots of twice the energies (BANDS,), per N let go in `shortest` s.

        It is let go at the point ``pluck``.
        """
        held, w = self.held, self.held.freq_rad
        bent = np.abs(held.vectors @ self.compiled.basis.right[self.compiled.basis.index("pluck")].real) / w**2
        amplitude = bent * np.minimum(1.0, 2.0 / (w * max(shortest, 1e-9)))
        each = np.stack([held.force * amplitude, (w * amplitude) ** 2])
        total = np.concatenate([np.zeros((2, 1)), np.cumsum(each, axis=1)], axis=1)
        force, square = total[:, self.counts[:-1]] - total[:, self.counts[1:]]
        spectrum: Floats = np.bincount(self.bins, each[0], self.gain.size).astype(np.float64)
        return force, spectrum, np.sqrt(np.maximum(square, 0.0))


def _stepped_compliance(compiled: Compiled, freq_rad: Floats) -> Complexes:
    """(n,) displacement of the bridge per force held for a step, residual compliance left out, at frequencies (n,)."""
    i = int(np.flatnonzero(compiled.ports == compiled.basis.index("bridge"))[0])
    E, C, W = compiled.E, compiled.form.C[compiled.ports[i]], compiled.W[i]
    z = np.exp(1j * freq_rad * compiled.dt)[:, None]
    a, b, c, d = z - E[:, 0, 0], E[:, 0, 1], E[:, 1, 0], z - E[:, 1, 1]
    each = (C[:, 0] * (d * W[:, 0] + b * W[:, 1]) + C[:, 1] * (c * W[:, 0] + a * W[:, 1])) / (a * d - b * c)
    return np.asarray(each.sum(axis=1))


def _inertia(push: Floats, freq_rad: Floats, counts: NDArray[np.intp], edges: Floats, bins: Floats) -> Floats:
    """(BANDS + 1, F) largest dynamic minus static force of the culled modes, N per m/s: see `Part.inertia`.

    Under a motion of velocity v at frequency w below its own W a held mode pulls w^3 g^2 / (W^4 (W^2 - w^2)) v less
    than its static compliance does; that grows with w, so that the upper edge of a bin bounds it. The component's own
    partials come no nearer than its modes lie apart.
    """
    out = np.zeros((BANDS + 1, len(bins) - 1))
    if not freq_rad.size:
        return out
    apart = float(np.min(np.diff(freq_rad), initial=freq_rad[0]))
    low, top = bins[:-1, None], np.minimum(bins[1:, None], freq_rad)
    each = push**2 * top**3 / (freq_rad**2 * np.maximum(freq_rad - top, apart) * (freq_rad + top))
    upward = np.concatenate([np.cumsum(each[:, ::-1], axis=1)[:, ::-1], np.zeros((len(each), 1))], axis=1)
    for level in range(1, BANDS):
        out[level] = np.where(low[:, 0] < edges[level], upward[:, counts[level]], 0.0)
    return out


def _gain(gathered: float, freq_rad: Floats, damping_rate: Floats, bins: Floats) -> Floats:
    """(F,) see `Part.gain`: in tune in a mode's own bin and in those beside it, else by the distance."""
    wide = bins[1:] - bins[:-1]
    distance, rate = np.full(len(wide), np.inf), np.full(len(wide), np.inf)
    if freq_rad.size:
        middle = 0.5 * (bins[1:] + bins[:-1])
        above = np.clip(np.searchsorted(freq_rad, middle), 1, max(freq_rad.size - 1, 1))
        for j in (above - 1, np.minimum(above, freq_rad.size - 1)):
            distance = np.minimum(distance, np.maximum(np.abs(freq_rad[j] - middle) - 1.5 * wide, 0.0))
            rate = np.minimum(rate, damping_rate[j])
    return np.asarray(gathered / np.maximum(np.maximum(distance, rate), 1e-9))


@dataclass(frozen=True, eq=False)
class Rungs:
    """A string as it is held now.

    Attributes
    ----------
    parts : component -> its modes.
    quiet : J, energy below which the string cannot reach what it may touch.
    """

    parts: Mapping[str, Part]
    quiet: float

    def carried(self, component: str, model: Model, before: int, after: int, modes: Floats) -> Floats:
        """Motion of a component, (2, n_modes) at one level, as it is stepped at another.

        Taking modes back leaves the motion as it is, leaving modes out takes their energy away.
        """
        part = self.parts[component]
        (old, stepped), (new, then) = (part.at(component, model, level) for level in (before, after))
        q, v = to_motion(stepped.basis, modes)
        if old is not None:
            q, v = old.expand(q, v)
        if new is not None:
            q, v = new.reduce(q, v)
        return from_motion(then.basis, q, v)


def quiet_energy(name: str, bases: Mapping[str, ModalBasis], connections: list[Connection]) -> float:
    """Energy (J) with which a string surely touches nothing; none where it is always in touch.

    Held at its bridge it is displaced by no more than sqrt(2 C E) at a place of compliance C.
    """
    compliance = {}
    for component, basis in bases.items():
        C, b = basis.static_compliance(), basis.index("bridge")
        own = np.diag(C) - C[:, b] ** 2 / C[b, b] if C[b, b] > 0 else np.diag(C)
        compliance[component] = dict(zip(basis.points, np.sqrt(2 * np.maximum(own, 0.0)), strict=True))
    energy = math.inf
    for connection in connections:
        law = connection.law
        if isinstance(law, SpringDashpot):
            continue
        if not isinstance(law, Contact) or any(t.component not in bases for t in connection.terms):
            return 0.0
        reach = sum(abs(t.factor) * float(compliance[t.component][t.point]) for t in connection.terms)
        if reach > 0.0:
            energy = min(energy, (max(-law.offset, 0.0) / reach) ** 2)
    return energy
