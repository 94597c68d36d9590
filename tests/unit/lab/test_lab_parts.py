"""Systems of the papers, row by row; and parts of the laboratory against forms written out in the test."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.polynomial import Polynomial

from tonewood.errors import TonewoodError
from tonewood.lab import estimates, figures, tables, validation
from tonewood.lab.accuracy import least_time, measures, outcome, timing
from tonewood.lab.accuracy import study as study_
from tonewood.lab.accuracy import tables as study_tables
from tonewood.lab.accuracy.outcome import PITCH, WAVEFORM, Outcome, Point
from tonewood.lab.accuracy.report import Study, _html
from tonewood.lab.assembled import (
    Matrices,
    chain,
    continuous_force,
    driven_motion,
    force_at,
    free_motion,
    integrated,
    modal_receptance,
    ramp_and_release,
    receptance,
    triangle,
)
from tonewood.lab.beam import Beam
from tonewood.lab.interpolatory import (
    P0,
    P1,
    P2,
    P2_MIDSTEP,
    SIMPSON,
    TRAPEZOIDAL,
    UPDATES,
    Update,
    interpolatory,
    lagrange,
)
from tonewood.lab.methods import METHODS, Problem
from tonewood.lab.methods.method import stability_limit
from tonewood.lab.newmark import AVERAGE_ACCELERATION, hht
from tonewood.lab.nonproportionality import reduced, reduction_shapes
from tonewood.lab.pseudo_load import PseudoLoad
from tonewood.lab.row import Row, cents, halving_order, misfit, nearest, pole_error
from tonewood.lab.string_end import ExactString
from tonewood.lab.systems import chinnakonda, fabre_methods, klosner
from tonewood.lab.transition import Transition
from tonewood.physics.coupling.connections import Term
from tonewood.physics.coupling.laws import Contact
from tonewood.physics.modal.modes import ModalBasis


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("fabre_forms", 36),
        ("fabre_academic", 32),
        ("fabre_guitar", 35),
        ("fabre_harp", 19),
        ("fabre_methods", 18),
        ("string_and_body", 25),
    ],
)
def test_every_row_of_a_system_passes(name: str, count: int) -> None:
    """Papers' figures, closed forms and direct solutions, each within its tolerance."""
    rows = validation.run([name])
    assert [f"{row.quantity}: {row.value} for {row.reference}" for row in rows if not row.passed] == []
    assert len(rows) >= count  # of methods more may be registered


# assembled systems


def two() -> Matrices:
    return chain([2.0, 1.0], [0.3, 0.1], [50.0, 30.0])


def test_forces_in_pieces() -> None:
    rise, fall = triangle(6.0, 2.0, 3.0)
    assert [force_at((rise, fall), t) for t in (0.0, 1.0, 2.0, 3.5, 5.0, -1.0)] == pytest.approx([0, 3, 6, 3, 0, 0])


def test_forces_of_laws() -> None:
    contact = SimpleNamespace(offset=0.2, stiffness=10.0, exponent=1.5, loss=0.5)
    hard = SimpleNamespace(offset=0.2, stiffness=10.0, cubic=5.0, damping=2.0, quadratic_damping=0.5)
    p, v = 0.2 + 0.3, 0.4
    assert continuous_force(hard, -0.3, -0.4) == pytest.approx(10 * p + 5 * p**3 + (2 + 0.5 * v) * v)
    assert continuous_force(hard, -0.3, 0.4) == pytest.approx(10 * p + 5 * p**3 - (2 + 0.5 * v) * v)
    real = Contact.__new__(Contact)
    for name, value in vars(contact).items():
        object.__setattr__(real, name, value)
    assert continuous_force(real, -0.3, -0.4) == pytest.approx(10 * p**1.5 * (1 + 0.5 * v))
    assert continuous_force(real, 0.2, -0.4) == 0.0


