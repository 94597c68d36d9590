"""The inverse in parts against the inverse of the whole matrix, and when it is used."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood import _kernel
from tonewood.physics.coupling import elimination
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.inverse import MOST_IN_PART, DenseInverse, Hub, InverseInParts
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000


def sparse(matrix):
    rows, columns = np.nonzero(matrix)
    return rows, columns, matrix[rows, columns]


def blocks(rng, sizes):
    parts = [x @ x.T + 0.1 * np.eye(n) for n in sizes for x in [rng.normal(size=(n, n))]]
    order = rng.permutation(sum(sizes))
    return 1e-5 * sla.block_diag(*parts)[np.ix_(order, order)]


@pytest.mark.parametrize("motions", [0, 1, 4])
def test_in_parts_is_the_inverse_of_the_whole(rng, motions):
    D = blocks(rng, [1, 1, 3, 2, 1, 4, 2])
    k = len(D)
    hub = None
    if motions:
        point = rng.integers(-1, 5, size=k)
        factor, span, root = rng.normal(size=k), rng.normal(size=(5, motions)), rng.normal(size=(motions, motions))
        hub = Hub(0, np.arange(motions), point, factor, span, 1e-5 * root @ root.T)
    found = InverseInParts.of(k, sparse(D), hub)
    whole = D + hub.gaps @ hub.compliance @ hub.gaps.T if hub else D
    inverse = sla.inv(whole)
    assert sorted(a.shape[1] for a, _ in found.parts) == [1, 2, 3, 4]
    np.testing.assert_allclose(found.dense, inverse, rtol=0, atol=1e-12 * np.abs(inverse).max())
    columns = rng.normal(size=(k, 3))
    np.testing.assert_allclose(found.apply(columns), inverse @ columns, rtol=0, atol=1e-11 * np.abs(inverse).max())


def test_no_parts_no_inverse_in_parts(rng):
    assert InverseInParts.of(MOST_IN_PART + 1, sparse(blocks(rng, [MOST_IN_PART + 1])), None) is None
    singular = blocks(rng, [1, 2, 1])
    singular[:, 1] = singular[1] = 0.0
    assert InverseInParts.of(4, sparse(singular), None) is None
    for error, kept in ((1e-14, True), (1e-10, False)):  # beside the largest entry, not beside small ones
        uneven = np.array([[1.0, 1e-5], [1e-5 + error, 1.0]])
        assert (InverseInParts.of(2, sparse(uneven), None) is not None) == kept
    chain = np.eye(40) + 0.1 * (np.eye(40, k=1) + np.eye(40, k=-1))
    assert InverseInParts.of(40, sparse(chain), None) is None


def test_a_hub_much_softer_than_the_parts_is_left_to_the_dense_inverse(rng):
    hub = Hub(0, np.arange(1), np.zeros(3, dtype=np.intp), np.ones(3), np.ones((1, 1)), np.array([[1.0]]))
    assert InverseInParts.of(3, sparse(1e-6 * np.eye(3)), hub) is None


def strings_on_a_body(
    rng,
    n=30,
    *,
    points=9,
    motions=4,
    residual=2e-8,
    joined=0.0,
    dashpots=True,
    held=True,
    laws=False,
    rising=0,
    bare=99,
    offset=0.0,
):
    """n strings of a body's points that move by fewer motions; a held one touches nothing, some have dashpots.

    Ends are held at gaps of up to `offset` m. The tension of the first ones rises by a few per cent at 1e-6 in each
    coordinate. Every `bare`-th has no residual:
    where the body has none either, its end is held at the gap alone, not at the gap and its rate.
    """
    shapes = rng.normal(size=(points, motions)) @ rng.normal(size=(motions, 20))
    names = [f"p{i}" for i in range(points)]
    freq = np.sort(rng.uniform(100, 4000, 20)) * 2 * np.pi
    static = residual * (np.eye(points) + joined)
    body = ModalBasis.real(freq, freq / 60, dict(zip(names, shapes, strict=True)), residual=static)
    parts = {"body": body}
    joints = []
    for i in range(n):
        own = 2 * np.pi * rng.uniform(80, 300) * np.arange(1, 12)
        place = {"end": np.ones(11) * 30, "mid": 30 * np.sin(np.arange(1, 12) * 0.4)}
        parts[f"s{i}"] = ModalBasis.real(
            own, np.full(11, 0.5), place, residual=1e-8 * np.eye(2) * (i % bare != bare - 1)
        )
        at = () if held and i % 5 == 4 else (Term("body", names[i // 3 % points], -1.0),)
        joints.append(Connection(f"s{i}.end", (Term(f"s{i}", "end"), *at), Rigid(offset * np.cos(i))))
        if dashpots and i % 4 == 0:
            joints.append(Connection(f"s{i}.felt", (Term(f"s{i}", "mid"),), SpringDashpot(0.0, 0.3)))
    if laws:
        joints.append(Connection("rail", (Term("body", "p2"),), HardeningSpring(2e4, 1e9, damping=1.0)))
        joints.append(Connection("stop", (Term("s1", "mid"), Term("body", "p4", -1.0)), Contact(1e7, 1.5)))
    out = [Readout("x", "acceleration", (Term("body", "p0"),)), Readout("f", "force", forces=(("s0.end", 1.0),))]
    weights = np.arange(1, 12) ** 2.0
    tensions = [TensionModulation(f"T{i}", (f"s{i}",), 6e13, 1.0, {f"s{i}": weights}) for i in range(rising)]
    return System.build(parts, joints, out, dt=DT, potentials=tensions)


#: those of 16 motions or more step the body sample by sample
CASES = {
    "plain": {}, "no residual": {"residual": 0.0}, "all at one point": {"points": 12, "motions": 1},
    "own motions": {"points": 12, "motions": 12}, "no dashpots": {"dashpots": False, "held": False},
    "a residual that joins all": {"joined": 0.5, "dashpots": False},
    "a residual that joins many": {"joined": 0.5, "n": 80, "points": 24},
    "own motions, many": {"points": 19, "motions": 19, "n": 60}, "many motions": {"points": 24, "motions": 17, "n": 80},
    "several gammas": {"residual": 0.0, "bare": 7},
    "several gammas, own motions": {"points": 19, "motions": 19, "n": 60, "residual": 0.0, "bare": 4, "rising": 5},
    "offsets": {"offset": 1e-6}, "offsets, own motions": {"points": 12, "motions": 12, "offset": 1e-6},
    "rising": {"rising": 9}, "rising, all at one point": {"points": 12, "motions": 1, "rising": 3},
    "rising, own motions": {"points": 12, "motions": 12, "rising": 30},
    "rising, many motions": {"points": 24, "motions": 17, "n": 80, "rising": 40},
}  # fmt: skip


@pytest.mark.parametrize(
    "case", ["several gammas, own motions", "many motions", "rising", "offsets", "offsets, own motions"]
)
def test_kernel_solves_in_parts_what_it_solves_by_the_whole_matrix(rng, case, monkeypatch):
    seed, found = int(rng.integers(10**6)), []
    for least in (20, 10**6):
        monkeypatch.setattr(elimination, "LEAST_IN_PARTS", least)
        system = strings_on_a_body(np.random.default_rng(seed), **CASES[case])
        assert isinstance(system.solve.by, InverseInParts) == (least == 20)
        state = system.start()
        state.modes[:] = 1e-6 * np.random.default_rng(1).normal(size=state.modes.shape)
        found.append((*KernelStepper(system).run(state, 100, [knock(system)]), state.modes))
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=3e-11 * np.abs(b).max())


@pytest.mark.slow
@pytest.mark.parametrize("case", list(CASES))
def test_kernel_and_twin_solve_in_parts_what_the_whole_matrix_solves(rng, case, monkeypatch):
    what = CASES[case]
    seed = int(rng.integers(10**6))
    monkeypatch.setattr(elimination, "LEAST_IN_PARTS", 20)
    system = strings_on_a_body(np.random.default_rng(seed), **what)
    assert isinstance(system.solve.by, InverseInParts)
    assert "parts" in KernelStepper(system).describe()["linear"]
    start = system.start()
    for name, compiled in zip(system.names, system.compiled, strict=True):
        system.modes_of(start, name)[:] = 1e-6 * rng.normal(size=(2, compiled.basis.n_modes))
    monkeypatch.setattr(elimination, "LEAST_IN_PARTS", 10**6)
    whole = strings_on_a_body(np.random.default_rng(seed), **what)
    assert isinstance(whole.solve.by, DenseInverse)
    found = []
    for stepped in (whole, system):
        kernels = [KernelStepper(stepped, isa=isa) for isa in _kernel.instruction_sets()]
        for stepper in (NumpyStepper(stepped), *kernels, general(stepped)):
            state = start.copy()
            out, forces = stepper.run(state, 100, [knock(stepped)])
            found.append((out, forces, state.modes))
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=3e-11 * np.abs(b).max())
    without, _ = KernelStepper(system.with_potentials(())).run(start.copy(), 100, [knock(system)])
    assert (np.abs(without - found[0][0]).max() > 1e-4 * np.abs(without).max()) == ("rising" in what)


def general(system):
    return KernelStepper(system, shortcuts=Shortcuts(direct_step=False))


def knock(system):
    """A force of 20 samples on the body."""
    return compile_force("body", system.compiled[0].basis, "p1", [Segment(0.0, 20 * DT, 3.0)], DT, time=30.3 * DT)[0]


@pytest.mark.parametrize("case", ["plain", "many motions"])
def test_runs_cut_at_windows_give_the_same_bits(rng, case, monkeypatch):
    monkeypatch.setattr(elimination, "LEAST_IN_PARTS", 20)
    system = strings_on_a_body(rng, **CASES[case])
    start = system.start()
    for name, compiled in zip(system.names, system.compiled, strict=True):
        system.modes_of(start, name)[:] = 1e-6 * rng.normal(size=(2, compiled.basis.n_modes))
    whole, cut = start.copy(), start.copy()
    stepper = KernelStepper(system)
    expected, _ = stepper.run(whole, 256, [knock(system)])
    found = [stepper.run(cut, n, [knock(system)])[0] for n in (64, 128, 64)]
    np.testing.assert_array_equal(np.concatenate(found), expected)
    np.testing.assert_array_equal(cut.modes, whole.modes)


@pytest.mark.parametrize("rising", [0, 5])
def test_kernel_finds_laws_in_parts_as_in_one_matrix(rng, rising, monkeypatch):
    """Points of a body that move by themselves, the linear connections also without a product for all of them."""
    seed, found = int(rng.integers(10**6)), []
    for least, direct in ((20, True), (20, False), (10**6, True)):
        monkeypatch.setattr(elimination, "LEAST_IN_PARTS", least)
        system = strings_on_a_body(np.random.default_rng(seed), points=12, motions=12, laws=True, rising=rising)
        assert isinstance(system.solve.by, InverseInParts) == (least == 20)
        state = system.start()
        state.modes[0] = 2e-7
        stepper = KernelStepper(system, shortcuts=Shortcuts(direct_step=direct))
        found.append((*stepper.run(state, 100, [knock(system)]), state.modes))
        assert np.any(found[-1][1][:, -2:] != 0.0, axis=0).all()
        without, _ = KernelStepper(system.with_laws(idle(system))).run(system.start(), 60, [knock(system)])
        found[-1] = (*found[-1], without)
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(b).max())


def idle(system):
    """The nonlinear connections, off."""
    return {
        c.name: Connection(c.name, c.terms, SpringDashpot()) for c in system.connections if c.name in ("rail", "stop")
    }


@pytest.mark.slow
@pytest.mark.parametrize("rising", [0, 12])
def test_laws_act_on_a_body_in_parts_as_in_one_matrix(rng, rising, monkeypatch):
    """A contact on the body itself and one on a string, the body stepped sample by sample."""
    seed = int(rng.integers(10**6))
    found = []
    for least in (20, 10**6):
        monkeypatch.setattr(elimination, "LEAST_IN_PARTS", least)
        with_laws = strings_on_a_body(np.random.default_rng(seed), 60, points=24, motions=17, laws=True, rising=rising)
        assert isinstance(with_laws.solve.by, InverseInParts) == (least == 20)
        for stepper in (NumpyStepper(with_laws), KernelStepper(with_laws)):
            state = with_laws.start()
            state.modes[0] = 2e-7 if rising else 0.0
            found.append(stepper.run(state, 200, [knock(with_laws)]))
            assert np.any(found[-1][1][:, -2:] != 0.0, axis=0).all()
    for other in found[1:]:
        for a, b in zip(other, found[0], strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-9 * np.abs(b).max())


def test_few_connections_are_one_matrix(rng):
    assert isinstance(strings_on_a_body(rng, elimination.LEAST_IN_PARTS - 1, dashpots=False).solve.by, DenseInverse)
    assert isinstance(strings_on_a_body(rng, elimination.LEAST_IN_PARTS, dashpots=False).solve.by, InverseInParts)


def test_the_solve_is_kept_while_only_nonlinear_laws_change(rng):
    system = strings_on_a_body(rng, 30)
    solve = system.solve
    same = system.with_laws({"s0.felt": Connection("s0.felt", system.connections[1].terms, SpringDashpot(0.0, 0.3))})
    assert same.solve is solve
    other = system.with_laws({"s0.felt": Connection("s0.felt", system.connections[1].terms, Rigid())})
    assert other.solve is not solve


def test_what_nothing_moves_stays_at_rest_without_steps(rng, monkeypatch):
    """Strings with rigid ends, at first at rest; one of them is plucked in the middle of a window."""
    monkeypatch.setattr(elimination, "LEAST_IN_PARTS", 20)
    system = strings_on_a_body(rng, 30)
    basis = system.compiled[system.slot("s9")].basis
    pluck = compile_force("s9", basis, "mid", [Segment(0.0, 9 * DT, 0.5)], DT, time=200.4 * DT)
    found = []
    for at_rest in (True, False):
        state = system.start()
        for name, compiled in zip(system.names, system.compiled, strict=True):
            if name == "body" or int(name[1:]) % 5 != 4:
                system.modes_of(state, name)[:] = 1e-6 * np.random.default_rng(1).normal(
                    size=(2, compiled.basis.n_modes)
                )
        stepper = KernelStepper(system, shortcuts=Shortcuts(at_rest=at_rest))
        runs = [stepper.run(state, n, [knock(system), *pluck]) for n in (64, 100, 28, 192)]
        found.append((*(np.concatenate(parts) for parts in zip(*runs, strict=True)), state.modes))
        assert not system.modes_of(state, "s4").any()
        assert system.modes_of(state, "s9").any()
    # to rounding alone: modes of others stand side by side in other groups, where a compiler may fuse other products
    for with_rest, without in zip(*found, strict=True):
        np.testing.assert_allclose(with_rest, without, rtol=0, atol=1e-12 * np.abs(without).max())
