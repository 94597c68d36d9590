"""Nonlinear systems: a string whose tension rises, a string against an obstacle, a beam with a hardening mounting.

Beside this project's implicit steps stands velocity Verlet, which evaluates the same laws where the motion is. Both
are held against an integrator of order 8 with a relative tolerance of 1e-11 on the same modes; it takes half a minute,
and a quick study takes the project's own scheme at 32 times 48 kHz instead, with its distance from its limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood import _methods
from tonewood.errors import NumericalError
from tonewood.lab.accuracy.measures import energy_drift, wave_errors
from tonewood.lab.accuracy.study import Attempt, Point, Tell, silent, timed
from tonewood.lab.accuracy.timing import Task
from tonewood.lab.assembled import continuous_force, integrated
from tonewood.lab.methods.problem import Problem, RealModes
from tonewood.lab.methods.scheme import padded
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.inverse import scaled_pinv
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Readout, System
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.propagator import apply
from tonewood.physics.stepping.kernel import KernelStepper, instruction_set

Floats = NDArray[np.float64]

#: times at which the stored energy is looked at
CHECKS = 20


@dataclass(frozen=True, eq=False)
class Truth:
    """Displacements (n,) that methods are held against, and in words where they come from."""

    wave: Floats
    source: str


@dataclass(frozen=True, eq=False)
class NonlinearCase:
    """A nonlinear system of real modes, let go from a state.

    Attributes
    ----------
    name, title : short, and as a heading.
    problem : components and rigid connections; one driven and one read point.
    laws : connections whose laws are `Contact` or `HardeningSpring`.
    tensions : strings whose tension rises.
    duration : s that waveforms are compared over.
    rates, verlet_rates : Hz.
    lossless : whether its energy should stay.
    start : (flat) -> (n, 2), where it is let go.
    slow : whether the integrator of order 8 takes more than seconds.
    pitch : closed form of the fundamental, Hz; it is compared instead of waveforms where it is not 0.
    """

    name: str
    title: str
    problem: Problem
    laws: tuple[Connection, ...]
    tensions: tuple[TensionModulation, ...]
    duration: float
    rates: tuple[float, ...]
    verlet_rates: tuple[float, ...]
    lossless: bool
    start: Callable[[Problem], Floats]
    slow: bool = True
    pitch: float = 0.0

    @cached_property
    def flat(self) -> Problem:
        """All modes side by side."""
        return self.problem

    @cached_property
    def arrays(self) -> Arrays:
        """Real modes, gaps of the laws, weights of the tensions."""
        return Arrays.of(self)

    @cached_property
    def x(self) -> Floats:
        """(n, 2) where it is let go."""
        return self.start(self.flat)

    @property
    def reference_rate(self) -> float:
        """Rate at which waveforms are compared, Hz."""
        return float(min(self.rates))

    def integrated(self) -> Truth:
        """Motion by an integrator of order 8, and how far the project's scheme at a high rate is from it."""
        y = integrate(self.arrays, self.x, self.duration, self.reference_rate)
        far = float(sla.norm(self._fine(1)[: len(y)] - y) / sla.norm(y))
        return Truth(y, f"DOP853, rtol 1e-11 (tonewood at {self.fine_rate / 1e3:g} kHz: {far:.1e} from it)")

    def stepped(self) -> Truth:
        """Motion by the project's scheme at a high rate, and its distance from its limit: it is of order 2."""
        fine, coarse = self._fine(1), self._fine(2)
        far = float(sla.norm(fine - coarse) / sla.norm(fine)) / 3
        return Truth(fine, f"tonewood at {self.fine_rate / 1e3:g} kHz, converged to {far:.1e}")

    @property
    def fine_rate(self) -> float:
        """32 times the rate of a render, or of the lowest that is tried."""
        return 32 * min(48e3, 2 * self.reference_rate)

    def _fine(self, divisor: int) -> Floats:
        rate = self.fine_rate / divisor
        run = OwnRun(self, rate)
        run.start()
        return run.run(round(self.duration * rate), round(rate / self.reference_rate))[0]


