"""The gallery has a sound of every shipped instrument, and each is the one that its command renders."""

from __future__ import annotations

import base64
import io
import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from tonewood.sound.level.loudness import loudness

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
    monkeypatch.setattr(gallery, "command", lambda name, options=(): ["render", f"{name}.mid", "-i", "none"])
    with pytest.raises(RuntimeError, match="exit code 2"):
        gallery.make(tmp_path, "monochord")


def test_a_note_that_is_not_played_is_reported(
    gallery: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(gallery.PIECES, "monochord", [(20, 80, 0.02), (45, 80, 0.5)])
    monkeypatch.setattr(gallery, "DURATION", 0.1)
    with pytest.raises(RuntimeError, match="1 dropped"):
        gallery.make(tmp_path, "monochord")


def test_a_page_holds_the_sounds_that_it_names(gallery: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two players at one loudness, in the page itself; a page without names stays as it is."""
    place = gallery.PAIRS["place"]
    monkeypatch.setattr(gallery, "DURATION", 0.6)
    page = gallery.with_players("before\n\n<!-- sounds: place -->\n\nafter\n")
    sounds = [base64.b64decode(data) for data in re.findall(r'src="data:audio/ogg;base64,([^"]+)"', page)]
    assert len(sounds) == len(place.options) == 2
    (x, fs), (y, _) = (sf.read(io.BytesIO(sound), always_2d=True) for sound in sounds)
    assert abs(loudness(x, fs)[0] - loudness(y, fs)[0]) < 0.5
    assert np.max(np.abs(x)) <= 1.0
    assert "data-sound" in page
    assert gallery.with_players("no sounds") == "no sounds"


def test_pages_name_sounds_that_are_there(gallery: ModuleType) -> None:
    named = {
        name
        for page in (ROOT / "docs").rglob("*.md")
        for name in re.findall(r"<!-- sounds: (\w+) -->", page.read_text(encoding="utf-8"))
    }
    assert named <= set(gallery.PAIRS)
