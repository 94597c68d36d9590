"""Energy over very many steps: kept without losses, never rising with them, whatever the modes.

Each test says what it asserts about energy; all assert that states stay finite, which energies being numbers is.
"""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from scenes import displaced, energies, guitar

from assembled import Part, held_force, poles_of, step_map
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper

DT = 1 / 48000


@pytest.mark.slow
@pytest.mark.parametrize(("law", "residual"), [(Rigid(), 0.0), (Rigid(), 2e-9), (SpringDashpot(2e4), 0.0)], ids=str)
def test_a_million_undamped_steps_keep_the_energy(law, residual):
    """Energy drifts by less than 1e-9; rigid joints are still closed."""
    system = guitar(eta=0.0, zeta=0.0, residual=residual, law=law)
    state = displaced(system, velocities=True)
    E = energies(system, state, 20, 50_000)
    assert np.abs(E / E[0] - 1).max() < 1e-9
    gaps = KernelStepper(system).run(state, 1)[0][0, 1:]
    if law == Rigid() and residual == 0.0:
        assert np.abs(gaps).max() < 1e-12


@pytest.mark.validate
def test_ten_million_undamped_steps_keep_the_energy():
    """Energy drifts by less than 1e-9 per million steps."""
    system = guitar(eta=0.0, zeta=0.0)
    state = displaced(system, velocities=True)
    E = energies(system, state, 40, 250_000)
    assert np.all(np.abs(E / E[0] - 1) < 1e-9 * np.maximum(np.arange(41) * 0.25, 1))


@pytest.mark.parametrize("fs", [8000, 48000, 192000])
def test_damped_energy_never_rises(fs):
    """Seen every 400 steps."""
    system = guitar(fs)
    E = energies(system, displaced(system, velocities=True), 200, 400)
    assert np.all(np.diff(E) <= 1e-13 * E[0])
    assert E[-1] < 0.8 * E[0]


ZETAS = (0.0, 1e-6, 1e-2, 0.69, 0.71, 0.999999, 1.0, 1.000001, 3.0, 10.0)
TURNS = (0.0, 1e-6, 1e-2, 1.0, np.pi * 0.9, np.pi, 3.3, 2 * np.pi, 40.0, 1e3)


def zoo(law):
    """Modes of every damping at every speed, up to omega h = 1000, in two components that hold on to each other."""
    rng = np.random.default_rng(2)
    omega, zeta = (a.ravel() / d for a, d in zip(np.meshgrid(TURNS, ZETAS), (DT, 1.0), strict=True))
    sigma = np.where(omega == 0, zeta * 100.0, zeta * omega)
    shapes = rng.normal(size=(3, omega.size))
    half = np.arange(omega.size) % 2 == 0
    bases = {
        name: ModalBasis.real(omega[which], sigma[which], {f"p{i}": s[which] for i, s in enumerate(shapes)})
        for name, which in (("a", half), ("b", ~half))
    }
    links = [Connection(f"c{i}", (Term("a", f"p{i}"), Term("b", f"p{i}", -0.7)), law) for i in range(2)]
    readouts = [Readout("v", "velocity", (Term("a", "p2"),))]
    return System.build(bases, links, readouts, dt=DT)


@pytest.mark.parametrize(
    "law",
    [Rigid(), SpringDashpot(1e3), SpringDashpot(1e15), SpringDashpot(0.0, 1e-3), SpringDashpot(1e8, 1e8)],
    ids=str,
)
def test_modes_of_every_speed_and_damping_together(law):
    """Rigid bodies, zeta from 0 to 10, omega h from 1e-6 through Nyquist to 1000: energy never rises."""
    system = zoo(law)
    state = system.start()
    rng = np.random.default_rng(3)
    for name in system.names:
        system.modes_of(state, name)[:] = rng.normal(size=system.modes_of(state, name).shape) * 1e-6
    KernelStepper(system).run(state, 2)  # a rigid joint first closes its gap
    E = energies(system, state, 60, 1)
    E = np.concatenate([E, energies(system, state, 20, 5000)])
    assert np.all(np.isfinite(E))
    assert np.all(np.diff(E) <= 1e-11 * E[0])


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("zeta", ZETAS)
def test_each_of_them_alone_on_a_stiff_spring(turn, zeta):
    """One mode and a spring of a million times its stiffness: energy never rises, at any step."""
    omega = turn / DT
    sigma = zeta * omega if turn else zeta * 100.0
    basis = ModalBasis.real([omega], [sigma], {"p": [1.0]})
    spring = Connection("k", (Term("a", "p"),), SpringDashpot(1e6 * max(omega, 1.0) ** 2))
    system = System.build({"a": basis}, [spring], dt=DT)
    state = system.start()
    system.modes_of(state, "a")[:] = np.array([[1e-3], [0.5]])
    E = energies(system, state, 40, 1)
    assert np.all(np.diff(E) <= 1e-12 * E[0])


def test_modes_above_nyquist_that_were_not_left_out():
    """They alias, but cannot create energy: undamped, it is kept to 1e-10 in 100 000 steps."""
    system = guitar(8000, share=2.5, eta=0.0, zeta=0.0)
    assert system.compiled[1].basis.natural_freq[-1] > 2 * 8000
    E = energies(system, displaced(system, velocities=True), 20, 5000)
    assert np.abs(E / E[0] - 1).max() < 1e-10


