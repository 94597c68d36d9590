"""Rooms: convolution by definition, the direct sound first, decay as Sabine's formula asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

from tonewood.errors import TonewoodError
from tonewood.sound.room import ROOMS, Room, room_response


def test_blocks_are_convolved(rng: np.random.Generator) -> None:
    """Whatever the size of the blocks, tail included."""
    sound, responses = rng.normal(size=(700, 2)), rng.normal(size=(333, 2))
    expected = np.column_stack([np.convolve(sound[:, c], responses[:, c]) for c in range(2)])
    for size in (64, 333, 700, 1000):
        blocks = [sound[i : i + size] for i in range(0, 700, size)]
        assert np.concatenate(list(Room(responses).process(blocks))) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("name", ROOMS)
def test_boxes_begin_with_their_direct_sound_and_decay(name: str) -> None:
    """T60 from Schroeder's backward integral, -5 to -25 dB, within 40 % of Sabine's."""
    pytest.importorskip("pyroomacoustics")
    fs = 16000
    response = room_response(name, fs, 2)
    assert response.shape[1] == 2
    assert np.abs(response).argmax() < 1e-3 * 2 * fs
    assert np.abs(response).max() == 1.0
    left = np.cumsum(response[::-1, 0] ** 2)[::-1]
    level = 10 * np.log10(left / left[0])
    t60 = 3 * (np.argmax(level < -25) - np.argmax(level < -5)) / fs
    assert t60 == pytest.approx(ROOMS[name].t60, rel=0.4)
    assert np.abs(response[:, 0] - response[:, 1]).max() > 0.05


def test_a_file_is_a_room(tmp_path: Path) -> None:
    """Another rate is resampled: the direct sound stays first, the echo at its time."""
    given = np.zeros(24000)
    given[200], given[200 + 4800] = 0.5, 0.25
    sf.write(tmp_path / "room.wav", given, 24000, subtype="DOUBLE")
    response = room_response(str(tmp_path / "room.wav"), 48000, 2)
    echo = np.abs(response[5000:, 1]).argmax() + 5000 - np.abs(response[:, 1]).argmax()
    assert echo == 9600
    assert np.abs(response[5000:, 1]).max() == pytest.approx(0.5, rel=1e-3)


def test_rooms_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(TonewoodError, match="'cellar'; small, hall or the name of a sound file"):
        room_response("cellar", 48000, 2)
    sf.write(tmp_path / "three.wav", np.ones((10, 3)), 48000)
    with pytest.raises(TonewoodError, match="has 3 channels; 1 or 2 are allowed"):
        room_response(str(tmp_path / "three.wav"), 48000, 2)
    sf.write(tmp_path / "silent.wav", np.zeros(10), 48000)
    with pytest.raises(TonewoodError, match="silent"):
        room_response(str(tmp_path / "silent.wav"), 48000, 2)
    (tmp_path / "text.wav").write_text("no sound")
    with pytest.raises(TonewoodError, match="cannot be read"):
        room_response(str(tmp_path / "text.wav"), 48000, 2)
