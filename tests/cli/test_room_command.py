"""``tonewood render --preset``: a room and the stems in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw

pytest.importorskip("pyroomacoustics")
Run = Callable[..., tuple[int, str, str]]


@pytest.mark.slow
@pytest.mark.parametrize("by", ["output", "string"])
def test_stems_in_a_room_add_up_to_the_mix(tonewood: Run, tmp_path: Path, by: str) -> None:
    tw.write_midi(
        tw.Score([tw.Note(0.0, 0.3, note=key) for key in (40, 59)]),
        tmp_path / "a.mid",
    )
    words = ("render", tmp_path / "a.mid", "-i", "classical_guitar", "-o", tmp_path / "mix.wav", "--fs", 16000)
    words += ("--max-duration", 0.4, "--subtype", "DOUBLE", "--level", "calibrated", "--preset", "studio")
    code, _, err = tonewood(*words, "--stems", tmp_path / "stems", "--stems-by", by)
    assert code == 0, err
    mix = sf.read(tmp_path / "mix.wav")[0]
    stems = [sf.read(file)[0] for file in sorted((tmp_path / "stems").iterdir())]
    assert len(stems) == (1 if by == "output" else 7)  # six strings and what sounds without one
    assert np.sum(stems, axis=0) == pytest.approx(mix, abs=1e-9 * np.abs(mix).max() if by == "output" else 1e-5)
