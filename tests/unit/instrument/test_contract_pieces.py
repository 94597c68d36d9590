"""Pieces of the contract of plugins against closed forms: circuits that run, spans of gestures, rises of tension."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import BundleError
from tonewood.instrument.contract.base import PickupRows, Resonator
from tonewood.instrument.contract.contract_checks import WrongResultError, pickup_rows
from tonewood.instrument.contract.conversion import Circuit, Conversion, Converter
from tonewood.instrument.contract.effects import Norms, rise_of_tension
from tonewood.instrument.contract.files import Files
from tonewood.instrument.contract.gestures import Gesture, Hold
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.system import Readout
from tonewood.physics.stepping.forcing import Segment

FS = 48000.0


@pytest.mark.parametrize("sizes", [[480], [1, 2, 77, 400], [1] * 480])
def test_a_circuit_in_blocks_answers_a_ramp_as_its_closed_form(sizes: list[int]) -> None:
    """RC low pass, 1 / (1 + s tau): a ramp t of two channels gives t - tau (1 - exp(-t / tau)), in any blocks."""
    tau, t = 1e-3, np.arange(480) / FS
    run = Converter(Conversion(circuit=Circuit((1.0,), (tau, 1.0))), 1 / FS, 2)
    ramp, at, out = np.stack([t, -3 * t], axis=1), 0, []
    for size in sizes:
        out.append(run(ramp[at : at + size]))
        at += size
    expected = t - tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(np.concatenate(out), np.stack([expected, -3 * expected], axis=1), atol=1e-15)


def test_a_circuit_of_second_order_in_blocks_is_one_in_a_piece() -> None:
    """A resonance of a coil and its cable: q = 2 at 3 kHz, and its answer at that frequency is 2."""
    w = 2 * math.pi * 3000.0
    circuit = Circuit((w**2,), (1.0, w / 2, w**2))
    assert abs(circuit.response(np.array([3000.0]))[0]) == pytest.approx(2.0)
    noise = np.random.default_rng(1).standard_normal((300, 1))
    whole, run = Converter(Conversion(circuit=circuit), 1 / FS, 1), Converter(Conversion(circuit=circuit), 1 / FS, 1)
    pieces = np.concatenate([run(noise[:7]), run(noise[7:8]), run(noise[8:])])
    np.testing.assert_allclose(pieces, whole(noise), atol=1e-12)


def test_a_gesture_lasts_from_its_first_piece_to_its_last() -> None:
    force = (Segment(-0.004, -0.001, 1.0, 0.0, 0.0), Segment(-0.001, 0.0, 1.0, 0.0, 0.0))
    assert (Gesture(force).start, Gesture(force).stop) == (-0.004, 0.0)
    held = Gesture(force, hold=Hold(-0.01, -0.008, -0.002, 1.0))
    assert (held.start, held.stop) == (-0.01, 0.0)
    late = Gesture(force, hold=Hold(-0.002, 0.0, 0.03, 1.0))
    assert (late.start, late.stop) == (-0.004, 0.03)
    assert (Gesture(()).start, Gesture(()).stop) == (0.0, 0.0)


def test_a_held_string_s_rise_of_tension_is_that_of_its_shape() -> None:
    """In its first mode, amplitude a, E = T (pi a)^2 / (4 L); the mean rise is half of the largest."""
    tension, stiffness, length, a = 70.0, 2.0e4, 0.65, 2e-3
    energy = tension * (math.pi * a) ** 2 / (4 * length)
    x = np.linspace(0.0, length, 20001)
    slope = a * math.pi / length * np.cos(math.pi * x / length)
    mean_rise = stiffness * np.trapezoid(slope**2 / 2, x) / length / 2
    cents = 1200 * math.log2(math.sqrt(1 + mean_rise / tension))
    assert rise_of_tension(Norms(0.0, energy, tension, stiffness, length)) == pytest.approx(1.5 * cents, rel=0.02)


def test_rows_of_a_pickup_with_a_circuit_alone_are_checked() -> None:
    """One readout for each channel; the circuit stands after them."""
    plugin, circuit = SimpleNamespace(channels=("left", "right")), Conversion(circuit=Circuit((1.0,), (1e-3, 1.0)))
    readouts = tuple(Readout(name, "velocity", (Term("body", "bridge"),)) for name in plugin.channels)
    pickup_rows(plugin, PickupRows(readouts, conversion=circuit))
    with pytest.raises(WrongResultError, match="1 readouts; one for each of its 2 channels"):
        pickup_rows(plugin, PickupRows(readouts[:1], conversion=circuit))
    with pytest.raises(WrongResultError, match="stable and proper"):
        pickup_rows(plugin, PickupRows(readouts, conversion=Conversion(circuit=Circuit((1.0, 1.0), (1e-3,)))))
    with pytest.raises(WrongResultError, match="stable and proper"):
        pickup_rows(plugin, PickupRows(readouts, conversion=Conversion(circuit=Circuit((1.0,), (-1e-3, 1.0)))))


def test_a_notebook_shows_a_plugin_as_the_table_of_its_parameters() -> None:
    string = tw.load_instrument("monochord").resonators["A2"]
    shown = string._repr_html_()
    assert shown.startswith("<strong>StiffString, resonator strings.A2</strong><table><tr>")
    assert re.findall("<th [^>]*>(.*?)</th>", shown) == [*string.parameters.model_dump(mode="json", by_alias=True)]
    alone = type(string)(string.parameters, string.files)
    assert alone._repr_html_().startswith("<strong>StiffString, resonator</strong>")
    assert (repr(string), repr(alone)) == ("StiffString(strings.A2)", "StiffString(resonator)")


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda x: x, "returns float64 of shape (4, 3); real numbers of shape (4, 2) are wanted"),
        (lambda x: 1 / 0, "conversion.function raises ZeroDivisionError: division by zero"),
        (lambda x: x[:, :2] + 1j, "returns complex128 of shape (4, 2)"),
        (lambda x: x[:, 0], "returns float64 of shape (4,)"),
    ],
)
def test_functions_of_a_conversion_return_a_column_a_channel(function: Any, said: str) -> None:
    run = Converter(Conversion(function=function), 1 / FS, 2, lambda reason: BundleError(reason, key="outputs.0"))
    with pytest.raises(BundleError) as fault:
        run(np.zeros((4, 3)))
    assert said in str(fault.value)
    assert fault.value.key == "outputs.0"
    run = Converter(Conversion(function=lambda x: x[:, :2] ** 2), 1 / FS, 2)
    assert run(np.full((2, 3), 3.0)).tolist() == [[9.0, 9.0]] * 2


LENGTHS = {"length": 0.65, "tension": 70.0, "linear_density": 4e-3}


@pytest.mark.parametrize(
    ("loss", "key", "said"),
    [
        (3.0, "s.loss", "is a float; a mapping with the key law, the name of a loss law, is wanted"),
        ({}, "s.loss.law", "is missing"),
        ({"law": 3}, "s.loss.law", "is an int; the name of a loss law is wanted: "),
        ({"law": "sigm"}, "s.loss.law", "did you mean sigma?"),
        ({"law": "hammer"}, "s.loss.law", "is of kind exciter; one of kind loss is wanted"),
        ({"law": "sigma", "sigma0": -1.0}, "s.loss.sigma0", ""),
    ],
)
def test_a_loss_law_is_made_from_its_name_and_keys(loss: Any, key: str, said: str) -> None:
    string = type(tw.load_instrument("monochord").resonators["A2"])
    law = string.from_values({**LENGTHS, "loss": {"law": "sigma", "sigma0": 0.5}}).parameters.loss
    assert (law.law, law.parameters.sigma0) == ("sigma", 0.5)
    assert string.from_values({**LENGTHS, "loss": law}).parameters.loss is law
    with pytest.raises(BundleError) as fault:
        string.from_values({**LENGTHS, "loss": loss}, key="s")
    assert (fault.value.key, said in str(fault.value)) == (key, True), str(fault.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n# note\n\n 3 , 4e1\n", ""),
        ("a,a\n1,2\n", "line 1: a column has no name or the name of another"),
        ("a,\n1,2\n", "line 1: a column has no name or the name of another"),
        ("#x\na,b\n1\n", "line 3: 1 numbers under 2 columns"),
        ("a,b\n1,nan\n", "line 2, column b: 'nan' is not a finite number"),
        ("a,b\n", "holds no rows"),
    ],
)
def test_tables_of_a_bundle_are_read_by_lines(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "t.csv").write_text(text)
    files = Files(tmp_path, tmp_path / "instrument.yaml")
    if not said:
        assert {name: list(values) for name, values in files.table("t.csv").items()} == {
            "a": [1.0, 3.0],
            "b": [2.0, 40.0],
        }
        assert files.cells("t.csv")[1] == [(2, ["1", "2"]), (5, ["3", "4e1"])]
        return
    with pytest.raises(BundleError, match=re.escape(said)) as fault:
        files.table("t.csv")
    assert fault.value.file == str(tmp_path / "t.csv")


def test_files_of_a_bundle_are_in_its_folder_unless_granted(tmp_path: Path) -> None:
    outside, root = tmp_path / "t.csv", tmp_path / "b"
    root.mkdir()
    outside.write_text("a\n1\n")
    (root / "t.csv").write_text("a\n2\n")
    granted = Files(root, granted=frozenset({outside}))
    assert granted.path(str(outside)) == outside
    assert granted.path("t.csv") == (root / "t.csv").resolve()
    for name in (str(outside), "../t.csv", "C:t.csv", "..\\t.csv", ""):
        with pytest.raises(BundleError, match="leads out of the bundle"):
            Files(root).path(name, "body.table")
    for name, said in (("n.csv", "there is no file 'n.csv'"), ("t.csv\0", "cannot be followed to a file")):
        with pytest.raises(BundleError, match=said):
            Files(root).path(name)
    with pytest.raises(BundleError, match="needs a bundle's folder"):
        Files(None).path("t.csv")


def test_a_string_leaves_out_its_physics_or_its_modes() -> None:
    """The physics of a uniform string is wanted, or the modes where a class has begun on these."""

    def left_out(*names: str) -> list[str]:
        methods = dict.fromkeys(("length", "tension", *names), lambda self, *words: 1.0)
        return type("Own", (Resonator,), methods).left_out()

    assert left_out() == ["linear_density", "loss"]
    assert left_out("loss") == ["linear_density"]
    assert left_out("basis") == ["detuned", "transfer"]
    assert left_out("basis", "loss", "transfer") == ["detuned"]
    assert left_out("linear_density", "loss") == left_out("basis", "detuned", "transfer") == []
    assert type("Bare", (Resonator,), {}).left_out() == ["length", "tension", "linear_density", "loss"]
