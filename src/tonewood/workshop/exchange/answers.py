"""Answers collected by other programs: webMUSHRA's tables, and a plain table that any program can write.

The plain table (CSV, the first row names the columns) has a row a rating, with `listener`, `page`, `trial`, `stimulus`
(a blind code), `item` (a scale, where a page has several) and `value`; or a row an answer, with `listener`, `page`,
`trial`, a column for each slot (A, B, X, 1, 2, 3, reference) that holds a code, and `response` (A, same, 2, ...).
Columns `repetition` and `seconds` may stand beside. The tables of the exports for jsPsych and PsychoPy are such tables.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tonewood.support.text_files import decoded
from tonewood.support.units import counted, number_in
from tonewood.workshop.batch import pages
from tonewood.workshop.exchange.course import identifiers
from tonewood.workshop.exchange.psychopy import KEYS
from tonewood.workshop.listening.answer_file import LeftOut, ListenerAnswers, printable
from tonewood.workshop.listening.checked_answer import choices
from tonewood.workshop.listening.definition import ListeningError, ListeningTest, ServedTrial
from tonewood.workshop.listening.trials import LETTERS, OPEN

_SLOTS = ("A", "B", "X", "1", "2", "3", OPEN)
_WEBMUSHRA = {"rating_stimulus": "mushra", "choice_answer": "pair", "rating_reference_score": "bs1116"}
#: kind of webMUSHRA's table -> columns that are read, and the page whose trials it may name
_READ: dict[str, tuple[tuple[str, ...], type[pages.AnyPage]]] = {
    "mushra": (("trial_id", "rating_stimulus", "rating_score"), pages.MushraPage),
    "pair": (("trial_id", "choice_answer"), pages.AbxPage),
    "bs1116": (
        ("trial_id", "rating_reference_score", "rating_non_reference", "rating_non_reference_score"),
        pages.Bs1116Page,
    ),
}
#: columns of PsychoPy's table with an answer
_KEY, _RATE = re.compile(r"answer\d+\.keys"), re.compile(r"rate\d+_(\w+)\.response")
_MOST_BYTES = 200_000_000
#: characters of a reason
_MOST_SHOWN = 300
Row = dict[str, str]


@dataclass(frozen=True)
class Imported:
    """Answers of listeners, and rows that do not count."""

    listeners: tuple[ListenerAnswers, ...]
    left_out: tuple[LeftOut, ...]


@dataclass
class _TrialAnswer:
    """One answer, collected of its rows: ratings by code (and item), or a choice."""

    trial: ServedTrial
    page: int
    repetition: int
    slots: dict[str, str]
    ratings: dict[tuple[str, str], float]
    choice: str | None = None
    right: bool | None = None
    seconds: float = 0.0
    session: str = ""


def read_answers(path: Path, test: ListeningTest) -> Imported:
    """Read a table of answers; rows that do not fit the test are left out, and named by file and line.

    Raises ListeningError : the file cannot be read, is no such table, or no row of it fits.
    """
    rows, columns = _table(path)
    if len(columns) == 1 and (other := next((mark for mark in ";\t|" if mark in "".join(columns)), "")):
        raise ListeningError(f"has {other!r} between its columns; commas are wanted", file=path)
    kind = next((kind for column, kind in _WEBMUSHRA.items() if column in columns), None)
    if kind is None:
        missing = [name for name in ("page", "trial") if name not in columns]
        if missing or not {"listener", "participant"} & columns:
            allowed = "listener, page and trial, or those of webMUSHRA"
            raise ListeningError(
                f"has no column {missing[0] if missing else 'listener'}; {allowed} are wanted", file=path
            )
    elif missing := [name for name in _READ[kind][0] if name not in columns]:
        raise ListeningError(f"has no column {missing[0]}; {', '.join(_READ[kind][0])} are wanted", file=path)
    trials = {trial.id: trial for trial in test.trials}
    answers: dict[str, dict[tuple[Any, ...], _TrialAnswer]] = {}
    spoken: dict[str, list[dict[str, Any]]] = {}
    left_out: list[LeftOut] = []
    for line, row, beyond in rows:
        try:
            who = _who(row)
            if beyond:  # a comma in a number makes two cells of it
                raise ListeningError(f"{beyond!r} is a cell beyond the columns that the first row names")
            if kind is None and (record := _questionnaire(test, row)) is not None:
                if any(
                    r["page"] == record["page"] and row["item"] in r["answer"]["values"] for r in spoken.get(who, [])
                ):
                    raise ListeningError("this question was answered before", key="item")
                spoken.setdefault(who, []).append(record)
            elif kind is not None:
                trial = trials.get(row["trial_id"].partition("-")[0])
                if trial is not None and not isinstance(page := test.pages[trial.page], _READ[kind][1]):
                    reason = f"trial {trial.id} is of a page {page.type}, which has no answers in such a table"
                    raise ListeningError(reason, key="trial_id")
                _take_webmushra(test, kind, row, trials, answers.setdefault(who, {}))
            elif row["trial"]:
                _take_plain(test, row, trials, answers.setdefault(who, {}))
            elif row.get("response") or (row.get("value") and not row.get("item")):
                raise ListeningError("is missing", key="trial")  # not so in rows of PsychoPy for pages without trials
        except ListeningError as fault:
            long = len(fault.reason) > _MOST_SHOWN  # so may a cell be
            reason = f"{fault.reason[:_MOST_SHOWN]} ..." if long else fault.reason
            left_out.append(LeftOut(str(ListeningError(reason, file=path, line=line, key=fault.key))))
    listeners: list[ListenerAnswers] = []
    for who in dict.fromkeys([*answers, *spoken]):
        kept = []
        for one in answers.get(who, {}).values():
            graded = {code for code, _ in one.ratings}
            if isinstance(test.pages[one.page], pages.Bs1116Page) and 0 < len(graded) < 2:
                reason = f"{who} has no grade of both sounds of trial {one.trial.id}"
                left_out.append(LeftOut(str(ListeningError(reason, file=path))))
            elif graded or one.choice is not None:
                kept.append(one)
        records = [_record(test, one, index) for index, one in enumerate(kept)]
        records += [{**record, "index": len(records) + i} for i, record in enumerate(spoken.get(who, []))]
        if records:
            header = {"listener": who, "token": who, "simulated": False, "started": "", "language": ""}
            name = path.with_name(f"{path.name}#{len(listeners) + 1}")
            listeners.append(ListenerAnswers(name, header, records, [], 0, 0))
    if not listeners:
        first = f"; the first row is left out because: {left_out[0].reason}" if left_out else ""
        raise ListeningError(f"holds no answers to this test{first}", file=path)
    return Imported(tuple(listeners), tuple(left_out))


def joined(tables: Sequence[Imported]) -> Imported:
    """Answers of several tables: one name is one listener; of an answer that two tables hold the first one counts."""
    listeners: dict[str, ListenerAnswers] = {}
    left_out = [one for table in tables for one in table.left_out]
    for one in (one for table in tables for one in table.listeners):
        before = listeners.setdefault(one.header["listener"], one)
        if before is one:
            continue
        answered = {_question(record) for record in before.records}
        fresh = [record for record in one.records if _question(record) not in answered]
        if count := len(one.records) - len(fresh):
            file = one.path.with_name(one.path.name.rpartition("#")[0])
            reason = f"{one.listener} answered this in another table, too: {counted(count, 'answer')}"
            left_out.append(LeftOut(str(ListeningError(reason, file=file)), count))
        records = [{**record, "index": i} for i, record in enumerate([*before.records, *fresh])]
        listeners[one.header["listener"]] = replace(before, records=records)
    return Imported(tuple(listeners.values()), tuple(left_out))


def _question(record: Mapping[str, Any]) -> tuple[Any, ...]:
    """Page, trial and repetition that a record answers, of a questionnaire its question."""
    questions = () if record["trial"] else tuple(record["answer"]["values"])
    return record["page"], record["trial"], record["repetition"], questions


def _table(path: Path) -> tuple[list[tuple[int, Row, str]], set[str]]:
    """Rows with the number of their last line and what stands beyond the columns, and the names of these."""
    try:
        with path.open("rb") as stream:  # a device may have no end
            raw = stream.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise ListeningError(f"is longer than the {_MOST_BYTES} bytes allowed", file=path)
        text = decoded(raw, file=path, error=ListeningError)
    except OSError as fault:
        raise ListeningError(f"cannot be read: {fault.strerror}", file=path) from None
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""), restval="", strict=True)
        names = [name.strip() for name in reader.fieldnames or ()]
        if twice := next((name for name in names if name and names.count(name) > 1), ""):
            raise ListeningError(f"has two columns {twice}", file=path)
        rows = []
        for cells in reader:
            beyond = ", ".join(cell for cell in cells.pop(None, ()) if cell.strip())
            row = {k.strip(): (v or "").strip() for k, v in cells.items()}
            if beyond or any(row.values()):  # spreadsheets end tables with rows of commas alone
                rows.append((reader.line_num, row, beyond))
    except csv.Error as fault:
        raise ListeningError(f"is no table: {fault}", file=path) from None
    return rows, set(names)


def _who(row: Row) -> str:
    """Name of the listener of a row. Raises ListeningError : there is none."""
    for column in ("listener", "participant", "session_uuid", "email"):
        if name := printable(row.get(column, ""), most=None):
            return name
    raise ListeningError("names no listener", key="listener")


def _trial(row: Row, name: str, trials: Mapping[str, ServedTrial]) -> ServedTrial:
    if name not in trials:
        raise ListeningError(f"{name!r} is no trial of this test", key="trial")
    return trials[name]


def _number(text: str, key: str, low: float, high: float) -> float:
    value = number_in(text)
    if not low <= value <= high:
        raise ListeningError(f"{text!r} is no number from {low:g} to {high:g}", key=key)
    return value


def _rate(one: _TrialAnswer, code: str, item: str, value: float) -> None:
    if code not in one.trial.codes:
        raise ListeningError(f"{code!r} is no sound of trial {one.trial.id}", key="stimulus")
    if (code, item) in one.ratings:
        raise ListeningError(f"{code} was rated before", key="stimulus")
    one.ratings[code, item] = value


def _repetition(text: str, key: str, page: pages.AnyPage) -> int:
    """Number of a trial's repetition: one of those that the page asks for."""
    value, most = _number(text, key, 1, 1000), getattr(page, "times", 1)
    if value % 1 or value > most:
        raise ListeningError(f"{text!r} is no repetition of a trial of this page, which asks {most} times", key=key)
    return int(value)


