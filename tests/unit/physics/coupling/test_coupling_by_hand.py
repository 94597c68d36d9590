"""Numbers of laws, eliminations, compiled components and potentials, each against its formula written out here."""

from __future__ import annotations

import ctypes
import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.errors import TonewoodError
from tonewood.physics.coupling.compiled import _pivots
from tonewood.physics.coupling.connections import (
    Connection,
    LinearLaws,
    NonlinearGaps,
    NonlinearLaws,
    NonlinearSolve,
    Rigid,
    SpringDashpot,
    Term,
)
from tonewood.physics.coupling.inverse import Hub, scaled_pinv
from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.laws.base import LawArrays
from tonewood.physics.coupling.laws.friction import FrictionBranch, solve_branches
from tonewood.physics.coupling.potentials.base import JoinedPotential, MiddleOfStep
from tonewood.physics.coupling.potentials.coordinates import ModalCoordinates, middle_of_step, pay_from_motion
from tonewood.physics.coupling.potentials.longitudinal import GeometricShare, GeometricShares
from tonewood.physics.coupling.potentials.phantom import DELAY, MOST_MODES, PhantomShare, PhantomShares, steps_of
from tonewood.physics.coupling.potentials.switched import Potentials
from tonewood.physics.coupling.potentials.tension import JoinedTension, TensionModulation, TensionShare
from tonewood.physics.coupling.potentials.user import ModalPotential, PotentialEnergy
from tonewood.physics.coupling.system import Drive, Injection, PrescribedMotion, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply, flow

