"""Pictures and figures of docs/gong.md: ``python scripts/gong_pictures.py [FOLDER]`` (docs/images by default).

It prints the errors against an integration of high order, and the times of steps; some minutes.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.integrate import solve_ivp
from scipy.signal import spectrogram
from tonewood.plugins._gong_energy import GongPlate, PlateGrid
from tonewood.plugins.gong import PlateEnergy, stiffening

import tonewood as tw
from tonewood.instrument.model.assembly import assemble
from tonewood.physics.coupling.potentials.user import ModalPotential
from tonewood.physics.coupling.system import System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, to_motion

FS = 48000
SECONDS = 4.0
PLATE = GongPlate(0.22, 0.30, 1e-3, 110e9, 0.34, 8700.0)
EDGES = ("sliding", "movable")
#: MIDI velocities
BLOWS = {"soft": 30, "medium": 90, "hard": 127}

Floats = NDArray[np.float64]


def sound(velocity: int, effects: str) -> Floats:
    """Acceleration of one point, m/s^2."""
    gong = tw.load_instrument("gong").replace({"effects.mode": effects})
    score = tw.Score([tw.Note(0.1, 4.0, 33.0, velocity_midi=velocity)])
    audio = tw.render(score, gong, max_duration=SECONDS)
    return np.asarray(audio.samples[:, 0], dtype=np.float64)


def pictures(folder: Path) -> None:
    """Spectrograms of three blows, linear and not; and the lowest partial of each."""
    figure, axes = plt.subplots(3, 3, figsize=(12, 9), layout="constrained", sharex=True)
    for column, (name, velocity) in enumerate(BLOWS.items()):
        for row, (effects, title) in enumerate((("none", "linear"), ("all", "large deflection"))):
            x = sound(velocity, effects)
            freq, at, power = spectrogram(x, FS, nperseg=4096, noverlap=3072)
            axis = axes[row, column]
            axis.pcolormesh(at, freq / 1e3, 10 * np.log10(power / power.max() + 1e-12), vmin=-90, vmax=0)
            axis.set(ylim=(0, 8), title=f"{name} blow, {title}")
            freq, at, power = spectrogram(x, FS, nperseg=16384, noverlap=15872)
            inside = (freq > 35) & (freq < 150)
            power = (power / np.maximum(freq, 1.0)[:, None] ** 4)[inside]  # of the displacement
            lowest = freq[inside][power.argmax(axis=0)]
            axes[2, column].plot(at, lowest, label=title, color="0.6" if row == 0 else "C3", lw=3 - row)
        axes[2, column].set(ylim=(0, 150), xlabel="time, s", title="lowest partial")
    axes[0, 0].set_ylabel("kHz")
    axes[1, 0].set_ylabel("kHz")
    axes[2, 0].set_ylabel("Hz")
    axes[2, 0].legend()
    path = folder / "gong.png"
    figure.savefig(path, dpi=70)
    with Image.open(path) as picture:
        few_colours = picture.convert("RGB").quantize(96)
    few_colours.save(path, optimize=True)


def blown(grid: PlateGrid, omega: Floats, thicknesses: float) -> Floats:
    """Velocities after a soft blow that bends the linear plate by so many thicknesses."""
    here = PLATE.shapes(grid.numbers, 0.31 * PLATE.a, 0.27 * PLATE.b)
    v = here * np.exp(-((omega / (2 * np.pi * 1000.0)) ** 2))
    times = np.arange(400) / FS
    return thicknesses * PLATE.thickness / np.abs((here * v / omega) @ np.sin(np.outer(omega, times))).max() * v


def system_of(grid: PlateGrid, omega: Floats, fs: float, loss: Floats) -> tuple[System, ModalBasis]:
    """Modes of the plate and their potential."""
    basis = ModalBasis.real(omega, loss, {"p": np.ones(len(omega))})
    potential = ModalPotential("gong", ("plate",), lambda bases: PlateEnergy(grid))
    return System.build({"plate": basis}, [], [], dt=1 / fs, potentials=[potential]), basis


def errors(freq_upper: float = 1950.0, pieces: int = 20) -> None:
    """Errors of 20 ms, sums of squares over modes and milliseconds."""
    numbers, omega = PLATE.modes(freq_upper)
    n, times = len(omega), np.arange(1, pieces + 1) / 1000
    print(f"error of 20 ms, {n} modes\n| edges | thicknesses | largest V / E | 48 kHz | 96 kHz |")
    print("|---|---:|---:|---:|---:|")
    for edges in EDGES:
        grid = PlateGrid(PLATE, numbers, edges)
        for thicknesses in (0.1, 1.0, 3.0):
            v = blown(grid, omega, thicknesses)

            def motion(t: float, z: Floats, grid: PlateGrid = grid) -> Floats:
                return np.concatenate([z[n:], -(omega**2) * z[:n] - grid.gradient(z[:n])[1]])

            start = np.concatenate([np.zeros(n), v])
            path = solve_ivp(motion, (0, times[-1]), start, method="DOP853", rtol=1e-10, atol=1e-14, t_eval=times)
            exact = path.y[:n]
            share = max(grid.energy(y) for y in exact.T) / (0.5 * v @ v)
            row = []
            for fs in (48e3, 96e3):
                system, basis = system_of(grid, omega, fs, np.zeros(n))
                state, stepper, found = system.start(), KernelStepper(system), []
                system.modes_of(state, "plate")[:] = from_motion(basis, np.zeros(n), v)
                for _ in range(pieces):
                    stepper.run(state, round(fs / 1000))
                    found.append(to_motion(basis, system.modes_of(state, "plate"))[0])
                row.append(f"{np.linalg.norm(np.array(found).T - exact) / np.linalg.norm(exact):.1e}")
            print(f"| {edges} | {thicknesses:g} | {share:.2g} | {' | '.join(row)} |", flush=True)


def costs() -> None:
    """Seconds of the process per second of sound, and K."""
    print("s per s of sound at 48 kHz, and K, 1/J\n| modes | to, Hz | sliding | movable | K sliding | K movable |")
    print("|---:|---:|---:|---:|---:|---:|")
    for n in (20, 80, 200):
        numbers, omega = (a[:n] for a in PLATE.modes(8000.0))
        row, K = [], []
        for edges in EDGES:
            grid = PlateGrid(PLATE, numbers, edges)
            system, basis = system_of(grid, omega, FS, 0.7 + 2e-8 * omega**2)
            state, stepper = system.start(), KernelStepper(system)
            system.modes_of(state, "plate")[:] = from_motion(basis, np.zeros(n), blown(grid, omega, 1.0))
            stepper.run(state, 64)
            best = np.inf
            for _ in range(7):
                began = time.process_time()
                stepper.run(state, 1920)
                best = min(best, (time.process_time() - began) / 1920 * FS)
            row.append(f"{best:.2f}")
            K.append(f"{stiffening(grid, omega):.1f}")
        print(f"| {n} | {omega[-1] / (2 * np.pi):.0f} | {' | '.join(row + K)} |", flush=True)


def deflections() -> None:
    """Largest displacement of the struck place, and times of whole renders."""
    print("| blow | m/s | peak, thicknesses | lowest partial, Hz, at .2 s | s per s |\n|---|---:|---:|---:|---:|")
    gong = tw.load_instrument("gong")
    model = assemble(gong, FS)
    for name, velocity in BLOWS.items():
        changed = gong.replace(
            {
                "strings.gong.points": {"here": {"from_bridge": {"fraction": 0.55}}},
                "outputs.0.quantity": "displacement",
                "outputs.0.full_scale": 1.0,
                "outputs.0.channels": {"here": "gong.here"},
            }
        )
        score = tw.Score([tw.Note(0.1, 4.0, 33.0, velocity_midi=velocity)])
        began = time.process_time()
        x = tw.render(score, changed, max_duration=1.0).samples[:, 0]
        spent = time.process_time() - began
        part = x[round(0.15 * FS) : round(0.45 * FS)]
        spectrum = np.abs(np.fft.rfft((part - part.mean()) * np.hanning(len(part)), 1 << 17))
        freq = np.fft.rfftfreq(1 << 17, 1 / FS)
        lowest = freq[spectrum.argmax()]
        speed = model.instrument.spec.playing.velocity.value(velocity)
        peak = np.abs(x).max() / PLATE.thickness
        print(f"| {name} | {speed:.2g} | {peak:.2g} | {lowest:.0f} | {spent:.2g} |", flush=True)


def main() -> None:
    """Draw the picture and print the tables."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1] / "docs" / "images"
    pictures(folder)
    deflections()
    costs()
    errors()


if __name__ == "__main__":
    main()