def _take_webmushra(
    test: ListeningTest,
    kind: str,
    row: Row,
    trials: Mapping[str, ServedTrial],
    into: dict[tuple[Any, ...], _TrialAnswer],
) -> None:
    name, _, count = row["trial_id"].partition("-")
    trial = _trial(row, name, trials)
    repetition = _repetition(count or "1", "trial_id", test.pages[trial.page])
    key, session = (name, repetition), row.get("session_uuid", "")
    if key in into and into[key].session != session:
        raise ListeningError("this trial was answered before, in another session", key="trial_id")
    reference, other = trial.reference or "", trial.stimuli[0]
    if kind == "pair":
        if key in into:
            raise ListeningError("this trial was answered before", key="trial_id")
        if (answer := row["choice_answer"]) not in ("correct", "incorrect", "undecided"):
            raise ListeningError(f"{answer!r} is not one of correct, incorrect, undecided", key="choice_answer")
        right = answer == "correct"
        choice = "undecided" if answer == "undecided" else "A" if right else "B"
        slots = {"A": reference, "B": other, "X": reference}
        into[key] = _TrialAnswer(trial, trial.page, repetition, slots, {}, choice, right, session=session)
        return
    one = into.setdefault(key, _TrialAnswer(trial, trial.page, repetition, {}, {}, session=session))
    if kind == "mushra":
        code = reference if row["rating_stimulus"] == "reference" else row["rating_stimulus"]
        _rate(one, code, "", _number(row["rating_score"], "rating_score", 0.0, 100.0))
    else:
        code = row["rating_non_reference"]
        _rate(one, reference, "", _number(row["rating_reference_score"], "rating_reference_score", 1.0, 5.0))
        _rate(one, code, "", _number(row["rating_non_reference_score"], "rating_non_reference_score", 1.0, 5.0))


