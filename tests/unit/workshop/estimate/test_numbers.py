"""Distances, gains, loss laws, combs and strokes against figures worked out by hand or with plain NumPy."""

from __future__ import annotations

import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from estimate_sounds import FS, analysed, partial, partials, recording
from scipy.stats import spearmanr

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.losses import StringData
from tonewood.sound.equalizer import response_db
from tonewood.workshop.estimate import analysis, body_modes, gain, laws, pluck, room
from tonewood.workshop.estimate.distance import bands_apart, distance, neighbours, strokes
from tonewood.workshop.estimate.partials import Bands, _followed, _fundamental, _inharmonicity, measure_partial
from tonewood.workshop.estimate.recordings import Recording, _mono, _number, clipped, read_folder
from tonewood.workshop.estimate.spectra import PARTS, THIRD_OCTAVES, bands_over_time, share

LOG = np.log(gain.KNOTS)


# distances


def test_bands_count_within_50_db_and_up_to_20_db() -> None:
    a, b = np.zeros((4, 21)), np.full((4, 21), 3.0)
    b[1, 2] = 9.0
    assert bands_apart(analysed(bands=a), analysed(bands=b)) == pytest.approx(6 / np.sqrt(84))
    assert bands_apart(analysed(bands=a), analysed(bands=b), slice(0, 1)) == 0
    b[1, 2] = 53.0  # 50 dB beside the others counts 20
    assert bands_apart(analysed(bands=a), analysed(bands=b)) == pytest.approx(20 / np.sqrt(84))
    a[1, 2] = -50.0  # no longer less than 50 dB below the loudest
    assert bands_apart(analysed(bands=a), analysed(bands=b)) == 0
    a[1, 2], b[1, 2] = -49.9, 3.0 - 49.9 + 8.0
    assert bands_apart(analysed(bands=a), analysed(bands=b)) == pytest.approx(8 / np.sqrt(84))
    a[1, 2], b[3] = 0.0, np.nan
    b[1, 2] = 9.0
    assert bands_apart(analysed(bands=a), analysed(bands=b)) == pytest.approx(6 / np.sqrt(63))
    assert np.isnan(bands_apart(analysed(bands=a), analysed(bands=b), slice(3, 4)))


def test_a_distance_is_the_median_over_notes_and_clear_partials() -> None:
    a = analysed(rise=0.010, partials=[partial(n, level=0.0, rate=2.0, early=4.0) for n in (1, 2, 3, 5)])
    b = analysed(
        rise=0.014,
        partials=[
            partial(1, level=1.0, rate=2.0, early=4.0),
            partial(2, level=1.0, rate=1.0, early=5.0),
            partial(3, level=4.0, rate=6.0, early=np.nan),
            partial(4, level=90.0, rate=9.0),
        ],
    )
    found = distance([(a, b)])
    assert found.as_dict() == {
        "third_octaves": 0.0,
        "onset": 0.0,
        "decays": pytest.approx(2.0),
        "early_decays": pytest.approx(np.sqrt(1.25)),
        "levels": pytest.approx(np.sqrt(3.0)),
        "rise": pytest.approx(4.0),
        "notes": 1,
        "partials": 3,
    }
    assert distance([(b, a)]) == found
    few = analysed(partials=[partial(1), partial(2, level=30.0)])
    assert np.isnan(distance([(few, a)]).levels)
    assert distance([(few, a)]).partials == 2
    assert distance([]).notes == 0
    assert np.isnan(distance([]).decays)
    assert distance([(a, b), (a, a), (a, analysed(rise=0.012, partials=[partial(1, rate=4.0)]))]).rise == 2.0


@pytest.mark.parametrize(("fell", "misfit", "clear"), [(6.1, -8.1, True), (6.0, -20.0, False), (30.0, -8.0, False)])
def test_a_partial_is_clear_beyond_both_limits(fell, misfit, clear) -> None:
    assert partial(1, fell=fell, misfit=misfit).clear is clear


def test_pairs_of_semitones_and_of_strokes() -> None:
    a, b, c, d, e = (analysed(rise=float(i)) for i in range(5))
    rows = [(60, a), (61, b), (60, c), (63, d), (60, e)]
    assert [(p.rise, q.rise) for p, q in neighbours(rows)] == [(0.0, 1.0)]
    assert [(p.rise, q.rise) for p, q in strokes(rows)] == [(0.0, 2.0), (2.0, 4.0)]


# gain


