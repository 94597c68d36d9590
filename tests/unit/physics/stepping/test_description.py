"""Arrays for the kernel against what they are made of, counts of steppers, courses of known forces and controls."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Drive, PrescribedMotion, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.description import (
    describe_component,
    describe_linear,
    describe_potentials,
    law_arrays,
    packed,
    sort_ports,
)
from tonewood.physics.stepping.forcing import Course, SampledForce, Segment, compile_force, controlled, course
from tonewood.physics.stepping.kept_descriptions import KeptDescriptions
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts, compiler
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1e-4
CONTACT = Contact(1e6, 1.5, 0.2, -1e-4)


@pytest.mark.parametrize(("n", "width"), [(0, 16), (1, 16), (16, 16), (17, 32)])
def test_packed_arrays_have_modes_last_and_zeros_behind(n, width):
    a = np.arange(1.0, 2 * n * 3 + 1).reshape(2, n, 3)
    out = packed(a)
    assert out.shape == (2, 3, width)
    np.testing.assert_array_equal(out[:, :, :n], a.transpose(0, 2, 1))
    assert not out[:, :, n:].any()


def test_ports_are_sorted_by_the_connections_that_act_on_them():
    """Five connections: linear at place 1, contact, other law, one at rest, and a contact on a linear one's port."""
    shares = np.array(
        [
            [2.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, -1.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 3.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 5.0, 0.0],
            [0.5, 0.0, 0.0, 0.0, 4.0],
        ]
    )
    use = np.array([[1, 0], [-1, 2], [-1, 1], [-1, 0], [-1, 2]])
    sets, terms = sort_ports(shares, use, 3, coupled=False, one_way=False, hub_ports=None)
    assert (sets.fixed.tolist(), sets.contact.tolist()) == ([0, 2], [1, 4])
    assert sets.incidence.tolist() == [[0.0, 0.0], [2.0, 0.0], [0.0, 0.0]]
    assert terms == [(1, 0, True, -1.0), (2, 1, False, 3.0), (4, 0, False, 0.5), (4, 1, True, 4.0)]
    assert (sets.coupled, sets.is_hub) == (False, False)
    for options in ({"coupled": True, "one_way": False}, {"coupled": False, "one_way": True}):
        other, terms = sort_ports(shares, use, 3, hub_ports=None, **options)
        assert (other.fixed.tolist(), other.contact.tolist()) == ([0, 1, 2, 4], [])
        assert terms == [(1, 1, False, -1.0), (2, 2, False, 3.0), (4, 0, False, 0.5), (4, 3, False, 4.0)]
        assert other.coupled == options["coupled"]
        assert other.key != sets.key
    hub, _ = sort_ports(shares, use, 3, coupled=False, one_way=False, hub_ports=np.array([1, 3]))
    assert (hub.fixed.tolist(), hub.incidence.shape, hub.is_hub) == ([1, 2, 3], (0, 3), True)


def test_arrays_of_laws_and_of_those_that_are_exchanged():
    lines = SampledPotential.from_force([0.0, 1.0], [0.0, -2.0], offset=3.0, damping=0.5)
    laws = [CONTACT, lines, Friction(2.0, 0.9, 0.4, 0.2, 0.7)]
    arrays = law_arrays(laws)
    assert arrays["kinds"].tolist() == [0, 2, 4]
    np.testing.assert_allclose(
        arrays["numbers"],
        [[1e6, 1.5, 0, 0, 0.2, 0, -1e-4, 0], [0, 0, 0, 0, 0, 0.5, 3.0, 0], [2.0, 0.9, 0.4, 0.2, 0, 0, 0, 0.7]],
    )
    assert [(j, list(knots)) for j, knots, _ in arrays["samples"]] == [(1, [0.0, 1.0])]
    spring = HardeningSpring(1.0, 2.0, 3.0, 4.0, 5.0)
    new = law_arrays([CONTACT, spring, laws[2]], laws, arrays)
    assert (new["kinds"].tolist(), new["samples"]) == ([0, 1, 4], [])
    assert new["numbers"][1].tolist() == [1.0, 2.0, 4.0, 0.0, 0.0, 3.0, 5.0, 0.0]
    np.testing.assert_array_equal(new["numbers"][[0, 2]], arrays["numbers"][[0, 2]])
    assert arrays["kinds"].tolist() == [0, 2, 4]  # of the laws before: not changed
    assert law_arrays(laws[:1], laws, arrays)["kinds"].tolist() == [0]
    assert law_arrays(laws, laws, arrays)["samples"] == arrays["samples"]


