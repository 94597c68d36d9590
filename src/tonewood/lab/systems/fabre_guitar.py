"""The guitar of Fabre, Le Carrou & Chomette (2024, section 3.2.1): a stiff string on a plate with an air cavity behind.

Body: their Eq. 38. String: radius, length, density, Young's modulus and tuning as printed; the paper says nothing of
its loss, so it is given a decay rate common to all partials, for which string and body together have an exact
solution. Their string is free at the bridge in cosine modes; here it moves the bridge by its ramp.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.linalg as sla

from tonewood.lab import assembled
from tonewood.lab.assembled import Matrices
from tonewood.lab.figures import figure
from tonewood.lab.methods import Problem, coupled_receptance, forms
from tonewood.lab.methods.step_map import held_position
from tonewood.lab.row import Row, cents, halving_order, nearest
from tonewood.lab.string_end import ExactString, coupled_pole
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.modal.damping import phase_collinearity, with_damping_case
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.synthesis import basis_from_matrices
from tonewood.support.arrays import Floats
from tonewood.support.plotting import save

SYSTEM = "Fabre guitar"
#: plate and air, dofs x_s (m) and z_a (velocity potential): Eq. 38
BODY = Matrices(np.diag([0.031, 2.7e-7]), np.array([[1.4, -0.036], [0.036, 3.1e-6]]), np.diag([2.2e4, 0.12]))
#: decay rate of every string partial by itself, 1/s: not in the paper
SIGMA0 = 0.5
#: ramp of force: to 1.1 N in 1 s, at 3/5 of the length from the bridge
FORCE, RAMP, PLUCK = 1.1, 1.0, 0.6
BRIDGE = Connection("bridge", (Term("string", "bridge"), Term("body", "plate", -1.0)))
PARTIALS = (1, 20, 40, 60)


def exact_string() -> ExactString:
    """The string: radius .48 mm, 64 cm, tuned to 82.4 Hz (its ideal fundamental)."""
    return ExactString.tuned(0.48e-3, 0.64, 82.4, SIGMA0)


def string(freq_upper: float | None = None, n_modes: int | None = None) -> ModalBasis:
    """Return the string's modes, with the point ``pluck``."""
    return exact_string().basis({"pluck": PLUCK}, freq_upper=freq_upper, n_modes=n_modes)


def body(case: str = "complex") -> ModalBasis:
    """Plate and air under a damping case."""
    return with_damping_case(basis_from_matrices(*BODY, ["plate", "air"], acoustic_dofs=[1]), case)


def problem(basis: ModalBasis, case: str = "complex") -> Problem:
    """Force on the string, displacement of the plate."""
    components = {"string": basis, "body": body(case)}
    return Problem(components, (BRIDGE,), (Term("string", "pluck"),), (Term("body", "plate"),))


def body_receptance(s: complex) -> complex:
    """Displacement of the plate per force on it, from the matrices, m/N."""
    return complex(assembled.receptance(BODY, s, 0, 0)[0])


def pluck(problem: Problem, fs: float, duration: float) -> Floats:
    """(n,) displacement of the plate: ramp of force for 1 s, release, free motion until `duration`."""
    step = held_position(problem, 1 / fs)
    ramp = FORCE * np.arange(round(RAMP * fs) + 1)[:, None] / (RAMP * fs)
    driven, x = step.advance(np.zeros(len(step.T)), ramp)
    # released at its peak: free motion from the state there follows
    free, _ = step.advance(x, np.zeros((round((duration - RAMP) * fs) + 1, 1)))
    return np.concatenate([driven, free[1:]])[:, 0]


