"""Energy accounts: closed forms against quadrature, balances that close, and mistakes that keep them open."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.integrate import quad_vec

from assembled import chain, merged, uneven
from random_bodies import mechanical_storage
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import Drive, Readout, System
from tonewood.physics.energy.account import EnergyAccount, KnownForce
from tonewood.physics.energy.forms import ComponentEnergy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import real_form
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000


@pytest.mark.parametrize("zeta", [0.0, 0.02, 0.71, 1.0, 4.0])
@pytest.mark.parametrize("turn", [0.0, 0.01, 0.7, 3.0, 25.0])
@pytest.mark.parametrize("share", [1.0, 0.13])
def test_loss_and_work_over_a_step_are_the_integrals(turn, zeta, share):
    """A mode under a parabola of force; quadrature of the augmented system's exponential."""
    omega = turn / DT
    sigma = zeta * omega if turn else zeta * 1e3
    basis = ModalBasis.real([omega], [sigma], {"p": [3.0]}, modal_mass=0.7)
    energy = ComponentEnergy(basis, ["p"], DT)
    d = share * DT
    force = np.array([2.0, -1.5, 4.0])  # in tau = t / d
    form = real_form(basis)
    to_motion = np.stack([form.C[0, 0], form.C[0, 0] @ form.A[0]])
    # by hand: u, v of the point of mass 0.7/9, time in units of d
    A = np.array([[0, 1.0, 0, 0, 0], [-((omega * d) ** 2), -2 * sigma * d, d * d * 9 / 0.7, 0, 0]])
    A = np.vstack([A, np.eye(5)[3], np.eye(5)[4], np.zeros(5)])
    start = np.array([2e-4, -3e-4])  # u, v d
    begin = np.concatenate([start, force * [1, 1, 2]])

    def integrand(tau):
        v = (sla.expm(A * tau) @ begin)[1] / d
        return np.array([2 * sigma * 0.7 / 9 * v * v, *(v * tau**j for j in range(3))])

    pieces = max(1, int(turn * share))
    exact = d * sum(
        quad_vec(integrand, i / pieces, (i + 1) / pieces, epsrel=1e-12, epsabs=0, quadrature="gk21")[0]
        for i in range(pieces)
    )
    x = sla.solve(to_motion, [start[0], start[1] / d])[None, None]
    forms = energy.forms(d)
    s = energy.start(x, force[None, None])
    scale = 0.7 / 9 * (start[1] / d) ** 2
    np.testing.assert_allclose(energy.lost(forms, s)[0], exact[0], rtol=1e-10, atol=1e-13 * scale)
    size = np.abs(exact[1:]).max() + d * abs(start[1] / d)
    np.testing.assert_allclose(energy.moments(forms, s, "p")[0], exact[1:], rtol=1e-10, atol=1e-12 * size)
    u, v = (sla.expm(A) @ begin)[:2]
    moved = to_motion @ energy.flow(forms, s)[0, 0]
    np.testing.assert_allclose(moved, [u, v / d], rtol=1e-9, atol=1e-12 * np.abs(moved).max())
    stored = 0.5 * 0.7 / 9 * ((start[1] / d) ** 2 + (omega * start[0]) ** 2)
    assert energy.stored(x)[0] == pytest.approx(stored, rel=1e-12)


def test_a_stiff_mode_loses_what_it_had():
    """omega h = 1000, zeta = 10: nothing overflows, and released from displacement it loses its spring's energy."""
    omega = 1000 / DT
    basis = ModalBasis.real([omega], [10 * omega], {"p": [1.0]})
    energy = ComponentEnergy(basis, ["p"], DT)
    x = np.array([[[1e-6, 0.0]]])
    s = energy.start(x, np.zeros((1, 1, 1)))
    forms = energy.forms(DT)
    after = energy.stored(energy.flow(forms, s))[0]
    assert energy.lost(forms, s)[0] == pytest.approx(energy.stored(x)[0] - after, rel=1e-6)
    assert after < 1e-20 * energy.stored(x)[0]


RAMP = (Segment(0.0, 5.3e-3, 0.0, 1000.0), Segment(5.3e-3, 5.45e-3, 5.3, -5.3 / 1.5e-4))
TAP = (Segment(0.0, 4e-4, 0.0, 8e4, -2e8),)


