"""Parts of the analysis of taps: onsets, blocks, poles of closed form, spectra, intervals, and the picture's data."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tonewood.errors import OutputError, TonewoodError
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape
from tonewood.workshop.taps import figure, recordings, ringing, strongest
from tonewood.workshop.taps.cutting import Taps, _clipped, _noise, _onsets, _powers, _ring_out, cut_taps
from tonewood.workshop.taps.ringing import Peak, _in_each_tap, _interval, _spectra, _standing
from tonewood.workshop.taps.strongest import _faded, _pole

FS = 8000


def tones(*rows, seconds=1.0, fs=FS):
    """Sum of amplitude e^(-pi f t / Q) sin(2 pi f t + phase)."""
    t = np.arange(round(seconds * fs)) / fs
    return sum(a * np.exp(-np.pi * f / q * t) * np.sin(2 * np.pi * f * t + phase) for a, f, q, phase in rows)


# cutting


def test_powers_of_blocks() -> None:
    size, power = _powers(np.array([1.0, 3.0, 2.0, 0.0, 9.0]), 2.2)
    assert (size, power.tolist()) == (2, [5.0, 2.0])
    assert _powers(np.ones(3), 0.2)[0] == 1
    quiet = np.zeros(2000)
    quiet[160 * np.arange(12)] = np.sqrt(np.arange(12) * 160.0)  # a block of 20 ms has the power 0, 1, 2 ...
    assert _noise(quiet, FS) == pytest.approx(np.quantile(np.arange(1.0, 12.0), 0.1))
    assert _noise(np.zeros(2000), FS) == 0.0
    x = np.repeat([3.0, 2.0, 1.0, 2.0, 1.0, 0.9], 160)
    assert [_ring_out(x, FS, p) for p in (1.9, 0.6, 0.4, 0.0, 5.0)] == [640, 640, 960, 960, 0]
    assert _ring_out(x[:700], FS, 0.4) == 640


def test_a_tap_rises_by_12_db_to_within_30_db_of_the_strongest() -> None:
    """Blocks of 2 ms against the mean of the eight before them and the quietest tenth."""

    def blocks(*levels):
        return np.repeat(np.sqrt(np.array(levels, float)), 16)

    base = [1.0] * 30
    # the mean before and the floor are 1 each: more than 32 is a rise
    assert _onsets(blocks(*base, 33.0, *base), FS).tolist() == [30 * 16]
    assert _onsets(blocks(*base, 31.9, *base), FS).size == 0
    # 17 blocks later is another tap, 16 blocks are not
    for gap, count in ((16, 1), (17, 2)):
        assert _onsets(blocks(*base, 100.0, *[1.0] * (gap - 1), 600.0, *base), FS).size == count
    for size, count in ((1.1e-3, 2), (0.9e-3, 1)):
        assert _onsets(blocks(*[1e-9] * 30, size, *[1e-9] * 30, 1.0, *[1e-9] * 30), FS).size == count
    assert _onsets(np.zeros(4000), FS).size == 0
    assert _onsets(blocks(*[1.0] * 7, 99.0), FS).size == 0
    # within eight blocks of the beginning, what lies before the file is silent
    assert _onsets(blocks(1.0, 1.0, 1.0, 50.0, *base), FS).tolist() == [48]


@pytest.mark.parametrize(
    ("x", "clipped"),
    [([1.0, -1.0, 0.999], True), ([1.0, 1.0, 0.998, 1.0], False), ([1.0, 0.0, 1.0, 1.0], False)],
)
def test_three_samples_at_full_scale(x, clipped) -> None:
    assert _clipped(np.array(x)) is clipped


def test_taps_of_median_length() -> None:
    taps = Taps((np.arange(5000.0), np.arange(9000.0), np.arange(7000.0)), 1000.0, (0.4, 0.9, 0.5), ("a",))
    assert taps.ring_out == 0.5
    assert [x.tolist() for x in taps.analysed()] == [list(range(500))] * 3
    assert len(Taps(taps.samples, 1000.0, (0.1,)).analysed()[0]) == 250
    assert len(Taps(taps.samples, 1000.0, (9.0,)).analysed()[0]) == 4000
    assert len(Taps((np.zeros(300), np.zeros(9000)), 1000.0, (9.0, 9.0)).analysed()[0]) == 300
    both = taps.joined(Taps((np.ones(2),), 1000.0, (0.7,), ("b",)))
    assert (len(both.samples), both.decays, both.left_out) == (4, (0.4, 0.9, 0.5, 0.7), ("a", "b"))
    with pytest.raises(TonewoodError, match="recordings of 1000 and 900 Hz; one rate is allowed"):
        taps.joined(Taps((), 900.0, ()))
    with pytest.raises(TonewoodError, match="no tap can be used: x; y"):
        Taps((), 1.0, (), ("x", "y", "z")).usable()


def test_taps_that_are_left_out_say_why() -> None:
    """One that rings for 60 ms, one followed by the next within 100 ms, one at the end, one that is clipped."""
    rng = np.random.default_rng(1)
    x = 1e-4 * rng.standard_normal(4 * FS)
    for at, size, q in ((0.5, 0.5, 15.0), (1.0, 0.5, 60.0), (1.1, 0.9, 500.0), (3.0, 0.4, 300.0), (3.94, 0.9, 100.0)):
        first = round(at * FS)
        part = tones((size, 400.0, q, 0.3), seconds=0.8)[: x.size - first]
        x[first : first + part.size] += part
    taps = cut_taps(x, FS, "a.wav")
    said = "\n".join(taps.left_out)
    assert "a.wav: tap at 1.00 s left out: another one follows too early" in said
    assert "a.wav: tap at 3.94 s left out: the recording ends too early" in said
    assert len(taps.samples) + len(taps.left_out) == 5
    hard = np.clip(4.0 * x, -1, 1)
    assert any(line.endswith("it is clipped; turn the level down") for line in cut_taps(hard, FS).left_out)
    assert not any("clipped" in line for line in cut_taps(hard, FS, full_scale=np.inf).left_out)
    dull = 1e-4 * rng.standard_normal(2 * FS)
    dull[FS : FS + 400] += tones((0.5, 400.0, 9.0, 0.3), seconds=0.05)
    (line,) = cut_taps(dull, FS).left_out
    assert "it rings for 0." in line
    assert line.endswith("s only; 0.1 s or more are needed")
    with pytest.raises(TonewoodError, match="not a finite number"):
        cut_taps(np.append(x, np.inf), FS, "a.wav")


# recordings


def test_a_recording_ends_after_two_minutes_or_two_and_a_half_seconds_of_quiet(monkeypatch) -> None:
    class Microphone:
        def __init__(self, **options):
            told.append(options)

        def __enter__(self):
            return self

        def __exit__(self, *rest):
            return None

        def read(self, size):
            return np.full((size, 1), 0.5, np.float32), False

    told, heard = [], []
    monkeypatch.setattr(recordings, "_heard", lambda samples, fs: int(len(samples) >= 2 * fs))
    samples = recordings.record_taps(1, fs=1000, stream=Microphone, tell=heard.append, device=3)
    assert len(samples) == pytest.approx(1000 * (2.0 + 2.5), abs=101)
    assert heard == [1]
    assert told == [{"samplerate": 1000, "channels": 1, "dtype": "float32", "device": 3}]
    assert set(samples) == {0.5}
    assert len(recordings.record_taps(2, fs=10, stream=Microphone)) == 1200


def test_taps_that_are_heard_are_counted() -> None:
    assert recordings._heard(np.zeros(FS), FS) == 0
    x = 1e-4 * np.random.default_rng(2).standard_normal(3 * FS)
    for at in (0.5, 1.5):
        x[round(at * FS) : round(at * FS) + FS] += tones((0.5, 400.0, 100.0, 0.3))
    assert recordings._heard(x, FS) == 2
    with pytest.raises(TonewoodError, match="no file was given"):
        recordings.read_taps([])


def test_a_machine_without_a_microphone_says_so(monkeypatch) -> None:
    fault = type("PortAudioError", (Exception,), {})

    def none(**options):
        raise fault("no device")

    monkeypatch.setitem(
        __import__("sys").modules, "sounddevice", SimpleNamespace(InputStream=none, PortAudioError=fault)
    )
    with pytest.raises(OutputError, match="cannot open the microphone: no device"):
        recordings._input_stream()()
    monkeypatch.setitem(__import__("sys").modules, "sounddevice", None)
    with pytest.raises(OutputError, match=r"pip install 'tonewood\[play\]'"):
        recordings._input_stream()


# strongest


def test_a_pole_of_closed_form_is_exact() -> None:
    """Spectra that are exactly (b0 + b1 s) / (s^2 + c1 s + c0), each with its own b."""
    freq = np.arange(100.0, 300.0, 0.5)
    s, w = 2j * np.pi * freq, 2 * np.pi * 201.0
    x = np.array([(b0 * w * w + b1 * w * s) / (s * s + w / 40.0 * s + w * w) for b0, b1 in ((1.0, 0.2j), (0.3j, -1.0))])
    assert _pole(freq, x, 200.0) == pytest.approx((201.0, 40.0), rel=1e-9)
    assert _pole(freq, x[:1], 202.0) == pytest.approx((201.0, 40.0), rel=1e-9)
    assert _pole(freq, x.conj(), 200.0) is None  # it grows


def test_the_last_fifth_of_a_tap_fades() -> None:
    tap = np.arange(10.0)
    out = _faded(tap)
    assert out[:8].tolist() == (tap - 4.5)[:8].tolist()
    assert out[8:] == pytest.approx([3.5, 4.5 * 0.5])
    assert tap[9] == 9.0


def test_strong_peaks_are_within_the_band_and_50_db() -> None:
    rows = ((1.0, 150.0, 40.0, 0.1), (0.5, 300.0, 60.0, 0.4), (10 ** (-55 / 20), 600.0, 60.0, 0.2))
    found = strongest.strongest([tones(*rows)], FS, (100.0, 1000.0))
    assert [p.freq for p in found] == pytest.approx([150.0, 300.0], rel=2e-3)
    assert [p.quality for p in found] == pytest.approx([40.0, 60.0], rel=0.05)
    assert [p.error for p in found] == pytest.approx([0.02 * p.freq / p.quality for p in found])
    assert [p.freq for p in strongest.strongest([tones(*rows)], FS, (200.0, 1000.0))] == pytest.approx(
        [300.0], rel=2e-3
    )
    assert strongest.strongest([np.zeros(FS)], FS, (100.0, 1000.0)) == []
    silent = strongest.strongest([np.zeros(FS), tones(*rows)], FS, (100.0, 1000.0))
    assert [p.freq for p in silent] == pytest.approx([p.freq for p in found])
    # the first two seconds alone are taken
    long = np.concatenate([tones(*rows[:1], seconds=2.0), np.random.default_rng(1).standard_normal(FS)])
    assert strongest.strongest([long], FS, (100.0, 200.0))[0].quality == pytest.approx(40.0, rel=0.05)


# ringing


def test_spectra_are_integrals_over_time() -> None:
    """int e^(p t) e^(-s t) dt of a decaying exponential over T, at n / T, by the trapezoid rule."""
    p, n = -30.0 + 2j * np.pi * 150.0, FS
    t = np.arange(n) / FS
    taps = [np.exp(p * t).real, 2 * np.exp(p * t).imag]
    freq, spectra = _spectra(taps, FS, (100.0, 200.0))
    assert freq.tolist() == list(range(100, 201))
    s = 2j * np.pi * freq
    end = np.complex128(1 - np.exp(p))
    plus, minus = end / (s - p), end.conj() / (s - np.conj(p))
    np.testing.assert_allclose(spectra[0], (plus + minus) / 2, rtol=0.01)
    np.testing.assert_allclose(spectra[1], (plus - minus) / 1j, rtol=0.02)
    assert taps[0][0] == 1.0
    assert len(_spectra(taps, FS, (100.0, 131.0))[0]) == 32
    with pytest.raises(TonewoodError, match="31 bins of 1 Hz lie between 100 and 130 Hz; 32 or more are needed"):
        _spectra(taps, FS, (100.0, 130.0))


def test_amplitudes_in_each_tap() -> None:
    """Of two modes the second is missing in the second tap; amplitudes are those at the tap's beginning."""
    rng = np.random.default_rng(3)
    taps = [tones((1.0, 150.0, 20.0, 0.4), (0.5, 300.0, 40.0, 0.1)), tones((0.2, 150.0, 20.0, 1.4))]
    freq, spectra = _spectra([x + 1e-4 * rng.standard_normal(x.size) for x in taps], FS, (50.0, 400.0))
    amplitude, seen = _in_each_tap(freq, spectra, Poles.at([150.0, 300.0], [20.0, 40.0]))
    assert amplitude[:, 0] == pytest.approx([1.0, 0.2], rel=0.03)
    assert amplitude[0, 1] == pytest.approx(0.5, rel=0.03)
    assert seen.tolist() == [[True, True], [True, False]]
    cut = [x[: round(0.1 * FS)] for x in taps]  # 9 dB down: the transform ends before the sound does
    freq, spectra = _spectra(cut, FS, (50.0, 400.0))
    amplitude, _ = _in_each_tap(freq, spectra, Poles.at([150.0, 300.0], [20.0, 40.0]))
    assert amplitude[0] == pytest.approx([1.0, 0.5], rel=0.03)


