"""A step as a browser gets it: texts in the listener's language, slots, and the answers allowed; no code, no level."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from tonewood.workshop.batch import pages
from tonewood.workshop.batch.page_parts import (
    Text,
)
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.session import OPEN, Session, Step, choices, share_wanted


def shown(test: ListeningTest, session: Session, language: str, listener: str = "", own: str = "") -> dict[str, Any]:
    """The step of a session; ``{"type": "done"}`` after the last one, ``{"type": "failed"}`` after a check not passed.

    test, session : what is shown.
    language : of the texts.
    listener : name given by the listener or the address; own name of the session, if there is none.
    own : name that the results give to a listener without a name.
    """
    step, page = session.step, session.page
    if step is None or page is None:
        kind = "done" if session.failed is None else "failed"
        return {"type": kind, "index": len(session.answers), "progress": 1.0, **_back(test, session, listener, own)}
    words = test.texts(language)

    def text(value: Text) -> str:
        return pages.localised(value, language)

    manifest_page = test.pages[step.page]
    kind = kind_of_texts(page)
    content = [paragraph for part in (manifest_page, page) if (paragraph := text(part.content))]
    default = words.get(f"{kind}_text", "")
    view: dict[str, Any] = {
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
        "sequence": isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.HeadphonesPage)),
        "listen": share_wanted(page),
        "plays": page.plays if isinstance(page, pages.ListenedPage) else None,
        "loop": page.loops if isinstance(page, pages.SwitchedPage) else "off",
        "restart": isinstance(page, pages.SwitchedPage) and page.switch == "restart",
        "waveform": bool(getattr(page, "waveform", False)),
        "last": page.type == "finish",
    }
    return view | _details(test, page, step, text, words)


def _back(test: ListeningTest, session: Session, listener: str, own: str) -> dict[str, Any]:
    """Code and address for a listener who has finished, or did not pass a check."""
    if session.failed is not None:
        ends: pages.AnyPage | None = test.pages[session.failed]
    else:
        ends = next((page for page in test.pages if isinstance(page, pages.FinishPage)), None)
    back = ends.back if isinstance(ends, (pages.FinishPage, pages.HeadphonesPage)) else None
    if back is None:
        return {}
    code = back.code.format(id=own)
    filled = None
    if back.address is not None:
        filled = back.address.format(code=quote(code, safe=""), listener=quote(listener, safe=""))
    return {"code": code, "address": filled}


def kind_of_texts(page: pages.AnyPage) -> str:
    """Key of a page's built-in texts: forced choices differ by their question."""
    if isinstance(page, (pages.AfcPage, pages.StaircasePage)):
        return "afc_question" if page.question else f"afc_{page.intervals}"
    if isinstance(page, pages.HeadphonesPage):
        return f"headphones_{page.method}"
    return page.type


def _details(test: ListeningTest, page: pages.AnyPage, step: Step, text: Any, words: dict[str, str]) -> dict[str, Any]:
    """Fields of one type of page."""
    if isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.PairedPage)):
        return {"question": text(page.question)}
    if isinstance(page, pages.RatingPage):
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
    if isinstance(page, pages.QuestionnairePage):
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
    if isinstance(page, pages.LevelPage):
        target = test.manifest.stimuli.loudness.target_lufs
        tone = words["level_tone"].format(freq=f"{page.freq:g}", lufs=f"{target:g}")
        parts = [words["level_spl"].format(spl=f"{page.spl_db:g}")] if page.spl_db is not None else []
        return {"notes": [tone, *parts, words["level_headphones"]], "measured": page.measured}
    if page.type == "consent":
        return {"agree": text(page.agree) or words["consent_agree"]}
    return {}
