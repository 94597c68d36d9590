"""A render foreseen: the effects that will run and when, against the render itself."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from effect_scenes import TENSION, duet, sound

import tonewood as tw
from tonewood.cli.main import run as run_and_exit
from tonewood.performance.player.timeline import Change, Timeline
from tonewood.sound.render import plan as planning

SCALE = Path(__file__).parents[2] / "examples" / "scores" / "scale.mid"
NOTES = [
    tw.Note(0.0, 0.5, note=64, force=3.0),
    tw.Note(0.6, 0.5, note=59, force=0.2),
    tw.Note(1.0, 1, note=61, force=5),
]
FS = 24000


def run(arguments: list[str]) -> int | str | None:
    with pytest.raises(SystemExit) as stop:
        run_and_exit(arguments)
    return stop.value.code


def test_switches_are_foreseen() -> None:
    foreseen = tw.plan(tw.Score(NOTES), duet(), FS, max_duration=2.0)
    stream = tw.Renderer(tw.Score(NOTES), duet(), FS, max_duration=2.0)
    sound(stream)
    planned = {e.component: e for e in foreseen.effects if e.name == "tension_modulation"}
    assert set(planned) == {"B3", "E4"}
    for name, effect in planned.items():
        there = stream.engine.usage.spans[TENSION, name].all
        assert len(effect.spans_s) == len(there)
        assert effect.spans_s
        for (start, stop), (first, last) in zip(effect.spans_s, there, strict=True):
            assert start == pytest.approx(max(first / FS, 0.0), abs=0.03)
            assert stop == pytest.approx(last / FS, abs=0.35)  # the sketch looks at all bounds that seldom
        assert "cents; the budget is 0.5" in effect.why
        assert effect.predicted_s is not None
    assert foreseen.duration_s == pytest.approx(2.0, abs=1e-3)
    assert foreseen.predicted_s > 0


def test_a_wide_budget_leaves_the_tension_out() -> None:
    foreseen = tw.plan(tw.Score(NOTES), duet(), FS, max_duration=1.5, budget_cents=100.0, budget_db=0.0)
    # until something is heard the missing sound is unknown
    assert all(e.seconds < 0.6 for e in foreseen.effects if e.name == "tension_modulation")


@pytest.mark.slow
def test_very_many_bends_are_counted_and_not_played(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan of them would take as long as the render; each is taken to need 0.01 s here, and none is stepped."""
    controls = [tw.Control(0.002 * i, "bend", 0.1 * i, 0) for i in range(1, 1001)]
    note = tw.Note(0.0, 3.0, note=64, force=3.0, channel=0)
    score, few = tw.Score([note], controls), tw.Score([note], controls[:500])
    monkeypatch.setattr(planning, "seconds_per_bend", lambda model, bends: 0.01)
    exchanges = []
    summary = tw.Renderer.summary
    monkeypatch.setattr(tw.Renderer, "summary", lambda self: exchanges.append(self.engine.counters) or summary(self))
    # a point of the grid is 64 samples, 2.7 ms: some bends share one
    foreseen = tw.plan(score, duet(), FS, max_duration=0.4)
    points = {int(control.time * FS // 64) for control in controls if control.time < 0.4}
    assert foreseen.bends == pytest.approx(len(points), abs=2)
    assert foreseen.bends_s == pytest.approx(0.01 * foreseen.bends)
    assert foreseen.predicted_s > foreseen.bends_s
    assert max(counters.exchanges for counters in exchanges) < 10
    foreseen = tw.plan(few, duet(), FS, max_duration=0.4)
    assert (foreseen.bends, foreseen.bends_s) == (0, 0.0)
    assert max(counters.exchanges for counters in exchanges) > 50


def test_the_time_of_a_bend_is_that_of_exchanging_its_strings() -> None:
    """Each point of the grid that has bends is exchanged once, however many strings are bent at it."""
    model = tw.Renderer(tw.Score(NOTES), duet(), FS).model
    bends = {3 + 5 * i: [Change(0.1, name, cents=float(i)) for name in ("B3", "E4")] for i in range(100)}
    assert planning.seconds_per_bend(model, bends) > 0
    line = planning.bends_by_point(Timeline([change for point in bends.values() for change in point], ()), FS)
    assert list(line) == [int(0.1 * FS // 64)]
    still = [Change(0.1, "B3", stop=2.0, cents=1.0), Change(0.1, "E4", damper=0.0)]
    assert planning.bends_by_point(Timeline(still, ()), FS) == {}


def test_a_time_is_that_of_the_beginning_by_the_work_of_the_whole() -> None:
    """Steps by the steps of the sketch, control by its control; what effects took of the beginning is left out."""
    first, whole = planning.Spent(stepping=0.5, control=0.2), planning.Spent(stepping=5.0, control=0.6)
    timed = planning.Spent(stepping=3.0, control=1.0)
    assert planning.predicted(timed, 1.0, first, whole) == pytest.approx(2.0 * 10 + 1.0 * 3)
    assert planning.predicted(timed, 4.0, first, whole) == pytest.approx(1.0 * 3)  # a clock may say more
    assert planning.predicted(timed, 1.0, planning.Spent(), whole) == pytest.approx(5.0 + 0.6)  # too short to tell


def test_choices_are_reported() -> None:
    everything = tw.plan(tw.Score(NOTES), duet(), FS, max_duration=0.3, effects="all")
    rises = [e for e in everything.effects if e.name == "tension_modulation"]
    assert all(e.seconds >= 0.3 and e.why == "always: effects are all" for e in rises)
    plain = tw.plan(tw.Score(NOTES), duet(), FS, max_duration=0.3, effects="none")
    left = [e for e in plain.effects if e.name in ("tension_modulation", "second_polarization")]
    assert len(left) == 4
    assert all(not e.spans_s and e.why == "left out: effects are none" for e in left)


def test_a_string_with_longitudinal_motion_is_foreseen_as_it_runs() -> None:
    guitar = duet().replace({"strings.B3.plugin": "geometric_string"})
    score = tw.Score([tw.Note(0.1, 1, note=59, force=3.0)])
    foreseen = tw.plan(score, guitar, 24000, max_duration=0.3)
    spans = {(e.name, e.component): e.spans_s for e in foreseen.effects}
    # it is drawn some moments before the note
    assert 0.0 <= spans["tension_modulation", "B3"][0][0] < 0.1 < spans["tension_modulation", "B3"][0][1]
    assert spans["longitudinal", "B3"] == spans["tension_modulation", "B3"]
    stream = tw.Renderer(score, guitar, 24000, max_duration=0.3)
    sound(stream)
    active = {(e.name, e.component): e.seconds_active for e in stream.summary().effects}
    for effect in ("tension_modulation", "longitudinal"):
        planned = sum(stop - start for start, stop in spans[effect, "B3"])
        assert active[effect, "B3"] == pytest.approx(planned, abs=0.06)
        assert active[effect, "B3"] < 0.29


@pytest.mark.slow
def test_contacts_and_outputs_are_foreseen() -> None:
    low = {"connections.frets.action_first": 2e-4, "connections.frets.action_twelfth": 5e-4}
    bass = tw.load_instrument("electric_bass").replace(low)
    foreseen = tw.plan(tw.Score([tw.Note(0.2, 1, note=43, force=8.0)]), bass, FS, max_duration=0.5)
    frets = next(e for e in foreseen.effects if (e.name, e.component) == ("frets", "G2"))
    assert frets.spans_s
    assert frets.spans_s[0][0] > 0.1
    recorded = {e.component: e.why for e in foreseen.effects if e.name == "outputs"}
    assert list(recorded.values()).count("it is recorded") == 1


@pytest.mark.slow
def test_the_command_tells_as_text_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["plan", str(SCALE), "-i", "monochord", "--max-duration", "0.3"]
    assert run(arguments) == 0
    text = capsys.readouterr().out
    assert text.startswith("0.30 s of sound in about ")
    assert "body_modes" not in text
    assert run([*arguments, "--verbose"]) == 0
    assert "body_modes body: 0.30 s" in capsys.readouterr().out
    assert run([*arguments, "--json", "--effects", "none", "--budget-cents", "0.1"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["schema"] == "tonewood-plan/1"
    assert {"name", "component", "spans_s", "why", "predicted_s"} == set(reported["effects"][0])
    assert run([*arguments, "--budget-cents", "-1"]) == 2
    assert capsys.readouterr().err == "tonewood: --budget-cents: is -1 cents; 0 to 100 are allowed\n"


def test_a_render_tells_what_ran(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["render", str(SCALE), "-i", "monochord", "-o", str(tmp_path / "out.wav"), "--max-duration", "0.3"]
    assert run([*arguments, "--json"]) == 0
    effects = json.loads(capsys.readouterr().out)["effects"]
    for effect in effects:
        assert set(effect) == {f.name for f in fields(tw.EffectReport)}
        assert np.isfinite(effect["seconds_active"])
    assert {"name": "body_modes", "component": "body"}.items() <= next(
        e for e in effects if e["name"] == "body_modes"
    ).items()
    assert run([*arguments, "--effects", "second_polarization,wind"]) == 2
    assert capsys.readouterr().err.startswith("tonewood: effects: there is no effect 'wind'; auto, all, none or ")


def test_of_a_long_score_the_beginning_is_looked_at(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """By the count of notes, or by the time that the sketch takes; the rest is in proportion, and that is said."""
    notes = [tw.Note(1.25 * i, 1.25, note=64, force=1.0) for i in range(16)]
    reached: list[float] = []
    whole = tw.plan(tw.Score(notes[:2]), "monochord", 16000, tail=2.0, progress=reached.append)
    assert whole.sketched_s == whole.duration_s == pytest.approx(1.25 + 2.0, abs=0.1)
    reached.clear()
    monkeypatch.setattr(planning, "_MOST_NOTES", 2)
    for most in (1e9, 0.0):
        monkeypatch.setattr(planning, "_MOST_COMPUTING", most)
        foreseen = tw.plan(tw.Score(notes), "monochord", 16000, tail=2.0, progress=reached.append)
        assert foreseen.sketched_s == pytest.approx(2.5 if most else 1.0, abs=0.2)
        assert foreseen.duration_s == pytest.approx(16 * 1.25 + 2.0)
    assert max(reached) < 2.7
    tw.write_midi(tw.Score(notes), tmp_path / "long.mid")
    assert run(["plan", str(tmp_path / "long.mid"), "-i", "monochord", "--fs", "16000"]) == 0
    assert "only the first 1.0 s were looked at" in capfd.readouterr().out


def test_the_rest_of_a_score_takes_time_in_proportion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps by seconds of sound, work between them by notes: with times of 2 s and 3 s in a sketch of half of both."""
    monkeypatch.setattr(planning, "_MOST_NOTES", 2)
    monkeypatch.setattr(planning.Spent, "of", classmethod(lambda cls, engine: cls(2.0, 3.0)))
    monkeypatch.setattr(planning, "_switched_rates", lambda engine: {})
    notes = [tw.Note(float(i), 1.0, note=64, force=1.0) for i in range(4)]
    foreseen = tw.plan(tw.Score(notes), "monochord", 16000, max_duration=4.0)
    assert foreseen.sketched_s == pytest.approx(2.0)
    assert foreseen.predicted_s == pytest.approx(2 * 2.0 + 2 * 3.0)


def test_of_many_moves_of_controllers_the_first_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """But a second of the notes at least, and bends are no such moves."""
    monkeypatch.setattr(planning, "_MOST_MOVES", 10)
    notes = [tw.Note(1.25 * i, 1.25, note=64, force=1.0) for i in range(8)]
    for kind, step, seconds in (("cc64", 0.25, 2.5), ("cc64", 0.01, 1.0), ("bend", 0.25, 10.8)):
        moves = [tw.Control(step * i, kind, 0.0) for i in range(40)]
        foreseen = tw.plan(tw.Score(notes, moves), "monochord", 16000, tail=2.0)
        assert foreseen.sketched_s == pytest.approx(seconds, abs=0.2), kind
        assert foreseen.duration_s == pytest.approx(10.8 if kind == "bend" else 12.0, abs=0.2)  # it rings off before
