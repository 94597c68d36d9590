"""Work around the steps: loading a bundle, assembling a model, reading a score, rendering a second."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import assemble

SCORES = Path(__file__).parents[2] / "examples" / "scores"
INSTRUMENTS = ("monochord", "classical_guitar", "steel_guitar")


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_load(benchmark: Any, name: str) -> None:
    benchmark.pedantic(tw.load_instrument, args=(name,), rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_assemble(benchmark: Any, name: str) -> None:
    instrument = tw.load_instrument(name)
    benchmark.pedantic(assemble, args=(instrument, 48000.0), rounds=5, warmup_rounds=1)


@pytest.mark.parametrize("name", ["scale", "greensleeves", "romance"])
def test_read_midi(benchmark: Any, name: str) -> None:
    benchmark(tw.read_midi, SCORES / f"{name}.mid")


@pytest.mark.parametrize("accuracy", ["draft", "standard", "reference"])
def test_render_a_second(benchmark: Any, accuracy: str) -> None:
    guitar = tw.load_instrument("classical_guitar")
    score = tw.Score([tw.Note(0.0, 1.0, string=name, stop=0, force=1.0) for name in guitar.string_names])
    benchmark.pedantic(lambda: tw.render(score, guitar, accuracy=accuracy, max_duration=1.0), rounds=3, warmup_rounds=1)
