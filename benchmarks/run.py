"""Measure the time that tonewood takes on this machine: one table.

    python benchmarks/run.py            # some minutes
    python benchmarks/run.py --quick    # shorter scores, fewer repeats

One core; times are the processor's, medians of repeats, with the fastest and the slowest beside them. "x real time" is
seconds of sound per second of computing, without imports and loading. Nothing here decides a test.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

import tonewood as tw
import tonewood.authoring as ta
from tonewood import _kernel
from tonewood.performance.engine.engine import GRID, Engine
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set
from tonewood.physics.stepping.stepper import NumpyStepper

ROOT = Path(__file__).parents[1]
FS = 48000
Row = tuple[str, str, str]


def machine() -> str:
    """Processor, cores, instruction set, versions."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.partition(":")[2].strip() for line in info.read_text().splitlines() if "model name" in line]
        name = names[0] if names else name
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return (
        f"{name}, {os.cpu_count()} cores{load}; {instruction_set()}; Python {platform.python_version()}, "
        f"NumPy {np.__version__}, tonewood {tw.__version__}"
    )


def repeated(measure: Callable[[], float], times: int) -> tuple[float, str]:
    """Median, and the spread in words."""
    found = [measure() for _ in range(times)]
    return statistics.median(found), f"{min(found):.3g} to {max(found):.3g} in {times} runs"


def chord(
    instrument: tw.Instrument,
    outputs: list[str] | None = None,
    effects: str = "all",
    max_duration: float | None = None,
) -> tw.Renderer:
    """All six strings of a guitar, both polarizations, plucked at once; with effects `all`, no mode is left out."""
    notes = [tw.Note(0.0, 600.0, string=name, stop=0, force=2.0) for name in instrument.string_names]
    return tw.Renderer(tw.Score(notes), instrument, FS, outputs=outputs, effects=effects, max_duration=max_duration)


def all_ringing(repeats: int) -> Iterator[Row]:
    """The whole guitar while every string rings, and the kernel's part of its time."""
    guitar = tw.load_instrument("classical_guitar")

    def engine_factor(effects: str = "all") -> float:
        renderer = chord(guitar, effects=effects)
        engine = Engine(renderer.model, renderer.performance.timeline)
        engine.advance(100)  # the plucks
        n_ticks = 3 * FS // GRID
        began = time.process_time()
        engine.advance(n_ticks)
        return n_ticks * GRID / FS / (time.process_time() - began)

    def render_factor() -> float:
        renderer = chord(guitar, max_duration=3.0)
        began = time.process_time()
        for _ in renderer.blocks(4096):
            pass
        return 3.0 / (time.process_time() - began)

    model = chord(guitar).model
    value, spread = repeated(engine_factor, repeats)
    what = f"guitar, {model.n_modes} modes ringing, 2 microphones, 48 kHz"
    yield what, f"{value:.1f} x real time", spread
    value, spread = repeated(lambda: engine_factor("auto"), repeats)
    yield "  with effects `auto`", f"{value:.1f} x real time", spread
    value, spread = repeated(render_factor, repeats)
    yield "  the same rendered, plucks and blocks included", f"{value:.1f} x real time", spread


