"""Limits and rules of a fit, each at a number worked out in the test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fit_scenes import TAU, Truth

from tonewood.errors import TonewoodError
from tonewood.workshop.fit import arrays, drift, files, identify, noise, radiation, search
from tonewood.workshop.fit.body import _shapes, passive_body
from tonewood.workshop.fit.fit import Fit, fit_responses
from tonewood.workshop.fit.hits import is_double
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape
from tonewood.workshop.fit.responses import Responses

FREQ = np.arange(60.0, 801.0)
REAL = Shape((0,), 2, False, False, False)
FS = 10000.0  # 2 ms around a pulse are 20 samples


def resonances(freq, at, quality):
    s, w = 1j * TAU * np.asarray(freq), TAU * np.asarray(at, float)[:, None]
    return s / (s * s + w / np.asarray(quality, float)[:, None] * s + w * w)


# hits


def pulses(*samples):
    """4000 samples of 0 with some (first, values)."""
    force = np.zeros(4000)
    for first, values in samples:
        force[first : first + len(values)] = values
    return force


@pytest.mark.parametrize(
    ("samples", "double"),
    [
        # a tail above a twentieth of the peak belongs to the pulse, one below is a second hit
        ([(1000, [1.0]), (1001, [0.07] * 40)], False),
        ([(1000, [1.0]), (1001, [0.04] * 40)], True),
        # a pulse of 40 samples keeps 40 on both sides of it clear
        ([(1000, [1.0] * 39), (1078, [0.1])], False),
        ([(1000, [1.0] * 39), (1079, [0.1])], True),
        ([(1000, [1.0] * 39), (959, [0.1])], False),
        ([(1000, [1.0] * 39), (958, [0.1])], True),
        # at the ends of the record, where nothing is below a twentieth
        ([(0, [1.0] * 30), (59, [0.1])], False),
        ([(0, [1.0] * 30), (60, [0.1])], True),
        ([(3960, [1.0] * 40), (3918, [0.1])], True),
        ([(3960, [1.0] * 40), (3919, [0.1])], False),
    ],
)
def test_a_pulse_keeps_its_own_width_clear(samples, double) -> None:
    assert is_double(pulses(*samples), FS) is double


@pytest.mark.parametrize(("second", "double"), [(0.117, False), (0.120, True)])
def test_a_second_hit_stands_out_of_noise_by_eight_deviations(second, double) -> None:
    """Noise of +-0.01: its normal deviation is 1.4826 medians of the absolute values, eight of them are 0.1186."""
    force = 0.01 * (-1.0) ** np.arange(4000)
    force[1000], force[3000] = 1.0, second
    assert is_double(force, FS) is double


# shapes and modes


def test_a_certain_shape_may_be_small() -> None:
    """Residues far below 1/kg, as of heavy bodies, beside noise that is larger than they are."""
    pairs = (("a", "a"), ("b", "a"), ("b", "b"))
    for size in (0.5, 1e-6):
        shapes, error = _shapes(size * np.array([4.0, 2.0, 1.0]), np.full(3, size), pairs, ("a", "b"), certain=True)
        assert np.abs(shapes) == pytest.approx(np.sqrt(size) * np.array([[2.0, 1.0]]))
        assert error == pytest.approx(1 / 5)


def test_modes_of_the_band_are_measured_and_those_beside_it_are_not() -> None:
    """Bins from 60 to 800 Hz; a Q below 2 is background."""
    at, quality = [59.5, 60.5, 200.0, 300.0, 799.5, 800.5], [30.0, 30.0, 1.99, 2.01, 30.0, 30.0]
    y = np.ones((2, 6)) @ resonances(FREQ, at, quality)
    problem, poles = Projection(FitData(FREQ, y, np.full(y.shape, 1e-6)), REAL), Poles.at(at, quality)
    body = passive_body(
        SimpleNamespace(problem=problem, poles=poles, solution=problem.solve(poles)), (("a", "a"), ("b", "a"))
    )
    assert body.freq == pytest.approx(at)
    assert body.measured.tolist() == [False, True, False, True, True, False]


@pytest.mark.parametrize("weak", [0, 1])
def test_a_mode_that_nobody_would_see_may_be_any(weak) -> None:
    residues = np.where(np.arange(2) == weak, 1e-6, 1.0)
    y = residues @ resonances(FREQ, [200.0, 600.0], [40.0, 60.0])
    problem = Projection(FitData(FREQ, y[None], np.full((1, FREQ.size), 1e-9)), REAL)
    assert search.inaudible(problem, Poles.at([200.0, 600.0], [40.0, 60.0]), np.zeros(0)).tolist() == [weak]


# warnings


@pytest.fixture(scope="module")
def fitted() -> Fit:
    truth = Truth(np.array([150.0, 320.0]), np.array([30.0, 50.0]), np.array([[1.0, 2.0], [-0.5, 1.0]]))
    freq = np.arange(80.0, 481.0)
    y, _ = truth.noisy(freq, 0.003, 1)
    return fit_responses(Responses(freq, y, (("a", "a"), ("b", "a"))), damping="viscous")


def warned(fitted, rows=(), **more):
    """Warnings with rows of numbers, of responses that differ."""
    fit = Fit(replace(fitted.responses, **more), fitted.modes, fitted.body)
    fit.__dict__["rows"] = [{"measured": True, "mass_kg": 1.0, "freq_Hz": 300.0, "Q": 10.0} | row for row in rows]
    return "\n".join(fit.warnings)


def test_a_window_widens_bandwidths(fitted) -> None:
    """exp(-t/tau) adds 1/(pi tau) to the bandwidth of a mode: here 1 Hz, to 300 Hz / Q."""
    assert "holds fewer" in warned(fitted, [{"Q": 103.0}])
    assert "holds fewer" not in warned(fitted, [{"Q": 149.0}], alpha=np.pi)
    assert "mode at 300.0 Hz: its bandwidth of 2.5 Hz (Q 200)" in warned(fitted, [{"Q": 200.0}], alpha=np.pi)
    assert Fit(replace(fitted.responses, alpha=4.0), fitted.modes, fitted.body).facts()["window_tau_s"] == 0.25
    assert fitted.facts()["hits"] is None


def test_parts_of_low_coherence_have_a_width(fitted) -> None:
    """16 of the 31 bins around bin 100 are low, fewer around any other: one bin is no part of the band."""
    coherence = np.ones((2, 401))
    coherence[0, [*range(85, 93), *range(108, 116)]] = 0.1
    assert "is low" not in warned(fitted, coherence=coherence, n_hits=4)
    coherence[:] = 1.0
    for k in range(3):
        coherence[0, 10 + 80 * k : 50 + 80 * k] = 0.1
    assert "is low: 90 to 129 Hz, 170 to 209 Hz, 250 to 289 Hz; move" in warned(fitted, coherence=coherence, n_hits=4)
    # without a driving point the first response tells
    assert "coherence at b is low" in warned(fitted, coherence=coherence, n_hits=4, pairs=(("b", "a"), ("c", "a")))
    two = warned(fitted, coherence=coherence[::-1], n_hits=4, pairs=(("a", "b"), ("b", "b")))
    assert "coherence at b is low" in two


# noise


def running_median(row, width):
    """Medians of an odd number of values, mirrored at the ends without repeating these."""
    half = width // 2
    return np.array([np.median(np.pad(row, half, "reflect")[i : i + width]) for i in range(row.size)])


@pytest.mark.parametrize(("bins", "width"), [(400, 151), (100, 99), (101, 99)])
def test_noise_of_neighbours_is_a_running_median_of_fourth_differences(bins, width) -> None:
    """Of a response of constant size, whose relative part is the additive one; the median of |e|^2 is sigma^2 ln 2."""
    y = np.exp(1j * np.random.default_rng(1).uniform(0, TAU, bins))
    fourth = y[:-4] - 4 * y[1:-3] + 6 * y[2:-2] - 4 * y[3:-1] + y[4:]
    power = np.pad(np.abs(fourth) ** 2 / 70.0, 2, "edge")
    assert noise.of_neighbours(y[None])[0] == pytest.approx(np.sqrt(running_median(power, width) / np.log(2)))


def test_noise_of_a_misfit_and_of_a_coherence_are_smoothed_over_their_bins() -> None:
    rng = np.random.default_rng(2)
    misfit = rng.standard_normal(500) + 1j * rng.standard_normal(500)
    assert noise.of_misfit(misfit[None])[0] == pytest.approx(
        np.sqrt(running_median(np.abs(misfit) ** 2, 201) / np.log(2))
    )
    g = rng.uniform(0.5, 0.9, 200)
    level = np.pad(np.log(1.25 * (1 - g) / (5 * g) * 4.0), 15, "reflect")
    smooth = np.array([np.mean(level[i : i + 31]) for i in range(200)])
    assert noise.of_coherence(np.full((1, 200), 2j), g[None], 5)[0] == pytest.approx(np.exp(0.5 * smooth))


@pytest.mark.parametrize(
    ("sizes", "found"),
    [
        ({150: 20.0}, [150]),  # 20 * 6 / sqrt(70) is above ten deviations, 10 times that is not
        ({150: 10.0}, []),
        ({150: 40.0, 152: 8.0}, [150, 152]),  # the second one is above four and a half
        ({150: 40.0, 158: 10.0}, [150]),  # a run of its own begins with ten deviations
    ],
)
def test_runs_of_outliers_begin_at_ten_deviations_and_end_below_four_and_a_half(sizes, found) -> None:
    rng = np.random.default_rng(4)
    y = (rng.standard_normal((1, 400)) + 1j * rng.standard_normal((1, 400))) / np.sqrt(2)
    y[0, list(sizes)] += list(sizes.values())
    assert np.flatnonzero(noise.outliers(y)[0]).tolist() == found


@pytest.mark.parametrize(("length", "found"), [(14, [7]), (15, [])])
def test_long_runs_of_outliers_are_left(length, found) -> None:
    """Of one spike, in a run of fourth differences that begins at bin 5 and has its centre at place 4."""
    fourth = np.zeros(length, complex)
    fourth[2:7] = 100 * noise._FOURTH
    assert noise._spikes(fourth, 1) == found


# the search


def test_a_candidate_may_be_negative_at_a_driving_point_within_its_noise() -> None:
    freq = np.arange(100.0, 1000.0)
    zero = np.zeros((2, freq.size), complex)
    problem = Projection(FitData(freq, zero, np.ones((2, freq.size))), Shape((0, 1), 2))
    filters = search.MatchedFilters(problem)
    at, quality = filters._grid
    k = int(np.flatnonzero(quality == 25)[40])
    y = resonances(freq, [at[k]], [25.0])[0]
    y = y / np.sqrt(np.sum(2 * np.abs(y) ** 2))  # a gain of 1
    for second, itself in ((2.9, True), (3.1, False)):  # beyond doubt, a neighbour of the grid stands in for it
        found = filters.candidates(np.array([40 * y, -second * y]), 1)
        assert np.allclose([found.freq[0], found.quality[0]], [at[k], 25.0], rtol=1e-6) is itself


@pytest.mark.parametrize(
    ("driving", "apart", "structural"),
    [((0,), 0.9, True), ((0,), 1.1, False), ((), 0.9, False)],
)
def test_of_two_kinds_of_damping_that_fit_alike_real_residues_decide(driving, apart, structural, monkeypatch) -> None:
    """Alike: their totals differ by less than a twentieth of the numbers measured. Viscous is better by that."""
    freq = np.arange(100.0, 301.0)
    y = resonances(freq, [200.0], [40.0])
    bins = 2 * freq.size

    class Order(identify._Order):
        def total(self, allowed):
            return 0.05 * bins * apart * self.shape.structural

        def total_of_real(self, allowed):
            return 1.0 - self.shape.structural

    made = []

    def ordered(data, shape, least_error, note):
        made.append(shape.structural)
        return Order(data, shape, Poles.at([200.0], [40.0]), ())

    monkeypatch.setattr(identify, "_ordered", ordered)
    modes = identify.identify(freq, y, Shape(driving, 1, True, False, False), sigma=np.full(y.shape, 1e-3))
    assert made == [False, True]
    assert modes.structural is structural


# drift, arrays, microphones


@pytest.mark.parametrize(("slope", "told"), [(0.0015, True), (0.0009, False)])
def test_a_zero_that_drifts_by_less_than_a_thousandth_is_not_told(slope, told) -> None:
    hit = np.where(np.arange(400) == 100, 2.0, 0.0)
    line = slope * np.linspace(0, 1, 400)
    _, motion, moved = drift.level_zero(hit[None], (0.5 * hit + line)[None, None])
    np.testing.assert_allclose(motion[0, 0], 0.5 * hit, atol=1e-12)
    assert moved == pytest.approx([0.0, slope if told else 0.0])


def test_two_rising_values_may_be_frequencies_in_rad_s() -> None:
    given = {"omega": np.array([1.0, 2.0]), "H": np.array([1j, 2j])}
    with pytest.raises(TonewoodError, match="omega may be in rad/s: save freq_Hz = omega"):
        arrays.responses_of_arrays(Path("a.npz"), given)


def test_a_bank_begins_with_the_modes_of_the_body_and_rings_no_longer_beyond_the_band(monkeypatch) -> None:
    """Its high-pass is at a fifth of the band's lower end, from 1 to 200 Hz; a point without a place is the middle."""
    asked = []

    def sought(data, shape, start, tell):
        asked.append((data, shape, start, tell))
        return Projection(data, shape), Poles.at([0.5 * FREQ[0], 200.0, 500.0, 850.0], [300.0, 8.0, 60.0, 200.0])

    monkeypatch.setattr(radiation, "sought", sought)
    rng = np.random.default_rng(1)
    heard = {
        (name, reference): rng.standard_normal(FREQ.size) + 1j * rng.standard_normal(FREQ.size)
        for name in "mn" for reference in "ab"
    }  # fmt: skip
    given = Responses(FREQ, np.ones((2, FREQ.size), complex), (("a", "a"), ("b", "b")), alpha=2.0, pressure=heard)
    body = SimpleNamespace(
        freq=np.array([201.0, 498.0, 900.0]), quality=np.array([9.0, 70.0, 5.0]), measured=np.array([1, 1, 0], bool)
    )
    tell = print
    bank = radiation.fit_radiation(given, body, {"b": 0.5}, tell=tell)
    assert np.abs(bank.poles) / TAU == pytest.approx([30.0, 200.0, 500.0, 850.0])
    assert -0.5 * np.abs(bank.poles) / bank.poles.real == pytest.approx([60.0, 8.0, 60.0, 60.0])
    ((data, shape, start, told),) = asked
    assert shape == Shape((), 4, True, False, False)
    assert told is tell
    assert (start.freq, start.quality) == (pytest.approx([201.0, 498.0]), pytest.approx([9.0, 70.0]))
    s = 2.0 + 1j * TAU * FREQ
    cut = s * s / ((s + TAU * 12 * 0.8) * (s + TAU * 12 * 1.25))
    rows = np.array(list(heard.values()))
    assert data.alpha == 2.0
    assert data.mobility == pytest.approx(rows / cut)
    assert data.sigma == pytest.approx(noise.of_neighbours(rows) / np.abs(cut))
    # the bank is what least squares give to each microphone from a at 0 and b at 0.5
    problem = Projection(data, shape)
    poles = Poles(np.log(np.abs(bank.poles)), np.log(-bank.poles.real / np.abs(bank.poles)))
    model = problem.model(poles, problem.solve(poles).residues)
    for r, u in enumerate((0.0, 0.5)):
        assert bank.pressure(FREQ, u, 2.0) == pytest.approx((model * cut)[[r, 2 + r]], rel=1e-6)
        level = np.abs(bank.pressure(FREQ, u, 2.0)) / np.abs(rows[[r, 2 + r]])
        assert bank.error_db[[r, 2 + r]] == pytest.approx(20 * np.log10(level))
    for scale, low_cut in ((0.05, 1.0), (20.0, 200.0), (2.0, 24.0)):
        assert radiation.fit_radiation(replace(given, freq=FREQ * scale), body, {"b": 0.5}).low_cut == low_cut


