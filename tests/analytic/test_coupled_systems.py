"""Coupled parts against second-order systems assembled in physical coordinates, and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from assembled import (
    Part,
    chain,
    connect,
    held_force,
    joined,
    merged,
    motion_readouts,
    poles_of,
    run_exact,
    step_map,
    uneven,
)
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper

PARTS = {"a": chain(3, seed=1), "b": chain(4, seed=2), "c": uneven(3, seed=5)}
GAPS = np.zeros((3, 10))
GAPS[0, [2, 3]] = GAPS[1, [6, 9]] = 1.0, -1.0
GAPS[2, [0, 7]] = 1.0, -0.5


def bases(parts):
    return {name: p.complex_basis() if name == "c" else p.real_basis() for name, p in parts.items()}


def coupled(gaps, dt, law=None):
    links = [connect(f"g{j}", PARTS, row, law) for j, row in enumerate(gaps)]
    return System.build(bases(PARTS), links, motion_readouts(PARTS), dt=dt)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_joined_chains_follow_the_exponential_of_the_assembled_system(joints, rng):
    """Displacements to 1e-9 at omega h < 0.05; velocities, of second order at the ends of a step, to 1e-4."""
    dt, steps = 2e-5, 1500
    gaps = GAPS[:joints]
    system = coupled(gaps, dt)
    force = np.repeat(rng.normal(size=steps // 50), 50)
    injection = held_force(system.compiled[1].basis, "b", "n2", force, dt)
    out, _ = KernelStepper(system).run(system.start(), steps, [injection])
    whole = merged(*PARTS.values())
    T, one = joined(whole, gaps)
    exact = run_exact(one, np.eye(10)[[5]] @ T, force[:, None], dt)[:-1]
    u, v = exact[:, : one.n] @ T.T, exact[:, one.n :] @ T.T
    assert np.abs(out[:, :10] - u).max() < 1e-9 * np.abs(u).max()
    assert np.abs(out[:, 10:] - v).max() < 1e-4 * np.abs(v).max()


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_poles_of_joined_chains(joints):
    dt = 2e-5
    gaps = GAPS[:joints]
    ours = poles_of(step_map(coupled(gaps, dt), KernelStepper), dt)
    _, one = joined(merged(*PARTS.values()), gaps)
    exact = sla.eigvals(one.state_matrices(np.zeros((0, one.n)))[0])
    exact = exact[exact.imag > 0]
    exact = exact[np.argsort(exact.imag)]
    assert ours.size == exact.size
    np.testing.assert_allclose(ours, exact, rtol=1e-9)


def test_stiff_spring_between_chains_is_that_of_the_assembled_system():
    """Springs act at the middle of a step: second order, and exact as the step shrinks."""
    k, r = 3e5, 20.0
    whole = merged(*PARTS.values())
    row = GAPS[:1]
    exact = sla.eigvals(
        Part(whole.M, whole.C + r * row.T @ row, whole.K + k * row.T @ row).state_matrices(np.zeros((0, 10)))[0]
    )
    exact = exact[exact.imag > 0]
    exact = exact[np.argsort(exact.imag)]
    for dt, tolerance in ((1e-4, 1e-3), (1e-5, 1e-5)):
        ours = poles_of(step_map(coupled(row, dt, SpringDashpot(k, r)), KernelStepper), dt)
        np.testing.assert_allclose(ours, exact, rtol=tolerance)


STRING = {"length": 0.65, "tension": 71.6, "linear_density": 6.24e-3, "bending_stiffness": 5.7e-5}


def guitar_string(n_modes, dt):
    """E2 of a classical guitar on a body of two modes, as System and as assembled second-order system."""
    basis = string_basis(**STRING, loss=lambda omega, k: np.full_like(omega, 4e-4), n_modes=n_modes)
    body_omega, body_sigma = 2 * np.pi * np.array([98.0, 205.0]), np.array([9.0, 12.0])
    shapes = np.array([2.1, 3.0])
    body = ModalBasis.real(body_omega, body_sigma, {"bridge": shapes})
    joint = Connection("joint", (Term("string", "bridge"), Term("body", "bridge", -1.0)))
    basis = basis.with_places({"pluck": 0.12})
    readouts = [Readout("bridge", "displacement", (Term("body", "bridge"),))]
    system = System.build({"string": basis, "body": body}, [joint], readouts, dt=dt)
    omega = np.concatenate([np.sqrt(basis.stiffness), body_omega])
    sigma = np.concatenate([basis.damping_rate, body_sigma])
    modal = Part(np.eye(omega.size), np.diag(2 * sigma), np.diag(omega**2))
    gap = np.concatenate([basis.right[0].real, -shapes])[None]
    pluck = np.concatenate([basis.right[1].real, [0.0, 0.0]])
    return system, modal, gap, pluck, shapes


def test_string_on_a_body_has_the_poles_of_the_assembled_system():
    """At 48 kHz the held force costs 1e-4 cent at 500 Hz and a hundredth of a cent at 5 kHz."""
    dt = 1 / 48000
    system, modal, gap, _, _ = guitar_string(60, dt)
    ours = poles_of(step_map(system, KernelStepper), dt)
    _, one = joined(modal, gap)
    exact = sla.eigvals(one.state_matrices(np.zeros((0, one.n)))[0])
    exact = exact[exact.imag > 0]
    exact = exact[np.argsort(exact.imag)]
    cents = 1200 * np.log2(ours.imag / exact.imag)
    freq = exact.imag / (2 * np.pi)
    assert np.abs(cents[freq < 500]).max() < 1.5e-4
    assert np.abs(cents[freq < 5100]).max() < 2e-2
    np.testing.assert_allclose(ours.real[freq < 500], exact.real[freq < 500], rtol=1e-6)


def test_plucked_string_moves_its_body_as_the_assembled_system_says():
    """The bridge's displacement after a pluck is that of the exponential, to 1e-9."""
    dt, steps = 1 / 192_000, 9600
    system, modal, gap, pluck, shapes = guitar_string(8, dt)
    force = np.zeros(steps)
    force[:480] = np.sin(np.linspace(0, np.pi, 480)) ** 2
    out, _ = KernelStepper(system).run(
        system.start(), steps, [held_force(system.compiled[0].basis, "string", "pluck", force, dt)]
    )
    T, one = joined(modal, gap)
    exact = run_exact(one, pluck[None] @ T, force[:, None], dt)[:-1]
    bridge = exact[:, : one.n] @ T[-2:].T @ shapes
    assert np.abs(out[:, 0] - bridge).max() < 1e-9 * np.abs(bridge).max()


