"""Turn live MIDI messages into calls of `Live`.

`performance.score.channels` knows the ranges of bends and the zones of MPE.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from tonewood.errors import ScoreError
from tonewood.performance.score.channels import STEERING, MidiChannels
from tonewood.sound.live.instrument import BEND_LIMIT, Live

#: channel that General MIDI gives to percussion, from 1
PERCUSSION = 10
#: status byte -> bytes that follow it
_LENGTHS = {0x80: 2, 0x90: 2, 0xA0: 2, 0xB0: 2, 0xC0: 1, 0xD0: 1, 0xE0: 2}


def channel_message(message: Sequence[int]) -> bytes | None:
    """Return a channel message without bytes after its end; None where it is another kind, incomplete or damaged."""
    status = message[0] if message else 0
    length = _LENGTHS.get(status & 0xF0) if 0x80 <= status < 0xF0 else None
    if length is None or len(message) <= length or not all(0 <= byte <= 127 for byte in message[1 : length + 1]):
        return None
    return bytes(message[: length + 1])


class MidiReceiver:
    """Plays MIDI messages on an instrument.

    live : the instrument.
    channels : from 1, of which notes are played; all where left out, but channel 10 (percussion), unless a zone of MPE
        has it.
    ignored : kind of message -> number of them without effect, besides those that `live` counts.
    messages : number of all.
    """

    def __init__(self, live: Live, channels: Collection[int] | None = None):
        self.live, self.channels = live, channels
        self.ignored: Counter[str] = Counter()
        self.messages = 0
        self._channels = MidiChannels()

    @property
    def zones(self) -> dict[int, list[int]]:
        """Master channel -> member channels, counted from 0."""
        return self._channels.zones

    def receive(self, message: Sequence[int]) -> None:
        """Take one message, as its bytes. Messages that are incomplete or of no use here are counted in `ignored`."""
        self.messages += 1
        if message and message[0] & 0xF0 == 0xF0:
            self.ignored["system exclusive" if message[0] == 0xF0 else "system message"] += 1
            return
        whole = channel_message(message)
        if whole is None:
            self.ignored["damaged message"] += 1
            return
        kind, number = whole[0] & 0xF0, whole[0] & 0x0F
        a, b = whole[1], whole[2] if len(whole) == 3 else 0
        if kind in (0x80, 0x90) and not self._is_played(number):
            if kind == 0x90 and b:
                self.ignored[f"note of channel {number + 1}, left out (--tracks {number + 1} plays it)"] += 1
        elif kind == 0x90 and b:
            self._note_on(number, a, b)
        elif kind in (0x80, 0x90):
            if not self.live.note_off(a, number):
                self.ignored["note-off without a note"] += 1
        elif kind == 0xA0:
            for at in self._chosen([number]):
                self.live.pressure(b / 127, at, note=a)
        elif kind == 0xB0 and a < 120:
            self._controller(number, a, b)
        elif kind == 0xB0:
            self._mode(number, a)
        elif kind == 0xC0:
            self.ignored["program change"] += 1
        elif kind == 0xD0:
            for at in self._chosen(self._channels.reached(number)):
                self.live.pressure(a / 127, at)
        else:
            self._channels.wheel(number, a, b)
            self._bend()

    def _is_played(self, number: int) -> bool:
        if self.channels is not None:
            return bool(self._chosen([number]))
        return number + 1 != PERCUSSION or self._channels.is_member(number)

    def _chosen(self, numbers: Sequence[int]) -> Sequence[int]:
        """Channels that were chosen, by themselves or with the master of their zone; pedals of others move nothing."""
        if self.channels is None:
            return numbers
        return [at for at in numbers if any(of + 1 in self.channels for of in (at, *self._masters(at)))]

    def _masters(self, number: int) -> list[int]:
        """Master of the zone of MPE of which a channel is a member."""
        return [master for master, members in self.zones.items() if number in members]

    def _note_on(self, number: int, key: int, velocity: int) -> None:
        try:
            self.live.note_on(key, velocity, channel=number)
        except ScoreError as fault:
            self.ignored[fault.reason] += 1

    def _bend(self) -> None:
        for at, cents in self._channels.bends():
            if abs(cents) > BEND_LIMIT:
                self.ignored[f"bend beyond {BEND_LIMIT:g} cents, held there"] += 1
            self.live.bend(min(max(cents, -BEND_LIMIT), BEND_LIMIT), at)

    def _controller(self, number: int, a: int, b: int) -> None:
        if a not in STEERING:
            for at in self._chosen(self._channels.reached(number)):
                self.live.control(a, b / 127, at)
        elif kind := self._channels.steer(number, a, b):
            self.ignored[kind] += 1
        self._bend()

    def _mode(self, number: int, a: int) -> None:
        for at in self._channels.reached(number):
            if a == 120:
                self.live.release_keys(at, pedalled=True)
            elif a == 121:
                self._channels.reset(at)
                for controller, value in ((1, 0.0), (11, 1.0), (64, 0.0)):
                    if (at, f"cc{controller}") in self.live.player.controls:
                        self.live.control(controller, value, at)
            elif a >= 123:
                self.live.release_keys(at)
            else:
                self.ignored["local control"] += 1
        self._bend()
