"""A finger on the string: harmonics by a light touch, damping by a heavy one, nothing when it is lifted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene import band_energy, instrument, play

import tonewood as tw

FREQ = np.sqrt(73.9 / 3.61e-3) / 2 / 0.65
FINGER: dict[str, Any] = {
    "plugin": "stopping_finger", "touch": {"fraction": 0.5}, "from_bridge": 0.1, "force": 2.0, "lift": 0.08,
    "hold_dashpot": 0.0,
}  # fmt: skip


def partial(signal: np.ndarray, n: int) -> float:
    return band_energy(signal, (n - 0.4) * FREQ, (n + 0.4) * FREQ)


def test_touched_at_its_middle_a_string_keeps_its_even_partials(tmp_path: Path) -> None:
    made = instrument(tmp_path, exciters={"finger": FINGER, "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.1}})
    touched = play(made, {"force": 2.0}, duration=0.4, exciter="finger").out[-14400:]
    free = play(made, {"force": 2.0}, duration=0.4, exciter="pluck").out[-14400:]
    for even, odd in ((2, 1), (4, 3)):
        assert partial(touched, even) == pytest.approx(partial(free, even), rel=0.25)
        assert partial(touched, odd) < 1e-3 * partial(free, odd)


def test_a_heavy_finger_damps_all(tmp_path: Path) -> None:
    heavy = {**FINGER, "touch": 0.06, "weight": 5.0, "lift": 0.35}
    made = instrument(tmp_path, exciters={"finger": heavy, "pluck": {"plugin": "pluck_ramp", "from_bridge": 0.1}})
    touched = play(made, {"force": 2.0}, duration=0.3, exciter="finger").out[-4800:]
    free = play(made, {"force": 2.0}, duration=0.3, exciter="pluck").out[-4800:]
    assert np.sum(touched**2) < 1e-2 * np.sum(free**2)


def test_the_finger_only_takes(tmp_path: Path) -> None:
    """While its weight does not change, skin and hand lose energy and give none."""
    made = instrument(tmp_path, exciters={"finger": {**FINGER, "lift": 1.0}})
    trace = play(made, {"force": 2.0}, duration=0.05, energy=True).energy
    assert trace is not None
    assert trace.worst_residual < 1e-9
    free = trace.total[trace.time > 1e-3]
    assert np.all(np.diff(free) <= 1e-12 * trace.peak)


def test_by_technique_of_a_note(tmp_path: Path) -> None:
    """Through notes: the octave instead of the open string's pitch."""
    bass = tw.load_instrument("electric_bass")
    sound = {}
    for technique in ("pluck", "harmonic"):
        notes = [tw.Note(0.0, 1.0, note=43, technique=technique, force=3.0)]
        sound[technique] = tw.render(tw.Score(notes), bass, max_duration=0.7).samples[-19200:, 0]
    low = {t: band_energy(x, 88, 108) for t, x in sound.items()}
    octave = {t: band_energy(x, 186, 206) for t, x in sound.items()}
    assert low["harmonic"] < 1e-2 * octave["harmonic"]
    assert low["pluck"] > low["harmonic"]