def _take_plain(
    test: ListeningTest, row: Row, trials: Mapping[str, ServedTrial], into: dict[tuple[Any, ...], _TrialAnswer]
) -> None:
    trial = _trial(row, row["trial"], trials)
    if row["page"] != str(trial.page + 1):
        raise ListeningError(f"is {row['page']!r}, and {trial.page + 1} is the page of trial {trial.id}", key="page")
    page = test.pages[trial.page]
    repetition = _repetition(row.get("repetition") or "1", "repetition", page)
    key = (trial.id, repetition)
    seconds = _number(row.get("seconds") or "0", "seconds", 0.0, 3.2e8)
    if isinstance(page, (pages.MushraPage, pages.Bs1116Page, pages.RatingPage)):
        if not (values := _values(row, page)):
            raise ListeningError("is missing", key="value")
        one = into.setdefault(key, _TrialAnswer(trial, trial.page, repetition, {}, {}, seconds=seconds))
        for item, value in values.items():
            low, high, name = _limits(page, item)
            _rate(one, row.get("stimulus", ""), name, _number(value, "value", low, high))
        return
    if key in into:
        raise ListeningError("this trial was answered before", key="trial")
    slots = {slot: row[slot] for slot in _SLOTS if row.get(slot)}
    if unknown := set(slots.values()) - set(trial.codes):
        raise ListeningError(f"{min(unknown)!r} is no sound of trial {trial.id}", key="trial")
    response = row.get("response") or next((row[c] for c in row if _KEY.fullmatch(c) and row[c]), "")
    if "response" not in row or not row["response"]:
        response = next((choice for choice in choices(page, slots) if KEYS[choice] == response), response)
    if response not in (allowed := choices(page, slots)):
        raise ListeningError(f"{response!r} is not one of {', '.join(allowed)}", key="response")
    right = _right(page, trial, slots, response)
    into[key] = _TrialAnswer(trial, trial.page, repetition, slots, {}, response, right, seconds)


