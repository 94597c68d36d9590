"""Order of nonlinear steps: error against 1.536 MHz, 32 times 48 kHz, falls with the square of the step."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

LENGTH, TENSION, DENSITY = 0.65, 70.0, 3.6e-3
N_MODES, DURATION, COARSE = 12, 0.01, 24000
DOUBLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
#: not powers: V = A cosh(d / a), and friction on a partner that is always faster, or holds the string
POTENTIAL, SLOPE = DOUBLE(lambda d: 4e-4 * math.cosh(d / 5e-4)), DOUBLE(lambda d: 0.8 * math.sinh(d / 5e-4))
LAWS = {
    "soft contact": Contact(1e5, 1.0, offset=-1e-4),
    "contact": Contact(3e7, 2.3, offset=-1e-4),
    "lossy contact": Contact(3e7, 2.3, loss=0.3, offset=-1e-4),
    "hardening spring": HardeningSpring(1e3, 1e9, 0.3, 2.0),
    "sampled": SampledPotential.from_potential(x := np.linspace(-3e-3, 3e-3, 41), 2e3 * x**2 + 3e8 * x**4, damping=0.1),
    "compiled": CompiledPotential(POTENTIAL, SLOPE, damping=0.1),
    "sliding": Friction(0.3, velocity=-3.0, speed=2.0),
    "sticking": Friction(50.0),
    "tension": None,
}


def motion(law, rate, residual=0.0):
    """Displacement at the quarter of a plucked string, at the samples of the coarsest step.

    `residual` (m/N): compliance of modes left out, where the law acts.
    """
    n = np.arange(1, N_MODES + 1)
    omega = n * np.pi / LENGTH * np.sqrt(TENSION / DENSITY)
    basis = ModalBasis.real(
        omega, 1.0 + 0 * omega, {"p": 0.25 * LENGTH, "q": 0.4 * LENGTH}, modal_mass=DENSITY * LENGTH / 2,
        shape=lambda x: np.sin(n * np.pi * x / LENGTH), residual=np.diag([0.0, residual]),
        metadata={"length": LENGTH, "tension_part": (n * np.pi / LENGTH) ** 2 / DENSITY},
    )  # fmt: skip
    readouts = [Readout("u", "displacement", (Term("string", "p"),))]
    connections = [Connection("law", (Term("string", "q"),), law)] if law is not None else []
    tensions = [TensionModulation("t", ("string",), 3e4)] if law is None else []
    system = System.build({"string": basis}, connections, readouts, dt=1 / rate, potentials=tensions)
    state = system.start()
    state.modes[0, :N_MODES] = 1e-3 * np.sin(0.3 * n) / n**3 * np.sqrt(DENSITY * LENGTH / 2)
    out, _ = KernelStepper(system).run(state, int(DURATION * rate) + 1)
    return out[:: rate // COARSE, 0]


@pytest.mark.parametrize("name", LAWS)
def test_smooth_laws_are_of_second_order(name):
    exact = motion(LAWS[name], 16 * 4 * COARSE)
    first = 2 if name == "tension" else 1  # at the coarsest step psi is put back in between
    errors = [np.abs(motion(LAWS[name], k * first * COARSE) - exact).max() for k in (1, 2, 4)]
    assert errors[0] < 0.05 * np.abs(exact).max()
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    # where a contact's stiffness jumps the error of one rate depends on where in a step it is met
    assert orders[-1] > 1.7, errors
    assert orders.mean() > 1.5, errors


@pytest.mark.parametrize("residual", [1e-6, 1e-5])
def test_what_yields_in_series_is_of_second_order(residual):
    """A contact at the string's own place, softened by the modes that are left out: its loss vanishes with h^2."""
    law = Contact(1e5, 1.0, offset=-1e-4)
    exact = motion(law, 16 * 4 * COARSE, residual)
    errors = [np.abs(motion(law, k * COARSE, residual) - exact).max() for k in (1, 2, 4)]
    assert errors[0] < 0.05 * np.abs(exact).max()
    assert np.log2(errors[0] / errors[2]) / 2 > 1.6, errors
