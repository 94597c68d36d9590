"""Bases against the matrices they come from: frequency responses, static deflection, residuals of folded modes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
import scipy.linalg as sla

from assembled import Part, chain, uneven
from tonewood.physics.modal.modes import BLOCK, PAIR, REAL, ModalBasis

FREQS = np.array([0.0, 3.0, 40.0, 97.0, 150.0, 800.0])


def modal_part(omega, zeta_or_sigma, seed=0):
    """M, C, K with given modal frequencies and damping rates, in random coordinates."""
    rng = np.random.default_rng(seed)
    n = len(omega)
    X = rng.normal(size=(n, n)) + 3 * np.eye(n)  # u = X^-1 q, mass-normalised
    return Part(X.T @ X, X.T @ np.diag(2 * np.asarray(zeta_or_sigma)) @ X, X.T @ np.diag(np.square(omega)) @ X)


def assert_same_response(basis, part, freqs=FREQS, rtol=1e-9):
    for i in (0, part.n - 1):
        expected = np.array([part.receptance(f)[i, 0] for f in freqs])
        np.testing.assert_allclose(basis.frf(freqs, f"n{i}", "n0", "receptance"), expected, rtol=rtol)


def test_response_of_real_modes_is_that_of_the_matrices():
    part = chain(5, seed=1)
    assert_same_response(part.real_basis(), part)


def test_response_of_modes_of_every_damping():
    omega = 2 * np.pi * np.array([5.0, 20.0, 60.0, 100.0, 140.0])
    zeta = np.array([10.0, 0.0, 1.0, 0.75, 0.01])
    part = modal_part(omega, zeta * omega)
    basis = part.real_basis()
    assert sorted(basis.kind) == [PAIR, PAIR, BLOCK, BLOCK, BLOCK]
    assert_same_response(basis, part, FREQS, rtol=1e-8)
    np.testing.assert_allclose(basis.damping_ratio, zeta, atol=1e-9)
    np.testing.assert_allclose(basis.natural_freq, omega / (2 * np.pi), rtol=1e-9)


def test_response_of_a_free_body_with_damped_and_undamped_rigid_modes():
    part = modal_part([0.0, 0.0, 300.0], [0.0, 4.0, 3.0])
    basis = ModalBasis.real(
        [0.0, 0.0, 300.0], [0.0, 4.0, 3.0], dict(zip(("n0", "n1", "n2"), sla.inv(mass_root(part)), strict=True))
    )
    assert list(basis.kind) == [BLOCK, BLOCK, PAIR]
    assert_same_response(basis, part, FREQS[1:])
    with pytest.raises(ValueError, match="rigid-body"):
        basis.static_compliance()


def mass_root(part):
    """X of `modal_part`, found again: columns of X^-1 are the mass-normalised shapes in the order given."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(part.n, part.n)) + 3 * np.eye(part.n)
    np.testing.assert_allclose(X.T @ X, part.M)
    return X


def test_response_of_complex_modes_with_real_poles_among_them():
    # stiff dashpots between light masses: some pairs of poles meet on the real axis
    part = uneven(5, seed=3, zeta=0.6)
    basis = part.complex_basis()
    assert np.count_nonzero(basis.kind == REAL) >= 2
    assert basis.n_modes < 2 * 5
    assert_same_response(basis, part)


def test_shape_scale_does_not_matter():
    part = uneven(4, seed=5)
    basis = part.complex_basis()
    turn = 3.0 * np.exp(1j * np.arange(4))
    right = {p: basis.right[i] * turn for i, p in enumerate(basis.points)}
    norm = (basis.right[0] / basis.left[0]) * turn**2
    again = ModalBasis.complex(basis.poles, right, norm=norm)
    # the modes' shares cancel far above them: a response is rounded to its largest shares
    s = 2j * np.pi * FREQS[:, None]
    residues = basis.right[basis.points.index("n3")] * basis.left[basis.points.index("n1")]
    shares = np.abs(s * residues / (s - basis.poles)) + np.abs(s * residues.conj() / (s - basis.poles.conj()))
    error = np.abs(again.frf(FREQS, "n3", "n1") - basis.frf(FREQS, "n3", "n1"))
    assert np.all(error <= 1e-14 * shares.sum(axis=1))