def test_response_in_time_is_the_response_in_frequency():
    """Transfer function from a short smooth pulse against the inverse of the assembled dynamic stiffness."""
    dt, steps = 1e-4, 1 << 15
    parts = {"a": chain(3, seed=1, mass_damping=15.0), "b": chain(4, seed=2, mass_damping=15.0)}
    row = GAPS[0, :7]
    system = System.build(
        {n: p.real_basis() for n, p in parts.items()}, [connect("c", parts, row)], motion_readouts(parts), dt=dt
    )
    t = np.arange(81) * dt
    pulse = np.sin(np.pi * t / t[-1]) ** 4
    pieces = [
        Segment(t0, t1, f0, (f1 - f0) / dt) for t0, t1, f0, f1 in zip(t[:-1], t[1:], pulse[:-1], pulse[1:], strict=True)
    ]
    out, _ = KernelStepper(system).run(
        system.start(), steps, compile_force("a", system.compiled[0].basis, "n0", pieces, dt)
    )
    freq = np.fft.rfftfreq(steps, dt)
    band = (freq > 10) & (freq < 200)
    # spectrum of a piecewise linear force
    force = np.fft.rfft(np.pad(pulse, (0, steps - pulse.size)))[band] * np.sinc(freq[band] * dt) ** 2
    ours = np.fft.rfft(out[:, 6])[band] / force
    T, one = joined(merged(*parts.values()), [row])
    exact = np.array([T[6] @ one.receptance(f) @ T[0] for f in freq[band]])
    assert np.abs(out[-1, :7]).max() < 1e-7 * np.abs(out[:, :7]).max()
    assert np.abs(ours - exact).max() < 2e-5 * np.abs(exact).max()