def test_motions_of_an_assembled_system() -> None:
    """Free, driven and released motion against `expm` of small steps and against receptances."""
    system, dt, n = two(), 0.05, 60
    a = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(system.M, system.K), -np.linalg.solve(system.M, system.C)]]
    )
    start = np.array([0.1, -0.2, 0.3, 0.0])
    wanted = np.array([sla.expm(a * dt * k) @ start for k in range(n)])
    assert free_motion(system, start[:2], start[2:], dt, n) == pytest.approx(wanted)
    assert free_motion(system, start[:2], start[2:], dt, 1).shape == (1, 4)
    pieces = triangle(2.0, 0.33, 0.5)
    moved = driven_motion(system, [0.0, 1.0], pieces, dt, n, start)

    def rate(t, y):
        return a @ y + np.array([0, 0, 0, force_at(pieces, t)]) / system.M[1, 1]

    times = dt * np.arange(n)
    assert moved == pytest.approx(integrated(rate, start, times, (0.33, 0.83)), abs=1e-9)
    ramp = ramp_and_release(system, [0.0, 1.0], 3.0, 0.7, times, [1.0, 0.0])

    def ramped(t, y):
        return a @ y + np.array([0, 0, 0, 3.0 * t if t < 0.7 else 0.0]) / system.M[1, 1]

    assert ramp == pytest.approx(integrated(ramped, np.zeros(4), times, (0.7,))[:, 0], abs=1e-9)
    s = np.array([3j, 1.0 + 5j])
    direct = [np.linalg.inv(x * x * system.M + x * system.C + system.K)[0, 1] for x in s]
    assert receptance(system, s, 0, 1) == pytest.approx(direct)
    assert modal_receptance(system, s, [1.0, 0.0], [0.0, 1.0]) == pytest.approx(direct)
    with pytest.raises(ValueError, match="as many links as masses"):
        chain([1.0], [0.1, 0.2], [1.0])


def test_a_beam_on_pins() -> None:
    beam = Beam(2.0, 3.0, 5.0)
    n = np.arange(1, 5)
    assert beam.natural_freq_rad(4) == pytest.approx((n * np.pi / 2) ** 2 * np.sqrt(5 / 3))
    assert beam.midspan_shapes(4) == pytest.approx(np.array([1, 0, -1, 0]) / np.sqrt(3.0), abs=1e-12)
    omega = 0.7 * beam.natural_freq_rad(1)[0]
    many = np.arange(1, 4001)
    own = (many * np.pi / 2) ** 2 * np.sqrt(5 / 3)
    assert beam.midspan_receptance(omega) == pytest.approx(
        np.sum(np.sin(many * np.pi / 2) ** 2 / 3 / (own**2 - omega**2))
    )
    system, middle = beam.elements(6)
    assert np.sqrt(sla.eigh(system.K, system.M, eigvals_only=True)[:2]) == pytest.approx(
        beam.natural_freq_rad(2), rel=2e-3
    )
    assert middle @ np.linalg.solve(system.K, middle) == pytest.approx(2.0**3 / 48 / 5)  # P L^3 / 48 EI
    with pytest.raises(ValueError, match="even number of elements"):
        beam.elements(5)


# updates


def test_names_orders_and_nodes_of_updates() -> None:
    rows = {
        P0: (1, 1, 1),
        P1: (2, 2, 1),
        P2: (4, 3, 2),
        P2_MIDSTEP: (4, 4, 1),
        TRAPEZOIDAL: (2, 2, 1),
        SIMPSON: (4, 3, 2),
    }
    for update, wanted in rows.items():
        assert (update.order, update.order_uneven, update.span) == wanted
    cubic = interpolatory(3, within=True)
    assert (cubic.name, cubic.order, cubic.span) == ("P3 mid-step", 4, 1)
    times = np.array([1.0, 4.0])
    assert P0.nodes(times).tolist() == [1.0]
    assert cubic.nodes(times).tolist() == [1.0, 2.0, 3.0, 4.0]
    assert P1.nodes(times).tolist() == [1.0, 4.0]
    for degree, weighted in ((-1, True), (0, False)):
        with pytest.raises(ValueError, match="the degree is"):
            Update("x", degree, weighted)
    nodes = np.array([0.0, 0.4, 1.0])
    assert np.array([Polynomial(row)(nodes) for row in lagrange(nodes)]) == pytest.approx(np.eye(3), abs=1e-12)


def test_updates_by_name_and_order() -> None:
    polynomial = [("P0", 1), ("P1", 2), ("P2", 4), ("P2 mid-step", 4)]
    others = [("P3", 4), ("P4", 6), ("P5", 6), ("P3 mid-step", 4), ("P4 mid-step", 6)]
    rules = [("Newton-Cotes 3", 4), ("Newton-Cotes 4", 6), ("Newton-Cotes 4 mid-step", 6)]
    sums = [("trapezoidal", 2), ("Simpson", 4), ("Simpson mid-step", 4)]
    assert [(u.name, u.order) for u in UPDATES] == [*polynomial, *sums, *others, *rules]


def test_kernels_are_integrals() -> None:
    """k1 = int e^(z (1 - s)) w(s) ds, k2 with w(s) (s - 1/2), by Gauss' rule."""
    x, weight = np.polynomial.legendre.leggauss(30)
    s, weight = 0.5 * (x + 1), 0.5 * weight
    for degree in (1, 2, 3):
        w = np.prod([s - c for c in np.linspace(0, 1, degree + 1)], axis=0)
        for z in (0.3, -2.0 + 1j):
            k1, k2 = estimates.kernels(degree, np.array([z]))
            flow = weight * np.exp(z * (1 - s))
            assert k1[0] == pytest.approx(np.sum(flow * w))
            assert k2[0] == pytest.approx(np.sum(flow * w * (s - 0.5)))


