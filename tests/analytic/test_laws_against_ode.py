"""Both steppers' nonlinear laws against differential equations in physical coordinates, and against closed forms.

M u'' + C u' + K u = sum_j a_j f_j(p_j, p_j', t),  p_j = offset_j - a_j u, is integrated by DOP853 with the laws written
out here; none of the package's laws, solves or steps take part. Errors of steps fall with the square of the step.
"""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from assembled import chain, connect, merged, motion_readouts
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import PrescribedMotion, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

STEPPERS = pytest.mark.parametrize("make", [NumpyStepper, KernelStepper])
DOUBLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)
RATE, DURATION = 8000, 0.015
PARTS = {"a": chain(2, seed=1), "b": chain(2, seed=2)}
WHOLE = merged(*PARTS.values())
START, SPEED = np.array([0.5e-3, 0.2e-3, -0.3e-3, 0.4e-3]), np.array([0.9, -0.6, -1.1, 0.5])
X = np.linspace(-8e-3, 8e-3, 161)

CONTACT = Contact(5e7, 1.7, loss=0.25, offset=-0.4e-3), lambda p, r, t: 5e7 * max(p, 0.0) ** 1.7 * (1 + 0.25 * r)
SPRING = (
    HardeningSpring(2e5, 3e10, 20.0, 15.0, offset=0.2e-3),
    lambda p, r, t: 2e5 * p + 3e10 * p**3 + 20.0 * r + 15.0 * r * abs(r),
)
SAMPLED = (
    SampledPotential.from_potential(X, 2e5 * X**2 + 2e10 * X**4, damping=30.0),
    lambda p, r, t: 4e5 * p + 8e10 * p**3 + 30.0 * r,
)
EXPONENTIAL = (
    CompiledPotential(
        DOUBLE(lambda d: 0.1 * math.exp(-d / 1e-3)), DOUBLE(lambda d: -100.0 * math.exp(-d / 1e-3)), 0.2, 5.0
    ),
    lambda p, r, t: 100.0 * math.exp(p / 1e-3) * (1 + 0.2 * r) + 5.0 * r,
)


def hyperbola(law, v):
    """Friction at a sliding velocity v, N."""
    return -math.copysign(law.normal_force * (law.dynamic + (law.static - law.dynamic) / (1 + abs(v) / law.speed)), v)


FAST = Friction(600.0, 0.9, 0.2, 1.5, velocity=9.0)  # its partner is always faster: it slides one way
SLIDING = FAST, lambda p, r, t: hyperbola(FAST, -r - 9.0)
SCENES = {
    "contact between parts": [((1.0, 0.0, -1.0, 0.0), *CONTACT)],
    "spring and dashpots": [((0.0, 1.0, 0.0, -0.7), *SPRING)],
    "sampled potential": [((1.0, -0.5, 0.0, 0.0), *SAMPLED)],
    "compiled potential": [((0.0, 1.0, 0.0, 1.0), *EXPONENTIAL)],
    "friction": [((1.0, 0.0, 0.5, 0.0), *SLIDING)],
    # friction moves the gap of the contact: their effect on one another has a sign
    "friction beside a contact": [((1.0, 0.0, 0.4, 0.0), *CONTACT), ((1.0, 0.3, 0.0, 0.0), *SLIDING)],
    "all, and linear connections": [
        ((1.0, 0.0, 0.0, -1.0), SpringDashpot(5e5, 40.0, 1e-4), lambda p, r, t: 5e5 * p + 40.0 * r),
        ((0.0, 1.0, -0.5, 0.0), SpringDashpot(1e5, 60.0), lambda p, r, t: 1e5 * p + 60.0 * r),
        ((1.0, 0.0, -1.0, 0.0), *CONTACT), ((0.0, 1.0, 0.0, -0.7), *SPRING), ((0.5, 1.0, 0.0, 0.0), *SAMPLED),
        ((0.0, 0.0, 1.0, 0.6), *SLIDING),
    ],
}  # fmt: skip


def begin(state, system):
    """Put START and SPEED into the modes."""
    first = 0
    for name, part in PARTS.items():
        form, own = real_form(system.compiled[system.slot(name)].basis), slice(first, first + part.n)
        rows = [form.rows(q, np.arange(part.n)).reshape(part.n, -1) for q in ("displacement", "velocity")]
        modes = sla.solve(np.concatenate(rows), np.concatenate([START[own], SPEED[own]]))
        system.modes_of(state, name)[:, : part.n] = modes.reshape(-1, 2).T
        first += part.n


