"""Taps of known modes: what rings in them, how sure it is, and recordings that are none."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile as sf

from tonewood.cli.main import run
from tonewood.errors import TonewoodError
from tonewood.workshop.taps.cutting import cut_taps
from tonewood.workshop.taps.names import named
from tonewood.workshop.taps.recordings import read_taps, record_taps
from tonewood.workshop.taps.ringing import Peak, _combined, ringing
from tonewood.workshop.taps.strongest import strongest

FS = 24000
FREQ = np.array([98.0, 190.0, 235.0, 290.0, 402.0, 430.0, 520.0, 760.0])
QUALITY = np.array([15.0, 30.0, 25.0, 40.0, 45.0, 38.0, 50.0, 55.0])
#: spruce plates measured by Badiane et al.; skipped where the folder is missing
PLATES = Path(os.environ.get("TONEWOOD_PLATES", Path(__file__).parents[4].parent / "shared/plates"))


def decaying(rng, seconds, freq=FREQ, quality=QUALITY):
    """Sum of modes of viscous damping, of random amplitudes and phases; a contact of 2 ms."""
    t = np.arange(round(seconds * FS)) / FS
    damped = freq * np.sqrt(1 - 1 / (4 * quality**2))
    size, phase = rng.uniform(0.3, 1.0, freq.size), rng.uniform(-1, 1, freq.size)
    rows = np.exp(-np.pi * np.outer(freq / quality, t)) * np.sin(2 * np.pi * np.outer(damped, t) + phase[:, None])
    return size @ rows * np.minimum(1.0, t / 2e-3)


def recording(seed, decibels=30.0, taps=5, apart=0.8):
    """Taps half a second after the beginning, then every `apart` seconds; noise so far below the whole."""
    rng = np.random.default_rng(seed)
    x = np.zeros(round((0.5 + apart * taps) * FS))
    for i in range(taps):
        start = round((0.5 + apart * i + rng.uniform(0, 0.02)) * FS)
        tap = 10 ** rng.uniform(-0.3, 0.3) * decaying(rng, 1.5 * apart)
        x[start : start + tap.size] += tap[: x.size - start]
    x /= 1.2 * np.abs(x).max()
    return x + 10 ** (-decibels / 20) * np.sqrt(np.mean(x**2)) * rng.normal(size=x.size)


def held(seeds):
    """Shares of intervals that hold frequency and Q, and the numbers of peaks."""
    found, numbers = [], []
    for seed in seeds:
        taps = cut_taps(recording(seed, (20.0, 30.0, 40.0)[seed % 3]), FS)
        peaks = ringing(taps.analysed(), FS)
        numbers.append(len(peaks))
        for f, q in zip(FREQ, QUALITY, strict=True):
            peak = min(peaks, key=lambda peak: abs(peak.freq - f))
            found.append((peak.freq_90[0] <= f <= peak.freq_90[1], peak.quality_90[0] <= q <= peak.quality_90[1]))
    return np.mean(found, axis=0), numbers


def command(*words):
    with pytest.raises(SystemExit) as ended:
        run([str(word) for word in words])
    return ended.value.code


@pytest.mark.parametrize("decibels", [60.0, 30.0, 10.0])
def test_frequencies_and_q_of_known_modes(decibels):
    taps = cut_taps(recording(3, decibels), FS)
    assert len(taps.samples) == 5
    peaks = ringing(taps.analysed(), FS)
    assert [peak.freq for peak in peaks] == pytest.approx(FREQ, rel=1e-3)
    assert [peak.quality for peak in peaks] == pytest.approx(QUALITY, rel=0.03)
    assert all(peak.seen == peak.taps == 5 for peak in peaks)
    assert max(peak.level for peak in peaks) == 0.0
    for peak in peaks:  # intervals of 90 %, by equal factors to both sides
        for value, (low, high) in ((peak.freq, peak.freq_90), (peak.quality, peak.quality_90)):
            assert 0.5 * value < low < value < high < 2 * value
            assert low * high == pytest.approx(value**2)


def test_taps_that_are_cut_short_have_the_same_q():
    """The next tap comes while Q 40 at 98 Hz still rings, 13 dB down; nothing of that is damping."""
    rng = np.random.default_rng(0)
    f, q = np.array([98.0, 240.0]), np.array([40.0, 60.0])
    taps = [decaying(rng, 0.2, f, q)[round(0.005 * FS) :] for _ in range(3)]
    peaks = ringing(taps, FS, (50.0, 400.0))
    assert [peak.freq for peak in peaks] == pytest.approx(f, rel=1e-3)
    assert [peak.quality for peak in peaks] == pytest.approx(q, rel=0.01)


@pytest.mark.slow
def test_intervals_hold_the_truth_of_a_few_recordings():
    """8 recordings, 64 modes: 90 % within three standard deviations of a share of 64."""
    share, numbers = held(range(8))
    assert np.all((share >= 0.78) & (share <= 1.0)), share
    assert numbers == [FREQ.size] * 8


@pytest.mark.validate
def test_intervals_hold_the_truth_of_many_recordings():
    share, numbers = held(range(200))
    assert np.all((share >= 0.85) & (share <= 0.95)), share
    assert np.mean(np.array(numbers) == FREQ.size) > 0.97


def test_taps_that_cannot_be_used_are_named():
    x = recording(1)
    x[round(2.2 * FS) : round(2.4 * FS)] = 1.0  # clipped within the third tap
    bounce = round(1.3 * FS)
    x[bounce + 1500 : bounce + 6000] += 6 * decaying(np.random.default_rng(9), 4500 / FS)
    taps = cut_taps(np.clip(x, -1, 1), FS, "top.wav")
    assert len(taps.samples) < 5
    assert any("it is clipped" in line for line in taps.left_out)
    assert all(line.startswith("top.wav: tap at ") and "\n" not in line for line in taps.left_out)


def test_taps_are_cut_where_they_are_said_to_be():
    """From 5 ms after a tap to 20 ms before the next; it rings until it is 3 dB above the noise, by blocks of 20 ms."""
    rng, t = np.random.default_rng(4), np.arange(round(0.9 * FS)) / FS
    t60, noise = 0.5, 1e-3
    tap = 0.5 * np.exp(-np.log(1000) * t / t60) * np.sin(2 * np.pi * 400.0 * t)
    x = noise * rng.normal(size=3 * FS)
    for start in (0.5, 1.4):
        x[round(start * FS) : round(start * FS) + t.size] += tap
    taps = cut_taps(x, FS)
    assert not taps.left_out
    first, second = taps.samples
    assert first.size == pytest.approx((0.9 - 0.005 - 0.020) * FS, abs=0.005 * FS)
    assert second.size == pytest.approx((3.0 - 1.4 - 0.005) * FS, abs=0.005 * FS)
    np.testing.assert_array_equal(second, x[-second.size :])
    # the noise below 30 Hz is filtered out, which is nothing here; 2 x its power is reached where tap = noise
    expected = t60 * np.log(0.5 / np.sqrt(2) / noise) / np.log(1000) - 0.005
    assert taps.decays == pytest.approx((expected, expected), abs=0.03)
    assert [piece.size for piece in taps.analysed()] == [round(taps.ring_out * FS)] * 2
    both = cut_taps(x, FS).joined(taps)
    assert both.decays == taps.decays * 2
    assert [piece.size for piece in both.samples] == [first.size, second.size] * 2


@pytest.mark.parametrize(("row", "out"), [(2, 0), (3, 1)])
def test_three_samples_in_a_row_at_full_scale_are_clipped(row, out):
    x = 0.5 * recording(1) / 0.9
    at = int(np.argmax(np.abs(x[round(1.32 * FS) : round(1.5 * FS)]))) + round(1.32 * FS)
    x[at : at + row] = -1.0
    x[at + row + 3] = 1.0  # by itself
    assert sum("clipped" in line for line in cut_taps(x, FS).left_out) == out


@pytest.mark.parametrize("samples", [np.zeros(FS), np.zeros(10)])
def test_silence_holds_no_tap(samples):
    with pytest.raises(TonewoodError, match="holds no tap"):
        cut_taps(samples, FS)


def test_a_peak_s_error_is_the_scatter_of_its_taps_or_a_fiftieth_of_its_width():
    """Of four taps whose mode moves by 0.5 %, that over two; of taps alike, 2 % of f / Q."""
    t = np.arange(round(0.8 * FS)) / FS
    moved = 200.0 * (1 + 0.005 * np.array([-1.0, 1.0, 1.0, -1.0]))

    def ring(f, q):
        return np.exp(-np.pi * f / q * t) * np.sin(2 * np.pi * f * t)

    taps = [ring(f, 40.0) + 0.5 * ring(330.0, 60.0) for f in moved]
    low, high = strongest(taps, FS, (100.0, 500.0))
    assert (low.freq, high.freq) == pytest.approx((200.0, 330.0), rel=2e-3)
    assert high.quality == pytest.approx(60.0, rel=0.05)
    assert low.error == pytest.approx(np.std(moved, ddof=1) / 2, rel=0.1)
    assert high.error == pytest.approx(0.02 * 330.0 / 60.0, rel=0.1)
    assert [p.freq for p in strongest(taps, FS, (100.0, 500.0), most=1)] == pytest.approx([200.0], rel=2e-3)


def a_peak(freq, level, quality=30.0, seen=5):
    return Peak(freq, quality, (freq, freq), (0.95 * quality, 1.05 * quality), level, seen, 5)


def test_a_peak_is_certain_that_most_taps_show_with_a_q_within_a_factor_of_one_and_a_half():
    sure = replace(a_peak(200.0, 0.0), quality_90=(20.0, 44.9))
    assert sure.certain
    assert not replace(sure, quality_90=(20.0, 45.1)).certain
    assert replace(sure, seen=3).certain
    assert not replace(sure, seen=2).certain
    assert not replace(sure, seen=2, taps=4).certain


def test_names_by_order_ratio_and_level():
    """Two guitars of the literature: air, top, back 97, 199, 291 Hz; a weak neck mode below A0 gets no name."""
    peaks = [
        a_peak(60.0, -40.0),
        a_peak(97.0, -6.0),
        a_peak(110.0, 0.0, seen=1),
        a_peak(199.0, 0.0),
        a_peak(291.0, -9.0),
    ]
    assert {name: peak.freq for name, peak in named(peaks).items()} == {"A0": 97.0, "T1": 199.0, "T2": 291.0}
    assert dict(named([])) == {}
    assert list(named([a_peak(97.0, 0.0), a_peak(600.0, 0.0)])) == ["A0"]
    # A0 from 50 to 350 Hz and at most 25 dB below the strongest; T1 1.4 to 2.8 times as high, T2 1.12 to 2.2
    for freq, level, there in ((49.0, 0.0, False), (51.0, -24.0, True), (51.0, -26.0, False), (351.0, 0.0, False)):
        assert ("A0" in named([a_peak(freq, level), a_peak(2000.0, 0.0)])) is there
    for ratio, there in ((1.39, False), (1.41, True), (2.79, True), (2.81, False)):
        assert ("T1" in named([a_peak(100.0, 0.0), a_peak(100.0 * ratio, -5.0)])) is there
    for ratio, there in ((1.11, False), (1.13, True), (2.19, True), (2.21, False)):
        air_and_top = [a_peak(100.0, 0.0), a_peak(200.0, -5.0)]
        assert ("T2" in named([*air_and_top, a_peak(200.0 * ratio, -5.0)])) is there
    # of several, the lowest within 10 dB of the strongest
    several = [a_peak(100.0, 0.0), a_peak(160.0, -20.0), a_peak(190.0, -14.0), a_peak(220.0, -5.0)]
    assert named(several)["T1"].freq == 190.0


def test_the_command_lists_writes_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sf.write("a.wav", np.stack([np.zeros(100000), recording(1)[:100000]], axis=1), FS, subtype="FLOAT")
    assert command("taptone", "a.wav", "--channel", "2", "-o", "a.csv", "--plot", "a.png", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert [(row["name"], round(row["freq_Hz"])) for row in report["peaks"] if row["name"]] == [
        ("A0", 98), ("T1", 190), ("T2", 235),
    ]  # fmt: skip
    assert "mobility" in report["quantity"]
    assert any("three or more at one place" in line for line in report["warnings"]) == (report["taps"] < 3)
    assert Path("a.csv").read_text().startswith("freq_Hz,freq_low_Hz,freq_high_Hz,Q,")
    assert len(Path("a.csv").read_text().splitlines()) == 1 + len(report["peaks"])
    assert Path("a.png").read_bytes()[:4] == b"\x89PNG"
    assert command("taptone", "a.wav", "--channel", "2", "--no-names") == 0
    said = capsys.readouterr().out
    assert "A0" not in said
    assert "there is no mobility" in said


def test_bad_recordings_are_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sf.write("quiet.wav", np.zeros(FS), FS)
    sf.write("noise.wav", 0.1 * np.random.default_rng(0).normal(size=FS), FS)
    sf.write("empty.wav", np.zeros(0), FS)
    sf.write("slow.wav", recording(0)[::20], FS // 20)
    sf.write("few.wav", np.ones(8), 8)
    Path("text.wav").write_text("not a sound")
    sf.write("good.wav", recording(0), FS)
    sf.write("other.wav", recording(0), 2 * FS)
    for words, reported in (
        (("quiet.wav",), "quiet.wav: holds no tap"),
        (("noise.wav",), "noise.wav: holds no tap"),
        (("empty.wav",), "empty.wav: holds no samples"),
        (("few.wav",), "few.wav: has 8 samples a second; 1000 to 400000 are allowed"),
        (("text.wav",), "text.wav: is no sound file"),
        (("none.wav",), "none.wav: is not there"),
        (("slow.wav",), "--band: is 50 1000 Hz; 0 to 600 Hz"),
        (("good.wav", "other.wav"), "one rate is allowed"),
        (("good.wav", "--channel", "2"), "--channel: is 2; 1 to 1 are allowed"),
        (("good.wav", "--band", "300", "200"), "--band: is 300 200"),
        (("good.wav", "--band", "100", "110"), "bins of"),
        (("good.wav", "--record", "3"), "good.wav"),
        ((), "no file was given"),
    ):
        assert command("taptone", *words) == 2, words
        said = capsys.readouterr()
        assert reported in said.err, said.err
        assert said.err.count("\n") == 1
        assert said.out == ""


class Microphone:
    """Plays a recording to whoever reads."""

    def __init__(self, samples, **options):
        self.samples, self.at, self.options = samples, 0, options

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def read(self, count):
        part = np.zeros((count, 1), np.float32)
        piece = self.samples[self.at : self.at + count]
        part[: piece.size, 0] = piece
        self.at += count
        return part, False


def test_recording_ends_after_the_taps_that_were_asked_for(tmp_path):
    heard = []
    samples = record_taps(5, fs=FS, stream=lambda **options: Microphone(recording(2), **options), tell=heard.append)
    assert heard[-1] == 5
    assert samples.size / FS < 10
    sf.write(tmp_path / "a.wav", samples, FS, subtype="FLOAT")
    peaks = ringing(read_taps([tmp_path / "a.wav"]).analysed(), FS)
    assert [peak.freq for peak in peaks] == pytest.approx(FREQ, rel=1e-3)


def test_lost_samples_end_a_recording():
    class Losing(Microphone):
        def read(self, count):
            return super().read(count)[0], True

    with pytest.raises(TonewoodError, match="samples of the microphone were lost"):
        record_taps(1, fs=FS, stream=lambda **options: Losing(recording(2), **options))


@pytest.mark.parametrize("command", ["taptone", "wood", "fit"])
def test_hours_in_a_small_file_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch, capsys, command):
    monkeypatch.setattr("tonewood.support.sound_rates.MOST_SAMPLES", 40_000)
    sf.write(tmp_path / "long.wav", np.zeros((20_001, 2)), 8000)
    monkeypatch.chdir(tmp_path)
    board = ["--length", "0.5", "--width", "0.2", "--thickness", "0.003", "--mass", "0.12"]
    hit = ["-o", "out", "--points", "a", "--sensitivity", "1,1", "--driving", "a", "--form", "mobility"]
    with pytest.raises(SystemExit) as end:
        run([command, "long.wav", *{"wood": board, "fit": hit}.get(command, [])])
    out, err = capsys.readouterr()
    assert (end.value.code, out, err.count("\n")) == (2, "", 1)
    assert "long.wav: lasts longer than 2 s; 40000 samples of 2 channel(s) are allowed" in err
    assert not (tmp_path / "out").exists()


def test_a_board_of_which_every_tap_is_clipped_is_one_line(tmp_path, capsys):
    x = np.concatenate([np.zeros(FS), np.clip(20 * decaying(np.random.default_rng(3), 2.0), -1.0, 1.0)])
    sf.write(tmp_path / "tap.wav", x, FS)
    with pytest.raises(SystemExit) as end:
        run(
            [
                "wood",
                str(tmp_path / "tap.wav"),
                "--length",
                "0.5",
                "--width",
                "0.2",
                "--thickness",
                "0.003",
                "--mass",
                "0.12",
            ]
        )
    err = capsys.readouterr().err
    assert (end.value.code, err.count("\n")) == (2, 1)
    assert "no tap can be used: tap.wav: tap at 1.00 s left out: it is clipped" in err


def plate(name):
    """Five hits on a plate measured by others, each a tap."""
    taps = [cut_taps(row, 48000, "hit", np.inf) for row in np.load(PLATES / f"{name}.npz")["acceleration"]]
    whole = taps[0]
    for more in taps[1:]:
        whole = whole.joined(more)
    return whole


@pytest.mark.slow
@pytest.mark.skipif(not (PLATES / "2L.npz").exists(), reason="needs measured plates")
@pytest.mark.parametrize("name", ["2R", *(pytest.param(x, marks=pytest.mark.slow) for x in ["1L", "1R", "2L", "3L"])])
def test_plates_that_others_measured(name):
    """The maxima of the mean spectrum, each fitted by itself, are modes; there are few more.

    Of 2L the lowest, by the peaks of its authors' responses: 51.5, 75.7, 127.8 Hz.
    """
    taps = plate(name)
    found = np.array([peak.freq for peak in ringing(taps.analysed(), 48000, (40.0, 700.0))])
    peaks = strongest(taps.samples, 48000, (40.0, 700.0))
    wanted = [peak.freq for peak in peaks if abs(peak.freq / 50 - 1) > 5e-3]  # hum of the mains is in 2R
    assert [float(np.abs(found / f - 1).min()) for f in wanted] == pytest.approx([0.0] * len(wanted), abs=0.01)
    assert len(found) <= len(wanted) + 7
    if name == "2L":
        assert found[:3] == pytest.approx([51.5, 75.7, 127.8], rel=0.01)


def test_combinations_of_taps_keep_their_energy():
    """One for taps that are alike, whatever the phase of what rings; as many as there are for taps that are not."""
    rng = np.random.default_rng(2)
    for phase in (1.0, 1j, np.exp(0.7j)):
        alike = phase * np.outer([1.0, 3.0, -2.0, 0.5], rng.normal(size=300))
        combined = _combined(alike)
        assert len(combined) == 1
        assert np.sum(np.abs(combined) ** 2) == pytest.approx(alike.shape[0] * 300)
    two = _combined(np.vstack([x := rng.normal(size=300), 1j * x]))
    assert np.sum(np.abs(two) ** 2) == pytest.approx(2 * 300)