def test_estimated_errors_of_a_driven_mode() -> None:
    """Of P1 at steps of a thousandth: that of x' = lambda x + f, exact less piecewise linear."""
    pole, omega, dt, n = -0.5 + 3j, 2.0, 0.01, 400
    told = estimates.harmonic_error(P1, np.array([pole]), omega, dt, n)[:, 0]
    t = dt * np.arange(n)
    exact = (np.exp(1j * omega * t) - np.exp(pole * t)) / (1j * omega - pole)
    force, e, z = np.exp(1j * omega * t), np.exp(pole * dt), pole * dt
    first = dt * ((e * (z - 1) + 1) / z**2)
    last = dt * ((e - 1 - z) / z**2)
    y = np.zeros(n, complex)
    for k in range(n - 1):
        y[k + 1] = e * y[k] + first * force[k] + last * force[k + 1]
    assert np.abs(told - (exact - y)).max() < 2e-2 * np.abs(exact - y).max()
    basis = ModalBasis.real([3.0], [0.5], {"a": [2.0], "b": [0.5]})
    mode = estimates.sine_error(P1, basis, {"a": 3.0}, omega, dt, n, "b")
    up, down = (estimates.harmonic_error(P1, basis.poles, w, dt, n) for w in (omega, -omega))
    assert mode == pytest.approx((2 * 3.0 * (up - down) / 2j * basis.right[1] * basis.left[0]).sum(axis=1).real)
    with pytest.raises(ValueError, match="weighted updates of degree 1"):
        estimates.harmonic_error(P0, basis.poles, 1.0, 0.1, 3)
    with pytest.raises(ValueError, match="weighted updates of degree 1"):
        estimates.harmonic_error(TRAPEZOIDAL, basis.poles, 1.0, 0.1, 3)


@pytest.mark.parametrize(("method", "alpha"), [(AVERAGE_ACCELERATION, 0.0), (hht(-0.2), -0.2)])
def test_newmark_s_equations_hold_at_every_step(method, alpha) -> None:
    system, h, n = two(), 0.1, 6
    u, v = method.run(system, h, n, ([0.1, 0.0], [0.0, 0.2]), lambda t: [math.sin(t), 0.0])
    a = np.linalg.solve(system.M, np.zeros(2) - system.C @ v[0] - system.K @ u[0])
    beta, gamma = (1 - alpha) ** 2 / 4, 0.5 - alpha
    for k in range(n - 1):
        new = (v[k + 1] - v[k] - h * (1 - gamma) * a) / (h * gamma)
        assert u[k + 1] == pytest.approx(u[k] + h * v[k] + h * h * ((0.5 - beta) * a + beta * new))
        left = (
            system.M @ new
            + system.C @ ((1 + alpha) * v[k + 1] - alpha * v[k])
            + system.K @ ((1 + alpha) * u[k + 1] - alpha * u[k])
        )
        assert left == pytest.approx([math.sin((k + 1 + alpha) * h), 0.0], abs=1e-10)
        a = new
    for outside in (-0.34, 0.01):
        with pytest.raises(ValueError, match="alpha from -1/3 to 0"):
            hht(outside)
    assert hht(-1 / 3).name == "HHT-alpha (-0.333333)"


@pytest.mark.parametrize("update", [P0, P1, P2, P2_MIDSTEP, interpolatory(3)])
def test_a_transition_is_exact_for_forces_of_its_degree(update) -> None:
    system, dt = two(), 0.1
    p = Polynomial([1.0, -2.0, 3.0, 1.0][: update.degree + 1])
    count = 3 * update.span + 1
    found = Transition.of(system, update, dt).run(lambda t: np.stack([0 * t, p(t)], axis=1), count, [0.1, 0, 0, 0.2])
    a = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(system.M, system.K), -np.linalg.solve(system.M, system.C)]]
    )
    wanted = integrated(
        lambda t, y: a @ y + np.array([0, 0, 0, p(t) / system.M[1, 1]]),
        np.array([0.1, 0, 0, 0.2]),
        dt * update.span * np.arange(4),
    )
    assert found == pytest.approx(wanted, abs=1e-10)
    with pytest.raises(ValueError, match="weighted updates"):
        Transition.of(system, TRAPEZOIDAL, dt)


