"""The bow: Helmholtz's motion, Schelleng's limits, and the work of the player's arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import Played, instrument, play

SPEED, BETA, STATIC, DYNAMIC = 0.1, 0.12, 0.8, 0.3
BOW: dict[str, Any] = {
    "plugin": "bow", "from_bridge": {"fraction": BETA}, "force": 0.5, "velocity": SPEED, "static": STATIC,
    "dynamic": DYNAMIC, "speed": 0.05, "attack_time": 0.02, "direction": "z",
}  # fmt: skip
#: a bowed string is well damped; its end here is all but rigid, so that the least bow force is small
STRING = {"loss": {"law": "sigma", "sigma0": 4.0, "sigma1": 3e-3}, "bending_stiffness": 1e-5}
Z = np.sqrt(73.9 * 3.61e-3)
FREQ = np.sqrt(73.9 / 3.61e-3) / 2 / 0.65


def bowed(folder: Path, force: float, duration: float = 0.6, **options: Any) -> Played:
    made = instrument(folder, STRING, exciters={"bow": {**BOW, "force": force}})
    return play(made, duration=duration, **options)


def slips(played: Played, force: float, last: float = 0.2) -> list[int]:
    """First samples of the slips of the last `last` s, by the jumps they send to the bridge."""
    f = played.forces["S.bow.hair"][-int(last / played.system.dt) :]
    assert np.abs(f).max() <= STATIC * force * (1 + 1e-9)
    jumps = np.abs(np.diff(played.out[-len(f) :]))
    starts = np.flatnonzero(jumps > 0.5 * jumps.max())
    return [int(s) for i, s in enumerate(starts) if i == 0 or s - starts[i - 1] > 0.2 / FREQ / played.system.dt]


def test_helmholtz(tmp_path: Path) -> None:
    """One slip in each period, at the string's own frequency; at the bridge the sawtooth of height 2 Z v / beta."""
    played = bowed(tmp_path, 0.7)
    tail = played.out[-9600:] - played.out[-9600:].mean()
    found = slips(played, 0.7)
    periods = np.diff(found) * played.system.dt
    assert len(found) == pytest.approx(0.2 * FREQ, abs=1.5)
    assert periods.std() < 0.02 * periods.mean()
    spectrum = np.abs(np.fft.rfft(tail * np.hanning(len(tail)), 16 * len(tail)))
    freq = np.fft.rfftfreq(16 * len(tail), played.system.dt)
    assert freq[spectrum[freq < 160].argmax()] == pytest.approx(FREQ, rel=0.01)
    # the corner carries a jump of velocity v / beta; when it turns at the rigid end the force jumps by 2 Z times that
    # (read off the first partial: a sawtooth of height H has one of H / pi)
    window, t = np.hanning(len(tail)), np.arange(len(tail)) * played.system.dt
    first = 2 * np.abs(np.sum(tail * window * np.exp(-2j * np.pi * freq[spectrum.argmax()] * t))) / window.sum()
    assert np.pi * first == pytest.approx(2 * Z * SPEED / BETA, rel=0.05)


@pytest.mark.parametrize("fs", [96000, 192000, 384000])
def test_helmholtz_at_any_rate(tmp_path: Path, fs: int) -> None:
    """The string's rolling under the hair has a resistance of its own, so that a finer step changes nothing."""
    played = bowed(tmp_path, 0.7, fs=fs)
    found = slips(played, 0.7)
    periods = np.diff(found) * played.system.dt
    assert len(found) == pytest.approx(0.2 * FREQ, abs=1.5)
    assert periods.std() < 0.02 * periods.mean()
    tail = played.out[-fs // 5 :] - played.out[-fs // 5 :].mean()
    t = np.arange(len(tail)) / fs
    window = np.hanning(len(tail))
    first = 2 * np.abs(np.sum(tail * window * np.exp(-2j * np.pi * t / periods.mean()))) / window.sum()
    assert np.pi * first == pytest.approx(2 * Z * SPEED / BETA, rel=0.05)


def test_too_light_a_bow_slips_twice(tmp_path: Path) -> None:
    """Below the least force sticking does not last the period."""
    assert len(slips(bowed(tmp_path, 0.3, 0.8), 0.3)) >= 1.8 * 0.2 * FREQ


def test_sawtooth_grows_with_the_bows_speed_not_its_force(tmp_path: Path) -> None:
    strong = np.ptp(bowed(tmp_path, 0.8).out[-4800:])
    weak = np.ptp(bowed(tmp_path, 0.7).out[-4800:])
    assert strong == pytest.approx(weak, rel=0.1)


def test_above_the_greatest_force_the_motion_is_raucous(tmp_path: Path) -> None:
    """Schelleng: N_max = 2 Z v / (beta (mu_s - mu_d)); four times that spoils the period."""
    greatest = 2 * Z * SPEED / (BETA * (STATIC - DYNAMIC))
    good = bowed(tmp_path, 0.3 * greatest).out[-9600:]
    bad = bowed(tmp_path, 5.0 * greatest).out[-9600:]

    def periodicity(x: np.ndarray) -> float:
        x = x - x.mean()
        lags = range(int(0.9 / FREQ * 48000), int(1.15 / FREQ * 48000))
        return max(float(x[lag:] @ x[:-lag] / (x @ x)) for lag in lags)

    assert periodicity(good) > 0.9
    assert periodicity(bad) < periodicity(good) - 0.1


def test_the_arm_pays(tmp_path: Path) -> None:
    """Bow's work = heat of slipping + losses + stored energy, step by step."""
    trace = bowed(tmp_path, 0.5, 0.1, energy=True).energy
    assert trace is not None
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < 1e-9
    supplied = sum(values.sum() for values in trace.supplied.values())
    lost = sum(values.sum() for values in trace.lost.values())
    assert supplied > 0
    assert lost > 0
    assert supplied == pytest.approx(trace.total[-1] + lost, rel=1e-8)
    assert all(values.min() >= -1e-12 * trace.peak for values in trace.lost.values())


def test_a_resting_bow_is_not_there(tmp_path: Path) -> None:
    both = instrument(tmp_path, exciters={"bow": BOW, "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.2}})
    alone = instrument(tmp_path, exciters={"pluck": {"plugin": "pluck_ramp", "from_bridge": 0.2}})
    ends = [play(made, {"force": 2.0}, duration=0.05, exciter="pluck").out for made in (both, alone)]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-12 * np.abs(ends[0]).max())