def scene(**options) -> System:
    omega = 2 * np.pi * 200 * np.arange(1, 6)
    string = ModalBasis.real(omega, 2 + 1e-3 * omega, {"end": np.ones(5), "at": np.arange(1.0, 6), "x": -np.ones(5)})
    body = ModalBasis.real([600.0, 900.0], [9.0, 8.0], {"p": [1.0, 2.0], "q": [0.5, -1.0]})
    links = [
        Connection("joint", (Term("s", "end"), Term("body", "p", -1.0)), Rigid()),
        Connection("fret", (Term("s", "at", 2.0),), CONTACT),
        Connection("felt", (Term("s", "x"),), SpringDashpot(50.0, 0.1, 1e-5)),
        Connection("off", (Term("body", "q"),), SpringDashpot()),
    ]
    readouts = [
        Readout("u", "displacement", (Term("s", "at"),)),
        Readout("f", "force", (), (("felt", 2.0), ("fret", 3.0))),
        Readout("a", "acceleration", (Term("body", "p"), Term("s", "end", 0.5))),
    ]
    drives = [Drive("mic", "p", "joint", 2.0)]
    return System.build({"s": string, "body": body, "mic": body}, links, readouts, dt=DT, drives=drives, **options)


def test_description_of_a_system_is_made_of_its_arrays():
    system = scene(potentials=[TensionModulation("T", ("s",), 9.0, 0.5, {"s": np.arange(5.0)})])
    kept = KeptDescriptions({"fused_pass": True})
    found = kept.of(system)
    assert found["shortcuts"] == {"fused_pass": True}
    string, body, mic = found["components"]
    assert [c["key"] for c in found["components"]] == [0, 1, 2]
    assert [c["driven"] for c in found["components"]] == [False, False, True]
    assert [c["offset"] for c in found["components"]] == [0, 16, 32]
    s, b = system.compiled[:2]
    # ports in order of their names: at, end, x; the fret's is the contact port
    np.testing.assert_array_equal(string["rows"], packed(s.rows[[1, 2, 3, 4]]))
    np.testing.assert_array_equal(string["w"], packed(s.W[[1, 2]]))
    np.testing.assert_array_equal(string["contact_rows"], packed(s.rows[[0]]))
    np.testing.assert_array_equal(string["contact_w"], packed(s.W[[0]]))
    np.testing.assert_array_equal(string["response"], s.history[:, [1, 2]][:, :, [1, 2, 3, 4]])
    np.testing.assert_array_equal(string["from_fixed"], s.history[:, [1, 2]][:, :, [0]])
    np.testing.assert_array_equal(string["from_contact"], s.history[:, [0]][:, :, [0]])
    np.testing.assert_array_equal(string["on_rows"], s.history[:, [0]][:, :, [1, 2, 3, 4]])
    np.testing.assert_array_equal(string["e"], packed(s.E.reshape(1, 5, 4))[0])
    assert string["incidence"].tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert (string["channels"], string["difference"]) == ([0, 2], [0, 1])
    assert (body["channels"], body["difference"], body["incidence"].tolist()) == ([2], [1], [[-1.0], [0.0]])
    np.testing.assert_array_equal(body["rows"], packed(b.rows[[0, 2]]))
    assert mic["rows"].shape[0] == 0
    np.testing.assert_array_equal(mic["incidence"], [[2.0], [0.0]])
    y = s.coordinates
    for name, values in (("a", np.arange(5.0)), ("reading", y.reading), ("stiffness", y.stiffness)):
        np.testing.assert_array_equal(string[name], np.pad(values, (0, 11)))
    np.testing.assert_array_equal(string["kick"], packed(y.kick[None])[0])
    np.testing.assert_array_equal(string["velocity"], np.pad(y.velocity, ((0, 0), (0, 11))))
    np.testing.assert_array_equal(string["middle"], np.pad(y.middle, ((0, 0), (0, 11))))
    assert "a" not in body
    linear, laws = found["linear"], found["nonlinear"]
    np.testing.assert_array_equal(linear["gamma"], system.solve.gamma[[0, 2]])
    np.testing.assert_allclose(linear["constant"], system.solve.constant[[0, 2]], rtol=1e-12)
    np.testing.assert_array_equal(linear["inverse"], system.solve.inverse)
    assert linear["weights"].tolist() == [[0.0, 0.0], [0.0, 2.0], [0.0, 0.0]]
    assert laws["weights"].tolist() == [[0.0], [3.0], [0.0]]
    assert (laws["dt"], laws["terms"].tolist(), laws["factors"].tolist()) == (DT, [[0, 0, 0, 1]], [2.0])
    nonlinear = system.nonlinear
    assert laws["theta"] == nonlinear.theta
    for name, a in (("compliance", nonlinear.gaps.compliance), ("residual", nonlinear.residual),
                    ("from_linear", nonlinear.from_linear[:, [0, 2]]),
                    ("to_linear", nonlinear.gaps.to_linear[[0, 2]])):  # fmt: skip
        np.testing.assert_array_equal(laws[name], a)
    assert [(p["kind"], p["at"], p["slots"], p["scale"]) for p in found["potentials"]] == [(0, 0, [0], 4.5)]
    assert describe_potentials(system.with_potentials(())) == []
    # a component that did not change is not described again
    again = kept.of(system, frozenset({0, 2}))
    assert [set(c) == {"key"} for c in again["components"]] == [True, False, True]
    freed = kept.of(system.with_laws({"fret": Connection("fret", system.connections[1].terms, SpringDashpot())}))
    assert [c["key"] for c in freed["components"]] == [3, 1, 2]
    assert (freed["nonlinear"]["theta"], freed["nonlinear"]["to_linear"].shape) == (0.5, (2, 0))
    assert "contact_rows" not in freed["components"][0]
    assert [c["key"] for c in kept.of(system)["components"]] == [0, 1, 2]