def scene(*, undamped=False, residual=2e-9, dt=DT):
    """Two strings on a body with a rigid mode; one rigid joint, one that yields, a spring and a dashpot."""
    rng = np.random.default_rng(4)
    loss = 0.0 if undamped else 1.0

    def string(n, freq):
        k = np.arange(1, n + 1)
        omega = 2 * np.pi * freq * k * np.sqrt(1 + 4e-5 * k**2)
        shapes = rng.normal(size=(2, n)) * 15
        points = {"bridge": shapes[0], "pluck": shapes[1]}
        return ModalBasis.real(omega, loss * (1 + 1e-4 * omega), points, residual=np.diag([residual, 0.0]))

    omega = np.concatenate([[0.0, 0.0], 2 * np.pi * np.geomspace(90, 9000, 20)])
    sigma = loss * 0.01 * omega
    sigma[1], sigma[2] = loss * 50.0, loss * 3 * omega[2]
    body = ModalBasis.real(omega, sigma, {p: rng.normal(size=22) * 2 for p in ("b0", "b1", "top")})
    links = [
        Connection("c0", (Term("s0", "bridge"), Term("body", "b0", -0.95))),
        Connection("c1", (Term("s1", "bridge"), Term("body", "b1", -1.0))),
        Connection("spring", (Term("s0", "pluck"), Term("s1", "pluck", -1.0)), SpringDashpot(800.0, 0.0, 1e-5)),
        Connection("finger", (Term("s1", "pluck"),), SpringDashpot(0.0, loss * 0.3)),
        Connection("idle", (Term("body", "top"),), SpringDashpot()),
    ]
    readouts = [Readout("v", "velocity", (Term("body", "top"),))]
    system = System.build({"s0": string(40, 110.0), "s1": string(30, 147.0), "body": body}, links, readouts, dt=dt)
    known = [
        KnownForce("finger", "s0", "pluck", RAMP, time=1.23e-3),
        KnownForce("tap", "body", "top", TAP, time=8.0003e-3, factor=-0.5),
    ]
    return system, known


def injections_of(system, known):
    out = []
    for k in known:
        basis = system.compiled[system.slot(k.component)].basis
        out += compile_force(k.component, basis, k.point, k.pieces, system.dt, time=k.time, factor=k.factor)
    return out


def followed(system, known, steps, *, interval=1, stepper=None, account=None, block=480, injections=None):
    stepper = stepper or KernelStepper(system)
    state = system.start()
    account = account or EnergyAccount(system, state, interval)
    injections = injections_of(system, known) if injections is None else injections
    for _ in range(0, steps, block):
        before = state.copy()
        _, forces = stepper.run(state, block, injections)
        account.follow(before, state, forces, injections, known)
    return account.trace()


def limit(trace):
    return 1e-10 + 4e-16 * int(trace.steps.sum())


@pytest.mark.parametrize("make", [KernelStepper, NumpyStepper])
def test_every_step_adds_up(make):
    system, known = scene()
    trace = followed(system, known, 960, stepper=make(system))
    assert trace.time.size == 960
    assert trace.worst_residual < 1e-12
    assert trace.worst_cumulative_residual < 1e-12
    assert set(trace.stored) == {"s0", "s1", "body", "c0", "c1", "spring"}
    assert set(trace.lost) == {"s0", "s1", "body", "finger"}
    assert set(trace.supplied) == {"finger", "tap"}
    assert all(np.all(v >= 0) for v in trace.lost.values())
    assert trace.supplied["finger"].sum() > 0
    assert trace.peak > 0


def test_long_balance_stays_closed():
    system, known = scene()
    trace = followed(system, known, 48000, interval=64, block=4800)
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < limit(trace)


def test_undamped_parts_lose_nothing():
    system, known = scene(undamped=True)
    trace = followed(system, known, 9600, interval=64)
    assert all(not v.any() for v in trace.lost.values())
    assert trace.worst_cumulative_residual < limit(trace)
    # after the last force the sum of all parts stays
    after = trace.total[trace.time > 0.01]
    np.testing.assert_allclose(after, after[-1], rtol=1e-11)


def test_work_of_a_force_on_a_free_mass_is_the_textbook_one():
    basis = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=0.4)
    system = System.build({"m": basis}, [], dt=1e-3)
    force = KnownForce("push", "m", "p", (Segment(0.0, 7.77e-3, 3.0),), time=2.5e-4)
    trace = followed(system, [force], 20, block=20)
    assert trace.supplied["push"].sum() == pytest.approx((3.0 * 7.77e-3) ** 2 / (2 * 0.4), rel=1e-12)
    assert trace.total[-1] == pytest.approx((3.0 * 7.77e-3) ** 2 / (2 * 0.4), rel=1e-12)


def test_intervals_gather_steps():
    system, known = scene()
    fine = followed(system, known, 960)
    coarse = followed(system, known, 960, interval=64)
    np.testing.assert_array_equal(coarse.steps, np.tile([*[64] * 7, 32], 2))  # each run of 480 begins anew
    ends = np.cumsum(coarse.steps)
    np.testing.assert_allclose(coarse.time, ends * DT)
    np.testing.assert_allclose(coarse.lost["s0"].cumsum(), fine.lost["s0"].cumsum()[ends - 1], rtol=1e-12)
    np.testing.assert_allclose(coarse.stored["body"], fine.stored["body"][ends - 1], rtol=1e-9)