DT = 1e-4
DOUBLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
LINES = SampledPotential.from_force([-2e-3, -1e-3, 0.0, 1e-3], [50.0, 10.0, 0.0, 0.0], loss=0.2, damping=0.3)
CUBIC = SampledPotential(np.array([0.0, 1e-3]), np.array([[2.0, -3.0, 4e3, 5e6]]), offset=1e-4)
COMPILED = CompiledPotential(
    DOUBLE(lambda d: 500 * d**2 + 1e8 * d**4), DOUBLE(lambda d: 1e3 * d + 4e8 * d**3), 0.1, 0.3
)
LAWS = {
    "contact": Contact(1e7, 1.7, loss=0.4),
    "linear contact": Contact(1e5),
    "spring": HardeningSpring(3e3, 7e8, 0.3, 2.0),
    "lines": LINES,
    "cubic": CUBIC,
    "compiled": replace(COMPILED, loss=0.0),
    "exponential": CompiledPotential(
        DOUBLE(lambda d: 0.1 * math.exp(-d / 1e-3)), DOUBLE(lambda d: -100.0 * math.exp(-d / 1e-3)), 0.2, 5.0
    ),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize(
    ("new", "old"),
    [(1.2e-3, 3e-4), (3e-4, 1.2e-3), (2e-4, -4e-4), (-5e-4, 6e-4), (1.6e-3, -3e-3), (7e-4, 7.001e-4), (8e-4, 8e-4)],
)
def test_slope_of_a_force_is_its_derivative(name, new, old):
    law, reach = LAWS[name], 2e-8
    rise = (law.force(new + reach, old, DT)[0] - law.force(new - reach, old, DT)[0]) / (2 * reach)
    assert law.force(new, old, DT)[1] == pytest.approx(rise, rel=2e-3, abs=1e-9)


def test_energies_and_forces_at_rest_of_the_laws():
    """Compression 0.5 mm, held; dashpots and losses do nothing at rest."""
    p, d = 5e-4, -5e-4
    expected = {
        "contact": (1e7 / 2.7 * p**2.7, 1e7 * p**1.7),
        "linear contact": (0.5e5 * p**2, 1e5 * p),
        "spring": (1.5e3 * p**2 + 1.75e8 * p**4, 3e3 * p + 7e8 * p**3),
        # -V' is 5 N at -0.5 mm; V counts from -2 mm, where the force has done 0.03 + 0.00375 J less
        "lines": (-(0.5 * 60 * 1e-3 + 0.5 * (10 + 5) * 5e-4), 5.0),
        "cubic": (2.0 - 3.0 * d + 4e3 * d**2, 3.0 - 8e3 * d),  # left of the samples a straight line of force
        "compiled": (500 * p**2 + 1e8 * p**4, 1e3 * p + 4e8 * p**3),
        "exponential": (0.1 * np.exp(0.5), 100.0 * np.exp(0.5)),
    }
    for name, law in LAWS.items():
        force = law.force(p, p, DT)[0]
        assert (law.energy(p), force) == (pytest.approx(expected[name][0]), pytest.approx(expected[name][1])), name
    right = 5e-4  # beyond the last sample, at 1.5 mm
    slope, bend = -3.0 + 8e3 * 1e-3 + 15e6 * 1e-6, 8e3 + 30e6 * 1e-3
    at_end = 2.0 - 3e-3 + 4e3 * 1e-6 + 5e6 * 1e-9
    assert CUBIC.energy(-1.5e-3) == pytest.approx(at_end + slope * right + 0.5 * bend * right**2)
    assert CUBIC.force(-1.5e-3, -1.5e-3, DT)[0] == pytest.approx(-(slope + bend * right))
    assert CUBIC.force(-1e-3, -1e-3, DT) == (pytest.approx(-slope), pytest.approx(0.5 * bend))


def test_loss_and_dashpots_see_the_mean_rate():
    new, old = 9e-4, 5e-4
    rate, p2 = (new - old) / DT, new**2 + old**2
    gradient = (0.5 * 3e3 + 0.25 * 7e8 * p2) * (new + old)
    assert LAWS["spring"].force(new, old, DT)[0] == pytest.approx(gradient + 0.3 * rate + 2.0 * rate**2)
    assert LAWS["spring"].force(old, new, DT)[0] == pytest.approx(gradient - 0.3 * rate - 2.0 * rate**2)
    work = 1e7 / 2.7 * (new**2.7 - old**2.7) / (new - old)
    assert LAWS["contact"].force(new, old, DT)[0] == pytest.approx(work * (1 + 0.4 * rate))
    lines = 10 * 0.5 * (0.9 + 0.5)  # -V' rises from 5 to 9 N
    assert LINES.force(new, old, DT)[0] == pytest.approx(lines * (1 + 0.2 * rate) + 0.3 * rate)
    compiled = (500 + 1e8 * p2) * (new + old)
    assert COMPILED.force(new, old, DT)[0] == pytest.approx(compiled * (1 + 0.1 * rate) + 0.3 * rate)


def test_laws_without_further_arguments():
    """A contact is linear without loss from zero on; a spring is none; friction falls from 0.8 to 0.3, half at 0.1."""
    assert (Contact(2e4).force(1e-3, 5e-4, DT)[0], Contact(2e4).offset, Contact(2e4).residual) == (15.0, 0.0, True)
    assert HardeningSpring().force(2e-3, -1e-3, DT) == (0.0, 0.0)
    assert (HardeningSpring().offset, HardeningSpring().residual, LINES.residual, COMPILED.residual) == (0, 1, 1, 1)
    assert (LINES.offset, COMPILED.offset, Rigid().offset, Friction(1.0).offset) == (0.0, 0.0, 0.0, 0.0)
    friction = Friction(1.0)
    assert (friction.velocity, friction.residual, friction.one_sided) == (0.0, False, False)
    assert [law.one_sided for law in LAWS.values()] == [True, True, *[False] * 5]
    assert friction.velocity_after(0.79, 1.0, 0.0) == 0.0
    slip = friction.velocity_after(-0.81, 1.0, 0.0)
    assert slip - (0.3 + 0.5 / (1 - slip / 0.1)) == pytest.approx(-0.81)
    for v, mu in ((0.1, 0.55), (0.3, 0.425), (9.9, 0.305)):
        assert friction.slide(v + 0.05 * mu, 0.05) == pytest.approx(v)
    assert SpringDashpot() == SpringDashpot(0.0, 0.0, 0.0)
    assert Connection("c", ()).law == Rigid(0.0)
    assert Term("a", "p").factor == 1.0
    assert Drive("m", "p", "c").factor == 1.0


def test_numbers_for_the_kernel():
    assert Contact(3.0, 1.5, 0.2).describe() == LawArrays(0, (3.0, 1.5, 0.0, 0.0), 0.2)
    assert HardeningSpring(3.0, 4.0, 0.5, 0.6).describe() == LawArrays(1, (3.0, 4.0, 0.6, 0.0), 0.0, 0.5)
    samples = ([-2e-3, -1e-3, 0.0, 1e-3], LINES.coefficients.ravel().tolist())
    assert LINES.describe() == LawArrays(2, loss=0.2, damping=0.3, samples=samples)
    functions = tuple((f.address, 0, False) for f in (COMPILED.potential, COMPILED.slope))
    assert COMPILED.describe() == LawArrays(3, loss=0.1, damping=0.3, functions=functions)
    assert Friction(5.0, 0.9, 0.4, 0.2).describe() == LawArrays(4, (5.0, 0.9, 0.4, 0.2))


@pytest.mark.parametrize(
    ("make", "least", "below"),
    [
        (Contact, (0.0, 1.0, 0.0), (-1e-3, 0.999, -1e-3)),
        (HardeningSpring, (0.0, 0.0, 0.0, 0.0), (-1e-3,) * 4),
        (SpringDashpot, (0.0, 0.0), (-1e-3,) * 2),
        (Friction, (0.0, 0.3, 0.3, 1e-9), (-1e-3, 0.299, 0.301, 0.0)),
        (Friction, (0.0, 0.0, 0.0, 1e-9), (np.nan, np.nan, -1e-3, np.nan)),
    ],
)
def test_each_number_of_a_law_has_its_least(make, least, below):
    make(*least)
    for i, low in enumerate(below):
        with pytest.raises(ValueError, match=r"must not|needs"):
            make(*least[:i], low, *least[i + 1 :])


@pytest.mark.parametrize(
    ("knots", "coefficients", "options"),
    [
        ([0.0], np.zeros((0, 4)), {}),
        ([0.0, 1.0], np.zeros((2, 4)), {}),
        ([0.0, 0.0], np.zeros((1, 4)), {}),
        ([0.0, 1.0], [[0.0, 0.0, -1.0, 0.0]], {}),
        ([0.0, 1.0], [[0.0, 0.0, 1.0, -0.4]], {}),  # V'' falls from 2 to -0.4
        ([0.0, 1.0, 2.0], [[0.0, 0.0, 0.5, 0.0], [0.5, 0.9, 0.5, 0.0]], {}),  # V' falls from 1 to 0.9
        ([0.0, 1.0], [[0.0, -1.0, 0.5, 0.0]], {"loss": -1.0}),
        ([0.0, 1.0], [[0.0, -1.0, 0.5, 0.0]], {"damping": -1.0}),
        ([0.0, 1.0], [[0.0, -1.0, 0.51, 0.0]], {"loss": 1.0}),  # it pulls at the end
    ],
)
def test_samples_that_make_no_potential_are_refused(knots, coefficients, options):
    with pytest.raises(ValueError, match=r"needs two|convex|negative|one way"):
        SampledPotential(np.array(knots), np.array(coefficients), **options)
    SampledPotential(np.array([0.0, 1.0]), np.array([[0.0, -1.0, 0.5, 0.0]]), loss=1.0, damping=1.0)
    SampledPotential(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 1.0, -1 / 3]]))


@pytest.mark.parametrize("free", [-2.0, -0.5, 0.05, 0.7, 1.61, 2.5])
@pytest.mark.parametrize("load", [0.02, 0.4, 2.0])
def test_slides_are_the_outermost_roots(free, load):
    """v + load mu(v) = free on a fine grid, from above; below the tangent slide_on is the velocity of the tangent."""
    law = Friction(1.0)
    v = np.linspace(5.0, 1e-7, 200001)
    over = v + load * (0.3 + 0.5 / (1 + v / 0.1)) - free
    crossing = np.flatnonzero(np.diff(np.sign(over)))
    slide = law.slide(free, load)
    if not crossing.size:
        assert slide is None
        assert law.slide_on(free, load) == pytest.approx(max(np.sqrt(load * 0.05) - 0.1, 0.0))
    else:
        assert slide == pytest.approx(v[crossing[0]], abs=5e-5)
        assert law.slide_on(free, load) == slide


