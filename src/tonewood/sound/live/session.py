"""A session: sources of events, an instrument played live, a sound card, a meter and a take."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Collection, Sequence
from operator import itemgetter
from typing import Any

from tonewood.sound.live.instrument import Live
from tonewood.sound.live.ports import EventSource
from tonewood.sound.live.receiver import MidiReceiver
from tonewood.sound.live.stream import Arrivals, AudioStream, Playback
from tonewood.sound.live.take import Take

#: s, after which a thread of Python gives way to another: the card's callback must not wait for the computing thread
_SWITCH = 5e-4


class LiveSession:
    """Plays an instrument from sources of MIDI messages on a sound card.

    All sources are asked before every block, so that every message reaches the next block that is computed. Messages
    that came before there was sound keep their distances (`Arrivals`).

    live : the instrument.
    sources : of messages.
    block_size, ahead : as for `AudioStream`.
    take : records the messages, where given.
    channels : as for `MidiReceiver`.
    receiver, stream : as they were made.
    """

    def __init__(
        self,
        live: Live,
        sources: Sequence[EventSource],
        *,
        block_size: int = 128,
        ahead: int = 4,
        take: Take | None = None,
        channels: Collection[int] | None = None,
    ):
        self.live, self.sources, self.take = live, sources, take
        self.receiver = MidiReceiver(live, channels)
        self._arrivals = Arrivals[Sequence[int]](live.fs, block_size)
        self.stream = AudioStream(live, block_size, ahead=ahead, before=self._poll)

    def _poll(self) -> None:
        frame = self.live.frames
        self._ask()
        for message in self._arrivals.due(frame):
            if self.take is not None:
                self.take.add(frame, message)
            self.receiver.receive(message)

    def _ask(self) -> None:
        come = [arrival for source in self.sources for arrival in source.poll()]
        for time, message in sorted(come, key=itemgetter(0)):
            self._arrivals.add(time, message)

    def _end(self) -> None:
        """Put messages for which there was no block any more into the take, at its end."""
        self._ask()
        for message in self._arrivals.rest():
            self.receiver.ignored["message after the last block"] += 1
            if self.take is not None:
                self.take.add(self.live.frames, message)

    @property
    def latency(self) -> dict[str, float]:
        """Parts of the time from a message to its sound, s: pluck and grid, blocks, device."""
        parts = {"pluck": self.live.ramp, "grid": self.live.latency - self.live.ramp, "blocks": self.stream.latency}
        return parts | {"device": self.stream.device_latency}

    def status(self) -> str:
        """One line for a meter: load of the last blocks, underruns, notes that sound, and events lost."""
        loads = self.stream.loads.copy() or (0.0,)
        player = self.live.player
        text = f"load {100 * sum(loads) / len(loads):3.0f} %, worst {100 * max(loads):3.0f} %"
        text += f" | {self.stream.underruns} underruns | {player.n_sounding} sounding"
        lost = sum(player.counters.dropped.values())
        if lost:
            text += f" | {lost} not played, last: {player.counters.latest[-1].reason}"
        return text

    def run(self, device: Any = None, stream: Any = None, wait: Callable[[], bool] | None = None) -> Playback:
        """Play until `wait` returns False or Ctrl-C; parameters as of `AudioStream.play`."""
        interval = sys.getswitchinterval()
        try:
            gc.collect()
            gc.disable()  # playing makes no cycles, and a collection takes as long as a block or two
            sys.setswitchinterval(_SWITCH)
            return self.stream.play(device, stream, wait, low_latency=True)
        except KeyboardInterrupt:
            return self.stream.playback()
        finally:
            sys.setswitchinterval(interval)
            gc.enable()
            self._end()
            for source in self.sources:
                source.close()