def coupled_structure_and_air():
    """Two masses and two air modes with velocity potentials: symmetric once the air's rows change sign."""
    M = np.diag([1.0, 2.0, 0.5, 0.7])
    K = np.array([[5e4, -1e4, 0, 0], [-1e4, 8e4, 0, 0], [0, 0, 3e4, 0], [0, 0, 0, 6e4]])
    B = np.array([[4.0, 1.0], [-2.0, 3.0]])
    C = np.diag([0.8, 1.0, 0.4, 0.9])
    C[:2, 2:], C[2:, :2] = B, -B.T
    return Part(M, C, K)


@pytest.mark.parametrize("shapes_of", ["displacement", "pressure"])
def test_left_shapes_of_acoustic_points_change_sign(shapes_of):
    part = coupled_structure_and_air()
    A, _ = part.state_matrices(np.zeros((0, 4)))
    poles, vectors = sla.eig(A)
    keep = poles.imag > 0
    lam, psi = poles[keep], vectors[:4, keep]
    flip = np.array([1.0, 1.0, -1.0, -1.0])
    norm = np.array([(flip * p) @ (part.C + 2 * s * part.M) @ p for s, p in zip(lam, psi.T, strict=True)])
    given = psi.copy()
    if shapes_of == "pressure":
        given[2:] *= lam
    right = {f"n{i}": row for i, row in enumerate(given)}
    basis = ModalBasis.complex(lam, right, norm=norm, acoustic=("n2", "n3"), shapes_of=shapes_of)
    for i, j in ((0, 0), (0, 2), (2, 0), (3, 1), (3, 3)):
        expected = [part.receptance(f)[i, j] for f in FREQS]
        ours = basis.frf(FREQS, f"n{i}", f"n{j}", "receptance")
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_a_response_of_thousands_of_modes_takes_little_memory():
    """Sum of phi^2 / (omega_n^2 - omega^2 + 2 i sigma omega) at a driving point; all at once it would take 160 MB."""
    n, sigma, freq = 2000, 3.0, np.linspace(20.0, 4000.0, 5000)
    omega = 2 * np.pi * np.linspace(50.0, 5000.0, n)
    basis = ModalBasis.real(omega, np.full(n, sigma), {"n0": np.ones(n)})
    tracemalloc.start()
    try:
        found = basis.frf(freq, "n0", "n0", "receptance")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 50e6
    for k in (0, 499, 500, 2499, 4999):
        w = 2 * np.pi * freq[k]
        assert found[k] == pytest.approx(np.sum(1 / (omega**2 - w**2 + 2j * sigma * w)), rel=1e-9)


def test_forms_of_a_response_differ_by_i_omega():
    basis = chain(3, seed=2).real_basis()
    y = basis.frf(FREQS, "n0", "n2", "receptance")
    iw = 2j * np.pi * FREQS
    np.testing.assert_allclose(basis.frf(FREQS, "n0", "n2"), iw * y, rtol=1e-13)
    np.testing.assert_allclose(basis.frf(FREQS, "n0", "n2", "accelerance"), iw**2 * y, rtol=1e-13)


@pytest.mark.parametrize("make", [Part.real_basis, Part.complex_basis])
def test_static_compliance_is_the_inverse_stiffness(make):
    part = chain(6, seed=4)
    np.testing.assert_allclose(make(part).static_compliance(), sla.inv(part.K), rtol=1e-8)


def test_static_compliance_of_overdamped_and_block_modes():
    omega = np.array([10.0, 30.0, 50.0])
    part = modal_part(omega, [60.0, 29.0, 50.0])
    np.testing.assert_allclose(part.real_basis().static_compliance(), sla.inv(part.K), rtol=1e-9)


def test_folding_modes_away_keeps_the_static_deflection():
    part = chain(6, seed=4)
    whole = part.real_basis()
    folded = whole.select(np.arange(3))
    np.testing.assert_allclose(folded.static_compliance(), sla.inv(part.K), rtol=1e-9)
    assert np.all(np.diag(folded.residual) > 0)
    dropped = whole.select(np.arange(3), fold=False)
    np.testing.assert_array_equal(dropped.residual, 0.0)
    # far below the modes left out the response is kept, near them it is not
    f = np.array([0.05]) * whole.natural_freq[3]
    assert (
        abs(folded.frf(f, "n0", "n0")[0] / whole.frf(f, "n0", "n0")[0] - 1)
        < 3e-3
        < (abs(dropped.frf(f, "n0", "n0")[0] / whole.frf(f, "n0", "n0")[0] - 1))
    )


