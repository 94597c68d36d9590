"""Other people's programs on stated scenes, beside this project, in one run.

    python benchmarks/peers/run.py [--seconds 10] [--rounds 5] [--python PATH] [--sav FOLDER]
        [--ness COMMAND] [--siconos COMMAND]

Whatever is installed is timed: Csound, Faust with a C++ compiler, FluidSynth with a sound font, and STK with its
headers (Debian: csound faust fluidsynth fluid-soundfont-gm libstk-dev); jaxdiffmodal and genny with the interpreter
`--python` (pip install genny jax einops jaxtyping opt_einsum tabulate; pip install --no-deps jaxdiffmodal); IRCAM's SAV
strings from `--sav`, the folder ``src/processor`` of Ircam-RnD/SAV-string-simulations, which needs Eigen (Debian:
libeigen3-dev, or its headers in `--eigen`). A COMMAND makes ``{seconds}`` seconds of sound: NESS and Siconos have no
common form, so you state which scene it plays.

Processor time per second of sound at 48 kHz, median of interleaved rounds, lowest and highest in brackets. Start-up and
compilation are left out: programs that do not tell their own time are run for two lengths, and the difference counts.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tonewood as tw
from tonewood.lab.accuracy.timing import machine
from tonewood.lab.tables import markdown, number
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.coupling.potentials.base import Potential
from tonewood.physics.coupling.potentials.longitudinal import GeometricStretch
from tonewood.physics.coupling.potentials.phantom import DrivenLongitudinal
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Injection, Readout, System
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.string_modes import string_basis
from tonewood.physics.stepping.forcing import Segment, compile_force
from tonewood.physics.stepping.kernel import KernelStepper

HERE, FS, N_MODES = Path(__file__).parent, 48000, 64
NUMBERS = np.arange(1, N_MODES + 1)
#: Hz, 1/s and gains of the modes that nothing couples
MODES = {
    "freq": (110 * NUMBERS * np.sqrt(1 + 1e-4 * NUMBERS**2)).tolist(),
    "decay": (0.4 + 0.01 * NUMBERS).tolist(),
    "gain": (1 / NUMBERS).tolist(),
}
CHORD = (40, 45, 50, 55, 59, 64)
#: strings between fixed ends, of one steel wire: Hz; m, N, kg/m, N m^2; pushed by N for s
STRINGS = (82.41, 110.0, 146.83, 196.0, 246.94, 329.63)
LENGTH, AXIAL, DENSITY, BENDING, FORCE, PULSE = 0.65, 52841.59, 2.1136636e-3, 1.1109944e-3, 1.0, 1.5e-3
#: points of IRCAM's strings at 48 kHz: as many modes
POINTS = (101, 98, 92, 84, 74, 61)
QUARTER = tuple(n // 4 for n in POINTS)
#: scene -> in words
SCENES = {
    "modes": f"{N_MODES} modes that nothing couples, under one impulse",
    "tension": f"one string of {N_MODES} modes whose tension rises",
    "strings": "six strings between fixed ends whose tension rises, in one plane, pushed by 1 N",
    "chord": "the six open strings of a guitar, struck together",
}
#: installed as none of these, FluidSynth is left out
FONTS = ("FluidR3_GM.sf2", "default-GM.sf2")
#: tried for Faust, of which the quickest counts; the last one is also STK's
COMPILERS = ("clang++-16", "clang++", "g++")

#: makes so many seconds of sound; returns s of processor time
Run = Callable[[float], float]


@dataclass(frozen=True)
class Peer:
    """A program in a scene: `alike` and `unlike` say what it has in common with this project there."""

    scene: str
    name: str
    alike: str
    unlike: str
    run: Run


def child(command: Sequence[str], given: str = "") -> float:
    """Processor time of a program, its own start included, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, input=given, text=True, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def printed(command: Sequence[str], given: str = "") -> float:
    """Processor time that a program prints as its first word, s; the second is the rms of a sound that must be one."""
    out = subprocess.run(command, input=given, text=True, check=True, capture_output=True).stdout.split()
    if not 0 < float(out[1]) < np.inf:
        raise SystemExit(f"{command[0]} made no sound")
    return float(out[0])


