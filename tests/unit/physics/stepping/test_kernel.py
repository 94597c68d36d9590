"""The C++ kernel against its NumPy twin: every instruction set, readout and way to cut a run."""

from __future__ import annotations

import numpy as np
import pytest

from assembled import chain, uneven
from tonewood import _kernel
from tonewood.errors import NumericalError, TonewoodError
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import BLOCK_SIZE, Drive, Injection, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set
from tonewood.physics.stepping.stepper import NumpyStepper

ISAS = _kernel.instruction_sets()
DT = 1 / 48000
TOLERANCE = 1e-12  # of the peak, where no solve amplifies rounding
EPS = np.finfo(np.float64).eps


def string(n, freq, rng):
    k = np.arange(1, n + 1)
    omega = 2 * np.pi * freq * k * np.sqrt(1 + 3e-5 * k**2)
    omega = omega[omega < 0.45 * 2 * np.pi / DT]
    shapes = rng.normal(size=(2, len(omega))) * 15
    return ModalBasis.real(omega, 1 + 1e-4 * omega, {"bridge": shapes[0], "pluck": shapes[1]})


def guitar(strings=3, *, modes=60, rigid_bodies=False, mics=1, residual=1e-8, connected=True, seed=1):
    """Strings of two polarisations on a body, a finger's dashpot, a spring, driven microphones; every readout."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.geomspace(90, 9000, 40)
    sigma = 0.01 * omega
    if rigid_bodies:
        omega[:2], sigma[0], sigma[1] = 0.0, 0.0, 40.0
        sigma[2] = 3 * omega[2]
    points = {f"b{i}": rng.normal(size=40) * 2 for i in range(strings)} | {"top": rng.normal(size=40)}
    components = {"body": ModalBasis.real(omega, sigma, points, residual=residual * np.eye(strings + 1))}
    connections = []
    for i in range(strings):
        components[f"s{i}"] = string(modes, 90.0 * 1.3**i, rng)
        if connected:
            connections.append(Connection(f"c{i}", (Term(f"s{i}", "bridge"), Term("body", f"b{i}", -0.95))))
        law = SpringDashpot(*((0.0, 0.0), (2e3, 0.0), (0.0, 0.4), (500.0, 1.0))[i % 4])
        connections.append(Connection(f"h{i}", (Term(f"s{i}", "pluck"),), law))
    drives = []
    for k in range(mics if connected else 0):
        poles = -50 + 2j * np.pi * np.geomspace(100, 9000, 50)
        right = {"in": np.zeros(50), "out": rng.normal(size=50) + 1j * rng.normal(size=50)}
        components[f"mic{k}"] = ModalBasis.complex(poles, right, {"in": np.ones(50), "out": np.zeros(50)})
        drives += [Drive(f"mic{k}", "in", f"c{i}", 1.0 - 0.2 * i) for i in range(strings)]
    readouts = [
        Readout("u", "displacement", (Term("body", "top"), Term("s0", "bridge", -0.5))),
        Readout("v", "velocity", (Term("body", "b0", 2.0),)),
        Readout("a", "acceleration", (Term("body", "top"),)),
        Readout("f", "force", (), ((connections[0].name, 1.0), (connections[-1].name, -0.3))),
        Readout("both", "velocity", (Term("s0", "pluck"),), ((connections[0].name, 0.01),)),
    ]
    heard = [d.component for d in drives]
    readouts += [Readout(mic, "displacement", (Term(mic, "out"),)) for mic in dict.fromkeys(heard)]
    return System.build(components, connections, readouts, dt=DT, drives=drives)


def plucked(system, steps=200, seed=3):
    """A ramp with breakpoints inside steps, and a noisy force on two vectors at once."""
    basis = system.compiled[system.slot("s0")].basis
    ramp = [Segment(0.0, 40.3 * DT, 0.0, 1 / (40 * DT)), Segment(40.3 * DT, 43.9 * DT, 1.0, -1 / (3.6 * DT))]
    rng = np.random.default_rng(seed)
    noise = Injection("body", 5, rng.normal(size=(2, 40, 2)) * 1e-7, rng.normal(size=(2, steps // 3)))
    return [*compile_force("s0", basis, "pluck", ramp, DT, time=3.7 * DT), noise]


def rounding_of_gaps(system, state):
    """Rounding of the gaps of linear connections, m: each sums `n` modes, rounded to eps sqrt(n) of their size."""
    size = np.zeros(len(system.connections))
    for i, compiled in enumerate(system.compiled):
        if not system.layout.driven[i]:
            modes = np.abs(system.modes_of(state, system.names[i]).T)
            terms = np.einsum("pmx,mx->p", np.abs(compiled.rows[: len(compiled.ports)]), modes)
            size += np.sqrt(len(modes)) * (np.abs(system.layout.incidence[i]) @ terms)
    return EPS * size


def assert_twins(system, injections, steps=200, isa=None, start=None, tolerance=TOLERANCE):
    """Outputs, forces and state of the two steppers agree up to the rounding of the gaps that the forces are solved
    from.

    Forces are G times gaps, so rounding of the gaps comes back times |G|, which carries the condition of the solve. A
    rigid connection keeps the error of an earlier step: a force held over a step has a sampling zero at -1 in the
    displacement after it, so an error d of the gaps leaves the second difference of d, up to 4 |G| d, in every later
    force (Astrom, Hagander & Sternby, Automatica 20, 1984).
    """
    a, b = (start or system.start()).copy(), (start or system.start()).copy()
    twin, rounding, rows = NumpyStepper(system), rounding_of_gaps(system, a), []
    for _ in range(steps):
        rows.append(twin.run(a, 1, injections))
        rounding = np.maximum(rounding, rounding_of_gaps(system, a))
    expected, expected_forces = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    out, forces = KernelStepper(system, isa=isa).run(b, steps, injections)
    peak = np.abs(expected_forces).max(axis=0)
    bound = 4 * steps * np.abs(system.solve.G) @ rounding
    assert np.all(np.abs(forces - expected_forces) <= np.maximum(bound, tolerance * peak))
    tolerance = max(tolerance, float(bound.max() / peak.max())) if np.any(peak) else tolerance
    assert tolerance < 1e-10
    assert np.all(np.abs(out - expected) <= tolerance * np.abs(expected).max(axis=0))
    assert np.any(expected != 0)
    np.testing.assert_allclose(b.modes, a.modes, rtol=0, atol=tolerance * np.abs(a.modes).max())
    np.testing.assert_array_equal(b.forces, forces[-1])
    assert b.sample == a.sample


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"rigid_bodies": True},
        {"strings": 6, "modes": 20, "mics": 2},
        {"strings": 1, "modes": 1, "mics": 0},
        {"residual": 0.0},
        {"connected": False},
    ],
    ids=str,
)
def test_kernel_is_its_twin(options, isa):
    system = guitar(**options)
    assert_twins(system, plucked(system), isa=isa)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("run", [1, 5, 16])
def test_each_mode_is_read_by_one_of_two_rows(run, isa):
    """Such a component takes part in the fused pass, whose modes, slow and others, go by the row that reads them.

    Shapes have phases, so that each row reads both numbers of its modes.
    """
    rng = np.random.default_rng(run)
    omega = 2 * np.pi * np.geomspace(60, 20000, 60)
    first = np.arange(60) // run % 2 == 0
    shapes = rng.uniform(0.5, 2, 60) * rng.choice([-1, 1], 60)
    turned = shapes * np.exp(0.1j) / (2j * omega)
    left, right = ({p: a * on for p, on in (("a", first), ("b", ~first))} for a in (shapes, turned))
    bars = ModalBasis.complex(-20 - 1e-4 * omega + 1j * omega, right, left)
    body = ModalBasis.real(2 * np.pi * np.geomspace(90, 9000, 20), np.full(20, 30.0), {"at": rng.normal(size=20)})
    laws = SpringDashpot(3e5, 2.0), SpringDashpot(1e5, 5.0)
    connections = [
        Connection(f"c{p}", (Term("bars", p), Term("body", "at", -1.0)), law) for p, law in zip("ab", laws, strict=True)
    ]
    out = [Readout("u", "velocity", (Term("body", "at"),))]
    system = System.build({"bars": bars, "body": body}, connections, out, dt=DT)
    start = system.start()
    system.modes_of(start, "bars")[:] = 1e-4 * rng.normal(size=(2, 60))
    assert_twins(system, (), 150, isa, start, tolerance=1e-11)


@pytest.mark.parametrize("isa", ISAS)
def test_a_body_of_many_ports_is_stepped_by_its_shapes(isa, rng):
    """From 16 ports on, sample by sample; known forces act on it, too."""
    omega, points = 2 * np.pi * np.geomspace(90, 9000, 21), [f"b{i}" for i in range(18)]
    body = ModalBasis.real(omega, 0.01 * omega, {p: rng.normal(size=21) for p in points})
    connections = [Connection(p, (Term("body", p),), SpringDashpot(1e4 * (1 + i), 2.0)) for i, p in enumerate(points)]
    out = [Readout("a", "acceleration", (Term("body", "b1"),)), Readout("v", "velocity", (Term("body", "b17"),))]
    system = System.build({"body": body}, connections, out, dt=DT)
    start = system.start()
    system.modes_of(start, "body")[:] = 1e-5 * rng.normal(size=(2, 21))
    push = Injection("body", 5, rng.normal(size=(2, 21, 2)) * 1e-7, rng.normal(size=(2, 20)))
    assert_twins(system, [push], 45, isa, start, tolerance=1e-11)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("steps", [1, 2, BLOCK_SIZE - 1, BLOCK_SIZE, BLOCK_SIZE + 1, 37])
def test_partial_blocks(isa, steps):
    system = guitar()
    start = system.start()
    NumpyStepper(system).run(start, 20, plucked(system))
    assert_twins(system, plucked(system), steps, isa, start)


def test_no_steps_change_nothing():
    system = guitar(strings=1)
    stepper = KernelStepper(system)
    state = stepper.start()
    out, forces = stepper.run(state, 0)
    assert out.shape == (0, 6)
    assert forces.shape == (0, 2)
    assert state.sample == 0


@pytest.mark.parametrize("bases", [("real", "complex"), ("complex", "complex")])
def test_small_bodies_of_every_kind(bases, rng):
    """Complex and real poles, block modes; a component without connections, and one that nothing reads."""
    kinds = {"real": lambda s: chain(4, s).real_basis(), "complex": lambda s: uneven(4, s, zeta=0.5).complex_basis()}
    components = {
        "a": kinds[bases[0]](1), "b": kinds[bases[1]](2), "alone": kinds["complex"](3), "mute": kinds["real"](4)
    }  # fmt: skip
    links = [
        Connection("c", (Term("a", "n1"), Term("b", "n0", -1.0))),
        Connection("d", (Term("b", "n1", 2.0), Term("a", "n0")), SpringDashpot(1e4, 5.0, 1e-5)),
        Connection("e", (Term("mute", "n0"),), SpringDashpot(1e5)),
        Connection("f", (Term("b", "n2"), Term("b", "n3", -1.0)), Rigid(1e-6)),
    ]
    readouts = [
        Readout("u", "displacement", (Term("a", "n2"), Term("alone", "n3"))),
        Readout("v", "velocity", (Term("alone", "n1"), Term("b", "n0"))),
        Readout("acc", "acceleration", (Term("b", "n3"), Term("a", "n0", -2.0))),
    ]
    system = System.build(components, links, readouts, dt=5e-4)
    force = [Segment(0.0, 0.01, 1.0, 20.0), Segment(0.01, 0.0234, 0.5, 0.0, 900.0)]
    injections = [
        i for n, p in (("a", "n2"), ("alone", "n0"), ("mute", "n1"))
        for i in compile_force(n, components[n], p, force, 5e-4, time=0.00123)
    ]  # fmt: skip
    assert_twins(system, injections, 150)


@pytest.mark.parametrize("isa", ISAS)
def test_runs_cut_at_64_samples_are_the_same_to_the_bit(isa):
    system = guitar()
    injections = plucked(system)
    stepper = KernelStepper(system, isa=isa)
    whole, cut = stepper.start(), stepper.start()
    out, forces = stepper.run(whole, 400, injections)
    parts = [stepper.run(cut, n, injections) for n in (64, 128, 64, 64, 80)]
    assert np.array_equal(np.concatenate([p[0] for p in parts]), out)
    assert np.array_equal(np.concatenate([p[1] for p in parts]), forces)
    assert np.array_equal(cut.modes, whole.modes)


@pytest.mark.parametrize("size", [1, 7, 63, 65])
def test_runs_cut_anywhere_agree_to_rounding(size):
    system = guitar()
    injections = plucked(system)
    stepper = KernelStepper(system)
    whole, cut = stepper.start(), stepper.start()
    out, _ = stepper.run(whole, 200, injections)
    pieces, left = [], 200
    while left:
        pieces.append(stepper.run(cut, min(size, left), injections)[0])
        left -= len(pieces[-1])
    assert np.all(np.abs(np.concatenate(pieces) - out) <= TOLERANCE * np.abs(out).max(axis=0))


def test_the_same_run_twice_is_the_same_to_the_bit():
    system = guitar()
    a, b = (KernelStepper(system) for _ in range(2))
    assert np.array_equal(a.run(a.start(), 150, plucked(system))[0], b.run(b.start(), 150, plucked(system))[0])


def test_exchanged_parts_take_effect():
    system = guitar()
    other = system.with_basis("s1", string(60, 130.0, np.random.default_rng(9)))
    law = Connection("h0", system.connections[1].terms, SpringDashpot(1e4, 2.0))
    changed = other.with_laws({"h0": law})
    stepper = KernelStepper(system)
    state, twin = stepper.start(), system.start()
    first = stepper.run(state, 64, plucked(system))[0]
    expected = NumpyStepper(system).run(twin, 64, plucked(system))[0]
    stepper.exchange(changed)
    second = stepper.run(state, 64, plucked(system))[0]
    again = NumpyStepper(changed).run(twin, 64, plucked(system))[0]
    peak = np.abs(np.concatenate([expected, again])).max(axis=0)
    assert np.all(np.abs(first - expected) <= TOLERANCE * peak)
    assert np.all(np.abs(second - again) <= TOLERANCE * peak)


def test_injections_before_and_after_the_run_do_nothing():
    system = guitar(strings=1)
    vectors = np.ones((1, 40, 2))
    past, future = Injection("body", -50, vectors, np.ones((1, 50))), Injection("body", 64, vectors, np.ones((1, 5)))
    stepper = KernelStepper(system)
    out, forces = stepper.run(stepper.start(), 64, [past, future])
    assert not out.any()
    assert not forces.any()


@pytest.mark.parametrize("overhang", [-10, 50])
def test_injections_that_reach_over_the_ends_of_a_run(overhang):
    system = guitar(strings=2)
    rng = np.random.default_rng(5)
    injection = Injection("s1", overhang, rng.normal(size=(3, 60, 2)) * 1e-5, rng.normal(size=(3, 33)))
    assert_twins(system, [injection], 70)


def test_a_system_of_nothing_but_one_mode():
    basis = ModalBasis.real([500.0], [1.0], {"p": [1.0]})
    system = System.build({"a": basis}, [], [Readout("u", "displacement", (Term("a", "p"),))], dt=DT)
    state = system.start()
    state.modes[0, 0] = 1.0
    out, forces = KernelStepper(system).run(state, 100)
    t = np.arange(100) * DT
    wd = np.sqrt(500.0**2 - 1)
    np.testing.assert_allclose(out[:, 0], 2 * np.exp(-t) * np.cos(wd * t), rtol=1e-12)
    assert forces.shape == (100, 0)


@pytest.mark.parametrize("where", ["body", "s1", "mic0"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_is_reported_with_component_and_time(where, bad):
    system = guitar()
    stepper = KernelStepper(system)
    state = stepper.start()
    stepper.run(state, 96, plucked(system))
    system.modes_of(state, where)[1, 3] = bad
    with pytest.raises(NumericalError, match=rf"{where} is no longer finite at 0\.002000 s"):
        stepper.run(state, 640)


def test_a_known_force_that_is_not_finite_is_reported():
    system = guitar()
    values = np.zeros((1, 30))
    values[0, 20] = np.nan
    stepper = KernelStepper(system)
    with pytest.raises(NumericalError, match=r"s2 is no longer finite at 0\.00"):
        stepper.run(stepper.start(), 640, [Injection("s2", 100, np.ones((1, 60, 2)), values)])


def test_wrong_state_is_refused():
    system = guitar(strings=1)
    stepper = KernelStepper(system)
    single = stepper.start()
    single.modes = single.modes.astype(np.float32)
    with pytest.raises(ValueError, match="a state of float32; float64 is needed"):
        stepper.run(single, 1)
    short = stepper.start()
    short.modes = short.modes[:, :-1].copy()
    with pytest.raises(ValueError, match="modes has the shape"):
        stepper.run(short, 1)
    with pytest.raises(ValueError, match="does not fit its component"):
        stepper.run(stepper.start(), 5, [Injection("body", 0, np.ones((1, 100, 2)), np.ones((1, 5)))])


def test_instruction_set_is_chosen_by_environment(monkeypatch):
    monkeypatch.setenv("TONEWOOD_ISA", "baseline")
    assert instruction_set() == "baseline"
    monkeypatch.setenv("TONEWOOD_ISA", "auto")
    assert instruction_set() == ISAS[0]
    monkeypatch.setenv("TONEWOOD_ISA", "abacus")
    with pytest.raises(TonewoodError, match="TONEWOOD_ISA=abacus: this machine has auto, "):
        instruction_set()
    with pytest.raises(ValueError, match="no instruction set 'abacus'"):
        KernelStepper(guitar(strings=1), isa="abacus")


def harp(strings=5, motions=2, seed=8):
    """Strings that are only joined to a bridge of few motions, and microphones with modes for each channel."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * np.geomspace(80, 9000, 30)
    shapes = rng.normal(size=(strings, motions)) @ rng.normal(size=(motions, 30))
    points = {f"b{i}": row for i, row in enumerate(shapes)}
    components = {"body": ModalBasis.real(omega, 0.02 * omega, points, residual=1e-8 * np.eye(strings))}
    connections, drives = [], []
    for i in range(strings):
        basis = string(20 + 13 * i, 70.0 * 1.4**i, rng)
        if i == 1:  # modes that creep: overdamped, critical, without stiffness
            freq = np.array([0.0, 0.0, 300.0, 2000.0, 900.0]) * 2 * np.pi
            rate = np.array([0.0, 40.0, 900.0 * np.pi, 4000.0 * np.pi, 5.0])
            basis = ModalBasis.real(freq, rate, {"bridge": rng.normal(size=5) * 9, "pluck": rng.normal(size=5)})
        components[f"s{i}"] = basis
        connections.append(Connection(f"c{i}", (Term(f"s{i}", "bridge"), Term("body", f"b{i}", -0.9))))
        drives += [Drive("mics", "heave", f"c{i}", 1.0), Drive("mics", "rock", f"c{i}", i / strings - 0.5)]
    poles = np.concatenate([-60 + 2j * np.pi * np.geomspace(90, 9000, 29), [-100, -260]])
    none = np.zeros_like(poles)
    residues = rng.normal(size=(4, 31)) + 1j * rng.normal(size=(4, 31)) * (poles.imag > 0)
    right = {
        p: np.concatenate([none + (p == "left"), none + (p == "right")]) for p in ("heave", "rock", "left", "right")
    }
    left = {p: np.concatenate([none, none]) for p in ("left", "right")}
    left |= {"heave": np.concatenate([residues[0], residues[1]]), "rock": np.concatenate([residues[2], residues[3]])}
    components["mics"] = ModalBasis.complex(np.tile(poles, 2), right, left)
    readouts = [Readout("top", "velocity", (Term("body", "b1"),)), Readout("pull", "force", (), (("c0", 1.0),))]
    readouts += [Readout(side, "displacement", (Term("mics", side),)) for side in ("left", "right")]
    return System.build(components, connections, readouts, dt=DT, drives=drives)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("options", [{}, {"motions": 1}, {"motions": 3}, {"motions": 5}, {"strings": 2}], ids=str)
