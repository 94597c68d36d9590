"""An instrument that listens to OSC messages, for installations and games; needs python-osc and sounddevice.

python examples/osc_server.py [INSTRUMENT] [PORT]

/note_on note velocity [channel]    /note_off note [channel]    /bend cents [channel]    /control number value [channel]
/all_off

Notes are MIDI numbers or names, velocities 1 to 127, controllers 0 to 1. Messages that cannot be followed are printed
in one line and counted; nothing stops the sound.
"""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import tonewood as tw
from tonewood.errors import TonewoodError


class OscInstrument:
    """Takes messages in the server's thread and leaves them to the thread that computes.

    Parameters
    ----------
    live : the instrument.
    stream : that plays it.
    """

    def __init__(self, live: tw.Live, stream: tw.AudioStream):
        self.live, self.stream = live, stream
        self.refused: Counter[str] = Counter()
        self.calls = {
            "/note_on": lambda note, velocity=90, channel=0: live.note_on(note, velocity, channel=channel),
            "/note_off": lambda note, channel=0: live.note_off(note, channel),
            "/bend": lambda cents, channel=None: live.bend(cents, channel),
            "/control": lambda number, value, channel=0: live.control(number, value, channel),
            "/all_off": lambda: live.all_off(),
        }

    def receive(self, address: str, *arguments: Any) -> None:
        """Take one message."""
        self.stream.send(self._play, address, arguments)

    def _play(self, address: str, arguments: tuple[Any, ...]) -> None:
        try:
            self.calls[address](*arguments)
        except (KeyError, TypeError, ValueError, TonewoodError) as fault:
            reason = f"no address {address}" if isinstance(fault, KeyError) else str(fault)
            self.refused[reason] += 1
            print(f"{address} {arguments}: {reason}", file=sys.stderr)


def main() -> None:
    """Serve until Ctrl-C."""
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import ThreadingOSCUDPServer

    live = tw.Live(sys.argv[1] if len(sys.argv) > 1 else "classical_guitar", gain_db=12.0)
    stream = tw.AudioStream(live, block_size=128, ahead=4)
    instrument, dispatcher = OscInstrument(live, stream), Dispatcher()
    dispatcher.set_default_handler(instrument.receive)
    server = ThreadingOSCUDPServer(("127.0.0.1", int(sys.argv[2]) if len(sys.argv) > 2 else 9000), dispatcher)
    print(f"listening on {server.server_address}")
    import threading

    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        stream.play(low_latency=True)
    except (KeyboardInterrupt, TonewoodError) as end:
        print(str(end) or "ended")
    server.shutdown()
    print(live.summary())


if __name__ == "__main__":
    main()