@pytest.mark.parametrize(
    ("branch", "free", "after", "changes"),
    [
        ("stuck", 0.79, "stuck", False),
        ("stuck", 0.81, "ahead", True),
        ("stuck", -0.81, "behind", True),
        ("ahead", 0.9, "ahead", False),
        ("behind", -0.9, "behind", False),
        ("ahead", -0.9, "behind", True),
        ("behind", 0.9, "ahead", True),
        ("ahead", 0.1, "stuck", True),
        ("held", 3.0, "held", False),
    ],
)
def test_friction_goes_over_to_the_branch_of_its_motion(branch, free, after, changes):
    """Under a load of 1 m/s: it sticks up to 0.8, slides on from 2 sqrt(0.05) + 0.2 on."""
    friction = FrictionBranch(Friction(1.0), 1.0, 0.0, branch, free=free, load=1.0)
    assert friction.changes() == changes
    assert friction.branch == after


@pytest.mark.parametrize(("slip", "velocity"), [(0.0, 0.0), (0.2, 1), (-0.2, 0.0)])
def test_an_open_branch_keeps_sliding_while_it_can(slip, velocity):
    friction = FrictionBranch(Friction(2.0), 0.5, slip)
    friction.meet(0.75, 1.0)  # load 1 m/s, between the tangent and the limit of sticking
    expected = Friction(1.0).slide(0.75, 1.0) if velocity else 0.0
    assert (friction.velocity, friction.load) == (pytest.approx(expected), 1.0)
    assert friction.force == pytest.approx(expected - 0.75)
    assert friction.branch == ("ahead" if velocity else "stuck")
    friction.meet(0.75, 0.0)
    assert friction.force == 0.0


def test_branches_are_solved_for_until_none_changes():
    friction, calls = FrictionBranch(Friction(1.0), 1.0, 0.0, "behind"), []

    def solve():
        friction.meet(2.0, 1.0)
        calls.append(friction.branch)
        return len(calls)

    assert solve_branches([friction], solve) == 2
    assert calls == ["behind", "ahead"]
    assert solve_branches([], lambda: "all else") == "all else"


def test_numbers_of_linear_laws():
    laws = [Rigid(2e-3), SpringDashpot(3e4, 5.0, 1e-3), SpringDashpot(), Contact(1.0), SpringDashpot(0.0, 2.0)]
    numbers = LinearLaws.of(laws, DT)
    alpha, beta = 1.5e4 + 5.0 / DT, 1.5e4 - 5.0 / DT
    assert numbers.rigid.tolist() == [True, False, False, False, False]
    assert numbers.active.tolist() == [True, True, False, False, True]
    np.testing.assert_allclose(numbers.softness, [0.0, 1 / alpha, 0.0, 0.0, DT / 2])
    np.testing.assert_allclose(numbers.gamma, [0.0, beta / alpha, 0.0, 0.0, -1.0])
    np.testing.assert_allclose(numbers.offset, [2e-3, 1e-3, 0.0, 0.0, 0.0])
    assert numbers.changed({3: Contact(2.0), 0: Rigid(2e-3)}, DT) is numbers
    other = numbers.changed({1: Rigid(4e-3), 2: SpringDashpot(2.0)}, DT)
    assert other.rigid.tolist() == [True, True, False, False, False]
    assert other.on.tolist() == [0, 1, 2, 4]
    assert (other.softness[2], other.gamma[2], other.offset[1]) == (1.0, 1.0, 4e-3)
    assert numbers.on.tolist() == [0, 1, 4]


def test_elimination_of_linear_laws_is_the_inverse_of_what_they_see(rng):
    root = rng.normal(size=(4, 4))
    Z = 1e-5 * (root @ root.T + np.eye(4))
    R = np.diag([3e-6, 1e-19, 5e-6, 7e-6])
    R[0, 3] = R[3, 0] = 1e-6
    laws = [Rigid(1e-3), Rigid(2e-3), Contact(1.0), SpringDashpot(3e4, 5.0, 1e-3)]
    solve = LinearLaws.of(laws, DT).solve(Z, R)
    alpha, beta = 1.5e4 + 5.0 / DT, 1.5e4 - 5.0 / DT
    on = [0, 1, 3]
    seen = Z[np.ix_(on, on)] + np.diag([6e-6, 0.0, 1 / alpha])
    np.testing.assert_allclose(solve.inverse, sla.inv(seen), rtol=1e-9)
    np.testing.assert_allclose(solve.gamma, [1.0, 0.0, 0.0, beta / alpha])  # the second yields by rounding alone
    np.testing.assert_allclose(solve.offset, [2e-3, 2e-3, 0.0, (1 + beta / alpha) * 1e-3])
    expected = np.zeros((4, 4))
    expected[np.ix_(on, on)] = sla.inv(seen)
    np.testing.assert_allclose(solve.G, expected, rtol=1e-9)
    np.testing.assert_allclose(solve.constant, expected @ solve.offset, rtol=1e-9)
    gaps = rng.normal(size=(4, 2))
    np.testing.assert_allclose(solve.apply(gaps), expected @ gaps, rtol=1e-9)