def stepped(make, scene, rate, controls=()):
    """(n, 4) displacements at the samples of RATE."""
    connections = [connect(f"law {j}", PARTS, row, law) for j, (row, law, _) in enumerate(scene)]
    system = System.build(
        {name: part.real_basis() for name, part in PARTS.items()}, connections, motion_readouts(PARTS), dt=1 / rate
    )
    state, stepper = system.start(), make(system)
    begin(state, system)
    out, _ = stepper.run(state, int(DURATION * rate), (), controls)
    assert stepper.statistics.redone == 0
    return out[:: rate // RATE, : WHOLE.n]


def integrated(scene, course=None):
    """The same by DOP853; course: t -> offset and its rate, of the first law."""

    def rates(t, y):
        u, v = y[: WHOLE.n], y[WHOLE.n :]
        f = -WHOLE.C @ v - WHOLE.K @ u
        for j, (row, law, force) in enumerate(scene):
            place, moves = course(t) if course and j == 0 else (law.offset, 0.0)
            f = f + np.array(row) * force(place - np.dot(row, u), moves - np.dot(row, v), t)
        return np.concatenate([v, sla.solve(WHOLE.M, f)])

    times = np.arange(int(DURATION * RATE)) / RATE
    found = solve_ivp(rates, (0, DURATION), [*START, *SPEED], "DOP853", times, rtol=1e-9, atol=1e-12, max_step=2e-4)
    return found.y[: WHOLE.n].T


def assert_second_order(errors, largest):
    assert errors[-1] < 1e-3 * largest
    assert errors[-2] / errors[-1] == pytest.approx(4.0, abs=0.2), errors


@pytest.mark.slow
@STEPPERS
@pytest.mark.parametrize("name", SCENES)
def test_laws_between_coupled_masses(make, name):
    scene = SCENES[name]
    exact, without = integrated(scene), integrated([])
    assert np.abs(exact - without).max() > 0.1 * np.abs(exact).max()  # the laws do something
    errors = [np.abs(stepped(make, scene, k * RATE) - exact).max() for k in (2, 4)]
    assert_second_order(errors, np.abs(exact).max())


@pytest.mark.slow
@STEPPERS
def test_partners_that_move(make):
    """A barrier that oscillates, and a bow of changing speed and pressure."""
    omega = 2 * np.pi * 120.0
    bow = Friction(600.0, 0.9, 0.2, 1.5)
    scene = [
        ((1.0, 0.0, 0.4, 0.0), *CONTACT),
        ((1.0, 0.3, 0.0, 0.0), bow, lambda p, r, t: (1 + np.sin(omega * t)) * hyperbola(bow, -r - 9.0 - 400.0 * t)),
    ]
    exact = integrated(scene, lambda t: (1e-3 * np.sin(omega * t), 1e-3 * omega * np.cos(omega * t)))
    errors = []
    for k in (2, 4):
        n, dt = int(DURATION * k * RATE), 1 / (k * RATE)
        ends, middle = np.arange(n + 1) * dt, (np.arange(n) + 0.5) * dt
        controls = [
            PrescribedMotion("law 0", 0, offset=1e-3 * np.sin(omega * ends)),
            PrescribedMotion("law 1", 0, velocity=9.0 + 400.0 * middle, scale=1 + np.sin(omega * middle)),
        ]
        errors.append(np.abs(stepped(make, scene, k * RATE, controls) - exact).max())
    assert_second_order(errors, np.abs(exact).max())


BOTH = [Readout("u", "displacement", (Term("part", "p"),)), Readout("v", "velocity", (Term("part", "p"),))]


def free_mass(make, law, n, dt, *, mass, start, speed, controls=()):
    """Displacement, velocity (n, 2) and force (n,) of a free mass under one law."""
    basis = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=mass)
    system = System.build({"part": basis}, [Connection("law", (Term("part", "p"),), law)], BOTH, dt=dt)
    state = system.start()
    state.modes[:, 0] = start * math.sqrt(mass), speed * math.sqrt(mass)
    out, forces = make(system).run(state, n, (), controls)
    return out, forces[:, 0]