def rows() -> Iterator[Row]:
    """Body, held string, coupled poles, their error at 48 and 96 kHz, waveform, damping cases."""
    by_paper = "values of Fabre 2024, Eq. 38"
    basis = body()
    for k, (re, im, freq, zeta, mpc) in enumerate(
        (
            (-7.5758, 564.2882, 89.817, 0.01342, 0.99999),
            (-20.7455, 994.9581, 158.387, 0.02085, 0.99993),
        )
    ):
        name = f"body mode {k + 1}"
        yield Row(SYSTEM, f"{name}: Re pole (1/s)", by_paper, re, float(basis.poles[k].real), 6e-5)
        yield Row(SYSTEM, f"{name}: Im pole (rad/s)", by_paper, im, float(basis.poles[k].imag), 6e-5)
        yield Row(SYSTEM, f"{name}: frequency (Hz)", by_paper, freq, float(basis.natural_freq[k]), 6e-4)
        yield Row(SYSTEM, f"{name}: zeta", by_paper, zeta, float(basis.damping_ratio[k]), 6e-6)
        yield Row(SYSTEM, f"{name}: MPC", by_paper, mpc, float(phase_collinearity(basis.right)[k]), 6e-6)

    exact = exact_string()
    fine = string(freq_upper=0.45 * 96000)
    string_alone = Problem({"string": fine}, (Connection("wall", (Term("string", "bridge"),)),))
    poles = held_position(string_alone, 1 / 96000).poles()
    for n in (1, 10, 20):
        reference = exact.pole(n)
        closed = "n f0 sqrt(1 + B n^2)"
        yield Row(
            SYSTEM, f"string held at the bridge, partial {n} (cents)", closed, 0,
            cents(nearest(poles, reference), reference), 1e-3,
        )  # fmt: skip

    expected = {n: coupled_pole(exact, body_receptance, n) for n in PARTIALS}
    by_stiffness = "exact dynamic stiffness, Newton"
    coarse = string(freq_upper=0.45 * 48000)
    continuous = np.asarray(sla.eigvals(forms.general(problem(coarse)).F), dtype=np.complex128)
    at = {fs: held_position(problem(coarse), 1 / fs).poles() for fs in (48000, 96000)}
    for n, pole in expected.items():
        got = nearest(continuous, pole)
        yield Row(
            SYSTEM, f"{coarse.n_modes} modes, no step: partial {n} (cents)", by_stiffness, 0, cents(got, pole), 1e-6
        )
        yield Row(
            SYSTEM, f"{coarse.n_modes} modes, no step: partial {n} decay (1/s)", by_stiffness, -pole.real, -got.real,
            1e-7, relative=True,
        )  # fmt: skip
    limits = {48000: (1e-5, 5e-3, 0.06, 0.5), 96000: (1e-6, 4e-4, 4e-3, 0.03)}
    for fs, tolerances in limits.items():
        for (n, pole), tolerance in zip(expected.items(), tolerances, strict=True):
            error = cents(nearest(at[fs], pole), pole)
            yield Row(SYSTEM, f"{fs // 1000} kHz: partial {n} (cents)", by_stiffness, 0, error, tolerance)
    for n in (20, 40):
        slow, fast = (abs(cents(nearest(at[rate], expected[n]), expected[n])) for rate in (48000, 96000))
        yield Row(SYSTEM, f"order of the pitch error, partial {n}", "4", 4, halving_order(slow, fast), 0.3)

    grid = np.array([82.0, 90.0, 160.0, 250.0, 1000.0, 3000.0])
    response = coupled_receptance(problem(coarse), grid)[:, 0, 0]
    error = float(np.abs(response / np.array([exact_response(f) for f in grid]) - 1).max())
    yield Row(SYSTEM, "plate over force on string, 6 frequencies, relative", "exact dynamic stiffness", 0, error, 2e-4)

    # half as many modes: the assembled system has the same
    duration, few = 1.3, string(n_modes=46)
    times = np.arange(round((RAMP - 0.01) * 48000), round(duration * 48000) + 1) / 48000
    system, direction = exact_string().assembled(few.n_modes - 1, BODY, np.array([1.0, 0.0]), PLUCK)
    plate = np.eye(len(direction))[few.n_modes - 1]
    reference_wave = assembled.ramp_and_release(system, direction, FORCE / RAMP, RAMP, times, plate)
    peak = np.abs(reference_wave[times > RAMP]).max()
    wave, case_2 = (pluck(problem(few, case), 48000, duration)[-len(times) :] for case in ("complex", "proportional"))
    error = float(np.abs(wave - reference_wave).max() / peak)
    yield Row(SYSTEM, "waveform of the plate, 48 kHz, largest error / peak", "eig of assembled M, C, K", 0, error, 1e-4)
    overlap = "Fabre 2024, Fig. 5: the curves overlap"
    error = float(np.abs(wave - case_2).max() / peak)
    yield Row(SYSTEM, "case 2 against case 1, waveform / peak", overlap, 0, error, 0.05)
    peaks = np.array([p.imag / (2 * np.pi) for p in expected.values()])
    levels = [np.abs(coupled_receptance(problem(coarse, c), peaks)[:, 0, 0]) for c in ("complex", "proportional")]
    error = float(np.abs(20 * np.log10(levels[1] / levels[0])).max())
    yield Row(SYSTEM, "case 2 against case 1 at the partials (dB)", overlap, 0, error, 0.5)