class Tampered:
    """A stepper whose propagators are not those of the basis."""

    def __init__(self, system, slot, factor):
        compiled = system.compiled[slot]
        wrong = replace(compiled, E=compiled.E * factor)
        others = system.compiled
        self.stepper = NumpyStepper(replace(system, compiled=(*others[:slot], wrong, *others[slot + 1 :])))

    def run(self, *args):
        return self.stepper.run(*args)


def test_wrong_propagator_keeps_the_balance_open():
    """Modes that decay faster than their losses say: a millionth per step is seen."""
    system, known = scene()
    trace = followed(system, known, 960, stepper=Tampered(system, 0, 1 - 1e-6), interval=480)
    assert trace.worst_residual > 1e-6
    assert followed(system, known, 960, interval=480).worst_residual < 1e-12


def account_with(system, slot, **changes):
    """An account that believes in other numbers than those that are stepped; its own path follows the true ones."""
    account = EnergyAccount(system, system.start(), 480)
    true = account._energy_of(system.names[slot])
    basis = system.compiled[slot].basis
    believed = ComponentEnergy(replace(basis, **changes), basis.points, system.dt)
    true._N, true._by_duration = believed._N, {}
    return account


def test_wrong_loss_keeps_the_balance_open():
    system, known = scene()
    rate = system.compiled[0].basis.damping_rate
    trace = followed(system, known, 960, account=account_with(system, 0, damping_rate=rate * 1.0001))
    assert trace.worst_residual > 1e-7
    trace = followed(system, known, 960, account=account_with(system, 0, damping_rate=rate))
    assert trace.worst_residual < 1e-12


def test_a_loss_that_one_mode_does_not_have_keeps_the_balance_open():
    system, known = scene()
    rate = system.compiled[0].basis.damping_rate.copy()
    rate[3] = 0.0
    trace = followed(system, known, 960, account=account_with(system, 0, damping_rate=rate))
    assert trace.worst_residual > 1e-6


def test_force_that_is_not_what_was_injected_keeps_the_balance_open():
    system, known = scene()
    late = [replace(known[0], time=known[0].time + 0.01 * DT), known[1]]
    trace = followed(system, known, 960, injections=injections_of(system, late), interval=480)
    assert trace.worst_residual > 1e-7


def test_wrong_connection_force_keeps_the_balance_open():
    system, known = scene()

    class Reported(NumpyStepper):
        def run(self, *args):
            out, forces = super().run(*args)
            return out, forces * (1 + 1e-6)

    trace = followed(system, known, 960, stepper=Reported(system), interval=480)
    assert trace.worst_residual > 1e-9


def test_change_between_steps_must_be_booked():
    system, known = scene()
    stepper, state = KernelStepper(system), system.start()
    injections = injections_of(system, known)

    booked, silent = EnergyAccount(system, state), EnergyAccount(system, state)
    before = state.copy()
    _, forces = stepper.run(state, 960, injections)
    for account in (booked, silent):
        account.follow(before, state, forces, injections, known)
    held = sum(booked.stored(state).values())
    system.modes_of(state, "s1")[:] *= 0.5
    left = sum(booked.stored(state).values())
    booked.book("damped by hand", left - held)
    before = state.copy()
    _, forces = stepper.run(state, 960)
    for account in (booked, silent):
        account.follow(before, state, forces)
    assert abs(left - held) > 0.1 * held
    assert booked.trace().worst_residual < 1e-12
    assert booked.trace().booked["damped by hand"].sum() == left - held
    assert silent.trace().residual.sum() == pytest.approx(left - held, rel=1e-9)


def test_exchanged_basis_goes_on_with_its_own_losses():
    system, known = scene()
    stepper, state = KernelStepper(system), system.start()
    account = EnergyAccount(system, state)
    injections = injections_of(system, known)
    before = state.copy()
    account.follow(before, state, stepper.run(state, 960, injections)[1], injections, known)
    basis = system.compiled[0].basis
    damped = ModalBasis.real(
        np.sqrt(basis.stiffness), basis.damping_rate + 20.0,
        dict(zip(basis.points, basis.right.real, strict=True)), residual=basis.residual,
    )  # fmt: skip
    changed = system.with_basis("s0", damped)
    moved = from_motion(damped, *to_motion(basis, system.modes_of(state, "s0")))
    changed.modes_of(state, "s0")[:] = moved
    stepper.exchange(changed)
    account.exchange(changed)
    before = state.copy()
    account.follow(before, state, stepper.run(state, 960)[1])
    # displacement and velocity carry over, so added damping books nothing
    assert account.trace().worst_residual < 1e-12
    assert account.trace().lost["s0"][-15:].sum() > 3 * account.trace().lost["s0"][:15].sum()