def test_mobility_of_an_uncoupled_point_is_that_of_its_modes():
    """Held force: the exact discrete response is known for every frequency, sin(wh/2)/(wh/2) and all."""
    dt, steps = 1e-4, 1 << 16
    part = uneven(4, seed=2, zeta=0.05)
    basis = part.complex_basis()
    system = System.build({"a": basis}, [], [Readout("v", "velocity", (Term("a", "n3"),))], dt=dt)
    out, _ = KernelStepper(system).run(system.start(), steps, [held_force(basis, "a", "n0", [1.0], dt)])
    freq = np.fft.rfftfreq(steps, dt)[1:400]
    # sampled response to a rectangle of one step: poles summed as geometric series
    z = np.exp(2j * np.pi * freq * dt)
    r, lam = basis.right[3] * basis.left[0], basis.poles
    exact = sum(
        rk * (np.exp(p * dt) - 1) / (z - np.exp(p * dt))
        for rk, p in zip(np.concatenate([r, r.conj()]), np.concatenate([lam, lam.conj()]), strict=True)
    )
    ours = np.fft.rfft(out[:, 0])[1:400]
    assert np.abs(ours - exact).max() < 1e-9 * np.abs(exact).max()


def test_static_deflection_under_a_lasting_force():
    parts = {"a": chain(3, seed=1, mass_damping=60.0), "b": chain(4, seed=2, mass_damping=60.0)}
    row = np.array([[0, 0, 1.0, -1.0, 0, 0, 0]])
    system = System.build(
        {n: p.real_basis() for n, p in parts.items()}, [connect("c", parts, row[0])], motion_readouts(parts), dt=1e-3
    )
    steps = 1600
    injection = held_force(system.compiled[0].basis, "a", "n0", np.full(steps, 5.0), 1e-3)
    out, forces = KernelStepper(system).run(system.start(), steps, [injection])
    T, one = joined(merged(*parts.values()), row)
    expected = T @ sla.solve(one.K, 5.0 * T[0])
    np.testing.assert_allclose(out[-1, :7], expected, rtol=1e-9)
    # the joint carries the force by which the second chain resists
    np.testing.assert_allclose(-forces[-1, 0], (parts["b"].K @ expected[3:])[0], rtol=1e-9)


def test_truncated_parts_forced_apart_meet_with_their_whole_compliance():
    """A joint with an offset: folded modes still give way, so the lasting force is that of all modes."""
    parts = {"a": chain(5, seed=1, mass_damping=60.0), "b": chain(6, seed=2, mass_damping=60.0)}
    whole = {n: p.real_basis() for n, p in parts.items()}
    row = np.zeros(11)
    row[4], row[5] = 1.0, -1.0
    compliance = row @ sla.inv(merged(*parts.values()).K) @ row
    for kept in (5, 2, 1):
        few = {n: b.select(np.arange(min(kept, b.n_modes))) for n, b in whole.items()}
        system = System.build(few, [connect("c", parts, row, Rigid(1e-3))], dt=1e-3)
        _, forces = KernelStepper(system).run(system.start(), 2400)
        assert forces[-1, 0] == pytest.approx(1e-3 / compliance, rel=1e-8)


def test_free_bodies_in_collision_course_share_their_momentum():
    """Two free masses joined while one moves: the constraint force makes one body of them in one step."""
    m1, m2, v = 0.3, 0.5, 2.0
    mass = lambda m: ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=m)  # noqa: E731
    link = Connection("c", (Term("a", "p"), Term("b", "p", -1.0)))
    # a trace of residual compliance lets the joint's ringing die; the mean velocity is exact either way
    readouts = [Readout(n, "displacement", (Term(n, "p"),)) for n in "ab"]
    system = System.build({"a": mass(m1), "b": replace(mass(m2))}, [link], readouts, dt=1e-3)
    state = system.start()
    system.modes_of(state, "a")[1, 0] = v * np.sqrt(m1)  # mass-normalised: q' = sqrt(m) v
    out, _ = KernelStepper(system).run(state, 200)
    np.testing.assert_allclose(out[:, 0], out[:, 1], atol=1e-12)
    assert out[-1, 0] / (199e-3) == pytest.approx(m1 * v / (m1 + m2), rel=1e-2)
