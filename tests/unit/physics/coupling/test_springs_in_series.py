"""Springs in series with the residual compliance of their gaps, against the assembled system with a massless node."""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1e-5
#: mass 1 kg on K N/m, a spring k with a dashpot r behind a compliance R
K, R = 1e4, 1e-4


def joined(*springs: tuple[float, float]) -> System:
    """One mode, held by springs at points that move alike."""
    points = {f"p{i}": [1.0] for i in range(len(springs))}
    basis = ModalBasis.real([np.sqrt(K)], [0.0], points, residual=np.full((len(springs), len(springs)), R))
    connections = [Connection(f"s{i}", (Term("a", f"p{i}"),), SpringDashpot(k, r)) for i, (k, r) in enumerate(springs)]
    return System.build({"a": basis}, connections, dt=DT)


def pole(system: System) -> complex:
    """Of the step: ln of its eigenvalue, by dt."""
    columns = []
    for one in np.eye(2):
        state = system.start()
        system.modes_of(state, "a")[:] = one[:, None]
        NumpyStepper(system).run(state, 1)
        columns.append(np.ravel(system.modes_of(state, "a")).copy())
    poles = np.log(np.linalg.eigvals(np.transpose(columns)).astype(complex)) / DT
    return complex(poles[np.argmax(poles.imag)])


def assembled(k: float, r: float) -> complex:
    """q'' + K q + (q - u)/R = 0 with (q - u)/R = k u + r u' at the node between compliance and spring."""
    A = np.array([[0.0, 1.0, 0.0], [-K - 1 / R, 0.0, 1 / R], [1 / (R * r), 0.0, -(1 / R + k) / r]])
    poles = np.linalg.eigvals(A)
    return complex(poles[np.argmax(poles.imag)])


@pytest.mark.parametrize("k", [5e2, 5e3, 5e4])
def test_a_spring_and_its_dashpot_act_behind_the_residual_compliance(k: float) -> None:
    """k R from 0.05 to 5; the error of the dashpot's share is of the second order in |s| r R, here 1e-2."""
    found, exact = pole(joined((k, 1.0))), assembled(k, 1.0)
    assert found.imag == pytest.approx(exact.imag, rel=1e-4)
    assert found.real == pytest.approx(exact.real, rel=1e-3)
    stiff = np.sqrt(K + k)  # without R
    assert abs(exact.imag - stiff) > 0.001 * stiff


def test_springs_of_points_that_move_alike_are_one_spring() -> None:
    assert pole(joined((2e3, 0.4), (3e3, 0.6))) == pytest.approx(pole(joined((5e3, 1.0))), rel=1e-9)


def test_a_stiff_spring_far_away_does_not_soften_a_weak_one() -> None:
    """Two modes with a point each, which R of the modes left out joins by a hundredth; k R is 1000 and 0.01."""
    squares, k, residual = np.array([1e4, 9e4]), np.array([1e7, 1e2]), R * np.array([[1.0, 0.01], [0.01, 1.0]])
    basis = ModalBasis.real(np.sqrt(squares), [0.0, 0.0], {"p0": [1.0, 0.0], "p1": [0.0, 1.0]}, residual=residual)
    links = [Connection(f"s{i}", (Term("a", f"p{i}"),), SpringDashpot(float(k[i]))) for i in range(2)]
    system = System.build({"a": basis}, links, dt=DT)
    held = np.diag(squares) + np.linalg.inv(np.diag(1 / k) + residual)  # both springs behind R, assembled
    springs = [law.stiffness for law in system.elimination.springs_in_series.values()]
    np.testing.assert_allclose(np.linalg.eigvalsh(np.diag(squares + springs)), np.linalg.eigvalsh(held), rtol=0.02)
    assert springs[1] == pytest.approx(100 / 1.01, rel=0.02)


@pytest.mark.parametrize("stepper", [NumpyStepper, KernelStepper])
def test_the_account_closes(stepper: type[NumpyStepper] | type[KernelStepper]) -> None:
    system = joined((2e3, 0.4), (3e3, 0.6))
    state = system.start()
    system.modes_of(state, "a")[:] = 1.0
    account, before = EnergyAccount(system, state), state.copy()
    _, forces = stepper(system).run(state, 2000)
    account.follow(before, state, forces)
    assert account.trace().worst_residual < 1e-12
    assert sum(account.stored(state).values()) < 0.999 * sum(account.stored(before).values())