def test_differences_of_levels_and_bands() -> None:
    bands = np.full((4, 21), np.nan)
    bands[0, :3], bands[2, 7] = (-10.0, -60.0, -20.0), -15.0
    other = np.full((4, 21), 0.0)
    other[0, 0], other[0, 2], other[2, 7] = -12.0, -24.0, -77.0
    rec = analysed(bands=bands, partials=[partial(2, freq=200.0, level=-3.0), partial(3, freq=300.0)])
    syn = analysed(bands=other, partials=[partial(2, freq=201.0, level=-8.0), partial(4)])
    silent = analysed(bands=np.full((4, 21), -10.0))
    found = gain.differences([silent, rec], [analysed(bands=np.full((4, 21), -210.0)), syn])
    assert found.note.tolist() == [1, 1, 1, 1]
    # band 1 is 50 dB below the loudest; of 2, 4 and 62 dB the last counts 25 dB more than the median
    assert found.db.tolist() == [5.0, 2.0, 4.0, 29.0]
    assert found.freq == pytest.approx([200.0, *THIRD_OCTAVES[[0, 2, 7]]])
    assert found.weight.tolist() == [1.0, 0.7, 0.7, 0.35]
    drawn = gain.Differences(np.array([0, 2, 0]), np.arange(3.0), np.arange(3.0) + 10, np.ones(3)).drawn([2, 0, 2])
    assert (drawn.note.tolist(), drawn.freq.tolist(), drawn.db.tolist()) == (
        [0, 1, 1, 2],
        [1, 0, 2, 1],
        [11, 10, 12, 11],
    )


def test_a_gain_straight_over_the_logarithm_is_exact_and_an_outlier_counts_little() -> None:
    """Second differences vanish; each note has a level of its own; the interval of notes that agree is a point."""
    freq = np.tile(np.geomspace(80, 10000, 40), 3)
    note = np.repeat([0, 1, 4], 40)
    level = 3.0 * np.log(freq) + np.array([0.0, 20.0, 0, 0, -7.0])[note]
    wanted = 3.0 * (LOG - LOG.mean())
    rows = gain.Differences(note, freq, level, np.ones(120))
    assert gain.curve(rows) == pytest.approx(wanted, abs=1e-9)
    assert gain.curve_interval(rows, np.random.default_rng(1), 5) == pytest.approx(np.array([wanted] * 2), abs=1e-9)
    level[20] += 400.0
    assert np.abs(gain.curve(rows) - wanted).max() < 0.5
    assert gain.at(
        wanted, np.array([1.0, gain.KNOTS[3], np.sqrt(gain.KNOTS[3] * gain.KNOTS[4]), 5e4])
    ) == pytest.approx([wanted[0], wanted[3], (wanted[3] + wanted[4]) / 2, wanted[-1]])


def test_a_curve_is_the_least_squares_of_its_equations() -> None:
    """The same normal equations, written out, for differences within 4 dB, where Huber's weights are 1."""
    rng = np.random.default_rng(4)
    freq, note, level = rng.uniform(60, 12000, 200), rng.integers(0, 3, 200), rng.uniform(-1, 1, 200)
    weight = rng.uniform(0.2, 1.0, 200)
    x = np.clip(np.log(freq), LOG[0], LOG[-1])
    rows, right = np.zeros((200 + 14, 18)), np.zeros(214)
    step = LOG[1] - LOG[0]
    for i in range(200):
        rows[i, :15] = np.maximum(1 - np.abs(LOG - x[i]) / step, 0) * weight[i]
        rows[i, 15 + note[i]], right[i] = weight[i], level[i] * weight[i]
    for j in range(13):
        rows[200 + j, j : j + 3] = 3.0 * np.array([1.0, -2.0, 1.0])
    rows[213, :15] = 1.0
    found = gain.curve(gain.Differences(note, freq, level, weight))
    assert found == pytest.approx(np.linalg.lstsq(rows, right, rcond=None)[0][:15], abs=1e-9)
    assert gain.curve_interval(gain.Differences(note, freq, level, weight), np.random.default_rng(0), 9).shape == (
        2,
        15,
    )


def test_bands_of_a_curve_have_the_frequencies_of_its_knots() -> None:
    bands = gain.bands_of(np.zeros(15))
    assert [f for f, _, _ in bands] == pytest.approx([gain.KNOTS[1], *gain.KNOTS[1:-1], gain.KNOTS[-2]], abs=0.005)
    assert [q for _, _, q in bands] == [None, *[1.6] * 13, None]
    assert [g for _, g, _ in bands] == [0.0] * 15
    tilt = 2.0 * (LOG - LOG.mean())
    away = response_db(list(gain.bands_of(tilt)), gain.KNOTS) - tilt
    assert np.ptp(away) < 0.4


# loss laws


