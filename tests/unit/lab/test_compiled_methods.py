"""The compiled methods against their definitions written out with dense matrices, and against eigenvalues."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg as sla
from step_matrices import MAPS

from tonewood.lab.accuracy.reference import ExactMotion, FineMotion
from tonewood.lab.assembled import Matrices, poles
from tonewood.lab.methods import METHODS, forms
from tonewood.lab.methods.pole_search import continuous_matrix, nearest_zero
from tonewood.lab.methods.problem import Problem
from tonewood.lab.methods.scheme import Runner, multipliers
from tonewood.lab.newmark import AVERAGE_ACCELERATION, HHT
from tonewood.lab.systems.fabre_academic import problem, subsystems, whole
from tonewood.lab.systems.fabre_forms import proportional_problem

DT = 1 / 400
SCHEMES = [name for name in METHODS if name != "superposition"]


def given(name: str) -> Problem:
    return proportional_problem()[0] if METHODS[name].real else problem()


def plucked(flat: Problem) -> np.ndarray:
    return flat.static(np.ones(len(flat.inputs)))


@pytest.mark.parametrize("name", MAPS)
def test_compiled_method_is_its_step_matrix(name: str) -> None:
    flat = given(name)
    n = 16 if name == "linear_position" else 1000
    runner = Runner(METHODS[name].arrays(flat, DT))
    runner.start(plucked(flat))
    got, fault = runner.run(n)
    forces = np.zeros((n + 1, len(flat.inputs)))
    wanted = MAPS[name](flat, DT).run(forces, plucked(flat).ravel())
    assert fault == -1
    np.testing.assert_allclose(got, wanted, atol=1e-9 * np.abs(wanted).max())


def dense(flat: Problem) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
    """A, B and f(x) of the acceleration constraint."""
    A = sla.block_diag(*flat.A)
    B, C = flat.B.reshape(len(flat.B), -1).T, flat.C.reshape(len(flat.C), -1)
    solve = sla.pinv(C @ A @ B)
    return A, B, lambda x: -solve @ C @ A @ A @ x


def test_interpolated_forces_are_carried_by_the_exponential() -> None:
    flat = problem()
    A, B, force = dense(flat)
    size, m = B.shape
    for degree in (1, 2):
        # moments of the flow with theta^k / k!, from one augmented exponential
        big = np.zeros((size + 3 * m, size + 3 * m))
        big[:size, :size], big[:size, size : size + m] = A * DT, B * DT
        big[size : size + 2 * m, size + m :] = np.eye(2 * m)
        full = sla.expm(big)[:size]
        E = full[:, :size]
        moment = [full[:, size + k * m : size + (k + 1) * m] for k in range(3)]
        x = plucked(flat).ravel()
        rate = forms.general(flat)
        # the motion before time 0, by the exact flow of the constrained system
        real = A - B @ sla.pinv(flat.C.reshape(m, -1) @ A @ B) @ flat.C.reshape(m, -1) @ A @ A
        assert np.max(np.abs(np.sort(np.abs(sla.eigvals(real))) - np.sort(np.abs(sla.eigvals(rate.F))))) < 1e-6
        past = [force(x - k * DT * real @ x + (k * DT) ** 2 / 2 * real @ real @ x) for k in (1, 2)]
        wanted = [flat.out.reshape(1, -1) @ x]
        for _ in range(50):
            f = force(x)
            first, second = f - past[0], f - 2 * past[0] + past[1]
            x = E @ x + moment[0] @ f + moment[1] @ first
            if degree == 2:
                x = x + (moment[2] + 0.5 * moment[1]) @ second
            past = [f, past[0]]
            wanted.append(flat.out.reshape(1, -1) @ x)
        runner = Runner(METHODS[f"p{degree}"].arrays(flat, DT))
        runner.start(plucked(flat))
        np.testing.assert_allclose(runner.run(50)[0], wanted, atol=1e-11 * np.abs(wanted).max())


def test_quadratures_evaluate_forces_at_their_nodes() -> None:
    flat = problem()
    A, B, force = dense(flat)
    E, out = sla.expm(A * DT), flat.out.reshape(1, -1)
    gain = -force(B[:, 0])[0]  # of the force by its own kick

    def kicked(x: np.ndarray, weight: float) -> tuple[np.ndarray, np.ndarray]:
        f = force(x) / (1 + weight * gain)
        return x + weight * B @ f, f

    x = plucked(flat).ravel()
    f, wanted = force(x), [out @ x]
    for _ in range(60):
        x, f = kicked(E @ (x + DT / 2 * B @ f), DT / 2)
        np.testing.assert_allclose(f, force(x), rtol=1e-9)
        wanted.append(out @ x)
    runner = Runner(METHODS["trapezoidal"].arrays(flat, DT))
    runner.start(plucked(flat))
    np.testing.assert_allclose(runner.run(60)[0], wanted, atol=1e-11 * np.abs(wanted).max())

    x = plucked(flat).ravel()
    f, wanted = force(x), [out @ x]
    for _ in range(30):
        middle, f_middle = kicked(E @ (x + DT / 2 * B @ f), DT / 2)
        wanted.append(out @ middle)
        x, f = kicked(E @ E @ (x + DT / 3 * B @ f) + 4 * DT / 3 * E @ B @ f_middle, DT / 3)
        wanted.append(out @ x)
    runner = Runner(METHODS["simpson"].arrays(flat, DT))
    runner.start(plucked(flat))
    np.testing.assert_allclose(runner.run(60)[0], wanted, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize(("name", "method"), [("newmark", AVERAGE_ACCELERATION), ("hht", HHT)])
def test_newmark_is_newmark_on_the_system_without_its_constraint(name: str, method: object) -> None:
    flat = given(name)
    m = flat.real
    N = sla.null_space(m.gaps)
    reduced = Matrices(N.T @ N, N.T @ np.diag(2 * m.sigma) @ N, N.T @ np.diag(m.omega2) @ N)
    x = plucked(flat)
    q = np.einsum("nij,nj->ni", m.read, x)[:, 0]
    motion, _ = method.run(reduced, DT, 501, (N.T @ q, np.zeros(N.shape[1])))  # type: ignore[attr-defined]  # of both methods
    wanted = motion @ (m.outs @ N).T
    runner = Runner(METHODS[name].arrays(flat, DT))
    runner.start(x)
    np.testing.assert_allclose(runner.run(500)[0], wanted, atol=1e-10 * np.abs(wanted).max())


@pytest.mark.parametrize("name", MAPS)
def test_poles_of_a_method_are_the_eigenvalues_of_its_step(name: str) -> None:
    flat = given(name)
    step = MAPS[name](flat, DT)
    known = step.poles()
    true = poles(whole(subsystems())) if name != "verlet" else poles(proportional_problem()[1])
    for pole in METHODS[name].arrays(flat, DT).poles(true[true.imag > 0]):
        assert np.min(np.abs(known - pole)) < 1e-9 * abs(pole)


@pytest.mark.parametrize("name", MAPS)
def test_multipliers_of_the_loop_are_those_of_the_step_matrix(name: str) -> None:
    flat = given(name)
    ours = np.sort(np.abs(multipliers(METHODS[name].arrays(flat, DT))))
    # the loop may keep numbers that no step needs; those of the matrix that are not near 0 are all there
    theirs = np.sort(np.abs(MAPS[name](flat, DT).multipliers()))
    theirs = theirs[theirs > 1e-3]
    np.testing.assert_allclose(ours[-len(theirs) :], theirs, rtol=1e-5)


@pytest.mark.parametrize("name", ["p1", "p2", "trapezoidal", "simpson", "newmark", "hht"])
def test_a_pole_of_a_method_is_a_motion_of_it(name: str) -> None:
    """Samples two steps apart of a decayed motion obey the recurrence of the two slowest poles that are left."""
    flat = given(name)
    true = poles(proportional_problem()[1] if METHODS[name].real else whole(subsystems()))
    true = true[true.imag > 0]
    found = METHODS[name].arrays(flat, DT).poles(true)
    runner = Runner(METHODS[name].arrays(flat, DT))
    runner.start(plucked(flat))
    y = runner.run(6000)[0][::2, 0]
    keep = np.concatenate([found, found.conj()])
    # a linear recurrence with all physical poles annihilates the motion; parasitic ones decay at once
    recurrence = np.poly(np.exp(keep * 2 * DT)).real
    rest = np.convolve(y, recurrence, "valid")
    scale = np.convolve(np.abs(y), np.abs(recurrence), "valid")
    assert np.all(np.abs(rest[20:]) < 1e-9 * scale[20:])


@pytest.mark.parametrize("name", SCHEMES)
def test_every_method_converges_to_the_true_poles(name: str) -> None:
    """A shorter step brings poles nearer, by about the stated order."""
    flat = given(name)
    true = poles(proportional_problem()[1] if METHODS[name].real else whole(subsystems()))
    true = true[true.imag > 0]
    coarse, fine = (np.max(np.abs(METHODS[name].arrays(flat, dt).poles(true) - true)) for dt in (1 / 400, 1 / 800))
    assert np.log2(coarse / fine) > METHODS[name].order - 0.35


def test_forces_reported_by_a_real_start_hold_the_gap() -> None:
    flat = problem()
    runner = Runner(METHODS["held_position"].arrays(flat, DT))
    runner.start(plucked(flat))
    runner.run(500)
    gap = np.einsum("mnx,nx->m", flat.C, runner.x)
    assert np.all(np.abs(gap) < 1e-13 * np.abs(runner.x).max() * np.abs(flat.C).sum())


def test_exact_motion_is_the_exponential_of_the_assembled_system() -> None:
    given, system = proportional_problem()
    flat = given
    x = plucked(flat)
    motion = ExactMotion.of(flat, x)
    true = poles(system)
    for pole in motion.poles[np.abs(motion.poles) > 1e-3]:
        assert np.min(np.abs(true - complex(pole.real, abs(pole.imag)))) < 1e-9 * abs(pole)
    fine = FineMotion(flat, x, 2.0, 25600)
    np.testing.assert_allclose(
        motion.displacement(400, 800)[1:], fine.displacement(400, 800)[1:], atol=1e-6 * np.abs(x).max()
    )
    assert fine.convergence < 1e-6


def test_superposition_basis_makes_the_same_motion() -> None:
    flat = problem()
    motion = ExactMotion.of(flat, plucked(flat))
    basis = motion.basis()
    t = np.arange(200) / 400
    y = 2 * (np.exp(np.outer(t, basis.poles)) @ basis.right[0]).real
    np.testing.assert_allclose(y, motion.displacement(400, 200)[:, 0], atol=1e-9 * np.abs(y).max())


def test_energy_is_that_of_the_assembled_matrices() -> None:
    given, _ = proportional_problem()
    flat = given
    x = np.random.default_rng(3).standard_normal((flat.n_modes, 2))
    m = flat.real
    q, v = np.einsum("nij,nj->ni", m.read, x).T
    assert flat.energy(x) == pytest.approx(0.5 * float(v @ v + m.omega2 @ q**2), rel=1e-12)


def test_nearest_zero_of_a_known_matrix() -> None:
    roots = np.array([-1 + 10j, -2 + 11j])

    def matrix(s: complex) -> np.ndarray:
        turn = np.array([[1.0, 0.4], [-0.3, 1.0]])
        return turn @ np.diag(s - roots) @ sla.inv(turn)

    assert abs(nearest_zero(matrix, -1.2 + 10.1j) - roots[0]) < 1e-10
    # the null vector of the second root is large at the second place
    assert abs(nearest_zero(matrix, -1.4 + 10.4j, joint=1, reach=0.5) - roots[1]) < 1e-10


def test_continuous_matrix_is_singular_at_the_poles_of_the_whole() -> None:
    matrix = continuous_matrix(problem())
    for pole in poles(whole(subsystems())):
        assert abs(matrix(complex(pole))[0, 0]) < 1e-9 * abs(matrix(complex(pole) * 1.1)[0, 0])
