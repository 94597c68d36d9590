"""Answers on disk: one file a listener, one JSON line an answer, written through to the disk.

The file appears complete with its first line (who, which test, which seed). Each answer is appended by one write and is
on the disk before the session goes on and the server confirms it. A line that a crash cut off has no line end: it is
left out when the file is read, and cut off when it is taken up again; that answer was never confirmed, so its page is
shown again.

The line of an answer ends with ``crc32``, the checksum of the text before it, so that a changed digit is noticed. The
first line has no checksum: its names may be replaced. Files of earlier versions have none either, and are read.

The analysis reads on past damage: a line that is no answer of this course is left out and reported, the others count.
A session with such a line is not continued.

A listener may withdraw: the file is deleted, and ``withdrawn.log`` keeps the time and the number of answers, no more.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import secrets
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tonewood.errors import OutputError
from tonewood.support.text_files import json_value
from tonewood.support.whole_files import remove
from tonewood.workshop.batch.definition import ANSWERS, count_answers
from tonewood.workshop.batch.pages import TrialPage
from tonewood.workshop.listening.definition import ListeningError, ListeningTest
from tonewood.workshop.listening.session import Session

SCHEMA = "tonewood-answers/1"
FOLDER = ANSWERS
#: one line for each listener who withdrew
WITHDRAWN = "withdrawn.log"
#: characters of a listener's name; panels' names of their listeners are hashes of 64 or longer
LONGEST_NAME = 200
#: 128 random bits: a listener cannot guess the session of another one
_TOKEN = re.compile(r"[0-9a-f]{32}")
#: a line, its checksum at the end
_CHECKED = re.compile(rb'(.+), "crc32": "([0-9a-f]{8})"\}')
#: key of the header -> type
_HEADER = {"sha256": str, "listener": str, "language": str, "seed": int, "started": str, "simulated": bool}


@dataclass(frozen=True)
class LeftOut:
    """Answers that do not count: the reason, with file and line, and their number."""

    reason: str
    answers: int = 1


@dataclass(frozen=True)
class ListenerAnswers:
    """A file of answers.

    header : token, listener, language, seed, sha256 of the definition, started, simulated.
    records : answers in the order they were given.
    lines : number of the file's line of each record.
    length : bytes of whole lines.
    torn : number of the last line if it was cut off, else 0.
    left_out : lines that are no answers.
    failed : whether a check of headphones ended the test.
    """

    path: Path
    header: dict[str, Any]
    records: list[dict[str, Any]]
    lines: list[int]
    length: int
    torn: int
    left_out: tuple[LeftOut, ...] = ()
    failed: bool = False

    @property
    def listener(self) -> str:
        """Name that the listener gave, or else the beginning of the token."""
        return listener_of(self.header)


@dataclass(frozen=True)
class Answers:
    """Answers of all listeners, in the order in which they began, and those that do not count."""

    listeners: tuple[ListenerAnswers, ...]
    left_out: tuple[LeftOut, ...]


def now(timespec: str = "milliseconds") -> str:
    """The time, UTC, as records have it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec=timespec)


def printable(name: str, most: int | None = LONGEST_NAME) -> str:
    """A name in one line, of at most so many characters; control characters would steer a terminal."""
    return " ".join("".join(c if c.isprintable() else " " for c in name).split())[:most]


def listener_of(header: Mapping[str, Any]) -> str:
    """Name that a listener gave, or else the beginning of the token."""
    return printable(str(header["listener"])) or str(header["token"][:8])


