"""An exact model made ahead in a process of its own: its arrays are kept in the cache, where the desk finds them.

The desk's own process has the sound. `Ahead` starts this module with a design on its standard input; a design that is
turned away from is stopped at once.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from tonewood.instrument.bundle.loading import Instrument
from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled
from tonewood.support.cache_folder import cache_folder
from tonewood.workshop.desk.session import Design

#: added to the process's niceness: the sound comes first
_NICE = 5


class Ahead:
    """One design at a time, assembled in another process.

    source, allow_code : of the instrument, as for `Instrument.load`.
    """

    def __init__(self, source: str, fs: int, *, allow_code: bool):
        self._fixed = {"source": source, "fs": fs, "allow_code": allow_code}
        self._process: subprocess.Popen[str] | None = None
        self._body: Any = None
        self._then: Callable[[], None] | None = None
        self._lock = threading.Lock()

    def turn_to(self, design: Design) -> None:
        """End the process where it makes another body."""
        if self._body != design.instrument.resolved["body"]:
            self.stop()

    def make(self, design: Design, then: Callable[[], None]) -> None:
        """Assemble a design, and call `then`: at once where nothing is kept between processes, never if stopped.

        design : one whose body is being made goes on.
        then : called when its arrays are kept, or cannot be made: the desk finds out why.
        """
        self.turn_to(design)
        if cache_folder() is None:
            then()
            return
        with self._lock:
            self._body, self._then = design.instrument.resolved["body"], then
            if self._process is not None:
                return
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, text=True,
            )  # fmt: skip
        text = json.dumps({**self._fixed, "changes": dict(design.changes)})
        threading.Thread(target=self._wait, args=(self._process, text), daemon=True).start()

    def stop(self) -> None:
        """End the process, if there is one."""
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()

    def _wait(self, process: subprocess.Popen[str], text: str) -> None:
        process.communicate(text)
        with self._lock:
            if self._process is not process:
                return
            self._process, then = None, self._then
        if then is not None:
            then()


def main() -> None:
    """Assemble the design that standard input describes."""
    if hasattr(os, "nice"):
        os.nice(_NICE)
    design = json.load(sys.stdin)
    instrument = Instrument.load(design["source"], allow_code=design["allow_code"]).replace(design["changes"])
    assembled(instrument, RenderOptions(fs=design["fs"]))


if __name__ == "__main__":
    main()
