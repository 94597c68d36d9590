"""Compiled forces against the matrix exponential, breakpoints anywhere."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given
from hypothesis import strategies as st

from assembled import chain, uneven
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import SampledForce, Segment, compile_force
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1e-3
STEPS = 40


def exact(part, row, pieces, dt, steps, time=0.0):
    """Displacements at t_n: the augmented system's exponential from breakpoint to breakpoint."""
    A, B = part.state_matrices([row])
    n = len(A)
    big = np.zeros((n + 3, n + 3))
    big[:n, :n], big[:n, n : n + 1] = A, B
    big[n, n + 1] = big[n + 1, n + 2] = 1.0
    ends = {time + t for p in pieces for t in (p.start, p.stop)}
    times = sorted({*(k * dt for k in range(steps)), *(t for t in ends if 0 < t < (steps - 1) * dt)})
    x, out = np.zeros(n), {times[0]: np.zeros(n)}
    for t0, t1 in pairwise(times):
        middle = (t0 + t1) / 2 - time
        force = next((p for p in pieces if p.start <= middle < p.stop), None)
        c0, c1, c2 = force.shifted(t0 - time - force.start) if force else (0.0, 0.0, 0.0)
        x = (sla.expm(big * (t1 - t0)) @ np.concatenate([x, [c0, c1, 2 * c2]]))[:n]
        out[t1] = x
    return np.array([out[k * dt][: part.n] for k in range(steps)])


def compiled(basis, pieces, dt=DT, steps=STEPS, **options):
    readouts = [Readout(p, "displacement", (Term("a", p),)) for p in basis.points]
    system = System.build({"a": basis}, [], readouts, dt=dt)
    return NumpyStepper(system).run(system.start(), steps, compile_force("a", basis, "n0", pieces, dt, **options))[0]


RAMP = [Segment(0.0, 9.3e-3, 0.0, 250.0), Segment(9.3e-3, 9.7e-3, 2.325, -2.325 / 4e-4)]
PULSE = [Segment(0.0, 1.1e-3, 0.0, 4000.0, -4000.0 / 1.1e-3)]
SHAPES = {
    "ramp and release": (RAMP, 2.25e-3),
    "parabola from step to step": ([Segment(0.0, 5e-3, 1.0, -200.0, 4e4)], 3e-3),
    "two breaks in one step": ([Segment(0.0, 1e-4, 1.0), Segment(1e-4, 3e-4, -2.0, 1e4)], 4.5e-3),
    "pulse": (PULSE, 7.77e-3),
    "gap between pieces": ([Segment(0.0, 2.5e-3, 1.0), Segment(4.2e-3, 6e-3, 2.0, 10.0)], 1e-3),
}


@pytest.mark.parametrize("make", ["real", "complex"])
@pytest.mark.parametrize(("pieces", "time"), SHAPES.values(), ids=SHAPES)
def test_force_is_exact_whatever_its_breakpoints(pieces, time, make):
    part = chain(4, seed=3) if make == "real" else uneven(4, seed=3, zeta=0.2)
    basis = part.real_basis() if make == "real" else part.complex_basis()
    expected = exact(part, np.eye(4)[0], pieces, DT, STEPS, time)
    np.testing.assert_allclose(compiled(basis, pieces, time=time), expected, atol=1e-11 * np.abs(expected).max())


@given(
    breaks=st.lists(st.floats(0.0, 20e-3), min_size=2, max_size=5, unique=True).map(sorted),
    numbers=st.lists(st.floats(-1, 1), min_size=12, max_size=12),
    time=st.floats(0, 10e-3),
)
def test_random_piecewise_quadratic_forces_are_exact(breaks, numbers, time):
    part = chain(3, seed=5)
    pieces = [
        Segment(a, b, numbers[3 * i], numbers[3 * i + 1] / DT, numbers[3 * i + 2] / DT**2)
        for i, (a, b) in enumerate(pairwise(breaks))
    ]
    expected = exact(part, np.eye(3)[0], pieces, DT, STEPS, time)
    scale = np.abs(expected).max() + 1e-6  # forces of 1 N move this chain some 1e-5 m
    np.testing.assert_allclose(compiled(part.real_basis(), pieces, time=time), expected, atol=1e-10 * scale)


def test_a_jump_within_a_step_is_seen_at_its_own_time():
    """Free mass: after a force that starts at t0 it has moved by F (t - t0)^2 / 2 m."""
    basis = ModalBasis.real([0.0], [0.0], {"n0": [1.0]}, modal_mass=2.0)
    out = compiled(basis, [Segment(0.0, 1.0, 3.0)], time=4.321e-3)[:, 0]
    t = np.maximum(np.arange(STEPS) * DT - 4.321e-3, 0.0)
    np.testing.assert_allclose(out, 3.0 / 2.0 * t**2 / 2, rtol=1e-12, atol=1e-20)


