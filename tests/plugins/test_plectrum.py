"""The plectrum: where and when the string slips off, its energy then, and the slow one that is a known force."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import PLUCK, Played, instrument, play

import tonewood as tw
from tonewood.errors import BundleError

PLACE, LENGTH, TENSION, DENSITY = 0.15, 0.65, 73.9, 3.61e-3
FREQ = np.sqrt(TENSION / DENSITY) / 2 / LENGTH
COMPLIANCE = PLACE * (LENGTH - PLACE) / (TENSION * LENGTH)
STRING = {"bending_stiffness": 0.0, "freq_upper": 20000.0}
PLECTRUM: dict[str, Any] = {"plugin": "plectrum", "from_bridge": PLACE, "force": 2.0, "stiffness": 2e3, "speed": 0.03}


def plucked(folder: Path, energy: bool = False, **values: Any) -> Played:
    made = instrument(folder, STRING, exciters={"plectrum": {**PLECTRUM, **values}})
    return play(made, duration=0.1, energy=energy)


def test_it_slips_at_its_force_and_on_time(tmp_path: Path) -> None:
    """F = X / (1 / k + C) until F is the limit: then, at the note's time, the string slips off."""
    for stiffness, speed in ((2e3, 0.03), (2e4, 0.1), (5e2, 0.1)):
        played = plucked(tmp_path, stiffness=stiffness, speed=speed)
        force = played.forces["S.plectrum.edge"]
        slip = int(np.flatnonzero(force > 0.9 * 2.0)[-1])
        assert force.max() == pytest.approx(2.0, rel=5e-3)
        assert force.max() <= 2.0 * (1 + 1e-9)
        assert abs(played.time[slip]) < 2.5e-4
        # the string then lets go all but at once: its own speed F / 2Z is far beyond the slip speed
        assert force[slip + 2] < 0.05 * 2.0


def test_force_on_the_way_follows_the_springs_in_series(tmp_path: Path) -> None:
    """On its way the force is X(t) / (1 / k + C); on the bridge its share 1 - x / L."""
    played = plucked(tmp_path)
    drawn = 2.0 * (1 / 2e3 + COMPLIANCE) / 0.03
    force = played.forces["S.plectrum.edge"]
    for share in (0.3, 0.5, 0.7):
        i = int(np.searchsorted(played.time, -share * drawn))
        period = slice(i, i + round(1 / FREQ / played.system.dt))
        middle = played.time[period].mean() + 0.5 * played.system.dt
        assert force[period].mean() == pytest.approx(2.0 + 0.03 * middle / (1 / 2e3 + COMPLIANCE), rel=5e-3)
        assert played.out[period].mean() == pytest.approx(force[period].mean() * (1 - PLACE / LENGTH), rel=5e-3)


def harmonics(signal: np.ndarray, time: np.ndarray, n: int = 12) -> np.ndarray:
    window = np.hanning(len(signal))
    waves = np.exp(-2j * np.pi * FREQ * np.arange(1, n + 1)[:, None] * time)
    return np.abs(waves @ (signal * window)) / window.sum()


def test_a_slow_one_is_a_known_force(tmp_path: Path) -> None:
    """Drawn slowly, with an edge that lets go at once: the partials of `pluck_ramp`."""
    slow = plucked(tmp_path, slip_speed=0.005)
    ramp = {**PLUCK, "from_bridge": PLACE, "ramp_time": 0.1, "release_time": 2e-5}
    known = play(instrument(tmp_path, STRING, exciters={"pluck": ramp}), {"force": 2.0}, duration=0.1)
    found = []
    for played in (slow, known):
        after = slice(*np.searchsorted(played.time, (0.002, 0.09)))
        found.append(harmonics(played.out[after], played.time[after]))
    np.testing.assert_allclose(found[0], found[1], rtol=6e-3)


@pytest.mark.slow
def test_the_hand_pays(tmp_path: Path) -> None:
    """String and tip hold the work of the hand's spring less the losses; friction gives nothing."""
    trace = plucked(tmp_path, energy=True).energy
    assert trace is not None
    assert trace.worst_residual < 1e-12
    assert trace.worst_cumulative_residual < 1e-10
    supplied = sum(values.sum() for values in trace.supplied.values())
    assert supplied > 0.5 * COMPLIANCE * 2.0**2
    for values in trace.lost.values():
        assert values.min() >= -1e-12 * trace.peak
    # the energy right after the slip is that of the static deflection, less the losses of string and edge meanwhile
    string = next(values for name, values in trace.stored.items() if name == "S.z")
    ringing = string[np.searchsorted(trace.time, 0.003)]
    assert 0.96 < ringing / (0.5 * COMPLIANCE * 2.0**2) < 1.0


def test_from_a_bundle(tmp_path: Path) -> None:
    bass = tw.load_instrument("electric_bass")
    notes = [tw.Note(0.0, 0.4, string="G2", stop=7, force=3.0, technique="plectrum")]
    sound = tw.render(tw.Score(notes), bass, max_duration=0.4).samples[:, 0]
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(len(sound)), 1 << 18))
    freq = np.fft.rfftfreq(1 << 18, 1 / 48000)
    near = (freq > 140) & (freq < 155)
    assert freq[near][spectrum[near].argmax()] == pytest.approx(146.83, abs=0.5)
    made = instrument(tmp_path, exciters={"plectrum": {**PLECTRUM, "direction": "y"}})
    with pytest.raises(BundleError, match="does not move in this direction"):
        play(made, duration=0.01)


def test_the_steel_strings_has_a_plectrum() -> None:
    """The note begins at its time, and has the pitch of the string."""
    guitar = tw.load_instrument("steel_strings")
    note = tw.Note(0.1, 1.0, string="D3", stop=0, technique="plectrum")
    x = tw.render(tw.Score([note]), guitar, max_duration=0.6).samples[:, 0]
    before, after = np.abs(x[: int(0.05 * 48000)]).max(), np.abs(x[int(0.1 * 48000) :]).max()
    assert after > 0.02
    assert before < 1e-3 * after
    freq = np.fft.rfftfreq(1 << 18, 1 / 48000)
    spectrum = np.abs(np.fft.rfft(x[int(0.15 * 48000) :] * np.hanning(len(x) - int(0.15 * 48000)), 1 << 18))
    near = (freq > 120) & (freq < 180)
    assert freq[near][spectrum[near].argmax()] == pytest.approx(146.83, rel=2e-3)
