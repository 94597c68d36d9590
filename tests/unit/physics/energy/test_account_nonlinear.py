"""Energy accounts of scenes with contacts, friction, moving partners and rising tension."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import PrescribedMotion, System
from tonewood.physics.energy.account import EnergyAccount, KnownForce
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000
RAMP = (Segment(0.0, 2.3e-3, 0.0, 2000.0), Segment(2.3e-3, 2.41e-3, 4.6, -4.6 / 1.1e-4))


def string(n=24, residual=3e-7):
    k = np.arange(1, n + 1)
    omega = 2 * np.pi * 196.0 * k
    shape = lambda x: np.sin(k * np.pi * x) * np.sqrt(2 / 4e-4)  # noqa: E731
    points = {"pluck": shape(0.2), "barrier": shape(0.37), "end": shape(0.05)}
    return ModalBasis.real(omega, 1.0 + 2e-4 * omega, points, residual=residual * np.eye(3))


def body():
    return ModalBasis.real(2 * np.pi * np.array([100.0, 230.0, 410.0]), [9.0, 14.0, 20.0], {"top": [1.5, 1.0, -2.0]})


LAWS = {
    "contact": Contact(4e8, 1.5, 0.0, -2e-5),
    "lossy contact": Contact(1e6, 1.0, 0.8, -2e-5),
    "contact without series": Contact(1e7, 2.3, 0.1, -2e-5, residual=False),
    "hardening spring": HardeningSpring(2e3, 1e10, 0.2, 3.0),
    "sampled force": SampledPotential.from_force([-1e-3, -2e-5, 0.0, 1e-3], [900.0, 2.0, 0.0, 0.0], loss=0.5),
    "bow": Friction(0.8, 0.7, 0.3, 0.1, 0.15),
}


def scene(law, dt=DT):
    links = [
        Connection("joint", (Term("string", "end"), Term("body", "top", -1.0)), Rigid()),
        Connection("law", (Term("string", "barrier"), Term("body", "top", -0.5)), law),
        Connection("finger", (Term("string", "pluck"),), SpringDashpot(50.0, 0.02)),
    ]
    system = System.build({"string": string(), "body": body()}, links, dt=dt)
    return system, [KnownForce("pluck", "string", "pluck", RAMP, time=5.3e-4)]


def followed(system, known, steps, *, make=KernelStepper, account=None, controls=(), interval=1, block=240):
    stepper, state = make(system), system.start()
    account = account or EnergyAccount(system, state, interval)
    injections = []
    for k in known:
        basis = system.compiled[system.slot(k.component)].basis
        injections += compile_force(k.component, basis, k.point, k.pieces, system.dt, time=k.time, factor=k.factor)
    for _ in range(0, steps, block):
        before = state.copy()
        _, forces = stepper.run(state, block, injections, controls)
        account.follow(before, state, forces, injections, known, controls)
    return account.trace()


@pytest.mark.parametrize("make", [KernelStepper, NumpyStepper])
@pytest.mark.parametrize("name", LAWS)
def test_every_step_adds_up(name, make):
    """Residual of each step below 1e-10 of the peak: contacts are solved to 1e-12 of the displacement."""
    system, known = scene(LAWS[name])
    trace = followed(system, known, 720 if make is KernelStepper else 240, make=make)
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < 1e-10 + 4e-16 * 720
    assert all(np.all(values >= -1e-13 * trace.peak) for values in trace.lost.values())
    if name != "bow":
        assert trace.stored["law"].max() > 0  # it was touched
    if "loss" in name or "force" in name or "spring" in name:
        assert trace.lost["law"].sum() > 1e-6 * trace.peak


def test_bow_supplies_and_heats():
    """A bow keeps the string going: its work goes into heat at the contact and losses of the parts."""
    system, _ = scene(LAWS["bow"])
    trace = followed(system, [], 9600, block=960, interval=96)
    assert trace.worst_residual < 1e-10
    supplied, heat = trace.supplied["law"].sum(), trace.lost["law"].sum()
    assert supplied > heat > 0
    parts = sum(values.sum() for name, values in trace.lost.items() if name != "law")
    assert supplied == pytest.approx(heat + parts + trace.total[-1], rel=1e-9)


@pytest.mark.parametrize("name", ["contact", "lossy contact", "hardening spring"])
def test_moving_partner_is_outside_work(name):
    """A barrier pushed through the string and taken back, at a pressure that rises: its work is all that goes in."""
    system, _ = scene(LAWS[name])
    t = np.arange(961) / 960
    offset = LAWS[name].offset + 3e-4 * np.sin(np.pi * t) ** 2
    control = PrescribedMotion("law", 37, offset=offset, scale=0.5 + t[1:])
    trace = followed(system, [], 1440, controls=[control])
    assert trace.worst_residual < 1e-10
    assert np.abs(trace.supplied["law"]).sum() > 0.1 * trace.peak
    assert trace.supplied["law"].sum() > 0
    assert not trace.supplied["law"][1100:].any()


def test_bowing_control_carries_the_work_of_the_bow():
    system, _ = scene(Friction(1.0, 0.7, 0.3, 0.1))
    ramp = np.minimum(np.arange(960) / 480, 1.0)
    trace = followed(system, [], 960, controls=[PrescribedMotion("law", 0, velocity=0.2 * ramp, scale=ramp)])
    assert trace.worst_residual < 1e-10
    assert trace.supplied["law"].sum() > 0


def stretched(dt=DT):
    omega = 2 * np.pi * 110.0 * np.arange(1, 19)
    weights = (np.arange(1, 19) * np.pi) ** 2 / 2 / (6e-3 * 0.65 / 2) / 0.65

    def polarization(seed):
        rng = np.random.default_rng(seed)
        return ModalBasis.real(
            omega, 1.0 + 1e-4 * omega, {"end": rng.normal(size=18), "pluck": rng.normal(size=18) * 8}
        )

    tension = TensionModulation("E2", ("a", "b"), 2e4, 0.65, {"a": weights, "b": weights})
    links = [Connection("joint", (Term("a", "end"), Term("body", "top", -1.0)))]
    system = System.build(
        {"a": polarization(1), "b": polarization(2), "body": body()}, links, dt=dt, potentials=[tension]
    )
    known = [KnownForce("pluck", p, "pluck", RAMP, time=5.3e-4, factor=f) for p, f in (("a", 20.0), ("b", 9.0))]
    return system, known


def test_rising_tension_adds_up():
    """Two polarizations share one tension; its energy comes and goes, the sum closes with every step."""
    system, known = stretched()
    trace = followed(system, known, 240, make=NumpyStepper)
    assert trace.stored["E2.tension"].max() > 0.01 * trace.peak
    assert trace.worst_residual < 1e-10
    assert trace.worst_cumulative_residual < 1e-10


def test_tension_that_is_left_out_keeps_the_balance_open():
    system, known = stretched()
    account = EnergyAccount(system.with_potentials([]), system.start(), 48)
    assert followed(system, known, 120, make=NumpyStepper, account=account, block=120).worst_residual > 1e-4


@pytest.mark.parametrize(
    ("name", "change"), [("lossy contact", {"loss": 0.801}), ("hardening spring", {"damping": 0.201})]
)
def test_wrong_loss_of_a_law_keeps_the_balance_open(name, change):
    system, known = scene(LAWS[name])
    wrong = system.with_laws({"law": replace(system.connections[1], law=replace(LAWS[name], **change))})
    account = EnergyAccount(system, system.start(), 720)
    account.exchange(wrong)
    assert followed(system, known, 720, account=account, block=720).worst_residual > 1e-7


def test_wrong_force_of_a_law_keeps_the_balance_open():
    system, known = scene(LAWS["contact"])

    class Sloppy(NumpyStepper):
        def run(self, *args):
            out, forces = super().run(*args)
            return out, forces * np.array([1.0, 1 + 1e-5, 1.0])

    assert followed(system, known, 720, make=Sloppy, interval=240).worst_residual > 1e-9
