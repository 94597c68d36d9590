"""Every method and every dial on a system: errors, times, stability."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg as sla

from tonewood.lab.accuracy.catalogue import CASES, selected
from tonewood.lab.accuracy.linear_cases import DURATION, FREQ_UPPER, LinearCase, sliding_string
from tonewood.lab.accuracy.measures import energy_drift, wave_errors
from tonewood.lab.accuracy.nonlinear_cases import NonlinearCase, Truth
from tonewood.lab.accuracy.outcome import DECAY, PITCH, USUAL_RATE, WAVEFORM, Outcome, Point
from tonewood.lab.accuracy.reference import FINE_RATE, ExactMotion, FineMotion
from tonewood.lab.accuracy.runs import KernelRun, Run, Scene, run_of
from tonewood.lab.accuracy.timing import Task, Tell, Timing, measure, silent
from tonewood.lab.methods import METHODS
from tonewood.lab.methods.problem import Problem
from tonewood.lab.systems import fabre_guitar
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.modal.modes import ModalBasis
from tonewood.support.arrays import Floats

#: share of the sampling rate above which this project steps no mode
FREQ_LIMIT = 0.45
#: largest stable |s| h of Adams-Bashforth 3 on the imaginary axis, and of velocity Verlet
AB3_LIMIT, VERLET_LIMIT = float((5 + np.sqrt(5)) / 10), 2.0
#: rates that divide that of a reference which has to be computed, Hz
GRID = tuple(1e3 * k for k in (24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768))


@dataclass(frozen=True, eq=False)
class Attempt:
    """A point without its time, and the run to be timed."""

    point: Point
    task: Task | None


Make = Callable[[], Attempt]


@dataclass(frozen=True, slots=True)
class Watch:
    """How a free motion is followed.

    rate : Hz, about that at which displacements are read.
    duration : s.
    checks : instants at which the stored energy is looked at.
    growth : energy, as a share of that at the start, by which it may grow before a method counts as growing.
    multiple : number of steps that is made at once.
    """

    rate: float = 48000.0
    duration: float = DURATION
    checks: int = 10
    growth: float = 1e-6
    multiple: int = 2

    def every(self, fs: float) -> int:
        """Steps from one displacement that is read to the next."""
        return max(1, round(fs / self.rate))

    def steps(self, fs: float) -> int:
        """Steps between two looks at the energy."""
        every = self.every(fs)
        n = round(fs * self.duration / self.checks / every) * every
        return n + n % self.multiple * every

    def follow(self, run: Run, fs: float) -> tuple[Floats, Floats, bool]:
        """Displacement of the first readout, energies, and whether all is finite."""
        run.start()
        out, energies = [], [run.energy()]
        with np.errstate(all="ignore"):
            for _ in range(self.checks):
                y, finite = run.run(self.steps(fs), self.every(fs))
                out.append(y[:, 0])
                energies.append(run.energy())
                if not finite or not np.isfinite(energies[-1]):
                    return np.concatenate(out), np.array(energies), False
        return np.concatenate(out), np.array(energies), True


#: run, displacements, energies, whether they grow -> fields of a `Point`
Judge = Callable[[Run, Floats, Floats, bool], dict[str, Any]]


def attempt(run: Run, point: Point, watch: Watch, judge: Judge, timed_steps: int = 0) -> Attempt:
    """Let go, follow, compare.

    timed_steps : of the run that is timed, read once; 0: all that were followed.
    """
    y, energies, finite = watch.follow(run, point.fs)
    if not finite:
        return Attempt(replace(point, stable="NaN"), None)
    grows = bool(energies.max() > (1 + watch.growth) * energies[0])
    point = replace(point, stable="grows" if grows else "stable", **judge(run, y, energies, grows))
    steps = timed_steps or watch.steps(point.fs) * watch.checks
    task = Task(lambda: run.run(steps, timed_steps or watch.every(point.fs)), steps / point.fs, run.start)
    return Attempt(point, None if grows else task)


# ---- linear systems ----


def linear_attempt(
    case: LinearCase, method: str, fs: float, problem: Problem, drift: bool, dial: str = "fs", value: str = ""
) -> Attempt:
    """One method on a problem of a case and, if `drift` of the energy is asked for, on the undamped twin."""
    point = Point(case.name, method, dial, value or kilohertz(fs), fs, problem.n_modes, "")
    watch = Watch()

    def judge(run: Run, y: Floats, energies: Floats, grows: bool) -> dict[str, Any]:
        poles = METHODS[method].arrays(problem, 1 / fs).poles(case.poles, case.joints)
        return case.errors(y, fs / watch.every(fs), poles)

    steps = max(2, round(fs * min(0.2, 4e6 / (fs * problem.n_modes)) / 2) * 2)
    damped = attempt(run_of(method, case.start(problem), fs), point, watch, judge, steps)
    if damped.task is None or not drift:
        return damped
    _, energies, finite = watch.follow(run_of(method, case.free_of_loss, fs), fs)
    return replace(damped, point=replace(damped.point, energy=energy_drift(energies) if finite else np.nan))


def kilohertz(fs: float) -> str:
    """A sampling rate in a table."""
    return f"{fs / 1e3:.4g} kHz"


def scheme_point(case: LinearCase, method: str, fs: float, *, freq_upper: float = FREQ_UPPER) -> Attempt:
    """A method of the compiled loop."""
    return linear_attempt(case, method, fs, case.problem(freq_upper), freq_upper == FREQ_UPPER)


def own_point(
    case: LinearCase, fs: float, *, problem: Problem | None = None, dial: str = "fs", value: str = ""
) -> Attempt:
    """The stepper of this project; modes up to 0.45 fs unless a basis is given."""
    stepped = problem or case.problem(min(FREQ_UPPER, FREQ_LIMIT * fs))
    drift = problem is None and stepped is case.problem()
    return linear_attempt(case, "tonewood", fs, stepped, drift, dial, value)


def superposition_point(case: LinearCase) -> Attempt:
    """The coupled modes themselves, by the same stepper: exact at any rate, as long as nothing changes."""
    fs, same = USUAL_RATE, ExactMotion.of(case.problem(), case.start(case.problem()).x)
    basis = same.basis()
    modes = Problem({"modes": basis}, (), (), (Term("modes", "out0"),))
    x = np.zeros((basis.n_modes, 2))
    x[:, 0] = 1.0
    run = KernelRun(Scene(modes, x), fs)
    y = run.run(round(fs * DURATION))[0][:, 0]
    nearest = np.array([same.poles[np.argmin(np.abs(same.poles - p))] for p in case.poles])
    point = Point(
        case.name, "superposition", "fs", kilohertz(fs), fs, basis.n_modes, "stable",
        **case.errors(y, fs, nearest), energy=0.0,
        note="no stop, bend or contact may change; the eigenproblem of the whole is not in the time",
    )  # fmt: skip
    steps = round(0.2 * fs)
    return Attempt(point, Task(lambda: run.run(steps), steps / fs))


def lowest_rate(problem: Problem, limit: float) -> float:
    """Sampling rate, Hz, at which the highest mode stands at a limit of |s| h.

    Rigid connections lower frequencies (interlacing), so the highest mode of the parts is a safe bound, and near it.
    """
    return max(float(np.sqrt(b.stiffness.max())) for b in problem.components.values()) / limit


def _linear_makes(case: LinearCase, quick: bool) -> Iterator[Make]:
    for fs in (24e3, 48e3, 96e3) if quick else (24e3, 32e3, 48e3, 96e3, 192e3):
        yield partial(own_point, case, fs)
    if case.strings is None:
        yield partial(superposition_point, case)
    yield from _others(case, case.in_real_modes, quick)
    yield from _dials(case, quick)


def _others(case: LinearCase, real: LinearCase, quick: bool) -> Iterator[Make]:
    ab3, verlet = lowest_rate(case.problem(), AB3_LIMIT), lowest_rate(real.problem(), VERLET_LIMIT)
    if case.strings is not None:
        rates = {
            "ab3": [fs for fs in GRID if fs > ab3][: 2 if quick else 4],
            "verlet": [fs for fs in GRID if fs > verlet][: 2 if quick else 6],
        }
        usual = [48e3, 192e3] if quick else [48e3, 96e3, 192e3, 384e3]
    else:
        rates = {
            "ab3": [1.02 * ab3, 800e3] if quick else [0.9 * ab3, 1.02 * ab3, 400e3, 800e3, 1200e3],
            "verlet": [1.05 * verlet, 400e3] if quick else [0.9 * verlet, 1.05 * verlet, 100e3, 200e3, 400e3, 800e3],
        }
        usual = [48e3, 192e3] if quick else [48e3, 96e3, 192e3, 384e3, 768e3]
    few = ("p1", "newmark") if quick and case.strings is not None else None
    for method in ("p0", "p1", "p2", "trapezoidal", "simpson", "newmark", "hht", "held_velocity"):
        if few is None or method in few:
            rates[method] = usual
    rates |= {"held_position": usual[:3], "linear_position": [48e3]}
    for method, values in rates.items():
        for fs in values:
            yield partial(scheme_point, real if METHODS[method].real else case, method, fs)
    if case.name == "fabre_guitar":
        # as in the paper: 150 string modes, at the limit and at the paper's rate
        top = float(fabre_guitar.string(n_modes=150).natural_freq[-1]) * 1.0001
        least = lowest_rate(case.problem(top), AB3_LIMIT)
        for fs in (1.02 * least, 1200e3) if quick else (0.9 * least, 1.02 * least, 800e3, 1200e3):
            yield partial(scheme_point, case, "ab3_paper", fs, freq_upper=top)


def _dials(case: LinearCase, quick: bool) -> Iterator[Make]:
    """Dials of this project at 48 kHz, one turned at a time."""
    point, problem = partial(own_point, case, 48e3), case.problem()
    for freq in (5e3, 10e3) if quick else (2.5e3, 5e3, 10e3, 15e3):
        value = f"strings solved to {freq / 1e3:.4g} kHz"
        yield partial(point, problem=case.problem(freq), dial="modes", value=value)
    for fold, named in ((True, "with"), (False, "without")):
        value = f"string modes above 10 kHz dropped, {named} their compliance"
        yield partial(point, problem=_cut(problem, 10e3, fold), dial="residual", value=value)
    if case.string is not None:
        pluck = {"pluck": problem.components["string"].places["pluck"]}
        for fold, named in ((True, "with"), (False, "without")):
            basis = sliding_string(case.string, FREQ_UPPER, residual=fold).with_places(pluck)
            value = f"sliding cosines, {named} residual compliance"
            yield partial(point, problem=exchanged(problem, "string", basis), dial="basis", value=value)


def exchanged(problem: Problem, name: str, basis: ModalBasis) -> Problem:
    """Return the arrays with another basis for one component."""
    return replace(problem, components={**problem.components, name: basis})


def _cut(problem: Problem, freq: float, fold: bool) -> Problem:
    """String modes above a frequency dropped from the solved basis, their compliance kept or not."""
    parts = {
        name: basis if name == "body" else basis.select(basis.natural_freq < freq, fold=fold)
        for name, basis in problem.components.items()
    }
    return replace(problem, components=parts)


# ---- nonlinear systems ----


def measured_period(y: Floats, fs: float, freq: float, cycles: int) -> float:
    """Period of a periodic motion, s: the shift by `cycles` of it that makes the motion meet itself best."""
    from scipy.interpolate import CubicSpline
    from scipy.optimize import minimize_scalar

    t = np.arange(len(y)) / fs
    spline = CubicSpline(t, y)
    first = t[t < 1.5 / freq]

    def miss(shift: float) -> float:
        return float(sla.norm(spline(first + shift) - spline(first)))

    around = cycles / freq
    shifts = np.linspace(around - 0.05 / freq, around + 0.05 / freq, 81)
    best = shifts[int(np.argmin([miss(s) for s in shifts]))]
    width = shifts[1] - shifts[0]
    minimum = minimize_scalar(miss, bounds=(best - width, best + width), method="bounded", options={"xatol": 1e-13})
    return float(minimum.x) / cycles


def nonlinear_attempt(
    case: NonlinearCase, truth: Truth | None, method: str, fs: float, residual: bool, dial: str = "fs", value: str = "",
) -> Attempt:  # fmt: skip
    """One method on a nonlinear case, against its truth or, where there is none, the closed form of its pitch."""
    rate = case.reference_rate

    def judge(run: Run, y: Floats, energies: Floats, grows: bool) -> dict[str, Any]:
        judged: dict[str, Any] = {"energy": energy_drift(energies) if case.lossless else np.nan}
        if truth is not None:
            errors = wave_errors(y, truth.wave[: len(y)], rate, np.zeros(0, dtype=np.complex128))
            judged |= {"waveform": errors.waveform, "spectral_db": errors.spectral_db}
        if isinstance(run, KernelRun):
            s = run.stepper.statistics
            most, mean = s.most_iterations, s.iterations / max(s.steps, 1)
            judged["note"] = f"{mean:.2g} Newton iterations per step, {most} at most; {source}"
        if case.pitch and not grows:
            freq = 1 / measured_period(y, rate, case.pitch, int(case.duration * case.pitch) - 2)
            judged["cents_median"] = judged["cents_worst"] = abs(1200 * float(np.log2(freq / case.pitch)))
        return judged

    source = "closed form of the pitch" if truth is None else truth.source
    n_modes = case.scene.problem.n_modes
    point = Point(case.name, method, dial, value or kilohertz(fs), fs, n_modes, "", note=source)
    return attempt(run_of(method, case.scene, fs, residual), point, Watch(rate, case.duration, 20, 0.01, 1), judge)


def _nonlinear_makes(case: NonlinearCase, quick: bool) -> Iterator[Make]:
    truth = None if case.pitch else case.stepped() if quick and case.slow else case.integrated()
    point = partial(nonlinear_attempt, case, truth)
    # closed forms are of strings with all their modes, waveforms of the modes that are stepped
    whole = bool(case.pitch)
    for fs in case.rates[:3] if quick else case.rates:
        yield partial(point, "tonewood", fs, whole)
    for fs in case.verlet_rates[:: 2 if quick else 1] if not (quick and case.pitch) else ():
        yield partial(point, "verlet", fs, whole)
    if any(isinstance(c.law, Contact) for c in case.scene.laws):
        for fs in case.rates[:2] if quick else case.rates:
            named = "without" if whole else "with"
            value = f"{named} residual compliance at the contact, {fs / 1e3:.4g} kHz"
            yield partial(point, "tonewood", fs, not whole, "residual", value)


# ---- one system, and all of them ----


def study(name: str, *, quick: bool = False, tell: Tell = silent) -> Outcome:
    """Every method and every dial on one system."""
    entry = CASES[name]
    case = ((quick and entry.quick) or entry.make)()
    if isinstance(case, NonlinearCase):
        points = timed(list(_nonlinear_makes(case, quick)), 3 if quick else 7, tell)
        measure = PITCH if case.pitch else WAVEFORM
        return Outcome(name, case.title, points[0].note.rpartition("; ")[2], (measure,), tuple(points))
    points = timed(list(_linear_makes(case, quick)), 3 if quick else 9, tell)
    truth = "poles of the transcendental string on its body; waveform superposed from the coupled modes up to 20 kHz"
    # where there are many strings most methods lose some partials: the chart is of those that all of them have
    measures = (PITCH, DECAY, WAVEFORM) if case.strings is None else (WAVEFORM, PITCH, DECAY)
    if isinstance(case.motion, FineMotion):
        far = f"converged to {case.motion.convergence:.1e}"
        points = [replace(p, note="; ".join(filter(None, (p.note, f"reference {far}")))) for p in points]
        if case.strings is not None:
            truth = (
                "poles by Newton's method on the continuous system with string modes to 40 kHz; waveform by this "
                f"scheme at {FINE_RATE / 1e3:g} kHz, {far}"
            )
    return Outcome(name, case.title, truth, measures, tuple(points))


def run(name: str | None = None, *, quick: bool = False, tell: Tell = silent) -> Iterator[Outcome]:
    """The systems one after the other, as each is done; `tell` hears of the whole."""
    names = selected(name, quick=quick)
    done, total = 0.0, sum(CASES[n].weight for n in names)
    for n in names:
        share = CASES[n].weight / total

        def part(inner: float, done: float = done, share: float = share) -> None:
            tell(done + share * inner)

        yield study(n, quick=quick, tell=part)
        done += share


def timed(makes: Sequence[Callable[[], Attempt]], repeats: int, tell: Tell = silent) -> list[Point]:
    """Points with their times, taken in turns.

    makes : run one method each.
    tell : called with the share that is done, 0 to 1.
    """
    attempts = []
    for done, make in enumerate(makes, 1):
        attempts.append(make())
        tell(0.7 * done / len(makes))
    tasks = [a.task for a in attempts if a.task is not None]
    timings: Iterator[Timing] = iter(measure(tasks, repeats, lambda share: tell(0.7 + 0.3 * share)))
    out = []
    for a in attempts:
        if a.task is None:
            out.append(a.point)
            continue
        t = next(timings)
        out.append(replace(a.point, seconds=t.median, seconds_low=t.low, seconds_high=t.high))
    return out
