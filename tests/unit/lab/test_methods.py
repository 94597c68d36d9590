"""Every method against assembled systems: the order it states, its stability, and the same motion."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from step_matrices import MAPS

from tonewood.lab import assembled
from tonewood.lab.methods import METHODS, Problem, coupled_receptance, exact, forms, stability_limit
from tonewood.lab.methods.scheme import multipliers
from tonewood.lab.methods.step_map import held_position
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices
from tonewood.physics.stepping.stepper import NumpyStepper

LEFT = assembled.chain([1.0, 0.8, 1.2], [0.5, 0.1, 0.4], [900.0, 500.0, 700.0], wall="left")
RIGHT = assembled.chain([0.5, 1.1], [0.2, 0.9], [600.0, 800.0], wall="right")
JUNCTION = Connection("junction", (Term("left", "2"), Term("right", "0", -1.0)))


def join(left, right, connections=(JUNCTION,)):
    return Problem(
        {
            "left": basis_from_matrices(*left, ["0", "1", "2"]),
            "right": basis_from_matrices(*right, ["0", "1"]),
        },
        connections,
        (Term("left", "0"),),
        (Term("right", "1"), Term("left", "2"), Term("right", "0")),
    )


def whole(left, right):
    return assembled.joined([left, right], [np.eye(4)[:3], np.eye(4)[2:]])


def proportional(part):
    return assembled.Matrices(part.M, 0.2 * part.M + 1e-4 * part.K, part.K)


COMPLEX = join(LEFT, RIGHT), assembled.poles(whole(LEFT, RIGHT))
REAL = (
    join(proportional(LEFT), proportional(RIGHT)),
    assembled.poles(whole(proportional(LEFT), proportional(RIGHT))),
)


@pytest.mark.parametrize("name", MAPS)
def test_measured_order_is_the_stated_one(name):
    problem, exact_poles = REAL if METHODS[name].real else COMPLEX
    errors = []
    for fs in (400.0, 800.0):
        poles = MAPS[name](problem, 1 / fs).poles()
        errors.append([np.min(np.abs(poles - p)) for p in exact_poles])
    slope = np.log2(np.sum(errors[0]) / np.sum(errors[1]))
    assert slope == pytest.approx(METHODS[name].order, abs=0.15)


@pytest.mark.parametrize("form", [forms.general, forms.compact])
def test_complex_forms_are_the_assembled_system(form):
    problem, expected = COMPLEX
    poles = sla.eigvals(form(problem).F)
    # the five modes of the parts make four of the whole; the rest is the constraint's double zero
    np.testing.assert_allclose([np.min(np.abs(poles - p)) for p in expected], 0.0, atol=1e-9)
    assert np.sum(np.abs(poles) < 1e-4) == 2


@pytest.mark.parametrize("again", [(), (Connection("again", JUNCTION.terms),)])
def test_receptances_of_joined_parts_are_those_of_the_assembled_system(again):
    """Parts with one joint, and with two, each of them also where one is stated twice."""
    freq = np.array([0.0, 3.0, 5.2])
    other = Connection("other", (Term("left", "0"), Term("right", "1", -1.0)))
    for connections, ends in (((JUNCTION,), [2, 3]), ((JUNCTION, other), [2, 0])):
        problem = join(LEFT, RIGHT, (*connections, *again))
        eye = np.eye(6 - len(connections) - 1)
        system = assembled.joined([LEFT, RIGHT], [eye[[0, 1, 2]], eye[ends]])
        found = coupled_receptance(problem, freq)
        for i, at in enumerate([ends[1], 2, 2]):
            expected = assembled.receptance(system, 2j * np.pi * freq, at, 0)
            np.testing.assert_allclose(found[:, i, 0], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("form", "case"), [(forms.general, 0), (forms.compact, 0), (forms.general, 1), (forms.real, 1)]
)
def test_motion_after_an_impulse(form, case):
    problem, _ = (COMPLEX, REAL)[case]
    parts = (LEFT, RIGHT) if case == 0 else (proportional(LEFT), proportional(RIGHT))
    system = whole(*parts)
    v0 = np.zeros(4)
    v0[0] = 1 / system.M[0, 0]
    n, dt = 800, 1 / 200
    expected = assembled.free_motion(system, np.zeros(4), v0, dt, n)[:, 3]
    start = problem.input_columns[:, 0]
    got = exact(form(problem), dt).run(np.zeros((n, 1)), start)[:, 0]
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


def test_forces_go_in():
    """A slow push: the motion must follow the assembled system's static deflection."""
    problem, _ = REAL
    system = whole(proportional(LEFT), proportional(RIGHT))
    fs, n = 1000.0, 8000
    force = 0.5 - 0.5 * np.cos(np.pi * np.minimum(np.arange(n) / (n / 2), 1.0))
    static = sla.solve(system.K, np.eye(4)[0])
    y = held_position(problem, 1 / fs).run(force[:, None])
    assert y[-1, 0] == pytest.approx(static[3], rel=2e-3)


