"""Responses of a body at the strings' ends: against the sum over modes, and in bounded memory."""

from __future__ import annotations

import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.contract.registry import instrument_folder
from tonewood.instrument.model.assembly import assemble
from tonewood.performance.effects import bridge_response
from tonewood.physics.coupling.system import Compiled


@pytest.fixture(scope="module")
def body() -> Compiled:
    system = assemble(tw.load_instrument("classical_guitar"), 48000).system
    return system.compiled[system.slot("body")]


@pytest.mark.parametrize("at_once", [1, 1000, 10**9])
def test_response_is_the_sum_over_modes(
    body: Compiled, at_once: int, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """sum_k r_k l_k^T / (s - lambda_k), both poles of each pair, and the residual compliance."""
    monkeypatch.setattr(bridge_response, "_AT_ONCE", at_once)
    basis, n = body.basis, len(body.basis.points)
    out, into = rng.normal(size=(3, n)), rng.normal(size=(2, n))
    freq_rad = 2 * np.pi * np.geomspace(30.0, 9000.0, 37)
    found = bridge_response.response(body.basis, body.form, freq_rad, out, into)
    assert found.shape == (3, 2, 37)
    for i, w in enumerate(freq_rad):
        wanted = basis.residual.astype(complex)
        for pole, right, left in zip(basis.poles, basis.right.T, basis.left.T, strict=True):
            one = np.outer(right, left)
            wanted += one / (1j * w - pole) + one.conj() / (1j * w - np.conj(pole))
        wanted = out @ wanted @ into.T
        assert found[..., i] == pytest.approx(wanted, rel=1e-9, abs=1e-9 * np.abs(wanted).max())


def test_response_without_ends_readings_modes_or_frequencies(body: Compiled) -> None:
    n = len(body.basis.points)
    some, none, freq_rad = np.ones((2, n)), np.zeros((2, n)), np.array([100.0, 200.0, 300.0])
    assert not bridge_response.response(body.basis, body.form, freq_rad, some, none).any()
    assert not bridge_response.response(body.basis, body.form, freq_rad, none, some).any()
    assert bridge_response.response(body.basis, body.form, freq_rad, np.zeros((0, n)), some).shape == (0, 2, 3)
    assert bridge_response.response(body.basis, body.form, freq_rad[:0], some, some).shape == (2, 2, 0)


def test_memory_grows_with_frequencies_plus_modes(tmp_path: Path) -> None:
    """A body of 1500 modes is looked at at 1748 frequencies: one array over both would take 80 MB."""
    folder = tmp_path / "body"
    shutil.copytree(instrument_folder("monochord"), folder)
    rows = "\n".join(f"{f},30,10,1" for f in np.linspace(60, 20000, 1500))
    (folder / "body.csv").write_text(f"f_Hz,Q,modal_mass,bridge\n{rows}\n")
    model = assemble(tw.load_instrument(folder), 48000)
    tracemalloc.start()
    try:
        found = bridge_response.BridgeResponse(model)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.freq_rad.size > 1700
    # `_AT_ONCE` complex numbers in states, four times with everything else; the result is small beside them
    assert peak < 4 * 16 * bridge_response._AT_ONCE + 2_000_000
