"""Compiled systems: arrays against brute force, exchange of parts, refused mistakes."""

from __future__ import annotations

import numpy as np
import pytest

from assembled import chain, connect, held_force_matrices, uneven
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.system import BLOCK_SIZE, PADDING, Drive, Readout, System

DT = 1e-3


def joined_system(**options):
    parts = {"a": chain(3, seed=1), "b": uneven(4, seed=2)}
    bases = {"a": parts["a"].real_basis(), "b": parts["b"].complex_basis()}
    links = [
        connect("joint", parts, np.array([0, 0, 1.0, -1.0, 0, 0, 0])),
        connect("spring", parts, np.array([0.5, 0, 0, 0, -2.0, 0, 1.0]), SpringDashpot(1e4, 3.0, 1e-4)),
    ]
    readouts = [
        Readout("u", "displacement", (Term("b", "n3", 2.0), Term("a", "n0"))),
        Readout("v", "velocity", (Term("b", "n2"),)),
        Readout("acc", "acceleration", (Term("a", "n1", -1.0),)),
        Readout("f", "force", (), (("joint", 1.0), ("spring", -0.5))),
    ]
    return parts, System.build(bases, links, readouts, dt=DT, **options)


def test_port_compliance_is_that_of_the_matrices():
    parts, system = joined_system()
    for name, compiled in zip(system.names, system.compiled, strict=True):
        ports = system.layout.ports[name]
        rows = parts[name].rows(ports)
        _, W = held_force_matrices(parts[name], rows, DT)
        ours = compiled.history[0, :, : len(ports)]
        np.testing.assert_allclose(ours, rows @ W[: parts[name].n], rtol=1e-9, atol=1e-15)


def test_history_is_the_response_to_one_held_step():
    _, system = joined_system()
    for compiled in system.compiled:
        x = compiled.W
        for k in range(BLOCK_SIZE):
            np.testing.assert_allclose(
                compiled.history[k], np.einsum("pmx,rmx->pr", x, compiled.rows), rtol=1e-12, atol=1e-18
            )
            x = np.einsum("mxy,pmy->pmx", compiled.E, x)


def test_incidence_collects_the_shares_of_ports():
    _, system = joined_system()
    assert system.layout.ports["b"] == ("n0", "n1", "n3")
    np.testing.assert_array_equal(system.layout.incidence[0], [[0.0, 1.0], [0.5, 0.0]])
    np.testing.assert_array_equal(system.layout.incidence[1], [[-1.0, 0.0, 0.0], [0.0, -2.0, 1.0]])


def test_force_weights_follow_the_readouts():
    _, system = joined_system()
    np.testing.assert_array_equal(system.layout.force_weights, [[0, 0], [0, 0], [0, 0], [1.0, -0.5]])


def test_gap_compliance_adds_up_over_components():
    parts, system = joined_system()
    gaps = np.array([[0, 0, 1.0, -1.0, 0, 0, 0], [0.5, 0, 0, 0, -2.0, 0, 1.0]])
    total = np.zeros((2, 2))
    for part, columns in ((parts["a"], slice(0, 3)), (parts["b"], slice(3, 7))):
        rows = gaps[:, columns]
        _, W = held_force_matrices(part, rows, DT)
        total += rows @ W[: part.n]
    np.testing.assert_allclose(system.elimination.gap.compliance, total, rtol=1e-9)


