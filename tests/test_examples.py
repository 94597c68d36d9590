"""Every example runs, and one number of each is right."""

from __future__ import annotations

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import soundfile as sf

import tonewood as tw
from browser import CHROMIUM, dom

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    spec = spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_all_examples_are_tested_here() -> None:
    here = Path(__file__).read_text()
    assert [p.stem for p in EXAMPLES.glob("*.py") if f'"{p.stem}"' not in here] == []


def test_render_score(tmp_path: Path) -> None:
    """The first note is a C3, 130.81 Hz: the lowest partial of the first quarter of a second."""
    audio = example("render_score").main(tmp_path)
    x, fs = sf.read(str(tmp_path / "prelude.flac"), always_2d=True)
    assert np.abs(x - audio.samples).max() <= 2.0**-23
    spectrum = np.abs(np.fft.rfft(x[:8000, 0] * np.hanning(8000), 1 << 17))
    freq = np.fft.rfftfreq(1 << 17, 1 / fs)
    low = (freq > 115) & (freq < 150)
    assert freq[low][np.argmax(spectrum[low])] == pytest.approx(130.81, rel=0.01)


def test_another_guitar(tmp_path: Path) -> None:
    """E2 and D2 of equal temperament at 440 Hz."""
    pitch = example("another_guitar").main(tmp_path)
    assert pitch["usual"] == pytest.approx(440.0 * 2 ** ((40 - 69) / 12), rel=6e-4)
    assert pitch["changed"] == pytest.approx(440.0 * 2 ** ((38 - 69) / 12), rel=6e-4)
    assert sf.info(str(tmp_path / "changed.wav")).frames == 48000


def test_bridge_mobility() -> None:
    """The lowest strong row of the guitar's own table: f, Q and its residue A = heave - 2 cross + rock at u = -1."""
    freq, size = example("bridge_mobility").main()
    folder = tw.list_instruments()["classical_guitar"]
    lines = [r.split(",") for r in (folder / "body.csv").read_text().splitlines() if r and r[0] != "#"]
    rows = [dict(zip(lines[0], map(float, values), strict=True)) for values in lines[1:]]
    low = [r for r in rows if r["f_Hz"] < 150]
    residue = [r["heave"] - 2 * r["cross"] + r["rock"] for r in low]
    peak = [a * r["Q"] / (2 * np.pi * r["f_Hz"]) for a, r in zip(residue, low, strict=True)]
    strongest = int(np.argmax(peak))
    assert freq == pytest.approx(low[strongest]["f_Hz"], rel=0.01)
    assert size == pytest.approx(peak[strongest], rel=0.1)


def test_streaming() -> None:
    assert example("streaming").main() == 0.0


def test_play_live(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "sounddevice", None)
    assert example("play_live").main() == 48000


@pytest.mark.slow
def test_scores_are_written_as_they_stand(tmp_path: Path) -> None:
    module = example("scores/make_scores")
    module.main(tmp_path)
    for name in module.PIECES:
        kept, written = ((folder / f"{name}.mid") for folder in (EXAMPLES / "scores", tmp_path))
        assert kept.read_bytes() == written.read_bytes()
        instrument = tw.load_instrument("african_harp" if name == "pentatonic" else "classical_guitar")
        performance = tw.Renderer(tw.read_midi(kept), instrument, 16000).performance
        assert len(performance.notes) == len(tw.read_midi(kept).notes)
        assert not performance.dropped
        assert not tw.read_midi(kept).warnings


def test_user_law() -> None:
    """A law without loss loses nothing; as a table it lets go at the same sample."""
    user_law = example("user_law")
    contact, kept = user_law.main()
    assert kept == pytest.approx(1.0, abs=1e-9)
    user_law.compiled = lambda folder: None
    assert user_law.main()[0] == pytest.approx(contact, abs=1.5 / 48000)


