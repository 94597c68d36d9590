"""The gallery has a sound of every shipped instrument, and each is the one that its command renders."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw

pytest.importorskip("soundfile", minversion="0.13", reason="older ones cannot set the compression")
ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    spec = spec_from_file_location("gallery", ROOT / "scripts" / "gallery.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_has_every_instrument(gallery: ModuleType) -> None:
    assert set(gallery.PIECES) == {p.parent.name for p in (ROOT / "instruments").glob("*/instrument.yaml")}


def test_a_sound_of_it(gallery: ModuleType, tmp_path: Path) -> None:
    """The monochord begins with an A2 of 110 Hz; the compressed sound is the rendered one within its own noise."""
    midi, sound, picture = gallery.make(tmp_path, "monochord")
    x, fs = sf.read(str(sound))
    assert len(x) == gallery.DURATION * fs
    assert sound.stat().st_size <= gallery.LARGEST
    assert picture.read_bytes().startswith(b"\x89PNG")
    audio = tw.render(tw.read_midi(midi), tw.load_instrument("monochord"), max_duration=gallery.DURATION)
    y = audio.samples.mean(axis=1)
    y *= 0.7 / np.abs(y).max()
    assert np.sum((x - y) ** 2) < 0.01 * np.sum(y**2)
    spectrum = np.abs(np.fft.rfft(x[: int(0.7 * fs)] * np.hanning(int(0.7 * fs)), 1 << 18))
    freq = np.fft.rfftfreq(1 << 18, 1 / fs)
    low = (freq > 80) & (freq < 150)
    assert freq[low][np.argmax(spectrum[low])] == pytest.approx(110.0, rel=0.01)


def test_a_command_that_fails_is_reported(gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gallery, "command", lambda name: ["render", f"{name}.mid", "-i", "none", "-o", f"{name}.wav"])
    with pytest.raises(RuntimeError, match="exit code 2"):
        gallery.make(tmp_path, "monochord")


def test_a_note_that_is_not_played_is_reported(
    gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(gallery.PIECES, "monochord", [(20, 80, 0.02), (45, 80, 0.5)])
    monkeypatch.setattr(gallery, "DURATION", 0.1)
    with pytest.raises(RuntimeError, match="1 dropped"):
        gallery.make(tmp_path, "monochord")
