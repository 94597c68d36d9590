"""Parameters: numbers are numbers, unknown keys are refused, faults are one line."""

from __future__ import annotations

import math
import re
from typing import Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tonewood.errors import BundleError
from tonewood.support.params import Number, Parameters, Vector, described, quantity, validated
from tonewood.support.units import cents, decibel, ratio_of_cents, t60


class Inner(Parameters):
    depth: float = quantity("m", low=0.0, high=1.0, doc="how deep")


class Outer(Parameters):
    mass: float = quantity("kg", low=0.0, doc="how heavy")
    way: Vector = described("where to", default=(1.0, 0.0, 0.0))
    kind: Literal["a", "b"] = described("which", default="a")
    parts: list[Inner] = described("its parts", default=[])
    named: dict[str, Inner] = described("and by name", default={})
    either: Number | Inner = described("one or the other", default=0.0)


def test_sound_values() -> None:
    outer = validated(Outer, {"mass": 2, "way": [0, 0, 1], "named": {"x": {"depth": 0.5}}}, key="o")
    assert (outer.mass, outer.way, outer.named["x"].depth) == (2.0, (0.0, 0.0, 1.0), 0.5)
    assert Outer.model_json_schema()["properties"]["mass"]["unit"] == "kg"


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({}, "f.yaml: o.mass: is missing"),
        ({"mass": "2"}, "f.yaml: o.mass: Input should be a valid number, not '2'"),
        ({"mass": True}, "f.yaml: o.mass: Input should be a valid number, not True"),
        ({"mass": math.inf}, "f.yaml: o.mass: Input should be a finite number, not inf"),
        ({"mass": -1.0}, "f.yaml: o.mass: is -1 kg; at least 0 kg is allowed"),
        ({"mass": 1, "way": [1, 0]}, "f.yaml: o.way"),
        ({"mass": 1, "way": [1, 0, "z"]}, "f.yaml: o.way.2: Input should be a valid number, not 'z'"),
        ({"mass": 1, "kind": "c"}, "f.yaml: o.kind: Input should be 'a' or 'b', not 'c'"),
        ({"mass": 1, "colour": 3}, "f.yaml: o.colour: is not a known key; allowed: mass, way, kind, parts"),
        ({"mass": 1, "parts": [{"depth": 0}, {"wide": 1, "depth": 0}]}, "1.wide: is not a known key; allowed: depth"),
        ({"mass": 1, "named": {"x": {}}}, "f.yaml: o.named.x.depth: is missing"),
        ({"mass": 1, "either": {"depth": 3}}, "o.either"),
    ],
)  # fmt: skip
def test_faults(values: dict[str, Any], line: str) -> None:
    with pytest.raises(BundleError) as fault:
        validated(Outer, values, key="o", file="f.yaml")
    assert line in str(fault.value)
    assert "\n" not in str(fault.value)


def test_parameters_do_not_change() -> None:
    with pytest.raises(ValueError, match="frozen"):
        Inner(depth=0.5).depth = 0.2


def test_units() -> None:
    assert cents(2.0) == 1200.0
    assert ratio_of_cents(cents(1.37)) == pytest.approx(1.37)
    assert decibel(0.001) == pytest.approx(-60.0)
    assert decibel(0.0) == -math.inf
    assert math.exp(-3.0 * t60(3.0)) == pytest.approx(1e-3)
    assert t60(0.0) == math.inf


