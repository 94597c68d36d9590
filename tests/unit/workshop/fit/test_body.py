"""From residues to a body: passive, of rank one, and the same after it was written and read."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla
from fit_scenes import random_body
from tonewood.plugins.modal_table import ModalTable

from tonewood.instrument.contract.files import Files
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.folder import FitFolder
from tonewood.workshop.fit.responses import Responses

FREQ = np.arange(70.0, 2000.5)


@pytest.fixture(scope="module")
def scene():
    """Three points, each driven; two modes coincide in frequency and damping with different shapes."""
    truth = random_body(6, seed=21, n_points=3)
    shapes = truth.residues / np.sqrt(truth.residues[0])
    freq, quality = np.append(truth.freq, truth.freq[3]), np.append(truth.quality, truth.quality[3])
    shapes = np.concatenate([shapes, np.roll(shapes[:, 3:4], 1, axis=0) * [[1.0], [-1.0], [0.7]]], axis=1)
    names = "abc"
    pairs = tuple((p, r) for r in names for p in names)
    s, w = 2j * np.pi * FREQ, 2 * np.pi * freq[:, None]
    resonance = s / (s * s + w / quality[:, None] * s + w * w)
    clean = np.array([(shapes[names.index(p)] * shapes[names.index(r)]) @ resonance for p, r in pairs])
    rng = np.random.default_rng(0)
    sigma = 0.001 * np.sqrt(np.mean(np.abs(clean) ** 2, axis=1, keepdims=True))
    noisy = clean + sigma / np.sqrt(2) * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
    return SimpleNamespace(pairs=pairs, clean=clean, noisy=noisy, freq=freq, quality=quality)


def rms_db(a, b):
    return float(np.sqrt(np.mean((20 * np.log10(np.abs(a / b))) ** 2)))


@pytest.mark.validate
def test_three_references_find_coincident_modes_and_one_says_what_it_cannot(scene):
    every = fit_responses(Responses(FREQ, scene.noisy, scene.pairs))
    one = fit_responses(Responses(FREQ, scene.noisy[:3], scene.pairs[:3]))
    assert np.count_nonzero(every.body.measured) == scene.freq.size
    whole = every.body.mobility(FREQ, scene.pairs)
    assert rms_db(whole, scene.clean) < 0.2
    assert rms_db(one.body.mobility(FREQ, scene.pairs[:3]), scene.clean[:3]) < 0.15
    # among undriven points one reference is off, as its warning says
    assert rms_db(one.body.mobility(FREQ, scene.pairs[3:]), scene.clean[3:]) > 0.5
    assert any("driven at a alone" in line for line in one.warnings)
    assert not any("alone" in line for line in every.warnings)


@pytest.mark.slow
def test_modes_outside_the_band_leave_a_compliance_that_is_passive():
    truth = random_body(9, seed=7, high=3500.0)
    mobility, _ = truth.noisy(FREQ, 0.005, seed=2)
    fit = fit_responses(Responses(FREQ, mobility, (("a", "a"), ("b", "a"))))
    assert np.count_nonzero(truth.freq > FREQ[-1]) >= 1
    assert fit.body.compliance[0, 0] > 0 or np.any(fit.body.freq > FREQ[-1])
    assert sla.eigvalsh(fit.body.compliance).min() >= -1e-25
    assert rms_db(fit.mobility, truth.mobility(FREQ)) < 0.2


@pytest.mark.validate
def test_the_body_plays_what_was_fitted(scene, tmp_path):
    """Written, read by `modal_table`, and asked for its mobility: the same to 1e-9; real modes, so passive."""
    fit = fit_responses(Responses(FREQ, scene.noisy, scene.pairs))
    FitFolder(fit).write(tmp_path)
    facts = json.loads((tmp_path / "fit.json").read_text())
    assert len(facts["modes"]) == fit.body.freq.size
    points = {name: {"direction": "z"} for name in "abc"}
    given = {
        "table": "body.csv", "shapes": "points", "points": points,
        "truncation": {"residual_compliance": fit.body.compliance.tolist()},
    }  # fmt: skip
    files = Files(tmp_path, tmp_path / "instrument.yaml")
    basis = ModalTable.from_values(given, files, "body").basis(1e6)
    assert basis.is_real
    for i, (point, reference) in enumerate(scene.pairs):
        got = basis.frf(FREQ, point, reference, "mobility")
        assert np.allclose(got, fit.mobility[i], rtol=1e-9, atol=1e-9 * np.abs(fit.mobility[i]).max())
