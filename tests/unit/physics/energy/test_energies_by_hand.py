"""Energies of connections, losses, sound and traces, each against its formula written out here."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest

from tonewood.physics.coupling.connections import Connection, Rigid, SpringDashpot, Term
from tonewood.physics.coupling.laws import Contact, Friction, HardeningSpring
from tonewood.physics.coupling.potentials.tension import TensionModulation
from tonewood.physics.coupling.system import Drive, System
from tonewood.physics.energy.account import EnergyAccount
from tonewood.physics.energy.forms import ComponentEnergy
from tonewood.physics.energy.laws import LawEnergies
from tonewood.physics.energy.steps import KnownForce, _by_step, _edges, _on_interval, over_steps
from tonewood.physics.energy.stored import gaps, stored_energy
from tonewood.physics.energy.trace import EnergyTrace
from tonewood.physics.modal.modes import ModalBasis
from tonewood.physics.passivity.storage import storage_matrix
from tonewood.physics.stepping.forcing import SampledForce, Segment
from tonewood.physics.stepping.motion import from_motion
from tonewood.physics.stepping.stepper import NumpyStepper

DT = 1e-4
R = 2e-9


def oscillator(residual: float = 0.0, freq_rad: float = 500.0, mass: float = 0.25) -> ModalBasis:
    return ModalBasis.real([freq_rad], [3.0], {"p": [1.0]}, modal_mass=mass, residual=[[residual]])


def law_system() -> System:
    """Each connection holds an oscillator of its own, so that its gap and its residual compliance are its own."""
    laws = {
        "spring": SpringDashpot(800.0, 0.3, 1e-5),
        "dashpot": SpringDashpot(0.0, 0.7),
        "alone": SpringDashpot(50.0),
        "joint": Rigid(2e-5),
        "stiff": Rigid(3e-5),
        "contact": Contact(1e7, 2.0, 0.5, 1e-5),
        "hard": HardeningSpring(2e3, 1e10, 0.2, 3.0, 1e-4, residual=False),
        "bow": Friction(0.8, 0.7, 0.3, 0.1, 0.15),
    }
    parts = {name: oscillator(0.0 if name == "stiff" else R) for name in laws}
    return System.build(parts, [Connection(n, (Term(n, "p"),), law) for n, law in laws.items()], dt=DT)


def test_energies_of_each_law_over_steps_are_its_formulas() -> None:
    system, rng, T = law_system(), np.random.default_rng(2), 4
    places = system.layout.places
    energies, g, f = LawEnergies(system), rng.normal(size=(T + 1, 8)) * 2e-5, rng.normal(size=(T, 8))
    start = np.zeros(8)
    start[places["contact"]] = 3e-7
    g[[1, 2], places["contact"]] = 5e-5, 6e-5  # open at both ends of one step
    theta = 1 / (1 + np.exp(-4e3 * DT))
    rho = [3e-7]
    for step in range(T):
        rho.append((R * f[step, places["contact"]] - (1 - theta) * rho[-1]) / theta)
    series = energies.series(start, f)
    np.testing.assert_allclose(series[:, 0], rho, rtol=1e-12)
    assert not series[:, 1:].any()
    assert np.flatnonzero(energies.spread(series[-1])).tolist() == [places["contact"]]

    begin, end = np.array([1.0, 1.3, 1.2, 0.9]) * 1e-4, np.array([1.1, 1.4, 1.0, 1.2]) * 1e-4
    scale, speed = np.array([1.0, 0.5, 2.0, 1.5]), np.array([0.1, -0.2, 0.3, 0.0])
    ones, nothing = np.ones(T), np.zeros(T)
    moving = {1: np.stack([begin, end, nothing, scale]), 2: np.stack([nothing, nothing, speed, ones])}
    assert energies.moved(moving) == ["hard"]
    flows = energies.over(g, series, f, moving)
    gap = {name: g[:, i] for name, i in places.items()}
    force = {name: f[:, i] for name, i in places.items()}

    def step_of(x: np.ndarray) -> np.ndarray:
        return x[1:] - x[:-1]

    def U(p: np.ndarray | float) -> np.ndarray:
        return 1e7 / 3 * np.maximum(p, 0.0) ** 3

    def V(p: np.ndarray | float) -> np.ndarray:
        return 1e3 * np.square(p) + 0.25e10 * np.square(p) ** 2

    p = 1e-5 - gap["contact"] - np.array(rho)
    old, new = begin - gap["hard"][:-1], end - gap["hard"][1:]
    before, after = scale * (V(old) - V(1e-4)), scale * (V(new) - V(1e-4))
    rate = (new - old) / DT
    stored = {
        "spring": 400.0 / (1 + 800.0 * R) * (gap["spring"] - 1e-5) ** 2,
        "alone": 25.0 / (1 + 50.0 * R) * gap["alone"] ** 2,
        "joint": (gap["joint"] - 2e-5) ** 2 / (2 * R),
        "contact": U(p) - U(1e-5) + np.square(rho) / (2 * R),
        "hard": np.concatenate([before[:1], after]),
    }
    lost = {
        "spring": 0.3 / (1 + 800.0 * R) ** 2 * step_of(gap["spring"]) ** 2 / DT,
        "dashpot": 0.7 * step_of(gap["dashpot"]) ** 2 / DT,
        "contact": 0.5 * step_of(U(p)) * step_of(p) / DT + (theta - 0.5) * np.diff(rho) ** 2 / R,
        "hard": scale * (0.2 + 3.0 * np.abs(rate)) * rate * (new - old),
        "bow": np.abs(force["bow"] * (step_of(gap["bow"]) - speed * DT)),
    }
    supplied = {
        "hard": force["hard"] * (end - begin) + np.concatenate([[0.0], before[1:] - after[:-1]]),
        "bow": force["bow"] * speed * DT,
    }
    for which, expected in ((flows.stored, stored), (flows.lost, lost), (flows.supplied, supplied)):
        assert set(which) == set(expected)
        for name, values in expected.items():
            np.testing.assert_allclose(which[name], values, rtol=1e-8, atol=1e-16, err_msg=name)
    at = energies.at(g[0], start)
    assert at["hard"] == pytest.approx(V(1e-4 - gap["hard"][0]) - V(1e-4), rel=1e-9)
    assert at["contact"] == pytest.approx(stored["contact"][0], rel=1e-9)
    assert energies.over(g, series, f, {}).supplied["bow"] == pytest.approx(force["bow"] * 0.15 * DT, rel=1e-12)
    still = energies.over(g, series, f, {})
    assert set(still.supplied) == {"bow"}
    assert still.stored["hard"] == pytest.approx(V(1e-4 - gap["hard"]) - V(1e-4), rel=1e-9)


def test_stored_energy_is_the_sum_of_its_formulas() -> None:
    """Modes v^2/2 + (omega q)^2/2, springs, compliance in series, a tension; a microphone's is not counted."""
    tension = TensionModulation("E", ("a",), 2e4, 0.65, {"a": np.array([40.0])})
    links = [
        Connection("joint", (Term("a", "p"), Term("b", "p", -2.0)), Rigid(1e-5)),
        Connection("spring", (Term("b", "p"),), SpringDashpot(700.0, 1.0, -4e-5)),
        Connection("contact", (Term("c", "p"),), Contact(1e7, 2.0, 0.5, 5e-5)),
        Connection("bow", (Term("c", "p", 2.0),), Friction(1.0)),
    ]
    parts = {"a": oscillator(R, 300.0, 1.0), "b": oscillator(3 * R), "c": oscillator(R, 900.0), "mic": oscillator()}
    system = System.build(parts, links, dt=DT, drives=[Drive("mic", "p", "joint")], potentials=[tension])
    state, motion = system.start(), {"a": (2e-4, 0.3), "b": (-1e-4, 0.2), "c": (1.5e-5, -0.4), "mic": (1.0, 1.0)}
    for name, (q, v) in motion.items():
        system.modes_of(state, name)[:] = from_motion(parts[name], np.array([q]), np.array([v]))
    at = system.layout.places["contact"]
    state.series[at] = 2e-6
    y = {name: q / np.sqrt(1.0 if name == "a" else 0.25) for name, (q, _) in motion.items()}
    expected_gaps = [y["a"] - 2 * y["b"], y["b"], y["c"], 2 * y["c"]]
    np.testing.assert_allclose(gaps(system, state), expected_gaps, rtol=1e-12)
    energy = stored_energy(system, state)
    omega = {"a": 300.0, "b": 500.0, "c": 900.0}
    modes = sum(0.5 * (motion[n][1] ** 2 + (omega[n] * motion[n][0]) ** 2) for n in omega)
    springs = 350.0 / (1 + 700.0 * 3 * R) * (y["b"] + 4e-5) ** 2 + 1e7 / 3 * (5e-5 - y["c"] - 2e-6) ** 3
    residual = (expected_gaps[0] - 1e-5) ** 2 / (2 * (R + 4 * 3 * R)) + (2e-6) ** 2 / (2 * R)
    stretch = 0.5 * (2e4 / (4 * 0.65)) * (40.0 * 2e-4**2) ** 2
    assert energy.modes == pytest.approx(modes, rel=1e-12)
    assert energy.connections == pytest.approx(springs, rel=1e-12)
    assert energy.residual == pytest.approx(residual, rel=1e-12)
    assert energy.potentials == pytest.approx(stretch, rel=1e-12)
    assert energy.total == pytest.approx(modes + springs + residual + stretch, rel=1e-12)
    account = EnergyAccount(system, state).stored(state)
    assert set(account) == {"a", "b", "c", "E.tension", "joint", "spring", "contact"}
    assert account["E.tension"] == pytest.approx(stretch, rel=1e-12)
    assert stored_energy(system.with_potentials([]), state).potentials == 0.0