def _values(row: Row, page: pages.AnyPage) -> dict[str, str]:
    """Ratings of a row by item: one, or those of the columns of PsychoPy's sliders, which are named by identifiers."""
    if "value" in row:
        return {row.get("item", ""): row["value"]}
    scales = [scale.name for scale in page.scales] if isinstance(page, pages.RatingPage) else []
    names = dict(zip(identifiers(scales), scales, strict=True))
    return {names.get(m[1], m[1]): row[c] for c in row if (m := _RATE.fullmatch(c)) and row[c]}


def _limits(page: pages.MushraPage | pages.Bs1116Page | pages.RatingPage, item: str) -> tuple[float, float, str]:
    if not isinstance(page, pages.RatingPage):
        return (0.0, 100.0, "") if isinstance(page, pages.MushraPage) else (1.0, 5.0, "")
    scales = {scale.name: scale for scale in page.scales}
    name = next(iter(scales)) if not item and len(scales) == 1 else item
    if name not in scales:
        raise ListeningError(f"{item!r} is not one of {', '.join(scales)}", key="item")
    return scales[name].low, scales[name].high, name


def _right(page: pages.AnyPage, trial: ServedTrial, slots: Mapping[str, str], response: str) -> bool | None:
    """Whether a response is right; None where none is.

    Raises ListeningError : the slots are not those of such a page.
    """
    reference, other = trial.reference or "", trial.stimuli[0]
    labels: Sequence[str] = ("A", "B", "X") if isinstance(page, pages.AbxPage) else ("A", "B")
    if isinstance(page, pages.AfcPage):
        labels = [str(i + 1) for i in range(page.intervals)]
    if missing := [slot for slot in labels if slot not in slots]:
        raise ListeningError(f"has no sound in slot {missing[0]}", key="trial")
    if others := [slot for slot in slots if slot not in (*labels, OPEN)]:
        reason = f"has a sound in slot {others[0]}; {', '.join(labels)} are the slots of its page"
        raise ListeningError(reason, key="trial")
    if isinstance(page, pages.AbPage):
        return response == ("same" if slots["A"] == slots["B"] else "different")
    if isinstance(page, pages.AbxPage):
        if slots["X"] not in (slots["A"], slots["B"]) or slots["A"] == slots["B"]:
            raise ListeningError("X is not one of A and B", key="trial")
        return response != "undecided" and slots[response] == slots["X"]
    if isinstance(page, pages.AfcPage):
        if sorted(slots[i] for i in labels) != sorted([other, *[reference] * (page.intervals - 1)]):
            raise ListeningError("the intervals do not hold one other sound", key="trial")
        return slots[response] == other
    if {slots["A"], slots["B"]} != {reference, other}:
        raise ListeningError("A and B are not the two sounds of the trial", key="trial")
    return None


