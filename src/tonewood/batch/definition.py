"""The definition of a listening test, ``test.json``: the manifest, and the blind codes of its trials.

`tonewood serve` reads it. It names no condition of a code (that is the key), and it is not sent to browsers:
they get one page at a time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from tonewood.batch.conditions import Condition, expand
from tonewood.batch.layout import Group
from tonewood.batch.manifest import Manifest, ManifestError
from tonewood.batch.pages import StaircasePage
from tonewood.errors import TonewoodError

SCHEMA = "tonewood-test/1"
FILE = "test.json"


def definition_of(
    manifest: Manifest, groups: Sequence[Group], codes: Collection[str], folder: Path, drops_db: dict[str, float]
) -> dict[str, Any]:
    """The definition as plain data; trials with a sound that is not in `codes` are left out.

    Parameters
    ----------
    folder : the manifest's, to which its paths are relative.
    drops_db : by name of a group, by which its files were lowered.
    """
    return {
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


def changed_condition(manifest: Manifest, conditions: Sequence[Condition], index: int) -> Condition:
    """The one condition that the staircase of page `index` (from 0) changes.

    Raises
    ------
    ManifestError : its `of` fits no condition, or several.
    """
    page = manifest.pages[index]
    assert isinstance(page, StaircasePage)
    found = [c for c in conditions if page.of.items() <= c.all_levels.items()]
    if len(found) != 1:
        raise ManifestError(
            f"fits {len(found)} conditions, one is wanted: name levels of {', '.join(manifest.choices())}, repeat",
            key=f"pages.{index}.of",
        )
    return found[0]


def with_value(manifest: Manifest, condition: Condition, path: str, value: Any) -> Condition:
    """The condition with one parameter of the bundle, or of the render (``render.``), changed."""
    name = f"{condition.name}.{path}={value}"
    if not path.startswith("render."):
        return dataclasses.replace(condition, name=name, overrides={**condition.overrides, path: value})
    factors = {manifest.factors[f].path: manifest.factors[f].levels[level] for f, level in condition.levels.items()}
    changes = {p.removeprefix("render."): v for p, v in factors.items() if p.startswith("render.")}
    settings = manifest.render_settings({**changes, path.removeprefix("render."): value})
    return dataclasses.replace(condition, name=name, render=settings)


def check_staircases(manifest: Manifest, folder: Path, own: Any) -> None:
    """Check that every staircase changes one condition, and that its first levels can be rendered.

    Parameters
    ----------
    folder : the manifest's.
    own : of (condition, path), the parameter's value in the bundle; raises a TonewoodError if there is none.

    Raises
    ------
    ManifestError : names the page and the key.
    """
    conditions = None
    for index, page in enumerate(manifest.pages):
        if isinstance(page, StaircasePage):
            conditions = conditions or expand(manifest, folder)
            condition = changed_condition(manifest, conditions, index)
            try:
                value = page.value(page.start, own(condition, page.path))
                own(with_value(manifest, condition, page.path, value), page.path)
            except ValueError as fault:
                raise ManifestError(str(fault), key=f"pages.{index}.reference") from None
            except ManifestError:
                raise
            except TonewoodError as fault:
                raise ManifestError(str(fault), key=f"pages.{index}.path") from None