def test_elimination_of_linear_laws_under_nonlinear_ones(rng):
    """Z~ = Z_nn - Z_nl G Z_ln + R / theta, with R where the law has it; theta forgets at 4000 / s."""
    root = rng.normal(size=(5, 5))
    Z, R = 1e-5 * root @ root.T, 1e-6 * np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    R[2, 4] = R[4, 2] = 1e-6
    laws = [Rigid(), Contact(1.0), HardeningSpring(2.0), Friction(1.0), Contact(3.0)]
    others = NonlinearLaws.of(laws, DT)
    assert others.index.tolist() == [1, 2, 3, 4]
    assert others.is_contact.tolist() == [True, False, False, True]
    assert others.theta == pytest.approx(1 / (1 + np.exp(-0.4)))
    solve = NonlinearSolve(NonlinearGaps.of(others, Z, R), LinearLaws.of(laws, DT).solve(Z, R))
    series = R[1:, 1:].copy()
    series[2] = series[:, 2] = 0.0  # friction has none
    n = [1, 2, 3, 4]
    linear = np.outer(Z[n, 0], Z[0, n]) / (Z[0, 0] + 2e-6)
    np.testing.assert_allclose(solve.Z, Z[np.ix_(n, n)] - linear + series / others.theta, rtol=1e-9)
    np.testing.assert_allclose(solve.answer[0], Z[0, n] / (Z[0, 0] + 2e-6), rtol=1e-9)
    assert not solve.answer[1:].any()
    np.testing.assert_array_equal(solve.residual, series)
    # the last comes to the place of the second: its displacement is R_42 / R_22 of that one's; friction keeps none
    carried = solve.carried_series(np.array([9.0, 0.0, 6e-6, 7.0, 0.0]))
    np.testing.assert_allclose(carried, [0.0, 0.0, 6e-6, 0.0, 2e-6], rtol=1e-12)
    both = np.array([0.0, 1e-6, 6e-6, 0.0, 5e-6])
    np.testing.assert_array_equal(solve.carried_series(both), both)
    assert not solve.carried_series(np.zeros(5)).any()


def test_exchanged_nonlinear_laws_keep_their_places():
    laws = [Contact(1.0), Rigid(), HardeningSpring(2.0)]
    others = NonlinearLaws.of(laws, DT)
    assert others.changed({1: SpringDashpot(3.0)}, DT) is others
    new = others.changed({1: Contact(5.0), 2: Rigid()}, DT)
    assert (new.index.tolist(), new.laws, new.theta) == ([0, 1], (Contact(1.0), Contact(5.0)), others.theta)
    assert others.changed({0: Contact(7.0)}, DT).laws == (Contact(7.0), HardeningSpring(2.0))


def test_pseudo_inverse_of_small_matrices():
    assert scaled_pinv(np.zeros((0, 0))).shape == (0, 0)
    np.testing.assert_array_equal(scaled_pinv(np.diag([4.0, 0.0])), np.diag([0.25, 0.0]))
    np.testing.assert_allclose(scaled_pinv(np.full((2, 2), 2.0)), np.full((2, 2), 0.125), rtol=1e-12)
    negative = np.array([[-2.0, 1.0], [1.0, 3.0]])
    np.testing.assert_allclose(scaled_pinv(negative), sla.inv(negative), rtol=1e-12)


def test_gaps_of_a_hub_are_the_shares_of_its_points():
    span = np.array([[1.0, 2.0], [3.0, 4.0]])
    hub = Hub(0, np.arange(2), np.array([1, -1, 0]), np.array([0.5, 9.0, -2.0]), span, np.eye(2))
    np.testing.assert_array_equal(hub.gaps, [[1.5, 2.0], [0.0, 0.0], [-2.0, -4.0]])


def test_pivots_span_the_rows():
    rows = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1e-3, 0.0], [2.0, 1e-3, 0.0]])
    assert _pivots(rows, 1e-13).tolist() in ([0, 3], [1, 3], [2, 3])
    assert len(_pivots(rows, 1e-2)) == 1
    assert _pivots(np.zeros((2, 3)), 1e-13).size == 0
    assert _pivots(np.eye(3) * [1, 1e-5, 1e-12], 1e-6).tolist() == [0, 1]


def body_system():
    body = ModalBasis.real(
        [300.0, 0.0], [4.0, 0.0], {"p": [1.0, 0.5], "q": [-2.0, 0.5]}, residual=np.diag([1e-6, 3e-6])
    )
    string = ModalBasis.real([900.0], [1.0], {"end": [3.0]}, residual=[[2e-6]])
    links = [
        Connection("joint", (Term("string", "end"), Term("body", "p", -0.5))),
        Connection("seat", (Term("body", "q", 2.0), Term("body", "p"), Term("body", "p", 0.25)), SpringDashpot(1e3)),
    ]
    return body, string, System.build({"body": body, "string": string}, links, dt=DT)


def test_compiled_numbers_of_a_component():
    _, string, system = body_system()
    compiled = system.compiled[0]
    shares = np.array([[-0.5, 0.0], [1.25, 2.0]])
    np.testing.assert_array_equal(compiled.shares, shares)
    np.testing.assert_allclose(compiled.residual, shares @ np.diag([1e-6, 3e-6]) @ shares.T, rtol=1e-12)
    # under a held force of 1 N: 1 - cos for an oscillator (here with its loss), h^2 / 2 for a free mass
    damped = np.sqrt(300.0**2 - 16.0)
    moved = (1 - np.exp(-4 * DT) * (np.cos(damped * DT) + 4 / damped * np.sin(damped * DT))) / 300.0**2
    phi = np.array([[1.0, 0.5], [-2.0, 0.5]])
    ports = phi @ np.diag([moved, DT**2 / 2]) @ phi.T
    np.testing.assert_allclose(compiled.compliance, shares @ ports @ shares.T, rtol=1e-9)
    np.testing.assert_allclose(compiled.gap_mobility, shares @ phi @ phi.T @ shares.T, rtol=1e-12)
    total = shares @ ports @ shares.T
    c = 3.0**2 * (1 - np.exp(-DT) * (np.cos(900 * DT) + np.sin(900 * DT) / 900)) / 900.0**2
    total[0, 0] += c
    np.testing.assert_allclose(system.elimination.gap.compliance, total, rtol=1e-5)
    np.testing.assert_allclose(system.elimination.gap.diagonal("compliance"), np.diag(total), rtol=1e-5)
    residual = compiled.residual + np.diag([2e-6, 0.0])
    np.testing.assert_allclose(system.elimination.gap.residual, residual, rtol=1e-12)
    np.testing.assert_allclose(system.elimination.gap.diagonal("residual"), np.diag(residual), rtol=1e-12)
    np.testing.assert_allclose(compiled.held_force("q"), compiled.W[1], rtol=1e-14)
    like = system.compile(
        "string", replace(string, right=2 * string.right, left=2 * string.left), like=system.compiled[1]
    )
    assert like.E is system.compiled[1].E
    np.testing.assert_allclose(like.W, 2 * system.compiled[1].W, rtol=1e-12)
    assert repr(system) == "System(2 components, 3 modes, 2 connections, 10000 Hz)"
    x = [np.array([[1e-3, 0.2], [2e-3, -0.1]]), np.array([[3e-3, 0.3]])]
    y = [c.form.C[:, :, :] for c in system.compiled]
    at = [np.einsum("pmx,mx->p", rows, state) for rows, state in zip(y, x, strict=True)]
    expected = [at[1][0] - 0.5 * at[0][0], 2 * at[0][1] + 1.25 * at[0][0]]
    np.testing.assert_allclose(system.gaps(x), expected, rtol=1e-12)
    assert not system.start().modes.any()


