"""A configuration for webMUSHRA: its pages of type consent, generic, mushra, bs1116 and paired_comparison.

Keys are those of webMUSHRA's documentation for experimenters (doc/experimenter.md) and of its configs/default.yaml
(``questionnaire``). Identifiers of conditions are blind codes; anchors are sounds like others. The file was checked
against these keys; webMUSHRA itself was not run on it.
"""

from __future__ import annotations

import io
from html import escape
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole
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
from tonewood.workshop.exchange.course import Exported, codes_of, copy_sounds, course, left_out, words
from tonewood.workshop.listening.definition import ListeningTest

_KEPT = (ConsentPage, InstructionsPage, LevelPage, MushraPage, Bs1116Page, AbxPage, QuestionnairePage)


def write(test: ListeningTest, folder: Path) -> Exported:
    """Write ``configs/NAME.yaml`` and its sounds into a folder whose contents go into that of webMUSHRA.

    Raises OutputError : a file cannot be written.
    """
    from ruamel.yaml import YAML

    name = test.manifest.name
    sounds = f"configs/resources/{name}"
    rows = course(test, 0)
    stream = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]  # declared as None
    writer.dump(_config(test, sounds, rows), stream)
    write_whole(folder / "configs" / f"{name}.yaml", stream.getvalue(), make_folder=True)
    kept = {i + 1 for i, page in enumerate(test.manifest.pages) if isinstance(page, (MushraPage, Bs1116Page, AbxPage))}
    copy_sounds(test, codes_of(row for row in rows if row["page"] in kept), folder / sounds)
    notes = left_out(test, "webmushra", _KEPT)
    if any(isinstance(page, QuestionnairePage) for page in test.manifest.pages):
        notes += ("webmushra: answers to questions stay in its tables; `tonewood results` does not read them",)
    return Exported(folder, (*notes, "webmushra: the file fits webMUSHRA's documented keys; it was not tried with it"))


def _config(test: ListeningTest, sounds: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    pages: list[Any] = []
    questions: list[dict[str, Any]] = [{"type": "text", "label": "Your number or name", "name": "listener"}]
    for index, page in enumerate(test.manifest.pages):
        title, content = words(test, page)
        base = {"id": f"page{index + 1}", "name": escape(title), "content": _html(content)}
        if isinstance(page, ConsentPage):
            pages.append({"type": "consent", **base, "mustConsent": True})
        elif isinstance(page, LevelPage):
            pages.append({"type": "volume", **base, "stimulus": f"{sounds}/tone{index + 1}.wav", "defaultVolume": 0.5})
        elif isinstance(page, InstructionsPage):
            pages.append({"type": "generic", **base})
        elif isinstance(page, QuestionnairePage):
            for question in page.questions:
                kind = "number" if question.kind in ("number", "scale") else "text"
                limits = (
                    {"min": question.low, "max": question.high, "default": question.low} if kind == "number" else {}
                )
                label = escape(localised(question.label, test.manifest.language))
                questions.append({"type": kind, "label": label, "name": question.name, **limits})
        elif isinstance(page, (MushraPage, Bs1116Page, AbxPage)):
            of_page = [row for row in rows if row["page"] == index + 1]
            pages.append(["random", *(_trial(page, base, row, sounds) for row in of_page)])
    return {
        "testname": escape(test.title(test.manifest.language)),
        "testId": test.manifest.name,
        "bufferSize": 2048,
        "stopOnErrors": True,
        "showButtonPreviousPage": False,
        "remoteService": "service/write.php",
        "pages": [
            *pages,
            {"type": "finish", "name": escape(test.texts(test.manifest.language)["finish_title"]),
             "content": "", "showResults": False, "writeResults": True, "questionnaire": questions},
        ],
    }  # fmt: skip


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


def _html(text: str) -> str:
    return "".join(f"<p>{escape(part)}</p>" for part in text.split("\n\n") if part.strip())
