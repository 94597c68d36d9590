"""Strings of a model: stops, bends, damping and angles."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import tonewood as tw
from tonewood.instrument.bundle.loading import Instrument
from tonewood.instrument.model import string_tuning
from tonewood.instrument.model.assembly import assemble
from tonewood.instrument.model.stop_table import StopTable
from tonewood.instrument.model.string_setup import Stopping
from tonewood.instrument.model.strings import StringModel
from tonewood.instrument.model.untuned_bases import held_freq

Make = Callable[..., Instrument]


@pytest.fixture
def string(make: Make) -> StringModel:
    return assemble(make(), 16000.0).strings["A2"]


def test_stops_lie_where_the_scale_puts_them(string: StringModel) -> None:
    assert string.length(12) == pytest.approx(0.325)
    assert string.length(7) == pytest.approx(0.65 * 2 ** (-7 / 12))
    assert string.tuning.freqs[12] == pytest.approx(220.0)
    assert len(string.tuning.freqs) == 13
    for stop in (-1, 13, 0.5):
        with pytest.raises(ValueError, match="stops from 0 to 12"):
            string.tuning.stops.position(stop)


def test_any_place_on_a_continuous_string(make: Make) -> None:
    string = assemble(make().replace({"stops.kind": "continuous"}), 16000.0).strings["A2"]
    assert string.freq(0.5) == pytest.approx(110.0 * 2 ** (0.5 / 12))
    assert string.length(0.5) == pytest.approx(0.65 * 2 ** (-0.5 / 12))


def test_polarizations_share_shapes_and_differ_by_the_split(string: StringModel) -> None:
    z, y = (string.bases(3)[c] for c in ("A2.z", "A2.y"))
    np.testing.assert_array_equal(z.right, y.right)
    cents = 1200 * math.log2((held_freq(y) or 0) / (held_freq(z) or 1))
    assert cents == pytest.approx(4.0, abs=0.01)


@pytest.mark.parametrize("bend", [-100.0, 37.0, 200.0])
def test_bends_are_in_tune(string: StringModel, bend: float) -> None:
    straight, bent = string.bases(5)["A2.z"], string.bases(5, bend_cents=bend)["A2.z"]
    got = 1200 * math.log2((held_freq(bent) or 0) / (held_freq(straight) or 1))
    assert got == pytest.approx(bend, abs=0.05)
    np.testing.assert_array_equal(straight.shape(0.2), bent.shape(0.2))  # type: ignore[misc]  # made with a shape


def test_modes_bent_past_the_limit_leave_their_compliance(make: Make) -> None:
    string = assemble(make().replace({"strings.*.freq_upper": 7200}), 16000.0).strings["D3"]
    straight, bent = string.bases()["D3.z"], string.bases(bend_cents=200)["D3.z"]
    assert bent.n_modes < straight.n_modes
    assert bent.natural_freq.max() < 0.45 * 16000
    back, _ = string.transfer("D3.z", bent, straight)
    assert back.shape == (straight.n_modes, bent.n_modes)
    np.testing.assert_allclose(back[: bent.n_modes], np.eye(bent.n_modes), atol=1e-9)


def test_added_damping(string: StringModel) -> None:
    plain, damped = string.bases(2)["A2.y"], string.bases(2, added_damping=57.6)["A2.y"]
    np.testing.assert_allclose(damped.damping_rate, plain.damping_rate + 57.6)
    np.testing.assert_allclose(damped.stiffness, plain.stiffness)
    assert damped.places == plain.places


def test_plucked_where_asked(string: StringModel) -> None:
    basis = string.bases(0, pluck_from_bridge=0.3)["A2.z"]
    np.testing.assert_allclose(basis.right[basis.index("pluck")].real, basis.shape(0.3))  # type: ignore[misc]  # made with a shape
    with pytest.raises(ValueError, match=r"0\.5 m is not on it"):
        string.bases(12, pluck_from_bridge=0.5)


def test_weights_are_the_components_of_a_unit_force(string: StringModel) -> None:
    for angle in (0.0, 12.0, 30.0, 90.0):
        w = string.weights(angle)
        force = np.array([0.0, math.sin(math.radians(angle)), math.cos(math.radians(angle))])
        for p in string.polarizations:
            assert w[p.component] == pytest.approx(force @ p.direction)
    assert string.weights(12.0) == pytest.approx({"A2.z": 1.0, "A2.y": 0.0})


def test_seat_compliance_is_at_the_bridge(make: Make) -> None:
    string = assemble(make().replace({"strings.*.end_compliance": 3e-8}), 16000.0).strings["D3"]
    basis = string.bases(4)["D3.z"]
    residual = basis.residual[basis.index("bridge")]
    assert residual[basis.index("bridge")] == pytest.approx(3e-8)
    assert residual[basis.index("pluck")] == pytest.approx(0.0, abs=1e-15)


def test_whole_stops_are_tuned_before_the_first_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """While the engine steps, the tensions of a score's stops come from the table."""
    guitar = tw.load_instrument("classical_guitar")
    notes = [tw.Note(0.02 * i, 0.05, string="E2", stop=i, force=1.0) for i in range(1, 5)]
    stream = tw.Renderer(tw.Score(notes), guitar, 24000, max_duration=0.15)

    def late(*args: object) -> None:
        raise AssertionError("a string is tuned while it sounds")

    monkeypatch.setattr(string_tuning, "tune", late)
    assert sum(len(block) for block in stream.blocks(1024)) == 3600
    with pytest.raises(AssertionError, match="tuned while it sounds"):
        stream.model.strings["E2"].tension(9)


def test_a_scale_is_asked_once_for_each_whole_stop() -> None:
    """Geometry comes from a table: how often lengths and places are wanted does not matter."""
    asked: list[float] = []

    def freq(stop: float) -> float:
        asked.append(stop)
        return 110.0 * 2 ** (stop / 12)

    stops = StopTable("A2", 0.65, Stopping(12, True, freq, "each_stop"))
    for _ in range(3):
        assert stops.lengths[12] == pytest.approx(0.325, rel=1e-12)
        assert [0.65 - stops.position(i) for i in range(13)] == list(stops.lengths)
    assert sorted(asked) == list(range(13))
    assert stops.length(6.5) == pytest.approx(0.65 * 2 ** (-6.5 / 12), rel=1e-12)
    for beyond in (-1, 12.5, 13):
        with pytest.raises(ValueError, match="string A2 has stops from 0 to 12"):
            stops.position(beyond)