def test_independent_motions_of_many_ports(rng):
    """Five points of a rigid bar move by two: any displacement is `span` of those of the chosen ports."""
    places = np.array([0.0, 0.3, 0.5, 0.8, 1.0])
    points = {f"p{i}": [1.0, x] for i, x in enumerate(places)}
    bar = ModalBasis.real([200.0, 310.0], [1.0, 2.0], points)
    links = [Connection(name, (Term("bar", name),)) for name in points]
    compiled = System.build({"bar": bar}, links, dt=DT).compiled[0]
    ports, span = compiled.motions(np.arange(5))
    assert len(ports) == 2
    x = places[ports]
    np.testing.assert_allclose(span, np.stack([(x[1] - places), (places - x[0])], axis=1) / (x[1] - x[0]), atol=1e-12)
    assert compiled.motions(np.arange(5))[1] is span
    few, whole = compiled.motions(np.array([1, 3]))
    assert (few.tolist(), whole.tolist()) == ([1, 3], np.eye(2).tolist())


def test_controls_and_injections_end_after_their_last_step():
    three = np.zeros(3)
    assert PrescribedMotion("c", 5, velocity=three).stop == 8
    assert PrescribedMotion("c", 5, scale=three).stop == 8
    assert PrescribedMotion("c", 5, offset=three).stop == 7
    assert PrescribedMotion("c", 5, offset=np.zeros(4), scale=three).stop == 8
    assert Injection("c", 5, np.zeros((2, 1, 2)), np.zeros((2, 3))).stop == 8
    for bad in ({}, {"offset": three, "scale": three}, {"offset": np.zeros(0)}, {"scale": np.array([0.0, -1e-9])}):
        with pytest.raises(ValueError, match=r"one number of steps|negative scale"):
            PrescribedMotion("c", 0, **bad)


def test_copies_and_restored_states_share_no_array():
    _, _, system = body_system()
    state = system.start()
    other = state.copy()
    arrays = ("modes", "forces", "series", "slip", "potentials")
    for i, name in enumerate(arrays):
        getattr(other, name)[:] = i + 1.0
    other.sample = 7
    assert not any(getattr(state, name).any() for name in arrays)
    state.restore(other)
    assert all(np.all(getattr(state, name) == i + 1.0) for i, name in enumerate(arrays))
    other.modes[:] = other.series[:] = other.forces[:] = 0.0
    assert (state.sample, state.modes.min(), state.series.min(), state.forces.min()) == (7, 1.0, 3.0, 2.0)


def test_coordinates_of_real_modes():
    """An oscillator and an overdamped mode, as first-order blocks and pairs: y, energy, and the held force."""
    basis = ModalBasis.real([300.0, 200.0], [4.0, 500.0], {"p": [1.0, 1.0]})
    E, held = flow(basis, DT)
    held = held * DT
    c = ModalCoordinates.of(basis, DT, held)
    q, v = np.array([2e-3, -1e-3]), np.array([0.3, 0.2])
    a, b, on, d, e, f = basis.motion
    x = np.stack([d * q, e * q + f * v]).T
    np.testing.assert_allclose(c.of_state(x, 2), q, rtol=1e-12)
    assert c.of_state(x, 1).shape == (1,)
    assert c.energy(x, 2) == pytest.approx(0.5 * np.sum(v**2 + np.array([300.0, 200.0]) ** 2 * q**2))
    assert c.energy(x, 1) == pytest.approx(0.5 * (v[0] ** 2 + (300.0 * q[0]) ** 2))
    for k, (omega, sigma) in enumerate(((300.0, 4.0), (200.0, 500.0))):
        A = np.array([[0.0, 1.0], [-(omega**2), -2 * sigma]])
        moved = sla.solve(A, (sla.expm(A * DT) - np.eye(2)) @ [0.0, 1.0])
        assert c.compliance[k] == pytest.approx(moved[0], rel=1e-9)
        after = c.kick[k] + apply(E, np.zeros((2, 2)))[k]
        assert b[k] * after[0] + on[k] * after[1] == pytest.approx(moved[1], rel=1e-9)
        assert a[k] * after[0] == pytest.approx(moved[0], rel=1e-9)
    np.testing.assert_allclose(c.middle, middle_of_step(np.array([300.0, 200.0]) * DT / 2), rtol=1e-12)
    stiff = ModalBasis.real([1e5], [0.0], {"p": [1.0]})
    limited = ModalCoordinates.of(stiff, DT, flow(stiff, DT)[1] * DT)
    np.testing.assert_allclose(limited.middle, middle_of_step(np.array([np.pi / 2 - 1e-6])), rtol=1e-12)


