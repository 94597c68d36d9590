"""Every method and every dial on one linear system: errors, times, stability."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import NumericalError
from tonewood.lab.accuracy.cases import (
    FREQ_UPPER,
    Case,
    GuitarCase,
    continuous_poles,
    real_modes_of,
    undamped,
)
from tonewood.lab.accuracy.measures import energy_drift, pole_errors, wave_errors
from tonewood.lab.accuracy.reference import ExactMotion, FineMotion, Motion
from tonewood.lab.accuracy.timing import Task, Timing, measure
from tonewood.lab.methods.problem import Problem
from tonewood.lab.methods.scheme import Runner
from tonewood.lab.methods.schemes import build
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.stepping.kernel import KernelStepper

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
#: takes the share of a study that is done
Tell = Callable[[float], None]

#: s of free motion that waveforms are compared over
DURATION = 1.0
#: instants in it at which the stored energy is looked at
CHECKS = 10
#: share of the sampling rate above which this project steps no mode
FREQ_LIMIT = 0.45
#: energy may grow by this before a method counts as growing
GROWTH = 1e-6


def silent(share: float) -> None:
    """Report nothing."""


@dataclass(frozen=True, slots=True)
class Point:
    """One method with one value of its dial on one system.

    Attributes
    ----------
    system, method : names; methods are those of `LABELS`.
    dial, value : parameter varied along the line, and its value here.
    fs : Hz.  n_modes : stepped.
    stable : stable, grows or NaN.
    cents_median, cents_worst, cents_20, decay_median, decay_worst, lost : see `measures.PoleErrors`.
    waveform, spectral_db, spurious_db : see `measures.WaveErrors`.
    energy : drift of the undamped system's energy within 1 s, relative.
    seconds, seconds_low, seconds_high : of computing per second of sound: median, 10th and 90th percentile.
    note : further remarks.
    """

    system: str
    method: str
    dial: str
    value: str
    fs: float
    n_modes: int
    stable: str
    cents_median: float = np.nan
    cents_worst: float = np.nan
    cents_20: float = np.nan
    decay_median: float = np.nan
    decay_worst: float = np.nan
    lost: int = 0
    waveform: float = np.nan
    spectral_db: float = np.nan
    spurious_db: float = np.nan
    energy: float = np.nan
    seconds: float = np.nan
    seconds_low: float = np.nan
    seconds_high: float = np.nan
    note: str = ""

    def to_dict(self) -> dict[str, object]:
        """Fields for JSON; unknown ones are None."""
        return {key: None if isinstance(v, float) and not np.isfinite(v) else v for key, v in asdict(self).items()}


#: name -> as it is called in tables and legends
LABELS = {
    "tonewood": "tonewood",
    "held_position": "tonewood's scheme, a sweep per sample",
    "held_velocity": "held force, velocity constraint",
    "p0": "P0, acceleration constraint",
    "p1": "P1, acceleration constraint",
    "p2": "P2, acceleration constraint",
    "trapezoidal": "trapezoidal, acceleration constraint",
    "simpson": "Simpson, acceleration constraint",
    "linear_position": "P1 constraint force, position constraint",
    "ab3": "Adams-Bashforth 3, Udwadia-Kalaba",
    "ab3_paper": "Adams-Bashforth 3 with 150 string modes, as published",
    "verlet": "velocity Verlet, Udwadia-Kalaba",
    "newmark": "Newmark, average acceleration",
    "hht": "HHT-alpha (-0.3)",
    "superposition": "superposition of coupled modes",
}
#: methods that take real modes only
SECOND_ORDER = ("verlet", "newmark", "hht")


class Subject:
    """A case as some methods see it: its modes, its true values, and the state in which the motion starts.

    Parameters
    ----------
    case : which.
    real : in real modes, damping proportional; else as it is.
    """

    def __init__(self, case: Case, *, real: bool = False):
        self.case, self.real = case, real
        self._flats: dict[float, Problem] = {}
        self._displacements: dict[tuple[float, int], Floats] = {}

    def problem(self, freq_upper: float) -> Problem:
        """With string modes up to a frequency."""
        problem = self.case.build(freq_upper)
        return real_modes_of(problem) if self.real else problem

    def flat(self, freq_upper: float = FREQ_UPPER) -> Problem:
        """Return the problem as flat arrays, made once for each limit (Hz)."""
        if freq_upper not in self._flats:
            self._flats[freq_upper] = self.problem(freq_upper)
        return self._flats[freq_upper]

    @cached_property
    def joints(self) -> Sequence[int] | None:
        """Connection of each partial, where there are many."""
        return self.case.joints() if isinstance(self.case, GuitarCase) else None

    @property
    def numbers(self) -> NDArray[np.intp]:
        """Number of each partial on its string."""
        if self.joints is None:
            return np.arange(1, len(self.poles) + 1)
        seen: dict[int, int] = {}
        out = []
        for joint in self.joints:
            seen[joint] = seen.get(joint, 0) + 1
            out.append(seen[joint])
        return np.array(out)

    @cached_property
    def poles(self) -> Complexes:
        """True poles: the case's own, or where damping is another, those of twice the modes."""
        if not self.real or self.case.damped_as == "real modes":
            return self.case.poles
        return continuous_poles(self.problem(2.5 * FREQ_UPPER), self.case.poles, self.joints)

    def start(self, flat: Problem) -> Floats:
        """State at rest under unit forces, to be let go."""
        return flat.static(np.ones(len(flat.inputs)))

    @cached_property
    def motion(self) -> Motion:
        """Partials below 20 kHz of the system with twice the modes; where there are too many, the same modes."""
        if self.flat().n_modes > 400:
            return FineMotion(self.flat(), self.start(self.flat()), DURATION)
        fine = self.flat(2 * FREQ_UPPER)
        return ExactMotion.of(fine, self.start(fine), FREQ_UPPER)

    def displacement(self, fs: float, n: int) -> Floats:
        """Return the true motion, see `reference.Motion`; made once for each rate."""
        if (fs, n) not in self._displacements:
            self._displacements[fs, n] = self.motion.displacement(fs, n)
        return self._displacements[fs, n]

    @cached_property
    def sounding(self) -> Complexes:
        """Poles of everything that sounds."""
        if isinstance(self.motion, ExactMotion):
            return self.motion.poles
        bodies = [b.poles for b in self.flat().components.values()]
        return np.concatenate([self.poles, *bodies])

    @cached_property
    def free_of_loss(self) -> Problem:
        """The undamped twin, in real modes."""
        problem = self.problem(FREQ_UPPER)
        return undamped(problem if self.real else real_modes_of(problem))