def kernel_cost(repeats: int) -> Iterator[Row]:
    """Nanoseconds per mode and sample, and the share of the multiply-adds this core can do."""
    system = chord(tw.load_instrument("classical_guitar")).model.system
    n_modes = sum(c.basis.n_modes for c in system.compiled)
    rigid = {(t.component, t.point) for c in system.connections if isinstance(c.law, Rigid) for t in c.terms}
    multiply_adds = 0
    for name, compiled, one_way in zip(system.names, system.compiled, system.layout.driven, strict=True):
        ports = len(compiled.ports) if one_way else sum(part == name for part, _ in rigid)
        rows = len(compiled.readouts) + (0 if one_way else ports)
        multiply_adds += compiled.basis.n_modes * (4 + 2 * ports + 2 * rows)
    stepper = KernelStepper(system)
    state = stepper.start()
    state.modes[:] = np.random.default_rng(1).standard_normal(state.modes.shape) * 1e-6

    def seconds() -> float:
        n = 4096  # as many as an engine steps at a time
        began = time.process_time()
        stepper.run(state, n)
        return (time.process_time() - began) / n

    seconds()
    value, spread = repeated(lambda: 1e9 * seconds() / n_modes, 10 * repeats)
    yield "kernel, linear step", f"{value:.3f} ns per mode and sample", spread
    peak = max(_kernel.fma_peak(instruction_set(), 0.1) for _ in range(3 * repeats))
    yield f"this core's peak, {instruction_set()}", f"{peak / 1e9:.1f} G multiply-adds/s", f"best of {3 * repeats} runs"
    share = multiply_adds / (value * 1e-9 * n_modes) / peak
    yield (
        "  share of it in the kernel",
        f"{100 * share:.0f} %",
        f"{multiply_adds / n_modes:.1f} multiply-adds per mode and sample that the equations need",
    )
    yield (
        "  the guitar if it did nothing else, at that peak",
        f"{peak / (multiply_adds * FS):.0f} x real time",
        "a bound",
    )


def where_it_goes(repeats: int) -> Iterator[Row]:
    """Time of the kernel by task, from the same guitar with parts left out."""
    guitar = tw.load_instrument("classical_guitar")
    low = guitar.replace({f"strings.{name}.freq_upper": 1500.0 for name in guitar.string_names})
    systems = [chord(guitar).model.system, *(chord(g, ["bridge"]).model.system for g in (guitar, low))]
    modes = [sum(c.basis.n_modes for c in system.compiled) for system in systems]
    steppers = [KernelStepper(system) for system in systems]
    states = [stepper.start() for stepper in steppers]
    n, times = 4096, []
    for _ in range(8 * repeats):
        row = []
        for stepper, state in zip(steppers, states, strict=True):
            state.modes[:] = np.random.default_rng(1).standard_normal(state.modes.shape) * 1e-6
            began = time.process_time()
            stepper.run(state, n)
            row.append(1e9 * (time.process_time() - began) / n)
        times.append(row)
    whole, deaf, few = np.median(times, axis=0)
    per_mode = (deaf - few) / (modes[1] - modes[2])
    how = f"medians of {8 * repeats} runs side by side"
    yield "where a sample's time goes: all", f"{whole:.0f} ns", how
    what = f"  microphones, {modes[0] - modes[1]} modes driven by 2 forces and read by 2 channels"
    yield what, f"{whole - deaf:.0f} ns", "less without them"
    strings = modes[0] - sum(systems[0].compiled[systems[0].slot(c)].basis.n_modes for c in ("body", "microphones"))
    yield f"  {strings} string modes", f"{per_mode * strings:.0f} ns", "from fewer of them"
    yield "  body, connections and the rest", f"{deaf - per_mode * strings:.0f} ns", "the rest"


def kernel_against_twin(repeats: int) -> Iterator[Row]:
    """The C++ kernel and the NumPy stepper on the same guitar."""
    system = chord(tw.load_instrument("classical_guitar")).model.system
    kernel, twin = KernelStepper(system), NumpyStepper(system)
    start = system.start()
    start.modes[:] = np.random.default_rng(1).standard_normal(start.modes.shape) * 1e-6
    n = 2000
    runs: list[np.ndarray] = []
    taken = []
    for stepper in (kernel, twin):
        times = []
        for _ in range(repeats):
            state = start.copy()
            began = time.process_time()
            out = stepper.run(state, n)[0]
            times.append(time.process_time() - began)
        runs.append(out)
        taken.append(statistics.median(times))
    worst = np.abs(runs[0] - runs[1]).max() / np.abs(runs[1]).max()
    yield "kernel against NumPy twin, same guitar", f"{taken[1] / taken[0]:.0f} times faster", f"{n} steps"
    yield "  difference of their outputs", f"{worst:.1e} of the peak", f"after {n} steps"


