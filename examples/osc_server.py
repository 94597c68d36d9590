"""An instrument that listens to OSC messages, for installations and games: pip install python-osc "tonewood[play]".

python examples/osc_server.py [INSTRUMENT] [--port 9000] [--host 127.0.0.1] [--device NAME]

/note_on note velocity [channel]    /note_off note [channel]    /bend cents [channel]    /control number value [channel]
/all_off

Notes are MIDI numbers or names, velocities 1 to 127 (0 is a note_off), controllers 0 to 1. Messages that cannot be
followed are printed in one line and counted; nothing stops the sound. A phone reaches it with --host 0.0.0.0, and then
anybody in the network does. To try it, in another Python:

from pythonosc.udp_client import SimpleUDPClient
SimpleUDPClient("127.0.0.1", 9000).send_message("/note_on", ["E2", 90])
"""

from __future__ import annotations

import argparse
import inspect
import sys
import threading
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
            "/note_on": self._note_on,
            "/note_off": lambda note, channel=0: live.note_off(note, channel),
            "/bend": lambda cents, channel=None: live.bend(float(cents), channel),
            "/control": lambda number, value, channel=0: live.control(number, value, channel),
            "/all_off": lambda: live.all_off(),
        }

    def receive(self, address: str, *arguments: Any) -> None:
        """Take one message."""
        self.stream.send(self._play, address, arguments)

    def _note_on(self, note: float | str, velocity: float = 90, channel: int = 0) -> None:
        if velocity == 0:
            self.live.note_off(note, channel)
        else:
            self.live.note_on(note, velocity, channel=channel)

    def _play(self, address: str, arguments: tuple[Any, ...]) -> None:
        try:
            if address not in self.calls:
                raise TonewoodError(f"no address {address}; there are {', '.join(self.calls)}")
            call = self.calls[address]
            try:
                inspect.signature(call).bind(*arguments)
            except TypeError:
                raise TonewoodError(f"{address} takes {', '.join(inspect.signature(call).parameters)}") from None
            call(*arguments)
        except (TypeError, ValueError, TonewoodError) as fault:
            self.refused[str(fault)] += 1
            print(f"{address} {arguments}: {fault}", file=sys.stderr)


def main() -> int:
    """Serve until Ctrl-C; returns the exit code."""
    from pythonosc.dispatcher import Dispatcher
    from pythonosc.osc_server import ThreadingOSCUDPServer

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("instrument", nargs="?", default="classical_guitar")
    parser.add_argument("--port", type=int, default=9000)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--device", help="sound device, as sounddevice names it")
    given = parser.parse_args()
    dispatcher, code = Dispatcher(), 0
    try:
        live = tw.Live(given.instrument, gain_db=12.0)
        stream = tw.AudioStream(live, block_size=128, ahead=4)
        instrument = OscInstrument(live, stream)
        dispatcher.set_default_handler(instrument.receive)
        server = ThreadingOSCUDPServer((given.host, given.port), dispatcher)
    except (TonewoodError, OSError) as fault:
        print(fault, file=sys.stderr)
        return 2
    threading.Thread(target=server.serve_forever, daemon=True).start()
    print(f"{given.instrument} listens on {given.host}, port {given.port}; Ctrl-C ends", flush=True)
    try:
        stream.play(given.device, low_latency=True)
    except KeyboardInterrupt:
        pass
    except TonewoodError as fault:
        print(fault, file=sys.stderr)
        code = 2
    server.shutdown()
    summary = live.summary()
    print(f"{summary.notes} notes, {stream.underruns} underruns; peak {summary.peak_dbfs:.1f} dBFS")
    for reason, count in [*summary.dropped.items(), *instrument.refused.items()]:
        print(f"  {count} not followed: {reason}")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