def test_a_file_of_arrays_runs_no_code(tmp_path) -> None:
    """Objects in a file of NumPy are pickles, whose reading may call anything."""
    ran = tmp_path / "ran"

    class Call:
        def __reduce__(self):
            return Path.touch, (ran,)

    for name, save in (("a.npy", np.save), ("a.npz", np.savez)):
        save(tmp_path / name, np.array([Call()], dtype=object), allow_pickle=True)
        with pytest.raises(TonewoodError, match=rf"is no {name[2:]} file of arrays"):
            arrays.npz_arrays(tmp_path / name)
    assert not ran.exists()


def test_coherences_are_real_arrays_of_the_responses_shape() -> None:
    freq = np.arange(1.0, 21.0)
    h = np.array([1.0, 2.0]) * (1 + 1j * freq[:, None])
    g = np.array([0.5, 0.25]) * np.ones((20, 1))
    given = {"freq_Hz": freq, "H": h, "coherence": g, "coh_one": g[:, 0], "cohort": 1j * g}
    table = arrays.responses_of_arrays(Path("a.mat"), given, ["H"])
    assert list(table.rows) == list(table.coherence) == [("H_1", "unnamed"), ("H_2", "unnamed")]
    assert [row.tolist() for row in table.coherence.values()] == [[0.5] * 20, [0.25] * 20]
    assert not arrays.responses_of_arrays(Path("a.mat"), {"freq_Hz": freq, "H": h, "cohort": 1j * g}, ["H"]).coherence


