"""The direct solutions, each against another way to the same number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.integrate import solve_ivp

from tonewood.lab import assembled
from tonewood.lab.assembled import Matrices
from tonewood.lab.systems.harp_body import harp_body, harp_body_matrices, harp_body_table

CHAIN = assembled.chain([1.0, 0.5, 2.0], [0.3, 0.1, 0.7], [200.0, 100.0, 400.0])


def test_chain_written_out():
    np.testing.assert_allclose(CHAIN.K, [[300, -100, 0], [-100, 500, -400], [0, -400, 400]])
    right = assembled.chain([1.0, 0.5], [0.1, 0.2], [10.0, 20.0], wall="right")
    np.testing.assert_allclose(right.K, [[10, -10], [-10, 30]])
    np.testing.assert_allclose(right.C, [[0.1, -0.1], [-0.1, 0.3]])
    with pytest.raises(ValueError, match="links"):
        assembled.chain([1.0], [0.1, 0.2], [1.0])


def test_poles_of_one_oscillator():
    pole = assembled.poles(Matrices(np.eye(1) * 2, np.eye(1) * 0.8, np.eye(1) * 50))[0]
    assert pole == pytest.approx(-0.2 + 1j * np.sqrt(25 - 0.04))


def test_motions_agree_with_an_ode_solver():
    A = assembled.state_matrix(CHAIN)
    x0, v0 = np.array([0.1, 0.0, -0.2]), np.array([0.0, 1.0, 0.0])
    motion = assembled.free_motion(CHAIN, x0, v0, 0.05, 41)
    direction = np.array([0.0, 1.0, 0.5])

    def rate(t, x, force):
        return A @ x + np.concatenate([np.zeros(3), sla.solve(CHAIN.M, direction)]) * force(t)

    solved = solve_ivp(
        rate, (0, 2), np.concatenate([x0, v0]), args=(lambda t: 0.0,), t_eval=[2.0], rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(motion[-1], solved.y[:, 0], atol=1e-8)
    kind = {"rtol": 1e-10, "atol": 1e-13}
    up = solve_ivp(rate, (0, 1), np.zeros(6), args=(lambda t: 3 * t,), t_eval=[0.5, 1.0], **kind)
    down = solve_ivp(rate, (1, 2), up.y[:, 1], args=(lambda t: 0.0,), t_eval=[2.0], **kind)
    got = assembled.ramp_and_release(CHAIN, direction, 3.0, 1.0, [0.5, 1.0, 2.0], [0, 0, 1])
    np.testing.assert_allclose(got, [up.y[2, 0], up.y[2, 1], down.y[2, 0]], atol=1e-9)


def test_receptances_agree():
    s = np.array([3j, -0.1 + 12j, 1.0])
    direct = assembled.receptance(CHAIN, s, 2, 0)
    np.testing.assert_allclose(assembled.modal_receptance(CHAIN, s, [0, 0, 1], [1, 0, 0]), direct, rtol=1e-10)
    static = sla.inv(CHAIN.K)[2, 0]
    assert assembled.receptance(CHAIN, 0.0, 2, 0)[0] == pytest.approx(static)


def test_harp_body_is_passive_and_its_table_is_the_body():
    matrices, points = harp_body_matrices()
    assert sla.eigvalsh(matrices.C)[0] > 0
    names, values = harp_body_table()
    assert names[:4] == ["f_Hz", "zeta", "s1_right_re", "s1_right_im"]
    assert values.shape == (32, 2 + 4 * 8)
    table = dict(zip(names, values.T, strict=True))
    omega = 2 * np.pi * table["f_Hz"]
    pole = omega * (-table["zeta"] + 1j * np.sqrt(1 - table["zeta"] ** 2))
    right = table["s4_right_re"] + 1j * table["s4_right_im"]
    left = table["s2_left_re"] + 1j * table["s2_left_im"]
    s = 2j * np.pi * np.array([100.0, 741.0, 1500.0])
    from_table = np.sum(right * left / (s[:, None] - pole) + np.conj(right * left) / (s[:, None] - pole.conj()), axis=1)
    direct = [points["s4"] @ sla.solve(v**2 * matrices.M + v * matrices.C + matrices.K, points["s2"]) for v in s]
    np.testing.assert_allclose(from_table, direct, rtol=1e-9)
    assert harp_body().points == tuple(f"s{i}" for i in range(1, 9))


def test_table_of_the_harp_bundle_is_the_stand_in():
    path = Path(__file__).parents[3] / "instruments" / "african_harp" / "body.csv"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    names, values = harp_body_table()
    assert lines[0].split(",") == names
    table = np.array([line.split(",") for line in lines[1:]], dtype=float)
    np.testing.assert_allclose(table[:, :2], values[:, :2], rtol=1e-9)
    # a complex shape of Pi = 1 has no sign of its own, a residue (right at one point, left at another) does
    residues = []
    for rows in (table, values):
        right, left = rows[:, 2::4] + 1j * rows[:, 3::4], rows[:, 4::4] + 1j * rows[:, 5::4]
        residues.append(right[:, :, None] * left[:, None, :])
    assert residues[0].shape == (32, 8, 8)
    np.testing.assert_allclose(*residues, rtol=0, atol=1e-9 * np.abs(residues[1]).max())
