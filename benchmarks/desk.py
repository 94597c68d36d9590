"""Processor time from a change at the desk to the first block that bears it: `python benchmarks/desk.py`.

The steps that the desk makes are made one after another, without a server: change, model (of a drawn body its preview),
take, first 4,096 frames. Printed: least and largest of five changes, ms, and of the drawn guitar the exact model.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ["TONEWOOD_CACHE"] = "off"

from tonewood.sound.render.options import RenderOptions
from tonewood.sound.render.renderer import assembled
from tonewood.workshop.desk.models import previewed
from tonewood.workshop.desk.phrase import phrase
from tonewood.workshop.desk.session import DeskSession
from tonewood.workshop.desk.take import PhraseTake

CHANGES: tuple[tuple[str, str, str, Callable[[int], Any]], ...] = (
    ("gauge of a string", "classical_guitar", "strings.E2.linear_density", lambda i: 6.2e-3 + 1e-4 * i),
    ("mass on the bridge", "classical_guitar", "body.added", lambda i: [{"at": "bridge_G3", "mass": 5e-3 + 1e-3 * i}]),
    ("end of a brace, preview", "drawn_guitar", "body.braces.fan_1.stop", lambda i: [0.38, -0.14 + 0.002 * i]),
)


def main() -> None:
    """Print a line for each change."""
    options = RenderOptions(tail=3.0, max_duration=60.0)
    for words, name, path, value in CHANGES:
        session, times = DeskSession(name), []
        with tempfile.TemporaryDirectory() as folder:
            score = phrase("chord", session.instrument, Path(folder) / "phrase.mid")
        for i in range(6):
            began = time.process_time()
            session.set(path, value(i))
            coarse = previewed(session.instrument, None)
            model = assembled(session.instrument if coarse is None else coarse[0], options)
            PhraseTake(score, model, options, {}).ensure(4096)
            times.append(1e3 * (time.process_time() - began))
        print(f"{words}, {name}: {min(times[1:]):.0f} to {max(times[1:]):.0f} ms, the first {times[0]:.0f} ms")
        if coarse is not None:
            began = time.process_time()
            assembled(session.instrument, options)
            print(f"its exact model: {time.process_time() - began:.1f} s")


if __name__ == "__main__":
    main()
