"""Linear systems that methods are compared on.

Every case is plucked alike: a constant force holds it at rest and lets go at time 0. Nothing but the method's own
stepping then makes an error; known forces, which each method takes in its own way, have no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from tonewood.lab.accuracy.measures import pole_errors, wave_errors
from tonewood.lab.accuracy.reference import ExactMotion, FineMotion, Motion
from tonewood.lab.accuracy.runs import Scene
from tonewood.lab.methods.pole_search import continuous_matrix, nearest_zero
from tonewood.lab.methods.problem import Problem
from tonewood.lab.string_end import ExactString, coupled_pole
from tonewood.lab.systems import fabre_guitar, harp, string_and_body
from tonewood.lab.systems.harp_body import harp_body, harp_body_matrices
from tonewood.physics.coupling.connections import Connection, Rigid, Term
from tonewood.physics.modal.damping import with_damping_case
from tonewood.physics.modal.modes import PAIR, ModalBasis
from tonewood.physics.modal.receptance import Joint, Ports
from tonewood.physics.modal.string_modes import held_string_compliance
from tonewood.support.arrays import Complexes, Floats

#: Hz, modes of strings that every method steps unless its dial says otherwise
FREQ_UPPER = 20000.0
#: s of free motion that waveforms are compared over
DURATION = 1.0
PARTIALS = 40


@dataclass(frozen=True, eq=False)
class LinearCase:
    """One linear system: its modes, its true values, and the state from which it is let go.

    name, title : short, and as a heading.
    build : highest string mode in Hz -> problem, one driven and one read point.
    true_poles : poles of partials 1, 2, ..., 1/s, by a way that knows no modes of strings.
    damped_as : in words, the damping of its bodies.
    string : its only string, if there is but one.
    strings : of many strings, for each true pole, the connection of its string.
    real : whether all is in real modes, damping proportional, as second-order methods take it.
    """

    name: str
    title: str
    build: Callable[[float], Problem]
    true_poles: Callable[[], Complexes]
    damped_as: str = ""
    string: ExactString | None = None
    strings: Callable[[], Sequence[int]] | None = None
    real: bool = False
    _problems: dict[float, Problem] = field(default_factory=dict, init=False)
    _displacements: dict[tuple[float, int], Floats] = field(default_factory=dict, init=False)

    @property
    def in_real_modes(self) -> LinearCase:
        """The same in real modes: itself, if it has no others."""
        return self if self.damped_as == "real modes" else replace(self, real=True)

    def problem(self, freq_upper: float = FREQ_UPPER) -> Problem:
        """With string modes up to a frequency (Hz), made once for each."""
        if freq_upper not in self._problems:
            problem = self.build(freq_upper)
            self._problems[freq_upper] = real_modes_of(problem) if self.real else problem
        return self._problems[freq_upper]

    @cached_property
    def joints(self) -> Sequence[int] | None:
        """Connection of each partial, where there are many strings."""
        return None if self.strings is None else self.strings()

    @property
    def numbers(self) -> NDArray[np.intp]:
        """Number of each partial on its string."""
        joints = self.joints
        if joints is None:
            return np.arange(1, len(self.poles) + 1)
        return np.array([list(joints[: i + 1]).count(joint) for i, joint in enumerate(joints)])

    @cached_property
    def poles(self) -> Complexes:
        """(n,) true poles of the partials, 1/s; of a twin in real modes those with twice the modes."""
        poles = self.true_poles()
        return continuous_poles(self.problem(2.5 * FREQ_UPPER), poles, self.joints) if self.real else poles

    def start(self, problem: Problem) -> Scene:
        """At rest under unit forces, to be let go."""
        return Scene(problem, problem.static(np.ones(len(problem.inputs))))

    @cached_property
    def motion(self) -> Motion:
        """Partials below 20 kHz of the system with twice the modes; where there are too many, the same modes."""
        if self.problem().n_modes > 400:
            return FineMotion(self.problem(), self.start(self.problem()).x, DURATION)
        fine = self.problem(2 * FREQ_UPPER)
        return ExactMotion.of(fine, self.start(fine).x, FREQ_UPPER)

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
        return np.concatenate([self.poles, *(b.poles for b in self.problem().components.values())])

    @cached_property
    def free_of_loss(self) -> Scene:
        """The undamped twin, in real modes."""
        return self.start(undamped(real_modes_of(self.problem())))

    def errors(self, y: Floats, rate: float, poles: Complexes) -> dict[str, Any]:
        """Errors of displacements from time 0 on, and of partials."""
        true = self.displacement(rate, len(y))
        wave = wave_errors(y[: len(true)], true[:, 0], rate, self.sounding)
        return asdict(wave) | asdict(pole_errors(poles, self.poles, self.numbers))


def real_modes_of(problem: Problem) -> Problem:
    """The problem with proportional damping, every component in real modes: all that second-order methods can take.

    A component of complex modes is given as real ones at the points the problem uses, phi_i phi_j = 2 j omega_d r_i l_j
    of its proportional approximation (Fabre et al. 2024, section 3, case 2).
    """
    used: dict[str, list[str]] = {name: [] for name in problem.components}
    terms = [t for c in problem.constraints for t in c.terms] + [*problem.inputs, *problem.outputs]
    for t in terms:
        if t.point not in used[t.component]:
            used[t.component].append(t.point)
    parts: dict[str, ModalBasis] = {}
    for name, basis in problem.components.items():
        if basis.is_real:
            parts[name] = basis
            continue
        case_2 = with_damping_case(basis, "proportional")
        if np.any(case_2.kind != PAIR):
            raise ValueError(f"{name!r} has modes that are not under-damped")
        rows = [case_2.index(point) for point in used[name]]
        right, left = case_2.right[rows], case_2.left[rows]
        first = np.argmax(np.abs(right), axis=0), np.arange(case_2.n_modes)
        size = np.sqrt((right[first] * left[first] * 2j * case_2.poles.imag).real)
        shapes = (right / right[first]).real * size
        parts[name] = ModalBasis.real(
            np.sqrt(case_2.stiffness),
            case_2.damping_rate,
            dict(zip(used[name], shapes, strict=True)),
            residual=basis.residual[np.ix_(rows, rows)],
        )
    return replace(problem, components=parts)


def undamped(problem: Problem) -> Problem:
    """Return the problem with its real modes undamped."""
    parts = {}
    for name, basis in problem.components.items():
        if not basis.is_real:
            raise ValueError(f"the modes of {name!r} are not real")
        parts[name] = ModalBasis.real(
            np.sqrt(basis.stiffness),
            np.zeros(basis.n_modes),
            dict(zip(basis.points, basis.right.real, strict=True)),
            residual=basis.residual,
        )
    return replace(problem, components=parts)


def continuous_poles(problem: Problem, starts: Complexes, joints: Sequence[int] | None = None) -> Complexes:
    """Poles of a problem in continuous time nearest to given ones; see `pole_search.nearest_zero`."""
    matrix = continuous_matrix(problem)
    which = [None] * len(starts) if joints is None else [int(j) for j in joints]
    return np.array([nearest_zero(matrix, s, j) for s, j in zip(starts, which, strict=True)])


def sliding_string(string: ExactString, freq_upper: float, *, residual: bool) -> ModalBasis:
    """The string in modes cos((2 n - 1) pi x / 2 L), free to slide at the bridge (Antunes & Debut 2017; Fabre 2024).

    Their slope at the bridge is zero, so the static ramp is found only as a sum that converges like 1 / N; `residual`
    puts the part of it that the kept modes leave, and of all other static compliance, into the residual compliance.
    """
    s = string
    mu, T, EI, L = s.linear_density, s.tension, s.bending_stiffness, s.length
    n = np.arange(1, 1 + int(4 * L * freq_upper / s.fundamental / (2 * L)) + 2)
    k = (2 * n - 1) * np.pi / (2 * L)
    omega = np.sqrt((T * k**2 + EI * k**4) / mu)
    k, omega = k[omega < 2 * np.pi * freq_upper], omega[omega < 2 * np.pi * freq_upper]
    scale = np.sqrt(2 / (mu * L))

    def shape(x: float) -> Floats:
        return np.asarray(scale * np.cos(k * x))

    def static(x: float, y: float) -> float:
        # ramp of the free end under a force at y, and the held string's own deflection
        return (1 - x / L) * (1 - y / L) * L / T + float(held_string_compliance(x, y, L, T, EI))

    return ModalBasis.real(
        omega,
        np.full(k.size, s.sigma0),
        {"bridge": 0.0},
        shape=shape,
        static_compliance=static if residual else None,
    )


def _coupled_poles(string: ExactString, receptance: Callable[[complex], complex]) -> Complexes:
    return np.array([coupled_pole(string, receptance, n) for n in range(1, PARTIALS + 1)])


def _on_body(
    string: ExactString, body: ModalBasis, bridge: Connection, pluck: float, read: Term
) -> Callable[[float], Problem]:
    """Build: a string plucked at a share of its length, on a body."""
    return lambda freq_upper: Problem(
        {"string": string.basis({"pluck": pluck}, freq_upper=freq_upper), "body": body},
        (bridge,), (Term("string", "pluck"),), (read,),
    )  # fmt: skip


def fabre_case() -> LinearCase:
    """String on plate and air (Fabre et al. 2024, section 3.2.1)."""
    string = fabre_guitar.exact_string()
    return LinearCase(
        "fabre_guitar",
        "Guitar of Fabre et al. (2024): stiff string, plate and air",
        lambda freq_upper: fabre_guitar.problem(fabre_guitar.string(freq_upper)),
        lambda: _coupled_poles(string, fabre_guitar.body_receptance),
        "complex modes",
        string,
    )


def harp_case(case: str = "complex") -> LinearCase:
    """String 4 on the stand-in for the Central African harp."""
    string, body = harp.exact_string(), with_damping_case(harp_body(), case)
    board = harp.COSINE**2

    def receptance(s: complex) -> complex:
        if case != "complex":
            row = np.zeros((1, len(body.points)))
            row[0, body.index("s4")] = 1.0
            return board * complex(Joint([Ports.of(body, row)]).receptance(s)[0][0, 0])
        matrices, points = harp_body_matrices()
        tie = points["s4"]
        return board * complex(tie @ sla.solve(matrices.M * s * s + matrices.C * s + matrices.K, tie))

    build = _on_body(string, body, harp.STRING_4, fabre_guitar.PLUCK, Term("body", "s4"))
    name, label = ("harp", "") if case == "complex" else (f"harp_{case}", f", {case} damping")
    title = f"Central African harp, stand-in body of 32 complex modes{label}: string 4"
    return LinearCase(name, title, build, lambda: _coupled_poles(string, receptance), f"{case} modes", string)


def a2_case() -> LinearCase:
    """An ideal A2 on sixteen guitar modes (Antunes & Debut 2017)."""
    string, body = replace(string_and_body.A2, sigma0=0.2), string_and_body.sixteen_modes()
    build = _on_body(string, body, string_and_body.BRIDGE, 0.2, Term("body", "bridge"))
    title = "Ideal A2 on the 16 modes of Antunes & Debut (2017)"
    poles = partial(_coupled_poles, string, string_and_body.sixteen_mode_receptance)
    return LinearCase("a2_on_16_modes", title, build, poles, "real modes", string)


def guitar_case(strings: Sequence[str] | None = None) -> LinearCase:
    """The shipped classical guitar: six strings in two polarizations on its measured body, all plucked at once.

    Its joints are made rigid (the seat of a string on the saddle gives way by 2e-8 m/N, for which methods that
    constrain accelerations have no place), and it is heard at one point of the bridge.

    strings : whose true poles are sought; all.
    """

    @lru_cache(maxsize=4)
    def build(freq_upper: float) -> Problem:
        from tonewood.instrument.bundle.loading import Instrument
        from tonewood.instrument.model.assembly import assemble

        instrument = Instrument.load("classical_guitar").replace(
            {"strings.*.end_compliance": 0.0, "strings.*.freq_upper": freq_upper}
        )
        model = assemble(instrument, 4 * freq_upper, freq_limit=1.5 * freq_upper)
        one_way = {d.component for d in model.system.drives}
        components = {
            name: compiled.basis
            for name, compiled in zip(model.system.names, model.system.compiled, strict=True)
            if name not in one_way
        }
        plucks = []
        for string in model.strings.values():
            plucks += [Term(name, "pluck", factor) for name, factor in string.weights(30.0).items()]
        joints = tuple(c for c in model.system.connections if isinstance(c.law, Rigid))
        return Problem(components, joints, tuple(plucks), (Term("body", "bridge_G3"),))

    def partials() -> list[tuple[int, complex]]:
        """Connection of every string's first polarization, and the partials of that string on a rigid bridge."""
        problem = build(FREQ_UPPER)
        out = []
        first: set[str] = set()
        for index, joint in enumerate(problem.constraints):
            component, string = joint.terms[0].component, joint.owner
            if string in first or (strings is not None and string not in strings):
                continue
            first.add(string)
            metadata = problem.components[component].metadata
            length, tension, mu, EI = (
                float(np.asarray(metadata[key])) for key in ("length", "tension", "linear_density", "bending_stiffness")
            )
            alone = ExactString(length, tension, mu, EI)
            freqs = [alone.held_freq(n) for n in range(1, PARTIALS + 1)]
            out += [(index, 2 * np.pi * f * complex(-1e-4, 1.0)) for f in freqs if f < 0.9 * FREQ_UPPER]
        return out

    def poles() -> Complexes:
        guesses = partials()
        # twice the modes: the error of the highest partials by the missing ones is far below a thousandth of a cent
        return continuous_poles(build(2 * FREQ_UPPER), np.array([s for _, s in guesses]), [j for j, _ in guesses])

    of = f" (partials of {', '.join(strings)})" if strings is not None else ""
    return LinearCase(
        "classical_guitar",
        "Classical guitar: six strings, two polarizations, measured body" + of,
        build,
        poles,
        "real modes",
        None,
        lambda: [j for j, _ in partials()],
    )