def fixed_string(n_modes=30, length=0.65, tension=70.0, density=4e-3):
    """Ideal string held at both ends: closed forms for everything."""
    k = np.arange(1, n_modes + 1) * np.pi / length
    green = lambda x, y: min(x, y) * (length - max(x, y)) / (length * tension)  # noqa: E731
    return ModalBasis.real(
        k * np.sqrt(tension / density),
        np.full(n_modes, 0.7),
        {"mid": 0.3},
        modal_mass=density * length / 2,
        shape=lambda x: np.sin(k * x),
        static_compliance=green,
    ), green


def test_residual_is_what_the_kept_modes_leave_of_greens_function():
    basis, green = fixed_string()
    assert basis.static_compliance()[0, 0] == pytest.approx(green(0.3, 0.3), rel=1e-12)
    more = basis.with_places({"x": 0.1, "y": 0.11})
    expected = [[green(a, b) for b in (0.3, 0.1, 0.11)] for a in (0.3, 0.1, 0.11)]
    np.testing.assert_allclose(more.static_compliance(), expected, rtol=1e-12)
    assert more.points == ("mid", "x", "y")
    np.testing.assert_array_equal(more.right[0], basis.right[0])


def test_fewer_modes_of_a_string_leave_more_residual_everywhere():
    basis, green = fixed_string()
    few = basis.select(np.arange(10)).with_places({"x": 0.1})
    assert few.shape is not None
    assert few.shape(0.2).shape == (10,)
    expected = [[green(a, b) for b in (0.3, 0.1)] for a in (0.3, 0.1)]
    np.testing.assert_allclose(few.static_compliance(), expected, rtol=1e-12)


def test_places_already_there_are_not_added_twice():
    basis, _ = fixed_string()
    assert basis.with_places({"mid": 0.3}) is basis


@pytest.mark.parametrize(
    ("basis", "real"),
    [
        (chain(3, seed=1).real_basis(), True),
        (modal_part([1.0, 2.0, 5.0], [0.0, 2.0, 30.0]).real_basis(), True),
        (uneven(3, seed=1).complex_basis(), False),
    ],
)
def test_real_modes_are_distinguished_from_complex_ones(basis, real):
    assert basis.is_real is real


def test_complex_shapes_of_a_proportional_body_may_still_be_written_as_real_modes():
    part = chain(4, seed=8)
    basis, real = part.complex_basis(), part.real_basis()
    assert not basis.is_real  # its shapes carry a phase
    np.testing.assert_allclose(basis.frf(FREQS, "n0", "n3"), real.frf(FREQS, "n0", "n3"), rtol=1e-9)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="positive imaginary part"):
        ModalBasis.complex([-1 - 5j], {"a": [1.0]})
    with pytest.raises(ValueError, match=r"\['b'\] have no shape"):
        ModalBasis.complex([-1 + 5j], {"a": [1.0]}, acoustic=("b",))
    with pytest.raises(ValueError, match="'displacement' or 'pressure'"):
        ModalBasis.complex([-1 + 5j], {"a": [1.0]}, shapes_of="velocity")
    with pytest.raises(ValueError, match="same points"):
        ModalBasis.complex([-1 + 5j], {"a": [1.0]}, {"b": [1.0]})
    with pytest.raises(ValueError, match="finite and not negative"):
        ModalBasis.real([-1.0], [0.0], {"a": [1.0]})
    with pytest.raises(ValueError, match=r"\(1, 1\), not \(2, 2\)"):
        ModalBasis.real([1.0], [0.0], {"a": [1.0]}, residual=np.eye(2))
    with pytest.raises(ValueError, match="residual of a basis must be finite"):
        ModalBasis.real([1.0], [0.0], {"a": [1.0]}, residual=[[np.inf]])
    with pytest.raises(ValueError, match="right of a basis must be finite"):
        ModalBasis.complex([-1 + 5j], {"a": [np.nan]})
    basis = ModalBasis.real([1.0], [0.0], {"a": [1.0], "b": [2.0]})
    with pytest.raises(ValueError, match="no point 'c'; there are a, b"):
        basis.frf([1.0], "c", "a")
    with pytest.raises(ValueError, match="named points only"):
        basis.with_places({"x": 0.1})
    with pytest.raises(ValueError, match="receptance, mobility or accelerance"):
        basis.frf([1.0], "a", "a", "impedance")
