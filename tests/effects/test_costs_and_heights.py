"""Rates of costs, switches and heights of sidebands against general methods, closed forms and sums by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from effect_scenes import FS, duet, tension_effect
from scipy.optimize import nnls

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects.base import Moment, Switching, Watched
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.costs import Costs
from tonewood.performance.effects.sidebands import Plane
from tonewood.performance.effects.switching import motion, switch
from tonewood.physics.coupling.potentials.tension import stretch_weights
from tonewood.physics.modal.held_modes import HeldModes


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(duet(mode="auto"), FS)


@pytest.mark.parametrize("seed", range(3))
def test_rates_are_the_least_squares_of_all_runs(seed: int) -> None:
    """Runs weigh by their samples; 1e-4 of their squares holds the rates to the declared ones. Lawson & Hanson's."""
    rng, declared = np.random.default_rng(seed), {"a": 3.0, "b": 7.0}
    costs, rows, seconds, samples = Costs(declared), [], [], []
    for _ in range(5):
        n, modes, loads = int(rng.integers(50, 900)), int(rng.integers(10, 90)), rng.integers(0, 3, 2) * 20.0
        took = n * (1e-6 * modes + 3e-6 * (loads[0] > 0) + 1e-7 * loads.sum()) * rng.uniform(0.5, 1.5)
        costs.add(took / 2, n // 2, modes, list(loads))
        costs.add(took / 2, n - n // 2, modes, list(loads))
        rows.append([modes, loads[0] > 0, loads[0], loads[1] > 0, loads[1]])
        seconds.append(took)
        samples.append(n)
    each, took, n = np.array(rows, dtype=float), np.array(seconds), np.array(samples)
    work = n @ (each @ [1.0, 0.0, 3.0, 0.0, 7.0])
    prior = np.array([1.0, 0.0, 3.0, 0.0, 7.0]) * took.sum() / work
    squares, steps = float(n @ each[:, 0] ** 2), float(n @ each[:, 0])
    weight = np.sqrt(1e-4 * np.array([squares, *(2 * [steps**2 / squares, squares])]))
    scale = 1.0 / np.sqrt(n @ each**2 + weight**2)
    matrix = np.vstack([np.sqrt(n)[:, None] * each, np.diag(weight)]) * scale
    expected, _ = nnls(matrix, np.concatenate([took / np.sqrt(n), weight * prior]))
    rates = costs.rates()
    fitted = [rates.mode, *(x for name in "ab" for x in (rates.running[name], rates.load[name]))]
    np.testing.assert_allclose(fitted, expected * scale, rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("loads", [(0.0, 0.0), (20.0, 0.0)])
def test_an_effect_that_never_ran_costs_what_it_declares(loads: tuple[float, float]) -> None:
    """In the time of all steps, those of the other effect by its declared cost; nothing for running at all."""
    costs = Costs({"a": 3.0, "b": 7.0})
    costs.add(0.5, 1000, 40, loads)
    costs.add(0.25, 500, 40, loads)
    rates = costs.rates()
    assert rates.load["b"] == pytest.approx(7.0 * 0.75 / (1500 * (40 + 3.0 * loads[0])))
    assert rates.running["b"] == 0.0
    assert 1500 * (40 * rates.mode + (loads[0] > 0) * rates.running["a"] + loads[0] * rates.load["a"]) == (
        pytest.approx(0.75, rel=1e-3)
    )
    assert costs.rates() is rates
    costs.add(0.5, 500, 40, loads)
    assert costs.rates().mode > rates.mode


@pytest.mark.parametrize("power", [None, 0, 1, 2])
@pytest.mark.parametrize("apart", [1.0003, None])
def test_heights_of_sidebands_of_close_partials_and_at_a_sensor_on_the_string(
    power: int | None, apart: float | None
) -> None:
    """Two close partials: their sideband counts no more than one drift and its decay away from the partial.

    A sensor on the string reads its motion beside the force on the bridge: A / A_n and the power of its quantity.
    """
    instrument = duet(mode="auto")
    if power is not None:
        values = dict(instrument.resolved)
        values["strings"] = {n: {**s, "points": {"s": {"from_bridge": 0.11}}} for n, s in values["strings"].items()}
        quantity = ("displacement", "velocity", "acceleration")[power]
        sensor = {"plugin": "point_pickup", "name": "s", "quantity": quantity, "at": "B3.s", "full_scale": 1.0}
        instrument = tw.Instrument.from_values(values | {"outputs": [sensor]}, instrument.folder)
    model = assemble(instrument, FS)
    system, response = model.system, BridgeResponse(model)
    readout = system.readouts[0]
    name = "B3.z" if power is None else readout.probes[0].component
    basis = system.compiled[system.slot(name)].basis
    held = HeldModes.of(basis, "bridge")
    w = held.freq_rad.copy()
    if apart:
        w[1] = apart * w[0]
        held = replace(held, freq_rad=w)
    found, g, s = Plane.of(name, basis, held, system, response), held.force, held.damping_rate
    i, end = response.components.index(name), basis.index("bridge")
    low = held.vectors[:12]
    form = np.abs((low * np.asarray(stretch_weights(basis))) @ low.T)
    together = max(form[j, k] / math.sqrt(form[j, j] * form[k, k]) for j in range(12) for k in range(12) if j != k)
    moved = np.zeros(len(w))
    for probe in readout.probes:
        if probe.component == name:
            moved += np.abs(probe.factor * (held.vectors @ basis.right[basis.index(probe.point)].real)) / w
    for n, m in ((0, 1), (1, 0), (0, 0), (3, 2), (4, 11)):
        total = 0.0
        for freq in (abs(w[n] - 2 * w[m]), w[n] + 2 * w[m])[n == m :]:
            away = max(abs(w[n] ** 2 - freq**2), 2 * freq * (0.0012 * freq + s[n]))
            k = int(np.argmin(np.abs(w - freq)))
            mobility = np.interp(w[k], response.freq_rad, response.mobility[i]) + w[k] * abs(basis.residual[end, end])
            shift = g[k] ** 2 * mobility / (2 * w[k] ** 2)
            gap = max(s[k] + s[n] + 2 * s[m], abs(freq - w[k]) - 0.0012 * w[k] - shift)
            bridge = freq**2 / away
            force = bridge + (bridge * shift + 0.5 * together * w[k]) / gap
            total += response.heard_at(name, np.array([freq]))[0, 0] * force * g[n] / w[n]
            total += moved[n] * w[n] ** 2 / away * freq ** (power or 0)
        assert found.heard[0, n, m] == pytest.approx(total, rel=1e-9)
    assert len(w) > len(found.bent) == 32
    rest = response.heard[0, i].max() * g / w * (2 + w / w[0]) + moved * (2 + w / w[0]) * w[-1] ** (power or 0)
    np.testing.assert_allclose(found.heard[0, :, -1], rest[:32], rtol=1e-9)
    assert found.above[0, -1] == pytest.approx(math.sqrt(sum(rest[32:] ** 2)))


def test_a_rising_tension_costs_its_potential(model: Model) -> None:
    """EA / (8 L) S^2, S the stretch of both planes; the switch off gives it back."""
    effect, system, state = tension_effect(model), model.system, model.system.start()
    rng = np.random.default_rng(1)
    stretch = 0.0
    for name in effect.payers("E4"):
        modes = system.modes_of(state, name)
        modes[:] = rng.normal(size=modes.shape) * 1e-5 / np.arange(1, modes.shape[1] + 1)
        q = motion(system, state, name)[0]
        stretch += float(np.asarray(stretch_weights(system.compiled[system.slot(name)].basis)) @ q**2)
    law = next(p for p in system.potentials if p.name == "E4")
    length = float(system.compiled[system.slot("E4.z")].basis.metadata["length"])  # type: ignore[arg-type]
    energy = law.axial_stiffness / (8 * length) * stretch**2
    now = Moment(system, state, {}, np.zeros(len(system.readouts)))
    for string, wanted in (("E4", energy), ("B3", 0.0)):
        assert effect.cost(now, string, True) == pytest.approx(wanted, rel=1e-2)
        assert effect.cost(now, string, False) == -effect.cost(now, string, True)


def test_switches_that_cannot_be_paid_wait() -> None:
    """Of those wanted, a costs nothing, b gains, c cannot pay and is pending; d cannot pay to be off and stays on."""
    costs = {("a", True): 0.0, ("b", True): -1.0, ("c", True): 1.0, ("d", False): 1.0, ("e", False): 0.0}
    effect: Any = SimpleNamespace(
        components=tuple("abcdef"), cost=lambda at, c, on: costs[c, on], payers=lambda component: ()
    )
    at: Any = SimpleNamespace(system=None, state=None)
    watched = Watched(frozenset("abcf"), (), {"a": 7})
    after = switch(effect, at, Switching(frozenset("def")), watched)
    assert after == Switching(frozenset("abdf"), frozenset("c"), {"a": 7})