@dataclass(frozen=True, eq=False)
class Arrays:
    """Equation of motion q'' = P (-w2 q - 2 sigma q' - sum EA/2L S k q + phi f), S = sum k q^2.

    Attributes
    ----------
    modes : frequencies, decay rates, shapes at rigid gaps and readouts.
    law : (l, n) shapes at the gaps of laws.
    weights : (n_tensions, n) k.
    stiffness : (n_tensions,) EA/2L.
    laws : of the gaps.
    G : (r, r) force of rigid connections per acceleration.
    """

    modes: RealModes
    law: Floats
    weights: Floats
    stiffness: Floats
    laws: tuple[Contact | HardeningSpring, ...]
    G: Floats

    @classmethod
    def of(cls, case: NonlinearCase) -> Arrays:
        """Collect them."""
        flat = case.flat
        modes = flat.real
        law_gaps = replace(case.problem, constraints=tuple(replace_law(c) for c in case.laws))
        law = law_gaps.real.gaps if case.laws else np.zeros((0, flat.n_modes))
        weights = np.zeros((len(case.tensions), flat.n_modes))
        stiffness = []
        for row, t in zip(weights, case.tensions, strict=True):
            for name in t.components:
                row[flat.starts[name]] = np.asarray(case.problem.components[name].metadata["tension_part"])
            length = t.length or float(np.asarray(case.problem.components[t.components[0]].metadata["length"]))
            stiffness.append(t.axial_stiffness / (2 * length))
        laws = tuple(c.law for c in case.laws if isinstance(c.law, (Contact, HardeningSpring)))
        return cls(modes, law, weights, np.array(stiffness), laws, scaled_pinv(modes.gaps @ modes.gaps.T))

    def acceleration(self, q: Floats, v: Floats) -> Floats:
        """(n,) of a state."""
        m = self.modes
        a = -m.omega2 * q - 2 * m.sigma * v
        for weight, stiffness in zip(self.weights, self.stiffness, strict=True):
            a -= stiffness * float(weight @ q**2) * weight * q
        for phi, law in zip(self.law, self.laws, strict=True):
            a += phi * continuous_force(law, float(phi @ q), float(phi @ v))
        return np.asarray(a - m.gaps.T @ (self.G @ (m.gaps @ a)))

    def energy(self, q: Floats, v: Floats) -> float:
        """Energy of modes, tensions and laws, J."""
        total = 0.5 * float(v @ v + self.modes.omega2 @ q**2)
        for weight, stiffness in zip(self.weights, self.stiffness, strict=True):
            total += stiffness / 4 * float(weight @ q**2) ** 2
        for phi, law in zip(self.law, self.laws, strict=True):
            total += law.energy(law.offset - float(phi @ q))
        return total


def replace_law(connection: Connection) -> Connection:
    """Return a rigid connection over the same gap."""
    return Connection(connection.name, connection.terms)


def integrate(arrays: Arrays, x: Floats, duration: float, fs: float, rtol: float = 1e-11) -> Floats:
    """(n,) displacement at 0, 1 / fs, ... by DOP853; state x (n, 2)."""
    m = arrays.modes
    q, v = apply(m.read, x).T
    n = len(q)
    # velocities in units of the frequency: entries of one size
    scale = np.sqrt(np.maximum(m.omega2, m.omega2[m.omega2 > 0].min()))

    def rate(t: float, y: Floats) -> Floats:
        v = y[n:] * scale
        return np.concatenate([v, arrays.acceleration(y[:n], v) / scale])

    y = np.concatenate([q, v / scale])
    atol = rtol * 1e-2 * float(np.abs(y).max())
    return np.asarray(
        integrated(rate, y, np.arange(round(duration * fs)) / fs, rtol=rtol, atol=atol)[:, :n] @ m.outs[0]
    )