def read(path: Path) -> ListenerAnswers:
    """Read a file of answers; a last line without its end is left out, and so are lines that are no JSON objects.

    Raises ListeningError : it cannot be read, or its first line is damaged; names the line.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe or a device may have no end
            raise ListeningError("is no file", file=path)
        return _parsed(path, path.read_bytes())
    except OSError as fault:
        raise ListeningError(f"cannot be read: {fault.strerror}", file=path) from None


def _parsed(path: Path, raw: bytes) -> ListenerAnswers:
    *whole, rest = raw.split(b"\n")
    rows: dict[int, dict[str, Any]] = {}
    left_out: list[LeftOut] = []
    for number, line in enumerate(whole, start=1):
        try:
            rows[number] = _row(line)
        except ListeningError as fault:
            if number == 1:
                raise ListeningError(fault.reason, file=path, line=1) from None
            left_out.append(LeftOut(str(ListeningError(fault.reason, file=path, line=number, key=fault.key))))
    header = rows.pop(1, {})
    if header.get("schema") != SCHEMA or not _TOKEN.fullmatch(str(header.get("token", ""))):
        raise ListeningError(f"no answers of a listener: schema {SCHEMA} is wanted", file=path)
    for key, kind in _HEADER.items():
        if type(header.get(key)) is not kind:
            raise ListeningError(f"{header.get(key)!r} is no {kind.__name__}", file=path, line=1, key=key)
    try:
        place_of(header)
    except ListeningError as fault:
        raise ListeningError(fault.reason, file=path, line=1, key="place") from None
    if header["token"] != path.stem:
        raise ListeningError("is the file of another session: its name is not its token", file=path, key="token")
    torn = len(whole) + 1 if rest else 0
    return ListenerAnswers(path, header, [*rows.values()], [*rows], len(raw) - len(rest), torn, tuple(left_out))


def _row(line: bytes) -> dict[str, Any]:
    try:
        row = json_value(line)
        json.dumps(row, ensure_ascii=False).encode()  # half a surrogate pair can be escaped, but is no text
    except (ValueError, RecursionError) as fault:
        raise ListeningError(f"not JSON: {fault}") from None
    if not isinstance(row, dict):
        raise ListeningError("not an answer")
    if "crc32" in row:
        match = _CHECKED.fullmatch(line)
        if match is None or int(match[2], 16) != zlib.crc32(match[1]):
            raise ListeningError("damaged: it has another checksum", key="crc32")
        del row["crc32"]
    return row


def _line(record: Mapping[str, Any]) -> bytes:
    """Line of an answer, as `_row` reads it."""
    text = json.dumps(record, ensure_ascii=False, allow_nan=False).removesuffix("}").encode()
    return text + f', "crc32": "{zlib.crc32(text):08x}"}}\n'.encode()


class OpenSession:
    """A session whose answers are kept on disk."""

    def __init__(self, session: Session, header: dict[str, Any], path: Path, length: int):
        self.session, self.header, self.path, self.length = session, header, path, length

    @property
    def language(self) -> str:
        """The listener's."""
        return str(self.header["language"])

    @property
    def listener(self) -> str:
        """Name that the listener gave, or else the beginning of the token."""
        return listener_of(self.header)

    def answer(self, message: Mapping[str, Any], *, now: str) -> dict[str, Any]:
        """Check an answer, write it to the disk, and then go on; returns its record.

        Raises ListeningError : it does not fit the step.
        Raises OutputError : the disk does not take it. After this or another error the session is at its step as
            before; if
            the file may hold a part of the answer, take the session up again by `resume`.
        """
        record = {**self.session.record(message), "time": now}
        record_bytes = _line(record)
        _append(self.path, record_bytes, at=self.length, sync=not self.header["simulated"])
        self.length += len(record_bytes)
        self.session.take(record)
        return record


def free_place(test: ListeningTest) -> int:
    """The least place that no listener holds: of those who withdrew or did not pass a check, it is given again.

    Only pages with `subset` need places; without them it is 0.
    """
    if not any(isinstance(page, TrialPage) and page.subset is not None for page in test.pages):
        return 0
    taken = set()
    for path in (test.folder / FOLDER).glob("*.jsonl"):
        try:
            answers = read(path)
            at_check = bool(answers.records) and answers.records[-1].get("type") == "headphones"
            if at_check and _replayed(test, answers)[0].failed is not None:
                continue
            taken.add(place_of(answers.header))
        except (ListeningError, LookupError, TypeError):  # the analysis reports it
            continue
    return next(k for k in range(len(taken) + 1) if k not in taken)


def place_of(header: Mapping[str, Any]) -> int:
    """Place of a listener; 0 in files of earlier versions, which had none.

    Raises ListeningError : it is no such number.
    """
    index = header.get("place", 0)
    if type(index) is not int or not 0 <= index < 2**31:
        raise ListeningError(f"{index!r} is no number of a listener", key="place")
    return index