def test_weights_of_the_middle_of_a_step():
    """A constant force is felt as K sin u / u of itself; K is u / sin u up to u^6."""
    u = np.array([0.05, 0.1, 0.2, 0.4])
    by_motion, by_force = middle_of_step(u)
    K = 2 * np.cos(u) * by_motion
    off = np.abs(K * np.sin(u) / u - 1)
    assert np.all(off < 12.0 * u**8)
    np.testing.assert_allclose(by_force, (1 - K * np.cos(u)) / (2 * np.sin(u) ** 2), rtol=1e-12)
    np.testing.assert_allclose(middle_of_step(np.array([0.0, 1e-5])), [[0.5, 0.5], [1 / 6, 1 / 6]], rtol=1e-9)
    assert by_force[0] == pytest.approx(1 / 6, rel=1e-2)
    s = np.sin(1.2) ** 2
    K = np.cos(1.2) ** 5 * (1 + 8 / 3 * s + 73 / 15 * s**2 + 2528 / 336 * s**3)
    assert middle_of_step(np.array([1.2]))[0, 0] == pytest.approx(K / (2 * np.cos(1.2)))


@pytest.mark.parametrize(("cost", "paid"), [(1.0, 1.0), (-1.0, -1.0), (9.0, 2.5), (-9.0, -2.5), (2.5, 2.5), (0.0, 0.0)])
def test_modes_pay_at_most_a_quarter_of_their_kinetic_energy(cost, paid):
    """Two parts with velocities 4 and 2 m/s sqrt(kg): 10 J, of which 2.5 J are paid at once."""
    parts = [np.array([[0.0], [1.0], [1.0]]), np.array([[0.0], [2.0], [0.5]])]
    states = [np.array([[5.0, 4.0], [1.0, 9.0]]), np.array([[7.0, 1.0]])]
    assert pay_from_motion(parts, states, cost) == pytest.approx(paid)
    factor = np.sqrt(1 - paid / 10)
    np.testing.assert_allclose(states[0], [[5.0, 4.0 * factor], [1.0, 9.0]])
    np.testing.assert_allclose(states[1], [[7.0, 1.0 * factor]])
    still = [np.array([[5.0, 0.0]])]
    assert pay_from_motion(parts[:1], still, 1.0) == 0.0


class Bowl(JoinedPotential):
    """V = 2 y^2 of one coordinate, with a shift of 3 J."""

    sizes = (1,)

    def energy(self, y):
        return 2.0 * float(y[0] ** 2)

    def direction(self, step):
        return np.zeros(1)

    def describe(self):
        return {}

    def shift(self, kept, stored, modes):
        return kept or 3.0 + modes()


def test_psi_of_a_potential_begins_and_ends_with_its_energy():
    bowl, y = Bowl(), np.array([1.5])  # V = 4.5 J
    assert (bowl.n, bowl.stored(y, np.array([0.25, 3.0, 1.0]))) == (1, 4.75)
    assert JoinedPotential.shift(bowl, 1.0, 2.0, lambda: 3.0) == 0.0
    assert JoinedPotential.fast(bowl, y) is None
    assert bowl.begin(y, np.zeros(3), lambda: 0.5) == (3.5, pytest.approx(4.0))  # sqrt(2 (4.5 + 3.5))
    assert bowl.begin(y, np.array([0.0, 3.5, -1.0]), float) == (3.5, pytest.approx(-4.0))
    same = np.sqrt(16.0 * (1 + 4e-15))
    assert bowl.begin(y, np.array([0.0, 3.5, same]), float) == (3.5, same)  # psi is kept to the bit
    assert bowl.begin(y, np.array([-9.0, 3.5, 1.0]), float)[1] == 0.0  # never the root of a negative number
    np.testing.assert_allclose(bowl.end(y, 3.5, 4.2, float, None), [8.82 - 8.0, 3.5, 4.2])
    # 0.1 % of V + C = 8 J is the tolerance
    paid = []
    within = bowl.end(y, 3.5, np.sqrt(16.015), lambda: 0.5, lambda cost: paid.append(cost) or cost)
    np.testing.assert_allclose(within, [0.0075, 3.5, np.sqrt(16.015)])
    assert not paid
    beyond = bowl.end(y, 3.5, np.sqrt(16.017), lambda: 0.5, lambda cost: paid.append(cost) or 0.5 * cost)
    np.testing.assert_allclose([*beyond, *paid], [0.00425, 3.5, np.sqrt(16.0085), -0.0085])


def test_tension_of_a_string_by_its_formula():
    weights = {"a": np.array([1.0, 4.0]), "b": np.array([2.0])}
    tension = TensionModulation("T", ("a", "b"), 8e3, 0.5, weights, correction=1.0)
    a = ModalBasis.real([5e3, 4e4], [1.0, 1.0], {"p": [1.0, 1.0]})
    share = tension.share("a", a, DT)
    assert share.kappa == pytest.approx(8e3 / 2.0)
    np.testing.assert_allclose(share.weights, [0.5 / np.sin(0.5), 4.0 / np.sin(1.0)])  # omega h is 0.5, and 1 at most
    assert weights["a"].tolist() == [1.0, 4.0]
    plain = TensionModulation("T", ("a",), 8e3, None, None)
    for key in ("stretch_part", "tension_part"):
        told = replace(a, metadata={key: [3.0, 5.0], "length": 2.0, "tension_part": [3.0, 5.0]})
        assert plain.share("a", told, DT).weights.tolist() == [3.0, 5.0]
        assert plain.share("a", told, DT).kappa == 1e3
    assert plain.share("a", replace(a, metadata={"stretch_part": [1, 2], "tension_part": [3, 4], "length": 1}), DT
                       ).weights.tolist() == [1, 2]  # fmt: skip
    joined = JoinedTension((TensionShare(np.array([1.0, 4.0]), 9.0), TensionShare(np.array([2.0]), 9.0)))
    y = np.array([0.5, -0.25, 1.0])
    S = 0.25 + 4 * 0.0625 + 2.0
    assert (joined.sizes, joined.n) == ((2, 1), 3)
    assert joined.psi(y) == pytest.approx(3 * S)
    assert joined.energy(y) == pytest.approx(4.5 * S**2)
    w = np.array([1e-3, 2e-3, 1e-3])
    slow = joined.direction(MiddleOfStep(y, y, w, 0.0, 1.0))
    np.testing.assert_allclose(slow, 6 * np.array([0.5, -1.0, 2.0]))
    alpha = 0.5 * w * np.array([1.0, 4.0, 2.0])  # T = 6 psi, at most 1 / max alpha = 250
    fast = joined.direction(MiddleOfStep(y, y, w, 0.0, 100.0))
    k = 1 - 250 / 600
    np.testing.assert_allclose(fast, slow * (1 - k * alpha / alpha.max()))
    np.testing.assert_allclose(joined.direction(MiddleOfStep(y, y, w, 0.0, 41.6)), slow)
    np.testing.assert_allclose(joined.direction(MiddleOfStep(y, y, w, 0.0, -100.0)), slow)
    assert joined.describe() == {"kind": 0, "scale": 9.0}


