"""A test as other programs need it: texts of its pages, and the trials of one listener after another.

No condition, level or right answer is in it: sounds have their blind codes, as in ``test.json``. The order and the
slots of each course are drawn as `tonewood serve` draws them.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tonewood.errors import OutputError
from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.pages import (
    AnyPage,
    ConsentPage,
    HtmlPage,
    InstructionsPage,
    LevelPage,
    QuestionnairePage,
    RatingPage,
    TrialPage,
    localised,
)
from tonewood.workshop.listening.checked_answer import choices
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.level_tone import tone
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.shown import kind_of_texts, scales_of
from tonewood.workshop.listening.trials import Step

FOLDER = "export"
#: courses that are written; listeners beyond them begin again with the first
COURSES = 20
#: names of a text page's parts
_READ = (ConsentPage, InstructionsPage, LevelPage)


@dataclass(frozen=True)
class Exported:
    """A folder that was written, and notes on parts of the test that are not in it."""

    folder: Path
    notes: tuple[str, ...] = ()


def left_out(test: ListeningTest, program: str, kept: tuple[type[Any], ...], why: str = "") -> tuple[str, ...]:
    """Notes on the pages that listeners see here and that `program` does not get."""
    return tuple(
        f"{program}: page {index + 1} ({page.type}) is left out: the export has no counterpart{why}"
        for index, page in enumerate(test.manifest.pages)
        if not isinstance(page, (*kept, HtmlPage)) and page.type != "finish"
    )


def identifiers(names: Sequence[str]) -> list[str]:
    """Names as programs allow them: letters, digits and underscores, a letter first; all different."""
    out: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name)
        plain = plain if plain[0].isalpha() else f"q{plain}"
        while plain in out or (plain != name and plain in names):
            plain += "_"
        out.append(plain)
    return out


def words(test: ListeningTest, page: AnyPage) -> tuple[str, str]:
    """Title and text of a page in the test's language."""
    language = test.manifest.language
    texts, kind = test.texts(language), kind_of_texts(page)
    title = localised(page.name, language) or texts.get(f"{kind}_title", "")
    return title, localised(page.content, language) or texts.get(f"{kind}_text", "")


def shown_pages(test: ListeningTest) -> list[dict[str, Any]]:
    """Pages that are read, answered or listened to, as plain data; trials are in `course`."""
    pages: list[dict[str, Any]] = []
    language = test.manifest.language
    texts = test.texts(language)
    for index, page in enumerate(test.manifest.pages):
        title, content = words(test, page)
        row: dict[str, Any] = {"page": index + 1, "type": page.type, "title": title, "content": content}
        if isinstance(page, _READ):
            agree = texts["consent_agree"]
            row["button"] = (
                (localised(page.agree, language) or agree) if isinstance(page, ConsentPage) else texts["next"]
            )
            row["tone"] = f"tone{index + 1}.wav" if isinstance(page, LevelPage) else ""
            pages.append(row)
        elif isinstance(page, QuestionnairePage):
            row["questions"] = [
                {
                    **question.model_dump(include={"name", "kind", "low", "high", "optional"}),
                    "label": localised(question.label, language),
                    "choices": {k: localised(v, language) for k, v in (question.choices or {}).items()},
                }
                for question in page.questions
            ]
            pages.append(row)
        elif isinstance(page, TrialPage):
            row["question"] = localised(getattr(page, "question", ""), language)
            row["scales"] = _scales(test, page)
            pages.append(row)
    return pages


def _scales(test: ListeningTest, page: AnyPage) -> list[dict[str, Any]]:
    language = test.manifest.language
    if isinstance(page, RatingPage):
        return scales_of(page, language)
    limits = {"mushra": (0.0, 100.0), "bs1116": (1.0, 5.0)}.get(page.type)
    if limits is None:
        return []
    grades = test.texts(language)[f"{page.type}_scale"].split("|")
    low, high = limits
    return [{"name": "", "label": "", "low": low, "high": high, "low_label": grades[0], "high_label": grades[-1]}]


def course(test: ListeningTest, number: int) -> list[dict[str, Any]]:
    """Trials of the listener `number` (from 0) in their order: page, trial, repetition, slots, choices."""
    session = Session(test, seed=number, place=number)
    pages: list[dict[str, Any]] = []
    for index, page in enumerate(test.manifest.pages):
        if not isinstance(page, TrialPage):
            continue
        for fields in session.trials.steps(index):
            step = Step(index=len(pages), page=index, **fields)
            row = {"page": index + 1, "trial": step.trial, "repetition": step.repetition, "slots": dict(step.slots)}
            pages.append({**row, "choices": choices(page, step.slots)})
    return pages


def codes_of(rows: Iterable[dict[str, Any]]) -> list[str]:
    """Codes of all sounds of trials, sorted: their order tells nothing."""
    return sorted({code for row in rows for code in row["slots"].values()})


def copy_sounds(test: ListeningTest, codes: Iterable[str], folder: Path) -> None:
    """Copy sounds into a folder, and write the tones of pages that set the level.

    Raises OutputError : one cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for code in codes:
            shutil.copyfile(test.sound(code), folder / f"{code}.wav")
    except OSError as fault:
        raise OutputError(f"cannot be written: {fault.strerror}", file=folder) from None
    for index, page in enumerate(test.manifest.pages):
        if isinstance(page, LevelPage):
            write_whole(folder / f"tone{index + 1}.wav", tone(test, page))