def test_a_band_without_ends_begins_with_the_data() -> None:
    """Below 1 Hz, too; what lies below a hundredth of a step stands for 0 Hz."""
    freq = np.array([0.0, 9e-4, *np.arange(0.1, 5.0, 0.1)])
    r = Responses(freq, np.ones((1, freq.size), complex), (("a", "a"),))
    assert r.band(None, None).freq[0] == pytest.approx(0.1)
    assert r.band(-1.0, 0.0).freq.size == 49
    assert r.band(0.35, 4.0).freq[[0, -1]] == pytest.approx([0.4, 4.0])


def test_shifts_of_hits_are_weighted_by_the_noise_of_each_response() -> None:
    """A second response that is noise alone changes nothing."""
    rng, freq, shift = np.random.default_rng(5), np.arange(1.0, 201.0), np.array([3e-6, -1e-6, -2e-6])
    force = np.exp(2j * np.pi * rng.uniform(size=(3, 200)))
    h, slope = rng.standard_normal((2, 200)) + 1j * rng.standard_normal((2, 200))
    clean = force * (h - shift[:, None] * freq * slope)
    motion = np.stack([clean, 30.0 * (rng.standard_normal((3, 200)) + 1j * rng.standard_normal((3, 200)))], axis=1)
    slopes = np.stack([force * slope, 0 * force + 1.0], axis=1)
    moved, _ = drift.Spectra(freq, force, motion, 0 * force, slopes).moves(np.arange(20, 180))
    assert moved == pytest.approx(shift, abs=1e-8)


