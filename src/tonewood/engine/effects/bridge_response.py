"""Responses of the outputs and of the strings' ends to the forces that strings exert on their bridges."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.coupling.system import System
from tonewood.instrument.assembly import Model
from tonewood.modal.modes import ModalBasis
from tonewood.modal.propagator import RealForm, real_form

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

#: frequencies per octave besides the body's own resonances
_PER_OCTAVE = 24
_LOWEST = 2 * np.pi * 20.0
#: complex numbers kept at a time for responses
_AT_ONCE = 500_000
_POWER = {"displacement": 0, "velocity": 1, "acceleration": 2}


class BridgeResponse:
    """Magnitudes of frequency responses to the forces of strings on their bridges; strings themselves are left out.

    Parameters
    ----------
    model : assembled instrument.

    Attributes
    ----------
    components : components of strings, and ``STRING.longitudinal`` of those whose longitudinal motion is driven one
        way; C of them.
    freq_rad : (f,) rad/s, the body's resonances among them.
    heard : (n_readouts, C, f) of each readout per N.
    stopped : (n_readouts, C, f) bound on the click when a force of each frequency stops at once, of each readout per N.
    """

    def __init__(self, model: Model):
        system = model.system
        joined = tuple(c for string in model.strings.values() for c in string.components)
        self.components = (*joined, *(f"{p.name}.longitudinal" for p in system.phantoms))
        top = np.pi / system.dt
        grid = np.geomspace(_LOWEST, top, int(_PER_OCTAVE * np.log2(top / _LOWEST)))
        body, form = model.body, real_form(model.body)
        own = np.abs(body.poles.imag)
        self.freq_rad = np.unique(np.concatenate([grid, own[(own > _LOWEST) & (own < top)]]))
        places = system.layout.places
        ends = [system.connections[places[f"{name}.bridge"]] for name in joined]
        entry = np.zeros((len(self.components), len(body.points)))
        for i, end in enumerate(ends):
            for term in end.terms:
                if term.component == "body":
                    entry[i, body.index(term.point)] += term.factor
        for i, phantom in enumerate(system.phantoms, len(ends)):
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
        for slot, (name, one_way) in enumerate(zip(system.names, system.driven, strict=True)):
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

    Parameters
    ----------
    form : of the basis.
    out, into : (n_out, n_points) and (n_in, n_points) weights of the points that are read and driven.
    """
    ins, outs = np.flatnonzero(into.any(axis=0)), np.flatnonzero(out.any(axis=0))
    A, B, C = form.A, form.B[ins], form.C[outs].reshape(len(outs), 2 * len(form.A))
    residual = (out @ basis.residual @ into.T)[..., None]
    whole = np.zeros((len(out), len(into), len(freq_rad)), dtype=np.complex128)
    # (s - A)^-1 B of every point that is driven, read at every point that is read, then the combinations;
    # some frequencies at a time: all of them would take memory by the product of frequencies and modes
    at_a_time = max(1, _AT_ONCE // max(1, len(A) * (len(ins) + 3)))
    for first in range(0, len(freq_rad), at_a_time):
        s = 1j * freq_rad[first : first + at_a_time, None]
        a, b, c, d = s - A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], s - A[:, 1, 1]
        det = a * d - b * c
        moved = np.empty((len(s), len(ins), len(A), 2), dtype=np.complex128)
        for i, (x, y) in enumerate(B.transpose(0, 2, 1)):
            moved[:, i, :, 0] = (d * x + b * y) / det
            moved[:, i, :, 1] = (c * x + a * y) / det
        points = moved.reshape(len(s), len(ins), 2 * len(A)) @ C.T
        combined = out[:, outs] @ points.transpose(0, 2, 1) @ into[:, ins].T
        whole[..., first : first + at_a_time] = combined.transpose(1, 2, 0)
    return whole + residual


def _own_response(basis: ModalBasis, form: RealForm, freq_rad: Floats, rows: Floats) -> Complexes:
    """(n_rows, f) displacement per force of each combination of points by itself, as `response` has it.

    A response between all pairs of n rows would take n^2 f numbers: 240 strings, a gigabyte.
    """
    alike, which = np.unique(rows, axis=0, return_inverse=True)
    own = [response(basis, form, freq_rad, row[None], row[None])[0, 0] for row in alike]
    return np.array(own).reshape(len(alike), len(freq_rad))[which.ravel()]


def _added(model: Model, s: Complexes) -> tuple[list[str], Floats, Complexes]:
    """List masses, springs and dashpots on the body.

    The force of such a connection is minus its dynamic stiffness times the body's share of the gap.

    Returns
    -------
    names of the connections; (n, n_points) share of the body's points in their gaps; (n, f) N/m of each at s.
    """
    connections = [c for c in model.system.connections if c.role == "added"]
    gaps = np.zeros((len(connections), len(model.body.points)))
    for i, connection in enumerate(connections):
        for term in connection.terms:
            if term.component == "body":
                gaps[i, model.body.index(term.point)] += term.factor
    entries = model.instrument.spec.body.added
    impedance = [e.mass * s**2 + e.damping * s + e.stiffness for e in entries]
    return [c.name for c in connections], gaps, np.array(impedance).reshape(len(entries), s.size)


def _readout_rows(system: System, name: str, basis: ModalBasis) -> tuple[Floats, NDArray[np.intp]]:
    """(n_readouts, n_points) weights of a component's points in the readouts, and the power of i omega they take."""
    rows = np.zeros((len(system.readouts), len(basis.points)))
    for r, readout in enumerate(system.readouts):
        for probe in readout.probes:
            if probe.component == name:
                rows[r, basis.index(probe.point)] += probe.factor
    return rows, np.array([_POWER.get(readout.quantity, 0) for readout in system.readouts], dtype=np.intp)
