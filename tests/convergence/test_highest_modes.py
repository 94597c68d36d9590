"""Errors of partials that modes near the Nyquist frequency, far above them, add.

A force that is constant over a step reaches a mode of frequency w, theta = w h / 2, as

    (phi^2 / w^2) (1 - cos w h) cos(W h / 2) / (cos W h - cos w h)     instead of     phi^2 / (w^2 - W^2)

at the frequency W, but for factors that all modes have in common. Of that, W^2 h^2 (phi^2 / w^2) e(theta) is an error,
e = 1/(4 sin^2 theta) - 1/(4 theta^2) - 1/12 = theta^2/60 + ...: the same for each mode of a string far below 1/h, and
more for those near it.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from assembled import poles_of, step_map
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.kernel import KernelStepper

FS, COUNT = 48000.0, 20
BODY = ModalBasis.real(np.array([2 * np.pi * 180.0]), np.array([0.0]), {"bridge": np.array([1 / np.sqrt(0.1)])})


def string(limit: float) -> ModalBasis:
    return string_basis(0.65, 80.0, 2e-3, 1e-5, lambda freq, k: np.zeros_like(freq), freq_upper=limit)


def modes(limit: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of string and body, and squares of their shapes at the joint."""
    parts = (string(limit), BODY)
    freq = np.concatenate([np.sqrt(b.stiffness) for b in parts])
    return freq, np.concatenate([b.right.real[b.index("bridge")] ** 2 for b in parts])


def stepped(limit: float, fs: float) -> np.ndarray:
    """Frequencies (rad/s) of the string on the body, as the engine steps them."""
    joint = Connection("bridge", (Term("string", "bridge"), Term("body", "bridge", -1.0)), Rigid())
    system = System.build({"string": string(limit), "body": BODY}, [joint], [], dt=1 / fs)
    return poles_of(step_map(system, KernelStepper), 1 / fs).imag[:COUNT]


def exact(limit: float) -> np.ndarray:
    """The same without steps: one zero of the sum of both receptances between every two of their modes."""
    freq, square = modes(limit)
    ends = np.sort(freq)[: COUNT + 1]
    eps = 1e-9 * ends
    return np.array([
        brentq(lambda w: np.sum(square / (freq**2 - w**2)), a + e, b - f, xtol=1e-9, rtol=1e-14)
        for a, b, e, f in zip(ends, ends[1:], eps, eps[1:], strict=False)
    ])  # fmt: skip


def foretold(limit: float, fs: float, at: np.ndarray) -> np.ndarray:
    """Errors of the frequencies `at`, from the sum of each mode's share."""
    freq, square = modes(limit)
    theta = 0.5 * freq / fs
    e = 1 / (4 * np.sin(theta) ** 2) - 1 / (4 * theta**2) - 1 / 12
    error = (at / fs) ** 2 * np.sum(square / freq**2 * e)
    return -error / np.array([np.sum(2 * w * square / (freq**2 - w**2) ** 2) for w in at])


@pytest.mark.parametrize(("limit", "fs"), [(5e3, FS), (10e3, FS), (20e3, FS), (10e3, FS / 2)])
def test_the_error_is_the_sum_of_what_each_mode_adds(limit: float, fs: float) -> None:
    truth = exact(limit)
    low = truth < 0.4 * fs
    error = stepped(limit, fs) - truth
    np.testing.assert_allclose(error[low][2:], foretold(limit, fs, truth)[low][2:], rtol=0.1)


def test_fewer_modes_at_the_same_rate_are_no_coarser_setting() -> None:
    """Partials are nearer with modes to 10 kHz than to 20 kHz, and farther at half the rate with either."""
    truth = exact(40e3)
    few, many, coarse = (
        np.abs(stepped(limit, fs) - truth)[5:] for limit, fs in ((10e3, FS), (20e3, FS), (10e3, FS / 2))
    )
    assert np.all(few < 0.6 * many)
    assert np.all(coarse > 5 * many)
