"""An experiment of PsychoPy's Builder: a ``.psyexp`` file and tables of trials for its loops.

Sounds of a trial are played one after the other. Rated sounds come alone after the reference, not side by side. The
tables hold the blind codes of each slot and no right answer.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import soundfile

from tonewood.support.csv_text import csv_text
from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch import pages
from tonewood.workshop.exchange.course import (
    COURSES,
    Exported,
    codes_of,
    copy_sounds,
    course,
    identifiers,
    left_out,
    shown_pages,
)
from tonewood.workshop.listening.definition import ListeningTest

_KEPT = (pages.ConsentPage, pages.InstructionsPage, pages.LevelPage, pages.TrialPage)
#: key that gives an answer
KEYS = {"A": "a", "B": "b", "same": "s", "different": "d", "tie": "t", "undecided": "u", "1": "1", "2": "2", "3": "3"}
#: s of silence between two sounds
_PAUSE = 0.5
#: version of the format that the file states
_VERSION = "2025.1.0"


def write(test: ListeningTest, folder: Path) -> Exported:
    """Write ``NAME.psyexp``, ``conditions/courseN_pageM.csv`` and the sounds.

    Raises OutputError : a file cannot be written.
    """
    courses = [course(test, number) for number in range(COURSES)]
    lengths = {code: soundfile.info(test.sound(code)).duration for rows in courses for code in codes_of(rows)}
    for number, rows in enumerate(courses, start=1):
        for page in dict.fromkeys(row["page"] for row in rows):
            page_rows = [cells for row in rows if row["page"] == page for cells in _rows(test, row, lengths)]
            columns = list(dict.fromkeys(key for row in page_rows for key in row))
            path = folder / "conditions" / f"course{number}_page{page}.csv"
            write_whole(path, csv_text(columns, page_rows), make_folder=True)
    root = _experiment(test, courses[0])
    ET.indent(root)
    write_whole(
        folder / f"{test.manifest.name}.psyexp",
        ET.tostring(root, encoding="utf-8", xml_declaration=True),
        make_folder=True,
    )
    copy_sounds(test, codes_of(row for rows in courses for row in rows), folder / "stimuli")
    rated = [i + 1 for i, p in enumerate(test.manifest.pages) if isinstance(p, (pages.MushraPage, pages.Bs1116Page))]
    notes = [f"psychopy: page {i}: its sounds are rated one at a time after the reference" for i in rated]
    return Exported(folder, (*left_out(test, "psychopy", _KEPT), *notes))


def _rated(test: ListeningTest, page: int) -> bool:
    return isinstance(test.manifest.pages[page - 1], (pages.MushraPage, pages.Bs1116Page, pages.RatingPage))


def _rows(test: ListeningTest, row: dict[str, Any], lengths: dict[str, float]) -> list[dict[str, Any]]:
    """Rows of one trial: one, or one a rated sound."""
    base = {key: row[key] for key in ("page", "trial", "repetition")}
    slots: dict[str, str] = row["slots"]
    if not _rated(test, row["page"]):
        return [{**base, **slots, **_sequence(list(slots.values()), lengths)}]
    before = [slots["reference"]] if "reference" in slots else []
    hidden = [code for slot, code in slots.items() if slot != "reference"]
    return [{**base, "stimulus": code, **_sequence([*before, code], lengths)} for code in hidden]


def _sequence(codes: list[str], lengths: dict[str, float]) -> dict[str, Any]:
    """Files of sounds that follow each other, with their beginnings, and the end of the last."""
    row: dict[str, Any] = {}
    time = _PAUSE
    for i, code in enumerate(codes, start=1):
        row |= {f"sound{i}": f"stimuli/{code}.wav", f"start{i}": round(time, 3)}
        time += lengths[code] + _PAUSE
    return {**row, "ends": round(time - _PAUSE, 3)}


def _experiment(test: ListeningTest, rows: list[dict[str, Any]]) -> ET.Element:
    root = ET.Element("PsychoPy2experiment", encoding="utf-8", version=_VERSION)
    settings = ET.SubElement(root, "Settings")
    _params(settings, {
        "expName": test.manifest.name,
        "Experiment info": ("{'participant': '', 'course': '1'}", "code"),
        "Save wide csv file": ("True", "bool"),
        "Units": "height",
    })  # fmt: skip
    routines, flow = ET.SubElement(root, "Routines"), ET.SubElement(root, "Flow")
    for page in shown_pages(test):
        of_page = [row for row in rows if row["page"] == page["page"]]
        if "button" in page:
            _text_page(routines, flow, page)
        elif of_page:
            _trial_page(routines, flow, page, of_page[0], _rated(test, page["page"]))
    return root


def _text_page(routines: ET.Element, flow: ET.Element, page: dict[str, Any]) -> None:
    name = f"page{page['page']}"
    routine = ET.SubElement(routines, "Routine", name=name)
    text = "\n\n".join(part for part in (page["title"], page["content"], f"{page['button']}: space") if part)
    _component(routine, "Text", f"text{page['page']}", {"text": _words(text), "letterHeight": ("0.03", "num")})
    if page["tone"]:
        _component(routine, "Sound", f"tone{page['page']}", {"sound": f"stimuli/{page['tone']}"})
    _component(routine, "Keyboard", f"go{page['page']}", {"allowedKeys": ("'space'", "list")})
    ET.SubElement(flow, "Routine", name=name)


def _trial_page(routines: ET.Element, flow: ET.Element, page: dict[str, Any], row: dict[str, Any], rated: bool) -> None:
    number = page["page"]
    name, loop = f"page{number}", f"trials{number}"
    routine = ET.SubElement(routines, "Routine", name=name)
    n = len(row["slots"])
    if rated:
        n = 2 if "reference" in row["slots"] else 1
    keys = [KEYS[choice] for choice in row["choices"]] or ["return"]
    order = "" if rated else ", ".join(row["slots"]) + ".  "
    hint = order + "  ".join(f"{k.upper()}: {c}" for k, c in zip(keys, row["choices"] or ["OK"], strict=True))
    text = "\n\n".join(part for part in (page["title"], page["content"], page["question"], hint) if part)
    layout = {"pos": ("(0, 0.25)", "list"), "letterHeight": ("0.03", "num")}
    _component(routine, "Text", f"text{number}", {"text": _words(text), **layout})
    for i in range(1, n + 1):
        _component(
            routine, "Sound", f"sound{number}_{i}",
            {"sound": (f"$sound{i}", "str", "set every repeat"), "startVal": (f"$start{i}", "code")},
        )  # fmt: skip
    names = identifiers([scale["name"] or "points" for scale in page["scales"]])
    for i, (scale, variable) in enumerate(zip(page["scales"], names, strict=True)):
        low, high = scale["low"], scale["high"]
        # a slider has no title: the words of the scale stand at its left end
        left = ": ".join(part for part in (scale["label"], scale["low_label"] or f"{low:.12g}") if part)
        _component(routine, "Slider", f"rate{number}_{variable}", {
            "ticks": (f"({low!r}, {high!r})", "list"),
            "labels": (repr([left, scale["high_label"] or f"{high:.12g}"]), "list"),
            "granularity": ("0", "num"),
            "pos": (f"(0, {-0.1 - 0.1 * i:g})", "list"),
            "startVal": ("$ends", "code"),
            "forceEndRoutine": ("False", "bool"),
        })  # fmt: skip
    allowed = ", ".join(repr(key) for key in keys)
    answer = {"allowedKeys": (allowed, "list"), "startVal": ("$ends", "code"), "storeCorrect": ("False", "bool")}
    _component(routine, "Keyboard", f"answer{number}", answer)
    initiator = ET.SubElement(flow, "LoopInitiator", loopType="TrialHandler", name=loop)
    _params(initiator, {
        "name": (loop, "code"),
        "loopType": "sequential",
        "nReps": ("1", "num"),
        "conditionsFile": f"$'conditions/course' + expInfo['course'] + '_page{number}.csv'",
        "isTrials": ("True", "bool"),
    })  # fmt: skip
    ET.SubElement(flow, "Routine", name=name)
    ET.SubElement(flow, "LoopTerminator", name=loop)


def _words(text: str) -> str:
    """A text that PsychoPy takes for no code, as it does where a dollar sign is in it."""
    return text.replace("$", r"\$")


def _component(routine: ET.Element, kind: str, name: str, params: dict[str, Any]) -> None:
    element = ET.SubElement(routine, f"{kind}Component", name=name, plugin="None")
    common: dict[str, Any] = {
        "name": (name, "code"),
        "startType": "time (s)",
        "startVal": ("0.0", "code"),
        "stopVal": ("", "code"),
    }
    _params(element, {**common, **params})


def _params(element: ET.Element, params: dict[str, str | tuple[str, ...]]) -> None:
    """Parameters by name: a text, or (value, type) or (value, type, when it is updated)."""
    for name, entry in params.items():
        value, kind, updates = (entry, "str", "constant") if isinstance(entry, str) else (*entry, "constant")[:3]
        ET.SubElement(element, "Param", val=value, valType=kind, updates=updates, name=name)