def by_difference(command: Callable[[float], Sequence[str]]) -> Run:
    """Time of a program without its start: that of one second more than was asked for, less that of one second."""
    return lambda seconds: child(command(seconds + 1)) - child(command(1))


# ---- this project ----


def stepped(system: System, component: str, modes: np.ndarray) -> Run:
    """A system from a state of its modes, stepped by the kernel."""

    def run(seconds: float) -> float:
        stepper, state = KernelStepper(system), system.start()
        system.modes_of(state, component)[0] = modes
        began = time.thread_time()
        stepper.run(state, round(FS * seconds))
        return time.thread_time() - began

    return run


def own_modes() -> Run:
    basis = ModalBasis.real(
        2 * np.pi * np.array(MODES["freq"]), np.array(MODES["decay"]), {"out": np.array(MODES["gain"])}
    )
    out = [Readout("out", "displacement", (Term("modes", "out"),))]
    return stepped(System.build({"modes": basis}, [], out, dt=1 / FS), "modes", np.array(MODES["gain"]))


def own_tension() -> Run:
    """Let go from the shape that 2 N at 0.13 m give, its bridge end held."""
    made = string_basis(0.65, 72.0, 3.1e-3, 1.5e-4, lambda w, k: 1.0 / w, n_modes=N_MODES)
    made = made.with_places({"out": 0.1, "pluck": 0.13})
    out = [Readout("out", "displacement", (Term("string", "out"),))]
    end = Connection("end", (Term("string", "bridge"),), Rigid())
    tension = TensionModulation("string", ("string",), 3e4)
    system = System.build({"string": made}, [end], out, dt=1 / FS, potentials=[tension])
    pluck, bridge = (made.right[made.index(point)].real / made.stiffness for point in ("pluck", "bridge"))
    held = made.right[made.index("bridge")].real
    return stepped(system, "string", 2.0 * (pluck - bridge * (held @ pluck) / (held @ bridge)))


def tension_of(freq: float) -> float:
    """Tension of one of `STRINGS`, N: f = sqrt(T / mu) / (2 L) sqrt(1 + beta), beta = pi^2 EI / (T L^2)."""
    return DENSITY * (2 * LENGTH * freq) ** 2 - np.pi**2 * BENDING / LENGTH**2


def strings(rate: float, modes: Sequence[int], kind: str = "tension", longitudinal: int = 5) -> System:
    """`STRINGS` of so many modes each, in one plane, damped at 0.5 / s.

    Parameters
    ----------
    kind : "tension" rises, "longitudinal" modes move both ways, "phantom" drives them one way.
    """
    components: dict[str, ModalBasis] = {}
    ends, outs, potentials = [], [], list[Potential]()
    if kind == "phantom":  # a body that the force along the strings moves
        components["body"] = ModalBasis.real(np.array([2 * np.pi * 200]), np.array([10.0]), {"bridge": np.ones(1)})
    for number_, (freq, n) in enumerate(zip(STRINGS, modes, strict=False)):
        name = f"string {number_}"
        made = string_basis(LENGTH, tension_of(freq), DENSITY, BENDING, lambda w, k: 1.0 / w, n_modes=n)
        components[name] = made.with_places({"pluck": 0.2 * LENGTH, "out": 0.9 * LENGTH})
        ends.append(Connection(f"end {number_}", (Term(name, "bridge"),), Rigid()))
        outs.append(Readout(name, "displacement", (Term(name, "out"),)))
        if kind == "tension":
            potentials.append(TensionModulation(name, (name,), AXIAL))
        elif kind == "longitudinal":
            stretch = f"stretch {number_}"
            components[stretch] = string_basis(
                LENGTH, AXIAL, DENSITY, 0.0, lambda w, k: np.full_like(w, 0.01), n_modes=longitudinal
            )
            ends.append(Connection(f"end {stretch}", (Term(stretch, "bridge"),), Rigid()))
            potentials.append(GeometricStretch(name, (name,), stretch, AXIAL))
        else:
            potentials.append(DrivenLongitudinal(name, (name,), (("body", "bridge", 0.1),), AXIAL, 3000.0, 0.01))
    return System.build(components, ends, outs, dt=1 / rate, potentials=potentials)