def test_fourth_order_needs_proper_modes():
    """Where sum r l is not zero the leading error no longer cancels: order 2 (docs/theory.md, section 2)."""
    oscillator = ModalBasis.real([30.0, 50.0], [0.2, 0.3], {"0": [1.0, 1.2]})
    cut_off = ModalBasis.complex(
        [-0.5 + 40j, -0.8 + 70j], {"2": [0.02 + 0.004j, 0.03 - 0.02j]}, {"2": [1 - 1.2j, 1 - 1j]}
    )
    problem = Problem({"left": cut_off, "right": oscillator}, (JUNCTION,))
    A, B, C = problem.generator, problem.gap_columns, problem.gap_rows
    assert abs((C @ B).item()) > 1e-3
    zeros = sla.eigvals(A - B @ C @ A / (C @ B))  # of C (s - A)^-1 B, and one at 0
    zeros = zeros[zeros.imag > 1.0]
    errors = []
    for fs in (1000.0, 2000.0):
        poles = held_position(problem, 1 / fs).poles()
        errors.append(sum(np.min(np.abs(poles - s)) for s in zeros))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_linear_constraint_force_is_unstable_at_any_step():
    for fs in (100.0, 1000.0, 10000.0):
        root = multipliers(METHODS["linear_position"].arrays(COMPLEX[0], 1 / fs))
        worst = root[np.argmax(np.abs(root))]
        assert worst.real < -1.9
        assert abs(worst.imag) < 1e-6


def test_position_level_is_stable_where_modes_pass_nyquist_and_velocity_level_is_not():
    stiff = ModalBasis.real([300.0, 2 * np.pi * 1500.0], [0.0, 0.0], {"2": [1.0, 1.0]})
    light = ModalBasis.real([200.0, 2 * np.pi * 1600.0], [0.0, 0.0], {"0": [1.0, 2.0]})
    problem = Problem({"left": stiff, "right": light}, (JUNCTION,))
    assert np.abs(held_position(problem, 1 / 1000).multipliers()).max() <= 1 + 1e-9
    # sum of phi^2 sin(omega h) / omega is negative at this step
    assert np.abs(multipliers(METHODS["held_velocity"].arrays(problem, 1 / 2500))).max() > 1.01
    assert np.abs(held_position(problem, 1 / 2500).multipliers()).max() <= 1 + 1e-9


def test_acceleration_level_drifts_and_position_level_does_not():
    problem, _ = COMPLEX
    start = problem.input_columns[:, 0]
    drift = {}
    for name in ("p0", "ab3", "held_position"):
        y = MAPS[name](problem, 1 / 400).run(np.zeros((2001, 1)), start)
        drift[name] = np.abs(y[:, 1] - y[:, 2]).max() / np.abs(y).max()
    assert drift["p0"] > 0.02
    assert drift["ab3"] < 1e-9
    assert drift["held_position"] < 1e-12


def single(omega):
    """One oscillator with a constraint that holds nothing."""
    one = ModalBasis.real([omega], [0.0], {"p": [1.0]})
    return Problem({"a": one}, (Connection("none", (Term("a", "p", 0.0),)),))


def test_limits_of_stability_on_one_oscillator():
    # Adams-Bashforth 3 holds on the imaginary axis up to its boundary locus, |omega h| = (5 + sqrt 5) / 10
    z = lambda th: 12 * (np.exp(3j * th) - np.exp(2j * th)) / (23 * np.exp(2j * th) - 16 * np.exp(1j * th) + 5)  # noqa: E731
    from scipy.optimize import brentq

    edge = abs(z(brentq(lambda th: z(th).real, 0.5, 2.0)))
    assert stability_limit(METHODS["ab3"], single(1000.0), 500.0, 5000.0) == pytest.approx(1000 / edge, rel=1e-3)
    # Verlet: omega h = 2
    assert stability_limit(METHODS["verlet"], single(1000.0), 300.0, 5000.0) == pytest.approx(500.0, rel=1e-3)
    with pytest.raises(ValueError, match="no limit"):
        stability_limit(METHODS["held_position"], single(1000.0), 300.0, 5000.0)


def test_held_position_is_what_the_stepper_does(rng):
    connection = Connection("twice", tuple(Term(t.component, t.point, 2 * t.factor) for t in JUNCTION.terms))
    problem = join(LEFT, RIGHT, (JUNCTION, connection))
    system = problem.system(1 / 300)
    state = system.start()
    start = []
    for name in system.names:
        modes = system.modes_of(state, name)
        modes[:] = rng.normal(size=modes.shape)
        start.append(modes.T.ravel())
    expected, _ = NumpyStepper(system).run(state, 50)
    got = held_position(problem, 1 / 300).run(np.zeros((50, 1)), np.concatenate(start))
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_what_a_method_cannot_do_it_refuses():
    rigid_body = ModalBasis.real([0.0], [0.0], {"p": [1.0]})
    problem = Problem({"a": rigid_body}, (Connection("wall", (Term("a", "p"),)),))
    with pytest.raises(ValueError, match="under-damped"):
        forms.general(problem)
    soft = ModalBasis.real([10.0], [0.0], {"p": [1.0]}, residual=[[1e-3]])
    problem = Problem({"a": soft}, (Connection("wall", (Term("a", "p"),)),))
    assert np.abs(held_position(problem, 1e-3).multipliers()).max() <= 1 + 1e-12
    with pytest.raises(ValueError, match="not real"):
        forms.real(COMPLEX[0])
    with pytest.raises(ValueError, match="rigid constraints"):
        Problem({"a": soft}, (Connection("spring", (Term("a", "p"),), SpringDashpot(1.0)),))
    with pytest.raises(ValueError, match="rigid constraints"):
        Problem({"a": soft}, (Connection("shifted", (Term("a", "p"),), Rigid(0.1)),))
