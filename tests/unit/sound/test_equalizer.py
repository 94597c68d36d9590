"""Equalizer of an output: its closed form, blocks, and the sound of a render."""

from __future__ import annotations

import numpy as np
import pytest

import tonewood as tw
from tonewood.sound.equalizer import Equalizer, response_db, section


def test_a_shelf_has_half_of_its_gain_at_the_middle_and_a_bell_all_of_it():
    for freq, gain in ((200.0, 6.0), (3000.0, -15.0)):
        far = np.array([1e-4 * freq, freq, 1e4 * freq])
        assert response_db([(freq, gain, None)], far) == pytest.approx((0.0, gain / 2, gain), abs=1e-3)
        assert response_db([(freq, gain, 1.4)], far) == pytest.approx((0.0, gain, 0.0), abs=1e-3)


@pytest.mark.parametrize(("q", "shown"), [(None, (0.0, 4.5, 9.0)), (2.0, (0.0, 9.0, 0.0))])
def test_digital_bands_have_the_gains_of_the_analogue_ones_at_dc_middle_and_end(q, shown):
    fs, freq = 48000.0, 2500.0
    b0, b1, b2, a0, a1, a2 = section((freq, 9.0, q), fs)
    z = np.exp(2j * np.pi * np.array([0.0, freq / fs, 0.5]))
    found = 20 * np.log10(np.abs((b0 + b1 / z + b2 / z**2) / (a0 + a1 / z + a2 / z**2)))
    assert found == pytest.approx(shown, abs=1e-9)


def test_blocks_change_nothing_and_channels_have_their_own_bands():
    sound = np.random.default_rng(1).standard_normal((500, 2))
    bands = [[(500.0, 6.0, None), (2000.0, -9.0, 1.0)], []]
    whole, parts = Equalizer(bands, 8000.0)(sound), Equalizer(bands, 8000.0)
    pieces = np.concatenate([parts(sound[a:b]) for a, b in ((0, 1), (1, 64), (64, 64), (64, 500))])
    assert np.array_equal(whole, pieces)
    assert np.array_equal(whole[:, 1], sound[:, 1])
    assert not np.allclose(whole[:, 0], sound[:, 0])


def test_an_output_renders_through_its_equalizer_and_goes_on_from_a_snapshot():
    plain = tw.load_instrument("monochord")
    score = tw.Score([tw.Note(0.05, 0.2, note="A2")])
    bands = [{"freq": 400.0, "gain_db": -12.0}, {"freq": 1500.0, "gain_db": 8.0, "q": 1.5}]
    shaped = plain.replace({"outputs.bridge.equalizer": bands})
    dry = tw.render(score, plain, 16000, max_duration=0.3).samples
    wet = tw.render(score, shaped, 16000, max_duration=0.3).samples
    # the renderer's filter runs from before the first frame on: compare after its transient
    expected = Equalizer([[(400.0, -12.0, None), (1500.0, 8.0, 1.5)]], 16000.0)(dry)
    assert np.allclose(wet[800:], expected[800:], rtol=0, atol=1e-3 * np.abs(dry).max())
    renderer = tw.Renderer(score, shaped, 16000, max_duration=0.3)
    next(renderer.blocks(100))
    checkpoint = renderer.snapshot()
    rest = np.concatenate(list(renderer.blocks(100)))
    renderer.restore(checkpoint)
    assert np.array_equal(rest, np.concatenate(list(renderer.blocks(64))))
