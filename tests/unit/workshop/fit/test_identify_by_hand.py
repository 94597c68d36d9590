"""Decisions of an identification and of what tables and arrays mean, each at its limit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tonewood.workshop.fit import arrays, identify, search, texts
from tonewood.workshop.fit.projection import FitData, Poles, Projection, Shape
from tonewood.workshop.fit.search import NothingFoundError

FREQ = np.arange(100.0, 196.0)
SHAPE = Shape((0,), 2)


def flat(sigma=0.02, size=1.0, rows=2):
    y = np.full((rows, FREQ.size), size + 0j)
    return FitData(FREQ, y, np.full(y.shape, sigma))


# the order


class Order:
    """What an order search asks for: modes, the misfit of the model on the noise, and its cost."""

    def __init__(self, monkeypatch, *, modes=(1,), loud=(1.0,), costs=(1.0,), lines=()):
        self.allowed, self.modes, self.loud, self.costs = [], list(modes), list(loud), list(costs)
        self.lines, self.data = list(lines), []
        monkeypatch.setattr(identify, "sought", self.sought)
        monkeypatch.setattr(identify, "mains", lambda problem, poles: np.array(self.take("lines", []), dtype=int))
        monkeypatch.setattr(identify, "descend", lambda problem, poles, most, enough: (poles, None))
        monkeypatch.setattr(identify, "_parts_above_noise", lambda *_: self.take("loud"))
        monkeypatch.setattr(identify, "Projection", lambda data, shape: self.problem(self.costs[0], data))

    def take(self, name, default=None):
        values = getattr(self, name)
        return values.pop(0) if len(values) > 1 else values[0] if values else default

    def problem(self, cost, data):
        return SimpleNamespace(size=4 * FREQ.size, solve=lambda poles: SimpleNamespace(cost=cost * 4 * FREQ.size))

    def sought(self, data, shape, start, note):
        n = self.take("modes")
        self.data.append(data)
        self.allowed.append(round(float(np.sqrt(max(data.sigma[0, 0] ** 2 - 0.02**2, 0.0))), 6))
        if not n:
            raise NothingFoundError("none")
        return self.problem(self.take("costs"), data), Poles.at(100.0 + 7.3 * np.arange(n), np.full(n, 30.0))

    def found(self, data=None, least=0.0):
        return identify._ordered(data or flat(), SHAPE, least, print)


@pytest.mark.parametrize(
    ("least", "allowed"), [(0.0, [0.3, 0.1, 0.03, 0.01, 0.0]), (0.05, [0.3, 0.1]), (0.1, [0.3, 0.1])]
)
def test_errors_are_allowed_down_to_three_tenths_of_the_noise(least, allowed, monkeypatch) -> None:
    """Noise of 0.02 of the response: 0.003 tells nothing more, 0 does; not below the least error that is asked for."""
    order = Order(monkeypatch, loud=(0.9, 0.8, 0.7, 0.6, 0.5))
    best = order.found(least=least)
    assert order.allowed == pytest.approx(allowed)
    assert best.allowed == 0.0
    assert best.data.sigma == pytest.approx(0.02)


def test_without_an_error_that_is_allowed_noise_has_to_be_known_to_three_thousandths(monkeypatch) -> None:
    order = Order(monkeypatch, loud=(0.9, 0.8, 0.7, 0.6, 0.5))
    order.found(flat(0.0029))
    assert [round(float(np.sqrt(d.sigma[0, 0] ** 2 - 0.0029**2)), 6) for d in order.data] == [
        0.3, 0.1, 0.03, 0.01, 0.003,
    ]  # fmt: skip
    order = Order(monkeypatch, loud=(0.9, 0.8, 0.7, 0.6, 0.5, 0.4))
    order.found(flat(0.0031))
    assert len(order.data) == 6
    order = Order(monkeypatch, loud=(0.9, 0.8))
    order.found(flat(1.1))  # 0.3 of it is more than 0.3: only the noise is left
    assert len(order.data) == 1


@pytest.mark.parametrize(
    ("loud", "costs", "modes", "n", "rounds", "allowed"),
    [
        ((0.9, 0.0), (1.0,), (1, 2), 2, 2, 0.0),  # the misfit is noise: it ends
        ((1.0, 1.0), (1.0,), (1, 2), 1, 2, 0.3),  # more modes bring it no nearer
        ((1.0, 1.0, 0.0), (9.0, 4.4, 1.0), (1, 2, 3), 3, 3, 0.0),  # they halve its cost
        ((1.0, 1.0), (9.0, 4.6), (1, 2), 1, 2, 0.3),
        ((0.5, 0.5), (9.0, 1.0), (1, 2), 1, 2, 0.0),
        ((0.5, 0.4, 0.0), (1.0,), (1, 2, 3), 3, 3, 0.0),
        ((0.5, 0.6, 0.0), (1.0,), (2, 2, 3), 3, 3, 0.0),  # no more modes: it goes on
        ((1.0, 0.5, 0.5), (10.1, 10.1), (1, 2), 1, 2, 0.3),  # ten times the error that was allowed is not reached
        ((1.0, 0.5, 0.5), (9.0, 9.9, 1.0), (1, 2, 3), 2, 3, 0.0),
    ],
)
def test_an_order_is_raised_while_that_brings_the_model_nearer(
    loud, costs, modes, n, rounds, allowed, monkeypatch
) -> None:
    order = Order(monkeypatch, loud=loud, costs=costs, modes=modes)
    best = order.found()
    assert (len(best.poles), len(order.allowed), best.allowed) == (n, rounds, allowed)


def test_lines_of_the_mains_are_muted_once_and_their_modes_left_out(monkeypatch) -> None:
    """Two lines, then none, then a third; and one whose bins are muted already."""
    order = Order(monkeypatch, modes=(3, 3, 3), lines=([0, 2], [], [1], []), loud=(0.5, 0.0))
    best = order.found()
    assert best.lines == pytest.approx((100.0, 114.6, 107.3))
    # the first search was made again without their bins; a second error allowed found another line, and then none
    assert [bool((d.sigma > 100).any()) for d in order.data] == [False, True, True, True]
    order = Order(monkeypatch, modes=(3,), lines=([0], [0], []), loud=(0.0,))
    best = order.found()
    assert best.lines == pytest.approx((100.0,))
    assert len(order.data) == 2
    assert best.poles.freq == pytest.approx([107.3, 114.6])
    with pytest.raises(NothingFoundError):
        Order(monkeypatch, modes=(0,)).found()


@pytest.mark.parametrize(("ratio", "share"), [(0.93, 0.0), (0.94, 1.0)])
def test_a_part_of_the_band_is_above_its_noise_by_a_quarter(ratio, share, monkeypatch) -> None:
    """ln 1.25 above -gamma / 2, the mean of ln |e| / sigma of complex Gaussian noise; parts of 24 bins."""
    misfit = 0.02 * ratio * np.exp(1j * np.arange(2 * FREQ.size)).reshape(2, -1)
    monkeypatch.setattr(Projection, "misfit", lambda self, poles, residues: misfit)
    poles = Poles.at([150.0], [30.0])
    assert identify._parts_above_noise(flat(), SHAPE, poles) == share
    misfit[:] = 0.02 * np.exp(0.2)
    misfit[0, :24], misfit[0, 24], misfit[1, 95] = 0.0, 0.0, 1e9  # of one bin e^-5 and e^5 are the limits
    # 8 parts: the first is 0; in the second one bin takes 5.2 / 24 off 0.2, which is below; in the last it adds to it
    assert identify._parts_above_noise(flat(), SHAPE, poles) == 7 / 8
    misfit[0, 24:26] = 0.0
    assert identify._parts_above_noise(flat(), SHAPE, poles) == 6 / 8


# modes that are wanted and that are not


def test_modes_are_left_out_by_frequency_and_made_where_they_are_missing(monkeypatch) -> None:
    weak, moved = [[1], []], []

    def descend(problem, poles, most, enough):
        moved.append((poles.freq.round(2).tolist(), most, enough))
        return poles, None

    monkeypatch.setattr(identify, "descend", descend)
    monkeypatch.setattr(identify, "inaudible", lambda problem, poles, required: np.array(weak.pop(0), dtype=int))
    problem, idle = Projection(flat(), SHAPE), []
    poles = Poles.at([50.0, 110.0, 130.0, 150.0, 190.0], [30.0, 30.0, 30.0, 10.0, 30.0])
    required = Poles.at([131.0, 170.0], [50.0, 50.0])
    found = identify._fixed(problem, poles, required, [157.0, 193.0], idle)
    # 157 is within half the bandwidth of 150, 5 %, and 193 within 3 % of 190
    assert moved == [
        ([50.0, 110.0, 130.0], 6, 1e-6), ([50.0, 130.0], 6, 1e-6), ([50.0, 130.0, 170.0], 12, 1e-6),
    ]  # fmt: skip
    assert idle == pytest.approx([110.0])
    assert found.quality[-1] == pytest.approx(50.0)
    weak[:], idle[:] = [[0], []], []
    moved.clear()
    identify._fixed(problem, poles, Poles.none(), [], idle)
    assert idle == []  # beyond the band: it stands for modes there
    assert len(moved) == 1


@pytest.mark.parametrize(
    ("lower", "upper", "ratios", "kept"),
    [
        (True, True, [[3.1, -2.9], [-2.9, 3.1]], (True, True)),
        (True, True, [[3.1, 3.1], [-3.1, -2.9]], (False, True)),
        (True, True, [[2.9, 9.0], [2.9, 9.0]], (False, True)),
        (True, True, [[9.0, 2.9], [9.0, 0.0]], (True, False)),
        (False, True, [[9.0], [0.0]], (False, True)),
        (False, True, [[2.0], [0.0]], (False, False)),
        (True, False, [[2.0], [0.0]], (False, False)),
        (True, False, [[4.0], [0.0]], (True, False)),
    ],
)
def test_edges_stay_that_are_surely_positive_somewhere_and_negative_nowhere(
    lower, upper, ratios, kept, monkeypatch
) -> None:
    """By three standard deviations, at the two driving points; a third response says nothing."""
    shape = Shape((0, 2), 3, False, lower, upper)
    n = 1 + lower + upper
    residues, deviation = np.full((3, n), -50.0), np.full((3, n), 0.5)
    residues[:, 0] = 1.0
    residues[[0, 2], 1:] = 0.5 * np.array(ratios)
    monkeypatch.setattr(Projection, "solve", lambda self, poles: SimpleNamespace(residues=residues))
    monkeypatch.setattr(Projection, "deviations", lambda self, poles: (None, None, deviation))
    found = identify._without_idle_edges(Projection(flat(rows=3), shape), Poles.at([150.0], [30.0]))
    assert found == replace(shape, lower=kept[0], upper=kept[1])


@pytest.mark.parametrize(("apart", "quality", "gone"), [(0.8, 300.0, True), (1.2, 300.0, False), (0.8, 150.0, False)])
def test_bins_of_half_a_hertz_resolve_modes_a_hertz_apart(apart, quality, gone) -> None:
    """200 Hz / Q of 0.67 Hz is narrower than two bins, of 1.33 Hz it is not."""
    freq = np.arange(100.0, 301.0, 0.5)
    data = FitData(freq, np.zeros((1, freq.size), complex), np.ones((1, freq.size)))
    poles = Poles.at([200.0, 200.0 + apart], [quality] * 2)
    assert search._unresolved(poles, np.array([9.0, 5.0]), data).tolist() == [False, gone]


# tables and arrays


@pytest.mark.parametrize(("largest", "radians"), [(1.0005 * np.pi, True), (1.0015 * np.pi, False), (0.4, False)])
def test_phases_that_turn_within_pi_are_radians(largest, radians) -> None:
    phase = np.array([-0.55, np.nan, largest, np.inf])
    assert arrays.within_pi(phase) is radians
    assert not arrays.within_pi(np.array([np.nan]))


def test_a_matrix_may_begin_at_0_hz() -> None:
    freq = np.arange(0.0, 20.0)
    for first, taken in ((0.0, True), (-1.0, False)):
        x = np.stack([freq + first, 1j * freq, 2j * freq], axis=1)
        found, remarks = arrays._frequencies_apart({"x": x})
        assert (list(found) == ["freq_Hz", "x"], bool(remarks)) == (taken, taken)
    table = arrays.responses_of_arrays(Path("a.npy"), {"x": np.stack([freq, 1j * freq], axis=1)})
    assert table.freq[0] == 0.0
    assert [row.tolist() for row in table.rows.values()] == [(1j * freq).tolist()]


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("20,5\t1,5+2,5i", [20.5, 1.5, 2.5]), ("20,5;1,5;-2", [20.5, 1.5, -2.0]), ("20.5,1.5,-2", [20.5, 1.5, -2.0]),
        ("20,5 1,5 -2", [20.5, 1.5, -2.0]), ("20.5, 1.5, -2", [20.5, 1.5, -2.0]), ("1,2,3 4", [1.0, 2.0, 3.0, 4.0]),
        ("1 (2 - 3j)", [1.0, 2.0, -3.0]), ("1;;3", [1.0, np.nan, 3.0]), (";2;3", None), ("1;a;3", None),
        ("1_0;2", None), ("1e3\t2E-2", [1000.0, 0.02]), ("\N{ARABIC-INDIC DIGIT ONE};2", None),
        ("1 2I", [1.0, 0.0, 2.0]),
    ],
)  # fmt: skip
def test_numbers_of_a_line(line, numbers) -> None:
    found = texts._numbers(line)
    assert found == (numbers if numbers is None else pytest.approx(numbers, nan_ok=True))