def pluck_forces(system: System, force: float = FORCE) -> list[Injection]:
    """The same parabola of force on each of the strings."""
    pieces = [Segment(0.0, PULSE, 0.0, 4 * force / PULSE, -4 * force / PULSE**2)]
    bases = {name: system.compiled[system.slot(name)].basis for name in system.names if name.startswith("string")}
    return [f for name, b in bases.items() for f in compile_force(name, b, "pluck", pieces, system.dt)]


def own_strings(rate: float, modes: Sequence[int], kind: str = "tension", longitudinal: int = 5) -> Run:
    system = strings(rate, modes, kind, longitudinal)

    def run(seconds: float) -> float:
        stepper, state, forces = KernelStepper(system), system.start(), pluck_forces(system)
        began = time.thread_time()
        stepper.run(state, round(rate * PULSE) + 1, forces)
        stepper.run(state, round(rate * seconds))
        return time.thread_time() - began

    return run


def own_chord(seconds: float) -> float:
    score = tw.Score([tw.Note(0.0, 3600.0, note=n) for n in CHORD])
    renderer = tw.Renderer(score, tw.load_instrument("classical_guitar"), FS, max_duration=seconds)
    began = time.thread_time()
    for _ in renderer.blocks(4096):
        pass
    return time.thread_time() - began


def own() -> list[Peer]:
    return [
        Peer("modes", "tonewood", "", "", own_modes()),
        Peer("tension", "tonewood", "", "", own_tension()),
        Peer("strings", "tonewood", "", "", own_strings(FS, POINTS)),
        Peer("strings", "tonewood, a quarter of the modes", "", "error still half of IRCAM's",
             own_strings(FS, QUARTER)),
        Peer("strings", "tonewood, the same at 24 kHz", "", "error still half of IRCAM's",
             own_strings(FS / 2, QUARTER)),
        Peer("strings", "tonewood, with longitudinal motion", "", "", own_strings(FS, POINTS, "longitudinal")),
        Peer("strings", "the same, a quarter of the modes", "", "", own_strings(FS, QUARTER, "longitudinal")),
        Peer("strings", "the same, at 24 kHz", "", "", own_strings(FS / 2, QUARTER, "longitudinal", 3)),
        Peer("strings", "tonewood, phantom partials", "", "one way", own_strings(FS, POINTS, "phantom")),
        Peer("chord", "tonewood", "1542 coupled modes: two planes, body, two microphones", "", own_chord),
    ]  # fmt: skip


# ---- others ----


def csound(folder: Path) -> list[Peer]:
    if shutil.which("csound") is None:
        return []
    lines = [f"a{n} mode aforce, {f:.6f}, {np.pi * f / d:.3f}" for n, (f, d) in _modes()]
    total = " + ".join(f"{g:.6f} * a{n}" for n, g in zip(NUMBERS, MODES["gain"], strict=True))
    # mode is a filter of second order without limit on the rate of control signals: vectors of 64 samples
    text = "\n".join(["sr = 48000", "ksmps = 64", "nchnls = 1", "instr 1", "aforce mpulse 1, 0", *lines])
    orchestra = f"<CsInstruments>\n{text}\nout 1e-3 * ({total})\nendin\n</CsInstruments>"

    def command(seconds: float) -> list[str]:
        path = folder / f"modes_{seconds:g}.csd"
        score = f"<CsScore>\ni 1 0 {seconds:g}\n</CsScore>"
        path.write_text(f"<CsoundSynthesizer>\n{orchestra}\n{score}\n</CsoundSynthesizer>\n", encoding="utf-8")
        return ["csound", "-n", "-m0", "-d", str(path)]

    return [Peer("modes", "Csound, opcode mode", "modes, 64-bit samples", "one filter each", by_difference(command))]