def test_energy_of_complex_modes_is_refused() -> None:
    basis = ModalBasis.complex([-5 + 100j], {"p": [1 + 0.2j]})
    system = System.build({"body": basis}, dt=DT)
    with pytest.raises(ValueError, match="the modes of body are not real"):
        stored_energy(system, system.start())
    with pytest.raises(ValueError, match="needs a storage function"):
        ComponentEnergy(basis, ["p"], DT)


@pytest.mark.parametrize("which", ["right", "left"])
def test_storage_of_a_real_pole_with_complex_shapes_is_refused(which: str) -> None:
    basis = ModalBasis.complex([-50.0], {"p": [1.0]}, {"p": [0.5]})
    storage = storage_matrix(basis.poles, basis.right, basis.left)
    turned = replace(basis, **{which: getattr(basis, which) * np.exp(0.1j)})
    with pytest.raises(ValueError, match="shapes of real poles must be real"):
        ComponentEnergy(turned, ["p"], DT, storage)
    with pytest.raises(ValueError, match="stepped as blocks"):
        ComponentEnergy(ModalBasis.real([0.0], [1.0], {"p": [1.0]}), ["p"], DT, storage)


def test_a_massless_spring_with_its_dashpot_loses_as_the_closed_form() -> None:
    """c y' + k y = f: y' = -(k/c) (y0 - f/k) exp(-k t / c); energy k y^2 / 2, loss c y'^2."""
    k, c, y, f, d = 700.0, 0.05, np.array([2e-4, -1e-4]), np.array([0.4, 0.0]), 3e-4
    basis = ModalBasis.complex([-k / c], {"p": [1.0], "r": [2.0]}, {"p": [1 / c], "r": [2 / c]})
    energy = ComponentEnergy(basis, ["p", "r"], DT, storage_matrix(basis.poles, basis.right, basis.left))
    forms = energy.forms(d)
    x = np.stack([y, np.zeros(2)], axis=1)[:, None]
    s = energy.start(x, np.stack([np.zeros(2), 0.5 * f], axis=1)[:, :, None])
    apart, share = y - f / k, np.exp(-k * d / c)
    assert energy.stored(x) == pytest.approx(0.5 * k * y**2, rel=1e-12)
    assert energy.lost(forms, s) == pytest.approx(0.5 * k * apart**2 * (1 - share**2), rel=1e-10)
    assert energy.flow(forms, s)[:, 0, 0] == pytest.approx(f / k + apart * share, rel=1e-10)
    assert energy.moments(forms, s, "p")[:, 0] == pytest.approx(apart * (share - 1), rel=1e-10)
    assert energy.moments(forms, s, "r")[:, 0] == pytest.approx(2 * apart * (share - 1), rel=1e-10)


