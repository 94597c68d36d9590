"""A listening test as it is served: the definition that a batch wrote, opened and checked."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.support.text_files import json_value
from tonewood.workshop.batch.definition import FILE, SCHEMA
from tonewood.workshop.batch.manifest import Manifest, check_manifest
from tonewood.workshop.batch.pages import AnyPage, FinishPage, TrainingPage, localised
from tonewood.workshop.batch.production import SOUNDS

#: bytes of a definition or a key
_MOST_BYTES = 200_000_000


class ListeningError(TonewoodError):
    """A test, its answers or its key cannot be used."""


@dataclass(frozen=True)
class ServedTrial:
    """Codes of the sounds that are judged together; `page` counts from 0."""

    id: str
    page: int
    reference: str | None
    stimuli: tuple[str, ...]
    drop_db: float = 0.0

    @property
    def codes(self) -> tuple[str, ...]:
        """All codes of the trial, the reference first."""
        return self.stimuli if self.reference is None else (self.reference, *self.stimuli)


@dataclass(frozen=True)
class ListeningTest:
    """A test and the folder of its batch.

    sha256 : of the definition's bytes; answers are given to one definition.
    room_sha256 : of the room's impulse response; empty where there is none.
    """

    folder: Path
    source: Path
    manifest: Manifest
    trials: tuple[ServedTrial, ...]
    sha256: str
    room_sha256: str = ""

    @cached_property
    def pages(self) -> tuple[AnyPage, ...]:
        """Pages of the manifest that listeners see, a last one added where it has none."""
        pages = tuple(self.manifest.pages)
        return pages if any(isinstance(p, FinishPage) for p in pages) else (*pages, FinishPage(type="finish"))

    def trials_of(self, page: int) -> list[ServedTrial]:
        """Trials of a page, counted from 0, in the manifest's order; of a page that is trained, for training."""
        trials = self.pages[page]
        number = trials.page - 1 if isinstance(trials, TrainingPage) else page
        return [trial for trial in self.trials if trial.page == number]

    def sound(self, code: str) -> Path:
        """File of a code."""
        return self.folder / SOUNDS / f"{code}.wav"

    @cached_property
    def languages(self) -> list[str]:
        """Languages of the texts, that of the manifest first."""
        languages = dict.fromkeys([self.manifest.language, *built_in_texts(), *self.manifest.texts])
        return list(languages)

    def texts(self, language: str) -> dict[str, str]:
        """Words of the pages in a language; missing ones are in English."""
        built_in = built_in_texts()
        base = language.partition("-")[0]
        texts = self.manifest.texts
        layers = (built_in["en"], built_in.get(base, {}), texts.get(base, {}), texts.get(language, {}))
        return {key: text for layer in layers for key, text in layer.items()}

    def title(self, language: str) -> str:
        """Title of the test."""
        return localised(self.manifest.title, language) or self.manifest.name


def built_in_texts() -> dict[str, dict[str, str]]:
    """Words of the pages that the package has: language -> key -> text."""
    texts: dict[str, dict[str, str]] = json.loads(
        (files("tonewood.workshop.listening") / "static/texts.json").read_text("utf-8")
    )
    return texts


def read_json(path: Path, schema: str, noun: str, hint: str = "") -> tuple[bytes, dict[str, Any]]:
    """Read a file of a schema: its bytes and values. Raises ListeningError : it cannot be read, or is no such file."""
    try:
        with path.open("rb") as stream:  # a device may have no end
            raw = stream.read(_MOST_BYTES + 1)
        if len(raw) > _MOST_BYTES:
            raise ListeningError(f"is longer than the {_MOST_BYTES} bytes allowed", file=path)
        data: Any = json_value(raw)
    except OSError as fault:
        raise ListeningError(f"cannot be read: {fault.strerror}{hint}", file=path) from None
    except (ValueError, RecursionError) as fault:
        raise ListeningError(f"not JSON: {fault}", file=path) from None
    if not isinstance(data, dict) or data.get("schema") != schema:
        raise ListeningError(f"not a {noun}: schema {schema} is wanted", file=path)
    return raw, data


def load_test(folder: Path) -> ListeningTest:
    """Open the test of a batch's folder. Raises ListeningError : there is none, or it is damaged; one line."""
    path = folder / FILE
    raw, data = read_json(path, SCHEMA, "test", "; `tonewood batch` writes it")
    try:
        trials = tuple(
            ServedTrial(row["id"], row["page"] - 1, row["reference"], tuple(row["stimuli"]), row["drop_db"])
            for row in data["trials"]
        )
        source, manifest, room = Path(data["folder"]), data["manifest"], str(data.get("room_sha256", ""))
    except (KeyError, TypeError) as fault:
        raise ListeningError(f"not a whole test: {fault}", file=path) from None
    sha256 = hashlib.sha256(raw).hexdigest()
    test = ListeningTest(folder, source, check_manifest(manifest, file=path), trials, sha256, room)
    unknown = sorted({key for words in test.manifest.texts.values() for key in words} - set(built_in_texts()["en"]))
    if unknown:
        raise ListeningError(f"texts: {unknown[0]} is not one of {', '.join(built_in_texts()['en'])}", file=path)
    return test
