"""Answers as a tidy table: one row an answer, a column a factor, opened with the key of the batch.

A page of several ratings gives a row for each. Columns besides the factors: listener, simulated, page, type, trial,
index, repetition, training, stimulus (code), role (sound, reference, anchor35, anchor70), item (scale or question),
value (a number), response (as given), right, level and track of a staircase, seconds, plays (of all sounds), heard (the
least share of a sound that was heard), time. In a pair the factor
that differs reads ``a|b``; its value is 1 where the second level was chosen, or the answer was right, 0 where not, 0.5
for a tie.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from tonewood.support.csv_text import csv_text
from tonewood.support.validation_messages import first_message
from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.manifest import ANSWER_COLUMNS
from tonewood.workshop.batch.pages import PairedPage
from tonewood.workshop.batch.records import KEY_SCHEMA
from tonewood.workshop.listening.answer_file import ListenerAnswers
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial, read_json
from tonewood.workshop.listening.trials import OPEN

#: levels of two sounds of a pair, and between them
VERSUS = "|"
COLUMNS = ANSWER_COLUMNS
#: columns that the analysis reads where answers have factors: none of these may have such a name
_READ = {
    "listener", "page", "trial", "index", "repetition", "training", "role", "item", "value", "response", "right",
}  # fmt: skip
#: columns that are fields of a record
_FROM_RECORD = ("page", "type", "trial", "index", "repetition", "training", "right", "level", "track")


class KeySound(BaseModel):
    """Condition and levels of a code."""

    condition: str
    levels: dict[str, str]
    role: str = "sound"


class Key(BaseModel):
    """The key of a batch: codes -> conditions."""

    model_config = ConfigDict(frozen=True)

    schema_: str = Field(alias="schema")
    name: str
    factors: list[str]
    levels: dict[str, list[str]]
    stimuli: dict[str, KeySound]

    @model_validator(mode="after")
    def _levels_are_there(self) -> Key:
        if missing := set(self.factors) - set(self.levels):
            raise PydanticCustomError("key", f"levels.{min(missing)} is missing")
        for code, sound in self.stimuli.items():
            if missing := set(self.factors) - set(sound.levels):
                raise PydanticCustomError("key", f"stimuli.{code}.levels: {min(missing)} is missing")
        return self


@dataclass(frozen=True)
class AnswerTable:
    """Answers of all listeners.

    factors : columns of factors with more than one level.
    rows : one an answer; values are str, float, bool or None.
    """

    factors: tuple[str, ...]
    levels: Mapping[str, Sequence[str]]
    rows: tuple[dict[str, Any], ...]

    def of_page(self, page: int) -> list[dict[str, Any]]:
        """Answers to the trials of a page (from 0) that count."""
        return [row for row in self.rows if row["page"] == page + 1 and not row["training"]]

    def write(self, path: Path) -> None:
        """Write all rows as CSV."""
        rows = ({k: _cell(v) for k, v in row.items()} for row in self.rows)
        write_whole(path, csv_text([*COLUMNS, *self.factors], rows), make_folder=True)


def read_key(path: Path) -> Key:
    """Read the key of a batch. Raises ListeningError : it cannot be read, or is no key."""
    _, data = read_json(path, KEY_SCHEMA, "key")
    try:
        return Key.model_validate(data)
    except ValidationError as fault:
        key, reason = first_message(fault, Key)
        raise ListeningError(f"not a whole key: {reason}", file=path, key=key) from None


def tidy(test: ListeningTest, key: Key, answers: Sequence[ListenerAnswers]) -> AnswerTable:
    """The table of all answers. Raises ListeningError : a code is not in the key, or a factor has a column's name."""
    names = _listener_names(answers)
    trials = {trial.id: trial for trial in test.trials}
    factors = tuple(f for f in key.factors if len({s.levels[f] for s in key.stimuli.values()}) > 1)
    if taken := sorted(_READ & set(factors)):
        raise ListeningError(
            f"{taken[0]} is a column of the table of answers, too; give it another name", key="factors"
        )
    factors += ("repeat",) if len({s.levels.get("repeat") for s in key.stimuli.values()}) > 1 else ()
    rows: list[dict[str, Any]] = []
    for one in answers:
        for record in one.records:
            base = {
                "listener": names[one.path],
                "simulated": bool(one.header.get("simulated")),
                "time": record.get("time", ""),
                **{k: record.get(k) for k in _FROM_RECORD},
                "seconds": record["answer"].get("seconds"),
                "plays": sum(record["answer"].get("plays", {}).values()),
                "heard": min(record["answer"].get("heard", {}).values(), default=None),
            }
            for fields in _rows(test, key, factors, trials, record):
                rows.append({**dict.fromkeys((*COLUMNS, *factors)), **base, **fields})
    return AnswerTable(factors, key.levels, tuple(rows))


def _rows(
    test: ListeningTest, key: Key, factors: Sequence[str], trials: Mapping[str, ServedTrial], record: dict[str, Any]
) -> Iterable[dict[str, Any]]:
    answer, slots = record["answer"], record["slots"]
    page = test.pages[record["page"] - 1]
    if "ratings" in answer:
        hidden = slots[OPEN]
        for slot, value in answer["ratings"].items():
            code = slots[slot]
            sound = _sound(key, code)
            role = "reference" if code == hidden else sound.role
            levels = {f: sound.levels[f] for f in factors}
            yield {"stimulus": code, "role": role, "value": value, "response": value, **levels}
    elif record["type"] == "rating":
        (code,) = slots.values()
        levels = {f: _sound(key, code).levels[f] for f in factors}
        for name, value in answer["values"].items():
            yield {"stimulus": code, "role": "sound", "item": name, "value": value, "response": value, **levels}
    elif "values" in answer:
        for name, value in answer["values"].items():
            number = value if isinstance(value, (int, float)) else None
            yield {"item": name, "value": number, "response": value}
    elif record["type"] == "headphones":
        yield {"item": "headphones", "value": float(record["right"]), "response": answer["choice"]}
    elif record["trial"] in trials:
        trial = trials[record["trial"]]
        first, second = _sound(key, trial.reference or ""), _sound(key, trial.stimuli[0])
        levels = {f: a if (a := first.levels[f]) == (b := second.levels[f]) else f"{a}{VERSUS}{b}" for f in factors}
        choice = answer["choice"]
        share: float | None = None
        if isinstance(page, PairedPage) or record["type"] == "paired_comparison":
            share = 0.5 if choice == "tie" else float(slots[choice] == trial.stimuli[0])
        elif choice != "undecided":
            share = float(record["right"])
        yield {"stimulus": trial.stimuli[0], "role": "pair", "value": share, "response": choice, **levels}
    elif record.get("level") is not None:
        yield {"role": "pair", "value": float(record["right"]), "response": answer["choice"]}
    elif "spl_db" in answer:
        yield {"item": "spl_db", "value": answer["spl_db"], "response": answer["spl_db"]}


def _sound(key: Key, code: str) -> KeySound:
    try:
        return key.stimuli[code]
    except KeyError:
        raise ListeningError(
            f"{code!r} is not one of the key's stimuli: key and test are of different batches"
        ) from None


def _listener_names(answers: Sequence[ListenerAnswers]) -> dict[Path, str]:
    """Names of listeners, each another one: a name given twice gets a number."""
    names: dict[Path, str] = {}
    taken: set[str] = set()
    last: Counter[str] = Counter()
    for one in answers:
        name = one.listener
        while name in taken:
            last[one.listener] += 1
            name = f"{one.listener} #{last[one.listener] + 1}"
        taken.add(name)
        names[one.path] = name
    return names


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return int(value)
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
