"""From notes to hands: gestures, their times and strings, and the end of a note."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import tonewood as tw
from tonewood.errors import ScoreError
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.player.playing import Performance, _glided, perform
from tonewood.performance.player.strokes import BEND_RATE
from tonewood.performance.player.timeline import GRID
from tonewood.performance.score.controllers import Controllers, History


@pytest.fixture(scope="module")
def guitar() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), 48000)


@pytest.fixture(scope="module")
def harp() -> Model:
    return assemble(tw.load_instrument("african_harp"), 48000)


def test_a_pluck_draws_before_its_time_and_lets_go_on_it(guitar: Model) -> None:
    played = perform(tw.Score([tw.Note(1.0, 0.5, note=64, force=3.0)]), guitar)
    (play,) = played.timeline.plays
    assert play.time == 1.0
    assert play.start == pytest.approx(0.98)
    assert play.gesture.force(0.0) == pytest.approx(3.0)
    assert play.gesture.force(-0.0201) == 0.0
    assert play.gesture.force(0.0201) == 0.0
    rise = [play.gesture.force(t) for t in np.linspace(-0.02, 0.0, 50)]
    assert all(a <= b for a, b in itertools.pairwise(rise))


def test_velocity_becomes_force_by_the_bundles_curve(guitar: Model) -> None:
    """0.12 (5 / 0.12)^((v - 1) / 126) N."""
    notes = [tw.Note(float(i), 0.5, note=60, velocity_midi=v) for i, v in enumerate((1, 64, 127))]
    forces = [p.gesture.force(0.0) for p in perform(tw.Score(notes), guitar).timeline.plays]
    assert forces == pytest.approx([0.12, (0.12 * 5) ** 0.5, 5.0])
    quieter = tw.Score(notes[2:], [tw.Control(0.0, "cc7", 0.5)])
    assert perform(quieter, guitar).timeline.plays[0].gesture.force(0.0) == pytest.approx(1.25)


def test_a_damped_string_is_damped_at_the_end_of_its_note_and_let_go_later(guitar: Model) -> None:
    changes = perform(tw.Score([tw.Note(0.5, 1.0, note=47, force=1.0)]), guitar).timeline.changes
    stopped, damped, open_again = changes
    assert (stopped.stop, stopped.added_damping) == (2, 0.0)
    assert stopped.time == pytest.approx(0.48)
    assert damped.time == pytest.approx(1.5)
    assert damped.added_damping == pytest.approx(math.log(1000) / 0.12)
    assert open_again.time > damped.time + 0.12
    assert (open_again.stop, open_again.added_damping) == (0, 0.0)


def test_a_string_that_rings_is_left_alone(harp: Model) -> None:
    changes = perform(tw.Score([tw.Note(0.5, 0.1, string="s4", force=1.0)]), harp).timeline.changes
    assert [c.added_damping for c in changes] == [0.0]


def test_a_note_that_follows_at_once_ends_no_pluck_before_its_time(guitar: Model) -> None:
    notes = [tw.Note(0.1 + 0.008 * i, 0.1, string="E4", stop=i, force=2.0) for i in range(5)]
    plays = perform(tw.Score(notes), guitar).timeline.plays
    assert len(plays) == 5
    for before, after in itertools.pairwise(plays):
        assert after.start >= before.stop - 1e-12
        times = np.linspace(after.gesture.start, after.gesture.stop, 20000)
        force = np.array([after.gesture.force(t) for t in times])
        assert force.max() == pytest.approx(2.0, rel=1e-3)
        assert np.abs(np.diff(force)).max() < 0.05  # no step


def test_bends_follow_their_channel_and_glide(guitar: Model) -> None:
    score = tw.Score(
        [tw.Note(0.1, 1.0, note=64, force=1.0, channel=0), tw.Note(0.1, 1.0, note=55, force=1.0, channel=1)],
        [tw.Control(0.5, "bend", 400.0, 0), tw.Control(0.7, "bend", 0.0, 0), tw.Control(0.05, "bend", -30.0, 1)],
    )
    played = perform(score, guitar)
    strings = {a.note.channel: a.string for a in played.notes}
    first = [c for c in played.timeline.changes if c.string == strings[0] and c.cents is not None]
    bent = [c.cents or 0.0 for c in first if c.time < 1.0]
    assert max(bent) == 400.0
    assert bent[-1] == 0.0
    assert max(abs(a - b) for a, b in itertools.pairwise(bent)) <= 54.0
    assert next(c.time for c in first if c.cents == 400.0) < 0.52
    (start,) = [c for c in played.timeline.changes if c.string == strings[1] and c.stop is not None and c.time < 1.0]
    assert start.cents == -30.0


def test_plucking_place_follows_its_controller(guitar: Model) -> None:
    """cc74 from 0.03 m to 0.25 m; the note's own place counts more."""
    score = tw.Score(
        [
            tw.Note(0.1, 0.2, note=64, force=1.0),
            tw.Note(0.6, 0.2, note=64, force=1.0),
            tw.Note(1.1, 0.2, note=64, force=1.0, from_bridge=0.2),
        ],
        [tw.Control(0.5, "cc74", 1.0)],
    )
    places = [p.gesture.from_bridge for p in perform(score, guitar).timeline.plays]
    assert places == pytest.approx([0.105, 0.25, 0.2])


