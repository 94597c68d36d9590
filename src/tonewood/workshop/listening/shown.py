"""A step as a browser gets it: texts in the listener's language, slots, and the answers allowed; no code, no level."""

from __future__ import annotations

from functools import partial
from typing import Any
from urllib.parse import quote

from tonewood.workshop.batch import pages
from tonewood.workshop.listening.checked_answer import choices, share_wanted
from tonewood.workshop.listening.definition import ListeningTest
from tonewood.workshop.listening.session import Session
from tonewood.workshop.listening.trials import OPEN


def shown(test: ListeningTest, session: Session, language: str, listener: str = "", code: str = "") -> dict[str, Any]:
    """The step of a session; ``{"type": "done"}`` after the last one, ``{"type": "failed"}`` after a check not passed.

    listener : name that the listener or the address states; `code` if there is none.
    code : name that the results use for a listener without a name.
    """
    step, page = session.step, session.page
    if step is None or page is None:
        kind = "done" if session.failed is None else "failed"
        return {"type": kind, "index": len(session.answers), "progress": 1.0, **_back(test, session, listener, code)}
    words = test.texts(language)
    text = partial(pages.localised, language=language)
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
            {"value": choice, "label": words.get(f"choice_{choice}", choice)} for choice in choices(page, step.slots)
        ],
        "sequence": isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.HeadphonesPage)),
        "listen": share_wanted(page),
        "plays": page.plays if isinstance(page, pages.ListenedPage) else None,
        "loop": page.loops if isinstance(page, pages.SwitchedPage) else "off",
        "restart": isinstance(page, pages.SwitchedPage) and page.switch == "restart",
        "waveform": bool(getattr(page, "waveform", False)),
        "last": page.type == "finish",
    }
    return view | _details(test, page, language)


def _back(test: ListeningTest, session: Session, listener: str, code_name: str) -> dict[str, Any]:
    """Code and address for a listener who has finished, or did not pass a check."""
    if session.failed is not None:
        ends: pages.AnyPage | None = test.pages[session.failed]
    else:
        ends = next((page for page in test.pages if isinstance(page, pages.FinishPage)), None)
    back = ends.back if isinstance(ends, (pages.FinishPage, pages.HeadphonesPage)) else None
    if back is None:
        return {}
    code = back.code.format(id=code_name)
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


def scales_of(page: pages.RatingPage, language: str) -> list[dict[str, Any]]:
    """Scales of a page with their words in a language."""
    texts = ("label", "low_label", "high_label")
    return [
        scale.model_dump(exclude={"ordinal"}) | {key: pages.localised(getattr(scale, key), language) for key in texts}
        for scale in page.scales
    ]


def _details(test: ListeningTest, page: pages.AnyPage, language: str) -> dict[str, Any]:
    """Fields of one type of page."""
    words, text = test.texts(language), partial(pages.localised, language=language)
    if isinstance(page, (pages.AfcPage, pages.StaircasePage, pages.PairedPage)):
        return {"question": text(page.question)}
    if isinstance(page, pages.RatingPage):
        return {"scales": scales_of(page, language)}
    if isinstance(page, pages.QuestionnairePage):
        return {
            "questions": [
                {
                    **question.model_dump(include={"name", "kind", "low", "high", "optional"}),
                    "label": text(question.label),
                    "choices": [{"value": v, "label": text(t)} for v, t in (question.choices or {}).items()],
                }
                for question in page.questions
            ]
        }
    if isinstance(page, pages.LevelPage):
        loudness = test.manifest.stimuli.loudness
        target, key = loudness.target_lufs, "level_tone_alone" if loudness.method == "none" else "level_tone"
        tone = words[key].replace("{freq}", f"{page.freq:g}").replace("{lufs}", f"{target:g}")
        parts = [words["level_spl"].replace("{spl}", f"{page.spl_db:g}")] if page.spl_db is not None else []
        return {"notes": [tone, *parts, words["level_headphones"]], "measured": page.measured}
    if page.type == "consent":
        return {"agree": text(page.agree) or words["consent_agree"]}
    return {}
