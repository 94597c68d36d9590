"""A batch as a webMUSHRA experiment: its YAML file, beside the folder of stimuli.

The served folder is to be put (or linked) into webMUSHRA as ``configs/NAME``; the address then ends in
``?config=NAME/webmushra.yaml``. Names of conditions appear nowhere: stimuli are keyed by their blind codes, trials
by theirs. webMUSHRA itself adds the hidden reference and the anchors it is asked for, under the names
``reference``, ``anchor35`` and ``anchor70``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tonewood.batch.layout import Group, Trial
from tonewood.batch.manifest import Bs1116Page, HtmlPage, Manifest, MushraPage, PairedPage
from tonewood.batch.production import SoundFile
from tonewood.batch.seeds import generator
from tonewood.whole_files import whole_file

FILE = "webmushra.yaml"
LONGEST = 12.0  # s, of a stimulus on a page webMUSHRA checks strictly
LISTENER = "listener"

_QUESTIONS = {
    "mushra": "Rate how close each sound is to the reference.",
    "bs1116": "One of the two sounds is the reference: rate the other.",
    "paired_comparison": "Which of the two sounds is the reference?",
}


def experiment(manifest: Manifest, groups: Sequence[Group], files: dict[str, SoundFile]) -> dict[str, Any]:
    """The experiment as plain data; trials with a sound that is not in `files` are left out."""
    pages: list[Any] = []
    for index, page in enumerate(manifest.pages):
        if isinstance(page, HtmlPage):
            continue
        trials = [t for g in groups if g.page == index for t in g.trials if set(t.codes) <= set(files)]
        shown = [_page(manifest, page, trial, files) for trial in _ordered(manifest, index, trials)]
        if manifest.output.page_order == "per_listener" and shown:
            pages.append(["random", *shown])
        else:
            pages += shown
    return {
        "testname": manifest.title or manifest.name,
        "testId": manifest.name,
        "bufferSize": 2048,
        "stopOnErrors": True,
        "showButtonPreviousPage": False,
        "remoteService": "service/write.php",
        "pages": [*pages, _finish()],
    }


def write_experiment(folder: Path, experiment: dict[str, Any]) -> None:
    """Write the YAML file into the served folder."""
    with whole_file(folder / FILE, make_folder=True) as stream:
        stream.write(("\n".join(_yaml(experiment, 0)) + "\n").encode())


def _yaml(value: dict[str, Any] | list[Any], depth: int) -> Iterator[str]:
    """Lines of the plainest block YAML: one value a line, JSON scalars, as in webMUSHRA's own configurations.

    Its browser-side reader knows only part of the language; folded lines and compact nested lists are kept from it.
    """
    space = "  " * depth
    items = [(f"{k}:", v) for k, v in value.items()] if isinstance(value, dict) else [("-", v) for v in value]
    for mark, item in items:
        if isinstance(item, (dict, list)) and item:
            yield space + mark
            yield from _yaml(item, depth + 1)
        else:
            yield f"{space}{mark} {json.dumps(item, ensure_ascii=False)}"


def _ordered(manifest: Manifest, index: int, trials: list[Trial]) -> list[Trial]:
    if manifest.output.page_order != "seeded":
        return trials
    order = generator(manifest.seed, "page order", index).permutation(len(trials))
    return [trials[i] for i in order]


def _page(
    manifest: Manifest, page: MushraPage | Bs1116Page | PairedPage, trial: Trial, files: dict[str, SoundFile]
) -> dict[str, Any]:
    def path(code: str) -> str:
        return f"configs/{manifest.name}/stimuli/{code}.wav"

    assert trial.reference is not None  # of html pages only
    reference = files[trial.reference]
    shown: dict[str, Any] = {
        "type": page.type,
        "id": trial.id,
        "name": page.name or _QUESTIONS[page.type],
        "content": page.content,
        "showWaveform": page.show_waveform,
        "enableLooping": page.looping,
    }
    if isinstance(page, MushraPage):
        shown["strict"] = page.strict and reference.frames <= LONGEST * reference.fs
    if isinstance(page, PairedPage):
        if page.unforced is not None:
            shown["unforced"] = page.unforced
    else:
        shown["createAnchor35"] = 3500 in page.anchors
        shown["createAnchor70"] = 7000 in page.anchors
    shown["reference"] = path(trial.reference)
    if isinstance(page, MushraPage):
        shown |= {"randomize": True, "showConditionNames": False, "switchBack": page.switch_back}
    shown["stimuli"] = {code: path(code) for code in trial.stimuli}
    return shown


def _finish() -> dict[str, Any]:
    return {
        "type": "finish",
        "name": "Thank you",
        "content": "Thank you for listening. Please enter the number you were given, and send your answers.",
        "popupContent": "Your answers were sent.",
        "showResults": False,
        "writeResults": True,
        "questionnaire": [{"type": "text", "label": "Your number", "name": LISTENER, "optional": False}],
    }