def test_pseudo_loads_of_proportional_damping_are_exact() -> None:
    """Without coupling, one shot and Picard's iteration give the motion under a force that is linear over each step."""
    system = chain([2.0, 1.0], [0.5, 0.3], [50.0, 30.0])
    system = Matrices(system.M, 0.01 * system.K, system.K)
    times, dt = 0.05 * np.arange(40), 0.05
    forces = np.stack([np.zeros(40), times], axis=1)
    a = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(system.M, system.K), -np.linalg.solve(system.M, system.C)]]
    )
    start = np.array([0.1, -0.1, 0.0, 0.3])
    wanted = integrated(lambda t, y: a @ y + np.array([0, 0, 0, t / system.M[1, 1]]), start, times)[:, :2]
    load = PseudoLoad.of(system)
    assert load.coupling == pytest.approx(np.zeros((2, 2)), abs=1e-12)
    assert load.one_shot(forces, dt, (start[:2], start[2:])) == pytest.approx(wanted, abs=1e-9)
    found, iterations = load.picard(forces, dt, (start[:2], start[2:]), window=7)
    assert found == pytest.approx(wanted, abs=1e-9)
    assert iterations == 2.0
    coupled = PseudoLoad.of(two())
    same, _ = coupled.picard(forces, dt, window=3)
    assert coupled.one_shot(forces, dt) == pytest.approx(same, abs=1e-10)
    shapes = reduction_shapes(two(), 1)
    small = reduced(two(), 1)
    assert pytest.approx(shapes.T @ two().C @ shapes) == small.C
    assert small.K[0, 0] == pytest.approx(sla.eigh(two().K, two().M, eigvals_only=True)[0])


def test_an_exact_string_and_its_assembled_sines() -> None:
    string = ExactString(0.6, 70.0, 5e-3, 1e-4, 0.4)
    assert string.fundamental == pytest.approx(np.sqrt(70 / 5e-3) / 1.2)
    assert string.impedance == pytest.approx(np.sqrt(0.35))
    assert string.held_freq(3) == pytest.approx(3 * string.fundamental * np.sqrt(1 + 9 * np.pi**2 * 1e-4 / 70 / 0.36))
    tuned = ExactString.tuned(4e-4, 0.65, 110.0, 0.5)
    assert tuned.fundamental == pytest.approx(110.0)
    assert tuned.linear_density == pytest.approx(1100 * np.pi * 1.6e-7)
    assert tuned.bending_stiffness == pytest.approx(7.4e9 * np.pi * 4e-4**4 / 4)
    body = Matrices(np.array([[2.0]]), np.array([[0.3]]), np.array([[900.0]]))
    system, force = string.assembled(4, body, np.array([1.0]), 0.2)
    # static: the end moved by d stretches as a straight line, T / L more stiffness
    assert system.K[4, 4] == pytest.approx(900 + 70 / 0.6)
    assert system.M[4, 4] == pytest.approx(2 + 5e-3 * 0.6 / 3)
    assert system.C[4, 4] - 0.3 == pytest.approx(0.8 * 5e-3 * 0.6 / 3)
    x = np.linspace(0, 0.6, 20001)
    product = np.trapezoid(5e-3 * (1 - x / 0.6) * np.sin(2 * np.pi * x / 0.6), x)
    assert system.M[1, 4] == system.M[4, 1] == pytest.approx(product, rel=1e-6)
    assert force == pytest.approx([*np.sin(np.arange(1, 5) * np.pi * 0.2), 0.8])


# rows, tables and reports


def test_errors_of_rows() -> None:
    poles = np.array([-1 + 10j, -2 + 20j])
    assert nearest(poles, -1 + 19j) == -2 + 20j
    assert pole_error(poles, np.array([-1 + 10j, -2 + 22j])) == pytest.approx(2 / abs(-2 + 22j))
    assert cents(2j, 1j) == pytest.approx(1200)
    assert halving_order(8.0, 2.0) == 2.0
    assert misfit([1.0, -3.0], [1.0, -4.0]) == 0.25
    assert not Row("s", "q", "r", 1.0, math.nan, 9.0).passed
    assert Row("s", "q", "r", -2.0, -1.0, 0.5, relative=True).error == 0.5
    assert validation.selected(["fabre_g", "klos", "fabre"])[:3] == ["fabre_guitar", "klosner", "fabre_forms"]
    for wrong in ("", "x"):
        with pytest.raises(TonewoodError, match="is '"):
            validation.selected([wrong])


