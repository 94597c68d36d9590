"""Loss of a felt on a string against the same felt as a dashpot that is solved exactly."""

from __future__ import annotations

import numpy as np
import pytest

from system_modes import coupled_modes
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.modal.damper import damper_rates
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.modal.string_transfer import retuned

LENGTH, TENSION, DENSITY, STIFFNESS = 0.657, 729.0, 6.17e-3, 9.9e-3
IMPEDANCE = (TENSION * DENSITY) ** 0.5
#: of the string on a rigid bridge without a damper, 1/s
OWN = 0.5


def string(n: int = 40):
    upper = n / (2 * LENGTH) * (TENSION / DENSITY) ** 0.5
    return string_basis(
        LENGTH, TENSION, DENSITY, STIFFNESS, lambda w, k: np.full_like(w, 2 * OWN) / w, freq_upper=upper
    )


def rates(basis, felts=()):
    """Decay rates of the partials on a rigid bridge, 1/s; felts: (place, resistance)."""
    there = basis.with_places({f"felt{i}": x for i, (x, _) in enumerate(felts)})
    joints = [Connection("bridge", (Term("string", "bridge"),), Rigid())]
    joints += [
        Connection(f"felt{i}", (Term("string", f"felt{i}"),), SpringDashpot(damping=R))
        for i, (_, R) in enumerate(felts)
    ]
    return coupled_modes({"string": there}, joints).damping_rate


def added(basis, resistance: float, place: float, width: float):
    more = damper_rates(basis, resistance, place, width)
    assert np.all(more >= 0.0)
    return rates(retuned(basis, np.sqrt(basis.stiffness), basis.damping_rate + more)) - rates(basis)


def exactly(basis, resistance: float, place: float, width: float, n: int = 9):
    spots = place + width * ((np.arange(n) + 0.5) / n - 0.5)
    return rates(basis, [(x, resistance / n) for x in spots]) - rates(basis)


@pytest.mark.parametrize("place", [0.75, 0.84, 0.88, 0.92])
def test_a_soft_felt_is_what_the_dashpot_is(place: float) -> None:
    basis, R, width = string(), 0.03 * IMPEDANCE, 0.045
    got, true = added(basis, R, place * LENGTH, width), exactly(basis, R, place * LENGTH, width)
    n = 24
    # every partial within a fifth of the mean rate (a node is the worst), and all of them together within 2 %
    assert np.abs(got - true)[:n].max() < 0.2 * true[:n].mean()
    assert got[:n].sum() == pytest.approx(true[:n].sum(), rel=0.02)


def test_it_grows_with_the_resistance_as_far_as_the_page_says() -> None:
    basis = string()
    errors = []
    for share in (0.01, 0.1, 0.5):
        got = added(basis, share * IMPEDANCE, 0.84 * LENGTH, 0.045)
        true = exactly(basis, share * IMPEDANCE, 0.84 * LENGTH, 0.045)
        errors.append(float(np.abs(got - true)[:24].max() / true[:24].mean()))
    assert errors[0] < 0.01
    assert errors[1] < 0.01
    assert errors[1] < errors[2] < 0.15


def test_by_hand_for_a_point_on_an_ideal_string() -> None:
    # R sin^2(j pi x / L) / (mu L) is the rate of partial j under a small dashpot at x
    basis = string_basis(LENGTH, TENSION, DENSITY, 0.0, lambda w, k: np.zeros_like(w), freq_upper=8000.0)
    R, x = 1e-4, 0.88 * LENGTH
    got = rates(retuned(basis, np.sqrt(basis.stiffness), damper_rates(basis, R, x)))[:12]
    wanted = R * np.sin(np.arange(1, 13) * np.pi * 0.88) ** 2 / (DENSITY * LENGTH)
    assert np.abs(got - wanted).max() < 0.1 * wanted.max()


def test_a_felt_that_resists_nothing_adds_nothing():
    basis = string()
    np.testing.assert_array_equal(damper_rates(basis, 0.0, 0.1, 0.01), np.zeros(basis.n_modes))