@pytest.mark.parametrize("ratio", [1e-12, 1e-6, 1e6, 1e12])
@pytest.mark.parametrize(
    "law", [Rigid(), SpringDashpot(1e9), SpringDashpot(0.0, 10.0)], ids=["rigid", "spring", "dashpot"]
)
def test_masses_of_very_unequal_size(ratio, law):
    """Undamped parts a million million times heavier than each other: energy is kept, or falls by the dashpot."""
    k = np.arange(1, 31)
    light = ModalBasis.real(2 * np.pi * 110 * k, np.zeros(30), {"p": np.sin(k)}, modal_mass=1e-3)
    heavy = ModalBasis.real(2 * np.pi * 77.7 * k, np.zeros(30), {"p": np.cos(k)}, modal_mass=1e-3 * ratio)
    joint = Connection("c", (Term("a", "p"), Term("b", "p", -1.0)), law)
    system = System.build({"a": light, "b": heavy}, [joint], dt=DT)
    state = system.start()
    system.modes_of(state, "a")[0, 5] = 1e-4
    system.modes_of(state, "a")[0, 6] = -1e-4 * np.sin(6) / np.sin(7)  # the joint starts closed
    E = energies(system, state, 20, 2000)
    if isinstance(law, SpringDashpot) and law.damping > 0:
        assert np.all(np.diff(E) <= 1e-12 * E[0])
    else:
        assert np.abs(E / E[0] - 1).max() < 1e-9


def test_a_string_partial_exactly_on_a_body_mode():
    """Wolf: undamped energy goes to the other part and back, nearly all of it, and its sum is kept."""
    omega, m_string, m_body, k = 2 * np.pi * 196.0, 4e-4, 0.5, 40.0
    string = ModalBasis.real(omega * np.arange(1, 21), np.zeros(20), {"p": np.ones(20)}, modal_mass=m_string)
    # each part with the spring's other end held: the string's lowest frequency so, and the wood tuned to it
    held = sla.eigvalsh(np.diag((omega * np.arange(1, 21)) ** 2) + np.full((20, 20), k / m_string))[0]
    tuned = np.sqrt(held - k / m_body)
    wood = ModalBasis.real([tuned], [0.0], {"p": [1.0]}, modal_mass=m_body)
    spring = Connection("c", (Term("string", "p"), Term("wood", "p", -1.0)), SpringDashpot(k))
    system = System.build({"string": string, "wood": wood}, [spring], dt=DT)
    state = system.start()
    state.modes[0, 0] = 1e-3
    account, stepper = EnergyAccount(system, state), KernelStepper(system)
    total, in_wood = [], []
    for _ in range(300):
        stepper.run(state, 480)
        stored = account.stored(state)
        total.append(sum(stored.values()))
        in_wood.append(stored["wood"] / total[-1])
    assert np.abs(np.array(total) / total[0] - 1).max() < 1e-10
    there = int(np.argmax(in_wood))
    assert in_wood[there] > 0.8
    assert min(in_wood[there:]) < 0.05
    # half a beat of the two coupled modes, k / (omega sqrt(m m')) apart
    beat = k / np.sqrt(held * m_string * m_body)
    assert (there + 1) * 0.01 == pytest.approx(np.pi / beat, rel=0.05)


@pytest.mark.parametrize("mistuning_cents", [0.0, 1e-9, 1e-3, 0.5])
def test_two_unison_strings_on_one_bridge(mistuning_cents):
    """Weinreich's pair, undamped but for the bridge: poles are those of the assembled system, coincident or not."""
    k = np.arange(1, 16)
    omega = 2 * np.pi * 220.0 * k
    strings = {
        name: ModalBasis.real(omega * factor, np.zeros(15), {"n0": np.full(15, 18.0)})
        for name, factor in (("a", 1.0), ("b", 2.0 ** (mistuning_cents / 1200)))
    }
    bridge = ModalBasis.real([2 * np.pi * 340.0], [60.0], {"n0": [1.3]})
    links = [Connection(n, (Term(n, "n0"), Term("bridge", "n0", -1.0)), SpringDashpot(2e5)) for n in strings]
    dt = 1 / 192000
    system = System.build(strings | {"bridge": bridge}, links, dt=dt)
    ours = poles_of(step_map(system, KernelStepper), dt)
    modal = np.concatenate([omega, omega * 2.0 ** (mistuning_cents / 1200), [2 * np.pi * 340.0]])
    rows = np.zeros((2, 31))
    rows[0, :15], rows[1, 15:30], rows[:, 30] = 18.0, 18.0, -1.3
    K = np.diag(modal**2) + 2e5 * rows.T @ rows
    C = np.zeros((31, 31))
    C[30, 30] = 120.0
    exact = sla.eigvals(Part(np.eye(31), C, K).state_matrices(rows)[0])
    exact = exact[exact.imag > 0]
    exact = exact[np.argsort(exact.imag)]
    low = exact.imag < 2 * np.pi * 3000
    assert ours.size == exact.size
    np.testing.assert_allclose(ours.imag[low], exact.imag[low], rtol=2e-3)
    # of each coincident pair one mode moves against the other string and is not damped at all
    still = np.sort(-ours.real[low])[: np.count_nonzero(low) // 2 - 1]
    if mistuning_cents < 1e-6:
        assert np.abs(still).max() < 1e-6
    assert np.all(ours.real < 1e-6)


def test_forces_of_any_size_scale_the_motion_and_nothing_else():
    """1 mN to 1 kN of a linear instrument: bit for bit the same up to the factor, here a power of two."""
    system = guitar()
    basis = system.compiled[system.slot("G3")].basis
    ramp = np.linspace(0, 1, 480)
    out = {}
    for size in (2.0**-10, 1.0, 2.0**10):
        stepper = KernelStepper(system)
        out[size] = stepper.run(stepper.start(), 4800, [held_force(basis, "G3", "pluck", size * ramp, DT)])[0]
    for size, motion in out.items():
        assert np.array_equal(motion, size * out[1.0])
