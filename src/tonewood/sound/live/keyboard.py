"""The computer's keys as a keyboard, in a terminal.

Two rows of letters are two octaves from C, black keys above the white ones. A terminal tells when a key is pressed but
not when it is let go: a note is released `HELD` s after its key was pressed or repeated last.
"""

from __future__ import annotations

import math
import os
import select
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from tonewood.errors import TonewoodError

#: key -> semitones above the C of the lower row
KEYS = {key: i for i, key in enumerate("zsxdcvgbhnjm")} | {key: 12 + i for i, key in enumerate("q2w3er5t6y7ui9o0p")}
#: s, from the last press of a key to its release
HELD = 0.6
_STEP = 12
_ESC = "\x1b"
HELP = "keys z to m and q to p play; [ ] octave, - = loudness, space damps all, Esc ends"


class ComputerKeyboard:
    """Turns characters into MIDI messages.

    lowest : MIDI number of the lowest note that the instrument has; the lower row begins at the C at or below it.
    read : returns the characters that were typed since the last time; those of the terminal where left out.
    now : clock, s.
    base, velocity : MIDI number of the lower row's C, and velocity of the next notes.
    ended : whether Esc was typed.
    Raises TonewoodError : standard input is no terminal.
    """

    name = "computer's keys"

    def __init__(self, lowest: float, read: Callable[[], str] | None = None, now: Callable[[], float] = time.monotonic):
        self.base, self.velocity, self.ended = 12 * math.floor(lowest / 12), 90, False
        self._now = now
        self._terminal = _Terminal() if read is None else None
        self._read = self._terminal.read if read is None and self._terminal is not None else read
        #: note -> time at which it is released
        self._held: dict[int, float] = {}

    def poll(self) -> list[tuple[float, list[int]]]:
        """Messages of the characters typed since the last time, and of notes whose time is over."""
        now, out = self._now(), list[list[int]]()
        for character in self._read() if self._read is not None else "":
            out += self._typed(character, now)
        for note in [note for note, until in self._held.items() if until <= now]:
            del self._held[note]
            out.append([0x80, note, 0])
        return [(now, message) for message in out]

    def _typed(self, character: str, now: float) -> list[list[int]]:
        note = self.base + KEYS.get(character.lower(), -1000)
        if 0 <= note < 128:
            repeated = self._held.get(note, 0.0) - HELD > now - 0.1
            self._held[note] = now + HELD
            return [] if repeated else [[0x90, note, self.velocity]]
        if character == _ESC:
            self.ended = True
        elif character == " ":
            self._held.clear()
            return [[0xB0, 120, 0]]
        elif character in "[]":
            self.base = min(max(self.base + (_STEP if character == "]" else -_STEP), 0), 108)
        elif character in "-=":
            self.velocity = min(max(self.velocity + (10 if character == "=" else -10), 10), 127)
        return []

    def close(self) -> None:
        """Give the terminal back."""
        if self._terminal is not None:
            self._terminal.close()


class _Terminal:
    """Standard input, character by character and without echo."""

    def __init__(self) -> None:
        try:
            import termios
            import tty
        except ImportError:
            raise TonewoodError("the computer's keys are read from a POSIX terminal only", key="--keyboard") from None
        if not sys.stdin.isatty():
            raise TonewoodError("standard input is no terminal; it must be one to be played on", key="--keyboard")
        self._fd = sys.stdin.fileno()
        self._before: Any = termios.tcgetattr(self._fd)
        tty.setcbreak(self._fd)

    def read(self) -> str:
        """Characters typed since the last time; Esc where the terminal has gone."""
        if not select.select([self._fd], [], [], 0.0)[0]:
            return ""
        try:
            return os.read(self._fd, 64).decode("utf-8", "replace") or _ESC
        except OSError:
            return _ESC

    def close(self) -> None:
        """Restore how the terminal was, if it is still there."""
        import termios

        with suppress(termios.error):
            termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)