def test_a_technique_may_play_the_body(guitar: Model) -> None:
    played = perform(tw.Score([tw.Note(0.1, 0.2, technique="tap", force=7.0)]), guitar)
    (tap,) = played.timeline.plays
    assert (tap.string, tap.at) == (None, "body.bridge_G3")
    assert max(tap.gesture.force(t) for t in np.linspace(0, 1e-3, 101)) == pytest.approx(7.0)
    with pytest.raises(ScoreError, match="there is no technique 'kick'; there are pluck, rest, flesh, harmonic, palm"):
        perform(tw.Score([tw.Note(0.1, technique="kick")]), guitar)


def test_what_cannot_be_played_is_listed(guitar: Model) -> None:
    notes = [tw.Note(0.1 * i, 0.2, note=n, force=1.0, channel=3) for i, n in enumerate((20, 64, 110))]
    played = perform(tw.Score(notes), guitar)
    assert [(d.note, d.channel) for d in played.dropped] == [(20, 3), (110, 3)]
    assert [a.note.note for a in played.notes] == [64]


def test_one_channel_per_string(guitar: Model) -> None:
    notes = [tw.Note(0.1, 0.2, note=60, force=1.0, channel=c) for c in (2, 3)]
    played = perform(tw.Score(notes), guitar, channel_per_string=True)
    names = list(guitar.strings)
    assert {a.note.channel: a.string for a in played.notes} == {2: names[2], 3: names[3]}


class Counted(float):
    """A time that counts how often it is compared."""

    count = 0

    def _compared(self, how: str, other: float) -> bool:
        Counted.count += 1
        return bool(getattr(float, how)(self, other))

    def __lt__(self, other: float) -> bool:
        return self._compared("__lt__", other)

    def __le__(self, other: float) -> bool:
        return self._compared("__le__", other)

    def __gt__(self, other: float) -> bool:
        return self._compared("__gt__", other)

    def __ge__(self, other: float) -> bool:
        return self._compared("__ge__", other)


@pytest.mark.parametrize(("instrument", "kind"), [("classical_guitar", "bend"), ("electric_bass", "cc64")])
def test_controls_cost_n_log_n(instrument: str, kind: str) -> None:
    """Each of n notes has 20 bends, or changes of a controller that chooses the technique."""
    base = tw.load_instrument(instrument)
    exciter = base.spec.playing.exciter or next(iter(base.exciters))
    model = assemble(base.replace({"playing.switches": {"cc64": exciter}}), 48000)
    pitch = base.open_note(base.string_names[0])

    def compared(n: int) -> int:
        notes = [tw.Note(0.5 * i, 0.4, note=pitch, force=1.0, channel=0) for i in range(n)]
        values = [5.0, -5.0] if kind == "bend" else [1.0, 0.0]
        controls = [tw.Control(Counted(0.025 * i), kind, values[i % 2], 0) for i in range(20 * n)]
        Counted.count = 0
        assert len(perform(tw.Score(notes, controls), model).timeline.plays) == n
        return Counted.count

    for n in (40, 160):
        # a few passes, sorts of sorted lists, and some bisections per note; all with all would be 20 n^2
        assert 0 < compared(n) < 8 * 20 * n + 8 * n * math.log2(20 * n)


def test_a_controller_is_at_its_latest_value_of_the_note_s_channel(guitar: Model) -> None:
    line = [tw.Control(1.0, "cc1", 0.1, 0), tw.Control(2.0, "cc1", 0.2), tw.Control(2.0, "cc1", 0.3, 1)]
    line += [tw.Control(3.0, "cc1", 0.4, 0), tw.Control(0.5, "cc2", 0.5, 3)]
    at = Controllers(line).at
    asked = [(0, 0.9), (0, 1.0), (0, 2.5), (0, 3.5), (1, 1.5), (1, 2.0), (2, 1.9), (2, 9.0), (None, 2.0)]
    assert [at("cc1", c, t) for c, t in asked] == [None, 0.1, 0.2, 0.4, None, 0.3, None, 0.2, 0.2]
    assert at("cc2", 0, 9.0) is None
    assert at("cc2", 3, 0.5) == 0.5


