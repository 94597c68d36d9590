"""Contacts and other laws on strings whose tension rises: the kernel against the NumPy stepper, and their limits."""

from __future__ import annotations

import numpy as np
import pytest
from nonlinear_scenes import drawn, modulated_guitar

from tonewood import _kernel
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact, Friction, HardeningSpring
from tonewood.physics.coupling.system import PrescribedMotion
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts
from tonewood.physics.stepping.stepper import NumpyStepper

ISAS = _kernel.instruction_sets()
SOFT = Contact(1e5, 1.0, loss=0.3, offset=-2e-4)
STIFF = Contact(1e10, 2.3, offset=-2e-4)
FAR = Contact(1e10, 2.3, offset=-5e-2)
EXTRA = {
    "rattle": Connection("rattle", (Term("s0a", "f2", -1.0), Term("s0b", "f2", 0.4)), Contact(1e6, 1.5, 0.1)),
    "to the body": Connection("touch", (Term("s1b", "f1", -1.0), Term("body", "b0")), Contact(1e6, 1.5)),
    "on a held point": Connection("stop", (Term("s0a", "pluck"),), Contact(1e8, 1.5, offset=-1e-4)),
    "spring": Connection("spring", (Term("s0b", "f3"), Term("body", "b1", 1.0)), HardeningSpring(2e3, 1e10, 0.2, 1.0)),
    "bow": Connection("bow", (Term("s1a", "f0"),), Friction(0.3, velocity=0.05)),
}


def same(ours, theirs, tolerance):
    assert np.all(np.isfinite(ours))
    np.testing.assert_array_less(np.abs(ours - theirs).max(axis=0), tolerance * np.abs(theirs).max(axis=0) + 1e-300)


def both(system, force, n, **options):
    """Kernel and twin over n steps from the same pluck."""
    a, b = drawn(system, force), drawn(system, force)
    stepper = KernelStepper(system, **options)
    expected, expected_forces = NumpyStepper(system).run(a, n)
    out, forces = stepper.run(b, n)
    assert stepper.statistics.failures == 0
    return (out, forces, b), (expected, expected_forces, a), stepper


@pytest.mark.parametrize(("force", "isa"), [(0.5, ISAS[0]), *((-5.0, isa) for isa in ISAS), (100.0, ISAS[0])])
def test_kernel_takes_the_steps_of_its_twin(force, isa):
    system = modulated_guitar(frets=SOFT)
    ours, theirs, stepper = both(system, force, 140, isa=isa)  # psi is put back twice
    same(ours[0], theirs[0], 1e-9)
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-9 * np.abs(theirs[1]).max())
    np.testing.assert_allclose(ours[2].series, theirs[2].series, atol=1e-9 * np.abs(theirs[2].series).max())
    kept = theirs[2].potentials
    np.testing.assert_allclose(ours[2].potentials, kept, rtol=1e-8, atol=1e-8 * kept.max())
    if abs(force) > 1:
        assert stepper.statistics.solves > 0
        assert np.abs(theirs[1][:, 4:]).max() > 0.01


@pytest.mark.parametrize("name", EXTRA)
def test_every_kind_of_connection_meets_rising_tension(name):
    ours, theirs, stepper = both(modulated_guitar(frets=STIFF, extra=[EXTRA[name]]), 5.0, 60)
    same(ours[0], theirs[0], 1e-9)
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-8 * np.abs(theirs[1]).max())
    assert np.abs(theirs[1][:, -1]).max() > 0
    assert stepper.statistics.solves > 0


@pytest.mark.validate
def test_thousands_of_steps_stay_together():
    ours, theirs, stepper = both(modulated_guitar(1, 30, frets=SOFT), 3.0, 3000)
    # each step finds its tension to 1e-11 of itself; 3000 of them have no smaller bound than their sum
    same(ours[0], theirs[0], 3000 * 1e-11)
    assert stepper.statistics.solves > 300


