"""A step as a browser gets it: texts in the listener's language, slots, and the answers allowed; no code, no level."""

from __future__ import annotations

from typing import Any

from tonewood.workshop.batch.pages import (
    AfcPage,
    AnyPage,
    LevelPage,
    PairedPage,
    QuestionnairePage,
    RatingPage,
    StaircasePage,
    Text,
    localised,
)
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.session import OPEN, Session, Step, choices


def shown(test: ListeningTest, session: Session, language: str) -> dict[str, Any]:
    """The step of a session; ``{"type": "done"}`` after the last one."""
    step, page = session.step, session.page
    if step is None or page is None:
        return {"type": "done", "index": len(session.answers), "progress": 1.0}
    words = test.texts(language)

    def text(value: Text) -> str:
        return localised(value, language)

    own = test.pages[step.page]
    kind = kind_of_texts(page)
    content = [paragraph for part in (own, page) if (paragraph := text(part.content))]
    default = words.get(f"{kind}_text", "")
    found: dict[str, Any] = {
        "type": page.type,
        "index": step.index,
        "progress": step.index / max(session.total, 1),
        "training": step.training,
        "title": text(page.name) or words[f"{kind}_title"],
        "content": list(dict.fromkeys(content)) or ([default] if default else []),
        "slots": list(step.slots),
        "open": OPEN if OPEN in step.slots else None,
        "choices": [
            {"value": choice, "label": words.get(f"choice_{choice}", choice)} for choice in choices(page, step)
        ],
        "sequence": isinstance(page, (AfcPage, StaircasePage)),
        "last": page.type == "finish",
    }
    return found | _details(test, page, step, text, words)


def kind_of_texts(page: AnyPage) -> str:
    """Key of a page's built-in texts: forced choices differ by their question."""
    if isinstance(page, (AfcPage, StaircasePage)):
        return "afc_question" if page.question else f"afc_{page.intervals}"
    return page.type


def _details(test: ListeningTest, page: AnyPage, step: Step, text: Any, words: dict[str, str]) -> dict[str, Any]:
    """Fields of one type of page."""
    if isinstance(page, (AfcPage, StaircasePage, PairedPage)):
        return {"question": text(page.question)}
    if isinstance(page, RatingPage):
        return {
            "scales": [
                {
                    "name": scale.name,
                    "label": text(scale.label),
                    "low": scale.low,
                    "high": scale.high,
                    "low_label": text(scale.low_label),
                    "high_label": text(scale.high_label),
                }
                for scale in page.scales
            ]
        }
    if isinstance(page, QuestionnairePage):
        return {
            "questions": [
                {
                    "name": question.name,
                    "label": text(question.label),
                    "kind": question.kind,
                    "choices": [{"value": v, "label": text(t)} for v, t in (question.choices or {}).items()],
                    "low": question.low,
                    "high": question.high,
                    "optional": question.optional,
                }
                for question in page.questions
            ]
        }
    if isinstance(page, LevelPage):
        target = test.manifest.stimuli.loudness.target_lufs
        tone = words["level_tone"].format(freq=f"{page.freq:g}", lufs=f"{target:g}")
        wanted = [words["level_spl"].format(spl=f"{page.spl_db:g}")] if page.spl_db is not None else []
        return {"notes": [tone, *wanted, words["level_headphones"]], "measured": page.measured}
    if page.type == "consent":
        return {"agree": text(page.agree) or words["consent_agree"]}
    return {}
