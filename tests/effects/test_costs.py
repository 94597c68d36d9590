"""Costs of steps on a clock that the tests set: rates that are fitted, and renders that are foreseen."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as sla
from effect_scenes import FS, TENSION, duet
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls

import tonewood as tw
from tonewood.performance.effects.costs import Costs, not_negative
from tonewood.performance.effects.tension import TENSION_MODULATION
from tonewood.performance.effects.usage import Bound, EffectUsage
from tonewood.performance.engine import engine as engine_module
from tonewood.physics.coupling.system import System
from tonewood.physics.stepping.kernel import KernelStepper
from tonewood.sound.render import plan as plan_module
from tonewood.sound.render import renderer as render_module

NOTE = tw.Note
MODE, RISING, RISING_MODE = 5e-10, 7e-7, 4e-9
DECLARED = {TENSION: TENSION_MODULATION.cost(1)}


def test_rates_are_those_of_the_clock() -> None:
    costs, rng = Costs(DECLARED), np.random.default_rng(3)
    for _ in range(60):
        samples, modes = int(rng.integers(64, 4000)), int(rng.integers(400, 1500))
        modulated = int(rng.choice([0, 90, 200, 330]))
        costs.add(
            samples * (MODE * modes + RISING * (modulated > 0) + RISING_MODE * modulated),
            samples,
            modes,
            [modulated],
        )
    rates = costs.rates()
    assert (rates.mode, rates.load[TENSION]) == pytest.approx((MODE, RISING_MODE), rel=0.05)
    assert rates.running[TENSION] == pytest.approx(RISING, rel=0.15)


def test_where_nothing_was_measured_costs_are_the_declared_ones() -> None:
    costs = Costs(DECLARED)
    assert costs.rates().mode == 0.0
    costs.add(1000 * 300 * MODE, 1000, 300, [0])
    rates = costs.rates()
    assert rates.mode == pytest.approx(MODE)
    assert rates.load[TENSION] == pytest.approx(TENSION_MODULATION.cost(1) * MODE)


def test_no_rate_is_negative() -> None:
    costs = Costs(DECLARED)
    costs.add(1e-3, 1000, 300, [0])
    costs.add(5e-4, 1000, 300, [200])
    rates = costs.rates()
    assert min(rates.mode, rates.running[TENSION], rates.load[TENSION]) >= 0.0
    assert rates.mode > 0.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that goes by the steps and exchanges made."""
    reported = SimpleNamespace(now=0.0, exchange=2e-3)
    reported.perf_counter = reported.thread_time = lambda: reported.now
    for module in (engine_module, plan_module, render_module):
        monkeypatch.setattr(module, "time", reported)
    step, exchange = KernelStepper._step, KernelStepper.exchange

    def per_sample(system: System) -> float:
        modes = {name: c.basis.n_modes for name, c in zip(system.names, system.compiled, strict=True)}
        rising = [t for t, on in zip(system.potentials, system.potentials.on, strict=True) if on]
        modulated = sum(modes[c] for t in rising for c in t.components)
        return MODE * sum(modes.values()) + RISING * (modulated > 0) + RISING_MODE * modulated

    def timed_step(self: KernelStepper, state: object, n: int, *rest: object) -> object:
        reported.now += n * per_sample(self.system)
        return step(self, state, n, *rest)  # type: ignore[arg-type]  # passed on as it came

    def timed_exchange(self: KernelStepper, system: System) -> None:
        reported.now += reported.exchange
        exchange(self, system)

    monkeypatch.setattr(KernelStepper, "_step", timed_step)
    monkeypatch.setattr(KernelStepper, "exchange", timed_exchange)
    return reported


SCORES = {
    "quiet, then loud": [NOTE(0.3 * i, 0.3, note=59 + i % 6, force=0.1 if i < 6 else 5.0) for i in range(12)],
    "loud, then quiet": [NOTE(0.3 * i, 0.3, note=59 + i % 6, force=5.0 if i < 6 else 0.1) for i in range(12)],
    "sparse": [NOTE(0.0, 0.5, note=64, force=3.0), NOTE(3.0, 0.5, note=59, force=3.0)],
    "dense": [NOTE(0.11 * i, 0.1, note=59 + (5 * i) % 9, force=1.0 + i % 4) for i in range(30)],
    "late": [NOTE(1.5 + 0.4 * i, 0.4, note=60 + i, force=2.0) for i in range(5)],
}


