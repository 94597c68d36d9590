"""Chinnakonda's systems and the methods beside the updates, against closed forms and matrix exponentials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tonewood.errors import NumericalError
from tonewood.lab.assembled import Matrices, free_motion
from tonewood.lab.estimates import harmonic_error, kernels, sine_error
from tonewood.lab.interpolatory import P0, P1, P2, SIMPSON, TRAPEZOIDAL, UPDATES, interpolatory, lagrange, respond
from tonewood.lab.newmark import AVERAGE_ACCELERATION, HHT, hht
from tonewood.lab.nonproportionality import commutator, coupling, imaginary_part, reduced
from tonewood.lab.pseudo_load import PseudoLoad
from tonewood.lab.systems.chinnakonda import _alternatives, plots, reduction_table, rows
from tonewood.lab.systems.chinnakonda_problems import (
    AMPLITUDES,
    FORCES,
    HEAVY,
    LIGHT,
    OMEGA,
    STIFF_DAMPING,
    STIFF_START,
    basis_of,
    damped_chain,
    driven_error,
    sampled_forces,
    stiff_system,
    two_masses,
    two_step,
)
from tonewood.lab.transition import Transition
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices, initial_state


def _one_pole(pole: complex) -> ModalBasis:
    return ModalBasis.complex([pole], {"p": [1.0]}, {"p": [1.0]})


@pytest.mark.parametrize("pole", [-0.7 + 5.0j, -8.0, -1e-9 + 1e-6j, -300.0 + 1.0j])
def test_weights_are_those_of_the_thesis(pole: complex) -> None:
    """Eqs. 2.19, 2.20, 2.22 and 2.23, with lambda of the thesis = -pole; compared where those do not cancel."""
    h = 0.3
    lam = -pole
    b, E = lam * h, np.exp(-lam * h)
    printed = {
        P0: (h, [(1 - E) / lam]),
        P1: (h, [(1 / b - E * (1 + 1 / b)) / lam, (1 - (1 - E) / b) / lam]),
        P2: (
            2 * h,
            [
                -((2 * b**2 + 3 * b + 2) * E**2 + b - 2) / (2 * lam * b**2),
                2 * ((b + 1) * E**2 + b - 1) / (lam * b**2),
                (2 * b**2 - 3 * b + 2 - (b + 2) * E**2) / (2 * lam * b**2),
            ],
        ),
        TRAPEZOIDAL: (h, [h / 2 * E, h / 2]),
        SIMPSON: (2 * h, [h / 3 * E**2, 4 * h / 3 * E, h / 3]),
    }
    rounding = 1e-14 * max(1.0, abs(b) ** -3)
    for update, (step, expected) in printed.items():
        nodes = update.nodes(np.linspace(0, step, update.span + 1)) / step
        W = update.weights(_one_pole(pole), step, nodes)
        found = W[:, 0, 0, 0] + 1j * W[:, 0, 1, 0]
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=rounding * step)


def test_lagrange_polynomials() -> None:
    nodes = np.array([0.0, 0.2, 0.7, 1.0])
    values = lagrange(nodes) @ np.vander(nodes, increasing=True).T
    np.testing.assert_allclose(values, np.eye(4), atol=1e-13)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_polynomial_loads_up_to_the_degree_are_exact(degree: int) -> None:
    basis = _one_pole(-0.5 + 3.0j)
    found = respond(
        interpolatory(degree), basis, {"p": lambda t: t**degree}, np.linspace(0, 1.2, 12 * degree + 1) ** 1.5
    )
    # 2 Re int_0^t s^p exp(lambda (t - s)) ds, by the series of exp
    t, lam = found.times[-1], -0.5 + 3.0j
    term, total = t ** (degree + 1) / (degree + 1) + 0j, 0j
    for k in range(1, 80):
        total += term
        term *= lam * t / (degree + 1 + k)
    assert found.displacement[-1, 0] == pytest.approx(2 * total.real, rel=1e-12)


@pytest.mark.parametrize("c", [LIGHT, HEAVY])
def test_free_motion_is_exact_to_rounding(c: float) -> None:
    system, start = two_masses(c), np.array([1.0, -1.0])
    exact = free_motion(system, start, [0.3, 0.0], 0.05, 121)[:, :2]
    basis = basis_of(system)
    state = initial_state(basis, system.M, system.C, start, [0.3, 0.0])
    for update in UPDATES:
        found = respond(update, basis, {}, np.arange(121) * 0.05, state).displacement
        np.testing.assert_allclose(found, exact[:: update.span][: len(found)], atol=1e-13)


def test_sample_times_must_rise() -> None:
    with pytest.raises(ValueError, match="rise"):
        respond(P1, _one_pole(-1.0), {}, [0.0, 1.0, 1.0])


@pytest.mark.parametrize("update", [P1, P2, interpolatory(3)], ids=lambda u: u.name)
@pytest.mark.parametrize("c", [LIGHT, HEAVY])
def test_estimated_errors_are_the_measured_ones(update: object, c: float) -> None:
    for steps, tolerance in ((20, 0.02), (40, 0.005)):
        times, error, _ = driven_error(update, c, steps)  # type: ignore[arg-type]  # any update
        estimate = sine_error(update, basis_of(two_masses(c)), AMPLITUDES, OMEGA, 1 / 1.5 / steps, len(times), "mass 1")  # type: ignore[arg-type]  # any update
        assert np.abs(estimate - error[:, 0]).max() < tolerance * np.abs(error[:, 0]).max()


def test_kernels_have_their_limits() -> None:
    k1, k2 = kernels(2, np.array([1e-4 + 0j, -1e4 + 0j]))
    assert k1[0] == pytest.approx(1e-4 / 120, rel=1e-3)
    assert k2[0] == pytest.approx(-1 / 120, rel=1e-3)
    assert k1[1] == pytest.approx(-0.5e-8, rel=1e-3)
    assert kernels(1, np.array([0j]))[0][0] == pytest.approx(-1 / 6)
    with pytest.raises(ValueError, match="weighted"):
        harmonic_error(TRAPEZOIDAL, np.array([-1 + 1j]), 1.0, 0.1, 3)


def test_order_between_light_and_extreme_damping() -> None:
    """Second order where lambda h is large, the fourth where it is small: it looks like the third in between."""
    pole, omega = np.array([-1000.0 + 0j]), 9.0
    slopes = []
    for h in (1e-1, 3e-3, 1e-5):
        coarse, fine = (np.abs(harmonic_error(P2, pole, omega, x, round(2 / x))).max() for x in (h, h / 2))
        slopes.append(np.log2(coarse / fine))
    assert slopes[0] == pytest.approx(2.0, abs=0.1)
    assert 2.3 < slopes[1] < 3.7
    assert slopes[2] == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("c", [LIGHT, HEAVY])
def test_picard_finds_the_one_shot_solution(c: float) -> None:
    split = PseudoLoad.of(two_masses(c))
    forces = sampled_forces(np.arange(121) / 30)
    start = (np.array([0.1, -0.2]), np.array([1.0, 0.0]))
    once = split.one_shot(forces, 1 / 30, start)
    np.testing.assert_allclose(once[0], start[0], atol=1e-14)
    counts = []
    for window in (1, 8, 40):
        again, count = split.picard(forces, 1 / 30, start, window=window)
        np.testing.assert_allclose(again, once, atol=1e-13)
        counts.append(count)
    assert counts == sorted(counts)


def test_picard_tells_when_it_does_not_converge() -> None:
    with pytest.raises(NumericalError, match="Picard"):
        PseudoLoad.of(two_masses(HEAVY)).picard(sampled_forces(np.arange(91) / 30), 1 / 30, window=90, max_iterations=9)


def test_pseudo_load_is_exact_for_proportional_damping() -> None:
    K = two_masses(1.0).K
    system = Matrices(np.eye(2), 0.02 * K, K)
    times = np.arange(61) / 30
    forces = sampled_forces(times)
    line = respond(P1, basis_of(system), FORCES, times)
    np.testing.assert_allclose(PseudoLoad.of(system).one_shot(forces, 1 / 30), line.displacement, atol=1e-13)


@pytest.mark.parametrize("update", [P0, P1, P2, interpolatory(4, within=True)], ids=lambda u: u.name)
def test_transition_matrix_is_the_same_update(update: object) -> None:
    system = two_masses(HEAVY)
    x0 = np.array([1.0, 0.5, -2.0, 0.0])
    dense = Transition.of(system, update, 0.04)  # type: ignore[arg-type]  # any update
    found = dense.run(sampled_forces, 61, x0)[:, :2]
    basis = basis_of(system)
    state = initial_state(basis, system.M, system.C, x0[:2], x0[2:])
    modal = respond(update, basis, FORCES, np.arange(61) * 0.04, state).displacement  # type: ignore[arg-type]  # any update
    np.testing.assert_allclose(found, modal, atol=1e-13)


def test_two_step_reduction_rejects_the_spurious_mode() -> None:
    for proportional, c in STIFF_DAMPING.items():
        system = stiff_system(c, proportional=proportional)
        t = np.arange(101) / 20
        exact = free_motion(system, STIFF_START, [0.0, 0.0], 1 / 20, 101)[:, :2]
        small = two_step(system, 1, t, STIFF_START).displacement
        direct, _ = HHT.run(system, 1 / 20, 101, (STIFF_START, np.zeros(2)))
        assert np.abs(small[:, 0]).max() < 2e-3
        assert np.abs(small - exact)[:, 1].max() < 0.1 * np.abs(direct - exact)[:, 1].max()
        # HHT-alpha needs several steps to be rid of it
        assert np.abs(direct[1:5, 0]).max() > 0.1
        assert np.abs(direct[20:, 0]).max() < 0.02
        both = two_step(system, 2, t, STIFF_START).displacement
        np.testing.assert_allclose(both, exact, atol=1e-10)


def test_newmark_steps_balance_the_equation_of_motion(rng: np.random.Generator) -> None:
    system = Matrices(np.diag([1.0, 2.0]), np.array([[0.3, -0.1], [-0.1, 0.2]]), np.array([[5.0, -2.0], [-2.0, 3.0]]))
    h, a = 0.2, HHT.alpha
    T, p = HHT.step_matrix(system, h)
    x, F = rng.normal(size=6), rng.normal(size=2)
    y = T @ x + p @ F
    (u, v, acc), (u1, v1, acc1) = ((z[:2], z[2:4] / h, z[4:] / h**2) for z in (x, y))
    balance = system.M @ acc1 + (1 + a) * (system.C @ v1 + system.K @ u1) - a * (system.C @ v + system.K @ u)
    np.testing.assert_allclose(balance, F, atol=1e-12)
    np.testing.assert_allclose(u1, u + h * v + h**2 * ((0.5 - HHT.beta) * acc + HHT.beta * acc1), atol=1e-12)
    np.testing.assert_allclose(v1, v + h * ((1 - HHT.gamma) * acc + HHT.gamma * acc1), atol=1e-12)


def test_average_acceleration_keeps_energy() -> None:
    system = two_masses(0.0)
    u, v = AVERAGE_ACCELERATION.run(system, 0.1, 200, (np.array([1.0, -0.3]), np.zeros(2)))
    energy = 0.5 * np.sum(v**2, axis=1) + 0.5 * np.einsum("ni,ij,nj->n", u, system.K, u)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)


def test_hht_parameter_is_bounded() -> None:
    with pytest.raises(ValueError, match="alpha from -1/3 to 0"):
        hht(-0.5)


def test_indices_vanish_for_proportional_damping_and_grow_with_it() -> None:
    K = two_masses(1.0).K
    for C in (0.02 * K, 0.3 * np.eye(2), 0.1 * np.eye(2) + 0.01 * K):
        system = Matrices(np.eye(2), C, K)
        assert coupling(system) < 1e-14
        assert commutator(system) < 1e-15
        assert imaginary_part(basis_of(system)).max() < 1e-12
    parts = [imaginary_part(basis_of(two_masses(c))).max() for c in (0.01, 0.1, 0.5)]
    assert parts == sorted(parts)


def test_the_chain_has_the_frequencies_of_a_chain_between_walls() -> None:
    """w_j = 2 sqrt(k / m) sin(j pi / (2 (n + 1))); its dashpot takes 20 N s/m times the third speed squared."""
    chain, n = damped_chain(), 12
    assert np.array_equal(chain.K, chain.K.T)
    expected = 2 * np.sqrt(1000.0) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    np.testing.assert_allclose(np.sqrt(np.linalg.eigvalsh(chain.K)), expected, rtol=1e-12)
    speed = np.arange(1.0, n + 1)
    assert speed @ chain.C @ speed == pytest.approx(20.0 * 3.0**2)


def test_reduction_changes_the_indices() -> None:
    table = reduction_table()
    assert max(table[1].values()) < 1e-14
    values = [table[n]["coupling"] for n in sorted(table)]
    assert values == sorted(values)
    whole = two_masses(0.4)
    np.testing.assert_allclose(
        basis_from_matrices(*reduced(whole, 2), ["a", "b"]).poles, basis_of(whole).poles, rtol=1e-12
    )


@pytest.mark.validate
def test_every_row_passes() -> None:
    failed = [row for row in rows() if not row.passed]
    assert not failed


@pytest.mark.validate
def test_plots(tmp_path: Path) -> None:
    for path in plots(tmp_path):
        assert path.stat().st_size > 10_000


@pytest.mark.slow
def test_a_difference_of_one_sample_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows tell the largest difference over time: 1 um in one sample of one of the two solutions is told as such."""
    run = Transition.run

    def disturbed(self: Transition, *arguments: Any) -> Any:
        out = np.array(run(self, *arguments))
        out[150, 1] += 1e-6
        return out

    monkeypatch.setattr(Transition, "run", disturbed)
    rows = [row for row in _alternatives() if row.system.endswith("transition")]
    assert [row.value for row in rows] == [pytest.approx(1e-6, rel=1e-5)] * 6
