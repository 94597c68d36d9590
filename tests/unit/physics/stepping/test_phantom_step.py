"""Longitudinal motion that is driven one way: against closed forms, the kernel against NumPy, the account of energy."""

from __future__ import annotations

import numpy as np
import pytest
from geometric_scenes import AXIAL, DENSITY, LENGTH, TENSION, held_string, in_modes, longitudinal, plucked, transverse
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.potentials.phantom import DELAY, DrivenLongitudinal
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]
FS = 48000.0
MASS = 50.0


def string_on_mass(
    freq_coupled: float = 3000.0,
    loss: float = 2e-3,
    moves: bool = False,
    planes: tuple[str, ...] = ("y",),
    axial_stiffness: float = AXIAL,
    more: tuple[Connection, ...] = (),
) -> System:
    """A string whose tension along itself acts on a free mass; `moves`: its transverse end moves that, too."""
    mass = ModalBasis.real([0.0], [0.0], {"top": [1.0]}, modal_mass=MASS)
    ends = [
        Connection(f"{n}.bridge", (Term(n, "bridge"), *([Term("mass", "top", -1.0)] if moves else [])), Rigid())
        for n in planes
    ]
    seat = Connection("seat", (Term("mass", "top"),), SpringDashpot(stiffness=0.0, damping=1e-9))
    readouts = [Readout("force", "acceleration", (Term("mass", "top", MASS),))]
    law = DrivenLongitudinal("string", planes, (("mass", "top", 1.0),), axial_stiffness, freq_coupled, loss)
    components = dict.fromkeys(planes, transverse(fs=FS)) | {"mass": mass}
    return System.build(components, [*ends, seat, *more], readouts, dt=1 / FS, potentials=[law])


