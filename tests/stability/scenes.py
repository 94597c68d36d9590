"""Scenes under attack: strings on a body, made from textbook numbers; energies read from the states."""

from __future__ import annotations

import numpy as np

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, share_velocities

FS = 48000

#: length m, tension N, linear density kg/m, bending stiffness N m^2 of nylon strings of a classical guitar
STRINGS = {
    "E2": (0.65, 71.6, 6.24e-3, 5.7e-5),
    "G3": (0.65, 53.6, 8.25e-4, 3.1e-4),
    "E4": (0.65, 69.6, 3.79e-4, 1.3e-4),
}


def string(name, limit, eta=4e-4):
    """A string's modes below `limit`, Hz, with a loss factor."""
    length, tension, density, stiffness = STRINGS[name]
    loss = lambda omega, k: np.full_like(omega, eta)  # noqa: E731
    return string_basis(length, tension, density, stiffness, loss, freq_upper=limit).with_places({"pluck": 0.11})


def body(limit, zeta=0.012, residual=0.0, n_modes=24, extra=()):
    """Modes from 95 Hz to 9 kHz, those above `limit` folded into the residual; `extra` are added, Hz."""
    rng = np.random.default_rng(7)
    freq = np.geomspace(95.0, 9000.0, n_modes)
    shapes = {p: rng.normal(size=n_modes) * 1.5 for p in (*STRINGS, "top")}
    freq = np.concatenate([freq, extra])
    shapes = {p: np.concatenate([s, np.full(len(extra), 1.0)]) for p, s in shapes.items()}
    whole = ModalBasis.real(2 * np.pi * freq, 2 * np.pi * freq * zeta, shapes, residual=residual * np.eye(len(shapes)))
    return whole.select(freq < limit)


def guitar(fs=FS, *, names=tuple(STRINGS), share=0.45, eta=4e-4, zeta=0.012, residual=2e-9, law=None, extra=()):
    """Strings joined to a body; modes above `share` of the sampling rate are left out, their compliance is not."""
    limit = share * fs
    components = {"body": body(limit, zeta, residual, extra=extra)}
    components |= {n: string(n, limit, eta) for n in names}
    links = [Connection(f"{n}.end", (Term(n, "bridge"), Term("body", n, -1.0)), law or Rigid()) for n in names]
    links += [Connection(f"{n}.finger", (Term(n, "pluck"),), SpringDashpot()) for n in names]
    readouts = [
        Readout("top", "velocity", (Term("body", "top"),)),
        *(
            Readout(f"gap {n}", "displacement", (Term(n, "bridge"), Term("body", n, -1.0)))
            for n in names
        ),
    ]  # fmt: skip
    return System.build(components, links, readouts, dt=1 / fs)


def displaced(system, size=1e-3, velocities=False, seed=1):
    """A state in which every string has a random displacement, and velocities that its joint allows, or rest."""
    rng = np.random.default_rng(seed)
    state = system.start()
    for name, compiled in zip(system.names, system.compiled, strict=True):
        if name == "body":
            continue
        basis = compiled.basis
        omega = np.sqrt(basis.stiffness) + 1.0
        q = size * rng.normal(size=basis.n_modes) / omega * omega.min()
        # the end stays where the body is
        end = basis.right[basis.index("bridge")].real
        q -= end * (end @ q) / (end @ end)
        v = size * rng.normal(size=basis.n_modes) * omega.min() * velocities
        system.modes_of(state, name)[:] = from_motion(basis, q, v)
    share_velocities(system, state)
    return state


def energies(system, state, chunks, steps):
    """(chunks + 1,) stored energy every so many steps of the kernel; moves the state."""
    stepper = KernelStepper(system)
    account = EnergyAccount(system, state)
    out = [sum(account.stored(state).values())]
    for _ in range(chunks):
        stepper.run(state, steps)
        out.append(sum(account.stored(state).values()))
    return np.array(out)
