"""The sound of the desk: a phrase and keys, in blocks; takes are exchanged with a crossfade, A and B without a gap."""

from __future__ import annotations

import secrets
import threading
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tonewood.sound.live.instrument import Live
from tonewood.workshop.desk.take import PhraseTake

Singles = NDArray[np.float32]

#: s of a crossfade; s of sound on its way to the page that are never taken back
FADE, MARGIN = 0.03, 0.04
#: s after a report of the page for which it is taken to hear on
_TRUSTED = 0.5
#: s of the keys' sound that may be sent again
_KEYED = 2
_WHOLE = 1 << 30


@dataclass(eq=False)
class _Fading:
    """A sound that is taken out."""

    source: PhraseTake | Live
    at: int
    gain: float
    done: int = 0


@dataclass(eq=False)
class ComparedTakes:
    """Two takes of one loudness.

    takes, gains : A and B; the louder one is turned down.
    which : 0 or 1, what is heard.
    blind : whether the page calls them X and Y; `order` is that of X and Y.
    """

    takes: tuple[PhraseTake, PhraseTake]
    gains: tuple[float, float]
    names: tuple[str, str]
    which: int = 0
    blind: bool = False
    order: tuple[int, int] = (0, 1)

    @classmethod
    def of_one_loudness(
        cls, takes: tuple[PhraseTake, PhraseTake], names: tuple[str, str], *, blind: bool
    ) -> tuple[ComparedTakes, float]:
        """Return two takes, the louder one turned down, and by how many LU the first was louder."""
        louder = takes[0].loudness() - takes[1].loudness()
        gains = (10 ** (-max(louder, 0.0) / 20), 10 ** (min(louder, 0.0) / 20))
        order = (0, 1) if not blind or secrets.randbelow(2) else (1, 0)
        return cls(takes, gains, names, blind=blind, order=order), louder

    def state(self) -> dict[str, Any]:
        """Return the names in the order of the page, and which of them is heard."""
        names = ["X", "Y"] if self.blind else [f"{'AB'[i]}: {self.names[i]}" for i in self.order]
        return {"names": names, "which": self.order.index(self.which), "blind": self.blind}


@dataclass(eq=False)
class Meter:
    """What blocks cost: share of their time, smoothed; the worst of late; underruns that the page counted."""

    load: float = 0.0
    worst: float = 0.0
    underruns: int = 0


class PageProgress:
    """Where the page of the stream is: places are frames since its beginning.

    patience : s until its first report.
    sent : place of the next block.
    reported : time of the last report.
    """

    def __init__(self, fs: int, patience: float):
        self._fs, self.sent, self._heard = fs, 0, 0
        self.reported = time.monotonic() + patience

    def report(self, heard: int) -> None:
        """Take the page's word on the place that it hears."""
        self._heard, self.reported = heard, time.monotonic()

    @property
    def unheard(self) -> int:
        """Frames that were sent and are not heard yet."""
        since = min(max(time.monotonic() - self.reported, 0.0), _TRUSTED)
        return max(self.sent - self._heard - int(since * self._fs), 0) if self.sent else 0


