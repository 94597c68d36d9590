"""Outputs by string add up to the outputs."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled

SCORE = tw.Score(
    [
        tw.Note(0.05, 0.1, string="E2", stop=3, velocity_midi=100),
        tw.Note(0.08, 0.1, string="B3", stop=1, velocity_midi=70),
        tw.Note(0.12, 0.1, string="E2", stop=8, velocity_midi=100),
    ]
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("classical_guitar", {}),
        ("drawn_guitar", {"body.fmax": 700.0, "body.cell": 0.03}),
    ],
)
def test_stems_add_up(name: str, changes: dict[str, float]) -> None:
    """To rounding, microphones and a pickup on the body, also where a stop gives it an impulse; others sympathise."""
    instrument = tw.load_instrument(name).replace(changes)
    options = RenderOptions(fs=16000, effects="none", max_duration=0.25, outputs=("bridge", "microphones"))
    whole = tw.render(SCORE, instrument, options=options)
    stems = tw.Renderer(SCORE, instrument, options=options, model=assembled(instrument, options, by_string=True))
    sound = np.concatenate(list(stems.blocks()))
    columns = {channel: i for i, channel in enumerate(stems.channels)}
    for j, channel in enumerate(whole.channels):
        group, _, own = channel.partition(".")
        parts = {s: sound[:, columns[f"{group}.{s}.{own}"]] for s in ("E2", "A2", "D3", "G3", "B3", "E4", "body")}
        peak = np.abs(whole.samples[:, j]).max()
        assert np.abs(sum(parts.values()) - whole.samples[:, j]).max() < 1e-10 * peak
        assert np.abs(parts["E2"]).max() > 0.1 * peak
        assert 0 < np.abs(parts["D3"]).max() < 0.3 * peak


def test_a_tap_is_the_bodys_stem() -> None:
    guitar = tw.load_instrument("drawn_guitar").replace({"body.fmax": 700.0, "body.cell": 0.03})
    score = tw.Score([tw.Note(0.05, 0.1, technique="tap", force=5.0, string="E2", stop=0)])
    options = RenderOptions(fs=16000, effects="none", max_duration=0.2)
    whole = tw.render(score, guitar, options=options)
    stems = tw.Renderer(score, guitar, options=options, model=assembled(guitar, options, by_string=True))
    sound = np.concatenate(list(stems.blocks()))
    found = {channel: sound[:, i] for i, channel in enumerate(stems.channels)}
    total = sum(samples for channel, samples in found.items() if channel.endswith(".left"))
    assert np.abs(total - whole.samples[:, 0]).max() < 1e-10 * np.abs(whole.samples).max()
    assert np.abs(found["microphones.body.left"]).max() > 0.5 * np.abs(whole.samples[:, 0]).max()
