"""Tables, figures, lists of poles, points, lumps and frets of small examples, worked out here."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.physics.modal import views
from tonewood.physics.modal.conjugates import conjugate_weights, extend, halve, real_form
from tonewood.physics.modal.damper import damper_rates
from tonewood.physics.modal.fretted import FretboardGeometry, FrettedString, compensated
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.modal.loaded import at_first_points, loaded, with_masses
from tonewood.physics.modal.mobility import balanced, port_directions, port_scale, smallest_hermitian, step_gain
from tonewood.physics.modal.modes import BLOCK, PAIR, REAL, ModalBasis
from tonewood.physics.modal.partial_decays import string_detuned, with_partial_decays
from tonewood.physics.modal.points import below, damped, moved, spread, with_points, with_still_points
from tonewood.physics.modal.secular import secular_roots
from tonewood.physics.modal.string_modes import loss_rates, string_basis, wavenumber
from tonewood.physics.modal.string_transfer import string_carry, string_transfer

OMEGA, SIGMA = 2 * np.pi * np.array([300.0, 100.0, 200.0]), np.array([3.0, 0.0, 2.0])


def body(**options) -> ModalBasis:
    return ModalBasis.real(OMEGA, SIGMA, {"p": [1.0, 2.0, -3.0], "q": [0.5, -1.0, 4.0]}, modal_mass=0.25, **options)


def test_table_of_modes_is_by_frequency():
    """Q = omega / 2 sigma, T60 = ln 1000 / sigma, residues phi^2 / m."""
    table = body().modes()
    expected = {
        "freq": [100.0, 200.0, 300.0], "q": [np.inf, 100 * np.pi, 100 * np.pi],
        "t60": [np.inf, np.log(1000) / 2, np.log(1000) / 3],
        "residue_p": [16.0, 36.0, 4.0], "residue_q": [4.0, 64.0, 1.0],
    }  # fmt: skip
    assert list(table) == list(expected)
    for name, column in expected.items():
        assert list(table[name]) == pytest.approx(column), name


@pytest.fixture
def drawn(monkeypatch):
    calls = []
    for name in ("mobility_figure", "points_figure"):
        monkeypatch.setattr(views, name, lambda *args, **options: calls.append((args, options)))
    return calls


def test_figures_of_modes_show_their_numbers(drawn):
    basis = body()
    basis.plot_modes()
    basis.plot_decay()
    ((freq, rows), options), ((at, decay), _) = drawn
    assert (freq.tolist(), at.tolist()) == ([pytest.approx(f) for f in OMEGA / (2 * np.pi)],) * 2
    assert list(rows) == ["Q", "residue, 1/kg"]
    np.testing.assert_allclose(rows["Q"], [100 * np.pi, np.inf, 100 * np.pi])
    np.testing.assert_allclose(rows["residue, 1/kg"], [4.0, 16.0, 64.0])
    np.testing.assert_allclose(decay["T60, s"], [np.log(1000) / 3, np.inf, np.log(1000) / 2])
    assert options == {"heading": ""}


@pytest.mark.parametrize(
    ("freq", "low", "high"),
    [([100.0, 200.0], 50.0, 300.0), ([0.0, 40.0], 20.0, 60.0), ([100.0, 19000.0], 50.0, 2e4), ([0.0], 20.0, 2e4)],
)
def test_figure_of_a_mobility_spans_the_modes(drawn, freq, low, high):
    n = len(freq)
    basis = ModalBasis.real(2 * np.pi * np.array(freq), np.full(n, 3.0), {"p": np.ones(n), "q": np.full(n, 2.0)})
    basis.plot_mobility()
    basis.plot_mobility("q")
    ((at, curves), options), ((_, one), _) = drawn
    assert (at[0], at[-1], options["of"]) == (pytest.approx(low), pytest.approx(high), "at")
    within = [f for f in freq if 0 < f <= high]
    assert len(at) == 3000 + len(within)
    assert all(np.abs(at - f).min() < 1e-9 for f in within)
    assert np.all(np.diff(at) > 0)
    assert (list(curves), list(one)) == (["p", "q"], ["q"])
    for name, curve in curves.items():
        np.testing.assert_array_equal(curve, basis.frf(at, name, name))


@pytest.mark.parametrize(("count", "shown"), [(6, 6), (7, 4), (12, 6), (13, 5)])
def test_figure_of_a_mobility_shows_six_points_at_most(drawn, count, shown):
    ModalBasis.real([500.0], [1.0], {f"p{i}": [1.0] for i in range(count)}).plot_mobility()
    names = list(drawn[0][0][1])
    assert len(names) == shown
    step = -(-count // 6)
    assert names == [f"p{i}" for i in range(0, count, step)]


def test_a_basis_says_what_it_is():
    assert repr(body()) == "ModalBasis(3 real modes, 100 to 300 Hz, points p, q)"
    assert all(f">{text}</td>" in body()._repr_html_() for text in ("3 real", "100 to 300 Hz", "p, q"))
    free = ModalBasis.real([0.0, 0.0, 10.0], [0.0, 2.0, 5.0], {"p": np.ones(3)})
    assert free.damping_ratio.tolist() == [0.0, np.inf, 0.5]


@pytest.mark.parametrize(("zeta", "kind"), [(0.699, PAIR), (0.701, BLOCK), (1.0, BLOCK), (1.5, BLOCK), (-0.1, PAIR)])
def test_kind_and_pole_of_a_second_order_mode(zeta, kind):
    """Poles -zeta omega + sqrt(zeta^2 - 1) omega; above 0.7 both are one block; left shapes are 1 / (2 i omega_d)."""
    basis = ModalBasis.real([50.0], [50.0 * zeta], {"p": [3.0]})
    pole = 50.0 * (-zeta + np.sqrt(complex(zeta**2 - 1)))
    assert basis.kind.tolist() == [kind]
    assert basis.poles[0] == pytest.approx(complex(pole.real, abs(pole.imag)))
    assert basis.left[0, 0] == pytest.approx(3.0 / (2j * pole.imag) if kind == PAIR else 3.0)
    assert basis.residues("p") == pytest.approx([9.0])
    assert (basis.stiffness[0], basis.damping_rate[0]) == (pytest.approx(2500.0), pytest.approx(50 * zeta))


def test_points_may_be_places_or_shapes_of_their_own() -> None:
    basis = ModalBasis.real(
        [50.0, 70.0], [1.0, 2.0], {"at": 0.5, "own": [3.0, -1.0]}, modal_mass=[4.0, 0.25],
        shape=lambda x: np.array([1.0 + x, 2.0 * x]),
    )  # fmt: skip
    np.testing.assert_allclose(basis.right, [[0.75, 2.0], [1.5, -2.0]])
    assert basis.places == {"at": 0.5}
    assert basis.shape(2.0).tolist() == [1.5, 8.0]


def mixed() -> ModalBasis:
    """A pair, a real pole and a block that reads both of its numbers."""
    pair = ModalBasis.complex([-3 + 40j, -20.0], {"p": [1 + 0.5j, 2.0], "q": [0.3 - 1j, 0.7]})
    return replace(
        pair,
        poles=np.append(pair.poles, -5.0),
        kind=np.append(pair.kind, BLOCK).astype(np.uint8),
        stiffness=np.append(pair.stiffness, 30.0),
        damping_rate=np.append(pair.damping_rate, 6.0),
        right=np.hstack([pair.right, [[2 + 3j], [0.5 - 1j]]]),
        left=np.hstack([pair.left, [[0.4 - 2j], [1 + 0.2j]]]),
        residual=np.array([[1e-3, 2e-3], [2e-3, 4e-3]]),
    )


def test_responses_of_every_kind_of_mode_are_their_equations():
    """q' = p + Im(l) f, p' = -k q - 2 sigma p + Re(l) f, y = Re(r) q + Im(r) p of a block."""
    basis = mixed()
    freq = np.array([0.3, 7.0])
    for out in (0, 1):
        for into in (0, 1):
            expected = []
            for s in 2j * np.pi * freq:
                r, ell, lam = basis.right[out], basis.left[into], basis.poles
                y = r[0] * ell[0] / (s - lam[0]) + np.conj(r[0] * ell[0]) / (s - np.conj(lam[0]))
                y += r[1] * ell[1] / (s - lam[1]) + basis.residual[out, into]
                A, f = np.array([[s, -1.0], [30.0, s + 12.0]]), [ell[2].imag, ell[2].real]
                expected.append(s**2 * (y + np.array([r[2].real, r[2].imag]) @ sla.solve(A, f)))
            got = basis.frf(freq, "pq"[out], "pq"[into], "accelerance")
            np.testing.assert_allclose(got, expected, rtol=1e-11)
    static = np.array([[basis.frf([0.0], i, j, "receptance")[0].real for j in "pq"] for i in "pq"])
    np.testing.assert_allclose(basis.static_compliance(), 0.5 * (static + static.T), rtol=1e-12)
    assert basis.residues("p")[0] == pytest.approx(abs(basis.right[0, 0] * basis.left[0, 0]) * 80)
    only = [basis.static_of(np.arange(3) == k) for k in range(3)]
    np.testing.assert_allclose(sum(only) + basis.residual, basis.static_compliance(), rtol=1e-12)
    assert (basis.index("q"), basis.natural_freq[2]) == (1, pytest.approx(np.sqrt(30) / (2 * np.pi)))
    with pytest.raises(ValueError, match="rigid-body"):
        replace(basis, stiffness=basis.stiffness * [1, 1, 0]).static_compliance()


def test_arrays_that_do_not_fit_a_basis_are_refused():
    basis = mixed()
    for change in ({"right": basis.right[:, :2]}, {"residual": np.eye(3)}, {"kind": basis.kind[:2]},
                   {"damping_rate": np.ones(4)}, {"left": basis.left[:1]}, {"stiffness": np.ones(2)}):  # fmt: skip
        with pytest.raises(ValueError, match="do not fit together"):
            replace(basis, **change)
    with pytest.raises(ValueError, match="same name"):
        replace(basis, points=("p", "p"))


def test_half_and_full_lists_of_poles():
    poles = np.array([-1 + 5j, -3.0, -2 + 7j])
    right, left = np.array([[1 + 1j, 2.0, 3j]]), np.array([[2.0, 1.0, 1 - 1j]])
    assert conjugate_weights(poles).tolist() == [2.0, 1.0, 2.0]
    full = extend(poles, right, left)
    np.testing.assert_array_equal(full[0], [-1 + 5j, -3.0, -2 + 7j, -1 - 5j, -2 - 7j])
    np.testing.assert_array_equal(full[1], [[1 + 1j, 2.0, 3j, 1 - 1j, -3j]])
    form = real_form(poles, right, left)
    x = np.array([0.3, 0.5, -0.2, 0.7, 0.1])
    z = form.to_full @ x
    np.testing.assert_allclose(form.to_full.conj().T @ form.to_full, np.eye(5), atol=1e-15)
    np.testing.assert_allclose(z[3:], np.conj(z[[0, 2]]), atol=1e-15)
    np.testing.assert_allclose(form.to_full @ (form.A @ x), full[0] * z, rtol=1e-12)
    np.testing.assert_allclose(form.R @ x, (full[1] @ z).real, rtol=1e-12)
    np.testing.assert_allclose(form.to_full @ form.B[:, 0], full[2][0], rtol=1e-12)
    assert form.D[0, 0] == pytest.approx(2 * ((1 + 1j) * 2).real + 2.0 + 2 * (3j * (1 - 1j)).real)


@pytest.mark.parametrize(
    ("change", "misfit"),
    [
        (lambda p, r, l_: None, 0.0),
        (lambda p, r, l_: r.__setitem__((0, 3), r[0, 3] * 2j) or l_.__setitem__((0, 3), l_[0, 3] / 2j), 0.0),
        (lambda p, r, l_: l_.__setitem__((0, 3), l_[0, 3] * 1.01), 0.01 / 1.01),
        (lambda p, r, l_: p.__setitem__(3, p[3] * (1 + 1e-3)), 1e-3 / 1.001),
        (lambda p, r, l_: p.__setitem__(3, np.conj(p[3])), np.inf),
        (lambda p, r, l_: p.__setitem__(0, np.conj(p[0])), np.inf),
        (lambda p, r, l_: r.__setitem__((0, 1), 2.0 + 0.0j), 0.0),
        (lambda p, r, l_: r.__setitem__((0, 1), 2.0 * np.exp(0.3j)), np.sin(0.3)),
    ],
)
def test_how_far_a_full_list_is_from_closed(change, misfit):
    poles, right, left = extend(np.array([-1 + 5j, -3.0, -2 + 7j]), np.array([[1 + 1j, 2.0, 3j]]), np.ones((1, 3)) + 0j)
    change(poles, right, left)
    half = halve(poles, right, left)
    assert half[3] == pytest.approx(misfit, rel=1e-9, abs=1e-15)
    if misfit < 1:
        np.testing.assert_array_equal(half[0], [-1 + 5j, -3.0, -2 + 7j])
        np.testing.assert_allclose((half[1] * half[2])[0], [1 + 1j, 2.0 * np.cos(0.3 * (misfit > 0.2)), 3j])
        assert not half[1][:, 1].imag.any()


def test_scaling_of_ports():
    assert step_gain(np.array([0.0, -2.0, 3j]), 0.1) == pytest.approx([0.1, np.expm1(-0.2) / -2, np.expm1(0.3j) / 3j])
    r, ell = balanced(np.array([[3.0, 0.0], [4.0, 1.0]]), np.array([[0.0, 0.0], [20.0, 0.0]]))
    np.testing.assert_allclose(r, [[6.0, 0.0], [8.0, 1.0]])
    np.testing.assert_allclose(ell, [[0.0, 0.0], [10.0, 0.0]])
    poles, shapes = np.array([-1 + 10j, -2 + 30j]), np.array([[1.0, 2.0], [0.5, -1.0], [0.0, 0.0]]) + 0j
    scale = port_scale(poles, shapes, -1j * shapes)
    again = port_scale(poles, shapes * [[7.0], [1e-3], [1.0]], -1j * shapes * [[7.0], [1e-3], [1.0]])
    np.testing.assert_allclose(again, scale * [7.0, 1e-3, 1.0], rtol=1e-9)
    assert scale[2] == 1.0
    # of one port and one mode: r l times twice its peak
    assert port_scale(poles[:1], np.array([[2.0 + 0j]]), np.array([[-3j]]))[0] ** 2 == pytest.approx(
        12 * abs(poles[0]), rel=1e-6
    )
    directions, sizes = port_directions(np.array([[3.0], [4.0]]) + 0j, np.array([[0.0], [0.0]]) + 0j)
    assert sizes == pytest.approx([5.0])
    np.testing.assert_allclose(np.abs(directions[:, 0]), [0.6, 0.8])
    assert [a.shape for a in port_directions(np.zeros((2, 0)) + 0j, np.zeros((2, 0)) + 0j)] == [(2, 0), (0,)]
    assert smallest_hermitian(np.array([[1.0, 4.0], [0.0, 1.0]])) == pytest.approx(-1.0)
    assert smallest_hermitian(np.zeros((0, 0))) == 0.0


@pytest.mark.parametrize(("slope", "constant"), [(1.0, 0.7), (2.0, 0.0)])
def test_secular_roots_are_the_eigenvalues_of_an_arrow(slope, constant):
    """(slope y - constant) - sum w / (y - p) = 0: of [[constant, z^T], [z, p]] with z^2 = w, rows scaled by slope."""
    pole, weight = np.array([1.0, 3.0, 4.0]), np.array([0.5, 2.0, 1e-3])
    arrow = np.diag([constant / slope, *pole])
    arrow[0, 1:] = arrow[1:, 0] = np.sqrt(weight / slope)
    expected = np.linalg.eigvalsh(arrow)
    low, high = np.array([-9.0, 1.0, 3.0, 4.0]), np.array([1.0, 3.0, 4.0, 19.0])
    root, distance = secular_roots(pole, weight, low, high, 0.5 * (low + high), slope=slope, constant=constant)
    np.testing.assert_allclose(root, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(distance, root[:, None] - pole, rtol=1e-6)
    # without a straight part: one between every two poles, zeros of the sum
    root, _ = secular_roots(pole, weight, pole[:2], pole[1:], np.array([2.0, 3.5]))
    np.testing.assert_allclose((weight / (root[:, None] - pole)).sum(axis=1), 0.0, atol=1e-9)


LENGTH, TENSION, DENSITY, BENDING = 0.65, 73.9, 3.61e-3, 4e-5


def string(n: int = 12) -> ModalBasis:
    return string_basis(LENGTH, TENSION, DENSITY, BENDING, lambda w, k: 1e-3 + 1e-6 * k, n_modes=n)


def test_points_of_a_string_at_places_at_rest_and_over_a_width():
    basis = string()
    more = with_points(basis, {"a": 0.2, "b": 0.3}, ["c"], {"b": 0.04})
    assert more.points == ("bridge", "a", "b", "c")
    assert not more.right[3].any()
    assert not more.left[3].any()
    assert not more.residual[3].any()
    np.testing.assert_allclose(more.right[1], basis.shape(0.2), rtol=1e-12)
    # Gauss's rule of three places has the mean over the width of a shape to the fifth order
    mean = np.mean([basis.shape(x) for x in 0.28 + 0.04 * (np.arange(2000) + 0.5) / 2000], axis=0)
    np.testing.assert_allclose(more.right[2].real, mean, atol=3e-5 * np.abs(mean).max())
    np.testing.assert_allclose(more.left[2], more.right[2] * -0.5j / more.poles.imag, rtol=1e-12)
    assert with_still_points(basis, []) is basis
    plain = body()
    assert spread(plain, "p", 0.1) is plain
    assert more.is_real


def test_a_moved_point_is_one_that_was_made_there():
    for width in (0.0, 0.03):
        here = with_points(string(), {"a": 0.2, "b": 0.3}, [], {"a": width} if width else {})
        there = with_points(string(), {"a": 0.26, "b": 0.3}, [], {"a": width} if width else {})
        got = moved(here, "a", 0.26, width)
        for name in ("right", "left", "residual"):
            np.testing.assert_allclose(getattr(got, name), getattr(there, name), rtol=1e-9, atol=1e-12, err_msg=name)
        assert got.places == there.places


def test_modes_below_a_limit_take_their_numbers_with_them():
    basis = string()
    limit = float(basis.natural_freq[7])
    kept = below(basis, limit)
    assert kept.n_modes == 7
    for name in ("tension_part", "bending_part", "wavenumber"):
        np.testing.assert_array_equal(kept.metadata[name], basis.metadata[name][:7])
    assert kept.metadata["vec"].shape == (12, 7)
    assert kept.metadata["loss_error"].shape == (11,)
    assert kept.metadata["length"] == LENGTH
    np.testing.assert_allclose(kept.static_compliance(), basis.static_compliance(), rtol=1e-12)
    assert below(basis, 1.001 * float(basis.natural_freq[-1])) is basis
    raised = damped({"x": basis}, 2.5)["x"]
    np.testing.assert_allclose(raised.damping_rate, basis.damping_rate + 2.5)
    np.testing.assert_allclose(raised.stiffness, basis.stiffness)


def test_a_string_at_another_tension_by_its_formula():
    basis = string()

    def loss(w, k, tension):
        return 1e-3 + 1e-6 * k + 1e-5 * tension + 1e-7 * w

    new = string_detuned(basis, 80.0, loss)
    a, b, k = (basis.metadata[key] for key in ("tension_part", "bending_part", "wavenumber"))
    old, omega = np.sqrt(TENSION * a + BENDING * b), np.sqrt(80.0 * a + BENDING * b)
    np.testing.assert_allclose(np.sqrt(new.stiffness), omega, rtol=1e-9)
    ratio = omega * loss(omega, k, 80.0) / (old * loss(old, k, TENSION))
    np.testing.assert_allclose(new.damping_rate, basis.damping_rate * ratio, rtol=1e-9)
    assert new.metadata["tension"] == 80.0
    lossless = string_detuned(basis, 80.0, lambda w, k, tension: 0.0 * w)
    np.testing.assert_array_equal(lossless.damping_rate, basis.damping_rate)
    with pytest.raises(ValueError, match="no bending_part"):
        string_detuned(body(), 80.0, loss)


def test_partials_decay_by_a_law_of_their_frequency():
    basis = with_partial_decays(string(30), lambda w: 1.0 + 1e-3 * w)
    held = HeldModes.of(basis, "bridge")
    k = np.arange(1, 30) * np.pi / LENGTH
    w = np.sqrt((TENSION * k**2 + BENDING * k**4) / DENSITY)
    np.testing.assert_allclose(held.damping_rate, 1.0 + 1e-3 * w, rtol=1e-4)
    assert np.abs(basis.metadata["loss_error"]).max() < 5e-5
    constant = with_partial_decays(string(30), lambda w: 2.0)
    np.testing.assert_allclose(constant.damping_rate, 2.0, rtol=1e-3)


def test_rates_of_mixtures_that_can_be_and_that_cannot():
    shares = np.array([[0.7, 0.3], [0.2, 0.8]])
    rates = loss_rates(shares, shares @ [5.0, 2.0], np.array([1.0, 1.0]))
    np.testing.assert_allclose(rates.mode, [5.0, 2.0], rtol=1e-3)
    assert np.abs(rates.error).max() <= 5e-5
    impossible = loss_rates(shares, np.array([1.0, 10.0]), np.array([1.0, 1.0]))
    assert np.all(impossible.mode >= 0.0)
    np.testing.assert_allclose(impossible.error, shares @ impossible.mode / [1.0, 10.0] - 1, rtol=1e-12)
    none = loss_rates(np.zeros((0, 2)), np.zeros(0), np.array([3.0, 4.0]))
    assert (none.mode.tolist(), none.error.size) == ([3.0, 4.0], 0)
    stuck = loss_rates(shares, np.array([1.0, 2.0]), np.zeros(2))  # modes that begin at 0 stay there
    assert (stuck.mode.tolist(), stuck.error.tolist()) == ([0.0, 0.0], [-1.0, -1.0])
    still = loss_rates(shares, np.zeros(2), np.zeros(2))
    assert (still.mode.tolist(), still.error.tolist()) == ([0.0, 0.0], [0.0, 0.0])


def test_wavenumber_is_that_of_the_dispersion():
    k = np.array([0.0, 5.0, 900.0])
    for bending in (0.0, 4e-5, 3.0):
        omega = np.sqrt((TENSION * k**2 + bending * k**4) / DENSITY)
        np.testing.assert_allclose(wavenumber(omega, TENSION, DENSITY, bending), k, rtol=1e-12)


@pytest.mark.parametrize(
    "change", [{"length": 0.0}, {"tension": 0.0}, {"linear_density": 0.0}, {"bending_stiffness": -1e-9}]
)
def test_a_string_needs_positive_numbers(change):
    numbers = {"length": LENGTH, "tension": TENSION, "linear_density": DENSITY, "bending_stiffness": 0.0}
    assert string_basis(**numbers, loss=lambda w, k: 0.0, n_modes=1).n_modes == 1
    with pytest.raises(ValueError, match="above 0"):
        string_basis(**{**numbers, **change}, loss=lambda w, k: 0.0, n_modes=3)
    for eta in (-1e-9, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"eta = .* Hz; it must be 0 or more"):
            string_basis(**numbers, loss=lambda w, k, eta=eta: eta, n_modes=3)


@pytest.mark.parametrize("shorter", [0.8, 1.0, 1.3])
def test_carried_motion_is_that_of_the_matrices(shorter):
    old, new = string(9), string_basis(LENGTH * shorter, TENSION, DENSITY, BENDING, lambda w, k: 0.0, n_modes=7)
    q, v = np.random.default_rng(1).normal(size=(2, 9))
    displacement, velocity = string_transfer(old, new)
    carried = string_carry(old, new, q, v)
    np.testing.assert_allclose(carried[0], displacement @ q, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(carried[1], velocity @ v, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("before", "after"), [(0.65, 0.5), (0.5, 0.65)])
def test_velocities_are_carried_by_the_projection_in_the_mass(before, after):
    """Sine coefficients of the old field less the new ramp, by quadrature; the old field is at rest beyond its stop."""
    old, new = (string_basis(L, TENSION, DENSITY, BENDING, lambda w, k: 0.0, n_modes=8) for L in (before, after))
    v = np.random.default_rng(2).normal(size=8)
    nodes, weights = np.polynomial.legendre.leggauss(200)
    end = min(before, after)
    x, w = 0.5 * end * (nodes + 1), 0.5 * end * weights
    field = np.array([old.shape(at) @ v for at in x])
    bridge = old.shape(0.0) @ v
    k = np.arange(1, 8) * np.pi / after
    full = 0.5 * after * (nodes + 1), 0.5 * after * weights
    sines = np.sin(np.outer(x, k)).T @ (w * field)
    sines -= np.sin(np.outer(full[0], k)).T @ (full[1] * bridge * (1 - full[0] / after))
    got = new.metadata["vec"] @ string_transfer(old, new)[1] @ v
    np.testing.assert_allclose(got, [bridge, *(2 / after * sines)], rtol=1e-8, atol=1e-9)


def test_a_felt_on_one_mode_is_the_mean_of_its_square():
    """Nine places over the width; two modes of a string decay as that mean says where they are alone."""
    basis = ModalBasis.real([500.0], [1.0], {"bridge": 0.0}, shape=lambda x: np.array([2.0 + x]))
    places = 0.3 + 0.09 * (np.arange(9) - 4) / 9
    assert damper_rates(basis, 0.5, 0.3, 0.09) == pytest.approx([0.25 * np.mean((2 + places) ** 2)], rel=1e-12)
    assert damper_rates(basis, 0.5, 0.3) == pytest.approx([0.25 * 2.3**2], rel=1e-12)
    with pytest.raises(ValueError, match="at every position"):
        damper_rates(body(), 0.5, 0.3)


def test_masses_beside_a_component_and_its_first_points():
    basis = body(residual=np.array([[1e-6, 2e-7], [2e-7, 3e-6]]))
    both = with_masses(basis, {"m": 0.04, "n": 0.25})
    assert both.points == ("p", "q", "m", "n")
    assert both.n_modes == 5
    freq = np.array([20.0, 150.0])
    np.testing.assert_allclose(both.frf(freq, "m", "m"), 1 / (2j * np.pi * freq * 0.04), rtol=1e-12)
    np.testing.assert_allclose(both.frf(freq, "n", "n"), 1 / (2j * np.pi * freq * 0.25), rtol=1e-12)
    np.testing.assert_allclose(both.frf(freq, "p", "q"), basis.frf(freq, "p", "q"), rtol=1e-12)
    assert not both.frf(freq, "m", "n").any()
    assert not both.frf(freq, "p", "m").any()
    assert with_masses(basis, {}) is basis
    first = at_first_points(both, 2)
    assert first.points == ("p", "q")
    np.testing.assert_allclose(first.frf(freq, "q", "p"), basis.frf(freq, "q", "p"), rtol=1e-12)
    np.testing.assert_array_equal(first.residual, basis.residual)


def test_lumps_that_do_nothing_and_lumps_on_nothing():
    basis = body(metadata={"maker": "x"})
    assert loaded(basis, np.zeros((0, 2)), [], [], []) is basis
    none = ModalBasis.real([], [], {"p": []})
    assert loaded(none, [[1.0]], 1.0, 0.0, 0.0) is none
    heavier = loaded(basis, [[1.0, 0.0]], 0.1, 0.0, 0.0)
    assert heavier.metadata == {"maker": "x"}
    assert np.sum(heavier.poles.imag) < np.sum(basis.poles.imag)
    for bad in ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)):
        with pytest.raises(ValueError, match="must not be negative"):
            loaded(basis, [[1.0, 0.0]], *bad)


def test_a_pressed_string_by_pythagoras():
    """Nut at 0, frets at 0.1 and 0.2, saddle at 0.5 m, with a finger 20 mm behind the fret, 1 mm deep at the first."""
    board = FretboardGeometry(0.5, (0.1, 0.2), (0.0, 0.0), 1e-3, 4e-3, 1e-3, 2e-3, 0.02, 1e-3, 0.05)
    assert board.nut == (-1e-3, 1e-3)
    assert board.saddle == (0.502, 4e-3)
    opened = board.pressed(0)
    assert (opened.whole, opened.length, opened.fret) == (math.hypot(0.503, 3e-3), math.hypot(0.503, 3e-3), 0)
    first = board.pressed(1)
    depth = max(4e-3 / 0.402 * 0.02, 1e-3 * 0.101 / 0.1)
    front = math.hypot(0.402, 4e-3)
    behind = math.hypot(0.081, 1e-3 + depth) + math.hypot(0.02, depth)
    assert (first.whole, first.length, first.fret) == (pytest.approx(front + behind), pytest.approx(front), 1)
    second = board.pressed(2)
    depth = max(4e-3 / 0.302 * 0.02, 1e-3)
    back = math.hypot(0.101, 1e-3) + math.hypot(0.08, depth) + math.hypot(0.02, depth)
    assert second.whole == pytest.approx(math.hypot(0.302, 4e-3) + back)
    # a finger never lies farther than half the gap behind its fret
    wide = replace(board, finger=0.3)
    assert wide.pressed(2).whole == pytest.approx(replace(board, finger=0.05).pressed(2).whole)
    string = FrettedString(board, 70.0, 1e-4, 3000.0)
    Q = (first.whole - opened.whole) / (opened.whole + 0.05)
    T = (70.0 + 3000.0 * Q) * (1 + Q)
    speaks = [front - math.sqrt(1e-4 / T), opened.length - math.sqrt(1e-4 / 70.0)]
    assert (string.stretch(1), string.raised(1), string.length(1)) == tuple(map(pytest.approx, (Q, T, speaks[0])))
    assert string.raised(1, 80.0) == pytest.approx((80.0 + 3000.0 * Q) * (1 + Q))
    speed = [math.sqrt(t * (1 + math.pi**2 * 1e-4 / (t * x**2))) / x for t, x in zip((T, 70.0), speaks, strict=True)]
    assert string.ratio(1) == pytest.approx(speed[0] / speed[1])
    assert string.cents([2 ** (2 / 12)])[0] == pytest.approx(1200 * math.log2(speed[0] / speed[1]) - 200)
    other = string.moved(0.0, 0.01)
    assert other.tension == pytest.approx(70.0 * (math.hypot(0.51, 3e-3) / opened.length) ** 2)
    assert (other.board.nut_setback, other.board.saddle_setback) == (0.0, 0.01)
    with pytest.raises(ValueError, match="within a tenth of the scale"):
        compensated(string, [3.0, 3.0])


def test_selected_modes_leave_their_compliance():
    basis = body()
    kept = basis.select(np.array([True, False, True]))
    np.testing.assert_array_equal(kept.poles, basis.poles[[0, 2]])
    phi = np.array([2.0, -1.0]) / 0.5
    np.testing.assert_allclose(kept.residual, np.outer(phi, phi) / OMEGA[1] ** 2, rtol=1e-12)
    assert basis.select(np.arange(3)).residual.tolist() == basis.residual.tolist()
    assert (kept.kind.tolist(), REAL) == ([PAIR, PAIR], 1)
