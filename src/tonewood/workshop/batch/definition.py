"""The definition of a listening test, ``test.json``: the manifest, and the blind codes of its trials.

`tonewood serve` reads it. It names no condition of a code (that is the key), and it is not sent to browsers:
they get one page at a time.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tonewood.errors import TonewoodError, together
from tonewood.support.text_files import json_value
from tonewood.support.validation_messages import first_message
from tonewood.workshop.batch.conditions import Condition, expand
from tonewood.workshop.batch.layout import Group
from tonewood.workshop.batch.manifest import Manifest, ManifestError, RenderSettings
from tonewood.workshop.batch.pages import StaircasePage

SCHEMA = "tonewood-test/1"
FILE = "test.json"
#: folder of the listeners' answers, a file each
ANSWERS = "answers"
#: s of each level of a staircase that are rendered to see whether it can be
_PIECE = 0.05


def definition_of(
    manifest: Manifest, groups: Sequence[Group], codes: Collection[str], folder: Path, drops_db: dict[str, float]
) -> dict[str, Any]:
    """The definition as plain data; trials with a sound that is not in `codes` are left out.

    drops_db : by name of a group, by which its files were lowered.
    Raises ManifestError : the room's file cannot be read.
    """
    room = manifest.stimuli.room
    return {
        **({} if room is None else {"room_sha256": room_sha256(folder / room)}),
        "schema": SCHEMA,
        "name": manifest.name,
        "folder": str(folder.resolve()),
        "manifest": manifest.model_dump(mode="json", by_alias=True, exclude_unset=True),
        "trials": [
            {
                "id": trial.id,
                "page": group.page + 1,
                "reference": trial.reference,
                "stimuli": list(trial.stimuli),
                "drop_db": drops_db.get(group.name, 0.0),
            }
            for group in groups
            for trial in group.trials
            if set(trial.codes) <= set(codes)
        ],
    }


def room_sha256(path: Path) -> str:
    """SHA-256 of a room's impulse response: the sounds of a test depend on it, its name does not tell.

    Raises ManifestError : it cannot be read.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as fault:
        raise ManifestError(f"cannot be read: {fault.strerror}", file=path, key="stimuli.room") from None


@dataclass(frozen=True)
class StaircaseLevel:
    """A level of a staircase that is known beforehand: the key of its page, and the sound."""

    key: str
    condition: Condition


def changed_condition(manifest: Manifest, conditions: Sequence[Condition], index: int) -> Condition:
    """The one condition that the staircase of page `index` (from 0) changes.

    Raises ManifestError : its `of` fits no condition, or several.
    """
    page = manifest.pages[index]
    assert isinstance(page, StaircasePage)
    candidates = [c for c in conditions if page.of.items() <= c.all_levels.items()]
    if len(candidates) != 1:
        raise ManifestError(
            f"fits {len(candidates)} conditions, one is wanted: name levels of {', '.join(manifest.choices())}, repeat",
            key=f"pages.{index}.of",
        )
    return candidates[0]


def with_value(manifest: Manifest, condition: Condition, path: str, value: Any) -> Condition:
    """The condition with one parameter of the bundle, or of the render (``render.``), changed.

    Raises ManifestError : a setting of the render cannot have the value.
    """
    name = f"{condition.name}.{path}={value}"
    if not path.startswith("render."):
        return dataclasses.replace(condition, name=name, overrides={**condition.overrides, path: value})
    factors = {manifest.factors[f].path: manifest.factors[f].levels[level] for f, level in condition.levels.items()}
    changes = {p.removeprefix("render."): v for p, v in factors.items() if p.startswith("render.")}
    try:
        settings = manifest.render_settings({**changes, path.removeprefix("render."): value})
    except ValidationError as fault:
        raise ManifestError(f"{path}: {first_message(fault, RenderSettings)[1]}") from None
    return dataclasses.replace(condition, name=name, render=settings)


def staircase_levels(
    manifest: Manifest, folder: Path, default: Callable[[Condition, str], Any]
) -> list[StaircaseLevel]:
    """Sounds that every staircase needs: reference, start, lowest and highest level.

    default : of (condition, path), the parameter's value in the bundle; raises a TonewoodError if there is none.
    Raises ManifestError : a staircase changes no condition or several, a level does not fit, or levels change nothing;
        names
        the page and the key.
    """
    pages = [(index, page) for index, page in enumerate(manifest.pages) if isinstance(page, StaircasePage)]
    conditions = expand(manifest, folder) if pages else ()
    levels: list[StaircaseLevel] = []
    faults: list[TonewoodError] = []
    for index, page in pages:
        try:
            levels += _levels_of(manifest, conditions, index, page, default)
        except ManifestError as fault:
            faults.append(fault)
    if faults:
        raise together(faults)
    return levels


