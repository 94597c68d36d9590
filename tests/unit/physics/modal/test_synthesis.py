"""Modes from matrices, against the exponential of the assembled first-order system."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import BLOCK, PAIR, REAL
from tonewood.physics.modal.propagator import apply, flow, real_form
from tonewood.physics.modal.synthesis import basis_from_matrices, initial_state, velocity_potential_form
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]
Matrices = tuple[Floats, Floats, Floats]


def _definite(rng: np.random.Generator, n: int) -> Floats:
    G = rng.normal(size=(n, n))
    return G @ G.T + 0.2 * np.eye(n)


def _chain(k: float, n: int) -> Floats:
    return k * (np.diag([1.0] + [2.0] * (n - 2) + [1.0]) - np.eye(n, k=1) - np.eye(n, k=-1))


def _mixed(matrices: Matrices, seed: int = 3) -> Matrices:
    """The same system in other coordinates."""
    T = np.random.default_rng(seed).normal(size=matrices[0].shape)
    M, C, K = (T.T @ a @ T for a in matrices)
    return (M + M.T) / 2, (C + C.T) / 2, (K + K.T) / 2


_PAIR_C, _PAIR_K = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([[5.0, -2.0], [-2.0, 3.0]])


def _near_critical(shift: float) -> Matrices:
    return _mixed((np.eye(3), sla.block_diag(4.0 + shift, _PAIR_C), sla.block_diag(4.0, _PAIR_K)))


def _twice(C: Floats) -> Matrices:
    return _mixed((np.eye(4), sla.block_diag(C, C), sla.block_diag(_PAIR_K, _PAIR_K)))


def _free_chain(damped: bool) -> Matrices:
    C = np.zeros((4, 4))
    C[:2, :2] = _PAIR_C
    C[3, 3] = 0.5 if damped else 0.0
    return np.diag([1.0, 2.0, 3.0, 1.0]), C, _chain(4.0, 4)


def _two_bodies(link: float) -> Matrices:
    C = np.diag([1.0, 0, 0, 0, 0])
    C[3:, 3:] = 0.4 * _PAIR_C
    C += link * np.outer([0, 0, 1, -1, 0], [0, 0, 1, -1, 0])
    return np.diag([1.0, 2.0, 3.0, 1.0, 1.0]), C, sla.block_diag(_chain(4.0, 3), _chain(3.0, 2))


def _double_complex_pole() -> Matrices:
    # s^4 + c s^3 + (A + B) s^2 + c B s + A B - k^2 is a square for A = B + c^2/4, k = c sqrt(B)/2
    c = 0.3
    return np.eye(2), np.diag([c, 0.0]), np.array([[1 + c**2 / 4, -c / 2], [-c / 2, 1.0]])


_RANDOM = np.random.default_rng(11)
_M, _K = _definite(_RANDOM, 5), 10 * _definite(_RANDOM, 5)
_SYSTEMS: dict[str, tuple[Matrices, list[int], float]] = {
    "undamped": ((_M, 0 * _M, _K), [PAIR] * 5, 1e-13),
    "proportional": ((_M, 0.1 * _M + 0.01 * _K, _K), [PAIR] * 5, 1e-13),
    "all critical": (_mixed((np.eye(3), 6 * np.eye(3), 9 * np.eye(3))), [BLOCK] * 3, 1e-12),
    "viscous": ((_M, 0.3 * _definite(_RANDOM, 5), _K), [PAIR] * 5, 1e-13),
    "heavily viscous": ((_M, 200 * _definite(_RANDOM, 5), _K), [REAL] * 10, 1e-11),
    "free, undamped rigid body": (_free_chain(False), [BLOCK, PAIR, PAIR, PAIR], 1e-13),
    "free, damped rigid body": (_free_chain(True), [REAL, REAL, PAIR, PAIR, PAIR], 1e-12),
    "two free bodies": (_two_bodies(0.0), [BLOCK, REAL, REAL, PAIR, PAIR, PAIR], 1e-13),
    "two free bodies, dashpot between": (_two_bodies(0.3), [REAL] * 4 + [PAIR] * 3, 1e-12),
    "no stiffness": ((np.eye(3), _mixed((np.eye(3),) * 3)[1], np.zeros((3, 3))), [BLOCK] * 3, 1e-13),
    "critical mode": (_near_critical(0.0), [PAIR, BLOCK, PAIR], 1e-13),
    "double complex pole": (_double_complex_pole(), [PAIR, PAIR], 1e-9),
    "two equal viscous halves": (_twice(0.2 * _PAIR_C), [PAIR] * 4, 1e-13),
    "two equal overdamped halves": (_twice(np.diag([15.0, 0.1])), [REAL, REAL, PAIR, PAIR, REAL, REAL], 1e-12),
    "two critical modes": (
        _mixed((np.eye(4), sla.block_diag(4.0, 4.0, _PAIR_C), sla.block_diag(4.0, 4.0, _PAIR_K))),
        [PAIR, REAL, REAL, REAL, REAL, PAIR],
        1e-9,
    ),
}


def _step(M: Floats, C: Floats, K: Floats, x: Floats, v: Floats, f: Floats, h: float) -> tuple[Floats, Floats]:
    """Exact motion after h under constant forces."""
    n = len(M)
    A = np.zeros((3 * n, 3 * n))
    A[:n, n : 2 * n] = np.eye(n)
    A[n : 2 * n] = sla.solve(M, np.hstack([-K, -C, np.eye(n)]))
    out = sla.expm(A * h) @ np.concatenate([x, v, f])
    return out[:n], out[n : 2 * n]


def _agrees(M: Floats, C: Floats, K: Floats, acoustic: list[int], h: float, tolerance: float) -> list[int]:
    n = len(M)
    rng = np.random.default_rng(5)
    basis = basis_from_matrices(M, C, K, [f"dof{i}" for i in range(n)], acoustic_dofs=acoustic)
    x0, v0, f = rng.normal(size=(3, n))
    state = initial_state(basis, M, C, x0, v0)
    form, every = real_form(basis), np.arange(n)
    phi = flow(basis, h)
    after = apply(phi[0], state) + apply(h * phi[1], np.einsum("pmx,p->mx", form.B, f))
    x, v = _step(M, C, K, x0, v0, f, h)
    scale = max(np.abs(x).max(), np.abs(v).max())
    velocity = form.rows("velocity", every)
    np.testing.assert_allclose(np.einsum("pmx,mx->p", form.C, state), x0, atol=100 * tolerance)
    np.testing.assert_allclose(np.einsum("pmx,mx->p", velocity, state), v0, atol=100 * tolerance)
    np.testing.assert_allclose(np.einsum("pmx,mx->p", form.C, after), x, atol=tolerance * scale)
    np.testing.assert_allclose(np.einsum("pmx,mx->p", velocity, after), v, atol=tolerance * scale)
    return [int(kind) for kind in basis.kind]


@pytest.mark.parametrize("name", _SYSTEMS)
def test_motion_is_that_of_the_assembled_system(name: str) -> None:
    (M, C, K), kinds, tolerance = _SYSTEMS[name]
    for h in (0.05, 1.7):
        assert sorted(_agrees(M, C, K, [], h, tolerance)) == sorted(kinds)


def test_a_double_real_pole_is_two_modes_however_it_is_rounded() -> None:
    """Two equal overdamped halves, turned in 150 ways: after some, rounding makes a pair of complex poles of it."""
    C, K = sla.block_diag(*[np.diag([6.0, 8.0])] * 2), sla.block_diag(_PAIR_K, _PAIR_K)
    for seed in range(150):
        turn = sla.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
        kinds = _agrees(np.eye(4), turn @ C @ turn.T, turn @ K @ turn.T, [], 0.7, 1e-12)
        assert sorted(kinds) == sorted([REAL] * 8)


@pytest.mark.parametrize("shift", [s * 10.0**-k for k in range(1, 15) for s in (1, -1)])
def test_accuracy_holds_through_critical_damping(shift: float) -> None:
    _agrees(*_near_critical(shift), [], 0.4, 5e-12)


def test_frequency_response_through_critical_damping() -> None:
    M, C, K = _near_critical(0.0)
    basis = basis_from_matrices(M, C, K, ["a", "b", "c"])
    freq = np.array([0.01, 0.2, 0.5, 1.3])
    expected = [sla.inv(-((2 * np.pi * f) ** 2) * M + 2j * np.pi * f * C + K) for f in freq]
    np.testing.assert_allclose(basis.frf(freq, "a", "c", "receptance"), [H[0, 2] for H in expected], rtol=1e-11)
    np.testing.assert_allclose(basis.static_compliance(), sla.inv(K), rtol=1e-10)


def _cavity(damped: bool, free_wall: bool) -> Matrices:
    """A wall of two masses on a cavity of two potentials, closed: a constant potential stores nothing."""
    L = np.array([[0.7, -0.3], [0.2, 0.9]])
    Ks = _chain(3.0, 2) if free_wall else _PAIR_K
    Cs = np.zeros((2, 2)) if free_wall else 0.3 * _PAIR_C
    Ca = np.diag([0.2, 0.0]) if damped else np.zeros((2, 2))
    return (
        np.diag([1.0, 2.0, 1.0, 1.5]),
        np.block([[Cs, -L], [L.T, Ca]]),
        sla.block_diag(Ks, _chain(2.0, 2)),
    )


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("free_wall", [True, False])
def test_closed_cavity(damped: bool, free_wall: bool) -> None:
    M, C, K = _cavity(damped, free_wall)
    for h in (0.1, 2.0):
        _agrees(M, C, K, [2, 3], h, 1e-12)


def test_pressure_form_is_brought_to_the_potential_form() -> None:
    M, C, K = _cavity(True, False)
    L = C[2:, :2].T
    M8, C8, K8 = M.copy(), sla.block_diag(C[:2, :2], C[2:, 2:]), K.copy()
    M8[2:, :2], K8[:2, 2:] = L.T, -L
    for given, expected in zip(velocity_potential_form(M8, C8, K8, [2, 3]), (M, C, K), strict=True):
        np.testing.assert_array_equal(given, expected)
    # displacement under a pressure source: Eq. 8 and the modes answer alike, g' in one being g in the other
    basis = basis_from_matrices(M8, C8, K8, ["u", "v", "a", "b"], acoustic_dofs=[2, 3])
    s = 2j * np.pi * 0.3
    expected = sla.inv(s**2 * M8 + s * C8 + K8)[0, 3] * s
    assert basis.frf(0.3, "u", "b", "receptance")[0] == pytest.approx(expected, rel=1e-10)


def test_left_shapes_of_acoustic_points_turn_their_sign() -> None:
    # guitar body of Fabre, Le Carrou & Chomette 2024, Eq. 38; poles from the quadratic eigenproblem
    M, K = np.diag([0.031, 2.7e-7]), np.diag([2.2e4, 0.12])
    C = np.array([[1.4, -0.036], [0.036, 3.1e-6]])
    basis = basis_from_matrices(M, C, K, ["plate", "air"], acoustic_dofs=[1])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-sla.solve(M, K), -sla.solve(M, C)]])
    expected = sla.eigvals(A)
    np.testing.assert_allclose(basis.poles, sorted(expected[expected.imag > 0], key=abs), rtol=1e-11)
    ratio = basis.left / basis.right
    np.testing.assert_allclose(ratio[1], -ratio[0], rtol=1e-9)
    norm = np.array(
        [
            (psi * [1, -1]) @ C @ psi + 2 * lam * (psi * [1, -1]) @ M @ psi
            for psi, lam in zip(basis.right.T, basis.poles, strict=True)
        ]
    )
    np.testing.assert_allclose(ratio[0], 1 / norm, rtol=1e-9)


def test_massless_dofs_are_residual_compliance() -> None:
    M, K = np.diag([0.0, 2.0, 1.0]), np.array([[2.0, -2.0, 0.0], [-2.0, 3.0, -1.0], [0.0, -1.0, 1.0]])
    basis = basis_from_matrices(M, np.zeros((3, 3)), K, {"end": [1, 0, 0], "far": [0, 0, 1]})
    s = 2j * np.pi * np.array([0.05, 0.4])
    H = [sla.inv(p**2 * M + K) for p in s]
    for a, i in (("end", 0), ("far", 2)):
        for b, j in (("end", 0), ("far", 2)):
            np.testing.assert_allclose(basis.frf(s.imag / (2 * np.pi), a, b, "receptance"), [h[i, j] for h in H])
    assert basis.residual[0, 0] == pytest.approx(0.5)
    assert sorted(basis.kind) == [PAIR, BLOCK]


def test_massless_direction_across_dofs() -> None:
    M = np.outer([1.0, 1.0, 0.0], [1.0, 1.0, 0.0]) + np.diag([0.0, 0.0, 1.0])
    K = np.array([[3.0, -1.0, 0.0], [-1.0, 4.0, -2.0], [0.0, -2.0, 5.0]])
    basis = basis_from_matrices(M, np.zeros((3, 3)), K, ["a", "b", "c"])
    H = sla.inv(-((2 * np.pi * 0.1) ** 2) * M + K)
    for i, a in enumerate("abc"):
        for j, b in enumerate("abc"):
            assert basis.frf(0.1, a, b, "receptance")[0] == pytest.approx(H[i, j], rel=1e-12)


def test_points_may_be_directions() -> None:
    (M, C, K), _, _ = _SYSTEMS["viscous"]
    whole = basis_from_matrices(M, C, K, list("abcde"))
    part = basis_from_matrices(M, C, K, {"sum": [1, 1, 0, 0, 0], "e": [0, 0, 0, 0, 1]})
    expected = whole.frf(0.4, "a", "e") + whole.frf(0.4, "b", "e")
    np.testing.assert_allclose(part.frf(0.4, "sum", "e"), expected, rtol=1e-12)


_EYE = np.eye(2)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: basis_from_matrices(_EYE, _EYE, np.eye(3), "ab"), "one size"),
        (lambda: basis_from_matrices(_EYE, _EYE, [[1, 0.2], [0, 1]], "ab"), "K is not symmetric"),
        (lambda: basis_from_matrices(_EYE, [[1, 0.2], [0, 1]], _EYE, "ab"), "C is not symmetric"),
        (lambda: basis_from_matrices(_EYE, [[1, 0.2], [0.2, 1]], _EYE, "ab", acoustic_dofs=[1]), "acoustic rows"),
        (lambda: basis_from_matrices(_EYE, _EYE, -_EYE, "ab"), "stiffness matrix is not positive"),
        (lambda: basis_from_matrices(-_EYE, _EYE, _EYE, "ab"), "mass matrix is not positive"),
        (lambda: basis_from_matrices(np.diag([1, 0]), 0 * _EYE, np.diag([1, 0]), "ab"), "neither mass nor stiffness"),
        (lambda: basis_from_matrices(np.diag([1, 0]), _EYE, _EYE, "ab"), "damping acts on a dof without mass"),
        (lambda: basis_from_matrices(_EYE, _EYE, _EYE, "abc"), "3 names for 2 dofs"),
        (lambda: basis_from_matrices(_EYE, _EYE, _EYE, {"p": [1.0]}), "a direction has 2 entries"),
        (lambda: basis_from_matrices(_EYE, [[0, 1], [1, 0]], np.diag([1, 0]), "ab"), "not positive semi-definite"),
    ],
)
def test_refusals(call: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_a_closed_cavity_is_stepped_like_any_component() -> None:
    """Its block reads both of its states: joined to a mass, its motion converges to the assembled system's."""
    M, C, K = _cavity(False, False)
    cavity = basis_from_matrices(M, C, K, ["u", "v", "a", "b"], acoustic_dofs=[2, 3])
    mass = basis_from_matrices([[0.7]], [[0.1]], [[3.0]], ["x"])
    gap = np.array([1.0, 0, 0, 0, -1.0])
    loss, stiff = sla.block_diag(C, 0.1), sla.block_diag(K, 3.0)
    whole = sla.block_diag(M, 0.7), loss + 0.3 * np.outer(gap, gap), stiff + 2 * np.outer(gap, gap)
    link = Connection("link", (Term("cavity", "u"), Term("mass", "x", -1.0)), SpringDashpot(2.0, 0.3))
    readouts = [Readout(p, "displacement", (Term("cavity", p),)) for p in "uvab"]
    readouts += [Readout("pressure", "velocity", (Term("cavity", "b"),))]
    errors = []
    for h in (0.02, 0.01):
        system = System.build({"cavity": cavity, "mass": mass}, [link], readouts, dt=h)
        state = system.start()
        system.modes_of(state, "mass")[:] = initial_state(mass, [[0.7]], [[0.1]], [0.4], [-1.0]).T
        steps = round(4 / h)
        out, _ = NumpyStepper(system).run(state, steps + 1)
        x, v = _step(*whole, np.array([0, 0, 0, 0, 0.4]), np.array([0, 0, 0, 0, -1.0]), np.zeros(5), 4.0)
        errors.append(np.abs(out[-1] - [*x[:4], v[3]]).max())
    assert errors[1] < 2e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
