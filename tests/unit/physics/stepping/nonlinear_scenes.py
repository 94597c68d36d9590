"""Strings with obstacles and with rising tension, on a body: scenes of the tests of nonlinear steps."""

from __future__ import annotations

import numpy as np

from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis

LENGTH, TENSION, DENSITY = 0.65, 70.0, 3.6e-3


def held_string(n_modes, places, *, length=LENGTH, tension=TENSION, density=DENSITY, damping=0.0, residual=True):
    """Ideal string held at both ends, with named places; the residual is that of all modes above the n-th."""
    n = np.arange(1, n_modes + 1)
    omega = n * np.pi / length * np.sqrt(tension / density)
    options = {"static_compliance": lambda x, y: min(x, y) * (length - max(x, y)) / (length * tension)}
    return ModalBasis.real(
        omega, damping + 0.0 * omega, places, modal_mass=density * length / 2,
        shape=lambda x: np.sin(n * np.pi * x / length), metadata={
            "length": length, "tension_part": (n * np.pi / length) ** 2 / density
        }, **(options if residual else {}),
    )  # fmt: skip


def hang(system, state, component, height, place, length=LENGTH, density=DENSITY):
    """Give a held string the triangular shape of a pluck of `height` m at `place` m, at rest."""
    modes = system.modes_of(state, component)
    n = np.arange(1, modes.shape[1] + 1)
    a = 2 * height * length**2 * np.sin(n * np.pi * place / length) / (n**2 * np.pi**2 * place * (length - place))
    modes[0] += 0.5 * a * np.sqrt(density * length / 2)
    basis = system.compiled[system.slot(component)].basis
    modes[1] += modes[0] * basis.poles.real / basis.poles.imag


def body(points, n_modes=20, seed=3):
    """A body with unevenly spaced modes and a residual compliance at every point."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.geomspace(90, 9000, n_modes)
    shapes = {p: rng.normal(size=n_modes) * 2 for p in points}
    return ModalBasis.real(omega, 0.01 * omega, shapes, residual=1e-9 * np.eye(len(points)))


def modulated_guitar(n_strings=2, n_modes=50, axial_stiffness=2e4, on=True, dt=1 / 48000, frets=None, extra=()):
    """Two polarizations each, the first on the body; their tension rises with amplitude.

    `frets`: law between each first polarization and six frets; `extra`: further connections.
    """
    names = range(n_strings)
    places = {"pluck": 0.11 * LENGTH} | {f"f{k}": LENGTH / 2 ** ((k + 1) / 12) for k in range(6)}
    components = {"body": body([f"b{i}" for i in names])}
    connections, tensions = [], []
    for i in names:
        density = TENSION / (2 * LENGTH * 110 * 1.3**i) ** 2
        string = string_basis(LENGTH, TENSION, density, 5e-5, lambda w, k: 1e-4 + 0 * w, n_modes=n_modes)
        components[f"s{i}a"] = string.with_places(places)
        components[f"s{i}b"] = held_string(n_modes, places, density=density, damping=0.5)
        joint = (Term(f"s{i}a", "bridge"), Term("body", f"b{i}", -0.97))
        connections.append(Connection(f"joint{i}", joint))
        law = SpringDashpot(0.0, 0.01 * i)
        connections.append(Connection(f"hold{i}", (Term(f"s{i}b", "pluck"), Term(f"s{i}a", "pluck", 0.3)), law))
        if frets is not None:
            connections += [Connection(f"s{i}f{k}", (Term(f"s{i}a", f"f{k}"),), frets) for k in range(6)]
        tensions.append(TensionModulation(f"s{i}", (f"s{i}a", f"s{i}b"), axial_stiffness))
    connections += extra
    readouts = [
        Readout("u", "displacement", (Term("s0a", "pluck"),)),
        Readout("v", "velocity", (Term("s0b", "pluck"),)),
        Readout("a", "acceleration", (Term("body", "b0"), Term(f"s{n_strings - 1}a", "pluck"))),
        Readout("f", "force", (), (("joint0", 1.0),)),
    ]  # fmt: skip
    return System.build(components, connections, readouts, dt=dt, potentials=tensions if on else [])


def drawn(system, force, angle=0.6):
    """State of strings pulled aside by `force` N at their pluck point, the bridge end held."""
    state = system.start()
    for name in system.names:
        if not name.startswith("s"):
            continue
        basis = system.compiled[system.slot(name)].basis
        q = basis.right[basis.index("pluck")].real * force / basis.stiffness
        if name.endswith("a"):
            end = basis.right[basis.index("bridge")].real
            q = q * np.cos(angle)
            q = q - end / basis.stiffness * (end @ q) / (end @ (end / basis.stiffness))
        else:
            q = q * np.sin(angle)
        modes = system.modes_of(state, name)
        modes[0], modes[1] = q / 2, q / 2 * basis.poles.real / basis.poles.imag
    return state
