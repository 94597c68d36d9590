from __future__ import annotations

import copy
import json
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest

from tonewood.errors import OutputError
from tonewood.workshop.listening import answer_file
from tonewood.workshop.listening.answer_file import answers_of, begin, read, resume
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.panel import SimulatedPanel, _Listener
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.shown import shown
from tonewood.workshop.listening.staircase import StaircaseTrack
from tonewood.workshop.listening.table import read_key
from tonewood.workshop.listening.trials import OPEN


@pytest.fixture(scope="module")
def test_of_all(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return fakes.made(tmp_path_factory.mktemp("all"), fakes.ALL)


def listener(test: ListeningTest, seed: int = 1) -> _Listener:
    panel = SimulatedPanel.model_validate({"schema": "tonewood-panel/1"})
    return _Listener(panel, read_key(test.folder / "key.json"), test, np.random.default_rng(seed))


def taken(test: ListeningTest, seed: int = 3) -> Session:
    session, who = Session(test, seed), listener(test)
    while session.step is not None:
        session.answer(who.answer(session))
    return session


def test_a_session_is_decided_by_seed_and_answers(test_of_all: ListeningTest) -> None:
    session = taken(test_of_all)
    again = Session(test_of_all, 3)
    for record in json.loads(json.dumps(session.answers)):
        again.take(record)
    assert again.step is None
    other = taken(test_of_all, 4)
    assert [a["slots"] for a in other.answers] != [a["slots"] for a in session.answers]
    kinds = Counter(a["type"] for a in session.answers)
    assert kinds["mushra"] == 3
    assert kinds["bs1116"] == 8  # the hidden reference and one other at a time
    assert kinds["paired_comparison"] == 9
    assert kinds["rating"] == 9
    assert kinds["abx"] == 3 + 1  # and one of training
    assert kinds["finish"] == 1
    assert Session(test_of_all, 3).total == pytest.approx(len(session.answers), abs=40)


def test_the_number_of_steps_is_known_from_the_first_on(tmp_path: Path) -> None:
    """Of all pages but staircases; a check of headphones that is repeated adds its trials."""
    pages = [page for page in fakes.ALL if page["type"] != "staircase"]
    test = fakes.made(tmp_path / "test", [{"type": "headphones", "trials": 4}, *pages])
    session, who = Session(test, 3), listener(test)
    foretold = session.total
    while session.step is not None:
        assert session.total >= foretold
        session.answer(who.answer(session))
    checks = sum(record["type"] == "headphones" for record in session.answers)
    assert checks % 4 == 0
    assert session.total == len(session.answers) == foretold + checks - 4


def test_right_answers_are_where_the_sounds_are(test_of_all: ListeningTest) -> None:
    key = read_key(test_of_all.folder / "key.json")
    corrects = Counter()
    for seed in range(20):
        for record in taken(test_of_all, seed).answers:
            slots, correct = record["slots"], record.get("correct")
            if record["type"] == "abx":
                assert slots["X"] == slots[correct]
            elif record["type"] == "ab":
                assert (correct == "same") == (slots["A"] == slots["B"])
            elif record["type"] == "afc":
                odd = [slot for slot in "123" if slot in slots and list(slots.values()).count(slots[slot]) == 1]
                assert correct in odd
                assert key.stimuli[slots[correct]].levels["pluck"] == "far"
            elif record["type"] == "mushra":
                hidden = [slot for slot, code in slots.items() if code == slots[OPEN] and slot != OPEN]
                assert len(hidden) == 1
                corrects["hidden", hidden[0]] += 1
            if record["type"] in ("abx", "ab", "staircase"):
                corrects[record["type"], correct] += 1
    for kind, choices in (("abx", "AB"), ("ab", ("same", "different")), ("staircase", "123"), ("hidden", "ABCDE")):
        counts = [corrects[kind, choice] for choice in choices]
        assert min(counts) > 0.4 * sum(counts) / len(counts), (kind, counts)


def test_browsers_get_no_code_no_level_and_no_answer(test_of_all: ListeningTest) -> None:
    key = json.loads((test_of_all.folder / "key.json").read_text())
    hidden = [*key["stimuli"], *key["trials"], "complex", "proportional", "near", "far", "correct", "level"]
    session, who = Session(test_of_all, 3), listener(test_of_all)
    while session.step is not None:
        said = shown(test_of_all, session, "en")
        values = json.dumps({k: v for k, v in said.items() if k not in ("type", "notes", "title", "content")})
        assert not [word for word in hidden if f'"{word}' in values], values
        session.answer(who.answer(session))


def test_texts_are_in_the_listener_s_language(test_of_all: ListeningTest) -> None:
    session, who = Session(test_of_all, 3), listener(test_of_all)
    assert shown(test_of_all, session, "de")["title"] == "Einwilligung"
    session.answer(who.answer(session))
    assert [shown(test_of_all, session, x)["title"] for x in ("en", "de", "fr")] == ["Hello", "Guten Tag", "Hello"]
    texts = {name: test_of_all.texts(name) for name in ("en", "de", "fr")}
    assert len({frozenset(words) for words in texts.values()}) == 1
    assert all(len({words[key] for words in texts.values()}) > 1 for key in ("next", "reference", "mushra_scale"))
    for words in texts.values():
        assert len(words["mushra_scale"].split("|")) == len(words["bs1116_scale"].split("|")) == 5


@pytest.mark.parametrize(
    ("kind", "change", "line"),
    [
        ("consent", {"agreed": False}, "agreed: the test goes on only with it"),
        ("level", {"spl_db": None}, "spl_db: None is not a number from 0 to 130"),
        ("mushra", {"ratings": {"A": 1}}, "ratings.B: None is not a number from 0 to 100"),
        ("mushra", {"ratings": "x"}, "ratings: is no mapping"),
        ("mushra", {"comment": "\u00e9" * 2001}, "comment: has 2001 characters, 2000 are allowed"),
        ("bs1116", {"ratings": {"A": 3, "B": 4}}, "ratings: one of the two is the reference: its grade is 5.0"),
        ("abx", {"choice": "C"}, "choice: 'C' is not one of A, B, undecided"),
        ("ab", {"choice": "A"}, "choice: 'A' is not one of same, different"),
        ("rating", {"values": {"bright": float("nan")}}, "values.bright: nan is not a number from 0 to 100"),
        ("staircase", {"choice": None}, "choice: None is not one of 1, 2, 3"),
        ("questionnaire", {"values": {}}, "values.plays: is missing"),
        ("questionnaire", {"values": {"plays": "x"}}, "values.plays: 'x' is not one of much, little"),
    ],
)
def test_an_answer_that_does_not_fit_is_one_line(
    test_of_all: ListeningTest, kind: str, change: dict, line: str
) -> None:
    session, who = Session(test_of_all, 3), listener(test_of_all)
    while session.page.type != kind or session.step.training:
        session.answer(who.answer(session))
    before = session.step
    with pytest.raises(ListeningError) as caught:
        session.answer(who.answer(session) | change)
    assert str(caught.value) == line
    assert session.step is before


@pytest.mark.parametrize(
    ("down", "answers", "levels"),
    [
        (1, (1, 1, 0, 1), [4, 2, 1, 2]),
        (3, (1, 1, 1, 1, 1, 1, 1), [4, 4, 4, 2, 2, 2, 1]),
        (3, (1, 1, 0, 1, 1, 1, 1), [4, 4, 4, 8, 8, 8, 4]),
    ],
)
def test_a_level_falls_after_so_many_right_answers_in_a_row(
    test_of_all: ListeningTest, down: int, answers: tuple[int, ...], levels: list[float]
) -> None:
    """Steps are halves and doubles up to the first reversal; a wrong answer begins the count anew."""
    page = next(p for p in test_of_all.pages if p.type == "staircase")
    track = StaircaseTrack(page.model_copy(update={"down": down, "start": 4.0}))
    for right in answers:
        expected = track.step_after(bool(right))
        track.answer(bool(right))
        assert track.level == expected
    assert track.levels == pytest.approx(levels)


def test_levels_follow_the_rule_of_levitt(test_of_all: ListeningTest) -> None:
    page = next(p for p in test_of_all.pages if p.type == "staircase")
    page = page.model_copy(update={"reversals": 4, "discard": 2, "longest": 80})
    track = StaircaseTrack(page)
    for right in (1, 1, 1, 1, 0, 1, 1, 0, 1, 0, 1, 1):
        expected = track.step_after(bool(right))
        track.answer(bool(right))
        assert track.level == expected
    # two right: half; wrong: up. 8 -> 8 4 4 2, wrong at 2 (reversal 1) -> 4, two right: 4 (2), /1.4, wrong (3) *1.4,
    # a single right answer moves nothing, wrong: up again, no reversal; two right: down (4)
    up = 4 / 1.4
    assert track.levels == pytest.approx([8, 8, 4, 4, 2, 4, 4, up, up * 1.4, up * 1.4, 5.6, 5.6])
    assert track.reversal_levels == pytest.approx([2, 4, up, 5.6])
    assert track.done
    assert track.threshold == pytest.approx(np.sqrt(up * 5.6))


def test_answers_are_on_the_disk_before_the_session_goes_on(
    test_of_all: ListeningTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = []
    fsync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (synced.append(os.fstat(handle).st_size), fsync(handle)))
    who = listener(test_of_all)
    opened = begin(test_of_all, language="en", listener="me", started="2026", seed=3)
    assert opened.path.stat().st_size in synced
    for _ in range(6):
        opened.answer(who.answer(opened.session), now="now")
        assert opened.path.stat().st_size == synced[-1]
    token = opened.header["token"]
    again = resume(test_of_all, token)
    assert again.session.step == opened.session.step
    with opened.path.open("ab") as stream:
        stream.write(b'{"index": 6, "page"')  # a write that a crash cut off
    torn = read(opened.path)
    assert torn.torn
    assert len(torn.records) == 6
    again = resume(test_of_all, token)
    assert again.session.step == opened.session.step
    again.answer(who.answer(again.session), now="now")
    assert [r["index"] for r in read(opened.path).records] == list(range(7))
    opened.path.unlink()


def test_a_full_disk_loses_nothing_and_stays_at_the_page(
    test_of_all: ListeningTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    who = listener(test_of_all)
    opened = begin(test_of_all, language="en", listener="me", started="2026", seed=3)
    opened.answer(who.answer(opened.session), now="now")
    step, size, write = opened.session.step, opened.path.stat().st_size, os.write

    monkeypatch.setattr(answer_file.os, "write", lambda handle, line: write(handle, line[: len(line) // 2]))
    with pytest.raises(OutputError, match="No space left on device"):
        opened.answer(who.answer(opened.session), now="now")
    monkeypatch.undo()
    assert opened.path.stat().st_size == size
    assert opened.session.step == step
    opened.answer(who.answer(opened.session), now="now")
    assert len(read(opened.path).records) == 2
    opened.path.unlink()


def test_answers_to_another_test_are_refused(tmp_path: Path) -> None:
    pages = [{"type": "abx", "pairs": {"damping": ["complex", "block"]}}]
    test = fakes.made(tmp_path, pages)
    opened = begin(test, language="en", listener="me", started="2026")
    changed = fakes.made(tmp_path, pages, title="other")
    with pytest.raises(ListeningError, match="was begun with another version of this test"):
        resume(changed, opened.header["token"])
    (left_out,) = answers_of(changed).left_out
    assert "was answered with another version" in left_out.reason
    assert resume(test, "../" * 10 + "etc/passwd") is None
    opened.path.write_text("x\n")
    (left_out,) = answers_of(test).left_out
    assert "line 1: not JSON" in left_out.reason


def damaged(value: Any) -> Iterator[Any]:
    """The value with one of its parts of another type, not finite or missing."""
    yield from (x for x in (None, "x", -1, float("nan"), [], {}) if type(x) is not type(value) or x != x)
    if isinstance(value, dict):
        for key in value:
            yield {k: v for k, v in value.items() if k != key}
            for part in damaged(value[key]):
                yield {**value, key: part}


@pytest.mark.slow
def test_damaged_answers_are_one_line(test_of_all: ListeningTest) -> None:
    """Each part of a row of each kind, one by one; names of tests and times are not read."""

    def changed(old: dict[str, Any], new: dict[str, Any]) -> set[str]:
        keys = {key for key in old if key not in new or new[key] != old[key]}
        return {f"answer.{key}" for key in changed(old["answer"], new["answer"])} if keys == {"answer"} else keys

    who = listener(test_of_all)
    opened = begin(test_of_all, language="en", listener="me", started="2026", seed=3)
    while opened.session.step is not None:
        opened.answer(who.answer(opened.session), now="now")
    # without their checksums, as in files of earlier versions
    lines = [re.sub(', "crc32": "[0-9a-f]{8}"', "", line) for line in opened.path.read_text().splitlines()]
    opened.path.write_text("\n".join(lines) + "\n")
    assert not answers_of(test_of_all).left_out
    kinds = {row["type"]: i for i, row in reversed(list(enumerate(map(json.loads, lines)))) if i}
    read_all, said = set(), []
    for i in (0, *kinds.values()):
        for row in damaged(json.loads(lines[i])):
            opened.path.write_text("\n".join([*lines[:i], json.dumps(row)]) + "\n")
            found = answers_of(test_of_all)
            if not found.left_out:
                read_all |= changed(json.loads(lines[i]), row)
            said += [one.reason for one in found.left_out]
    assert len(said) > 100
    assert all(line.startswith(f"{opened.path}: ") and "\n" not in line for line in said)
    # a sound need not be played, nor an optional question be answered; files of earlier versions have no place
    assert read_all == {"test", "time", "place", "answer.plays", "answer.values"}
    opened.path.unlink()


def test_definitions_that_cannot_be_used_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ListeningError, match=r"test\.json: cannot be read: .*`tonewood batch` writes it"):
        fakes.load_test(tmp_path)
    pages = [{"type": "abx", "pairs": {"damping": ["complex", "block"]}}]
    with pytest.raises(ListeningError, match="texts: nxt is not one of start, next"):
        fakes.made(tmp_path, pages, texts={"en": {"nxt": "x"}})
    path = tmp_path / "out" / "test.json"
    data = json.loads(path.read_text())
    for change, line in (({"schema": "x"}, "not a test"), ({"trials": [{}]}, "not a whole test: 'id'")):
        path.write_text(json.dumps(copy.deepcopy(data) | change))
        with pytest.raises(ListeningError, match=line):
            fakes.load_test(tmp_path / "out")
