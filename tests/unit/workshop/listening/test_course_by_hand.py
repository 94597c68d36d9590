"""The course of a listening test: steps, limits of answers, words of pages, sounds on demand."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest
from listening_by_hand import LEVITT, LINEAR

from tonewood.sound.level.loudness import loudest
from tonewood.workshop.batch.pages import LevelPage
from tonewood.workshop.batch.pages import localised as in_language
from tonewood.workshop.listening.answer_file import listener_of, place_of, printable
from tonewood.workshop.listening.checked_answer import checked, choices, share_wanted
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial
from tonewood.workshop.listening.headphones import ramped
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.on_demand import RenderedPairs
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.shown import _details, kind_of_texts, shown

# -- the course of a test ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def every(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return fakes.made(tmp_path_factory.mktemp("every"), fakes.ALL)


def stepped(test: ListeningTest) -> dict[tuple[str, bool], dict[str, Any]]:
    """The first view of each type of page, of training apart."""
    session, views = Session(test, 3), dict[tuple[str, bool], dict[str, Any]]()
    while session.step is not None:
        view = shown(test, session, "en")
        assert view["index"] == session.step.index
        assert view["progress"] == pytest.approx(session.step.index / session.total)
        views.setdefault((view["type"], view["training"]), view)
        session.pass_over()
    views["done", False] = shown(test, session, "en")
    return views


def test_views_are_those_of_the_pages(every: ListeningTest) -> None:
    views = stepped(every)
    assert views["done", False] == {"type": "done", "index": 0, "progress": 1.0}
    trained = views["abx", True]
    assert trained["training"]
    abx = views["abx", False]
    assert [c["value"] for c in abx["choices"]] == ["A", "B", "undecided"]
    assert (abx["slots"], abx["open"], abx["sequence"], abx["listen"]) == (["A", "B", "X"], None, False, 0.5)
    assert (abx["loop"], abx["restart"], abx["plays"], abx["waveform"], abx["last"]) == (
        "whole",
        False,
        None,
        False,
        False,
    )
    mushra = views["mushra", False]
    assert (mushra["open"], mushra["slots"][0], len(mushra["slots"])) == ("reference", "reference", 1 + 5)
    assert mushra["choices"] == []
    afc = views["afc", False]
    assert (afc["slots"], afc["sequence"], afc["question"]) == (["1", "2", "3"], True, "")
    assert [c["value"] for c in afc["choices"]] == ["1", "2", "3"]
    paired = views["paired_comparison", False]
    assert (paired["question"], [c["value"] for c in paired["choices"]]) == ("Which is brighter?", ["A", "B", "tie"])
    level = views["level", False]
    assert level["measured"] is True
    assert len(level["notes"]) == 3
    assert "1000" in level["notes"][0]
    assert "65" in level["notes"][1]
    assert (views["rating", False]["scales"], views["instructions", False]["title"]) == (
        [{"name": "bright", "label": "Brightness", "low": 0.0, "high": 100.0, "low_label": "", "high_label": ""}],
        "Hello",
    )
    questions = views["questionnaire", False]["questions"]
    assert [(q["name"], q["kind"], q["optional"]) for q in questions] == [
        ("age", "number", True), ("plays", "choice", False)
    ]  # fmt: skip
    assert questions[1]["choices"] == [{"value": "much", "label": "much"}, {"value": "little", "label": "little"}]
    assert views["consent", False]["agree"] == every.texts("en")["consent_agree"]
    assert views["finish", False]["last"] is True
    assert kind_of_texts(LEVITT) == "afc_3"
    assert kind_of_texts(LINEAR) == "afc_2"
    assert kind_of_texts(LINEAR.model_copy(update={"question": "?"})) == "afc_question"


def given(test: ListeningTest, kind: str, answer: dict[str, Any]) -> dict[str, Any]:
    """The record of an answer to the first page of a type."""
    session = Session(test, 3)
    while session.step is not None and (session.page is None or session.page.type != kind or session.step.training):
        session.pass_over()
    assert session.page is not None
    assert session.step is not None
    return checked(session.page, session.step, answer)


MUSHRA = dict.fromkeys("ABCDE", 50.0)


@pytest.mark.parametrize(
    ("kind", "answer", "kept"),
    [
        ("abx", {"choice": "A", "extra": 1}, {"choice": "A"}),
        ("abx", {"choice": "X"}, None),
        ("abx", {"choice": "A", "comment": "c" * 2000}, {"choice": "A", "comment": "c" * 2000}),
        ("abx", {"choice": "A", "comment": "c" * 2001}, None),
        ("abx", {"choice": "A", "seconds": -0.1}, None),
        ("abx", {"choice": "A", "seconds": 3.2e8}, {"choice": "A"}),
        ("abx", {"choice": "A", "seconds": 3.3e8}, None),
        ("abx", {"choice": "A", "plays": {"A": -1}}, None),
        ("abx", {"choice": "A", "plays": {"A": 1e6, "Z": 1}}, {"choice": "A"}),
        ("abx", {"choice": "A", "plays": {"A": 1e6 + 1}}, None),
        ("abx", {"choice": "A", "heard": {"A": 0.5, "B": 0.5, "X": 1.0}}, {"heard": {"A": 0.5, "B": 0.5, "X": 1.0}}),
        ("abx", {"choice": "A", "heard": {"A": 0.49, "B": 0.5, "X": 1.0}}, None),
        ("abx", {"choice": "A", "heard": {"A": 0.5, "B": 0.5, "X": 1.01}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 0.0, "B": 100.0}}, {"ratings": MUSHRA | {"A": 0.0, "B": 100.0}}),
        ("mushra", {"ratings": MUSHRA | {"A": -0.1}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 100.1}}, None),
        ("mushra", {"ratings": {"A": 1.0}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": True}}, None),
        ("mushra", {"ratings": MUSHRA | {"A": 10**400}}, None),
        ("bs1116", {"ratings": {"A": 1.0, "B": 5.0}}, {"ratings": {"A": 1.0, "B": 5.0}}),
        ("bs1116", {"ratings": {"A": 0.9, "B": 5.0}}, None),
        ("bs1116", {"ratings": {"A": 4.9, "B": 4.9}}, None),
        ("rating", {"values": {"bright": 100}}, {"values": {"bright": 100.0}}),
        ("rating", {"values": {}}, None),
        ("questionnaire", {"values": {"plays": "much"}}, {"values": {"plays": "much"}}),
        ("questionnaire", {"values": {"plays": "much", "age": ""}}, {"values": {"plays": "much"}}),
        ("questionnaire", {"values": {"plays": "never", "age": 3}}, None),
        ("questionnaire", {"values": {"age": 3}}, None),
        ("consent", {"agreed": True}, {"agreed": True}),
        ("consent", {"agreed": 1}, None),
        ("level", {"spl_db": 130}, {"spl_db": 130.0}),
        ("level", {"spl_db": 130.1}, None),
        ("ab", {"choice": "same"}, {"choice": "same"}),
        ("ab", {"choice": "A"}, None),
    ],
)
def test_answers_within_their_limits_are_taken(
    every: ListeningTest, kind: str, answer: dict[str, Any], kept: dict[str, Any] | None
) -> None:
    if kept is None:
        with pytest.raises(ListeningError):
            given(every, kind, answer)
        return
    found = given(every, kind, answer)
    assert {key: found[key] for key in kept} == kept
    assert set(found) <= {"seconds", "plays", *answer}
    assert found["seconds"] == answer.get("seconds", 0.0)
    assert "Z" not in found["plays"]


def test_words_of_one_s_own_may_lack_the_places_of_numbers() -> None:
    """A text with another word in braces stopped every listener at the page that sets the level."""
    level = LevelPage(type="level", spl_db=65.0)
    words = {"level_tone": "Ton, {frequenz} Hz", "level_spl": "{spl} dB", "level_headphones": ""}
    stimuli = SimpleNamespace(loudness=SimpleNamespace(target_lufs=-23.0, method="loudest"))
    test: Any = SimpleNamespace(texts=lambda language: words, manifest=SimpleNamespace(stimuli=stimuli))
    assert _details(test, level, "de")["notes"] == ["Ton, {frequenz} Hz", "65 dB", ""]


def test_the_level_tone_is_a_whole_number_of_periods(tmp_path: Path) -> None:
    import io

    import soundfile

    page = LevelPage.model_validate({"type": "level", "freq": 997.3})
    loudness = SimpleNamespace(target_lufs=-23.0, method="loudest")
    settings = SimpleNamespace(fs=8000, channels=2, loudness=loudness)
    test = SimpleNamespace(manifest=SimpleNamespace(stimuli=settings))
    sound, fs = soundfile.read(io.BytesIO(tone(test, page)))  # type: ignore[arg-type]
    level = float(np.abs(sound).max())
    assert 20 * math.log10(level) == pytest.approx(-23.0 + 3.01 - 10 * math.log10(2), abs=0.01)
    expected = level * np.sin(2 * np.pi * 1995 / 16000 * np.arange(16000))
    assert (fs, sound.shape) == (8000, (16000, 2))
    np.testing.assert_allclose(sound, np.stack([expected, expected], axis=1), atol=2**-21)


def test_ramps_are_raised_cosines() -> None:
    found = ramped(np.ones((100, 2)), 1000, 0.01)
    rise = np.sin(np.pi / 2 * (np.arange(10) + 0.5) / 10) ** 2
    np.testing.assert_allclose(found[:, 1], np.r_[rise, np.ones(80), rise[::-1]])


def test_words_are_of_the_nearest_language() -> None:
    words = {"en": "colour", "de": "Farbe"}
    assert [in_language(words, x) for x in ("de-CH", "en", "fr")] == ["Farbe", "colour", "colour"]
    pages = SimpleNamespace(texts={"de": {"next": "Weiter!"}, "de-CH": {"next": "Wiiter"}}, title={"fr": "Essai"})
    test = ListeningTest(Path(), Path(), pages, (), "")  # type: ignore[arg-type]
    assert (test.texts("de")["next"], test.texts("de-CH")["next"]) == ("Weiter!", "Wiiter")
    assert test.texts("de-AT")["next"] == "Weiter!"
    assert test.title("de") == "Essai"
    assert ServedTrial("t", 0, "r", ("a", "b")).codes == ("r", "a", "b")
    assert ServedTrial("t", 0, None, ("a", "b")).codes == ("a", "b")


def test_shares_that_must_be_heard() -> None:
    pages = {p["type"]: p for p in fakes.ALL}
    from tonewood.workshop.batch.pages import HeadphonesPage

    assert share_wanted(LEVITT) == 0.5
    assert share_wanted(HeadphonesPage.model_validate({"type": "headphones"})) == 0.5
    assert share_wanted(LevelPage.model_validate(pages["level"])) == 0.0
    assert choices(LINEAR, ("reference", "1", "2")) == ["1", "2"]
    assert choices(LevelPage.model_validate(pages["level"]), ()) == []


# -- sessions and files of answers -------------------------------------------------------------------------------------


def test_steps_are_counted_with_every_attempt_of_a_check(tmp_path: Path) -> None:
    """Six trials of headphones, three of the second attempt so far, then two pairs and the end."""
    pages = [{"type": "headphones"}, {"type": "abx", "pairs": {"damping": ["complex", "block"]}, "group_by": ["pluck"]}]
    session = Session(fakes.made(tmp_path, pages), 1)
    pairs = len(session.test.trials)
    assert session.total == 6 + pairs + 1
    for k in range(9):
        assert session.step is not None
        wrong = next(slot for slot in session.step.slots if slot != session.step.correct)
        session.answer({"choice": wrong if k == 0 else session.step.correct})
        assert session.total == max(6, k + 1) + pairs + 1


def test_training_on_a_staircase_stays_at_its_start(tmp_path: Path) -> None:
    pages = [{"type": "training", "page": 2, "trials": 9}, fakes.STAIRS | {"down": 1}]
    session = Session(fakes.made(tmp_path, pages), 1)
    assert session.total == 9 + 40 + 1
    places = []
    for k in range(9):
        step = session.step
        assert step is not None
        assert session.page_index == 1
        assert (step.training, step.repetition, step.track, step.level) == (True, k + 1, 0, 8.0)
        assert [slot for slot, code in step.slots.items() if code == "changed"] == [step.correct]
        places.append(step.correct)
        if k < 7:
            record = session.answer({"choice": step.correct})
            assert (record["level"], record["right"], record["training"], record["page"]) == (8.0, True, True, 1)
        else:
            session.pass_over()
    assert len(set(places)) > 1
    assert session.incomplete == set()
    step = session.step
    assert step is not None
    assert (step.training, step.page, step.level, session.tracks[1][0].levels) == (False, 1, 8.0, [])
    session.pass_over()
    assert session.incomplete == {1}
    assert session.page is not None
    assert session.page.type == "finish"


def test_names_are_one_line_of_two_hundred_characters() -> None:
    assert printable(" a\n\x1b b\t" + "c" * 300) == "a b " + "c" * 196
    assert listener_of({"listener": "\n", "token": "0123456789"}) == "01234567"
    assert listener_of({"listener": " x ", "token": "0"}) == "x"
    assert [place_of(x) for x in ({}, {"place": 0}, {"place": 2**31 - 1})] == [0, 0, 2**31 - 1]
    for wrong in (-1, 2**31, True, 1.0, "1"):
        with pytest.raises(ListeningError, match="is no number of a listener"):
            place_of({"place": wrong})


# -- sounds on demand and languages ------------------------------------------------------------------------------------


class Renders(fakes.fakes.FakeRenderer):
    """Notes what it renders."""

    def __init__(self) -> None:
        super().__init__()
        self.rendered: list[float] = []

    def render(self, condition: Any) -> Any:
        self.rendered.append(condition.overrides["body.detune"])
        return super().render(condition)


def test_both_sounds_of_a_level_are_made_once(tmp_path: Path) -> None:
    """8 % of a detuning of 1 is 1.08; both have one length and one loudness."""
    import io

    import soundfile

    test = fakes.made(tmp_path, [{"type": "instructions"}, fakes.STAIRS])
    renders = Renders()
    pairs = RenderedPairs(test, renders)
    assert pairs.changes() == []
    one = pairs.pair(1, 5.0)
    assert pairs.pair(1, 5.0) is one
    assert renders.rendered == [pytest.approx(1.05)]  # the standard is kept by the batch
    pairs.expect(1, 4.0)
    assert pairs.pair(1, 4.0) is not one
    sounds = {name: soundfile.read(io.BytesIO(raw)) for name, raw in one.items()}
    assert set(sounds) == {"standard", "changed"}
    (standard, fs), (changed, _) = sounds["standard"], sounds["changed"]
    assert (fs, len(standard)) == (48000, len(changed))
    assert loudest(standard[:, None], fs, 0.1) == pytest.approx(-23.0, abs=0.05)
    assert loudest(changed[:, None], fs, 0.1) == pytest.approx(-23.0, abs=0.05)
    assert not np.allclose(standard, changed, atol=1e-3)
    for level in range(70):
        pairs._pairs[1, float(100 + level)] = pairs._pairs[1, 5.0]
    pairs.pair(1, 5.0)
    assert len(pairs._pairs) == 64
    assert next(reversed(pairs._pairs)) == (1, 5.0)
    pairs.close()
    (tmp_path / "out" / "work").rename(tmp_path / "gone")
    assert RenderedPairs(test, renders).changes()[0].startswith("page 2: its sound of the batch is not in ")


@pytest.mark.parametrize(
    ("asked", "language"),
    [("de", "de"), ("de-CH", "de"), ("xx, de-AT;q=0.5", "de"), ("xx,de-AT", "de"), ("", "en"), ("xx", "en")],
)
def test_the_first_language_that_is_known_is_taken(every: ListeningTest, asked: str, language: str) -> None:
    from tonewood.workshop.listening.server import ListeningServer

    assert ListeningServer(every)._language(asked) == language