@dataclass(frozen=True, eq=False)
class Attempt:
    """A point without its time, and the run to be timed."""

    point: Point
    task: Task | None


@dataclass(eq=False)
class KernelRun:
    """The project's own stepper behind the interface of `schemes.Runner`."""

    flat: Problem
    fs: float

    def __post_init__(self) -> None:
        self.system: System = self.flat.system(1 / self.fs)
        self.stepper = KernelStepper(self.system)
        self.state = self.stepper.start()

    def start(self, x: Floats) -> None:
        """Put a state (n, 2) in."""
        self.state = self.stepper.start()
        self.state.modes[:] = self.flat.state_of(x, self.system)

    def run(self, n: int, every: int = 1) -> tuple[Floats, int]:
        """As `schemes.Runner.run`; the sample after the last is not there."""
        try:
            return self.stepper.run(self.state, n)[0][::every], -1
        except NumericalError:
            return np.full((n // every, len(self.system.readouts)), np.nan), n

    @property
    def x(self) -> Floats:
        """(n, 2)."""
        return self.flat.x_of(self.state.modes, self.system)


Run = Runner | KernelRun


def _follow(run: Run, flat: Problem, start: Floats, fs: float) -> tuple[Floats, Floats, bool]:
    """Displacement at about 48 kHz for `DURATION`, energies at `CHECKS` instants, and whether all is finite."""
    every = max(1, round(fs / 48000))
    part = round(fs * DURATION / CHECKS / every) * every
    part += part % 2 * every
    run.start(start)
    out, energies = [], [flat.energy(start)]
    with np.errstate(all="ignore"):
        for _ in range(CHECKS):
            y, bad = run.run(part, every)
            out.append(y[: part // every])
            energies.append(flat.energy(run.x))
            if bad >= 0 or not np.isfinite(energies[-1]):
                return np.concatenate(out), np.array(energies), False
    return np.concatenate(out), np.array(energies), True


def attempt(
    subject: Subject, method: str, fs: float, make: Callable[[Problem], Run], flat: Problem, point: Point,
    poles: Callable[[], Complexes] | None = None,
) -> Attempt:  # fmt: skip
    """Run one method on its subject and on the undamped twin."""
    run = make(flat)
    start = subject.start(flat)
    y, energies, finite = _follow(run, flat, start, fs)
    if not finite:
        return Attempt(replace(point, stable="NaN"), None)
    stable = "grows" if energies.max() > (1 + GROWTH) * energies[0] else "stable"
    point = replace(point, stable=stable)
    every = max(1, round(fs / 48000))
    true = subject.displacement(fs / every, len(y))
    errors = wave_errors(y[: len(true), 0], true[:, 0], fs / every, subject.sounding)
    point = replace(point, waveform=errors.waveform, spectral_db=errors.spectral_db, spurious_db=errors.spurious_db)
    if poles is not None:
        p = pole_errors(poles(), subject.poles, subject.numbers)
        point = replace(point, **asdict(p))
    steps = max(2, round(fs * min(0.2, 4e6 / (fs * flat.n_modes)) / 2) * 2)
    return Attempt(point, Task(lambda: run.run(steps, steps), steps / fs) if stable == "stable" else None)


def drift(subject: Subject, make: Callable[[Problem], Run], fs: float) -> float:
    """Energy drift of the undamped twin."""
    flat = subject.free_of_loss
    _, energies, finite = _follow(make(flat), flat, subject.start(flat), fs)
    return energy_drift(energies) if finite else np.nan


def scheme_point(subject: Subject, method: str, fs: float, *, label: str | None = None, freq_upper: float = FREQ_UPPER,
                 note: str = "") -> Attempt:  # fmt: skip
    """A method of the compiled loop."""
    flat = subject.flat(freq_upper)

    def make(given: Problem) -> Runner:
        return Runner(build(method, given, 1 / fs))

    point = Point(subject.case.name, label or method, "fs", f"{fs / 1e3:.4g} kHz", fs, flat.n_modes, "", note=note)
    got = attempt(
        subject, method, fs, make, flat, point, lambda: build(method, flat, 1 / fs).poles(subject.poles, subject.joints)
    )
    if got.task is None or freq_upper != FREQ_UPPER:
        return got
    return replace(got, point=replace(got.point, energy=drift(subject, make, fs)))


def own_point(
    subject: Subject, fs: float, *, flat: Problem | None = None, dial: str = "fs",
    value: str | None = None, note: str = "",
) -> Attempt:  # fmt: skip
    """The stepper of this project; modes up to 0.45 fs unless a basis is given."""
    given = flat or subject.flat(min(FREQ_UPPER, FREQ_LIMIT * fs))

    def make(some: Problem) -> KernelRun:
        return KernelRun(some, fs)

    point = Point(subject.case.name, "tonewood", dial, value or f"{fs / 1e3:.4g} kHz", fs, given.n_modes, "", note=note)
    got = attempt(
        subject, "tonewood", fs, make, given, point,
        lambda: build("held_position", given, 1 / fs).poles(subject.poles, subject.joints),
    )  # fmt: skip
    if flat is not None or given is not subject.flat():
        return got
    return replace(got, point=replace(got.point, energy=drift(subject, make, fs)))


def superposition_point(subject: Subject, fs: float = 48000.0) -> Attempt:
    """The coupled modes themselves, by the same stepper: exact at any rate, as long as nothing changes."""
    same = ExactMotion.of(subject.flat(), subject.start(subject.flat()))
    basis = same.basis()
    system = System.build({"modes": basis}, (), [Readout("0", "displacement", (Term("modes", "out0"),))], dt=1 / fs)
    stepper = KernelStepper(system)
    state = stepper.start()
    system.modes_of(state, "modes")[0] = 1.0
    y = stepper.run(state, round(fs * DURATION))[0]
    errors = wave_errors(y[:, 0], subject.displacement(fs, len(y))[:, 0], fs, subject.sounding)
    nearest = np.array([same.poles[np.argmin(np.abs(same.poles - p))] for p in subject.poles])
    point = Point(
        subject.case.name, "superposition", "fs", f"{fs / 1e3:.4g} kHz", fs, basis.n_modes, "stable",
        **asdict(pole_errors(nearest, subject.poles, subject.numbers)), **asdict(errors), energy=0.0,
        note="no stop, bend or contact may change; the eigenproblem of the whole is not in the time",
    )  # fmt: skip
    steps = round(0.2 * fs)
    return Attempt(point, Task(lambda: stepper.run(state, steps), steps / fs))


def timed(makes: Sequence[Callable[[], Attempt]], repeats: int, tell: Tell = silent) -> list[Point]:
    """Points with their times, taken in turns.

    Parameters
    ----------
    makes : run one method each.
    tell : called with the share that is done, 0 to 1.
    """
    known = []
    for done, make in enumerate(makes, 1):
        known.append(make())
        tell(0.7 * done / len(makes))
    tasks = [a.task for a in known if a.task is not None]
    timings: Iterator[Timing] = iter(measure(tasks, repeats, lambda share: tell(0.7 + 0.3 * share)))
    out = []
    for a in known:
        if a.task is None:
            out.append(a.point)
            continue
        t = next(timings)
        out.append(replace(a.point, seconds=t.median, seconds_low=t.low, seconds_high=t.high))
    return out
