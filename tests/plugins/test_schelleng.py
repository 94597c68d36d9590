"""Schelleng's map of the bow: which forces keep Helmholtz's motion, at places along the string.

    N_max = 2 Z v / (beta (mu_s - mu_d)),      N_min = Z^2 v / (2 beta^2 r (mu_s - mu_d))

(J. C. Schelleng, J. Acoust. Soc. Am. 53, 1973). Here the string has its loss in itself: a rate sigma at its end stands
for r = 2 Z f / sigma there. The upper bound is one of a period's timing and holds well; the lower one is the force that
just keeps the motion up, and a bow that starts on a resting string, as here, needs some three to four times as much,
alike at all places.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scene import instrument, play
from test_bow import BOW, DYNAMIC, FREQ, SPEED, STATIC, Z, slips

from tonewood.instrument.assembly import Model, assemble

SIGMA = 8.0
STRING = {"loss": {"law": "sigma", "sigma0": SIGMA, "sigma1": 3e-4}, "bending_stiffness": 0.0}
PLACES = (0.07, 0.11, 0.17)


def greatest(beta: float) -> float:
    return 2 * Z * SPEED / (beta * (STATIC - DYNAMIC))


def least(beta: float) -> float:
    return Z**2 * SPEED / (2 * beta**2 * (2 * Z * FREQ / SIGMA) * (STATIC - DYNAMIC))


def model(folder: Path, beta: float) -> Model:
    bow = {**BOW, "from_bridge": {"fraction": beta}}
    return assemble(instrument(folder, STRING, exciters={"bow": bow}), 48000)


def is_helmholtz(string: Model, beta: float, force: float) -> bool:
    """One slip per period, period after period, and at the bridge steps of 2 Z v / beta."""
    played = play(string, {"force": force}, duration=1.0)
    tail = played.out[-9600:] - played.out[-9600:].mean()
    lags = range(int(0.9 / FREQ * 48000), int(1.15 / FREQ * 48000))
    periodic = max(float(tail[lag:] @ tail[:-lag] / (tail @ tail)) for lag in lags)
    size = np.ptp(tail) / (2 * Z * SPEED / beta)
    return periodic > 0.9 and abs(len(slips(played, force)) - 0.2 * FREQ) < 1.6 and 0.9 < size < 2.0


@pytest.mark.parametrize("beta", PLACES)
def test_inside_and_outside(tmp_path: Path, beta: float) -> None:
    string = model(tmp_path, beta)
    assert is_helmholtz(string, beta, 5 * least(beta))
    for force in (0.3 * least(beta), least(beta), 2 * greatest(beta), 4 * greatest(beta)):
        assert not is_helmholtz(string, beta, force)


@pytest.mark.validate
def test_the_map(tmp_path: Path) -> None:
    """Tenths of a decade in force: the bounds go with the powers of the place that Schelleng found, 1 and 2."""
    bounds = []
    for beta in PLACES:
        string = model(tmp_path, beta)
        forces: NDArray[np.float64] = greatest(beta) * 10 ** np.arange(-2.0, 0.65, 0.1)
        good = np.flatnonzero([is_helmholtz(string, beta, float(force)) for force in forces])
        low, high = forces[good[0]], forces[good[-1]]
        assert 0.6 < high / greatest(beta) < 1.3
        assert 2.0 < low / least(beta) < 5.0
        assert len(good) >= 0.7 * (good[-1] - good[0] + 1)  # inside nearly everywhere
        bounds.append((low, high))
    low, high = np.log(np.array(bounds)).T
    assert np.polyfit(np.log(PLACES), high, 1)[0] == pytest.approx(-1.0, abs=0.3)
    assert np.polyfit(np.log(PLACES), low, 1)[0] == pytest.approx(-2.0, abs=0.4)