def test_numbers_and_tables_as_text() -> None:
    assert [tables.number(x) for x in (None, math.inf, 0.0, 9.99e-4, 1e-3, 9999.0, 1e4)] == [
        "",
        "",
        "0",
        "1.0e-03",
        "0.001",
        "1e+04",
        "1.0e+04",
    ]
    assert tables.number(123.456, 4) == "123.5"
    assert tables.number(1e-9, 1) == "1e-09"
    text = tables.markdown(["a", "bbb"], [["long", "1"], ["x", "22"]])
    assert text.splitlines() == ["| a    | bbb |", "| ---- | --: |", "| long |   1 |", "| x    |  22 |"]
    shown = tables.terminal("t", list("abcdefg"), [(list("1234567"), "bold")], left=2)
    assert [column.justify for column in shown.columns] == ["left", "left", *["right"] * 4, "left"]
    assert [column.no_wrap for column in shown.columns] == [False, False, *[True] * 5]
    made, axes = figures.figure(2, 2, sharex=True)
    assert made.get_size_inches().tolist() == [9.0, 6.8]
    assert axes.shape == (2, 2)
    assert figures.figure(size=(3.0, 2.0), polar=True)[1].name == "polar"


def point(method, seconds, waveform, *, cents_=1.0, value="48 kHz", fs=48e3, dial="fs", stable="stable", lost=0):
    return Point(
        "s",
        method,
        dial,
        value,
        fs,
        10,
        stable,
        cents_worst=cents_,
        cents_20=cents_,
        decay_worst=0.1,
        waveform=waveform,
        seconds=seconds,
        seconds_low=0.9 * seconds,
        seconds_high=1.1 * seconds,
        lost=lost,
    )


@pytest.fixture
def study() -> Outcome:
    points = (
        point("tonewood", 0.01, 1e-2, cents_=0.5, value="24 kHz", fs=24e3),
        point("tonewood", 0.02, 1e-3, cents_=0.05),
        point("tonewood", 0.04, 1e-4, cents_=0.005, value="96 kHz", fs=96e3),
        point("tonewood", 0.015, 5e-3, cents_=0.2, value="strings solved 8 kHz", dial="freq"),
        point("verlet", 0.005, 2e-2, cents_=0.9),
        point("verlet", 0.1, 1e-4, cents_=0.1, fs=96e3),
        point("ab3", 0.2, 1e-2, lost=2),
        point("newmark", 0.01, 9.0, stable="grows"),
        point("superposition", 0.002, 1e-9, cents_=1e-9),
    )
    return Outcome("s", "A system", "truth", (PITCH, WAVEFORM), points)


def test_least_times_of_errors(study) -> None:
    """Between two points log time is straight in log error."""
    assert least_time.cheapest(study, WAVEFORM, 5e-3).value == "strings solved 8 kHz"
    assert least_time.cheapest(study, PITCH, 0.06).value == "48 kHz"
    assert least_time.cheapest(study, PITCH, 1e-3) is None
    share = math.log(2e-2 / 1e-3) / math.log(2e-2 / 1e-4)
    between = 0.005 * (0.1 / 0.005) ** share
    method, seconds = least_time.best_peer(study, WAVEFORM, 1e-3)
    assert (method, seconds) == ("verlet", pytest.approx(between))
    assert least_time.best_peer(study, WAVEFORM, 1e-5) is None
    assert least_time.floor(study) == 0.002
    (row,) = outcome.headlines(study.points, WAVEFORM)[:1]
    assert (row.method, row.error, row.best) == ("verlet", 1e-3, 1e-4)
    assert row.ratio == pytest.approx(between / 0.02)
    assert row.ratio_at_best == pytest.approx(0.1 / 0.04)
    texts = {h.method: h.text for h in outcome.headlines(study.points, PITCH)}
    assert texts == {"verlet": "not reached", "ab3": "partials lost", "newmark": "not stable", "superposition": "0.1"}
    quick = least_time.verlet_is_quicker_above(study)
    ours, theirs = (outcome.line(study.points, m, WAVEFORM) for m in ("tonewood", "verlet"))
    assert outcome.seconds_at(theirs, quick) < outcome.seconds_at(ours, quick)
    assert outcome.seconds_at(theirs, 0.8 * quick) > outcome.seconds_at(ours, 0.8 * quick)
    cells = [cell.strip() for cell in least_time.table([study], WAVEFORM).splitlines()[2].split("|")[1:-1]]
    assert cells[0] == "`s`"
    assert cells[1].startswith("24 kHz: 0.01 s; velocity Verlet ") or "0.5 x" in cells[1]
    assert cells[3].startswith("48 kHz: 0.02 s; ")
    assert cells[5] == "0.002 s"