@dataclass(eq=False)
class ExplicitRun:
    """Velocity Verlet, compiled."""

    case: NonlinearCase
    fs: float
    isa: str = field(default_factory=instruction_set)

    def __post_init__(self) -> None:
        a, flat, h = self.case.arrays, self.case.flat, 1 / self.fs
        r, weights = a.modes.gaps, a.weights.sum(axis=0)
        pad = _methods.PADDING
        self._places: dict[str, slice] = {}
        capacity = 0
        for name, modes in flat.starts.items():
            size = -(-(modes.stop - modes.start) // pad) * pad
            self._places[name] = slice(capacity, capacity + size)
            capacity += size
        self._method = _methods.Explicit(self.isa, capacity, h, len(r), 1, a.stiffness.tolist())
        for law in a.laws:
            numbers = (
                [law.stiffness, law.exponent, law.loss, 0.0]
                if isinstance(law, Contact)
                else [law.stiffness, law.cubic, law.damping, law.quadratic_damping]
            )
            self._method.add_law(isinstance(law, Contact), numbers, law.offset)
        coef = np.stack([a.modes.omega2, 2 * a.modes.sigma, weights])
        for name, modes in flat.starts.items():
            place = self._places[name]
            size = place.stop - place.start
            rigid, touched = (np.flatnonzero(rows[:, modes].any(axis=1)) for rows in (r, a.law))
            outs = np.flatnonzero(a.modes.outs[:, modes].any(axis=1))
            tension = next((i for i, t in enumerate(self.case.tensions) if name in t.components), -1)
            self._method.add_part(
                place.start, tension, padded(coef[:, modes], size), padded(r[rigid][:, modes], size),
                padded(a.law[touched][:, modes], size), padded(a.modes.outs[outs][:, modes], size),
                rigid.tolist(), touched.tolist(), outs.tolist(),
            )  # fmt: skip
        self._method.set_solve(np.ascontiguousarray(a.G), np.ascontiguousarray(r @ a.law.T))
        self.state = np.zeros((3, capacity))

    def start(self) -> None:
        """Let go: q, velocity half a step before, acceleration of the modes by themselves."""
        a, m = self.case.arrays, self.case.arrays.modes
        q, v = apply(m.read, self.case.x).T
        numbers = np.stack([q, v - a.acceleration(q, v) / (2 * self.fs), -m.omega2 * q - 2 * m.sigma * v])
        self.state[:] = 0.0
        for name, modes in self.case.flat.starts.items():
            first = self._places[name].start
            self.state[:, first : first + modes.stop - modes.start] = numbers[:, modes]

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """(n // every,) displacements from now on, and whether all is finite."""
        out = np.zeros((n // every + 1, 1))
        bad = self._method.run(self.state, n, every, out)
        return out[:-1, 0], bad < 0

    def energy(self) -> float:
        """Stored, J."""
        a = self.case.arrays
        numbers = np.concatenate([
            self.state[:, place.start : place.start + modes.stop - modes.start]
            for place, modes in zip(self._places.values(), self.case.flat.starts.values(), strict=True)
        ], axis=1)  # fmt: skip
        q, w, _ = numbers
        # the velocity half a step on needs the acceleration here
        v = w + a.acceleration(q, w) / (2 * self.fs)
        return a.energy(q, v)


@dataclass(eq=False)
class OwnRun:
    """The kernel of this project."""

    case: NonlinearCase
    fs: float
    residual: bool = False

    def __post_init__(self) -> None:
        case = self.case
        laws = [
            replace(c, law=replace(law, residual=self.residual))
            for c, law in zip(case.laws, case.arrays.laws, strict=True)
        ]
        out = case.problem.outputs[0]
        self.system = System.build(
            case.problem.components,
            [*case.problem.constraints, *laws],
            [Readout("0", "displacement", (Term(out.component, out.point, out.factor),))],
            dt=1 / self.fs,
            potentials=case.tensions,
        )
        self.stepper = KernelStepper(self.system)
        self.state = self.stepper.start()

    def start(self) -> None:
        """Let go."""
        self.state = self.stepper.start()
        self.state.modes[:] = self.case.flat.state_of(self.case.x, self.system)

    def run(self, n: int, every: int = 1) -> tuple[Floats, bool]:
        """See `ExplicitRun.run`."""
        try:
            return self.stepper.run(self.state, n)[0][::every, 0], True
        except NumericalError:
            return np.full(n // every, np.nan), False

    def energy(self) -> float:
        """Stored, J, also in the residual compliance of a contact."""
        return stored_energy(self.system, self.state).total


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
    found = minimize_scalar(miss, bounds=(best - width, best + width), method="bounded", options={"xatol": 1e-13})
    return float(found.x) / cycles


def attempt(case: NonlinearCase, truth: Truth | None, run: OwnRun | ExplicitRun, point: Point) -> Attempt:
    """Let go, follow, compare."""
    every = max(1, round(run.fs / case.reference_rate))
    n = round(case.duration * case.reference_rate) // CHECKS * every
    run.start()
    energies, out, finite = [run.energy()], [], True
    with np.errstate(all="ignore"):
        for _ in range(CHECKS):
            y, finite = run.run(n, every)
            if not finite:
                return Attempt(replace(point, stable="NaN"), None)
            out.append(y)
            energies.append(run.energy())
    y = np.concatenate(out)
    grown = max(energies) > 1.01 * energies[0]
    energy = energy_drift(np.array(energies)) if case.lossless else np.nan
    point = replace(point, stable="grows" if grown else "stable", energy=energy)
    if truth is not None:
        none = np.zeros(0, dtype=np.complex128)
        errors = wave_errors(y, truth.wave[: len(y)], case.reference_rate, none)
        point = replace(point, waveform=errors.waveform, spectral_db=errors.spectral_db)
    if isinstance(run, OwnRun):
        s = run.stepper.statistics
        most, mean = s.most_iterations, s.iterations / max(s.steps, 1)
        point = replace(point, note=f"{mean:.2g} Newton iterations per step, {most} at most; {point.note}")
    if case.pitch and not grown:
        cycles = int(case.duration * case.pitch) - 2
        freq = 1 / measured_period(y, case.reference_rate, case.pitch, cycles)
        cents = abs(1200 * float(np.log2(freq / case.pitch)))
        point = replace(point, cents_median=cents, cents_worst=cents)
    steps = n * CHECKS
    return Attempt(point, None if grown else Task(lambda: run.run(steps, every), steps / run.fs, run.start))


def study(case: NonlinearCase, *, quick: bool = False, tell: Tell = silent) -> list[Point]:
    """All points of one nonlinear system."""
    truth = None if case.pitch else case.stepped() if quick and case.slow else case.integrated()
    source = "closed form of the pitch" if truth is None else truth.source
    makes: list[Callable[[], Attempt]] = []

    def add(make: Callable[[NonlinearCase, float], OwnRun | ExplicitRun], name: str, fs: float, **more: str) -> None:
        here = {"dial": "fs", "value": f"{fs / 1e3:.4g} kHz", **more}
        point = Point(case.name, name, here["dial"], here["value"], fs, case.flat.n_modes, "", note=source)
        makes.append(lambda: attempt(case, truth, make(case, fs), point))

    # closed forms are of strings with all their modes, waveforms of the modes that are stepped
    whole = bool(case.pitch)
    for fs in case.rates[:3] if quick else case.rates:
        add(partial(OwnRun, residual=whole), "tonewood", fs)
    for fs in case.verlet_rates[:: 2 if quick else 1] if not (quick and case.pitch) else ():
        add(ExplicitRun, "verlet", fs)
    if any(isinstance(c.law, Contact) for c in case.laws):
        for fs in case.rates[:2] if quick else case.rates:
            named = "without" if whole else "with"
            value = f"{named} residual compliance at the contact, {fs / 1e3:.4g} kHz"
            add(partial(OwnRun, residual=not whole), "tonewood", fs, dial="residual", value=value)
    return timed(makes, 3 if quick else 7, tell)
