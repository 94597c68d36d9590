"""Faults between an answer and its place in the results: none is lost that was confirmed, none is counted wrongly."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import listening_fakes as fakes
import numpy as np
import pytest

from tonewood.errors import OutputError
from tonewood.workshop.listening import answer_file
from tonewood.workshop.listening.answer_file import OpenSession, answers_of, begin, clear_parts, read, resume
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.panel import SimulatedPanel, _Listener
from tonewood.workshop.listening.report import write_report
from tonewood.workshop.listening.results import analyse, write_tables
from tonewood.workshop.listening.table import read_key, tidy

PAGES = [
    {"type": "consent"},
    {"type": "training", "page": 3, "trials": 2},
    {"type": "mushra", "group_by": ["pluck"], "reference": {"damping": "complex"}},
    {"type": "abx", "pairs": {"damping": ["complex", "block"]}},
    fakes.STAIRS | {"reversals": 4, "longest": 7},
    {"type": "rating", "scales": [{"name": "bright", "label": "Brightness"}]},
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ListeningTest:
    return fakes.made(tmp_path_factory.mktemp("all"), PAGES)


@pytest.fixture
def test(made: ListeningTest) -> Iterator[ListeningTest]:
    yield made
    shutil.rmtree(made.folder / "answers", ignore_errors=True)


def listener(test: ListeningTest) -> _Listener:
    panel = SimulatedPanel.model_validate({"schema": "tonewood-panel/1"})
    return _Listener(panel, read_key(test.folder / "key.json"), test, np.random.default_rng(1))


def opened(test: ListeningTest, answers: int = 10_000, name: str = "me", seed: int = 3) -> OpenSession:
    """A session with its first answers given."""
    session, who = begin(test, language="en", listener=name, started="2026", seed=seed), listener(test)
    while session.session.step is not None and len(session.session.answers) < answers:
        session.answer(who.answer(session.session), now="now")
    return session


@pytest.mark.parametrize(
    "fault",
    [OSError(errno.ENOSPC, "full"), OSError(errno.EROFS, "read-only"), MemoryError(), RuntimeError("a mistake"),
     UnicodeEncodeError("utf-8", "x", 0, 1, "no")],
)  # fmt: skip
@pytest.mark.parametrize("place", ["open", "write", "fsync", "fstat", "dumps"])
def test_no_fault_between_check_and_disk_moves_the_session(
    test: ListeningTest, monkeypatch: pytest.MonkeyPatch, place: str, fault: Exception
) -> None:
    session, who = opened(test, 3), listener(test)
    step, before, given = session.session.step, session.path.read_bytes(), who.answer(session.session)

    def broken(*args: object, **kwargs: object) -> None:
        raise fault

    module: Any = answer_file.json if place == "dumps" else answer_file.os
    with monkeypatch.context() as patched:
        patched.setattr(module, place, broken)
        with pytest.raises((type(fault), OutputError)):
            session.answer(given, now="now")
    assert session.session.step == step
    # the disk counts: as the server does, the session is taken up again; a whole line is an answer
    if place != "fsync" or isinstance(fault, OSError):
        assert session.path.read_bytes() == before
        session.answer(given, now="now")
    again = resume(test, session.header["token"])
    assert again is not None
    assert again.session.has_taken(given | {"index": 3})
    while again.session.step is not None:
        again.answer(who.answer(again.session), now="now")
    found = answers_of(test)
    assert found.left_out == ()
    assert [r["index"] for r in found.listeners[0].records] == list(range(len(again.session.answers)))


def test_half_a_surrogate_pair_moves_nothing(test: ListeningTest) -> None:
    session, who = opened(test, 4), listener(test)
    before = session.path.read_bytes()
    with pytest.raises(UnicodeEncodeError):
        session.answer(who.answer(session.session) | {"comment": "\ud83d"}, now="now")
    assert (len(session.session.answers), session.path.read_bytes()) == (4, before)
    session.answer(who.answer(session.session) | {"comment": "\U0001f600"}, now="now")
    assert read(session.path).records[-1]["answer"]["comment"] == "\U0001f600"
    with pytest.raises(UnicodeEncodeError):
        begin(test, language="\udfff", listener="me", started="2026")
    assert list((test.folder / "answers").iterdir()) == [session.path]


def test_a_file_that_another_program_changed_is_not_written_to(test: ListeningTest) -> None:
    session, who = opened(test, 3), listener(test)
    with session.path.open("ab") as stream:
        stream.write(b'{"index": 3, "pa')  # of a write that could not be undone
    with pytest.raises(OutputError, match="was changed by another program"):
        session.answer(who.answer(session.session), now="now")
    again = resume(test, session.header["token"])
    again.answer(who.answer(again.session), now="now")
    assert [r["index"] for r in answers_of(test).listeners[0].records] == [0, 1, 2, 3]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes with names")
def test_a_pipe_in_the_place_of_a_file_does_not_block(test: ListeningTest) -> None:
    session, who = opened(test, 3), listener(test)
    session.path.unlink()
    os.mkfifo(session.path)
    signal.alarm(5)  # ends the run where it blocks
    try:
        with pytest.raises(OutputError, match="cannot be written"):
            session.answer(who.answer(session.session), now="now")
    finally:
        signal.alarm(0)


def test_what_a_killed_server_wrote_is_on_the_disk_before_it_is_confirmed(
    test: ListeningTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, synced, fsync = opened(test, 3), [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (synced.append(os.fstat(handle).st_ino), fsync(handle)))
    resume(test, session.header["token"])
    assert synced == [session.path.stat().st_ino]


def test_an_answer_sent_again_is_known_and_another_one_is_not(test: ListeningTest) -> None:
    session, who = opened(test, 4), listener(test)  # the next is a rated page
    given = who.answer(session.session) | {"index": 4, "seconds": 2.5}
    session.answer(given, now="now")
    assert session.session.has_taken(given)
    for change in ({"seconds": 2.6}, {"index": 3}, {"index": 5}, {"index": -1}, {"index": None}, {"ratings": {}}):
        assert not session.session.has_taken(given | change)


def test_a_changed_digit_of_an_answer_is_noticed(test: ListeningTest) -> None:
    session = opened(test)
    raw = session.path.read_bytes()
    lines = raw.splitlines(keepends=True)
    number = next(i for i, line in enumerate(lines) if b'"mushra"' in line)
    for at, byte in enumerate(lines[number]):
        if chr(byte).isdigit():
            changed = bytearray(lines[number])
            changed[at] = ord("0") + (byte - ord("0") + 1) % 10
            session.path.write_bytes(b"".join([*lines[:number], bytes(changed), *lines[number + 1 :]]))
            if b'"crc32": "' not in changed:  # no checksum by its name, and the answer is as it was
                continue
            reasons = [left.reason for left in read(session.path).left_out]
            assert reasons == [f"{session.path}: line {number + 1}: crc32: damaged: it has another checksum"]


def test_answers_without_checksums_count(test: ListeningTest) -> None:
    """They are those of earlier versions."""
    session = opened(test)
    before = read(session.path)
    plain = [re.sub(rb', "crc32": "[0-9a-f]{8}"', b"", line) for line in session.path.read_bytes().splitlines()]
    session.path.write_bytes(b"\n".join(plain) + b"\n")
    after = read(session.path)
    assert (after.records, after.left_out) == (before.records, ())
    assert not any("crc32" in record for record in before.records)


@pytest.mark.slow
def test_each_line_may_be_damaged_and_the_others_count(test: ListeningTest) -> None:
    """Line by line: garbage, a record cut and run into the next, one that is gone, one that is there twice."""
    session = opened(test)
    lines = session.path.read_bytes().splitlines()
    records = [json.loads(line) for line in lines[1:]]
    for record in records:
        del record["crc32"]  # damage is found without it, too
    stairs = [r["index"] for r in records if r["type"] == "staircase" and not r["training"]]
    assert len(stairs) >= 4

    def kept(changed: list[bytes]) -> tuple[list[int], list[str], int]:
        session.path.write_bytes(b"\n".join(changed) + b"\n")
        found = answers_of(test)
        reasons = [one.reason for one in found.left_out]
        assert all(reason.startswith(f"{session.path}: line ") and "\n" not in reason for reason in reasons)
        (one,) = found.listeners
        return [r["index"] for r in one.records], reasons, sum(one.answers for one in found.left_out)

    assert kept(lines) == ([r["index"] for r in records], [], 0)
    for k, record in enumerate(records):
        line = k + 2
        # of a staircase nobody knows the levels after a trial that is missing
        gone = {k, *(i for i in stairs if i > k)} if k in stairs else {k}
        whole = [r["index"] for r in records if r["index"] not in gone]
        for damage in (b"\xff\x00garbage", b"", b"[1]", json.dumps({**record, "slots": 1}).encode(), b'{"answer": {}}'):
            indices, reasons, count = kept([*lines[: k + 1], damage, *lines[k + 2 :]])
            assert indices == whole, (k, damage)
            assert count == len(gone)
            assert any(f"line {line}: " in reason for reason in reasons)
        indices, reasons, count = kept([*lines[: k + 1], *lines[k + 2 :]])
        assert indices == whole
        if k not in stairs and k + 1 < len(records):
            assert (len(reasons), count) == (1, 1)
            assert "1 answer before it missing" in reasons[0]
        indices, reasons, count = kept([*lines[: k + 2], *lines[k + 1 :]])  # the same answer twice
        assert (indices, count) == ([r["index"] for r in records], 1)
        assert f"line {line + 1}: " in reasons[0]
        if k + 1 < len(records):
            merged = lines[k + 1][:20] + lines[k + 2]
            indices, reasons, count = kept([*lines[: k + 1], merged, *lines[k + 3 :]])
            assert not {k, k + 1} & set(indices)
            assert set(indices) >= {i for i in whole if i != k + 1 and i not in stairs}


@pytest.mark.slow
def test_results_name_and_count_what_they_leave_out(test: ListeningTest, tmp_path: Path) -> None:
    whole, broken, torn, other = (opened(test, name=f"L{k}", seed=k) for k in range(4))
    lines = broken.path.read_bytes().splitlines(keepends=True)
    mushra = next(i for i, line in enumerate(lines) if b'"mushra"' in line and b'"training": false' in line)
    lines[mushra] = b"{\n"
    broken.path.write_bytes(b"".join(lines))
    torn.path.write_bytes(torn.path.read_bytes()[:-5])
    head, _, rest = other.path.read_bytes().partition(b"\n")
    other.path.write_bytes(json.dumps(json.loads(head) | {"sha256": "0"}).encode() + b"\n" + rest)
    shutil.copy(whole.path, whole.path.with_name("a copy.jsonl"))
    whole.path.with_name("empty.jsonl").touch()
    found = analyse(test.folder, screening=False)
    reasons = {Path(one.reason.partition(": ")[0]).name: one for one in found.left_out}
    assert found.listeners == 3
    assert set(reasons) == {broken.path.name, torn.path.name, other.path.name, "a copy.jsonl", "empty.jsonl"}
    assert f"line {mushra + 1}: not JSON" in reasons[broken.path.name].reason
    assert "is cut off" in reasons[torn.path.name].reason
    assert "another version of this test" in reasons[other.path.name].reason
    assert reasons[other.path.name].answers == rest.count(b"\n")
    assert "another session" in reasons["a copy.jsonl"].reason
    assert "torn" not in found.unfinished
    report = write_report(found, tmp_path).read_text()
    assert f"{sum(one.answers for one in found.left_out)} answers are left out" in report
    assert str(broken.path.name) in report
    assert len(found.to_dict()["left_out"]) == 5
    for one in (whole, broken, torn):
        one.path.unlink()
    with pytest.raises(
        ListeningError,
        match=r"holds no answers that can be used; \d+ are left out, the first because: .*(another|no answers)",
    ):
        analyse(test.folder)


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"schema": "x"}, "no answers of a listener: schema tonewood-answers/"),
        ({"token": "x"}, "no answers of a listener: schema tonewood-answers/"),
        ({"token": "0" * 32}, "token: is the file of another session: its name is not its token"),
        ({"seed": "3"}, "line 1: seed: '3' is no int"),
        ({"simulated": 1}, "line 1: simulated: 1 is no bool"),
        ({"listener": None}, "line 1: listener: None is no str"),
        ({"place": -1}, "line 1: place: -1 is no number of a listener"),
        ({"place": 2**31}, "line 1: place: 2147483648 is no number of a listener"),
    ],
)
def test_a_first_line_that_is_damaged_is_said(test: ListeningTest, change: dict[str, Any], reported: str) -> None:
    path = opened(test, 2).path
    head, _, rest = path.read_bytes().partition(b"\n")
    path.write_bytes(json.dumps(json.loads(head) | change).encode() + b"\n" + rest)
    with pytest.raises(ListeningError) as fault:
        read(path)
    assert str(fault.value).startswith(f"{path}: {reported}")
    path.write_bytes(b"[1]\n" + rest)
    with pytest.raises(ListeningError, match="line 1: not an answer"):
        read(path)
    with pytest.raises(ListeningError, match="is no file"):
        read(path.parent)


def test_answers_that_are_missing_damaged_or_cut_off_are_counted(test: ListeningTest) -> None:
    """Of six answers: one gone, two gone, one that is no JSON, and the last one cut."""
    session = opened(test, 6)
    lines = session.path.read_bytes().splitlines(keepends=True)

    def found(changed: list[bytes]) -> tuple[list[int], list[tuple[str, int]]]:
        session.path.write_bytes(b"".join(changed))
        answers = answers_of(test)
        reasons = [(one.reason.removeprefix(f"{session.path}: "), one.answers) for one in answers.left_out]
        return [r["index"] for r in answers.listeners[0].records], reasons

    assert found(lines) == (list(range(6)), [])
    assert found([*lines[:4], *lines[5:]]) == ([0, 1, 2, 4, 5], [("line 5: 1 answer before it missing", 1)])
    assert found([*lines[:3], *lines[5:]]) == ([0, 1, 4, 5], [("line 4: 2 answers before it missing", 2)])
    indices, ((reason, count),) = found([*lines[:4], b"{\n", *lines[5:]])
    assert (indices, reason[:16], count) == ([0, 1, 2, 4, 5], "line 5: not JSON", 1)
    cut = [*lines[:6], lines[6][:-4]]
    assert found(cut) == (list(range(5)), [("line 7: is cut off: its answer was not confirmed to the listener", 1)])


@pytest.mark.parametrize("line", [2, 3])
def test_a_damaged_check_of_headphones_costs_no_later_page(tmp_path: Path, line: int) -> None:
    """Two attempts fail and the third is passed; without an answer of the first their number is unknown."""
    test = fakes.made(tmp_path, [{"type": "headphones", "trials": 2, "attempts": 3}, *PAGES[3:]])
    session, who = begin(test, language="en", listener="me", started="2026", seed=3), listener(test)
    for attempt in range(3):
        for _ in range(2):
            step = session.session.step
            assert step is not None
            wrong = next(slot for slot in step.slots if slot != step.correct)
            session.answer({"choice": step.correct if attempt == 2 else wrong}, now="now")
    while session.session.step is not None:
        session.answer(who.answer(session.session), now="now")
    lines = session.path.read_bytes().splitlines(keepends=True)
    session.path.write_bytes(b"".join([*lines[: line - 1], b"{\n", *lines[line:]]))
    answers = answers_of(test)
    kept = [record["index"] for record in answers.listeners[0].records]
    assert kept == [3 - line, *range(6, len(lines) - 1)]
    assert sum(one.answers for one in answers.left_out) == 5
    assert not answers.listeners[0].failed


def test_answers_without_sounds_are_rows_too(tmp_path: Path) -> None:
    """A check of headphones, a level that was measured, questions by number and by choice."""
    pages = [
        {"type": "headphones", "trials": 1, "right": 1},
        {"type": "level", "measured": True},
        fakes.ALL[-1],
        PAGES[3],
    ]
    test = fakes.made(tmp_path, pages)
    session = begin(test, language="en", listener="me", started="2026", seed=3)
    step = session.session.step
    assert step is not None
    given: list[dict[str, Any]] = [
        {"choice": step.correct}, {"spl_db": 71.5}, {"values": {"age": 33.0, "plays": "much"}}
    ]  # fmt: skip
    for answer in given:
        slots = session.session.step.slots if session.session.step else {}
        session.answer(answer | {"plays": dict.fromkeys(slots, 1), "seconds": 1.0}, now="now")
    table = tidy(test, read_key(test.folder / "key.json"), answers_of(test).listeners)
    assert [(row["item"], row["value"], row["response"]) for row in table.rows] == [
        ("headphones", 1.0, step.correct), ("spl_db", 71.5, 71.5), ("age", 33.0, 33.0), ("plays", None, "much")
    ]  # fmt: skip
    key = json.loads((test.folder / "key.json").read_text())
    code = next(iter(key["stimuli"]))
    for change, reported in (
        ({"levels": {}}, r"not a whole key: levels\.\w+ is missing"),
        (
            {"stimuli": {code: key["stimuli"][code] | {"levels": {}}}},
            rf"stimuli\.{code}\.levels: not a whole key: \w+ is missing",
        ),
        ({"factors": 3}, r"key\.json: factors: not a whole key"),
    ):
        (tmp_path / "key.json").write_text(json.dumps(key | change))
        with pytest.raises(ListeningError, match=reported):
            read_key(tmp_path / "key.json")
    for confidence in (0.0, 1.0):
        with pytest.raises(ListeningError, match=f"--confidence: is {confidence:g}; a number between 0 and 1 is"):
            analyse(test.folder, confidence=confidence)


def test_a_damaged_session_is_not_continued(test: ListeningTest) -> None:
    session = opened(test, 6)
    lines = session.path.read_bytes().splitlines(keepends=True)
    for damaged in (b"x\n", lines[2].replace(b"{", b'{"index": 7, "index": 7, ', 1)):
        session.path.write_bytes(b"".join([*lines[:2], damaged, *lines[3:]]))
        with pytest.raises(ListeningError, match="line 3: not JSON"):
            resume(test, session.header["token"])


def test_files_of_a_server_that_was_killed_while_it_began_them_are_removed(test: ListeningTest) -> None:
    session = opened(test, 2)
    part = session.path.with_name("0" * 32 + ".part")
    part.write_text("{")
    clear_parts(test)
    assert list(session.path.parent.iterdir()) == [session.path]


def test_names_and_texts_of_listeners_are_no_formulas_and_steer_no_terminal(
    test: ListeningTest, tmp_path: Path
) -> None:
    session = opened(test, 4, name="=cmd|'/C calc'!A0\x1b[2J\u202e")
    who = listener(test)
    while session.session.step is not None:
        session.answer(who.answer(session.session) | {"comment": "@SUM(1)"}, now="now")
    found = analyse(test.folder, screening=False)
    write_tables(found, tmp_path)
    for name in ("answers.csv", "means.csv"):
        text = (tmp_path / name).read_text()
        cells = [cell.strip('"') for line in text.splitlines() for cell in line.split(",")]
        assert not [cell for cell in cells if cell[:1] in "=@\t\r" and cell]
        assert "\x1b" not in text
        assert "\u202e" not in text
    assert "'=cmd|'/C calc'!A0 [2J" in (tmp_path / "answers.csv").read_text()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="names of bytes, and pipes")
def test_what_is_no_file_of_answers_stops_no_results(test: ListeningTest, tmp_path: Path) -> None:
    """A name that is no UTF-8, a pipe, a device without an end and a folder are named, and the others count."""
    session = opened(test)
    folder = session.path.parent
    (folder / os.fsdecode(b"\xff.jsonl")).write_bytes(b"{}\n")
    os.mkfifo(folder / ("a" * 32 + ".jsonl"))
    (folder / ("b" * 32 + ".jsonl")).symlink_to("/dev/zero")
    (folder / ("c" * 32 + ".jsonl")).mkdir()
    found = analyse(test.folder, screening=False)
    write_report(found, tmp_path)
    reasons = [one.reason for one in found.left_out]
    assert len(reasons) == 4
    assert sum(reason.endswith(": is no file") for reason in reasons) == 3
    assert any("\\udcff.jsonl: no answers of a listener" in reason for reason in reasons)
    assert found.listeners == 1


def test_a_file_that_cannot_be_read_now_is_not_the_end_of_its_session(
    test: ListeningTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = opened(test, 4)

    def fails(path: Path) -> bytes:
        raise OSError(errno.EMFILE, "Too many open files")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", fails)
        with pytest.raises(OutputError, match="Too many open files"):
            resume(test, session.header["token"])
    again = resume(test, session.header["token"])
    assert again is not None
    assert again.session.step == session.session.step
