"""Sample libraries: who serves which note, loudness between layers, files, and a sampler that plays them."""

from __future__ import annotations

import gc
import re
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import soundfile as sf
from hypothesis import given
from hypothesis import strategies as st

import tonewood as tw
from tonewood.cli.main import run
from tonewood.errors import OutputError, TonewoodError
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled
from tonewood.support.whole_files import AtomicFile
from tonewood.workshop.sampling.library import Library, Sampling, make_library
from tonewood.workshop.sampling.notes import Span, compass, key_spans, velocity_spans
from tonewood.workshop.sampling.strokes import Stroke, rings
from tonewood.workshop.sampling.texts import Region

FS = 16000
SAMPLING = Sampling(step=12, velocities=(40, 110), repeats=2, lowest=45, highest=57, duration=1.2)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    path = tmp_path_factory.mktemp("library") / "string.sfz"
    return make_library(tw.load_instrument("monochord"), path, SAMPLING, RenderOptions(fs=FS))


def opcodes(line: str) -> dict[str, str]:
    return dict(re.findall(r"(\w+)=(\S+)", line))


def regions(library: Library) -> list[dict[str, str]]:
    group: dict[str, str] = {}
    out = []
    for line in library.sfz.read_text(encoding="utf-8").splitlines():
        if line.startswith("<group>"):
            group = opcodes(line)
        elif line.startswith("<region>"):
            out.append(group | opcodes(line))
    return out


@given(st.integers(0, 60), st.integers(0, 60), st.integers(1, 24))
def test_every_key_has_one_sample_and_the_nearest(low: int, extent: int, step: int) -> None:
    parts = key_spans(low, low + extent, step)
    served = [key for part in parts for key in range(part.low, part.high + 1)]
    assert served == list(range(low, low + extent + 1))
    centres = [part.centre for part in parts]
    for part in parts:
        for key in range(part.low, part.high + 1):
            assert abs(key - part.centre) == min(abs(key - centre) for centre in centres)


@given(st.sets(st.integers(1, 127), min_size=1, max_size=8))
def test_every_velocity_has_one_layer(velocities: set[int]) -> None:
    parts = velocity_spans(sorted(velocities))
    assert [v for part in parts for v in range(part.low, part.high + 1)] == list(range(1, 128))


@pytest.mark.parametrize("wrong", [(), (0,), (64, 64), (128,)])
def test_layers_that_cannot_be(wrong: tuple[int, ...]) -> None:
    with pytest.raises(TonewoodError, match="different numbers from 1 to 127"):
        velocity_spans(wrong)


def test_loudness_has_no_steps_between_layers() -> None:
    """Volume and curve of two layers give one level where they meet, and the measured ones where they were rendered."""
    levels = {40: -30.0, 110: -12.0}
    soft, hard = (Region("", Span(60, 60, 60), span, 1, 1, levels) for span in (Span(40, 1, 75), Span(110, 76, 127)))
    for region, velocity in ((soft, 40), (hard, 110), (soft, 75), (hard, 76)):
        curve = region.curve
        gain = np.interp(velocity, list(curve), list(curve.values()))
        heard = levels[region.velocities.centre] + region.volume_db + 20 * np.log10(gain)
        assert heard == pytest.approx(-30.0 + 18.0 * (velocity - 40) / 70, abs=0.35)


def test_files_are_those_of_the_text(library: Library) -> None:
    texts = regions(library)
    assert {r["sample"] for r in texts} == {f.name for f in library.folder.glob("*.flac")}
    assert (library.n_samples, library.n_releases) == (8, 0)  # a monochord's string rings on
    assert all(r["loop_mode"] == "one_shot" for r in texts)
    assert sorted({(r["seq_length"], r["seq_position"]) for r in texts}) == [("2", "1"), ("2", "2")]
    for r in texts:
        info = sf.info(library.folder / r["sample"])
        assert (info.samplerate, info.subtype) == (FS, "PCM_24")
        assert 0.5 < info.duration <= 1.2
    root = ElementTree.fromstring(library.decent.read_text(encoding="utf-8"))
    paths = {element.get("path") for element in root.iter("sample")}
    assert paths == {f"{library.folder.name}/{r['sample']}" for r in texts}
    assert "CC-BY-4.0" in (library.folder / "README.txt").read_text(encoding="utf-8")


