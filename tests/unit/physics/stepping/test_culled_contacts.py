"""Contacts that the block-level broad phase culls: none is ever missed."""

from __future__ import annotations

import numpy as np
import pytest
from nonlinear_scenes import LENGTH, TENSION, body, hang, held_string

from assembled import held_force
from tonewood import _kernel
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import PrescribedMotion, Readout, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.points import with_still_points
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts
from tonewood.physics.stepping.motion import to_motion
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000
FRETS = 6
ISAS = _kernel.instruction_sets()


def fretted(
    clearance=3e-4, rate=1 / DT, law=(1e10, 2.3), turned=0.0, modulated=(), axial_stiffness=2e4, stop=0, damping=1.0
):
    """Two strings on a body, in two directions each, over frets that see both.

    `turned`: phase of the shapes, rad; `modulated`: numbers of strings whose tension rises; `stop`: frets behind it see
    what does not move, and touch it.
    """
    places = {f"f{k}": LENGTH / 2 ** ((k + 1) / 12) for k in range(stop, FRETS)} | {"pluck": 0.11 * LENGTH}
    still = [f"f{k}" for k in range(stop)]
    components = {"body": body(["b0", "b1"])}
    connections = []
    for i in range(2):
        density = TENSION / (2 * LENGTH * 110 * 1.3**i) ** 2
        string = string_basis(LENGTH, TENSION, density, 5e-5, lambda w, k: damping * (2e-4 + 0 * w), n_modes=45)
        string = string.with_places(places)
        if turned:
            string = type(string).complex(
                string.poles,
                dict(zip(string.points, string.right * np.exp(1j * turned), strict=True)),
                left=dict(zip(string.points, string.left, strict=True)),
            )
        other = held_string(37, places | {"bridge": 0.013 * LENGTH}, density=density, damping=0.5 * damping)
        components |= {f"s{i}a": with_still_points(string, still), f"s{i}b": with_still_points(other, still)}
        connections += [
            Connection(f"joint{i}", (Term(f"s{i}a", "bridge"), Term("body", f"b{i}", -0.97))),
            Connection(f"stay{i}", (Term(f"s{i}b", "bridge"),), SpringDashpot(3e3, 0.2)),
        ]
        connections += [
            Connection(
                f"s{i}f{k}",
                (Term(f"s{i}a", f"f{k}", 0.95), Term(f"s{i}b", f"f{k}", 0.3)),
                Contact(*law, loss=0.3, offset=-clearance * (1 + 0.2 * k) if k >= stop else 0.0),
            )
            for k in range(FRETS)
        ]
    readouts = [
        Readout("a", "acceleration", (Term("body", "b0"),)),
        Readout("f", "force", (), (("s0f2", 1.0), ("joint1", 0.5))),
    ]
    tensions = [TensionModulation(f"s{i}", (f"s{i}a", f"s{i}b"), axial_stiffness) for i in modulated]
    return System.build(components, connections, readouts, dt=1 / rate, potentials=tensions)


def plucked(system, heights, places):
    state = system.start()
    for i, (height, place) in enumerate(zip(heights, places, strict=True)):
        hang(system, state, f"s{i}b", height[1], place)
        modes = system.modes_of(state, f"s{i}a")
        basis = system.compiled[system.slot(f"s{i}a")].basis
        q = basis.right[basis.index("pluck")].real / basis.stiffness
        end = basis.right[basis.index("bridge")].real
        q = q - end / basis.stiffness * (end @ q) / (end @ (end / basis.stiffness))
        q *= height[0] / (2 * np.sum(basis.right[basis.index("pluck")].real * q))
        modes[0], modes[1] = q, q * basis.poles.real / basis.poles.imag
    return state


def both_ways(system, state, n, isa=None, injections=(), controls=()):
    """Kernel with bounds and without; asserts that they agree in every bit."""
    runs, states, steppers = [], [], []
    for culling in (True, False):
        shortcuts = Shortcuts(block_culling=culling)
        stepper, at = KernelStepper(system, isa=isa, shortcuts=shortcuts), state.copy()
        runs.append(stepper.run(at, n, injections, controls))
        states.append(at)
        steppers.append(stepper)
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(states[0].modes, states[1].modes)
    np.testing.assert_array_equal(states[0].series, states[1].series)
    np.testing.assert_array_equal(states[0].potentials, states[1].potentials)
    assert steppers[0].statistics.failures == 0
    return runs[0], steppers[0].culling_statistics


