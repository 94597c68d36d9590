"""Bounds of the broad phase against closed forms: a contact is culled just beyond them, and a candidate just within.

An undamped mode of frequency w moves by a (c cos wt + s sin wt): its largest displacement is a hypot(c, s).
"""

from __future__ import annotations

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.solve import PotentialSolve
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Injection, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply
from tonewood.physics.stepping.kernel import KernelStepper, Shortcuts
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1 / 48000
OMEGA = 2 * np.pi * np.array([300.0, 1100.0, 4000.0, 9000.0])
BLOCK, COARSE = 16, 0.8
NEAR = 1e-6


ALL = (0, 1, 2, 3)


def string(modes=ALL):
    """Undamped modes; contacts act on `at` and `there`, a spring on `end`."""
    some = list(modes)
    shapes = {"at": [1.0, -0.7, 0.4, 0.9], "end": [0.5, 0.6, -0.8, 0.3], "there": [0.2, 0.5, 0.9, -0.4]}
    return ModalBasis.real(
        OMEGA[some], np.zeros(len(some)), {name: np.array(row)[some] for name, row in shapes.items()}
    )


def scene(clearances, modes=ALL, *, points=("at",), factor=1.0, pulled=True):
    """A string over contacts, and a body that pulls on it; the contacts are the first connections."""
    links = [
        Connection(f"c{i}", (Term("s", point, factor),), Contact(1e7, 1.5, offset=-c, residual=False))
        for i, (point, c) in enumerate(zip(points, clearances, strict=True))
    ]
    if pulled:
        links.append(Connection("spring", (Term("s", "end"), Term("body", "p", -1.0)), SpringDashpot(5e4, 1.0)))
    body = ModalBasis.real([2 * np.pi * 700.0], [30.0], {"p": [4.0]})
    return System.build({"s": string(modes), "body": body}, links, dt=DT)


def statistics(system, state=None, *, kick=0.0, steps=BLOCK, injections=(), **shortcuts):
    """Statistics of a run in which nothing touches, and the forces of the last connection."""
    start = system.start()
    if state is not None:
        system.modes_of(start, "s")[:] = state
    system.modes_of(start, "body")[1] = kick
    stepper = KernelStepper(system, shortcuts=Shortcuts(**shortcuts))
    _, forces = stepper.run(start, steps, injections)
    contacts = [j for j, c in enumerate(system.connections) if isinstance(c.law, Contact)]
    assert not forces[:, contacts].any()
    return stepper.culling_statistics, forces[:, -1]


class Rows:
    """Rows of the contact port in a block, a (cos, sin)(j theta), and their weights.

    The second number counts s times as much, s = 1 or 16 sin theta where a mode goes through less than a radian.
    """

    def __init__(self, modes):
        some = list(modes)
        theta = OMEGA[some] * DT
        j = np.arange(BLOCK + 1)[:, None]
        self.a = 2 * string(modes).right[0].real
        self.s = np.minimum(1.0, BLOCK * np.sin(theta))
        self.cos, self.sin = self.a * np.cos(j * theta), self.a * np.sin(j * theta)
        self.all = np.max(self.cos**2 + (self.sin / self.s) ** 2, axis=0)
        self.weight = np.abs(1 - np.exp(1j * theta)) ** 2
        self.peak = np.sqrt(np.sum(self.all / self.weight))

    def norm(self, state):
        return np.sqrt(np.sum(self.weight * (state[0] ** 2 + (self.s * state[1]) ** 2)))