@pytest.mark.parametrize("offset", [0.0, 0.5, -3.0])
def test_the_zero_of_a_force_is_its_median(offset) -> None:
    force = pulses((1000, [1.0, 0.5]), (3000, [0.02]))
    assert not is_double(offset + force, FS)
    force[3000] = 0.04
    assert is_double(offset + force, FS)


@pytest.mark.parametrize(("first", "second"), [(True, True), (True, False), (False, True), (False, False)])
def test_hits_on_several_points_are_one_measurement(first, second, monkeypatch, tmp_path) -> None:
    """Rows in the order of the points struck; a coherence where all have one, and the fewest hits of one point."""
    freq = np.arange(5.0)

    def hit(path, reading):
        return files._Hit(100.0, np.arange(20.0), np.ones((2, 20)), ("a", "b"), path.name[0])

    def of_one(name, hits, reading):
        known = {"p": first, "q": second}[name]
        y = np.full((2, 5), len(hits) + 0j)
        return Responses(
            freq, y, (("a", name), ("b", name)), np.full((2, 5), 0.1 * len(hits)) if known else None,
            len(hits) if known else None, 2.0, {("m", name): y[0]}, kept=(len(hits), len(hits) + 1), remarks=(name,),
        )  # fmt: skip

    monkeypatch.setattr(files, "_hit", hit)
    monkeypatch.setattr(files, "_of_one_reference", of_one)
    paths = [Path(name) for name in ("p1", "q1", "p2", "p3", "q2")]
    whole = files._of_hits(paths, files.Reading("mobility"), {"p1": "hash"})
    assert whole.pairs == (("a", "p"), ("b", "p"), ("a", "q"), ("b", "q"))
    assert whole.mobility[:, 0].tolist() == [3, 3, 2, 2]
    both = first and second
    assert (whole.coherence is not None) == both
    if both:
        assert whole.coherence[:, 0] == pytest.approx([0.3, 0.3, 0.2, 0.2])
        assert whole.n_hits == 2
    assert (list(whole.pressure), whole.kept, whole.remarks) == ([("m", "p"), ("m", "q")], (5, 7), ("p", "q"))
    assert (whole.alpha, whole.files) == (2.0, {"p1": "hash"})
    with pytest.raises(TonewoodError, match="--form: the quantity measured is not stated"):
        files._of_hits(paths, files.Reading(), {})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"fs": 101.0}, "another rate, length or other channels"), ({"names": ("a", "c")}, "another rate"),
        ({"force": np.ones(21)}, "another rate"),
        ({"motion": np.array([np.ones(20), np.r_[np.ones(18), 0, 0]])}, "ends in zeros"),
    ],
)  # fmt: skip
def test_hits_that_do_not_belong_together_are_refused(changes, said, monkeypatch) -> None:
    usual = files._Hit(100.0, np.arange(20.0), np.ones((2, 20)), ("a", "b"), "p")
    hits = {"1": usual, "2": replace(usual, **changes)}
    monkeypatch.setattr(files, "_hit", lambda path, reading: hits[path.name])
    with pytest.raises(TonewoodError, match=f"2: (has|ends).*{said.removeprefix('ends ')}"):
        files._of_hits([Path("1"), Path("2")], files.Reading("mobility"), {})