def contacts(system, forces):
    return forces[:, [j for j, c in enumerate(system.connections) if isinstance(c.law, Contact)]]


@pytest.mark.parametrize("isa", ISAS)
def test_random_plucks_near_the_clearance_miss_no_contact(isa):
    system = fretted()
    rng = np.random.default_rng(11)
    touched = unread = 0
    for _ in range(16):
        # from far below the least amplitude that reaches a fret up to it, each string for itself
        heights = rng.uniform(-1, 1, (2, 2)) * 10 ** rng.uniform(-4.0, -2.8, (2, 1))
        state = plucked(system, heights, rng.uniform(0.05, 0.5, 2) * LENGTH)
        (_, forces), statistics = both_ways(system, state, 640, isa)
        acted = contacts(system, forces).any()
        touched += acted
        unread += statistics["rows_read"] == 0
        assert not (acted and statistics["rows_read"] == 0)
        assert statistics["blocks"] == 40
    assert 3 <= touched <= 12
    assert unread >= 2


def test_culled_contacts_leave_the_steps_of_the_twin():
    system = fretted()
    rng = np.random.default_rng(2)
    for size in (1e-5, 1.5e-4, 4e-4):
        start = plucked(
            system, size * rng.uniform([[0.5], [0.1]], [[1.0], [0.2]], (2, 2)), [0.1 * LENGTH, 0.2 * LENGTH]
        )
        twin = start.copy()
        expected, expected_forces = NumpyStepper(system).run(twin, 320)
        (out, forces), statistics = both_ways(system, start, 320)
        assert statistics["rows_read"] < 20 * 24
        np.testing.assert_allclose(out, expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
        np.testing.assert_array_equal(contacts(system, forces) != 0, contacts(system, expected_forces) != 0)


@pytest.mark.parametrize("clearance", [1e-8, 3e-7, 2e-6])
def test_a_string_at_rest_is_shaken_against_its_frets(clearance):
    """Forces through the bridge add contacts inside a block, at any sample of it."""
    system = fretted(clearance)
    state = system.start()
    push = compile_force("body", system.compiled[system.slot("body")].basis, "b1", [Segment(0.0, 0.01, 0.0, 300.0)], DT)
    (_, forces), statistics = both_ways(system, state, 640, injections=push)
    _, expected = NumpyStepper(system).run(system.start(), 320, push)
    assert 0 < statistics["rows_read"] < 40 * 24
    acted = contacts(system, forces).any(axis=1)
    first = int(np.argmax(acted))
    assert first == int(np.argmax(contacts(system, expected).any(axis=1)))
    assert acted.any()
    assert first % 16
    np.testing.assert_allclose(forces[:320], expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("modulated", [(), (0, 1)])
def test_strings_drawn_near_their_frets_miss_no_contact(isa, modulated):
    """Known forces that grow, are let go or strike: held and free motion are bounded block by block."""
    system = fretted(1e-3, modulated=modulated)
    rng = np.random.default_rng(7)
    touched, unread = 0, 0
    for _ in range(12):
        pushes = []
        for name in ("s0a", "s0b", "s1a"):
            force, ramp = rng.uniform(-1, 1) * 10 ** rng.uniform(-0.7, 1.2), rng.choice([3.7, 40.3, 300.6]) * DT
            course = [Segment(0.0, ramp, 0.0, force / ramp)]
            basis = system.compiled[system.slot(name)].basis
            pushes += compile_force(name, basis, "pluck", course, DT, time=rng.uniform(0, 200) * DT)
        (_, forces), statistics = both_ways(system, system.start(), 576, isa, pushes)
        acted = contacts(system, forces).any()
        touched += acted
        unread += statistics["rows_read"] == 0
        assert modulated or not (acted and statistics["rows_read"] == 0)
    assert 2 <= touched <= 9
    assert unread >= 3


def test_drawn_strings_take_the_steps_of_the_twin():
    system = fretted(4e-4)
    basis = system.compiled[system.slot("s0a")].basis
    for force in (0.5, -0.8, 4.0):
        push = compile_force(
            "s0a", basis, "pluck", [Segment(0.0, 100 * DT, 0.0, force / (100 * DT))], DT, time=3.3 * DT
        )
        a, b = system.start(), system.start()
        expected, expected_forces = NumpyStepper(system).run(a, 256, push)
        out, forces = KernelStepper(system).run(b, 256, push)
        np.testing.assert_allclose(out, expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
        np.testing.assert_array_equal(contacts(system, forces) != 0, contacts(system, expected_forces) != 0)


def test_runs_cut_at_blocks_are_the_same_to_the_bit():
    system = fretted()
    whole = plucked(system, [(2e-4, 1e-4), (6e-4, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    cut, stepper = whole.copy(), KernelStepper(system)
    out, forces = stepper.run(whole, 512)
    pieces = [stepper.run(cut, n) for n in (64, 208, 112, 128)]
    np.testing.assert_array_equal(np.concatenate([p[0] for p in pieces]), out)
    np.testing.assert_array_equal(np.concatenate([p[1] for p in pieces]), forces)
    np.testing.assert_array_equal(whole.modes, cut.modes)


def test_forces_come_only_where_contacts_were_solved_for():
    system = fretted()
    a = plucked(system, [(1e-5, 0.0), (1e-5, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    b, one, other = a.copy(), KernelStepper(system), KernelStepper(system)
    out, acted = one.advance(a, 128)
    expected, forces = other.run(b, 128)
    assert not acted.size
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(a.forces, forces[-1])
    np.testing.assert_array_equal(b.forces, forces[-1])
    a = plucked(system, [(2e-3, 0.0), (2e-3, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    b = a.copy()
    (_, acted), (_, forces) = one.advance(a, 320), other.run(b, 320)
    assert contacts(system, forces).any()
    touched = np.flatnonzero(forces.any(axis=0))
    np.testing.assert_array_equal(acted, touched[np.isin(touched, system.elimination.others.index)])
    # and nothing of it is left in the next run
    system_forces = one.run(a, 64)[1], other.run(b, 64)[1]
    np.testing.assert_array_equal(*system_forces)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_free_mass_that_a_known_force_drives_off_meets_its_rail(sign):
    """A force under which one mode has no static state; the other mode moves little."""
    mass = ModalBasis.real([0.0, 2 * np.pi * 400.0], [0.0, 5.0], {"p": [1.0, 0.3]}, modal_mass=2e-3)
    rail = Connection("rail", (Term("mass", "p", -sign),), Contact(1e8, 1.7, offset=-1e-3, residual=False))
    system = System.build({"mass": mass}, [rail], dt=DT)
    push = held_force(mass, "mass", "p", np.full(400, sign * 0.5), DT)
    (_, forces), _ = both_ways(system, system.start(), 400, injections=[push])
    met = int(np.argmax(forces[:, 0] != 0.0))
    # x = F t^2 / 2M of the free mode; the other one adds at most 2 F 0.09 / k, k = M w^2
    near = np.sqrt(2 * 2e-3 * np.array([1e-3 - 2 * 0.5 * 0.09 / (2e-3 * (2 * np.pi * 400.0) ** 2), 1e-3]) / 0.5) / DT
    assert near[0] - 1 <= met <= near[1] + 1


@pytest.mark.parametrize("modulated", [(), (0, 3)])
def test_contacts_between_strings_join_the_strings_that_share_bounds(modulated):
    """Four strings over rails, of which one is drawn: contacts join pairs of them, then both pairs; all are met."""
    parts, links = {}, []
    for i in range(4):
        places = {"rail": 0.31 * LENGTH, "mid": 0.47 * LENGTH, "end": 0.1 * LENGTH}
        parts[f"s{i}"] = held_string(21 + i, places, density=(3 + i) * 1e-3, damping=0.5)
        links.append(Connection(f"stay{i}", (Term(f"s{i}", "end"),), SpringDashpot(2e3, 0.1)))
    law = Contact(1e8, 1.7, loss=0.2, offset=-2e-4)
    links += [Connection(f"rail{i}", (Term(f"s{i}", "rail"),), law) for i in range(4)]
    for a, b in ((2, 0), (1, 3), (3, 0)):
        links.append(Connection(f"{a} on {b}", (Term(f"s{a}", "mid"), Term(f"s{b}", "mid", -1.0)), law))
    tensions = [TensionModulation(f"s{i}", (f"s{i}",), 2e4) for i in modulated]
    system = System.build(parts, links, dt=DT, potentials=tensions)
    state = system.start()
    hang(system, state, "s3", -2e-3, 0.11 * LENGTH)
    (_, forces), statistics = both_ways(system, state, 960)
    assert np.any(contacts(system, forces) != 0.0, axis=0).all()
    assert statistics["added"] > 0


def test_frets_that_move_are_looked_at_block_by_block():
    system = fretted()
    state = plucked(system, [(1e-5, 0.0), (1e-5, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    rising = [PrescribedMotion("s0f1", 0, offset=np.linspace(-4e-4, 1e-5, 321))]
    (_, forces), statistics = both_ways(system, state, 320, controls=rising)
    assert 0 < statistics["rows_read"] < 20 * 24
    assert contacts(system, forces)[:, 1].any()


def test_modes_with_complex_shapes_are_bounded_too():
    system = fretted(1e-3, turned=0.05)
    state = plucked(system, [(1e-4, 0.0), (1e-4, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    twin = state.copy()
    expected, _ = NumpyStepper(system).run(twin, 128)
    (out, _), statistics = both_ways(system, state, 128)
    assert statistics["rows_read"] == 0
    np.testing.assert_allclose(out, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize(("modulated", "axial_stiffness"), [((0,), 2e4), ((0, 1), 2e3), ((0, 1), 1e5)])
def test_random_plucks_of_modulated_strings_miss_no_contact(isa, modulated, axial_stiffness):
    """Energy goes back and forth between a string's directions and its potential: each is bounded by all of it."""
    system = fretted(modulated=modulated, axial_stiffness=axial_stiffness)
    rng = np.random.default_rng(5)
    touched = unread = 0
    for _ in range(10):
        heights = rng.uniform(-1, 1, (2, 2)) * 10 ** rng.uniform(-3.7, -2.6, (2, 1))
        state = plucked(system, heights, rng.uniform(0.05, 0.5, 2) * LENGTH)
        (_, forces), statistics = both_ways(system, state, 320, isa)
        acted = contacts(system, forces).any()
        touched += acted
        unread += statistics["rows_read"] == 0
        assert statistics["blocks"] == 20
    assert 2 <= touched <= 8
    assert unread > 0


@pytest.mark.parametrize("modulated", [(0,), (0, 1)])
def test_culled_contacts_of_modulated_strings_leave_the_steps_of_the_twin(modulated):
    system = fretted(modulated=modulated)
    for size in (3e-5, 1.5e-4, 4e-4):
        start = plucked(system, size * np.array([[0.7, 0.2], [0.9, -0.1]]), [0.1 * LENGTH, 0.2 * LENGTH])
        twin = start.copy()
        expected, expected_forces = NumpyStepper(system).run(twin, 192)
        (out, forces), statistics = both_ways(system, start, 192)
        assert statistics["rows_read"] < 12 * 24
        np.testing.assert_allclose(out, expected, atol=1e-9 * np.abs(expected).max())
        np.testing.assert_allclose(forces, expected_forces, atol=1e-9 * np.abs(expected_forces).max())
        np.testing.assert_array_equal(contacts(system, forces) != 0, contacts(system, expected_forces) != 0)


@pytest.mark.parametrize("clearance", [1e-8, 3e-7, 2e-6])
def test_modulated_strings_at_rest_are_shaken_against_their_frets(clearance):
    """Forces through the bridge add contacts at any sample of a block."""
    system = fretted(clearance, modulated=(0, 1))
    push = compile_force("body", system.compiled[system.slot("body")].basis, "b1", [Segment(0.0, 0.01, 0.0, 300.0)], DT)
    (_, forces), _ = both_ways(system, system.start(), 640, injections=push)
    _, expected = NumpyStepper(system).run(system.start(), 192, push)
    assert contacts(system, forces).any()
    np.testing.assert_allclose(forces[:192], expected, atol=1e-8 * np.abs(expected).max())


def test_a_modulated_string_has_what_its_ports_give_it():
    """The bound: modes' energy and the potential of the tension change by force times way, exactly."""
    system = fretted(1.0, modulated=(0,), axial_stiffness=1e5, damping=0.0)
    state = plucked(system, [(2e-3, 1e-3), (1e-3, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    names, stepper = ("s0a", "s0b"), KernelStepper(system)
    bases = [system.compiled[system.slot(name)].basis for name in names]

    def reported():
        energy = 0.0
        ports = []
        for name, basis in zip(names, bases, strict=True):
            x = system.modes_of(state, name)
            q, velocity = to_motion(basis, x)
            energy += 0.5 * np.sum(velocity**2 + basis.stiffness * q**2)
            ports.append(float(basis.right[basis.index("bridge")].real @ q))
        return energy, stored_energy(system, state).potentials, np.array(ports)

    number = [[c.name for c in system.connections].index(name) for name in ("joint0", "stay0")]
    before, gained, shares = reported(), [], []
    for _ in range(300):
        _, forces = stepper.run(state, 1)
        after = reported()
        gained.append(after[0] + after[1] - before[0] - before[1] - forces[0, number] @ (after[2] - before[2]))
        shares.append(after[1] / (after[0] + after[1]))
        before = after
    assert np.abs(gained).max() < 1e-10 * (before[0] + before[1])
    assert max(shares) > 0.03


def test_linear_strings_rest_beside_a_modulated_one():
    """Only the contacts of a string that comes near its frets are stepped."""
    system = fretted(modulated=(0,))
    for heights, read in (
        ([(6e-4, 0.0), (1e-5, 0.0)], True),
        ([(1e-5, 0.0), (6e-4, 0.0)], True),
        ([(1e-5, 0.0)] * 2, False),
    ):
        state = plucked(system, heights, [0.4 * LENGTH, 0.4 * LENGTH])
        _, statistics = both_ways(system, state, 320)
        assert read or statistics["rows_read"] == statistics["added"] == 0


@pytest.mark.parametrize("modulated", [(), (0, 1)])
def test_frets_behind_a_stop_are_left_out(modulated):
    system = fretted(stop=3, modulated=modulated)
    state = plucked(system, [(1e-5, 0.0), (1e-5, 0.0)], [0.1 * LENGTH, 0.3 * LENGTH])
    twin = state.copy()
    (out, _), statistics = both_ways(system, state.copy(), 320)
    assert statistics["rows_read"] == 0
    expected, _ = NumpyStepper(system).run(twin, 128)
    np.testing.assert_allclose(out[:128], expected, atol=1e-9 * np.abs(expected).max())
    # one that is moved is looked at
    rising = [PrescribedMotion("s0f1", 0, offset=np.linspace(-4e-4, 1e-4, 321))]
    (_, forces), statistics = both_ways(system, state.copy(), 320, controls=rising)
    _, expected = NumpyStepper(system).run(state, 320, (), rising)
    assert statistics["rows_read"] > 0 or modulated
    np.testing.assert_allclose(forces, expected, atol=1e-9 * np.abs(expected).max())


def test_a_string_that_another_plane_pumps_misses_no_contact():
    """While one plane swings, the tension that it makes takes the other past its clearance within a block."""
    planes = {name: held_string(1, {"p": 0.4 * LENGTH}, damping=0.5, residual=False) for name in ("other", "a", "b")}
    fret = Connection("fret", (Term("b", "p"),), Contact(1e5, 1.5, offset=-2e-4))
    rising = [TensionModulation("string", ("a", "b"), 5e5)]
    touched = 0
    for turn in np.linspace(0.0, np.pi, 8, endpoint=False):
        for other in np.linspace(0.0, np.pi, 8, endpoint=False):
            system = System.build(planes, [fret], dt=1 / 1400, potentials=rising)
            state = system.start()
            for name, height, phase in (("a", 6e-3, turn), ("b", 1.9e-4, other)):
                hang(system, state, name, height, 0.4 * LENGTH)
                modes = system.modes_of(state, name)
                turned = (modes[0] + 1j * modes[1]) * np.exp(1j * phase)
                modes[0], modes[1] = turned.real, turned.imag
            (_, forces), statistics = both_ways(system, state, 64)
            touched += forces.any() and statistics["added"] > 0
    assert touched > 10


@pytest.mark.parametrize("turn", [0.8, 1.5])
def test_a_mode_that_swings_about_its_displaced_state_misses_no_contact(turn):
    """Its static state under a constant force counts, with both of its numbers: `turn`, rad per sample, is large."""
    basis = ModalBasis.real(np.array([turn / DT]), np.array([300.0]), {"p": np.ones(1)})
    force, shape = 2.0, basis.right[basis.index("p")].real
    still = 0.5 * force * shape / basis.stiffness
    push = compile_force("mode", basis, "p", [Segment(0.0, 1.0, force, 0.0)], DT)
    touched = 0
    for size in (0.1, 0.5, 1.5, 4.0):
        for phase in np.linspace(0.0, 2 * np.pi, 12, endpoint=False):
            for room in (0.5, 0.9):
                offset = -2.0 * float((1 + room * size) * (shape * still)[0])
                fret = Connection("fret", (Term("mode", "p", -1.0),), Contact(1e6, 1.5, offset=offset))
                system = System.build({"mode": basis}, [fret], dt=DT)
                state = system.start()
                moving = still * (1 + 1j * basis.poles.real / basis.poles.imag + size * np.exp(1j * phase))
                system.modes_of(state, "mode")[:] = moving.real, moving.imag
                (_, forces), _ = both_ways(system, state, 16, injections=push)
                touched += forces[1:].any()
    assert touched > 40