def radiating(shares: list[float]) -> ModalBasis:
    metadata = {"radiated": np.array(shares)}
    return ModalBasis.real([0.0, 400.0, 900.0], [2.0, 3.0, 5.0], {"p": [1.0, 2.0, -1.0]}, metadata=metadata)


def test_sound_is_each_modes_share_of_its_loss() -> None:
    basis, shares = radiating([0.0, 0.25, 0.9]), np.array([0.0, 0.25, 0.9])
    energy, rng = ComponentEnergy(basis, ["p"], DT), np.random.default_rng(5)
    x, force = rng.normal(size=(2, 3, 2)), rng.normal(size=(2, 1))
    lost, sound, _ = over_steps(energy, x, force, None, [], 0, DT)
    silent = replace(basis, metadata={})
    alone = [
        over_steps(ComponentEnergy(silent.select(np.array([k])), ["p"], DT), x[:, [k]], force, None, [], 0, DT)
        for k in range(3)
    ]
    assert not alone[0][1].any()
    np.testing.assert_allclose(lost, sum(a[0] for a in alone), rtol=1e-12)
    np.testing.assert_allclose(sound, sum(s * a[0] for s, a in zip(shares, alone, strict=True)), rtol=1e-12)
    system = System.build({"body": basis}, dt=DT)
    account, state = EnergyAccount(system, system.start(), 2), system.start()
    system.modes_of(state, "body")[:] = x[0].T
    account.book_change("struck", state)
    before = state.copy()
    account.follow(before, state, NumpyStepper(system).run(state, 4)[1])
    trace = account.trace()
    assert set(trace.lost) == {"body", "body.sound"}
    assert trace.worst_residual < 1e-12
    assert trace.booked["struck"].tolist() == [pytest.approx(energy.stored(x[:1])[0], rel=1e-12), 0.0]
    forms = energy.forms(4 * DT)
    s = energy.start(x[:1], np.zeros((1, 1, 1)))
    assert trace.lost["body.sound"].sum() == pytest.approx(energy.sound(forms, s)[0], rel=1e-9)
    assert trace.lost["body"].sum() == pytest.approx((energy.lost(forms, s) - energy.sound(forms, s))[0], rel=1e-9)
    with pytest.raises(ValueError, match="radiated of a basis of 3 modes has 2 shares"):
        ComponentEnergy(radiating([0.0, 1.0]), ["p"], DT)