@pytest.mark.parametrize(("pair", "within"), [((5, 6), 0.035), ((6, 7), 0.03), ((11, 13), 0.1)])
def test_two_partials_drive_their_sum(pair: tuple[int, int], within: float) -> None:
    """Slopes C_i cos(i pi x / L) cos(w_i t) put C_i C_j / 4 into s_n, n = j - i and i + j, at W = w_i + w_j.

    Mode n answers as a forced oscillator, e_n = s_n (2 i d W - W^2) / (W_n^2 - W^2 + 2 i d W); EA sum e_n is the force.
    The pairs are those whose sum is near the first or second longitudinal mode, 11.8 times the partials of its
    number; the last sum is at 7.9 kHz, where holding s_n over a step takes 5 %.
    """
    i, j = pair
    system = string_on_mass(freq_coupled=15000.0, loss=0.02)
    state = in_modes(system, {i: 1e-4, j: 0.7e-4}, "y")
    n = 1 << 15
    out, _ = KernelStepper(system).run(state, n)
    force, first = out[n // 2 :, 0], np.pi / LENGTH / np.sqrt(DENSITY)
    window, time = np.hanning(len(force)), np.arange(len(force)) / FS
    W = (i + j) * first * np.sqrt(TENSION)
    strain = 0j
    for order in (j - i, i + j):
        own = order * first * np.sqrt(AXIAL)
        loss = 2j * 0.01 * own * W
        strain += (loss - W**2) / (own**2 - W**2 + loss)
    expected = AXIAL * abs(strain) * 0.7e-8 * i * j * (np.pi / LENGTH) ** 2 / 4
    found = 2 * abs(np.sum(window * force * np.exp(-1j * W * time))) / window.sum()
    assert found == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("pair", [(5, 6), (5, 8), (3, 8)])
def test_two_partials_hardly_drive_their_difference(pair: tuple[int, int]) -> None:
    """Far below the longitudinal modes a_n is nearly -s_n: 0.008 of s_n are left, and s_0 errs by 0.01 of s_n.

    A lag of half a sample between s_n and a_n would leave s_n W h / 2, 0.04 to 0.2 of it in s_(j - i) and s_(i + j).
    """
    i, j = pair
    system = string_on_mass(freq_coupled=15000.0, loss=0.02)
    n = 1 << 14
    out, _ = KernelStepper(system).run(in_modes(system, {i: 1e-4, j: 0.7e-4}, "y"), n)
    force, first = out[n // 2 :, 0], np.pi / LENGTH / np.sqrt(DENSITY)
    window, time = np.hanning(len(force)), np.arange(len(force)) / FS
    W = (j - i) * first * np.sqrt(TENSION)
    strain = sum(W**2 / ((order * first) ** 2 * AXIAL - W**2) for order in (j - i, i + j))
    square = AXIAL * 0.7e-8 * i * j * (np.pi / LENGTH) ** 2 / 4
    found = 2 * abs(np.sum(window * force * np.exp(-1j * W * time))) / window.sum()
    assert found / square == pytest.approx(strain, abs=0.01)


def test_one_way_is_as_loud_as_both_ways() -> None:
    """At a small amplitude the force of the string that is stepped both ways, at the sum of two partials."""
    i, j, n = 5, 6, 1 << 14
    one = string_on_mass(freq_coupled=15000.0, loss=0.02)
    amplitudes = {i: 2e-5, j: 2e-5}
    force, _ = KernelStepper(one).run(in_modes(one, amplitudes, "y"), n)
    both = held_string(FS, basis=transverse(fs=FS), motion=longitudinal(fs=FS, eta=0.02), freq_coupled=15000.0)
    out, _ = KernelStepper(both).run(in_modes(both, amplitudes, "y"), n)
    W = (i + j) * np.pi / LENGTH * np.sqrt(TENSION / DENSITY)
    window, time = np.hanning(n // 2), np.arange(n // 2, n) / FS
    found = [abs(np.sum(window * y[n // 2 :] * np.exp(-1j * W * time))) for y in (force[:, 0], out[:, 2])]
    assert found[0] == pytest.approx(found[1], rel=0.06)


@pytest.mark.parametrize(("moves", "order"), [(False, 1), (True, 3), (True, 8), (False, 10), (False, 32)])
def test_kernel_and_numpy_agree(moves: bool, order: int) -> None:
    """The same samples, wherever a run is cut, with the end held or on the mass, and `order` longitudinal modes."""
    axial_stiffness = AXIAL / (4 if order <= 10 else 40)
    first = np.sqrt(axial_stiffness / DENSITY) / (2 * LENGTH)
    system = string_on_mass((order + 0.5) * first / 2, moves=moves, planes=("y", "z"), axial_stiffness=axial_stiffness)
    assert len(KernelStepper(system).describe()["potentials"][0]["steps"]) == order
    start = plucked(system, 5e-3, ("y", "z"))
    reference, state = start.copy(), start.copy()
    wanted, _ = NumpyStepper(system).run(reference, 200)
    stepper = KernelStepper(system)
    found = np.concatenate([stepper.run(state, n)[0] for n in (64, 7, 57, 72)])
    peak = float(np.max(np.abs(wanted)))
    assert peak > 0.1
    assert np.max(np.abs(found - wanted)) < 1e-10 * peak
    assert np.max(np.abs(state.potentials - reference.potentials)) < 1e-10 * np.max(np.abs(reference.potentials))


def test_kernel_and_numpy_agree_on_a_string_that_is_held_between_its_ends_too() -> None:
    """Forces at two points of the string drive the copies of its modes."""
    felt = Connection("felt", (Term("y", "pick"),), SpringDashpot(stiffness=300.0, damping=0.05))
    system = string_on_mass(moves=True, planes=("y", "z"), more=(felt,))
    reference = plucked(system, 5e-3, ("y", "z"))
    state = reference.copy()
    wanted, _ = NumpyStepper(system).run(reference, 200)
    open_string = string_on_mass(moves=True, planes=("y", "z"))
    without, _ = NumpyStepper(open_string).run(plucked(open_string, 5e-3, ("y", "z")), 200)
    assert np.max(np.abs(without - wanted)) > 0.01 * np.max(np.abs(wanted))
    found, _ = KernelStepper(system).run(state, 200)
    assert np.max(np.abs(found - wanted)) < 1e-10 * np.max(np.abs(wanted))


def test_strings_on_one_body_add_their_forces() -> None:
    """Kernel and NumPy agree: forces on the same points, combinations of them, another component; 2 to 30 modes."""
    shapes = np.random.default_rng(3).normal(size=(2, 6))
    freq, loss = 200.0 * np.arange(1, 7), np.full(6, 20.0)
    body = ModalBasis.real(2 * np.pi * freq, loss, {"a": shapes[0], "b": shapes[1]}, modal_mass=MASS)
    other = ModalBasis.real([0.0], [0.0], {"top": [1.0]}, modal_mass=MASS)
    onto: dict[str, tuple[tuple[str, str, float], ...]] = {
        "low": (("body", "a", 0.3),),
        "away": (("other", "top", 1.0),),
        "twice": (("body", "a", -0.6),),
        "both": (("body", "a", 1.0), ("body", "b", 1e-3)),
        "last": (("body", "b", 0.2),),
    }
    ends = [Connection(f"{name}.bridge", (Term(name, "bridge"), Term("body", "a", -1.0)), Rigid()) for name in onto]
    readouts = [Readout(p, "acceleration", (Term("body", p),)) for p in "ab"]
    readouts.append(Readout("other", "acceleration", (Term("other", "top"),)))
    stiffness = (AXIAL, AXIAL, AXIAL / 400, AXIAL / 40, AXIAL / 4)
    laws = [
        DrivenLongitudinal(name, (name,), at, axial, 3000.0, 2e-3)
        for (name, at), axial in zip(onto.items(), stiffness, strict=True)
    ]
    components = {name: transverse(fs=FS) for name in onto} | {"body": body, "other": other}
    system = System.build(components, ends, readouts, dt=1 / FS, potentials=laws)
    orders = [len(one["steps"]) for one in KernelStepper(system).describe()["potentials"]]
    assert orders[2:4] == [30, 9]  # the fewer after the more
    start = plucked(system, 5e-3, tuple(onto))
    reference = start.copy()
    wanted, _ = NumpyStepper(system).run(reference, 100)
    found, _ = KernelStepper(system).run(start, 100)
    assert np.all(np.max(np.abs(found - wanted), axis=0) < 1e-10 * np.max(np.abs(wanted), axis=0))
    assert np.max(np.abs(start.potentials - reference.potentials)) < 1e-10 * np.max(np.abs(reference.potentials))


def test_the_force_grows_with_the_square() -> None:
    """Twice the amplitude, four times the force, and it is late by a block."""
    forces = []
    for height in (1e-3, 2e-3):
        system = string_on_mass()
        out, _ = KernelStepper(system).run(plucked(system, height), 512)
        forces.append(out[:, 0])
    assert not np.any(forces[0][:DELAY])
    np.testing.assert_allclose(forces[1], 4 * forces[0], atol=1e-9 * np.max(forces[1]))


def test_switched_off_it_has_no_force() -> None:
    """Off, samples are those of a system without it, and its memory is cleared."""
    system = string_on_mass().with_potentials([])
    state = plucked(system, 1e-3)
    state.potentials[:] = 1.0
    out, _ = KernelStepper(system).run(state, 128)
    assert not np.any(out)
    assert not np.any(state.potentials)


def test_its_work_is_in_the_account() -> None:
    """The account closes; the work of the force stands under the string's name."""
    system = string_on_mass(moves=True)
    state = plucked(system, 5e-3)
    account = EnergyAccount(system, state.copy())
    stepper = KernelStepper(system)
    for _ in range(8):
        before = state.copy()
        _, forces = stepper.run(state, 64)
        account.follow(before, state, forces)
    trace = account.trace()
    work = np.sum(trace.supplied["string longitudinal"])
    stored = sum(trace.initial.values())
    assert np.max(np.abs(trace.residual)) < 1e-11 * stored
    assert 1e-9 * stored < abs(work) < 0.01 * stored


@pytest.mark.parametrize(
    ("onto", "loss"), [((), 0.01), ((("mass", "top", 1.0), ("body", "b", 1.0)), 0.01), (None, 2.0)]
)
def test_a_string_that_cannot_be_stepped_is_refused(
    onto: tuple[tuple[str, str, float], ...] | None, loss: float
) -> None:
    with pytest.raises(ValueError, match="string: "):
        DrivenLongitudinal("string", ("y",), (("mass", "top", 1.0),) if onto is None else onto, AXIAL, 3000.0, loss)