def _questionnaire(test: ListeningTest, row: Row) -> dict[str, Any] | None:
    """The record of an answer to a questionnaire; None where the row is none."""
    if row.get("trial") or not row.get("item"):
        return None
    number = row.get("page", "")
    page = next((p for i, p in enumerate(test.pages) if number == str(i + 1)), None)
    questions = {q.name: q for q in page.questions} if isinstance(page, pages.QuestionnairePage) else {}
    if row["item"] not in questions:
        raise ListeningError(f"{row['item']!r} is no question of page {number}", key="item")
    question, value = questions[row["item"]], row.get("value", "")
    if not value:
        return None
    numeric = question.kind in ("number", "scale")
    answer: Any = _number(value, "value", -1e300, 1e300) if numeric else value[:10_000]
    return {
        "page": int(number), "type": "questionnaire", "trial": "", "training": False, "repetition": 1, "slots": {},
        "answer": {"values": {question.name: answer}},
    }  # fmt: skip


def _record(test: ListeningTest, one: _TrialAnswer, index: int) -> dict[str, Any]:
    """A record as the files of this test have them."""
    page, answer = test.pages[one.page], {"seconds": one.seconds}
    slots: dict[str, str] = one.slots
    fields: dict[str, Any] = {}
    if isinstance(page, pages.PairPage):
        fields = {"choice": one.choice}
    elif isinstance(page, pages.RatingPage):
        slots = {"A": one.trial.stimuli[0]}
        fields = {"values": {item: value for (_, item), value in one.ratings.items()}}
    else:
        codes = [code for code, _ in one.ratings]
        slots = {OPEN: one.trial.reference or "", **{LETTERS[i]: code for i, code in enumerate(codes)}}
        fields = {"ratings": {LETTERS[i]: one.ratings[code, ""] for i, code in enumerate(codes)}}
    record = {
        "index": index, "page": one.page + 1, "type": page.type, "trial": one.trial.id, "training": False,
        "repetition": one.repetition, "slots": slots, "answer": {**answer, **fields},
    }  # fmt: skip
    return record if one.right is None else {**record, "right": one.right}
