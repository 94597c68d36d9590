"""An effect of a third party that is switched while the engine steps: against the same effect always on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tonewood as tw
import tonewood.authoring as ta
from tonewood.cli.main import run
from tonewood.performance.effects.base import SwitchedEffect
from tonewood.performance.effects.switching import pay
from tonewood.performance.engine.engine import Engine
from tonewood.physics.energy.stored import gaps, stored_energy

pytestmark = pytest.mark.usefixtures("plate")

FS, SLACK = 24000, 4e-4
#: too soft to reach the slack, then strong, then left to ring
SOFT = [tw.Note(0.05, 1.0, string="D3", stop=0, force=0.03)]
LOUD = [*SOFT, tw.Note(0.8, 1.0, string="A3", stop=0, force=2.0), tw.Note(1.2, 2.0, string="D3", stop=0, force=4.0)]


def zither(**effects: object) -> tw.Instrument:
    ring = {"playing.note_end.kind": "ring"}
    return tw.load_instrument("plate_zither").replace({**ring, **{f"effects.{k}": v for k, v in effects.items()}})


def renderer(notes: list[tw.Note], seconds: float, **effects: object) -> tw.Renderer:
    return tw.Renderer(tw.Score(notes), zither(**effects), FS, max_duration=seconds)


def sound(stream: tw.Renderer, block: int = 4096) -> NDArray[np.float64]:
    return np.concatenate(list(stream.blocks(block)))


def effect_of(engine: Engine) -> SwitchedEffect:
    (found,) = (e for e in engine.effects if e.name == "slack_thread" and isinstance(e, SwitchedEffect))
    return found


def test_nothing_is_lost_where_it_is_switched_off() -> None:
    """Rounding apart, which a stretched thread magnifies from 1.2 s on; without the thread the sound is another one."""
    streams = {mode: renderer(LOUD, 2.5, mode=mode) for mode in ("auto", "all", "none")}
    sounds = {mode: sound(stream) for mode, stream in streams.items()}
    peak = abs(sounds["all"]).max()
    off = abs(sounds["auto"] - sounds["all"])[: int(1.2 * FS)]
    assert off.max() < 1e-11 * peak
    linear = ["second_polarization", "dampers"]
    assert abs(sound(renderer(LOUD, 2.5, mode=linear)) - sounds["all"]).max() > 1e-2 * peak
    (report,) = (r for r in streams["auto"].summary().effects if r.name == "slack_thread")
    assert 0.1 < report.seconds_active < 2.0
    assert report.bound == 0.0


def test_it_is_on_whenever_the_string_passes_the_slack() -> None:
    engine = renderer(LOUD, 3.0, mode="auto").engine
    place = [c.name for c in engine.system.connections].index("D3.thread.thread")
    ways, reached = set(), 0.0
    while engine.state.sample < 2.5 * FS:
        on = "D3" in engine.running("slack_thread")
        engine.advance(1)
        ways.add(on)
        reached = max(reached, abs(gaps(engine.system, engine.state)[place]))
        assert on or abs(gaps(engine.system, engine.state)[place]) < SLACK
    assert ways == {True, False}
    assert reached > SLACK


def test_the_system_has_no_law_of_it_while_it_is_off() -> None:
    engine = renderer(SOFT, 2.0, mode="auto").engine
    assert not engine.system.elimination.others.laws
    while "D3" not in engine.running("slack_thread"):
        engine.advance(1)
    assert engine.system.elimination.others.laws
    while "D3" in engine.running("slack_thread"):
        engine.advance(1)
    assert not engine.system.elimination.others.laws


def test_samples_do_not_depend_on_blocks_and_snapshots_restore_it() -> None:
    reference = sound(renderer(LOUD, 1.6, mode="auto"), 1 << 20)
    assert np.array_equal(sound(renderer(LOUD, 1.6, mode="auto"), 100), reference)
    stream = renderer(LOUD, 1.6, mode="auto")
    blocks, kept = stream.blocks(512), []
    for block in blocks:
        kept.append((stream.snapshot(), stream.engine.running("slack_thread"), len(block)))
    assert len({on for _, on, _ in kept}) > 1
    done = np.cumsum([n for *_, n in kept])
    for i in range(0, len(kept), 17):
        again = renderer(LOUD, 1.6, mode="auto")
        again.restore(kept[i][0])
        assert np.array_equal(sound(again, 512), reference[done[i] :])


def test_a_stretched_thread_is_paid_for_when_it_is_switched_on() -> None:
    """Switched on beyond its slack, which no look lets happen, it takes its potential from the string's motion."""
    engine = renderer(LOUD, 3.0, mode="auto").engine
    engine.advance(int(1.25 * FS) // 64)
    effect = effect_of(engine)
    off = effect.apply(engine.system, (), engine.frettings)
    on = effect.apply(off, ("D3",), engine.frettings)
    tried = set()
    for _ in range(60):
        engine.advance(1)
        state = engine.state.copy()
        effect.reset(off, state, ("D3",))
        still = state.copy()
        before = stored_energy(off, still).total
        moment = ta.Moment(off, state, engine.frettings, engine.peak)
        if not (stored_energy(on, still).total > before * (1 + 1e-9)):
            continue  # it is not stretched
        paid = pay(effect, moment, "D3", True)
        tried.add(paid)
        if paid:
            assert stored_energy(on, state).total <= before * (1 + 1e-9)
        else:
            assert np.array_equal(state.modes, still.modes)
    assert True in tried


@pytest.mark.slow
def test_its_energy_adds_up() -> None:
    audio = tw.render(tw.Score(LOUD), zither(mode="auto"), FS, max_duration=1.6, energy=True)
    assert audio.energy is not None
    assert audio.energy.worst_residual <= 1e-10


def test_it_is_planned_and_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = tw.plan(tw.Score(LOUD), zither(mode="auto"), FS, max_duration=2.0)
    (planned,) = (e for e in plan.effects if e.name == "slack_thread")
    stream = renderer(LOUD, 2.0, mode="auto")
    sound(stream)
    there = stream.engine.usage.spans["slack_thread", "D3"].all
    assert len(planned.spans_s) == len(there) > 1
    for (start, stop), (first, last) in zip(planned.spans_s, there, strict=True):
        assert start == pytest.approx(max(first / FS, 0.0), abs=0.1)
        assert stop == pytest.approx(last / FS, abs=0.3)
    score = tmp_path / "loud.mid"
    tw.write_midi(tw.Score([tw.Note(0.05, 1.0, note=50)]), score)
    arguments = ["render", str(score), "-i", "plate_zither", "-o", str(tmp_path / "o.wav"), "--max-duration", "0.5"]
    for choice, active in ((["--effects", "slack_thread"], True), (["--effects", "none"], False)):
        with pytest.raises(SystemExit):
            run([*arguments, *choice, "--json"])
        reports = json.loads(capsys.readouterr().out)["effects"]
        (report,) = (e for e in reports if e["name"] == "slack_thread")
        assert (report["seconds_active"] > 0) == active


def test_it_is_switched_off_as_the_string_decays() -> None:
    """Below 0.4 of the slack, and on again from half of it only."""
    engine = renderer([tw.Note(0.0, 4.0, string="D3", stop=0, force=0.12)], 4.0, mode="auto").engine
    effect, found = effect_of(engine), []
    assert isinstance(effect, ta.SwitchedConnections)
    engine.advance(FS // 10 // 64)
    while engine.state.sample < 3.5 * FS:
        before = engine.running("slack_thread")
        engine.advance(1)
        if before != engine.running("slack_thread"):
            found.append(effect.excursion(engine.system, engine.state, "D3")[0] / SLACK)
    assert len(found) == 1
    assert 0.3 < found[0] < 0.41
