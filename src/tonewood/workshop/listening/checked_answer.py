"""Checks of an answer against its step: what a page allows, and nothing beside the fields that it asks for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from tonewood.workshop.batch import pages
from tonewood.workshop.listening.definition import ListeningError
from tonewood.workshop.listening.trials import OPEN, Step

#: seconds on one page that a browser may state: ten years, for pages that stay open
_LONGEST = 3.2e8


def choices(page: pages.AnyPage, slots: Iterable[str]) -> list[str]:
    """Answers that a choice allows."""
    if isinstance(page, pages.AbPage):
        return ["same", "different"]
    if isinstance(page, pages.AbxPage):
        return ["A", "B", *(["undecided"] if page.unforced else [])]
    if isinstance(page, pages.PairedPage):
        return ["A", "B", *(["tie"] if page.tie else [])]
    if isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.HeadphonesPage)):
        return [slot for slot in slots if slot != OPEN]
    return []


def checked(page: pages.AnyPage, step: Step, message: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to a step, with nothing in it beside the fields asked for.

    Raises ListeningError : something is missing or not allowed.
    """
    record: dict[str, Any] = {
        "seconds": _number(message.get("seconds", 0.0), "seconds", 0.0, _LONGEST),
        "plays": {
            slot: int(_number(count, f"plays.{slot}", 0, _most_plays(page)))
            for slot, count in _mapping(message.get("plays", {}), "plays").items()
            if slot in step.slots
        },
    }
    if (shares := message.get("heard")) is not None:
        record["heard"] = _heard(page, step, _mapping(shares, "heard"), record["plays"])
    if comment := message.get("comment"):
        record["comment"] = _text(comment, "comment", 2000)
    if allowed := choices(page, step.slots):
        choice = message.get("choice")
        if choice not in allowed:
            raise ListeningError(f"{choice!r} is not one of {', '.join(allowed)}", key="choice")
        record["choice"] = choice
    elif isinstance(page, (pages.MushraPage, pages.Bs1116Page)):
        low, high = (0.0, 100.0) if isinstance(page, pages.MushraPage) else (1.0, 5.0)
        ratings = _mapping(message.get("ratings"), "ratings")
        record["ratings"] = {
            slot: _number(ratings.get(slot), f"ratings.{slot}", low, high) for slot in step.slots if slot != OPEN
        }
        if isinstance(page, pages.Bs1116Page) and max(record["ratings"].values()) < high:
            raise ListeningError("one of the two is the reference: its grade is 5.0", key="ratings")
    elif isinstance(page, pages.RatingPage):
        values = _mapping(message.get("values"), "values")
        record["values"] = {
            scale.name: _number(values.get(scale.name), f"values.{scale.name}", scale.low, scale.high)
            for scale in page.scales
        }
    elif isinstance(page, pages.QuestionnairePage):
        record["values"] = _questionnaire(page, _mapping(message.get("values"), "values"))
    elif page.type == "consent":
        if message.get("agreed") is not True:
            raise ListeningError("the test goes on only with it", key="agreed")
        record["agreed"] = True
    elif page.type == "level" and page.measured:
        record["spl_db"] = _number(message.get("spl_db"), "spl_db", 0.0, 130.0)
    return record


def _most_plays(page: pages.AnyPage) -> float:
    """Most times that a sound may be played."""
    return page.plays if isinstance(page, pages.ListenedPage) and page.plays is not None else 1e6


def share_wanted(page: pages.AnyPage) -> float:
    """Share of each sound that must be heard before the answer."""
    if isinstance(page, pages.ListenedPage):
        return page.listen
    return 0.5 if isinstance(page, pages.HeadphonesPage) else 0.0


def _heard(page: pages.AnyPage, step: Step, shares: Mapping[str, Any], plays: Mapping[str, int]) -> dict[str, float]:
    """Share of each sound that was heard, as the browser measured it.

    It must be as large as the page wants it, unless the sound cannot be played again; in a sequence none can be played
    again when one of them cannot.
    """
    least, by_name = share_wanted(page), {}
    played = {slot for slot in step.slots if plays.get(slot, 0) >= _most_plays(page)}
    if played and isinstance(page, (pages.AfcPage, pages.StaircasePage)):
        played = set(step.slots)
    for slot in step.slots:
        by_name[slot] = share = _number(shares.get(slot), f"heard.{slot}", 0.0, 1.0)
        if share < least and slot not in played:
            raise ListeningError(f"{share:.0%} of the sound was heard, {least:.0%} are wanted", key=f"heard.{slot}")
    return by_name


def _questionnaire(page: pages.QuestionnairePage, values: Mapping[str, Any]) -> dict[str, Any]:
    answers: dict[str, Any] = {}
    for question in page.questions:
        value, key = values.get(question.name), f"values.{question.name}"
        if value in (None, ""):
            if not question.optional:
                raise ListeningError("is missing", key=key)
            continue
        if question.kind == "text":
            answers[question.name] = _text(value, key, 10_000)
        elif question.kind == "choice":
            if not isinstance(value, str) or value not in (question.choices or {}):
                raise ListeningError(f"{value!r} is not one of {', '.join(question.choices or {})}", key=key)
            answers[question.name] = value
        else:
            bounded = {"low", "high"} if question.kind == "scale" else question.model_fields_set
            low = question.low if "low" in bounded else -math.inf
            answers[question.name] = _number(value, key, low, question.high if "high" in bounded else math.inf)
    return answers


def _mapping(value: Any, key: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ListeningError("is missing" if value is None else "is no mapping", key=key)
    return value


def _text(value: Any, key: str, most: int) -> str:
    if not isinstance(value, str):
        raise ListeningError("is no text", key=key)
    if len(value) > most:  # cut off, a part of a confirmed answer would be lost
        raise ListeningError(f"has {len(value)} characters, {most} are allowed", key=key)
    return value


def _number(value: Any, key: str, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ListeningError(f"{value!r} is not a number from {low:g} to {high:g}", key=key)
    try:
        number = float(value)
    except OverflowError:  # an integer of hundreds of digits
        number = math.inf
    if not math.isfinite(number):
        raise ListeningError("is not finite", key=key)
    return number
