"""Extreme contacts and tensions: energy never rises, no solve fails, and the solution does not depend on its start."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.laws.solve import newton
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

LENGTH, TENSION, DENSITY, DT = 0.65, 70.0, 3.6e-3, 1 / 48000


def string(places, n_modes=140):
    n = np.arange(1, n_modes + 1)
    omega = n * np.pi / LENGTH * np.sqrt(TENSION / DENSITY)
    return ModalBasis.real(
        omega, 0.3 + 0 * omega, places, modal_mass=DENSITY * LENGTH / 2, shape=lambda x: np.sin(n * np.pi * x / LENGTH),
        static_compliance=lambda x, y: min(x, y) * (LENGTH - max(x, y)) / (LENGTH * TENSION),
        metadata={"length": LENGTH, "tension_part": (n * np.pi / LENGTH) ** 2 / DENSITY},
    )  # fmt: skip


def pluck(system, state, name, height, place=0.1):
    modes = system.modes_of(state, name)
    n = np.arange(1, modes.shape[1] + 1)
    shape = 2 * height * np.sin(n * np.pi * place) / ((n * np.pi) ** 2 * place * (1 - place))
    modes[0] = 0.5 * shape * np.sqrt(DENSITY * LENGTH / 2)


def rises(system, state, steps):
    """Largest rise of the energy in one step, and the energy at the start."""
    stepper = KernelStepper(system)
    energy = [stored_energy(system, state).total]
    for _ in range(steps):
        stepper.run(state, 1)
        energy.append(stored_energy(system, state).total)
    assert stepper.statistics.failures == 0
    assert energy[-1] < energy[0]
    return np.diff(energy).max(), energy[0], stepper.statistics


@pytest.mark.parametrize(
    ("stiffness", "exponent", "height"), [(1e10, 1.5, 2e-3), (1e15, 2.3, 2e-3), (1e15, 2.3, 5e-2), (1e13, 1.0, 2e-3)]
)
def test_energy_over_twenty_close_points_never_rises(stiffness, exponent, height):
    places = {f"p{i}": 0.3 + 0.001 * i for i in range(20)}
    connections = [Connection(p, (Term("string", p),), Contact(stiffness, exponent, offset=-1e-4)) for p in places]
    system = System.build({"string": string(places)}, connections, dt=DT)
    state = system.start()
    pluck(system, state, "string", height)
    rise, start, statistics = rises(system, state, 600)
    assert rise <= 1e-9 * start
    assert statistics.solves > 30


@pytest.mark.parametrize("height", [2e-3, 0.2])
def test_energy_of_a_string_pulled_by_a_thousand_newtons_never_rises(height):
    bases = {"x": string({"q": 0.2}, 190), "y": string({"q": 0.2}, 190)}
    system = System.build(bases, [], dt=DT, potentials=[TensionModulation("t", ("x", "y"), 2e4)])
    state = system.start()
    pluck(system, state, "x", height)
    pluck(system, state, "y", 0.3 * height, 0.37)
    rise, start, _ = rises(system, state, 300)
    assert rise <= 1e-7 * start


def test_the_forces_do_not_depend_on_where_the_search_began(rng):
    laws = [Contact(10 ** rng.uniform(5, 12), rng.choice([1.0, 1.5, 2.3]), offset=0.0) for _ in range(8)]
    root = rng.normal(size=(8, 5)) * 1e-3
    Z = root @ root.T + 1e-9 * np.eye(8)
    free, old = rng.normal(size=(2, 8)) * 1e-4
    found = []
    for _ in range(6):
        guess = rng.normal(size=8) * 10 ** rng.uniform(-3, 3)
        f, _, converged = newton(laws, Z, free, old, DT, np.ones(8), guess, 1e-19)
        assert converged
        found.append(Z @ f)
    np.testing.assert_allclose(found, np.tile(found[0], (6, 1)), atol=1e-10 * np.abs(found[0]).max())


@pytest.mark.validate
def test_energy_of_a_tension_modulated_string_falls_over_a_million_steps():
    system = System.build({"x": string({"q": 0.2}, 20)}, [], dt=DT, potentials=[TensionModulation("t", ("x",), 2e4)])
    state, stepper = system.start(), KernelStepper(system)
    pluck(system, state, "x", 5e-3)
    last = stored_energy(system, state).total
    for _ in range(500):
        stepper.run(state, 2000)
        now = stored_energy(system, state).total
        assert now <= last * (1 + 1e-9)
        last = now
