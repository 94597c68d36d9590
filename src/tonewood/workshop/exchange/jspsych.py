"""A page for jsPsych 8: ``npm install`` in the folder fetches jsPsych, then ``index.html`` opens from the disk."""

from __future__ import annotations

import json
from html import escape
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole
from tonewood.workshop.batch.pages import ConsentPage, InstructionsPage, LevelPage, QuestionnairePage, TrialPage
from tonewood.workshop.exchange.course import COURSES, Exported, codes_of, copy_sounds, course, left_out, shown_pages
from tonewood.workshop.listening.definition import ListeningTest

_KEPT = (ConsentPage, InstructionsPage, LevelPage, QuestionnairePage, TrialPage)
#: packages of npm with the versions that the page was tried with
PACKAGES = {
    "jspsych": "^8.2.1",
    "@jspsych/plugin-html-button-response": "^2.1.0",
    "@jspsych/plugin-survey-html-form": "^2.1.0",
}
_PAGE = """<!DOCTYPE html>
<html lang="{language}">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="node_modules/jspsych/css/jspsych.css">
{scripts}
</head>
<body></body>
</html>
"""
_SCRIPTS = (*(f"node_modules/{name}/dist/index.browser.min.js" for name in PACKAGES), "test.js", "tonewood.js")


def write(test: ListeningTest, folder: Path) -> Exported:
    """Write page, trials of `COURSES` listeners, sounds, and the list of packages that npm installs.

    Raises OutputError : a file cannot be written.
    """
    language = test.manifest.language
    courses = [course(test, number) for number in range(COURSES)]
    texts = test.texts(language)
    data: dict[str, Any] = {
        "name": test.manifest.name,
        "pages": shown_pages(test),
        "courses": courses,
        "texts": {
            key: texts[key]
            for key in (
                "play", "stop", "reference", "send", "next", "finish_title", "answer", "choice_same",
                "choice_different", "choice_undecided", "choice_tie",
            )
        },
    }  # fmt: skip
    scripts = "\n".join(f'<script src="{address}"></script>' for address in _SCRIPTS)
    title = escape(test.title(language))
    write_whole(folder / "index.html", _PAGE.format(language=language, title=title, scripts=scripts), make_folder=True)
    write_whole(folder / "test.js", f"const TEST = {json.dumps(data, ensure_ascii=False)};\n")
    static = package_files("tonewood.workshop.exchange") / "static/tonewood.js"
    write_whole(folder / "tonewood.js", static.read_text("utf-8"))
    package = {"name": "listening-test", "private": True, "dependencies": PACKAGES}
    write_whole(folder / "package.json", json.dumps(package, indent=1) + "\n")
    copy_sounds(test, codes_of(row for rows in courses for row in rows), folder / "stimuli")
    return Exported(folder, left_out(test, "jspsych", _KEPT))