@pytest.mark.slow
@STEPPERS
@pytest.mark.parametrize("exponent", [1.0, 2.3])
def test_a_lossy_barrier_throws_a_mass_back_as_slowly_as_hunt_and_crossley_say(make, exponent):
    """v dv / (1 + loss v) = -(K/m) p^n dp: the speed of return depends on the loss alone, the depth on K as well."""
    loss, mass, stiffness, v = 0.3, 0.01, 1e7, 2.0

    def paid(v):  # int_0^v w dw / (1 + loss w)
        return v / loss - math.log1p(loss * v) / loss**2

    back = brentq(lambda w: paid(-w) - paid(v), 0.1, v)
    depth = ((exponent + 1) * mass / stiffness * paid(v)) ** (1 / (exponent + 1))
    errors = []
    for rate in (96e3, 384e3):
        start = 3.4 * v / rate
        out, f = free_mass(
            make, Contact(stiffness, exponent, loss), int(rate * 6 * depth / v), 1 / rate,
            mass=mass, start=start, speed=-v,
        )  # fmt: skip
        assert f[0] == 0.0
        assert abs(f[-1]) < 1e-12 * f.max()
        assert -out[:, 0].min() == pytest.approx(depth, rel=0.01)
        errors.append(abs(out[-1, 1] / back - 1))
    assert errors[-1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.4)


@STEPPERS
def test_a_barrier_that_comes_throws_a_mass_at_twice_its_speed(make):
    n, dt, speed = 400, 1e-5, 1.5
    course = -1e-3 + speed * dt * np.arange(n + 1)
    out, f = free_mass(
        make, Contact(1e7, 1.5), n, dt, mass=0.01, start=0.0, speed=0.0,
        controls=[PrescribedMotion("law", 0, offset=course)],
    )  # fmt: skip
    assert f[-1] == 0.0
    assert np.all(out[:60] == 0.0)
    assert out[-1, 1] == pytest.approx(2 * speed, rel=1e-9)


