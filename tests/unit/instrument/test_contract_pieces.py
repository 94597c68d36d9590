"""Pieces of the contract of plugins against closed forms: circuits that run, spans of gestures, rises of tension."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tonewood.instrument.contract.base import PickupRows
from tonewood.instrument.contract.contract_checks import WrongResultError, pickup_rows
from tonewood.instrument.contract.conversion import Circuit, Conversion, Converter
from tonewood.instrument.contract.effects import Norms, rise_of_tension
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