def test_tables_of_a_study_have_its_points(study) -> None:
    rows = [[c.strip() for c in line.split("|")[1:-1]] for line in study_tables.point_table(study).splitlines()]
    head = dict(zip(rows[0], range(len(rows[0])), strict=True))
    assert "partials lost" in head
    assert "spectrum, dB" not in head
    ours, verlet = rows[3], rows[6]
    assert (ours[head["dial"]], ours[head["worst"]], ours[head["waveform"]], ours[head["ratio"]]) == (
        "48 kHz",
        "0.05",
        "0.001",
        "1",
    )
    assert ours[head["s per s"]] == "0.02 (0.018-0.022)"
    assert verlet[head["ratio"]] == "0.25"
    assert rows[8][head["partials lost"]] == "2"
    summary = [c.strip() for c in study_tables.summary_table([study]).splitlines()[2].split("|")[1:-1]]
    assert summary[:4] == ["`s`", "0.05", "0.001", "0.02"]
    plain = json.loads(json.dumps(study_tables.to_json(study), allow_nan=False))
    assert plain["points"][1]["seconds"] == 0.02
    assert plain["points"][1]["spectral_db"] is None
    assert [h["method"] for h in plain["headline"]] == ["verlet", "ab3", "newmark", "superposition"] * 2
    said = study_tables.headline(study).splitlines()
    assert len(said) == 2
    assert "tonewood at 48 kHz has 0.001" in said[1]
    assert "for 0.02 s per second of sound" in said[1]
    assert "partials lost: " in said[0]
    assert "not stable: " in said[0]
    machine = {"processor": "P", "system": "S", "instruction_set": "I", "fma_peak": 12.34e9}
    page = Study((study,), machine, True, {"more": ("## More", [1])})
    assert page.machine_line == "P, S, I, one core, measured peak 12.3 G multiply-adds/s"
    assert page.to_json()["more"] == [1]
    assert page.to_json()["quick"] is True
    assert "tonewood accuracy --quick --report" in page.markdown()
    assert "![Error against time" in page.markdown("a.png")
    assert _html("# A\n\n- b\n- c\n\n| d | e |\n| - | - |\n| 1 | 2 |") == (
        "<h1>A</h1>\n<ul><li>b</li><li>c</li></ul>\n"
        '<div class="scroll"><table><tr><th>d</th><th>e</th></tr><tr><td>1</td><td>2</td></tr></table></div>'
    )


def test_lost_partials_and_low_ones() -> None:
    true = np.array([-1 + 100j, -2 + 200j, -3 + 300j])
    found = np.array([-1.1 + 101j, -2 + 251j, -3.9 + 300j])
    errors = measures.pole_errors(found, true)
    first = 1200 * math.log2(1.01)
    assert (errors.lost, errors.cents_worst, errors.cents_median) == (1, pytest.approx(first), pytest.approx(first / 2))
    assert (errors.decay_worst, errors.decay_median) == (pytest.approx(0.3), pytest.approx(0.2))
    high = measures.pole_errors(found, true, np.array([20, 21, 22]))
    assert high.cents_20 == pytest.approx(first)
    assert np.isnan(measures.pole_errors(found, true, np.array([21, 22, 23])).cents_20)
    assert measures.pole_errors(found + 1e6j, true).lost == 3
    assert measures.energy_drift(np.array([2.0, 2.2, 1.5])) == 0.25


def test_tasks_are_timed_in_turn() -> None:
    called, told = [], []
    rows = [
        timing.Task(lambda: called.append("a"), 2.0, lambda: called.append("p")),
        timing.Task(lambda: called.append("b"), 1.0),
    ]
    found = timing.measure(rows, 2, told.append)
    assert "".join(called) == "pabpabpab"
    assert told == [0.5, 1.0]
    assert [t.repeats for t in found] == [2, 2]
    assert all(0 <= t.low <= t.median <= t.high for t in found)


@pytest.mark.parametrize(
    ("module", "part", "count"),
    [
        (chinnakonda, "_two_masses", 18),
        (chinnakonda, "_initial_conditions", 2),
        (chinnakonda, "_every_kind", 14),
        (chinnakonda, "_stiff", 12),
        (chinnakonda, "_alternatives", 10),
        (chinnakonda, "_estimates", 12),
        (chinnakonda, "_indices", 5),
        (klosner, "_printed_modes", 17),
        (klosner, "_beam", 8),
        (klosner, "_modes_needed", 3),
    ],
)
def test_rows_of_a_part_pass(module, part: str, count: int) -> None:
    rows = list(getattr(module, part)())
    assert [f"{row.quantity}: {row.value} for {row.reference}" for row in rows if not row.passed] == []
    assert len(rows) == count


