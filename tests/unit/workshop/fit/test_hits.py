"""Hammer hits: the window's line, estimators against scipy's, double hits."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from fit_scenes import Truth

from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.hits import is_double, responses_of_hits
from tonewood.workshop.fit.responses import Responses, to_mobility

FS = 8192.0


def pulse(n, at=40, width=12, height=20.0, second=0.0, later=400):
    t = np.arange(n)
    force = height * np.exp(-0.5 * ((t - at) / (width / 4)) ** 2)
    if second:
        force = force + second * height * np.exp(-0.5 * ((t - at - later) / (width / 4)) ** 2)
    return force


def struck(truth, force):
    """(P, n) displacement under a force held over samples.

    The discrete modes are those of scipy's zero-order hold, so that nothing of the code under test is in it.
    """
    out = np.zeros((len(truth.residues), force.size))
    for f, q, residues in zip(truth.freq, truth.quality, truth.residues.T, strict=True):
        w = 2 * np.pi * f
        matrices = ([[0, 1], [-w * w, -w / q]], [[0], [1]], [[1, 0]], [[0]])
        system = tuple(np.array(x, dtype=float) for x in matrices)
        a, b, c, d, _ = scipy.signal.cont2discrete(system, 1 / FS, method="zoh")
        _, y, _ = scipy.signal.dlsim((a, b, c, d, 1 / FS), force)
        out += residues[:, None] * y[:, 0]
    return out


def test_one_window_on_both_channels_is_exact():
    """Modes that ring far beyond the record: no body without a window; with one the line Re s = a has them."""
    truth = Truth(np.array([412.0, 777.0]), np.array([600.0, 350.0]), np.array([[5.0, 3.0]]))
    n, rng = int(0.5 * FS), np.random.default_rng(1)
    force = np.array([pulse(n, height=h) for h in (10.0, 15.0, 20.0, 12.0)])
    motion = np.array([struck(truth, f) for f in force])
    motion += 1e-6 * np.abs(motion).max() * rng.normal(size=motion.shape)

    def seen(tau):
        made = responses_of_hits(force, motion, FS, window_tau=tau)
        mobility = to_mobility(made.response, made.freq, "receptance", made.alpha)
        given = Responses(made.freq, mobility, (("a", "a"),), alpha=made.alpha).band(300.0, 900.0)
        s = given.alpha + 2j * np.pi * given.freq
        held = (1 - np.exp(-s / FS)) / (s / FS)  # the force is held over samples
        return Responses(given.freq, given.mobility / held, given.pairs, alpha=given.alpha)

    assert "--window-tau" in seen(None).no_body()
    body = fit_responses(seen(0.1)).body
    near = [int(np.argmin(np.abs(body.freq - f))) for f in truth.freq]
    assert body.quality[near] == pytest.approx(truth.quality, rel=0.02)
    assert body.shapes[near, 0] ** 2 == pytest.approx(truth.residues[0], rel=0.02)


def test_estimators_are_scipys():
    """H1, H2 and coherence of whole records against scipy.signal's spectra, one segment a hit."""
    rng = np.random.default_rng(0)
    n, hits = 1024, 6
    force = np.array([pulse(n) for _ in range(hits)]) + 1e-3 * rng.normal(size=(hits, n))
    motion = rng.normal(size=(hits, 1, n)) + 0.5 * force[:, None]
    options = {"fs": FS, "window": "boxcar", "nperseg": n, "noverlap": 0, "detrend": False}
    x, y = force.ravel(), motion[:, 0].ravel()
    _, xx = scipy.signal.welch(x, **options)
    _, yy = scipy.signal.welch(y, **options)
    freq, xy = scipy.signal.csd(x, y, **options)
    for estimator, reference in (("H1", xy / xx), ("H2", yy / xy.conj())):
        made = responses_of_hits(force, motion, FS, estimator=estimator)
        inner = slice(1, -1)
        assert np.allclose(made.freq, freq)
        assert np.allclose(made.response[0, inner], reference[inner], rtol=1e-10)
    assert np.allclose(made.coherence[0, 1:-1], (np.abs(xy) ** 2 / (xx * yy))[1:-1], rtol=1e-10)


def test_double_hits_are_distinguished_from_noise():
    rng = np.random.default_rng(3)
    n = 4096
    single = [pulse(n, at=int(rng.integers(30, 200))) + 0.02 * rng.normal(size=n) for _ in range(60)]
    double = [
        pulse(n, second=share, later=int(rng.integers(80, 2000))) + 0.02 * rng.normal(size=n)
        for share in np.repeat((0.05, 0.10, 0.30), 20)
    ]
    assert sum(is_double(x, FS) for x in single) == 0
    assert sum(is_double(x, FS) for x in double) == 60
    assert sum(is_double(x[::-1], FS) for x in double) == 60  # the smaller pulse may come first
    assert sum(is_double(x[::-1], FS) for x in single) == 0


def test_two_single_hits_are_needed():
    n = 2048
    force = np.array([pulse(n), pulse(n, second=0.3), pulse(n, second=0.2)])
    with pytest.raises(ValueError, match="1 of 3 hits are single"):
        responses_of_hits(force, force[:, None], FS)
