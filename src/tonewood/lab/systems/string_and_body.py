"""Closed forms: end-loaded string, decay through the body, Weinreich's pair, Helmholtz's resonator.

The body of sixteen modes is the guitar of Antunes & Debut (2017), as their table gives it: f, zeta, modal mass, all
shapes 1 at the bridge.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tonewood.lab.figures import figure
from tonewood.lab.methods import Problem, StepMap, system_map
from tonewood.lab.methods.step_map import held_position
from tonewood.lab.row import Row, nearest
from tonewood.lab.string_end import ExactString, coupled_pole
from tonewood.physics.coupling.connections import Connection, SpringDashpot, Term
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices
from tonewood.support.arrays import Complexes
from tonewood.support.plotting import save

#: f (Hz), zeta, modal mass (kg) of 16 guitar modes at the bridge: Antunes & Debut, J. Acoust. Soc. Am. 141 (2017) 764
SIXTEEN_MODES = (
    (78.3, 0.022, 2.91), (100.2, 0.011, 0.45), (187.3, 0.016, 0.09), (207.8, 0.010, 0.25),
    (250.9, 0.007, 2.65), (291.8, 0.009, 9.88), (314.7, 0.011, 8.75), (344.5, 0.007, 8.80),
    (399.0, 0.014, 0.90), (429.6, 0.009, 0.41), (482.9, 0.007, 0.38), (504.2, 0.007, 1.07),
    (553.9, 0.006, 2.33), (580.3, 0.014, 1.36), (645.7, 0.010, 2.02), (723.5, 0.013, 0.45),
)  # fmt: skip
#: ideal A2: T (N), mu (kg/m), L (m)
A2 = ExactString(0.65, 73.9, 3.61e-3)
BRIDGE = Connection("bridge", (Term("string", "bridge"), Term("body", "bridge", -1.0)))
#: coupled partials of the ideal A2 on the sixteen modes: Hz, decay 1/s; roots of 1 + Y Z0 coth(s L / c) = 0
A2_COUPLED = ((110.1953, 0.2701), (221.0483, 0.7301), (330.3229, 0.0820), (440.5852, 0.7260))


def sixteen_modes() -> ModalBasis:
    """The body, with the point ``bridge``."""
    freq, zeta, mass = np.array(SIXTEEN_MODES).T
    omega = 2 * np.pi * freq
    return ModalBasis.real(omega, zeta * omega, {"bridge": np.ones(16)}, modal_mass=mass)


def sixteen_mode_receptance(s: complex) -> complex:
    """Displacement per force at the bridge, from the table, m/N."""
    freq, zeta, mass = np.array(SIXTEEN_MODES).T
    omega = 2 * np.pi * freq
    return complex(np.sum(1 / (mass * (s**2 + 2 * zeta * omega * s + omega**2))))


def on_sixteen_modes(string: ExactString, freq_upper: float) -> Problem:
    """A lossless string on the body."""
    return Problem({"string": string.basis(freq_upper=freq_upper), "body": sixteen_modes()}, (BRIDGE,))


def weinreich_pair(split: float, r: float) -> StepMap:
    """Two modes near 440 Hz, `split` (rad/s) apart, on one dashpot; each alone decays through it at `r` (1/s)."""
    omega = 2 * np.pi * 440.0
    strings = {
        name: ModalBasis.real([omega + side * split / 2], [0.0], {"end": [1.0]}) for name, side in (("a", -1), ("b", 1))
    }
    bridge = Connection("bridge", (Term("a", "end"), Term("b", "end")), SpringDashpot(damping=2 * r))
    return system_map(System.build(strings, (bridge,), dt=1 / 192000))


def weinreich_eigenvalues(split: float, r: float) -> Complexes:
    """-r +- sqrt(r^2 - split^2 / 4): envelopes of the two common modes, 1/s (Weinreich 1977)."""
    root = np.sqrt(complex(r**2 - split**2 / 4))
    return np.array([-r + root, -r - root])


def resonator(
    volume: float, area: float, neck: float, radius: float, plate_mass: float, plate_freq: float
) -> ModalBasis:
    """A cavity with a neck behind a plate: velocity-potential form (Fabre et al. 2024, Eq. 10).

    Cavity: Ma = V / (rho c^2), Ka = S / (rho (l + 1.7 a)); the plate has the area of the neck, L = S.
    """
    rho, c = 1.2, 343.0
    M = np.diag([plate_mass, volume / (rho * c**2)])
    K = np.diag([plate_mass * (2 * np.pi * plate_freq) ** 2, area / (rho * (neck + 1.7 * radius))])
    C = np.array([[0.0, -area], [area, 0.0]])
    return basis_from_matrices(M, C, K, ["plate", "air"], acoustic_dofs=[1])


def rows() -> Iterator[Row]:
    """Everything of the module."""
    yield from _end_loaded()
    yield from _weinreich()
    yield from _helmholtz()


def _end_loaded() -> Iterator[Row]:
    system = "A2 on 16 modes"
    problem = on_sixteen_modes(A2, 20000.0)
    poles = held_position(problem, 1 / 48000).poles()
    for n, (freq, decay) in enumerate(A2_COUPLED, start=1):
        exact = coupled_pole(A2, sixteen_mode_receptance, n)
        got = nearest(poles, exact)
        source = "roots of 1 + Y Z0 coth(s L/c)"
        yield Row(system, f"partial {n} (Hz)", source + ", 4 decimals", freq, got.imag / (2 * np.pi), 2e-4)
        yield Row(system, f"partial {n} decay (1/s)", source + ", 4 decimals", decay, -got.real, 1e-4)
        cents = float(1200 * np.log2(got.imag / exact.imag))
        yield Row(system, f"partial {n} at 48 kHz (cents)", source, 0, cents, 1e-3)
        # of first order in Z0 Y
        mobility = exact.imag * 1j * sixteen_mode_receptance(1j * exact.imag)
        approximate = 2 * A2.fundamental * A2.impedance * mobility.real
        yield Row(
            system, f"partial {n} decay through the body (1/s)", "2 f0 Z0 Re Y", approximate, -got.real, 0.05,
            relative=True,
        )  # fmt: skip


def _weinreich() -> Iterator[Row]:
    omega = 2 * np.pi * 440.0
    for name, split, r in (("double decay, locked", 1.0, 2.0), ("apart", 8.0, 2.0), ("one frequency", 0.0, 2.0)):
        poles = weinreich_pair(split, r).poles()
        poles = poles[poles.imag > 0]
        expected = np.sort_complex(weinreich_eigenvalues(split, r))
        envelope = np.sort_complex(poles - 1j * omega)
        if split > 2 * r:  # equal decay, two frequencies
            envelope = envelope[np.argsort(envelope.imag)]
            expected = expected[np.argsort(expected.imag)]
        for k, (got, reference) in enumerate(zip(envelope, expected, strict=True), start=1):
            error = float(abs(got - reference))
            source = "-r +- sqrt(r^2 - D^2/4)"
            yield Row("Weinreich pair", f"{name}: envelope pole {k}, distance (1/s)", source, 0, error, 0.01)


def _helmholtz() -> Iterator[Row]:
    system = "Helmholtz resonator"
    volume, area, neck, radius = 0.0125, np.pi * 0.0425**2, 0.0025, 0.0425
    closed = 343.0 / (2 * np.pi) * np.sqrt(area / (volume * (neck + 1.7 * radius)))
    heavy = resonator(volume, area, neck, radius, 1e6, 40.0)
    air = float(heavy.natural_freq[np.argmin(np.abs(heavy.natural_freq - closed))])
    yield Row(system, "air behind a plate that does not give (Hz)", "c/2pi sqrt(S / V (l + 1.7 a))", closed, air, 1e-6)
    # a plate that gives: (w^2 - ws^2)(w^2 - wa^2) = w^2 L^2 / (Ms Ma)
    mass, plate = 0.05, 180.0
    ws2, wa2 = (2 * np.pi * plate) ** 2, (2 * np.pi * closed) ** 2
    coupling = area**2 / (mass * volume / (1.2 * 343.0**2))
    b = ws2 + wa2 + coupling
    root = np.sqrt(b**2 - 4 * ws2 * wa2)
    both = resonator(volume, area, neck, radius, mass, plate).natural_freq
    for name, w2, got in zip(("lower", "upper"), ((b - root) / 2, (b + root) / 2), both, strict=True):
        reference = float(np.sqrt(w2) / (2 * np.pi))
        yield Row(system, f"{name} mode of plate and air (Hz)", "closed quadratic", reference, float(got), 1e-6)


def plots(directory: Path) -> list[Path]:
    """Decay and locking of Weinreich's pair; decay of A2's partials through the body."""
    fig, (pair, decay) = figure(1, 2, size=(11, 4.5))
    splits, r = np.linspace(0.0, 10.0, 41), 2.0
    exact = np.array([weinreich_eigenvalues(d, r) for d in splits])
    got = []
    for d in splits:
        poles = weinreich_pair(float(d), r).poles()
        got.append(np.sort_complex(poles[poles.imag > 0] - 2j * np.pi * 440.0))
    pair.plot(splits, -exact.real, "k-")
    pair.plot(splits, exact.imag, "C0-")
    pair.plot(splits, -np.array(got).real, "k.")
    pair.plot(splits, np.array(got).imag, "C0.")
    pair.set(
        xlabel="split (rad/s)", ylabel="1/s, rad/s", title="Weinreich's pair: decay (black), beating (blue), r = 2"
    )
    partials = np.arange(1, 31)
    poles = held_position(on_sixteen_modes(A2, 20000.0), 1 / 48000).poles()
    exact_poles = [coupled_pole(A2, sixteen_mode_receptance, int(n)) for n in partials]
    rough = [
        2 * A2.fundamental * A2.impedance * (1j * p.imag * sixteen_mode_receptance(1j * p.imag)).real
        for p in exact_poles
    ]
    decay.semilogy(partials, [-p.real for p in exact_poles], "ko", mfc="none", label="exact end of the string")
    decay.semilogy(partials, [-nearest(poles, p).real for p in exact_poles], "C3.", label="48 kHz")
    decay.semilogy(partials, rough, "C0_", label="2 f0 Z0 Re Y")
    decay.set(xlabel="partial", ylabel="decay (1/s)", title="Ideal A2 on 16 guitar modes")
    decay.legend(fontsize=8)
    return [save(fig, directory / "string_and_body.png")]
