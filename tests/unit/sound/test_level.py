"""Levels of files and of playing: the gain, the parts it leaves unchanged, and the summary."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import TonewoodError
from tonewood.performance.score.note import Control
from tonewood.sound.render import level
from tonewood.sound.render.level import LOUDNESS, PEAK, level_name, meaning, preview_gain
from tonewood.sound.render.options import RenderOptions


@pytest.mark.parametrize(
    ("given", "gain", "limiter", "found"),
    [
        (None, 0.0, False, "peak"),
        (None, -6.0, False, "calibrated"),
        (None, 0.0, True, "calibrated"),
        ("LUFS", 0.0, False, "LUFS"),
        ("calibrated", 3.0, True, "calibrated"),
    ],
)
def test_the_level_where_none_is_given(given: str | None, gain: float, limiter: bool, found: str) -> None:
    assert level_name(given, gain_db=gain, limiter=limiter) == found


@pytest.mark.parametrize(("given", "gain", "said"), [("loud", 0.0, "calibrated, peak, LUFS"), ("peak", 3.0, "--gain")])
def test_a_wrong_level_is_one_line(given: str, gain: float, said: str) -> None:
    with pytest.raises(TonewoodError) as fault:
        level_name(given, gain_db=gain, limiter=False)
    assert said in str(fault.value)


def test_what_full_scale_is_after_a_gain() -> None:
    group: Any = SimpleNamespace(full_scale=40.0, unit="Pa", gain_db=0.0)
    assert meaning([group], 20.0) == "gain +20.0 dB, 0 dBFS is 4 Pa"
    assert meaning([group, group], -6.0206) == "gain -6.0 dB, 0 dBFS is 80 Pa, 80 Pa"
    pickup: Any = SimpleNamespace(full_scale=2.0, unit="m/s", gain_db=-20.0)  # its own gain makes it quieter
    assert meaning([group, pickup], 20.0) == "gain +20.0 dB, 0 dBFS is 4 Pa, 2 m/s"


def test_the_preview_finds_the_loudest_part() -> None:
    """With its gain the whole piece peaks at -4 dBFS, the tail included: within 1.5 dB."""
    monochord = tw.load_instrument("monochord")
    notes = [tw.Note(0.5 * i, 0.4, note=45 + i % 3, velocity_midi=30) for i in range(16)]
    notes[11] = tw.Note(5.5, 0.4, note=52, velocity_midi=120)
    score, options = tw.Score(notes), RenderOptions(fs=16000)
    gain = preview_gain(score, monochord, options)
    x = tw.render(score, monochord, options=options).samples
    assert 20 * np.log10(np.abs(x).max()) + gain == pytest.approx(PEAK - 3.0, abs=1.5)
    assert preview_gain(tw.Score([tw.Note(0.0, 1.0, note=1)]), monochord, options) == 0.0
    assert LOUDNESS == -23.0


@pytest.mark.parametrize(
    ("forces", "begin", "chosen"),
    [
        # sums of squares over two seconds: 2, 10 (two notes, the third begins as they end), 9 + 0.25, ...
        ([(0.0, 1.0), (1.9, 1.0), (5.0, 1.0), (6.0, 3.0), (7.0, 0.5), (8.1, 0.5)], 5.0, [0.0, 1.0]),
        ([(0.0, 4.0), (5.0, 2.0), (6.0, 3.0)], 0.0, [0.0]),
        ([(3.0, 1.0), (1.0, 1.0), (8.0, 0.5)], 1.0, [0.0]),
    ],
)
def test_the_loudest_two_seconds_are_rendered_for_a_gain(
    monkeypatch: pytest.MonkeyPatch, forces: list[tuple[float, float]], begin: float, chosen: list[float]
) -> None:
    """Moves before them stand at their begin; a peak of 0.25 is brought 3 dB below that of a file."""
    made: list[tuple[tw.Score, RenderOptions]] = []

    def renderer(score: tw.Score, instrument: object, *, options: RenderOptions) -> SimpleNamespace:
        made.append((score, options))
        return SimpleNamespace(blocks=lambda n: iter([np.array([[0.1], [-0.25]]), np.array([[0.2]])]))

    monkeypatch.setattr(level, "Renderer", renderer)
    notes = [tw.Note(time, 0.5, note=45, force=force) for time, force in forces]
    moves = [Control(time, "cc1", 0.5) for time in (0.0, begin + 0.5, begin + 2.5)]
    options = RenderOptions(fs=16000, gain_db=-6.0, lead_in=0.5)
    gain = preview_gain(tw.Score(notes, moves), tw.load_instrument("monochord"), options)
    assert gain == pytest.approx(PEAK - 3.0 + 20 * np.log10(4))
    ((score, used),) = made
    assert [n.time for n in score.notes] == pytest.approx(chosen)
    assert [c.time for c in score.controls] == pytest.approx([0.0, 0.5])
    assert (used.gain_db, used.effects, used.max_duration, used.lead_in, used.fs) == (0.0, "none", 2.0, 0.0, 16000)
    assert preview_gain(tw.Score([]), tw.load_instrument("monochord"), options) == 0.0