def test_effects(tmp_path: Path) -> None:
    """A tanpura's partials near 2.5 kHz grow after the pluck; a clavichord's key let go silences its string."""
    sounds = example("effects").main(tmp_path, ("tanpura", "clavichord"))
    assert {p.name for p in tmp_path.glob("*.wav")} == {"tanpura.wav", "clavichord.wav"}

    def level(x: np.ndarray, start: float) -> float:
        piece = x[int(start * 48000) :][:4800]
        spectrum = np.abs(np.fft.rfft(piece * np.hanning(len(piece)))) ** 2
        return float(spectrum[200:300].sum())  # 2 to 3 kHz

    drone, key = sounds["tanpura"].samples[:, 0], sounds["clavichord"].samples[:, 0]
    assert level(drone, 0.3) > 3 * level(drone, 0.0)
    assert np.abs(key[int(0.64 * 48000) : int(0.68 * 48000)]).max() < 0.02 * np.abs(key[: int(0.4 * 48000)]).max()


@pytest.mark.slow
def test_from_a_measurement(tmp_path: Path) -> None:
    """A body fitted to hits moves under 10 g as Y / (1 + i omega m Y) of the body that was struck says."""
    guitar = tw.load_instrument("classical_guitar")
    freq = np.arange(150.0, 300.0, 0.02)
    Y = guitar.body.basis(1e4).frf(freq, "bridge_middle", "bridge_middle")
    heavy = Y / (1 + 2j * np.pi * freq * 0.010 * Y)
    found = example("from_a_measurement").main(tmp_path, (70.0, 700.0), microphones=False, pages=False)
    assert found["mine"] == pytest.approx(freq[np.argmax(np.abs(Y))], rel=1e-3)
    assert found["heavier"] == pytest.approx(freq[np.argmax(np.abs(heavy))], rel=1e-3)
    assert sf.info(str(tmp_path / "heavier.wav")).frames == 72000
    assert "measured by examples/from_a_measurement.py" in (tmp_path / "my_guitar" / "instrument.yaml").read_text()


@pytest.mark.validate
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_pages_of_a_measurement_in_a_browser(tmp_path: Path) -> None:
    """Both modes stand in the table of the page that a browser has opened, and its script has run."""
    found = example("from_a_measurement").main(tmp_path, (70.0, 700.0), microphones=False)
    compared = dom(tmp_path / "compared.html", tmp_path / "profile")
    cells = [float(cell) for cell in re.findall(r"<td>([0-9.]+)</td>", compared)]
    for freq in found.values():
        assert min(abs(1200 * np.log2(cell / freq)) for cell in cells if cell > 0) < 10
    assert 'data-state="stopped"' in compared
    assert compared.count("<img") == 6
    assert "10 g on the bridge" in compared
    assert "0.01 kg at middle" in dom(tmp_path / "heavier.html", tmp_path / "profile")


def test_osc_server() -> None:
    """Messages reach the thread that computes; those that cannot be followed are counted."""
    module = example("osc_server")
    live = tw.Live("monochord", 16000, prepare=False)
    stream = tw.AudioStream(live, 128)
    instrument = module.OscInstrument(live, stream)
    instrument.receive("/note_on", "A2", 100)
    instrument.receive("/note_on", "H2")
    instrument.receive("/volume", 3)
    instrument.receive("/bend")
    instrument.receive("/note_on", "A2", 0)
    for call in stream._calls.due(0):
        call()
    assert np.abs(live.process(4000)).max() > 1e-4
    assert live.summary().notes == 1
    assert len(instrument.refused) == 3
    assert any(reason.startswith("no address /volume; there are /note_on") for reason in instrument.refused)
    assert "/bend takes cents, channel" in instrument.refused
    assert not live.player.n_sounding


@pytest.mark.validate
def test_place_of_pluck(tmp_path: Path) -> None:
    """Held-back strings: the dips of the partials give the place to a few tenths of a percent of the length."""
    pytest.importorskip("pyarrow")
    found = example("place_of_pluck").main(tmp_path, 128, 1)
    assert found["held_back"] > 30
    assert found["median_error"] < 0.005
    assert found["rms_error"] < found["rms_error_of_the_mean"]