def test_samples_are_the_instrument_s_notes(library: Library) -> None:
    """Pitch by the file's spectrum; round robins differ; the loudest stays below full scale."""
    peaks = []
    for r in regions(library):
        samples, _ = sf.read(library.folder / r["sample"], always_2d=True)
        spectrum = np.abs(np.fft.rfft(samples[:, 0] * np.hanning(len(samples)), 1 << 17))
        freq = np.fft.rfftfreq(1 << 17, 1 / FS)
        f0 = 440 * 2 ** ((int(r["pitch_keycenter"]) - 69) / 12)
        near = (freq > 0.9 * f0) & (freq < 1.1 * f0)
        assert 1200 * np.log2(freq[near][np.argmax(spectrum[near])] / f0) == pytest.approx(0.0, abs=15.0)
        peaks.append(np.abs(samples).max() * 10 ** (float(r["volume"]) / 20))
    assert 10 ** (-8 / 20) < max(peaks) <= 10 ** (-1 / 20) + 1e-4
    one, two = (sf.read(library.folder / f"A2_v110_r{i}.flac")[0] for i in (1, 2))
    n = min(len(one), len(two))
    assert np.abs(one[:n] - two[:n]).max() > 0.01 * np.abs(one).max()


def test_a_damped_instrument_has_releases(tmp_path: Path) -> None:
    guitar = tw.load_instrument("classical_guitar")
    few = Sampling(step=1, velocities=(90,), repeats=1, lowest=58, highest=58, duration=1.5)
    made = make_library(guitar, tmp_path / "a.sfz", few, RenderOptions(fs=FS), suffix=".wav")
    note, release = regions(made)
    assert (made.n_samples, made.n_releases) == (1, 1)
    assert (note["loop_mode"], release["trigger"]) == ("no_loop", "release")
    samples, _ = sf.read(made.folder / release["sample"], always_2d=True)
    level = [10 * np.log10(np.mean(samples[i * 800 : (i + 1) * 800] ** 2)) for i in (0, 3)]
    assert level[1] < level[0] - 20  # T60 0.12 s: 75 dB in 0.15 s, less what the other strings hold
    assert float(release["rt_decay"]) > 5.0


def test_a_sampler_plays_it(tmp_path: Path) -> None:
    """Keys and velocities that were rendered come back as rendered, but for the sampler's own gain."""
    pysfizz = pytest.importorskip("pysfizz")
    few = Sampling(step=5, velocities=(50, 110), repeats=1, lowest=45, highest=50, duration=1.5)
    monochord = tw.load_instrument("monochord").replace({"playing.variation.seed": None})
    made = make_library(monochord, tmp_path / "a.sfz", few, RenderOptions(fs=48000), suffix=".wav")
    gains = []
    for key, velocity in ((45, 50), (45, 110), (50, 50), (50, 110), (45, 80)):
        synth = pysfizz.Synth(sample_rate=48000, block_size=256)
        assert synth.load_sfz_file(str(made.sfz))
        tries = []
        for _ in range(4):  # it loads files in the background, and plays what is there: the fullest is the whole
            tries.append(np.asarray(synth.render_note(key, velocity, 1.0, 1.2))[0])
            time.sleep(0.1)
        heard = max(tries, key=lambda x: float(np.sum(x[:40000] ** 2)))
        note = tw.Note(0.0, 1.0, note=key, velocity_midi=velocity)
        wanted = tw.render(tw.Score([note]), monochord, max_duration=1.0).samples[:, 0]
        a, b = (10 * np.log10(np.mean(x[4800:40000] ** 2)) for x in (heard, wanted))
        gains.append(a - b)
    assert np.ptp(gains[:4]) < 0.2, gains
    assert gains[4] - gains[0] == pytest.approx(0.0, abs=1.5)  # between the layers


