"""Dying tails, runs of any length, and numbers that are not numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import displaced, guitar

from assembled import held_force
from tonewood import _kernel
from tonewood.errors import NumericalError
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import BLOCK_SIZE, Injection, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000
ISAS = _kernel.instruction_sets()


def undamped(n=512, connected=True):
    """Free modes from 20 Hz to 21 kHz; a finger that does not touch makes the component one with a port."""
    omega = 2 * np.pi * np.linspace(20, 21_000, n)
    basis = ModalBasis.real(omega, np.zeros(n), {"p": np.ones(n)})
    finger = [Connection("finger", (Term("a", "p"),), SpringDashpot())] if connected else []
    return System.build({"a": basis}, finger, [Readout("u", "displacement", (Term("a", "p"),))], dt=DT)


@pytest.mark.parametrize("isa", ISAS)
def test_tails_do_not_end_in_denormals(isa):
    """Modes that decay below the smallest normal number are flushed: no slow numbers are left in the state.

    Some numbers stay near the smallest one for ever: in a step a mode of 20 Hz changes by 1e-3 to 1e-5 of itself, and
    below a thousand to a hundred thousand times the smallest number it is that change which is flushed.
    """
    system = guitar(eta=0.05, zeta=0.5)
    stepper = KernelStepper(system, isa=isa)
    tiny = float(np.finfo(np.float64).tiny)
    state, quiet = stepper.start(), displaced(system).modes
    # a tail that has come down to some orders above the smallest number already
    state.modes[:] = quiet / np.abs(quiet).max() * tiny * 1e6
    state.modes[np.abs(state.modes) < tiny] = 0.0
    for _ in range(30):
        stepper.run(state, 4800)
        left = np.abs(state.modes[state.modes != 0])
        assert np.all(left >= tiny)
    assert left.max(initial=0.0) < 1e5 * tiny
    # without joints too
    alone = undamped(64)
    dying = alone.with_basis(
        "a", ModalBasis.real(np.sqrt(alone.compiled[0].basis.stiffness), np.full(64, 200.0), {"p": np.ones(64)})
    )
    stepper = KernelStepper(dying, isa=isa)
    state = stepper.start()
    state.modes[0, :64] = tiny * 1e6
    stepper.run(state, 24_000)
    left = np.abs(state.modes[state.modes != 0])
    assert np.all(left >= tiny)
    assert left.max(initial=0.0) < 1e5 * tiny


def test_flushing_is_left_at_the_kernels_door():
    """Denormals of the rest of the process stay as they are, during and after."""
    system = guitar(names=("E4",))
    state = displaced(system)
    KernelStepper(system).run(state, 1000)
    smallest = np.float64(5e-324)
    assert smallest * 1.0 == 5e-324
    assert np.float64(1e-308) / 4 > 0


@pytest.mark.parametrize("isa", ISAS)
def test_runs_of_any_length_are_one_run(isa):
    """A second at once, or a block at a time: the same to the bit."""
    system = guitar()
    start = displaced(system)
    stepper = KernelStepper(system, isa=isa)
    whole, pieces = start.copy(), start.copy()
    out, _ = stepper.run(whole, 16_000)
    parts = [stepper.run(pieces, BLOCK_SIZE)[0] for _ in range(16_000 // BLOCK_SIZE)]
    assert np.array_equal(np.concatenate(parts), out)
    assert np.array_equal(whole.modes, pieces.modes)


@pytest.mark.parametrize("make", [KernelStepper, NumpyStepper])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["body", "E2", "G3", "E4"])
def test_a_number_that_is_not_one_is_reported_where_and_when(make, bad, where):
    """Put into one mode's state at 0.01 s: the next call says which component, at which time."""
    system = guitar()
    state = displaced(system)
    stepper = make(system)
    state.sample = 480
    modes = system.modes_of(state, where)
    modes[1, modes.shape[1] // 2] = bad
    with pytest.raises(NumericalError, match=rf"^{where} is no longer finite at 0\.01"):
        stepper.run(state, 64)


@pytest.mark.parametrize("make", [KernelStepper, NumpyStepper])
def test_an_input_that_is_not_a_number_is_reported_where_and_when(make):
    """In the 32nd step of a known force: within the block of that step."""
    system = guitar()
    values = np.zeros((1, 64))
    values[0, 32] = np.nan
    basis = system.compiled[system.slot("G3")].basis
    vectors = np.ones((1, basis.n_modes, 2))
    with pytest.raises(NumericalError, match=r"^G3 is no longer finite at 0\.0006"):
        make(system).run(system.start(), 128, [Injection("G3", 0, vectors, values)])


def test_a_state_too_large_for_its_numbers_is_reported():
    """Forces of 1e300 N overflow: an error and no sound."""
    system = guitar()
    basis = system.compiled[system.slot("E2")].basis
    push = held_force(basis, "E2", "pluck", np.full(2000, 1e308), DT)
    with pytest.raises(NumericalError, match="no longer finite"):
        KernelStepper(system).run(system.start(), 4000, [push, push, push])