@cache
def strings_law(name="monochord", string="A2"):
    loss = Instrument.load(name).resonators[string].parameters.loss
    return laws.LinearLoss.of(loss, StringData(70.0, 1e-3, 1e-4))


def test_a_law_is_the_sum_of_its_columns() -> None:
    """sigma0 + sigma1 k^2, k of a stiff string; Woodhouse's (T (eta_f + eta_a / w) + EI k^2 eta_b) / (T + EI k^2)."""
    law, freq = strings_law(), np.array([300.0, 2000.0])
    omega = 2 * np.pi * freq
    k2 = np.array([np.roots([1e-4, 70.0, -1e-3 * w**2]).real.max() for w in omega])
    assert law.names == ("sigma0", "sigma1")
    assert law.columns(freq) == pytest.approx(np.column_stack([np.ones(2), k2]))
    assert law.rate(freq, np.array([2.0, 1e-3])) == pytest.approx(2.0 + 1e-3 * k2)
    assert law.rate(freq) == pytest.approx(law.values[0] + law.values[1] * k2)
    assert law.rest(freq) == pytest.approx(0.0, abs=1e-12)
    guitar = strings_law("classical_guitar", "D3")
    bend = 1e-4 * k2
    assert guitar.names == ("eta_f", "eta_b", "eta_a")
    wanted = omega[:, None] / 2 * np.column_stack([np.full(2, 70.0), bend, 70.0 / omega]) / (70.0 + bend)[:, None]
    assert guitar.columns(freq) == pytest.approx(wanted)
    limp = laws.LinearLoss.of(law.loss, StringData(70.0, 1e-3, 0.0))
    assert limp.columns(freq)[:, 1] == pytest.approx(omega**2 * 1e-3 / 70.0)


def test_numbers_to_begin_with_give_a_tenth_of_the_rate_where_there_is_none() -> None:
    law = strings_law()
    bare = laws.LinearLoss(law.loss, law.string, law.names, np.array([2.0, 0.0]))
    column = law.columns(np.array([1000.0]))[0, 1]
    assert law.starts == pytest.approx(law.values)
    assert bare.starts == pytest.approx([2.0, 0.1 * 2.0 / column])


def decays(law, values, bridge, f0=110.0, notes=2):
    freq = np.tile(f0 * np.arange(2, 40), notes)
    each = np.repeat(np.arange(notes), 38)
    return laws.DecayRates(freq, np.full(freq.size, f0), law.rate(freq, values) + bridge * f0, each)


def test_a_fit_finds_the_law_and_the_loss_at_the_bridge() -> None:
    law = strings_law()
    wanted = law.values * [1.5, 3.0]
    values, bridge = laws.fit_law(decays(law, wanted, 1.5e-3), law)
    total = law.rate(laws.STATED, values) + 110.0 * bridge
    assert total == pytest.approx(law.rate(laws.STATED, wanted) + 110.0 * 1.5e-3, rel=0.02)
    assert values[1] == pytest.approx(wanted[1], rel=0.02)


def test_a_law_moves_by_the_difference_of_recorded_and_rendered() -> None:
    """The same notes leave it; a bridge of both drops out; a rate grows to five times, falls to a fifth at once."""
    law = strings_law()
    same = decays(law, law.values, 1e-3)
    assert laws.moved(law, same, same) == pytest.approx(law.values, rel=1e-6)
    more = laws.moved(law, decays(law, 2 * law.values, 1e-3), same)
    assert law.rate(laws.STATED, more) == pytest.approx(2 * law.rate(laws.STATED), rel=0.05)
    grid = np.geomspace(150.0, 4290.0, 40)
    for factor, limit in ((40.0, 5.0), (0.01, 0.2)):
        found = laws.moved(law, decays(law, factor * law.values, 0.0), decays(law, law.values, 0.0))
        assert law.rate(grid, found) == pytest.approx(limit * law.rate(grid), rel=0.05)


def test_rates_are_those_of_clear_partials_above_150_hz() -> None:
    notes = [
        analysed(f0=75.0, partials=[partial(1, freq=75.0), partial(2, freq=150.0), partial(3, freq=225.0, rate=3.0)]),
        analysed(f0=500.0, partials=[partial(1, freq=500.0, rate=4.0), partial(2, freq=1000.0, fell=1.0)]),
    ]
    found = laws.rates_of(notes)
    assert (found.freq.tolist(), found.f0.tolist()) == ([225.0, 500.0], [75.0, 500.0])
    assert (found.rate.tolist(), found.note.tolist(), len(found)) == ([3.0, 4.0], [0, 1], 2)
    assert laws.rates_of(notes, 0.5).rate.tolist() == [1.5, 2.0]
    assert len(laws.rates_of([])) == 0
    assert found.taken(np.array([1, 1, 0])).rate.tolist() == [4.0, 4.0, 3.0]