@pytest.mark.parametrize(
    ("update", "c", "order"),
    [(P2, chinnakonda.LIGHT, 4), (interpolatory(4, within=True), chinnakonda.HEAVY, 6), (P1, chinnakonda.HEAVY, 2)],
)
def test_orders_of_updates(update: Update, c: float, order: int) -> None:
    assert chinnakonda.measured_order(update, c) == pytest.approx(order, abs=0.03)


@pytest.mark.parametrize(("off", "failed"), [(0.04, 0), (0.06, 20), (0.24, 20), (0.26, 30)])
def test_orders_may_be_off_by_a_little(monkeypatch, off: float, failed: int) -> None:
    """A quarter for orders above 4, of which there are five."""
    monkeypatch.setattr(chinnakonda, "measured_order", lambda update, c: update.order + off)
    rows = list(chinnakonda._orders())
    assert (len(rows), sum(not row.passed for row in rows)) == (30, failed)
    assert [row.quantity for row in rows if "thesis reads 3" in row.source] == ["P2, very heavy damping"]


def test_rows_of_motions_pass(monkeypatch) -> None:
    problem_b = replace(klosner.problem_b(), duration=0.2)
    monkeypatch.setattr(klosner, "problems", lambda: (replace(klosner.problem_a(), duration=0.2), problem_b))
    monkeypatch.setattr(klosner, "energy_drift", lambda form: 1.01e-10 * (form == "fixed-base"))
    monkeypatch.setattr(klosner, "_printed_modes", lambda: iter(()))
    monkeypatch.setattr(klosner, "_beam", lambda: iter(()))
    monkeypatch.setattr(klosner, "_modes_needed", lambda: iter(()))
    rows = list(klosner.rows())
    assert [row.quantity for row in rows if not row.passed] == ["energy drift without dashpots in 20 s, fixed-base"]
    assert [row.system for row in rows] == ["klosner A"] * 12 + ["klosner B"] * 10


def test_a_beam_and_its_chain_have_the_frequencies_of_the_closed_form() -> None:
    exact = klosner.exact_frequencies(2)
    for form in klosner.FORMS:
        assert klosner.coupled_frequencies(form, 40, 2) == pytest.approx(exact, rel=2e-4)


# the study


def test_a_period_is_the_shift_that_meets_the_motion() -> None:
    t = np.arange(4000) / 8000
    y = np.sin(2 * np.pi * 100.05 * t) + 0.3 * np.cos(2 * np.pi * 300.15 * t)
    assert study_.measured_period(y, 8000, 100.0, 40) == pytest.approx(1 / 100.05, rel=1e-7)


def two_modes() -> Problem:
    parts = {
        "body": ModalBasis.real([300.0], [1.0], {"p": [1.0]}),
        "string": ModalBasis.real([2000.0, 9e4], [2.0, 3.0], {"p": [1.0, 2.0]}),
    }
    return Problem(parts, (), (Term("string", "p"),), (Term("string", "p"),))


def test_modes_are_dropped_with_or_without_their_compliance() -> None:
    """Those above 10 kHz; a quarter of the static compliance at 90000 rad/s is 4 / 90000^2."""
    problem = two_modes()
    for fold, left in ((True, 4 / 9e4**2), (False, 0.0)):
        cut = study_._cut(problem, 1e4, fold).components
        assert cut["string"].n_modes == 1
        assert cut["string"].residual[0, 0] == pytest.approx(left, rel=1e-3)
        assert cut["body"] is problem.components["body"]
    other = study_.exchanged(problem, "string", problem.components["body"])
    assert other.components["string"] is problem.components["body"]
    assert other.inputs == problem.inputs
    assert study_.lowest_rate(problem, 0.5) == pytest.approx(9e4 / 0.5, rel=1e-3)


def test_dials_of_a_study(monkeypatch) -> None:
    made = []
    monkeypatch.setattr(study_, "own_point", lambda case, fs, **more: made.append((fs, more)))
    monkeypatch.setattr(study_, "_cut", lambda problem, freq, fold: (freq, fold))
    monkeypatch.setattr(
        study_, "sliding_string", lambda string, freq, residual: SimpleNamespace(with_places=lambda p: residual)
    )
    monkeypatch.setattr(study_, "exchanged", lambda problem, name, basis: (name, basis))
    places = SimpleNamespace(places={"pluck": 0.1})
    case = SimpleNamespace(problem=lambda freq=None: freq or SimpleNamespace(components={"string": places}), string="s")
    for make in study_._dials(case, quick=False):
        make()
    assert {fs for fs, _ in made} == {48e3}
    assert [(m["dial"], m["value"], m["problem"]) for _, m in made] == [
        ("modes", "strings solved to 2.5 kHz", 2.5e3),
        ("modes", "strings solved to 5 kHz", 5e3),
        ("modes", "strings solved to 10 kHz", 10e3),
        ("modes", "strings solved to 15 kHz", 15e3),
        ("residual", "string modes above 10 kHz dropped, with their compliance", (10e3, True)),
        ("residual", "string modes above 10 kHz dropped, without their compliance", (10e3, False)),
        ("basis", "sliding cosines, with residual compliance", ("string", True)),
        ("basis", "sliding cosines, without residual compliance", ("string", False)),
    ]
    made.clear()
    for make in study_._dials(SimpleNamespace(problem=case.problem, string=None), quick=True):
        make()
    assert [m["value"] for _, m in made][:2] == ["strings solved to 5 kHz", "strings solved to 10 kHz"]
    assert len(made) == 4


