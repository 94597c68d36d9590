"""Sound files: the samples written are those read back, or no file is there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.errors import OutputError
from tonewood.sound.files.audio import SoundWriter, file_format
from tonewood.sound.files.tags import Tags


def tone(n: int = 4800, channels: int = 2, amplitude: float = 0.5) -> np.ndarray:
    t = np.arange(n)[:, None] / 48000
    return amplitude * np.sin(2 * np.pi * (440.0 + 100 * np.arange(channels)) * t)


@pytest.mark.parametrize(
    ("name", "subtype", "container", "resolution"),
    [
        ("a.wav", "PCM_16", "WAV", 2.0**-15),
        ("a.wav", "PCM_24", "WAV", 2.0**-23),
        ("a.WAV", "FLOAT", "WAV", 2.0**-24),
        ("a.wav", "DOUBLE", "WAV", 0.0),
        ("a.flac", "PCM_24", "FLAC", 2.0**-23),
        ("a.rf64", "PCM_32", "RF64", 2.0**-31),
    ],
)
def test_samples_come_back(tmp_path: Path, name: str, subtype: str, container: str, resolution: float) -> None:
    x = tone()
    assert tw.Audio(x, 48000).save(tmp_path / name, subtype) == 0
    info = sf.info(str(tmp_path / name))
    assert (info.format, info.subtype, info.samplerate, info.channels) == (container, subtype, 48000, 2)
    back, _ = sf.read(str(tmp_path / name), dtype="float64", always_2d=True)
    assert back.shape == x.shape
    assert np.abs(back - x).max() <= resolution


def test_a_wav_too_large_becomes_rf64() -> None:
    four_gigabytes = 4_000_000_000
    assert file_format("a.wav", "PCM_16", four_gigabytes // 2)[0] == "WAV"
    assert file_format("a.wav", "PCM_16", four_gigabytes // 2 + 1) == ("RF64", "PCM_16")
    assert file_format("a.wav", "DOUBLE", four_gigabytes // 8 + 1) == ("RF64", "DOUBLE")


def test_expected_length_alone_decides_the_container(tmp_path: Path) -> None:
    with SoundWriter(tmp_path / "long.wav", 48000, 2, "PCM_24", frames=1_000_000_000) as writer:
        writer.write(tone())
    assert sf.info(str(tmp_path / "long.wav")).format == "RF64"


def test_blocks_are_joined(tmp_path: Path) -> None:
    x = tone()
    with SoundWriter(tmp_path / "a.wav", 48000, 2, "DOUBLE") as writer:
        for start in range(0, len(x), 777):
            writer.write(x[start : start + 777])
    assert np.array_equal(sf.read(str(tmp_path / "a.wav"))[0], x)
    assert writer.frames == len(x)


def test_clipped_samples_are_counted_and_cut(tmp_path: Path) -> None:
    x = tone(amplitude=0.5)
    x[[10, 20, 30], 0] = (1.5, -2.0, 1.0)
    with pytest.warns(UserWarning, match=r"a\.wav: 2 samples were clipped, the peak is \+6\.0 dBFS"):
        assert tw.Audio(x, 48000).save(tmp_path / "a.wav", "PCM_16") == 2
    back, _ = sf.read(str(tmp_path / "a.wav"))
    assert np.abs(back[[10, 20, 30], 0] - [1, -1, 1]).max() < 1e-4
    with pytest.warns(UserWarning, match=r"b\.wav: 2 samples lie beyond full scale, the peak is \+6\.0 dBFS"):
        assert tw.Audio(x, 48000).save(tmp_path / "b.wav", "FLOAT") == 2
    assert sf.read(str(tmp_path / "b.wav"))[0][20, 0] == -2.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lossy_file_gets_the_sound_cut_at_full_scale(tmp_path: Path, sign: float) -> None:
    """Vorbis would keep numbers beyond it, which players cut in their own ways."""
    ramp = sign * np.repeat([0.0, 3.0, 0.0], 8000)[:, None] * np.hanning(24000)[:, None]
    with pytest.warns(UserWarning, match="were clipped"):
        tw.Audio(ramp, 48000).save(tmp_path / "a.ogg")
    assert np.abs(sf.read(tmp_path / "a.ogg")[0]).max() == pytest.approx(1.0, abs=0.1)


def test_not_a_number_is_never_written(tmp_path: Path) -> None:
    x = tone()
    x[100, 1] = np.nan
    with pytest.raises(OutputError, match="not a finite number"):
        tw.Audio(x, 48000).save(tmp_path / "a.wav")
    x[100, 1] = np.inf
    with pytest.raises(OutputError, match="not a finite number"):
        tw.Audio(x, 48000).save(tmp_path / "a.wav")
    assert list(tmp_path.iterdir()) == []


def test_the_name_appears_only_when_all_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.wav"
    path.write_bytes(b"what was there before")

    def interrupted() -> None:
        with SoundWriter(path, 48000, 2) as writer:
            writer.write(tone())
            assert path.read_bytes() == b"what was there before"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_bytes() == b"what was there before"
    with SoundWriter(path, 48000, 2) as writer:
        writer.write(tone())
    assert sf.info(str(path)).frames == 4800
    assert [p.name for p in tmp_path.iterdir()] == ["a.wav"]


@pytest.mark.parametrize(
    ("name", "subtype", "said"),
    [
        ("a.m4a", None, ".wav, .rf64, .flac, .ogg, .mp3"),
        ("a", None, ".wav, .rf64, .flac"),
        ("a.ogg", "PCM_24", "allowed: VORBIS"),
        ("a.flac", "FLOAT", "PCM_16, PCM_24"),
        ("a.wav", "PCM_20", "PCM_24"),
        ("nowhere/a.wav", None, "no folder"),
    ],
)
def test_what_cannot_be_written_is_said_in_one_line(tmp_path: Path, name: str, subtype: str | None, said: str) -> None:
    with pytest.raises(OutputError, match=said) as error:
        tw.Audio(tone(), 48000).save(tmp_path / name, subtype)
    assert "\n" not in str(error.value)
    assert str(tmp_path / name) in str(error.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "fs", "n_channels", "said"),
    [
        (".mp3", 96000, 2, "the sampling rate is 96000 Hz; MP3 holds 8000, 11025"),
        (".mp3", 48000, 3, "has 3 channels; MP3 holds up to 2"),
        (".ogg", 200_001, 1, "the sampling rate is 200001 Hz; OGG holds up to 200000 Hz"),  # libsndfile crashes
        (".ogg", 48000, 256, "has 256 channels; OGG holds up to 255"),
        (".flac", 65536, 1, "the sampling rate is 65536 Hz; FLAC holds up to 65535 Hz, and multiples of 10 Hz"),
        (".flac", 655_360, 1, "the sampling rate is 655360 Hz"),
        (".flac", 48000, 9, "has 9 channels; FLAC holds up to 8"),
        (".wav", 48000, 1025, "has 1025 channels; WAV holds up to 1024"),
    ],
)
def test_rates_and_channels_that_a_format_lacks_are_refused(
    tmp_path: Path, suffix: str, fs: int, n_channels: int, said: str
) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(OutputError, match=f"^{re.escape(f'{path}: {said}')}"):
        SoundWriter(path, fs, n_channels)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("suffix", "fs", "n_channels"),
    [(".mp3", 8000, 2), (".ogg", 200_000, 1), (".ogg", 48000, 255), (".flac", 65535, 8), (".flac", 655_350, 1),
     (".wav", 768_000, 1), (".rf64", 48000, 1024)],
)  # fmt: skip
def test_the_highest_rates_and_channels_of_a_format_are_written(
    tmp_path: Path, suffix: str, fs: int, n_channels: int
) -> None:
    path = tmp_path / f"a{suffix}"
    tw.Audio(np.zeros((1000, n_channels)), fs).save(path)
    assert (sf.info(path).samplerate, sf.info(path).channels) == (fs, n_channels)


def test_a_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "a.wav").mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        tw.Audio(tone(), 48000).save(tmp_path / "a.wav")


def test_peak_and_duration() -> None:
    audio = tw.Audio(tone(48000, amplitude=0.5), 48000)
    assert audio.duration == 1.0
    assert audio.peak_dbfs == pytest.approx(-6.0206, abs=1e-3)
    assert tw.Audio(np.zeros((10, 1)), 48000).peak_dbfs == -np.inf


@pytest.mark.parametrize("suffix", [".wav", ".rf64", ".flac", ".ogg", ".mp3"])
def test_files_carry_their_tags_and_repeat(tmp_path: Path, suffix: str) -> None:
    """libsndfile reads them back, names of itself after the program's; a file without a date is the same again."""
    score = tw.Score([], metadata={"title": "Étude\nin A", "composer": "F. Sor"})
    tags = Tags.of(score, [tw.load_instrument("monochord"), tw.load_instrument("classical_guitar")])
    for name in ("a", "b"):
        tw.Audio(tone(), 48000, tags=tags).save(tmp_path / f"{name}{suffix}")
    path = tmp_path / f"a{suffix}"
    with sf.SoundFile(path) as file:
        texts = file.copy_metadata()
        assert file.frames == 4800
    assert (texts["title"], texts["artist"]) == (
        "Etude in A" if suffix == ".mp3" else "Étude in A", "F. Sor",
    )  # fmt: skip
    assert "Classical guitar M. Lopez Bellido" in texts["comment"]
    if suffix != ".mp3":  # libsndfile writes neither into the tags of an MP3
        assert "CC-BY-4.0" in texts["copyright"]
        assert texts["software"].startswith(f"tonewood {tw.__version__}")
    assert texts.get("license", "") == (tags.licence if suffix in (".flac", ".ogg") else "")
    same = sf.read(path)[0], sf.read(tmp_path / f"b{suffix}")[0]
    assert np.array_equal(*same)
    if suffix != ".ogg":  # libsndfile numbers its streams at random
        assert path.read_bytes() == (tmp_path / f"b{suffix}").read_bytes()
    assert np.abs(same[0] - tone()).max() < 0.05


def test_a_format_that_libsndfile_lacks_is_said_with_those_it_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sf, "available_subtypes", lambda container: {})
    with pytest.raises(OutputError, match=r"does not write \.mp3; \.wav, \.rf64, \.flac are written"):
        tw.Audio(tone(), 48000).save(tmp_path / "a.mp3")
