"""Responses of the outputs and of the strings' ends to the forces that strings exert on their bridges."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.instrument.bundle.added import dynamic_stiffness
from tonewood.instrument.model.assembly import Model
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import RealForm, real_form
from tonewood.support.arrays import Complexes, Floats

#: frequencies per octave besides the body's own resonances
_PER_OCTAVE = 24
_LOWEST = 2 * np.pi * 20.0
#: complex numbers kept at a time for responses
_AT_ONCE = 500_000
_POWER = {"displacement": 0, "velocity": 1, "acceleration": 2}


class BridgeResponse:
    """Magnitudes of frequency responses to the forces of strings on their bridges; strings themselves are left out.

    model : assembled instrument.
    components : components of strings, and ``STRING.longitudinal`` of those whose longitudinal motion is driven one
        way; C of them.
    freq_rad : (f,) rad/s, the body's resonances among them.
    heard : (n_readouts, C, f) of each readout per N.
    stopped : (n_readouts, C, f) bound on the click when a force of each frequency stops at once, of each readout per N.
    """

    def __init__(self, model: Model):
        system = model.system
        joined = tuple(c for string in model.strings.values() for c in string.components)
        phantoms = [p for p in system.potentials if isinstance(p, DrivenLongitudinal)]
        self.components = (*joined, *(f"{p.name}.longitudinal" for p in phantoms))
        top = np.pi / system.dt
        grid = np.geomspace(_LOWEST, top, int(_PER_OCTAVE * np.log2(top / _LOWEST)))
        body, form = model.body, real_form(model.body)
        body_freq = np.abs(body.poles.imag)
        self.freq_rad = np.unique(np.concatenate([grid, body_freq[(body_freq > _LOWEST) & (body_freq < top)]]))
        places = system.layout.places
        ends = [system.connections[places[f"{name}.bridge"]] for name in joined]
        entry = np.zeros((len(self.components), len(body.points)))
        for i, end in enumerate(ends):
            for term in end.terms:
                if term.component == "body":
                    entry[i, body.index(term.point)] += term.factor
        for i, phantom in enumerate(phantoms, len(ends)):
            for _, point, share in phantom.onto:
                entry[i, body.index(point)] += share
        added, gaps, impedance = _added(model, 1j * self.freq_rad)
        rows, direct = _readout_rows(system, "body", body)
        respond = response(body, form, self.freq_rad, np.vstack([gaps, rows]), entry)
        n = len(self.components)
        self._own = body, form, entry
        # forces of the parts added to the body per force of a string
        reaction = -impedance[:, None] * respond[: len(added)]
        heard = respond[len(added) :] * (1j * self.freq_rad) ** direct[:, None, None]
        names = [*(end.name for end in ends), *self.components[len(ends) :]]
        for r, readout in enumerate(system.readouts):
            for name, factor in readout.forces:
                if name in names:
                    heard[r, names.index(name)] += factor
        for slot, (name, one_way) in enumerate(zip(system.names, system.layout.driven, strict=True)):
            if one_way:
                compiled = system.compiled[slot]
                sources = [*names, *added]
                inputs = np.zeros((len(sources), len(compiled.basis.points)))
                for drive in system.drives:
                    if drive.component == name and drive.connection in sources:
                        inputs[sources.index(drive.connection), compiled.basis.index(drive.point)] += drive.factor
                rows, power = _readout_rows(system, name, compiled.basis)
                each = response(compiled.basis, compiled.form, self.freq_rad, rows, inputs)
                whole = each[:, :n] + np.einsum("raf,anf->rnf", each[:, n:], reaction)
                heard += whole * (1j * self.freq_rad) ** power[:, None, None]
        self.heard = np.abs(heard)
        self.stopped = _stopped(self.heard, self.freq_rad)

    @cached_property
    def mobility(self) -> Floats:
        """(C, f) m/s of each end along its polarization per N there; found when first wanted."""
        body, form, entry = self._own
        return np.asarray(np.abs(_own_response(body, form, self.freq_rad, entry) * self.freq_rad))

    def heard_at(self, component: str, freq_rad: Floats) -> Floats:
        """(n_readouts, n) of each readout per N from a string's component, at frequencies of (n,)."""
        return self._at(self.heard, component, freq_rad)

    def stopped_at(self, component: str, freq_rad: Floats) -> Floats:
        """(n_readouts, n) bound on the transient, per N, when a force of these frequencies stops at once."""
        return self._at(self.stopped, component, freq_rad)

    def _at(self, sizes: Floats, component: str, freq_rad: Floats) -> Floats:
        rows = sizes[:, self.components.index(component)]
        return np.array([np.interp(freq_rad, self.freq_rad, row) for row in rows]).reshape(len(rows), len(freq_rad))


