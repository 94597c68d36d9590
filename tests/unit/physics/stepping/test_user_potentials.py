"""Potentials of one's own: energy balances whatever V is; order two; the kernel steps them as its twin does."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from tonewood.errors import TonewoodError
from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.coordinates import middle_of_step
from tonewood.physics.coupling.potentials.solve import RESET_STEPS
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.potentials.user import FUNCTION, ModalPotential, PotentialEnergy, PotentialFunction
from tonewood.physics.coupling.system import Readout, State, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]
STEPPERS = [NumpyStepper, KernelStepper]


@dataclass
class Sum(PotentialEnergy):
    """Sums of squares of quadratic forms, of fourth powers and of cosines, of linear forms of the coordinates."""

    sizes: tuple[int, ...]
    forms: Floats  # (j, n, n)
    fourth: Floats  # (q, n)
    waves: Floats  # (c, n)
    height: float = 0.0
    scale: float = 0.0
    least: float = field(init=False)

    def __post_init__(self) -> None:
        self.least = -self.height * len(self.waves)

    def gradient(self, y: Floats) -> tuple[float, Floats]:
        b, u, w = np.einsum("jpq,p,q->j", self.forms, y, y), self.fourth @ y, self.waves @ y
        value = 0.5 * b @ b + 0.25 * np.sum(u**4) - self.height * np.sum(np.cos(w))
        slope = 2 * np.einsum("j,jpq,q->p", b, self.forms, y) + u**3 @ self.fourth
        return float(value), slope + self.height * np.sin(w) @ self.waves


def random_potential(rng: np.random.Generator, sizes: tuple[int, ...], speed: float) -> Sum:
    """One that stores about as much as modes of this speed (m/s sqrt(kg)) at some hundreds of hertz."""
    n, y = sum(sizes), speed / 2e3
    forms = rng.normal(size=(rng.integers(0, 4), n, n))
    forms = (forms + forms.transpose(0, 2, 1)) * speed / (n * y * y)
    fourth = rng.normal(size=(rng.integers(0, 4), n)) * speed**0.5 / y / n**0.5
    waves = rng.normal(size=(rng.integers(0, 3), n)) / y
    energy = 0.5 * speed**2
    return Sum(sizes, forms, fourth, waves, 0.2 * energy, rng.choice([0.0, 0.1, 1.0]) * energy)


def random_scene(rng: np.random.Generator) -> tuple[System, State]:
    """Two plates of a potential each, or of one, joined and in contact, and a mass."""
    names, parts = ("a", "b"), {}
    for name in names:
        n = int(rng.integers(3, 9))
        freq = np.sort(rng.uniform(80.0, 4e3, n)) * 2 * np.pi
        loss = rng.choice([0.0, 30.0]) * rng.random(n)
        shapes = {p: rng.normal(size=n) for p in ("p", "q", "r")}
        parts[name] = ModalBasis.real(freq, loss, shapes, modal_mass=1.0)
    parts["mass"] = ModalBasis.real([300.0], [5.0], {"p": [1.0]}, modal_mass=0.2)
    joints = [
        Connection("joint", (Term("a", "p"), Term("b", "p", -1.0)), Rigid()),
        Connection("spring", (Term("a", "q"), Term("mass", "p", -1.0)), SpringDashpot(2e4, 3.0)),
        Connection("edge", (Term("b", "q"),), Contact(1e7, 1.5, 0.3, offset=-1e-5)),
        Connection("meet", (Term("a", "r"), Term("b", "r", -1.0)), Contact(1e6, 2.0, 0.0, offset=-2e-5)),
    ]
    chosen = [c for c in joints if rng.random() < 0.7]
    speed = 10.0 ** rng.uniform(-2, 0.5)
    sizes = {name: int(rng.integers(1, parts[name].n_modes + 1)) for name in names}
    if rng.random() < 0.5:
        one = random_potential(rng, tuple(sizes.values()), speed)
        potentials = [ModalPotential("both", names, lambda bases: one)]
    else:
        each = {name: random_potential(rng, (sizes[name],), speed) for name in names}
        potentials = [ModalPotential(name, (name,), lambda bases, v=each[name]: v) for name in names]
    out = [Readout("o", "displacement", (Term("a", "p"),))]
    system = System.build(parts, chosen, out, dt=1 / 48000, potentials=potentials)
    state = system.start()
    for name, basis in parts.items():
        v = speed * rng.normal(size=basis.n_modes)
        system.modes_of(state, name)[:] = from_motion(basis, np.zeros(basis.n_modes), v)
    return system, state


@pytest.mark.slow
@given(seed=st.integers(0, 10**6), stepper=st.sampled_from(STEPPERS))
@settings(max_examples=30, deadline=None)
def test_energy_balances_whatever_the_potential(seed: int, stepper: type) -> None:
    """Stored, lost and put back add up to 1e-12 of the largest energy, over a put-back of psi."""
    system, state = random_scene(np.random.default_rng(seed))
    account, made = EnergyAccount(system, state.copy(), interval=8), stepper(system)
    for _ in range(12):
        before = state.copy()
        _, forces = made.run(state, 8)
        account.follow(before, state, forces)
    trace = account.trace()
    assert trace.worst_residual < 1e-12
    assert trace.total[-1] <= trace.peak * (1 + 1e-12)


def quartic(sizes: tuple[int, ...], strength: float) -> Sum:
    n = sum(sizes)
    forms = np.stack([np.diag(1.0 / (1 + np.abs(np.arange(n) - j))) for j in range(3)])
    return Sum(sizes, 3 * strength * forms, np.zeros((0, n)), np.zeros((0, n)))


FREQ = 2 * np.pi * np.array([100.0, 230.0, 370.0, 520.0, 700.0, 900.0])
PLATE = ModalBasis.real(FREQ, np.zeros(6), {"p": np.ones(6)}, modal_mass=1.0)


def plate(fs: float, energy: PotentialEnergy) -> System:
    potential = ModalPotential("v", ("plate",), lambda bases: energy)
    return System.build({"plate": PLATE}, [], [], dt=1 / fs, potentials=[potential])


@pytest.mark.parametrize("stepper", STEPPERS)
def test_order_is_two_against_an_integration_of_high_order(stepper: type) -> None:
    """V holds up to a third of the energy, and psi is put back a few times."""
    energy, v0, seconds = quartic((6,), 2e7), 0.1 * np.array([1.0, -0.6, 0.5, 0.4, -0.3, 0.2]), 0.01

    def motion(t: float, z: Floats) -> Floats:
        return np.concatenate([z[6:], -(FREQ**2) * z[:6] - energy.gradient(z[:6])[1]])

    start = np.concatenate([np.zeros(6), v0])
    exact = solve_ivp(motion, (0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-16).y[:, -1]
    errors = []
    for fs in (6000, 24000, 96000):
        system = plate(fs, energy)
        state = system.start()
        system.modes_of(state, "plate")[:] = from_motion(PLATE, np.zeros(6), v0)
        stepper(system).run(state, round(seconds * fs))
        q, _ = to_motion(PLATE, system.modes_of(state, "plate"))
        errors.append(np.abs(q - exact[:6]).max() / np.abs(exact[:6]).max())
    assert energy.energy(exact[:6]) > 0.02 * 0.5 * v0 @ v0
    assert errors[-1] < 2e-3
    assert np.log2(errors[0] / errors[-1]) / 4 > 1.9


def test_the_middle_of_a_step_makes_a_held_force_exact() -> None:
    """For one mode under a spring that is held over the step: its mean effect is that of the spring, to u^7."""
    u = np.array([1e-6, 1e-3, 0.05, 0.1, 0.2, 0.4])
    by_itself, pushed = middle_of_step(u)
    factor = 2 * np.cos(u) * by_itself * np.sin(u) / u
    assert np.all(np.abs(factor - 1) < 12 * u**8 + 1e-15)
    # half the step is by_itself = 1 / (2 cos u), pushed = 1 / (2 (1 + cos u)); the weights differ from it by the same
    # difference of it and the mean of the ends
    away = (by_itself - 1 / (2 * np.cos(u))) / (1 / (2 * np.cos(u)) - 0.5)
    np.testing.assert_allclose(pushed, (1 + away) / (2 * (1 + np.cos(u))) - 0.5 * away, rtol=1e-3)
    np.testing.assert_allclose(middle_of_step(np.array([0.5 * np.pi - 1e-6])), [[0.0], [0.5]], atol=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_kernel_takes_the_steps_of_its_twin(seed: int) -> None:
    system, state = random_scene(np.random.default_rng(seed))
    ours, theirs = state.copy(), state.copy()
    out, forces = KernelStepper(system).run(ours, 100)
    expected, others = NumpyStepper(system).run(theirs, 100)
    np.testing.assert_allclose(out, expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(forces, others, atol=1e-8 * max(np.abs(others).max(initial=0.0), 1e-300))
    np.testing.assert_allclose(ours.modes, theirs.modes, atol=1e-9 * np.abs(theirs.modes).max())


SOURCE = """
#include <stdint.h>
double fourth(const void* data, int64_t n, const double* y, double* gradient, double* scratch) {
    const double k = *(const double*)data;
    double V = 0;
    for (int64_t i = 0; i < n; ++i) {
        scratch[i] = k * y[i] * y[i] * y[i];
        V += 0.25 * scratch[i] * y[i];
        if (gradient) gradient[i] = scratch[i];
    }
    return V;
}
"""


class Fourth(PotentialEnergy):
    sizes = (6,)

    def __init__(self, stiffness: float, pointer: object = None):
        self.stiffness, self.pointer = np.array([stiffness]), pointer

    def gradient(self, y: Floats) -> tuple[float, Floats]:
        return float(0.25 * self.stiffness[0] * np.sum(y**4)), self.stiffness[0] * y**3

    def function(self) -> PotentialFunction | None:
        return None if self.pointer is None else PotentialFunction(self.pointer, data=self.stiffness, scratch=6)


@pytest.fixture
def fourth(tmp_path: Path) -> object:
    """Pointer to the C function."""
    if (compiler := shutil.which("cc")) is None:
        pytest.skip("needs cc")
    (tmp_path / "fourth.c").write_text(SOURCE)
    library = tmp_path / "fourth.so"
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", tmp_path / "fourth.c", "-o", library], check=True)
    return ctypes.cast(ctypes.CDLL(str(library)).fourth, FUNCTION)


@pytest.mark.parametrize("kind", STEPPERS)
@pytest.mark.parametrize("in_c", [False, True])
def test_a_potential_that_is_unbounded_below_ends_the_run(fourth: object, kind: type, in_c: bool) -> None:
    """V = -k/4 sum y^4 is 0 J at rest, and nowhere above."""
    for stiffness, ends in ((1e12, False), (-1e12, True)):
        system = plate(48000, Fourth(stiffness, fourth if in_c else None))
        state = system.start()
        system.modes_of(state, "plate")[:] = from_motion(PLATE, np.zeros(6), 0.3 * np.ones(6))
        if not ends:
            kind(system).run(state, 70)
            continue
        with pytest.raises(TonewoodError, match=r"Fourth: V = -\S+ J is below `least` = 0 J in the motion"):
            kind(system).run(state, 70)


@pytest.mark.parametrize("psi", [0.4, -0.4])
def test_psi_that_is_put_to_another_energy_keeps_its_sign(psi: float) -> None:
    """V - least + scale = psi^2 / 2 has two roots: steps may have passed through zero."""
    energy, y = Fourth(3.0), np.array([0.5, *np.zeros(5)])
    row = np.array([0.0, 0.3, psi, 0.0])
    shift, root = energy.begin(y[: energy.n], row, lambda: 1.0)
    assert root == pytest.approx(np.sign(psi) * np.sqrt(2 * (energy.energy(y[: energy.n]) + shift)), rel=1e-12)


def test_a_potential_without_finite_force_at_rest_is_refused() -> None:
    for value, slope in ((0.0, np.nan), (np.nan, 0.0), (np.inf, 0.0)):
        energy = Sum((2,), np.zeros((0, 2, 2)), np.zeros((0, 2)), np.zeros((0, 2)))
        energy.gradient = lambda y, of=(value, slope): (of[0], np.full(2, of[1]))  # type: ignore[method-assign]
        potential = ModalPotential("p", ("plate",), lambda shares, made=energy: made)
        with pytest.raises(TonewoodError, match="potential p: V or dV/dy is not finite at rest"):
            potential.join([PLATE])


def test_rounding_of_a_potential_is_no_fault() -> None:
    """V may be below `least` by 1e-12 J, and by 1e-9 of the energies at hand."""
    energy = Fourth(1.0)
    energy.check_bound(-0.9e-12)
    energy.check_bound(-0.9e-9, 1.0)
    energy.least, energy.scale = -2.0, 3.0
    energy.check_bound(-2.0 - 4.9e-9)
    energy.check_state(np.array([2.0 + 1e-9, 5.0, np.sqrt(10.0)]))
    for value, scale in ((-2.0 - 5.1e-9, 0.0), (-2.0 - 1.1e-7, 100.0)):
        with pytest.raises(TonewoodError, match="below `least` = -2 J"):
            energy.check_bound(value, scale)
    with pytest.raises(TonewoodError, match=r"V = -2\.1 J"):
        energy.check_state(np.array([2.1, 5.0, np.sqrt(10.0)]))


def test_a_c_function_gives_the_samples_of_the_python_one(fourth: object) -> None:
    found = []
    for energy in (Fourth(1e12), Fourth(1e12, fourth)):
        system = plate(48000, energy)
        state = system.start()
        system.modes_of(state, "plate")[:] = from_motion(PLATE, np.zeros(6), 0.3 * np.ones(6))
        KernelStepper(system).run(state, 3 * RESET_STEPS + 5)
        found.append(state.modes.copy())
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-11 * np.abs(found[0]).max())


def test_kinds_stand_side_by_side() -> None:
    """A string of rising tension beside a plate of a potential of one's own, joined."""
    n = np.arange(1, 9)
    string = ModalBasis.real(2 * np.pi * 110 * n, 2.0 * n, {"e": np.sin(2.5 * n), "p": np.sin(n)}, modal_mass=1.0)
    weights = {"string": 50.0 * n**2.0}
    potentials = [
        ModalPotential("v", ("plate",), lambda bases: quartic((6,), 2e7)),
        TensionModulation("t", ("string",), 2e4, 0.65, weights),
    ]
    joint = Connection("joint", (Term("string", "e"), Term("plate", "p", -1.0)), SpringDashpot(1e5, 1.0))
    out = [Readout("o", "velocity", (Term("plate", "p"), Term("string", "p")))]
    system = System.build({"plate": PLATE, "string": string}, [joint], out, dt=1 / 48000, potentials=potentials)
    runs = []
    for stepper in STEPPERS:
        state = system.start()
        system.modes_of(state, "string")[:] = from_motion(string, np.zeros(8), 2.0 * np.ones(8))
        energy = stored_energy(system, state).total
        runs.append(stepper(system).run(state, 150)[0])
        assert stored_energy(system, state).total < energy
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-10 * np.abs(runs[0]).max())
    off = system.with_potentials(["t"], among=["t", "v"])
    assert off.potentials.on == (False, True)
    assert system.with_potentials(["t"], among=["t"]) is system


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(TonewoodError, match="has 6 modes, not 7"):
        KernelStepper(plate(48000, quartic((7,), 1.0)))
    with pytest.raises(ValueError, match="C function"):
        PotentialFunction(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(abs))
