"""Answers as a data set of the Brain Imaging Data Structure (BIDS 1.9): behaviour alone, one table a listener.

Listeners are numbered; names and comments are not in it. Sounds have their blind codes.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from tonewood.support.whole_files import write_whole
from tonewood.workshop.exchange.course import Exported, copy_sounds
from tonewood.workshop.listening.answer_file import answers_of
from tonewood.workshop.listening.definition import ListeningError, ListeningTest

VERSION = "1.9.0"
_NONE = "n/a"
COLUMNS = {
    "page": "number of the page, from 1",
    "type": "type of the page",
    "trial": "blind name of the trial",
    "repetition": "of the trial, from 1",
    "training": "1 where the answer does not count",
    "stim_file": "sound that was rated, below stimuli/",
    "slots": "slots of the page and the sounds in them",
    "item": "scale or question",
    "response": "answer that was given",
    "right": "1 where it was right, 0 where not",
    "level": "of a staircase",
    "track": "of a staircase",
    "response_time": "from the begin of the page to the answer",
}


def write(test: ListeningTest, folder: Path) -> Exported:
    """Write ``dataset_description.json``, ``participants.tsv``, a table of each listener, and the sounds.

    Raises ListeningError : there are no answers.
    Raises OutputError : a file cannot be written.
    """
    answers = answers_of(test)
    listeners = [one for one in answers.listeners if one.records]
    if not listeners:
        raise ListeningError("holds no answers; BIDS is of participants", file=test.folder / "answers")
    task = re.sub(r"[^A-Za-z0-9]", "", test.manifest.name) or "listening"
    width = max(2, len(str(len(listeners))))
    people, used = [], set()
    for number, one in enumerate(listeners, start=1):
        name = f"sub-{number:0{width}d}"
        people.append({"participant_id": name, "simulated": int(bool(one.header["simulated"]))})
        rows = [row for record in one.records for row in _rows(record)]
        used |= {code for record in one.records for code in record["slots"].values()}
        _table(folder / name / "beh" / f"{name}_task-{task}_beh.tsv", list(COLUMNS), rows)
    _table(folder / "participants.tsv", ["participant_id", "simulated"], people)
    simulated = {"Description": "whether the listener is simulated", "Levels": {"0": "a person", "1": "simulated"}}
    _json(folder / "participants.json", {"simulated": simulated})
    sidecar: dict[str, Any] = {name: {"Description": text} for name, text in COLUMNS.items()}
    sidecar["response_time"]["Units"] = "s"
    head = {"TaskName": test.manifest.name, "TaskDescription": test.title(test.manifest.language)}
    _json(folder / f"task-{task}_beh.json", head | sidecar)
    made_by = [{"Name": "tonewood", "Description": "sounds and listening test"}]
    description = {"Name": test.title(test.manifest.language), "BIDSVersion": VERSION, "DatasetType": "raw"}
    _json(folder / "dataset_description.json", {**description, "GeneratedBy": made_by})
    write_whole(folder / "README.md", _README.format(name=test.manifest.name), make_folder=True)
    copy_sounds(test, sorted(code for code in used if test.sound(code).exists()), folder / "stimuli")
    return Exported(folder, tuple(f"bids: left out: {one.reason}" for one in answers.left_out))


_README = """# {name}

Answers to a listening test made by tonewood. Each table `sub-*/beh/*_beh.tsv` has one row an answer. Sounds are in
`stimuli/` under blind codes; the key to the codes is published apart from this data set.
"""


def _rows(record: dict[str, Any]) -> list[dict[str, Any]]:
    answer, slots = record["answer"], record["slots"]
    base = {
        "page": record["page"], "type": record["type"], "trial": record["trial"], "repetition": record["repetition"],
        "training": int(record["training"]), "level": record.get("level"), "track": record.get("track"),
        "slots": " ".join(f"{slot}={code}" for slot, code in slots.items()),
        "response_time": answer.get("seconds"),
        "right": None if "right" not in record else int(record["right"]),
    }  # fmt: skip
    rated = answer.get("ratings", {})
    if rated:
        return [{**base, "stim_file": f"{slots[slot]}.wav", "response": value} for slot, value in rated.items()]
    if "values" in answer:
        files = {"stim_file": f"{next(iter(slots.values()))}.wav"} if slots else {}
        return [{**base, **files, "item": name, "response": value} for name, value in answer["values"].items()]
    response = answer.get("choice", answer.get("spl_db"))
    return [] if response is None else [{**base, "response": response}]


def _table(path: Path, columns: list[str], rows: list[dict[str, Any]]) -> None:
    def cell(value: Any) -> str:
        text = "" if value is None else " ".join(str(value).split())
        return text or _NONE

    lines = ["\t".join(columns), *("\t".join(cell(row.get(name)) for name in columns) for row in rows)]
    write_whole(path, "\n".join(lines) + "\n", make_folder=True)


def _json(path: Path, data: dict[str, Any]) -> None:
    write_whole(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n", make_folder=True)
