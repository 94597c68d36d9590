"""Discrete nonlinear forces: their energy, their limits, and the solve."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from tonewood.errors import NumericalError
from tonewood.lab.nonlinear_port import GeneralLaw, Mounting, PortStepper, solve_ports
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.stepper import NumpyStepper

MOUNTING = Mounting(40.0, 300.0, 0.15, 0.4)
GENERAL = GeneralLaw(MOUNTING.continuous, MOUNTING.energy, reach=1.0, speed=20.0)
gaps = st.floats(-1, 1)


@given(gaps, gaps)
def test_work_is_the_energy_gained_and_a_loss(new: float, old: float) -> None:
    elastic = Mounting(40.0, 300.0)
    force, _ = elastic.force(new, old, 0.01)
    gain = elastic.energy(new) - elastic.energy(old)
    assert force * (new - old) == pytest.approx(gain, rel=1e-12, abs=1e-12)
    force, _ = MOUNTING.force(new, old, 0.01)
    assert force * (new - old) >= gain - 1e-12


@given(gaps, gaps)
def test_slope(new: float, old: float) -> None:
    _, slope = MOUNTING.force(new, old, 0.01)
    step = approx_fprime(np.array([new]), lambda x: MOUNTING.force(float(x[0]), old, 0.01)[0], 1e-7)[0]
    assert slope == pytest.approx(step, rel=1e-4, abs=1e-3)
    assert slope >= 0


@given(gaps, gaps)
def test_general_law_makes_the_same_force_from_the_functions(new: float, old: float) -> None:
    assert GENERAL.force(new, old, 0.1)[0] == pytest.approx(MOUNTING.force(new, old, 0.1)[0], rel=1e-6, abs=1e-7)


def test_discrete_force_tends_to_the_law() -> None:
    gap, rate = 0.05, -0.7
    for dt, tolerance in ((1e-3, 1e-3), (1e-4, 1e-5)):
        force, _ = MOUNTING.force(gap + rate * dt / 2, gap - rate * dt / 2, dt)
        assert abs(force - MOUNTING.continuous(gap, rate)) < tolerance


@pytest.mark.parametrize(
    ("law", "potential", "message"),
    [
        (lambda g, v: g, lambda g: g**2, "slope of the potential"),
        (lambda g, v: -g, lambda g: -(g**2) / 2, "must not fall"),
        (lambda g, v: g - v, lambda g: g**2 / 2, "oppose"),
    ],
)
def test_a_law_that_creates_energy_is_refused(law: object, potential: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GeneralLaw(law, potential, 1.0, 1.0)  # type: ignore[arg-type] # lambdas without annotations


def test_negative_constants_are_refused() -> None:
    with pytest.raises(ValueError, match="create energy"):
        Mounting(-1.0)


@pytest.mark.parametrize("stiffness", [1.0, 1e4, 1e8])
@pytest.mark.parametrize("hardening", [0.0, 1.0, 1e4])
def test_solution_satisfies_the_laws(stiffness: float, hardening: float, rng: np.random.Generator) -> None:
    G = rng.normal(size=(5, 2))
    Z = 1e-4 * G @ G.T  # singular
    laws = (Mounting(stiffness, hardening, 1.0, 10.0),) * 5
    free, old, dt = rng.normal(size=5), rng.normal(size=5), 1e-3
    force, after, iterations = solve_ports(laws, Z, free, old, dt)
    np.testing.assert_array_equal(after, free - Z @ force)
    expected = [law.force(a, b, dt)[0] for law, a, b in zip(laws, after, old, strict=True)]
    np.testing.assert_allclose(expected, force, atol=1e-5 * np.abs(force).max())
    assert iterations <= 15


def test_a_law_stiffer_than_rounding_is_reported() -> None:
    Z = np.ones((3, 3))
    with pytest.raises(NumericalError, match="too stiff"):
        solve_ports((Mounting(1e30),) * 3, Z, np.array([1.0, 2.0, 3.0]), np.zeros(3), 1e-3)


def test_linear_mounting_steps_as_the_linear_connection() -> None:
    basis = ModalBasis.real([3.0, 8.0], [0.1, 0.2], {"p": [1.0, 0.5], "q": [0.3, -1.0]})
    free = ModalBasis.real([0.0, 5.0], [0.0, 0.0], {"p": [1.0, 1.0], "q": [1.0, -0.7]})
    terms = (Term("a", "p"), Term("b", "p", -1.0))
    held = Connection("held", (Term("a", "q"),), Rigid())
    readout = [Readout("x", "displacement", (Term("b", "q"),))]

    def run(law: SpringDashpot, nonlinear: dict[str, Mounting]) -> np.ndarray:
        system = System.build({"a": basis, "b": free}, [Connection("c", terms, law), held], readout, dt=0.02)
        state = system.start()
        state.modes[:] = 0.1
        stepper = PortStepper(system, nonlinear) if nonlinear else NumpyStepper(system)
        return np.hstack(stepper.run(state, 200))

    linear = run(SpringDashpot(stiffness=50.0, damping=0.7), {})
    np.testing.assert_allclose(run(SpringDashpot(), {"c": Mounting(50.0, 0.0, 0.7)}), linear, atol=1e-11)


def test_residual_compliance_in_series_loses_no_energy_and_counts() -> None:
    # a mass on a nonlinear spring through a compliance: the same as the spring alone, softened, when motion is slow
    mass = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, residual=[[0.01]])
    ground = ModalBasis.real([1e4], [0.0], {"p": [0.0]})
    law = Mounting(100.0, 50.0)
    system = System.build(
        {"mass": mass, "ground": ground},
        [Connection("c", (Term("mass", "p"), Term("ground", "p", -1.0)), SpringDashpot())],
        [Readout("x", "displacement", (Term("mass", "p"),)), Readout("v", "velocity", (Term("mass", "p"),))],
        dt=0.01,
    )
    state = system.start()
    system.modes_of(state, "mass")[1, 0] = 1.0
    stretch = np.zeros(1)
    stepper = PortStepper(system, {"c": law})
    energies = []
    for _ in range(300):
        (motion,), _ = stepper.run(state, 1, stretch=stretch)
        gap = system.modes_of(state, "mass")[0, 0]
        speed = system.modes_of(state, "mass")[1, 0]
        energies.append(0.5 * speed**2 + law.energy(gap + stretch[0]) + 0.5 * stretch[0] ** 2 / 0.01)
        assert np.isfinite(motion).all()
    np.testing.assert_allclose(energies, 0.5, rtol=1e-10)


def test_unknown_connection_is_refused() -> None:
    basis = ModalBasis.real([3.0], [0.1], {"p": [1.0]})
    system = System.build({"a": basis}, [Connection("c", (Term("a", "p"),), Rigid())], dt=0.1)
    with pytest.raises(ValueError, match="SpringDashpot"):
        PortStepper(system, {"c": MOUNTING})
    with pytest.raises(ValueError, match="no connection 'd'"):
        PortStepper(system, {"d": MOUNTING})
