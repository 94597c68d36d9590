"""Driven assembled systems and the beam, against other ways to the same motion."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.integrate import solve_ivp

from tonewood.lab.assembled import Matrices, driven_motion, force_at, free_motion, triangle
from tonewood.lab.beam import Beam
from tonewood.physics.stepping.forcing import Segment

SYSTEM = Matrices(
    np.diag([1.0, 0.5]), np.array([[0.3, -0.1], [-0.1, 0.2]]), np.array([[30.0, -12.0], [-12.0, 20.0]])
)  # fmt: skip


def test_breakpoints_need_not_lie_on_the_grid() -> None:
    pieces = (Segment(0.013, 0.21, 1.0, 4.0, -30.0), Segment(0.21, 0.4567, -2.0))
    dt, n = 0.05, 31
    found = driven_motion(SYSTEM, [0.4, 1.0], pieces, dt, n, [0.1, 0.0, 0.0, -0.5])
    y, t0 = np.array([0.1, 0.0, 0.0, -0.5]), 0.0
    for edge in (0.013, 0.21, 0.4567, (n - 1) * dt):
        middle = (t0 + edge) / 2

        def rate(t: float, y: np.ndarray, middle: float = middle) -> np.ndarray:
            # the polynomial of this stretch, also at its very ends
            piece = next((p for p in pieces if p.start <= middle < p.stop), None)
            F = 0.0 if piece is None else piece.shifted(t - piece.start)[0]
            a = sla.solve(SYSTEM.M, np.array([0.4, 1.0]) * F - SYSTEM.C @ y[2:] - SYSTEM.K @ y[:2])
            return np.concatenate([y[2:], a])

        y = solve_ivp(rate, (t0, edge), y, rtol=1e-12, atol=1e-14, method="DOP853").y[:, -1]
        t0 = edge
    np.testing.assert_allclose(found[-1], y, atol=1e-10)


def test_after_the_force_the_motion_is_free() -> None:
    found = driven_motion(SYSTEM, [1.0, 0.0], triangle(3.0, 0.1, 0.15), 0.02, 200)
    np.testing.assert_allclose(found[13:], free_motion(SYSTEM, found[13, :2], found[13, 2:], 0.02, 187), atol=1e-13)
    assert force_at(triangle(3.0, 0.1, 0.15), 0.1) == 3.0
    assert force_at(triangle(3.0, 0.1, 0.15), 0.3) == 0.0


def test_beam_elements_approach_the_closed_forms() -> None:
    beam = Beam(0.8, 1.1, 2.5)
    errors = []
    for n in (4, 8):
        elements, middle = beam.elements(n)
        freq = np.sqrt(sla.eigh(elements.K, elements.M, eigvals_only=True)[:3])
        errors.append(np.abs(freq / beam.natural_freq_rad(3) - 1).max())
        # static deflection of the middle, exact for cubic elements
        assert middle @ sla.solve(elements.K, middle) == pytest.approx(0.8**3 / (48 * 2.5), rel=1e-10)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)
    omega = 0.4 * beam.natural_freq_rad(1)[0]
    modal = np.sum(beam.midspan_shapes(2000) ** 2 / (beam.natural_freq_rad(2000) ** 2 - omega**2))
    assert beam.midspan_receptance(omega) == pytest.approx(modal, rel=1e-9)
    with pytest.raises(ValueError, match="even"):
        beam.elements(3)
