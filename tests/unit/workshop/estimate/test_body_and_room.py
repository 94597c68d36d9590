"""Body modes, share of a room, and edge of the finger that notes tell: each put in beforehand, and found again."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from estimate_sounds import GUITAR, recorded
from scipy.signal import fftconvolve

from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.contract.losses import StringData
from tonewood.sound.room import room_response
from tonewood.workshop.estimate.analysis import analyse
from tonewood.workshop.estimate.body_modes import FEWEST, body_modes, envelopes
from tonewood.workshop.estimate.distance import Distance
from tonewood.workshop.estimate.estimate import Half, estimate, loss_is_unknown, placed_notes
from tonewood.workshop.estimate.figures import Figures, forces_of, with_laws
from tonewood.workshop.estimate.laws import LinearLoss
from tonewood.workshop.estimate.partials import Bands
from tonewood.workshop.estimate.playing import Stage
from tonewood.workshop.estimate.pluck import edge_for, scaled_forces
from tonewood.workshop.estimate.recordings import FS, read_folder
from tonewood.workshop.estimate.room import room_share
from tonewood.workshop.estimate.search import Search

OPEN = (82.41, 110.0, 146.83, 196.0, 246.94, 329.63)


def note(rng, freq, modes, *, noise=1e-4, seconds=1.0):
    """Harmonics, damped modes (Hz, Q, level) below them with phases by chance, and noise, from 0.1 s on."""
    t = np.arange(round(seconds * FS)) / FS
    x = sum(np.exp(-8 * t) * np.sin(2 * np.pi * n * freq * t) / n for n in range(1, 12))
    for f, q, level in modes:
        size = level * rng.uniform(0.5, 1.5)
        x = x + size * np.exp(-np.pi * f / q * t) * np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi))
    x = np.concatenate([np.zeros(round(0.1 * FS)), x])
    return x + noise * rng.standard_normal(len(x))


def modes_told(sounds, freqs):
    onset = round(0.1 * FS)
    return body_modes([envelopes(Bands(x, onset), f) for x, f in zip(sounds, freqs, strict=True)], OPEN)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_modes_below_the_fundamentals_are_found_and_open_strings_are_not(seed) -> None:
    rng = np.random.default_rng(seed)
    freqs = 330.0 * 2 ** (np.arange(12) / 12)
    modes = [(103.0, 24.0, 0.02), (207.0, 13.0, 0.1), (2 * 110.0, 150.0, 0.05)]
    found = modes_told([note(rng, f, modes) for f in freqs], freqs)
    assert [mode.freq for mode in found] == pytest.approx([103.0, 207.0], rel=0.01)
    assert [mode.q for mode in found] == pytest.approx([24.0, 13.0], rel=0.2)
    for mode, (f, q, _) in zip(found, modes, strict=False):
        assert mode.freq_interval[0] * 0.995 < f < mode.freq_interval[1] * 1.005
        assert mode.q_interval[0] * 0.9 < q < mode.q_interval[1] * 1.1


def test_noise_has_no_modes_and_few_notes_tell_none() -> None:
    rng = np.random.default_rng(5)
    freqs = 330.0 * 2 ** (np.arange(12) / 12)
    assert modes_told([note(rng, f, [], noise=0.02) for f in freqs], freqs) == ()
    modes = [(207.0, 13.0, 0.1)]
    assert modes_told([note(rng, f, modes) for f in freqs[: FEWEST - 1]], freqs[: FEWEST - 1]) == ()
    low = [120.0] * 12
    assert modes_told([note(rng, f, modes) for f in low], low) == ()


@pytest.mark.slow
def test_the_mix_of_a_room_is_found_again() -> None:
    rng = np.random.default_rng(2)
    freqs = 196.0 * 2 ** (np.arange(8) / 12)
    dry = [note(rng, f, [], noise=1e-6) for f in freqs]
    rows = [(x, analyse(x, f, 1e-5)) for x, f in zip(dry, freqs, strict=True)]
    for room, mix in (("studio", -9.0), ("small", 0.0)):
        response = room_response(room, FS, 1, mix_db=mix)[:, 0]
        wet = [(fftconvolve(x, response)[: len(x)], a) for x, a in rows]
        share = room_share(wet, rows)
        assert share is not None
        assert share.known
        assert (share.room, share.mix_db) == (room, mix)
        assert share.wet < 0.1 < share.dry
    assert room_share(rows, rows) is None
    assert room_share(rows[:3], rows[:3]) is None


def test_edges_between_those_tried_and_ranges_of_forces() -> None:
    edges = np.geomspace(1e-4, 1e-3, 5)
    changes = 2.0 + 3.0 * np.log10(edges / 1e-4)
    assert edge_for(edges, changes, 3.5) == pytest.approx(1e-4 * 10**0.5, rel=0.01)
    assert edge_for(edges, changes, 99.0) == pytest.approx(1e-3)
    low, high = scaled_forces((0.2, 5.0), 2.0)
    assert low * high == pytest.approx(1.0)
    assert high / low == pytest.approx(25.0**2)


@pytest.mark.parametrize(("changes", "unknown"), [((), False), ((0.1, 0.2), True), ((0.1, -0.2), False)])
def test_loss_is_kept_where_held_back_notes_say_so(changes, unknown) -> None:
    none = np.nan
    halves = [
        Half((), (), *(Distance(none, none, decays, none, none, none, 1, 1) for decays in (1.5, 1.5 + by)), {}, {})
        for by in changes
    ]
    assert loss_is_unknown(halves) is unknown


@pytest.mark.slow
def test_a_search_that_keeps_loss_moves_stiffness_alone(tmp_path) -> None:
    changes = {"strings.A2.loss.eta_f": 4e-4, "strings.A2.bending_stiffness": 6e-5}
    recorded(tmp_path, changes, [("A2", 0), ("A2", 5)], seconds=1.0)
    stage = Stage(Instrument.load(GUITAR))
    notes, _ = placed_notes(read_folder(tmp_path), stage)
    analyses = [analyse(p.recording.samples, p.recording.freq, p.b, p.recording.freq_upper) for p in notes]
    search = Search(stage)
    start = search.render(search.start, notes)
    moved = search.fit(notes, analyses, start, 1)
    search.keeps_loss = True
    kept = search.fit(notes, analyses, start, 1)
    np.testing.assert_array_equal(kept.laws["A2"].values, search.start.laws["A2"].values)
    assert np.any(moved.laws["A2"].values != search.start.laws["A2"].values)
    assert kept.bending["A2"] == moved.bending["A2"] != search.start.bending["A2"]


@pytest.mark.slow
def test_a_body_mode_an_edge_and_a_range_of_forces_are_found_again(tmp_path) -> None:
    body, microphones = ({"near": f, "freq": 0.93 * f, "q": 1.7 * q} for f, q in ((216.428, 9.354), (212.19, 7.686)))
    changes = {
        "body.moved_modes": [body],
        "outputs.microphones.moved_modes": [microphones],
        "exciters.pluck.edge": 6e-4,
        "playing.velocity.low": 0.3,
        "playing.velocity.high": 3.0,
    }
    places = [("E4", stop) for stop in range(0, 13, 2)] + [("B3", 8), ("B3", 10), ("G3", 12)]
    recorded(tmp_path, changes, places, seconds=1.0, dynamics=(40, 110))
    found = estimate(read_folder(tmp_path), Instrument.load(GUITAR))
    for near, (by_freq, by_q) in found.figures.modes.items():
        true = (0.93, 1.7) if abs(near - 216.4) < 0.1 else (1.0, 1.0)
        assert by_freq == pytest.approx(true[0], rel=0.01)
        assert by_q == pytest.approx(true[1], rel=0.15)
    assert any(abs(near - 216.4) < 0.1 for near in found.figures.modes)
    assert found.figures.edge == pytest.approx(6e-4, rel=0.33)
    assert found.figures.forces is not None
    assert np.log(found.figures.forces[1] / found.figures.forces[0]) == pytest.approx(np.log(10.0), rel=0.1)
    assert [m.freq for m in found.body_modes if 150 < m.freq < 250] == pytest.approx([0.93 * 213.3], rel=0.02)


def test_strings_without_notes_follow_their_neighbours() -> None:
    """By ratios straight over the logarithm of pitch between them, and by the nearest one's beyond."""
    loss = Instrument.load("monochord").resonators["A2"].parameters.loss
    law = LinearLoss.of(loss, StringData(70.0, 1e-3, 1e-4))
    pitch = {"low": 40.0, "third": 44.0, "high": 52.0, "highest": 57.0}
    figures = Figures(dict.fromkeys(pitch, law), dict.fromkeys(pitch, 1e-4), None, {}, None)
    stage = SimpleNamespace(open_note=pitch.__getitem__)
    made = with_laws(figures, {"low": law.values, "high": 8 * law.values}, {"low": 1e-4, "high": 8e-4}, stage)  # type: ignore[arg-type]
    for name, ratio in (("low", 1.0), ("third", 2.0), ("high", 8.0), ("highest", 8.0)):
        np.testing.assert_allclose(made.laws[name].values, ratio * law.values, rtol=1e-12)
        assert made.bending[name] == made.laws[name].string.bending_stiffness == pytest.approx(ratio * 1e-4)
    assert made.estimated == {"low": True, "third": False, "high": True, "highest": False}


@pytest.mark.parametrize(
    ("parameter", "curve", "told"),
    [
        ("pluck.force", "exponential", (0.5, 5.0)),
        ("pluck.force", "linear", None),
        ("hammer.speed", "exponential", None),
    ],
)
def test_forces_are_told_where_the_velocity_is_one(parameter, curve, told) -> None:
    velocity = SimpleNamespace(parameter=parameter, curve=curve, low=0.5, high=5.0)
    assert forces_of(SimpleNamespace(spec=SimpleNamespace(playing=SimpleNamespace(velocity=velocity)))) == told  # type: ignore[arg-type]
