"""MIDI messages to calls of `Live`: channels, bend ranges, pedals, and the zones of MPE.

MPE (MIDI Polyphonic Expression, MMA M1-100-UM, 2018): registered parameter 6 on channel 1 with n gives channels 2 to
n + 1 to the lower zone, on channel 16 channels 15 down to 16 - n to the upper one. In a zone every note has a channel
of its own; bends and controllers of the master channel (1 or 16) hold for all notes of the zone, and its bend is added
to theirs. A zone sets the range of the bend to 48 semitones on member channels and 2 on the master.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from tonewood.errors import ScoreError
from tonewood.sound.live.instrument import Live

_NO_PARAMETER = (127, 127)
_BEND_RANGE, _ZONE = (0, 0), (0, 6)
#: controllers that steer other messages: bank select, data entry, parameter numbers
_STEERING = {0, 6, 32, 38, 96, 97, 98, 99, 100, 101}
#: status byte -> bytes that follow it
_LENGTHS = {0x80: 2, 0x90: 2, 0xA0: 2, 0xB0: 2, 0xC0: 1, 0xD0: 1, 0xE0: 2}


@dataclass(eq=False)
class _Channel:
    """State of one channel."""

    parameter: tuple[int, int] = _NO_PARAMETER
    bend_range: float = 2.0
    bend: int = 0

    @property
    def cents(self) -> float:
        return self.bend / 8192 * self.bend_range * 100


class MidiReceiver:
    """Plays MIDI messages on an instrument.

    Parameters
    ----------
    live : the instrument.

    Attributes
    ----------
    ignored : kind of message -> number of them without effect, besides those that `live` counts.
    messages : number of all.
    """

    def __init__(self, live: Live):
        self.live = live
        self.ignored: Counter[str] = Counter()
        self.messages = 0
        self._channels = [_Channel() for _ in range(16)]
        #: member channel -> master channel
        self._master: dict[int, int] = {}

    @property
    def zones(self) -> dict[int, list[int]]:
        """Master channel -> member channels, counted from 0."""
        return {m: sorted(c for c, master in self._master.items() if master == m) for m in self._master.values()}

    def receive(self, message: Sequence[int]) -> None:
        """Take one message, as its bytes. Messages that are incomplete or of no use here are counted in `ignored`."""
        self.messages += 1
        status = message[0] if message else 0
        kind, number = status & 0xF0, status & 0x0F
        if kind == 0xF0:
            self.ignored["system exclusive" if status == 0xF0 else "system message"] += 1
            return
        length = _LENGTHS.get(kind)
        if length is None or len(message) <= length or max(message[1 : length + 1]) > 127:
            self.ignored["damaged message"] += 1
            return
        a, b = message[1], message[2] if length == 2 else 0
        if kind == 0x90 and b:
            self._note_on(number, a, b)
        elif kind in (0x80, 0x90):
            if not self.live.note_off(a, number):
                self.ignored["note-off without a note"] += 1
        elif kind == 0xA0:
            self.live.pressure(b / 127, number, note=a)
        elif kind == 0xB0 and a < 120:
            self._controller(number, a, b)
        elif kind == 0xB0:
            self._mode(number, a)
        elif kind == 0xC0:
            self.ignored["program change"] += 1
        elif kind == 0xD0:
            self.live.pressure(a / 127, number)
        else:
            self._channels[number].bend = (b << 7 | a) - 8192
            self._bend(number)

    def _note_on(self, number: int, key: int, velocity: int) -> None:
        try:
            self.live.note_on(key, velocity, channel=number)
        except ScoreError as fault:
            self.ignored[fault.reason] += 1

    def _reached(self, number: int) -> list[int]:
        """Channels for which a message on a channel holds: with a master, those of its zone."""
        return [number, *(c for c, master in self._master.items() if master == number)]

    def _bend(self, number: int) -> None:
        for at in self._reached(number):
            master = self._master.get(at)
            own = self._channels[at].cents
            self.live.bend(own + (0.0 if master is None else self._channels[master].cents), at)

    def _controller(self, number: int, a: int, b: int) -> None:
        channel = self._channels[number]
        if a in (98, 99):  # a non-registered parameter: data entry is ignored until a registered one is chosen
            channel.parameter = _NO_PARAMETER
        elif a in (100, 101):
            high, low = channel.parameter
            channel.parameter = (high, b) if a == 100 else (b, low)
        elif a in (6, 38):
            self._data_entry(number, a, b)
        elif a in _STEERING:
            self.ignored["bank select" if a in (0, 32) else "data increment or decrement"] += 1
        if a not in _STEERING:
            for at in self._reached(number):
                self.live.control(a, b / 127, at)

    def _data_entry(self, number: int, a: int, b: int) -> None:
        channel = self._channels[number]
        if channel.parameter == _BEND_RANGE:
            channel.bend_range = float(b) if a == 6 else int(channel.bend_range) + b / 100
            members = [c for c, master in self._master.items() if master == self._master.get(number)]
            for at in members if number in self._master else ():
                self._channels[at].bend_range = channel.bend_range
            self._bend(number)
        elif channel.parameter == _ZONE and a == 6 and number in (0, 15):
            self._zone(number, b)
        else:
            self.ignored["data entry of a parameter that is not read"] += 1

    def _zone(self, master: int, n: int) -> None:
        """Give a zone n member channels; where they overlap, the other zone loses them, or ends with its master."""
        members = range(1, min(n, 15) + 1) if master == 0 else range(15 - min(n, 15), 15)
        ended = {master, *members}
        self._master = {c: m for c, m in self._master.items() if m not in ended}
        for at in members:
            self._master[at] = master
            self._channels[at].bend_range = 48.0
        self._channels[master].bend_range = 2.0

    def _mode(self, number: int, a: int) -> None:
        for at in self._reached(number):
            if a == 120:
                self.live.all_off(at)
            elif a == 121:
                channel = self._channels[at]
                channel.parameter, channel.bend = _NO_PARAMETER, 0
                self.live.bend(0.0, at)
                for controller, value in ((1, 0.0), (11, 1.0), (64, 0.0)):
                    self.live.control(controller, value, at)
            elif a >= 123:
                self.live.release_keys(at)
            else:
                self.ignored["local control"] += 1
