"""Strings and high modes that sleep: within the additive budget of all, without a click or a gain of energy."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from effect_scenes import FS, compared, duet, sound

import tonewood as tw
from tonewood.energy.stored import stored_energy
from tonewood.engine import sleeping
from tonewood.engine.engine import GRID, Engine
from tonewood.engine.rungs import BANDS, Rungs

NOTE = tw.Note
#: a chord that rings, and one note of it again when most has decayed
NOTES = [NOTE(0.05, 3, note=59, force=2.0), NOTE(0.1, 3, note=64, force=1.0), NOTE(1.9, 1, note=64, force=0.3)]
SECONDS = 3.0


def renderer(notes: list[tw.Note], seconds: float, worth: float = 0.0, **effects: Any) -> tw.Renderer:
    """Strings that decay soon; every exchange is taken to pay."""
    soft = {"axial_stiffness": 0.0, "loss.eta_f": 8e-3, "loss.eta_b": 2e-2}
    changes = {f"strings.{name}.{key}": value for name in ("B3", "E4") for key, value in soft.items()}
    instrument = duet(**effects).replace(changes)
    stream = tw.Renderer(tw.Score(notes), instrument, FS, max_duration=seconds)
    stream.engine.sleeper.worth = worth
    return stream


def levels(stream: tw.Renderer) -> dict[str, int]:
    return dict(stream.engine.sleeper.state.level)


@pytest.fixture(scope="module")
def everything() -> np.ndarray:
    return sound(renderer(NOTES, SECONDS, mode="all"))


@pytest.mark.parametrize("late", [0.08, 0.2, sleeping._LATE])
@pytest.mark.parametrize("budget", [-60.0, -80.0, -100.0])
def test_what_sleeps_is_within_the_budget(
    budget: float, late: float, everything: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However often it is looked: the click as a band falls asleep counts, too."""
    monkeypatch.setattr(sleeping, "_LATE", late)
    stream = renderer(NOTES, SECONDS, budget_db=budget)
    got = sound(stream)
    assert stream.engine.ledger.mode_samples < 0.95 * stream.engine.ledger.samples * stream.model.n_modes
    n = min(len(got), len(everything))  # the tail may be judged decayed a block sooner
    difference = 20 * np.log10(abs(got[:n] - everything[:n]).max() / abs(everything).max())
    assert difference < budget
    bounds = [e.bound for e in stream.summary().effects if e.name == "high_modes" and e.seconds_active < SECONDS]
    assert bounds
    assert all(bound is not None and bound <= budget for bound in bounds), bounds


def test_partials_keep_their_pitch(everything: np.ndarray) -> None:
    got = sound(renderer(NOTES, SECONDS, budget_db=-60.0))
    for freq in (246.9, 329.6, 740.8):
        cents, level = compared(everything[:, 0], got[:, 0], freq)
        assert len(cents) > 2
        assert abs(cents).max() < 0.1
        assert abs(level).max() < 0.1


def test_nothing_may_sleep_within_a_budget_of_nothing(everything: np.ndarray) -> None:
    stream = renderer(NOTES[:1], 0.5, budget_db=-300.0)
    started = iter(stream.blocks(512))
    next(started)
    for _ in started:
        assert set(levels(stream).values()) == {0}


def test_a_quiet_string_beside_a_loud_one_at_the_same_pitch_is_woken() -> None:
    notes = [NOTE(0.0, 1, string="B3", stop=5, force=0.02), NOTE(2.0, 2, string="E4", stop=0, force=3.0)]
    stream, all_ = renderer(notes, 2.6), renderer(notes, 2.6, mode="all")
    blocks, seen = [], set()
    for block in stream.blocks(512):
        blocks.append(block)
        seen.add(levels(stream)["B3"])
    assert max(seen) > 2
    a, b = np.concatenate(blocks), sound(all_)
    assert abs(a - b).max() < 1e-4 * abs(b).max()


def test_a_loud_pluck_after_a_long_silence() -> None:
    notes = [NOTE(0.0, 0.1, note=59, force=0.01), NOTE(3.0, 1, note=59, force=3.0)]
    stream, all_ = renderer(notes, 3.4), renderer(notes, 3.4, mode="all")
    deepest = 0
    blocks = []
    for block in stream.blocks(512):
        blocks.append(block)
        deepest = max(deepest, *levels(stream).values())
    assert deepest >= BANDS - 2
    a, b = np.concatenate(blocks), sound(all_)
    assert abs(a - b).max() < 1e-4 * abs(b).max()


def exchanges(engine: Engine, seconds: float) -> list[tuple[float, float, bool]]:
    """Energy before and after every exchange, and whether all in it woke."""
    found = []
    rest = engine._rest

    def watched(wanted: dict[str, int]) -> None:
        up = all(level < engine.sleeper.state.level[name] for name, level in wanted.items())
        before = stored_energy(engine.system, engine.state).total
        rest(wanted)
        found.append((before, stored_energy(engine.system, engine.state).total, up))

    engine._rest = watched  # type: ignore[method-assign]  # watched, not changed
    engine.advance(round(seconds * FS / GRID))
    return found


def test_energy_never_rises_and_waking_leaves_it() -> None:
    found = exchanges(renderer(NOTES, SECONDS).engine, SECONDS)
    assert any(up for *_, up in found)
    assert any(not up for *_, up in found)
    for before, after, up in found:
        assert after <= before * (1 + 1e-9) + 1e-30
        if up:
            assert after == pytest.approx(before, rel=1e-8, abs=1e-30)


