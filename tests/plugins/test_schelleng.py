"""Schelleng's map of the bow: which forces keep Helmholtz's motion, at places along the string.

    N_max = 2 Z v / (beta (mu_s - mu_d)),      N_min = Z^2 v / (2 beta^2 r (mu_s - mu_d))

(J. C. Schelleng, J. Acoust. Soc. Am. 53, 1973). Here the string has its loss in itself: a rate sigma at its end stands
for r = 2 Z f / sigma there. The upper bound is one of a period's timing and holds well; the lower one is the force that
just keeps the motion up, and a bow that starts on a resting string, as here, needs some four to five times as much,
alike at all places.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scene import instrument, play
from test_bow import BOW, DYNAMIC, FREQ, SPEED, STATIC, Z, slips

from tonewood.instrument.model.assembly import Model, assemble

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
    assert is_helmholtz(string, beta, 0.7 * greatest(beta))
    for force in (0.3 * least(beta), least(beta), 2 * greatest(beta), 4 * greatest(beta)):
        assert not is_helmholtz(string, beta, force)


@pytest.mark.validate
def test_the_map(tmp_path: Path) -> None:
    """The bounds go with the powers of the place that Schelleng found, 1 and 2.

    Near a bound rounding decides whether a stroke becomes periodic. So a bound is where half of all strokes do: the
    share of five that differ by 20 % in force, each tenth of a decade, is summed from well inside outwards. Measured:
    low bounds 3.9, 5.2 and 4.6 times Schelleng's, high ones 0.9 to 1.1; single strokes scatter by a factor of 1.6.
    """
    bounds, inside = [], 9
    steps = 0.1 * (np.arange(15.0) - inside)
    for beta in PLACES:
        string = model(tmp_path, beta)
        forces: NDArray[np.float64] = 10**-0.2 * greatest(beta) * 10**steps
        near = 10 ** np.linspace(-0.04, 0.04, 5)
        share = np.array([np.mean([is_helmholtz(string, beta, float(f * k)) for k in near]) for f in forces])
        assert share[inside] == 1.0
        low = forces[inside] * 10 ** (-0.1 * (share[:inside].sum() + 0.5))
        high = forces[inside] * 10 ** (0.1 * (share[inside + 1 :].sum() + 0.5))
        assert 0.6 < high / greatest(beta) < 1.3
        assert 3.0 < low / least(beta) < 7.0
        bounds.append((low, high))
    low, high = np.log(np.array(bounds)).T
    assert np.polyfit(np.log(PLACES), high, 1)[0] == pytest.approx(-1.0, abs=0.3)
    assert np.polyfit(np.log(PLACES), low, 1)[0] == pytest.approx(-2.0, abs=0.4)