def test_intervals_and_trades_of_a_bootstrap() -> None:
    law = strings_law()
    exact = laws.bootstrap(decays(law, law.values, 1e-3), law, np.random.default_rng(1), draws=6)
    assert exact.rates.shape == (2, 4)
    assert exact.rates[:, 2:] == pytest.approx(np.array([law.rate(laws.STATED[2:])] * 2), rel=0.1)
    assert exact.spread.max() < 1e-3
    assert (exact.values.shape, exact.bridge.shape, exact.trades.shape) == ((2, 2), (2,), (3, 3))
    assert np.all(exact.rates[0] <= exact.rates[1])
    square = np.array([[1.0, -0.5, -0.49], [-0.5, 1.0, -0.9], [-0.49, -0.9, 1.0]])
    interval = laws.Interval(np.array([[1.0] * 4, [4.0] * 4]), np.ones((2, 2)), np.ones(2), square)
    assert interval.spread.tolist() == [1.0] * 4
    assert laws.trades(law, interval) == [("sigma0", "sigma1", -0.5), ("sigma1", "bridge", -0.9)]
    assert laws.trades(law, interval, 0.6) == [("sigma1", "bridge", -0.9)]


def test_rank_correlations_are_spearmans() -> None:
    draws = np.random.default_rng(6).standard_normal((30, 3))
    draws[:, 1] += draws[:, 0]
    draws[3, 2] = draws[4, 2]
    assert laws._rank_correlations(draws) == pytest.approx(spearmanr(draws).statistic)
    draws[:, 2] = 1.0
    assert laws._rank_correlations(draws)[2].tolist() == [0.0] * 3


# pluck


def plucked(at, length, numbers=range(1, 25), beyond=40.0):
    """Levels of the comb of a pluck, on a slope; partials above 22 are misleading."""
    n = np.array(numbers)
    level = 10 * np.log10(np.sin(n * np.pi * at / length) ** 2 + 0.01) - 12 * np.log10(n)
    return analysed(
        partials=[
            partial(int(i), freq=200.0 * i, level=float(y) if i < 23 else beyond * (-1) ** i)
            for i, y in zip(n, level, strict=True)
        ]
    )


@pytest.mark.parametrize("at", [0.075, 0.1, 0.13])
def test_a_comb_tells_the_place_of_the_pluck(at) -> None:
    assert pluck.place_of(plucked(at, 0.65), 0.65, 0.26) == pytest.approx(at, abs=1.1e-3)
    assert pluck.place_of(plucked(at, 0.65), 0.65, 0.09) < 0.09
    assert pluck.place_of(plucked(at, 0.65), 0.65, 9.0) <= 0.325
    assert pluck.place_of(plucked(at, 0.65, range(1, 10)), 0.65, 0.26) == pytest.approx(at, abs=0.01)
    assert np.isnan(pluck.place_of(plucked(at, 0.65, range(1, 9)), 0.65, 0.26))


def test_places_move_by_the_median_of_differences() -> None:
    notes = [SimpleNamespace(length=0.65, recording=SimpleNamespace(place=p)) for p in (None, None, 0.1, None)]
    recorded = [plucked(at, 0.65) for at in (0.12, 0.13, 0.07, 0.125)]
    rendered = [plucked(at, 0.65) for at in (0.10, 0.105, 0.2, 0.11)]
    told = [[pluck.place_of(row, 0.65, 0.26) for row in rows] for rows in (recorded, rendered)]
    a, b = np.delete(np.array(told), 2, axis=1)
    found = pluck.places(notes, recorded, rendered, 0.26)
    assert found is not None
    assert found.moved == pytest.approx(np.median(a - b))
    assert (found.rendered, found.notes) == (np.median(b), 3)
    assert found.scatter == pytest.approx(1.4826 * np.median(np.abs(a - np.median(a))))
    assert pluck.places(notes[:3], recorded[:3], rendered[:3], 0.26) is None


