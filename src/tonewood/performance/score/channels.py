"""Channels of MIDI as messages configure them: registered parameters, ranges of bends, and the zones of MPE.

MPE (MIDI Polyphonic Expression, MMA M1-100-UM, 2018): registered parameter 6 on channel 1 with n gives channels 2 to
n + 1 to the lower zone, on channel 16 channels 15 down to 16 - n to the upper one. In a zone every note has a channel
of its own; bends and controllers of the master channel (1 or 16) hold for all notes of the zone, and its bend is added
to theirs. A zone sets the range of the bend to 48 semitones on member channels and 2 on the master.
"""

from __future__ import annotations

from dataclasses import dataclass

_NO_PARAMETER = (127, 127)
_BEND_RANGE, _ZONE = (0, 0), (0, 6)
_TUNINGS = ((0, 1), (0, 2))
#: controllers that steer other messages: bank select, data entry, parameter numbers
STEERING = frozenset({0, 6, 32, 38, 96, 97, 98, 99, 100, 101})
_WITHOUT_EFFECT = {0: "bank select", 32: "bank select", 96: "data increment", 97: "data decrement"}
#: kinds of data entry that have no effect
TUNING, UNREAD = "channel tuning", "data entry of a parameter that is not read"
TOO_LARGE = "zone of MPE of more than 15 channels"


@dataclass
class _Channel:
    """Registered parameter (high, low) that data entry sets, range of the bend in semitones, and the wheel."""

    parameter: tuple[int, int] = _NO_PARAMETER
    bend_range: float = 2.0
    wheel: int = 0

    @property
    def cents(self) -> float:
        return self.wheel / 8192 * self.bend_range * 100


class MidiChannels:
    """State of the sixteen channels, counted from 0, by which notes and controllers are understood."""

    def __init__(self) -> None:
        self._channels = [_Channel() for _ in range(16)]
        #: member channel -> master channel
        self._master: dict[int, int] = {}
        self._changed: set[int] = set()

    @property
    def zones(self) -> dict[int, list[int]]:
        """Master channel -> member channels."""
        return {m: sorted(c for c, master in self._master.items() if master == m) for m in self._master.values()}

    def is_member(self, number: int) -> bool:
        """Whether a channel is a member of a zone: each of its notes has a channel of its own."""
        return number in self._master

    def reached(self, number: int) -> list[int]:
        """Channels for which a message on a channel holds: with a master, those of its zone."""
        return [number, *(c for c, master in self._master.items() if master == number)]

    def cents(self, number: int) -> float:
        """Bend of a channel, with that of its master."""
        master = self._master.get(number)
        return self._channels[number].cents + (0.0 if master is None else self._channels[master].cents)

    def bends(self) -> list[tuple[int, float]]:
        """Channels whose bend messages may have changed since this was asked last, with `cents`."""
        changed, self._changed = self._changed, set()
        return [(number, self.cents(number)) for number in sorted(changed)]

    def wheel(self, number: int, a: int, b: int) -> None:
        """Take the two data bytes of a pitch wheel."""
        self._channels[number].wheel = (b << 7 | a) - 8192
        self._changed.update(self.reached(number))

    def steer(self, number: int, a: int, b: int) -> str:
        """Take a controller of `STEERING`. Returns The kind of message where it has no effect, else an empty text."""
        channel = self._channels[number]
        if a in (98, 99):  # a non-registered parameter: data entry is ignored until a registered one is chosen
            channel.parameter = _NO_PARAMETER
        elif a in (100, 101):
            high, low = channel.parameter
            channel.parameter = (high, b) if a == 100 else (b, low)
        elif a in (6, 38):
            return self._data_entry(number, a, b)
        return _WITHOUT_EFFECT.get(a, "")

    def reset(self, number: int) -> None:
        """Reset a channel's controllers (RP-015): neither the range of its bend nor its zone."""
        self._channels[number].parameter, self._channels[number].wheel = _NO_PARAMETER, 0
        self._changed.update(self.reached(number))

    def _data_entry(self, number: int, a: int, b: int) -> str:
        channel = self._channels[number]
        if channel.parameter == _BEND_RANGE:
            bend_range = float(b) if a == 6 else int(channel.bend_range) + b / 100
            master = self._master.get(number)
            zone = [number] if master is None else self.reached(master)[1:]
            for at in zone:
                self._channels[at].bend_range = bend_range
            self._changed.update(self.reached(number) if master is None else zone)
        elif channel.parameter == _ZONE and number in (0, 15):
            if a == 6 and b > 15:
                return TOO_LARGE
            if a == 6:
                self._zone(number, b)
        else:
            return TUNING if channel.parameter in _TUNINGS else UNREAD
        return ""

    def _zone(self, master: int, n: int) -> None:
        """Give a zone n member channels; where they overlap, the other zone loses them, or ends with its master."""
        self._changed.update(range(16))
        members = range(1, n + 1) if master == 0 else range(15 - n, 15)
        ended = {master, *members}
        self._master = {c: m for c, m in self._master.items() if c not in ended and m not in ended}
        for at in members:
            self._master[at] = master
            self._channels[at].bend_range = 48.0
        self._channels[master].bend_range = 2.0