@pytest.mark.parametrize(
    "change",
    [{"axial_stiffness": -1.0}, {"correction": -0.1}, {"correction": 3.15}, {"components": ()}, {"length": 0.0}],
)
def test_a_tension_that_cannot_be_is_refused(change):
    options = {"components": ("a",), "axial_stiffness": 0.0, "length": 1.0, "correction": 3.14} | change
    with pytest.raises(ValueError, match="T: "):
        TensionModulation("T", **options)
    basis = ModalBasis.real([5e3, 4e4], [1.0, 1.0], {"p": [1.0, 1.0]})
    for weights, length in (
        ({"b": [1, 1]}, 1.0),
        ({"a": [1.0]}, 1.0),
        ({"a": [1.0, -1e-9]}, 1.0),
        ({"a": [1, 1]}, None),
    ):
        with pytest.raises(ValueError, match="T: "):
            TensionModulation("T", ("a",), 1.0, length, weights).share("a", basis, DT)
    TensionModulation("T", ("a",), 1.0, 1.0, {"a": [0, 1]}).share("a", basis, DT)


def test_which_potentials_act():
    tensions = [TensionModulation(name, (name.lower(),), 1.0) for name in ("A", "B", "C")]
    both = Potentials.of(tensions, {"a", "b", "c", "m"}, {"m"})
    assert (both.on, both.two_way, both.one_way, both.user, len(both)) == ((True,) * 3, (0, 1, 2), (), (), 3)
    assert both.memory == (slice(0, 3), slice(3, 6), slice(6, 9))
    assert (both.index("B"), both[2].name) == (1, "C")
    only = both.switched({"B"})
    assert (only.on, only.two_way) == ((False, True, False), (1,))
    assert both.switched({"A", "B", "C"}) is both
    assert both.switched((), among={"C"}).on == (True, True, False)
    assert only.switched({"A"}, among={"A", "C"}).on == (True, True, False)
    memory = np.arange(1.0, 10.0)
    assert only.checked(memory).tolist() == [0, 0, 0, 4, 5, 6, 0, 0, 0]
    assert memory.tolist() == list(range(1, 10))
    assert both.checked(memory) is memory
    assert both.checked(np.ones(4)).tolist() == [0.0] * 9
    assert Potentials().checked(np.ones(2)).size == 0
    with pytest.raises(ValueError, match="no potential"):
        both.switched({"D"})
    for wrong in ("m", "x"):
        with pytest.raises(ValueError, match=f"not '{wrong}'"):
            Potentials.of([TensionModulation("A", (wrong,), 1.0)], {"a", "m"}, {"m"})


class Quartic(PotentialEnergy):
    """V = y^4 - 1 of each coordinate, `scale` 4 J."""

    scale = 4.0

    def __init__(self, sizes, at_rest=0.0):
        self.sizes, self.at_rest, self.least = sizes, at_rest, -float(sum(sizes))

    def gradient(self, y):
        return float(np.sum(y**4 - 1) + self.at_rest), 4 * y**3


def test_a_potential_of_ones_own_by_its_formula():
    V, y = Quartic((1, 1)), np.array([2.0, 1.0])
    assert V.energy(y) == 15.0
    assert V.shift(9.0, 9.0, float) == 6.0  # scale - least
    np.testing.assert_allclose(V.direction(MiddleOfStep(y, y, y, 6.0, 0.0)), np.array([32.0, 4.0]) / np.sqrt(42.0))
    assert V.direction(MiddleOfStep(y, y, y, -15.0, 0.0)).tolist() == [0.0, 0.0]
    assert V.describe()["scale"] == 6.0
    assert V.describe()["sizes"] == [1, 1]
    bases = [ModalBasis.real([100.0], [1.0], {"p": [1.0]})] * 2
    join = ModalPotential("V", ("a", "b"), lambda shares: V).join
    assert join(bases) is V
    for bad in (Quartic((2, 0)), Quartic((1, 1), -1e-9), Quartic((1, 1), np.inf), Quartic((1, 1), np.nan)):
        with pytest.raises(TonewoodError, match="potential V: "):
            ModalPotential("V", ("a", "b"), lambda shares, bad=bad: bad).join(bases)
    # rounding: 1e-12 J and 1e-9 of 2 J, 4 J and the scale at hand
    for scale, allowed in ((0.0, 6e-9 + 1e-12), (1e3, 1.006e-6 + 1e-12)):
        V.check_bound(-2.0 - 0.999 * allowed, scale)
        with pytest.raises(TonewoodError, match="bounded from below"):
            V.check_bound(-2.0 - 1.001 * allowed, scale)
    psi = 4.0  # V = 8 - shift - excess
    V.check_state(np.array([4.0, 6.0, psi]))
    with pytest.raises(TonewoodError, match=r"V = -2\.1 J"):
        V.check_state(np.array([4.1, 6.0, psi]))


