"""A configuration for webMUSHRA: its pages of type consent, generic, mushra, bs1116 and paired_comparison.

Keys are those of webMUSHRA's documentation for experimenters (doc/experimenter.md) and of its configs/default.yaml
(``questionnaire``). Identifiers of conditions are blind codes; anchors are sounds like others. The file was checked
against these keys, and webMUSHRA of May 2025 ran it in Chromium from its first page to the answers that it sent.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.page_parts import Question
from tonewood.workshop.batch.pages import (
    AbxPage,
    Bs1116Page,
    ConsentPage,
    InstructionsPage,
    LevelPage,
    MushraPage,
    QuestionnairePage,
    RatedPage,
    localised,
)
from tonewood.workshop.exchange.course import Exported, codes_of, copy_sounds, course, identifiers, left_out, words
from tonewood.workshop.listening.definition import ListeningTest

_KEPT = (ConsentPage, InstructionsPage, LevelPage, MushraPage, Bs1116Page, AbxPage, QuestionnairePage)


def write(test: ListeningTest, folder: Path) -> Exported:
    """Write ``configs/NAME.yaml`` and its sounds into a folder whose contents go into that of webMUSHRA.

    Raises OutputError : a file cannot be written.
    """
    name = test.manifest.name
    sounds = f"configs/resources/{name}"
    rows = course(test, 0)
    text = "\n".join(_yaml(_config(test, sounds, rows))) + "\n"
    write_whole(folder / "configs" / f"{name}.yaml", text, make_folder=True)
    kept = {i + 1 for i, page in enumerate(test.manifest.pages) if isinstance(page, (MushraPage, Bs1116Page, AbxPage))}
    copy_sounds(test, codes_of(row for row in rows if row["page"] in kept), folder / sounds)
    notes = left_out(test, "webmushra", _KEPT)
    if any(isinstance(page, QuestionnairePage) for page in test.manifest.pages):
        notes += ("webmushra: answers to questions stay in its tables; `tonewood results` does not read them",)
    return Exported(folder, notes)


def _config(test: ListeningTest, sounds: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    pages: list[Any] = []
    asked = [q for page in test.manifest.pages if isinstance(page, QuestionnairePage) for q in page.questions]
    # the page that asks finds the fields by jQuery selectors: a plus sign or a first digit would disable its button
    names = identifiers(["listener", *(question.name for question in asked)])[1:]
    questions: list[dict[str, Any]] = [{"type": "text", "label": "Your number or name", "name": "listener"}]
    questions += [_question(q, name, test.manifest.language) for q, name in zip(asked, names, strict=True)]
    for index, page in enumerate(test.manifest.pages):
        title, content = words(test, page)
        base = {"id": f"page{index + 1}", "name": escape(_line(title)), "content": _html(content)}
        if isinstance(page, ConsentPage):
            pages.append({"type": "consent", **base, "mustConsent": True})
        elif isinstance(page, LevelPage):
            pages.append({"type": "volume", **base, "stimulus": f"{sounds}/tone{index + 1}.wav", "defaultVolume": 0.5})
        elif isinstance(page, InstructionsPage):
            pages.append({"type": "generic", **base})
        elif isinstance(page, (MushraPage, Bs1116Page, AbxPage)):
            of_page = [row for row in rows if row["page"] == index + 1]
            pages.append(["random", *(_trial(page, base, row, sounds) for row in of_page)])
    return {
        "testname": _line(test.title(test.manifest.language)),  # shown as text, others as HTML
        "testId": test.manifest.name,
        "bufferSize": 2048,
        "stopOnErrors": True,
        "showButtonPreviousPage": False,
        "remoteService": "service/write.php",
        "pages": [
            *pages,
            {"type": "finish", "name": escape(_line(test.texts(test.manifest.language)["finish_title"])),
             "content": "", "showResults": False, "writeResults": True, "questionnaire": questions},
        ],
    }  # fmt: skip


def _question(question: Question, name: str, language: str) -> dict[str, Any]:
    """An entry of webMUSHRA's questionnaire; a field that has a value before it is touched would count as answered."""
    label = escape(_line(localised(question.label, language)))
    asked: dict[str, Any] = {"type": "text", "label": label, "name": name}
    if question.kind == "choice":
        labels = {value: localised(text, language) for value, text in (question.choices or {}).items()}
        response = [{"value": value, "label": escape(_line(text))} for value, text in labels.items()]
        asked |= {"type": "likert", "response": response}
    elif question.kind != "text":
        asked |= {"type": "number", "min": question.low, "max": question.high, "default": ""}
    return {**asked, "optional": True} if question.optional else asked


def _trial(
    page: MushraPage | Bs1116Page | AbxPage, base: dict[str, Any], row: dict[str, Any], sounds: str
) -> dict[str, Any]:
    slots = row["slots"]
    reference = slots["X"] if isinstance(page, AbxPage) else slots["reference"]
    others = sorted(set(slots.values()) - {reference})
    trial = {
        "type": "paired_comparison" if isinstance(page, AbxPage) else page.type,
        **base,
        "id": f"{row['trial']}-{row['repetition']}",
        "showWaveform": isinstance(page, RatedPage) and page.waveform,
        "enableLooping": page.loops == "region",
        "reference": f"{sounds}/{reference}.wav",
        "stimuli": {code: f"{sounds}/{code}.wav" for code in others},
    }
    if isinstance(page, AbxPage):
        return {**trial, **({"unforced": "?"} if page.unforced else {})}
    trial |= {"createAnchor35": False, "createAnchor70": False}
    if isinstance(page, MushraPage):
        trial |= {
            "strict": False, "randomize": True, "showConditionNames": False, "switchBack": page.switch == "restart",
        }  # fmt: skip
    return trial


def _line(text: str) -> str:
    """A text in one line: webMUSHRA's reader of YAML knows no others, and HTML shows any white space as a blank."""
    return " ".join(text.split())


def _html(text: str) -> str:
    return "".join(f"<p>{escape(_line(part))}</p>" for part in text.split("\n\n") if part.strip())


def _yaml(value: Any, depth: int = 0) -> Iterator[str]:
    """Lines of YAML as yamljs reads it: a sequence in a sequence begins on a line of its own, a text is in one line."""
    pairs = value.items() if isinstance(value, dict) else (("", one) for one in value)
    for key, inner in pairs:
        head = "  " * depth + (f"{key}:" if isinstance(value, dict) else "-")
        if isinstance(inner, (dict, list)) and inner:
            yield head
            yield from _yaml(inner, depth + 1)
        else:
            yield f"{head} {json.dumps(inner, ensure_ascii=False)}"
