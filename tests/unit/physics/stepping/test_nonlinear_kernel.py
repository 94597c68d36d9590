"""Nonlinear connections and rising tension in the kernel against the NumPy stepper, and against themselves."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from nonlinear_scenes import LENGTH, body, drawn, hang, held_string, modulated_guitar

from assembled import held_force
from tonewood import _kernel
from tonewood.errors import NumericalError
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import CompiledPotential, Contact, Friction, HardeningSpring, SampledPotential
from tonewood.physics.coupling.system import PrescribedMotion, Readout, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_transfer import retuned
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000
ISAS = _kernel.instruction_sets()
FRETS = [LENGTH / 2 ** (i / 12) for i in range(1, 7)]
CFUNC = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
LAWS = {
    "soft": Contact(1e5, 1.0, offset=-3e-4),
    "lossy": Contact(1e10, 2.3, loss=0.5, offset=-3e-4),
    "linear": Contact(4e8, 1.0, offset=-3e-4),
    "stiff": Contact(1e15, 2.3, offset=-3e-4),
    "spring": HardeningSpring(2e3, 1e10, 0.2, 1.0),
    "sampled": SampledPotential.from_force([-3e-4, -1e-4, 2e-4], [2.0, 0.1, 0.0], damping=0.05),
    "compiled": CompiledPotential(
        CFUNC(lambda d, _: 1e3 * d**2 + 3e9 * d**4), CFUNC(lambda d, _: 2e3 * d + 12e9 * d**3)
    ),
    "friction": Friction(0.3, velocity=0.05),
}  # fmt: skip


def fretted(law, n_modes=60):
    """Two strings over frets, on a body, and a mass that lies loosely on one string."""
    places = {f"f{i}": x for i, x in enumerate(FRETS)} | {"pluck": 0.11 * LENGTH, "bridge": 0.01 * LENGTH}
    components = {
        "s0": held_string(n_modes, places, damping=0.5),
        "s1": held_string(n_modes, places, damping=0.5, density=2e-3),
        "body": body(["b0", "b1"]),
        "mass": ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=2e-4),
    }
    connections = [Connection(f"joint{i}", (Term(f"s{i}", "bridge"), Term("body", f"b{i}", -1.0))) for i in range(2)]
    connections += [
        Connection(f"s{i}f{k}", (Term(f"s{i}", f"f{k}"),), law) for i in range(2) for k in range(len(FRETS))
    ]
    connections.append(Connection("hold", (Term("s1", "pluck"),), SpringDashpot(100.0, 0.02)))
    connections.append(Connection("rattle", (Term("mass", "p"), Term("s0", "pluck", -1.0)), Contact(1e7, 1.5, 0.1)))
    readouts = [
        Readout("u", "displacement", (Term("s0", "pluck"),)),
        Readout("v", "velocity", (Term("s1", "bridge"),)),
        Readout("a", "acceleration", (Term("body", "b0"), Term("s0", "f2"))),
        Readout("f", "force", (), (("s0f3", 1.0), ("joint1", 0.5), ("rattle", -1.0))),
    ]
    return System.build(components, connections, readouts, dt=DT)


def struck(system, height=1e-3):
    state = system.start()
    for name in ("s0", "s1"):
        hang(system, state, name, height, 0.11 * LENGTH)
    system.modes_of(state, "mass")[0] = 1.2e-3 * np.sqrt(2e-4)
    return state


def injections(system):
    basis = system.compiled[system.slot("s0")].basis
    return compile_force("s0", basis, "pluck", [Segment(0.0, 20.3 * DT, 0.0, 2 / (20 * DT))], DT, time=31.6 * DT)


def assert_same(ours, theirs, tolerance):
    peak = np.abs(theirs).max(axis=0)
    np.testing.assert_array_less(
        np.abs(ours - theirs).max(axis=0), tolerance * np.where(peak > 0, peak, 1e-30) + 1e-300
    )


@pytest.mark.parametrize("name", LAWS)
def test_kernel_takes_the_steps_of_its_twin(name):
    system = fretted(LAWS[name])
    a, b = struck(system), struck(system)
    n = 120
    expected, expected_forces = NumpyStepper(system).run(a, n, injections(system))
    stepper = KernelStepper(system)
    out, forces = stepper.run(b, n, injections(system))
    assert_same(out, expected, 1e-10)
    np.testing.assert_allclose(forces, expected_forces, atol=1e-10 * np.abs(expected_forces).max())
    np.testing.assert_allclose(b.series, a.series, atol=1e-10 * np.abs(a.series).max())
    np.testing.assert_allclose(b.slip, a.slip, atol=1e-9 * max(np.abs(a.slip).max(), 1e-30))
    assert np.abs(expected_forces[:, 2:14]).max() > 0.01
    assert stepper.statistics.solves > 0
    assert stepper.statistics.failures == 0


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("height", [2e-4, 1e-3])
def test_culled_contacts_change_no_bit(isa, height):
    system = fretted(LAWS["stiff"])
    results, states, read = [], [], []
    for culling in (True, False):
        state, stepper = (
            struck(system, height),
            KernelStepper(system, isa=isa, shortcuts=Shortcuts(block_culling=culling)),
        )
        results.append([stepper.run(state, n, injections(system)) for n in (64, 300, 100, 336)])
        states.append(state)
        read.append(stepper.culling_statistics["rows_read"])
    for culled, without in zip(*results, strict=True):
        np.testing.assert_array_equal(culled[0], without[0])
        np.testing.assert_array_equal(culled[1], without[1])
    np.testing.assert_array_equal(states[0].modes, states[1].modes)
    np.testing.assert_array_equal(states[0].series, states[1].series)
    assert read[0] < (0.5 if height < 5e-4 else 1.0) * read[1]
    assert np.abs(results[0][-1][1]).max() > 0


def test_a_slow_swell_adds_its_contact_inside_a_block():
    system = fretted(Contact(1e10, 1.5, offset=-2e-4))
    basis = system.compiled[system.slot("s1")].basis
    push = compile_force("s1", basis, "f2", [Segment(0.0, 0.02, 0.0, -100.0)], DT, time=0.001)
    out = []
    for culling in (True, False):
        stepper, state = KernelStepper(system, shortcuts=Shortcuts(block_culling=culling)), system.start()
        system.modes_of(state, "mass")[0] = 1e-3
        out.append(stepper.run(state, 960, push)[1])
        if culling:
            assert stepper.culling_statistics["rows_read"] < 0.5 * 60 * 12
    np.testing.assert_array_equal(*out)
    touched = np.flatnonzero(out[0].any(axis=1))
    assert np.abs(out[0][:, 8:14]).max() > 0.1
    assert touched.size < 960


def test_controls_move_and_scale_the_partner():
    system = fretted(Contact(1e8, 1.5, offset=-1.0))
    offset = np.concatenate([np.full(20, -1e-3), np.linspace(-1e-3, 2e-4, 61)])
    controls = [
        PrescribedMotion("s0f2", 10, offset=offset, scale=np.linspace(0.2, 1.0, 80)),
        PrescribedMotion("s1f1", 40, offset=np.full(41, 1e-5)),
    ]
    a, b = struck(system, 1e-4), struck(system, 1e-4)
    _, expected = NumpyStepper(system).run(a, 120, (), controls)
    _, forces = KernelStepper(system).run(b, 120, (), controls)
    np.testing.assert_allclose(forces, expected, atol=1e-10 * np.abs(expected).max())
    assert np.abs(expected[:, 4]).max() > 0.1
    assert not expected[:10, 4].any()
    assert not expected[91:, 4].any()
    with pytest.raises(ValueError, match="no nonlinear connection"):
        KernelStepper(system).run(b, 10, (), [PrescribedMotion("joint0", b.sample, scale=np.ones(10))])


def test_cut_runs_go_on_where_they_stopped():
    system = fretted(LAWS["lossy"])
    whole, cut = struck(system), struck(system)
    stepper = KernelStepper(system)
    out, forces = stepper.run(whole, 256)
    pieces = [stepper.run(cut, n) for n in (64, 16, 48, 128)]
    np.testing.assert_array_equal(np.concatenate([p[0] for p in pieces]), out)
    np.testing.assert_array_equal(np.concatenate([p[1] for p in pieces]), forces)
    copied = whole.copy()
    a, b = stepper.run(whole, 64), stepper.run(copied, 64)
    np.testing.assert_array_equal(a[0], b[0])


def test_a_law_that_is_switched_off_leaves_no_trace():
    system = fretted(LAWS["lossy"])
    idle = {c.name: Connection(c.name, c.terms, SpringDashpot()) for c in system.connections if c.name[0] in "sr"}
    stepper, state = KernelStepper(system), struck(system)
    stepper.run(state, 64)
    plain = system.with_laws(idle)
    stepper.exchange(plain)
    twin = state.copy()
    out, forces = stepper.run(state, 64)
    expected, _ = NumpyStepper(plain).run(twin, 64)
    assert_same(out, expected, 1e-10)
    assert not forces[:, 2:14].any()


def test_forces_that_are_not_found_stop_the_run():
    turning = CompiledPotential(CFUNC(lambda d, _: np.sin(1e9 * d)), CFUNC(lambda d, _: np.nan))
    system = fretted(turning)
    with pytest.raises(NumericalError, match=r"the forces of s0f0.* were not found at 0\.000000 s"):
        KernelStepper(system).run(struck(system), 32)


@pytest.mark.parametrize("force", [0.1, 5.0, 1000.0])
@pytest.mark.parametrize("isa", ISAS)
def test_rising_tension_takes_the_steps_of_its_twin(force, isa):
    system = modulated_guitar()
    a, b = drawn(system, force), drawn(system, force)
    stepper = KernelStepper(system, isa=isa)
    n = 60
    expected, expected_forces = NumpyStepper(system).run(a, n)
    out, forces = stepper.run(b, n)
    assert_same(out, expected, 1e-9)
    np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
    # a string that hardly moves: its tension is the rounding of the others' motion
    np.testing.assert_allclose(b.potentials, a.potentials, rtol=1e-8, atol=1e-12 * np.abs(a.potentials).max())
    assert stepper.statistics.redone == 0


@pytest.mark.parametrize("force", [0.0, 5.0, 1000.0])
@pytest.mark.parametrize("isa", ISAS)
def test_known_forces_on_modulated_strings_take_the_steps_of_their_twin(force, isa):
    """On both polarizations and for some steps only, at rest, moving, and beyond the bound of stable tensions."""
    system = modulated_guitar(n_modes=19)
    pushes = [
        held_force(system.compiled[system.slot(name)].basis, name, "pluck", size * np.hanning(n), DT, start)
        for name, size, start, n in (("s0a", 30.0, 0, 25), ("s0b", -20.0, 7, 12), ("s1a", 10.0, 20, 9))
    ]
    a, b = drawn(system, force), drawn(system, force)
    expected, forces = NumpyStepper(system).run(a, 40, pushes)
    out, found = KernelStepper(system, isa=isa).run(b, 40, pushes)
    assert_same(out, expected, 1e-9)
    assert_same(found, forces, 1e-9)
    assert_same(b.modes.T, a.modes.T, 1e-9)


def test_tension_is_switched_at_the_bounds_of_runs():
    system, linear = modulated_guitar(), modulated_guitar(on=False)
    off = system.with_potentials([])
    a, b = drawn(system, 3.0), drawn(linear, 3.0)
    stepper = KernelStepper(off)
    out, _ = stepper.run(a, 64)
    expected, _ = KernelStepper(linear).run(b, 64)
    np.testing.assert_array_equal(out, expected)
    half = system.with_potentials(["s1"])
    stepper.exchange(half)
    twin = a.copy()
    out, _ = stepper.run(a, 64)
    expected, _ = NumpyStepper(half).run(twin, 64)
    assert_same(out, expected, 1e-9)
    first, second = (a.potentials[memory] for memory in system.potentials.memory)
    assert second.any()
    assert not first.any()


@pytest.mark.parametrize("force", [20.0, 1000.0])
def test_energy_of_modulated_strings_never_rises(force):
    system = modulated_guitar(n_modes=60)
    state, stepper = drawn(system, force), KernelStepper(system)
    energy = [stored_energy(system, state).total]
    for _ in range(200):
        stepper.run(state, 1)
        energy.append(stored_energy(system, state).total)
    assert np.max(np.diff(energy)) <= 1e-10 * energy[0]
    assert energy[-1] < energy[0]


def test_energy_of_fretted_strings_never_rises():
    for name in ("lossy", "linear", "stiff"):
        system = fretted(LAWS[name])
        state, stepper = struck(system), KernelStepper(system)
        energy = [stored_energy(system, state).total]
        for _ in range(400):
            stepper.run(state, 1)
            energy.append(stored_energy(system, state).total)
        assert np.max(np.diff(energy)) <= 1e-11 * energy[0], name
        assert stepper.statistics.failures == 0


def test_a_kernel_whose_parts_come_and_go_is_as_one_just_made():
    """Stops, fingers, laws and tensions changed at random, more often than parts are kept: the same bits."""
    rng = np.random.default_rng(5)
    system = modulated_guitar(frets=LAWS["lossy"])
    strings = [name for name in system.names if name != "body"]
    bases = {name: system.compiled[system.slot(name)].basis for name in strings}
    held = {
        name: [system.compile(name, retuned(b, b.natural_freq * 2 * np.pi, rate + b.damping_rate)) for rate in rates]
        for name, b in bases.items()
        for rates in [rng.uniform(0.0, 2.0, 6)]
    }
    laws = [
        {f"hold{i}": SpringDashpot(0.0, damping) for i, damping in enumerate(pair)}
        for pair in ((0.0, 0.0), (0.05, 0.0), (0.0, 0.02), (0.05, 0.03))
    ] + [{f"s{i}f2": Contact(1e10, 2.3, loss=0.5, offset=offset)} for i in range(2) for offset in (-4e-4, -2e-4)]
    tensions = [(), ("s0",), ("s1",), ("s0", "s1")]
    stepper, state = KernelStepper(system), drawn(system, 2.0)
    touched = 0
    for _ in range(40):
        name = strings[rng.integers(len(strings))]
        system = system.with_compiled({name: held[name][rng.integers(6)]})
        terms = {c.name: c.terms for c in system.connections}
        new = laws[rng.integers(len(laws))]
        system = system.with_laws({n: Connection(n, terms[n], law) for n, law in new.items()})
        system = system.with_potentials(tensions[rng.integers(len(tensions))])
        stepper.exchange(system)
        fresh, copied = KernelStepper(system), state.copy()
        sounds = [one.run(there, 64) for one, there in ((stepper, state), (fresh, copied))]
        np.testing.assert_array_equal(sounds[0][0], sounds[1][0])
        np.testing.assert_array_equal(sounds[0][1], sounds[1][1])
        np.testing.assert_array_equal(state.modes, copied.modes)
        touched += fresh.statistics.solves
    assert touched > 50


def test_a_system_that_comes_back_takes_the_series_over_again():
    """A fret and a rail at one place yield alike, also when the rail comes back after a displacement was cleared."""
    places = {"pluck": 0.11 * LENGTH, "f0": 0.5 * LENGTH, "f1": 0.3 * LENGTH}
    parts = {"body": body(["b0"]), "s0": held_string(37, places, damping=1.0)}
    fret = Contact(1e8, 2.3, loss=0.3, offset=-2e-4)
    joints = [Connection(f"at {place}", (Term("s0", place),), fret) for place in ("f0", "f1")]
    readout = Readout("u", "displacement", (Term("s0", "pluck"),))
    whole = System.build(parts, joints, [readout], dt=1 / 48000)
    fewer = whole.with_laws({"at f1": Connection("at f1", (Term("s0", "f1"),), SpringDashpot())})
    state = whole.start()
    hang(whole, state, "s0", 1.5e-3, 0.11 * LENGTH)
    stepper = KernelStepper(whole)
    for _ in range(200):
        stepper.run(state, 64)
        if state.series.all():
            break
    assert state.series.all()
    stepper.run(state, 64)
    state.series[:] = 0.0
    stepper.exchange(fewer)
    for _ in range(200):
        stepper.run(state, 64)
        if state.series.any():
            break
    assert state.series.any()
    twin = state.copy()
    stepper.exchange(whole)
    ours, _ = stepper.run(state, 16)
    theirs, _ = NumpyStepper(whole).run(twin, 16)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(theirs).max())
    np.testing.assert_allclose(state.series, twin.series, rtol=0, atol=1e-6 * np.abs(twin.series).max())
    assert state.series.all()
    # so does a state of its own that comes to a stepper which has run another one
    other, again = twin.copy(), twin.copy()
    other.series[0] = again.series[0] = 0.0
    ours, _ = stepper.run(other, 16)
    theirs, _ = NumpyStepper(whole).run(again, 16)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(theirs).max())
    np.testing.assert_allclose(other.series, again.series, rtol=0, atol=1e-6 * np.abs(again.series).max())


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("stepper", [NumpyStepper, KernelStepper])
def test_a_string_slips_later_than_it_is_caught(stepper, sign):
    """Friedlander's ambiguity: v + N mu(v) / 2 Z = F / 2 Z has two stable roots; the one of the step before holds."""
    normal, static, dynamic, speed, n = 1.0, 0.8, 0.3, 0.02, 200  # 4 ms, before the ends answer
    string = held_string(224, {"middle": LENGTH / 2})
    bow = Connection("bow", (Term("string", "middle"),), Friction(normal, static, dynamic, speed))
    system = System.build({"string": string}, [bow], dt=DT)
    pull = np.concatenate([np.linspace(0.0, 1.0, n // 2), np.linspace(1.0, 0.0, n // 2)])
    pulled = held_force(string, "string", "middle", sign * pull, DT)
    _, forces = stepper(system).run(system.start(), n, [pulled])
    net = sign * forces[:, 0] + pull  # N, 2 Z v
    doubled = 2 * np.sqrt(70.0 * 3.6e-3)  # 2 Z, kg/s

    def sliding(force):
        flat = doubled * speed
        return np.max(np.roots([1.0, flat + normal * dynamic - force, flat * (normal * static - force)]).real)

    rising, falling = pull[: n // 2], pull[n // 2 :]
    np.testing.assert_allclose(net[: n // 2][rising < normal * static], 0.0, atol=1e-3)
    for k in range(n):
        if pull[k] > (0.85 if k < n // 2 else 0.55):
            assert net[k] == pytest.approx(sliding(pull[k]), abs=0.02)
    np.testing.assert_allclose(net[n // 2 :][falling < 0.42], 0.0, atol=5e-3)  # the roots meet at 0.48 N


@pytest.mark.parametrize(
    ("stepper", "sides"),
    [(NumpyStepper, (-1,)), (KernelStepper, (1,)), (KernelStepper, (-1,)), (KernelStepper, (1, -1))],
)
def test_friction_beside_a_stiff_contact_meets_its_curve(stepper, sides):
    """Free masses at rest, each pressed by F on a linear contact, slip by v with (1 + k) v + L mu(v) = L F / N.

    L = N h / 2M and k = K h^2 / 4M. Under the contact's force while it sticks, the mass slides; under the force
    that the contact would have then, it sticks. So changing branches does not end, and halving finds v.
    """
    mass, k, normal, static, dynamic, speed = 1e-3, 2.0, 2.0, 0.8, 0.3, 6e-3
    stiffness, load = 4 * mass * k / DT**2, normal * DT / (2 * mass)
    pressed = np.array([0.85, 0.9])[: len(sides)] * normal
    masses = {f"m{i}": ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=mass) for i in range(len(sides))}
    bow = Friction(2 * normal, static, dynamic, speed)
    links = [Connection(f"bow{i}", (Term(m, "p"),), bow) for i, m in enumerate(masses)]
    for m, side, force in zip(masses, sides, pressed, strict=True):
        links.append(Connection(f"on {m}", (Term(m, "p", side),), Contact(stiffness, 1.0, offset=force / stiffness)))
    system = System.build(masses, links, dt=DT)
    made, state = stepper(system), system.start()
    halved = [PrescribedMotion(f"bow{i}", 0, scale=np.array([0.5])) for i in range(len(sides))]
    _, forces = made.run(state, 1, (), halved)
    v = np.array([
        np.roots([1 + k, (1 + k) * speed + load * (dynamic - f), speed * load * (static - f)]).real.max()
        for f in pressed / normal
    ])  # fmt: skip
    assert (v < np.sqrt(load * (static - dynamic) * speed) - speed).all()  # where no mass alone would slide
    n = len(sides)
    np.testing.assert_allclose(state.slip[:n], v * sides, rtol=1e-9)
    np.testing.assert_allclose(
        forces[0, :n], -normal * np.array(sides) * (dynamic + (static - dynamic) / (1 + v / speed)), rtol=1e-10
    )
    np.testing.assert_allclose(forces[0, n:], pressed - v * stiffness * DT / 2, rtol=1e-10)
    assert (made.statistics.redone, made.statistics.failures) == (0, 0)


PUSH = [-4e-4, -3e-4, -2e-4, -1e-4, 0.0], [20.0, 6.0, 2.0, 0.5, 0.0]  # m, N
LOSSY = {
    "contact": Contact(1e9, 2.0, loss=30.0),
    "linear contact": Contact(1e5, 1.0, loss=30.0),
    "spring": HardeningSpring(1e4, 1e11, 2.0, 20.0),
    "sampled": SampledPotential.from_force(*PUSH, loss=30.0),
    "sampled, damped": SampledPotential.from_force(*PUSH, damping=3.0),
    "compiled": CompiledPotential(
        CFUNC(lambda d, _: 1e8 / 3 * max(-d, 0.0) ** 3), CFUNC(lambda d, _: -1e8 * max(-d, 0.0) ** 2), loss=30.0
    ),
    "compiled, damped": CompiledPotential(
        CFUNC(lambda d, _: 1e4 * d**2 + 1e11 * d**4), CFUNC(lambda d, _: 2e4 * d + 4e11 * d**3), damping=3.0
    ),
}


@pytest.mark.parametrize("name", LOSSY)
def test_a_law_with_losses_takes_the_iterations_of_its_twin(name):
    """A light mass thrown onto the law: a wrong derivative finds the same forces after more iterations, or none."""
    mass = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=1e-5)
    system = System.build({"mass": mass}, [Connection("law", (Term("mass", "p"),), LOSSY[name])], dt=DT)
    state = system.start()
    system.modes_of(state, "mass")[:, 0] = np.array([1e-6, -1.0]) * np.sqrt(1e-5)
    twin, ours, theirs = state.copy(), KernelStepper(system), NumpyStepper(system)
    _, expected = theirs.run(twin, 12)
    _, forces = ours.run(state, 12)
    np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max())
    # a few more or fewer, where rounding decides
    assert ours.statistics.iterations == pytest.approx(theirs.statistics.iterations, rel=0.2)
    assert (ours.statistics.redone, ours.statistics.failures) == (0, 0)


@pytest.mark.parametrize("stepper", [NumpyStepper, KernelStepper])
@pytest.mark.parametrize("speed", [1.0, 9.0, 25.0])
def test_steps_over_several_samples_keep_the_energy_of_a_potential(stepper, speed):
    """A mass thrown onto a law whose stiffness doubles from sample to sample, within them and beyond both ends."""
    knots, stiffness = np.linspace(-5e-4, 0.0, 6), 1e4 * 2.0 ** np.arange(4, -1, -1)
    slopes = np.append(-np.cumsum((stiffness * 1e-4)[::-1])[::-1], 0.0)
    levels = np.append(-np.cumsum((0.5 * (slopes[1:] + slopes[:-1]) * 1e-4)[::-1])[::-1], 0.0)
    coefficients = np.stack([levels[:-1], slopes[:-1], 0.5 * stiffness, 0 * stiffness], axis=1)

    def potential(d):
        cell = int(np.clip(np.searchsorted(knots, d, side="right") - 1, 0, 4))
        u = d - knots[cell]
        return levels[cell] + slopes[cell] * u + 0.5 * stiffness[cell] * u * u

    mass = ModalBasis.real([0.0], [0.0], {"p": [1.0]}, modal_mass=1e-4)
    readouts = [Readout(quantity, quantity, (Term("mass", "p"),)) for quantity in ("displacement", "velocity")]
    law = SampledPotential(knots, coefficients)
    system = System.build({"mass": mass}, [Connection("law", (Term("mass", "p"),), law)], readouts, dt=DT)
    made, state, path = stepper(system), system.start(), []
    system.modes_of(state, "mass")[:, 0] = np.array([1.3e-4, -speed]) * np.sqrt(1e-4)
    for _ in range(60):
        (((at, velocity),), _) = made.run(state, 1)
        path.append((at, 0.5 * 1e-4 * velocity**2 + potential(at)))
    places, energies = np.array(path).T
    np.testing.assert_allclose(energies, 0.5e-4 * speed**2 + potential(1.3e-4), rtol=1e-9)
    assert places.max() > 1e-4
    assert np.abs(np.diff(np.searchsorted(knots, places))).max() > (speed > 5)


def linear_springs():
    """Springs and dashpots that are stepped with the nonlinear laws, on a string, its joint and a body.

    The rail has a place of its own: the springs are solved at once only where bounds exclude all contacts.
    """
    springs = {
        "pluck": (("s0", "pluck"), HardeningSpring(4e3, damping=0.5, offset=2e-5)),
        "stay": (("body", "b0"), HardeningSpring(3e4, damping=3.0, offset=-3e-5, residual=False)),
        "felt": (("s0", "felt"), HardeningSpring(0.0, damping=0.3)),
        "nothing": (("body", "b1"), HardeningSpring()),
    }
    parts = {
        "s0": held_string(40, {"pluck": 0.07, "felt": 0.2, "rail": 0.3, "bridge": 0.01}, damping=0.5),
        "body": body(["b0", "b1"]),
    }
    joint = Connection("joint", (Term("s0", "bridge"), Term("body", "b0", -0.9)), Rigid(1e-6))
    laws = [Connection(name, (Term(*at, 1.5),), law) for name, (at, law) in springs.items()]
    rail = Connection("rail", (Term("s0", "rail"),), Contact(1e7, 1.5, offset=-0.1))
    readouts = [
        Readout("a", "acceleration", (Term("body", "b1"),)),
        Readout("f", "force", (), (("stay", 1.0), ("joint", 0.5))),
    ]
    return System.build(parts, [joint, rail, *laws], readouts, dt=DT)


STEADY = {"scale": np.full(90, 0.4)}
CONTROLS = {
    "none": [],
    "one factor": [("pluck", 0, STEADY)],
    "none at all": [("stay", 0, {"scale": np.zeros(90)})],
    "a factor from a block on": [("stay", 32, {"scale": np.full(58, 2.0)})],
    "two factors": [("pluck", 0, {"scale": np.repeat([0.3, 1.7, 0.9], 30)}), ("stay", 0, STEADY)],
    "at its offset": [("stay", 0, {"offset": np.full(91, -3e-5)})],
    "at another offset": [("stay", 0, {"offset": np.full(91, 4e-5)})],
    "that moves": [("stay", 20, {"offset": np.linspace(-3e-5, 5e-5, 41)})],
    "moves at its end": [("stay", 0, {"offset": np.r_[np.full(15, -3e-5), 1e-5]})],
    "a contact that is not met": [("rail", 0, {"offset": np.full(91, -0.2), "scale": np.full(90, 0.3)})],
}


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize("case", CONTROLS)
def test_linear_springs_take_the_steps_of_their_twin(case, at_once):
    system = linear_springs()
    controls = [PrescribedMotion(name, start, **arrays) for name, start, arrays in CONTROLS[case]]
    a = system.start()
    hang(system, a, "s0", 2e-4, 0.07)
    a.series[system.layout.places["pluck"]] = 1e-7
    b, c = a.copy(), a.copy()
    out, forces = NumpyStepper(system).run(a, 90, (), controls)
    stepper = KernelStepper(system, shortcuts=Shortcuts(linear_laws=at_once))
    found = stepper.run(b, 90, (), controls)
    if at_once:  # by another way than one by one, as its rounding shows, unless a control keeps the law off its offset
        one_by_one, _ = KernelStepper(system, shortcuts=Shortcuts(linear_laws=False)).run(c, 90, (), controls)
        assert np.array_equal(one_by_one, found[0]) == (case == "at another offset")
    if case == "none":
        assert (stepper.statistics.solves, stepper.statistics.iterations) == (90, 0 if at_once else 90)
    for ours, theirs in ((found[0], out), (found[1], forces), (b.modes, a.modes), (b.series, a.series)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max())
    acted = np.abs(forces).max(axis=0) > 0
    expected = [True, False, True, case != "none at all", True, False]
    assert acted.tolist() == expected
    assert stepper.statistics.failures == 0


@pytest.mark.parametrize("make", [NumpyStepper, KernelStepper])
@pytest.mark.parametrize(("cubic", "size", "within"), [(0.0, 1e-9, 1e-9), (1e15, 1e-6, 1e-7)])
def test_a_potential_beside_a_large_constant_is_that_of_its_slope(make, cubic, size, within):
    """5 J + k d^2 / 2 + c d^4 / 4 in motions so small that differences of it are rounding: a spring with its energy."""
    mode = ModalBasis.real([600.0], [3.0], {"p": [1.0]})
    slope = CFUNC(lambda d, _: 1e3 * d + cubic * d**3)
    potential = CompiledPotential(CFUNC(lambda d, _: 5.0 + 500.0 * d**2 + cubic / 4 * d**4), slope)
    found = []
    for law in (potential, HardeningSpring(1e3, cubic)):
        readout = Readout("u", "displacement", (Term("m", "p"),))
        system = System.build({"m": mode}, [Connection("spring", (Term("m", "p"),), law)], [readout], dt=DT)
        state = system.start()
        system.modes_of(state, "m")[0] = size
        found.append(make(system).run(state, 400)[0])
    assert_same(*found, within)
