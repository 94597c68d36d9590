"""Keys and pedals played live: the same strings are free as in a score."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tonewood as tw
from pianos import piano
from tonewood.support.units import decibel

FS = 24000


@pytest.fixture(scope="module")
def grand(tmp_path_factory: pytest.TempPathFactory) -> tw.Instrument:
    return piano(tmp_path_factory.mktemp("keys"), ["C3", "C4", "C5"])


def played(grand: tw.Instrument, events: dict[float, Any], to: float = 1.2, block: int = 240) -> np.ndarray:
    live = tw.Live(grand, prepare=False, fs=FS)
    due, out = sorted(events), []
    while live.frames < to * FS:
        while due and round(due[0] * FS) <= live.frames:
            events[due.pop(0)](live)
        until = min(round(due[0] * FS) if due else round(to * FS), live.frames + block, round(to * FS))
        out.append(live.process(until - live.frames))
    return np.concatenate(out)[:, 0]


def level(sound: np.ndarray, start: float, stop: float) -> float:
    return decibel(float(np.sqrt(np.mean(sound[int(start * FS) : int(stop * FS)] ** 2))))


@pytest.mark.slow
def test_keys_and_pedals(grand: tw.Instrument) -> None:
    strike, release = (lambda live: live.note_on("C4", 90)), (lambda live: live.note_off("C4"))
    alone = played(grand, {0.05: strike, 0.35: release})
    held = played(grand, {0.05: strike})
    sustained = played(grand, {0.05: strike, 0.2: lambda live: live.control(64, 1.0), 0.35: release})
    half = played(grand, {0.05: strike, 0.2: lambda live: live.control(64, 0.5), 0.35: release})
    middle = played(grand, {0.05: strike, 0.2: lambda live: live.control(66, 1.0), 0.35: release})
    too_late = played(grand, {0.05: strike, 0.35: release, 0.4: lambda live: live.control(66, 1.0)})
    late = [level(sound, 0.9, 1.2) for sound in (alone, half, middle, sustained)]
    assert late[0] < late[1] - 10
    assert late[1] < late[2] - 3
    assert late[2] == pytest.approx(level(held, 0.9, 1.2), abs=0.5)
    assert late[3] == pytest.approx(late[2], abs=2.0)
    assert np.array_equal(alone, too_late)
    # all strings of the key: after the blow as loud as in a score
    score = tw.render(tw.Score([tw.Note(0.05, 0.3, note=60, velocity_midi=90)]), grand, fs=FS, max_duration=1.2)
    assert level(alone, 0.1, 0.3) == pytest.approx(level(score.samples[:, 0], 0.1, 0.3), abs=0.3)


def test_una_corda(grand: tw.Instrument) -> None:
    """Two of three strings: the sum of their amplitudes while they are in phase, of their energies later."""
    strike = {0.05: lambda live: live.note_on("C4", 90)}
    soft = {0.0: lambda live: live.control(67, 1.0)} | strike
    less = level(played(grand, soft, 0.1), 0.05, 0.1) - level(played(grand, strike, 0.1), 0.05, 0.1)
    assert decibel(2 / 3) < less < decibel(2 / 3) / 2


def test_blocks_change_nothing(grand: tw.Instrument) -> None:
    events = {
        0.01: lambda live: live.note_on("C4", 100),
        0.1: lambda live: live.control(64, 1.0),
        0.15: lambda live: (live.note_off("C4"), live.note_on("C3", 60)),
        0.3: lambda live: live.control(64, 0.5),
    }
    first = played(grand, events, 0.5, 64)
    assert np.array_equal(first, played(grand, events, 0.5, 1000))


def test_a_key_struck_and_released_at_once_does_not_lift_the_half_pressed_dampers(grand: tw.Instrument) -> None:
    def struck(released: float) -> np.ndarray:
        half = {0.0: lambda live: live.control(64, 0.5), 0.05: lambda live: live.note_on("C4", 90)}
        return played(grand, half | {released: lambda live: live.note_off("C4")})

    # 10 ms are shorter than the shortest note, 20 ms; 30 ms longer
    short, longer = struck(0.06), struck(0.08)
    assert level(short, 0.9, 1.2) == pytest.approx(level(longer, 0.9, 1.2), abs=1.0)


def test_sustain_and_sostenuto_are_those_of_a_score(grand: tw.Instrument) -> None:
    """Sample by sample, where a score's hammers set out at the moments at which the keys go down."""
    tick, key = 64 / FS, {"C3": 48.0, "C4": 60.0, "C5": 72.0}
    notes = [("C4", 60, 120), ("C5", 180, 210), ("C3", 300, 340), ("C4", 360, 410)]
    pedals = [(90, 64, 1.0), (240, 64, 0.0), (330, 66, 1.0), (420, 66, 0.0)]
    moves = [tw.Control(at * tick, f"cc{number}", value) for at, number, value in pedals]

    def rendered(later: list[float]) -> tuple[np.ndarray, list[float]]:
        """Sound of the score with its blows so much later (s), and when its hammers set out, s."""
        blows = [
            tw.Note(begin * tick + late, (end - begin) * tick - late, note=key[name], velocity_midi=90)
            for (name, begin, end), late in zip(notes, later, strict=True)
        ]
        renderer = tw.Renderer(tw.Score(blows, moves), grand, fs=FS, max_duration=480 * tick)
        sound = np.concatenate(list(renderer.blocks()))[:, 0]
        return sound, sorted(play.start for play in renderer.performance.timeline.plays)

    starts = rendered([0.0] * len(notes))[1]
    score, _ = rendered([begin * tick - start for (_, begin, _), start in zip(notes, starts, strict=True)])
    events: dict[float, Any] = {}
    for name, begin, end in notes:
        events[begin * tick] = lambda live, name=name: live.note_on(name, 90)
        events[end * tick] = lambda live, name=name: live.note_off(name)
    for at, number, value in pedals:
        events[at * tick] = lambda live, number=number, value=value: live.control(number, value)
    live = played(grand, events, to=480 * tick)
    assert np.abs(score).max() > 0.1
    assert np.array_equal(live[: len(score)], score)
