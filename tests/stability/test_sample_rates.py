"""One instrument at sampling rates from 8 to 192 kHz: the same pitches and decay times, and no trouble anywhere."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from scenes import body, guitar, string

from assembled import held_force, poles_of, step_map
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.stepping.kernel import KernelStepper

RATES = [8000, 11025, 16000, 22050, 32000, 44100, 48000, 96000, 192000]


def instrument(fs, name="G3"):
    """One string on the body, every mode below 0.45 fs and the compliance of the others."""
    limit = 0.45 * fs
    joint = Connection("end", (Term(name, "bridge"), Term("body", name, -1.0)))
    readouts = [Readout("top", "velocity", (Term("body", "top"),))]
    return System.build({name: string(name, limit), "body": body(limit, residual=2e-9)}, [joint], readouts, dt=1 / fs)


@pytest.fixture(scope="module")
def reference():
    """Poles at a rate where the string's 40 lowest modes and their hold are beyond doubt."""
    fs = 384_000
    limit = 0.1 * fs
    joint = Connection("end", (Term("G3", "bridge"), Term("body", "G3", -1.0)))
    system = System.build({"G3": string("G3", limit), "body": body(limit, residual=2e-9)}, [joint], dt=1 / fs)
    return poles_of(step_map(system, KernelStepper), 1 / fs)


@pytest.mark.parametrize("fs", RATES)
def test_pitches_and_decay_times_agree(fs, reference):
    """Below 1.5 kHz: pitch within 2.2 cents at 8 kHz and 0.07 cent from 44.1 kHz on, T60 within 3 % and 0.2 %."""
    poles = poles_of(step_map(instrument(fs), KernelStepper), 1 / fs)
    expected = reference[reference.imag < 2 * np.pi * 1500]
    cents, t60 = 0.07 * max(1.0, (44100 / fs) ** 2), 0.002 * max(1.0, (44100 / fs) ** 1.6)
    for pole in expected:
        nearest = poles[np.argmin(np.abs(poles - pole))]
        assert abs(1200 * np.log2(nearest.imag / pole.imag)) < cents
        assert abs(nearest.real / pole.real - 1) < t60


@pytest.mark.parametrize("fs", RATES)
def test_no_pole_of_the_step_grows(fs):
    """Every multiplier of the guitar's map lies in the unit circle, at every rate."""
    step = step_map(guitar(fs, names=("G3",)), KernelStepper)

    assert np.abs(sla.eigvals(step)).max() < 1.0


@pytest.mark.parametrize("fs", [8000, 44100, 192000])
def test_rendered_pluck_decays_alike(fs):
    """Level of the plucked string after 0.1 and 0.5 s against 48 kHz, 400 Hz low-passed by its own modes: 0.1 dB."""

    def levels(rate):
        system = instrument(rate)
        ramp = np.linspace(0, 1, rate // 50)
        force = held_force(system.compiled[0].basis, "G3", "pluck", ramp, 1 / rate)
        stepper = KernelStepper(system)
        out = stepper.run(stepper.start(), int(0.6 * rate), [force])[0][:, 0]
        t = np.arange(out.size) / rate
        # energy in a band around the fundamental, by a Hann-windowed transform at its frequency
        bands = []
        for start in (0.1, 0.4):
            part = (t >= start) & (t < start + 0.15)
            window = np.hanning(np.count_nonzero(part))
            bands.append(abs(np.sum(out[part] * window * np.exp(-2j * np.pi * 195.9 * t[part]))) / window.sum())
        return 20 * np.log10(bands)

    np.testing.assert_allclose(levels(fs), levels(48000), atol=0.1)