def test_some_strings_modulated_and_some_not():
    system = modulated_guitar(frets=SOFT, extra=[EXTRA["to the body"]]).with_potentials(["s0"])
    ours, theirs, _ = both(system, 5.0, 60)
    same(ours[0], theirs[0], 1e-9)
    np.testing.assert_allclose(ours[1], theirs[1], atol=1e-9 * np.abs(theirs[1]).max())


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("force", [0.3, 5.0])
def test_culled_contacts_change_no_bit(isa, force):
    system = modulated_guitar(frets=STIFF)
    results, states, read = [], [], []
    for culling in (True, False):
        state, stepper = (
            drawn(system, force),
            KernelStepper(system, isa=isa, shortcuts=Shortcuts(block_culling=culling)),
        )
        results.append([stepper.run(state, n) for n in (64, 300, 100, 336)])
        states.append(state)
        read.append(stepper.culling_statistics["added"])
        assert stepper.statistics.failures == 0
    for (out, forces), (expected, expected_forces) in zip(*results, strict=True):
        np.testing.assert_array_equal(out, expected)
        np.testing.assert_array_equal(forces, expected_forces)
    np.testing.assert_array_equal(states[0].modes, states[1].modes)
    np.testing.assert_array_equal(states[0].series, states[1].series)
    assert read[1] == 0


def test_contacts_that_are_never_touched_change_no_bit():
    alone, with_frets = modulated_guitar(), modulated_guitar(frets=FAR)
    a, b = drawn(alone, 20.0), drawn(with_frets, 20.0)
    stepper = KernelStepper(with_frets)
    expected, _ = KernelStepper(alone).run(a, 480)
    out, _ = stepper.run(b, 480)
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(b.modes, a.modes)
    np.testing.assert_array_equal(b.potentials, a.potentials)
    assert stepper.statistics.solves == 0


def test_without_axial_stiffness_only_the_contacts_are_left():
    modulated, plain = modulated_guitar(axial_stiffness=0.0, frets=SOFT), modulated_guitar(on=False, frets=SOFT)
    a, b = drawn(modulated, 5.0), drawn(plain, 5.0)
    stepper = KernelStepper(modulated)
    out, forces = stepper.run(a, 400)
    expected, expected_forces = KernelStepper(plain).run(b, 400)
    same(out, expected, 1e-9)
    np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
    assert stepper.statistics.solves > 0
    assert not a.potentials.reshape(-1, 3)[:, :2].any()


@pytest.mark.parametrize("law", [SOFT, STIFF, Contact(1e15, 2.3, offset=-2e-4)], ids=["soft", "stiff", "stiffest"])
@pytest.mark.parametrize("force", [5.0, 100.0])
def test_energy_never_rises(law, force):
    system = modulated_guitar(frets=law, extra=[EXTRA["to the body"]])
    state, stepper = drawn(system, force), KernelStepper(system)
    energy = [stored_energy(system, state).total]
    for _ in range(300):
        stepper.run(state, 1)
        energy.append(stored_energy(system, state).total)
    assert np.max(np.diff(energy)) <= 1e-10 * energy[0]
    assert energy[-1] < energy[0]
    assert stepper.statistics.failures == 0
    assert stepper.statistics.solves > 0


def test_runs_cut_into_whole_windows_go_on_where_they_stopped():
    system = modulated_guitar(frets=STIFF)
    a, b = drawn(system, 5.0), drawn(system, 5.0)
    one, many = KernelStepper(system), KernelStepper(system)
    expected, _ = one.run(a, 320)
    out = np.concatenate([many.run(b, n)[0] for n in (64, 128, 128)])
    np.testing.assert_array_equal(out, expected)


def test_a_moving_partner_meets_a_modulated_string():
    system = modulated_guitar(frets=SOFT)
    n = 60
    ramp = PrescribedMotion("s0f3", 5, offset=-2e-4 + np.linspace(0, 4e-4, n + 1), scale=np.linspace(0.0, 1.0, n))
    a, b = drawn(system, 1.0), drawn(system, 1.0)
    expected, expected_forces = NumpyStepper(system).run(a, n + 20, (), [ramp])
    out, forces = KernelStepper(system).run(b, n + 20, (), [ramp])
    same(out, expected, 1e-9)
    np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
    assert np.abs(forces[:, [c.name for c in system.connections].index("s0f3")]).max() > 1e-3