def test_state_has_room_as_asked_and_is_padded():
    _, system = joined_system(capacities={"a": 40})
    room = -(-40 // PADDING) * PADDING
    assert system.layout.capacities == (room, PADDING)
    assert system.layout.offsets == (0, room)
    state = system.start()
    assert state.modes.shape == (2, room + PADDING)
    system.modes_of(state, "b")[:] = 1.0
    assert np.count_nonzero(state.modes) == 2 * system.compiled[1].basis.n_modes
    copy = state.copy()
    copy.modes[:] = 5.0
    assert state.modes.max() == 1.0


def test_exchanged_component_is_as_if_built_with_it():
    _, system = joined_system(capacities={"b": 10})
    other = uneven(5, seed=7).complex_basis()
    changed = system.with_basis("b", other)
    built = System.build(
        {"a": system.compiled[0].basis, "b": other}, system.connections, system.readouts, dt=DT, capacities={"b": 10}
    )
    np.testing.assert_array_equal(changed.solve.G, built.solve.G)
    np.testing.assert_array_equal(changed.compiled[1].history, built.compiled[1].history)
    assert changed.compiled[0] is system.compiled[0]
    assert system.compiled[1].basis is not other


def test_exchanged_component_must_fit_its_room():
    _, system = joined_system()
    with pytest.raises(ValueError, match=f"room for {PADDING} modes, not {PADDING + 1}"):
        system.with_basis("a", chain(PADDING + 1, seed=1).real_basis())


def test_exchanged_law_is_as_if_built_with_it():
    _, system = joined_system()
    stiffer = Connection("spring", system.connections[1].terms, SpringDashpot(1e6, 0.0))
    changed = system.with_laws({"spring": stiffer})
    built = System.build(
        {n: c.basis for n, c in zip(system.names, system.compiled, strict=True)},
        (system.connections[0], stiffer),
        system.readouts,
        dt=DT,
    )
    np.testing.assert_array_equal(changed.solve.G, built.solve.G)
    with pytest.raises(ValueError, match="terms cannot change"):
        system.with_laws({"spring": Connection("spring", system.connections[0].terms, Rigid())})


def test_many_exchanges_one_after_another_are_as_if_built_at_last():
    """Data kept from system to system (the numbers of laws, sums of compliance) must not go stale."""
    _, system = joined_system(capacities={"a": 10, "b": 10})
    spring = system.connections[1].terms
    for seed in range(6):
        _ = system.solve  # found before the change in some, after it in others
        system = system.with_laws({"spring": Connection("spring", spring, SpringDashpot(1e4 * seed, 2.0 - seed % 3))})
        system = system.with_basis("a", chain(3 + seed, seed=seed).real_basis())
        if seed % 2:
            _ = system.nonlinear
        system = system.with_laws({"joint": Connection("joint", system.connections[0].terms, Rigid(1e-4 * seed))})
        system = system.with_compiled({"b": system.compile("b", uneven(4 + seed, seed=seed).complex_basis())})
        bases = {n: c.basis for n, c in zip(system.names, system.compiled, strict=True)}
        room = {"a": 10, "b": 10}
        built = System.build(bases, system.connections, system.readouts, dt=DT, capacities=room)
        for name in ("on", "G", "inverse", "gamma", "offset", "constant"):
            np.testing.assert_array_equal(getattr(system.solve, name), getattr(built.solve, name))
        np.testing.assert_array_equal(system.elimination.gap.residual, built.elimination.gap.residual)


def test_driven_components_are_not_felt():
    basis = chain(2, seed=1).real_basis()
    link = Connection("ground", (Term("a", "n1"),))
    system = System.build({"a": basis, "mic": basis}, [link], dt=DT, drives=[Drive("mic", "n0", "ground", -2.0)])
    assert system.layout.driven == (False, True)
    assert system.layout.ports["mic"] == ("n0",)
    np.testing.assert_array_equal(system.layout.incidence[1], [[-2.0]])
    alone = System.build({"a": basis}, [link], dt=DT)
    np.testing.assert_array_equal(system.solve.G, alone.solve.G)


def test_mistakes_are_named():
    basis = chain(2, seed=1).real_basis()
    parts = {"a": basis}
    ground = Connection("c", (Term("a", "n1"),))
    bad = [
        ((parts, [Connection("c", (Term("x", "n1"),))], [], {}), "connection 'c': no component 'x'"),
        ((parts, [Connection("c", (Term("a", "n7"),))], [], {}), "no point 'n7'; there are n0, n1"),
        ((parts, [ground, ground], [], {}), "same name"),
        ((parts, [], [Readout("o", "velocity", (Term("x", "n0"),))], {}), "no component 'x' to read"),
        ((parts, [], [Readout("o", "force", (), (("c", 1.0),))], {}), "no connection 'c'"),
        ((parts, [ground], [], {"drives": [Drive("a", "n0", "c")]}), "'a' is driven one way"),
    ]
    for (components, connections, readouts, more), message in bad:
        with pytest.raises(ValueError, match=message):
            System.build(components, connections, readouts, dt=DT, **more)
    with pytest.raises(ValueError, match="longer than"):
        System.build(parts, dt=0.0)
    with pytest.raises(ValueError, match="not 'speed'"):
        Readout("o", "speed")