def test_strings_that_touch_nothing_but_a_bridge(options, isa):
    system = harp(**options)
    basis = system.compiled[system.slot("s0")].basis
    late = compile_force("s0", basis, "pluck", [Segment(0.0, 30.4 * DT, 0.0, 1 / (30 * DT))], DT, time=170.2 * DT)
    start = system.start()
    rng = np.random.default_rng(2)
    for name, compiled in zip(system.names, system.compiled, strict=True):
        alive = compiled.basis.poles.imag != 0
        system.modes_of(start, name)[:] = 1e-6 * rng.normal(size=(2, len(alive))) * alive
    # a mode without stiffness adds up rounding
    assert_twins(system, late, steps=330, isa=isa, start=start, tolerance=1e-11)


def test_motions_of_a_bridge_are_counted_exactly():
    rng = np.random.default_rng(5)
    for motions, off in ((2, 0.0), (2, 1e-9)):
        shapes = rng.normal(size=(6, motions)) @ rng.normal(size=(motions, 12))
        shapes[3] += off * rng.normal(size=12)
        points = dict(zip("abcdef", shapes, strict=True))
        system = System.build(
            {"body": ModalBasis.real(np.arange(1.0, 13) * 900, np.full(12, 9.0), points)},
            [Connection(p, (Term("body", p),), SpringDashpot(1e3, 0.1)) for p in "abcdef"],
            [Readout("a", "displacement", (Term("body", "a"),))],
            dt=DT,
        )  # fmt: skip
        ports, span = system.compiled[0].motions(np.arange(6))
        assert len(ports) == (3 if off else 2)
        assert span.shape == (6, len(ports))
        assert_twins(system, [Injection("body", 3, rng.normal(size=(1, 12, 2)) * 1e-7, np.ones((1, 4)))])