def test_what_lies_before_the_first_step_is_left_out():
    basis = chain(2, seed=1).real_basis()
    whole = compile_force("a", basis, "n0", RAMP, DT)
    late = compile_force("a", basis, "n0", RAMP, DT, first=5)
    assert min(i.start for i in late) == 5
    assert min(i.start for i in whole) == 0
    kept = {(i.start, i.values.shape) for i in late}
    assert kept <= {(i.start, i.values.shape) for i in whole} | {(5, (i.values.shape[0], 4)) for i in whole}


def test_factor_multiplies_the_force():
    basis = chain(2, seed=1).real_basis()
    np.testing.assert_allclose(compiled(basis, RAMP, factor=-0.3), -0.3 * compiled(basis, RAMP), rtol=1e-12)


def test_empty_and_reversed_pieces_do_nothing():
    basis = chain(2, seed=1).real_basis()
    assert compile_force("a", basis, "n0", [Segment(1e-3, 1e-3, 5.0), Segment(3e-3, 2e-3, 1.0)], DT) == []


def test_shifted_coefficients_are_the_same_parabola():
    piece = Segment(0.0, 1.0, 1.0, -2.0, 3.0)
    c0, c1, c2 = piece.shifted(0.25)
    for t in (0.0, 0.1, 0.6):
        assert c0 + c1 * t + c2 * t**2 == pytest.approx(1 - 2 * (t + 0.25) + 3 * (t + 0.25) ** 2)


def test_a_sampled_force_is_straight_between_its_values():
    force = SampledForce(2e-3, 1e-3, np.array([0.0, 3.0, -1.0, 0.0]))
    assert force.stop == pytest.approx(5e-3)
    t = np.array([1e-3, 2e-3, 2.25e-3, 3e-3, 3.5e-3, 4.75e-3, 5.5e-3])
    np.testing.assert_allclose(force.at(t), [0.0, 0.0, 0.75, 3.0, 1.0, -0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(force.rate(t + 1e-9), [0.0, 3e3, 3e3, -4e3, -4e3, 1e3, 0.0], atol=1e-6)
    # each step has the value in its middle
    by_step = force.by_step(7, 5, DT, time=1e-3)
    np.testing.assert_allclose(by_step, force.at((np.arange(7, 12) + 0.5) * DT - 1e-3))
    known = force.course(DT, time=1e-3, first=0)
    k = np.arange(known.start, known.start + known.values.shape[1])
    assert k[0] * DT <= 3e-3 < (k[0] + 1.5) * DT
    assert (k[-1] + 1) * DT >= 6e-3 > (k[-1] - 0.5) * DT
    np.testing.assert_allclose(known.values[0], force.at((k + 0.5) * DT - 1e-3), atol=1e-12)
    assert not known.values[1:].any()
    rest = force.after(3.2e-3)
    late = np.linspace(4e-3, 6e-3, 21)
    np.testing.assert_allclose(rest.at(late), force.at(late), atol=1e-12)
    assert rest.start == pytest.approx(4e-3)
    assert len(force.after(1.0).values) == 2


def test_the_rate_of_a_sampled_force_is_that_of_its_lines() -> None:
    """From the right where two lines meet, 0 outside."""
    force = SampledForce(2e-3, 1e-3, np.array([0.0, 3.0, -1.0, 0.0]))
    times = [0.0, 1.9e-3, 2.1e-3, 2.9e-3, 3.1e-3, 4.5e-3, 4.9e-3, 5.1e-3, 9.0]
    np.testing.assert_allclose(force.rate(times), [0.0, 0.0, 3e3, 3e3, -4e3, 1e3, 1e3, 0.0, 0.0])


@pytest.mark.parametrize("span", [(-1.0, -0.5), (-0.3, 0.2), (0.31, 0.34), (0.9, 1.5), (1.1, 2.0), (0.0, 0.0)])
def test_a_part_of_a_sampled_force_is_that_of_the_whole(span):
    """To the last bit, by the lines and slopes of all values."""
    values = np.random.default_rng(4).normal(size=101)
    force, times = SampledForce(0.013, 0.01, values), np.linspace(*span, 9)
    grid = 0.013 + 0.01 * np.arange(101)
    np.testing.assert_array_equal(force.at(times), np.interp(times, grid, values, left=0.0, right=0.0))
    place = np.floor((times - 0.013) / 0.01).astype(int)
    slopes = [(values[k + 1] - values[k]) / 0.01 if 0 <= k < 100 else 0.0 for k in place]
    np.testing.assert_array_equal(force.rate(times), slopes)
    assert force.at([]).shape == (0,)


def test_breakpoints_that_lie_near_are_injected_few_at_a_time():
    """One table of all steps with breakpoints would have 2001 x 8001 numbers, most of them 0."""
    basis = ModalBasis.real([0.0], [0.0], {"n0": [1.0]})
    pieces = [Segment(k * 4 * DT, (k + 1) * 4 * DT, 1.0 + k) for k in np.arange(2000) + 0.125]
    out = compile_force("a", basis, "n0", pieces, DT)
    assert sum(i.values.size for i in out) < 1e6
    momentum = sum(np.einsum("vt,vmx->x", i.values, i.vectors) for i in out)[1]
    assert momentum * basis.right[0, 0].real == pytest.approx(sum(p.c0 * 4 * DT for p in pieces), rel=1e-9)