def test_a_mode_without_a_peak_of_its_own_is_left_out() -> None:
    rng = np.random.default_rng(4)
    taps = [tones((1.0, 150.0, 20.0, p), (0.5, 300.0, 40.0, 0.1)) + 1e-4 * rng.standard_normal(FS) for p in (0.1, 1.0)]
    freq, spectra = _spectra(taps, FS, (50.0, 400.0))
    problem = Projection(FitData(freq, spectra, np.full(spectra.shape, 1e-6)), Shape((), 2))
    poles = Poles.at([150.0, 175.0, 300.0], [20.0, 9.0, 40.0])
    _, left = _standing(problem, poles, freq, spectra)
    assert left.freq == pytest.approx([150.0, 300.0], rel=1e-3)
    assert left.quality == pytest.approx([20.0, 40.0], rel=0.02)
    same, kept = _standing(problem, Poles.at([150.0, 300.0], [20.0, 40.0]), freq, spectra)
    assert same is problem
    assert len(kept) == 2


def test_peaks_of_two_taps() -> None:
    """Levels are re the strongest, of the mean square over the taps; beyond the band and below Q 4 are none."""
    rng = np.random.default_rng(5)
    rows = [((1.0, 150.0, 20.0, 0.4), (0.3, 300.0, 40.0, 0.1)), ((0.5, 150.0, 20.0, 1.4), (0.1, 300.0, 40.0, 1.0))]
    taps = [tones(*row) + 1e-3 * rng.standard_normal(FS) for row in rows]
    low, high = ringing.ringing(taps, FS, (50.0, 400.0))
    assert (low.freq, high.freq) == pytest.approx((150.0, 300.0), rel=1e-3)
    assert (low.level, low.seen, low.taps) == (0.0, 2, 2)
    assert high.level == pytest.approx(10 * np.log10((0.09 + 0.01) / (1 + 0.25)), abs=0.3)
    (only,) = ringing.ringing(taps, FS, (200.0, 400.0))
    assert only.freq == pytest.approx(300.0, rel=2e-3)
    assert only.level == 0.0
    with pytest.raises(TonewoodError, match="there is no tap to be analysed"):
        ringing.ringing([], FS)
    for band in ((0.0, 100.0), (100.0, 100.0), (100.0, 4001.0)):
        with pytest.raises(TonewoodError, match="0 to 4000 Hz, rising, are allowed"):
            ringing.ringing(taps, FS, band)
    assert _interval(100.0, 0.1) == pytest.approx((100 * np.exp(-0.16449), 100 * np.exp(0.16449)))


