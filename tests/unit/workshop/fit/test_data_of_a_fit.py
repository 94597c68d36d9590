"""Noise, responses, hits and files of a fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fit_parts import FREQ, resonances
from fit_scenes import TAU

from tonewood.errors import TonewoodError
from tonewood.workshop.fit import arrays, drift, files, noise, texts, universal
from tonewood.workshop.fit.drift import Drift
from tonewood.workshop.fit.hits import is_double
from tonewood.workshop.fit.responses import Responses, to_mobility

# -- noise and responses -----------------------------------------------------------------------------------------------


def test_noise_of_windows_runs_and_spikes() -> None:
    x = np.array([0.5, 3.0])
    assert [noise.tied(a, 2.0) for a in 2 * x] == pytest.approx(np.sqrt(2 * x / (1 - np.exp(-2 * x))))
    assert noise.tied(0.0, 1.0) == 1.0
    assert noise._runs(np.array([True, True, False, True])).tolist() == [[0, 2], [3, 4]]
    rng = np.random.default_rng(3)
    row = 1e-3 * (rng.standard_normal(400) + 1j * rng.standard_normal(400))
    y = np.array([row, row[::-1]])
    assert not noise.outliers(y).any()
    y[0, 100] += 0.5
    y[1, 200] -= 0.5j
    assert [np.flatnonzero(out).tolist() for out in noise.outliers(y)] == [[100], [200]]
    sharp = y[1:] * 0 + row + 0.01 * resonances(np.arange(400.0) + 100, [300.0], [60.0]) * 1e3
    assert not noise.outliers(sharp).any()
    assert not noise.outliers(y[:, :9]).any()
    with pytest.raises(ValueError, match="9 bins tell no noise; 10 or more do"):
        noise.of_neighbours(y[:, :9])
    fourth = np.convolve(np.eye(1, 9, 4)[0] * 3, noise._FOURTH)[2:-2]
    assert noise._spikes(fourth[2:7] * 10 + 0j, 50) == [54]


@pytest.mark.parametrize(("bins", "size"), [((150, 151), 40.0), ((150, 151), -30.0), ((150, 152), 40.0)])
def test_spikes_beside_each_other_are_both_found(bins: tuple[int, ...], size: float) -> None:
    """Those that explain the differences best, not others that explain them nearly."""
    rng = np.random.default_rng(4)
    y = (rng.standard_normal((1, 400)) + 1j * rng.standard_normal((1, 400))) / np.sqrt(2)
    y[0, list(bins)] += size
    assert np.flatnonzero(noise.outliers(y)[0]).tolist() == list(bins)


def test_noise_of_a_coherence_has_ends() -> None:
    """A coherence of 1 counts as 1 - 1e-9, one of 0 as 1e-4; two hits have no bias that could be taken out."""
    response = np.full((1, 80), 3.0 - 4.0j)
    for coherence, g in ((1.0, 1 - 1e-9), (0.0, 1e-4), (0.6, 0.6)):
        for n, bias in ((5, 5 / 4), (2, 1.0)):
            sigma = noise.of_coherence(response, np.full((1, 80), coherence), n)
            assert sigma == pytest.approx(5.0 * np.sqrt(bias * (1 - g) / (n * g)), rel=1e-6)


def test_two_parts_are_found_from_medians() -> None:
    """Powers that are exactly a + r |Y|^2; a constant level has no relative part."""
    size = np.random.default_rng(4).uniform(0.1, 9.0, (2, 600)) ** 2
    power = np.array([[2.0], [0.0]]) + np.array([[0.3], [0.01]]) * size
    assert noise._two_parts(power, size) == pytest.approx(power, rel=0.02)
    assert noise.of_misfit(np.full((1, 400), 2.0 + 0j)) == pytest.approx(np.full((1, 400), 2 / np.sqrt(np.log(2))))


def responses(truth, freq=FREQ, **more):
    return Responses(freq, truth.mobility(freq), (("a", "a"), ("b", "a")), **more)


def test_bands_hold_both_ends_and_no_zero(truth) -> None:
    freq = np.concatenate([[0.005], np.arange(1.0, 101.0)])
    y = truth.mobility(freq)
    y[0, 50] = np.nan
    r = Responses(freq, y, (("a", "a"), ("b", "a")), coherence=np.ones((2, 101)), pressure={("m", "a"): y[1]})
    assert r.band(None, None).freq.tolist() == [*range(1, 50), *range(51, 101)]
    part = r.band(10.0, 60.0)
    assert (part.freq[0], part.freq[-1], part.freq.size) == (10.0, 60.0, 50)
    assert part.coherence.shape == (2, 50)
    assert part.pressure["m", "a"] == pytest.approx(truth.mobility(part.freq)[1])
    assert r.band(69.0, 100.0).freq.size == 32
    with pytest.raises(TonewoodError, match="31 bins lie between 70 and 100 Hz; 32 or more are needed"):
        r.band(70.0, None)


def test_names_references_and_exchange(truth) -> None:
    y = np.arange(4.0)[:, None] * np.ones(5) + 0j
    pairs = (("a", "a"), ("a", "b"), ("c", "b"), ("b", "d"))
    r = Responses(np.arange(5.0), y, pairs, pressure={("m", "b"): y[0], ("m", "a"): y[1]})
    assert (r.points, r.references, r.driving, r.microphones) == (("a", "b", "c", "d"), ("a", "b", "d"), (0,), ("m",))
    assert r.reciprocal().pairs == (("a", "a"), ("b", "a"), ("c", "b"), ("b", "d"))
    kept, others = r.reciprocal().of_driven()
    assert (kept.pairs, others) == ((("a", "a"), ("b", "a")), ("b", "d"))
    assert kept.mobility[:, 0].tolist() == [0.0, 1.0]
    assert list(kept.pressure) == [("m", "a")]
    about = Responses(r.freq, y[:2], (("s", "a"), ("s", "b")))
    assert about.reciprocal().pairs == (("a", "s"), ("b", "s"))
    assert about.of_driven() == (about, ())
    new = r.renamed({"a": "x", "m": "mic"})
    assert new.pairs == (("x", "x"), ("x", "b"), ("c", "b"), ("b", "d"))
    assert list(new.pressure) == [("mic", "b"), ("mic", "x")]
    with pytest.raises(TonewoodError, match="there is no point 'q'; there are a, b, c, d, m"):
        r.renamed({"q": "x"})
    with pytest.raises(TonewoodError, match="two points would be called 'b'"):
        r.renamed({"a": "b"})


def test_what_no_body_has_is_told(truth) -> None:
    r = responses(truth)
    assert r.checked() is r
    assert r.no_body() is None
    assert replace(r, pairs=(("b", "a"), ("c", "a"))).no_body().startswith("no driving point: the sensor did not")
    assert "'a' has a negative real part over 100%" in replace(r, mobility=-r.mobility).no_body()
    half = r.mobility * np.where(FREQ < 60 + 0.07 * 741, -1, 1)  # 7 % of the band
    assert "over 7%" in replace(r, mobility=half).no_body()
    assert replace(r, mobility=r.mobility * np.where(FREQ < 60 + 0.04 * 741, -1, 1)).no_body() is None
    size = float(np.median(np.abs(r.mobility[0])))
    kg = 1 / (TAU * np.sqrt(60.0 * 800.0) * size)
    for mass, told in ((1.1e-5, False), (0.9e-5, True), (0.9e4, False), (1.1e4, True)):
        assert (replace(r, mobility=r.mobility * kg / mass).no_body() is not None) == told
    with pytest.raises(TonewoodError, match="rings before it is struck"):
        replace(r, mobility=r.mobility.conj()).checked()
    with pytest.raises(TonewoodError, match="do not rise"):
        replace(r, freq=r.freq[::-1]).checked()
    zero = r.mobility.copy()
    zero[1, 31:] = 0
    with pytest.raises(TonewoodError, match="b:a is 0 in nearly all bins"):
        replace(r, mobility=zero).checked()
    zero[1, 31] = 1e-3
    with pytest.raises(TonewoodError, match="rings"):
        replace(r, mobility=zero.conj()).checked()


def test_incoherent_parts_and_outliers(truth) -> None:
    coherence = np.ones((2, 741))
    coherence[0, 100:200] = 0.4
    coherence[0, 400:410] = 0.1  # shorter than half of the running median
    r = responses(truth, coherence=coherence)
    assert r.incoherent(0) == [(160.0, 259.0)]
    assert r.incoherent(1) == []
    assert responses(truth).incoherent(0) == []
    spiked = r.mobility.copy()
    spiked[1, 300] += 1.0
    kept, out = replace(r, mobility=spiked).without_outliers()
    assert out == (360.0,)
    assert (kept.freq.size, kept.mobility.shape, kept.coherence.shape) == (740, (2, 740), (2, 740))
    uneven = np.array([*FREQ[:-1], 800.5])
    assert replace(r, freq=uneven, mobility=spiked).without_outliers()[1] == ()


@pytest.mark.parametrize(("form", "power"), [("receptance", 1), ("mobility", 0), ("accelerance", -1)])
def test_forms_are_powers_of_s(form, power) -> None:
    freq, y = np.array([10.0, 20.0]), np.array([1.0 + 1j, 2.0])
    assert to_mobility(y, freq, form, 3.0) == pytest.approx(y * (3.0 + 1j * TAU * freq) ** power)
    if power < 0:
        assert to_mobility(y, np.array([0.0, 1.0]), form)[0] == 0


def test_a_second_pulse_is_a_double_hit() -> None:
    fs, force = 10000.0, 1e-4 * np.random.default_rng(1).standard_normal(4000)
    force[1000:1010] += np.hanning(10)
    assert not is_double(force, fs)
    for at, size, double in (
        (2000, 0.05, True),
        (2000, 0.02, False),
        (1024, 0.05, False),
        (1036, 0.05, True),
        (500, 0.05, True),
    ):
        again = force.copy()
        again[at] += size
        assert is_double(again, fs) is double
    noisy = force + 0.01 * np.random.default_rng(2).standard_normal(4000)
    assert not is_double(noisy, fs)
    assert not is_double(np.ones(3), fs)


def test_lines_of_a_drift_have_its_figures() -> None:
    zero, common, peak = Drift((0.012, 0.0), (0.001, -0.002), ((250.0, 0.004, 0.5),)).lines(("force", "a"))
    assert "of force (1.2 % of its peak)" in zero
    assert "drift by 0.3 % from hit to hit (+0.1, -0.2 %)" in common
    assert peak.startswith("the peak at 250 Hz drifts by 0.4 % from hit to hit, 50% of its bandwidth")
    assert Drift((0.0, 0.0), (0.0,)).lines(("force", "a")) == ()


# -- files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("time", "rate"),
    [
        (np.arange(50) / 1000, 1000.0),
        (np.round(np.arange(3000) / 2000, 3), 2000.0),  # some times repeat
        (np.round(np.arange(1000) / 100 / 0.02) * 0.02, 100.0),  # two thousandths of 10 s are 20 ms
        (np.round(np.arange(500) / 10000, 3), None),  # of 50 ms 0.1 ms
        (np.array([0.0, 1.0, 2.005]), 2 / 2.005),
        (np.array([0.0, 1.0, 2.02]), None),
        (np.array([0.0, 1.0, 1.0, 3.0]), None),
        (np.zeros(3), None),
        (np.zeros(1), None),
    ],
)
def test_rates_of_times(time, rate) -> None:
    if rate is None:
        with pytest.raises(TonewoodError, match="times are not evenly spaced"):
            files._rate(Path("a.csv"), time)
    else:
        assert files._rate(Path("a.csv"), time) == pytest.approx(rate, rel=1e-3 if time.size > 99 else 1e-9)


def test_two_sided_and_padded_data_are_told() -> None:
    half = np.array([1 + 1j, 2 - 1j, 0.5j])
    assert files._mirrored([np.concatenate([half, half[::-1].conj()])]) == 3
    assert files._mirrored([np.concatenate([[7.0], half, [4.0], half[::-1].conj()])]) == 5
    assert files._mirrored([np.concatenate([half, half])]) == 0
    assert files._mirrored([np.concatenate([half, half[::-1].conj()]), np.arange(6) + 1j]) == 0
    assert files._mirrored([np.ones(6, complex)]) == 0
    assert files._padded(np.append(np.ones(18), np.zeros(2)))
    assert not files._padded(np.append(np.ones(19), np.zeros(1)))
    assert files._padded(np.zeros(1))


def test_nodes_without_a_response_are_named() -> None:
    def sets(nodes, reference=1):
        return [{"rsp_node": n, "ref_node": reference} for n in nodes]

    path = Path("a.uff")
    assert universal._missing_nodes(path, [{"type": 58}], sets([1, 2, 4])) == (
        "a.uff has no response at 1 of its nodes: 3; sets may be missing",
    )
    geometry = {"type": 15, "node_nums": [1, 2, 4, 9]}
    assert universal._missing_nodes(path, geometry, sets([1, 2, 4]))[0].count(": 9;") == 1
    assert universal._missing_nodes(path, [], sets([1, 2, 3])) == ()
    assert universal._missing_nodes(path, [], sets([1, 9])) == ()
    many = [{"type": 15, "node_nums": range(1, 15)}]
    (line,) = universal._missing_nodes(path, many, sets(range(1, 8)))
    assert "at 7 of its nodes: 8, 9, 10, 11, 12, 13 ...;" in line
    moved = [{"rsp_node": 1, "ref_node": n} for n in (1, 2, 4)]
    assert ": 3;" in universal._missing_nodes(path, [], moved)[0]


def test_ends_of_universal_files() -> None:
    for line, bound in (
        (b"    -1", True),
        (b"ab    -1", True),
        (b"abcde    -1", False),
        (b"a\0cdef    -1", True),
        (b"    -2", False),
    ):
        assert universal._bounds(line) is bound
    assert universal._uff_units([{"type": 15}, {"type": 164, "force": 2, "length": 3}]) == (2.0, 3.0)
    assert universal._uff_units({"type": 58}) == (1.0, 1.0)


def test_a_hit_is_scaled_and_named() -> None:
    reading = files.Reading("mobility", points=("p", "q"), references=(("p", "a_"),), sensitivity=(2.0, 3.0, 4.0))
    hit = files._scaled(Path("a_1.wav"), 100.0, np.array([[1.0, 2], [1, 0], [0, 1]]), reading, reading.sensitivity)
    assert (hit.force.tolist(), hit.motion.tolist()) == ([2.0, 4.0], [[3.0, 0.0], [0.0, 4.0]])
    assert (hit.names, hit.reference, hit.fs) == (("p", "q"), "p", 100.0)
    for channels, sensitivity, name, said in (
        (1, (1.0,), "a_1.wav", "has one channel"),
        (2, (1.0, 1.0), "a_1.wav", "has 1 responses; --points names 2"),
        (3, (1.0, 1.0), "a_1.wav", "has 3 channels; --sensitivity gives 2 numbers"),
        (3, (1.0, 1.0, 1.0), "b.wav", "is not named"),
    ):
        with pytest.raises(TonewoodError, match=said):
            files._scaled(Path(name), 1.0, np.ones((channels, 2)), reading, sensitivity)


# -- hits --------------------------------------------------------------------------------------------------------------


def shifted_hits(shift, noise_size=0.0, seed=5):
    """Hits X = F (H - e f H') of two responses; forces of constant shares of the power, any phase."""
    rng, freq = np.random.default_rng(seed), np.arange(1.0, 201.0)
    size = np.array([1.0, 2.0, 3.0])
    force = size[:, None] * np.exp(2j * np.pi * rng.uniform(size=(3, 200)))
    h, slope = rng.standard_normal((2, 2, 200)) + 1j * rng.standard_normal((2, 2, 200))
    motion = force[:, None] * (h - np.asarray(shift)[:, None, None] * freq * slope)
    motion = motion + noise_size * (rng.standard_normal(motion.shape) + 1j * rng.standard_normal(motion.shape))
    turn = 0.01 * rng.standard_normal((3, 200))
    return drift.Spectra(freq, force, motion, force * turn, motion * turn[:, None] + force[:, None] * slope), size


def test_shifts_of_hits_are_relative_to_the_mean_by_power() -> None:
    """H of all hits by H1 moves by the mean of their shifts, weighted by the power of their forces."""
    shift, bins = np.array([3e-6, -1e-6, 2e-6]), np.arange(20, 180)
    spectra, size = shifted_hits(shift)
    moved, deviation = spectra.moves(bins)
    assert moved == pytest.approx(shift - np.sum(size**2 * shift) / np.sum(size**2), rel=1e-4)
    assert np.all(deviation < 1e-9)
    many = [shifted_hits(np.zeros(3), 1.0, seed)[0].moves(bins) for seed in range(60)]
    spread = np.std([m for m, _ in many], axis=0)
    assert np.mean([d for _, d in many], axis=0) == pytest.approx(spread, rel=0.35)


def test_spectra_of_hits_are_those_at_their_own_frequencies() -> None:
    """Sums over the samples at (1 + e) f; slopes in f, with time from the sample of the largest force on."""
    rng, fs, stretch = np.random.default_rng(6), 40.0, np.array([0.0, 0.01])
    force, motion = rng.standard_normal((2, 20)), rng.standard_normal((2, 3, 20))
    force[1, 4] = 9.0
    spectra = drift.Spectra.of(force, motion, fs, stretch)
    assert spectra.freq.tolist() == [2.0 * i for i in range(11)]
    t = np.arange(20) / fs
    for h, e in enumerate(stretch):
        turns = np.exp(-1j * TAU * (1 + e) * spectra.freq[:, None] * t)
        slopes = -1j * TAU * (1 + e) * turns * (t - 4 / fs)
        assert spectra.force[h] == pytest.approx(turns @ force[h])
        assert spectra.motion[h] == pytest.approx(motion[h] @ turns.T)
        assert spectra.force_slope[h] == pytest.approx(slopes @ force[h])
        assert spectra.motion_slope[h] == pytest.approx(motion[h] @ slopes.T)


def test_peaks_have_the_width_of_half_their_power() -> None:
    """Triangles of |H|^2 |F|^2 at bins 50 and 120, forces of any size and phase; the third is too low."""
    power = np.zeros(200)
    for at, height in ((50, 1.0), (120, 0.01), (160, 0.9e-4)):
        power += height * np.maximum(0, 1 - np.abs(np.arange(200) - at) / 9.5)
    rng = np.random.default_rng(8)
    force = rng.uniform(1, 3, (2, 200)) * np.exp(2j * np.pi * rng.uniform(size=(2, 200)))
    response = np.sqrt(power / np.sum(np.abs(force) ** 2, axis=0)) * np.array([[0.6], [0.8j]])
    motion = force[:, None] * response
    peaks = drift.Spectra(2.0 * np.arange(200), force, motion, 0 * force, 0 * motion).peaks()
    assert [width for _, width in peaks] == [18.0, 18.0]  # the nine bins above half, of 2 Hz
    assert [(bins[0], bins[-1]) for bins, _ in peaks] == [(37, 63), (107, 133)]


def test_one_hit_is_not_brought_together() -> None:
    hit = np.zeros((1, 64))
    hit[0, 3] = 2.0
    spectra, stretch, peaks = drift.brought_together(hit, hit[:, None] * 0.5, 640.0)
    assert (stretch.tolist(), peaks) == ([0.0], [])
    assert spectra.freq[[1, -1]].tolist() == [10.0, 320.0]
    assert spectra.motion[0, 0] == pytest.approx(np.exp(-2j * np.pi * np.arange(33) * 3 / 64))
    assert np.abs(spectra.force_slope).max() < 1e-12  # time begins at the hit


# -- more files --------------------------------------------------------------------------------------------------------


def test_a_universal_file_cut_off_after_its_nodes_names_them(tmp_path) -> None:
    """The node line is the eighth of a data set; of seven lines it is not there."""
    nodes = "    4         0    1         0       NONE        12   3       NONE         7   3"
    lines = ["    -1", "    58", *["text"] * 5, nodes]
    for count, said in ((8, r"data set 1 \(response at node 12 to node 7\), and"), (7, "data set 1, and")):
        (tmp_path / "a.uff").write_text("\n".join(lines[:count]) + "\n")
        with pytest.raises(TonewoodError, match=said):
            universal._whole(tmp_path / "a.uff")
    (tmp_path / "a.uff").write_text("\n".join([*lines, "    -1"]) + "\n")
    assert universal._whole(tmp_path / "a.uff") is None


def test_signs_at_the_end_of_each_line_are_no_columns(tmp_path) -> None:
    rows = [(100.0 + k, 0.5 * k, -1.0 * k) for k in range(64)]
    text = "\n".join(["f;re;im;;", *("{};{};{};;".format(*row) for row in rows)])
    (tmp_path / "a.csv").write_text(text)
    _, columns, names, others = texts._table(tmp_path / "a.csv")
    assert columns.T.tolist() == [list(row) for row in rows]
    assert (names, others) == ([], 0)  # words of the head and columns do not match in number


@pytest.mark.parametrize(
    ("shape", "pairs"),
    [
        ((9,), [("H", "unnamed")]),
        ((9, 2), [("H_1", "unnamed"), ("H_2", "unnamed")]),
        ((9, 2, 2), [("H_1", "H_1"), ("H_1", "H_2"), ("H_2", "H_1"), ("H_2", "H_2")]),
        ((9, 1, 2), [("H_1", "unnamed_1"), ("H_1", "unnamed_2")]),
    ],
)
def test_arrays_are_rows_of_points_and_references(shape, pairs) -> None:
    x = np.arange(float(np.prod(shape))).reshape(shape)
    found = arrays._pairs_of("a.H", x)
    assert [pair for pair, _ in found] == pairs
    for (_, row), expected in zip(found, x.reshape(9, -1).T, strict=True):
        assert row.tolist() == expected.tolist()
