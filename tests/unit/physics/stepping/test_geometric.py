"""Strings with longitudinal motion: the potential, its forces, energy, phantom partials, and limiting cases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from geometric_scenes import (
    AXIAL,
    BENDING,
    DENSITY,
    LENGTH,
    TENSION,
    held_string,
    in_modes,
    longitudinal,
    plucked,
    transverse,
)
from numpy.typing import NDArray

from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.coupling.potentials.longitudinal import (
    GeometricShares,
    GeometricStretch,
    cosine_gradient,
    cosine_product,
    cosine_products,
)
from tonewood.physics.coupling.potentials.solve import PotentialSolve
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.potentials.user import ModalPotential, PotentialEnergy
from tonewood.physics.coupling.system import Injection, Readout, State, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.stepper import NumpyStepper

Floats = NDArray[np.float64]


def test_products_of_cosines_are_those_of_a_quadrature() -> None:
    rng = np.random.default_rng(1)
    c = rng.normal(size=9)
    theta = (np.arange(64) + 0.5) * np.pi / 64
    square = 0.5 * (np.cos(np.outer(theta, np.arange(9))) @ c) ** 2
    for n in range(12):
        coefficient = np.mean(square * np.cos(n * theta)) * (1 if n == 0 else 2)
        assert 0.5 * c @ cosine_products(n, 9) @ c == pytest.approx(coefficient, abs=1e-12)


@pytest.mark.parametrize(("count", "n"), [(1, 1), (1, 6), (4, 9), (9, 4), (30, 7)])
def test_sums_over_products_of_cosines_are_those_of_their_matrices(count: int, n: int) -> None:
    rng = np.random.default_rng(n)
    c, d, w = rng.normal(size=n), rng.normal(size=n), rng.normal(size=count)
    forms = [cosine_products(k, n) for k in range(count)]
    np.testing.assert_allclose(cosine_product(c, d, count), [c @ form @ d for form in forms], atol=1e-12)
    np.testing.assert_allclose(cosine_gradient(w, c), np.tensordot(w, forms, 1) @ c, atol=1e-12)


def stretched(n_modes: int = 12, n_longitudinal: int = 5) -> GeometricShares:
    system = held_string(
        48000.0, ("y", "z"), basis=transverse(n_modes), motion=longitudinal(n_longitudinal), freq_coupled=1e6
    )
    return PotentialSolve(system).active[0].joined


def strain_energy(string: GeometricShares, y: Floats) -> float:
    """EA/2 int e^2 dx of the strain as far as its first cosines tell, by quadrature over the string."""
    longitudinal_ = string.parts[-1]
    count, x = len(longitudinal_.slopes), (np.arange(400) + 0.5) * LENGTH / 400
    pieces = np.split(y, np.cumsum(string.sizes)[:-1])
    e = np.zeros(len(x))
    for part, q in zip(string.parts[:-1], pieces[:-1], strict=True):
        cosines = np.cos(np.outer(x, np.arange(len(part.slopes))) * np.pi / LENGTH)
        e += 0.5 * (cosines @ (part.slopes @ q)) ** 2
    basis = np.cos(np.outer(x, np.arange(count)) * np.pi / LENGTH)
    coefficients = 2 * basis.T @ e / len(x)
    coefficients[0] /= 2
    e = basis @ (coefficients + longitudinal_.slopes @ pieces[-1])
    return float(AXIAL / 2 * np.sum(e**2) * LENGTH / len(x))


def test_what_is_stored_is_the_strain_energy_of_the_string() -> None:
    string = stretched()
    rng = np.random.default_rng(2)
    for size in (1e-6, 1e-4, 1e-3):
        y = size * rng.normal(size=string.n)
        alone = np.concatenate([np.zeros(string.n - string.parts[-1].n), y[-string.parts[-1].n :]])
        # U leaves out the longitudinal modes' own energy
        expected = strain_energy(string, y) - strain_energy(string, alone)
        assert string.energy(y) == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_the_gradient_is_that_of_the_potential() -> None:
    string = stretched(6, 3)
    rng = np.random.default_rng(4)
    y, step = 1e-3 * rng.normal(size=string.n), 1e-8
    numeric = [(string.energy(y + step * e) - string.energy(y - step * e)) / (2 * step) for e in np.eye(string.n)]
    found = string.gradient(y, string.squares(y), string.strains @ y)
    np.testing.assert_allclose(found, numeric, rtol=1e-6, atol=1e-7 * np.abs(numeric).max())


@pytest.mark.parametrize("height", [5e-3, 5e-2, 0.3])
def test_modes_never_hold_more_than_twice_the_energy_that_is_there(height: float) -> None:
    """However far beyond its validity it is plucked: the shortfall of the potential is bounded by its shift."""
    system = held_string(48000.0, ("y", "z"), basis=transverse(30, bending=BENDING), motion=longitudinal(6))
    stepper, state = KernelStepper(system), plucked(system, height, ("y", "z"))
    stepper.run(state, 1)
    there = stored_energy(system, state).total
    for _ in range(100):
        stepper.run(state, 37)
        now = stored_energy(system, state)
        assert now.total <= there * (1 + 1e-9)
        assert now.modes <= 2 * there * (1 + 1e-6) + 1e-8 * AXIAL * LENGTH


def energy(system: System, state: State) -> float:
    return stored_energy(system, state).total


@pytest.mark.parametrize(("height", "eta"), [(1e-3, 0.0), (8e-3, 0.0), (8e-3, 1e-3), (4e-2, 1e-3)])
def test_energy_stays_without_loss_and_falls_with_it(height: float, eta: float) -> None:
    basis, motion = transverse(bending=BENDING, eta=eta), longitudinal(eta=eta)
    system = held_string(48000.0, ("y", "z"), basis=basis, motion=motion)
    stepper, state = KernelStepper(system), plucked(system, height, ("y", "z"))
    stepper.run(state, 1)  # the shape cut off at the highest mode does not quite fit the held end
    path = [energy(system, state)]
    for _ in range(60):
        stepper.run(state, 25)
        path.append(energy(system, state))
    if eta == 0.0:
        assert np.abs(np.array(path) / path[0] - 1).max() < 1e-11
    else:
        assert np.diff(path).max() < 0
    assert stepper.statistics.failures == 0


@pytest.mark.validate
@pytest.mark.parametrize("height", [2e-3, 3e-2, 0.1])
def test_energy_never_rises_over_a_long_time(height: float) -> None:
    # 0.1 m is the shape under some 100 N, as far from a small slope as it looks
    basis, motion = transverse(bending=BENDING, eta=2e-4), longitudinal(eta=2e-3)
    system = held_string(48000.0, ("y", "z"), basis=basis, motion=motion)
    stepper, state = KernelStepper(system), plucked(system, height, ("y", "z"))
    stepper.run(state, 1)
    last = energy(system, state)
    for _ in range(400):
        stepper.run(state, 500)
        now = energy(system, state)
        assert now < last
        last = now
    assert stepper.statistics.failures == 0


def amplitude_at(signal: Floats, freq: float, fs: float) -> float:
    """Of a line at a frequency (Hz), under a Blackman-Harris window."""
    n = np.arange(len(signal))
    t = 2 * np.pi * n / len(signal)
    window = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    return float(2 * np.abs(np.sum(window * signal * np.exp(-2j * np.pi * freq / fs * n))) / np.sum(window))


def two_modes(size: float, *, coupled: bool = True) -> tuple[Floats, float]:
    """Longitudinal end force of a string in its 2nd and 5th mode, and the sampling rate."""
    fs = 96000.0
    motion = longitudinal(fs=fs, eta=0.02)  # its own vibration dies away; the forced one stays
    system = held_string(fs, basis=transverse(14), motion=motion, coupled=coupled, freq_coupled=1e6)
    state, stepper = in_modes(system, {2: size, 5: 0.6 * size}), KernelStepper(system)
    stepper.run(state, 4800)
    return stepper.run(state, 19200)[0][:, 2], fs


def test_phantom_partials_are_at_sums_and_differences_and_as_strong_as_theory_says() -> None:
    size = 2e-5
    force, fs = two_modes(size)
    c, c_longitudinal = np.sqrt(TENSION / DENSITY), np.sqrt(AXIAL / DENSITY)
    f2, f5 = 2 * c / (2 * LENGTH), 5 * c / (2 * LENGTH)
    # v_x^2 / 2 has cosines 3 and 7 of amplitude k2 k5 a2 a5 / 4 at f5 +- f2; mode n answers by -w^2 / (W_n^2 - w^2)
    pair = 0.25 * (2 * np.pi / LENGTH) * (5 * np.pi / LENGTH) * 0.6 * size**2
    for freq in (f2 + f5, f5 - f2):
        answer = sum((2 * np.pi * freq) ** 2 / ((n * np.pi * c_longitudinal / LENGTH) ** 2 - (2 * np.pi * freq) ** 2)
                     for n in (3, 7))  # fmt: skip
        assert amplitude_at(force, freq, fs) == pytest.approx(AXIAL * pair * answer, rel=0.01)
    # twice a partial: its mean stretch moves the whole string's tension
    own = AXIAL * 0.125 * (2 * np.pi / LENGTH * size) ** 2
    assert amplitude_at(force, 2 * f2, fs) == pytest.approx(own, rel=0.01)
    # and nothing at the partials themselves
    assert max(amplitude_at(force, f, fs) for f in (f2, f5)) < 1e-3 * own
    stronger, _ = two_modes(2 * size)
    ratio = amplitude_at(stronger, f2 + f5, fs) / amplitude_at(force, f2 + f5, fs)
    assert ratio == pytest.approx(4.0, rel=5e-3)
    without, _ = two_modes(size, coupled=False)
    assert np.abs(without).max() < 1e-9 * own


@pytest.mark.slow
def test_without_longitudinal_modes_it_is_the_string_of_one_rising_tension() -> None:
    """Two schemes of second order: their difference falls with the square of the step."""
    apart = []
    for fs in (24000.0, 192000.0):
        basis = transverse(40)
        system = held_string(fs, ("y", "z"), basis=basis, motion=longitudinal(1), freq_coupled=1e6)
        ends = [Connection(f"{n}.bridge", (Term(n, "bridge"),), Rigid()) for n in ("y", "z")]
        carrier = System.build(
            {"y": basis, "z": basis}, ends, system.readouts[:1], dt=1 / fs,
            potentials=[TensionModulation("string", ("y", "z"), AXIAL)],
        )  # fmt: skip
        here, there = plucked(system, 6e-3, ("y", "z")), plucked(carrier, 6e-3, ("y", "z"))
        out, _ = NumpyStepper(system).run(here, int(fs / 160))
        expected, _ = NumpyStepper(carrier).run(there, int(fs / 160))
        apart.append(np.abs(out[:, 0] - expected[:, 0]).max() / np.abs(expected).max())
    assert apart[1] < 0.03 * apart[0]
    assert apart[0] < 5e-3


def agree(system: System, state: State, n: int, tol: float = 1e-11, injections: Sequence[Injection] = ()) -> None:
    twin = state.copy()
    expected, pushes = NumpyStepper(system).run(twin, n, injections)
    stepper = KernelStepper(system)
    parts = [stepper.run(state, k, injections) for k in (n // 3, n - n // 3)]
    out, forces = (np.concatenate(p) for p in zip(*parts, strict=True))
    for channel, wanted in zip(out.T, expected.T, strict=True):
        np.testing.assert_allclose(channel, wanted, atol=tol * np.abs(wanted).max())
    np.testing.assert_allclose(forces, pushes, atol=tol * np.abs(pushes).max())
    assert stepper.statistics.failures == 0


@pytest.mark.parametrize("height", [1e-4, 2e-3, 2e-2])
@pytest.mark.parametrize("planes", [("y",), ("y", "z")])
def test_kernel_and_twin_agree(height: float, planes: tuple[str, ...]) -> None:
    system = held_string(48000.0, planes, basis=transverse(bending=BENDING, eta=1e-3))
    agree(system, plucked(system, height, planes), 120)


def test_kernel_and_twin_agree_under_forces_that_change_from_step_to_step() -> None:
    """On both planes, so large that they move the string as much as the pluck did."""
    system = held_string(48000.0, ("y", "z"), basis=transverse(bending=BENDING, eta=1e-3))
    rng, state = np.random.default_rng(5), plucked(system, 2e-3, ("y", "z"))
    pushed = []
    for name, first in (("y", 3), ("z", 17)):
        n, size = system.compiled[system.slot(name)].basis.n_modes, np.abs(system.modes_of(state, name)).max()
        noise = 0.1 * size * rng.normal(size=(2, n, 2)), rng.normal(size=(2, 50))
        pushed.append(Injection(name, first, *noise))
    free = NumpyStepper(system).run(state.copy(), 120)[0]
    assert np.abs(NumpyStepper(system).run(state.copy(), 120, pushed)[0] - free).max() > 0.3 * np.abs(free).max()
    agree(system, state, 120, injections=pushed)


def body() -> ModalBasis:
    return ModalBasis.real([2 * np.pi * 110, 2 * np.pi * 235], [9.0, 14.0], {"bridge": [1.6, 2.2]})


class Quartic(PotentialEnergy):
    """V = 2.5e17 y^4 of one mode."""

    sizes, scale, least = (1,), 0.0, 0.0

    def gradient(self, y: Floats) -> tuple[float, Floats]:
        return float(2.5e17 * y[0] ** 4), 1e18 * y**3


def test_kernel_and_twin_agree_where_each_kind_of_potential_acts() -> None:
    """Each kind ends its own steps: none reflects the psi of another."""
    components = {n: transverse() for n in ("y", "t")} | {"x": longitudinal(), "body": body()}
    components["u"] = ModalBasis.real([2 * np.pi * 300], [3.0], {"bridge": [2.0], "pick": [2.0]})
    shares = {"y": 1.0, "x": 0.3, "t": 1.0, "u": 1.0}
    ends = [Connection(n, (Term(n, "bridge"), Term("body", "bridge", -a)), Rigid()) for n, a in shares.items()]
    potentials = [
        ModalPotential("own", ("u",), lambda bases: Quartic()),
        GeometricStretch("stretched", ("y",), "x", AXIAL, 5000.0),
        TensionModulation("modulated", ("t",), AXIAL),
    ]
    out = [Readout(n, "displacement", (Term(n, "pick"),)) for n in ("y", "t", "u")]
    system = System.build(components, ends, out, dt=1 / 48000, potentials=potentials)
    state = plucked(system, 4e-3, ("y", "t"))
    free, _ = NumpyStepper(system.with_potentials(["stretched", "modulated"])).run(state.copy(), 120)
    acting, _ = NumpyStepper(system).run(state.copy(), 120)
    assert np.abs(acting[:, 2] - free[:, 2]).max() > 0.01 * np.abs(free[:, 2]).max()
    agree(system, state, 120)


@pytest.mark.parametrize("n_along", [None, 20])  # five modes below 22 kHz, or more than one chunk of them
def test_kernel_and_twin_agree_on_a_body_that_the_string_pulls_both_ways(n_along: int | None) -> None:
    ends = {"y": (Term("body", "bridge", -1.0),), "x": (Term("body", "bridge", -0.3),)}
    motion = longitudinal(n_along)
    system = held_string(48000.0, ("y", "z"), motion=motion, others={"body": body()}, ends=ends)
    agree(system, plucked(system, 3e-3, ("y", "z")), 120)
    # and nothing is lost on the way into the body and back but by the body's losses
    state, stepper = plucked(system, 3e-3, ("y", "z")), KernelStepper(system)
    stepper.run(state, 1)
    path = []
    for _ in range(20):
        stepper.run(state, 40)
        path.append(energy(system, state))
    assert np.diff(path).max() < 0


def test_kernel_and_twin_agree_where_the_string_strikes_something() -> None:
    fret = Connection("fret", (Term("y", "fret"),), Contact(1e7, 1.5, loss=0.3, offset=-2e-4))
    system = held_string(48000.0, ("y", "z"), basis=transverse(60), more=[fret])
    state = plucked(system, 3e-3, ("y", "z"))
    agree(system, state.copy(), 150)
    stepper = KernelStepper(system)
    stepper.run(state, 1)
    path, struck = [energy(system, state)], 0.0
    for _ in range(40):
        struck += float(np.abs(stepper.run(state, 10)[1][:, -1]).sum())
        path.append(energy(system, state))
    assert struck > 0
    assert np.diff(path).max() < 1e-10 * path[0]


@pytest.mark.parametrize("isa", ["baseline"])
def test_instruction_sets_agree(isa: str) -> None:
    system = held_string(48000.0, ("y", "z"))
    here, there = plucked(system, 3e-3, ("y", "z")), plucked(system, 3e-3, ("y", "z"))
    out, _ = KernelStepper(system).run(here, 200)
    other, _ = KernelStepper(system, isa=isa).run(there, 200)
    np.testing.assert_allclose(other, out, atol=1e-11 * np.abs(out).max())


def test_blocks_of_any_size_give_the_same_samples() -> None:
    system = held_string(48000.0, ("y", "z"))
    whole, cut = plucked(system, 3e-3, ("y", "z")), plucked(system, 3e-3, ("y", "z"))
    out, _ = KernelStepper(system).run(whole, 192)
    stepper = KernelStepper(system)
    parts = np.concatenate([stepper.run(cut, n)[0] for n in (64, 128)])
    assert np.array_equal(parts, out)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="EA"):
        GeometricStretch("string", ("y",), "x", 0.0)
    plain = ModalBasis.real([500.0], [1.0], {"bridge": [1.0], "pick": [1.0]})
    with pytest.raises(ValueError, match="ramp and sines"):
        held_string(48000.0, basis=plain)
    basis = transverse(10)
    parts, stretch = {"y": basis, "x": longitudinal(3), "w": basis}, GeometricStretch("s", ("y",), "x", AXIAL)
    for other, message in ((("other", ("y",)), "of its own, not 'y'"), (("s", ("w",)), "the same name")):
        with pytest.raises(ValueError, match=message):
            System.build(parts, [], [], dt=1e-4, potentials=[TensionModulation(*other, AXIAL), stretch])
