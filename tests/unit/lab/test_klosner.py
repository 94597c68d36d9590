"""Klosner & Ranlet's problems: both forms against the physical systems put together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.lab.component_modes import fixed_base_modes, free_free_modes
from tonewood.lab.klosner_forms import MainStructure, fixed_base_form, free_free_form
from tonewood.lab.systems.klosner import (
    DT,
    FORMS,
    coupled_frequencies,
    energy_drift,
    exact_frequencies,
    measured_order,
    plots,
    rows,
)
from tonewood.lab.systems.klosner_modes import MOUNTINGS, chain_matrices, errors, modes_needed
from tonewood.lab.systems.klosner_problems import (
    Motion,
    assembled,
    by_form,
    difference,
    loaded,
    problem_a,
    problem_b,
    problem_c,
    problem_d,
    spring_mounting,
)


@pytest.mark.parametrize("make", [problem_a, problem_b, problem_c])
@pytest.mark.parametrize("form", FORMS)
def test_equations_and_components_move_like_the_assembled_system(make: object, form: str) -> None:
    problem = replace(loaded(make()), duration=0.4)  # type: ignore[operator] # parametrized makers
    reference = assembled(problem, DT, 160)
    motion = by_form(problem, form, DT, 160)
    assert difference(reference, motion) < 1e-9
    np.testing.assert_allclose(motion.force, reference.force, atol=1e-8 * np.abs(reference.force).max())
    order, error = measured_order(problem, form, reference)
    assert order == pytest.approx(2.0, abs=0.05)
    assert error < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_stiff_and_soft_mountings_of_the_beam(form: str) -> None:
    for law in (spring_mounting(3.0, 2000.0, 0.05, 5.0), spring_mounting(1.5e4, 1e7, 1.0, 0.0)):
        problem = replace(problem_d(law, elements=2), duration=0.15)
        reference = assembled(problem, DT, 60)
        assert difference(reference, by_form(problem, form, DT, 60)) < 1e-8
        order, _ = measured_order(problem, form, reference, refinements=4)
        assert order == pytest.approx(2.0, abs=0.1)


def test_energy_is_kept_by_a_lossless_mounting() -> None:
    assert energy_drift("free-free", steps=600) < 1e-11


def test_beam_and_chain_have_the_frequencies_of_the_closed_form() -> None:
    exact = exact_frequencies(4)
    coarse, fine = (coupled_frequencies("fixed-base", n, 4) for n in (20, 80))
    np.testing.assert_allclose(fine, exact, rtol=1e-6)
    assert np.all(np.abs(fine - exact) < np.abs(coarse - exact))
    np.testing.assert_allclose(coupled_frequencies("free-free", 80, 4), fine, rtol=1e-7)


def test_interface_with_mass_is_coupled_through_accelerations() -> None:
    """No massless mode: the free-free form finds its force from the second derivative of the constraint."""
    main = MainStructure(np.array([9.0, 21.0]), np.array([[0.7, -0.4]]), np.array([0.7, -0.4]))
    M = np.diag([0.2, 0.5, 0.3])
    K = 50 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    fixed = fixed_base_form(main, fixed_base_modes(M, K, [0]))
    free = free_free_form(main, free_free_modes(M, K), np.array([0]))
    # the free-free form has one coordinate to spare: its constraint holds as a pair of poles at 0
    expected = sorted(np.abs(sla.eigvals(fixed.A)))
    found = sorted(np.abs(sla.eigvals(free.A)))
    np.testing.assert_allclose(found[2:], expected, rtol=1e-7)
    assert max(found[:2]) < 1e-5
    np.testing.assert_allclose(
        sorted(np.abs(sla.eigvals(fixed_base_form(main, fixed_base_modes(M, K, [0]), as_printed=False).A))),
        expected,
        rtol=1e-10,
    )


def test_equation_16_as_printed_needs_a_complete_set_of_modes() -> None:
    M, K = chain_matrices()
    main = MainStructure(np.array([20.0]), np.ones((1, 1)), np.ones(1))

    def lowest(n_modes: int, as_printed: bool) -> float:
        form = fixed_base_form(main, fixed_base_modes(M, K, [0], n_modes), as_printed=as_printed)
        return float(np.min(np.abs(sla.eigvals(form.A))))

    exact = lowest(23, False)
    assert lowest(23, True) == pytest.approx(exact, rel=1e-10)
    assert abs(lowest(4, True) / exact - 1) > 100 * abs(lowest(4, False) / exact - 1)


def test_modes_needed_follow_the_report() -> None:
    need = {(n.mounting, n.way): n.modes for n in modes_needed((1e-2,))}
    assert need["stiff", "fixed-base"] < need["stiff", "free-free"] / 2
    assert need["soft", "free-free"] <= need["soft", "fixed-base"]
    for mounting in MOUNTINGS:
        assert need[mounting, "free-free with residual"] <= need[mounting, "free-free"]
        assert errors(mounting, "fixed-base")[-1].max() < 1e-8


def test_printed_modes_are_found() -> None:
    count = 0
    for row in rows():
        if "equations" in row.quantity or "components" in row.quantity:
            break
        count += 1
        assert row.passed, row
    assert count >= 17


@pytest.mark.validate
def test_every_row_passes() -> None:
    failed = [row for row in rows() if not row.passed]
    assert not failed


@pytest.mark.validate
def test_plots(tmp_path: object) -> None:
    for path in plots(tmp_path):  # type: ignore[arg-type] # pytest's path is a pathlib.Path
        assert path.stat().st_size > 10_000


def test_a_difference_is_the_largest_re_the_largest_displacement():
    one = Motion(np.array([0.0, 2.0, -1.0]), np.array([[0.0, 0.0], [1.0, -4.0], [0.0, 0.0]]), np.zeros(3))
    other = Motion(np.add(one.main, [0.0, 0.1, -0.2]), np.add(one.sub, [[0, 0], [0.3, 0], [0, -0.8]]), np.zeros(3))
    assert difference(one, other) == pytest.approx(0.8 / 4)
    assert difference(one, other, [0]) == pytest.approx(0.3 / 4)
    assert difference(one, one) == 0.0
    assert difference(one, other, []) == pytest.approx(0.2 / 4)
