"""Arrays that a new place or finger on a string leaves as they are are taken over: the same numbers as made anew."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.linalg import expm

from tonewood.instrument.bundle.loading import load_instrument
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects.gesture_connections import GestureConnections
from tonewood.performance.player.fretting import FrettedBases, Fretting
from tonewood.physics.coupling.connections import Connection, SpringDashpot
from tonewood.physics.coupling.system import System

FS = 48000.0


@pytest.fixture(scope="module", params=["classical_guitar", "steel_strings", "sitar"])
def model(request: pytest.FixtureRequest) -> Model:
    return assemble(load_instrument(request.param), FS)


def test_a_place_is_compiled_as_if_it_were_the_first(model: Model) -> None:
    """Bit for bit: samples do not depend on earlier renders."""
    name = next(iter(model.strings))
    stop = min(2, model.strings[name].n_stops)
    ways = [Fretting(stop, place=place, width=width) for place, width in ((0.1, 0.0), (0.123, 4e-3), (0.2, 8e-3))]
    ways += [Fretting(stop), Fretting(stop, place=0.05, width=3e-3, added_damping=30.0), Fretting(stop, place=0.07)]
    one_by_one = FrettedBases(model)
    for way in ways:
        for component, again in one_by_one.bases(name, way).items():
            first = FrettedBases(model).bases(name, way)[component]
            assert again.basis.places == first.basis.places
            for found, expected in (
                (again.basis.right, first.basis.right),
                (again.basis.left, first.basis.left),
                (again.basis.residual, first.basis.residual),
                (again.E, first.E),
                (again.W, first.W),
                (again.form.A, first.form.A),
                (again.history, first.history),
            ):
                assert np.array_equal(found, expected)


def test_a_force_that_is_held_over_a_step_is_the_exponential_of_the_augmented_matrix(model: Model) -> None:
    string = next(iter(model.strings.values()))
    compiled = FrettedBases(model).bases(string.name, Fretting(0.0, place=0.11))[string.components[0]]
    point, dt = compiled.basis.index("pluck"), 1 / FS
    found = compiled.held_force("pluck")
    for mode in (0, 3, compiled.basis.n_modes - 1):
        big = np.zeros((3, 3))
        big[:2, :2], big[:2, 2] = compiled.form.A[mode], compiled.form.B[point, mode]
        expected = expm(big * dt)[:2, 2]
        assert found[mode] == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.abs(expected).max())


def test_fingers_that_come_and_go_leave_the_laws_that_they_found(model: Model) -> None:
    """In any order, and where other laws change meanwhile."""
    connections, system = GestureConnections(model), model.system
    names = [c.owner for c in system.connections if c.role == "hold"][:2]
    steps: list[Mapping[str, float]] = [{}, {names[0]: 0.5}, {names[0]: 1.0, names[-1]: 0.3}, {names[-1]: 0.3}, {}]
    for held in (*steps, *reversed(steps), *steps):
        system = connections.with_holds(system, held)
        assert connections.with_holds(system, held) is system
        _has_holds(system, model, held)
    stiffer = {c.name: c for c in system.connections if c.role == "bridge"}
    softened = {n: Connection(n, c.terms, SpringDashpot(1e6), c.role, c.owner) for n, c in stiffer.items()}
    other = system.with_laws(softened)
    for held in (*steps, *steps):
        other = connections.with_holds(other, held)
        assert all(c.law == SpringDashpot(1e6) for c in other.connections if c.role == "bridge")


def _has_holds(system: System, model: Model, held: Mapping[str, float]) -> None:
    now = model.system.connections
    laws = {
        c.name: Connection(c.name, c.terms, SpringDashpot(damping=held[c.owner]), c.role, c.owner, c.part)
        for c in now
        if c.role == "hold" and c.owner in held
    }
    direct = model.system.with_laws(laws)
    assert system.connections == direct.connections
    assert np.array_equal(system.solve.on, direct.solve.on)
    assert np.array_equal(system.solve.gamma, direct.solve.gamma)
    assert np.array_equal(system.solve.inverse, direct.solve.inverse)
