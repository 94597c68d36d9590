"""Answers of listeners: webMUSHRA's result tables, opened with the key of the batch.

webMUSHRA appends one block of rows per session to a CSV file of each test type (``mushra.csv``, ``bs1116.csv``,
``paired_comparison.csv``). Columns between ``session_test_id`` and ``trial_id`` are the questionnaire's, and
``session_uuid`` where its version writes one. Nothing is dropped: a row that does not fit the key is an error.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from tonewood.batch.records import KEY_SCHEMA
from tonewood.errors import TonewoodError
from tonewood.validation_messages import first_message

Kind = Literal["mushra", "bs1116", "paired_comparison"]
MAX_BYTES = 50_000_000
COLUMNS: dict[Kind, tuple[str, ...]] = {
    "mushra": ("rating_stimulus", "rating_score"),
    "bs1116": ("rating_reference", "rating_non_reference", "rating_reference_score", "rating_non_reference_score"),
    "paired_comparison": ("choice_reference", "choice_non_reference", "choice_answer"),
}
ANSWERS = ("correct", "incorrect", "undecided", "unknown")
HELPERS = ("reference", "anchor35", "anchor70")  # what webMUSHRA calls the sounds it adds


class ResultsError(TonewoodError):
    """A table of results or its key cannot be read."""


@dataclass(frozen=True)
class Answer:
    """One row.

    Attributes
    ----------
    listener : session, from its uuid or the questionnaire.
    trial : blind id of the trial.
    label : the level heard, e.g. ``damping=proportional``, or ``reference``, ``anchor35``, ``anchor70``.
    condition : full name of the condition (of the reference for the anchors).
    score : 0..100 for mushra; difference to the hidden reference for bs1116; NaN for a choice.
    choice : one of `ANSWERS` for paired_comparison, else None.
    """

    listener: str
    trial: str
    label: str
    condition: str
    score: float
    choice: str | None = None


class KeyTrial(BaseModel):
    """A trial of the key: codes of its sounds."""

    type: str
    group: str
    reference: str | None
    stimuli: list[str]


class Sound(BaseModel):
    """Condition and levels of a code."""

    condition: str
    levels: dict[str, str]


class Key(BaseModel):
    """The opened key of a batch."""

    model_config = ConfigDict(strict=True, frozen=True)

    schema_: Literal["tonewood-key/1"] = Field(alias="schema")
    name: str
    trials: dict[str, KeyTrial]
    stimuli: dict[str, Sound]
    factors: list[str]

    @model_validator(mode="after")
    def _codes_lead_somewhere(self) -> Key:
        for name, trial in self.trials.items():
            rated = trial.type in ("mushra", "bs1116")
            for code in (*trial.stimuli, *([trial.reference] if rated or trial.reference is not None else [])):
                if code not in self.stimuli:
                    raise PydanticCustomError("key", f"trials.{name}: {code!r} is not one of the key's stimuli")
        for code, sound in self.stimuli.items():
            if missing := set(self.factors) - set(sound.levels):
                raise PydanticCustomError("key", f"stimuli.{code}.levels: {min(missing)} is missing")
        return self

    def label(self, trial: str, code: str) -> str:
        """Levels of a sound that tell it from the others of its trial."""
        entry = self.trials[trial]
        codes = [c for c in (entry.reference, *entry.stimuli) if c is not None]
        levels = [self.stimuli[c].levels for c in codes]
        mine = self.stimuli[code].levels
        own = [f"{f}={mine[f]}" for f in self.factors if len({row[f] for row in levels}) > 1]
        return ", ".join(own) or self.stimuli[code].condition

    def condition(self, trial: str, code: str) -> str:
        """Full name of the condition behind a code, or behind the reference for a helper."""
        return self.stimuli[(self.trials[trial].reference or "") if code in HELPERS else code].condition


def read_key(path: str | os.PathLike[str]) -> Key:
    """Read ``key.json``.

    Raises
    ------
    ResultsError
        It cannot be read, or is not a key.
    """
    try:
        data = json.loads(_read(path))
    except (ValueError, RecursionError) as fault:
        raise ResultsError(f"not JSON: {fault}", file=path) from None
    if not isinstance(data, dict) or data.get("schema") != KEY_SCHEMA:
        raise ResultsError(f"not a key: schema {KEY_SCHEMA} is wanted", file=path)
    try:
        return Key.model_validate(data)
    except ValidationError as fault:
        key, reason = first_message(fault, Key)
        raise ResultsError(f"not a whole key: {reason}", file=path, key=key) from None


def read_answers(path: str | os.PathLike[str], key: Key) -> tuple[Kind, list[Answer]]:
    """Read a table of results.

    Raises
    ------
    ResultsError
        The table has not webMUSHRA's columns, or a row is not of this batch; names line and column.
    """
    text = _read(path)
    header_line = text.split("\n", 1)[0]
    reader = csv.reader(io.StringIO(text), delimiter=";" if header_line.count(";") > header_line.count(",") else ",")
    try:
        header = [name.strip() for name in next(reader)]
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except StopIteration:
        raise ResultsError("is empty", file=path) from None
    except csv.Error as fault:
        raise ResultsError(f"line {reader.line_num}: {fault}", file=path) from None
    kind = _kind(header, path)
    if not rows:
        raise ResultsError("holds no answers", file=path)
    return kind, list(_answers(kind, header, rows, key, path))


def _kind(header: list[str], path: str | os.PathLike[str]) -> Kind:
    for kind, columns in COLUMNS.items():
        if columns[-1] in header:
            missing = [c for c in ("session_test_id", "trial_id", *columns) if c not in header]
            if missing:
                raise ResultsError(f"column {missing[0]} is missing; found {', '.join(header)}", file=path)
            return kind
    wanted = ", ".join(columns[-1] for columns in COLUMNS.values())
    raise ResultsError(f"not a table of webMUSHRA: one of the columns {wanted} is wanted", file=path)


def _answers(
    kind: Kind, header: list[str], rows: list[tuple[int, list[str]]], key: Key, path: str | os.PathLike[str]
) -> Iterator[Answer]:
    asked = header[header.index("session_test_id") + 1 : header.index("trial_id")]
    identity = ["session_uuid"] if "session_uuid" in header else asked
    sessions = _Sessions()
    for line, cells in rows:
        if len(cells) != len(header):
            raise ResultsError(f"line {line}: {len(cells)} cells; the header has {len(header)}", file=path)
        row = {name: cell.strip() for name, cell in zip(header, cells, strict=True)}

        def fault(column: str, allowed: str, row: dict[str, str] = row, line: int = line) -> ResultsError:
            return ResultsError(f"line {line}: {row[column]!r} is not {allowed}", file=path, key=column)

        if row["session_test_id"].lower() != key.name.lower():
            raise fault("session_test_id", f"the batch of the key, {key.name}")
        trial = row["trial_id"]
        if trial not in key.trials or key.trials[trial].type != kind:
            raise fault("trial_id", f"a {kind} trial of the key")
        heard = "rating_stimulus" if kind == "mushra" else COLUMNS[kind][1]
        code = row[heard]
        if code not in key.trials[trial].stimuli and not (kind == "mushra" and code in HELPERS):
            raise fault(heard, "a stimulus of its trial")
        listener = sessions.listener(", ".join(row[c] for c in identity), (trial, code))
        label = code if code in HELPERS else key.label(trial, code)
        score, choice = math.nan, None
        if kind == "paired_comparison":
            choice = row["choice_answer"]
            if choice not in ANSWERS:
                raise fault("choice_answer", f"one of {', '.join(ANSWERS)}")
        elif kind == "mushra":
            score = _score(row, "rating_score", 0.0, 100.0, fault)
        else:
            score = _score(row, "rating_non_reference_score", 1.0, 5.0, fault)
            score -= _score(row, "rating_reference_score", 1.0, 5.0, fault)
        yield Answer(listener, trial, label, key.condition(trial, code), score, choice)


class _Sessions:
    """Distinguishes sessions: by the listener, and by an answer that is given a second time."""

    def __init__(self) -> None:
        self.given: dict[str, set[tuple[str, str]]] = {}
        self.times: dict[str, int] = {}

    def listener(self, who: str, what: tuple[str, str]) -> str:
        if what in self.given.get(who, set()):
            self.given[who] = set()
            self.times[who] = self.times.get(who, 1) + 1
        self.given.setdefault(who, set()).add(what)
        name = who or "listener"
        return f"{name} #{self.times[who]}" if who in self.times else name


def _score(row: dict[str, str], column: str, low: float, high: float, fault: Any) -> float:
    try:
        value = float(row[column])
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise fault(column, f"a number from {low:g} to {high:g}")
    return value


def _read(path: str | os.PathLike[str]) -> str:
    try:
        raw = Path(path).read_bytes()
    except OSError as fault:
        raise ResultsError(f"cannot be read: {fault.strerror}", file=path) from None
    if len(raw) > MAX_BYTES:
        raise ResultsError(f"longer than the {MAX_BYTES} bytes allowed", file=path)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise ResultsError(f"byte {fault.start} is not UTF-8", file=path) from None
