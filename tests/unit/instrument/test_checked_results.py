"""Checks of what plugins return, at their limits and on both sides; what coupled modes say of a tuning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tonewood.errors import BundleError, TonewoodError
from tonewood.instrument.contract import contract_checks as checks
from tonewood.instrument.contract.attached import Attached, Motion, loose_mass
from tonewood.instrument.contract.base import BodyPoint, PickupRows
from tonewood.instrument.contract.contract_checks import WrongResultError
from tonewood.instrument.contract.conversion import Circuit, Conversion
from tonewood.instrument.contract.gestures import Gesture, Hold
from tonewood.instrument.model.tuning import (
    CoupledMode,
    TunedStop,
    body_ports,
    ends_at_rest,
    no_mode,
    of_second_polarization,
)
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws.contact import Contact
from tonewood.physics.coupling.layout import Drive, Readout
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import SampledForce, Segment

S = Segment(0.0, 1.0, 2.0)
WAVE = np.array([0.0, 1.0, 0.0])


def refusal(check: Callable[[], object]) -> str:
    """Text of the refusal; empty where the result is taken."""
    try:
        check()
    except WrongResultError as wrong:
        return str(wrong)
    return ""


@pytest.mark.parametrize(
    ("value", "low", "above", "said"),
    [
        (0.0, 0.0, False, ""),
        (0.0, 0.0, True, "0.0; x is wanted"),
        (1e-300, 0.0, True, ""),
        (-1e-9, 0.0, False, "is wanted"),
        (math.nan, -math.inf, False, "nan; x is wanted"),
        (math.inf, -math.inf, False, "is wanted"),
        (True, 0.0, False, "True"),
        (np.float32(2.0), 0.0, False, ""),
        (np.int64(3), 0.0, False, ""),
        (10**400, 0.0, False, "is wanted"),
        ("1", 0.0, False, "'1'"),
        (-1e308, -math.inf, False, ""),
        (None, 0.0, False, "None"),
    ],
)
def test_numbers_are_finite_and_in_their_range(value: Any, low: float, above: bool, said: str) -> None:
    found = refusal(lambda: checks.number(value, "x", low, above=above))
    assert (said in found) if said else found == ""


@pytest.mark.filterwarnings("error")
def test_numbers_of_32_bits_are_checked_without_a_warning() -> None:
    assert refusal(lambda: checks.number(np.float32(3.0), "x", 0.0)) == ""
    assert "inf" in refusal(lambda: checks.number(np.float32(math.inf), "x"))


def test_long_values_are_shown_by_their_kind() -> None:
    assert refusal(lambda: checks.want(False, "a" * 58, "y", "w")) == f"w {'a' * 58!r}; y is wanted"
    assert "a" * 59 not in refusal(lambda: checks.want(False, "a" * 59, "y"))
    assert "\n" not in refusal(lambda: checks.want(False, SimpleNamespace(a=np.zeros((3, 3))), "y"))
    assert refusal(lambda: checks.want(True, 1, "y")) == ""
    for value, shown in ((np.ones((1, 2)), "array([[1., 1.]])"), (np.ones((2, 2)), "a ndarray")):  # of two lines
        assert refusal(lambda value=value: checks.want(False, value, "y", "w")) == f"w {shown}; y is wanted"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"segments": [S]}, "a tuple of ta.Segment"),
        ({"segments": (1,)}, "a ta.Segment"),
        ({"segments": (Segment(0.0, 1.0, math.nan),)}, "segments: c0 nan"),
        ({"segments": (Segment(0.0, 1.0, 0.0, math.inf),)}, "c1"),
        ({"segments": (Segment(0.0, 1.0, 0.0, 0.0, math.inf),)}, "c2"),
        ({"segments": (Segment(1.0, 1.0, 0.0),)}, ""),
        ({"segments": (Segment(1.1, 1.0, 0.0),)}, "a start before the stop"),
        ({"segments": (Segment(-checks._LONGEST_GESTURE, checks._LONGEST_GESTURE, 0.0),)}, ""),
        ({"segments": (Segment(0.0, 1.01 * checks._LONGEST_GESTURE, 0.0),)}, "times of at most"),
        ({"segments": (Segment(-1.01 * checks._LONGEST_GESTURE, 0.0, 0.0),)}, "times of at most"),
        ({"stops": (1,)}, "stops"),
        ({"from_bridge": 0.0}, ""),
        ({"from_bridge": -0.1}, "from_bridge -0.1"),
        ({"angle_deg": math.nan}, "angle_deg"),
        ({"width": -1e-9}, "width"),
        ({"on": 3}, "on 3"),
        ({"on": "x"}, ""),
        ({"hold": 1}, "a ta.Hold or None"),
        ({"hold": Hold(0.0, 0.0, 1.0, 0.0)}, ""),
        ({"hold": Hold(0.0, 0.0, 1.0, -1.0)}, "hold.damping"),
        ({"hold": Hold(0.0, math.inf, 1.0, 1.0)}, "hold.grown"),
        ({"hold": Hold(0.0, 0.0, math.nan, 1.0)}, "hold.stop"),
        ({"noise": 1}, "noise 1"),
        ({"noise": SampledForce(0.0, 0.1, WAVE)}, ""),
        ({"noise": SampledForce(math.nan, 0.1, WAVE)}, "noise.start"),
        ({"motions": [1]}, "a tuple of motions"),
        ({"motions": (1,)}, "a ta.Motion"),
        ({"motions": (Motion("k", "offset", (S,)),)}, ""),
        ({"motions": (Motion("k", "offset", (1,)),)}, "motion of k"),
        ({"touches": [1]}, "a mapping of point to segments"),  # type: ignore[arg-type]
        ({"touches": {"p": (S,)}}, ""),
        ({"touches": {"p": ()}}, "one segment or more"),
    ],
)
def test_gestures(changes: dict[str, Any], said: str) -> None:
    found = refusal(lambda: checks.gesture(replace(Gesture((S,), 0.1), **changes)))
    assert (said in found) if said else found == ""
    assert "a ta.Gesture" in refusal(lambda: checks.gesture(None))


@pytest.mark.parametrize(
    ("start", "interval", "values", "said"),
    [
        (0.0, 0.1, WAVE, ""),
        (0.0, 0.0, WAVE, "noise.interval"),
        (0.0, -1.0, WAVE, "noise.interval"),
        (0.0, 0.1, np.zeros((3, 1)), "an array (n,)"),
        (0.0, 0.1, np.zeros(0), "an array (n,)"),
        (0.0, 0.1, WAVE + 0j, "an array (n,)"),
        (0.0, 0.1, [0.0, 1.0], "an array (n,)"),
        (0.0, 0.1, np.array([1, 2]), ""),
        (0.0, 0.1, np.array([1.0, math.nan]), "finite values"),
        (-2 * checks._LONGEST_GESTURE, 0.1, WAVE, "times of at most"),
        (0.0, checks._LONGEST_GESTURE, WAVE, "times of at most"),
    ],
)
def test_sampled_forces(start: float, interval: float, values: Any, said: str) -> None:
    force = SimpleNamespace(start=start, interval=interval, values=values, stop=start + interval * (len(values) - 1))
    found = refusal(lambda: checks._sampled(force))  # type: ignore[arg-type]
    assert (said in found) if said else found == ""


REAL = ModalBasis.real([10.0, 20.0], [0.1, 0.2], {"bridge": [1.0, 1.0], "p": [0.5, -0.5]})


@pytest.mark.parametrize(
    ("attached", "said"),
    [
        (
            Attached(
                {"p": 0.1},
                {"m": loose_mass(1.0)},
                (Connection("k", (Term("m", "mass"),), SpringDashpot()),),
                resting=("k",),
            ),
            "",
        ),
        (3, "a ta.Attached"),
        (Attached([1]), "a mapping of point to metres"),
        (Attached({"p": "x"}), "places['p'] 'x'"),  # type: ignore[arg-type]
        (Attached(components=[1]), "a mapping of name to ta.ModalBasis"),
        (Attached(components={"c": 1}), "components['c'] 1"),  # type: ignore[arg-type, dict-item]
        (Attached(connections=[1]), "a tuple of ta.Connection"),
        (Attached(connections=(1,)), "a ta.Connection"),  # type: ignore[arg-type]
        (Attached(connections=(Connection("k", (1,), SpringDashpot()),)), "connection 'k': terms 1"),  # type: ignore[arg-type]
        (Attached(connections=(Connection("k", (Term("m", 3),), SpringDashpot()),)), "as texts"),  # type: ignore[arg-type]
        (Attached(connections=(Connection("k", (Term("m", "p", math.inf),), SpringDashpot()),)), "a finite factor"),
        (Attached(connections=(Connection("k", (), 7),)), "a law, as ta.Contact"),  # type: ignore[arg-type]
        (Attached(connections=(Connection("k", (), Rigid()),)), ""),
        (Attached(resting=("k",)), "resting 'k'"),
        (Attached(inputs=[1]), "a mapping of name to entries"),  # type: ignore[arg-type]
    ],
)
def test_attached_parts(attached: Any, said: str) -> None:
    found = refusal(lambda: checks.attached(attached))
    assert (said in found) if said else found == ""


@pytest.mark.parametrize(("factor", "fits"), [(0.999, True), (-0.999, True), (1.001, False), (-1.001, False)])
def test_numbers_of_laws_have_limits(factor: float, fits: bool) -> None:
    for law in (
        SpringDashpot(stiffness=abs(factor) * checks._LARGEST_OF_LAW),
        SpringDashpot(offset=factor * checks._LARGEST_OFFSET),
        Contact(1.0, 1.0, 0.0, offset=factor * checks._LARGEST_OFFSET),
    ):
        assert (refusal(lambda law=law: checks.law(law, "w")) == "") is fits


@pytest.mark.parametrize(
    ("basis", "said"),
    [
        (REAL, "a basis without `shape`"),
        (None, "a ta.ModalBasis"),
        (replace_points := ModalBasis.real([1.0], [0.1], {"p": [1.0]}), "'bridge' is wanted"),
        (ModalBasis.real([1.0], [-0.1], {"bridge": [1.0]}), "a damping rate of -0.1 1/s"),
        (
            ModalBasis.complex([-1.0 + 5.0j], {"bridge": [1.0 + 1.0j]}, {"bridge": [1.0 + 0.0j]}),
            "real modes are wanted",
        ),
    ],
)
def test_bases_of_strings(basis: Any, said: str) -> None:
    assert said in refusal(lambda: checks.string_basis(basis))
    lossless = replace(ModalBasis.real([1.0], [0.0], {"bridge": [1.0]}), shape=lambda x: np.ones(1))
    assert refusal(lambda: checks.string_basis(lossless)) == ""
    assert replace_points.points == ("p",)


def test_pairs_of_arrays_have_their_shape() -> None:
    good = np.zeros((2, 3))
    assert refusal(lambda: checks.pair_of_arrays((good, good), (2, 3))) == ""
    for pair, said in (
        ((good,), "a pair"),
        ([good, good], "a pair"),
        ((good, 1), "velocity 1; an array"),
        ((good.T, good), "displacement of shape (3, 2); 2 x 3"),
        ((good, good + math.nan), "velocity"),
    ):
        assert said in refusal(lambda pair=pair: checks.pair_of_arrays(pair, (2, 3)))


ROW = Readout("r", "velocity", (Term("body", "p"),))
FORCE = Readout("f", "force", forces=(("k", 1.0),))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (PickupRows((ROW, FORCE)), ""),
        (None, "a ta.PickupRows"),
        (PickupRows([ROW, FORCE]), "a tuple of ta.Readout"),  # type: ignore[arg-type]
        (PickupRows((ROW, 1)), "a ta.Readout"),
        (PickupRows((ROW,)), "1 readouts; one for each of its 2 channels"),  # type: ignore[arg-type]
        (PickupRows((ROW, ROW, ROW)), "3 readouts"),
        (PickupRows((replace(ROW, probes=()), FORCE)), "without probes"),
        (PickupRows((ROW, replace(FORCE, forces=()))), "without forces"),
        (PickupRows((ROW, replace(FORCE, forces=(("k",),)))), "a pair (connection, factor)"),  # type: ignore[arg-type]
        (PickupRows((ROW, replace(FORCE, forces=(("k", math.nan),)))), "a finite factor"),
        (PickupRows((replace(ROW, probes=(Term("b", "p", math.inf),)), FORCE)), "a finite factor"),
        (PickupRows((replace(ROW, probes=(1,)), FORCE)), "a ta.Term"),  # type: ignore[arg-type]
        (PickupRows((ROW, FORCE), conversion=1), "a ta.Conversion or None"),
        (PickupRows((ROW,), conversion=Conversion(lambda x: np.zeros((len(x), 2)))), ""),  # type: ignore[arg-type]
        (PickupRows((ROW,), conversion=Conversion(lambda x: np.ones((len(x), 2)))), "at rest"),
        (PickupRows((ROW,), conversion=Conversion(lambda x: np.zeros((len(x), 3)))), "zeros of shape (1, 2)"),
        (PickupRows((ROW, FORCE), drives=(1,)), "a ta.Drive"),
        (PickupRows((ROW, FORCE), drives=(Drive("a", "b", "c", 1.0),)), ""),  # type: ignore[arg-type]
        (PickupRows((ROW, FORCE), components={"c": 1}), "components['c']"),  # type: ignore[dict-item]
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((1.0,), (1.0, 1.0)))), ""),
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((), (1.0, 1.0)))), "numerator"),
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((1.0,), (0.0, 1.0)))), "other than 0"),
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((1.0, 1.0), (1.0, 1.0)))), ""),
        (
            PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((1.0, 1.0, 1.0), (1.0, 1.0)))),
            "stable and proper",
        ),
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((1.0,), (1.0, 0.0)))), "stable and proper"),
        (PickupRows((ROW, FORCE), conversion=Conversion(circuit=Circuit((math.inf,), (1.0, 1.0)))), "a finite number"),
    ],
)
def test_rows_of_pickups(rows: Any, said: str) -> None:
    found = refusal(lambda: checks.pickup_rows(SimpleNamespace(channels=("a", "b")), rows))
    assert (said in found) if said else found == ""


def test_points_words_and_rates() -> None:
    good = {"p": BodyPoint((0.0, 0.0, 1.0))}
    assert refusal(lambda: checks.body_points(good)) == ""
    for value, said in (
        ({}, "a mapping"),
        ({"p": 1}, "points['p']"),
        ({"p": BodyPoint((0.0, 1.0))}, "three numbers"),  # type: ignore[arg-type]
        ({"p": BodyPoint((0.0, math.nan, 1.0))}, "a finite number"),
    ):
        assert said in refusal(lambda value=value: checks.body_points(value))
    for words, some, fits in (
        (("a",), True, True),
        ((), True, False),
        ((), False, True),
        (("a", 1), True, False),
        ("ab", True, False),
    ):
        assert (refusal(lambda w=words, s=some: checks.texts(w, "x", some=s)) == "") is fits
    freq = {"freq_rad": np.ones(3)}
    for rates, fits in (
        (None, True),
        (1.0, True),
        (np.ones(3), True),
        (np.ones(2), False),
        (-1.0, False),
        (math.inf, False),
        (np.ones(3) * 1j, False),
    ):
        assert (refusal(lambda r=rates: checks._decay_rate(None, r, freq)) == "") is fits
    omega = {"omega": 2 * np.pi * np.array([100.0, 200.0])}
    for eta, said in (
        (0.1, ""),
        (np.array([0.0, 0.1]), ""),
        (np.ones(3), "loss factors of shape (2,)"),
        (np.array([0.1, -0.1]), "eta = -0.1 at 200 Hz"),
        (np.array([math.nan, 0.1]), "eta = nan at 100 Hz"),
        (checks._HIGHEST_LOSS, ""),
        (1.01 * checks._HIGHEST_LOSS, "at most"),
    ):
        found = refusal(lambda e=eta: checks._loss_factor(None, e, omega))
        assert (said in found) if said else found == ""
    old = {"basis": REAL}
    assert "as many modes" in refusal(lambda: checks._detuned(None, _shaped(1), old))
    assert "the points as before" in refusal(lambda: checks._detuned(None, _shaped(2), old))


def _shaped(n: int) -> ModalBasis:
    basis = ModalBasis.real(np.arange(1.0, n + 1), np.ones(n), {"bridge": np.ones(n)})
    return replace(basis, shape=lambda x: np.ones(n))


def test_methods_are_checked_by_the_names_of_the_contract() -> None:
    class Plain:
        def made(self, first: int, second: int = 2) -> int:
            return first

    class Own(Plain):
        def made(self, a: int, b: int = 5) -> int:  # other names
            if a == 0:
                raise ValueError("nothing\n of it")
            return a + b

        @property
        def size(self) -> float:
            return -1.0

    seen: list[dict[str, Any]] = []

    def verify(plugin: Any, value: Any, arguments: Any) -> None:
        seen.append(dict(arguments))
        checks.want(value < 100, value, "less than 100")

    def fault(plugin: Any, reason: str) -> TonewoodError:
        return BundleError(reason)

    sized = lambda p, v, a: checks.number(v, "a size", 0.0)  # noqa: E731
    checks.check_results(Own, {"made": verify, "size": sized, "absent": verify}, fault)
    own = Own()
    assert own.made(1, 3) == 4
    assert {k: v for k, v in seen[-1].items() if k != "self"} == {"first": 1, "second": 3}
    with pytest.raises(BundleError, match=r"Own\.made returns 105; less than 100 is wanted"):
        own.made(100)
    with pytest.raises(
        BundleError, match=r"Own\.made raises ValueError: nothing of it \(test_checked_results\.py, line \d+\)"
    ):
        own.made(0)
    with pytest.raises(BundleError, match=r"Own\.size returns -1\.0; a size is wanted"):
        _ = own.size


def mode(freq: float, rate: float, strength: float = 1.0, shares: tuple[float, ...] = (0.9, 0.0, 0.1)) -> CoupledMode:
    return CoupledMode(complex(-rate, 2 * math.pi * freq), shares, strength)


def test_levels_of_coupled_modes_are_those_of_their_energy() -> None:
    """20 lg of a / sqrt(2 sigma) re that of the other."""
    one, other = mode(100.0, 1.0, 2.0), mode(100.0, 4.0, 1.0)
    assert one.freq == pytest.approx(100.0)
    assert one.level_db(other) == pytest.approx(20 * math.log10(2.0 * 2.0))
    assert other.level_db(one) == pytest.approx(-20 * math.log10(4.0))


@pytest.mark.parametrize(
    ("second", "error", "wolf"),
    [
        (mode(100.0 * 2 ** (59 / 1200), 1.0, 0.51), 0.0, True),
        (mode(100.0 * 2 ** (61 / 1200), 1.0, 1.0), 0.0, False),
        (mode(100.0 * 2 ** (-59 / 1200), 1.0, 0.51), 0.0, True),
        (mode(100.0, 1.0, 0.49), 0.0, False),
        (mode(150.0, 1.0, 0.01), 1.01, True),
        (mode(150.0, 1.0, 0.01), -1.01, True),
        (mode(150.0, 1.0, 0.01), 0.99, False),
        (mode(100.0, 1.0, 1.0, (0.0, 0.5, 0.5)), 0.0, False),
        (mode(100.0, 1.0, 1.0, (0.0, 0.49, 0.51)), 0.0, True),
    ],
)
def test_a_wolf_is_near_and_loud_or_keeps_the_note_from_its_pitch(
    second: CoupledMode, error: float, wolf: bool
) -> None:
    tuned = TunedStop(100.0 * 2 ** (-error / 1200), 70.0, (mode(100.0, 1.0), second))
    assert tuned.error_cents == pytest.approx(error)
    assert (tuned.wolf is second) is wolf
    assert TunedStop(100.0, 70.0, (mode(100.0, 1.0),)).wolf is None
    assert [of_second_polarization(s) for s in ((0.9, 0.1), (0.2, 0.5, 0.3), (0.2, 0.49, 0.31))] == [False, True, False]


def test_a_string_without_a_mode_says_what_to_change() -> None:
    light = ModalBasis.real([2 * math.pi * 50.0], [1.0], {"bridge": [1.0]})
    heavy = ModalBasis.real([2 * math.pi * 50.0], [2 * math.pi * 60.0], {"bridge": [0.0]})
    assert "sounds near 100 Hz; check `tension`" in no_mode(light, 100.0)
    assert "decays at 377 1/s, and from 628.3 1/s on nothing vibrates there: lower `loss`" in no_mode(heavy, 100.0)
    assert (ends_at_rest(light), ends_at_rest(heavy)) == (False, True)
    ports = body_ports(REAL, [{"bridge": 0.5}, {"p": 2.0}], copies=4)
    single = body_ports(REAL, [{"bridge": 0.5}, {"p": 2.0}])
    np.testing.assert_allclose(ports.right, 2 * single.right)
    np.testing.assert_allclose(single.right, [[0.5] * 4, [1.0, -1.0] * 2])