def undamped_energy(steps: int) -> Iterator[Row]:
    """A stiff string without losses on a body without losses, joined by a rigid constraint."""
    string_class = tw.list_plugins()["stiff_string"]
    values = {"length": 0.65, "tension": 71.6, "linear_density": 6.24e-3, "bending_stiffness": 57e-6}
    string = string_class.from_values({**values, "loss": {"law": "sigma", "sigma0": 0.0}})
    assert isinstance(string, ta.Resonator)
    body = ta.ModalBasis.real(
        2 * np.pi * np.array([102.0, 204.0, 415.0]), np.zeros(3), {"bridge": np.array([1.6, 3.0, 2.2])},
        residual=np.array([[2e-8]]),
    )  # fmt: skip
    string_basis = string.basis(20000.0).with_places({"pluck": 0.105})
    system = System.build(
        {"string": string_basis, "body": body},
        [Connection("joint", (Term("string", "bridge"), Term("body", "bridge", -1.0)), Rigid())],
        [Readout("bridge", "velocity", (Term("body", "bridge"),))],
        dt=1 / FS,
    )
    stepper = KernelStepper(system)
    state = stepper.start()
    held = compile_force("string", string_basis, "pluck", [Segment(0.0, 0.02, 0.0, 50.0)], system.dt)
    stepper.run(state, 1000, held)  # drawn with 1 N and let go
    modes = system.modes_of(state, "string")
    account = EnergyAccount(system, state)
    first = sum(account.stored(state).values())
    worst = 0.0
    for _ in range(10):
        stepper.run(state, steps // 10)
        worst = max(worst, abs(sum(account.stored(state).values()) / first - 1))
    yield f"energy drift over {steps:.0e} undamped steps", f"{worst:.1e}", f"{len(modes[0])} + 3 modes, one constraint"


def long_score(seconds: float) -> tw.Score:
    """Two voices, two notes a second each, over the range of the guitar."""
    rng = np.random.default_rng(7)
    notes = []
    for i in range(int(2 * seconds)):
        notes.append(tw.Note(0.5 * i, 0.45, note=int(rng.integers(40, 52)), velocity_midi=80))
        notes.append(tw.Note(0.5 * i + 0.25, 0.45, note=int(rng.integers(59, 76)), velocity_midi=80))
    return tw.Score(notes)


def _child(score: Path, folder: str, *more: str) -> tuple[float, float, float]:
    """Wall and processor time (s) and peak memory (MB) of a render in a process of its own."""
    program = (
        "import resource, sys\nfrom tonewood.cli.main import run\n"
        "try:\n    run(sys.argv[1:])\nexcept SystemExit as end:\n    assert not end.code\n"
        "used = resource.getrusage(resource.RUSAGE_SELF)\n"
        "print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)"
    )
    command = [sys.executable, "-c", program, "render", str(score), "-i", "classical_guitar"]
    compiled_once = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    began = time.perf_counter()
    command += ["-o", f"{folder}/out.wav", *more]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=compiled_once)
    processor, memory = map(float, done.stdout.splitlines()[-1].split())
    return time.perf_counter() - began, processor, memory


def cold_start(repeats: int) -> Iterator[Row]:
    """``tonewood render`` of one second, from the command to the file."""
    with tempfile.TemporaryDirectory() as folder:
        score = Path(folder) / "one.mid"
        tw.write_midi(tw.Score([tw.Note(0.0, 0.5, note=64, velocity_midi=80)]), score)
        _child(score, folder)
        runs = [_child(score, folder, "--max-duration", "1") for _ in range(repeats)]
        wall, processor = (statistics.median(r[i] for r in runs) for i in (0, 1))
        spread = f"{processor:.2f} s of the processor; {min(r[0] for r in runs):.2f} s at best in {repeats} runs"
        yield "cold start: `tonewood render` of one second", f"{wall:.2f} s", spread