def _levels_of(
    manifest: Manifest,
    conditions: Sequence[Condition],
    index: int,
    page: StaircasePage,
    default: Callable[[Condition, str], Any],
) -> list[StaircaseLevel]:
    condition = changed_condition(manifest, conditions, index)
    levels = []
    try:
        base = default(condition, page.path)
    except TonewoodError as fault:
        raise ManifestError(str(fault), key=f"pages.{index}.path") from None
    values = {}
    for name in ("reference", "start", "lowest", "highest"):
        key = f"pages.{index}.{name}"
        if name == "reference":
            value = base if page.reference is None else page.reference
        else:
            try:
                value = page.value(getattr(page, name), base)
            except ValueError as fault:
                raise ManifestError(str(fault), key=f"pages.{index}.reference") from None
            except OverflowError:
                value = math.inf
        if isinstance(value, float) and not math.isfinite(value):
            raise ManifestError(f"the value of {page.path} is not finite", key=key)
        # the condition itself where nothing is changed: its value may be none that an override can set
        same = name == "reference" and page.reference is None
        try:
            level = condition if same else with_value(manifest, condition, page.path, value)
            values[name] = default(level, page.path)
        except TonewoodError as fault:
            raise ManifestError(f"the level cannot be rendered: {fault}", key=key) from None
        levels.append(StaircaseLevel(key, level))
    if values["lowest"] == values["highest"]:
        reason = f"{page.path} is {values['lowest']} at the lowest and at the highest level: levels change nothing"
        raise ManifestError(reason, key=f"pages.{index}.scale")
    return levels


def check_rendering(levels: Sequence[StaircaseLevel], render: Callable[[Condition], Any]) -> None:
    """Render a short piece of each level: values that are allowed one by one may not fit together.

    Raises ManifestError : one cannot be rendered; names the page and the key.
    """
    for level in levels:
        settings = level.condition.render
        piece = settings.at(max_duration=min(settings.max_duration or _PIECE, _PIECE))
        try:
            render(dataclasses.replace(level.condition, render=piece))
        except Exception as fault:  # of a plugin, anything
            reason = str(fault) if isinstance(fault, TonewoodError) else f"{type(fault).__name__}: {fault}"
            raise ManifestError(f"the level cannot be rendered: {reason}", key=level.key) from None


def count_answers(path: Path) -> int:
    """Number of lines after the first one of a file of answers; 0 of what is no file, as a pipe has no end."""
    return max(path.read_bytes().count(b"\n") - 1, 0) if path.is_file() else 0


def check_answers(folder: Path, manifest: Manifest, source: Path, groups: Sequence[Group], todo: int) -> None:
    """Check that a batch leaves a test as it is to which answers were given.

    todo : sounds that would be rendered.
    Raises ManifestError : the test or its sounds would be replaced, or it is unknown whether answers were given.
    """
    answers = 0
    for path in (folder / ANSWERS).glob("*.jsonl"):
        try:
            answers += count_answers(path)
        except OSError as fault:
            reason = f"cannot be read: {fault.strerror}; there may be answers to this test in it"
            raise ManifestError(reason, file=path) from None
    if not answers:
        return
    planned = definition_of(manifest, groups, {s.code for g in groups for s in g.stimuli}, source, {})
    try:
        old = json_value((folder / FILE).read_bytes())
        drops = [row.pop("drop_db") for row in old["trials"]]
    except (OSError, ValueError, RecursionError, LookupError, TypeError, AttributeError):
        old, drops = None, []
    for row in planned["trials"][: len(drops)]:
        row.pop("drop_db")
    changed = FILE if json.loads(json.dumps(planned)) != old else f"{todo} of its sounds" if todo else None
    if changed:
        raise ManifestError(
            f"{answers} answers were given to this test, and {changed} would be replaced: take another folder with -o, "
            f"or move {folder / ANSWERS} away",
            file=folder / FILE,
        )