def test_bends_between_two_times() -> None:
    history = History([tw.Control(t, "bend", v, 0) for t, v in ((2.0, 2.0), (1.0, 1.0), (3.0, 3.0), (3.0, 4.0))])
    assert [history.at(t) for t in (0.5, 1.0, 2.5, 3.0)] == [None, 1.0, 2.0, 4.0]
    assert [c.value for c in history.between(1.0, 3.0)] == [2.0]
    assert [c.value for c in history.between(0.0, 9.0)] == [1.0, 2.0, 3.0, 4.0]


def test_places_are_refused_beyond_the_string_and_reported_where_moved(guitar: Model) -> None:
    """E2 is 0.65 m long; stopped at 12 it speaks over 0.325 m."""

    def played(stop: int, x: float) -> Performance:
        return perform(tw.Score([tw.Note(0.0, 0.1, string="E2", stop=stop, force=1.0, from_bridge=x)]), guitar)

    for stop, x in ((0, 0.1), (0, 0.643), (12, 0.321)):
        asked = played(stop, x)
        assert asked.timeline.plays[0].gesture.from_bridge == x
        assert not asked.warnings
    for stop, x, at in ((0, 0.001, 0.0065), (0, 0.65, 0.6435), (12, 0.4, 0.32175)):
        moved = played(stop, x)
        assert moved.timeline.plays[0].gesture.from_bridge == pytest.approx(at)
        assert moved.warnings[0].endswith("beyond the stop: 1")
    with pytest.raises(ScoreError, match=r"exciters\.pluck: the note at 0 s on string E2: from_bridge is 0\.66 m"):
        played(0, 0.66)
    said = r"^score: exciters\.pluck: the note at 0 s on string E2: force is 1000000000 N; at most 1000 N is allowed"
    with pytest.raises(ScoreError, match=said):
        perform(tw.Score([tw.Note(0.0, 0.1, string="E2", stop=0, force=1e9)]), guitar)


def test_what_nobody_reads_is_counted(guitar: Model) -> None:
    controls = [tw.Control(0.1 * i, kind, 0.1 * i, 0) for i in range(3) for kind in ("cc1", "cc7", "cc64", "bend")]
    score = tw.Score([tw.Note(0.0, 0.1, note=50)], controls, ignored={"channel pressure": 2, "controller 1": 4})
    assert perform(score, guitar).ignored == {"channel pressure": 2, "controller 1": 7}


def test_a_note_that_ends_while_the_next_is_prepared_leaves_no_damper_on_it(guitar: Model) -> None:
    """The string rings on after the second pluck, whatever gap up to its preparation the score leaves."""
    for gap in (0.0, 0.005, 0.015, 0.019, 0.025, 0.05):
        notes = [tw.Note(0.5, 0.5 - gap, string="E4", stop=7, force=1.0), tw.Note(1.0, 2.0, string="E4", stop=7)]
        made = perform(tw.Score(notes), guitar).timeline
        second = made.plays[1]
        damping = 0.0
        for change in made.changes:
            if change.time <= second.time + 0.5 and change.added_damping is not None:
                damping = change.added_damping
        assert damping == 0.0, gap
        damped = [c.time for c in made.changes if c.added_damping and c.time < second.time]
        assert all(time < second.start for time in damped)
        assert bool(damped) == (gap > 0.021)


def test_leaps_of_a_bend_there_and_back_share_their_steps(guitar: Model) -> None:
    """Each different bend is a set of modes to compute: a wheel thrown to and fro has as many as one throw."""
    controls = [tw.Control(0.3 * i, "bend", 4800.0 * (-1) ** i, 0) for i in range(1, 9)]
    line = _glided(controls, GRID / guitar.fs)
    step = BEND_RATE * GRID / guitar.fs
    values = [c.value for c in line]
    assert len(set(values)) <= 2 * 4800.0 / step + 4
    assert max(abs(b - a) for a, b in itertools.pairwise([0.0, *values])) <= step * (1 + 1e-9)
    assert [History(line).at(0.3 * i + 0.29) for i in range(1, 9)] == [4800.0 * (-1) ** i for i in range(1, 9)]


def test_very_many_different_bends_are_foretold(guitar: Model) -> None:
    controls = [tw.Control(0.002 * i, "bend", 0.1 * i, 0) for i in range(2500)]
    score = tw.Score([tw.Note(0.0, 6.0, note="E4", velocity_midi=80, channel=0)], controls)
    assert any("different bends of strings" in line for line in perform(score, guitar).warnings)


def test_strings_are_not_bent_before_the_first_bend() -> None:
    """A bend of 0 then changes nothing, and the way to another one begins at 0 cents."""
    tick = 2.0 / BEND_RATE
    assert _glided([tw.Control(0.0, "bend", 0.0, 0)], tick) == []
    assert [c.value for c in _glided([tw.Control(0.0, "bend", 2.5, 0)], tick)] == [2.0, 2.5]
