"""MIDI inputs of the machine, by mido and python-rtmidi."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol

from tonewood.errors import TonewoodError
from tonewood.support.validation_messages import did_you_mean

_REMEDY = (
    "on Linux the ALSA sequencer is needed (modprobe snd-seq), or a JACK server and "
    "MIDO_BACKEND=mido.backends.rtmidi/UNIX_JACK; --keyboard plays with the computer's keys"
)


class EventSource(Protocol):
    """Gives the MIDI messages that have come since it was asked last."""

    name: str

    def poll(self) -> Sequence[tuple[float, Sequence[int]]]:
        """Messages, each as the time at which it came, s of `time.monotonic`, and its bytes."""

    def close(self) -> None:
        """Give it back."""


def midi_inputs() -> list[str]:
    """Names of the MIDI inputs.

    Raises TonewoodError : no MIDI library is installed, or it finds no system to ask; one line.
    """
    import mido

    try:
        with _library_silent():
            return list(dict.fromkeys(mido.get_input_names()))
    except ImportError as error:
        raise TonewoodError(f"MIDI inputs need {error.name or 'python-rtmidi'}: pip install 'tonewood[live]'") from None
    except (OSError, RuntimeError) as error:  # rtmidi's errors are RuntimeErrors
        raise TonewoodError(f"MIDI inputs cannot be listed: {str(error).strip()}; {_REMEDY}", key="--midi-in") from None


@contextmanager
def _library_silent() -> Iterator[None]:
    """Keep messages of a C library off the standard error: its error comes as an exception, too."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class MidiInput:
    """One MIDI input, opened.

    name : of the port, or a part of it that no other has; empty for the first one.
    Raises TonewoodError : there is no such input, or it cannot be opened; one line.
    """

    def __init__(self, name: str = ""):
        import mido

        names = midi_inputs()
        if not names:
            raise TonewoodError("there is no MIDI input; --keyboard plays with the computer's keys", key="--midi-in")
        matches = [n for n in names if n == name] or [n for n in names if name.lower() in n.lower()]
        if not name:
            matches = names[:1]
        if len(matches) != 1:
            which = "fits several" if matches else "is not there"
            listed = f"{'' if matches else did_you_mean(name, names)}there are {', '.join(matches or names)}"
            raise TonewoodError(f"{name!r} {which}; {listed}", key="--midi-in")
        self.name: str = matches[0]
        self._come: deque[tuple[float, list[int]]] = deque()
        try:
            self._port: Any = mido.open_input(self.name, callback=self._take)
        except (OSError, RuntimeError) as error:
            raise TonewoodError(f"{self.name!r} cannot be opened: {str(error).strip()}", key="--midi-in") from None

    def _take(self, message: Any) -> None:
        """Note when a message comes, in the thread of the MIDI library."""
        self._come.append((time.monotonic(), message.bytes()))

    def poll(self) -> list[tuple[float, list[int]]]:
        """Messages that have come since the last time."""
        return [self._come.popleft() for _ in range(len(self._come))]

    def close(self) -> None:
        """Close the port."""
        self._port.close()
