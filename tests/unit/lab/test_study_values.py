"""Cases of the study and what is made of them: closed forms, and runs that are made up."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla

from tonewood.lab.accuracy import linear_cases, nonlinear_cases, study
from tonewood.lab.accuracy.linear_cases import LinearCase
from tonewood.lab.accuracy.nonlinear_cases import NonlinearCase
from tonewood.lab.accuracy.outcome import DECAY, PITCH, WAVEFORM, Point
from tonewood.lab.accuracy.runs import Scene
from tonewood.lab.accuracy.study import Attempt, Watch
from tonewood.lab.accuracy.timing import Task, Timing
from tonewood.lab.methods import Problem
from tonewood.lab.methods.problem import inverses
from tonewood.physics.coupling.connections import Connection, Term
from tonewood.physics.coupling.laws import Contact, HardeningSpring
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.modal.propagator import apply

# nonlinear cases


def moved(case: NonlinearCase, component: str, point: str) -> float:
    """Displacement of a point at the start, m."""
    problem = case.scene.problem
    basis = problem.components[component]
    q = apply(problem.real.read, case.scene.x)[problem.starts[component], 0]
    return float(basis.right.real[basis.index(point)] @ q)


def test_the_beam_of_problem_d_is_bent_by_5_newton_and_its_chain_follows() -> None:
    """F L^3 / 48 EI at the middle of the beam, 1 m and 3 N m^2."""
    case = nonlinear_cases.klosner_case()
    bent = 5 / (48 * 3.0)
    assert moved(case, "main", "seat") == pytest.approx(bent, rel=1e-3)
    assert moved(case, "sub", "foot") == pytest.approx(moved(case, "main", "seat"), rel=1e-12)
    problem = case.scene.problem
    q, v = apply(problem.real.read, case.scene.x).T
    assert np.count_nonzero(np.abs(q[problem.starts["sub"]]) > 1e-12) == 1
    assert np.abs(v).max() < 1e-12
    (mount,) = case.scene.laws
    assert isinstance(mount.law, HardeningSpring)
    assert [t.factor for t in mount.terms] == [1.0, -1.0]
    assert (case.reference_rate, case.fine_rate, case.duration) == (500.0, 32e3, 1.0)
    assert (case.lossless, case.slow, case.pitch) == (False, False, 0.0)


@pytest.mark.parametrize(
    ("make", "stiffness", "exponent"), [("obstacle_case", 1e10, 2.3), ("hard_obstacle_case", 1e10, 1)]
)
def test_strings_are_lifted_by_2_mm_over_their_obstacle(make: str, stiffness: float, exponent: float) -> None:
    case = getattr(nonlinear_cases, make)()
    assert moved(case, "string", "middle") == pytest.approx(2e-3, rel=0.01)
    assert moved(case, "string", "pickup") == pytest.approx(2e-3 * 0.3 / 0.5, rel=0.01)
    (obstacle,) = case.scene.laws
    assert isinstance(obstacle.law, Contact)
    assert (obstacle.law.stiffness, obstacle.law.exponent, obstacle.law.offset) == (stiffness, exponent, 0.0)
    assert (case.lossless, case.slow, case.fine_rate) == (True, True, 32 * 48e3)
    assert case.duration == (0.3 if exponent == 1 else 0.04)
    assert case.pitch == (pytest.approx(4 / 3 * 110.0, rel=1e-3) if exponent == 1 else 0.0)


def test_a_plucked_steel_string_is_lossless_and_bent_by_2_newton() -> None:
    """Without its body's give: T u (1 / a + 1 / b) = F."""
    case = nonlinear_cases.tension_case()
    lifted = 2.0 / (75.0 * (1 / 0.2 + 1 / 0.8))
    assert moved(case, "string", "pluck") == pytest.approx(lifted, rel=0.05)
    assert not case.scene.problem.components["body"].damping_rate.any()
    assert case.scene.tensions[0].axial_stiffness == pytest.approx(174e9 * np.pi * 0.3556e-3**2)
    assert (case.fine_rate, case.reference_rate, case.duration) == (32 * 48e3, 24e3, 0.2)


