"""Modes of joined components against assembled matrices, closed forms and each other."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from system_modes import coupled_modes
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.physics.modal.string_modes import string_basis


def oscillator(mass: float, stiffness: float, damping: float, **more: object) -> ModalBasis:
    return ModalBasis.real([np.sqrt(stiffness / mass)], [damping / (2 * mass)], {"p": [1.0]}, modal_mass=mass, **more)  # type: ignore[arg-type]  # options of a basis


def oscillatory(A: np.ndarray) -> np.ndarray:
    poles = sla.eigvals(A)
    poles = poles[poles.imag > 1e-9]
    return poles[np.argsort(poles.imag)]


def companion(M: np.ndarray, C: np.ndarray, K: np.ndarray) -> np.ndarray:
    n = len(M)
    return np.block([[np.zeros((n, n)), np.eye(n)], [-sla.solve(M, K), -sla.solve(M, C)]])


def test_two_oscillators_held_together_are_one() -> None:
    parts = {"a": oscillator(2.0, 300.0, 0.4), "b": oscillator(1.0, 50.0, 0.1)}
    joint = Connection("j", (Term("a", "p"), Term("b", "p", -1.0)))
    found = coupled_modes(parts, [joint])
    expected = oscillatory(companion(np.array([[3.0]]), np.array([[0.5]]), np.array([[350.0]])))
    np.testing.assert_allclose(found.poles, expected, rtol=1e-12)
    # they move together: kinetic energies as their masses, potential as their stiffnesses
    np.testing.assert_allclose(found.shares, [[(2 / 3 + 300 / 350) / 2, (1 / 3 + 50 / 350) / 2]], rtol=1e-3)


def test_redundant_constraints_and_springs() -> None:
    parts = {"a": oscillator(2.0, 300.0, 0.4), "b": oscillator(1.0, 50.0, 0.1), "c": oscillator(0.5, 80.0, 0.2)}
    rigid = Connection("j", (Term("a", "p"), Term("b", "p", -1.0)))
    twice = Connection("jj", (Term("a", "p", 2.0), Term("b", "p", -2.0)))
    spring = Connection("s", (Term("b", "p"), Term("c", "p", -1.0)), SpringDashpot(40.0, 0.3))
    found = coupled_modes(parts, [rigid, twice, spring])
    M, C = np.diag([3.0, 0.5]), np.array([[0.5 + 0.3, -0.3], [-0.3, 0.2 + 0.3]])
    K = np.array([[350.0 + 40.0, -40.0], [-40.0, 80.0 + 40.0]])
    np.testing.assert_allclose(found.poles, oscillatory(companion(M, C, K)), rtol=1e-9)


def test_residual_compliance_is_a_spring_in_the_joint() -> None:
    R = 2e-3
    parts = {"a": oscillator(2.0, 300.0, 0.4, residual=[[R]]), "b": oscillator(1.0, 50.0, 0.1)}
    found = coupled_modes(parts, [Connection("j", (Term("a", "p"), Term("b", "p", -1.0)), Rigid())])
    K = np.array([[300 + 1 / R, -1 / R], [-1 / R, 50 + 1 / R]])
    np.testing.assert_allclose(
        found.poles, oscillatory(companion(np.diag([2.0, 1.0]), np.diag([0.4, 0.1]), K)), rtol=1e-9
    )


def test_complex_modes_of_a_part() -> None:
    """A two-mass part with non-proportional damping, given by its complex modes, held to a third mass."""
    M, C = np.diag([1.0, 0.5]), np.array([[0.9, -0.2], [-0.2, 0.3]])
    K = np.array([[400.0, -150.0], [-150.0, 260.0]])
    A = companion(M, C, K)
    lam, psi = sla.eig(A)
    lam, psi = lam[lam.imag > 0], psi[:2, lam.imag > 0]
    norm = np.array([v @ (2 * s * M + C) @ v for s, v in zip(lam, psi.T, strict=True)])
    part = ModalBasis.complex(lam, {"one": psi[0], "two": psi[1]}, norm=norm)
    other = oscillator(0.7, 90.0, 0.05)
    found = coupled_modes({"part": part, "b": other}, [Connection("j", (Term("part", "two"), Term("b", "p", -1.0)))])
    whole = companion(M + np.diag([0, 0.7]), C + np.diag([0, 0.05]), K + np.diag([0, 90.0]))
    np.testing.assert_allclose(found.poles, oscillatory(whole), rtol=1e-9)


def string_and_body() -> tuple[dict[str, ModalBasis], list[Connection]]:
    string = string_basis(0.65, 73.9, 3.61e-3, 4e-5, lambda w, k: 1.0 / w + 1e-4, freq_upper=3000.0)
    omega = 2 * np.pi * np.array([102.0, 216.0, 413.0])
    body = ModalBasis.real(omega, omega / 60, {"bridge": np.sqrt([1.8, 16.0, 1.9])}, residual=[[1e-7]])
    return {"string": string, "body": body}, [Connection("j", (Term("string", "bridge"), Term("body", "bridge", -1.0)))]


def test_zeros_of_the_joint_are_the_modes() -> None:
    parts, joints = string_and_body()
    everything = coupled_modes(parts, joints)
    joint = Joint([Ports.of(b, np.ones((1, 1))) for b in parts.values()])
    poles = [complex(p) for p in parts["body"].poles]
    near = everything.poles[everything.freq < 450.0]
    found = sorted(joint.zeros([1.001 * p for p in [*poles, *near]], multiply=poles), key=lambda s: s.imag)
    np.testing.assert_allclose([s for s in found if s.imag < 450 * 2 * np.pi], near, rtol=1e-9)
    for s in found[:4]:
        k = int(np.argmin(np.abs(everything.poles - s)))
        np.testing.assert_allclose(joint.shares(s), everything.shares[k], atol=1e-6)


def test_derivative_of_the_joint(rng: np.random.Generator) -> None:
    parts, _ = string_and_body()
    heavy = ModalBasis.real([50.0, 0.0], [60.0, 0.0], {"bridge": [0.3, 0.1]})  # over-damped, and a rigid-body mode
    rows = {"string": [1.0, 0.0], "body": [-0.8, 0.3], "heavy": [0.2, 0.5]}
    joint = Joint([Ports.of(b, np.array(rows[n])[:, None]) for n, b in {**parts, "heavy": heavy}.items()])
    for s in (complex(-3, 700), complex(5, 1200)):
        h = 1e-4
        slope = (joint.determinant(s + h)[0] - joint.determinant(s - h)[0]) / (2 * h)
        assert joint.determinant(s)[1] == pytest.approx(slope, rel=1e-6)
        expected = sum(b.frf([s.imag / (2 * np.pi)], "bridge", "bridge", "receptance")[0] * rows[n][0] * rows[n][1]
                       for n, b in {**parts, "heavy": heavy}.items())  # fmt: skip
        at_axis = joint.receptance(1j * s.imag)[0][0, 1]
        assert at_axis == pytest.approx(expected, rel=1e-12)


def test_limit_keeps_low_modes() -> None:
    parts, joints = string_and_body()
    whole, part = coupled_modes(parts, joints), coupled_modes(parts, joints, freq_upper=1500.0)
    low = whole.freq < 300.0
    cents = 1200 * np.log2(part.freq[: low.sum()] / whole.freq[low])
    assert np.abs(cents).max() < 0.5