def test_ports_of_a_rigid_bar_are_described_by_its_motions():
    points = {f"p{i}": [1.0, 0.3 * i] for i in range(4)}
    bar = ModalBasis.real([200.0, 310.0], [1.0, 2.0], points)
    links = [Connection(p, (Term("bar", p, i + 1.0),)) for i, p in enumerate(points)]
    system = System.build({"bar": bar}, links, dt=DT)
    compiled = system.compiled[0]
    use = np.array([[i, 0] for i in range(4)])
    sets, _ = sort_ports(system.layout.touching[0][1], use, 4, False, False, None)
    ports, span = compiled.motions(np.arange(4))
    found = describe_component(compiled, sets, one_way=False, loaded=False)
    np.testing.assert_allclose(found["incidence"], np.diag([1.0, 2, 3, 4]) @ span, rtol=1e-12)
    np.testing.assert_array_equal(found["w"], packed(compiled.W[ports]))
    loaded = describe_component(compiled, sets, one_way=False, loaded=True)
    np.testing.assert_array_equal(loaded["incidence"], np.diag([1.0, 2, 3, 4]))
    dense = describe_linear(system.solve, system.layout.force_weights, [sets], True)
    np.testing.assert_array_equal(dense["inverse"], system.solve.inverse)


def test_steppers_count_their_work():
    system = scene()
    pluck = compile_force("s", system.compiled[0].basis, "at", [Segment(0.0, 2e-3, -40.0)], DT)
    counts = []
    for make in (NumpyStepper, KernelStepper):
        stepper, state = make(system), system.start()
        for n in (50, 0, 70):
            _, forces = stepper.run(state, n, pluck)
        counts.append(stepper.statistics)
        assert (stepper.statistics.steps, stepper.statistics.failures, stepper.statistics.redone) == (120, 0, 0)
        assert state.sample == 120
        np.testing.assert_array_equal(state.forces, forces[-1])
    for c in counts:
        assert 0 < c.most_iterations <= c.iterations
        assert c.most_iterations < 30
    assert counts[0].solves == 120
    kernel = KernelStepper(system)
    assert kernel.statistics.steps == kernel.n_solves == 0
    _, acted = kernel.advance(system.start(), 120, pluck)
    assert acted.tolist() == [1]
    assert kernel.n_solves == kernel.statistics.solves == counts[1].solves > 0
    assert set(kernel.culling_statistics) == {"blocks", "rows_read", "added"}
    assert kernel.culling_statistics["blocks"] == 8  # 120 samples in blocks of 16
    _, still = kernel.advance(system.start(), 32)
    assert still.size == 0
    assert all(asdict(Shortcuts()).values())
    assert any(character.isdigit() for character in compiler())


def test_forces_of_laws_do_not_stay_from_run_to_run():
    system = scene()
    pluck = compile_force("s", system.compiled[0].basis, "at", [Segment(0.0, 2e-3, -40.0)], DT)
    stepper = KernelStepper(system)
    _, first = stepper.run(system.start(), 64, pluck)
    assert first[:, 1].any()
    assert not stepper.run(system.start(), 64)[1][:, 1].any()
    _, again = stepper.run(system.start(), 64, pluck)
    np.testing.assert_array_equal(again, first)


def test_course_of_a_force_and_its_derivative():
    pieces = [Segment(1.0, 2.0, 3.0, -4.0, 5.0), Segment(2.0, 4.0, 7.0, 1.0)]
    times = [0.9, 1.0, 1.5, 2.0, 3.0, 4.0]
    assert course(pieces, times).tolist() == [0.0, 3.0, 3 - 2 + 1.25, 7.0, 8.0, 0.0]
    assert course(pieces, times, derivative=True).tolist() == [0.0, -4.0, 1.0, 1.0, 1.0, 0.0]