def complex_scene():
    part = uneven(6, seed=3, zeta=0.05, stiffness=4e7)
    body = part.complex_basis(["n5", "n0", "n2"])
    string = chain(8, seed=2, stiffness=1e7, mass=0.01).real_basis(["n0", "n7"])
    links = [
        Connection("joint", (Term("string", "n7"), Term("body", "n5", -1.0))),
        Connection("spring", (Term("body", "n2"),), SpringDashpot(1e5, 3.0)),
    ]
    system = System.build({"body": body, "string": string}, links, dt=DT)
    known = [
        KnownForce("pluck", "string", "n0", RAMP, time=1e-3),
        KnownForce("tap", "body", "n0", TAP, time=3.7003e-3),
    ]
    return part, system, known


def test_complex_modes_with_their_storage_function_add_up():
    _, system, known = complex_scene()
    assert not system.compiled[0].basis.is_real
    account = EnergyAccount(system, system.start(), 1, driven_points={"body": ("n0",)})
    trace = followed(system, known, 960, account=account)
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < limit(trace)
    assert np.all(trace.lost["body"] >= -1e-12 * trace.peak)


def test_mechanical_energy_of_a_complete_set_of_complex_modes():
    part, system, known = complex_scene()
    basis = part.complex_basis()
    exact = mechanical_storage(basis.poles, basis.right, basis.left, part.M, part.C, part.K)
    ports = [part.n - 1, 2, 0]
    storage = replace(exact, cross=exact.cross[:, ports], direct=exact.direct[np.ix_(ports, ports)])
    account = EnergyAccount(system, system.start(), 1, {"body": storage}, {"body": ("n0",)})
    trace = followed(system, known, 960, account=account)
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < limit(trace)
    # its value at the end is (v M v + u K u) / 2
    wrong = replace(storage, Q=storage.Q * 1.001)
    account = EnergyAccount(system, system.start(), 480, {"body": wrong}, {"body": ("n0",)})
    assert followed(system, known, 960, account=account).worst_residual > 1e-6


def test_stored_energy_is_that_of_the_matrices(rng):
    parts = {"a": chain(4, seed=1), "b": chain(3, seed=2)}
    spring = Connection("k", (Term("a", "n3"), Term("b", "n0", -1.0)), SpringDashpot(3e5, 0.0, 1e-3))
    system = System.build({n: p.real_basis() for n, p in parts.items()}, [spring], dt=DT)
    state = system.start()
    u, v, start = rng.normal(size=7), rng.normal(size=7), 0
    for name, part in parts.items():
        form = real_form(system.compiled[system.slot(name)].basis)
        rows = [form.rows(q, np.arange(part.n)).reshape(part.n, -1) for q in ("displacement", "velocity")]
        span = slice(start, start + part.n)
        x = sla.solve(np.concatenate(rows), np.concatenate([u[span], v[span]]))
        system.modes_of(state, name)[:] = x.reshape(-1, 2).T
        start += part.n
    stored = EnergyAccount(system, state).stored(state)
    whole = merged(*parts.values())
    mechanical = 0.5 * (v @ whole.M @ v + u @ whole.K @ u)
    assert stored["a"] + stored["b"] == pytest.approx(mechanical, rel=1e-10)
    assert stored["k"] == pytest.approx(0.5 * 3e5 * (u[3] - u[4] - 1e-3) ** 2, rel=1e-10)


def test_microphones_are_left_out():
    basis = chain(3, seed=1).real_basis()
    ground = Connection("ground", (Term("a", "n2"),))
    system = System.build({"a": basis, "mic": basis}, [ground], dt=1e-3, drives=[Drive("mic", "n0", "ground")])
    known = [KnownForce("push", "a", "n0", (Segment(0.0, 0.0123, 1.0),))]
    trace = followed(system, known, 480)
    assert set(trace.stored) == {"a"}
    assert trace.worst_residual < 1e-12


def test_trace_goes_to_json_and_to_a_picture(tmp_path):
    system, known = scene()
    trace = followed(system, known, 960, interval=64)
    data = json.loads(json.dumps(trace.to_dict()))
    assert data["schema"] == "tonewood-energy/1"
    assert len(data["stored"]["body"]) == len(data["time"]) == len(data["residual"])
    energy = np.sum([trace.lost[n] for n in trace.lost], axis=0)
    np.testing.assert_allclose(trace.power_lost * trace.steps * DT, energy)
    trace.plot(tmp_path / "energy.png")
    assert (tmp_path / "energy.png").stat().st_size > 10_000


def test_nothing_happened_is_an_empty_trace():
    system, _ = scene()
    trace = EnergyAccount(system, system.start()).trace()
    assert trace.time.size == 0
    assert trace.worst_residual == 0.0
    assert json.dumps(trace.to_dict())