@STEPPERS
def test_a_block_that_slides_stops_where_coulomb_says_and_stays(make):
    mass, pressed, mu, v, dt = 0.2, 3.0, 0.4, -1.3, 1e-4
    decel = mu * pressed / mass
    out, f = free_mass(make, Friction(pressed, mu, mu), 2500, dt, mass=mass, start=0.1, speed=v)
    sliding = np.arange(int(-v / decel / dt))
    t = sliding * dt
    np.testing.assert_allclose(out[sliding, 0], 0.1 + v * t + 0.5 * decel * t**2, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(f[sliding], mu * pressed, rtol=1e-9, atol=1e-12)
    # the step in which it stops ends with a gap that has not moved since: off by less than the last step's slide
    assert out[-1, 0] == pytest.approx(0.1 - v**2 / (2 * decel), abs=decel * dt**2)
    assert np.ptp(out[len(t) + 3 :, 0]) < 1e-12


@pytest.mark.slow
@STEPPERS
def test_a_mass_on_a_belt_sticks_and_slips(make):
    """Phase after phase: it rides until the spring asks for more than friction has, and slides until it rides."""
    mass, omega, sigma, belt = 0.1, 2 * math.pi * 40.0, 6.0, 0.2
    law = Friction(20.0, 0.8, 0.3, 0.05, belt)
    k, c = mass * omega**2, 2 * sigma * mass

    def slide(t, y):
        return [y[1], (-k * y[0] - c * y[1] + hyperbola(law, y[1] - belt)) / mass]

    def rides(t, y):
        return y[1] - belt

    rides.terminal, rides.direction = True, 1.0
    released = (0.8 * 20.0 - c * belt) / k
    duration, dt = 0.14, 1 / 16000
    grid = np.arange(int(duration / dt)) * dt
    exact, t, u, slips = np.zeros(len(grid)), 0.0, 0.0, []
    while t < duration:
        end = t + (released - u) / belt
        here = (grid >= t) & (grid < end)
        exact[here] = u + belt * (grid[here] - t)
        slips.append(end)
        # off the belt by less than the steps resolve, so that the event is the next meeting
        way = solve_ivp(
            slide, (end, end + 0.1), [released, belt * (1 - 1e-9)], "DOP853", events=rides, dense_output=True,
            rtol=1e-9, atol=1e-12,
        )  # fmt: skip
        t, u = way.t_events[0][0], way.y_events[0][0][0]
        here = (grid >= end) & (grid < t)
        if here.any():
            exact[here] = way.sol(grid[here])[0]
    assert len(slips) >= 4
    basis = ModalBasis.real([omega], [sigma], {"p": [1.0]}, modal_mass=mass)
    errors = []
    for step in (4 * dt, dt):
        system = System.build({"part": basis}, [Connection("law", (Term("part", "p"),), law)], BOTH, dt=step)
        state = system.start()
        state.modes[1, 0] = -0.5 * belt * math.sqrt(mass) / basis.poles.imag[0]
        out, forces = make(system).run(state, int(duration / step + 0.5))
        errors.append(np.abs(out[:, 0] - exact[:: round(step / dt)]).max())
        ratio = forces[:, 0] / law.normal_force
        assert 0.8 * 0.98 < ratio.max() <= 0.8 * (1 + 1e-9)
    assert errors[1] < 0.02 * np.abs(exact).max()
    assert errors[1] < 0.4 * errors[0]


LENGTH, DENSITY, TENSION = 0.65, 3.6e-3, 70.0


@pytest.mark.slow
@STEPPERS
@pytest.mark.parametrize("alone", [True, False], ids=["alone", "with contact and friction"])
def test_rising_tension_is_that_of_the_kirchhoff_carrier_string(make, alone):
    """q'' + 2 sigma q' + omega^2 q = -dV/dq + laws, V = EA/(8 L) (sum a q^2)^2, over both polarizations."""
    axial, sigma, n = 2e4, 5.0, np.arange(1, 4)
    a = (n * np.pi / LENGTH) ** 2 / DENSITY
    omega = n * np.pi / LENGTH * np.sqrt(TENSION / DENSITY)
    place, rub = (np.sin(n * np.pi * x) * math.sqrt(2 / (DENSITY * LENGTH)) for x in (0.3, 0.22))
    basis = ModalBasis.real(omega, sigma + 0 * omega, {"p": place, "r": rub}, metadata={"length": LENGTH})
    contact, law = Contact(2e4, 1.5, loss=0.2, offset=-1e-3), Friction(0.3, 0.9, 0.2, 1.0, velocity=-9.0)
    row_c, row_f = np.concatenate([place, 0 * n]), np.concatenate([rub, 0.5 * rub])

    def rates(t, y):
        q, v = y[:6], y[6:]
        weights = np.tile(a, 2)
        f = -2 * sigma * v - np.tile(omega, 2) ** 2 * q - axial / (2 * LENGTH) * (weights @ q**2) * weights * q
        if not alone:
            p, r = -1e-3 - row_c @ q, -row_c @ v
            f = f + row_c * (2e4 * max(p, 0.0) ** 1.5 * (1 + 0.2 * r)) + row_f * hyperbola(law, row_f @ v + 9.0)
        return np.concatenate([v, f])

    start = 1e-3 * np.array([4.0, -0.6, 0.3, 1.0, 0.5, 0.0]) * math.sqrt(DENSITY * LENGTH / 2)
    coarse, duration = 12000, 0.012
    grid = np.arange(int(coarse * duration)) / coarse
    exact = solve_ivp(rates, (0, duration), [*start, *np.zeros(6)], "DOP853", grid, rtol=1e-10, atol=1e-14).y[:6].T
    exact = np.stack([exact[:, :3] @ place, exact[:, 3:] @ place], axis=1)
    connections = [
        Connection("fret", (Term("x", "p"),), contact), Connection("bow", (Term("x", "r"), Term("y", "r", 0.5)), law)
    ]  # fmt: skip
    readouts = [Readout(name, "displacement", (Term(name, "p"),)) for name in "xy"]
    errors = []
    for k in (4, 8):  # below these rates an error of the fourth order is as large, and of the other sign
        system = System.build(
            dict.fromkeys("xy", basis), [] if alone else connections, readouts, dt=1 / (k * coarse),
            potentials=[TensionModulation("string", ("x", "y"), axial, weights=dict.fromkeys("xy", a))],
        )  # fmt: skip
        state = system.start()
        for name, q in zip("xy", np.split(start, 2), strict=True):
            modes = system.modes_of(state, name)
            modes[:, :3] = q / 2, q / 2 * basis.poles.real / basis.poles.imag
        out, _ = make(system).run(state, k * len(grid))
        errors.append(np.abs(out[::k] - exact).max())
    assert_second_order(errors, np.abs(exact).max())


@STEPPERS
def test_a_part_that_yields_in_series_softens_a_contact(make):
    """Modes left out, of compliance R, in series with K: K / (1 + K R)."""
    stiffness, residual = 2e5, 8e-6
    motion = []
    for law, R in ((Contact(stiffness), residual), (Contact(stiffness / (1 + stiffness * residual)), 0.0)):
        basis = ModalBasis.real([2 * math.pi * 200.0], [3.0], {"p": [1.0]}, modal_mass=0.1, residual=np.array([[R]]))
        system = System.build({"part": basis}, [Connection("law", (Term("part", "p"),), law)], BOTH, dt=1 / 64000)
        state = system.start()
        state.modes[0, 0] = 0.5e-3 * math.sqrt(0.1)
        motion.append(make(system).run(state, 1000)[0][:, 1])
    assert np.abs(motion[0] - motion[1]).max() < 2e-3 * np.abs(motion[1]).max()