def test_limits_of_stability_lie_between_the_rates() -> None:
    """Verlet on one undamped mode: omega h = 2."""
    oscillator = fabre_methods.free_oscillator(1000.0)
    verlet = METHODS["verlet"]
    assert stability_limit(verlet, oscillator, 300.0, 5000.0) == pytest.approx(500.0, rel=2e-4)
    for low, high in ((600.0, 5000.0), (300.0, 400.0)):
        with pytest.raises(ValueError, match=f"no limit of stability between {low:g} and {high:g} Hz"):
            stability_limit(verlet, oscillator, low, high)
    assert fabre_methods.lowest_ab3_rate(np.array([1000j])) == pytest.approx(1000 / ((5 + 5**0.5) / 10), rel=2e-3)


def test_heads_and_sentences_of_least_times(study) -> None:
    pitch = [cell.strip() for cell in least_time.table([study], PITCH).splitlines()[0].split("|")[1:-1]]
    assert pitch == ["system", "10 cent", "1 cent", "0.1 cent", "0.01 cent", "superposition"]
    wave = [cell.strip() for cell in least_time.table([study], WAVEFORM).splitlines()[0].split("|")[1:-1]]
    assert wave[1:5] == ["10 %", "1 %", "0.1 %", "0.01 %"]
    said = least_time.sentences([study])
    assert "costs 0.01 to 0.01 s of computing" in said
    assert "the best other method takes 0.5 to 0.5 times as long" in said
    assert "takes 0.2 to 0.2 times that" in said
    rising = Outcome("tension", "t", "r", (WAVEFORM,), study.points)
    assert "velocity Verlet is the quicker one for errors above" in least_time.sentences([rising])


def test_the_machine_is_named(monkeypatch, tmp_path) -> None:
    info = tmp_path / "cpuinfo"
    info.write_text("vendor\t: V\nmodel name\t: A: B\nmodel name\t: C\n")
    monkeypatch.setattr(timing, "Path", lambda name: info if name == "/proc/cpuinfo" else None)
    monkeypatch.setattr(timing._kernel, "fma_peak", lambda isa, seconds: (isa, seconds))
    monkeypatch.setattr(timing, "instruction_set", lambda: "avx2")
    monkeypatch.setattr(timing.platform, "processor", lambda: "")
    monkeypatch.setattr(timing.platform, "machine", lambda: "x86")
    monkeypatch.setattr(timing.platform, "system", lambda: "OS")
    named = {"processor": "A: B", "system": "OS x86", "instruction_set": "avx2", "fma_peak": ("avx2", 0.1)}
    assert timing.machine() == named
    info.write_text("vendor\t: V\n")
    assert timing.machine()["processor"] == "x86"
    info.unlink()
    monkeypatch.setattr(timing.platform, "processor", lambda: "P")
    assert timing.machine()["processor"] == "P"


@pytest.mark.parametrize(("cents", "verdict"), [(0.0099, "confirmed"), (0.0101, "refuted")])
def test_what_was_expected_of_a_guitar(cents: float, verdict: str) -> None:
    points = (
        point("tonewood", 0.02, 1e-3, cents_=cents),
        replace(point("ab3", 0.2, 1e-2, fs=700e3, stable="NaN"), decay_median=0.5),
        replace(point("ab3", 0.2, 1e-2, fs=1200e3), decay_median=0.2),
        replace(point("ab3", 0.2, 1e-2, fs=816e3), decay_median=0.03),
    )
    said = study_tables.expectation(Outcome("s", "A system", "truth", (PITCH,), points))
    assert said.startswith(f"**Expected** of A system: below {study_tables.EXPECTED_CENTS} cent")
    assert f"cent at 48 kHz, {verdict}. " in said
    assert "from 816 kHz (decay rates 3 % off there)" in said
    assert "at none of its rates" in said
    assert study_tables.expectation(Outcome("s", "A", "t", (PITCH,), points[1:])) == ""
