"""One player with all lookahead, with none, and with some."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.engine.engine import Engine
from tonewood.performance.player.player import Player
from tonewood.performance.player.playing import perform
from tonewood.performance.player.strokes import tapped, with_force
from tonewood.performance.player.timeline import GRID, Timeline
from tonewood.physics.stepping.forcing import course

FS = 16000
Event = tw.Note | tw.Control


@pytest.fixture(scope="module")
def guitar() -> tw.Instrument:
    return tw.load_instrument("classical_guitar")


@pytest.fixture(scope="module")
def model(guitar: tw.Instrument) -> Model:
    return assemble(guitar, FS)


def events(seed: int) -> list[Event]:
    """Notes, bends and a pedal at times of their own, in order."""
    rng = np.random.default_rng(seed)
    out: list[Event] = [
        tw.Note(
            float(t), float(rng.uniform(0.03, 0.4)), note=float(rng.integers(40, 77)), velocity_midi=80.0, channel=0
        )
        for t in rng.uniform(0.0, 1.2, 12)
    ]
    out += [tw.Control(float(t), "bend", float(rng.integers(-200, 200)), 0) for t in rng.uniform(0.0, 1.2, 4)]
    out += [tw.Control(0.3, "cc64", 1.0, 0), tw.Control(0.9, "cc64", 0.0, 0)]
    return sorted(out, key=lambda event: event.time)


def fed(player: Player, known: list[Event], lookahead: float, to: float = 2.0) -> Timeline:
    """Actions of a player to whom every event becomes known so long (s) before its time."""
    rest, changes, plays = list(known), [], []
    for sample in range(0, int(to * FS), GRID):
        come = []
        while rest and rest[0].time <= sample / FS + lookahead:
            come.append(rest.pop(0))
        decided = player.feed(come, lookahead, sample)
        changes += decided.changes
        plays += decided.plays
    return Timeline(changes, plays)


def plain(timeline: Timeline) -> list[tuple[object, ...]]:
    """Gestures as values that can be compared."""
    return [
        (p.time, p.string, p.exciter, g.segments, g.hold, g.from_bridge, g.noise and g.noise.values.tolist())
        for p in timeline.plays
        for g in (p.gesture,)
    ]


@pytest.mark.parametrize("capo", [0, 3])
def test_a_score_is_all_lookahead(model: Model, capo: int) -> None:
    known = events(1)
    notes, controls = ([e for e in known if isinstance(e, kind)] for kind in (tw.Note, tw.Control))
    whole = perform(tw.Score(notes, controls), model, capo=capo).timeline  # type: ignore[arg-type]
    assert Player(model, capo=capo).feed(reversed(known), math.inf).changes == whole.changes
    assert plain(Player(model, capo=capo).feed(known, math.inf)) == plain(whole)
    assert len(whole.plays) > 8


@pytest.mark.parametrize("seed", [2, 3])
def test_no_lookahead_is_live(model: Model, guitar: tw.Instrument, seed: int) -> None:
    """Notes that come as events are notes played by calls: the same actions."""
    known = events(seed)
    alone = fed(Player(model), known, 0.0)
    live = tw.Live(guitar, FS, prepare=False, oversampling=1)
    calls: list[tuple[float, int, Callable[[], object]]] = []
    voices: dict[int, object] = {}
    for i, event in enumerate(known):
        if isinstance(event, tw.Note):
            calls.append((event.time, i, lambda e=event, i=i: voices.update({i: live.player.note_on(e)})))
            calls.append((event.key_up, i, lambda i=i: live.player.release(voices[i])))  # type: ignore[arg-type]
        elif event.kind == "bend":
            calls.append((event.time, i, lambda e=event: live.player.bend(e.value, 0)))
        else:
            calls.append((event.time, i, lambda e=event: live.player.control(e.kind, e.value, 0)))
    calls.sort(key=lambda call: call[:2])
    feed, made = live.player.feed, Timeline([], [])

    def watched(none: list[Event], lookahead: float, sample: int) -> Timeline:
        while calls and calls[0][0] <= sample / FS:
            calls.pop(0)[2]()
        decided = feed(none, lookahead, sample)
        made.changes.extend(decided.changes)  # type: ignore[attr-defined]
        made.plays.extend(decided.plays)  # type: ignore[attr-defined]
        return decided

    live.player.feed = watched  # type: ignore[method-assign, assignment]
    # every point of the grid, as the player may step many at once
    type(live.player).idle_points, before = property(lambda player: 1), type(live.player).idle_points
    try:
        live.process(2 * FS)
    finally:
        type(live.player).idle_points = before
    n = sum(change.time < 1.9 for change in alone.changes)
    assert n > 20
    assert made.changes[:n] == alone.changes[:n]
    assert plain(made) == plain(alone)


def test_some_lookahead_prepares_in_time(model: Model) -> None:
    """Gestures begin, and have their force, as in a score; without lookahead they are late by the ramp."""
    known: list[Event] = [
        tw.Note(0.1 + 0.17 * i, 0.1, string=name, stop=stop, force=1.0)
        for i, (name, stop) in enumerate([("E4", 3), ("B3", 0), ("E4", 5), ("G3", 2), ("E2", 1), ("E4", 5)])
    ]
    score = perform(tw.Score(known), model).timeline  # type: ignore[arg-type]

    def heard(timeline: Timeline) -> dict[tuple[str | None, float], tuple[float, float]]:
        return {(p.string, round(p.time, 9)): (p.start, p.gesture.force(-0.01)) for p in timeline.plays}

    some = heard(fed(Player(model), known, 0.05))
    assert {k: pytest.approx(v) for k, v in heard(score).items()} == some
    late = fed(Player(model, ramp=5e-3), known, 0.0)
    delays = [p.time - event.time for p, event in zip(late.plays, known, strict=True)]
    assert min(delays) >= 5e-3
    assert max(delays) <= 5e-3 + GRID / FS
    stops = [(c.string, c.stop) for c in fed(Player(model), known, 0.05).changes if c.stop]
    assert stops == [(c.string, c.stop) for c in score.changes if c.stop]


def test_later_notes_that_are_known_choose_the_string(model: Model) -> None:
    """B3 is an open string, but not where the chord that follows at once wants it to ring on elsewhere."""
    known: list[Event] = [tw.Note(0.1, 2.0, note=59.0, force=1.0), tw.Note(0.4, 1.0, note=60.0, force=1.0)]
    known[1:] = [tw.Note(0.4, 1.0, string="B3", stop=1, force=1.0)]
    (whole, _), (some, _), (none, _) = (
        [play.string for play in sorted(timeline.plays, key=lambda p: p.time)]
        for timeline in (
            perform(tw.Score(known), model).timeline,  # type: ignore[arg-type]
            fed(Player(model), known, 0.5),
            fed(Player(model), known, 0.1),
        )
    )
    assert whole == some == "G3"
    assert none == "B3"


def test_actions_in_a_window_sound(model: Model) -> None:
    """The engine takes them as they are: no action is in its past."""
    player, engine, known = Player(model), Engine(model, Timeline((), ())), events(4)
    peak = 0.0
    for sample in range(0, FS, GRID):
        come = [e for e in known if (sample - GRID) / FS + 0.03 < e.time <= sample / FS + 0.03 or sample == 0 > e.time]
        decided = player.feed(come, 0.03, sample)
        assert all(change.time >= sample / FS - 1e-9 for change in decided.changes)
        assert all(play.start >= sample / FS - 1e-9 for play in decided.plays)
        engine.schedule.add(decided.changes, decided.plays)
        peak = max(peak, float(np.abs(engine.advance(1)).max()))
    assert peak > 1e-3


def test_every_string_of_a_course_is_plucked_by_its_own_gesture() -> None:
    """Live as in a score: the second string of a course has its own pitch, and the gesture the name of its exciter."""
    model = assemble(tw.load_instrument("twelve_string_guitar"), FS)
    note = tw.Note(0.2, 0.5, note=43.0, force=1.0, technique="pluck")

    def strokes(timeline: Timeline) -> dict[str, tuple[object, ...]]:
        return {str(p[1]): (p[2], p[3], *p[5:]) for p in plain(timeline)}

    live = strokes(fed(Player(model, ramp=0.1), [note], 0.0))
    assert len(live) == 2
    assert live == strokes(perform(tw.Score([note]), model).timeline)


@pytest.mark.parametrize("seed", [2, 3])
def test_points_at_which_nothing_is_done_can_be_left_out(model: Model, seed: int) -> None:
    """A player that is looked at only where it says so, and where an event comes, does the same."""
    known, whole = events(seed), fed(Player(model), events(seed), 0.0)
    player, changes, plays, point, looked = Player(model), [], [], 0, 0
    while point * GRID < 2.0 * FS:
        come = [e for e in known if e.time <= point * GRID / FS]
        known = known[len(come) :]
        decided = player.feed(come, 0.0, point * GRID)
        changes += decided.changes
        plays += decided.plays
        following = math.ceil(known[0].time * FS / GRID) if known else 1 << 30
        point, looked = min(point + player.idle_points, max(following, point + 1)), looked + 1
    assert changes == whole.changes
    assert plain(Timeline(changes, plays)) == plain(whole)
    assert looked < 0.8 * 2.0 * FS / GRID


@pytest.mark.parametrize("kind", ["cc7", "cc11"])
def test_a_volume_of_zero_refuses_no_note(kind: str) -> None:
    """The least force of a plectrum is 1 mN; a note that asks for less itself is still refused."""
    steel = assemble(tw.load_instrument("steel_guitar"), 48000.0)
    score = tw.Score([tw.Note(0.5, 0.5, note=50), tw.Note(1.0, 0.5, note=50, velocity_midi=127)])
    faded = replace(score, notes=[replace(n, velocity_midi=127) for n in score.notes], controls=[
        tw.Control(0.0, kind, 0.0), tw.Control(0.8, kind, 0.5)
    ])  # fmt: skip
    played = perform(faded, steel)
    assert [assigned.note.force for assigned in played.notes] == [1e-3, pytest.approx(2.5 * 0.25)]
    assert with_force(tw.Note(0.0, note=50, force=1e-4), steel, 1.0).force == 1e-4
    with pytest.raises(ScoreError, match=r"force is 0\.0001 N"):
        perform(tw.Score([tw.Note(0.5, 0.5, note=50, force=1e-4)]), steel)


def test_the_speed_of_a_hammer_is_no_force_of_a_tap() -> None:
    """A tap at a velocity has the force of the bundle where velocities are speeds, and a note's own force."""
    bundle = tw.load_instrument("struck_monochord")
    tap = {"plugin": "force_pulse", "at": "body.bridge", "duration": 1e-3, "force": 5.0}
    model = assemble(bundle.replace({"exciters.tap": tap}), FS)
    assert model.playing.velocity.parameter.endswith(".velocity")
    note = tw.Note(0.0, 0.5, technique="tap", velocity_midi=100)

    def peak(one: tw.Note) -> float:
        play = tapped(one, model, "")
        assert play is not None
        return float(course(play.gesture.segments, np.linspace(-1e-3, 1e-3, 401)).max())

    assert peak(note) == pytest.approx(5.0, rel=1e-3)
    assert peak(replace(note, force=2.0)) == pytest.approx(2.0, rel=1e-3)