def withdraw(test: ListeningTest, token: str, *, now: str) -> bool:
    """Delete the answers of a session, damaged or not; returns whether there were any.

    Raises OutputError : the file cannot be removed.
    """
    path = test.folder / FOLDER / f"{token}.jsonl"
    try:
        if not _TOKEN.fullmatch(token) or not path.is_file():
            return False
        text = json.dumps({"time": now, "answers": _lines_after_the_first(path)}) + "\n"
        path.unlink()
        _sync(path.parent)
        with (path.parent / WITHDRAWN).open("ab") as stream:
            stream.write(text.encode())
    except OSError as fault:
        raise OutputError(f"cannot be removed: {fault.strerror}", file=path) from None
    return True


def withdrawn(test: ListeningTest) -> int:
    """Number of listeners who withdrew."""
    try:
        return (test.folder / FOLDER / WITHDRAWN).read_bytes().count(b"\n")
    except OSError:
        return 0


def exported(opened: OpenSession) -> dict[str, Any]:
    """What a listener gave, for the listener: no code, level or right answer is in it."""
    kept = ("page", "type", "training", "repetition", "answer", "time")
    header = {key: opened.header[key] for key in ("test", "listener", "language", "started")}
    return {
        **header,
        "answers": [{key: record[key] for key in kept if key in record} for record in opened.session.answers],
    }