def test_tensions_that_rise_while_strings_sleep_gain_nothing() -> None:
    steel = tw.Renderer(tw.Score(NOTES), duet(budget_cents=0.0), FS, max_duration=SECONDS)
    steel.engine.sleeper.worth = 0.0
    steel.engine.sleeper.budget = 1e-2
    found = exchanges(steel.engine, SECONDS)
    assert found
    assert all(after <= before * (1 + 1e-9) + 1e-30 for before, after, _ in found)


def test_a_string_that_wakes_moves_as_it_did() -> None:
    engine = renderer(NOTES[:2], SECONDS).engine
    engine.advance(round(1.7 * FS / GRID))
    asleep = engine.sleeper.sleeping
    assert asleep
    before = engine.state.copy(), engine.system
    engine._rest(dict.fromkeys(asleep, 0))
    for name in asleep:
        for component in engine.model.strings[name].components:
            motions = []
            for state, system in (before, (engine.state, engine.system)):
                compiled = system.compiled[system.slot(component)]
                x = system.modes_of(state, component)
                places = [compiled.basis.index(p) for p in ("bridge", "pluck")]
                rows = [compiled.form.rows(q, np.array(places)) for q in ("displacement", "velocity")]
                motions.append([np.einsum("pmx,xm->p", r, x) for r in rows])
            np.testing.assert_allclose(motions[0], motions[1], rtol=1e-7, atol=1e-18)


def test_snapshots_and_blocks() -> None:
    stream = renderer(NOTES, SECONDS)
    blocks = stream.blocks(512)
    kept = []
    for _ in itertools.islice(blocks, 80):
        kept.append(stream.snapshot())
    rest = np.concatenate(list(blocks))
    assert any(s.engine.asleep.level["B3"] for s in kept)
    for snapshot in kept[24::13]:
        again = renderer(NOTES, SECONDS)
        again.restore(snapshot)
        assert np.array_equal(np.concatenate(list(again.blocks(512)))[-len(rest) :], rest)
    assert np.array_equal(sound(renderer(NOTES, SECONDS), 1000), sound(renderer(NOTES, SECONDS), 1 << 20))


def test_the_account_of_energy_closes() -> None:
    stream = tw.Renderer(tw.Score(NOTES), renderer(NOTES, 1.0).model.instrument, FS, max_duration=2.2, energy=True)
    stream.engine.sleeper.worth = 0.0
    sound(stream)
    assert stream.engine.ticker.exchanges > 4
    trace = stream.energy
    assert trace is not None
    assert trace.worst_cumulative_residual < 1e-9


def test_work_follows_the_modes_that_are_awake() -> None:
    """The kernel is given no more modes than are awake: what it takes goes with them."""
    engine = renderer(NOTES[:2], 4.0).engine
    engine.advance(round(3.5 * FS / GRID))
    assert engine.sleeper.sleeping
    stepped = sum(compiled.basis.n_modes for compiled in engine.system.compiled)
    whole = engine.model.n_modes
    missing = 0
    for name, level in engine.sleeper.sleeping.items():
        rungs = engine.sleeper.rungs(name, engine.frettings[name])
        assert isinstance(rungs, Rungs)
        missing += sum(int(p.counts[0] - p.counts[level]) for p in rungs.parts.values())
    assert stepped == whole - missing
    assert missing > 0.4 * whole


def test_strings_that_trade_energy_between_looks_stay_within_their_bound() -> None:
    """Two strings in unison pass what they have to and fro: in between, a force is larger than at both ends.

    What is supposed of an interval from its beginning alone holds all the same.
    """
    notes = [NOTE(0.0, 3, string="B3", stop=5, force=2.0)]
    stream = renderer(notes, 3.0, mode="auto")
    engine, sleeper = stream.engine, stream.engine.sleeper
    engine.advance(round(0.1 * FS / GRID))
    sleeper.look(engine.state.sample, engine.system, engine.state, engine.frettings, (), ())
    awake = np.ones((len(sleeper.components), BANDS), dtype=bool)
    step, steps = 4 * GRID / FS, 140
    forces, starts = [], []
    for _ in range(steps):
        force, _, _, doubled, _ = sleeper._listening.look(engine.state)
        forces.append(force)
        starts.append(
            (force, np.sqrt(doubled.sum(axis=0) + sleeper._doubled_body(engine.system, engine.state, doubled)))
        )
        engine.advance(4)
    course = np.array(forces)
    drives = np.array([sleeper._driving(f) for f in course])
    traded = False
    for n in (8, 30, 70):
        for i in range(0, steps - n, 10):
            inside, ends = course[i : i + n].max(axis=0), np.maximum(course[i], course[i + n])
            traded |= bool(np.any((inside > 1.5 * ends) & (inside > 0.05 * course.max(axis=0))))
            bound = sleeper._velocity(*starts[i], awake, n * step)
            most = drives[i : i + n].max(axis=0)
            # all octaves together: the motion of the loudest is seen in the modes of others, at a moment's phase
            assert np.all(most.sum(axis=1) <= bound.sum(axis=1))
            # and it is one that decisions can be made with: within 26 dB of what happens where most is going on
            loudest = np.unravel_index(np.argmax(most), bound.shape)
            assert bound[loudest] < 20 * most[loudest]
    assert traded  # what both ends tell would not have been a bound