class Measured(Parameters):
    """Numbers with units that people mistake."""

    length: float = quantity("m", low=0.05, high=5.0, default=1.0, doc="of a string")
    time: float = quantity("s", low=0.0, high=0.5, default=0.1, doc="of a stroke")
    modulus: float = quantity("Pa", low=1e6, high=1e13, default=1e9, doc="of wood")
    ratio: float = quantity("1", low=0.0, high=1.0, default=0.5, doc="of two")
    tension: float = quantity("N", low=1.0, high=2000.0, usual=(10.0, 1500.0), default=70.0, doc="of a string")
    density: float = quantity("kg/m", low=0.0, default=1e-3, doc="of a string")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"length": 650}, "length: is 650 m; at most 5 m: did you mean 650 mm (0.65)?"),
        ({"length": 65}, "length: is 65 m; at most 5 m: did you mean 65 cm (0.65)?"),
        ({"length": 9e9}, "length: is 9000000000 m; at most 5 m is allowed"),
        ({"length": -1}, "length: is -1 m; at least 0.05 m is allowed"),
        ({"time": 30}, "time: is 30 s; at most 0.5 s: did you mean 30 ms (0.03)?"),
        ({"modulus": 12}, "modulus: is 12 Pa; at least 1000000 Pa: did you mean 12 GPa (1.2e+10)?"),
        ({"ratio": 20}, "ratio: is 20; at most 1: did you mean 20 % (0.2)?"),
        ({"tension": 2399}, "tension: is 2399 N; at most 2000 N is allowed"),
        ({"tension": 0.07}, "tension: is 0.07 N; at least 1 N: did you mean 0.07 kN (70)?"),
        ({"modulus": 1e14}, "modulus: is 1e+14 Pa; at most 1e+13 Pa is allowed"),
        ({"density": -0.5}, "density: is -0.5 kg/m; at least 0 kg/m is allowed"),
        ({"lenth": 1.0}, "lenth: is not a known key; did you mean length? allowed: "),
    ],
)
def test_numbers_beyond_their_bounds_are_shown_in_units(values: dict[str, Any], said: str) -> None:
    with pytest.raises(BundleError) as fault:
        validated(Measured, values, key="")
    assert said in str(fault.value)


#: units, and the range in which a value of the key would be believed
BELIEVED = {
    "length": (0.1, 2.5),
    "time": (5e-4, 0.5),
    "modulus": (1e7, 1e12),
    "ratio": (1e-3, 1),
    "tension": (10, 1500),
}
IN_SI = {"mm": 1e-3, "cm": 1e-2, "ms": 1e-3, "MPa": 1e6, "GPa": 1e9, "%": 1e-2, "mN": 1e-3, "kN": 1e3}


@given(st.sampled_from(sorted(BELIEVED)), st.floats(-9, 15), st.sampled_from([1, -1]))
def test_a_hint_has_a_value_that_would_be_believed(key: str, decade: float, sign: int) -> None:
    """Over 24 decades: each unit that is named gives a plausible number of the right size, and no wrong value none."""
    _, _, hint = answer(key, sign * 10.0**decade).partition("did you mean ")
    low, high = BELIEVED[key]
    hints = re.findall(r"(\S+) (\S+) \((\S+?)\)", hint)
    assert bool(hints) == bool(hint)
    for said, unit, shown in hints:
        assert low <= float(shown) <= high
        assert float(shown) == pytest.approx(float(said) * IN_SI[unit], rel=1e-5)


@given(st.sampled_from(sorted(BELIEVED)), st.floats(0.2, 0.8))
def test_a_usual_value_in_another_unit_is_recognised(key: str, share: float) -> None:
    """A usual value, written in the unit of daily use: that unit is among the hints."""
    low, high = BELIEVED[key]
    unit = {"length": "mm", "time": "ms", "modulus": "GPa", "ratio": "%", "tension": "kN"}[key]
    said = answer(key, low * (high / low) ** share / IN_SI[unit])
    assert f" {unit} (" in said or (key == "ratio" and not said)  # a few percent are a ratio, too


def answer(key: str, value: float) -> str:
    """Error of a value, empty where it is allowed."""
    try:
        validated(Measured, {key: value}, key="")
    except BundleError as fault:
        return str(fault)
    return ""


def test_an_unknown_key_comes_before_the_missing_one_it_resembles() -> None:
    for values, said in (
        ({"mas": 1.0}, "mas: is not a known key; did you mean mass?"),
        ({"depth": 1}, "mass: is missing"),
    ):
        with pytest.raises(BundleError) as fault:
            validated(Outer, values, key="")
        assert str(fault.value).startswith(said)