def test_louder_strokes_are_compared_note_by_note() -> None:
    notes, rows = [], []
    for string, strokes_ in (
        ("A", [(40, -20.0, -30.0), (100, -8.0, -24.0), (60, 0.0, 0.0)]),
        ("B", [(120, -6.0, -20.0), (40, -20.0, -25.0)]),
        ("C", [(40, -21.0, -30.0), (90, -11.0, -27.0)]),
        ("D", [(80, -5.0, -9.0), (80, -1.0, -1.0)]),
    ):
        for dynamic, peak, bright in strokes_:
            notes.append(SimpleNamespace(string=string, stop=0.0, recording=SimpleNamespace(dynamic=dynamic)))
            rows.append(analysed(peak=peak, bright=bright))
    found = pluck.louder(notes, rows)
    assert found == pluck.Louder(12.0, 5.0, 60.0, 3)
    assert found.per_7_db == pytest.approx(35 / 12)
    assert np.isnan(pluck.Louder(1.0, 5.0, 60.0, 3).per_7_db)
    assert pluck.louder(notes[:5], rows[:5]) is None
    even = pluck.louder(notes, [analysed(peak=-1.0, bright=row.bright) for row in rows])
    assert even is not None
    assert np.isnan(even.peak)
    picked = [(p.string, p.recording.dynamic) for p in pluck.pairs(notes)]
    assert picked == [("A", 40), ("A", 100), ("B", 40), ("B", 120), ("C", 40), ("C", 90)]
    silent = SimpleNamespace(string="A", stop=0.0, recording=SimpleNamespace(dynamic=None))
    assert pluck.pairs([silent, *notes[3:5]]) == (notes[4], notes[3])


# body modes and room


def test_poles_of_open_strings_and_of_the_pluck_are_no_modes() -> None:
    poles = np.array(
        [(220.0, 41.0), (220.0, 39.0), (222.0, 41.0), (110.9, 90.0), (111.1, 90.0), (50.0, 3.1), (50.0, 3.0)]
    )
    assert body_modes._kept(poles, [110.0]).tolist() == poles[[1, 2, 4, 5]].tolist()
    near = body_modes._alike(
        np.array([(0, 100.0, 10.0), (1, 102.9, 19.9), (2, 103.1, 10.0), (3, 100.0, 20.1)]), np.array([0, 100.0, 10.0])
    )
    assert near.tolist() == [True, True, False, False]
    assert body_modes._interval(np.arange(101.0)) == pytest.approx((5.0, 95.0))


def test_envelopes_below_high_fundamentals_have_rms_1() -> None:
    x = np.random.default_rng(1).standard_normal(FS)
    bands = Bands(x, 4410)
    for f0, present in (
        (312.4, (False, False)),
        (312.6, (True, False)),
        (437.6, (True, True)),
        (np.nan, (False, False)),
    ):
        rows = body_modes.envelopes(bands, f0)
        assert tuple(y is not None for y in rows) == present
        assert [np.mean(np.abs(y) ** 2) for y in rows if y is not None] == pytest.approx([1.0] * sum(present))
    assert body_modes.envelopes(Bands(x[: 4410 + 11000], 4410), 500.0) == (None, None)
    assert body_modes.envelopes(Bands(np.zeros(FS), 4410), 500.0) == (None, None)


def test_levels_between_partials() -> None:
    """Partials that stand still at 1, others half-way at 0.1: 20 dB."""
    t = np.arange(FS) / FS - 0.1
    at = 200.0 * np.arange(1, 26)
    tones = sum(np.cos(2 * np.pi * f * t) + 0.1 * np.cos(2 * np.pi * (f + 100.0) * t) for f in at)
    note = analysed(onset=0.1, f0=200.0, b=0.0)
    pair = room.between(tones, note)
    assert pair is not None
    assert [part.shape for part in pair] == [(12, 45), (12, 6)]
    assert room._level(*pair) == pytest.approx(-20.0, abs=0.1)
    assert room._level(np.full((2, 3), 2.0 + 0j), np.full((5, 3), 1.0 + 0j)) == pytest.approx([20 * np.log10(2)] * 3)
    assert room.between(tones, analysed(onset=0.1, f0=99.0, b=0.0)) is None
    assert room.between(tones, analysed(onset=0.1, f0=200.0, b=np.nan)) is None
    assert room.between(tones[: int(0.6 * FS)], note) is None
    assert [room.RoomShare("small", 0.0, (-4.0, high), 1.0, 0.5, 6).known for high in (5.0, 5.1)] == [True, False]
    assert room.room_share([(tones, note)] * 4, [(tones, note)] * 4) is None


# analysis