@pytest.mark.parametrize(
    "scene",
    [s if s in ("quiet, then loud", "late") else pytest.param(s, marks=pytest.mark.validate) for s in SCORES],
)
def test_a_render_takes_what_was_foreseen(scene: str, clock: SimpleNamespace) -> None:
    score, guitar = tw.Score(SCORES[scene]), duet()
    foreseen = tw.plan(score, guitar, FS, tail=1.0).predicted_s
    began = clock.now
    stream = tw.Renderer(score, guitar, FS, tail=1.0)
    for _ in stream.blocks(4096):
        pass
    assert foreseen == pytest.approx(clock.now - began, rel=0.25)


def test_what_was_saved_is_what_all_takes_more(clock: SimpleNamespace) -> None:
    score, taken, clock.exchange = tw.Score(SCORES["dense"]), {}, 0.0
    for mode in ("auto", "all"):
        began = clock.now
        stream = tw.Renderer(score, duet(), FS, max_duration=3.0, effects=mode)
        for _ in stream.blocks(4096):
            pass
        taken[mode] = clock.now - began
        if mode == "auto":
            saved = sum(e.seconds_saved for e in stream.summary().effects if e.name == "tension_modulation")
    assert saved == pytest.approx(taken["all"] - taken["auto"], rel=0.05)


@given(
    rows=st.lists(st.tuples(*[st.floats(-2, 2)] * 3), min_size=4, max_size=8),
    right=st.tuples(*[st.floats(-3, 3)] * 3),
)
def test_rates_that_may_not_be_negative_are_those_of_the_general_method(rows, right):
    """Lawson & Hanson's, on the Cholesky factor."""
    A, b = np.array(rows), np.array(right)
    matrix = A.T @ A + 0.1 * np.eye(3)
    root = sla.cholesky(matrix)
    expected, _ = nnls(root, sla.solve_triangular(root, b, trans="T"))
    np.testing.assert_allclose(not_negative(matrix, b), expected, atol=1e-9)


def test_when_and_how_long_an_effect_ran() -> None:
    """Runs that follow at once are one interval; of what begins before score time 0, the part from 0 on is told."""
    usage = EffectUsage(1000.0, {TENSION: {"E4": 100.0, "B3": 60.0}}, DECLARED)
    for start, n, on in ((-64, 128, ["E4"]), (64, 64, ["E4"]), (128, 64, []), (192, 64, ["E4", "B3"])):
        usage.count(start, n, {TENSION: on}, 300, n * 300 * MODE)
    e4, b3 = usage.spans[TENSION, "E4"], usage.spans[TENSION, "B3"]
    assert (e4.all, b3.all) == ([(-64, 128), (192, 256)], [(192, 256)])
    assert usage.score_time(e4) == ((0.0, 0.128), (0.192, 0.256))
    assert [usage.seconds(s.samples) for s in (e4, b3)] == pytest.approx([0.256, 0.064])
    assert (usage.samples, usage.running[TENSION]) == (320, 256)
    usage.forget_times()
    assert usage.score_time(e4) == ((0.192, 0.256),)
    assert e4.samples == 256


def test_the_largest_bounds_are_kept() -> None:
    usage = EffectUsage(1000.0, {TENSION: {"E4": 100.0}}, DECLARED)
    for bound, out in ((Bound(2.0, 0.1), True), (Bound(1.0, 0.3), True), (Bound(5.0, 0.2), False)):
        usage.enter(TENSION, [("E4", bound, out)])
    assert usage.left_out[TENSION, "E4"] == Bound(2.0, 0.3)
    assert usage.largest[TENSION, "E4"] == Bound(5.0, 0.3)


def test_what_an_effect_would_have_taken_where_it_was_off() -> None:
    """Its cost per load and sample, and, while it runs nowhere, its share of the cost of running at all."""
    loads = {"E4": 100.0, "B3": 60.0}
    usage = EffectUsage(1000.0, {TENSION: loads}, DECLARED)
    for start, on in ((0, []), (1000, ["E4"]), (2000, ["B3"]), (3000, ["E4", "B3"])):
        load = sum(loads[name] for name in on)
        usage.count(start, 1000, {TENSION: on}, 300, 1000 * (300 * MODE + (RISING if on else 0) + load * RISING_MODE))
    nowhere = 1000 * RISING * 60 / 160
    assert usage.saved(TENSION, "B3") == pytest.approx(2000 * 60 * RISING_MODE + nowhere, rel=0.02)
    assert usage.saved_as_declared(50.0) == pytest.approx(4000 * 50 * MODE, rel=0.02)
