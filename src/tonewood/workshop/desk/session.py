"""What a maker has changed: values over a bundle, undone and redone, kept under names, saved, told as a command."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.workshop.design.folder import write_changed
from tonewood.workshop.desk.phrase import LONGEST

#: changes that can be undone, and designs with a name
MOST_CHANGES, MOST_SNAPSHOTS = 500, 50


@dataclass(frozen=True)
class Design:
    """Values over the bundle, in the order in which they are applied, and the instrument that they make."""

    changes: Mapping[str, Any]
    instrument: Instrument


class DeskSession:
    """Changes of one instrument.

    source : name or folder of the instrument, as on the command line.
    changes : path -> value, that were asked for on the command line.
    allow_code : run plugins that lie as Python files in the bundle's folder.
    start : the design that the session began with, to which others are compared.
    Raises TonewoodError : there is no such instrument, or a value is not allowed.
    """

    def __init__(self, source: str, changes: Mapping[str, Any] | None = None, *, allow_code: bool = False):
        self.source, self.allow_code = source, allow_code
        self._base = Instrument.load(source, allow_code=allow_code)
        self.start = self._design(changes or {})
        self.snapshots: dict[str, Design] = {}
        self._past: list[Design] = []
        self._future: list[Design] = []
        #: path that the last change was of, while it is dragged
        self._dragged: str | None = None
        self.design = self.start

    @property
    def instrument(self) -> Instrument:
        """The instrument as it is now."""
        return self.design.instrument

    def _design(self, changes: Mapping[str, Any]) -> Design:
        return Design(dict(changes), self._base.replace(changes))

    def set(self, path: str, value: Any, *, dragging: bool = False) -> None:
        """Change a value; where it is not allowed nothing changes.

        path, value : as for `Instrument.replace`; a path that was changed before takes the new value in its place.
        dragging : whether the knob is still moved: changes of one movement are undone together.
        Raises TonewoodError : the value is not allowed; one line.
        """
        changes = {key: old for key, old in self.design.changes.items() if key != path}
        design = self._design(changes | {path: value})
        if dragging and self._dragged == path:
            self.design = design
            self._future.clear()
        else:
            self._go(design)
        self._dragged = path if dragging else None

    def set_all(self, values: Mapping[str, Any]) -> None:
        """Change several values in one step; where one is not allowed nothing changes.

        Raises TonewoodError : a value is not allowed; one line.
        """
        self._go(self._design({k: v for k, v in self.design.changes.items() if k not in values} | dict(values)))

    def reset(self, path: str) -> None:
        """Take a change back, wherever it stands in the history; the start's value holds again."""
        if path in self.design.changes:
            first = {path: self.start.changes[path]} if path in self.start.changes else {}
            self._go(self._design({key: old for key, old in self.design.changes.items() if key != path} | first))

    def _go(self, design: Design) -> None:
        self._past.append(self.design)
        del self._past[:-MOST_CHANGES]
        self.design, self._dragged = design, None
        self._future.clear()

    @property
    def can_undo(self) -> bool:
        """Whether there is a change to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is an undone change."""
        return bool(self._future)

    def course(self) -> tuple[Design, list[Design], list[Design], str | None]:
        """Return all that a change alters, for `go_back`."""
        return self.design, self._past.copy(), self._future.copy(), self._dragged

    def go_back(self, course: tuple[Design, list[Design], list[Design], str | None]) -> None:
        """Take back a change that cannot be played, as if it had not been made."""
        self.design, self._past, self._future, self._dragged = course

    def undo(self) -> None:
        """Go back by one change, if there is one."""
        if self._past:
            self._future.append(self.design)
            self.design, self._dragged = self._past.pop(), None

    def redo(self) -> None:
        """Make the last undone change again, if there is one."""
        if self._future:
            self._past.append(self.design)
            self.design, self._dragged = self._future.pop(), None

    def keep(self, name: str) -> None:
        """Keep the design under a name; another one of that name is replaced.

        Raises TonewoodError : the name is empty or too long, or too many are kept.
        """
        name = name.strip()
        if not 0 < len(name) <= 60:
            raise TonewoodError(f"is {name!r}; 1 to 60 characters are allowed", key="name")
        if name not in self.snapshots and len(self.snapshots) >= MOST_SNAPSHOTS:
            raise TonewoodError(f"{MOST_SNAPSHOTS} designs are kept; forget one first", key="name")
        self.snapshots[name] = self.design

    def recall(self, name: str) -> None:
        """Go to the design of a name; this can be undone. Raises TonewoodError : there is none of that name."""
        self._go(self.snapshot(name))

    def forget(self, name: str) -> None:
        """Forget the design of a name. Raises TonewoodError : there is none of that name."""
        self.snapshot(name)
        del self.snapshots[name]

    def snapshot(self, name: str) -> Design:
        """Return the design of a name; the empty name is the start.

        Raises TonewoodError : there is none of that name.
        """
        if not name:
            return self.start
        if name not in self.snapshots:
            names = ", ".join(self.snapshots) or "nothing yet"
            raise TonewoodError(f"there is no {name!r}; kept are: {names}", key="name")
        return self.snapshots[name]

    def options(self) -> list[str]:
        """Arguments of any command that make this design of the instrument."""
        code = ["--allow-code"] if self.allow_code else []
        pairs = [assignment(path, value) for path, value in self.design.changes.items()]
        return [*code, *(word for pair in pairs for word in ("--set", pair))]

    def command(self, score: str, output: str, gain_db: float, tail: float) -> str:
        """Return the command line that renders the samples heard, in single precision.

        gain_db, tail : of the desk, dB and s.
        """
        words = ["tonewood", "render", score, "-i", self.source, *self.options(), "--level", "calibrated"]
        words += [f"--gain={gain_db:g}", f"--tail={tail:g}", f"--max-duration={LONGEST:g}"]
        return shlex.join([*words, "--subtype", "FLOAT", "-o", output])

    def save(self, folder: str | Path) -> Instrument:
        """Write a bundle of this design; `render`, `compare` and `batch` take its folder.

        Values that were changed become authored, with a note of the change; others keep their origin.

        folder : to make; its last part is the instrument's name.
        Returns the instrument, loaded from its new folder.
        Raises TonewoodError : the folder is there already, cannot be made, or has no name for an instrument.
        """
        instrument, target = self.instrument, Path(folder).expanduser()
        note = f"changed at the desk; {instrument.name} has another value. Now "
        changes = {k: json.dumps(v, ensure_ascii=False) for k, v in self.design.changes.items() if k != "strings_from"}
        title = f"{target.name}, changed from {instrument.name}: {instrument.spec.title}"
        return write_changed(instrument, target, title, {path: note + value for path, value in changes.items()})


def assignment(path: str, value: Any) -> str:
    """Return ``PATH=VALUE`` as ``--set`` reads it: the value as JSON, which is YAML."""
    return f"{path}={json.dumps(value, ensure_ascii=False)}"
