"""Keys, pedals and controllers of a player, one by one."""

from __future__ import annotations

import math

import pytest

import tonewood as tw
from tonewood.instrument.model.assembly import Model, assemble
from tonewood.performance.player.player import GRAIN, Player, rounded
from tonewood.performance.player.strokes import ended
from tonewood.performance.player.timeline import GRID, Play
from tonewood.performance.player.voices import HeldKeys, Voice

FS = 16000


@pytest.fixture(scope="module")
def model() -> Model:
    return assemble(tw.load_instrument("classical_guitar"), FS)


def test_places_are_rounded_to_five_millimetres() -> None:
    assert GRAIN == 5e-3
    for place, near in ((0.1234, 0.125), (0.1224, 0.12), (0.0, 0.0), (0.0026, 0.005), (0.31, 0.31)):
        assert rounded(place) == pytest.approx(near, abs=1e-12)


def test_a_pedal_that_is_lifted_ends_the_notes_of_its_channel() -> None:
    keys, voices = HeldKeys(), {}
    for number, (channel, pitch) in enumerate(((0, 60.0), (0, 64.0), (3, 60.0), (5, 7.0))):
        voice = voices[channel, pitch] = Voice(number, tw.Note(0.0, 1.0, note=pitch, channel=channel))
        keys.press(voice)
        keys.release(voice, pedal=True)
    assert set(keys.pedalled) == set(voices)
    assert not any(voice.key_down for voice in voices.values())
    keys.lift_pedal(3)
    assert keys.ending == [voices[3, 60.0]]
    keys.lift_pedal(1)
    assert len(keys.ending) == 1
    keys.lift_pedal(0)
    assert keys.ending[1:] == [voices[0, 60.0], voices[0, 64.0]]
    assert set(keys.pedalled) == {(5, 7.0)}
    keys.lift_pedal(None)
    assert not keys.pedalled
    assert keys.ending[-1] is voices[5, 7.0]
    assert not any(voice.pedalled or voice.key_down for voice in voices.values())


def test_a_note_that_is_known_ahead_takes_the_controllers_of_its_time(model: Model) -> None:
    """Volume falls 0.1 s before a note that has been known for 0.5 s: it is plucked as if it came then."""
    note = tw.Note(0.5, 0.2, note=64, force=2.0, channel=0)
    quiet, loud = tw.Control(0.4, "cc7", 0.2, 0), tw.Control(0.0, "cc7", 1.0, 0)
    points = int(0.6 * FS / GRID)
    late = {int(0.4 * FS / GRID): [quiet], int(0.5 * FS / GRID): [note]}
    ahead = {0: [loud, note], int(0.4 * FS / GRID): [quiet]}
    never = {0: [loud, note]}
    slips = []  # the forces from the release on; without lookahead the string is drawn faster
    for given, lookahead in ((late, 0.0), (ahead, 0.5), (never, 0.5)):
        (play,) = plays_of(Player(model), given, lookahead, points)
        slips.append([segment for segment in play.gesture.segments if segment.start >= 0.0])
    assert slips[1] == slips[0]
    assert slips[2] != slips[0]


def plays_of(player: Player, given: dict[int, list[tw.Note | tw.Control]], lookahead: float, points: int) -> list[Play]:
    return [
        play for point in range(points) for play in player.feed(given.get(point, []), lookahead, point * GRID).plays
    ]


def test_a_player_is_idle_when_no_bend_is_to_be_done(model: Model) -> None:
    player = Player(model)
    player.feed([tw.Note(0.0, 9.0, note=64, force=2.0, channel=0)], 0.0, 0)
    point = 0
    while not player.hands.idle:
        point += 1
        assert point < 1000
        player.feed([], 0.0, point * GRID)
    player.bend(100.0, 0)
    (line,) = [line for line in player.hands.strings.values() if line.voice is not None]
    line.later.clear()
    assert line.cents != line.target
    assert not player.hands.idle
    player.feed([], 0.0, (point + 1) * GRID)
    while not player.hands.idle:
        point += 1
        player.feed([], 0.0, (point + 1) * GRID)
    assert line.cents == line.target == 100.0


def test_a_note_is_plain_unless_technique_place_or_pitch_is_its_own(model: Model) -> None:
    player = Player(model)

    def plain(**values: object) -> bool:
        note = tw.Note(0.0, 1.0, note=64, force=2.0, channel=0, **{"technique": None, **values})  # type: ignore[arg-type]
        (_,) = plays_of(player, {0: [note]}, 0.0, 1) or [None]
        voice = next(line.voice for line in player.hands.strings.values() if line.voice is not None)
        found = player._is_plain(voice)
        player.release(voice)
        return found

    assert plain()
    voice = next(line.voice for line in player.hands.strings.values() if line.voice is not None)
    voice.event.values["from_bridge"] = 0.1  # type: ignore[index]
    assert not player._is_plain(voice)
    del voice.event.values["from_bridge"]  # type: ignore[attr-defined]
    other = next(name for name in [*model.exciters, "another"] if name != model.default_exciter)
    voice.note = tw.Note(0.0, 1.0, note=64, technique=other)
    assert not player._is_plain(voice)


def test_a_note_that_ends_as_the_next_begins_is_not_damped(model: Model) -> None:
    """Within 1 ms before the next gesture; let go only where 0.1 s are left after that."""
    damped = ended(1.0, "E2", model, 0.0, 1.0 + 1.5e-3)
    assert [change.added_damping is not None for change in damped] == [True]
    assert ended(1.0, "E2", model, 0.0, 1.0 + 0.9e-3) == []
    assert ended(1.0, "E2", model, 0.0, 0.9) == []
    damped, free = ended(1.0, "E2", model, 0.0)
    # a finger leaves a string that has fallen by 90 dB
    fallen = (damped.added_damping or 0.0) * (free.time - damped.time) * 20 / math.log(10)
    assert fallen == pytest.approx(90.0, abs=(damped.added_damping or 0.0) * 2 * GRID / FS * 20 / math.log(10))


def test_a_pedal_holds_from_half_its_way_on(model: Model) -> None:
    player, point = Player(model), 0

    def after(points: int) -> int:
        nonlocal point
        for _ in range(points):
            point += 1
            player.feed([], 0.0, point * GRID)
        return player.n_sounding

    player.feed([tw.Note(0.0, 9.0, note=64, force=2.0, channel=0)], 0.0, 0)
    assert after(60) == 1
    player.control("cc64", 0.5)
    player.release(next(string.voice for string in player.hands.strings.values() if string.voice is not None))
    assert after(60) == 1
    player.control("cc64", 0.5)
    assert after(60) == 1
    player.control("cc64", 0.49)
    assert after(60) == 0


def test_notes_that_nobody_bends_sound_at_their_pitch(model: Model) -> None:
    player = Player(model)
    notes = [tw.Note(0.0, 0.2, note=64, force=2.0, channel=2), tw.Note(0.0, 0.2, note=50, force=2.0)]
    changes = [c for point in range(100) for c in player.feed([] if point else notes, 0.0, point * GRID).changes]
    assert len(changes) > 2
    assert {c.cents for c in changes} <= {None, 0.0}