def oscillators(**more: object) -> NonlinearCase:
    """Two modes that nothing joins, released from 1 and 0.5 mm: a closed form."""
    basis = ModalBasis.real([400.0, 900.0], [3.0, 5.0], {"p": [1.0, 1.0]})
    nothing = Connection("nothing", (Term("m", "p", 0.0),))
    problem = Problem({"m": basis}, (nothing,), (Term("m", "p"),), (Term("m", "p", 2.0),))
    x = apply(inverses(problem.real.read), np.array([[1e-3, 0], [5e-4, 0]]))
    return NonlinearCase("m", "M", Scene(problem, x), 0.1, (2e3, 1e3), (2e3,), **more)  # type: ignore[arg-type]


def closed(t: np.ndarray) -> np.ndarray:
    out = np.zeros_like(t)
    for a, w0, sigma in ((1e-3, 400.0, 3.0), (5e-4, 900.0, 5.0)):
        w = np.sqrt(w0**2 - sigma**2)
        out += 2 * a * np.exp(-sigma * t) * (np.cos(w * t) + sigma / w * np.sin(w * t))
    return out


def test_true_motions_are_those_of_oscillators(monkeypatch) -> None:
    case, t = oscillators(), np.arange(100) / 1e3
    exact = closed(t)
    whole, fine = case.integrated(), case.stepped()
    assert (case.reference_rate, case.fine_rate) == (1e3, 64e3)
    assert whole.wave == pytest.approx(exact, abs=1e-12)
    assert fine.wave == pytest.approx(exact, abs=1e-12)
    assert whole.source.startswith("DOP853, rtol 1e-11 (tonewood at 64 kHz: ")
    monkeypatch.setattr(NonlinearCase, "_fine", lambda self, divisor: exact * (1 + 3e-3 * (divisor - 1)))
    assert case.stepped().source == "tonewood at 64 kHz, converged to 1.0e-03"
    monkeypatch.setattr(NonlinearCase, "_fine", lambda self, divisor: 1.002 * np.append(exact, 9.0))
    assert case.integrated().source.endswith(": 2.0e-03 from it)")


# linear cases


BODY, STRING = (1500.0, 6.0), ((1200.0, 2.0), (4000.0, 4.0))


def joined() -> Problem:
    """A mode of a body tied to one of two modes of a string."""
    parts = {
        "body": ModalBasis.real([BODY[0]], [BODY[1]], {"b": [0.5]}),
        "string": ModalBasis.real([w for w, _ in STRING], [s for _, s in STRING], {"b": [1.0, -1.0], "p": [1.0, 2.0]}),
    }
    tie = Connection("tie", (Term("string", "b"), Term("body", "b", -1.0)))
    return Problem(parts, (tie,), (Term("string", "p"),), (Term("body", "b"),))


def tied_poles() -> np.ndarray:
    """Poles of q1, q2 with the body at q = 2 (q1 - q2)."""
    T = np.array([[2.0, -2.0], [1.0, 0.0], [0.0, 1.0]])
    omega, sigma = (np.array([BODY[i], *(row[i] for row in STRING)]) for i in (0, 1))
    M, C, K = (T.T @ np.diag(d) @ T for d in (np.ones(3), 2 * sigma, omega**2))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-sla.solve(M, K), -sla.solve(M, C)]])
    poles = sla.eigvals(A)
    return np.array(sorted(poles[poles.imag > 0], key=lambda p: p.imag))


@pytest.fixture(scope="module")
def case() -> LinearCase:
    return LinearCase("tied", "Tied", lambda freq_upper: joined(), tied_poles, "real modes")


def test_superposed_modes_are_exact(case) -> None:
    made = study.superposition_point(case)
    p = made.point
    assert (p.method, p.dial, p.value, p.fs, p.n_modes, p.stable, p.energy) == (
        "superposition", "fs", "48 kHz", 48e3, 2, "stable", 0.0
    )  # fmt: skip
    assert max(p.cents_worst, p.decay_worst, p.waveform) < 1e-8
    assert made.task.sound == pytest.approx(0.2)
    made.task.run()