# the picture


def test_the_picture_has_the_levels_of_the_spectra(monkeypatch, tmp_path) -> None:
    drawn = []
    monkeypatch.setattr(figure, "save", lambda made, path: drawn.append((made, path)))
    taps = [tones((1.0, 150.0, 20.0, 0.4)), tones((0.5, 150.0, 20.0, 0.4), (0.1, 300.0, 40.0, 0.0))]
    peaks = [
        Peak(150.0, 20.0, (149.0, 151.0), (19.0, 21.0), 0.0, 2, 2),
        Peak(300.0, 40.0, (299.0, 301.0), (20.0, 80.0), -9.0, 1, 2),
    ]
    figure.draw_taps(taps, FS, (100.0, 400.0), peaks, {peaks[0]: "A0"}, tmp_path / "a.png")
    made, path = drawn[0]
    assert path == tmp_path / "a.png"
    first, second, mean, sure, doubtful = made.axes[0].lines
    freq = np.arange(100.0, 401.0)
    power = np.abs(np.fft.rfft(np.array(taps))[:, 100:401]) ** 2
    level = 10 * np.log10(power.mean(axis=0) / power.mean(axis=0).max())
    for line, row in ((first, power[0]), (second, power[1]), (mean, power.mean(axis=0))):
        assert line.get_xdata() == pytest.approx(freq)
        assert line.get_ydata() == pytest.approx(10 * np.log10(row / power.mean(axis=0).max()))
    assert (sure.get_xdata()[0], sure.get_ydata()[0]) == pytest.approx((150.0, level[50]))
    assert (doubtful.get_xdata()[0], doubtful.get_ydata()[0]) == pytest.approx((300.0, level[200]))
    assert [text.get_text() for text in made.axes[0].texts] == ["A0 150\nQ 20"]
    assert made.axes[0].get_ylim() == (-70.0, 18.0)