@pytest.mark.parametrize(
    ("energy", "kept", "stored", "modes", "shift"),
    [
        (2.0, 0.0, 1.0, 3.0, 4.0), (2.0, 0.0, -5.0, 3.0, 5.0), (2.0, 0.0, 1.0, -3.0, 0.0),
        (2.0, 0.5, -0.4, 3.0, None), (2.0, 0.5, -0.5, 3.0, 2.5),
    ],
)  # fmt: skip
def test_shift_of_a_stretched_string(energy, kept, stored, modes, shift):
    """C is held while U + C is above 0; anew it is all energy of the string, or its shortfall, and 1e-8 EA L."""
    share = GeometricShare(np.ones((2, 1)), energy)
    found = GeometricShares((share, share)).shift(kept, stored, lambda: modes)
    assert found == (kept if shift is None else pytest.approx(shift + 2e-8, abs=1e-12))


def test_direction_of_a_stretched_string_is_the_gradient_over_the_root():
    rng = np.random.default_rng(3)
    string = GeometricShares(
        (GeometricShare(rng.normal(size=(5, 3)), 7.0), GeometricShare(rng.normal(size=(3, 2)), 7.0))
    )
    middle, answered = rng.normal(size=(2, 5))
    s = string.squares(middle)
    for sign in (1, -1):
        strain = string.strains @ answered * 10 * sign
        U = 7.0 * (0.5 * s[0] ** 2 + s[0] * strain[0] + 0.5 * (0.5 * s[1:] @ s[1:] + s[1:] @ strain[1:]))
        for shift in (2 * abs(U), 4 * abs(U)):
            size = np.sqrt(max(2 * (U + shift), abs(U) + shift))
            found = string.direction(MiddleOfStep(middle, 10 * sign * answered, middle, shift, 0.0))
            np.testing.assert_allclose(found * size, string.gradient(middle, s, strain), rtol=1e-9)
    fast = string.fast(middle)
    np.testing.assert_allclose(fast[3:], -(7.0 * np.array([1, 0.5, 0.5]) * s) @ string.parts[1].slopes, rtol=1e-12)
    assert not fast[:3].any()
    still = MiddleOfStep(np.zeros(5), np.zeros(5), np.zeros(5), 0.0, 0.0)
    assert not string.direction(still).any()


def test_a_driven_string_by_its_formula():
    """Squares with explicit sums; forces 16 samples late; modes as free oscillators of e = s + a."""
    rng = np.random.default_rng(5)
    weights, mirrored, freq = rng.normal(size=(3, 4)), rng.normal(size=(3, 2)), np.array([800.0, 1700.0])
    steps = steps_of(freq, np.array([3.0, 40.0]), DT)
    for row, omega, sigma in zip(steps, freq, (3.0, 40.0), strict=True):
        rate = np.array([[0, 1], [-(omega**2), -2 * sigma]])
        np.testing.assert_allclose(row, [*sla.expm(rate * DT).ravel(), *sla.expm(rate * DT / 2)[0]])
    share = PhantomShare(weights, mirrored, steps)
    x = rng.normal(size=(6, 2))
    first = x[:, 0]
    s = np.array([sum(weights[m, k] * first[k] * first[k + m] for k in range(4 - m)) for m in range(3)])
    for m in range(1, 3):
        s[m] += sum(mirrored[m, k] * first[k] * first[m - 1 - k] for k in range(m))
    np.testing.assert_allclose(share.squares(x), s, rtol=1e-12)
    string = PhantomShares((share, share), 9.0)
    row = np.zeros(DELAY + 2 * MOST_MODES)
    row[:DELAY] = np.arange(1.0, DELAY + 1)
    a, moving = np.array([0.3, -0.2]), np.array([5.0, 7.0])
    row[DELAY : DELAY + 2], row[DELAY + MOST_MODES : DELAY + MOST_MODES + 2] = a, moving
    assert string.advance([x, x], row) == 1.0
    e = a + 2 * s[1:]
    assert row[: DELAY - 1].tolist() == list(np.arange(2.0, DELAY + 1))
    middle = steps[:, 4] * e + steps[:, 5] * moving
    assert row[DELAY - 1] == pytest.approx(9.0 * (2 * s[0] + middle.sum()))
    np.testing.assert_allclose(row[DELAY : DELAY + 2], steps[:, 0] * e + steps[:, 1] * moving - 2 * s[1:])
    after = row[DELAY + MOST_MODES : DELAY + MOST_MODES + 2]
    np.testing.assert_allclose(after, steps[:, 2] * e + steps[:, 3] * moving)
    assert string.describe()["scale"] == 9.0


def test_layout_of_a_small_system():
    links = [
        Connection("joint", (Term("a", "q"), Term("b", "p", -2.0), Term("a", "q", 0.5))),
        Connection("own", (Term("a", "p"),)),
    ]
    basis = ModalBasis.real([100.0], [1.0], {"p": [1.0], "q": [2.0]})
    readouts = [Readout("f", "force", (), (("own", 2.0), ("own", 0.5)))]
    drives = [Drive("m", "p", "joint", 3.0)]
    layout = System.build({"a": basis, "b": basis, "m": basis}, links, readouts, dt=DT, drives=drives).layout
    assert layout.ports == {"a": ("p", "q"), "b": ("p",), "m": ("p",)}
    assert [a.tolist() for a in layout.incidence] == [[[0, 1.5], [1, 0]], [[-2], [0]], [[3], [0]]]
    assert [g.tolist() for g in layout.gaps] == [[0, 1], [0], []]
    assert [on.tolist() for on, _ in layout.touching] == [[0, 1], [0], [0]]
    assert [a.tolist() for a in layout.entries] == [[0, 0, 1, 1, 0], [0, 1, 0, 1, 0]]
    assert layout.entry_slots.tolist() == [0, 0, 0, 0, 1]
    assert [a.tolist() for a in layout.joints] == [[0, 0, 1], [0, 1, 0]]
    assert layout.force_weights.tolist() == [[0.0, 2.5]]
    gathered = layout.gathered([np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[10.0]]), np.zeros((0, 0))])
    assert gathered.tolist() == [[11.0, 2.0], [3.0, 4.0]]
    assert (layout.slots, layout.places) == ({"a": 0, "b": 1, "m": 2}, {"joint": 0, "own": 1})
    assert layout.offsets == (0, 16, 32)
