"""Strings with longitudinal motion are linear while little is heard of that: bounds, switches, energy."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import FS, TENSION, compared, duet, moment, renderer, sound, tension_effect

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.effects.bridge_response import BridgeResponse
from tonewood.performance.effects.phantoms import Phantoms
from tonewood.performance.effects.switching import pay
from tonewood.performance.effects.tension import SELDOM, potential
from tonewood.performance.effects.usage import Bound
from tonewood.performance.engine.engine import GRID
from tonewood.physics.coupling.system import State
from tonewood.physics.energy.stored import stored_energy
from tonewood.physics.modal.held_modes import HeldModes
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.physics.stepping.motion import from_motion, share_velocities, to_motion

NOTES = [tw.Note(0.0, 3, note=59, force=2.0), tw.Note(0.3, 3, note=64, force=4.0)]


def longitudinal(**changes: object) -> tw.Instrument:
    """The duet, its lower string free to move longitudinally, over frets that it does not reach."""
    high = {"connections.frets.action_first": 3e-3, "connections.frets.action_twelfth": 6e-3}
    return duet(**changes).replace({"strings.B3.plugin": "geometric_string", **high})


def partials(model: Model, rng: np.random.Generator, amplitudes: dict[int, float]) -> State:
    """The lower string in some of its partials (number -> m) with random phases, its bridge at rest."""
    system = model.system
    state = system.start()
    basis = system.compiled[system.slot("B3.z")].basis
    held = HeldModes.of(basis, "bridge")
    q, v = np.zeros(basis.n_modes), np.zeros(basis.n_modes)
    for number, amplitude in amplitudes.items():
        phase = rng.uniform(0, 2 * np.pi)
        size = amplitude * np.sqrt(basis.metadata["linear_density"] * basis.metadata["length"] / 2)  # type: ignore[operator]  # numbers
        q += size * np.cos(phase) * held.vectors[number - 1]
        v += size * np.sin(phase) * held.freq_rad[number - 1] * held.vectors[number - 1]
    system.modes_of(state, "B3.z")[:] = from_motion(basis, q, v)
    share_velocities(system, state)
    return state


def bounds(model: Model) -> Phantoms:
    law = model.system.potentials[0]
    compiled = {name: model.system.compiled[model.system.slot(name)] for name in law.components}
    return Phantoms.of(law, compiled, model.strings["B3"].tension(0), BridgeResponse(model))


@pytest.mark.parametrize("seed", range(6))
def test_what_is_missing_stays_below_its_bound(seed: int) -> None:
    """Against the coupled string itself, in motions so small that their pitch is that of the linear one."""
    rng = np.random.default_rng(seed)
    model = assemble(longitudinal(mode="all"), FS)
    numbers = rng.choice(np.arange(1, 13), 3, replace=False)
    state = partials(model, rng, {int(n): 2e-5 / n for n in numbers})
    q, v = to_motion(
        model.system.compiled[model.system.slot("B3.z")].basis, np.asarray(model.system.modes_of(state, "B3.z"))
    )
    still = np.zeros(model.system.compiled[model.system.slot("B3.y")].basis.n_modes)
    found = bounds(model)
    slopes = found.slopes({"B3.z": (q, v), "B3.y": (still, still)})
    on, off = model.system, model.system.with_potentials(["E4"])
    sounds = [KernelStepper(system).run(state.copy(), 2400)[0] for system in (on, off)]
    missing = np.abs(sounds[0] - sounds[1]).max(axis=0)
    for r, most in enumerate(missing):
        peak = np.full(len(missing), np.inf)
        peak[r] = 1.0
        bound = found.level(slopes, peak)
        assert 0.0 < most <= bound
        assert bound <= 8 * most  # of use, too
    assert found.cents(slopes) < 0.05


def test_slopes_are_those_of_the_partials() -> None:
    """Amplitude times wavenumber of a partial, whatever its phase."""
    model = assemble(longitudinal(mode="all"), FS)
    basis = model.system.compiled[model.system.slot("B3.z")].basis
    found, still = bounds(model), np.zeros(basis.n_modes)
    for seed in range(3):
        state = partials(model, np.random.default_rng(seed), {5: 1e-4})
        q, v = to_motion(basis, np.asarray(model.system.modes_of(state, "B3.z")))
        slopes = found.slopes({"B3.z": (q, v), "B3.y": (still[: found.parts["B3.y"].displaced.shape[1]],) * 2})
        length = float(basis.metadata["length"])  # type: ignore[arg-type]  # a number
        assert slopes[4] == pytest.approx(1e-4 * 5 * np.pi / length, rel=0.03)
        assert np.delete(slopes, 4).max() < 0.05 * slopes[4]


def test_switches_lose_no_more_than_the_budget_and_gain_no_energy() -> None:
    options = {"mode": "auto", "budget_db": -40.0, "budget_cents": 2.0}
    engine, other = (renderer(NOTES, 3.0, longitudinal(**options)).engine for _ in range(2))
    other._switch = lambda moved, fresh: None  # type: ignore[method-assign]  # never switches
    peak, left, energies, ways = 0.0, [], [], set()
    while engine.state.sample < 2.9 * FS:
        before, modulated = engine.snapshot(), engine.running(TENSION)
        out = engine.advance(SELDOM // 8)
        peak = max(peak, abs(out).max())
        if engine.done:
            energies.append(stored_energy(engine.system, engine.state).total)
        now = engine.running(TENSION)
        if now != modulated:
            if now < modulated:
                other.restore(before)
                n = SELDOM // 8 if "B3" in modulated - now else 1  # the other's pitch departs
                left.append((abs(other.advance(n) - out[: n * GRID]).max(), peak))
            ways |= {("rises" if name in now else "rests", name) for name in now ^ modulated}
    assert {("rises", "B3"), ("rests", "B3"), ("rises", "E4")} <= ways
    assert len(left) > 1
    assert all(lost <= 1e-2 * loudest for lost, loudest in left)
    assert np.all(np.diff(energies) <= 1e-12 * energies[0])


@pytest.mark.slow
def test_auto_keeps_the_pitch_of_all() -> None:
    streams = {mode: renderer(NOTES, 3.0, longitudinal(mode=mode, budget_db=-30.0)) for mode in ("all", "auto")}
    every, auto = (sound(stream)[:, 0] for stream in streams.values())
    for freq in (246.9, 493.9, 329.6):
        cents, _ = compared(every, auto, freq)
        assert abs(cents).max() < 0.5
    active = {e.component: e for e in streams["auto"].summary().effects if e.name == "longitudinal"}
    assert 0.0 < active["B3"].seconds_active < 2.8
    assert active["B3"].bound is not None
    assert active["B3"].bound <= -30.0


def test_a_string_that_nobody_plays_is_linear_from_the_beginning() -> None:
    quiet = renderer([tw.Note(0.0, 1, note=64, force=0.02)], 0.3, longitudinal(mode="auto", budget_db=-60.0))
    sound(quiet)
    assert not quiet.engine.usage.spans[TENSION, "B3"].samples
    assert not any(quiet.engine.system.potentials.on)


def test_a_soft_pluck_is_coupled_from_the_beginning() -> None:
    """Its rise is within the budget of cents; whether its phantoms are heard is only known once they sound."""
    soft = renderer([tw.Note(0.0, 1, note=59, force=0.05)], 0.2, longitudinal(mode="auto"))
    sound(soft)
    assert soft.engine.usage.spans[TENSION, "B3"].all[0][0] <= 0


def test_a_coupling_that_would_set_energy_free_is_paid_or_kept() -> None:
    """With longitudinal modes strained against the slope the potential beside the modes is below zero."""
    model = assemble(longitudinal(mode="all"), FS)
    system = model.system
    state = partials(model, np.random.default_rng(1), {1: 2e-4, 2: 1e-4})
    KernelStepper(system).run(state, 400)
    signs = set()
    for shift in (-1e-5, 0.0, 1e-5):
        trial = state.copy()
        system.modes_of(trial, "B3.longitudinal")[0, 0] += shift
        share_velocities(system, trial)
        stored, before = potential(system, trial, "B3"), stored_energy(system, trial).total
        signs.add(np.sign(stored))
        rests = pay(tension_effect(model), moment(system, trial), "B3", False)
        assert rests or stored < 0.0
        if rests:
            assert stored_energy(system.with_potentials([]), trial).total <= before * (1 + 1e-12)
    assert signs == {-1.0, 1.0}


def test_a_tension_is_left_out_below_nine_tenths_of_the_budget() -> None:
    effect = tension_effect(assemble(longitudinal(mode="auto"), FS))

    def wanted(level: float, on: set[str]) -> frozenset[str]:
        return effect.wanted({"B3": Bound(0.1, level), "E4": Bound(0.1)}, on)

    assert wanted(0.5e-4, set()) == frozenset()
    assert wanted(1.1e-4, set()) == {"B3"}
    assert wanted(0.95e-4, set()) == frozenset()
    assert wanted(0.95e-4, {"B3"}) == {"B3"}
    assert wanted(0.5e-4, {"B3"}) == frozenset()