def test_figures_of_a_note_of_closed_form() -> None:
    """Two partials in proportion: level, peak and share of each band follow from the amplitudes."""
    t = np.arange(FS) / FS
    tone = 0.3 * np.sin(2 * np.pi * 440 * t) + 0.1 * np.sin(2 * np.pi * 4400 * t)
    x = np.concatenate([np.zeros(4410), tone * np.minimum(t / 0.002, 1.0)])
    found = analysis.analyse(x, 440.0, 1e-5)
    assert found.onset == pytest.approx(0.1, abs=0.002)
    assert found.peak == pytest.approx(20 * np.log10(np.abs(tone).max()), abs=0.02)
    assert found.level == pytest.approx(10 * np.log10(0.05), abs=0.05)
    assert found.bright == pytest.approx(-10.0, abs=0.1)
    assert 0.0005 < found.rise < 0.004
    assert share(tone, 3000.0, 8000.0) == pytest.approx(-10.0, abs=0.05)
    assert share(tone, 300.0, 4400.0 - 40) == pytest.approx(10 * np.log10(0.9), abs=0.05)
    assert found.bands == pytest.approx(bands_over_time(x, round(found.onset * FS)), nan_ok=True)
    assert np.isfinite(found.bands[3]).all()


def test_bands_over_time_are_those_of_each_part() -> None:
    """1 kHz of amplitude 1, 0.1, 1, 0.01 in the parts: power over samples; a part of 60 % or less has none."""
    t = np.arange(2 * FS) / FS
    x = np.sin(2 * np.pi * 1000 * t)
    for (start, stop), size in zip(PARTS, (1.0, 0.1, 1.0, 0.01), strict=True):
        x[1000 + int(start * FS) : 1000 + int(stop * FS)] *= size
    bands = bands_over_time(x, 1000)
    assert np.diff(bands[1:, 10]) == pytest.approx([20 + 20 * np.log10(2) / 2 * 2 - 0.5, -40], abs=2.0)
    cut = 1000 + int(0.6 * FS)
    assert np.isnan(bands_over_time(x[: cut + int(0.35 * FS)], 1000)[3]).all()
    assert np.isfinite(bands_over_time(x[: cut + int(0.37 * FS)], 1000)).all()


@pytest.mark.parametrize("cents", [-1200, -300, -35, 0, 50, 400])
def test_the_pitch_is_told_within_12_cents(cents) -> None:
    x, _ = partials(220.0 * 2 ** (cents / 1200), 0.0, np.full(20, 3.0))
    assert analysis.pitch_offset(x, 4410, 220.0) == pytest.approx(cents, abs=12)
    note = Recording("a.wav", 57, x)
    reason = analysis.check_pitch(note)
    assert (reason is None) == (abs(cents) <= 60)
    if reason:
        number, way = re.fullmatch(r"a.wav: sounds (\d+) cents (above|below) the note of its name", reason).groups()
        assert int(number) * (1 if way == "above" else -1) == analysis.pitch_offset(
            x, analysis.find_onset(x, 220.0)[0], 220.0
        )


def test_too_short_or_noise_alone_is_told() -> None:
    x, _ = partials(220.0, 1e-4, np.full(20, 3.0))
    start = analysis.find_onset(x, 220.0)[0]
    least = start + int(0.35 * FS)
    assert analysis.check_pitch(Recording("a.wav", 57, x[: least - 100])) == (
        "a.wav: ends 0.35 s after its onset; 0.35 s or more are wanted"
    )
    assert analysis.check_pitch(Recording("a.wav", 57, x[: least + 1000])) is None
    noise = np.random.default_rng(2).standard_normal(FS)
    assert np.isnan(analysis.pitch_offset(noise, 100, 220.0))


def test_beats_are_the_modulation_of_their_band() -> None:
    """One partial per band with a beat of known depth: rms of its level in dB about a parabola, floors left out."""
    t = np.arange(FS) / FS - 0.1
    depth = {1000.0: 0.3, 2000.0: 0.1, 4000.0: 0.0}
    x = sum((1 + m * np.cos(2 * np.pi * 10 * t)) * np.cos(2 * np.pi * f * t) for f, m in depth.items()) * (t >= 0)
    rows = [partial(int(f / 200), freq=f) for f in depth]
    found = analysis._modulation(Bands(x, 4410), rows, 200.0)
    grid = np.arange(0.06, 0.46, 1e-3)
    for value, m in zip(found, depth.values(), strict=True):
        level = 20 * np.log10(1 + m * np.cos(2 * np.pi * 10 * grid))
        wanted = np.std(level - np.polyval(np.polyfit(grid, level, 2), grid))
        assert value == pytest.approx(wanted, rel=0.05, abs=0.06)
    assert np.isnan(analysis._modulation(Bands(x, 4410), rows[:1], 200.0)[1:]).all()
    assert np.isnan(analysis._modulation(Bands(x[: int(0.6 * FS)], 4410), rows, 200.0)).all()