def faust(folder: Path) -> list[Peer]:
    """Scalar code: vectors of Faust's own made it slower with every compiler tried."""
    compilers = [c for name in COMPILERS if (c := shutil.which(name)) is not None]
    if shutil.which("faust") is None or not compilers:
        return []
    filters = []
    for (_, (f, d)), g in zip(_modes(), MODES["gain"], strict=True):
        r = np.exp(-d / FS)
        filters.append(f"fi.tf2({g:.9f}, 0, 0, {-2 * r * np.cos(2 * np.pi * f / FS):.15f}, {r * r:.15f})")
    (folder / "modes.dsp").write_text(
        f'import("stdfaust.lib");\nprocess = _ <: {",".join(filters)} :> _;\n', encoding="utf-8"
    )
    subprocess.run(["faust", "-double", "-o", "modes.hpp", "modes.dsp"], cwd=folder, check=True)
    flags = ["-O3", "-ffast-math", "-march=native", "-DFAUSTFLOAT=double", f"-I{folder}"]
    programs = [str(folder / f"faust_modes_{i}") for i in range(len(compilers))]
    for compiler, program in zip(compilers, programs, strict=True):
        subprocess.run([compiler, *flags, str(HERE / "faust_main.cpp"), "-o", program], check=True)
    return [
        Peer("modes", "Faust, tf2 filters", "modes, 64-bit samples, this machine's instructions",
             "compiled for these modes; -ffast-math; the quickest of the compilers here",
             lambda seconds: min(printed([program, f"{seconds:g}"]) for program in programs))
    ]  # fmt: skip


def stk(folder: Path) -> list[Peer]:
    compiler = next((c for name in reversed(COMPILERS) if (c := shutil.which(name)) is not None), None)
    if compiler is None or not Path("/usr/include/stk/StifKarp.h").exists():
        return []
    program = folder / "stk_chord"
    subprocess.run([compiler, "-O3", str(HERE / "stk_chord.cpp"), "-o", str(program), "-lstk"], check=True)
    return [
        Peer("chord", "STK, StifKarp", "six stiff strings", "delay lines with filters; one plane, no body or coupling",
             lambda seconds: printed([str(program), f"{seconds:g}"]))
    ]  # fmt: skip


def sav_command(folder: Path, sources: str | None, eigen: str) -> list[str]:
    """Program of IRCAM's strings, and its arguments after seconds, kind and force; empty where it cannot be made."""
    compiler = next((c for name in reversed(COMPILERS) if (c := shutil.which(name)) is not None), None)
    if compiler is None or sources is None:
        return []
    program = folder / "sav_strings"
    flags = ["-std=c++17", "-O3", "-march=native", "-ffast-math", f"-I{eigen}", f"-I{sources}"]
    files = [str(HERE / "sav_strings.cpp"), str(Path(sources) / "StringProcessor.cpp")]
    subprocess.run([compiler, *flags, *files, "-o", str(program)], check=True)
    return [
        str(program),
        *(f"{x:.12g}" for f in STRINGS for x in (f, np.pi**2 * BENDING / (tension_of(f) * LENGTH**2))),
    ]


def sav(folder: Path, sources: str | None, eigen: str) -> list[Peer]:
    command = sav_command(folder, sources, eigen)
    if not command:
        return []

    def run(mode: int) -> Run:
        return lambda seconds: printed([command[0], f"{seconds:g}", str(mode), f"{FORCE:g}", *command[1:]])

    same = "strings of Kirchhoff and Carrier, loss, push; 64-bit samples"
    return [
        Peer("strings", "IRCAM's SAV strings", same, "finite differences, 510 points; -ffast-math", run(1)),
        Peer("strings", "IRCAM's, geometrically exact", "", "to fourth order, without longitudinal modes", run(2)),
    ]


def fluidsynth(folder: Path) -> list[Peer]:
    found = [p for name in FONTS if (p := Path("/usr/share/sounds/sf2") / name).exists()]
    if shutil.which("fluidsynth") is None or not found:
        return []

    def command(seconds: float) -> list[str]:
        path = folder / f"chord_{seconds:g}.mid"
        tw.write_midi(tw.Score([tw.Note(0.0, seconds, note=n, velocity_midi=90) for n in CHORD]), path)
        sound = str(folder / "fluidsynth.wav")
        return ["fluidsynth", "-ni", "-q", "-r", str(FS), "-F", sound, str(found[0]), str(path)]

    return [
        Peer("chord", "FluidSynth", "the same notes, two channels", "plays recordings; reverb and chorus",
             by_difference(command))
    ]  # fmt: skip