@pytest.mark.parametrize("factor", [1.0, -0.6])
@pytest.mark.parametrize("modes", [(1,), (0,), ALL])
def test_the_coarse_bound_is_that_of_cauchy_and_schwarz(modes, factor):
    """sqrt(sum a^2 / w) sqrt(sum w |z|^2), w = |1 - exp(i omega h)|^2; of one mode its amplitude."""
    state = 1e-5 * np.array([[1.0, -0.5, 0.3, 0.2], [0.4, 0.8, -0.2, 0.1]])[:, list(modes)]
    rows = Rows(modes)
    bound = rows.peak * rows.norm(state)
    if modes == (1,):
        assert bound == pytest.approx(abs(rows.a[0]) * np.hypot(*state[:, 0]))
    for share, read in ((1 + NEAR, 0), (1 - NEAR, 1)):
        system = scene([bound * abs(factor) * share], modes, factor=factor, pulled=False)
        assert statistics(system, state, fine_bound=False, group_bound=False)[0]["rows_read"] == read


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("modes", [(1,), (0,), (0, 1), ALL])
def test_the_fine_bound_is_that_about_the_middle_of_the_block(modes, sign):
    """Displacement in the middle, less the largest change from there by each mode's amplitude.

    That is max + 0.41421357 min of the two numbers; where the change may exceed the motion, the middle counts as 0.
    """
    state = sign * 1e-5 * np.array([[0.9, -0.5, 3e-3, 2e-3], [0.4, 0.2, -2e-3, 1e-3]])[:, list(modes)]
    rows = Rows(modes)
    far = np.max((rows.cos - rows.cos[8]) ** 2 + ((rows.sin - rows.sin[8]) / rows.s) ** 2, axis=0)
    middle = rows.cos[8] * state[0] - rows.sin[8] * state[1]
    size = np.sort(np.abs([state[0], rows.s * state[1]]), axis=0)
    spread = np.sqrt(np.minimum(far, rows.all)) * (size[1] + 0.41421357 * size[0])
    bound = np.sum(spread) - np.sum(middle[far < rows.all])  # as far as the gap may fall
    coarse = rows.peak * rows.norm(state)
    assert bound < coarse or sign < 0 or 0 not in modes
    for beyond, read in ((NEAR, 0), (-NEAR, 1)):
        system = scene([min(bound, coarse) + beyond * abs(bound)], modes, pulled=False)
        assert statistics(system, state, group_bound=False)[0]["rows_read"] == read


@pytest.mark.parametrize("fine", [False, True])
@pytest.mark.parametrize("values", [np.ones(BLOCK), np.cos(2.0 * np.arange(BLOCK)), np.r_[np.zeros(10), np.ones(6)]])
def test_known_forces_are_bounded_about_their_static_displacement(values, fine):
    """A string at rest: the static state z of the mean force, about which it moves, and the deviations from the mean.

    z = (1 - E)^-1 w. Coarse: |y of z| + peak (|z| + sum |deviation| |w|). Fine: y of z in place of its size, with the
    motion about it in the middle of the block and its change, as without a force.
    """
    rows, w = Rows(ALL), 1e-7 * np.array([[1.0, -0.5], [0.4, 0.8], [-0.3, 0.2], [0.1, 0.6]])
    system = scene([1.0], pulled=False)
    E = system.compiled[0].E
    mean = values.mean()
    z = mean * np.linalg.solve(np.eye(2) - E, w[..., None])[..., 0].T
    static = rows.a @ z[0]
    deviation = np.abs(values - mean).sum() * rows.norm(w.T)
    bound = abs(static) + rows.peak * (rows.norm(z) + deviation)
    if fine:
        far = np.max((rows.cos - rows.cos[8]) ** 2 + ((rows.sin - rows.sin[8]) / rows.s) ** 2, axis=0)
        size = np.sort(np.abs([z[0], rows.s * z[1]]), axis=0)
        spread = np.sum(np.sqrt(np.minimum(far, rows.all)) * (size[1] + 0.41421357 * size[0]))
        middle = np.sum((rows.sin[8] * z[1] - rows.cos[8] * z[0])[far < rows.all])
        bound = min(bound, spread + rows.peak * deviation - middle - static)
    force = Injection("s", 0, w[None], values[None])
    for near, read in ((1 + NEAR, 0), (1 - NEAR, 1)):
        found = statistics(scene([bound * near], pulled=False), injections=[force], fine_bound=fine)[0]
        assert found["rows_read"] == read


def reach_of(system, onto, at):
    """Largest displacement of a point in a block per newton held over one step on another, of undamped modes."""
    basis = system.compiled[0].basis
    first, second = (basis.right[basis.index(p)].real for p in (onto, at))
    omega, steps = np.sqrt(basis.stiffness), np.arange(BLOCK)[:, None]
    moved = (np.cos(omega * DT * steps) - np.cos(omega * DT * (steps + 1))) / omega**2
    return np.abs(moved @ (first * second)).max()


@pytest.mark.parametrize(("group_bound", "share"), [(False, 1.0), (True, 1 - COARSE)])
@pytest.mark.parametrize("factor", [1.0, -2.0])
def test_forces_use_up_the_clearance_by_their_reach(group_bound, share, factor):
    """A string at rest over one contact; the contact is added once reach sum |f| comes to its clearance."""
    _, force = statistics(scene([1.0]), kick=1e-3)
    assert np.abs(force).sum() > 0
    bound = abs(factor) * reach_of(scene([1.0]), "end", "at") * np.abs(force).sum() / share
    for near, added in ((1 + NEAR, 0), (1 - NEAR, 1)):
        found, again = statistics(scene([bound * near], factor=factor), kick=1e-3, group_bound=group_bound)
        np.testing.assert_array_equal(again, force)
        # once added, its clearance is no longer a fifth
        assert (found["added"], found["blocks"]) == (added, 1)
    few, _ = statistics(scene([bound * (1 - NEAR)], factor=factor), kick=1e-3, steps=14, group_bound=group_bound)
    assert few["added"] == 0