@pytest.mark.parametrize("first", [None, 0, 3, 5])
def test_steps_of_a_course_hold_the_force_at_their_beginnings(first):
    """F = 2 + 3 u - 4 u^2 of u = t - 1.25 steps, from 1.25 to 6.5 steps of 1/2 s."""
    dt = 0.5
    piece = Segment(1.25 * dt, 6.5 * dt, 2.0, 3.0, -4.0)
    got = Course.of([piece], dt, first=first)
    start = max(2, first or 0)
    assert (got.start, got.values.shape) == (start, (3, 6 - start))
    u = (np.arange(start, 6) - 1.25) * dt
    np.testing.assert_allclose(got.values, [2 + 3 * u - 4 * u**2, 3 - 8 * u, np.full(u.shape, -4.0)])
    u = 4.75 * dt
    parts = [(1, 0.125, 0.5, (2.0, 3.0, -4.0)), (6, 0.0, 0.25, (2 + 3 * u - 4 * u**2, 3 - 8 * u, -4.0))]
    assert got.parts == tuple(part for part in parts if part[0] >= (first or 0))
    assert got.steps == tuple(part[0] for part in got.parts)
    assert got.used.tolist() == [0, 1, 2]
    within = Course.of([Segment(0.6, 0.7, 1.0)], dt)
    assert [part[:3] for part in within.parts] == [(1, pytest.approx(0.1), pytest.approx(0.2))]
    assert (within.values.shape, within.used.size) == ((3, 0), 0)
    two = Course.of([Segment(0.0, 2.0, 1.0), Segment(2.0, 3.0, 5.0)], dt, time=0.5)
    assert (two.start, two.values[0].tolist(), two.parts) == (1, [1, 1, 1, 1, 5, 5], ())
    assert two.used.tolist() == [0]


def test_injections_of_a_course_are_grouped_by_nearness():
    """Steps with breakpoints at 2, 30, 200 and 230: the gap of 170 steps parts them; the rest is one injection."""
    basis = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=2.0)
    pieces = [Segment(2.5 * DT, 30.5 * DT, 1.0), Segment(200.5 * DT, 230.5 * DT, 1.0)]
    out = compile_force("m", basis, "p", pieces, DT, factor=3.0)
    assert [(i.start, i.stop) for i in out] == [(2, 31), (200, 231), (3, 230)]
    assert [i.values.shape for i in out] == [(2, 29), (2, 31), (1, 227)]
    assert np.argwhere(out[1].values).tolist() == [[0, 0], [1, 30]]
    assert out[2].values[0, :27].tolist() == [1.0] * 27
    # an impulse of 3 N over a part of a step changes the velocity by that over the mass
    total = sum(np.einsum("vt,vmx->x", i.values, i.vectors) for i in out)
    assert total[1] * basis.right[0, 0].real == pytest.approx(3.0 * 58 * DT / 2.0)


def test_a_sampled_force_from_its_first_step_on():
    force = SampledForce(0.0, 2 * DT, np.array([0.0, 4.0, 0.0]))
    whole = force.course(DT, time=3.25 * DT, first=0)
    at = np.clip(np.interp((np.arange(3, 8) + 0.5) - 3.25, [0, 2, 4], [0, 4, 0]), 0, None)
    assert whole.start == 3
    np.testing.assert_allclose(whole.values, [at, np.zeros(5), np.zeros(5)], atol=1e-12)
    late = force.course(DT, time=3.25 * DT, first=5)
    np.testing.assert_allclose(late.values[0], at[2:], atol=1e-12)
    assert force.course(DT, time=3.25 * DT, first=9).values.shape == (3, 0)
    rest = force.after(1.5 * DT)
    assert (rest.start, rest.values.tolist()) == (pytest.approx(2 * DT), [4.0, 0.0])
    assert force.after(-1.0).values.tolist() == [0.0, 4.0, 0.0]
    assert force.after(2 * DT).values.tolist() == [4.0, 0.0]


def test_controls_of_some_steps():
    """Steps 10 to 14 of a run under one control from 8 to 12 and another from 13 on."""
    system = scene()
    offset, scale = np.arange(5.0), np.array([2.0, 3.0, 4.0, 5.0])
    controls = [
        PrescribedMotion("fret", 8, offset=offset, scale=scale),
        PrescribedMotion("fret", 13, velocity=np.array([6.0, 7.0, 8.0])),
        PrescribedMotion("felt", 15, scale=np.ones(3)),  # after the run
    ]
    found = controlled(system, controls, 10, 5)
    assert list(found) == [0]
    o = CONTACT.offset
    expected = [[2, 3, o, o, o], [3, 4, o, o, o], [0, 0, 0, 6, 7], [4, 5, 1, 1, 1]]
    np.testing.assert_array_equal(found[0], expected)
    assert controlled(system, (), 10, 5) == {}
    assert controlled(system, controls, 0, 8) == {}
    with pytest.raises(ValueError, match="no nonlinear connection 'felt'"):
        controlled(system, controls, 10, 6)
