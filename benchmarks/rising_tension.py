"""How near strings whose tension rises come to their exact motion, pluck by pluck: 48 kHz against eight times the rate.

    python benchmarks/rising_tension.py            # about two minutes on one core

Prints the figures of docs/theory.md: square root of the summed squares of the errors over that of the motion, of modes
for the first table, of the displacement at a fifth of the string for the third. The second says how often psi of the
rising tension is negative; the fourth, how far levels of phantom partials beside a longitudinal mode are off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import norm

import tonewood as tw
import tonewood.authoring as ta
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.system import System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.stepping.forcing import Injection, compile_force
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion

RATE, FINER, MODES = 48000, 8, 40
SECONDS = 0.1
FORCES = (2.0, 10.0, 40.0, 100.0)
HEIGHTS = (5e-4, 2e-3, 6e-3, 2e-2)  # m
LENGTH, AXIAL, DENSITY = 0.645, 14613.0, 5.735e-4
LONGITUDINAL = float(np.sqrt(AXIAL / DENSITY)) / (2 * LENGTH)  # Hz
LINES = 1 << 14

Floats = NDArray[np.float64]


def scene(force: float, rate: float) -> tuple[System, list[Injection], tuple[str, ...]]:
    """G3 of `steel_strings` on its body, the force of a ramp on it, and the string's components."""
    guitar = tw.load_instrument("steel_strings").replace(
        {"tuning.compensate": "none", "strings.*.polarizations": ["z", "y"]}
    )
    values = dict(guitar.resolved)
    values["strings"], values["connections"] = {"G3": values["strings"]["G3"]}, {}
    model = assemble(tw.Instrument.from_values(values, guitar.folder), rate)
    gesture = model.exciters["pluck"].gesture(ta.Event({"force": force}, 196.0), model.place("G3"))
    system, injections = model.system, []
    for component, weight in model.strings["G3"].weights(gesture.angle_deg).items():
        basis = system.compiled[system.slot(component)].basis
        injections += compile_force(
            component, basis, "pluck", gesture.segments, system.dt, time=0.021, factor=weight
        )  # fmt: skip
    return system, injections, model.strings["G3"].components


def plucked(force: float, times: int) -> Floats:
    """Lowest modes of the plucked string at every 48 000th of a second."""
    system, injections, parts = scene(force, float(RATE * times))
    stepper, state, path = KernelStepper(system), system.start(), []
    for _ in range(int(SECONDS * RATE)):
        stepper.run(state, times, injections)
        path.append([np.array(system.modes_of(state, name)[0, :MODES]) for name in parts])
    return np.asarray(path)


def signs(force: float) -> tuple[float, float]:
    """Share of steps in which psi is negative; largest rise of the energy in 64 steps after the pluck, relative."""
    system, injections, _ = scene(force, float(RATE))
    stepper, state, psi, energies = KernelStepper(system), system.start(), [], []
    for i in range(int(SECONDS * RATE)):
        stepper.run(state, 1, injections)
        psi.append(state.potentials[system.potentials.memory[0]][2])
        if i > 0.03 * RATE and i % 64 == 0:
            energies.append(stored_energy(system, state).total)
    return float(np.mean(np.array(psi) < 0.0)), float(np.diff(energies).max() / max(energies))