def test_floor_and_tail_are_levels_re_half_way() -> None:
    """Partials of 1 and tones half-way of 0.1: 20 dB between peaks and floors; the tail has the level of the latter."""
    t = np.arange(FS) / FS - 0.1
    at = 250.0 * np.arange(1, 36)
    x = sum(np.cos(2 * np.pi * f * t + f) + 0.1 * np.cos(2 * np.pi * (f + 125.0) * t) for f in at)
    tail = analysis._tail(Bands(x, 4410), 250.0, 0.0)
    assert tail[:, 0] == pytest.approx(0.03 + 0.01 * np.arange(67))
    assert tail[:, 1] == pytest.approx(-20.0, abs=0.3)
    assert analysis._tail(Bands(x, 4410), 250.0, np.nan).shape == (0, 2)
    assert analysis._tail(Bands(x[: int(0.75 * FS)], 4410), 250.0, 0.0).shape == (0, 2)
    floors = analysis._floor(x, 4410, 250.0, 0.0)
    louder = analysis._floor(x + 9 * sum(np.cos(2 * np.pi * f * t + f) for f in at), 4410, 250.0, 0.0)
    assert np.subtract(louder, floors) == pytest.approx([20.0] * 3, abs=2.0)
    assert np.isnan(analysis._floor(x[: 4410 + 500], 4410, 250.0, 0.0)).all()


# partials


def test_the_fundamental_is_the_median_of_loud_multiples() -> None:
    level = np.full(10000, -90.0)
    for n, off in ((1, 0), (2, 2), (3, 3), (4, -40), (5, 15), (6, 12)):
        level[100 * n + off] = -10.0 if n != 5 else -46.0
    # 4 lies beyond 60 cents, 5 is 36 dB down
    assert _fundamental(level, 1.0, 100.0) == pytest.approx(np.median([100.0, 101.0, 101.0, 102.0]))


def test_stiffness_is_the_slope_of_squares() -> None:
    n = np.arange(1, 21.0)
    f = n * 200.0 * np.sqrt(1 + 3e-4 * n**2)
    rows = np.column_stack([n, f, np.zeros(20), np.full(20, 40.0)])
    assert _inharmonicity(rows, 1.0, 0.0, 1e-4) == pytest.approx((200.0, 3e-4))
    assert _inharmonicity(rows, 1.0, 0.0, 1e-5)[1] == pytest.approx(2e-4)  # 20 times the guess at most
    rows[6, 1] *= 1.03
    assert _inharmonicity(rows, 1.0, 0.0, 1e-4) == pytest.approx((200.0, 3e-4))
    rows[:, 1] = n * 200.0 * np.sqrt(1 - 1e-4 * n**2)
    assert _inharmonicity(rows, 1.0, 0.0, 1e-4)[1] == 0.0
    assert _inharmonicity(rows[:2], 150.0, 1e-4, 1e-4) == pytest.approx((150.0, 1e-4))


def test_partials_are_followed_up_to_the_end_of_the_band() -> None:
    level = np.full(20000, -80.0)
    n = np.arange(1, 21)
    at = np.round(n * 200.0 * np.sqrt(1 + 1e-4 * n**2)).astype(int)
    level[at] = -20.0
    found = _followed(level, 1.0, 200.0, 1e-4, 3000.0)
    assert found is not None
    score, f0, b, rows = found
    assert rows[:, 0].tolist() == [i for i, f in zip(n, at, strict=True) if f <= 2800]
    assert rows[:, 1].tolist() == at[: len(rows)].tolist()
    assert (rows[:, 2] == -20).all()
    assert (rows[:, 3] == 60).all()
    assert (f0, b) == pytest.approx((200.0, 1e-4), rel=0.03)
    assert score == 40 * len(rows)
    level[at[2:]] = -67.0  # 13 dB over the noise
    assert _followed(level, 1.0, 200.0, 1e-4, 3000.0) is None
    level[at[2]] = -65.0
    assert _followed(level, 1.0, 200.0, 1e-4, 3000.0) is not None


def test_rates_of_envelopes() -> None:
    step = FS / (1 << 18)
    assert Bands.rate(30.0) == pytest.approx(512 * step)
    y, t = Bands(np.zeros(FS), 0).envelope(500.0, 30.0)
    assert (len(y), t[0], t[1] - t[0]) == pytest.approx((512, -0.1, 1 / (512 * step)))
    assert [Bands(np.zeros(n), 4410).end for n in (4410 + FS, 5 * FS)] == pytest.approx([1.0, 3.1], abs=1e-4)
    assert Bands(np.zeros(FS), 441).end == pytest.approx(0.99)


# recordings