def test_a_linear_attempt_has_the_errors_of_its_method(case) -> None:
    """Held positions have errors of order 4; the undamped twin keeps its energy."""
    one, two = (study.own_point(case, fs) for fs in (48e3, 96e3))
    assert (one.point.n_modes, one.point.value, one.point.dial) == (3, "48 kHz", "fs")
    assert np.log2(one.point.cents_worst / two.point.cents_worst) == pytest.approx(4, abs=0.2)
    assert one.point.waveform / two.point.waveform == pytest.approx(16, rel=0.2)
    assert one.point.energy < 1e-11
    assert one.task.sound == pytest.approx(0.2)
    assert two.task.sound == pytest.approx(0.2)
    other = study.own_point(case, 48e3, problem=joined(), dial="modes", value="x").point
    assert (other.dial, other.value, np.isnan(other.energy)) == ("modes", "x", True)
    assert not np.isnan(study.scheme_point(case, "newmark", 48e3).point.energy)
    assert np.isnan(study.scheme_point(case, "newmark", 48e3, freq_upper=1e4).point.energy)


def test_sounding_poles_and_numbers_of_partials(case) -> None:
    assert sorted(case.sounding.imag) == pytest.approx(sorted([*tied_poles().imag, *-tied_poles().imag]), rel=1e-9)
    assert case.numbers.tolist() == [1, 2]
    assert case.in_real_modes is case
    many = LinearCase("m", "M", lambda f: joined(), lambda: np.zeros(5, complex), strings=lambda: [4, 4, 7, 4, 7])
    assert many.numbers.tolist() == [1, 2, 1, 3, 2]
    assert many.joints == [4, 4, 7, 4, 7]
    assert many.in_real_modes.real
    still = case.free_of_loss.problem.components
    assert [basis.damping_rate.max() for basis in still.values()] == [0.0, 0.0]
    with pytest.raises(ValueError, match="'b' are not real"):
        linear_cases.undamped(Problem({"b": ModalBasis.complex([-1 + 5j], {"p": [1]}, {"p": [1]})}, (), (), ()))


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("fabre_guitar", linear_cases.fabre_case),
        ("harp", linear_cases.harp_case),
        ("a2_on_16_modes", linear_cases.a2_case),
        ("harp_block", partial(linear_cases.harp_case, "block")),
    ],
)
def test_poles_of_a_case_are_those_of_its_modes(name: str, make) -> None:
    """Poles of string and receptance against eigenvalues of the modes: another way to the same."""
    case = make()
    true = case.true_poles()[:8]
    assert case.name == name
    assert case.poles.size == linear_cases.PARTIALS
    modal = linear_cases.continuous_poles(case.problem(), true)
    assert np.abs(1200 * np.log2(modal.imag / true.imag)).max() < 1e-3
    assert modal.real == pytest.approx(true.real, rel=1e-5)


def test_the_shipped_guitar_as_a_problem(monkeypatch) -> None:
    """Each string is pulled by 1 N at 30 degrees to the board's normal; partials lie near those of ideal strings."""
    monkeypatch.setattr(linear_cases, "FREQ_UPPER", 1000.0)
    case = linear_cases.guitar_case(("E2", "B3"))
    problem = case.build(1000.0)
    assert len(problem.constraints) == len(problem.inputs) == 12
    axes = -np.array([[t.factor for t in joint.terms[1:]] for joint in problem.constraints]).reshape(6, 2, 2)
    pulls = np.array([t.factor for t in problem.inputs]).reshape(6, 1, 2) @ axes
    assert np.abs(pulls[:, 0]) == pytest.approx(np.tile([3**0.5 / 2, 0.5], (6, 1)))
    assert problem.outputs == (Term("body", "bridge_G3"),)
    numbers = case.numbers.tolist()
    assert numbers == [*range(1, 11), 1, 2, 3]
    freqs = case.true_poles().imag / (2 * np.pi)
    f0 = np.where(np.arange(13) < 10, 82.41, 246.94)
    assert np.abs(1200 * np.log2(freqs / (f0 * numbers))).max() < 60
    assert (case.true_poles().real < 0).all()
    assert linear_cases.guitar_case().title == "Classical guitar: six strings, two polarizations, measured body"
    assert case.title.endswith(" (partials of E2, B3)")


# what is made of a case


