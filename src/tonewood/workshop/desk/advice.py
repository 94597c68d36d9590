"""What to change so that the body reaches targets: `tonewood design`, run beside the sound in its own process."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

from tonewood.errors import TonewoodError
from tonewood.instrument.bundle.loading import Instrument
from tonewood.workshop.design.task import parse_free, parse_targets

#: thickness and heights that are offered, re those of the design
_RANGE = (0.8, 1.2)
#: lines of progress that are kept
_KEPT = 50


def offered(instrument: Instrument) -> str:
    """Lines of free parameters to begin with: those of a drawn body, or of what was put on it; may be empty."""
    body = instrument.resolved["body"]
    out = []
    if isinstance(thickness := body.get("thickness"), int | float):
        out.append(f"body.thickness: {_RANGE[0] * thickness:.4g} .. {_RANGE[1] * thickness:.4g}")
    if body.get("braces"):
        out.append(f"body.braces.*.height: x {_RANGE[0]:g} .. {_RANGE[1]:g}")
    for i, part in enumerate(body.get("added") or ()):
        if part.get("frequency"):
            out += [
                f"body.added.{i}.mass: 0.001 .. 0.05",
                f"body.added.{i}.frequency: x {_RANGE[0]:g} .. {_RANGE[1]:g}",
            ]
        elif part.get("mass"):
            out.append(f"body.added.{i}.mass: 0 .. 0.05")
    return "\n".join(out)


class Adviser:
    """One search for a design at a time.

    lines : of progress, then of the result.
    overrides : path -> value of the design that was found.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.fault, self.command = "", ""
        self.overrides: dict[str, float] = {}
        self._process: subprocess.Popen[str] | None = None
        self._began = 0.0
        self._lock = threading.Lock()

    def ask(self, instrument: Instrument, options: Sequence[str], source: str, targets: str, free: str) -> None:
        """Begin a search.

        options, source : arguments of a command that make it.
        targets, free : lines, as in a file of ``tonewood design``.
        Raises TonewoodError : a line is not allowed, or a search goes on.
        """
        target_lines = [line.strip() for line in targets.splitlines() if line.strip()]
        bounds = _bounds(free)
        parse_targets(target_lines, instrument)
        parse_free(bounds, instrument)
        arguments = ["design", source, *options]
        arguments += [word for line in target_lines for word in ("--target", line)]
        arguments += [word for path, line in bounds.items() for word in ("--free", f"{path}={line}")]
        with self._lock:
            if self._process is not None:
                raise TonewoodError("a search goes on: stop it first", key="advise")
            self.lines, self.fault, self.overrides = [], "", {}
            self.command = shlex.join(["tonewood", *arguments])
            self._began = time.monotonic()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "tonewood", *arguments, "--json"],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip
        threading.Thread(target=self._follow, args=(self._process,), daemon=True).start()

    def stop(self) -> None:
        """End the search, if one goes on."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.terminate()
            self.lines, self.fault = [], "stopped"

    def state(self) -> dict[str, Any]:
        """Return all that the page shows."""
        with self._lock:
            return {
                "seconds": None if self._process is None else round(time.monotonic() - self._began, 1),
                "lines": self.lines,
                "fault": self.fault,
                "found": self.overrides,
                "command": self.command,
            }

    def _follow(self, process: subprocess.Popen[str]) -> None:
        """Read progress until the search ends, then its report."""
        assert process.stdout is not None
        assert process.stderr is not None
        errors: list[str] = []
        for line in process.stderr:
            errors.append(line.strip())
            with self._lock:
                if self._process is process:
                    self.lines = errors[-_KEPT:]
        text = process.stdout.read()
        code = process.wait()
        with self._lock:
            if self._process is not process:
                return
            self._process = None
            try:
                report: Mapping[str, Any] = json.loads(text)
                self.lines, self.overrides = list(report["lines"]), dict(report["overrides"])
            except (ValueError, KeyError):
                self.lines, self.fault = [], errors[-1] if errors else f"the search ended with code {code}"


def _bounds(text: str) -> dict[str, str]:
    """Path -> bounds, of lines PATH: LOW .. HIGH."""
    out: dict[str, str] = {}
    for text_line in text.splitlines():
        path, colon, bounds = text_line.partition(":")
        if not text_line.strip():
            continue
        if not colon:
            raise TonewoodError(f"is {text_line.strip()!r}; PATH: LOW .. HIGH is allowed", key="free")
        out[path.strip()] = bounds.strip()
    return out