def test_a_group_is_culled_at_once_with_a_fifth_of_its_clearances():
    """Motion takes 0.4 of the clearance: forces may use the other 0.6, or 0.2 where one bound culls the whole group."""
    rows, state = Rows(ALL), np.zeros((2, 4))
    state[0, 1] = 1e-9
    clearance = rows.peak * rows.norm(state) / 0.4
    reach = reach_of(scene([1.0]), "end", "at")
    _, unit = statistics(scene([1.0]), kick=1.0)
    for group_bound, left in ((False, 0.6), (True, 1 - COARSE)):
        for near in (0.98, 1.02):
            kick = near * clearance * left / (reach * np.abs(unit).sum())
            options = {"kick": kick, "fine_bound": False, "group_bound": group_bound}
            found, force = statistics(scene([clearance]), state, **options)
            used = reach * np.abs(force).sum() / (clearance * left)
            assert found["added"] == (used > 1)


def test_the_tightest_of_a_groups_contacts_counts():
    """Two contacts of one string: each is added by its own reach, and the other stays culled."""
    both = ("at", "there")
    _, force = statistics(scene([1.0, 1.0], points=both), kick=1e-3)
    bounds = [reach_of(scene([1.0, 1.0], points=both), "end", point) * np.abs(force).sum() for point in both]
    for first, second in ((1.5, 1 + NEAR), (1 + NEAR, 1.5), (1 - NEAR, 1.5), (1.5, 1 - NEAR), (0.999, 0.999)):
        system = scene([bounds[0] * first, bounds[1] * second], points=both)
        assert statistics(system, kick=1e-3, group_bound=False)[0]["added"] == (first < 1) + (second < 1)


@pytest.mark.parametrize("axial_stiffness", [2e7, 2e8])
def test_a_rising_tension_uses_up_the_clearance_by_its_reach(axial_stiffness):
    """Its forces -psi_m g move the row by at most psi_m sqrt(sum g^2 / a) sqrt(max_j sum a (row E^j kick)^2)."""
    weights = np.array([1.0, 3.0, 20.0, 60.0]) * 1e3
    tension = TensionModulation("T", ("s",), axial_stiffness, 0.65, {"s": weights})

    def system(clearance):
        links = [Connection("c", (Term("s", "at"),), Contact(1e7, 1.5, offset=-clearance, residual=False))]
        beside = ModalBasis.real([2 * np.pi * 700.0], [30.0], {"p": [4.0]})
        return System.build({"beside": beside, "s": string()}, links, dt=DT, potentials=[tension])

    far = system(1.0)
    state = far.start()
    far.modes_of(state, "s")[:] = 1e-4 * np.array([[1.0, -0.5, 0.1, 0.05], [0.4, 0.3, -0.1, 0.02]])
    start, rows, compiled, solve = state.copy(), Rows(ALL), far.compiled[1], PotentialSolve(far)
    used = 0.0
    for _ in range(BLOCK):
        x = far.modes_of(state, "s").T.copy()
        rest = np.zeros((1, 2))
        over = solve.over([rest, x], [rest, apply(compiled.E, x)], np.zeros(1), state.potentials)
        used += abs(over.mean(np.zeros(1))[0]) * np.sqrt(np.sum(over.modal[1][1] ** 2 / weights))
        NumpyStepper(far).run(state, 1)
    moved, most = compiled.coordinates.kick, []
    for _ in range(BLOCK):
        most.append(np.sum(weights * np.einsum("mx,mx->m", compiled.rows[0], moved) ** 2))
        moved = apply(compiled.E, moved)
    motion = rows.peak * rows.norm(far.modes_of(start, "s"))
    bound = motion + used * np.sqrt(max(most))
    assert bound > 1.01 * motion
    for near, added in ((1.09, 0), (1.08, 1)):  # its bound of |g| is looser by 8.5 %; the last sample has 1.5 % or more
        clearance = motion + near * (bound - motion)
        stepper = KernelStepper(system(clearance), shortcuts=Shortcuts(fine_bound=False, group_bound=False))
        _, forces = stepper.run(start.copy(), BLOCK)
        assert not forces.any()
        assert stepper.culling_statistics["added"] == added