def test_a_component_without_stepped_modes_loses_nothing() -> None:
    force = KnownForce("push", "c", "p", (Segment(0.0, 1.0, 3.0),))
    energy = ComponentEnergy(ModalBasis.real([], [], {"p": []}), ["p"], DT)
    lost, sound, works = over_steps(energy, np.zeros((3, 0, 2)), np.ones((3, 1)), None, [force], 0, DT)
    assert [lost.tolist(), sound.tolist(), *(w.tolist() for w in works)] == [[0.0] * 3] * 3


def test_work_of_forces_that_meet_within_steps_is_that_of_the_motion() -> None:
    """A free mass of 0.5 kg: work of each force is the integral of force times velocity, on a fine grid."""
    basis, steps = ModalBasis.real([0.0], [0.0], {"p": [1.0], "r": [-2.0]}, modal_mass=0.5), 12
    one = KnownForce("one", "m", "p", (Segment(0.0, 3.3e-4, 2.0, 1e4), Segment(3.3e-4, 5e-4, 5.0)), 1.5e-4, -0.5)
    two = KnownForce("two", "m", "r", (Segment(1e-4, 8.7e-4, 1.0, 0.0, 3e6),), 0.2e-4)
    noise = KnownForce("noise", "m", "p", SampledForce(0.0, DT, np.array([0.0, 1.0, -2.0, 3.0, 0.0])), 3e-4, 0.7)
    energy, known = ComponentEnergy(basis, ["p", "r"], DT), [one, two, noise]
    n = 120000
    t = (np.arange(n) + 0.5) * (steps * DT / n)
    held = np.array([0.3, -0.1])

    def value(force: KnownForce) -> np.ndarray:
        since = t - force.time
        if isinstance(force.pieces, SampledForce):
            middle = (np.floor(t / DT) + 0.5) * DT - force.time
            return force.factor * np.interp(middle, np.arange(5) * DT, force.pieces.values, left=0.0, right=0.0)
        total = np.zeros(n)
        for s in force.pieces:
            u = since - s.start
            total += np.where((since >= s.start) & (since < s.stop), s.c0 + u * (s.c1 + u * s.c2), 0.0)
        return force.factor * total

    forces = [value(k) for k in known]
    modal = held[0] - 2 * held[1] + forces[0] - 2 * forces[1] + forces[2]
    speed = (np.cumsum(modal) - 0.5 * modal) * (t[1] - t[0]) / 0.5 + 0.1
    expected = [np.sum(f * speed * factor) * (t[1] - t[0]) for f, factor in zip(forces, (1, -2, 1), strict=True)]
    x, rows = np.zeros((steps, 1, 2)), np.tile(held, (steps, 1))
    begin = np.concatenate([[0.1], speed.reshape(steps, -1)[:, -1]])[:-1]
    path = np.concatenate([[0.0], np.cumsum(speed.reshape(steps, -1).sum(axis=1) * (t[1] - t[0]))])[:-1]
    root = np.sqrt(0.5)
    x[:, 0] = from_motion(basis, (path * root)[None], (begin * root)[None])[:, 0].T
    works = over_steps(energy, x, rows, None, known, 0, DT)[2]
    assert [w.sum() for w in works] == pytest.approx(expected, rel=1e-3)
    for w, f, factor in zip(works, forces, (1, -2, 1), strict=True):
        each = (f * speed * factor).reshape(steps, -1).sum(axis=1) * (t[1] - t[0])
        np.testing.assert_allclose(w, each, rtol=2e-3, atol=2e-3 * np.abs(each).max())