def test_a_file_is_resampled_centred_and_put_in_order(tmp_path) -> None:
    t = np.arange(48000) / 48000
    recording(tmp_path / "A3_ff.wav", 0.1 + 0.2 * np.sin(2 * np.pi * 1000 * t), 48000)
    recording(tmp_path / "A3_pp.wav", 0.2 * np.sin(2 * np.pi * 1000 * np.arange(22050) / 22050), 22050)
    recording(tmp_path / "C2.wav", np.column_stack([0.4 * np.sin(6280 * t), 0 * t]), 48000)
    recording(tmp_path / "64.wav", 0.2 * np.sin(6280 * t[:16900]), 48000)
    recording(tmp_path / "65.wav", 0.2 * np.sin(6280 * t[:16700]), 48000)
    folder = read_folder(tmp_path, transpose=-12)
    assert [(r.file, r.note, r.dynamic, r.freq_upper) for r in folder.recordings] == [
        ("C2.wav", 24, None, 22050.0),
        ("A3_pp.wav", 45, 33.0, 11025.0),
        ("A3_ff.wav", 45, 112.0, 22050.0),
        ("64.wav", 52, None, 22050.0),
    ]
    assert folder.warnings == ("left out: 65.wav: lasts 0.35 s; 0.35 s or more are wanted",)
    mono, soft, loud, _ = (r.samples for r in folder.recordings)
    assert [len(x) for x in (mono, soft, loud)] == [44100] * 3
    assert abs(loud.mean()) < 1e-9
    inside = slice(5000, 39000)
    assert np.std(loud[inside]) == pytest.approx(0.2 / np.sqrt(2), rel=0.01)
    assert np.std(mono[inside]) == pytest.approx(0.2 / np.sqrt(2), rel=0.01)
    assert folder.recordings[1].freq == pytest.approx(110.0)
    assert folder.notes == (24, 45, 52)


def test_channels_that_cancel_are_taken_alone() -> None:
    x = np.sin(np.arange(2000) * 0.1)
    kept, lines = _mono(np.column_stack([x, -1.2 * x]), "a.wav")
    assert kept.tolist() == (-1.2 * x).tolist()
    assert lines == ["a.wav: its channels cancel each other; channel 2 is taken alone"]
    kept, lines = _mono(np.column_stack([x, 0.2 * x]), "a.wav")
    assert kept == pytest.approx(0.6 * x)
    assert lines == []
    kept, lines = _mono(np.column_stack([x, *[0 * x] * 3]), "a.wav")  # one channel of four: none that cancels it
    assert (kept == pytest.approx(x / 4), lines) == (True, [])


def test_runs_at_the_largest_and_smallest_value_are_clipping() -> None:
    x = np.sin(np.arange(400) * 0.5)
    x[100:103] = 1.5
    assert clipped(x) == 0
    x[103] = 1.5
    assert clipped(x) == 4
    x[200:206] = -2.0
    assert clipped(x) == 6
    assert clipped(np.abs(x) + 0.1) >= 6
    assert clipped(-np.ones(10)) == 10


@pytest.mark.parametrize(
    ("text", "value"), [("", None), ("0.001", 0.001), ("5", 5.0), ("5.1", ""), ("nan", ""), ("x", "")]
)
def test_numbers_of_a_table_lie_within_limits(tmp_path, text, value) -> None:
    if value == "":
        with pytest.raises(Exception, match=r"0\.001 to 5 is allowed"):
            _number({"place": text}, "place", 1e-3, 5.0, tmp_path / "t.csv", 3)
    else:
        assert _number({"place": text}, "place", 1e-3, 5.0, tmp_path / "t.csv", 3) == value


def test_partials_of_a_low_note_are_apart_from_their_neighbours() -> None:
    """At 55 Hz the band of a partial ends before its neighbours, and so do those half-way between them."""
    t = np.arange(2 * FS) / FS - 0.1
    x = sum(np.exp(-2 * np.maximum(t, 0)) * np.cos(2 * np.pi * 55.0 * n * t) for n in range(1, 12)) * (t >= 0)
    x = x + 1e-4 * np.random.default_rng(1).standard_normal(len(x))
    found = measure_partial(Bands(x, 4410), 5, 275.0, 55.0)
    assert found.noise < -50
    assert found.level == pytest.approx(-20 * 2 * 0.06 / np.log(10), abs=0.5)
    assert (found.rate, found.early) == pytest.approx((2.0, 2.0), rel=0.02)
    assert (found.number, found.freq) == (5, 275.0)
    assert found.fell > 20
    assert found.misfit < -20
    assert measure_partial(Bands(x[: 4410 + 3000], 4410), 5, 275.0, 55.0) is None
    assert measure_partial(Bands(1e-4 * np.random.default_rng(2).standard_normal(FS), 4410), 5, 275.0, 55.0) is None