def python_peers(interpreter: str | None) -> list[Peer]:
    if interpreter is None:
        return []
    given = json.dumps(MODES)

    def run(name: str) -> Run:
        script = str(HERE / "python_peers.py")
        return lambda seconds: printed([interpreter, script, name, f"{seconds:g}"], given)

    jax = "Stoermer-Verlet; returns every mode at every sample"
    peers = [
        ("genny", Peer("modes", "genny", "modes, 64-bit samples", "at its own rate", run("genny"))),
        ("jaxdiffmodal", Peer("modes", "jaxdiffmodal, JAX on the processor", "modes, 64-bit samples", jax,
                              run("jaxdiffmodal"))),
        ("jaxdiffmodal", Peer("tension", "jaxdiffmodal, JAX on the processor", "modes, one common tension", jax,
                              run("jaxdiffmodal-tension"))),
    ]  # fmt: skip
    has = {
        name: subprocess.run([interpreter, "-c", f"import {name}"], capture_output=True, check=False).returncode == 0
        for name in {name for name, _ in peers}
    }
    return [peer for name, peer in peers if has[name]]


def given_commands(commands: dict[str, str | None]) -> list[Peer]:
    def made(text: str) -> Run:
        return by_difference(lambda seconds: shlex.split(text.format(seconds=f"{seconds:g}")))

    return [Peer("yours", name, "", text, made(text)) for name, text in commands.items() if text is not None]


def _modes() -> list[tuple[int, tuple[float, float]]]:
    return list(zip(NUMBERS.tolist(), zip(MODES["freq"], MODES["decay"], strict=True), strict=True))


def table(peers: Sequence[Peer], spent: dict[int, list[float]]) -> str:
    """A row per program: s per s, and the ratio to this project's in the same scene."""
    mine = {p.scene: statistics.median(spent[id(p)]) for p in peers if p.name == "tonewood"}
    rows = []
    for scene in dict.fromkeys(p.scene for p in peers):
        for p in (p for p in peers if p.scene == scene):
            times = spent[id(p)]
            middle = statistics.median(times)
            ratio = number(middle / mine[scene], 3) if scene in mine else ""
            shown = f"{number(middle, 3)} ({number(min(times), 3)}-{number(max(times), 3)})"
            rows.append([scene, p.name, shown, ratio, p.alike, p.unlike])
    return markdown(["scene", "program", "s per s", "times tonewood", "alike", "not alike"], rows, left=2)


def main() -> None:
    """Time all that is installed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of sound per run")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--python", help="interpreter that has jaxdiffmodal or genny")
    parser.add_argument("--sav", metavar="FOLDER", help="src/processor of Ircam-RnD/SAV-string-simulations")
    parser.add_argument("--eigen", metavar="FOLDER", default="/usr/include/eigen3", help="headers of Eigen")
    parser.add_argument("--ness", metavar="COMMAND", help="with {seconds} in it")
    parser.add_argument("--siconos", metavar="COMMAND", help="with {seconds} in it")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peers = [
            *own(), *csound(folder), *faust(folder), *stk(folder), *fluidsynth(folder),
            *sav(folder, options.sav, options.eigen),
            *python_peers(options.python), *given_commands({"NESS": options.ness, "Siconos": options.siconos}),
        ]  # fmt: skip
        spent: dict[int, list[float]] = {id(p): [] for p in peers}
        for _ in range(options.rounds):
            for peer in peers:
                spent[id(peer)].append(peer.run(options.seconds) / options.seconds)
                print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    info = machine()
    print(f"{info['processor']}, {info['instruction_set']}; {options.rounds} rounds of {options.seconds:g} s.\n")
    for scene, words in SCENES.items():
        print(f"- {scene}: {words}")
    print(f"\n{table(peers, spent)}")


if __name__ == "__main__":
    main()
