"""Signals that end the program: Ctrl-C, SIGTERM and SIGHUP, from its first line to its last.

Before a command begins and after it has ended there is nothing to save: a signal ends the program at once. In between
it raises a KeyboardInterrupt, so that files begun are removed and takes are saved; another one a second later ends the
program at once. Imports nothing that takes time.
"""

from __future__ import annotations

import os
import signal
import sys
import time

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType
    from typing import Any

#: name of the signal -> how the program's last line begins
_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
#: s, from a signal on in which others are ignored: one that interrupts cleaning up would leave files
_GRACE = 1.0
#: s, after which an exception that got lost in a callback of the interpreter is raised again
_AGAIN = 0.01


class SignalHandling:
    """State of one process.

    installed : whether signals are handled here.
    signal : the last one while a command ran, 0 before.
    """

    def __init__(self) -> None:
        self.installed, self.signal = False, 0
        #: time of the signal; 0 before one, negative while there is nothing to save
        self._since, self._line, self._code = -1.0, True, 0

    def begin(self) -> None:
        """Handle signals, but for those that were ignored before, as in background jobs of a shell."""
        self.installed = True
        for name in _WORDS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, self._take)
        sys.unraisablehook = self._lost

    def command_begins(self) -> None:
        """Raise an exception from now on."""
        self._since = 0.0

    def command_ends(self, code: int) -> None:
        """End the program at once and without a word from now on, with its own exit code."""
        self._since, self._line, self._code = -1.0, False, code

    @property
    def word(self) -> str:
        """How the line about the signal begins."""
        return _WORDS[signal.Signals(self.signal).name] if self.signal else _WORDS["SIGINT"]

    @property
    def code(self) -> int:
        """Exit code as shells have it."""
        return 128 + (self.signal or signal.SIGINT)

    def _take(self, number: int, _: FrameType | None) -> None:
        now = time.monotonic()
        if self._since > 0.0 and now - self._since < _GRACE:
            return
        self.signal = number
        if self._since != 0.0:
            self._end()
        self._since = now
        raise KeyboardInterrupt

    def _end(self) -> None:
        if self._line:
            reason = f"{self.word}; nothing was written" if self._since < 0.0 else self.word
            if "--json" in sys.argv:
                error = (
                    '{"kind": "Interrupted", "file": null, "line": null, "key": null, "reason": "%s", "exit_code": %d}'
                )
                line = '{"schema": "tonewood-error/1", "ok": false, "error": %s}\n' % (error % (reason, self.code))
                _write(1, line)
            _write(2, f"tonewood: {reason}\n")
            self._code = self.code
        os._exit(self._code)

    def _lost(self, unraisable: Any) -> None:
        """Raise an exception again that got lost: none can leave a callback of the interpreter."""
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)
            return
        from threading import Timer

        self._since = 0.0
        again = Timer(_AGAIN, os.kill, (os.getpid(), self.signal or signal.SIGINT))
        again.daemon = True
        again.start()


def _write(descriptor: int, line: str) -> None:
    try:
        os.write(descriptor, line.encode())
    except OSError:  # closed, full or gone
        return


stopping = SignalHandling()