def _stopped(size: Floats, freq_rad: Floats) -> Floats:
    """Motion that a force cos(w t + a) leaves behind, when it stops at once, at frequencies v other than its own.

    Its spectrum is no larger than max(v, w) / |w^2 - v^2|, some 1/w below w and 1/v above: the sound is at most
    (1/pi) (int_0^w |H| dv / w + int_w |H| dv / v).
    """
    width = np.diff(freq_rad)
    below = np.zeros_like(size)
    above = np.zeros_like(size)
    mean = 0.5 * (size[..., 1:] + size[..., :-1])
    below[..., 1:] = np.cumsum(mean * width, axis=-1)
    over = np.cumsum((mean * width / (0.5 * (freq_rad[1:] + freq_rad[:-1])))[..., ::-1], axis=-1)
    above[..., :-1] = over[..., ::-1]
    return np.asarray((below / freq_rad + above) / np.pi)


def response(basis: ModalBasis, form: RealForm, freq_rad: Floats, out: Floats, into: Floats) -> Complexes:
    """(n_out, n_in, f) displacement per force of combinations of a component's points, residual compliance included.

    form : of the basis.
    out, into : (n_out, n_points) and (n_in, n_points) weights of the points that are read and driven.
    """
    ins = np.flatnonzero(into.any(axis=0))
    read, driven = np.tensordot(out, form.C, 1)[:, None], form.B[None, ins]
    pairs = _over_modes(form, freq_rad, read, driven).reshape(len(out), len(ins), len(freq_rad))
    combined = np.tensordot(into[:, ins], pairs, (1, 1)).transpose(1, 0, 2)
    return np.asarray(combined + (out @ basis.residual @ into.T)[..., None])


def _over_modes(form: RealForm, freq_rad: Floats, read: Floats, driven: Floats) -> Complexes:
    """(n_pairs, f) sums over the modes, c (i w - A)^-1 b = (i w c b + c (A - tr A) b) / det(i w - A).

    read, driven : (..., n_modes, 2) c and b of the pairs, broadcast; their pairs are counted row by row.
    """
    A = form.A
    (cx, cy), (bx, by) = np.moveaxis(read, -1, 0), np.moveaxis(driven, -1, 0)
    growing = cx * bx + cy * by
    constant = cx * (A[:, 0, 1] * by - A[:, 1, 1] * bx) + cy * (A[:, 1, 0] * bx - A[:, 0, 0] * by)
    numerators = np.stack([growing, constant]).reshape(2 * math.prod(growing.shape[:-1]), len(A)).T
    n = numerators.shape[1] // 2
    trace, square = A[:, 0, 0] + A[:, 1, 1], A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0]
    whole = np.zeros((n, len(freq_rad)), dtype=np.complex128)
    # some frequencies at a time: all of them would take memory by the product of frequencies and modes
    at_a_time = max(1, _AT_ONCE // max(1, 2 * len(A) + 2 * n))
    for first in range(0, len(freq_rad), at_a_time):
        w = freq_rad[first : first + at_a_time, None]
        real, imag = square - w**2, -trace * w
        size = real**2 + imag**2
        response = np.concatenate([real / size, -imag / size]) @ numerators
        inverse = response[: len(w)] + 1j * response[len(w) :]
        whole[:, first : first + at_a_time] = (1j * w * inverse[:, :n] + inverse[:, n:]).T
    return whole


def _own_response(basis: ModalBasis, form: RealForm, freq_rad: Floats, rows: Floats) -> Complexes:
    """(n_rows, f) displacement per force of each combination of points by itself, as `response` has it.

    A response between all pairs of n rows would take n^2 f numbers: 240 strings, a gigabyte.
    """
    alike, which = np.unique(rows, axis=0, return_inverse=True)
    direct = _over_modes(form, freq_rad, np.tensordot(alike, form.C, 1), np.tensordot(alike, form.B, 1))
    residual = np.einsum("np,pq,nq->n", alike, basis.residual, alike)
    return np.asarray((direct + residual[:, None])[which.ravel()])


def _added(model: Model, s: Complexes) -> tuple[list[str], Floats, Complexes]:
    """List masses, springs and dashpots on the body.

    The force of such a connection is minus its dynamic stiffness times the body's share of the gap.

    Returns names of the connections; (n, n_points) share of the body's points in their gaps; (n, f) N/m of each at s.
    """
    connections = [c for c in model.system.connections if c.role == "added"]
    gaps = np.zeros((len(connections), len(model.body.points)))
    for i, connection in enumerate(connections):
        for term in connection.terms:
            if term.component == "body":
                gaps[i, model.body.index(term.point)] += term.factor
    entries = model.instrument.spec.body.added
    impedance = [np.polyval(top, s) / np.polyval(below, s) for top, below in map(dynamic_stiffness, entries)]
    return [c.name for c in connections], gaps, np.array(impedance).reshape(len(entries), s.size)


def _readout_rows(system: System, name: str, basis: ModalBasis) -> tuple[Floats, NDArray[np.intp]]:
    """(n_readouts, n_points) weights of a component's points in the readouts, and the power of i omega they take."""
    rows = np.zeros((len(system.readouts), len(basis.points)))
    for r, readout in enumerate(system.readouts):
        for probe in readout.probes:
            if probe.component == name:
                rows[r, basis.index(probe.point)] += probe.factor
    return rows, np.array([_POWER.get(readout.quantity, 0) for readout in system.readouts], dtype=np.intp)
