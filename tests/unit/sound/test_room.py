"""Rooms: convolution by definition, the direct sound first, decay as Sabine's formula asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

from tonewood.errors import TonewoodError
from tonewood.sound.room import ROOMS, Room, reverberation_db, room_response


def direct_gain_db(response: np.ndarray, fs: int, freq: float = 1000.0) -> float:
    """Gain of the first channel's direct sound at a frequency (Hz): what comes within 0.9 ms of its largest sample."""
    direct = response[: np.abs(response[:, 0]).argmax() + round(0.9e-3 * fs), 0]
    return float(20 * np.log10(np.abs(direct @ np.exp(-2j * np.pi * freq / fs * np.arange(len(direct))))))


def test_pieces_are_convolved(rng: np.random.Generator) -> None:
    """By definition, tail included; to the last bit whatever the pieces; a channel may be heard twice."""
    sound, responses = rng.normal(size=(4700, 2)), rng.normal(size=(2333, 3))
    sources = (0, 1, 1)
    expected = np.column_stack([np.convolve(sound[:, k], responses[:, c]) for c, k in enumerate(sources)])
    whole = Room(responses, sources).add(sound, last=True)
    assert whole == pytest.approx(expected, abs=1e-10)
    for size in (64, 1024, 3000):
        room = Room(responses, sources)
        pieces = [sound[i : i + size] for i in range(0, 4700, size)]
        out = [room.add(piece) for piece in pieces[:-1]]
        kept = room.memory
        out.append(room.add(pieces[-1], last=True))
        assert np.array_equal(np.concatenate(out), whole)
        room.memory = kept
        assert np.array_equal(room.add(pieces[-1], last=True), out[-1])


@pytest.mark.slow
@pytest.mark.parametrize("name", ROOMS)
@pytest.mark.parametrize("distance", [0.5, 1.0])
def test_the_distance_sets_the_room_s_share(name: str, distance: float) -> None:
    """Diffuse field: 16 pi d^2 over the absorption area, with Sabine's 0.161 V / T60; boxes are not diffuse."""
    pytest.importorskip("pyroomacoustics")
    box = ROOMS[name]
    response = room_response(name, 16000, 2, distance=distance)
    diffuse = 10 * np.log10(16 * np.pi * distance**2 * box.t60 / (0.161 * np.prod(box.size)))
    assert reverberation_db(response, 16000) == pytest.approx(diffuse, abs=3.0)
    softer = room_response(name, 16000, 2, distance=distance, mix_db=-6.0)
    assert reverberation_db(softer, 16000) == pytest.approx(reverberation_db(response, 16000) - 6.0, abs=0.3)
    assert direct_gain_db(softer, 16000) == pytest.approx(direct_gain_db(response, 16000), abs=0.2)


def test_microphones_stand_in_the_room(tmp_path: Path) -> None:
    with pytest.raises(TonewoodError, match=r"is 9 m; 0\.1 to [\d.]+ m are allowed in this room"):
        room_response("small", 16000, 2, distance=9.0)
    sf.write(tmp_path / "room.wav", np.eye(1, 100)[0], 16000)
    with pytest.raises(TonewoodError, match="the response of a file has its own"):
        room_response(str(tmp_path / "room.wav"), 16000, 2, distance=1.0)


@pytest.mark.parametrize(
    ("name", "volume", "t60", "distance"), [("studio", 98, 0.3, 0.7), ("small", 53, 0.4, 0.6), ("hall", 3240, 1.6, 2.0)]
)
def test_rooms_are_those_of_the_page_of_presets(name: str, volume: int, t60: float, distance: float) -> None:
    """With instrument and microphones inside, 30 cm apart and both at the distance from the instrument that is told."""
    box = ROOMS[name]
    assert (round(np.prod(box.size)), box.t60, box.distance) == (volume, t60, distance)
    left, right = box.places(distance, 2).T
    middle = (left + right) / 2 - box.source
    assert np.linalg.norm(middle) == pytest.approx(distance)
    assert np.cross(middle, box.towards) == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.dot(middle, box.towards) > 0
    assert (np.linalg.norm(right - left), (right - left) @ middle) == pytest.approx((0.3, 0.0), abs=2e-3)
    for place in (np.array(box.source), left, right):
        assert np.all(place >= 0.3)
        assert np.all(place <= np.array(box.size) - 0.3)


@pytest.mark.parametrize("name", ROOMS)
def test_boxes_begin_with_their_direct_sound_and_decay(name: str) -> None:
    """T60 from Schroeder's backward integral, -5 to -25 dB, within 40 % of Sabine's."""
    pytest.importorskip("pyroomacoustics")
    fs = 16000
    response = room_response(name, fs, 2)
    assert response.shape[1] == 2
    assert np.abs(response).argmax() < 1e-3 * 2 * fs
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


@pytest.mark.parametrize("late", [0.0, 0.2, 0.5, 0.8])
def test_the_direct_sound_has_its_gain_between_samples_too(tmp_path: Path, late: float) -> None:
    """A band-limited impulse a part of a sample late: its largest sample is down to 0.64 of it."""
    impulse = 0.3 * np.sinc(np.arange(400) - 200 - late)
    sf.write(tmp_path / "room.wav", impulse, 48000, subtype="DOUBLE")
    assert direct_gain_db(room_response(str(tmp_path / "room.wav"), 48000, 2), 48000) == pytest.approx(0.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("fs", "distance"), [(44100, 0.7), (48000, 0.5), (48000, 0.7), (48000, 1.0)])
def test_the_direct_sound_keeps_its_level_at_any_distance_and_rate(fs: int, distance: float) -> None:
    pytest.importorskip("pyroomacoustics")
    assert direct_gain_db(room_response("studio", fs, 2, distance=distance), fs) == pytest.approx(0.0, abs=0.3)


def test_rooms_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(TonewoodError, match="'cellar'; studio, small, hall or the name of a sound file"):
        room_response("cellar", 48000, 2)
    sf.write(tmp_path / "three.wav", np.ones((10, 3)), 48000)
    with pytest.raises(TonewoodError, match="has 3 channels; 1 or 2 are allowed"):
        room_response(str(tmp_path / "three.wav"), 48000, 2)
    sf.write(tmp_path / "silent.wav", np.zeros(10), 48000)
    with pytest.raises(TonewoodError, match="silent"):
        room_response(str(tmp_path / "silent.wav"), 48000, 2)
    for rate in (7999, 400001, 2**31 - 1):  # resampling would need 320 GiB for the last one
        sf.write(tmp_path / "rate.wav", np.ones(100), 48000)
        with (tmp_path / "rate.wav").open("r+b") as stream:
            stream.seek(24)
            stream.write(rate.to_bytes(4, "little"))
        with pytest.raises(TonewoodError, match=f"has {rate} samples a second; 8000 to 400000 are allowed"):
            room_response(str(tmp_path / "rate.wav"), 48000, 2)
    sf.write(tmp_path / "long.wav", np.ones(20 * 8000 + 1), 8000)
    with pytest.raises(TonewoodError, match="up to 20 s of finite samples"):
        room_response(str(tmp_path / "long.wav"), 48000, 2)
    (tmp_path / "text.wav").write_text("no sound")
    with pytest.raises(TonewoodError, match="cannot be read"):
        room_response(str(tmp_path / "text.wav"), 48000, 2)
