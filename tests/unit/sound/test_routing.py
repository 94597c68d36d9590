"""Gain, pan and delay of outputs against the same outputs without them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError, TonewoodError
from tonewood.sound.render.model_file import save_model

FS = 16000
SCORE = tw.Score([tw.Note(0.08, 0.05, "E4", velocity_midi=80)])


def rendered(name: str, changes: dict[str, Any], **options: Any) -> tw.Audio:
    options = {"max_duration": 0.15, "effects": "none"} | options
    return tw.render(SCORE, tw.load_instrument(name).replace(changes), FS, **options)


def test_a_single_channel_is_placed_between_two() -> None:
    (output,) = tw.load_instrument("monochord").spec.outputs[:1]
    key = f"outputs.{output.name}"
    plain = rendered("monochord", {})
    found = rendered("monochord", {f"{key}.gain_db": -6.0, f"{key}.pan": 0.4, f"{key}.delay": 0.01})
    assert found.channels == ("left", "right")
    angle, gain = math.pi * 1.4 / 4, 10 ** (-6 / 20)
    late = np.vstack([np.zeros((160, 1)), plain.samples])[: len(plain.samples)]
    expected = late * gain * np.array([math.cos(angle), math.sin(angle)])
    assert found.samples == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert np.abs(found.samples).max() > 1e-6


def test_two_channels_of_a_measured_body_are_balanced() -> None:
    plain = rendered("classical_guitar", {})
    found = rendered("classical_guitar", {"outputs.microphones.pan": 0.0})
    assert found.samples == pytest.approx(plain.samples, rel=1e-12, abs=1e-15)
    hard = rendered("classical_guitar", {"outputs.microphones.pan": -1.0, "outputs.microphones.gain_db": 3.0})
    assert hard.channels == plain.channels
    assert hard.samples[:, 0] == pytest.approx(plain.samples[:, 0] * math.sqrt(2) * 10**0.15, rel=1e-12, abs=1e-15)
    assert np.abs(hard.samples[:, 1]).max() < 1e-15


def test_each_output_has_its_own_delay_whatever_the_blocks() -> None:
    """Of two outputs the second is late by 37 frames (2.3 ms); blocks and a restored snapshot do not matter."""
    changes = {"outputs.bridge.delay": 37 / FS}
    both = {"outputs": ("microphones", "bridge")}
    plain, found = rendered("classical_guitar", {}, **both), rendered("classical_guitar", changes, **both)
    assert np.array_equal(found.samples[:, :2], plain.samples[:, :2])
    assert np.array_equal(found.samples[37:, 2], plain.samples[:-37, 2])
    assert not found.samples[:37, 2].any()
    guitar = tw.load_instrument("classical_guitar").replace(changes)
    renderer = tw.Renderer(SCORE, guitar, FS, max_duration=0.15, effects="none", **both)
    blocks = renderer.blocks(100)
    first = [next(blocks) for _ in range(3)]
    kept = renderer.snapshot()
    rest = np.concatenate(list(blocks))
    assert np.array_equal(np.concatenate([*first, rest]), found.samples)
    renderer.restore(kept)
    assert np.array_equal(np.concatenate(list(renderer.blocks(333))), rest)


def test_live_hears_the_same() -> None:
    guitar = tw.load_instrument("classical_guitar")
    changes = {"outputs.microphones.delay": 0.002, "outputs.microphones.gain_db": -2.0}
    sounds = []
    for instrument in (guitar, guitar.replace(changes)):
        live = tw.Live(instrument, FS, prepare=False, effects="none")
        live.note_on("E4", 80)
        sounds.append(live.process(1200))
    assert sounds[1][32:] == pytest.approx(sounds[0][:-32] * 10**-0.1, rel=1e-12, abs=1e-15)
    assert not sounds[1][:32].any()


@pytest.mark.slow
def test_more_than_two_channels_have_no_pan() -> None:
    places = {"a": [0.3, 0, 1], "b": [0.2, 0, 1], "c": [0.1, 0, 1]}
    coarse = {"body.fmax": 300.0, "body.cell": 0.04}
    guitar = tw.load_instrument("drawn_guitar").replace(
        {"outputs.microphones.at": places, "outputs.microphones.pan": 0.1} | coarse
    )
    with pytest.raises(BundleError, match=r"outputs.microphones.pan: is for outputs of one or two channels; .* has 3"):
        tw.Renderer(SCORE, guitar, FS)


@pytest.mark.parametrize("output", ["microphones", "listener"])
def test_every_channel_has_a_name_of_its_own(output: str) -> None:
    with pytest.raises(BundleError, match=rf"outputs\.{output}\.channels: has 'left' twice"):
        rendered("classical_guitar", {f"outputs.{output}.channels": ["left", "left"]}, outputs=[output])


def test_live_counts_the_samples_beyond_full_scale() -> None:
    live = tw.Live(tw.load_instrument("monochord"), FS, prepare=False, effects="none", gain_db=30.0)
    live.note_on("A2", 127)
    heard = np.concatenate([live.process(n) for n in (500, 1, 1200)])
    assert live.summary().clipped == np.count_nonzero(abs(heard) > 1.0) > 10
    assert live.summary().peak_dbfs == pytest.approx(20 * np.log10(abs(heard).max()))


@pytest.mark.parametrize("changes", [{"delay": 0.002}, {"equalizer": [{"freq": 200.0, "gain_db": -3.0}]}])
def test_a_file_of_a_model_has_plain_outputs_alone(tmp_path: Path, changes: dict[str, Any]) -> None:
    monochord = tw.load_instrument("monochord")
    name, group = next(iter(monochord.pickups)), monochord.spec.outputs[0]
    file = tmp_path / "m.tonewood"
    save_model(file, monochord, FS)
    assert b"scale f8 1\n" + np.array([1 / group.full_scale], "<f8").tobytes() in file.read_bytes()
    assert b"fs f8\n" + np.array(1 / (1 / FS), "<f8").tobytes() in file.read_bytes()
    file.unlink()
    wrong = monochord.replace({f"outputs.{name}.{key}": value for key, value in changes.items()})
    with pytest.raises(TonewoodError, match="a circuit, delays, an equalizer"):
        save_model(file, wrong, FS)
    assert not file.exists()