class DeskSound:
    """All that sounds.

    A change is heard before sound that has been sent already: frames that the page has not heard are sent again, from
    an earlier place on, and take the place of those before (`PageProgress`).

    take, at : that is heard, and its next frame; None until the first model is made.
    serial : counts changes that are heard; the page measures the time to them.
    """

    def __init__(self, fs: int):
        self.fs, self.lock = fs, threading.RLock()
        self.take: PhraseTake | None = None
        self.at, self.playing, self.loop, self.serial = 0, False, True, 0
        self.pair: ComparedTakes | None = None
        self.live: Live | None = None
        self.meter = Meter()
        #: page that hears the stream
        self.listener: PageProgress | None = None
        #: place before which nothing is sent again: no fade is cut
        self._firm = 0
        #: what keys sounded of late, and of that what is sent again
        self._keyed, self._keyed_again = _none(), 0
        self._fading: list[_Fading] = []
        #: frames of B that were faded in after A; from the beginning of a phrase nothing is
        self._fade_in = _WHOLE
        #: take that goes on from a frame of this one, and serial of its change
        self._joins: tuple[PhraseTake, int, int] | None = None

    def listen(self, patience: float) -> PageProgress:
        """Begin a stream; returns the place of its page."""
        with self.lock:
            self.listener, self._firm = PageProgress(self.fs, patience), 0
            return self.listener

    def swap(self, take: PhraseTake, *, goes_on: bool = False, serial: int | None = None) -> None:
        """Let another take be heard, as soon as the page can.

        goes_on : at the same place of the phrase, faded in, as far as it is rendered; else from the beginning.
        serial : of the change that is heard with it.
        """
        with self.lock:
            self._end()
            self.take, self.pair = take, None
            self.at = min(self.at, take.frames) if goes_on else 0
            self._joins, self._fade_in = None, 0 if self.at else _WHOLE
            self.serial = self.serial if serial is None else serial

    @property
    def unheard(self) -> int:
        """Frames that can be taken back: the page has not heard them, and they are of one pass of the phrase."""
        if self.listener is None:
            return 0
        free = min(self.listener.unheard - round(MARGIN * self.fs), self.listener.sent - self._firm)
        return max(min(free, self.at), 0) if self.playing else max(free, 0)

    def _take_back(self, frames: int) -> None:
        """Send so many frames again; those before are dropped by the page."""
        if self.listener is not None and frames > 0:
            self.listener.sent -= frames
            self._keyed_again += frames
            if self.playing:
                self.at -= frames

    def compare(self, pair: ComparedTakes | None) -> None:
        """Let two takes be switched, at the same frame of both; None ends that."""
        with self.lock:
            if self.playing and (self.pair is not None or pair is not None):
                self._end()
                self._fade_in = 0
            self.pair = pair

    def switch(self, which: int) -> None:
        """Let A (0) or B (1) be heard, without a gap."""
        with self.lock:
            if self.pair is not None and which != self.pair.which and which in (0, 1):
                self._end()
                self.pair.which = which
                self._fade_in = 0

    def pick(self, which: int) -> None:
        """Let the first (0) or second (1) of a comparison be heard, in the order of the page."""
        with self.lock:
            if self.pair is not None and which in (0, 1):
                self.switch(self.pair.order[which])

    def reveal(self) -> None:
        """End the blindness of a comparison."""
        with self.lock:
            if self.pair is not None:
                self.pair.blind = False

    def _fade_out(self, source: PhraseTake | Live, at: int, gain: float) -> None:
        self._fading = [*self._fading[-3:], _Fading(source, at, gain)]
        if self.listener is not None:
            self._firm = self.listener.sent + round(FADE * self.fs)

    def fork(self, take: PhraseTake, at: int, serial: int) -> None:
        """Let a take go on that another one was up to a frame: exactly there, without a fade.

        take, at : and its first frame, no earlier than `unheard` frames ago.
        """
        with self.lock:
            self._take_back(self.at - at)
            self._joins = (take, at, serial)

    def start(self, *, again: bool = True) -> None:
        """Play the phrase, from its beginning."""
        with self.lock:
            if again:
                self._end()
                self._begin_again()
            self.playing = self.take is not None

    def stop(self) -> None:
        """Fade out all that sounds."""
        with self.lock:
            self._end()
            self.playing = False
            self.release_keys()

    def _end(self) -> None:
        """Fade out the phrase, as soon as the page can."""
        self._take_back(self.unheard)
        if self.playing and self.take is not None:
            heard, gain = self._heard()
            self._fade_out(heard, self.at, gain)

    def exchange_live(self, live: Live | None) -> None:
        """Let keys play another model; what rings of the one before fades."""
        with self.lock:
            if self.live is not None:
                self._fade_out(self.live, 0, 1.0)
            self.live, self._keyed, self._keyed_again = live, _none(), 0

    def release_keys(self) -> None:
        """Release all keys."""
        with self.lock:
            if self.live is not None:
                self.live.all_off()

    def _heard(self) -> tuple[PhraseTake, float]:
        assert self.take is not None
        if self.pair is None:
            return self.take, 1.0
        return self.pair.takes[self.pair.which], self.pair.gains[self.pair.which]

    def read(self, frames: int) -> tuple[Singles, dict[str, Any]]:
        """Return the next (frames, 2) and what they are: serial, frame of the phrase and place of the stream."""
        began = time.perf_counter()
        with self.lock:
            out = np.zeros((frames, 2), dtype=np.float32)
            first, serial = self.at, self.serial
            if self.playing and self.take is not None:
                self._phrase(out)
                serial = self.serial
            if self.live is not None:
                out += self._keys(frames, self.live)
            for fading in self._fading:
                self._faded(fading, out)
            self._fading = [f for f in self._fading if f.done < FADE * self.fs]
            position = 0
            if self.listener is not None:
                position = self.listener.sent
                self.listener.sent += frames
        share = (time.perf_counter() - began) / (frames / self.fs)
        self.meter.load += 0.05 * (share - self.meter.load)
        self.meter.worst = max(0.99 * self.meter.worst, share)
        return out, {"serial": serial, "frame": first, "playing": self.playing, "place": position}

    def moments(self, since: int) -> dict[str, Any]:
        """Return what rings: moments of energy after frame `since` of the phrase, effects that run, load."""
        with self.lock:
            take, at = self.take, self.at
            return {
                "frame": at,
                "moments": [] if take is None else [asdict(m) for m in take.moments if since < m.frame <= at + 4096],
                "effects": [] if take is None else take.effects(),
                "seconds": 0.0 if take is None else take.frames / take.fs,
                "load": self.meter.load,
                "worst": self.meter.worst,
            }

    def _keys(self, frames: int, live: Live) -> Singles:
        """Sound of the keys; what is sent again is that of before."""
        again = min(self._keyed_again, len(self._keyed), frames)
        first = len(self._keyed) - min(self._keyed_again, len(self._keyed))
        old = self._keyed[first : first + again]
        self._keyed_again = max(self._keyed_again - frames, 0)
        new = _stereo(live.process(frames - again)) if again < frames else _none()
        self._keyed = np.concatenate([self._keyed, new])[-_KEYED * self.fs :]
        return np.concatenate([old, new])

    def _phrase(self, out: Singles) -> None:
        """Add the phrase to a block, which may end and begin again in it."""
        done = 0
        while done < len(out):
            take, gain = self._heard()
            want = len(out) - done
            if self._joins is not None and self.pair is None:
                joined, at, serial = self._joins
                if self.at >= at:
                    self.take, self._joins, self.serial = joined, None, serial
                    continue
                want = min(want, at - self.at)
            block = take.read(self.at, want)
            n = len(block)
            part = out[done : done + n]
            if gain == 1.0 and self._fade_in >= FADE * self.fs:
                part += block
            else:
                rise = np.clip((self._fade_in + np.arange(n)) / (FADE * self.fs), 0.0, 1.0)
                part += block * (gain * rise[:, None]).astype(np.float32)
                self._fade_in += n
            done += n
            self.at += n
            if n < want:
                if not self.loop or take.frames == 0:
                    self.playing = False
                    self._firm = 0 if self.listener is None else self.listener.sent + done
                    return
                self._begin_again()

    def _begin_again(self) -> None:
        if self._joins is not None:
            self.take, _, self.serial = self._joins
            self._joins = None
        if self.take is not None:
            self.take = self.take.again()
        self.at, self._fade_in = 0, _WHOLE

    def _faded(self, fading: _Fading, out: Singles) -> None:
        n = min(len(out), max(0, round(FADE * self.fs) - fading.done))
        if n == 0:
            return
        if isinstance(fading.source, Live):
            block = _stereo(fading.source.process(n))
        else:
            block = fading.source.read(fading.at + fading.done, n)
        fall = 1.0 - (fading.done + np.arange(len(block))) / (FADE * self.fs)
        out[: len(block)] += block * (fading.gain * fall[:, None]).astype(np.float32)
        fading.done += n


def _none() -> Singles:
    return np.zeros((0, 2), dtype=np.float32)


def _stereo(block: NDArray[np.float64]) -> Singles:
    return np.stack([block[:, 0], block[:, min(1, block.shape[1] - 1)]], axis=1).astype(np.float32)
