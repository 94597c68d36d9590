"""No step of a random scene is lost, finite and with its energy accounted for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hard_scenes import scene

SHORT, LONG = 50, 1000


def play(seed: int, folder: Path, *, energy: bool = False, **options: int) -> int:
    """Steps made by the careful search; the scene's number is in the message."""
    renderer = scene(seed, folder, **options).renderer(energy=energy)
    sound = np.concatenate(list(renderer.blocks(4096)))
    assert np.isfinite(sound).all(), f"scene {seed}"
    statistics = renderer.engine.stepper.statistics
    assert statistics.failures == 0, f"scene {seed}"
    if energy:
        assert renderer.energy is not None
        # C of a string with longitudinal motion, some 1e-5 J, rounds by as much before anything moves
        account, rounding = renderer.energy, 1e-19
        lost = np.abs(account.residual).max(initial=0.0)
        assert account.worst_residual < 1e-7 or lost < rounding, f"scene {seed}"
    return statistics.redone


@pytest.mark.parametrize(
    "first", [pytest.param(first, marks=[pytest.mark.slow] if first >= 20 else []) for first in range(0, SHORT, 10)]
)
def test_no_step_is_lost(tmp_path: Path, first: int) -> None:
    for seed in range(first, first + 10):
        play(seed, tmp_path, samples=100)


@pytest.mark.validate
@pytest.mark.parametrize("first", range(0, LONG, 50))
def test_no_step_is_lost_in_a_thousand_scenes(tmp_path: Path, first: int) -> None:
    redone = [play(seed, tmp_path, energy=seed % 5 == 0) for seed in range(first, first + 50)]
    print(f"scenes {first} to {first + 49}: {sum(redone)} steps made again, in {np.count_nonzero(redone)} scenes")
