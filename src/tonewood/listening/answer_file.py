"""Answers on disk: one file a listener, one JSON line an answer, written through to the disk.

The file appears complete with its first line (who, which test, which seed). Each answer is appended by one write and is
on the disk before the server confirms it. A line that a crash cut off has no line end: it is left out when
the file is read, and cut off when it is taken up again; that answer was never confirmed, so its page is shown again.
"""

from __future__ import annotations

import json
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tonewood.errors import OutputError
from tonewood.listening.definition import ListeningError, ListeningTest
from tonewood.listening.session import Session

SCHEMA = "tonewood-answers/1"
FOLDER = "answers"
#: 128 random bits: nobody finds the session of another one
_TOKEN = re.compile(r"[0-9a-f]{32}")
#: key of the header -> type
_HEADER = {"sha256": str, "listener": str, "language": str, "seed": int, "started": str, "simulated": bool}


@dataclass(frozen=True)
class ListenerAnswers:
    """A file of answers.

    Attributes
    ----------
    header : token, listener, language, seed, sha256 of the definition, started, simulated.
    records : answers in the order they were given.
    length : bytes of whole lines.
    torn : whether a line was cut off.
    """

    path: Path
    header: dict[str, Any]
    records: list[dict[str, Any]]
    length: int
    torn: bool

    @property
    def listener(self) -> str:
        """Name that the listener gave, or else the beginning of the token."""
        return str(self.header.get("listener") or self.header["token"][:8])


def read(path: Path) -> ListenerAnswers:
    """Read a file of answers; a last line without its end is left out.

    Raises
    ------
    ListeningError : it cannot be read, or a whole line is damaged; names the line.
    """
    try:
        raw = path.read_bytes()
    except OSError as fault:
        raise ListeningError(f"cannot be read: {fault.strerror}", file=path) from None
    whole = raw[: raw.rfind(b"\n") + 1]
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as fault:
            raise ListeningError(f"line {number}: not JSON: {fault}", file=path) from None
        if not isinstance(row, dict):
            raise ListeningError(f"line {number}: not an answer", file=path)
        rows.append(row)
    if not rows or rows[0].get("schema") != SCHEMA or not _TOKEN.fullmatch(str(rows[0].get("token", ""))):
        raise ListeningError(f"no answers of a listener: schema {SCHEMA} is wanted", file=path)
    for key, kind in _HEADER.items():
        if type(rows[0].get(key)) is not kind:
            raise ListeningError(f"line 1: {rows[0].get(key)!r} is no {kind.__name__}", file=path, key=key)
    return ListenerAnswers(path, rows[0], rows[1:], len(whole), len(whole) < len(raw))


class OpenSession:
    """A session whose answers are kept on disk.

    Attributes
    ----------
    session : its course.
    header : first line of its file.
    """

    def __init__(self, session: Session, header: dict[str, Any], path: Path):
        self.session, self.header, self.path = session, header, path

    @property
    def language(self) -> str:
        """The listener's."""
        return str(self.header["language"])

    def answer(self, given: dict[str, Any], *, now: str) -> dict[str, Any]:
        """Check an answer, write it to the disk, and go on; returns its record.

        Raises
        ------
        ListeningError : it does not fit the step.
        OutputError : the disk does not take it; the session stays at its step.
        """
        session = self.session
        before = Session(session.test, session.seed)  # the same course again, if the disk fails
        try:
            record = {**session.answer(given), "time": now}
            line = (json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n").encode()
            _append(self.path, line, sync=not self.header["simulated"])
        except OutputError:
            for old in session.answers[:-1]:
                before.take(old)
            self.session = before
            raise
        return record


def begin(
    test: ListeningTest, *, language: str, listener: str, started: str, seed: int | None = None, simulated: bool = False
) -> OpenSession:
    """Begin a session: make its file.

    Raises
    ------
    OutputError : it cannot be written.
    """
    token = secrets.token_hex(16)
    own_seed = secrets.randbits(48) if seed is None else seed
    header = {
        "schema": SCHEMA,
        "token": token,
        "test": test.manifest.name,
        "sha256": test.sha256,
        "listener": listener,
        "language": language,
        "seed": own_seed,
        "started": started,
        "simulated": simulated,
    }
    path = test.folder / FOLDER / f"{token}.jsonl"
    part = path.with_suffix(".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(b"")
        _append(part, (json.dumps(header, ensure_ascii=False) + "\n").encode())
        os.replace(part, path)
        _sync_folder(path.parent)
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
    return OpenSession(Session(test, own_seed), header, path)


def resume(test: ListeningTest, token: str) -> OpenSession | None:
    """Take up the session of a token again; None if there is none.

    Raises
    ------
    ListeningError : its answers are damaged, or were given to another definition.
    OutputError : a line that was cut off cannot be removed.
    """
    path = test.folder / FOLDER / f"{token}.jsonl"
    if not _TOKEN.fullmatch(token) or not path.is_file():
        return None
    found = read(path)
    if found.header["sha256"] != test.sha256:
        raise ListeningError("was begun with another version of this test", file=path)
    if found.torn:
        try:
            os.truncate(path, found.length)
        except OSError as fault:
            raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None
    return OpenSession(_replayed(test, found), found.header, path)


def answers_of(test: ListeningTest) -> list[ListenerAnswers]:
    """Answers of all listeners, in the order in which they began.

    Raises
    ------
    ListeningError : answers are damaged, or were given to another definition.
    """
    found = [read(path) for path in sorted((test.folder / FOLDER).glob("*.jsonl"))]
    for one in found:
        if one.header["sha256"] != test.sha256:
            raise ListeningError("was answered with another version of this test", file=one.path)
        _replayed(test, one)
    return sorted(found, key=lambda one: (one.header["started"], one.header["token"]))


def _replayed(test: ListeningTest, found: ListenerAnswers) -> Session:
    """Return the session that gives these records again, answer by answer.

    Raises
    ------
    ListeningError : none does; names the line.
    """
    session = Session(test, found.header["seed"])
    for line, record in enumerate(found.records, start=2):
        try:
            if not isinstance(answer := record.get("answer"), dict):
                raise ListeningError(f"is {answer!r}; a mapping is allowed", key="answer")
            made = session.answer(answer)
        except ListeningError as fault:
            raise ListeningError(fault.reason, file=found.path, line=line, key=fault.key) from None
        for key, value in json.loads(json.dumps(made)).items():
            if key not in record or record[key] != value:
                reason = f"is {record.get(key)!r}, and {value!r} in the course of this test: the file is damaged"
                raise ListeningError(reason, file=found.path, line=line, key=key)
    return session


def _append(path: Path, line: bytes, *, sync: bool = True) -> None:
    """Append a line by one write and wait until it is on the disk; the part that a full disk took is cut off again.

    Parameters
    ----------
    sync : wait; answers of simulated listeners can be had again.
    """
    try:
        handle = os.open(path, os.O_WRONLY | os.O_APPEND)
        try:
            before = os.fstat(handle).st_size
            try:
                if os.write(handle, line) != len(line):
                    raise OSError(28, "No space left on device")
                if sync:
                    os.fsync(handle)
            except OSError:
                os.ftruncate(handle, before)
                raise
        finally:
            os.close(handle)
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=path) from None


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
