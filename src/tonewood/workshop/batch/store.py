"""Store of rendered sounds on disk, by the hash of their content."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.errors import OutputError
from tonewood.support.whole_files import remove_leftover, whole_file

SCHEMA = "tonewood-render/2"


@dataclass(frozen=True)
class Rendered:
    """A rendered sound.

    samples : (n, channels) float64, 1.0 is full scale.
    fs : Hz.
    info : JSON-ready facts about the render (energy residual, effects that ran, seconds it took, ...).
    """

    samples: NDArray[np.float64]
    fs: int
    info: dict[str, Any] = field(default_factory=dict)


def content_key(identity: dict[str, Any]) -> str:
    """SHA-256 over everything that decides a render's samples, from JSON with sorted keys."""
    text = json.dumps({"schema": SCHEMA, **identity}, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


class Store:
    """Rendered sounds in one folder, each under the hash of everything that decides its samples."""

    def __init__(self, folder: Path):
        self.folder = folder

    def path(self, key: str) -> Path:
        """File of the render of `key`, whether it exists or not."""
        return self.folder / f"{key}.npz"

    def has(self, key: str) -> bool:
        """Whether a whole, undamaged render of `key` is there (its checksums are read)."""
        try:
            self.load(key)
        except OutputError:
            return False
        return True

    def others(self, keys: Collection[str]) -> int:
        """Number of renders besides those of `keys`."""
        return sum(path.stem not in keys for path in self.folder.glob("[0-9a-f]*.npz"))

    def save(self, key: str, rendered: Rendered) -> None:
        """Store a render; raises as `whole_file`."""
        facts = json.dumps(
            {"fs": rendered.fs, "frames": len(rendered.samples), "info": rendered.info}, allow_nan=False
        ).encode()
        with whole_file(self.path(key), make_folder=True) as stream:
            np.savez(stream, samples=rendered.samples, facts=np.frombuffer(facts, dtype=np.uint8))

    def load(self, key: str) -> Rendered:
        """The render of `key`. Raises OutputError : it is not there or damaged; the next run makes it again."""
        with self._open(key) as archive:
            facts, samples = _facts(archive), archive["samples"]
            if samples.dtype != np.float64 or samples.ndim != 2 or len(samples) != facts["frames"]:
                raise ValueError("samples are not those the facts tell of")
            return Rendered(samples, facts["fs"], facts["info"])

    def facts(self, key: str) -> dict[str, Any]:
        """Return `fs`, `frames` and `info` of the render of `key` without reading its samples; raises as `load`."""
        with self._open(key) as archive:
            return _facts(archive)

    @contextlib.contextmanager
    def _open(self, key: str) -> Iterator[Any]:
        try:
            with np.load(self.path(key)) as archive:
                yield archive
        except Exception:  # unzipping and decoding damaged bytes may raise almost anything
            raise OutputError("is damaged or gone: run the batch again", file=self.path(key)) from None

    def clear_parts(self) -> None:
        """Remove incomplete files of an earlier run."""
        for part in self.folder.glob(".*.part.npz"):
            remove_leftover(part)


def _facts(archive: Any) -> dict[str, Any]:
    facts = json.loads(archive["facts"].tobytes())
    fs, frames, info = facts["fs"], facts["frames"], facts["info"]
    if not (type(fs) is int and fs > 0 and type(frames) is int and isinstance(info, dict)):
        raise ValueError("facts are not those of a render")
    return {"fs": fs, "frames": frames, "info": info}
