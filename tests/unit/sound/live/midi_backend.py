"""A backend of mido whose ports are lists in this process: ``mido.set_backend("midi_backend")``."""

from __future__ import annotations

from typing import Any

import mido
from mido.ports import BaseInput

NAMES = ["Keys A", "Keys B", "Pads"]
OPEN: dict[str, Input] = {}


def get_devices(**_: Any) -> list[dict[str, Any]]:
    return [{"name": name, "is_input": True, "is_output": False} for name in NAMES]


class Input(BaseInput):
    """A port that gives the messages that `feed` has put in."""

    def _open(self, callback: Any = None, **_: Any) -> None:
        self.callback = callback
        OPEN[self.name] = self

    def _close(self) -> None:
        OPEN.pop(self.name, None)

    def _receive(self, block: bool = True) -> None:
        return None

    def feed(self, *messages: mido.Message) -> None:
        for message in messages:
            self.callback(message)