def short_sounds(repeats: int) -> Iterator[Row]:
    """Stimuli of a listening test: notes of two seconds, one by one, most of them ringing."""
    guitar = tw.load_instrument("classical_guitar")
    score = tw.Score([tw.Note(0.0, 1.5, string="G3", stop=0, velocity_midi=80)])
    many = 10

    def per_second() -> float:
        began = time.process_time()
        for _ in range(many):
            tw.render(score, guitar, FS, max_duration=2.0)
        return many / (time.process_time() - began)

    value, spread = repeated(per_second, repeats)
    yield "sounds of 2 s, `tw.render` with a loaded instrument", f"{value:.1f} a second", spread
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "one.mid"
        tw.write_midi(tw.Score([tw.Note(0.0, 1.5, note=64, velocity_midi=80)]), path)
        _child(path, folder)
        value, spread = repeated(lambda: 1 / _child(path, folder, "--max-duration", "2")[1], repeats)
        yield "  one command `tonewood render` each", f"{value:.2f} a second", spread


def memory(minutes: float) -> Iterator[Row]:
    """Peak memory does not follow the length of the piece."""
    with tempfile.TemporaryDirectory() as folder:
        peaks = {}
        for seconds in (20.0, 60.0 * minutes):
            score = Path(folder) / f"{seconds:.0f}.mid"
            tw.write_midi(long_score(seconds), score)
            _, processor, peaks[seconds] = _child(score, folder)
            factor = seconds / processor
            yield (
                f"peak memory of a {seconds:.0f} s score",
                f"{peaks[seconds]:.0f} MB",
                f"{factor:.1f} x real time, load included",
            )
        short, long = peaks.values()
        yield "  difference", f"{long - short:+.0f} MB", ""


def pieces(repeats: int) -> Iterator[Row]:
    """Whole pieces: cost of notes beside the ringing."""
    guitar = tw.load_instrument("classical_guitar")
    for name in ("greensleeves", "romance"):
        score = tw.read_midi(ROOT / "examples" / "scores" / f"{name}.mid")
        stepping: list[float] = []

        def factor(score: tw.Score = score, stepping: list[float] = stepping) -> float:
            renderer = tw.Renderer(score, guitar, FS)
            stepper, spent = renderer.engine.stepper, 0.0
            run = stepper._step  # runs of any kind

            def timed(*arguments: object) -> object:
                nonlocal spent
                before = time.process_time()
                result = run(*arguments)  # type: ignore[arg-type]  # passed on
                spent += time.process_time() - before
                return result

            stepper._step = timed  # type: ignore[assignment,method-assign]  # to be timed
            began = time.process_time()
            for _ in renderer.blocks(4096):
                pass
            whole = time.process_time() - began
            stepping.append(spent / whole)
            return renderer.summary().duration_s / whole

        value, spread = repeated(factor, repeats)
        share = 100 * statistics.median(stepping)
        yield (
            f"{name}.mid, {len(score.notes)} notes, {score.duration:.0f} s",
            f"{value:.1f} x real time",
            (f"{share:.0f} % of it stepping; {spread}"),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="shorter scores, fewer repeats")
    quick = parser.parse_args().quick
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    if not one_thread.items() <= os.environ.items():  # read when NumPy is imported
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **one_thread})
    repeats = 3 if quick else 7
    print(machine())
    print(f"\n| {'part':<66} | {'measured':<31} | {'how':<50} |")
    print(f"| {'-' * 66} | {'-' * 31} | {'-' * 50} |")
    rows: list[Callable[[], Iterator[Row]]] = [
        lambda: all_ringing(repeats),
        lambda: kernel_cost(repeats),
        lambda: where_it_goes(repeats),
        lambda: kernel_against_twin(3),
        lambda: undamped_energy(1_000_000),
        lambda: cold_start(repeats),
        lambda: short_sounds(repeats),
        lambda: pieces(1 if quick else 3),
        lambda: memory(2.0 if quick else 20.0),
    ]
    for measure in rows:
        for what, value, how in measure():
            print(f"| {what:<66} | {value:<31} | {how:<50} |", flush=True)


if __name__ == "__main__":
    main()