def test_nothing_is_overwritten_or_half_written(tmp_path: Path, library: Library) -> None:
    monochord = tw.load_instrument("monochord")
    with pytest.raises(OutputError, match="there already"):
        make_library(monochord, library.sfz, SAMPLING, RenderOptions(fs=FS))
    with pytest.raises(OutputError, match=r"\.sfz is allowed"):
        make_library(monochord, tmp_path / "a.txt", SAMPLING, RenderOptions(fs=FS))
    with pytest.raises(OutputError, match="the sampling rate is 88201 Hz; FLAC holds"):
        make_library(monochord, tmp_path / "a.sfz", SAMPLING, RenderOptions(fs=88201))
    with pytest.raises(TonewoodError, match="keys from 45 to 69"):
        make_library(monochord, tmp_path / "a.sfz", Sampling(lowest=30), RenderOptions(fs=FS))

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_library(monochord, tmp_path / "a.sfz", SAMPLING, RenderOptions(fs=FS), tell=stop)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("completed", [0, 1])
def test_nothing_is_left_where_the_last_files_are_not_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, completed: int
) -> None:
    """The folder has its name by then, and perhaps one of the two texts: a second run must find none of them."""
    original, done = AtomicFile.complete, []

    def complete(file: AtomicFile) -> None:
        if file.path.suffix != ".wav":
            if len(done) == completed:
                raise KeyboardInterrupt
            done.append(file)
        original(file)

    monkeypatch.setattr(AtomicFile, "complete", complete)
    one = Sampling(step=12, velocities=(64,), repeats=1, lowest=45, highest=45, duration=0.1)
    with pytest.raises(KeyboardInterrupt):
        make_library(tw.load_instrument("monochord"), tmp_path / "a.sfz", one, RenderOptions(fs=8000), suffix=".wav")
    assert len(done) == completed
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut_short(file: Path, samples: np.ndarray) -> None:
        raise OSError("96000 requested and 4088 written")  # as NumPy has it

    monkeypatch.setattr(np, "save", cut_short)
    with pytest.raises(OutputError, match=r"a\.sfz: cannot be written: is the disk full\?"):
        make_library(tw.load_instrument("monochord"), tmp_path / "a.sfz", SAMPLING, RenderOptions(fs=FS))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (("--range", "E5-E2"), "the lower one first"),
        (("--velocities", "soft"), "numbers from 1 to 127"),
        (("--every", "0"), "1 to 24 semitones"),
        (("--format", "mp3"), "flac or wav"),
    ],
)
def test_the_command_refuses(
    option: tuple[str, str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run(["sample", "monochord", "-o", str(tmp_path / "a.sfz"), *option])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line


def test_what_is_sampled_unless_asked_is_what_the_page_says() -> None:
    page = (Path(__file__).parents[4] / "docs" / "sampling.md").read_text(encoding="utf-8")
    said = dict(re.findall(r"`--(velocities|every|round-robins|duration) ([\d,.]+)", page.partition("| ---")[2]))
    usual = Sampling()
    assert [int(v) for v in said["velocities"].split(",")] == list(usual.velocities)
    assert (int(said["every"]), int(said["round-robins"])) == (usual.step, usual.repeats)
    assert float(said["duration"]) == usual.duration


def test_the_compass_ends_at_the_last_stop_of_the_highest_string() -> None:
    """E2 to the 19th fret of E4 of a classical guitar: B5."""
    guitar = tw.load_instrument("classical_guitar")
    assert compass(assembled(guitar, RenderOptions(fs=8000))) == (40, 64 + 19)


def test_a_decay_is_that_of_an_exponential() -> None:
    """Decibels per second; none where a stroke ends within the second of its two pieces, or grows."""
    t = np.arange(2 * FS) / FS
    falling = 10 ** (-40.0 * t[:, None] / 20)
    assert Stroke(60, 100, 1, falling).decay_db(FS) == pytest.approx(40.0)
    assert Stroke(60, 100, 1, falling[: round(0.95 * FS)]).decay_db(FS) == 0.0
    assert Stroke(60, 100, 1, falling[::-1]).decay_db(FS) == 0.0


@pytest.mark.parametrize(("name", "on"), [("monochord", True), ("classical_guitar", False), ("grand_piano", False)])
def test_notes_ring_on_unless_a_hand_or_a_damper_ends_them(name: str, on: bool) -> None:
    assert rings(tw.load_instrument(name)) is on


def test_the_hardest_stroke_peaks_one_decibel_below_full_scale(tmp_path: Path) -> None:
    few = Sampling(step=1, velocities=(127,), repeats=1, lowest=50, highest=50, duration=0.3)
    made = make_library(tw.load_instrument("monochord"), tmp_path / "a.sfz", few, RenderOptions(fs=FS))
    samples, _ = sf.read(made.folder / regions(made)[0]["sample"])
    assert 20 * np.log10(np.abs(samples).max()) == pytest.approx(-1.0, abs=0.01)
