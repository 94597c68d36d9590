"""Notes that cannot be played: listed, warned of once, and an error where nothing is left."""

from __future__ import annotations

import warnings

import pytest

import tonewood as tw
from tonewood.errors import NothingPlayedError
from tonewood.performance.score.note import Dropped

PLAYABLE, TOO_LOW = tw.Note(0.0, 0.1, note=45, force=1.0), tw.Note(0.1, 0.1, note=20, force=1.0)


def test_dropped_notes_are_on_the_result_and_warned_of_once() -> None:
    score = tw.Score([PLAYABLE, TOO_LOW, TOO_LOW])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        audio = tw.render(score, tw.load_instrument("monochord"), 16000, max_duration=0.05)
    (reported,) = caught
    assert reported.category is tw.DroppedNotesWarning
    assert "2 notes cannot be played; the first, at 0.10 s: " in str(reported.message)
    assert reported.filename == __file__
    assert [(d.time, d.note) for d in audio.dropped] == [(0.1, 20), (0.1, 20)]
    with pytest.warns(tw.DroppedNotesWarning):
        renderer = tw.Renderer(score, tw.load_instrument("monochord"), 16000)
    assert renderer.dropped == audio.dropped


def test_no_warning_where_all_is_played() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tw.render(tw.Score([PLAYABLE]), tw.load_instrument("monochord"), 16000, max_duration=0.02).dropped == ()


def test_a_score_of_which_nothing_can_sound_is_an_error() -> None:
    with pytest.raises(NothingPlayedError, match=r"^score: none of 2 notes can be played: .* reach"):
        tw.render(tw.Score([TOO_LOW, TOO_LOW]), tw.load_instrument("monochord"), 16000)
    already = tw.Score([], dropped=[Dropped(0.0, 20, None, "too low")])
    with pytest.raises(NothingPlayedError, match="the one note cannot be played: too low"):
        tw.render(already, tw.load_instrument("monochord"), 16000)


def test_a_plan_warns_once_and_lists_them() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = tw.plan(tw.Score([PLAYABLE, TOO_LOW]), tw.load_instrument("monochord"), 16000, max_duration=0.05)
    assert [w.category for w in caught] == [tw.DroppedNotesWarning]
    assert [d.note for d in found.notes_dropped] == [20]