def exact_response(freq: float) -> complex:
    """Plate over force on the string at one frequency, m/N; by reciprocity string over force on the plate."""
    s, string_end = 2j * np.pi * freq, exact_string()
    plate = 1 / (1 / string_end.end_receptance(s) + 1 / body_receptance(s))
    return plate * string_end.transfer(s, PLUCK * string_end.length)


def plots(directory: Path) -> list[Path]:
    """Redraw Fig. 5: force, waveform, its beginning, and spectrum of the plate in damping cases 1 and 2."""
    fs = 48000.0
    basis = string(freq_upper=0.45 * fs)
    fig, (force, wave, start, spectrum) = figure(4, 1, size=(9, 12))
    exact = exact_string()
    times = np.arange(round(2.0 * fs) + 1) / fs
    force.plot(times, np.where(times <= RAMP, FORCE * times / RAMP, 0.0), "k")
    force.set(ylabel="force on string (N)", title="Guitar of Fabre 2024, Fig. 5")
    freq = np.arange(40.0, 1500.0, 0.1)
    for number, case, style in ((1, "complex", "k"), (2, "proportional", "C3--")):
        system = problem(basis, case)
        y = pluck(system, fs, 2.0) * 1e3
        label = f"case {number}: {case}"
        wave.plot(times, y, style, linewidth=1, label=label)
        near = (times >= 1.0) & (times <= 1.1)
        start.plot(times[near], y[near], style, linewidth=1, label=label)
        level = 20 * np.log10(np.abs(coupled_receptance(system, freq)[:, 0, 0]))
        spectrum.plot(freq, level, style, linewidth=1, label=label)
    for n in range(1, 17):
        f = coupled_pole(exact, body_receptance, n).imag / (2 * np.pi)
        spectrum.plot(f, 20 * np.log10(np.abs(coupled_receptance(problem(basis), f)[0, 0, 0])) + 4, "k*", markersize=5)
    for f, marker in zip(body().natural_freq, "so", strict=True):
        spectrum.plot(f, 20 * np.log10(np.abs(coupled_receptance(problem(basis), f)[0, 0, 0])) + 10, "C0" + marker)
    wave.set(ylabel="plate (mm)", xlabel="time (s)")
    start.set(ylabel="plate (mm)", xlabel="time (s)")
    spectrum.set(xlabel="frequency (Hz)", ylabel="plate / force on string (dB re 1 m/N)")
    spectrum.set_title("stars: string partials; square: air; circle: plate", fontsize=9)
    wave.legend()
    return [save(fig, directory / "fabre_fig5_guitar.png")]
