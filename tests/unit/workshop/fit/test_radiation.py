"""Microphones: a bank of known poles and residues, driven at two places of a bridge."""

from __future__ import annotations

import numpy as np
import pytest
from fit_scenes import TAU, random_body

from tonewood.errors import TonewoodError
from tonewood.workshop.fit.fit import fit_responses
from tonewood.workshop.fit.radiation import FittedRadiation, fit_radiation
from tonewood.workshop.fit.responses import Responses

FREQ = np.arange(70.0, 700.0)
BODY = random_body(4, seed=6, n_points=2, high=600.0)
RNG = np.random.default_rng(3)
#: heave and moment of two microphones, Pa/(N s); the last pole is a cavity's, which the body does not have
POLES = np.append(TAU * BODY.freq * (-0.5 / BODY.quality + 1j), TAU * 333.0 * (-0.02 + 1j))
HEAVE, MOMENT = (s * (RNG.normal(size=(2, 5)) + 1j * RNG.normal(size=(2, 5))) for s in (30.0, 10.0))


def pressure(u):
    s = 1j * TAU * FREQ[:, None]
    residues = HEAVE + u * MOMENT
    return residues @ (1 / (s - POLES)).T + residues.conj() @ (1 / (s - POLES.conj())).T


def measured(places):
    """Both points driven, both microphones, 0.2 % noise."""
    shapes = BODY.residues / np.sqrt(BODY.residues[0])
    s, w = 1j * TAU * FREQ, TAU * BODY.freq[:, None]
    resonance = s / (s * s + w / BODY.quality[:, None] * s + w * w)
    pairs = tuple((p, r) for r in places for p in "ab")
    rows = [(shapes["ab".index(p)] * shapes["ab".index(r)]) @ resonance for p, r in pairs]
    heard = {(name, r): row for r, u in places.items() for name, row in zip(("l", "r"), pressure(u), strict=True)}

    def noisy(row):
        size = 0.002 * np.sqrt(np.mean(np.abs(row) ** 2) / 2)
        return row + size * (RNG.normal(size=row.size) + 1j * RNG.normal(size=row.size))

    return Responses(FREQ, np.array([noisy(r) for r in rows]), pairs, pressure={k: noisy(v) for k, v in heard.items()})


@pytest.mark.slow
def test_two_places_tell_heave_from_rock():
    places = {"a": -0.5, "b": 0.5}
    given = measured(places)
    found = fit_radiation(given, fit_responses(given).body, places)
    assert found is not None
    assert found.channels == ("l", "r")
    for u in (-0.5, 0.0, 1.0):
        assert np.abs(found.pressure(FREQ, u) - pressure(u)).max() < 0.02 * np.abs(pressure(u)).max()
    rows = [line.split(",") for line in found.table().splitlines() if line[0] != "#"]
    assert rows[0][:3] == ["f_Hz", "Q", "l_re"]
    assert [float(row[2]) for row in rows[1:]] == found.heave[0].real.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("place", [0.0, 0.7])
def test_one_place_tells_nothing_of_rock(place):
    given = measured({"a": place})
    found = fit_radiation(given, fit_responses(given).body, {"a": place} if place else {})
    assert found is not None
    assert not found.moment.any()
    assert np.sqrt(np.mean(found.error_db**2)) < 0.5


@pytest.mark.slow
def test_what_is_missing_is_reported():
    given = measured({"a": 0.0, "b": 0.0})
    body = fit_responses(given).body
    with pytest.raises(TonewoodError, match="say where these lie along the bridge"):
        fit_radiation(given, body, {})
    given.pressure.pop(("l", "b"))
    with pytest.raises(TonewoodError, match="microphone 'l' was not measured from 'b'"):
        fit_radiation(given, body, {"a": -0.5, "b": 0.5})
    assert fit_radiation(Responses(FREQ, given.mobility, given.pairs), body, {}) is None


@pytest.mark.parametrize("u", [0.0, 1.0])
def test_a_bank_is_the_sum_of_its_poles_behind_its_high_pass(u):
    """Its real impulse response by a sum over time, 4 s at 20 kHz; a pole of the high-pass each side of the cut."""
    fs, cut = 20000.0, 50.0
    bank = FittedRadiation(("l", "r"), POLES, cut, HEAVE, MOMENT, np.zeros((2, 0)))
    t = np.arange(4 * 20000) / fs
    impulse = 2 * ((HEAVE + u * MOMENT) @ np.exp(POLES[:, None] * t)).real
    impulse[:, 0] *= 0.5
    s = 1j * TAU * FREQ[::70]
    expected = impulse @ np.exp(-np.outer(t, s)) / fs * s**2 / ((s + 0.8 * TAU * cut) * (s + 1.25 * TAU * cut))
    np.testing.assert_allclose(bank.pressure(FREQ[::70], u), expected, atol=2e-3 * np.abs(expected).max())
