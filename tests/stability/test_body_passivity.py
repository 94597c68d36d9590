"""Truncated complex-mode bodies with strings on them: left alone they explode, repaired they cannot.

Asserted: growth of the coupled one-step map (its spectral radius, hence energy for ever), and that repairing costs
less than truncating did. The map is assembled here, from matrix exponentials.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from random_bodies import DAMPING, STRINGS, body, coupled_map, energy_form, growth, static_compliance, string_end
from tonewood.physics.passivity.conditions import check
from tonewood.physics.passivity.repair import repair
from tonewood.physics.passivity.storage import storage_matrix

DT = 1 / 48000


def dropped_compliance(one, kept):
    """Static compliance of the modes that were left out: the joint's residual."""
    return static_compliance(*one.modes) - static_compliance(*kept)


def band_error(one, modes, omega):
    """Relative rms error of the mobility against the matrices."""
    true = one.mobility(omega)
    poles, right, left = modes
    made = np.zeros_like(true)
    for pole, r, l_ in zip(poles, right.T, left.T, strict=True):
        residue = np.outer(r, l_)
        for p, n in [(pole, residue), (pole.conj(), residue.conj())] if pole.imag else [(pole, residue)]:
            made += (1j * omega / (1j * omega - p))[:, None, None] * n
    return float(np.sqrt((np.abs(made - true) ** 2).sum() / (np.abs(true) ** 2).sum()))


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("medium", 2), ("heavy", 0)])
def test_truncated_body_explodes_and_repaired_one_does_not(kind, seed):
    one = body(seed, DAMPING[kind])
    kept = one.truncated()
    residual = dropped_compliance(one, kept)
    assert linalg.eigvalsh(residual)[0] > 0
    assert not check(*kept).passive
    step, _ = coupled_map(kept, STRINGS, DT, residual)
    assert growth(step) > 1e-4
    for _ in range(15):
        step = step @ step
    # 2^15 steps: less than a second of sound, 40 dB up and more
    assert np.abs(linalg.eigvals(step)).max() > 100

    new = repair(*kept)
    modes = new.poles, new.right, new.left
    step, gap = coupled_map(modes, STRINGS, DT, residual)
    assert growth(step) < -1e-6
    # whatever the state, a step does not raise the energy of body, strings and joints
    parts = [new.storage.P, *(storage_matrix(*string).P for string in STRINGS)]
    forms = [energy_form(part[0], P) for part, P in zip([modes, *STRINGS], parts, strict=True)]
    energy = linalg.block_diag(*forms) + 0.5 * gap.T @ linalg.solve(residual, gap)
    ratio = linalg.eigvalsh(step.T @ energy @ step, energy)
    assert ratio[-1] < 1 + 1e-9
    # the complete body is stable as it is, and the repaired one is as near to it as the truncated one
    assert growth(coupled_map(one.modes, STRINGS, DT, 1e-9 * np.eye(3))[0]) < -1e-6
    omega = 2 * np.pi * np.linspace(60, kept[0].imag.max() / 2 / np.pi, 400)
    assert band_error(one, modes, omega) < 1.1 * band_error(one, kept, omega)


@pytest.mark.validate
def test_twelve_truncated_bodies():
    failing, exploding = 0, 0
    for zeta in DAMPING.values():
        for seed in range(4):
            one = body(seed, zeta)
            kept = one.truncated()
            residual = dropped_compliance(one, kept)
            failing += not check(*kept).passive
            exploding += growth(coupled_map(kept, STRINGS, DT, residual)[0]) > 0
            assert check(*one.modes, dt=DT).passive
            new = repair(*kept)
            modes = new.poles, new.right, new.left
            assert check(*modes, dt=DT).passive
            assert growth(coupled_map(modes, STRINGS, DT, residual)[0]) < -1e-6
            omega = 2 * np.pi * np.linspace(60, kept[0].imag.max() / 2 / np.pi, 400)
            assert band_error(one, modes, omega) < 1.2 * band_error(one, kept, omega)
    assert failing == 12
    assert exploding >= 6


@settings(max_examples=10)
@given(
    st.integers(0, 10**6),
    st.floats(0.002, 0.1),
    st.sampled_from([1 / 8000, 1 / 48000, 1 / 192000]),
    st.floats(1e-4, 1.0),
    st.floats(-9, -5),
)
def test_passive_bodies_never_make_the_map_grow(seed, zeta, dt, mass, log_residual):
    """Any body that passes, any strings, any step (modes far above Nyquist too), any joint."""
    rng = np.random.default_rng(seed)
    one = body(seed, zeta, n_dof=8, n_ports=2, mass=mass)
    strings = [string_end(*rng.uniform([20, 2e-4], [200, 2e-2]), n_sines=6) for _ in range(2)]
    joint = 10**log_residual * np.eye(2)
    assert check(*one.modes, dt=dt).passive
    assert growth(coupled_map(one.modes, strings, dt, joint)[0]) < 1e-10
    new = repair(*one.truncated(), max_change=10.0, max_iterations=20)
    assert check(new.poles, new.right, new.left, dt=dt).passive
    assert growth(coupled_map((new.poles, new.right, new.left), strings, dt, joint)[0]) < 1e-10