class Scripted:
    """A run of energies and displacements that are given."""

    def __init__(self, energies: list[float], finite: int = 99):
        self.energies, self.finite, self.made = energies, finite, []

    def start(self) -> None:
        self.made.clear()

    def energy(self) -> float:
        return self.energies[min(len(self.made), len(self.energies) - 1)]

    def run(self, n: int, every: int):
        self.made.append((n, every))
        return np.full((n // every, 2), [float(len(self.made)), 7.0]), len(self.made) < self.finite


@pytest.mark.parametrize(
    ("energies", "finite", "stable"),
    [
        ([2.0, 2.0, 2.0], 99, "stable"),
        ([2.0, 2.0, 2.39], 99, "stable"),
        ([2.0, 2.41, 1.0], 99, "grows"),
        ([2.0, 1.0, np.inf], 99, "NaN"),
        ([2.0, 2.0, 2.0], 2, "NaN"),
    ],
)
def test_an_attempt_is_judged_by_its_energies(energies: list[float], finite: int, stable: str) -> None:
    run, heard = Scripted(energies, finite), []

    def judge(run, y, energies, grows):
        heard.append((y.tolist(), energies.tolist(), grows))
        return {"waveform": 0.25}

    watch = Watch(rate=10.0, duration=0.4, checks=2, growth=0.2, multiple=1)
    made = study.attempt(run, Point("s", "m", "fs", "", 20.0, 1, ""), watch, judge)
    assert made.point.stable == stable
    assert run.made[0] == (4, 2)
    if stable == "NaN":
        assert (made.task, heard, np.isnan(made.point.waveform)) == (None, [], True)
        return
    assert heard == [([1.0, 1.0, 2.0, 2.0], energies, stable == "grows")]
    assert made.point.waveform == 0.25
    assert (made.task is None) == (stable == "grows")
    if made.task is not None:
        assert (made.task.sound, made.task.prepare) == (0.4, run.start)
        made.task.run()
        assert run.made[-1] == (8, 2)
        short = study.attempt(run, made.point, watch, judge, 6)
        short.task.run()
        assert (run.made[-1], short.task.sound) == ((6, 6), 0.3)


@pytest.mark.parametrize(("fs", "every", "steps"), [(8e3, 1, 268), (16e3, 2, 534), (24e3, 3, 804), (3e3, 1, 100)])
def test_looks_are_multiples_of_steps(fs: float, every: int, steps: int) -> None:
    watch = Watch(rate=8e3, duration=0.1, checks=3)
    assert (watch.every(fs), watch.steps(fs)) == (every, steps)
    assert Watch().steps(48e3) == 4800


def asked(makes) -> list[tuple]:
    """Function, method or basis, rate and more of each."""
    return [(m.func.__name__, *m.args[1:], *m.keywords.values()) for m in makes]


def test_rates_of_linear_methods(monkeypatch) -> None:
    limits = {study.AB3_LIMIT: 100e3, study.VERLET_LIMIT: 40e3}
    monkeypatch.setattr(study, "lowest_rate", lambda problem, limit: limits[limit])
    monkeypatch.setattr(study, "_dials", lambda case, quick: [partial(study.own_point, case, 1.0)])
    assert limits.keys() == {(5 + 5**0.5) / 10, 2.0}
    one = SimpleNamespace(name="x", strings=None, problem=lambda top=0.0: None)
    one.in_real_modes = SimpleNamespace(problem=one.problem)
    own = [("own_point", fs) for fs in (24e3, 32e3, 48e3, 96e3, 192e3)]
    made = list(study._linear_makes(one, quick=False))
    rows = asked(made)
    assert rows[:5] == own
    assert (rows[5], rows[-1]) == (("superposition_point",), ("own_point", 1.0))
    assert asked(study._linear_makes(one, quick=True))[:4] == [*own[:1], *own[2:4], ("superposition_point",)]
    by = {}
    for make in made[6:-1]:
        by.setdefault(make.args[1], []).append(make.args[2])
        real = make.args[1] in ("verlet", "newmark", "hht")
        assert make.args[0] is (one.in_real_modes if real else one)
    usual = [48e3, 96e3, 192e3, 384e3, 768e3]
    others = ("p0", "p1", "p2", "trapezoidal", "simpson", "newmark", "hht", "held_velocity")
    assert by == {
        "ab3": [pytest.approx(90e3), pytest.approx(102e3), 400e3, 800e3, 1200e3],
        "verlet": [pytest.approx(36e3), pytest.approx(42e3), 100e3, 200e3, 400e3, 800e3],
        **dict.fromkeys(others, usual),
        "held_position": usual[:3],
        "linear_position": [48e3],
    }
    quick = {}
    for make in study._others(one, one.in_real_modes, quick=True):
        quick.setdefault(make.args[1], []).append(make.args[2])
    assert quick == {
        "ab3": [pytest.approx(102e3), 800e3],
        "verlet": [pytest.approx(42e3), 400e3],
        **{method: [48e3, 192e3] for method in (*others, "held_position")},
        "linear_position": [48e3],
    }
    many = SimpleNamespace(**{**vars(one), "strings": "all"})
    assert ("superposition_point",) not in asked(study._linear_makes(many, quick=True))
    for fast in (False, True):
        strings = {}
        for make in study._others(many, one.in_real_modes, quick=fast):
            strings.setdefault(make.args[1], []).append(make.args[2])
        methods = ("p1", "newmark") if fast else others
        usual = [48e3, 192e3] if fast else [48e3, 96e3, 192e3, 384e3]
        assert strings == {
            "ab3": [128e3, 192e3] if fast else [128e3, 192e3, 256e3, 384e3],
            "verlet": [48e3, 64e3] if fast else [48e3, 64e3, 96e3, 128e3, 192e3, 256e3],
            **dict.fromkeys(methods, usual),
            "held_position": usual[:3],
            "linear_position": [48e3],
        }


def test_the_paper_s_guitar_has_150_modes(monkeypatch) -> None:
    tops = []
    case = SimpleNamespace(name="fabre_guitar", strings=None, problem=lambda top=0.0: tops.append(top))
    monkeypatch.setattr(study, "lowest_rate", lambda problem, limit: 500e3 if limit < 1 else 40e3)
    for quick, rates in ((True, [510e3, 1200e3]), (False, [450e3, 510e3, 800e3, 1200e3])):
        made = [m for m in study._others(case, case, quick) if m.args[1] == "ab3_paper"]
        assert [m.args[2] for m in made] == pytest.approx(rates)
        string = linear_cases.fabre_guitar.string(freq_upper=made[0].keywords["freq_upper"])
        # the highest partial of the 150 is kept, the next one is not
        assert abs(string.n_modes - 150) <= 1
        assert tops[-1] == made[0].keywords["freq_upper"]


def test_nonlinear_attempts_are_judged_by_truth_or_pitch(monkeypatch) -> None:
    case = oscillators()
    made = study.nonlinear_attempt(case, case.integrated(), "tonewood", 2e3, False)
    assert (made.point.value, made.point.n_modes, made.point.stable, made.point.waveform < 1e-9) == (
        "2 kHz",
        2,
        "stable",
        True,
    )
    assert made.point.note == f"0 Newton iterations per step, 0 at most; {case.integrated().source}"
    assert np.isfinite(made.point.energy)
    assert np.isnan(made.point.cents_worst)
    assert np.isnan(study.nonlinear_attempt(oscillators(lossless=False), None, "tonewood", 2e3, False).point.energy)
    heard = []

    def period(y, *asked):
        heard.append((len(y), *asked))
        return 1 / (80.0 * 2 ** (-5 / 1200))

    monkeypatch.setattr(study, "measured_period", period)
    pitched = study.nonlinear_attempt(oscillators(pitch=80.0), None, "tonewood", 2e3, True, "residual", "v").point
    assert heard == [(100, 1e3, 80.0, 6)]
    assert pitched.cents_worst == pytest.approx(5.0)
    assert pitched.cents_median == pytest.approx(5.0)
    assert (pitched.dial, pitched.value, np.isnan(pitched.waveform)) == ("residual", "v", True)
    assert pitched.note.endswith("; closed form of the pitch")


def test_rates_and_dials_of_nonlinear_systems() -> None:
    contact = [SimpleNamespace(law=Contact(1.0, 1.0))]

    def made(quick: bool, pitch: float = 0.0, laws=(), slow: bool = True) -> list[tuple]:
        case = SimpleNamespace(
            rates=(1e3, 2e3, 3e3, 4e3), verlet_rates=(5e3, 6e3, 7e3), pitch=pitch, slow=slow,
            scene=SimpleNamespace(laws=laws), stepped=lambda: "stepped", integrated=lambda: "integrated",
        )  # fmt: skip
        return asked(study._nonlinear_makes(case, quick))

    full = [("nonlinear_attempt", "integrated", "tonewood", fs, False) for fs in (1e3, 2e3, 3e3, 4e3)]
    verlet = [("nonlinear_attempt", "integrated", "verlet", fs, False) for fs in (5e3, 6e3, 7e3)]
    assert made(False) == [*full, *verlet]
    assert made(True, slow=False) == [*full[:3], *verlet[::2]]
    assert {row[1] for row in made(True)} == {"stepped"}
    closed = made(False, 100.0, contact)
    assert [row[1:] for row in closed[:4]] == [(None, "tonewood", fs, True) for fs in (1e3, 2e3, 3e3, 4e3)]
    said = "without residual compliance at the contact, 4 kHz"
    assert closed[-1][1:] == (None, "tonewood", 4e3, False, "residual", said)
    assert len(closed) == 11
    quick = made(True, 100.0, contact)
    assert [row[2] for row in quick] == ["tonewood"] * 5
    assert made(True, 0.0, contact)[-1][4:] == (True, "residual", "with residual compliance at the contact, 2 kHz")


def test_times_are_those_of_the_attempts_that_are_timed(monkeypatch) -> None:
    def measured(tasks, repeats, tell):
        tell(0.5)
        return [Timing(t.sound, t.sound - 1, t.sound + 1, repeats) for t in tasks]

    monkeypatch.setattr(study, "measure", measured)
    shares = []
    point = Point("s", "m", "fs", "", 1.0, 1, "")
    makes = [
        lambda: Attempt(point, Task(print, 5.0)),
        lambda: Attempt(point, None),
        lambda: Attempt(point, Task(print, 7.0)),
    ]
    rows = study.timed(makes, 3, shares.append)
    assert [(p.seconds, p.seconds_low, p.seconds_high) for p in rows[::2]] == [(5, 4, 6), (7, 6, 8)]
    assert np.isnan(rows[1].seconds)
    assert shares == pytest.approx([0.7 / 3, 1.4 / 3, 0.7, 0.85])


def test_studies_of_linear_and_nonlinear_systems(monkeypatch, case) -> None:
    asked = []

    def timed(makes, repeats, tell):
        asked.append((makes, repeats))
        tell(0.5)
        return [Point("s", "m", "fs", "", 1.0, 1, "", note="9 iterations; the truth")]

    monkeypatch.setattr(study, "timed", timed)
    monkeypatch.setattr(study, "_linear_makes", lambda case, quick: iter(("linear", case.name, quick)))
    monkeypatch.setattr(study, "_nonlinear_makes", lambda case, quick: iter(("nonlinear", case.name, quick)))
    strings = LinearCase("many", "Many", case.build, tied_poles, "real modes", strings=lambda: [0, 0])
    monkeypatch.setattr(study.FineMotion, "convergence", 1.5e-7)
    vars(strings)["motion"] = study.FineMotion(joined(), np.zeros((3, 2)))
    entry = study.CASES["harp"].__class__
    cases = {
        "tied": entry(lambda: case, lambda: case),
        "many": entry(lambda: strings, None, 2.0),
        "soft": entry(oscillators, lambda: oscillators(pitch=3.0)),
    }
    monkeypatch.setattr(study, "CASES", cases)
    monkeypatch.setattr(study, "selected", lambda name, quick: ["tied", "many", "soft"])
    shares = []
    tied, many, soft = study.run(tell=shares.append)
    assert shares == [0.125, 0.5, 0.875]
    assert asked == [
        (["linear", "tied", False], 9), (["linear", "many", False], 9), (["nonlinear", "m", False], 7)
    ]  # fmt: skip
    assert (tied.measures, many.measures, soft.measures) == (
        (PITCH, DECAY, WAVEFORM),
        (WAVEFORM, PITCH, DECAY),
        (WAVEFORM,),
    )
    assert (soft.truth, soft.title) == ("the truth", "M")
    assert tied.points[0].note == "9 iterations; the truth"
    assert many.points[0].note == "9 iterations; the truth; reference converged to 1.5e-07"
    assert many.truth.endswith(" kHz, converged to 1.5e-07")
    assert tied.truth.startswith("poles of the transcendental string")
    asked.clear()
    assert [o.measures[0] for o in study.run(quick=True)] == [PITCH, WAVEFORM, PITCH]
    assert [(made[2], repeats) for made, repeats in asked] == [(True, 3)] * 3