@pytest.mark.parametrize(
    ("start", "stop", "values", "broken"),
    [
        (2.0, 4.0, [0, 0, 7, 7, 0, 0], []),
        (2.5, 4.0, [0, 0, None, 7, 0, 0], [2]),
        (2.0, 4.5, [0, 0, 7, 7, None, 0], [4]),
        (-3.0, 1.0, [7, 0, 0, 0, 0, 0], []),
        (-3.0, 0.0, [0] * 6, []),
        (-3.0, 0.5, [None, 0, 0, 0, 0, 0], [0]),
        (5.0, 9.0, [0] * 5 + [7], []),
        (5.5, 9.0, [0] * 5 + [None], [5]),
        (6.0, 9.0, [0] * 6, []),
        (2.0, 2.0, [0] * 6, []),
        (2.25, 2.75, [0, 0, None, 0, 0, 0], [2]),
    ],
)
def test_a_force_over_six_steps_fills_those_that_it_covers(
    start: float, stop: float, values: list[float | None], broken: list[int]
) -> None:
    """Times in steps; a step is a power of two, so that their quotients are exact."""
    dt = 2.0**-13
    force = KnownForce("f", "c", "p", (Segment(start * dt, stop * dt, 7.0),))
    steps = _by_step(force, 0, 6, dt)
    assert np.flatnonzero(np.isnan(steps[:, 0])).tolist() == broken
    assert [None if np.isnan(v) else v for v in steps[:, 0]] == values
    assert _edges(force, 1, dt) == [start - 1, stop - 1]
    assert _edges(KnownForce("f", "c", "p", SampledForce(0.0, dt, np.zeros(3))), 1, dt) == []
    assert _on_interval(force, 8, 0.0, 1.0, dt).tolist() == ([7.0, 0, 0] if stop == 9.0 else [0, 0, 0])


def trace() -> EnergyTrace:
    return EnergyTrace(
        time=np.array([0.02, 0.04, 0.05]),
        steps=np.array([20, 20, 10], dtype=np.int64),
        dt=1e-3,
        initial={"a": 0.5, "b": 0.25},
        stored={"a": np.array([2.0, 1.0, 0.5]), "b": np.array([4.0, 3.0, 0.0])},
        supplied={"pluck": np.array([7.0, 1.0, 0.0]), "bow": np.array([1.0, 1.0, 0.5])},
        booked={"bend": np.array([0.0, -1.0, 0.25])},
        lost={"a": np.array([2.0, 3.0, 1.5]), "b": np.array([1.0, 0.5, 0.0])},
        residual=np.array([0.03, 0.06, -0.12]),
    )