def begin(
    test: ListeningTest, *, language: str, listener: str, started: str, seed: int | None = None, simulated: bool = False
) -> OpenSession:
    """Begin a session: make its file. Two calls at one time would give one place twice.

    Raises ListeningError : the name is too long; cut off, it would be that of another listener.
    Raises OutputError : it cannot be written.
    """
    if len(name := printable(listener, most=None)) > LONGEST_NAME:
        raise ListeningError(f"has {len(name)} characters, {LONGEST_NAME} are allowed", key="listener")
    token = secrets.token_hex(16)
    own_seed = secrets.randbits(48) if seed is None else seed
    header = {
        "schema": SCHEMA,
        "token": token,
        "test": test.manifest.name,
        "sha256": test.sha256,
        "listener": name,
        "language": language,
        "seed": own_seed,
        "place": free_place(test),
        "started": started,
        "simulated": simulated,
    }
    header_bytes = (json.dumps(header, ensure_ascii=False) + "\n").encode()
    path = test.folder / FOLDER / f"{token}.jsonl"
    part = path.with_suffix(".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(b"")
            _append(part, header_bytes, at=0, sync=True)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        _sync(path.parent)
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
    return OpenSession(Session(test, own_seed, place_of(header)), header, path, len(header_bytes))


def clear_parts(test: ListeningTest) -> None:
    """Remove unfinished files of a server that was killed."""
    for part in (test.folder / FOLDER).glob("*.part"):
        remove(part)


def resume(test: ListeningTest, token: str) -> OpenSession | None:
    """Take up the session of a token again; None if there is none.

    Raises ListeningError : its answers are damaged, or were given to another definition.
    Raises OutputError : the file cannot be read now, a line that was cut off cannot be removed, or the disk does not
        confirm
        the answers.
    """
    path = test.folder / FOLDER / f"{token}.jsonl"
    try:
        if not _TOKEN.fullmatch(token) or not path.is_file():
            return None
        raw = path.read_bytes()
    except OSError as fault:  # not the end of the session: the disk, or this process, may be able to later
        raise OutputError(f"cannot be read: {fault.strerror}", file=path) from None
    answers = _parsed(path, raw)
    if answers.header["sha256"] != test.sha256:
        raise ListeningError("was begun with another version of this test", file=path)
    session, kept = _replayed(test, answers)
    if kept.left_out:
        raise ListeningError(kept.left_out[0].reason)
    try:
        if answers.torn:
            os.truncate(path, answers.length)
        if not answers.header["simulated"]:
            _sync(path)  # the server before may have been killed between writing and waiting for the disk
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
    return OpenSession(session, answers.header, path, answers.length)


def answers_of(test: ListeningTest) -> Answers:
    """Answers of all listeners; damaged ones, and those to another definition, are left out and reported."""
    kept: list[ListenerAnswers] = []
    left_out: list[LeftOut] = []
    for path in sorted((test.folder / FOLDER).glob("*.jsonl")):
        try:
            answers = read(path)
            if answers.header["sha256"] != test.sha256:
                raise ListeningError("was answered with another version of this test", file=path)
        except ListeningError as fault:
            left_out.append(LeftOut(str(fault), _lines_after_the_first(path)))
            continue
        one = _replayed(test, answers)[1]
        kept.append(one)
        left_out += one.left_out
        if one.torn:
            reason = "is cut off: its answer was not confirmed to the listener"
            left_out.append(LeftOut(str(ListeningError(reason, file=path, line=one.torn))))
    kept.sort(key=lambda one: (one.header["started"], one.header["token"]))
    return Answers(tuple(kept), tuple(left_out))


def _lines_after_the_first(path: Path) -> int:
    try:
        return count_answers(path)
    except OSError:
        return 0


def _replayed(test: ListeningTest, answers: ListenerAnswers) -> tuple[Session, ListenerAnswers]:
    """Return the session that gives these records again, answer by answer, and the answers of its course.

    A record that does not fit is left out. One that fits a later step is taken there: the answers between are missing.
    """
    seed, index = answers.header["seed"], answers.header.get("place", 0)
    session = Session(test, seed, index)
    history: list[dict[str, Any] | None] = []  # None: passed over
    kept: list[tuple[int, dict[str, Any]]] = []
    left_out = list(answers.left_out)
    for line, record in zip(answers.lines, answers.records, strict=True):
        fault = _misfit(session, record)
        if fault is not None:
            ahead = Session(test, seed, index)
            for old in history:
                ahead.pass_over() if old is None else ahead.take(old)
            skipped = 0
            while ahead.step is not None and _misfit(ahead, record) is not None:
                ahead.pass_over()
                skipped += 1
            if ahead.step is None:
                left_out.append(LeftOut(str(ListeningError(fault.reason, file=answers.path, line=line, key=fault.key))))
                continue
            session, history = ahead, history + [None] * skipped
            before = kept[-1][0] if kept else 1
            if (missing := skipped - (line - before - 1)) > 0:
                reason = f"{missing} {'answer' if missing == 1 else 'answers'} before it missing"
                left_out.append(LeftOut(str(ListeningError(reason, file=answers.path, line=line)), missing))
        record_of_answer = session.record(record["answer"])
        session.take(record_of_answer)
        history.append(record_of_answer)
        kept.append((line, record))
    return session, replace(
        answers,
        records=[record for _, record in kept],
        lines=[line for line, _ in kept],
        left_out=tuple(left_out),
        failed=session.failed is not None,
    )


def _misfit(session: Session, record: Mapping[str, Any]) -> ListeningError | None:
    """Why a record is not that of the session's step; None if it is."""
    try:
        if not isinstance(answer := record.get("answer"), dict):
            raise ListeningError(f"is {answer!r}; a mapping is allowed", key="answer")
        entry = session.record(answer)
        for key, value in json.loads(json.dumps(entry)).items():
            if key == "index" and session.incomplete:
                continue  # the number of trials of a page before is unknown
            if key not in record or record[key] != value:
                reason = f"is {record.get(key)!r}, and {value!r} in the course of this test: the file is damaged"
                raise ListeningError(reason, key=key)
    except ListeningError as fault:
        return fault
    return None


def _append(path: Path, line: bytes, *, at: int, sync: bool) -> None:
    """Append a line by one write and wait until it is on the disk; the part that a full disk took is cut off again.

    at : length that the file must have: no other program may have written to it.
    sync : wait; answers of simulated listeners can be had again.
    """
    try:
        # a pipe in its place does not block
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | getattr(os, "O_NONBLOCK", 0))
        try:
            if os.fstat(handle).st_size != at:
                raise OutputError("was changed by another program", file=path)
            try:
                if os.write(handle, line) != len(line):
                    raise OSError(28, "No space left on device")
                if sync:
                    os.fsync(handle)
            except OSError:
                os.ftruncate(handle, at)
                raise
        finally:
            os.close(handle)
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        return
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
