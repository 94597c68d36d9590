"""Rising tensions left out within their budgets, in random scenes and under bends."""

from __future__ import annotations

import numpy as np
import pytest
from effect_scenes import FS, TENSION
from tension_scenes import SECONDS, deviations, followed, forces, guitar

import tonewood as tw
from tonewood.performance.effects.tension import TensionEffect
from tonewood.performance.score.note import Control

BUDGET = 0.5
#: cents that the reading of pitch itself is off in these scenes, where `auto` never left anything out
READING = 0.03
LONG = [pytest.param(seed, marks=pytest.mark.validate) for seed in range(4, 150)]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(4), *LONG])
def test_no_partial_leaves_the_budget(seed: int) -> None:
    """With the additive budget so wide that cents decide alone."""
    cents, _, (report,) = deviations(seed, budget_db=0.0)
    assert cents < BUDGET
    assert report.bound is None or (cents < report.bound + READING and report.bound <= BUDGET)


@pytest.mark.parametrize("cents", [-1200.0, -500.0, 700.0])
@pytest.mark.parametrize("time", [0.0, 0.6])
def test_a_bent_string_is_within_its_budget(cents: float, time: float) -> None:
    """An octave down the same energy raises the pitch sixteen times as much."""
    score = tw.Score([tw.Note(0.0, 4.0, string="G3", stop=0, force=0.9)], controls=[Control(time, "bend", cents)])
    renderers = [
        tw.Renderer(score, guitar("steel_strings", ("G3",), mode=mode, budget_db=0.0), FS, max_duration=SECONDS + 1)
        for mode in ("all", "auto")
    ]
    every, auto = (forces(renderer.engine, SECONDS)[1][:, 0] for renderer in renderers)
    (report,) = (e for e in renderers[1].summary().effects if e.name == "tension_modulation")
    pitch = 196.0 * 2 ** (cents / 1200)
    here = slice(round((time + 0.15) * FS), None)
    off, _ = followed(every[here], auto[here], pitch, 0.03 * abs(every[here]).max())
    assert len(off) > 10
    assert report.seconds_active < SECONDS
    assert report.bound is not None
    assert abs(off).max() < report.bound + 0.02
    assert report.bound <= BUDGET


def test_a_bend_of_a_ringing_string_is_looked_at_at_once() -> None:
    """Left out while it is not bent, the rise comes back with the bend, not at the next look at all strings."""
    score = tw.Score([tw.Note(0.0, 4.0, string="G3", stop=0, force=0.9)], controls=[Control(0.9, "bend", -1200.0)])
    made = guitar("steel_strings", ("G3",), mode="auto", budget_db=0.0, budget_cents=0.1)
    renderer = tw.Renderer(score, made, FS, max_duration=SECONDS)
    engine, rises = renderer.engine, []
    (effect,) = (e for e in engine.effects if isinstance(e, TensionEffect))
    while engine.state.sample < 1.1 * FS:
        engine.advance(1)
        if "G3" not in engine.running(TENSION) and engine.state.sample > 0.2 * FS:
            (energy,) = effect.energies.at(engine.system, engine.state)
            rises.append(effect.bounds.rise("G3", engine.system, float(energy)))
    assert rises
    assert 0.02 < max(rises) < 0.11
    assert "G3" in engine.running(TENSION)


def test_bounds_that_were_not_used_are_none() -> None:
    score = tw.Score([tw.Note(0.0, 2.0, string="G3", stop=0, force=3.0)])
    for mode in ("all", "auto"):
        made = guitar("steel_strings", ("G3",), mode=mode)
        renderer = tw.Renderer(score, made, FS, max_duration=0.5)
        for _ in renderer.blocks(4096):
            pass
        for report in renderer.summary().effects:
            if report.seconds_active >= renderer.summary().duration_s:
                assert report.bound is None
                assert report.bound_db is None


def test_what_a_tension_adds_is_within_the_additive_budget() -> None:
    score = tw.Score([tw.Note(0.0, 4.0, string="G3", stop=0, force=3.0, angle_deg=20.0)])
    made = guitar("steel_strings", ("G3",), mode="auto", budget_db=-70.0)
    renderer = tw.Renderer(score, made, FS, max_duration=SECONDS)
    for _ in renderer.blocks(4096):
        pass
    (report,) = (e for e in renderer.summary().effects if e.name == "tension_modulation")
    assert report.bound_db is not None
    assert -100 < report.bound_db <= -76.0
    assert report.bound is not None
    assert np.isfinite(report.bound)
    assert 0.0 < report.seconds_active < SECONDS


@pytest.mark.parametrize(("seconds", "watched"), [(0.25, False), (20.0, True)])
def test_the_score_decides_whether_rises_are_looked_at(
    monkeypatch: pytest.MonkeyPatch, seconds: float, watched: bool
) -> None:
    """All strings struck again at once, or left to ring out: where nothing could be left out, `auto` is `all`."""
    monkeypatch.undo()
    guitar = tw.load_instrument("steel_strings")
    notes = [tw.Note(i * seconds, seconds, string=s, stop=0, force=6.0) for i in range(8) for s in guitar.spec.strings]
    models = {
        mode: tw.Renderer(tw.Score(notes), guitar, 24000, effects=mode, max_duration=0.6) for mode in ("auto", "all")
    }
    effect = next(e for e in models["auto"].engine.effects if isinstance(e, TensionEffect))
    assert effect.watched == watched
    if not watched:
        auto, whole = (np.concatenate(list(r.blocks())) for r in models.values())
        np.testing.assert_array_equal(auto, whole)