def still_trace() -> EnergyTrace:
    """Nothing is stored, and the balance is open by 1 J."""
    return EnergyTrace(np.ones(1), np.ones(1, dtype=np.int64), 1e-3, {}, {}, {}, {}, {}, np.ones(1))


def test_numbers_of_a_trace_are_sums_of_its_columns() -> None:
    t = trace()
    assert t.total.tolist() == [6.0, 4.0, 0.5]
    assert t.peak == 6.0
    assert t.power_in == pytest.approx([8 / 0.02, 1 / 0.02, 0.75 / 0.01])
    assert t.power_lost == pytest.approx([3 / 0.02, 3.5 / 0.02, 1.5 / 0.01])
    assert t.worst_residual == pytest.approx(0.02)
    assert t.worst_cumulative_residual == pytest.approx(0.015)
    shares = {"worst_residual": pytest.approx(0.02), "worst_cumulative_residual": pytest.approx(0.015)}
    assert t.balance() == {"peak_J": 6.0, **shares}
    assert t.to_dict() == {
        "schema": "tonewood-energy/1", "unit": "J", "dt": 1e-3, "time": [0.02, 0.04, 0.05], "steps": [20, 20, 10],
        "initial": {"a": 0.5, "b": 0.25}, "stored": {"a": [2.0, 1.0, 0.5], "b": [4.0, 3.0, 0.0]},
        "supplied": {"pluck": [7.0, 1.0, 0.0], "bow": [1.0, 1.0, 0.5]}, "booked": {"bend": [0.0, -1.0, 0.25]},
        "lost": {"a": [2.0, 3.0, 1.5], "b": [1.0, 0.5, 0.0]}, "power_in": t.power_in.tolist(),
        "power_lost": t.power_lost.tolist(), "residual": [0.03, 0.06, -0.12], "peak": 6.0, **shares,
    }  # fmt: skip
    none, rows = np.zeros(0), np.zeros(0, dtype=np.int64)
    empty = EnergyTrace(none, rows, 1e-3, {"a": 2.0, "b": 1.0}, {}, {}, {}, {}, none)
    assert (empty.peak, empty.worst_residual, empty.worst_cumulative_residual) == (3.0, 0.0, 0.0)
    still = still_trace()
    assert (still.peak, still.worst_residual, still.worst_cumulative_residual) == (0.0, 0.0, 0.0)


@pytest.mark.filterwarnings("ignore:Data has no positive values", "ignore:overflow encountered")  # of nothing stored
def test_picture_of_a_trace_shows_its_columns(monkeypatch) -> None:
    from tonewood.support import plotting

    drawn, original = [], plotting.figure
    monkeypatch.setattr(plotting, "figure", lambda *a, **k: drawn.append(original(*a, **k)) or drawn[-1])
    monkeypatch.setattr(plotting._figure_class(), "savefig", lambda self, file, **options: file.write(b"saved"))
    t, stream = trace(), io.BytesIO()
    t.plot(stream)
    assert stream.getvalue() == b"saved"
    above, middle, below = drawn[0][1][:, 0]
    by_label = [{line.get_label(): line for line in axes.lines} for axes in (above, middle, below)]
    expected = [
        {"b": t.stored["b"], "a": t.stored["a"], "all": [6.0, 4.0, 0.5]},
        {"put in": [400.0, 50.0, 75.0], "dissipated": [150.0, 175.0, 150.0]},
        {"each interval": [0.005, 0.01, 0.02], "summed up": [0.005, 0.015, 0.005]},
    ]
    for lines, columns in zip(by_label, expected, strict=True):
        assert list(lines) == list(columns)  # the component with most energy first
        for label, y in columns.items():
            assert lines[label].get_xdata() == pytest.approx(t.time)
            assert lines[label].get_ydata() == pytest.approx(y)
    assert above.get_ylim() == pytest.approx((6e-9, 12.0))
    assert middle.yaxis.get_transform().linthresh == pytest.approx(0.175)
    still_trace().plot(stream)
    assert [line.get_ydata().tolist() for line in drawn[1][1][2, 0].lines] == [[1.0], [1.0]]
    assert [axes.get_yscale() for axes in (above, middle, below)] == ["log", "symlog", "log"]