def released(height: float, times: int, seconds: float) -> tuple[Floats, Floats]:
    """Steel string with longitudinal motion, rigid ends: 40 modes in each plane, 5 along, let go from a triangle.

    Returns (n, 2) displacements of its planes at a fifth, and (n,) N, its longitudinal force on the bridge.
    """
    length, stiffness = LENGTH, AXIAL

    def modes(tension: float, bending: float, eta: float, count: int) -> ta.ModalBasis:
        def loss(w: Floats, k: Floats) -> Floats:
            return np.full_like(w, eta)

        return ta.string_basis(length, tension, DENSITY, bending, loss, n_modes=count)

    across = modes(104.1, 8.5e-5, 1e-3, MODES).with_places({"pick": 0.2 * length})
    lengthwise = modes(stiffness, 0.0, 2e-3, 5)
    ends = [ta.Connection(name, (ta.Term(name, "bridge"),)) for name in ("y", "z", "x")]
    stretch = GeometricStretch("string", ("y", "z"), "x", stiffness)
    read = [ta.Readout(name, "displacement", (ta.Term(name, "pick"),)) for name in ("y", "z")]
    parts = {"y": across, "z": across, "x": lengthwise}
    system = System.build(parts, ends, read, dt=1 / (RATE * times), potentials=[stretch])
    state = system.start()
    vec = np.asarray(across.metadata["vec"])
    n = np.arange(1, len(vec))
    a = (
        2 * height / (np.pi**2 * n**2 * 0.16) * np.sin(0.2 * n * np.pi)
    )  # sines of a triangle with its corner at a fifth
    q = DENSITY * length * (vec[0] * (a @ (1 / (np.pi * n))) + 0.5 * a @ vec[1:])
    for size, name in ((1.0, "y"), (0.5, "z")):
        system.modes_of(state, name)[:] = from_motion(across, size * q, np.zeros(len(q)))
    out, forces = KernelStepper(system).run(state, int(seconds * RATE) * times)
    return out[::times], forces[::times, 2]


def phantoms(height: float, times: Sequence[int]) -> list[tuple[float, list[float]]]:
    """Lines of the longitudinal force within 8 % of the first longitudinal mode and 60 dB of the loudest of them.

    Returns frequency, Hz, and levels at so many times the rate, dB re the loudest at the finest.
    """
    spectra = []
    for n in times:
        force = released(height, n, 0.35)[1][-LINES:]
        spectra.append(20 * np.log10(np.abs(np.fft.rfft(force * np.blackman(LINES)))))
    freq, best = np.fft.rfftfreq(LINES, 1 / RATE), spectra[-1]
    near = np.flatnonzero(np.abs(freq / LONGITUDINAL - 1) < 0.08)
    loudest = best[near].max()
    lines = [i for i in near if best[i] == best[i - 6 : i + 7].max() > loudest - 60]
    return [(float(freq[i]), [float(s[i - 6 : i + 7].max() - loudest) for s in spectra]) for i in lines]


def error(rough: Floats, exact: Floats) -> str:
    """Relative error."""
    return f"{norm((rough - exact).ravel()) / norm(exact.ravel()):.1e}"


def main() -> None:
    print(f"G3 of steel_strings on its body, first {MODES} modes of each plane, {SECONDS:g} s, {RATE} Hz\n")
    print("| pluck, N | error |\n|---|---|")
    for force in FORCES:
        print(f"| {force:g} | {error(plucked(force, 1), plucked(force, FINER))} |", flush=True)
    print("\n| pluck, N | steps with psi < 0 | largest rise of the energy |\n|---|---|---|")
    for force in (500.0, 1000.0):
        share, rise = signs(force)
        print(f"| {force:g} | {100 * share:.2g} % | {rise:.1g} |", flush=True)
    print(f"\nsteel string with longitudinal motion, rigid ends, 10 ms, {RATE} Hz\n")
    print("| triangle, mm | error |\n|---|---|")
    for height in HEIGHTS:
        print(f"| {height * 1e3:g} | {error(*(released(height, n, 0.01)[0] for n in (1, FINER)))} |", flush=True)
    print(
        f"\nthe same string, longitudinal force on the bridge near its first longitudinal mode, {LONGITUDINAL:.0f} Hz\n"
    )
    print("| triangle, mm | Hz | dB | error at 1, 2, 4 times the rate, dB |\n|---|---|---|---|")
    for height in HEIGHTS[:3]:
        for freq, levels in phantoms(height, (1, 2, 4, FINER)):
            errors = ", ".join(f"{level - levels[-1]:.1f}" for level in levels[:-1])
            print(f"| {height * 1e3:g} | {freq:.0f} | {levels[-1]:.0f} | {errors} |", flush=True)


if __name__ == "__main__":
    main()
